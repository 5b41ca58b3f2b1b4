/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The tables that say how bright a group of slabs is seen from where (sampler.h), made from the field's cells.  seen.c reads them.
 */
#include "memory.h"
#include "sampler.h"

#include <stdlib.h>
#include <string.h>

/* Part of the brightest neighbour's luminance added to each bin: light may stand across the border of bins or blocks from where the
 * node's middle looks. */
static const float SPILL = 0.1F;

enum { FINE = 1 << (LMG_LEVELS - 1), BINS = LMG_BINS * LMG_BINS }; /* blocks of the finest level, each way; finest bins of a picture */

/* Overlap of cell i of n on [lo,hi] with blocks on [from,to]: first block, number, and each block's covered share. */
static int overlap(double lo, double hi, uint32_t n, uint32_t i, double from, double to, int *first, double share[FINE])
{
    double a = lo + (hi - lo) * i / n, b = lo + (hi - lo) * (i + 1) / n, step = (to - from) / FINE;
    int k0 = (int)d_clamp((a - from) / step, 0, FINE - 1), k1 = (int)d_clamp((b - from) / step, 0, FINE - 1);
    *first = k0;
    for (int k = k0; k <= k1; k++)
        share[k - k0] = d_max(d_min(b, from + (k + 1) * step) - d_max(a, from + k * step), 0) / step;
    return k1 - k0 + 1;
}

/* Which bins an (s,t) cell's light falls in, and what share of the bin it covers. */
typedef struct part {
    uint32_t bin;
    float share;
} part;

/* Parts of all (s,t) cells of a slab, cell i's from start[i] to start[i+1]; NULL without memory.  By points spread over each cell. */
static part *parts_of_cells(const lmg_slab *slab, const lmg_brightness *table, size_t *start)
{
    size_t count = 0, room = (size_t)slab->ns * slab->nt * 2 + BINS;
    part *parts = malloc(room * sizeof *parts);
    double ds = (slab->s1 - slab->s0) / slab->ns, dt = (slab->t1 - slab->t0) / slab->nt;
    double bin_x = (table->x1 - table->x0) / LMG_BINS, bin_y = (table->y1 - table->y0) / LMG_BINS;
    int ms = (int)d_clamp(ceil(4 * ds / bin_x), 3, 64), mt = (int)d_clamp(ceil(4 * dt / bin_y), 3, 64);
    for (uint32_t it = 0; parts && it < slab->nt; it++)
        for (uint32_t is = 0; is < slab->ns; is++) {
            float share[BINS] = {0};
            uint32_t touched[BINS];
            size_t n = 0;
            for (int k = 0; k < ms * mt; k++) {
                double s = slab->s0 + ds * (is + (k % ms + 0.5) / ms), t = slab->t0 + dt * (it + (k / ms + 0.5) / mt), z;
                double area = ds * dt / (ms * mt);
                if (slab->kind == LMG_SLAB_APERTURE) {
                    lmg_square_to_disc(s, t, &s, &t, &z);
                    area *= LMG_PI / 4;
                }
                double x = floor((s - table->x0) / bin_x), y = floor((t - table->y0) / bin_y);
                if (!(x >= 0 && x < LMG_BINS && y >= 0 && y < LMG_BINS))
                    continue;
                uint32_t bin = (uint32_t)y * LMG_BINS + (uint32_t)x;
                if (share[bin] == 0)
                    touched[n++] = bin;
                share[bin] += (float)(area / (bin_x * bin_y));
            }
            if (count + n > room) {
                room = 2 * room + BINS;
                part *more = realloc(parts, room * sizeof *parts);
                if (!more) {
                    free(parts);
                    return NULL;
                }
                parts = more;
            }
            start[(size_t)it * slab->ns + is] = count;
            for (size_t k = 0; k < n; k++)
                parts[count++] = (part){touched[k], share[touched[k]]};
        }
    start[(size_t)slab->ns * slab->nt] = count;
    return parts;
}

/* Adds the light of slab j to pictures of the finest blocks: mean luminance per block and bin. */
static bool gather(const lmg_field *field, uint32_t j, const lmg_group *g, const lmg_brightness *table, float (*fine)[LMG_PICTURE])
{
    const lmg_slab *slab = &field->layout.slabs[j];
    size_t st = (size_t)slab->ns * slab->nt;
    size_t *start = malloc((st + 1) * sizeof *start);
    part *parts = start ? parts_of_cells(slab, table, start) : NULL;
    for (uint32_t iv = 0; parts && iv < slab->nv; iv++)
        for (uint32_t iu = 0; iu < slab->nu; iu++) {
            uint64_t cell = ((uint64_t)iv * slab->nu + iu) * st;
            float picture[BINS] = {0};
            for (size_t i = 0; i < st; i++) {
                if (start[i] == start[i + 1])
                    continue;
                double l = lmg_cell_luminance(field, j, cell + i);
                if (l > 0)
                    for (size_t k = start[i]; k < start[i + 1]; k++)
                        picture[parts[k].bin] += parts[k].share * (float)l;
            }
            double share_u[FINE], share_v[FINE];
            int first_u, first_v, nu = overlap(slab->u0, slab->u1, slab->nu, iu, g->u0, g->u1, &first_u, share_u);
            int nv = overlap(slab->v0, slab->v1, slab->nv, iv, g->v0, g->v1, &first_v, share_v);
            for (int y = 0; y < nv; y++)
                for (int x = 0; x < nu; x++) {
                    float *p = fine[(first_v + y) * FINE + first_u + x], share = (float)(share_u[x] * share_v[y]);
                    for (int k = 0; k < BINS; k++)
                        p[k] += picture[k] * share;
                }
        }
    bool done = parts != NULL;
    free(parts);
    free(start);
    return done;
}

/* The upper half of a float: eight bits of precision steer well enough, and tables of half the size stay in the cache. */
static inline uint16_t pack(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (uint16_t)((bits + (bits < 0x7f7f0000 ? 0x8000 : 0)) >> 16); /* rounded, but not to infinity */
}

/* From the finest blocks' finest bins: spill into neighbours, mips, coarser levels, and all but the whole plane's own into the table. */
static void finish(lmg_brightness *table, float (*level_pictures)[LMG_PICTURE])
{
    for (int block = 0; block < FINE * FINE; block++) {
        float *p = level_pictures[block], old[BINS];
        memcpy(old, p, sizeof old);
        for (int t = 0; t < LMG_BINS; t++)
            for (int s = 0; s < LMG_BINS; s++) {
                float most = 0;
                for (int y = t > 0 ? t - 1 : 0; y <= t + 1 && y < LMG_BINS; y++)
                    for (int x = s > 0 ? s - 1 : 0; x <= s + 1 && x < LMG_BINS; x++)
                        most = old[y * LMG_BINS + x] > most ? old[y * LMG_BINS + x] : most;
                p[t * LMG_BINS + s] += SPILL * most;
            }
        for (int m = 1; m < LMG_LEVELS; m++) {
            int n = LMG_BINS >> m;
            const float *from = p + LMG_MIP_START[m - 1];
            float *to = p + LMG_MIP_START[m];
            for (int t = 0; t < n; t++)
                for (int s = 0; s < n; s++)
                    to[t * n + s] = 0.25F * (from[2 * t * 2 * n + 2 * s] + from[2 * t * 2 * n + 2 * s + 1] + from[(2 * t + 1) * 2 * n + 2 * s] +
                                             from[(2 * t + 1) * 2 * n + 2 * s + 1]);
        }
    }
    /* Each level goes to its parents' places and is averaged for the next, in place: parent i reads blocks that come after it. */
    for (int level = LMG_LEVELS - 2; level >= 0; level--) {
        int n = 1 << level;
        for (int y = 0; y < n; y++)
            for (int x = 0; x < n; x++) {
                float mean[LMG_PICTURE] = {0};
                uint16_t *to = table->children + (size_t)(LMG_LEVEL_START[level] + (uint32_t)(y * n + x)) * LMG_PICTURE * 4;
                for (int k = 0; k < 4; k++) {
                    const float *from = level_pictures[(2 * y + k / 2) * 2 * n + 2 * x + k % 2];
                    for (int i = 0; i < LMG_PICTURE; i++) {
                        to[4 * i + k] = pack(from[i]);
                        mean[i] += 0.25F * from[i];
                    }
                }
                memcpy(level_pictures[y * n + x], mean, sizeof mean);
            }
    }
}

/* Two bins more than there are: a reader between the middles of bins may look, with weight 0, past the last one, to the right and above. */
static const size_t TABLE_BYTES = ((size_t)LMG_PARENTS * LMG_PICTURE + 2) * 4 * sizeof(uint16_t);

size_t lmg_groups_memory(const lmg_sampler *sampler)
{
    size_t sum = 0;
    for (uint32_t g = 0; g < sampler->group_count; g++)
        sum += sampler->groups[g].table_count * (sizeof(lmg_brightness) + TABLE_BYTES);
    return sum;
}

void lmg_groups_destroy(lmg_sampler *sampler)
{
    for (uint32_t g = 0; g < sampler->group_count; g++) {
        for (uint32_t k = 0; k < sampler->groups[g].table_count; k++)
            lmg_table_free(sampler->groups[g].tables[k].children, TABLE_BYTES);
        free(sampler->groups[g].tables);
    }
    sampler->group_count = 0;
}

/* Rectangle of directions that holds a slab's (s,t): itself, or of aperture slabs the direction cosines on it, which go furthest on its
 * border. */
static void directions_of(const lmg_slab *slab, lmg_brightness *table)
{
    if (slab->kind != LMG_SLAB_APERTURE) {
        *table = (lmg_brightness){.x0 = slab->s0, .x1 = slab->s1, .y0 = slab->t0, .y1 = slab->t1};
        return;
    }
    *table = (lmg_brightness){.x0 = INFINITY, .x1 = -INFINITY, .y0 = INFINITY, .y1 = -INFINITY};
    enum { STEPS = 64 };
    for (int k = 0; k < 4 * STEPS; k++) {
        double f = (double)(k % STEPS) / STEPS, x, y, z;
        double s = k < STEPS ? slab->s0 + f * (slab->s1 - slab->s0) : k < 2 * STEPS ? slab->s1 : k < 3 * STEPS ? slab->s1 - f * (slab->s1 - slab->s0) : slab->s0;
        double t = k < STEPS ? slab->t0 : k < 2 * STEPS ? slab->t0 + f * (slab->t1 - slab->t0) : k < 3 * STEPS ? slab->t1 : slab->t1 - f * (slab->t1 - slab->t0);
        lmg_square_to_disc(s, t, &x, &y, &z);
        table->x0 = d_min(table->x0, x);
        table->x1 = d_max(table->x1, x);
        table->y0 = d_min(table->y0, y);
        table->y1 = d_max(table->y1, y);
    }
}

lmg_result lmg_groups_create(const lmg_field *field, lmg_sampler *sampler, lmg_error *err)
{
    const lmg_layout *layout = &field->layout;
    for (uint32_t j = 0; j < layout->slab_count; j++)
        sampler->group_of[j] = -1;
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        const lmg_slab *slab = &layout->slabs[j];
        if (!(field->slabs[j].flux > 0))
            continue;
        uint32_t at = 0;
        while (at < sampler->group_count && !lmg_same_frame(sampler->groups[at].frame, slab))
            at++;
        lmg_group *g = &sampler->groups[at];
        if (at == sampler->group_count) {
            *g = (lmg_group){.frame = slab, .u0 = slab->u0, .u1 = slab->u1, .v0 = slab->v0, .v1 = slab->v1, .inside = true};
            sampler->group_count++;
        }
        g->u0 = d_min(g->u0, slab->u0);
        g->u1 = d_max(g->u1, slab->u1);
        g->v0 = d_min(g->v0, slab->v0);
        g->v1 = d_max(g->v1, slab->v1);
        g->flux += field->slabs[j].flux;
        sampler->flux += field->slabs[j].flux;
        g->inside = g->inside && sampler->etendue[j].inside;
        uint32_t cells = slab->nu > slab->nv ? slab->nu : slab->nv, levels = 0;
        while (levels + 1 < LMG_LEVELS && (uint32_t)1 << levels < cells)
            levels++;
        g->levels = levels > g->levels ? levels : g->levels;
        sampler->group_of[j] = (int8_t)at;
    }
    float(*pictures)[LMG_PICTURE] = malloc(FINE * FINE * sizeof *pictures);
    lmg_result r = pictures ? LMG_OK : LMG_ERROR_MEMORY;
    for (uint32_t i = 0; r == LMG_OK && i < sampler->group_count; i++) {
        lmg_group *g = &sampler->groups[i];
        uint32_t count = 0;
        for (uint32_t j = 0; j < layout->slab_count; j++)
            count += sampler->group_of[j] == (int8_t)i;
        g->tables = calloc(count + 1, sizeof *g->tables);
        if (!g->tables) {
            r = LMG_ERROR_MEMORY;
            break;
        }
        /* one for each slab, and one around all where the last of them isn't that */
        lmg_brightness around = {.x0 = INFINITY, .x1 = -INFINITY, .y0 = INFINITY, .y1 = -INFINITY};
        for (uint32_t j = 0; j < layout->slab_count; j++)
            if (sampler->group_of[j] == (int8_t)i) {
                lmg_brightness *t = &g->tables[g->table_count++];
                directions_of(&layout->slabs[j], t);
                around.x0 = d_min(around.x0, t->x0);
                around.x1 = d_max(around.x1, t->x1);
                around.y0 = d_min(around.y0, t->y0);
                around.y1 = d_max(around.y1, t->y1);
            }
        const lmg_brightness *last = &g->tables[g->table_count - 1];
        if (last->x0 > around.x0 || last->x1 < around.x1 || last->y0 > around.y0 || last->y1 < around.y1)
            g->tables[g->table_count++] = around;
        for (uint32_t k = 0; r == LMG_OK && k < g->table_count; k++) {
            lmg_brightness *t = &g->tables[k];
            t->low[0] = (float)t->x0;
            t->low[1] = (float)t->y0;
            t->high[0] = (float)t->x1;
            t->high[1] = (float)t->y1;
            t->x_scale = (float)(LMG_BINS / (t->x1 - t->x0));
            t->y_scale = (float)(LMG_BINS / (t->y1 - t->y0));
            t->inv_finest = fmaxf(t->x_scale, t->y_scale);
            t->finest = 1 / t->inv_finest;
            t->children = lmg_table_alloc(TABLE_BYTES);
            if (!t->children)
                r = LMG_ERROR_MEMORY;
            memset(pictures, 0, FINE * FINE * sizeof *pictures);
            for (uint32_t j = 0; r == LMG_OK && j < layout->slab_count; j++)
                if (sampler->group_of[j] == (int8_t)i && !gather(field, j, g, t, pictures))
                    r = LMG_ERROR_MEMORY;
            if (r == LMG_OK)
                finish(t, pictures);
        }
    }
    free(pictures);
    return r == LMG_OK ? LMG_OK : lmg_fail(err, r, "field: no memory for its sampler");
}
