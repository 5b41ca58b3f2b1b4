/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Media in rooms: fog before a bright wall, the balance of a bright closed room full of fog, and a box's light in fog.  Closed
 * forms and quadrature; means are rejected beyond 4 standard errors (a chance of 6e-5 each).
 */
#include "meter.h"
#include "room_fixture.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>

static const double REJECT = 4;

/* Mean and standard error of what comes along one ray (room file's frame). */
static void look(const view_scene *scene, lmg_vec3 eye, lmg_vec3 towards, uint32_t samples, view_path_options options,
                 double mean[3], double se[3])
{
    double squares[3] = {0};
    double *weights = calloc(2 * (size_t)scene->light_count + 2, sizeof *weights);
    assert_non_null(weights);
    view_worker worker = {.weights = weights};
    mean[0] = mean[1] = mean[2] = 0;
    lmg_vec3 o = view_sub(eye, scene->origin), d = view_unit(view_sub(towards, eye));
    for (uint32_t i = 0; i < samples; i++) {
        lum_rng rng = lum_rng_stream(5, i);
        double rgb[3];
        view_path_radiance(scene, &options, o, d, &rng, &worker, rgb);
        for (int c = 0; c < 3; c++) {
            mean[c] += rgb[c] / samples;
            squares[c] += rgb[c] * rgb[c] / samples;
        }
    }
    for (int c = 0; c < 3; c++) {
        se[c] = sqrt(fmax(squares[c] - mean[c] * mean[c], 0) / samples);
    }
    assert_true(worker.refused == 0);
    free(weights);
}

static void expect(const char *what, double mean, double se, double wanted, double noticeable)
{
    print_message("%-44s %.5g +- %.2g, wanted %.5g: %+.1f se\n", what, mean, se, wanted, se > 0 ? (mean - wanted) / se : 0);
    assert_true(fabs(mean - wanted) <= REJECT * se + 1e-6 * wanted);
    assert_true(REJECT * se < noticeable * wanted);
}

/* A slab of fog, 1.5 m along the ray, before a wall of luminance 100: what isn't scattered or absorbed arrives. */
static void fog_transmits(void **state)
{
    (void)state;
    const room_rectangle wall = {.corner = {-5, -5, 0}, .e1 = {10, 0, 0}, .e2 = {0, 10, 0}, .luminance = 100};
    view_scene *scene =
        scene_with_recipe(&wall, 1,
                          "{\"volumes\": [{\"name\": \"fog\", \"box\": {\"min\": [-3, -3, 1], \"max\": [3, 3, 2.5]}, "
                          "\"scattering\": [0.2, 0.4, 0.6], \"absorption\": [0.1, 0.1, 0.3]}]}");
    lmg_error err;
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    double mean[3], se[3];
    look(scene, (lmg_vec3){0.1, 0.2, 4}, (lmg_vec3){0.1, 0.2, 0}, 40000, (view_path_options){.max_depth = 0}, mean, se);
    static const double EXTINCTION[3] = {0.3, 0.5, 0.9};
    for (int c = 0; c < 3; c++) {
        expect("fog before a wall", mean[c], se[c], 100 * exp(-1.5 * EXTINCTION[c]), 0.05);
    }
    view_scene_destroy(scene);
}

/* Walls of luminance 100 all around and fog that absorbs nothing: every ray sees 100, however often light is scattered.  With
 * the phase function forwards and backwards.  (Choosing lights alone has the same mean, but no bound on its variance by a wall.) */
static void bright_room_full_of_fog(void **state)
{
    (void)state;
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[6];
    room_walls(lower, upper, 0, walls);
    for (int i = 0; i < 6; i++) {
        walls[i].luminance = 100;
    }
    for (int k = 0; k < 2; k++) {
        char recipe[256];
        snprintf(recipe, sizeof recipe,
                 "{\"volumes\": [{\"name\": \"fog\", \"box\": {\"min\": [-3, -3, -3], \"max\": [3, 3, 0.7]}, "
                 "\"scattering\": [0.5, 0.7, 1], \"anisotropy\": %g}]}",
                 k ? -0.5 : 0.7);
        view_scene *scene = scene_with_recipe(walls, 6, recipe);
        lmg_error err;
        assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
        double mean[3], se[3];
        view_path_options options = {.max_depth = UINT32_MAX, .strategy = k ? VIEW_SCATTERING_ONLY : VIEW_MIS};
        look(scene, (lmg_vec3){0.1, 1.1, 1.2}, (lmg_vec3){0.4, 0.7, 0}, 20000, options, mean, se);
        for (int c = 0; c < 3; c++) {
            expect("bright room full of fog", mean[c], se[c], 100, 0.1);
        }
        view_scene_destroy(scene);
    }
}

/* Light of a box in fog, scattered once towards the eye: quadrature along the line of sight and over the panel. */
static void box_in_fog(void **state)
{
    (void)state;
    static const double L = 5000, SCATTERING = 0.3, ABSORPTION = 0.2, G = 0.4, X0 = -0.2, X1 = 0.3, Z0 = -0.1, Z1 = 0.2, H = 2;
    const room_rectangle far = {.corner = {-30, -10, -30}, .e1 = {60, 0, 0}, .e2 = {0, 0, -1}};
    char recipe[256];
    snprintf(recipe, sizeof recipe,
             "{\"volumes\": [{\"name\": \"fog\", \"box\": {\"min\": [-9, -9, -9], \"max\": [9, 9, 9]}, "
             "\"scattering\": %g, \"absorption\": %g, \"anisotropy\": %g}]}",
             SCATTERING, ABSORPTION, G);
    view_scene *scene = scene_with_recipe(&far, 1, recipe);
    lmg_error err;
    static const float WHITE[3] = {1, 1, 1};
    const view_placement up = {.position = {0, H, 0}};
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &up, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    /* To beyond the fog; below the panel, which isn't seen itself. */
    const lmg_vec3 eye = {-3, 1.1, 0.4}, target = {0, 1.0, 0.1}, d = view_unit(view_sub(target, eye));
    enum { STEPS = 2000, GRID = 24 };
    double reach = 6 / d.x * 2, wanted = 0;
    for (int i = 0; i < STEPS; i++) {
        double t = (i + 0.5) * reach / STEPS, sum = 0;
        lmg_vec3 p = view_add(eye, view_scale(d, t));
        for (int k = 0; k < GRID * GRID; k++) {
            lmg_vec3 q = {X0 + (k % GRID + 0.5) * (X1 - X0) / GRID, H, Z0 + (k / GRID + 0.5) * (Z1 - Z0) / GRID};
            lmg_vec3 way = view_sub(p, q);
            double r = view_length(way), cosine = -way.y / r;
            if (cosine > 0) {
                sum += lum_phase_pdf(G, -view_dot(way, d) / r) * L * cosine / (r * r) * exp(-(SCATTERING + ABSORPTION) * r);
            }
        }
        wanted += SCATTERING * exp(-(SCATTERING + ABSORPTION) * t) * sum * (X1 - X0) * (Z1 - Z0) / (GRID * GRID) * reach / STEPS;
    }
    for (int k = 0; k < 2; k++) {
        double mean[3], se[3];
        view_path_options options = {.max_depth = 1, .strategy = k ? VIEW_LIGHTS_ONLY : VIEW_MIS};
        look(scene, eye, target, 200000, options, mean, se);
        expect("a panel's light in fog, scattered once", mean[1], se[1], wanted, 0.04);
    }
    view_scene_destroy(scene);
}

/* Paths from the boxes change no mean in fog either. */
static void connections_in_fog(void **state)
{
    (void)state;
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[6];
    room_walls(lower, upper, 0.6, walls);
    view_scene *scene =
        scene_with_recipe(walls, 6,
                          "{\"volumes\": [{\"name\": \"fog\", \"box\": {\"min\": [-9, -9, -9], \"max\": [9, 1.5, 9]}, "
                          "\"scattering\": [0.2, 0.3, 0.5], \"absorption\": 0.1, \"anisotropy\": 0.3}]}");
    lmg_error err;
    static const float WHITE[3] = {1, 0.9f, 0.8f};
    const view_placement up = {.position = {0.1, 2.1, 0.05}, .ry = 20};
    assert_int_equal(view_scene_adopt_box(scene, beam_field(-0.1, 0.1, -0.08, 0.08, 0.05, WHITE, 2e5, 0.1), &up, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    view_reading with, without;
    view_meter_options options = {.samples = 300000, .seed = 3, .path = {.max_depth = UINT32_MAX, .connect = 1}};
    const lmg_vec3 at = view_sub((lmg_vec3){-0.5, 0.3, 0.2}, scene->origin), up_wards = {0, 0.6, -0.8};
    assert_int_equal(view_meter_read(scene, at, up_wards, &options, &with, &err), LMG_OK);
    options.path.connect = -1;
    options.seed = 4;
    options.samples = 600000;
    assert_int_equal(view_meter_read(scene, at, up_wards, &options, &without, &err), LMG_OK);
    for (int c = 0; c < 3; c++) {
        expect("indirect light in fog, with paths from the box", with.rgb[c], hypot(with.se[c], without.se[c]), without.rgb[c],
               0.25);
    }
    view_scene_destroy(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fog_transmits),
        cmocka_unit_test(bright_room_full_of_fog),
        cmocka_unit_test(box_in_fog),
        cmocka_unit_test(connections_in_fog),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
