/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The whole chain - glTF, bake, box file, reading, illuminance - against closed forms: Lambertian disc, square and sphere, and the
 * far axial intensity of the paraboloid spot.  Fixed seeds; every value must lie within 3 of its own standard errors and within 1 %
 * (the spot: 2 %).  A point's error goes as sqrt(sqrt(cells)) / sqrt(photons), so uniform emitters are baked into fewer cells than
 * the default.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "bake.h"
#include "dimensions.h"
#include "gltf_writer.h"

#include <luminaires/model.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

static const double PI = 3.14159265358979323846;

static void folder(char path[1024])
{
    snprintf(path, 1024, "%s/tests/closed_forms", LUMIBOX_BINARY_DIR);
    mkdir(path, 0777);
}

/* Bakes a lamp file, writes the box, and returns what reading it gives.  backward: rays traced backwards for each photon. */
static lmg_field *bake_file(const char *path, const char *name, uint64_t photons, uint64_t cells, double backward)
{
    lmg_error err = {{0}};
    lum_model *model;
    if (lum_model_load(path, NULL, &model, &err) != LMG_OK)
        fail_msg("%s", err.message);
    const bake_options options = {.photons = photons, .seed = 7, .fit.cells = cells, .rays_per_photon = backward};
    bake_report report;
    lmg_field *field;
    if (bake_run(model, &options, &field, &report, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lum_model_destroy(model);
    char box[1200], where[1024];
    folder(where);
    snprintf(box, sizeof(box), "%s/%s.box.exr", where, name);
    if (lmg_field_write(field, box, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lmg_field_destroy(field);
    if (lmg_field_read(box, &field, &err) != LMG_OK)
        fail_msg("%s", err.message);
    const lmg_ledger l = lmg_field_ledger(field);
    assert_int_equal(l.photons, photons);
    /* deposits are rounded to 2^-20 of a photon */
    assert_true(fabs(l.stored + l.residual + l.absorbed + l.lost - l.emitted) <= 1e-6 * l.emitted);
    assert_true(l.lost <= 1e-6 * l.emitted);
    return field;
}

/* Writes a mesh as a lamp of luminance L and bakes it. */
static lmg_field *bake_mesh(const mesh *m, const char *name, double luminance, uint64_t photons, uint64_t cells, double backward)
{
    char where[1024], path[1200];
    folder(where);
    const gltf_material light = {.name = "light", .roughness = 1, .emission_color = {1, 1, 1}, .luminance = luminance};
    gltf_file *file = gltf_begin(name);
    gltf_add(file, "light", m, &light);
    gltf_end(file, where);
    snprintf(path, sizeof(path), "%s/%s.gltf", where, name);
    return bake_file(path, name, photons, cells, backward);
}

static void expect_near(double e, double error, double expected, const char *what, double at)
{
    print_message("%s at %g: %.6g lx, closed form %.6g: %+.3f %% +- %.3f %%\n", what, at, e, expected, 100 * (e / expected - 1),
                  100 * error / expected);
    fflush(stdout);
    assert_true(error > 0);
    assert_true(fabs(e - expected) < 3 * error);
    assert_true(fabs(e - expected) < 0.01 * expected);
}

static void expect_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, double expected, const char *what,
                               double at)
{
    double rgb[3], error;
    lmg_error err = {{0}};
    if (lmg_field_illuminance(field, point, normal, rgb, &error, &err) != LMG_OK)
        fail_msg("%s", err.message);
    expect_near(0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2], error, expected, what, at);
}

/* A disc facing +x, off the origin.  E / (I/d^2) on the axis: 1 / (1 + (R/d)^2). */
static void test_disc(void **state)
{
    (void)state;
    enum { SEGMENTS = 128 };
    const double diameter = 0.2385, luminance = 4100, step = 2 * PI / SEGMENTS;
    /* corners a little further out, so that the polygon has the disc's area */
    const double corner = 0.5 * diameter * sqrt(step / sin(step));
    const lmg_vec3 centre = {0.31, -0.12, 0.77};
    mesh m = {0};
    const double n[3] = {1, 0, 0}, c[3] = {centre.x, centre.y, centre.z};
    const uint32_t middle = mesh_add_vertex(&m, c, n);
    uint32_t last = 0;
    for (int i = 0; i <= SEGMENTS; ++i) {
        const double p[3] = {c[0], c[1] + corner * cos(i * step), c[2] + corner * sin(i * step)};
        const uint32_t v = mesh_add_vertex(&m, p, n);
        if (i > 0)
            mesh_add_triangle(&m, middle, last, v);
        last = v;
    }
    lmg_field *field = bake_mesh(&m, "disc", luminance, 30000000, 200000, 0);
    mesh_free(&m);
    const double intensity = luminance * PI * diameter * diameter / 4;
    const double ratios[][2] = {{0.5, 0.5}, {1, 0.8}, {2, 16.0 / 17}, {5, 100.0 / 101}, {10, 400.0 / 401}};
    for (int i = 0; i < 5; ++i) {
        const double d = ratios[i][0] * diameter;
        expect_illuminance(field, (lmg_vec3){centre.x + d, centre.y, centre.z}, (lmg_vec3){-1, 0, 0},
                           ratios[i][1] * intensity / (d * d), "disc, diameters", ratios[i][0]);
    }
    lmg_field_destroy(field);
}

/* A square facing -y.  On the axis, h = d / (a/2): E = 4 L X / sqrt(1+h^2) atan(1/sqrt(1+h^2)), the view factor of four quarters,
 * each 1/(2 pi) 2 (1/sqrt(1+h^2)) atan(1/sqrt(1+h^2)). */
static void test_square(void **state)
{
    (void)state;
    const double side = 0.4, luminance = 2750;
    const double corner[3] = {0.1, 0.25, -0.3}, along_x[3] = {side, 0, 0}, along_z[3] = {0, 0, side};
    mesh m = {0};
    mesh_add_rectangle(&m, corner, along_x, along_z); /* x cross z = -y */
    lmg_field *field = bake_mesh(&m, "square", luminance, 30000000, 200000, 0);
    mesh_free(&m);
    const double intensity = luminance * side * side, known[][2] = {{0.5, 0.4352}, {1, 0.7523}, {2, 0.9234}, {5, 0.9869}};
    for (int i = 0; i < 4; ++i) {
        const double d = known[i][0] * side, h = d / (side / 2), root = sqrt(1 + h * h);
        const double expected = 4 * luminance * atan(1 / root) / root;
        assert_true(fabs(expected - known[i][1] * intensity / (d * d)) < 1e-4 * intensity / (d * d)); /* the table's last digit */
        expect_illuminance(field, (lmg_vec3){corner[0] + side / 2, corner[1] - d, corner[2] + side / 2}, (lmg_vec3){0, 1, 0},
                           expected, "square, sides", known[i][0]);
    }
    lmg_field_destroy(field);
}

/* A Lambertian sphere: E = pi L r^2 / d^2 facing it, at any distance.  The facets' mean projected area is a quarter of their
 * surface (Cauchy), so corners are moved out until the mesh has the sphere's area. */
static const double SPHERE_RADIUS = 0.015, SPHERE_LUMINANCE = 90000, SPHERE_CENTRE[3] = {0.2, 0.1, -0.05};
enum { DIRECTIONS = 24 };

static lmg_field *bake_sphere(const char *name, double backward)
{
    const double r = SPHERE_RADIUS;
    mesh m = {0};
    mesh_add_sphere(&m, SPHERE_CENTRE, r, 48, 96);
    const double blown = r * sqrt(4 * PI * r * r / mesh_area(&m));
    mesh_free(&m);
    mesh_add_sphere(&m, SPHERE_CENTRE, blown, 48, 96);
    lmg_field *field = bake_mesh(&m, name, SPHERE_LUMINANCE, 30000000, 4000000, backward);
    mesh_free(&m);
    return field;
}

/* Illuminance over the closed form at distance d in direction k of a spiral of equal solid angles. */
static double sphere_ratio(const lmg_field *field, double d, int k, double *error)
{
    const double expected = PI * SPHERE_LUMINANCE * SPHERE_RADIUS * SPHERE_RADIUS / (d * d);
    const double z = 1 - (2 * k + 1.0) / DIRECTIONS, phi = k * PI * (3 - sqrt(5)), s = sqrt(1 - z * z);
    const lmg_vec3 n = {s * cos(phi), z, s * sin(phi)}, facing = {-n.x, -n.y, -n.z};
    const lmg_vec3 point = {SPHERE_CENTRE[0] + d * n.x, SPHERE_CENTRE[1] + d * n.y, SPHERE_CENTRE[2] + d * n.z};
    double rgb[3];
    assert_int_equal(lmg_field_illuminance(field, point, facing, rgb, error, NULL), LMG_OK);
    *error /= expected;
    return (0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]) / expected;
}

static const double SPHERE_DISTANCES[] = {0.045, 0.1, 0.2, 0.5, 2};

/* By photons alone, measured as a goniophotometer would: the mean over 24 directions all round, whose cells are different ones and so
 * have independent errors. */
static void test_sphere(void **state)
{
    (void)state;
    lmg_field *field = bake_sphere("sphere", 0);
    for (int i = 0; i < 5; ++i) {
        double sum = 0, variance = 0;
        for (int k = 0; k < DIRECTIONS; ++k) {
            double error;
            sum += sphere_ratio(field, SPHERE_DISTANCES[i], k, &error);
            variance += error * error;
        }
        expect_near(sum / DIRECTIONS, sqrt(variance) / DIRECTIONS, 1, "sphere over the closed form, metres", SPHERE_DISTANCES[i]);
    }
    lmg_field_destroy(field);
}

/* Every single point, on and off the slabs' axes, of a sphere baked with rays traced backwards as well, since photons alone leave 1.3 % of noise in a
 * point: within 3 standard errors, and within 1 % where noise leaves room for that, which is nearly everywhere. */
static void test_sphere_points(void **state)
{
    (void)state;
    lmg_field *field = bake_sphere("sphere_points", 1);
    int points = 0, quiet = 0;
    for (int i = 0; i < 5; ++i)
        for (int k = 0; k < DIRECTIONS; ++k, ++points) {
            double error;
            const double off = sphere_ratio(field, SPHERE_DISTANCES[i], k, &error) - 1;
            if (fabs(off) > 0.007 || error > 0.01 / 3)
                print_message("sphere, %g m, direction %d: %+.2f %% +- %.2f %%\n", SPHERE_DISTANCES[i], k, 100 * off, 100 * error);
            assert_true(error > 0);
            assert_true(fabs(off) < 3 * error);
            quiet += error <= 0.01 / 3;
        }
    print_message("sphere: %d of %d points have a standard error of at most a third of 1 %%\n", quiet, points);
    assert_true(3 * quiet >= 2 * points); /* 88 of 120 are */
    lmg_field_destroy(field);
}

static void test_paraboloid_spot(void **state)
{
    (void)state;
    char path[1024];
    snprintf(path, sizeof(path), "%s/models/paraboloid-spot/paraboloid-spot.gltf", LUMIBOX_BINARY_DIR);
    lmg_field *field = bake_file(path, "spot", 30000000, 0, 0);
    const double a = SPOT_SOURCE_RADIUS, luminance = SPOT_FLUX / (4 * PI * PI * a * a);
    const double expected =
        SPOT_REFLECTANCE * luminance * PI * (SPOT_RIM_RADIUS * SPOT_RIM_RADIUS - a * a) + luminance * PI * a * a;
    double rgb[3], error;
    lmg_error err = {{0}};
    assert_int_equal(lmg_field_intensity(field, (lmg_vec3){0, -1, 0}, rgb, &error, &err), LMG_OK);
    const double i = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
    print_message("spot: axial intensity %.5g cd +- %.2g, closed form %.5g: %+.2f %%\n", i, error, expected,
                  100 * (i / expected - 1));
    assert_true(fabs(i - expected) < 0.02 * expected);

    const double h = SPOT_APEX - SPOT_FOCAL_LENGTH, direct = (1 - h / hypot(h, SPOT_RIM_RADIUS)) / 2;
    const double efficiency = direct + SPOT_REFLECTANCE * (1 - direct - a * a / (4 * SPOT_FOCAL_LENGTH * SPOT_FOCAL_LENGTH));
    const lmg_ledger l = lmg_field_ledger(field);
    print_message("spot: efficiency %.5f, closed form %.5f\n", (l.stored + l.residual) / l.emitted, efficiency);
    /* the mirror's edge is a polygon of 160 corners and the formula is of first order in (a/f)^2 = 0.01: 1e-3 covers both */
    assert_true(fabs((l.stored + l.residual) / l.emitted - efficiency) < 1e-3);
    lmg_field_destroy(field);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_disc), cmocka_unit_test(test_square), cmocka_unit_test(test_sphere),
                                       cmocka_unit_test(test_sphere_points),
                                       cmocka_unit_test(test_paraboloid_spot)};
    return cmocka_run_group_tests_name("bake_closed_forms", tests, NULL, NULL);
}
