/* SPDX-License-Identifier: Apache-2.0 */
/* Radiance trees: how they grow, and what they say; trees.h tells what they are, trees_code.c how they are stored. */
#include "trees.h"

#include "etendue.h"
#include "field.h"
#include "geometry.h"
#include "random.h"
#include "work.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/*
 * The squared error of a histogram is, but for what all have in common, minus the sum over its cells of (W^2 - 2 Q) / G: W and Q
 * are the sums of the fluxes and of their squares in a cell of etendue G (leave-one-out cross-validation [rudemo1982]).  A fork has
 * been chosen among several, which makes it look better than it is, so that squares count more: with 4 the leaves of our lamps are
 * noise, with 10 they are blurred (docs/accuracy.md).
 */
static const double PENALTY = 6;
/* A piece of fewer rays isn't cut: its halves couldn't hold enough of them to stand. */
enum { FEWEST = 8 };

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

/* ------------------------------------------------------------------------------------------------------------- growing */

typedef lmg_tree_point point;

typedef struct growing {
    const lmg_layout *layout;
    lmg_trees *trees;
    const point *points; /* of all roots, one after the other */
    double lumens_per_unit;
    size_t first[LMG_MOST_ROOTS + 1];
} growing;

uint32_t lmg_sapling_add(lmg_sapling *s, double luminance, double variance)
{
    lmg_tree *tree = s->tree;
    if (tree->count == s->room) {
        const size_t room = s->room ? 2 * s->room : 1024;
        lmg_tree_node *nodes = room <= UINT32_MAX ? realloc(tree->nodes, room * sizeof *nodes) : NULL;
        if (nodes)
            tree->nodes = nodes;
        double *luminances = nodes ? realloc(s->luminance, room * sizeof *luminances) : NULL;
        if (luminances)
            s->luminance = luminances;
        float *variances = luminances ? realloc(s->variance, room * sizeof *variances) : NULL;
        if (variances)
            s->variance = variances;
        if (!nodes || !luminances || !variances) {
            s->failed = true;
            return 0;
        }
        s->room = room;
    }
    tree->nodes[tree->count] = (lmg_tree_node){.axis = LMG_LEAF};
    s->luminance[tree->count] = luminance;
    s->variance[tree->count] = (float)variance;
    return tree->count++;
}

void lmg_sapling_set_leaves(lmg_sapling *s, uint32_t root, double light)
{
    lmg_tree *tree = s->tree;
    double *etendue = malloc(tree->count * sizeof *etendue);
    s->failed = s->failed || !etendue;
    if (!s->failed) {
        lmg_tree_etendues(tree, root, s->slab, etendue);
        lmg_tree_set_leaves(tree, root, tree->count, s->luminance, s->variance, etendue, light);
    }
    free(etendue);
}

lmg_result lmg_sapling_end(lmg_sapling *s, lmg_error *err)
{
    free(s->luminance);
    free(s->variance);
    if (s->failed)
        return lmg_fail(err, LMG_ERROR_MEMORY, "trees: no memory to grow one");
    lmg_tree_end(s->tree);
    return LMG_OK;
}

typedef struct sums {
    double flux, squares;
} sums;

static double score(const sums *s, double etendue, double penalty)
{
    return s->flux > 0 && etendue > 0 ? (s->flux * s->flux - penalty * s->squares) / etendue : 0;
}

/* Which cut tells most of many thousand rays, some of them tell as well. */
enum { LOOKED_AT = 2048 };

/* Sums of the rays below each of four cuts, and of all; every step-th ray is looked at. */
LMG_WIDE static void sums_below(const point *p, size_t count, size_t step, const double cut[4], sums low[4], sums *all)
{
    const lmg_double4 at = {cut[0], cut[1], cut[2], cut[3]};
    lmg_double4 flux = {0}, squares = {0};
    *all = (sums){0};
    for (size_t i = 0; i < count; i += step) {
        const double f = (double)p[i].flux;
        const lmg_double4 x = {(double)p[i].at[0], (double)p[i].at[1], (double)p[i].at[2], (double)p[i].at[3]}, f4 = {f, f, f, f};
        const lmg_long4 below = x < at;
        const lmg_double4 g = (lmg_double4)(below & (lmg_long4)f4);
        flux += g;
        squares += g * g;
        all->flux += f;
        all->squares += f * f;
    }
    for (int k = 0; k < 4; k++)
        low[k] = (sums){flux[k], squares[k]};
}

/* The fork of a piece: the axis whose cut, by chance somewhere in the middle half, brings the most; -1: none can be made.  *below:
 * etendue of the half below the cut. */
static int choose_axis(const lmg_sapling *s, const point *p, size_t count, const lmg_tree_box *box, double etendue, uint64_t key,
                       uint8_t *chosen, double *below)
{
    uint8_t cuts[4];
    sums low[4], all;
    double at[4];
    for (int k = 0; k < 4; k++) {
        cuts[k] = (uint8_t)(lmg_next_key(key + (uint64_t)k) % LMG_TREE_CUTS);
        at[k] = lmg_tree_cut(box, k, cuts[k]);
    }
    sums_below(p, count, count > LOOKED_AT ? count / LOOKED_AT : 1, at, low, &all);
    double best = -INFINITY;
    int axis = -1;
    for (int k = 0; k < 4; k++) {
        lmg_tree_box half = *box;
        half.hi[k] = at[k];
        const double g = k < 2 ? etendue * (at[k] - box->lo[k]) / (box->hi[k] - box->lo[k]) : lmg_tree_etendue(s->slab, &half);
        const sums high = {all.flux - low[k].flux, all.squares - low[k].squares};
        if (!(g > 0) || !(g < etendue) || !(at[k] > box->lo[k]) || !(at[k] < box->hi[k]))
            continue;
        const double gain = score(&low[k], g, 1) + score(&high, etendue - g, 1);
        if (gain > best) {
            best = gain;
            axis = k;
            *chosen = cuts[k];
            *below = g;
        }
    }
    return axis;
}

/* Rays below a cut to the front; how many, and their sums.  Without a branch on where a ray lies, which nobody can predict: each
 * changes places with the first one that isn't below, and counts if it is. */
static size_t part(point *p, size_t count, int axis, double cut, sums *low)
{
    float least = (float)cut; /* of the numbers that aren't below */
    if ((double)least < cut)
        least = nextafterf(least, INFINITY);
    size_t below = 0;
    *low = (sums){0};
    for (size_t i = 0; i < count; i++) {
        const point here = p[i];
        const bool is_below = p[i].at[axis] < least;
        p[i] = p[below];
        p[below] = here;
        below += is_below;
        const double flux = (double)here.flux * is_below; /* of ?: gcc 12 makes a branch */
        low->flux += flux;
        low->squares += flux * flux;
    }
    return below;
}

/* Grows a piece, whose rays have these sums: cut as far as there are rays, then taken back where leaves don't stand against the
 * piece in one. Returns its score. */
static double grow_piece(lmg_sapling *s, point *p, size_t count, const sums *all, const lmg_tree_box *box, double etendue,
                         uint64_t key, unsigned depth)
{
    const double own = score(all, etendue, PENALTY);
    const uint32_t me =
        lmg_sapling_add(s, all->flux > 0 ? all->flux / etendue : 0, all->flux > 0 ? all->squares / (all->flux * all->flux) : 0);
    uint8_t cut;
    double part_of;
    if (s->failed || count < FEWEST || depth + 1 >= LMG_TREE_DEPTH)
        return own;
    const int axis = choose_axis(s, p, count, box, etendue, key, &cut, &part_of);
    if (axis < 0)
        return own;
    lmg_tree_box half[2] = {*box, *box};
    half[0].hi[axis] = half[1].lo[axis] = lmg_tree_cut(box, axis, cut);
    sums of[2];
    const size_t below = part(p, count, axis, half[0].hi[axis], &of[0]);
    of[1] = (sums){fmax(all->flux - of[0].flux, 0), fmax(all->squares - of[0].squares, 0)};
    if (below == count) /* nothing is left, not even by rounding */
        of[1] = (sums){0};
    double kept = grow_piece(s, p, below, &of[0], &half[0], part_of, lmg_next_key(key ^ 1), depth + 1);
    const uint32_t second = s->tree->count;
    kept += grow_piece(s, p + below, count - below, &of[1], &half[1], etendue - part_of, lmg_next_key(key ^ 2), depth + 1);
    if (s->failed)
        return own;
    if (own >= kept) {
        s->tree->count = me + 1;
        return own;
    }
    s->tree->nodes[me].axis = (uint8_t)axis;
    s->tree->nodes[me].cut = cut;
    s->tree->nodes[me].second = second;
    return kept;
}

static lmg_result grow_tree(void *self, uint64_t k, void *scratch, lmg_error *err)
{
    (void)scratch;
    const growing *g = self;
    const lmg_trees *trees = g->trees;
    lmg_sapling s = {.tree = &g->trees->trees[k]};
    const size_t count = g->first[trees->root_count];
    point *points = malloc((count > 0 ? count : 1) * sizeof *points);
    s.failed = !points;
    if (points)
        memcpy(points, g->points, count * sizeof *points);
    for (uint32_t j = 0; j < trees->root_count && !s.failed; j++) {
        const lmg_tree_box whole = lmg_tree_whole();
        const lmg_slab slab = lmg_root_slab(trees, g->layout, j);
        s.slab = &slab;
        s.tree->first[j] = s.tree->count;
        sums all = {0};
        for (size_t i = g->first[j]; i < g->first[j + 1]; i++) {
            all.flux += (double)points[i].flux;
            all.squares += (double)points[i].flux * (double)points[i].flux;
        }
        grow_piece(&s, points + g->first[j], g->first[j + 1] - g->first[j], &all, &whole, lmg_tree_etendue(s.slab, &whole),
                   lmg_next_key(lmg_next_key(k) ^ j), 0);
        if (!s.failed)
            lmg_sapling_set_leaves(&s, j, g->lumens_per_unit * all.flux);
    }
    free(points);
    return lmg_sapling_end(&s, err);
}

/* The slabs that get trees: of those on one side of the lamp the last, which holds the others' rays as well.  The six that
 * lmg_layout_fit puts last catch what passes beside.  (With trees of its own for a source that is seen directly the spot's radiance
 * is off by 25 instead of 22 %: leaves around it lose light to it.) */
static uint32_t find_wide(const lmg_layout *layout, lmg_tiling tilings[LMG_MAX_SLABS])
{
    const uint32_t wide = layout->slab_count > 6 ? layout->slab_count - 6 : layout->slab_count;
    uint32_t count = 0;
    for (uint32_t j = 0; j < wide; j++) {
        const lmg_slab *x = &layout->slabs[j];
        bool last = x->kind == LMG_SLAB_APERTURE || isinf(x->distance);
        for (uint32_t k = j + 1; k < wide; k++)
            last = last && !(layout->slabs[k].kind == x->kind && v_dot(layout->slabs[k].n, x->n) > 1 - 1e-9);
        if (last)
            tilings[count++] = (lmg_tiling){.slab = j, .nu = 1, .nv = 1, .kinds = 1};
    }
    return count;
}

_Static_assert((int)LMG_MAX_SLABS <= (int)LMG_MOST_ROOTS && LMG_MOST_ROOTS <= INT8_MAX, "a root for each slab, numbered by int8_t");

/* Finds the tiles of all wide slabs, whose roots are one for each so far; root: of each ray, -1 for none. */
static bool tile(lmg_trees *trees, const point *all, const int8_t *root, size_t count)
{
    point *own = malloc((count > 0 ? count : 1) * sizeof *own);
    for (uint32_t k = 0; own && k < trees->tiling_count; k++) {
        lmg_tiling *t = &trees->tilings[k];
        size_t n = 0;
        for (size_t i = 0; i < count; i++)
            if (root[i] == (int)k)
                own[n++] = all[i];
        const lmg_tiling plain = *t;
        lmg_find_tiles(t, own, n);
        if (!lmg_trees_set_roots(trees))
            *t = plain;
    }
    free(own);
    return own && lmg_trees_set_roots(trees);
}

/* Sorts the rays into the roots; sums up the roots' colours.  *flux: of all rays, in roots or not. */
static bool place_rays(growing *g, const lmg_ray *rays, size_t count, point **points, double *flux)
{
    lmg_trees *trees = g->trees;
    point *all = malloc((count > 0 ? count : 1) * sizeof *all), *sorted = malloc((count > 0 ? count : 1) * sizeof *sorted);
    int8_t *root = malloc(count > 0 ? count : 1);
    double sum[LMG_MOST_ROOTS] = {0}, colour[LMG_MOST_ROOTS][3] = {{0}};
    size_t held[LMG_MOST_ROOTS] = {0};
    *flux = 0;
    *points = sorted;
    for (size_t i = 0; i < count && all && sorted && root; i++) {
        const double y = lmg_luminance(rays[i].flux);
        root[i] = -1;
        if (!(y > 0) || !isfinite(y))
            continue;
        *flux += y;
        all[i].flux = (float)y;
        root[i] = (int8_t)lmg_trees_root(trees, g->layout, rays[i].origin, rays[i].direction, all[i].at);
    }
    const bool done = all && sorted && root && tile(trees, all, root, count);
    for (size_t i = 0; i < count && done; i++) {
        if (root[i] < 0)
            continue;
        const uint32_t j = lmg_tile_root(&trees->tilings[root[i]], all[i].at);
        root[i] = (int8_t)j;
        held[j]++;
        sum[j] += (double)all[i].flux;
        for (int c = 0; c < 3; c++)
            colour[j][c] += (double)rays[i].flux[c];
    }
    g->first[0] = 0;
    for (uint32_t j = 0; j < trees->root_count; j++) {
        lmg_tree_root *r = &trees->roots[j];
        g->first[j + 1] = g->first[j] + held[j];
        for (int c = 0; c < 3; c++)
            r->colour[c] = g->layout->channels == 1 ? g->layout->colour[c] : sum[j] > 0 ? (float)(colour[j][c] / sum[j]) : 1;
    }
    size_t at[LMG_MOST_ROOTS];
    memcpy(at, g->first, sizeof at);
    for (size_t i = 0; i < count && done; i++)
        if (root[i] >= 0)
            sorted[at[root[i]]++] = all[i];
    free(all);
    free(root);
    return done;
}

lmg_result lmg_trees_check_size(const lmg_trees *trees, lmg_error *err)
{
    if (lmg_trees_size(trees) <= LMG_TREE_BYTES)
        return LMG_OK;
    return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "trees: larger than a file may hold (%d MB); fewer rays or fewer trees would help",
                    LMG_TREE_BYTES / 1000000);
}

lmg_result lmg_field_grow_trees(lmg_field *field, const lmg_ray *rays, size_t count, uint32_t trees, lmg_error *err)
{
    if (!field || (count > 0 && !rays) || trees == 1 || trees > LMG_MOST_TREES)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "trees: %u of them asked for; 2 to %d are possible, 0 takes them away", trees,
                        LMG_MOST_TREES);
    if (trees == 0) {
        lmg_trees_destroy(field->trees);
        field->trees = NULL;
        return LMG_OK;
    }
    lmg_trees *made = calloc(1, sizeof *made);
    if (!made)
        return lmg_fail(err, LMG_ERROR_MEMORY, "trees: no memory");
    made->tree_count = trees;
    made->rays = count;
    made->tiling_count = find_wide(&field->layout, made->tilings);
    lmg_trees_set_roots(made);
    growing g = {.layout = &field->layout, .trees = made};
    point *points = NULL;
    double flux;
    lmg_result r = made->root_count > 0
                       ? LMG_OK
                       : lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                                  "trees: need slabs whose (s,t) is a direction, not a place at a finite distance");
    if (r == LMG_OK && !place_rays(&g, rays, count, &points, &flux))
        r = lmg_fail(err, LMG_ERROR_MEMORY, "trees: no memory for %zu rays", count);
    if (r == LMG_OK && g.first[made->root_count] == 0)
        r = lmg_fail(err, LMG_ERROR_ARGUMENT, "trees: none of %zu rays is in a wide slab", count);
    if (r == LMG_OK) {
        g.points = points;
        g.lumens_per_unit = (field->ledger.stored + field->ledger.residual) / flux;
        lmg_work work = {.piece = grow_tree, .self = &g, .count = trees};
        r = lmg_work_do(&work, err);
    }
    free(points);
    if (r == LMG_OK)
        r = lmg_trees_check_size(made, err);
    lmg_trees_destroy(r == LMG_OK ? field->trees : made);
    if (r == LMG_OK)
        field->trees = made;
    return r;
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
    return t;
}
