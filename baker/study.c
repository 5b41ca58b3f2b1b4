/* SPDX-License-Identifier: Apache-2.0 */
/* The accuracy study: ladders of bakes, judged by the lamp's own rays (judge.c). */
#include "study.h"

#include <luminaires/model.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const double TARGETS[STUDY_TARGETS] = {0.05, 0.02, 0.01, 0.005};
/* Shares of the study's time: the lamp's own rays; the ladder of photons, each rung twice the one before; the ladder of cells; that
 * of photons and rays traced backwards.  What is left goes into judging the boxes. */
static const double REFERENCE_SHARE = 0.22, PHOTON_SHARE = 0.25, CELL_SHARE = 0.2, COMBINED_SHARE = 0.1;
/* The ladders: photons from 1/128 of the largest bake on, cells in steps of four, both in steps of four up to
 * what takes about as long as the largest bake of photons. */
enum { PHOTON_RUNGS = 8, CELL_RUNGS = 4, COMBINED_RUNGS = 4 };
enum { JUDGED = 2 * (PHOTON_RUNGS + CELL_RUNGS) + COMBINED_RUNGS }; /* boxes of photons twice */
static const uint64_t CELLS[CELL_RUNGS] = {250000, 1000000, 4000000, 16000000};
/* Rays that a box is judged by, at least, however short the study: below that the judging's own noise hides errors of ten percent. */
static const uint64_t LEAST_JUDGING = 100000;
/* A bake's own luck moves its error by so much, beyond the noise of judging: no rung is known better. */
static const double LUCK = 0.1;
/* Power laws are followed so many times beyond the largest bake. */
static const double FORETOLD = 100;
static const uint64_t TRIAL = 100000; /* photons that tell the speed */

typedef struct ladder {
    const lum_model *model;
    const study_options *options;
    study *out;
    judge *judge;
    uint64_t judging; /* rays per box */
    char path[1100];  /* of the box being written */
    size_t planned;
} ladder;

static bool stopped(const ladder *l)
{
    return l->options->stop && *l->options->stop;
}

/* -------------------------------------------------------------------------------------------------------------- baking */

const char *study_ladder_name(study_ladder kind)
{
    static const char *const NAMES[STUDY_LADDERS] = {"photons", "cells", "combined"};
    return NAMES[kind];
}

/* A verdict that says nothing. */
static judge_verdict no_verdict(void)
{
    judge_verdict v;
    for (int m = 0; m < JUDGE_MEASURES; ++m)
        v.error[m] = (judge_error){NAN, NAN};
    for (int k = 0; k < JUDGE_DISTANCES; ++k)
        v.planes[k] = (judge_error){NAN, NAN};
    return v;
}

static double processor_clock(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* cells: 0 = as many as the photons are worth. */
static lmg_result bake_rung(ladder *l, study_ladder kind, uint64_t photons, uint64_t cells, lmg_error *err)
{
    study *s = l->out;
    study_rung *rung = &s->rungs[s->rung_count];
    *rung = (study_rung){.ladder = kind, .photons = photons, .plain = no_verdict()};
    const bake_options options = {.photons = photons,
                                  .seed = l->options->seed,
                                  .threads = l->options->threads,
                                  .flux_lm = l->options->flux_lm,
                                  .rays_per_photon = kind == STUDY_COMBINED ? 1 : 0,
                                  .fit = {.cells = cells}};
    lmg_field *field;
    bake_report report;
    const double processor_began = processor_clock();
    lmg_result result = bake_run(l->model, &options, &field, &report, err);
    if (result != LMG_OK)
        return result;
    rung->pilot_seconds = report.pilot_seconds;
    rung->trace_seconds = report.trace_seconds;
    rung->gather_seconds = report.gather_seconds;
    rung->gathered_rays = report.gathered_rays;
    rung->reconstruct_seconds = report.reconstruct_seconds;
    rung->noise = report.noise;
    const lmg_layout *layout = lmg_field_layout(field);
    for (uint32_t i = 0; i < layout->slab_count; ++i) {
        const lmg_slab *slab = &layout->slabs[i];
        rung->cells += (uint64_t)slab->nu * slab->nv * slab->ns * slab->nt;
    }
    const double began = bake_clock();
    result = lmg_field_write_rounded(field, l->path, BAKE_ROUNDING, NULL, err);
    rung->write_seconds = bake_clock() - began;
    rung->processor_seconds = processor_clock() - processor_began;
    struct stat status = {0};
    if (result == LMG_OK && stat(l->path, &status) == 0)
        rung->bytes = (uint64_t)status.st_size;
    unlink(l->path);
    if (result == LMG_OK)
        result = judge_box(l->judge, field, l->judging, &rung->verdict, err);
    if (result == LMG_OK && kind != STUDY_COMBINED) {
        lmg_field_make_constant(field);
        result = judge_box(l->judge, field, l->judging, &rung->plain, err);
    }
    lmg_field_destroy(field);
    if (result == LMG_OK) {
        ++s->rung_count;
        if (l->options->progress)
            l->options->progress(l->options->progress_self, rung, s->rung_count, l->planned);
    }
    return result;
}

double study_rung_seconds(const study_rung *r)
{
    return r->pilot_seconds + r->trace_seconds + r->gather_seconds + r->reconstruct_seconds + r->write_seconds;
}

/* The share of tracing's processor time that depositing takes: the same photons with and without an accumulator, the lesser of three times
 * each. */
static lmg_result measure_deposits(ladder *l, uint64_t photons, lmg_error *err)
{
    bake_source *lamp = judge_lamp(l->judge);
    const lmg_fit_options fit = {.struct_size = sizeof(fit), .bounds_min = lamp->bounds_min, .bounds_max = lamp->bounds_max};
    bake_ray_list *list;
    lmg_result result = bake_ray_list_create(50000, &list, err);
    if (result != LMG_OK)
        return result;
    lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    result = lamp->run(lamp, BAKE_PILOT_FIRST, 50000, l->options->threads, &sink, 1, &tally, err);
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(list, &count);
    lmg_layout layout;
    lmg_accumulator *accumulator = NULL;
    if (result == LMG_OK)
        result = bake_ray_list_check(list, err);
    if (result == LMG_OK)
        result = lmg_layout_fit(rays, count, &fit, &layout, NULL, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &accumulator, err);
    double least[2] = {INFINITY, INFINITY};
    for (int i = 0; result == LMG_OK && i < 6; ++i) {
        const int with = i % 2;
        sink = lmg_accumulator_sink(accumulator);
        const double began = processor_clock();
        result = lamp->run(lamp, 0, photons, l->options->threads, &sink, (size_t)with, &tally, err);
        least[with] = fmin(least[with], processor_clock() - began);
    }
    if (result == LMG_OK)
        l->out->deposit_share = fmax(0, 1 - least[0] / least[1]);
    lmg_accumulator_destroy(accumulator);
    bake_ray_list_destroy(list);
    return result;
}

/* ------------------------------------------------------------------------------------------------------------- fitting */

static study_fit fit_ladder(const study *s, judge_measure m)
{
    double photons[STUDY_MAX_RUNGS], seconds[STUDY_MAX_RUNGS], square[STUDY_MAX_RUNGS], se[STUDY_MAX_RUNGS];
    size_t count = 0;
    for (size_t i = 0; i < s->rung_count; ++i) {
        const study_rung *r = &s->rungs[i];
        const judge_error e = r->verdict.error[m];
        if (r->ladder != STUDY_PHOTONS)
            continue;
        photons[count] = (double)r->photons;
        seconds[count] = r->processor_seconds;
        square[count] = e.rms * fabs(e.rms);
        se[count++] = 2 * fabs(e.rms) * e.standard_error;
    }
    return (study_fit){.over_photons = report_squares_fit(photons, square, se, LUCK, count),
                       .over_seconds = report_squares_fit(seconds, square, se, LUCK, count)};
}

/* By the ladder of photons: what a plain bake of so many photons is off by, how long it takes and how large it is. */
static void give_advice(study *s)
{
    const report_slope error = s->fit[JUDGE_NEAR].over_photons;
    const study_rung *least = NULL, *most = NULL;
    double photons[STUDY_MAX_RUNGS], bytes[STUDY_MAX_RUNGS];
    size_t count = 0;
    for (size_t i = 0; i < s->rung_count; ++i) {
        const study_rung *r = &s->rungs[i];
        if (r->ladder != STUDY_PHOTONS)
            continue;
        least = least ? least : r;
        most = r;
        photons[count] = (double)r->photons;
        bytes[count++] = (double)r->bytes;
    }
    const report_slope size = report_slope_fit(photons, bytes, count);
    for (int t = 0; t < STUDY_TARGETS; ++t) {
        study_advice *a = &s->advice[t];
        *a = (study_advice){.target = TARGETS[t]};
        /* where errors don't fall, as far as one sees, the least bake will do if that in the middle does */
        const double n = error.slope < 0         ? fmax(report_slope_x(error, TARGETS[t]), (double)least->photons)
                         : error.y <= TARGETS[t] ? (double)least->photons
                                                 : (double)NAN;
        if (!(n <= FORETOLD * (double)most->photons))
            continue;
        a->reachable = true;
        a->photons = (uint64_t)ceil(n);
        a->seconds = study_rung_seconds(most) + (n / (double)most->photons - 1) * most->trace_seconds;
        a->bytes = report_slope_y(size, n);
    }
}

/* As one word of a shell. */
static void write_word(char *to, size_t size, const char *word, const char *suffix)
{
    const bool plain = strspn(word, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+,-./:=@_") == strlen(word);
    size_t n = 0;
    if (!plain && n + 1 < size)
        to[n++] = '\'';
    for (; *word && n + 5 < size; ++word) {
        if (*word == '\'') {
            memcpy(to + n, "'\\''", 4);
            n += 4;
        } else {
            to[n++] = *word;
        }
    }
    snprintf(to + n, size - n, "%s%s", suffix, plain ? "" : "'");
}

const char *study_command(const study_advice *a, const char *lamp, char *text, size_t size)
{
    const char *slash = strrchr(lamp, '/'), *name = slash ? slash + 1 : lamp, *dot = strrchr(name, '.');
    char model[1100], stem[300], box[350];
    snprintf(stem, sizeof(stem), "%.*s", (int)(dot && dot > name ? dot - name : (long)strlen(name)), name);
    write_word(model, sizeof(model), lamp, "");
    write_word(box, sizeof(box), stem, ".box.exr");
    /* two digits, rounded up; not for what rounding of the quotient, of some 1e-16 of at most 100, adds to a whole number */
    const double unit = pow(10, floor(log10((double)a->photons)) - 1);
    snprintf(text, size, "lumibake bake %s --photons %.2g -o %s", model, ceil((double)a->photons / unit - 1e-9) * unit, box);
    return text;
}

/* ----------------------------------------------------------------------------------------------------------------- run */

/* Measures the lamp; rates come from a trial: photons per second of the lamp with all receivers, and of bakes. */
static lmg_result measure_reference(ladder *l, lmg_error *err)
{
    study *s = l->out;
    const study_options *o = l->options;
    bake_source *lamp = judge_lamp(l->judge);
    double began = bake_clock();
    lmg_result result = judge_measure_lamp(l->judge, TRIAL, err);
    const double measuring = (double)TRIAL / fmax(bake_clock() - began, 1e-6);
    if (result == LMG_OK) {
        bake_tally tally = {0};
        began = bake_clock();
        result = lamp->run(lamp, BAKE_PILOT_FIRST, TRIAL, o->threads, NULL, 0, &tally, err);
        s->photons_per_second = 0.8 * (double)TRIAL / fmax(bake_clock() - began, 1e-6); /* deposits take about a fifth */
    }
    if (result != LMG_OK)
        return result;
    s->reference_photons = (uint64_t)(REFERENCE_SHARE * o->seconds * measuring);
    if (s->reference_photons < 4 * LEAST_JUDGING)
        s->reference_photons = 4 * LEAST_JUDGING;
    const double left = 1 - REFERENCE_SHARE - PHOTON_SHARE - CELL_SHARE - COMBINED_SHARE;
    l->judging = (uint64_t)(left * o->seconds * measuring / JUDGED);
    if (l->judging < LEAST_JUDGING)
        l->judging = LEAST_JUDGING;
    result = judge_measure_lamp(l->judge, s->reference_photons, err);
    for (int m = 0; result == LMG_OK && m < JUDGE_MEASURES; ++m)
        s->reference_noise[m] = judge_noise(l->judge, (judge_measure)m);
    return result;
}

/* Photons and rays traced backwards; a lamp whose light can't be traced so goes without. */
static lmg_result climb_combined(ladder *l, lmg_error *err)
{
    study *s = l->out;
    /* A ladder in steps of four takes four thirds of its highest rung, and a ray about as long as a photon (docs/accuracy.md). */
    const double largest = fmax(COMBINED_SHARE * l->options->seconds * 3 / 8 * s->photons_per_second, 64 * 2000);
    for (int i = 0; !stopped(l) && i < COMBINED_RUNGS; ++i) {
        lmg_error why = {{0}};
        const lmg_result result =
            bake_rung(l, STUDY_COMBINED, (uint64_t)(largest / (double)(1 << 2 * (COMBINED_RUNGS - 1 - i))), 0, &why);
        if (result == LMG_ERROR_UNSUPPORTED) {
            snprintf(s->combined_why, sizeof(s->combined_why), "%.199s", why.message);
            return LMG_OK;
        }
        if (result != LMG_OK)
            return lmg_fail(err, result, "%s", why.message);
    }
    return LMG_OK;
}

static lmg_result climb(ladder *l, lmg_error *err)
{
    study *s = l->out;
    const double seconds = l->options->seconds;
    const double largest = fmax(PHOTON_SHARE * seconds / 2 * s->photons_per_second, 128 * 2000);
    lmg_result result = LMG_OK;
    l->planned = PHOTON_RUNGS + CELL_RUNGS + COMBINED_RUNGS;
    for (int i = 0; result == LMG_OK && !stopped(l) && i < PHOTON_RUNGS; ++i)
        result = bake_rung(l, STUDY_PHOTONS, (uint64_t)(largest / (double)(1 << (PHOTON_RUNGS - 1 - i))), 0, err);
    if (result == LMG_OK && s->rung_count > 0) {
        const study_rung *top = &s->rungs[s->rung_count - 1];
        s->photons_per_second = (double)top->photons / study_rung_seconds(top);
    }
    const double each = fmax(CELL_SHARE * seconds / CELL_RUNGS * s->photons_per_second, 1e5);
    for (int i = 0; result == LMG_OK && !stopped(l) && i < CELL_RUNGS; ++i)
        result = bake_rung(l, STUDY_CELLS, (uint64_t)each, CELLS[i], err);
    if (result == LMG_OK)
        result = climb_combined(l, err);
    if (result == LMG_OK && s->rung_count < 3)
        result = lmg_fail(err, LMG_ERROR_INPUT, "interrupted before there was anything to say");
    if (result == LMG_OK)
        result = measure_deposits(l, (uint64_t)fmin(0.25 * s->photons_per_second, 1e7), err);
    return result;
}

lmg_result study_run(const struct lum_model *model, const study_options *options, study *out, lmg_error *err)
{
    memset(out, 0, sizeof(*out));
    ladder l = {.model = model, .options = options, .out = out};
    if ((size_t)snprintf(l.path, sizeof(l.path), "%s/lumibake-study-%ld.box.exr", options->folder, (long)getpid()) >= sizeof(l.path))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%.200s...: too long a folder", options->folder);
    lmg_result result = judge_create(model, options->seed, options->flux_lm, options->threads, &l.judge, err);
    if (result != LMG_OK)
        return result;
    out->size = judge_size(l.judge);
    out->axis = judge_axis(l.judge);
    result = measure_reference(&l, err);
    if (result == LMG_OK)
        result = climb(&l, err);
    if (result == LMG_OK) {
        for (int m = 0; m < JUDGE_MEASURES; ++m)
            out->fit[m] = fit_ladder(out, (judge_measure)m);
        give_advice(out);
    }
    judge_destroy(l.judge);
    return result;
}
