/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Lamps by their geometry against their bakes: mean illuminance of small planes, by paths followed into the lamp, and by the
 * box, whose photons were followed the other way with code of the baker.  One lamp for each thing that happens on the way: a medium
 * inside glass, smoke on a grid, a phosphor, and glass that refracts by wavelength.
 *
 * Statistics: null hypothesis: equal expectations.  Luminance is rejected beyond 4 joint standard errors, of the paths and of the
 * cells (meter.h; a chance of 6e-5 each).  Of R, G and B a box states no error; their relative error is taken as twice that of
 * luminance. NOTICEABLE must be found by the same test.
 */
#include "bake.h"
#include "convert.h"
#include "gltf_writer.h"
#include "meter.h"
#include "receiver.h"
#include "room_fixture.h"

#include <luminaires/rayfile.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define GREEN_LED LUMIBOX_SHARED_DATA "/rayfiles/rayfile_LERTDUW_S2WP_green_100k_20161013_IES_TM25.TM25RAY"

static const double REJECT = 4;
static const double NOTICEABLE = 0.12;

/* A room that neither lights nor reflects anything. */
static view_scene *nothing(void)
{
    const room_rectangle far = {.corner = {50, 50, 50}, .e1 = {1, 0, 0}, .e2 = {0, 1, 0}};
    return scene_of(&far, 1);
}

static void demand(lmg_result r, const lmg_error *err)
{
    if (r != LMG_OK) {
        fail_msg("%s", err->message);
    }
}

/* A rectangle that is measured: corner, sides, facing side1 x side2; metres, the lamp stands at the origin. */
typedef struct plane {
    lmg_vec3 corner, side1, side2;
} plane;

typedef struct result {
    double rgb[4], se[4]; /* R,G,B, luminance; lx */
    double bake;          /* standard error of luminance */
} result;

/* Mean illuminance of a plane: a meter at a random point for each path. */
static result measure_plane(const view_scene *scene, const plane *where, uint64_t paths, uint64_t seed)
{
    result r = {.bake = 0};
    double weights[4], squares[4] = {0}, half[2][VIEW_BAKES] = {{0}};
    view_worker worker = {.weights = weights};
    const view_path_options options = {.max_depth = UINT32_MAX};
    assert_true(scene->light_count <= 2);
    lmg_vec3 normal = view_unit(view_cross(where->side1, where->side2));
    for (uint64_t i = 0; i < paths; i++) {
        lum_rng rng = lum_rng_stream(seed, i);
        double a = lum_rng_next(&rng), b = lum_rng_next(&rng), e[4];
        lmg_vec3 at = view_add(where->corner, view_add(view_scale(where->side1, a), view_scale(where->side2, b)));
        worker.deviation = half[i % 2];
        view_path_illuminance(scene, &options, view_sub(at, scene->origin), normal, &rng, &worker, e);
        e[3] = 0.2126 * e[0] + 0.7152 * e[1] + 0.0722 * e[2];
        for (int c = 0; c < 4; c++) {
            r.rgb[c] += e[c] / (double)paths;
            squares[c] += e[c] * e[c] / (double)paths;
        }
    }
    assert_true(worker.refused == 0);
    for (int c = 0; c < 4; c++) {
        r.se[c] = sqrt(fmax(squares[c] - r.rgb[c] * r.rgb[c], 0) / (double)paths);
    }
    r.bake = view_bake_error(half[0], half[1]) * VIEW_PI / (double)(paths / 2);
    return r;
}

static void compare(const char *lamp, const char *entry, uint64_t photons, uint64_t paths, const plane *planes, size_t count)
{
    char path[1024], recipe_path[1024];
    lmg_error err = {""};
    lum_recipe *recipe = NULL;
    lum_model *model = NULL;
    lmg_field *field = NULL;
    snprintf(path, sizeof path, LUMIBOX_BINARY_DIR "/models/%s/%s.gltf", lamp, lamp);
    snprintf(recipe_path, sizeof recipe_path, LUMIBOX_BINARY_DIR "/models/%s/%s.recipe.json", lamp, lamp);
    if (access(path, R_OK) != 0) {
        print_message("SKIPPED: %s isn't there (smoke needs OpenVDB)\n", path);
        skip();
    }
    demand(access(recipe_path, R_OK) == 0 ? lum_recipe_read(recipe_path, &recipe, &err) : lum_recipe_create(&recipe, &err), &err);
    if (entry) {
        demand(lum_recipe_add(recipe, entry, &err), &err);
    }
    demand(lum_model_load(path, recipe, &model, &err), &err);
    bake_options options = {
        .photons = photons, .seed = 3, .effects_chosen = true, .effects = UINT32_MAX, .fit = {.struct_size = sizeof options.fit}};
    bake_report report;
    demand(bake_run(model, &options, &field, &report, &err), &err);

    view_scene *built = nothing(), *boxed = nothing();
    const view_placement origin = {.ry = 0};
    demand(view_scene_add_lamp(built, path, recipe, &origin, 0, &err), &err);
    demand(view_scene_adopt_box(boxed, field, &origin, 0, &err), &err);
    demand(view_scene_finish(built, &err), &err);
    demand(view_scene_finish(boxed, &err), &err);
    for (size_t i = 0; i < count; i++) {
        result box = measure_plane(boxed, &planes[i], 200000, 7 + i), geometry = measure_plane(built, &planes[i], paths, 11 + i);
        double off[4], se[4];
        for (int c = 0; c < 4; c++) {
            double bake = (c < 3 ? 2 : 1) * box.bake * fabs(box.rgb[c]) / box.rgb[3];
            off[c] = geometry.rgb[c] - box.rgb[c];
            se[c] = sqrt(geometry.se[c] * geometry.se[c] + box.se[c] * box.se[c] + bake * bake);
        }
        print_message("%-12s %zu: box %.5g lx, geometry %+.2f %% +- %.2f (bake) +- %.2f (paths) +- %.2f (box's); R,G,B %.4g %.4g "
                      "%.4g, %+.1f %+.1f "
                      "%+.1f se\n",
                      lamp, i, box.rgb[3], 100 * off[3] / box.rgb[3], 100 * box.bake / box.rgb[3],
                      100 * geometry.se[3] / box.rgb[3], 100 * box.se[3] / box.rgb[3], box.rgb[0], box.rgb[1], box.rgb[2],
                      off[0] / se[0], off[1] / se[1], off[2] / se[2]);
        for (int c = 0; c < 4; c++) {
            assert_true(fabs(off[c]) <= REJECT * se[c]);
        }
        assert_true(REJECT * se[3] < NOTICEABLE * box.rgb[3]);
    }
    view_scene_destroy(built);
    view_scene_destroy(boxed);
    lum_model_destroy(model);
    lum_recipe_destroy(recipe);
}

static void opal_glass(void **state)
{
    (void)state;
    static const plane P[] = {{{-0.1, -0.1, -0.1}, {0, 0, 0.2}, {0.2, 0, 0}}};
    compare("opal-ball", NULL, 200000, 300000, P, 1);
}

static void smoke(void **state)
{
    (void)state;
    static const plane P[] = {{{-0.4, -0.3, -0.4}, {0, 0, 0.8}, {0.8, 0, 0}}};
    compare("smoke-lamp", NULL, 1000000, 800000, P, 1);
}

static void phosphor(void **state)
{
    (void)state;
    static const plane P[] = {{{-0.005, -0.004, -0.005}, {0, 0, 0.01}, {0.01, 0, 0}}};
    compare("phosphor-led", NULL, 200000, 100000, P, 1);
}

/* In the middle of the beam, and where its edge falls, whose colours differ by the dispersion of the lens. */
static void dispersion(void **state)
{
    (void)state;
    static const plane P[] = {{{-0.01, -0.05, -0.01}, {0, 0, 0.02}, {0.02, 0, 0}},
                              {{0.005, -0.04, -0.002}, {0, 0, 0.004}, {0.002, 0, 0}}};
    compare("glass-lens", "glass:Glass=N-SF11", 1500000, 400000, P, 2);
}

/*
 * A measured ray file, made a box and rendered from at 1 mm: light on a square of 1 mm beside the LED, where it is brightest, against the
 * rays that cross it.  The box blurs what lies within its cells of 0.3 mm; the mean over the square loses little by it.
 */
static void measured_rays_at_1_mm(void **state)
{
    (void)state;
    static const double PART_OF_BLUR = 0.03;
    lmg_error err = {""};
    lum_rayfile *file;
    bake_source *rays;
    bake_conversion report;
    lmg_field *field;
    if (access(GREEN_LED, R_OK) != 0) {
        print_message("SKIPPED: %s isn't there\n", GREEN_LED);
        skip();
    }
    demand(lum_rayfile_open(GREEN_LED, LUM_RAY_LIGHT, &file, &err), &err);
    demand(bake_rayfile_source_create(file, 1, 0, &rays, &err), &err);
    demand(bake_convert_to_field(rays, &(bake_convert_options){.rays = 0}, &field, &report, &err), &err);

    const double z = rays->bounds_max.z + 1e-3;
    const lmg_vec3 middle = {-0.68e-3, 0.84e-3, z};
    const bake_rectangle square = {.centre = middle, .a = {1, 0, 0}, .b = {0, 1, 0}, .width = 1e-3, .height = 1e-3, .nx = 1, .ny = 1};
    bake_receiver *receiver;
    bake_tally tally = {0};
    demand(bake_illuminance_create(&square, &receiver, &err), &err);
    const lmg_sink sink = bake_receiver_sink(receiver);
    demand(rays->run(rays, 0, rays->photons, 0, &sink, 1, &tally, &err), &err);
    double se;
    const double expected = bake_receiver_reading(receiver, 0, rays->flux / (double)rays->photons, &se);

    view_scene *scene = nothing();
    demand(view_scene_adopt_box(scene, field, &(view_placement){.ry = 0}, 0, &err), &err);
    demand(view_scene_finish(scene, &err), &err);
    const plane facing = {{middle.x - 0.5e-3, middle.y - 0.5e-3, z}, {0, 1e-3, 0}, {1e-3, 0, 0}};
    const result seen = measure_plane(scene, &facing, 200000, 5);
    print_message("LED at 1 mm: rays %.4g lx +- %.2f %%, rendered %+.2f %% +- %.2f %%\n", expected, 100 * se / expected,
                  100 * (seen.rgb[3] / expected - 1), 100 * seen.se[3] / expected);
    /* the box is of these rays: their own noise is in both */
    assert_true(fabs(seen.rgb[3] - expected) < REJECT * seen.se[3] + PART_OF_BLUR * expected);
    assert_true(se < 0.03 * expected && seen.se[3] < 0.01 * expected);
    view_scene_destroy(scene);
    bake_receiver_destroy(receiver);
    rays->destroy(rays);
    lum_rayfile_close(file);
}

/* Geometry filled with phosphor isn't followed, and said so. */
static void filled_with_phosphor_is_refused(void **state)
{
    (void)state;
    static const char RECIPE[] = "{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"phosphor\":{\"absorption\":{\"gaussian\":[450,30]},"
                                 "\"emission\":{\"gaussian\":[570,60]},\"quantum_yield\":1}}}]}";
    lmg_error err = {""};
    lum_recipe *recipe = NULL;
    FILE *file = fopen("viewer_lamps.recipe.json", "w");
    assert_non_null(file);
    assert_true(fputs(RECIPE, file) >= 0 && fclose(file) == 0);
    demand(lum_recipe_read("viewer_lamps.recipe.json", &recipe, &err), &err);
    remove("viewer_lamps.recipe.json");
    view_scene *scene = nothing();
    const view_placement origin = {.ry = 0};
    assert_int_equal(view_scene_add_lamp(scene, LUMIBOX_BINARY_DIR "/models/glass-lens/glass-lens.gltf", recipe, &origin, 0, &err),
                     LMG_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.message, "\"Glass\" is filled with phosphor"));
    view_scene_destroy(scene);
    lum_recipe_destroy(recipe);
}

/* A wall of half a metre, a millimetre in front of a light of a tenth, hides it from a meter a metre away, wherever the lamp is: at the
 * room's origin and a kilometre off, where a few millionths of the world's coordinates are millimetres. */
static void walls_hide_lights_far_from_the_room(void **state)
{
    (void)state;
    float corners[2][6][3];
    for (int q = 0; q < 2; q++) {
        static const float SIGN[6][2] = {{-1, -1}, {1, -1}, {1, 1}, {-1, -1}, {1, 1}, {-1, 1}};
        for (int k = 0; k < 6; k++) {
            const float half = q == 0 ? 0.05F : 0.25F;
            corners[q][k][0] = half * SIGN[k][0];
            corners[q][k][1] = q == 0 ? 0 : -0.001F;
            corners[q][k][2] = half * SIGN[k][1];
        }
    }
    gltf_folder("viewer_lamps");
    char *data = gltf_data_uri(corners, sizeof corners);
    char *json = gltf_text(
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_emissive_strength\"],\"scene\":0,"
        "\"scenes\":[{\"nodes\":[0,1]}],\"nodes\":[{\"mesh\":0},{\"mesh\":1}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"material\":0}]},"
        "{\"primitives\":[{\"attributes\":{\"POSITION\":1},\"material\":1}]}],"
        "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0,0,0,1],\"metallicFactor\":1},\"emissiveFactor\":[1,1,1],"
        "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":1000}}},"
        "{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0,0,0,1],\"metallicFactor\":1},\"doubleSided\":true}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\",\"min\":[-0.05,0,-0.05],"
        "\"max\":[0.05,0,0.05]},{\"bufferView\":1,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\","
        "\"min\":[-0.25,-0.001,-0.25],\"max\":[0.25,-0.001,0.25]}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":72},{\"buffer\":0,\"byteOffset\":72,\"byteLength\":72}],"
        "\"buffers\":[{\"byteLength\":144,\"uri\":\"%s\"}]}",
        data);
    gltf_write("hidden.gltf", json, strlen(json));
    free(json);
    free(data);
    for (int far = 0; far < 2; far++) {
        const double height = far ? 1000 : 0, lambertian = 3141.6; /* lx, before an endless light of 1000 cd/m2 */
        lmg_error err = {""};
        view_scene *scene = nothing();
        demand(view_scene_add_lamp(scene, gltf_path("hidden.gltf"), NULL, &(view_placement){.position = {0, height, 0}}, 0, &err), &err);
        demand(view_scene_finish(scene, &err), &err);
        const plane below = {{-0.01, height - 1, -0.01}, {0, 0, 0.02}, {0.02, 0, 0}},
                    between = {{-0.01, height - 0.0005, -0.01}, {0, 0, 0.02}, {0.02, 0, 0}};
        const double hidden = measure_plane(scene, &below, 2000, 3).rgb[3], seen = measure_plane(scene, &between, 2000, 3).rgb[3];
        print_message("behind a wall, %g m up: %g lx; before it %g\n", height, hidden, seen);
        assert_true(seen > 0.9 * lambertian && seen < 1.01 * lambertian);
        assert_true(hidden == 0);
        view_scene_destroy(scene);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(walls_hide_lights_far_from_the_room),
        cmocka_unit_test(opal_glass),
        cmocka_unit_test(smoke),
        cmocka_unit_test(phosphor),
        cmocka_unit_test(dispersion),
        cmocka_unit_test(measured_rays_at_1_mm),
        cmocka_unit_test(filled_with_phosphor_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
