/* SPDX-License-Identifier: Apache-2.0 */
/*
 * GGX microfacets [walter2007microfacet] and where the light goes that one bounce on them doesn't account for.
 *
 * A single reflection on a rough surface loses the light that its own facets block: of what arrives under cosine mu the share E(mu)
 * gets away, the rest, 1 - E(mu), is scattered again.  That rest leaves with the density
 *     p(mu_o) = (1 - E(mu_o)) mu_o / (pi (1 - E_avg)),   E_avg = 2 * integral of E mu,
 * which is reciprocal and conserves energy [kelemen2001coupled, kulla2017imageworks].  1 - E is tabulated as a function that is
 * linear in q = mu^2 between nodes; with d(mu^2) = 2 mu dmu the density is linear in q too, so its integral and its inverse are
 * exact for the interpolant.
 */
#ifndef LUMINAIRES_MICROFACET_H
#define LUMINAIRES_MICROFACET_H

#include "vec.h"

#include <luminaires/scatter.h>

enum { LUM_LOBE_SEGMENTS = 64 /* a power of two */, LUM_LOBE_ROUGHNESSES = 24 };

/* 1 - E over q at one roughness. */
typedef struct lum_lobe {
    double rest[LUM_LOBE_SEGMENTS + 1]; /* 1 - E at node j, q = (j / LUM_LOBE_SEGMENTS)^4 */
    double sum[LUM_LOBE_SEGMENTS + 1];  /* integral of rest dq from 0 to node j; the last is 1 - E_avg */
    uint8_t guide[LUM_LOBE_SEGMENTS];   /* of part k of LUM_LOBE_SEGMENTS equal parts of the sum: the segment where it begins */
} lum_lobe;

/* Over roughness (sqrt of alpha): one lobe if it is constant, else LUM_LOBE_ROUGHNESSES + 1 equally spaced ones. */
typedef struct lum_lobe_set {
    int kind;    /* lum_lobe_kind */
    float eta;   /* relative index n_t / n_i; 0 for LUM_LOBE_METAL */
    float alpha; /* of a set with one lobe */
    int count;
    lum_lobe lobes[];
} lum_lobe_set;

typedef enum lum_lobe_kind {
    LUM_LOBE_METAL = 0,   /* E: single reflection, Fresnel reflectance 1 */
    LUM_LOBE_COAT = 1,    /* E: single reflection on a dielectric; the rest is what enters the base below */
    LUM_LOBE_BOUNDARY = 2 /* E: single reflection and single transmission of a dielectric */
} lum_lobe_kind;

/* For one index of the medium outside. */
typedef struct lum_medium_tables {
    float eta_outside;
    const lum_lobe_set *coat;             /* opaque dielectrics */
    const lum_lobe_set *outside, *inside; /* boundaries of solids, light from the front and from behind; NULL if not needed */
    double fresnel_average;               /* of the smooth boundary from the front, over the cosine-weighted hemisphere */
    double thin_average;                  /* of lum_fresnel_thin */
} lum_medium_tables;

enum { LUM_MAX_MEDIA = 8 };

/* What the lobes of one material need. */
struct lum_tables {
    const lum_lobe_set *metal; /* NULL if not needed */
    float metal_average[3];    /* Fresnel reflectance of eta, k over the cosine-weighted hemisphere */
    int media;
    lum_medium_tables medium[LUM_MAX_MEDIA];
};

/* All tables of a model: one lum_tables per material, lobe sets shared. */
typedef struct lum_table_store {
    struct lum_tables *tables;
    lum_lobe_set **sets;
    size_t set_count;
} lum_table_store;

/* 1 - E and 1 - E_avg at a roughness. */
double lum_lobe_rest(const lum_lobe_set *set, double alpha, double mu);
double lum_lobe_total(const lum_lobe_set *set, double alpha);
/* Squared cosine q of a direction distributed as p above; x in [0,1). */
double lum_lobe_sample(const lum_lobe_set *set, double alpha, double x);

/* The single-scattering albedo E(mu) by quadrature: what the tables hold. n: points per dimension. */
double lum_lobe_albedo(lum_lobe_kind kind, double alpha, double eta, double mu, int n);

/* GGX, isotropic, in the frame whose z axis is the normal. */

/* Smith's Lambda of a direction with cosine z and squared sine s2 = 1 - z^2. */
static inline double ggx_lambda(double alpha, double z, double s2)
{
    double z2 = z * z;
    return z2 > 0 ? 0.5 * (sqrt(1 + alpha * alpha * s2 / z2) - 1) : (double)INFINITY;
}

/* D(m); the sum is of positive terms, so that narrow lobes keep their precision. */
static inline double ggx_d(double alpha, lmg_vec3 m)
{
    double a2 = alpha * alpha, e = a2 * m.z * m.z + m.x * m.x + m.y * m.y;
    return a2 / (LUM_PI * e * e);
}

/* A facet normal seen from (s, 0, c), c > 0, distributed as its visible normals [heitz2018vndf], by spherical caps [dupuy2023caps].
 */
static inline lmg_vec3 ggx_sample_visible(double alpha, double s, double c, double x, double y)
{
    double vx = alpha * s, inverse = 1 / sqrt(vx * vx + c * c), vz = c * inverse;
    double si, co, z = (1 - y) * (1 + vz) - vz;
    double r2 = (1 - z) * (1 + z), r = sqrt(r2 > 0 ? r2 : 0);
    sincos_turns(x, &si, &co);
    return vec_unit(vec(alpha * (r * co + vx * inverse), alpha * r * si, z + vz + 0x1p-60 /* never the zero vector */));
}

#endif
