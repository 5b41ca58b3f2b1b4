/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Where rays are counted.  Every sum is an integer, so the order of deposits doesn't matter and any number of threads gives the same
 * bits.  Rounding to the fixed point is stochastic, keyed by the photon's number and channel: the same photon always gives the same
 * integers, yet the mean has no bias however small the weights are (rounding to nearest would turn a million photons of weight 1.5e-6
 * into twice or half their flux).
 * A batch goes in passes: rays into columns, their fixed-point numbers, their cells (place.c), which are prefetched; then it is added.  A
 * random cell in a large table costs a memory access, and the accesses of a batch overlap.
 */
#include "accumulate.h"
#include "field.h"
#include "memory.h"
#include "place.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#define PREFETCH_WRITE(p) __builtin_prefetch((const void *)(uintptr_t)(p), 1)
#else
#define PREFETCH_WRITE(p) ((void)(p))
#endif

lmg_result lmg_accumulator_create(const lmg_layout *layout, lmg_accumulator **out, lmg_error *err)
{
    if (!out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "accumulator: nowhere to put it");
    *out = NULL;
    lmg_result r = lmg_layout_check(layout, err);
    if (r != LMG_OK)
        return r;
    lmg_accumulator *acc = calloc(1, sizeof *acc);
    if (!acc)
        return lmg_fail(err, LMG_ERROR_MEMORY, "accumulator: no memory");
    acc->layout = *layout;
    lmg_plan_prepare(&acc->plan, &acc->layout);
    uint64_t cells = acc->plan.first[layout->slab_count];
    if (!lmg_size_product((size_t)cells, lmg_cell_words(layout->channels) * sizeof(uint64_t), &acc->bytes) ||
        !(acc->words = lmg_table_alloc(acc->bytes))) {
        free(acc);
        return lmg_fail(err, LMG_ERROR_MEMORY, "accumulator: no memory for %.0f million cells; a layout of fewer cells would help",
                        (double)cells * 1e-6);
    }
    *out = acc;
    return LMG_OK;
}

void lmg_accumulator_destroy(lmg_accumulator *acc)
{
    if (!acc)
        return;
    lmg_table_free(acc->words, acc->bytes);
    free(acc);
}

/* Uniform in [0,1) from the photon's number: the dither of its rounding. */
static inline double dither(uint64_t number, uint64_t channel)
{
    uint64_t z = (number + 1) * 0x9e3779b97f4a7c15u + channel * 0xd1342543de82ef95u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)(z >> 11) * 0x1p-53;
}

/* floor(x + f) for |x| < 2^62, f in [0,1): x rounded up with probability of its fraction; whole numbers stay. */
static inline int64_t round_with(double x, double f)
{
    const int64_t toward_zero = (int64_t)x;
    const double rest = x - (double)toward_zero;
    const double fraction = rest < 0 ? rest + 1 : rest;
    return toward_zero - (rest < 0 ? 1 : 0) + (fraction > f ? 1 : 0);
}

static inline void add(_Atomic uint64_t *word, uint64_t value)
{
    atomic_fetch_add_explicit(word, value, memory_order_relaxed);
}

/* What a batch adds to the totals, kept apart from the shared words until its end. */
typedef struct tally {
    uint64_t rays, refused, unplaced, stored[3], residual[3], residual_squares;
} tally;

/* As lmg_luminance. */
#define LUMINANCE(red, green, blue) (0.2126 * (red) + 0.7152 * (green) + 0.0722 * (blue))

/* A batch of rays and what is to be added for each. */
typedef struct batch {
    lmg_ray_columns rays;
    double colour[3][LMG_COLUMN];
    uint64_t number[LMG_COLUMN], cell[LMG_COLUMN];
    int64_t good[LMG_COLUMN]; /* 0: refused */
    int64_t flux[3][LMG_COLUMN], square[LMG_COLUMN];
} batch;

static void fill_columns(const lmg_ray *rays, size_t count, batch *b)
{
    for (size_t i = 0; i < count; i++) {
        const lmg_ray *ray = &rays[i];
        b->rays.origin[0][i] = ray->origin.x;
        b->rays.origin[1][i] = ray->origin.y;
        b->rays.origin[2][i] = ray->origin.z;
        b->rays.direction[0][i] = ray->direction.x;
        b->rays.direction[1][i] = ray->direction.y;
        b->rays.direction[2][i] = ray->direction.z;
        for (int c = 0; c < 3; c++)
            b->colour[c][i] = (double)ray->flux[c];
        b->number[i] = ray->number;
    }
}

/* Which rays are good: their values in range, which no NaN is. */
LMG_WIDE static void check_columns(size_t count, batch *restrict b)
{
    for (size_t i = 0; i < count; i++) {
        const double red = b->colour[0][i], green = b->colour[1][i], blue = b->colour[2][i];
        const double x = b->rays.direction[0][i], y = b->rays.direction[1][i], z = b->rays.direction[2][i];
        const double luminance = LUMINANCE(red, green, blue), d2 = x * x + y * y + z * z;
        const bool flux = (luminance >= 0) & (luminance <= LMG_MAX_RAY_FLUX) & (fabs(red) <= LMG_MAX_RAY_FLUX) &
                          (fabs(green) <= LMG_MAX_RAY_FLUX) & (fabs(blue) <= LMG_MAX_RAY_FLUX);
        const bool line = (d2 > 0) & (d2 <= DBL_MAX) & (fabs(b->rays.origin[0][i]) <= DBL_MAX) &
                          (fabs(b->rays.origin[1][i]) <= DBL_MAX) & (fabs(b->rays.origin[2][i]) <= DBL_MAX);
        b->good[i] = flux & line ? 1 : 0;
    }
}

LMG_WIDE static void fix_luminance(size_t count, batch *restrict b)
{
    for (size_t i = 0; i < count; i++) {
        const double luminance = b->good[i] ? LUMINANCE(b->colour[0][i], b->colour[1][i], b->colour[2][i]) : 0;
        b->flux[0][i] = round_with(luminance * LMG_FLUX_ONE, dither(b->number[i], 0));
        b->square[i] = round_with(luminance * luminance * LMG_SQUARE_ONE, dither(b->number[i], 3));
    }
}

LMG_WIDE static void fix_colours(size_t count, batch *restrict b)
{
    for (size_t i = 0; i < count; i++) {
        const double luminance = b->good[i] ? LUMINANCE(b->colour[0][i], b->colour[1][i], b->colour[2][i]) : 0;
        b->square[i] = round_with(luminance * luminance * LMG_SQUARE_ONE, dither(b->number[i], 3));
    }
    for (uint64_t c = 0; c < 3; c++)
        for (size_t i = 0; i < count; i++)
            b->flux[c][i] = round_with((b->good[i] ? b->colour[c][i] : 0) * LMG_FLUX_ONE, dither(b->number[i], c));
}

/* Adds a batch whose cells are known. */
static void add_batch(lmg_accumulator *acc, const batch *b, size_t count, tally *sum)
{
    const uint32_t channels = acc->layout.channels, words = lmg_cell_words(channels);
    for (size_t i = 0; i < count; i++) {
        if (!b->good[i]) {
            sum->refused++;
            continue;
        }
        if (b->cell[i] == LMG_NO_CELL) {
            sum->unplaced++;
            for (uint32_t c = 0; c < channels; c++)
                sum->residual[c] += (uint64_t)b->flux[c][i];
            sum->residual_squares += (uint64_t)b->square[i];
            continue;
        }
        sum->rays++;
        _Atomic uint64_t *cell = acc->words + b->cell[i] * words, *half = cell + (b->number[i] & 1) * channels;
        for (uint32_t c = 0; c < channels; c++) {
            add(&half[c], (uint64_t)b->flux[c][i]);
            sum->stored[c] += (uint64_t)b->flux[c][i];
        }
        add(&cell[2 * channels], (uint64_t)b->square[i]); /* behind both halves */
    }
}

void lmg_accumulator_deposit(lmg_accumulator *acc, const lmg_ray *rays, size_t count)
{
    const uint32_t channels = acc->layout.channels, words = lmg_cell_words(channels);
    batch b;
    tally sum = {0};
    for (size_t start = 0, n; start < count; start += n) {
        n = count - start < LMG_COLUMN ? count - start : LMG_COLUMN;
        fill_columns(rays + start, n, &b);
        lmg_plan_place(&acc->plan, n, &b.rays, b.cell);
        for (size_t i = 0; i < n; i++)
            if (b.cell[i] != LMG_NO_CELL)
                PREFETCH_WRITE(acc->words + b.cell[i] * words);
        check_columns(n, &b);
        if (channels == 1)
            fix_luminance(n, &b);
        else
            fix_colours(n, &b);
        add_batch(acc, &b, n, &sum);
    }
    add(&acc->rays, sum.rays);
    add(&acc->refused, sum.refused);
    add(&acc->unplaced, sum.unplaced);
    for (int c = 0; c < 3; c++) {
        add(&acc->stored[c], sum.stored[c]);
        add(&acc->residual[c], sum.residual[c]);
    }
    add(&acc->residual_squares, sum.residual_squares);
}

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    lmg_accumulator_deposit(self, rays, count);
}

lmg_sink lmg_accumulator_sink(lmg_accumulator *acc)
{
    return (lmg_sink){acc, consume};
}

static bool same_slab(const lmg_slab *x, const lmg_slab *y)
{
    return lmg_same_frame(x, y) && x->u0 == y->u0 && x->u1 == y->u1 && x->v0 == y->v0 && x->v1 == y->v1 && x->s0 == y->s0 &&
           x->s1 == y->s1 && x->t0 == y->t0 && x->t1 == y->t1 && x->nu == y->nu && x->nv == y->nv && x->ns == y->ns && x->nt == y->nt;
}

lmg_result lmg_accumulator_merge(lmg_accumulator *acc, const lmg_accumulator *other, lmg_error *err)
{
    const lmg_layout *x = &acc->layout, *y = &other->layout;
    bool same = x->slab_count == y->slab_count && x->channels == y->channels &&
                (x->channels == 3 || memcmp(x->colour, y->colour, sizeof x->colour) == 0);
    for (uint32_t j = 0; same && j < x->slab_count; j++)
        same = same_slab(&x->slabs[j], &y->slabs[j]);
    if (!same)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "accumulator: merging needs the same layout in both; bake the parts with one layout");
    size_t count = acc->bytes / sizeof(uint64_t);
    for (size_t i = 0; i < count; i++) {
        uint64_t value = atomic_load_explicit(&other->words[i], memory_order_relaxed);
        if (value) /* untouched pages stay untouched */
            add(&acc->words[i], value);
    }
    add(&acc->rays, other->rays);
    add(&acc->refused, other->refused);
    add(&acc->unplaced, other->unplaced);
    for (int c = 0; c < 3; c++) {
        add(&acc->stored[c], other->stored[c]);
        add(&acc->residual[c], other->residual[c]);
    }
    add(&acc->residual_squares, other->residual_squares);
    return LMG_OK;
}

/* Luminance of a total, in units. */
static double luminance_of(const _Atomic uint64_t total[3], uint32_t channels)
{
    double c[3];
    for (int i = 0; i < 3; i++)
        c[i] = (double)(int64_t)atomic_load_explicit(&total[i], memory_order_relaxed) / LMG_FLUX_ONE;
    return channels == 1 ? c[0] : 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
}

lmg_deposit_totals lmg_accumulator_totals(const lmg_accumulator *acc)
{
    return (lmg_deposit_totals){
        .rays = acc->rays,
        .refused = acc->refused,
        .unplaced = acc->unplaced,
        .stored = luminance_of(acc->stored, acc->layout.channels),
        .residual = luminance_of(acc->residual, acc->layout.channels),
    };
}
