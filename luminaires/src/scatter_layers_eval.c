/* SPDX-License-Identifier: Apache-2.0 */
/* Densities of surfaces with layers: layer_parts.h says how they scatter. */
#include "layer_parts.h"

/* E of the dielectric's interface at the nodes. */
static void interface_albedos(const lum_surface *s, double eta, float albedo[LUM_COSINE_NODES + 1])
{
    float r[3];
    if (s->alpha < LUM_SMOOTH) {
        for (int j = 0; j <= LUM_COSINE_NODES; j++) {
            double x = (double)j / LUM_COSINE_NODES;
            dielectric_reflectance(s, x * x, eta, r);
            albedo[j] = (float)largest(r);
        }
        return;
    }
    float f[LUM_COSINE_STEPS + 1];
    for (int k = 0; k <= LUM_COSINE_STEPS; k++) {
        dielectric_reflectance(s, (double)k / LUM_COSINE_STEPS, eta, r);
        f[k] = (float)largest(r);
    }
    lum_cosine_albedos(s->tables->cosines, (double)s->alpha, f, albedo);
}

static double at_node(const float albedo[LUM_COSINE_NODES + 1], double mu)
{
    double x = sqrt(mu) * LUM_COSINE_NODES;
    int j = (int)x < LUM_COSINE_NODES ? (int)x : LUM_COSINE_NODES - 1;
    return (double)albedo[j] + (x - j) * ((double)albedo[j + 1] - (double)albedo[j]);
}

/* T: the integral of 2 R mu dmu = 4 R x^3 dx, x = sqrt(mu), by Simpson's rule over the nodes. */
static double base_total(const lum_surface *s, const float albedo[LUM_COSINE_NODES + 1])
{
    double total = 0;
    for (int j = 1; j <= LUM_COSINE_NODES; j++) {
        double x = (double)j / LUM_COSINE_NODES, r = (1 - (double)albedo[j]) * coat_passes(s, x * x) * sheen_passes(s, x * x);
        total += (j == LUM_COSINE_NODES ? 1 : j % 2 ? 4 : 2) * r * 4 * x * x * x / (3.0 * LUM_COSINE_NODES);
    }
    return total;
}

/* The diffuse base towards mu. */
static double base_density(const lum_surface *s, double eta, double passed, double ci, double mu)
{
    const struct lum_tables *tables = s->tables;
    float own[LUM_COSINE_NODES + 1];
    const float *albedo = tables->base_albedo;
    double total = tables->base_total;
    if (!(total > 0) || eta != (double)s->material->ior) {
        interface_albedos(s, eta, own);
        albedo = own;
        total = base_total(s, own);
    }
    double out = (1 - at_node(albedo, mu)) * coat_passes(s, mu) * sheen_passes(s, mu);
    return total > 0 ? passed * (1 - at_node(albedo, ci)) * out * mu / (LUM_PI * total) : 0;
}

static void add_changed_rest(const lum_surface *s, const side *at, const lum_medium_tables *medium, double eta, double mu,
                             bool above, double share, density *sum)
{
    changed_boundary b;
    float weight[3];
    find_changed_boundary(s, medium, eta, at->front, &b);
    int from = at->front ? 0 : 1, to = above ? from : 1 - from;
    double rest = share * at_node(b.rest[from], at->ci) * (above ? 1 - b.through : b.through);
    changed_colour(s, eta, !above, weight);
    density_add(sum, rest * at_node(b.rest[to], mu) * mu / (LUM_PI * b.total[to]), weight);
}

void lum_prepare_layers(const lum_surface *s, struct lum_tables *tables)
{
    const lum_medium_tables *air = tables->media ? &tables->medium[0] : NULL;
    if (air && air->changed && !lum_material_is_textured(s->material)) {
        changed_boundary b;
        find_changed_boundary(s, air, (double)s->material->ior, true, &b);
        memcpy(tables->changed_rest, b.own, sizeof tables->changed_rest);
        memcpy(tables->changed_total, b.total, sizeof tables->changed_total);
    }
    if (s->metallic < 1 && !lum_material_is_textured(s->material)) {
        interface_albedos(s, (double)s->material->ior, tables->base_albedo);
        tables->base_total = base_total(s, tables->base_albedo);
    }
}

/* 1 - E of the metal from w, and 1 - E_avg. */
static double metal_rest(const lum_surface *s, lmg_vec3 n, lmg_vec3 w, double c, double *total)
{
    if (is_stretched(s)) {
        facets f = metal_facets(s, n, w, c);
        return lum_stretched_rest(s->tables->stretched, &f, total);
    }
    *total = lum_lobe_total(s->tables->metal, (double)s->alpha);
    return lum_lobe_rest(s->tables->metal, (double)s->alpha, c);
}

typedef struct towards {
    const lum_surface *s;
    const side *at;
    lmg_vec3 wi;
    const double *share; /* metal, clear, diffuse */
    double across;       /* relative index that wi meets */
    double passed, attenuation;
    bool covered, has_interface;
    lmg_vec3 coat_normal;
    double coat_cosine, coat_ratio; /* min(1, C(wo) / C(wi)): of the coat alone */
} towards;

static const float white[3] = {1, 1, 1};

static void add_attenuated(density *sum, double pdf, const float weight[3], double factor)
{
    float w[3] = {(float)((double)weight[0] * factor), (float)((double)weight[1] * factor), (float)((double)weight[2] * factor)};
    density_add(sum, pdf, w);
}

/* The lobes about shading normals, at wo; reflected or transmitted ones. */
static void add_lobes(const towards *t, lmg_vec3 wo, bool reflected, density *sum)
{
    const lum_surface *s = t->s;
    const side *at = t->at;
    double c, metal = t->share[0], clear = t->share[1], diffuse = t->share[2];
    float r[3], weight[3];
    if (reflected && t->covered && (s->layers_present & LUM_LAYER_CLEARCOAT) && s->layers.clearcoat_alpha >= LUM_SMOOTH) {
        facets f = facets_from(t->coat_normal, t->wi, t->coat_cosine, (double)s->layers.clearcoat_alpha);
        double d = facets_reflected_density(&f, facets_to_local(&f, wo), &c);
        density_add(sum, (double)s->layers.clearcoat * d * lum_fresnel_dielectric(c, COAT_INDEX), white);
    }
    double strength = sheen_strength(s), z = vec_dot(wo, at->n);
    if (reflected && t->covered && strength > 0 && z > 0) {
        facets f = facets_from(at->n, t->wi, at->ci, 1);
        double d = lum_sheen_density(s->tables->sheen, (double)s->layers.sheen_alpha, f.wi, facets_to_local(&f, wo));
        shares_of_largest(s->layers.sheen, strength, weight);
        add_attenuated(sum, coat_passes(s, t->coat_cosine) * strength * d, weight, t->coat_ratio);
    }
    if (reflected && metal > 0 && (s->alpha >= LUM_SMOOTH || is_stretched(s)) && z > 0) {
        facets f = metal_facets(s, at->n, t->wi, at->ci);
        double d = facets_reflected_density(&f, facets_to_local(&f, wo), &c);
        metal_reflectance(s, c, r);
        add_attenuated(sum, t->passed * metal * d, r, t->attenuation);
    }
    if (s->alpha < LUM_SMOOTH || !(clear > 0 || diffuse > 0)) {
        return;
    }
    facets f = facets_from(at->n, t->wi, at->ci, (double)s->alpha);
    lmg_vec3 o = facets_to_local(&f, wo);
    bool thin = s->material->thin;
    if (reflected) {
        double d = facets_reflected_density(&f, o, &c);
        if (clear > 0) {
            if (thin) {
                thin_reflectance(s, c, t->across, r);
            } else {
                dielectric_reflectance(s, c, t->across, r);
            }
            shares_of_largest(r, largest(r), weight);
            add_attenuated(sum, t->passed * clear * d * largest(r), weight, t->attenuation);
        }
        if (diffuse > 0 && t->has_interface) {
            dielectric_reflectance(s, c, t->across, r);
            shares_of_largest(r, largest(r), weight);
            add_attenuated(sum, t->passed * diffuse * d * largest(r), weight, t->attenuation);
        }
    } else if (clear > 0) {
        double d;
        if (thin) {
            d = facets_reflected_density(&f, vec(o.x, o.y, -o.z), &c);
            thin_reflectance(s, c, t->across, r);
        } else {
            d = facets_refracted_density(&f, t->across, o, &c);
            dielectric_reflectance(s, c, t->across, r);
        }
        add_attenuated(sum, t->passed * clear * d * (1 - largest(r)), s->base, t->attenuation);
    }
}

void lum_add_layers(const lum_surface *s, const side *at, lmg_vec3 wi, lmg_vec3 wo, float eta_outside, density *sum)
{
    double co = vec_dot(wo, at->g), mu = fmin(fabs(co), 1);
    bool above = co > 0;
    const double metal = (double)s->metallic, clear = (1 - metal) * (double)s->transmission;
    double share[3] = {metal, clear, 1 - metal - clear};
    bool outward = !at->front && is_solid(s);
    double eta = (double)s->ior / (double)eta_outside;
    towards t = {.s = s, .at = at, .wi = wi, .share = share, .across = outward ? 1 / eta : eta};
    t.covered = is_covered(s, at->front);
    t.has_interface = t.covered;
    t.coat_normal = coat_normal(s, at, wi, &t.coat_cosine);
    t.passed = passes_in(s, at, t.coat_cosine);
    t.attenuation = attenuation(s, at, t.passed, wo);
    double ratio = coat_passes(s, mu) / coat_passes(s, t.coat_cosine);
    t.coat_ratio = ratio < 1 ? ratio : 1;
    if (fabs(t.across - 1) < LUM_NO_STEP && !changes_reflectance(s)) {
        share[1] = 0; /* straight through: a delta */
    }

    add_lobes(&t, wo, above, sum);
    if (at->tilted || ((s->layers_present & LUM_LAYER_CLEARCOAT) && vec_dot(t.coat_normal, at->g) < 1)) {
        add_lobes(&t, mirrored(wo, at->g), above, sum); /* what pointed to the wrong side was mirrored at the surface */
    }

    if (share[0] > 0 && above && (s->alpha >= LUM_SMOOTH || is_stretched(s))) {
        float r[3];
        double lost, rest = metal_rest(s, at->n, wi, at->ci, &lost) * metal_rest(s, at->g, wo, mu, &lost);
        repeated_reflectance(s, lost, r);
        add_attenuated(sum, t.passed * share[0] * rest * mu / (LUM_PI * lost), r, t.attenuation);
    }
    if (share[1] > 0 && s->alpha >= LUM_SMOOTH) {
        density repeated_light = {0};
        const lum_medium_tables *medium = medium_of(s->tables, eta_outside);
        if (!s->material->thin && changes_reflectance(s)) {
            add_changed_rest(s, at, medium, t.across, mu, above, share[1], &repeated_light);
        } else {
            lum_add_repeated(s, at, medium, t.across, mu, above, share[1], &repeated_light);
        }
        for (int k = 0; k < 3; k++) {
            sum->p[k] += t.passed * t.attenuation * repeated_light.p[k];
        }
        sum->pdf += t.passed * repeated_light.pdf;
    }
    if (share[2] > 0) {
        double d = (double)s->diffuse_transmission;
        double lobe = t.has_interface ? base_density(s, t.across, t.passed, at->ci, mu) : mu / LUM_PI;
        density_add(sum, share[2] * (above ? 1 - d : d) * lobe, above ? s->base : s->through);
    }
}
