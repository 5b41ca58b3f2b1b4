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
 * What of a cell is its slab's own stands in own_etendue.c.
 */
#include "etendue.h"
#include "field.h"
#include "geometry.h"
#include "memory.h"

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

lmg_cell_box lmg_cell_limits(const lmg_slab *s, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    double du = (s->u1 - s->u0) / s->nu, dv = (s->v1 - s->v0) / s->nv, ds = (s->s1 - s->s0) / s->ns, dt = (s->t1 - s->t0) / s->nt;
    return (lmg_cell_box){s->u0 + iu * du, iu + 1 == s->nu ? s->u1 : s->u0 + (iu + 1) * du, s->v0 + iv * dv, iv + 1 == s->nv ? s->v1 : s->v0 + (iv + 1) * dv,
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

double lmg_box_etendue(const lmg_slab *slab, const lmg_cell_box *c)
{
    if (st_is_direction(slab))
        return (c->u1 - c->u0) * (c->v1 - c->v0) * direction_rectangle(slab, c->s0, c->s1, c->t0, c->t1);
    return finite_cell(c->u0, c->u1, c->v0, c->v1, c->s0, c->s1, c->t0, c->t1, slab->distance);
}

double lmg_slab_cell_etendue(const lmg_slab *slab, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    lmg_cell_box c = lmg_cell_limits(slab, iu, iv, is, it);
    return lmg_box_etendue(slab, &c);
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
    lmg_own_etendue_plan(e);
    /* the table serves only where it is small beside the cells it is for */
    size_t count = (size_t)slab->ns * slab->nt;
    if (st_is_direction(slab) && (uint64_t)slab->nu * slab->nv > 1 && count <= (size_t)1 << 24) {
        e->per_area = malloc(count * sizeof *e->per_area);
        if (!e->per_area)
            return lmg_fail(err, LMG_ERROR_MEMORY, "etendue: no memory for a table of %zu cells", count);
        for (uint32_t it = 0; it < slab->nt; it++)
            for (uint32_t is = 0; is < slab->ns; is++) {
                lmg_cell_box c = lmg_cell_limits(slab, 0, 0, is, it);
                e->per_area[(size_t)it * slab->ns + is] = direction_rectangle(slab, c.s0, c.s1, c.t0, c.t1);
            }
    }
    return LMG_OK;
}

void lmg_etendue_release(lmg_etendue *e)
{
    free(e->per_area);
    lmg_table_free(e->share, e->share_bytes);
    *e = (lmg_etendue){0};
}

bool lmg_etendue_is_full(const lmg_etendue *e)
{
    return e->inside && e->higher_count == 0;
}

double lmg_etendue_full(const lmg_etendue *e, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it)
{
    lmg_cell_box c = lmg_cell_limits(e->slab, iu, iv, is, it);
    if (e->per_area)
        return (c.u1 - c.u0) * (c.v1 - c.v0) * e->per_area[(size_t)it * e->slab->ns + is];
    return lmg_box_etendue(e->slab, &c);
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
    lmg_own_etendue_plan(&e); /* with the cells there really are */
    double result = lmg_etendue_effective(&e, iu, iv, is, it);
    lmg_etendue_release(&e);
    return result;
}
