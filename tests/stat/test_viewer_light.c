/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Direct light of boxes and emitters in the viewer against closed forms.
 *
 * Statistics: a rendering's mean has a normal distribution with the standard error that the viewer reports (means over 10^4 paths
 * and more). Null hypothesis: its expectation is the closed form.  Rejected beyond 4 standard errors; with fewer than 50 such
 * comparisons in this program a sound viewer fails with a probability below 50 * 6.3e-5 = 0.3 % for other seeds, and never for the
 * fixed ones. To make sure that the tests can fail, each also demands that an error of 3 % would be seen.
 */
#include "room_fixture.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

static const float WHITE[3] = {1, 1, 1};
static const double REJECT = 4;
static const double NOTICEABLE = 0.03;

static const view_path_options DIRECT = {.max_depth = 1};

static void expect(measurement m, double wanted, const char *what)
{
    double z = (m.mean - wanted) / m.se;
    print_message("%-50s %.6g +- %.2g, wanted %.6g: %+.1f se\n", what, m.mean, m.se, wanted, z);
    assert_true(m.refused == 0);
    assert_true(m.mean > 0 && fabs(z) <= REJECT);
    assert_true(REJECT * m.se < NOTICEABLE * wanted);
}

static const double X0 = -0.23, X1 = 0.31, Z0 = -0.11, Z1 = 0.17, L = 2385;

/* A floor of albedo 0.6 at y = 0, 40 m on a side; rho = 0.6. */
static const room_rectangle FLOOR = {.corner = {-20, 0, -20}, .e1 = {0, 0, 40}, .e2 = {40, 0, 0}, .albedo = 0.6};

static view_scene *floor_with_panel(const view_placement *placement)
{
    lmg_error err;
    view_scene *scene = scene_of(&FLOOR, 1);
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), placement, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    return scene;
}

/* The floor around (x,0,z), seen from aside under the box, in a picture so narrow that E is constant over it to 1e-5. */
static view_camera look_at_floor(const view_scene *scene, double x, double z)
{
    return camera_at(scene, x + 1.1, 0.4, z - 0.7, x, 0, z, 0.1);
}

static void floor_under_panel(void **state)
{
    (void)state;
    /* Heights from near (where the cosine changes over the panel) to far; points off the axes, so that mirrored or swapped axes
     * show. */
    static const double POINTS[][3] = {{0.1, 0.21, 0.02}, {0.3, 0.5, -0.4}, {-0.9, 0.8, 0.35}, {0.04, 2.1, 0.03}, {1.7, 5, -2.9}};
    for (size_t i = 0; i < sizeof POINTS / sizeof POINTS[0]; i++) {
        double x = POINTS[i][0], h = POINTS[i][1], z = POINTS[i][2];
        view_placement placement = {.position = {0, h, 0}};
        view_scene *scene = floor_with_panel(&placement);
        view_camera camera = look_at_floor(scene, x, z);
        char what[80];
        snprintf(what, sizeof what, "panel %.2f m over (%.2f, %.2f)", h, x, z);
        expect(measure(scene, &camera, 64, 64, 16, 11, DIRECT), 0.6 * panel_illuminance(X0, X1, Z0, Z1, L, x, h, z) / VIEW_PI,
               what);
        view_scene_destroy(scene);
    }
}

static void placement_turns_and_moves(void **state)
{
    (void)state;
    /* The panel turned by ry about the vertical: the point turned back sees what it saw. */
    double angle = 37.5, s = sin(angle * VIEW_PI / 180), c = cos(angle * VIEW_PI / 180);
    double x = 0.45, z = -0.3, h = 0.6;
    view_placement turned = {.position = {3.1, h, -2.2}, .ry = angle};
    view_scene *scene = floor_with_panel(&turned);
    /* Ry(a) takes (x,z) to (c x + s z, -s x + c z). */
    view_camera camera = look_at_floor(scene, 3.1 + c * x + s * z, -2.2 - s * x + c * z);
    double wanted = 0.6 * panel_illuminance(X0, X1, Z0, Z1, L, x, h, z) / VIEW_PI;
    expect(measure(scene, &camera, 64, 64, 16, 12, DIRECT), wanted, "turned about y and moved");
    view_scene_destroy(scene);

    /* Half turns about x and then about z are a half turn about y. */
    view_placement twice = {.position = {1, h, 1}, .rx = 180, .rz = 180};
    scene = floor_with_panel(&twice);
    camera = look_at_floor(scene, 1 - x, 1 - z);
    expect(measure(scene, &camera, 64, 64, 16, 13, DIRECT), wanted, "half turns about x and z");
    view_scene_destroy(scene);

    /* First x, then y: the panel looks along -z after rx = 90, then ry = -90 turns that to +x. */
    static const room_rectangle WALL = {.corner = {2, -20, -20}, .e1 = {0, 0, 40}, .e2 = {0, 40, 0}, .albedo = 0.6};
    lmg_error err;
    scene = scene_of(&WALL, 1);
    view_placement on_edge = {.position = {2 - h, 0, 0}, .rx = 90, .ry = -90};
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &on_edge, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    /* Own (x,z) -> rx: (x, -z up) -> ry: x goes to +z. */
    camera = camera_at(scene, 1, -z + 0.3, x - 0.9, 2, -z, x, 0.1);
    expect(measure(scene, &camera, 64, 64, 16, 14, DIRECT), wanted, "first about x, then about y");
    view_scene_destroy(scene);
}

static void boxes_add_up(void **state)
{
    (void)state;
    lmg_error err;
    static const float RED[3] = {1, 0.2f, 0.1f};
    view_scene *scene = scene_of(&FLOOR, 1);
    const view_placement one = {.position = {0.4, 1.3, 0.2}}, two = {.position = {-3, 2, 1}}, three = {.position = {0.5, 9, 0.1}};
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &one, 0, &err), LMG_OK);
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, RED, 3 * L), &two, 0, &err), LMG_OK);
    /* Rescaled to 5000 lm of emitted light. */
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &three, 5000, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    view_camera camera = look_at_floor(scene, 0.1, 0.3);
    double red = lmg_luminance(RED);
    double e = panel_illuminance(X0, X1, Z0, Z1, L, 0.1 - 0.4, 1.3, 0.3 - 0.2) +
               red * panel_illuminance(X0, X1, Z0, Z1, 3 * L, 0.1 + 3, 2, 0.3 - 1) +
               5000 / panel_flux(X0, X1, Z0, Z1, 1) * panel_illuminance(X0, X1, Z0, Z1, 1, 0.1 - 0.5, 9, 0.3 - 0.1);
    expect(measure(scene, &camera, 64, 64, 32, 15, DIRECT), 0.6 * e / VIEW_PI, "three boxes, one coloured, one rescaled");
    view_scene_destroy(scene);
}

static void geometry_shadows_box(void **state)
{
    (void)state;
    lmg_error err;
    /* A screen covers the half x > 0.04 of the panel as seen from the point, right below the panel. */
    const double h = 1.2;
    room_rectangle both[2] = {FLOOR, {.corner = {0.04, h - 1e-3, -9}, .e1 = {0, 0, 18}, .e2 = {9, 0, 0}, .albedo = 0.0}};
    view_scene *scene = scene_of(both, 2);
    const view_placement placement = {.position = {0, h, 0}};
    assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &placement, 0, &err), LMG_OK);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    view_camera camera = look_at_floor(scene, 0.04, 0.1);
    expect(measure(scene, &camera, 64, 64, 16, 16, DIRECT), 0.6 * panel_illuminance(X0, 0.04, Z0, Z1, L, 0.04, h, 0.1) / VIEW_PI,
           "half of the panel hidden by a screen");
    view_scene_destroy(scene);
}

/* A floor that mirrors roughly, a box, and an emitting rectangle of the room: all three ways to estimate direct light agree. */
static void strategies_agree(void **state)
{
    (void)state;
    lmg_error err;
    room_rectangle both[2] = {
        FLOOR, {.corner = {0.3, 0.9, -0.2}, .e1 = {0.4, 0.1, 0}, .e2 = {0, 0.05, 0.5}, .albedo = 0.4, .luminance = 700}};
    static const char *const NAME[3] = {"both", "lights only", "scattering only"};
    for (int rough = 0; rough < 3; rough++) {
        both[0].metal = rough > 0;
        both[0].albedo = rough > 0 ? 0.9 : 0.6;
        both[0].roughness = rough == 1 ? 0.7 : 0.4;
        view_scene *scene = scene_of(both, 2);
        const view_placement placement = {.position = {-0.2, 0.7, 0.1}, .rx = 10, .rz = -15};
        assert_int_equal(view_scene_adopt_box(scene, panel_field(X0, X1, Z0, Z1, 0.05, WHITE, L), &placement, 0, &err), LMG_OK);
        assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
        view_camera camera = camera_at(scene, -1.0, 0.9, 0.3, 0.1, 0, 0, 20);
        measurement m[3];
        for (int i = 0; i < 3; i++) {
            view_path_options options = {.max_depth = 1, .strategy = (view_strategy)i};
            m[i] = measure(scene, &camera, 48, 48, i == VIEW_MIS ? 64 : 512, 17 + (uint64_t)i, options);
            print_message("floor %d, %-16s %.6g +- %.2g\n", rough, NAME[i], m[i].mean, m[i].se);
            assert_true(m[i].refused == 0 && m[i].mean > 0);
        }
        for (int i = 1; i < 3; i++) {
            double se = hypot(m[0].se, m[i].se), z = (m[i].mean - m[0].mean) / se;
            print_message("  %s against both: %+.1f se\n", NAME[i], z);
            assert_true(fabs(z) <= REJECT);
            assert_true(REJECT * se < NOTICEABLE * m[0].mean);
        }
        view_scene_destroy(scene);
    }
}

/* A rectangle that shines, as room geometry, lights the floor by the same closed form. */
static void emitter_lights_floor(void **state)
{
    (void)state;
    lmg_error err;
    const double h = 0.7, x = 0.2, z = -0.25;
    room_rectangle both[2] = {FLOOR, {.corner = {X0, h, Z0}, .e1 = {X1 - X0, 0, 0}, .e2 = {0, 0, Z1 - Z0}, .luminance = L}};
    view_scene *scene = scene_of(both, 2);
    assert_int_equal(view_scene_finish(scene, &err), LMG_OK);
    view_camera camera = look_at_floor(scene, x, z);
    expect(measure(scene, &camera, 64, 64, 16, 21, DIRECT), 0.6 * panel_illuminance(X0, X1, Z0, Z1, L, x, h, z) / VIEW_PI,
           "emitting rectangle of the room");
    view_scene_destroy(scene);
}

/* Looking straight at the box: the panel's own luminance, and nothing beside it. */
static void direct_view(void **state)
{
    (void)state;
    view_placement placement = {.position = {0, 2, 0}};
    view_scene *scene = floor_with_panel(&placement);
    view_camera camera = camera_at(scene, 0.3, 0.5, -0.2, 0.04, 2, 0.03, 1);
    measurement m = measure(scene, &camera, 8, 8, 4, 22, DIRECT);
    /* Constant, but for the float's rounding of L. */
    assert_true(fabs(m.mean - L) < 1e-4 * L && m.se < 1e-4 * L);
    camera = camera_at(scene, 0.3, 2.5, -0.2, 0.04, 2.06, 0.03, 1);
    m = measure(scene, &camera, 8, 8, 4, 22, (view_path_options){.max_depth = 0});
    assert_true(m.mean == 0); /* from above: dark; the floor behind doesn't shine by itself */
    view_scene_destroy(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(floor_under_panel),    cmocka_unit_test(placement_turns_and_moves), cmocka_unit_test(boxes_add_up),
        cmocka_unit_test(geometry_shadows_box), cmocka_unit_test(strategies_agree),          cmocka_unit_test(emitter_lights_floor),
        cmocka_unit_test(direct_view),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
