/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Scattering at surfaces with the layers of glTF's material extensions: sampling and densities.
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
 * Layers act on unpolarized light.  Single bounces on stretched facets, and at boundaries of solids with a changed reflectance, lose
 * the light that meets a second facet (it counts as absorbed); all others keep it as scatter_parts.h says.  The dielectric's own
 * reflection over a diffuse base isn't stretched.
 */
#include "scatter_layers.h"

#include "film.h"
#include "sheen.h"

#include <luminaires/rng.h>

#include <string.h>

static const double COAT_INDEX = 1.5;

static double largest(const float c[3])
{
    return (double)fmaxf(fmaxf(c[0], c[1]), c[2]);
}

static bool is_solid(const lum_surface *s)
{
    return s->transmission > 0 && !s->material->thin;
}

/* Whether light on this side passes the outer layers: not inside of solids. */
static bool is_covered(const lum_surface *s, bool front)
{
    return front || !is_solid(s);
}

/* The strength of the sheen; its colours are shares of it. */
static double sheen_strength(const lum_surface *s)
{
    return s->layers_present & LUM_LAYER_SHEEN ? largest(s->layers.sheen) : 0;
}

static double coat_albedo(const lum_surface *s, double mu)
{
    double alpha = (double)s->layers.clearcoat_alpha;
    return alpha < (double)LUM_SMOOTH ? lum_fresnel_dielectric(mu, COAT_INDEX) : 1 - lum_lobe_rest(s->tables->clearcoat, alpha, mu);
}

static double coat_passes(const lum_surface *s, double mu)
{
    return s->layers_present & LUM_LAYER_CLEARCOAT ? 1 - (double)s->layers.clearcoat * coat_albedo(s, mu) : 1;
}

static double sheen_passes(const lum_surface *s, double mu)
{
    double strength = sheen_strength(s);
    return strength > 0 ? 1 - strength * lum_sheen_albedo(s->tables->sheen, (double)s->layers.sheen_alpha, mu) : 1;
}

/* L of a direction that leaves, with the cosine mu of the geometric normal, or arrives straight there. */
static double passes(const lum_surface *s, bool front, double mu)
{
    return is_covered(s, front) ? coat_passes(s, mu) * sheen_passes(s, mu) : 1;
}

/* L of light that arrives: the coat lies about its own normal. */
static double passes_in(const lum_surface *s, const side *at, double coat_cosine)
{
    return is_covered(s, at->front) ? coat_passes(s, coat_cosine) * sheen_passes(s, at->ci) : 1;
}

/* The coat's normal on the side of wi and the cosine with it; the geometric normal where wi is behind it. */
static lmg_vec3 coat_normal(const lum_surface *s, const side *at, lmg_vec3 wi, double *c)
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
static void metal_reflectance(const lum_surface *s, double c, float r[3])
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
static void dielectric_reflectance(const lum_surface *s, double c, double eta, float r[3])
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
static void thin_reflectance(const lum_surface *s, double c, double eta, float r[3])
{
    dielectric_reflectance(s, c, eta, r);
    for (int k = 0; k < 3; k++) {
        r[k] = 2 * r[k] / (1 + r[k]);
    }
}

static void shares_of_largest(const float r[3], double top, float weight[3])
{
    for (int k = 0; k < 3; k++) {
        weight[k] = top > 0 ? (float)fmin((double)r[k] / top, 1) : 1;
    }
}

/* Whether the reflectance of the dielectric isn't Fresnel's. */
static bool changes_reflectance(const lum_surface *s)
{
    return (s->layers_present & (LUM_LAYER_SPECULAR | LUM_LAYER_IRIDESCENCE)) != 0;
}

/* Whether light that one bounce on clear facets loses is known, to go where scatter_parts.h says.  A thin wall reflects what it
 * transmits too, so facets keep the same share of either; at the boundary of a solid the shares depend on the reflectance. */
static bool knows_losses(const lum_surface *s)
{
    return s->material->thin || !changes_reflectance(s);
}

static bool is_stretched(const lum_surface *s)
{
    return (s->layers_present & LUM_LAYER_ANISOTROPY) && s->layers.alpha_along > s->alpha;
}

/* The metal's facets: stretched along the tangent. */
static facets metal_facets(const lum_surface *s, const side *at, lmg_vec3 wi)
{
    if (!is_stretched(s)) {
        return facets_from(at->n, wi, at->ci, (double)s->alpha);
    }
    facets f;
    lmg_vec3 x = vec_along(s->layers.tangent, at->n, -vec_dot(s->layers.tangent, at->n)), unused;
    if (vec_dot(x, x) > 1e-12) {
        x = vec_unit(x);
    } else {
        vec_frame(at->n, &x, &unused);
    }
    f.n = at->n;
    f.x = x;
    f.y = vec_cross(at->n, x);
    f.wi = vec(vec_dot(wi, f.x), vec_dot(wi, f.y), at->ci);
    f.ax = fmax((double)s->layers.alpha_along, (double)LUM_SMOOTH);
    f.ay = fmax((double)s->alpha, (double)LUM_SMOOTH);
    f.b = facets_b(&f, f.wi);
    return f;
}

/* ------------------------------------------------------------------------------------------------------------ sampling */

static void set_weight(lum_scattered *out, const float w[3], double factor)
{
    for (int k = 0; k < 3; k++) {
        out->weight[k] = (float)((double)w[k] * factor);
    }
}

static void absorb(const side *at, lum_scattered *out)
{
    const float none[3] = {0, 0, 0};
    set_weight(out, none, 0);
    out->event = LUM_ABSORBED;
    out->wo = at->g;
}

/* Leaves along wo to one side, mirrored there if the shading normal sent it to the other. */
static void leave(const side *at, lmg_vec3 wo, bool above, int event, lum_scattered *out)
{
    double c = vec_dot(wo, at->g);
    if (above ? c < 0 : c > 0) {
        wo = vec_along(wo, at->g, -2 * c);
    }
    out->wo = wo;
    out->event = event;
}

/* Whether a layer of facets of index 1.5 reflects; then *out is set. */
static bool sample_clearcoat(const lum_surface *s, const side *at, lmg_vec3 wi, lmg_vec3 n, double c, lum_rng *rng,
                             lum_scattered *out)
{
    static const float white[3] = {1, 1, 1};
    if (!(lum_rng_next(rng) < (double)s->layers.clearcoat)) {
        return false;
    }
    double alpha = (double)s->layers.clearcoat_alpha;
    lmg_vec3 wo;
    int event = LUM_REFLECTED;
    if (alpha < (double)LUM_SMOOTH) {
        if (!(lum_rng_next(rng) < lum_fresnel_dielectric(c, COAT_INDEX))) {
            return false;
        }
        wo = vec_along(vec_scale(wi, -1), n, 2 * c);
        event |= LUM_DELTA;
    } else {
        facets f = facets_from(n, wi, c, alpha);
        double x = lum_rng_next(rng), y = lum_rng_next(rng);
        facet h = facets_sample(&f, x, y);
        lmg_vec3 o = facet_reflected(&f, &h);
        if (!(lum_rng_next(rng) < lum_fresnel_dielectric(facet_cosine(&h), COAT_INDEX)) ||
            !facets_keep_reflected(&f, o, lum_rng_next(rng))) {
            return false;
        }
        wo = facets_to_model(&f, o);
    }
    set_weight(out, white, 1);
    leave(at, wo, true, event, out);
    return true;
}

/* Whether the sheen reflects: chosen by its albedo, then found by rejection among directions uniform over the hemisphere, under the
 * bound D_max / (4 mu_i (1 + Lambda_i) cap_i). */
static bool sample_sheen(const lum_surface *s, const side *at, lmg_vec3 wi, lum_rng *rng, lum_scattered *out)
{
    enum { TRIES = 100000 };
    double strength = sheen_strength(s), alpha = (double)s->layers.sheen_alpha;
    const lum_sheen_table *table = s->tables->sheen;
    if (!(strength > 0) || !(lum_rng_next(rng) < strength * lum_sheen_albedo(table, alpha, at->ci))) {
        return false;
    }
    facets f = facets_from(at->n, wi, at->ci, 1);
    double top = lum_sheen_d_max(alpha), lambda = lum_sheen_lambda(alpha, at->ci);
    for (int i = 0; i < TRIES; i++) {
        double z = lum_rng_next(rng), si, co, r = sqrt((1 - z) * (1 + z));
        sincos_turns(lum_rng_next(rng), &si, &co);
        lmg_vec3 o = vec(r * co, r * si, z), h = vec_add(f.wi, o);
        double d = lum_sheen_d(alpha, (h.x * h.x + h.y * h.y) / vec_dot(h, h)), u = lum_rng_next(rng) * top;
        if (u < d && u * (1 + lambda + lum_sheen_lambda(alpha, z)) * lum_sheen_cap(table, alpha, z) < d * (1 + lambda)) {
            float weight[3];
            shares_of_largest(s->layers.sheen, strength, weight);
            set_weight(out, weight, 1);
            leave(at, facets_to_model(&f, o), true, LUM_REFLECTED, out);
            return true;
        }
    }
    return false; /* a lobe so thin that it wasn't found */
}

/* min(1, L(wo) / L(wi)) of what leaves from below the outer layers. */
static double attenuation(const lum_surface *s, const side *at, double passed, lmg_vec3 wo)
{
    double c = vec_dot(wo, at->g), out = passes(s, (c >= 0) == at->front, fmin(fabs(c), 1));
    return out < passed ? out / passed : 1;
}

static void sample_layered_metal(const lum_surface *s, const side *at, lmg_vec3 wi, double passed, lum_rng *rng, lum_scattered *out)
{
    float r[3];
    lmg_vec3 wo;
    int event = LUM_REFLECTED;
    if (s->alpha >= LUM_SMOOTH || is_stretched(s)) {
        facets f = metal_facets(s, at, wi);
        double x = lum_rng_next(rng), y = lum_rng_next(rng);
        facet h = facets_sample(&f, x, y);
        lmg_vec3 o = facet_reflected(&f, &h);
        if (!facets_keep_reflected(&f, o, lum_rng_next(rng))) {
            if (is_stretched(s)) {
                absorb(at, out);
                return;
            }
            const lum_lobe_set *set = s->tables->metal;
            double q = lum_lobe_sample(set, (double)s->alpha, lum_rng_next(rng)), lost = lum_lobe_total(set, (double)s->alpha);
            metal_reflectance(s, 2.0 / 3, r); /* the mean cosine of diffuse light stands for all */
            for (int k = 0; k < 3; k++) {
                r[k] = repeated(r[k], lost);
            }
            out->wo = vec_about_squared(at->g, q, lum_rng_next(rng));
            out->event = LUM_REFLECTED;
            set_weight(out, r, attenuation(s, at, passed, out->wo));
            return;
        }
        metal_reflectance(s, facet_cosine(&h), r);
        wo = facets_to_model(&f, o);
    } else {
        metal_reflectance(s, at->ci, r);
        wo = vec_along(vec_scale(wi, -1), at->n, 2 * at->ci);
        event |= LUM_DELTA;
    }
    leave(at, wo, true, event, out);
    set_weight(out, r, attenuation(s, at, passed, out->wo));
}

static void sample_layered_clear(const lum_surface *s, const side *at, lmg_vec3 wi, const lum_medium_tables *tables, double eta,
                                 double passed, lum_rng *rng, lum_scattered *out)
{
    bool thin = s->material->thin, rough = s->alpha >= LUM_SMOOTH;
    int boundary = thin ? 0 : LUM_BOUNDARY, delta = rough ? 0 : LUM_DELTA;
    lmg_vec3 d = vec_scale(wi, -1), m = at->n, wo;
    double c = at->ci;
    facets g = {0};
    facet h = {0};
    float r[3];
    if (fabs(eta - 1) < LUM_NO_STEP && !changes_reflectance(s)) {
        out->wo = d;
        out->event = LUM_TRANSMITTED | LUM_DELTA | boundary;
        set_weight(out, s->base, attenuation(s, at, passed, d));
        return;
    }
    if (rough) {
        g = facets_from(at->n, wi, at->ci, (double)s->alpha);
        double x = lum_rng_next(rng), y = lum_rng_next(rng);
        h = facets_sample(&g, x, y);
        c = facet_cosine(&h);
        m = facet_normal(&g, &h);
    }
    if (thin) {
        thin_reflectance(s, c, eta, r);
    } else {
        dielectric_reflectance(s, c, eta, r);
    }
    double top = largest(r), v = lum_rng_next(rng);
    bool reflected = lum_rng_next(rng) < top, kept = true;
    if (reflected || thin) {
        wo = vec_along(d, m, 2 * c);
        kept = !rough || facets_keep_reflected(&g, facets_to_local(&g, wo), v);
        if (!reflected) {
            wo = rough ? mirrored(wo, at->n) : d;
        }
    } else {
        double ct2 = 1 - (1 - c) * (1 + c) / (eta * eta);
        wo = vec_along(vec_scale(d, 1 / eta), m, c / eta - sqrt(ct2 > 0 ? ct2 : 0));
        kept = !rough || v < facets_keep_refracted(&g, facets_to_local(&g, wo));
    }
    if (!kept) {
        if (!knows_losses(s)) {
            absorb(at, out);
            return;
        }
        double xi[4] = {lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng)};
        lum_sample_repeated(s, at, tables, eta, xi, NULL, out);
        set_weight(out, out->weight, attenuation(s, at, passed, out->wo));
        return;
    }
    float weight[3];
    if (reflected) {
        shares_of_largest(r, top, weight);
        leave(at, wo, true, LUM_REFLECTED | delta, out);
    } else {
        memcpy(weight, s->base, sizeof weight);
        leave(at, wo, false, LUM_TRANSMITTED | delta | boundary, out);
    }
    set_weight(out, weight, attenuation(s, at, passed, out->wo));
}

/* Whether light that comes from the base with cosine mu gets out through the dielectric's facets. */
static bool gets_out(const lum_surface *s, double mu, double eta, lum_rng *rng)
{
    float r[3];
    if (s->alpha < LUM_SMOOTH) {
        dielectric_reflectance(s, mu, eta, r);
        return !(lum_rng_next(rng) < largest(r));
    }
    facets f = {.wi = vec(sqrt((1 - mu) * (1 + mu)), 0, mu), .ax = (double)s->alpha, .ay = (double)s->alpha};
    f.b = facets_b(&f, f.wi);
    double x = lum_rng_next(rng), y = lum_rng_next(rng);
    facet h = facets_sample(&f, x, y);
    lmg_vec3 o = facet_reflected(&f, &h);
    dielectric_reflectance(s, facet_cosine(&h), eta, r);
    return !(lum_rng_next(rng) < largest(r) && facets_keep_reflected(&f, o, lum_rng_next(rng)));
}

static void sample_layered_base(const lum_surface *s, const side *at, lmg_vec3 wi, bool interface, double eta, double passed,
                                lum_rng *rng, lum_scattered *out)
{
    enum { TRIES = 4096 };
    if (interface) {
        bool rough = s->alpha >= LUM_SMOOTH;
        double c = at->ci;
        lmg_vec3 wo;
        float r[3], weight[3];
        facets f = {0};
        if (rough) {
            f = facets_from(at->n, wi, at->ci, (double)s->alpha);
            double x = lum_rng_next(rng), y = lum_rng_next(rng);
            facet h = facets_sample(&f, x, y);
            c = facet_cosine(&h);
            lmg_vec3 o = facet_reflected(&f, &h);
            if (!facets_keep_reflected(&f, o, lum_rng_next(rng))) {
                c = -1;
            }
            wo = facets_to_model(&f, o);
        } else {
            wo = vec_along(vec_scale(wi, -1), at->n, 2 * c);
        }
        if (c >= 0) {
            dielectric_reflectance(s, c, eta, r);
            double top = largest(r);
            if (lum_rng_next(rng) < top) {
                shares_of_largest(r, top, weight);
                leave(at, wo, true, LUM_REFLECTED | (rough ? 0 : LUM_DELTA), out);
                set_weight(out, weight, attenuation(s, at, passed, out->wo));
                return;
            }
        }
    }
    bool through = lum_rng_next(rng) < (double)s->diffuse_transmission;
    double q = 0.5, mu;
    for (int i = 0; i < TRIES; i++) {
        q = lum_rng_next(rng);
        mu = sqrt(q);
        if (!interface ||
            (lum_rng_next(rng) < coat_passes(s, mu) && lum_rng_next(rng) < sheen_passes(s, mu) && gets_out(s, mu, eta, rng))) {
            break;
        }
    }
    out->wo = vec_about_squared(through ? vec_scale(at->g, -1) : at->g, q, lum_rng_next(rng));
    out->event = through ? LUM_TRANSMITTED : LUM_REFLECTED;
    set_weight(out, through ? s->through : s->base, 1);
}

void lum_sample_layers(const lum_surface *s, const side *at, lmg_vec3 wi, float eta_outside, const double xi[4],
                       lum_polarization *pol, lum_scattered *out)
{
    uint64_t seed = 0;
    for (int i = 0; i < 4; i++) {
        seed = lum_mix64(seed + 0x9e3779b97f4a7c15u + (uint64_t)(xi[i] * 0x1p53));
    }
    lum_rng rng = {seed};
    if (pol) {
        pol->known = false;
    }
    double coat_cosine, passed = 1;
    lmg_vec3 n = coat_normal(s, at, wi, &coat_cosine);
    if (is_covered(s, at->front)) {
        if ((s->layers_present & LUM_LAYER_CLEARCOAT) && sample_clearcoat(s, at, wi, n, coat_cosine, &rng, out)) {
            return;
        }
        if ((s->layers_present & LUM_LAYER_SHEEN) && sample_sheen(s, at, wi, &rng, out)) {
            if (s->layers_present & LUM_LAYER_CLEARCOAT) { /* it lies under the coat */
                double c = fmin(fabs(vec_dot(out->wo, at->g)), 1), ratio = coat_passes(s, c) / coat_passes(s, coat_cosine);
                set_weight(out, out->weight, ratio < 1 ? ratio : 1);
            }
            return;
        }
        passed = passes_in(s, at, coat_cosine);
    }
    if (lum_rng_next(&rng) < (double)s->metallic) {
        sample_layered_metal(s, at, wi, passed, &rng, out);
        return;
    }
    const lum_medium_tables *tables = medium_of(s->tables, eta_outside);
    double eta = (double)s->ior / (double)eta_outside;
    if (lum_rng_next(&rng) < (double)s->transmission) {
        bool outward = !at->front && !s->material->thin;
        sample_layered_clear(s, at, wi, tables, outward ? 1 / eta : eta, passed, &rng, out);
        return;
    }
    sample_layered_base(s, at, wi, is_covered(s, at->front), eta, passed, &rng, out);
}

/* ---------------------------------------------------------------------------------------------------------- evaluation */

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

void lum_prepare_layers(const lum_surface *s, struct lum_tables *tables)
{
    if (s->metallic < 1 && !lum_material_is_textured(s->material)) {
        interface_albedos(s, (double)s->material->ior, tables->base_albedo);
        tables->base_total = base_total(s, tables->base_albedo);
    }
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
        facets f = metal_facets(s, at, t->wi);
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

    double alpha = (double)s->alpha;
    if (share[0] > 0 && above && s->alpha >= LUM_SMOOTH && !is_stretched(s)) {
        const lum_lobe_set *set = s->tables->metal;
        double lost = lum_lobe_total(set, alpha), rest = lum_lobe_rest(set, alpha, at->ci);
        float r[3];
        metal_reflectance(s, 2.0 / 3, r);
        for (int k = 0; k < 3; k++) {
            r[k] = repeated(r[k], lost);
        }
        add_attenuated(sum, t.passed * share[0] * rest * rest_density(set, alpha, mu), r, t.attenuation);
    }
    if (share[1] > 0 && s->alpha >= LUM_SMOOTH && knows_losses(s)) {
        density repeated_light = {0};
        lum_add_repeated(s, at, medium_of(s->tables, eta_outside), t.across, mu, above, share[1], &repeated_light);
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
