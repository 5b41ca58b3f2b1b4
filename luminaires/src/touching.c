/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Which triangles of solids lie on other surfaces: there light meets several boundaries at once, which rays find one of
 * (lum_scene_all_here finds the others).  Here such triangles are only marked, once per scene, so that a hit elsewhere costs
 * nothing.
 *
 * Two triangles touch when the part of the one that lies over the other, seen along the other's normal, is more than a sliver and is
 * nowhere farther from it than LUM_TOUCHING_GAP.  Candidates come from a tree of boxes.  About 1.5 s of processor time per
 * million triangles of glass.
 */
#include "scene_data.h"
#include "vec.h"

#include <stdlib.h>
#include <string.h>

typedef struct bounds {
    float low[3], high[3];
} bounds;

enum { LEAF = 8 };

/* Without a call; none of the numbers is NaN. */
static inline float least(float a, float b)
{
    return a < b ? a : b;
}
static inline float greatest(float a, float b)
{
    return a > b ? a : b;
}

/* A binary tree over `count` triangles in `order`: node k has the children 2k + 1 and 2k + 2, its range is halved between them. */
typedef struct box_tree {
    lum_scene *scene;
    uint32_t *order;
    bounds *nodes;
} box_tree;

static bounds triangle_bounds(const lum_triangle *t)
{
    bounds b;
    for (int k = 0; k < 3; k++) {
        b.low[k] = least(t->v[0][k], least(t->v[1][k], t->v[2][k])) - t->error;
        b.high[k] = greatest(t->v[0][k], greatest(t->v[1][k], t->v[2][k])) + t->error;
    }
    return b;
}

static float middle_of(const lum_triangle *t, int axis)
{
    return t->v[0][axis] + t->v[1][axis] + t->v[2][axis];
}

/* Hoare's selection: afterwards the elements before `half` are in no case above those from it on. */
static void halve(const lum_scene *scene, uint32_t *order, uint32_t count, uint32_t half, int axis)
{
    uint32_t low = 0, high = count - 1;
    while (low < high) {
        float pivot = middle_of(&scene->triangles[order[low + (high - low) / 2]], axis);
        uint32_t i = low, j = high;
        for (;;) {
            while (middle_of(&scene->triangles[order[i]], axis) < pivot) {
                i++;
            }
            while (middle_of(&scene->triangles[order[j]], axis) > pivot) {
                j--;
            }
            if (i >= j) {
                break;
            }
            uint32_t swap = order[i];
            order[i++] = order[j];
            order[j--] = swap;
        }
        if (half <= j) {
            high = j;
        } else {
            low = j + 1;
        }
    }
}

static void build(box_tree *tree, size_t node, uint32_t first, uint32_t count)
{
    bounds *b = &tree->nodes[node];
    if (count > LEAF) {
        bounds middle = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
        for (uint32_t i = first; i < first + count; i++) {
            for (int k = 0; k < 3; k++) {
                float x = middle_of(&tree->scene->triangles[tree->order[i]], k);
                middle.low[k] = least(middle.low[k], x);
                middle.high[k] = greatest(middle.high[k], x);
            }
        }
        int axis = 0;
        for (int k = 1; k < 3; k++) {
            if (middle.high[k] - middle.low[k] > middle.high[axis] - middle.low[axis]) {
                axis = k;
            }
        }
        uint32_t half = count / 2;
        halve(tree->scene, tree->order + first, count, half, axis);
        build(tree, 2 * node + 1, first, half);
        build(tree, 2 * node + 2, first + half, count - half);
        const bounds *l = &tree->nodes[2 * node + 1], *r = &tree->nodes[2 * node + 2];
        for (int k = 0; k < 3; k++) {
            b->low[k] = least(l->low[k], r->low[k]);
            b->high[k] = greatest(l->high[k], r->high[k]);
        }
        return;
    }
    *b = triangle_bounds(&tree->scene->triangles[tree->order[first]]);
    for (uint32_t i = first + 1; i < first + count; i++) {
        bounds t = triangle_bounds(&tree->scene->triangles[tree->order[i]]);
        for (int k = 0; k < 3; k++) {
            b->low[k] = least(b->low[k], t.low[k]);
            b->high[k] = greatest(b->high[k], t.high[k]);
        }
    }
}

/* A triangle as a column that stands on it: the planes of its edges, moved inside by its error. */
typedef struct column {
    lmg_vec3 inward[3], normal;
    double start[3], height, error; /* where the planes are along their normals */
    bounds box;
} column;

/* False for a triangle without area. */
static bool raise_column(const lum_triangle *t, column *c)
{
    lmg_vec3 along[3];
    for (int e = 0; e < 3; e++) {
        along[e] = vec_sub(vec_from_float(t->v[(e + 1) % 3]), vec_from_float(t->v[e]));
    }
    if (!(vec_length(vec_cross(along[0], along[1])) > 0)) {
        return false;
    }
    c->error = (double)t->error;
    c->normal = vec_from_float(t->ng);
    c->height = vec_dot(vec_from_float(t->v[0]), c->normal);
    c->box = triangle_bounds(t);
    for (int e = 0; e < 3; e++) {
        c->inward[e] = vec_scale(vec_cross(c->normal, along[e]), 1 / vec_length(along[e]));
        c->start[e] = vec_dot(vec_from_float(t->v[e]), c->inward[e]) + c->error;
    }
    return true;
}

/* Whether the part of a triangle in the column is more than a sliver, and all of it near the column's own triangle. */
static bool touch(const column *c, const lum_triangle *t)
{
    /* A plane leaves at most one corner more of what is convex, 6 in the end.  Whatever signs rounding gives the distances: of n corners P
     * are kept, and each of the others lies between at most two crossings, so there are at most P + 2 min(P, n - P) <= 3n/2:
     * 3, 4, 6, 9. */
    enum { CORNERS = 9 };
    lmg_vec3 corner[CORNERS];
    int count = 3;
    for (int i = 0; i < 3; i++) {
        corner[i] = vec_from_float(t->v[i]);
    }
    for (int e = 0; e < 3; e++) {
        double in[CORNERS];
        lmg_vec3 kept[CORNERS];
        int kept_count = 0;
        for (int i = 0; i < count; i++) {
            in[i] = vec_dot(corner[i], c->inward[e]) - c->start[e];
        }
        for (int i = 0; i < count; i++) {
            const int k = i + 1 < count ? i + 1 : 0;
            if (in[i] >= 0) {
                kept[kept_count++] = corner[i];
            }
            if ((in[i] > 0 && in[k] < 0) || (in[i] < 0 && in[k] > 0)) {
                kept[kept_count++] = vec_along(corner[i], vec_sub(corner[k], corner[i]), in[i] / (in[i] - in[k]));
            }
        }
        if (kept_count < 3) {
            return false;
        }
        count = kept_count;
        memcpy(corner, kept, (size_t)count * sizeof kept[0]);
    }
    const double error = fmax(c->error, (double)t->error);
    lmg_vec3 area = vec(0, 0, 0);
    double longest = 0;
    for (int i = 0; i < count; i++) {
        if (fabs(vec_dot(corner[i], c->normal) - c->height) > LUM_TOUCHING_GAP * error) {
            return false;
        }
        const lmg_vec3 w = vec_sub(corner[i], corner[0]);
        longest = fmax(longest, vec_length(w));
        area = vec_add(area, vec_cross(w, vec_sub(corner[(i + 1) % count], corner[0])));
    }
    return vec_length(area) > 2 * error * longest;
}

static bool overlap(const bounds *a, const bounds *b)
{
    for (int k = 0; k < 3; k++) {
        if (a->low[k] > b->high[k] || b->low[k] > a->high[k]) {
            return false;
        }
    }
    return true;
}

static bool bounds_solid(const lum_scene *scene, uint32_t t)
{
    return lum_material_is_solid(&scene->model->materials[scene->triangles[t].material & LUM_TRIANGLE_MATERIAL]);
}

/* Marks the solid's triangle t, and of the tree's range those that it touches.  Of two solids' triangles the first looks at the second. */
static void mark(box_tree *tree, size_t node, uint32_t first, uint32_t count, uint32_t t, const column *c)
{
    if (!overlap(&tree->nodes[node], &c->box)) {
        return;
    }
    if (count > LEAF) {
        uint32_t half = count / 2;
        mark(tree, 2 * node + 1, first, half, t, c);
        mark(tree, 2 * node + 2, first + half, count - half, t, c);
        return;
    }
    lum_triangle *triangles = tree->scene->triangles;
    for (uint32_t i = first; i < first + count; i++) {
        const uint32_t other = tree->order[i];
        if (other == t || (other < t && bounds_solid(tree->scene, other)) ||
            (triangles[t].edges & triangles[other].edges & LUM_TRIANGLE_TOUCHES)) {
            continue;
        }
        const bounds b = triangle_bounds(&triangles[other]);
        if (overlap(&b, &c->box) && touch(c, &triangles[other])) {
            triangles[t].edges |= LUM_TRIANGLE_TOUCHES;
            triangles[other].edges |= LUM_TRIANGLE_TOUCHES;
            tree->scene->touching = true;
        }
    }
}

lmg_result lum_find_touching(lum_scene *scene, lmg_error *err)
{
    const uint32_t count = scene->model->triangle_count;
    uint32_t solid = 0;
    while (solid < count && !bounds_solid(scene, solid)) {
        solid++;
    }
    if (solid == count) {
        return LMG_OK;
    }
    /* Halving `count` until LEAF or less are left takes `depth` steps; the last level has 2^depth nodes. */
    size_t nodes = 1;
    for (uint32_t left = count; left > LEAF; left = left - left / 2) {
        nodes = 2 * nodes + 1;
    }
    box_tree tree = {.scene = scene, .order = malloc(count * sizeof *tree.order), .nodes = malloc(nodes * sizeof *tree.nodes)};
    lmg_result result = LMG_OK;
    if (!tree.order || !tree.nodes) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %u triangles", count);
    } else {
        for (uint32_t i = 0; i < count; i++) {
            tree.order[i] = i;
        }
        build(&tree, 0, 0, count);
        for (uint32_t i = 0; i < count; i++) { /* in the tree's order: neighbours look at the same nodes */
            uint32_t t = tree.order[i];
            column c;
            if (bounds_solid(scene, t) && raise_column(&scene->triangles[t], &c)) {
                mark(&tree, 0, 0, count, t, &c);
            }
        }
    }
    free(tree.order);
    free(tree.nodes);
    return result;
}
