/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Near-field goniometer pictures: what an imaging goniophotometer measures.  A camera of known optics goes round the luminaire on a
 * sphere and takes a luminance picture in every direction; together they are the light field.  A set is a folder of OpenEXR pictures
 * with index.json (docs/rayfiles.md).  Written: by a virtual goniophotometer in the light of a box.  Read: as a source of rays.
 *
 * With a camera at distance d, dA = d^2 dOmega of its sphere, a pixel of solid angle dw seen under the angle alpha to the camera's
 * axis has the etendue dA cos(alpha) dw: flux = sum of luminance x etendue over all pixels, whatever the luminaire's shape.
 */
#ifndef BAKER_PICTURE_SET_H
#define BAKER_PICTURE_SET_H

#include "source.h"

#include <signal.h>

typedef struct bake_picture_set_options {
    double distance;                   /* of the camera's pupil from the luminaire's centre, metres, beyond its bounds; 0 = 4 radii */
    double step;                       /* of theta and phi, degrees, a divisor of 180; 0 = 5 */
    uint32_t pixels;                   /* width and height of a picture; 0 = 64 */
    unsigned threads;                  /* 0 = all cores */
    bool radiant;                      /* the box's "lumens" are watts */
    const char *origin;                /* what the light is of, for the index; NULL = not told */
    const volatile sig_atomic_t *stop; /* when it becomes non-zero, writing ends with LMG_ERROR_INTERNAL; NULL = never */
} bake_picture_set_options;

typedef struct bake_picture_set_report {
    uint32_t pictures, dark; /* in all; without light, for which no file is written */
    double flux;             /* that the pictures add up to, lumens or watts */
    uint64_t raw_bytes;      /* of all pictures as plain floats, dark ones too */
    uint64_t stored_bytes;   /* of the files in the folder */
    double distance;
    double seconds;
} bake_picture_set_report;

/* Takes the pictures.  The folder appears when it is whole; a folder of that name must not exist, unless empty.  Errors:
 * LMG_ERROR_ARGUMENT, LMG_ERROR_FILE_*. */
lmg_result bake_picture_set_write(const lmg_field *field, const bake_picture_set_options *options, const char *folder,
                                  bake_picture_set_report *report, lmg_error *err);

/* Whether path is a folder with an index.json. */
bool bake_is_picture_set(const char *path);

typedef struct bake_picture_set_info {
    uint32_t pictures, width, height;
    bool photometric;
    double distance;
    double told;     /* the photometer's flux, lumens or watts; NAN = the index doesn't tell */
} bake_picture_set_info;

/*
 * A set as a source of rays: photon numbers go through pictures and pixels, several of them per pixel where there are few; each ray
 * passes the place where its pixel's line of sight meets the bounds and a random point of the picture's share of the camera's sphere,
 * weighted with the pixel's flux.  All pictures are read once when the source is made.  Untrusted files: LMG_ERROR_FILE_OPEN, _READ,
 * _FORMAT with the file's name.  LMG_ERROR_INPUT when all is dark.
 */
lmg_result bake_picture_set_source_create(const char *path, uint64_t seed, bake_source **out, bake_picture_set_info *info,
                                          lmg_error *err);

#endif
