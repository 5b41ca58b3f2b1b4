/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Pay as you go: what a lamp that only reflects pays for the effects that it doesn't have.
 *
 * This program is built twice: as everything is built, and with the other effects compiled out (LUM_ONLY_REFLECTORS: scattering by
 * mirrors, metals and Lambertian surfaces only, no textures, no layers, one kernel).  Run without arguments, the full build runs both, in
 * turn, several times, so that a busy machine disturbs both alike, and compares the processor time per photon of the same photons of the
 * paraboloid spot: least against least, and the median of the ratios of neighbours.  Target: within 3 %.
 *
 *     test_bench_pay [TURNS]
 *     test_bench_pay --measure     one build's figure: nanoseconds per photon, and where the photons went
 */
#include "plan.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static void die(const lmg_error *err)
{
    fprintf(stderr, "error: %s\n", err->message);
    exit(3);
}

static double processor_time(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int measure(void)
{
    enum { TURNS = 9, PHOTONS = 200000 };
    lmg_error err;
    lum_model *model;
    bake_source *tracer;
    lum_recipe *recipe;
    if (lum_recipe_read(LUMIBOX_BINARY_DIR "/models/paraboloid-spot/paraboloid-spot.recipe.json", &recipe, &err) != LMG_OK ||
        lum_model_load(LUMIBOX_BINARY_DIR "/models/paraboloid-spot/paraboloid-spot.gltf", recipe, &model, &err) != LMG_OK ||
        bake_tracer_create_with(model, ~(1u << BAKE_POLARIZATION), 1, NULL, &tracer, &err) != LMG_OK)
        die(&err);
    lum_recipe_destroy(recipe);
    double least = INFINITY;
    bake_tally tally = {0};
    for (int turn = 0; turn < TURNS; ++turn) {
        tally = (bake_tally){0};
        const double began = processor_time();
        if (tracer->run(tracer, 0, PHOTONS, 1, NULL, 0, &tally, &err) != LMG_OK)
            die(&err);
        least = fmin(least, processor_time() - began);
    }
    printf("%.3f %.0f %.0f %s\n", 1e9 * least / PHOTONS, tally.escaped, tally.absorbed, bake_tracer_kernel(tracer));
    tracer->destroy(tracer);
    lum_model_destroy(model);
    return 0;
}

typedef struct figure {
    double ns, escaped, absorbed;
    char kernel[32];
} figure;

static figure run(const char *program)
{
    char command[1200];
    snprintf(command, sizeof(command), "'%s' --measure", program);
    figure f;
    FILE *pipe = popen(command, "r");
    if (!pipe || fscanf(pipe, "%lf %lf %lf %31s", &f.ns, &f.escaped, &f.absorbed, f.kernel) != 4 || pclose(pipe) != 0) {
        fprintf(stderr, "error: %s gave no figures\n", program);
        exit(1);
    }
    return f;
}

static int compare_doubles(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    if (argc > 1 && !strcmp(argv[1], "--measure"))
        return measure();
    enum { MOST = 100 };
    int turns = argc > 1 ? atoi(argv[1]) : 7;
    turns = turns < 1 ? 1 : turns > MOST ? MOST : turns;
    char bare[1100];
    snprintf(bare, sizeof(bare), "%s_reflectors", argv[0]);
    double ratios[MOST], full_least = INFINITY, bare_least = INFINITY;
    char kernel[32] = "";
    for (int i = 0; i < turns; ++i) {
        const figure f = run(argv[0]), b = run(bare);
        if (f.escaped != b.escaped || f.absorbed != b.absorbed) {
            fprintf(stderr, "error: the two builds don't trace the same light\n");
            return 1;
        }
        ratios[i] = f.ns / b.ns;
        full_least = fmin(full_least, f.ns);
        bare_least = fmin(bare_least, b.ns);
        memcpy(kernel, f.kernel, sizeof(kernel));
    }
    qsort(ratios, (size_t)turns, sizeof(ratios[0]), compare_doubles);
    printf("paraboloid spot, ns a photon: full build %.1f (kernel %s), other effects compiled out %.1f: %+.1f %%; median of %d turns %+.1f %%\n",
           full_least, kernel, bare_least, 100 * (full_least / bare_least - 1), turns, 100 * (ratios[turns / 2] - 1));
    printf("{\"benchmark\": \"pay as you go\", \"full_ns\": %.3f, \"reflectors_ns\": %.3f, \"ratio\": %.4f, \"median_ratio\": %.4f}\n", full_least,
           bare_least, full_least / bare_least, ratios[turns / 2]);
    return 0;
}
