/* SPDX-License-Identifier: Apache-2.0 */
/* Recipes: reading, shorthands, what entries do to a model, and the messages of wrong ones. */
#include "gltf_writer.h"

#include "colour.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static const double pi = 3.14159265358979323846;

static void assert_close(double a, double b, double tolerance)
{
    if (!(fabs(a - b) <= tolerance))
        fail_msg("%.17g is not within %g of %.17g", a, tolerance, b);
}

/* Which way the cube's faces look. */
typedef enum shell { INWARD, OUTWARD, DOUBLED } shell;

/* Two nodes with the same mesh (a unit square facing +z, material "Paint"), below one parent; a light; and a cube, material "Bulb",
 * 2 m across. */
static char *scene_with(shell which)
{
    static const float square[4][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    /* Corner i has x, y, z = -1 or 1 by its bits 0, 1, 2; counter-clockwise seen from outside. */
    static const unsigned char outward[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
    float data[4 + 8][3];
    unsigned short indices[72];
    int count = 0;
    memcpy(data, square, sizeof square);
    for (int i = 0; i < 8; i++)
        for (int k = 0; k < 3; k++)
            data[4 + i][k] = i >> k & 1 ? 1 : -1;
    for (int f = 0; f < 6 && which != INWARD; f++)
        for (int k = 0; k < 6; k++)
            indices[count++] = outward[f][(const int[6]){0, 1, 2, 0, 2, 3}[k]];
    for (int f = 0; f < 6 && which != OUTWARD; f++) /* turned round, and cut along the other diagonal */
        for (int k = 0; k < 6; k++)
            indices[count++] = outward[f][(const int[6]){1, 0, 3, 1, 3, 2}[k]];
    unsigned char bytes[sizeof data + sizeof indices];
    memcpy(bytes, data, sizeof data);
    memcpy(bytes + sizeof data, indices, sizeof indices);
    char *uri = gltf_data_uri(bytes, sizeof bytes);
    char *text =
        gltf_text("{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":%zu,\"uri\":\"%s\"}],"
                  "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":96},"
                  "{\"buffer\":0,\"byteOffset\":144,\"byteLength\":144}],"
                  "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
                  "{\"bufferView\":1,\"componentType\":5126,\"count\":8,\"type\":\"VEC3\"},"
                  "{\"bufferView\":2,\"componentType\":5123,\"count\":%d,\"type\":\"SCALAR\"}],"
                  "\"materials\":[{\"name\":\"Paint\",\"emissiveFactor\":[1,1,1]},{\"name\":\"Bulb\"}],"
                  "\"meshes\":[{\"name\":\"Square\",\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":6,\"material\":0}]},"
                  "{\"name\":\"Cube\",\"primitives\":[{\"attributes\":{\"POSITION\":1},\"indices\":2,\"material\":1}]}],"
                  "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"point\",\"name\":\"Spark\"}]}},"
                  "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"Root\",\"children\":[1,2,3,4]},{\"name\":"
                  "\"Left\",\"mesh\":0},"
                  "{\"name\":\"Right\",\"mesh\":0,\"translation\":[3,0,0]},{\"name\":\"Globe\",\"mesh\":1,\"translation\":[0,0,5]},"
                  "{\"name\":\"L\",\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}]}",
                  sizeof bytes, uri, count);
    free(uri);
    return text;
}

static char *scene(void)
{
    return scene_with(INWARD);
}

static lum_recipe *recipe_of(const char *entries)
{
    lmg_error err = {{0}};
    lum_recipe *r = NULL;
    char *text = gltf_text("{\"comment\":\"x\",\"entries\":[%s]}", entries);
    gltf_write("r.recipe.json", text, strlen(text));
    free(text);
    if (lum_recipe_read(gltf_path("r.recipe.json"), &r, &err))
        fail_msg("%s", err.message);
    return r;
}

static lum_model *load_with(const char *entries)
{
    char *text = scene();
    lum_recipe *r = recipe_of(entries);
    lum_model *m = gltf_load("recipe.gltf", text, r);
    lum_recipe_destroy(r);
    free(text);
    return m;
}

/* The part in a node, and its material. */
static const lum_part *part_in(const lum_model *m, const char *node)
{
    for (uint32_t i = 0; i < m->part_count; i++)
        if (strcmp(m->parts[i].node, node) == 0)
            return &m->parts[i];
    return NULL;
}

static const lum_material *material_in(const lum_model *m, const char *node)
{
    const lum_part *p = part_in(m, node);
    assert_non_null(p);
    return &m->materials[p->material];
}

/* ------------------------------------------------------------------------------------------------------------- applying */

static void matching(void **state)
{
    (void)state;
    /* By material: both squares; by node: one of them gets a material of its own; a later entry wins. */
    lum_model *m = load_with("{\"match\":\"Paint\",\"diffuse\":{\"reflectance\":0.5}},{\"match\":\"Le*\",\"mirror\":{"
                             "\"reflectance\":[0.9,0.8,0.7],\"roughness\":0.1}}");
    assert_int_equal(material_in(m, "Left")->kind, LUM_SURFACE_CONDUCTOR);
    assert_close((double)material_in(m, "Left")->base_color[2], 0.7, 1e-7);
    assert_close((double)material_in(m, "Left")->roughness, 0.1, 1e-7);
    assert_int_equal(material_in(m, "Right")->kind, LUM_SURFACE_LAMBERT);
    assert_close((double)material_in(m, "Right")->base_color[0], 0.5, 0);
    assert_int_equal(material_in(m, "Globe")->kind, LUM_SURFACE_PBR);
    assert_int_equal(m->material_count, 3);
    lum_model_destroy(m);
    /* A node stands for all below it; targets narrow. */
    m = load_with(
        "{\"match\":\"Root\",\"black\":true},{\"match\":\"Cube\",\"target\":\"mesh\",\"conductor\":{\"metal\":\"gold\"}}");
    assert_int_equal(material_in(m, "Left")->kind, LUM_SURFACE_BLACK);
    assert_int_equal(material_in(m, "Globe")->kind, LUM_SURFACE_CONDUCTOR);
    assert_true(material_in(m, "Globe")->has_eta);
    assert_close((double)material_in(m, "Globe")->eta[1], 0.424, 1e-6);
    lum_model_destroy(m);
    m = load_with("{\"match\":\"Right\",\"leave_out\":true},{\"match\":\"Spark\",\"leave_out\":true}");
    assert_null(part_in(m, "Right"));
    assert_non_null(part_in(m, "Left"));
    assert_int_equal(m->light_count, 0);
    lum_model_destroy(m);
    m = load_with("{\"match\":\"*\",\"no_emission\":true}");
    assert_close((double)material_in(m, "Left")->emissive[0], 0, 0);
    assert_int_equal(m->light_count, 0);
    assert_true(gltf_warned(m, "\"Bulb\"")); /* nothing emits: the name that sounds like a light */
    lum_model_destroy(m);
}

/* Priorities of solids, and metals by their symbols. */
static void priorities_and_symbols(void **state)
{
    (void)state;
    lum_model *m = load_with("{\"match\":\"Left\",\"glass\":{\"priority\":-3}},{\"match\":\"Left\",\"priority\":7},"
                             "{\"match\":\"Right\",\"priority\":2},{\"match\":\"Globe\",\"conductor\":{\"metal\":\"Al\"}}");
    assert_int_equal(material_in(m, "Left")->priority, 7);
    bool warned = false;
    for (uint32_t i = 0; i < m->warning_count; i++)
        warned = warned || strstr(m->warnings[i], "\"priority\" changes nothing");
    assert_true(warned); /* Right is no solid */
    float eta[3], k[3];
    assert_true(lum_metal("aluminium", eta, k));
    assert_memory_equal(material_in(m, "Globe")->eta, eta, sizeof eta);
    lum_model_destroy(m);
}

static void surfaces(void **state)
{
    (void)state;
    lum_model *m = load_with("{\"match\":\"Left\",\"glass\":{\"ior\":1.6,\"attenuation_color\":0.5,\"attenuation_distance\":0.25}},"
                             "{\"match\":\"Right\",\"diffuse_transmission\":{\"reflectance\":0.3,\"transmittance\":[0.1,0.5,0]}},"
                             "{\"match\":\"Globe\",\"glass\":{\"thin\":true,\"roughness\":0.2}}");
    const lum_material *a = material_in(m, "Left");
    assert_close((double)a->transmission, 1, 0);
    assert_close((double)a->ior, 1.6, 1e-6);
    assert_false(a->thin);
    assert_close((double)a->absorption[1], log(2) / 0.25, 1e-6);
    a = material_in(m, "Right");
    for (int i = 0; i < 3; i++) {
        static const double t[3] = {0.1, 0.5, 0};
        assert_close((double)(a->base_color[i] * (1 - a->diffuse_transmission)), 0.3, 1e-6);
        assert_close((double)(a->diffuse_transmission_color[i] * a->diffuse_transmission), t[i], 1e-6);
    }
    assert_close((double)a->ior, 1, 0);
    a = material_in(m, "Globe");
    assert_true(a->thin);
    assert_close((double)a->ior, 1.5, 0);
    assert_close((double)a->roughness, 0.2, 1e-7);
    lum_model_destroy(m);
}

/* Lumens are spread over all pieces of an entry: L = flux / (pi area). */
static void emitters(void **state)
{
    (void)state;
    lum_model *m = load_with("{\"match\":\"Paint\",\"emitter\":{\"lumens\":100,\"color\":[1,2,3]}}");
    double luminance = lmg_luminance(material_in(m, "Left")->emissive);
    assert_close(luminance, 100 / (pi * 2), 1e-4);
    assert_close((double)(material_in(m, "Left")->emissive[2] / material_in(m, "Left")->emissive[0]), 3, 1e-6);
    assert_false(material_in(m, "Left")->emits_back);
    lum_model_destroy(m);
    m = load_with(
        "{\"match\":\"Left\",\"emitter\":{\"lumens\":100,\"sides\":\"both\"}},{\"match\":\"Right\",\"emitter\":{\"luminance\":7}}");
    assert_close(lmg_luminance(material_in(m, "Left")->emissive), 100 / (pi * 2), 1e-4);
    assert_true(material_in(m, "Left")->emits_back);
    assert_close(lmg_luminance(material_in(m, "Right")->emissive), 7, 1e-5);
    lum_model_destroy(m);
}

/* Of a cube that looks inward no face emits "outside", of one that looks outward all, of a doubled one half: 6 faces of 4 m2. */
static void emitting_outside(void **state)
{
    (void)state;
    static const double volumes[] = {-8, 8, 0};
    for (shell which = INWARD; which <= DOUBLED; which++) {
        char *text = scene_with(which);
        lum_recipe *r = recipe_of("{\"match\":\"Bulb\",\"emitter\":{\"lumens\":100}}");
        lum_model *m = gltf_load("front.gltf", text, r);
        assert_close(part_in(m, "Globe")->enclosed_volume, volumes[which], 1e-4);
        assert_int_equal(gltf_warned(m, "its faces look inward"), which == INWARD);
        assert_int_equal(gltf_warned(m, "its faces are doubled"), which == DOUBLED);
        lum_model_destroy(m);
        lum_recipe_destroy(r);
        r = recipe_of("{\"match\":\"Bulb\",\"emitter\":{\"lumens\":100,\"sides\":\"outside\"}}");
        if (which == INWARD) {
            assert_non_null(strstr(gltf_refuse("outside.gltf", text, r, LMG_ERROR_INPUT), "no face of \"Bulb\" looks outside"));
        } else {
            m = gltf_load("outside.gltf", text, r);
            assert_close(lmg_luminance(material_in(m, "Globe")->emissive), 100 / (pi * 24), 1e-4);
            const lum_part *p = part_in(m, "Globe");
            uint32_t bright = 0;
            for (uint32_t t = p->first_triangle; t < p->first_triangle + p->triangle_count; t++)
                bright += m->materials[m->triangle_material[t]].emissive[0] > 0;
            assert_int_equal(bright, 12);
            assert_false(gltf_warned(m, "doubled"));
            lum_model_destroy(m);
        }
        lum_recipe_destroy(r);
        free(text);
    }
}

static void globals(void **state)
{
    (void)state;
    lmg_error err = {{0}};
    lum_recipe *r;
    assert_int_equal(lum_recipe_create(&r, &err), LMG_OK);
    char *text = scene();
    lum_model *m = gltf_load("recipe.gltf", text, r);
    uint64_t hash = m->hash;
    double size = m->bounds_max.z - m->bounds_min.z;
    assert_close(m->rated_flux, 0, 0);
    lum_model_destroy(m);
    assert_int_equal(lum_recipe_add(r, "scale=0.001", &err), LMG_OK);
    assert_int_equal(lum_recipe_add(r, "flux=812.5lm", &err), LMG_OK);
    m = gltf_load("recipe.gltf", text, r);
    assert_true(m->hash != hash);
    assert_close((m->bounds_max.z - m->bounds_min.z) / size, 0.001, 1e-9);
    assert_close(m->rated_flux, 812.5, 0);
    lum_model_destroy(m);
    lum_recipe_destroy(r);
    free(text);
}

/* ---------------------------------------------------------------------------------------------------------- shorthands */

static void shorthands(void **state)
{
    (void)state;
    static const char *const good[] = {"emitter:Bulb=800lm,2700K,both",
                                       "emitter:Paint=9500cd/m2",
                                       "thin:Bulb",
                                       "solid:Bulb",
                                       "no-emission:Paint",
                                       "mirror:Left=0.9",
                                       "mirror:Left=0.9,0.1",
                                       "diffuse:Right=0.8",
                                       "leave-out:Spark",
                                       "black:Left",
                                       "glass:Globe=1.5",
                                       "conductor:Globe=brass,0.4",
                                       "diffuse-transmission:Left=0.4,0.5"};
    static const char *const bad[] = {"",
                                      "emitter",
                                      "emitter:",
                                      "emitter:Bulb",
                                      "emitter:Bulb=",
                                      "emitter:Bulb=800",
                                      "emitter:Bulb=800W",
                                      "emitter:Bulb=lm",
                                      "emitter:Bulb=2700K",
                                      "emitter:Bulb=-5lm",
                                      "emitter:Bulb=nanlm",
                                      "mirror:Left",
                                      "mirror:Left=1.5",
                                      "mirror:Left=0.9,0.1,3",
                                      "mirror:Left=0.9x",
                                      "conductor:Globe=unobtainium",
                                      "diffuse:Right=0.8,0.1",
                                      "shine:Bulb=800lm",
                                      "scale=0",
                                      "scale=x",
                                      "flux=800",
                                      "flux=-1lm",
                                      "thin",
                                      "diffuse-transmission:Left=0.6,0.5",
                                      "mirror:=0.9"};
    lmg_error err = {{0}};
    lum_recipe *r;
    assert_int_equal(lum_recipe_create(&r, &err), LMG_OK);
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        if (lum_recipe_add(r, good[i], &err))
            fail_msg("%s", err.message);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        memset(&err, 0, sizeof err);
        if (lum_recipe_add(r, bad[i], &err) == LMG_OK)
            fail_msg("%s was accepted", bad[i]);
        assert_true(err.message[0] != 0);
        assert_null(strchr(err.message, '\n'));
    }
    char *text = scene();
    lum_model *m = gltf_load("recipe.gltf", text, r);
    assert_int_equal(material_in(m, "Globe")->kind, LUM_SURFACE_CONDUCTOR); /* the last of three */
    assert_true(material_in(m, "Globe")->emits_back);
    assert_close(lmg_luminance(material_in(m, "Globe")->emissive), 800 / (pi * 48), 1e-3);
    assert_close((double)material_in(m, "Left")->diffuse_transmission, 5.0 / 9, 1e-6);
    assert_int_equal(m->light_count, 0);
    lum_model_destroy(m);
    free(text);
    lum_recipe_destroy(r);
}

/* -------------------------------------------------------------------------------------------------------------- errors */

static void wrong_recipes(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
    } cases[] = {
        {"{\"entries\":[{\"match\":\"a\",\"thn\":true}]}", "entries[0]: unknown key \"thn\""},
        {"{\"entry\":[]}", "unknown key \"entry\""},
        {"{\"entries\":[{\"match\":\"a\",\"mirror\":{\"reflectance\":1.2}}]}",
         "entries[0].mirror.reflectance: 1.2 is outside [0, 1]"},
        {"{\"entries\":[{\"match\":\"a\",\"mirror\":{\"reflectance\":[1,1]}}]}",
         "entries[0].mirror.reflectance: must be a number or three"},
        {"{\"entries\":[{\"match\":\"a\",\"mirror\":0.9}]}", "entries[0].mirror: must be an object"},
        {"{\"entries\":[{\"thin\":true}]}", "entries[0].match: is missing"},
        {"{\"entries\":[{\"match\":\"a\"}]}", "says nothing"},
        {"{\"entries\":[{\"match\":\"a\",\"thin\":1}]}", "entries[0].thin: must be true or false"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{}}]}", "needs \"lumens\" or \"luminance\""},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"luminance\":1}}]}", "give one of"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"kelvin\":100}}]}",
         "entries[0].emitter.kelvin: 100 is outside"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"color\":[0,0,0]}}]}", "color: is black"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1},\"no_emission\":true}]}", "contradicts"},
        {"{\"entries\":[{\"match\":\"a\",\"black\":true,\"diffuse\":{\"reflectance\":1}}]}", "two things"},
        {"{\"entries\":[{\"match\":\"a\",\"target\":\"nod\",\"thin\":true}]}", "\"nod\" is not one of any, material, mesh, node"},
        {"{\"entries\":[{\"match\":\"a\",\"conductor\":{\"metal\":\"x\"}}]}", "aluminium"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"thin\":true,\"absorption\":3}}]}", "no inside"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"priority\":2000}}]}", "glass.priority: 2000 is outside [-1000, 1000]"},
        {"{\"entries\":[{\"match\":\"a\",\"priority\":1.5}]}", "entries[0].priority: 1.5 is not a whole number"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"kelvin\":3000,\"spectrum\":\"D65\"}}]}", "give one of \"color\""},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"watts\":1}}]}", "watts: needs a \"spectrum\""},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":\"D64\"}}]}", "\"D64\" is not one of A, E, D50"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{}}}]}", "spectrum: give one of"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{\"blackbody\":100}}}]}", "100 is outside [500, 100000]"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{\"nm\":[400,500],\"values\":[1]}}}]}",
         "spectrum.values: needs 2 numbers"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{\"nm\":[400,500,600],\"values\":[1,-1,1]}}}]}",
         "emitter.spectrum: -1 at 500 nm is outside"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{\"nm\":[400,500],\"values\":[1,1],\"x\":1}}}]}",
         "unknown key \"x\""},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{\"file\":\"no.csv\"}}}]}", "spectrum.file: no.csv: can't be opened"},
        {"{\"entries\":[{\"match\":\"a\",\"emitter\":{\"lumens\":1,\"spectrum\":{\"gaussian\":[300,20]}}}]}", "peak at 300 nm is outside"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":\"N-BK8\"}}]}", "\"N-BK8\" is not one of N-BK7"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":\"N-BK7\",\"abbe\":60}}]}", "abbe: belongs to"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":3.9,\"abbe\":1}}]}", "the refractive index comes to 1"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":0.9}}]}", "ior: 0.9 is outside [1, 4]"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":{\"cauchy\":[0.9,0.001]}}}]}", "outside [1, 4]"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":{\"sellmeier\":[1,0.01,1]}}}]}", "sellmeier: needs pairs"},
        {"{\"entries\":[{\"match\":\"a\",\"glass\":{\"ior\":{\"nm\":[400,700],\"values\":[1.5,0.9]}}}]}", "0.9 at 700 nm is outside [1, 4]"},
        {"{\"entries\":[{\"match\":\"a\",\"diffuse\":{\"reflectance\":{\"nm\":[450,700],\"values\":[1,1]}}}]}", "covers 450 to 700 nm only"},
        {"{\"entries\":[{\"match\":\"a\",\"diffuse\":{\"reflectance\":{\"nm\":[400,700],\"values\":[1,1.1]}}}]}",
         "diffuse.reflectance: 1.1 at 700 nm is outside [0, 1]"},
        {"{\"entries\":[{\"match\":\"a\",\"diffuse_transmission\":{\"reflectance\":0.5,\"transmittance\":{\"nm\":[400,700],\"values\":[0,0.6]}}}]}",
         "together exceed 1"},
        {"{\"entries\":[{\"match\":\"a\",\"conductor\":{\"eta\":1,\"k\":{\"nm\":[400,700],\"values\":[2,3]}}}]}", "both \"eta\" and \"k\""},
        {"{\"entries\":[{\"match\":\"a\",\"phosphor\":{\"absorption\":0.5,\"emission\":{\"gaussian\":[560,100]},\"quantum_yield\":0.9,"
         "\"reflectance\":0.4,\"transmittance\":0.5}}]}",
         "absorption: needs a spectrum"},
        {"{\"entries\":[{\"match\":\"a\",\"phosphor\":{\"absorption\":{\"gaussian\":[450,60]},\"emission\":{\"gaussian\":[560,100]},"
         "\"quantum_yield\":1.1,\"reflectance\":0.4,\"transmittance\":0.5}}]}",
         "quantum_yield: 1.1 is outside [0, 1]"},
        {"{\"entries\":[{\"match\":\"a\",\"phosphor\":{\"absorption\":{\"gaussian\":[650,60]},\"emission\":{\"gaussian\":[560,100]},"
         "\"quantum_yield\":1,\"reflectance\":0.4,\"transmittance\":0.5}}]}",
         "more energy than it takes"},
        {"{\"entries\":7}", "entries: must be an array"},
        {"{\"entries\":[7]}", "entries[0]: must be an object"},
        {"{\"scale\":0}", "scale: 0 is outside"},
        {"[]", "a recipe is an object"},
        {"{\n \"a\": }", "line 2"},
        {"", "not JSON"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        lmg_error err = {{0}};
        lum_recipe *r = NULL;
        gltf_write("wrong.recipe.json", cases[i].text, strlen(cases[i].text));
        const lmg_result result = lum_recipe_read(gltf_path("wrong.recipe.json"), &r, &err);
        if (result != LMG_ERROR_INPUT)
            fail_msg("case %zu: %d, %s", i, (int)result, err.message);
        assert_null(r);
        if (!strstr(err.message, cases[i].says) || strncmp(err.message, "wrong.recipe.json: ", 19) != 0 ||
            strchr(err.message, '\n'))
            fail_msg("case %zu: %s", i, err.message);
    }
    lmg_error err = {{0}};
    lum_recipe *r;
    assert_int_equal(lum_recipe_read(gltf_path("not-there.json"), &r, &err), LMG_ERROR_FILE_OPEN);
}

/* What spectra do to materials: values by wavelength, and R,G,B that stand for them. */
static void spectra(void **state)
{
    (void)state;
    const char *const led = "nm,power\n400,0\n450,1\n500,0.2\n600,0.5\n700,0\n";
    gltf_write("led.csv", led, strlen(led));
    lum_model *m = load_with("{\"match\":\"Left\",\"emitter\":{\"watts\":2,\"spectrum\":{\"file\":\"led.csv\"}},"
                             "\"phosphor\":{\"absorption\":{\"gaussian\":[450,60],\"height\":0.8},\"emission\":{\"gaussian\":[560,100]},"
                             "\"quantum_yield\":0.9,\"forward\":0.7,\"reflectance\":0.3,\"transmittance\":[0.6,0.6,0.5]}},"
                             "{\"match\":\"Right\",\"glass\":{\"ior\":\"N-SF11\",\"absorption\":{\"nm\":[400,700],\"values\":[3,1]}},"
                             "\"emitter\":{\"lumens\":100,\"kelvin\":3000}},"
                             "{\"match\":\"Globe\",\"conductor\":{\"metal\":\"gold\"}}");
    const lum_material *left = material_in(m, "Left"), *right = material_in(m, "Right"), *globe = material_in(m, "Globe");
    const lum_spectral *s = &left->spectral;
    assert_int_equal(left->kind, LUM_SURFACE_LAMBERT);
    assert_non_null(s->emission);
    assert_true(s->measured);
    assert_close(lum_spectrum_at(s->emission, 475), 0.6, 1e-6);
    assert_close(pi * lmg_luminance(left->emissive), 2 * lum_spectrum_efficacy(s->emission), 1e-2); /* of 1 m2 */
    assert_close(lum_spectrum_at(s->excitation, 450), 0.8, 1e-6);
    assert_close(lum_spectrum_at(s->converted, 610), 0.5, 1e-6);
    assert_close((double)s->quantum_yield, 0.9, 1e-7);
    assert_close((double)s->forward, 0.7, 1e-7);
    assert_close(lum_spectrum_at(s->reflectance, 555), 0.3, 1e-6);
    assert_close(lum_spectrum_at(s->transmittance, 700), 0.6, 1e-6);
    assert_close((double)left->diffuse_transmission, 0.6 / 0.9, 1e-6);

    assert_close((double)right->ior, 1.78472, 1e-5);
    assert_close(lum_spectrum_at(right->spectral.index, LUM_NM_F), 1.80651, 2e-5); /* SCHOTT's data sheet */
    assert_close(lum_spectrum_at(right->spectral.index, LUM_NM_C), 1.77595, 2e-5);
    assert_close(lum_spectrum_at(right->spectral.absorption, 550), 2, 1e-6);
    assert_close((double)right->absorption[1], 2, 1e-6);
    assert_non_null(right->spectral.emission);
    assert_false(right->spectral.measured);
    assert_close(lum_spectrum_at(globe->spectral.k, 600), 3.1, 0.1);
    assert_true(globe->has_eta);
    lum_model_destroy(m);

    m = load_with("{\"match\":\"Left\",\"glass\":{\"ior\":1.6,\"abbe\":25}},{\"match\":\"Left\",\"diffuse\":{\"reflectance\":0.5}},"
                  "{\"match\":\"Right\",\"glass\":{\"ior\":{\"cauchy\":[1.5,0.004]}}},{\"match\":\"Right\",\"ior\":1.6},"
                  "{\"match\":\"Globe\",\"diffuse\":{\"reflectance\":{\"nm\":[380,580,590,780],\"values\":[0,0,0.9,0.9]}}}");
    assert_null(material_in(m, "Left")->spectral.index); /* a later surface replaces all of an earlier one */
    assert_null(material_in(m, "Right")->spectral.index);
    assert_close((double)material_in(m, "Right")->ior, 1.6, 1e-6);
    globe = material_in(m, "Globe");
    assert_close(lum_spectrum_at(globe->spectral.reflectance, 585), 0.45, 1e-6);
    assert_true(globe->base_color[0] > 0.8f && globe->base_color[1] < 0.2f && globe->base_color[2] < 0.05f);
    lum_model_destroy(m);
}

/* Shorthands of glasses and illuminants; KHR_materials_dispersion. */
static void dispersion(void **state)
{
    (void)state;
    lum_recipe *r;
    lmg_error err = {{0}};
    char *text = scene();
    assert_int_equal(lum_recipe_create(&r, &err), LMG_OK);
    if (lum_recipe_add(r, "glass:Left=PMMA,0.1", &err) || lum_recipe_add(r, "emitter:Right=100lm,D65,both", &err))
        fail_msg("%s", err.message);
    assert_int_equal(lum_recipe_add(r, "glass:Left=Plexiglas", &err), LMG_ERROR_ARGUMENT);
    lum_model *m = gltf_load("recipe.gltf", text, r);
    assert_close(lum_spectrum_at(material_in(m, "Left")->spectral.index, LUM_NM_D), 1.4906, 1e-4);
    assert_close((double)material_in(m, "Left")->roughness, 0.1, 1e-6);
    assert_true(material_in(m, "Right")->spectral.measured);
    lum_model_destroy(m);
    lum_recipe_destroy(r);

    /* in place of the emission of "Paint" */
    static const char *const from = "\"emissiveFactor\":[1,1,1]";
    char *at = strstr(text, from), changed[16384];
    assert_non_null(at);
    for (int i = 0; i < 2; i++) {
        snprintf(changed, sizeof changed,
                 "%.*s\"extensions\":{\"KHR_materials_ior\":{\"ior\":1.5},\"KHR_materials_dispersion\":{\"dispersion\":%s}}%s",
                 (int)(at - text), text, i ? "40" : "0.5", at + strlen(from));
        if (i) {
            assert_non_null(strstr(gltf_refuse("dispersion.gltf", changed, NULL, LMG_ERROR_INPUT), "dispersion 40 with ior 1.5"));
            continue;
        }
        m = gltf_load("dispersion.gltf", changed, NULL);
        const lum_spectrum *n = material_in(m, "Left")->spectral.index;
        assert_non_null(n);
        assert_close(lum_spectrum_at(n, LUM_NM_D), 1.5, 2e-6);
        assert_close(0.5 / (lum_spectrum_at(n, LUM_NM_F) - lum_spectrum_at(n, LUM_NM_C)), 40, 0.02); /* floats */
        lum_model_destroy(m);
    }
    free(text);
}

static void no_match(void **state)
{
    (void)state;
    char *text = scene();
    lum_recipe *r = recipe_of("{\"match\":\"Paint\",\"thin\":true},{\"match\":\"Blub\",\"black\":true}");
    const char *message = gltf_refuse("recipe.gltf", text, r, LMG_ERROR_INPUT);
    assert_non_null(strstr(message, "entries[1]: nothing in the scene is called \"Blub\"; close names: \"Bulb\""));
    lum_recipe_destroy(r);
    free(text);
}

/* ------------------------------------------------------------------------------------------------------------- colours */

/* Chromaticities of black bodies from Planck's law and the CIE 1931 observer (CIE 15): illuminant A, and the locus at 4000, 6500
 * and 10000 K, given to five places; the matrix from Rec.709 used here is rounded to 5e-5. */
static void planckian(void **state)
{
    (void)state;
    static const double locus[][3] = {
        {2856, 0.44757, 0.40745}, {4000, 0.38045, 0.37675}, {6500, 0.31352, 0.32363}, {10000, 0.28063, 0.28828}};
    for (size_t i = 0; i < sizeof locus / sizeof *locus; i++) {
        double c[3];
        lum_planckian(locus[i][0], c);
        assert_close(0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2], 1, 1e-12);
        double x = 0.4124 * c[0] + 0.3576 * c[1] + 0.1805 * c[2], y = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
        double z = 0.0193 * c[0] + 0.1192 * c[1] + 0.9505 * c[2], sum = x + y + z;
        assert_close(x / sum, locus[i][1], 1e-4);
        assert_close(y / sum, locus[i][2], 1e-4);
    }
    double red[3];
    lum_planckian(LUM_KELVIN_MIN, red);
    assert_true(red[0] > red[1] && red[1] > 0);
    assert_true(red[2] < 0); /* outside the gamut */
    assert_close(0.2126 * red[0] + 0.7152 * red[1] + 0.0722 * red[2], 1, 1e-12);
}

/* ------------------------------------------------------------------------------------------------------- our recipes */

/* The recipes in the tree fit the models they are for: they match, and leave an emitter of the flux they say. */
static void recipes_of_the_tree(void **state)
{
    (void)state;
    static const struct {
        const char *recipe, *model;
        double flux; /* of all emitters, lumens; 0: a punctual light */
    } cases[] = {
        {"AnisotropyBarnLamp", "AnisotropyBarnLamp/AnisotropyBarnLamp.gltf", 800},
        {"StainedGlassLamp", "StainedGlassLamp/StainedGlassLamp.gltf", 940},
        {"LightsPunctualLamp", "LightsPunctualLamp/LightsPunctualLamp.gltf", 0},
        {"park-light", "park-light/park-light.glb", 7000},
        {"track-lights", "track-lights/track-lights.glb", 2300},
        {"fluorescent", "fluorescent/fluorescent.glb", 4800},
        {"desk_lamp1", "desk_lamp1/desk_lamp1.glb", 450},
        {"hangingLight", "hangingLight/hangingLight.glb", 806},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char recipe[512], path[512];
        snprintf(recipe, sizeof recipe, "%s/luminaires/recipes/%s.recipe.json", LUMIBOX_SOURCE_DIR, cases[i].recipe);
        snprintf(path, sizeof path, "%s/luminaires/%s", LUMIBOX_SHARED_DATA, cases[i].model);
        lmg_error err = {{0}};
        lum_recipe *r;
        if (lum_recipe_read(recipe, &r, &err))
            fail_msg("%s", err.message);
        FILE *there = fopen(path, "rb");
        if (!there) {
            print_message("skipped, not there: %s\n", path);
            lum_recipe_destroy(r);
            continue;
        }
        fclose(there);
        lum_model *m;
        if (lum_model_load(path, r, &m, &err))
            fail_msg("%s", err.message);
        lum_recipe_destroy(r);
        double flux = 0;
        for (uint32_t t = 0; t < m->triangle_count; t++) {
            const lum_material *material = &m->materials[m->triangle_material[t]];
            double x[3][3], n2 = 0;
            for (int k = 0; k < 3; k++)
                for (int j = 0; j < 3; j++)
                    x[k][j] = m->unit * (double)m->positions[3 * m->indices[3 * t + (uint32_t)k] + (uint32_t)j];
            for (int j = 0; j < 3; j++) {
                int a = (j + 1) % 3, b = (j + 2) % 3;
                double n = (x[1][a] - x[0][a]) * (x[2][b] - x[0][b]) - (x[1][b] - x[0][b]) * (x[2][a] - x[0][a]);
                n2 += n * n;
            }
            flux += pi * lmg_luminance(material->emissive) * sqrt(n2) / 2;
        }
        assert_close(flux, cases[i].flux, 1e-5 * cases[i].flux);
        assert_int_equal(m->light_count, cases[i].flux > 0 ? 0 : 1);
        lum_model_destroy(m);
    }
}

int main(void)
{
    gltf_folder("test_recipe_files");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(matching),      cmocka_unit_test(surfaces), cmocka_unit_test(priorities_and_symbols),
        cmocka_unit_test(emitters),      cmocka_unit_test(emitting_outside),
        cmocka_unit_test(globals),       cmocka_unit_test(shorthands),
        cmocka_unit_test(wrong_recipes), cmocka_unit_test(no_match),
        cmocka_unit_test(spectra), cmocka_unit_test(dispersion), cmocka_unit_test(planckian),     cmocka_unit_test(recipes_of_the_tree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
