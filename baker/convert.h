/* SPDX-License-Identifier: Apache-2.0 */
/* Light from one form into another: any source of rays into a box, a ray file or a far-field distribution.  Every conversion counts
 * what went in and what came out. */
#ifndef BAKER_CONVERT_H
#define BAKER_CONVERT_H

#include "goniometer.h"
#include "source.h"

#include <luminaires/rayfile.h>

#include <signal.h>

typedef struct bake_convert_options {
    uint64_t rays;                     /* photons to take; 0 = all that the source has, of an endless one 10 million */
    unsigned threads;                  /* 0 = all cores */
    lmg_fit_options fit;               /* of a box: layout wishes; bounds and, where 0, cells are filled in */
    bake_goniometer_options grid;      /* of a far field; the bounds are filled in */
    double near;                       /* of a far field: > 0: E d^2 on a sphere of this radius (metres) around the bounds' centre */
    const volatile sig_atomic_t *stop; /* when it becomes non-zero, the conversion ends with LMG_ERROR_INTERNAL; NULL = never */
} bake_convert_options;

typedef struct bake_conversion {
    uint64_t photons;        /* taken from the source */
    uint64_t rays;           /* that left it */
    double flux_in;          /* that leaves the source, lumens or watts */
    double flux_out, out_se; /* in the result, and the standard error that it has as a sample */
    double residual;         /* of a box: beside all slabs */
    uint64_t refused;        /* of a box: rays that can't be counted */
    double noise;            /* of a far field: RMS standard error / RMS intensity, over the sphere */
    uint32_t pictures, dark; /* of a set of pictures: all; those without light */
    uint64_t raw_bytes, stored_bytes; /* of a set of pictures: as plain floats; on disk */
    uint64_t box_bytes;               /* of the box file that they were taken of; 0: none */
    double distance;         /* of their camera, metres */
    double seconds;
    char layout_why[1024]; /* of a box */
} bake_conversion;

/*
 * A box of a source's light.  The layout is fitted to a pilot of the source's own rays: of a finite source that has no more of them
 * than a pilot takes, to all of them.  Errors: those of the source, of lmg_layout_fit and of the accumulator.
 */
lmg_result bake_convert_to_field(bake_source *source, const bake_convert_options *options, lmg_field **out, bake_conversion *report,
                                 lmg_error *err);

/* A ray file, rays in the order of photon numbers, the same bytes for any number of threads.  Nothing is left behind on failure. */
lmg_result bake_convert_to_rays(bake_source *source, const bake_convert_options *options, const char *path,
                                const lum_ray_writer_options *writer, bake_conversion *report, lmg_error *err);

/* The far field of a source, on a grid of C and gamma (goniometer.h); with options.near what a photometer at that distance takes for it
 * (application-distance photometry). */
lmg_result bake_convert_to_photometry(bake_source *source, const bake_convert_options *options, lum_photometry **out,
                                      bake_conversion *report, lmg_error *err);

#endif
