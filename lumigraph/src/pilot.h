/* SPDX-License-Identifier: Apache-2.0 */
/* Pilot rays, as the fit of a layout sees them, for the files of this library only. */
#ifndef LUMIGRAPH_PILOT_H
#define LUMIGRAPH_PILOT_H

#include "vec.h"

typedef struct lmg_pilot {
    size_t count;
    lmg_vec3 *origin, *direction;
    double *flux;      /* luminance */
    uint8_t *class;
    bool *taken;       /* whether a focus has the ray, so that no other slab needs to be good for it */
    float (*jitter)[4];
    double *x, *w; /* scratch */
    double total;
    double photons;    /* rays that the box will be made of; 0: infinitely many */
    lmg_vec3 lo, hi;             /* the layout's bounds */
    lmg_vec3 light_lo, light_hi; /* holds 99 % of the light's origins */
    double size;                 /* of the luminous opening, for the planes */
} lmg_pilot;

/* lo and hi of a zeroed pilot are set; on failure what is there is still to be destroyed. */
lmg_result lmg_pilot_create(lmg_pilot *pl, const lmg_ray *rays, size_t count, lmg_error *err);
void lmg_pilot_destroy(lmg_pilot *pl);

/* One colour for all rays?  colour: that of the sum, at luminance 1. */
bool lmg_one_colour(const lmg_ray *rays, size_t count, float colour[3]);

/* Right-handed frame of a direction class: n along the axis, a and b the next two, b reversed for negative n so that a x b = n. */
void lmg_class_frame(int c, lmg_vec3 *a, lmg_vec3 *b, lmg_vec3 *n);
const char *lmg_class_name(int c);

/* The interval of x that leaves out a share `tail` of the weight at either end, and the outermost values. */
typedef struct lmg_interval {
    double lo, hi, least, most;
} lmg_interval;
lmg_interval lmg_quantiles(const double *x, const double *w, size_t n, double tail);

#endif
