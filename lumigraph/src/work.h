/* SPDX-License-Identifier: Apache-2.0 */
/* Work shared out over the processors, for the files of this library only. */
#ifndef LUMIGRAPH_WORK_H
#define LUMIGRAPH_WORK_H

#include <lumigraph/lumigraph.h>

#include <pthread.h>
#include <stdatomic.h>

/* count independent pieces of work, done by all processors.  Of several failures the one of the lowest piece is reported, so that
 * the same file gives the same message every time. */
typedef struct lmg_work {
    lmg_result (*piece)(void *self, uint64_t index, void *scratch, lmg_error *err);
    void (*end)(void *self, void *scratch); /* frees what a thread's scratch holds; may be NULL */
    void *self;
    size_t scratch_size; /* each thread's own, zeroed, at most LMG_WORK_SCRATCH */
    uint64_t count;
    atomic_uint_least64_t next;   /* from here on work.c's own */
    atomic_uint_least64_t failed; /* lowest failed piece so far, or count */
    pthread_mutex_t lock;         /* guards result and error */
    uint64_t reported;
    lmg_result result;
    lmg_error error;
} lmg_work;

enum { LMG_WORK_SCRATCH = 1024 };

/* Does all pieces and returns when the last has ended; the first fields up to count are the caller's to set. */
lmg_result lmg_work_do(lmg_work *w, lmg_error *err);

#endif
