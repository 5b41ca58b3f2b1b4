/* SPDX-License-Identifier: Apache-2.0 */
/* Receivers and the comparison of their readings: exact counts, orientation, solid angles, noise taken out with an honest error; a
 * box as a source against the box's own look-up. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "bake.h"
#include "compare.h"
#include "receiver.h"
#include "stats.h"

#include <luminaires/rng.h>

#include <math.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

static lmg_ray ray(lmg_vec3 o, lmg_vec3 d, float y)
{
    const double l = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
    return (lmg_ray){.origin = o, .direction = {d.x / l, d.y / l, d.z / l}, .flux = {y, y, y}};
}

static void feed(bake_receiver *r, lmg_ray x)
{
    const lmg_sink s = bake_receiver_sink(r);
    s.consume(s.self, &x, 1);
}

/* A rectangle of 3 x 2 pixels, 0.6 x 0.8 m, with light along +(a x b) = -y. */
static void test_rectangle(void **state)
{
    (void)state;
    const bake_rectangle q = {
        .centre = {0.1, -2, 0.3}, .a = {1, 0, 0}, .b = {0, 0, 1}, .width = 0.6, .height = 0.8, .nx = 3, .ny = 2};
    bake_receiver *r;
    assert_int_equal(bake_illuminance_create(&q, &r, NULL), LMG_OK);
    assert_int_equal(bake_receiver_count(r), 6);
    /* straight down into pixel (2, 0), obliquely into pixel (0, 1) */
    feed(r, ray((lmg_vec3){0.35, 0, 0}, (lmg_vec3){0, -1, 0}, 2));
    feed(r, ray((lmg_vec3){0.35, 0, 0}, (lmg_vec3){0, -1, 0}, 1));
    feed(r, ray((lmg_vec3){2, 0, 1}, (lmg_vec3){-2.1, -2, -0.6}, 1));
    /* none of these: upwards; starting below; beside it; NaN */
    feed(r, ray((lmg_vec3){0.35, -3, 0}, (lmg_vec3){0, 1, 0}, 1));
    feed(r, ray((lmg_vec3){0.35, -3, 0}, (lmg_vec3){0, -1, 0}, 1));
    feed(r, ray((lmg_vec3){0.45, 0, 0}, (lmg_vec3){0, -1, 0}, 1));
    feed(r, ray((lmg_vec3){0.35, 0, 0}, (lmg_vec3){0, -1, 0}, NAN));
    const double pixel = 0.2 * 0.4;
    const double expected[6] = {0, 0, 3, 1, 0, 0}, squares[6] = {0, 0, 5, 1, 0, 0};
    for (size_t i = 0; i < 6; ++i) {
        double error;
        const double e = bake_receiver_reading(r, i, 10, &error);
        /* fixed point: 2^-20; doubles otherwise */
        assert_true(fabs(e - 10 * expected[i] / pixel) < 1e-3);
        assert_true(fabs(error - 10 * sqrt(squares[i]) / pixel) < 1e-3);
    }
    bake_receiver_destroy(r);

    bake_rectangle flat = q;
    flat.width = 0;
    lmg_error err = {{0}};
    assert_int_equal(bake_illuminance_create(&flat, &r, &err), LMG_ERROR_ARGUMENT);
    assert_null(r);
}

/* Isotropic light has the same intensity in all bins: chi-square over 8 x 12 bins, about a skew axis, one million rays. */
static void test_far_field(void **state)
{
    (void)state;
    enum { RINGS = 8, SECTORS = 12, RAYS = 1000000 };
    bake_receiver *r;
    assert_int_equal(bake_sphere_create(&(bake_sphere){.radius = INFINITY, .axis = {0.6, 0, -0.8}, .rings = RINGS, .sectors = SECTORS}, &r, NULL), LMG_OK);
    double counts[RINGS * SECTORS], expected[RINGS * SECTORS];
    for (int i = 0; i < RAYS; ++i) {
        lum_rng rng = lum_rng_stream(9, (uint64_t)i);
        const double z = 2 * lum_rng_next(&rng) - 1, phi = 2 * PI * lum_rng_next(&rng), s = sqrt(1 - z * z);
        feed(r, ray((lmg_vec3){0, 0, 0}, (lmg_vec3){s * cos(phi), s * sin(phi), z}, 1));
    }
    double total = 0;
    for (size_t i = 0; i < RINGS * SECTORS; ++i) {
        const double cd = bake_receiver_reading(r, i, 1, NULL);
        counts[i] = cd * 4 * PI / (RINGS * SECTORS);
        expected[i] = (double)RAYS / (RINGS * SECTORS);
        total += counts[i];
    }
    assert_true(fabs(total - RAYS) < 1e-6 * RAYS);
    assert_true(stats_chi_square(counts, expected, RINGS * SECTORS, NULL, NULL) > 0.001);
    /* noise: one over the root of the rays in a bin */
    assert_true(fabs(bake_receiver_noise(r) / sqrt((double)(RINGS * SECTORS) / RAYS) - 1) < 0.02);
    /* the ends of the axis are in the first and last ring */
    bake_receiver_destroy(r);
    assert_int_equal(bake_sphere_create(&(bake_sphere){.radius = INFINITY, .axis = {0.6, 0, -0.8}, .rings = RINGS, .sectors = 1}, &r, NULL), LMG_OK);
    feed(r, ray((lmg_vec3){0, 0, 0}, (lmg_vec3){0.6, 0, -0.8}, 1));
    feed(r, ray((lmg_vec3){0, 0, 0}, (lmg_vec3){-0.6, 0, 0.8}, 3));
    assert_true(bake_receiver_reading(r, 0, 1, NULL) > 0);
    assert_true(bake_receiver_reading(r, RINGS - 1, 1, NULL) > bake_receiver_reading(r, 0, 1, NULL));
    bake_receiver_destroy(r);
}

static void test_main_axis(void **state)
{
    (void)state;
    const lmg_ray down[2] = {ray((lmg_vec3){0, 0, 0}, (lmg_vec3){0.3, -1, 0.2}, 1),
                             ray((lmg_vec3){0, 0, 0}, (lmg_vec3){-0.3, -1, 0.4}, 1)};
    lmg_vec3 a = bake_main_axis(down, 2);
    assert_true(a.x == 0 && a.y == -1 && a.z == 0);
    const lmg_ray side[1] = {ray((lmg_vec3){0, 0, 0}, (lmg_vec3){0.3, -0.2, 0.9}, 1)};
    a = bake_main_axis(side, 1);
    assert_true(a.x == 0 && a.y == 0 && a.z == 1);
    const lmg_ray both[2] = {ray((lmg_vec3){0, 0, 0}, (lmg_vec3){1, 0, 0}, 1), ray((lmg_vec3){0, 0, 0}, (lmg_vec3){-1, 0, 0}, 1)};
    a = bake_main_axis(both, 2);
    assert_true(a.y == -1);
    const bake_rectangle q =
        bake_measuring_rectangle((lmg_vec3){-1, -2, -3}, (lmg_vec3){1, 0, 5}, (lmg_vec3){0, -1, 0}, 0.5, 2, 32);
    assert_true(q.centre.x == 0 && q.centre.y == -4 && q.centre.z == 1);
    assert_true(q.width == 4.5 && q.height == 4.5);
}

static double normal(lum_rng *rng)
{
    return sqrt(-2 * log(1 - lum_rng_next(rng))) * cos(2 * PI * lum_rng_next(rng));
}

/* Readings that truly differ by a known RMS share, with Gaussian noise on both: over many trials the estimate is right on average
 * and its spread is what it says. */
static void test_difference(void **state)
{
    (void)state;
    enum { PIXELS = 1024, TRIALS = 200 };
    static double a[PIXELS], b[PIXELS], se[PIXELS];
    const double shares[3] = {0.05, 0.02, 0};
    for (int s = 0; s < 3; ++s) {
        stats_mean squares = {0};
        double said = 0;
        for (int k = 0; k < TRIALS; ++k) {
            lum_rng rng = lum_rng_stream(50 + (uint64_t)s, (uint64_t)k);
            for (int i = 0; i < PIXELS; ++i) {
                const double truth = 100 + 50 * sin(0.1 * i), noise = 0.03 * truth;
                /* +-share in turn */
                a[i] = truth + (i % 2 ? 1 : -1) * shares[s] * sqrt(11250) + noise * normal(&rng);
                b[i] = truth + noise * normal(&rng);
                se[i] = noise;
            }
            const bake_difference d = bake_differ(a, se, b, se, PIXELS);
            stats_add(&squares, d.rms * fabs(d.rms));
            said += shares[s] > 0 ? d.standard_error : 0;
            assert_true(d.raw > d.rms && d.noise > 0.03 && d.p99 > d.raw);
        }
        /* the mean square of the truth is 100^2 + 50^2 / 2 = 11250 up to the sine's incomplete periods (1 %) */
        print_message("difference %.3f: mean square %.3e +- %.1e\n", shares[s], squares.mean, stats_error(&squares));
        assert_true(fabs(squares.mean - shares[s] * shares[s]) < 4 * stats_error(&squares) + 0.02 * shares[s] * shares[s]);
        if (shares[s] > 0) { /* spread of the square / (2 rms) against the error given: 200 trials tell it to 5 %, and 4 of those */
            const double spread = stats_error(&squares) * sqrt(TRIALS) / (2 * shares[s]);
            assert_true(fabs(said / TRIALS / spread - 1) < 0.25);
        }
    }
}

/* A box as a source of rays lights a plane as its look-up says, and has its flux. */
static void test_box_source(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t light = make_material(m, LUM_SURFACE_BLACK), wall = make_lambert(m, 0.6f);
    for (int k = 0; k < 3; ++k)
        m->materials[light].emissive[k] = 1000;
    make_quad(m, (lmg_vec3){-0.1, 0, -0.15}, (lmg_vec3){0.2, 0, 0}, (lmg_vec3){0, 0, 0.3}, 2, light);  /* faces -y */
    make_quad(m, (lmg_vec3){0.1, -0.1, -0.15}, (lmg_vec3){0, 0.1, 0}, (lmg_vec3){0, 0, 0.3}, 2, wall); /* a wall beside it */
    finish_model(m);
    const bake_options options = {.photons = 3000000, .seed = 4, .fit.cells = 200000};
    bake_report report;
    lmg_field *field;
    lmg_error err = {{0}};
    if (bake_run(m, &options, &field, &report, &err) != LMG_OK)
        fail_msg("%s", err.message);
    bake_source *source;
    assert_int_equal(bake_box_source_create(field, 5, &source, &err), LMG_OK);
    const lmg_ledger l = lmg_field_ledger(field);
    assert_true(fabs(source->flux - l.stored) < 1e-5 * l.stored); /* cells are floats */

    const bake_rectangle q = bake_measuring_rectangle(source->bounds_min, source->bounds_max, (lmg_vec3){0, -1, 0}, 0.3, 0.3, 6);
    bake_receiver *r;
    assert_int_equal(bake_illuminance_create(&q, &r, &err), LMG_OK);
    const lmg_sink sink = bake_receiver_sink(r);
    bake_tally tally = {0};
    const uint64_t rays = 4000000;
    assert_int_equal(source->run(source, 0, rays, 0, &sink, 1, &tally, &err), LMG_OK);
    assert_true(tally.emitted == (double)rays && tally.escaped == (double)rays);
    const double dx = q.width / q.nx;
    double chi2 = 0;
    for (uint32_t iy = 0; iy < q.ny; ++iy)
        for (uint32_t ix = 0; ix < q.nx; ++ix) {
            /* mean of the look-up over 8 x 8 points of the pixel */
            double mean = 0;
            for (int j = 0; j < 64; ++j) {
                const double x = (ix + (j % 8 + 0.5) / 8) * dx - q.width / 2, y = (iy + (j / 8 + 0.5) / 8) * dx - q.height / 2;
                const lmg_vec3 p = {q.centre.x + x * q.a.x + y * q.b.x, q.centre.y + x * q.a.y + y * q.b.y,
                                    q.centre.z + x * q.a.z + y * q.b.z};
                double rgb[3];
                assert_int_equal(lmg_field_illuminance(field, p, (lmg_vec3){0, 1, 0}, rgb, NULL, &err), LMG_OK);
                mean += (0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]) / 64;
            }
            double error;
            const double e = bake_receiver_reading(r, iy * q.nx + ix, source->flux / (double)rays, &error);
            /* 64 points of a piecewise constant field: half a per cent beside the rays' own noise */
            chi2 += (e - mean) * (e - mean) / (error * error + 25e-6 * mean * mean);
        }
    print_message("box source: chi-square %.1f of 36 pixels\n", chi2);
    assert_true(stats_chi_square_tail(chi2, 36) > 0.001);
    bake_receiver_destroy(r);
    source->destroy(source);

    /* and against the geometry itself, by the comparison */
    bake_source *box, *lamp;
    assert_int_equal(bake_box_source_create(field, 15, &box, &err), LMG_OK);
    assert_int_equal(bake_tracer_create(m, 16, &lamp, &err), LMG_OK);
    const bake_compare_options compare = {.photons = 2000000, .size = 0.36, .distance_count = 2, .distances = {0.5, 2}};
    bake_comparison c;
    assert_int_equal(bake_compare(box, lamp, &compare, &c, &err), LMG_OK);
    assert_true(c.axis.y == -1);
    assert_true(fabs(c.flux[0] - c.flux[1]) < 4 * hypot(c.flux_se[0], c.flux_se[1]));
    for (int i = 0; i < 2; ++i) {
        print_message("box against geometry at %.2g m: %.2f %% +- %.2f %%\n", c.planes[i].distance,
                      100 * c.planes[i].difference.rms, 100 * c.planes[i].difference.standard_error);
        assert_true(c.planes[i].difference.rms < 0.03);
    }
    box->destroy(box);
    lamp->destroy(lamp);
    lmg_field_destroy(field);
    free_model(m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_rectangle), cmocka_unit_test(test_far_field),
                                       cmocka_unit_test(test_main_axis), cmocka_unit_test(test_difference),
                                       cmocka_unit_test(test_box_source)};
    return cmocka_run_group_tests_name("receiver", tests, NULL, NULL);
}
