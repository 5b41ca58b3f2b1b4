/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A far-field goniophotometer: a sink that turns rays into a luminous intensity distribution on a grid of C and gamma.
 *
 * The distribution is the piecewise bilinear function on the grid that is nearest (least squares over the sphere) to the light that
 * arrived: each ray goes to its four nodes with the weights of linear interpolation, and at the end the overlap of the nodes is
 * solved for.  Interpolated between its nodes the result has exactly the flux of the rays, and for a distribution that is linear
 * between the nodes its expectation is that distribution: reading, tracing and writing a photometric file on its own grid adds no
 * blur.
 */
#ifndef BAKER_GONIOMETER_H
#define BAKER_GONIOMETER_H

#include <luminaires/photometry.h>

typedef struct bake_goniometer_options {
    uint32_t planes;                 /* C planes at equal steps, 4..720 and a multiple of 4; 0 = 72 */
    uint32_t angles;                 /* gamma angles at equal steps over 0..180, 7..1441; 0 = 73 */
    lum_symmetry symmetry;           /* imposed by taking the mean of mirror images (of type C) */
    lmg_vec3 bounds_min, bounds_max; /* of the luminaire: its luminous shape in the result; equal = a point */
} bake_goniometer_options;

typedef struct bake_goniometer bake_goniometer;

/* Errors: LMG_ERROR_ARGUMENT for a grid outside these ranges. */
lmg_result bake_goniometer_create(const bake_goniometer_options *options, bake_goniometer **out, lmg_error *err);
void bake_goniometer_destroy(bake_goniometer *g);

/* Any number of threads at once; sums are 64-bit fixed point, so the reading is the same bits for any order.  Rays without a finite
 * direction or flux, or with negative flux, don't count. */
lmg_sink bake_goniometer_sink(bake_goniometer *g);

/*
 * The distribution, and the standard errors of its intensities (cd, same layout; *standard_errors to be freed, may be NULL).  Each
 * is for a distribution that changes little between neighbouring nodes.  Where noise would make an intensity negative it is 0, and
 * the rest is scaled so that the flux stays.  Errors: LMG_ERROR_INPUT when no light arrived.
 */
lmg_result bake_goniometer_read(const bake_goniometer *g, double lumens_per_unit, lum_photometry **out, double **standard_errors,
                                lmg_error *err);

#endif
