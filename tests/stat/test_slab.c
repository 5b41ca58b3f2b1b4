/* SPDX-License-Identifier: Apache-2.0 */
/* Photons through panes of glass: scene and scattering together against closed forms with all inter-reflections. */
#include "../unit/make_model.h"
#include "stats.h"

#include <luminaires/rng.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <cmocka.h>

#define PI 3.14159265358979323846

/* Follows a photon until it leaves the scene; returns its last direction.  Interfaces are lossless: every photon gets out. */
static lmg_vec3 follow(const lum_scene *scene, lmg_vec3 o, lmg_vec3 d, lum_rng *rng, lum_polarization *pol, int *segments)
{
    lum_hit hit;
    *segments = 1;
    while (lum_scene_intersect(scene, o, d, &hit)) {
        lum_surface s;
        lum_scattered out;
        double xi[4] = {lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng)};
        lum_surface_at(scene, &hit, d, &s);
        lum_scatter_trace(&s, (lmg_vec3){-d.x, -d.y, -d.z}, 1, xi, pol, &out);
        assert_true(out.weight[0] == 1 && out.weight[1] == 1 && out.weight[2] == 1);
        o = lum_offset(&hit, out.wo);
        d = out.wo;
        ++*segments;
    }
    return d;
}

static const double DEGREES[] = {0, 30, 45, 60, 75, 85}, TRANSMITTANCE[] = {.9183, .9160, .9025, .8435, .6148, .2456};
/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { PHOTONS = 20000 };
#else
enum { PHOTONS = 1000000 };
#endif

static lum_scene *panes(lum_model *model, float ior, bool thin)
{
    uint32_t glass = make_glass(model, ior, 0, thin);
    lum_scene *scene;
    if (thin) {
        make_quad(model, (lmg_vec3){-1, -1, 0}, (lmg_vec3){2, 0, 0}, (lmg_vec3){0, 2, 0}, 3, glass);
    } else {
        make_box(model, (lmg_vec3){-1, -1, -0.002}, (lmg_vec3){1, 1, 0.003}, false, 3, glass);
    }
    finish_model(model);
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    return scene;
}

/* Clear slab, n = 1.52: the mean over the two polarizations of (1 - F)/(1 + F). */
static void clear_slab(void **state)
{
    (void)state;
    for (int thin = 0; thin < 2; thin++) {
        lum_model *model = make_model();
        lum_scene *scene = panes(model, 1.52f, thin);
        unsigned saved = lum_thread_begin();
        for (int a = 0; a < 6; a++) {
            double t = DEGREES[a] * PI / 180, sum = 0;
            lmg_vec3 d = {sin(t) * cos(0.3), sin(t) * sin(0.3), -cos(t)}, o = {-0.5 * d.x, -0.5 * d.y, -0.5 * d.z};
            for (int i = 0; i < PHOTONS; i++) {
                lum_rng rng = lum_rng_stream(41 + (uint64_t)a, (uint64_t)i);
                lum_polarization pol = {0};
                int segments;
                lmg_vec3 end = follow(scene, o, d, &rng, &pol, &segments);
                assert_true(fabs(fabs(end.z) - fabs(d.z)) < 1e-9); /* parallel faces change no angle */
                sum += end.z < 0;
            }
            double mean = sum / PHOTONS, se = sqrt(mean * (1 - mean) / PHOTONS);
            print_message("%s, %2.0f degrees: %.4f +- %.4f (%.4f)\n", thin ? "thin wall" : "slab", DEGREES[a], mean, se,
                          TRANSMITTANCE[a]);
            assert_true(fabs(mean - TRANSMITTANCE[a]) < 3 * se + 0.5e-4); /* the last printed digit */
            assert_true(fabs(mean - TRANSMITTANCE[a]) < fmax(2e-3, 3 * se));
        }
        lum_thread_end(saved);
        lum_scene_destroy(scene);
        free_model(model);
    }
}

/* Two plates at 60 degrees to the beam, the second turned by an angle about it: what is s for the first is a mixture of s and p for
 * the second (Malus).  With Ts, Tp of one plate, light that passes both without reflections between the plates: T = (Ts^2 + Tp^2)/2
 * cos^2 + Ts Tp sin^2. */
static void crossed_plates(void **state)
{
    (void)state;
    double n = 1.52, t = 60 * PI / 180, c = cos(t), ct = sqrt(1 - sin(t) * sin(t) / (n * n));
    double fs = pow((c - n * ct) / (c + n * ct), 2), fp = pow((n * c - ct) / (n * c + ct), 2);
    double ts = (1 - fs) / (1 + fs), tp = (1 - fp) / (1 + fp);
    for (int k = 0; k < 3; k++) {
        lum_model *model = make_model();
        uint32_t glass = make_glass(model, 1.52f, 0, true);
        /* The beam goes down along -z; plate i contains the horizontal direction h, and is tipped by 60 degrees about it. */
        double turn[2] = {0, k * PI / 4};
        for (int i = 0; i < 2; i++) {
            lmg_vec3 h = {cos(turn[i]), sin(turn[i]), 0}, e = {-sin(turn[i]) * c, cos(turn[i]) * c, sin(t)};
            lmg_vec3 o = {-h.x - e.x, -h.y - e.y, -h.z - e.z - 4 * i};
            make_quad(model, o, (lmg_vec3){2 * h.x, 2 * h.y, 2 * h.z}, (lmg_vec3){2 * e.x, 2 * e.y, 2 * e.z}, 1, glass);
        }
        finish_model(model);
        lum_scene *scene;
        assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
        double sum = 0, s2 = pow(sin(turn[1]), 2), expected = 0.5 * (ts * ts + tp * tp) * (1 - s2) + ts * tp * s2;
        for (int i = 0; i < PHOTONS; i++) {
            lum_rng rng = lum_rng_stream(51 + (uint64_t)k, (uint64_t)i);
            lum_polarization pol = {0};
            int segments;
            lmg_vec3 end = follow(scene, (lmg_vec3){0.1, 0.05, 3}, (lmg_vec3){0, 0, -1}, &rng, &pol, &segments);
            sum += end.z < -1 + 1e-9 && segments == 3;
        }
        double mean = sum / PHOTONS, se = sqrt(mean * (1 - mean) / PHOTONS);
        print_message("plates turned by %d degrees: %.4f +- %.4f (%.4f)\n", 45 * k, mean, se, expected);
        assert_true(fabs(mean - expected) < 3 * se);
        lum_scene_destroy(scene);
        free_model(model);
    }
}

/* Rough glass keeps all its light through any number of bounces, and what goes in comes out. */
static void rough_slab_is_lossless(void **state)
{
    (void)state;
    for (int k = 0; k < 3; k++) {
        lum_model *model = make_model();
        uint32_t glass = make_glass(model, 1.52f, 0.2f + 0.3f * (float)k, false);
        make_sphere(model, (lmg_vec3){0, 0, 0}, 0.1, 40, false, true, glass);
        finish_model(model);
        lum_scene *scene;
        assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
        for (int i = 0; i < 20000; i++) {
            lum_rng rng = lum_rng_stream(61, (uint64_t)i);
            lum_polarization pol = {0};
            int segments;
            follow(scene, (lmg_vec3){0.03, 0.05, 1}, (lmg_vec3){0, 0, -1}, &rng, &pol, &segments);
            assert_true(segments >= 2);
        }
        lum_scene_destroy(scene);
        free_model(model);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(clear_slab),
        cmocka_unit_test(crossed_plates),
        cmocka_unit_test(rough_slab_is_lossless),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
