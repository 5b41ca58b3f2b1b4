/* SPDX-License-Identifier: Apache-2.0 */
/* Coordinates of rays in slabs and back, which slab owns a ray, and what a layout has to fulfil.  Relies on geometry.h. */
#include "field.h"
#include "geometry.h"

bool lmg_slab_coordinates(const lmg_slab *slab, lmg_vec3 origin, lmg_vec3 direction, double uvst[4])
{
    double dn = v_dot(direction, slab->n);
    if (!(dn > 0))
        return false;
    if (slab->kind == LMG_SLAB_CUBE && lmg_direction_class(direction) != lmg_direction_class(slab->n))
        return false;
    lmg_slab_crossing(slab, origin, direction, dn, &uvst[0], &uvst[1]);
    lmg_slab_st(slab, direction, dn, uvst[0], uvst[1], &uvst[2], &uvst[3]);
    return uvst[0] >= slab->u0 && uvst[0] < slab->u1 && uvst[1] >= slab->v0 && uvst[1] < slab->v1 &&
           lmg_in_st(slab, uvst[2], slab->s0, slab->s1) && lmg_in_st(slab, uvst[3], slab->t0, slab->t1);
}

void lmg_slab_ray(const lmg_slab *slab, const double uvst[4], lmg_vec3 *origin, lmg_vec3 *direction)
{
    *origin = v_fma(v_fma(slab->o, uvst[0], slab->a), uvst[1], slab->b);
    if (slab->kind == LMG_SLAB_APERTURE) {
        double x, y, z;
        lmg_square_to_disc(uvst[2], uvst[3], &x, &y, &z);
        *direction = v_fma(v_fma(v_scale(z, slab->n), x, slab->a), y, slab->b);
        return;
    }
    bool slopes = isinf(slab->distance);
    double p = slopes ? uvst[2] : (uvst[2] - uvst[0]) / slab->distance;
    double q = slopes ? uvst[3] : (uvst[3] - uvst[1]) / slab->distance;
    double inv = 1 / sqrt(1 + p * p + q * q);
    *direction = v_scale(inv, v_fma(v_fma(slab->n, p, slab->a), q, slab->b));
}

void lmg_plan_prepare(lmg_plan *plan, const lmg_layout *layout)
{
    *plan = (lmg_plan){.layout = layout};
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        const lmg_slab *slab = &layout->slabs[j];
        plan->frame[j] = (uint8_t)j;
        for (uint32_t k = 0; k < j; k++)
            if (lmg_same_frame(slab, &layout->slabs[k])) {
                plan->frame[j] = plan->frame[k];
                break;
            }
        plan->scale[j][0] = slab->nu / (slab->u1 - slab->u0);
        plan->scale[j][1] = slab->nv / (slab->v1 - slab->v0);
        plan->scale[j][2] = slab->ns / (slab->s1 - slab->s0);
        plan->scale[j][3] = slab->nt / (slab->t1 - slab->t0);
        const double low[4] = {slab->u0, slab->v0, slab->s0, slab->t0};
        const double end[4] = {slab->u1, slab->v1, lmg_st_end(slab, slab->s1), lmg_st_end(slab, slab->t1)};
        const uint32_t n[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
        for (int k = 0; k < 4; k++) {
            plan->low[j][k] = low[k];
            plan->end[j][k] = end[k];
            plan->last[j][k] = (int32_t)n[k] - 1;
        }
        plan->first[j + 1] = plan->first[j] + lmg_slab_cells(slab);
        int own = slab->kind == LMG_SLAB_CUBE ? lmg_direction_class(slab->n) : -1;
        for (int c = 0; c < 6; c++) {
            /* An aperture slab can own a direction of class c unless all such directions point away: class c's directions are the
             * cone around +-axis with |other components| <= 1, so the most favourable has d.n = +-n_axis + |n_others|. */
            bool can = own == c;
            if (own < 0) {
                double along = v_axis(slab->n, c / 2) * (c % 2 ? -1 : 1);
                double others = fabs(slab->n.x) + fabs(slab->n.y) + fabs(slab->n.z) - fabs(along);
                can = along + others > 0;
            }
            if (can) {
                plan->list[c][plan->count[c]++] = (uint8_t)j;
                plan->classes[j] |= (uint8_t)(1 << c);
            }
        }
    }
}

int lmg_layout_owner(const lmg_layout *layout, lmg_vec3 origin, lmg_vec3 direction, double uvst[4])
{
    for (uint32_t j = 0; j < layout->slab_count; j++)
        if (lmg_slab_coordinates(&layout->slabs[j], origin, direction, uvst))
            return (int)j;
    return -1;
}

uint64_t lmg_hash(uint64_t hash, const void *bytes, size_t count)
{
    const unsigned char *b = bytes;
    for (size_t i = 0; i < count; i++)
        hash = (hash ^ b[i]) * 0x100000001b3u;
    return hash;
}

/* Largest departure from orthonormal that a frame may have: rounding of its components to float, as a file made by somebody else may. */
#define FRAME_TOLERANCE 1e-6

static lmg_result check_slab(const lmg_slab *s, uint32_t j, lmg_error *err)
{
    if (s->kind != LMG_SLAB_CUBE && s->kind != LMG_SLAB_APERTURE)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: slab %u has the unknown kind %d", j, (int)s->kind);
    if (!v_finite(s->o) || !v_finite(s->a) || !v_finite(s->b) || !v_finite(s->n))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the frame of slab %u isn't finite", j);
    lmg_vec3 off = v_sub(v_cross(s->a, s->b), s->n);
    if (fabs(v_length(s->a) - 1) > FRAME_TOLERANCE || fabs(v_length(s->b) - 1) > FRAME_TOLERANCE ||
        fabs(v_dot(s->a, s->b)) > FRAME_TOLERANCE || v_length(off) > FRAME_TOLERANCE)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the axes of slab %u aren't orthonormal with a x b = n", j);
    bool slopes = s->kind == LMG_SLAB_APERTURE;
    if (s->kind == LMG_SLAB_CUBE) {
        const lmg_vec3 axes[3] = {s->a, s->b, s->n};
        for (int k = 0; k < 3; k++)
            if (fabs(axes[k].x) + fabs(axes[k].y) + fabs(axes[k].z) != 1 || fmax(fabs(axes[k].x), fmax(fabs(axes[k].y), fabs(axes[k].z))) != 1)
                return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the axes of cube slab %u must be coordinate axes", j);
        if (!(s->distance > 0))
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: slab %u has its (s,t) plane at distance %g, which must be positive", j,
                            s->distance);
        slopes = isinf(s->distance);
    }
    const double r[8] = {s->u0, s->u1, s->v0, s->v1, s->s0, s->s1, s->t0, s->t1};
    for (int k = 0; k < 8; k += 2)
        if (!isfinite(r[k]) || !isfinite(r[k + 1]) || !(r[k] < r[k + 1]))
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: slab %u has an empty or infinite range of %c: [%g, %g]", j, "uvst"[k / 2],
                            r[k], r[k + 1]);
    if (slopes && (s->s0 < -1 || s->s1 > 1 || s->t0 < -1 || s->t1 > 1))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: (s,t) of slab %u goes beyond [-1,1]", j);
    const uint32_t n[4] = {s->nu, s->nv, s->ns, s->nt};
    uint64_t cells = 1;
    for (int k = 0; k < 4; k++) {
        if (n[k] < 1 || n[k] > 65535)
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: slab %u has %u cells along %c; 1 to 65535 are possible", j, n[k], "uvst"[k]);
        cells *= n[k];
        if (cells > (uint64_t)1 << 32)
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: slab %u has more than 2^32 cells", j);
    }
    return LMG_OK;
}

lmg_result lmg_layout_check(const lmg_layout *layout, lmg_error *err)
{
    if (!layout)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: none given");
    if (layout->slab_count < 1 || layout->slab_count > LMG_MAX_SLABS)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %u slabs; 1 to %d are possible", layout->slab_count, LMG_MAX_SLABS);
    if (layout->channels != 1 && layout->channels != 3)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %u channels; 1 or 3 are possible", layout->channels);
    if (layout->channels == 1) {
        /* 1e-4: a colour that went through a decimal text of five digits is still luminance 1 */
        if (!(fabs(lmg_luminance(layout->colour) - 1) < 1e-4))
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the colour %g %g %g of a one-channel field must have luminance 1",
                            (double)layout->colour[0], (double)layout->colour[1], (double)layout->colour[2]);
    }
    const lmg_vec3 lo = layout->bounds_min, hi = layout->bounds_max;
    if (!v_finite(lo) || !v_finite(hi) || !(lo.x < hi.x && lo.y < hi.y && lo.z < hi.z))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the bounds [%g %g %g] to [%g %g %g] m are empty or infinite", lo.x, lo.y, lo.z,
                        hi.x, hi.y, hi.z);
    if (!isfinite(layout->size) || !(layout->size > 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the size %g m must be positive", layout->size);
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        lmg_result r = check_slab(&layout->slabs[j], j, err);
        if (r != LMG_OK)
            return r;
    }
    return LMG_OK;
}
