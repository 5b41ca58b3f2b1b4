/* SPDX-License-Identifier: Apache-2.0 */
/* Slopes of radiance within cells, from the cells around; what they mean stands in slopes.h. */
#include "slopes.h"

#include "memory.h"
#include "sampler.h"

#include <stdlib.h>

/* Largest sum of two slopes before they are rounded to 127ths, which adds at most (1 + 1/2) / 127: centroids are within 1/2 of the middle.
 * So a shape never falls to zero. */
static const double LIMIT = 125.0 / 127;

/* Whether cell i of n on [lo,hi] has something in common with [from,to]; a share below 1e-9 is the rounding of a common border. */
static bool touches(double lo, double hi, uint32_t n, uint32_t i, double from, double to)
{
    double step = (hi - lo) / n, a = lo + step * i, b = a + step;
    return d_min(b, to) - d_max(a, from) > 1e-9 * step;
}

/* Which cells aren't wholly the slab's own.  A slab above it in the same frame covers those where all four intervals touch; elsewhere the
 * shares of etendue tell. */
typedef struct covered {
    bool any;
    uint8_t *axis[4]; /* for each index whether it touches; one allocation */
    const float *share; /* NULL: all of every cell */
} covered;

static bool covered_create(covered *c, const lmg_slab *slab, const lmg_slab *by)
{
    const double lo[4] = {slab->u0, slab->v0, slab->s0, slab->t0}, hi[4] = {slab->u1, slab->v1, slab->s1, slab->t1};
    const uint32_t n[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
    *c = (covered){.any = by != NULL};
    if (!by)
        return true;
    const double from[4] = {by->u0, by->v0, by->s0, by->t0}, to[4] = {by->u1, by->v1, by->s1, by->t1};
    uint8_t *at = malloc((size_t)n[0] + n[1] + n[2] + n[3]);
    if (!at)
        return false;
    for (int k = 0; k < 4; at += n[k++]) {
        c->axis[k] = at;
        for (uint32_t i = 0; i < n[k]; i++)
            at[i] = touches(lo[k], hi[k], n[k], i, from[k], to[k]);
    }
    return true;
}

/* Of a cell with light: whether some of it is somebody else's. */
static inline bool is_cut(const covered *c, const uint32_t i[4], uint64_t cell)
{
    return (c->any && c->axis[0][i[0]] && c->axis[1][i[1]] && c->axis[2][i[2]] && c->axis[3][i[3]]) || (c->share && c->share[cell] != 1);
}

/* Of any cell: whether all of it is, so that its number says nothing of the light there. */
static inline bool is_covered(const covered *c, const uint32_t i[4], uint64_t cell)
{
    return (c->any && c->axis[0][i[0]] && c->axis[1][i[1]] && c->axis[2][i[2]] && c->axis[3][i[3]]) || (c->share && c->share[cell] == 0);
}

/* Centroid in etendue of each (s,t) cell of slopes, du dv dp dq / (1+p^2+q^2)^2, by Gauss' rule of 4 x 4 points on pieces of at most 1/8:
 * the weight's scale is 1. */
static void centroids(const lmg_slab *slab, float (*out)[2])
{
    static const double X[4] = {-0.86113631159405258, -0.33998104358485626, 0.33998104358485626, 0.86113631159405258};
    static const double W[4] = {0.34785484513745386, 0.65214515486254614, 0.65214515486254614, 0.34785484513745386};
    double ds = (slab->s1 - slab->s0) / slab->ns, dt = (slab->t1 - slab->t0) / slab->nt;
    int ms = (int)ceil(8 * ds), mt = (int)ceil(8 * dt);
    for (uint32_t it = 0; it < slab->nt; it++)
        for (uint32_t is = 0; is < slab->ns; is++) {
            double sum = 0, first[2] = {0, 0};
            for (int k = 0; k < 16 * ms * mt; k++) {
                int g = k % 16, piece = k / 16;
                double z = 2 * (piece % ms + 0.5 + 0.5 * X[g % 4]) / ms - 1, w = 2 * (piece / ms + 0.5 + 0.5 * X[g / 4]) / mt - 1;
                double p = slab->s0 + ds * (is + 0.5 + 0.5 * z), q = slab->t0 + dt * (it + 0.5 + 0.5 * w), r = 1 + p * p + q * q;
                double weight = W[g % 4] * W[g / 4] / (r * r);
                sum += weight;
                first[0] += weight * z;
                first[1] += weight * w;
            }
            out[(size_t)it * slab->ns + is][0] = (float)(first[0] / sum);
            out[(size_t)it * slab->ns + is][1] = (float)(first[1] / sum);
        }
}

/* Two slopes, scaled so that reach[0] |g[0]| + reach[1] |g[1]| stays below one, in 127ths. */
static void limited(const double g[2], const double reach[2], int8_t out[2])
{
    double sum = reach[0] * fabs(g[0]) + reach[1] * fabs(g[1]), scale = sum > LIMIT ? LIMIT / sum : 1;
    for (int k = 0; k < 2; k++)
        out[k] = (int8_t)lrint(127 * scale * g[k]);
}

/* Whether the cell `by` cells further along axis k is there and counts as a neighbour. */
static bool is_neighbour(const covered *c, const uint32_t n[4], const uint32_t i[4], int k, int by, uint64_t cell)
{
    int64_t at = (int64_t)i[k] + by;
    uint32_t other[4] = {i[0], i[1], i[2], i[3]};
    if (at < 0 || at >= n[k])
        return false;
    other[k] = (uint32_t)at;
    return !is_covered(c, other, cell);
}

/* How much of a difference between cells is light and not the luck of a few photons: shrinking by 1 - variance / difference^2 [james1961]
 * leaves slopes alone where photons are many, and cells constant where they are few. */
static double signal_share(const lmg_field *field, uint32_t j, uint64_t cell, lmg_stencil s, int64_t step, double difference)
{
    const float *se = field->slabs[j].standard_error;
    double a = (double)se[(uint64_t)((int64_t)cell + s.lo * step)], b = (double)se[(uint64_t)((int64_t)cell + s.hi * step)];
    double square = difference * difference, noise = a * a + b * b;
    return square > noise ? 1 - noise / square : 0;
}

static void slopes_of_cell(const lmg_slopes *slopes, const lmg_field *field, uint32_t j, const covered *c, const uint32_t i[4], uint64_t cell,
                           int8_t out[4])
{
    const lmg_slab *slab = &field->layout.slabs[j];
    const uint32_t n[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
    const int64_t st = (int64_t)slab->ns * slab->nt, step[4] = {st, st * slab->nu, 1, slab->ns};
    double l = lmg_cell_luminance(field, j, cell), g[4], reach[4] = {1, 1, 1, 1};
    if (!(l > 0) || is_cut(c, i, cell))
        return;
    for (int k = 0; k < 4; k++) {
        bool there[5];
        for (int by = -2; by <= 2; by++)
            there[by + 2] = by == 0 || is_neighbour(c, n, i, k, by, (uint64_t)((int64_t)cell + by * step[k]));
        lmg_stencil s = lmg_stencil_of(there[0], there[1], there[3], there[4]);
        double lo = lmg_cell_luminance(field, j, (uint64_t)((int64_t)cell + s.lo * step[k]));
        double hi = lmg_cell_luminance(field, j, (uint64_t)((int64_t)cell + s.hi * step[k]));
        g[k] = s.hi > s.lo ? (hi - lo) / (2 * (s.hi - s.lo) * l) * signal_share(field, j, cell, s, step[k], hi - lo) : 0;
    }
    if (slopes->centroid)
        for (int k = 0; k < 2; k++)
            reach[2 + k] = 1 + fabs((double)slopes->centroid[i[3] * slab->ns + i[2]][k]);
    limited(g, reach, out);
    limited(g + 2, reach + 2, out + 2);
}

static void fill(lmg_slopes *slopes, const lmg_field *field, uint32_t j, const covered *c, bool sloping)
{
    const lmg_slab *slab = &field->layout.slabs[j];
    uint64_t cell = 0;
    uint32_t i[4];
    for (i[1] = 0; i[1] < slab->nv; i[1]++)
        for (i[0] = 0; i[0] < slab->nu; i[0]++)
            for (i[3] = 0; i[3] < slab->nt; i[3]++)
                for (i[2] = 0; i[2] < slab->ns; i[2]++, cell++) {
                    const float *r = field->slabs[j].radiance + cell * field->layout.channels;
                    if (slopes->rgb ? r[0] == 0 && r[1] == 0 && r[2] == 0 : r[0] == 0)
                        continue; /* dark: its page may stay untouched */
                    uint16_t *lit = slopes->lit[(uint64_t)i[1] * slab->nu + i[0]];
                    for (int k = 0; k < 2; k++) {
                        lit[2 * k] = i[2 + k] < lit[2 * k] ? (uint16_t)i[2 + k] : lit[2 * k];
                        lit[2 * k + 1] = i[2 + k] > lit[2 * k + 1] ? (uint16_t)i[2 + k] : lit[2 * k + 1];
                    }
                    int8_t slope[4] = {0};
                    if (sloping)
                        slopes_of_cell(slopes, field, j, c, i, cell, slope);
                    if (slopes->rgb)
                        slopes->rgb[cell] = (lmg_cell_rgb){{r[0], r[1], r[2]}, {slope[0], slope[1], slope[2], slope[3]}};
                    else
                        slopes->y[cell] = (lmg_cell_y){r[0], {slope[0], slope[1], slope[2], slope[3]}};
                }
}

lmg_result lmg_slopes_create(lmg_slopes *slopes, const lmg_field *field, const lmg_etendue *e, lmg_error *err)
{
    const lmg_slab *slab = e->slab;
    *slopes = (lmg_slopes){0};
    bool three = field->layout.channels == 3, sloping = e->directions && field->slabs[e->index].flux > 0;
    slopes->bytes = (size_t)field->slabs[e->index].cells * (three ? sizeof *slopes->rgb : sizeof *slopes->y);
    void *table = lmg_table_alloc(slopes->bytes);
    covered c = {0};
    slopes->lit = malloc((size_t)slab->nu * slab->nv * sizeof *slopes->lit);
    bool done = table && slopes->lit;
    for (size_t k = 0; done && k < (size_t)slab->nu * slab->nv; k++) {
        slopes->lit[k][0] = slopes->lit[k][2] = UINT16_MAX;
        slopes->lit[k][1] = slopes->lit[k][3] = 0;
    }
    if (three)
        slopes->rgb = table;
    else
        slopes->y = table;
    if (done && sloping) {
        done = covered_create(&c, slab, e->share || !e->higher_count ? NULL : &e->layout->slabs[e->higher[0]]);
        c.share = e->share;
        if (done && slab->kind == LMG_SLAB_CUBE)
            done = (slopes->centroid = malloc((size_t)slab->ns * slab->nt * sizeof *slopes->centroid)) != NULL;
        if (done && slopes->centroid)
            centroids(slab, slopes->centroid);
    }
    if (done)
        fill(slopes, field, e->index, &c, sloping);
    free(c.axis[0]);
    return done ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its slopes");
}

void lmg_slopes_destroy(lmg_slopes *slopes)
{
    lmg_table_free(slopes->rgb, slopes->bytes);
    lmg_table_free(slopes->y, slopes->bytes);
    free(slopes->lit);
    free(slopes->centroid);
    *slopes = (lmg_slopes){0};
}

size_t lmg_slopes_memory(const lmg_slopes *slopes, const lmg_slab *slab)
{
    return slopes->bytes + (size_t)slab->nu * slab->nv * sizeof *slopes->lit + (slopes->centroid ? (size_t)slab->ns * slab->nt * sizeof *slopes->centroid : 0);
}
