/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A glTF document as plain C structs, in the terms and defaults of the glTF 2.0 specification: nothing is converted or judged here.
 * Filled by gltf_shim.cpp with tinygltf.  tinygltf trusts its input, so it only ever sees a document that gltf_check.c has passed:
 * every index in these structs is in range or -1, every accessor lies within its buffer.
 */
#ifndef LUMINAIRES_GLTF_SHIM_H
#define LUMINAIRES_GLTF_SHIM_H

#include <lumigraph/lumigraph.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct gltf_bytes {
    const uint8_t *data;
    size_t size;
} gltf_bytes;

typedef struct gltf_view {
    int32_t buffer;
    uint64_t offset, length, stride; /* bytes; stride 0 = tightly packed */
} gltf_view;

typedef struct gltf_accessor {
    int32_t view; /* -1: zeros */
    uint64_t offset, count;
    int32_t component_type; /* 5120 BYTE .. 5126 FLOAT */
    int32_t components;     /* 1 SCALAR, 2..4 VECn; matrices 4, 9, 16 */
    bool normalized;
    uint64_t sparse_count; /* 0 = not sparse */
    int32_t sparse_index_view, sparse_index_type, sparse_value_view;
    uint64_t sparse_index_offset, sparse_value_offset;
} gltf_accessor;

typedef struct gltf_sampler {
    int32_t mag_filter, min_filter, wrap_s, wrap_t; /* filters -1 = not given */
} gltf_sampler;

typedef struct gltf_texture {
    int32_t sampler, image; /* -1 = none */
} gltf_texture;

/* A use of a texture: index -1 = none.  strength: normal scale, where it applies. */
typedef struct gltf_texture_use {
    int32_t texture, coordinates;
    double strength;
    double offset[2], rotation, scale[2]; /* KHR_texture_transform */
} gltf_texture_use;

typedef struct gltf_material {
    const char *name;
    double base_color[4], metallic, roughness;
    gltf_texture_use base_texture, metal_rough_texture, normal_texture, emissive_texture;
    double emissive[3], emissive_strength;
    int32_t alpha_mode; /* 0 OPAQUE, 1 MASK, 2 BLEND */
    double alpha_cutoff;
    bool double_sided, unlit;
    double ior;
    bool has_ior;
    double dispersion; /* 20 / Abbe number; 0 = none */
    double transmission;
    gltf_texture_use transmission_texture;
    bool has_volume;
    double thickness, attenuation_distance, attenuation_color[3]; /* distance INFINITY = none */
    gltf_texture_use thickness_texture;
    double diffuse_transmission, diffuse_transmission_color[3];
    gltf_texture_use diffuse_transmission_texture, diffuse_transmission_color_texture;
    double specular, specular_color[3];
    gltf_texture_use specular_texture, specular_color_texture;
    double clearcoat, clearcoat_roughness;
    gltf_texture_use clearcoat_texture, clearcoat_roughness_texture, clearcoat_normal_texture;
    double sheen_color[3], sheen_roughness;
    gltf_texture_use sheen_color_texture, sheen_roughness_texture;
    double anisotropy, anisotropy_rotation;
    gltf_texture_use anisotropy_texture;
    double iridescence, iridescence_ior, iridescence_thickness_min, iridescence_thickness_max; /* nm */
    gltf_texture_use iridescence_texture, iridescence_thickness_texture;
} gltf_material;

typedef struct gltf_morph_target {
    int32_t position, normal;
} gltf_morph_target;

typedef struct gltf_primitive {
    int32_t mode; /* 0 points .. 4 triangles, 5 strip, 6 fan */
    int32_t indices, material;
    int32_t position, normal, tangent, uv[2], color;
    const gltf_morph_target *targets;
    uint32_t target_count;
} gltf_primitive;

typedef struct gltf_mesh {
    const char *name;
    const gltf_primitive *primitives;
    uint32_t primitive_count;
    const double *weights;
    uint32_t weight_count;
} gltf_mesh;

typedef struct gltf_node {
    const char *name;
    int32_t mesh, camera, light, skin;
    const int32_t *children;
    uint32_t child_count;
    bool has_matrix;
    double matrix[16];                            /* column by column */
    double translation[3], rotation[4], scale[3]; /* rotation: quaternion x,y,z,w */
    const double *weights;
    uint32_t weight_count;
    int32_t instance_translation, instance_rotation, instance_scale; /* EXT_mesh_gpu_instancing accessors, -1 = none */
    bool instanced;
    int32_t profile; /* EXT_lights_ies: index of the photometric file, -1 = none */
    double profile_multiplier, profile_color[3];
} gltf_node;

typedef struct gltf_light {
    const char *name;
    int32_t kind;                             /* 0 point, 1 spot, 2 directional */
    double color[3], intensity, inner, outer; /* cone angles, radians */
} gltf_light;

typedef struct gltf_camera {
    const char *name;
    bool perspective;
    double yfov;
} gltf_camera;

typedef struct gltf_scene {
    const int32_t *nodes;
    uint32_t node_count;
} gltf_scene;

typedef struct gltf_document {
    gltf_bytes *buffers;
    uint32_t buffer_count;
    gltf_view *views;
    uint32_t view_count;
    gltf_accessor *accessors;
    uint32_t accessor_count;
    gltf_sampler *samplers;
    uint32_t sampler_count;
    gltf_texture *textures;
    uint32_t texture_count;
    gltf_material *materials;
    uint32_t material_count;
    gltf_mesh *meshes;
    uint32_t mesh_count;
    gltf_node *nodes;
    uint32_t node_count;
    gltf_light *lights;
    uint32_t light_count;
    gltf_camera *cameras;
    uint32_t camera_count;
    gltf_scene *scenes;
    uint32_t scene_count;
    int32_t scene; /* the default scene, else the first; -1 = the file has none */
} gltf_document;

/*
 * Parses the checked document `json` (JSON text).  buffers: the contents of its buffers, in order, copied.  The document's arrays
 * and strings live until gltf_document_free.  Errors: LMG_ERROR_FILE_FORMAT with tinygltf's own words, LMG_ERROR_MEMORY.
 */
lmg_result gltf_document_parse(const char *json, size_t size, const gltf_bytes *buffers, uint32_t buffer_count, gltf_document **out,
                               lmg_error *err);
void gltf_document_free(gltf_document *document);

/* Decodes a PNG or JPEG to R,G,B,A: 8 bits (bits 8, bytes) or 16 bits (bits 16, native uint16_t) a channel.  *pixels is freed by
 * free(). */
lmg_result gltf_image_decode(const uint8_t *bytes, size_t size, uint32_t *width, uint32_t *height, int *bits, void **pixels,
                             lmg_error *err);

#ifdef __cplusplus
}
#endif
#endif
