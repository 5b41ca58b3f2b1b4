/* SPDX-License-Identifier: Apache-2.0 */
/*
 * For the tests of radiance trees: a lamp that is a formula, trees of it, and what they say.  The lamp is a Lambertian disc in the
 * plane z = 0, facing +Z, whose light ends sharply at 20 degrees, so that radiance is one number within edges in all four
 * dimensions and 0 beyond them.  What can't be made fails the test.
 */
#ifndef TESTS_TREES_FIXTURE_H
#define TESTS_TREES_FIXTURE_H

#include "lamp_fixture.h"
#include "trees.h"

#define TREES_RADIUS 0.05              /* of the disc, metres */
#define TREES_SINE 0.34202014332566873 /* of 20 degrees */

/* Bounds of the disc, metres. */
extern const lmg_vec3 TREES_LOW, TREES_HIGH;

/* Of the disc with 1 lm, cd/m2. */
double trees_disc_radiance(void);

/* From the disc and within the cone; both `wider` times as wide as its light: a uniform sample of etendue.  Its flux is 1. */
lmg_ray trees_disc_ray(lamp_rng *g, double wider);

/* The disc's rays number 0 to count-1; free() them. */
lmg_ray *trees_disc_rays(uint64_t seed, size_t count);

/* One slab over the disc made by hand, few cells; distance in metres. */
lmg_layout trees_one_slab(lmg_slab_kind kind, double distance, uint32_t channels);

/* Fitted to the first ten thousand rays, a pilot. */
lmg_layout trees_fitted(const lmg_ray *rays, lmg_fit_options wishes);

/* The rays' light, 1 lm of it; no trees. */
lmg_field *trees_field_of(const lmg_layout *layout, const lmg_ray *rays, size_t count);

/* So many trees instead of those that it has; 0: none. */
void trees_grow(lmg_field *field, const lmg_ray *rays, size_t count, uint32_t trees);

/* The disc's light, 1 lm, in one slab made by hand, with trees. */
lmg_field *trees_small_field(uint64_t seed, size_t count, uint32_t trees);

/* Looks at the disc, drawn in pieces of so many, and trees refined by them; how much of these was misplaced (lmg_looks_misplaced).
 * noise: variance of what is seen, in squares of the disc's radiance. */
double trees_refine_by(lmg_look_kind kind, lmg_field *field, size_t count, size_t piece, uint64_t seed, double noise);

/* By looks at radiance. */
void trees_refine(lmg_field *field, size_t count, size_t piece, uint64_t seed, double noise);

/* What a camera sees a little way down the ray, cd/m2; its standard error too unless NULL. */
double trees_linear(const lmg_field *field, const lmg_ray *ray, double *se);

/* What a tree holds at one root, lumens; nodes are checked on the way. */
double trees_light_of_root(const lmg_field *field, uint32_t tree, uint32_t root);

/* RMS over random rays around the light, in parts of the light's own radiance; mean well inside it, in the same parts. */
double trees_disc_error(const lmg_field *field, double *inside);

/* Fails unless both have the same bytes in files. */
void trees_same_bytes(const lmg_trees *a, const lmg_trees *b);

#endif
