/* SPDX-License-Identifier: Apache-2.0 */
/* The error that a layout's cells alone put into illuminance, for the files of this library only. */
#ifndef LUMIGRAPH_BLUR_H
#define LUMIGRAPH_BLUR_H

#include "pilot.h"

/* Planes at these distances, in sizes, and their pixels each way. */
enum { PLANES = 4, PIXELS = 24 };

/* Rays of half A's and half B's planes. */
typedef struct lmg_planes {
    lmg_vec3 a, b, n;
    double start;              /* along n: where the light's box ends */
    double ca, cb;             /* centre */
    double reach[PLANES], half[PLANES];
    double energy[PLANES];
    int16_t (*pixel)[PLANES];  /* of each ray as it is; -1 outside */
    float (*change)[2][PIXELS * PIXELS];
    float (*variance)[2][PIXELS * PIXELS]; /* of change */
} lmg_planes;

/* Planes across direction class c; on failure (no memory) what is there is still to be destroyed. */
bool lmg_planes_create(lmg_planes *p, const lmg_pilot *pl, int c);
void lmg_planes_destroy(lmg_planes *p);

/* A squared relative error, with the standard error of its estimate. */
typedef struct lmg_verdict {
    double error, se;
} lmg_verdict;

/* Whether x is below gain x than, by three standard errors. */
bool lmg_better(lmg_verdict x, lmg_verdict than, double gain);

/* Mean squared relative error of illuminance over the planes that the slabs' cells cause; class >= 0: by rays of that class only (but
 * relative to all light on the planes). */
lmg_verdict lmg_measure_blur(const lmg_pilot *pl, lmg_planes *p, const lmg_slab *slabs, uint32_t slab_count, int class);

#endif
