/* SPDX-License-Identifier: Apache-2.0 */
/* The cells of many rays at once, in columns: the arithmetic of geometry.h, and so the same bits, without a branch per ray. */
#ifndef LUMIGRAPH_PLACE_H
#define LUMIGRAPH_PLACE_H

#include "geometry.h"

enum { LMG_COLUMN = 128 };

/* Number of a cell that isn't. */
#define LMG_NO_CELL UINT64_MAX

typedef struct lmg_ray_columns {
    double origin[3][LMG_COLUMN], direction[3][LMG_COLUMN];
} lmg_ray_columns;

/* Numbers, over all slabs of the layout, of the cells of `count` (at most LMG_COLUMN) rays: what lmg_plan_owner and lmg_plan_cell
 * say, or LMG_NO_CELL.  Rays may hold anything; what isn't finite has no meaningful cell, but a valid one or none. */
void lmg_plan_place(const lmg_plan *plan, size_t count, const lmg_ray_columns *rays, uint64_t cell[LMG_COLUMN]);

#endif
