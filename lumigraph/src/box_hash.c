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

uint64_t lmg_hash_tile(const lmg_tiles *t, uint32_t slab, uint64_t tile_in_slab)
{
    const lmg_slab_data *data = &t->field->slabs[slab];
    const uint64_t cells = lmg_tile_cells(&t->layout->slabs[slab]), first = tile_in_slab * cells, channels = t->layout->channels;
    uint64_t h = lmg_hash(hash_start, data->radiance + first * channels, (size_t)(cells * channels) * sizeof(float));
    h = lmg_hash(h, data->standard_error + first, (size_t)cells * sizeof(float));
    return lmg_hash(h, data->half_a + first, (size_t)cells * sizeof(float));
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
