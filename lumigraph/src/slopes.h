/* SPDX-License-Identifier: Apache-2.0 */
/*
 * How radiance varies within cells, for the files of this library only.
 *
 * A cell's number is a mean over its rays.  Taken as constant within the cell it makes a staircase of any smooth light: the intensity of
 * a small sphere, of which every direction sees another part of the cells, is off by two percent at the cells' borders.  So radiance is
 * linear within a cell,
 *     L = mean (1 + gu x + gv y) (1 + gs (z - mz) + gt (w - mw)),
 * x, y, z, w in [-1,1] across the cell in u, v, s, t, and (mz, mw) the cell's centroid in etendue (0 for aperture slabs, whose etendue is
 * uniform).  The mean over the cell's etendue is the cell's number whatever the slopes, so no flux moves.  Slopes are differences of the
 * neighbours' numbers (the finite-volume reconstruction of [vanleer1979towards]), shrunk by what of them is noise [james1961], so the file needs
 * nothing for them; they are limited only so far that radiance stays positive: a stricter limiter would cut into what is light.
 */
#ifndef LUMIGRAPH_SLOPES_H
#define LUMIGRAPH_SLOPES_H

#include "etendue.h"
#include "field.h"
#include "geometry.h"

#include <string.h>

/* Of one slab; the slopes themselves are in its cells. */
typedef struct lmg_slopes {
    uint16_t (*lit)[4];   /* for each (u,v) cell the (s,t) cells that carry light are within: first and last is, first and last it;
                             first > last: none */
    float (*centroid)[2]; /* of each (s,t) cell, index it * ns + is, in its own [-1,1]; NULL: (0,0) */
} lmg_slopes;

/* Finds the slopes of slab e->index of a field whose cells are final, e's shares being known.  Cells stay constant that aren't
 * wholly the slab's own, whose own part has another mean, and so do all cells of slabs with a second plane at a finite distance. */
lmg_result lmg_slopes_create(lmg_slopes *slopes, lmg_field *field, const lmg_etendue *e, lmg_error *err);
void lmg_slopes_destroy(lmg_slopes *slopes);
size_t lmg_slopes_memory(const lmg_slopes *slopes, const lmg_slab *slab);

/*
 * How a cell's slope along one axis comes about: half the difference of two cells over their distance in cells, 1 or 2: the neighbours,
 * or at an end, where one of them is missing, the cell itself and the one two further on, which keeps the noise down.
 */
typedef struct lmg_stencil {
    int lo, hi; /* in cells along the axis, from -2 to 2; equal: no slope */
} lmg_stencil;

static inline lmg_stencil lmg_stencil_of(bool before2, bool before, bool after, bool after2)
{
    return before && after ? (lmg_stencil){-1, 1} : after ? (lmg_stencil){0, after2 ? 2 : 1} : before ? (lmg_stencil){before2 ? -2 : -1, 0} : (lmg_stencil){0, 0};
}

/* Where a ray is within the slab that owns it. */
typedef struct lmg_place {
    uint64_t cell;
    uint32_t st;  /* it * ns + is */
    lmg_float4 x; /* from -1 to 1 across the cell in u, v, s, t */
} lmg_place;

/*
 * The cells of the coordinates, as lmg_cell_of gives them, and where they are within.  uvst has to be numbers that the compiler knows, not
 * memory: read as a vector, what was stored number by number would have to wait in the processor until the stores are done with, and
 * with them the look-up before and its access to memory.
 */
static inline lmg_place lmg_plan_place(const lmg_plan *plan, int j, const double uvst[4])
{
    const lmg_slab *slab = &plan->layout->slabs[j];
    lmg_double4 at = {uvst[0], uvst[1], uvst[2], uvst[3]}, low, scale;
    lmg_int4 last;
    memcpy(&low, plan->low[j], sizeof low);
    memcpy(&scale, plan->scale[j], sizeof scale);
    memcpy(&last, plan->last[j], sizeof last);
    at = (at - low) * scale;
    lmg_int4 i = __builtin_convertvector(at, lmg_int4), beyond = i > last;
    i = (beyond & last) | (~beyond & i);
    lmg_place p = {.x = __builtin_convertvector(2 * (at - __builtin_convertvector(i, lmg_double4)) - 1, lmg_float4)};
    p.st = (uint32_t)i[3] * slab->ns + (uint32_t)i[2];
    p.cell = ((uint64_t)i[1] * slab->nu + (uint64_t)i[0]) * ((uint64_t)slab->ns * slab->nt) + p.st;
    return p;
}

/* Radiance at a place over the mean of its cell, whose slopes are g: positive, at most 4. */
static inline float lmg_shape(const lmg_slopes *slopes, const int8_t g[4], const lmg_place *p)
{
    static const float UNIT = 1.0F / 127;
    typedef int8_t bytes __attribute__((vector_size(4)));
    bytes b;
    memcpy(&b, g, sizeof b);
    lmg_float4 f = p->x;
    if (slopes->centroid)
        f -= (lmg_float4){0, 0, slopes->centroid[p->st][0], slopes->centroid[p->st][1]};
    f *= __builtin_convertvector(b, lmg_float4);
    return (1 + UNIT * (f[0] + f[1])) * (1 + UNIT * (f[2] + f[3]));
}

#endif
