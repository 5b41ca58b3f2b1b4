/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Unphysical values through the program: each ends in one line that says where it is and what is allowed, and in exit code 3.  A triangle
 * that shines is the lamp; each case changes one thing in its file or its recipe.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "run_lumibake.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* A glTF of one triangle; material: members of its material; used: its extensions; color: of all vertices. */
static void write_lamp(const char *material, const char *used, const float color[4])
{
    float numbers[9 + 12] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    for (int i = 0; i < 12; ++i)
        numbers[9 + i] = color[i % 4];
    write_file(in_folder("lamp.bin"), numbers, sizeof(numbers));
    char text[3000];
    const int n = snprintf(
        text, sizeof(text),
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[%s],\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"name\":\"node\",\"mesh\":0}],"
        "\"meshes\":[{\"name\":\"mesh\",\"primitives\":[{\"attributes\":{\"POSITION\":0,\"COLOR_0\":1},\"material\":0}]}],"
        "\"materials\":[{\"name\":\"paint\"%s}],\"buffers\":[{\"uri\":\"lamp.bin\",\"byteLength\":84}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":48}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,0]},"
        "{\"bufferView\":1,\"componentType\":5126,\"count\":3,\"type\":\"VEC4\"}]}",
        used, material);
    assert_true(n > 0 && (size_t)n < sizeof(text));
    write_file(in_folder("lamp.gltf"), text, (size_t)n);
}

static const float WHITE[4] = {1, 1, 1, 1};

static void refused(const char *message)
{
    char lamp[1200], box[1200];
    snprintf(lamp, sizeof(lamp), "%s", in_folder("lamp.gltf"));
    snprintf(box, sizeof(box), "%s", in_folder("x.box.exr"));
    outcome o = RUN("bake", lamp, "-o", box, "--photons", "100", "--pilot", "100", "--cells", "1000", "-q");
    if (message && (o.code != 3 || !strstr(o.err, message) || lines_of(o.err) != 1))
        fail_msg("expected exit 3 and one line with \"%s\", got exit %d and: %s", message, o.code, o.err);
    if (!message && (o.code != 0 || *o.err))
        fail_msg("expected success, got exit %d and: %s", o.code, o.err);
    assert_int_equal(access(box, F_OK) == 0, message == NULL);
    unlink(box);
    release(&o);
}

static const char SHINES[] = ",\"emissiveFactor\":[1,1,1]";

static void test_gltf(void **state)
{
    (void)state;
    unlink(in_folder("lamp.recipe.json"));
    static const struct {
        const char *extension, *members, *message;
    } CASES[] = {
        {NULL, "\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1.2,1,1]}", "baseColorFactor[1]: 1.2 is outside [0, 1]"},
        {NULL, "\"pbrMetallicRoughness\":{\"metallicFactor\":-0.5}", "metallicFactor: -0.5 is outside [0, 1]"},
        {NULL, "\"pbrMetallicRoughness\":{\"roughnessFactor\":1.5}", "roughnessFactor: 1.5 is outside [0, 1]"},
        {NULL, "\"emissiveTexture\":{\"index\":3}", "index 3 is outside"},
        {"KHR_materials_emissive_strength", "{\"emissiveStrength\":-1}", "emissiveStrength: -1 is outside [0, inf]"},
        {"KHR_materials_transmission", "{\"transmissionFactor\":1.1}", "transmissionFactor: 1.1 is outside [0, 1]"},
        {"KHR_materials_ior", "{\"ior\":0.9}", "ior 0.9 is below 1"},
        {"KHR_materials_volume", "{\"thicknessFactor\":1,\"attenuationDistance\":-1}", "attenuationDistance: -1 is outside [0, inf]"},
        {"KHR_materials_volume", "{\"thicknessFactor\":1,\"attenuationColor\":[1,1,1.5]}", "attenuationColor[2]: 1.5 is outside [0, 1]"},
        {"KHR_materials_dispersion", "{\"dispersion\":-1}", "dispersion: -1 is outside [0, inf]"},
        {"KHR_materials_diffuse_transmission", "{\"diffuseTransmissionFactor\":2}", "diffuseTransmissionFactor: 2 is outside [0, 1]"},
        {"KHR_materials_diffuse_transmission", "{\"diffuseTransmissionColorFactor\":[2,1,1]}", "ColorFactor[0]: 2 is outside [0, 1]"},
        {"KHR_materials_specular", "{\"specularFactor\":2}", "specularFactor: 2 is outside [0, 1]"},
        {"KHR_materials_sheen", "{\"sheenColorFactor\":[1,2,1]}", "sheenColorFactor[1]: 2 is outside [0, 1]"},
        {"KHR_materials_clearcoat", "{\"clearcoatFactor\":1.01}", "clearcoatFactor: 1.01 is outside [0, 1]"},
        {"KHR_materials_anisotropy", "{\"anisotropyStrength\":-0.1}", "anisotropyStrength: -0.1 is outside [0, 1]"},
        {"KHR_materials_iridescence", "{\"iridescenceFactor\":1,\"iridescenceIor\":0.5}", "iridescenceIor: 0.5 is outside [1, inf]"},
    };
    write_lamp(SHINES, "", WHITE);
    refused(NULL);
    for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); ++i) {
        char material[400], used[100] = "", message[200];
        if (CASES[i].extension) {
            snprintf(material, sizeof(material), "%s,\"extensions\":{\"%s\":%s}", SHINES, CASES[i].extension, CASES[i].members);
            snprintf(used, sizeof(used), "\"%s\"", CASES[i].extension);
        } else {
            snprintf(material, sizeof(material), "%s,%s", strstr(CASES[i].members, "emissive") ? "" : SHINES, CASES[i].members);
        }
        write_lamp(material, used, WHITE);
        refused(CASES[i].message);
        snprintf(message, sizeof(message), "\"paint\""); /* the place */
        refused(message);
    }
    static const float BRIGHT[4] = {1, 1, 1.5f, 1}, DARK[4] = {-0.5f, 1, 1, 1}, NONE[4] = {1, NAN, 1, 1};
    write_lamp(SHINES, "", BRIGHT);
    refused("mesh \"mesh\" primitive 0: COLOR_0: vertex 0: 1.5 is outside [0, 1]");
    write_lamp(SHINES, "", DARK);
    refused("COLOR_0: vertex 0: -0.5 is outside [0, 1]");
    write_lamp(SHINES, "", NONE);
    refused("COLOR_0: vertex 0 is not finite");
}

static void test_recipe(void **state)
{
    (void)state;
#define GAP "\"nm\":[400,410,420,430,440,450,460,470,480,490,500,510,520,530,600,610,620,700],"
#define ONES "\"values\":[1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1]"
    static const char *const CASES[][2] = {
        {"\"mirror\":{\"reflectance\":1.2}", "entries[0].mirror.reflectance: 1.2 is outside [0, 1]"},
        {"\"mirror\":{\"reflectance\":1e999}", "line 1, column"},
        {"\"diffuse\":{\"reflectance\":[0.5,-0.1,0.5]}", "diffuse.reflectance: -0.1 is outside [0, 1]"},
        {"\"diffuse\":{\"reflectance\":{" GAP ONES "}}", "diffuse.reflectance: has a gap from 530 to 600 nm"},
        {"\"diffuse\":{\"reflectance\":{\"nm\":[500,600],\"values\":[1,1]}}", "it has to cover 400 to 700 nm"},
        {"\"diffuse_transmission\":{\"reflectance\":0.6,\"transmittance\":0.6}", "together exceed 1"},
        {"\"glass\":{\"absorption\":-1}", "glass.absorption: -1 is outside [0, 1e+09]"},
        {"\"glass\":{\"ior\":0.9}", "glass.ior: 0.9 is outside [1, 4]"},
        {"\"glass\":{\"attenuation_color\":1.5,\"attenuation_distance\":1}", "attenuation_color: 1.5 is outside [1e-30, 1]"},
        {"\"glass\":{},\"medium\":{\"extinction\":1,\"albedo\":1.5}", "medium.albedo: 1.5 is outside [0, 1]"},
        {"\"glass\":{},\"medium\":{\"scattering\":1,\"absorption\":-1}", "medium.absorption: -1 is outside [0, 1e+09]"},
        {"\"glass\":{},\"medium\":{\"scatering\":1}", "entries[0].medium: unknown key \"scatering\""},
        {"\"mirror\":{\"reflectence\":1}", "entries[0].mirror: unknown key \"reflectence\""},
        {"\"conductor\":{\"eta\":1,\"k\":-2}", "conductor.k: -2 is outside [0, 1000]"},
        {"\"conductor\":{\"metal\":\"unobtanium\"}", "\"unobtanium\" is not one of aluminium"},
        {"\"emitter\":{\"lumens\":-5}", "emitter.lumens: -5 is outside [1e-12, 1e+12]"},
        {"\"emitter\":{\"lumens\":5,\"spectrum\":{" GAP ONES "}}", "emitter.spectrum: has a gap from 530 to 600 nm"},
        {"\"emitter\":{\"lumens\":5,\"spectrum\":{\"nm\":[400,700],\"values\":[-1,1]}}", "-1 at 400 nm is outside [0, 1e+30]"},
        {"\"mirrr\":{\"reflectance\":1}", "entries[0]: unknown key \"mirrr\""},
    };
    static const char *const WHOLE[][2] = {
        {"{\"entires\":[]}", "lamp.recipe.json: unknown key \"entires\""},
        {"{\"flux\":-1}", "lamp.recipe.json: flux: -1 is outside"},
        {"{\"entries\":[{\"match\":\"point\",\"black\":true}]}", "entries[0]: nothing in the scene is called \"point\"; close names: \"paint\""},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"extinction\":1,\"albedo\":2}]}", "volumes[0].albedo: 2 is outside [0, 1]"},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"scatering\":1}]}", "volumes[0]: unknown key \"scatering\""},
        {"{\"volumes\":[{\"box\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"scattering\":1,\"density_scale\":-1}]}", "density_scale: -1 is outside [0, 1e+12]"},
    };
    write_lamp(SHINES, "", WHITE);
    char recipe[1200];
    snprintf(recipe, sizeof(recipe), "%s", in_folder("lamp.recipe.json"));
    for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); ++i) {
        char text[800];
        const int n = snprintf(text, sizeof(text), "{\"entries\":[{\"match\":\"paint\",%s}]}", CASES[i][0]);
        write_file(recipe, text, (size_t)n);
        refused(CASES[i][1]);
    }
    for (size_t i = 0; i < sizeof(WHOLE) / sizeof(WHOLE[0]); ++i) {
        write_file(recipe, WHOLE[i][0], strlen(WHOLE[i][0]));
        refused(WHOLE[i][1]);
    }
    unlink(recipe);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_gltf), cmocka_unit_test(test_recipe)};
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
