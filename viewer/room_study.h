/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What a picture's accuracy costs in time: one room, lit by boxes of light and by the geometry of the same lamps, rendered with
 * rising numbers of samples per pixel, several times each.
 *
 * The error of a picture is the relative deviation of its block means (luminance of block x block pixels) from a far longer picture
 * with random numbers of its own, root mean square over blocks.  From that picture and not from the pictures' own spread: a path
 * tracer that finds light by rare luck underrates its own noise, since a run without luck knows nothing of what it misses.  The
 * reference is lit by the boxes, whose noise is the lesser one; it is made in two halves, whose difference is its own noise, which
 * is taken out.  Blocks that show the lamp itself or next to nothing are left out.
 *
 * The geometry's errors have two parts that no picture of its own can tell apart: light that it hasn't found yet, and what the box
 * itself is off by (its bake's error, the blur of its cells, the lamp's body in the room).  Both count as its error.  Where its
 * errors fall as noise does, with the slope -1/2, the second part is small; where they are flat the first is all there is, and the
 * ratio of times a lower bound.
 */
#ifndef VIEWER_ROOM_STUDY_H
#define VIEWER_ROOM_STUDY_H

#include "render.h"

#include "power_law.h"

enum { VIEW_STUDY_MAX_RUNGS = 16, VIEW_STUDY_MAX_RUNS = 64 };

/* A picture's light; in that order everywhere. */
typedef enum view_study_method { VIEW_STUDY_BOX, VIEW_STUDY_GEOMETRY, VIEW_STUDY_METHODS } view_study_method;
const char *view_study_method_name(view_study_method method); /* "box", "geometry" */

/* The root of a mean square from which noise has been taken out; negative when more was taken out than there was. */
typedef struct view_study_error {
    double rms, standard_error; /* the latter from the spread of independent pictures */
} view_study_error;

/* Pictures with one number of samples per pixel. */
typedef struct view_study_rung {
    uint32_t samples;
    double seconds;         /* processor time of a picture, all threads together; mean of the pictures */
    view_study_error error; /* as measured against the reference, whose noise is taken out */
    double median;          /* the root of the median over blocks of the squared deviations: what rare bright paths can't carry */
    double run[VIEW_STUDY_MAX_RUNS];    /* squared error of each picture, the reference's noise taken out, ... */
    uint64_t seed[VIEW_STUDY_MAX_RUNS]; /* ... and its seed */
} view_study_rung;

typedef struct view_study_result {
    size_t rung_count;
    view_study_rung rungs[VIEW_STUDY_MAX_RUNGS];
    report_slope over_seconds, over_samples; /* of log error, ... */
    report_slope median_over_seconds;        /* ... and of its median over blocks */
    double cost, cost_se;                    /* squared error x processor seconds; rungs weighted with samples */
    double cost_median;                      /* the same for the median over blocks */
} view_study_result;

typedef struct view_study {
    uint32_t width, height, block, runs;
    uint32_t blocks, lamp_blocks, dark_blocks; /* used; left out since they show the lamp, or less than a thousandth of the mean */
    uint64_t reference_seed[2];
    uint32_t reference_samples; /* of both halves */
    double reference_seconds;   /* processor time of both halves */
    double reference_noise;     /* relative, RMS over blocks */
    view_study_result of[VIEW_STUDY_METHODS];
    double ratio, ratio_se; /* time of geometry over that of the box at equal error */
    double ratio_median;
    view_study_error difference; /* of the mean of all pictures by the geometry from the reference, beyond what their spread and the
                                    reference's noise explain: the two parts (above) together */
} view_study;

typedef struct view_study_options {
    uint32_t width, height; /* pixels; at least two blocks each way */
    uint32_t block;         /* pixels, >= 1; what doesn't fill a block is left out */
    uint32_t runs;          /* pictures of each rung, 3 to VIEW_STUDY_MAX_RUNS */
    uint32_t rungs; /* each with twice the samples of the one before, 1 to VIEW_STUDY_MAX_RUNGS; fewer where samples run out */
    uint32_t samples[VIEW_STUDY_METHODS]; /* per pixel on the highest rung; 0 = as many as fit in seconds */
    double seconds;                       /* of the whole study, about; > 0 where samples are 0 */
    uint64_t seed;
    unsigned threads; /* 0 = all cores */
    view_path_options path;
    const atomic_int *stop; /* when it becomes non-zero, the study ends with what is complete; may be NULL */
    void (*progress)(void *self, view_study_method method, const view_study_rung *rung, size_t done, size_t all); /* may be NULL */
    void *progress_self;
} view_study_options;

/* The reference's samples over those of the box's highest rung: its noise then is that of the rung over the root of this. */
enum { VIEW_STUDY_REFERENCE = 16 };

/* boxed and built: the room lit by boxes and by the lamps' geometry, both finished; camera: of boxed.  Errors: LMG_ERROR_ARGUMENT
 * (options); LMG_ERROR_INPUT when boxed has no box or built no lamp, nothing is left to compare, or the study is stopped before
 * each method has a rung; LMG_ERROR_MEMORY. */
lmg_result view_study_run(const view_scene *boxed, const view_scene *built, const view_camera *camera,
                          const view_study_options *options, view_study *out, lmg_error *err);

/* Writes the study as one HTML file; room: what the room is called in it, lights: what lights it (a box and a lamp, say). */
lmg_result view_study_report(const view_study *s, const char *room, const char *lights, const char *path, lmg_error *err);

#endif
