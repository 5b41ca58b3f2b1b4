/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Cells as half floats, for the files of this library only: format version 2 of docs/format.md.
 *
 * A cell's luminance is a multiple of its slab's unit, which is what one photon makes of a cell; its standard error is told by how
 * much a photon of this cell counts for, which is 1 wherever all are alike; half A by its relative difference; colour relative to
 * luminance.  So what has no information of its own is nearly always the same number, and packs to nothing.
 */
#ifndef LUMIGRAPH_CELL_CODE_H
#define LUMIGRAPH_CELL_CODE_H

#include "field.h"

/* A field's cells as a file holds them: of each tile its lines, of each line its channels in the order of the channel list (BY, RY
 * of three colours; Y, difference, weight), ns half floats each. */
typedef struct lmg_codes {
    double units[LMG_MAX_SLABS]; /* cd/m2 */
    uint16_t *of[LMG_MAX_SLABS];
    lmg_rounding rounding;
} lmg_codes;

/* loss: see lmg_field_write_rounded.  *possible is false, and codes is empty, when a field has cells that half floats can't tell:
 * nothing else than version 1 holds it then.  The field's sampler is needed.  codes is to be destroyed in any case. */
lmg_result lmg_codes_create(lmg_codes *codes, const lmg_field *field, double loss, bool *possible, lmg_error *err);
void lmg_codes_destroy(lmg_codes *codes);

/* cd/m2 that code 1 of channel Y means in each (s,t) cell, index it * ns + is: unit x (1 + s^2 + t^2)^2 in the middle of cells of
 * slopes, which have etendues in proportion to the inverse of that; the unit in others.  Owned by the caller; NULL: no memory. */
double *lmg_code_scales(const lmg_slab *slab, double unit);

/* Decodes one line of a tile as it lies in a file, n cells; scales: of its first cell on; radiance: channels + 1 floats apart, as in
 * lmg_slab_data.  False when a code can't be. */
bool lmg_decode_line(const unsigned char *line, uint32_t n, uint32_t channels, const double *scales, float *radiance,
                     float *standard_error, float *half_a);

#endif
