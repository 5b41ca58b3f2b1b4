/* SPDX-License-Identifier: Apache-2.0 */
/*
 * An accumulator as bytes and back: checkpoints, parts of a bake from several machines.  The integers themselves are kept, so what
 * is saved and loaded goes on as if nothing had happened.
 *
 * Bytes: 8-byte little-endian words for magic, layout and totals, then the table's words in order as a stream of tokens.  A token is a
 * number in base 128, low digits first, bit 7 = more follow.  0 is followed by a second number r and stands for r + 1 zero words; any
 * other is one word w, as 2 w for w >= 0 and -2 w - 1 below.  Photons of weight 1 make small multiples of 2^20, most cells are empty:
 * a table shrinks to a tenth or less.
 */
#include "accumulate.h"
#include "field.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t MAGIC = 0x313063636167626cu; /* "lbgacc01" */
/* Zero words in one token, at most: what a few bytes can ask for stays bounded. */
static const uint64_t MAX_RUN = UINT64_C(1) << 20;

/* The layout is saved member by member.  A new member has to be added to slab_words or layout_words, and the magic's number raised. */
_Static_assert(sizeof(lmg_slab) == 192, "slab_words must list every member of lmg_slab");
_Static_assert(sizeof(lmg_layout) == 32 * 192 + 80, "layout_words must list every member of lmg_layout");

/* ------------------------------------------------------------------------------------------------------------ writing */

enum { BUFFER = 1 << 16, LONGEST = 10 /* bytes of a token's number */ };

typedef struct writer {
    lmg_write_bytes write;
    void *self;
    bool failed;
    size_t used;
    unsigned char buffer[BUFFER];
} writer;

static void flush(writer *w)
{
    if (w->used > 0 && !w->failed)
        w->failed = !w->write(w->self, w->buffer, w->used);
    w->used = 0;
}

static inline void put_number(writer *w, uint64_t x)
{
    if (w->used > BUFFER - LONGEST)
        flush(w);
    for (; x >= 128; x >>= 7)
        w->buffer[w->used++] = (unsigned char)(x | 128);
    w->buffer[w->used++] = (unsigned char)x;
}

static void put_word(void *self, void *value)
{
    writer *w = self;
    uint64_t x;
    memcpy(&x, value, sizeof x);
    if (w->used > BUFFER - 8)
        flush(w);
    for (int i = 0; i < 8; i++)
        w->buffer[w->used++] = (unsigned char)(x >> (8 * i));
}

/* ------------------------------------------------------------------------------------------------------------ reading */

typedef struct reader {
    const unsigned char *at, *end;
    bool failed;
} reader;

static inline uint64_t get_number(reader *r)
{
    uint64_t x = 0;
    for (unsigned shift = 0; shift < 64 && r->at < r->end; shift += 7) {
        const unsigned char byte = *r->at++;
        if (shift == 63 && byte > 1)
            break; /* beyond 64 bits */
        x |= (uint64_t)(byte & 127) << shift;
        if (byte < 128)
            return x;
    }
    r->failed = true;
    return 0;
}

static void get_word(void *self, void *value)
{
    reader *r = self;
    uint64_t x = 0;
    if (r->end - r->at < 8) {
        r->failed = true;
        r->at = r->end;
    } else {
        for (int i = 0; i < 8; i++)
            x |= (uint64_t)r->at[i] << (8 * i);
        r->at += 8;
    }
    memcpy(value, &x, sizeof x);
}

/* ------------------------------------------------------------------------------------------------------------- layout */

typedef void each_word(void *self, void *eight_bytes);

/* Calls f for a member that is no 8-byte word itself, through one that is. */
static void narrow(each_word *f, void *self, uint32_t *member)
{
    uint64_t x = *member;
    f(self, &x);
    *member = x <= UINT32_MAX ? (uint32_t)x : UINT32_MAX; /* too large for any range: the layout check refuses it */
}

static void vector(each_word *f, void *self, lmg_vec3 *v)
{
    f(self, &v->x);
    f(self, &v->y);
    f(self, &v->z);
}

static void slab_words(each_word *f, void *self, lmg_slab *s)
{
    uint32_t kind = (uint32_t)s->kind;
    narrow(f, self, &kind);
    s->kind = (lmg_slab_kind)kind;
    vector(f, self, &s->o);
    vector(f, self, &s->a);
    vector(f, self, &s->b);
    vector(f, self, &s->n);
    double *const numbers[] = {&s->distance, &s->u0, &s->u1, &s->v0, &s->v1, &s->s0, &s->s1, &s->t0, &s->t1};
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++)
        f(self, numbers[i]);
    uint32_t *const cells[] = {&s->nu, &s->nv, &s->ns, &s->nt};
    for (size_t i = 0; i < 4; i++)
        narrow(f, self, cells[i]);
}

/* All that a layout consists of, in the order of the bytes: for writing and for reading. */
static void layout_words(each_word *f, void *self, lmg_layout *y)
{
    narrow(f, self, &y->slab_count);
    narrow(f, self, &y->channels);
    for (int c = 0; c < 3; c++) {
        double x = (double)y->colour[c];
        f(self, &x);
        y->colour[c] = (float)x;
    }
    vector(f, self, &y->bounds_min);
    vector(f, self, &y->bounds_max);
    f(self, &y->size);
    for (uint32_t j = 0; j < y->slab_count && j < LMG_MAX_SLABS; j++)
        slab_words(f, self, &y->slabs[j]);
}

/* ---------------------------------------------------------------------------------------------------------------- API */

/* The totals that are saved; what is stored in cells is summed up again. */
static const size_t TOTALS[] = {
    offsetof(lmg_accumulator, rays),        offsetof(lmg_accumulator, refused),     offsetof(lmg_accumulator, unplaced),
    offsetof(lmg_accumulator, residual[0]), offsetof(lmg_accumulator, residual[1]), offsetof(lmg_accumulator, residual[2]),
    offsetof(lmg_accumulator, residual_squares)};
enum { TOTAL_COUNT = sizeof TOTALS / sizeof TOTALS[0] };

lmg_result lmg_accumulator_save(const lmg_accumulator *acc, lmg_write_bytes write, void *self, lmg_error *err)
{
    if (!acc || !write)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "accumulator: nothing to save, or nowhere to save it");
    writer *w = malloc(sizeof *w);
    if (!w)
        return lmg_fail(err, LMG_ERROR_MEMORY, "accumulator: no memory to save it");
    w->write = write;
    w->self = self;
    w->failed = false;
    w->used = 0;
    uint64_t word = MAGIC;
    put_word(w, &word);
    lmg_layout layout = acc->layout;
    layout_words(put_word, w, &layout);
    for (int i = 0; i < TOTAL_COUNT; i++) {
        const void *total = (const char *)acc + TOTALS[i];
        word = atomic_load_explicit((const _Atomic uint64_t *)total, memory_order_relaxed);
        put_word(w, &word);
    }
    const size_t count = acc->bytes / sizeof(uint64_t);
    uint64_t zeros = 0;
    for (size_t i = 0; i <= count && !w->failed; i++) {
        const uint64_t value = i < count ? atomic_load_explicit(&acc->words[i], memory_order_relaxed) : 1;
        if (value == 0 && ++zeros < MAX_RUN)
            continue;
        if (zeros > 0) {
            put_number(w, 0);
            put_number(w, zeros - 1);
            zeros = 0;
        }
        if (value != 0 && i < count)
            put_number(w, value >> 63 ? ~value << 1 | 1 : value << 1);
    }
    flush(w);
    const bool failed = w->failed;
    free(w);
    return failed ? lmg_fail(err, LMG_ERROR_FILE_WRITE, "accumulator: writing its bytes failed") : LMG_OK;
}

/* Fills the table from its tokens and sums what is stored.  Whether the stream is whole and says possible things. */
static bool fill(lmg_accumulator *acc, reader *r)
{
    const size_t count = acc->bytes / sizeof(uint64_t);
    const uint32_t channels = acc->layout.channels, words = lmg_cell_words(channels);
    uint64_t stored[3] = {0};
    for (size_t i = 0; i < count;) {
        const uint64_t token = get_number(r);
        if (r->failed)
            return false;
        if (token == 0) {
            const uint64_t run = get_number(r);
            if (r->failed || run >= MAX_RUN || run >= count - i)
                return false;
            i += (size_t)run + 1;
            continue;
        }
        const uint32_t place = (uint32_t)(i % words);
        const bool negative = token & 1;
        if (place > 2 * channels || (negative && (channels == 1 || place == 2 * channels)))
            return false; /* words beyond the squares are unused; luminance and squares are never negative */
        const uint64_t value = negative ? ~(token >> 1) : token >> 1;
        atomic_store_explicit(&acc->words[i], value, memory_order_relaxed);
        if (place < 2 * channels)
            stored[place % channels] += value;
        i++;
    }
    for (int c = 0; c < 3; c++)
        atomic_store_explicit(&acc->stored[c], stored[c], memory_order_relaxed);
    return r->at == r->end;
}

lmg_result lmg_accumulator_load(const void *bytes, size_t size, lmg_accumulator **out, lmg_error *err)
{
    if (!out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "accumulator: nowhere to put it");
    *out = NULL;
    reader r = {.at = bytes, .end = (const unsigned char *)bytes + size};
    uint64_t word = 0;
    get_word(&r, &word);
    if (r.failed || word != MAGIC)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "accumulator: these bytes aren't a saved accumulator of this version");
    lmg_layout layout = {0};
    layout_words(get_word, &r, &layout);
    uint64_t values[TOTAL_COUNT];
    for (int i = 0; i < TOTAL_COUNT; i++)
        get_word(&r, &values[i]);
    if (r.failed)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "accumulator: the saved bytes end too early");
    lmg_accumulator *acc;
    const lmg_result result = lmg_accumulator_create(&layout, &acc, err);
    if (result != LMG_OK)
        return result == LMG_ERROR_ARGUMENT ? LMG_ERROR_FILE_FORMAT : result;
    for (int i = 0; i < TOTAL_COUNT; i++) {
        void *total = (char *)acc + TOTALS[i];
        atomic_store_explicit((_Atomic uint64_t *)total, values[i], memory_order_relaxed);
    }
    if (!fill(acc, &r)) {
        lmg_accumulator_destroy(acc);
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "accumulator: the saved counts are incomplete or contradict the layout");
    }
    *out = acc;
    return LMG_OK;
}

const lmg_layout *lmg_accumulator_layout(const lmg_accumulator *acc)
{
    return &acc->layout;
}
