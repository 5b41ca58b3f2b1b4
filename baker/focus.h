/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The virtual focus of a source: the point that its rays, drawn out to straight lines, pass closest by - the least sum of squared
 * distances, weighted by flux.  Makers of ray files give it to tell where a lamp seems to shine from.
 */
#ifndef BAKER_FOCUS_H
#define BAKER_FOCUS_H

#include <lumigraph/lumigraph.h>

typedef struct bake_focus bake_focus;

/* centre, size: about where the rays start and how far apart (metres): what sums are counted relative to, in 2^-30 of it. */
lmg_result bake_focus_create(lmg_vec3 centre, double size, bake_focus **out, lmg_error *err);
void bake_focus_destroy(bake_focus *focus);

/* Takes rays, from several threads at once; sums are integers, so their order doesn't matter. */
lmg_sink bake_focus_sink(bake_focus *focus);

/* The point, metres; spread (may be NULL): the root mean square distance of the lines from it.  False when there is none: no light, or
 * parallel rays. */
bool bake_focus_point(const bake_focus *focus, lmg_vec3 *point, double *spread);

#endif
