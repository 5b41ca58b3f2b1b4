/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Geometry of slabs for the files of this library only: the arithmetic that places a ray, written once and inlined wherever speed
 * counts, so that depositing, looking up and sampling agree to the bit on whose cell a ray is.
 */
#ifndef LUMIGRAPH_GEOMETRY_H
#define LUMIGRAPH_GEOMETRY_H

#include "vec.h"

/*
 * Which of the six classes a direction is in: 2 * axis + (component negative), axis being the one of the largest component by
 * magnitude; equal components: the lowest axis wins, so that every direction is in exactly one class.  -1 for zero or NaN.
 */
static inline int lmg_direction_class(lmg_vec3 d)
{
    double ax = fabs(d.x), ay = fabs(d.y), az = fabs(d.z);
    if (ax >= ay && ax >= az)
        return ax > 0 ? (d.x < 0) : -1;
    if (ay >= az)
        return 2 + (d.y < 0);
    return az > 0 ? 4 + (d.z < 0) : -1;
}

/*
 * Angle of the point (l, m), 0 <= m <= l, over 45 degrees: 4/pi atan(m/l), in [0,1]; 0 where both are.  Above tan(22.5 degrees) it is
 * one less the angle of (l + m, l - m).  The polynomial in the squared tangent (up to tan(22.5)^2) is Chebyshev's, off by less than 1e-17 of
 * the angle before its coefficients were rounded.  Without branches and calls, so that it can be done for many rays at once, and with
 * the same bits on every C library.
 */
static inline double lmg_octant_angle(double m, double l)
{
    bool upper = m > 0.41421356237309503 * l;
    double side = upper ? m - l : m, base = upper ? m + l : l;
    double z = side / d_max(base, 0x1p-1022), q = z * z, q2 = q * q, q4 = q2 * q2;
    double a = (1.2732395447351628 - 0.42441318157838487 * q) + (0.2546479089462799 - 0.18189136345129195 * q) * q2;
    double b = (0.1414710558636348 - 0.11574889314407025 * q) + (0.09793816295200183 - 0.08483533733777557 * q) * q2;
    double c = (0.07444476661415464 - 0.06410891559538259 * q) + (0.04833886711631351 - 0.022670535831656992 * q) * q2;
    double angle = z * (a + q4 * (b + q4 * c));
    return upper ? 1 + angle : angle;
}

/*
 * Concentric map between disc and square [Shirley and Chiu 1997] of the point (x,y)/sqrt(length2); the square's horizontal and vertical wedges are
 * those of |s| >= |t| and the rest.  The angle doesn't wait for the radius: a look-up takes as long as its longest chain of operations.
 */
static inline void lmg_cone_to_square(double x, double y, double length2, double *s, double *t)
{
    double ax = fabs(x), ay = fabs(y);
    bool horizontal = ax >= ay;
    /* Rounding: the ratio is 1 + 4 eps at most. */
    double r = d_min(sqrt((x * x + y * y) / length2), 1), other = r * lmg_octant_angle(horizontal ? ay : ax, horizontal ? ax : ay);
    *s = copysign(horizontal ? r : other, x);
    *t = copysign(horizontal ? other : r, y);
}

/* Inverse; *z is the third direction cosine, stable near the rim. */
static inline void lmg_square_to_disc(double s, double t, double *x, double *y, double *z)
{
    double r;
    if (fabs(s) >= fabs(t)) {
        double phi = s != 0 ? LMG_PI / 4 * (t / s) : 0;
        r = s;
        *x = r * cos(phi);
        *y = r * sin(phi);
    } else {
        double phi = LMG_PI / 4 * (s / t);
        r = t;
        *x = r * sin(phi);
        *y = r * cos(phi);
    }
    double z2 = (1 - r) * (1 + r);
    *z = z2 > 0 ? sqrt(z2) : 0;
}

/* A ray's line in a slab's frame: direction along the axes and the normal, and origin past the plane. */
typedef struct lmg_line {
    double da, db, dn, past;
} lmg_line;

/* Crossing of the line with the (u,v) plane; line->dn = d . n, not zero, is known. */
static inline void lmg_line_crossing(const lmg_slab *slab, lmg_vec3 origin, lmg_vec3 d, lmg_line *line, double *u, double *v)
{
    lmg_vec3 w = v_sub(origin, slab->o);
    line->past = v_dot(w, slab->n);
    line->da = v_dot(d, slab->a);
    line->db = v_dot(d, slab->b);
    double k = -line->past / line->dn;
    *u = v_dot(w, slab->a) + k * line->da;
    *v = v_dot(w, slab->b) + k * line->db;
}

static inline void lmg_slab_crossing(const lmg_slab *slab, lmg_vec3 origin, lmg_vec3 d, double dn, double *u, double *v)
{
    lmg_line line = {.dn = dn};
    lmg_line_crossing(slab, origin, d, &line, u, v);
}

/* (s,t) of direction d in the frame of an aperture slab, */
static inline void lmg_line_aperture_st(lmg_vec3 d, const lmg_line *line, double *s, double *t)
{
    lmg_cone_to_square(line->da, line->db, v_dot(d, d), s, t);
}

/* of a cube slab without second plane: slopes; with one, of the line through (u,v). */
static inline void lmg_line_slope_st(const lmg_line *line, double *s, double *t)
{
    *s = line->da / line->dn;
    *t = line->db / line->dn;
}

static inline void lmg_line_plane_st(const lmg_slab *slab, const lmg_line *line, double u, double v, double *s, double *t)
{
    lmg_line_slope_st(line, s, t);
    *s = u + slab->distance * *s;
    *t = v + slab->distance * *t;
}

/* (s,t) of a line through (u,v) with direction d. */
static inline void lmg_line_st(const lmg_slab *slab, lmg_vec3 d, const lmg_line *line, double u, double v, double *s, double *t)
{
    if (slab->kind == LMG_SLAB_APERTURE)
        lmg_line_aperture_st(d, line, s, t);
    else if (isinf(slab->distance))
        lmg_line_slope_st(line, s, t);
    else
        lmg_line_plane_st(slab, line, u, v, s, t);
}

static inline void lmg_slab_st(const lmg_slab *slab, lmg_vec3 d, double dn, double u, double v, double *s, double *t)
{
    const lmg_line line = {.da = v_dot(d, slab->a), .db = v_dot(d, slab->b), .dn = dn};
    lmg_line_st(slab, d, &line, u, v, s, t);
}

/* Where the range of an (s,t) coordinate ends, exclusive: the end of the coordinate's domain (1 for slopes and squares) is included, as
 * nothing lies beyond. */
static inline double lmg_st_end(const lmg_slab *slab, double hi)
{
    return hi == 1 && (slab->kind == LMG_SLAB_APERTURE || isinf(slab->distance)) ? 1 + 0x1p-52 : hi;
}

static inline bool lmg_in_st(const lmg_slab *slab, double x, double lo, double hi)
{
    return x >= lo && x < lmg_st_end(slab, hi);
}

/* Same plane, axes, kind and second plane, so that coordinates in one are coordinates in the other. */
static inline bool lmg_same_frame(const lmg_slab *x, const lmg_slab *y)
{
    return x->kind == y->kind && x->o.x == y->o.x && x->o.y == y->o.y && x->o.z == y->o.z && x->a.x == y->a.x && x->a.y == y->a.y &&
           x->a.z == y->a.z && x->b.x == y->b.x && x->b.y == y->b.y && x->b.z == y->b.z && x->n.x == y->n.x && x->n.y == y->n.y &&
           x->n.z == y->n.z && (x->kind == LMG_SLAB_APERTURE || x->distance == y->distance);
}

static inline uint64_t lmg_slab_cells(const lmg_slab *slab)
{
    return (uint64_t)slab->nu * slab->nv * slab->ns * slab->nt;
}

/* Index of a coordinate's cell; x is in [lo, lo + cells/scale], where rounding may give `cells` just below the upper border. */
static inline uint32_t lmg_cell_of(double x, double lo, double scale, uint32_t cells)
{
    uint32_t i = (uint32_t)((x - lo) * scale);
    return i < cells ? i : cells - 1;
}

/* A layout made ready for placing many rays: for each direction class the slabs that could own a ray, in order of priority. */
typedef struct lmg_plan {
    const lmg_layout *layout;
    uint8_t count[6];
    uint8_t list[6][LMG_MAX_SLABS];
    uint8_t frame[LMG_MAX_SLABS]; /* slabs with the same number share their coordinates */
    uint8_t classes[LMG_MAX_SLABS]; /* bit c: directions of class c may be the slab's */
    double scale[LMG_MAX_SLABS][4]; /* cells per unit of u,v,s,t */
    double low[LMG_MAX_SLABS][4];   /* where they begin */
    double end[LMG_MAX_SLABS][4];   /* where they end, exclusive: lmg_st_end for (s,t) */
    int32_t last[LMG_MAX_SLABS][4]; /* number of the last cell */
    uint64_t first[LMG_MAX_SLABS + 1]; /* cells in the slabs before */
} lmg_plan;

/* layout is kept (borrowed). */
void lmg_plan_prepare(lmg_plan *plan, const lmg_layout *layout);

/* The slab that owns a ray, or -1, with the ray's coordinates in it and its line in the slab's frame.  Inlined everywhere: passing the ray's six
 * numbers costs as much. */
#if defined(__GNUC__)
__attribute__((always_inline))
#endif
static inline int lmg_plan_owner_line(const lmg_plan *plan, lmg_vec3 origin, lmg_vec3 d, double uvst[4], lmg_line *line)
{
    const int c = lmg_direction_class(d);
    uvst[0] = uvst[1] = uvst[2] = uvst[3] = 0;
    *line = (lmg_line){0};
    if (c < 0)
        return -1;
    int frame = -1;
    bool have_st = false;
    for (uint32_t k = 0; k < plan->count[c]; k++) {
        const int j = plan->list[c][k];
        const lmg_slab *slab = &plan->layout->slabs[j];
        const double *low = plan->low[j], *end = plan->end[j];
        if (plan->frame[j] != frame) {
            frame = plan->frame[j];
            have_st = false;
            line->dn = v_dot(d, slab->n);
            if (line->dn > 0)
                lmg_line_crossing(slab, origin, d, line, &uvst[0], &uvst[1]);
        }
        if (!(line->dn > 0) || !((uvst[0] >= low[0]) & (uvst[0] < end[0]) & (uvst[1] >= low[1]) & (uvst[1] < end[1])))
            continue;
        if (!have_st) {
            lmg_line_st(slab, d, line, uvst[0], uvst[1], &uvst[2], &uvst[3]);
            have_st = true;
        }
        if ((uvst[2] >= low[2]) & (uvst[2] < end[2]) & (uvst[3] >= low[3]) & (uvst[3] < end[3]))
            return j;
    }
    return -1;
}

#if defined(__GNUC__)
__attribute__((always_inline))
#endif
static inline int lmg_plan_owner(const lmg_plan *plan, lmg_vec3 origin, lmg_vec3 d, double uvst[4])
{
    lmg_line line;
    return lmg_plan_owner_line(plan, origin, d, uvst, &line);
}

/* Cell number within its slab of coordinates in slab j. */
static inline uint64_t lmg_plan_cell(const lmg_plan *plan, int j, const double uvst[4])
{
    const lmg_slab *slab = &plan->layout->slabs[j];
    const double *scale = plan->scale[j];
    uint64_t iu = lmg_cell_of(uvst[0], slab->u0, scale[0], slab->nu), iv = lmg_cell_of(uvst[1], slab->v0, scale[1], slab->nv);
    uint64_t is = lmg_cell_of(uvst[2], slab->s0, scale[2], slab->ns), it = lmg_cell_of(uvst[3], slab->t0, scale[3], slab->nt);
    return ((iv * slab->nu + iu) * slab->nt + it) * slab->ns + is;
}

/* Where the line origin + k d is inside a box: [*k0, *k1]; false if nowhere.  d may have zero components. */
static inline bool lmg_box_interval(lmg_vec3 lo, lmg_vec3 hi, lmg_vec3 origin, lmg_vec3 d, double *k0, double *k1)
{
    double a = -INFINITY, b = INFINITY;
    for (int i = 0; i < 3; i++) {
        double x = v_axis(origin, i), dx = v_axis(d, i), l = v_axis(lo, i), h = v_axis(hi, i);
        if (dx == 0) {
            if (x < l || x > h)
                return false;
            continue;
        }
        /* without branches on signs, which nobody can predict, and with one division */
        double inv = 1 / dx, ka = (l - x) * inv, kb = (h - x) * inv;
        a = d_max(a, d_min(ka, kb));
        b = d_min(b, d_max(ka, kb));
    }
    *k0 = a;
    *k1 = b;
    return a <= b;
}

static inline bool lmg_box_contains(lmg_vec3 lo, lmg_vec3 hi, lmg_vec3 p)
{
    return p.x > lo.x && p.x < hi.x && p.y > lo.y && p.y < hi.y && p.z > lo.z && p.z < hi.z;
}

/* Whether light of directions d with d . n > 0 can come out of the bounds before it reaches a point: not if all of them are ahead. */
static inline bool lmg_box_behind(lmg_vec3 lo, lmg_vec3 hi, lmg_vec3 n, lmg_vec3 point)
{
    double least = (n.x > 0 ? lo.x : hi.x) * n.x + (n.y > 0 ? lo.y : hi.y) * n.y + (n.z > 0 ? lo.z : hi.z) * n.z;
    return v_dot(point, n) > least;
}

/*
 * Whether a point on a ray is downstream, where light recorded for the ray's line has already come out of the luminaire.  Outside the
 * bounds: going back along the ray one comes through the bounds; the slab's plane may still lie ahead, beside the bounds.  Inside
 * the bounds (a desk lamp's arm makes them large): the ray has crossed the slab's (u,v) plane, past = (point - plane) . n >= 0.
 */
static inline bool lmg_downstream(const lmg_layout *layout, lmg_vec3 point, lmg_vec3 d, double past)
{
    double k0, k1;
    if (!lmg_box_interval(layout->bounds_min, layout->bounds_max, point, d, &k0, &k1))
        return false;
    if (k1 <= 0)
        return true;
    return k0 < 0 && past >= 0;
}

#endif
