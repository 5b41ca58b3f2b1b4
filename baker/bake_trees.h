/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Radiance trees of a bake: which rays and how many looks they grow of, and what that costs of its time.  Trees are the same whoever has
 * traced the photons and when.
 */
#ifndef BAKER_BAKE_TREES_H
#define BAKER_BAKE_TREES_H

#include "bake.h"
#include "part.h"

typedef struct bake_trees {
    const bake_options *options;
    bake_report *report;
    bake_source *tracer;
    const bake_part *part;
    bake_ray_list *kept; /* rays of the first photons; NULL: none wanted, or they have to be traced again */
    uint32_t count; /* of trees; 0: none */
    uint64_t most_photons, most_looks;
    lmg_look_kind kind; /* of looks */
} bake_trees;

/* Once there is a pilot, the first members being set: decides on looks (report->looks_why) and makes room for the rays of the bake's first
 * photons, to be kept while they are traced; kept is the caller's to destroy, unless bake_trees_grow has.  Errors: LMG_ERROR_MEMORY. */
lmg_result bake_trees_begin(bake_trees *t, double seconds, lmg_error *err);

/* How many trees a bake of so many seconds, if it's by time, is to have. */
uint32_t bake_trees_wanted(const bake_options *options, double seconds);

/* Bytes of a file of so many that the cells of a bake with trees may take. */
double bake_trees_leave(double bytes);

/* Of so many seconds that a bake by time has left, those in which to trace, so that the rest is enough for the trees. */
double bake_trees_tracing(const bake_trees *t, double left);

/* Grows them, once the photons are traced.  What hinders that is told (report->no_trees_why), and the box does without: a bake isn't lost for
 * it.  An interruption here is one of the bake: report->interrupted. */
void bake_trees_grow(bake_trees *t, lmg_field *field);

#endif
