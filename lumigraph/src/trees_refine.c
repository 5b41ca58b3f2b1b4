/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Trees refined by looks (trees_look.c).  Each tree keeps its forks and divides its leaves further, as a regression tree does
 * [breiman1984]: by what is seen, not by how many rays there are.  Errors of the mean of a leaf are those of a mean, small where
 * all looks see the same.
 */
#include "field.h"
#include "geometry.h"
#include "random.h"
#include "trees_look.h"
#include "work.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/*
 * The squared error of a tree is, but for what all have in common, minus the sum over its pieces of etendue times the squared mean,
 * less twice the variance of the mean.  Forks and edges have been chosen among several, which makes them look better than they are,
 * so variances count more: with 4 times trees have three times the leaves and are no better (docs/accuracy.md).  Edges are looked
 * for hardest, and where looks have noise they find it (NOISY_EDGE_PENALTY: with the variance of a photon).
 */
static const double PENALTY = 8, EDGE_PENALTY = 10, NOISY_EDGE_PENALTY = 20;
/* What squares of photons count when leaves are pooled, as in trees_grow.c: with 3 the opal globe's radiance is off by 10.5 instead
 * of 10.1 %, with 10 by 10.1. */
static const double POOL_PENALTY = 6;
/* Relative variance of a look: at least, where all is even; and where looks are too few to tell it. */
static const double LEAST_SPREAD = 0.01, UNKNOWN_SPREAD = 100;
/* How certain a dark leaf is, in photons: cuts were chosen so that none is in it, and the leaves beside it hold a little more than
 * they have. */
static const double DARK_PHOTONS = 8;
/* A piece of fewer looks isn't divided; nor is one of fewer, or more, by an edge: it would be no plane. */
enum { FEWEST = 3, FEWEST_FOR_EDGE = 30, MOST_FOR_EDGE = 4000 };
/* An edge doesn't stand against forks that come to more leaves. */
enum { MOST_INSTEAD = 32 };
/* Which cut tells most of many looks, some of them tell as well. */
enum { LOOKED_AT = 1024 };

/* Of looks: weights, their squares, weighted luminances and squared ones. */
typedef struct sums {
    double count, weight, weights2, luminance, squares;
} sums;

static inline void add_look(sums *s, const lmg_look *l)
{
    const double w = (double)l->weight, y = (double)l->luminance;
    s->count++;
    s->weight += w;
    s->weights2 += w * w;
    s->luminance += w * y;
    s->squares += w * y * y;
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
    lmg_look *looks;
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
LMG_WIDE static void sums_below(const lmg_look *l, size_t count, size_t step, const double cut[4], double weight[5],
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

/* Normals that are tried at once. */
enum { NORMALS = 4 };
/* Boxes that places, numbers of 24 bits, don't resolve have no edge along such an axis. */
static const double THINNEST = 0x1p-18;

/* An edge's coordinate, in cuts: start + slope * place. */
typedef struct ramps {
    lmg_double4 start, slope[4]; /* of four normals; by axis */
} ramps;

/* Slopes of luminance on place, in parts of the box, times anything positive. */
LMG_WIDE static void regress(const lmg_look *l, size_t count, size_t step, const lmg_tree_box *box, double slope[4])
{
    lmg_double4 low, scale, x1 = {0}, x2 = {0}, xy = {0};
    double weight = 0, light = 0;
    for (int k = 0; k < 4; k++) {
        low[k] = 0.5 * (box->lo[k] + box->hi[k]);
        scale[k] = 1 / (box->hi[k] - box->lo[k]);
    }
    for (size_t i = 0; i < count; i += step) {
        const double w = (double)l[i].weight, wy = w * (double)l[i].luminance;
        const lmg_double4 at = {(double)l[i].at[0], (double)l[i].at[1], (double)l[i].at[2], (double)l[i].at[3]};
        const lmg_double4 x = (at - low) * scale;
        weight += w;
        light += wy;
        x1 += w * x;
        x2 += w * x * x;
        xy += wy * x;
    }
    for (int k = 0; k < 4; k++) {
        const double spread = x2[k] - x1[k] * x1[k] / weight;
        slope[k] = spread > 0 && box->hi[k] - box->lo[k] > THINNEST ? (xy[k] - x1[k] * light / weight) / spread : 0;
    }
}

/* The normals to be tried, most of them different ones: luminance grows fastest along an edge's normal, which the regression tells
 * a little too blunt or too sharp; and edges of what lies along an axis are in one coordinate of place and one of direction. */
static void choose_normals(const double slope[4], int normal[NORMALS][4])
{
    double steepness[4], most = 0;
    for (int k = 0; k < 4; k++)
        most = fmax(most, steepness[k] = fabs(slope[k]));
    for (int k = 0; k < 4; k++) {
        const double x = steepness[k] / most, powers[] = {x, x * sqrt(x), sqrt(x)};
        for (int n = 0; n < 3; n++)
            normal[n][k] = (int)rint(copysign(LMG_EDGE_MOST * powers[n], slope[k]));
    }
    const int pair = fmax(steepness[0], steepness[2]) > fmax(steepness[1], steepness[3]) ? 0 : 1;
    for (int k = 0; k < 4; k++)
        normal[3][k] = k % 2 == pair ? normal[0][k] : 0;
}

/* Weights and weighted luminances of looks by where they are along each normal. */
LMG_WIDE static void sort_into_bins(const lmg_look *l, size_t count, size_t step, const ramps *r,
                                    double bins[NORMALS][LMG_EDGE_CUTS][2])
{
    for (size_t i = 0; i < count; i += step) {
        const double w = (double)l[i].weight, wy = w * (double)l[i].luminance;
        lmg_double4 y = r->start;
        for (int k = 0; k < 4; k++)
            y += r->slope[k] * (double)l[i].at[k];
        for (int n = 0; n < NORMALS; n++) { /* within, but for rounding, which may be anything in a box that is too thin */
            double *bin = bins[n][!(y[n] > 0) ? 0 : y[n] < LMG_EDGE_CUTS - 1 ? (int)y[n] : LMG_EDGE_CUTS - 1];
            bin[0] += w;
            bin[1] += wy;
        }
    }
}

/* The cut that does best, -1: none has looks on both sides; *gain: the larger the better.  Variance is taken to be as large on both
 * sides, so that what it costs is the same for all cuts, but for the looks that may be lucky (variance_of). */
static int choose_cut(double bins[LMG_EDGE_CUTS][2], double count, const piece *p, double *gain)
{
    double weight = 0, light = 0, w = 0, wy = 0;
    int best = -1;
    *gain = -INFINITY;
    for (int b = 0; b < LMG_EDGE_CUTS; b++) {
        weight += bins[b][0];
        light += bins[b][1];
    }
    const double lucky = p->edge_penalty * (weight / count) * (weight / count);
    for (int b = 0; b + 1 < LMG_EDGE_CUTS; b++) {
        w += bins[b][0];
        wy += bins[b][1];
        if (!(bins[b][0] > 0) || !(weight - w > 1e-9 * weight))
            continue;
        const double first = wy * wy / w, v = weight - w, vy = light - wy, second = vy * vy / v;
        const double x = first + second - lucky * ((first / w + p->usual) / w + (second / v + p->usual) / v);
        if (x > *gain) {
            *gain = x;
            best = b;
        }
    }
    return best;
}

/* The best edge of a piece, with the score -INFINITY if there is none. */
static edge choose_edge(const piece *p)
{
    edge best = {.score = -INFINITY};
    if (p->count < FEWEST_FOR_EDGE || p->count > MOST_FOR_EDGE)
        return best;
    const size_t step = p->count > LOOKED_AT ? p->count / LOOKED_AT : 1;
    double slope[4], bins[NORMALS][LMG_EDGE_CUTS][2] = {{{0}}}, most = -INFINITY;
    int normal[NORMALS][4];
    regress(p->looks, p->count, step, &p->box, slope);
    if (!(fabs(slope[0]) + fabs(slope[1]) + fabs(slope[2]) + fabs(slope[3]) > 0))
        return best;
    choose_normals(slope, normal);
    ramps r = {{0}, {{0}}};
    for (int n = 0; n < NORMALS; n++) {
        double range = 0, start = 0;
        for (int k = 0; k < 4; k++)
            range += abs(normal[n][k]);
        for (int k = 0; k < 4; k++) {
            const double x = LMG_EDGE_CUTS / range * normal[n][k];
            r.slope[k][n] = x / (p->box.hi[k] - p->box.lo[k]);
            start -= r.slope[k][n] * p->box.lo[k] + fmin(x, 0);
        }
        r.start[n] = start;
    }
    sort_into_bins(p->looks, p->count, step, &r, bins);
    int chosen = -1;
    for (int n = 0; n < NORMALS; n++) {
        double gain;
        const int cut = choose_cut(bins[n], (double)((p->count - 1) / step + 1), p, &gain);
        if (cut >= 0 && gain > most) {
            most = gain;
            chosen = n;
            best.cut = (unsigned)cut;
        }
    }
    if (chosen < 0)
        return best;
    memcpy(best.normal, normal[chosen], sizeof best.normal);
    for (size_t i = 0; i < p->count; i++) {
        const float *at = p->looks[i].at;
        double y = r.start[chosen];
        for (int k = 0; k < 4; k++)
            y += r.slope[k][chosen] * (double)at[k];
        add_look(&best.side[y < best.cut + 1 ? 0 : 1], &p->looks[i]);
    }
    const sums *side = best.side;
    if (side[0].count < 2 || side[1].count < 2)
        return best;
    const double whole = p->etendue / (side[0].weight + side[1].weight);
    best.score = 0;
    for (int k = 0; k < 2; k++)
        best.score += whole * score(&side[k], side[k].luminance / side[k].weight, side[k].weight, p->edge_penalty, p->usual);
    return best;
}

/* In two rows, which don't wait for each other. */
LMG_WIDE static sums sums_of(const lmg_look *l, size_t count)
{
    lmg_double4 row[2] = {{0}, {0}};
    for (size_t i = 0; i < count; i++) {
        const double w = (double)l[i].weight, y = (double)l[i].luminance;
        row[i % 2] += (lmg_double4){w, w * w, w * y, w * y * y};
    }
    row[0] += row[1];
    return (sums){(double)count, row[0][0], row[0][1], row[0][2], row[0][3]};
}

/* Looks below a cut to the front; how many.  Without a branch on where a look lies, which nobody can predict: each changes places
 * with the first one that isn't below, and counts if it is. */
static size_t part(lmg_look *l, size_t count, int axis, double cut)
{
    float least = (float)cut; /* of the numbers that aren't below */
    if ((double)least < cut)
        least = nextafterf(least, INFINITY);
    size_t below = 0;
    for (size_t i = 0; i < count; i++) {
        const bool is_below = l[i].at[axis] < least;
        const lmg_look here = l[i];
        l[i] = l[below];
        l[below] = here;
        below += is_below;
    }
    return below;
}

/* Halves of a piece whose looks have been parted; etendue isn't set. */
static void halve(const piece *p, int axis, double cut, size_t below, piece half[2])
{
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
    uint8_t cut = 0;
    double kept = -INFINITY, part_of, light_of[2];
    uint32_t second = 0;
    const int axis = choose_axis(s->slab, p, &cut, &part_of);
    if (axis >= 0) {
        const double at = lmg_tree_cut(&p->box, axis, cut);
        piece half[2];
        halve(p, axis, at, part(p->looks, p->count, axis, at), half);
        half[0].etendue = part_of;
        half[1].etendue = p->etendue - part_of;
        kept = 0;
        for (int k = 0; k < 2; k++) {
            half[k].before = mean;
            half[k].variance = (double)s->variance[me];
            /* not a difference, which would keep what rounding left of looks that aren't there */
            const sums of = sums_of(half[k].looks, half[k].count);
            second = s->tree->count;
            kept += grow_piece(s, &half[k], &of, &light_of[k]);
        }
    }
    if (s->failed)
        return own;
    const uint32_t below =
        s->tree->count - me - 1; /* nodes; one more than half of them are leaves, and as many if there are edges */
    const edge e = below / 2 < MOST_INSTEAD ? choose_edge(p) : (edge){.score = -INFINITY};
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

/* What has become of a node: outlines only. */
typedef struct pool {
    double flux, squares;     /* of its photons, and of their squares */
    double etendue, expected; /* and what is expected of light from it, looks' luminance times etendue */
    bool even;                /* its light is pooled: in proportion to what is expected, all over it */
    /* leaves */
    double unknown;      /* relative variance of what is expected */
    uint32_t first, end; /* nodes that are in its place */
} pool;

/* A tree as it was, and where in the looks each node begins. */
typedef struct former {
    const lmg_tree *tree;
    const double *etendue; /* of each leaf, by node */
    uint32_t *begin;       /* by node */
    pool *pools;           /* by node; NULL if looks tell radiance */
} former;

/* Sorts looks first .. end - 1 by the leaves below a node, in the order of these. */
static void sort_looks(const former *was, uint32_t node, const lmg_tree_box *box, lmg_look *looks, size_t first, size_t end)
{
    const lmg_tree_node *n = &was->tree->nodes[node];
    was->begin[node] = (uint32_t)first;
    if (n->axis == LMG_LEAF)
        return;
    const double cut = lmg_tree_cut(box, n->axis, n->cut);
    const size_t middle = first + part(looks + first, end - first, n->axis, cut);
    lmg_tree_box half = *box;
    half.hi[n->axis] = cut;
    sort_looks(was, node + 1, &half, looks, first, middle);
    half = *box;
    half.lo[n->axis] = cut;
    sort_looks(was, n->second, &half, looks, middle, end);
}

/* Variance of a look, relative, of all leaves together: nodes first .. end - 1, and count looks. */
static double measure_spread(const former *was, uint32_t first, uint32_t end, const lmg_look *looks, size_t count)
{
    double variances = 0, squares = 0; /* within leaves, and of luminance; both times etendue */
    for (uint32_t i = first; i < end; i++) {
        if (was->tree->nodes[i].axis != LMG_LEAF)
            continue;
        const sums all = sums_of(looks + was->begin[i], (i + 1 < end ? was->begin[i + 1] : count) - was->begin[i]);
        const double many = all.count > 1 ? all.weight * all.weight / all.weights2 : 0;
        if (!(many > 1.5))
            continue;
        const double mean = all.luminance / all.weight;
        const double variance = fmax(all.squares / all.weight - mean * mean, 0) * many / (many - 1);
        variances += all.weight * variance;
        squares += all.weight * (mean * mean - variance / many);
    }
    return squares > 0 ? fmax(variances / squares, LEAST_SPREAD) : UNKNOWN_SPREAD;
}

/* Luminance of a leaf that photons and something else tell, each as far as it is certain, in photons: as photons that are to be
 * expected, since those that are there go with what they tell. */
static double mix(double luminance, double certain, double by_photons, double *photons)
{
    double both = (certain * luminance + *photons * by_photons) / (certain + *photons);
    if (by_photons > 0) {
        *photons *= both / by_photons;
        both = (certain * luminance + *photons * by_photons) / (certain + *photons);
    }
    return both;
}

/* Sets the light of a leaf that has been grown to pieces, nodes first and on, whose luminances add up to so much light: looks
 * divide it; how much there is, photons tell as well.  all: sums of the leaf's looks; spread: relative variance of one. */
static void mix_light(lmg_sapling *s, uint32_t first, const piece *leaf, double light, const sums *all, double spread)
{
    const double looks = all->weight * all->weight / all->weights2 / spread;
    double photons = leaf->before > 0 ? 1 / leaf->variance : DARK_PHOTONS;
    const double both = mix(mean_of(all, leaf), looks, leaf->before, &photons);
    for (uint32_t i = first; i < s->tree->count; i++)
        s->luminance[i] = light > 0 ? s->luminance[i] * (both * leaf->etendue / light) : both;
    if (s->tree->count == first + 1) /* a leaf still */
        s->variance[first] = (float)(1 / (looks + photons));
}

/* The same where looks tell outlines: notes how much light is expected of it, and how much the photons, nodes to->first and on
 * having grown of it, brought there; divide_light does the rest. */
static void pool_leaf(lmg_sapling *s, pool *to, double luminance, double variance, double etendue, const sums *all, double usual,
                      double light)
{
    if (!(light > 0)) { /* empty; with photons they got out between looks, and it isn't */
        s->tree->count = to->first + 1;
        s->tree->nodes[to->first] = (lmg_tree_node){.axis = LMG_LEAF};
        s->luminance[to->first] = luminance > 0 ? usual : 0;
        s->variance[to->first] = 0;
        light = s->luminance[to->first] * etendue;
    }
    to->flux = luminance * etendue;
    to->squares = to->flux * to->flux * variance;
    to->etendue = etendue;
    to->expected = light;
    to->end = s->tree->count;
    to->unknown = 1;
    if (all->luminance > 0) {
        /* as of a mean of looks; since there is an edge between these, it falls with the square of their number */
        const double mean = all->luminance / all->weight, spread = fmax(all->squares / all->weight / (mean * mean) - 1, 0);
        to->unknown = spread / (all->count * fmax(all->count / (1 + spread), 1));
    }
}

/* Photons' leaves are small along an outline, as what's empty in them would spread their light; now that it doesn't, light is even
 * over as many of them as stand together against each for itself (trees_grow.c).  Returns the score of what stands. */
static double pool_leaves(const former *was, uint32_t node)
{
    const lmg_tree_node *n = &was->tree->nodes[node];
    pool *p = &was->pools[node];
    double kept = 0;
    if (n->axis != LMG_LEAF) {
        kept = pool_leaves(was, node + 1) + pool_leaves(was, n->second);
        const pool *a = &was->pools[node + 1], *b = &was->pools[n->second];
        p->flux = a->flux + b->flux;
        p->squares = a->squares + b->squares;
        p->expected = a->expected + b->expected;
    }
    const double own = p->expected > 0 ? (p->flux * p->flux - POOL_PENALTY * p->squares) / p->expected : 0;
    p->even = n->axis == LMG_LEAF || own >= kept;
    return p->even ? own : kept;
}

/* Gives the pieces below a node their light, in proportion to what is expected of each.  even: the node around it over which light
 * is pooled, NULL if there is none. */
static void divide_light(lmg_sapling *s, const former *was, uint32_t node, const pool *even)
{
    const lmg_tree_node *n = &was->tree->nodes[node];
    const pool *p = &was->pools[node];
    if (!even && p->even)
        even = p;
    if (n->axis != LMG_LEAF) {
        divide_light(s, was, node + 1, even);
        divide_light(s, was, n->second, even);
        return;
    }
    if (!(even->flux > 0)) {
        for (uint32_t i = p->first; i < p->end; i++)
            s->luminance[i] = s->variance[i] = 0;
        return;
    }
    double luminance = even->flux / even->expected, variance = even->squares / (even->flux * even->flux);
    if (even != p && p->unknown > 0) {
        const double expected = p->expected / p->etendue, certain = 1 / (variance + p->unknown);
        double photons = p->flux > 0 ? p->flux * p->flux / p->squares : DARK_PHOTONS;
        luminance = expected > 0 ? mix(expected * luminance, certain, p->flux / p->etendue, &photons) / expected : 0;
        variance = 1 / (photons + certain);
    }
    for (uint32_t i = p->first; i < p->end; i++) {
        s->luminance[i] *= luminance;
        s->variance[i] = s->luminance[i] > 0 ? s->variance[i] + (float)variance : 0;
    }
}

/* Goes down a tree as it was, whose forks stay, and grows its leaves.  spread: relative variance of a look, of all leaves together:
 * one leaf's own goes with its mean, and would draw the mean down. */
static void grow_from(lmg_sapling *s, lmg_look_kind kind, const former *was, uint32_t node, const piece *p, double spread)
{
    const lmg_tree_node *n = &was->tree->nodes[node];
    if (n->axis == LMG_LEAF) {
        const double luminance = (double)n->radiance;
        const bool outline = kind == LMG_LOOK_OUTLINE;
        const sums all = sums_of(p->looks, p->count);
        const uint32_t first = s->tree->count;
        piece here = *p;
        double light;
        here.etendue = was->etendue[node];
        /* what no look stands for; of outlines as the rest, or, with p->before, as all that the root's looks expect */
        here.before = !outline ? luminance : all.count > 0 ? all.luminance / all.weight : p->before;
        here.variance = outline ? 0 : lmg_leaf_variance(n->code);
        if (all.count == 0 && !outline) {
            lmg_sapling_add(s, luminance, here.variance);
            return;
        }
        const double most = all.count > 0 ? fmax(all.luminance / all.weight, here.before) : here.before;
        here.usual = spread * most * most;
        grow_piece(s, &here, &all, &light);
        if (s->failed)
            return;
        if (!outline) {
            mix_light(s, first, &here, light, &all, spread);
            return;
        }
        was->pools[node].first = first;
        pool_leaf(s, &was->pools[node], luminance, lmg_leaf_variance(n->code), here.etendue, &all, p->before, light);
        return;
    }
    const uint32_t me = lmg_sapling_add(s, 0, 0);
    piece half[2];
    uint32_t second = 0;
    halve(p, n->axis, lmg_tree_cut(&p->box, n->axis, n->cut), was->begin[n->second] - was->begin[node], half);
    for (int k = 0; k < 2 && !s->failed; k++) {
        second = s->tree->count;
        grow_from(s, kind, was, k == 0 ? node + 1 : n->second, &half[k], spread);
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
    const lmg_tree *tree = &trees->trees[k];
    lmg_sapling s = {.tree = &r->trees->trees[k]};
    lmg_look *own = malloc(looks->count * sizeof *own);
    const bool outline = looks->kind == LMG_LOOK_OUTLINE;
    const former was = {tree, looks->etendue[k], malloc(tree->count * sizeof *was.begin),
                        outline ? malloc(tree->count * sizeof *was.pools) : NULL};
    s.failed = !own || !was.begin || (outline && !was.pools);
    for (uint32_t j = 0; j < trees->root_count && !s.failed; j++) {
        const uint32_t first = tree->first[j], end = lmg_root_end(trees, tree, j);
        double light = 0;
        for (uint32_t i = first; i < end; i++)
            light += tree->nodes[i].axis == LMG_LEAF ? (double)tree->nodes[i].radiance * was.etendue[i] : 0;
        piece p = {.looks = own, .box = lmg_tree_whole(), .key = lmg_next_key(lmg_next_key(~k) ^ j)};
        for (size_t i = 0; i < looks->count; i++)
            if (looks->look[i].weight > 0 && looks->root[i] == j)
                own[p.count++] = looks->look[i];
        const lmg_slab slab = lmg_root_slab(trees, &looks->field->layout, j);
        s.slab = &slab;
        s.tree->first[j] = s.tree->count;
        sort_looks(&was, first, &p.box, own, 0, p.count);
        const double spread = measure_spread(&was, first, end, own, p.count);
        if (outline) {
            const sums all = sums_of(own, p.count);
            p.before = all.luminance > 0 ? all.luminance / all.weight : 1;
        }
        p.edge_penalty = EDGE_PENALTY + (NOISY_EDGE_PENALTY - EDGE_PENALTY) * fmin(spread, 1);
        grow_from(&s, looks->kind, &was, first, &p, spread);
        if (outline && !s.failed) {
            pool_leaves(&was, first);
            divide_light(&s, &was, first, NULL);
        }
        if (!s.failed)
            lmg_sapling_set_leaves(&s, j, light);
    }
    free(was.pools);
    free(was.begin);
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
    made->tiling_count = field->trees->tiling_count;
    made->root_count = field->trees->root_count;
    memcpy(made->tilings, field->trees->tilings, sizeof made->tilings);
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
