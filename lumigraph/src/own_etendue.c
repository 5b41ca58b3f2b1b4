/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What of a cell is its slab's own: not what slabs of higher priority own, nor lines that miss the bounds.  Relies on etendue.c for whole
 * cells and on geometry.h for who owns a ray.
 *
 * Integrated over direction by the midpoint rule, with the (u,v) area clipped exactly for each direction: the bounds' shadow and the slabs'
 * are convex polygons in the (u,v) plane, the same for all (u,v) cells.  So all cells of a slab are done direction by direction: blocks of
 * cells that a direction's shadows leave whole, or cover, are done at once, and only what they cut is quartered down to single cells.
 * The number of points is bounded for the slab as a whole, so that no file, however its slabs overlap, takes more than seconds.
 */
#include "etendue.h"
#include "field.h"
#include "geometry.h"
#include "memory.h"
#include "work.h"

#include <stdlib.h>

/* ---------------------------------------------------------------------------------------- polygons in the (u,v) plane */

enum { MAX_CORNERS = 24 }; /* a rectangle cut by 6 + 4 half-planes has at most 14 */
typedef struct polygon {
    int n;
    double x[MAX_CORNERS], y[MAX_CORNERS];
} polygon;

/* Keeps the part with a x + b y >= c. */
static void clip(polygon *p, double a, double b, double c)
{
    double side[MAX_CORNERS];
    bool all = true, none = true;
    for (int i = 0; i < p->n; i++) {
        side[i] = a * p->x[i] + b * p->y[i] - c;
        all = all && side[i] >= 0;
        none = none && side[i] <= 0;
    }
    if (all)
        return;
    if (none) {
        p->n = 0;
        return;
    }
    polygon q = {0};
    for (int i = 0; i < p->n; i++) {
        int j = i + 1 == p->n ? 0 : i + 1;
        if (side[i] >= 0) {
            q.x[q.n] = p->x[i];
            q.y[q.n++] = p->y[i];
        }
        if ((side[i] > 0 && side[j] < 0) || (side[i] < 0 && side[j] > 0)) {
            double f = side[i] / (side[i] - side[j]);
            q.x[q.n] = p->x[i] + f * (p->x[j] - p->x[i]);
            q.y[q.n++] = p->y[i] + f * (p->y[j] - p->y[i]);
        }
    }
    *p = q;
}

static double area(const polygon *p)
{
    double sum = 0;
    for (int i = 1; i + 1 < p->n; i++)
        sum += (p->x[i] - p->x[0]) * (p->y[i + 1] - p->y[0]) - (p->x[i + 1] - p->x[0]) * (p->y[i] - p->y[0]);
    return 0.5 * sum;
}

/* Cuts p down to the convex polygon q (either sense of rotation). */
static void clip_to_polygon(polygon *p, const polygon *q)
{
    double sign = area(q) < 0 ? -1 : 1;
    for (int i = 0; i < q->n && p->n; i++) {
        int j = i + 1 == q->n ? 0 : i + 1;
        double ex = q->x[j] - q->x[i], ey = q->y[j] - q->y[i];
        clip(p, -ey * sign, ex * sign, (-ey * q->x[i] + ex * q->y[i]) * sign);
    }
}

/* What one direction sees of a slab's plane. */
typedef struct sight {
    double weight;      /* of the direction: etendue per (u,v) area and (s,t) */
    double strips[3][4];/* the bounds' shadow: lo <= x a + y b <= hi, {a, b, lo, hi} for each; only where the slab isn't inside */
    uint32_t count;     /* shadows of slabs of higher priority that own this direction */
    polygon shadows[LMG_MAX_SLABS];
    double box[LMG_MAX_SLABS][4]; /* their extent: x0 x1 y0 y1 */
} sight;

/* The bounds' shadow along d: a convex hexagon, the hull of the corners' projections. */
static void shadow_of_bounds(const lmg_etendue *e, lmg_vec3 d, double dn, sight *out)
{
    const lmg_layout *layout = e->layout;
    double x[8], y[8];
    for (int k = 0; k < 8; k++) {
        lmg_vec3 c = {k & 1 ? layout->bounds_max.x : layout->bounds_min.x, k & 2 ? layout->bounds_max.y : layout->bounds_min.y,
                      k & 4 ? layout->bounds_max.z : layout->bounds_min.z};
        lmg_slab_crossing(e->slab, c, d, dn, &x[k], &y[k]);
    }
    /* The hull's edges are parallel to the projected edges of the box, three directions: between the least and greatest of each. */
    for (int axis = 0; axis < 3; axis++) {
        double *s = out->strips[axis];
        s[0] = -(y[1 << axis] - y[0]);
        s[1] = x[1 << axis] - x[0];
        s[2] = INFINITY;
        s[3] = -INFINITY;
        for (int k = 0; k < 8; k++) {
            double c = s[0] * x[k] + s[1] * y[k];
            s[2] = c < s[2] ? c : s[2];
            s[3] = c > s[3] ? c : s[3];
        }
    }
}

/* Whether slab x, whose (s,t) is the direction, owns direction d where the line passes its rectangle; the rectangle's shadow if so. */
static bool shadow_of_slab(const lmg_slab *x, const lmg_slab *slab, lmg_vec3 d, double dn, polygon *shadow)
{
    double dx = v_dot(d, x->n), s, t;
    if (!(dx > 0) || (x->kind == LMG_SLAB_CUBE && lmg_direction_class(d) != lmg_direction_class(x->n)))
        return false;
    lmg_slab_st(x, d, dx, 0, 0, &s, &t);
    if (!lmg_in_st(x, s, x->s0, x->s1) || !lmg_in_st(x, t, x->t0, x->t1))
        return false;
    const double u[4] = {x->u0, x->u1, x->u1, x->u0}, v[4] = {x->v0, x->v0, x->v1, x->v1};
    shadow->n = 4;
    for (int k = 0; k < 4; k++)
        lmg_slab_crossing(slab, v_fma(v_fma(x->o, u[k], x->a), v[k], x->b), d, dn, &shadow->x[k], &shadow->y[k]);
    if (area(shadow) < 0) { /* counterclockwise */
        double swap = shadow->x[1];
        shadow->x[1] = shadow->x[3];
        shadow->x[3] = swap;
        swap = shadow->y[1];
        shadow->y[1] = shadow->y[3];
        shadow->y[3] = swap;
    }
    return true;
}

/* False for a direction that the slab doesn't hold. */
static bool look_along(const lmg_etendue *e, lmg_vec3 d, sight *out)
{
    double dn = v_dot(d, e->slab->n);
    out->count = 0;
    if (!(dn > 0))
        return false;
    out->weight = e->slab->kind == LMG_SLAB_CUBE ? dn * dn * dn * dn : 1;
    if (!e->inside)
        shadow_of_bounds(e, d, dn, out);
    for (uint32_t k = 0; k < e->higher_count; k++) {
        polygon *p = &out->shadows[out->count];
        if (!shadow_of_slab(&e->layout->slabs[e->higher[k]], e->slab, d, dn, p))
            continue;
        double *box = out->box[out->count++];
        box[0] = d_min(d_min(p->x[0], p->x[1]), d_min(p->x[2], p->x[3]));
        box[1] = d_max(d_max(p->x[0], p->x[1]), d_max(p->x[2], p->x[3]));
        box[2] = d_min(d_min(p->y[0], p->y[1]), d_min(p->y[2], p->y[3]));
        box[3] = d_max(d_max(p->y[0], p->y[1]), d_max(p->y[2], p->y[3]));
    }
    return true;
}

typedef struct rectangle {
    double u0, u1, v0, v1;
} rectangle;

/* 1: a rectangle is whole in a direction's sight, 0: nothing of it is, -1: some may be.  touching: the shadows that may cut it. */
static int classify(const lmg_etendue *e, const sight *s, const rectangle *r, uint8_t touching[LMG_MAX_SLABS], uint32_t *touching_count)
{
    bool whole = true;
    *touching_count = 0;
    for (int k = 0; k < 3 && !e->inside; k++) {
        const double *x = s->strips[k];
        double a0 = x[0] * r->u0, a1 = x[0] * r->u1, b0 = x[1] * r->v0, b1 = x[1] * r->v1;
        double least = d_min(a0, a1) + d_min(b0, b1), most = d_max(a0, a1) + d_max(b0, b1);
        if (most < x[2] || least > x[3]) /* of a direction along an axis one strip is all zeros, and holds everything */
            return 0;
        whole = whole && least >= x[2] && most <= x[3];
    }
    for (uint32_t k = 0; k < s->count; k++) {
        const double *box = s->box[k];
        if (box[0] >= r->u1 || box[1] <= r->u0 || box[2] >= r->v1 || box[3] <= r->v0)
            continue;
        const polygon *p = &s->shadows[k];
        bool within = true, apart = false;
        for (int i = 0; i < 4; i++) {
            int j = (i + 1) % 4;
            double ex = p->x[j] - p->x[i], ey = p->y[j] - p->y[i], c = ex * p->y[i] - ey * p->x[i];
            /* ex y - ey x - c >= 0 inside */
            double a0 = -ey * r->u0, a1 = -ey * r->u1, b0 = ex * r->v0, b1 = ex * r->v1;
            within = within && d_min(a0, a1) + d_min(b0, b1) >= c;
            apart = apart || d_max(a0, a1) + d_max(b0, b1) <= c;
        }
        if (apart)
            continue;
        if (within)
            return 0;
        touching[(*touching_count)++] = (uint8_t)k;
    }
    return whole && *touching_count == 0 ? 1 : -1;
}

/* Area of a polygon that several convex polygons leave free: their union's length is taken along the middle lines of strips. */
static double free_of_several(const polygon *p, const sight *s, const uint8_t *touching, uint32_t count, int strips)
{
    double lo = INFINITY, hi = -INFINITY, sum = 0;
    for (int i = 0; i < p->n; i++) {
        lo = d_min(lo, p->y[i]);
        hi = d_max(hi, p->y[i]);
    }
    for (int k = 0; k < strips; k++) {
        double y = lo + (hi - lo) * (k + 0.5) / strips, from[LMG_MAX_SLABS + 1], to[LMG_MAX_SLABS + 1];
        uint32_t n = 0;
        for (uint32_t m = 0; m <= count; m++) {
            const polygon *q = m == 0 ? p : &s->shadows[touching[m - 1]];
            double a = INFINITY, b = -INFINITY;
            for (int i = 0; i < q->n; i++) {
                int j = i + 1 == q->n ? 0 : i + 1;
                if ((q->y[i] <= y) != (q->y[j] <= y)) {
                    double x = q->x[i] + (y - q->y[i]) / (q->y[j] - q->y[i]) * (q->x[j] - q->x[i]);
                    a = d_min(a, x);
                    b = d_max(b, x);
                }
            }
            if (m > 0 && !(a < b))
                continue;
            /* by their left ends, the polygon itself first */
            uint32_t at = n++;
            for (; at > 1 && from[at - 1] > a; at--) {
                from[at] = from[at - 1];
                to[at] = to[at - 1];
            }
            from[at] = a;
            to[at] = b;
        }
        double x = from[0], free_length = 0;
        for (uint32_t m = 1; m < n && x < to[0]; m++) {
            free_length += d_max(d_min(from[m], to[0]) - x, 0);
            x = d_max(x, to[m]);
        }
        sum += (free_length + d_max(to[0] - x, 0)) * (hi - lo) / strips;
    }
    return sum;
}

/* (u,v) area of a rectangle, classified -1, that light of the direction can use; middle (may be NULL): of its part inside the bounds. */
static double cut_area(const lmg_etendue *e, const sight *s, const rectangle *r, const uint8_t *touching, uint32_t count, double middle[2])
{
    polygon p = {4, {r->u0, r->u1, r->u1, r->u0}, {r->v0, r->v0, r->v1, r->v1}};
    for (int k = 0; k < 3 && !e->inside && p.n; k++) {
        clip(&p, s->strips[k][0], s->strips[k][1], s->strips[k][2]);
        clip(&p, -s->strips[k][0], -s->strips[k][1], -s->strips[k][3]);
    }
    if (middle) {
        middle[0] = middle[1] = 0;
        for (int i = 0; i < p.n; i++) {
            middle[0] += p.x[i] / p.n;
            middle[1] += p.y[i] / p.n;
        }
    }
    if (count == 0 || p.n < 3)
        return area(&p);
    if (count > 1)
        return free_of_several(&p, s, touching, count, e->strips);
    polygon common = p;
    clip_to_polygon(&common, &s->shadows[touching[0]]);
    return d_max(area(&p) - area(&common), 0);
}

static double area_in_sight(const lmg_etendue *e, const sight *s, const rectangle *r, double middle[2])
{
    uint8_t touching[LMG_MAX_SLABS];
    uint32_t count;
    int class = classify(e, s, r, touching, &count);
    if (class < 0)
        return cut_area(e, s, r, touching, count, middle);
    if (middle) {
        middle[0] = 0.5 * (r->u0 + r->u1);
        middle[1] = 0.5 * (r->v0 + r->v1);
    }
    return class ? (r->u1 - r->u0) * (r->v1 - r->v0) : 0;
}

double lmg_etendue_area(const lmg_etendue *e, double u0, double u1, double v0, double v1, lmg_vec3 d, double middle[2])
{
    sight s;
    return look_along(e, d, &s) ? area_in_sight(e, &s, &(rectangle){u0, u1, v0, v1}, middle) : 0;
}

/* ------------------------------------------------------------------------------------------------------------- points */

/* Most points that a slab's cells together are integrated by, where the least that each cell needs is fewer: about a second's work. */
static const double MOST_POINTS = 0x1p27;
/* Points in each of four dimensions where the (s,t) of the slab, or of one above it, isn't the direction alone; and the least. */
enum { MOST_EACH = 6, LEAST_EACH = 2, MOST_STRIPS = 32, LEAST_STRIPS = 4 };

/* Directions in a cell, of one coordinate: about 48 across the whole domain of (s,t), at least 2 and at most 16; what is integrated is
 * continuous, so that the error is a fraction of a percent of cells that are cut at all. */
static int directions_across(double lo, double hi, uint32_t n)
{
    const double domain = 2;
    return (int)d_clamp(ceil((hi - lo) / n / domain * 48), 2, 16);
}

void lmg_own_etendue_plan(lmg_etendue *e)
{
    const lmg_slab *s = e->slab;
    double cells = (double)lmg_slab_cells(s), others = 1.0 + e->higher_count;
    e->directions_s = directions_across(s->s0, s->s1, s->ns);
    e->directions_t = directions_across(s->t0, s->t1, s->nt);
    double wanted = MOST_POINTS / (cells * others);
    e->points = (int)d_clamp(floor(sqrt(sqrt(wanted))), LEAST_EACH, MOST_EACH);
    /* beneath many slabs directions count for what their strips cost */
    if (e->higher_count > 1)
        while (e->directions_s * e->directions_t > 4 && wanted < (double)e->directions_s * e->directions_t * LEAST_STRIPS) {
            e->directions_s = e->directions_s > 2 ? e->directions_s - 1 : 2;
            e->directions_t = e->directions_t > 2 ? e->directions_t - 1 : 2;
        }
    e->strips = (int)d_clamp(wanted / (e->directions_s * e->directions_t), LEAST_STRIPS, MOST_STRIPS);
}

/* Cells of a slab with a second plane at a finite distance, or beneath one: midpoints in all four dimensions, each asked for its owner. */
static double effective_by_points(const lmg_etendue *e, const lmg_cell_box *c, double full)
{
    const lmg_slab *slab = e->slab;
    const int n = e->points;
    double all = 0, own = 0;
    for (int k = 0; k < n * n * n * n; k++) {
        double f[4];
        for (int i = 0, m = k; i < 4; i++, m /= n)
            f[i] = (m % n + 0.5) / n;
        const double uvst[4] = {c->u0 + f[0] * (c->u1 - c->u0), c->v0 + f[1] * (c->v1 - c->v0), c->s0 + f[2] * (c->s1 - c->s0),
                                c->t0 + f[3] * (c->t1 - c->t0)};
        lmg_vec3 x, d;
        lmg_slab_ray(slab, uvst, &x, &d);
        double weight = 1, unused[4], k0, k1;
        if (slab->kind == LMG_SLAB_CUBE) {
            double z = v_dot(d, slab->n);
            if (fabs(v_dot(d, slab->a)) > z || fabs(v_dot(d, slab->b)) > z)
                continue; /* not of this slab's class: not in the full etendue either */
            weight = z * z * z * z;
        }
        all += weight;
        bool free_of_others = true;
        for (uint32_t m = 0; m < e->higher_count && free_of_others; m++)
            free_of_others = !lmg_slab_coordinates(&e->layout->slabs[e->higher[m]], x, d, unused);
        if (free_of_others && (e->inside || lmg_box_interval(e->layout->bounds_min, e->layout->bounds_max, x, d, &k0, &k1)))
            own += weight;
    }
    return all > 0 ? full * own / all : 0;
}

/* Direction number k of those of an (s,t) cell. */
static lmg_vec3 direction_in(const lmg_etendue *e, const lmg_cell_box *c, int k)
{
    const double uvst[4] = {0, 0, c->s0 + (c->s1 - c->s0) * (k % e->directions_s + 0.5) / e->directions_s,
                            c->t0 + (c->t1 - c->t0) * (k / e->directions_s + 0.5) / e->directions_t};
    lmg_vec3 x, d;
    lmg_slab_ray(e->slab, uvst, &x, &d);
    return d;
}

/* ---------------------------------------------------------------------------------------------- all cells of a slab */

/* Marks a cell that nobody wants to know more of than that it's cut. */
static const float UNKNOWN = -1;

typedef struct sharing {
    const lmg_etendue *e;
    bool (*wanted)(const void *self, uint64_t cell);
    const void *self;
    float *share;
} sharing;

/* What one thread keeps: for each (u,v) cell the sum over directions so far. */
typedef struct sharing_sums {
    double *sum;
    sight *sight;
} sharing_sums;

/* Adds a block of (u,v) cells, [i0,i1) x [j0,j1), of one direction. */
static void add_block(const sharing *w, const sharing_sums *sums, uint64_t st, uint32_t i0, uint32_t i1, uint32_t j0, uint32_t j1)
{
    const lmg_etendue *e = w->e;
    const lmg_slab *slab = e->slab;
    const uint64_t cells = (uint64_t)slab->ns * slab->nt;
    const lmg_cell_box lo = lmg_cell_limits(slab, i0, j0, 0, 0), hi = lmg_cell_limits(slab, i1 - 1, j1 - 1, 0, 0);
    const rectangle r = {lo.u0, hi.u1, lo.v0, hi.v1};
    uint8_t touching[LMG_MAX_SLABS];
    uint32_t count;
    int class = classify(e, sums->sight, &r, touching, &count);
    if (class == 0)
        return;
    if (class == 1) {
        for (uint32_t j = j0; j < j1; j++)
            for (uint32_t i = i0; i < i1; i++)
                sums->sum[(size_t)j * slab->nu + i] += sums->sight->weight;
        return;
    }
    if (i1 - i0 > 1 || j1 - j0 > 1) {
        bool by_u = i1 - i0 >= j1 - j0;
        uint32_t mid = by_u ? (i0 + i1) / 2 : (j0 + j1) / 2;
        add_block(w, sums, st, i0, by_u ? mid : i1, j0, by_u ? j1 : mid);
        add_block(w, sums, st, by_u ? mid : i0, i1, by_u ? j0 : mid, j1);
        return;
    }
    size_t at = (size_t)j0 * slab->nu + i0;
    if (!(sums->sum[at] >= 0))
        return;
    if (!w->wanted(w->self, at * cells + st)) {
        sums->sum[at] = -(double)INFINITY;
        return;
    }
    sums->sum[at] += sums->sight->weight * cut_area(e, sums->sight, &r, touching, count, NULL) / ((r.u1 - r.u0) * (r.v1 - r.v0));
}

/* All cells of one (s,t) cell. */
static lmg_result share_piece(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    const sharing *w = self;
    const lmg_etendue *e = w->e;
    const lmg_slab *slab = e->slab;
    sharing_sums *sums = scratch;
    const size_t count = (size_t)slab->nu * slab->nv, cells = (size_t)slab->ns * slab->nt;
    if (!sums->sum && (!(sums->sum = malloc(count * sizeof *sums->sum)) || !(sums->sight = malloc(sizeof *sums->sight))))
        return lmg_fail(err, LMG_ERROR_MEMORY, "etendue: no memory");
    for (size_t i = 0; i < count; i++)
        sums->sum[i] = 0;
    const lmg_cell_box c = lmg_cell_limits(slab, 0, 0, (uint32_t)(index % slab->ns), (uint32_t)(index / slab->ns));
    double all = 0;
    for (int k = 0; k < e->directions_s * e->directions_t; k++) {
        if (!look_along(e, direction_in(e, &c, k), sums->sight))
            continue;
        all += sums->sight->weight;
        add_block(w, sums, index, 0, slab->nu, 0, slab->nv);
    }
    /* No direction of this (s,t) cell is anybody's: a ray that rounding puts there finds the cell whole. */
    const bool seen = all > 0;
    const double whole = seen ? all : 1;
    for (size_t i = 0; i < count; i++)
        w->share[i * cells + index] = sums->sum[i] >= 0 ? (seen ? (float)d_min(sums->sum[i] / whole, 1) : 1) : UNKNOWN;
    return LMG_OK;
}

static void share_end(void *self, void *scratch)
{
    (void)self;
    sharing_sums *sums = scratch;
    free(sums->sum);
    free(sums->sight);
}

lmg_result lmg_etendue_share(lmg_etendue *e, bool (*wanted)(const void *self, uint64_t cell), const void *self, lmg_error *err)
{
    if (lmg_etendue_is_full(e) || (e->aligned_overlap && e->inside) || !e->directions || e->share)
        return LMG_OK;
    e->share_bytes = (size_t)lmg_slab_cells(e->slab) * sizeof *e->share;
    e->share = lmg_table_alloc(e->share_bytes);
    if (!e->share)
        return lmg_fail(err, LMG_ERROR_MEMORY, "etendue: no memory for a table of %zu bytes", e->share_bytes);
    sharing w = {e, wanted, self, e->share};
    lmg_work work = {.piece = share_piece, .end = share_end, .self = &w, .scratch_size = sizeof(sharing_sums),
                     .count = (uint64_t)e->slab->ns * e->slab->nt};
    return lmg_work_do(&work, err);
}

void lmg_etendue_forget_share(lmg_etendue *e)
{
    lmg_table_free(e->share, e->share_bytes);
    e->share = NULL;
}

double lmg_etendue_effective(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    const lmg_slab *slab = e->slab;
    double full = lmg_etendue_full(e, iu, iv, is, it);
    if (lmg_etendue_is_full(e))
        return full;
    if (e->share) {
        float share = e->share[(((uint64_t)iv * slab->nu + iu) * slab->nt + it) * slab->ns + is];
        if (share >= 0)
            return full * (double)share;
    }
    lmg_cell_box c = lmg_cell_limits(slab, iu, iv, is, it);
    if (e->aligned_overlap && e->inside) {
        const lmg_slab *x = &e->layout->slabs[e->higher[0]];
        lmg_cell_box m = {d_max(c.u0, x->u0), d_min(c.u1, x->u1), d_max(c.v0, x->v0), d_min(c.v1, x->v1),
                          d_max(c.s0, x->s0), d_min(c.s1, x->s1), d_max(c.t0, x->t0), d_min(c.t1, x->t1)};
        if (!(m.u0 < m.u1 && m.v0 < m.v1 && m.s0 < m.s1 && m.t0 < m.t1))
            return full;
        return d_max(full - lmg_box_etendue(slab, &m), 0);
    }
    if (!e->directions)
        return effective_by_points(e, &c, full);
    const rectangle r = {c.u0, c.u1, c.v0, c.v1};
    double sum = 0, all = 0;
    sight s;
    for (int k = 0; k < e->directions_s * e->directions_t; k++) {
        if (!look_along(e, direction_in(e, &c, k), &s))
            continue;
        all += s.weight;
        sum += s.weight * area_in_sight(e, &s, &r, NULL);
    }
    return all > 0 ? d_min(full * (sum / (all * (r.u1 - r.u0) * (r.v1 - r.v0))), full) : full;
}
