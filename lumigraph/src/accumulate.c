/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Where rays are counted.  Every sum is an integer, so the order of deposits doesn't matter and any number of threads gives the same
 * bits.  Rounding to the fixed point is stochastic, keyed by the photon's number and channel: the same photon always gives the same
 * integers, yet the mean has no bias however small the weights are (rounding to nearest would turn a million photons of weight 1.5e-6
 * into twice or half their flux).
 * A batch goes in two passes: find each ray's cell and prefetch it, then add; a random cell in a large table costs a memory access,
 * and the accesses of a batch overlap.
 */
#include "accumulate.h"
#include "field.h"
#include "memory.h"

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
static inline uint64_t round_with(double x, double f)
{
    int64_t whole = (int64_t)x;
    double rest = x - (double)whole;
    if (rest < 0) {
        rest += 1;
        whole -= 1;
    }
    return (uint64_t)(whole + (rest > f));
}

static inline void add(_Atomic uint64_t *word, uint64_t value)
{
    atomic_fetch_add_explicit(word, value, memory_order_relaxed);
}

/* What a batch adds to the totals, kept apart from the shared words until its end. */
typedef struct tally {
    uint64_t rays, refused, unplaced, stored[3], residual[3], residual_squares;
} tally;

enum { BATCH = 64 };

typedef struct entry {
    _Atomic uint64_t *cell; /* NULL: unplaced */
    uint64_t flux[3], square;
} entry;

/* Fixed-point flux of a ray; false when it's refused. */
static inline bool convert(const lmg_ray *ray, uint32_t channels, entry *out)
{
    double y = lmg_luminance(ray->flux);
    double largest = fmax(fmax(fabs((double)ray->flux[0]), fabs((double)ray->flux[1])), fabs((double)ray->flux[2]));
    /* one comparison also catches NaN and infinity: sums of them aren't <= a number; fmax alone would drop a NaN, y doesn't */
    if (!(y >= 0 && y <= LMG_MAX_RAY_FLUX && largest <= LMG_MAX_RAY_FLUX))
        return false;
    double d2 = v_dot(ray->direction, ray->direction);
    if (!(d2 > 0 && d2 < HUGE_VAL) || !v_finite(ray->origin))
        return false;
    if (channels == 1) {
        out->flux[0] = round_with(y * LMG_FLUX_ONE, dither(ray->number, 0));
        out->flux[1] = out->flux[2] = 0;
    } else {
        for (uint64_t c = 0; c < 3; c++)
            out->flux[c] = round_with((double)ray->flux[c] * LMG_FLUX_ONE, dither(ray->number, c));
    }
    out->square = round_with(y * y * LMG_SQUARE_ONE, dither(ray->number, 3));
    return true;
}

void lmg_accumulator_deposit(lmg_accumulator *acc, const lmg_ray *rays, size_t count)
{
    const uint32_t channels = acc->layout.channels, words = lmg_cell_words(channels);
    entry entries[BATCH];
    tally sum = {0};
    for (size_t start = 0; start < count; start += BATCH) {
        size_t n = count - start < BATCH ? count - start : BATCH, used = 0;
        for (size_t i = 0; i < n; i++) {
            const lmg_ray *ray = &rays[start + i];
            entry *e = &entries[used];
            if (!convert(ray, channels, e)) {
                sum.refused++;
                continue;
            }
            double uvst[4];
            int j = lmg_plan_owner(&acc->plan, ray->origin, ray->direction, uvst);
            if (j < 0) {
                sum.unplaced++;
                for (int c = 0; c < 3; c++)
                    sum.residual[c] += e->flux[c];
                sum.residual_squares += e->square;
                continue;
            }
            uint64_t cell = acc->plan.first[j] + lmg_plan_cell(&acc->plan, j, uvst);
            _Atomic uint64_t *base = acc->words + cell * words;
            PREFETCH_WRITE(base);
            e->cell = base + (ray->number & 1 ? channels : 0);
            /* the squares' word lies behind both halves: A + 2 channels */
            used++;
            sum.rays++;
            for (int c = 0; c < 3; c++)
                sum.stored[c] += e->flux[c];
            if (ray->number & 1)
                e->square |= (uint64_t)1 << 63; /* squares use 61 bits at most; the top one remembers the half */
        }
        for (size_t i = 0; i < used; i++) {
            entry *e = &entries[i];
            bool odd = e->square >> 63;
            add(e->cell, e->flux[0]);
            if (channels == 3) {
                add(e->cell + 1, e->flux[1]);
                add(e->cell + 2, e->flux[2]);
            }
            add(e->cell + (odd ? channels : 2 * channels), e->square & ~((uint64_t)1 << 63));
        }
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
