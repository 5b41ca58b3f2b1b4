/* SPDX-License-Identifier: Apache-2.0 */
/* Densities of scattering at surfaces: what lum_scatter_sample samples, as a function of both directions.  The model is described
 * in scatter_parts.h. */
#include "scatter_layers.h"

#include <string.h>

static const float white[3] = {1, 1, 1};

/* The lobes about the shading normal, towards wo.  Shares of the mixture: metal, clear, coated. */
static void add_facets(const lum_surface *surface, const facets *f, lmg_vec3 wo, double eta, bool coat, const double share[3],
                       density *sum)
{
    double c;
    lmg_vec3 o = facets_to_local(f, wo);
    bool thin = surface->material->thin;
    if (o.z > 0) {
        double d = facets_reflected_density(f, o, &c);
        if (share[0] > 0) {
            float r[3] = {surface->base[0], surface->base[1], surface->base[2]};
            if (surface->material->has_eta) {
                for (int k = 0; k < 3; k++) {
                    r[k] = (float)lum_fresnel_conductor(c, (double)surface->material->eta[k], (double)surface->material->k[k]);
                }
            }
            density_add(sum, share[0] * d, r);
        }
        if (share[1] > 0) {
            density_add(sum, share[1] * d * (thin ? lum_fresnel_thin(c, eta) : lum_fresnel_dielectric(c, eta)), white);
        }
        if (share[2] > 0 && coat) {
            density_add(sum, share[2] * d * lum_fresnel_dielectric(c, eta), white);
        }
    } else if (share[1] > 0) {
        if (thin) {
            double d = facets_reflected_density(f, vec(o.x, o.y, -o.z), &c);
            density_add(sum, share[1] * d * (1 - lum_fresnel_thin(c, eta)), surface->base);
        } else {
            double d = facets_refracted_density(f, eta, o, &c);
            density_add(sum, share[1] * d * (1 - lum_fresnel_dielectric(c, eta)), surface->base);
        }
    }
}

void lum_add_repeated(const lum_surface *surface, const side *at, const lum_medium_tables *tables, double eta, double mu,
                      bool above, double share, density *sum)
{
    double alpha = (double)surface->alpha;
    const lum_lobe_set *same = surface->tables->metal, *other = same;
    double through = 1 - tables->thin_average;
    if (!surface->material->thin) {
        same = at->front ? tables->outside : tables->inside;
        other = at->front ? tables->inside : tables->outside;
        through = repeated_through(tables, alpha, eta, at->front);
    }
    double rest = share * lum_lobe_rest(same, alpha, at->ci);
    if (above) {
        density_add(sum, rest * (1 - through) * rest_density(same, alpha, mu), white);
    } else {
        density_add(sum, rest * through * rest_density(other, alpha, mu), surface->base);
    }
}

static density density_of(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside)
{
    density sum = {0};
    side at = side_of(surface, wi);
    double co = vec_dot(wo, at.g), mu = fmin(fabs(co), 1);
    bool above = co > 0, rough = surface->alpha >= LUM_SMOOTH;
    double alpha = (double)surface->alpha;
    const lum_material *material = surface->material;
    double share[3] = {0, 0, 0};

    if (co == 0) {
        return sum;
    }
    if (surface->layers_present) {
        lum_add_layers(surface, &at, wi, wo, eta_outside, &sum);
        return sum;
    }
    if (surface->kind == LUM_SURFACE_LAMBERT) {
        double d = (double)surface->diffuse_transmission;
        density_add(&sum, (above ? 1 - d : d) * mu / LUM_PI, above ? surface->base : surface->through);
        return sum;
    }
    if (surface->kind == LUM_SURFACE_CONDUCTOR) {
        share[0] = 1;
    } else if (surface->kind == LUM_SURFACE_PBR) {
        share[0] = (double)surface->metallic;
        share[1] = (1 - share[0]) * (double)surface->transmission;
        share[2] = 1 - share[0] - share[1];
    } else {
        return sum;
    }

    const lum_medium_tables *tables = surface->kind == LUM_SURFACE_PBR ? medium_of(surface->tables, eta_outside) : NULL;
    double eta = (double)surface->ior / (double)eta_outside;
    const lum_lobe_set *coat = share[2] > 0 ? coat_of(surface, tables, at.front) : NULL;
    bool outward = !at.front && !material->thin && surface->transmission > 0;
    double across = outward ? 1 / eta : eta; /* the relative index that light from wi meets */
    if (fabs(across - 1) < LUM_NO_STEP) {
        share[1] = 0; /* straight through: a delta */
    }

    if (rough) {
        facets f = facets_from(at.n, wi, at.ci, alpha);
        add_facets(surface, &f, wo, across, coat != NULL, share, &sum);
        if (at.tilted) {
            /* What pointed to the wrong side of the geometric surface was mirrored at it.  A lobe about n that is on the other side
             * of the geometric surface than this direction comes from there. */
            lmg_vec3 other = mirrored(wo, at.g);
            double no = vec_dot(other, at.n);
            density folded = {0};
            if (above ? no > 0 : no < 0) {
                add_facets(surface, &f, other, across, coat != NULL, share, &folded);
            }
            /* And the lobe at wo itself counts only if it is meant for this side. */
            double n = vec_dot(wo, at.n);
            if (above ? n <= 0 : n >= 0) {
                memset(&sum, 0, sizeof sum);
            }
            sum.pdf += folded.pdf;
            for (int i = 0; i < 3; i++) {
                sum.p[i] += folded.p[i];
            }
        }
        if (share[0] > 0) {
            if (above) {
                float average[3], weight[3];
                double lost = lum_lobe_total(surface->tables->metal, alpha);
                metal_average(surface, average);
                for (int i = 0; i < 3; i++) {
                    weight[i] = repeated(average[i], lost);
                }
                double rest = lum_lobe_rest(surface->tables->metal, alpha, at.ci);
                density_add(&sum, share[0] * rest * rest_density(surface->tables->metal, alpha, mu), weight);
            }
        }
        if (share[1] > 0) {
            lum_add_repeated(surface, &at, tables, across, mu, above, share[1], &sum);
        }
    }
    if (share[2] > 0) {
        double enters = coat ? (rough ? lum_lobe_rest(coat, alpha, at.ci) : 1 - lum_fresnel_dielectric(at.ci, across)) : 1;
        double d = (double)surface->diffuse_transmission;
        double lobe = coat ? rest_density(coat, alpha, mu) : mu / LUM_PI;
        density_add(&sum, share[2] * enters * (above ? 1 - d : d) * lobe, above ? surface->base : surface->through);
    }
    return sum;
}

void lum_scatter_eval(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside, float p[3])
{
    density d = density_of(surface, wi, wo, eta_outside);
    p[0] = (float)d.p[0];
    p[1] = (float)d.p[1];
    p[2] = (float)d.p[2];
}

double lum_scatter_pdf(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside)
{
    return density_of(surface, wi, wo, eta_outside).pdf;
}
