/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Hard cases of lighting with a box: points far away, a millionth of its size away, on its face and inside, behind an aperture box, and
 * a box whose light is all in one cell.  Importance sampling has to give the illuminance that quadrature gives, with finite weights and a
 * density that is the one it says.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"
#include "make_model.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A Lambertian square of 0.2 m facing down, with a box's other sides. */
static lmg_field *panel(lmg_layout_choice choice)
{
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0);
    hard_emit(m, source, 1000);
    make_quad(m, v3(-0.1, 0, -0.1), v3(0.2, 0, 0), v3(0, 0, 0.2), 1, source);
    make_quad(m, v3(-0.1, 0.05, -0.1), v3(0, 0, 0.2), v3(0.2, 0, 0), 1, make_lambert(m, 0));
    finish_model(m);
    const bake_options o = {.photons = 2000000, .seed = 21, .fit.cells = 60000, .fit.choice = choice};
    lmg_field *f = hard_bake(m, &o, NULL);
    free_model(m);
    return f;
}

typedef struct estimate {
    double mean, error, worst_weight, pdf_mismatch;
    double largest_share; /* of the largest weight's square in the sum of all */
    bool finite;
} estimate;

/* Illuminance at a point by importance sampling with n samples. */
static estimate by_sampling(const lmg_field *f, lmg_vec3 point, lmg_vec3 normal, int n)
{
    double sum = 0, squares = 0;
    estimate e = {.finite = true};
    for (int i = 0; i < n; ++i) {
        lum_rng rng = lum_rng_stream(77, (uint64_t)i);
        const double xi[3] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lmg_point_sample s;
        float radiance[3];
        if (!lmg_field_sample_point(f, point, xi, &s) || !lmg_field_sample_radiance(f, &s, radiance))
            continue;
        const double c = s.direction.x * normal.x + s.direction.y * normal.y + s.direction.z * normal.z;
        const double w = c > 0 ? lmg_luminance(radiance) * c / s.pdf : 0;
        e.finite = e.finite && isfinite(w) && s.pdf > 0 && isfinite(s.pdf);
        e.pdf_mismatch = fmax(e.pdf_mismatch, fabs(lmg_field_point_pdf(f, point, s.direction) / s.pdf - 1));
        e.worst_weight = fmax(e.worst_weight, w);
        sum += w;
        squares += w * w;
    }
    e.mean = sum / n;
    e.largest_share = squares > 0 ? e.worst_weight * e.worst_weight / squares : 0;
    e.error = sqrt(fmax(squares / n - e.mean * e.mean, 0) / n);
    return e;
}

/* The density over all directions is one (of directions without light, where a try gives no sample, too): by stratified directions in the cone that
 * holds the box. */
static void test_density(void **state)
{
    (void)state;
    static const lmg_layout_choice CHOICES[2] = {LMG_LAYOUT_CUBE, LMG_LAYOUT_APERTURE};
    static const double HEIGHTS[] = {1e-2, 0.3, 3, 1e3, 1e6};
    for (int c = 0; c < 2; ++c) {
        lmg_field *f = panel(CHOICES[c]);
        const lmg_layout *y = lmg_field_layout(f);
        const lmg_vec3 lo = y->bounds_min, hi = y->bounds_max, middle = v3(0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), 0.5 * (lo.z + hi.z));
        const double radius = 0.5 * sqrt((hi.x - lo.x) * (hi.x - lo.x) + (hi.y - lo.y) * (hi.y - lo.y) + (hi.z - lo.z) * (hi.z - lo.z));
        for (size_t k = 0; k < sizeof(HEIGHTS) / sizeof(HEIGHTS[0]); ++k) {
            const double h = HEIGHTS[k] * y->size;
            const lmg_vec3 p = v3(middle.x + 0.2 * h, lo.y - h, middle.z - 0.1 * h);
            const lmg_vec3 to = v3(middle.x - p.x, middle.y - p.y, middle.z - p.z);
            const double away = sqrt(to.x * to.x + to.y * to.y + to.z * to.z);
            /* 1 - cos of the cone's half-angle; near the box all directions upward and some more */
            const double sine = radius / away, rise = sine < 1 ? sine * sine / (1 + sqrt(1 - sine * sine)) : 2;
            const lmg_vec3 axis = v3(to.x / away, to.y / away, to.z / away);
            const lmg_vec3 side = v3(axis.y / hypot(axis.x, axis.y), -axis.x / hypot(axis.x, axis.y), 0);
            const lmg_vec3 third = v3(axis.y * side.z - axis.z * side.y, axis.z * side.x - axis.x * side.z, axis.x * side.y - axis.y * side.x);
            enum { STRATA = 700 };
            double sum = 0, squares = 0;
            for (int i = 0; i < STRATA * STRATA; ++i) {
                lum_rng rng = lum_rng_stream(78, (uint64_t)i);
                const double w = rise * (i / STRATA + lum_rng_next(&rng)) / STRATA, phi = 6.283185307179586 * (i % STRATA + lum_rng_next(&rng)) / STRATA;
                const double up = 1 - w, across = sqrt(w * (2 - w)), x = across * cos(phi), z = across * sin(phi);
                const lmg_vec3 d = v3(up * axis.x + x * side.x + z * third.x, up * axis.y + x * side.y + z * third.y, up * axis.z + x * side.z + z * third.z);
                const double pdf = lmg_field_point_pdf(f, p, d);
                sum += pdf;
                squares += pdf * pdf;
            }
            const double n = STRATA * STRATA, whole = 6.283185307179586 * rise, integral = whole * sum / n;
            const double error = whole * sqrt((squares / n - sum / n * sum / n) / n); /* of random directions; strata have less */
            hard_at_most(hard_text("%s box from %g sizes below", c ? "aperture" : "cube", HEIGHTS[k]),
                         "density over all directions: differs from 1, in standard errors", fabs(integral - 1) / error, 3);
        }
        lmg_field_destroy(f);
    }
}

static void test_distances(void **state)
{
    (void)state;
    static const char *const NAMES[] = {"", "cube", "aperture"};
    for (int k = 1; k <= 2; ++k) {
        lmg_field *f = panel((lmg_layout_choice)k);
        const double size = lmg_field_layout(f)->size, flux = lmg_field_ledger(f).stored;
        static const double SIZES[] = {1e-6, 1e-3, 0.1, 1, 1e3, 1e6};
        for (int i = 0; i < 6; ++i) {
            const double low = lmg_field_layout(f)->bounds_min.y;
            const lmg_vec3 p = {0.013, low - SIZES[i] * size, -0.021}, up = {0, 1, 0};
            double noise; /* of the box */
            const double e = hard_illuminance(f, p, up, &noise);
            const estimate s = by_sampling(f, p, up, 100000);
            print_message("quadrature %g, sampling %g +- %g\n", e, s.mean, s.error);
            const char *name = hard_text("%s box at %g sizes below its face", NAMES[k], SIZES[i]);
            hard_holds(name, "weights finite and positive", s.finite && s.mean > 0, "largest %.3g times the mean", s.worst_weight / s.mean);
            /* where one sample has a share s of the sum of squares, the standard error is known to the root of s, here to a tenth
             */
            hard_at_most(name, "weights bounded: the largest's share of the sum of squares", s.largest_share, 0.01);
            hard_at_most(name, "density said again, relative", s.pdf_mismatch, 1e-5);
            /* 5e-4 RMS is what the rule of quadrature is off in noisy boxes (CHANGELOG); four times that */
            hard_at_most(name, "sampling against quadrature, in 4 standard errors + 0.002",
                         fabs(s.mean - e) / (4 * s.error + 0.002 * e), 1);
            /* the panel's radiance is the same everywhere, so that cells blur nothing: what is left is noise */
            if (SIZES[i] >= 1e3) {
                const double d = SIZES[i] * size, far = 1000 * 0.04 / (d * d);
                hard_at_most(name, "far field: L A / d^2, in standard errors", fabs(e - far) / noise, 4);
            } else if (SIZES[i] < 1e-2) {
                hard_at_most(name, "on the panel: pi L, in standard errors", fabs(e - 3.14159265358979 * 1000) / noise, 4);
            }
        }
        assert_true(flux > 0);
        lmg_field_destroy(f);
    }
}

static void test_across_the_face(void **state)
{
    (void)state;
    lmg_field *f = panel(LMG_LAYOUT_CUBE);
    const double low = lmg_field_layout(f)->bounds_min.y, size = lmg_field_layout(f)->size;
    /* illuminance is continuous across the box's lower face, where light comes out */
    const double outside = hard_illuminance(f, v3(0.01, low - 1e-7 * size, 0.02), v3(0, 1, 0), NULL),
                 on = hard_illuminance(f, v3(0.01, low, 0.02), v3(0, 1, 0), NULL),
                 away = hard_illuminance(f, v3(0.01, low - 1e-4 * size, 0.02), v3(0, 1, 0), NULL);
    /* of a point exactly in a (u,v) plane that plane's light is left out */
    hard_holds("on the box's face, exactly in a (u,v) plane", "not made stable: finite, and at most what is seen just outside",
               isfinite(on) && on >= 0 && on <= 1.02 * outside, "%.5g lx, outside %.5g lx; ask 1e-7 sizes outside", on, outside);
    /* what is seen moves by 1e-4 sizes, a thousandth of a cell (some ten to a side): twice as much, if every cell were beside a
     * dark one */
    hard_at_most("on the box's face", "illuminance between 1e-7 and 1e-4 sizes outside, relative", fabs(away / outside - 1), 2e-3);
    /* inside and behind: nothing invalid, whatever comes */
    bool finite = true;
    static const double HEIGHTS[] = {1e-9, 0.01, 0.025, 0.05, 0.06, 1, 100};
    for (int i = 0; i < 7; ++i)
        for (int up = -1; up <= 1; up += 2) {
            const lmg_vec3 p = {0.01, low + HEIGHTS[i], 0.02}, n = {0, up, 0};
            const double e = hard_illuminance(f, p, n, NULL);
            const estimate s = by_sampling(f, p, n, 2000);
            finite = finite && isfinite(e) && e >= 0 && s.finite && isfinite(s.mean);
        }
    hard_holds("inside and behind the box", "illuminance and samples finite, none negative", finite, "7 heights, both sides");
    lmg_field_destroy(f);

    f = panel(LMG_LAYOUT_APERTURE);
    const lmg_vec3 behind = {0.01, 3, 0.02};
    /* the coarse slabs hold what doesn't come through the opening: of a panel that shines down, nothing */
    hard_at_most("behind an aperture box", "illuminance over that in front",
                 hard_illuminance(f, behind, v3(0, -1, 0), NULL) / hard_illuminance(f, v3(0.01, -3, 0.02), v3(0, 1, 0), NULL), 1e-6);
    lmg_field_destroy(f);
}

/* All the light in one cell of a million. */
static void test_one_bright_cell(void **state)
{
    (void)state;
    lum_model *m = make_model();
    make_box(m, v3(-0.1, -0.1, -0.1), v3(0.1, 0.1, 0.1), false, 1, make_lambert(m, 0));
    hard_ray_light(m, v3(0.012, -0.11, 0.007), v3(0, -1, 0), 1e-6);
    finish_model(m);
    const bake_options o = {.photons = 50000, .seed = 3, .fit.cells = 1000000, .fit.choice = LMG_LAYOUT_CUBE, .output_flux_lm = 100};
    lmg_field *f = hard_bake(m, &o, NULL);
    free_model(m);
    hard_at_most("all light in one cell", "flux, relative", fabs(lmg_field_ledger(f).stored / 100 - 1), 1e-6);
    /* a plane across the beam gets all of it: by emission */
    double through = 0;
    enum { N = 2000 };
    for (int i = 0; i < N; ++i) {
        lum_rng rng = lum_rng_stream(5, (uint64_t)i);
        double xi[5];
        for (int k = 0; k < 5; ++k)
            xi[k] = lum_rng_next(&rng);
        lmg_ray ray;
        assert_true(lmg_field_emit(f, xi, &ray));
        through += ray.direction.y < -0.99;
    }
    hard_at_most("all light in one cell", "emitted rays that aren't in the beam", N - through, 0);
    const estimate s = by_sampling(f, v3(0.012, -1, 0.007), v3(0, 1, 0), 2000);
    const double e = hard_illuminance(f, v3(0.012, -1, 0.007), v3(0, 1, 0), NULL);
    hard_holds("all light in one cell", "weights finite in the beam", s.finite && e > 0, "illuminance %.3g lx, sampled %.3g", e, s.mean);
    hard_at_most("all light in one cell", "sampling against quadrature, in 4 standard errors + 0.002",
                 fabs(s.mean - e) / (4 * s.error + 0.002 * e), 1);
    lmg_field_destroy(f);
}

int main(void)
{
    hard_begin("sampling");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_density),
        cmocka_unit_test(test_distances),
        cmocka_unit_test(test_across_the_face),
        cmocka_unit_test(test_one_bright_cell),
    };
    return cmocka_run_group_tests_name("hard_sampling", tests, NULL, NULL);
}
