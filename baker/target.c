/* SPDX-License-Identifier: Apache-2.0 */
/* Bakes to a stated error: a search over photons, each box judged by the lamp's own rays. */
#include "target.h"

#include <luminaires/model.h>

#include <math.h>
#include <string.h>

/* The first bake; the smallest, in photons that leave (fewer make no box); and the largest: beyond that a bake of hours would
 * begin, which nobody should fall into by a wrong percentage. */
static const double FIRST_PHOTONS = 1e5, LEAST_PHOTONS = 1e3, MOST_PHOTONS = 1e11;
/* No step multiplies or divides the photons by more: how the error falls is known from other bakes only roughly. */
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
/* A box that is off by luck alone, by what the others say: the next has more or fewer photons by this factor at least. */
static const double NUDGE = 1.1;
/* Between a box that is worse than asked for and a better one the next keeps off both by this share of the way; where their photons
 * differ by less than this factor the error jumps, since the pilot finds other cells worth it. */
static const double OFF_ENDS = 0.1, JUMP = 1.25;
/* No limit to the file but what memory and time allow. */
static const double MOST_BYTES = 1e9;
/* How well the error asked for is to be known, relative: half of CLOSE is as fine as judging needs to be; and one further off than
 * by this factor. */
static const double JUDGING = 0.08, JUDGING_COARSELY = 0.25;
static const double NEAR_THE_MARK = 2;
static const uint64_t TRIAL = 200000, MOST_JUDGING = 4000000000u;

_Static_assert((int)TARGET_NEAR == (int)JUDGE_NEAR && (int)TARGET_FAR == (int)JUDGE_FAR &&
                   (int)TARGET_LUMINANCE == (int)JUDGE_LUMINANCE && (int)TARGET_FLUX == (int)JUDGE_MEASURES,
               "targets are the judge's measures, and flux");

const char *target_measure_name(target_measure m)
{
    return m == TARGET_FLUX ? "flux" : judge_measure_name((judge_measure)m);
}

typedef struct tried {
    double photons, cells;
    double x, y, variance; /* log photons, log (error / asked)^2 */
    bool better;           /* than asked for */
} tried;

/*
 * Judges a box; one that comes near the error asked for with as many photons of the lamp, and rays of the box, as it takes to know
 * that error well enough: the noise v of judging makes the variance of error^2 go as v^4, so the standard error of an error e goes
 * as 1 / (rays e).  Far off the mark a coarse judgement will do, that it is far off.  seconds: what judging the next box will take,
 * one that is near the mark.
 */
static lmg_result judge_well(judge *j, const bake_target *target, const lmg_field *field, uint64_t *rays, judge_error *out,
                             double *seconds, lmg_error *err)
{
    judge_verdict verdict;
    lmg_result result = *rays > 0 ? LMG_OK : judge_measure_lamp(j, *rays = TRIAL, err);
    for (int round = 0; result == LMG_OK && round < 4; ++round) {
        const double began = bake_clock();
        result = judge_box(j, field, *rays, &verdict, err);
        *seconds = bake_clock() - began;
        if (result != LMG_OK)
            break;
        const judge_error e = *out = verdict.error[target->of];
        const bool far_off = e.rms > NEAR_THE_MARK * target->error;
        const double finely = fabs(e.rms) * e.standard_error / (JUDGING * target->error * target->error);
        const double factor = far_off ? e.standard_error / (JUDGING_COARSELY * e.rms) : finely;
        if (far_off && finely > 1.25) /* lamp and box anew, with so many more rays */
            *seconds *= 1 + 2 * finely;
        if (!(factor > 1.25) || *rays >= MOST_JUDGING)
            break;
        *rays = (double)*rays * factor > (double)MOST_JUDGING ? MOST_JUDGING : (uint64_t)((double)*rays * factor);
        result = judge_measure_lamp(j, *rays, err);
    }
    return result;
}

/* The relative standard error of the flux that left; of none nothing is known. */
static judge_error flux_error(const bake_tally *tally)
{
    if (!(tally->escaped > 0))
        return (judge_error){.rms = 1};
    return (judge_error){.rms = bake_light_error(tally, tally->escaped) * (double)tally->photons / tally->escaped};
}

/* The fewest photons of a lamp that are tried. */
static double least_photons(const bake_tally *tally)
{
    return ceil(LEAST_PHOTONS * fmax((double)tally->photons / fmax(tally->escaped, 1), 1));
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

/* Whether a box is to be kept rather than another: one that is what was asked for, else a better one, else the nearer one. */
static bool preferred(double error, double other, double wanted)
{
    const double a = log(fmax(error, 1e-9) / wanted), b = log(fmax(other, 1e-9) / wanted), close = log(1 + CLOSE);
    if ((a <= close) != (b <= close))
        return a <= close;
    return fabs(a) < fabs(b);
}

static void keep(lmg_field **kept, lmg_field *field, bake_report *report, const bake_report *its, bake_reached *reached,
                 bake_reached now, double wanted)
{
    if (*kept && !preferred(now.error.rms, reached->error.rms, wanted)) {
        lmg_field_destroy(field);
        reached->bakes = now.bakes;
        return;
    }
    lmg_field_destroy(*kept);
    *kept = field;
    *report = *its;
    *reached = now;
}

/* An error as a point of the fit: one that is chance is known to be below the standard error of its square. */
static tried try_of(judge_error e, double photons, double cells, double wanted)
{
    const double square_se = 2 * fabs(e.rms) * e.standard_error,
                 seen2 = fmax(fmax(e.rms * fabs(e.rms), square_se), 1e-12 * wanted * wanted);
    const double se = square_se / seen2;
    return (tried){.photons = photons,
                   .cells = cells,
                   .x = log(photons),
                   .y = log(seen2 / (wanted * wanted)),
                   .variance = se * se,
                   .better = e.rms < wanted};
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

/* The fewest photons of a box better than asked for (HUGE_VAL: none yet), and the most below them of a worse one (0: none). */
static void bracket(const tried *list, size_t count, double *worse, double *better)
{
    *worse = 0;
    *better = HUGE_VAL;
    for (size_t i = 0; i < count; ++i)
        if (list[i].better)
            *better = fmin(*better, list[i].photons);
    for (size_t i = 0; i < count; ++i)
        if (!list[i].better && list[i].photons < *better)
            *worse = fmax(*worse, list[i].photons);
}

/* The photons of the next box: by the fit, as far as the last box and the bracket agree; 0: none. */
static double next_photons(const tried *list, size_t count, double least)
{
    const tried last = list[count - 1];
    double next = photons_for_error(list, count), worse, better;
    bracket(list, count, &worse, &better);
    if (!(better < HUGE_VAL) && (!(next > 0) || floor_above(list, count)))
        return 0;
    if (worse > 0 && better < HUGE_VAL) {
        const double off = pow(better / worse, OFF_ENDS);
        if (!(next > worse * off && next < better / off))
            next = sqrt(worse * better);
    } else {
        const double step = fmax(exp(fabs(last.y) / (2 * SLOPE)), NUDGE); /* half of the way that it would be by the last alone */
        if (last.better ? !(next < last.photons / NUDGE) : !(next > last.photons * NUDGE))
            next = last.better ? last.photons / step : last.photons * step;
    }
    next = fmax(fmin(next, fmin(last.photons * LARGEST_STEP, MOST_PHOTONS)), fmax(last.photons / LARGEST_STEP, least));
    next = floor(next);
    for (size_t i = 0; i < count; ++i)
        if (list[i].photons == next)
            return 0; /* at an end of what is tried: the same photons make the same box */
    return next;
}

/* The same for flux, after a bake of an error that is `ratio` of the one asked for: noise alone, so that one bake tells the
 * photons. */
static double next_for_flux(double photons, double ratio, double least)
{
    const double next = floor(fmax(fmin(photons * fmin(ratio * ratio, LARGEST_STEP), MOST_PHOTONS), least));
    return next != photons ? next : 0;
}

/* What has been tried, and in which cells. */
typedef struct trials {
    tried list[TARGET_MAX_BAKES];
    size_t count;
    lmg_layout layout; /* of the box with the fewest photons that is better than asked for */
    bool held;         /* boxes are made in those cells */
} trials;

/* Notes a box; returns the photons of the next, 0: none.  Where the error jumps they are fewer than the better box's, in its cells:
 * there the error rises as their noise does. */
static double after_box(trials *all, tried now, const lmg_field *field, double least)
{
    all->list[all->count++] = now;
    double worse, better;
    bracket(all->list, all->count, &worse, &better);
    if (now.photons == better)
        all->layout = *lmg_field_layout(field);
    if (better < JUMP * worse) {
        if (all->held)
            return 0;
        for (size_t i = 0; i < all->count; ++i)
            if (all->list[i].photons == better)
                all->list[0] = all->list[i];
        all->count = 1;
        all->held = true;
    }
    return next_photons(all->list, all->count, least);
}

lmg_result bake_run_to_error(const struct lum_model *model, const bake_options *options, const bake_target *target, lmg_field **out,
                             bake_report *report, bake_reached *reached, lmg_error *err)
{
    *out = NULL;
    *reached = (bake_reached){0};
    const bool flux = target->of == TARGET_FLUX;
    judge *j = NULL;
    lmg_result result = flux ? LMG_OK : judge_create(model, options->seed, options->flux_lm, options->threads, &j, err);
    if (result != LMG_OK)
        return result;
    uint64_t rays = 0;
    double photons = FIRST_PHOTONS, least = 0;
    trials all = {.count = 0};
    for (unsigned n = 1; result == LMG_OK && n <= TARGET_MAX_BAKES && photons > 0; ++n) {
        bake_options o = *options;
        o.photons = (uint64_t)photons;
        if (!(o.size > 0))
            o.size = MOST_BYTES;
        o.layout = all.held ? &all.layout : NULL;
        lmg_field *field;
        bake_report its;
        const double began = bake_clock();
        result = bake_run(model, &o, &field, &its, err);
        if (result != LMG_OK)
            break;
        const double baked = bake_clock() - began;
        double judged = 0;
        judge_error e;
        if (flux)
            e = flux_error(&its.tally);
        else
            result = judge_well(j, target, field, &rays, &e, &judged, err);
        if (result != LMG_OK) {
            lmg_field_destroy(field);
            break;
        }
        const double ratio = e.rms / target->error;
        if (n == 1)
            least = least_photons(&its.tally);
        bake_reached now = {.error = e, .photons = o.photons, .cells = cells_of(field), .bakes = n};
        now.within = fabs(ratio - 1) <= CLOSE || (ratio < 1 && photons <= least);
        double next = 0;
        if (!now.within && !its.interrupted)
            next = flux ? next_for_flux(photons, ratio, least)
                        : after_box(&all, try_of(e, photons, (double)now.cells, target->error), field, least);
        keep(out, field, report, &its, reached, now, target->error);
        const double traced = its.trace_seconds + its.gather_seconds;
        if (target->progress)
            target->progress(target->progress_self, n, o.photons, now.cells, e, (uint64_t)next,
                             baked + (next / photons - 1) * traced + judged);
        photons = next;
    }
    reached->within = reached->within || reached->error.rms < target->error;
    judge_destroy(j);
    if (result != LMG_OK) {
        lmg_field_destroy(*out);
        *out = NULL;
    }
    return result;
}
