/* SPDX-License-Identifier: Apache-2.0 */
/* What asking a field needs besides its cells, for sample.c and ask.c. */
#ifndef LUMIGRAPH_SAMPLER_H
#define LUMIGRAPH_SAMPLER_H

#include "etendue.h"
#include "field.h"
#include "geometry.h"

struct lmg_sampler {
    lmg_plan plan;
    lmg_etendue etendue[LMG_MAX_SLABS];
    /* Emission: running sum of flux over rows of cells, over all slabs in order.  A row is the cells that differ in s only, or a single
     * cell where the etendue of cells is costly (row_length 1). */
    double *rows;
    uint64_t row_count;
    uint64_t first_row[LMG_MAX_SLABS + 1];
    uint32_t row_length[LMG_MAX_SLABS];
};

/* Luminance of a cell. */
static inline double lmg_cell_luminance(const lmg_field *field, uint32_t j, uint64_t cell)
{
    const float *r = field->slabs[j].radiance;
    return field->layout.channels == 1 ? (double)r[cell] : lmg_luminance(&r[3 * cell]);
}

/* R,G,B of a cell. */
static inline void lmg_cell_rgb(const lmg_field *field, uint32_t j, uint64_t cell, float rgb[3])
{
    const float *r = field->slabs[j].radiance;
    for (int c = 0; c < 3; c++)
        rgb[c] = field->layout.channels == 1 ? r[cell] * field->layout.colour[c] : r[3 * cell + (uint64_t)c];
}

#endif
