/* SPDX-License-Identifier: Apache-2.0 */
/* One primitive of a mesh: its vertices under a transform, its triangles with their fronts kept, appended to the model under
 * construction.  Positions stay double and in the file's frame until model_finish.c has found the centre. */
#include "gltf_accessor.h"
#include "model_build.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TRIANGLES = 4, STRIP = 5, FAN = 6 }; /* glTF modes; below are points and lines */

/* Coordinates beyond this are damage, not luminaires: a float keeps no more than half a metre there. */
#define MAX_COORDINATE 1e7

typedef struct primitive {
    const gltf_primitive *from;
    const gltf_mesh *mesh;
    char name[LUM_NAME_SIZE]; /* of the mesh */
    uint32_t number;          /* of the primitive */
    uint64_t vertices;
    double *position, *normal, *tangent, *uv[2], *color; /* local, NULL if the file has none */
    uint32_t *corners;                                   /* 3 per triangle */
    uint64_t triangles;
} primitive;

static void free_primitive(primitive *p)
{
    free(p->position);
    free(p->normal);
    free(p->tangent);
    free(p->uv[0]);
    free(p->uv[1]);
    free(p->color);
    free(p->corners);
}

/* Puts `mesh "Shade" primitive 0: POSITION` before a message. */
static lmg_result in_primitive(lum_build *b, const primitive *p, const char *what, lmg_result result)
{
    char where[LUM_NAME_SIZE + 64];
    snprintf(where, sizeof where, "mesh \"%.60s\" primitive %u%s%s", p->name, p->number, *what ? ": " : "", what);
    if (result)
        lum_prefix_error(b->err, where);
    return result;
}

static lmg_result bad(lum_build *b, const primitive *p, const char *text)
{
    return in_primitive(b, p, "", lmg_fail(b->err, LMG_ERROR_INPUT, "%s", text));
}

/* Which component types an attribute may have, as a set: f float, b/B byte and unsigned byte, s/S short and unsigned short, small
 * letters and capitals; n = the integer types must be normalised.  The wider sets are those of KHR_mesh_quantization, taken whether
 * it is declared or not. */
static bool type_allowed(const gltf_accessor *a, const char *types)
{
    static const struct {
        int32_t type;
        char letter;
    } letters[] = {{5120, 'b'}, {5121, 'B'}, {5122, 's'}, {5123, 'S'}, {5126, 'f'}};
    for (size_t i = 0; i < sizeof letters / sizeof *letters; i++)
        if (a->component_type == letters[i].type)
            return strchr(types, letters[i].letter) && (letters[i].letter == 'f' || a->normalized || !strchr(types, 'n'));
    return false;
}

static lmg_result read_attribute(lum_build *b, primitive *p, int32_t accessor, const char *name, const char *types,
                                 int32_t components, double **out)
{
    if (accessor < 0)
        return LMG_OK;
    const gltf_accessor *a = &b->doc->accessors[accessor];
    lmg_result result = LMG_OK;
    if (!type_allowed(a, types))
        result = lmg_fail(b->err, LMG_ERROR_INPUT, "component type %d%s is not allowed there; re-export the mesh",
                          a->component_type, a->normalized ? " (normalised)" : "");
    else if (p->vertices && a->count != p->vertices)
        result = lmg_fail(b->err, LMG_ERROR_INPUT, "has %llu elements for %llu vertices; re-export the mesh",
                          (unsigned long long)a->count, (unsigned long long)p->vertices);
    else
        result = gltf_read_numbers(b->doc, accessor, components, out, b->err);
    return in_primitive(b, p, name, result);
}

static lmg_result check_finite(lum_build *b, const primitive *p, const double *values, int components, const char *name)
{
    for (uint64_t i = 0; values && i < p->vertices * (uint64_t)components; i++)
        if (!isfinite(values[i]))
            return in_primitive(b, p, name,
                                lmg_fail(b->err, LMG_ERROR_INPUT, "vertex %llu is not finite; re-export the mesh",
                                         (unsigned long long)(i / (uint64_t)components)));
    return LMG_OK;
}

/* Colours multiply reflectances: beyond 1 they would make light.  Morphing may round them. */
static lmg_result check_colors(lum_build *b, const primitive *p)
{
    static const double ROUNDING = 1e-6;
    for (uint64_t i = 0; p->color && i < p->vertices * 4; i++) {
        if (!(p->color[i] >= -ROUNDING && p->color[i] <= 1 + ROUNDING))
            return in_primitive(b, p, "COLOR_0",
                                lmg_fail(b->err, LMG_ERROR_INPUT, "vertex %llu: %g is outside [0, 1]; re-export the mesh", (unsigned long long)(i / 4),
                                         p->color[i]));
        p->color[i] = fmin(fmax(p->color[i], 0), 1);
    }
    return LMG_OK;
}

/* Morph targets at the weights of rest: those of the node, else those of the mesh. */
static lmg_result morph(lum_build *b, primitive *p, const gltf_node *node)
{
    const double *weights = node->weight_count ? node->weights : p->mesh->weights;
    uint32_t weight_count = node->weight_count ? node->weight_count : p->mesh->weight_count;
    for (uint32_t t = 0; t < p->from->target_count && t < weight_count; t++) {
        if (weights[t] == 0)
            continue;
        const int32_t accessors[2] = {p->from->targets[t].position, p->from->targets[t].normal};
        double *to[2] = {p->position, p->normal};
        for (int k = 0; k < 2; k++) {
            double *delta = NULL;
            if (!to[k])
                continue;
            LUM_TRY(read_attribute(b, p, accessors[k], "morph target", "fbBsS", 3, &delta));
            for (uint64_t i = 0; delta && i < 3 * p->vertices; i++)
                to[k][i] += weights[t] * delta[i];
            free(delta);
        }
    }
    return LMG_OK;
}

static lmg_result read_vertices(lum_build *b, primitive *p, const gltf_node *node)
{
    const gltf_primitive *from = p->from;
    if (from->position < 0)
        return bad(b, p, "has no POSITION; re-export the mesh");
    LUM_TRY(read_attribute(b, p, from->position, "POSITION", "fbBsS", 3, &p->position));
    p->vertices = b->doc->accessors[from->position].count;
    LUM_TRY(read_attribute(b, p, from->normal, "NORMAL", "fbsn", 3, &p->normal));
    LUM_TRY(read_attribute(b, p, from->uv[0], "TEXCOORD_0", "fbBsS", 2, &p->uv[0]));
    LUM_TRY(read_attribute(b, p, from->uv[1], "TEXCOORD_1", "fbBsS", 2, &p->uv[1]));
    const gltf_material *material = from->material >= 0 ? &b->doc->materials[from->material] : NULL;
    if (material && material->normal_texture.texture >= 0)
        LUM_TRY(read_attribute(b, p, from->tangent, "TANGENT", "fbsn", 4, &p->tangent));
    int32_t color_size = from->color >= 0 ? b->doc->accessors[from->color].components : 4;
    LUM_TRY(read_attribute(b, p, from->color, "COLOR_0", "fBSn", color_size == 3 ? 3 : 4, &p->color));
    if (p->color && color_size == 3) {
        double *wide = malloc(p->vertices * 4 * sizeof *wide);
        if (!wide)
            return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
        for (uint64_t i = 0; i < p->vertices; i++) {
            memcpy(wide + 4 * i, p->color + 3 * i, 3 * sizeof *wide);
            wide[4 * i + 3] = 1;
        }
        free(p->color);
        p->color = wide;
    }
    LUM_TRY(morph(b, p, node));
    LUM_TRY(check_finite(b, p, p->position, 3, "POSITION"));
    LUM_TRY(check_finite(b, p, p->normal, 3, "NORMAL"));
    LUM_TRY(check_finite(b, p, p->tangent, 4, "TANGENT"));
    LUM_TRY(check_finite(b, p, p->uv[0], 2, "TEXCOORD_0"));
    LUM_TRY(check_finite(b, p, p->uv[1], 2, "TEXCOORD_1"));
    LUM_TRY(check_finite(b, p, p->color, 4, "COLOR_0"));
    return check_colors(b, p);
}

/* The corners of all triangles, whatever the topology.  Strips turn every second triangle round; fans start where glTF says:
 * triangle i is (i+1, i+2, 0). */
static lmg_result read_corners(lum_build *b, primitive *p)
{
    uint32_t *indices = NULL;
    uint64_t n = p->vertices;
    if (p->from->indices >= 0) {
        LUM_TRY(in_primitive(b, p, "indices", gltf_read_indices(b->doc, p->from->indices, &indices, b->err)));
        n = b->doc->accessors[p->from->indices].count;
    }
    lmg_result result = LMG_OK;
    for (uint64_t i = 0; indices && i < n; i++)
        if (indices[i] >= p->vertices) {
            result = in_primitive(b, p, "",
                                  lmg_fail(b->err, LMG_ERROR_INPUT, "index %u is outside its %llu vertices; re-export the mesh",
                                           indices[i], (unsigned long long)p->vertices));
            goto cleanup;
        }
    p->triangles = p->from->mode == TRIANGLES ? n / 3 : n < 3 ? 0 : n - 2;
    if (p->triangles > LUM_MAX_TRIANGLES) {
        result = bad(b, p, "has more triangles than can be handled; simplify the mesh");
        goto cleanup;
    }
    if (p->from->mode == TRIANGLES && n % 3)
        lum_warn(b, "mesh \"%.60s\" primitive %u: %llu indices are no whole triangles; the last %llu are left out", p->name,
                 p->number, (unsigned long long)n, (unsigned long long)(n % 3));
    p->corners = malloc((p->triangles * 3 + 1) * sizeof *p->corners);
    if (!p->corners) {
        result = lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
        goto cleanup;
    }
    for (uint64_t i = 0; i < p->triangles; i++) {
        uint64_t c[3] = {3 * i, 3 * i + 1, 3 * i + 2};
        if (p->from->mode == STRIP) {
            c[0] = i;
            c[1] = i + 1 + i % 2;
            c[2] = i + 2 - i % 2;
        } else if (p->from->mode == FAN) {
            c[0] = i + 1;
            c[1] = i + 2;
            c[2] = 0;
        }
        for (int k = 0; k < 3; k++)
            p->corners[3 * i + (uint64_t)k] = indices ? indices[c[k]] : (uint32_t)c[k];
    }
cleanup:
    free(indices);
    return result;
}

/* Without normals glTF wants flat shading: every triangle gets its own three vertices. */
static lmg_result unshare(lum_build *b, primitive *p)
{
    double **attributes[] = {&p->position, &p->uv[0], &p->uv[1], &p->color};
    const size_t size[] = {3, 2, 2, 4};
    uint64_t n = 3 * p->triangles;
    for (size_t k = 0; k < sizeof size / sizeof *size; k++) {
        double *from = *attributes[k];
        if (!from)
            continue;
        double *to = malloc((n * size[k] + 1) * sizeof *to);
        if (!to)
            return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
        for (uint64_t i = 0; i < n; i++)
            memcpy(to + i * size[k], from + p->corners[i] * size[k], size[k] * sizeof *to);
        free(from);
        *attributes[k] = to;
    }
    free(p->tangent); /* without normals the file's tangents mean nothing */
    p->tangent = NULL;
    for (uint64_t i = 0; i < n; i++)
        p->corners[i] = (uint32_t)i;
    p->vertices = n;
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------- into the model */

static lmg_result reserve(lum_build *b, const primitive *p)
{
    lum_model *m = b->model;
    uint64_t vertices = m->vertex_count + p->vertices, triangles = m->triangle_count + p->triangles;
    if (vertices > LUM_MAX_VERTICES || triangles > LUM_MAX_TRIANGLES)
        return lmg_fail(b->err, LMG_ERROR_INPUT, "it has more than %d million vertices or %d million triangles; simplify it",
                        LUM_MAX_VERTICES / 1000000, LUM_MAX_TRIANGLES / 1000000);
    if (vertices > b->vertex_capacity || !b->positions) {
        size_t capacity = (size_t)vertices + (size_t)vertices / 2 + 64;
        LUM_TRY(lum_grow((void **)&b->positions, 3 * sizeof *b->positions, capacity, b->err));
        LUM_TRY(lum_grow((void **)&m->normals, 3 * sizeof *m->normals, capacity, b->err));
        if (m->uv[0])
            LUM_TRY(lum_grow((void **)&m->uv[0], 2 * sizeof *m->uv[0], capacity, b->err));
        if (m->uv[1])
            LUM_TRY(lum_grow((void **)&m->uv[1], 2 * sizeof *m->uv[1], capacity, b->err));
        if (m->colors)
            LUM_TRY(lum_grow((void **)&m->colors, 4 * sizeof *m->colors, capacity, b->err));
        if (m->tangents)
            LUM_TRY(lum_grow((void **)&m->tangents, 4 * sizeof *m->tangents, capacity, b->err));
        b->vertex_capacity = (uint32_t)capacity;
    }
    if (triangles > b->triangle_capacity || !m->indices) {
        size_t capacity = (size_t)triangles + (size_t)triangles / 2 + 64;
        LUM_TRY(lum_grow((void **)&m->indices, 3 * sizeof *m->indices, capacity, b->err));
        LUM_TRY(lum_grow((void **)&m->triangle_part, sizeof *m->triangle_part, capacity, b->err));
        b->triangle_capacity = (uint32_t)capacity;
    }
    if (m->part_count == b->part_capacity) {
        size_t capacity = 2 * (size_t)b->part_capacity + 16;
        LUM_TRY(lum_grow((void **)&m->parts, sizeof *m->parts, capacity, b->err));
        LUM_TRY(lum_grow((void **)&b->part_node, sizeof *b->part_node, capacity, b->err));
        b->part_capacity = (uint32_t)capacity;
    }
    return LMG_OK;
}

/* Appends an attribute of this primitive to the model's array of it, which begins to exist with the first primitive that has it;
 * vertices without it get `fill`. */
static lmg_result append(lum_build *b, const primitive *p, const double *values, size_t size, float fill, float **array)
{
    size_t before = b->model->vertex_count * size, n = p->vertices * size;
    if (!values && !*array)
        return LMG_OK;
    if (!*array) {
        LUM_TRY(lum_grow((void **)array, size * sizeof **array, b->vertex_capacity, b->err));
        for (size_t i = 0; i < before; i++)
            (*array)[i] = fill;
    }
    for (size_t i = 0; i < n; i++)
        (*array)[before + i] = values ? (float)values[i] : fill;
    return LMG_OK;
}

/* The matrix that turns normals: the cofactors, which also works for flattening transforms. */
static void normal_matrix(const lum_affine *a, double n[3][3])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
            n[i][j] = a->m[i1][j1] * a->m[i2][j2] - a->m[i1][j2] * a->m[i2][j1];
        }
}

/* out = M v, normalised and times sign; zero where v has no direction. */
static void turn(const double m[3][3], const double v[3], double sign, double out[3])
{
    double n = 0;
    for (int i = 0; i < 3; i++) {
        out[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2];
        n += out[i] * out[i];
    }
    n = sqrt(n);
    for (int i = 0; i < 3; i++)
        out[i] = n > 0 ? sign * out[i] / n : 0;
}

static lmg_result append_vertices(lum_build *b, primitive *p, const lum_affine *a)
{
    double cofactors[3][3], linear[3][3];
    normal_matrix(a, cofactors);
    for (int i = 0; i < 3; i++)
        memcpy(linear[i], a->m[i], sizeof linear[i]);
    double determinant = 0;
    for (int j = 0; j < 3; j++)
        determinant += linear[0][j] * cofactors[0][j];
    double mirror = determinant < 0 ? -1 : 1; /* a mirroring transform turns fronts to backs: swap two corners to keep them */
    lum_model *m = b->model;
    double *to = b->positions + 3 * (size_t)m->vertex_count;
    float *normal = m->normals + 3 * (size_t)m->vertex_count;
    uint64_t without = 0;
    for (uint64_t v = 0; v < p->vertices; v++) {
        const double *x = p->position + 3 * v;
        for (int i = 0; i < 3; i++) {
            to[3 * v + (uint64_t)i] = a->m[i][0] * x[0] + a->m[i][1] * x[1] + a->m[i][2] * x[2] + a->m[i][3];
            if (!(fabs(to[3 * v + (uint64_t)i]) <= MAX_COORDINATE))
                return in_primitive(
                    b, p, "",
                    lmg_fail(b->err, LMG_ERROR_INPUT,
                             "vertex %llu lies %.2g m from the origin; check the model's unit, or set \"scale\" in a recipe",
                             (unsigned long long)v, fabs(to[3 * v + (uint64_t)i])));
        }
        double turned[3] = {0, 0, 0};
        if (p->normal)
            turn(cofactors, p->normal + 3 * v, mirror, turned);
        for (int i = 0; i < 3; i++)
            normal[3 * v + (uint64_t)i] = (float)turned[i];
        without += p->normal && turned[0] == 0 && turned[1] == 0 && turned[2] == 0;
        if (p->tangent) {
            turn(linear, p->tangent + 4 * v, 1, turned);
            memcpy(p->tangent + 4 * v, turned, sizeof turned);
            p->tangent[4 * v + 3] = (p->tangent[4 * v + 3] < 0 ? -1 : 1) * mirror;
        }
    }
    if (without) /* complete_normals mends them */
        lum_warn(b, "mesh \"%.60s\": %llu of its normals are zero: those of the faces around are taken", p->name, (unsigned long long)without);
    LUM_TRY(append(b, p, p->uv[0], 2, 0, &m->uv[0]));
    LUM_TRY(append(b, p, p->uv[1], 2, 0, &m->uv[1]));
    LUM_TRY(append(b, p, p->color, 4, 1, &m->colors));
    LUM_TRY(append(b, p, p->tangent, 4, 0, &m->tangents));
    uint32_t *corner = m->indices + 3 * (size_t)m->triangle_count;
    for (uint64_t i = 0; i < 3 * p->triangles; i++)
        corner[i] = m->vertex_count + p->corners[i];
    for (uint64_t i = 0; mirror < 0 && i < p->triangles; i++) {
        uint32_t swap = corner[3 * i + 1];
        corner[3 * i + 1] = corner[3 * i + 2];
        corner[3 * i + 2] = swap;
    }
    return LMG_OK;
}

static lmg_result append_primitive(lum_build *b, int32_t node, primitive *p, const lum_affine *a)
{
    lum_model *m = b->model;
    LUM_TRY(reserve(b, p));
    LUM_TRY(append_vertices(b, p, a));
    lum_part *part = &m->parts[m->part_count];
    *part = (lum_part){.material = p->from->material >= 0 ? p->from->material : (int32_t)b->doc->material_count,
                       .first_triangle = m->triangle_count,
                       .triangle_count = (uint32_t)p->triangles,
                       .has_normals = p->normal != NULL};
    lum_copy_name(part->node, b->doc->nodes[node].name, "node", (uint32_t)node);
    memcpy(part->mesh, p->name, sizeof part->mesh);
    for (uint64_t i = 0; i < p->triangles; i++)
        m->triangle_part[m->triangle_count + i] = m->part_count;
    b->part_node[m->part_count++] = node;
    m->vertex_count += (uint32_t)p->vertices;
    m->triangle_count += (uint32_t)p->triangles;
    return LMG_OK;
}

lmg_result lum_build_primitive(lum_build *b, int32_t node, int32_t mesh, uint32_t number, const lum_affine *to_world)
{
    primitive p = {.mesh = &b->doc->meshes[mesh], .number = number};
    p.from = &p.mesh->primitives[number];
    lum_copy_name(p.name, p.mesh->name, "mesh", (uint32_t)mesh);
    char material[LUM_NAME_SIZE] = "";
    if (p.from->material >= 0)
        lum_copy_name(material, b->doc->materials[p.from->material].name, "material", (uint32_t)p.from->material);
    if (lum_recipe_leaves_out(b, node, p.name, material))
        return LMG_OK;
    if (p.from->mode < TRIANGLES) {
        if (!b->warned_lines)
            lum_warn(b, "mesh \"%.60s\" has points or lines, which have no area: left out", p.name);
        b->warned_lines = true;
        return LMG_OK;
    }
    lmg_result result = read_vertices(b, &p, &b->doc->nodes[node]);
    if (!result)
        result = read_corners(b, &p);
    if (!result && !p.normal)
        result = unshare(b, &p);
    if (!result && p.triangles > 0)
        result = append_primitive(b, node, &p, to_world);
    free_primitive(&p);
    return result;
}
