/* SPDX-License-Identifier: Apache-2.0 */
/* Comparison of two sources by the receivers that both feed. */
#include "compare.h"

#include "bake.h"
#include "receiver.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t DEFAULT_PHOTONS = 20000000;
/* Photons that main axis and size are taken from. */
static const uint64_t PILOT_PHOTONS = 50000;
static const uint32_t PIXELS = 32, RINGS = 32, SECTORS = 64;

static int compare_doubles(const void *x, const void *y)
{
    const double a = *(const double *)x, b = *(const double *)y;
    return (a > b) - (a < b);
}

/*
 * With d = a - b of variance v = va + vb, E[d^2] = delta^2 + v: the noise comes off as a sum.  For Gaussian noise Var[d^2] = 2 v^2
 * + 4 delta^2 v, where sums over pixels take d^2 - v for delta^2; error propagation through the square root gives the standard
 * error, which far below the noise levels off at the root of the sum's own error.
 */
bake_difference bake_differ(const double *a, const double *a_se, const double *b, const double *b_se, size_t count)
{
    double d2 = 0, v = 0, b2 = 0, noise = 0, cross = 0;
    double *absolute = malloc(count * sizeof(*absolute));
    for (size_t i = 0; i < count; ++i) {
        const double d = a[i] - b[i], vi = a_se[i] * a_se[i] + b_se[i] * b_se[i];
        d2 += d * d;
        v += vi;
        b2 += b[i] * b[i] - b_se[i] * b_se[i];
        noise += 2 * vi * vi;
        cross += 4 * (d * d - vi) * vi;
        if (absolute)
            absolute[i] = fabs(d);
    }
    bake_difference r = {.raw = NAN, .rms = NAN, .standard_error = NAN, .p99 = NAN, .noise = NAN};
    if (b2 > 0) {
        const double s = (d2 - v) / b2, se = sqrt(noise + fmax(cross, 0)) / b2;
        r.raw = sqrt(d2 / b2);
        r.noise = sqrt(v / b2);
        r.rms = s >= 0 ? sqrt(s) : -sqrt(-s);
        r.standard_error = se > 0 ? se / (2 * fmax(fabs(r.rms), 0.5 * sqrt(se))) : 0;
        if (absolute) {
            qsort(absolute, count, sizeof(*absolute), compare_doubles);
            r.p99 = absolute[(size_t)(0.99 * (double)(count - 1) + 0.5)] / sqrt(b2 / (double)count);
        }
    }
    free(absolute);
    return r;
}

typedef struct receivers {
    size_t count;
    bake_receiver *list[BAKE_MAX_DISTANCES + 1];
} receivers;

static void destroy(receivers *r)
{
    for (size_t i = 0; i < r->count; ++i)
        bake_receiver_destroy(r->list[i]);
    r->count = 0;
}

static lmg_result create(receivers *r, const bake_rectangle *planes, size_t plane_count, lmg_vec3 axis, lmg_error *err)
{
    lmg_result result = LMG_OK;
    for (size_t i = 0; result == LMG_OK && i <= plane_count; ++i) {
        result = i < plane_count ? bake_illuminance_create(&planes[i], &r->list[i], err)
                                 : bake_sphere_create(&(bake_sphere){.radius = INFINITY, .axis = axis, .rings = RINGS, .sectors = SECTORS}, &r->list[i], err);
        r->count += result == LMG_OK;
    }
    if (result != LMG_OK)
        destroy(r);
    return result;
}

/* A few rays of a source, kept. */
static lmg_result run_pilot(bake_source *source, unsigned threads, bake_ray_list **list, const lmg_ray **rays, size_t *count,
                            lmg_error *err)
{
    lmg_result result = bake_ray_list_create(PILOT_PHOTONS, list, err);
    if (result != LMG_OK)
        return result;
    const lmg_sink sink = bake_ray_list_sink(*list);
    bake_tally tally = {0};
    result = source->run(source, BAKE_PILOT_FIRST, PILOT_PHOTONS, threads, &sink, 1, &tally, err);
    *rays = bake_ray_list_sorted(*list, count);
    if (result == LMG_OK && *count == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "no light leaves the luminaire: nothing to compare");
    if (result != LMG_OK) {
        bake_ray_list_destroy(*list);
        *list = NULL;
    }
    return result;
}

static lmg_result main_axis(bake_source *source, unsigned threads, lmg_vec3 *axis, lmg_error *err)
{
    bake_ray_list *list;
    const lmg_ray *rays;
    size_t count;
    const lmg_result result = run_pilot(source, threads, &list, &rays, &count, err);
    if (result != LMG_OK)
        return result;
    *axis = bake_main_axis(rays, count);
    bake_ray_list_destroy(list);
    return LMG_OK;
}

lmg_result bake_source_size(bake_source *source, unsigned threads, double *size, lmg_error *err)
{
    bake_ray_list *list;
    const lmg_ray *rays;
    size_t count;
    lmg_result result = run_pilot(source, threads, &list, &rays, &count, err);
    if (result != LMG_OK)
        return result;
    const lmg_fit_options fit = {.struct_size = sizeof(fit), .bounds_min = source->bounds_min, .bounds_max = source->bounds_max};
    lmg_layout layout;
    result = lmg_layout_fit(rays, count, &fit, &layout, NULL, err);
    if (result == LMG_OK)
        *size = layout.size;
    bake_ray_list_destroy(list);
    return result;
}

/* Readings of one receiver fed by both sources; arrays of 4 * count: a, a_se, b, b_se. */
static double *readings(bake_receiver *a, bake_receiver *b, const double lumens_per_unit[2])
{
    const size_t n = bake_receiver_count(a);
    double *r = malloc(4 * n * sizeof(*r));
    for (size_t i = 0; r && i < n; ++i) {
        r[i] = bake_receiver_reading(a, i, lumens_per_unit[0], &r[n + i]);
        r[2 * n + i] = bake_receiver_reading(b, i, lumens_per_unit[1], &r[3 * n + i]);
    }
    return r;
}

static void mean_of(const double *value, const double *error, size_t n, double *mean, double *mean_se)
{
    double sum = 0, squares = 0;
    for (size_t i = 0; i < n; ++i) {
        sum += value[i];
        squares += error[i] * error[i];
    }
    *mean = sum / (double)n;
    *mean_se = sqrt(squares) / (double)n;
}

static lmg_result evaluate(receivers sides[2], const bake_compare_options *options, const double lumens_per_unit[2],
                           bake_comparison *out, lmg_error *err)
{
    for (size_t i = 0; i <= options->distance_count; ++i) {
        double *r = readings(sides[0].list[i], sides[1].list[i], lumens_per_unit);
        if (!r)
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the comparison");
        const size_t n = bake_receiver_count(sides[0].list[i]);
        const bake_difference d = bake_differ(r, r + n, r + 2 * n, r + 3 * n, n);
        if (i == options->distance_count) {
            out->far_field = d;
        } else {
            out->planes[i].difference = d;
            for (int s = 0; s < 2; ++s)
                mean_of(r + 2 * (size_t)s * n, r + (2 * (size_t)s + 1) * n, n, &out->planes[i].mean[s], &out->planes[i].mean_se[s]);
        }
        free(r);
    }
    return LMG_OK;
}

static double least(double a, double b)
{
    return a < b ? a : b;
}

static double most(double a, double b)
{
    return a > b ? a : b;
}

lmg_result bake_compare(bake_source *a, bake_source *b, const bake_compare_options *options, bake_comparison *out, lmg_error *err)
{
    memset(out, 0, sizeof(*out));
    if (options->distance_count < 1 || options->distance_count > BAKE_MAX_DISTANCES || !(options->size > 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a comparison needs a size and 1 to %d distances", BAKE_MAX_DISTANCES);
    lmg_result result = main_axis(b, options->threads, &out->axis, err);
    if (result != LMG_OK)
        return result;
    out->size = options->size;

    /* Planes stand clear of both. */
    const lmg_vec3 lo = {least(a->bounds_min.x, b->bounds_min.x), least(a->bounds_min.y, b->bounds_min.y),
                         least(a->bounds_min.z, b->bounds_min.z)};
    const lmg_vec3 hi = {most(a->bounds_max.x, b->bounds_max.x), most(a->bounds_max.y, b->bounds_max.y),
                         most(a->bounds_max.z, b->bounds_max.z)};
    bake_rectangle planes[BAKE_MAX_DISTANCES];
    for (size_t i = 0; i < options->distance_count; ++i) {
        if (!(options->distances[i] > 0))
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "a distance of %g sizes isn't outside the luminaire", options->distances[i]);
        planes[i] = bake_measuring_rectangle(lo, hi, out->axis, options->size, options->distances[i] * options->size, PIXELS);
        out->planes[i].distance = options->distances[i] * options->size;
        out->planes[i].side = planes[i].width;
    }

    bake_source *const sources[2] = {a, b};
    receivers sides[2] = {{0}, {0}};
    double lumens_per_unit[2];
    const uint64_t wanted = options->photons ? options->photons : DEFAULT_PHOTONS;
    for (int s = 0; result == LMG_OK && s < 2; ++s) {
        result = create(&sides[s], planes, options->distance_count, out->axis, err);
        if (result != LMG_OK)
            break;
        lmg_sink sinks[BAKE_MAX_DISTANCES + 1];
        for (size_t i = 0; i < sides[s].count; ++i)
            sinks[i] = bake_receiver_sink(sides[s].list[i]);
        const double began = bake_clock();
        bake_tally *t = &out->tally[s];
        const uint64_t has = sources[s]->photons, photons = has && has < wanted ? has : wanted;
        result = sources[s]->run(sources[s], 0, photons, options->threads, sinks, sides[s].count, t, err);
        out->seconds[s] = bake_clock() - began;
        lumens_per_unit[s] = sources[s]->flux / (double)photons;
        out->flux[s] = t->escaped * lumens_per_unit[s];
        out->flux_se[s] = hypot(sources[s]->flux * bake_share_error(t->escaped, (double)photons),
                                sources[s]->flux_se * t->escaped / (double)photons);
    }
    if (result == LMG_OK)
        result = evaluate(sides, options, lumens_per_unit, out, err);
    destroy(&sides[0]);
    destroy(&sides[1]);
    return result;
}
