/* SPDX-License-Identifier: Apache-2.0 */
/* Tiles of a slab that share their light: how they are found among photons; trees.h tells what they are. */
#include "trees.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Tiles are compared in so many bins along u and v, and along s and t; and in halves along each, which tell what differs all over.
 */
enum { PLACES = 4, DIRECTIONS = 8, BINS = PLACES * PLACES * DIRECTIONS * DIRECTIONS, GROUPS = 16 };
/* Standard deviations of chance beyond which tiles differ: all bins together and the tiles' light; a single bin, of a thousand. */
static const double DIFFERENT = 4, DIFFERENT_BIN = 6;
/* Photons of a tile, unless it has none: with fewer nothing can be told. */
static const double FEWEST = 5000;
/* Rays that tell how many tiles along one axis are worth a closer look, and how many of these numbers get one. */
enum { LOOKED_AT = 400000, FINALISTS = 3 };
/* Logarithm of how often light repeats, on average, below which tiles aren't worth it. */
static const double WORTH_IT = 1.5;

uint32_t lmg_tile_root(const lmg_tiling *t, float at[4])
{
    if (t->nu == 1 && t->nv == 1)
        return t->first;
    const uint32_t n[2] = {t->nu, t->nv};
    uint32_t tile[2];
    for (int k = 0; k < 2; k++) {
        const double x = (double)at[k] * n[k];
        tile[k] = (uint32_t)x;
        at[k] = fminf((float)(x - tile[k]), 1 - 0x1p-24F);
    }
    return t->first + t->kind[tile[1] * t->nu + tile[0]];
}

void lmg_tile_place(const lmg_tiling *t, uint32_t kind, uint32_t which, double *u, double *v)
{
    uint32_t tile = 0;
    while (t->kind[tile] != kind || which-- > 0)
        tile++;
    *u = (tile % t->nu + *u) / t->nu;
    *v = (tile / t->nu + *v) / t->nv;
}

lmg_slab lmg_root_slab(const lmg_trees *trees, const lmg_layout *layout, uint32_t root)
{
    const lmg_tree_root *r = &trees->roots[root];
    const lmg_tiling *t = &trees->tilings[r->tiling];
    lmg_slab slab = layout->slabs[t->slab];
    slab.u1 = slab.u0 + (slab.u1 - slab.u0) * r->tiles / t->nu;
    slab.v1 = slab.v0 + (slab.v1 - slab.v0) / t->nv;
    return slab;
}

bool lmg_trees_set_roots(lmg_trees *trees)
{
    trees->root_count = 0;
    for (uint32_t k = 0; k < trees->tiling_count; k++) {
        lmg_tiling *t = &trees->tilings[k];
        t->first = trees->root_count;
        if (trees->root_count + t->kinds > LMG_MOST_ROOTS)
            return false;
        trees->root_count += t->kinds;
        for (uint32_t j = t->first; j < trees->root_count; j++) {
            trees->roots[j].tiling = k;
            trees->roots[j].tiles = 0;
        }
        for (uint32_t i = 0; i < t->nu * t->nv; i++)
            trees->roots[t->first + t->kind[i]].tiles++;
    }
    return true;
}

typedef struct bin {
    double flux, squares;
} bin;

/* Sum of squared deviations in bins of a tile from those of a kind's members' mean, in units of their variance, over what chance
 * makes of it, in standard deviations; infinite where a bin differs.  Chance is that of all of them together, since a bin without
 * photons knows nothing of its own; bins of less than one are taken as one. */
static double deviation_in(const bin *tile, const bin *kind, double members, int count)
{
    double chi = 0, expected = 0, chance = 0;
    bin few[2] = {{0}};
    for (int b = 0; b <= count; b++) {
        const bin *one = b < count ? &tile[b] : &few[0], *all = b < count ? &kind[b] : &few[1];
        const double squares = (one->squares + all->squares) / (members + 1), v = squares * (1 + 1 / members);
        const double mean = (one->flux + all->flux) / (members + 1), d = one->flux - all->flux / members;
        if (!(v > 0))
            continue;
        const double photons = mean * mean / squares;
        if (photons < 1 && b < count) {
            few[0].flux += one->flux;
            few[0].squares += one->squares;
            few[1].flux += all->flux;
            few[1].squares += all->squares;
            continue;
        }
        if (d * d > DIFFERENT_BIN * DIFFERENT_BIN * v)
            return INFINITY;
        chi += d * d / v;
        expected++;
        chance += 2 + 1 / photons; /* variance of that square, of a Poisson count */
    }
    return expected > 0 ? (chi - expected) / sqrt(chance) : 0;
}

/* The same in all bins, in groups of them, and of the light; the largest. */
static double deviation(const bin *tile, const bin *kind, double members)
{
    bin groups[2][GROUPS] = {{{0}}}, all[2] = {{0}};
    for (int k = 0; k < 2; k++)
        for (int b = 0; b < BINS; b++) {
            const int u = b / (PLACES * DIRECTIONS * DIRECTIONS), v = b / (DIRECTIONS * DIRECTIONS) % PLACES,
                      s = b / DIRECTIONS % DIRECTIONS, t = b % DIRECTIONS;
            bin *g = &groups[k][((u * 2 / PLACES * 2 + v * 2 / PLACES) * 2 + s * 2 / DIRECTIONS) * 2 + t * 2 / DIRECTIONS];
            const bin *x = k == 0 ? &tile[b] : &kind[b];
            g->flux += x->flux;
            g->squares += x->squares;
            all[k].flux += x->flux;
            all[k].squares += x->squares;
        }
    const double squares = (all[0].squares + all[1].squares) / (members + 1), d = all[0].flux - all[1].flux / members;
    if (squares > 0 && d * d > DIFFERENT * DIFFERENT * squares * (1 + 1 / members))
        return INFINITY;
    return fmax(deviation_in(tile, kind, members, BINS), deviation_in(groups[0], groups[1], members, GROUPS));
}

/* A test of many differences together. */
typedef struct test {
    double chi, expected, chance; /* sum of squares in units of variance, what chance makes of it, variance of that */
} test;

/* Adds the scatter of a kind's tiles about their mean in one bin, every size-th of these. */
static void add_scatter(test *all, const lmg_tiling *t, uint32_t kind, double members, const bin *bins, size_t size)
{
    double flux = 0, squares = 0, scatter = 0;
    for (uint32_t i = 0; i < t->nu * t->nv; i++)
        if (t->kind[i] == kind) {
            flux += bins[i * size].flux;
            squares += bins[i * size].squares;
        }
    flux /= members;
    squares /= members;
    if (!(squares > 0) || flux * flux < squares) /* less than a photon in a tile */
        return;
    for (uint32_t i = 0; i < t->nu * t->nv; i++)
        if (t->kind[i] == kind)
            scatter += (bins[i * size].flux - flux) * (bins[i * size].flux - flux);
    all->chi += scatter / squares;
    all->expected += members - 1;
    all->chance += (members - 1) * (2 + squares / (flux * flux));
}

/* Whether the tiles of all kinds scatter about their means as chance has them: single tiles of light that changes slowly may each
 * be near enough to a kind; together they aren't. */
static bool scatter_is_chance(const lmg_tiling *t, const uint32_t members[LMG_MOST_KINDS], const bin *bins, const bin *light)
{
    test of_light = {0}, of_bins = {0};
    for (uint32_t k = 0; k < t->kinds; k++) {
        if (members[k] < 2)
            continue;
        add_scatter(&of_light, t, k, members[k], light, 1);
        for (size_t b = 0; b < BINS; b++)
            add_scatter(&of_bins, t, k, members[k], bins + b, BINS);
    }
    return of_light.chi - of_light.expected <= DIFFERENT * sqrt(of_light.chance) &&
           of_bins.chi - of_bins.expected <= DIFFERENT * sqrt(of_bins.chance);
}

/* Cuts the rectangle into nu x nv tiles and sorts them by kind: each joins the kind that is most like it, or founds one.  Of every
 * step-th ray.  *worth: mean logarithm, by light, of how many tiles share it.  False: too many kinds, too few rays in a tile, or
 * kinds whose tiles aren't alike; no memory. */
static bool sort_tiles(lmg_tiling *t, uint32_t nu, uint32_t nv, const lmg_tree_point *p, size_t count, size_t step, double *worth)
{
    const uint32_t tiles = nu * nv;
    if ((double)(count / step) < FEWEST)
        return false;
    bin *bins = calloc((size_t)tiles * BINS, sizeof *bins), *kinds = calloc((size_t)LMG_MOST_KINDS * BINS, sizeof *kinds);
    bin light[LMG_MOST_TILES * LMG_MOST_TILES] = {{0}};
    uint32_t members[LMG_MOST_KINDS] = {0};
    const lmg_tiling cut = {.nu = nu, .nv = nv};
    bool good = bins && kinds;
    for (size_t i = 0; good && i < count; i += step) {
        const uint32_t iu = (uint32_t)((double)p[i].at[0] * nu), iv = (uint32_t)((double)p[i].at[1] * nv);
        float at[4];
        memcpy(at, p[i].at, sizeof at);
        lmg_tile_root(&cut, at);
        const uint32_t b =
            (((uint32_t)(at[0] * PLACES) * PLACES + (uint32_t)(at[1] * PLACES)) * DIRECTIONS + (uint32_t)(at[2] * DIRECTIONS)) *
                DIRECTIONS +
            (uint32_t)(at[3] * DIRECTIONS);
        bin *here = &bins[(size_t)(iv * nu + iu) * BINS + b];
        const double flux = (double)p[i].flux;
        here->flux += flux;
        here->squares += flux * flux;
    }
    double all = 0;
    for (uint32_t i = 0; good && i < tiles; i++) {
        for (int b = 0; b < BINS; b++) {
            light[i].flux += bins[(size_t)i * BINS + (size_t)b].flux;
            light[i].squares += bins[(size_t)i * BINS + (size_t)b].squares;
        }
        all += light[i].flux;
        good = !(light[i].flux > 0) || light[i].flux * light[i].flux >= FEWEST * light[i].squares;
    }
    lmg_tiling sorted = {.slab = t->slab, .nu = nu, .nv = nv};
    for (uint32_t i = 0; good && i < tiles; i++) {
        const bin *tile = bins + (size_t)i * BINS;
        double least = DIFFERENT;
        uint32_t kind = sorted.kinds;
        for (uint32_t k = 0; k < sorted.kinds; k++) {
            const double x = deviation(tile, kinds + (size_t)k * BINS, members[k]);
            if (x < least) {
                least = x;
                kind = k;
            }
        }
        good = kind < LMG_MOST_KINDS;
        if (!good)
            break;
        sorted.kinds += kind == sorted.kinds;
        sorted.kind[i] = (uint8_t)kind;
        members[kind]++;
        for (int b = 0; b < BINS; b++) {
            kinds[(size_t)kind * BINS + (size_t)b].flux += tile[b].flux;
            kinds[(size_t)kind * BINS + (size_t)b].squares += tile[b].squares;
        }
    }
    good = good && scatter_is_chance(&sorted, members, bins, light);
    free(bins);
    free(kinds);
    if (!good)
        return false;
    *worth = 0;
    for (uint32_t i = 0; i < tiles; i++)
        *worth += light[i].flux * log(members[sorted.kind[i]]) / all;
    *worth = rint(*worth * 1e6) * 1e-6; /* the same with every library's logarithm */
    *t = sorted;
    return true;
}

/* The numbers of tiles along one axis that are worth most by themselves, and one tile, which always goes. */
static int find_numbers(const lmg_tree_point *p, size_t count, int axis, uint32_t numbers[FINALISTS + 1])
{
    const size_t step = count > LOOKED_AT ? (count + LOOKED_AT - 1) / LOOKED_AT : 1;
    double worths[FINALISTS + 1] = {0};
    int found = 0;
    for (uint32_t n = 2; n <= LMG_MOST_TILES; n++) {
        lmg_tiling t = {0};
        double worth;
        if (!sort_tiles(&t, axis == 0 ? n : 1, axis == 0 ? 1 : n, p, count, step, &worth) || !(worth > 0))
            continue;
        int k = found < FINALISTS ? found++ : FINALISTS;
        for (; k > 0 && worths[k - 1] < worth; k--)
            if (k < FINALISTS) {
                worths[k] = worths[k - 1];
                numbers[k] = numbers[k - 1];
            }
        if (k < FINALISTS) {
            worths[k] = worth;
            numbers[k] = n;
        }
    }
    numbers[found] = 1;
    return found + 1;
}

void lmg_find_tiles(lmg_tiling *t, const lmg_tree_point *p, size_t count)
{
    const uint32_t slab = t->slab;
    *t = (lmg_tiling){.slab = slab, .nu = 1, .nv = 1, .kinds = 1};
    uint32_t nu[FINALISTS + 1], nv[FINALISTS + 1];
    const int us = find_numbers(p, count, 0, nu), vs = find_numbers(p, count, 1, nv);
    double most = WORTH_IT;
    for (int i = 0; i < us; i++)
        for (int j = 0; j < vs; j++) {
            lmg_tiling here = {.slab = slab};
            double worth;
            if (nu[i] * nv[j] > 1 && sort_tiles(&here, nu[i], nv[j], p, count, 1, &worth) && worth > most) {
                most = worth;
                *t = here;
            }
        }
}
