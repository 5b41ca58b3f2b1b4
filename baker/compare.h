/* SPDX-License-Identifier: Apache-2.0 */
/* Two sources into the same receivers: how much their light differs, with the noise of both taken out and an error for every
 * figure. */
#ifndef BAKER_COMPARE_H
#define BAKER_COMPARE_H

#include "source.h"

enum { BAKE_MAX_DISTANCES = 16 };

/* How two sets of readings differ; everything relative to the RMS reading of B, noise taken out. */
typedef struct bake_difference {
    double raw; /* RMS(A - B) / RMS(B), noise and all */
    double rms; /* the same with the variances of A and B subtracted; negative: sqrt of a negative difference, all noise */
    double standard_error; /* of rms */
    double p99;            /* 99th percentile of |A - B| over the pixels, noise included */
    double noise;          /* RMS standard error of A - B */
} bake_difference;

bake_difference bake_differ(const double *a, const double *a_se, const double *b, const double *b_se, size_t count);

typedef struct bake_compare_options {
    uint64_t photons; /* per source, or as many as it has; 0 = 20 million */
    unsigned threads; /* 0 = all cores */
    double size;      /* the luminaire's size, metres, > 0: the unit of distances */
    size_t distance_count;
    double distances[BAKE_MAX_DISTANCES]; /* sizes from the face of the bounds, > 0 */
} bake_compare_options;

typedef struct bake_comparison {
    lmg_vec3 axis;              /* that the planes are perpendicular to */
    double size;                /* metres */
    double flux[2], flux_se[2]; /* that leaves A and B, lumens */
    bake_tally tally[2];
    double seconds[2];
    struct {
        double distance, side; /* metres */
        double mean[2];        /* mean illuminance, lx */
        double mean_se[2];
        bake_difference difference;
    } planes[BAKE_MAX_DISTANCES];
    bake_difference far_field; /* intensity in 32 x 64 bins of equal solid angle */
} bake_comparison;

/* The size of a source (diagonal of its luminous opening, metres), as lmg_layout_fit finds it from a pilot's rays. */
lmg_result bake_source_size(bake_source *source, unsigned threads, double *size, lmg_error *err);

/* A is judged against B.  Photons are taken from number 0 on; give the sources different seeds. */
lmg_result bake_compare(bake_source *a, bake_source *b, const bake_compare_options *options, bake_comparison *out, lmg_error *err);

#endif
