/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Media in recipes: what reaches the model, and one clear line for everything that can't be: coefficients, places, OpenVDB files
 * and grids, materials that light doesn't get into.
 */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include "gltf_writer.h"
#include "vdb_shim.h"

#include <luminaires/medium.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A triangle of glass "Pane" (material "Glass", a solid's boundary) and a light. */
static char *document(void)
{
    const float corners[9] = {0, 0, 0, 2, 0, 0, 0, 4, 0};
    char *uri = gltf_data_uri(corners, sizeof(corners));
    char *text = gltf_text(
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"Pane\",\"mesh\":0}],"
        "\"meshes\":[{\"name\":\"Pane\",\"primitives\":[{\"attributes\":{\"POSITION\":0},\"material\":0}]}],"
        "\"materials\":[{\"name\":\"Glass\",\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1},"
        "\"KHR_materials_volume\":{\"thicknessFactor\":0.01}}}],"
        "\"extensionsUsed\":[\"KHR_materials_transmission\",\"KHR_materials_volume\"],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[2,4,0]}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,\"uri\":\"%s\"}]}",
        uri);
    free(uri);
    return text;
}

static lum_recipe *recipe(const char *json)
{
    lum_recipe *r;
    lmg_error err = {{0}};
    gltf_write("media.recipe.json", json, strlen(json));
    if (lum_recipe_read(gltf_path("media.recipe.json"), &r, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return r;
}

static void media_reach_the_model(void **state)
{
    (void)state;
    char *text = document();
    lum_recipe *r = recipe("{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"extinction\":[100,200,400],\"albedo\":[0.5,0.75,1],"
                           "\"anisotropy\":-0.25}}],\"scale\":0.001,"
                           "\"volumes\":[{\"name\":\"haze\",\"box\":{\"min\":[-10,-20,-30],\"max\":[30,20,10],\"comment\":\"mm\"},"
                           "\"scattering\":0.5,\"absorption\":[0,1,2],\"density_scale\":4,\"translation\":[0,0,100],"
                           "\"rotation\":[0,0,0.70710678,0.70710678],\"scale\":[2,1,1]}]}");
    lum_model *model = gltf_load("media.gltf", text, r);
    const lum_material *m = &model->materials[model->parts[0].material];
    const float scattering[3] = {50, 150, 400}, absorption[3] = {50, 50, 0};
    for (int c = 0; c < 3; ++c)
        assert_true(m->scattering[c] == scattering[c] && m->absorption[c] == absorption[c]);
    assert_true(m->anisotropy == -0.25f);
    assert_int_equal(model->volume_count, 1);
    const lum_volume *v = &model->volumes[0];
    assert_string_equal(v->name, "haze");
    assert_true(v->scattering[2] == 2 && v->absorption[0] == 0 && v->absorption[1] == 4 && v->absorption[2] == 8);
    /* Stretched by 2 along x: -20..60; turned by 90 degrees, x to y and y to -x; moved along z; millimetres. */
    const lmg_vec3 c = model->centre;
    const double low[3] = {-0.020, -0.020, 0.070}, high[3] = {0.020, 0.060, 0.110};
    const double lo[3] = {v->bounds_min.x + c.x, v->bounds_min.y + c.y, v->bounds_min.z + c.z};
    const double hi[3] = {v->bounds_max.x + c.x, v->bounds_max.y + c.y, v->bounds_max.z + c.z};
    for (int a = 0; a < 3; ++a)
        assert_true(fabs(lo[a] - low[a]) < 1e-9 && fabs(hi[a] - high[a]) < 1e-9);
    assert_true(model->bounds_max.z + c.z > 0.11 - 1e-9 && model->bounds_max.x + c.x > 0.02 - 1e-9);
    lum_volumes *volumes;
    double depth[3];
    assert_int_equal(lum_volumes_create(model, &volumes, NULL), LMG_OK);
    lum_volumes_depth(volumes, (lmg_vec3){0.01 - c.x, -1 - c.y, 0.1 - c.z}, (lmg_vec3){0, 1, 0}, 10, depth);
    assert_true(fabs(depth[0] - 2 * 0.08) < 1e-9 && fabs(depth[1] - 6 * 0.08) < 1e-9 && fabs(depth[2] - 10 * 0.08) < 1e-9);
    lum_volumes_destroy(volumes);
    lum_model_destroy(model);
    lum_recipe_destroy(r);
    free(text);
}

/* Coefficients by wavelength, and phosphor among them: the model has spectra of its own, R,G,B their values at 610, 550 and 465 nm. */
static void media_by_wavelength_reach_the_model(void **state)
{
    (void)state;
    char *text = document();
    lum_recipe *r = recipe("{\"entries\":[{\"match\":\"Glass\",\"medium\":{"
                           "\"extinction\":{\"nm\":[360,830],\"values\":[940,470]},\"albedo\":[0.5,0.5,0.5],"
                           "\"phosphor\":{\"absorption\":{\"gaussian\":[450,30],\"height\":800},\"emission\":{\"gaussian\":[570,60]},"
                           "\"quantum_yield\":0.75}}}]}");
    lum_model *model = gltf_load("media.gltf", text, r);
    lum_recipe_destroy(r);
    const lum_material *m = &model->materials[model->parts[0].material];
    const lum_spectral *s = &m->spectral;
    assert_true(s->fills && s->quantum_yield == 0.75f && s->scattering && s->absorption && s->excitation && s->converted);
    static const double NM[4] = {610, 550, 465, 700};
    for (int i = 0; i < 4; ++i) {
        const double half = 0.5 * (940 - (NM[i] - 360));
        assert_true(fabs(lum_spectrum_at(s->scattering, NM[i]) - half) < 1e-3 && fabs(lum_spectrum_at(s->absorption, NM[i]) - half) < 1e-3);
        if (i < 3)
            assert_true(fabs((double)m->scattering[i] - half) < 1e-3 && fabs((double)m->absorption[i] - half) < 1e-3);
    }
    assert_true(fabs(lum_spectrum_at(s->excitation, 450) - 800) < 1e-3 && lum_spectrum_at(s->excitation, 465) < 500);
    lum_model_destroy(model);

    /* Phosphor alone is a medium; a later entry without it takes it out again. */
    static const char PHOSPHOR[] = "{\"match\":\"Glass\",\"medium\":{\"phosphor\":{\"absorption\":{\"gaussian\":[450,30],\"height\":800},"
                                   "\"emission\":{\"gaussian\":[570,60]},\"quantum_yield\":1}}}";
    for (int later = 0; later < 2; ++later) {
        char json[600];
        snprintf(json, sizeof(json), "{\"entries\":[%s%s]}", PHOSPHOR, later ? ",{\"match\":\"Glass\",\"medium\":{\"scattering\":3}}" : "");
        r = recipe(json);
        model = gltf_load("media.gltf", text, r);
        lum_recipe_destroy(r);
        m = &model->materials[model->parts[0].material];
        assert_true(m->spectral.fills == !later && (m->spectral.converted != NULL) == !later && m->scattering[0] == (later ? 3.0f : 0.0f));
        lum_model_destroy(model);
    }
    free(text);
}

static void bad_media_are_refused_by_the_reader(void **state)
{
    (void)state;
    static const struct {
        const char *json, *part;
    } bad[] = {
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":-1}}]}", "entries[0].medium.scattering: -1 is outside"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":1,\"absorption\":[0,-2,0]}}]}", "medium.absorption: -2"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"extinction\":1,\"albedo\":1.5}}]}",
         "medium.albedo: 1.5 is outside [0, 1]"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"extinction\":1}}]}", "\"albedo\""},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"extinction\":1,\"albedo\":1,\"scattering\":1}}]}",
         "give \"scattering\""},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":0}}]}", "scatters nothing"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":1,\"anisotropy\":1}}]}", "anisotropy: 1 is outside"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":1,\"g\":0.5}}]}", "unknown key \"g\""},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":{\"nm\":[400,700],\"values\":[1,-1]}}}]}",
         "medium.scattering: -1 at 700 nm is outside [0, 1e+09]"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"extinction\":1,\"albedo\":{\"nm\":[400,700],\"values\":[1,1.5]}}}]}",
         "medium.albedo: 1.5 at 700 nm is outside [0, 1]"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"scattering\":{\"nm\":[500,600],\"values\":[1,1]}}}]}", "covers 500 to 600 nm only"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"phosphor\":{\"absorption\":5,\"emission\":\"E\",\"quantum_yield\":1}}}]}",
         "medium.phosphor.absorption: needs a spectrum"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"phosphor\":{\"absorption\":{\"gaussian\":[450,30]},\"quantum_yield\":1}}}]}",
         "medium.phosphor.emission: is missing"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"phosphor\":{\"absorption\":{\"gaussian\":[450,30]},\"emission\":{\"gaussian\":[570,60]},"
         "\"quantum_yield\":1.5}}}]}",
         "quantum_yield: 1.5 is outside [0, 1]"},
        {"{\"entries\":[{\"match\":\"Glass\",\"medium\":{\"phosphor\":{\"absorption\":{\"gaussian\":[650,30]},\"emission\":{\"gaussian\":[570,60]},"
         "\"quantum_yield\":1}}}]}",
         "more energy than it takes"},
        {"{\"volumes\":{}}", "volumes: must be an array"},
        {"{\"volumes\":[1]}", "volumes[0]: must be an object"},
        {"{\"volumes\":[{\"scattering\":1}]}", "give \"vdb\""},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"box\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"scattering\":1}]}", "give \"vdb\""},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\"}]}", "volumes[0]: give \"scattering\""},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"density_scale\":-1}]}", "density_scale: -1"},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"interpolation\":\"cubic\"}]}", "linear, nearest"},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"rotation\":[1,1,0,0]}]}", "quaternion of length"},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"rotation\":[0,1]}]}", "must be a unit quaternion"},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"translation\":[0,1]}]}", "must be three numbers"},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"scale\":0}]}", "scale: 0 is outside"},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0],\"max\":[1,0,1]},\"scattering\":1}]}", "isn't beyond"},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0]},\"scattering\":1}]}", "needs \"min\" and \"max\""},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"scattering\":1,\"grid\":\"density\"}]}", "belongs to \"vdb\""},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"scattering\":0}]}", "is clear"},
        {"{\"volumes\":[{\"vdb\":\"a.vdb\",\"scattering\":1,\"desnity_scale\":1}]}", "unknown key \"desnity_scale\""},
    };
    for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); ++i) {
        lum_recipe *r = NULL;
        lmg_error err = {{0}};
        gltf_write("bad.recipe.json", bad[i].json, strlen(bad[i].json));
        const lmg_result result = lum_recipe_read(gltf_path("bad.recipe.json"), &r, &err);
        if (result != LMG_ERROR_INPUT || !strstr(err.message, bad[i].part) || strchr(err.message, '\n') || r)
            fail_msg("%s\n  result %d: %s", bad[i].json, (int)result, err.message);
    }
}

static void refused_at_load(const char *json, lmg_result expected, const char *part)
{
    char *text = document();
    lum_recipe *r = recipe(json);
    const char *message = gltf_refuse("media.gltf", text, r, expected);
    if (!strstr(message, part) || strchr(message, '\n'))
        fail_msg("%s\n  %s", json, message);
    lum_recipe_destroy(r);
    free(text);
}

static void bad_media_are_refused_at_load(void **state)
{
    (void)state;
    refused_at_load("{\"entries\":[{\"match\":\"Glass\",\"thin\":true,\"medium\":{\"scattering\":1}}]}", LMG_ERROR_INPUT,
                    "\"medium\" fills a solid that light gets into, and material \"Glass\" isn't one");
    refused_at_load("{\"entries\":[{\"match\":\"Glass\",\"mirror\":{\"reflectance\":1},\"medium\":{\"scattering\":1}}]}",
                    LMG_ERROR_INPUT, "isn't one");
    if (!lum_vdb_available()) {
        refused_at_load("{\"volumes\":[{\"vdb\":\"media.recipe.json\",\"scattering\":1}]}", LMG_ERROR_UNSUPPORTED,
                        "without OpenVDB");
        return;
    }
    refused_at_load("{\"volumes\":[{\"vdb\":\"nowhere.vdb\",\"scattering\":1}]}", LMG_ERROR_FILE_OPEN,
                    "recipe volumes[0]: nowhere.vdb: can't be opened");
    refused_at_load("{\"volumes\":[{\"vdb\":\"media.recipe.json\",\"scattering\":1}]}", LMG_ERROR_FILE_READ, "OpenVDB");
    const int32_t low[3] = {0, 0, 0};
    const uint32_t size[3] = {2, 2, 2};
    const double map[3][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}};
    float values[8] = {1, 2, 3, 4, 5, NAN, 7, 8};
    assert_int_equal(lum_vdb_write(gltf_path("smoke.vdb"), "density", low, size, values, map, NULL), LMG_OK);
    refused_at_load("{\"volumes\":[{\"vdb\":\"smoke.vdb\",\"scattering\":1}]}", LMG_ERROR_INPUT, "voxel (1, 0, 1): density nan");
    values[5] = -1;
    assert_int_equal(lum_vdb_write(gltf_path("smoke.vdb"), "density", low, size, values, map, NULL), LMG_OK);
    refused_at_load("{\"volumes\":[{\"vdb\":\"smoke.vdb\",\"scattering\":1}]}", LMG_ERROR_INPUT, "density -1");
    refused_at_load("{\"volumes\":[{\"vdb\":\"smoke.vdb\",\"grid\":\"fog\",\"scattering\":1}]}", LMG_ERROR_INPUT,
                    "no grid is called \"fog\"; it has \"density\"");
    /* and a good one, found beside the recipe; its contents are part of the model's hash */
    uint64_t hash[2];
    for (int i = 0; i < 2; ++i) {
        values[5] = (float)i;
        assert_int_equal(lum_vdb_write(gltf_path("smoke.vdb"), "density", low, size, values, map, NULL), LMG_OK);
        char *text = document();
        lum_recipe *r = recipe("{\"volumes\":[{\"vdb\":\"smoke.vdb\",\"scattering\":1}]}");
        lum_model *model = gltf_load("media.gltf", text, r);
        hash[i] = model->hash;
        lum_model_destroy(model);
        lum_recipe_destroy(r);
        free(text);
    }
    assert_true(hash[0] != hash[1]);
}

static int set_up(void **state)
{
    (void)state;
    gltf_folder("recipe_media");
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(media_reach_the_model),
        cmocka_unit_test(media_by_wavelength_reach_the_model),
        cmocka_unit_test(bad_media_are_refused_by_the_reader),
        cmocka_unit_test(bad_media_are_refused_at_load),
    };
    return cmocka_run_group_tests(tests, set_up, NULL);
}
