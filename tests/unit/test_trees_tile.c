/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Tiles of light that repeats itself, found among points of a slab's rectangle: a louvre of 5 x 3 cells, whose light goes where
 * blades let it through; the same with one cell that differs; light that is even all over; light that doesn't repeat, or changes
 * slowly.
 */
#include "lamp_fixture.h"
#include "trees.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { CELLS_U = 5, CELLS_V = 3 };

typedef enum light { LOUVRE, ODD_CELL, BRIGHT_CELL, EVEN, SLANTED, GRADIENT, WEAK_GRADIENT, FALLOFF, STRAY } light;

/* Relative, at a place of the rectangle: within a cell light goes away from the nearer blade. */
static double light_at(light kind, const double x[4])
{
    const double u = fmod(x[0] * CELLS_U, 1), v = fmod(x[1] * CELLS_V, 1);
    const bool odd = (int)(x[0] * CELLS_U) == 3 && (int)(x[1] * CELLS_V) == 1;
    switch (kind) {
    case EVEN:
        return 0.5;
    case SLANTED:
        return fabs(x[2] - x[0]) < 0.2 && fabs(x[3] - x[1]) < 0.2;
    case GRADIENT:
        return 0.7 + 0.3 * x[0];
    case WEAK_GRADIENT:
        return 0.9 + 0.1 * x[1];
    case FALLOFF:
        return 1 - 2 * ((x[0] - 0.5) * (x[0] - 0.5) + (x[1] - 0.5) * (x[1] - 0.5));
    case STRAY: /* a beam in the middle, and some light beside it */
        return fabs(x[0] - 0.5) < 0.1 && fabs(x[1] - 0.5) < 0.1 ? 1 : 0.001;
    case LOUVRE:
    case ODD_CELL:
    case BRIGHT_CELL:
        break;
    }
    const double s = kind == ODD_CELL && odd ? 1 - x[2] : x[2], bright = kind == BRIGHT_CELL && odd ? 1.15 : 1;
    return 0.8 * bright * (fabs(s - 0.3 - 0.4 * u) < 0.25 && fabs(x[3] - 0.3 - 0.4 * v) < 0.25);
}

static lmg_tree_point *points_of(light kind, uint64_t seed, size_t count)
{
    lmg_tree_point *points = malloc(count * sizeof *points);
    assert_non_null(points);
    for (size_t i = 0; i < count; i++) {
        lamp_rng g = lamp_stream(seed, i);
        double x[4];
        do
            for (int k = 0; k < 4; k++)
                x[k] = lamp_next(&g);
        while (lamp_next(&g) >= light_at(kind, x));
        points[i] = (lmg_tree_point){.at = {(float)x[0], (float)x[1], (float)x[2], (float)x[3]}, .flux = 1};
        for (int k = 0; k < 4; k++)
            points[i].at[k] = fminf(points[i].at[k], 1 - 0x1p-24F);
    }
    return points;
}

static lmg_tiling found(light kind, uint64_t seed, size_t count)
{
    lmg_tree_point *points = points_of(kind, seed, count);
    lmg_tiling t = {.slab = 7};
    lmg_find_tiles(&t, points, count);
    print_message("%d: %u x %u tiles of %u kinds\n", (int)kind, t.nu, t.nv, t.kinds);
    assert_int_equal(t.slab, 7);
    free(points);
    return t;
}

static void test_louvre(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 3; seed++) {
        const lmg_tiling t = found(LOUVRE, seed, 400000);
        /* whole cells, or equal parts of them */
        assert_true(t.nu % CELLS_U == 0 && t.nv % CELLS_V == 0);
        const uint32_t mu = t.nu / CELLS_U, mv = t.nv / CELLS_V;
        assert_true(t.kinds >= mu * mv && t.kinds <= mu * mv + 1);
        uint32_t same = 0;
        for (uint32_t i = 0; i < t.nu * t.nv; i++)
            same += t.kind[i] == t.kind[i / t.nu % mv * t.nu + i % t.nu % mu];
        assert_true(same + 1 >= t.nu * t.nv);
    }
}

static void test_odd_cell(void **state)
{
    (void)state;
    static const light KINDS[] = {ODD_CELL, BRIGHT_CELL};
    for (int k = 0; k < 2; k++) {
        const lmg_tiling t = found(KINDS[k], 4, 400000);
        assert_true(t.nu % CELLS_U == 0 && t.nv % CELLS_V == 0);
        const uint32_t mu = t.nu / CELLS_U, mv = t.nv / CELLS_V;
        uint32_t same = 0;
        for (uint32_t i = 0; i < t.nu * t.nv; i++) {
            const uint32_t iu = i % t.nu, iv = i / t.nu;
            const bool odd = iu / mu == 3 && iv / mv == 1;
            same += (t.kind[i] == t.kind[iv % mv * t.nu + iu % mu]) != odd;
        }
        assert_true(same + 1 >= t.nu * t.nv);
    }
}

/* As many tiles as photons allow, all alike but for chance; none where light doesn't repeat, or photons are few. */
static void test_even_and_slanted(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 10; seed++) {
        const lmg_tiling even = found(EVEN, seed, 100000);
        assert_true(even.nu * even.nv >= 9 && even.nu * even.nv <= 20 && even.kinds <= 2);
    }
    lmg_tiling t;
    static const light NONE[] = {SLANTED, GRADIENT, WEAK_GRADIENT, FALLOFF, STRAY};
    for (int k = 0; k < 5; k++) {
        t = found(NONE[k], 1, NONE[k] == GRADIENT ? 1500000 : 700000);
        /* a gradient along one axis repeats along the other, and only there */
        assert_true(NONE[k] == WEAK_GRADIENT || t.nu == 1);
        assert_true(NONE[k] == GRADIENT || t.nv == 1);
        assert_true(t.kinds == 1 && t.kind[0] == 0);
    }
    t = found(LOUVRE, 1, 5000);
    assert_true(t.nu == 1 && t.nv == 1);
    lmg_find_tiles(&t, NULL, 0);
    assert_true(t.nu == 1 && t.nv == 1 && t.kinds == 1);
}

/* From a place to its root and back. */
static void test_places(void **state)
{
    (void)state;
    const lmg_tiling t = {.slab = 0, .nu = 3, .nv = 2, .first = 4, .kinds = 2, .kind = {0, 1, 0, 0, 1, 1}};
    uint32_t seen[2] = {0};
    for (uint32_t i = 0; i < 6; i++) {
        const float x = 0.25F, y = 0.625F;
        float at[4] = {((float)(i % 3) + x) / 3, ((float)(i / 3) + y) / 2, 0.1F, 0.2F};
        double u = 0.25, v = 0.625;
        lmg_tile_place(&t, t.kind[i], seen[t.kind[i]]++, &u, &v);
        assert_true(fabs(u - (double)at[0]) < 1e-6 && fabs(v - (double)at[1]) < 1e-6);
        assert_int_equal(lmg_tile_root(&t, at), 4u + t.kind[i]);
        assert_true(fabsf(at[0] - x) < 1e-6F && fabsf(at[1] - y) < 1e-6F && at[2] == 0.1F && at[3] == 0.2F);
    }
    float last[4] = {1 - 0x1p-24F, 1 - 0x1p-24F, 0, 0};
    assert_int_equal(lmg_tile_root(&t, last), 5);
    assert_true(last[0] < 1 && last[1] < 1);

    lmg_trees *trees = calloc(1, sizeof *trees);
    assert_non_null(trees);
    trees->tiling_count = 2;
    trees->tilings[0] = (lmg_tiling){.slab = 0, .nu = 1, .nv = 1, .kinds = 1};
    trees->tilings[1] = t;
    assert_true(lmg_trees_set_roots(trees));
    assert_true(trees->root_count == 3 && trees->tilings[1].first == 1 && trees->roots[1].tiles == 3 &&
                trees->roots[2].tiles == 3 && trees->roots[2].tiling == 1);
    trees->tiling_count = 5;
    for (int k = 0; k < 5; k++)
        trees->tilings[k] = (lmg_tiling){.nu = 16, .nv = 1, .kinds = LMG_MOST_KINDS};
    assert_false(lmg_trees_set_roots(trees));
    free(trees);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_louvre), cmocka_unit_test(test_odd_cell),
                                       cmocka_unit_test(test_even_and_slanted), cmocka_unit_test(test_places)};
    return cmocka_run_group_tests_name("tiles", tests, NULL, NULL);
}
