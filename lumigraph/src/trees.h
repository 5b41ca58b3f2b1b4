/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Radiance trees, for the files of this library only: a second, sharper estimate of radiance from some of a bake's rays, for what
 * is seen directly.
 *
 * A slab's cells all have one shape, and light has edges in all four dimensions.  A *density estimation tree* [ram2011] halves the
 * slab's rectangle of (u,v,s,t) again and again across the axis that tells most, down to leaves that hold some tens of rays: small
 * where light is strong or sharp, large where it is even or dark.  A single tree is a staircase; the mean of several, whose cuts
 * lie elsewhere by chance [geurts2006], is finer than each and has less noise, since every ray counts in all of them.
 *
 * Roots are the wide slabs of the layout whose (s,t) is a direction; windows over beams are parts of them, and the coarse slabs
 * that catch the rest have no trees.
 */
#ifndef LUMIGRAPH_TREES_H
#define LUMIGRAPH_TREES_H

#include <lumigraph/lumigraph.h>

typedef struct lmg_tree_root {
    uint32_t slab;   /* of the layout, whose rectangle it is */
    float colour[3]; /* R,G,B of its rays together, at luminance 1 */
    double spread;   /* mean square over squared mean of the rays' fluxes: the variance of a count, in counts; at least 1 */
} lmg_tree_root;

/* In preorder: the first child of a fork follows it. */
typedef struct lmg_tree_node {
    union {
        uint32_t second; /* fork: its other child, index in the tree */
        float radiance;  /* leaf: cd/m2 */
    };
    uint8_t axis;  /* 0 to 3: fork across u, v, s, t; LMG_LEAF */
    uint8_t cut;   /* fork: place of the cut, see lmg_tree_cut */
    uint16_t code; /* leaf: of its count, see lmg_tree_count */
} lmg_tree_node;

/* LMG_TREE_BYTES: what trees take of a file at most, so that the cost of reading them is bounded.  8 trees of 4 M rays take 0.9 MB (spot). */
enum { LMG_LEAF = 4, LMG_TREE_CUTS = 32, LMG_TREE_DEPTH = 64, LMG_TREE_BYTES = 1 << 25 };

typedef struct lmg_tree {
    lmg_tree_node *nodes;
    uint32_t count, leaves;
    uint32_t first[LMG_MAX_SLABS]; /* node of each root */
    double unit[LMG_MAX_SLABS]; /* of each root, lumens of a count: the sum over leaves is the root's light, whatever rounding did
                                   to counts */
} lmg_tree;

typedef struct lmg_trees {
    uint32_t tree_count, root_count;
    uint64_t rays; /* that they were grown of */
    lmg_tree_root roots[LMG_MAX_SLABS];
    lmg_tree trees[LMG_MOST_TREES];
} lmg_trees;

/* A piece of a root's rectangle, in parts of it. */
typedef struct lmg_tree_box {
    double lo[4], hi[4];
} lmg_tree_box;

static inline lmg_tree_box lmg_tree_whole(void)
{
    return (lmg_tree_box){{0, 0, 0, 0}, {1, 1, 1, 1}};
}

/* Where a fork cuts its box: in the middle half of the axis. */
static inline double lmg_tree_cut(const lmg_tree_box *box, int axis, uint8_t cut)
{
    return box->lo[axis] + (box->hi[axis] - box->lo[axis]) * (0.25 + (cut + 0.5) * (0.5 / LMG_TREE_CUTS));
}

/* Counts are stored to the unit below LMG_EXACT_COUNTS and to 0.14 % above, which noise hides by far. */
enum { LMG_EXACT_COUNTS = 96, LMG_MOST_CODE = LMG_EXACT_COUNTS + 8191 };
double lmg_tree_count(uint16_t code);
uint16_t lmg_tree_code(double count);

/* Etendue of a piece, m2 sr. */
double lmg_tree_etendue(const lmg_slab *slab, const lmg_tree_box *box);

/* Sets the radiance of a root's leaves by their counts. */
void lmg_tree_fill(lmg_tree *tree, uint32_t root, const lmg_slab *slab);

void lmg_trees_destroy(lmg_trees *trees); /* accepts NULL */
size_t lmg_trees_memory(const lmg_trees *trees);
void lmg_trees_scale(lmg_trees *trees, double factor);

/* The root that a ray is in, and where it is in its rectangle, from 0 to below 1; -1: in none. */
int lmg_trees_root(const lmg_trees *trees, const lmg_layout *layout, lmg_vec3 origin, lmg_vec3 direction, float at[4]);

/* Luminance there, cd/m2; variance, may be NULL: of it. */
double lmg_trees_luminance(const lmg_trees *trees, int root, const float at[4], double *variance);

/* The bytes that trees take, at most. */
size_t lmg_trees_size(const lmg_trees *trees);

/* As bytes (docs/format.md, radiance trees), owned by the caller; NULL: no memory. */
unsigned char *lmg_trees_encode(const lmg_trees *trees, size_t *size);

/* From untrusted bytes.  Errors: LMG_ERROR_FILE_FORMAT, LMG_ERROR_FILE_VERSION, LMG_ERROR_MEMORY; the message goes on after the
 * file's name. */
lmg_result lmg_trees_decode(const unsigned char *bytes, size_t size, const lmg_layout *layout, lmg_trees **out, lmg_error *err);

#endif
