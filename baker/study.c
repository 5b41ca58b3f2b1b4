/* SPDX-License-Identifier: Apache-2.0 */
/* The accuracy study: ladders of bakes, judged by the receivers of the comparison (compare.c). */
#include "study.h"

#include "compare_inside.h"

#include <luminaires/model.h>
#include <luminaires/rng.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const double DISTANCES[STUDY_DISTANCES] = {0.5, 1, 2, 5, 10};
static const double TARGETS[STUDY_TARGETS] = {0.05, 0.02, 0.01, 0.005};
/* Shares of the study's time: the lamp's own rays; the ladder of photons, each rung twice the one before; the ladder of cells.  What is
 * left goes into judging the boxes. */
static const double REFERENCE_SHARE = 0.25, PHOTON_SHARE = 0.3, CELL_SHARE = 0.25;
/* The ladders: photons from 1/128 of the largest bake on, cells in steps of four around the default. */
enum { PHOTON_RUNGS = 8, CELL_RUNGS = 4 };
static const uint64_t CELLS[CELL_RUNGS] = {250000, 1000000, 4000000, 16000000};
static const uint64_t DEFAULT_CELLS = 4000000;
/* Rays that a box is judged by, at least, however short the study: below that the judging's own noise hides errors of ten percent. */
static const uint64_t LEAST_JUDGING = 100000;
static const uint64_t TRIAL = 100000; /* photons that tell the speed */

const char *study_measure_name(study_measure m)
{
    static const char *const NAMES[STUDY_MEASURES] = {"near-field illuminance", "far-field intensity", "luminance pictures"};
    return NAMES[m];
}

typedef struct ladder {
    const lum_model *model;
    const study_options *options;
    study *out;
    bake_source *lamp;
    instrument instrument;
    measured reference;
    uint64_t judging; /* rays per box */
    char path[1100];  /* of the box being written */
    size_t planned;
} ladder;

static bool stopped(const ladder *l)
{
    return l->options->stop && *l->options->stop;
}

/* ------------------------------------------------------------------------------------------------------------- judging */

static study_error error_of(const bake_difference *d)
{
    return (study_error){d->rms, d->standard_error};
}

/* The root of the mean of squares of several errors; a negative rms stands for a negative square, all noise. */
static study_error together(const study_error *e, size_t count)
{
    double sum = 0, variance = 0;
    for (size_t i = 0; i < count; ++i) {
        sum += e[i].rms * fabs(e[i].rms) / (double)count;
        variance += 4 * e[i].rms * e[i].rms * e[i].standard_error * e[i].standard_error / (double)(count * count);
    }
    const double rms = sum >= 0 ? sqrt(sum) : -sqrt(-sum);
    return (study_error){rms, rms != 0 ? sqrt(variance) / (2 * fabs(rms)) : 0};
}

static lmg_result judge(ladder *l, const lmg_field *field, study_rung *rung, lmg_error *err)
{
    bake_source *box;
    lmg_result result = bake_box_source_create(field, lum_mix64(l->options->seed + 0x62), &box, err);
    if (result != LMG_OK)
        return result;
    measured m = {0};
    bake_tally tally = {0};
    const size_t planes = l->instrument.plane_count;
    result = measure_source(box, &l->instrument, planes + RECEIVERS, &BAKE_NO_MOTION, 0, l->judging, l->options->threads, &m, NULL, &tally, err);
    if (result == LMG_OK) {
        for (size_t i = 0; i < planes; ++i) {
            const bake_difference d = differ(&m.of[i], &l->reference.of[i]);
            rung->planes[i] = error_of(&d);
        }
        const bake_difference far = differ(&m.of[planes + FAR_FIELD], &l->reference.of[planes + FAR_FIELD]);
        study_error views[BAKE_VIEWS];
        for (size_t i = 0; i < BAKE_VIEWS; ++i) {
            const bake_difference d = differ(&m.of[planes + PICTURES + i], &l->reference.of[planes + PICTURES + i]);
            views[i] = error_of(&d);
        }
        rung->error[STUDY_NEAR] = together(rung->planes, planes);
        rung->error[STUDY_FAR] = error_of(&far);
        rung->error[STUDY_LUMINANCE] = together(views, BAKE_VIEWS);
    }
    measured_release(&m);
    box->destroy(box);
    return result;
}

/* -------------------------------------------------------------------------------------------------------------- baking */

static lmg_result bake_rung(ladder *l, bool resolution, uint64_t photons, uint64_t cells, lmg_error *err)
{
    study *s = l->out;
    study_rung *rung = &s->rungs[s->rung_count];
    *rung = (study_rung){.resolution = resolution, .photons = photons, .cells_asked = cells};
    const bake_options options = {.photons = photons,
                                  .seed = l->options->seed,
                                  .threads = l->options->threads,
                                  .flux_lm = l->options->flux_lm,
                                  .fit = {.cells = cells}};
    lmg_field *field;
    bake_report report;
    lmg_result result = bake_run(l->model, &options, &field, &report, err);
    if (result != LMG_OK)
        return result;
    rung->pilot_seconds = report.pilot_seconds;
    rung->trace_seconds = report.trace_seconds;
    rung->reconstruct_seconds = report.reconstruct_seconds;
    rung->noise = report.noise;
    const lmg_layout *layout = lmg_field_layout(field);
    for (uint32_t i = 0; i < layout->slab_count; ++i) {
        const lmg_slab *slab = &layout->slabs[i];
        rung->cells += (uint64_t)slab->nu * slab->nv * slab->ns * slab->nt;
    }
    const double began = bake_clock();
    result = lmg_field_write(field, l->path, err);
    rung->write_seconds = bake_clock() - began;
    struct stat status = {0};
    if (result == LMG_OK && stat(l->path, &status) == 0)
        rung->bytes = (uint64_t)status.st_size;
    unlink(l->path);
    if (result == LMG_OK)
        result = judge(l, field, rung, err);
    lmg_field_destroy(field);
    if (result == LMG_OK) {
        ++s->rung_count;
        if (l->options->progress)
            l->options->progress(l->options->progress_self, rung, s->rung_count, l->planned);
    }
    return result;
}

static double rung_seconds(const study_rung *r)
{
    return r->pilot_seconds + r->trace_seconds + r->reconstruct_seconds + r->write_seconds;
}

/* The share of tracing's time that depositing takes: the same photons with and without an accumulator, the lesser of three times each. */
static lmg_result measure_deposits(ladder *l, uint64_t photons, lmg_error *err)
{
    const lmg_fit_options fit = {.struct_size = sizeof(fit), .bounds_min = l->lamp->bounds_min, .bounds_max = l->lamp->bounds_max};
    bake_ray_list *list;
    lmg_result result = bake_ray_list_create(50000, &list, err);
    if (result != LMG_OK)
        return result;
    lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    result = l->lamp->run(l->lamp, BAKE_PILOT_FIRST, 50000, l->options->threads, &sink, 1, &tally, err);
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(list, &count);
    lmg_layout layout;
    lmg_accumulator *accumulator = NULL;
    if (result == LMG_OK)
        result = lmg_layout_fit(rays, count, &fit, &layout, NULL, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &accumulator, err);
    double least[2] = {INFINITY, INFINITY};
    for (int i = 0; result == LMG_OK && i < 6; ++i) {
        const int with = i % 2;
        sink = lmg_accumulator_sink(accumulator);
        const double began = bake_clock();
        result = l->lamp->run(l->lamp, 0, photons, l->options->threads, &sink, (size_t)with, &tally, err);
        least[with] = fmin(least[with], bake_clock() - began);
    }
    if (result == LMG_OK)
        l->out->deposit_share = fmax(0, 1 - least[0] / least[1]);
    lmg_accumulator_destroy(accumulator);
    bake_ray_list_destroy(list);
    return result;
}

/* ------------------------------------------------------------------------------------------------------------- fitting */

/* Least squares of error^2 = scale / n + floor^2 with both terms >= 0, weights from the errors of the errors, and the slope of
 * log(error) over log(n) with its standard error from the residuals. */
static study_fit fit_ladder(const study *s, study_measure m)
{
    double w0 = 0, wx = 0, wxx = 0, wy = 0, wxy = 0;
    double l0 = 0, lx = 0, lxx = 0, ly = 0, lxy = 0, lyy = 0;
    for (size_t i = 0; i < s->rung_count; ++i) {
        const study_rung *r = &s->rungs[i];
        const study_error e = r->error[m];
        if (r->resolution || !isfinite(e.rms))
            continue;
        const double x = 1 / (double)r->photons, y = e.rms * fabs(e.rms);
        /* Relative weights: no rung is known better than to 5 %, as the errors' errors leave out how a bake's own luck moves it. */
        const double se = hypot(2 * fabs(e.rms) * e.standard_error, 0.1 * fabs(y)), w = se > 0 ? 1 / (se * se) : 0;
        w0 += w, wx += w * x, wxx += w * x * x, wy += w * y, wxy += w * x * y;
        if (e.rms > 0) {
            const double a = log((double)r->photons), b = log(e.rms);
            l0 += 1, lx += a, lxx += a * a, ly += b, lxy += a * b, lyy += b * b;
        }
    }
    study_fit f = {.scale = NAN, .floor = NAN, .slope = NAN, .slope_se = NAN};
    const double determinant = w0 * wxx - wx * wx;
    if (determinant > 0) {
        f.scale = (w0 * wxy - wx * wy) / determinant;
        double square = (wxx * wy - wx * wxy) / determinant;
        if (square < 0) { /* all noise */
            square = 0;
            f.scale = wxy / wxx;
        } else if (f.scale < 0) { /* all floor */
            f.scale = 0;
            square = wy / w0;
        }
        f.floor = sqrt(square);
    }
    const double spread = l0 * lxx - lx * lx;
    if (l0 >= 3 && spread > 0) {
        f.slope = (l0 * lxy - lx * ly) / spread;
        const double intercept = (ly - f.slope * lx) / l0;
        const double residual = lyy - intercept * ly - f.slope * lxy;
        f.slope_se = sqrt(fmax(residual, 0) / (l0 - 2) * l0 / spread);
    }
    return f;
}

/* For each target the rung of the ladder of cells (its floor: its error without the noise that the fit gives its photons) that
 * reaches it in the shortest time, and the photons for that. */
static void give_advice(study *s)
{
    const study_fit *f = &s->fit[STUDY_NEAR];
    for (int t = 0; t < STUDY_TARGETS; ++t) {
        study_advice *a = &s->advice[t];
        *a = (study_advice){.target = TARGETS[t]};
        for (size_t i = 0; i < s->rung_count; ++i) {
            const study_rung *r = &s->rungs[i];
            if (!r->resolution || !(f->scale >= 0))
                continue;
            /* A standard error to be on the safe side: what is hardly known mustn't come out as good. */
            const double e = r->error[STUDY_NEAR].rms + r->error[STUDY_NEAR].standard_error;
            const double floor2 = fmax(0, e * fabs(e) - f->scale / (double)r->photons);
            const double room = TARGETS[t] * TARGETS[t] - floor2;
            if (!(room > 0))
                continue;
            const double photons = fmax(f->scale / room, 1e5);
            const double fixed = r->pilot_seconds + r->reconstruct_seconds + r->write_seconds;
            const double seconds = fixed + photons * r->trace_seconds / (double)r->photons;
            if (!a->reachable || seconds < a->seconds)
                *a = (study_advice){.target = TARGETS[t], .reachable = true, .photons = (uint64_t)ceil(photons), .cells = r->cells_asked,
                                    .seconds = seconds, .bytes = (double)r->bytes};
        }
    }
}

/* ----------------------------------------------------------------------------------------------------------------- run */

/* Rates from a trial: photons per second of the lamp with all receivers, and of bakes. */
static lmg_result measure_reference(ladder *l, lmg_error *err)
{
    study *s = l->out;
    const study_options *o = l->options;
    measured trial = {0};
    bake_tally tally = {0};
    const size_t count = l->instrument.plane_count + RECEIVERS;
    double began = bake_clock();
    lmg_result result =
        measure_source(l->lamp, &l->instrument, count, &BAKE_NO_MOTION, BAKE_PILOT_FIRST, TRIAL, o->threads, &trial, NULL, &tally, err);
    const double measuring = (double)TRIAL / fmax(bake_clock() - began, 1e-6);
    measured_release(&trial);
    if (result == LMG_OK) {
        began = bake_clock();
        result = l->lamp->run(l->lamp, BAKE_PILOT_FIRST, TRIAL, o->threads, NULL, 0, &tally, err);
        s->photons_per_second = 0.8 * (double)TRIAL / fmax(bake_clock() - began, 1e-6); /* deposits take about a fifth */
    }
    if (result != LMG_OK)
        return result;
    s->reference_photons = (uint64_t)(REFERENCE_SHARE * o->seconds * measuring);
    if (s->reference_photons < 4 * LEAST_JUDGING)
        s->reference_photons = 4 * LEAST_JUDGING;
    const double left = 1 - REFERENCE_SHARE - PHOTON_SHARE - CELL_SHARE;
    l->judging = (uint64_t)(left * o->seconds * measuring / (PHOTON_RUNGS + CELL_RUNGS));
    if (l->judging < LEAST_JUDGING)
        l->judging = LEAST_JUDGING;
    tally = (bake_tally){0};
    result = measure_source(l->lamp, &l->instrument, count, &BAKE_NO_MOTION, 0, s->reference_photons, o->threads, &l->reference, NULL,
                            &tally, err);
    if (result == LMG_OK && !(tally.escaped > 0))
        result = lmg_fail(err, LMG_ERROR_INPUT, "%s: no light leaves the luminaire", l->model->path);
    if (result == LMG_OK)
        for (int m = 0; m < STUDY_MEASURES; ++m) {
            const reading *r = &l->reference.of[m == STUDY_NEAR ? 0 : l->instrument.plane_count + (m == STUDY_FAR ? FAR_FIELD : PICTURES)];
            const bake_difference d = differ(r, r);
            s->reference_noise[m] = d.noise / sqrt(2); /* differ takes both sides as independent */
        }
    return result;
}

static lmg_result climb(ladder *l, lmg_error *err)
{
    study *s = l->out;
    const double seconds = l->options->seconds;
    const double largest = fmax(PHOTON_SHARE * seconds / 2 * s->photons_per_second, 128 * 2000);
    lmg_result result = LMG_OK;
    l->planned = PHOTON_RUNGS + CELL_RUNGS;
    for (int i = 0; result == LMG_OK && !stopped(l) && i < PHOTON_RUNGS; ++i)
        result = bake_rung(l, false, (uint64_t)(largest / (double)(1 << (PHOTON_RUNGS - 1 - i))), DEFAULT_CELLS, err);
    if (result == LMG_OK && s->rung_count > 0) {
        const study_rung *top = &s->rungs[s->rung_count - 1];
        s->photons_per_second = (double)top->photons / rung_seconds(top);
    }
    const double each = fmax(CELL_SHARE * seconds / CELL_RUNGS * s->photons_per_second, 1e5);
    for (int i = 0; result == LMG_OK && !stopped(l) && i < CELL_RUNGS; ++i)
        result = bake_rung(l, true, (uint64_t)each, CELLS[i], err);
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
    /* A seed apart from the bakes': the reference shares no photon with what it judges. */
    lmg_result result = bake_tracer_create(model, lum_mix64(options->seed + 0x61), &l.lamp, err);
    if (result != LMG_OK)
        return result;
    if (options->flux_lm > 0)
        l.lamp->flux = options->flux_lm;
    result = bake_source_size(l.lamp, options->threads, &out->size, err);
    if (result == LMG_OK)
        result = source_main_axis(l.lamp, options->threads, &out->axis, err);
    if (result == LMG_OK) {
        set_up_instrument(&l.instrument, l.lamp->bounds_min, l.lamp->bounds_max, out->axis, out->size, DISTANCES, STUDY_DISTANCES);
        result = measure_reference(&l, err);
    }
    if (result == LMG_OK)
        result = climb(&l, err);
    if (result == LMG_OK) {
        for (int m = 0; m < STUDY_MEASURES; ++m)
            out->fit[m] = fit_ladder(out, (study_measure)m);
        give_advice(out);
    }
    measured_release(&l.reference);
    l.lamp->destroy(l.lamp);
    return result;
}
