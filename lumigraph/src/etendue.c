/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Etendue of cells.
 *
 * Aperture slabs: dG = du dv ds dt pi/4, because the concentric map preserves area.
 * Cube slabs: with slopes p, q, dG = du dv dp dq / (1 + p^2 + q^2)^2, whose integral over a rectangle of slopes has the closed form
 *   H(p,q) = 1/2 [ p/sqrt(1+p^2) atan(q/sqrt(1+p^2)) + q/sqrt(1+q^2) atan(p/sqrt(1+q^2)) ]
 * differenced over the corners (it is the corner function of the view factor to a parallel rectangle).  Small rectangles are
 * integrated by Gauss' rule instead, where the differences would cancel.
 * A second plane at a finite distance D: with x = s-u, y = t-v the four-fold integral is that of w(x) w'(y) D^2/(D^2+x^2+y^2)^2, where w(x) is
 * the length of u for which both u and u + x are in the cell: piecewise linear.  Each piece, cut at |x| = D, is smooth: Gauss' rule.
 *
 * What slabs of higher priority own of a cell, and what passes the bounds by, is integrated over direction by the midpoint rule, with
 * the (u,v) area clipped exactly for each direction: both are convex polygons in the (u,v) plane.
 */
#include "etendue.h"
#include "field.h"
#include "geometry.h"

#include <stdlib.h>

/* Gauss-Legendre of four points on [-1,1]. */
static const double GAUSS_X[4] = {-0.86113631159405258, -0.33998104358485626, 0.33998104358485626, 0.86113631159405258};
static const double GAUSS_W[4] = {0.34785484513745386, 0.65214515486254614, 0.65214515486254614, 0.34785484513745386};

static double corner(double p, double q)
{
    double sp = sqrt(1 + p * p), sq = sqrt(1 + q * q);
    return 0.5 * (p / sp * atan(q / sp) + q / sq * atan(p / sq));
}

/* Integral of 1/(1+p^2+q^2)^2 over a rectangle. */
static double slope_rectangle(double p0, double p1, double q0, double q1)
{
    /* Below 1/16 the 4-point rule's error, (h/2)^8 times the eighth derivative over 8!, is under 1e-13 of the value; above it the
     * differences of H lose less than 1e-13. */
    if (p1 - p0 > 1.0 / 16 || q1 - q0 > 1.0 / 16) {
        if (p1 - p0 > 1.0 / 16 && q1 - q0 > 1.0 / 16)
            return corner(p1, q1) - corner(p0, q1) - corner(p1, q0) + corner(p0, q0);
        /* a narrow strip: cut the long side so that Gauss' rule serves */
        bool cut_p = p1 - p0 > q1 - q0;
        double lo = cut_p ? p0 : q0, hi = cut_p ? p1 : q1;
        int pieces = (int)ceil((hi - lo) * 16);
        double sum = 0;
        for (int k = 0; k < pieces; k++) {
            double a = lo + (hi - lo) * k / pieces, b = lo + (hi - lo) * (k + 1) / pieces;
            sum += cut_p ? slope_rectangle(a, b, q0, q1) : slope_rectangle(p0, p1, a, b);
        }
        return sum;
    }
    double cp = 0.5 * (p0 + p1), hp = 0.5 * (p1 - p0), cq = 0.5 * (q0 + q1), hq = 0.5 * (q1 - q0), sum = 0;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            double p = cp + hp * GAUSS_X[i], q = cq + hq * GAUSS_X[j], k = 1 + p * p + q * q;
            sum += GAUSS_W[i] * GAUSS_W[j] / (k * k);
        }
    return sum * hp * hq;
}

/* Nodes x and weights (Gauss weight times w(x)) of one dimension of the finite-distance integral; returns their number. */
enum { FINITE_PIECES = 64, FINITE_NODES = FINITE_PIECES * 4 * 5 };
static int finite_nodes(double u0, double u1, double s0, double s1, double distance, double *x, double *w)
{
    double knots[4] = {s0 - u1, s0 - u0, s1 - u1, s1 - u0};
    if (knots[1] > knots[2]) {
        double swap = knots[1];
        knots[1] = knots[2];
        knots[2] = swap;
    }
    int n = 0;
    for (int k = 0; k < 3; k++) {
        double lo = d_clamp(knots[k], -distance, distance), hi = d_clamp(knots[k + 1], -distance, distance);
        if (!(hi > lo))
            continue;
        /* pieces of at most D/8 (the kernel's scale is D); [-D,D] is 16 of them */
        int pieces = (int)ceil((hi - lo) / distance * 8);
        pieces = pieces < 1 ? 1 : pieces;
        for (int i = 0; i < pieces; i++) {
            double a = lo + (hi - lo) * i / pieces, b = lo + (hi - lo) * (i + 1) / pieces;
            for (int g = 0; g < 4; g++) {
                double xg = 0.5 * (a + b) + 0.5 * (b - a) * GAUSS_X[g];
                double length = fmin(u1, s1 - xg) - fmax(u0, s0 - xg);
                x[n] = xg;
                w[n++] = 0.5 * (b - a) * GAUSS_W[g] * fmax(length, 0);
            }
        }
    }
    return n;
}

static double finite_cell(double u0, double u1, double v0, double v1, double s0, double s1, double t0, double t1, double distance)
{
    double x[FINITE_NODES], wx[FINITE_NODES], y[FINITE_NODES], wy[FINITE_NODES];
    int nx = finite_nodes(u0, u1, s0, s1, distance, x, wx), ny = finite_nodes(v0, v1, t0, t1, distance, y, wy);
    double d2 = distance * distance, sum = 0;
    for (int i = 0; i < nx; i++)
        for (int j = 0; j < ny; j++) {
            double r2 = d2 + x[i] * x[i] + y[j] * y[j];
            sum += wx[i] * wy[j] * d2 / (r2 * r2);
        }
    return sum;
}

typedef struct cell_box {
    double u0, u1, v0, v1, s0, s1, t0, t1;
} cell_box;

static cell_box cell_limits(const lmg_slab *s, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    double du = (s->u1 - s->u0) / s->nu, dv = (s->v1 - s->v0) / s->nv, ds = (s->s1 - s->s0) / s->ns, dt = (s->t1 - s->t0) / s->nt;
    return (cell_box){s->u0 + iu * du, iu + 1 == s->nu ? s->u1 : s->u0 + (iu + 1) * du, s->v0 + iv * dv, iv + 1 == s->nv ? s->v1 : s->v0 + (iv + 1) * dv,
                      s->s0 + is * ds, is + 1 == s->ns ? s->s1 : s->s0 + (is + 1) * ds, s->t0 + it * dt, it + 1 == s->nt ? s->t1 : s->t0 + (it + 1) * dt};
}

/* Etendue of an (s,t) rectangle per unit of (u,v) area, for slabs whose (s,t) is the direction. */
static double direction_rectangle(const lmg_slab *slab, double s0, double s1, double t0, double t1)
{
    if (slab->kind == LMG_SLAB_APERTURE)
        return LMG_PI / 4 * (s1 - s0) * (t1 - t0);
    return slope_rectangle(s0, s1, t0, t1);
}

static bool st_is_direction(const lmg_slab *slab)
{
    return slab->kind == LMG_SLAB_APERTURE || isinf(slab->distance);
}

static double box_etendue(const lmg_slab *slab, const cell_box *c)
{
    if (st_is_direction(slab))
        return (c->u1 - c->u0) * (c->v1 - c->v0) * direction_rectangle(slab, c->s0, c->s1, c->t0, c->t1);
    return finite_cell(c->u0, c->u1, c->v0, c->v1, c->s0, c->s1, c->t0, c->t1, slab->distance);
}

double lmg_slab_cell_etendue(const lmg_slab *slab, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    cell_box c = cell_limits(slab, iu, iv, is, it);
    return box_etendue(slab, &c);
}

/* ------------------------------------------------------------------------------------------------------------ overlaps */

static bool rectangle_within(const lmg_slab *x, const lmg_slab *y)
{
    return x->u0 >= y->u0 && x->u1 <= y->u1 && x->v0 >= y->v0 && x->v1 <= y->v1 && x->s0 >= y->s0 && x->s1 <= y->s1 && x->t0 >= y->t0 &&
           x->t1 <= y->t1;
}

/* Whether rays of slab y can be owned by the earlier slab x: same direction class, or an aperture; in one frame, common coordinates. */
static bool may_overlap(const lmg_slab *x, const lmg_slab *y)
{
    if (x->kind == LMG_SLAB_CUBE && y->kind == LMG_SLAB_CUBE && lmg_direction_class(x->n) != lmg_direction_class(y->n))
        return false;
    if (lmg_same_frame(x, y))
        return x->u0 < y->u1 && x->u1 > y->u0 && x->v0 < y->v1 && x->v1 > y->v0 && x->s0 < y->s1 && x->s1 > y->s0 && x->t0 < y->t1 && x->t1 > y->t0;
    if (x->kind == LMG_SLAB_APERTURE && y->kind == LMG_SLAB_APERTURE)
        return v_dot(x->n, y->n) > -1 + 1e-12;
    if (x->kind != y->kind) {
        lmg_vec3 n = x->kind == LMG_SLAB_CUBE ? x->n : y->n, m = x->kind == LMG_SLAB_CUBE ? y->n : x->n;
        double along = v_dot(n, m), others = fabs(m.x) + fabs(m.y) + fabs(m.z) - fabs(along);
        return along + others > 0; /* as in lmg_plan_prepare */
    }
    return true;
}

/*
 * Whether all lines of the slab pass through the bounds.  True when the (u,v) rectangle is inside the bounds' section: a line through a
 * point of the bounds.  1e-9 of the bounds' diagonal is forgiven: the rounding of corners that were fitted to the bounds themselves.
 */
static bool rectangle_inside_bounds(const lmg_layout *layout, const lmg_slab *s)
{
    double slack = 1e-9 * v_length(v_sub(layout->bounds_max, layout->bounds_min));
    for (int k = 0; k < 4; k++) {
        lmg_vec3 x = v_fma(v_fma(s->o, k & 1 ? s->u1 : s->u0, s->a), k & 2 ? s->v1 : s->v0, s->b);
        for (int i = 0; i < 3; i++)
            if (v_axis(x, i) < v_axis(layout->bounds_min, i) - slack || v_axis(x, i) > v_axis(layout->bounds_max, i) + slack)
                return false;
    }
    return true;
}

lmg_result lmg_etendue_prepare(lmg_etendue *e, const lmg_layout *layout, uint32_t index, lmg_error *err)
{
    const lmg_slab *slab = &layout->slabs[index];
    *e = (lmg_etendue){.layout = layout, .slab = slab, .index = index, .inside = rectangle_inside_bounds(layout, slab)};
    for (uint32_t k = 0; k < index; k++) {
        const lmg_slab *x = &layout->slabs[k];
        bool needed = may_overlap(x, slab);
        /* a window inside a wide slab that is itself of higher priority than this one adds nothing */
        for (uint32_t m = 0; needed && m < index; m++)
            if (m != k && lmg_same_frame(x, &layout->slabs[m]) && rectangle_within(x, &layout->slabs[m]) &&
                !(m > k && rectangle_within(&layout->slabs[m], x)))
                needed = false;
        if (needed)
            e->higher[e->higher_count++] = (uint8_t)k;
    }
    e->aligned_overlap = e->higher_count == 0 || (e->higher_count == 1 && lmg_same_frame(&layout->slabs[e->higher[0]], slab));
    e->directions = st_is_direction(slab);
    for (uint32_t k = 0; k < e->higher_count; k++)
        e->directions = e->directions && st_is_direction(&layout->slabs[e->higher[k]]);
    /* the table serves only where it is small beside the cells it is for */
    size_t count = (size_t)slab->ns * slab->nt;
    if (st_is_direction(slab) && (uint64_t)slab->nu * slab->nv > 1 && count <= (size_t)1 << 24) {
        e->per_area = malloc(count * sizeof *e->per_area);
        if (!e->per_area)
            return lmg_fail(err, LMG_ERROR_MEMORY, "etendue: no memory for a table of %zu cells", count);
        for (uint32_t it = 0; it < slab->nt; it++)
            for (uint32_t is = 0; is < slab->ns; is++) {
                cell_box c = cell_limits(slab, 0, 0, is, it);
                e->per_area[(size_t)it * slab->ns + is] = direction_rectangle(slab, c.s0, c.s1, c.t0, c.t1);
            }
    }
    return LMG_OK;
}

void lmg_etendue_release(lmg_etendue *e)
{
    free(e->per_area);
    *e = (lmg_etendue){0};
}

bool lmg_etendue_is_full(const lmg_etendue *e)
{
    return e->inside && e->higher_count == 0;
}

double lmg_etendue_full(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    cell_box c = cell_limits(e->slab, iu, iv, is, it);
    if (e->per_area)
        return (c.u1 - c.u0) * (c.v1 - c.v0) * e->per_area[(size_t)it * e->slab->ns + is];
    return box_etendue(e->slab, &c);
}

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

/* (u,v) in the slab's plane of the line through point x with direction d. */
static void project(const lmg_slab *slab, lmg_vec3 x, lmg_vec3 d, double dn, double *u, double *v)
{
    lmg_slab_crossing(slab, x, d, dn, u, v);
}

/* Cuts p down to the shadow of the bounds along d: a convex hexagon, the hull of the corners' projections. */
static void clip_to_bounds(polygon *p, const lmg_layout *layout, const lmg_slab *slab, lmg_vec3 d, double dn)
{
    double x[8], y[8];
    for (int k = 0; k < 8; k++) {
        lmg_vec3 c = {k & 1 ? layout->bounds_max.x : layout->bounds_min.x, k & 2 ? layout->bounds_max.y : layout->bounds_min.y,
                      k & 4 ? layout->bounds_max.z : layout->bounds_min.z};
        project(slab, c, d, dn, &x[k], &y[k]);
    }
    /* The hull's edges are parallel to the projected edges of the box, three directions: between the least and greatest of each. */
    for (int axis = 0; axis < 3 && p->n; axis++) {
        double ex = x[1 << axis] - x[0], ey = y[1 << axis] - y[0];
        double lo = INFINITY, hi = -INFINITY;
        for (int k = 0; k < 8; k++) {
            double c = -ey * x[k] + ex * y[k];
            lo = c < lo ? c : lo;
            hi = c > hi ? c : hi;
        }
        clip(p, -ey, ex, lo);
        clip(p, ey, -ex, -hi);
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
        project(slab, v_fma(v_fma(x->o, u[k], x->a), v[k], x->b), d, dn, &shadow->x[k], &shadow->y[k]);
    return true;
}

/* (u,v) area of the cell that light of direction d can use; middle: of its part inside the bounds. */
static double effective_area(const lmg_etendue *e, const cell_box *c, lmg_vec3 d, double middle[2])
{
    polygon p = {4, {c->u0, c->u1, c->u1, c->u0}, {c->v0, c->v0, c->v1, c->v1}}, shadows[LMG_MAX_SLABS];
    double dn = v_dot(d, e->slab->n);
    if (!(dn > 0))
        return 0;
    if (!e->inside)
        clip_to_bounds(&p, e->layout, e->slab, d, dn);
    int count = 0;
    for (uint32_t k = 0; k < e->higher_count && p.n; k++)
        if (shadow_of_slab(&e->layout->slabs[e->higher[k]], e->slab, d, dn, &shadows[count])) {
            polygon common = p;
            clip_to_polygon(&common, &shadows[count]);
            if (common.n >= 3)
                count++;
        }
    double total = area(&p);
    middle[0] = middle[1] = 0;
    for (int i = 0; i < p.n; i++) {
        middle[0] += p.x[i] / p.n;
        middle[1] += p.y[i] / p.n;
    }
    if (count == 0)
        return total;
    if (count == 1) {
        polygon common = p;
        clip_to_polygon(&common, &shadows[0]);
        return fmax(total - area(&common), 0);
    }
    /* Several: cut the polygon into strips and each strip by every shadow; the union's length is taken along the strips' middle lines. */
    enum { STRIPS = 32 };
    double lo = INFINITY, hi = -INFINITY, sum = 0;
    for (int i = 0; i < p.n; i++) {
        lo = fmin(lo, p.y[i]);
        hi = fmax(hi, p.y[i]);
    }
    for (int k = 0; k < STRIPS; k++) {
        double y = lo + (hi - lo) * (k + 0.5) / STRIPS, from[LMG_MAX_SLABS + 1], to[LMG_MAX_SLABS + 1];
        int n = 0;
        for (int m = -1; m < count; m++) {
            const polygon *q = m < 0 ? &p : &shadows[m];
            double a = INFINITY, b = -INFINITY;
            for (int i = 0; i < q->n; i++) {
                int j = i + 1 == q->n ? 0 : i + 1;
                if ((q->y[i] <= y) != (q->y[j] <= y)) {
                    double x = q->x[i] + (y - q->y[i]) / (q->y[j] - q->y[i]) * (q->x[j] - q->x[i]);
                    a = fmin(a, x);
                    b = fmax(b, x);
                }
            }
            from[n] = a;
            to[n++] = b;
        }
        /* walk from the strip's left end over everything that covers it */
        double x = from[0], free_length = 0;
        while (x < to[0]) {
            double next = to[0];
            bool covered = false;
            for (int m = 1; m < n; m++) {
                if (from[m] <= x && to[m] > x) {
                    covered = true;
                    x = to[m];
                    break;
                }
                if (from[m] > x)
                    next = fmin(next, from[m]);
            }
            if (!covered) {
                free_length += next - x;
                x = next;
            }
        }
        sum += free_length * (hi - lo) / STRIPS;
    }
    return sum;
}

double lmg_etendue_area(const lmg_etendue *e, double u0, double u1, double v0, double v1, lmg_vec3 d, double middle[2])
{
    cell_box c = {.u0 = u0, .u1 = u1, .v0 = v0, .v1 = v1};
    return effective_area(e, &c, d, middle);
}

/* Cells of a slab with a second plane at a finite distance, or beneath one: midpoints in all four dimensions, each asked for its owner. */
static double effective_by_points(const lmg_etendue *e, const cell_box *c, double full)
{
    enum { POINTS = 6 };
    const lmg_slab *slab = e->slab;
    double all = 0, own = 0;
    for (int k = 0; k < POINTS * POINTS * POINTS * POINTS; k++) {
        double f[4];
        for (int i = 0, m = k; i < 4; i++, m /= POINTS)
            f[i] = (m % POINTS + 0.5) / POINTS;
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

double lmg_etendue_effective(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    const lmg_slab *slab = e->slab;
    double full = lmg_etendue_full(e, iu, iv, is, it);
    if (lmg_etendue_is_full(e))
        return full;
    cell_box c = cell_limits(slab, iu, iv, is, it);
    if (e->aligned_overlap && e->inside) {
        const lmg_slab *x = &e->layout->slabs[e->higher[0]];
        cell_box m = {fmax(c.u0, x->u0), fmin(c.u1, x->u1), fmax(c.v0, x->v0), fmin(c.v1, x->v1),
                      fmax(c.s0, x->s0), fmin(c.s1, x->s1), fmax(c.t0, x->t0), fmin(c.t1, x->t1)};
        if (!(m.u0 < m.u1 && m.v0 < m.v1 && m.s0 < m.s1 && m.t0 < m.t1))
            return full;
        return fmax(full - box_etendue(slab, &m), 0);
    }
    if (!e->directions)
        return effective_by_points(e, &c, full);
    /* Midpoints in direction, about 48 across the whole domain of (s,t), at least 2 and at most 16 in a cell each way: what is
     * integrated is continuous, so that the error is a fraction of a percent of cells that are cut at all. */
    const double domain = 2;
    int ms = (int)d_clamp(ceil((c.s1 - c.s0) / domain * 48), 2, 16), mt = (int)d_clamp(ceil((c.t1 - c.t0) / domain * 48), 2, 16);
    double sum = 0, all = 0, cell_area = (c.u1 - c.u0) * (c.v1 - c.v0);
    for (int j = 0; j < mt; j++)
        for (int i = 0; i < ms; i++) {
            const double uvst[4] = {0.5 * (c.u0 + c.u1), 0.5 * (c.v0 + c.v1), c.s0 + (c.s1 - c.s0) * (i + 0.5) / ms,
                                    c.t0 + (c.t1 - c.t0) * (j + 0.5) / mt};
            lmg_vec3 x, d;
            lmg_slab_ray(slab, uvst, &x, &d);
            double z = v_dot(d, slab->n), weight = slab->kind == LMG_SLAB_CUBE ? z * z * z * z : 1;
            all += weight;
            double middle[2];
            sum += weight * effective_area(e, &c, d, middle);
        }
    return fmin(full * (sum / (all * cell_area)), full);
}

double lmg_layout_cell_etendue(const lmg_layout *layout, uint32_t slab, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    lmg_etendue e;
    const lmg_slab *s = &layout->slabs[slab];
    /* one cell: the table would be waste, so it is left out by asking for a slab of one (u,v) cell */
    lmg_layout one = *layout;
    one.slabs[slab].nu = one.slabs[slab].nv = 1;
    if (lmg_etendue_prepare(&e, &one, slab, NULL) != LMG_OK)
        return 0; /* can't fail without the table */
    e.layout = layout;
    e.slab = s;
    double result = lmg_etendue_effective(&e, iu, iv, is, it);
    lmg_etendue_release(&e);
    return result;
}
