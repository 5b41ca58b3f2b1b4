/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What following light by wavelength costs: photons per second of the tracer without sinks, one thread, processor time, of dispersive lamps as they
 * are and with their glass's index at the d line for all light, which is traced in R,G,B.  Both in turn, the best of several turns, so that
 * other work on the machine counts as little as can be.
 *
 *     test_bench_spectral [--json]
 */
#include "source.h"

#include <luminaires/model.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { TURNS = 7 };

static void die(const lmg_error *err)
{
    fprintf(stderr, "error: %s\n", err->message);
    exit(3);
}

static double processor_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

typedef struct lamp {
    const char *name, *model, *recipe;
    uint64_t photons;
} lamp;

static bake_source *load(const lamp *l, bool by_wavelength, lum_model **model)
{
    char path[512];
    lum_recipe *recipe;
    bake_source *source;
    lmg_error err = {{0}};
    snprintf(path, sizeof(path), "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, l->model, l->model);
    if (lum_recipe_create(&recipe, &err) || lum_recipe_add(recipe, l->recipe, &err) || lum_model_load(path, recipe, model, &err))
        die(&err);
    lum_recipe_destroy(recipe);
    for (uint32_t i = 0; i < (*model)->material_count && !by_wavelength; ++i)
        (*model)->materials[i].spectral.index = NULL;
    if (bake_tracer_create(*model, 1, &source, &err))
        die(&err);
    return source;
}

int main(int argc, char **argv)
{
    static const lamp lamps[] = {{"prism lamp, N-SF11", "prism-lamp", "glass:Flint glass=N-SF11", 200000},
                                 {"glass lens, N-BK7", "glass-lens", "glass:Glass=N-BK7", 100000}};
    enum { LAMPS = sizeof(lamps) / sizeof(lamps[0]) };
    const bool json = argc > 1 && !strcmp(argv[1], "--json");
    if (json)
        printf("{\"spectral\": [");
    else
        printf("%-24s %14s %14s %14s\n", "", "R,G,B, 1/s", "wavelengths, 1/s", "cost ratio");
    for (int i = 0; i < LAMPS; ++i) {
        lum_model *model[2];
        bake_source *source[2];
        double rate[2] = {0, 0};
        for (int k = 0; k < 2; ++k)
            source[k] = load(&lamps[i], k, &model[k]);
        for (int turn = 0; turn < TURNS; ++turn)
            for (int k = 0; k < 2; ++k) {
                bake_tally tally = {0};
                lmg_error err = {{0}};
                const double start = processor_seconds();
                if (source[k]->run(source[k], (uint64_t)turn * lamps[i].photons, lamps[i].photons, 1, NULL, 0, &tally, &err))
                    die(&err);
                rate[k] = fmax(rate[k], (double)lamps[i].photons / (processor_seconds() - start));
            }
        if (json)
            printf("%s\n{\"name\": \"%s\", \"rgb_per_second\": %.4g, \"spectral_per_second\": %.4g, \"cost_ratio\": %.4g}", i ? "," : "",
                   lamps[i].name, rate[0], rate[1], rate[0] / rate[1]);
        else
            printf("%-24s %14.0f %14.0f %14.3f\n", lamps[i].name, rate[0], rate[1], rate[0] / rate[1]);
        for (int k = 0; k < 2; ++k) {
            source[k]->destroy(source[k]);
            lum_model_destroy(model[k]);
        }
    }
    if (json)
        printf("\n]}\n");
    return 0;
}
