/* SPDX-License-Identifier: Apache-2.0 */
/* Emitters: flux, far-field intensity, textured emission, and next-event estimation against closed forms. */
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
#define NEAR(a, b, tolerance) assert_true(fabs((a) - (b)) <= (tolerance))

/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { PHOTONS = 20000 };
#else
enum { PHOTONS = 1000000 };
#endif

static double next(void *state)
{
    return lum_rng_next(state);
}

static lum_photon emit(const lum_emitters *emitters, lum_rng *rng)
{
    lum_photon p;
    double xi[6];
    for (int i = 0; i < 6; i++) {
        xi[i] = lum_rng_next(rng);
    }
    lum_emitters_sample(emitters, xi, next, rng, &p);
    assert_true(fabs(p.direction.x * p.direction.x + p.direction.y * p.direction.y + p.direction.z * p.direction.z - 1) < 1e-9);
    NEAR(lmg_luminance(p.flux), 1, 1e-6); /* floats */
    return p;
}

static uint32_t make_emitter(lum_model *model, float r, float g, float b, bool both)
{
    uint32_t m = make_lambert(model, 0.5f);
    model->materials[m].emissive[0] = r;
    model->materials[m].emissive[1] = g;
    model->materials[m].emissive[2] = b;
    model->materials[m].emits_back = both;
    return m;
}

static lum_emitters *emitters_of(lum_model *model)
{
    lum_emitters *e;
    finish_model(model);
    assert_int_equal(lum_emitters_create(model, &e, NULL), LMG_OK);
    return e;
}

static void add_light(lum_model *model, lum_light light)
{
    model->lights = realloc(model->lights, (model->light_count + 1) * sizeof *model->lights);
    if (!model->lights) {
        abort();
    }
    model->lights[model->light_count++] = light;
}

/* Counts of photons in rings of equal cosine about +z, against the shares they should have. */
enum { RINGS = 21 };
static double ring_test(const lum_emitters *e, uint64_t seed, const double share[RINGS], lmg_vec3 axis)
{
    double counts[RINGS] = {0}, expected[RINGS];
    lum_rng rng = lum_rng_stream(seed, 0);
    for (int i = 0; i < PHOTONS; i++) {
        lum_photon p = emit(e, &rng);
        double c = p.direction.x * axis.x + p.direction.y * axis.y + p.direction.z * axis.z;
        int ring = (int)((c + 1) / 2 * RINGS);
        counts[ring < RINGS ? ring : RINGS - 1]++;
    }
    for (int i = 0; i < RINGS; i++) {
        expected[i] = PHOTONS * share[i];
    }
    return stats_chi_square(counts, expected, RINGS, NULL, NULL);
}

/* Share of a Lambertian's flux (about +axis; both: and about -axis) with cosine below c. */
static double lambert_below(double c, bool both)
{
    return both ? 0.5 + 0.5 * (c < 0 ? -c * c : c * c) : c > 0 ? c * c : 0;
}

static void quads(void **state)
{
    (void)state;
    for (int both = 0; both < 2; both++) {
        lum_model *model = make_model();
        uint32_t dim = make_emitter(model, 120, 60, 30, both), bright = make_emitter(model, 2000, 2500, 3000, both);
        lmg_vec3 n = {0, 0.6, 0.8};
        make_quad(model, (lmg_vec3){0.3, 0.1, 0.2}, (lmg_vec3){0.4, 0, 0}, (lmg_vec3){0, 0.4, -0.3}, 3, dim);       /* 0.2 m2 */
        make_quad(model, (lmg_vec3){-0.3, 0.1, 0.2}, (lmg_vec3){0.1, 0, 0}, (lmg_vec3){0, 0.08, -0.06}, 1, bright); /* 0.01 m2 */
        make_quad(model, (lmg_vec3){-1, -1, -1}, (lmg_vec3){1, 0, 0}, (lmg_vec3){0, 1, 0}, 1, make_lambert(model, 1));
        lum_emitters *e = emitters_of(model);
        double rgb[3], y[2], sides = both ? 2 : 1, flux = lum_emitters_flux(e, rgb);
        for (int i = 0; i < 2; i++) {
            y[i] = lmg_luminance(model->materials[i ? bright : dim].emissive);
        }
        double expected = sides * PI * (0.2 * y[0] + 0.01 * y[1]);
        NEAR(flux, expected, 2e-6 * expected); /* positions are floats */
        NEAR(rgb[0], sides * PI * (0.2 * 120 + 0.01 * 2000), 1e-3);
        double share[RINGS];
        for (int i = 0; i < RINGS; i++) {
            share[i] = lambert_below(2.0 * (i + 1) / RINGS - 1, both) - lambert_below(2.0 * i / RINGS - 1, both);
        }
        double p = ring_test(e, 71 + (uint64_t)both, share, n);
        print_message("quad, %d side(s): p %.3f\n", both + 1, p);
        assert_true(p > 1e-3);
        /* Where: by power, uniformly over each; off the surface to the side of the direction. */
        lum_rng rng = lum_rng_stream(73, 0);
        stats_mean share_bright = {0}, u = {0}, u2 = {0};
        for (int i = 0; i < PHOTONS; i++) {
            lum_photon ph = emit(e, &rng);
            bool is_bright = ph.origin.x < 0;
            stats_add(&share_bright, is_bright);
            if (is_bright) {
                double x = (ph.origin.x + 0.3) / 0.1;
                assert_true(x >= -1e-5 && x <= 1 + 1e-5);
                stats_add(&u, x);
                stats_add(&u2, x * x);
                NEAR((double)(ph.flux[0] / ph.flux[2]), 2.0 / 3, 1e-6);
            }
            double above = (ph.origin.y - 0.1) * n.y + (ph.origin.z - 0.2) * n.z;
            double c = ph.direction.y * n.y + ph.direction.z * n.z;
            assert_true(above * c >= 0 && fabs(above) < 4e-6 && above != 0); /* lum_triangle_error of coordinates below 1 */
        }
        double expected_share = 0.01 * y[1] / (0.01 * y[1] + 0.2 * y[0]);
        assert_true(fabs(share_bright.mean - expected_share) < 3 * stats_error(&share_bright));
        assert_true(fabs(u.mean - 0.5) < 3 * stats_error(&u) && fabs(u2.mean - 1.0 / 3) < 3 * stats_error(&u2));
        lum_emitters_destroy(e);
        free_model(model);
    }
}

static void sphere(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_sphere(model, (lmg_vec3){0.1, 0, 0.05}, 0.05, 60, false, true, make_emitter(model, 1000, 1000, 1000, false));
    lum_emitters *e = emitters_of(model);
    double area = 0, flux = lum_emitters_flux(e, NULL), share[RINGS];
    for (uint32_t i = 0; i < model->triangle_count; i++) {
        double v[3][3];
        for (int k = 0; k < 9; k++) {
            v[k / 3][k % 3] = model->unit * (double)model->positions[3 * (size_t)model->indices[3 * i + (uint32_t)(k / 3)] + (size_t)(k % 3)];
        }
        double a[3], b[3];
        for (int k = 0; k < 3; k++) {
            a[k] = v[1][k] - v[0][k];
            b[k] = v[2][k] - v[0][k];
        }
        area +=
            0.5 * sqrt(pow(a[1] * b[2] - a[2] * b[1], 2) + pow(a[2] * b[0] - a[0] * b[2], 2) + pow(a[0] * b[1] - a[1] * b[0], 2));
    }
    NEAR(flux, PI * 1000 * area, 1e-6 * flux);
    NEAR(area, 4 * PI * 0.05 * 0.05, 2e-3 * area); /* the mesh's own facets: 1 - cos^2 of 1.5 degrees, twice */
    for (int i = 0; i < RINGS; i++) {
        share[i] = 1.0 / RINGS; /* isotropic; facets of 3 degrees, symmetric over the sphere, shift it by less than 1e-4 */
    }
    double p = ring_test(e, 75, share, (lmg_vec3){0, 0.6, 0.8});
    print_message("sphere: p %.3f\n", p);
    assert_true(p > 1e-3);
    lum_emitters_destroy(e);
    free_model(model);
}

static void punctual(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_lambert(model, 1);
    add_light(model,
              (lum_light){.kind = LUM_LIGHT_POINT, .position = {1, 2, 3}, .direction = {0, 0, -1}, .intensity = {10, 20, 30}});
    lum_emitters *e = emitters_of(model);
    double y = lmg_luminance(model->lights[0].intensity), share[RINGS];
    NEAR(lum_emitters_flux(e, NULL), 4 * PI * y, 1e-9 * y);
    for (int i = 0; i < RINGS; i++) {
        share[i] = 1.0 / RINGS;
    }
    double p = ring_test(e, 76, share, (lmg_vec3){0.6, 0, 0.8});
    print_message("point light: p %.3f\n", p);
    assert_true(p > 1e-3);
    lum_emitters_destroy(e);

    /* Spots: the falloff of KHR_lights_punctual, integrated numerically. */
    const double cones[3][2] = {{0.3, 0.7}, {0, 0.4}, {0.499, 0.5}}; /* the last narrower than the extension's 0.001 of cosine */
    for (int k = 0; k < 3; k++) {
        lum_light spot = {.kind = LUM_LIGHT_SPOT, .position = {0.1, 0, 0}, .direction = {0, 0.6, 0.8}, .intensity = {50, 50, 50}};
        spot.cos_inner = cos(cones[k][0]);
        spot.cos_outer = cos(cones[k][1]);
        model->lights[0] = spot;
        lum_emitters *es;
        assert_int_equal(lum_emitters_create(model, &es, NULL), LMG_OK);
        double flux = 0, width = fmax(0.001, spot.cos_inner - spot.cos_outer);
        memset(share, 0, sizeof share);
        enum { STEPS = 2000000 };
        for (int i = 0; i < STEPS; i++) {
            double c = spot.cos_outer + (1 - spot.cos_outer) * (i + 0.5) / STEPS, a = fmin((c - spot.cos_outer) / width, 1);
            double f = 2 * PI * 50 * a * a * (1 - spot.cos_outer) / STEPS;
            flux += f;
            share[(int)((c + 1) / 2 * RINGS)] += f;
        }
        for (int i = 0; i < RINGS; i++) {
            share[i] /= flux;
        }
        NEAR(lum_emitters_flux(es, NULL), flux, 1e-6 * flux);
        /* Rings inside the cone: the radial distribution by its moments. */
        stats_mean c1 = {0}, c2 = {0};
        lum_rng rng = lum_rng_stream(78 + (uint64_t)k, 0);
        for (int i = 0; i < PHOTONS; i++) {
            lum_photon ph = emit(es, &rng);
            double c = ph.direction.y * 0.6 + ph.direction.z * 0.8, x = (c - spot.cos_outer) / (1 - spot.cos_outer);
            assert_true(x >= -1e-9 && x <= 1 + 1e-9);
            stats_add(&c1, x);
            stats_add(&c2, x * x);
        }
        double m1 = 0, m2 = 0;
        for (int i = 0; i < STEPS; i++) {
            double x = (i + 0.5) / STEPS, a = fmin(x * (1 - spot.cos_outer) / width, 1),
                   w = 2 * PI * 50 * a * a * (1 - spot.cos_outer) / STEPS;
            m1 += w * x / flux;
            m2 += w * x * x / flux;
        }
        print_message("spot %d: %.2f and %.2f se\n", k, (c1.mean - m1) / stats_error(&c1), (c2.mean - m2) / stats_error(&c2));
        assert_true(fabs(c1.mean - m1) < 3 * stats_error(&c1) && fabs(c2.mean - m2) < 3 * stats_error(&c2));
        lum_emitters_destroy(es);
    }
    free_model(model);
}

/* A picture with a small bright spot in the dark: flux, and where photons start. */
static void textured(void **state)
{
    (void)state;
    for (int nearest = 0; nearest < 2; nearest++) {
        enum { W = 40, H = 24 };
        static float texels[W * H * 4];
        double sum = 0, sum_x = 0;
        lum_rng rng = lum_rng_stream(81, 0);
        for (int i = 0; i < W * H; i++) {
            float v = i % 7 == 0 ? (float)lum_rng_next(&rng) * 0.1f : 0;
            if (i / W == 10 && i % W >= 30 && i % W < 33) {
                v = 1;
            }
            texels[4 * i] = v;
            texels[4 * i + 1] = texels[4 * i + 2] = 0.5f * v;
            texels[4 * i + 3] = 1;
            sum += (double)v / (W * H);
            sum_x += (double)v / (W * H) * ((i % W + 0.5) / W);
        }
        lum_model *model = make_model();
        uint32_t m = make_emitter(model, 1000, 2000, 3000, false);
        lum_material *material = &model->materials[m];
        material->emissive_texture.image = make_image(model, W, H, texels);
        material->emissive_texture.nearest = nearest;
        make_quad(model, (lmg_vec3){0, 0, 0}, (lmg_vec3){0.5, 0, 0}, (lmg_vec3){0, 0.4, 0}, 1, m);
        lum_emitters *e = emitters_of(model);
        /* Interpolation between repeated texels conserves the mean over the whole picture. */
        double y = 0.2126 * 1000 + 0.7152 * 1000 + 0.0722 * 1500, flux = lum_emitters_flux(e, NULL), expected = PI * 0.2 * y * sum;
        print_message("textured, %s: flux %.3f (%.3f)\n", nearest ? "nearest" : "linear", flux, expected);
        NEAR(flux, expected, (nearest ? 1e-2 : 1e-3) * expected); /* four midpoints along a texel; bright
            texels that a patch's edge cuts are the worst case */
        stats_mean x = {0};
        for (int i = 0; i < PHOTONS / 4; i++) {
            lum_photon p = emit(e, &rng);
            stats_add(&x, p.origin.x / 0.5);
            NEAR((double)(p.flux[0] / p.flux[1]), 1, 1e-5);
        }
        double wrap = nearest ? 0 : 1e-3; /* interpolation wraps a little light around */
        print_message("mean position %.5f +- %.5f (%.5f)\n", x.mean, stats_error(&x), sum_x / sum);
        assert_true(fabs(x.mean - sum_x / sum) < 3 * stats_error(&x) + wrap + (nearest ? 5e-3 : 0));
        lum_emitters_destroy(e);
        free_model(model);
    }
}

/* Illuminance on the ground under a rectangle parallel to it, by next-event estimation, against its form factor; and the pdf of
 * every direction sampled against lum_emitters_point_pdf of the hit that it leads to, whose inverse integrates to the solid angle.
 */
static void next_event(void **state)
{
    (void)state;
    lum_model *model = make_model();
    enum { W = 32 };
    static float texels[W * W * 4];
    for (int i = 0; i < 4 * W * W; i++) {
        texels[i] = 1;
    }
    uint32_t m = make_emitter(model, 700, 700, 700, false);
    model->materials[m].emissive_texture.image = make_image(model, W, W, texels); /* cut into patches, of constant luminance */
    double a = 0.6, b = 0.4, h = 0.5;
    make_quad(model, (lmg_vec3){0, 0, h}, (lmg_vec3){0, b, 0}, (lmg_vec3){a, 0, 0}, 1, m); /* faces down */
    lum_emitters *e = emitters_of(model);
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    double x = a / h, y = b / h, rx = sqrt(1 + x * x), ry = sqrt(1 + y * y);
    /* Form factor from a horizontal element under a corner. */
    double factor = (x / rx * atan(y / rx) + y / ry * atan(x / ry)) / (2 * PI);
    double omega = atan(x * y / sqrt(1 + x * x + y * y)); /* solid angle from there */
    lum_rng rng = lum_rng_stream(91, 0);
    stats_mean illuminance = {0}, solid = {0};
    lmg_vec3 p = {0, 0, 0};
    int misses = 0;
    for (int i = 0; i < PHOTONS; i++) {
        double xi[3] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lum_light_sample s;
        if (!lum_emitters_sample_point(e, p, xi, &s)) {
            stats_add(&illuminance, 0);
            stats_add(&solid, 0);
            continue;
        }
        stats_add(&illuminance, (double)s.radiance[0] * s.direction.z / s.pdf);
        stats_add(&solid, 1 / s.pdf);
        assert_false(lum_scene_occluded(scene, p, s.direction, s.distance));
        lum_hit hit;
        if (!lum_scene_intersect(scene, p, s.direction, &hit)) {
            misses++; /* points on the very edge */
            continue;
        }
        double pdf = lum_emitters_point_pdf(e, p, &hit);
        assert_true(fabs(pdf - s.pdf) < 2e-4 * s.pdf); /* hits keep off the edges by 4 errors, a fraction of the distance */
    }
    print_message("illuminance %.4f +- %.4f (%.4f), solid angle %.5f (%.5f), %d beside the edge\n", illuminance.mean,
                  stats_error(&illuminance), 700 * PI * factor, solid.mean, omega, misses);
    assert_true(fabs(illuminance.mean - 700 * PI * factor) < 3 * stats_error(&illuminance));
    assert_true(fabs(solid.mean - omega) < 3 * stats_error(&solid));
    assert_true(misses < 20);
    /* From behind it is dark. */
    lum_light_sample s;
    double xi[3] = {0.3, 0.4, 0.5};
    assert_false(lum_emitters_sample_point(e, (lmg_vec3){0.1, 0.1, 1}, xi, &s));
    lum_scene_destroy(scene);
    lum_emitters_destroy(e);
    free_model(model);
}

/* Point, spot and directional lights together: every light's share comes back divided by its chance. */
static void next_event_punctual(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_quad(model, (lmg_vec3){-1, -1, 0}, (lmg_vec3){2, 0, 0}, (lmg_vec3){0, 2, 0}, 1, make_lambert(model, 1));
    add_light(model, (lum_light){.kind = LUM_LIGHT_POINT, .position = {0, 0, 2}, .intensity = {8, 8, 8}});
    add_light(model, (lum_light){.kind = LUM_LIGHT_DIRECTIONAL, .direction = {0, 0.6, -0.8}, .intensity = {3, 3, 3}});
    add_light(model, (lum_light){.kind = LUM_LIGHT_SPOT,
                                 .position = {0, 0, 1},
                                 .direction = {0, 0, -1},
                                 .intensity = {5, 5, 5},
                                 .cos_inner = 0.9,
                                 .cos_outer = 0.8});
    add_light(model, (lum_light){.kind = LUM_LIGHT_POINT, .position = {0, 0, 3}, .intensity = {0, 0, 0}});
    lum_emitters *e = emitters_of(model);
    lum_rng rng = lum_rng_stream(95, 0);
    stats_mean illuminance = {0};
    for (int i = 0; i < PHOTONS / 4; i++) {
        double xi[3] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lum_light_sample s;
        bool lit = lum_emitters_sample_point(e, (lmg_vec3){0, 0, 0}, xi, &s);
        assert_true(lit && s.delta && s.pdf == 1);
        stats_add(&illuminance, (double)s.radiance[0] * s.direction.z);
    }
    double expected = 8.0 / 4 + 3 * 0.8 + 5;
    print_message("punctual lights: %.4f +- %.4f (%.4f)\n", illuminance.mean, stats_error(&illuminance), expected);
    assert_true(fabs(illuminance.mean - expected) < 3 * stats_error(&illuminance));
    /* Directional lights aren't part of what a model emits. */
    NEAR(lum_emitters_flux(e, NULL), 4 * PI * 8 + 2 * PI * 5 * (0.1 + 0.1 / 3), 1e-6 * 120);
    lum_emitters_destroy(e);
    free_model(model);
}

static void nothing_shines(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_quad(model, (lmg_vec3){-1, -1, 0}, (lmg_vec3){2, 0, 0}, (lmg_vec3){0, 2, 0}, 1, make_lambert(model, 1));
    lum_emitters *e = emitters_of(model);
    lum_light_sample s;
    lum_hit hit = {0};
    double xi[3] = {0.3, 0.4, 0.5}, rgb[3];
    assert_true(lum_emitters_flux(e, rgb) == 0 && rgb[0] == 0);
    assert_false(lum_emitters_sample_point(e, (lmg_vec3){0, 0, 1}, xi, &s));
    assert_true(lum_emitters_point_pdf(e, (lmg_vec3){0, 0, 1}, &hit) == 0);
    lum_emitters_destroy(e);
    free_model(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(quads),          cmocka_unit_test(sphere),     cmocka_unit_test(punctual),
        cmocka_unit_test(textured),       cmocka_unit_test(next_event), cmocka_unit_test(next_event_punctual),
        cmocka_unit_test(nothing_shines),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
