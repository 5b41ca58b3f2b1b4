/* SPDX-License-Identifier: Apache-2.0 */
/* Integrals as sums over cells.  Relies on slopes.h for how radiance varies within a cell, and so for whose noise comes in. */
#include "cell_sum.h"

#include <stdlib.h>

void lmg_cell_sum_free(lmg_cell_sum *sum)
{
    free(sum->table);
    free(sum->used);
}

static lmg_cell_share *find(lmg_cell_share *table, size_t room, uint64_t key)
{
    size_t at = (size_t)(key * 0x9e3779b97f4a7c15u >> 20) & (room - 1);
    while (table[at].key && table[at].key != key)
        at = (at + 1) & (room - 1);
    return &table[at];
}

static bool resize(lmg_cell_sum *sum, size_t room)
{
    lmg_cell_share *table = calloc(room, sizeof *table);
    uint32_t *used = malloc(room * sizeof *used);
    if (!table || !used) {
        free(table);
        free(used);
        return false;
    }
    for (size_t i = 0; i < sum->count; i++) {
        const lmg_cell_share *from = &sum->table[sum->used[i]];
        lmg_cell_share *to = find(table, room, from->key);
        *to = *from;
        used[i] = (uint32_t)(to - table);
    }
    lmg_cell_sum_free(sum);
    sum->table = table;
    sum->used = used;
    sum->room = room;
    return true;
}

bool lmg_cell_sum_add(lmg_cell_sum *sum, const lmg_field *field, uint32_t j, const lmg_place *place, double weight)
{
    const float *r = lmg_cell_radiance(&field->slabs[j], place->cell);
    if (r[0] == 0 && (field->layout.channels == 1 || (r[1] == 0 && r[2] == 0)))
        return true;
    if (2 * (sum->count + 1) > sum->room && !resize(sum, sum->room ? 2 * sum->room : 256))
        return false;
    lmg_cell_share *s = find(sum->table, sum->room, place->cell + 1);
    if (!s->key) {
        s->key = place->cell + 1;
        sum->used[sum->count++] = (uint32_t)(s - sum->table);
    }
    s->weight += weight;
    s->shaped += weight * (double)lmg_shape(&field->sampler->slopes[j], lmg_cell_slopes(&field->slabs[j], place->cell), place);
    for (int k = 0; k < 4; k++)
        s->moment[k] += weight * (double)place->x[k];
    return true;
}

/*
 * Variance of one cell's part: its own, and that of the cells that its slopes are differences of, as if no two slopes shared a cell.
 * Slopes at their limit are in a fixed proportion to the cell itself.
 */
static double variance_of(const lmg_field *field, uint32_t j, const lmg_cell_share *s)
{
    const lmg_slab *slab = &field->layout.slabs[j];
    const float *se = field->slabs[j].standard_error;
    const uint64_t cell = s->key - 1, st = (uint64_t)slab->ns * slab->nt;
    const int8_t *g = lmg_cell_slopes(&field->slabs[j], cell);
    const uint32_t n[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
    const uint32_t i[4] = {(uint32_t)(cell / st % slab->nu), (uint32_t)(cell / st / slab->nu), (uint32_t)(cell % slab->ns), (uint32_t)(cell / slab->ns % slab->nt)};
    const int64_t step[4] = {(int64_t)st, (int64_t)st * slab->nu, 1, slab->ns};
    enum { AT_LIMIT = 122 }; /* 127ths: slopes.c's limit less two roundings and the centroid's part */
    bool limited[2] = {abs(g[0]) + abs(g[1]) >= AT_LIMIT, abs(g[2]) + abs(g[3]) >= AT_LIMIT};
    double own = limited[0] || limited[1] ? s->shaped : s->weight, variance = 0;
    for (int k = 0; k < 4; k++) {
        if (limited[0] || limited[1] || (g[k / 2 * 2] == 0 && g[k / 2 * 2 + 1] == 0))
            continue;
        lmg_stencil t = lmg_stencil_of(i[k] >= 2, i[k] >= 1, i[k] + 1 < n[k], i[k] + 2 < n[k]);
        if (t.lo == t.hi)
            continue;
        double weight = s->moment[k] / (2 * (t.hi - t.lo));
        own += t.lo == 0 ? -weight : t.hi == 0 ? weight : 0;
        for (int side = 0; side < 2; side++) {
            int by = side ? t.hi : t.lo;
            double e = by ? weight * (double)se[(int64_t)cell + by * step[k]] : 0;
            variance += e * e;
        }
    }
    double e = own * (double)se[cell];
    return variance + e * e;
}

void lmg_cell_sum_flush(lmg_cell_sum *sum, const lmg_field *field, uint32_t j, double rgb[3], double *variance)
{
    for (size_t i = 0; i < sum->count; i++) {
        lmg_cell_share *s = &sum->table[sum->used[i]];
        float c[3];
        lmg_cell_mean(field, j, s->key - 1, c);
        for (int k = 0; k < 3; k++)
            rgb[k] += s->shaped * (double)c[k];
        if (sum->errors)
            *variance += variance_of(field, j, s);
        *s = (lmg_cell_share){0};
    }
    sum->count = 0;
}
