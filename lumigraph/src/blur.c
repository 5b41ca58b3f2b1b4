/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What cells do to illuminance, noise left out: each pilot ray is moved to a random place in its own cell (that is what a cell does to
 * light), and the illuminance on planes before and after is compared.  Half A's differences times half B's, summed over the planes' pixels,
 * have the squared error as their mean, because the noise of the halves is independent.  All candidates use the same random numbers, so that
 * they differ by what the cells do.  Relies on geometry.h for coordinates.
 */
#include "blur.h"

#include "geometry.h"

#include <stdlib.h>
#include <string.h>

static const double PLANE_DISTANCE[PLANES] = {0.5, 1, 2, 5};
/* Errors of illuminance below 0.1 % are good enough: nothing is gained by telling them apart. */
static const double GOOD_ENOUGH = 0.001 * 0.001;

static int pixel_of(const lmg_planes *p, int k, lmg_vec3 o, lmg_vec3 d)
{
    double dn = v_dot(d, p->n);
    if (!(dn > 0))
        return -1;
    double t = (p->start + p->reach[k] - v_dot(o, p->n)) / dn, scale = PIXELS / (2 * p->half[k]);
    double x = (v_dot(o, p->a) + t * v_dot(d, p->a) - p->ca + p->half[k]) * scale;
    double y = (v_dot(o, p->b) + t * v_dot(d, p->b) - p->cb + p->half[k]) * scale;
    return x >= 0 && x < PIXELS && y >= 0 && y < PIXELS ? (int)y * PIXELS + (int)x : -1;
}

bool lmg_planes_create(lmg_planes *p, const lmg_pilot *pl, int c)
{
    *p = (lmg_planes){0};
    lmg_class_frame(c, &p->a, &p->b, &p->n);
    lmg_vec3 mid = v_scale(0.5, v_add(pl->light_lo, pl->light_hi)), half = v_scale(0.5, v_sub(pl->light_hi, pl->light_lo));
    p->start = v_dot(mid, p->n) + fabs(v_dot(half, p->n));
    p->ca = v_dot(mid, p->a);
    p->cb = v_dot(mid, p->b);
    p->pixel = malloc(pl->count * sizeof *p->pixel);
    p->change = malloc(PLANES * sizeof *p->change);
    p->variance = malloc(PLANES * sizeof *p->variance);
    if (!p->pixel || !p->change || !p->variance)
        return false;
    memset(p->change, 0, PLANES * sizeof *p->change);
    for (int k = 0; k < PLANES; k++) {
        p->reach[k] = PLANE_DISTANCE[k] * pl->size;
        p->half[k] = (PLANE_DISTANCE[k] + 0.5) * pl->size;
        for (size_t i = 0; i < pl->count; i++) {
            int px = pixel_of(p, k, pl->origin[i], pl->direction[i]);
            p->pixel[i][k] = (int16_t)px;
            if (px >= 0)
                p->change[k][pl->half[i]][px] += (float)pl->flux[i];
        }
        for (int i = 0; i < PIXELS * PIXELS; i++)
            p->energy[k] += (double)p->change[k][0][i] * (double)p->change[k][1][i];
    }
    return true;
}

void lmg_planes_destroy(lmg_planes *p)
{
    free(p->pixel);
    free(p->change);
    free(p->variance);
}
bool lmg_better(lmg_verdict x, lmg_verdict than, double gain)
{
    return x.error < than.error * gain && than.error - x.error > 3 * fmax(x.se, than.se);
}
lmg_verdict lmg_measure_blur(const lmg_pilot *pl, lmg_planes *p, const lmg_slab *slabs, uint32_t slab_count, int class)
{
    memset(p->change, 0, PLANES * sizeof *p->change);
    memset(p->variance, 0, PLANES * sizeof *p->variance);
    double scale[LMG_MAX_SLABS][4];
    for (uint32_t j = 0; j < slab_count; j++) {
        const lmg_slab *s = &slabs[j];
        scale[j][0] = s->nu / (s->u1 - s->u0);
        scale[j][1] = s->nv / (s->v1 - s->v0);
        scale[j][2] = s->ns / (s->s1 - s->s0);
        scale[j][3] = s->nt / (s->t1 - s->t0);
    }
    for (size_t i = 0; i < pl->count; i++) {
        if (class >= 0 && pl->class[i] != class)
            continue;
        double x[4];
        for (uint32_t j = 0; j < slab_count; j++) {
            const lmg_slab *s = &slabs[j];
            if (!lmg_slab_coordinates(s, pl->origin[i], pl->direction[i], x))
                continue;
            const double low[4] = {s->u0, s->v0, s->s0, s->t0};
            for (int k = 0; k < 4; k++)
                x[k] = low[k] + (floor((x[k] - low[k]) * scale[j][k]) + (double)pl->jitter[i][k]) / scale[j][k];
            lmg_vec3 o, d;
            lmg_slab_ray(s, x, &o, &d);
            for (int k = 0; k < PLANES; k++) {
                int before = p->pixel[i][k], after = pixel_of(p, k, o, d);
                if (before == after)
                    continue;
                float w = (float)pl->flux[i];
                if (before >= 0) {
                    p->change[k][pl->half[i]][before] -= w;
                    p->variance[k][pl->half[i]][before] += w * w;
                }
                if (after >= 0) {
                    p->change[k][pl->half[i]][after] += w;
                    p->variance[k][pl->half[i]][after] += w * w;
                }
            }
            break;
        }
    }
    /* Independent a, b of one mean m and variances va, vb: Var[a b] = va vb + m^2 (va + vb), with m^2 estimated by a b. */
    double sum = 0, variance = 0;
    int used = 0;
    for (int k = 0; k < PLANES; k++) {
        if (!(p->energy[k] > 0))
            continue;
        for (int i = 0; i < PIXELS * PIXELS; i++) {
            double e = (double)p->change[k][0][i] * (double)p->change[k][1][i];
            double va = (double)p->variance[k][0][i], vb = (double)p->variance[k][1][i];
            sum += e / p->energy[k];
            variance += (va * vb + fmax(e, 0) * (va + vb)) / (p->energy[k] * p->energy[k]);
        }
        used++;
    }
    return used ? (lmg_verdict){fmax(sum / used, GOOD_ENOUGH), sqrt(variance) / used} : (lmg_verdict){GOOD_ENOUGH, 0};
}
