/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What participating media cost: photons per second of the tracer without sinks, one thread, processor time, all variants of a lamp
 * in turn and the best of several turns, so that other work on the machine counts as little as can be.
 *
 *   - a bulb in a shell of glass (the opal ball): clear; filled with an isotropic medium of optical depth 1.2 across the wall;
 * filled with the forward scattering medium of the sample, optical depth 6, which turns light round as much; ten times as dense;
 *   - a white tray with LEDs behind a plate, as in a ceiling panel: clear; opal, isotropic optical depth 1.2;
 *   - a bulb in a box of haze: homogeneous; a lattice of 128^3 densities with the same mean, smooth noise; the same with a few
 *     voxels of a million times the mean.
 *
 *     test_bench_media [--json]
 */
#include "../unit/make_model.h"
#include "source.h"

#include <luminaires/medium.h>
#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { TURNS = 5, N = 128 };

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

typedef struct variant {
    const char *name;
    lum_model *model;
    bake_source *source;
    uint64_t photons;
    double rate, segments;
} variant;

static void prepare(variant *v)
{
    lmg_error err = {{0}};
    if (bake_tracer_create(v->model, 1, &v->source, &err) != LMG_OK)
        die(&err);
}

static void run(variant *variants, size_t count)
{
    for (int turn = 0; turn < TURNS; ++turn)
        for (size_t i = 0; i < count; ++i) {
            variant *v = &variants[i];
            bake_tally tally = {0};
            lmg_error err = {{0}};
            const double start = processor_seconds();
            if (v->source->run(v->source, (uint64_t)turn * v->photons, v->photons, 1, NULL, 0, &tally, &err) != LMG_OK)
                die(&err);
            v->rate = fmax(v->rate, (double)v->photons / (processor_seconds() - start));
            v->segments = (double)tally.segments / (double)v->photons;
        }
}

static lmg_vec3 v3(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

static lum_model *ball(float scattering, float anisotropy)
{
    lum_model *model = make_model();
    const uint32_t glass = make_glass(model, 1.5f, 0, false), bulb = make_lambert(model, 0.5f);
    lum_material *m = &model->materials[glass];
    for (int c = 0; c < 3; ++c) {
        m->scattering[c] = scattering;
        m->absorption[c] = 0.5f;
        model->materials[bulb].emissive[c] = 1000;
    }
    m->anisotropy = anisotropy;
    make_sphere(model, v3(0, 0, 0), 0.060, 64, false, true, glass);
    make_sphere(model, v3(0, 0, 0), 0.057, 64, true, true, glass);
    make_sphere(model, v3(0, 0, 0), 0.015, 32, false, true, bulb);
    finish_model(model);
    return model;
}

/* 0.6 m square, 50 mm deep, reflectance 0.9, a square of LEDs in its ground; the plate is 3 mm thick. */
static lum_model *panel(float scattering)
{
    lum_model *model = make_model();
    const uint32_t plate = make_glass(model, 1.5f, 0, false), tray = make_lambert(model, 0.9f), leds = make_lambert(model, 0.9f);
    for (int c = 0; c < 3; ++c) {
        model->materials[plate].scattering[c] = scattering;
        model->materials[plate].absorption[c] = 0.5f;
        model->materials[leds].emissive[c] = 1000;
    }
    const double h = 0.3, d = 0.05;
    make_quad(model, v3(-h, -h, 0), v3(2 * h, 0, 0), v3(0, 2 * h, 0), 8, tray);
    make_quad(model, v3(-h, -h, 0), v3(0, 2 * h, 0), v3(0, 0, d), 4, tray);
    make_quad(model, v3(h, -h, 0), v3(0, 0, d), v3(0, 2 * h, 0), 4, tray);
    make_quad(model, v3(-h, -h, 0), v3(0, 0, d), v3(2 * h, 0, 0), 4, tray);
    make_quad(model, v3(-h, h, 0), v3(2 * h, 0, 0), v3(0, 0, d), 4, tray);
    make_quad(model, v3(-0.2, -0.2, 0.002), v3(0.4, 0, 0), v3(0, 0.4, 0), 8, leds);
    make_box(model, v3(-h, -h, d + 0.001), v3(h, h, d + 0.004), false, 8, plate);
    finish_model(model);
    return model;
}

/* A cube of 0.5 m, of which a way across has a mean optical depth of 2.5. */
static lum_model *haze(lum_grid *grid, double voxels, lum_volume *v)
{
    lum_model *model = make_model();
    const uint32_t bulb = make_lambert(model, 0.5f);
    for (int c = 0; c < 3; ++c)
        model->materials[bulb].emissive[c] = 1000;
    make_sphere(model, v3(0, 0, 0), 0.02, 32, false, true, bulb);
    finish_model(model);
    *v = (lum_volume){.scattering = {4.5f, 4.5f, 4.5f}, .absorption = {0.5f, 0.5f, 0.5f}, .anisotropy = 0.3f, .grid = grid};
    for (int a = 0; a < 3; ++a) {
        v->to_index[a][a] = voxels / 0.5;
        v->to_index[a][3] = (voxels - 1) / 2;
    }
    model->volumes = v;
    model->volume_count = 1;
    model->bounds_min = v3(-0.26, -0.26, -0.26);
    model->bounds_max = v3(0.26, 0.26, 0.26);
    return model;
}

/* Smooth noise of mean 1, as clouds have it; spikes: one voxel in 100,000 with a million. */
static lum_grid *noise(bool spikes)
{
    float *values = malloc((size_t)N * N * N * sizeof(*values));
    lum_grid *grid;
    lmg_error err = {{0}};
    if (!values)
        exit(1);
    for (int i = 0; i < N * N * N; ++i) {
        const double x = i / (N * N), y = i / N % N, z = i % N;
        lum_rng rng = lum_rng_stream(3, (uint64_t)i);
        const double u = lum_rng_next(&rng);
        values[i] = (float)(1 + 0.5 * sin(0.11 * x + 0.05 * y) * cos(0.09 * y) + 0.3 * sin(0.21 * z) + 0.1 * (u - 0.5));
        if (spikes && u < 1e-5)
            values[i] = 1e6f;
    }
    const int32_t low[3] = {0, 0, 0};
    const uint32_t size[3] = {N, N, N};
    if (lum_grid_create(low, size, values, LUM_INTERPOLATION_LINEAR, 5 * 0.5 / N, &grid, &err) != LMG_OK)
        die(&err);
    free(values);
    return grid;
}

int main(int argc, char **argv)
{
    const bool json = argc > 1 && !strcmp(argv[1], "--json");
    const int32_t origin[3] = {0, 0, 0};
    const uint32_t one[3] = {1, 1, 1};
    const float density = 1;
    lum_grid *grids[3] = {NULL, noise(false), noise(true)};
    lum_volume volumes[3];
    if (lum_grid_create(origin, one, &density, LUM_INTERPOLATION_NEAREST, 2.5, &grids[0], NULL) != LMG_OK)
        exit(1);
    variant shell[4] = {{.name = "glass, clear", .model = ball(0, 0), .photons = 60000},
                        {.name = "glass, opal, depth 1.2, isotropic", .model = ball(400, 0), .photons = 20000},
                        {.name = "glass, opal, depth 6, forward", .model = ball(2000, 0.8f), .photons = 8000},
                        {.name = "glass, opal, depth 60, forward", .model = ball(20000, 0.8f), .photons = 500}};
    variant plate[2] = {{.name = "panel, clear plate", .model = panel(0), .photons = 60000},
                        {.name = "panel, opal plate, depth 1.2", .model = panel(400), .photons = 20000}};
    variant cloud[3] = {{.name = "haze, homogeneous", .model = haze(grids[0], 1, &volumes[0]), .photons = 60000},
                        {.name = "haze, 128^3 voxels", .model = haze(grids[1], N, &volumes[1]), .photons = 60000},
                        {.name = "haze, 128^3, a few voxels of 1e6", .model = haze(grids[2], N, &volumes[2]), .photons = 40000}};
    const struct {
        variant *variants;
        size_t count;
    } groups[3] = {{shell, 4}, {plate, 2}, {cloud, 3}};
    for (int g = 0; g < 3; ++g) {
        for (size_t i = 0; i < groups[g].count; ++i)
            prepare(&groups[g].variants[i]);
        run(groups[g].variants, groups[g].count);
    }
    if (json)
        printf("{\"media\": [\n");
    else
        printf("%-36s %12s %10s %8s\n", "", "photons/s", "segments", "ratio");
    for (int g = 0; g < 3; ++g)
        for (size_t i = 0; i < groups[g].count; ++i) {
            const variant *first = groups[g].variants, *v = &first[i];
            if (json)
                printf("%s{\"name\": \"%s\", \"photons_per_second\": %.4g, \"segments\": %.4g, \"ratio\": %.4g}",
                       g + (int)i ? ",\n" : "", v->name, v->rate, v->segments, v->rate / first->rate);
            else
                printf("%-36s %12.0f %10.2f %8.3f\n", v->name, v->rate, v->segments, v->rate / first->rate);
        }
    if (json)
        printf("\n]}\n");
    for (int g = 0; g < 3; ++g) {
        for (size_t i = 0; i < groups[g].count; ++i) {
            groups[g].variants[i].source->destroy(groups[g].variants[i].source);
            free_model(groups[g].variants[i].model);
        }
        lum_grid_destroy(grids[g]);
    }
    return 0;
}
