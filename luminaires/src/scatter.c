/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Scattering at surfaces: sampling.  The model is described in scatter_parts.h, its densities are in scatter_eval.c.
 *
 * Written for speed where it matters: microfacets are handled unnormalized in a frame of their own, square roots and divisions that
 * most events don't need wait until they are needed, and unpolarized light on a rough coat first asks the coat's albedo table
 * whether it gets through, which it mostly does; only light that is reflected looks for a facet.
 */
#include "polarization.h"
#include "scatter_layers.h"

#include <luminaires/rng.h>

/* --------------------------------------------------------------------------------------------------------------- parts */

INLINE void set_white(lum_scattered *out)
{
    out->weight[0] = out->weight[1] = out->weight[2] = 1;
}

/* More numbers than the four of a sample, as a function of them: for what comes after a choice that has used them up. */
INLINE lum_rng more_numbers(const double xi[4])
{
    lum_rng r = {lum_mix64((uint64_t)(xi[0] * 0x1p53) ^ lum_mix64((uint64_t)(xi[1] * 0x1p53) + 0x9e3779b97f4a7c15u))};
    return r;
}

/* Leaves along wo on the side of wi, mirrored there if it points below the geometric surface. */
INLINE void leave(const side *at, lmg_vec3 wo, bool above, lum_polarization *pol, lum_scattered *out)
{
    if (at->tilted) {
        double c = vec_dot(wo, at->g);
        if (above ? c < 0 : c > 0) {
            wo = vec_along(wo, at->g, -2 * c);
            mirror_field(pol, at->g);
        }
    }
    out->wo = wo;
}

/* Diffuse light, numbers for azimuth and squared cosine; `behind`: to the other side. */
INLINE void leave_diffusely(const side *at, bool behind, double azimuth, double q, lum_polarization *pol, lum_scattered *out)
{
    depolarize(pol);
    out->wo = vec_about_squared(behind ? vec_scale(at->g, -1) : at->g, q, azimuth);
    out->event = behind ? LUM_TRANSMITTED : LUM_REFLECTED;
}

/* ------------------------------------------------------------------------------------------------------------- metals */

/* Mirror or rough metal; the choice is made: all of the light is here. */
INLINE void sample_metal(const lum_surface *surface, const side *at, lmg_vec3 wi, const double xi[4], double u,
                         lum_polarization *pol, lum_scattered *out)
{
    bool rough = surface->alpha >= LUM_SMOOTH, ideal = !surface->material->has_eta;
    bool follows = pol && pol->known; /* the field, of an ideal metal; of others always */
    double c = at->ci;
    lmg_vec3 wo, m = at->n;
    if (rough) {
        double alpha = (double)surface->alpha;
        facets f = facets_from(at->n, wi, at->ci, alpha);
        facet h = facets_sample(&f, xi[0], xi[1]);
        lmg_vec3 o = facet_reflected(&f, &h);
        if (!facets_keep_reflected(&f, o, xi[2])) {
            lum_rng more = more_numbers(xi);
            float average[3];
            metal_average(surface, average);
            double lost = lum_lobe_total(surface->tables->metal, alpha);
            for (int i = 0; i < 3; i++) {
                out->weight[i] = repeated(average[i], lost);
            }
            leave_diffusely(at, false, u, lum_lobe_sample(surface->tables->metal, alpha, lum_rng_next(&more)), pol, out);
            return;
        }
        wo = facets_to_model(&f, o);
        if (!ideal || follows) {
            c = facet_cosine(&h);
            m = facet_normal(&f, &h);
        }
    } else {
        wo = vec_along(vec_scale(wi, -1), m, 2 * c);
    }
    out->event = LUM_REFLECTED | (rough ? 0 : LUM_DELTA);
    if (ideal) {
        set_weight(out, surface->base);
        if (follows) {
            mirror_field(pol, m); /* an ideal conductor: E' = 2 (E.m) m - E; the sign of the whole doesn't matter */
        }
    } else {
        lmg_vec3 d = vec_scale(wi, -1);
        shares in = shares_of(pol, d, m);
        const lum_material *material = surface->material;
        interface green = {0};
        for (int i = 0; i < 3; i++) {
            interface f = conductor(c, (double)material->eta[i], (double)material->k[i]);
            out->weight[i] = (float)(in.s * f.fs + in.p * f.fp);
            if (i == 1) {
                green = f; /* one field for the three colours: that of the channel with most of the luminance */
            }
        }
        set_field(pol, &in, green.rs, green.rp, green.fs, green.fp, d, m, wo, &u);
    }
    leave(at, wo, true, pol, out);
}

/* --------------------------------------------------------------------------------------------------- coated diffusers */

/* Light that enters the base of a coated diffuser (coat NULL: no interface), from three numbers. */
INLINE void sample_base(const lum_surface *surface, const side *at, const lum_lobe_set *coat, double azimuth, double x, double y,
                        lum_polarization *pol, lum_scattered *out)
{
    double q;
    bool through = base_goes_through(surface, coat, &azimuth, x, y, &q);
    set_weight(out, through ? surface->through : surface->base);
    leave_diffusely(at, through, azimuth, q, pol, out);
}

/* Light that a rough coat reflects, when nothing but that is known: by rejection among the facets that wi sees, in proportion to
 * what they reflect and let get away.  A facet reflects upwards only if it is turned from wi by less than (90 degrees + theta_i) /
 * 2, whose squared cosine is (1 - sin theta_i) / 2; over the angle reflectance rises, or for n > 3.7 first falls and then rises, so
 * it is largest there or at normal incidence.  False: no facet found in so many tries that it can't matter. */
static bool sample_coat(const side *at, lmg_vec3 wi, double alpha, double eta, const double xi[4], double u, lum_polarization *pol,
                        lum_scattered *out)
{
    enum { TRIES = 256 };
    facets f = facets_from(at->n, wi, at->ci, alpha);
    double bound = fmax(lum_fresnel_dielectric(sqrt(0.5 * fmax(1 - f.wi.x, 0)), eta), lum_fresnel_dielectric(1, eta));
    lum_rng more = more_numbers(xi);
    double x = xi[0], y = xi[1], v = xi[2];
    for (int i = 0; i < TRIES; i++) {
        facet h = facets_sample(&f, x, y);
        lmg_vec3 o = facet_reflected(&f, &h);
        if (o.z > 0) {
            interface step = dielectric(facet_cosine(&h), eta);
            double share = 0.5 * (step.fs + step.fp);
            if (v * bound < share && facets_keep_reflected(&f, o, v * bound / share)) {
                lmg_vec3 wo = facets_to_model(&f, o);
                shares in = {0.5, 0.5, {0, 0}, {0, 0}, {0, 0, 0}};
                set_white(out);
                out->event = LUM_REFLECTED;
                if (pol) {
                    set_field(pol, &in, step.rs, step.rp, step.fs, step.fp, vec_scale(wi, -1), facet_normal(&f, &h), wo, &u);
                }
                leave(at, wo, true, pol, out);
                return true;
            }
        }
        x = lum_rng_next(&more);
        y = lum_rng_next(&more);
        v = lum_rng_next(&more);
    }
    return false;
}

/* Polarized light on a rough coat: facet first. */
static void sample_coated_polarized(const lum_surface *surface, const side *at, lmg_vec3 wi, const lum_lobe_set *coat, double eta,
                                    const double xi[4], double u, lum_polarization *pol, lum_scattered *out)
{
    double alpha = (double)surface->alpha;
    facets f = facets_from(at->n, wi, at->ci, alpha);
    facet h = facets_sample(&f, xi[0], xi[1]);
    interface step = dielectric(facet_cosine(&h), eta);
    lmg_vec3 o = facet_reflected(&f, &h), d = vec_scale(wi, -1), m = facet_normal(&f, &h);
    shares in = shares_of(pol, d, m);
    if (!choose(&u, in.s * step.fs + in.p * step.fp) || !facets_keep_reflected(&f, o, xi[2])) {
        lum_rng more = more_numbers(xi);
        double x = lum_rng_next(&more), y = lum_rng_next(&more);
        sample_base(surface, at, coat, u, x, y, pol, out);
        return;
    }
    lmg_vec3 wo = facets_to_model(&f, o);
    set_white(out);
    out->event = LUM_REFLECTED;
    set_field(pol, &in, step.rs, step.rp, step.fs, step.fp, d, m, wo, &u);
    leave(at, wo, true, pol, out);
}

INLINE void sample_coated(const lum_surface *surface, const side *at, lmg_vec3 wi, const lum_lobe_set *coat, double eta,
                          const double xi[4], double u, lum_polarization *pol, lum_scattered *out)
{
    double alpha = (double)surface->alpha;
    if (surface->alpha < LUM_SMOOTH) {
        interface f = dielectric(at->ci, eta);
        lmg_vec3 d = vec_scale(wi, -1);
        shares in = shares_of(pol, d, at->n);
        if (!choose(&u, in.s * f.fs + in.p * f.fp)) {
            sample_base(surface, at, coat, xi[0], xi[1], xi[2], pol, out);
            return;
        }
        lmg_vec3 wo = vec_along(d, at->n, 2 * at->ci);
        set_white(out);
        out->event = LUM_REFLECTED | LUM_DELTA;
        set_field(pol, &in, f.rs, f.rp, f.fs, f.fp, d, at->n, wo, &u);
        leave(at, wo, true, pol, out);
    } else if (pol && pol->known) {
        sample_coated_polarized(surface, at, wi, coat, eta, xi, u, pol, out);
    } else {
        /* The share 1 - E enters the base.  The facet that lets light enter doesn't matter for what follows. */
        double rest;
        if (!coat_admits(coat, alpha, at->ci, u, &rest) &&
            sample_coat(at, wi, alpha, eta, xi, (u - rest) / (1 - rest), pol, out)) {
            return;
        }
        sample_base(surface, at, coat, xi[0], xi[1], xi[2], pol, out);
    }
}

/* -------------------------------------------------------------------------------------------------------------- glass */

void lum_sample_repeated(const lum_surface *surface, const side *at, const lum_medium_tables *tables, double eta,
                         const double xi[4], lum_polarization *pol, lum_scattered *out)
{
    double alpha = (double)surface->alpha;
    const lum_lobe_set *same = surface->tables->metal, *other = same;
    double through = 1 - tables->thin_average;
    bool thin = surface->material->thin;
    if (!thin) {
        same = at->front ? tables->outside : tables->inside;
        other = at->front ? tables->inside : tables->outside;
        through = repeated_through(tables, alpha, eta, at->front);
    }
    lum_rng more = more_numbers(xi);
    bool behind = lum_rng_next(&more) < through;
    double azimuth = lum_rng_next(&more);
    leave_diffusely(at, behind, azimuth, lum_lobe_sample(behind ? other : same, alpha, lum_rng_next(&more)), pol, out);
    if (behind) {
        out->event |= thin ? 0 : LUM_BOUNDARY;
        set_weight(out, surface->base);
    } else {
        set_white(out);
    }
}

/* The clear share of a dielectric: boundary of a solid, or thin wall.  eta: relative index across. */
INLINE void sample_clear(const lum_surface *surface, const side *at, lmg_vec3 wi, const lum_medium_tables *tables, double eta,
                         const double xi[4], double u, lum_polarization *pol, lum_scattered *out)
{
    bool thin = surface->material->thin, rough = surface->alpha >= LUM_SMOOTH;
    int boundary = thin ? 0 : LUM_BOUNDARY;
    lmg_vec3 d = vec_scale(wi, -1);
    if (fabs(eta - 1) < LUM_NO_STEP) {
        out->wo = d;
        out->event = LUM_TRANSMITTED | LUM_DELTA | boundary;
        set_weight(out, surface->base);
        return;
    }
    int delta = rough ? 0 : LUM_DELTA;
    lmg_vec3 m = at->n;
    double c = at->ci;
    facets g = {0};
    facet h = {0};
    if (rough) {
        g = facets_from(at->n, wi, at->ci, (double)surface->alpha);
        h = facets_sample(&g, xi[0], xi[1]);
        c = facet_cosine(&h);
        m = facet_normal(&g, &h);
    }
    interface f = thin ? thin_wall(c, eta) : dielectric(c, eta);
    shares in = shares_of(pol, d, m);
    bool reflected = choose(&u, in.s * f.fs + in.p * f.fp);
    lmg_vec3 wo;
    if (reflected || thin) { /* a thin wall's light through is reflected light, mirrored at the surface */
        if (rough) {
            lmg_vec3 o = facet_reflected(&g, &h);
            if (!facets_keep_reflected(&g, o, xi[2])) {
                lum_sample_repeated(surface, at, tables, eta, xi, pol, out);
                return;
            }
            wo = facets_to_model(&g, o);
        } else {
            wo = vec_along(d, m, 2 * c);
        }
        if (reflected) {
            set_white(out);
            out->event = LUM_REFLECTED | delta;
            set_field(pol, &in, f.rs, f.rp, f.fs, f.fp, d, m, wo, &u);
        } else {
            /* Of the field the component along the mirrored wo x s changes sign, so that a wall straight on leaves the field as it
             * is. */
            complex2 tp = passed(f.fp);
            tp.re = -tp.re;
            set_field(pol, &in, passed(f.fs), tp, 1 - f.fs, 1 - f.fp, d, m, wo, &u);
            mirror_field(pol, at->n);
            wo = rough ? mirrored(wo, at->n) : d;
            set_weight(out, surface->base);
            out->event = LUM_TRANSMITTED | delta;
        }
        leave(at, wo, reflected, pol, out);
        return;
    }
    wo = vec_along(vec_scale(d, 1 / eta), m, c / eta - f.ct);
    if (rough && !(xi[2] < facets_keep_refracted(&g, facets_to_local(&g, wo)))) {
        lum_sample_repeated(surface, at, tables, eta, xi, pol, out);
        return;
    }
    set_weight(out, surface->base);
    out->event = LUM_TRANSMITTED | LUM_BOUNDARY | delta;
    set_field(pol, &in, passed(f.fs), passed(f.fp), 1 - f.fs, 1 - f.fp, d, m, wo, &u);
    leave(at, wo, false, pol, out);
}

/* ------------------------------------------------------------------------------------------------------------ sampling */

void lum_scatter_trace(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4], lum_polarization *pol,
                       lum_scattered *out)
{
    side at = side_of(surface, wi);
    double u = xi[3];
    out->pdf = 0;
    switch (surface->kind) {
    case LUM_SURFACE_LAMBERT: {
        bool through = choose(&u, (double)surface->diffuse_transmission);
        set_weight(out, through ? surface->through : surface->base);
        leave_diffusely(&at, through, xi[0], xi[1], pol, out);
        return;
    }
    case LUM_SURFACE_CONDUCTOR:
        sample_metal(surface, &at, wi, xi, u, pol, out);
        return;
#ifndef LUM_ONLY_REFLECTORS /* the benchmark's build without other effects (tests/bench/bench_pay.c) */
    case LUM_SURFACE_PBR: {
        if (surface->layers_present) {
            lum_sample_layers(surface, &at, wi, eta_outside, xi, pol, out);
            return;
        }
        if (choose(&u, (double)surface->metallic)) {
            sample_metal(surface, &at, wi, xi, u, pol, out);
            return;
        }
        const lum_medium_tables *tables = medium_of(surface->tables, eta_outside);
        double eta = (double)surface->ior / (double)eta_outside;
        if (choose(&u, (double)surface->transmission)) {
            bool outward = !at.front && !surface->material->thin;
            sample_clear(surface, &at, wi, tables, outward ? 1 / eta : eta, xi, u, pol, out);
            return;
        }
        const lum_lobe_set *coat = coat_of(surface, tables, at.front);
        if (coat) {
            sample_coated(surface, &at, wi, coat, eta, xi, u, pol, out);
        } else {
            sample_base(surface, &at, NULL, xi[0], xi[1], 0, pol, out);
        }
        return;
    }
#endif
    case LUM_SURFACE_BLACK:
    default:
        out->event = LUM_ABSORBED;
        out->wo = at.g;
        out->weight[0] = out->weight[1] = out->weight[2] = 0;
        return;
    }
}

void lum_scatter_sample(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4], lum_scattered *out)
{
    lum_scatter_trace(surface, wi, eta_outside, xi, NULL, out);
    if (out->event & LUM_DELTA) {
        out->pdf = 1;
    } else if (out->event != LUM_ABSORBED) {
        out->pdf = lum_scatter_pdf(surface, wi, out->wo, eta_outside);
    }
}
