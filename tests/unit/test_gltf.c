/* SPDX-License-Identifier: Apache-2.0 */
/* What lum_model_load makes of glTF files, feature by feature, on files written here. */
#include "gltf_writer.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#define ASSET "\"asset\":{\"version\":\"2.0\"}"
#define ONE_NODE "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"name\":\"N\"}]"

/* Tolerance of quantities computed from float positions of about 1 m: some roundings of 2^-24 each. */
static const double rounding = 16 * 0x1p-24;

/* A document with one mesh: `data` in one buffer, the rest as text. */
static char *document(const void *data, size_t size, const char *views_accessors, const char *rest)
{
    char *uri = gltf_data_uri(data, size);
    char *text = gltf_text("{" ASSET ",\"buffers\":[{\"byteLength\":%zu,\"uri\":\"%s\"}],%s,%s}", size, uri, views_accessors, rest);
    free(uri);
    return text;
}

static void corner(const lum_model *m, uint32_t t, int k, double x[3])
{
    for (int i = 0; i < 3; i++)
        x[i] = m->unit * (double)m->positions[3 * m->indices[3 * t + (uint32_t)k] + (uint32_t)i];
}

/* Area vector sum of all triangles: their mean front direction. */
static void area_sum(const lum_model *m, double n[3])
{
    n[0] = n[1] = n[2] = 0;
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        double a[3], b[3], c[3];
        corner(m, t, 0, a);
        corner(m, t, 1, b);
        corner(m, t, 2, c);
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            n[i] += ((b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j])) / 2;
        }
    }
}

static void assert_close(double a, double b, double tolerance)
{
    if (!(fabs(a - b) <= tolerance))
        fail_msg("%.17g is not within %g of %.17g", a, tolerance, b);
}

/* ---------------------------------------------------------------------------------------------------------- topologies */

/* A unit square of four corners, in the order that each topology needs to cover it once, front to +z. */
static void topologies(void **state)
{
    (void)state;
    static const struct {
        int mode;
        int count;
        unsigned char order[6];
    } cases[] = {{4, 6, {0, 1, 2, 0, 2, 3}}, {5, 4, {0, 1, 3, 2}}, {6, 4, {0, 1, 2, 3}}};
    static const float square[4][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    static const int types[] = {0, 5121, 5123, 5125}; /* 0: not indexed */
    for (size_t c = 0; c < 3; c++)
        for (size_t k = 0; k < 4; k++) {
            unsigned char data[6 * 12 + 24] = {0};
            int size = types[k] == 5121 ? 1 : types[k] == 5123 ? 2 : 4, n = cases[c].count;
            for (int i = 0; i < n; i++) {
                memcpy(data + 12 * i, square[types[k] ? i % 4 : cases[c].order[i]], 12);
                data[72 + size * i] = cases[c].order[i]; /* little-endian whatever the size */
            }
            char *accessors =
                gltf_text("\"bufferViews\":[{\"buffer\":0,\"byteLength\":72},{\"buffer\":0,\"byteOffset\":72,\"byteLength\":24}],"
                          "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":%d,\"type\":\"VEC3\"},"
                          "{\"bufferView\":1,\"componentType\":%d,\"count\":%d,\"type\":\"SCALAR\"}]",
                          types[k] ? 4 : n, types[k] ? types[k] : 5121, n);
            char *rest = gltf_text("\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},%s\"mode\":%d}]}]," ONE_NODE,
                                   types[k] ? "\"indices\":1," : "", cases[c].mode);
            char *text = document(data, sizeof data, accessors, rest);
            lum_model *m = gltf_load("topology.gltf", text, NULL);
            assert_int_equal(m->triangle_count, 2);
            assert_int_equal(m->part_count, 1);
            double n3[3];
            area_sum(m, n3);
            assert_close(n3[0], 0, rounding);
            assert_close(n3[1], 0, rounding);
            assert_close(n3[2], 1, rounding);
            assert_close(m->parts[0].area, 1, rounding);
            assert_int_equal(m->parts[0].boundary_edges, 4);
            assert_close(m->centre.x, 0.5, 0);
            assert_false(m->parts[0].has_normals);
            for (uint32_t v = 0; v < m->vertex_count; v++)
                assert_close((double)m->normals[3 * v + 2], 1, 0);
            lum_model_destroy(m);
            free(accessors);
            free(rest);
            free(text);
        }
}

/* ------------------------------------------------------------------------------------------------------- a tetrahedron */

/* Corner of the unit cube: volume 1/6, fronts outward, indexed. */
static const float tetrahedron[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
static const unsigned short tetrahedron_indices[12] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};

#define TETRAHEDRON                                                                                                                \
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":24}],"                       \
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"                                      \
    "{\"bufferView\":1,\"componentType\":5123,\"count\":12,\"type\":\"SCALAR\"}]"
#define TETRAHEDRON_MESH "\"meshes\":[{\"name\":\"T\",\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}]"

static char *tetrahedron_document(const char *rest)
{
    unsigned char data[72];
    memcpy(data, tetrahedron, 48);
    memcpy(data + 48, tetrahedron_indices, 24);
    return document(data, sizeof data, TETRAHEDRON, rest);
}

static lum_model *load_tetrahedron(const char *nodes)
{
    char *rest = gltf_text(TETRAHEDRON_MESH ",%s", nodes);
    char *text = tetrahedron_document(rest);
    lum_model *m = gltf_load("tetrahedron.gltf", text, NULL);
    free(rest);
    free(text);
    return m;
}

static void closed_mesh(void **state)
{
    (void)state;
    lum_model *m = load_tetrahedron(ONE_NODE);
    assert_int_equal(m->triangle_count, 4);
    assert_int_equal(m->parts[0].boundary_edges, 0);
    assert_close(m->parts[0].enclosed_volume, 1.0 / 6, rounding);
    assert_close(m->parts[0].area, 1.5 + sqrt(3) / 2, rounding);
    assert_string_equal(m->parts[0].node, "N");
    assert_string_equal(m->parts[0].mesh, "T");
    assert_string_equal(m->materials[m->parts[0].material].name, "default material");
    lum_model_destroy(m);
}

/* Fronts stay fronts under transforms that mirror: the enclosed volume stays positive. */
static void mirroring(void **state)
{
    (void)state;
    static const struct {
        const char *node;
        double volume;
    } cases[] = {
        {"{\"mesh\":0,\"scale\":[-1,1,1]}", 1.0 / 6},
        {"{\"mesh\":0,\"scale\":[-2,-3,-0.5]}", 3.0 / 6},
        {"{\"mesh\":0,\"scale\":[-1,-1,1]}", 1.0 / 6},
        {"{\"mesh\":0,\"matrix\":[0,1,0,0, 1,0,0,0, 0,0,1,0, 3,4,5,1]}", 1.0 / 6},
        {"{\"children\":[1],\"scale\":[1,-1,1]},{\"mesh\":0,\"rotation\":[0.5,0.5,0.5,0.5],\"scale\":[1,1,-2]}", 2.0 / 6},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char *nodes = gltf_text("\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[%s]", cases[i].node);
        lum_model *m = load_tetrahedron(nodes);
        assert_close(m->parts[0].enclosed_volume, cases[i].volume, cases[i].volume * rounding);
        lum_model_destroy(m);
        free(nodes);
    }
}

/* A rotation by 90 degrees about z takes x to y; parents apply after children; the centre is found in double. */
static void transforms(void **state)
{
    (void)state;
    lum_model *m = load_tetrahedron(
        "\"scene\":0,\"scenes\":[{\"nodes\":[1]}],\"nodes\":[{\"mesh\":0,\"scale\":[2,1,1]},"
        "{\"children\":[0],\"translation\":[40000.1,0,-7],\"rotation\":[0,0,0.70710678118654757,0.70710678118654757]}]");
    /* Local x (2 long) goes to +y, local y to -x. */
    assert_close(m->centre.x, 40000.1 - 0.5, 1e-10);
    assert_close(m->centre.y, 1, 1e-15);
    assert_close(m->centre.z, -6.5, 1e-15);
    assert_close(m->bounds_max.x - m->bounds_min.x, 1, rounding);
    assert_close(m->bounds_max.y - m->bounds_min.y, 2, 2 * rounding);
    assert_close(m->parts[0].enclosed_volume, 2.0 / 6, rounding);
    lum_model_destroy(m);
}

static void scenes(void **state)
{
    (void)state;
    lum_model *m = load_tetrahedron(
        "\"scenes\":[{\"nodes\":[1]},{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[5,0,0]}]");
    assert_close(m->centre.x, 5.5, rounding);
    lum_model_destroy(m);
    m = load_tetrahedron(
        "\"scene\":1,\"scenes\":[{\"nodes\":[1]},{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[5,0,0]}]");
    assert_close(m->centre.x, 0.5, rounding);
    lum_model_destroy(m);
    m = load_tetrahedron("\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[5,0,0]}]");
    assert_int_equal(m->part_count, 2);
    assert_true(gltf_warned(m, "no scene"));
    lum_model_destroy(m);
}

static void degenerate_and_repeated(void **state)
{
    (void)state;
    /* The last two triangles of the tetrahedron's index list are replaced: by one without area and by a repeat of the first. */
    unsigned char data[72];
    memcpy(data, tetrahedron, 48);
    memcpy(data + 48, (const unsigned short[12]){0, 2, 1, 0, 1, 3, 0, 1, 1, 2, 1, 0}, 24);
    char *text = document(data, sizeof data, TETRAHEDRON, TETRAHEDRON_MESH "," ONE_NODE);
    lum_model *m = gltf_load("degenerate.gltf", text, NULL);
    assert_int_equal(m->triangle_count, 2);
    assert_true(gltf_warned(m, "1 triangle without area"));
    assert_true(gltf_warned(m, "1 triangle repeats"));
    assert_int_equal(m->parts[0].boundary_edges, 4);
    lum_model_destroy(m);
    free(text);
}

/* ----------------------------------------------------------------------------------------------------------- accessors */

static void sparse(void **state)
{
    (void)state;
    /* Vertex 3 of the square moves from (0,1,0) to (0,2,0) by a sparse replacement: the area becomes 1.5. */
    struct {
        float positions[4][3];
        unsigned short indices[2];
        float values[2][3];
    } data = {{{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}, {0, 3}, {{0, 0, 0}, {0, 2, 0}}};
    static const char *const views =
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":4},"
        "{\"buffer\":0,\"byteOffset\":52,\"byteLength\":24}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"sparse\":{\"count\":2,"
        "\"indices\":{\"bufferView\":1,\"componentType\":5123},\"values\":{\"bufferView\":2}}}]";
    static const char *const rest = "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":6}]}]," ONE_NODE;
    char *text = document(&data, sizeof data, views, rest);
    lum_model *m = gltf_load("sparse.gltf", text, NULL);
    assert_close(m->parts[0].area, 1.5, rounding);
    lum_model_destroy(m);
    free(text);
    static const unsigned short wrong[2][2] = {{3, 0}, {0, 4}}; /* out of order, out of range */
    for (int i = 0; i < 2; i++) {
        memcpy(data.indices, wrong[i], sizeof wrong[i]);
        text = document(&data, sizeof data, views, rest);
        assert_non_null(strstr(gltf_refuse("sparse.gltf", text, NULL, LMG_ERROR_INPUT), "sparse index"));
        free(text);
    }
}

static void quantized(void **state)
{
    (void)state;
    /* Unsigned shorts, interleaved with stride 8 and a normalised byte normal; the node's scale restores metres. */
    struct {
        unsigned short x[3];
        unsigned short gap;
        signed char n[4];
    } data[4] = {{{0, 0, 0}, 9, {0, 0, 127, 0}},
                 {{1000, 0, 0}, 9, {0, 0, 127, 0}},
                 {{1000, 500, 0}, 9, {0, 0, 127, 0}},
                 {{0, 500, 0}, 9, {0, 0, 127, 0}}};
    char *text =
        document(data, sizeof data,
                 "\"extensionsUsed\":[\"KHR_mesh_quantization\"],\"extensionsRequired\":[\"KHR_mesh_quantization\"],"
                 "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48,\"byteStride\":12}],"
                 "\"accessors\":[{\"bufferView\":0,\"componentType\":5123,\"count\":4,\"type\":\"VEC3\"},"
                 "{\"bufferView\":0,\"byteOffset\":8,\"componentType\":5120,\"normalized\":true,\"count\":4,\"type\":\"VEC3\"}]",
                 "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"NORMAL\":1},\"mode\":6}]}],"
                 "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"scale\":[0.001,0.001,0.001]}]");
    lum_model *m = gltf_load("quantized.gltf", text, NULL);
    assert_close(m->bounds_max.x - m->bounds_min.x, 1, rounding);
    assert_close(m->bounds_max.y - m->bounds_min.y, 0.5, rounding);
    assert_true(m->parts[0].has_normals);
    assert_int_equal(m->vertex_count, 4);
    assert_close((double)m->normals[2], 1, 0);
    lum_model_destroy(m);
    free(text);
}

static void colours(void **state)
{
    (void)state;
    struct {
        float positions[3][3];
        unsigned char rgb[3][4];
    } data = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{255, 0, 51, 0}, {0, 255, 0, 0}, {0, 0, 255, 0}}};
    char *text = document(
        &data, sizeof data,
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":12,\"byteStride\":4}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"
        "{\"bufferView\":1,\"componentType\":5121,\"normalized\":true,\"count\":3,\"type\":\"VEC3\"}]",
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"COLOR_0\":1}},{\"attributes\":{\"POSITION\":0}}]}]"
        "," ONE_NODE);
    lum_model *m = gltf_load("colours.gltf", text, NULL);
    assert_non_null(m->colors);
    assert_close((double)m->colors[0], 1, 0);
    assert_close((double)m->colors[2], 0.2, 1e-7);
    assert_close((double)m->colors[3], 1, 0); /* no alpha in the file */
    for (int i = 0; i < 12; i++)              /* the second primitive has none: white */
        assert_close((double)m->colors[12 + i], 1, 0);
    lum_model_destroy(m);
    free(text);
}

static void morphs_and_instances(void **state)
{
    (void)state;
    struct {
        float positions[3][3];
        float delta[3][3];
        float shift[2][3];
    } data = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 0, 0}, {2, 0, 0}, {0, 0, 0}}, {{0, 0, 0}, {0, 0, 10}}};
    static const char *const views =
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":36},"
        "{\"buffer\":0,\"byteOffset\":72,\"byteLength\":24}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"
        "{\"bufferView\":1,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":2,\"componentType\":5126,"
        "\"count\":2,\"type\":\"VEC3\"}]";
    char *text = document(
        &data, sizeof data, views,
        "\"meshes\":[{\"weights\":[0.5],\"primitives\":[{\"attributes\":{\"POSITION\":0},\"targets\":[{\"POSITION\":1}]}]}],"
        "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"translation\":[0,0,1],\"extensions\":"
        "{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":2}}}}]");
    lum_model *m = gltf_load("morph.gltf", text, NULL);
    assert_int_equal(m->part_count, 2);
    assert_close(m->parts[0].area, 1, rounding); /* the base grew from 1 to 2 */
    assert_close(m->centre.z, 6, rounding);      /* instances at z 1 and 11 */
    lum_model_destroy(m);
    free(text);
}

/* ----------------------------------------------------------------------------------------------------------- materials */

static lum_model *load_material(const char *material, const char *more)
{
    char *rest =
        gltf_text("\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0}]}]," ONE_NODE
                  ",\"materials\":[{\"name\":\"M\"%s%s}]%s",
                  *material ? "," : "", material, more);
    char *text = tetrahedron_document(rest);
    lum_model *m = gltf_load("material.gltf", text, NULL);
    free(rest);
    free(text);
    assert_int_equal(m->material_count, 1);
    return m;
}

static void material_defaults(void **state)
{
    (void)state;
    lum_model *m = load_material("", "");
    const lum_material *a = &m->materials[0];
    assert_string_equal(a->name, "M");
    assert_int_equal(a->kind, LUM_SURFACE_PBR);
    for (int i = 0; i < 4; i++)
        assert_close((double)a->base_color[i], 1, 0);
    assert_close((double)a->metallic, 1, 0);
    assert_close((double)a->roughness, 1, 0);
    assert_close((double)a->ior, 1.5, 0);
    assert_close((double)a->transmission, 0, 0);
    assert_int_equal(a->alpha_mode, LUM_ALPHA_OPAQUE);
    assert_false(a->double_sided);
    assert_int_equal(a->base_texture.image, LUM_NONE);
    assert_true(gltf_warned(m, "nothing in it emits light"));
    lum_model_destroy(m);
}

static void material_values(void **state)
{
    (void)state;
    lum_model *m = load_material(
        "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.1,0.2,0.3,0.4],\"metallicFactor\":0.25,\"roughnessFactor\":0.75},"
        "\"emissiveFactor\":[1,0.5,0.25],\"alphaMode\":\"BLEND\",\"alphaCutoff\":0.3,\"doubleSided\":true,\"extensions\":{"
        "\"KHR_materials_emissive_strength\":{\"emissiveStrength\":1000},\"KHR_materials_ior\":{\"ior\":1.7},"
        "\"KHR_materials_transmission\":{\"transmissionFactor\":0.5},\"KHR_materials_diffuse_transmission\":{"
        "\"diffuseTransmissionFactor\":0.125},"
        "\"KHR_materials_volume\":{\"thicknessFactor\":0.01,\"attenuationDistance\":0.5,\"attenuationColor\":[0.5,0.25,1]},"
        "\"KHR_materials_nothing_known\":{}}",
        "");
    const lum_material *a = &m->materials[0];
    for (int i = 0; i < 4; i++)
        assert_close((double)a->base_color[i], 0.1 * (i + 1), 1e-7);
    assert_close((double)a->metallic, 0.25, 0);
    assert_close((double)a->roughness, 0.75, 0);
    assert_close((double)a->emissive[0], 1000, 0);
    assert_close((double)a->emissive[2], 250, 0);
    assert_int_equal(a->alpha_mode, LUM_ALPHA_BLEND);
    assert_true(a->double_sided && a->emits_back);
    assert_close((double)a->ior, 1.7, 1e-6);
    assert_close((double)a->transmission, 0.5, 0);
    assert_close((double)a->diffuse_transmission, 0.125, 0);
    assert_false(a->thin);
    assert_close((double)a->absorption[0], log(2) / 0.5, 1e-6);
    assert_close((double)a->absorption[1], log(4) / 0.5, 1e-6);
    assert_close((double)a->absorption[2], 0, 0);
    assert_true(gltf_warned(m, "KHR_materials_nothing_known"));
    lum_model_destroy(m);
    m = load_material("\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1}}", "");
    assert_true(m->materials[0].thin); /* no volume: infinitely thin, as the extension says */
    lum_model_destroy(m);
}

static void material_layers(void **state)
{
    (void)state;
    lum_model *m =
        load_material("\"extensions\":{\"KHR_materials_specular\":{\"specularFactor\":0.25,\"specularColorFactor\":[0.5,1,2]},"
                      "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":0.75,\"clearcoatRoughnessFactor\":0.125},"
                      "\"KHR_materials_sheen\":{\"sheenColorFactor\":[0.25,0.5,1],\"sheenRoughnessFactor\":0.375},"
                      "\"KHR_materials_anisotropy\":{\"anisotropyStrength\":0.5,\"anisotropyRotation\":1.5},"
                      "\"KHR_materials_iridescence\":{\"iridescenceFactor\":0.625,\"iridescenceIor\":1.375,"
                      "\"iridescenceThicknessMinimum\":50,\"iridescenceThicknessMaximum\":450}}",
                      "");
    const lum_layers *l = &m->materials[0].layers;
    assert_int_equal(l->present, 31);
    assert_close((double)l->specular, 0.25, 0);
    assert_close((double)l->specular_color[2], 2, 0);
    assert_close((double)l->clearcoat, 0.75, 0);
    assert_close((double)l->clearcoat_roughness, 0.125, 0);
    assert_close((double)l->sheen_color[1], 0.5, 0);
    assert_close((double)l->sheen_roughness, 0.375, 0);
    assert_close((double)l->anisotropy, 0.5, 0);
    assert_close((double)l->anisotropy_rotation, 1.5, 0);
    assert_close((double)l->iridescence, 0.625, 0);
    assert_close((double)l->iridescence_ior, 1.375, 0);
    assert_close((double)l->thickness_min, 50, 0);
    assert_close((double)l->thickness_max, 450, 0);
    assert_false(gltf_warned(m, "KHR_materials"));
    lum_model_destroy(m);
    /* The extensions' defaults are no layers. */
    m = load_material("\"extensions\":{\"KHR_materials_specular\":{},\"KHR_materials_clearcoat\":{},\"KHR_materials_sheen\":{},"
                      "\"KHR_materials_anisotropy\":{},\"KHR_materials_iridescence\":{}}",
                      "");
    assert_int_equal(m->materials[0].layers.present, 0);
    lum_model_destroy(m);
}

static void layers_out_of_range(void **state)
{
    (void)state;
    static const struct {
        const char *extension, *says;
    } bad[] = {
        {"\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1.5}", "clearcoatFactor"},
        {"\"KHR_materials_clearcoat\":{\"clearcoatRoughnessFactor\":-0.5}", "clearcoatRoughnessFactor"},
        {"\"KHR_materials_sheen\":{\"sheenColorFactor\":[0,2,0]}", "sheenColorFactor"},
        {"\"KHR_materials_sheen\":{\"sheenRoughnessFactor\":7}", "sheenRoughnessFactor"},
        {"\"KHR_materials_anisotropy\":{\"anisotropyStrength\":-1}", "anisotropyStrength"},
        {"\"KHR_materials_specular\":{\"specularFactor\":2}", "specularFactor"},
        {"\"KHR_materials_specular\":{\"specularColorFactor\":[-1,0,0]}", "specularColorFactor"},
        {"\"KHR_materials_iridescence\":{\"iridescenceIor\":0.5}", "iridescenceIor"},
        {"\"KHR_materials_iridescence\":{\"iridescenceFactor\":1,\"iridescenceIor\":9}", "[1, 4]"},
        {"\"KHR_materials_iridescence\":{\"iridescenceFactor\":1,\"iridescenceThicknessMaximum\":1e6}", "nanometre"},
        {"\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1,\"clearcoatTexture\":{\"index\":5}}", "index"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        char *rest =
            gltf_text("\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0}]}]," ONE_NODE
                      ",\"materials\":[{\"name\":\"M\",\"extensions\":{%s}}]",
                      bad[i].extension);
        char *text = tetrahedron_document(rest);
        const char *message = gltf_refuse("layers.gltf", text, NULL, LMG_ERROR_INPUT);
        if (!strstr(message, bad[i].says))
            fail_msg("case %zu: %s", i, message);
        free(rest);
        free(text);
    }
}

/* ------------------------------------------------------------------------------------------------------------ textures */

static lum_model *load_textured(const char *use, const char *sampler)
{
    static const unsigned char texels[16] = {255, 0, 0, 255, 128, 128, 128, 64, 0, 0, 255, 255, 255, 255, 255, 0};
    struct {
        float positions[3][3], uv[3][2];
    } data = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1}, {1, 1}, {0, 0}}};
    size_t size;
    unsigned char *png = gltf_png(texels, 2, 2, &size);
    char *image = gltf_data_uri(png, size);
    char *rest = gltf_text("\"images\":[{\"uri\":\"%s\"}],\"samplers\":[%s],\"textures\":[{\"source\":0,\"sampler\":0}],"
                           "\"materials\":[{%s}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1},"
                           "\"material\":0}]}]," ONE_NODE,
                           image, sampler, use);
    char *text = document(&data, sizeof data,
                          "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":24}],"
                          "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"
                          "{\"bufferView\":1,\"componentType\":5126,\"count\":3,\"type\":\"VEC2\"}]",
                          rest);
    lum_model *m = gltf_load("textured.gltf", text, NULL);
    free(png);
    free(image);
    free(rest);
    free(text);
    return m;
}

static void fetch(const lum_model *m, const lum_texture *t, double u, double v, double r, double g, double b, double a)
{
    const float uv[2] = {(float)u, (float)v};
    const double expected[4] = {r, g, b, a};
    float rgba[4];
    lum_texture_fetch(m, t, uv, uv, rgba);
    for (int i = 0; i < 4; i++)
        assert_close((double)rgba[i], expected[i], 4 * 0x1p-24);
}

static void textures(void **state)
{
    (void)state;
    double grey = pow((128 / 255.0 + 0.055) / 1.055, 2.4);
    lum_model *m = load_textured(
        "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0},\"metallicRoughnessTexture\":{\"index\":0}}", "{}");
    assert_int_equal(m->image_count, 2); /* sRGB and linear */
    const lum_texture *t = &m->materials[0].base_texture;
    fetch(m, t, 0.25, 0.25, 1, 0, 0, 1); /* centres of the four texels; (0,0) is above and left */
    fetch(m, t, 0.75, 0.25, grey, grey, grey, 64 / 255.0);
    fetch(m, t, 0.25, 0.75, 0, 0, 1, 1);
    fetch(m, t, 0.5, 0.25, (1 + grey) / 2, grey / 2, grey / 2, (1 + 64 / 255.0) / 2);
    fetch(m, t, 1.25, -0.75, 1, 0, 0, 1);                                           /* repeats */
    fetch(m, t, 0, 0.25, (1 + grey) / 2, grey / 2, grey / 2, (1 + 64 / 255.0) / 2); /* across the border */
    fetch(m, &m->materials[0].metal_rough_texture, 0.75, 0.25, 128 / 255.0, 128 / 255.0, 128 / 255.0, 64 / 255.0);
    lum_model_destroy(m);

    m = load_textured("\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
                      "{\"wrapS\":33071,\"wrapT\":33648,\"magFilter\":9728}");
    t = &m->materials[0].base_texture;
    fetch(m, t, -3, 0.1, 1, 0, 0, 1);                  /* clamped */
    fetch(m, t, 9, 0.1, grey, grey, grey, 64 / 255.0); /* clamped, nearest */
    fetch(m, t, 0.1, 1.1, 0, 0, 1, 1);                 /* mirrored: the lower row again */
    fetch(m, t, 0.1, 1.9, 1, 0, 0, 1);                 /* and the upper one */
    fetch(m, t, 0.1, -0.1, 1, 0, 0, 1);
    lum_model_destroy(m);
}

/* KHR_texture_transform: uv is scaled, then rotated, then shifted.  The sense of the rotation is fixed by Khronos'
 * TextureTransformTest: with a rotation of 22.5 degrees the texel in the direction of 45 degrees is to be seen at 67.5 degrees, so
 * (u,v) turns by minus the angle. */
static void texture_transform(void **state)
{
    (void)state;
    lum_model *m =
        load_textured("\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,\"extensions\":{\"KHR_texture_transform\":"
                      "{\"offset\":[0.5,0.25],\"rotation\":1.5707963267948966,\"scale\":[2,3]}}}}",
                      "{}");
    const lum_texture *t = &m->materials[0].base_texture;
    /* (u,v) -> (2u,3v) -> by 90 degrees (3v,-2u) -> (3v+0.5, -2u+0.25) */
    const double expected[2][3] = {{0, 3, 0.5}, {-2, 0, 0.25}};
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 3; j++)
            assert_close((double)t->m[i][j], expected[i][j], 1e-7);
    lum_model_destroy(m);
}

/* A picture upright on a square facing +z: the tangent is +x, and normal x tangent times w is up. */
static void tangents(void **state)
{
    (void)state;
    lum_model *m = load_textured("\"normalTexture\":{\"index\":0,\"scale\":0.5}", "{}");
    assert_non_null(m->tangents);
    assert_close((double)m->materials[0].normal_scale, 0.5, 0);
    for (uint32_t v = 0; v < m->vertex_count; v++) {
        const float expected[4] = {1, 0, 0, 1};
        for (int i = 0; i < 4; i++)
            assert_close((double)m->tangents[4 * v + (uint32_t)i], (double)expected[i], 0);
    }
    lum_model_destroy(m);
    m = load_textured("\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}", "{}");
    assert_null(m->tangents);
    lum_model_destroy(m);
}

/* -------------------------------------------------------------------------------------------------- lights and cameras */

static void lights_and_cameras(void **state)
{
    (void)state;
    lum_model *m = gltf_load(
        "lights.gltf",
        "{" ASSET ",\"extensionsUsed\":[\"KHR_lights_punctual\"],\"extensions\":{\"KHR_lights_punctual\":{\"lights\":["
        "{\"type\":\"point\",\"name\":\"P\",\"intensity\":20,\"color\":[1,0.5,0]},"
        "{\"type\":\"spot\",\"intensity\":3,\"spot\":{\"innerConeAngle\":0.1,\"outerConeAngle\":0.3}},"
        "{\"type\":\"directional\",\"intensity\":5}]}},"
        "\"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":0.8,\"znear\":0.1}}],"
        "\"scene\":0,\"scenes\":[{\"nodes\":[0,1,2,3]}],\"nodes\":["
        "{\"name\":\"a\",\"translation\":[1,2,3],\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}},"
        "{\"name\":\"b\",\"translation\":[3,2,3],\"rotation\":[-0.70710678118654757,0,0,0.70710678118654757],\"extensions\":{\"KHR_"
        "lights_punctual\":{\"light\":1}}},"
        "{\"name\":\"c\",\"translation\":[0,900,0],\"extensions\":{\"KHR_lights_punctual\":{\"light\":2}}},"
        "{\"name\":\"eye\",\"camera\":0,\"translation\":[0,1,7],\"rotation\":[0,0.70710678118654757,0,0.70710678118654757]}]}",
        NULL);
    assert_int_equal(m->light_count, 3);
    assert_close(m->centre.x, 2, 0); /* between the point and the spot; the directional light has no place */
    assert_close(m->lights[0].position.x, -1, 0);
    assert_string_equal(m->lights[0].name, "P");
    assert_close((double)m->lights[0].intensity[1], 10, 0);
    assert_int_equal(m->lights[1].kind, LUM_LIGHT_SPOT);
    assert_string_equal(m->lights[1].name, "b");
    assert_close(m->lights[1].direction.y, -1, 1e-15); /* -z turned by -90 degrees about x points down */
    assert_close(m->lights[1].cos_inner, cos(0.1), 1e-15);
    assert_close(m->lights[1].cos_outer, cos(0.3), 1e-15);
    assert_int_equal(m->lights[2].kind, LUM_LIGHT_DIRECTIONAL);
    assert_int_equal(m->camera_count, 1);
    assert_close(m->cameras[0].eye.z, 7, 0);
    assert_close(m->cameras[0].forward.x, -1, 1e-15);
    assert_close(m->cameras[0].up.y, 1, 1e-15);
    assert_close(m->cameras[0].yfov, 0.8, 0);
    lum_model_destroy(m);
}

/* ---------------------------------------------------------------------------------------------------- files and errors */

static void binary_and_external(void **state)
{
    (void)state;
    unsigned char data[72];
    memcpy(data, tetrahedron, 48);
    memcpy(data + 48, tetrahedron_indices, 24);
    static const char *const json =
        "{" ASSET ",\"buffers\":[{\"byteLength\":72%s}]," TETRAHEDRON "," TETRAHEDRON_MESH "," ONE_NODE "}";
    lmg_error err = {{0}};
    lum_model *m;
    char *text = gltf_text(json, "");
    size_t size;
    unsigned char *glb = gltf_glb(text, data, sizeof data, &size);
    gltf_write("t.glb", glb, size);
    assert_int_equal(lum_model_load(gltf_path("t.glb"), NULL, &m, &err), LMG_OK);
    assert_int_equal(m->triangle_count, 4);
    uint64_t hash = m->hash;
    lum_model_destroy(m);
    glb[size - 30] ^= 1; /* a bit of the positions */
    gltf_write("t.glb", glb, size);
    assert_int_equal(lum_model_load(gltf_path("t.glb"), NULL, &m, &err), LMG_OK);
    assert_true(m->hash != hash);
    lum_model_destroy(m);
    free(glb);
    free(text);

    /* File names with spaces, plus and percent signs and other alphabets, as URIs are written. */
    text = gltf_text(json, ",\"uri\":\"a%20b+c%25%C3%A4.bin\"");
    gltf_write("a b+c%\xc3\xa4.bin", data, sizeof data);
    m = gltf_load("external.gltf", text, NULL);
    assert_int_equal(m->triangle_count, 4);
    hash = m->hash;
    lum_model_destroy(m);
    data[0] = 1;
    gltf_write("a b+c%\xc3\xa4.bin", data, sizeof data);
    m = gltf_load("external.gltf", text, NULL);
    assert_true(m->hash != hash); /* the hash covers external buffers */
    lum_model_destroy(m);
    gltf_write("a b+c%\xc3\xa4.bin", data, sizeof data - 1);
    assert_non_null(strstr(gltf_refuse("external.gltf", text, NULL, LMG_ERROR_FILE_READ), "71 bytes"));
    free(text);
}

static void errors(void **state)
{
    (void)state;
    static const struct {
        const char *nodes, *says;
        lmg_result result;
    } cases[] = {
        {"\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":1}]",
         "nodes[0].mesh: index 1 is outside the file's 1 meshes", LMG_ERROR_INPUT},
        {"\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"a\",\"children\":[1]},{\"name\":\"b\",\"children\":[0]}]",
         "ancestor", LMG_ERROR_INPUT},
        {"\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"scale\":[1,2]}]", "nodes[0].scale: must have 3 numbers",
         LMG_ERROR_INPUT},
        {"\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"scale\":[1e300,1e300,1e300]}]", "from the origin",
         LMG_ERROR_INPUT},
        {"\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"big\",\"children\":[1],\"scale\":[1e300,1,1]},{\"name\":"
         "\"in\",\"mesh\":0,\"scale\":[1e300,1,1]}]",
         "node \"in\": its transform is not finite", LMG_ERROR_INPUT},
        {"\"extensionsRequired\":[\"KHR_draco_mesh_compression\"]", "KHR_draco_mesh_compression", LMG_ERROR_UNSUPPORTED},
        {"\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"mesh\":0}]", "duplicate", LMG_ERROR_FILE_FORMAT},
        {"\"nodes\":\"x\"", "nodes: must be an array", LMG_ERROR_INPUT},
        {"\"materials\":[{\"name\":\"lens\",\"pbrMetallicRoughness\":{\"roughnessFactor\":-0.2}}]",
         "materials[0] \"lens\".pbrMetallicRoughness.roughnessFactor: -0.2 is outside [0, 1]", LMG_ERROR_INPUT},
        {"\"images\":[{\"uri\":\"http://x/y.png\"}]", "not beside the model", LMG_ERROR_UNSUPPORTED},
        {"\"images\":[{\"uri\":\"/etc/x.png\"}]", "absolute path", LMG_ERROR_INPUT},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char *rest = gltf_text(TETRAHEDRON_MESH ",%s", cases[i].nodes);
        char *text = tetrahedron_document(rest);
        const char *message = gltf_refuse("error.gltf", text, NULL, cases[i].result);
        if (!strstr(message, cases[i].says))
            fail_msg("case %zu: %s", i, message);
        free(rest);
        free(text);
    }
    unsigned char data[72];
    memcpy(data, tetrahedron, 48);
    memcpy(data + 48, tetrahedron_indices, 24);
    data[48] = 77;
    char *text = document(data, sizeof data, TETRAHEDRON, TETRAHEDRON_MESH "," ONE_NODE);
    assert_string_equal(gltf_refuse("index.gltf", text, NULL, LMG_ERROR_INPUT),
                        "index.gltf: mesh \"T\" primitive 0: index 77 is outside its 4 vertices; re-export the mesh");
    free(text);
    float nan = NAN;
    memcpy(data + 12, &nan, 4);
    text = document(data, sizeof data, TETRAHEDRON, TETRAHEDRON_MESH "," ONE_NODE);
    assert_non_null(
        strstr(gltf_refuse("nan.gltf", text, NULL, LMG_ERROR_INPUT), "mesh \"T\" primitive 0: POSITION: vertex 1 is not finite"));
    free(text);
    /* A missing picture of a slot that moves light is an error; of one that doesn't, nothing. */
    char *rest = gltf_text(
        "\"images\":[{\"uri\":\"gone.png\"}],\"textures\":[{\"source\":0}],\"materials\":[{\"occlusionTexture\":{\"index\":0}}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0}]}]," ONE_NODE);
    text = tetrahedron_document(rest);
    lum_model_destroy(gltf_load("gone.gltf", text, NULL));
    free(text);
    char *used = strstr(rest, "occlusionTexture");
    memcpy(used, "normalTexture\"  ", 16); /* spaces keep the length */
    memmove(used + 14, ":   ", 4);
    text = tetrahedron_document(rest);
    assert_non_null(strstr(gltf_refuse("gone.gltf", text, NULL, LMG_ERROR_FILE_OPEN), "gone.png"));
    free(text);
    free(rest);
}

/* Deep hierarchies end in an error, not in an overflowing stack. */
static void depth(void **state)
{
    (void)state;
    enum { DEPTH = 5000 };
    char *nodes = malloc(64 * DEPTH), *out = nodes;
    assert_non_null(nodes);
    out += sprintf(out, "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[");
    for (int i = 0; i + 1 < DEPTH; i++)
        out += sprintf(out, "{\"children\":[%d]},", i + 1);
    sprintf(out, "{\"mesh\":0}]");
    char *rest = gltf_text(TETRAHEDRON_MESH ",%s", nodes);
    char *text = tetrahedron_document(rest);
    assert_non_null(strstr(gltf_refuse("deep.gltf", text, NULL, LMG_ERROR_INPUT), "nested deeper"));
    free(nodes);
    free(rest);
    free(text);
}

/* Names of any length and content stay one line of UTF-8 in messages. */
static void long_names(void **state)
{
    (void)state;
    char name[400] = "";
    for (int i = 0; i < 120; i++)
        strcat(name, "\xc3\xa4"); /* a two-byte letter, so that cuts at even and odd places meet its middle */
    for (int shift = 0; shift < 2; shift++) {
        char *rest = gltf_text(
            "\"meshes\":[{\"name\":\"%s%s\\n\",\"primitives\":[{\"attributes\":{\"NORMAL\":0},\"indices\":1}]}]," ONE_NODE,
            shift ? "x" : "", name);
        char *text = tetrahedron_document(rest);
        const char *message = gltf_refuse("names.gltf", text, NULL, LMG_ERROR_INPUT);
        assert_non_null(strstr(message, "has no POSITION"));
        for (const unsigned char *c = (const unsigned char *)message; *c; c++) {
            if (*c == 0xc3)
                assert_int_equal(*++c, 0xa4);
            else
                assert_true(*c >= 0x20 && *c < 0x7f);
        }
        free(rest);
        free(text);
    }
}

int main(void)
{
    gltf_folder("test_gltf_files");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(topologies),
        cmocka_unit_test(closed_mesh),
        cmocka_unit_test(mirroring),
        cmocka_unit_test(transforms),
        cmocka_unit_test(scenes),
        cmocka_unit_test(degenerate_and_repeated),
        cmocka_unit_test(sparse),
        cmocka_unit_test(quantized),
        cmocka_unit_test(colours),
        cmocka_unit_test(morphs_and_instances),
        cmocka_unit_test(material_defaults),
        cmocka_unit_test(material_values),
        cmocka_unit_test(material_layers),
        cmocka_unit_test(layers_out_of_range),
        cmocka_unit_test(textures),
        cmocka_unit_test(texture_transform),
        cmocka_unit_test(tangents),
        cmocka_unit_test(lights_and_cameras),
        cmocka_unit_test(binary_and_external),
        cmocka_unit_test(errors),
        cmocka_unit_test(depth),
        cmocka_unit_test(long_names),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
