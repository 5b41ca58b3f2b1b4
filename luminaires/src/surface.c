/* SPDX-License-Identifier: Apache-2.0 */
/*
 * From a hit to a surface: material, textures, shading normal.  Materials are prepared once per scene, so that a hit on an
 * untextured one is a copy.
 */
#include "scene_data.h"
#include "scatter_layers.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

static bool textured(const lum_texture *t)
{
    return t->image != LUM_NONE;
}

static float squared(float x)
{
    return x * x;
}

static void fill_layers(const lum_material *m, lum_surface_layers *s)
{
    const lum_layers *l = &m->layers;
    s->specular = l->specular;
    memcpy(s->specular_color, l->specular_color, sizeof s->specular_color);
    s->clearcoat = l->clearcoat;
    s->clearcoat_alpha = squared(l->clearcoat_roughness);
    memcpy(s->sheen, l->sheen_color, sizeof s->sheen);
    s->sheen_alpha = squared(l->sheen_roughness);
    s->iridescence = l->iridescence;
    s->film_ior = l->iridescence_ior;
    s->film_nm = l->thickness_max;
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
        memcpy(s->through, m->diffuse_transmission_color, sizeof s->through);
        s->coverage = m->alpha_mode == LUM_ALPHA_BLEND  ? m->base_color[3]
                      : m->alpha_mode == LUM_ALPHA_MASK ? (m->base_color[3] >= m->alpha_cutoff ? 1.0f : 0.0f)
                                                        : 1.0f;
        memcpy(s->emission, m->emissive, sizeof s->emission);
        s->front = true;
        shading->emissive = m->emissive[0] != 0 || m->emissive[1] != 0 || m->emissive[2] != 0;
        s->layers_present = m->kind == LUM_SURFACE_PBR ? m->layers.present : 0;
        fill_layers(m, &s->layers);
        if (s->layers_present) {
            lum_prepare_layers(s, &scene->tables.tables[i]);
        }
        shading->fetch = lum_material_is_textured(m) || (textured(&m->emissive_texture) && shading->emissive) || model->colors;
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
    lmg_vec3 p = lum_model_vertex(model, corner[0]);
    lmg_vec3 e1 = vec_sub(lum_model_vertex(model, corner[1]), p), e2 = vec_sub(lum_model_vertex(model, corner[2]), p);
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

/* The same as unit vectors perpendicular to the normal n: tangent and bitangent. */
static bool tangent_frame(const lum_model *model, const lum_hit *hit, int set, lmg_vec3 n, lmg_vec3 *t, lmg_vec3 *b)
{
    double hand;
    if (!tangent_at(model, hit, set, t, &hand)) {
        return false;
    }
    *t = vec_along(*t, n, -vec_dot(*t, n));
    double length = vec_length(*t);
    if (!(length > 0)) {
        return false;
    }
    *t = vec_scale(*t, 1 / length);
    *b = vec_scale(vec_cross(n, *t), hand);
    return true;
}

/* The normal n tipped by a normal map; false where the map says nothing or tips it below the triangle. */
static bool map_normal(const lum_model *model, const lum_hit *hit, const lum_texture *texture, float scale_xy, const float uv[2][2],
                       lmg_vec3 n, lmg_vec3 *out)
{
    float texel[4];
    lum_texture_fetch(model, texture, uv[0], uv[1], texel);
    double scale = (double)scale_xy;
    double x = (2 * (double)texel[0] - 1) * scale, y = (2 * (double)texel[1] - 1) * scale, z = 2 * (double)texel[2] - 1;
    lmg_vec3 t, b;
    if (!tangent_frame(model, hit, texture->coordinates, n, &t, &b)) {
        return false;
    }
    lmg_vec3 tipped = vec_along(vec_along(vec_scale(t, x), b, y), n, z);
    double length = vec_length(tipped);
    if (!(length > 0 && vec_dot(tipped, hit->ng) > 0)) {
        return false;
    }
    *out = vec_scale(tipped, 1 / length);
    return true;
}

/* One channel of a texture, 1 where there is none. */
static float channel(const lum_model *model, const lum_texture *texture, const float uv[2][2], int i)
{
    float texel[4] = {1, 1, 1, 1};
    if (textured(texture)) {
        lum_texture_fetch(model, texture, uv[0], uv[1], texel);
    }
    return texel[i];
}

static void times_texture(const lum_model *model, const lum_texture *texture, const float uv[2][2], float rgb[3])
{
    float texel[4];
    if (textured(texture)) {
        lum_texture_fetch(model, texture, uv[0], uv[1], texel);
        for (int c = 0; c < 3; c++) {
            rgb[c] *= texel[c];
        }
    }
}

/* The layers at a hit: textures, and the directions that depend on the normal. */
static void fetch_layers(const lum_model *model, const lum_hit *hit, const float uv[2][2], lmg_vec3 plain, lum_surface *s)
{
    const lum_layers *m = &s->material->layers;
    lum_surface_layers *l = &s->layers;
    if (m->present & LUM_LAYER_SPECULAR) {
        l->specular *= channel(model, &m->specular_texture, uv, 3);
        times_texture(model, &m->specular_color_texture, uv, l->specular_color);
    }
    if (m->present & LUM_LAYER_CLEARCOAT) {
        l->clearcoat *= channel(model, &m->clearcoat_texture, uv, 0);
        l->clearcoat_alpha *= squared(channel(model, &m->clearcoat_roughness_texture, uv, 1));
        l->clearcoat_normal = plain;
        if (textured(&m->clearcoat_normal_texture)) {
            map_normal(model, hit, &m->clearcoat_normal_texture, m->clearcoat_normal_scale, uv, plain, &l->clearcoat_normal);
        }
    }
    if (m->present & LUM_LAYER_SHEEN) {
        times_texture(model, &m->sheen_color_texture, uv, l->sheen);
        l->sheen_alpha *= squared(channel(model, &m->sheen_roughness_texture, uv, 3));
    }
    if (m->present & LUM_LAYER_IRIDESCENCE) {
        l->iridescence *= channel(model, &m->iridescence_texture, uv, 0);
        float g = channel(model, &m->thickness_texture, uv, 1);
        l->film_nm = m->thickness_min + g * (m->thickness_max - m->thickness_min);
    }
    if (m->present & LUM_LAYER_ANISOTROPY) {
        double angle = (double)m->anisotropy_rotation, x = cos(angle), y = sin(angle);
        float strength = m->anisotropy;
        if (textured(&m->anisotropy_texture)) {
            float texel[4];
            lum_texture_fetch(model, &m->anisotropy_texture, uv[0], uv[1], texel);
            double u = 2 * (double)texel[0] - 1, v = 2 * (double)texel[1] - 1, turned = x * u - y * v;
            y = y * u + x * v;
            x = turned;
            strength *= texel[2];
        }
        lmg_vec3 t, b;
        /* Without a direction on the surface there is no anisotropy. */
        bool known =
            tangent_frame(model, hit, textured(&m->anisotropy_texture) ? m->anisotropy_texture.coordinates : 0, s->ns, &t, &b);
        double length = hypot(x, y);
        l->alpha_along = s->alpha;
        if (known && length > 0) {
            l->tangent = vec_along(vec_scale(t, x / length), b, y / length);
            l->alpha_along = s->alpha + (1 - s->alpha) * strength * strength;
        } else {
            lmg_vec3 unused;
            vec_frame(s->ns, &l->tangent, &unused);
        }
    }
}

static void fetch_textures(const lum_model *model, const lum_hit *hit, const float uv[2][2], lum_surface *s)
{
    const lum_material *m = s->material;
    const float *uv0 = uv[0], *uv1 = uv[1];
    float texel[4];
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
    s->transmission *= channel(model, &m->transmission_texture, uv, 0);
    s->diffuse_transmission *= channel(model, &m->diffuse_transmission_texture, uv, 3);
    times_texture(model, &m->diffuse_transmission_color_texture, uv, s->through);
    if (textured(&m->emissive_texture) && (s->emission[0] != 0 || s->emission[1] != 0 || s->emission[2] != 0)) {
        lum_texture_fetch(model, &m->emissive_texture, uv0, uv1, texel);
        for (int c = 0; c < 3; c++) {
            s->emission[c] *= texel[c];
        }
    }
    if (textured(&m->normal_texture) && map_normal(model, hit, &m->normal_texture, m->normal_scale, uv, s->ns, &s->ns)) {
        s->tilted = true;
    }
}

static void fetch_at(const lum_model *model, const lum_hit *hit, bool textures, lum_surface *s)
{
    float uv[2][2] = {{0, 0}, {0, 0}};
    for (int k = 0; k < 2; k++) {
        if (model->uv[k]) {
            interpolate(model, hit, model->uv[k], 2, uv[k]);
        }
    }
    lmg_vec3 plain = s->ns; /* before the normal map, which a clear coat levels out */
    if (textures) {
        fetch_textures(model, hit, (const float(*)[2])uv, s);
    }
    if (s->layers_present) {
        fetch_layers(model, hit, (const float(*)[2])uv, plain, s);
    }
}

void lum_surface_at(const lum_scene *scene, const lum_hit *hit, lmg_vec3 d, lum_surface *out)
{
    const lum_triangle *triangle = &scene->triangles[hit->triangle];
    const lum_shading *shading = &scene->shading[triangle->material & LUM_TRIANGLE_MATERIAL];
#ifndef LUM_ONLY_REFLECTORS /* the benchmark's build without other effects (tests/bench/bench_pay.c) */
    if (shading->surface.layers_present)
        *out = shading->surface;
    else
#endif
        memcpy(out, &shading->surface, offsetof(lum_surface, layers));
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
        double towards = vec_dot(ns, hit->ng), length2 = vec_dot(ns, ns);
        if (towards * towards > 1e-6 * length2) {
            out->ns = vec_scale(ns, copysign(1 / sqrt(length2), towards));
            out->tilted = true;
        }
    }
    if (shading->emissive && !out->front && !out->material->emits_back) {
        out->emission[0] = out->emission[1] = out->emission[2] = 0;
    }
#ifndef LUM_ONLY_REFLECTORS
    if (shading->fetch || out->layers_present) {
        fetch_at(scene->model, hit, shading->fetch, out);
    }
#endif
}
