/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Rays of a file as a source.  Photon number n is ray n of the file; pilot numbers pick groups of rays all over it.  The whole file
 * is read once when the source is made: every ray is checked before any light is used, and flux, bounds and the mean flux that a unit
 * stands for are known.
 */
#include "source.h"

#include "bake.h"
#include "parallel.h"

#include <luminaires/rayfile.h>

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

/* Pilot rays come in runs of so many neighbours: a run costs one access to the file. */
enum { PILOT_RUN = 64 };
/* Receivers and accumulators count squares of ray units in 64 bits: the largest ray times the number of rays stays below this. */
static const double MOST_UNEVEN = 0x1p42;
/* The flux of a run is summed in integers of 2^-20 units per chunk. */
static const double UNIT = 0x1p20;

typedef struct rayfile_source {
    bake_source source; /* first: a bake_source is cast back */
    const lum_rayfile *file;
    uint64_t seed;
    double scale; /* units (mean rays) per lumen or watt */
} rayfile_source;

/* One run over part of the file, whatever is done with the rays. */
typedef struct job {
    const rayfile_source *source;
    const lmg_sink *sinks;
    size_t sink_count;
    double *sums;      /* scan: flux of each chunk, so that the total doesn't depend on who adds first */
    lmg_result result; /* the failure of the lowest ray */
    uint64_t failed_at;
    lmg_error error;
    int64_t units; /* run: flux, in 1/UNIT: integers, for the same reason */
    uint64_t rays;
    lmg_vec3 lo, hi;
    double most;
} job;

typedef struct worker {
    lum_ray_reader *reader;
    lmg_ray *rays;
    double most;
    int64_t units;
    uint64_t count;
    lmg_vec3 lo, hi;
    uint64_t failed_at; /* first ray of the chunk that failed; UINT64_MAX = none */
    lmg_result result;
    lmg_error error;
} worker;

static void *begin(void *self)
{
    const job *j = self;
    worker *w = calloc(1, sizeof(*w));
    if (!w)
        return NULL;
    w->rays = malloc(LUM_RAY_BLOCK * sizeof(*w->rays));
    if (!w->rays || lum_ray_reader_create(j->source->file, &w->reader, NULL) != LMG_OK) {
        free(w->rays);
        free(w);
        return NULL;
    }
    w->failed_at = UINT64_MAX;
    w->lo = (lmg_vec3){INFINITY, INFINITY, INFINITY};
    w->hi = (lmg_vec3){-INFINITY, -INFINITY, -INFINITY};
    return w;
}

/* Chunks are taken in rising order, so a worker's first failure is its lowest, and the lowest of all workers is the file's. */
static bool read_rays(worker *w, uint64_t first, size_t count, double scale)
{
    if (w->result != LMG_OK)
        return false;
    w->result = lum_ray_reader_read(w->reader, first, count, scale, w->rays, &w->error);
    if (w->result == LMG_OK)
        return true;
    w->failed_at = first;
    return false;
}

static void end(void *self, void *state)
{
    job *j = self;
    worker *w = state;
    if (w->result != LMG_OK && w->failed_at < j->failed_at) {
        j->failed_at = w->failed_at;
        j->result = w->result;
        j->error = w->error;
    }
    j->units += w->units;
    j->rays += w->count;
    j->most = fmax(j->most, w->most);
    j->lo = (lmg_vec3){fmin(j->lo.x, w->lo.x), fmin(j->lo.y, w->lo.y), fmin(j->lo.z, w->lo.z)};
    j->hi = (lmg_vec3){fmax(j->hi.x, w->hi.x), fmax(j->hi.y, w->hi.y), fmax(j->hi.z, w->hi.z)};
    lum_ray_reader_destroy(w->reader);
    free(w->rays);
    free(w);
}

static double smaller(double a, double b)
{
    return a < b ? a : b;
}

static double larger(double a, double b)
{
    return a > b ? a : b;
}

/* ---------------------------------------------------------------------------------------------------------------- scan */

static void scan_chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    const job *j = self;
    worker *w = state;
    if (!read_rays(w, first, (size_t)count, 1))
        return;
    double sum = 0;
    lmg_vec3 lo = w->lo, hi = w->hi;
    for (uint64_t i = 0; i < count; ++i) {
        const lmg_ray *ray = &w->rays[i];
        const double y = lmg_luminance(ray->flux);
        sum += y;
        w->most = larger(w->most, y);
        lo = (lmg_vec3){smaller(lo.x, ray->origin.x), smaller(lo.y, ray->origin.y), smaller(lo.z, ray->origin.z)};
        hi = (lmg_vec3){larger(hi.x, ray->origin.x), larger(hi.y, ray->origin.y), larger(hi.z, ray->origin.z)};
    }
    w->lo = lo;
    w->hi = hi;
    w->count += count;
    j->sums[first / BAKE_CHUNK] = sum;
}

static lmg_result scan(rayfile_source *s, unsigned threads, lmg_error *err)
{
    const uint64_t rays = lum_rayfile_info(s->file)->rays;
    const uint64_t chunks = (rays - 1) / BAKE_CHUNK + 1;
    job j = {.source = s,
             .failed_at = UINT64_MAX,
             .lo = {INFINITY, INFINITY, INFINITY},
             .hi = {-INFINITY, -INFINITY, -INFINITY}};
    j.sums = chunks <= SIZE_MAX / sizeof(*j.sums) ? calloc((size_t)chunks, sizeof(*j.sums)) : NULL;
    if (!j.sums)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the sums of %" PRIu64 " rays", rays);
    const bake_work work = {.self = &j, .begin = begin, .chunk = scan_chunk, .end = end};
    lmg_result result = bake_parallel(&work, 0, rays, threads, err);
    if (result == LMG_OK && j.result != LMG_OK) {
        result = j.result;
        if (err)
            *err = j.error;
    }
    double total = 0, lost = 0; /* Neumaier's sum */
    for (uint64_t i = 0; result == LMG_OK && i < chunks; ++i) {
        const double t = total + j.sums[i];
        lost += fabs(total) >= fabs(j.sums[i]) ? (total - t) + j.sums[i] : (j.sums[i] - t) + total;
        total = t;
    }
    total += lost;
    free(j.sums);
    if (result != LMG_OK)
        return result;
    if (!(total > 0) || !isfinite(total))
        return lmg_fail(err, LMG_ERROR_INPUT, "its rays carry no light");
    const double mean = total / (double)rays;
    if (j.most / mean * (double)rays > MOST_UNEVEN)
        return lmg_fail(err, LMG_ERROR_INPUT, "one ray carries %.3g times the mean flux: too uneven to be counted", j.most / mean);
    s->scale = 1 / mean;
    s->source.flux = total;
    s->source.photons = rays;
    s->source.bounds_min = j.lo;
    s->source.bounds_max = j.hi;
    return LMG_OK;
}

/* ----------------------------------------------------------------------------------------------------------------- run */

/* Rays `first` .. of the pilot: runs of neighbours at places drawn from (seed, run). */
static bool read_pilot(const rayfile_source *s, worker *w, uint64_t first, uint64_t count)
{
    const uint64_t rays = lum_rayfile_info(s->file)->rays;
    lmg_ray *all = w->rays, *at = all;
    bool good = true;
    for (uint64_t i = first - BAKE_PILOT_FIRST, stop = i + count; good && i < stop;) {
        const uint64_t place = bake_pilot_place(i, rays, PILOT_RUN, s->seed);
        uint64_t n = rays >= PILOT_RUN ? PILOT_RUN - i % PILOT_RUN : 1;
        n = n < stop - i ? n : stop - i;
        w->rays = at;
        good = read_rays(w, place, (size_t)n, s->scale);
        for (uint64_t k = 0; good && k < n; ++k)
            at[k].number = BAKE_PILOT_FIRST + i + k;
        at += n;
        i += n;
    }
    w->rays = all;
    return good;
}

static void run_chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    const job *j = self;
    worker *w = state;
    if (first >= BAKE_PILOT_FIRST ? !read_pilot(j->source, w, first, count) : !read_rays(w, first, (size_t)count, j->source->scale))
        return;
    for (size_t i = 0; i < j->sink_count; ++i)
        j->sinks[i].consume(j->sinks[i].self, w->rays, (size_t)count);
    double sum = 0;
    for (uint64_t i = 0; i < count; ++i)
        sum += lmg_luminance(w->rays[i].flux);
    w->units += llrint(sum * UNIT);
    w->count += count;
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err)
{
    const rayfile_source *s = (const rayfile_source *)source;
    if (first < BAKE_PILOT_FIRST && (first > s->source.photons || count > s->source.photons - first))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "rays up to number %" PRIu64 " of a file of %" PRIu64, first + count, s->source.photons);
    job j = {.source = s, .sinks = sinks, .sink_count = sink_count, .failed_at = UINT64_MAX};
    const bake_work work = {.self = &j, .begin = begin, .chunk = run_chunk, .end = end};
    lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result == LMG_OK && j.result != LMG_OK) { /* checked once already: the file changed meanwhile, or the disk fails */
        result = j.result;
        if (err)
            *err = j.error;
    }
    if (result != LMG_OK)
        return result;
    const double units = (double)j.units / UNIT;
    tally->photons += j.rays;
    tally->emitted += units;
    tally->escaped += units;
    return LMG_OK;
}

static void destroy(bake_source *source)
{
    free(source);
}

lmg_result bake_rayfile_source_create(const lum_rayfile *file, uint64_t seed, unsigned threads, bake_source **out, lmg_error *err)
{
    *out = NULL;
    rayfile_source *s = calloc(1, sizeof(*s));
    if (!s)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a ray file as a source");
    s->source.run = run;
    s->source.destroy = destroy;
    s->file = file;
    s->seed = seed;
    const lmg_result result = scan(s, threads, err);
    if (result != LMG_OK) {
        free(s);
        return result;
    }
    *out = &s->source;
    return LMG_OK;
}
