/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Receivers: sinks that measure.  Illuminance on a rectangle of pixels, and luminous intensity far away in bins of equal solid
 * angle. Any source can feed them, any number of threads at once, and sums are 64-bit fixed point (2^-20 of a ray's unit), so that
 * the reading is the same for any order.  Readings come with a standard error: the number of rays in a pixel follows Poisson's law,
 * so the variance of its sum is the sum of the squares.
 */
#ifndef BAKER_RECEIVER_H
#define BAKER_RECEIVER_H

#include <lumigraph/lumigraph.h>

/* A rectangle that light falls on: orthonormal a and b along its sides, light counts when it travels along +(a x b). */
typedef struct bake_rectangle {
    lmg_vec3 centre; /* luminaire frame, metres */
    lmg_vec3 a, b;
    double width, height; /* along a and b, metres */
    uint32_t nx, ny;      /* pixels along a and b */
} bake_rectangle;

/* The measuring rectangle of the near-field comparisons: perpendicular to axis (a unit vector along +-x, +-y or +-z), `distance`
 * beyond the face of the bounds, centred on them, square with side 2 distance + size. */
bake_rectangle bake_measuring_rectangle(lmg_vec3 bounds_min, lmg_vec3 bounds_max, lmg_vec3 axis, double size, double distance,
                                        uint32_t pixels);

/* The axis (+-x, +-y, +-z) nearest to the mean direction of the rays' light; -y (down) for a source that shines to all sides alike:
 * a mean of less than a tenth of the light's own length. */
lmg_vec3 bake_main_axis(const lmg_ray *rays, size_t count);

typedef struct bake_receiver bake_receiver;

lmg_result bake_illuminance_create(const bake_rectangle *rectangle, bake_receiver **out, lmg_error *err);

/* Far field: rings of equal solid angle about axis, each cut in sectors; rings x sectors bins of 4 pi / (rings sectors) steradians.
 */
lmg_result bake_far_field_create(lmg_vec3 axis, uint32_t rings, uint32_t sectors, bake_receiver **out, lmg_error *err);

void bake_receiver_destroy(bake_receiver *receiver);
lmg_sink bake_receiver_sink(bake_receiver *receiver);

/* Number of pixels or bins; order: pixel iy * nx + ix, bin ring * sectors + sector. */
size_t bake_receiver_count(const bake_receiver *receiver);

/* Reading of one pixel (lx) or bin (cd), luminance-weighted, and its standard error (may be NULL). */
double bake_receiver_reading(const bake_receiver *receiver, size_t i, double lumens_per_unit, double *standard_error);

/* Relative noise over all pixels: RMS standard error / RMS reading, the reading's own noise taken out.  INFINITY when noise is all.
 */
double bake_receiver_noise(const bake_receiver *receiver);

#endif
