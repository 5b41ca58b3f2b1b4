/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What cells do to the light, in three measures.
 *
 * Illuminance and intensity: each pilot ray is moved to a random place in its own cell (that is what a cell does to light), and
 * what falls on planes, and into directions, before and after is compared.  All candidates use the same random numbers, so that
 * they differ by what the cells do.  Squares are taken over pairs of different rays, whose noise is independent.
 *
 * Radiance: of a light field L cells keep the means M.  |L - M|^2 = |L|^2 - |M|^2, the norm being the integral of squares over
 * etendue, and |M|^2 is the sum of (flux of cell)^2 / (etendue of cell), which every pair of rays in one cell tells without bias: a
 * U-statistic [hoeffding1948].  The noise of the box adds its variance, sum of (photons' flux)^2 / etendue.
 *
 * The three differ by orders of magnitude: a good box has an error of some tenths of a per cent of illuminance and one of 30 % of
 * radiance.  So each counts in units of what is good.  Errors of illuminance and intensity count as far as they are more than
 * chance: where they aren't, radiance, which pairs of rays tell much more exactly, decides.  Relies on geometry.h for coordinates.
 */
#include "layout_judge.h"

#include "geometry.h"
#include "work.h"

#include <stdlib.h>
#include <string.h>

static const double PLANE_DISTANCE[LMG_JUDGE_PLANES] = {0.5, 1, 2, 5};
/* The directions of most of the light: what is left out at either end of both coordinates, and how much wider than the rest the
 * receiver is. */
static const double BEAM_TAIL = 0.3, BEAM_MARGIN = 1.5;
/* Rays are dealt with in so many parts, whatever the number of processors, so that sums of floats are always the same. */
enum { SIDE = 24, PARTS = 8 };

typedef struct receiver {
    double reach;         /* of a plane; unused for directions */
    double x0, y0, scale; /* its corner, pixels per unit */
    double scale_y;
    double energy;
} receiver;

/* What moving the rays changes, in a part of the work; and the squares of each change. */
typedef struct sums {
    float change[LMG_JUDGE_RECEIVERS][LMG_JUDGE_PIXELS], squares[LMG_JUDGE_RECEIVERS][LMG_JUDGE_PIXELS];
} sums;

typedef struct slot {
    uint64_t cell; /* 1 + the cell's number over all slabs; 0: empty */
    double sum, squares;
    float inverse;
    uint32_t rays;
} slot;

struct lmg_judge {
    const lmg_pilot *pl;
    lmg_vec3 a, b, n;
    double start; /* along n: where the light's box ends */
    receiver receivers[LMG_JUDGE_RECEIVERS];
    double square; /* |L|^2; 0: not known */
    size_t count;
    uint32_t *ray;                         /* those judged, by their numbers in the pilot */
    int16_t (*pixel)[LMG_JUDGE_RECEIVERS]; /* of each as it is; -1 outside */
    uint64_t *cell;
    float *inverse; /* one over the cell's etendue */
    sums *parts;
    slot *slots; /* power of two, twice the rays */
    size_t slot_count;
    /* of the call under way */
    const lmg_slab *slabs;
    uint32_t slab_count;
    double scale[LMG_MAX_SLABS][4];
    uint64_t first_cell[LMG_MAX_SLABS];
    bool move;
};

/* The receiver of all directions: rings of equal solid angle, cut in sectors. */
enum { RINGS = 16, SECTORS = LMG_JUDGE_PIXELS / RINGS };

/* square: the direction's place in the square of the concentric map, in which the angle about n is linear on each side. */
static int ring_pixel(double cosine, const double square[2])
{
    const double s = square[0], t = square[1];
    double eighths = 0; /* of the circle */
    if (fabs(s) >= fabs(t))
        eighths = s != 0 ? (s > 0 ? 0 : 4) + t / s : 0;
    else
        eighths = (t > 0 ? 2 : 6) - s / t;
    const int ring = (int)((1 - cosine) * RINGS), sector = (int)((eighths < 0 ? eighths + 8 : eighths) * (SECTORS / 8.0));
    return (ring < RINGS ? ring : RINGS - 1) * SECTORS + (sector < SECTORS ? sector : SECTORS - 1);
}

static int pixel_of(const lmg_judge *q, int k, lmg_vec3 o, lmg_vec3 d, const double square[2])
{
    const receiver *r = &q->receivers[k];
    double x, y;
    if (k == LMG_JUDGE_PLANES)
        return ring_pixel(v_dot(d, q->n), square);
    if (k < LMG_JUDGE_PLANES) {
        double t = (q->start + r->reach - v_dot(o, q->n)) / v_dot(d, q->n);
        x = v_dot(o, q->a) + t * v_dot(d, q->a);
        y = v_dot(o, q->b) + t * v_dot(d, q->b);
    } else {
        x = square[0];
        y = square[1];
    }
    x = (x - r->x0) * r->scale;
    y = (y - r->y0) * r->scale_y;
    return x >= 0 && x < SIDE && y >= 0 && y < SIDE ? (int)y * SIDE + (int)x : -1;
}

/* Pixels of a ray in all receivers; -1 for those that go backwards. */
static void pixels_of(const lmg_judge *q, lmg_vec3 o, lmg_vec3 d, int out[LMG_JUDGE_RECEIVERS])
{
    const bool forward = v_dot(d, q->n) > 0;
    double square[2] = {0};
    if (forward)
        lmg_cone_to_square(v_dot(d, q->a), v_dot(d, q->b), 1, &square[0], &square[1]);
    for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++)
        out[k] = forward ? pixel_of(q, k, o, d, square) : -1;
}

/* The receiver of a beam: the part of the square of directions that holds the middle of the light, and as much again around it. */
static bool set_directions(lmg_judge *q)
{
    const lmg_pilot *pl = q->pl;
    receiver *beam = &q->receivers[LMG_JUDGE_PLANES + 1];
    double *x = malloc(pl->count * sizeof *x), *y = malloc(pl->count * sizeof *y), *w = malloc(pl->count * sizeof *w);
    size_t n = 0;
    for (size_t i = 0; x && y && w && i < pl->count; i++)
        if (v_dot(pl->direction[i], q->n) > 0) {
            lmg_cone_to_square(v_dot(pl->direction[i], q->a), v_dot(pl->direction[i], q->b), 1, &x[n], &y[n]);
            w[n++] = pl->flux[i];
        }
    const bool there = x && y && w;
    lmg_interval qx = {-1, 1, 0, 0}, qy = {-1, 1, 0, 0};
    if (there && n) {
        qx = lmg_quantiles(x, w, n, BEAM_TAIL);
        qy = lmg_quantiles(y, w, n, BEAM_TAIL);
    }
    /* a beam narrower than any cell will be: anything positive */
    const double wx = fmax((1 + BEAM_MARGIN) * (qx.hi - qx.lo), 1e-6), wy = fmax((1 + BEAM_MARGIN) * (qy.hi - qy.lo), 1e-6);
    *beam =
        (receiver){.x0 = 0.5 * (qx.lo + qx.hi - wx), .y0 = 0.5 * (qy.lo + qy.hi - wy), .scale = SIDE / wx, .scale_y = SIDE / wy};
    free(x);
    free(y);
    free(w);
    return there;
}

lmg_judge *lmg_judge_create(const lmg_pilot *pl, int c, bool all)
{
    lmg_judge *q = calloc(1, sizeof *q);
    if (!q)
        return NULL;
    q->pl = pl;
    lmg_class_frame(c, &q->a, &q->b, &q->n);
    lmg_vec3 mid = v_scale(0.5, v_add(pl->light_lo, pl->light_hi)), half = v_scale(0.5, v_sub(pl->light_hi, pl->light_lo));
    q->start = v_dot(mid, q->n) + fabs(v_dot(half, q->n));
    size_t judged = 0;
    for (size_t i = 0; i < pl->count; i++)
        judged += all || pl->class[i] == c;
    for (q->slot_count = 64; q->slot_count < 2 * judged;)
        q->slot_count *= 2;
    q->ray = malloc(pl->count * sizeof *q->ray);
    q->pixel = malloc(pl->count * sizeof *q->pixel);
    q->cell = malloc(pl->count * sizeof *q->cell);
    q->inverse = malloc(pl->count * sizeof *q->inverse);
    q->parts = malloc(PARTS * sizeof *q->parts);
    q->slots = malloc(q->slot_count * sizeof *q->slots);
    if (!q->ray || !q->pixel || !q->cell || !q->inverse || !q->parts || !q->slots || !set_directions(q)) {
        lmg_judge_destroy(q);
        return NULL;
    }
    for (int k = 0; k < LMG_JUDGE_PLANES; k++) {
        double w = (PLANE_DISTANCE[k] + 0.5) * pl->size;
        q->receivers[k] = (receiver){.reach = PLANE_DISTANCE[k] * pl->size,
                                     .x0 = v_dot(mid, q->a) - w,
                                     .y0 = v_dot(mid, q->b) - w,
                                     .scale = SIDE / (2 * w),
                                     .scale_y = SIDE / (2 * w)};
    }
    /* relative to all light on the receivers, whatever its class */
    sums *whole = q->parts;
    memset(whole, 0, sizeof *whole);
    for (size_t i = 0; i < pl->count; i++) {
        const bool mine = all || pl->class[i] == c;
        int pixel[LMG_JUDGE_RECEIVERS];
        pixels_of(q, pl->origin[i], pl->direction[i], pixel);
        for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++) {
            if (mine)
                q->pixel[q->count][k] = (int16_t)pixel[k];
            if (pixel[k] >= 0) {
                whole->change[k][pixel[k]] += (float)pl->flux[i];
                whole->squares[k][pixel[k]] += (float)(pl->flux[i] * pl->flux[i]);
            }
        }
        if (mine)
            q->ray[q->count++] = (uint32_t)i;
    }
    for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++) {
        double energy = 0, squares = 0;
        for (int i = 0; i < LMG_JUDGE_PIXELS; i++) {
            const double light = (double)whole->change[k][i], v = (double)whole->squares[k][i];
            energy += light * light - v;
            squares += v;
        }
        /* of single rays in pixels the rounding of floats, 2^-23 of the squares, would be left */
        q->receivers[k].energy = energy > 1e-5 * squares ? energy : 0;
    }
    return q;
}

void lmg_judge_destroy(lmg_judge *q)
{
    if (!q)
        return;
    free(q->ray);
    free(q->pixel);
    free(q->cell);
    free(q->inverse);
    free(q->parts);
    free(q->slots);
    free(q);
}

void lmg_judge_set_square(lmg_judge *q, double square)
{
    q->square = square;
}

double lmg_judge_square(const lmg_judge *q)
{
    return q->square;
}

bool lmg_better(lmg_verdict x, lmg_verdict than, double gain, double standard_errors)
{
    return x.error < than.error * gain && than.error - x.error > standard_errors * fmax(x.se, than.se);
}

/* A ray's cell, and what moving within it changes. */
static void place_ray(lmg_judge *q, size_t m, sums *out)
{
    const lmg_pilot *pl = q->pl;
    const uint32_t i = q->ray[m];
    q->cell[m] = 0;
    double x[4];
    for (uint32_t j = 0; j < q->slab_count; j++) {
        const lmg_slab *s = &q->slabs[j];
        if (!lmg_slab_coordinates(s, pl->origin[i], pl->direction[i], x))
            continue;
        const double low[4] = {s->u0, s->v0, s->s0, s->t0}, *scale = q->scale[j];
        const uint32_t n[4] = {s->nu, s->nv, s->ns, s->nt};
        uint64_t at[4];
        double middle[4];
        for (int k = 0; k < 4; k++) {
            at[k] = (uint64_t)d_clamp((x[k] - low[k]) * scale[k], 0, (double)(n[k] - 1));
            middle[k] = low[k] + ((double)at[k] + 0.5) / scale[k];
            x[k] = low[k] + ((double)at[k] + (double)pl->jitter[i][k]) / scale[k];
        }
        q->cell[m] = 1 + q->first_cell[j] + ((at[1] * s->nu + at[0]) * s->nt + at[3]) * s->ns + at[2];
        /* etendue by the density in the middle of the cell */
        double density = LMG_PI / 4;
        if (s->kind == LMG_SLAB_CUBE) {
            const double d = isinf(s->distance) ? 1 : 1 / s->distance;
            const double p = isinf(s->distance) ? middle[2] : (middle[2] - middle[0]) * d,
                         r = isinf(s->distance) ? middle[3] : (middle[3] - middle[1]) * d;
            density = d * d / ((1 + p * p + r * r) * (1 + p * p + r * r));
        }
        q->inverse[m] = (float)(scale[0] * scale[1] * scale[2] * scale[3] / density);
        if (!q->move)
            return;
        lmg_vec3 o, d;
        lmg_slab_ray(s, x, &o, &d);
        int after[LMG_JUDGE_RECEIVERS];
        pixels_of(q, o, d, after);
        const float w = (float)pl->flux[i];
        for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++) {
            const int before = q->pixel[m][k];
            if (before == after[k])
                continue;
            if (before >= 0) {
                out->change[k][before] -= w;
                out->squares[k][before] += w * w;
            }
            if (after[k] >= 0) {
                out->change[k][after[k]] += w;
                out->squares[k][after[k]] += w * w;
            }
        }
        return;
    }
}

static lmg_result place_part(void *self, uint64_t part, void *scratch, lmg_error *err)
{
    lmg_judge *q = self;
    (void)scratch, (void)err;
    if (q->move)
        memset(&q->parts[part], 0, sizeof q->parts[part]);
    for (size_t m = q->count * part / PARTS; m < q->count * (part + 1) / PARTS; m++)
        place_ray(q, m, &q->parts[part]);
    return LMG_OK;
}

static void place_all(lmg_judge *q, const lmg_slab *slabs, uint32_t slab_count, bool move)
{
    uint64_t cells = 0;
    for (uint32_t j = 0; j < slab_count; j++) {
        const lmg_slab *s = &slabs[j];
        q->scale[j][0] = s->nu / (s->u1 - s->u0);
        q->scale[j][1] = s->nv / (s->v1 - s->v0);
        q->scale[j][2] = s->ns / (s->s1 - s->s0);
        q->scale[j][3] = s->nt / (s->t1 - s->t0);
        q->first_cell[j] = cells;
        cells += lmg_slab_cells(s);
    }
    q->slabs = slabs;
    q->slab_count = slab_count;
    q->move = move;
    lmg_work work = {.piece = place_part, .self = q, .count = PARTS};
    if (lmg_work_do(&work, NULL) != LMG_OK) /* no lock to be had: one part after the other */
        for (uint64_t k = 0; k < PARTS; k++)
            place_part(q, k, NULL, NULL);
}

/* Sums over pairs of rays in one cell; *noise: sum of squares over etendue, of the pilot's rays. */
static double pair_up(lmg_judge *q, double *pairs, double *noise)
{
    memset(q->slots, 0, q->slot_count * sizeof *q->slots);
    for (size_t m = 0; m < q->count; m++) {
        if (!q->cell[m])
            continue;
        size_t k = (size_t)((q->cell[m] * 0x9e3779b97f4a7c15u) >> 20) & (q->slot_count - 1);
        while (q->slots[k].cell && q->slots[k].cell != q->cell[m])
            k = (k + 1) & (q->slot_count - 1);
        const double w = q->pl->flux[q->ray[m]];
        slot *s = &q->slots[k];
        s->cell = q->cell[m];
        s->sum += w;
        s->squares += w * w;
        s->inverse = q->inverse[m];
        s->rays++;
    }
    double kept = 0;
    *pairs = *noise = 0;
    for (size_t k = 0; k < q->slot_count; k++) {
        const slot *s = &q->slots[k];
        if (!s->cell)
            continue;
        kept += (s->sum * s->sum - s->squares) * (double)s->inverse;
        *noise += s->squares * (double)s->inverse;
        *pairs += 0.5 * (double)s->rays * (double)(s->rays - 1);
    }
    return kept;
}

double lmg_judge_kept(lmg_judge *q, const lmg_slab *slabs, uint32_t slab_count, double *pairs)
{
    double noise;
    place_all(q, slabs, slab_count, false);
    return pair_up(q, pairs, &noise);
}

/* Squared errors on planes and of directions, with their standard errors. */
static void measure_moves(const lmg_judge *q, double error[2], double se[2])
{
    for (int part = 1; part < PARTS; part++) {
        const float *from[2] = {&q->parts[part].change[0][0], &q->parts[part].squares[0][0]};
        float *to[2] = {&q->parts[0].change[0][0], &q->parts[0].squares[0][0]};
        for (int k = 0; k < 2; k++)
            for (int i = 0; i < LMG_JUDGE_RECEIVERS * LMG_JUDGE_PIXELS; i++)
                to[k][i] += from[k][i];
    }
    /* Of a sum c of independent changes, c^2 less the sum of their squares v has the square of c's mean as its own mean; with that
     * m^2, its variance is 2 v^2 + 4 m^2 v. */
    double sum[2] = {0}, variance[2] = {0};
    int used[2] = {0};
    for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++) {
        const int far = k >= LMG_JUDGE_PLANES;
        const double weight = k > LMG_JUDGE_PLANES ? LMG_GOOD_INTENSITY * LMG_GOOD_INTENSITY / (LMG_GOOD_BEAM * LMG_GOOD_BEAM) : 1;
        const double energy = q->receivers[k].energy;
        if (!(energy > 0))
            continue;
        for (int i = 0; i < LMG_JUDGE_PIXELS; i++) {
            double c = (double)q->parts[0].change[k][i], v = (double)q->parts[0].squares[k][i], e = c * c - v;
            sum[far] += weight * e / energy;
            variance[far] += weight * weight * (2 * v * v + 4 * fmax(e, 0) * v) / (energy * energy);
        }
        used[far]++;
    }
    for (int far = 0; far < 2; far++) {
        error[far] = sum[far] / fmax(used[far], 1);
        se[far] = sqrt(variance[far]) / fmax(used[far], 1);
    }
}

lmg_verdict lmg_judge_slabs(lmg_judge *q, const lmg_slab *slabs, uint32_t slab_count, bool by_radiance)
{
    static const double GOOD[2] = {LMG_GOOD_ILLUMINANCE * LMG_GOOD_ILLUMINANCE, LMG_GOOD_INTENSITY * LMG_GOOD_INTENSITY};
    place_all(q, slabs, slab_count, !by_radiance);
    lmg_verdict v = {0};
    double pairs, noise, error[2] = {0}, se[2] = {0}, variance = 0;
    if (!by_radiance)
        measure_moves(q, error, se);
    double beside = 0;
    for (size_t m = 0; m < q->count; m++)
        beside += q->cell[m] ? 0 : q->pl->flux[q->ray[m]] / q->pl->total;
    for (int far = 0; far < 2; far++) {
        v.error += (fmax(error[far] - se[far], 0) + beside * beside) / GOOD[far];
        variance += error[far] > se[far] ? se[far] * se[far] / (GOOD[far] * GOOD[far]) : 0;
    }
    v.illuminance = fmax(error[0], 0) + beside * beside;
    v.intensity = fmax(error[1], 0) + beside * beside;
    const double kept = pair_up(q, &pairs, &noise);
    if (q->square > 0) {
        const double net = kept - (q->pl->photons > 0 ? noise * (double)q->pl->count / q->pl->photons : 0);
        const double unit = 1 / (LMG_GOOD_RADIANCE * LMG_GOOD_RADIANCE), uncertain = unit * kept / q->square / sqrt(fmax(pairs, 1));
        v.radiance = 1 - net / q->square;
        v.error += unit * (by_radiance ? v.radiance : fmax(v.radiance, 0)); /* chance below 0 must not outweigh the others */
        variance += uncertain * uncertain;
    }
    v.se = sqrt(variance);
    return v;
}
