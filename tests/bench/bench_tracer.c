/* SPDX-License-Identifier: Apache-2.0 */
/*
 * How fast the photon tracer is against Embree alone on the same ray segments, in one run.
 *
 * For each lamp, with the effects that a bake's plan simulates: record a few million of its ray segments; then, several times in turn, so that a busy machine disturbs both alike:
 * Embree alone (rtcIntersect1 on the recorded segments, no use made of the hits), the tracer without sinks, the tracer into an
 * accumulator with the layout of a default bake.  The best of the turns counts.  One thread each, and all cores.  Time is the
 * processor time that the process got, divided by the threads, so that other work on the machine counts as little as can be.
 *
 * Then what a deposit costs against resolution: the tracer without sinks and into slabs of 16^4, 32^4 and 64^4 cells each, in turn; what
 * threads gain over one; and, of a photon in the largest table, the time and the growth of the process per photon of a run against one of
 * an eighth.
 *
 *     test_bench_tracer [--json] [LAMP.gltf ...]       default: the four sample lamps
 *
 * A lamp's recipe is read when LAMP.recipe.json lies beside it.
 */
#include "bake.h"
#include "parallel.h"
#include "plan.h"
#include "tracer.h"

#include <luminaires/model.h>
#include <luminaires/scene.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

enum { SEGMENTS = 1000000, TURNS = 5 };

typedef struct figures {
    double segments_per_photon;
    double embree, bare, baking;         /* ray segments per second */
    double bare_photons, baking_photons; /* photons per second */
} figures;

static void die(const lmg_error *err)
{
    fprintf(stderr, "error: %s\n", err->message);
    exit(3);
}

typedef struct raw_work {
    const lum_scene *scene;
    const float *rays;
    size_t count;
} raw_work;

static void *raw_begin(void *self)
{
    return self;
}

/* A chunk of numbers stands for as many segments. */
static void raw_chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    (void)state;
    const raw_work *w = self;
    lum_scene_trace_raw(w->scene, w->rays + 6 * first, count);
}

static void raw_end(void *self, void *state)
{
    (void)self;
    (void)state;
}

static double clock_of(unsigned threads)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return ((double)t.tv_sec + 1e-9 * (double)t.tv_nsec) / threads;
}

static double best(double a, double b)
{
    return a > b ? a : b;
}

static lmg_layout fit_layout(bake_source *tracer, unsigned threads)
{
    lmg_error err;
    bake_ray_list *list;
    if (bake_ray_list_create(200000, &list, &err) != LMG_OK)
        die(&err);
    const lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    if (tracer->run(tracer, BAKE_PILOT_FIRST, 200000, threads, &sink, 1, &tally, &err) != LMG_OK)
        die(&err);
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(list, &count);
    lmg_layout layout;
    const lmg_fit_options fit = {.struct_size = sizeof(fit), .bounds_min = tracer->bounds_min, .bounds_max = tracer->bounds_max};
    if (lmg_layout_fit(rays, count, &fit, &layout, NULL, &err) != LMG_OK)
        die(&err);
    bake_ray_list_destroy(list);
    return layout;
}

static figures measure(bake_source *tracer, const float *rays, size_t segments, uint64_t photons, const lmg_layout *layout,
                       unsigned threads)
{
    lmg_error err;
    figures f = {0};
    lmg_accumulator *accumulator;
    if (lmg_accumulator_create(layout, &accumulator, &err) != LMG_OK)
        die(&err);
    const lmg_sink sink = lmg_accumulator_sink(accumulator);
    for (int turn = 0; turn < TURNS; ++turn) {
        raw_work raw = {bake_tracer_scene(tracer), rays, segments};
        const bake_work work = {.self = &raw, .begin = raw_begin, .chunk = raw_chunk, .end = raw_end};
        double began = clock_of(threads);
        if (bake_parallel(&work, 0, segments, threads, &err) != LMG_OK)
            die(&err);
        f.embree = best(f.embree, (double)segments / (clock_of(threads) - began));

        bake_tally bare = {0}, baking = {0};
        began = clock_of(threads);
        if (tracer->run(tracer, 0, photons, threads, NULL, 0, &bare, &err) != LMG_OK)
            die(&err);
        double seconds = clock_of(threads) - began;
        f.bare = best(f.bare, (double)bare.segments / seconds);
        f.bare_photons = best(f.bare_photons, (double)photons / seconds);
        f.segments_per_photon = (double)bare.segments / (double)photons;

        began = clock_of(threads);
        if (tracer->run(tracer, (uint64_t)turn * photons, photons, threads, &sink, 1, &baking, &err) != LMG_OK)
            die(&err);
        seconds = clock_of(threads) - began;
        f.baking = best(f.baking, (double)baking.segments / seconds);
        f.baking_photons = best(f.baking_photons, (double)photons / seconds);
    }
    lmg_accumulator_destroy(accumulator);
    return f;
}

typedef struct deposit_figures {
    double million_cells;
    double bare, baking; /* photons per second */
    double linear;       /* time per photon of a run, over that of one of an eighth */
    double grown;        /* MB that the process grew by meanwhile */
} deposit_figures;

static double baked_in(bake_source *tracer, const lmg_sink *sink, uint64_t first, uint64_t photons, unsigned threads)
{
    lmg_error err;
    bake_tally tally = {0};
    const double began = clock_of(threads);
    if (tracer->run(tracer, first, photons, threads, sink, sink ? 1 : 0, &tally, &err) != LMG_OK)
        die(&err);
    return clock_of(threads) - began;
}

static double largest_size(void)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return (double)usage.ru_maxrss / 1024;
}

/* All slabs of a layout with so many cells along each coordinate; false if there is no memory for them. */
static bool measure_deposits(bake_source *tracer, const lmg_layout *fitted, uint32_t cells, uint64_t photons, unsigned threads,
                             deposit_figures *f)
{
    lmg_error err;
    lmg_layout layout = *fitted;
    *f = (deposit_figures){0};
    for (uint32_t j = 0; j < layout.slab_count; ++j) {
        lmg_slab *s = &layout.slabs[j];
        s->nu = s->nv = s->ns = s->nt = cells;
        f->million_cells += 1e-6 * pow(cells, 4);
    }
    lmg_accumulator *accumulator;
    if (lmg_accumulator_create(&layout, &accumulator, &err) != LMG_OK)
        return false;
    const lmg_sink sink = lmg_accumulator_sink(accumulator);
    baked_in(tracer, &sink, 0, photons, threads); /* the pages are there from now on */
    const double size = largest_size();
    double shorter = (double)INFINITY, whole = (double)INFINITY;
    for (int turn = 0; turn < TURNS; ++turn) {
        const uint64_t first = (uint64_t)turn * photons;
        f->bare = best(f->bare, (double)photons / baked_in(tracer, NULL, first, photons, threads));
        shorter = fmin(shorter, baked_in(tracer, &sink, first, photons / 8, threads));
        whole = fmin(whole, baked_in(tracer, &sink, first, photons, threads));
    }
    f->baking = (double)photons / whole;
    f->linear = whole / (double)photons / (shorter / (double)(photons / 8));
    f->grown = largest_size() - size;
    lmg_accumulator_destroy(accumulator);
    return true;
}

static void print_deposits(const char *name, uint32_t cells, unsigned threads, const deposit_figures *f, double one, bool json, bool first)
{
    const double share = 1 - f->baking / f->bare;
    if (json)
        printf("%s\n    {\"lamp\": \"%s\", \"cells_per_axis\": %u, \"million_cells\": %.4g, \"threads\": %u, \"baking_photons_per_s\": %.5g, "
               "\"deposit_share\": %.4f, \"over_one_thread\": %.3f, \"time_per_photon_over_shorter_run\": %.3f, \"megabytes_grown\": %.3g}",
               first ? "" : ",", name, cells, f->million_cells, threads, f->baking, share, f->baking / one, f->linear, f->grown);
    else
        printf("%-18s %4u^4 %8.2f %7u %9.2f %7.0f %% %9.2f %9.3f %8.1f\n", name, cells, f->million_cells, threads, 1e-6 * f->baking,
               100 * share, f->baking / one, f->linear, f->grown);
    fflush(stdout);
}

static void bench_deposits(const char *name, bake_source *tracer, const lmg_layout *layout, uint64_t photons, bool json, bool *first)
{
    static const uint32_t CELLS[] = {16, 32, 64};
    const unsigned cores = bake_thread_count(0);
    for (int k = 0; k < 3; ++k) {
        double one = 0;
        for (unsigned threads = 1;; threads = cores) {
            deposit_figures f;
            if (!measure_deposits(tracer, layout, CELLS[k], photons, threads, &f)) {
                fprintf(stderr, "no memory for %u^4 cells in each slab of %s\n", CELLS[k], name);
                break;
            }
            one = threads == 1 ? f.baking : one;
            print_deposits(name, CELLS[k], threads, &f, one, json, *first);
            *first = false;
            if (threads == cores)
                break;
        }
    }
}

static void print_figures(const char *name, uint32_t triangles, unsigned threads, const figures *f, bool json, bool first)
{
    if (json) {
        printf("%s\n    {\"lamp\": \"%s\", \"triangles\": %u, \"threads\": %u, \"segments_per_photon\": %.4g, "
               "\"embree_rays_per_s\": %.5g, "
               "\"tracer_rays_per_s\": %.5g, \"baking_rays_per_s\": %.5g, \"baking_photons_per_s\": %.5g, \"tracer_ratio\": %.4f, "
               "\"baking_ratio\": %.4f, \"deposit_share\": %.4f}",
               first ? "" : ",", name, triangles, threads, f->segments_per_photon, f->embree, f->bare, f->baking, f->baking_photons,
               f->bare / f->embree, f->baking / f->embree, 1 - f->baking / f->bare);
        return;
    }
    printf("%-18s %8u %7u %8.2f %9.2f %9.2f %9.2f %9.2f %8.0f %% %8.0f %% %7.0f %%\n", name, triangles, threads,
           f->segments_per_photon, 1e-6 * f->embree, 1e-6 * f->bare, 1e-6 * f->baking, 1e-6 * f->baking_photons,
           100 * f->bare / f->embree, 100 * f->baking / f->embree, 100 * (1 - f->baking / f->bare));
    fflush(stdout);
}

/* deposits: their table instead of the lamp's shares of Embree. */
static void bench_lamp(const char *path, bool deposits, bool json, bool *first)
{
    lmg_error err;
    char recipe_path[1100], name[64];
    const char *slash = strrchr(path, '/'), *dot = strrchr(path, '.');
    snprintf(recipe_path, sizeof(recipe_path), "%.*s.recipe.json", (int)(dot ? dot - path : (long)strlen(path)), path);
    snprintf(name, sizeof(name), "%.*s", (int)(dot && slash ? dot - slash - 1 : 60), slash ? slash + 1 : path);
    lum_recipe *recipe = NULL;
    if (access(recipe_path, R_OK) == 0 && lum_recipe_read(recipe_path, &recipe, &err) != LMG_OK)
        die(&err);
    lum_model *model;
    if (lum_model_load(path, recipe, &model, &err) != LMG_OK)
        die(&err);
    lum_recipe_destroy(recipe);
    /* what a bake would trace: the effects that its plan simulates */
    bake_source *all, *tracer;
    bake_plan plan;
    if (bake_tracer_create(model, 1, &all, &err) != LMG_OK ||
        bake_plan_make(model, all, 1, &(bake_plan_options){0}, &plan, &err) != LMG_OK ||
        bake_tracer_create_with(model, plan.simulated, 1, all, &tracer, &err) != LMG_OK)
        die(&err);
    float *rays = malloc((size_t)SEGMENTS * 6 * sizeof(*rays));
    if (!rays)
        exit(1);
    const size_t segments = bake_tracer_record(tracer, 0, SEGMENTS, rays, SEGMENTS);
    const lmg_layout layout = fit_layout(tracer, 0);
    const unsigned cores = bake_thread_count(0);
    for (unsigned threads = 1;; threads = cores) {
        /* as many photons as make as many segments: both sides then work for about as long */
        bake_tally tally = {0};
        if (tracer->run(tracer, 0, 10000, 1, NULL, 0, &tally, &err) != LMG_OK)
            die(&err);
        const uint64_t photons = (uint64_t)((double)segments * 10000 / (double)tally.segments);
        if (deposits) {
            bench_deposits(name, tracer, &layout, photons, json, first);
            break;
        }
        const figures f = measure(tracer, rays, segments, photons, &layout, threads);
        print_figures(name, model->triangle_count, threads, &f, json, *first);
        *first = false;
        if (threads == cores)
            break;
    }
    free(rays);
    tracer->destroy(tracer);
    all->destroy(all);
    lum_model_destroy(model);
}

static void bench_lamps(int count, char **paths, bool deposits, bool json)
{
    static const char *const LAMPS[] = {"paraboloid-spot", "opal-globe", "louvred-panel", "glass-lens"};
    bool first = true;
    for (int i = 0; i < (count > 0 ? count : 4); ++i) {
        char path[1024];
        snprintf(path, sizeof(path), "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, LAMPS[i % 4], LAMPS[i % 4]);
        bench_lamp(count > 0 ? paths[i] : path, deposits, json, &first);
    }
}

int main(int argc, char **argv)
{
    const bool json = argc > 1 && !strcmp(argv[1], "--json");
    char **paths = argv + 1 + json;
    const int count = argc - 1 - json;
    printf(json ? "{\"format\": \"lumibox bench tracer 1\", \"results\": ["
                : "                                     segments  M segments/s                M photons/s   of Embree alone\n"
                  "lamp              triangles threads  /photon    Embree    tracer    baking    baking    tracer     baking deposit\n");
    bench_lamps(count, paths, false, json);
    printf(json ? "\n], \"deposits\": ["
                : "\n                         M cells         M photons/s          times    time per photon    MB\n"
                  "lamp              slabs   in all threads    baking   deposit  one thread  of 1/8 run   grown\n");
    bench_lamps(count, paths, true, json);
    if (json)
        printf("\n]}\n");
    return 0;
}
