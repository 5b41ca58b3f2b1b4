/* SPDX-License-Identifier: Apache-2.0 */
/* What a comparison says, computed from the readings of both sources: differences, measures, distances.  Measuring: compare.c. */
#include "compare_inside.h"

#include <luminaires/photometry.h>
#include <luminaires/spectrum.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

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

static void mean_and_error(const reading *r, double *mean, double *se)
{
    for (size_t i = 0; i < r->count; ++i) {
        double sum = 0;
        for (size_t b = 0; b < BLOCKS; ++b)
            sum += r->value[b * r->count + i];
        mean[i] = sum / BLOCKS;
        se[i] = sqrt(r->variance[i]);
    }
}

/* Four arrays in one allocation, which `a` holds; a is NULL without memory. */
static bake_readings readings_of(const reading *a, const reading *b)
{
    const size_t n = a->count;
    bake_readings r = {.count = n, .a = malloc(4 * n * sizeof(double))};
    if (r.a) {
        r.a_se = r.a + n;
        r.b = r.a + 2 * n;
        r.b_se = r.a + 3 * n;
        mean_and_error(a, r.a, r.a_se);
        mean_and_error(b, r.b, r.b_se);
    }
    return r;
}

bake_difference differ(const reading *a, const reading *b)
{
    const bake_readings r = readings_of(a, b);
    const bake_difference none = {.raw = NAN, .rms = NAN, .standard_error = NAN, .p99 = NAN, .noise = NAN};
    const bake_difference d = r.a ? bake_differ(r.a, r.a_se, r.b, r.b_se, r.count) : none;
    free(r.a);
    return d;
}

/* ------------------------------------------------------------------------------------------------------------- figures */

/* Everything that is jackknifed, as one array of doubles: the values of the measures (a, b, difference), and the deviations from
 * the far field. */
typedef struct figures {
    double measure[BAKE_MAX_MEASURES][3];
    double deviation[2][NEAR_RINGS * BAKE_RADII];
} figures;
enum { FIGURES = sizeof(figures) / sizeof(double) };

/* Names of the measures; filled once. */
typedef struct catalogue {
    bake_measure *list;
    size_t count;
} catalogue;

/* Readings with a block left out. */
typedef struct means {
    size_t plane_count;
    double *value[MAX_RECEIVERS], *rgb[MAX_RECEIVERS];
} means;

static void release_means(means *m)
{
    for (size_t i = 0; i < MAX_RECEIVERS; ++i) {
        free(m->value[i]);
        free(m->rgb[i]);
    }
    *m = (means){0};
}

static double *mean_without(const double *blocks, size_t count, int left_out)
{
    double *mean = calloc(count ? count : 1, sizeof(*mean));
    for (int b = 0; mean && b < BLOCKS; ++b)
        if (b != left_out)
            for (size_t i = 0; i < count; ++i)
                mean[i] += blocks[(size_t)b * count + i] / (left_out < BLOCKS ? BLOCKS - 1 : BLOCKS);
    return mean;
}

static bool make_means(const measured *m, size_t plane_count, int left_out, means *out)
{
    *out = (means){.plane_count = plane_count};
    bool made = true;
    for (size_t i = 0; i < m->count; ++i) {
        out->value[i] = mean_without(m->of[i].value, m->of[i].count, left_out);
        out->rgb[i] = m->of[i].rgb ? mean_without(m->of[i].rgb, 3 * m->of[i].count, left_out) : NULL;
        made = made && out->value[i] && (out->rgb[i] || !m->of[i].rgb);
    }
    return made;
}

/* Adds a figure; the first pass (c->list) writes its description too. */
static void put(catalogue *c, figures *f, size_t *n, const char *name, const char *unit, double a, double b, bool relative)
{
    if (*n == BAKE_MAX_MEASURES)
        return;
    if (c) {
        bake_measure *m = &c->list[*n];
        snprintf(m->name, sizeof(m->name), "%s", name);
        snprintf(m->unit, sizeof(m->unit), "%s", unit);
        m->relative = relative;
        c->count = *n + 1;
    }
    f->measure[*n][0] = a;
    f->measure[*n][1] = b;
    f->measure[(*n)++][2] = relative ? a / b - 1 : a - b;
}

/* The same of a figure that belongs to the pair; none: its value for equal sources. */
static void put_pair(catalogue *c, figures *f, size_t *n, const char *name, const char *unit, double value, double none)
{
    if (*n == BAKE_MAX_MEASURES)
        return;
    if (c)
        c->list[*n].none = none;
    put(c, f, n, name, unit, NAN, NAN, false);
    f->measure[*n - 1][2] = value;
}

static double ring_solid_angle(uint32_t ring, uint32_t rings, uint32_t sectors)
{
    return 2 * PI / sectors * (cos(PI * ring / rings) - cos(PI * (ring + 1) / rings));
}

static double bergen_fit(const double *a, const double *b, size_t count)
{
    lum_bergen fit = {0};
    for (size_t i = 0; i < count; ++i)
        lum_bergen_add(&fit, a[i], b[i], 1);
    return lum_bergen_fit(&fit);
}

/* Intensity over the polar angle, mean of the sectors. */
static void profile_of(const double *bins, double mean[PROFILE_RINGS])
{
    for (int ring = 0; ring < PROFILE_RINGS; ++ring) {
        mean[ring] = 0;
        for (int s = 0; s < PROFILE_SECTORS; ++s)
            mean[ring] += bins[ring * PROFILE_SECTORS + s] / PROFILE_SECTORS;
    }
}

/* Full angle, degrees, outside of which the profile stays below share x its peak; interpolated between the rings. */
static double full_angle(const double profile[PROFILE_RINGS], double share)
{
    double peak = 0;
    for (int i = 0; i < PROFILE_RINGS; ++i)
        peak = fmax(peak, profile[i]);
    int last = PROFILE_RINGS - 1;
    while (last >= 0 && profile[last] < share * peak)
        --last;
    if (last < 0 || last == PROFILE_RINGS - 1)
        return last < 0 ? NAN : 360;
    const double x = (profile[last] - share * peak) / (profile[last] - profile[last + 1]);
    return 2 * (last + 0.5 + x) * 180 / PROFILE_RINGS;
}

static double largest(const double *v, size_t count)
{
    double most = 0;
    for (size_t i = 0; i < count; ++i)
        most = fmax(most, v[i]);
    return most;
}

/* Distance in CIE 1976 u'v'; NAN where one of them is dark. */
static double colour_distance(const double a[3], const double b[3])
{
    double xyz[2][3], xy[2], uv[2][2];
    lum_rgb_to_xyz(a, xyz[0]);
    lum_rgb_to_xyz(b, xyz[1]);
    for (int i = 0; i < 2; ++i) {
        if (!(xyz[i][1] > 0))
            return NAN;
        lum_chromaticity(xyz[i], xy, uv[i]);
    }
    return hypot(uv[0][0] - uv[1][0], uv[0][1] - uv[1][1]);
}

/* Flux-weighted mean colour distance of the cells that a receiver's bins are gathered in: group of bin i is group_of(i). */
static double mean_colour_distance(const double *a, const double *b, size_t count, size_t (*group_of)(size_t), size_t groups)
{
    double *sums = calloc(6 * groups, sizeof(*sums)), total = 0, distance = 0;
    for (size_t i = 0; sums && i < count; ++i)
        for (int k = 0; k < 3; ++k) {
            sums[6 * group_of(i) + (size_t)k] += a[3 * i + (size_t)k];
            sums[6 * group_of(i) + 3 + (size_t)k] += b[3 * i + (size_t)k];
        }
    for (size_t g = 0; sums && g < groups; ++g) {
        const double d = colour_distance(&sums[6 * g], &sums[6 * g + 3]);
        const double y = 0.2126 * sums[6 * g + 3] + 0.7152 * sums[6 * g + 4] + 0.0722 * sums[6 * g + 5];
        if (isfinite(d) && y > 0) {
            distance += y * d;
            total += y;
        }
    }
    free(sums);
    return distance / total;
}

/* The far field's 32 x 64 bins in 8 x 8, a plane's 32 x 32 pixels in 8 x 8. */
static size_t far_group(size_t i)
{
    return i / SECTORS / 4 * 8 + i % SECTORS / 8;
}

static size_t plane_group(size_t i)
{
    return i / PIXELS / 4 * 8 + i % PIXELS / 4;
}

static size_t one_group(size_t i)
{
    (void)i;
    return 0;
}

/* Structural similarity of two pictures [Wang et al. 2004], windows of 8 x 8 pixels, range: B's largest value. */
static double similarity(const double *a, const double *b)
{
    const double range = largest(b, PIXELS * PIXELS), c1 = 1e-4 * range * range, c2 = 9e-4 * range * range;
    if (!(range > 0))
        return NAN;
    double sum = 0;
    int windows = 0;
    for (int y = 0; y + 8 <= PIXELS; y += 2)
        for (int x = 0; x + 8 <= PIXELS; x += 2) {
            double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
            for (int j = 0; j < 8; ++j)
                for (int i = 0; i < 8; ++i) {
                    const double p = a[(y + j) * PIXELS + x + i], q = b[(y + j) * PIXELS + x + i];
                    ma += p / 64, mb += q / 64, aa += p * p / 64, bb += q * q / 64, ab += p * q / 64;
                }
            const double va = aa - ma * ma, vb = bb - mb * mb, v = ab - ma * mb;
            sum += (2 * ma * mb + c1) * (2 * v + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            ++windows;
        }
    return sum / windows;
}

static int compare_descending(const void *x, const void *y)
{
    return compare_doubles(y, x);
}

/* Mean of the brightest hundredth of a picture's pixels, cd/m2. */
static double peak_luminance(const double *picture)
{
    double sorted[PIXELS * PIXELS], sum = 0;
    memcpy(sorted, picture, sizeof(sorted));
    qsort(sorted, PIXELS * PIXELS, sizeof(sorted[0]), compare_descending);
    const int n = PIXELS * PIXELS / 100;
    for (int i = 0; i < n; ++i)
        sum += sorted[i] / n;
    return sum;
}

/* How far the light through each sphere is from the far field: per ring the RMS over its sectors, relative to the ring's mean. */
static void deviations(const means *m, double out[NEAR_RINGS * BAKE_RADII])
{
    /* The far field in the spheres' bins, from the finer profile. */
    double far[NEAR_RINGS * NEAR_SECTORS] = {0}, weight[NEAR_RINGS * NEAR_SECTORS] = {0};
    const double *profile = m->value[m->plane_count + PROFILE];
    for (uint32_t ring = 0; ring < PROFILE_RINGS; ++ring)
        for (uint32_t s = 0; s < PROFILE_SECTORS; ++s) {
            const size_t to = ring / (PROFILE_RINGS / NEAR_RINGS) * NEAR_SECTORS + s / (PROFILE_SECTORS / NEAR_SECTORS);
            const double w = ring_solid_angle(ring, PROFILE_RINGS, PROFILE_SECTORS);
            far[to] += w * profile[ring * PROFILE_SECTORS + s];
            weight[to] += w;
        }
    double brightest = 0;
    for (size_t i = 0; i < NEAR_RINGS * NEAR_SECTORS; ++i) {
        far[i] /= weight[i];
        brightest = fmax(brightest, far[i]);
    }
    for (int ring = 0; ring < NEAR_RINGS; ++ring)
        for (int k = 0; k < BAKE_RADII; ++k) {
            const double *near = m->value[m->plane_count + SPHERES + (size_t)k];
            double sum = 0, squares = 0;
            for (int s = 0; s < NEAR_SECTORS; ++s) {
                const double i = far[ring * NEAR_SECTORS + s], e = near[ring * NEAR_SECTORS + s];
                sum += i / NEAR_SECTORS;
                squares += (e - i) * (e - i) / NEAR_SECTORS;
            }
            /* Squared, so that the jackknife can take the noise off: a mean square's noise bias falls as one over the rays. */
            out[ring * BAKE_RADII + k] = sum > 1e-3 * brightest ? squares / (sum * sum) : (double)NAN;
        }
}

static void compute(const means m[2], catalogue *c, figures *f)
{
    const size_t planes = m[0].plane_count;
    size_t n = 0;
    char name[64];
    double total[2] = {0}, down[2] = {0}, zone[2][ZONES];
    for (int s = 0; s < 2; ++s)
        for (uint32_t z = 0; z < ZONES; ++z) {
            zone[s][z] = m[s].value[planes + NADIR][z] * ring_solid_angle(z, ZONES, 1);
            total[s] += zone[s][z];
            down[s] += z < ZONES / 2 ? zone[s][z] : 0;
        }
    put(c, f, &n, "flux", "lm", total[0], total[1], true);
    put(c, f, &n, "flux down", "lm", down[0], down[1], false);
    put(c, f, &n, "flux up", "lm", total[0] - down[0], total[1] - down[1], false);
    for (int z = 0; z < ZONES; ++z) {
        snprintf(name, sizeof(name), "flux %d-%d deg", 10 * z, 10 * (z + 1));
        put(c, f, &n, name, "lm", zone[0][z], zone[1][z], false);
    }

    const double *far[2], *fine[2];
    double profile[2][PROFILE_RINGS];
    for (int s = 0; s < 2; ++s) {
        far[s] = m[s].value[planes + FAR_FIELD];
        fine[s] = m[s].value[planes + PROFILE];
        profile_of(fine[s], profile[s]);
    }
    put(c, f, &n, "peak intensity", "cd", largest(profile[0], PROFILE_RINGS), largest(profile[1], PROFILE_RINGS), true);
    put(c, f, &n, "beam angle", "deg", full_angle(profile[0], 0.5), full_angle(profile[1], 0.5), false);
    put(c, f, &n, "field angle", "deg", full_angle(profile[0], 0.1), full_angle(profile[1], 0.1), false);
    put_pair(c, f, &n, "Bergen's fit", "", bergen_fit(fine[0], fine[1], PROFILE_RINGS * PROFILE_SECTORS), 100);
    put_pair(c, f, &n, "Bergen's fit, by solid angle", "", bergen_fit(far[0], far[1], RINGS * SECTORS), 100);

    const double *far_rgb[2] = {m[0].rgb[planes + FAR_FIELD], m[1].rgb[planes + FAR_FIELD]};
    put_pair(c, f, &n, "colour of all light", "u'v'", mean_colour_distance(far_rgb[0], far_rgb[1], RINGS * SECTORS, one_group, 1),
             0);
    put_pair(c, f, &n, "colour over angle", "u'v'", mean_colour_distance(far_rgb[0], far_rgb[1], RINGS * SECTORS, far_group, 64),
             0);
    put_pair(c, f, &n, "colour over position", "u'v'",
             mean_colour_distance(m[0].rgb[0], m[1].rgb[0], PIXELS * PIXELS, plane_group, 64), 0);

    for (size_t v = 0; v < BAKE_VIEWS; ++v) {
        const double *a = m[0].value[planes + PICTURES + v], *b = m[1].value[planes + PICTURES + v];
        snprintf(name, sizeof(name), "view %zu: peak luminance", v + 1);
        put(c, f, &n, name, "cd/m2", peak_luminance(a), peak_luminance(b), true);
        snprintf(name, sizeof(name), "view %zu: similarity", v + 1);
        put_pair(c, f, &n, name, "SSIM", similarity(a, b), 1);
    }
    for (int s = 0; s < 2; ++s)
        deviations(&m[s], f->deviation[s]);
}

/* ------------------------------------------------------------------------------------------------------------ evaluate */

bool bake_measure_differs(const bake_measure *m)
{
    /* Differences of equal things come out as rounding, with as little error. */
    const double rounding = 1e-9 * fmax(1, fmax(isfinite(m->a) ? fabs(m->a) : 0, isfinite(m->b) ? fabs(m->b) : 0));
    return fabs(m->difference - m->none) > 3 * m->difference_se + rounding;
}

/* A figure without its noise bias, and its standard error. */
static double jackknife(double whole, const double left_out[BLOCKS], double *se)
{
    double mean = 0, squares = 0;
    for (int b = 0; b < BLOCKS; ++b)
        mean += left_out[b] / BLOCKS;
    for (int b = 0; b < BLOCKS; ++b)
        squares += (left_out[b] - mean) * (left_out[b] - mean);
    *se = sqrt(squares * (BLOCKS - 1) / BLOCKS);
    return BLOCKS * whole - (BLOCKS - 1) * mean;
}

static lmg_result jackknife_figures(const measured sides[2], bake_comparison *out, figures *value, figures *error, lmg_error *err)
{
    figures *passes = calloc(BLOCKS + 1, sizeof(*passes));
    bool made = passes != NULL;
    catalogue c = {.list = out->measures};
    for (int left = 0; made && left <= BLOCKS; ++left) {
        means m[2] = {{0}, {0}};
        made = make_means(&sides[0], out->plane_count, left, &m[0]) && make_means(&sides[1], out->plane_count, left, &m[1]);
        if (made)
            compute(m, left == BLOCKS ? &c : NULL, &passes[left]);
        release_means(&m[0]);
        release_means(&m[1]);
    }
    for (size_t k = 0; made && k < FIGURES; ++k) {
        double left_out[BLOCKS];
        for (int b = 0; b < BLOCKS; ++b)
            left_out[b] = ((const double *)&passes[b])[k];
        ((double *)value)[k] = jackknife(((const double *)&passes[BLOCKS])[k], left_out, &((double *)error)[k]);
    }
    out->measure_count = c.count;
    free(passes);
    return made ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the comparison");
}

/* The radius beyond which all radii deviate by less than the limit, between two radii by the power law through their deviations. */
static double valid_from(const double *deviation, const double *radii, double limit)
{
    int last = BAKE_RADII - 1;
    if (isnan(deviation[last]))
        return NAN;
    if (deviation[last] > limit)
        return INFINITY;
    while (last > 0 && deviation[last - 1] <= limit)
        --last;
    if (last == 0)
        return radii[0];
    const double x0 = log(radii[last - 1]), x1 = log(radii[last]);
    const double y0 = log(deviation[last - 1] / limit), y1 = log(fmax(deviation[last], 1e-3 * limit) / limit);
    return exp(x0 + (x1 - x0) * y0 / (y0 - y1));
}

static lmg_result evaluate_distances(const figures *value, const figures *error, bake_comparison *out, lmg_error *err)
{
    out->rings = NEAR_RINGS;
    for (int s = 0; s < 2; ++s) {
        out->deviation[s] = malloc(sizeof(value->deviation[s]));
        out->deviation_se[s] = malloc(sizeof(value->deviation[s]));
        for (int k = 0; k < 2; ++k)
            out->valid_from[s][k] = malloc(NEAR_RINGS * sizeof(double));
        if (!out->deviation[s] || !out->deviation_se[s] || !out->valid_from[s][0] || !out->valid_from[s][1])
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the comparison");
        for (size_t i = 0; i < NEAR_RINGS * BAKE_RADII; ++i) {
            const double square = value->deviation[s][i], se = error->deviation[s][i];
            out->deviation[s][i] = isnan(square) ? (double)NAN : sqrt(fmax(square, 0));
            out->deviation_se[s][i] = se / (2 * fmax(out->deviation[s][i], 0.5 * sqrt(se)));
        }
        for (int ring = 0; ring < NEAR_RINGS; ++ring) {
            out->valid_from[s][0][ring] = valid_from(&out->deviation[s][ring * BAKE_RADII], out->radii, 0.01);
            out->valid_from[s][1][ring] = valid_from(&out->deviation[s][ring * BAKE_RADII], out->radii, 0.05);
        }
    }
    return LMG_OK;
}

/* Plots of intensity: the half-planes at four azimuths, each the mean of the two sectors beside it. */
static lmg_result evaluate_profiles(const measured sides[2], bake_comparison *out, lmg_error *err)
{
    out->profile_rings = PROFILE_RINGS;
    for (int s = 0; s < 2; ++s) {
        const reading *r = &sides[s].of[out->plane_count + PROFILE];
        double *mean = mean_without(r->value, r->count, BLOCKS);
        for (int k = 0; k < 4; ++k) {
            /* Azimuth 0 is in the middle of the bins, which start at -180 degrees. */
            const int at = (PROFILE_SECTORS / 2 + k * PROFILE_SECTORS / 4) % PROFILE_SECTORS;
            const int before = (at + PROFILE_SECTORS - 1) % PROFILE_SECTORS;
            double *profile = out->profile[s][k] = malloc(PROFILE_RINGS * sizeof(double));
            for (int ring = 0; mean && profile && ring < PROFILE_RINGS; ++ring)
                profile[ring] = 0.5 * (mean[ring * PROFILE_SECTORS + at] + mean[ring * PROFILE_SECTORS + before]);
            if (!mean || !profile) {
                free(mean);
                return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the comparison");
            }
        }
        free(mean);
    }
    return LMG_OK;
}

static void add_focus(bake_comparison *out)
{
    static const char *const NAMES[3] = {"virtual focus x", "virtual focus y", "virtual focus z"};
    const bake_focus *fa = &out->alignment.focus[0], *fb = &out->alignment.focus[1];
    const lmg_vec3 p = out->moved ? bake_motion_point(&out->alignment.motion, fa->point) : fa->point;
    const double a[3] = {p.x, p.y, p.z}, b[3] = {fb->point.x, fb->point.y, fb->point.z};
    const double ea[3] = {fa->standard_error.x, fa->standard_error.y, fa->standard_error.z};
    const double eb[3] = {fb->standard_error.x, fb->standard_error.y, fb->standard_error.z};
    for (int k = 0; k < 3 && out->measure_count < BAKE_MAX_MEASURES; ++k) {
        bake_measure *m = &out->measures[out->measure_count++];
        *m = (bake_measure){.unit = "mm",
                            .a = 1e3 * a[k],
                            .a_se = 1e3 * ea[k],
                            .b = 1e3 * b[k],
                            .b_se = 1e3 * eb[k],
                            .difference = 1e3 * (a[k] - b[k]),
                            .difference_se = 1e3 * hypot(ea[k], eb[k])};
        snprintf(m->name, sizeof(m->name), "%s", NAMES[k]);
    }
}

static void plane_means(const bake_readings *map, double mean[2], double se[2])
{
    double sum[2] = {0}, squares[2] = {0};
    for (size_t i = 0; i < map->count; ++i) {
        sum[0] += map->a[i];
        sum[1] += map->b[i];
        squares[0] += map->a_se[i] * map->a_se[i];
        squares[1] += map->b_se[i] * map->b_se[i];
    }
    for (int s = 0; s < 2; ++s) {
        mean[s] = sum[s] / (double)map->count;
        se[s] = sqrt(squares[s]) / (double)map->count;
    }
}

lmg_result evaluate(const measured sides[2], const measured *unmoved, bake_comparison *out, lmg_error *err)
{
    const size_t planes = out->plane_count;
    const char *const no_memory = "no memory for the comparison";
    out->pixels = PIXELS;
    for (size_t i = 0; i < planes; ++i) {
        const bake_readings r = out->planes[i].map = readings_of(&sides[0].of[i], &sides[1].of[i]);
        if (!r.a)
            return lmg_fail(err, LMG_ERROR_MEMORY, "%s", no_memory);
        out->planes[i].difference = bake_differ(r.a, r.a_se, r.b, r.b_se, r.count);
        out->planes[i].unmoved = differ(&unmoved->of[i], &sides[1].of[i]);
        plane_means(&r, out->planes[i].mean, out->planes[i].mean_se);
    }
    out->far_field = differ(&sides[0].of[planes + FAR_FIELD], &sides[1].of[planes + FAR_FIELD]);
    out->far_field_unmoved = differ(&unmoved->of[planes + FAR_FIELD], &sides[1].of[planes + FAR_FIELD]);
    for (size_t v = 0; v < BAKE_VIEWS; ++v) {
        const size_t k = planes + PICTURES + v;
        const bake_readings r = out->views[v].picture = readings_of(&sides[0].of[k], &sides[1].of[k]);
        if (!r.a)
            return lmg_fail(err, LMG_ERROR_MEMORY, "%s", no_memory);
        out->views[v].difference = bake_differ(r.a, r.a_se, r.b, r.b_se, r.count);
    }

    figures *f = calloc(2, sizeof(*f));
    if (!f)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s", no_memory);
    lmg_result result = jackknife_figures(sides, out, &f[0], &f[1], err);
    for (size_t i = 0; result == LMG_OK && i < out->measure_count; ++i) {
        bake_measure *m = &out->measures[i];
        m->a = f[0].measure[i][0], m->a_se = f[1].measure[i][0];
        m->b = f[0].measure[i][1], m->b_se = f[1].measure[i][1];
        m->difference = f[0].measure[i][2], m->difference_se = f[1].measure[i][2];
    }
    if (result == LMG_OK)
        add_focus(out);
    if (result == LMG_OK)
        result = evaluate_distances(&f[0], &f[1], out, err);
    if (result == LMG_OK)
        result = evaluate_profiles(sides, out, err);
    free(f);
    return result;
}

void bake_comparison_release(bake_comparison *c)
{
    for (size_t i = 0; i < BAKE_MAX_DISTANCES; ++i)
        free(c->planes[i].map.a);
    for (size_t i = 0; i < BAKE_VIEWS; ++i)
        free(c->views[i].picture.a);
    for (int s = 0; s < 2; ++s) {
        free(c->deviation[s]);
        free(c->deviation_se[s]);
        free(c->valid_from[s][0]);
        free(c->valid_from[s][1]);
        for (int k = 0; k < 4; ++k)
            free(c->profile[s][k]);
    }
    memset(c, 0, sizeof(*c));
}
