/* SPDX-License-Identifier: Apache-2.0 */
/* Tables that layered materials need beside those of microfacet.c: how facets reflect by the cosine, sheen, thin films. */
#include "film.h"
#include "microfacet.h"
#include "sheen.h"
#include "stretched.h"

#include <stdlib.h>

/* The visible normals on a Fibonacci lattice, as in microfacet.c. */
static void fill_row(double alpha, double mu, float share[LUM_COSINE_STEPS + 1])
{
    enum { POINTS = 2584, BEFORE = 1597 };
    double sum[LUM_COSINE_STEPS + 1] = {0};
    facets f = {.wi = vec(sqrt((1 - mu) * (1 + mu)), 0, mu), .ax = alpha, .ay = alpha};
    f.b = facets_b(&f, f.wi);
    for (uint32_t i = 0; i < POINTS; i++) {
        facet h = facets_sample(&f, (double)((uint64_t)i * BEFORE % POINTS) / POINTS, (i + 0.5) / POINTS);
        lmg_vec3 o = facet_reflected(&f, &h);
        double c = facet_cosine(&h) * LUM_COSINE_STEPS;
        if (o.z > 0) {
            double keep = o.z * (mu + f.b) / (o.z * f.b + mu * facets_b(&f, o));
            int k = (int)c < LUM_COSINE_STEPS ? (int)c : LUM_COSINE_STEPS - 1;
            sum[k] += keep * (k + 1 - c);
            sum[k + 1] += keep * (c - k);
        }
    }
    for (int k = 0; k <= LUM_COSINE_STEPS; k++) {
        share[k] = (float)(sum[k] / POINTS);
    }
}

/* One side of a boundary: eta, the relative index that light from there meets. */
static void fill_boundary(double alpha, double eta, lum_boundary_rows *rows)
{
    enum { POINTS = 10946, BEFORE = 6765 };
    for (int j = 0; j <= LUM_COSINE_NODES; j++) {
        double x = j ? (double)j / LUM_COSINE_NODES : 0.03 / LUM_COSINE_NODES, mu = x * x;
        double sum[LUM_COSINE_STEPS + 1] = {0}, without = 0;
        facets f = {.wi = vec(sqrt((1 - mu) * (1 + mu)), 0, mu), .ax = alpha, .ay = alpha};
        f.b = facets_b(&f, f.wi);
        for (uint32_t i = 0; i < POINTS; i++) {
            facet h = facets_sample(&f, (double)((uint64_t)i * BEFORE % POINTS) / POINTS, (i + 0.5) / POINTS);
            lmg_vec3 o = facet_reflected(&f, &h);
            double ci = facet_cosine(&h), ct2 = 1 - (1 - ci) * (1 + ci) / (eta * eta);
            double kept = o.z > 0 ? o.z * (mu + f.b) / (o.z * f.b + mu * facets_b(&f, o)) : 0;
            if (ct2 <= 0) { /* total reflection stays total */
                without += kept;
                continue;
            }
            double ct = sqrt(ct2), length = sqrt(h.mm);
            lmg_vec3 t = vec_along(vec_scale(f.wi, -1 / eta), h.m, (ci / eta - ct) / length);
            double passed = facets_keep_refracted(&f, t), c = (eta > 1 ? ci : ct) * LUM_COSINE_STEPS;
            int k = (int)c < LUM_COSINE_STEPS ? (int)c : LUM_COSINE_STEPS - 1;
            sum[k] += (kept - passed) * (k + 1 - c);
            sum[k + 1] += (kept - passed) * (c - k);
            without += passed;
        }
        rows->without[j] = (float)(without / POINTS);
        for (int k = 0; k <= LUM_COSINE_STEPS; k++) {
            rows->share[j][k] = (float)(sum[k] / POINTS);
        }
    }
}

const lum_boundary_set *lum_boundary_set_find(lum_table_store *store, float alpha, float eta, bool *failed)
{
    for (const lum_table_store *from = store; from; from = from->like) {
        for (size_t i = 0; i < from->boundary_set_count; i++) {
            if (from->boundary_sets[i]->alpha == alpha && from->boundary_sets[i]->eta == eta) {
                return from->boundary_sets[i];
            }
        }
    }
    int count = alpha < 0 ? LUM_LOBE_COMPUTED_ROUGHNESSES + 1 : 1;
    lum_boundary_set *set = malloc(sizeof *set + (size_t)count * sizeof set->rows[0]);
    lum_boundary_set **sets = realloc(store->boundary_sets, (store->boundary_set_count + 1) * sizeof *sets);
    if (sets) {
        store->boundary_sets = sets;
    }
    if (!set || !sets) {
        free(set);
        *failed = true;
        return NULL;
    }
    sets[store->boundary_set_count++] = set;
    *set = (lum_boundary_set){alpha, eta, count};
    for (int k = 0; k < count; k++) {
        double r = (double)k / LUM_LOBE_COMPUTED_ROUGHNESSES, a = fmax(count == 1 ? (double)alpha : r * r, (double)LUM_SMOOTH);
        fill_boundary(a, (double)eta, &set->rows[k][0]);
        fill_boundary(a, 1 / (double)eta, &set->rows[k][1]);
    }
    return set;
}

double lum_boundary_rests(const lum_boundary_set *set, double alpha, bool front, const float f[LUM_COSINE_STEPS + 1],
                          float rest[LUM_COSINE_NODES + 1])
{
    double x = set->count > 1 ? sqrt(alpha < 1 ? alpha : 1) * LUM_LOBE_COMPUTED_ROUGHNESSES : 0, total = 0;
    int low = set->count == 1 ? 0 : (int)x < LUM_LOBE_COMPUTED_ROUGHNESSES ? (int)x : LUM_LOBE_COMPUTED_ROUGHNESSES - 1;
    const lum_boundary_rows *p = &set->rows[low][front ? 0 : 1], *q = set->count > 1 ? &set->rows[low + 1][front ? 0 : 1] : p;
    float w = set->count > 1 ? (float)(x - low) : 0;
    for (int j = 0; j <= LUM_COSINE_NODES; j++) {
        float a = p->without[j], b = q->without[j];
        for (int i = 0; i <= LUM_COSINE_STEPS; i++) {
            a += f[i] * p->share[j][i];
            b += f[i] * q->share[j][i];
        }
        rest[j] = fminf(fmaxf(1 - (a + w * (b - a)), 1e-9f), 1);
        /* The integral of 2 rest mu dmu = 4 rest y^3 dy, y = sqrt(mu), by Simpson's rule. */
        double y = (double)j / LUM_COSINE_NODES;
        total += (j == LUM_COSINE_NODES ? 1 : j % 2 ? 4 : 2) * (double)rest[j] * 4 * y * y * y / (3.0 * LUM_COSINE_NODES);
    }
    return total;
}

static const lum_cosine_set *find_cosines(lum_table_store *store, float alpha, bool *failed)
{
    for (const lum_table_store *from = store; from; from = from->like) {
        for (size_t i = 0; i < from->cosine_set_count; i++) {
            if (from->cosine_sets[i]->alpha == alpha) {
                return from->cosine_sets[i];
            }
        }
    }
    int count = alpha < 0 ? LUM_LOBE_COMPUTED_ROUGHNESSES + 1 : 1;
    lum_cosine_set *set = malloc(sizeof *set + (size_t)count * sizeof set->rows[0]);
    lum_cosine_set **sets = realloc(store->cosine_sets, (store->cosine_set_count + 1) * sizeof *sets);
    if (sets) {
        store->cosine_sets = sets;
    }
    if (!set || !sets) {
        free(set);
        *failed = true;
        return NULL;
    }
    sets[store->cosine_set_count++] = set;
    set->alpha = alpha;
    set->count = count;
    for (int k = 0; k < count; k++) {
        double r = (double)k / LUM_LOBE_COMPUTED_ROUGHNESSES, a = count == 1 ? (double)alpha : r * r;
        for (int j = 0; j <= LUM_COSINE_NODES; j++) {
            double x = j ? (double)j / LUM_COSINE_NODES : 0.03 / LUM_COSINE_NODES;
            fill_row(fmax(a, (double)LUM_SMOOTH), x * x, set->rows[k].share[j]);
        }
    }
    return set;
}

void lum_cosine_albedos(const lum_cosine_set *set, double alpha, const float f[LUM_COSINE_STEPS + 1],
                        float albedo[LUM_COSINE_NODES + 1])
{
    double x = set->count > 1 ? sqrt(alpha < 1 ? alpha : 1) * LUM_LOBE_COMPUTED_ROUGHNESSES : 0;
    int k = (int)x;
    k = set->count == 1 ? 0 : k < LUM_LOBE_COMPUTED_ROUGHNESSES ? k : LUM_LOBE_COMPUTED_ROUGHNESSES - 1;
    float w = (float)(x - k);
    for (int j = 0; j <= LUM_COSINE_NODES; j++) {
        float a = 0, b = 0;
        const float *p = set->rows[k].share[j], *q = w > 0 ? set->rows[k + 1].share[j] : p;
        for (int i = 0; i <= LUM_COSINE_STEPS; i++) {
            a += f[i] * p[i];
            b += f[i] * q[i];
        }
        albedo[j] = a + w * (b - a);
    }
}

void lum_layer_tables_fill(lum_table_store *store, const lum_material *m, struct lum_tables *t, bool *failed)
{
    const lum_layers *l = &m->layers;
    bool varies = m->metal_rough_texture.image != LUM_NONE;
    if (m->metallic < 1 || varies) {
        t->cosines = find_cosines(store, varies ? -1.0f : m->roughness * m->roughness, failed);
    }
    if (l->present & LUM_LAYER_CLEARCOAT) {
        bool textured = l->clearcoat_roughness_texture.image != LUM_NONE;
        t->clearcoat = lum_lobe_set_find(store, LUM_LOBE_COAT, 1.5f,
                                         textured ? -1.0f : l->clearcoat_roughness * l->clearcoat_roughness, failed);
    }
    if (l->present & LUM_LAYER_SHEEN) {
        if (!store->sheen) {
            store->sheen = calloc(1, sizeof *store->sheen);
            *failed |= !store->sheen;
        }
        if (store->sheen) {
            double r = (double)l->sheen_roughness;
            lum_sheen_table_fill(store->sheen, l->sheen_roughness_texture.image != LUM_NONE ? 0 : r, r);
        }
        t->sheen = store->sheen;
    }
    if ((l->present & LUM_LAYER_ANISOTROPY) && (m->metallic > 0 || varies) && l->anisotropy > 0) {
        t->stretched = lum_stretched_find(store, varies ? -1.0f : m->roughness,
                                          l->anisotropy_texture.image != LUM_NONE ? -1.0f : l->anisotropy, failed);
    }
    if (l->present & LUM_LAYER_IRIDESCENCE && store->like && store->like->film) {
        t->film = store->like->film;
    } else if (l->present & LUM_LAYER_IRIDESCENCE) {
        if (!store->film) {
            store->film = malloc(sizeof *store->film);
            *failed |= !store->film;
            if (store->film) {
                lum_film_table_fill(store->film);
            }
        }
        t->film = store->film;
    }
}
