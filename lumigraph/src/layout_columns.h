/* SPDX-License-Identifier: Apache-2.0 */
/* Columns of rays for layout_judge.c: what their cells do to them, and where they fall. */
#ifndef LUMIGRAPH_LAYOUT_COLUMNS_H
#define LUMIGRAPH_LAYOUT_COLUMNS_H

#include "layout_judge.h"
#include "place.h"

typedef struct lmg_receiver {
    double reach;         /* of a plane; unused for directions */
    double x0, y0, scale; /* its corner, pixels per unit */
    double scale_y;
} lmg_receiver;

/* Pixels of a column of rays in all receivers; LMG_OUTSIDE of rays that one doesn't see. */
typedef uint16_t lmg_pixels[LMG_JUDGE_RECEIVERS][LMG_COLUMN];
/* The receiver of all directions has rings of equal solid angle, cut in sectors; the others are squares. */
enum {
    LMG_JUDGE_SIDE = 24,
    LMG_JUDGE_RINGS = 16,
    LMG_JUDGE_SECTORS = LMG_JUDGE_PIXELS / LMG_JUDGE_RINGS,
    LMG_OUTSIDE = LMG_JUDGE_PIXELS
};

/* Of rays in the frame of the LMG_JUDGE_RECEIVERS receivers: along a, b and n; start: where along n the light's box ends. */
void lmg_pixels_of(const lmg_receiver *receivers, double start, size_t count, const lmg_ray_columns *rays, lmg_pixels out);

/* Rays of one slab. */
typedef struct lmg_members {
    size_t count;
    uint16_t at[LMG_COLUMN];   /* in their block */
    double within[LMG_COLUMN]; /* number of the cell in its slab: up to 65535^4, of which a double has all that there are rays in */
    double jitter[4][LMG_COLUMN];
    double uvst[4][LMG_COLUMN]; /* moved */
    double inverse[LMG_COLUMN];
} lmg_members;

/* Moves rays to where their jitter says in their cells; scale: cells per unit of u,v,s,t. */
void lmg_members_move(const lmg_slab *slab, const double scale[4], lmg_members *m);

/* The moved rays along the axes a, b, n. */
void lmg_members_rays(const lmg_slab *slab, const lmg_vec3 axes[3], const lmg_members *m, lmg_ray_columns *out);

#endif
