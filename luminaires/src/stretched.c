/* SPDX-License-Identifier: Apache-2.0 */
/* The albedo of stretched facets (stretched.h). */
#include "stretched.h"

#include <stdlib.h>

/* Four points and weights of a cubic through n equally spaced values (n = 1: the only one), x in [0, n - 1].  Even ends continue as
 * their mirror image. */
typedef struct cubic4 {
    int at[4];
    double w[4];
} cubic4;

static cubic4 cubic_weights(double x, int n, bool even_low, bool even_high)
{
    cubic4 r = {{0, 0, 0, 0}, {1, 0, 0, 0}};
    if (n == 1) {
        return r;
    }
    int i = (int)x;
    i = i < n - 2 ? i : n - 2;
    i = i < 1 && !even_low ? 1 : i > n - 3 && !even_high ? n - 3 : i;
    double t = x - i;
    r.w[0] = -t * (t - 1) * (t - 2) / 6;
    r.w[1] = (t + 1) * (t - 1) * (t - 2) / 2;
    r.w[2] = -(t + 1) * t * (t - 2) / 2;
    r.w[3] = (t + 1) * t * (t - 1) / 6;
    for (int k = 0; k < 4; k++) {
        int j = abs(i - 1 + k);
        r.at[k] = j < n ? j : 2 * (n - 1) - j;
    }
    return r;
}

/* 1 - E at v by visible normals on a Fibonacci lattice, as in microfacet.c. */
static double compute_rest(double ax, double ay, lmg_vec3 v, bool many)
{
    uint32_t points = many ? 10946 : 987, before = many ? 6765 : 610;
    facets f = {.wi = vec_unit(vec(v.x / ax, v.y / ay, v.z)), .ax = ax, .ay = ay};
    f.b = facets_b(&f, f.wi);
    double sum = 0;
    for (uint32_t i = 0; i < points; i++) {
        facet h = facets_sample(&f, (double)((uint64_t)i * before % points) / points, (i + 0.5) / points);
        lmg_vec3 o = facet_reflected(&f, &h);
        if (o.z > 0) {
            sum += o.z * (f.wi.z + f.b) / (o.z * f.b + f.wi.z * facets_b(&f, o));
        }
    }
    return 1 - sum / points;
}

static double interpolated(const lum_stretched *t, const cubic4 *height, const cubic4 *azimuth)
{
    double sum = 0;
    for (int i = 0; i < 4; i++) {
        const float *row = t->rest[height->at[i]];
        double s = 0;
        for (int j = 0; j < 4; j++) {
            s += azimuth->w[j] * (double)row[azimuth->at[j]];
        }
        sum += height->w[i] * s;
    }
    return sum;
}

static void place(const facets *f, cubic4 *height, cubic4 *azimuth)
{
    double z = f->wi.z / f->b, x = fabs(f->ax * f->wi.x), y = fabs(f->ay * f->wi.y);
    z = z < 1 ? z > 0 ? z : 0 : 1;
    double turn = x > 0 || y > 0 ? atan2(y, x) / (0.5 * LUM_PI) : 0;
    *height = cubic_weights(sqrt(z) * (LUM_STRETCHED_HEIGHTS - 1), LUM_STRETCHED_HEIGHTS, false, false);
    *azimuth = cubic_weights(turn * (LUM_STRETCHED_AZIMUTHS - 1), LUM_STRETCHED_AZIMUTHS, true, true);
}

static void fill(lum_stretched *t, double across, double strength, bool many)
{
    enum { RINGS = 64, SECTORS = 32 };
    facets f = {.ax = fmax(across + (1 - across) * strength * strength, (double)LUM_SMOOTH),
                .ay = fmax(across, (double)LUM_SMOOTH)};
    for (int i = 0; i < LUM_STRETCHED_HEIGHTS; i++) {
        /* At 0 the limit, taken a little above it. */
        double u = fmax((double)i / (LUM_STRETCHED_HEIGHTS - 1), 1e-3), z = u * u, r = sqrt((1 - z) * (1 + z));
        for (int j = 0; j < LUM_STRETCHED_AZIMUTHS; j++) {
            double s, c;
            sincos_turns(0.25 * j / (LUM_STRETCHED_AZIMUTHS - 1), &s, &c);
            t->rest[i][j] = (float)fmin(fmax(compute_rest(f.ax, f.ay, vec(r * c, r * s, z), many), 1e-9), 1);
        }
    }
    /* Over a quarter of the directions; with the squared cosine as x^2, as the share is steep at grazing angles: dq = 2 x dx. */
    double sum = 0;
    for (int i = 0; i < RINGS; i++) {
        double x = (i + 0.5) / RINGS, r = sqrt((1 - x * x) * (1 + x * x));
        for (int j = 0; j < SECTORS; j++) {
            double s, c;
            cubic4 height, azimuth;
            sincos_turns(0.25 * (j + 0.5) / SECTORS, &s, &c);
            double z = x * x;
            f.wi = vec(r * c, r * s, z);
            f.b = facets_b(&f, f.wi);
            place(&f, &height, &azimuth);
            sum += 4 * x * x * x * interpolated(t, &height, &azimuth); /* 2 z dz */
        }
    }
    t->total = (float)(sum / (RINGS * SECTORS));
}

const lum_stretched_set *lum_stretched_find(lum_table_store *store, float roughness, float strength, bool *failed)
{
    for (const lum_table_store *from = store; from; from = from->like) {
        for (size_t i = 0; i < from->stretched_count; i++) {
            if (from->stretched[i]->roughness == roughness && from->stretched[i]->strength == strength) {
                return from->stretched[i];
            }
        }
    }
    int a = roughness < 0 ? LUM_STRETCHED_ROUGHNESSES : 1, b = strength < 0 ? LUM_STRETCHED_ROUGHNESSES : 1;
    lum_stretched_set *set = malloc(sizeof *set + (size_t)(a * b) * sizeof set->sets[0]);
    lum_stretched_set **sets = realloc(store->stretched, (store->stretched_count + 1) * sizeof *sets);
    if (sets) {
        store->stretched = sets;
    }
    if (!set || !sets) {
        free(set);
        *failed = true;
        return NULL;
    }
    sets[store->stretched_count++] = set;
    *set = (lum_stretched_set){roughness, strength, a, b};
    for (int i = 0; i < a; i++) {
        double r = a > 1 ? (double)i / (a - 1) : (double)roughness;
        for (int j = 0; j < b; j++) {
            fill(&set->sets[i * b + j], r * r, b > 1 ? (double)j / (b - 1) : (double)strength, a * b == 1);
        }
    }
    return set;
}

double lum_stretched_rest(const lum_stretched_set *set, const facets *f, double *total)
{
    double across = fmin(f->ay, 1), strength = across < 1 ? sqrt(fmin(fmax((f->ax - across) / (1 - across), 0), 1)) : 0, rest = 0;
    cubic4 height, azimuth;
    cubic4 r = cubic_weights(sqrt(across) * (set->roughnesses - 1), set->roughnesses, true, false);
    cubic4 s = cubic_weights(strength * (set->strengths - 1), set->strengths, true, false);
    place(f, &height, &azimuth);
    *total = 0;
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            double w = r.w[i] * s.w[j];
            if (w != 0) {
                const lum_stretched *t = &set->sets[r.at[i] * set->strengths + s.at[j]];
                rest += w * interpolated(t, &height, &azimuth);
                *total += w * (double)t->total;
            }
        }
    }
    *total = fmax(*total, 1e-9);
    return fmin(fmax(rest, 1e-9), 1);
}
