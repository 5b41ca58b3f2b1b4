/* SPDX-License-Identifier: Apache-2.0 */
/* The sample lamps and the room, as make_models writes them and the loader reads them, against the measures in dimensions.h. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <luminaires/medium.h>
#include <luminaires/model.h>
#include <luminaires/scatter.h>

#include "dimensions.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

static const char *const NAMES[] = {"paraboloid-spot", "opal-globe", "louvred-panel", "glass-lens", "opal-ball", "edge-lit-panel",
#ifdef LUMIBOX_OPENVDB
                                    "smoke-lamp",
#endif
                                    "room"};
static const double FLUX[] = {SPOT_FLUX, GLOBE_FLUX, LOUVRE_FLUX, LENS_FLUX, BALL_FLUX, PANEL_FLUX, SMOKE_FLUX};
enum { MODELS = sizeof(NAMES) / sizeof(NAMES[0]), LAMPS = MODELS - 1 };

static lum_model *load(const char *name)
{
    char path[1024];
    snprintf(path, sizeof path, "%s/models/%s/%s.recipe.json", LUMIBOX_BINARY_DIR, name, name);
    lmg_error err = {""};
    lum_recipe *recipe = NULL;
    FILE *there = fopen(path, "rb");
    if (there) {
        fclose(there);
        if (lum_recipe_read(path, &recipe, &err) != LMG_OK)
            fail_msg("%s", err.message);
    }
    snprintf(path, sizeof path, "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, name, name);
    lum_model *model = NULL;
    if (lum_model_load(path, recipe, &model, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lum_recipe_destroy(recipe);
    return model;
}

static const lum_part *find_part(const lum_model *model, const char *node)
{
    for (uint32_t i = 0; i < model->part_count; ++i)
        if (!strcmp(model->parts[i].node, node))
            return &model->parts[i];
    fail_msg("%s: no part \"%s\"", model->path, node);
    return NULL;
}

/* A vertex in the file's frame. */
static void vertex(const lum_model *model, uint32_t index, double out[3])
{
    const double centre[3] = {model->centre.x, model->centre.y, model->centre.z};
    for (int k = 0; k < 3; ++k)
        out[k] = model->unit * (double)model->positions[3 * (size_t)index + (size_t)k] + centre[k];
}

/* How far a coordinate may be off the generator's: it was rounded to float in the file and again relative to the centre, half a unit in
 * the last place of at most the model's extent (all are within their extent of the origin) each time. */
static double rounding(const lum_model *model)
{
    const lmg_vec3 lo = model->bounds_min, hi = model->bounds_max;
    return fmax(hi.x - lo.x, fmax(hi.y - lo.y, hi.z - lo.z)) * (double)FLT_EPSILON;
}

static double length3(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* Rated flux, up to the rounding of vertices: moving each corner of a triangle by d changes its area by at most d/2 times the circumference. */
static void test_lamps_emit_their_rated_flux(void **state)
{
    (void)state;
    for (int i = 0; i < LAMPS; ++i) {
        lum_model *model = load(NAMES[i]);
        lum_emitters *emitters = NULL;
        lmg_error err = {""};
        if (lum_emitters_create(model, &emitters, &err) != LMG_OK)
            fail_msg("%s", err.message);
        const double flux = lum_emitters_flux(emitters, NULL), moved = sqrt(3.0) * rounding(model);
        double area = 0, slack = 0;
        for (uint32_t t = 0; t < model->triangle_count; ++t) {
            const float *e = model->materials[model->triangle_material[t]].emissive;
            if (e[0] <= 0 && e[1] <= 0 && e[2] <= 0)
                continue;
            double p[3][3], edge[3][3];
            for (int c = 0; c < 3; ++c)
                vertex(model, model->indices[3 * t + (uint32_t)c], p[c]);
            for (int c = 0; c < 3; ++c)
                for (int k = 0; k < 3; ++k)
                    edge[c][k] = p[(c + 1) % 3][k] - p[c][k];
            const double n[3] = {edge[0][1] * edge[1][2] - edge[0][2] * edge[1][1], edge[0][2] * edge[1][0] - edge[0][0] * edge[1][2],
                                 edge[0][0] * edge[1][1] - edge[0][1] * edge[1][0]};
            area += 0.5 * length3(n);
            slack += 0.5 * moved * (length3(edge[0]) + length3(edge[1]) + length3(edge[2]));
        }
        /* The luminance passed through a few float operations. */
        const double bound = slack / area + 8 * (double)FLT_EPSILON;
        print_message("%s: %.5f lm, rated %.0f lm, off by %.1e of %.1e allowed\n", NAMES[i], flux, FLUX[i], flux / FLUX[i] - 1, bound);
        assert_true(bound < 1e-3); /* else the test would say nothing */
        assert_true(fabs(flux / FLUX[i] - 1) <= bound);
        lum_emitters_destroy(emitters);
        lum_model_destroy(model);
    }
}

/* Of the room it says that nothing shines in it, which is so. */
static void test_loader_finds_nothing_to_warn_about(void **state)
{
    (void)state;
    for (int i = 0; i < MODELS; ++i) {
        lum_model *model = load(NAMES[i]);
        for (uint32_t w = 0; w < model->warning_count; ++w)
            print_message("%s: %s\n", NAMES[i], model->warnings[w]);
        assert_int_equal(model->warning_count, i < LAMPS ? 0 : 1);
        lum_model_destroy(model);
    }
}

/* Every triangle faces the side that its vertex normals point to. */
static void test_windings_agree_with_normals(void **state)
{
    (void)state;
    for (int i = 0; i < MODELS; ++i) {
        lum_model *model = load(NAMES[i]);
        uint32_t wrong = 0;
        for (uint32_t t = 0; t < model->triangle_count; ++t) {
            double p[3][3], along = 0;
            for (int c = 0; c < 3; ++c)
                vertex(model, model->indices[3 * t + (uint32_t)c], p[c]);
            for (int k = 0; k < 3; ++k) {
                const int a = (k + 1) % 3, b = (k + 2) % 3;
                const double n = (p[1][a] - p[0][a]) * (p[2][b] - p[0][b]) - (p[1][b] - p[0][b]) * (p[2][a] - p[0][a]);
                for (int c = 0; c < 3; ++c)
                    along += n * (double)model->normals[3 * (size_t)model->indices[3 * t + (uint32_t)c] + (size_t)k];
            }
            wrong += along <= 0;
        }
        assert_int_equal(wrong, 0);
        lum_model_destroy(model);
    }
}

static void test_spot_mirror_is_the_paraboloid(void **state)
{
    (void)state;
    lum_model *model = load("paraboloid-spot");
    const lum_part *mirror = find_part(model, "Reflector");
    const double eps = rounding(model), f = SPOT_FOCAL_LENGTH;
    assert_true(mirror->has_normals);
    for (uint32_t i = 3 * mirror->first_triangle; i < 3 * (mirror->first_triangle + mirror->triangle_count); ++i) {
        double p[3];
        vertex(model, model->indices[i], p);
        const double r = hypot(p[0], p[2]);
        /* y(r) = apex - r^2/4f has the slope r/2f: an error e of all coordinates shows as up to e (1 + sqrt(2) r/2f). */
        assert_true(fabs(SPOT_APEX - r * r / (4 * f) - p[1]) <= eps * (1 + sqrt(2.0) * r / (2 * f)));
        /* Inward normal: -(x, 2f, z) / |..|.  Its error: that of x and z over the normal's length 2f or more, and float rounding. */
        const double n[3] = {-p[0], -2 * f, -p[2]}, length = length3(n);
        for (int k = 0; k < 3; ++k)
            assert_true(fabs(n[k] / length - (double)model->normals[3 * (size_t)model->indices[i] + (size_t)k]) <=
                        2 * eps / (2 * f) + 2 * (double)FLT_EPSILON);
    }
    lum_model_destroy(model);
}

/* Mean projected area of a convex body is a quarter of its surface (Cauchy): so the source's mesh stands for the sphere. */
static void test_spot_source_has_the_spheres_area(void **state)
{
    (void)state;
    lum_model *model = load("paraboloid-spot");
    const lum_part *source = find_part(model, "Source");
    const double area = 4 * PI * SPOT_SOURCE_RADIUS * SPOT_SOURCE_RADIUS;
    /* Relative error of the radius, twice: area goes with its square. */
    assert_true(fabs(source->area / area - 1) <= 2 * sqrt(3.0) * rounding(model) / SPOT_SOURCE_RADIUS);
    assert_int_equal(source->boundary_edges, 0);
    assert_true(source->enclosed_volume > 0);
    lum_model_destroy(model);
}

static void test_lens_is_closed_and_hyperbolic(void **state)
{
    (void)state;
    lum_model *model = load("glass-lens");
    const lum_part *lens = find_part(model, "Lens");
    assert_int_equal(lens->boundary_edges, 0);
    assert_true(lens->enclosed_volume > 0);
    const lum_material *glass = &model->materials[lens->material];
    assert_false(glass->thin);
    assert_true(glass->transmission == 1 && fabs((double)glass->ior - LENS_IOR) <= (double)FLT_EPSILON * LENS_IOR);

    /* On the curved face light from the focus has the same optical length to any plane in the glass: rho - n z = const. */
    const double n = LENS_IOR, q = (n - 1) * LENS_FOCAL_LENGTH, n2 = n * n - 1;
    const double sag = (sqrt(q * q + n2 * LENS_RADIUS * LENS_RADIUS) - q) / n2, focus = LENS_FLAT_FACE + LENS_RIM + sag + LENS_FOCAL_LENGTH;
    uint32_t curved = 0;
    for (uint32_t i = 3 * lens->first_triangle; i < 3 * (lens->first_triangle + lens->triangle_count); ++i) {
        double p[3];
        vertex(model, model->indices[i], p);
        if (p[1] < LENS_FLAT_FACE + LENS_RIM - rounding(model))
            continue;
        const double z = focus - p[1], rho = sqrt(p[0] * p[0] + p[2] * p[2] + z * z);
        assert_true(fabs(n * z - rho - (n - 1) * LENS_FOCAL_LENGTH) <= (n + sqrt(3.0)) * rounding(model));
        ++curved;
    }
    assert_true(curved > 3 * 20000);
    lum_model_destroy(model);
}

static void test_light_guides_and_shells_are_closed(void **state)
{
    (void)state;
    lum_model *model = load("opal-ball");
    const lum_part *shell = find_part(model, "Shell");
    const double inner = BALL_RADIUS - BALL_WALL, volume = 4 * PI / 3 * (BALL_RADIUS * BALL_RADIUS * BALL_RADIUS - inner * inner * inner);
    const lum_material *opal = &model->materials[shell->material];
    assert_int_equal(shell->boundary_edges, 0);
    /* 64 bands by 128 segments: a tessellated sphere lacks (pi/64)^2 / 4 + (2 pi/128)^2 / 6, together below 1.1e-3, of its volume */
    assert_true(fabs(shell->enclosed_volume / volume - 1) < 2e-3);
    assert_true(opal->scattering[0] == 2000 && opal->absorption[1] == 0.5f && opal->anisotropy == 0.8f && !opal->thin);
    lum_model_destroy(model);

    model = load("edge-lit-panel");
    const lum_part *guide = find_part(model, "Light guide");
    assert_int_equal(guide->boundary_edges, 0);
    assert_true(guide->enclosed_volume > 0.95 * PANEL_SIDE * PANEL_SIDE * PANEL_THICKNESS);
    assert_true(guide->enclosed_volume < PANEL_SIDE * PANEL_SIDE * PANEL_THICKNESS);
    assert_true(fabs((double)model->materials[guide->material].ior - PANEL_IOR) <= (double)FLT_EPSILON * PANEL_IOR);
    lum_model_destroy(model);
}

/* Optical depth from the middle outwards: sigma w sqrt(pi/2), less the tail beyond 3 widths (0.27 %); linear interpolation of the
 * Gaussian is off by h^2/12 of its second derivative, whose integral from the middle on vanishes along the axes and is below
 * (h/w)^2/4 = 1e-3 in any direction. */
static void test_smoke_has_its_depth(void **state)
{
    (void)state;
#ifdef LUMIBOX_OPENVDB
    lum_model *model = load("smoke-lamp");
    lum_volumes *volumes = NULL;
    assert_int_equal(model->volume_count, 1);
    assert_int_equal(lum_volumes_create(model, &volumes, NULL), LMG_OK);
    const double expected = 8 * SMOKE_WIDTH * sqrt(PI / 2) * erf(3 / sqrt(2.0)), reach = SMOKE_VOXEL * (SMOKE_REACH + 1);
    const lmg_vec3 c = model->centre, middle = {-c.x, -c.y, -c.z}, ways[3] = {{0, -1, 0}, {0.6, 0.8, 0}, {0.48, -0.6, 0.64}};
    for (int i = 0; i < 3; ++i) {
        double depth[3];
        lum_volumes_depth(volumes, middle, ways[i], i ? 3 * SMOKE_WIDTH : 1, depth);
        print_message("smoke: depth %.5f (%.5f)\n", depth[0], expected);
        assert_true(fabs(depth[0] / expected - 1) < 2e-3);
    }
    assert_true(fabs(model->bounds_max.y + c.y - reach) < 1e-6 && fabs(model->bounds_min.x + c.x + reach) < 1e-6);
    lum_volumes_destroy(volumes);
    lum_model_destroy(model);
#else
    print_message("test_smoke_has_its_depth: skipped, built without OpenVDB\n");
    skip();
#endif
}

static void test_room_has_its_size_a_camera_and_space_for_a_lamp(void **state)
{
    (void)state;
    lum_model *model = load("room");
    const double eps = rounding(model);
    const lmg_vec3 lo = model->bounds_min, hi = model->bounds_max;
    assert_true(fabs(hi.x - lo.x - ROOM_LENGTH) <= 2 * eps && fabs(hi.y - lo.y - ROOM_HEIGHT) <= 2 * eps && fabs(hi.z - lo.z - ROOM_WIDTH) <= 2 * eps);
    assert_true(fabs(model->centre.y + lo.y) <= eps);
    assert_int_equal(model->camera_count, 1);
    assert_string_equal(model->cameras[0].name, "default");
    assert_int_equal(model->light_count, 0);
    for (uint32_t i = 0; i < model->material_count; ++i)
        for (int c = 0; c < 3; ++c)
            assert_true(model->materials[i].emissive[c] == 0);
    /* The largest lamp, 0.6 m square, hangs free: nothing in its column from a hand over the table up to the ceiling. */
    for (uint32_t i = 0; i < model->vertex_count; ++i) {
        double p[3];
        vertex(model, i, p);
        assert_false(fabs(p[0]) < LOUVRE_OUTER / 2 && fabs(p[2]) < LOUVRE_OUTER / 2 && p[1] > 1.0 && p[1] < ROOM_HEIGHT - eps);
    }
    lum_model_destroy(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_lamps_emit_their_rated_flux),
        cmocka_unit_test(test_loader_finds_nothing_to_warn_about),
        cmocka_unit_test(test_windings_agree_with_normals),
        cmocka_unit_test(test_spot_mirror_is_the_paraboloid),
        cmocka_unit_test(test_spot_source_has_the_spheres_area),
        cmocka_unit_test(test_lens_is_closed_and_hyperbolic),
        cmocka_unit_test(test_light_guides_and_shells_are_closed),
        cmocka_unit_test(test_smoke_has_its_depth),
        cmocka_unit_test(test_room_has_its_size_a_camera_and_space_for_a_lamp),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
