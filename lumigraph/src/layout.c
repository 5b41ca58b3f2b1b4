/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fits a layout to pilot rays.  Relies on geometry.h for coordinates.
 */
#include "field.h"
#include "geometry.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Right-handed frame of a direction class: n along the axis, a and b the next two (so that a x b = n). */
static void class_frame(int c, lmg_vec3 *a, lmg_vec3 *b, lmg_vec3 *n)
{
    static const lmg_vec3 unit[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    int axis = c / 2;
    *n = v_scale(c % 2 ? -1 : 1, unit[axis]);
    *a = unit[(axis + 1) % 3];
    *b = v_scale(c % 2 ? -1 : 1, unit[(axis + 2) % 3]);
}

/* A cube slab through the middle of the bounds that holds every line of its class through the bounds. */
static lmg_slab catch_all(int c, lmg_vec3 lo, lmg_vec3 hi, uint32_t resolution)
{
    lmg_slab s = {.kind = LMG_SLAB_CUBE, .distance = INFINITY, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
    class_frame(c, &s.a, &s.b, &s.n);
    s.o = v_scale(0.5, v_add(lo, hi));
    lmg_vec3 half = v_scale(0.5, v_sub(hi, lo));
    double depth = fabs(v_dot(half, s.n)), margin = 1e-6 * v_length(half);
    s.u1 = fabs(v_dot(half, s.a)) + depth + margin;
    s.v1 = fabs(v_dot(half, s.b)) + depth + margin;
    s.u0 = -s.u1;
    s.v0 = -s.v1;
    s.nu = s.nv = s.ns = s.nt = resolution;
    return s;
}

typedef struct value_weight {
    double x, w;
} value_weight;

static int by_value(const void *p, const void *q)
{
    double a = ((const value_weight *)p)->x, b = ((const value_weight *)q)->x;
    return (a > b) - (a < b);
}

/* The interval without a share `tail` of the weight at either end. */
static void quantiles(value_weight *v, size_t n, double tail, double *lo, double *hi)
{
    qsort(v, n, sizeof *v, by_value);
    double total = 0, sum = 0;
    for (size_t i = 0; i < n; i++)
        total += v[i].w;
    size_t i = 0, k = n - 1;
    while (i + 1 < n && sum + v[i].w <= tail * total)
        sum += v[i++].w;
    sum = 0;
    while (k > i && sum + v[k].w <= tail * total)
        sum += v[k--].w;
    *lo = v[i].x;
    *hi = v[k].x;
}

lmg_result lmg_layout_fit(const lmg_ray *rays, size_t count, const lmg_fit_options *options, lmg_layout *out, char report[1024],
                          lmg_error *err)
{
    if (!rays || !count || !options || !out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: no pilot rays");
    *out = (lmg_layout){.channels = options->channels ? options->channels : 3, .colour = {1, 1, 1}};
    lmg_vec3 lo = options->bounds_min, hi = options->bounds_max;
    if (!v_finite(lo) || !v_finite(hi) || !(lo.x <= hi.x && lo.y <= hi.y && lo.z <= hi.z) || v_length(v_sub(hi, lo)) == 0)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the bounds are empty");
    double pad = 1e-6 * v_length(v_sub(hi, lo));
    lo = v_sub(lo, (lmg_vec3){pad, pad, pad});
    hi = v_add(hi, (lmg_vec3){pad, pad, pad});
    out->bounds_min = lo;
    out->bounds_max = hi;
    double flux[6] = {0}, total = 0;
    for (size_t i = 0; i < count; i++) {
        int c = lmg_direction_class(rays[i].direction);
        if (c >= 0)
            flux[c] += lmg_luminance(rays[i].flux);
        total += lmg_luminance(rays[i].flux);
    }
    int best = 0;
    for (int c = 1; c < 6; c++)
        if (flux[c] > flux[best])
            best = c;
    value_weight *u = malloc(count * sizeof *u), *v = malloc(count * sizeof *v);
    if (!u || !v) {
        free(u);
        free(v);
        return lmg_fail(err, LMG_ERROR_MEMORY, "layout: no memory");
    }
    double forward = 0;
    lmg_vec3 axis, aa, bb;
    class_frame(best, &aa, &bb, &axis);
    for (size_t i = 0; i < count; i++)
        if (v_dot(rays[i].direction, axis) > 0)
            forward += lmg_luminance(rays[i].flux);
    bool aperture = options->choice == LMG_LAYOUT_APERTURE || (options->choice == LMG_LAYOUT_AUTO && forward > 0.98 * total);
    uint64_t cells = options->cells ? options->cells : 4000000;
    for (int c = aperture ? best : 0; c <= (aperture ? best : 5); c++) {
        lmg_slab s = {.kind = aperture ? LMG_SLAB_APERTURE : LMG_SLAB_CUBE, .distance = INFINITY, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
        class_frame(c, &s.a, &s.b, &s.n);
        s.o = v_scale(0.5, v_add(lo, hi));
        double depth = aperture ? fabs(v_dot(v_scale(0.5, v_sub(hi, lo)), s.n)) : 0;
        s.o = v_fma(s.o, depth, s.n);
        size_t n = 0;
        for (size_t i = 0; i < count; i++) {
            double dn = v_dot(rays[i].direction, s.n);
            if (!(dn > 0) || (!aperture && lmg_direction_class(rays[i].direction) != c))
                continue;
            lmg_slab_crossing(&s, rays[i].origin, rays[i].direction, dn, &u[n].x, &v[n].x);
            u[n].w = v[n].w = lmg_luminance(rays[i].flux);
            n++;
        }
        if (!n)
            continue;
        quantiles(u, n, 5e-5, &s.u0, &s.u1);
        quantiles(v, n, 5e-5, &s.v0, &s.v1);
        double mu = 0.005 * (s.u1 - s.u0) + pad, mv = 0.005 * (s.v1 - s.v0) + pad;
        s.u0 -= mu;
        s.u1 += mu;
        s.v0 -= mv;
        s.v1 += mv;
        uint32_t res = (uint32_t)pow((double)cells / (aperture ? 1 : 6), 0.25);
        s.nu = s.nv = s.ns = s.nt = res ? res : 1;
        out->size = fmax(out->size, hypot(s.u1 - s.u0, s.v1 - s.v0));
        out->slabs[out->slab_count++] = s;
    }
    free(u);
    free(v);
    for (int c = 0; c < 6; c++)
        out->slabs[out->slab_count++] = catch_all(c, lo, hi, 6);
    if (report)
        snprintf(report, 1024, "%s layout, %.1f %% of the flux in the opening's direction\n", aperture ? "aperture" : "cube", 100 * forward / total);
    return lmg_layout_check(out, err);
}
