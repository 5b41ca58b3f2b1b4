/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading accessors (gltf_accessor.h).  Relies on gltf_check.c: views lie within buffers and accessors within views.  The formulas
 * of normalised integers are those of the glTF 2.0 specification, section 3.11.
 */
#include "gltf_accessor.h"

#include <stdlib.h>
#include <string.h>

enum { BYTE = 5120, UNSIGNED_BYTE = 5121, SHORT = 5122, UNSIGNED_SHORT = 5123, UNSIGNED_INT = 5125, FLOAT = 5126 };

static size_t type_size(int32_t type)
{
    return type == BYTE || type == UNSIGNED_BYTE ? 1 : type == SHORT || type == UNSIGNED_SHORT ? 2 : 4;
}

/* Buffers hold little-endian numbers at any alignment. */
static double number_at(const uint8_t *p, int32_t type, bool normalized)
{
    uint32_t word = 0;
    switch (type) {
    case BYTE: {
        double v = (int8_t)p[0];
        return !normalized ? v : v < -127 ? -1 : v / 127;
    }
    case UNSIGNED_BYTE:
        return normalized ? p[0] / 255.0 : p[0];
    case SHORT: {
        double v = (int16_t)(uint16_t)(p[0] | p[1] << 8);
        return !normalized ? v : v < -32767 ? -1 : v / 32767;
    }
    case UNSIGNED_SHORT: {
        double v = p[0] | p[1] << 8;
        return normalized ? v / 65535 : v;
    }
    default:
        word = (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
        break;
    }
    if (type == FLOAT) {
        float f;
        memcpy(&f, &word, sizeof f);
        return (double)f;
    }
    return normalized ? word / 4294967295.0 : word;
}

static const uint8_t *view_data(const gltf_document *doc, int32_t view, uint64_t offset)
{
    const gltf_view *v = &doc->views[view];
    return doc->buffers[v->buffer].data + v->offset + offset;
}

static lmg_result apply_sparse(const gltf_document *doc, const gltf_accessor *a, double *values, lmg_error *err)
{
    size_t index_size = type_size(a->sparse_index_type), size = type_size(a->component_type), n = (size_t)a->components;
    const uint8_t *indices = view_data(doc, a->sparse_index_view, a->sparse_index_offset);
    const uint8_t *from = view_data(doc, a->sparse_value_view, a->sparse_value_offset);
    double last = -1;
    for (uint64_t i = 0; i < a->sparse_count; i++) {
        double index = number_at(indices + i * index_size, a->sparse_index_type, false);
        if (index <= last || index >= (double)a->count)
            return lmg_fail(err, LMG_ERROR_INPUT,
                            "sparse index %.0f is out of order or outside its %llu elements; re-export the mesh", index,
                            (unsigned long long)a->count);
        last = index;
        for (size_t c = 0; c < n; c++)
            values[(size_t)index * n + c] = number_at(from + (i * n + c) * size, a->component_type, a->normalized);
    }
    return LMG_OK;
}

lmg_result gltf_read_numbers(const gltf_document *doc, int32_t accessor, int32_t components, double **values, lmg_error *err)
{
    *values = NULL;
    const gltf_accessor *a = &doc->accessors[accessor];
    if (a->components != components)
        return lmg_fail(err, LMG_ERROR_INPUT, "has %d components a vertex and should have %d; re-export the mesh", a->components,
                        components);
    size_t n = (size_t)components;
    double *out = calloc(a->count, n * sizeof *out);
    if (!out)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %llu elements", (unsigned long long)a->count);
    if (a->view >= 0) {
        size_t size = type_size(a->component_type);
        uint64_t stride = doc->views[a->view].stride ? doc->views[a->view].stride : size * n;
        const uint8_t *from = view_data(doc, a->view, a->offset);
        for (uint64_t i = 0; i < a->count; i++)
            for (size_t c = 0; c < n; c++)
                out[i * n + c] = number_at(from + i * stride + c * size, a->component_type, a->normalized);
    }
    if (a->sparse_count) {
        lmg_result result = apply_sparse(doc, a, out, err);
        if (result) {
            free(out);
            return result;
        }
    }
    *values = out;
    return LMG_OK;
}

lmg_result gltf_read_indices(const gltf_document *doc, int32_t accessor, uint32_t **values, lmg_error *err)
{
    *values = NULL;
    const gltf_accessor *a = &doc->accessors[accessor];
    if (a->component_type != UNSIGNED_BYTE && a->component_type != UNSIGNED_SHORT && a->component_type != UNSIGNED_INT)
        return lmg_fail(err, LMG_ERROR_INPUT, "are not unsigned integers; re-export the mesh");
    double *numbers;
    lmg_result result = gltf_read_numbers(doc, accessor, 1, &numbers, err);
    if (result)
        return result;
    uint32_t *out = malloc(a->count * sizeof *out);
    if (!out) {
        free(numbers);
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %llu indices", (unsigned long long)a->count);
    }
    for (uint64_t i = 0; i < a->count; i++)
        out[i] = (uint32_t)numbers[i];
    free(numbers);
    *values = out;
    return LMG_OK;
}
