/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Curved reflectors as coarse meshes: the paraboloid spot of our sample lamps (luminaires/models/dimensions.h) from meshes of 24,
 * 48 and 96 segments with the true curve's normals.  The intensity on the axis is that of the analytic mirror, rho L pi (R^2 - a^2)
 * + L pi a^2, counted in a cone that the beam fills everywhere.
 */
#include "../unit/make_model.h"

#include "source.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <cmocka.h>

#define PI 3.14159265358979323846

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { PHOTONS = 20000 };
#else
enum { PHOTONS = 1000000 };
#endif

static const double FOCAL = 0.020, RIM = 0.050, SOURCE = 0.002, REFLECTANCE = 0.9;

/* The sample spot's mirror faces -y; the focus is at y = 0 here. */
static lmg_vec3 on_mirror(double r, double phi)
{
    lmg_vec3 p = {r * cos(phi), FOCAL - r * r / (4 * FOCAL), r * sin(phi)};
    return p;
}

/* Whether the vertex normals say the true curve, or are those of the facets. */
static lum_model *spot(uint32_t segments, bool curved, double reflectance)
{
    lum_model *model = make_model();
    uint32_t mirror = make_mirror(model, (float)reflectance, 0), source = make_lambert(model, 0);
    uint32_t rings = segments / 4;
    for (uint32_t i = 0; i < rings; i++) {
        for (uint32_t k = 0; k < segments; k++) {
            double r0 = RIM * i / rings, r1 = RIM * (i + 1) / rings, a = 2 * PI * k / segments, b = 2 * PI * (k + 1) / segments;
            uint32_t first = model->vertex_count;
            make_triangle(model, on_mirror(r0, a), on_mirror(r1, a), on_mirror(r1, b), mirror);
            if (i > 0) {
                make_triangle(model, on_mirror(r0, a), on_mirror(r1, b), on_mirror(r0, b), mirror);
            }
            for (uint32_t v = first; curved && v < model->vertex_count; v++) {
                const float *p = model->positions + 3 * v;
                double x = (double)p[0], z = (double)p[2], l = sqrt(x * x + z * z + 4 * FOCAL * FOCAL);
                model->normals[3 * v] = (float)(-x / l); /* inwards: minus the gradient of r^2 + 4 f y */
                model->normals[3 * v + 1] = (float)(-2 * FOCAL / l);
                model->normals[3 * v + 2] = (float)(-z / l);
            }
        }
    }
    /* The source's mesh has the sphere's area, hence (Cauchy) its mean projected area. */
    uint32_t first = model->vertex_count;
    make_sphere(model, (lmg_vec3){0, 0, 0}, SOURCE, 24, false, true, source);
    double area = 0;
    for (uint32_t t = 0; t < model->triangle_count; t++) {
        const uint32_t *c = model->indices + 3 * t;
        if (c[0] >= first) {
            double e[2][3];
            for (int k = 0; k < 3; k++) {
                e[0][k] = (double)model->positions[3 * c[1] + (uint32_t)k] - (double)model->positions[3 * c[0] + (uint32_t)k];
                e[1][k] = (double)model->positions[3 * c[2] + (uint32_t)k] - (double)model->positions[3 * c[0] + (uint32_t)k];
            }
            area += 0.5 * sqrt(pow(e[0][1] * e[1][2] - e[0][2] * e[1][1], 2) + pow(e[0][2] * e[1][0] - e[0][0] * e[1][2], 2) +
                               pow(e[0][0] * e[1][1] - e[0][1] * e[1][0], 2));
        }
    }
    for (uint32_t v = 3 * first; v < 3 * model->vertex_count; v++) {
        model->positions[v] *= (float)sqrt(4 * PI * SOURCE * SOURCE / area);
    }
    for (int c = 0; c < 3; c++) {
        model->materials[source].emissive[c] = 1;
    }
    finish_model(model);
    return model;
}

typedef struct cone {
    double cos_limit;
    uint64_t count, leaked;
} cone;

static void count(void *self, const lmg_ray *rays, size_t n)
{
    cone *c = self;
    for (size_t i = 0; i < n; i++) {
        lmg_vec3 o = rays[i].origin, d = rays[i].direction;
        c->count += -d.y > c->cos_limit;
        /* All light leaves by the opening, 1e-5 for the origin's distance from the rim's facets. */
        double rim = FOCAL - RIM * RIM / (4 * FOCAL), t = (rim - o.y) / d.y;
        c->leaked += !(d.y < 0 && hypot(o.x + t * d.x, o.z + t * d.z) < RIM + 1e-5);
    }
}

/* Axial intensity over the closed form, its standard error, and where the light went. */
static double axial(uint32_t segments, bool curved, double *error, bake_tally *tally)
{
    lum_model *model = spot(segments, curved, REFLECTANCE);
    bake_source *source;
    lmg_error err = {{0}};
    if (bake_tracer_create(model, 11, &source, &err) != LMG_OK) {
        fail_msg("%s", err.message);
    }
    const double degrees = 1.5; /* the beam's half angle is a / (f + R^2 / 4f) = 2.2 degrees at the rim */
    cone c = {.cos_limit = cos(degrees * PI / 180)};
    lmg_sink sink = {.self = &c, .consume = count};
    *tally = (bake_tally){0};
    assert_int_equal(source->run(source, 0, PHOTONS, 1, &sink, 1, tally, &err), LMG_OK);
    assert_true(c.leaked == 0);
    source->destroy(source);
    free_model(model);
    /* Flux 4 pi^2 a^2 L: photons in the cone = I omega / flux * all.  cos averages to (1 + cos) / 2 over the flat beam. */
    double omega = 2 * PI * (1 - c.cos_limit);
    double intensity = PI * (REFLECTANCE * (RIM * RIM - SOURCE * SOURCE) + SOURCE * SOURCE);
    double expected = PHOTONS * intensity * omega / (4 * PI * PI * SOURCE * SOURCE) * 0.5 * (1 + c.cos_limit);
    *error = sqrt((double)c.count) / expected;
    return (double)c.count / expected;
}

static void meshes_keep_the_beam(void **state)
{
    (void)state;
    static const uint32_t SEGMENTS[] = {24, 48, 96};
    const double h = FOCAL - RIM * RIM / (4 * FOCAL), direct = (1 + h / hypot(h, RIM)) / 2;
    const double efficiency = direct + REFLECTANCE * (1 - direct - SOURCE * SOURCE / (4 * FOCAL * FOCAL));
    for (int i = 0; i < 3; i++) {
        double error, flat_error;
        bake_tally tally, flat;
        double value = axial(SEGMENTS[i], true, &error, &tally), facets = axial(SEGMENTS[i], false, &flat_error, &flat);
        print_message("%2u segments: axial intensity %.4f +- %.4f of the analytic mirror's (flat facets: %.4f); efficiency %.5f, "
                      "closed form %.5f\n",
                      SEGMENTS[i], value, error, facets, tally.escaped / tally.emitted, efficiency);
        assert_true(tally.lost == 0 && tally.escaped + tally.absorbed == tally.emitted);
        /* The opening is a polygon: its area, and with it the intensity, is less than the disc's. */
        double polygon = SEGMENTS[i] / (2 * PI) * sin(2 * PI / SEGMENTS[i]);
        assert_true(value < 1.02 + 3 * error && value > fmin(polygon, 0.98) - 3 * error);
        assert_true(SEGMENTS[i] < 48 || fabs(value - 1) < 0.02 + 3 * error);
        /* What the normals are for: without them the test fails. */
        assert_true(SEGMENTS[i] > 48 || facets < 0.8);
        /* First order in (a/f)^2 = 0.01, and the polygon. */
        assert_true(fabs(tally.escaped / tally.emitted - efficiency) < 2e-3 + (1 - polygon) + 3e-4 / sqrt(PHOTONS / 1e6));
    }
}

/* A closed ball of a few facets with the normals of a sphere: what is inside stays, whatever its walls are made of. */
static void nothing_leaks(void **state)
{
    (void)state;
    for (int wall = 0; wall < 4; wall++) {
        for (uint32_t rings = 3; rings <= 9; rings += 3) {
            lum_model *model = make_model();
            uint32_t m = wall == 0   ? make_mirror(model, 0.9f, 0)
                         : wall == 1 ? make_mirror(model, 0.9f, 0.4f)
                         : wall == 2 ? make_material(model, LUM_SURFACE_PBR)
                                     : make_mirror(model, 0.9f, 0.05f);
            uint32_t light = make_lambert(model, 0.5f);
            for (int c = 0; c < 3; c++) {
                model->materials[light].emissive[c] = 1;
                model->materials[m].base_color[c] = 0.9f;
            }
            make_sphere(model, (lmg_vec3){0, 0, 0}, 0.1, rings, true, true, m);
            make_sphere(model, (lmg_vec3){0.01, 0.02, 0}, 0.03, rings, false, true, light);
            finish_model(model);
            bake_source *source;
            lmg_error err = {{0}};
            assert_int_equal(bake_tracer_create(model, 3, &source, &err), LMG_OK);
            bake_tally tally = {0};
            assert_int_equal(source->run(source, 0, PHOTONS / 20, 1, NULL, 0, &tally, &err), LMG_OK);
            assert_true(tally.escaped == 0 && tally.lost == 0 && tally.absorbed == tally.emitted);
            source->destroy(source);
            free_model(model);
        }
    }
}

/* A coarse glass ball with a sphere's normals before a lamp: all light leaves or falls back on the lamp, none is lost inside. */
static void glass_keeps_the_balance(void **state)
{
    (void)state;
    for (uint32_t rings = 4; rings <= 12; rings += 4) {
        lum_model *model = make_model();
        uint32_t glass = make_glass(model, 1.5f, 0, false), light = make_lambert(model, 0);
        for (int c = 0; c < 3; c++) {
            model->materials[light].emissive[c] = 1;
        }
        make_quad(model, (lmg_vec3){-0.05, 0, -0.05}, (lmg_vec3){0, 0, 0.1}, (lmg_vec3){0.1, 0, 0}, 1, light);
        make_sphere(model, (lmg_vec3){0, 0.08, 0}, 0.05, rings, false, true, glass);
        finish_model(model);
        bake_source *source;
        lmg_error err = {{0}};
        assert_int_equal(bake_tracer_create(model, 3, &source, &err), LMG_OK);
        bake_tally tally = {0};
        assert_int_equal(source->run(source, 0, PHOTONS / 10, 1, NULL, 0, &tally, &err), LMG_OK);
        print_message("glass ball of %u rings: escaped %.4f, back on the lamp %.4f, %.1f segments a photon\n", rings,
                      tally.escaped / tally.emitted, tally.absorbed / tally.emitted, (double)tally.segments / tally.emitted);
        assert_true(tally.lost == 0 && tally.escaped + tally.absorbed == tally.emitted);
        source->destroy(source);
        free_model(model);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(meshes_keep_the_beam), cmocka_unit_test(nothing_leaks),
                                       cmocka_unit_test(glass_keeps_the_balance)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
