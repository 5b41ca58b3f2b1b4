/* SPDX-License-Identifier: Apache-2.0 */
/* Rays emitted by a baked box: each carries a luminance-weighted flux of 1, drawn in proportion to the stored light. */
#include "source.h"

#include "batch.h"
#include "parallel.h"

#include <luminaires/rng.h>

#include <stdlib.h>

typedef struct box_source {
    bake_source source; /* first: a bake_source is cast back to its box_source */
    const lmg_field *field;
    uint64_t seed;
} box_source;

typedef struct job {
    const box_source *box;
    const lmg_sink *sinks;
    size_t sink_count;
    uint64_t photons, escaped;
} job;

typedef struct worker {
    uint64_t photons, escaped;
    bake_batch batch;
} worker;

static void *begin(void *self)
{
    const job *j = self;
    worker *w = malloc(sizeof(*w));
    if (w) {
        w->photons = w->escaped = 0;
        w->batch.sinks = j->sinks;
        w->batch.sink_count = j->sink_count;
        w->batch.count = 0;
    }
    return w;
}

static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    const job *j = self;
    worker *w = state;
    for (uint64_t i = 0; i < count; ++i) {
        lum_rng rng = lum_rng_stream(j->box->seed, first + i);
        double xi[5];
        for (int k = 0; k < 5; ++k)
            xi[k] = lum_rng_next(&rng);
        lmg_ray *ray = bake_batch_next(&w->batch);
        ++w->photons;
        if (!lmg_field_emit(j->box->field, xi, ray)) {
            --w->batch.count;
            continue;
        }
        ray->number = first + i;
        ++w->escaped;
    }
}

static void end(void *self, void *state)
{
    job *j = self;
    worker *w = state;
    bake_batch_flush(&w->batch);
    j->photons += w->photons;
    j->escaped += w->escaped;
    free(w);
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err)
{
    job j = {.box = (const box_source *)source, .sinks = sinks, .sink_count = sink_count};
    const bake_work work = {.self = &j, .begin = begin, .chunk = chunk, .end = end};
    const lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result != LMG_OK)
        return result;
    tally->photons += j.photons;
    tally->emitted += (double)j.photons;
    tally->escaped += (double)j.escaped;
    tally->lost += (double)(j.photons - j.escaped);
    return LMG_OK;
}

static void destroy(bake_source *source)
{
    free(source);
}

lmg_result bake_box_source_create(const lmg_field *field, uint64_t seed, bake_source **out, lmg_error *err)
{
    *out = NULL;
    const lmg_layout *layout = lmg_field_layout(field);
    double flux = 0;
    for (uint32_t i = 0; i < layout->slab_count; ++i)
        flux += lmg_field_slab_flux(field, i, NULL);
    const lmg_ledger ledger = lmg_field_ledger(field);
    if (!(flux > 0))
        return lmg_fail(err, LMG_ERROR_INPUT, "the box holds no light");
    box_source *box = calloc(1, sizeof(*box));
    if (!box)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a box as a source");
    box->source.run = run;
    box->source.destroy = destroy;
    box->source.flux = flux;
    box->source.flux_se = ledger.stored_se;
    box->source.bounds_min = layout->bounds_min;
    box->source.bounds_max = layout->bounds_max;
    box->field = field;
    box->seed = seed;
    *out = &box->source;
    return LMG_OK;
}
