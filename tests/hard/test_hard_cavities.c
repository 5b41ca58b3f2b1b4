/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Hard cases of long paths and of angles: integrating spheres up to albedo 0.9999, guides with ten thousand bounces, closed boxes
 * that must not leak, Fresnel's equations at grazing and critical angles.  Statistical cases: fixed seeds, 3 standard errors.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"
#include "make_model.h"

#include "field.h"

#include <complex.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

static void add_point_light(lum_model *m, lmg_vec3 position)
{
    hard_ray_light(m, position, v3(0, -1, 0), 1);
    m->lights[0].kind = LUM_LIGHT_POINT;
}

/* A sphere of 2 rings^2 quads seen from inside, without those within `open` rings of the pole +y: the port. */
static void sphere_with_port(lum_model *m, double radius, uint32_t rings, uint32_t open, uint32_t material)
{
    const uint32_t around = 2 * rings;
    for (uint32_t i = open; i < rings; ++i)
        for (uint32_t k = 0; k < around; ++k) {
            const double a[2] = {PI * i / rings, PI * (i + 1) / rings},
                         b[2] = {2 * PI * k / around, 2 * PI * ((k + 1) % around) / around};
            lmg_vec3 p[4];
            for (int c = 0; c < 4; ++c) {
                const double t = a[c / 2], f = b[c == 1 || c == 2];
                p[c] = v3(radius * sin(t) * cos(f), radius * cos(t), radius * sin(t) * sin(f));
            }
            if (i > 0)
                make_triangle(m, p[0], p[1], p[2], material);
            if (i + 1 < rings)
                make_triangle(m, p[0], p[2], p[3], material);
        }
}

static void test_integrating_sphere(void **state)
{
    (void)state;
    enum { RINGS = 96, OPEN = 16 };
    static const double ALBEDOS[] = {0.98, 0.99, 0.999, 0.9999};
    double least_bounces = 0;
    for (int i = 0; i < 4; ++i) {
        lum_model *m = make_model();
        const float albedo = (float)ALBEDOS[i];
        const double rho = (double)albedo;
        sphere_with_port(m, 0.1, RINGS, OPEN, make_lambert(m, albedo));
        add_point_light(m, v3(0, 0, 0));
        finish_model(m);
        bake_source *s = hard_tracer(m, 31);
        const double photons = 60000;
        const bake_tally t = hard_trace(s, (uint64_t)photons, NULL);
        /* the port's share of the sphere, as area and as solid angle from the centre */
        const double f = 0.5 * (1 - cos(PI * OPEN / RINGS));
        /* E_port S / Phi = rho / (1 - rho (1 - f)) for what strikes the wall first; f of the light leaves directly */
        const double expected = f + (1 - f) * f * rho / (1 - rho * (1 - f)), got = t.escaped / photons;
        const double error = sqrt(expected * (1 - expected) / photons);
        const char *name = hard_text("integrating sphere, albedo %g, port of %.2f %%", ALBEDOS[i], 100 * f);
        hard_at_most(name, "E_port = Phi rho / (S (1 - rho (1 - f))), in standard errors", fabs(got - expected) / error, 3);
        hard_at_most(name, "lost", t.lost, 0);
        /* a photon strikes the wall (1 - f) / (1 - rho (1 - f)) times on average, spread about as much: none is cut off, none costs
         * more */
        const double bounces = (double)t.segments / photons, closed = expected + (1 - f) / (1 - rho * (1 - f));
        hard_at_most(name, "segments per photon against the closed form, in standard errors",
                     fabs(bounces / closed - 1) * sqrt(photons), 3);
        least_bounces = bounces;
        s->destroy(s);
        free_model(m);
    }
    assert_true(least_bounces > 10);
}

/* A square tube of mirrors of width 1 mm along y, and light that crosses it at 45 degrees. */
static lum_model *tube(double length, float reflectance)
{
    lum_model *m = make_model();
    const uint32_t mirror = make_mirror(m, reflectance, 0);
    const double w = 0.0005;
    make_quad(m, v3(-w, 0, -w), v3(0, length, 0), v3(0, 0, 2 * w), 1, mirror);
    make_quad(m, v3(w, 0, -w), v3(0, 0, 2 * w), v3(0, length, 0), 1, mirror);
    make_quad(m, v3(-w, 0, -w), v3(2 * w, 0, 0), v3(0, length, 0), 1, mirror);
    make_quad(m, v3(-w, 0, w), v3(0, length, 0), v3(2 * w, 0, 0), 1, mirror);
    hard_ray_light(m, v3(0.00013, 0.0001, 0.00007), v3(sqrt(0.5), sqrt(0.5), 0), 1e-6);
    finish_model(m);
    return m;
}

static void test_light_guides(void **state)
{
    (void)state;
    const double bounces = 10000;
    lum_model *m = tube(0.001 * bounces, 1);
    bake_source *s = hard_tracer(m, 5);
    bake_tally t = hard_trace(s, 300, NULL);
    hard_holds("mirror tube, 10^4 bounces, lossless", "all light leaves, none is cut off", t.escaped == 300,
               "%.0f of 300 photons left", t.escaped);
    /* new rays start 32 x 2^-24 of the largest coordinate (5 m from the centre) off a wall: a tube of 1 mm is that much narrower,
     * twice */
    const double narrowed = 1 - 2 * 32 * 0x1p-24 * 5 / 0.001, more = bounces / narrowed - bounces;
    hard_at_most("mirror tube, 10^4 bounces, lossless", "bounces per photon, difference from 10^4: what the offset off walls makes",
                 fabs((double)(t.segments - 300) / 300 - bounces), more + 2);
    s->destroy(s);
    free_model(m);

    m = tube(0.001 * bounces, 0.9999f);
    s = hard_tracer(m, 6);
    const double photons = 1500, expected = pow((double)0.9999f, bounces + more);
    t = hard_trace(s, (uint64_t)photons, NULL);
    hard_at_most("mirror tube, 10^4 bounces, reflectance 0.9999", "R^bounces leaves, in standard errors",
                 fabs(t.escaped / photons - expected) / sqrt(expected * (1 - expected) / photons), 3);
    s->destroy(s);
    free_model(m);

    /* a glass rod 1 mm thick and 10 m long, light born inside it at 40 degrees from the axis: total reflection at 50 degrees of
     * incidence, 8,400 of them from end to end, and some turn back at the ends */
    m = make_model();
    const uint32_t glass = make_glass(m, 1.5f, 0, false);
    make_box(m, v3(-0.0005, 0, -0.0005), v3(0.0005, 10, 0.0005), false, 1, glass);
    const double a = 40 * PI / 180;
    hard_ray_light(m, v3(0.0001, 0.001, 0.0002), v3(sin(a), cos(a), 0), 1e-6);
    finish_model(m);
    s = hard_tracer(m, 7);
    t = hard_trace(s, 400, NULL);
    hard_holds("glass rod, 8,400 total reflections", "all light leaves through the ends, none through the sides",
               t.escaped == 400 && t.lost == 0, "%.0f of 400 left, %.0f lost, %.0f segments each", t.escaped, t.lost,
               (double)t.segments / 400);
    s->destroy(s);
    free_model(m);
}

/* ------------------------------------------------------------------------------------------------------------- closed boxes */

/* The sample panel lit from its edge: hundreds of total reflections.  At most 1e-6 may be lost, one of these photons. */
static void test_edge_lit_panel(void **state)
{
    (void)state;
    char path[1200];
    snprintf(path, sizeof(path), "%s/models/edge-lit-panel/edge-lit-panel.gltf", LUMIBOX_BINARY_DIR);
    lum_model *m = hard_load(path, NULL);
    bake_source *s = hard_tracer(m, 3);
    const double photons = 1000000;
    const bake_tally t = hard_trace(s, (uint64_t)photons, NULL);
    hard_at_most(hard_text("edge-lit panel, %.0f segments a photon, %.3g photons", (double)t.segments / photons, photons),
                 "lost, share", t.lost / photons, 1e-6);
    s->destroy(s);
    lum_model_destroy(m);
}

/* A source flush with the bottom of the bounds, facing out, and one within white mirrors that touch the bounds on five sides. */
static void test_flush(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0), mirror = make_mirror(m, 1, 0);
    hard_emit(m, source, 1000);
    const double a = 0.1, h = 0.08;
    make_quad(m, v3(-0.5 * a, 0, -0.5 * a), v3(a, 0, 0), v3(0, 0, a), 1, source);
    make_quad(m, v3(-0.5 * a, 0.5 * h, -0.5 * a), v3(0, 0, a), v3(a, 0, 0), 1, source);
    make_quad(m, v3(-a, h, -a), v3(2 * a, 0, 0), v3(0, 0, 2 * a), 1, mirror); /* ceiling, and walls down to the opening */
    make_quad(m, v3(-a, 0, -a), v3(2 * a, 0, 0), v3(0, h, 0), 1, mirror);
    make_quad(m, v3(-a, 0, a), v3(0, h, 0), v3(2 * a, 0, 0), 1, mirror);
    make_quad(m, v3(-a, 0, -a), v3(0, h, 0), v3(0, 0, 2 * a), 1, mirror);
    make_quad(m, v3(a, 0, -a), v3(0, 0, 2 * a), v3(0, h, 0), 1, mirror);
    finish_model(m);
    static const lmg_layout_choice CHOICES[2] = {LMG_LAYOUT_CUBE, LMG_LAYOUT_APERTURE};
    for (int c = 0; c < 2; ++c) {
        const bake_options o = {.photons = 300000, .seed = 5, .fit.cells = 50000, .fit.choice = CHOICES[c]};
        bake_report report;
        lmg_field *f = hard_bake(m, &o, &report);
        const lmg_ledger l = lmg_field_ledger(f);
        const char *name = hard_text("emitter flush with the box's face, reflectors touching it, %s", c ? "aperture" : "cube");
        hard_at_most(name, "balance, relative", fabs((l.stored + l.residual + l.absorbed + l.lost) / l.emitted - 1), 1e-6);
        hard_at_most(name, "lost or kept from leaving, share: what hits the mirrors' common edges", (l.lost + l.residual) / l.emitted, 1e-5);
        bool finite = true;
        for (uint32_t j = 0; j < f->layout.slab_count; ++j)
            for (uint64_t k = 0; k < f->slabs[j].cells; ++k)
                finite = finite && isfinite(lmg_cell_radiance(&f->slabs[j], k)[0]) && isfinite(f->slabs[j].standard_error[k]);
        hard_holds(name, "no NaN, no infinity", finite, "%.4f of the light stored", l.stored / l.emitted);
        lmg_field_destroy(f);
    }
    free_model(m);
}

static void test_leaks(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        float reflectance, roughness;
        bool sphere;
    } CASES[] = {{"closed mirror box", 0.99f, 0, false},
                 {"closed box of rough mirrors", 0.99f, 0.4f, false},
                 {"closed sphere of 18,000 triangles", 0.99f, 0, true}};
    double strikes = 0;
    for (int i = 0; i < 3; ++i) {
        lum_model *m = make_model();
        const uint32_t wall = make_mirror(m, CASES[i].reflectance, CASES[i].roughness);
        /* off the origin and of uneven sides: nothing is exact in float */
        if (CASES[i].sphere)
            make_sphere(m, v3(0.37, -1.1, 0.73), 0.31, 48, true, false, wall);
        else
            make_box(m, v3(0.3, -1.3, 0.5), v3(0.9, -0.97, 0.91), true, 3, wall);
        add_point_light(m, v3(0.43, -1.12, 0.71));
        finish_model(m);
        bake_source *s = hard_tracer(m, 77);
        const bake_tally t = hard_trace(s, i == 0 ? 200000 : 60000, NULL);
        hard_holds(CASES[i].name, "no photon of 10^7 strikes on the walls leaks", t.escaped == 0 && t.lost == 0,
                   "%.0f escaped, %.0f lost, %.3g strikes", t.escaped, t.lost, (double)t.segments);
        strikes += (double)t.segments;
        s->destroy(s);
        free_model(m);
    }
    hard_at_most("closed boxes together", "1 / strikes without a leak (the long run below has 1e9)", 1 / strikes, 1e-7);
}

/* The same with 1e8 photons; for the argument "long". */
static void test_leaks_long(void **state)
{
    (void)state;
    lum_model *m = make_model();
    make_box(m, v3(0.3, -1.3, 0.5), v3(0.9, -0.97, 0.91), true, 3, make_mirror(m, 0.9f, 0));
    add_point_light(m, v3(0.43, -1.12, 0.71));
    finish_model(m);
    bake_source *s = hard_tracer(m, 78);
    const double photons = 1e8;
    const bake_tally t = hard_trace(s, (uint64_t)photons, NULL);
    const char *name = hard_text("closed mirror box, %.3g photons, %.3g strikes", photons, (double)t.segments);
    hard_at_most(name, "leaked share", t.escaped / photons, 1e-8);
    hard_at_most(name, "lost share", t.lost / photons, 1e-8);
    s->destroy(s);
    free_model(m);
}

/* ------------------------------------------------------------------------------------------------------------------ Fresnel */

/* In long double, from the complex amplitudes. */
static long double fresnel(long double c, long double complex n)
{
    const long double complex ct = csqrtl(c * c - (1 - n) * (1 + n)) / n;
    const long double complex rs = (c - n * ct) / (c + n * ct), rp = (n * c - ct) / (n * c + ct);
    return 0.5L * (creall(rs * conjl(rs)) + creall(rp * conjl(rp)));
}

static void test_fresnel(void **state)
{
    (void)state;
    double worst = 0, worst_conductor = 0, beyond = 0;
    static const double INDICES[] = {1.0000001, 1.0003, 1.33, 1.5, 2.42, 1 / 1.0000001, 1 / 1.33, 1 / 1.5};
    for (size_t i = 0; i < sizeof(INDICES) / sizeof(INDICES[0]); ++i) {
        const double n = INDICES[i];
        double cosines[64];
        int count = 0;
        for (int k = 0; k <= 12; ++k)
            cosines[count++] = pow(10, -k);       /* normal to grazing at 1e-12 */
        cosines[count++] = sin(0.001 * PI / 180); /* 89.999 degrees */
        cosines[count++] = 0;
        if (n < 1) { /* at the critical angle, and a little on either side */
            const double critical = sqrt((1 - n) * (1 + n));
            for (int k = 3; k <= 15; ++k) {
                cosines[count++] = critical * (1 + pow(10, -k));
                cosines[count++] = critical * (1 - pow(10, -k));
            }
        }
        for (int k = 0; k < count; ++k) {
            const double c = cosines[k], got = lum_fresnel_dielectric(c, n);
            const long double exact = (long double)c * c <= (1 - (long double)n) * (1 + (long double)n) ? 1
                                      : c == 0                                                          ? 1
                                               : fresnel((long double)c, (long double)n);
            if (!(got >= 0 && got <= 1))
                fail_msg("index %g, cosine %g: reflectance %g", n, c, got);
            worst = fmax(worst, fabs(got - (double)exact));
            if (n < 1 && c < sqrt((1 - n) * (1 + n)) * (1 - 1e-14))
                beyond = fmax(beyond, 1 - got);
            const double thin = lum_fresnel_thin(c, n > 1 ? n : 1 / n);
            if (!(thin >= 0 && thin <= 1))
                fail_msg("index %g, cosine %g: reflectance of a thin wall %g", n, c, thin);
        }
    }
    /* near the critical angle sqrt(distance) turns a rounding of 1e-16 in the cosine into 1e-8 of reflectance */
    hard_at_most("Fresnel, dielectrics, normal to grazing and around the critical angle", "reflectance", worst, 1e-6);
    hard_at_most("Fresnel beyond the critical angle", "1 - reflectance", beyond, 0);
    static const double METALS[][2] = {{0.2, 3.9}, {1.5, 7.6}, {0.05, 4.2}, {2.9, 3.1}, {1, 1e-6}, {1e-3, 10}};
    for (size_t i = 0; i < sizeof(METALS) / sizeof(METALS[0]); ++i)
        for (int k = 0; k <= 12; ++k) {
            const double c = pow(10, -k), got = lum_fresnel_conductor(c, METALS[i][0], METALS[i][1]);
            const long double exact = fresnel((long double)c, (long double)METALS[i][0] - (long double)METALS[i][1] * I);
            worst_conductor = fmax(worst_conductor, fabs(got - (double)exact));
        }
    hard_at_most("Fresnel, conductors, normal to grazing", "reflectance", worst_conductor, 1e-6);
}

/* The same through the tracer: a slab of glass met at 89.999 degrees, and a prism whose face light meets just within and just
 * beyond the critical angle. */
static void test_grazing_photons(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t glass = make_glass(m, 1.5f, 0, false);
    make_box(m, v3(-1, -0.01, -0.1), v3(1, 0, 0.1), false, 1, glass);
    const double e = 0.001 * PI / 180;
    hard_ray_light(m, v3(-0.5, 0.5 * tan(e), 0.013), v3(cos(e), -sin(e), 0), 1e-6);
    finish_model(m);
    bake_source *s = hard_tracer(m, 9);
    const double photons = 200000;
    bake_tally t = hard_trace(s, (uint64_t)photons, NULL);
    const double transmitted = 1 - (double)fresnel(sinl((long double)e), 1.5L);
    /* those that go in need at least three segments more; those reflected have two */
    const double in = ((double)t.segments - 2 * photons) / photons;
    hard_holds("slab of glass met at 89.999 degrees", "all light accounted for and out again", t.escaped == photons && t.lost == 0,
               "%.0f of %.0f left; %.2g segments more each, Fresnel lets %.2g in", t.escaped, photons, in, transmitted);
    s->destroy(s);
    free_model(m);

    /* light born in glass meets its top face at the critical angle +- 1e-5: part goes through just before it, nothing beyond */
    for (int side = -1; side <= 1; side += 2) {
        m = make_model();
        const uint32_t block = make_glass(m, 1.5f, 0, false), black = make_lambert(m, 0);
        for (int c = 0; c < 3; ++c)
            m->materials[block].absorption[c] = 1; /* a clear cube keeps such light for ever */
        make_box(m, v3(-1, -1, -1), v3(1, 0, 1), false, 1, block);
        make_quad(m, v3(-2, 0.3, -2), v3(4, 0, 0), v3(0, 0, 4), 1, black);
        const double n = (double)1.5f, angle = asin(1 / n) + side * 1e-5;
        hard_ray_light(m, v3(0.01, -0.1, 0.003), v3(sin(angle), cos(angle), 0), 1e-6);
        finish_model(m);
        s = hard_tracer(m, 10);
        t = hard_trace(s, 100, NULL);
        /* beyond it light goes on inside and leaves through other faces or not at all: what counts is that nothing is lost */
        hard_holds(hard_text("light in glass at the critical angle %s 1e-5", side < 0 ? "-" : "+"),
                   "the balance closes, nothing is lost", t.lost == 0, "%.0f escaped, %.0f absorbed, %.0f lost of 100", t.escaped,
                   t.absorbed, t.lost);
        s->destroy(s);
        free_model(m);
    }
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "long") == 0) {
        hard_begin("long_cavities");
        const struct CMUnitTest tests[] = {cmocka_unit_test(test_leaks_long)};
        return cmocka_run_group_tests_name("hard_long_cavities", tests, NULL, NULL);
    }
    hard_begin("cavities");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_integrating_sphere),
        cmocka_unit_test(test_light_guides),
        cmocka_unit_test(test_edge_lit_panel),
        cmocka_unit_test(test_flush),
        cmocka_unit_test(test_leaks),
        cmocka_unit_test(test_fresnel),
        cmocka_unit_test(test_grazing_photons),
    };
    return cmocka_run_group_tests_name("hard_cavities", tests, NULL, NULL);
}
