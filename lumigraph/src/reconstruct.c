/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Turns counts into radiance: L = flux / effective etendue, with the standard error of a weighted Poisson count, sqrt(sum of squares).
 * Relies on etendue.c for the measure and on accumulate.h for the counts.
 *
 * A cell of which almost nothing is its own (slabs before it own the rest, or its lines pass the bounds by) can't carry a radiance: what
 * fell there goes to the nearest cell of the same slab that can, so that no flux is lost and none becomes an infinite radiance.
 */
#include "accumulate.h"
#include "etendue.h"
#include "field.h"
#include "gather.h"

#include <stdlib.h>

/* Share of a cell's etendue that must be its own.  The clipped integral's error is below this for cells cut by a corner, and emission
 * finds a ray of its own in such a cell within a few hundred tries. */
#define OWN_SHARE 0.01

typedef lmg_cell_flux cell_sum;

typedef struct orphan {
    uint32_t i[4]; /* iu, iv, is, it */
    cell_sum sum;
} orphan;

static cell_sum read_cell(const lmg_accumulator *acc, uint64_t cell, double lumens)
{
    const uint32_t channels = acc->layout.channels;
    const _Atomic uint64_t *w = acc->words + cell * lmg_cell_words(channels);
    cell_sum s = {0};
    for (uint32_t c = 0; c < channels; c++) {
        s.a[c] = (double)(int64_t)atomic_load_explicit(&w[c], memory_order_relaxed) * (lumens / LMG_FLUX_ONE);
        s.b[c] = (double)(int64_t)atomic_load_explicit(&w[channels + c], memory_order_relaxed) * (lumens / LMG_FLUX_ONE);
    }
    s.variance = (double)atomic_load_explicit(&w[2 * channels], memory_order_relaxed) * (lumens * lumens / LMG_SQUARE_ONE);
    return s;
}

static double luminance(const double c[3], uint32_t channels)
{
    return channels == 1 ? c[0] : 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
}

/* Adds counts to a cell's radiance. */
static void put(lmg_field *field, uint32_t j, uint64_t cell, const cell_sum *s, double etendue)
{
    lmg_slab_data *data = &field->slabs[j];
    const uint32_t channels = field->layout.channels;
    float *radiance = lmg_cell_radiance(data, cell);
    for (uint32_t c = 0; c < channels; c++)
        radiance[c] = (float)((double)radiance[c] + (s->a[c] + s->b[c]) / etendue);
    data->standard_error[cell] = (float)hypot((double)data->standard_error[cell], sqrt(s->variance) / etendue);
    data->half_a[cell] = (float)((double)data->half_a[cell] + 2 * luminance(s->a, channels) / etendue);
}

/* The nearest cell (fewest steps, then largest share) around an orphan that can carry its flux; false when the slab has none. */
static bool adopt(const lmg_etendue *e, const orphan *o, uint64_t *cell, double *etendue)
{
    const lmg_slab *s = e->slab;
    const uint32_t n[4] = {s->nu, s->nv, s->ns, s->nt};
    uint32_t reach = 0;
    for (int k = 0; k < 4; k++)
        reach = n[k] > reach ? n[k] : reach;
    /* Shells of growing radius; a slab that has any such cell has one within a few steps of where light falls.  The search is given up
     * at 8 because a shell's size grows with the cube of its radius. */
    for (int64_t radius = 1; radius < reach && radius <= 8; radius++) {
        double best = 0;
        int64_t d[4];
        for (d[0] = -radius; d[0] <= radius; d[0]++)
            for (d[1] = -radius; d[1] <= radius; d[1]++)
                for (d[2] = -radius; d[2] <= radius; d[2]++)
                    for (d[3] = -radius; d[3] <= radius; d[3]++) {
                        if (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + d[3] * d[3] > radius * radius)
                            continue;
                        int64_t i[4];
                        bool valid = true;
                        for (int k = 0; k < 4; k++) {
                            i[k] = (int64_t)o->i[k] + d[k];
                            valid = valid && i[k] >= 0 && i[k] < n[k];
                        }
                        if (!valid)
                            continue;
                        double own = lmg_etendue_effective(e, (uint32_t)i[0], (uint32_t)i[1], (uint32_t)i[2], (uint32_t)i[3]);
                        double full = lmg_etendue_full(e, (uint32_t)i[0], (uint32_t)i[1], (uint32_t)i[2], (uint32_t)i[3]);
                        if (own >= OWN_SHARE * full && own > best) {
                            best = own;
                            *etendue = own;
                            *cell = (((uint64_t)i[1] * s->nu + (uint64_t)i[0]) * s->nt + (uint64_t)i[3]) * s->ns + (uint64_t)i[2];
                        }
                    }
        if (best > 0)
            return true;
    }
    return false;
}

/* Whether anything fell into a cell of the slab whose first cell this is. */
typedef struct counted_cells {
    const lmg_accumulator *acc;
    uint64_t first;
} counted_cells;

static bool is_counted(const void *self, uint64_t cell)
{
    const counted_cells *c = self;
    const uint32_t words = lmg_cell_words(c->acc->layout.channels);
    const _Atomic uint64_t *w = c->acc->words + (c->first + cell) * words;
    for (uint32_t k = 0; k < words; k++)
        if (atomic_load_explicit(&w[k], memory_order_relaxed))
            return true;
    return false;
}

/* What is gathered beside the photons, and the flux of its cells by photons alone and combined. */
typedef struct gathering {
    const lmg_gathering *cells; /* NULL: none */
    double photons, combined;
} gathering;

static void combine(gathering *g, uint64_t cell, double etendue, double lumens, uint32_t channels, cell_sum *s)
{
    const size_t i = lmg_gathering_find(g->cells, cell);
    if (i == lmg_gathering_cells(g->cells))
        return;
    g->photons += luminance(s->a, channels) + luminance(s->b, channels);
    lmg_gathering_combine(g->cells, i, etendue, lumens, s);
    g->combined += luminance(s->a, channels) + luminance(s->b, channels);
}

/* Light that a gathered cell adopts. */
static void adopted(gathering *g, uint64_t cell, uint32_t channels, const cell_sum *s)
{
    if (!g->cells || lmg_gathering_find(g->cells, cell) == lmg_gathering_cells(g->cells))
        return;
    g->photons += luminance(s->a, channels) + luminance(s->b, channels);
    g->combined += luminance(s->a, channels) + luminance(s->b, channels);
}

/* Gives the gathered cells the flux that photons say they have together. */
static void keep_flux(lmg_field *field, const lmg_plan *plan, const gathering *g)
{
    const double factor = g->combined > 0 ? g->photons / g->combined : 1;
    const uint32_t channels = field->layout.channels;
    uint32_t j = 0;
    for (size_t i = 0; i < lmg_gathering_cells(g->cells); i++) {
        const uint64_t at = lmg_gathering_cell(g->cells, i);
        while (plan->first[j + 1] <= at)
            j++;
        lmg_slab_data *data = &field->slabs[j];
        const uint64_t cell = at - plan->first[j];
        float *radiance = lmg_cell_radiance(data, cell);
        for (uint32_t c = 0; c < channels; c++)
            radiance[c] = (float)((double)radiance[c] * factor);
        data->standard_error[cell] = (float)((double)data->standard_error[cell] * factor);
        data->half_a[cell] = (float)((double)data->half_a[cell] * factor);
    }
}

/* One slab; *homeless gets the flux and variance that no cell of it can carry. */
static lmg_result reconstruct_slab(const lmg_accumulator *acc, uint32_t j, double lumens, gathering *gathered, lmg_field *field,
                                   cell_sum *homeless, lmg_error *err)
{
    const lmg_slab *slab = &acc->layout.slabs[j];
    const uint64_t first = acc->plan.first[j];
    lmg_etendue e;
    orphan *orphans = NULL;
    size_t orphan_count = 0, orphan_room = 0;
    lmg_result r = lmg_etendue_prepare(&e, &acc->layout, j, err);
    const counted_cells counted = {acc, first};
    if (r == LMG_OK)
        r = lmg_etendue_share(&e, is_counted, &counted, err);
    if (r != LMG_OK) {
        lmg_etendue_release(&e);
        return r;
    }
    uint64_t cell = 0;
    for (uint32_t iv = 0; iv < slab->nv; iv++)
        for (uint32_t iu = 0; iu < slab->nu; iu++)
            for (uint32_t it = 0; it < slab->nt; it++)
                for (uint32_t is = 0; is < slab->ns; is++, cell++) {
                    cell_sum s = read_cell(acc, first + cell, lumens);
                    bool empty = s.variance == 0;
                    for (int c = 0; c < 3; c++)
                        empty = empty && s.a[c] == 0 && s.b[c] == 0;
                    if (empty)
                        continue;
                    double own = lmg_etendue_effective(&e, iu, iv, is, it);
                    if (lmg_etendue_is_full(&e) ? own > 0 : own >= OWN_SHARE * lmg_etendue_full(&e, iu, iv, is, it)) {
                        if (gathered->cells)
                            combine(gathered, first + cell, own, lumens, acc->layout.channels, &s);
                        put(field, j, cell, &s, own);
                        continue;
                    }
                    if (orphan_count == orphan_room) {
                        orphan_room = orphan_room ? 2 * orphan_room : 64;
                        orphan *more = realloc(orphans, orphan_room * sizeof *orphans);
                        if (!more) {
                            r = lmg_fail(err, LMG_ERROR_MEMORY, "reconstruct: no memory");
                            goto cleanup;
                        }
                        orphans = more;
                    }
                    orphans[orphan_count++] = (orphan){{iu, iv, is, it}, s};
                }
    for (size_t k = 0; k < orphan_count; k++) {
        uint64_t home;
        double etendue;
        if (adopt(&e, &orphans[k], &home, &etendue)) {
            put(field, j, home, &orphans[k].sum, etendue);
            adopted(gathered, first + home, acc->layout.channels, &orphans[k].sum);
            continue;
        }
        for (int c = 0; c < 3; c++) {
            homeless->a[c] += orphans[k].sum.a[c];
            homeless->b[c] += orphans[k].sum.b[c];
        }
        homeless->variance += orphans[k].sum.variance;
    }
cleanup:
    free(orphans);
    lmg_etendue_release(&e);
    return r;
}

lmg_result lmg_field_reconstruct(const lmg_accumulator *acc, double lumens_per_unit, const lmg_ledger *ledger, lmg_field **out,
                                 lmg_error *err)
{
    return lmg_field_reconstruct_gathered(acc, lumens_per_unit, ledger, NULL, out, NULL, err);
}

lmg_result lmg_field_reconstruct_gathered(const lmg_accumulator *acc, double lumens_per_unit, const lmg_ledger *ledger,
                                          const lmg_gathering *cells, lmg_field **out, double *share, lmg_error *err)
{
    if (!out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "reconstruct: nowhere to put the field");
    *out = NULL;
    if (!acc || !(lumens_per_unit > 0) || !isfinite(lumens_per_unit))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "reconstruct: %g lumens per unit must be positive", lumens_per_unit);
    lmg_field *field;
    lmg_result r = lmg_field_allocate(&acc->layout, &field, err);
    if (r != LMG_OK)
        return r;
    cell_sum homeless = {0};
    gathering gathered = {.cells = cells};
    for (uint32_t j = 0; j < acc->layout.slab_count && r == LMG_OK; j++)
        r = reconstruct_slab(acc, j, lumens_per_unit, &gathered, field, &homeless, err);
    if (r == LMG_OK && cells)
        keep_flux(field, &acc->plan, &gathered);
    if (r == LMG_OK)
        r = lmg_field_prepare(field, err);
    if (r != LMG_OK) {
        lmg_field_destroy(field);
        return r;
    }
    lmg_deposit_totals totals = lmg_accumulator_totals(acc);
    double moved = luminance(homeless.a, acc->layout.channels) + luminance(homeless.b, acc->layout.channels), stored_variance = 0;
    for (uint32_t j = 0; j < acc->layout.slab_count; j++)
        stored_variance += field->slabs[j].flux_se * field->slabs[j].flux_se;
    lmg_ledger *l = &field->ledger;
    if (ledger)
        *l = *ledger;
    l->stored = totals.stored * lumens_per_unit - moved;
    l->residual = totals.residual * lumens_per_unit + moved;
    if (!ledger) {
        l->photons = totals.rays + totals.unplaced;
        l->emitted = l->stored + l->residual;
    }
    if (!(ledger && ledger->stored_se > 0))
        l->stored_se = sqrt(stored_variance);
    if (!(ledger && ledger->residual_se > 0))
        l->residual_se = sqrt((double)acc->residual_squares / LMG_SQUARE_ONE * lumens_per_unit * lumens_per_unit + homeless.variance);
    if (!ledger)
        l->emitted_se = hypot(l->stored_se, l->residual_se);
    if (share)
        *share = l->stored > 0 ? gathered.photons / l->stored : 0;
    *out = field;
    return LMG_OK;
}
