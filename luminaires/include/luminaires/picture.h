/* SPDX-License-Identifier: Apache-2.0 */
/* Pictures of luminance in OpenEXR files: one part of scan lines, channels R, G, B (linear Rec.709) or Y alone. */
#ifndef LUMINAIRES_PICTURE_H
#define LUMINAIRES_PICTURE_H

#include <lumigraph/lumigraph.h>

enum { LUM_PICTURE_MAX_SIDE = 16384 };

typedef struct lum_picture {
    uint32_t width, height;
    bool colour;    /* false: R = G = B, written as Y alone */
    float *rgb;     /* 3 width height, top row first */
} lum_picture;

/* All zeros. */
lmg_result lum_picture_create(uint32_t width, uint32_t height, lum_picture *out, lmg_error *err);
void lum_picture_free(lum_picture *picture);

/* Writes path as it goes: into a place that isn't the final one yet. */
lmg_result lum_picture_write(const lum_picture *picture, const char *path, lmg_error *err);

/* Reads a picture into *picture, which is empty or of the last call (its memory is used again when the size is the same).  Files are
 * untrusted.  Errors: LMG_ERROR_FILE_OPEN, _READ, _FORMAT; values that aren't finite or are below zero in luminance are errors too. */
lmg_result lum_picture_read(const char *path, lum_picture *picture, lmg_error *err);

#endif
