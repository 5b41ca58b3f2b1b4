/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Rays to cells, many at once.  Slabs are taken in order of priority, those with a frame in common together: the rays that any of
 * them could own are gathered from those without a cell, their coordinates are computed, then each slab takes what is its own.  In
 * a bake mostly the first frame, or of a cube each class's frame, takes nearly all.
 */
#include "place.h"

typedef struct coordinates {
    double uvst[4][LMG_COLUMN]; /* u = -infinity, in no slab, where a ray runs against the slab's normal */
} coordinates;

/* Of ray i in a slab's frame. */
static inline lmg_line crossing(const lmg_slab *slab, const lmg_ray_columns *rays, size_t i, lmg_vec3 *d, double *u, double *v)
{
    const lmg_vec3 o = {rays->origin[0][i], rays->origin[1][i], rays->origin[2][i]};
    *d = (lmg_vec3){rays->direction[0][i], rays->direction[1][i], rays->direction[2][i]};
    lmg_line line = {.dn = v_dot(*d, slab->n)};
    lmg_line_crossing(slab, o, *d, &line, u, v);
    *u = line.dn > 0 ? *u : -(double)INFINITY;
    return line;
}

LMG_WIDE static void aperture_coordinates(const lmg_slab *restrict of, size_t count, const lmg_ray_columns *restrict rays,
                                          coordinates *restrict out)
{
    const lmg_slab slab = *of;
    for (size_t i = 0; i < count; i++) {
        lmg_vec3 d;
        double u, v, s, t;
        const lmg_line line = crossing(&slab, rays, i, &d, &u, &v);
        lmg_line_aperture_st(d, &line, &s, &t);
        out->uvst[0][i] = u;
        out->uvst[1][i] = v;
        out->uvst[2][i] = s;
        out->uvst[3][i] = t;
    }
}

LMG_WIDE static void slope_coordinates(const lmg_slab *restrict of, size_t count, const lmg_ray_columns *restrict rays,
                                       coordinates *restrict out)
{
    const lmg_slab slab = *of;
    for (size_t i = 0; i < count; i++) {
        lmg_vec3 d;
        double u, v, s, t;
        const lmg_line line = crossing(&slab, rays, i, &d, &u, &v);
        lmg_line_slope_st(&line, &s, &t);
        out->uvst[0][i] = u;
        out->uvst[1][i] = v;
        out->uvst[2][i] = s;
        out->uvst[3][i] = t;
    }
}

LMG_WIDE static void plane_coordinates(const lmg_slab *restrict of, size_t count, const lmg_ray_columns *restrict rays,
                                       coordinates *restrict out)
{
    const lmg_slab slab = *of;
    for (size_t i = 0; i < count; i++) {
        lmg_vec3 d;
        double u, v, s, t;
        const lmg_line line = crossing(&slab, rays, i, &d, &u, &v);
        lmg_line_plane_st(&slab, &line, u, v, &s, &t);
        out->uvst[0][i] = u;
        out->uvst[1][i] = v;
        out->uvst[2][i] = s;
        out->uvst[3][i] = t;
    }
}

/* lmg_cell_of for x inside the slab; of other rays it is some number. */
static inline double cell_of(double x, double low, double scale, double last)
{
    return (double)(int32_t)d_min(d_max((x - low) * scale, 0), last);
}

/* Numbers of cells within slab j (they fit a double), or -1 for rays that aren't the slab's. */
LMG_WIDE static void cells_within(const lmg_plan *restrict plan, int j, size_t count, const coordinates *restrict c,
                                  double *restrict within)
{
    const lmg_slab slab = plan->layout->slabs[j];
    const double u0 = slab.u0, u1 = slab.u1, v0 = slab.v0, v1 = slab.v1, s0 = slab.s0, t0 = slab.t0;
    const double s1 = lmg_st_end(&slab, slab.s1), t1 = lmg_st_end(&slab, slab.t1);
    const double nu = slab.nu, ns = slab.ns, nt = slab.nt, *scale = plan->scale[j];
    const double su = scale[0], sv = scale[1], ss = scale[2], st = scale[3];
    const double last_u = nu - 1, last_v = (double)slab.nv - 1, last_s = ns - 1, last_t = nt - 1;
    for (size_t i = 0; i < count; i++) {
        const double u = c->uvst[0][i], v = c->uvst[1][i], s = c->uvst[2][i], t = c->uvst[3][i];
        const bool inside = (u >= u0) & (u < u1) & (v >= v0) & (v < v1) & (s >= s0) & (s < s1) & (t >= t0) & (t < t1);
        const double iu = cell_of(u, u0, su, last_u), iv = cell_of(v, v0, sv, last_v);
        const double is = cell_of(s, s0, ss, last_s), it = cell_of(t, t0, st, last_t);
        /* a factor in place of a choice, of which compilers make a branch around all of the above */
        const double number = ((iv * nu + iu) * nt + it) * ns + is;
        within[i] = (inside ? 1.0 : 0.0) * (number + 1) - 1;
    }
}

LMG_WIDE static void classes_of(size_t count, const lmg_ray_columns *restrict rays, int32_t *restrict class)
{
    for (size_t i = 0; i < count; i++) {
        const double x = rays->direction[0][i], y = rays->direction[1][i], z = rays->direction[2][i];
        const double ax = fabs(x), ay = fabs(y), az = fabs(z);
        const bool along_x = (ax >= ay) & (ax >= az), along_y = ay >= az;
        const double largest = along_x ? x : along_y ? y : z;
        class[i] = (along_x ? 0 : along_y ? 2 : 4) + (largest < 0 ? 1 : 0);
    }
}

static void coordinates_in(const lmg_slab *slab, size_t count, const lmg_ray_columns *rays, coordinates *out)
{
    if (slab->kind == LMG_SLAB_APERTURE)
        aperture_coordinates(slab, count, rays, out);
    else if (isinf(slab->distance))
        slope_coordinates(slab, count, rays, out);
    else
        plane_coordinates(slab, count, rays, out);
}

/* The rays named by `at`, gathered. */
static void gather(const lmg_ray_columns *rays, size_t count, const uint16_t *at, lmg_ray_columns *out)
{
    for (size_t k = 0; k < count; k++)
        for (int c = 0; c < 3; c++) {
            out->origin[c][k] = rays->origin[c][at[k]];
            out->direction[c][k] = rays->direction[c][at[k]];
        }
}

void lmg_plan_place(const lmg_plan *plan, size_t count, const lmg_ray_columns *rays, uint64_t cell[LMG_COLUMN])
{
    int32_t class[LMG_COLUMN];
    uint16_t left[LMG_COLUMN], at[LMG_COLUMN];
    lmg_ray_columns some;
    coordinates c;
    double within[LMG_COLUMN];
    classes_of(count, rays, class);
    for (size_t i = 0; i < count; i++) {
        left[i] = (uint16_t)i;
        cell[i] = LMG_NO_CELL;
    }
    size_t left_count = count;
    const int slabs = (int)plan->layout->slab_count;
    for (int j = 0, end; j < slabs && left_count > 0; j = end) {
        for (end = j + 1; end < slabs && plan->frame[end] == plan->frame[j];)
            end++;
        size_t n = 0, others = 0;
        for (size_t k = 0; k < left_count; k++) {
            const uint16_t i = left[k];
            const bool candidate = plan->classes[j] >> class[i] & 1;
            at[n] = i;
            left[others] = i;
            n += candidate;
            others += !candidate;
        }
        if (n == 0)
            continue;
        const lmg_ray_columns *these = rays;
        if (n < count) {
            gather(rays, n, at, &some);
            these = &some;
        }
        coordinates_in(&plan->layout->slabs[j], n, these, &c);
        for (int slab = j; slab < end; slab++) {
            cells_within(plan, slab, n, &c, within);
            for (size_t k = 0; k < n; k++)
                if (within[k] >= 0 && cell[at[k]] == LMG_NO_CELL)
                    cell[at[k]] = plan->first[slab] + (uint64_t)within[k];
        }
        for (size_t k = 0; k < n; k++) {
            left[others] = at[k];
            others += cell[at[k]] == LMG_NO_CELL;
        }
        left_count = others;
    }
}
