/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Radiance trees and what looks into the lamp tell them: sharper still than photons alone, where openings repeat themselves too,
 * with the light and the noise that there are.
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

#include <cmocka.h>

#define PI 3.14159265358979323846

/* The disc's light in a layout of this kind, with 8 trees. */
static lmg_field *grown(lmg_layout_choice choice, const lmg_ray *rays, size_t count)
{
    const lmg_layout layout = trees_fitted(
        rays,
        (lmg_fit_options){.choice = choice, .cells = 10000, .photons = count, .bounds_min = TREES_LOW, .bounds_max = TREES_HIGH});
    lmg_field *field = trees_field_of(&layout, rays, count);
    trees_grow(field, rays, count, 8);
    return field;
}

/* An eye that sees the disc: edges, and errors far below those of photons; one that sees it with much noise does no harm.  The
 * light stays. */
static void test_looks(void **state)
{
    (void)state;
    enum { RAYS = 100000 };
    static const lmg_layout_choice CHOICES[] = {LMG_LAYOUT_APERTURE, LMG_LAYOUT_CUBE};
    lmg_ray *rays = trees_disc_rays(1, RAYS);
    for (int c = 0; c < 2; c++) {
        lmg_field *field = grown(CHOICES[c], rays, RAYS);
        double inside, before;
        const double of_photons = trees_disc_error(field, &before), light = trees_light_of_root(field, 3, 0);
        trees_refine(field, 300000, 7001, 5, 0);
        const double of_looks = trees_disc_error(field, &inside);
        uint32_t edges = 0;
        for (uint32_t i = 0; i < field->trees->trees[0].count; i++)
            edges += field->trees->trees[0].nodes[i].axis == LMG_EDGE;
        print_message("%s: RMS error of radiance: photons %.3f, looks %.3f, %u edges in a tree; mean inside %.4f, %.4f\n",
                      c == 0 ? "aperture" : "cube", of_photons, of_looks, edges, before, inside);
        assert_true(of_looks < (c == 0 ? 0.5 : 0.65) * of_photons);
        assert_near(inside, 1, 0.01);
        assert_true(edges > 100);
        assert_near(trees_light_of_root(field, 3, 0), light, 1e-6 * light);

        trees_grow(field, rays, RAYS, 8);
        trees_refine(field, 100000, 100000, 5, 20);
        const double of_noise = trees_disc_error(field, &inside);
        print_message("looks with the variance of 20 photons: %.3f, mean inside %.4f\n", of_noise, inside);
        assert_true(of_noise < 1.1 * of_photons);
        assert_near(inside, before, 0.02);
        assert_near(trees_light_of_root(field, 3, 0), light, 1e-6 * light);
        static const size_t FEW[] = {1, 100, 2000};
        for (int noisy = 0; noisy < 2; noisy++)
            for (size_t n = 0; n < 3; n++) {
                trees_grow(field, rays, RAYS, 8);
                trees_refine(field, FEW[n], FEW[n], 5, noisy ? 20 : 0);
                const double of_few = trees_disc_error(field, &inside);
                print_message("%zu looks%s: %.3f\n", FEW[n], noisy ? " with noise" : "", of_few);
                assert_true(of_few < 1.05 * of_photons);
            }
        lmg_field_destroy(field);
    }
    free(rays);
}

/* An eye that sees only where the disc is: little is left beside it, and on it is all the light that there was, within its cone as
 * far as photons told that. */
static void test_outlines(void **state)
{
    (void)state;
    enum { RAYS = 100000, ASKED = 20000 };
    static const lmg_layout_choice CHOICES[] = {LMG_LAYOUT_APERTURE, LMG_LAYOUT_CUBE};
    lmg_ray *rays = trees_disc_rays(1, RAYS);
    for (int c = 0; c < 2; c++) {
        lmg_field *field = grown(CHOICES[c], rays, RAYS);
        double inside, before, beside[2] = {0};
        const double of_photons = trees_disc_error(field, &before), light = trees_light_of_root(field, 3, 0);
        for (int k = 0; k < 2; k++) {
            /* beside the disc, within the cone */
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(92, i);
                const lmg_ray r = trees_disc_ray(&g, 1.05);
                beside[k] += hypot(r.origin.x, r.origin.y) < TREES_RADIUS
                                 ? 0
                                 : trees_linear(field, &r, NULL) / trees_disc_radiance() / ASKED;
            }
            if (k == 0) {
                const double misplaced = trees_refine_by(LMG_LOOK_OUTLINE, field, 300000, 7001, 5, 0);
                /* trees_disc_error is of 1.2^4 times the light's etendue */
                assert_true(misplaced > 0.3 * 1.44 * of_photons && misplaced < 1.44 * of_photons);
                trees_grow(field, rays, RAYS, 8);
                trees_refine_by(LMG_LOOK_OUTLINE, field, 300000, 300000, 5, 0);
            }
        }
        const double of_outlines = trees_disc_error(field, &inside);
        print_message(
            "%s: RMS error of radiance: photons %.3f, outlines %.3f; mean inside %.4f, %.4f; beside the disc %.5f, %.5f\n",
            c == 0 ? "aperture" : "cube", of_photons, of_outlines, before, inside, beside[0], beside[1]);
        assert_true(of_outlines < 0.9 * of_photons);
        assert_true(inside > before && inside < 1.005);
        assert_true(beside[1] < 0.5 * beside[0]);
        assert_near(trees_light_of_root(field, 3, 0), light, 1e-6 * light);

        /* too few to tell anything, and where photons are that nobody sees */
        static const size_t FEW[] = {1, 100, 2000};
        for (size_t n = 0; n < 3; n++) {
            trees_grow(field, rays, RAYS, 8);
            trees_refine_by(LMG_LOOK_OUTLINE, field, FEW[n], FEW[n], 5, 0);
            const double of_few = trees_disc_error(field, &inside);
            print_message("%zu looks: %.3f\n", FEW[n], of_few);
            assert_true(of_few < 1.02 * of_photons);
            assert_near(trees_light_of_root(field, 3, 0), light, 1e-6 * light);
        }
        lmg_field_destroy(field);
    }
    free(rays);
}

/* Half of the disc has an eighth of the other's luminance. */
static double shade_of(const lmg_ray *r)
{
    const bool lit = hypot(r->origin.x, r->origin.y) < TREES_RADIUS && hypot(r->direction.x, r->direction.y) < TREES_SINE;
    return !lit ? 0 : r->origin.x + 0.6 * r->origin.y < 0 ? 1 : 0.125;
}

/* RMS error of radiance, in parts of the brighter half's. */
static double shade_error(const lmg_field *field)
{
    enum { ASKED = 20000 };
    const double bright = trees_disc_radiance() / (0.5 + 0.5 * 0.125);
    double sum = 0;
    for (uint64_t i = 0; i < ASKED; i++) {
        lamp_rng g = lamp_stream(95, i);
        const lmg_ray r = trees_disc_ray(&g, 1.2);
        const double e = trees_linear(field, &r, NULL) / bright - shade_of(&r);
        sum += e * e;
    }
    return sqrt(sum / ASKED);
}

/* Outlines that know how bright a surface is find the edges between surfaces, too, and what is expected wrongly is told. */
static void test_shades(void **state)
{
    (void)state;
    enum { RAYS = 100000, LOOKS = 300000 };
    lmg_ray *rays = malloc(RAYS * sizeof *rays), *drawn = malloc(LOOKS * sizeof *drawn);
    float(*expected)[3] = malloc(LOOKS * sizeof *expected);
    assert_true(rays && drawn && expected);
    uint64_t number = 0;
    for (size_t i = 0; i < RAYS; number++) {
        lamp_rng g = lamp_stream(8, number);
        rays[i] = trees_disc_ray(&g, 1);
        i += lamp_next(&g) < shade_of(&rays[i]);
    }
    static const lmg_layout_choice CHOICES[] = {LMG_LAYOUT_APERTURE, LMG_LAYOUT_CUBE};
    for (int c = 0; c < 2; c++) {
        lmg_field *field = grown(CHOICES[c], rays, RAYS);
        double errors[3], unexpected[4];
        for (int what = 0; what < 4; what++) { /* photons alone, outlines, shades; shades the wrong way round */
            trees_grow(field, rays, RAYS, 8);
            const double light = trees_light_of_root(field, 2, 0);
            lmg_looks *looks;
            if (what > 0) {
                assert_int_equal(lmg_looks_create(field, LMG_LOOK_OUTLINE, LOOKS, 3, &looks, NULL), LMG_OK);
                lmg_looks_draw(looks, 0, LOOKS, drawn);
                for (size_t i = 0; i < LOOKS; i++) {
                    const double shade = shade_of(&drawn[i]);
                    expected[i][0] = expected[i][1] = expected[i][2] = (float)(what == 1                 ? shade > 0
                                                                               : what == 2 || shade == 0 ? shade
                                                                                                         : 1.125 - shade);
                }
                lmg_looks_put(looks, 0, LOOKS, (const float(*)[3])expected);
                unexpected[what] = lmg_looks_unexpected(looks);
                assert_int_equal(lmg_field_refine_trees(field, looks, NULL), LMG_OK);
                lmg_looks_destroy(looks);
            }
            if (what < 3)
                errors[what] = shade_error(field);
            assert_near(trees_light_of_root(field, 2, 0), light, 1e-6 * light);
        }
        print_message("%s: photons %.3f, outlines %.3f, shades %.3f; unexpected %.3f, %.3f, %.3f\n", c == 0 ? "aperture" : "cube",
                      errors[0], errors[1], errors[2], unexpected[1], unexpected[2], unexpected[3]);
        assert_true(errors[1] < 0.67 * errors[0]); /* with light that isn't pooled 0.7 */
        assert_true(errors[2] < 0.88 * errors[1]);
        /* by the angle between two functions: of shades 1 and 1/8 with an even one, and with themselves the other way round */
        assert_near(unexpected[1], sqrt(1 - 1.125 * 1.125 / (2 * (1 + 0.125 * 0.125))), 0.05);
        assert_near(unexpected[3], sqrt(1 - pow(0.25 / (1 + 0.125 * 0.125), 2)), 0.05);
        assert_true(unexpected[2] < 0.25); /* but for the trees' own errors, which are of photons alone */
        lmg_field_destroy(field);
    }
    free(rays);
    free(drawn);
    free(expected);
}

/* Sixteen equal openings in a grid, each lit in a part of it. */
static bool in_openings(const lmg_ray *r)
{
    const double u = fmod((r->origin.x + 0.06) / 0.03, 1), v = fmod((r->origin.y + 0.06) / 0.03, 1);
    return fabs(r->origin.x) < 0.06 && fabs(r->origin.y) < 0.06 && u > 0.1 && u < 0.6 && v > 0.25 && v < 0.85 &&
           hypot(r->direction.x, r->direction.y) < TREES_SINE;
}

/* Openings repeat themselves: rays shared by all of them tell more of each; where the slab isn't a whole number of them they don't.
 */
static void test_tiles(void **state)
{
    (void)state;
    enum { RAYS = 200000, ASKED = 20000, LOOKS = 100000 };
    lmg_ray *rays = malloc(RAYS * sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < RAYS; i++) {
        lamp_rng g = lamp_stream(7, i);
        rays[i] = trees_disc_ray(&g, 1);
        const double u = 0.1 + 0.5 * lamp_next(&g), v = 0.25 + 0.6 * lamp_next(&g);
        rays[i].origin = (lmg_vec3){0.03 * ((int)(lamp_next(&g) * 4) + u) - 0.06, 0.03 * ((int)(lamp_next(&g) * 4) + v) - 0.06, 0};
        rays[i].number = i;
    }
    const double radiance = 1 / (16 * 0.03 * 0.03 * 0.5 * 0.6 * PI * TREES_SINE * TREES_SINE);
    double error[2][2];
    for (int whole = 0; whole < 2; whole++) {
        lmg_layout layout = trees_one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
        layout.slabs[0].u0 = whole ? -0.06 : -0.07;
        layout.slabs[0].v0 = whole ? -0.06 : -0.07;
        lmg_field *field = trees_field_of(&layout, rays, RAYS);
        for (int looked = 0; looked < 2; looked++) {
            trees_grow(field, rays, RAYS, 8);
            const lmg_tree_totals t = lmg_field_trees(field);
            assert_true(whole ? t.tiles >= 16 && t.kinds < t.tiles / 4 : t.tiles == 0);
            if (looked) {
                lmg_error err = {{0}};
                lmg_looks *looks;
                lmg_ray *drawn = malloc(LOOKS * sizeof *drawn);
                float(*seen_there)[3] = malloc(LOOKS * sizeof *seen_there);
                assert_true(drawn && seen_there);
                assert_int_equal(lmg_looks_create(field, LMG_LOOK_RADIANCE, LOOKS, 3, &looks, &err), LMG_OK);
                lmg_looks_draw(looks, 0, LOOKS, drawn);
                for (size_t i = 0; i < LOOKS; i++)
                    for (int c = 0; c < 3; c++)
                        seen_there[i][c] = in_openings(&drawn[i]) ? (float)radiance : 0;
                lmg_looks_put(looks, 0, LOOKS, (const float(*)[3])seen_there);
                assert_int_equal(lmg_field_refine_trees(field, looks, &err), LMG_OK);
                assert_int_equal(lmg_field_trees(field).tiles, t.tiles);
                lmg_looks_destroy(looks);
                free(seen_there);
                free(drawn);
            }
            for (uint32_t k = 0; k < 8; k++) {
                double light = 0;
                for (uint32_t j = 0; j < field->trees->root_count; j++)
                    light += trees_light_of_root(field, k, j);
                assert_near(light, lmg_field_ledger(field).stored, 1e-6);
            }
            double squares = 0, lit = 0;
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(93, i);
                lmg_ray r = trees_disc_ray(&g, 1.1);
                r.origin = (lmg_vec3){0.12 * lamp_next(&g) - 0.06, 0.12 * lamp_next(&g) - 0.06, 0};
                const double e = trees_linear(field, &r, NULL) / radiance - in_openings(&r);
                squares += e * e;
                lit += in_openings(&r);
            }
            error[whole][looked] = sqrt(squares / lit);
            size_t size;
            unsigned char *bytes = lmg_trees_encode(field->trees, &size);
            lmg_trees *back;
            assert_non_null(bytes);
            assert_int_equal(lmg_trees_decode(bytes, size, &layout, &back, NULL), LMG_OK);
            trees_same_bytes(field->trees, back);
            lmg_trees_destroy(back);
            free(bytes);
        }
        lmg_field_destroy(field);
    }
    print_message("RMS error of radiance: each for itself %.3f, with looks %.3f; tiles %.3f, %.3f\n", error[0][0], error[0][1],
                  error[1][0], error[1][1]);
    assert_true(error[1][0] < 0.6 * error[0][0] && error[1][1] < 0.6 * error[0][1]);
    free(rays);
}

/* What looks tell spreads from seed to seed as it says: where all see the same, where an edge runs, and where outlines are all. */
static void test_looks_errors(void **state)
{
    (void)state;
    enum { SEEDS = 20, RAYS = 10000, LOOKS = 20000, ASKED = 200 };
    for (int c = 0; c < 3; c++) {
        const bool border = c > 0;
        const lmg_look_kind kind = c == 2 ? LMG_LOOK_OUTLINE : LMG_LOOK_RADIANCE;
        const double noise = border ? 0 : 0.5;
        double sum[ASKED] = {0}, squares[ASKED] = {0}, variance = 0, spread = 0, mean = 0;
        for (uint64_t seed = 0; seed < SEEDS; seed++) {
            lmg_field *field = trees_small_field(300 + seed, RAYS, 4);
            trees_refine_by(kind, field, LOOKS, LOOKS, 400 + seed, noise);
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(91, i);
                const lmg_ray r = trees_disc_ray(&g, border ? 1.2 : 0.5);
                double se;
                const double x = trees_linear(field, &r, &se) / trees_disc_radiance();
                sum[i] += x;
                squares[i] += x * x;
                variance += se * se / (trees_disc_radiance() * trees_disc_radiance()) / SEEDS / ASKED;
            }
            lmg_field_destroy(field);
        }
        for (int i = 0; i < ASKED; i++) {
            mean += sum[i] / SEEDS / ASKED;
            spread += (squares[i] - sum[i] * sum[i] / SEEDS) / (SEEDS - 1) / ASKED;
        }
        print_message("%s: mean %.4f, spread %.3f, standard error %.3f\n",
                      c == 0   ? "inside, noisy looks"
                      : c == 1 ? "all over"
                               : "outlines",
                      mean, sqrt(spread), sqrt(variance));
        assert_true(spread > 0.64 * variance && spread < 1.57 * variance);
        assert_near(mean, border ? 1 / (1.2 * 1.2 * 1.2 * 1.2) : 1, 0.03);
    }
}

/* Etendue on one side of an edge, against counting; the inside of an edge's first side is around a corner.  The box of the cube
 * slab spans a quarter of its directions, more than a leaf with an edge does. */
static void test_edges(void **state)
{
    (void)state;
    enum { POINTS = 20000 };
    const lmg_slab aperture = {.kind = LMG_SLAB_APERTURE, .distance = INFINITY, .u1 = 2, .v1 = 1, .s1 = 1, .t1 = 1};
    const lmg_slab cube = {.kind = LMG_SLAB_CUBE, .distance = INFINITY, .u1 = 2, .v1 = 1, .s0 = -1, .t0 = -1, .s1 = 1, .t1 = 1};
    for (uint64_t trial = 0; trial < 400; trial++) {
        lamp_rng g = lamp_stream(90, trial);
        const lmg_slab *slab = trial % 2 == 0 ? &aperture : &cube;
        int normal[4] = {0}, some = 0;
        for (int k = 0; k < 4; k++)
            some += abs(normal[k] = trial % 7 == 0 && k > (int)(trial % 3) ? 0 : (int)(lamp_next(&g) * 15) - 7);
        if (some == 0)
            continue;
        const unsigned cut = (unsigned)(lamp_next(&g) * (LMG_EDGE_CUTS - 1));
        const lmg_tree_node edge = {.axis = LMG_EDGE, .cut = (uint8_t)cut, .code = lmg_edge_code(normal)};
        const lmg_tree_box box = {{0.25, 0.5, 0.5, 0}, {0.5, 0.75, 1, 0.5}};
        double below = 0, all = 0, squares = 0;
        for (int i = 0; i < POINTS; i++) {
            float at[4];
            for (int k = 0; k < 4; k++)
                at[k] = (float)(box.lo[k] + (box.hi[k] - box.lo[k]) * lamp_next(&g));
            const double s = 2 * (double)at[2] - 1, t = 2 * (double)at[3] - 1;
            const double weight = slab == &cube ? 1 / ((1 + s * s + t * t) * (1 + s * s + t * t)) : 1;
            below += lmg_edge_below(&edge, &box, at) ? weight : 0;
            all += weight;
            squares += weight * weight;
        }
        const double whole = lmg_tree_etendue(slab, &box), share = lmg_edge_etendue(slab, &box, normal, cut) / whole;
        /* standard errors of counting: 400 trials keep to 4.7 of them with a chance of 0.999 */
        assert_near(below / all, share, 4.7 * sqrt(share * (1 - share) * squares) / all);
        assert_true(cut == 0 || share * whole > lmg_edge_etendue(slab, &box, normal, cut - 1));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_looks), cmocka_unit_test(test_outlines),     cmocka_unit_test(test_shades),
        cmocka_unit_test(test_tiles), cmocka_unit_test(test_looks_errors), cmocka_unit_test(test_edges),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
