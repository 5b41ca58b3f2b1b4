/* SPDX-License-Identifier: Apache-2.0 */
/* What a box file holds, in which order and within which limits, whatever it is packed in; for the files of this library only. */
#ifndef LUMIGRAPH_BOX_CONTENT_H
#define LUMIGRAPH_BOX_CONTENT_H

#include "field.h"

#include <stdbool.h>

/* The formats that docs/format.md describes: cells to the bit; cells rounded (cell_code.h). */
enum { LMG_BOX_EXACT = 1, LMG_BOX_ROUNDED = 2 };

/* The ten numbers of the ledger in the order of the file and the hash. */
enum { LMG_LEDGER_ENTRIES = 5 };
extern const char *const lmg_ledger_names[LMG_LEDGER_ENTRIES]; /* of their attributes */
void lmg_ledger_get(const lmg_ledger *l, double values[LMG_LEDGER_ENTRIES][2]);
void lmg_ledger_set(lmg_ledger *l, const double values[LMG_LEDGER_ENTRIES][2]);

/* All tiles of a field in the order of the file: slab by slab, iv by iv, iu by iu.  Work is shared out in runs of tiles: one tile
 * of 16 x 16 cells is too little to hand around. */
typedef struct lmg_tiles {
    const lmg_layout *layout;
    const lmg_field *field;
    uint64_t start[LMG_MAX_SLABS + 1]; /* number of tiles before each slab */
    uint64_t run;                      /* tiles per piece of work */
    uint64_t first, end;               /* tiles that the work is about */
    uint64_t *hashes;                  /* one per tile */
    const double *units;               /* of rounded cells, one per slab; NULL: cells to the bit */
    lmg_rounding rounding;             /* of these */
} lmg_tiles;

/* At least this much data to a piece of work, so that handing it out costs nothing beside it. */
enum { LMG_RUN_BYTES = 128 << 10 };

static inline uint64_t lmg_tile_cells(const lmg_slab *slab)
{
    return (uint64_t)slab->ns * slab->nt;
}

/* All tiles of the layout, without field and hashes, which are the caller's to set. */
void lmg_tiles_init(lmg_tiles *t, const lmg_layout *layout);

/* The slab of a tile of the field. */
uint32_t lmg_tile_slab(const lmg_tiles *t, uint64_t tile);

/* Every number of a tile is finite and standard errors aren't negative: what the readers of a field rely on. */
bool lmg_tile_is_sound(const lmg_tiles *t, uint32_t slab, uint64_t tile_in_slab);

/* What isn't a matter of one cell: checked before writing and after reading, so that what is written can be read.  Fails with code;
 * where is the file's name as messages show it. */
lmg_result lmg_box_check(const lmg_field *field, const char *where, lmg_result code, lmg_error *err);

#endif
