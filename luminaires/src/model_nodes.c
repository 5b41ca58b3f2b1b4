/* SPDX-License-Identifier: Apache-2.0 */
/* Walks the scene's nodes: their transforms, meshes, instances, lights and cameras.  Without recursion, so that no file is too
 * deep. */
#include "gltf_accessor.h"
#include "model_build.h"
#include "profile_light.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static const lum_affine identity = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};

static lum_affine multiply(const lum_affine *a, const lum_affine *b)
{
    lum_affine r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            r.m[i][j] = j == 3 ? a->m[i][3] : 0;
            for (int k = 0; k < 3; k++)
                r.m[i][j] += a->m[i][k] * b->m[k][j];
        }
    return r;
}

static bool is_finite(const lum_affine *a)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
            if (!isfinite(a->m[i][j]))
                return false;
    return true;
}

/* Translation, rotation by a quaternion (x,y,z,w; normalised here), scale. */
static lum_affine from_trs(const double t[3], const double q[4], const double s[3])
{
    double n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double x = 0, y = 0, z = 0, w = 1;
    if (n > 0) {
        x = q[0] / n;
        y = q[1] / n;
        z = q[2] / n;
        w = q[3] / n;
    }
    const double r[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                            {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                            {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
    lum_affine a;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            a.m[i][j] = r[i][j] * s[j];
        a.m[i][3] = t[i];
    }
    return a;
}

static lmg_result local_transform(lum_build *b, const gltf_node *node, const char *name, lum_affine *out)
{
    if (node->has_matrix) {
        const double *m = node->matrix; /* column by column */
        if (m[3] != 0 || m[7] != 0 || m[11] != 0 || m[15] != 1)
            return lmg_fail(b->err, LMG_ERROR_INPUT,
                            "node \"%.60s\": the last row of its matrix is not 0 0 0 1; re-export the model", name);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 4; j++)
                out->m[i][j] = m[4 * j + i];
    } else {
        *out = from_trs(node->translation, node->rotation, node->scale);
    }
    return LMG_OK;
}

static lmg_vec3 point(const lum_affine *a, double x, double y, double z)
{
    return (lmg_vec3){a->m[0][0] * x + a->m[0][1] * y + a->m[0][2] * z + a->m[0][3],
                      a->m[1][0] * x + a->m[1][1] * y + a->m[1][2] * z + a->m[1][3],
                      a->m[2][0] * x + a->m[2][1] * y + a->m[2][2] * z + a->m[2][3]};
}

/* Direction of the local axis, unit length; the fallback when the transform flattens it. */
static lmg_vec3 axis(const lum_affine *a, double x, double y, double z)
{
    lmg_vec3 p = point(a, x, y, z);
    double dx = p.x - a->m[0][3], dy = p.y - a->m[1][3], dz = p.z - a->m[2][3];
    double n = sqrt(dx * dx + dy * dy + dz * dz);
    return n > 0 ? (lmg_vec3){dx / n, dy / n, dz / n} : (lmg_vec3){x, y, z};
}

static lmg_result add_light(lum_build *b, int32_t index, const char *node_name, const lum_affine *a)
{
    const gltf_light *from = &b->doc->lights[index];
    LUM_TRY(lum_grow((void **)&b->model->lights, sizeof *b->model->lights, b->model->light_count + 1u, b->err));
    lum_light *to = &b->model->lights[b->model->light_count++];
    *to = (lum_light){.kind = (lum_light_kind)from->kind, .position = point(a, 0, 0, 0), .direction = axis(a, 0, 0, -1)};
    lum_copy_name(to->name, from->name && *from->name ? from->name : node_name, "light", (uint32_t)index);
    for (int i = 0; i < 3; i++) {
        to->intensity[i] = (float)(from->color[i] * from->intensity);
        if (!isfinite(to->intensity[i]))
            return lmg_fail(b->err, LMG_ERROR_INPUT, "light \"%.60s\": its intensity is beyond the range of float", to->name);
    }
    if (from->kind == 1 && !(from->inner < from->outer))
        return lmg_fail(b->err, LMG_ERROR_INPUT, "light \"%.60s\": innerConeAngle %g is not below outerConeAngle %g", to->name,
                        from->inner, from->outer);
    to->cos_inner = cos(from->inner);
    to->cos_outer = cos(from->outer);
    return LMG_OK;
}

static lmg_result add_camera(lum_build *b, int32_t index, const char *node_name, const lum_affine *a)
{
    const gltf_camera *from = &b->doc->cameras[index];
    if (!from->perspective) {
        lum_warn(b, "camera \"%.60s\" is orthographic, which is not supported: left out", node_name);
        return LMG_OK;
    }
    LUM_TRY(lum_grow((void **)&b->model->cameras, sizeof *b->model->cameras, b->model->camera_count + 1u, b->err));
    lum_camera *to = &b->model->cameras[b->model->camera_count++];
    *to = (lum_camera){.eye = point(a, 0, 0, 0), .forward = axis(a, 0, 0, -1), .up = axis(a, 0, 1, 0), .yfov = from->yfov};
    lum_copy_name(to->name, from->name && *from->name ? from->name : node_name, "camera", (uint32_t)index);
    return LMG_OK;
}

static lmg_result add_mesh(lum_build *b, int32_t node, int32_t mesh, const lum_affine *a)
{
    for (uint32_t i = 0; i < b->doc->meshes[mesh].primitive_count; i++)
        LUM_TRY(lum_build_primitive(b, node, mesh, i, a));
    return LMG_OK;
}

/* EXT_mesh_gpu_instancing: the mesh once per instance, transformed by it and then by the node. */
static lmg_result add_instances(lum_build *b, int32_t index, const char *name, const lum_affine *a)
{
    const gltf_node *node = &b->doc->nodes[index];
    const int32_t accessors[3] = {node->instance_translation, node->instance_rotation, node->instance_scale};
    const int32_t components[3] = {3, 4, 3};
    double *values[3] = {NULL, NULL, NULL};
    uint64_t count = 0;
    lmg_result result = LMG_OK;
    for (int i = 0; i < 3 && !result; i++) {
        if (accessors[i] < 0)
            continue;
        uint64_t n = b->doc->accessors[accessors[i]].count;
        if (count && n != count)
            result =
                lmg_fail(b->err, LMG_ERROR_INPUT, "has %llu and %llu instances", (unsigned long long)count, (unsigned long long)n);
        else
            result = gltf_read_numbers(b->doc, accessors[i], components[i], &values[i], b->err);
        count = n;
    }
    if (result) {
        char where[LUM_NAME_SIZE + 40];
        snprintf(where, sizeof where, "node \"%.60s\": EXT_mesh_gpu_instancing", name);
        lum_prefix_error(b->err, where);
    }
    for (uint64_t i = 0; i < count && !result; i++) {
        const double zero[3] = {0, 0, 0}, one[3] = {1, 1, 1}, still[4] = {0, 0, 0, 1};
        lum_affine local = from_trs(values[0] ? values[0] + 3 * i : zero, values[1] ? values[1] + 4 * i : still,
                                    values[2] ? values[2] + 3 * i : one);
        lum_affine world = multiply(a, &local);
        if (!is_finite(&world))
            result = lmg_fail(b->err, LMG_ERROR_INPUT,
                              "node \"%.60s\": instance %llu has a transform that is not finite; re-export the "
                              "model",
                              name, (unsigned long long)i);
        else
            result = add_mesh(b, index, node->mesh, &world);
    }
    for (int i = 0; i < 3; i++)
        free(values[i]);
    return result;
}

static lmg_result visit(lum_build *b, int32_t index, const lum_affine *world)
{
    const gltf_node *node = &b->doc->nodes[index];
    char name[LUM_NAME_SIZE];
    lum_copy_name(name, node->name, "node", (uint32_t)index);
    if (node->skin >= 0 && !b->warned_skin) {
        lum_warn(b, "node \"%.60s\" is skinned: skins are ignored, its mesh is taken in its bind pose", name);
        b->warned_skin = true;
    }
    const lmg_vec3 at = point(world, 0, 0, 0), axes[3] = {axis(world, 1, 0, 0), axis(world, 0, 1, 0), axis(world, 0, 0, 1)};
    LUM_TRY(lum_add_recipe_profiles(b, name, at, axes));
    /* A node with both light extensions says one light twice: the profile is the whole story. */
    if (node->profile >= 0 && !lum_recipe_darkens(b, index, name))
        LUM_TRY(lum_add_gltf_profile(b, index, name, at, axes));
    else if (node->profile < 0 && node->light >= 0 && !lum_recipe_darkens(b, index, b->doc->lights[node->light].name))
        LUM_TRY(add_light(b, node->light, name, world));
    if (node->camera >= 0)
        LUM_TRY(add_camera(b, node->camera, name, world));
    if (node->mesh >= 0 && node->instanced)
        return add_instances(b, index, name, world);
    if (node->mesh >= 0)
        return add_mesh(b, index, node->mesh, world);
    return LMG_OK;
}

/* A node waiting for its visit. */
typedef struct waiting {
    int32_t node;
    uint32_t depth;
    lum_affine parent;
} waiting;

typedef struct stack {
    waiting *items;
    size_t count, capacity;
} stack;

/* Puts nodes on the stack, last one first, so that they are visited in the file's order.  A node that has been met before is part
 * of a cycle or has two parents; glTF allows neither. */
static lmg_result push(lum_build *b, stack *s, const int32_t *nodes, uint32_t count, int32_t parent, uint32_t depth,
                       const lum_affine *a, bool *met)
{
    if (depth > LUM_MAX_DEPTH)
        return lmg_fail(b->err, LMG_ERROR_INPUT, "its nodes are nested deeper than %d; flatten the hierarchy", LUM_MAX_DEPTH);
    if (s->count + count > s->capacity) {
        s->capacity = 2 * (s->count + count) + 16;
        LUM_TRY(lum_grow((void **)&s->items, sizeof *s->items, s->capacity, b->err));
    }
    for (uint32_t i = count; i-- > 0;) {
        char name[LUM_NAME_SIZE];
        lum_copy_name(name, b->doc->nodes[nodes[i]].name, "node", (uint32_t)nodes[i]);
        if (met[nodes[i]])
            return lmg_fail(b->err, LMG_ERROR_INPUT, "node \"%.60s\" is its own ancestor or has two parents; re-export the model",
                            name);
        met[nodes[i]] = true;
        b->node_parent[nodes[i]] = parent;
        s->items[s->count++] = (waiting){nodes[i], depth, *a};
    }
    return LMG_OK;
}

/* Without a scene: all nodes that are nobody's child. */
static lmg_result push_roots(lum_build *b, stack *s, const lum_affine *a, bool *met)
{
    uint32_t n = b->doc->node_count;
    bool *child = calloc((size_t)n + 1, sizeof *child);
    if (!child)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t k = 0; k < b->doc->nodes[i].child_count; k++)
            child[b->doc->nodes[i].children[k]] = true;
    lmg_result result = LMG_OK;
    for (uint32_t i = n; i-- > 0 && !result;) {
        int32_t node = (int32_t)i;
        if (!child[i])
            result = push(b, s, &node, 1, -1, 1, a, met);
    }
    free(child);
    lum_warn(b, "it has no scene: all of its nodes are taken");
    return result;
}

static lmg_result walk(lum_build *b, stack *s, bool *met)
{
    lum_affine root = identity;
    for (int i = 0; i < 3; i++)
        root.m[i][i] = b->scale;
    if (b->doc->scene >= 0) {
        const gltf_scene *scene = &b->doc->scenes[b->doc->scene];
        LUM_TRY(push(b, s, scene->nodes, scene->node_count, -1, 1, &root, met));
    } else {
        LUM_TRY(push_roots(b, s, &root, met));
    }
    while (s->count > 0) {
        waiting w = s->items[--s->count];
        const gltf_node *node = &b->doc->nodes[w.node];
        char name[LUM_NAME_SIZE];
        lum_copy_name(name, node->name, "node", (uint32_t)w.node);
        lum_affine local;
        LUM_TRY(local_transform(b, node, name, &local));
        lum_affine world = multiply(&w.parent, &local);
        if (!is_finite(&world))
            return lmg_fail(b->err, LMG_ERROR_INPUT, "node \"%.60s\": its transform is not finite; re-export the model", name);
        LUM_TRY(visit(b, w.node, &world));
        LUM_TRY(push(b, s, node->children, node->child_count, w.node, w.depth + 1, &world, met));
    }
    return LMG_OK;
}

lmg_result lum_build_scene(lum_build *b)
{
    uint32_t n = b->doc->node_count;
    b->node_parent = malloc((n + 1) * sizeof *b->node_parent);
    if (!b->node_parent)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    for (uint32_t i = 0; i < n; i++)
        b->node_parent[i] = -1;
    if (b->doc->scene < 0 && n == 0)
        return lmg_fail(b->err, LMG_ERROR_INPUT, "it has no scene and no nodes; export the model with its meshes in a scene");
    bool *met = calloc(n + 1, sizeof *met);
    if (!met)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    stack s = {NULL, 0, 0};
    lmg_result result = walk(b, &s, met);
    free(s.items);
    free(met);
    if (!result && b->model->triangle_count == 0 && b->model->light_count == 0)
        result = lmg_fail(b->err, LMG_ERROR_INPUT,
                          "its scene has no triangles and no lights; export the model with its meshes in the "
                          "default scene");
    return result;
}
