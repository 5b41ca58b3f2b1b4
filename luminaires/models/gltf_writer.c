/* SPDX-License-Identifier: Apache-2.0 */
/* Writes glTF 2.0 for make_models, JSON through jansson; see gltf_writer.h. */
#include "gltf_writer.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct gltf_file {
    const char *name;
    json_t *nodes, *meshes, *materials, *cameras, *lights, *accessors, *views, *extensions;
    unsigned char *buffer;
    size_t size, room;
};

static void die(const char *what)
{
    fprintf(stderr, "make_models: %s\n", what);
    exit(1);
}

static json_t *vector(const double *v, size_t count)
{
    json_t *array = json_array();
    for (size_t i = 0; i < count; i++) {
        json_array_append_new(array, json_real(v[i]));
    }
    return array;
}

static void append(gltf_file *file, const void *data, size_t size)
{
    if (file->size + size > file->room) {
        file->room = 2 * (file->size + size);
        file->buffer = realloc(file->buffer, file->room);
        if (!file->buffer) {
            die("out of memory");
        }
    }
    memcpy(file->buffer + file->size, data, size);
    file->size += size;
}

/* glTF wants little-endian; so do all machines that Embree runs on. */
static void append_float(gltf_file *file, double value)
{
    float f = (float)value;
    append(file, &f, sizeof f);
}

static size_t add_view(gltf_file *file, size_t start, int target)
{
    json_array_append_new(file->views, json_pack("{s:i, s:I, s:I, s:i}", "buffer", 0, "byteOffset", (json_int_t)start, "byteLength",
                                                 (json_int_t)(file->size - start), "target", target));
    return json_array_size(file->views) - 1;
}

static size_t add_accessor(gltf_file *file, size_t view, int component, size_t count, const char *type, json_t *low, json_t *high)
{
    json_t *accessor = json_pack("{s:I, s:i, s:I, s:s}", "bufferView", (json_int_t)view, "componentType", component, "count",
                                 (json_int_t)count, "type", type);
    if (low) {
        json_object_set_new(accessor, "min", low);
        json_object_set_new(accessor, "max", high);
    }
    json_array_append_new(file->accessors, accessor);
    return json_array_size(file->accessors) - 1;
}

static void use_extension(gltf_file *file, json_t *extensions, const char *name, json_t *value)
{
    json_object_set_new(extensions, name, value);
    for (size_t i = 0; i < json_array_size(file->extensions); i++) {
        if (!strcmp(json_string_value(json_array_get(file->extensions, i)), name)) {
            return;
        }
    }
    json_array_append_new(file->extensions, json_string(name));
}

static size_t add_material(gltf_file *file, const gltf_material *m)
{
    for (size_t i = 0; i < json_array_size(file->materials); i++) {
        if (!strcmp(json_string_value(json_object_get(json_array_get(file->materials, i), "name")), m->name)) {
            return i;
        }
    }
    double rgba[4] = {m->color[0], m->color[1], m->color[2], 1};
    json_t *material = json_pack("{s:s, s:{s:o, s:f, s:f}}", "name", m->name, "pbrMetallicRoughness", "baseColorFactor", vector(rgba, 4),
                                 "metallicFactor", m->metallic, "roughnessFactor", m->roughness);
    json_t *extensions = json_object();
    if (m->luminance > 0) {
        const double *c = m->emission_color;
        double y = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2], most = fmax(c[0], fmax(c[1], c[2]));
        double factor[3] = {c[0] / most, c[1] / most, c[2] / most};
        json_object_set_new(material, "emissiveFactor", vector(factor, 3));
        use_extension(file, extensions, "KHR_materials_emissive_strength", json_pack("{s:f}", "emissiveStrength", m->luminance * most / y));
    }
    if (m->diffuse_transmission > 0) {
        use_extension(file, extensions, "KHR_materials_diffuse_transmission",
                      json_pack("{s:f, s:o}", "diffuseTransmissionFactor", m->diffuse_transmission, "diffuseTransmissionColorFactor",
                                vector(m->color, 3)));
    }
    if (m->ior > 0) {
        use_extension(file, extensions, "KHR_materials_transmission", json_pack("{s:f}", "transmissionFactor", 1.0));
        use_extension(file, extensions, "KHR_materials_volume", json_pack("{s:f}", "thicknessFactor", m->thickness));
        use_extension(file, extensions, "KHR_materials_ior", json_pack("{s:f}", "ior", m->ior));
        if (m->abbe > 0) {
            use_extension(file, extensions, "KHR_materials_dispersion", json_pack("{s:f}", "dispersion", 20 / m->abbe));
        }
    }
    if (json_object_size(extensions) > 0) {
        json_object_set(material, "extensions", extensions);
    }
    json_decref(extensions);
    if (m->double_sided) {
        json_object_set_new(material, "doubleSided", json_true());
    }
    json_array_append_new(file->materials, material);
    return json_array_size(file->materials) - 1;
}

gltf_file *gltf_begin(const char *name)
{
    gltf_file *file = calloc(1, sizeof *file);
    if (!file) {
        die("out of memory");
    }
    file->name = name;
    file->nodes = json_array();
    file->meshes = json_array();
    file->materials = json_array();
    file->cameras = json_array();
    file->lights = json_array();
    file->accessors = json_array();
    file->views = json_array();
    file->extensions = json_array();
    return file;
}

void gltf_add(gltf_file *file, const char *node, const mesh *m, const gltf_material *material)
{
    enum { ARRAY_BUFFER = 34962, ELEMENT_ARRAY_BUFFER = 34963, FLOAT = 5126, UNSIGNED_INT = 5125 };
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    size_t start = file->size;
    for (size_t i = 0; i < m->vertex_count; i++) {
        for (int k = 0; k < 3; k++) {
            double value = (double)(float)m->vertices[i].position[k];
            low[k] = fmin(low[k], value);
            high[k] = fmax(high[k], value);
            append_float(file, value);
        }
    }
    size_t positions = add_accessor(file, add_view(file, start, ARRAY_BUFFER), FLOAT, m->vertex_count, "VEC3", vector(low, 3),
                                    vector(high, 3));
    start = file->size;
    for (size_t i = 0; i < m->vertex_count; i++) {
        for (int k = 0; k < 3; k++) {
            append_float(file, m->vertices[i].normal[k]);
        }
    }
    size_t normals = add_accessor(file, add_view(file, start, ARRAY_BUFFER), FLOAT, m->vertex_count, "VEC3", NULL, NULL);
    start = file->size;
    append(file, m->indices, m->index_count * sizeof *m->indices);
    size_t indices = add_accessor(file, add_view(file, start, ELEMENT_ARRAY_BUFFER), UNSIGNED_INT, m->index_count, "SCALAR", NULL, NULL);

    json_t *primitive = json_pack("{s:{s:I, s:I}, s:I, s:I}", "attributes", "POSITION", (json_int_t)positions, "NORMAL",
                                  (json_int_t)normals, "indices", (json_int_t)indices, "material",
                                  (json_int_t)add_material(file, material));
    json_array_append_new(file->meshes, json_pack("{s:s, s:[o]}", "name", node, "primitives", primitive));
    json_array_append_new(file->nodes, json_pack("{s:s, s:I}", "name", node, "mesh", (json_int_t)json_array_size(file->meshes) - 1));
}

/* Matrix of a node at eye that looks along -Z to target with +Y up, in columns: z = eye - target, x = up cross z, y = z cross x. */
static json_t *looking_at(const double eye[3], const double target[3])
{
    double z[3] = {eye[0] - target[0], eye[1] - target[1], eye[2] - target[2]};
    double length = sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2]);
    for (int i = 0; i < 3; i++) {
        z[i] /= length;
    }
    double across = hypot(z[2], z[0]), x[3] = {z[2] / across, 0, -z[0] / across};
    double y[3] = {z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]};
    double matrix[16] = {x[0], x[1], x[2], 0, y[0], y[1], y[2], 0, z[0], z[1], z[2], 0, eye[0], eye[1], eye[2], 1};
    return vector(matrix, 16);
}

void gltf_add_camera(gltf_file *file, const char *name, const double eye[3], const double target[3], double yfov, double aspect)
{
    json_array_append_new(file->cameras,
                          json_pack("{s:s, s:s, s:{s:f, s:f, s:f, s:f}}", "name", name, "type", "perspective", "perspective", "yfov",
                                    yfov, "aspectRatio", aspect, "znear", 0.01, "zfar", 100.0));
    json_array_append_new(file->nodes, json_pack("{s:s, s:I, s:o}", "name", name, "camera",
                                                 (json_int_t)json_array_size(file->cameras) - 1, "matrix", looking_at(eye, target)));
}

void gltf_add_spot(gltf_file *file, const char *name, const double eye[3], const double target[3], double candela, double cone)
{
    static const char *const extension = "KHR_lights_punctual";
    json_array_append_new(file->lights, json_pack("{s:s, s:s, s:f, s:{s:f, s:f}}", "name", name, "type", "spot", "intensity", candela,
                                                  "spot", "innerConeAngle", 0.999 * cone, "outerConeAngle", cone));
    json_t *extensions = json_object();
    use_extension(file, extensions, extension, json_pack("{s:I}", "light", (json_int_t)json_array_size(file->lights) - 1));
    json_array_append_new(file->nodes, json_pack("{s:s, s:o, s:o}", "name", name, "matrix", looking_at(eye, target), "extensions", extensions));
}

void gltf_end(gltf_file *file, const char *folder)
{
    char path[4096], uri[256];
    snprintf(uri, sizeof uri, "%s.bin", file->name);
    json_t *roots = json_array();
    for (size_t i = 0; i < json_array_size(file->nodes); i++) {
        json_array_append_new(roots, json_integer((json_int_t)i));
    }
    json_t *root = json_pack("{s:{s:s, s:s}, s:i, s:[{s:s, s:o}], s:o, s:o, s:o, s:o, s:o, s:[{s:s, s:I}]}", "asset", "version", "2.0",
                             "generator", "Lumibox make_models", "scene", 0, "scenes", "name", file->name, "nodes", roots, "nodes",
                             file->nodes, "meshes", file->meshes, "materials", file->materials, "accessors", file->accessors,
                             "bufferViews", file->views, "buffers", "uri", uri, "byteLength", (json_int_t)file->size);
    if (!root) {
        die("can't put the JSON together");
    }
    if (json_array_size(file->cameras) > 0) {
        json_object_set(root, "cameras", file->cameras);
    }
    if (json_array_size(file->lights) > 0) {
        json_object_set_new(root, "extensions", json_pack("{s:{s:O}}", "KHR_lights_punctual", "lights", file->lights));
    }
    if (json_array_size(file->extensions) > 0) {
        json_object_set(root, "extensionsUsed", file->extensions);
    }
    snprintf(path, sizeof path, "%s/%s.gltf", folder, file->name);
    if (json_dump_file(root, path, JSON_INDENT(1) | JSON_REAL_PRECISION(10)) != 0) {
        fprintf(stderr, "make_models: can't write %s\n", path);
        exit(1);
    }
    snprintf(path, sizeof path, "%s/%s.bin", folder, file->name);
    FILE *stream = fopen(path, "wb");
    bool written = stream && fwrite(file->buffer, 1, file->size, stream) == file->size;
    if (stream && fclose(stream) != 0) {
        written = false;
    }
    if (!written) {
        fprintf(stderr, "make_models: can't write %s\n", path);
        exit(1);
    }
    json_decref(root);
    json_decref(file->cameras);
    json_decref(file->lights);
    json_decref(file->extensions);
    free(file->buffer);
    free(file);
}

void gltf_chromaticity(double x, double y, double rgb[3])
{
    /* XYZ to linear Rec.709 with its D65 white (IEC 61966-2-1). */
    double X = x / y, Z = (1 - x - y) / y;
    rgb[0] = 3.2404542 * X - 1.5371385 - 0.4985314 * Z;
    rgb[1] = -0.9692660 * X + 1.8760108 + 0.0415560 * Z;
    rgb[2] = 0.0556434 * X - 0.2040259 + 1.0572252 * Z;
}
