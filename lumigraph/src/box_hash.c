/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The content hash of box files: of what a file means, not of its bytes, so that packing it otherwise leaves the hash alone. Relies
 * on lmg_hash.
 */
#include "box_hash.h"

#include <string.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "box_hash.c hashes floats as they lie in memory, the format wants them little-endian; a big-endian machine needs a swap"
#endif

static const uint64_t hash_start = 0xcbf29ce484222325u;

static uint64_t hash_u32(uint64_t hash, uint32_t value)
{
    unsigned char bytes[4];
    for (int i = 0; i < 4; i++) {
        bytes[i] = (unsigned char)(value >> (8 * i));
    }
    return lmg_hash(hash, bytes, sizeof bytes);
}

static uint64_t hash_u64(uint64_t hash, uint64_t value)
{
    return hash_u32(hash_u32(hash, (uint32_t)value), (uint32_t)(value >> 32));
}

static uint64_t hash_f32(uint64_t hash, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return hash_u32(hash, bits);
}

static uint64_t hash_f64(uint64_t hash, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return hash_u64(hash, bits);
}

static uint64_t hash_vec3(uint64_t hash, lmg_vec3 v)
{
    return hash_f64(hash_f64(hash_f64(hash, v.x), v.y), v.z);
}

static uint64_t hash_metadata(const lmg_tiles *t)
{
    const lmg_field *field = t->field;
    const lmg_layout *l = &field->layout;
    uint64_t h = lmg_hash(hash_start, "LUMIBOX", 7);
    h = hash_u32(h, t->units ? LMG_BOX_ROUNDED : LMG_BOX_EXACT);
    h = hash_u32(h, l->slab_count);
    h = hash_u32(h, l->channels);
    for (int i = 0; i < 3; i++) {
        h = hash_f32(h, l->colour[i]);
    }
    h = hash_vec3(h, l->bounds_min);
    h = hash_vec3(h, l->bounds_max);
    h = hash_f64(h, l->size);
    h = hash_u64(h, field->ledger.photons);
    double ledger[LMG_LEDGER_ENTRIES][2];
    lmg_ledger_get(&field->ledger, ledger);
    for (int i = 0; i < LMG_LEDGER_ENTRIES; i++) {
        h = hash_f64(hash_f64(h, ledger[i][0]), ledger[i][1]);
    }
    if (t->units) {
        h = hash_f64(hash_f64(h, t->rounding.loss), t->rounding.half_loss);
    }
    for (uint32_t i = 0; i < l->slab_count; i++) {
        const lmg_slab *s = &l->slabs[i];
        h = hash_u32(h, (uint32_t)s->kind);
        h = hash_vec3(hash_vec3(hash_vec3(hash_vec3(h, s->o), s->a), s->b), s->n);
        h = hash_f64(h, s->distance);
        h = hash_f64(hash_f64(h, s->u0), s->u1);
        h = hash_f64(hash_f64(h, s->v0), s->v1);
        h = hash_f64(hash_f64(h, s->s0), s->s1);
        h = hash_f64(hash_f64(h, s->t0), s->t1);
        h = hash_u32(hash_u32(hash_u32(hash_u32(h, s->nu), s->nv), s->ns), s->nt);
        h = t->units ? hash_f64(h, t->units[i]) : h;
    }
    h = hash_u32(h, (uint32_t)field->text_count);
    for (size_t i = 0; i < field->text_count;
         i++) { /* with their terminating zeros, so that no two lists run into the same bytes */
        h = lmg_hash(h, field->texts[i].name, strlen(field->texts[i].name) + 1);
        h = lmg_hash(h, field->texts[i].value, strlen(field->texts[i].value) + 1);
    }
    return h;
}

/*
 * Every byte's step waits for the one before, so one tile's hash leaves the processor idle most of the time: several tiles are
 * hashed side by side. Inlined with a constant number of lanes.
 */
enum { LANES = 4 };
#if defined(__GNUC__)
__attribute__((always_inline))
#endif
static inline void
hash_words(uint64_t hash[LANES], const float *const from[LANES], int lanes, uint64_t count, uint64_t stride, uint32_t words)
{
    for (uint64_t i = 0; i < count; i++)
        for (uint32_t w = 0; w < words; w++) {
            uint32_t bits[LANES];
            for (int k = 0; k < lanes; k++)
                memcpy(&bits[k], from[k] + i * stride + w, sizeof bits[k]);
            for (int byte = 0; byte < 32; byte += 8)
                for (int k = 0; k < lanes; k++)
                    hash[k] = (hash[k] ^ (bits[k] >> byte & 0xff)) * 0x100000001b3u;
        }
}

#if defined(__GNUC__)
__attribute__((always_inline))
#endif
static inline void
hash_lanes(const lmg_tiles *t, uint32_t slab, uint64_t tile_in_slab, int lanes, uint64_t *out)
{
    const lmg_slab_data *data = &t->field->slabs[slab];
    const uint64_t cells = lmg_tile_cells(&t->layout->slabs[slab]);
    const float *radiance[LANES], *standard_error[LANES], *half_a[LANES];
    uint64_t hash[LANES];
    for (int k = 0; k < lanes; k++) {
        const uint64_t first = (tile_in_slab + (uint64_t)k) * cells;
        radiance[k] = lmg_cell_radiance(data, first);
        standard_error[k] = data->standard_error + first;
        half_a[k] = data->half_a + first;
        hash[k] = hash_start;
    }
    hash_words(hash, radiance, lanes, cells, data->stride, data->stride - 1);
    hash_words(hash, standard_error, lanes, cells, 1, 1);
    hash_words(hash, half_a, lanes, cells, 1, 1);
    for (int k = 0; k < lanes; k++)
        out[k] = hash[k];
}

void lmg_hash_tiles(const lmg_tiles *t, uint64_t first, uint64_t after)
{
    while (first < after) {
        const uint32_t slab = lmg_tile_slab(t, first);
        const uint64_t in_slab = first - t->start[slab], end = after < t->start[slab + 1] ? after : t->start[slab + 1],
                       left = end - first;
        const int lanes = left >= LANES ? LANES : left >= 2 ? 2 : 1;
        if (lanes == LANES)
            hash_lanes(t, slab, in_slab, LANES, t->hashes + first);
        else if (lanes == 2)
            hash_lanes(t, slab, in_slab, 2, t->hashes + first);
        else
            hash_lanes(t, slab, in_slab, 1, t->hashes + first);
        first += (uint64_t)lanes;
    }
}

uint64_t lmg_hash_codes(const void *codes, uint64_t count)
{
    return lmg_hash(hash_start, codes, (size_t)count * sizeof(uint16_t));
}

uint64_t lmg_hash_field(const lmg_tiles *t)
{
    uint64_t h = hash_metadata(t);
    for (uint64_t i = 0; i < t->start[t->layout->slab_count]; i++) {
        h = hash_u64(h, t->hashes[i]);
    }
    return h;
}
