/* SPDX-License-Identifier: Apache-2.0 */
/* A thread's own batch of rays on its way from a source to the sinks. */
#ifndef BAKER_BATCH_H
#define BAKER_BATCH_H

#include <lumigraph/lumigraph.h>

/* 512 rays of 72 bytes stay in the second-level cache beside the scene. */
enum { BAKE_BATCH_RAYS = 512 };

typedef struct bake_batch {
    const lmg_sink *sinks;
    size_t sink_count;
    size_t count;
    lmg_ray rays[BAKE_BATCH_RAYS];
} bake_batch;

static inline void bake_batch_flush(bake_batch *batch)
{
    if (batch->count > 0)
        for (size_t i = 0; i < batch->sink_count; ++i)
            batch->sinks[i].consume(batch->sinks[i].self, batch->rays, batch->count);
    batch->count = 0;
}

/* The place of the next ray; the caller fills it before anything else happens to the batch. */
static inline lmg_ray *bake_batch_next(bake_batch *batch)
{
    if (batch->count == BAKE_BATCH_RAYS)
        bake_batch_flush(batch);
    return &batch->rays[batch->count++];
}

#endif
