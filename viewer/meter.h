/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A virtual lux meter in the scene, all light included, with two standard errors: of the rendering, from the spread of its paths,
 * and of the bakes, from the standard errors of the boxes' cells.
 *
 * The bakes' errors reach the meter by every way that light takes from a box.  So beside the light itself each path adds up what
 * the cells' errors would make of it in a number of made-up bakes: in each, every cell is off by its standard error, up or down by
 * a coin that belongs to the cell.  The mean square of these deviations is the variance, as of independent cells.  Paths come in
 * two halves; the product of their deviations has no noise of the paths in its mean.
 */
#ifndef VIEWER_METER_H
#define VIEWER_METER_H

#include "view_path.h"

#include <stdatomic.h>

typedef struct view_meter_options {
    uint64_t samples; /* paths, at least 2 */
    uint64_t seed;
    unsigned threads; /* 0 = all cores; the result doesn't depend on it */
    view_path_options path;
} view_meter_options;

typedef struct view_reading {
    double rgb[3], se[3]; /* lx, and the rendering's standard errors */
    double lux, render;   /* luminance weighted, and the rendering's standard error */
    double bake;          /* standard error from the boxes' bakes, lx; uncertain by a tenth */
    uint64_t samples, refused;
    double seconds;
} view_reading;

/* Illuminance at a point on a plane that faces normal (unit), world frame.  Random numbers depend on (seed, sample). */
lmg_result view_meter_read(const view_scene *scene, lmg_vec3 point, lmg_vec3 normal, const view_meter_options *options,
                           view_reading *out, lmg_error *err);

/* The standard error of a mean, from the mean deviations of two halves of its paths. */
double view_bake_error(const double a[VIEW_BAKES], const double b[VIEW_BAKES]);

#endif
