/* SPDX-License-Identifier: Apache-2.0 */
/* Lamps as formulas; see the header.  Geometry in closed form, no meshes. */
#include "lamp_fixture.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

lamp_rng lamp_stream(uint64_t seed, uint64_t number)
{
    return (lamp_rng){(seed * 0x9e3779b97f4a7c15u) ^ (number * 0xd1342543de82ef95u + 0x632be59bd9b4e019u)};
}

double lamp_next(lamp_rng *rng)
{
    uint64_t z = rng->state += 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

static lmg_vec3 vec(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

static lmg_vec3 along(lmg_vec3 o, double t, lmg_vec3 d)
{
    return vec(o.x + t * d.x, o.y + t * d.y, o.z + t * d.z);
}

static double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static lmg_vec3 unit(lmg_vec3 a)
{
    double k = 1 / sqrt(dot(a, a));
    return vec(k * a.x, k * a.y, k * a.z);
}

static lmg_vec3 on_sphere(lamp_rng *g)
{
    double z = 2 * lamp_next(g) - 1, f = 2 * PI * lamp_next(g), s = sqrt(1 - z * z);
    return vec(s * cos(f), s * sin(f), z);
}

/* Cosine-distributed about n: the sum of n and a point on the unit sphere. */
static lmg_vec3 lambert(lamp_rng *g, lmg_vec3 n)
{
    for (;;) {
        lmg_vec3 d = along(n, 1, on_sphere(g));
        if (dot(d, d) > 1e-20)
            return unit(d);
    }
}

const char *lamp_name(lamp kind)
{
    static const char *const names[LAMP_COUNT] = {"disc", "square", "sphere", "bead", "spot", "louvre", "lens"};
    return names[kind];
}

void lamp_bounds(lamp kind, lmg_vec3 *lo, lmg_vec3 *hi)
{
    static const lmg_vec3 low[LAMP_COUNT] = {{-0.05, 0, -0.05}, {0.08, -0.1, -0.6},   {-0.15, -0.15, -0.15}, {-0.2, -0.2, -0.2},
                                             {-0.05, 0, -0.05}, {-0.3, 0, -0.3}, {-0.02, 0, -0.02}};
    static const lmg_vec3 high[LAMP_COUNT] = {{0.05, 0.01, 0.05},    {0.1, 0.5, 0.0},       {0.15, 0.15, 0.15}, {0.2, 0.2, 0.2},
                                              {0.05, 0.03125, 0.05}, {0.3, 0.0375, 0.3}, {0.02, 0.04, 0.02}};
    *lo = low[kind];
    *hi = high[kind];
}

lmg_vec3 lamp_axis(lamp kind)
{
    return kind == LAMP_SQUARE ? vec(1, 0, 0) : kind == LAMP_SPHERE || kind == LAMP_BEAD ? vec(0, 1, 0) : vec(0, -1, 0);
}

static bool spot(lamp_rng *g, lmg_vec3 *o, lmg_vec3 *d)
{
    const double f = 0.02, a = 0.002, focus = 0.01125, apex = 0.03125;
    lmg_vec3 n = on_sphere(g);
    *o = along(vec(0, focus, 0), a, n);
    *d = lambert(g, n);
    /* y = apex - (x^2 + z^2) / 4f */
    double qa = (d->x * d->x + d->z * d->z) / (4 * f), qb = d->y + 2 * (o->x * d->x + o->z * d->z) / (4 * f);
    double qc = o->y - apex + (o->x * o->x + o->z * o->z) / (4 * f);
    double t = qa < 1e-14 ? -qc / qb : (-qb + sqrt(qb * qb - 4 * qa * qc)) / (2 * qa);
    lmg_vec3 hit = along(*o, t, *d);
    if (hit.y < 0)
        return true;
    if (lamp_next(g) > 0.9)
        return false;
    lmg_vec3 m = unit(vec(-hit.x / (2 * f), -1, -hit.z / (2 * f)));
    *d = along(*d, -2 * dot(*d, m), m);
    *o = hit;
    lmg_vec3 w = vec(o->x, o->y - focus, o->z);
    double b = dot(w, *d), c = dot(w, w) - a * a;
    return !(b < 0 && b * b > c); /* the source is in the way */
}

static bool louvre(lamp_rng *g, lmg_vec3 *o, lmg_vec3 *d)
{
    const double depth = 0.0375, cell = 0.075;
    *o = vec(0.6 * (lamp_next(g) - 0.5), depth, 0.6 * (lamp_next(g) - 0.5));
    *d = lambert(g, vec(0, -1, 0));
    lmg_vec3 e = along(*o, -depth / d->y, *d);
    double cx = floor(o->x / cell), cz = floor(o->z / cell);
    if (cx == floor(e.x / cell) && cz == floor(e.z / cell)) {
        *o = e;
        return true;
    }
    *o = vec((cx + lamp_next(g)) * cell, 0, (cz + lamp_next(g)) * cell);
    *d = lambert(g, vec(0, -1, 0));
    return lamp_next(g) < 0.5;
}

static bool try_ray(lamp kind, lamp_rng *g, lmg_vec3 *o, lmg_vec3 *d)
{
    double r, f, q, p;
    switch (kind) {
    case LAMP_DISC:
        r = 0.05 * sqrt(lamp_next(g));
        f = 2 * PI * lamp_next(g);
        *o = vec(r * cos(f), 0, r * sin(f));
        *d = lambert(g, vec(0, -1, 0));
        return d->y < 0;
    case LAMP_SQUARE:
        *o = vec(0.1, 0.2 + 0.6 * (lamp_next(g) - 0.5), -0.3 + 0.6 * (lamp_next(g) - 0.5));
        *d = lambert(g, vec(1, 0, 0));
        return d->x > 0;
    case LAMP_SPHERE:
        *o = on_sphere(g);
        *d = lambert(g, *o);
        *o = vec(0.15 * o->x, 0.15 * o->y, 0.15 * o->z);
        return true;
    case LAMP_BEAD:
        *o = on_sphere(g);
        *d = lambert(g, *o);
        *o = along(vec(0.1, 0.05, -0.07), 0.01, *o);
        return true;
    case LAMP_SPOT:
        return spot(g, o, d) && d->y < 0;
    case LAMP_LOUVRE:
        return louvre(g, o, d) && d->y < 0;
    default:
        if (lamp_next(g) < 0.05) {
            *o = vec(0, 0.02, 0);
            *d = on_sphere(g);
            return true;
        }
        r = 0.02 * sqrt(lamp_next(g));
        f = 2 * PI * lamp_next(g);
        q = 0.0025 * sqrt(lamp_next(g));
        p = 2 * PI * lamp_next(g);
        *o = vec(r * cos(f), 0, r * sin(f));
        *d = unit(vec(-q * cos(p), -0.02, -q * sin(p)));
        return true;
    }
}

lmg_ray lamp_ray(lamp kind, uint64_t seed, uint64_t number)
{
    lamp_rng g = lamp_stream(seed * LAMP_COUNT + (uint64_t)kind, number);
    lmg_ray ray = {.flux = {1, 1, 1}, .number = number};
    while (!try_ray(kind, &g, &ray.origin, &ray.direction)) {
    }
    return ray;
}

lmg_ray *lamp_rays(lamp kind, uint64_t seed, uint64_t first, size_t count)
{
    lmg_ray *rays = malloc(count * sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < count; i++)
        rays[i] = lamp_ray(kind, seed, first + i);
    return rays;
}

lmg_layout lamp_layout(lamp kind, const lmg_fit_options *wishes)
{
    enum { PILOT = 100000 };
    lmg_fit_options o = {0};
    if (wishes)
        o = *wishes;
    o.struct_size = sizeof o;
    lamp_bounds(kind, &o.bounds_min, &o.bounds_max);
    lmg_ray *pilot = lamp_rays(kind, 987654321, 0, PILOT);
    lmg_layout layout;
    lmg_error err = {{0}};
    if (lmg_layout_fit(pilot, PILOT, &o, &layout, NULL, &err) != LMG_OK)
        fail_msg("%s: %s", lamp_name(kind), err.message);
    free(pilot);
    return layout;
}

lmg_field *lamp_field(lamp kind, uint64_t seed, size_t count, const lmg_fit_options *wishes)
{
    lmg_layout layout = lamp_layout(kind, wishes);
    lmg_accumulator *acc;
    lmg_field *field;
    assert_int_equal(lmg_accumulator_create(&layout, &acc, NULL), LMG_OK);
    enum { BATCH = 4096 };
    for (size_t i = 0; i < count; i += BATCH) {
        size_t n = count - i < BATCH ? count - i : BATCH;
        lmg_ray *rays = lamp_rays(kind, seed, i, n);
        lmg_accumulator_deposit(acc, rays, n);
        free(rays);
    }
    assert_int_equal(lmg_field_reconstruct(acc, 1.0 / (double)count, NULL, &field, NULL), LMG_OK);
    lmg_accumulator_destroy(acc);
    return field;
}
