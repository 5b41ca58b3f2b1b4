/* SPDX-License-Identifier: Apache-2.0 */
/* What measuring (compare.c) and evaluating (compare_measures.c) share: the set of receivers and their readings in blocks. */
#ifndef BAKER_COMPARE_INSIDE_H
#define BAKER_COMPARE_INSIDE_H

#include "compare.h"
#include "receiver.h"

enum {
    BLOCKS = 8,
    PIXELS = 32,
    RINGS = 32, /* far field for differences: equal solid angles */
    SECTORS = 64,
    PROFILE_RINGS = 180, /* far field for plots and angles: steps of one degree, and five about the axis */
    PROFILE_SECTORS = 72,
    ZONES = 18,          /* about the vertical: 10 degrees */
    NEAR_RINGS = 36,     /* spheres: 5 degrees */
    NEAR_SECTORS = 8
};

/* Receivers after the planes, in this order. */
enum { FAR_FIELD = 0, PROFILE = 1, NADIR = 2, SPHERES = 3, PICTURES = SPHERES + BAKE_RADII, RECEIVERS = PICTURES + BAKE_VIEWS };
enum { MAX_RECEIVERS = BAKE_MAX_DISTANCES + RECEIVERS };

typedef struct instrument {
    size_t plane_count;
    bake_rectangle planes[BAKE_MAX_DISTANCES];
    bake_sphere far_field, profile, nadir, spheres[BAKE_RADII];
    bake_picture pictures[BAKE_VIEWS];
} instrument;

typedef struct receivers {
    size_t count;
    bake_receiver *list[MAX_RECEIVERS];
} receivers;

/* Readings of a receiver, each block scaled to the whole source, so that their mean is the reading. */
typedef struct reading {
    size_t count;
    double *value;    /* [block][i] */
    double *variance; /* [i], of the mean over all blocks: Poisson */
    double *rgb;      /* [block][i][3], or NULL */
} reading;

typedef struct measured {
    size_t count;
    reading of[MAX_RECEIVERS];
} measured;

void measured_release(measured *m);

/* Sets up what sources within the bounds are measured with: planes across `axis`, spheres and pictures about the centre. */
void set_up_instrument(instrument *in, lmg_vec3 lo, lmg_vec3 hi, lmg_vec3 axis, double size, const double *distances, size_t count);

/*
 * Measures a source in blocks, moved by `motion`, with the first `count` receivers; the planes and the far field unmoved as well, into
 * `unmoved`, unless that is NULL.
 */
lmg_result measure_source(bake_source *source, const instrument *in, size_t count, const bake_motion *motion, uint64_t first,
                          uint64_t photons, unsigned threads, measured *out, measured *unmoved, bake_tally *tally, lmg_error *err);
extern const bake_motion BAKE_NO_MOTION;

/* The axis (+-x, +-y, +-z) that most of a source's light goes along. */
lmg_result source_main_axis(bake_source *source, unsigned threads, lmg_vec3 *axis, lmg_error *err);

/* How the means of two readings differ, noise taken out. */
bake_difference differ(const reading *a, const reading *b);

/* Fills in everything that is computed from readings.  unmoved: A's planes and far field before the alignment. */
lmg_result evaluate(const measured sides[2], const measured *unmoved, bake_comparison *out, lmg_error *err);

#endif
