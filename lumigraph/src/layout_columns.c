/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The arithmetic of judging layouts, many rays at once: moving rays within their cells, and the pixels of rays in receivers.  Loops
 * without calls and branches; relies on geometry.h for the concentric map.
 */
#include "layout_columns.h"

/* Whole part of x, from 0 to last; of what isn't a number, one of them. */
static inline int32_t index_of(double x, double last)
{
    return (int32_t)d_min(d_max(x, 0), last);
}

/* Coordinates are limited before they are looked at: converting what is far outside would be an invalid operation. */
static inline uint16_t pixel_of(double x, double y, bool forward)
{
    const double in_x = d_min(d_max(x, -1), LMG_JUDGE_SIDE), in_y = d_min(d_max(y, -1), LMG_JUDGE_SIDE);
    const bool inside = forward & (in_x >= 0) & (in_x < LMG_JUDGE_SIDE) & (in_y >= 0) & (in_y < LMG_JUDGE_SIDE);
    return (uint16_t)(inside ? (int32_t)in_y * LMG_JUDGE_SIDE + (int32_t)in_x : LMG_OUTSIDE);
}

LMG_WIDE static void plane_pixels(const lmg_receiver *restrict of, double start, size_t count, const lmg_ray_columns *restrict r,
                                  uint16_t *restrict pixel)
{
    const double x0 = of->x0, y0 = of->y0, scale = of->scale, at = start + of->reach;
    for (size_t i = 0; i < count; i++) {
        const double dn = r->direction[2][i];
        const bool forward = dn > 0;
        const double t = (at - r->origin[2][i]) / (forward ? dn : 1);
        pixel[i] = pixel_of((r->origin[0][i] + t * r->direction[0][i] - x0) * scale,
                            (r->origin[1][i] + t * r->direction[1][i] - y0) * scale, forward);
    }
}

/* Places of directions in the square of the concentric map; of those that go backwards, some places. */
LMG_WIDE static void squares_of(size_t count, const lmg_ray_columns *restrict r, double *restrict s, double *restrict t)
{
    for (size_t i = 0; i < count; i++)
        lmg_cone_to_square(r->direction[0][i], r->direction[1][i], 1, &s[i], &t[i]);
}

LMG_WIDE static void beam_pixels(const lmg_receiver *restrict of, size_t count, const lmg_ray_columns *restrict r,
                                 const double *restrict s, const double *restrict t, uint16_t *restrict pixel)
{
    const double x0 = of->x0, y0 = of->y0, scale = of->scale, scale_y = of->scale_y;
    for (size_t i = 0; i < count; i++)
        pixel[i] = pixel_of((s[i] - x0) * scale, (t[i] - y0) * scale_y, r->direction[2][i] > 0);
}

/* The angle about n is linear on each side of the square. */
LMG_WIDE static void ring_pixels(size_t count, const lmg_ray_columns *restrict r, const double *restrict square_s,
                                 const double *restrict square_t, uint16_t *restrict pixel)
{
    for (size_t i = 0; i < count; i++) {
        const double cosine = r->direction[2][i], s = square_s[i], t = square_t[i];
        const bool horizontal = fabs(s) >= fabs(t), forward = cosine > 0;
        const double side = horizontal ? s : t, along = horizontal ? t : -s;
        /* never by 0, nor by way of it: of x / (c ? y : 1) compilers make c ? x / y : x, and columns of that divide by all y */
        const double width = fabs(side) > 0x1p-1000 ? fabs(side) : 0x1p-1000;
        const double eighths = (horizontal ? 0 : 2) + (side > 0 ? 0 : 4) + (side > 0 ? along : -along) / width; /* of the circle */
        const double round = (eighths < 0 ? eighths + 8 : eighths) * (LMG_JUDGE_SECTORS / 8.0);
        const int32_t at = index_of((1 - cosine) * LMG_JUDGE_RINGS, LMG_JUDGE_RINGS - 1) * LMG_JUDGE_SECTORS +
                           index_of(round, LMG_JUDGE_SECTORS - 1);
        pixel[i] = (uint16_t)(forward ? at : LMG_OUTSIDE);
    }
}

void lmg_pixels_of(const lmg_receiver *receivers, double start, size_t count, const lmg_ray_columns *rays, lmg_pixels out)
{
    double s[LMG_COLUMN], t[LMG_COLUMN];
    for (int k = 0; k < LMG_JUDGE_PLANES; k++)
        plane_pixels(&receivers[k], start, count, rays, out[k]);
    squares_of(count, rays, s, t);
    ring_pixels(count, rays, s, t, out[LMG_JUDGE_PLANES]);
    beam_pixels(&receivers[LMG_JUDGE_PLANES + 1], count, rays, s, t, out[LMG_JUDGE_PLANES + 1]);
}

/* And one over the etendue of their cells, by the density in the cell's middle. */
LMG_WIDE static void move_within(const lmg_slab *restrict of, const double *restrict scale, lmg_members *restrict m)
{
    const double nu = of->nu, nt = of->nt, ns = of->ns, u0 = of->u0, v0 = of->v0, s0 = of->s0, t0 = of->t0;
    const double wu = 1 / scale[0], wv = 1 / scale[1], ws = 1 / scale[2], wt = 1 / scale[3];
    const double cell = wu * wv * ws * wt;
    const bool aperture = of->kind == LMG_SLAB_APERTURE, slopes = !isfinite(of->distance);
    const double d = slopes ? 1 : 1 / of->distance, minus = slopes ? 0 : 1;
    for (size_t i = 0; i < m->count; i++) {
        /* exact: quotients of whole numbers below 2^53 never round up to a whole one */
        double rest = m->within[i], next = floor(rest / ns);
        const double is = rest - next * ns;
        rest = next;
        next = floor(rest / nt);
        const double it = rest - next * nt, iv = floor(next / nu), iu = next - iv * nu;
        m->uvst[0][i] = u0 + (iu + m->jitter[0][i]) * wu;
        m->uvst[1][i] = v0 + (iv + m->jitter[1][i]) * wv;
        m->uvst[2][i] = s0 + (is + m->jitter[2][i]) * ws;
        m->uvst[3][i] = t0 + (it + m->jitter[3][i]) * wt;
        const double u = u0 + (iu + 0.5) * wu, v = v0 + (iv + 0.5) * wv, s = s0 + (is + 0.5) * ws, t = t0 + (it + 0.5) * wt;
        const double p = (s - minus * u) * d, r = (t - minus * v) * d, f = 1 + p * p + r * r;
        const double density = aperture ? LMG_PI / 4 : d * d / (f * f);
        m->inverse[i] = 1 / (cell * density);
    }
}

/* A slab's axes and origin in the frame of the judge. */
typedef struct seen_frame {
    double o[3], a[3], b[3], n[3];
} seen_frame;

/* Rays of an aperture slab: the inverse of the concentric map with series for angles up to 45 degrees, right to 2e-9. */
LMG_WIDE static void aperture_rays(const seen_frame *restrict of, const lmg_members *restrict m, lmg_ray_columns *restrict out)
{
    const seen_frame f = *of;
    for (size_t i = 0; i < m->count; i++) {
        const double s = m->uvst[2][i], t = m->uvst[3][i];
        const bool horizontal = fabs(s) >= fabs(t);
        const double r = horizontal ? s : t, other = horizontal ? t : s;
        const double phi = LMG_PI / 4 * other / (r != 0 ? r : 1), q = phi * phi;
        const double cosine = 1 - q * (1.0 / 2 - q * (1.0 / 24 - q * (1.0 / 720 - q * (1.0 / 40320 - q * (1.0 / 3628800)))));
        const double sine = phi * (1 - q * (1.0 / 6 - q * (1.0 / 120 - q * (1.0 / 5040 - q * (1.0 / 362880)))));
        const double x = r * (horizontal ? cosine : sine), y = r * (horizontal ? sine : cosine),
                     z = sqrt(d_max((1 - r) * (1 + r), 0));
        for (int k = 0; k < 3; k++) {
            out->origin[k][i] = f.o[k] + m->uvst[0][i] * f.a[k] + m->uvst[1][i] * f.b[k];
            out->direction[k][i] = x * f.a[k] + y * f.b[k] + z * f.n[k];
        }
    }
}

/* Of a cube slab. */
LMG_WIDE static void cube_rays(const seen_frame *restrict of, double distance, const lmg_members *restrict m,
                               lmg_ray_columns *restrict out)
{
    const seen_frame f = *of;
    const bool slopes = !isfinite(distance);
    const double d = slopes ? 1 : 1 / distance, minus = slopes ? 0 : 1;
    for (size_t i = 0; i < m->count; i++) {
        const double u = m->uvst[0][i], v = m->uvst[1][i], p = (m->uvst[2][i] - minus * u) * d, r = (m->uvst[3][i] - minus * v) * d;
        const double z = 1 / sqrt(1 + p * p + r * r);
        for (int k = 0; k < 3; k++) {
            out->origin[k][i] = f.o[k] + u * f.a[k] + v * f.b[k];
            out->direction[k][i] = z * (p * f.a[k] + r * f.b[k] + f.n[k]);
        }
    }
}

void lmg_members_move(const lmg_slab *slab, const double scale[4], lmg_members *m)
{
    move_within(slab, scale, m);
}

void lmg_members_rays(const lmg_slab *slab, const lmg_vec3 axes[3], const lmg_members *m, lmg_ray_columns *out)
{
    seen_frame f;
    for (int k = 0; k < 3; k++) {
        f.o[k] = v_dot(slab->o, axes[k]);
        f.a[k] = v_dot(slab->a, axes[k]);
        f.b[k] = v_dot(slab->b, axes[k]);
        f.n[k] = v_dot(slab->n, axes[k]);
    }
    if (slab->kind == LMG_SLAB_APERTURE)
        aperture_rays(&f, m, out);
    else
        cube_rays(&f, slab->distance, m, out);
}
