/* SPDX-License-Identifier: Apache-2.0 */
/* Section "Coordinates" of docs/format.md: which cell a ray belongs to, and the ray of a cell.  Relies on that text only. */
#include "box_reader.h"

#include <math.h>

static const double pi = 3.14159265358979323846;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The number of the cell that holds x, or -1; closed: the upper border belongs to the last cell. */
static int64_t cell_of(double x, const double range[2], uint32_t cells, int closed)
{
    if (x < range[0] || x > range[1] || (x == range[1] && !closed)) {
        return -1;
    }
    const double i = floor((x - range[0]) / (range[1] - range[0]) * cells);
    return i < cells ? (int64_t)i : (int64_t)cells - 1;
}

static int same_class(const double d[3], const double n[3])
{
    int axis = 0; /* of the largest component; the first of equals */
    for (int i = 1; i < 3; i++) {
        axis = fabs(d[i]) > fabs(d[axis]) ? i : axis;
    }
    return d[axis] * n[axis] > 0;
}

int box_find(const box *b, const double origin[3], const double direction[3], uint32_t cell[4])
{
    for (int k = 0; k < b->slabs; k++) {
        const box_slab *s = &b->slab[k];
        const double dn = dot(direction, s->n), length = sqrt(dot(direction, direction));
        if (!(dn > 0) || (!s->aperture && !same_class(direction, s->n))) {
            continue;
        }
        const double w[3] = {origin[0] - s->o[0], origin[1] - s->o[1], origin[2] - s->o[2]};
        const double p = dot(direction, s->a) / dn, q = dot(direction, s->b) / dn, h = dot(w, s->n);
        const double u = dot(w, s->a) - h * p, v = dot(w, s->b) - h * q;
        double sc, tc;
        if (s->aperture) {
            const double x = dot(direction, s->a) / length, y = dot(direction, s->b) / length, r = fmin(1, hypot(x, y));
            if (fabs(x) >= fabs(y)) {
                sc = copysign(r, x);
                tc = x == 0 ? 0 : 4 / pi * sc * atan(y / x);
            } else {
                tc = copysign(r, y);
                sc = 4 / pi * tc * atan(x / y);
            }
        } else {
            sc = isinf(s->distance) ? p : u + s->distance * p;
            tc = isinf(s->distance) ? q : v + s->distance * q;
        }
        const int bounded = s->aperture || isinf(s->distance);
        const int64_t i[4] = {cell_of(u, s->u, s->nu, 0), cell_of(v, s->v, s->nv, 0), cell_of(sc, s->s, s->ns, bounded && s->s[1] == 1),
                              cell_of(tc, s->t, s->nt, bounded && s->t[1] == 1)};
        if (i[0] >= 0 && i[1] >= 0 && i[2] >= 0 && i[3] >= 0) {
            for (int c = 0; c < 4; c++) {
                cell[c] = (uint32_t)i[c];
            }
            return k;
        }
    }
    return -1;
}

static double middle(const double range[2], uint32_t cells, uint32_t i)
{
    return range[0] + (range[1] - range[0]) * (i + 0.5) / cells;
}

void box_ray(const box_slab *k, const uint32_t cell[4], double origin[3], double direction[3])
{
    const double u = middle(k->u, k->nu, cell[0]), v = middle(k->v, k->nv, cell[1]);
    const double s = middle(k->s, k->ns, cell[2]), t = middle(k->t, k->nt, cell[3]);
    double x, y, z;
    if (k->aperture) {
        const double r = fabs(s) >= fabs(t) ? s : t, phi = r == 0 ? 0 : fabs(s) >= fabs(t) ? pi / 4 * t / s : pi / 2 - pi / 4 * s / t;
        x = r * cos(phi);
        y = r * sin(phi);
        z = sqrt(fmax(0, 1 - r * r));
    } else {
        const double p = isinf(k->distance) ? s : (s - u) / k->distance, q = isinf(k->distance) ? t : (t - v) / k->distance;
        z = 1 / sqrt(1 + p * p + q * q);
        x = p * z;
        y = q * z;
    }
    for (int i = 0; i < 3; i++) {
        origin[i] = k->o[i] + u * k->a[i] + v * k->b[i];
        direction[i] = x * k->a[i] + y * k->b[i] + z * k->n[i];
    }
}
