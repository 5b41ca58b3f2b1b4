/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Speed of ray files: decoding from a warm cache, binning a far field, counting into a box.  Targets: decode 100 M rays/s (or what
 * copying the same bytes takes), far field 20 M rays/s on one core, box 10 M rays/s on 2 cores.  Time is the processor time that the
 * process got, divided by its threads, and of several repeats the best counts, so that other work on the machine counts as little
 * as can be.
 */
#include "bake.h"
#include "convert.h"
#include "receiver.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { RAYS = 4000000, REPEATS = 5 };

static void check(lmg_result result, const lmg_error *err)
{
    if (result != LMG_OK) {
        fprintf(stderr, "error: %s\n", err->message);
        exit(1);
    }
}

static double processor_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void write_rays(const char *path, lum_ray_format format, uint32_t count)
{
    lmg_error err = {{0}};
    lum_ray_writer *w;
    const lum_ray_writer_options o = {.format = format, .photometric = true};
    check(lum_ray_writer_create(path, &o, &w, &err), &err);
    for (uint32_t i = 0; i < count; ++i) {
        lum_rng rng = lum_rng_stream(1, i);
        const double c = lum_rng_next(&rng), s = sqrt(c), phi = 6.283185307179586 * lum_rng_next(&rng);
        const lmg_ray ray = {.origin = {1e-3 * lum_rng_next(&rng), 2e-3 * lum_rng_next(&rng), 0},
                             .direction = {s * cos(phi), s * sin(phi), sqrt(1 - c)},
                             .flux = {1, 1, 1}};
        check(lum_ray_writer_append(w, &ray, 1, 1, &err), &err);
    }
    check(lum_ray_writer_finish(w, NULL, &err), &err);
}

/* Reading the same bytes without decoding them, in blocks of the decoder's size. */
static double copy_seconds(const char *path)
{
    static char buffer[LUM_RAY_BLOCK * 28];
    double best = INFINITY;
    for (int r = 0; r < REPEATS; ++r) {
        FILE *f = fopen(path, "rb");
        if (!f)
            exit(1);
        setvbuf(f, NULL, _IONBF, 0);
        const double began = processor_seconds();
        while (fread(buffer, 1, sizeof(buffer), f) == sizeof(buffer))
            ;
        best = fmin(best, processor_seconds() - began);
        fclose(f);
    }
    return best;
}

static void ignore(void *self, const lmg_ray *rays, size_t count)
{
    (void)self;
    (void)rays;
    (void)count;
}

/* Best seconds of running a source's rays into a sink. */
static double run_seconds(bake_source *source, unsigned threads, lmg_sink sink)
{
    double best = INFINITY;
    for (int r = 0; r < REPEATS; ++r) {
        lmg_error err = {{0}};
        bake_tally tally = {0};
        const double began = processor_seconds();
        check(source->run(source, 0, source->photons, threads, &sink, 1, &tally, &err), &err);
        best = fmin(best, processor_seconds() - began);
    }
    return best / threads;
}

static double read_seconds(const lum_rayfile *file, uint64_t rays)
{
    static lmg_ray block[LUM_RAY_BLOCK];
    lmg_error err = {{0}};
    lum_ray_reader *reader;
    check(lum_ray_reader_create(file, &reader, &err), &err);
    double best = INFINITY;
    for (int r = 0; r < REPEATS; ++r) {
        const double began = processor_seconds();
        for (uint64_t at = 0; at < rays; at += LUM_RAY_BLOCK)
            check(lum_ray_reader_read(reader, at, rays - at < LUM_RAY_BLOCK ? (size_t)(rays - at) : LUM_RAY_BLOCK, 1, block, &err), &err);
        best = fmin(best, processor_seconds() - began);
    }
    lum_ray_reader_destroy(reader);
    return best;
}

static void print(const char *what, double seconds, double rays, double target)
{
    printf("%-46s %8.1f M rays/s", what, 1e-6 * rays / seconds);
    if (target > 0)
        printf("   target %g", target);
    putchar('\n');
}

int main(void)
{
    char path[] = LUMIBOX_BINARY_DIR "/bench_rays_XXXXXX";
    const int descriptor = mkstemp(path);
    if (descriptor < 0)
        return 1;
    close(descriptor);
    write_rays(path, LUM_RAYS_TM25, RAYS);
    lmg_error err = {{0}};
    lum_rayfile *file;
    bake_source *source;
    check(lum_rayfile_open(path, LUM_RAY_LIGHT, &file, &err), &err);
    const lmg_sink nothing = {.consume = ignore};
    print("copying the file's bytes", copy_seconds(path), RAYS, 0);
    print("decode TM-25, 1 thread", read_seconds(file, RAYS), RAYS, 100);
    check(bake_rayfile_source_create(file, 1, 0, &source, &err), &err);
    print("decode TM-25 as a source, 2 threads", run_seconds(source, 2, nothing), RAYS, 100);

    const bake_sphere far = {.radius = INFINITY, .axis = {0, 0, 1}, .rings = 32, .sectors = 64};
    bake_receiver *receiver;
    check(bake_sphere_create(&far, &receiver, &err), &err);
    print("decode and bin the far field, 1 thread", run_seconds(source, 1, bake_receiver_sink(receiver)), RAYS, 20);
    bake_receiver_destroy(receiver);

    const lmg_fit_options fit = {
        .struct_size = sizeof(fit), .bounds_min = source->bounds_min, .bounds_max = source->bounds_max, .cells = 4000000};
    bake_ray_list *pilot;
    bake_tally tally = {0};
    lmg_layout layout;
    size_t count;
    check(bake_ray_list_create(100000, &pilot, &err), &err);
    const lmg_sink keep = bake_ray_list_sink(pilot);
    check(source->run(source, BAKE_PILOT_FIRST, 100000, 0, &keep, 1, &tally, &err), &err);
    const lmg_ray *rays = bake_ray_list_sorted(pilot, &count);
    check(lmg_layout_fit(rays, count, &fit, &layout, NULL, &err), &err);
    bake_ray_list_destroy(pilot);
    lmg_accumulator *accumulator;
    check(lmg_accumulator_create(&layout, &accumulator, &err), &err);
    print("decode and count into a box of 4 M cells, 2 thr.", run_seconds(source, 2, lmg_accumulator_sink(accumulator)), RAYS, 10);
    lmg_accumulator_destroy(accumulator);
    source->destroy(source);
    lum_rayfile_close(file);

    write_rays(path, LUM_RAYS_LIGHTTOOLS_TEXT, RAYS / 10);
    check(lum_rayfile_open(path, LUM_RAY_LIGHT, &file, &err), &err);
    print("decode LightTools ASCII, 1 thread", read_seconds(file, RAYS / 10), RAYS / 10, 0);
    lum_rayfile_close(file);
    unlink(path);
    return 0;
}
