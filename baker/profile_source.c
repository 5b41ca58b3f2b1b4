/* SPDX-License-Identifier: Apache-2.0 */
/* Rays of a far-field distribution: direction by intensity, origin on the luminous shape by its projected area. */
#include "source.h"

#include "batch.h"
#include "parallel.h"

#include <luminaires/photometry.h>

#include <stdlib.h>

typedef struct profile_source {
    bake_source source; /* first: a bake_source is cast back to its profile_source */
    lum_profile *profile;
    lum_shape shape;
    uint64_t seed;
} profile_source;

typedef struct job {
    const profile_source *p;
    const lmg_sink *sinks;
    size_t sink_count;
} job;

static double next(void *state)
{
    return lum_rng_next(state);
}

static void *begin(void *self)
{
    const job *j = self;
    bake_batch *batch = malloc(sizeof(*batch));
    if (batch) {
        batch->sinks = j->sinks;
        batch->sink_count = j->sink_count;
        batch->count = 0;
    }
    return batch;
}

static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    const job *j = self;
    for (uint64_t i = 0; i < count; ++i) {
        lum_rng rng = lum_rng_stream(j->p->seed, first + i);
        double xi[3];
        for (int k = 0; k < 3; ++k)
            xi[k] = lum_rng_next(&rng);
        lmg_ray *ray = bake_batch_next(state);
        ray->direction = lum_profile_direction(j->p->profile, next, &rng);
        ray->origin = lum_shape_point(&j->p->shape, ray->direction, xi);
        ray->flux[0] = ray->flux[1] = ray->flux[2] = 1;
        ray->wavelength = 0;
        ray->number = first + i;
    }
}

static void end(void *self, void *state)
{
    (void)self;
    bake_batch_flush(state);
    free(state);
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err)
{
    job j = {.p = (const profile_source *)source, .sinks = sinks, .sink_count = sink_count};
    const bake_work work = {.self = &j, .begin = begin, .chunk = chunk, .end = end};
    const lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result != LMG_OK)
        return result;
    tally->photons += count;
    tally->emitted += (double)count;
    tally->escaped += (double)count;
    return LMG_OK;
}

static void destroy(bake_source *source)
{
    profile_source *p = (profile_source *)source;
    lum_profile_destroy(p->profile);
    free(p);
}

lmg_result bake_profile_source_create(const lum_photometry *photometry, uint64_t seed, bake_source **out, lmg_error *err)
{
    *out = NULL;
    profile_source *p = calloc(1, sizeof(*p));
    if (!p)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a distribution as a source");
    const lmg_result result = lum_profile_create(photometry, &p->profile, err);
    if (result != LMG_OK) {
        free(p);
        return result;
    }
    p->shape = photometry->shape;
    p->seed = seed;
    lmg_vec3 half = {0.5 * p->shape.c0, 0.5 * p->shape.height, 0.5 * p->shape.c90};
    if (p->shape.kind == LUM_SHAPE_POINT || !(half.x > 0 || half.y > 0 || half.z > 0))
        half = (lmg_vec3){0.0005, 0.0005, 0.0005};
    p->source.run = run;
    p->source.destroy = destroy;
    p->source.flux = lum_profile_flux(p->profile);
    p->source.bounds_min = (lmg_vec3){-half.x, -half.y, -half.z};
    p->source.bounds_max = half;
    p->source.even = p->shape.kind == LUM_SHAPE_POINT || p->shape.kind == LUM_SHAPE_RECTANGLE;
    *out = &p->source;
    return LMG_OK;
}
