/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Bakes to a stated error: boxes of rising size are judged by the lamp's own rays (judge.h) until one has the error asked for.
 *
 * Cells are as many as so many photons are worth, however large the file (or as are asked for), so that photons alone are searched:
 * a power law through the boxes judged so far tells how many it takes, more or fewer than before.
 */
#ifndef BAKER_TARGET_H
#define BAKER_TARGET_H

#include "judge.h"

enum { TARGET_MAX_BAKES = 14 };

/* What the error is of: a measure of the judge; or the flux that leaves the lamp, of which a box is off by chance alone: its
 * standard error is what counts, known from the photons without a judge. */
typedef enum target_measure { TARGET_NEAR, TARGET_FAR, TARGET_LUMINANCE, TARGET_FLUX, TARGET_MEASURES } target_measure;
const char *target_measure_name(target_measure measure);

typedef struct bake_target {
    target_measure of;
    double error; /* relative, > 0 */
    /* After every bake, on the calling thread: its number from 1, photons and cells, its error, the photons of the next (0: done)
     * and the seconds that it will take, judged, by this one. */
    void (*progress)(void *self, unsigned bake, uint64_t photons, uint64_t cells, judge_error error, uint64_t next, double seconds);
    void *progress_self;
} bake_target;

typedef struct bake_reached {
    judge_error error;       /* of the box that was kept */
    uint64_t photons, cells; /* cells: all that it has */
    unsigned bakes;
    bool within; /* error within 15 % of what was asked, or below it where nothing with fewer photons was found between */
} bake_reached;

/*
 * Bakes until the error is what was asked for.  options: photons and seconds don't count; size: as
 * in bake_options, but where it is 0 the file may be as large as it takes.  *out is the box, also when the error can't be reached
 * (within: false; then it is the nearest one).  Which photons are tried depends on the judging alone, never on time, so the same
 * call gives the same box. Errors: as bake_run.
 */
lmg_result bake_run_to_error(const struct lum_model *model, const bake_options *options, const bake_target *target, lmg_field **out,
                             bake_report *report, bake_reached *reached, lmg_error *err);

#endif
