/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The far-field goniophotometer (goniometer.h).  The least-squares problem on the sphere is a product of one in C (hat functions
 * round a circle) and one in gamma (hat functions weighted with sin gamma), each tridiagonal.  At the poles all planes meet in one
 * value: the mean over C is solved with the poles, the rest, which vanishes there, without them.  Relies on C11 atomics.
 */
#include "goniometer.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;
/* Sums count in units of 2^-20 of a ray's unit flux; a node gets 10^12 rays before they overflow. */
static const double FIXED = 0x1p20;

typedef struct node {
    atomic_int_least64_t sum, squares; /* of flux x weight; of flux^2 x weight */
} node;

struct bake_goniometer {
    bake_goniometer_options o;
    node *nodes; /* [plane * angles + angle] */
};

lmg_result bake_goniometer_create(const bake_goniometer_options *options, bake_goniometer **out, lmg_error *err)
{
    *out = NULL;
    bake_goniometer_options o = *options;
    o.planes = o.planes ? o.planes : 72;
    o.angles = o.angles ? o.angles : 73;
    if (o.planes < 4 || o.planes > 720 || o.planes % 4 || o.angles < 7 || o.angles > 1441 || (int)o.symmetry < 0 ||
        o.symmetry > LUM_SYMMETRY_QUADRANT)
        return lmg_fail(
            err, LMG_ERROR_ARGUMENT,
            "a far field of %u planes and %u angles can't be measured; 4..720 planes, a multiple of 4, and 7..1441 angles can",
            o.planes, o.angles);
    bake_goniometer *g = calloc(1, sizeof(*g));
    if (g)
        g->nodes = calloc((size_t)o.planes * o.angles, sizeof(*g->nodes));
    if (!g || !g->nodes) {
        free(g);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a far field of %u x %u angles", o.planes, o.angles);
    }
    g->o = o;
    *out = g;
    return LMG_OK;
}

void bake_goniometer_destroy(bake_goniometer *g)
{
    if (!g)
        return;
    free(g->nodes);
    free(g);
}

static void add(node *n, double flux, double weight)
{
    if (weight > 0) {
        atomic_fetch_add_explicit(&n->sum, (int_least64_t)llrint(flux * weight * FIXED), memory_order_relaxed);
        atomic_fetch_add_explicit(&n->squares, (int_least64_t)llrint(flux * flux * weight * FIXED), memory_order_relaxed);
    }
}

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    bake_goniometer *g = self;
    const uint32_t planes = g->o.planes, angles = g->o.angles;
    for (size_t k = 0; k < count; ++k) {
        const double flux = lmg_luminance(rays[k].flux);
        double c, gamma;
        lum_direction_to_c_gamma(rays[k].direction, &c, &gamma);
        if (!(flux > 0 && flux < 0x1p40 && c >= 0 && gamma >= 0)) /* also not a number */
            continue;
        const double x = c / 360 * planes, y = gamma / 180 * (angles - 1);
        const uint32_t i = (uint32_t)x < planes ? (uint32_t)x : planes - 1, j = (uint32_t)y < angles - 1 ? (uint32_t)y : angles - 2;
        const double s = x - i, t = y - j;
        node *a = g->nodes + (size_t)i * angles + j, *b = g->nodes + (size_t)((i + 1) % planes) * angles + j;
        add(a, flux, (1 - s) * (1 - t));
        add(a + 1, flux, (1 - s) * t);
        add(b, flux, s * (1 - t));
        add(b + 1, flux, s * t);
    }
}

lmg_sink bake_goniometer_sink(bake_goniometer *g)
{
    return (lmg_sink){.self = g, .consume = consume};
}

/* ------------------------------------------------------------------------------------------------------------- solving */

/* A symmetric, positive definite tridiagonal matrix: diagonal d[0..n), beside it e[0..n-1) (e[i] joins i and i+1). */
typedef struct bands {
    size_t n;
    double *d, *e;
} bands;

static bool bands_create(bands *m, size_t n)
{
    m->n = n;
    m->d = calloc(2 * n, sizeof(*m->d));
    m->e = m->d ? m->d + n : NULL;
    return m->d;
}

/* Solves m x = b for rows from..n-1-from, in place, stride between elements; work: n doubles. */
static void solve(const bands *m, size_t from, double *x, size_t stride, double *work)
{
    const size_t end = m->n - from;
    double pivot = m->d[from];
    x[from * stride] /= pivot;
    for (size_t i = from + 1; i < end; ++i) {
        work[i] = m->e[i - 1] / pivot;
        pivot = m->d[i] - m->e[i - 1] * work[i];
        x[i * stride] = (x[i * stride] - m->e[i - 1] * x[(i - 1) * stride]) / pivot;
    }
    for (size_t i = end - 1; i-- > from;)
        x[i * stride] -= work[i + 1] * x[(i + 1) * stride];
}

/* The same round a circle of n equal elements, diagonal d and beside it e, by Sherman and Morrison's formula. */
static void solve_circle(const bands *open, double d, double e, double *x, size_t stride, double *work, double *u)
{
    /* open is the matrix with corners cut: first diagonal d + d, last d + e^2/d (bands_of_circle). */
    const size_t n = open->n;
    memset(u, 0, n * sizeof(*u));
    u[0] = -d;
    u[n - 1] = e;
    solve(open, 0, u, 1, work);
    solve(open, 0, x, stride, work);
    const double ratio = -e / d, factor = (x[0] + ratio * x[(n - 1) * stride]) / (1 + u[0] + ratio * u[n - 1]);
    for (size_t i = 0; i < n; ++i)
        x[i * stride] -= factor * u[i];
}

/* Overlap integrals of the hat functions in gamma, weighted with sin gamma (radians), by Gauss-Legendre quadrature with five points
 * an interval: exact to rounding for steps up to 30 degrees. */
static void gamma_overlaps(bands *m)
{
    static const double POINTS[5] = {0, 0.5384693101056831, -0.5384693101056831, 0.9061798459386640, -0.9061798459386640};
    static const double WEIGHTS[5] = {0.5688888888888889, 0.4786286704993665, 0.4786286704993665, 0.2369268850561891,
                                      0.2369268850561891};
    const double step = PI / (double)(m->n - 1);
    for (size_t j = 0; j + 1 < m->n; ++j)
        for (int k = 0; k < 5; ++k) {
            const double t = 0.5 * (1 + POINTS[k]), w = 0.5 * step * WEIGHTS[k] * sin(((double)j + t) * step);
            m->d[j] += w * (1 - t) * (1 - t);
            m->d[j + 1] += w * t * t;
            m->e[j] += w * t * (1 - t);
        }
}

typedef struct least_squares {
    uint32_t planes, angles;
    bands c, gamma;
    double diagonal, beside; /* overlaps in C */
    double *work, *u, *mean; /* each as long as the longer side */
} least_squares;

static bool squares_create(least_squares *s, uint32_t planes, uint32_t angles)
{
    const size_t longest = planes > angles ? planes : angles;
    *s = (least_squares){.planes = planes, .angles = angles};
    s->work = calloc(3 * longest, sizeof(*s->work));
    if (!bands_create(&s->c, planes) || !bands_create(&s->gamma, angles) || !s->work)
        return false;
    s->u = s->work + longest;
    s->mean = s->u + longest;
    const double step = 2 * PI / planes;
    s->diagonal = 2 * step / 3;
    s->beside = step / 6;
    for (uint32_t i = 0; i < planes; ++i) {
        s->c.d[i] = s->diagonal;
        s->c.e[i] = s->beside;
    }
    s->c.d[0] += s->diagonal;
    s->c.d[planes - 1] += s->beside * s->beside / s->diagonal;
    gamma_overlaps(&s->gamma);
    return true;
}

static void squares_destroy(least_squares *s)
{
    free(s->c.d);
    free(s->gamma.d);
    free(s->work);
}

/* x[plane * angles + angle]: sums in, intensities (per unit of flux) out. */
static void squares_solve(least_squares *s, double *x)
{
    const uint32_t n = s->planes, m = s->angles;
    for (uint32_t j = 0; j < m; ++j)
        solve_circle(&s->c, s->diagonal, s->beside, x + j, m, s->work, s->u);
    for (uint32_t j = 0; j < m; ++j) {
        s->mean[j] = 0;
        for (uint32_t i = 0; i < n; ++i)
            s->mean[j] += x[(size_t)i * m + j] / n;
        for (uint32_t i = 0; i < n; ++i)
            x[(size_t)i * m + j] -= s->mean[j];
    }
    solve(&s->gamma, 0, s->mean, 1, s->work);
    for (uint32_t i = 0; i < n; ++i) {
        double *row = x + (size_t)i * m;
        row[0] = row[m - 1] = 0;
        solve(&s->gamma, 1, row, 1, s->work);
        for (uint32_t j = 0; j < m; ++j)
            row[j] += s->mean[j];
    }
}

/* ------------------------------------------------------------------------------------------------------------- reading */

/* Variances: an intensity is the sum of the rays' flux times the dual function of its node; for a density that is constant over its
 * reach that has the variance density x the integral of the dual squared, which is the diagonal of the inverse.  density: per
 * steradian, of the squares. */
static void standard_errors(const bake_goniometer *g, least_squares *s, double scale, double *se)
{
    const uint32_t n = s->planes, m = s->angles;
    /* Diagonals of the inverses, one unit vector at a time; in C all are alike. */
    double *unit = s->mean, inverse_c, integral;
    memset(unit, 0, n * sizeof(*unit));
    unit[0] = 1;
    solve_circle(&s->c, s->diagonal, s->beside, unit, 1, s->work, s->u);
    inverse_c = unit[0];
    for (uint32_t j = 0; j < m; ++j) {
        const bool pole = j == 0 || j == m - 1;
        memset(unit, 0, m * sizeof(*unit));
        unit[j] = 1;
        solve(&s->gamma, 0, unit, 1, s->work);
        const double with_poles = unit[j];
        double without = 0;
        if (!pole) {
            memset(unit, 0, m * sizeof(*unit));
            unit[j] = 1;
            solve(&s->gamma, 1, unit, 1, s->work);
            without = unit[j];
        }
        integral = s->gamma.d[j] + (j ? s->gamma.e[j - 1] : 0) + (j + 1 < m ? s->gamma.e[j] : 0);
        /* The mean over C and the rest are independent; constants take 1 / 2 pi of the circle's inverse. */
        const double inverse = with_poles / (2 * PI) + without * (inverse_c - 1 / (2 * PI));
        double ring = 0;
        for (uint32_t i = 0; i < n; ++i)
            ring += (double)atomic_load_explicit(&g->nodes[(size_t)i * m + j].squares, memory_order_relaxed) / FIXED;
        for (uint32_t i = 0; i < n; ++i) {
            const double own = (double)atomic_load_explicit(&g->nodes[(size_t)i * m + j].squares, memory_order_relaxed) / FIXED;
            const double density = (pole ? ring / n : own) / (integral * 2 * PI / n);
            se[(size_t)i * m + j] = scale * sqrt(density * inverse);
        }
    }
}

/* Means of mirror images, in place. */
static void impose(lum_symmetry symmetry, double *x, double *se, uint32_t n, uint32_t m)
{
    const bool all = symmetry == LUM_SYMMETRY_AXIAL;
    for (uint32_t j = 0; j < m; ++j) {
        if (all) {
            double mean = 0, variance = 0;
            for (uint32_t i = 0; i < n; ++i) {
                mean += x[(size_t)i * m + j] / n;
                variance += se[(size_t)i * m + j] * se[(size_t)i * m + j];
            }
            for (uint32_t i = 0; i < n; ++i) {
                x[(size_t)i * m + j] = mean;
                se[(size_t)i * m + j] = sqrt(variance) / n;
            }
            continue;
        }
        for (int mirror = 0; mirror < 2; ++mirror) {
            const bool wanted =
                symmetry == LUM_SYMMETRY_QUADRANT || symmetry == (mirror ? LUM_SYMMETRY_C90_C270 : LUM_SYMMETRY_C0_C180);
            for (uint32_t i = 0; wanted && i < n; ++i) {
                const uint32_t k = (mirror ? n + n / 2 - i : n - i) % n;
                if (k <= i)
                    continue;
                double *a = &x[(size_t)i * m + j], *b = &x[(size_t)k * m + j], *p = &se[(size_t)i * m + j],
                       *q = &se[(size_t)k * m + j];
                *a = *b = 0.5 * (*a + *b);
                *p = *q = 0.5 * hypot(*p, *q);
            }
        }
    }
}

/* The planes that the symmetry keeps, in the order of lum_photometry. */
static uint32_t kept_planes(lum_symmetry symmetry, uint32_t n, int32_t *first)
{
    *first = symmetry == LUM_SYMMETRY_C90_C270 ? -(int32_t)(n / 4) : 0;
    switch (symmetry) {
    case LUM_SYMMETRY_AXIAL:
        return 1;
    case LUM_SYMMETRY_C0_C180:
    case LUM_SYMMETRY_C90_C270:
        return n / 2 + 1;
    case LUM_SYMMETRY_QUADRANT:
        return n / 4 + 1;
    default:
        return n;
    }
}

static void describe(const bake_goniometer *g, double up_share, lum_photometry *p)
{
    p->absolute = true;
    const lmg_vec3 lo = g->o.bounds_min, hi = g->o.bounds_max;
    p->housing[0] = hi.x - lo.x;
    p->housing[1] = hi.z - lo.z;
    p->housing[2] = hi.y - lo.y;
    if (!(p->housing[0] > 0 || p->housing[1] > 0 || p->housing[2] > 0))
        return;
    /* What shines down alone shines from an opening; else from all around. */
    const bool flat = up_share < 0.001;
    p->shape.c0 = p->housing[0];
    p->shape.c90 = p->housing[1];
    p->shape.height = flat ? 0 : p->housing[2];
    p->shape.kind = p->shape.c0 > 0 && p->shape.c90 > 0 && p->shape.height > 0 ? LUM_SHAPE_BOX : LUM_SHAPE_RECTANGLE;
}

lmg_result bake_goniometer_read(const bake_goniometer *g, double lumens_per_unit, lum_photometry **out, double **errors,
                                lmg_error *err)
{
    *out = NULL;
    if (errors)
        *errors = NULL;
    const uint32_t n = g->o.planes, m = g->o.angles;
    const size_t count = (size_t)n * m;
    least_squares s;
    double *x = malloc(count * sizeof(*x)), *se = malloc(count * sizeof(*se));
    lum_photometry *p = NULL;
    lmg_result result = LMG_OK;
    if (!squares_create(&s, n, m) || !x || !se)
        result = lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a far field of %u x %u angles", n, m);
    double total = 0;
    if (result == LMG_OK) {
        for (size_t i = 0; i < count; ++i) {
            x[i] = (double)atomic_load_explicit(&g->nodes[i].sum, memory_order_relaxed) / FIXED * lumens_per_unit;
            total += x[i];
        }
        if (!(total > 0))
            result = lmg_fail(err, LMG_ERROR_INPUT, "no light arrived in the far field");
    }
    if (result == LMG_OK) {
        squares_solve(&s, x);
        standard_errors(g, &s, lumens_per_unit, se);
        impose(g->o.symmetry, x, se, n, m);
        int32_t first;
        const uint32_t kept = kept_planes(g->o.symmetry, n, &first);
        result = lum_photometry_create(kept, m, &p, err);
        for (uint32_t i = 0; result == LMG_OK && i < kept; ++i) {
            const uint32_t from = (uint32_t)(first + (int32_t)i + (int32_t)n) % n;
            p->h[i] = 360.0 * (first + (int32_t)i) / n;
            for (uint32_t j = 0; j < m; ++j)
                p->intensity[(size_t)i * m + j] = fmax(x[(size_t)from * m + j], 0);
        }
    }
    if (result == LMG_OK) {
        for (uint32_t j = 0; j < m; ++j)
            p->v[j] = 180.0 * j / (m - 1);
        p->symmetry = g->o.symmetry;
        lum_photometry_measures measures;
        result = lum_photometry_measure(p, &measures, err);
        if (result == LMG_OK) {
            const double scale = total / measures.flux;
            for (size_t i = 0; i < (size_t)p->h_count * m; ++i)
                p->intensity[i] *= scale;
            describe(g, measures.up / measures.flux, p);
        }
    }
    squares_destroy(&s);
    if (result == LMG_OK && errors) {
        int32_t first;
        const uint32_t kept = kept_planes(g->o.symmetry, n, &first);
        for (uint32_t i = 0; i < kept; ++i) /* x is free by now */
            memcpy(x + (size_t)i * m, se + (size_t)((uint32_t)(first + (int32_t)i + (int32_t)n) % n) * m, m * sizeof(*x));
        *errors = x;
        x = NULL;
    }
    free(x);
    free(se);
    if (result != LMG_OK)
        lum_photometry_destroy(p);
    else
        *out = p;
    return result;
}
