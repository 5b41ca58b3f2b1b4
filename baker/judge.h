/* SPDX-License-Identifier: Apache-2.0 */
/* Judges boxes of a lamp by the lamp's own rays: how far their light is off, the noise of judging taken out. */
#ifndef BAKER_JUDGE_H
#define BAKER_JUDGE_H

#include "bake.h"

enum { JUDGE_DISTANCES = 5 };

/* An error: relative RMS difference, noise taken out; negative: the root of a negative square, all noise. */
typedef struct judge_error {
    double rms, standard_error;
} judge_error;

/* What is judged.  Near: illuminance, the RMS of the errors on five planes (32 x 32 pixels) at 0.5, 1, 2, 5 and 10 sizes; far: intensity in
 * 32 x 64 bins of equal solid angle; luminance: five pictures of 32 x 32 pixels, means over cones of 5 degrees half-angle. */
typedef enum judge_measure { JUDGE_NEAR, JUDGE_FAR, JUDGE_LUMINANCE, JUDGE_MEASURES } judge_measure;
const char *judge_measure_name(judge_measure measure);

typedef struct judge_verdict {
    judge_error error[JUDGE_MEASURES];
    judge_error planes[JUDGE_DISTANCES];
} judge_verdict;

typedef struct judge judge;
struct lum_model;

/* seed: that of the bakes to be judged; the judge's photons are others.  flux_lm: as in bake_options.  The model is borrowed.  Errors: as
 * bake_tracer_create; LMG_ERROR_INPUT when no light leaves the lamp. */
lmg_result judge_create(const struct lum_model *model, uint64_t seed, double flux_lm, unsigned threads, judge **out, lmg_error *err);
void judge_destroy(judge *j);

/* Measures the lamp, anew, with so many photons; to be done before boxes are judged. */
lmg_result judge_measure_lamp(judge *j, uint64_t photons, lmg_error *err);
/* The relative noise of that alone, RMS, for a measure. */
double judge_noise(const judge *j, judge_measure measure);

/* Judges a box by so many rays of it. */
lmg_result judge_box(const judge *j, const lmg_field *field, uint64_t rays, judge_verdict *out, lmg_error *err);

double judge_size(const judge *j);  /* metres */
lmg_vec3 judge_axis(const judge *j);
bake_source *judge_lamp(const judge *j);

#endif
