/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What sampling (scatter.c) and evaluation (scatter_eval.c) of surfaces share.
 *
 * The model.  A surface is a mixture by area of (PBR) a metal with share `metallic`, a clear dielectric with share `transmission`
 * of the rest, and a coated diffuser; the other kinds are one of these alone.
 * - Metal: GGX.  Without eta, k the reflectance is the base colour at all angles: a base colour doesn't determine a complex index,
 *   and the unpolarized reflectance of Al, Ag, Au, Cu, Cr, Fe and Ni stays within 0.035 of its normal value up to 70 degrees (0.08
 *   at 80), less than what is known of most base colours.  With eta, k: Fresnel's formulae.
 * - Clear dielectric.  Thin: reflects and transmits straight on (rough: mirrored at the surface); solid: refracts.  The base colour
 *   multiplies what is transmitted, at each transmission, as glTF has it.
 * - Coated diffuser: a dielectric interface over a diffuse base; the base colour is the share of the light entering the base that
 *   comes back, and it comes back with the reciprocal density proportional to (1 - E(mu)) mu.  Seen from inside of a solid that it
 *   shares a surface with, the base has no interface.
 *
 * Light that one bounce on microfacets loses goes where microfacet.h says, so lossless surfaces stay lossless.
 *
 * Normals.  Diffuse lobes and the multiple-scattering lobes are about the geometric normal, where flux through the surface is
 * defined; mirrors and single-scattering lobes are about the shading normal.  If light arrives from below the shading normal's
 * horizon, the geometric normal is used.  A direction on the wrong side of the geometric surface is mirrored at it, with unchanged
 * weight.  So no light is lost, gained or leaked by interpolated normals, and the density remains known: a lobe's value at a
 * direction plus its value at the mirrored direction.
 */
#ifndef LUMINAIRES_SCATTER_PARTS_H
#define LUMINAIRES_SCATTER_PARTS_H

#include "microfacet.h"

/* Relative steps of the index below this are none: they would reflect less than 1e-12 and deflect by less than 1e-6 tan(theta). */
#define LUM_NO_STEP 1e-6

#define INLINE static inline __attribute__((always_inline))

/* The surface as the incoming light sees it. */
typedef struct side {
    lmg_vec3 n, g; /* shading and geometric normal, on the side of wi */
    double ci, cg; /* cosines of wi with them, > 0 (cg may be 0 for light along the surface) */
    bool front;
    bool tilted; /* n differs from g */
} side;

INLINE side side_of(const lum_surface *surface, lmg_vec3 wi)
{
    side r;
    double cg = vec_dot(wi, surface->ng);
    r.front = cg >= 0;
    r.g = r.front ? surface->ng : vec_scale(surface->ng, -1);
    r.cg = fabs(cg);
    r.tilted = false;
    r.n = r.g;
    r.ci = r.cg;
    if (surface->tilted) {
        lmg_vec3 n = r.front ? surface->ns : vec_scale(surface->ns, -1);
        double ci = vec_dot(wi, n);
        if (ci > 0) {
            r.n = n;
            r.ci = ci;
            r.tilted = true;
        }
    }
    /* Rounding of unit vectors gives cosines up to 1 + 4e-16; exactly grazing light would divide by zero below. */
    r.ci = r.ci < 1 ? r.ci > 1e-12 ? r.ci : 1e-12 : 1;
    return r;
}

/* w mirrored at the plane with unit normal m. */
INLINE lmg_vec3 mirrored(lmg_vec3 w, lmg_vec3 m)
{
    return vec_along(w, m, -2 * vec_dot(w, m));
}

/* Uniform numbers are used up by choices: true with probability p, and *u is uniform again. */
INLINE bool choose(double *u, double p)
{
    if (p <= 0) {
        return false;
    }
    if (p >= 1) {
        return true;
    }
    bool yes = *u < p;
    double v = yes ? *u / p : (*u - p) / (1 - p);
    *u = v < 1 ? v : 0x1.fffffffffffffp-1;
    return yes;
}

static inline const lum_medium_tables *medium_of(const struct lum_tables *tables, float eta_outside)
{
    for (int i = 0; i < tables->media; i++) {
        if (tables->medium[i].eta_outside == eta_outside) {
            return &tables->medium[i];
        }
    }
    return &tables->medium[0]; /* a medium from another model: the energy stays exact, eval and pdf of the rest approximate */
}

INLINE void metal_average(const lum_surface *surface, float average[3])
{
    for (int c = 0; c < 3; c++) {
        average[c] = surface->material->has_eta ? surface->tables->metal_average[c] : surface->base[c];
    }
}

/* Reflectance of light that is scattered more than once, when a bounce reflects r on average and keeps the share 1 - e: the
 * geometric series r^2 e / (1 - r (1 - e)) [kulla2017imageworks]. */
INLINE float repeated(float r, double lost)
{
    double d = 1 - (double)r * lost;
    return d > 0 ? (float)((double)r * (double)r * (1 - lost) / d) : r;
}

/* The densities of what comes back from the rough boundary of a solid after more than one bounce: the share that is transmitted.
 * Reciprocity wants share_outside * n_outside^2 * lost_outside = share_inside * n_inside^2 * lost_inside; of the values that meet
 * it, this is the largest up to the smooth boundary's own transmittance. */
INLINE double repeated_share(double lost_out, double lost_in, double fresnel_average, double eta, bool front)
{
    double index2 = front ? eta * eta : 1 / (eta * eta); /* (n_inside / n_outside)^2 */
    double a = lost_out, b = lost_in * index2;
    double k = fmin(b, (1 - fresnel_average) * a);
    return front ? k / a : k / b;
}

INLINE double repeated_through(const lum_medium_tables *t, double alpha, double eta, bool front)
{
    return repeated_share(lum_lobe_total(t->outside, alpha), lum_lobe_total(t->inside, alpha), t->fresnel_average, eta, front);
}

/* The interface over a diffuse base; NULL from inside of a solid that it shares a surface with. */
INLINE const lum_lobe_set *coat_of(const lum_surface *surface, const lum_medium_tables *tables, bool front)
{
    bool from_inside = !front && surface->transmission > 0 && !surface->material->thin;
    return from_inside ? NULL : tables->coat;
}

INLINE void set_weight(lum_scattered *out, const float w[3])
{
    out->weight[0] = w[0];
    out->weight[1] = w[1];
    out->weight[2] = w[2];
}

/* Whether unpolarized light enters the base below a rough coat, as the share 1 - E does; *rest is set where it doesn't: 1 - E. */
INLINE bool coat_admits(const lum_lobe_set *coat, double alpha, double ci, double u, double *rest)
{
    if (u < (double)lum_lobe_floor(coat, alpha, ci * ci)) {
        return true;
    }
    *rest = lum_lobe_rest(coat, alpha, ci);
    return u < *rest;
}

/* Of light in the base of a coated diffuser (coat NULL: no interface): whether it goes through to the other side, and the squared
 * cosine with which it leaves; the azimuth serves for the choice, and stays uniform. */
INLINE bool base_goes_through(const lum_surface *surface, const lum_lobe_set *coat, double *azimuth, double x, double y, double *q)
{
    bool through = choose(azimuth, (double)surface->diffuse_transmission);
    *q = coat ? lum_lobe_sample_flat(coat, (double)surface->alpha, x, y) : x;
    return through;
}

/* Densities of lobes at a direction wo. */
typedef struct density {
    double pdf; /* of directions, all reflectances 1 */
    double p[3];
} density;

INLINE void density_add(density *sum, double pdf, const float weight[3])
{
    sum->pdf += pdf;
    for (int i = 0; i < 3; i++) {
        sum->p[i] += pdf * (double)weight[i];
    }
}

/* Of a lobe of microfacet.h. */
INLINE double rest_density(const lum_lobe_set *set, double alpha, double mu)
{
    return lum_lobe_rest(set, alpha, mu) * mu / (LUM_PI * lum_lobe_total(set, alpha));
}

/* Light that one bounce on the facets of a rough clear dielectric loses.  eta: relative index across.  scatter.c, scatter_eval.c.
 */
void lum_sample_repeated(const lum_surface *surface, const side *at, const lum_medium_tables *tables, double eta,
                         const double xi[4], lum_polarization *pol, lum_scattered *out);
void lum_add_repeated(const lum_surface *surface, const side *at, const lum_medium_tables *tables, double eta, double mu,
                      bool above, double share, density *sum);

#endif
