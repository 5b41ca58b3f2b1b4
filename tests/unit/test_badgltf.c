/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Files that are wrong, odd or damaged: lum_model_load ends with a model or with one clear line, whatever it is given.  Run it with
 * the sanitizers, which see what a plain run doesn't.  Real files come from the shared data; damaged ones are made here from two
 * small files, by a fixed sequence of cuts and changes.
 */
#include "gltf_writer.h"

#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <cmocka.h>

/* Loads a file and checks what every answer must satisfy. */
static bool load_any(const char *path)
{
    lmg_error err = {{0}};
    lum_model *m = NULL;
    lmg_result result = lum_model_load(path, NULL, &m, &err);
    if (result) {
        const char *name = strrchr(path, '/') + 1;
        assert_null(m);
        if (strncmp(err.message, name, strnlen(name, 160)) != 0 || strlen(err.message) < strlen(name) + 8)
            fail_msg("%s: the message doesn't begin with the file's name: %s", path, err.message);
        for (const char *c = err.message; *c; c++)
            if ((unsigned char)*c < 0x20)
                fail_msg("%s: the message is not one line: %s", path, err.message);
        return false;
    }
    assert_non_null(m);
    assert_true(m->triangle_count > 0 || m->light_count > 0);
    assert_true(m->material_count > 0);
    for (uint32_t i = 0; i < 3 * m->triangle_count; i++)
        assert_true(m->indices[i] < m->vertex_count);
    for (uint32_t i = 0; i < m->triangle_count; i++) {
        assert_true((uint32_t)m->triangle_material[i] < m->material_count);
        assert_true(m->triangle_part[i] < m->part_count);
    }
    for (uint32_t i = 0; i < m->material_count; i++) {
        const lum_material *a = &m->materials[i];
        const lum_texture *textures[] = {&a->base_texture, &a->metal_rough_texture, &a->normal_texture, &a->transmission_texture,
                                         &a->emissive_texture};
        for (int k = 0; k < 5; k++) {
            assert_true(textures[k]->image >= LUM_NONE && textures[k]->image < (int32_t)m->image_count);
            assert_true(textures[k]->image == LUM_NONE || textures[k]->coordinates <= 1);
        }
        assert_true(a->base_color[0] >= 0 && a->base_color[0] <= 1 && a->roughness >= 0 && a->roughness <= 1 && a->ior >= 1);
    }
    for (uint32_t i = 0; i < m->warning_count; i++)
        assert_null(strchr(m->warnings[i], '\n'));
    lum_model_destroy(m);
    return true;
}

/* ----------------------------------------------------------------------------------------------------------- real files */

typedef struct tally {
    int files, loaded;
} tally;

static bool ends_with(const char *name, const char *end)
{
    size_t n = strlen(name), m = strlen(end);
    return n >= m && strcmp(name + n - m, end) == 0;
}

static void load_all(const char *folder, tally *t)
{
    DIR *dir = opendir(folder);
    if (!dir)
        return;
    for (const struct dirent *e; (e = readdir(dir));) {
        char path[2048];
        struct stat info;
        if (e->d_name[0] == '.' || snprintf(path, sizeof path, "%s/%s", folder, e->d_name) >= (int)sizeof path ||
            stat(path, &info) != 0)
            continue;
        if (S_ISDIR(info.st_mode))
            load_all(path, t);
        else if (ends_with(path, ".gltf") || ends_with(path, ".glb")) {
            t->files++;
            t->loaded += load_any(path);
        }
    }
    closedir(dir);
}

static void real_files(void **state)
{
    (void)state;
    static const char *const folders[] = {"gltf-invalid", "gltf-odd", "gltf-materials", "luminaires", "scenes", "paired"};
    for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) {
        char path[1024];
        tally t = {0, 0};
        snprintf(path, sizeof path, "%s/%s", LUMIBOX_SHARED_DATA, folders[i]);
        load_all(path, &t);
        if (t.files == 0)
            print_message("skipped, not there: %s\n", path);
        else
            print_message("%s: %d files, %d load, %d are refused\n", folders[i], t.files, t.loaded, t.files - t.loaded);
    }
}

static void not_files(void **state)
{
    (void)state;
    assert_false(load_any(gltf_path("absent.gltf")));
    mkdir(gltf_path("folder.gltf"), 0777);
    assert_false(load_any(gltf_path("folder.gltf")));
    gltf_write("empty.gltf", "", 0);
    assert_false(load_any(gltf_path("empty.gltf")));
    gltf_write("line\nbreak.gltf", "{", 1); /* the name itself can't be kept, but the message is one line */
    lmg_error err = {{0}};
    lum_model *m;
    assert_true(lum_model_load(gltf_path("line\nbreak.gltf"), NULL, &m, &err) != LMG_OK);
    assert_null(strchr(err.message, '\n'));
    assert_int_equal(lum_model_load(NULL, NULL, &m, &err), LMG_ERROR_ARGUMENT);
}

/* -------------------------------------------------------------------------------------------------------- damaged files */

/* A little of everything: indexed, sparse, normalised, morphed, instanced, textured, lights and a camera. */
static char *everything(bool embedded, unsigned char *bin, size_t *bin_size)
{
    static const unsigned char texels[16] = {255, 0, 0, 255, 9, 99, 199, 255, 1, 2, 3, 4, 255, 255, 255, 0};
    static const float positions[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, delta[4][3] = {{0, 0, 0}};
    static const float uv[4][2] = {{0, 0}, {1, 0}, {0, 1}, {1, 1}}, shift[2][3] = {{0, 0, 0}, {2, 0, 0}};
    static const unsigned short indices[12] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}, sparse[2] = {1, 3};
    static const unsigned char colours[16] = {255, 255, 255, 255, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
    size_t png_size;
    unsigned char *png = gltf_png(texels, 2, 2, &png_size);
    memset(bin, 0, 512);
    memcpy(bin, positions, 48);
    memcpy(bin + 48, delta, 48);
    memcpy(bin + 96, uv, 32);
    memcpy(bin + 128, indices, 24);
    memcpy(bin + 152, sparse, 4);
    memcpy(bin + 156, shift, 24);
    memcpy(bin + 180, colours, 16);
    assert_true(png_size <= 300);
    memcpy(bin + 196, png, png_size);
    *bin_size = 196 + png_size;
    char *uri = gltf_data_uri(bin, *bin_size);
    char *text = gltf_text(
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_lights_punctual\"],\"buffers\":[{\"byteLength\":%zu%s%s%s}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":48},{\"buffer\":0,"
        "\"byteOffset\":96,\"byteLength\":32},"
        "{\"buffer\":0,\"byteOffset\":128,\"byteLength\":24},{\"buffer\":0,\"byteOffset\":152,\"byteLength\":4},{\"buffer\":0,"
        "\"byteOffset\":156,\"byteLength\":24},"
        "{\"buffer\":0,\"byteOffset\":180,\"byteLength\":16,\"byteStride\":4},{\"buffer\":0,\"byteOffset\":196,\"byteLength\":%zu}]"
        ","
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"sparse\":{\"count\":2,\"indices\":"
        "{\"bufferView\":4,"
        "\"componentType\":5123},\"values\":{\"bufferView\":5}}},{\"bufferView\":1,\"componentType\":5126,\"count\":4,\"type\":"
        "\"VEC3\"},"
        "{\"bufferView\":2,\"componentType\":5126,\"count\":4,\"type\":\"VEC2\"},{\"bufferView\":3,\"componentType\":5123,"
        "\"count\":12,\"type\":\"SCALAR\"},"
        "{\"bufferView\":5,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"},{\"bufferView\":6,\"componentType\":5121,"
        "\"normalized\":true,\"count\":4,\"type\":\"VEC4\"}],"
        "\"images\":[{\"bufferView\":7,\"mimeType\":\"image/"
        "png\"}],\"samplers\":[{\"wrapS\":33071}],\"textures\":[{\"source\":0,\"sampler\":0}],"
        "\"materials\":[{\"name\":\"glass\",\"normalTexture\":{\"index\":0},\"emissiveFactor\":[1,1,1],\"emissiveTexture\":{"
        "\"index\":0,\"extensions\":"
        "{\"KHR_texture_transform\":{\"scale\":[2,3]}}},\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1},"
        "\"KHR_materials_volume\":{\"thicknessFactor\":1,\"attenuationDistance\":2,\"attenuationColor\":[1,0.5,0]}}}],"
        "\"meshes\":[{\"name\":\"T\",\"weights\":[0.5],\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":2,\"COLOR_"
        "0\":5},\"indices\":3,"
        "\"material\":0,\"targets\":[{\"POSITION\":1}]},{\"attributes\":{\"POSITION\":1},\"mode\":5}]}],"
        "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":1,\"znear\":0.1}}],"
        "\"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"spot\",\"spot\":{}}]}},"
        "\"scene\":0,\"scenes\":[{\"nodes\":[0,2]}],\"nodes\":[{\"name\":\"a\",\"children\":[1],\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,"
        "0,0,0,0,1]},"
        "{\"mesh\":0,\"rotation\":[0,0,0,1],\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":4}}}},"
        "{\"camera\":0,\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}]}",
        *bin_size, embedded ? ",\"uri\":\"" : "", embedded ? uri : "", embedded ? "\"" : "", png_size);
    free(uri);
    free(png);
    return text;
}

static unsigned next_random(unsigned long long *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return (unsigned)(*state >> 33);
}

/* Cuts the file after every byte, then changes 1 to 4 bytes at a time: any byte to any other, or a digit to another, which keeps
 * the JSON valid more often. */
static void damage(const char *name, const unsigned char *bytes, size_t size)
{
    int loaded = 0, tried = 0;
    gltf_write(name, bytes, size);
    assert_true(load_any(gltf_path(name)));
    unsigned char *copy = malloc(size);
    assert_non_null(copy);
    for (size_t n = 0; n < size; n++) {
        gltf_write(name, bytes, n);
        loaded += load_any(gltf_path(name));
        tried++;
    }
    unsigned long long random = 2385;
    for (int i = 0; i < 2000; i++) {
        memcpy(copy, bytes, size);
        for (unsigned changes = 1 + next_random(&random) % 4; changes > 0; changes--) {
            size_t at = next_random(&random) % size;
            if (i % 2 == 0)
                copy[at] = (unsigned char)next_random(&random);
            else {
                for (size_t k = 0; k < size && (copy[at] < '0' || copy[at] > '9'); k++)
                    at = (at + 1) % size;
                copy[at] = "0123456789-"[next_random(&random) % 11];
            }
        }
        gltf_write(name, copy, size);
        loaded += load_any(gltf_path(name));
        tried++;
    }
    free(copy);
    print_message("%s: %d damaged copies, %d still load\n", name, tried, loaded);
}

static void damaged_text(void **state)
{
    (void)state;
    unsigned char bin[512];
    size_t bin_size;
    char *text = everything(true, bin, &bin_size);
    damage("damaged.gltf", (unsigned char *)text, strlen(text));
    free(text);
}

static void damaged_binary(void **state)
{
    (void)state;
    unsigned char bin[512];
    size_t bin_size, size;
    char *text = everything(false, bin, &bin_size);
    unsigned char *glb = gltf_glb(text, bin, bin_size, &size);
    damage("damaged.glb", glb, size);
    free(glb);
    free(text);
}

/* A picture that declares 100000 x 100000 pixels must be refused before anything is allocated for it. */
static void huge_image(void **state)
{
    (void)state;
    unsigned char bin[512];
    size_t bin_size, size;
    char *text = everything(false, bin, &bin_size);
    memcpy(bin + 196 + 16, "\x00\x01\x86\xa0\x00\x01\x86\xa0", 8);
    unsigned char *glb = gltf_glb(text, bin, bin_size, &size);
    gltf_write("huge.glb", glb, size);
    lmg_error err = {{0}};
    lum_model *m;
    assert_int_equal(lum_model_load(gltf_path("huge.glb"), NULL, &m, &err), LMG_ERROR_INPUT);
    assert_non_null(strstr(err.message, "100000 x 100000"));
    free(glb);
    free(text);
}

/* JSON nested far deeper than any stack. */
static void deep_json(void **state)
{
    (void)state;
    enum { DEPTH = 1000000 };
    char *text = malloc(DEPTH + 64);
    assert_non_null(text);
    int n = sprintf(text, "{\"asset\":{\"version\":\"2.0\"},\"extras\":");
    memset(text + n, '[', DEPTH);
    gltf_write("deep-json.gltf", text, (size_t)n + DEPTH);
    assert_false(load_any(gltf_path("deep-json.gltf")));
    free(text);
}

int main(void)
{
    gltf_folder("test_badgltf_files");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(real_files),     cmocka_unit_test(not_files),  cmocka_unit_test(damaged_text),
        cmocka_unit_test(damaged_binary), cmocka_unit_test(huge_image), cmocka_unit_test(deep_json),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
