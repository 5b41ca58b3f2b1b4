/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Pictures in files: OpenEXR with R, G, B (linear Rec.709, cd/m2) and "stderr.Y" (standard error of the luminance), and 8-bit PNG.
 * Files are written beside their final name and renamed, so that a name never holds half a picture.
 */
#ifndef VIEWER_IMAGE_IO_H
#define VIEWER_IMAGE_IO_H

#include "render.h"

/* What goes with a picture, kept as attributes of the EXR file. */
typedef struct view_image_notes {
    uint32_t samples;    /* per pixel (the fewest); attribute "spp" */
    double seconds;      /* "renderSeconds" */
    uint64_t seed;       /* "seed", as text */
    double mid_grey;     /* exposure that goes with the picture, cd/m2: "midGrey"; 0 = none */
    const char *command; /* "command"; NULL = none */
} view_image_notes;

lmg_result view_write_exr(const view_image *image, const view_image_notes *notes, const char *path, lmg_error *err);

/* Reads a picture (scan lines; R, G, B; stderr.Y if there is one, else NAN).  notes may be NULL; its command is NULL on return.
 * Files are untrusted: errors are LMG_ERROR_FILE_OPEN, _READ and _FORMAT, and nothing is allocated beyond VIEW_MAX_SIDE squared. */
lmg_result view_read_exr(const char *path, view_image *out, view_image_notes *notes, lmg_error *err);

/* 8-bit sRGB, 3 bytes per pixel. */
lmg_result view_write_png(const uint8_t *bytes, uint32_t width, uint32_t height, const char *path, lmg_error *err);

#endif
