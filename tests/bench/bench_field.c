/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What the light field costs, nanoseconds per call on one thread: depositing, radiance along random rays, sampling from points,
 * densities, emission, illuminance; and seconds for a fit and a reconstruction.  CPU time, best of many short
 * runs, so that what else runs on the machine counts little.  On the spot (aperture or cube
 * with beam window), the sphere (cube) and the louvred panel (aperture), three channels, 4 million cells: about 100 MB each.
 */
#include "../unit/lamp_fixture.h"
#include "geometry.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <cmocka.h>

enum { RAYS = 1 << 20, SLICE = 1 << 14 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* What a lamp's measurements share. */
typedef struct bench {
    lamp kind;
    const lmg_ray *rays; /* moved past the bounds */
    const lmg_field *field;
    lmg_accumulator *acc;
    lmg_plan plan;
    const lmg_vec3 *points;
    const double (*xi)[5];
    double sink; /* keeps results alive */
} bench;

/* Median and least time per call over slices of the rays: random access everywhere, yet short enough to fall between others' turns. */
static int by_size(const void *p, const void *q)
{
    double a = *(const double *)p, b = *(const double *)q;
    return (a > b) - (a < b);
}

static void best(const char *name, bench *b, size_t count, void (*run)(bench *b, size_t first, size_t count))
{
    double times[RAYS / SLICE * 2];
    size_t slices = count / SLICE ? count / SLICE : 1, slice = count / slices;
    for (size_t i = 0; i < 2 * slices; i++) {
        double start = now();
        run(b, i % slices * slice, slice);
        times[i] = (now() - start) * 1e9 / (double)slice;
    }
    qsort(times, 2 * slices, sizeof *times, by_size);
    printf("bench_field %-8s %-34s %9.1f ns (least %.1f)\n", lamp_name(b->kind), name, times[slices], times[0]);
}

static void run_owner(bench *b, size_t first, size_t count)
{
    for (size_t i = first; i < first + count; i++) {
        double uvst[4];
        int j = lmg_plan_owner(&b->plan, b->rays[i].origin, b->rays[i].direction, uvst);
        b->sink += j >= 0 ? (double)lmg_plan_cell(&b->plan, j, uvst) : 0;
    }
}

static void run_deposit(bench *b, size_t first, size_t count)
{
    for (size_t i = first; i < first + count; i += 4096)
        lmg_accumulator_deposit(b->acc, b->rays + i, 4096);
}

static void radiance(bench *b, size_t first, size_t count, lmg_filter filter)
{
    for (size_t i = first; i < first + count; i++) {
        float rgb[3];
        lmg_field_radiance(b->field, b->rays[i].origin, b->rays[i].direction, filter, rgb, NULL);
        b->sink += (double)rgb[1];
    }
}

static void run_nearest(bench *b, size_t first, size_t count)
{
    radiance(b, first, count, LMG_NEAREST);
}

static void run_linear(bench *b, size_t first, size_t count)
{
    radiance(b, first, count, LMG_LINEAR);
}

static void run_sample(bench *b, size_t first, size_t count)
{
    for (size_t i = first; i < first + count; i++) {
        lmg_point_sample s;
        if (lmg_field_sample_point(b->field, b->points[i], b->xi[i], &s))
            b->sink += s.pdf;
    }
}

static void run_sample_radiance(bench *b, size_t first, size_t count)
{
    for (size_t i = first; i < first + count; i++) {
        lmg_point_sample s;
        float rgb[3];
        if (lmg_field_sample_point(b->field, b->points[i], b->xi[i], &s) && lmg_field_sample_radiance(b->field, &s, rgb))
            b->sink += s.pdf + (double)rgb[0];
    }
}

static void run_pdf(bench *b, size_t first, size_t count)
{
    for (size_t i = first; i < first + count; i++) {
        const lmg_vec3 d = b->rays[i].direction;
        b->sink += lmg_field_point_pdf(b->field, b->rays[i].origin, (lmg_vec3){-d.x, -d.y, -d.z});
    }
}

static void run_emit(bench *b, size_t first, size_t count)
{
    for (size_t i = first; i < first + count; i++) {
        lmg_ray r;
        if (lmg_field_emit(b->field, b->xi[i], &r))
            b->sink += r.direction.x;
    }
}

static void run_illuminance(bench *b, size_t first, size_t count)
{
    lmg_vec3 axis = lamp_axis(b->kind);
    for (size_t i = first; i < first + count; i++) {
        double rgb[3], se;
        lmg_field_illuminance(b->field, b->points[i], (lmg_vec3){-axis.x, -axis.y, -axis.z}, rgb, &se, NULL);
        b->sink += rgb[1] + se;
    }
}

static void measure(lamp kind)
{
    lmg_fit_options wishes = {.struct_size = sizeof wishes, .channels = 3};
    lamp_bounds(kind, &wishes.bounds_min, &wishes.bounds_max);
    bench b = {.kind = kind};
    lmg_ray *rays = lamp_rays(kind, 1, 0, RAYS);
    double start = now();
    lmg_layout layout;
    char report[1024];
    assert_int_equal(lmg_layout_fit(rays, 200000, &wishes, &layout, report, NULL), LMG_OK);
    double fit = now() - start;
    lmg_vec3 *points = malloc(RAYS * sizeof *points);
    double(*xi)[5] = malloc(RAYS * sizeof *xi);
    assert_true(points && xi);
    lmg_vec3 axis = lamp_axis(kind), lo, hi;
    lamp_bounds(kind, &lo, &hi);
    for (uint64_t i = 0; i < RAYS; i++) {
        lamp_rng g = lamp_stream(3, i);
        double k0, k1;
        if (!lmg_box_interval(lo, hi, rays[i].origin, rays[i].direction, &k0, &k1))
            k1 = 0; /* a tangent, by rounding */
        rays[i].origin = v_fma(rays[i].origin, k1 + layout.size, rays[i].direction);
        for (int k = 0; k < 5; k++)
            xi[i][k] = lamp_next(&g);
        /* points on planes at 0.5 to 10 sizes, across as wide as they are far */
        double away = layout.size * 0.5 * pow(20, lamp_next(&g)), x = (lamp_next(&g) - 0.5) * away, y = (lamp_next(&g) - 0.5) * away;
        double half = 0.5 * fabs(v_dot(v_sub(hi, lo), axis));
        points[i] = v_fma(v_scale(0.5, v_add(lo, hi)), half + away, axis);
        points[i] = v_add(points[i], axis.x != 0 ? (lmg_vec3){0, x, y} : (lmg_vec3){x, 0, y});
    }
    b.rays = rays;
    b.points = points;
    b.xi = (const double(*)[5])xi;
    lmg_plan_prepare(&b.plan, &layout);
    assert_int_equal(lmg_accumulator_create(&layout, &b.acc, NULL), LMG_OK);
    best("owner and cell of a ray", &b, RAYS, run_owner);
    best("deposit, owner and cell included", &b, RAYS, run_deposit);
    start = now();
    lmg_field *field;
    assert_int_equal(lmg_field_reconstruct(b.acc, 1.0 / RAYS, NULL, &field, NULL), LMG_OK);
    double reconstruct = now() - start;
    b.field = field;
    best("radiance, nearest", &b, RAYS, run_nearest);
    best("radiance, linear", &b, RAYS, run_linear);
    best("sample from a point, with density", &b, RAYS, run_sample);
    best("and its radiance at once", &b, RAYS, run_sample_radiance);
    best("density of a direction", &b, RAYS, run_pdf);
    best("emit a ray", &b, RAYS, run_emit);
    best("illuminance at a point", &b, 200, run_illuminance);
    printf("bench_field %-8s fit of 200,000 rays %.2f s, reconstruction %.2f s, field %.0f MB (%g)\n", lamp_name(kind), fit, reconstruct,
           (double)lmg_field_memory(field) * 1e-6, b.sink == 0 ? 0.0 : 1.0);
    lmg_field_destroy(field);
    lmg_accumulator_destroy(b.acc);
    free(rays);
    free(points);
    free(xi);
}

static void benchmark(void **state)
{
    (void)state;
    measure(LAMP_SPOT);
    measure(LAMP_SPHERE);
    measure(LAMP_LOUVRE);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(benchmark)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
