/* SPDX-License-Identifier: Apache-2.0 */
/* What the meshes are like: area, openness, winding and enclosed volume of each part, and faces that lie on each other.  Equal positions
 * count as one vertex, whatever their normals and texture coordinates: exporters split vertices there. */
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

/* Edges of one triangle, and those that both of their triangles run along the same way. */
static lmg_result count_edges(lum_model *m, const uint32_t *same, lmg_error *err)
{
    for (uint32_t p = 0; p < m->part_count; p++) {
        lum_part *part = &m->parts[p];
        table t;
        LUM_TRY(table_create(&t, 3 * (size_t)part->triangle_count, err));
        for (uint32_t i = 0; i < part->triangle_count; i++) {
            const uint32_t *corner = m->indices + 3 * ((size_t)part->first_triangle + i);
            for (int k = 0; k < 3; k++) {
                uint32_t a = same[corner[k]], b = same[corner[(k + 1) % 3]];
                entry *e = table_at(&t, a < b ? a : b, a < b ? b : a, 0);
                e->count++;
                e->value += a < b ? 1 : (uint32_t)-1;
            }
        }
        for (size_t i = 0; i <= t.mask; i++) {
            part->boundary_edges += t.entries[i].count == 1;
            part->turned_edges += t.entries[i].count == 2 && t.entries[i].value != 0;
        }
        free(t.entries);
    }
    return LMG_OK;
}

/* Triangles on the same three places.  The same way round, in the same material: a copy that adds nothing, removed.  Otherwise, unless
 * one of them bounds a solid (touching.c), which of the two light meets is chance.  Back to back in the same opaque material that is harmless and a common way to say
 * "two-sided". */
typedef struct pair {
    int32_t material, other;
    uint32_t count;
    uint32_t part; /* the first, for the message */
} pair;

static lmg_result note_pair(lum_build *b, pair **pairs, uint32_t *count, int32_t material, int32_t other, uint32_t part)
{
    for (uint32_t i = 0; i < *count; i++)
        if ((*pairs)[i].material == material && (*pairs)[i].other == other) {
            (*pairs)[i].count++;
            return LMG_OK;
        }
    LUM_TRY(lum_grow((void **)pairs, sizeof **pairs, *count + 1u, b->err));
    (*pairs)[(*count)++] = (pair){material, other, 1, part};
    return LMG_OK;
}

/* Sorts three numbers; returns whether that was an even permutation. */
static bool sort3(uint32_t v[3])
{
    bool even = true;
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2 - i; j++)
            if (v[j] > v[j + 1]) {
                uint32_t swap = v[j];
                v[j] = v[j + 1];
                v[j + 1] = swap;
                even = !even;
            }
    return even;
}

static bool lets_light_through(const lum_material *m)
{
    return m->transmission > 0 || m->diffuse_transmission > 0 || m->alpha_mode == LUM_ALPHA_BLEND;
}

static lmg_result scan_coincident(lum_build *b, const uint32_t *same, table *t, pair **pairs, uint32_t *pair_count)
{
    lum_model *m = b->model;
    uint32_t kept = 0;
    for (uint32_t p = 0; p < m->part_count; p++) {
        lum_part *part = &m->parts[p];
        uint32_t first = kept, last = part->first_triangle + part->triangle_count, dropped = 0;
        for (uint32_t i = part->first_triangle; i < last; i++) {
            uint32_t v[3];
            for (int k = 0; k < 3; k++)
                v[k] = same[m->indices[3 * (size_t)i + (size_t)k]];
            bool even = sort3(v);
            entry *e = table_at(t, v[0], v[1], v[2]);
            int32_t material = part->material;
            if (e->count++ == 0) {
                e->value = 2 * (uint32_t)material + even;
            } else if (e->value == 2 * (uint32_t)material + even) {
                dropped++;
                continue;
            } else if (e->value / 2 != (uint32_t)material ? !lum_material_is_solid(&m->materials[material]) &&
                                                                !lum_material_is_solid(&m->materials[e->value / 2])
                                                          : lets_light_through(&m->materials[material])) {
                LUM_TRY(note_pair(b, pairs, pair_count, material, (int32_t)(e->value / 2), p));
            }
            memmove(m->indices + 3 * (size_t)kept, m->indices + 3 * (size_t)i, 3 * sizeof *m->indices);
            m->triangle_material[kept] = material;
            m->triangle_part[kept++] = p;
        }
        part->first_triangle = first;
        part->triangle_count = kept - first;
        if (dropped)
            lum_warn(b, "mesh \"%.60s\": %u triangle%s another one of the same material: left out", part->mesh, dropped,
                     dropped == 1 ? " repeats" : "s repeat");
    }
    m->triangle_count = kept;
    return LMG_OK;
}

static lmg_result find_coincident(lum_build *b, const uint32_t *same)
{
    const lum_model *m = b->model;
    table t;
    pair *pairs = NULL;
    uint32_t count = 0;
    LUM_TRY(table_create(&t, m->triangle_count, b->err));
    lmg_result result = scan_coincident(b, same, &t, &pairs, &count);
    for (uint32_t i = 0; i < count && !result; i++) {
        const char *material = m->materials[pairs[i].material].name, *mesh = m->parts[pairs[i].part].mesh;
        if (pairs[i].material == pairs[i].other && lum_material_is_solid(&m->materials[pairs[i].material]))
            lum_warn(b,
                     "material \"%.60s\" (mesh \"%.60s\"): %u of its faces lie back to back on others of it. Two blocks of it that touch "
                     "are one; but if it is one wall drawn from both sides, nothing of it is left: delete one side in the model, or recipe "
                     "entry \"thin\"",
                     material, mesh, pairs[i].count);
        else if (pairs[i].material == pairs[i].other)
            lum_warn(b,
                     "material \"%.60s\" (mesh \"%.60s\"): %u of its faces lie back to back on others of it, so light passes it "
                     "twice. If "
                     "it is one wall, delete one side in the model, or halve its effect by a recipe entry",
                     material, mesh, pairs[i].count);
        else
            lum_warn(
                b,
                "material \"%.60s\" (mesh \"%.60s\"): %u of its faces lie on faces of material \"%.60s\"; which one light meets is "
                "chance. Recipe entry \"leave_out\" can take one of them away",
                material, mesh, pairs[i].count, m->materials[pairs[i].other].name);
    }
    free(t.entries);
    free(pairs);
    return result;
}

/* --------------------------------------------------------------------------------------------------------- measures */

/* Corners of a triangle, metres, and twice its area times its normal. */
static void triangle(const lum_model *m, uint32_t t, double x[3][3], double n[3])
{
    double e1[3], e2[3];
    for (int k = 0; k < 3; k++)
        for (int j = 0; j < 3; j++)
            x[k][j] = m->unit * (double)m->positions[3 * (size_t)m->indices[3 * (size_t)t + (size_t)k] + (size_t)j];
    for (int j = 0; j < 3; j++) {
        e1[j] = x[1][j] - x[0][j];
        e2[j] = x[2][j] - x[0][j];
    }
    for (int j = 0; j < 3; j++)
        n[j] = e1[(j + 1) % 3] * e2[(j + 2) % 3] - e1[(j + 2) % 3] * e2[(j + 1) % 3];
}

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

double lum_triangle_area(const lum_model *m, uint32_t t)
{
    double x[3][3], n[3];
    triangle(m, t, x, n);
    return length(n) / 2;
}

/* Area, and volume by the divergence theorem: over the tetrahedra between each triangle and the centre of the model. */
static void measure(lum_model *m)
{
    for (uint32_t p = 0; p < m->part_count; p++) {
        lum_part *part = &m->parts[p];
        for (uint32_t i = 0; i < part->triangle_count; i++) {
            double x[3][3], n[3];
            triangle(m, part->first_triangle + i, x, n);
            part->area += length(n) / 2;
            part->enclosed_volume += (n[0] * x[0][0] + n[1] * x[0][1] + n[2] * x[0][2]) / 6;
        }
    }
}

/* -------------------------------------------------------------------------------------------------------------- inside */

static uint32_t find_root(uint32_t *parent, uint32_t v)
{
    while (parent[v] != v)
        v = parent[v] = parent[parent[v]];
    return v;
}

/* Pieces: triangles of a part that share vertices.  The middle of a piece is the mean of its surface. */
static void mark_inside(const lum_model *m, const lum_part *part, uint32_t *same, uint32_t *parent, double (*middle)[4],
                        bool *inside)
{
    uint32_t first = part->first_triangle, last = first + part->triangle_count;
    for (uint32_t t = first; t < last; t++)
        for (int k = 0; k < 3; k++) {
            uint32_t v = same[m->indices[3 * (size_t)t + (size_t)k]];
            parent[v] = v;
            memset(middle[v], 0, sizeof middle[v]);
        }
    for (uint32_t t = first; t < last; t++)
        for (int k = 1; k < 3; k++) {
            uint32_t a = find_root(parent, same[m->indices[3 * (size_t)t]]);
            uint32_t b = find_root(parent, same[m->indices[3 * (size_t)t + (size_t)k]]);
            parent[a] = b;
        }
    for (uint32_t t = first; t < last; t++) {
        double x[3][3], n[3];
        triangle(m, t, x, n);
        double *sum = middle[find_root(parent, same[m->indices[3 * (size_t)t]])], area = length(n) / 2;
        for (int j = 0; j < 3; j++)
            sum[j] += area * (x[0][j] + x[1][j] + x[2][j]) / 3;
        sum[3] += area;
    }
    for (uint32_t t = first; t < last; t++) {
        double x[3][3], n[3], outward = 0;
        triangle(m, t, x, n);
        const double *sum = middle[find_root(parent, same[m->indices[3 * (size_t)t]])];
        for (int j = 0; j < 3; j++)
            outward += n[j] * ((x[0][j] + x[1][j] + x[2][j]) / 3 - sum[j] / sum[3]);
        inside[t] = outward < 0;
    }
}

lmg_result lum_find_inside(lum_build *b, bool **inside)
{
    const lum_model *m = b->model;
    size_t n = (size_t)m->vertex_count + 1;
    uint32_t *same = malloc(n * sizeof *same), *parent = malloc(n * sizeof *parent);
    double(*middle)[4] = malloc(n * sizeof *middle);
    *inside = calloc((size_t)m->triangle_count + 1, sizeof **inside);
    lmg_result result = LMG_OK;
    if (!same || !parent || !middle || !*inside)
        result = lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    else
        result = weld(m, same, b->err);
    for (uint32_t p = 0; p < m->part_count && !result; p++)
        mark_inside(m, &m->parts[p], same, parent, middle, *inside);
    free(same);
    free(parent);
    free(middle);
    if (result) {
        free(*inside);
        *inside = NULL;
    }
    return result;
}

lmg_result lum_check_meshes(lum_build *b)
{
    lum_model *m = b->model;
    uint32_t *same = malloc(((size_t)m->vertex_count + 1) * sizeof *same);
    if (!same)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    lmg_result result = weld(m, same, b->err);
    if (!result)
        result = find_coincident(b, same);
    if (!result)
        result = count_edges(m, same, b->err);
    measure(m);
    free(same);
    return result;
}
