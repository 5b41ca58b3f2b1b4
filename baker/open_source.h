/* SPDX-License-Identifier: Apache-2.0 */
/* A source of light by the path of its file: what compare and convert take.  The kind is told by the file itself, not by its name
 * (but for glTF and photometric text formats, which go by their endings). */
#ifndef BAKER_OPEN_SOURCE_H
#define BAKER_OPEN_SOURCE_H

#include "program.h"
#include "source.h"

#include <luminaires/photometry.h>
#include <luminaires/rayfile.h>

typedef enum source_kind {
    SOURCE_BOX,        /* a baked box */
    SOURCE_LAMP,       /* a glTF luminaire, traced */
    SOURCE_RAYS,       /* a ray file */
    SOURCE_PICTURES,   /* a folder of near-field goniometer pictures */
    SOURCE_PHOTOMETRY, /* IES, EULUMDAT, TM-33: its far field from its luminous shape */
} source_kind;

/* What a path is; anything that isn't known counts as a box, whose reader says what is wrong with it. */
source_kind source_kind_of(const char *path);

typedef struct source_options {
    double flux_lm;    /* > 0: what the sources of glTF lamps emit */
    lum_ray_flux rays; /* units of ray files */
    uint64_t seed;
    unsigned threads; /* for reading; 0 = all cores */
    bool quiet;       /* no remarks on stderr */
} source_options;

typedef struct opened_source {
    source_kind kind;
    const char *path;
    bool photometric; /* flux in lumens, else in watts */
    char *recipe;     /* of a lamp, as compact JSON; NULL = none */
    lmg_field *field; /* of a box, else NULL */
    struct lum_model *model;
    lum_rayfile *rays;
    lum_photometry *photometry; /* in cd, or W/sr when not photometric */
    bake_source *source;
} opened_source;

/* Opens; prints remarks that come with the file (recipe in use, quirks of a ray file) to stderr unless quiet.  The path is borrowed
 * until close. */
lmg_result open_source(const lamp_options *lamp, const source_options *options, opened_source *out, lmg_error *err);
void close_source(opened_source *source);

#endif
