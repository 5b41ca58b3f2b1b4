/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Radiance trees as bytes: docs/format.md, radiance trees.  A fork is a byte, an edge four, a leaf two, a dark one a byte.  Bytes
 * of files are untrusted: nothing is believed but what fits.
 */
#include "field.h"
#include "trees.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { VERSION = 3, HEAD = 24, PER_TILING = 8, PER_ROOT = 12, HASH = 8 };
/* First bytes: of a dark leaf, of an edge; up to LEAST_FORK of a leaf with light. */
enum { DARK = 0, EDGE = 1, LEAST_FORK = 0x80 };

/* lmg_hash's. */
static const uint64_t HASH_START = 0xcbf29ce484222325u;
/* Luminance beyond what any lamp has: sums and products of it stay finite. */
static const double MOST_UNIT = 1e30;

static const double PER_OCTAVE = 64;

double lmg_leaf_part(uint16_t code)
{
    return code > 0 ? exp2(((code >> 4) - LMG_LEAF_BRIGHTEST) / PER_OCTAVE) : 0;
}

double lmg_leaf_variance(uint16_t code)
{
    return code > 0 ? exp2(2 - (code & 15)) : 0;
}

uint16_t lmg_leaf_code(double part_of_unit, double relative_variance)
{
    if (!(part_of_unit > 0))
        return 0;
    const double part = LMG_LEAF_BRIGHTEST + rint(PER_OCTAVE * log2(part_of_unit));
    if (part < LMG_LEAF_DARKEST)
        return 0;
    const double precision = relative_variance > 0 ? rint(2 - log2(relative_variance)) : 15;
    return (uint16_t)((unsigned)fmin(part, LMG_LEAF_BRIGHTEST) << 4 | (unsigned)fmin(fmax(precision, 0), 15));
}

/* ------------------------------------------------------------------------------------------------------------- writing */

typedef struct writer {
    unsigned char *at;
} writer;

static void put(writer *b, uint64_t value, int count)
{
    for (int i = 0; i < count; i++)
        *b->at++ = (unsigned char)(value >> (8 * i));
}

static void put_double(writer *b, double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    put(b, bits, 8);
}

static void put_float(writer *b, float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    put(b, bits, 4);
}

static size_t size_of(const lmg_tree_node *n)
{
    return n->axis == LMG_EDGE ? 4 : n->axis == LMG_LEAF && n->code > 0 ? 2 : 1;
}

size_t lmg_trees_size(const lmg_trees *trees)
{
    size_t sum = HEAD + (size_t)trees->root_count * PER_ROOT + HASH;
    for (uint32_t k = 0; k < trees->tiling_count; k++)
        sum += PER_TILING + (size_t)trees->tilings[k].nu * trees->tilings[k].nv;
    for (uint32_t k = 0; k < trees->tree_count; k++) {
        sum += (size_t)trees->root_count * 8;
        for (uint32_t i = 0; i < trees->trees[k].count; i++)
            sum += size_of(&trees->trees[k].nodes[i]);
    }
    return sum;
}

unsigned char *lmg_trees_encode(const lmg_trees *trees, size_t *size)
{
    unsigned char *start = malloc(lmg_trees_size(trees));
    if (!start)
        return NULL;
    writer b = {start};
    put(&b, VERSION, 4);
    put(&b, trees->tree_count, 2);
    put(&b, trees->tiling_count, 2);
    put(&b, trees->rays, 8);
    put(&b, trees->looks, 8);
    for (uint32_t k = 0; k < trees->tiling_count; k++) {
        const lmg_tiling *t = &trees->tilings[k];
        put(&b, t->slab, 4);
        put(&b, t->nu, 1);
        put(&b, t->nv, 1);
        put(&b, t->kinds, 2);
        for (uint32_t i = 0; i < t->nu * t->nv; i++)
            put(&b, t->kind[i], 1);
    }
    for (uint32_t j = 0; j < trees->root_count; j++)
        for (int c = 0; c < 3; c++)
            put_float(&b, trees->roots[j].colour[c]);
    for (uint32_t k = 0; k < trees->tree_count; k++) {
        const lmg_tree *tree = &trees->trees[k];
        for (uint32_t j = 0; j < trees->root_count; j++)
            put_double(&b, tree->unit[j]);
        for (uint32_t i = 0; i < tree->count; i++) {
            const lmg_tree_node *n = &tree->nodes[i];
            if (n->axis == LMG_LEAF && n->code == 0) {
                put(&b, DARK, 1);
            } else if (n->axis == LMG_LEAF) {
                put(&b, n->code >> 8, 1);
                put(&b, n->code & 255, 1);
            } else if (n->axis == LMG_EDGE) {
                put(&b, EDGE, 1);
                put(&b, n->code, 2);
                put(&b, n->cut, 1);
            } else {
                put(&b, LEAST_FORK | (unsigned)n->axis << 5 | n->cut, 1);
            }
        }
    }
    put(&b, lmg_hash(HASH_START, start, (size_t)(b.at - start)), 8);
    *size = (size_t)(b.at - start);
    return start;
}

/* ------------------------------------------------------------------------------------------------------------- reading */

typedef struct reader {
    const unsigned char *at, *end;
    bool failed;
    bool edges; /* only looks find them: lmg_looks_create relies on that */
} reader;

static uint64_t get(reader *r, int count)
{
    uint64_t value = 0;
    if (r->end - r->at < count) {
        r->failed = true;
        r->at = r->end;
        return 0;
    }
    for (int i = 0; i < count; i++)
        value |= (uint64_t)*r->at++ << (8 * i);
    return value;
}

static double get_double(reader *r)
{
    const uint64_t bits = get(r, 8);
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static float get_float(reader *r)
{
    const uint32_t bits = (uint32_t)get(r, 4);
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* A leaf that begins with this byte. */
static bool get_leaf(reader *r, lmg_tree *tree, unsigned byte)
{
    lmg_tree_node *n = &tree->nodes[tree->count++];
    *n = (lmg_tree_node){.axis = LMG_LEAF};
    if (byte != DARK)
        n->code = (uint16_t)(byte << 8 | get(r, 1));
    return !r->failed && byte != EDGE && byte < LEAST_FORK;
}

static bool get_edge(reader *r, lmg_tree *tree)
{
    lmg_tree_node *n = &tree->nodes[tree->count++];
    *n = (lmg_tree_node){.axis = LMG_EDGE, .second = tree->count + 1};
    n->code = (uint16_t)get(r, 2);
    n->cut = (uint8_t)get(r, 1);
    int normal[4];
    lmg_edge_normal(n->code, normal);
    bool good = r->edges && (normal[0] != 0 || normal[1] != 0 || normal[2] != 0 || normal[3] != 0);
    for (int k = 0; k < 4; k++)
        good = good && normal[k] <= LMG_EDGE_MOST;
    good = good && n->cut < LMG_EDGE_CUTS - 1 && !r->failed;
    for (int k = 0; k < 2; k++)
        good = good && get_leaf(r, tree, (unsigned)get(r, 1));
    return good;
}

/* The nodes of one root, in preorder; false when they aren't a tree. */
static bool get_nodes(reader *r, lmg_tree *tree, unsigned depth)
{
    const unsigned byte = (unsigned)get(r, 1);
    if (r->failed || depth >= LMG_TREE_DEPTH)
        return false;
    if (byte == EDGE)
        return get_edge(r, tree);
    if (byte < LEAST_FORK)
        return get_leaf(r, tree, byte);
    const uint32_t me = tree->count++;
    tree->nodes[me] = (lmg_tree_node){.axis = (uint8_t)(byte >> 5 & 3), .cut = (uint8_t)(byte & 31)};
    if (!get_nodes(r, tree, depth + 1))
        return false;
    tree->nodes[me].second = tree->count;
    return get_nodes(r, tree, depth + 1);
}

static bool get_tree(reader *r, const lmg_trees *trees, lmg_tree *tree)
{
    for (uint32_t j = 0; j < trees->root_count; j++) {
        tree->unit[j] = get_double(r);
        if (!(tree->unit[j] >= 0) || !(tree->unit[j] <= MOST_UNIT))
            return false;
    }
    for (uint32_t j = 0; j < trees->root_count; j++) {
        tree->first[j] = tree->count;
        if (!get_nodes(r, tree, 0))
            return false;
        lmg_tree_fill(tree, j, tree->count);
    }
    return true;
}

static bool get_tiling(reader *r, const lmg_layout *layout, lmg_tiling *t)
{
    *t = (lmg_tiling){.slab = (uint32_t)get(r, 4)};
    t->nu = (uint32_t)get(r, 1);
    t->nv = (uint32_t)get(r, 1);
    t->kinds = (uint32_t)get(r, 2);
    if (r->failed || t->slab >= layout->slab_count || t->nu < 1 || t->nu > LMG_MOST_TILES || t->nv < 1 || t->nv > LMG_MOST_TILES ||
        t->kinds < 1 || t->kinds > LMG_MOST_KINDS)
        return false;
    for (uint32_t i = 0; i < t->nu * t->nv; i++) {
        t->kind[i] = (uint8_t)get(r, 1);
        if (t->kind[i] >= t->kinds)
            return false;
    }
    return !r->failed && (layout->slabs[t->slab].kind != LMG_SLAB_CUBE || isinf(layout->slabs[t->slab].distance));
}

static bool get_roots(reader *r, const lmg_layout *layout, lmg_trees *trees)
{
    for (uint32_t k = 0; k < trees->tiling_count; k++)
        if (!get_tiling(r, layout, &trees->tilings[k]))
            return false;
    if (!lmg_trees_set_roots(trees))
        return false;
    for (uint32_t j = 0; j < trees->root_count; j++) {
        bool good = trees->roots[j].tiles > 0;
        for (int c = 0; c < 3; c++) {
            trees->roots[j].colour[c] = get_float(r);
            good = good && isfinite(trees->roots[j].colour[c]);
        }
        if (!good || r->failed)
            return false;
    }
    return true;
}

lmg_result lmg_trees_decode(const unsigned char *bytes, size_t size, const lmg_layout *layout, lmg_trees **out, lmg_error *err)
{
    *out = NULL;
    static const char damaged[] = "its radiance trees are damaged; copy or bake it again";
    if (size < HEAD + HASH || size > LMG_TREE_BYTES)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s", damaged);
    reader r = {bytes, bytes + size - HASH, false, false}, tail = {bytes + size - HASH, bytes + size, false, false};
    const uint64_t hash = get(&tail, HASH);
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION /* or a fuzzer would hardly get past this line */
    (void)hash;
#else
    if (hash != lmg_hash(HASH_START, bytes, size - HASH))
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s", damaged);
#endif
    const uint64_t version = get(&r, 4);
    if (version != VERSION)
        return lmg_fail(err, LMG_ERROR_FILE_VERSION, "its radiance trees have version %u; this library (%s) reads version %d",
                        (unsigned)version, LMG_VERSION_STRING, VERSION);
    lmg_trees *trees = calloc(1, sizeof *trees);
    if (!trees)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for its radiance trees");
    trees->tree_count = (uint32_t)get(&r, 2);
    trees->tiling_count = (uint32_t)get(&r, 2);
    trees->rays = get(&r, 8);
    trees->looks = get(&r, 8);
    r.edges = trees->looks > 0;
    const bool possible = trees->tree_count >= 1 && trees->tree_count <= LMG_MOST_TREES && trees->tiling_count >= 1 &&
                          trees->tiling_count <= LMG_MAX_SLABS;
    if (!possible)
        trees->tree_count = 0;
    bool good = possible && get_roots(&r, layout, trees), memory = true;
    for (uint32_t k = 0; good && k < trees->tree_count; k++) {
        lmg_tree *tree = &trees->trees[k];
        /* a node takes a byte at least */
        tree->nodes = malloc((size_t)(r.end - r.at + 1) * sizeof *tree->nodes);
        memory = tree->nodes != NULL;
        good = memory && get_tree(&r, trees, tree);
        if (good)
            lmg_tree_end(tree);
    }
    if (good && r.at == r.end) {
        *out = trees;
        return LMG_OK;
    }
    lmg_trees_destroy(trees);
    return memory ? lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s", damaged)
                  : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for its radiance trees");
}
