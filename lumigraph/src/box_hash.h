/* SPDX-License-Identifier: Apache-2.0 */
/* The content hash of box files (docs/format.md), for the files of this library only. */
#ifndef LUMIGRAPH_BOX_HASH_H
#define LUMIGRAPH_BOX_HASH_H

#include "box_content.h"

/* Puts the hashes of the tiles [first, after) into t->hashes. */
void lmg_hash_tiles(const lmg_tiles *t, uint64_t first, uint64_t after);

/* The same of rounded cells: of the tile's bytes before packing. */
uint64_t lmg_hash_codes(const void *codes, uint64_t count);

/* The hash of the whole field, from what isn't cells and from t->hashes, which hold every tile's. */
uint64_t lmg_hash_field(const lmg_tiles *t);

#endif
