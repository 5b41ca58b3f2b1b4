/* SPDX-License-Identifier: Apache-2.0 */
/* Radiance trees grown of photons; trees_refine.c goes on where these end, with what is seen. */
#include "field.h"
#include "geometry.h"
#include "random.h"
#include "trees.h"
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
