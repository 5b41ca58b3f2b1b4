/* SPDX-License-Identifier: Apache-2.0 */
/* Bakes to a stated error: a search over photons and cells, each box judged by the lamp's own rays. */
#include "target.h"

#include "size.h"

#include <luminaires/model.h>

#include <math.h>
#include <string.h>

/* The first bake, and the largest: beyond that a bake of hours would begin, which nobody should fall into by a wrong percentage. */
static const double FIRST_PHOTONS = 1e5, MOST_PHOTONS = 1e11;
static const uint64_t FIRST_CELLS = 1000000, MOST_CELLS = 64000000;
/* Where the file's size is limited: the first box has a cell for each byte, within reason; four times the cells take less than so many times the bytes. */
static const uint64_t LEAST_CELLS = 100000;
static const double GROWTH = 3;
/* No step multiplies the photons by more: the scale is known from small bakes only roughly. */
static const double LARGEST_STEP = 16;
/* A box this close to the error asked for is it. */
static const double CLOSE = 0.15;
/* A floor above this share of the error asked for costs more photons than more cells do. */
static const double HIGH_FLOOR = 0.75;
/* How well the error asked for is to be known, relative: half of CLOSE is as fine as judging needs to be. */
static const double JUDGING = 0.08;
static const double NEAR_THE_MARK = 2;
static const uint64_t TRIAL = 200000, MOST_JUDGING = 4000000000u;

typedef struct tried {
    double photons, square, weight; /* error^2, 1 / variance of it */
} tried;

/* Weighted least squares of square = scale / photons + floor2, both >= 0. */
static void fit(const tried *list, size_t count, double *scale, double *floor2)
{
    double w0 = 0, wx = 0, wxx = 0, wy = 0, wxy = 0;
    for (size_t i = 0; i < count; ++i) {
        const double x = 1 / list[i].photons, y = list[i].square, w = list[i].weight;
        w0 += w, wx += w * x, wxx += w * x * x, wy += w * y, wxy += w * x * y;
    }
    const double determinant = w0 * wxx - wx * wx;
    *floor2 = count > 1 && determinant > 0 ? (wxx * wy - wx * wxy) / determinant : 0;
    *scale = count > 1 && determinant > 0 ? (w0 * wxy - wx * wy) / determinant : wxy / wxx;
    if (*floor2 < 0) {
        *floor2 = 0;
        *scale = wxy / wxx;
    } else if (*scale < 0) {
        *scale = 0;
        *floor2 = wy / w0;
    }
}

/*
 * Judges a box; one that comes near the error asked for with as many photons of the lamp, and rays of the box, as it takes to know that
 * error well enough: the noise v of judging makes the variance of error^2 go as v^4, so the standard error of an error e goes as
 * 1 / (rays e).  Far off the mark a coarse judgement will do.
 */
static lmg_result judge_well(judge *j, const bake_target *target, const lmg_field *field, uint64_t *rays, judge_verdict *verdict,
                             lmg_error *err)
{
    lmg_result result = *rays > 0 ? LMG_OK : judge_measure_lamp(j, *rays = TRIAL, err);
    for (int round = 0; result == LMG_OK && round < 4; ++round) {
        result = judge_box(j, field, *rays, verdict, err);
        const judge_error e = verdict->error[target->of];
        const double factor = fabs(e.rms) * e.standard_error / (JUDGING * target->error * target->error);
        if (result != LMG_OK || e.rms > NEAR_THE_MARK * target->error || !(factor > 1.25) || *rays >= MOST_JUDGING)
            break;
        *rays = (double)*rays * factor > (double)MOST_JUDGING ? MOST_JUDGING : (uint64_t)((double)*rays * factor);
        result = judge_measure_lamp(j, *rays, err);
    }
    return result;
}

/* Keeps the box that is nearer to the error asked for; of two beyond it the better one. */
static void keep(lmg_field **kept, lmg_field *field, bake_report *report, const bake_report *its, bake_reached *reached, bake_reached now,
                 double wanted)
{
    if (*kept && fabs(log(fmax(now.error.rms, 1e-9) / wanted)) >= fabs(log(fmax(reached->error.rms, 1e-9) / wanted))) {
        lmg_field_destroy(field);
        reached->bakes = now.bakes;
        return;
    }
    lmg_field_destroy(*kept);
    *kept = field;
    *report = *its;
    *reached = now;
}

lmg_result bake_run_to_error(const struct lum_model *model, const bake_options *options, const bake_target *target, lmg_field **out,
                             bake_report *report, bake_reached *reached, lmg_error *err)
{
    *out = NULL;
    *reached = (bake_reached){0};
    judge *j;
    lmg_result result = judge_create(model, options->seed, options->flux_lm, options->threads, &j, err);
    if (result != LMG_OK)
        return result;
    uint64_t rays = 0;
    const bool fixed = options->fit.cells > 0;
    uint64_t cells = fixed ? options->fit.cells : FIRST_CELLS;
    if (!fixed && options->size > 0 && options->size < (double)cells)
        cells = options->size > (double)LEAST_CELLS ? (uint64_t)options->size : LEAST_CELLS;
    double photons = FIRST_PHOTONS;
    tried list[TARGET_MAX_BAKES];
    size_t count = 0;
    for (unsigned n = 1; result == LMG_OK && n <= TARGET_MAX_BAKES && photons > 0; ++n) {
        bake_options o = *options;
        o.photons = (uint64_t)photons;
        o.fit.cells = cells;
        lmg_field *field;
        bake_report its;
        result = bake_run(model, &o, &field, &its, err);
        if (result != LMG_OK)
            break;
        judge_verdict verdict;
        result = judge_well(j, target, field, &rays, &verdict, err);
        if (result != LMG_OK) {
            lmg_field_destroy(field);
            break;
        }
        const judge_error e = verdict.error[target->of];
        const double ratio = e.rms / target->error;
        bake_reached now = {.error = e, .photons = o.photons, .cells = cells, .bakes = n};
        now.within = fabs(ratio - 1) <= CLOSE || (ratio < 1 && photons <= FIRST_PHOTONS);
        keep(out, field, report, &its, reached, now, target->error);
        const double se = hypot(2 * fabs(e.rms) * e.standard_error, 0.05 * e.rms * e.rms);
        list[count++] = (tried){photons, e.rms * fabs(e.rms), 1 / fmax(se * se, 1e-30)};

        double next = 0;
        bool may_grow = !fixed && cells < MOST_CELLS;
        if (!now.within && !its.interrupted) {
            double scale, floor2, bytes = 0;
            fit(list, count, &scale, &floor2);
            const double room = target->error * target->error - floor2;
            if (ratio > 1 && sqrt(floor2) > HIGH_FLOOR * target->error) {
                if (may_grow && options->size > 0) {
                    result = bake_size_of(*out, &bytes, err);
                    may_grow = GROWTH * bytes <= options->size;
                }
                if (may_grow) {
                    cells *= 4;
                    count = 0; /* the floor is another one now */
                    next = photons;
                }
                else if (room > 0)
                    next = scale / room;
            } else if (room > 0) {
                next = scale / room;
            }
            next = fmin(next, fmin(photons * LARGEST_STEP, MOST_PHOTONS));
            if (next > 0 && next < FIRST_PHOTONS)
                next = FIRST_PHOTONS;
            if (count > 0 && fabs(next / photons - 1) < 0.02) /* nothing new would come of it */
                next = 0;
        }
        if (target->progress)
            target->progress(target->progress_self, n, o.photons, now.cells, e, (uint64_t)next);
        photons = next;
    }
    judge_destroy(j);
    if (result != LMG_OK) {
        lmg_field_destroy(*out);
        *out = NULL;
    }
    return result;
}
