/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Surfaces with the layers of glTF's material extensions: what sampling (scatter_layers.c) and densities (scatter_layers_eval.c)
 * share.
 *
 * From the outside in: clear coat, sheen, then the metal or the dielectric, whose reflection `specular` and `iridescence` change
 * and whose metal part `anisotropy` stretches, then what is under the dielectric: clear or diffuse.  Of the light that arrives with
 * the cosine mu, clear coat and sheen let through
 *     L(mu) = (1 - C E_c(mu)) (1 - S E_s(mu)),
 * C the coat's strength, E_c the albedo of its reflection (GGX, index 1.5), S the largest of the sheen's R,G,B, E_s its albedo.
 *
 * What lies below is attenuated by min(L(mu_i), L(mu_o)), which is reciprocal; glTF writes this for sheen, and for the clear coat
 * gives L of the viewer's side alone, under which a photon could be reflected more than once.  Diffuse light, which a coat throws
 * back until it gets out, keeps what the minimum would lose: with R(mu) = (1 - E(mu)) L(mu), E the albedo of the dielectric's
 * reflection (its largest colour component, as glTF has it), its density is
 *     p = R(mu_i) R(mu_o) mu_o / (pi T),   T = integral of 2 R mu dmu,
 * the form that uncoated surfaces have (microfacet.h).  Sampling doesn't need E: light enters where a facet lets it enter, and
 * leaves where a facet, the coat and the sheen let it out.
 *
 * Layers act on unpolarized light.  Light that one bounce on facets loses is kept as scatter_parts.h says; of stretched facets and
 * of the boundary of a solid with a changed reflectance as stretched.h says.  The dielectric's own reflection over a diffuse base
 * isn't stretched.
 */
#ifndef LUMINAIRES_LAYER_PARTS_H
#define LUMINAIRES_LAYER_PARTS_H

#include "film.h"
#include "scatter_layers.h"
#include "sheen.h"
#include "stretched.h"

#include <string.h>

#define COAT_INDEX 1.5

static inline double largest(const float c[3])
{
    return (double)fmaxf(fmaxf(c[0], c[1]), c[2]);
}

static inline bool is_solid(const lum_surface *s)
{
    return s->transmission > 0 && !s->material->thin;
}

/* Whether light on this side passes the outer layers: not inside of solids. */
static inline bool is_covered(const lum_surface *s, bool front)
{
    return front || !is_solid(s);
}

/* The strength of the sheen; its colours are shares of it. */
static inline double sheen_strength(const lum_surface *s)
{
    return s->layers_present & LUM_LAYER_SHEEN ? largest(s->layers.sheen) : 0;
}

static inline double coat_albedo(const lum_surface *s, double mu)
{
    double alpha = (double)s->layers.clearcoat_alpha;
    return alpha < (double)LUM_SMOOTH ? lum_fresnel_dielectric(mu, COAT_INDEX) : 1 - lum_lobe_rest(s->tables->clearcoat, alpha, mu);
}

static inline double coat_passes(const lum_surface *s, double mu)
{
    return s->layers_present & LUM_LAYER_CLEARCOAT ? 1 - (double)s->layers.clearcoat * coat_albedo(s, mu) : 1;
}

static inline double sheen_passes(const lum_surface *s, double mu)
{
    double strength = sheen_strength(s);
    return strength > 0 ? 1 - strength * lum_sheen_albedo(s->tables->sheen, (double)s->layers.sheen_alpha, mu) : 1;
}

/* L of a direction that leaves, with the cosine mu of the geometric normal, or arrives straight there. */
static inline double passes(const lum_surface *s, bool front, double mu)
{
    return is_covered(s, front) ? coat_passes(s, mu) * sheen_passes(s, mu) : 1;
}

/* L of light that arrives: the coat lies about its own normal. */
static inline double passes_in(const lum_surface *s, const side *at, double coat_cosine)
{
    return is_covered(s, at->front) ? coat_passes(s, coat_cosine) * sheen_passes(s, at->ci) : 1;
}

/* The coat's normal on the side of wi and the cosine with it; the geometric normal where wi is behind it. */
static inline lmg_vec3 coat_normal(const lum_surface *s, const side *at, lmg_vec3 wi, double *c)
{
    lmg_vec3 n = s->layers_present & LUM_LAYER_CLEARCOAT ? vec_scale(s->layers.clearcoat_normal, at->front ? 1 : -1) : at->g;
    *c = vec_dot(wi, n);
    if (!(*c > 1e-12)) {
        n = at->g;
        *c = fmax(at->cg, 1e-12);
    }
    *c = fmin(*c, 1);
    return n;
}

/* ------------------------------------------------------------------------------------------------------- reflectances */

/* Of the metal's facets at cosine c. */
static inline void metal_reflectance(const lum_surface *s, double c, float r[3])
{
    memcpy(r, s->base, 3 * sizeof *r);
    if (s->layers_present & LUM_LAYER_IRIDESCENCE) {
        float film[3];
        lum_film_reflectance(s->tables->film, c, (double)s->layers.film_ior, (double)s->layers.film_nm, s->base, film);
        for (int k = 0; k < 3; k++) {
            r[k] += s->layers.iridescence * (film[k] - r[k]);
        }
    }
}

/*
 * Of the dielectric's facets at cosine c for the relative index eta.  With F Fresnel's reflectance and F0 its value at normal
 * incidence, specular 1 and its colour c make of F
 *     specular (min(F0 c, 1) (1 - t) + t),   t = (F - F0) / (1 - F0),
 * which is glTF's formula with the exact t in place of (1 - cos)^5.  Total reflection stays total.
 */
static inline void dielectric_reflectance(const lum_surface *s, double c, double eta, float r[3])
{
    double f = lum_fresnel_dielectric(c, eta);
    if (f >= 1) {
        r[0] = r[1] = r[2] = 1;
        return;
    }
    if (eta < 1 && is_solid(s)) { /* from inside: as much passes as on the way back, for every layer on the outside */
        c = sqrt(fmax(1 - (1 - c) * (1 + c) / (eta * eta), 0));
        eta = 1 / eta;
    }
    double root = (eta - 1) / (eta + 1), f0 = root * root, t = fmin(fmax((f - f0) / (1 - f0), 0), 1);
    float normal[3];
    for (int k = 0; k < 3; k++) {
        bool changed = s->layers_present & LUM_LAYER_SPECULAR;
        double strength = changed ? (double)s->layers.specular : 1;
        double n = changed ? fmin(f0 * (double)s->layers.specular_color[k], 1) : f0;
        normal[k] = (float)(strength * n);
        r[k] = (float)(changed ? strength * (n * (1 - t) + t) : f);
    }
    if (s->layers_present & LUM_LAYER_IRIDESCENCE) {
        float film[3];
        lum_film_reflectance(s->tables->film, c, (double)s->layers.film_ior, (double)s->layers.film_nm, normal, film);
        for (int k = 0; k < 3; k++) {
            r[k] += s->layers.iridescence * (film[k] - r[k]);
        }
    }
}

/* Both faces of a thin wall, all reflections between them. */
static inline void thin_reflectance(const lum_surface *s, double c, double eta, float r[3])
{
    dielectric_reflectance(s, c, eta, r);
    for (int k = 0; k < 3; k++) {
        r[k] = 2 * r[k] / (1 + r[k]);
    }
}

static inline void shares_of_largest(const float r[3], double top, float weight[3])
{
    for (int k = 0; k < 3; k++) {
        weight[k] = top > 0 ? (float)fmin((double)r[k] / top, 1) : 1;
    }
}

/* Whether the reflectance of the dielectric isn't Fresnel's. */
static inline bool changes_reflectance(const lum_surface *s)
{
    return (s->layers_present & (LUM_LAYER_SPECULAR | LUM_LAYER_IRIDESCENCE)) != 0;
}

/*
 * What one bounce on the facets of a solid's boundary with a changed reflectance loses: 1 - E at the nodes and 1 - E_avg, from the
 * front and from inside.  (A thin wall reflects what it transmits too, so its facets keep the same share of either, whatever the
 * reflectance: lum_sample_repeated.)
 */
typedef struct changed_boundary {
    const float *rest[2];
    double total[2];
    double through; /* share of the lost light that is transmitted */
    float own[2][LUM_COSINE_NODES + 1];
} changed_boundary;

/* By the reflectance of the larger colour, with which light is reflected.  eta: relative index that light from this side meets. */
static inline void find_changed_boundary(const lum_surface *s, const lum_medium_tables *medium, double eta, bool front,
                                         changed_boundary *b)
{
    const struct lum_tables *known = s->tables;
    if (known->changed_total[0] > 0 && medium->eta_outside == 1.0f) {
        for (int i = 0; i < 2; i++) {
            b->rest[i] = known->changed_rest[i];
            b->total[i] = known->changed_total[i];
        }
    } else {
        float f[LUM_COSINE_STEPS + 1], r[3];
        for (int k = 0; k <= LUM_COSINE_STEPS; k++) {
            dielectric_reflectance(s, (double)k / LUM_COSINE_STEPS, eta > 1 ? eta : 1 / eta, r);
            f[k] = (float)largest(r);
        }
        for (int i = 0; i < 2; i++) {
            b->total[i] = lum_boundary_rests(medium->changed, (double)s->alpha, i == 0, f, b->own[i]);
            b->rest[i] = b->own[i];
        }
    }
    b->through = repeated_share(b->total[0], b->total[1], medium->fresnel_average, eta, front);
}

/* Colour of that light: transmitted by the base colour, reflected as at the mean cosine of diffuse light. */
static inline void changed_colour(const lum_surface *s, double eta, bool behind, float weight[3])
{
    float r[3];
    if (behind) {
        memcpy(weight, s->base, 3 * sizeof *weight);
    } else {
        dielectric_reflectance(s, 2.0 / 3, eta > 1 ? eta : 1 / eta, r);
        shares_of_largest(r, largest(r), weight);
    }
}

static inline bool is_stretched(const lum_surface *s)
{
    return (s->layers_present & LUM_LAYER_ANISOTROPY) && s->layers.alpha_along > s->alpha;
}

/* Facets about n, stretched along the tangent, that no direction is given for yet. */
static inline facets stretched_facets(const lum_surface *s, lmg_vec3 n)
{
    facets f = {.n = n};
    lmg_vec3 x = vec_along(s->layers.tangent, n, -vec_dot(s->layers.tangent, n)), unused;
    if (vec_dot(x, x) > 1e-12) {
        x = vec_unit(x);
    } else {
        vec_frame(n, &x, &unused);
    }
    f.x = x;
    f.y = vec_cross(n, x);
    f.ax = fmax((double)s->layers.alpha_along, (double)LUM_SMOOTH);
    f.ay = fmax((double)s->alpha, (double)LUM_SMOOTH);
    return f;
}

/* The metal's facets as seen from w, the cosine of which with n is c. */
static inline facets metal_facets(const lum_surface *s, lmg_vec3 n, lmg_vec3 w, double c)
{
    if (!is_stretched(s)) {
        return facets_from(n, w, c, (double)s->alpha);
    }
    facets f = stretched_facets(s, n);
    f.wi = vec(vec_dot(w, f.x), vec_dot(w, f.y), c);
    f.b = facets_b(&f, f.wi);
    return f;
}

/* Reflectance of light that meets more than one facet of the metal. */
static inline void repeated_reflectance(const lum_surface *s, double lost, float r[3])
{
    metal_reflectance(s, 2.0 / 3, r); /* the mean cosine of diffuse light stands for all */
    for (int k = 0; k < 3; k++) {
        r[k] = repeated(r[k], lost);
    }
}

/* min(1, L(wo) / L(wi)) of what leaves from below the outer layers. */
static inline double attenuation(const lum_surface *s, const side *at, double passed, lmg_vec3 wo)
{
    double c = vec_dot(wo, at->g), out = passes(s, (c >= 0) == at->front, fmin(fabs(c), 1));
    return out < passed ? out / passed : 1;
}

#endif
