/* SPDX-License-Identifier: Apache-2.0 */
/* Radiance gathered by rays traced backwards, for reconstruct.c. */
#ifndef LUMIGRAPH_GATHER_H
#define LUMIGRAPH_GATHER_H

#include <lumigraph/lumigraph.h>

/* Counts of a cell, in lumens. */
typedef struct lmg_cell_flux {
    double a[3], b[3], variance;
} lmg_cell_flux;

/* The number over all slabs of gathered cell i, and back: the number of cells if it isn't gathered. */
uint64_t lmg_gathering_cell(const lmg_gathering *g, size_t i);
size_t lmg_gathering_find(const lmg_gathering *g, uint64_t cell);

/* Combines what was gathered of cell i with what the photons say.  etendue: the cell's own; lumens: per unit. */
void lmg_gathering_combine(const lmg_gathering *g, size_t i, double etendue, double lumens, lmg_cell_flux *flux);

#endif
