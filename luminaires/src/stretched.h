/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Where the light goes that one reflection on stretched facets (brushed metal, GGX widths ax > ay) doesn't let get away.
 *
 * As on isotropic facets (microfacet.h) the share 1 - E(wi) leaves with the density
 *     p(wo) = (1 - E(wo)) mu_o / (pi (1 - E_avg)),   1 - E_avg = integral of (1 - E) mu dw / pi,
 * E now of the direction, not of its cosine alone: reciprocal, and no light is lost.  Sampling needs no E: of light that arrives
 * from all around, what its first facet loses is distributed as p, so a direction drawn in proportion to its cosine is taken if a
 * facet seen from there loses its light.  Under diffuse light that takes one trial on average.
 *
 * For densities, E is tabulated over the direction as stretched facets see it, v = (ax x, ay y, z) / B: in it, E is smooth whatever
 * the widths, up to the limits of one width or both going to 0.
 */
#ifndef LUMINAIRES_STRETCHED_H
#define LUMINAIRES_STRETCHED_H

#include "microfacet.h"

enum {
    LUM_STRETCHED_HEIGHTS = 49,   /* over sqrt(v.z) */
    LUM_STRETCHED_AZIMUTHS = 9,   /* over a quarter turn of v */
    LUM_STRETCHED_ROUGHNESSES = 9 /* if they vary: over roughness, and over the strength of the anisotropy */
};

/* 1 - E and 1 - E_avg of one pair of widths. */
typedef struct lum_stretched {
    float rest[LUM_STRETCHED_HEIGHTS][LUM_STRETCHED_AZIMUTHS];
    float total;
} lum_stretched;

/* By roughness (sqrt of alpha across) and strength (alpha along = across + (1 - across) strength^2), [0,1] each; one element of
 * what is constant. */
typedef struct lum_stretched_set {
    float roughness, strength; /* -1: varies */
    int roughnesses, strengths;
    lum_stretched sets[]; /* [roughness][strength] */
} lum_stretched_set;

/* The set for these, made if it isn't there yet; NULL and *failed without memory.  -1: varies. */
const lum_stretched_set *lum_stretched_find(lum_table_store *store, float roughness, float strength, bool *failed);
/* 1 - E of the facets' wi; *total: 1 - E_avg. */
double lum_stretched_rest(const lum_stretched_set *set, const facets *f, double *total);

#endif
