/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What accuracy costs in time: a lamp is baked with rising numbers of photons and with several numbers of cells, and each box is judged
 * against the lamp's own rays, many more of them, the noise of both taken out.
 */
#ifndef BAKER_STUDY_H
#define BAKER_STUDY_H

#include "judge.h"

enum { STUDY_MAX_RUNGS = 24, STUDY_TARGETS = 4 };

typedef struct study_rung {
    bool resolution; /* of the ladder of cells; false: of the ladder of photons */
    uint64_t photons, cells, bytes; /* cells: as laid out */
    uint64_t cells_asked;
    double pilot_seconds, trace_seconds, reconstruct_seconds, write_seconds;
    judge_verdict verdict;
    double noise; /* what the bake itself said: bake_report.noise */
} study_rung;

/* error^2 = scale / photons + floor^2, fitted to the ladder of photons; slope: of log(error) over log(photons), by regression. */
typedef struct study_fit {
    double scale, floor;
    double slope, slope_se;
} study_fit;

/* The cheapest command that reaches a target of the near-field error. */
typedef struct study_advice {
    double target;
    bool reachable;
    uint64_t photons, cells;
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
    double photons_per_second; /* of whole bakes: the largest rung of the ladder of photons */
    double deposit_share;      /* of the time of tracing that goes into counting rays in cells */
} study;

/* Errors: as bake_run; LMG_ERROR_FILE_* when boxes can't be written; LMG_ERROR_INPUT when stopped before there is anything to say. */
struct lum_model;
lmg_result study_run(const struct lum_model *model, const study_options *options, study *out, lmg_error *err);

/* Writes the study as one HTML file; lamp: what the model is called in it. */
lmg_result study_report(const study *s, const char *lamp, const char *path, lmg_error *err);

#endif
