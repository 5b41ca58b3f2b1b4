/* SPDX-License-Identifier: Apache-2.0 */
/* Sampling of surfaces with layers: layer_parts.h says how they scatter. */
#include "layer_parts.h"

#include <luminaires/rng.h>

static void set_scaled_weight(lum_scattered *out, const float w[3], double factor)
{
    for (int k = 0; k < 3; k++) {
        out->weight[k] = (float)((double)w[k] * factor);
    }
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
    set_scaled_weight(out, white, 1);
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
            set_scaled_weight(out, weight, 1);
            leave(at, facets_to_model(&f, o), true, LUM_REFLECTED, out);
            return true;
        }
    }
    return false; /* a lobe so thin that it wasn't found */
}

/* A direction distributed as what stretched facets lose (stretched.h). */
static lmg_vec3 sample_stretched_rest(const lum_surface *s, lmg_vec3 n, lum_rng *rng)
{
    enum { TRIES = 1 << 20 }; /* the smoothest lose 1 in some 10^4 */
    facets f = stretched_facets(s, n);
    for (int i = 0; i < TRIES; i++) {
        double q = lum_rng_next(rng), r = sqrt(1 - q), si, co;
        sincos_turns(lum_rng_next(rng), &si, &co);
        f.wi = vec(r * co, r * si, sqrt(q));
        f.b = facets_b(&f, f.wi);
        double x = lum_rng_next(rng), y = lum_rng_next(rng);
        facet h = facets_sample(&f, x, y);
        if (!facets_keep_reflected(&f, facet_reflected(&f, &h), lum_rng_next(rng))) {
            break;
        }
    }
    return facets_to_model(&f, f.wi);
}

static void sample_layered_metal(const lum_surface *s, const side *at, lmg_vec3 wi, double passed, lum_rng *rng, lum_scattered *out)
{
    float r[3];
    lmg_vec3 wo;
    int event = LUM_REFLECTED;
    if (s->alpha >= LUM_SMOOTH || is_stretched(s)) {
        facets f = metal_facets(s, at->n, wi, at->ci);
        double x = lum_rng_next(rng), y = lum_rng_next(rng);
        facet h = facets_sample(&f, x, y);
        lmg_vec3 o = facet_reflected(&f, &h);
        if (!facets_keep_reflected(&f, o, lum_rng_next(rng))) {
            double lost;
            if (is_stretched(s)) {
                out->wo = sample_stretched_rest(s, at->g, rng);
                lum_stretched_rest(s->tables->stretched, &f, &lost);
            } else {
                const lum_lobe_set *set = s->tables->metal;
                double q = lum_lobe_sample(set, (double)s->alpha, lum_rng_next(rng));
                out->wo = vec_about_squared(at->g, q, lum_rng_next(rng));
                lost = lum_lobe_total(set, (double)s->alpha);
            }
            repeated_reflectance(s, lost, r);
            out->event = LUM_REFLECTED;
            set_scaled_weight(out, r, attenuation(s, at, passed, out->wo));
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
    set_scaled_weight(out, r, attenuation(s, at, passed, out->wo));
}

/* Whether light from f->wi gets away after one bounce on a facet of the boundary; eta: the relative index that it meets. */
static bool boundary_keeps(const lum_surface *s, const facets *f, double eta, lum_rng *rng)
{
    float r[3];
    double x = lum_rng_next(rng), y = lum_rng_next(rng), v = lum_rng_next(rng);
    facet h = facets_sample(f, x, y);
    double c = facet_cosine(&h);
    dielectric_reflectance(s, c, eta, r);
    if (lum_rng_next(rng) < largest(r)) {
        return facets_keep_reflected(f, facet_reflected(f, &h), v);
    }
    double ct = sqrt(fmax(1 - (1 - c) * (1 + c) / (eta * eta), 0));
    return v < facets_keep_refracted(f, vec_along(vec_scale(f->wi, -1 / eta), h.m, (c / eta - ct) / sqrt(h.mm)));
}

/* Light that one bounce loses: distributed as what light from all around loses on the side to which it goes (stretched.h). */
static void sample_changed_rest(const lum_surface *s, const side *at, const lum_medium_tables *medium, double eta, lum_rng *rng,
                                lum_scattered *out)
{
    enum { TRIES = 1 << 20 };
    changed_boundary b;
    find_changed_boundary(s, medium, eta, at->front, &b);
    bool behind = lum_rng_next(rng) < b.through;
    double q = 1, step = behind ? 1 / eta : eta;
    facets f = {.ax = (double)s->alpha, .ay = (double)s->alpha};
    for (int i = 0; i < TRIES; i++) {
        q = lum_rng_next(rng);
        f.wi = vec(sqrt(1 - q), 0, sqrt(q));
        f.b = facets_b(&f, f.wi);
        if (!boundary_keeps(s, &f, step, rng)) {
            break;
        }
    }
    out->wo = vec_about_squared(behind ? vec_scale(at->g, -1) : at->g, q, lum_rng_next(rng));
    out->event = behind ? LUM_TRANSMITTED | LUM_BOUNDARY : LUM_REFLECTED;
    changed_colour(s, eta, behind, out->weight);
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
        set_scaled_weight(out, s->base, attenuation(s, at, passed, d));
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
        if (!thin && changes_reflectance(s)) {
            sample_changed_rest(s, at, tables, eta, rng, out);
            set_scaled_weight(out, out->weight, attenuation(s, at, passed, out->wo));
            return;
        }
        double xi[4] = {lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng)};
        lum_sample_repeated(s, at, tables, eta, xi, NULL, out);
        set_scaled_weight(out, out->weight, attenuation(s, at, passed, out->wo));
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
    set_scaled_weight(out, weight, attenuation(s, at, passed, out->wo));
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
                set_scaled_weight(out, weight, attenuation(s, at, passed, out->wo));
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
    set_scaled_weight(out, through ? s->through : s->base, 1);
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
                set_scaled_weight(out, out->weight, ratio < 1 ? ratio : 1);
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
