/* SPDX-License-Identifier: Apache-2.0 */
/* Radiance trees: what they hold and say; trees.h tells what they are, trees_grow.c how they grow, trees_code.c how they are
 * stored. */
#include "trees.h"

#include "etendue.h"
#include "field.h"
#include "geometry.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Parts of a box's s and t for the etendue on one side of an edge. */
enum { EDGE_PARTS = 4 };

void lmg_trees_destroy(lmg_trees *trees)
{
    if (!trees)
        return;
    for (uint32_t k = 0; k < trees->tree_count; k++)
        free(trees->trees[k].nodes);
    free(trees);
}

size_t lmg_trees_memory(const lmg_trees *trees)
{
    size_t sum = trees ? sizeof *trees : 0;
    for (uint32_t k = 0; trees && k < trees->tree_count; k++)
        sum += (size_t)trees->trees[k].count * sizeof(lmg_tree_node);
    return sum;
}

void lmg_trees_scale(lmg_trees *trees, double factor)
{
    for (uint32_t k = 0; k < trees->tree_count; k++) {
        lmg_tree *tree = &trees->trees[k];
        for (uint32_t j = 0; j < trees->root_count; j++)
            tree->unit[j] *= factor;
        for (uint32_t i = 0; i < tree->count; i++)
            if (tree->nodes[i].axis == LMG_LEAF)
                tree->nodes[i].radiance = (float)((double)tree->nodes[i].radiance * factor);
    }
}

double lmg_tree_etendue(const lmg_slab *slab, const lmg_tree_box *box)
{
    const double u = slab->u1 - slab->u0, v = slab->v1 - slab->v0, s = slab->s1 - slab->s0, t = slab->t1 - slab->t0;
    const lmg_cell_box c = {slab->u0 + box->lo[0] * u, slab->u0 + box->hi[0] * u, slab->v0 + box->lo[1] * v,
                            slab->v0 + box->hi[1] * v, slab->s0 + box->lo[2] * s, slab->s0 + box->hi[2] * s,
                            slab->t0 + box->lo[3] * t, slab->t0 + box->hi[3] * t};
    return lmg_box_etendue(slab, &c);
}

/* Those of the leaves from *node on that are in a box; *node: the next after them. */
static void etendues_in(const lmg_tree *tree, const lmg_slab *slab, const lmg_tree_box *box, uint32_t *node, double *etendue)
{
    const uint32_t me = (*node)++;
    const lmg_tree_node *n = &tree->nodes[me];
    if (n->axis == LMG_LEAF) {
        etendue[me] = lmg_tree_etendue(slab, box);
        return;
    }
    if (n->axis == LMG_EDGE) {
        int normal[4];
        lmg_edge_normal(n->code, normal);
        const double whole = lmg_tree_etendue(slab, box), first = lmg_edge_etendue(slab, box, normal, n->cut);
        etendue[(*node)++] = first;
        etendue[(*node)++] = whole - first;
        return;
    }
    lmg_tree_box half = *box;
    const double cut = lmg_tree_cut(box, n->axis, n->cut);
    half.hi[n->axis] = cut;
    etendues_in(tree, slab, &half, node, etendue);
    half = *box;
    half.lo[n->axis] = cut;
    etendues_in(tree, slab, &half, node, etendue);
}

void lmg_tree_etendues(const lmg_tree *tree, uint32_t root, const lmg_slab *slab, double *etendue)
{
    const lmg_tree_box whole = lmg_tree_whole();
    uint32_t node = tree->first[root];
    etendues_in(tree, slab, &whole, &node, etendue);
}

void lmg_tree_fill(lmg_tree *tree, uint32_t root, uint32_t end)
{
    for (uint32_t i = tree->first[root]; i < end; i++)
        if (tree->nodes[i].axis == LMG_LEAF)
            tree->nodes[i].radiance = (float)(tree->unit[root] * lmg_leaf_part(tree->nodes[i].code));
}

void lmg_tree_end(lmg_tree *tree)
{
    tree->leaves = 0;
    for (uint32_t i = 0; i < tree->count; i++)
        tree->leaves += tree->nodes[i].axis == LMG_LEAF;
    lmg_tree_node *nodes = realloc(tree->nodes, tree->count * sizeof *nodes);
    tree->nodes = nodes ? nodes : tree->nodes;
}

void lmg_tree_set_leaves(lmg_tree *tree, uint32_t root, uint32_t end, const double *luminance, const float *variance,
                         const double *etendue, double light)
{
    double most = 0, parts = 0;
    for (uint32_t i = tree->first[root]; i < end; i++)
        if (tree->nodes[i].axis == LMG_LEAF)
            most = fmax(most, luminance[i]);
    for (uint32_t i = tree->first[root]; i < end; i++)
        if (tree->nodes[i].axis == LMG_LEAF) {
            tree->nodes[i].code = most > 0 ? lmg_leaf_code(luminance[i] / most, (double)variance[i]) : 0;
            parts += lmg_leaf_part(tree->nodes[i].code) * etendue[i];
        }
    tree->unit[root] = parts > 0 ? light / parts : 0;
    lmg_tree_fill(tree, root, end);
}

bool lmg_edge_below(const lmg_tree_node *edge, const lmg_tree_box *box, const float at[4])
{
    int normal[4];
    lmg_edge_normal(edge->code, normal);
    double y = 0, range = 0;
    for (int k = 0; k < 4; k++) {
        const double x = ((double)at[k] - box->lo[k]) / (box->hi[k] - box->lo[k]);
        y += normal[k] >= 0 ? normal[k] * x : -normal[k] * (1 - x);
        range += abs(normal[k]);
    }
    return y < range * (edge->cut + 1) / LMG_EDGE_CUTS;
}

/* The distribution of a sum of independent numbers, each uniform from 0 to a part. */
static double share_below(const double parts[4], double at)
{
    double part[4], divisor = 1, sum = 0;
    int count = 0;
    for (int k = 0; k < 4; k++)
        if (parts[k] > 0) {
            part[count++] = parts[k];
            divisor *= parts[k] * count;
        }
    for (int corner = 0; corner < 1 << count; corner++) {
        double beyond = at, sign = 1;
        for (int k = 0; k < count; k++)
            if (corner >> k & 1) {
                beyond -= part[k];
                sign = -sign;
            }
        double power = beyond > 0 ? sign : 0;
        for (int k = 0; k < count; k++)
            power *= beyond;
        sum += power;
    }
    return fmin(fmax(sum / divisor, 0), 1);
}

double lmg_edge_etendue(const lmg_slab *slab, const lmg_tree_box *box, const int normal[4], unsigned cut)
{
    /* etendue is even over the box of an aperture slab, and wherever the edge is across u and v alone; over a cube slab's it is
     * taken as even in each of some parts of its directions */
    const int n = slab->kind == LMG_SLAB_CUBE && (normal[2] != 0 || normal[3] != 0) ? EDGE_PARTS : 1;
    double range = 0, parts[4], sum = 0, all = 0;
    for (int k = 0; k < 4; k++) {
        range += abs(normal[k]);
        parts[k] = abs(normal[k]) / (double)(k < 2 ? 1 : n);
    }
    const double at = range * (cut + 1) / LMG_EDGE_CUTS;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            lmg_tree_box part = *box;
            const double s = (box->hi[2] - box->lo[2]) / n, t = (box->hi[3] - box->lo[3]) / n;
            part.lo[2] = box->lo[2] + i * s;
            part.hi[2] = part.lo[2] + s;
            part.lo[3] = box->lo[3] + j * t;
            part.hi[3] = part.lo[3] + t;
            const double before = parts[2] * (normal[2] >= 0 ? i : n - 1 - i) + parts[3] * (normal[3] >= 0 ? j : n - 1 - j);
            const double etendue = lmg_tree_etendue(slab, &part);
            sum += etendue * share_below(parts, at - before);
            all += etendue;
        }
    /* as a share, which no rounding takes out of 0 to 1 */
    return all > 0 ? lmg_tree_etendue(slab, box) * fmin(sum / all, 1) : 0;
}

/* -------------------------------------------------------------------------------------------------------------- asking */

/* Where a coordinate is in a root's rectangle. */
static float place_in(double x, double lo, double hi)
{
    const float at = (float)((x - lo) / (hi - lo));
    return at < 0 ? 0 : at < 1 ? at : 1 - 0x1p-24F;
}

static bool place_of(const lmg_slab *slab, lmg_vec3 origin, lmg_vec3 direction, float at[4])
{
    double uvst[4];
    if (!lmg_slab_coordinates(slab, origin, direction, uvst))
        return false;
    at[0] = place_in(uvst[0], slab->u0, slab->u1);
    at[1] = place_in(uvst[1], slab->v0, slab->v1);
    at[2] = place_in(uvst[2], slab->s0, slab->s1);
    at[3] = place_in(uvst[3], slab->t0, slab->t1);
    return true;
}

int lmg_trees_root(const lmg_trees *trees, const lmg_layout *layout, lmg_vec3 origin, lmg_vec3 direction, float at[4])
{
    for (uint32_t k = 0; k < trees->tiling_count; k++)
        if (place_of(&layout->slabs[trees->tilings[k].slab], origin, direction, at))
            return (int)lmg_tile_root(&trees->tilings[k], at);
    return -1;
}

const lmg_tree_node *lmg_tree_leaf(const lmg_tree *tree, uint32_t root, const float at[4], lmg_tree_box *box)
{
    lmg_tree_box own = lmg_tree_whole();
    lmg_tree_box *b = box ? box : &own;
    *b = own;
    const lmg_tree_node *node = &tree->nodes[tree->first[root]];
    while (node->axis < LMG_LEAF) {
        const double cut = lmg_tree_cut(b, node->axis, node->cut);
        if ((double)at[node->axis] < cut) {
            b->hi[node->axis] = cut;
            node++;
        } else {
            b->lo[node->axis] = cut;
            node = &tree->nodes[node->second];
        }
    }
    if (node->axis == LMG_EDGE)
        node += lmg_edge_below(node, b, at) ? 1 : 2;
    return node;
}

static double volume(const lmg_tree_box *b)
{
    return (b->hi[0] - b->lo[0]) * (b->hi[1] - b->lo[1]) * (b->hi[2] - b->lo[2]) * (b->hi[3] - b->lo[3]);
}

static double common_volume(const lmg_tree_box *a, const lmg_tree_box *b)
{
    double product = 1;
    for (int k = 0; k < 4; k++)
        product *= fmax(fmin(a->hi[k], b->hi[k]) - fmax(a->lo[k], b->lo[k]), 0);
    return product;
}

double lmg_trees_luminance(const lmg_trees *trees, int root, const float at[4], double *variance)
{
    const uint32_t n = trees->tree_count;
    double sum = 0;
    if (!variance) {
        for (uint32_t k = 0; k < n; k++)
            sum += (double)lmg_tree_leaf(&trees->trees[k], (uint32_t)root, at, NULL)->radiance;
        return sum / n;
    }
    /*
     * What is random in a leaf is the rays in it, each adding as much wherever in the leaf it is; two trees have those in common
     * that are in the intersection of their leaves' boxes.  Etendue goes as volume near the place.
     *
     * Where leaves end is chance as well, since forks stand by what the rays happened to be: trees differ in it, and their mean
     * by a part in tree_count of that variance.
     */
    lmg_tree_box box[LMG_MOST_TREES];
    double deviation[LMG_MOST_TREES], squares = 0;
    for (uint32_t k = 0; k < n; k++) {
        const lmg_tree_node *leaf = lmg_tree_leaf(&trees->trees[k], (uint32_t)root, at, &box[k]);
        const double l = (double)leaf->radiance;
        deviation[k] = l * sqrt(lmg_leaf_variance(leaf->code) / volume(&box[k]));
        sum += l;
        squares += l * l;
    }
    sum /= n;
    *variance = 0;
    for (uint32_t k = 0; k < n; k++)
        for (uint32_t m = 0; m < n; m++)
            *variance += deviation[k] * deviation[m] * common_volume(&box[k], &box[m]) / ((double)n * n);
    if (n > 1)
        *variance += fmax(squares / n - sum * sum, 0) / (n - 1);
    return sum;
}

/* -------------------------------------------------------------------------------------------------------------- totals */

lmg_result lmg_trees_check_size(const lmg_trees *trees, lmg_error *err)
{
    if (lmg_trees_size(trees) <= LMG_TREE_BYTES)
        return LMG_OK;
    return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "trees: larger than a file may hold (%d MB); fewer rays or fewer trees would help",
                    LMG_TREE_BYTES / 1000000);
}

lmg_tree_totals lmg_field_trees(const lmg_field *field)
{
    lmg_tree_totals t = {0};
    if (!field->trees)
        return t;
    t.trees = field->trees->tree_count;
    t.rays = field->trees->rays;
    t.looks = field->trees->looks;
    for (uint32_t k = 0; k < field->trees->tiling_count; k++) {
        const lmg_tiling *x = &field->trees->tilings[k];
        t.tiles += x->nu * x->nv > 1 ? x->nu * x->nv : 0;
        t.kinds += x->nu * x->nv > 1 ? x->kinds : 0;
    }
    for (uint32_t k = 0; k < t.trees; k++)
        t.leaves += field->trees->trees[k].leaves;
    t.memory = lmg_trees_memory(field->trees);
    t.bytes = lmg_trees_size(field->trees);
    return t;
}

uint32_t lmg_field_thin_trees(lmg_field *field, size_t bytes)
{
    lmg_trees *t = field->trees;
    while (t && lmg_trees_size(t) > bytes) {
        if (t->tree_count <= 2) {
            lmg_trees_destroy(t);
            field->trees = t = NULL;
            break;
        }
        free(t->trees[--t->tree_count].nodes);
        t->trees[t->tree_count] = (lmg_tree){0};
    }
    return t ? t->tree_count : 0;
}
