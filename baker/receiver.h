/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Receivers: sinks that measure.  Illuminance on a rectangle of pixels, luminous intensity far away or on a sphere around the
 * luminaire, luminance pictures. Any source can feed them, any number of threads at once, and sums are 64-bit fixed point (2^-20 of a ray's unit), so that
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
    bool colour;          /* R,G,B sums as well */
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

/* Directions about an axis in rings x sectors: light far away (radius INFINITY), or where it passes a sphere (metres) on its way out.
 * Readings are flux per solid angle seen from the centre, cd: illuminance of the sphere times radius squared, which tends to the
 * intensity as the radius grows. */
typedef struct bake_sphere {
    lmg_vec3 centre; /* luminaire frame; counts only with a finite radius */
    double radius;
    lmg_vec3 axis; /* unit: ring 0 lies around it */
    uint32_t rings, sectors;
    bool equal_angles; /* rings of equal polar angle; false: of equal solid angle */
    bool colour;       /* R,G,B sums as well */
} bake_sphere;
lmg_result bake_sphere_create(const bake_sphere *sphere, bake_receiver **out, lmg_error *err);

/* A luminance picture from far away, as a camera with a long lens takes it: light within a cone of directions about the view, on a
 * rectangle across it.  Readings are cd/m2, a mean over the cone. */
typedef struct bake_picture {
    bake_rectangle across; /* a x b is the direction that the light travels in, towards the eye */
    double half_angle;     /* of the cone, radians, in (0, pi/2) */
} bake_picture;
lmg_result bake_picture_create(const bake_picture *picture, bake_receiver **out, lmg_error *err);

void bake_receiver_destroy(bake_receiver *receiver);
lmg_sink bake_receiver_sink(bake_receiver *receiver);

/* Number of pixels or bins; order: pixel iy * nx + ix, bin ring * sectors + sector. */
size_t bake_receiver_count(const bake_receiver *receiver);

/* Reading of one pixel (lx) or bin (cd), luminance-weighted, and its standard error (may be NULL). */
double bake_receiver_reading(const bake_receiver *receiver, size_t i, double lumens_per_unit, double *standard_error);

/* R,G,B of one pixel or bin of a receiver that was created with colour, in the unit of its readings. */
void bake_receiver_colour(const bake_receiver *receiver, size_t i, double lumens_per_unit, double rgb[3]);
bool bake_receiver_has_colour(const bake_receiver *receiver);
/* The direction at polar angle theta and azimuth phi (radians, -pi .. pi) of a sphere's bins: ring i covers theta in its i-th part,
 * sector j phi in its j-th part from -pi on. */
lmg_vec3 bake_receiver_direction(const bake_receiver *receiver, double theta, double phi);
/* Solid angle of one bin of a sphere, sr. */
double bake_receiver_solid_angle(const bake_receiver *receiver, size_t i);

/* Relative noise over all pixels: RMS standard error / RMS reading, the reading's own noise taken out.  INFINITY when noise is all.
 */
double bake_receiver_noise(const bake_receiver *receiver);

#endif
