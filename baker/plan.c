/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The effect plan: measures what each effect does to the light that leaves, and decides.
 *
 * Runs with and without an effect use the same photon numbers, so that they differ by the photons that meet it, not by chance.  Their
 * light is counted by direction and by the place where it leaves the bounds, in integers (sums that no order of threads changes) and
 * in GROUPS groups of photons, from which the jackknife gives standard errors.
 */
#include "plan.h"

#include "bake.h"
#include "parallel.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Cells on each face of a cube, for the places where light leaves the bounds and for directions (3 degrees), and the coarse ones that
 * COARSEN x COARSEN of them make: narrow beams need the fine ones, little light the coarse ones. */
enum { GROUPS = 16, SIDE = 32, CELLS = 6 * SIDE * SIDE, COARSEN = 8, COARSE_CELLS = CELLS / (COARSEN * COARSEN) };

/* Photons of the plan are numbered from here on, apart from those of bake and pilot. */
static const uint64_t PLAN_FIRST = UINT64_C(1) << 61;
/* A run is this long at most, and all together trace about so many segments: a second or two on two cores, a twentieth of a bake of a
 * minute at most.  Of shorter bakes both are a share: a plan by fewer photons leaves less out, which costs a short bake little. */
static const uint64_t RUN_PHOTONS = 65536, RUN_LEAST = 2048;
static const double ALL_SEGMENTS = 6e6, FULL_SECONDS = 60;
/* The first look, before it is known how long paths are. */
static const uint64_t PROBE_PHOTONS = 512;
/* Counts are in 2^-20 of a photon: far below its noise. */
static const double UNIT = 1048576;

/* ------------------------------------------------------------------------------------------------------------- census */

/* What is counted: luminance by direction and by place, and by direction the part of red and blue that isn't grey. */
typedef enum field { FAR, NEAR, RED, BLUE, FIELDS } field;

typedef struct census {
    lmg_vec3 low, high; /* the luminaire's bounds */
    int64_t cells[FIELDS][GROUPS][CELLS];
} census;

/* Cell of a position on the faces of a cube: axis and sign, and two coordinates in [-1,1]. */
static int cell_of(int face, double a, double b)
{
    int i = (int)((a + 1) * (SIDE / 2)), k = (int)((b + 1) * (SIDE / 2));
    i = i < 0 ? 0 : i < SIDE ? i : SIDE - 1;
    k = k < 0 ? 0 : k < SIDE ? k : SIDE - 1;
    return (face * SIDE + i) * SIDE + k;
}

static int cell_of_direction(const double d[3])
{
    int axis = 0;
    for (int k = 1; k < 3; ++k)
        if (fabs(d[k]) > fabs(d[axis]))
            axis = k;
    const double scale = 1 / fabs(d[axis]);
    return cell_of(2 * axis + (d[axis] < 0), d[(axis + 1) % 3] * scale, d[(axis + 2) % 3] * scale);
}

/* Where the ray leaves the bounds. */
static int cell_of_exit(const census *c, const double o[3], const double d[3])
{
    const double low[3] = {c->low.x, c->low.y, c->low.z}, high[3] = {c->high.x, c->high.y, c->high.z};
    double nearest = (double)INFINITY;
    int axis = 0;
    for (int k = 0; k < 3; ++k) {
        const double t = d[k] != 0 ? ((d[k] > 0 ? high[k] : low[k]) - o[k]) / d[k] : (double)INFINITY;
        if (t < nearest) {
            nearest = t;
            axis = k;
        }
    }
    double at[2];
    for (int i = 0; i < 2; ++i) {
        const int k = (axis + 1 + i) % 3;
        at[i] = 2 * (o[k] + nearest * d[k] - low[k]) / (high[k] - low[k]) - 1;
    }
    return cell_of(2 * axis + (d[axis] < 0), at[0], at[1]);
}

static void count_rays(census *c, const lmg_ray *rays, size_t count)
{
    for (size_t i = 0; i < count; ++i) {
        const lmg_ray *r = &rays[i];
        const double o[3] = {r->origin.x, r->origin.y, r->origin.z}, d[3] = {r->direction.x, r->direction.y, r->direction.z};
        const size_t g = r->number % GROUPS;
        const double y = lmg_luminance(r->flux);
        const int direction = cell_of_direction(d);
        c->cells[FAR][g][direction] += llround(y * UNIT);
        c->cells[NEAR][g][cell_of_exit(c, o, d)] += llround(y * UNIT);
        c->cells[RED][g][direction] += llround(((double)r->flux[0] - y) * UNIT);
        c->cells[BLUE][g][direction] += llround(((double)r->flux[2] - y) * UNIT);
    }
}

/* ----------------------------------------------------------------------------------------------------------- measures */

/* Standard error of a statistic from its values with each group left out in turn. */
static double jackknife(const double without[GROUPS])
{
    double mean = 0, sum = 0;
    for (int g = 0; g < GROUPS; ++g)
        mean += without[g] / GROUPS;
    for (int g = 0; g < GROUPS; ++g)
        sum += (without[g] - mean) * (without[g] - mean);
    return sqrt(sum * (GROUPS - 1) / GROUPS);
}

/* Sums over the groups of one cell's change d and light t, and their parts. */
typedef struct cell_sums {
    double d[GROUPS], t[GROUPS];
} cell_sums;

static cell_sums sums_of(const census *with, const census *without, field f, int cell, bool coarse)
{
    cell_sums sums = {{0}, {0}};
    const field light = f == NEAR ? NEAR : FAR;
    const int across = SIDE / COARSEN, face = cell / (across * across), row = cell / across % across, column = cell % across;
    const int n = coarse ? COARSEN : 1;
    for (int i = 0; i < n; ++i)
        for (int k = 0; k < n; ++k) {
            const int at = coarse ? (face * SIDE + row * COARSEN + i) * SIDE + column * COARSEN + k : cell;
            for (int g = 0; g < GROUPS; ++g) {
                sums.d[g] += (double)(without->cells[f][g][at] - with->cells[f][g][at]);
                sums.t[g] += (double)with->cells[light][g][at];
            }
        }
    return sums;
}

/*
 * Square of the RMS change of a field's cells relative to the light in them, flux-weighted: sum of squared changes over sum of squared
 * light, what chance adds to the squares subtracted (the variance of a sum over groups, from the groups themselves).  Its standard
 * error by jackknife.
 */
static double squared_change(const census *with, const census *without, field f, bool coarse, double *error)
{
    double squares[GROUPS + 1] = {0}, light[GROUPS + 1] = {0}; /* with group g left out; the last: none */
    const int cells = coarse ? COARSE_CELLS : CELLS;
    for (int c = 0; c < cells; ++c) {
        const cell_sums sums = sums_of(with, without, f, c, coarse);
        double d = 0, d2 = 0, t = 0;
        for (int g = 0; g < GROUPS; ++g) {
            d += sums.d[g];
            d2 += sums.d[g] * sums.d[g];
            t += sums.t[g];
        }
        for (int g = 0; g <= GROUPS; ++g) {
            const double own = g < GROUPS ? sums.d[g] : 0, n = g < GROUPS ? GROUPS - 1 : GROUPS;
            const double sum = d - own, sum2 = d2 - own * own, rest = t - (g < GROUPS ? sums.t[g] : 0);
            squares[g] += sum * sum - (sum2 - sum * sum / n) * n / (n - 1);
            light[g] += rest * rest;
        }
    }
    for (int g = 0; g <= GROUPS; ++g)
        squares[g] = light[g] > 0 ? squares[g] / light[g] : 0;
    *error = jackknife(squares);
    return squares[GROUPS];
}

/* The root of a square that noise may have made negative keeps its sign. */
static double signed_root(double x)
{
    return x < 0 ? -sqrt(-x) : sqrt(x);
}

/* The RMS change of a field, by fine or coarse cells, whichever has the higher bound. */
static double rms_change(const census *with, const census *without, field f, bake_change *out)
{
    double highest = -1;
    for (int coarse = 0; coarse < 2; ++coarse) {
        double error;
        const double square = squared_change(with, without, f, coarse, &error), value = signed_root(square);
        const double bound = sqrt(fmax(0, square + 2 * error));
        if (bound > highest) {
            highest = bound;
            *out = (bake_change){value, 0.5 * (bound - value), error > 0 ? square / error : 0};
        }
    }
    return highest;
}

static bake_change flux_change(const census *with, const census *without)
{
    double a[GROUPS] = {0}, b[GROUPS] = {0}, each[GROUPS], all_a = 0, all_b = 0;
    for (int g = 0; g < GROUPS; ++g) {
        for (int c = 0; c < CELLS; ++c) {
            a[g] += (double)with->cells[FAR][g][c];
            b[g] += (double)without->cells[FAR][g][c];
        }
        all_a += a[g];
        all_b += b[g];
    }
    for (int g = 0; g < GROUPS; ++g)
        each[g] = all_a - a[g] > 0 ? (all_b - b[g]) / (all_a - a[g]) - 1 : 0;
    const double value = all_a > 0 ? all_b / all_a - 1 : 0, error = jackknife(each);
    return (bake_change){value, error, error > 0 ? fabs(value) / error : 0};
}

static void measure(const census *with, const census *without, bake_plan_entry *e)
{
    bake_change blue;
    const double far_bound = rms_change(with, without, FAR, &e->far_field);
    const double near_bound = rms_change(with, without, NEAR, &e->near_field);
    const double red_bound = rms_change(with, without, RED, &e->colour);
    const double blue_bound = rms_change(with, without, BLUE, &blue);
    if (blue_bound > red_bound)
        e->colour = blue;
    e->flux = flux_change(with, without);
    e->bound = fmax(fmax(far_bound, near_bound), fmax(fabs(e->flux.value) + 2 * e->flux.error, fmax(red_bound, blue_bound)));
    e->measured = true;
}

/* ---------------------------------------------------------------------------------------------------------------- runs */

static lmg_result take_census(const bake_source *tracer, uint64_t photons, unsigned threads, census *c, double *seconds, lmg_error *err)
{
    bake_ray_list *list;
    lmg_result result = bake_ray_list_create(photons, &list, err);
    if (result != LMG_OK)
        return result;
    memset(c, 0, sizeof(*c));
    c->low = tracer->bounds_min;
    c->high = tracer->bounds_max;
    const lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    const double began = bake_clock();
    result = tracer->run((bake_source *)(uintptr_t)tracer, PLAN_FIRST, photons, threads, &sink, 1, &tally, err);
    *seconds = (bake_clock() - began) * bake_thread_count(threads) / (double)photons;
    size_t count;
    const lmg_ray *rays = bake_ray_list_any_order(list, &count);
    if (result == LMG_OK)
        result = bake_ray_list_check(list, err);
    if (result == LMG_OK)
        count_rays(c, rays, count);
    bake_ray_list_destroy(list);
    return result;
}

static lmg_result measure_without(const lum_model *model, const bake_source *tracer, uint64_t seed, const bake_plan_options *o,
                                  const census *with, census *without, bake_plan *plan, bake_plan_entry *e, lmg_error *err)
{
    bake_source *variant;
    lmg_result result = bake_tracer_create_with(model, ~(1u << e->effect), seed, tracer, &variant, err);
    if (result == LMG_OK)
        result = take_census(variant, plan->photons, o->threads, without, &e->seconds_without, err);
    if (result == LMG_OK)
        measure(with, without, e);
    if (variant)
        variant->destroy(variant);
    return result;
}

/* How much the light of a share of the photons can change at most, by coarse cells: if it all went from one to another of them, which
 * are lit alike, their RMS changed by sqrt(2 COARSE_CELLS) of the share. */
static double largest_change(double share)
{
    return sqrt(2.0 * COARSE_CELLS) * share;
}

/* ----------------------------------------------------------------------------------------------------------- decisions */

/* Of the five or so changes looked at, none passes by chance: four standard errors (p < 1e-4 each). */
static const double SHOWN_SIGMAS = 4;

static bool shows(const bake_change *c, double error)
{
    return fabs(c->value) > error && c->sigmas > SHOWN_SIGMAS;
}

static void decide(bake_plan *plan)
{
    double left = plan->error;
    for (;;) { /* the least first, as long as there is room */
        bake_plan_entry *least = NULL;
        for (size_t i = 0; i < plan->count; ++i) {
            bake_plan_entry *e = &plan->entries[i];
            if (e->simulated && e->effect != BAKE_POLARIZATION && bake_effect_stand_in(e->effect) && e->bound <= left &&
                (!least || e->bound < least->bound))
                least = e;
        }
        if (!least)
            break;
        least->simulated = false;
        left -= least->bound;
        plan->left_out += least->bound;
    }
    plan->simulated = plan->contained;
    for (size_t i = 0; i < plan->count; ++i) {
        bake_plan_entry *e = &plan->entries[i];
        const char *stand_in = bake_effect_stand_in(e->effect);
        if (e->effect == BAKE_POLARIZATION) {
            e->simulated = e->measured && (shows(&e->flux, plan->error) || shows(&e->far_field, plan->error) ||
                                           shows(&e->near_field, plan->error) || shows(&e->colour, plan->error));
            snprintf(e->why, sizeof(e->why), "%s",
                     e->simulated  ? "shown to matter"
                     : e->measured ? "not shown to matter: no change beyond four standard errors and the error asked for"
                                   : "no light meets two surfaces that polarize");
        } else if (!stand_in) {
            snprintf(e->why, sizeof(e->why), "nothing simpler could take its place");
        } else if (e->simulated) {
            snprintf(e->why, sizeof(e->why), "without it up to %.2g %% would change, more than %s", 100 * e->bound,
                     e->bound > plan->error ? "the error asked for" : "is left of the error asked for");
        } else {
            snprintf(e->why, sizeof(e->why), "%s instead: at most %.2g %% changes", stand_in, 100 * e->bound);
        }
        if (!e->simulated)
            plan->simulated &= ~(1u << e->effect);
    }
}

static void list_entries(const lum_model *model, bake_plan *plan)
{
    memset(plan, 0, sizeof(*plan));
    plan->contained = bake_effects_of(model);
    for (int i = 0; i < BAKE_EFFECT_COUNT; ++i)
        if (plan->contained >> i & 1)
            plan->entries[plan->count++] = (bake_plan_entry){.effect = (bake_effect)i, .simulated = true};
}

void bake_plan_choose(const lum_model *model, uint32_t effects, bake_plan *plan)
{
    list_entries(model, plan);
    plan->simulated = plan->contained & (effects | BAKE_EMISSION_BITS);
    for (size_t i = 0; i < plan->count; ++i) {
        bake_plan_entry *e = &plan->entries[i];
        const char *stand_in = bake_effect_stand_in(e->effect);
        if (!(plan->simulated >> e->effect & 1) && !stand_in)
            plan->simulated |= 1u << e->effect;
        e->simulated = plan->simulated >> e->effect & 1;
        if (e->simulated)
            snprintf(e->why, sizeof(e->why), "%s", effects >> e->effect & 1 ? "asked for" : "nothing simpler could take its place");
        else
            snprintf(e->why, sizeof(e->why), "not asked for: %s instead", stand_in);
    }
}

/* Which materials swallow the light, most first. */
static void describe_ends(const lum_model *model, const bake_survey *survey, char *text, size_t size)
{
    enum { PLACES = 3 };
    uint64_t below = UINT64_MAX;
    size_t used = 0;
    text[0] = 0;
    uint32_t last = UINT32_MAX;
    for (int place = 0; place < PLACES && used < size; ++place) {
        uint32_t best = UINT32_MAX;
        for (uint32_t i = 0; i < model->material_count; ++i) /* in order of count, then number */
            if (survey->ended[i] > 0 && (survey->ended[i] < below || (survey->ended[i] == below && i > last)) &&
                (best == UINT32_MAX || survey->ended[i] > survey->ended[best]))
                best = i;
        if (best == UINT32_MAX)
            break;
        const int n = snprintf(text + used, size - used, "%s%.3g %% in material \"%.40s\"", place ? ", " : "",
                               100 * (double)survey->ended[best] / (double)survey->photons, model->materials[best].name);
        used += n > 0 ? (size_t)n : 0;
        below = survey->ended[best];
        last = best;
    }
}

void bake_plan_where_absorbed(const lum_model *model, const bake_source *tracer, unsigned threads, char *text, size_t size)
{
    bake_survey survey = {.ended = calloc(model->material_count + 1, sizeof(uint64_t))};
    text[0] = 0;
    if (survey.ended && bake_tracer_survey(tracer, PLAN_FIRST, PROBE_PHOTONS, threads, &survey, NULL) == LMG_OK)
        describe_ends(model, &survey, text, size);
    free(survey.ended);
}

lmg_result bake_plan_make(const lum_model *model, const bake_source *tracer, uint64_t seed, const bake_plan_options *options,
                          bake_plan *plan, lmg_error *err)
{
    const bake_plan_options *o = options;
    list_entries(model, plan);
    plan->error = o->error > 0 ? o->error : BAKE_PLAN_ERROR;
    census *with = malloc(sizeof(*with)), *without = malloc(sizeof(*without));
    lmg_result result = with && without ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the effect plan");

    bake_survey probe = {0}, survey = {0};
    if (result == LMG_OK)
        result = bake_tracer_survey(tracer, PLAN_FIRST, PROBE_PHOTONS, o->threads, &probe, err);
    if (result == LMG_OK) {
        const double work = o->seconds > 0 ? fmin(o->seconds / FULL_SECONDS, 1) : 1;
        plan->photons = o->photons ? o->photons : RUN_PHOTONS;
        const double segments = (double)probe.segments / (double)PROBE_PHOTONS * ((double)plan->count + 2);
        while (!o->photons && plan->photons > RUN_LEAST &&
               ((double)plan->photons > work * (double)RUN_PHOTONS || (double)plan->photons * segments > work * ALL_SEGMENTS))
            plan->photons /= 2;
        result = bake_tracer_survey(tracer, PLAN_FIRST, plan->photons, o->threads, &survey, err);
    }
    plan->escaped = survey.escaped;
    if (result == LMG_OK && survey.escaped > 0)
        result = take_census(tracer, plan->photons, o->threads, with, &plan->seconds_with, err);
    for (size_t i = 0; result == LMG_OK && i < plan->count; ++i) {
        bake_plan_entry *e = &plan->entries[i];
        const double n = (double)plan->photons, met = fmin((double)survey.met[e->effect] / n, 1);
        e->met = met;
        e->met_error = bake_share_error(met * n, n);
        const bool all = BAKE_EMISSION_BITS >> e->effect & 1 || !bake_effect_stand_in(e->effect);
        /* never met: of 3/n it would have been with 95 % */
        e->bound = all ? 1 : largest_change(met > 0 ? met + 2 * e->met_error : 3 / n);
        if (!all && met > 0 && survey.escaped > 0)
            result = measure_without(model, tracer, seed, o, with, without, plan, e, err);
    }
    free(with);
    free(without);
    if (result != LMG_OK)
        return result;
    decide(plan);
    return LMG_OK;
}

/* ---------------------------------------------------------------------------------------------------------------- texts */

void bake_plan_where(const lum_model *model, bake_effect effect, char *text, size_t size)
{
    size_t used = 0;
    text[0] = 0;
    for (uint32_t i = 0; i < model->material_count; ++i) {
        if (!(bake_effects_of_material(&model->materials[i]) >> effect & 1))
            continue;
        const char *node = NULL;
        uint32_t parts = 0;
        for (uint32_t k = 0; k < model->part_count; ++k)
            if (model->parts[k].material == (int32_t)i && model->parts[k].triangle_count > 0) {
                node = node ? node : model->parts[k].node;
                ++parts;
            }
        if (parts == 0)
            continue;
        char more[24] = "";
        if (parts > 1)
            snprintf(more, sizeof(more), " and %u more", parts - 1);
        const int n =
            snprintf(text + used, size - used, "%s\"%.40s\" (%.40s%s)", used ? ", " : "", model->materials[i].name, node, more);
        used += n > 0 ? (size_t)n : 0;
        if (used >= size)
            return;
    }
    for (uint32_t i = 0; effect == BAKE_VOLUMES && i < model->volume_count && used < size; ++i) {
        const int n = snprintf(text + used, size - used, "%s\"%.40s\"", used ? ", " : "", model->volumes[i].name);
        used += n > 0 ? (size_t)n : 0;
    }
    for (uint32_t i = 0; i < model->light_count && used < size; ++i)
        if ((effect == BAKE_EMISSION_POINT && model->lights[i].kind == LUM_LIGHT_POINT) ||
            (effect == BAKE_EMISSION_SPOT && model->lights[i].kind == LUM_LIGHT_SPOT) ||
            (effect == BAKE_EMISSION_PROFILE && model->lights[i].kind == LUM_LIGHT_PROFILE)) {
            const int n = snprintf(text + used, size - used, "%s\"%.40s\"", used ? ", " : "", model->lights[i].name);
            used += n > 0 ? (size_t)n : 0;
        }
}

char *bake_plan_text(const bake_plan *plan)
{
    enum { LINE = 512 }; /* more than the longest: a name, and the texts below */
    char *text = malloc((plan->count + 1) * LINE);
    if (!text)
        return NULL;
    size_t used = 0;
    if (plan->photons > 0)
        used = (size_t)snprintf(text, LINE, "error asked for %.4g %%, %" PRIu64 " photons a run, left out at most %.2g %%", 100 * plan->error,
                                plan->photons, 100 * plan->left_out);
    else
        used = (size_t)snprintf(text, LINE, "effects chosen by the user");
    for (size_t i = 0; i < plan->count; ++i) {
        const bake_plan_entry *e = &plan->entries[i];
        char met[40] = "", changes[160] = "";
        if (plan->photons > 0)
            snprintf(met, sizeof(met), " met by %.3g %%,", 100 * e->met);
        if (e->measured)
            snprintf(changes, sizeof(changes), " without it flux %+.2g +- %.2g, far %.2g +- %.2g, near %.2g +- %.2g, colour %+.2g +- %.2g %%,",
                     100 * e->flux.value, 100 * e->flux.error, 100 * e->far_field.value, 100 * e->far_field.error,
                     100 * e->near_field.value, 100 * e->near_field.error, 100 * e->colour.value, 100 * e->colour.error);
        used += (size_t)snprintf(text + used, LINE, "\n%s: %s,%s%s %s", bake_effect_name(e->effect), e->simulated ? "simulated" : "left out",
                                 met, changes, e->why);
    }
    return text;
}

uint64_t bake_plan_text_photons(const char *text)
{
    uint64_t photons = 0;
    return text && sscanf(text, "error asked for %*f %%, %" SCNu64 " photons a run", &photons) == 1 ? photons : 0;
}
