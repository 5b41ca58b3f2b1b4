/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Hard cases of placement: sample lamps under a root node that scales them from nanometres to hundreds of kilometres, moves them 10
 * km away, turns and mirrors them.  A scaled or moved lamp has the same vertices in floats, and with them the same photons up to the
 * rounding of doubles, so the box must be the same but for what lies that near to a border, and where nothing is rounded (powers of
 * two) to the bit; a turned or mirrored one chooses other tangents at surfaces and has other photons, so there the comparison is by
 * standard errors.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"

#include "field.h"

#include <jansson.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const uint64_t PHOTONS = 400000;

typedef struct transform {
    double scale[3], rotation[4], translation[3];
} transform;
static const transform IDENTITY = {{1, 1, 1}, {0, 0, 0, 1}, {0, 0, 0}};

static json_t *numbers(const double *x, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; i < n; ++i)
        json_array_append_new(a, json_real(x[i]));
    return a;
}

/* Writes the sample lamp under a root node with the transform, bakes it with 800 lm. */
static lmg_field *bake_under(const char *lamp, const transform *t)
{
    char source[1200], bin[1200], file[64];
    snprintf(source, sizeof(source), "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, lamp, lamp);
    json_t *g = json_load_file(source, 0, NULL);
    assert_non_null(g);
    json_t *nodes = json_object_get(g, "nodes"), *scene = json_array_get(json_object_get(g, "scenes"), 0);
    json_t *root = json_pack("{s:s, s:O, s:o, s:o, s:o}", "name", "moved", "children", json_object_get(scene, "nodes"), "scale",
                             numbers(t->scale, 3), "rotation", numbers(t->rotation, 4), "translation", numbers(t->translation, 3));
    assert_int_equal(json_array_append_new(nodes, root), 0);
    json_object_set_new(scene, "nodes", json_pack("[I]", (json_int_t)json_array_size(nodes) - 1));
    json_t *buffer = json_array_get(json_object_get(g, "buffers"), 0);
    snprintf(bin, sizeof(bin), "%s/models/%s/%s", LUMIBOX_BINARY_DIR, lamp, json_string_value(json_object_get(buffer, "uri")));
    snprintf(file, sizeof(file), "%s.gltf", lamp);
    unlink(hard_path("lamp.bin"));
    assert_int_equal(symlink(bin, hard_path("lamp.bin")), 0);
    json_object_set_new(buffer, "uri", json_string("lamp.bin"));
    assert_int_equal(json_dump_file(g, hard_path(file), JSON_REAL_PRECISION(17)), 0);
    json_decref(g);

    lum_recipe *recipe;
    lmg_error err = {{0}};
    snprintf(source, sizeof(source), "%s/luminaires/models/%s/%s.recipe.json", LUMIBOX_SOURCE_DIR, lamp, lamp);
    if ((access(source, R_OK) == 0 ? lum_recipe_read(source, &recipe, &err) : lum_recipe_create(&recipe, &err)) != LMG_OK)
        fail_msg("%s", err.message);
    lum_model *model = hard_load(hard_path(file), recipe);
    lum_recipe_destroy(recipe);
    const bake_options options = {.photons = PHOTONS, .seed = 3, .flux_lm = 800, .fit.cells = 40000};
    bake_report report;
    lmg_field *field = hard_bake(model, &options, &report);
    lum_model_destroy(model);
    return field;
}

static double efficiency(const lmg_field *f)
{
    const lmg_ledger l = lmg_field_ledger(f);
    return (l.stored + l.residual) / l.emitted;
}

/* Largest difference of the layouts, b's lengths divided by scale and its origin moved back, in sizes; infinite when their cells
 * don't correspond. */
static double layout_difference(const lmg_field *a, const lmg_field *b, double scale, lmg_vec3 moved)
{
    const lmg_layout *x = &a->layout, *y = &b->layout;
    if (x->slab_count != y->slab_count || x->channels != y->channels)
        return (double)INFINITY;
    double worst = fabs(y->size / scale / x->size - 1);
    for (uint32_t j = 0; j < x->slab_count; ++j) {
        const lmg_slab *p = &x->slabs[j], *q = &y->slabs[j];
        if (p->kind != q->kind || p->nu != q->nu || p->nv != q->nv || p->ns != q->ns || p->nt != q->nt)
            return (double)INFINITY;
        const double metres[] = {p->o.x - (q->o.x - moved.x) / scale,
                                 p->o.y - (q->o.y - moved.y) / scale,
                                 p->o.z - (q->o.z - moved.z) / scale,
                                 p->u0 - q->u0 / scale,
                                 p->u1 - q->u1 / scale,
                                 p->v0 - q->v0 / scale,
                                 p->v1 - q->v1 / scale};
        for (size_t i = 0; i < sizeof(metres) / sizeof(metres[0]); ++i)
            worst = fmax(worst, fabs(metres[i]) / x->size);
        const double slopes[] = {p->s0 - q->s0, p->s1 - q->s1, p->t0 - q->t0, p->t1 - q->t1};
        for (size_t i = 0; i < 4; ++i)
            worst = fmax(worst, fabs(slopes[i]));
    }
    return worst;
}

/* Share of the light that is in another cell: half the sum of the cells' differences in flux. */
static double moved_light(const lmg_field *a, const lmg_field *b, double scale)
{
    double difference = 0, all = 0;
    for (uint32_t j = 0; j < a->layout.slab_count; ++j) {
        const lmg_slab *s = &a->layout.slabs[j];
        uint64_t cell = 0;
        for (uint32_t iv = 0; iv < s->nv; ++iv)
            for (uint32_t iu = 0; iu < s->nu; ++iu)
                for (uint32_t it = 0; it < s->nt; ++it)
                    for (uint32_t is = 0; is < s->ns; ++is, ++cell) {
                        const uint32_t c = a->layout.channels;
                        const float *x = lmg_cell_radiance(&a->slabs[j], cell), *y = lmg_cell_radiance(&b->slabs[j], cell);
                        const double la = c == 1 ? (double)x[0] : lmg_luminance(x), lb = c == 1 ? (double)y[0] : lmg_luminance(y);
                        if (la == 0 && lb == 0)
                            continue;
                        const double g = lmg_slab_cell_etendue(s, iu, iv, is, it);
                        difference += fabs(lb * scale * scale - la) * g;
                        all += la * g;
                    }
    }
    return 0.5 * difference / all;
}

/* Points of the comparison, at 0.8 to 5 sizes below the lamp; the first on a plane of symmetry, where directions lie exactly on
 * borders of cells. */
enum { POINTS = 6 };
static lmg_vec3 point_below(const lmg_layout *l, int i)
{
    const double r = l->size * (0.8 + 0.9 * i);
    const lmg_vec3 lo = l->bounds_min, hi = l->bounds_max;
    return v3(0.5 * (lo.x + hi.x) + 0.3 * r * cos(2.0 * i), lo.y - r, 0.5 * (lo.z + hi.z) + 0.3 * r * sin(2.0 * i));
}

/* The case: same layout, same flux, same light in the cells, same illuminance around. */
static void same_photons(const char *lamp, const lmg_field *a, const char *what, double scale, lmg_vec3 moved)
{
    const transform t = {{scale, scale, scale}, {0, 0, 0, 1}, {moved.x, moved.y, moved.z}};
    lmg_field *b = bake_under(lamp, &t);
    char name[100];
    snprintf(name, sizeof(name), "%s %s", lamp, what);
    /* the same box to 1e-5 is what is promised of any scale; doubles' rounding is far below it */
    hard_at_most(name, "same layout, relative to the size", layout_difference(a, b, scale, moved), 1e-5);
    hard_at_most(name, "same efficiency", fabs(efficiency(b) - efficiency(a)), 1e-5);
    /* powers of two round nothing: any difference would be a length in metres somewhere in the program */
    int exponent;
    const bool exact = frexp(scale, &exponent) == 0.5 && moved.x == 0;
    hard_at_most(name, exact ? "share of light in another cell, nothing being rounded" : "share of light in another cell",
                 moved_light(a, b, scale), exact ? 0 : 1e-5);
    double worst = 0;
    for (int i = 0; i < POINTS; ++i) {
        const lmg_vec3 p = point_below(&a->layout, i);
        const lmg_vec3 q = {p.x * scale + moved.x, p.y * scale + moved.y, p.z * scale + moved.z};
        worst = fmax(worst, fabs(hard_illuminance(b, q, v3(0, 1, 0), NULL) * scale * scale / hard_illuminance(a, p, v3(0, 1, 0), NULL) - 1));
    }
    hard_at_most(name, "same illuminance x scale^2, at 0.8 to 5 sizes", worst, 1e-5);
    lmg_field_destroy(b);
}

static void test_scale(void **state)
{
    (void)state;
    static const char *const LAMPS[] = {"paraboloid-spot", "opal-globe", "glass-lens"};
    for (int l = 0; l < 3; ++l) {
        lmg_field *a = bake_under(LAMPS[l], &IDENTITY);
        static const double SCALES[] = {1e-6, 0.0254, 1e6, 0x1p-20, 0x1p20};
        static const char *const NAMES[] = {"x 1e-6", "x 0.0254", "x 1e6", "x 2^-20", "x 2^20"};
        for (int i = 0; i < 5; ++i)
            same_photons(LAMPS[l], a, NAMES[i], SCALES[i], v3(0, 0, 0));
        same_photons(LAMPS[l], a, "10 km away", 1, v3(7071, -5000, 5000));
        lmg_field_destroy(a);
    }
}

static void test_turned_and_mirrored(void **state)
{
    (void)state;
    static const struct {
        const char *what;
        transform t;
        double m[3][3]; /* what it does to points */
    } CASES[] = {
        {"turned 90 degrees about z",
         {{1, 1, 1}, {0, 0, 0.70710678118654752, 0.70710678118654752}, {0}},
         {{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}},
        {"turned 120 degrees about (1,1,1)", {{1, 1, 1}, {0.5, 0.5, 0.5, 0.5}, {0}}, {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}}},
        {"mirrored in x", {{-1, 1, 1}, {0, 0, 0, 1}, {0}}, {{-1, 0, 0}, {0, 1, 0}, {0, 0, 1}}},
        {"mirrored through the centre", {{-1, -1, -1}, {0, 0, 0, 1}, {0}}, {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}}},
    };
    static const char *const LAMPS[] = {"paraboloid-spot", "glass-lens"};
    for (int l = 0; l < 2; ++l) {
        lmg_field *a = bake_under(LAMPS[l], &IDENTITY);
        const double n = (double)PHOTONS, p = efficiency(a);
        for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); ++i) {
            lmg_field *b = bake_under(LAMPS[l], &CASES[i].t);
            const char *name = hard_text("%s %s", LAMPS[l], CASES[i].what);
            /* two independent binomial shares; 4 standard errors for 8 + 8 comparisons: p < 1e-3 in all */
            hard_at_most(name, "same efficiency, in standard errors", fabs(efficiency(b) - p) / sqrt(2 * p * (1 - p) / n), 4);
            hard_at_most(name, "nothing lost", lmg_field_ledger(b).lost / lmg_field_ledger(b).emitted, 1e-5);
            double sum_a = 0, sum_b = 0, variance = 0;
            for (int k = 0; k < 5; ++k) {
                const double r = a->layout.size * (1.5 + k);
                const double at[3] = {0.1 * r * cos(1.3 * k), -r, 0.1 * r * sin(1.3 * k)}, normal[3] = {0, 1, 0};
                double q[3], m[3], ea, eb;
                for (int c = 0; c < 3; ++c) {
                    q[c] = m[c] = 0;
                    for (int d = 0; d < 3; ++d) {
                        q[c] += CASES[i].m[c][d] * at[d];
                        m[c] += CASES[i].m[c][d] * normal[d];
                    }
                }
                sum_a += r * r * hard_illuminance(a, v3(at[0], at[1], at[2]), v3(0, 1, 0), &ea);
                sum_b += r * r * hard_illuminance(b, v3(q[0], q[1], q[2]), v3(m[0], m[1], m[2]), &eb);
                /* readings of one box aren't independent: their errors add up at worst */
                variance += r * r * (ea + eb);
            }
            hard_at_most(name, "same illuminance in the beam, in standard errors", fabs(sum_a - sum_b) / variance, 4);
            lmg_field_destroy(b);
        }
        lmg_field_destroy(a);
    }
}

int main(void)
{
    hard_begin("transforms");
    hard_without_traps();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scale),
        cmocka_unit_test(test_turned_and_mirrored),
    };
    return cmocka_run_group_tests_name("hard_transforms", tests, NULL, NULL);
}
