/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Global illumination in the viewer: the balance of a closed white room, a lamp by its box and by its geometry, threads.
 *
 * Statistics: as in test_viewer_light.c.  Null hypothesis: equal expectations.  Single means are rejected beyond 4 standard errors;
 * sums of squares over blocks beyond the value that a chi-square distribution exceeds with a probability of 1e-4 (Wilson and
 * Hilferty 1931).
 */
#include "meter.h"
#include "room_fixture.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const double REJECT = 4;
static const view_path_options ENDLESS = {.max_depth = UINT32_MAX};

/* Photon-like rays of a Lambertian sphere of radius r around the origin, flux 1 each. */
static void sphere_rays(double r, lmg_ray *rays, uint64_t count, uint64_t seed)
{
    lum_rng rng = lum_rng_stream(seed, 7);
    for (uint64_t i = 0; i < count; i++) {
        double y = 2 * lum_rng_next(&rng) - 1, phi = 2 * VIEW_PI * lum_rng_next(&rng), q = sqrt(1 - y * y);
        lmg_vec3 n = {q * cos(phi), y, q * sin(phi)};
        double u = lum_rng_next(&rng), psi = 2 * VIEW_PI * lum_rng_next(&rng);
        lmg_vec3 t = view_unit(view_cross(n, fabs(n.x) < 0.5 ? (lmg_vec3){1, 0, 0} : (lmg_vec3){0, 1, 0})), b = view_cross(n, t);
        lmg_vec3 d =
            view_add(view_scale(n, sqrt(1 - u)), view_add(view_scale(t, sqrt(u) * cos(psi)), view_scale(b, sqrt(u) * sin(psi))));
        rays[i] = (lmg_ray){.origin = view_scale(n, r), .direction = view_unit(d), .flux = {1, 1, 1}, .number = i};
    }
}

/* count such rays of a seed in a box fitted to those of seed 7. */
static lmg_field *sphere_field(double r, double flux, uint64_t count, uint64_t cells, uint64_t seed)
{
    lmg_error err = {""};
    lmg_ray *rays = malloc(count * sizeof *rays);
    assert_non_null(rays);
    sphere_rays(r, rays, count, 7);
    /* The bounds stand off the sphere a little and unevenly. */
    lmg_fit_options fit = {.struct_size = sizeof fit,
                           .cells = cells,
                           .bounds_min = {-r - 0.01, -r - 0.02, -r - 0.03},
                           .bounds_max = {r + 0.01, r + 0.02, r + 0.03}};
    lmg_layout layout;
    lmg_accumulator *acc = NULL;
    lmg_field *field = NULL;
    char report[1024];
    if (lmg_layout_fit(rays, count, &fit, &layout, report, &err) != LMG_OK ||
        lmg_accumulator_create(&layout, &acc, &err) != LMG_OK) {
        fail_msg("%s", err.message);
    }
    sphere_rays(r, rays, count, seed);
    lmg_accumulator_deposit(acc, rays, count);
    lmg_ledger ledger = {.photons = count, .emitted = flux, .stored = flux};
    assert_int_equal(lmg_field_reconstruct(acc, flux / (double)count, &ledger, &field, &err), LMG_OK);
    lmg_accumulator_destroy(acc);
    free(rays);
    return field;
}

/*
 * In a closed room whose walls all have the albedo rho, what a lamp gives is what the walls absorb: flux = (1 - rho) S E, with E
 * the mean illuminance.  Six cameras in the middle, inside the box's bounds, look at one wall each in pixels of equal area.
 */
static void closed_room_balance(void **state)
{
    (void)state;
    static const double SIDE = 3, FLUX = 1234.5;
    static const double RHO[] = {0.5, 0.8};
    lmg_error err;
    for (size_t k = 0; k < 2; k++) {
        const double lower[3] = {1, 0, -2}, upper[3] = {1 + SIDE, SIDE, -2 + SIDE};
        room_rectangle walls[6];
        room_walls(lower, upper, RHO[k], walls);
        view_scene *scene = scene_of(walls, 6);
        lmg_field *field = sphere_field(0.1, FLUX, 400000, 200000, 7);
        double stored = 0;
        for (uint32_t i = 0; i < lmg_field_layout(field)->slab_count; i++) {
            stored += lmg_field_slab_flux(field, i, NULL);
        }
        assert_true(fabs(stored - FLUX) < 1e-6 * FLUX);
        const double m[3] = {1 + SIDE / 2, SIDE / 2, -2 + SIDE / 2};
        const view_placement placement = {.position = {m[0], m[1], m[2]}, .rx = 20, .ry = 30, .rz = 40};
        assert_int_equal(view_scene_adopt_box(scene, field, &placement, 0, &err), LMG_OK);
        assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
        static const double LOOK[6][3] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
        double mean = 0, variance = 0;
        for (int i = 0; i < 6; i++) {
            view_camera camera = camera_at(scene, m[0], m[1], m[2], m[0] + LOOK[i][0], m[1] + LOOK[i][1], m[2] + LOOK[i][2], 90);
            measurement wall = measure(scene, &camera, 48, 48, 32, 31 + (uint64_t)i, ENDLESS);
            assert_true(wall.refused == 0);
            mean += wall.mean / 6;
            variance += wall.se * wall.se / 36;
        }
        double e = mean * VIEW_PI / RHO[k], se = sqrt(variance) * VIEW_PI / RHO[k],
               wanted = FLUX / (6 * SIDE * SIDE * (1 - RHO[k]));
        print_message("closed room, albedo %g: %.5g +- %.2g lx, wanted %.5g: %+.1f se\n", RHO[k], e, se, wanted, (e - wanted) / se);
        assert_true(fabs(e - wanted) <= REJECT * se);
        assert_true(REJECT * se < 0.02 * wanted);
        view_scene_destroy(scene);
    }
}

/* The value that a chi-square distribution with n degrees of freedom exceeds with a probability of 1e-4. */
static double chi_square_limit(double n)
{
    double c = 2 / (9 * n), z = 3.719;
    return n * pow(1 - c + z * sqrt(c), 3);
}

/* Sum over blocks of (a - b)^2 / (se_a^2 + se_b^2). */
static double chi_square(const view_image *a, const view_image *b, double factor, int *blocks)
{
    enum { BLOCK = 8 };
    double sum = 0;
    *blocks = 0;
    for (uint32_t y = 0; y < a->height; y += BLOCK) {
        for (uint32_t x = 0; x < a->width; x += BLOCK) {
            double difference = 0, variance = 0;
            for (uint32_t i = 0; i < BLOCK * BLOCK; i++) {
                size_t p = (size_t)(y + i / BLOCK) * a->width + x + i % BLOCK;
                difference += lmg_luminance(&a->rgb[3 * p]) * factor - lmg_luminance(&b->rgb[3 * p]);
                variance += (double)a->standard_error[p] * (double)a->standard_error[p] +
                            (double)b->standard_error[p] * (double)b->standard_error[p];
            }
            sum += difference * difference / variance;
            ++*blocks;
        }
    }
    return sum;
}

static view_image picture(const view_scene *scene, const view_camera *camera, uint32_t side, uint32_t samples, uint64_t seed,
                          view_path_options path)
{
    lmg_error err;
    view_render *render = NULL;
    view_image image;
    view_render_options options = {.width = side, .height = side, .seed = seed, .path = path};
    assert_int_equal(view_render_create(scene, camera, &options, &render, &err), LMG_OK);
    assert_int_equal(view_render_pass(render, samples, NULL, &err), LMG_OK);
    assert_int_equal(view_image_create(side, side, &image, &err), LMG_OK);
    view_render_resolve(render, &image);
    view_render_destroy(render);
    return image;
}

/*
 * A panel lamp on a tilted ceiling panel, as a box and as geometry: the same picture.  The lamp's own surface and the ceiling right
 * behind it are black, since a box is transparent for light that comes back and its geometry isn't; and the camera doesn't see the
 * lamp.
 */
static void box_and_geometry_agree(void **state)
{
    (void)state;
    static const double X0 = -0.4, X1 = 0.5, Z0 = -0.3, Z1 = 0.2, L = 1850, H = 2.4;
    lmg_error err = {""};
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[7];
    room_walls(lower, upper, 0.6, walls);
    walls[1].albedo = 0; /* the ceiling */
    walls[6] =
        (room_rectangle){.corner = {-0.5, 0, -0.3}, .e1 = {0.2, 0.9, 0}, .e2 = {0, 0.1, 0.8}, .albedo = 0.7}; /* casts a shadow */
    const view_placement placement = {.position = {0.2, H, 0.1}, .ry = 25};
    static const float WHITE[3] = {1, 1, 1};

    view_scene *boxed = scene_of(walls, 7), *built = scene_of(walls, 7);
    assert_int_equal(view_scene_adopt_box(boxed, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &placement, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(boxed, &err), LMG_OK);

    char folder[] = "/tmp/lumibox-lamp-XXXXXX", path[64];
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/lamp.gltf", folder);
    const room_rectangle lamp = {.corner = {X0, 0, Z0}, .e1 = {X1 - X0, 0, 0}, .e2 = {0, 0, Z1 - Z0}, .luminance = L};
    room_write(path, &lamp, 1);
    lmg_result r = view_scene_add_lamp(built, path, NULL, &placement, 0, &err);
    unlink(path);
    rmdir(folder);
    if (r != LMG_OK) {
        fail_msg("%s", err.message);
    }
    assert_int_equal(view_scene_finish(built, &err), LMG_OK);
    assert_true(fabs(built->objects[1].flux - panel_flux(X0, X1, Z0, Z1, L)) < 1e-5 * built->objects[1].flux);

    /* Down into a corner: floor, two walls, the tilted rectangle and its shadow. */
    view_camera camera = camera_at(boxed, 1.8, 1.9, 1.3, -0.6, 0.2, -0.4, 55);
    view_image a = picture(boxed, &camera, 64, 96, 41, ENDLESS), b = picture(built, &camera, 64, 96, 42, ENDLESS);
    int blocks;
    double same = chi_square(&a, &b, 1, &blocks), mutant = chi_square(&a, &b, 1.03, &blocks), limit = chi_square_limit(blocks);
    print_message("box against geometry: chi-square %.1f for %d blocks (limit %.1f); with 3 %% more light %.1f\n", same, blocks,
                  limit, mutant);
    assert_true(same < limit);
    assert_true(mutant > limit);
    view_image_free(&a);
    view_image_free(&b);
    view_scene_destroy(boxed);
    view_scene_destroy(built);
}

/*
 * Paths from the boxes change the noise and nothing else.  A beam on a table among diffuse and roughly mirroring surfaces, two
 * boxes of which one is turned; with connections always, sometimes and never, for all depths and for two scatterings alone.
 */
static void connections_change_no_mean(void **state)
{
    (void)state;
    lmg_error err;
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[9];
    room_walls(lower, upper, 0.6, walls);
    walls[2].metal = true; /* mirrors roughly */
    walls[2].roughness = 0.5;
    walls[2].albedo = 0.8;
    walls[6] = (room_rectangle){.corner = {-0.5, 0.7, -0.4}, .e1 = {0, 0, 0.8}, .e2 = {1.1, 0, 0}, .albedo = 0.7};
    walls[7] = (room_rectangle){.corner = {-0.5, 0.6999, -0.4}, .e1 = {1.1, 0, 0}, .e2 = {0, 0, 0.8}, .albedo = 0.3};
    walls[8] = (room_rectangle){.corner = {-0.4, 0.71, -0.2}, .e1 = {0.15, 0.3, 0}, .e2 = {0, 0, 0.3}, .albedo = 0.5};
    view_scene *scene = scene_of(walls, 9);
    static const float WARM[3] = {1, 0.8f, 0.6f}, COOL[3] = {0.7f, 0.9f, 1.2f};
    const view_placement one = {.position = {0.1, 2.1, 0.05}, .ry = 20}, two = {.position = {-1, 1.5, 0.8}, .rx = 40, .rz = -30};
    assert_int_equal(view_scene_adopt_box(scene, beam_field(-0.1, 0.1, -0.08, 0.08, 0.05, WARM, 2e5, 0.1), &one, 0, &err), LMG_OK);
    assert_int_equal(view_scene_adopt_box(scene, panel_field(-0.1, 0.1, -0.08, 0.08, 0.05, COOL, 500), &two, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    assert_true(scene->connect > 0);
    view_camera camera = camera_at(scene, 1.8, 1.4, 1.3, -0.6, 0.7, -0.8, 60);
    for (int depth = 2; depth <= 12; depth += 10) {
        view_path_options never = {.max_depth = (uint32_t)depth, .connect = -1},
                          always = {.max_depth = (uint32_t)depth, .connect = 1},
                          sometimes = {.max_depth = (uint32_t)depth, .connect = 0.4};
        view_image a = picture(scene, &camera, 48, depth > 2 ? 1000 : 400, 51, never);
        for (int i = 0; i < 2; i++) {
            view_image b = picture(scene, &camera, 48, 64, 52 + (uint64_t)i, i ? sometimes : always);
            int blocks;
            double same = chi_square(&a, &b, 1, &blocks), limit = chi_square_limit(blocks);
            print_message("depth %d, connections %s: chi-square %.1f for %d blocks (limit %.1f); with 20 %% more light %.1f\n",
                          depth, i ? "sometimes" : "always", same, blocks, limit, chi_square(&a, &b, 1.2, &blocks));
            assert_true(same < limit);
            assert_true(chi_square(&a, &b, 1.2, &blocks) > limit);
            view_image_free(&b);
        }
        view_image_free(&a);
    }
    view_scene_destroy(scene);
}

/* The same bits on 1, 2 and 5 threads, in one pass and in three; other bits for another seed. */
static void threads_change_nothing(void **state)
{
    (void)state;
    lmg_error err;
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[6];
    room_walls(lower, upper, 0.6, walls);
    walls[2].luminance = 90;
    view_scene *scene = scene_of(walls, 6);
    static const float COLOR[3] = {0.7f, 1, 0.9f};
    const view_placement placement = {.position = {0.2, 2, 0.1}, .rx = 12, .ry = 25};
    assert_int_equal(view_scene_adopt_box(scene, panel_field(-0.2, 0.3, -0.1, 0.2, 0.05, COLOR, 2000), &placement, 0, &err),
                     LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    view_camera camera = camera_at(scene, 1.8, 1.9, 1.3, -0.6, 0.2, -0.4, 55);
    static const struct {
        unsigned threads;
        uint32_t passes[3];
        uint64_t seed;
    } RUN[4] = {{1, {6, 0, 0}, 5}, {2, {6, 0, 0}, 5}, {5, {1, 3, 2}, 5}, {2, {6, 0, 0}, 6}};
    view_image image[4];
    uint64_t rays[4];
    for (int i = 0; i < 4; i++) {
        view_render *render = NULL;
        /* Sides that aren't multiples of a tile. */
        view_render_options options = {.width = 50, .height = 37, .seed = RUN[i].seed, .threads = RUN[i].threads, .path = ENDLESS};
        assert_int_equal(view_render_create(scene, &camera, &options, &render, &err), LMG_OK);
        for (int k = 0; k < 3; k++) {
            assert_int_equal(view_render_pass(render, RUN[i].passes[k], NULL, &err), LMG_OK);
        }
        assert_int_equal(view_image_create(50, 37, &image[i], &err), LMG_OK);
        view_render_resolve(render, &image[i]);
        view_render_state look = view_render_look(render);
        rays[i] = look.rays;
        assert_int_equal(look.samples_min, 6);
        assert_int_equal(look.samples_max, 6);
        view_render_destroy(render);
    }
    for (int i = 1; i < 4; i++) {
        bool same = memcmp(image[0].rgb, image[i].rgb, 50 * 37 * 3 * sizeof(float)) == 0 &&
                    memcmp(image[0].standard_error, image[i].standard_error, 50 * 37 * sizeof(float)) == 0;
        assert_true(same == (i < 3));
        assert_true((rays[i] == rays[0]) == (i < 3));
    }
    for (int i = 0; i < 4; i++) {
        view_image_free(&image[i]);
    }
    view_scene_destroy(scene);
}

/* The standard error that a picture claims is the spread that it has over seeds. */
static void errors_are_honest(void **state)
{
    (void)state;
    lmg_error err;
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[6];
    room_walls(lower, upper, 0.6, walls);
    view_scene *scene = scene_of(walls, 6);
    static const float WHITE[3] = {1, 1, 1};
    const view_placement placement = {.position = {0.2, 2, 0.1}, .rx = 12, .ry = 25};
    assert_int_equal(view_scene_adopt_box(scene, panel_field(-0.2, 0.3, -0.1, 0.2, 0.05, WHITE, 2000), &placement, 0, &err),
                     LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    view_camera camera = camera_at(scene, 1.8, 1.9, 1.3, -0.6, 0.2, -0.4, 55);
    enum { SEEDS = 160 };
    double sum = 0, squares = 0, claimed = 0;
    for (int i = 0; i < SEEDS; i++) {
        measurement m = measure(scene, &camera, 16, 16, 24, 100 + (uint64_t)i, ENDLESS);
        sum += m.mean;
        squares += m.mean * m.mean;
        claimed += m.se * m.se / SEEDS;
    }
    double spread = (squares - sum * sum / SEEDS) / (SEEDS - 1), ratio = spread / claimed;
    print_message("spread over %d seeds / claimed variance: %.3f\n", SEEDS, ratio);
    /* ratio x 159 is chi-square distributed: between the 1e-4 quantiles of either side. */
    assert_true(ratio * (SEEDS - 1) < chi_square_limit(SEEDS - 1));
    double c = 2.0 / (9 * (SEEDS - 1));
    assert_true(ratio > pow(1 - c - 3.719 * sqrt(c), 3));
    view_scene_destroy(scene);
}

/*
 * A meter's two errors together are the spread that it has over bakes and paths of other seeds, direct and indirect light alike;
 * and so are those of a picture's mean.  The bake is made to weigh more than the paths, so that a bake's error left out or doubled
 * shows: the spread over the claim, times SEEDS - 1, is chi-square distributed, within its 1e-4 quantiles a ratio of 0.36 to 2.1.
 */
static void errors_of_bake_and_paths_are_honest(void **state)
{
    (void)state;
    enum { SEEDS = 40 };
    lmg_error err;
    const double lower[3] = {-1, 0, -1}, upper[3] = {1, 2, 1};
    room_rectangle walls[7];
    room_walls(lower, upper, 0.5, walls);
    walls[6] = (room_rectangle){.corner = {-0.3, 0.9, -0.3}, .e1 = {0, 0, 0.6}, .e2 = {0.6, 0, 0}, .albedo = 0.5}; /* a table */
    double sum[3] = {0}, squares[3] = {0}, bake[3] = {0}, paths[3] = {0};
    for (int i = 0; i < SEEDS; i++) {
        view_scene *scene = scene_of(walls, 7);
        const view_placement placement = {.position = {0.1, 1.6, 0}, .ry = 25};
        assert_int_equal(view_scene_adopt_box(scene, sphere_field(0.1, 1000, 20000, 20000, 100 + (uint64_t)i), &placement, 0, &err),
                         LMG_OK);
        assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
        for (int k = 0; k < 3; k++) {
            double value, from_bake, from_paths;
            if (k < 2) { /* on the table, and beneath it on the floor, where no light comes directly */
                const lmg_vec3 at = view_sub(k ? (lmg_vec3){0, 0.01, 0} : (lmg_vec3){-0.1, 0.91, 0.1}, scene->origin),
                               up = {0, 1, 0};
                const view_meter_options options = {.samples = 8000, .seed = 200 + (uint64_t)i, .path = ENDLESS};
                view_reading r;
                assert_int_equal(view_meter_read(scene, at, up, &options, &r, &err), LMG_OK);
                value = r.lux;
                from_bake = r.bake;
                from_paths = r.render;
            } else {
                view_camera camera = camera_at(scene, 0.1, 1.3, 0.9, 0, 0.9, 0, 30);
                view_render *render = NULL;
                const view_render_options options = {.width = 48, .height = 48, .seed = 300 + (uint64_t)i, .path = ENDLESS};
                assert_int_equal(view_render_create(scene, &camera, &options, &render, &err), LMG_OK);
                for (int pass = 0; pass < 2; pass++) {
                    assert_int_equal(view_render_pass(render, 2, NULL, &err), LMG_OK);
                }
                view_render_state look = view_render_look(render);
                value = look.mean;
                from_bake = look.mean_bake;
                from_paths = look.mean_render;
                view_render_destroy(render);
            }
            sum[k] += value;
            squares[k] += value * value;
            bake[k] += from_bake * from_bake / SEEDS;
            paths[k] += from_paths * from_paths / SEEDS;
        }
        view_scene_destroy(scene);
    }
    static const char *const WHAT[3] = {"meter in direct light", "meter in indirect light", "mean picture"};
    for (int k = 0; k < 3; k++) {
        double mean = sum[k] / SEEDS, spread = (squares[k] - sum[k] * mean) / (SEEDS - 1), ratio = spread / (bake[k] + paths[k]);
        print_message("%-24s %.4g, spread over %d seeds %.2f %%, claimed %.2f %% bake, %.2f %% paths: variances' ratio %.2f\n",
                      WHAT[k], mean, SEEDS, 100 * sqrt(spread) / mean, 100 * sqrt(bake[k]) / mean, 100 * sqrt(paths[k]) / mean,
                      ratio);
        double c = 2.0 / (9 * (SEEDS - 1));
        assert_true(ratio * (SEEDS - 1) < chi_square_limit(SEEDS - 1));
        assert_true(ratio > pow(1 - c - 3.719 * sqrt(c), 3));
    }
    assert_true(bake[0] > paths[0]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(connections_change_no_mean), cmocka_unit_test(closed_room_balance),
        cmocka_unit_test(box_and_geometry_agree),     cmocka_unit_test(threads_change_nothing),
        cmocka_unit_test(errors_are_honest),          cmocka_unit_test(errors_of_bake_and_paths_are_honest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
