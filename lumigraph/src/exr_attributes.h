/* SPDX-License-Identifier: Apache-2.0 */
/* The headers of a box file: what of a field isn't cells, as EXR attributes.  For the files of this library only. */
#ifndef LUMIGRAPH_EXR_ATTRIBUTES_H
#define LUMIGRAPH_EXR_ATTRIBUTES_H

#include "exr_stream.h"
#include "box_content.h"

/* The layout from the headers, checked by lmg_layout_check and against the sizes of the pictures, and the format's version. */
lmg_result lmg_exr_read_layout(lmg_exr_file *file, lmg_layout *layout, int32_t *version, lmg_error *err);

/* Of rounded cells, the units of the slabs, finite and positive, and what rounding lost. */
lmg_result lmg_exr_read_units(lmg_exr_file *file, uint32_t slabs, double units[LMG_MAX_SLABS], lmg_rounding *rounding, lmg_error *err);

/* The content hash that the file says it has. */
lmg_result lmg_exr_read_hash(lmg_exr_file *file, uint64_t *hash, lmg_error *err);

/* The ledger and the texts, into the field. */
lmg_result lmg_exr_read_records(lmg_exr_file *file, lmg_field *field, lmg_error *err);

/* Adds a part for every slab of the field, sets all attributes and writes the headers. */
lmg_result lmg_exr_write_header(lmg_exr_file *file, const lmg_tiles *tiles, exr_compression_t compression, uint64_t hash,
                                lmg_error *err);

#endif
