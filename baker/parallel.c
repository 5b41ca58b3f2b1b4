/* SPDX-License-Identifier: Apache-2.0 */
/* Threads over chunks of photon numbers.  Relies on POSIX threads and C11 atomics. */
#include "parallel.h"

#include <luminaires/rng.h>
#include <luminaires/scene.h>

#include <pthread.h>
#include <stdatomic.h>
#include <unistd.h>

enum { MAX_THREADS = 1024 };

typedef struct job {
    const bake_work *work;
    uint64_t first, count;
    atomic_uint_fast64_t next;
} job;

typedef struct worker {
    job *job;
    void *state;
    pthread_t thread;
} worker;

unsigned bake_thread_count(unsigned threads)
{
    if (threads == 0) {
        long cores = sysconf(_SC_NPROCESSORS_ONLN);
        threads = cores > 0 ? (unsigned)cores : 1;
    }
    return threads < MAX_THREADS ? threads : MAX_THREADS;
}

static void *work_through(void *argument)
{
    worker *w = argument;
    job *j = w->job;
    const unsigned saved = lum_thread_begin();
    for (;;) {
        const uint64_t at = atomic_fetch_add_explicit(&j->next, BAKE_CHUNK, memory_order_relaxed);
        if (at >= j->count)
            break;
        const uint64_t left = j->count - at;
        j->work->chunk(j->work->self, w->state, j->first + at, left < BAKE_CHUNK ? left : BAKE_CHUNK);
    }
    lum_thread_end(saved);
    return NULL;
}

lmg_result bake_parallel(const bake_work *work, uint64_t first, uint64_t count, unsigned threads, lmg_error *err)
{
    if (count == 0)
        return LMG_OK;
    const uint64_t chunks = (count - 1) / BAKE_CHUNK + 1;
    threads = bake_thread_count(threads);
    if (threads > chunks)
        threads = (unsigned)chunks;

    worker workers[MAX_THREADS];
    job j = {.work = work, .first = first, .count = count};
    atomic_init(&j.next, 0);
    for (unsigned i = 0; i < threads; ++i) {
        workers[i].job = &j;
        workers[i].state = work->begin(work->self);
        if (!workers[i].state) {
            for (unsigned k = 0; k < i; ++k)
                work->end(work->self, workers[k].state);
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the state of %u threads", threads);
        }
    }
    unsigned started = 1;
    while (started < threads && pthread_create(&workers[started].thread, NULL, work_through, &workers[started]) == 0)
        ++started;
    work_through(&workers[0]);
    for (unsigned i = 1; i < started; ++i)
        pthread_join(workers[i].thread, NULL);
    for (unsigned i = 0; i < threads; ++i)
        work->end(work->self, workers[i].state);
    return LMG_OK;
}

static uint64_t common_divisor(uint64_t a, uint64_t b)
{
    while (b) {
        const uint64_t rest = a % b;
        a = b;
        b = rest;
    }
    return a;
}

uint64_t bake_pilot_place(uint64_t i, uint64_t count, uint64_t run, uint64_t seed)
{
    const uint64_t runs = count / run;
    if (runs == 0)
        return i % count;
    /* by a step near the golden section of their number, which spreads any part of them evenly; what the last run leaves over goes before the
     * first or after the last */
    uint64_t step = (uint64_t)(0.6180339887498949 * (double)runs) + 1;
    while (common_divisor(step, runs) != 1)
        ++step;
    const uint64_t turn = i / run % runs, begin = lum_mix64(seed);
    __extension__ typedef unsigned __int128 wide; /* the product of two 64-bit numbers */
    const uint64_t place = (uint64_t)(((wide)turn * step + begin % runs) % runs);
    return begin / runs % (count % run + 1) + place * run + i % run;
}
