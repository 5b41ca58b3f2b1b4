/* SPDX-License-Identifier: Apache-2.0 */
/* Bakes to a stated error: a search over photons, each box judged by the lamp's own rays. */
#include "target.h"

#include <luminaires/model.h>

#include <math.h>
#include <string.h>

/* The first bake, and the largest: beyond that a bake of hours would begin, which nobody should fall into by a wrong percentage. */
static const double FIRST_PHOTONS = 1e5, MOST_PHOTONS = 1e11;
/* No step multiplies the photons by more: how the error falls is known from small bakes only roughly. */
static const double LARGEST_STEP = 16;
/* A box this close to the error asked for is it. */
static const double CLOSE = 0.15;
/* error^2 goes as photons^-slope: 1 where all of it is noise, less where more photons make finer cells worth it, 0 where cells
 * can't get finer.  What is supposed before anything is known, with its standard deviation. */
static const double SLOPE = 0.7, SLOPE_SD = 0.25;
/* What a power law may be off by for each e-fold of error^2, and what the luck of one layout does to error^2: boxes of as many
 * photons by several seeds spread by so much. */
static const double BENT = 0.3, LAYOUT_LUCK = 0.3;
/* Below this slope photons won't do: half the error would take a thousand times as many. */
static const double FLAT = 0.2;
/* Boxes with cells that differ by less have the same ones, as far as what they blur goes. */
static const double SAME_CELLS = 0.1;
/* A floor is one when it lies above the error asked for by so many standard errors. */
static const double SURE = 2;
/* A box that is off by luck alone, by what the others say: the next has so many more or fewer photons. */
static const double NUDGE = 1.1;
/* No limit to the file but what memory and time allow. */
static const double MOST_BYTES = 1e9;
/* How well the error asked for is to be known, relative: half of CLOSE is as fine as judging needs to be. */
static const double JUDGING = 0.08;
static const double NEAR_THE_MARK = 2;
static const uint64_t TRIAL = 200000, MOST_JUDGING = 4000000000u;

typedef struct tried {
    double x, y, variance; /* log photons, log (error / asked)^2 */
    double cells;
} tried;

/*
 * Judges a box; one that comes near the error asked for with as many photons of the lamp, and rays of the box, as it takes to know
 * that error well enough: the noise v of judging makes the variance of error^2 go as v^4, so the standard error of an error e goes
 * as 1 / (rays e).  Far off the mark a coarse judgement will do.
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

static uint64_t cells_of(const lmg_field *field)
{
    const lmg_layout *layout = lmg_field_layout(field);
    uint64_t cells = 0;
    for (uint32_t i = 0; i < layout->slab_count; ++i) {
        const lmg_slab *s = &layout->slabs[i];
        cells += (uint64_t)s->nu * s->nv * s->ns * s->nt;
    }
    return cells;
}

/* Keeps the box that is nearer to the error asked for; of two beyond it the better one. */
static void keep(lmg_field **kept, lmg_field *field, bake_report *report, const bake_report *its, bake_reached *reached,
                 bake_reached now, double wanted)
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

/* The photons whose box would have the error asked for, by the boxes so far, those near to it first: a line through the logarithms,
 * by weighted least squares with what is supposed of its slope.  0: no number of them. */
static double photons_for_error(const tried *list, size_t count)
{
    double w0 = 0, wx = 0, wy = 0, across = -SLOPE / (SLOPE_SD * SLOPE_SD), along = 1 / (SLOPE_SD * SLOPE_SD);
    for (int pass = 0; pass < 2; ++pass)
        for (size_t i = 0; i < count; ++i) {
            const tried *t = &list[i];
            const double w = 1 / (t->variance + LAYOUT_LUCK * LAYOUT_LUCK + BENT * BENT * t->y * t->y);
            if (pass == 0) {
                w0 += w, wx += w * t->x, wy += w * t->y;
            } else {
                along += w * (t->x - wx / w0) * (t->x - wx / w0);
                across += w * (t->x - wx / w0) * (t->y - wy / w0);
            }
        }
    const double slope = -across / along;
    return slope > FLAT ? exp(wx / w0 + wy / w0 / slope) : 0;
}

/* Whether the cells, which no longer get finer, blur more than was asked for: least squares of error^2 = scale / photons + floor^2
 * through the boxes with as many cells as the last. */
static bool floor_above(const tried *list, size_t count)
{
    double w0 = 0, wx = 0, wxx = 0, wy = 0, wxy = 0;
    for (size_t i = 0; i < count; ++i) {
        if (fabs(list[i].cells / list[count - 1].cells - 1) > SAME_CELLS)
            continue;
        const double x = exp(-list[i].x), y = exp(list[i].y), w = 1 / (y * y * (list[i].variance + LAYOUT_LUCK * LAYOUT_LUCK));
        w0 += w, wx += w * x, wxx += w * x * x, wy += w * y, wxy += w * x * y;
    }
    const double determinant = w0 * wxx - wx * wx;
    if (!(determinant > 1e-9 * w0 * wxx)) /* one number of photons */
        return false;
    const double floor2 = (wxx * wy - wx * wxy) / determinant, se = sqrt(wxx / determinant);
    return floor2 - SURE * se > 1;
}

/* The same, in reach of what was tried last and apart from it. */
static double next_photons(const tried *list, size_t count, double photons, double ratio)
{
    double next = photons_for_error(list, count);
    if (ratio > 1 && (!(next > 0) || floor_above(list, count)))
        return 0;
    if (fabs(log(fmax(next, 1) / photons)) < 0.5 * log(NUDGE) || (ratio > 1) != (next > photons))
        next = ratio > 1 ? photons * NUDGE : photons / NUDGE;
    next = fmax(fmin(next, fmin(photons * LARGEST_STEP, MOST_PHOTONS)), FIRST_PHOTONS);
    return next != photons ? next : 0; /* at an end of what is tried: the same photons make the same box */
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
    double photons = FIRST_PHOTONS;
    tried list[TARGET_MAX_BAKES];
    for (unsigned n = 1; result == LMG_OK && n <= TARGET_MAX_BAKES && photons > 0; ++n) {
        bake_options o = *options;
        o.photons = (uint64_t)photons;
        if (!(o.size > 0))
            o.size = MOST_BYTES;
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
        bake_reached now = {.error = e, .photons = o.photons, .cells = cells_of(field), .bakes = n};
        now.within = fabs(ratio - 1) <= CLOSE || (ratio < 1 && photons <= FIRST_PHOTONS);
        keep(out, field, report, &its, reached, now, target->error);
        /* an error that is chance is known to be below its own standard error */
        const double seen = fmax(e.rms, e.standard_error), se = 2 * e.standard_error / seen;
        list[n - 1] = (tried){log((double)o.photons), 2 * log(seen / target->error), se * se, (double)now.cells};
        const double next = now.within || its.interrupted ? 0 : next_photons(list, n, photons, ratio);
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
