/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What every picture in OpenEXR needs: float channels of one part in scan lines, through OpenEXRCore.  Who calls adds and reads the
 * attributes of its own.  Box files aren't pictures: lumigraph has them.
 */
#ifndef LUMINAIRES_SCANLINES_H
#define LUMINAIRES_SCANLINES_H

#include <lumigraph/lumigraph.h>

#include <openexr.h>

/* One channel in memory, borrowed: its values are `stride` floats apart, rows without gaps, top row first. */
typedef struct lum_channel {
    const char *name;
    float *values;
    uint32_t stride;
} lum_channel;

/* Settings for a context that prints nothing and refuses pictures wider or higher than max_side. */
exr_context_initializer_t lum_scanlines_settings(uint32_t max_side);

/* Adds the only part of a new file, with the size, ZIP compression and the channels, to which attributes can be added still. */
exr_result_t lum_scanlines_add_part(exr_context_t file, const char *name, uint32_t width, uint32_t height,
                                    const lum_channel *channels, uint32_t count);

/* Writes all rows after exr_write_header; the channels are those of lum_scanlines_add_part. */
exr_result_t lum_scanlines_write(exr_context_t file, uint32_t width, uint32_t height, const lum_channel *channels, uint32_t count);

/* Opens a file for reading, untrusted: one part of scan lines, 1 to max_side pixels a side.  *file is NULL unless LMG_OK, else the
 * caller finishes it.  Errors: LMG_ERROR_FILE_OPEN, LMG_ERROR_FILE_FORMAT. */
lmg_result lum_scanlines_open(const char *path, uint32_t max_side, exr_context_t *file, uint32_t *width, uint32_t *height,
                              lmg_error *err);

/* Whether an opened file has a channel of that name, one value per pixel. */
bool lum_scanlines_has(exr_context_t file, const char *name);

/* Reads all rows of an opened file into those of the channels that it has.  Errors: LMG_ERROR_FILE_READ, naming path. */
lmg_result lum_scanlines_read(exr_context_t file, const char *path, uint32_t width, uint32_t height, const lum_channel *channels,
                              uint32_t count, lmg_error *err);

#endif
