/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Participating media in the photon tracer: a conservative slab against published transmittances, colours after a coloured medium,
 * media inside refracting solids that leak nothing, the same photons whether clear ways are known or not, volumes around a lamp and
 * beyond it, balance in whole photons, independence of threads.  Seeds are fixed.  Statistical tolerances: 4 standard errors, p <
 * 7e-5 for each of about 20 comparisons.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "source.h"
#include "tracer_state.h"

#include <luminaires/medium.h>
#include <luminaires/rng.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double SIGMAS = 4;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SPARE = 50 };
#else
enum { SPARE = 1 };
#endif

static lmg_vec3 v3(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

/* The boundary of a solid of the given index, filled. */
static uint32_t make_filled(lum_model *model, float ior, const float scattering[3], const float absorption[3], float anisotropy)
{
    const uint32_t index = make_glass(model, ior, 0, false);
    lum_material *m = &model->materials[index];
    memcpy(m->scattering, scattering, sizeof(m->scattering));
    memcpy(m->absorption, absorption, sizeof(m->absorption));
    m->anisotropy = anisotropy;
    return index;
}

static void add_light(lum_model *model, lum_light_kind kind, lmg_vec3 position, lmg_vec3 direction, const float intensity[3])
{
    model->lights = calloc(1, sizeof(*model->lights));
    assert_non_null(model->lights);
    model->light_count = 1;
    lum_light *l = &model->lights[0];
    strcpy(l->name, "light");
    l->kind = kind;
    l->position = position;
    l->direction = direction;
    memcpy(l->intensity, intensity, sizeof(l->intensity));
    l->cos_inner = cos(0.5e-4); /* so narrow that its light is a ray */
    l->cos_outer = cos(1e-4);
}

static bake_source *tracer_of(const lum_model *model, uint64_t seed)
{
    bake_source *source;
    lmg_error err = {{0}};
    if (bake_tracer_create(model, seed, &source, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return source;
}

/* What a sink sees: rays up and down, those that kept their first direction, their colours, and a hash of the set of rays. */
typedef struct census {
    _Atomic uint64_t hash;
    double up, down, straight, colour[3], squares[3];
    lmg_vec3 direction; /* straight on */
    lmg_vec3 low, high; /* bounds that all origins must respect */
    uint64_t outside;
    bool hash_only;
} census;

static void count_rays(void *self, const lmg_ray *rays, size_t count)
{
    census *c = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_ray *r = &rays[i];
        const double values[9] = {r->origin.x,    r->origin.y,        r->origin.z,        r->direction.x,    r->direction.y,
                                  r->direction.z, (double)r->flux[0], (double)r->flux[1], (double)r->flux[2]};
        uint64_t h = r->number;
        for (int k = 0; k < 9; ++k) {
            uint64_t b;
            memcpy(&b, &values[k], sizeof(b));
            h = lum_mix64(h ^ b);
        }
        c->hash += h;
        if (c->hash_only)
            continue;
        ++*(r->direction.z > 0 ? &c->up : &c->down);
        const lmg_vec3 d = c->direction, o = r->origin;
        c->outside +=
            !(o.x >= c->low.x && o.y >= c->low.y && o.z >= c->low.z && o.x <= c->high.x && o.y <= c->high.y && o.z <= c->high.z);
        if (d.x * r->direction.x + d.y * r->direction.y + d.z * r->direction.z > 1 - 1e-7) {
            ++c->straight;
            for (int k = 0; k < 3; ++k) {
                c->colour[k] += (double)r->flux[k];
                c->squares[k] += (double)r->flux[k] * (double)r->flux[k];
            }
        }
    }
}

static bake_tally trace(const lum_model *model, uint64_t seed, uint64_t count, unsigned threads, census *c)
{
    bake_source *source = tracer_of(model, seed);
    bake_tally tally = {0};
    lmg_error err = {{0}};
    const lmg_sink sink = {c, count_rays};
    c->low = source->bounds_min;
    c->high = source->bounds_max;
    if (source->run(source, 0, count, threads, &sink, 1, &tally, &err) != LMG_OK)
        fail_msg("%s", err.message);
    source->destroy(source);
    assert_true(tally.emitted == tally.escaped + tally.absorbed + tally.lost);
    assert_true(tally.emitted == (double)count);
    return tally;
}

/* A Lambertian lamp just under a wide slab without boundaries: Heaslet and Warming's transmittances, as in test_medium.c. */
static void slab_transmits_as_published(void **state)
{
    (void)state;
    const double depth[] = {0.2, 1, 5}, published[] = {.8491, .5532, .2077};
    for (int k = 0; k < 3; ++k) {
        lum_model *model = make_model();
        const float s[3] = {(float)depth[k], (float)depth[k], (float)depth[k]}, none[3] = {0, 0, 0};
        const uint32_t slab = make_filled(model, 1, s, none, 0), lamp = make_lambert(model, 0);
        for (int c = 0; c < 3; ++c)
            model->materials[lamp].emissive[c] = 1000;
        make_box(model, v3(-200, -200, 0), v3(200, 200, 1), false, 1, slab);
        make_quad(model, v3(-0.01, -0.01, -0.005), v3(0.02, 0, 0), v3(0, 0.02, 0), 1, lamp);
        finish_model(model);
        census c = {.direction = {0, 0, 1}};
        const bake_tally t = trace(model, 71, 200000 / SPARE, 1, &c);
        const double mean = c.up / t.emitted, se = sqrt(mean * (1 - mean) / t.emitted);
        print_message("slab of depth %g: %.4f +- %.4f (%.4f), lost %g\n", depth[k], mean, se, published[k], t.lost);
        /* last digit printed; light that leaves a slab 200 times wider than thick by its edges, below 1e-4 */
        assert_true(fabs(mean - published[k]) <= SIGMAS * se + 1.5e-4);
        assert_true(t.lost == 0 && c.outside == 0);
        free_model(model);
    }
}

/* A coloured ray straight through a coloured medium: each colour falls by its own exponential.  Also with light out of the gamut.
 */
static void colours_fall_by_their_own_coefficients(void **state)
{
    (void)state;
    const float colours[2][3] = {{600, 900, 400}, {-200, 1000, 1200}};
    for (int k = 0; k < 2; ++k)
        for (int volume = 0; volume < 2; ++volume) {
            lum_model *model = make_model();
            const float s[3] = {1.5f, 0.25f, 0.5f}, a[3] = {0.5f, 0.5f, 0};
            const uint32_t slab = make_filled(model, 1, s, a, 0.3f), black = make_lambert(model, 0);
            add_light(model, LUM_LIGHT_SPOT, v3(0.1, 0.2, -1), v3(0, 0, 1), colours[k]);
            lum_grid *grid = NULL;
            lum_volume v = {.anisotropy = 0.3f};
            if (volume) {
                const float one = 1;
                assert_int_equal(lum_grid_create((const int32_t[3]){0, 0, 0}, (const uint32_t[3]){1, 1, 1}, &one,
                                                 LUM_INTERPOLATION_NEAREST, 1, &grid, NULL),
                                 LMG_OK);
                v.grid = grid;
                memcpy(v.scattering, s, sizeof(s));
                memcpy(v.absorption, a, sizeof(a));
                for (int i = 0; i < 3; ++i)
                    v.to_index[i][i] = i == 2 ? 1 / 1.25 : 0.25; /* 4 x 4 x 1.25 m, from z = 0 */
                v.to_index[2][3] = -0.5;
                make_box(model, v3(-2, -2, -1.1), v3(2, 2, -1.05), false, 1, black);
            } else {
                make_box(model, v3(-2, -2, 0), v3(2, 2, 1.25), false, 1, slab);
            }
            finish_model(model);
            if (volume) {
                model->volume_count = 1;
                model->volumes = &v;
                model->bounds_max.z = 1.25;
            }
            census c = {.direction = {0, 0, 1}};
            const bake_tally t = trace(model, 72, 200000 / SPARE, 1, &c);
            const double y = 0.2126 * (double)colours[k][0] + 0.7152 * (double)colours[k][1] + 0.0722 * (double)colours[k][2];
            for (int i = 0; i < 3; ++i) {
                const double expected = (double)colours[k][i] / y * exp(-1.25 * (double)(s[i] + a[i])),
                             mean = c.colour[i] / t.emitted;
                const double se = sqrt((c.squares[i] / t.emitted - mean * mean) / t.emitted);
                print_message("%s, colour %d: %.5f +- %.5f (%.5f)\n", volume ? "volume" : "solid", i, mean, se, expected);
                assert_true(fabs(mean - expected) <= SIGMAS * se + 1e-6);
            }
            assert_true(t.lost == 0 && c.outside == 0);
            free_model(model);
            lum_grid_destroy(grid);
        }
}

/* A lossless medium in a refracting ball with a lamp outside or inside: all light comes out, after thousands of scatterings, many
 * of them within rounding of the surface. */
static void filled_balls_leak_nothing(void **state)
{
    (void)state;
    for (int k = 0; k < 4; ++k) {
        lum_model *model = make_model();
        const float dense = k % 2 ? 3000 : 50; /* mean free paths of 0.33 and 20 mm in a ball of 50 mm radius */
        const uint32_t ball = make_filled(model, 1.5f, (const float[3]){dense, dense, dense}, (const float[3]){0, 0, 0}, 0.5f);
        const float white[3] = {100, 100, 100};
        make_sphere(model, v3(0, 0, 0), 0.05, 24, false, k / 2, ball);
        add_light(model, LUM_LIGHT_POINT, k / 2 ? v3(0.01, 0.02, 0.1) : v3(0.01, 0, 0.02), v3(0, 0, 1), white);
        finish_model(model);
        census c = {.direction = {0, 0, 1}};
        const bake_tally t = trace(model, 73, (k % 2 ? 4000 : 40000) / SPARE, 1, &c);
        print_message("ball %d: %g photons, %.1f segments each, lost %g\n", k, t.emitted, (double)t.segments / t.emitted, t.lost);
        assert_true(t.absorbed == 0 && t.lost == 0 && t.escaped == t.emitted);
        free_model(model);
    }
}

/* The lamps of the next test: shells of coarse and fine facets, a block with its edges and corners; media thin and dense, grey and
 * coloured; cubes, one that is as large as its lamp, and one without a lid; a plate beside a ball of many triangles. */
enum { OPAL_LAMPS = 10, CUBES = 6, CROWDED = 8 };

/* Vertices in the model's extent, as the loader has them: its unit times one over it needn't be 1. */
static void use_unit(lum_model *model)
{
    float largest = 0;
    for (uint32_t i = 0; i < 3 * model->vertex_count; ++i)
        largest = fmaxf(largest, fabsf(model->positions[i]));
    model->unit = (double)largest;
    for (uint32_t i = 0; i < 3 * model->vertex_count; ++i)
        model->positions[i] = (float)((double)model->positions[i] / model->unit);
}

/* Half a side of 48 mm: 0.048f times one over it is less than 1. */
static void make_cube(lum_model *model, bool open, uint32_t opal)
{
    const double h = 0.048;
    if (!open) {
        make_box(model, v3(-h, -h, -h), v3(h, h, h), false, 1, opal);
    } else {
        make_quad(model, v3(-h, -h, -h), v3(0, 2 * h, 0), v3(2 * h, 0, 0), 1, opal);
        make_quad(model, v3(-h, -h, -h), v3(2 * h, 0, 0), v3(0, 0, 2 * h), 1, opal);
        make_quad(model, v3(-h, h, -h), v3(0, 0, 2 * h), v3(2 * h, 0, 0), 1, opal);
        make_quad(model, v3(-h, -h, -h), v3(0, 0, 2 * h), v3(0, 2 * h, 0), 1, opal);
        make_quad(model, v3(h, -h, -h), v3(0, 2 * h, 0), v3(0, 0, 2 * h), 1, opal);
    }
}

static lum_model *opal_lamp(int k)
{
    lum_model *model = make_model();
    const float depth = k >= CUBES && k < CROWDED ? 100 : k % 2 ? 15000 : 500, blue = k / 2 == 2 ? 1.5f * depth : depth;
    const uint32_t opal = make_filled(model, 1.5f, (const float[3]){depth, depth, blue}, (const float[3]){0.5f, 0.5f, 0.2f}, 0.3f);
    const uint32_t bulb = make_lambert(model, 0.5f);
    if (k >= CUBES && k < CROWDED) {
        make_cube(model, k % 2, opal);
    } else if (k >= CROWDED) {
        make_box(model, v3(-0.03, -0.02, 0.001), v3(0.03, 0.02, 0.004), false, 1, opal);
        make_sphere(model, v3(0, 0, 0.007), 0.002, 64, false, true, bulb);
    } else if (k / 2 == 2) {
        make_box(model, v3(-0.03, -0.02, 0.001), v3(0.03, 0.02, 0.004), false, 3, opal);
    } else {
        make_sphere(model, v3(0.01, 0, 0), 0.03, k / 2 ? 48 : 9, false, k / 2, opal);
        make_sphere(model, v3(0.01, 0, 0), 0.027, k / 2 ? 48 : 9, true, k / 2, opal);
    }
    make_sphere(model, v3(0, 0, -0.005), 0.005, 8, false, false, bulb);
    for (int c = 0; c < 3; ++c)
        model->materials[bulb].emissive[c] = 1000;
    finish_model(model);
    use_unit(model);
    return model;
}

/* To know that nothing is on a way saves looking, and changes no photon: the same rays to the bit with it and without. */
static void known_clear_ways_change_nothing(void **state)
{
    (void)state;
    for (int k = 0; k < OPAL_LAMPS; ++k) {
        lum_model *model = opal_lamp(k);
        bake_source *source = tracer_of(model, 76);
        tracer *t = (tracer *)source;
        lum_clearance *clearance = t->clearance;
        assert_non_null(clearance);
        census seen[2] = {{.hash_only = true}, {.hash_only = true}};
        bake_tally tally[2] = {{0}, {0}};
        const uint64_t n = (k % 2 ? 1500 : 8000) / SPARE;
        for (int without = 0; without < 2; ++without) {
            const lmg_sink sink = {&seen[without], count_rays};
            t->clearance = without ? NULL : clearance;
            assert_int_equal(source->run(source, 0, n, 2, &sink, 1, &tally[without], NULL), LMG_OK);
        }
        t->clearance = clearance;
        print_message("opal lamp %d: %.1f segments each, %g of %g escape, %g lost\n", k,
                      (double)tally[0].segments / tally[0].emitted, tally[0].escaped, tally[0].emitted, tally[0].lost);
        assert_true(seen[0].hash == seen[1].hash);
        assert_true(tally[0].segments == tally[1].segments && tally[0].escaped == tally[1].escaped &&
                    tally[0].absorbed == tally[1].absorbed && tally[0].lost == tally[1].lost);
        assert_true(tally[0].segments > 4 * n && tally[0].escaped > 0.1 * (double)n);
        source->destroy(source);
        free_model(model);
    }
}

/* Smoke of chance around and beyond a small lamp: light out of it starts within the bounds, and what an albedo leaves of it
 * escapes. */
static lum_model *smoky_lamp(lum_grid **grid, lum_volume *v)
{
    enum { N = 24 };
    static float values[N * N * N];
    for (int i = 0; i < N * N * N; ++i) {
        lum_rng rng = lum_rng_stream(74, (uint64_t)i);
        const double u = lum_rng_next(&rng);
        values[i] = u < 0.5 ? 0 : (float)(u < 0.501 ? 3000 * u : u);
    }
    lum_model *model = make_model();
    const uint32_t grey = make_lambert(model, 0.5f);
    make_box(model, v3(-0.02, -0.02, -0.02), v3(0.02, 0.02, 0), false, 1, grey);
    const float white[3] = {100, 100, 100};
    add_light(model, LUM_LIGHT_POINT, v3(0, 0, 0.05), v3(0, 0, 1), white);
    finish_model(model);
    assert_int_equal(lum_grid_create((const int32_t[3]){0, 0, 0}, (const uint32_t[3]){N, N, N}, values, LUM_INTERPOLATION_LINEAR,
                                     0.1, grid, NULL),
                     LMG_OK);
    *v = (lum_volume){.scattering = {4, 6, 8}, .absorption = {1, 1, 0}, .anisotropy = 0.6f, .grid = *grid};
    for (int a = 0; a < 3; ++a) {
        v->to_index[a][a] = 40; /* voxels of 25 mm, about the middle */
        v->to_index[a][3] = 11.5;
    }
    const double reach = 12.5 / 40;
    model->volumes = v;
    model->volume_count = 1;
    model->bounds_min = v3(-reach, -reach, -reach);
    model->bounds_max = v3(reach, reach, reach);
    return model;
}

static void smoke_around_a_lamp(void **state)
{
    (void)state;
    lum_grid *grid;
    lum_volume v;
    lum_model *model = smoky_lamp(&grid, &v);
    census one = {.hash_only = true}, two = {.hash_only = true}, seen = {.direction = {0, 0, 1}};
    const uint64_t n = 60000 / SPARE;
    const bake_tally a = trace(model, 75, n, 1, &one), b = trace(model, 75, n, 2, &two), t = trace(model, 75, n, 1, &seen);
    assert_true(one.hash == two.hash && a.escaped == b.escaped && a.segments == b.segments);
    assert_true(t.lost == 0 && seen.outside == 0 && t.absorbed > 0 && t.segments > n + n / 10);
    /* Without absorption, and with a white box: all of it escapes. */
    memset(v.absorption, 0, sizeof(v.absorption));
    model->materials[0].base_color[0] = model->materials[0].base_color[1] = model->materials[0].base_color[2] = 1;
    const bake_tally lossless = trace(model, 75, n, 1, &seen);
    assert_true(lossless.lost == 0 && seen.outside == 0);
    /* coloured light keeps its luminance only up to rounding, and is thinned out by that: a part in 10^14 of each event */
    assert_true(lossless.escaped == lossless.emitted);
    free_model(model);
    lum_grid_destroy(grid);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(slab_transmits_as_published), cmocka_unit_test(colours_fall_by_their_own_coefficients),
        cmocka_unit_test(filled_balls_leak_nothing),   cmocka_unit_test(known_clear_ways_change_nothing),
        cmocka_unit_test(smoke_around_a_lamp),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
