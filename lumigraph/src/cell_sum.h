/* SPDX-License-Identifier: Apache-2.0 */
/* Integrals over a field as sums over its cells, with the standard error that comes from the cells', for ask.c. */
#ifndef LUMIGRAPH_CELL_SUM_H
#define LUMIGRAPH_CELL_SUM_H

#include "sampler.h"

/* How much of a cell an integral has taken: weights w summed over places of the cell, w x shape, and w x place. */
typedef struct lmg_cell_share {
    uint64_t key; /* cell + 1; 0 = free */
    double weight, shaped, moment[4];
} lmg_cell_share;

/* Summed per cell, so that the standard error counts each cell once.  Open addressing, grows by doubling.  Zeroed to begin with. */
typedef struct lmg_cell_sum {
    lmg_cell_share *table;
    uint32_t *used; /* places taken, in order of arrival, so that sums don't depend on the table's size */
    size_t room, count;
    bool errors;    /* wanted */
} lmg_cell_sum;

/* Adds a place of slab j with a weight; false: no memory. */
bool lmg_cell_sum_add(lmg_cell_sum *sum, const lmg_field *field, uint32_t j, const lmg_place *place, double weight);

/* Adds what has been gathered of slab j to rgb and to the variance of the luminance, and empties the table. */
void lmg_cell_sum_flush(lmg_cell_sum *sum, const lmg_field *field, uint32_t j, double rgb[3], double *variance);

void lmg_cell_sum_free(lmg_cell_sum *sum);

#endif
