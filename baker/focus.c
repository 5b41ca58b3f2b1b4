/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Virtual focus.  The squared distance of a point x from a ray (o, d) is (x - o)' P (x - o) with P = I - d d', so the least sum solves
 * the 3 x 3 system (sum w P) x = sum w P o.  Relies on C11 atomics.
 */
#include "focus.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>

static const double UNIT = 0x1p30;
/* Rays further from the centre than so many sizes would overflow the sums of 2^30 rays; they are left out. */
static const double FAR = 8;
/* The system is singular when the smallest of its pivots is this small a part of the largest: parallel rays, to the floats' rounding. */
static const double SINGULAR = 1e-10;

enum { XX, XY, XZ, YY, YZ, ZZ, BX, BY, BZ, CONSTANT, WEIGHT, SUMS };

struct bake_focus {
    lmg_vec3 centre;
    double size;
    atomic_int_least64_t sums[SUMS];
};

lmg_result bake_focus_create(lmg_vec3 centre, double size, bake_focus **out, lmg_error *err)
{
    *out = NULL;
    if (!(size > 0) || !isfinite(centre.x + centre.y + centre.z))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a virtual focus needs a centre and a size");
    bake_focus *f = calloc(1, sizeof(*f));
    if (!f)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a virtual focus");
    f->centre = centre;
    f->size = size;
    *out = f;
    return LMG_OK;
}

void bake_focus_destroy(bake_focus *focus)
{
    free(focus);
}

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    bake_focus *f = self;
    int64_t sums[SUMS] = {0};
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 d = rays[i].direction;
        const double w = lmg_luminance(rays[i].flux);
        const double ox = (rays[i].origin.x - f->centre.x) / f->size, oy = (rays[i].origin.y - f->centre.y) / f->size,
                     oz = (rays[i].origin.z - f->centre.z) / f->size;
        if (!(w >= 0 && w < 0x1p20) || !(fabs(ox) < FAR && fabs(oy) < FAR && fabs(oz) < FAR))
            continue;
        const double along = ox * d.x + oy * d.y + oz * d.z;
        const double px = ox - along * d.x, py = oy - along * d.y, pz = oz - along * d.z;
        const double values[SUMS] = {1 - d.x * d.x, -d.x * d.y, -d.x * d.z, 1 - d.y * d.y, -d.y * d.z, 1 - d.z * d.z, px,
                                     py,            pz,         px * px + py * py + pz * pz, 1};
        for (int k = 0; k < SUMS; ++k)
            sums[k] += llrint(w * values[k] * UNIT);
    }
    for (int k = 0; k < SUMS; ++k)
        atomic_fetch_add_explicit(&f->sums[k], sums[k], memory_order_relaxed);
}

lmg_sink bake_focus_sink(bake_focus *focus)
{
    return (lmg_sink){.self = focus, .consume = consume};
}

bool bake_focus_point(const bake_focus *f, lmg_vec3 *point, double *spread)
{
    double s[SUMS];
    for (int k = 0; k < SUMS; ++k)
        s[k] = (double)atomic_load_explicit(&f->sums[k], memory_order_relaxed) / UNIT;
    if (!(s[WEIGHT] > 0))
        return false;
    /* Cholesky; the matrix is symmetric and, unless all rays are parallel, positive */
    const double l00 = sqrt(s[XX]), l10 = s[XY] / l00, l20 = s[XZ] / l00;
    const double p11 = s[YY] - l10 * l10;
    const double l11 = sqrt(p11), l21 = (s[YZ] - l20 * l10) / l11;
    const double p22 = s[ZZ] - l20 * l20 - l21 * l21;
    if (!(s[XX] > SINGULAR * s[WEIGHT]) || !(p11 > SINGULAR * s[WEIGHT]) || !(p22 > SINGULAR * s[WEIGHT]))
        return false;
    const double l22 = sqrt(p22);
    const double y0 = s[BX] / l00, y1 = (s[BY] - l10 * y0) / l11, y2 = (s[BZ] - l20 * y0 - l21 * y1) / l22;
    const double z = y2 / l22, y = (y1 - l21 * z) / l11, x = (y0 - l10 * y - l20 * z) / l00;
    *point = (lmg_vec3){f->centre.x + f->size * x, f->centre.y + f->size * y, f->centre.z + f->size * z};
    if (spread) /* sum w |P(x - o)|^2 = constant - b'x at the least */
        *spread = f->size * sqrt(fmax(s[CONSTANT] - (s[BX] * x + s[BY] * y + s[BZ] * z), 0) / s[WEIGHT]);
    return true;
}
