/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Asking a field: radiance along a ray, illuminance at a point, intensity in a direction.  All three see the same thing: radiance
 * linear within a cell as slopes.h says, in the rays that the cell's slab owns and that come out of the bounds.
 */
#include "cell_sum.h"
#include "trees.h"

#include <float.h>
#include <stdlib.h>

/* --------------------------------------------------------------------------------------------------------- radiance */

/* Multilinear between the centres of the cells around; beyond the outermost centres it stays constant. */
static void linear(const lmg_field *field, int j, double u, double v, double s, double t, float rgb[3], float *standard_error)
{
    const double uvst[4] = {u, v, s, t};
    const lmg_slab *slab = &field->layout.slabs[j];
    const double low[4] = {slab->u0, slab->v0, slab->s0, slab->t0}, *scale = field->sampler->plan.scale[j];
    const uint32_t n[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
    uint64_t i0[4], i1[4];
    double f[4], sum[3] = {0}, variance = 0;
    for (int k = 0; k < 4; k++) {
        double x = d_clamp((uvst[k] - low[k]) * scale[k] - 0.5, 0, n[k] - 1);
        i0[k] = (uint64_t)x;
        i1[k] = i0[k] + 1 < n[k] ? i0[k] + 1 : i0[k];
        f[k] = x - (double)i0[k];
    }
    for (int corner = 0; corner < 16; corner++) {
        uint64_t i[4];
        double w = 1;
        for (int k = 0; k < 4; k++) {
            bool up = corner >> k & 1;
            i[k] = up ? i1[k] : i0[k];
            w *= up ? f[k] : 1 - f[k];
        }
        if (w == 0)
            continue;
        uint64_t cell = ((i[1] * slab->nu + i[0]) * slab->nt + i[3]) * slab->ns + i[2];
        float c[3];
        lmg_cell_mean(field, (uint32_t)j, cell, c);
        for (int k = 0; k < 3; k++)
            sum[k] += w * (double)c[k];
        double se = (double)field->slabs[j].standard_error[cell];
        variance += w * w * se * se;
    }
    for (int k = 0; k < 3; k++)
        rgb[k] = (float)sum[k];
    if (standard_error)
        *standard_error = (float)sqrt(variance);
}

/* Radiance by the trees, in the colour of the cells; false where there are none. */
static bool from_trees(const lmg_field *field, int j, const double uvst[4], lmg_vec3 origin, lmg_vec3 direction, float rgb[3],
                       float *standard_error)
{
    float at[4];
    const int root = lmg_trees_root(field->trees, &field->layout, origin, direction, at);
    if (root < 0)
        return false;
    const float *colour = field->trees->roots[root].colour;
    double variance = 0, of_cells = 0;
    if (field->layout.channels == 3) {
        linear(field, j, uvst[0], uvst[1], uvst[2], uvst[3], rgb, NULL);
        of_cells = lmg_luminance(rgb);
    }
    const double luminance = lmg_trees_luminance(field->trees, root, at, standard_error ? &variance : NULL);
    for (int c = 0; c < 3; c++) {
        const double x = luminance * (of_cells > 0 ? (double)rgb[c] / of_cells : (double)colour[c]);
        rgb[c] = (float)fmax(fmin(x, (double)FLT_MAX), -(double)FLT_MAX); /* colours of files needn't be possible */
    }
    if (standard_error)
        *standard_error = variance <= DBL_MAX ? (float)fmin(sqrt(variance), (double)FLT_MAX) : FLT_MAX;
    return true;
}

LMG_WIDE void lmg_field_radiance(const lmg_field *field, lmg_vec3 origin, lmg_vec3 direction, lmg_filter filter, float rgb[3],
                                 float *standard_error)
{
    double uvst[4];
    rgb[0] = rgb[1] = rgb[2] = 0;
    if (standard_error)
        *standard_error = 0;
    const lmg_plan *plan = &field->sampler->plan;
    lmg_line line;
    const int j = lmg_plan_owner_line(plan, origin, direction, uvst, &line);
    if (j < 0)
        return;
    /* the cell is asked for before it's known to be needed: the access to memory is what takes time */
    const lmg_place place = lmg_plan_place(plan, j, uvst);
    lmg_place_prefetch(field, (uint32_t)j, &place);
    /* a line that crosses its plane within the bounds is downstream past the crossing, wherever it leaves them */
    if (field->sampler->etendue[j].inside ? !(line.past >= 0) : !lmg_downstream(&field->layout, origin, direction, line.past))
        return;
    if (filter == LMG_LINEAR) {
        if (!field->trees || !from_trees(field, j, uvst, origin, direction, rgb, standard_error))
            linear(field, j, uvst[0], uvst[1], uvst[2], uvst[3], rgb, standard_error);
        return;
    }
    lmg_place_rgb(field, (uint32_t)j, &place, rgb);
    if (standard_error)
        *standard_error = field->slabs[j].standard_error[place.cell];
}

bool lmg_field_enter(const lmg_field *field, lmg_vec3 origin, lmg_vec3 direction, double *t)
{
    double k0, k1;
    if (!lmg_box_interval(field->layout.bounds_min, field->layout.bounds_max, origin, direction, &k0, &k1) || !(k0 > 0))
        return false;
    *t = k0;
    return true;
}

/* ------------------------------------------------------------------------------------------------------- illuminance */

/*
 * dE = L cos(receiver) cos(plane) / r^2 du dv over the planes, L smooth within cells.  The plane is cut into rectangles along the
 * borders of (u,v) cells and, of cube slabs, along the lines where the ray to the point passes from one (s,t) cell into the next: s
 * depends on u alone there and t on v alone, so that each rectangle sees one cell, exactly.  All is smooth there and integrated by
 * Gauss' rule of 2 x 2 points on pieces small beside their distance: relative error below 1e-4 for cube slabs (measured, as the
 * next).  Of aperture slabs the (s,t) borders are curved: there pieces are also small beside the (s,t) cells as seen from the
 * point, and each is shared among the cells that its lines' (s,t) cover: some 5e-4 (RMS over points before the sample lamps).
 * Where others own parts of the plane, or lines pass the bounds by, pieces on the border are quartered until it doesn't matter.
 * So nothing of weight hangs on which side of a border a point falls to: the sum moves as little as what is asked.
 */
typedef struct cuts {
    double *x;
    size_t count;
} cuts;

static int by_size(const void *p, const void *q)
{
    double a = *(const double *)p, b = *(const double *)q;
    return (a > b) - (a < b);
}

/* Cuts of one axis within [lo,hi]: n cells on [c0,c1]; m cells on [s0,s1] of s = foot + slope (x - foot), where the (s,t) borders
 * are straight. */
static bool cut_axis(cuts *c, double lo, double hi, double c0, double c1, uint32_t n, bool straight, double foot, double at_foot,
                     double slope, double s0, double s1, uint32_t m)
{
    *c = (cuts){malloc(((size_t)n + (straight ? m : 0) + 4) * sizeof(double)), 0};
    if (!c->x)
        return false;
    c->x[c->count++] = lo;
    c->x[c->count++] = hi;
    for (uint32_t i = 0; i <= n; i++) {
        double x = c0 + (c1 - c0) * i / n;
        if (x > lo && x < hi)
            c->x[c->count++] = x;
    }
    for (uint32_t i = 0; straight && slope != 0 && i <= m; i++) {
        double x = foot + (s0 + (s1 - s0) * i / m - at_foot) / slope;
        if (x > lo && x < hi)
            c->x[c->count++] = x;
    }
    qsort(c->x, c->count, sizeof *c->x, by_size);
    return true;
}

/* Most pieces of a rectangle each way. */
enum { MAX_PIECES = 256 };

/* Layouts make whole numbers of them wanted; those are to stay what they are when rounding makes them a little more. */
static int pieces(double wanted)
{
    return (int)d_clamp(ceil(wanted * (1 - 0x1p-30)), 1, MAX_PIECES);
}

/* Pieces for a width of so many (s,t) cells with curved borders: five to two cells; of many, whose errors cancel, one to each more. */
static double pieces_across(double cells)
{
    return cells < 3 ? 2.5 * cells : 4.5 + cells;
}

/* What the integration over one slab's plane shares. */
typedef struct integral {
    const lmg_field *field;
    uint32_t j;
    const lmg_slab *slab;
    lmg_vec3 point, normal;
    double h;   /* of the point past the plane; negative: before it */
    bool whole; /* every line is the slab's own and comes out of the bounds before the point, but for those of the window */
    const lmg_slab *window; /* the one slab of higher priority in the same frame, told by coordinates; NULL: none, or several */
    lmg_cell_sum *sum;
} integral;

/* The light's line from (u,v) to the point, of any length. */
static inline lmg_vec3 line_from(const integral *q, double u, double v)
{
    lmg_vec3 from = v_fma(v_fma(q->slab->o, u, q->slab->a), v, q->slab->b);
    return q->h < 0 ? v_sub(from, q->point) : v_sub(q->point, from);
}

/*
 * Whether a rectangle of one (u,v) cell, of sides a, b from (u0,v0), sees only (s,t) cells without light.  Its directions differ
 * from its middle's by an angle of at most pi/2 times half its diagonal over its least distance.  (s,t) is their direction cosines
 * in the square, whose map stretches by at most sqrt(1 + (4/pi)^2) = 1.62; of cube slabs one cell, the middle's.
 */
static bool sees_none(const integral *q, uint64_t iu, uint64_t iv, double u0, double v0, double a, double b, double nearest)
{
    const lmg_slab *slab = q->slab;
    const double *scale = q->field->sampler->plan.scale[q->j];
    const uint16_t *lit = q->field->sampler->slopes[q->j].lit[iv * slab->nu + iu];
    if (lit[0] > lit[1])
        return true;
    double margin = slab->kind == LMG_SLAB_CUBE ? 0 : LMG_PI / 2 * 1.62 * 0.5 * hypot(a, b) / nearest, s, t;
    lmg_vec3 middle = line_from(q, u0 + 0.5 * a, v0 + 0.5 * b);
    lmg_slab_st(slab, middle, v_dot(middle, slab->n), u0 + 0.5 * a, v0 + 0.5 * b, &s, &t);
    return (s + margin - slab->s0) * scale[2] < lit[0] || (s - margin - slab->s0) * scale[2] > lit[1] + 1 ||
           (t + margin - slab->t0) * scale[3] < lit[2] || (t - margin - slab->t0) * scale[3] > lit[3] + 1;
}

/* Whether the line through (u,v) carries light to the point that no slab of higher priority owns; the window is left to
 * add_rectangle. */
static bool is_own(const integral *q, double u, double v)
{
    const lmg_layout *layout = &q->field->layout;
    const lmg_etendue *e = &q->field->sampler->etendue[q->j];
    lmg_vec3 d = line_from(q, u, v), from = v_fma(v_fma(q->slab->o, u, q->slab->a), v, q->slab->b);
    bool own = lmg_downstream(layout, q->point, d, q->h);
    for (uint32_t k = 0; own && k < e->higher_count; k++) {
        const lmg_slab *x = &layout->slabs[e->higher[k]];
        double uvst[4];
        own = x == q->window || !lmg_slab_coordinates(x, from, d, uvst);
    }
    return own;
}

/* Where x, counted in cells, is within cell i: from -1 to 1. */
static inline float within(double x, double i)
{
    return (float)(2 * (x - i) - 1);
}

/* Coordinates that a rectangle's lines cover along one axis. */
typedef struct span {
    double lo, hi;
} span;

static inline double overlap(span x, double lo, double hi)
{
    return d_max(d_min(x.hi, hi) - d_max(x.lo, lo), 0);
}

/*
 * Span of (s,t) coordinates from those at the rectangle's corners, as wide as evenly spread ones of the same variance.  At least
 * 2^-32 of a cell wide, so that rounding moves little of what lies on a border; nothing lies beyond +-1.
 */
static span span_of(const double at[4], double scale)
{
    double along = 0.5 * (at[1] + at[3] - at[0] - at[2]), across = 0.5 * (at[2] + at[3] - at[0] - at[1]);
    double middle = 0.25 * (at[0] + at[1] + at[2] + at[3]),
           half = 0.5 * d_max(sqrt(along * along + across * across), 0x1p-32 / scale);
    return (span){d_max(middle - half, -1), d_min(middle + half, 1)};
}

/* Adds a rectangle of one (u,v) cell of an aperture slab, whose middle is at x, y in it, to the (s,t) cells that its lines cover.
 */
static bool add_shared(const integral *q, uint64_t iu, uint64_t iv, double u0, double v0, double width, double height, double x,
                       double y, double weight)
{
    const lmg_slab *slab = q->slab, *window = q->window;
    const double *scale = q->field->sampler->plan.scale[q->j];
    double s[4], t[4];
    for (int k = 0; k < 4; k++) {
        double u = u0 + (k % 2) * width, v = v0 + (k / 2) * height;
        lmg_vec3 d = line_from(q, u, v);
        lmg_slab_st(slab, d, v_dot(d, slab->n), u, v, &s[k], &t[k]);
    }
    span a = span_of(s, scale[2]), b = span_of(t, scale[3]);
    double all = weight / ((a.hi - a.lo) * (b.hi - b.lo)), windowed = 0;
    if (window)
        windowed = overlap((span){u0, u0 + width}, window->u0, window->u1) / width *
                   overlap((span){v0, v0 + height}, window->v0, window->v1) / height;
    if (!(a.hi > slab->s0 && a.lo < slab->s1 && b.hi > slab->t0 && b.lo < slab->t1))
        return true;
    /* of the cells only the first's lower and the last's upper border are the slab's own ends */
    uint32_t is0 = lmg_cell_of(d_max(a.lo, slab->s0), slab->s0, scale[2], slab->ns),
             is1 = lmg_cell_of(d_min(a.hi, slab->s1), slab->s0, scale[2], slab->ns);
    uint32_t it0 = lmg_cell_of(d_max(b.lo, slab->t0), slab->t0, scale[3], slab->nt),
             it1 = lmg_cell_of(d_min(b.hi, slab->t1), slab->t0, scale[3], slab->nt);
    for (uint32_t it = it0; it <= it1; it++)
        for (uint32_t is = is0; is <= is1; is++) {
            span p = {d_max(a.lo, slab->s0 + is / scale[2]), d_min(a.hi, slab->s0 + (is + 1) / scale[2])};
            span r = {d_max(b.lo, slab->t0 + it / scale[3]), d_min(b.hi, slab->t0 + (it + 1) / scale[3])};
            if (!(p.hi > p.lo && r.hi > r.lo))
                continue;
            double share = (p.hi - p.lo) * (r.hi - r.lo);
            if (windowed > 0)
                share -= windowed * overlap(p, window->s0, window->s1) * overlap(r, window->t0, window->t1);
            const lmg_place place = {((iv * slab->nu + iu) * slab->nt + it) * slab->ns + is,
                                     it * slab->ns + is,
                                     {(float)x, (float)y, within((0.5 * (p.lo + p.hi) - slab->s0) * scale[2], is),
                                      within((0.5 * (r.lo + r.hi) - slab->t0) * scale[3], it)}};
            if (share > 0 && !lmg_cell_sum_add(q->sum, q->field, q->j, &place, all * share))
                return false;
        }
    return true;
}

/* Adds a rectangle by Gauss' 2 x 2 points, all in the (u,v) cell iu, iv and, of cube slabs, in one (s,t) cell. */
static bool add_rectangle(const integral *q, uint64_t iu, uint64_t iv, double u0, double v0, double width, double height, bool each)
{
    static const double at[2] = {0.21132486540518712, 0.78867513459481288};
    const lmg_slab *slab = q->slab, *window = q->window;
    const double *scale = q->field->sampler->plan.scale[q->j];
    bool cube = slab->kind == LMG_SLAB_CUBE;
    double middle_s = 0, middle_t = 0, all = 0, x = 0, y = 0;
    if (cube) {
        /* the cell by the rectangle's middle, where no rounding can cross a border */
        double mu = u0 + 0.5 * width, mv = v0 + 0.5 * height;
        lmg_vec3 middle = line_from(q, mu, mv);
        lmg_slab_st(slab, middle, v_dot(middle, slab->n), mu, mv, &middle_s, &middle_t);
        if (!lmg_in_st(slab, middle_s, slab->s0, slab->s1) || !lmg_in_st(slab, middle_t, slab->t0, slab->t1))
            return true;
    }
    for (int k = 0; k < 4; k++) {
        double u = u0 + at[k % 2] * width, v = v0 + at[k / 2] * height;
        lmg_vec3 d = line_from(q, u, v);
        double facing = -v_dot(d, q->normal), r2 = v_dot(d, d), weight = 0.25 * width * height * facing * fabs(q->h) / (r2 * r2), s,
               t;
        if (!(facing > 0) || (each && !is_own(q, u, v)))
            continue;
        float cu = within((u - slab->u0) * scale[0], (double)iu), cv = within((v - slab->v0) * scale[1], (double)iv);
        if (!cube) {
            all += weight;
            x += weight * (double)cu;
            y += weight * (double)cv;
            continue;
        }
        if (window && u >= window->u0 && u < window->u1 && v >= window->v0 && v < window->v1 &&
            lmg_in_st(window, middle_s, window->s0, window->s1) && lmg_in_st(window, middle_t, window->t0, window->t1))
            continue;
        lmg_slab_st(slab, d, v_dot(d, slab->n), u, v, &s, &t);
        uint32_t is = lmg_cell_of(middle_s, slab->s0, scale[2], slab->ns), it = lmg_cell_of(middle_t, slab->t0, scale[3], slab->nt);
        const lmg_place place = {((iv * slab->nu + iu) * slab->nt + it) * slab->ns + is,
                                 it * slab->ns + is,
                                 {cu, cv, within((s - slab->s0) * scale[2], is), within((t - slab->t0) * scale[3], it)}};
        if (!lmg_cell_sum_add(q->sum, q->field, q->j, &place, weight))
            return false;
    }
    return !(all > 0) || add_shared(q, iu, iv, u0, v0, width, height, x / all, y / all, all);
}

/* Levels by which a piece across a border of what the slab owns is quartered; in slabs with little of the light. */
enum { BORDER_LEVELS = 6, FAINT_BORDER_LEVELS = 3 };
static const double FAINT = 0.01;

static bool add_piece(const integral *q, uint64_t iu, uint64_t iv, double u0, double v0, double width, double height, int levels)
{
    if (q->whole)
        return add_rectangle(q, iu, iv, u0, v0, width, height, false);
    /* corners a little within: pieces end where bounds and rectangles do, and which side those belong to is a matter of rounding */
    int own = is_own(q, u0 + 0.5 * width, v0 + 0.5 * height);
    for (int k = 0; k < 4; k++)
        own += is_own(q, u0 + (k % 2 ? 1 - 0x1p-16 : 0x1p-16) * width, v0 + (k / 2 ? 1 - 0x1p-16 : 0x1p-16) * height);
    if (own == 0)
        return true;
    if (own == 5 || levels == 0)
        return add_rectangle(q, iu, iv, u0, v0, width, height, own != 5);
    for (int k = 0; k < 4; k++)
        if (!add_piece(q, iu, iv, u0 + 0.5 * width * (k % 2), v0 + 0.5 * height * (k / 2), 0.5 * width, 0.5 * height, levels - 1))
            return false;
    return true;
}

static lmg_result illuminance_of_slab(const lmg_field *field, uint32_t j, lmg_vec3 point, lmg_vec3 normal, double rgb[3],
                                      double *variance, lmg_cell_sum *sum, bool everywhere, lmg_error *err)
{
    const lmg_slab *slab = &field->layout.slabs[j];
    const lmg_etendue *e = &field->sampler->etendue[j];
    const double *scale = field->sampler->plan.scale[j];
    lmg_vec3 w = v_sub(point, slab->o), extent = v_sub(field->layout.bounds_max, field->layout.bounds_min);
    double h = v_dot(w, slab->n), pu = v_dot(w, slab->a), pv = v_dot(w, slab->b);
    /* Nearer to an aperture's plane than a 64th of a cell, what is integrated is a spike between the points of the rule (of cube
     * slabs the cuts follow it): such a point counts as one at that distance, where it sees the same cells. */
    double least = d_max((slab->u1 - slab->u0) / slab->nu, (slab->v1 - slab->v0) / slab->nv) * (4.0 / MAX_PIECES);
    if (slab->kind == LMG_SLAB_APERTURE && h != 0 && fabs(h) < least) {
        double at = h < 0 ? -least : least;
        point = v_fma(point, at - h, slab->n);
        h = at;
    }
    bool within = lmg_box_contains(field->layout.bounds_min, field->layout.bounds_max, point);
    /* A plane that lies ahead of the light (h < 0) counts for points beside the bounds, and only where it sticks out of them. */
    if (h == 0 || field->slabs[j].flux == 0 ||
        (h < 0 && (e->inside || within || !lmg_box_behind(field->layout.bounds_min, field->layout.bounds_max, slab->n, point))))
        return LMG_OK;
    const lmg_slab *window = NULL;
    uint32_t windows = 0;
    for (uint32_t k = 0; k < e->higher_count; k++)
        if (lmg_same_frame(&field->layout.slabs[e->higher[k]], slab)) {
            window = &field->layout.slabs[e->higher[k]];
            windows++;
        }
    window = windows == 1 ? window : NULL;
    bool whole = e->inside && e->higher_count == windows && windows <= 1 && (!within || h > 0);
    const integral q = {field, j, slab, point, normal, h, whole, window, sum};
    int levels = field->slabs[j].flux < FAINT * field->sampler->flux ? FAINT_BORDER_LEVELS : BORDER_LEVELS;
    /* cube slabs: only the part of the plane seen at slopes up to 1 */
    bool cube = slab->kind == LMG_SLAB_CUBE;
    double reach = cube ? fabs(h) : (double)INFINITY;
    double u0 = d_max(slab->u0, pu - reach), u1 = d_min(slab->u1, pu + reach), v0 = d_max(slab->v0, pv - reach),
           v1 = d_min(slab->v1, pv + reach);
    if (!(u1 > u0 && v1 > v0))
        return LMG_OK;
    /* s = (pu - u) / h, or u + D (pu - u) / h; at u = pu it is 0 or pu */
    bool slopes = isinf(slab->distance);
    double slope = slopes ? -1 / h : 1 - slab->distance / h;
    cuts cu, cv = {0};
    lmg_result r = LMG_OK;
    if (!cut_axis(&cu, u0, u1, slab->u0, slab->u1, slab->nu, cube, pu, slopes ? 0 : pu, slope, slab->s0, slab->s1, slab->ns) ||
        !cut_axis(&cv, v0, v1, slab->v0, slab->v1, slab->nv, cube, pv, slopes ? 0 : pv, slope, slab->t0, slab->t1, slab->nt)) {
        r = lmg_fail(err, LMG_ERROR_MEMORY, "illuminance: no memory");
        goto cleanup;
    }
    for (size_t y = 0; r == LMG_OK && y + 1 < cv.count; y++)
        for (size_t x = 0; r == LMG_OK && x + 1 < cu.count; x++) {
            double a0 = cu.x[x], a = cu.x[x + 1] - a0, b0 = cv.x[y], b = cv.x[y + 1] - b0;
            if (!(a > 0 && b > 0))
                continue;
            double du = d_clamp(pu, a0, a0 + a) - pu, dv = d_clamp(pv, b0, b0 + b) - pv, nearest = sqrt(h * h + du * du + dv * dv);
            uint64_t iu = lmg_cell_of(a0 + 0.5 * a, slab->u0, scale[0], slab->nu),
                     iv = lmg_cell_of(b0 + 0.5 * b, slab->v0, scale[1], slab->nv);
            if (!everywhere && sees_none(&q, iu, iv, a0, b0, a, b, nearest))
                continue;
            double wanted_u = 4 * a / nearest, wanted_v = 4 * b / nearest;
            if (!q.whole) {
                /* nothing of the bounds' shadow is to slip through between corners and middle */
                wanted_u = d_max(wanted_u, 12 * a / fabs(v_dot(extent, slab->a)));
                wanted_v = d_max(wanted_v, 12 * b / fabs(v_dot(extent, slab->b)));
            }
            if (!cube) {
                wanted_u = d_max(wanted_u, pieces_across(a / nearest * scale[2]));
                wanted_v = d_max(wanted_v, pieces_across(b / nearest * scale[3]));
            }
            int nx = pieces(wanted_u), ny = pieces(wanted_v);
            for (int m = 0; m < ny; m++)
                for (int k = 0; k < nx; k++)
                    if (!add_piece(&q, iu, iv, a0 + a * k / nx, b0 + b * m / ny, a / nx, b / ny, levels))
                        r = lmg_fail(err, LMG_ERROR_MEMORY, "illuminance: no memory");
        }
    lmg_cell_sum_flush(sum, field, j, rgb, variance);
cleanup:
    free(cu.x);
    free(cv.x);
    return r;
}

lmg_result lmg_field_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, double rgb[3], double *standard_error,
                                 lmg_error *err)
{
    return lmg_illuminance(field, point, normal, false, rgb, standard_error, err);
}

lmg_result lmg_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, bool everywhere, double rgb[3],
                           double *standard_error, lmg_error *err)
{
    double variance = 0;
    lmg_cell_sum sum = {.errors = standard_error != NULL};
    rgb[0] = rgb[1] = rgb[2] = 0;
    if (standard_error)
        *standard_error = 0;
    if (!v_finite(point) || !(fabs(v_length(normal) - 1) < 1e-6))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "illuminance: the point must be finite and the normal (%g %g %g) of length 1",
                        normal.x, normal.y, normal.z);
    lmg_result r = LMG_OK;
    for (uint32_t j = 0; r == LMG_OK && j < field->layout.slab_count; j++)
        r = illuminance_of_slab(field, j, point, normal, rgb, &variance, &sum, everywhere, err);
    lmg_cell_sum_free(&sum);
    if (r == LMG_OK && standard_error)
        *standard_error = sqrt(variance);
    return r;
}

lmg_result lmg_field_intensity(const lmg_field *field, lmg_vec3 direction, double rgb[3], double *standard_error, lmg_error *err)
{
    double variance = 0;
    lmg_cell_sum sum = {.errors = standard_error != NULL};
    lmg_result r = LMG_OK;
    rgb[0] = rgb[1] = rgb[2] = 0;
    if (standard_error)
        *standard_error = 0;
    if (!(fabs(v_length(direction) - 1) < 1e-6))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "intensity: the direction (%g %g %g) must have length 1", direction.x, direction.y,
                        direction.z);
    const lmg_plan *plan = &field->sampler->plan;
    int class = lmg_direction_class(direction);
    for (uint32_t j = 0; j < field->layout.slab_count; j++) {
        const lmg_slab *slab = &field->layout.slabs[j];
        const lmg_etendue *e = &field->sampler->etendue[j];
        double dn = v_dot(direction, slab->n);
        if (!(dn > 0) || field->slabs[j].flux == 0 || (slab->kind == LMG_SLAB_CUBE && class != lmg_direction_class(slab->n)))
            continue;
        /* One direction: a cell counts with the (u,v) area that is its own; where (s,t) isn't the direction alone, by 24 x 24
         * points. */
        bool full = lmg_etendue_is_full(e);
        int pieces_each = e->directions ? 1 : 24;
        double width = 1 / (plan->scale[j][0] * pieces_each), height = 1 / (plan->scale[j][1] * pieces_each);
        for (uint32_t iv = 0; iv < slab->nv; iv++)
            for (uint32_t iu = 0; iu < slab->nu; iu++) {
                for (int k = 0; k < pieces_each * pieces_each; k++) {
                    double u0 = slab->u0 + width * (iu * (uint32_t)pieces_each + (uint32_t)(k % pieces_each));
                    double v0 = slab->v0 + height * (iv * (uint32_t)pieces_each + (uint32_t)(k / pieces_each));
                    double u = u0 + 0.5 * width, v = v0 + 0.5 * height, uvst[4] = {u, v, 0, 0}, own[4], k0, k1,
                           piece = width * height;
                    lmg_vec3 from = v_fma(v_fma(slab->o, u, slab->a), v, slab->b);
                    lmg_slab_st(slab, direction, dn, u, v, &uvst[2], &uvst[3]);
                    if (!lmg_in_st(slab, uvst[2], slab->s0, slab->s1) || !lmg_in_st(slab, uvst[3], slab->t0, slab->t1))
                        continue;
                    if (!full && e->directions)
                        piece = lmg_etendue_area(e, u0, u0 + width, v0, v0 + height, direction, own);
                    else if (!full &&
                             (lmg_plan_owner(plan, from, direction, own) != (int)j ||
                              !lmg_box_interval(field->layout.bounds_min, field->layout.bounds_max, from, direction, &k0, &k1)))
                        continue;
                    if (!(piece > 0))
                        continue;
                    uint64_t is = lmg_cell_of(uvst[2], slab->s0, plan->scale[j][2], slab->ns);
                    uint64_t it = lmg_cell_of(uvst[3], slab->t0, plan->scale[j][3], slab->nt);
                    /* a whole (u,v) cell, at the mean of its slopes, its middle */
                    const lmg_place place = {(((uint64_t)iv * slab->nu + iu) * slab->nt + it) * slab->ns + is,
                                             (uint32_t)(it * slab->ns + is),
                                             {0, 0, within((uvst[2] - slab->s0) * plan->scale[j][2], (double)is),
                                              within((uvst[3] - slab->t0) * plan->scale[j][3], (double)it)}};
                    if (!lmg_cell_sum_add(&sum, field, j, &place, piece * dn)) {
                        r = lmg_fail(err, LMG_ERROR_MEMORY, "intensity: no memory");
                        goto cleanup;
                    }
                }
                lmg_cell_sum_flush(&sum, field, j, rgb, &variance);
            }
    }
    if (standard_error)
        *standard_error = sqrt(variance);
cleanup:
    lmg_cell_sum_free(&sum);
    return r;
}
