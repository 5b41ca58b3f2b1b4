/* SPDX-License-Identifier: Apache-2.0 */
/* The search for one direction's slabs, for layout.c. */
#ifndef LUMIGRAPH_LAYOUT_SEARCH_H
#define LUMIGRAPH_LAYOUT_SEARCH_H

#include "layout_judge.h"

/* What the search decides for one direction. */
typedef struct lmg_choice {
    lmg_slab_kind kind;
    int class;
    double distance;
    double depth;          /* of the (u,v) plane along n, metres in the luminaire frame */
    double rect[4];        /* u0 u1 v0 v1 about the frame's origin */
    bool window;
    double st[4];          /* window's s0 s1 t0 t1, before alignment */
    double share;          /* of the cells, for the window */
    double bias, window_bias; /* cells of (u,v) over cells of (s,t), as a factor on each side of the square root */
    double cells;
    double flux;           /* in the rectangle, in units of the pilot */
    double spread;         /* area of the rectangle that the light would need, were it not kept within the bounds */
    const lmg_slab *focus; /* of higher priority than all of these; NULL: none */
    const uint32_t *fixed; /* resolution asked for; NULL or zeros: chosen */
    bool fewer;            /* fewer cells may be taken where photons are few */
} lmg_choice;

enum { LMG_CHOICE_SLABS = 3 };

/* The slabs of a choice: its focus and the window, if any, before the main slab.  Returns their number. */
uint32_t lmg_choice_slabs(const lmg_pilot *pl, const lmg_choice *c, lmg_slab out[LMG_CHOICE_SLABS]);

/* Everything about one direction. */
lmg_verdict lmg_choice_search(lmg_pilot *pl, lmg_judge *judge, lmg_choice *c);

/* Where much of the light that goes towards class c passes through a small place inside the bounds, such as a source that is seen
 * directly: an aperture slab on that place, with one cell.  area: of the opening that the light goes through otherwise, m2.  False: nowhere. */
bool lmg_focus_find(const lmg_pilot *pl, int c, double area, lmg_slab *out);

/* Cuts a focus in about so many cells; bias: of (u,v) over (s,t), as in a choice. */
void lmg_focus_cut(lmg_slab *focus, double cells, double bias);

#endif
