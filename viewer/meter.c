/* SPDX-License-Identifier: Apache-2.0 */
/* Paths for one meter on all cores (meter.h).  Blocks of paths are handed out by a counter and added up in their order. */
#include "meter.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { BLOCK = 1024, MAX_THREADS = 1024 };

/* Sums over a block's paths. */
typedef struct block_sum {
    double sum[4], squares[4]; /* R,G,B, luminance */
    double deviation[VIEW_BAKES];
    uint64_t refused;
} block_sum;

typedef struct job {
    const view_scene *scene;
    const view_meter_options *options;
    lmg_vec3 point, normal;
    size_t blocks;
    block_sum *sums;
    atomic_size_t next;
} job;

typedef struct task {
    job *job;
    view_worker worker;
    pthread_t thread;
} task;

static void read_block(job *j, view_worker *worker, size_t index)
{
    block_sum *sum = &j->sums[index];
    uint64_t first = (uint64_t)index * BLOCK, refused = worker->refused;
    worker->deviation = sum->deviation;
    for (uint64_t k = first; k < first + BLOCK && k < j->options->samples; k++) {
        lum_rng rng = lum_rng_stream(j->options->seed, k);
        double value[4];
        view_path_illuminance(j->scene, &j->options->path, j->point, j->normal, &rng, worker, value);
        value[3] = 0.2126 * value[0] + 0.7152 * value[1] + 0.0722 * value[2];
        for (int c = 0; c < 4; c++) {
            sum->sum[c] += value[c];
            sum->squares[c] += value[c] * value[c];
        }
    }
    sum->refused = worker->refused - refused;
}

static void *run(void *argument)
{
    task *t = argument;
    unsigned saved = lum_thread_begin();
    for (;;) {
        size_t index = atomic_fetch_add(&t->job->next, 1);
        if (index >= t->job->blocks) {
            break;
        }
        read_block(t->job, &t->worker, index);
    }
    lum_thread_end(saved);
    return NULL;
}

static lmg_result run_all(job *j, unsigned threads, lmg_error *err)
{
    size_t lights = j->scene->light_count ? j->scene->light_count : 1;
    task *tasks = calloc(threads, sizeof *tasks);
    double *weights = calloc(2 * threads * lights, sizeof *weights);
    if (!tasks || !weights) {
        free(tasks);
        free(weights);
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %u threads", threads);
    }
    unsigned started = 0;
    for (unsigned i = 0; i < threads; i++) {
        tasks[i] = (task){.job = j, .worker = {.weights = weights + 2 * i * lights}};
    }
    while (started + 1 < threads && pthread_create(&tasks[started].thread, NULL, run, &tasks[started]) == 0) {
        started++;
    }
    run(&tasks[started]);
    for (unsigned i = 0; i < started; i++) {
        pthread_join(tasks[i].thread, NULL);
    }
    free(tasks);
    free(weights);
    return LMG_OK;
}

double view_bake_error(const double a[VIEW_BAKES], const double b[VIEW_BAKES])
{
    double product = 0;
    for (int k = 0; k < VIEW_BAKES; k++) {
        product += a[k] * b[k] / VIEW_BAKES;
    }
    return sqrt(fmax(product, 0));
}

static void add_up(const job *j, view_reading *out)
{
    double squares[4] = {0}, sum[4] = {0}, half[2][VIEW_BAKES] = {{0}}, n = (double)j->options->samples;
    for (size_t i = 0; i < j->blocks; i++) {
        const block_sum *s = &j->sums[i];
        for (int c = 0; c < 4; c++) {
            sum[c] += s->sum[c];
            squares[c] += s->squares[c];
        }
        for (int k = 0; k < VIEW_BAKES; k++) {
            half[i % 2][k] += VIEW_PI * s->deviation[k];
        }
        out->refused += s->refused;
    }
    double paths[2] = {0, 0};
    for (size_t i = 0; i < j->blocks; i++) {
        paths[i % 2] += (double)(i + 1 < j->blocks ? BLOCK : j->options->samples - (uint64_t)i * BLOCK);
    }
    for (int k = 0; k < VIEW_BAKES; k++) {
        half[0][k] /= paths[0];
        half[1][k] /= fmax(paths[1], 1);
    }
    for (int c = 0; c < 4; c++) {
        double mean = sum[c] / n, se = sqrt(fmax(squares[c] / n - mean * mean, 0) / (n - 1));
        *(c < 3 ? &out->rgb[c] : &out->lux) = mean;
        *(c < 3 ? &out->se[c] : &out->render) = se;
    }
    out->bake = view_bake_error(half[0], half[paths[1] > 0]);
}

lmg_result view_meter_read(const view_scene *scene, lmg_vec3 point, lmg_vec3 normal, const view_meter_options *options,
                           view_reading *out, lmg_error *err)
{
    struct timespec begin, end;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    *out = (view_reading){.samples = options->samples};
    if (options->samples < 2) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a meter needs two paths at least");
    }
    long cores = sysconf(_SC_NPROCESSORS_ONLN);
    unsigned threads = options->threads ? options->threads : cores > 0 ? (unsigned)cores : 1;
    job j = {.scene = scene, .options = options, .point = point, .normal = normal};
    j.blocks = (size_t)((options->samples + BLOCK - 1) / BLOCK);
    j.sums = calloc(j.blocks, sizeof *j.sums);
    if (!j.sums) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %llu paths", (unsigned long long)options->samples);
    }
    lmg_result r = run_all(&j, threads < MAX_THREADS ? threads : MAX_THREADS, err);
    if (r == LMG_OK) {
        add_up(&j, out);
    }
    free(j.sums);
    clock_gettime(CLOCK_MONOTONIC, &end);
    out->seconds = (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
    return r;
}
