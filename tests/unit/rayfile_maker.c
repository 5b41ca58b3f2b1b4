/* SPDX-License-Identifier: Apache-2.0 */
/* TM-25 files for tests. */
#include "rayfile_maker.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct bytes {
    uint8_t *data;
    size_t size;
} bytes;

static void put(bytes *b, const void *data, size_t size)
{
    b->data = realloc(b->data, b->size + size);
    if (data)
        memcpy(b->data + b->size, data, size);
    else
        memset(b->data + b->size, 0, size);
    b->size += size;
}

static void put_i32(bytes *b, int32_t v)
{
    const uint8_t le[4] = {(uint8_t)v, (uint8_t)((uint32_t)v >> 8), (uint8_t)((uint32_t)v >> 16), (uint8_t)((uint32_t)v >> 24)};
    put(b, le, 4);
}

static void put_f32(bytes *b, float v)
{
    int32_t bits;
    memcpy(&bits, &v, 4);
    put_i32(b, bits);
}

void tm25_direction(uint32_t i, float k[3])
{
    const double theta = 0.1 + 0.3 * (i % 5), phi = 0.7 * i;
    k[0] = (float)(sin(theta) * cos(phi));
    k[1] = (float)(sin(theta) * sin(phi));
    k[2] = (float)cos(theta);
}

uint8_t *tm25_make(const tm25_recipe *r, size_t *size)
{
    static const uint8_t SWAPPED[4] = {0x7f, 0x80, 0x00, 0x01};
    bytes b = {0};
    put(&b, "TM25", 4);
    put_i32(&b, 2013);
    put_i32(&b, 1);
    for (int i = 0; i < 2; ++i)
        if (r->big_endian_nan)
            put(&b, SWAPPED, 4);
        else
            put_f32(&b, i == 0 ? r->luminous : r->radiant);
    put_i32(&b, (int32_t)r->rays);
    put_i32(&b, 0);
    put(&b, "2024-05-06 07:08:09\0\0\0\0\0\0\0\0\0", 28);
    put_i32(&b, 3);
    put_i32(&b, r->spectral);
    put_f32(&b, r->spectral == 1 ? 550.0f : NAN);
    put_f32(&b, 400);
    put_f32(&b, 700);
    put_i32(&b, r->tables);
    put_i32(&b, r->extra);
    put_i32(&b, r->text_bytes);
    put(&b, NULL, 168);
    for (int i = 0; i < 8; ++i)
        put_i32(&b, r->flags[i]);
    for (int t = 0; t < 9; ++t) {
        put_i32(&b, 'A' + t);
        put_i32(&b, 0x4e2d); /* a character outside ASCII */
        put(&b, NULL, 998 * 4);
    }
    for (int t = 0; t < r->tables; ++t) {
        put_i32(&b, r->table_points);
        for (int i = 0; i < r->table_points; ++i) {
            put_f32(&b, 500 + 20.0f * (float)t + (float)i);
            put_f32(&b, 1 + (float)i);
        }
    }
    if (!r->unpadded)
        while (b.size % 32)
            put(&b, NULL, 4);
    if (!r->no_labels)
        put(&b, NULL, 512 * (size_t)r->extra);
    put(&b, NULL, (size_t)r->text_bytes);
    for (uint32_t i = 0; i < r->rays; ++i) {
        float k[3];
        tm25_direction(i, k);
        put_f32(&b, (float)i);
        put_f32(&b, -0.5f * (float)i);
        put_f32(&b, 0.25f);
        for (int c = 0; c < 3; ++c)
            put_f32(&b, k[c]);
        const float y = 1 + 0.001f * (float)i;
        if (r->flags[2])
            put_f32(&b, 0.002f);
        if (r->flags[3])
            put_f32(&b, 500 + (float)i);
        if (r->flags[4])
            put_f32(&b, y);
        for (int c = 0; r->flags[5] && c < 6; ++c)
            put_f32(&b, 7);
        if (r->flags[6]) {
            put_f32(&b, 0.5f * y);
            put_f32(&b, 0.25f * y);
        }
        if (r->flags[7])
            put_f32(&b, (float)(1 + i % (uint32_t)(r->tables ? r->tables : 1)));
        for (int c = 0; c < r->extra; ++c)
            put_f32(&b, 7);
    }
    *size = b.size;
    return b.data;
}
