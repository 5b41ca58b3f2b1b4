/* SPDX-License-Identifier: Apache-2.0 */
/* See make_model.h. */
#include "make_model.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static void *grown(void *old, size_t bytes)
{
    void *p = realloc(old, bytes + 16); /* 16: Embree reads beyond the last vertex */
    if (!p) {
        abort();
    }
    return p;
}

lum_model *make_model(void)
{
    lum_model *model = grown(NULL, sizeof *model);
    memset(model, 0, sizeof *model);
    strcpy(model->path, "memory");
    model->unit = 1;
    return model;
}

void free_model(lum_model *model)
{
    for (uint32_t i = 0; i < model->image_count; i++) {
        free(model->images[i].texels);
    }
    free(model->images);
    free(model->positions);
    free(model->normals);
    free(model->uv[0]);
    free(model->indices);
    free(model->triangle_material);
    free(model->triangle_part);
    free(model->parts);
    free(model->materials);
    free(model->lights);
    free(model);
}

static lum_texture no_texture(void)
{
    lum_texture t = {.image = LUM_NONE, .m = {{1, 0, 0}, {0, 1, 0}}};
    return t;
}

uint32_t make_material(lum_model *model, lum_surface_kind kind)
{
    model->materials = grown(model->materials, (model->material_count + 1) * sizeof *model->materials);
    lum_material *m = &model->materials[model->material_count];
    memset(m, 0, sizeof *m);
    strcpy(m->name, "material");
    m->kind = kind;
    for (int c = 0; c < 4; c++) {
        m->base_color[c] = 1;
    }
    m->roughness = 1;
    m->ior = 1.5f;
    m->normal_scale = 1;
    m->alpha_cutoff = 0.5f;
    for (int c = 0; c < 3; c++) {
        m->diffuse_transmission_color[c] = 1;
    }
    m->base_texture = m->metal_rough_texture = m->normal_texture = m->transmission_texture = m->emissive_texture = no_texture();
    m->diffuse_transmission_texture = m->diffuse_transmission_color_texture = no_texture();
    lum_layers *l = &m->layers;
    l->specular_texture = l->specular_color_texture = l->clearcoat_texture = l->clearcoat_roughness_texture = no_texture();
    l->clearcoat_normal_texture = l->sheen_color_texture = l->sheen_roughness_texture = l->anisotropy_texture = no_texture();
    l->iridescence_texture = l->thickness_texture = no_texture();
    return model->material_count++;
}

uint32_t make_lambert(lum_model *model, float albedo)
{
    uint32_t i = make_material(model, LUM_SURFACE_LAMBERT);
    for (int c = 0; c < 3; c++) {
        model->materials[i].base_color[c] = albedo;
    }
    return i;
}

uint32_t make_mirror(lum_model *model, float reflectance, float roughness)
{
    uint32_t i = make_material(model, LUM_SURFACE_CONDUCTOR);
    for (int c = 0; c < 3; c++) {
        model->materials[i].base_color[c] = reflectance;
    }
    model->materials[i].roughness = roughness;
    return i;
}

uint32_t make_glass(lum_model *model, float ior, float roughness, bool thin)
{
    uint32_t i = make_material(model, LUM_SURFACE_PBR);
    lum_material *m = &model->materials[i];
    m->ior = ior;
    m->roughness = roughness;
    m->transmission = 1;
    m->thin = thin;
    return i;
}

int32_t make_image(lum_model *model, uint32_t width, uint32_t height, const float *texels)
{
    model->images = grown(model->images, (model->image_count + 1) * sizeof *model->images);
    lum_image *image = &model->images[model->image_count];
    size_t bytes = (size_t)width * height * 4 * sizeof(float);
    image->width = width;
    image->height = height;
    image->texels = grown(NULL, bytes);
    memcpy(image->texels, texels, bytes);
    return (int32_t)model->image_count++;
}

static uint32_t add_vertex(lum_model *model, lmg_vec3 p, lmg_vec3 n, double u, double v)
{
    uint32_t i = model->vertex_count++;
    if ((i & (i - 1)) == 0) { /* at powers of two, room for as many again */
        size_t room = i ? 2 * (size_t)i : 1;
        model->positions = grown(model->positions, room * 3 * sizeof(float));
        model->normals = grown(model->normals, room * 3 * sizeof(float));
        model->uv[0] = grown(model->uv[0], room * 2 * sizeof(float));
    }
    float *x = model->positions + 3 * (size_t)i, *y = model->normals + 3 * (size_t)i, *z = model->uv[0] + 2 * (size_t)i;
    x[0] = (float)p.x;
    x[1] = (float)p.y;
    x[2] = (float)p.z;
    y[0] = (float)n.x;
    y[1] = (float)n.y;
    y[2] = (float)n.z;
    z[0] = (float)u;
    z[1] = (float)v;
    return i;
}

static void add_triangle(lum_model *model, uint32_t a, uint32_t b, uint32_t c, uint32_t material)
{
    uint32_t i = model->triangle_count++;
    if ((i & (i - 1)) == 0) {
        size_t room = i ? 2 * (size_t)i : 1;
        model->indices = grown(model->indices, room * 3 * sizeof(uint32_t));
        model->triangle_material = grown(model->triangle_material, room * sizeof(int32_t));
        model->triangle_part = grown(model->triangle_part, room * sizeof(uint32_t));
    }
    model->indices[3 * (size_t)i] = a;
    model->indices[3 * (size_t)i + 1] = b;
    model->indices[3 * (size_t)i + 2] = c;
    model->triangle_material[i] = (int32_t)material;
    model->triangle_part[i] = 0;
}

static lmg_vec3 v3(double x, double y, double z)
{
    lmg_vec3 r = {x, y, z};
    return r;
}

static lmg_vec3 plus(lmg_vec3 o, lmg_vec3 a, double s)
{
    return v3(o.x + s * a.x, o.y + s * a.y, o.z + s * a.z);
}

static lmg_vec3 cross_unit(lmg_vec3 a, lmg_vec3 b)
{
    lmg_vec3 n = v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    double l = sqrt(n.x * n.x + n.y * n.y + n.z * n.z);
    return v3(n.x / l, n.y / l, n.z / l);
}

void make_triangle(lum_model *model, lmg_vec3 a, lmg_vec3 b, lmg_vec3 c, uint32_t material)
{
    lmg_vec3 n = cross_unit(plus(b, a, -1), plus(c, a, -1));
    uint32_t i = add_vertex(model, a, n, 0, 0), j = add_vertex(model, b, n, 1, 0), k = add_vertex(model, c, n, 0, 1);
    add_triangle(model, i, j, k, material);
}

void make_quad(lum_model *model, lmg_vec3 origin, lmg_vec3 a, lmg_vec3 b, uint32_t n, uint32_t material)
{
    lmg_vec3 normal = cross_unit(a, b);
    uint32_t first = model->vertex_count;
    for (uint32_t j = 0; j <= n; j++) {
        for (uint32_t i = 0; i <= n; i++) {
            double u = (double)i / n, v = (double)j / n;
            add_vertex(model, plus(plus(origin, a, u), b, v), normal, u, v);
        }
    }
    for (uint32_t j = 0; j < n; j++) {
        for (uint32_t i = 0; i < n; i++) {
            uint32_t k = first + j * (n + 1) + i;
            add_triangle(model, k, k + 1, k + n + 2, material);
            add_triangle(model, k, k + n + 2, k + n + 1, material);
        }
    }
}

void make_box(lum_model *model, lmg_vec3 low, lmg_vec3 high, bool inward, uint32_t n, uint32_t material)
{
    lmg_vec3 x = v3(high.x - low.x, 0, 0), y = v3(0, high.y - low.y, 0), z = v3(0, 0, high.z - low.z);
    lmg_vec3 corner[6] = {low, low, low, plus(low, z, 1), plus(low, y, 1), plus(low, x, 1)};
    lmg_vec3 a[6] = {y, x, z, x, z, y}, b[6] = {x, z, y, y, x, z};
    for (int i = 0; i < 6; i++) {
        make_quad(model, corner[i], inward ? b[i] : a[i], inward ? a[i] : b[i], n, material);
    }
}

void make_sphere(lum_model *model, lmg_vec3 centre, double radius, uint32_t rings, bool inward, bool smooth, uint32_t material)
{
    const double pi = 3.14159265358979323846;
    uint32_t around = 2 * rings, first = model->vertex_count;
    for (uint32_t j = 0; j <= rings; j++) {
        for (uint32_t i = 0; i < around; i++) {
            double theta = pi * j / rings, phi = 2 * pi * i / around;
            double s = j == 0 || j == rings ? 0 : sin(theta); /* the poles exactly, so that the mesh closes */
            lmg_vec3 n = v3(s * cos(phi), s * sin(phi), cos(theta));
            add_vertex(model, plus(centre, n, radius), inward ? v3(-n.x, -n.y, -n.z) : n, (double)i / around, (double)j / rings);
        }
    }
    for (uint32_t j = 0; j < rings; j++) {
        for (uint32_t i = 0; i < around; i++) {
            uint32_t a = first + j * around + i, b = first + j * around + (i + 1) % around, c = a + around, d = b + around;
            if (j + 1 < rings) {
                add_triangle(model, a, inward ? d : c, inward ? c : d, material);
            }
            if (j > 0) {
                add_triangle(model, a, inward ? b : d, inward ? d : b, material);
            }
        }
    }
    if (!smooth) { /* normals of no use: the scene takes zero vectors as "flat" */
        memset(model->normals + 3 * (size_t)first, 0, 3 * sizeof(float) * (size_t)(model->vertex_count - first));
    }
}

void finish_model(lum_model *model)
{
    model->bounds_min = v3(INFINITY, INFINITY, INFINITY);
    model->bounds_max = v3(-INFINITY, -INFINITY, -INFINITY);
    for (uint32_t i = 0; i < model->vertex_count; i++) {
        const float *p = model->positions + 3 * (size_t)i;
        model->bounds_min = v3(fmin(model->bounds_min.x, (double)p[0]), fmin(model->bounds_min.y, (double)p[1]),
                               fmin(model->bounds_min.z, (double)p[2]));
        model->bounds_max = v3(fmax(model->bounds_max.x, (double)p[0]), fmax(model->bounds_max.y, (double)p[1]),
                               fmax(model->bounds_max.z, (double)p[2]));
    }
    model->parts = grown(model->parts, sizeof *model->parts); /* it may have been finished before and grown since */
    memset(model->parts, 0, sizeof *model->parts);
    model->parts[0].triangle_count = model->triangle_count;
    model->part_count = 1;
}

lum_surface surface_of(const lum_scene *scene, uint32_t triangle, lmg_vec3 d, const lmg_vec3 *ns)
{
    lum_surface s;
    lum_hit hit = {.t = 1, .ng = {0, 0, 1}, .b1 = 0.25f, .b2 = 0.25f, .triangle = triangle};
    lum_surface_at(scene, &hit, d, &s);
    if (ns) {
        s.ns = *ns;
        s.tilted = true;
    }
    return s;
}
