/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Radiance trees: they keep the light, are sharper than cells, know their noise, and come out the same again.  Seeds are fixed, so
 * that a run is a fact.
 */
#include "field.h"
#include "lamp_fixture.h"
#include "trees.h"
#include "trees_fixture.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ------------------------------------------------------------------------------------------------------- what trees say */

/* Each tree's leaves hold the light of their root's rays, on one side of a lamp or on six, with a window and a focus or without. */
static void test_light_is_kept(void **state)
{
    (void)state;
    enum { RAYS = 30000 };
    static const lamp LAMPS[] = {LAMP_DISC, LAMP_SPHERE, LAMP_LENS};
    static const lmg_layout_choice CHOICES[] = {LMG_LAYOUT_APERTURE, LMG_LAYOUT_CUBE, LMG_LAYOUT_AUTO};
    for (size_t i = 0; i < sizeof LAMPS / sizeof LAMPS[0]; i++) {
        lmg_fit_options wishes = {.choice = CHOICES[i], .cells = 3000, .photons = RAYS};
        lamp_bounds(LAMPS[i], &wishes.bounds_min, &wishes.bounds_max);
        lmg_ray *rays = lamp_rays(LAMPS[i], 1, 0, RAYS);
        const lmg_layout layout = trees_fitted(rays, wishes);
        lmg_field *field = trees_field_of(&layout, rays, RAYS);
        trees_grow(field, rays, RAYS, 3);
        const lmg_trees *trees = field->trees;
        print_message("%s: %u slabs, %u roots\n", lamp_name(LAMPS[i]), layout.slab_count, trees->root_count);
        if (CHOICES[i] != LMG_LAYOUT_AUTO)
            assert_int_equal(trees->root_count, CHOICES[i] == LMG_LAYOUT_CUBE ? 6 : 1);
        double held[LMG_MAX_SLABS] = {0};
        for (size_t k = 0; k < RAYS; k++) {
            float at[4];
            const int root = lmg_trees_root(trees, &layout, rays[k].origin, rays[k].direction, at);
            if (root >= 0)
                held[root] += 1.0 / RAYS;
        }
        double in_roots = 0;
        for (uint32_t j = 0; j < trees->root_count; j++)
            in_roots += held[j];
        assert_true(in_roots > 0.9);
        uint64_t leaves = 0;
        for (uint32_t k = 0; k < trees->tree_count; k++) {
            for (uint32_t j = 0; j < trees->root_count; j++) {
                assert_near(trees_light_of_root(field, k, j), lmg_field_ledger(field).stored * held[j], 1e-6 * held[j]);
            }
            leaves += trees->trees[k].leaves;
            assert_int_equal(trees->trees[k].count, 2 * trees->trees[k].leaves - trees->root_count);
        }
        const lmg_tree_totals t = lmg_field_trees(field);
        assert_true(t.leaves == leaves && t.rays == RAYS && t.memory >= leaves * sizeof(lmg_tree_node) &&
                    t.memory < lmg_field_memory(field));
        free(rays);
        lmg_field_destroy(field);
    }
}

/* Light that no slab has is no light of the trees: beside an aperture of half its width the radiance within stays what it is. */
static void test_light_beside(void **state)
{
    (void)state;
    enum { RAYS = 100000 };
    lmg_ray *rays = trees_disc_rays(3, RAYS);
    lmg_layout layout = trees_one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
    layout.slabs[0].u0 = 0;
    lmg_field *field = trees_field_of(&layout, rays, RAYS);
    const lmg_ledger l = lmg_field_ledger(field);
    assert_near(l.residual / (l.stored + l.residual), 0.5, 0.02);
    trees_grow(field, rays, RAYS, 8);
    double sum = 0;
    for (int i = 0; i < 20; i++) {
        float rgb[3];
        const lmg_vec3 from = {0.01 + 0.001 * i, 0.002 * (i - 10), 1}, along = {0, 0, 1};
        lmg_field_radiance(field, from, along, LMG_LINEAR, rgb, NULL);
        sum += lmg_luminance(rgb) / 20;
    }
    print_message("radiance %.4f of the light's own\n", sum / trees_disc_radiance());
    assert_near(sum / trees_disc_radiance(), 1, 0.1);
    free(rays);
    lmg_field_destroy(field);
}

/* Against cells that a fit has put where the light is. */
static void test_sharper_than_cells(void **state)
{
    (void)state;
    enum { RAYS = 300000 };
    lmg_ray *rays = trees_disc_rays(1, RAYS);
    const lmg_layout layout =
        trees_fitted(rays, (lmg_fit_options){.cells = 30000, .photons = RAYS, .bounds_min = TREES_LOW, .bounds_max = TREES_HIGH});
    lmg_field *field = trees_field_of(&layout, rays, RAYS);
    double inside;
    const double of_cells = trees_disc_error(field, &inside);
    trees_grow(field, rays, RAYS, 8);
    const double of_trees = trees_disc_error(field, &inside);
    print_message("RMS error of radiance: cells %.3f, 8 trees %.3f; mean inside %.4f\n", of_cells, of_trees, inside);
    assert_true(of_trees < 0.6 * of_cells);
    assert_near(inside, 1, 0.03);
    trees_grow(field, rays, RAYS, 2);
    const double of_two = trees_disc_error(field, &inside);
    print_message("2 trees %.3f\n", of_two);
    assert_true(of_trees < 0.95 * of_two);
    free(rays);
    lmg_field_destroy(field);
}

/* Rays of unequal fluxes, 0.2 and 1.8 by chance, or all alike: what is seen well inside the light has the right mean, and spreads
 * from seed to seed as the standard error says. */
static void test_standard_errors(void **state)
{
    (void)state;
    enum { SEEDS = 20, RAYS = 20000, ASKED = 100 };
    for (int unequal = 0; unequal < 2; unequal++) {
        double sum[ASKED] = {0}, squares[ASKED] = {0}, variance[ASKED] = {0};
        for (uint64_t seed = 0; seed < SEEDS; seed++) {
            lmg_ray *rays = trees_disc_rays(100 + seed, RAYS);
            for (size_t i = 0; unequal && i < RAYS; i++) {
                lamp_rng g = lamp_stream(200 + seed, i);
                const float w = lamp_next(&g) < 0.5 ? 0.2F : 1.8F;
                for (int c = 0; c < 3; c++)
                    rays[i].flux[c] = w;
            }
            const lmg_layout layout = trees_one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
            lmg_field *field = trees_field_of(&layout, rays, RAYS);
            trees_grow(field, rays, RAYS, 4);
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(98, i);
                const lmg_ray r = trees_disc_ray(&g, 0.5);
                double se;
                const double x = trees_linear(field, &r, &se) / trees_disc_radiance();
                sum[i] += x;
                squares[i] += x * x;
                variance[i] += se * se / (trees_disc_radiance() * trees_disc_radiance());
            }
            free(rays);
            lmg_field_destroy(field);
        }
        double mean = 0, ratio = 0;
        for (int i = 0; i < ASKED; i++) {
            const double m = sum[i] / SEEDS;
            mean += m / ASKED;
            ratio += (squares[i] / SEEDS - m * m) * SEEDS / (SEEDS - 1) / (variance[i] / SEEDS) / ASKED;
        }
        print_message("%s fluxes: mean %.4f, spread over standard error %.3f\n", unequal ? "unequal" : "equal", mean, sqrt(ratio));
        assert_near(mean, 1, 0.02);
        assert_true(sqrt(ratio) > 0.8 && sqrt(ratio) < 1.25);
    }
}

/* A red half of the disc and a blue one: the cells' colours, the trees' luminance; where the cells are dark, the colour of all
 * light. */
static void test_colours(void **state)
{
    (void)state;
    enum { RAYS = 20000, ASKED = 500 };
    lmg_ray *rays = trees_disc_rays(1, RAYS);
    for (size_t i = 0; i < RAYS; i++) {
        const bool red = rays[i].origin.x < 0;
        rays[i].flux[0] = red ? 2 : 0.5F;
        rays[i].flux[1] = 0.7F;
        rays[i].flux[2] = red ? 0 : 3;
    }
    const lmg_layout layout = trees_one_slab(LMG_SLAB_APERTURE, INFINITY, 3);
    lmg_field *plain = trees_field_of(&layout, rays, RAYS), *field = trees_field_of(&layout, rays, RAYS);
    trees_grow(field, rays, RAYS, 8);
    int compared = 0;
    for (uint64_t i = 0; i < ASKED; i++) {
        lamp_rng g = lamp_stream(97, i);
        const lmg_ray r = trees_disc_ray(&g, 1.1);
        float cells[3], here[3], at[4];
        lmg_field_radiance(plain, r.origin, r.direction, LMG_LINEAR, cells, NULL);
        lmg_field_radiance(field, r.origin, r.direction, LMG_LINEAR, here, NULL);
        const int root = lmg_trees_root(field->trees, &layout, r.origin, r.direction, at);
        assert_int_equal(root, 0);
        const double luminance = lmg_trees_luminance(field->trees, root, at, NULL);
        assert_near(lmg_luminance(here), luminance, 1e-5 * luminance);
        if (lmg_luminance(cells) > 0 && luminance > 0) {
            for (int c = 0; c < 3; c++)
                assert_near((double)here[c] / luminance, (double)cells[c] / lmg_luminance(cells), 1e-5);
            compared++;
        }
    }
    assert_true(compared > ASKED / 2);
    for (uint64_t k = 0; k < field->slabs[0].cells; k++)
        for (int c = 0; c < 3; c++)
            lmg_cell_radiance(&field->slabs[0], k)[c] = 0;
    assert_int_equal(lmg_field_prepare(field, NULL), LMG_OK);
    double all[3] = {0}, y = 0;
    for (size_t i = 0; i < RAYS; i++) {
        y += lmg_luminance(rays[i].flux);
        for (int c = 0; c < 3; c++)
            all[c] += (double)rays[i].flux[c];
    }
    const lmg_ray middle = {.origin = {0.01, 0, 0}, .direction = {0, 0, 1}};
    float here[3];
    lmg_field_radiance(field, middle.origin, middle.direction, LMG_LINEAR, here, NULL);
    assert_true(lmg_luminance(here) > 0);
    for (int c = 0; c < 3; c++)
        assert_near((double)here[c] / lmg_luminance(here), all[c] / y, 1e-5);
    /* what no light has, but a file might: answers are numbers still */
    for (int c = 0; c < 3; c++)
        field->trees->roots[0].colour[c] = c == 1 ? -3e38F : 3e38F;
    trees_linear(field, &middle, NULL);
    free(rays);
    lmg_field_destroy(plain);
    lmg_field_destroy(field);
}

/* ------------------------------------------------------------------------------------------------------------- the call */

static void test_asked_for(void **state)
{
    (void)state;
    enum { RAYS = 5000 };
    const lmg_layout layout = trees_one_slab(LMG_SLAB_APERTURE, INFINITY, 1), finite = trees_one_slab(LMG_SLAB_CUBE, 0.5, 1);
    lmg_ray *rays = trees_disc_rays(1, RAYS);
    lmg_field *field = trees_field_of(&layout, rays, RAYS), *plain = trees_field_of(&layout, rays, RAYS);
    lmg_error err = {{0}};
    assert_int_equal(lmg_field_grow_trees(field, rays, RAYS, LMG_MOST_TREES + 1, &err), LMG_ERROR_ARGUMENT);
    assert_non_null(strstr(err.message, "17"));
    assert_int_equal(lmg_field_grow_trees(field, NULL, 0, 8, &err), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_grow_trees(field, NULL, RAYS, 8, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_grow_trees(NULL, rays, RAYS, 8, NULL), LMG_ERROR_ARGUMENT);
    /* dark, broken, or away from the slab: none is in it */
    lmg_ray beside[3] = {rays[0], rays[1], rays[2]};
    beside[0].flux[0] = beside[0].flux[1] = beside[0].flux[2] = 0;
    beside[1].flux[1] = NAN;
    beside[2].origin.x = 7;
    assert_int_equal(lmg_field_grow_trees(field, beside, 3, 8, NULL), LMG_ERROR_ARGUMENT);
    assert_true(lmg_field_trees(field).trees == 0 && lmg_field_trees(field).memory == 0 && !field->trees);

    lmg_field *metres = trees_field_of(&finite, rays, RAYS);
    assert_int_equal(lmg_field_grow_trees(metres, rays, RAYS, 8, &err), LMG_ERROR_UNSUPPORTED);
    assert_null(metres->trees);
    lmg_field_destroy(metres);

    /* only LINEAR radiance asks them */
    trees_grow(field, rays, RAYS, LMG_MOST_TREES);
    int changed = 0;
    for (uint64_t i = 0; i < 100; i++) {
        lamp_rng g = lamp_stream(96, i);
        const lmg_ray r = trees_disc_ray(&g, 1.1);
        float a[3], b[3], ea, eb;
        lmg_field_radiance(field, r.origin, r.direction, LMG_NEAREST, a, &ea);
        lmg_field_radiance(plain, r.origin, r.direction, LMG_NEAREST, b, &eb);
        assert_memory_equal(a, b, sizeof a);
        assert_true(ea == eb);
        changed += trees_linear(field, &r, NULL) != trees_linear(plain, &r, NULL);
        double xi[5];
        for (int k = 0; k < 5; k++)
            xi[k] = lamp_next(&g);
        lmg_ray x, y;
        assert_true(lmg_field_emit(field, xi, &x) && lmg_field_emit(plain, xi, &y));
        assert_memory_equal(&x.origin, &y.origin, sizeof x.origin);
        assert_memory_equal(&x.direction, &y.direction, sizeof x.direction);
        assert_memory_equal(x.flux, y.flux, sizeof x.flux);
    }
    assert_true(changed > 50);
    double a[3], b[3], ea, eb;
    assert_int_equal(lmg_field_illuminance(field, (lmg_vec3){0, 0.02, 0.2}, (lmg_vec3){0, 0, -1}, a, &ea, NULL), LMG_OK);
    assert_int_equal(lmg_field_illuminance(plain, (lmg_vec3){0, 0.02, 0.2}, (lmg_vec3){0, 0, -1}, b, &eb, NULL), LMG_OK);
    assert_true(a[0] > 0 && memcmp(a, b, sizeof a) == 0 && ea == eb);

    /* twice the light */
    const lmg_ray middle = {.origin = {0.003, 0.001, 0}, .direction = {0, 0, 1}};
    double se, twice_se;
    const double x = trees_linear(field, &middle, &se), light = trees_light_of_root(field, 5, 0);
    assert_int_equal(lmg_field_scale(field, 2.5, NULL), LMG_OK);
    assert_near(trees_linear(field, &middle, &twice_se), 2.5 * x, 1e-6 * x);
    assert_near(twice_se, 2.5 * se, 1e-6 * se);
    assert_near(trees_light_of_root(field, 5, 0), 2.5 * light, 1e-6 * light);

    lmg_looks *looks;
    assert_int_equal(lmg_looks_create(NULL, LMG_LOOK_RADIANCE, 10, 1, &looks, &err), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_looks_create(plain, LMG_LOOK_RADIANCE, 10, 1, &looks, &err), LMG_ERROR_ARGUMENT);
    assert_non_null(strstr(err.message, "trees"));
    assert_int_equal(lmg_looks_create(field, LMG_LOOK_RADIANCE, 0, 1, &looks, NULL), LMG_ERROR_ARGUMENT);
    lmg_looks_destroy(NULL);
    assert_int_equal(lmg_looks_create(field, LMG_LOOK_RADIANCE, 10, 1, &looks, NULL), LMG_OK);
    assert_int_equal(lmg_field_refine_trees(plain, looks, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_refine_trees(NULL, looks, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_refine_trees(field, NULL, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_refine_trees(field, looks, NULL), LMG_OK); /* nothing was seen along them: the light stays */
    assert_int_equal(lmg_field_refine_trees(field, looks, NULL), LMG_ERROR_ARGUMENT); /* once */
    lmg_looks_destroy(looks);
    trees_grow(field, rays, RAYS, LMG_MOST_TREES);
    trees_refine(field, 1, 1, 1, 0);
    assert_near(trees_light_of_root(field, 5, 0), 2.5 * light, 1e-6 * light);
    assert_int_equal(lmg_looks_create(field, LMG_LOOK_RADIANCE, 10, 1, &looks, NULL), LMG_ERROR_ARGUMENT); /* refined already */

    trees_grow(field, rays, RAYS, 0);
    assert_null(field->trees);
    assert_int_equal(lmg_field_scale(field, 0.4, NULL), LMG_OK);
    assert_near(trees_linear(field, &middle, NULL), trees_linear(plain, &middle, NULL), 1e-6 * x);
    free(rays);
    lmg_field_destroy(plain);
    lmg_field_destroy(field);
}

/* The same rays, the same trees, each a function of its number however many there are; their mean doesn't ask which comes first. */
static void test_same_again(void **state)
{
    (void)state;
    lmg_field *field = trees_small_field(1, 10000, 8), *again = trees_small_field(1, 10000, 8),
              *few = trees_small_field(1, 10000, 3);
    trees_same_bytes(field->trees, again->trees);
    trees_refine(field, 5000, 5000, 3, 0); /* looks at once or in pieces */
    trees_refine(again, 5000, 77, 3, 0);
    trees_same_bytes(field->trees, again->trees);
    lmg_field_destroy(field);
    lmg_field_destroy(again);
    field = trees_small_field(1, 10000, 8);
    again = trees_small_field(1, 10000, 8);
    for (uint32_t k = 0; k < 3; k++) {
        const lmg_tree *a = &field->trees->trees[k], *b = &few->trees->trees[k];
        assert_true(a->count == b->count && a->unit[0] == b->unit[0]);
        for (uint32_t i = 0; i < a->count; i++)
            assert_true(a->nodes[i].axis == b->nodes[i].axis && a->nodes[i].cut == b->nodes[i].cut &&
                        a->nodes[i].code == b->nodes[i].code);
    }
    for (uint32_t k = 0; k < 4; k++) {
        const lmg_tree tree = again->trees->trees[k];
        again->trees->trees[k] = again->trees->trees[7 - k];
        again->trees->trees[7 - k] = tree;
    }
    for (uint64_t i = 0; i < 200; i++) {
        lamp_rng g = lamp_stream(95, i);
        const lmg_ray r = trees_disc_ray(&g, 1.1);
        double a, b;
        const double x = trees_linear(field, &r, &a);
        assert_near(trees_linear(again, &r, &b), x, 1e-6 * x);
        assert_near(a, b, 0.01 * a);
    }
    lmg_field_destroy(few);
    lmg_field_destroy(again);
    lmg_field_destroy(field);
}

/* For a file that is too small for all of them: the others stay what they are, and two at least have to. */
static void test_fewer(void **state)
{
    (void)state;
    lmg_field *field = trees_small_field(1, 20000, 8), *less = trees_small_field(1, 20000, 8);
    const lmg_tree_totals all = lmg_field_trees(field);
    assert_int_equal(lmg_field_thin_trees(field, all.bytes), 8);
    assert_int_equal(lmg_field_trees(field).bytes, all.bytes);
    const uint32_t left = lmg_field_thin_trees(less, all.bytes / 2);
    const lmg_tree_totals half = lmg_field_trees(less);
    assert_in_range(left, 3, 5);
    assert_true(half.trees == left && half.bytes <= all.bytes / 2 && half.memory < all.memory && half.leaves < all.leaves);
    for (uint32_t k = 0; k < left; k++) {
        const lmg_tree *a = &field->trees->trees[k], *b = &less->trees->trees[k];
        assert_int_equal(a->count, b->count);
        assert_memory_equal(a->nodes, b->nodes, a->count * sizeof *a->nodes);
    }
    /* as many as fit, and the next would not */
    assert_int_equal(lmg_field_thin_trees(field, half.bytes), left);
    assert_int_equal(lmg_field_thin_trees(field, half.bytes - 1), left - 1);
    lmg_field *plain = trees_small_field(1, 20000, 0);
    const lmg_ray ray = {.origin = {0, 0, 0}, .direction = {0, 0, 1}};
    assert_int_equal(lmg_field_thin_trees(less, 100), 0);
    assert_int_equal(lmg_field_trees(less).trees, 0);
    assert_true(trees_linear(less, &ray, NULL) == trees_linear(plain, &ray, NULL));
    assert_int_equal(lmg_field_thin_trees(plain, 0), 0);
    lmg_field_destroy(plain);
    lmg_field_destroy(less);
    lmg_field_destroy(field);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_light_is_kept),   cmocka_unit_test(test_light_beside), cmocka_unit_test(test_sharper_than_cells),
        cmocka_unit_test(test_standard_errors), cmocka_unit_test(test_colours),      cmocka_unit_test(test_asked_for),
        cmocka_unit_test(test_same_again),      cmocka_unit_test(test_fewer),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
