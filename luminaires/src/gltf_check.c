/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The schema of glTF 2.0 and of the extensions that Lumibox reads, as tables, and the walk that holds a document against them.
 * What the tables don't know is removed.  Relies on jansson only.
 */
#include "gltf_check.h"
#include "text.h"

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

typedef enum kind {
    K_END,
    K_INTEGER, /* in [low, high] */
    K_NUMBER,  /* in [low, high] */
    K_BOOLEAN,
    K_STRING,
    K_CHOICE,    /* one of the strings in `text`, separated by '|' */
    K_INDEX,     /* of the top-level array `text` */
    K_INDICES,   /* several of them */
    K_INDEX_MAP, /* an object whose members are indices */
    K_INDEX_MAPS,
    K_NUMBERS, /* least..most of them, each in [low, high] */
    K_OBJECT,
    K_OBJECTS,
    K_EXTENSIONS /* an object; members that `members` doesn't know are noted as ignored */
} kind;

typedef struct rule {
    const char *key;
    kind kind;
    bool required;
    double low, high;
    size_t least, most;
    const char *text;
    const struct rule *members;
} rule;

#define ANY -INFINITY, INFINITY
#define FRACTION 0, 1
#define POSITIVE 0, INFINITY
#define FROM_ONE 1, INFINITY
/* The largest integer that a double, and so every JSON reader, keeps exactly. */
#define EXACT 9007199254740992.0
#define END                                                                                                                        \
    {                                                                                                                              \
        NULL, K_END, false, 0, 0, 0, 0, NULL, NULL                                                                                 \
    }
#define INTEGER(k, r, lo, hi)                                                                                                      \
    {                                                                                                                              \
        k, K_INTEGER, r, lo, hi, 0, 0, NULL, NULL                                                                                  \
    }
#define NUMBER(k, range) NUMBER_(k, range)
#define NUMBER_(k, lo, hi)                                                                                                         \
    {                                                                                                                              \
        k, K_NUMBER, false, lo, hi, 0, 0, NULL, NULL                                                                               \
    }
#define NUMBERS(k, n, range) NUMBERS__(k, n, range)
#define NUMBERS__(k, n, lo, hi) NUMBERS_(k, n, n, lo, hi)
#define NUMBERS_(k, a, b, lo, hi)                                                                                                  \
    {                                                                                                                              \
        k, K_NUMBERS, false, lo, hi, a, b, NULL, NULL                                                                              \
    }
#define BOOLEAN(k)                                                                                                                 \
    {                                                                                                                              \
        k, K_BOOLEAN, false, 0, 0, 0, 0, NULL, NULL                                                                                \
    }
#define STRING(k)                                                                                                                  \
    {                                                                                                                              \
        k, K_STRING, false, 0, 0, 0, 0, NULL, NULL                                                                                 \
    }
#define CHOICE(k, r, list)                                                                                                         \
    {                                                                                                                              \
        k, K_CHOICE, r, 0, 0, 0, 0, list, NULL                                                                                     \
    }
#define INDEX(k, r, array)                                                                                                         \
    {                                                                                                                              \
        k, K_INDEX, r, 0, 0, 0, 0, array, NULL                                                                                     \
    }
#define INDICES(k, array)                                                                                                          \
    {                                                                                                                              \
        k, K_INDICES, false, 0, 0, 0, 0, array, NULL                                                                               \
    }
#define INDEX_MAP(k, r, array)                                                                                                     \
    {                                                                                                                              \
        k, K_INDEX_MAP, r, 0, 0, 0, 0, array, NULL                                                                                 \
    }
#define INDEX_MAPS(k, array)                                                                                                       \
    {                                                                                                                              \
        k, K_INDEX_MAPS, false, 0, 0, 0, 0, array, NULL                                                                            \
    }
#define OBJECT(k, r, table)                                                                                                        \
    {                                                                                                                              \
        k, K_OBJECT, r, 0, 0, 0, 0, NULL, table                                                                                    \
    }
#define OBJECTS(k, r, table)                                                                                                       \
    {                                                                                                                              \
        k, K_OBJECTS, r, 0, 0, 0, 0, NULL, table                                                                                   \
    }
#define EXTENSIONS(table)                                                                                                          \
    {                                                                                                                              \
        "extensions", K_EXTENSIONS, false, 0, 0, 0, 0, NULL, table                                                                 \
    }

static const rule nothing[] = {END};
static const rule no_extensions[] = {EXTENSIONS(nothing), END};

static const rule transform_rules[] = {NUMBERS("offset", 2, ANY), NUMBER("rotation", ANY), NUMBERS("scale", 2, ANY),
                                       INTEGER("texCoord", false, 0, 255), END};
static const rule texture_use_extensions[] = {OBJECT("KHR_texture_transform", false, transform_rules), END};
static const rule texture_use_rules[] = {INDEX("index", true, "textures"), INTEGER("texCoord", false, 0, 255), NUMBER("scale", ANY),
                                         NUMBER("strength", ANY),          EXTENSIONS(texture_use_extensions), END};

static const rule emissive_strength_rules[] = {NUMBER("emissiveStrength", POSITIVE), END};
static const rule ior_rules[] = {NUMBER("ior", POSITIVE), END};
static const rule dispersion_rules[] = {NUMBER("dispersion", POSITIVE), END};
static const rule transmission_rules[] = {NUMBER("transmissionFactor", FRACTION),
                                          OBJECT("transmissionTexture", false, texture_use_rules), END};
static const rule volume_rules[] = {NUMBER("thicknessFactor", POSITIVE), OBJECT("thicknessTexture", false, texture_use_rules),
                                    NUMBER("attenuationDistance", POSITIVE), NUMBERS("attenuationColor", 3, FRACTION), END};
static const rule diffuse_transmission_rules[] = {NUMBER("diffuseTransmissionFactor", FRACTION),
                                                  OBJECT("diffuseTransmissionTexture", false, texture_use_rules),
                                                  NUMBERS("diffuseTransmissionColorFactor", 3, FRACTION),
                                                  OBJECT("diffuseTransmissionColorTexture", false, texture_use_rules), END};
static const rule specular_rules[] = {NUMBER("specularFactor", FRACTION), OBJECT("specularTexture", false, texture_use_rules),
                                      NUMBERS("specularColorFactor", 3, POSITIVE),
                                      OBJECT("specularColorTexture", false, texture_use_rules), END};
static const rule clearcoat_rules[] = {NUMBER("clearcoatFactor", FRACTION),
                                       OBJECT("clearcoatTexture", false, texture_use_rules),
                                       NUMBER("clearcoatRoughnessFactor", FRACTION),
                                       OBJECT("clearcoatRoughnessTexture", false, texture_use_rules),
                                       OBJECT("clearcoatNormalTexture", false, texture_use_rules),
                                       END};
static const rule sheen_rules[] = {NUMBERS("sheenColorFactor", 3, FRACTION), OBJECT("sheenColorTexture", false, texture_use_rules),
                                   NUMBER("sheenRoughnessFactor", FRACTION),
                                   OBJECT("sheenRoughnessTexture", false, texture_use_rules), END};
static const rule anisotropy_rules[] = {NUMBER("anisotropyStrength", FRACTION), NUMBER("anisotropyRotation", ANY),
                                        OBJECT("anisotropyTexture", false, texture_use_rules), END};
static const rule iridescence_rules[] = {NUMBER("iridescenceFactor", FRACTION),
                                         OBJECT("iridescenceTexture", false, texture_use_rules),
                                         NUMBER("iridescenceIor", FROM_ONE),
                                         NUMBER("iridescenceThicknessMinimum", POSITIVE),
                                         NUMBER("iridescenceThicknessMaximum", POSITIVE),
                                         OBJECT("iridescenceThicknessTexture", false, texture_use_rules),
                                         END};
static const rule material_extensions[] = {OBJECT("KHR_materials_emissive_strength", false, emissive_strength_rules),
                                           OBJECT("KHR_materials_ior", false, ior_rules),
                                           OBJECT("KHR_materials_dispersion", false, dispersion_rules),
                                           OBJECT("KHR_materials_transmission", false, transmission_rules),
                                           OBJECT("KHR_materials_volume", false, volume_rules),
                                           OBJECT("KHR_materials_diffuse_transmission", false, diffuse_transmission_rules),
                                           OBJECT("KHR_materials_specular", false, specular_rules),
                                           OBJECT("KHR_materials_clearcoat", false, clearcoat_rules),
                                           OBJECT("KHR_materials_sheen", false, sheen_rules),
                                           OBJECT("KHR_materials_anisotropy", false, anisotropy_rules),
                                           OBJECT("KHR_materials_iridescence", false, iridescence_rules),
                                           OBJECT("KHR_materials_unlit", false, nothing),
                                           END};
static const rule metallic_rules[] = {NUMBERS("baseColorFactor", 4, FRACTION),
                                      OBJECT("baseColorTexture", false, texture_use_rules),
                                      NUMBER("metallicFactor", FRACTION),
                                      NUMBER("roughnessFactor", FRACTION),
                                      OBJECT("metallicRoughnessTexture", false, texture_use_rules),
                                      EXTENSIONS(nothing),
                                      END};
static const rule material_rules[] = {STRING("name"),
                                      OBJECT("pbrMetallicRoughness", false, metallic_rules),
                                      OBJECT("normalTexture", false, texture_use_rules),
                                      OBJECT("emissiveTexture", false, texture_use_rules),
                                      NUMBERS("emissiveFactor", 3, POSITIVE),
                                      CHOICE("alphaMode", false, "OPAQUE|MASK|BLEND"),
                                      NUMBER("alphaCutoff", POSITIVE),
                                      BOOLEAN("doubleSided"),
                                      EXTENSIONS(material_extensions),
                                      END};

static const rule buffer_rules[] = {STRING("uri"), INTEGER("byteLength", true, 1, EXACT), EXTENSIONS(nothing), END};
static const rule view_rules[] = {INDEX("buffer", true, "buffers"),
                                  INTEGER("byteOffset", false, 0, EXACT),
                                  INTEGER("byteLength", true, 1, EXACT),
                                  INTEGER("byteStride", false, 4, 252),
                                  EXTENSIONS(nothing),
                                  END};
static const rule sparse_index_rules[] = {INDEX("bufferView", true, "bufferViews"), INTEGER("byteOffset", false, 0, 2147483647),
                                          INTEGER("componentType", true, 5121, 5125), END};
static const rule sparse_value_rules[] = {INDEX("bufferView", true, "bufferViews"), INTEGER("byteOffset", false, 0, 2147483647),
                                          END};
static const rule sparse_rules[] = {INTEGER("count", true, 1, 2147483647), OBJECT("indices", true, sparse_index_rules),
                                    OBJECT("values", true, sparse_value_rules), END};
static const rule accessor_rules[] = {INDEX("bufferView", false, "bufferViews"),
                                      INTEGER("byteOffset", false, 0, EXACT),
                                      INTEGER("componentType", true, 5120, 5126),
                                      BOOLEAN("normalized"),
                                      INTEGER("count", true, 1, 67108864),
                                      CHOICE("type", true, "SCALAR|VEC2|VEC3|VEC4|MAT2|MAT3|MAT4"),
                                      OBJECT("sparse", false, sparse_rules),
                                      EXTENSIONS(nothing),
                                      END};
static const rule primitive_rules[] = {INDEX_MAP("attributes", true, "accessors"),
                                       INDEX("indices", false, "accessors"),
                                       INDEX("material", false, "materials"),
                                       INTEGER("mode", false, 0, 6),
                                       INDEX_MAPS("targets", "accessors"),
                                       EXTENSIONS(nothing),
                                       END};
static const rule mesh_rules[] = {STRING("name"), OBJECTS("primitives", true, primitive_rules),
                                  NUMBERS_("weights", 0, SIZE_MAX, -INFINITY, INFINITY), EXTENSIONS(nothing), END};
static const rule node_light_rules[] = {INDEX("light", true, "lights"), END};
static const rule instancing_rules[] = {INDEX_MAP("attributes", true, "accessors"), END};
static const rule node_profile_rules[] = {INDEX("light", true, "profiles"), NUMBER("multiplier", POSITIVE),
                                          NUMBERS("color", 3, POSITIVE), END};
static const rule node_extensions[] = {OBJECT("KHR_lights_punctual", false, node_light_rules),
                                       OBJECT("EXT_lights_ies", false, node_profile_rules),
                                       OBJECT("EXT_mesh_gpu_instancing", false, instancing_rules), END};
static const rule node_rules[] = {STRING("name"),
                                  INDEX("mesh", false, "meshes"),
                                  INDEX("camera", false, "cameras"),
                                  INDEX("skin", false, "skins"),
                                  INDICES("children", "nodes"),
                                  NUMBERS("matrix", 16, ANY),
                                  NUMBERS("translation", 3, ANY),
                                  NUMBERS("rotation", 4, ANY),
                                  NUMBERS("scale", 3, ANY),
                                  NUMBERS_("weights", 0, SIZE_MAX, -INFINITY, INFINITY),
                                  EXTENSIONS(node_extensions),
                                  END};
static const rule scene_rules[] = {STRING("name"), INDICES("nodes", "nodes"), EXTENSIONS(nothing), END};
static const rule image_rules[] = {
    STRING("name"), STRING("uri"), STRING("mimeType"), INDEX("bufferView", false, "bufferViews"), EXTENSIONS(nothing), END};
static const rule sampler_rules[] = {INTEGER("magFilter", false, 9728, 9729),
                                     INTEGER("minFilter", false, 9728, 9987),
                                     INTEGER("wrapS", false, 10497, 33648),
                                     INTEGER("wrapT", false, 10497, 33648),
                                     EXTENSIONS(nothing),
                                     END};
/* A texture's source may be dangling: it matters only when a slot that moves light uses it, and is checked there. */
static const rule texture_rules[] = {INDEX("sampler", false, "samplers"), INTEGER("source", false, 0, 2147483647),
                                     EXTENSIONS(nothing), END};
static const rule perspective_rules[] = {{"yfov", K_NUMBER, true, 1e-6, 3.14159265358979, 0, 0, NULL, NULL},
                                         NUMBER("znear", POSITIVE),
                                         NUMBER("zfar", POSITIVE),
                                         NUMBER("aspectRatio", POSITIVE),
                                         EXTENSIONS(nothing),
                                         END};
static const rule orthographic_rules[] = {NUMBER("xmag", ANY),  NUMBER("ymag", ANY), NUMBER("zfar", ANY),
                                          NUMBER("znear", ANY), EXTENSIONS(nothing), END};
static const rule camera_rules[] = {STRING("name"),
                                    CHOICE("type", true, "perspective|orthographic"),
                                    OBJECT("perspective", false, perspective_rules),
                                    OBJECT("orthographic", false, orthographic_rules),
                                    EXTENSIONS(nothing),
                                    END};
static const rule spot_rules[] = {NUMBER("innerConeAngle", POSITIVE), NUMBER_("outerConeAngle", 0, 1.5707963267949), END};
static const rule light_rules[] = {STRING("name"),
                                   CHOICE("type", true, "point|spot|directional"),
                                   NUMBERS("color", 3, POSITIVE),
                                   NUMBER("intensity", POSITIVE),
                                   OBJECT("spot", false, spot_rules),
                                   EXTENSIONS(nothing),
                                   END};
static const rule lights_rules[] = {OBJECTS("lights", true, light_rules), END};
static const rule profile_rules[] = {STRING("name"), STRING("uri"), STRING("mimeType"), INDEX("bufferView", false, "bufferViews"), END};
static const rule profiles_rules[] = {OBJECTS("lights", true, profile_rules), END};
static const rule root_extensions[] = {OBJECT("KHR_lights_punctual", false, lights_rules),
                                       OBJECT("EXT_lights_ies", false, profiles_rules), END};
static const rule asset_rules[] = {STRING("version"), STRING("minVersion"), END};
static const rule root_rules[] = {OBJECT("asset", true, asset_rules),
                                  OBJECTS("buffers", false, buffer_rules),
                                  OBJECTS("bufferViews", false, view_rules),
                                  OBJECTS("accessors", false, accessor_rules),
                                  OBJECTS("images", false, image_rules),
                                  OBJECTS("samplers", false, sampler_rules),
                                  OBJECTS("textures", false, texture_rules),
                                  OBJECTS("materials", false, material_rules),
                                  OBJECTS("meshes", false, mesh_rules),
                                  OBJECTS("skins", false, no_extensions),
                                  OBJECTS("cameras", false, camera_rules),
                                  OBJECTS("nodes", false, node_rules),
                                  INDEX("scene", false, "scenes"),
                                  OBJECTS("scenes", false, scene_rules),
                                  EXTENSIONS(root_extensions),
                                  END};

/* Extensions a file may require.  KHR_mesh_quantization only widens the types that accessors may have; KHR_materials_variants
 * leaves the default materials in place; KHR_materials_unlit and animations pointers don't move light. */
static const char *const understood[] = {"KHR_texture_transform",  "KHR_materials_emissive_strength",
                                         "KHR_materials_ior",      "KHR_materials_transmission",
                                         "KHR_materials_volume",   "KHR_materials_diffuse_transmission",
                                          "KHR_materials_specular", "KHR_materials_clearcoat",
                                          "KHR_materials_sheen",    "KHR_materials_anisotropy",
                                          "KHR_materials_iridescence",
                                         "KHR_materials_unlit",    "KHR_lights_punctual",    "EXT_lights_ies",
                                         "KHR_mesh_quantization",  "KHR_materials_variants",
                                         "EXT_mesh_gpu_instancing", "KHR_materials_dispersion"};

typedef struct walk {
    const json_t *root;
    gltf_ignored *ignored;
    lmg_error *err;
    char path[256];
    size_t length; /* of path */
} walk;

static bool is_understood(const char *name)
{
    for (size_t i = 0; i < sizeof understood / sizeof *understood; i++)
        if (strcmp(name, understood[i]) == 0)
            return true;
    return false;
}

static void note_ignored(gltf_ignored *ignored, const char *name)
{
    for (uint32_t i = 0; i < ignored->count; i++)
        if (strncmp(ignored->names[i], name, sizeof ignored->names[i] - 1) == 0)
            return;
    if (ignored->count < GLTF_MAX_IGNORED)
        snprintf(ignored->names[ignored->count++], sizeof ignored->names[0], "%s", name);
}

/* Appends to the path; the caller restores w->length.  Paths of this schema are short: what doesn't fit is cut. */
static void push(walk *w, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    int n = vsnprintf(w->path + w->length, sizeof w->path - w->length, format, args);
    va_end(args);
    size_t room = sizeof w->path - w->length - 1;
    w->length += n < 0 ? 0 : (size_t)n < room ? (size_t)n : room;
}

static void pop(walk *w, size_t length)
{
    w->length = length;
    w->path[length] = 0;
}

static lmg_result bad(const walk *w, const char *format, ...)
{
    char text[256];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return lmg_fail(w->err, LMG_ERROR_INPUT, "%s: %s", *w->path ? w->path : "document", text);
}

/* Number of elements of a top-level array; "lights" and "profiles" (of EXT_lights_ies) live in extensions. */
static size_t array_size(const json_t *root, const char *name)
{
    const json_t *array = json_object_get(root, name);
    if (strcmp(name, "lights") == 0)
        array = json_object_get(json_object_get(json_object_get(root, "extensions"), "KHR_lights_punctual"), "lights");
    if (strcmp(name, "profiles") == 0)
        array = json_object_get(json_object_get(json_object_get(root, "extensions"), "EXT_lights_ies"), "lights");
    return json_array_size(array);
}

static lmg_result check_index(walk *w, const json_t *value, const char *array)
{
    if (!json_is_integer(value))
        return bad(w, "must be the index of one of the %s, an integer", array);
    json_int_t i = json_integer_value(value);
    size_t n = array_size(w->root, array);
    if (i < 0 || (uint64_t)i >= n)
        return bad(w, "index %" JSON_INTEGER_FORMAT " is outside the file's %zu %s; re-export the model", i, n, array);
    return LMG_OK;
}

static lmg_result check_number(walk *w, json_t *value, const rule *r)
{
    if (!json_is_number(value))
        return bad(w, "must be a number");
    double x = json_number_value(value);
    /* Exporters work in float: a factor of 1 may come out one rounding above.  Such values are set to the limit. */
    const double rounding = 0x1p-23;
    if (x < r->low - rounding || x > r->high + rounding)
        return bad(w, "%g is outside [%g, %g]", x, r->low, r->high);
    if (x < r->low || x > r->high) {
        if (json_is_real(value))
            json_real_set(value, x < r->low ? r->low : r->high);
    }
    return LMG_OK;
}

static bool is_choice(const char *list, const char *s)
{
    size_t n = strlen(s);
    for (const char *p = list; p; p = strchr(p, '|') ? strchr(p, '|') + 1 : NULL)
        if (strncmp(p, s, n) == 0 && (p[n] == '|' || p[n] == 0))
            return true;
    return false;
}

static lmg_result check_object(walk *w, json_t *object, const rule *rules);

static lmg_result check_index_map(walk *w, json_t *map, const char *array)
{
    if (!json_is_object(map))
        return bad(w, "must be an object");
    const char *key;
    json_t *value;
    json_object_foreach(map, key, value)
    {
        size_t length = w->length;
        push(w, ".%.40s", key);
        lmg_result r = check_index(w, value, array);
        if (r)
            return r;
        pop(w, length);
    }
    return LMG_OK;
}

/* The i-th element of an array in the path: `materials[3]`, with its name if it has one. */
static void push_element(walk *w, size_t i, const json_t *element)
{
    const char *name = json_string_value(json_object_get(element, "name"));
    if (name && *name)
        push(w, "[%zu] \"%.60s\"", i, name);
    else
        push(w, "[%zu]", i);
}

static lmg_result check_elements(walk *w, json_t *array, const rule *r)
{
    if (!json_is_array(array))
        return bad(w, "must be an array");
    size_t n = json_array_size(array);
    if (r->kind == K_NUMBERS && (n < r->least || n > r->most))
        return bad(w, "must have %zu numbers and has %zu", r->least, n);
    for (size_t i = 0; i < n; i++) {
        json_t *element = json_array_get(array, i);
        size_t length = w->length;
        push_element(w, i, element);
        lmg_result result = LMG_OK;
        if (r->kind == K_NUMBERS)
            result = check_number(w, element, r);
        else if (r->kind == K_INDICES)
            result = check_index(w, element, r->text);
        else if (r->kind == K_INDEX_MAPS)
            result = check_index_map(w, element, r->text);
        else
            result = check_object(w, element, r->members);
        if (result)
            return result;
        pop(w, length);
    }
    return LMG_OK;
}

static const rule *find_rule(const rule *rules, const char *key)
{
    for (; rules->kind != K_END; rules++)
        if (strcmp(rules->key, key) == 0)
            return rules;
    return NULL;
}

static lmg_result check_extensions(walk *w, json_t *object, const rule *known)
{
    if (!json_is_object(object))
        return bad(w, "must be an object");
    const char *key;
    json_t *value;
    void *next;
    json_object_foreach_safe(object, next, key, value)
    {
        if (find_rule(known, key))
            continue;
        if (!is_understood(key))
            note_ignored(w->ignored, key);
        json_object_del(object, key);
    }
    return check_object(w, object, known);
}

static lmg_result check_value(walk *w, json_t *value, const rule *r)
{
    switch (r->kind) {
    case K_INTEGER:
        if (!json_is_integer(value))
            return bad(w, "must be an integer");
        return check_number(w, value, r);
    case K_NUMBER:
        return check_number(w, value, r);
    case K_BOOLEAN:
        return json_is_boolean(value) ? LMG_OK : bad(w, "must be true or false");
    case K_STRING:
        return json_is_string(value) ? LMG_OK : bad(w, "must be a string");
    case K_CHOICE:
        if (!json_is_string(value))
            return bad(w, "must be one of %s", r->text);
        return is_choice(r->text, json_string_value(value))
                   ? LMG_OK
                   : bad(w, "\"%.40s\" is not one of %s", json_string_value(value), r->text);
    case K_INDEX:
        return check_index(w, value, r->text);
    case K_INDEX_MAP:
        return check_index_map(w, value, r->text);
    case K_INDICES:
    case K_INDEX_MAPS:
    case K_NUMBERS:
    case K_OBJECTS:
        return check_elements(w, value, r);
    case K_OBJECT:
        return check_object(w, value, r->members);
    case K_EXTENSIONS:
        return check_extensions(w, value, r->members);
    case K_END:
        break;
    }
    return LMG_OK;
}

static lmg_result check_object(walk *w, json_t *object, const rule *rules)
{
    if (!json_is_object(object))
        return bad(w, "must be an object");
    for (const rule *r = rules; r->kind != K_END; r++)
        if (r->required && !json_object_get(object, r->key))
            return bad(w, "\"%s\" is missing", r->key);
    const char *key;
    json_t *value;
    void *next;
    json_object_foreach_safe(object, next, key, value)
    {
        const rule *r = find_rule(rules, key);
        if (!r) {
            json_object_del(object, key);
            continue;
        }
        double x = json_real_value(value);
        bool integer = r->kind == K_INTEGER || r->kind == K_INDEX;
        if (integer && json_is_real(value) && x == floor(x) && fabs(x) < 9007199254740992.0) {
            json_object_set_new(object, key, json_integer((json_int_t)x));
            value = json_object_get(object, key);
        }
        size_t length = w->length;
        push(w, w->length ? ".%s" : "%s", r->key);
        lmg_result result = check_value(w, value, r);
        if (result)
            return result;
        pop(w, length);
    }
    return LMG_OK;
}

static lmg_result check_version(const json_t *root, lmg_error *err)
{
    const json_t *asset = json_object_get(root, "asset");
    if (!json_is_object(asset))
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "not a glTF 2.0 file: it has no \"asset\" object");
    const char *version = json_string_value(json_object_get(asset, "version"));
    const char *least = json_string_value(json_object_get(asset, "minVersion"));
    if (!version || !*version)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "not a glTF 2.0 file: its asset.version is missing, empty or not a string");
    if (strncmp(version, "2.", 2) != 0)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "glTF version %.16s is not supported; export the model as glTF 2.0", version);
    if (least && strcmp(least, "2.0") != 0)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "it requires glTF %.16s; export the model as glTF 2.0", least);
    return LMG_OK;
}

static lmg_result check_extension_lists(const json_t *root, gltf_ignored *ignored, lmg_error *err)
{
    static const char *const lists[] = {"extensionsRequired", "extensionsUsed"};
    for (int l = 0; l < 2; l++) {
        const json_t *list = json_object_get(root, lists[l]);
        if (list && !json_is_array(list))
            return lmg_fail(err, LMG_ERROR_INPUT, "%s: must be an array", lists[l]);
        for (size_t i = 0; i < json_array_size(list); i++) {
            const char *name = json_string_value(json_array_get(list, i));
            if (!name)
                return lmg_fail(err, LMG_ERROR_INPUT, "%s[%zu]: must be a string", lists[l], i);
            if (is_understood(name))
                continue;
            if (l == 0)
                return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                                "it requires the extension %.80s, which is not supported; export the model without it", name);
            note_ignored(ignored, name);
        }
    }
    return LMG_OK;
}

static lmg_result check_spots(const json_t *root, lmg_error *err)
{
    const json_t *lights = json_object_get(json_object_get(json_object_get(root, "extensions"), "KHR_lights_punctual"), "lights");
    for (size_t i = 0; i < json_array_size(lights); i++) {
        const json_t *light = json_array_get(lights, i);
        if (strcmp(json_string_value(json_object_get(light, "type")), "spot") == 0 && !json_object_get(light, "spot"))
            return lmg_fail(err, LMG_ERROR_INPUT,
                            "extensions.KHR_lights_punctual.lights[%zu]: a spot light needs the object \"spot\"", i);
    }
    return LMG_OK;
}

lmg_result gltf_check(json_t *root, gltf_ignored *ignored, lmg_error *err)
{
    memset(ignored, 0, sizeof *ignored);
    if (!json_is_object(root))
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "not a glTF file: the JSON text is not an object");
    lmg_result result = check_version(root, err);
    if (!result)
        result = check_extension_lists(root, ignored, err);
    if (result)
        return result;
    ignored->animations = (uint32_t)json_array_size(json_object_get(root, "animations"));
    walk w = {.root = root, .ignored = ignored, .err = err};
    result = check_object(&w, root, root_rules);
    if (!result)
        result = check_spots(root, err);
    json_object_del(root, "skins"); /* they had to be there to check that the nodes' skins exist */
    return result;
}

/* --------------------------------------------------------------------------------------------------------------- reach */

static uint64_t get(const json_t *object, const char *key)
{
    return (uint64_t)json_integer_value(json_object_get(object, key));
}

static uint64_t component_size(uint64_t type)
{
    switch (type) {
    case 5120: /* BYTE */
    case 5121:
        return 1;
    case 5122: /* SHORT */
    case 5123:
        return 2;
    case 5125: /* UNSIGNED_INT */
    case 5126: /* FLOAT */
        return 4;
    default:
        return 0;
    }
}

static uint64_t component_count(const char *type)
{
    static const struct {
        const char *name;
        uint64_t count;
    } types[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}, {"MAT2", 4}, {"MAT3", 9}, {"MAT4", 16}};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (strcmp(type, types[i].name) == 0)
            return types[i].count;
    return 0;
}

/* Whether count elements of `size` bytes, `stride` apart from offset on, lie within a view.  All numbers are below 2^53
 * (gltf_check), the stride below 2^8 and the count below 2^32, so nothing overflows 64 bits. */
static bool fits(const json_t *view, uint64_t offset, uint64_t count, uint64_t size, uint64_t stride)
{
    return offset + (count - 1) * stride + size <= get(view, "byteLength");
}

static lmg_result check_sparse(const json_t *root, const json_t *accessor, size_t i, uint64_t size, lmg_error *err)
{
    const json_t *sparse = json_object_get(accessor, "sparse");
    const json_t *views = json_object_get(root, "bufferViews");
    const json_t *indices = json_object_get(sparse, "indices"), *values = json_object_get(sparse, "values");
    uint64_t count = get(sparse, "count"), index_type = get(indices, "componentType");
    if (index_type != 5121 && index_type != 5123 && index_type != 5125)
        return lmg_fail(err, LMG_ERROR_INPUT, "accessors[%zu].sparse.indices.componentType: %" PRIu64 " is not an unsigned type", i,
                        index_type);
    if (count > get(accessor, "count"))
        return lmg_fail(err, LMG_ERROR_INPUT, "accessors[%zu].sparse: replaces %" PRIu64 " of %" PRIu64 " elements", i, count,
                        get(accessor, "count"));
    uint64_t index_size = component_size(index_type);
    const json_t *index_view = json_array_get(views, get(indices, "bufferView"));
    const json_t *value_view = json_array_get(views, get(values, "bufferView"));
    if (!fits(index_view, get(indices, "byteOffset"), count, index_size, index_size) ||
        !fits(value_view, get(values, "byteOffset"), count, size, size))
        return lmg_fail(err, LMG_ERROR_INPUT, "accessors[%zu].sparse: reaches past the end of its buffer view; re-export the model",
                        i);
    return LMG_OK;
}

/* Indices must come from a buffer: all zeros would be no triangles. */
static lmg_result check_index_views(const json_t *root, lmg_error *err)
{
    const json_t *meshes = json_object_get(root, "meshes"), *accessors = json_object_get(root, "accessors");
    for (size_t i = 0; i < json_array_size(meshes); i++) {
        const json_t *primitives = json_object_get(json_array_get(meshes, i), "primitives");
        for (size_t j = 0; j < json_array_size(primitives); j++) {
            const json_t *indices = json_object_get(json_array_get(primitives, j), "indices");
            if (indices && !json_object_get(json_array_get(accessors, (size_t)json_integer_value(indices)), "bufferView"))
                return lmg_fail(err, LMG_ERROR_INPUT,
                                "meshes[%zu].primitives[%zu].indices: accessor %" PRIu64 " has no buffer view; re-export the model",
                                i, j, (uint64_t)json_integer_value(indices));
        }
    }
    return LMG_OK;
}

lmg_result gltf_check_reach(const json_t *root, lmg_error *err)
{
    const json_t *buffers = json_object_get(root, "buffers"), *views = json_object_get(root, "bufferViews");
    const json_t *accessors = json_object_get(root, "accessors");
    for (size_t i = 0; i < json_array_size(views); i++) {
        const json_t *v = json_array_get(views, i);
        uint64_t buffer = get(v, "buffer"), end = get(v, "byteOffset") + get(v, "byteLength");
        uint64_t length = get(json_array_get(buffers, buffer), "byteLength");
        if (get(v, "byteStride") % 4)
            return lmg_fail(err, LMG_ERROR_INPUT,
                            "bufferViews[%zu].byteStride: %" PRIu64 " is not a multiple of 4; re-export the model", i,
                            get(v, "byteStride"));
        if (end > length)
            return lmg_fail(err, LMG_ERROR_INPUT,
                            "bufferViews[%zu]: ends at byte %" PRIu64 " of buffer %" PRIu64 ", which has %" PRIu64
                            "; the file is damaged, re-export the model",
                            i, end, buffer, length);
    }
    LUM_TRY(check_index_views(root, err));
    for (size_t i = 0; i < json_array_size(accessors); i++) {
        const json_t *a = json_array_get(accessors, i);
        uint64_t component = component_size(get(a, "componentType"));
        if (component == 0)
            return lmg_fail(err, LMG_ERROR_INPUT, "accessors[%zu].componentType: %" PRIu64 " is not a type of glTF", i,
                            get(a, "componentType"));
        uint64_t size = component * component_count(json_string_value(json_object_get(a, "type")));
        const json_t *index = json_object_get(a, "bufferView");
        if (index) {
            const json_t *view = json_array_get(views, (size_t)json_integer_value(index));
            uint64_t stride = json_object_get(view, "byteStride") ? get(view, "byteStride") : size;
            if (!fits(view, get(a, "byteOffset"), get(a, "count"), size, stride))
                return lmg_fail(err, LMG_ERROR_INPUT,
                                "accessors[%zu]: %" PRIu64 " elements of %" PRIu64
                                " bytes reach past the end of buffer view %" PRIu64 "; the file is damaged, re-export the model",
                                i, get(a, "count"), size, get(a, "bufferView"));
        }
        if (json_object_get(a, "sparse")) {
            lmg_result r = check_sparse(root, a, i, size, err);
            if (r)
                return r;
        }
    }
    return LMG_OK;
}
