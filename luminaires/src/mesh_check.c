/* SPDX-License-Identifier: Apache-2.0 */
/* What the meshes are like: area, openness and enclosed volume of each part, and faces that lie on each other.  Equal positions count as
 * one vertex, whatever their normals and texture coordinates: exporters split vertices there. */
#include "model_build.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A table of keys of three words with a count each; open addressing, never more than half full. */
typedef struct entry {
    uint32_t key[3];
    uint32_t count;
    uint32_t value;
} entry;

typedef struct table {
    entry *entries;
    size_t mask;
} table;

static lmg_result table_create(table *t, size_t keys, lmg_error *err)
{
    size_t size = 16;
    while (size < 2 * keys)
        size *= 2;
    t->mask = size - 1;
    t->entries = calloc(size, sizeof *t->entries);
    return t->entries ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
}

/* The entry of a key; count 0 = new. */
static entry *table_at(table *t, uint32_t a, uint32_t b, uint32_t c)
{
    uint64_t h = (uint64_t)a * 0x9e3779b97f4a7c15u ^ (uint64_t)b * 0xc2b2ae3d27d4eb4fu ^ (uint64_t)c * 0x165667b19e3779f9u;
    h = (h ^ (h >> 31)) * 0xbf58476d1ce4e5b9u;
    for (size_t i = (h ^ (h >> 29)) & t->mask;; i = (i + 1) & t->mask) {
        entry *e = &t->entries[i];
        if (e->count == 0) {
            e->key[0] = a;
            e->key[1] = b;
            e->key[2] = c;
            return e;
        }
        if (e->key[0] == a && e->key[1] == b && e->key[2] == c)
            return e;
    }
}

/* For each vertex the number of the first vertex at the same place. */
static lmg_result weld(const lum_model *m, uint32_t *same, lmg_error *err)
{
    table t;
    LUM_TRY(table_create(&t, m->vertex_count, err));
    for (uint32_t v = 0; v < m->vertex_count; v++) {
        uint32_t bits[3];
        for (int i = 0; i < 3; i++) {
            float x = m->positions[3 * (size_t)v + (size_t)i] + 0.0f; /* -0 becomes 0 */
            memcpy(&bits[i], &x, sizeof x);
        }
        entry *e = table_at(&t, bits[0], bits[1], bits[2]);
        if (e->count++ == 0)
            e->value = v;
        same[v] = e->value;
    }
    free(t.entries);
    return LMG_OK;
}

static lmg_result count_boundary(lum_model *m, const uint32_t *same, lmg_error *err)
{
    for (uint32_t p = 0; p < m->part_count; p++) {
        lum_part *part = &m->parts[p];
        table t;
        LUM_TRY(table_create(&t, 3 * (size_t)part->triangle_count, err));
        for (uint32_t i = 0; i < part->triangle_count; i++) {
            const uint32_t *corner = m->indices + 3 * ((size_t)part->first_triangle + i);
            for (int k = 0; k < 3; k++) {
                uint32_t a = same[corner[k]], b = same[corner[(k + 1) % 3]];
                table_at(&t, a < b ? a : b, a < b ? b : a, 0)->count++;
            }
        }
        for (size_t i = 0; i <= t.mask; i++)
            part->boundary_edges += t.entries[i].count == 1;
        free(t.entries);
    }
    return LMG_OK;
}

static void sort3(uint32_t v[3])
{
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2 - i; j++)
            if (v[j] > v[j + 1]) {
                uint32_t swap = v[j];
                v[j] = v[j + 1];
                v[j + 1] = swap;
            }
}

/* Which of two coincident faces a ray meets is chance; within one part back-to-back faces are a common way to say "two-sided". */
static lmg_result find_coincident(lum_build *b, const uint32_t *same)
{
    const lum_model *m = b->model;
    table t;
    LUM_TRY(table_create(&t, m->triangle_count, b->err));
    uint32_t *pairs = calloc((size_t)m->part_count + 1, sizeof *pairs), *other = calloc((size_t)m->part_count + 1, sizeof *other);
    if (!pairs || !other) {
        free(t.entries);
        free(pairs);
        free(other);
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    }
    for (uint32_t i = 0; i < m->triangle_count; i++) {
        uint32_t v[3];
        for (int k = 0; k < 3; k++)
            v[k] = same[m->indices[3 * (size_t)i + (size_t)k]];
        sort3(v);
        entry *e = table_at(&t, v[0], v[1], v[2]);
        if (e->count++ == 0) {
            e->value = m->triangle_part[i];
            continue;
        }
        pairs[m->triangle_part[i]]++;
        other[m->triangle_part[i]] = e->value;
    }
    for (uint32_t p = 0; p < m->part_count; p++) {
        if (!pairs[p])
            continue;
        const lum_part *part = &m->parts[p], *with = &m->parts[other[p]];
        const char *material = m->materials[part->material].name, *with_material = m->materials[with->material].name;
        if (p == other[p])
            lum_warn(b, "mesh \"%.60s\" (material \"%.60s\"): %u faces lie on other faces of it; which one light meets is chance. Recipe "
                        "entry \"leave_out\" can take a copy away", part->mesh, material, pairs[p]);
        else
            lum_warn(b, "mesh \"%.60s\" (material \"%.60s\"): %u faces lie on faces of mesh \"%.60s\" (material \"%.60s\"); which one light "
                        "meets is chance. Recipe entry \"leave_out\" can take one of them away",
                     part->mesh, material, pairs[p], with->mesh, with_material);
    }
    free(t.entries);
    free(pairs);
    free(other);
    return LMG_OK;
}

/* Area, and volume by the divergence theorem over the tetrahedra between each triangle and the centre of the model. */
static void measure(lum_model *m)
{
    for (uint32_t p = 0; p < m->part_count; p++) {
        lum_part *part = &m->parts[p];
        for (uint32_t i = 0; i < part->triangle_count; i++) {
            const uint32_t *corner = m->indices + 3 * ((size_t)part->first_triangle + i);
            double x[3][3];
            for (int k = 0; k < 3; k++)
                for (int j = 0; j < 3; j++)
                    x[k][j] = (double)m->positions[3 * (size_t)corner[k] + (size_t)j];
            double n[3], e1[3], e2[3];
            for (int j = 0; j < 3; j++) {
                e1[j] = x[1][j] - x[0][j];
                e2[j] = x[2][j] - x[0][j];
            }
            for (int j = 0; j < 3; j++)
                n[j] = e1[(j + 1) % 3] * e2[(j + 2) % 3] - e1[(j + 2) % 3] * e2[(j + 1) % 3];
            part->area += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
            part->enclosed_volume += (n[0] * x[0][0] + n[1] * x[0][1] + n[2] * x[0][2]) / 6;
        }
    }
}

lmg_result lum_check_meshes(lum_build *b)
{
    lum_model *m = b->model;
    measure(m);
    uint32_t *same = malloc(((size_t)m->vertex_count + 1) * sizeof *same);
    if (!same)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    lmg_result result = weld(m, same, b->err);
    if (!result)
        result = count_boundary(m, same, b->err);
    if (!result)
        result = find_coincident(b, same);
    free(same);
    return result;
}
