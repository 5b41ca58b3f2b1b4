/* SPDX-License-Identifier: Apache-2.0 */
/* Slopes of radiance within cells, from the cells around; what they mean stands in slopes.h. */
#include "slopes.h"

#include "sampler.h"
#include "work.h"

#include <float.h>
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

/* Two slopes, scaled so that reach[0] |g[0]| + reach[1] |g[1]| stays below one, in 127ths.  Between two of them lie exactly the slopes
 * of many a cell with few photons: they go to the larger one, whichever way radiance, a float, has been rounded at the lamp's scale. */
static inline void limited(double g0, double g1, double reach0, double reach1, int8_t out[2])
{
    double scale = (1 + 0x1p-20) * 127 * LIMIT / d_max(reach0 * fabs(g0) + reach1 * fabs(g1), LIMIT);
    out[0] = (int8_t)lrint(scale * g0);
    out[1] = (int8_t)lrint(scale * g1);
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

/*
 * Slopes of n cells in a row, along one axis: g = (hi - lo) / (2 distance l), with 1/l in inverse, times how much of the difference
 * is light and not the luck of a few photons: shrinking by 1 - variance / difference^2 [james1961] leaves slopes alone where
 * photons are many, and cells constant where they are few.  Without branches on that, which nobody can predict, and simple enough
 * for vectors.
 */
#if defined(__GNUC__)
__attribute__((always_inline))
#endif
static inline void
slopes_along(const lmg_slab_data *data, bool one_channel, uint64_t low, uint64_t high, int distance, const double *inverse,
             double *g, uint32_t n)
{
    const float *a = lmg_cell_radiance(data, low), *b = lmg_cell_radiance(data, high), *sa = data->standard_error + low,
                *sb = data->standard_error + high;
    const size_t stride = one_channel ? 2 : 4;
    const double half = 0.5 / distance;
    for (uint32_t k = 0; k < n; k++) {
        double lo = one_channel ? (double)a[k * stride] : lmg_luminance(a + k * stride),
               hi = one_channel ? (double)b[k * stride] : lmg_luminance(b + k * stride);
        double difference = hi - lo, noise = (double)sa[k] * (double)sa[k] + (double)sb[k] * (double)sb[k];
        double signal = d_max(difference * difference - noise, 0) / d_max(fabs(difference), DBL_MIN);
        g[k] = copysign(signal, difference) * inverse[k] * half;
    }
}

enum { BLOCK = 64 }; /* cells of a row done together */
typedef struct block {
    double inverse[BLOCK], g[4][BLOCK];
} block;

static inline void slopes_between(const lmg_slab_data *data, uint64_t cell, int64_t step, lmg_stencil s, block *b, int axis,
                                  uint32_t from, uint32_t n)
{
    const uint64_t low = (uint64_t)((int64_t)cell + s.lo * step), high = (uint64_t)((int64_t)cell + s.hi * step);
    if (s.lo == s.hi)
        memset(b->g[axis] + from, 0, n * sizeof(double));
    else if (data->stride == 2)
        slopes_along(data, true, low, high, s.hi - s.lo, b->inverse + from, b->g[axis] + from, n);
    else
        slopes_along(data, false, low, high, s.hi - s.lo, b->inverse + from, b->g[axis] + from, n);
}

static lmg_stencil stencil_at(uint32_t i, uint32_t n)
{
    return lmg_stencil_of(i >= 2, i >= 1, i + 1 < n, i + 2 < n);
}

/* n cells from i on, of a slab all of whose cells are its own. */
static void slopes_of_own(const lmg_slab *slab, const lmg_slab_data *data, const uint32_t i[4], uint64_t cell, uint32_t n, block *b)
{
    const int64_t st = (int64_t)slab->ns * slab->nt;
    slopes_between(data, cell, st, stencil_at(i[0], slab->nu), b, 0, 0, n);
    slopes_between(data, cell, st * slab->nu, stencil_at(i[1], slab->nv), b, 1, 0, n);
    slopes_between(data, cell, slab->ns, stencil_at(i[3], slab->nt), b, 3, 0, n);
    /* along the row itself: its ends by themselves */
    for (uint32_t k = 0; k < n;) {
        uint32_t is = i[2] + k, count = is == 0 || is + 1 == slab->ns ? 1 : i[2] + n < slab->ns ? n - k : slab->ns - 1 - is;
        slopes_between(data, cell + k, 1, stencil_at(is, slab->ns), b, 2, k, count);
        k += count;
    }
}

/* n cells from i on, some of which may be somebody else's. */
static void slopes_of_shared(const lmg_slab *slab, const lmg_slab_data *data, const covered *c, const uint32_t first[4],
                             uint64_t cell, uint32_t n, block *b)
{
    const uint32_t all[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
    const int64_t st = (int64_t)slab->ns * slab->nt, step[4] = {st, st * slab->nu, 1, slab->ns};
    uint32_t i[4] = {first[0], first[1], first[2], first[3]};
    for (uint32_t m = 0; m < n; m++, i[2]++, cell++)
        for (int k = 0; k < 4; k++) {
            lmg_stencil s = {0, 0};
            if (b->inverse[m] > 0 && !is_cut(c, i, cell)) {
                bool there[5];
                for (int by = -2; by <= 2; by++)
                    there[by + 2] = by == 0 || is_neighbour(c, all, i, k, by, (uint64_t)((int64_t)cell + by * step[k]));
                s = lmg_stencil_of(there[0], there[1], there[3], there[4]);
            }
            slopes_between(data, cell, step[k], s, b, k, m, 1);
        }
}

/* What the pieces of work on one slab share; a piece is `run` cells of (u,v). */
typedef struct filling {
    lmg_slopes *slopes;
    lmg_field *field;
    uint32_t j;
    covered covered;
    bool sloping;
    uint64_t run;
} filling;

/* n cells in a row, from i on. */
static void fill_block(const filling *f, const uint32_t i[4], uint64_t cell, uint32_t n, uint16_t lit[4])
{
    const lmg_slab *slab = &f->field->layout.slabs[f->j];
    const lmg_slab_data *data = &f->field->slabs[f->j];
    const bool one_channel = data->stride == 2;
    block b;
    uint32_t from = n, to = 0; /* with light */
    for (uint32_t k = 0; k < n; k++) {
        const float *r = lmg_cell_radiance(data, cell + k);
        double l = one_channel ? (double)r[0] : lmg_luminance(r);
        b.inverse[k] = l > 0 ? 1 / l : 0;
        if (r[0] != 0 || (!one_channel && (r[1] != 0 || r[2] != 0))) {
            from = from < k ? from : k;
            to = k + 1;
        }
    }
    if (to > 0) {
        lit[0] = i[2] + from < lit[0] ? (uint16_t)(i[2] + from) : lit[0];
        lit[1] = i[2] + to - 1 > lit[1] ? (uint16_t)(i[2] + to - 1) : lit[1];
        lit[2] = i[3] < lit[2] ? (uint16_t)i[3] : lit[2];
        lit[3] = i[3] > lit[3] ? (uint16_t)i[3] : lit[3];
    }
    if (to == 0 || !f->sloping)
        memset(b.g, 0, sizeof b.g);
    else if (f->covered.any || f->covered.share)
        slopes_of_shared(slab, data, &f->covered, i, cell, n, &b);
    else
        slopes_of_own(slab, data, i, cell, n, &b);
    const float(*centroid)[2] =
        f->slopes->centroid ? (const float(*)[2])f->slopes->centroid + (size_t)i[3] * slab->ns + i[2] : NULL;
    for (uint32_t k = 0; k < n; k++) {
        static const int8_t none[4] = {0, 0, 0, 0};
        int8_t *at = lmg_cell_slopes(data, cell + k), slope[4];
        limited(b.g[0][k], b.g[1][k], 1, 1, slope);
        limited(b.g[2][k], b.g[3][k], centroid ? 1 + fabs((double)centroid[k][0]) : 1,
                centroid ? 1 + fabs((double)centroid[k][1]) : 1, slope + 2);
        if (to > 0 || memcmp(at, none, sizeof none) != 0) /* in the dark a page may stay untouched */
            memcpy(at, slope, sizeof slope);
    }
}

static void fill_picture(const filling *f, uint64_t uv)
{
    const lmg_slab *slab = &f->field->layout.slabs[f->j];
    uint16_t *lit = f->slopes->lit[uv];
    uint32_t i[4] = {(uint32_t)(uv % slab->nu), (uint32_t)(uv / slab->nu), 0, 0};
    lit[0] = lit[2] = UINT16_MAX;
    lit[1] = lit[3] = 0;
    for (i[3] = 0; i[3] < slab->nt; i[3]++)
        for (i[2] = 0; i[2] < slab->ns; i[2] += BLOCK)
            fill_block(f, i, (uv * slab->nt + i[3]) * slab->ns + i[2], slab->ns - i[2] < BLOCK ? slab->ns - i[2] : BLOCK, lit);
}

static lmg_result fill_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    (void)scratch;
    (void)err;
    const filling *f = self;
    const lmg_slab *slab = &f->field->layout.slabs[f->j];
    const uint64_t all = (uint64_t)slab->nu * slab->nv, first = index * f->run, after = first + f->run < all ? first + f->run : all;
    for (uint64_t uv = first; uv < after; uv++)
        fill_picture(f, uv);
    return LMG_OK;
}

/* Cells in a piece of work, at least: so that handing it out costs nothing beside it. */
enum { RUN_CELLS = 1 << 14 };

lmg_result lmg_slopes_create(lmg_slopes *slopes, lmg_field *field, const lmg_etendue *e, lmg_error *err)
{
    const lmg_slab *slab = e->slab;
    const uint64_t pictures = (uint64_t)slab->nu * slab->nv, st = (uint64_t)slab->ns * slab->nt;
    filling f = {.slopes = slopes, .field = field, .j = e->index, .sloping = e->directions && field->slabs[e->index].flux > 0};
    f.run = st < RUN_CELLS ? RUN_CELLS / st : 1;
    *slopes = (lmg_slopes){.lit = malloc((size_t)pictures * sizeof *slopes->lit)};
    bool done = slopes->lit != NULL;
    if (done && f.sloping) {
        done = covered_create(&f.covered, slab, e->share || !e->higher_count ? NULL : &e->layout->slabs[e->higher[0]]);
        f.covered.share = e->share;
        if (done && slab->kind == LMG_SLAB_CUBE)
            done = (slopes->centroid = malloc((size_t)st * sizeof *slopes->centroid)) != NULL;
        if (done && slopes->centroid)
            centroids(slab, slopes->centroid);
    }
    lmg_result r = done ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its slopes");
    if (done) {
        lmg_work work = {.piece = fill_run, .self = &f, .count = (pictures + f.run - 1) / f.run};
        r = lmg_work_do(&work, err);
    }
    free(f.covered.axis[0]);
    return r;
}

void lmg_slopes_destroy(lmg_slopes *slopes)
{
    free(slopes->lit);
    free(slopes->centroid);
    *slopes = (lmg_slopes){0};
}

size_t lmg_slopes_memory(const lmg_slopes *slopes, const lmg_slab *slab)
{
    return (size_t)slab->nu * slab->nv * sizeof *slopes->lit +
           (slopes->centroid ? (size_t)slab->ns * slab->nt * sizeof *slopes->centroid : 0);
}
