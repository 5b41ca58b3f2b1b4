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
 * Photons tell where light is, and that to the size of a leaf: what has edges needs some ten of them on this side of each.  An eye
 * that looks into the lamp sees both sides, mostly without noise.  Where the baker can say what it sees, rays spread over the
 * leaves divide them further (trees_look.c, trees_refine.c), and a leaf may have an *edge*, a hyperplane across its box with another radiance on
 * each side.
 *
 * Trees belong to the wide slabs of the layout whose (s,t) is a direction; windows over beams are parts of them, and the coarse
 * slabs that catch the rest have none.
 *
 * Louvres and arrays of lenses repeat themselves.  Their slab's rectangle of (u,v) is cut into equal tiles, and those of one kind,
 * whose light photons can't tell apart, share a root and all its rays (trees_tile.c).
 */
#ifndef LUMIGRAPH_TREES_H
#define LUMIGRAPH_TREES_H

#include <lumigraph/lumigraph.h>

/* Tiles along one axis; kinds of a slab's; roots of all slabs. */
enum { LMG_MOST_TILES = 16, LMG_MOST_KINDS = 16, LMG_MOST_ROOTS = 64 };

typedef struct lmg_tiling {
    uint32_t slab;                                 /* of the layout */
    uint32_t nu, nv;                               /* tiles; 1, 1: none */
    uint32_t first, kinds;                         /* roots, one for each kind */
    uint8_t kind[LMG_MOST_TILES * LMG_MOST_TILES]; /* of tile iv nu + iu */
} lmg_tiling;

typedef struct lmg_tree_root {
    uint32_t tiling, tiles; /* how many have it; its coordinates go from 0 to 1 in each */
    float colour[3];        /* R,G,B of its rays together, at luminance 1 */
} lmg_tree_root;

/* In preorder: the first child of a fork follows it. */
typedef struct lmg_tree_node {
    union {
        uint32_t second; /* fork: its other child, index in the tree */
        float radiance;  /* leaf: cd/m2 */
    };
    uint8_t axis;  /* 0 to 3: fork across u, v, s, t; LMG_LEAF; LMG_EDGE: fork across a hyperplane, both children are leaves */
    uint8_t cut;   /* fork: place of the cut, see lmg_tree_cut, lmg_edge_below */
    uint16_t code; /* leaf: see lmg_leaf_code; edge: its normal, see lmg_edge_normal */
} lmg_tree_node;

/* LMG_TREE_BYTES: what trees take of a file at most, so that the cost of reading them is bounded.  8 trees of 16 M looks take 6 MB
 * (spot). */
enum { LMG_LEAF = 4, LMG_EDGE = 5, LMG_TREE_CUTS = 32, LMG_TREE_DEPTH = 64, LMG_TREE_BYTES = 1 << 25 };

typedef struct lmg_tree {
    lmg_tree_node *nodes;
    uint32_t count, leaves;
    uint32_t first[LMG_MOST_ROOTS]; /* node of each root */
    double unit[LMG_MOST_ROOTS];    /* of each root, cd/m2, what its leaves' codes are parts of: set so that the leaves' sum is the
                                      root's light, whatever rounding did to them */
} lmg_tree;

typedef struct lmg_trees {
    uint32_t tree_count, tiling_count, root_count;
    uint64_t rays, looks; /* that they were grown of */
    lmg_tiling tilings[LMG_MAX_SLABS];
    lmg_tree_root roots[LMG_MOST_ROOTS];
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

/*
 * An edge is where y = sum of |n_k| x_k (n_k >= 0) or |n_k| (1 - x_k) is (cut + 1) / LMG_EDGE_CUTS of its range, x_k from 0 to 1
 * across the box: so that every normal, -7 to 7 in each component, has its first side around a corner of the box.
 */
enum { LMG_EDGE_CUTS = 32, LMG_EDGE_MOST = 7 };

static inline void lmg_edge_normal(uint16_t code, int normal[4])
{
    for (int k = 0; k < 4; k++)
        normal[k] = (code >> (4 * k) & 15) - LMG_EDGE_MOST;
}

static inline uint16_t lmg_edge_code(const int normal[4])
{
    unsigned code = 0;
    for (int k = 0; k < 4; k++)
        code |= (unsigned)(normal[k] + LMG_EDGE_MOST) << (4 * k);
    return (uint16_t)code;
}

/* Whether a place in the box is on the first child's side. */
bool lmg_edge_below(const lmg_tree_node *edge, const lmg_tree_box *box, const float at[4]);

/* Etendue of the part of the box on the first child's side, m2 sr. */
double lmg_edge_etendue(const lmg_slab *slab, const lmg_tree_box *box, const int normal[4], unsigned cut);

/*
 * A leaf's code: its luminance, 64 steps an octave below the unit (so that rounding, 0.3 % RMS, is far below noise), times 16, plus
 * its precision, -log2 of a quarter of its relative variance.  0: dark.
 */
enum { LMG_LEAF_BRIGHTEST = 2047, LMG_LEAF_DARKEST = 32 };
uint16_t lmg_leaf_code(double part_of_unit, double relative_variance);
double lmg_leaf_part(uint16_t code);     /* of the unit */
double lmg_leaf_variance(uint16_t code); /* relative */

/* Etendue of a piece, m2 sr. */
double lmg_tree_etendue(const lmg_slab *slab, const lmg_tree_box *box);

/* Etendues of a root's leaves, by node of the tree; forks' stay as they are. */
void lmg_tree_etendues(const lmg_tree *tree, uint32_t root, const lmg_slab *slab, double *etendue);

/* Nodes of a root: first .. end - 1. */
static inline uint32_t lmg_root_end(const lmg_trees *trees, const lmg_tree *tree, uint32_t root)
{
    return root + 1 < trees->root_count ? tree->first[root + 1] : tree->count;
}

/* Sets the codes of a root's leaves, nodes first .. end - 1, to these luminances, in any unit, and relative variances, and the unit
 * so that together they have so much light, lm. */
void lmg_tree_set_leaves(lmg_tree *tree, uint32_t root, uint32_t end, const double *luminance, const float *variance,
                         const double *etendue, double light);

/* Sets the radiance of a root's leaves by their codes. */
void lmg_tree_fill(lmg_tree *tree, uint32_t root, uint32_t end);

/* When all roots are there: counts the leaves, gives back memory that isn't needed. */
void lmg_tree_end(lmg_tree *tree);

/* One tree while it grows. */
typedef struct lmg_sapling {
    const lmg_slab *slab; /* of the root at hand */
    lmg_tree *tree;
    double *luminance; /* of each node, as a leaf; in any unit */
    float *variance;   /* relative */
    size_t room;
    bool failed; /* no memory, or too many nodes */
} lmg_sapling;

/* Adds a leaf; its node, 0 on failure. */
uint32_t lmg_sapling_add(lmg_sapling *s, double luminance, double variance);

/* Sets the leaves of the root at hand, the last one so far, to the light that it has, lm. */
void lmg_sapling_set_leaves(lmg_sapling *s, uint32_t root, double light);

/* Frees what only growing needs; LMG_ERROR_MEMORY if it has failed. */
lmg_result lmg_sapling_end(lmg_sapling *s, lmg_error *err);

void lmg_trees_destroy(lmg_trees *trees); /* accepts NULL */
size_t lmg_trees_memory(const lmg_trees *trees);
void lmg_trees_scale(lmg_trees *trees, double factor);

/* The leaf around a place of a root and, unless box is NULL, its box; an edge's box for its leaves. */
const lmg_tree_node *lmg_tree_leaf(const lmg_tree *tree, uint32_t root, const float at[4], lmg_tree_box *box);

/* The root that a ray is in, and where it is in its rectangle, from 0 to below 1; -1: in none. */
int lmg_trees_root(const lmg_trees *trees, const lmg_layout *layout, lmg_vec3 origin, lmg_vec3 direction, float at[4]);

/* A root's slab as far as etendue goes: a rectangle of (u,v) as large as all its tiles together. */
lmg_slab lmg_root_slab(const lmg_trees *trees, const lmg_layout *layout, uint32_t root);

/* Sets the roots by the tilings: all but their colours, and where tilings begin; false: too many. */
bool lmg_trees_set_roots(lmg_trees *trees);

/* The root of a place of a slab's rectangle; the place: from now on in its tile. */
uint32_t lmg_tile_root(const lmg_tiling *t, float at[4]);

/* A place u, v of the kind's which-th tile, from then on of the slab's rectangle; all in parts of them. */
void lmg_tile_place(const lmg_tiling *t, uint32_t kind, uint32_t which, double *u, double *v);

/* A ray in a root's rectangle, or a slab's. */
typedef struct lmg_tree_point {
    float at[4];
    float flux; /* luminance, units */
} lmg_tree_point;

/* Finds tiles of a slab, t->slab, in the light of rays, sorted by something of their own. */
void lmg_find_tiles(lmg_tiling *t, const lmg_tree_point *points, size_t count);

/* Luminance there, cd/m2; variance, may be NULL: of it. */
double lmg_trees_luminance(const lmg_trees *trees, int root, const float at[4], double *variance);

/* The bytes that trees take; LMG_ERROR_UNSUPPORTED if a file may not hold so many. */
size_t lmg_trees_size(const lmg_trees *trees);
lmg_result lmg_trees_check_size(const lmg_trees *trees, lmg_error *err);

/* As bytes (docs/format.md, radiance trees), owned by the caller; NULL: no memory. */
unsigned char *lmg_trees_encode(const lmg_trees *trees, size_t *size);

/* From untrusted bytes.  Errors: LMG_ERROR_FILE_FORMAT, LMG_ERROR_FILE_VERSION, LMG_ERROR_MEMORY; the message goes on after the
 * file's name. */
lmg_result lmg_trees_decode(const unsigned char *bytes, size_t size, const lmg_layout *layout, lmg_trees **out, lmg_error *err);

#endif
