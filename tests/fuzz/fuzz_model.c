/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fuzz target of lamps: any bytes as a glTF file (text or binary) are refused with one line, or give a model that holds what the
 * rest of the program relies on.
 */
#define _GNU_SOURCE /* memfd_create */
#include "fuzz.h"

#include <luminaires/model.h>

#include <math.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

/* What the rest of the program relies on. */
static void check(const lum_model *m)
{
    for (uint32_t i = 0; i < m->warning_count; ++i)
        if (strchr(m->warnings[i], '\n'))
            abort();
    for (size_t i = 0; i < 3 * (size_t)m->vertex_count; ++i)
        if (!isfinite(m->positions[i]))
            abort();
    for (size_t i = 0; i < 3 * (size_t)m->triangle_count; ++i)
        if (m->indices[i] >= m->vertex_count)
            abort();
    for (uint32_t i = 0; i < m->triangle_count; ++i)
        if ((uint32_t)m->triangle_material[i] >= m->material_count || m->triangle_part[i] >= m->part_count)
            abort();
    for (uint32_t i = 0; i < m->material_count; ++i) {
        const lum_material *a = &m->materials[i];
        if (!(a->base_color[0] >= 0 && a->base_color[0] <= 1 && a->roughness >= 0 && a->roughness <= 1 && a->ior >= 1) ||
            a->base_texture.image >= (int32_t)m->image_count || a->emissive_texture.image >= (int32_t)m->image_count)
            abort();
    }
    if (!isfinite(m->bounds_max.x - m->bounds_min.x) || !isfinite(m->centre.x))
        abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    const int fd = memfd_create("fuzz", MFD_CLOEXEC);
    if (fd < 0 || (size > 0 && write(fd, bytes, size) != (ssize_t)size))
        abort();
    char path[64];
    snprintf(path, sizeof(path), "/proc/self/fd/%d", fd);
    lmg_error err = {{0}};
    lum_model *m = NULL;
    if (lum_model_load(path, NULL, &m, &err) != LMG_OK) {
        if (m)
            abort();
        fuzz_check_message(&err);
    } else {
        check(m);
        lum_model_destroy(m);
    }
    close(fd);
    return 0;
}
