/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Renders a scene: paths for all pixels on all cores, the mean radiance of every pixel and its standard error.
 *
 * The random numbers of sample k of pixel n depend on (seed, n, k) alone and a pixel's samples are added in order, so a picture of
 * N samples per pixel is the same bits on any number of threads and however many passes it was made in.
 */
#ifndef VIEWER_RENDER_H
#define VIEWER_RENDER_H

#include "view_camera.h"
#include "view_path.h"

#include <stdatomic.h>

enum { VIEW_MAX_SIDE = 16384 };

/* A picture, rows from the top. */
typedef struct view_image {
    uint32_t width, height;
    float *rgb;            /* 3 per pixel, linear Rec.709, cd/m2 */
    float *standard_error; /* of the luminance, cd/m2, 1 per pixel; NAN where it is unknown (fewer than two samples) */
} view_image;

lmg_result view_image_create(uint32_t width, uint32_t height, view_image *out, lmg_error *err);
void view_image_free(view_image *image);

typedef struct view_render view_render;

typedef struct view_render_options {
    uint32_t width, height; /* 1..VIEW_MAX_SIDE */
    uint64_t seed;
    unsigned threads; /* 0 = all cores */
    view_path_options path;
} view_render_options;

/* scene and camera are borrowed until view_render_destroy. */
lmg_result view_render_create(const view_scene *scene, const view_camera *camera, const view_render_options *options,
                              view_render **out, lmg_error *err);
void view_render_destroy(view_render *render);

/* Adds samples paths to every pixel.  When *stop becomes non-zero, the pass ends early (pixels then differ in their numbers of
 * samples; each stays a valid mean).  stop may be NULL. */
lmg_result view_render_pass(view_render *render, uint32_t samples, const atomic_int *stop, lmg_error *err);

typedef struct view_render_state {
    uint32_t samples_min, samples_max; /* per pixel so far */
    uint64_t rays;                     /* closest-hit and shadow rays traced */
    uint64_t refused;                  /* paths whose estimate wasn't finite, counted as zero; 0 in a sound scene */
    double seconds;                    /* wall clock spent in passes */
    double processor_seconds;          /* the process's time on processors meanwhile, all threads together */
    double
        noise;   /* typical relative standard error of a pixel: median over blocks; NAN before the second sample or without light */
    double mean;                   /* mean luminance, cd/m2, */
    double mean_bake, mean_render; /* and its standard errors, of the boxes' bakes (meter.h) and of the paths (NAN: fewer than two) */
} view_render_state;
view_render_state view_render_look(const view_render *render);

/* The picture as it stands; image as made by view_image_create for the same size. */
void view_render_resolve(const view_render *render, view_image *image);

#endif
