/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Two sources into the same receivers: how much their light differs, with the noise of both taken out and an error for every
 * figure.  A is judged against B, after A was moved onto B if that helps.
 *
 * Errors.  Each source gives its rays in eight blocks.  Readings of pixels and bins have Poisson errors; whatever is computed from
 * them (angles, distances, structural similarity, colour) is computed with each pair of blocks left out in turn, and the jackknife
 * gives its standard error and takes its noise bias off (Efron and Stein 1981).
 */
#ifndef BAKER_COMPARE_H
#define BAKER_COMPARE_H

#include "align.h"
#include "source.h"

enum { BAKE_MAX_DISTANCES = 16, BAKE_VIEWS = 5, BAKE_RADII = 10, BAKE_MAX_MEASURES = 96 };

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
    bool align;                           /* move A onto B first if that makes them more alike */
} bake_compare_options;

/* One figure of the comparison.  Of figures that each source has by itself, a and b are its values and difference is a - b (or a / b
 * - 1, when relative); of figures of the pair alone, a and b are NAN and difference is the figure. */
typedef struct bake_measure {
    char name[64], unit[16];
    double a, a_se, b, b_se;
    double difference, difference_se;
    double none; /* what the difference is of two equal sources */
    bool relative;
} bake_measure;

/* Whether a difference exceeds the joint noise: further than three standard errors from none. */
bool bake_measure_differs(const bake_measure *measure);

/* Readings of one receiver for pictures and plots, count values each, noise and all; they belong to the comparison. */
typedef struct bake_readings {
    size_t count;
    double *a, *a_se, *b, *b_se;
} bake_readings;

typedef struct bake_comparison {
    lmg_vec3 axis;              /* that the planes are perpendicular to */
    double size;                /* metres */
    double flux[2], flux_se[2]; /* that leaves A and B, lumens */
    bake_tally tally[2];
    double seconds[2];
    bake_alignment alignment; /* as found; */
    bool moved;               /* whether A was moved by it: it made A and B more alike */
    size_t plane_count;
    struct {
        double sizes, distance, side; /* sizes; metres */
        double mean[2];               /* mean illuminance, lx */
        double mean_se[2];
        bake_difference difference;
        bake_difference unmoved; /* without the alignment; the same when nothing moved */
        bake_readings map;       /* pixels x pixels, lx */
    } planes[BAKE_MAX_DISTANCES];
    uint32_t pixels;
    bake_difference far_field, far_field_unmoved; /* intensity in bins of equal solid angle */
    struct {
        double tilt, turn;  /* degrees from the main axis, and about it */
        double width;       /* metres */
        bake_difference difference;
        bake_readings picture; /* pixels x pixels, cd/m2 */
    } views[BAKE_VIEWS];
    /* From which distance on, in sizes from the centre, the light of a direction follows the far field: rings of polar angle about the
     * main axis, the RMS over the sectors of a ring of E r^2 / I - 1, for each radius. */
    uint32_t rings;
    double radii[BAKE_RADII];                 /* sizes */
    double *deviation[2], *deviation_se[2];   /* of A and B, [ring * BAKE_RADII + radius]; NAN in rings that are dark */
    double *valid_from[2][2];                 /* [A, B][1 %, 5 %][ring], sizes; INFINITY beyond the radii measured; NAN dark */
    /* Intensity about the main axis in cd, [ring] of ring_count degrees steps in the half-planes of four sectors */
    uint32_t profile_rings;
    double *profile[2][4];
    size_t measure_count;
    bake_measure measures[BAKE_MAX_MEASURES];
} bake_comparison;

/* The size of a source (diagonal of its luminous opening, metres), as lmg_layout_fit finds it from a pilot's rays. */
lmg_result bake_source_size(bake_source *source, unsigned threads, double *size, lmg_error *err);

/* Photons are taken from number 0 on; give the sources different seeds.  out is to be released by bake_comparison_release, also after
 * an error. */
lmg_result bake_compare(bake_source *a, bake_source *b, const bake_compare_options *options, bake_comparison *out, lmg_error *err);
void bake_comparison_release(bake_comparison *comparison);

/* Writes the comparison as one HTML file; paths: of A and B, to name them by. */
lmg_result bake_comparison_report(const bake_comparison *comparison, const char *const paths[2], const char *path, lmg_error *err);

#endif
