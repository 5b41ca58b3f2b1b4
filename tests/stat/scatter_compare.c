/* SPDX-License-Identifier: Apache-2.0 */
/* Samples of scattering against its densities: scatter_compare.h. */
#include "scatter_compare.h"

#include <luminaires/rng.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

grid grid_about(lmg_vec3 axis, double width)
{
    grid r;
    r.z = axis;
    lmg_vec3 t = fabs(axis.x) < 0.6 ? v3(1, 0, 0) : v3(0, 1, 0);
    r.x = unit(v3(axis.y * t.z - axis.z * t.y, axis.z * t.x - axis.x * t.z, axis.x * t.y - axis.y * t.x));
    r.y = v3(axis.y * r.x.z - axis.z * r.x.y, axis.z * r.x.x - axis.x * r.x.z, axis.x * r.x.y - axis.y * r.x.x);
    /* First ring about width / 4: pi g / (RINGS e^g) = width / 4. */
    r.g = 0.5;
    for (int i = 0; i < 60; i++) {
        r.g = fmax(0.5, log(4 * PI * r.g / (RINGS * width) + 1));
    }
    return r;
}

double ring_angle(const grid *g, double x)
{
    return PI * expm1(g->g * x) / expm1(g->g);
}

static int cell_of(const grid *g, lmg_vec3 w)
{
    double x = dot(w, g->x), y = dot(w, g->y), theta = atan2(hypot(x, y), dot(w, g->z));
    int ring = (int)(log1p(theta / PI * expm1(g->g)) / g->g * RINGS);
    int sector = (int)((atan2(y, x) / (2 * PI) + 0.5) * SECTORS);
    ring = ring < RINGS ? ring : RINGS - 1;
    sector = sector < SECTORS ? sector : SECTORS - 1;
    return ring * SECTORS + sector;
}

lmg_vec3 direction(const grid *g, double theta, double phi)
{
    double x = sin(theta) * cos(phi), y = sin(theta) * sin(phi), z = cos(theta);
    return v3(x * g->x.x + y * g->y.x + z * g->z.x, x * g->x.y + y * g->y.y + z * g->z.y, x * g->x.z + y * g->y.z + z * g->z.z);
}

/* Three-point Gauss-Legendre in each direction over [x0,x1] x [y0,y1] of the grid's (ring, turn) plane, cut in n x n parts;
 * directions on the wrong side of the surface count zero.  Parts that the horizon crosses are cut again, EDGE times. */
static void integrate_patch(const lum_surface *s, lmg_vec3 wi, float eta, const grid *g, lmg_vec3 up, double x0, double x1,
                            double y0, double y1, int n, int deeper, double *pdf_sum, double p_sum[3])
{
    static const double node[3] = {0.5 - 0.3872983346207417, 0.5, 0.5 + 0.3872983346207417},
                        weight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};
    for (int part = 0; part < n * n; part++) {
        double xa = x0 + (x1 - x0) * (part / n) / n, xb = x0 + (x1 - x0) * (part / n + 1) / n;
        double ya = y0 + (y1 - y0) * (part % n) / n, yb = y0 + (y1 - y0) * (part % n + 1) / n;
        double a = ring_angle(g, xa), b = ring_angle(g, xb);
        int above = 0;
        for (int k = 0; k < 4; k++) {
            above += dot(direction(g, k & 1 ? a : b, 2 * PI * (k & 2 ? ya : yb)), up) > 0;
        }
        if (above == 0) {
            continue; /* rings are narrow enough for the corners to tell */
        }
        if (above < 4 && deeper > 0) {
            integrate_patch(s, wi, eta, g, up, xa, xb, ya, yb, 2, deeper - 1, pdf_sum, p_sum);
            continue;
        }
        for (int i = 0; i < 9; i++) {
            double theta = a + (b - a) * node[i / 3], phi = 2 * PI * (ya + (yb - ya) * node[i % 3]);
            lmg_vec3 wo = direction(g, theta, phi);
            if (dot(wo, up) <= 0) {
                continue;
            }
            double w = (b - a) * weight[i / 3] * sin(theta) * 2 * PI * (yb - ya) * weight[i % 3];
            float p[3];
            double pdf = lum_scatter_pdf(s, wi, wo, eta);
            lum_scatter_eval(s, wi, wo, eta, p);
            assert_true(pdf >= 0 && pdf < (double)INFINITY);
            *pdf_sum += w * pdf;
            for (int c = 0; c < 3; c++) {
                assert_true(p[c] >= 0);
                p_sum[c] += w * (double)p[c];
            }
        }
    }
}

void integrate(const lum_surface *s, lmg_vec3 wi, float eta, const grid grids[2], int fine, integrals *out)
{
    memset(out, 0, sizeof *out);
    for (int half = 0; half < 2; half++) {
        double side = (dot(wi, s->ng) >= 0) == (half == 0) ? 1 : -1;
        lmg_vec3 up = v3(side * s->ng.x, side * s->ng.y, side * s->ng.z);
        for (int i = 0; i < HALF; i++) {
            int ring = i / SECTORS, sector = i % SECTORS;
            double *pdf = &out->pdf[half * HALF + i];
            integrate_patch(s, wi, eta, &grids[half], up, (double)ring / RINGS, (ring + 1.0) / RINGS,
                            (double)sector / SECTORS - 0.5, (sector + 1.0) / SECTORS - 0.5, fine, EDGE - 2, pdf, out->p);
            out->total += *pdf;
        }
    }
}

void draw(const lum_surface *s, lmg_vec3 wi, float eta, const grid grids[2], int samples, uint64_t seed, sampled *out)
{
    memset(out, 0, sizeof *out);
    lum_rng rng = lum_rng_stream(seed, 0);
    double side = dot(wi, s->ng) >= 0 ? 1 : -1;
    for (int i = 0; i < samples; i++) {
        double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lum_scattered o;
        lum_scatter_sample(s, wi, eta, xi, &o);
        assert_true(fabs(dot(o.wo, o.wo) - 1) < 1e-9);
        if (o.event == LUM_ABSORBED) {
            for (int k = 0; k < 3; k++) {
                stats_add(&out->weight[k], 0);
            }
            out->counts[CELLS]++;
            continue;
        }
        bool delta = (o.event & LUM_DELTA) != 0;
        double c = dot(o.wo, s->ng) * side;
        out->leaks += o.event & LUM_REFLECTED ? c < 0 : c > 0;
        for (int k = 0; k < 3; k++) {
            out->all[k] += (double)o.weight[k] / samples;
            out->largest = fmax(out->largest, (double)o.weight[k]);
            stats_add(&out->weight[k], delta ? 0 : (double)o.weight[k]);
        }
        if (delta) {
            out->counts[CELLS]++;
        } else {
            assert_true(o.pdf > 0);
            int half = c < 0;
            out->counts[half * HALF + cell_of(&grids[half], o.wo)]++;
        }
    }
}

/* Where a smooth surface with normal n (on either side) would send light. */
lmg_vec3 reflected(lmg_vec3 wi, lmg_vec3 n)
{
    double c = 2 * dot(wi, n);
    return v3(c * n.x - wi.x, c * n.y - wi.y, c * n.z - wi.z);
}

/* Mirrored at the plane with normal n. */
static lmg_vec3 flipped(lmg_vec3 w, lmg_vec3 n)
{
    lmg_vec3 r = reflected(w, n);
    return v3(-r.x, -r.y, -r.z);
}

static lmg_vec3 refracted(lmg_vec3 wi, lmg_vec3 n, double step)
{
    double c = dot(wi, n), t = sqrt(fmax(0, 1 - (1 - c * c) / (step * step))), k = c / step - (c > 0 ? t : -t);
    return unit(v3(k * n.x - wi.x / step, k * n.y - wi.y / step, k * n.z - wi.z / step));
}

/* One configuration: samples against density. */
void compare(const char *name, const lum_surface *s, lmg_vec3 wi, float eta, uint64_t seed, double table, tally *t)
{
    static integrals q;
    static sampled n;
    if (t->tests++ % EVERY) {
        return;
    }
    /* Lobes at grazing incidence are narrower across the plane of incidence, by the cosine. */
    double cosine = fabs(dot(wi, s->ng)), width = fmax((double)s->alpha * cosine, 2e-5), side = dot(wi, s->ng) >= 0 ? 1 : -1;
    double step = s->material->thin ? 1
                  : side > 0        ? (double)s->material->ior / (double)eta
                                    : (double)eta / (double)s->material->ior;
    lmg_vec3 normal = s->tilted ? s->ns : s->ng, mirror = reflected(wi, normal), through = refracted(wi, normal, step);
    if (dot(wi, normal) * side <= 0) {
        mirror = reflected(wi, s->ng);
        through = refracted(wi, s->ng, step);
    }
    if (dot(mirror, s->ng) * side <
        0) { /* what points below the surface is mirrored at it, and so is what doesn't when it should */
        mirror = flipped(mirror, s->ng);
    }
    if (dot(through, s->ng) * side > 0) {
        through = flipped(through, s->ng);
    }
    grid grids[2] = {grid_about(mirror, width), grid_about(through, width)};
    /* Narrow lobes at grazing incidence, and broad refraction with its edge at the critical angle, want finer parts. */
    bool edge = s->alpha > 0.5f && s->transmission > 0 && !s->material->thin;
    integrate(s, wi, eta, grids, cosine < 0.1 && s->alpha < 0.02f ? 3 * FINE : edge ? 2 * FINE : FINE, &q);
    draw(s, wi, eta, grids, SAMPLES, seed, &n);
    double expected[CELLS + 1], delta = n.counts[CELLS] / SAMPLES;
    for (int i = 0; i < CELLS; i++) {
        expected[i] = SAMPLES * q.pdf[i] * (1 - delta) / q.total;
    }
    expected[CELLS] = SAMPLES * delta; /* its share is tested below */
    int degrees = 0;
    double x = 0, p = q.total > 1e-6 ? stats_chi_square(n.counts, expected, CELLS, &x, &degrees) : 1;
    double total_error = fabs(q.total + delta - 1);
    double se = sqrt(fmax(delta * (1 - delta), 1e-12) / SAMPLES);
    double allowed = 4 * se + table;
    for (int k = 0; k < 3; k++) {
        double z = (fabs(n.weight[k].mean - q.p[k]) - table) / fmax(stats_error(&n.weight[k]), 1e-9);
        t->worst_z = fmax(t->worst_z, z);
        if (z > 4.5) {
            print_message("%s: weight %d: mean %.6f, integral %.6f, z %.2f\n", name, k, n.weight[k].mean, q.p[k], z);
        }
    }
    if (total_error > allowed) {
        print_message("%s: integral %.6f + delta %.6f, off by %.2e, allowed %.2e\n", name, q.total, delta, total_error, allowed);
    }
    t->worst_total = fmax(t->worst_total, total_error / allowed);
    if (p < t->lowest) {
        t->lowest = p;
        snprintf(t->where, sizeof t->where, "%s: chi2 %.1f of %d", name, x, degrees);
    }
    if (p < 1e-5) {
        print_message("%s: chi2 %.1f of %d, p %.2e\n", name, x, degrees, p);
    }
    assert_true(n.leaks == 0);
    assert_true(n.largest <= 1);
}

void judge(const tally *t)
{
    print_message("%d comparisons: smallest p %.2e (%s); worst total %.2f of what is allowed, worst weight %.2f se\n", t->tests,
                  t->lowest, t->where, t->worst_total, t->worst_z);
    assert_true(t->lowest > stats_sidak(0.01, t->tests));
    assert_true(t->worst_total <= 1);
    assert_true(t->worst_z < 4.5); /* 3 weights in each of some 250 comparisons: 5e-3 by chance */
}
