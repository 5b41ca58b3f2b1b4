/* SPDX-License-Identifier: Apache-2.0 */
/* A model under construction: shared by the files that turn a glTF document into a lum_model, in this order:
 * model.c (the whole), model_nodes.c -> model_mesh.c, model_material.c (with model_layers.c), model_finish.c, recipe_apply.c, mesh_check.c, model_warn.c.
 */
#ifndef LUMINAIRES_MODEL_BUILD_H
#define LUMINAIRES_MODEL_BUILD_H

#include "gltf_file.h"
#include "text.h"

/* Bounds on a model's size, far above any luminaire or room. */
enum { LUM_MAX_VERTICES = 1 << 27, LUM_MAX_TRIANGLES = 1 << 26, LUM_MAX_DEPTH = 1000, LUM_MAX_WARNINGS = 200 };

/* An affine map: row by row, m[i][3] is the translation. */
typedef struct lum_affine {
    double m[3][4];
} lum_affine;

typedef struct lum_build {
    gltf_file *file;
    const gltf_document *doc;
    const lum_recipe *recipe; /* may be NULL */
    lum_model *model;
    lmg_error *err;
    bool *entry_matched; /* per recipe entry */
    double scale;        /* of the whole model, from the recipe */

    double *positions; /* 3 per vertex, metres, the file's frame */
    uint32_t vertex_capacity, triangle_capacity, part_capacity;
    int32_t *part_node;   /* the document's node of each part */
    int32_t *node_parent; /* of each of the document's nodes, -1 = root or not in the scene */
    int32_t *image_slots; /* per document image: 2 model images (linear, sRGB), LUM_NONE where not loaded yet */
    uint64_t texel_count; /* of all images together */
    uint32_t warning_capacity;
    bool warned_lines, warned_skin, warned_morph;
} lum_build;

/* Adds a warning line.  Past LUM_MAX_WARNINGS only their number goes on. */
void lum_warn(lum_build *b, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 2, 3)))
#endif
    ;

/* Grows *array (elements of `size` bytes) to hold at least `needed`; doubles the capacity. */
lmg_result lum_grow(void **array, size_t size, size_t needed, lmg_error *err);

/* Copies a spectrum into the model. */
lmg_result lum_add_spectrum(lum_build *b, const lum_spectrum *s, const lum_spectrum **out);

/* model_nodes.c: walks the scene; parts, lights and cameras in the file's frame (lights and positions in b->positions not yet
 * centred). */
lmg_result lum_build_scene(lum_build *b);

/* model_mesh.c: appends one primitive under one transform. */
lmg_result lum_build_primitive(lum_build *b, int32_t node, int32_t mesh, uint32_t primitive, const lum_affine *to_world);

/* model_material.c: the document's materials, those that no part uses left empty, and last glTF's default material; their images.
 */
lmg_result lum_build_materials(lum_build *b);
lmg_result lum_build_texture(lum_build *b, const gltf_texture_use *use, bool srgb, lum_texture *out);

/* model_layers.c: no layers; those of a material, called `name` in messages. */
void lum_layers_none(lum_layers *layers);
lmg_result lum_build_layers(lum_build *b, const char *name, const gltf_material *from, lum_layers *to);

/* model_finish.c: centre, rounding to float, degenerate triangles, tangents, bounds. */
lmg_result lum_build_finish(lum_build *b);

/* mesh_check.c: area, boundary edges and volume of each part; coincident faces (warning). */
lmg_result lum_check_meshes(lum_build *b);

double lum_triangle_area(const lum_model *model, uint32_t triangle);
/* Per triangle: whether it faces the middle of the piece (connected triangles of a part) it belongs to.  *inside is freed by
 * free(). */
lmg_result lum_find_inside(lum_build *b, bool **inside);

/* recipe_apply.c: whether the recipe leaves a part (or a punctual light) out; then, when all parts are known, materials changed
 * part by part, and those that no part uses removed. */
bool lum_recipe_leaves_out(lum_build *b, int32_t node, const char *mesh, const char *material);
bool lum_recipe_darkens(lum_build *b, int32_t node, const char *light);
lmg_result lum_recipe_apply(lum_build *b);
/* recipe_medium.c: whether the material that an entry with a medium gave is a solid; loads the recipe's volumes, when the model has its
 * hash and bounds. */
struct lum_recipe_entry;
lmg_result lum_recipe_check_medium(lum_build *b, const struct lum_recipe_entry *e, const lum_material *material);
lmg_result lum_recipe_apply_volumes(lum_build *b);
double lum_recipe_scale(const lum_recipe *recipe);
/* Continues a hash over everything the recipe says. */
uint64_t lum_recipe_hash(const lum_recipe *recipe, uint64_t hash);

/* model_warn.c: what looks implausible, each with the recipe entry that would settle it. */
void lum_warn_model(lum_build *b);

#endif
