/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The inside of a lattice of density, between medium_grid.c, which makes it, and medium_volume.c, which walks through it.
 *
 * Cells and bricks.  A cell is a cube of side 1 in which density is one trilinear polynomial: between voxels i and i+1 (linear), or
 * around voxel i (nearest).  *Cell coordinates* are index coordinates, plus 1/2 for nearest, so that cell i is [i, i+1).  A brick
 * is 8^3 cells; *brick coordinates* are (cell coordinates) / 8 - base, so that brick b of the table is [b, b+1).  Where the medium
 * is so thin that light seldom collides within a brick, flights walk over blocks of group^3 bricks instead.
 */
#ifndef LUMINAIRES_MEDIUM_GRID_H
#define LUMINAIRES_MEDIUM_GRID_H

#include <luminaires/medium.h>

/* Values kept per brick: the corners of its cells, shared faces repeated, so that one brick answers for all its cells. */
enum { LUM_CORNERS = LUM_GRID_BRICK + 1, LUM_CELLS = LUM_GRID_BRICK * LUM_GRID_BRICK * LUM_GRID_BRICK };

#define LUM_NO_VALUES UINT64_MAX

typedef struct lum_brick {
    float least, most; /* bounds of the density in it; where it has no values of its own, the density everywhere in it */
    bool by_cell;      /* lum_brick_cells are there, and worth walking one by one */
    uint64_t values;   /* offset into lum_grid.values: 9^3 corners (linear) or 8^3 voxels (nearest); LUM_NO_VALUES */
} lum_brick;

struct lum_grid {
    lum_interpolation interpolation;
    int32_t base[3];   /* of the table, in bricks */
    int32_t bricks[3]; /* size of the table */
    lum_brick *table;  /* third index fastest */
    int32_t group;     /* bricks along the edge of a block: 1, 2, 4, ... */
    int32_t blocks[3]; /* size of the table of blocks */
    float *block_most; /* largest density in each block; NULL when group is 1 */
    float *values;
    double clip_low[3], clip_high[3]; /* brick coordinates; density is zero outside */
};

/* Offset into lum_grid.values of the largest density in each of the 8^3 cells of a brick that has them: after its corners; a voxel
 * that is constant is its own bound. */
static inline uint64_t lum_brick_cells(const lum_grid *g, const lum_brick *b)
{
    return b->values + (g->interpolation == LUM_INTERPOLATION_LINEAR ? LUM_CORNERS * LUM_CORNERS * LUM_CORNERS : 0);
}

static inline size_t lum_brick_index(const lum_grid *g, const int32_t b[3])
{
    return ((size_t)b[0] * (size_t)g->bricks[1] + (size_t)b[1]) * (size_t)g->bricks[2] + (size_t)b[2];
}

/* Density at q, in cells from a brick's corner; values are the brick's.  q is forced into [0, 8], against rounding. */
static inline double lum_brick_density(const float *values, lum_interpolation interpolation, const double q[3])
{
    int i[3];
    double f[3];
    for (int a = 0; a < 3; ++a) {
        i[a] = q[a] <= 0 ? 0 : q[a] >= LUM_GRID_BRICK ? LUM_GRID_BRICK - 1 : (int)q[a];
        f[a] = q[a] - i[a];
        f[a] = f[a] < 0 ? 0 : f[a] > 1 ? 1 : f[a];
    }
    if (interpolation == LUM_INTERPOLATION_NEAREST)
        return (double)values[(i[0] * LUM_GRID_BRICK + i[1]) * LUM_GRID_BRICK + i[2]];
    enum { Y = LUM_CORNERS, X = LUM_CORNERS * LUM_CORNERS };
    const float *v = values + i[0] * X + i[1] * Y + i[2];
    const double a00 = (double)v[0] + f[2] * ((double)v[1] - (double)v[0]);
    const double a01 = (double)v[Y] + f[2] * ((double)v[Y + 1] - (double)v[Y]);
    const double a10 = (double)v[X] + f[2] * ((double)v[X + 1] - (double)v[X]);
    const double a11 = (double)v[X + Y] + f[2] * ((double)v[X + Y + 1] - (double)v[X + Y]);
    const double a0 = a00 + f[1] * (a01 - a00), a1 = a10 + f[1] * (a11 - a10);
    return a0 + f[0] * (a1 - a0);
}

#endif
