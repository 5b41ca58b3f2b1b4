/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What a box file holds: the ledger and the tiles in their order, and the limits on both.  Knows nothing of EXR but how large its
 * pictures can be.
 */
#include "box_content.h"
#include "exr_check.h"

#include <math.h>
#include <string.h>

const char *const lmg_ledger_names[LMG_LEDGER_ENTRIES] = {"lumibox.emitted", "lumibox.stored", "lumibox.residual",
                                                          "lumibox.absorbed", "lumibox.lost"};

void lmg_ledger_get(const lmg_ledger *l, double values[LMG_LEDGER_ENTRIES][2])
{
    const double all[LMG_LEDGER_ENTRIES][2] = {{l->emitted, l->emitted_se},
                                               {l->stored, l->stored_se},
                                               {l->residual, l->residual_se},
                                               {l->absorbed, l->absorbed_se},
                                               {l->lost, l->lost_se}};
    memcpy(values, all, sizeof all);
}

void lmg_ledger_set(lmg_ledger *l, const double values[LMG_LEDGER_ENTRIES][2])
{
    l->emitted = values[0][0];
    l->emitted_se = values[0][1];
    l->stored = values[1][0];
    l->stored_se = values[1][1];
    l->residual = values[2][0];
    l->residual_se = values[2][1];
    l->absorbed = values[3][0];
    l->absorbed_se = values[3][1];
    l->lost = values[4][0];
    l->lost_se = values[4][1];
}

void lmg_tiles_init(lmg_tiles *t, const lmg_layout *layout)
{
    memset(t, 0, sizeof *t);
    t->layout = layout;
    uint64_t largest = 1;
    for (uint32_t i = 0; i < layout->slab_count; i++) {
        const uint64_t bytes = lmg_tile_cells(&layout->slabs[i]) * (layout->channels + 2) * sizeof(float);
        largest = bytes > largest ? bytes : largest;
        t->start[i + 1] = t->start[i] + (uint64_t)layout->slabs[i].nu * layout->slabs[i].nv;
    }
    t->run = largest >= LMG_RUN_BYTES ? 1 : LMG_RUN_BYTES / largest;
    t->end = t->start[layout->slab_count];
}

uint32_t lmg_tile_slab(const lmg_tiles *t, uint64_t tile)
{
    uint32_t slab = 0;
    while (tile >= t->start[slab + 1]) {
        slab++;
    }
    return slab;
}

bool lmg_tile_is_sound(const lmg_tiles *t, uint32_t slab, uint64_t tile_in_slab)
{
    const lmg_slab_data *data = &t->field->slabs[slab];
    const uint64_t cells = lmg_tile_cells(&t->layout->slabs[slab]), first = tile_in_slab * cells, channels = t->layout->channels;
    bool sound = true;
    for (uint64_t i = first; i < first + cells; i++) {
        for (uint64_t c = 0; c < channels; c++) {
            sound &= isfinite(lmg_cell_radiance(data, i)[c]) != 0;
        }
        sound &= isfinite(data->standard_error[i]) && data->standard_error[i] >= 0 && isfinite(data->half_a[i]);
    }
    return sound;
}

lmg_result lmg_box_check(const lmg_field *field, const char *where, lmg_result code, lmg_error *err)
{
    double ledger[LMG_LEDGER_ENTRIES][2];
    lmg_ledger_get(&field->ledger, ledger);
    for (int i = 0; i < LMG_LEDGER_ENTRIES; i++) {
        if (!isfinite(ledger[i][0]) || !isfinite(ledger[i][1]) || ledger[i][1] < 0) {
            return lmg_fail(err, code, "%s: the flux %s is %g +- %g lm", where, lmg_ledger_names[i] + strlen("lumibox."),
                            ledger[i][0], ledger[i][1]);
        }
    }
    for (int i = 0; i < 3; i++) {
        if (!isfinite(field->layout.colour[i])) {
            return lmg_fail(err, code, "%s: the common colour isn't finite", where);
        }
    }
    for (uint32_t i = 0; i < field->layout.slab_count; i++) {
        const lmg_slab *s = &field->layout.slabs[i];
        const uint64_t width = (uint64_t)s->nu * s->ns, height = (uint64_t)s->nv * s->nt;
        if (width > LMG_EXR_MAX_EXTENT || height > LMG_EXR_MAX_EXTENT || (uint64_t)s->nu * s->nv > INT32_MAX ||
            lmg_tile_cells(s) * (field->layout.channels + 2) * sizeof(float) > INT32_MAX) {
            return lmg_fail(err, code, "%s: slab %u of %u x %u x %u x %u cells is larger than an EXR picture can be", where, i,
                            s->nu, s->nv, s->ns, s->nt);
        }
    }
    return LMG_OK;
}
