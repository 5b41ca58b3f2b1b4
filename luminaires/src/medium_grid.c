/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Making lattices of density: voxels come in brick by brick (the leaves of an OpenVDB tree are such bricks); at the end the corners
 * that neighbours share are copied together, and the bounds for null collisions are taken.
 */
#include "medium_grid.h"

#include "text.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The table of bricks takes 24 bytes each. */
static const uint64_t MAX_TABLE = UINT64_C(1) << 27;

/* A brick as it comes in: one value for all, or a block of 512 in builder.voxels. */
typedef struct raw_brick {
    uint32_t block; /* index, or NO_BLOCK */
    float value;
} raw_brick;

#define NO_BLOCK UINT32_MAX

struct lum_grid_builder {
    lum_interpolation interpolation;
    int32_t low[3], high[3]; /* voxels */
    int32_t base[3], bricks[3];
    raw_brick *table;
    float *voxels;
    uint32_t block_count, block_capacity;
};

static int32_t floor_brick(int64_t i)
{
    return (int32_t)(i >= 0 ? i / LUM_GRID_BRICK : -((-i + LUM_GRID_BRICK - 1) / LUM_GRID_BRICK));
}

lmg_result lum_grid_begin(const int32_t low[3], const int32_t high[3], lum_interpolation interpolation, lum_grid_builder **out,
                          lmg_error *err)
{
    *out = NULL;
    lum_grid_builder *b = calloc(1, sizeof(*b));
    if (!b)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    uint64_t count = 1;
    lmg_result result = LMG_OK;
    b->interpolation = interpolation;
    for (int a = 0; a < 3 && !result; ++a) {
        if (low[a] > high[a])
            result = lmg_fail(err, LMG_ERROR_INPUT, "the grid is empty");
        b->low[a] = low[a];
        b->high[a] = high[a];
        /* Trilinear interpolation reaches into the cell before the first voxel. */
        b->base[a] = floor_brick((int64_t)low[a] - (interpolation == LUM_INTERPOLATION_LINEAR));
        const int64_t bricks = (int64_t)floor_brick(high[a]) - b->base[a] + 1;
        if (!result && (bricks > (int64_t)MAX_TABLE || (count *= (uint64_t)bricks) > MAX_TABLE))
            result =
                lmg_fail(err, LMG_ERROR_INPUT, "the grid spans more than 2^27 bricks of 8^3 voxels; resample it more coarsely");
        b->bricks[a] = (int32_t)bricks;
    }
    if (!result) {
        b->table = malloc(count * sizeof(*b->table));
        if (!b->table)
            result = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a grid of %llu bricks", (unsigned long long)count);
    }
    if (result) {
        lum_grid_cancel(b);
        return result;
    }
    for (uint64_t i = 0; i < count; ++i)
        b->table[i] = (raw_brick){NO_BLOCK, 0};
    *out = b;
    return LMG_OK;
}

void lum_grid_cancel(lum_grid_builder *b)
{
    if (!b)
        return;
    free(b->table);
    free(b->voxels);
    free(b);
}

static raw_brick *raw_at(const lum_grid_builder *b, const int32_t brick[3])
{
    return &b->table[((size_t)brick[0] * (size_t)b->bricks[1] + (size_t)brick[1]) * (size_t)b->bricks[2] + (size_t)brick[2]];
}

/* Gives a brick voxels of its own. */
static lmg_result open_block(lum_grid_builder *b, raw_brick *raw, lmg_error *err)
{
    if (raw->block != NO_BLOCK)
        return LMG_OK;
    if (b->block_count == b->block_capacity) {
        const uint32_t capacity = b->block_capacity ? 2 * b->block_capacity : 64;
        float *grown = realloc(b->voxels, (size_t)capacity * LUM_CELLS * sizeof(*grown));
        if (!grown)
            return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a grid of %u bricks", (unsigned)capacity);
        b->voxels = grown;
        b->block_capacity = capacity;
    }
    raw->block = b->block_count++;
    for (int i = 0; i < LUM_CELLS; ++i)
        b->voxels[(size_t)raw->block * LUM_CELLS + (size_t)i] = raw->value;
    return LMG_OK;
}

static lmg_result check_density(float value, const int32_t voxel[3], lmg_error *err)
{
    if (isfinite(value) && value >= 0)
        return LMG_OK;
    return lmg_fail(err, LMG_ERROR_INPUT, "voxel (%d, %d, %d): density %g; densities are finite and not negative", (int)voxel[0],
                    (int)voxel[1], (int)voxel[2], (double)value);
}

static bool within(const lum_grid_builder *b, const int32_t voxel[3])
{
    bool in = true;
    for (int a = 0; a < 3; ++a)
        in = in && voxel[a] >= b->low[a] && voxel[a] <= b->high[a];
    return in;
}

lmg_result lum_grid_put(lum_grid_builder *b, const int32_t origin[3], const float values[512], lmg_error *err)
{
    int32_t brick[3];
    bool inside = true;
    for (int a = 0; a < 3; ++a) {
        brick[a] = floor_brick(origin[a]) - b->base[a];
        inside = inside && brick[a] >= 0 && brick[a] < b->bricks[a];
    }
    if (!inside)
        return LMG_OK;
    raw_brick *raw = raw_at(b, brick);
    LUM_TRY(open_block(b, raw, err));
    float *block = b->voxels + (size_t)raw->block * LUM_CELLS;
    for (int i = 0; i < LUM_CELLS; ++i) {
        const int32_t voxel[3] = {origin[0] + i / 64, origin[1] + i / 8 % 8, origin[2] + i % 8};
        LUM_TRY(check_density(values[i], voxel, err));
        block[i] = within(b, voxel) ? values[i] : 0;
    }
    return LMG_OK;
}

lmg_result lum_grid_fill(lum_grid_builder *b, const int32_t low[3], const int32_t high[3], float value, lmg_error *err)
{
    int32_t lo[3], hi[3], first[3], last[3], k[3];
    LUM_TRY(check_density(value, low, err));
    for (int a = 0; a < 3; ++a) {
        lo[a] = low[a] > b->low[a] ? low[a] : b->low[a];
        hi[a] = high[a] < b->high[a] ? high[a] : b->high[a];
        if (lo[a] > hi[a])
            return LMG_OK;
        first[a] = floor_brick(lo[a]) - b->base[a];
        last[a] = floor_brick(hi[a]) - b->base[a];
    }
    for (k[0] = first[0]; k[0] <= last[0]; ++k[0])
        for (k[1] = first[1]; k[1] <= last[1]; ++k[1])
            for (k[2] = first[2]; k[2] <= last[2]; ++k[2]) {
                raw_brick *raw = raw_at(b, k);
                int32_t from[3], to[3];
                bool whole = true;
                for (int a = 0; a < 3; ++a) {
                    const int32_t corner = (k[a] + b->base[a]) * LUM_GRID_BRICK;
                    from[a] = lo[a] > corner ? lo[a] - corner : 0;
                    to[a] = hi[a] < corner + LUM_GRID_BRICK - 1 ? hi[a] - corner : LUM_GRID_BRICK - 1;
                    whole = whole && from[a] == 0 && to[a] == LUM_GRID_BRICK - 1;
                }
                if (whole && raw->block == NO_BLOCK) {
                    raw->value = value;
                    continue;
                }
                LUM_TRY(open_block(b, raw, err));
                float *block = b->voxels + (size_t)raw->block * LUM_CELLS;
                for (int32_t x = from[0]; x <= to[0]; ++x)
                    for (int32_t y = from[1]; y <= to[1]; ++y)
                        for (int32_t z = from[2]; z <= to[2]; ++z)
                            block[(x * 8 + y) * 8 + z] = value;
            }
    return LMG_OK;
}

/* Value of the voxel at offset i (0 .. 8) of a brick: of the next brick where an i is 8, zero beyond the table. */
static float raw_value(const lum_grid_builder *b, const int32_t brick[3], int x, int y, int z)
{
    const int32_t at[3] = {brick[0] + x / 8, brick[1] + y / 8, brick[2] + z / 8};
    for (int a = 0; a < 3; ++a)
        if (at[a] >= b->bricks[a])
            return 0;
    const raw_brick *raw = raw_at(b, at);
    if (raw->block == NO_BLOCK)
        return raw->value;
    return b->voxels[(size_t)raw->block * LUM_CELLS + (size_t)((x % 8 * 8 + y % 8) * 8 + z % 8)];
}

/* The voxels that differ from zero, bounds inclusive; false when there are none. */
static bool find_extent(const lum_grid_builder *b, int32_t low[3], int32_t high[3])
{
    bool any = false;
    int32_t k[3];
    for (k[0] = 0; k[0] < b->bricks[0]; ++k[0])
        for (k[1] = 0; k[1] < b->bricks[1]; ++k[1])
            for (k[2] = 0; k[2] < b->bricks[2]; ++k[2]) {
                const raw_brick *raw = raw_at(b, k);
                if (raw->block == NO_BLOCK && raw->value == 0)
                    continue;
                for (int i = 0; i < LUM_CELLS; ++i) {
                    const int v[3] = {i / 64, i / 8 % 8, i % 8};
                    if (raw->block != NO_BLOCK && b->voxels[(size_t)raw->block * LUM_CELLS + (size_t)i] == 0)
                        continue;
                    for (int a = 0; a < 3; ++a) {
                        const int32_t x = (k[a] + b->base[a]) * LUM_GRID_BRICK + v[a];
                        low[a] = any && low[a] < x ? low[a] : x;
                        high[a] = any && high[a] > x ? high[a] : x;
                    }
                    any = true;
                }
            }
    return any;
}

/* What a brick will hold. */
typedef struct brick_plan {
    float values[LUM_CORNERS * LUM_CORNERS * LUM_CORNERS];
    float cells[LUM_CELLS];
    float least, most;
    bool constant, by_cell;
} brick_plan;

/*
 * Bounds of single cells pay when the brick's bound would cause more null collisions on a way across it than the eight or so steps
 * from cell to cell cost: about four, as a null collision costs two such steps.
 */
static const double NULL_COLLISIONS_WORTH_CELLS = 4;

static void plan_brick(const lum_grid_builder *b, const lum_grid *g, const int32_t brick[3], double voxel_depth, brick_plan *p)
{
    const bool linear = b->interpolation == LUM_INTERPOLATION_LINEAR;
    const int n = linear ? LUM_CORNERS : LUM_GRID_BRICK, reach = linear ? 2 : 1;
    for (int x = 0; x < n; ++x)
        for (int y = 0; y < n; ++y)
            for (int z = 0; z < n; ++z)
                p->values[(x * n + y) * n + z] = raw_value(b, brick, x, y, z);
    /* Cells that lie outside the clip box are never met. */
    int from[3], to[3];
    for (int a = 0; a < 3; ++a) {
        const double lo = (g->clip_low[a] - brick[a]) * LUM_GRID_BRICK, hi = (g->clip_high[a] - brick[a]) * LUM_GRID_BRICK;
        from[a] = lo > 0 ? (int)lo : 0;
        to[a] = hi < LUM_GRID_BRICK ? (int)hi : LUM_GRID_BRICK;
    }
    double sum = 0, cells = 0;
    float least = INFINITY;
    p->most = 0;
    memset(p->cells, 0, sizeof(p->cells));
    for (int x = from[0]; x < to[0]; ++x)
        for (int y = from[1]; y < to[1]; ++y)
            for (int z = from[2]; z < to[2]; ++z) {
                float most = 0;
                for (int c = 0; c < reach * reach * reach; ++c) {
                    const float v = p->values[((x + c / (reach * reach)) * n + y + c / reach % reach) * n + z + c % reach];
                    most = v > most ? v : most;
                    least = v < least ? v : least;
                }
                p->cells[(x * 8 + y) * 8 + z] = most;
                p->most = most > p->most ? most : p->most;
                sum += (double)most;
                ++cells;
            }
    p->constant = !(cells > 0) || least == p->most;
    p->least = p->constant ? p->most : least;
    p->by_cell = !p->constant && ((double)p->most - sum / cells) * LUM_GRID_BRICK * voxel_depth > NULL_COLLISIONS_WORTH_CELLS;
}

/* First pass: counts the numbers that the bricks need.  Second pass, when g->values is there: writes them. */
static uint64_t fill_bricks(const lum_grid_builder *b, lum_grid *g, double voxel_depth, brick_plan *p)
{
    const bool linear = b->interpolation == LUM_INTERPOLATION_LINEAR;
    const uint64_t size = linear ? LUM_CORNERS * LUM_CORNERS * LUM_CORNERS : LUM_CELLS;
    uint64_t used = 0;
    int32_t k[3];
    for (k[0] = 0; k[0] < b->bricks[0]; ++k[0])
        for (k[1] = 0; k[1] < b->bricks[1]; ++k[1])
            for (k[2] = 0; k[2] < b->bricks[2]; ++k[2]) {
                plan_brick(b, g, k, voxel_depth, p);
                lum_brick *brick = &g->table[lum_brick_index(g, k)];
                *brick = (lum_brick){.least = p->least, .most = p->most, .by_cell = p->by_cell, .values = LUM_NO_VALUES};
                if (p->constant)
                    continue;
                brick->values = used;
                if (g->values)
                    memcpy(g->values + used, p->values, size * sizeof(float));
                used += size;
                if (p->by_cell && linear) {
                    if (g->values)
                        memcpy(g->values + used, p->cells, sizeof(p->cells));
                    used += LUM_CELLS;
                }
            }
    return used;
}

/*
 * What a flight costs per unit of length: steps from block to block, and null collisions, which fetch values from memory; times in
 * nanoseconds as measured, but only their ratio matters.
 */
static const double STEP_COST = 10, NULL_COLLISION_COST = 60;
enum { LARGEST_GROUP = 16 };

/* Largest densities in blocks of group^3 bricks; most: as many numbers as there are blocks.  Returns their mean. */
static double fill_blocks(const lum_grid *g, int32_t group, const int32_t blocks[3], float *most)
{
    const size_t count = (size_t)blocks[0] * (size_t)blocks[1] * (size_t)blocks[2];
    double sum = 0;
    int32_t k[3];
    memset(most, 0, count * sizeof(*most));
    for (k[0] = 0; k[0] < g->bricks[0]; ++k[0])
        for (k[1] = 0; k[1] < g->bricks[1]; ++k[1])
            for (k[2] = 0; k[2] < g->bricks[2]; ++k[2]) {
                const size_t block = ((size_t)(k[0] / group) * (size_t)blocks[1] + (size_t)(k[1] / group)) * (size_t)blocks[2] +
                                     (size_t)(k[2] / group);
                const float here = g->table[lum_brick_index(g, k)].most;
                most[block] = here > most[block] ? here : most[block];
            }
    for (size_t i = 0; i < count; ++i)
        sum += (double)most[i];
    return sum / (double)count;
}

static void count_blocks(const lum_grid *g, int32_t group, int32_t blocks[3])
{
    for (int a = 0; a < 3; ++a)
        blocks[a] = (g->bricks[a] + group - 1) / group;
}

/* Chooses the size of blocks that costs least.  Where single cells are worth walking, bricks stay: what is dense there is found
 * soon enough. */
static lmg_result make_blocks(lum_grid *g, double voxel_depth, lmg_error *err)
{
    const size_t count = (size_t)g->bricks[0] * (size_t)g->bricks[1] * (size_t)g->bricks[2];
    g->group = 1;
    for (size_t i = 0; i < count; ++i)
        if (g->table[i].by_cell)
            return LMG_OK;
    float *most = malloc(count * sizeof(*most));
    if (!most)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a grid of %zu bricks", count);
    double cheapest = INFINITY;
    for (int32_t group = 1; group <= LARGEST_GROUP; group *= 2) {
        int32_t blocks[3];
        count_blocks(g, group, blocks);
        const double mean = fill_blocks(g, group, blocks, most);
        const double cost = STEP_COST / (LUM_GRID_BRICK * group) + NULL_COLLISION_COST * mean * voxel_depth;
        if (cost < cheapest) {
            cheapest = cost;
            g->group = group;
        }
    }
    if (g->group > 1) {
        count_blocks(g, g->group, g->blocks);
        fill_blocks(g, g->group, g->blocks, most);
        g->block_most = most;
    } else {
        free(most);
    }
    return LMG_OK;
}

static lmg_result build(const lum_grid_builder *b, lum_grid *g, double voxel_depth, lmg_error *err)
{
    const bool linear = b->interpolation == LUM_INTERPOLATION_LINEAR;
    int32_t low[3] = {0}, high[3] = {0};
    if (!find_extent(b, low, high))
        return lmg_fail(err, LMG_ERROR_INPUT, "all densities are zero");
    g->interpolation = b->interpolation;
    uint64_t count = 1;
    for (int a = 0; a < 3; ++a) {
        g->base[a] = b->base[a];
        g->bricks[a] = b->bricks[a];
        count *= (uint64_t)b->bricks[a];
        g->clip_low[a] = ((double)low[a] - (linear ? 1 : 0)) / LUM_GRID_BRICK - g->base[a];
        g->clip_high[a] = ((double)high[a] + 1) / LUM_GRID_BRICK - g->base[a];
    }
    g->table = malloc(count * sizeof(*g->table));
    brick_plan *p = malloc(sizeof(*p));
    lmg_result result = LMG_OK;
    if (g->table && p) {
        const uint64_t numbers = fill_bricks(b, g, voxel_depth, p);
        g->values = malloc((numbers ? numbers : 1) * sizeof(float));
        if (g->values)
            fill_bricks(b, g, voxel_depth, p);
    }
    if (!g->table || !p || !g->values)
        result = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for a grid of %llu bricks", (unsigned long long)count);
    free(p);
    return result ? result : make_blocks(g, voxel_depth, err);
}

lmg_result lum_grid_end(lum_grid_builder *b, double voxel_depth, lum_grid **out, lmg_error *err)
{
    *out = NULL;
    lum_grid *g = calloc(1, sizeof(*g));
    lmg_result result = g ? build(b, g, voxel_depth, err) : lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    lum_grid_cancel(b);
    if (result)
        lum_grid_destroy(g);
    else
        *out = g;
    return result;
}

void lum_grid_destroy(lum_grid *g)
{
    if (!g)
        return;
    free(g->table);
    free(g->block_most);
    free(g->values);
    free(g);
}

lmg_result lum_grid_create(const int32_t low[3], const uint32_t size[3], const float *values, lum_interpolation interpolation,
                           double voxel_depth, lum_grid **out, lmg_error *err)
{
    *out = NULL;
    int32_t high[3], k[3];
    for (int a = 0; a < 3; ++a) {
        if (size[a] == 0 || size[a] > INT32_MAX / 2 || low[a] < -INT32_MAX / 2 || low[a] > INT32_MAX / 2)
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "lum_grid_create: a size or position is out of range");
        high[a] = low[a] + (int32_t)size[a] - 1;
    }
    lum_grid_builder *b;
    LUM_TRY(lum_grid_begin(low, high, interpolation, &b, err));
    for (k[0] = 0; k[0] < b->bricks[0]; ++k[0])
        for (k[1] = 0; k[1] < b->bricks[1]; ++k[1])
            for (k[2] = 0; k[2] < b->bricks[2]; ++k[2]) {
                int32_t origin[3];
                float block[LUM_CELLS];
                for (int a = 0; a < 3; ++a)
                    origin[a] = (k[a] + b->base[a]) * LUM_GRID_BRICK;
                for (int i = 0; i < LUM_CELLS; ++i) {
                    const int32_t voxel[3] = {origin[0] + i / 64, origin[1] + i / 8 % 8, origin[2] + i % 8};
                    block[i] = within(b, voxel)
                                   ? values[((size_t)(voxel[0] - low[0]) * size[1] + (size_t)(voxel[1] - low[1])) * size[2] +
                                            (size_t)(voxel[2] - low[2])]
                                   : 0;
                }
                const lmg_result result = lum_grid_put(b, origin, block, err);
                if (result) {
                    lum_grid_cancel(b);
                    return result;
                }
            }
    return lum_grid_end(b, voxel_depth, out, err);
}

static double cell_offset(const lum_grid *g)
{
    return g->interpolation == LUM_INTERPOLATION_NEAREST ? 0.5 : 0;
}

double lum_grid_density(const lum_grid *g, const double p[3])
{
    double q[3];
    int32_t brick[3];
    for (int a = 0; a < 3; ++a) {
        const double x = (p[a] + cell_offset(g)) / LUM_GRID_BRICK - g->base[a];
        if (!(x >= g->clip_low[a] && x < g->clip_high[a]))
            return 0;
        brick[a] = (int32_t)x;
        q[a] = (x - brick[a]) * LUM_GRID_BRICK;
    }
    const lum_brick *b = &g->table[lum_brick_index(g, brick)];
    return b->values == LUM_NO_VALUES ? (double)b->most : lum_brick_density(g->values + b->values, g->interpolation, q);
}

void lum_grid_bounds(const lum_grid *g, double low[3], double high[3])
{
    for (int a = 0; a < 3; ++a) {
        low[a] = (g->clip_low[a] + g->base[a]) * LUM_GRID_BRICK - cell_offset(g);
        high[a] = (g->clip_high[a] + g->base[a]) * LUM_GRID_BRICK - cell_offset(g);
    }
}
