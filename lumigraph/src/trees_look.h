/* SPDX-License-Identifier: Apache-2.0 */
/* Looks, for the files of this library only: trees_look.c draws them, trees_refine.c grows trees of them. */
#ifndef LUMIGRAPH_TREES_LOOK_H
#define LUMIGRAPH_TREES_LOOK_H

#include "trees.h"

typedef struct lmg_look {
    float at[4]; /* in its root */
    float luminance;
    float weight; /* etendue, m2 sr; 0: the ray is another root's */
} lmg_look;

struct lmg_looks {
    const lmg_field *field;
    const lmg_trees *trees; /* the field's, which looks refine once */
    lmg_look_kind kind;
    uint64_t seed;
    size_t count;
    lmg_look *look;
    uint8_t *root;
    double *etendue[LMG_MOST_TREES]; /* of each leaf, by node */
    double *density[LMG_MOST_TREES]; /* looks per unit of etendue that are drawn from each leaf, by node */
    uint32_t *leaf[LMG_MOST_TREES];  /* nodes that are leaves */
    double *until[LMG_MOST_TREES];   /* looks that are drawn from a tree's leaves up to each of these */
};

#endif
