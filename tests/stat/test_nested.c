/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Solids in solids: priorities where they overlap, and boundaries without a step of the index.  A slab's transmittance at normal
 * incidence, Fresnel's with all reflections, tells which interfaces the light has met.
 */
#include "../unit/make_model.h"

#include "source.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { PHOTONS = 200000 };
#else
enum { PHOTONS = 1000000 };
#endif

typedef struct catcher {
    lmg_ray *rays; /* by number; flux 0 = hasn't come out */
    uint64_t up;
} catcher;

static void catch_rays(void *self, const lmg_ray *rays, size_t n)
{
    catcher *c = self;
    for (size_t i = 0; i < n; i++) {
        c->up += rays[i].direction.y > 0;
        if (c->rays) {
            c->rays[rays[i].number] = rays[i];
        }
    }
}

static void run(lum_model *model, uint64_t seed, catcher *c, bake_tally *tally)
{
    finish_model(model);
    bake_source *source;
    lmg_error err = {{0}};
    if (bake_tracer_create(model, seed, &source, &err) != LMG_OK) {
        fail_msg("%s", err.message);
    }
    *tally = (bake_tally){0};
    lmg_sink sink = {.self = c, .consume = catch_rays};
    assert_int_equal(source->run(source, 0, PHOTONS, 1, &sink, 1, tally, &err), LMG_OK);
    source->destroy(source);
}

/* A small black lamp at y = 0 shining up a long black tube: what gets to the slabs above it is nearly parallel, and what comes back
 * is absorbed. */
static void add_lamp(lum_model *model)
{
    uint32_t light = make_lambert(model, 0), black = make_material(model, LUM_SURFACE_BLACK);
    for (int c = 0; c < 3; c++) {
        model->materials[light].emissive[c] = 1;
    }
    make_quad(model, (lmg_vec3){-0.02, 0, -0.02}, (lmg_vec3){0, 0, 0.04}, (lmg_vec3){0.04, 0, 0}, 1, light);
    const double r = 0.021, top = 0.2;
    make_quad(model, (lmg_vec3){-r, 0, -r}, (lmg_vec3){2 * r, 0, 0}, (lmg_vec3){0, top, 0}, 1, black);
    make_quad(model, (lmg_vec3){-r, 0, r}, (lmg_vec3){2 * r, 0, 0}, (lmg_vec3){0, top, 0}, 1, black);
    make_quad(model, (lmg_vec3){-r, 0, -r}, (lmg_vec3){0, 0, 2 * r}, (lmg_vec3){0, top, 0}, 1, black);
    make_quad(model, (lmg_vec3){r, 0, -r}, (lmg_vec3){0, 0, 2 * r}, (lmg_vec3){0, top, 0}, 1, black);
}

static void add_slab(lum_model *model, double low, double high, double ior, int priority)
{
    uint32_t glass = make_glass(model, (float)ior, 0, false);
    model->materials[glass].priority = priority;
    make_box(model, (lmg_vec3){-0.5, low, -0.5}, (lmg_vec3){0.5, high, 0.5}, false, 1, glass);
}

typedef struct slab {
    double low, high, ior;
    int priority;
} slab;

static double transmitted(const slab *slabs, int count, bake_tally *tally)
{
    lum_model *model = make_model();
    add_lamp(model);
    for (int i = 0; i < count; i++) {
        add_slab(model, slabs[i].low, slabs[i].high, slabs[i].ior, slabs[i].priority);
    }
    catcher c = {0};
    run(model, 5, &c, tally);
    free_model(model);
    return (double)c.up;
}

/* Transmittance of a pile of layers for light straight on, intensities added: the interfaces' (1 - R) / R add up. */
static double pile(const double *n, int count)
{
    double sum = 0;
    for (int i = 0; i + 1 < count; i++) {
        double r = (n[i] - n[i + 1]) / (n[i] + n[i + 1]);
        sum += r * r / (1 - r * r);
    }
    return 1 / (1 + sum);
}

/* Liquid (1.33) filled into glass (1.9) so that it overlaps it by a tenth of a millimetre: with the glass above it in priority the
 * light meets air-glass, glass-liquid, liquid-air; the other way round the liquid displaces the glass, to the same effect; alone,
 * without an overlap but with a gap, there would be two more interfaces. */
static void the_higher_priority_is_there(void **state)
{
    (void)state;
    bake_tally tally;
    double open = transmitted(NULL, 0, &tally);
    static const double LAYERS[] = {1, 1.9, 1.33, 1}, GAP[] = {1, 1.9, 1, 1.33, 1};
    double expected = pile(LAYERS, 4), with_gap = pile(GAP, 5);
    for (int glass_first = 0; glass_first < 2; glass_first++) {
        slab s[] = {{0.25, 0.27, 1.9, glass_first ? 2 : 1}, {0.2699, 0.29, 1.33, glass_first ? 1 : 2}};
        double t = transmitted(s, 2, &tally) / open, error = sqrt(t * (1 - t) / open);
        print_message("overlap, %s first: transmitted %.4f +- %.4f; closed form straight on %.4f, with a gap %.4f\n",
                      glass_first ? "glass" : "liquid", t, error, expected, with_gap);
        assert_true(tally.lost == 0);
        /* Up to 11 degrees off straight on, unpolarized transmittance changes by less than 1e-3. */
        assert_true(fabs(t - expected) < 4 * error + 1e-3);
        assert_true(fabs(t - with_gap) > 4 * error);
    }
}

/* Three solids of which the middle one lies wholly inside of one of higher priority: it isn't there. */
static void what_is_hidden_does_nothing(void **state)
{
    (void)state;
    bake_tally tally;
    double open = transmitted(NULL, 0, &tally);
    slab s[] = {{0.25, 0.27, 1.5, 7}, {0.255, 0.262, 2.4, -3}};
    static const double LAYERS[] = {1, 1.5, 1};
    double t = transmitted(s, 2, &tally) / open, error = sqrt(t * (1 - t) / open);
    assert_true(tally.lost == 0);
    assert_true(fabs(t - pile(LAYERS, 3)) < 4 * error + 1e-3);
}

/* A ball of the index of what is around it changes no ray: the same directions to the last bit, on the same lines. */
static void matched_index_changes_nothing(void **state)
{
    (void)state;
    lmg_ray *rays[2];
    for (int with = 0; with < 2; with++) {
        lum_model *model = make_model();
        add_lamp(model);
        add_slab(model, 0.25, 0.35, 1.5, 0);
        if (with) {
            uint32_t same = make_glass(model, 1.5f, 0, false), air = make_glass(model, 1, 0, false);
            make_sphere(model, (lmg_vec3){0.001, 0.3, 0.002}, 0.02, 12, false, true, same);
            make_sphere(model, (lmg_vec3){0.003, 0.5, 0.001}, 0.1, 12, false, true, air);
        }
        rays[with] = calloc(PHOTONS, sizeof **rays);
        assert_non_null(rays[with]);
        catcher c = {.rays = rays[with]};
        bake_tally tally;
        run(model, 9, &c, &tally);
        assert_true(tally.lost == 0);
        free_model(model);
    }
    uint64_t came = 0, grazing = 0;
    for (int i = 0; i < PHOTONS; i++) {
        const lmg_ray *a = &rays[0][i], *b = &rays[1][i];
        assert_true((a->flux[1] > 0) == (b->flux[1] > 0));
        if (!(a->flux[1] > 0)) {
            continue;
        }
        assert_memory_equal(&a->direction, &b->direction, sizeof a->direction);
        double d[3] = {b->origin.x - a->origin.x, b->origin.y - a->origin.y, b->origin.z - a->origin.z};
        double along = d[0] * a->direction.x + d[1] * a->direction.y + d[2] * a->direction.z;
        double off = sqrt(fmax(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - along * along, 0));
        /* Rounding of distances of a metre; rays that touch the ball within 0.6 degrees are moved aside by the hit's error. */
        grazing += off > 1e-7;
        assert_true(off < 1e-6);
        came++;
    }
    print_message("%llu rays, %llu of them moved aside\n", (unsigned long long)came, (unsigned long long)grazing);
    assert_true(came > PHOTONS / 200 && grazing * 1000 < came);
    free(rays[0]);
    free(rays[1]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_higher_priority_is_there),
                                       cmocka_unit_test(what_is_hidden_does_nothing),
                                       cmocka_unit_test(matched_index_changes_nothing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
