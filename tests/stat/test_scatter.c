/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Scattering at surfaces: samples against densities (chi-square), weights against quadrature of the density, energy, reciprocity,
 * tilted shading normals.  Densities are integrated on two polar grids, one about the mirror direction for the side of the light,
 * one about the refracted direction for the other side, with rings that follow the width of the lobe; odd numbers of cells, so that
 * their edges avoid symmetry planes.
 */
#include "../../luminaires/src/microfacet.h"
#include "../unit/make_model.h"
#include "stats.h"

#include <luminaires/rng.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#define PI 3.14159265358979323846

enum { RINGS = 41, SECTORS = 17, HALF = RINGS * SECTORS, CELLS = 2 * HALF, FINE = 3, EDGE = 6 };

/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SAMPLES = 5000, EVERY = 13 };
#else
enum { SAMPLES = 200000, EVERY = 1 }; /* enough to see a lobe that is one degree off: mutants_are_rejected */
#endif

static lmg_vec3 v3(double x, double y, double z)
{
    lmg_vec3 r = {x, y, z};
    return r;
}

static double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static lmg_vec3 unit(lmg_vec3 a)
{
    double l = sqrt(dot(a, a));
    return v3(a.x / l, a.y / l, a.z / l);
}

/* A polar grid: rings at theta = pi (e^(g x) - 1) / (e^g - 1), x = i / RINGS; g makes the first ring a fraction of the lobe's
 * width. */
typedef struct grid {
    lmg_vec3 x, y, z;
    double g;
} grid;

static grid grid_about(lmg_vec3 axis, double width)
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

static double ring_angle(const grid *g, double x)
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

typedef struct integrals {
    double pdf[CELLS];
    double p[3], total;
} integrals;

static lmg_vec3 direction(const grid *g, double theta, double phi)
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

static void integrate(const lum_surface *s, lmg_vec3 wi, float eta, const grid grids[2], int fine, integrals *out)
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

typedef struct sampled {
    double counts[CELLS + 1]; /* the last: delta */
    stats_mean weight[3];     /* of what isn't delta */
    double all[3];            /* mean weight of everything */
    double largest;           /* weight */
    double leaks;             /* reflected below, transmitted above */
} sampled;

static void draw(const lum_surface *s, lmg_vec3 wi, float eta, const grid grids[2], int samples, uint64_t seed, sampled *out)
{
    memset(out, 0, sizeof *out);
    lum_rng rng = lum_rng_stream(seed, 0);
    double side = dot(wi, s->ng) >= 0 ? 1 : -1;
    for (int i = 0; i < samples; i++) {
        double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lum_scattered o;
        lum_scatter_sample(s, wi, eta, xi, &o);
        assert_true(fabs(dot(o.wo, o.wo) - 1) < 1e-9);
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

/* One quad per material; triangle 2 i has material i. */
static lum_scene *scene_of(lum_model *model)
{
    lum_scene *scene;
    for (uint32_t i = 0; i < model->material_count; i++) {
        make_quad(model, v3(-1, -1, -1.0 * i), v3(2, 0, 0), v3(0, 2, 0), 1, i);
    }
    finish_model(model);
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    return scene;
}

typedef struct scattering_case {
    const char *name;
    lum_surface_kind kind;
    float metallic, transmission, diffuse_transmission, ior;
    bool thin, eta;
} scattering_case;

static const scattering_case CASES[] = {
    {"Lambert", LUM_SURFACE_LAMBERT, 0, 0, 0, 1.5f, false, false},
    {"Lambert, part through", LUM_SURFACE_LAMBERT, 0, 0, 0.3f, 1.5f, false, false},
    {"metal", LUM_SURFACE_CONDUCTOR, 0, 0, 0, 1.5f, false, false},
    {"metal of index eta, k", LUM_SURFACE_CONDUCTOR, 0, 0, 0, 1.5f, false, true},
    {"coated diffuser", LUM_SURFACE_PBR, 0, 0, 0, 1.5f, false, false},
    {"coated diffuser, part through", LUM_SURFACE_PBR, 0, 0, 0.4f, 1.5f, false, false},
    {"half metal", LUM_SURFACE_PBR, 0.45f, 0, 0, 1.5f, false, false},
    {"glass", LUM_SURFACE_PBR, 0, 1, 0, 1.52f, false, false},
    {"half glass", LUM_SURFACE_PBR, 0, 0.6f, 0.2f, 1.52f, false, false},
    {"pane", LUM_SURFACE_PBR, 0, 1, 0, 1.52f, true, false},
    {"a bit of everything", LUM_SURFACE_PBR, 0.3f, 0.5f, 0.25f, 1.7f, true, false},
};
enum { CASE_COUNT = sizeof CASES / sizeof CASES[0] };
static const float ROUGHNESS[] = {0, 1e-3f, 0.05f, 0.2f, 0.5f, 1};
enum { ROUGHNESS_COUNT = sizeof ROUGHNESS / sizeof ROUGHNESS[0] };

static lum_model *all_materials(bool coloured)
{
    static const float BASE[3] = {0.9f, 0.55f, 0.2f}, THROUGH[3] = {0.35f, 0.6f, 0.8f};
    lum_model *model = make_model();
    for (int i = 0; i < CASE_COUNT; i++) {
        for (int r = 0; r < ROUGHNESS_COUNT; r++) {
            const scattering_case *c = &CASES[i];
            uint32_t index = make_material(model, c->kind);
            lum_material *m = &model->materials[index];
            m->roughness = ROUGHNESS[r];
            m->metallic = c->metallic;
            m->transmission = c->transmission;
            m->diffuse_transmission = c->diffuse_transmission;
            m->ior = c->ior;
            m->thin = c->thin;
            if (c->eta && coloured) {
                static const float ETA[3] = {0.18f, 0.42f, 1.37f}, K[3] = {3.42f, 2.35f, 1.77f}; /* like gold */
                m->has_eta = true;
                memcpy(m->eta, ETA, sizeof ETA);
                memcpy(m->k, K, sizeof K);
            }
            if (coloured) {
                memcpy(m->base_color, BASE, sizeof BASE);
                memcpy(m->diffuse_transmission_color, THROUGH, sizeof THROUGH);
            }
        }
    }
    return model;
}

static const double DEGREES[] = {0, 23, 51, 77, 88};
enum { DEGREES_COUNT = sizeof DEGREES / sizeof DEGREES[0] };

static lmg_vec3 incoming(double degrees, bool behind)
{
    double t = degrees * PI / 180, phi = 0.7;
    return v3(sin(t) * cos(phi), sin(t) * sin(phi), behind ? -cos(t) : cos(t));
}

static void white_furnace(void **state)
{
    (void)state;
    lum_model *model = all_materials(false);
    lum_scene *scene = scene_of(model);
    const lmg_vec3 tilts[] = {unit(v3(0.2, 0.1, 1)), unit(v3(-0.9, 0.5, 1)), unit(v3(0.1, -3, 1))};
    lum_rng rng = lum_rng_stream(21, 0);
    for (uint32_t m = 0; m < model->material_count; m++) {
        for (int a = 0; a < 2 * DEGREES_COUNT; a++) {
            lmg_vec3 wi = incoming(DEGREES[a / 2], a & 1), d = v3(-wi.x, -wi.y, -wi.z);
            for (int tilt = 0; tilt < 4; tilt++) {
                lum_surface s = surface_of(scene, 2 * m, d, tilt ? &tilts[tilt - 1] : NULL);
                for (int i = 0; i < 500; i++) {
                    double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
                    lum_scattered o;
                    lum_polarization pol = {0};
                    lum_scatter_trace(&s, wi, i % 3 ? 1 : 1.33f, xi, i & 1 ? &pol : NULL, &o);
                    assert_true(o.weight[0] == 1 && o.weight[1] == 1 && o.weight[2] == 1);
                    /* On the side that the event says. */
                    double c = dot(o.wo, s.ng) * (wi.z > 0 ? 1 : -1);
                    assert_true(o.event & LUM_REFLECTED ? c >= 0 : c <= 0);
                    assert_true(fabs(dot(o.wo, o.wo) - 1) < 1e-9);
                    if (pol.known) {
                        assert_true(fabs(dot(pol.re, pol.re) + dot(pol.im, pol.im) - 1) < 1e-9);
                        assert_true(fabs(dot(pol.re, o.wo)) < 1e-7 && fabs(dot(pol.im, o.wo)) < 1e-7);
                    }
                }
            }
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

/* Extremes of the numbers and of the incidence. */
static void extremes(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    const double ends[] = {0, 0.25, 0.5, 1 - 0x1p-53};
    const double grazing[] = {1, 1e-3, 1e-8, 1e-16, 0};
    for (uint32_t m = 0; m < model->material_count; m++) {
        for (int a = 0; a < 10; a++) {
            double c = grazing[a / 2], r = sqrt(1 - c * c);
            lmg_vec3 wi = v3(0.6 * r, -0.8 * r, a & 1 ? -c : c), tilt = unit(v3(1, 1, 0.5));
            for (int t = 0; t < 2; t++) {
                lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), t ? &tilt : NULL);
                for (int i = 0; i < 256; i++) {
                    double xi[4] = {ends[i & 3], ends[i >> 2 & 3], ends[i >> 4 & 3], ends[i >> 6]};
                    lum_scattered o;
                    lum_polarization pol = {0};
                    lum_scatter_trace(&s, wi, 1, xi, &pol, &o);
                    if (!(fabs(dot(o.wo, o.wo) - 1) < 1e-9)) {
                        print_message("material %u, incidence %d, tilt %d, numbers %d: |wo| %g\n", m, a, t, i, dot(o.wo, o.wo));
                    }
                    assert_true(fabs(dot(o.wo, o.wo) - 1) < 1e-9);
                    lum_scatter_sample(&s, wi, 1, xi, &o);
                    assert_true(o.pdf >= 0 && o.pdf < (double)INFINITY);
                    for (int k = 0; k < 3; k++) {
                        assert_true(o.weight[k] >= 0 && o.weight[k] <= 1);
                    }
                }
            }
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

/* Where a smooth surface with normal n (on either side) would send light. */
static lmg_vec3 reflected(lmg_vec3 wi, lmg_vec3 n)
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

/* What interpolation and quadrature of the albedo tables may be off by (tables_are_accurate): samples follow the true albedo,
 * densities the table. */
static const double TABLE = 4e-4;

typedef struct tally {
    int tests;
    double lowest;      /* p-value of the chi-square tests */
    double worst_total; /* |integral of the pdf + delta - 1| */
    double worst_z;     /* of the mean weights */
    char where[200];
} tally;

/* One configuration: samples against density. */
static void compare(const char *name, const lum_surface *s, lmg_vec3 wi, float eta, uint64_t seed, double table, tally *t)
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

static void samples_follow_densities(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    tally t = {.lowest = 1};
    for (int i = 0; i < CASE_COUNT; i++) {
        for (int r = 0; r < ROUGHNESS_COUNT; r++) {
            uint32_t m = (uint32_t)(i * ROUGHNESS_COUNT + r);
            if (r > 0 && CASES[i].kind == LUM_SURFACE_LAMBERT) {
                continue;
            }
            for (int a = 0; a < DEGREES_COUNT; a++) {
                for (int behind = 0; behind < 2; behind++) {
                    char name[200];
                    if (behind && !(CASES[i].transmission > 0)) {
                        continue; /* scatters as from the front */
                    }
                    lmg_vec3 wi = incoming(DEGREES[a], behind);
                    lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), NULL);
                    snprintf(name, sizeof name, "%s, roughness %g, %g degrees%s", CASES[i].name, (double)ROUGHNESS[r], DEGREES[a],
                             behind ? " from behind" : "");
                    compare(name, &s, wi, 1, 1000 + (uint64_t)t.tests, TABLE, &t);
                }
            }
        }
    }
    print_message("%d comparisons: smallest p %.2e (%s); worst total %.2f of what is allowed, worst weight %.2f se\n", t.tests,
                  t.lowest, t.where, t.worst_total, t.worst_z);
    assert_true(t.lowest > stats_sidak(0.01, t.tests));
    assert_true(t.worst_total <= 1);
    assert_true(t.worst_z < 4.5); /* 3 weights in each of some 250 comparisons: 5e-3 by chance */
    lum_scene_destroy(scene);
    free_model(model);
}

/* Normals tipped by interpolation or a map: also lobes that are mirrored at the geometric surface have the density they say. */
static void tilted_normals(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    const lmg_vec3 tilts[] = {unit(v3(0.3, -0.1, 1)), unit(v3(-1.2, 0.4, 1))};
    tally t = {.lowest = 1};
    for (int i = 2; i < CASE_COUNT; i++) {
        for (int r = 3; r < 5; r++) {
            for (int a = 1; a < DEGREES_COUNT - 1; a++) {
                for (int k = 0; k < 4; k++) {
                    char name[200];
                    bool behind = k & 1;
                    lmg_vec3 wi = incoming(DEGREES[a], behind);
                    lum_surface s =
                        surface_of(scene, 2 * (uint32_t)(i * ROUGHNESS_COUNT + r), v3(-wi.x, -wi.y, -wi.z), &tilts[k / 2]);
                    snprintf(name, sizeof name, "%s, roughness %g, %g degrees%s, tilt %d", CASES[i].name, (double)ROUGHNESS[r],
                             DEGREES[a], behind ? " from behind" : "", k / 2);
                    compare(name, &s, wi, 1, 9000 + (uint64_t)t.tests, TABLE, &t);
                }
            }
        }
    }
    print_message("%d comparisons: smallest p %.2e (%s); worst total %.2f of what is allowed, worst weight %.2f se\n", t.tests,
                  t.lowest, t.where, t.worst_total, t.worst_z);
    assert_true(t.lowest > stats_sidak(0.01, t.tests));
    assert_true(t.worst_total <= 1);
    assert_true(t.worst_z < 4.5);
    lum_scene_destroy(scene);
    free_model(model);
}

/* f = p / cos is symmetric; across refraction f / n_o^2 is: radiance over n^2 is what travels unchanged. */
static void reciprocity(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    lum_rng rng = lum_rng_stream(31, 0);
    int compared = 0;
    for (uint32_t m = 0; m < model->material_count; m++) {
        const lum_material *material = &model->materials[m];
        bool solid = material->transmission > 0 && !material->thin;
        for (int i = 0; i < 400; i++) {
            lmg_vec3 w[2];
            for (int k = 0; k < 2; k++) {
                double z = 2 * lum_rng_next(&rng) - 1, phi = 2 * PI * lum_rng_next(&rng), q = sqrt(1 - z * z);
                w[k] = v3(q * cos(phi), q * sin(phi), z);
            }
            if (material->kind == LUM_SURFACE_PBR && solid && material->transmission < 1 && w[0].z * w[1].z < 0) {
                continue; /* the diffusing share of a half clear solid has an interface on one side only */
            }
            float f[2][3];
            double n2[2];
            for (int k = 0; k < 2; k++) {
                lum_surface s = surface_of(scene, 2 * m, v3(-w[k].x, -w[k].y, -w[k].z), NULL);
                lum_scatter_eval(&s, w[k], w[1 - k], 1, f[k]);
                n2[k] = solid && w[1 - k].z < 0 ? (double)material->ior * (double)material->ior : 1;
            }
            for (int c = 0; c < 3; c++) {
                double a = (double)f[0][c] / fabs(w[1].z) / n2[0], b = (double)f[1][c] / fabs(w[0].z) / n2[1];
                /* p is returned in float; a smooth coat has its exact reflectance for the light that enters and the interpolated
                 * one of its table for the light that leaves: up to 2e-3 of 1 - E, more where 1 - E itself is small near grazing.
                 */
                bool smooth_coat = material->kind == LUM_SURFACE_PBR && material->roughness * material->roughness < LUM_SMOOTH;
                double tolerance = smooth_coat ? 0.02 : 4e-7;
                if (smooth_coat && (fabs(w[0].z) < 0.05 || fabs(w[1].z) < 0.05)) {
                    continue;
                }
                assert_true(fabs(a - b) <= tolerance * (fabs(a) + fabs(b)));
                compared += a > 0;
            }
        }
    }
    print_message("%d values compared\n", compared);
    assert_true(compared > 10000);
    lum_scene_destroy(scene);
    free_model(model);
}

/* The tables against quadrature with a hundred times the points, at cosines and roughnesses between their nodes. */
static void tables_are_accurate(void **state)
{
    (void)state;
    lum_model *model = make_model();
    const float texel[4] = {1, 1, 1, 1};
    int32_t image = make_image(model, 1, 1, texel);
    uint32_t m[2] = {make_glass(model, 1.5f, 1, false), make_material(model, LUM_SURFACE_PBR)};
    model->materials[m[0]].metallic = 0.5f;
    model->materials[m[0]].metal_rough_texture.image = image; /* all roughnesses */
    model->materials[m[1]].roughness = 0.45f;                 /* one */
    lum_scene *scene = scene_of(model);
    for (int which = 0; which < 2; which++) {
        const struct lum_tables *tables = surface_of(scene, 2 * m[which], v3(0, 0, -1), NULL).tables;
        const lum_lobe_set *sets[4] = {tables->medium[0].coat, tables->metal, tables->medium[0].outside, tables->medium[0].inside};
        for (int k = 0; k < (which ? 1 : 4); k++) {
            double worst = 0;
            for (int r = 0; r < (which ? 1 : 10); r++) {
                double alpha = which ? (double)(0.45f * 0.45f) : pow(0.15 + 0.09 * r, 2);
                for (int j = 1; j < 12; j++) {
                    double mu = 0.035 + 0.08 * j;
                    double exact = 1 - lum_lobe_albedo((lum_lobe_kind)sets[k]->kind, alpha, (double)sets[k]->eta, mu, 200000);
                    worst = fmax(worst, fabs(lum_lobe_rest(sets[k], alpha, mu) - exact));
                }
            }
            print_message("%s, table %d: off by at most %.1e\n", which ? "one roughness" : "all roughnesses", k, worst);
            assert_true(worst < TABLE);
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

/* The tests above must be able to fail: densities that are wrong by as much as people get them wrong are found out. */
static void mutants_are_rejected(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t m = make_lambert(model, 1);
    lum_scene *scene = scene_of(model);
    lmg_vec3 wi = incoming(51, false);
    lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), NULL);
    grid grids[2] = {grid_about(reflected(wi, s.ng), 1), grid_about(v3(0, 0, -1), 1)};
    /* A Lambertian tipped by one degree differs by chi2 = 1.4e-3 N on some 600 cells, whose spread is 35 to 50: N = 100000 is a
     * matter of luck (p up to 4e-5 over 40 seeds), 200000 gives p < 1e-17, this p < 1e-50. */
    enum { MUTANT_SAMPLES = 400000 };
    static integrals q;
    static sampled n;
    integrate(&s, wi, 1, grids, FINE, &q);
    draw(&s, wi, 1, grids, MUTANT_SAMPLES, 77, &n);
    double right[CELLS], no_cosine[CELLS], tilted[CELLS], sum = 0;
    lmg_vec3 tip = unit(v3(0.02, 0, 1)); /* one degree */
    for (int i = 0; i < CELLS; i++) {
        right[i] = MUTANT_SAMPLES * q.pdf[i];
    }
    assert_true(stats_chi_square(n.counts, right, CELLS, NULL, NULL) > 0.01);
    for (int mutant = 0; mutant < 2; mutant++) {
        double *e = mutant ? tilted : no_cosine;
        sum = 0;
        for (int i = 0; i < CELLS; i++) {
            int k = i % HALF;
            lmg_vec3 w = direction(&grids[i / HALF], ring_angle(&grids[i / HALF], (k / SECTORS + 0.5) / RINGS),
                                   2 * PI * ((k % SECTORS + 0.5) / SECTORS - 0.5));
            e[i] = w.z > 0.02 ? right[i] * (mutant ? fmax(dot(w, tip), 0) / w.z : 1 / w.z) : right[i];
            sum += e[i];
        }
        for (int i = 0; i < CELLS; i++) {
            e[i] *= MUTANT_SAMPLES / sum;
        }
        assert_true(stats_chi_square(n.counts, e, CELLS, NULL, NULL) < 1e-6);
    }
    /* A pdf scaled by 1.03 shows in the total. */
    assert_true(fabs(1.03 * q.total - 1) > TABLE);
    assert_true(fabs(q.total - 1) < TABLE);
    lum_scene_destroy(scene);
    free_model(model);
}

static void statistics(void **state)
{
    (void)state;
    /* Tabulated quantiles (Abramowitz and Stegun, table 26.8), to their digits. */
    assert_true(fabs(stats_chi_square_tail(3.84146, 1) - 0.05) < 1e-6);
    assert_true(fabs(stats_chi_square_tail(18.3070, 10) - 0.05) < 1e-6);
    assert_true(fabs(stats_chi_square_tail(135.807, 100) - 0.01) < 1e-5);
    assert_true(fabs(stats_chi_square_tail(2.55821, 10) - 0.99) < 1e-6);
    assert_true(fabs(stats_normal_tail(1.95996) - 0.05) < 1e-6);
    /* p-values of true hypotheses are uniform: Kolmogorov's test at 1e-3 (1.95 / sqrt(n)). */
    enum { TRIALS = 500, BINS = 23 };
    double p[TRIALS], worst = 0;
    lum_rng rng = lum_rng_stream(3, 3);
    for (int t = 0; t < TRIALS; t++) {
        double counts[BINS] = {0}, expected[BINS];
        for (int i = 0; i < 2000; i++) {
            double x = lum_rng_next(&rng);
            counts[(int)(x * x * BINS)]++;
        }
        for (int i = 0; i < BINS; i++) {
            expected[i] = 2000 * (sqrt((i + 1.0) / BINS) - sqrt((double)i / BINS));
        }
        p[t] = stats_chi_square(counts, expected, BINS, NULL, NULL);
    }
    for (int t = 0; t < TRIALS; t++) {
        double below = 0;
        for (int i = 0; i < TRIALS; i++) {
            below += p[i] <= p[t];
        }
        worst = fmax(worst, fabs(below / TRIALS - p[t]));
    }
    assert_true(worst < 1.95 / sqrt(TRIALS));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(statistics),
        cmocka_unit_test(white_furnace),
        cmocka_unit_test(extremes),
        cmocka_unit_test(tables_are_accurate),
        cmocka_unit_test(mutants_are_rejected),
        cmocka_unit_test(reciprocity),
        cmocka_unit_test(samples_follow_densities),
        cmocka_unit_test(tilted_normals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
