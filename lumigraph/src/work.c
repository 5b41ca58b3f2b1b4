/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Shares independent pieces of work out over the processors.  Relies on POSIX threads; goes on with the calling thread alone when
 * no other can be started.
 */
#include "work.h"

#include <stddef.h>
#include <string.h>
#include <unistd.h>

enum { MAX_THREADS = 16 };

static void *work_run(void *argument)
{
    lmg_work *w = argument;
    _Alignas(max_align_t) unsigned char scratch[LMG_WORK_SCRATCH];
    memset(scratch, 0, w->scratch_size);
    for (;;) {
        const uint64_t index = atomic_fetch_add(&w->next, 1);
        if (index >= w->count || index > atomic_load(&w->failed)) {
            break;
        }
        lmg_error error = {.message = ""};
        const lmg_result result = w->piece(w->self, index, scratch, &error);
        if (result != LMG_OK) {
            pthread_mutex_lock(&w->lock);
            if (index < w->reported) {
                w->reported = index;
                w->result = result;
                w->error = error;
                atomic_store(&w->failed, index);
            }
            pthread_mutex_unlock(&w->lock);
        }
    }
    if (w->end != NULL) {
        w->end(w->self, scratch);
    }
    return NULL;
}

lmg_result lmg_work_do(lmg_work *w, lmg_error *err)
{
    atomic_init(&w->next, 0);
    atomic_init(&w->failed, w->count);
    w->reported = w->count;
    w->result = LMG_OK;
    if (pthread_mutex_init(&w->lock, NULL) != 0) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "can't make a lock");
    }
    const long processors = sysconf(_SC_NPROCESSORS_ONLN);
    uint64_t wanted = processors < 1 ? 1 : processors > MAX_THREADS ? MAX_THREADS : (uint64_t)processors;
    if (wanted > w->count) {
        wanted = w->count;
    }
    pthread_t threads[MAX_THREADS];
    unsigned started = 0;
    while (started + 1 < wanted && pthread_create(&threads[started], NULL, work_run, w) == 0) {
        started++;
    }
    work_run(w); /* this thread works too, so it goes on if no other could be started */
    for (unsigned i = 0; i < started; i++) {
        pthread_join(threads[i], NULL);
    }
    pthread_mutex_destroy(&w->lock);
    if (w->result != LMG_OK && err != NULL) {
        *err = w->error;
    }
    return w->result;
}
