/* SPDX-License-Identifier: Apache-2.0 */
/* How good a layout's cells would be, by the pilot's rays, for the files of this library only. */
#ifndef LUMIGRAPH_LAYOUT_JUDGE_H
#define LUMIGRAPH_LAYOUT_JUDGE_H

#include "pilot.h"

/* Where light is caught: planes at some sizes, then two of directions (far away): all, and those of most of the light. */
enum { LMG_JUDGE_PLANES = 4, LMG_JUDGE_RECEIVERS = 6, LMG_JUDGE_PIXELS = 24 * 24 };

typedef struct lmg_judge lmg_judge;

/* Errors of a good box: what errors are measured in.  Those of a beam's intensity are seen in finer pixels than others. */
#define LMG_GOOD_ILLUMINANCE 0.006
#define LMG_GOOD_INTENSITY 0.02
#define LMG_GOOD_BEAM 0.04
#define LMG_GOOD_RADIANCE 0.3

/* Squared relative errors. */
typedef struct lmg_verdict {
    double error, se;   /* what candidates are compared by: the sum of the next three over what is good; with its standard error */
    double illuminance; /* over the planes */
    double intensity;   /* over directions */
    double radiance; /* weighted with etendue (L2): what the cells smooth, and the noise of the box's photons; by chance below 0 */
} lmg_verdict;

/* For rays of direction class c, or, with all, of all classes; planes lie across that direction.  NULL: no memory. */
lmg_judge *lmg_judge_create(const lmg_pilot *pl, int c, bool all);
void lmg_judge_destroy(lmg_judge *judge); /* accepts NULL */

/* Whether x is below gain x than, by so many of the larger standard error, which is that of one verdict alone and a measure of
 * chance rather than the error of the difference: candidates have their rays in common.  LIKELY between ways of sharing cells,
 * CLEAR between one opening and six faces, CERTAIN for planes, which would better stay as it is. */
bool lmg_better(lmg_verdict x, lmg_verdict than, double gain, double standard_errors);
#define LMG_LIKELY 0.5
#define LMG_CLEAR 1.0
#define LMG_CERTAIN 2.0

/* What the slabs' cells do to the light; rays that no slab holds count as lost.  by_radiance: judges that alone, which is quicker.
 * Where the error is certainly above the limit that is found out by some of the rays: its measures may be missing then, and the
 * error infinite.  INFINITY: judges by all rays. */
lmg_verdict lmg_judge_slabs(lmg_judge *judge, const lmg_slab *slabs, uint32_t slab_count, bool by_radiance, double limit);

/* Integral of the squared radiance over etendue, in (pilot's flux)^2/(m2 sr), that the slabs' cells keep, noise aside; *pairs: of
 * rays in one cell, which is what it's known by. */
double lmg_judge_kept(lmg_judge *judge, const lmg_slab *slabs, uint32_t slab_count, double *pairs);

/* Sets what the light itself has of that: errors of radiance are relative to it.  At first, nothing is known, and radiance isn't
 * judged. */
void lmg_judge_set_square(lmg_judge *judge, double square);
double lmg_judge_square(const lmg_judge *judge);

#endif
