/* SPDX-License-Identifier: Apache-2.0 */
/* The ladders of pictures and their statistics; what they mean stands in room_study.h. */
#include "room_study.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* Shares of the study's time; the rest is the geometry's. */
static const double BOX_SHARE = 0.4;
/* How long a trial of a method's speed takes, seconds but no more than a share of the time, and the samples that it ends at. */
static const double TRIAL_SECONDS = 1, TRIAL_SHARE = 0.02;
enum { TRIAL_MOST = 1024 };
/* Samples of the highest rung, at least, however short the time: three rungs. */
enum { LEAST_SAMPLES = 4 };
/* Blocks that are darker than the picture's mean times this are left out: nobody sees what goes on there. */
static const double DARK = 1e-3;

const char *view_study_method_name(view_study_method method)
{
    return method == VIEW_STUDY_BOX ? "box" : "geometry";
}

typedef struct ladder {
    const view_scene *scene[VIEW_STUDY_METHODS];
    const view_camera *camera;
    const view_study_options *options;
    view_study *out;
    uint32_t across, blocks;           /* in a row; in all */
    char *skip;                        /* of each block: left out */
    double *reference;                 /* mean luminance of each block */
    double *means[VIEW_STUDY_METHODS]; /* of each rung, run and block over the reference's */
    double *scratch;                   /* blocks numbers */
} ladder;

static double *means_of(const ladder *l, view_study_method m, size_t rung, uint32_t run)
{
    return l->means[m] + (rung * l->options->runs + run) * l->blocks;
}

static bool stopped(const ladder *l)
{
    return l->options->stop && atomic_load(l->options->stop);
}

/* ------------------------------------------------------------------------------------------------------------- pictures */

/* Mean luminance of each block of a new picture, and the processor time that it took. */
static lmg_result render_blocks(const ladder *l, view_study_method m, uint32_t samples, uint64_t seed, double *block,
                                double *seconds, lmg_error *err)
{
    const view_study_options *o = l->options;
    view_render *render = NULL;
    view_image image = {0};
    const view_render_options options = {
        .width = o->width, .height = o->height, .seed = seed, .threads = o->threads, .path = o->path};
    lmg_result r = view_render_create(l->scene[m], l->camera, &options, &render, err);
    r = r ? r : view_render_pass(render, samples, o->stop, err);
    r = r ? r : view_image_create(o->width, o->height, &image, err);
    if (r == LMG_OK) {
        view_render_resolve(render, &image);
        *seconds = view_render_look(render).processor_seconds;
        for (uint32_t b = 0; b < l->blocks; b++) {
            uint32_t x0 = b % l->across * o->block, y0 = b / l->across * o->block;
            block[b] = 0;
            for (uint32_t i = 0; i < o->block * o->block; i++) {
                block[b] += lmg_luminance(&image.rgb[3 * ((size_t)(y0 + i / o->block) * o->width + x0 + i % o->block)]);
            }
            block[b] /= (double)o->block * o->block;
        }
    }
    view_image_free(&image);
    view_render_destroy(render);
    return r;
}

/* Seeds that no two pictures of a study share, and that studies of neighbouring seeds don't share either. */
static uint64_t seed_of(const ladder *l, uint64_t kind, uint64_t number)
{
    /* Whole numbers up to 2^53 come through JSON and doubles as they are. */
    return lum_mix64(lum_mix64(l->options->seed + 0x51) ^ (kind << 32 | number)) >> 11;
}

enum { SEED_TRIAL = VIEW_STUDY_METHODS, SEED_REFERENCE };

/* --------------------------------------------------------------------------------------------------------------- blocks */

/* Marks the blocks whose sight meets the bounds of a box, by a margin of a block. */
static void skip_lamps(ladder *l)
{
    const view_study_options *o = l->options;
    const int64_t block = o->block, across = l->across, down = l->blocks / l->across;
    for (int64_t y = -block; y < o->height + block; y++) {
        for (int64_t x = -block; x < o->width + block; x++) {
            lmg_vec3 d = view_camera_direction(l->camera, (double)x + 0.5, (double)y + 0.5, o->width, o->height);
            double t;
            bool meets = false;
            for (uint32_t i = 0; i < l->scene[VIEW_STUDY_BOX]->box_count && !meets; i++) {
                meets = view_box_enter(l->scene[VIEW_STUDY_BOX], i, l->camera->eye, d, &t);
            }
            for (int64_t k = 0; meets && k < 9; k++) {
                int64_t bx = (x + block) / block - 1 + k % 3 - 1, by = (y + block) / block - 1 + k / 3 - 1;
                if (bx >= 0 && by >= 0 && bx < across && by < down) {
                    l->skip[by * across + bx] = 1;
                }
            }
        }
    }
    for (uint32_t b = 0; b < l->blocks; b++) {
        l->out->lamp_blocks += l->skip[b] != 0;
    }
}

/* The reference in two halves. */
static lmg_result make_reference(ladder *l, uint32_t samples, lmg_error *err)
{
    view_study *s = l->out;
    double *other = l->scratch, mean = 0, seconds[2] = {0, 0};
    s->reference_samples = samples;
    for (int h = 0; h < 2; h++) {
        s->reference_seed[h] = seed_of(l, SEED_REFERENCE, (uint64_t)h);
        lmg_result r =
            render_blocks(l, VIEW_STUDY_BOX, samples / 2, s->reference_seed[h], h ? other : l->reference, &seconds[h], err);
        if (r != LMG_OK) {
            return r;
        }
    }
    s->reference_seconds = seconds[0] + seconds[1];
    if (stopped(l)) {
        return LMG_OK;
    }
    for (uint32_t b = 0; b < l->blocks; b++) {
        const double half = 0.5 * (l->reference[b] - other[b]);
        l->reference[b] = 0.5 * (l->reference[b] + other[b]);
        other[b] = half;
        mean += l->skip[b] ? 0 : l->reference[b] / (double)(l->blocks - s->lamp_blocks);
    }
    double square = 0;
    for (uint32_t b = 0; b < l->blocks; b++) {
        if (!l->skip[b] && !(l->reference[b] > DARK * mean)) {
            l->skip[b] = 1;
            s->dark_blocks++;
        }
        if (!l->skip[b]) {
            square += other[b] * other[b] / (l->reference[b] * l->reference[b]);
            s->blocks++;
        }
    }
    if (!s->blocks) {
        return lmg_fail(err, LMG_ERROR_INPUT,
                        "no part of the picture is lit without showing the lamp itself: nothing to compare; choose another camera");
    }
    s->reference_noise = sqrt(square / s->blocks);
    return LMG_OK;
}

/* ----------------------------------------------------------------------------------------------------------- statistics */

static int compare_doubles(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *values, size_t count)
{
    qsort(values, count, sizeof *values, compare_doubles);
    return values[count / 2];
}

static double signed_root(double square)
{
    return square >= 0 ? sqrt(square) : -sqrt(-square);
}

static view_study_error root_of(double square, double se)
{
    const double rms = signed_root(square);
    /* d sqrt(x) = dx / (2 sqrt(x)); below its own error a square says no more than that its root is less than that of the error. */
    return (view_study_error){rms, se / (2 * fmax(fabs(rms), sqrt(0.5 * se)))};
}

/* The mean and standard error of count numbers. */
static double mean_of(const double *x, size_t count, double *se)
{
    double mean = 0, squares = 0;
    for (size_t i = 0; i < count; i++) {
        mean += x[i] / (double)count;
    }
    for (size_t i = 0; i < count; i++) {
        squares += (x[i] - mean) * (x[i] - mean);
    }
    *se = sqrt(squares / ((double)count * ((double)count - 1)));
    return mean;
}

static void finish_rung(ladder *l, view_study_method m, size_t k)
{
    view_study *s = l->out;
    view_study_rung *rung = &s->of[m].rungs[k];
    size_t used = 0;
    for (uint32_t i = 0; i < s->runs; i++) {
        rung->run[i] = -s->reference_noise * s->reference_noise;
    }
    for (uint32_t b = 0; b < l->blocks; b++) {
        double sum = 0;
        for (uint32_t i = 0; i < s->runs && !l->skip[b]; i++) {
            const double d = means_of(l, m, k, i)[b] - 1;
            rung->run[i] += d * d / s->blocks;
            sum += d * d / s->runs;
        }
        if (!l->skip[b]) {
            l->scratch[used++] = sum;
        }
    }
    rung->median = sqrt(median(l->scratch, used));
    double se;
    const double square = mean_of(rung->run, s->runs, &se);
    rung->error = root_of(square, se);
}

/* The squared difference of the geometry from the reference, from all runs but one (without; no run: runs): the square of the
 * mean over all its pictures, less what noise makes of that. */
static double squared_difference(const ladder *l, uint32_t without)
{
    const view_study *s = l->out;
    const view_study_result *g = &s->of[VIEW_STUDY_GEOMETRY];
    const double runs = s->runs - (without < s->runs);
    double all = 0, sum = 0;
    for (size_t k = 0; k < g->rung_count; k++) {
        all += g->rungs[k].samples;
    }
    for (uint32_t b = 0; b < l->blocks; b++) {
        double mean = 0, variance = 0;
        for (size_t k = 0; k < g->rung_count && !l->skip[b]; k++) {
            double x = 0, xx = 0;
            for (uint32_t i = 0; i < s->runs; i++) {
                const double d = i == without ? 0 : means_of(l, VIEW_STUDY_GEOMETRY, k, i)[b] - 1;
                x += d;
                xx += d * d;
            }
            const double weight = g->rungs[k].samples / all;
            mean += weight * x / runs;
            variance += weight * weight * fmax(0, xx - x * x / runs) / (runs * (runs - 1));
        }
        sum += mean * mean - variance;
    }
    return sum / s->blocks - s->reference_noise * s->reference_noise;
}

/* Squared error x time without one run (none: runs), rungs weighted with samples: the squares of high rungs are the means of more
 * luck. */
static double cost_of(const ladder *l, view_study_method m, uint32_t without)
{
    const view_study_result *r = &l->out->of[m];
    const double runs = l->out->runs - (without < l->out->runs);
    double sum = 0, weights = 0;
    for (size_t k = 0; k < r->rung_count; k++) {
        double square = 0;
        for (uint32_t i = 0; i < l->out->runs; i++) {
            square += i == without ? 0 : r->rungs[k].run[i] / runs;
        }
        sum += r->rungs[k].samples * square * r->rungs[k].seconds;
        weights += r->rungs[k].samples;
    }
    return sum / weights;
}

/* The standard error of a statistic by leaving out a run at a time (jackknife). */
static double jackknife(const ladder *l, view_study_method m, double (*statistic)(const ladder *, view_study_method, uint32_t))
{
    double values[VIEW_STUDY_MAX_RUNS], se;
    const uint32_t runs = l->out->runs;
    for (uint32_t i = 0; i < runs; i++) {
        values[i] = statistic(l, m, i);
    }
    mean_of(values, runs, &se);
    return (runs - 1) * se;
}

static double difference_of(const ladder *l, view_study_method m, uint32_t without)
{
    (void)m;
    return squared_difference(l, without);
}

static double median_cost(const ladder *l, view_study_method m)
{
    const view_study *s = l->out;
    const view_study_result *r = &s->of[m];
    size_t used = 0;
    double weights = 0;
    for (size_t k = 0; k < r->rung_count; k++) {
        weights += r->rungs[k].samples;
    }
    for (uint32_t b = 0; b < l->blocks; b++) {
        double sum = 0;
        for (size_t k = 0; k < r->rung_count && !l->skip[b]; k++) {
            for (uint32_t i = 0; i < s->runs; i++) {
                const double d = means_of(l, m, k, i)[b] - 1;
                sum += r->rungs[k].samples / weights * d * d * r->rungs[k].seconds / s->runs;
            }
        }
        if (!l->skip[b]) {
            l->scratch[used++] = sum;
        }
    }
    return median(l->scratch, used);
}

static void finish_study(const ladder *l)
{
    view_study *s = l->out;
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        view_study_result *r = &s->of[m];
        double seconds[VIEW_STUDY_MAX_RUNGS], samples[VIEW_STUDY_MAX_RUNGS];
        double error[VIEW_STUDY_MAX_RUNGS], medians[VIEW_STUDY_MAX_RUNGS];
        for (size_t k = 0; k < r->rung_count; k++) {
            seconds[k] = r->rungs[k].seconds;
            samples[k] = r->rungs[k].samples;
            error[k] = r->rungs[k].error.rms;
            medians[k] = r->rungs[k].median;
        }
        r->over_seconds = report_slope_fit(seconds, error, r->rung_count);
        r->over_samples = report_slope_fit(samples, error, r->rung_count);
        r->median_over_seconds = report_slope_fit(seconds, medians, r->rung_count);
        r->cost = cost_of(l, (view_study_method)m, s->runs);
        r->cost_se = jackknife(l, (view_study_method)m, cost_of);
        r->cost_median = median_cost(l, (view_study_method)m);
    }
    const view_study_result *box = &s->of[VIEW_STUDY_BOX], *geometry = &s->of[VIEW_STUDY_GEOMETRY];
    s->ratio = geometry->cost / box->cost;
    s->ratio_se = fabs(s->ratio) * hypot(geometry->cost_se / geometry->cost, box->cost_se / box->cost);
    s->ratio_median = geometry->cost_median / box->cost_median;
    s->difference = root_of(squared_difference(l, s->runs), jackknife(l, VIEW_STUDY_GEOMETRY, difference_of));
}

/* ------------------------------------------------------------------------------------------------------------------ run */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Seconds by the wall clock that a sample of every pixel takes. */
static lmg_result try_speed(const ladder *l, view_study_method m, double *per_sample, lmg_error *err)
{
    for (uint32_t samples = 1;; samples *= 2) {
        double unused;
        const double began = now();
        lmg_result r = render_blocks(l, m, samples, seed_of(l, SEED_TRIAL, m), l->scratch, &unused, err);
        const double took = now() - began;
        if (r != LMG_OK || took > fmin(TRIAL_SECONDS, TRIAL_SHARE * l->options->seconds) || samples >= TRIAL_MOST || stopped(l)) {
            *per_sample = took / samples;
            return r;
        }
    }
}

/* Samples of the highest rung of each method: as asked for, or the largest power of two that keeps to the time. */
static lmg_result choose_samples(const ladder *l, uint32_t samples[VIEW_STUDY_METHODS], lmg_error *err)
{
    const view_study_options *o = l->options;
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        samples[m] = o->samples[m];
        if (samples[m]) {
            continue;
        }
        double per_sample;
        lmg_result r = try_speed(l, (view_study_method)m, &per_sample, err);
        if (r != LMG_OK) {
            return r;
        }
        const double share = m == VIEW_STUDY_BOX ? BOX_SHARE : 1 - BOX_SHARE;
        /* A ladder costs twice its highest rung. */
        const double pictures = 2.0 * o->runs + (m == VIEW_STUDY_BOX ? VIEW_STUDY_REFERENCE : 0);
        const double most = fmin(share * o->seconds / (per_sample * pictures), (double)(UINT32_MAX / 2 / VIEW_STUDY_REFERENCE));
        samples[m] = LEAST_SAMPLES;
        while (2.0 * samples[m] <= most) {
            samples[m] *= 2;
        }
    }
    return LMG_OK;
}

/* One rung; it counts once it is complete. */
static lmg_result climb(ladder *l, view_study_method m, uint32_t samples, size_t all, lmg_error *err)
{
    view_study *s = l->out;
    view_study_result *of = &s->of[m];
    const size_t k = of->rung_count;
    view_study_rung *rung = &of->rungs[k];
    *rung = (view_study_rung){.samples = samples};
    for (uint32_t i = 0; i < s->runs; i++) {
        double *block = means_of(l, m, k, i), seconds;
        rung->seed[i] = seed_of(l, (uint64_t)m, k * VIEW_STUDY_MAX_RUNS + i);
        lmg_result r = render_blocks(l, m, samples, rung->seed[i], block, &seconds, err);
        if (r != LMG_OK || stopped(l)) {
            return r;
        }
        rung->seconds += seconds / s->runs;
        for (uint32_t b = 0; b < l->blocks; b++) {
            block[b] /= l->skip[b] ? 1 : l->reference[b];
        }
    }
    finish_rung(l, m, k);
    of->rung_count++;
    if (l->options->progress) {
        l->options->progress(l->options->progress_self, m, rung, s->of[0].rung_count + s->of[1].rung_count, all);
    }
    return LMG_OK;
}

static lmg_result run_ladders(ladder *l, lmg_error *err)
{
    const view_study_options *o = l->options;
    view_study *s = l->out;
    uint32_t samples[VIEW_STUDY_METHODS];
    lmg_result r = choose_samples(l, samples, err);
    if (r != LMG_OK) {
        return r;
    }
    uint32_t rungs[VIEW_STUDY_METHODS];
    size_t all = 0;
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        for (rungs[m] = 1; rungs[m] < o->rungs && samples[m] >> rungs[m];) {
            rungs[m]++;
        }
        all += rungs[m];
    }
    skip_lamps(l);
    if (!stopped(l)) {
        r = make_reference(l, samples[VIEW_STUDY_BOX] * VIEW_STUDY_REFERENCE, err);
    }
    /* From the cheap end, one method after the other: an interrupted study has something of both. */
    for (uint32_t k = 0; k < o->rungs; k++) {
        for (int m = 0; m < VIEW_STUDY_METHODS && r == LMG_OK; m++) {
            if (k < rungs[m] && !stopped(l)) {
                r = climb(l, (view_study_method)m, samples[m] >> (rungs[m] - 1 - k), all, err);
            }
        }
    }
    if (r == LMG_OK && (!s->of[VIEW_STUDY_BOX].rung_count || !s->of[VIEW_STUDY_GEOMETRY].rung_count)) {
        r = lmg_fail(err, LMG_ERROR_INPUT, "interrupted before there was anything to say");
    }
    if (r == LMG_OK) {
        finish_study(l);
    }
    return r;
}

static lmg_result check(const view_scene *boxed, const view_scene *built, const view_study_options *o, lmg_error *err)
{
    if (o->block < 1 || o->width / o->block < 2 || o->height / o->block < 2) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a picture of %u x %u pixels has fewer than two blocks of %u pixels each way",
                        o->width, o->height, o->block);
    }
    if (o->runs < 3 || o->runs > VIEW_STUDY_MAX_RUNS) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%u pictures of each kind: should be 3 to %d", o->runs, VIEW_STUDY_MAX_RUNS);
    }
    if (o->rungs < 1 || o->rungs > VIEW_STUDY_MAX_RUNGS) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%u numbers of samples: should be 1 to %d", o->rungs, VIEW_STUDY_MAX_RUNGS);
    }
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        if (o->samples[m] > UINT32_MAX / VIEW_STUDY_REFERENCE || (!o->samples[m] && !(o->seconds > 0))) {
            return lmg_fail(err, LMG_ERROR_ARGUMENT,
                            "%u samples per pixel and %g s: samples should be at most %u, or time more than 0", o->samples[m],
                            o->seconds, UINT32_MAX / VIEW_STUDY_REFERENCE);
        }
    }
    if (!boxed->box_count) {
        return lmg_fail(err, LMG_ERROR_INPUT, "no box lights the room");
    }
    bool lamp = false;
    for (uint32_t i = 0; i < built->object_count; i++) {
        lamp = lamp || built->objects[i].lamp;
    }
    return lamp ? LMG_OK : lmg_fail(err, LMG_ERROR_INPUT, "no lamp's geometry lights the room");
}

lmg_result view_study_run(const view_scene *boxed, const view_scene *built, const view_camera *camera,
                          const view_study_options *options, view_study *out, lmg_error *err)
{
    memset(out, 0, sizeof *out);
    lmg_result r = check(boxed, built, options, err);
    if (r != LMG_OK) {
        return r;
    }
    out->width = options->width;
    out->height = options->height;
    out->block = options->block;
    out->runs = options->runs;
    ladder l = {
        .scene = {boxed, built}, .camera = camera, .options = options, .out = out, .across = options->width / options->block};
    l.blocks = l.across * (options->height / options->block);
    const size_t pictures = (size_t)options->rungs * options->runs;
    l.skip = calloc(l.blocks, sizeof *l.skip);
    l.reference = calloc(l.blocks, sizeof *l.reference);
    l.scratch = calloc(l.blocks, sizeof *l.scratch);
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        l.means[m] = calloc(pictures * l.blocks, sizeof *l.means[m]);
    }
    if (l.skip && l.reference && l.scratch && l.means[0] && l.means[1]) {
        r = run_ladders(&l, err);
    } else {
        r = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a study of %u blocks", l.blocks);
    }
    free(l.skip);
    free(l.reference);
    free(l.scratch);
    free(l.means[0]);
    free(l.means[1]);
    return r;
}
