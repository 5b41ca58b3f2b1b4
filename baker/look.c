/* SPDX-License-Identifier: Apache-2.0 */
#include "look.h"

#include "parallel.h"
#include "tracer.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

/* Rays that are traced together. */
enum { TOGETHER = 4096 };
enum { LOOK_ROUND = 400000 };

typedef struct look_job {
    const bake_source *tracer;
    lmg_looks *looks;
    const float *brightness; /* of surfaces; NULL: radiance */
    double scale; /* of the model's emission */
    atomic_bool failed;
} look_job;

/* Paths that go round for ever, or no memory. */
static lmg_result cant_look(lmg_error *err)
{
    return lmg_fail(err, LMG_ERROR_MEMORY, "rays traced backwards: no memory, or they go round for ever");
}

lmg_result bake_look_noise(const bake_source *tracer, const lmg_ray *rays, size_t count, double *noise, lmg_error *err)
{
    enum { PAIRS = 4096 };
    const size_t pairs = count < PAIRS ? count : PAIRS;
    lmg_ray *twice = malloc((2 * pairs + 1) * sizeof(*twice));
    float(*radiance)[3] = malloc((2 * pairs + 1) * sizeof(*radiance));
    const bool seen = twice && radiance;
    for (size_t i = 0; i < 2 * pairs && seen; ++i) {
        twice[i] = rays[i / 2 * count / pairs];
        twice[i].number = UINT64_MAX - i; /* looks of trees have random ones */
    }
    const bool done = seen && bake_tracer_look(tracer, twice, 2 * pairs, radiance, NULL);
    double squares = 0, differences = 0;
    for (size_t i = 0; i < pairs && done; ++i) {
        const double a = lmg_luminance(radiance[2 * i]), b = lmg_luminance(radiance[2 * i + 1]);
        squares += a * b;
        differences += 0.5 * (a - b) * (a - b);
    }
    *noise = squares > 0 ? differences / squares : (double)INFINITY;
    free(twice);
    free(radiance);
    return done ? LMG_OK : cant_look(err);
}

/* ---------------------------------------------------------------------------------------------------------- brightness */

/* Rays of light that are asked where they come from, at most. */
enum { MOST_ASKED = 400000 };
/* A surface that fewer looks have met is taken to be as bright as all are together; of one that no ray has come from it is the light of half a
 * ray. */
enum { FEWEST_MET = 20 };
static const double NO_RAY = 0.5;

typedef struct survey_job {
    const bake_source *tracer;
    lmg_looks *looks; /* NULL: along rays */
    const lmg_ray *rays;
    size_t every; /* so many-th of them */
    uint32_t *surface;
} survey_job;

static void *survey_begin(void *self)
{
    (void)self;
    return malloc(TOGETHER * sizeof(lmg_ray));
}

static void survey_chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    survey_job *j = self;
    lmg_ray *ray = state;
    for (uint64_t done = 0; done < count;) {
        const size_t n = (size_t)(count - done < TOGETHER ? count - done : TOGETHER);
        if (j->looks)
            lmg_looks_draw(j->looks, (size_t)(first + done), n, ray);
        for (size_t k = 0; k < n && !j->looks; ++k)
            ray[k] = j->rays[(first + done + k) * j->every];
        bake_tracer_outline(j->tracer, ray, n, j->surface + first + done);
        done += n;
    }
}

static void survey_end(void *self, void *state)
{
    (void)self;
    free(state);
}

/* What is met first along the looks, or rays. */
static lmg_result meet_surfaces(survey_job *j, size_t count, unsigned threads, lmg_error *err)
{
    const bake_work work = {.self = j, .begin = survey_begin, .chunk = survey_chunk, .end = survey_end};
    j->surface = malloc((count + 1) * sizeof(*j->surface));
    return j->surface ? bake_parallel(&work, 0, count, threads, err) : lmg_fail(err, LMG_ERROR_MEMORY, "looks: no memory");
}

/* Of a surface: light, in any unit, etendue, and how many looks have met it. */
typedef struct surface_sums {
    double light, etendue;
    size_t looks;
} surface_sums;

static void set_brightness(const surface_sums *of, uint32_t surfaces, double ray, float *brightness)
{
    double light = 0, etendue = 0, most = 0;
    for (uint32_t i = 0; i < surfaces; ++i) {
        light += of[i].light;
        etendue += of[i].etendue;
    }
    for (int pass = 0; pass < 2; ++pass) /* the most, then parts of it */
        for (uint32_t i = 0; i < surfaces; ++i) {
            const double l = of[i].looks >= FEWEST_MET ? fmax(of[i].light, NO_RAY * ray) / of[i].etendue
                             : etendue > 0             ? light / etendue
                                                       : 0;
            most = fmax(most, l);
            brightness[i] = most > 0 ? (float)(l / most) : 1;
        }
}

/* Puts what is expected of all looks, by the surfaces that they meet. */
static void expect(lmg_looks *looks, const uint32_t *surface, const float *brightness)
{
    for (size_t i = 0; i < lmg_looks_count(looks); ++i) {
        const float y = surface[i] != BAKE_NO_SURFACE ? brightness[surface[i]] : 0;
        lmg_looks_put(looks, i, 1, (const float[1][3]){{y, y, y}});
    }
}

lmg_result bake_look_brightness(const bake_source *tracer, lmg_looks *looks, const lmg_ray *rays, size_t count, unsigned threads,
                                float **brightness, lmg_error *err)
{
    const uint32_t surfaces = bake_tracer_surfaces(tracer);
    const size_t every = 1 + count / MOST_ASKED, asked = count / every, look_count = lmg_looks_count(looks);
    survey_job by_looks = {.tracer = tracer, .looks = looks}, by_rays = {.tracer = tracer, .rays = rays, .every = every};
    surface_sums *of = calloc(surfaces + 1, sizeof(*of));
    float *made = malloc((surfaces + 1) * sizeof(*made)), *even = malloc((surfaces + 1) * sizeof(*even));
    for (uint32_t i = 0; i < surfaces && even; ++i)
        even[i] = 1;
    lmg_result result = of && made && even ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "looks: no memory");
    if (result == LMG_OK)
        result = meet_surfaces(&by_looks, look_count, threads, err);
    if (result == LMG_OK)
        result = meet_surfaces(&by_rays, asked, threads, err);
    if (result == LMG_OK) {
        double light = 0;
        for (size_t i = 0; i < look_count; ++i)
            if (by_looks.surface[i] != BAKE_NO_SURFACE && lmg_looks_weight(looks, i) > 0) {
                of[by_looks.surface[i]].etendue += lmg_looks_weight(looks, i);
                of[by_looks.surface[i]].looks++;
            }
        for (size_t i = 0; i < asked; ++i) {
            const double y = lmg_luminance(rays[i * every].flux);
            light += y;
            if (by_rays.surface[i] != BAKE_NO_SURFACE)
                of[by_rays.surface[i]].light += y;
        }
        set_brightness(of, surfaces, asked > 0 ? light / (double)asked : 0, made);
        expect(looks, by_looks.surface, even);
        const double unexpected = lmg_looks_unexpected(looks);
        expect(looks, by_looks.surface, made);
        if (lmg_looks_unexpected(looks) >= unexpected) { /* what is bright on one side and dark on the other, say */
            memcpy(made, even, surfaces * sizeof(*made));
            expect(looks, by_looks.surface, made);
        }
    }
    free(by_looks.surface);
    free(by_rays.surface);
    free(of);
    free(even);
    if (result != LMG_OK) {
        free(made);
        made = NULL;
    }
    *brightness = made;
    return result;
}

/* ---------------------------------------------------------------------------------------------------------- all looks */

typedef struct look_state {
    lmg_ray ray[TOGETHER];
    float radiance[TOGETHER][3];
    uint32_t surface[TOGETHER];
} look_state;

static void *look_begin(void *self)
{
    (void)self;
    return malloc(sizeof(look_state));
}

static void look_chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    look_job *j = self;
    look_state *s = state;
    for (uint64_t done = 0; done < count && !atomic_load_explicit(&j->failed, memory_order_relaxed);) {
        const size_t n = (size_t)(count - done < TOGETHER ? count - done : TOGETHER);
        lmg_looks_draw(j->looks, (size_t)(first + done), n, s->ray);
        if (j->brightness)
            bake_tracer_outline(j->tracer, s->ray, n, s->surface);
        else if (!bake_tracer_look(j->tracer, s->ray, n, s->radiance, NULL)) {
            atomic_store(&j->failed, true);
            return;
        }
        for (size_t k = 0; k < n; ++k)
            for (int c = 0; c < 3; ++c)
                s->radiance[k][c] = !j->brightness                       ? s->radiance[k][c] * (float)j->scale
                                    : s->surface[k] != BAKE_NO_SURFACE ? j->brightness[s->surface[k]]
                                                                         : 0;
        lmg_looks_put(j->looks, (size_t)(first + done), n, (const float(*)[3])s->radiance);
        done += n;
    }
}

static void look_end(void *self, void *state)
{
    (void)self;
    free(state);
}

lmg_result bake_look_run(const bake_source *tracer, lmg_looks *looks, const float *brightness, double flux, unsigned threads,
                         const volatile sig_atomic_t *stop, lmg_error *err)
{
    look_job j = {.tracer = tracer, .looks = looks, .brightness = brightness, .scale = flux / bake_tracer_emission(tracer)};
    const bake_work work = {.self = &j, .begin = look_begin, .chunk = look_chunk, .end = look_end};
    const uint64_t count = lmg_looks_count(looks);
    lmg_result result = LMG_OK;
    for (uint64_t first = 0; result == LMG_OK && first < count && !(stop && *stop); first += LOOK_ROUND) {
        result = bake_parallel(&work, first, count - first < LOOK_ROUND ? count - first : LOOK_ROUND, threads, err);
        if (result == LMG_OK && atomic_load(&j.failed))
            result = cant_look(err);
    }
    return result;
}
