/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Looks: rays along which somebody says what an eye sees, and trees grown of them.
 *
 * They are drawn from the leaves of the photons' trees, as many for each leaf.  Leaves are small where light is strong or sharp, so
 * looks are dense there; a look's weight is the etendue that it stands for, one over the density of looks of all trees together.
 * Each tree keeps its forks and divides its leaves further, as a regression tree does [breiman1984]: by what is seen, not by how
 * many rays there are.  Errors of the mean of a leaf are those of a mean, small where all looks see the same.
 */
#include "etendue.h"
#include "field.h"
#include "geometry.h"
#include "random.h"
#include "trees.h"
#include "work.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Tries to draw a ray of a box that is uniform in etendue: at the least one in nine is kept. */
enum { TRIES = 200 };

typedef struct look {
    float at[4]; /* in its root */
    float luminance;
    float weight; /* etendue, m2 sr; 0: the ray is another root's */
} look;

struct lmg_looks {
    const lmg_field *field;
    const lmg_trees *trees; /* the field's, which looks refine once */
    lmg_look_kind kind;
    uint64_t seed;
    size_t count;
    look *look;
    uint8_t *root;
    double *etendue[LMG_MOST_TREES]; /* of each leaf, by node */
    uint32_t *leaf[LMG_MOST_TREES];  /* nodes that are leaves */
};

void lmg_looks_destroy(lmg_looks *looks)
{
    if (!looks)
        return;
    for (int k = 0; k < LMG_MOST_TREES; k++) {
        free(looks->etendue[k]);
        free(looks->leaf[k]);
    }
    free(looks->look);
    free(looks->root);
    free(looks);
}

size_t lmg_looks_count(const lmg_looks *looks)
{
    return looks->count;
}

lmg_result lmg_looks_create(const lmg_field *field, lmg_look_kind kind, size_t count, uint64_t seed, lmg_looks **out,
                            lmg_error *err)
{
    *out = NULL;
    const lmg_trees *trees = field ? field->trees : NULL;
    if (!trees || trees->looks > 0 || count < 1)
        return lmg_fail(err, LMG_ERROR_ARGUMENT,
                        "looks: need a field with trees that are grown of photons alone, and 1 look or more");
    lmg_looks *made = calloc(1, sizeof *made);
    bool done = made != NULL;
    if (done) {
        *made = (lmg_looks){.field = field, .trees = trees, .kind = kind, .seed = seed, .count = count};
        made->look = calloc(count, sizeof *made->look);
        made->root = malloc(count);
        done = made->look && made->root;
    }
    for (uint32_t k = 0; done && k < trees->tree_count; k++) {
        const lmg_tree *tree = &trees->trees[k];
        made->etendue[k] = malloc(tree->count * sizeof *made->etendue[k]);
        made->leaf[k] = malloc(tree->leaves * sizeof *made->leaf[k]);
        done = made->etendue[k] && made->leaf[k];
        if (!done)
            break;
        for (uint32_t j = 0; j < trees->root_count; j++)
            lmg_tree_etendues(tree, j, &field->layout.slabs[trees->roots[j].slab], made->etendue[k]);
        uint32_t leaves = 0;
        for (uint32_t i = 0; i < tree->count; i++)
            if (tree->nodes[i].axis == LMG_LEAF)
                made->leaf[k][leaves++] = i;
    }
    if (!done) {
        lmg_looks_destroy(made);
        return lmg_fail(err, LMG_ERROR_MEMORY, "looks: no memory for %zu of them", count);
    }
    *out = made;
    return LMG_OK;
}

/* ------------------------------------------------------------------------------------------------------------- drawing */

/* The box of a leaf of a tree without edges. */
static lmg_tree_box box_of(const lmg_tree *tree, uint32_t root, uint32_t leaf)
{
    lmg_tree_box b = lmg_tree_whole();
    uint32_t at = tree->first[root];
    while (at != leaf) {
        const lmg_tree_node *fork = &tree->nodes[at];
        const double cut = lmg_tree_cut(&b, fork->axis, fork->cut);
        const bool second = leaf >= fork->second;
        *(second ? &b.lo[fork->axis] : &b.hi[fork->axis]) = cut;
        at = second ? fork->second : at + 1;
    }
    return b;
}

/* A ray of the box, uniform in etendue: its place in the root and in the slab. */
static bool draw_in(const lmg_slab *slab, const lmg_tree_box *box, uint64_t *state, float at[4], double uvst[4])
{
    const double lo[4] = {slab->u0, slab->v0, slab->s0, slab->t0}, hi[4] = {slab->u1, slab->v1, slab->s1, slab->t1};
    const bool cube = slab->kind == LMG_SLAB_CUBE;
    double nearest = 0; /* cube slabs: etendue goes as 1 / (1 + s^2 + t^2)^2, here against its largest value in the box */
    for (int k = 2; k < 4 && cube; k++) {
        const double a = lo[k] + (hi[k] - lo[k]) * box->lo[k], b = lo[k] + (hi[k] - lo[k]) * box->hi[k];
        const double m = a > 0 ? a : b < 0 ? b : 0;
        nearest += m * m;
    }
    for (int i = 0; i < TRIES; i++) {
        for (int k = 0; k < 4; k++) {
            at[k] = (float)fmin(box->lo[k] + (box->hi[k] - box->lo[k]) * lmg_next_number(state), 1 - 0x1p-24);
            uvst[k] = lo[k] + (hi[k] - lo[k]) * (double)at[k];
        }
        if (!cube)
            return true;
        const double share = (1 + nearest) / (1 + uvst[2] * uvst[2] + uvst[3] * uvst[3]);
        if (lmg_next_number(state) < share * share)
            return true;
    }
    return false;
}

/* Looks that are drawn from a tree: trees take turns. */
static double looks_of(const lmg_looks *looks, uint32_t tree)
{
    const size_t n = looks->trees->tree_count;
    return (double)((looks->count + n - 1 - tree) / n);
}

/* Looks that a unit of etendue holds, of all trees together. */
static double density_at(const lmg_looks *looks, uint32_t root, const float at[4])
{
    double sum = 0;
    for (uint32_t k = 0; k < looks->trees->tree_count; k++) {
        const lmg_tree *tree = &looks->trees->trees[k];
        sum += looks_of(looks, k) / (tree->leaves * looks->etendue[k][lmg_tree_leaf(tree, root, at, NULL) - tree->nodes]);
    }
    return sum;
}

void lmg_looks_draw(lmg_looks *looks, size_t first, size_t count, lmg_ray *rays)
{
    const lmg_trees *trees = looks->trees;
    const lmg_layout *layout = &looks->field->layout;
    for (size_t i = first; i < first + count; i++) {
        uint64_t state = lmg_mix(lmg_next_key(looks->seed) + i);
        /* each tree goes through its leaves in order */
        const uint32_t k = (uint32_t)(i % trees->tree_count);
        const lmg_tree *tree = &trees->trees[k];
        const double at = ((double)(i / trees->tree_count) + lmg_next_number(&state)) / looks_of(looks, k);
        const uint32_t n = (uint32_t)(at * tree->leaves);
        const uint32_t leaf = looks->leaf[k][n < tree->leaves ? n : tree->leaves - 1];
        uint32_t root = 0;
        while (root + 1 < trees->root_count && tree->first[root + 1] <= leaf)
            root++;
        const lmg_slab *slab = &layout->slabs[trees->roots[root].slab];
        const lmg_tree_box box = box_of(tree, root, leaf);
        look *l = &looks->look[i];
        double uvst[4], k0, k1;
        float own[4];
        lmg_ray *ray = &rays[i - first];
        *ray = (lmg_ray){.flux = {1, 1, 1}, .number = lmg_mix(state) | (uint64_t)1 << 63};
        const bool drawn = draw_in(slab, &box, &state, l->at, uvst);
        lmg_slab_ray(slab, uvst, &ray->origin, &ray->direction);
        looks->root[i] = (uint8_t)root;
        l->weight = drawn && lmg_trees_root(trees, layout, ray->origin, ray->direction, own) == (int)root
                        ? (float)(1 / density_at(looks, root, l->at))
                        : 0;
        if (lmg_box_interval(layout->bounds_min, layout->bounds_max, ray->origin, ray->direction, &k0, &k1))
            ray->origin = v_fma(ray->origin, k1, ray->direction);
    }
}

void lmg_looks_put(lmg_looks *looks, size_t first, size_t count, const float (*radiance)[3])
{
    for (size_t i = 0; i < count; i++) {
        const double y = lmg_luminance(radiance[i]), seen = y > 0 && isfinite(y) ? y : 0;
        looks->look[first + i].luminance = looks->kind == LMG_LOOK_OUTLINE ? seen > 0 : (float)seen;
    }
}

double lmg_looks_misplaced(const lmg_looks *looks)
{
    double all = 0, misplaced = 0;
    for (size_t i = 0; i < looks->count && looks->trees; i++) {
        const look *l = &looks->look[i];
        if (!(l->weight > 0))
            continue;
        const double y = lmg_trees_luminance(looks->trees, looks->root[i], l->at, NULL), square = (double)l->weight * y * y;
        all += square;
        misplaced += l->luminance > 0 ? 0 : square;
    }
    return all > 0 ? sqrt(misplaced / all) : 0;
}

/* ------------------------------------------------------------------------------------------------------------- growing */

/*
 * The squared error of a tree is, but for what all have in common, minus the sum over its pieces of etendue times the squared mean,
 * less twice the variance of the mean.  Forks and edges have been chosen among several, which makes them look better than they are,
 * so variances count more: with 4 times trees have three times the leaves and are no better (docs/accuracy.md).  Edges are looked
 * for hardest, and where looks have noise they find it (NOISY_EDGE_PENALTY: with the variance of a photon).
 */
static const double PENALTY = 8, EDGE_PENALTY = 10, NOISY_EDGE_PENALTY = 20;
/* Relative variance of a look: at least, where all is even; and where looks are too few to tell it. */
static const double LEAST_SPREAD = 0.01, UNKNOWN_SPREAD = 100;
/* How certain a dark leaf is, in photons: cuts were chosen so that none is in it, and the leaves beside it hold a little more than
 * they have. */
static const double DARK_PHOTONS = 8;
/* A piece of fewer looks isn't divided; nor is one of fewer, or more, by an edge: it would be no plane. */
enum { FEWEST = 3, FEWEST_FOR_EDGE = 12, MOST_FOR_EDGE = 4000 };
/* Which cut tells most of many looks, some of them tell as well. */
enum { LOOKED_AT = 1024 };

/* Of looks: weights, their squares, weighted luminances and squared ones. */
typedef struct sums {
    double count, weight, weights2, luminance, squares;
} sums;

static inline void add_look(sums *s, const look *l)
{
    const double w = (double)l->weight, y = (double)l->luminance;
    s->count++;
    s->weight += w;
    s->weights2 += w * w;
    s->luminance += w * y;
    s->squares += w * y * y;
}

static void add_sums(sums *s, const sums *other)
{
    s->count += other->count;
    s->weight += other->weight;
    s->weights2 += other->weights2;
    s->luminance += other->luminance;
    s->squares += other->squares;
}

static sums rest(const sums *all, const sums *part)
{
    return (sums){all->count - part->count, all->weight - part->weight, all->weights2 - part->weights2,
                  all->luminance - part->luminance, all->squares - part->squares};
}

/* Variance of the mean.  Looks that all see the same may be lucky: what one more might have seen is added, the mean or what all
 * looks leave open; usual: variance of a look. */
static double variance_of(const sums *s, double usual)
{
    const double mean = s->luminance / s->weight, spread = fmax(s->squares / s->weight - mean * mean, 0);
    return (spread + (mean * mean + usual) / s->count) / fmax(s->weight * s->weight / s->weights2 - 1, 0.5);
}

static double score(const sums *s, double mean, double etendue, double penalty, double usual)
{
    return etendue * (mean * mean - (s->count > 0 ? penalty * variance_of(s, usual) : 0));
}

/* A piece to be grown. */
typedef struct piece {
    look *looks;
    size_t count;
    lmg_tree_box box;
    double etendue;
    double before, variance; /* luminance of the leaf that it is a part of, and relative variance of that */
    double usual;            /* variance of a look */
    double edge_penalty;
    uint64_t key;
    unsigned depth;
} piece;

/* Weights and weighted luminances below each of four cuts, and of all; every step-th look is looked at. */
LMG_WIDE static void sums_below(const look *l, size_t count, size_t step, const double cut[4], double weight[5],
                                double luminance[5])
{
    const lmg_double4 at = {cut[0], cut[1], cut[2], cut[3]};
    lmg_double4 weights = {0}, luminances = {0};
    weight[4] = luminance[4] = 0;
    for (size_t i = 0; i < count; i += step) {
        const double w = (double)l[i].weight, wy = w * (double)l[i].luminance;
        const lmg_double4 x = {(double)l[i].at[0], (double)l[i].at[1], (double)l[i].at[2], (double)l[i].at[3]};
        const lmg_double4 w4 = {w, w, w, w}, wy4 = {wy, wy, wy, wy};
        const lmg_long4 below = x < at;
        weights += (lmg_double4)(below & (lmg_long4)w4);
        luminances += (lmg_double4)(below & (lmg_long4)wy4);
        weight[4] += w;
        luminance[4] += wy;
    }
    for (int k = 0; k < 4; k++) {
        weight[k] = weights[k];
        luminance[k] = luminances[k];
    }
}

/* The fork of a piece: the axis whose cut, by chance somewhere in the middle half, brings the most; -1: none has looks on both
 * sides.  *below: etendue of the half below the cut. */
static int choose_axis(const lmg_slab *slab, const piece *p, uint8_t *chosen, double *below)
{
    uint8_t cuts[4];
    double at[4], weight[5], luminance[5], best = -INFINITY;
    int axis = -1;
    for (int k = 0; k < 4; k++) {
        cuts[k] = (uint8_t)(lmg_next_key(p->key + (uint64_t)k) % LMG_TREE_CUTS);
        at[k] = lmg_tree_cut(&p->box, k, cuts[k]);
    }
    sums_below(p->looks, p->count, p->count > LOOKED_AT ? p->count / LOOKED_AT : 1, at, weight, luminance);
    for (int k = 0; k < 4; k++) {
        const double other = weight[4] - weight[k], light = luminance[4] - luminance[k];
        if (!(weight[k] > 0) || !(other > 0) || !(at[k] > p->box.lo[k]) || !(at[k] < p->box.hi[k]))
            continue;
        const double gain = luminance[k] * luminance[k] / weight[k] + light * light / other;
        if (gain > best) {
            best = gain;
            axis = k;
        }
    }
    if (axis < 0)
        return -1;
    lmg_tree_box half = p->box;
    half.hi[axis] = at[axis];
    *chosen = cuts[axis];
    *below =
        axis < 2 ? p->etendue * (at[axis] - p->box.lo[axis]) / (p->box.hi[axis] - p->box.lo[axis]) : lmg_tree_etendue(slab, &half);
    return *below > 0 && *below < p->etendue ? axis : -1;
}

typedef struct edge {
    int normal[4];
    unsigned cut;
    sums side[2];
    double score;
} edge;

/* Tries all places of an edge with this normal. */
static void try_normal(const piece *p, size_t step, const int normal[4], edge *best)
{
    sums bin[LMG_EDGE_CUTS] = {{0}}, all = {0}, low = {0};
    double slope[4], start = 0, range = 0;
    for (int k = 0; k < 4; k++) {
        slope[k] = normal[k] / (p->box.hi[k] - p->box.lo[k]);
        start -= slope[k] * p->box.lo[k];
        start -= normal[k] < 0 ? normal[k] : 0;
        range += abs(normal[k]);
    }
    const double scale = LMG_EDGE_CUTS / range;
    for (size_t i = 0; i < p->count; i += step) {
        const float *at = p->looks[i].at;
        const double y =
            start + slope[0] * (double)at[0] + slope[1] * (double)at[1] + slope[2] * (double)at[2] + slope[3] * (double)at[3];
        const int b = (int)fmin(fmax(y * scale, 0), LMG_EDGE_CUTS - 1);
        add_look(&bin[b], &p->looks[i]);
    }
    for (int b = 0; b < LMG_EDGE_CUTS; b++)
        add_sums(&all, &bin[b]);
    for (unsigned cut = 0; cut + 1 < LMG_EDGE_CUTS; cut++) {
        add_sums(&low, &bin[cut]);
        const sums high = rest(&all, &low);
        if (low.count < 2 || high.count < 2)
            continue;
        const double gain = (score(&low, low.luminance / low.weight, low.weight, p->edge_penalty, p->usual) +
                             score(&high, high.luminance / high.weight, high.weight, p->edge_penalty, p->usual)) *
                            p->etendue / all.weight;
        if (gain > best->score) {
            *best = (edge){.cut = cut, .side = {low, high}, .score = gain};
            memcpy(best->normal, normal, sizeof best->normal);
        }
    }
}

/* The best edge of a piece, with the score -INFINITY if there is none.  Luminance grows fastest along an edge's normal: the
 * regression of luminance on place tells it, a little too blunt or too sharp. */
static edge choose_edge(const piece *p)
{
    edge best = {.score = -INFINITY};
    if (p->count < FEWEST_FOR_EDGE || p->count > MOST_FOR_EDGE)
        return best;
    const size_t step = p->count > LOOKED_AT ? p->count / LOOKED_AT : 1;
    double weight = 0, light = 0, x1[4] = {0}, x2[4] = {0}, xy[4] = {0}, slope[4], most = 0;
    for (size_t i = 0; i < p->count; i += step) {
        const look *l = &p->looks[i];
        const double w = (double)l->weight, wy = w * (double)l->luminance;
        weight += w;
        light += wy;
        for (int k = 0; k < 4; k++) {
            const double x = ((double)l->at[k] - p->box.lo[k]) / (p->box.hi[k] - p->box.lo[k]) - 0.5;
            x1[k] += w * x;
            x2[k] += w * x * x;
            xy[k] += wy * x;
        }
    }
    for (int k = 0; k < 4; k++) {
        const double spread = x2[k] - x1[k] * x1[k] / weight;
        slope[k] = spread > 0 ? (xy[k] - x1[k] * light / weight) / spread : 0;
        most = fmax(most, fabs(slope[k]));
    }
    static const double SHARPER[] = {1, 1.6, 0.6};
    int tried[3][4];
    for (int n = 0; n < 3 && most > 0; n++) {
        for (int k = 0; k < 4; k++)
            tried[n][k] = (int)rint(copysign(LMG_EDGE_MOST * pow(fabs(slope[k]) / most, SHARPER[n]), slope[k]));
        bool again = false;
        for (int m = 0; m < n; m++)
            again = again || memcmp(tried[m], tried[n], sizeof tried[n]) == 0;
        if (!again)
            try_normal(p, step, tried[n], &best);
    }
    return best;
}

static sums sums_of(const piece *p)
{
    sums all = {0};
    for (size_t i = 0; i < p->count; i++)
        add_look(&all, &p->looks[i]);
    return all;
}

/* Halves of a piece, the looks below the cut to the front; etendue isn't set. */
static void halve(const piece *p, int axis, uint8_t chosen, piece half[2])
{
    const double cut = lmg_tree_cut(&p->box, axis, chosen);
    size_t below = 0;
    for (size_t i = 0; i < p->count; i++)
        if ((double)p->looks[i].at[axis] < cut) {
            const look here = p->looks[i];
            p->looks[i] = p->looks[below];
            p->looks[below++] = here;
        }
    half[0] = half[1] = *p;
    half[0].count = below;
    half[1].looks = p->looks + below;
    half[1].count = p->count - below;
    half[0].box.hi[axis] = half[1].box.lo[axis] = cut;
    for (int k = 0; k < 2; k++) {
        half[k].key = lmg_next_key(p->key ^ (uint64_t)(k + 1));
        half[k].depth++;
    }
}

/* Returns the light of both sides. */
static double set_edge(lmg_sapling *s, uint32_t me, const edge *e, const piece *p)
{
    double light = 0;
    const double first = lmg_edge_etendue(s->slab, &p->box, e->normal, e->cut);
    for (int k = 0; k < 2; k++) {
        const double mean = e->side[k].luminance / e->side[k].weight;
        light += mean * (k == 0 ? first : p->etendue - first);
        lmg_sapling_add(s, mean, mean > 0 ? variance_of(&e->side[k], p->usual) / (mean * mean) : 0);
    }
    if (!s->failed)
        s->tree->nodes[me] =
            (lmg_tree_node){.second = me + 2, .axis = LMG_EDGE, .cut = (uint8_t)e->cut, .code = lmg_edge_code(e->normal)};
    return light;
}

/* Of a piece: etendue that no look stands for is as it was before. */
static double mean_of(const sums *all, const piece *p)
{
    const double missing = fmax(p->etendue - all->weight, 0);
    return all->count > 0 ? (all->luminance + p->before * missing) / (all->weight + missing) : p->before;
}

/* Grows a piece, whose looks have these sums: cut as far as there are looks, then taken back where the halves don't stand against
 * the piece in one, or in two along an edge.  Returns its score; *light: that of its leaves. */
static double grow_piece(lmg_sapling *s, piece *p, const sums *all, double *light)
{
    const double mean = mean_of(all, p);
    const double own = score(all, mean, p->etendue, PENALTY, p->usual);
    *light = mean * p->etendue;
    const uint32_t me =
        lmg_sapling_add(s, mean, all->count > 0 ? mean > 0 ? variance_of(all, p->usual) / (mean * mean) : 0 : p->variance);
    if (s->failed || all->count < FEWEST || p->depth + 1 >= LMG_TREE_DEPTH)
        return own;
    const double average = all->luminance / all->weight;
    if (all->squares / all->weight - average * average <=
        1e-6 * all->squares / all->weight) /* all see the same, but for rounding */
        return own;
    const edge e = choose_edge(p);
    uint8_t cut = 0;
    double kept = -INFINITY, part_of, light_of[2];
    uint32_t second = 0;
    const int axis = choose_axis(s->slab, p, &cut, &part_of);
    if (axis >= 0) {
        piece half[2];
        halve(p, axis, cut, half);
        half[0].etendue = part_of;
        half[1].etendue = p->etendue - part_of;
        kept = 0;
        for (int k = 0; k < 2; k++) {
            half[k].before = mean;
            half[k].variance = (double)s->variance[me];
            const sums of =
                sums_of(&half[k]); /* not a difference, which would keep what rounding left of looks that aren't there */
            second = s->tree->count;
            kept += grow_piece(s, &half[k], &of, &light_of[k]);
        }
    }
    if (s->failed)
        return own;
    const bool has_edge = e.score > own;
    const double alone = has_edge ? e.score : own;
    if (axis < 0 || !(kept > alone)) {
        s->tree->count = me + 1;
        if (has_edge)
            *light = set_edge(s, me, &e, p);
        return alone;
    }
    s->tree->nodes[me] = (lmg_tree_node){.second = second, .axis = (uint8_t)axis, .cut = cut};
    *light = light_of[0] + light_of[1];
    return kept;
}

/* Variance of looks within leaves, and squared luminance, both times etendue. */
typedef struct noise {
    double variance, square;
} noise;

static void measure_noise(const lmg_tree *was, uint32_t node, const piece *p, noise *out)
{
    const lmg_tree_node *n = &was->nodes[node];
    if (n->axis != LMG_LEAF) {
        piece half[2];
        halve(p, n->axis, n->cut, half);
        measure_noise(was, node + 1, &half[0], out);
        measure_noise(was, n->second, &half[1], out);
        return;
    }
    const sums all = sums_of(p);
    const double many = all.count > 1 ? all.weight * all.weight / all.weights2 : 0;
    if (!(many > 1.5))
        return;
    const double mean = all.luminance / all.weight;
    const double variance = fmax(all.squares / all.weight - mean * mean, 0) * many / (many - 1);
    out->variance += all.weight * variance;
    out->square += all.weight * (mean * mean - variance / many);
}

/* Sets the light of a leaf that has been grown to pieces, nodes first and on, whose luminances add up to so much light: looks divide
 * it; how much there is, photons tell as well, each as far as it is certain: as photons that are to be expected, since those that
 * are there go with what they tell.  all: sums of the leaf's looks; spread: relative variance of one. */
static void mix_light(lmg_sapling *s, uint32_t first, const piece *leaf, double light, const sums *all, double spread)
{
    const double looks = all->weight * all->weight / all->weights2 / spread, mean = mean_of(all, leaf);
    double photons = leaf->before > 0 ? 1 / leaf->variance : DARK_PHOTONS;
    double both = (looks * mean + photons * leaf->before) / (looks + photons);
    if (leaf->before > 0) {
        photons *= both / leaf->before;
        both = (looks * mean + photons * leaf->before) / (looks + photons);
    }
    for (uint32_t i = first; i < s->tree->count; i++)
        s->luminance[i] = light > 0 ? s->luminance[i] * (both * leaf->etendue / light) : both;
    if (s->tree->count == first + 1) /* a leaf still */
        s->variance[first] = (float)(1 / (looks + photons));
}

/* The same where looks tell outlines, and only photons how much light there is; their noise is the same in all pieces. */
static void divide_light(lmg_sapling *s, uint32_t first, const piece *leaf, double luminance, double light)
{
    if (!(light > 0)) { /* photons got out between looks */
        s->tree->count = first + 1;
        s->tree->nodes[first] = (lmg_tree_node){.axis = LMG_LEAF};
        s->luminance[first] = luminance;
        s->variance[first] = (float)leaf->variance;
        return;
    }
    for (uint32_t i = first; i < s->tree->count; i++) {
        const double part = s->luminance[i] * leaf->etendue / light;
        s->luminance[i] = luminance * part;
        s->variance[i] = part > 0 ? s->variance[i] + (float)leaf->variance : 0;
    }
}

/* Goes down a tree as it was, whose forks stay, and grows its leaves.  spread: relative variance of a look, of all leaves together:
 * one leaf's own goes with its mean, and would draw the mean down. */
static void grow_from(lmg_sapling *s, lmg_look_kind kind, const lmg_tree *was, const double *etendue, uint32_t node, const piece *p,
                      double spread)
{
    const lmg_tree_node *n = &was->nodes[node];
    if (n->axis == LMG_LEAF) {
        const double luminance = (double)n->radiance;
        const bool outline = kind == LMG_LOOK_OUTLINE;
        const sums all = sums_of(p);
        const uint32_t first = s->tree->count;
        piece here = *p;
        double light;
        here.etendue = etendue[node];
        here.before = outline ? 1 : luminance;
        here.variance = lmg_leaf_variance(n->code);
        if (all.count == 0 || (outline && !(luminance > 0))) {
            lmg_sapling_add(s, luminance, here.variance);
            return;
        }
        const double most = fmax(all.luminance / all.weight, here.before);
        here.usual = spread * most * most;
        grow_piece(s, &here, &all, &light);
        if (s->failed)
            return;
        if (outline)
            divide_light(s, first, &here, luminance, light);
        else
            mix_light(s, first, &here, light, &all, spread);
        return;
    }
    const uint32_t me = lmg_sapling_add(s, 0, 0);
    piece half[2];
    uint32_t second = 0;
    halve(p, n->axis, n->cut, half);
    for (int k = 0; k < 2 && !s->failed; k++) {
        second = s->tree->count;
        grow_from(s, kind, was, etendue, k == 0 ? node + 1 : n->second, &half[k], spread);
    }
    if (!s->failed)
        s->tree->nodes[me] = (lmg_tree_node){.second = second, .axis = n->axis, .cut = n->cut};
}

typedef struct refining {
    const lmg_looks *looks;
    lmg_trees *trees;
} refining;

static lmg_result refine_tree(void *self, uint64_t k, void *scratch, lmg_error *err)
{
    (void)scratch;
    const refining *r = self;
    const lmg_looks *looks = r->looks;
    const lmg_trees *trees = looks->trees;
    const lmg_tree *was = &trees->trees[k];
    lmg_sapling s = {.tree = &r->trees->trees[k]};
    look *own = malloc(looks->count * sizeof *own);
    s.failed = !own;
    for (uint32_t j = 0; j < trees->root_count && !s.failed; j++) {
        double light = 0;
        for (uint32_t i = was->first[j]; i < lmg_root_end(trees, was, j); i++)
            light += was->nodes[i].axis == LMG_LEAF ? (double)was->nodes[i].radiance * looks->etendue[k][i] : 0;
        piece p = {.looks = own, .box = lmg_tree_whole(), .key = lmg_next_key(lmg_next_key(~k) ^ j)};
        for (size_t i = 0; i < looks->count; i++)
            if (looks->root[i] == j && looks->look[i].weight > 0)
                own[p.count++] = looks->look[i];
        s.slab = &looks->field->layout.slabs[trees->roots[j].slab];
        s.tree->first[j] = s.tree->count;
        noise n = {0};
        measure_noise(was, was->first[j], &p, &n);
        const double spread = n.square > 0 ? fmax(n.variance / n.square, LEAST_SPREAD) : UNKNOWN_SPREAD;
        p.edge_penalty = EDGE_PENALTY + (NOISY_EDGE_PENALTY - EDGE_PENALTY) * fmin(spread, 1);
        grow_from(&s, looks->kind, was, looks->etendue[k], was->first[j], &p, spread);
        if (!s.failed)
            lmg_sapling_set_leaves(&s, j, light);
    }
    free(own);
    return lmg_sapling_end(&s, err);
}

lmg_result lmg_field_refine_trees(lmg_field *field, lmg_looks *looks, lmg_error *err)
{
    if (!field || !looks || looks->field != field || !looks->trees || field->trees != looks->trees)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "trees: the looks are of other trees, or have refined them");
    lmg_trees *made = calloc(1, sizeof *made);
    if (!made)
        return lmg_fail(err, LMG_ERROR_MEMORY, "trees: no memory");
    made->tree_count = field->trees->tree_count;
    made->root_count = field->trees->root_count;
    made->rays = field->trees->rays;
    made->looks = looks->count;
    memcpy(made->roots, field->trees->roots, sizeof made->roots);
    refining r = {looks, made};
    lmg_work work = {.piece = refine_tree, .self = &r, .count = made->tree_count};
    lmg_result result = lmg_work_do(&work, err);
    if (result == LMG_OK)
        result = lmg_trees_check_size(made, err);
    lmg_trees_destroy(result == LMG_OK ? field->trees : made);
    if (result == LMG_OK) {
        field->trees = made;
        looks->trees = NULL;
    }
    return result;
}
