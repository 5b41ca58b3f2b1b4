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
    bool inside;           /* every line of the slab passes through the bounds */
} lmg_etendue;

/* layout is borrowed until release. */
lmg_result lmg_etendue_prepare(lmg_etendue *e, const lmg_layout *layout, uint32_t slab, lmg_error *err);
void lmg_etendue_release(lmg_etendue *e);

/* Whether every cell's effective etendue is its full one. */
bool lmg_etendue_is_full(const lmg_etendue *e);

double lmg_etendue_full(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);
double lmg_etendue_effective(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);

#endif
