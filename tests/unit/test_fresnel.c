/* SPDX-License-Identifier: Apache-2.0 */
/* Fresnel's formulae against closed forms and limits, and the polarization that photons carry through them. */
#include "make_model.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <cmocka.h>

#define PI 3.14159265358979323846
#define NEAR(a, b, tolerance) assert_true(fabs((a) - (b)) <= (tolerance))

/* The formulae are a dozen operations in double on numbers of order one. */
static const double ROUNDING = 1e-14;

static void dielectric_limits(void **state)
{
    (void)state;
    const double index[] = {1.1, 1.33, 1.52, 2.385};
    for (int i = 0; i < 4; i++) {
        double n = index[i], r0 = (n - 1) / (n + 1);
        NEAR(lum_fresnel_dielectric(1, n), r0 * r0, ROUNDING);
        NEAR(lum_fresnel_dielectric(1, 1 / n), r0 * r0, ROUNDING);
        NEAR(lum_fresnel_dielectric(0, n), 1, ROUNDING);
        /* At Brewster's angle the parallel part vanishes: R = Rs / 2 with Rs = ((n^2 - 1) / (n^2 + 1))^2. */
        double rs = (n * n - 1) / (n * n + 1);
        NEAR(lum_fresnel_dielectric(cos(atan(n)), n), 0.5 * rs * rs, ROUNDING);
        /* Total reflection from inside, beyond asin(1/n). */
        double critical = asin(1 / n);
        assert_true(lum_fresnel_dielectric(cos(critical + 1e-6), 1 / n) == 1);
        assert_true(lum_fresnel_dielectric(cos(critical - 1e-3), 1 / n) < 1);
        /* Reciprocity: the same reflectance from the other side under the refracted angle. */
        for (int k = 1; k < 20; k++) {
            double theta = k * (PI / 40), refracted = asin(sin(theta) / n);
            NEAR(lum_fresnel_dielectric(cos(theta), n), lum_fresnel_dielectric(cos(refracted), 1 / n), 10 * ROUNDING);
        }
    }
    assert_true(lum_fresnel_dielectric(0.3, 1) < ROUNDING * ROUNDING);
    assert_true(lum_fresnel_dielectric(0, 1) == 0);
    /* Crown glass at 45 degrees: Rs = 0.09693, Rp = Rs^2 (a theorem for 45 degrees), mean 0.053163. */
    double ct = sqrt(1 - 0.5 / (1.52 * 1.52)), c = sqrt(0.5);
    double rs = (c - 1.52 * ct) / (c + 1.52 * ct);
    NEAR(lum_fresnel_dielectric(c, 1.52), 0.5 * (rs * rs + rs * rs * rs * rs), ROUNDING);
}

static void conductor_limits(void **state)
{
    (void)state;
    const double eta[] = {0.043, 0.62, 1.22, 2.9}, k[] = {5.3, 2.1, 6.9, 3.1};
    for (int i = 0; i < 4; i++) {
        double r0 = ((eta[i] - 1) * (eta[i] - 1) + k[i] * k[i]) / ((eta[i] + 1) * (eta[i] + 1) + k[i] * k[i]);
        NEAR(lum_fresnel_conductor(1, eta[i], k[i]), r0, ROUNDING);
        NEAR(lum_fresnel_conductor(0, eta[i], k[i]), 1, ROUNDING);
        for (int j = 0; j <= 90; j++) {
            double r = lum_fresnel_conductor(cos(j * PI / 180), eta[i], k[i]);
            assert_true(r > 0 && r <= 1 + ROUNDING);
        }
    }
    /* Without absorption it is a dielectric, also beyond the critical angle. */
    for (int j = 1; j < 90; j++) {
        double c = cos(j * PI / 180);
        NEAR(lum_fresnel_conductor(c, 1.52, 0), lum_fresnel_dielectric(c, 1.52), 10 * ROUNDING);
        NEAR(lum_fresnel_conductor(c, 1 / 1.52, 0), lum_fresnel_dielectric(c, 1 / 1.52),
             1e-7); /* square root of a rounding beyond it */
    }
}

static void thin_wall(void **state)
{
    (void)state;
    /* A pane of n = 1.52 with all inter-reflections. */
    const double degrees[] = {0, 30, 45, 60, 75, 85}, transmittance[] = {.9183, .9160, .9025, .8435, .6148, .2456};
    for (int i = 0; i < 6; i++) {
        NEAR(1 - lum_fresnel_thin(cos(degrees[i] * PI / 180), 1.52), transmittance[i], 0.5e-4); /* four printed digits */
    }
    assert_true(lum_fresnel_thin(0.5, 1) < ROUNDING * ROUNDING);
}

static lum_scattered trace(const lum_surface *s, lmg_vec3 d, double choice, lum_polarization *pol)
{
    lum_scattered out;
    double xi[4] = {0.3, 0.6, 0.2, choice};
    lmg_vec3 wi = {-d.x, -d.y, -d.z};
    lum_scatter_trace(s, wi, 1, xi, pol, &out);
    return out;
}

/* Total reflection turns the phases of the two fields by different amounts: tan(delta/2) = cos sqrt(sin^2 - 1/n^2) / sin^2. */
static void total_reflection_retards(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_quad(model, (lmg_vec3){-1, -1, 0}, (lmg_vec3){2, 0, 0}, (lmg_vec3){0, 2, 0}, 1, make_glass(model, 1.51f, 0, false));
    finish_model(model);
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    double theta = 54.62 * PI / 180, n = (double)model->materials[0].ior;
    lmg_vec3 d = {sin(theta), 0, cos(theta)}; /* from inside */
    lum_surface s = surface_of(scene, 0, d, NULL);
    /* Linear at 45 degrees to the plane of incidence (x,z): s = +-y, p in the plane. */
    double h = sqrt(0.5);
    lum_polarization pol = {{h * cos(theta), h, -h * sin(theta)}, {0, 0, 0}, true};
    lum_scattered out = trace(&s, d, 0.999, &pol);
    assert_int_equal(out.event, LUM_REFLECTED | LUM_DELTA);
    NEAR(out.wo.x, sin(theta), ROUNDING);
    NEAR(out.wo.z, -cos(theta), ROUNDING);
    assert_true(pol.known);
    lmg_vec3 p = {cos(theta), 0, sin(theta)}; /* perpendicular to wo in the plane */
    double sr = pol.re.y, si = pol.im.y, pr = pol.re.x * p.x + pol.re.z * p.z, pi = pol.im.x * p.x + pol.im.z * p.z;
    NEAR(sr * sr + si * si, 0.5, ROUNDING);
    NEAR(pr * pr + pi * pi, 0.5, ROUNDING);
    NEAR(pol.re.x * out.wo.x + pol.re.z * out.wo.z, 0, ROUNDING);
    double delta = fabs(atan2(si, sr) - atan2(pi, pr));
    delta = fmin(delta, 2 * PI - delta);
    double expected = 2 * atan(cos(theta) * sqrt(sin(theta) * sin(theta) - 1 / (n * n)) / (sin(theta) * sin(theta)));
    delta = fabs(delta - expected) < fabs(PI - delta - expected) ? delta : PI - delta; /* the sign of p is a convention */
    NEAR(delta, expected, 1e-12);
    NEAR(expected * 180 / PI, 45, 0.1); /* Fresnel's rhomb */

    /* And a photon polarized in the plane of incidence passes Brewster's angle without reflection. */
    theta = atan(n);
    d = (lmg_vec3){sin(theta), 0, -cos(theta)};
    s = surface_of(scene, 0, d, NULL);
    pol = (lum_polarization){{cos(theta), 0, sin(theta)}, {0, 0, 0}, true};
    out = trace(&s, d, 1e-12, &pol);
    assert_int_equal(out.event, LUM_TRANSMITTED | LUM_DELTA | LUM_BOUNDARY);
    NEAR(out.wo.x, sin(theta) / n, ROUNDING);
    lum_scene_destroy(scene);
    free_model(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(dielectric_limits),
        cmocka_unit_test(conductor_limits),
        cmocka_unit_test(thin_wall),
        cmocka_unit_test(total_reflection_retards),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
