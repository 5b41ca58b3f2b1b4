/* SPDX-License-Identifier: Apache-2.0 */
/*
 * How one source has to be turned and moved to lie on another: measured luminaires come in the frame of the goniometer, models in
 * that of the CAD program.  And the point that a source's rays seem to come from.
 */
#ifndef BAKER_ALIGN_H
#define BAKER_ALIGN_H

#include "source.h"

/* The point with the least flux-weighted sum of squared distances from the rays' lines: the solution of
 * sum w (1 - d d^T) (x - o) = 0, with the standard error of each coordinate (jackknife over eight blocks of rays).  Along a narrow
 * beam it is hardly determined, and its error says so. */
typedef struct bake_focus {
    lmg_vec3 point, standard_error; /* metres, luminaire frame */
} bake_focus;

/* A rigid motion: x' = rotation x + shift. */
typedef struct bake_motion {
    double rotation[3][3];
    lmg_vec3 shift; /* metres */
} bake_motion;

typedef struct bake_alignment {
    bake_motion motion; /* brings A to B */
    double angle, angle_se; /* of the rotation, radians */
    lmg_vec3 shift_se;
    unsigned turns; /* rotations that the light determines: 3, or 2 for a source that is round about an axis, 0 for one that shines to
                       all sides alike; the others are left alone */
    bake_focus focus[2];
} bake_alignment;

lmg_vec3 bake_motion_point(const bake_motion *motion, lmg_vec3 p);
lmg_vec3 bake_motion_direction(const bake_motion *motion, lmg_vec3 d);
bool bake_motion_is_identity(const bake_motion *motion);

/* A sink that moves the rays it is given and hands them on to `count` sinks, which are borrowed. */
typedef struct bake_moved_sink {
    bake_motion motion;
    const lmg_sink *sinks;
    size_t count;
} bake_moved_sink;
lmg_sink bake_moved_sink_of(bake_moved_sink *moved);

/*
 * Finds the rotation from the two far fields (their expansions in spherical harmonics up to degree 10; Gauss-Newton from the
 * identity and from the 24 rotations of a cube), the shift from where the rays pass.  A motion that the noise of the
 * rays could make is no motion: it comes out as zero.  photons: of each source, at least 80,000, numbered from BAKE_PILOT_FIRST on.
 */
lmg_result bake_align(bake_source *a, bake_source *b, uint64_t photons, unsigned threads, bake_alignment *out, lmg_error *err);

#endif
