/* SPDX-License-Identifier: Apache-2.0 */
/* Work on a range of photon numbers, cut into chunks that the threads take from one counter.  Which thread takes which chunk is
 * left to chance, so whatever a chunk does must depend on its numbers alone and add up in any order. */
#ifndef BAKER_PARALLEL_H
#define BAKER_PARALLEL_H

#include <lumigraph/lumigraph.h>

/* Numbers in a chunk, at most: enough that taking one costs nothing, few enough that the threads finish together. */
enum { BAKE_CHUNK = 4096 };

typedef struct bake_work {
    void *self;
    /* One thread's own state, made before the threads start; NULL = out of memory. */
    void *(*begin)(void *self);
    void (*chunk)(void *self, void *state, uint64_t first, uint64_t count);
    /* Called for one state after the other once all threads have finished: merging needs no lock. */
    void (*end)(void *self, void *state);
} bake_work;

/* Number of threads that `threads` asks for: 0 = one per core that is online. */
unsigned bake_thread_count(unsigned threads);

/* Does first .. first+count-1.  The calling thread works too; if the system gives fewer threads than asked for, those do it all.
 * Denormal floats are flushed to zero while working (what Embree asks of every thread that traces), and as before afterwards. */
lmg_result bake_parallel(const bake_work *work, uint64_t first, uint64_t count, unsigned threads, lmg_error *err);

/* Which of the `count` items of a file (at least 1) the i-th of a pilot is: runs of `run` neighbours (an access to the file costs time) from
 * all over the file, none twice before all have had their turn.  seed: where it starts. */
uint64_t bake_pilot_place(uint64_t i, uint64_t count, uint64_t run, uint64_t seed);

#endif
