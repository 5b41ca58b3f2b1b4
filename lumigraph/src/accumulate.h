/* SPDX-License-Identifier: Apache-2.0 */
/* The inside of an accumulator, for reconstruct.c. */
#ifndef LUMIGRAPH_ACCUMULATE_H
#define LUMIGRAPH_ACCUMULATE_H

#include "geometry.h"

#include <stdatomic.h>

/*
 * Fixed point.  Flux: 2^-20 of a unit, signed (components of colours outside the gamut are negative), so 2^43 = 8.8e12 units fit a word.
 * Squares of luminance: 2^-12 unit^2, unsigned, so the sum of squares may reach 2^52 = 4.5e15: 10^11 rays of RMS weight 200.  A ray of
 * more than 2^24 units is refused, because its square alone would come near that.
 */
#define LMG_FLUX_ONE 1048576.0
#define LMG_SQUARE_ONE 4096.0
#define LMG_MAX_RAY_FLUX 16777216.0

/*
 * A cell is a group of words within one cache line.
 * One channel, 4 words: luminance of half A, of half B, sum of squares, unused (keeps cells from straddling lines).
 * Three channels, 8 words: R,G,B of half A, R,G,B of half B, sum of squares, unused.
 */
static inline uint32_t lmg_cell_words(uint32_t channels)
{
    return channels == 1 ? 4 : 8;
}

struct lmg_accumulator {
    lmg_layout layout;
    lmg_plan plan;
    _Atomic uint64_t *words;
    size_t bytes;
    /* totals, fixed point as above, per channel */
    _Atomic uint64_t rays, refused, unplaced;
    _Atomic uint64_t stored[3], residual[3], residual_squares;
};

#endif
