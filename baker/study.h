/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What accuracy costs in time: a lamp is baked with rising numbers of photons, with several numbers of cells, and with rays traced
 * backwards beside the photons, and each box is judged against the lamp's own rays, many more of them, the noise of both taken out.
 * Boxes of photons alone are judged once more as plain bins.
 */
#ifndef BAKER_STUDY_H
#define BAKER_STUDY_H

#include "judge.h"

#include "power_law.h"

enum { STUDY_MAX_RUNGS = 24, STUDY_TARGETS = 4 };

/* Rising numbers of photons, in the cells that they are worth; of cells, by the same photons; of photons and as many rays traced
 * backwards as photons leave. */
typedef enum study_ladder { STUDY_PHOTONS, STUDY_CELLS, STUDY_COMBINED, STUDY_LADDERS } study_ladder;
const char *study_ladder_name(study_ladder ladder); /* "photons", "cells", "combined" */

typedef struct study_rung {
    study_ladder ladder;
    uint64_t photons, cells, bytes; /* cells: as laid out */
    uint64_t gathered_rays; /* traced backwards */
    double pilot_seconds, trace_seconds, gather_seconds, reconstruct_seconds, write_seconds;
    double processor_seconds; /* of the same, all threads together: what a busy machine doesn't change */
    judge_verdict verdict;
    judge_verdict plain; /* of the same box read as plain bins (lmg_field_make_constant); STUDY_COMBINED: not judged, NAN */
    double noise;        /* what the bake itself said: bake_report.noise */
} study_rung;

/* All in: what the whole bake took. */
double study_rung_seconds(const study_rung *rung);

/* Power laws of the error, fitted to the ladder of photons. */
typedef struct study_fit {
    report_slope over_photons, over_seconds; /* of processors */
} study_fit;

/* The photons of a plain bake that reach a target of the near-field error, by its power law. */
typedef struct study_advice {
    double target;
    bool reachable; /* not so: errors don't fall, or it takes over 100 times the photons of the largest bake */
    uint64_t photons;
    double seconds, bytes;
} study_advice;

typedef struct study_options {
    double seconds;   /* of the whole study, about; > 0 */
    unsigned threads; /* 0 = all cores */
    uint64_t seed;
    double flux_lm;   /* as in bake_options */
    const char *folder; /* where boxes are written for their size and time, and removed */
    const volatile sig_atomic_t *stop;
    void (*progress)(void *self, const study_rung *rung, size_t done, size_t all);
    void *progress_self;
} study_options;

typedef struct study {
    double size; /* metres */
    lmg_vec3 axis;
    uint64_t reference_photons;
    double reference_noise[JUDGE_MEASURES]; /* relative, of the lamp's rays alone */
    size_t rung_count;
    study_rung rungs[STUDY_MAX_RUNGS];
    study_fit fit[JUDGE_MEASURES];
    study_advice advice[STUDY_TARGETS];
    char
        combined_why[200]; /* why there is no ladder of STUDY_COMBINED: which effect can't be traced backwards; "" = there is one */
    double photons_per_second; /* of whole bakes: the largest rung of the ladder of photons */
    double deposit_share;      /* of the time of tracing that goes into counting rays in cells */
} study;

/* Errors: as bake_run; LMG_ERROR_FILE_* when boxes can't be written; LMG_ERROR_INPUT when stopped before there is anything to say. */
struct lum_model;
lmg_result study_run(const struct lum_model *model, const study_options *options, study *out, lmg_error *err);

/* The advice as a command line of a shell, in quotes where the lamp's path needs them; options of the lamp (--flux, --recipe, --set) are
 * the user's to add.  Returns text. */
const char *study_command(const study_advice *advice, const char *lamp, char *text, size_t size);

/* Writes the study as one HTML file; lamp: what the model is called in it. */
lmg_result study_report(const study *s, const char *lamp, const char *path, lmg_error *err);

#endif
