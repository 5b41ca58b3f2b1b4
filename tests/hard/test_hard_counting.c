/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Hard cases of counting and brightness: 10^11 photons in one cell, weights over twelve decades, one photon, black lamps, a
 * filament of 0.1 mm in a reflector of 0.5 m, luminances beyond the range of half floats.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"
#include "make_model.h"

#include "field.h"

#include <luminaires/rng.h>

#include <float.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static lmg_layout one_cell(uint32_t n)
{
    lmg_layout y = {.slab_count = 1, .channels = 1, .colour = {1, 1, 1}, .size = 0.1};
    y.bounds_min = v3(-0.05, 0, -0.05);
    y.bounds_max = v3(0.05, 0.1, 0.05);
    y.slabs[0] = (lmg_slab){.kind = LMG_SLAB_CUBE,
                            .a = v3(1, 0, 0),
                            .b = v3(0, 0, 1),
                            .n = v3(0, -1, 0),
                            .distance = (double)INFINITY,
                            .u0 = -0.05,
                            .u1 = 0.05,
                            .v0 = -0.05,
                            .v1 = 0.05,
                            .s0 = -1,
                            .s1 = 1,
                            .t0 = -1,
                            .t1 = 1,
                            .nu = n,
                            .nv = 1,
                            .ns = 1,
                            .nt = 1};
    return y;
}

static lmg_accumulator *accumulator(const lmg_layout *y)
{
    lmg_accumulator *acc;
    lmg_error err = {{0}};
    if (lmg_accumulator_create(y, &acc, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return acc;
}

static lmg_ray down(double x, float flux, uint64_t number)
{
    return (lmg_ray){.origin = v3(x, 0, 0), .direction = v3(0, -1, 0), .flux = {flux, flux, flux}, .number = number};
}

/* 2^17 photons, doubled by merging with itself 20 times: 1.4e11; and weights of 10^4 up to 1e11 units. */
static void test_many_photons(void **state)
{
    (void)state;
    const lmg_layout y = one_cell(1);
    lmg_accumulator *acc = accumulator(&y);
    enum { BATCH = 1 << 12 };
    static lmg_ray rays[BATCH];
    for (int k = 0; k < 32; ++k) {
        for (uint64_t i = 0; i < BATCH; ++i)
            rays[i] = down(0.001, 1, (uint64_t)k * BATCH + i);
        lmg_accumulator_deposit(acc, rays, BATCH);
    }
    double expected = 32.0 * BATCH;
    for (int k = 0; k < 20; ++k, expected *= 2)
        assert_int_equal(lmg_accumulator_merge(acc, acc, NULL), LMG_OK);
    rays[0] = down(0.001, 1, 5);
    lmg_accumulator_deposit(acc, rays, 1); /* where a float would have stood still since 1.7e7 */
    const lmg_deposit_totals t = lmg_accumulator_totals(acc);
    hard_holds("1.4e11 photons in one cell, and one more", "exact sum", t.stored == expected + 1 && (double)t.rays == expected + 1,
               "%.0f units, %" PRIu64 " rays", t.stored, t.rays);
    lmg_field *f;
    assert_int_equal(lmg_field_reconstruct(acc, 1 / (expected + 1), NULL, &f, NULL), LMG_OK);
    double error;
    hard_at_most("1.4e11 photons in one cell, and one more", "the field's flux, relative",
                 fabs(lmg_field_slab_flux(f, 0, &error) - 1), 2 * FLT_EPSILON);
    hard_at_most("1.4e11 photons in one cell, and one more", "its standard error is 1/sqrt(n), relative",
                 fabs(error * sqrt(expected + 1) - 1), 2 * FLT_EPSILON);
    lmg_field_destroy(f);
    lmg_accumulator_destroy(acc);
}

/* Weights 1e-6 .. 1e6: sums follow, small ones without bias. */
static void test_weights(void **state)
{
    (void)state;
    const lmg_layout y = one_cell(13);
    lmg_accumulator *acc = accumulator(&y);
    enum { EACH = 200000 };
    static lmg_ray rays[4096];
    double worst = 0;
    size_t n = 0;
    for (int k = 0; k < 13; ++k)
        for (uint64_t i = 0; i < EACH; ++i) {
            rays[n++] = down(-0.05 + 0.1 * (k + 0.5) / 13, (float)pow(10, k - 6), i * 13 + (uint64_t)k);
            if (n == 4096 || (k == 12 && i + 1 == EACH)) {
                lmg_accumulator_deposit(acc, rays, n);
                n = 0;
            }
        }
    lmg_field *f;
    lmg_ledger ledger = {.photons = 13 * EACH};
    assert_int_equal(lmg_field_reconstruct(acc, 1, &ledger, &f, NULL), LMG_OK);
    for (uint32_t k = 0; k < 13; ++k) {
        const double flux = (double)*lmg_cell_radiance(&f->slabs[0], k) * lmg_slab_cell_etendue(&y.slabs[0], k, 0, 0, 0);
        const double w = (double)(float)pow(10, (int)k - 6), all = EACH * w;
        /* rounding to 2^-20 is by chance, with the variance of a uniform step at most a quarter of its square each */
        const double error = hypot(sqrt(0.25 * EACH) * 0x1p-20 / all, FLT_EPSILON);
        worst = fmax(worst, fabs(flux / all - 1) / error);
    }
    hard_at_most("weights 1e-6 .. 1e6 in neighbouring cells", "each cell's sum, in standard errors of the rounding", worst, 4);
    lmg_field_destroy(f);
    lmg_accumulator_destroy(acc);
}

static lum_model *disc_lamp(float luminance, double size, float albedo)
{
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, albedo);
    hard_emit(m, source, luminance);
    make_quad(m, v3(-size, 0, -size), v3(2 * size, 0, 0), v3(0, 0, 2 * size), 1, source);
    finish_model(m);
    return m;
}

static void test_few_photons(void **state)
{
    (void)state;
    lum_model *m = disc_lamp(1000, 0.05, 0);
    for (uint64_t n = 1; n <= 3; ++n) {
        const bake_options o = {.photons = n, .seed = 2, .fit.cells = 10000};
        lmg_field *f = hard_bake(m, &o, NULL);
        const lmg_ledger l = lmg_field_ledger(f);
        hard_at_most(hard_text("a bake of %d photon%s", (int)n, n > 1 ? "s" : ""), "flux stored, relative",
                     fabs((l.stored + l.residual + l.absorbed + l.lost) / l.emitted - 1), 1e-6);
        lmg_field_destroy(f);
    }
    free_model(m);

    lmg_error err = {{0}};
    lmg_field *f;
    bake_report r;
    m = disc_lamp(0, 0.05, 0.5f);
    bake_options o = {.photons = 1000, .seed = 2};
    lmg_result result = bake_run(m, &o, &f, &r, &err);
    hard_holds("black lamp: nothing emits", "a message, no box", result == LMG_ERROR_INPUT && strstr(err.message, "emits light"),
               "%s", err.message);
    free_model(m);

    m = disc_lamp(1000, 0.05, 0);
    make_box(m, v3(-0.1, -0.1, -0.1), v3(0.1, 0.1, 0.1), true, 1, make_lambert(m, 0));
    finish_model(m);
    result = bake_run(m, &o, &f, &r, &err);
    hard_holds("black shell: nothing leaves", "a message that says where the light went",
               result == LMG_ERROR_INPUT && strstr(err.message, "absorbed"), "%s", err.message);
    free_model(m);
    /* --photons 0 is a matter of the command line: test_restart */
}

/* Photons near the axis +y. */
typedef struct axial {
    double cosine, photons;
} axial;
static void count_axial(void *self, const lmg_ray *rays, size_t count)
{
    axial *a = self;
    for (size_t i = 0; i < count; ++i)
        a->photons += rays[i].direction.y > a->cosine ? (double)rays[i].flux[1] : 0;
}

/* A filament of 0.1 mm with 1e9 cd/m2 (the sun has 1.6e9) in the focus of a mirror of 0.5 m. */
static void test_filament(void **state)
{
    (void)state;
    const double focus = 0.1, rim = 0.25, r = 0.00005;
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0), mirror = make_mirror(m, 0.9f, 0);
    hard_emit(m, source, 1e9f);
    make_sphere(m, v3(0, focus, 0), r, 16, false, true, source);
    /* so fine, and with the true normals, that flat faces turn no reflected ray by more than 4e-5 */
    enum { RINGS = 120, AROUND = 800 };
    double area = 0; /* of the sphere's triangles */
    for (uint32_t i = 0; i < m->triangle_count; ++i) {
        double p[3][3], n[3];
        for (int k = 0; k < 9; ++k)
            p[k / 3][k % 3] = m->unit * (double)m->positions[3 * (size_t)m->indices[3 * (size_t)i + (size_t)(k / 3)] + (size_t)(k % 3)];
        for (int k = 0; k < 3; ++k)
            n[k] = (p[1][(k + 1) % 3] - p[0][(k + 1) % 3]) * (p[2][(k + 2) % 3] - p[0][(k + 2) % 3]) -
                   (p[1][(k + 2) % 3] - p[0][(k + 2) % 3]) * (p[2][(k + 1) % 3] - p[0][(k + 1) % 3]);
        area += 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    const uint32_t first = m->vertex_count;
    for (int i = 0; i < RINGS; ++i)
        for (int k = 0; k < AROUND; ++k) {
            lmg_vec3 p[4];
            for (int c = 0; c < 4; ++c) {
                const double q = rim * (i + c / 2) / RINGS, a = 6.283185307179586 * ((k + (c == 1 || c == 2)) % AROUND) / AROUND;
                p[c] = v3(q * cos(a), q * q / (4 * focus), q * sin(a));
            }
            make_triangle(m, p[0], p[3], p[2], mirror);
            if (i > 0)
                make_triangle(m, p[0], p[2], p[1], mirror);
        }
    for (uint32_t v = first; v < m->vertex_count; ++v) {
        const lmg_vec3 at = lum_model_vertex(m, v);
        const double x = at.x, z = at.z, length = sqrt(x * x + z * z + 4 * focus * focus);
        m->normals[3 * (size_t)v] = (float)(-x / length);
        m->normals[3 * (size_t)v + 1] = (float)(2 * focus / length);
        m->normals[3 * (size_t)v + 2] = (float)(-z / length);
    }
    finish_model(m);
    bake_report report;
    const bake_options o = {.photons = 300000, .seed = 4, .fit.cells = 500000};
    lmg_field *f = hard_bake(m, &o, &report);
    const lmg_ledger l = lmg_field_ledger(f);
    hard_at_most("0.1 mm filament in a 0.5 m reflector", "flux, relative to pi L A", fabs(l.emitted / (3.14159265358979 * 1e9 * area) - 1), 1e-6);
    /* Far away on the axis the whole mirror shines with the filament's luminance, I = rho L pi rim^2, in directions nearer to the axis than
     * the filament's half-angle seen from the rim: r / (focus + rim^2 / (4 focus)) = 1.95e-4. */
    const double half = 1e-4, cone = 3.14159265358979 * half * half, intensity = 0.9 * 1e9 * 3.14159265358979 * rim * rim;
    axial a = {.cosine = cos(half)};
    const lmg_sink near_axis = {.consume = count_axial, .self = &a};
    bake_source *s = hard_tracer(m, 9);
    const bake_tally t = hard_trace(s, 300000, &near_axis);
    hard_at_most("0.1 mm filament in a 0.5 m reflector", "peak intensity of the beam, rho L A of the mirror, in standard errors",
                 fabs(a.photons / t.emitted * l.emitted / (cone * intensity) - 1) * sqrt(a.photons), 3);
    s->destroy(s);
    hard_at_most("0.1 mm filament in a 0.5 m reflector", "balance, relative",
                 fabs((l.stored + l.residual + l.absorbed + l.lost) / l.emitted - 1), 1e-6);
    hard_at_most("0.1 mm filament in a 0.5 m reflector", "lost, relative", l.lost / l.emitted, 1e-6);
    const char *path = hard_path("filament.box.exr");
    lmg_error err = {{0}};
    if (lmg_field_write(f, path, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lmg_field *back;
    if (lmg_field_read(path, &back, &err) != LMG_OK)
        fail_msg("%s", err.message);
    double peak = 0, flux = 0;
    bool finite = true;
    for (uint32_t j = 0; j < back->layout.slab_count; ++j) {
        for (uint64_t c = 0; c < back->slabs[j].cells * back->layout.channels; ++c) {
            const double value = (double)lmg_cell_radiance(&back->slabs[j], c / back->layout.channels)[c % back->layout.channels];
            finite = finite && isfinite(value);
            peak = fmax(peak, value);
        }
        flux += lmg_field_slab_flux(back, j, NULL);
    }
    hard_holds("0.1 mm filament in a 0.5 m reflector",
               "beyond half floats (65,504 cd/m2), nothing infinite after writing and reading", finite && peak > 65504,
               "brightest cell %.3g cd/m2", peak);
    hard_at_most("0.1 mm filament in a 0.5 m reflector", "flux after writing and reading, relative", fabs(flux / l.stored - 1),
                 1e-5);
    /* no cell can be brighter than the filament: a cell averages over what it sees of it */
    hard_at_most("0.1 mm filament in a 0.5 m reflector", "brightest cell over the filament's luminance", peak / 1e9, 1);
    lmg_field_destroy(back);
    lmg_field_destroy(f);
    free_model(m);

    /* a luminance near the end of float */
    m = disc_lamp(1e30f, 0.05, 0);
    const bake_options bright = {.photons = 1000000, .seed = 4, .fit.cells = 10000};
    f = hard_bake(m, &bright, NULL);
    double noise;
    const double e = hard_illuminance(f, v3(0, -10, 0), v3(0, 1, 0), &noise), expected = 1e30 * 0.01 / 100;
    /* of a square of 0.1 m at 10 m: L A / d^2 to 1e-4; a million photons in some hundred directions: 1 % noise */
    hard_at_most("luminance 1e30 cd/m2", "illuminance at 10 m, relative standard error", noise / expected, 0.02);
    hard_at_most("luminance 1e30 cd/m2", "illuminance at 10 m from L A / d^2, in standard errors", fabs(e - expected) / noise, 4);
    lmg_field_destroy(f);
    free_model(m);
}

/* Neighbouring cells far apart in luminance, the sun's among them, through a file and back: nothing overflows, nothing vanishes. */
static void test_sun_in_a_file(void **state)
{
    (void)state;
    static const double PAIRS[][2] = {{1.6e9, 16}, {65520, 65504}, {1e20, 1e12}, {1e-6, 1e-14}};
    enum { BRIGHT = 1 << 16 };
    const lmg_layout y = one_cell(2);
    for (size_t k = 0; k < sizeof(PAIRS) / sizeof(PAIRS[0]); ++k) {
        lmg_accumulator *acc = accumulator(&y);
        const double dim = PAIRS[k][1];
        const uint64_t bright = PAIRS[k][0] > 1000 * dim ? BRIGHT : 16; /* photons in the first cell */
        static lmg_ray rays[16 + BRIGHT];
        for (uint64_t i = 0; i < 16 + bright; ++i)
            rays[i] = i < 16 ? down(0.025, 1, i) : down(-0.025, (float)(16 * PAIRS[k][0] / dim / (double)bright), i);
        lmg_accumulator_deposit(acc, rays, 16 + bright);
        assert_int_equal(lmg_accumulator_totals(acc).refused, 0);
        lmg_field *f, *back;
        lmg_error err = {{0}};
        const char *path = hard_path("sun.box.exr");
        if (lmg_field_reconstruct(acc, dim * lmg_slab_cell_etendue(&y.slabs[0], 0, 0, 0, 0) / 16, NULL, &f, &err) != LMG_OK ||
            lmg_field_write(f, path, &err) != LMG_OK || lmg_field_read(path, &back, &err) != LMG_OK)
            fail_msg("%s", err.message);
        double worst = 0;
        for (int c = 0; c < 2; ++c) {
            /* equal photons: an error of one over the root of their number */
            worst = fmax(worst, fabs((double)*lmg_cell_radiance(&back->slabs[0], (uint64_t)c) / PAIRS[k][c] - 1));
            worst =
                fmax(worst, fabs(sqrt(c == 0 ? (double)bright : 16) * (double)back->slabs[0].standard_error[c] / PAIRS[k][c] - 1));
        }
        /* fluxes of at least 1 are rounded to 2^-20, cells to float */
        hard_at_most(hard_text("%g cd/m2 beside %g cd/m2", PAIRS[k][0], PAIRS[k][1]),
                     "both and their standard errors after writing and reading, relative", worst,
                     0x1p-20 + 4 * (double)FLT_EPSILON);
        lmg_field_destroy(back);
        /* rounded cells are half floats in steps of at most a quarter of the standard error, which rounding may miss by less than a
         * step */
        if (lmg_field_write_rounded(f, path, 0.1, NULL, &err) != LMG_OK || lmg_field_read(path, &back, &err) != LMG_OK)
            fail_msg("%s", err.message);
        worst = 0;
        for (int c = 0; c < 2; ++c) {
            const double se = PAIRS[k][c] / sqrt(c == 0 ? (double)bright : 16);
            worst = fmax(worst, fabs((double)*lmg_cell_radiance(&back->slabs[0], (uint64_t)c) - PAIRS[k][c]) / se);
            assert_true(isfinite((double)back->slabs[0].standard_error[c]));
        }
        hard_at_most(hard_text("%g cd/m2 beside %g cd/m2", PAIRS[k][0], PAIRS[k][1]),
                     "both in a file of rounded cells, change over the standard error", worst, 0.25);
        lmg_field_destroy(f);
        lmg_field_destroy(back);
        lmg_accumulator_destroy(acc);
    }
}

int main(void)
{
    hard_begin("counting");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_many_photons), cmocka_unit_test(test_weights),       cmocka_unit_test(test_few_photons),
        cmocka_unit_test(test_filament),     cmocka_unit_test(test_sun_in_a_file),
    };
    return cmocka_run_group_tests_name("hard_counting", tests, NULL, NULL);
}
