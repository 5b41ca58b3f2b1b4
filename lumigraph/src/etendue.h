/* SPDX-License-Identifier: Apache-2.0 */
/* Etendue of many cells of one slab, for the files of this library only. */
#ifndef LUMIGRAPH_ETENDUE_H
#define LUMIGRAPH_ETENDUE_H

#include <lumigraph/lumigraph.h>

/*
 * What a slab's cells share.  A cell's *effective* etendue is that of the rays in it that can carry light of its own: owned by no slab
 * of higher priority and passing through the bounds.
 */
typedef struct lmg_etendue {
    const lmg_layout *layout;
    const lmg_slab *slab;
    uint32_t index;
    double *per_area;      /* for each (s,t) cell, index it * ns + is: etendue per unit of (u,v) area; NULL where it isn't separable */
    uint32_t higher_count; /* slabs of higher priority that own rays of this one, without those inside another such slab */
    uint8_t higher[LMG_MAX_SLABS];
    bool aligned_overlap;  /* at most one, in the same frame: overlap is a product of rectangles */
    bool directions;       /* (s,t) is the direction alone, of this slab and of those: lmg_etendue_area serves */
    bool inside;           /* every line of the slab passes through the bounds */
    /* own_etendue.c's: points by which cells are integrated, and what lmg_etendue_share has found */
    int directions_s, directions_t, points, strips;
    float *share;          /* effective over full etendue of each cell, below 0: not known; NULL: none asked for */
    size_t share_bytes;
} lmg_etendue;

/* Limits of a cell. */
typedef struct lmg_cell_box {
    double u0, u1, v0, v1, s0, s1, t0, t1;
} lmg_cell_box;
lmg_cell_box lmg_cell_limits(const lmg_slab *slab, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);
/* Full etendue of any box of a slab's rays. */
double lmg_box_etendue(const lmg_slab *slab, const lmg_cell_box *c);

/* layout is borrowed until release. */
lmg_result lmg_etendue_prepare(lmg_etendue *e, const lmg_layout *layout, uint32_t slab, lmg_error *err);
void lmg_etendue_release(lmg_etendue *e);

/* Whether every cell's effective etendue is its full one. */
bool lmg_etendue_is_full(const lmg_etendue *e);

/* Fixes how many points cells are integrated by, for the slab's number of cells; part of lmg_etendue_prepare. */
void lmg_own_etendue_plan(lmg_etendue *e);

/* Finds the effective etendue of all cells at once, on all processors, where that isn't a product or the full one: many times faster than
 * one by one.  Of cells that are cut only the wanted ones are integrated.  forget gives the memory back: a float for each cell. */
lmg_result lmg_etendue_share(lmg_etendue *e, bool (*wanted)(const void *self, uint64_t cell), const void *self, lmg_error *err);
void lmg_etendue_forget_share(lmg_etendue *e);

double lmg_etendue_full(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);
double lmg_etendue_effective(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);

/* Part of a (u,v) rectangle, m2, whose lines of direction d are the slab's own and pass through the bounds; only if e->directions.
 * middle: (u,v) of a point whose line passes through the bounds, if the part isn't empty. */
double lmg_etendue_area(const lmg_etendue *e, double u0, double u1, double v0, double v1, lmg_vec3 d, double middle[2]);

#endif
