/* SPDX-License-Identifier: Apache-2.0 */
/* Rays of far-field distributions and the goniophotometer: a distribution's rays have its intensities, an area source looks equally
 * bright all over, and what the goniophotometer reads is what was emitted, within its own standard errors. */
#include "goniometer.h"
#include "source.h"
#include "stats.h"

#include <luminaires/photometry.h>
#include <luminaires/rng.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const double PI = 3.14159265358979323846;

/* An uneven, nowhere dark distribution in the stored sector of a symmetry, on uneven angles. */
static lum_photometry *make(lum_photometry_type type, lum_symmetry symmetry)
{
    static const double ranges[][2] = {{0, 324}, {0, 0}, {0, 180}, {-90, 90}, {0, 90}, {0, 75}};
    const uint32_t n = symmetry == LUM_SYMMETRY_AXIAL ? 1 : 7, m = 9;
    lum_photometry *p;
    assert_int_equal(lum_photometry_create(n, m, &p, NULL), LMG_OK);
    p->type = type;
    p->symmetry = symmetry;
    double low = ranges[symmetry][0], high = ranges[symmetry][1];
    if (type != LUM_TYPE_C && symmetry == LUM_SYMMETRY_NONE)
        low = -80, high = 65;
    for (uint32_t i = 0; i < n; i++) {
        const double t = n > 1 ? (double)i / (n - 1) : 0;
        p->h[i] = low + (high - low) * t * (0.8 + 0.2 * t);
    }
    for (uint32_t j = 0; j < m; j++) {
        const double t = (double)j / (m - 1);
        p->v[j] = type == LUM_TYPE_C ? 170 * t * (0.7 + 0.3 * t) : -85 + 160 * t;
    }
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t j = 0; j < m; j++)
            p->intensity[(size_t)i * m + j] = 20 + 100 * (1 + sin(1.7 * i + 2.9 * j)) * (j < 3 ? 3 : 1);
    lmg_error err;
    if (lum_photometry_check(p, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return p;
}

static double next(void *state)
{
    return lum_rng_next(state);
}

/* Null hypothesis: directions have density intensity / flux.  Chi-square in bins of equal solid angle against the interpolated
 * intensity integrated by quadrature in each bin. */
static void directions_follow_the_intensity(void **state)
{
    (void)state;
    static const struct {
        lum_photometry_type type;
        lum_symmetry symmetry;
    } cases[] = {{LUM_TYPE_C, LUM_SYMMETRY_NONE},     {LUM_TYPE_C, LUM_SYMMETRY_AXIAL},    {LUM_TYPE_C, LUM_SYMMETRY_C0_C180},
                 {LUM_TYPE_C, LUM_SYMMETRY_C90_C270}, {LUM_TYPE_C, LUM_SYMMETRY_QUADRANT}, {LUM_TYPE_B, LUM_SYMMETRY_NONE},
                 {LUM_TYPE_B, LUM_SYMMETRY_LATERAL},  {LUM_TYPE_A, LUM_SYMMETRY_NONE},     {LUM_TYPE_A, LUM_SYMMETRY_LATERAL}};
    enum { CASES = sizeof cases / sizeof *cases, RINGS = 23, SECTORS = 31, SAMPLES = 200000, FINE = 24 };
    for (int k = 0; k < CASES; k++) {
        lum_photometry *p = make(cases[k].type, cases[k].symmetry);
        lum_profile *profile;
        assert_int_equal(lum_profile_create(p, &profile, NULL), LMG_OK);
        double *expected = calloc(RINGS * SECTORS, sizeof *expected), *seen = calloc(RINGS * SECTORS, sizeof *seen), total = 0;
        for (int r = 0; r < RINGS; r++)
            for (int s = 0; s < SECTORS; s++)
                for (int f = 0; f < FINE * FINE; f++) {
                    const double y = 2 * (r + (f % FINE + 0.5) / FINE) / RINGS - 1,
                                 phi = 2 * PI * (s + (f / FINE + 0.5) / FINE) / SECTORS;
                    const double across = sqrt(1 - y * y);
                    expected[r * SECTORS + s] += lum_photometry_intensity(p, (lmg_vec3){across * cos(phi), y, across * sin(phi)});
                }
        for (int i = 0; i < RINGS * SECTORS; i++)
            total += expected[i];
        /* The quadrature gives the flux that the profile says it has.  Midpoint rule on 552 x 744 points: of kinks 1e-3; the steps
         * at the ends of types A and B fall up to half a row of 552 from where they are, with up to twice the mean intensity: 4e-3.
         */
        const double solid = 4 * PI / (RINGS * SECTORS * FINE * FINE);
        assert_true(fabs(total * solid / lum_profile_flux(profile) - 1) < (p->type == LUM_TYPE_C ? 1e-3 : 4e-3));
        lum_photometry_measures measures;
        assert_int_equal(lum_photometry_measure(p, &measures, NULL), LMG_OK);
        assert_true(fabs(measures.flux / lum_profile_flux(profile) - 1) < 1e-12);
        for (int i = 0; i < RINGS * SECTORS; i++)
            expected[i] *= SAMPLES / total;
        for (int i = 0; i < SAMPLES; i++) {
            lum_rng rng = lum_rng_stream(77 + (uint64_t)k, (uint64_t)i);
            const lmg_vec3 d = lum_profile_direction(profile, next, &rng);
            assert_true(fabs(d.x * d.x + d.y * d.y + d.z * d.z - 1) < 1e-12);
            assert_true(lum_profile_intensity(profile, d) > 0);
            const int r = (int)(0.5 * (d.y + 1) * RINGS), s = (int)((atan2(d.z, d.x) / (2 * PI) + (d.z < 0)) * SECTORS);
            seen[(r < RINGS ? r : RINGS - 1) * SECTORS + (s < SECTORS ? s : SECTORS - 1)]++;
        }
        const double p_value = stats_chi_square(seen, expected, RINGS * SECTORS, NULL, NULL);
        printf("type %d symmetry %d: p = %.3f\n", cases[k].type, cases[k].symmetry, p_value);
        assert_true(p_value > stats_sidak(0.01, CASES));
        free(expected);
        free(seen);
        lum_profile_destroy(profile);
        lum_photometry_destroy(p);
    }
}

/* ---------------------------------------------------------------------------------------------------------------- shapes */

/* A point of a shape's surface at parameters (s, t) and the normal times the area element; kind's surfaces are numbered by part. */
static bool surface(const lum_shape *shape, int part, double s, double t, double p[3], double n[3])
{
    const double a = 0.5 * shape->c0, b = 0.5 * shape->height, c = 0.5 * shape->c90, phi = 2 * PI * s;
    const bool lies0 = shape->kind == LUM_SHAPE_CYLINDER_C0, lies90 = shape->kind == LUM_SHAPE_CYLINDER_C90;
    switch (shape->kind) {
    case LUM_SHAPE_BOX: {
        const double half[3] = {a, b, c};
        if (part >= 6)
            return false;
        const int axis = part / 2, u = (axis + 1) % 3, v = (axis + 2) % 3;
        p[axis] = part % 2 ? half[axis] : -half[axis];
        p[u] = half[u] * (2 * s - 1);
        p[v] = half[v] * (2 * t - 1);
        n[axis] = (part % 2 ? 4 : -4) * half[u] * half[v];
        n[u] = n[v] = 0;
        return true;
    }
    case LUM_SHAPE_ELLIPSOID: {
        const double z = 2 * t - 1, r = sqrt(1 - z * z), e[3] = {r * cos(phi), r * sin(phi), z}, half[3] = {a, b, c};
        for (int k = 0; k < 3; k++) {
            p[k] = half[k] * e[k];
            n[k] = 4 * PI * a * b * c * e[k] / half[k];
        }
        return part < 1;
    }
    default: { /* cylinders: axis w, cross section (u, v) */
        const int w = lies0 ? 0 : lies90 ? 2 : 1, u = (w + 1) % 3, v = (w + 2) % 3;
        const double half[3] = {a, b, c}, r = sqrt(t);
        if (part == 0) {
            p[u] = half[u] * cos(phi), p[v] = half[v] * sin(phi), p[w] = half[w] * (2 * t - 1);
            n[u] = 4 * PI * half[w] * half[v] * cos(phi), n[v] = 4 * PI * half[w] * half[u] * sin(phi), n[w] = 0;
        } else {
            p[u] = half[u] * r * cos(phi), p[v] = half[v] * r * sin(phi), p[w] = part == 1 ? half[w] : -half[w];
            n[u] = n[v] = 0, n[w] = (part == 1 ? PI : -PI) * half[u] * half[v];
        }
        return part < 3;
    }
    }
}

/* Null hypothesis: the points' means of products of coordinates are those of the surface weighted by projected area. */
static void shapes_look_equally_bright_all_over(void **state)
{
    (void)state;
    static const lum_shape shapes[] = {{LUM_SHAPE_BOX, 0.31, 0.17, 0.23},
                                       {LUM_SHAPE_CYLINDER, 0.31, 0.17, 0.23},
                                       {LUM_SHAPE_CYLINDER_C0, 0.31, 0.17, 0.23},
                                       {LUM_SHAPE_CYLINDER_C90, 0.31, 0.17, 0.23},
                                       {LUM_SHAPE_ELLIPSOID, 0.31, 0.17, 0.23}};
    static const lmg_vec3 directions[] = {{0.48, -0.6, 0.64}, {-0.64, 0.48, -0.6}, {0, -1, 0}, {0.6, 0.8, 0}};
    enum { N = 200000, MOMENTS = 9 };
    double worst = 0;
    for (size_t k = 0; k < sizeof shapes / sizeof *shapes; k++)
        for (size_t q = 0; q < 4; q++) {
            const lmg_vec3 d = directions[q];
            double mean[2][MOMENTS] = {{0}}, square[2][MOMENTS] = {{0}}, weight = 0, weight2 = 0;
            lum_rng rng = lum_rng_stream(5, k * 4 + q);
            for (int i = 0; i < N; i++) {
                const double xi[3] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
                const lmg_vec3 at = lum_shape_point(&shapes[k], d, xi);
                const double x[3] = {at.x, at.y, at.z};
                for (int m = 0; m < MOMENTS; m++) {
                    const double f = m < 3 ? x[m] : x[(m - 3) / 2] * x[((m - 3) / 2 + (m - 3) % 2) % 3];
                    mean[0][m] += f / N;
                    square[0][m] += f * f / N;
                }
                double p[3] = {0}, n[3] = {0};
                const double s = lum_rng_next(&rng), t = lum_rng_next(&rng);
                for (int part = 0; surface(&shapes[k], part, s, t, p, n); part++) {
                    const double w = fmax(0, n[0] * d.x + n[1] * d.y + n[2] * d.z);
                    weight += w;
                    weight2 += w * w;
                    for (int m = 0; m < MOMENTS; m++) {
                        const double f = m < 3 ? p[m] : p[(m - 3) / 2] * p[((m - 3) / 2 + (m - 3) % 2) % 3];
                        mean[1][m] += w * f;
                        square[1][m] += w * f * f;
                    }
                }
            }
            for (int m = 0; m < MOMENTS; m++) {
                const double a = mean[0][m], b = mean[1][m] / weight;
                const double va = (square[0][m] - a * a) / N, vb = (square[1][m] / weight - b * b) * weight2 / (weight * weight);
                if (va + vb > 1e-12)
                    worst = fmax(worst, fabs(a - b) / sqrt(va + vb));
                else
                    assert_true(fabs(a - b) < 1e-9);
            }
        }
    printf("worst of %d moments: %.2f standard errors\n", 5 * 4 * MOMENTS, worst);
    assert_true(worst < 4.3); /* Sidak for 180 tests at 0.3 % */
}

/* ---------------------------------------------------------------------------------------------------------- goniometer */

/* A source of p's rays through the goniometer; returns the sum of z^2 over nodes, their number and the largest |z|. */
static void measure(const lum_photometry *p, uint64_t rays, uint64_t seed, unsigned threads, const bake_goniometer_options *o,
                    lum_photometry **out, double **se)
{
    bake_source *source;
    bake_goniometer *g;
    lmg_error err = {""};
    assert_int_equal(bake_profile_source_create(p, seed, &source, &err), LMG_OK);
    if (bake_goniometer_create(o, &g, &err) != LMG_OK)
        fail_msg("%s", err.message);
    const lmg_sink sink = bake_goniometer_sink(g);
    bake_tally tally = {0};
    assert_int_equal(source->run(source, 0, rays, threads, &sink, 1, &tally, &err), LMG_OK);
    assert_int_equal(tally.photons, rays);
    if (bake_goniometer_read(g, source->flux / (double)rays, out, se, &err) != LMG_OK)
        fail_msg("%s", err.message);
    bake_goniometer_destroy(g);
    source->destroy(source);
}

/* The distribution on the goniometer's own grid, bright everywhere, so that nothing is cut at zero. */
static lum_photometry *on_grid(uint32_t planes, uint32_t angles)
{
    lum_photometry *p;
    assert_int_equal(lum_photometry_create(planes, angles, &p, NULL), LMG_OK);
    for (uint32_t i = 0; i < planes; i++)
        p->h[i] = 360.0 * i / planes;
    for (uint32_t j = 0; j < angles; j++)
        p->v[j] = 180.0 * j / (angles - 1);
    for (uint32_t i = 0; i < planes; i++)
        for (uint32_t j = 0; j < angles; j++) {
            const bool pole = j == 0 || j == angles - 1;
            p->intensity[(size_t)i * angles + j] =
                300 + (pole ? 50 : 80 * sin(2 * PI * i / planes + 0.5) * sin(PI * j / (angles - 1)) + 40 * cos(0.7 * j));
        }
    return p;
}

static void goniometer_reads_what_was_emitted(void **state)
{
    (void)state;
    enum { PLANES = 24, ANGLES = 25, RAYS = 1000000, RUNS = 4 };
    lum_photometry *p = on_grid(PLANES, ANGLES);
    const bake_goniometer_options o = {.planes = PLANES, .angles = ANGLES};
    double z2 = 0, largest = 0, pole = 0;
    size_t count = 0;
    for (int run = 0; run < RUNS; run++) {
        lum_photometry *q;
        double *se;
        measure(p, RAYS, 100 + (uint64_t)run, 0, &o, &q, &se);
        lum_photometry_measures mp, mq;
        assert_int_equal(lum_photometry_measure(p, &mp, NULL), LMG_OK);
        assert_int_equal(lum_photometry_measure(q, &mq, NULL), LMG_OK);
        /* Every ray's whole flux is in the result: only fixed-point rounding, 4 x 2^-21 of a ray each. */
        assert_true(fabs(mq.flux / mp.flux - 1) < 2e-6);
        for (uint32_t i = 0; i < PLANES; i++)
            for (uint32_t j = 0; j < ANGLES; j++) {
                const size_t k = (size_t)i * ANGLES + j;
                const double z = (q->intensity[k] - p->intensity[k]) / se[k];
                if (j == 0 || j == ANGLES - 1) {
                    pole += i == 0 ? z * z : 0;
                    continue;
                }
                z2 += z * z;
                largest = fmax(largest, fabs(z));
                count++;
            }
        free(se);
        lum_photometry_destroy(q);
    }
    /* Neighbouring nodes are correlated, so that z^2 scatters more than for independent ones: the correlation of a least-squares
     * fit with hats (-0.27 to each side in each direction) makes sum z^2's variance 2 n sum(rho^2) = 2 n x 1.32.  The estimate of
     * the variance itself takes the density as constant over three nodes: 5 %. */
    const double sigma = sqrt(2 * 1.32 / (double)count);
    printf("mean z^2 %.3f (poles %.2f), largest |z| %.2f of %zu\n", z2 / (double)count, pole / (2 * RUNS), largest, count);
    assert_true(fabs(z2 / (double)count - 1) < 0.05 + 4 * sigma);
    assert_true(largest < 4.8);
    assert_true(pole / (2 * RUNS) < 3.3); /* chi-square with 8 degrees of freedom: p = 0.001 */
    lum_photometry_destroy(p);
}

static void symmetry_is_imposed_and_lessens_the_noise(void **state)
{
    (void)state;
    lum_photometry *source = make(LUM_TYPE_C, LUM_SYMMETRY_C90_C270);
    static const lum_symmetry symmetries[] = {LUM_SYMMETRY_NONE, LUM_SYMMETRY_C90_C270};
    double noise[2];
    for (int k = 0; k < 2; k++) {
        const bake_goniometer_options o = {.planes = 24, .angles = 19, .symmetry = symmetries[k]};
        lum_photometry *q;
        double *se;
        measure(source, 400000, 9, 0, &o, &q, &se);
        assert_int_equal(q->symmetry, symmetries[k]);
        assert_int_equal(lum_photometry_check(q, NULL), LMG_OK);
        assert_int_equal(q->h_count, k ? 13 : 24);
        lum_photometry_difference d;
        assert_int_equal(lum_photometry_compare(q, source, &d, NULL), LMG_OK);
        assert_true(d.bergen_weighted > 90 && fabs(d.flux_ratio - 1) < 1e-5);
        noise[k] = se[(k ? 9 : 3) * 19 + 9]; /* plane C45, or its like */
        free(se);
        lum_photometry_destroy(q);
    }
    /* Two nodes of about the same intensity: their mean has the noise of one over the root of two. */
    assert_true(fabs(noise[1] / noise[0] * sqrt(2) - 1) < 0.1);
    lum_photometry_destroy(source);
}

static void the_same_bits_on_any_number_of_threads(void **state)
{
    (void)state;
    lum_photometry *p = make(LUM_TYPE_C, LUM_SYMMETRY_NONE), *a, *b;
    p->shape = (lum_shape){LUM_SHAPE_BOX, 0.3, 0.2, 0.1};
    const bake_goniometer_options o = {.planes = 12, .angles = 19, .bounds_min = {-1, -1, -1}, .bounds_max = {1, 1, 1}};
    measure(p, 100000, 3, 1, &o, &a, NULL);
    measure(p, 100000, 3, 3, &o, &b, NULL);
    assert_memory_equal(a->intensity, b->intensity, 12 * 19 * sizeof *a->intensity);
    assert_int_equal(a->shape.kind, LUM_SHAPE_BOX);
    lum_photometry_destroy(a);
    lum_photometry_destroy(b);
    lum_photometry_destroy(p);
}

static void impossible_requests_are_refused(void **state)
{
    (void)state;
    static const bake_goniometer_options bad[] = {{.planes = 3}, {.planes = 26}, {.planes = 724}, {.angles = 6}, {.angles = 1442}};
    bake_goniometer *g;
    lmg_error err;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_int_equal(bake_goniometer_create(&bad[i], &g, &err), LMG_ERROR_ARGUMENT);
        assert_null(g);
    }
    const bake_goniometer_options o = {0};
    assert_int_equal(bake_goniometer_create(&o, &g, &err), LMG_OK);
    const lmg_sink sink = bake_goniometer_sink(g);
    const lmg_ray rays[] = {{.direction = {NAN, 0, 0}, .flux = {1, 1, 1}},
                            {.direction = {0, 1, 0}, .flux = {NAN, 1, 1}},
                            {.direction = {0, 1, 0}, .flux = {-1, -1, -1}}};
    sink.consume(sink.self, rays, 3);
    lum_photometry *p;
    assert_int_equal(bake_goniometer_read(g, 1, &p, NULL, &err), LMG_ERROR_INPUT);
    assert_null(p);
    bake_goniometer_destroy(g);
    bake_source *source;
    assert_int_equal(lum_photometry_create(2, 2, &p, NULL), LMG_OK);
    p->symmetry = LUM_SYMMETRY_C0_C180;
    p->h[1] = 180;
    p->v[1] = 90;
    assert_int_equal(bake_profile_source_create(p, 1, &source, &err), LMG_ERROR_INPUT);
    assert_non_null(strstr(err.message, "no light"));
    lum_photometry_destroy(p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(directions_follow_the_intensity),        cmocka_unit_test(shapes_look_equally_bright_all_over),
        cmocka_unit_test(goniometer_reads_what_was_emitted),      cmocka_unit_test(symmetry_is_imposed_and_lessens_the_noise),
        cmocka_unit_test(the_same_bits_on_any_number_of_threads), cmocka_unit_test(impossible_requests_are_refused)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
