/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Samples of scattering against its densities, for tests: chi-square of directions, means of weights against quadrature, the
 * integral of the density.  Densities are integrated on two polar grids, one about the mirror direction for the side of the light,
 * one about the refracted direction for the other side, with rings that follow the width of the lobe; odd numbers of cells, so that
 * their edges avoid symmetry planes.
 */
#ifndef TESTS_SCATTER_COMPARE_H
#define TESTS_SCATTER_COMPARE_H

#include "../unit/make_model.h"
#include "stats.h"

#include <math.h>

#define PI 3.14159265358979323846

enum { RINGS = 41, SECTORS = 17, HALF = RINGS * SECTORS, CELLS = 2 * HALF, FINE = 3, EDGE = 6 };

/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SAMPLES = 5000, EVERY = 13 };
#else
enum { SAMPLES = 200000, EVERY = 1 }; /* enough to see a lobe that is one degree off: mutants_are_rejected */
#endif

static inline lmg_vec3 v3(double x, double y, double z)
{
    lmg_vec3 r = {x, y, z};
    return r;
}

static inline double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline lmg_vec3 unit(lmg_vec3 a)
{
    double l = sqrt(dot(a, a));
    return v3(a.x / l, a.y / l, a.z / l);
}

/* A polar grid: rings at theta = pi (e^(g x) - 1) / (e^g - 1), x = i / RINGS; g makes the first ring a fraction of the lobe's
 * width. */
typedef struct grid {
    lmg_vec3 x, y, z;
    double g;
} grid;

grid grid_about(lmg_vec3 axis, double width);
double ring_angle(const grid *g, double x);
lmg_vec3 direction(const grid *g, double theta, double phi);

typedef struct integrals {
    double pdf[CELLS];
    double p[3], total;
} integrals;

void integrate(const lum_surface *s, lmg_vec3 wi, float eta, const grid grids[2], int fine, integrals *out);

typedef struct sampled {
    double counts[CELLS + 1]; /* the last: delta, and absorbed */
    stats_mean weight[3];     /* of what isn't delta */
    double all[3];            /* mean weight of everything */
    double largest;           /* weight */
    double leaks;             /* reflected below, transmitted above */
} sampled;

void draw(const lum_surface *s, lmg_vec3 wi, float eta, const grid grids[2], int samples, uint64_t seed, sampled *out);

/* Where a smooth surface with normal n (on either side) would send light. */
lmg_vec3 reflected(lmg_vec3 wi, lmg_vec3 n);

/* What interpolation and quadrature of the albedo tables may be off by (tables_are_accurate): samples follow the true albedo,
 * densities the table. */
#define TABLE 4e-4

typedef struct tally {
    int tests;
    double lowest;      /* p-value of the chi-square tests */
    double worst_total; /* |integral of the pdf + delta - 1| */
    double worst_z;     /* of the mean weights */
    char where[200];
} tally;

/* One configuration: samples against density.  Adds to the tally and prints what is off. */
void compare(const char *name, const lum_surface *s, lmg_vec3 wi, float eta, uint64_t seed, double table, tally *t);
/* Prints the tally and fails if it is worse than chance allows. */
void judge(const tally *t);

#endif
