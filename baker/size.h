/* SPDX-License-Identifier: Apache-2.0 */
/*
 * How many cells a box file of a given size holds, from the pilot's rays.
 *
 * What a cell takes in a file depends on how many photons it gets, not on how small it is.  So a box of C cells and n photons is
 * foretold by one of fewer cells, C m / n, that the m photons of the pilot fill as densely: it is made, rounded and written.  A
 * second one of a quarter of these rays and cells tells how bytes grow with cells at that density: less than they, where light has
 * edges that finer cells leave fewer dark cells around.
 */
#ifndef BAKER_SIZE_H
#define BAKER_SIZE_H

#include "bake.h"

typedef struct bake_size {
    uint64_t cells; /* that fit */
    double bytes;   /* that they are expected to take; 0: so few photons don't fill the size, whatever the cells */
    bool limited;   /* by the size; else by most */
} bake_size;

/* Fits a layout of at most `most` cells, whose box of `photons` photons has `bytes` or a little less; why: the fit's report.  rays:
 * those of a pilot of pilot_photons; fit: bounds and wishes, without cells.  Errors: as lmg_layout_fit and lmg_field_write (a
 * temporary file). */
lmg_result bake_size_choose(const lmg_ray *rays, size_t count, double pilot_photons, double photons, const lmg_fit_options *fit,
                            double bytes, uint64_t most, lmg_layout *layout, char why[1024], bake_size *out, lmg_error *err);

/* Bytes of a field's file, its cells rounded. */
lmg_result bake_size_of(const lmg_field *field, double *bytes, lmg_error *err);

#endif
