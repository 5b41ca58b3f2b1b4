/* SPDX-License-Identifier: Apache-2.0 */
/*
 * From a hit to a surface: material, textures, shading normal.  Materials are prepared once per scene, so that a hit on an
 * untextured one is a copy.
 */
#include "scene_data.h"

#include <stdlib.h>
#include <string.h>

static bool textured(const lum_texture *t)
{
    return t->image != LUM_NONE;
}

lmg_result lum_shading_create(lum_scene *scene, lmg_error *err)
{
    const lum_model *model = scene->model;
    scene->shading = calloc(model->material_count ? model->material_count : 1, sizeof *scene->shading);
    if (!scene->shading) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %u materials", model->material_count);
    }
    for (uint32_t i = 0; i < model->material_count; i++) {
        const lum_material *m = &model->materials[i];
        lum_shading *shading = &scene->shading[i];
        lum_surface *s = &shading->surface;
        s->material = m;
        s->tables = &scene->tables.tables[i];
        s->kind = m->kind;
        memcpy(s->base, m->base_color, sizeof s->base);
        s->metallic = m->metallic;
        s->alpha = m->roughness * m->roughness;
        s->ior = m->ior;
        s->transmission = m->transmission;
        s->diffuse_transmission = m->diffuse_transmission;
        s->coverage = m->alpha_mode == LUM_ALPHA_BLEND  ? m->base_color[3]
                      : m->alpha_mode == LUM_ALPHA_MASK ? (m->base_color[3] >= m->alpha_cutoff ? 1.0f : 0.0f)
                                                        : 1.0f;
        memcpy(s->emission, m->emissive, sizeof s->emission);
        s->front = true;
        shading->emissive = m->emissive[0] != 0 || m->emissive[1] != 0 || m->emissive[2] != 0;
        shading->fetch = textured(&m->base_texture) || textured(&m->metal_rough_texture) || textured(&m->normal_texture) ||
                         textured(&m->transmission_texture) || (textured(&m->emissive_texture) && shading->emissive) ||
                         model->colors;
    }
    return LMG_OK;
}

/* Interpolates size floats per vertex. */
static void interpolate(const lum_model *model, const lum_hit *hit, const float *attribute, int size, float *out)
{
    const uint32_t *corner = model->indices + 3 * (size_t)hit->triangle;
    float b0 = 1 - hit->b1 - hit->b2;
    for (int k = 0; k < size; k++) {
        out[k] = b0 * attribute[(size_t)corner[0] * (size_t)size + (size_t)k] +
                 hit->b1 * attribute[(size_t)corner[1] * (size_t)size + (size_t)k] +
                 hit->b2 * attribute[(size_t)corner[2] * (size_t)size + (size_t)k];
    }
}

/* The direction in which u of the normal texture grows, from tangents or, without, from the triangle's texture coordinates; false
 * if they say nothing.  *hand: 1 or -1, of the bitangent cross(n, tangent). */
static bool tangent_at(const lum_model *model, const lum_hit *hit, int set, lmg_vec3 *tangent, double *hand)
{
    const uint32_t *corner = model->indices + 3 * (size_t)hit->triangle;
    if (model->tangents) {
        float t[4];
        interpolate(model, hit, model->tangents, 4, t);
        *tangent = vec_from_float(t);
        *hand = t[3] < 0 ? -1 : 1;
        if (vec_dot(*tangent, *tangent) > 1e-6) { /* vertex tangents are unit vectors: much shorter is no tangent */
            return true;
        }
    }
    const float *uv = model->uv[set];
    if (!uv) {
        return false;
    }
    const float *a = uv + 2 * (size_t)corner[0], *b = uv + 2 * (size_t)corner[1], *c = uv + 2 * (size_t)corner[2];
    lmg_vec3 p = vec_from_float(model->positions + 3 * (size_t)corner[0]);
    lmg_vec3 e1 = vec_sub(vec_from_float(model->positions + 3 * (size_t)corner[1]), p);
    lmg_vec3 e2 = vec_sub(vec_from_float(model->positions + 3 * (size_t)corner[2]), p);
    double u1 = (double)b[0] - (double)a[0], v1 = (double)b[1] - (double)a[1];
    double u2 = (double)c[0] - (double)a[0], v2 = (double)c[1] - (double)a[1];
    double det = u1 * v2 - u2 * v1;
    if (det == 0) {
        return false;
    }
    *tangent = vec_scale(vec_sub(vec_scale(e1, v2), vec_scale(e2, v1)), 1 / det);
    /* glTF's v grows downwards in the picture while y of a normal map is up: the sign that MikkTSpace gives. */
    *hand = det > 0 ? 1 : -1;
    return vec_dot(*tangent, *tangent) > 0;
}

static void apply_normal_map(const lum_model *model, const lum_hit *hit, const float uv0[2], const float uv1[2], lum_surface *s)
{
    const lum_texture *texture = &s->material->normal_texture;
    float texel[4];
    lum_texture_fetch(model, texture, uv0, uv1, texel);
    double scale = (double)s->material->normal_scale;
    double x = (2 * (double)texel[0] - 1) * scale, y = (2 * (double)texel[1] - 1) * scale, z = 2 * (double)texel[2] - 1;
    lmg_vec3 t;
    double hand;
    if (!tangent_at(model, hit, texture->coordinates, &t, &hand)) {
        return;
    }
    t = vec_along(t, s->ns, -vec_dot(t, s->ns));
    double length = vec_length(t);
    if (!(length > 0)) {
        return;
    }
    t = vec_scale(t, 1 / length);
    lmg_vec3 b = vec_scale(vec_cross(s->ns, t), hand);
    lmg_vec3 n = vec_along(vec_along(vec_scale(t, x), b, y), s->ns, z);
    length = vec_length(n);
    /* A map that tips the normal below the triangle is ignored there. */
    if (length > 0 && vec_dot(n, s->ng) > 0) {
        s->ns = vec_scale(n, 1 / length);
        s->tilted = true;
    }
}

static void fetch_textures(const lum_model *model, const lum_hit *hit, lum_surface *s)
{
    const lum_material *m = s->material;
    float uv0[2] = {0, 0}, uv1[2] = {0, 0}, texel[4];
    if (model->uv[0]) {
        interpolate(model, hit, model->uv[0], 2, uv0);
    }
    if (model->uv[1]) {
        interpolate(model, hit, model->uv[1], 2, uv1);
    }
    float alpha = m->base_color[3];
    if (textured(&m->base_texture)) {
        lum_texture_fetch(model, &m->base_texture, uv0, uv1, texel);
        for (int c = 0; c < 3; c++) {
            s->base[c] *= texel[c];
        }
        alpha *= texel[3];
    }
    if (model->colors) {
        interpolate(model, hit, model->colors, 4, texel);
        for (int c = 0; c < 3; c++) {
            s->base[c] = fminf(s->base[c] * texel[c], 1); /* colours above 1 would create light */
        }
        alpha *= texel[3];
    }
    if (m->alpha_mode == LUM_ALPHA_BLEND) {
        s->coverage = fminf(fmaxf(alpha, 0), 1);
    } else if (m->alpha_mode == LUM_ALPHA_MASK) {
        s->coverage = alpha >= m->alpha_cutoff ? 1 : 0;
    }
    if (textured(&m->metal_rough_texture)) {
        lum_texture_fetch(model, &m->metal_rough_texture, uv0, uv1, texel);
        float roughness = m->roughness * texel[1];
        s->alpha = roughness * roughness;
        s->metallic *= texel[2];
    }
    if (textured(&m->transmission_texture)) {
        lum_texture_fetch(model, &m->transmission_texture, uv0, uv1, texel);
        s->transmission *= texel[0];
    }
    if (textured(&m->emissive_texture) && (s->emission[0] != 0 || s->emission[1] != 0 || s->emission[2] != 0)) {
        lum_texture_fetch(model, &m->emissive_texture, uv0, uv1, texel);
        for (int c = 0; c < 3; c++) {
            s->emission[c] *= texel[c];
        }
    }
    if (textured(&m->normal_texture)) {
        apply_normal_map(model, hit, uv0, uv1, s);
    }
}

void lum_surface_at(const lum_scene *scene, const lum_hit *hit, lmg_vec3 d, lum_surface *out)
{
    const lum_triangle *triangle = &scene->triangles[hit->triangle];
    const lum_shading *shading = &scene->shading[triangle->material & LUM_TRIANGLE_MATERIAL];
    *out = shading->surface;
    out->ng = hit->ng;
    out->front = vec_dot(d, hit->ng) < 0;
    out->ns = hit->ng;
    if (triangle->material & LUM_TRIANGLE_SMOOTH) {
        const float(*n)[3] = (const float(*)[3])scene->normals[hit->triangle];
        double b1 = (double)hit->b1, b2 = (double)hit->b2, b0 = 1 - b1 - b2;
        lmg_vec3 ns = vec(b0 * (double)n[0][0] + b1 * (double)n[1][0] + b2 * (double)n[2][0],
                          b0 * (double)n[0][1] + b1 * (double)n[1][1] + b2 * (double)n[2][1],
                          b0 * (double)n[0][2] + b1 * (double)n[1][2] + b2 * (double)n[2][2]);
        /* Vertex normals that point to the back mean the other side of the same curve; ones along the triangle mean nothing. */
        double side = vec_dot(ns, hit->ng), length2 = vec_dot(ns, ns);
        if (side * side > 1e-6 * length2) {
            out->ns = vec_scale(ns, copysign(1 / sqrt(length2), side));
            out->tilted = true;
        }
    }
    if (shading->emissive && !out->front && !out->material->emits_back) {
        out->emission[0] = out->emission[1] = out->emission[2] = 0;
    }
    if (shading->fetch) {
        fetch_textures(scene->model, hit, out);
    }
}
