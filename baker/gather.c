/* SPDX-License-Identifier: Apache-2.0 */
/* Rays traced backwards into the lamp for all cells that are gathered, with the pilot that decides whether that pays. */
#include "gather.h"

#include "parallel.h"
#include "tracer.h"

#include <inttypes.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

/* Cells are traced together until there are so many rays. */
enum { ENOUGH_RAYS = 4096, MOST_RAYS = ENOUGH_RAYS + 2 * LMG_GATHERING_RAYS };

/* ------------------------------------------------------------------------------------------------------------- tracing */

typedef struct gather_job {
    const bake_source *tracer;
    lmg_gathering *gathering;
    double scale; /* of the model's emission */
    void (*note)(void *self, size_t cell, const float (*radiance)[3],
                 uint32_t count); /* instead of lmg_gathering_put; NULL: none */
    void *note_self;
    uint64_t rays, segments;
    atomic_bool failed;
} gather_job;

typedef struct gather_state {
    uint64_t rays, segments;
    size_t cells, count;
    struct {
        size_t cell;
        uint32_t count;
    } waiting[ENOUGH_RAYS];
    lmg_ray ray[MOST_RAYS];
    float radiance[MOST_RAYS][3];
} gather_state;

static void *begin(void *self)
{
    (void)self;
    gather_state *s = malloc(sizeof(*s));
    if (s)
        s->rays = s->segments = s->cells = s->count = 0;
    return s;
}

/* Traces what waits. */
static void flush(gather_job *j, gather_state *s)
{
    if (!bake_tracer_look(j->tracer, s->ray, s->count, s->radiance, &s->segments)) {
        atomic_store(&j->failed, true);
        s->cells = s->count = 0;
        return;
    }
    for (size_t k = 0; k < s->count; ++k)
        for (int c = 0; c < 3; ++c)
            s->radiance[k][c] *= (float)j->scale;
    size_t at = 0;
    for (size_t k = 0; k < s->cells; ++k) {
        const float(*radiance)[3] = (const float(*)[3])s->radiance + at;
        if (j->note)
            j->note(j->note_self, s->waiting[k].cell, radiance, s->waiting[k].count);
        else
            lmg_gathering_put(j->gathering, s->waiting[k].cell, radiance);
        at += s->waiting[k].count;
    }
    s->rays += s->count;
    s->cells = s->count = 0;
}

static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    gather_job *j = self;
    gather_state *s = state;
    for (uint64_t i = first; i < first + count && !atomic_load_explicit(&j->failed, memory_order_relaxed); ++i) {
        const uint32_t n = lmg_gathering_draw(j->gathering, i, s->ray + s->count);
        if (n == 0) {
            lmg_gathering_put(j->gathering, i, NULL);
            continue;
        }
        s->waiting[s->cells].cell = i;
        s->waiting[s->cells++].count = n;
        s->count += n;
        if (s->count >= ENOUGH_RAYS)
            flush(j, s);
    }
    if (s->count > 0)
        flush(j, s);
}

static void end(void *self, void *state)
{
    gather_job *j = self;
    const gather_state *s = state;
    j->rays += s->rays;
    j->segments += s->segments;
    free(state);
}

static lmg_result run(gather_job *j, unsigned threads, lmg_error *err)
{
    const bake_work work = {.self = j, .begin = begin, .chunk = chunk, .end = end};
    lmg_result result = bake_parallel(&work, 0, lmg_gathering_cells(j->gathering), threads, err);
    if (result == LMG_OK && atomic_load(&j->failed))
        result = lmg_fail(err, LMG_ERROR_MEMORY,
                          "rays traced backwards: no memory, or they go round for ever; leave --gather out");
    return result;
}

lmg_result bake_gather_run(const bake_source *tracer, lmg_gathering *gathering, double flux, unsigned threads, uint64_t *segments,
                           lmg_error *err)
{
    gather_job j = {.tracer = tracer, .gathering = gathering, .scale = flux / bake_tracer_emission(tracer)};
    const lmg_result result = run(&j, threads, err);
    if (segments)
        *segments += j.segments;
    return result;
}

/* --------------------------------------------------------------------------------------------------------------- pilot */

/* Cells that are looked at, chosen by pilot photons and so in proportion to flux, and rays for each. */
enum { PILOT_CELLS = 2048, PILOT_RAYS = 16 };
/* A ray's time per segment over a photon's: rays have to be drawn, but those of a cell go the same way.  Measured in bakes of our
 * sample lamps: 0.8 (panel), 1.0 (spot), 1.5 (lens).  Counted by segments the decision doesn't depend on the machine. */
static const double RAY_SEGMENT = 1.1;
/* What of the variance weights with errors of their own leave (gather.c of lumigraph). */
static const double LEAST_VARIANCE = 0.1;
/* Gathering has to gain so much: predictions have errors, and photons alone are the simpler bake. */
static const double WORTH_IT = 0.9;

typedef struct seen_cell {
    double radiance; /* mean luminance */
    double variance; /* of single rays, relative */
    double photons;  /* expected in a half */
} seen_cell;

typedef struct pilot_notes {
    const lmg_gathering *gathering;
    double half; /* photons of a half per lumen */
    seen_cell *cell;
} pilot_notes;

static void note_cell(void *self, size_t i, const float (*radiance)[3], uint32_t count)
{
    const pilot_notes *notes = self;
    double sum = 0, squares = 0;
    for (uint32_t k = 0; k < count; ++k) {
        const double y = lmg_luminance(radiance[k]);
        sum += y;
        squares += y * y;
    }
    const double mean = sum / count, variance = fmax(squares - sum * mean, 0) / (count - 1);
    /* rays that all see nothing: at least as rare as one in so many */
    notes->cell[i] = (seen_cell){mean, mean > 0 ? variance / (mean * mean) : count,
                                 mean * lmg_gathering_etendue(notes->gathering, i) * notes->half};
}

/* Variance with so many rays per photon, over that of the photons alone: of radiance weighed by etendue, and of flux.  Cells into
 * whose other half no photon falls aren't gathered. */
static void predict(const seen_cell *cells, size_t count, double rays_per_photon, double *radiance, double *flux)
{
    double sum[2] = {0, 0}, all[2] = {0, 0};
    for (size_t i = 0; i < count; ++i) {
        const double missed = exp(-cells[i].photons * fmin(0.5 * rays_per_photon, 1));
        const double left = missed + (1 - missed) / (1 + rays_per_photon / (cells[i].variance + LEAST_VARIANCE));
        sum[0] += cells[i].radiance * left;
        all[0] += cells[i].radiance;
        sum[1] += left;
        all[1] += 1;
    }
    *radiance = all[0] > 0 ? sum[0] / all[0] : 1;
    *flux = all[1] > 0 ? sum[1] / all[1] : 1;
}

static void choose(const seen_cell *cells, size_t count, bake_gather_plan *plan)
{
    static const double CHOICES[] = {0.25, 0.5, 1, 2, 4};
    double best_radiance = 1, best_flux = 1;
    plan->gain = WORTH_IT;
    for (size_t i = 0; i < sizeof(CHOICES) / sizeof(CHOICES[0]); ++i) {
        double radiance, flux;
        predict(cells, count, CHOICES[i], &radiance, &flux);
        const double time = 1 + CHOICES[i] * plan->cost, gain = time * sqrt(radiance * flux);
        if (time * radiance < 1 && time * flux < 1 && gain < plan->gain) {
            plan->gain = gain;
            plan->rays_per_photon = CHOICES[i];
            best_radiance = time * radiance;
            best_flux = time * flux;
        }
    }
    if (plan->rays_per_photon > 0) {
        snprintf(plan->why, sizeof(plan->why),
                 "%g rays per photon: each costs %.2g photons; at equal cost the variance of radiance is to be %.2g, that of flux "
                 "%.2g of "
                 "photons' alone",
                 plan->rays_per_photon, plan->cost, best_radiance, best_flux);
        return;
    }
    double radiance, flux;
    predict(cells, count, 1, &radiance, &flux);
    plan->gain = 1;
    snprintf(plan->why, sizeof(plan->why),
             "photons only: a ray backwards costs %.2g photons, and one per photon would leave %.2g of the variance of radiance, "
             "%.2g of flux's",
             plan->cost, radiance, flux);
}

/* The pilot's cells in a gathering of their own. */
static lmg_result look_at_cells(const bake_source *tracer, const lmg_layout *layout, const lmg_ray *pilot, size_t count,
                                const bake_tally *tally, double photons, uint64_t seed, unsigned threads, seen_cell **cells,
                                size_t *cell_count, bake_gather_plan *plan, lmg_error *err)
{
    lmg_accumulator *few = NULL;
    lmg_gathering *gathering = NULL;
    lmg_result result = lmg_accumulator_create(layout, &few, err);
    const size_t wanted = count < PILOT_CELLS ? count : PILOT_CELLS;
    for (size_t i = 0; result == LMG_OK && i < wanted; ++i) {
        lmg_ray ray = pilot[i * count / wanted];
        ray.number = i; /* halves at random */
        ray.flux[0] = ray.flux[1] = ray.flux[2] = 1;
        lmg_accumulator_deposit(few, &ray, 1);
    }
    if (result == LMG_OK)
        result = lmg_gathering_create(few, PILOT_RAYS, ~seed, &gathering, err);
    if (result == LMG_OK) {
        *cell_count = lmg_gathering_cells(gathering);
        *cells = calloc(*cell_count + 1, sizeof(**cells));
        if (!*cells)
            result = lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the pilot of rays traced backwards");
    }
    if (result == LMG_OK) {
        pilot_notes notes = {gathering, 0.5 * photons / tracer->flux, *cells};
        gather_job j = {.tracer = tracer,
                        .gathering = gathering,
                        .scale = tracer->flux / bake_tracer_emission(tracer),
                        .note = note_cell,
                        .note_self = &notes};
        result = run(&j, threads, err);
        const double photon = (double)tally->segments / fmax(tally->escaped, 1);
        plan->cost = j.rays > 0 ? RAY_SEGMENT * (double)j.segments / (double)j.rays / photon : 0;
    }
    lmg_gathering_destroy(gathering);
    lmg_accumulator_destroy(few);
    return result;
}

lmg_result bake_gather_decide(const bake_source *tracer, const lmg_layout *layout, const lmg_ray *pilot, size_t count,
                              const bake_tally *tally, double photons, double rays_per_photon, uint64_t seed, unsigned threads,
                              bake_gather_plan *plan, lmg_error *err)
{
    *plan = (bake_gather_plan){.gain = 1};
    const char *obstacle;
    if (!bake_tracer_can_look(tracer, &obstacle)) {
        if (rays_per_photon > 0)
            return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                            "--gather: rays can't be traced backwards through a lamp with %s; leave it out", obstacle);
        snprintf(plan->why, sizeof(plan->why), "photons only: rays can't be traced backwards through a lamp with %s", obstacle);
        return LMG_OK;
    }
    seen_cell *cells = NULL;
    size_t cell_count = 0;
    const lmg_result result =
        look_at_cells(tracer, layout, pilot, count, tally, photons, seed, threads, &cells, &cell_count, plan, err);
    if (result == LMG_OK && rays_per_photon > 0) {
        plan->rays_per_photon = rays_per_photon;
        snprintf(plan->why, sizeof(plan->why), "%g rays per photon, as asked for", rays_per_photon);
    } else if (result == LMG_OK) {
        choose(cells, cell_count, plan);
    }
    free(cells);
    return result;
}
