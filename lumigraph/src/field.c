/* SPDX-License-Identifier: Apache-2.0 */
/* A field's memory, texts and scale.  Relies on memory.c for its tables and on sample.c for what is derived from them. */
#include "field.h"
#include "geometry.h"
#include "memory.h"
#include "trees.h"

#include <stdlib.h>
#include <string.h>

lmg_result lmg_field_allocate(const lmg_layout *layout, lmg_field **out, lmg_error *err)
{
    *out = NULL;
    lmg_field *field = calloc(1, sizeof *field);
    if (!field)
        return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory");
    field->layout = *layout;
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        lmg_slab_data *data = &field->slabs[j];
        data->cells = lmg_slab_cells(&layout->slabs[j]);
        data->stride = layout->channels + 1;
        size_t one, all;
        if (!lmg_size_product((size_t)data->cells, sizeof(float), &one) || !lmg_size_product(one, data->stride, &all) ||
            !(data->cell = lmg_table_alloc(all)) || !(data->standard_error = lmg_table_alloc(one)) ||
            !(data->half_a = lmg_table_alloc(one))) {
            lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for %.1f million cells", (double)data->cells * 1e-6);
            lmg_field_destroy(field);
            return LMG_ERROR_MEMORY;
        }
    }
    *out = field;
    return LMG_OK;
}

void lmg_field_destroy(lmg_field *field)
{
    if (!field)
        return;
    for (uint32_t j = 0; j < field->layout.slab_count; j++) {
        lmg_slab_data *data = &field->slabs[j];
        size_t one = (size_t)data->cells * sizeof(float);
        lmg_table_free(data->cell, one * data->stride);
        lmg_table_free(data->standard_error, one);
        lmg_table_free(data->half_a, one);
    }
    for (size_t i = 0; i < field->text_count; i++)
        free(field->texts[i].value);
    free(field->texts);
    lmg_sampler_destroy(field->sampler);
    lmg_trees_destroy(field->trees);
    free(field);
}

const lmg_layout *lmg_field_layout(const lmg_field *field)
{
    return &field->layout;
}

lmg_rounding lmg_field_rounding(const lmg_field *field)
{
    return field->rounding;
}

lmg_ledger lmg_field_ledger(const lmg_field *field)
{
    return field->ledger;
}

size_t lmg_field_memory(const lmg_field *field)
{
    size_t sum = sizeof *field + lmg_sampler_memory(field->sampler) + lmg_trees_memory(field->trees);
    for (uint32_t j = 0; j < field->layout.slab_count; j++)
        sum += (size_t)field->slabs[j].cells * sizeof(float) * (field->slabs[j].stride + 2);
    for (size_t i = 0; i < field->text_count; i++)
        sum += sizeof field->texts[i] + strlen(field->texts[i].value) + 1;
    return sum;
}

double lmg_field_slab_flux(const lmg_field *field, uint32_t slab, double *standard_error)
{
    const bool valid = slab < field->layout.slab_count;
    const double flux = valid ? field->slabs[slab].flux : 0;
    if (standard_error) {
        /* flux_se is that of Poisson counts.  A share of a known number of photons varies less; what was emitted may vary too. */
        const lmg_ledger *l = &field->ledger;
        const double se = valid ? field->slabs[slab].flux_se : 0, relative = l->emitted > 0 ? l->emitted_se / l->emitted : 0;
        *standard_error = l->photons ? sqrt(fmax(0, se * se + flux * flux * (relative * relative - 1 / (double)l->photons))) : se;
    }
    return flux;
}

/* Position of the first text whose name isn't before `name`. */
static size_t text_position(const lmg_field *field, const char *name, bool *found)
{
    size_t lo = 0, hi = field->text_count;
    while (lo < hi) {
        size_t mid = (lo + hi) / 2;
        if (strcmp(field->texts[mid].name, name) < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    *found = lo < field->text_count && strcmp(field->texts[lo].name, name) == 0;
    return lo;
}

static bool valid_name(const char *name)
{
    static const char allowed[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.-";
    size_t length = strlen(name);
    return length >= 1 && length <= 63 && strspn(name, allowed) == length;
}

lmg_result lmg_field_set_text(lmg_field *field, const char *name, const char *value, lmg_error *err)
{
    if (!name || !valid_name(name))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "field: a text's name has 1 to 63 characters of A-Z a-z 0-9 _ . -, unlike \"%.80s\"",
                        name ? name : "(null)");
    bool found;
    size_t at = text_position(field, name, &found);
    if (!value) {
        if (found) {
            free(field->texts[at].value);
            field->text_count--;
            memmove(&field->texts[at], &field->texts[at + 1], (field->text_count - at) * sizeof *field->texts);
        }
        return LMG_OK;
    }
    size_t length = strlen(value);
    char *copy = malloc(length + 1);
    if (!copy)
        return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for the text \"%s\"", name);
    memcpy(copy, value, length + 1);
    if (found) {
        free(field->texts[at].value);
        field->texts[at].value = copy;
        return LMG_OK;
    }
    lmg_text *texts = realloc(field->texts, (field->text_count + 1) * sizeof *texts);
    if (!texts) {
        free(copy);
        return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for the text \"%s\"", name);
    }
    field->texts = texts;
    memmove(&texts[at + 1], &texts[at], (field->text_count - at) * sizeof *texts);
    texts[at] = (lmg_text){.value = copy};
    memcpy(texts[at].name, name, strlen(name) + 1);
    field->text_count++;
    return LMG_OK;
}

const char *lmg_field_get_text(const lmg_field *field, const char *name)
{
    bool found;
    if (!name)
        return NULL;
    size_t at = text_position(field, name, &found);
    return found ? field->texts[at].value : NULL;
}

const char *lmg_field_text_name(const lmg_field *field, size_t i)
{
    return i < field->text_count ? field->texts[i].name : NULL;
}

lmg_result lmg_field_scale(lmg_field *field, double factor, lmg_error *err)
{
    if (!(factor > 0) || !isfinite(factor))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "field: the factor %g must be positive", factor);
    for (uint32_t j = 0; j < field->layout.slab_count; j++) {
        lmg_slab_data *data = &field->slabs[j];
        for (uint64_t i = 0; i < data->cells; i++) {
            float *radiance = lmg_cell_radiance(data, i);
            for (uint32_t c = 0; c < field->layout.channels; c++)
                radiance[c] = (float)((double)radiance[c] * factor);
            data->standard_error[i] = (float)((double)data->standard_error[i] * factor);
            data->half_a[i] = (float)((double)data->half_a[i] * factor);
        }
    }
    if (field->trees)
        lmg_trees_scale(field->trees, factor);
    lmg_ledger *l = &field->ledger;
    double *values[] = {&l->emitted,    &l->stored,    &l->residual,    &l->absorbed,    &l->lost,
                        &l->emitted_se, &l->stored_se, &l->residual_se, &l->absorbed_se, &l->lost_se};
    for (size_t i = 0; i < sizeof values / sizeof *values; i++)
        *values[i] *= factor;
    return lmg_field_prepare(field, err);
}
