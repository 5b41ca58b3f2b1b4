/* SPDX-License-Identifier: Apache-2.0 */
/* Luminaire models made in memory, for tests that want exact geometry without a file. */
#ifndef TESTS_MAKE_MODEL_H
#define TESTS_MAKE_MODEL_H

#include <luminaires/scatter.h>

/* An empty model.  Everything below aborts when memory runs out. */
lum_model *make_model(void);
void free_model(lum_model *model);

/* Adds a material with glTF's defaults for what isn't said: white, opaque, not emitting; returns its index.  Pointers to earlier
 * materials become invalid. */
uint32_t make_material(lum_model *model, lum_surface_kind kind);
/* Common ones. */
uint32_t make_lambert(lum_model *model, float albedo);
uint32_t make_mirror(lum_model *model, float reflectance, float roughness);
uint32_t make_glass(lum_model *model, float ior, float roughness, bool thin);

/* Adds an image of width x height RGBA texels (copied); returns its index. */
int32_t make_image(lum_model *model, uint32_t width, uint32_t height, const float *texels);

/* Quad origin, origin + a, origin + a + b, origin + b, counter-clockwise seen from the side a x b points to, cut into n x n;
 * texture coordinates (0,0) .. (1,1) along a and b. */
void make_quad(lum_model *model, lmg_vec3 origin, lmg_vec3 a, lmg_vec3 b, uint32_t n, uint32_t material);
/* Box, normals outward or inward. */
void make_box(lum_model *model, lmg_vec3 low, lmg_vec3 high, bool inward, uint32_t n, uint32_t material);
/* Sphere of rings x 2 rings quads (triangles at the poles), normals outward or inward; smooth: vertex normals of the true sphere.
 */
void make_sphere(lum_model *model, lmg_vec3 centre, double radius, uint32_t rings, bool inward, bool smooth, uint32_t material);
void make_triangle(lum_model *model, lmg_vec3 a, lmg_vec3 b, lmg_vec3 c, uint32_t material);

/* Bounds and defaults; to be called when everything is in. */
void finish_model(lum_model *model);

/* A surface of a material as a ray along d (unit) meets it on a horizontal quad (+z), with the shading normal tilted to ns if that
 * isn't NULL.  The scene must have the material; it lends its tables. */
lum_surface surface_of(const lum_scene *scene, uint32_t triangle, lmg_vec3 d, const lmg_vec3 *ns);

#endif
