/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Rays of a far-field distribution.  A cell of the grid is drawn by its exact flux (binary search in running sums), a direction in
 * it by rejection from the uniform distribution over its solid angle, then one of the mirror images: the density is the
 * interpolated intensity over the flux, with no error of its own.
 */
#include "photometry_file.h"

#include "text.h"

#include <math.h>
#include <stdlib.h>

static const double DEGREE = 3.14159265358979323846 / 180;

struct lum_profile {
    lum_photometry *p;
    uint32_t cells_v;
    size_t cells;
    double *running; /* flux of cells 0 .. i, lumens of the stored sector */
    double flux;
};

lmg_result lum_profile_create(const lum_photometry *p, lum_profile **out, lmg_error *err)
{
    *out = NULL;
    LUM_TRY(lum_photometry_check(p, err));
    lum_profile *f = calloc(1, sizeof *f);
    if (!f)
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a profile");
    lmg_result result = lum_photometry_copy(p, &f->p, err);
    if (result == LMG_OK) {
        f->cells_v = p->v_count - 1;
        f->cells = (size_t)lum_grid_h_cells(p) * f->cells_v;
        f->running = malloc(f->cells * sizeof *f->running);
        if (!f->running)
            result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a profile of %zu cells", f->cells);
    }
    if (result == LMG_OK) {
        double sum = 0;
        for (size_t i = 0; i < f->cells; i++)
            f->running[i] = sum += lum_grid_cell_flux(p, (uint32_t)(i / f->cells_v), (uint32_t)(i % f->cells_v));
        f->flux = sum * lum_grid_copies(p);
        if (!(f->flux > 0))
            result = lmg_fail(err, LMG_ERROR_INPUT, "the distribution holds no light");
    }
    if (result != LMG_OK) {
        lum_profile_destroy(f);
        return result;
    }
    *out = f;
    return LMG_OK;
}

void lum_profile_destroy(lum_profile *profile)
{
    if (!profile)
        return;
    lum_photometry_destroy(profile->p);
    free(profile->running);
    free(profile);
}

double lum_profile_flux(const lum_profile *profile)
{
    return profile->flux;
}

double lum_profile_intensity(const lum_profile *profile, lmg_vec3 direction)
{
    return lum_photometry_intensity(profile->p, direction);
}

/* An angle between x0 and x1 (degrees from a pole) whose cosine is uniformly distributed, and how far it is on the way.  Near the
 * pole through the half angle, where 1 - cos would lose digits. */
static double between(double x0, double x1, double u, double *t)
{
    const double s0 = sin(0.5 * x0 * DEGREE), s1 = sin(0.5 * x1 * DEGREE);
    const double s = sqrt(s0 * s0 + u * (s1 * s1 - s0 * s0));
    const double x = fmin(fmax(2 * asin(fmin(s, 1)) / DEGREE, x0), x1);
    *t = (x - x0) / (x1 - x0);
    return x;
}

lmg_vec3 lum_profile_direction(const lum_profile *profile, double (*next)(void *state), void *state)
{
    const lum_photometry *p = profile->p;
    const double x = next(state) * profile->running[profile->cells - 1];
    size_t low = 0, high = profile->cells - 1;
    while (low < high) { /* the first cell whose running sum exceeds x: never one without light */
        const size_t middle = low + (high - low) / 2;
        if (profile->running[middle] > x)
            high = middle;
        else
            low = middle + 1;
    }
    const uint32_t i = (uint32_t)(low / profile->cells_v), j = (uint32_t)(low % profile->cells_v);
    double h0, h1, s, t, h, v;
    uint32_t a, b;
    lum_grid_h_cell(p, i, &h0, &h1, &a, &b);
    const double v0 = p->v[j], v1 = p->v[j + 1];
    const double *ra = p->intensity + (size_t)a * p->v_count + j, *rb = p->intensity + (size_t)b * p->v_count + j;
    const double bound = fmax(fmax(ra[0], ra[1]), fmax(rb[0], rb[1]));
    do {
        if (p->type == LUM_TYPE_B) {
            h = between(h0 + 90, h1 + 90, next(state), &s) - 90;
            t = next(state);
            v = v0 + t * (v1 - v0);
        } else {
            const double from = p->type == LUM_TYPE_A ? 90 : 0;
            v = between(v0 + from, v1 + from, next(state), &t) - from;
            s = next(state);
            h = h0 + s * (h1 - h0);
        }
    } while (next(state) * bound >= (1 - s) * ((1 - t) * ra[0] + t * ra[1]) + s * ((1 - t) * rb[0] + t * rb[1]));
    switch (p->symmetry) {
    case LUM_SYMMETRY_C0_C180:
    case LUM_SYMMETRY_LATERAL:
        h = next(state) < 0.5 ? -h : h;
        break;
    case LUM_SYMMETRY_C90_C270:
        h = next(state) < 0.5 ? 180 - h : h;
        break;
    case LUM_SYMMETRY_QUADRANT:
        h = next(state) < 0.5 ? -h : h;
        h = next(state) < 0.5 ? 180 - h : h;
        break;
    default:
        break;
    }
    return lum_grid_direction(p, h, v);
}
