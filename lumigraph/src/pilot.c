/* SPDX-License-Identifier: Apache-2.0 */
/* Pilot rays made ready for the fit of a layout, and their statistics.  Relies on geometry.h for direction classes. */
#include "pilot.h"

#include "geometry.h"

#include <stdlib.h>
#include <string.h>

/* Pilot rays that the search looks at; more don't change its choices, they only take time. */
enum { SEARCH_RAYS = 100000 };

void lmg_class_frame(int c, lmg_vec3 *a, lmg_vec3 *b, lmg_vec3 *n)
{
    static const lmg_vec3 unit[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, minus[3] = {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
    int axis = c / 2;
    *n = c % 2 ? minus[axis] : unit[axis];
    *a = unit[(axis + 1) % 3];
    *b = c % 2 ? minus[(axis + 2) % 3] : unit[(axis + 2) % 3];
}

const char *lmg_class_name(int c)
{
    static const char *const names[6] = {"+x", "-x", "+y", "-y", "+z", "-z"};
    return names[c];
}

/* The value below which a share `tail` of the weight lies: bins between least and most, then finer bins in the one that holds it, until
 * the interval is a 2^-40th.  Several times faster than sorting. */
static double quantile(const double *x, const double *w, size_t n, double tail, double least, double most)
{
    enum { STEPS = 256 };
    double total = 0, below = 0, lo = least, hi = most;
    for (size_t i = 0; i < n; i++)
        total += w[i];
    for (int round = 0; round < 5 && hi > lo; round++) {
        double bins[STEPS] = {0}, scale = STEPS / (hi - lo);
        for (size_t i = 0; i < n; i++)
            if (x[i] >= lo && x[i] <= hi) {
                int k = (int)((x[i] - lo) * scale);
                bins[k < STEPS ? k : STEPS - 1] += w[i];
            }
        int k = 0;
        while (k + 1 < STEPS && below + bins[k] <= tail * total)
            below += bins[k++];
        double step = (hi - lo) / STEPS;
        hi = k + 1 == STEPS ? hi : lo + (k + 1) * step;
        lo = lo + k * step;
        /* the first bin of the next round starts where this one does: what is below stays counted */
    }
    return 0.5 * (lo + hi);
}

lmg_interval lmg_quantiles(const double *x, const double *w, size_t n, double tail)
{
    lmg_interval r = {0, 0, INFINITY, -INFINITY};
    for (size_t i = 0; i < n; i++) {
        r.least = fmin(r.least, x[i]);
        r.most = fmax(r.most, x[i]);
    }
    r.lo = quantile(x, w, n, tail, r.least, r.most);
    r.hi = quantile(x, w, n, 1 - tail, r.least, r.most);
    return r;
}

void lmg_pilot_destroy(lmg_pilot *pl)
{
    free(pl->origin);
    free(pl->direction);
    free(pl->flux);
    free(pl->class);
    free(pl->taken);
    free(pl->jitter);
    free(pl->x);
    free(pl->w);
}

static double uniform(uint64_t i)
{
    uint64_t z = (i + 1) * 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

static bool usable(const lmg_ray *r)
{
    double y = lmg_luminance(r->flux);
    return y > 0 && isfinite(y) && v_finite(r->origin) && v_finite(r->direction) && lmg_direction_class(r->direction) >= 0;
}

lmg_result lmg_pilot_create(lmg_pilot *pl, const lmg_ray *rays, size_t count, lmg_error *err)
{
    size_t good = 0;
    for (size_t i = 0; i < count; i++)
        good += usable(&rays[i]);
    if (!good)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: none of the %zu pilot rays carries light", count);
    const size_t stride = good / SEARCH_RAYS ? good / SEARCH_RAYS : 1;
    size_t room = good / stride + 1;
    pl->origin = malloc(room * sizeof *pl->origin);
    pl->direction = malloc(room * sizeof *pl->direction);
    pl->flux = malloc(room * sizeof *pl->flux);
    pl->class = malloc(room);
    pl->taken = calloc(room, sizeof *pl->taken);
    pl->jitter = malloc(room * sizeof *pl->jitter);
    pl->x = malloc(room * sizeof *pl->x);
    pl->w = malloc(room * sizeof *pl->w);
    if (!pl->origin || !pl->direction || !pl->flux || !pl->class || !pl->taken || !pl->jitter || !pl->x || !pl->w)
        return lmg_fail(err, LMG_ERROR_MEMORY, "layout: no memory for %zu pilot rays", room);
    for (size_t i = 0, k = 0; i < count; i++) {
        if (!usable(&rays[i]) || k++ % stride)
            continue;
        size_t m = pl->count++;
        pl->origin[m] = rays[i].origin;
        pl->direction[m] = v_scale(1 / v_length(rays[i].direction), rays[i].direction);
        pl->flux[m] = lmg_luminance(rays[i].flux);
        pl->class[m] = (uint8_t)lmg_direction_class(rays[i].direction);
        for (uint64_t c = 0; c < 4; c++)
            pl->jitter[m][c] = (float)uniform(4 * m + c);
        pl->total += pl->flux[m];
    }
    /* the light's own box: 99 % of the origins, within the bounds */
    double lo[3], hi[3];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < pl->count; i++) {
            pl->x[i] = d_clamp(v_axis(pl->origin[i], axis), v_axis(pl->lo, axis), v_axis(pl->hi, axis));
            pl->w[i] = pl->flux[i];
        }
        lmg_interval q = lmg_quantiles(pl->x, pl->w, pl->count, 0.005);
        lo[axis] = q.lo;
        hi[axis] = q.hi;
    }
    pl->light_lo = (lmg_vec3){lo[0], lo[1], lo[2]};
    pl->light_hi = (lmg_vec3){hi[0], hi[1], hi[2]};
    return LMG_OK;
}

/* One colour for all rays?  colour: that of the sum, at luminance 1.  Float rounding of a product: a few 2^-24. */
bool lmg_one_colour(const lmg_ray *rays, size_t count, float colour[3])
{
    double sum[3] = {0};
    for (size_t i = 0; i < count; i++)
        for (int c = 0; c < 3 && usable(&rays[i]); c++)
            sum[c] += (double)rays[i].flux[c];
    double y = 0.2126 * sum[0] + 0.7152 * sum[1] + 0.0722 * sum[2];
    for (int c = 0; c < 3; c++)
        colour[c] = (float)(sum[c] / y);
    for (size_t i = 0; i < count; i++) {
        double yi = lmg_luminance(rays[i].flux);
        for (int c = 0; c < 3 && usable(&rays[i]); c++)
            if (fabs((double)rays[i].flux[c] - yi * sum[c] / y) > 1e-6 * yi)
                return false;
    }
    return true;
}
