/* SPDX-License-Identifier: Apache-2.0 */
/* Threads, pixels and their statistics.  Tiles are handed out by an atomic counter; no two threads touch the same pixel in a pass.
 */
#include "render.h"

#include "meter.h"

#include <pthread.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

/* Small enough to share a picture evenly, large enough that neighbouring rays find each other's memory warm. */
enum { TILE = 16 };

enum { MAX_THREADS = 1024 };

/* One in so many of a pixel's samples follows the boxes' errors, which takes time. */
enum { FOLLOW = 16 };

lmg_result view_image_create(uint32_t width, uint32_t height, view_image *out, lmg_error *err)
{
    *out = (view_image){.width = width, .height = height};
    if (width < 1 || height < 1 || width > VIEW_MAX_SIDE || height > VIEW_MAX_SIDE) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a picture of %u x %u pixels: each side should be 1 to %d", width, height,
                        VIEW_MAX_SIDE);
    }
    size_t pixels = (size_t)width * height;
    out->rgb = calloc(pixels * 3, sizeof *out->rgb);
    out->standard_error = calloc(pixels, sizeof *out->standard_error);
    if (!out->rgb || !out->standard_error) {
        view_image_free(out);
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a picture of %u x %u pixels", width, height);
    }
    return LMG_OK;
}

void view_image_free(view_image *image)
{
    free(image->rgb);
    free(image->standard_error);
    image->rgb = image->standard_error = NULL;
}

/* One pixel's samples: sums of R,G,B and Welford's mean and squared deviations of the luminance. */
typedef struct view_pixel {
    double sum[3];
    double mean, deviations;
    uint32_t samples;
} view_pixel;

struct view_render {
    const view_scene *scene;
    const view_camera *camera;
    view_render_options options;
    uint32_t tiles_x, tiles_y;
    view_pixel *pixels;
    uint64_t rays, refused;
    double deviation[2][VIEW_BAKES]; /* of even and odd pixels' samples that follow the boxes' errors; the order of adding them up
                                        isn't fixed, and rounding is all that may differ */
    uint64_t followed[2];
    double seconds, processor_seconds;
    /* of the pass under way */
    atomic_uint next_tile;
    const atomic_int *stop;
    uint32_t samples;
};

lmg_result view_render_create(const view_scene *scene, const view_camera *camera, const view_render_options *options,
                              view_render **out, lmg_error *err)
{
    *out = NULL;
    if (options->width < 1 || options->height < 1 || options->width > VIEW_MAX_SIDE || options->height > VIEW_MAX_SIDE) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a picture of %u x %u pixels: each side should be 1 to %d", options->width,
                        options->height, VIEW_MAX_SIDE);
    }
    view_render *render = calloc(1, sizeof *render);
    view_pixel *pixels = calloc((size_t)options->width * options->height, sizeof *pixels);
    if (!render || !pixels) {
        free(render);
        free(pixels);
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a picture of %u x %u pixels", options->width, options->height);
    }
    render->scene = scene;
    render->camera = camera;
    render->options = *options;
    if (render->options.threads == 0) {
        long cores = sysconf(_SC_NPROCESSORS_ONLN);
        render->options.threads = cores > 0 ? (unsigned)cores : 1;
    }
    if (render->options.threads > MAX_THREADS) {
        render->options.threads = MAX_THREADS;
    }
    render->tiles_x = (options->width + TILE - 1) / TILE;
    render->tiles_y = (options->height + TILE - 1) / TILE;
    render->pixels = pixels;
    *out = render;
    return LMG_OK;
}

void view_render_destroy(view_render *render)
{
    if (!render) {
        return;
    }
    free(render->pixels);
    free(render);
}

typedef struct thread_task {
    view_render *render;
    view_worker worker;
    double deviation[2][VIEW_BAKES];
    uint64_t followed[2];
    pthread_t thread;
} thread_task;

static void trace_pixel(view_render *render, thread_task *task, uint32_t x, uint32_t y)
{
    view_worker *worker = &task->worker;
    const view_render_options *options = &render->options;
    uint64_t index = (uint64_t)y * options->width + x;
    view_pixel *pixel = &render->pixels[index];
    for (uint32_t k = 0; k < render->samples; k++) {
        lum_rng rng = lum_rng_stream(options->seed, index << 32 | pixel->samples);
        double px = x + lum_rng_next(&rng), py = y + lum_rng_next(&rng);
        lmg_vec3 d = view_camera_direction(render->camera, px, py, options->width, options->height);
        double rgb[3];
        bool follow = render->scene->box_count && pixel->samples % FOLLOW == 0;
        worker->deviation = follow ? task->deviation[(x + y) % 2] : NULL;
        task->followed[(x + y) % 2] += follow;
        view_path_radiance(render->scene, &options->path, render->camera->eye, d, &rng, worker, rgb);
        for (int c = 0; c < 3; c++) {
            pixel->sum[c] += rgb[c];
        }
        double luminance = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
        pixel->samples++;
        double step = luminance - pixel->mean;
        pixel->mean += step / pixel->samples;
        pixel->deviations += step * (luminance - pixel->mean);
    }
}

static void *run_tiles(void *argument)
{
    thread_task *task = argument;
    view_render *render = task->render;
    unsigned saved = lum_thread_begin();
    uint32_t tiles = render->tiles_x * render->tiles_y;
    for (;;) {
        uint32_t tile = atomic_fetch_add(&render->next_tile, 1);
        if (tile >= tiles) {
            break;
        }
        uint32_t x0 = tile % render->tiles_x * TILE, y0 = tile / render->tiles_x * TILE;
        for (uint32_t y = y0; y < y0 + TILE && y < render->options.height; y++) {
            if (render->stop && atomic_load_explicit(render->stop, memory_order_relaxed)) {
                lum_thread_end(saved);
                return NULL;
            }
            for (uint32_t x = x0; x < x0 + TILE && x < render->options.width; x++) {
                trace_pixel(render, task, x, y);
            }
        }
    }
    lum_thread_end(saved);
    return NULL;
}

static double clock_seconds(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

lmg_result view_render_pass(view_render *render, uint32_t samples, const atomic_int *stop, lmg_error *err)
{
    const double begin = clock_seconds(CLOCK_MONOTONIC), processor_begin = clock_seconds(CLOCK_PROCESS_CPUTIME_ID);
    unsigned threads = render->options.threads;
    size_t lights = render->scene->light_count ? render->scene->light_count : 1;
    thread_task *tasks = calloc(threads, sizeof *tasks);
    double *weights = calloc(2 * threads * lights, sizeof *weights);
    if (!tasks || !weights) {
        free(tasks);
        free(weights);
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %u threads", threads);
    }
    render->samples = samples;
    render->stop = stop;
    atomic_store(&render->next_tile, 0);
    unsigned started = 0;
    for (unsigned i = 0; i < threads; i++) {
        tasks[i] = (thread_task){.render = render, .worker = {.weights = weights + 2 * i * lights}};
        if (i + 1 == threads) {
            run_tiles(&tasks[i]); /* this thread is one of them */
        } else if (pthread_create(&tasks[i].thread, NULL, run_tiles, &tasks[i]) == 0) {
            started = i + 1;
        } else {
            /* Fewer threads do as well: the picture doesn't depend on their number. */
            run_tiles(&tasks[i]);
            threads = i + 1;
        }
    }
    for (unsigned i = 0; i < threads; i++) {
        if (i < started) {
            pthread_join(tasks[i].thread, NULL);
        }
        render->rays += tasks[i].worker.rays;
        render->refused += tasks[i].worker.refused;
        for (int h = 0; h < 2; h++) {
            render->followed[h] += tasks[i].followed[h];
            for (int k = 0; k < VIEW_BAKES; k++) {
                render->deviation[h][k] += tasks[i].deviation[h][k];
            }
        }
    }
    free(tasks);
    free(weights);
    render->seconds += clock_seconds(CLOCK_MONOTONIC) - begin;
    render->processor_seconds += clock_seconds(CLOCK_PROCESS_CPUTIME_ID) - processor_begin;
    return LMG_OK;
}

/* Variance of a pixel's mean luminance; NAN with fewer than two samples. */
static double pixel_variance(const view_pixel *p)
{
    return p->samples < 2 ? (double)NAN : p->deviations / ((double)p->samples * (p->samples - 1.0));
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The typical relative noise of a pixel: over blocks of pixels that got light, the median of RMS standard error over mean.  A
 * median, since the few pixels that show the lamp itself can be brighter than all others together. */
static double typical_noise(const view_render *render)
{
    double *ratio = malloc((size_t)render->tiles_x * render->tiles_y * sizeof *ratio);
    size_t count = 0;
    for (uint32_t tile = 0; ratio && tile < render->tiles_x * render->tiles_y; tile++) {
        uint32_t x0 = tile % render->tiles_x * TILE, y0 = tile / render->tiles_x * TILE, n = 0;
        double mean = 0, variance = 0;
        for (uint32_t y = y0; y < y0 + TILE && y < render->options.height; y++) {
            for (uint32_t x = x0; x < x0 + TILE && x < render->options.width; x++) {
                const view_pixel *p = &render->pixels[(size_t)y * render->options.width + x];
                mean += p->mean;
                variance += pixel_variance(p);
                n++;
            }
        }
        if (mean > 0 && !isnan(variance)) {
            ratio[count++] = sqrt(variance / n) / (mean / n);
        }
    }
    double median = (double)NAN;
    if (count) {
        qsort(ratio, count, sizeof *ratio, compare_doubles);
        median = ratio[count / 2];
    }
    free(ratio);
    return median;
}

/* Standard error of the mean luminance from the bakes; 0 as long as one half is empty. */
static double mean_bake_error(const view_render *render)
{
    double half[2][VIEW_BAKES];
    for (int h = 0; h < 2; h++) {
        for (int k = 0; k < VIEW_BAKES; k++) {
            half[h][k] = render->followed[h] ? render->deviation[h][k] / (double)render->followed[h] : 0;
        }
    }
    return view_bake_error(half[0], half[1]);
}

view_render_state view_render_look(const view_render *render)
{
    view_render_state state = {.samples_min = UINT32_MAX,
                               .rays = render->rays,
                               .refused = render->refused,
                               .seconds = render->seconds,
                               .processor_seconds = render->processor_seconds};
    size_t count = (size_t)render->options.width * render->options.height;
    for (size_t i = 0; i < count; i++) {
        const view_pixel *p = &render->pixels[i];
        if (p->samples < state.samples_min) {
            state.samples_min = p->samples;
        }
        if (p->samples > state.samples_max) {
            state.samples_max = p->samples;
        }
        state.mean += p->mean / (double)count;
        state.mean_render += pixel_variance(p) / ((double)count * (double)count);
    }
    state.mean_render = sqrt(state.mean_render);
    state.mean_bake = mean_bake_error(render);
    state.noise = typical_noise(render);
    return state;
}

void view_render_resolve(const view_render *render, view_image *image)
{
    size_t count = (size_t)image->width * image->height;
    for (size_t i = 0; i < count; i++) {
        const view_pixel *p = &render->pixels[i];
        for (int c = 0; c < 3; c++) {
            image->rgb[3 * i + (size_t)c] = p->samples ? (float)(p->sum[c] / p->samples) : 0;
        }
        image->standard_error[i] = (float)sqrt(pixel_variance(p));
    }
}
