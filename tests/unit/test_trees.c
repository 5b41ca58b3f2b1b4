/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Radiance trees: they keep the light, are sharper than cells and sharper still by looks, know their noise, come back from files as
 * they were, and survive damaged bytes.  Seeds are fixed, so that a run is a fact.  The lamp is a formula: a Lambertian disc whose
 * light ends sharply at 20 degrees, so that radiance is one number within edges in all four dimensions and 0 beyond them.
 */
#include "box_fixture.h"
#include "field.h"
#include "lamp_fixture.h"
#include "trees.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

static const double RADIUS = 0.05, SINE = 0.34202014332566873; /* of 20 degrees */
static const lmg_vec3 LOW = {-0.06, -0.06, -0.02}, HIGH = {0.06, 0.06, 0};

/* Of the disc with 1 lm. */
static double disc_radiance(void)
{
    return 1 / (PI * RADIUS * RADIUS * PI * SINE * SINE);
}

/* From the disc and within the cone; both `wider` times as wide as its light: a uniform sample of etendue. */
static lmg_ray disc_ray(lamp_rng *g, double wider)
{
    double at[4];
    for (int i = 0; i < 4; i += 2) {
        const double r = wider * (i == 0 ? RADIUS : SINE) * sqrt(lamp_next(g)), f = 2 * PI * lamp_next(g);
        at[i] = r * cos(f);
        at[i + 1] = r * sin(f);
    }
    return (lmg_ray){
        .origin = {at[0], at[1], 0}, .direction = {at[2], at[3], sqrt(1 - at[2] * at[2] - at[3] * at[3])}, .flux = {1, 1, 1}};
}

static bool in_light(const lmg_ray *r)
{
    return hypot(r->origin.x, r->origin.y) < RADIUS && hypot(r->direction.x, r->direction.y) < SINE;
}

static lmg_ray *disc_rays(uint64_t seed, size_t count)
{
    lmg_ray *rays = malloc(count * sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < count; i++) {
        lamp_rng g = lamp_stream(seed, i);
        rays[i] = disc_ray(&g, 1);
        rays[i].number = i;
    }
    return rays;
}

static lmg_layout one_slab(lmg_slab_kind kind, double distance, uint32_t channels)
{
    return (lmg_layout){.slab_count = 1,
                        .slabs = {{.kind = kind,
                                   .a = {1, 0, 0},
                                   .b = {0, 1, 0},
                                   .n = {0, 0, 1},
                                   .distance = distance,
                                   .u0 = -0.06,
                                   .u1 = 0.06,
                                   .v0 = -0.06,
                                   .v1 = 0.06,
                                   .s0 = -1,
                                   .s1 = 1,
                                   .t0 = -1,
                                   .t1 = 1,
                                   .nu = 6,
                                   .nv = 6,
                                   .ns = 9,
                                   .nt = 9}},
                        .channels = channels,
                        .colour = {1, 1, 1},
                        .bounds_min = LOW,
                        .bounds_max = HIGH,
                        .size = 0.1};
}

/* The first ten thousand rays for a pilot. */
static lmg_layout fitted(const lmg_ray *rays, lmg_fit_options wishes)
{
    lmg_layout layout;
    lmg_error err = {{0}};
    wishes.struct_size = sizeof wishes;
    if (lmg_layout_fit(rays, 10000, &wishes, &layout, NULL, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return layout;
}

/* The rays' light, 1 lm of it. */
static lmg_field *field_of(const lmg_layout *layout, const lmg_ray *rays, size_t count)
{
    lmg_error err = {{0}};
    lmg_accumulator *acc;
    lmg_field *field;
    if (lmg_accumulator_create(layout, &acc, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lmg_accumulator_deposit(acc, rays, count);
    const lmg_deposit_totals t = lmg_accumulator_totals(acc);
    if (lmg_field_reconstruct(acc, 1 / (t.stored + t.residual), NULL, &field, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lmg_accumulator_destroy(acc);
    return field;
}

static void grow(lmg_field *field, const lmg_ray *rays, size_t count, uint32_t trees)
{
    lmg_error err = {{0}};
    if (lmg_field_grow_trees(field, rays, count, trees, &err) != LMG_OK)
        fail_msg("%s", err.message);
    assert_int_equal(lmg_field_trees(field).trees, trees);
}

/* What an eye sees: the disc; or with the variance of so many photons, nothing or more than there is; or only whether the disc is
 * there, from wherever it may shine. */
static float seen(const lmg_ray *ray, lmg_look_kind kind, double noise)
{
    if (kind == LMG_LOOK_OUTLINE)
        return hypot(ray->origin.x, ray->origin.y) < RADIUS ? 7 : 0;
    lamp_rng g = lamp_stream(77, ray->number);
    return in_light(ray) && lamp_next(&g) < 1 / (1 + noise) ? (float)(disc_radiance() * (1 + noise)) : 0;
}

/* Looks, drawn in pieces of so many, and trees refined by them; how much of these was misplaced. */
static double refine_by(lmg_look_kind kind, lmg_field *field, size_t count, size_t piece, uint64_t seed, double noise)
{
    lmg_error err = {{0}};
    lmg_looks *looks;
    if (lmg_looks_create(field, kind, count, seed, &looks, &err) != LMG_OK)
        fail_msg("%s", err.message);
    assert_int_equal(lmg_looks_count(looks), count);
    lmg_ray *rays = malloc(piece * sizeof *rays);
    float(*radiance)[3] = malloc(piece * sizeof *radiance);
    assert_true(rays && radiance);
    for (size_t first = 0; first < count; first += piece) {
        const size_t n = count - first < piece ? count - first : piece;
        lmg_looks_draw(looks, first, n, rays);
        for (size_t i = 0; i < n; i++) {
            assert_true(rays[i].origin.z >= 0 && rays[i].direction.z >= 0);
            /* back to the disc */
            const double k = -rays[i].origin.z / rays[i].direction.z;
            const lmg_vec3 o = rays[i].origin, d = rays[i].direction;
            rays[i].origin = (lmg_vec3){o.x + k * d.x, o.y + k * d.y, 0};
            for (int c = 0; c < 3; c++)
                radiance[i][c] = rays[i].direction.z > 0 ? seen(&rays[i], kind, noise) : 0;
        }
        lmg_looks_put(looks, first, n, (const float(*)[3])radiance);
    }
    const double misplaced = lmg_looks_misplaced(looks);
    if (lmg_field_refine_trees(field, looks, &err) != LMG_OK)
        fail_msg("%s", err.message);
    assert_int_equal(lmg_field_trees(field).looks, count);
    lmg_looks_destroy(looks);
    free(radiance);
    free(rays);
    return misplaced;
}

static void refine(lmg_field *field, size_t count, size_t piece, uint64_t seed, double noise)
{
    refine_by(LMG_LOOK_RADIANCE, field, count, piece, seed, noise);
}

/* One slab made by hand, few cells. */
static lmg_field *small_field(uint64_t seed, size_t count, uint32_t trees)
{
    const lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
    lmg_ray *rays = disc_rays(seed, count);
    lmg_field *field = field_of(&layout, rays, count);
    grow(field, rays, count, trees);
    free(rays);
    return field;
}

/* What a camera sees a little way down the ray. */
static double linear(const lmg_field *field, const lmg_ray *ray, double *se)
{
    const lmg_vec3 o = ray->origin, d = ray->direction;
    float rgb[3], error;
    lmg_field_radiance(field, (lmg_vec3){o.x + 0.1 * d.x, o.y + 0.1 * d.y, o.z + 0.1 * d.z}, d, LMG_LINEAR, rgb, &error);
    assert_true(isfinite(rgb[0]) && isfinite(rgb[1]) && isfinite(rgb[2]) && isfinite(error) && error >= 0);
    if (se)
        *se = (double)error;
    return lmg_luminance(rgb);
}

/* Steps over the nodes of a piece; the sum of its leaves' light. */
static double light_of(const lmg_tree *tree, const lmg_slab *slab, const lmg_tree_box *box, uint32_t *node)
{
    const lmg_tree_node *n = &tree->nodes[(*node)++];
    const double etendue = lmg_tree_etendue(slab, box);
    assert_true(etendue > 0);
    if (n->axis == LMG_LEAF) {
        assert_true(isfinite(n->radiance) && n->radiance >= 0);
        return (double)n->radiance * etendue;
    }
    if (n->axis == LMG_EDGE) {
        int normal[4];
        lmg_edge_normal(n->code, normal);
        assert_int_equal(lmg_edge_code(normal), n->code);
        const double first = lmg_edge_etendue(slab, box, normal, n->cut);
        assert_true(first > 0 && first < etendue && n[1].axis == LMG_LEAF && n[2].axis == LMG_LEAF);
        assert_int_equal(n->second, *node + 1);
        *node += 2;
        return first * (double)n[1].radiance + (etendue - first) * (double)n[2].radiance;
    }
    lmg_tree_box half = *box;
    half.hi[n->axis] = lmg_tree_cut(box, n->axis, n->cut);
    double sum = light_of(tree, slab, &half, node);
    assert_int_equal(n->second, *node);
    half = *box;
    half.lo[n->axis] = lmg_tree_cut(box, n->axis, n->cut);
    return sum + light_of(tree, slab, &half, node);
}

static double light_of_root(const lmg_field *field, uint32_t tree, uint32_t root)
{
    const lmg_tree_box whole = lmg_tree_whole();
    const lmg_tree *t = &field->trees->trees[tree];
    uint32_t node = t->first[root];
    const lmg_slab slab = lmg_root_slab(field->trees, &field->layout, root);
    const double light = light_of(t, &slab, &whole, &node);
    assert_int_equal(node, root + 1 < field->trees->root_count ? t->first[root + 1] : t->count);
    return light;
}

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
        const lmg_layout layout = fitted(rays, wishes);
        lmg_field *field = field_of(&layout, rays, RAYS);
        grow(field, rays, RAYS, 3);
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
                assert_near(light_of_root(field, k, j), lmg_field_ledger(field).stored * held[j], 1e-6 * held[j]);
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
    lmg_ray *rays = disc_rays(3, RAYS);
    lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
    layout.slabs[0].u0 = 0;
    lmg_field *field = field_of(&layout, rays, RAYS);
    const lmg_ledger l = lmg_field_ledger(field);
    assert_near(l.residual / (l.stored + l.residual), 0.5, 0.02);
    grow(field, rays, RAYS, 8);
    double sum = 0;
    for (int i = 0; i < 20; i++) {
        float rgb[3];
        const lmg_vec3 from = {0.01 + 0.001 * i, 0.002 * (i - 10), 1}, along = {0, 0, 1};
        lmg_field_radiance(field, from, along, LMG_LINEAR, rgb, NULL);
        sum += lmg_luminance(rgb) / 20;
    }
    print_message("radiance %.4f of the light's own\n", sum / disc_radiance());
    assert_near(sum / disc_radiance(), 1, 0.1);
    free(rays);
    lmg_field_destroy(field);
}

/* RMS over random rays around the light, in parts of the light's own radiance. */
static double disc_error(const lmg_field *field, double *inside)
{
    enum { ASKED = 4000 };
    double squares = 0, sum = 0, count = 0;
    for (uint64_t i = 0; i < ASKED; i++) {
        lamp_rng g = lamp_stream(99, i);
        const lmg_ray r = disc_ray(&g, 1.2);
        const double x = linear(field, &r, NULL) / disc_radiance(), e = x - in_light(&r);
        squares += e * e;
        if (hypot(r.origin.x, r.origin.y) < 0.7 * RADIUS && hypot(r.direction.x, r.direction.y) < 0.7 * SINE) {
            sum += x;
            count++;
        }
    }
    *inside = sum / count;
    return sqrt(squares / ASKED);
}

/* Against cells that a fit has put where the light is. */
static void test_sharper_than_cells(void **state)
{
    (void)state;
    enum { RAYS = 300000 };
    lmg_ray *rays = disc_rays(1, RAYS);
    const lmg_layout layout =
        fitted(rays, (lmg_fit_options){.cells = 30000, .photons = RAYS, .bounds_min = LOW, .bounds_max = HIGH});
    lmg_field *field = field_of(&layout, rays, RAYS);
    double inside;
    const double of_cells = disc_error(field, &inside);
    grow(field, rays, RAYS, 8);
    const double of_trees = disc_error(field, &inside);
    print_message("RMS error of radiance: cells %.3f, 8 trees %.3f; mean inside %.4f\n", of_cells, of_trees, inside);
    assert_true(of_trees < 0.6 * of_cells);
    assert_near(inside, 1, 0.03);
    grow(field, rays, RAYS, 2);
    const double of_two = disc_error(field, &inside);
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
            lmg_ray *rays = disc_rays(100 + seed, RAYS);
            for (size_t i = 0; unequal && i < RAYS; i++) {
                lamp_rng g = lamp_stream(200 + seed, i);
                const float w = lamp_next(&g) < 0.5 ? 0.2F : 1.8F;
                for (int c = 0; c < 3; c++)
                    rays[i].flux[c] = w;
            }
            const lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
            lmg_field *field = field_of(&layout, rays, RAYS);
            grow(field, rays, RAYS, 4);
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(98, i);
                const lmg_ray r = disc_ray(&g, 0.5);
                double se;
                const double x = linear(field, &r, &se) / disc_radiance();
                sum[i] += x;
                squares[i] += x * x;
                variance[i] += se * se / (disc_radiance() * disc_radiance());
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

/* An eye that sees the disc: edges, and errors far below those of photons; one that sees it with much noise does no harm.  The
 * light stays. */
static void test_looks(void **state)
{
    (void)state;
    enum { RAYS = 100000 };
    static const lmg_layout_choice CHOICES[] = {LMG_LAYOUT_APERTURE, LMG_LAYOUT_CUBE};
    lmg_ray *rays = disc_rays(1, RAYS);
    for (int c = 0; c < 2; c++) {
        const lmg_layout layout = fitted(
            rays, (lmg_fit_options){.choice = CHOICES[c], .cells = 10000, .photons = RAYS, .bounds_min = LOW, .bounds_max = HIGH});
        lmg_field *field = field_of(&layout, rays, RAYS);
        double inside, before;
        grow(field, rays, RAYS, 8);
        const double of_photons = disc_error(field, &before), light = light_of_root(field, 3, 0);
        refine(field, 300000, 7001, 5, 0);
        const double of_looks = disc_error(field, &inside);
        uint32_t edges = 0;
        for (uint32_t i = 0; i < field->trees->trees[0].count; i++)
            edges += field->trees->trees[0].nodes[i].axis == LMG_EDGE;
        print_message("%s: RMS error of radiance: photons %.3f, looks %.3f, %u edges in a tree; mean inside %.4f, %.4f\n",
                      c == 0 ? "aperture" : "cube", of_photons, of_looks, edges, before, inside);
        assert_true(of_looks < (c == 0 ? 0.5 : 0.65) * of_photons);
        assert_near(inside, 1, 0.01);
        assert_true(edges > 100);
        assert_near(light_of_root(field, 3, 0), light, 1e-6 * light);

        grow(field, rays, RAYS, 8);
        refine(field, 100000, 100000, 5, 20);
        const double of_noise = disc_error(field, &inside);
        print_message("looks with the variance of 20 photons: %.3f, mean inside %.4f\n", of_noise, inside);
        assert_true(of_noise < 1.1 * of_photons);
        assert_near(inside, before, 0.02);
        assert_near(light_of_root(field, 3, 0), light, 1e-6 * light);
        static const size_t FEW[] = {1, 100, 2000};
        for (int noisy = 0; noisy < 2; noisy++)
            for (size_t n = 0; n < 3; n++) {
                grow(field, rays, RAYS, 8);
                refine(field, FEW[n], FEW[n], 5, noisy ? 20 : 0);
                const double of_few = disc_error(field, &inside);
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
    lmg_ray *rays = disc_rays(1, RAYS);
    for (int c = 0; c < 2; c++) {
        const lmg_layout layout = fitted(
            rays, (lmg_fit_options){.choice = CHOICES[c], .cells = 10000, .photons = RAYS, .bounds_min = LOW, .bounds_max = HIGH});
        lmg_field *field = field_of(&layout, rays, RAYS);
        double inside, before, beside[2] = {0};
        grow(field, rays, RAYS, 8);
        const double of_photons = disc_error(field, &before), light = light_of_root(field, 3, 0);
        for (int k = 0; k < 2; k++) {
            /* beside the disc, within the cone */
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(92, i);
                const lmg_ray r = disc_ray(&g, 1.05);
                beside[k] += hypot(r.origin.x, r.origin.y) < RADIUS ? 0 : linear(field, &r, NULL) / disc_radiance() / ASKED;
            }
            if (k == 0) {
                const double misplaced = refine_by(LMG_LOOK_OUTLINE, field, 300000, 7001, 5, 0);
                /* disc_error is of 1.2^4 times the light's etendue */
                assert_true(misplaced > 0.3 * 1.44 * of_photons && misplaced < 1.44 * of_photons);
                grow(field, rays, RAYS, 8);
                refine_by(LMG_LOOK_OUTLINE, field, 300000, 300000, 5, 0);
            }
        }
        const double of_outlines = disc_error(field, &inside);
        print_message(
            "%s: RMS error of radiance: photons %.3f, outlines %.3f; mean inside %.4f, %.4f; beside the disc %.5f, %.5f\n",
            c == 0 ? "aperture" : "cube", of_photons, of_outlines, before, inside, beside[0], beside[1]);
        assert_true(of_outlines < 0.9 * of_photons);
        assert_true(inside > before && inside < 1.005);
        assert_true(beside[1] < 0.5 * beside[0]);
        assert_near(light_of_root(field, 3, 0), light, 1e-6 * light);

        /* too few to tell anything, and where photons are that nobody sees */
        static const size_t FEW[] = {1, 100, 2000};
        for (size_t n = 0; n < 3; n++) {
            grow(field, rays, RAYS, 8);
            refine_by(LMG_LOOK_OUTLINE, field, FEW[n], FEW[n], 5, 0);
            const double of_few = disc_error(field, &inside);
            print_message("%zu looks: %.3f\n", FEW[n], of_few);
            assert_true(of_few < 1.02 * of_photons);
            assert_near(light_of_root(field, 3, 0), light, 1e-6 * light);
        }
        lmg_field_destroy(field);
    }
    free(rays);
}

static void same_bytes(const lmg_trees *a, const lmg_trees *b);

/* Sixteen equal openings in a grid, each lit in a part of it. */
static bool in_openings(const lmg_ray *r)
{
    const double u = fmod((r->origin.x + 0.06) / 0.03, 1), v = fmod((r->origin.y + 0.06) / 0.03, 1);
    return fabs(r->origin.x) < 0.06 && fabs(r->origin.y) < 0.06 && u > 0.1 && u < 0.6 && v > 0.25 && v < 0.85 &&
           hypot(r->direction.x, r->direction.y) < SINE;
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
        rays[i] = disc_ray(&g, 1);
        const double u = 0.1 + 0.5 * lamp_next(&g), v = 0.25 + 0.6 * lamp_next(&g);
        rays[i].origin = (lmg_vec3){0.03 * ((int)(lamp_next(&g) * 4) + u) - 0.06, 0.03 * ((int)(lamp_next(&g) * 4) + v) - 0.06, 0};
        rays[i].number = i;
    }
    const double radiance = 1 / (16 * 0.03 * 0.03 * 0.5 * 0.6 * PI * SINE * SINE);
    double error[2][2];
    for (int whole = 0; whole < 2; whole++) {
        lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
        layout.slabs[0].u0 = whole ? -0.06 : -0.07;
        layout.slabs[0].v0 = whole ? -0.06 : -0.07;
        lmg_field *field = field_of(&layout, rays, RAYS);
        for (int looked = 0; looked < 2; looked++) {
            grow(field, rays, RAYS, 8);
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
                    light += light_of_root(field, k, j);
                assert_near(light, lmg_field_ledger(field).stored, 1e-6);
            }
            double squares = 0, lit = 0;
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(93, i);
                lmg_ray r = disc_ray(&g, 1.1);
                r.origin = (lmg_vec3){0.12 * lamp_next(&g) - 0.06, 0.12 * lamp_next(&g) - 0.06, 0};
                const double e = linear(field, &r, NULL) / radiance - in_openings(&r);
                squares += e * e;
                lit += in_openings(&r);
            }
            error[whole][looked] = sqrt(squares / lit);
            size_t size;
            unsigned char *bytes = lmg_trees_encode(field->trees, &size);
            lmg_trees *back;
            assert_non_null(bytes);
            assert_int_equal(lmg_trees_decode(bytes, size, &layout, &back, NULL), LMG_OK);
            same_bytes(field->trees, back);
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
    const lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
    for (int c = 0; c < 3; c++) {
        const bool border = c > 0;
        const lmg_look_kind kind = c == 2 ? LMG_LOOK_OUTLINE : LMG_LOOK_RADIANCE;
        const double noise = border ? 0 : 0.5;
        double sum[ASKED] = {0}, squares[ASKED] = {0}, variance = 0, spread = 0, mean = 0;
        for (uint64_t seed = 0; seed < SEEDS; seed++) {
            lmg_ray *rays = disc_rays(300 + seed, RAYS);
            lmg_field *field = field_of(&layout, rays, RAYS);
            grow(field, rays, RAYS, 4);
            refine_by(kind, field, LOOKS, LOOKS, 400 + seed, noise);
            for (uint64_t i = 0; i < ASKED; i++) {
                lamp_rng g = lamp_stream(91, i);
                const lmg_ray r = disc_ray(&g, border ? 1.2 : 0.5);
                double se;
                const double x = linear(field, &r, &se) / disc_radiance();
                sum[i] += x;
                squares[i] += x * x;
                variance += se * se / (disc_radiance() * disc_radiance()) / SEEDS / ASKED;
            }
            free(rays);
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

/* A red half of the disc and a blue one: the cells' colours, the trees' luminance; where the cells are dark, the colour of all
 * light. */
static void test_colours(void **state)
{
    (void)state;
    enum { RAYS = 20000, ASKED = 500 };
    lmg_ray *rays = disc_rays(1, RAYS);
    for (size_t i = 0; i < RAYS; i++) {
        const bool red = rays[i].origin.x < 0;
        rays[i].flux[0] = red ? 2 : 0.5F;
        rays[i].flux[1] = 0.7F;
        rays[i].flux[2] = red ? 0 : 3;
    }
    const lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 3);
    lmg_field *plain = field_of(&layout, rays, RAYS), *field = field_of(&layout, rays, RAYS);
    grow(field, rays, RAYS, 8);
    int compared = 0;
    for (uint64_t i = 0; i < ASKED; i++) {
        lamp_rng g = lamp_stream(97, i);
        const lmg_ray r = disc_ray(&g, 1.1);
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
    linear(field, &middle, NULL);
    free(rays);
    lmg_field_destroy(plain);
    lmg_field_destroy(field);
}

/* ------------------------------------------------------------------------------------------------------------- the call */

static void test_asked_for(void **state)
{
    (void)state;
    enum { RAYS = 5000 };
    const lmg_layout layout = one_slab(LMG_SLAB_APERTURE, INFINITY, 1), finite = one_slab(LMG_SLAB_CUBE, 0.5, 1);
    lmg_ray *rays = disc_rays(1, RAYS);
    lmg_field *field = field_of(&layout, rays, RAYS), *plain = field_of(&layout, rays, RAYS);
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

    lmg_field *metres = field_of(&finite, rays, RAYS);
    assert_int_equal(lmg_field_grow_trees(metres, rays, RAYS, 8, &err), LMG_ERROR_UNSUPPORTED);
    assert_null(metres->trees);
    lmg_field_destroy(metres);

    /* only LINEAR radiance asks them */
    grow(field, rays, RAYS, LMG_MOST_TREES);
    int changed = 0;
    for (uint64_t i = 0; i < 100; i++) {
        lamp_rng g = lamp_stream(96, i);
        const lmg_ray r = disc_ray(&g, 1.1);
        float a[3], b[3], ea, eb;
        lmg_field_radiance(field, r.origin, r.direction, LMG_NEAREST, a, &ea);
        lmg_field_radiance(plain, r.origin, r.direction, LMG_NEAREST, b, &eb);
        assert_memory_equal(a, b, sizeof a);
        assert_true(ea == eb);
        changed += linear(field, &r, NULL) != linear(plain, &r, NULL);
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
    const double x = linear(field, &middle, &se), light = light_of_root(field, 5, 0);
    assert_int_equal(lmg_field_scale(field, 2.5, NULL), LMG_OK);
    assert_near(linear(field, &middle, &twice_se), 2.5 * x, 1e-6 * x);
    assert_near(twice_se, 2.5 * se, 1e-6 * se);
    assert_near(light_of_root(field, 5, 0), 2.5 * light, 1e-6 * light);

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
    grow(field, rays, RAYS, LMG_MOST_TREES);
    refine(field, 1, 1, 1, 0);
    assert_near(light_of_root(field, 5, 0), 2.5 * light, 1e-6 * light);
    assert_int_equal(lmg_looks_create(field, LMG_LOOK_RADIANCE, 10, 1, &looks, NULL), LMG_ERROR_ARGUMENT); /* refined already */

    grow(field, rays, RAYS, 0);
    assert_null(field->trees);
    assert_int_equal(lmg_field_scale(field, 0.4, NULL), LMG_OK);
    assert_near(linear(field, &middle, NULL), linear(plain, &middle, NULL), 1e-6 * x);
    free(rays);
    lmg_field_destroy(plain);
    lmg_field_destroy(field);
}

static void same_bytes(const lmg_trees *a, const lmg_trees *b)
{
    size_t n, m;
    unsigned char *x = lmg_trees_encode(a, &n), *y = lmg_trees_encode(b, &m);
    assert_true(x && y);
    assert_int_equal(n, m);
    assert_memory_equal(x, y, n);
    free(x);
    free(y);
}

/* The same rays, the same trees, each a function of its number however many there are; their mean doesn't ask which comes first. */
static void test_same_again(void **state)
{
    (void)state;
    lmg_field *field = small_field(1, 10000, 8), *again = small_field(1, 10000, 8), *few = small_field(1, 10000, 3);
    same_bytes(field->trees, again->trees);
    refine(field, 5000, 5000, 3, 0); /* looks at once or in pieces */
    refine(again, 5000, 77, 3, 0);
    same_bytes(field->trees, again->trees);
    lmg_field_destroy(field);
    lmg_field_destroy(again);
    field = small_field(1, 10000, 8);
    again = small_field(1, 10000, 8);
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
        const lmg_ray r = disc_ray(&g, 1.1);
        double a, b;
        const double x = linear(field, &r, &a);
        assert_near(linear(again, &r, &b), x, 1e-6 * x);
        assert_near(a, b, 0.01 * a);
    }
    lmg_field_destroy(few);
    lmg_field_destroy(again);
    lmg_field_destroy(field);
}

/* ---------------------------------------------------------------------------------------------------------------- files */

static lmg_field *read_box(const char *path)
{
    lmg_error err = {{0}};
    lmg_field *field = NULL;
    if (lmg_field_read(path, &field, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return field;
}

static void check_same_trees(const lmg_field *a, const lmg_field *b)
{
    const lmg_tree_totals t = lmg_field_trees(a), u = lmg_field_trees(b);
    assert_true(t.trees == u.trees && t.leaves == u.leaves && t.rays == u.rays && t.looks == u.looks && t.memory == u.memory);
    same_bytes(a->trees, b->trees);
    for (uint64_t i = 0; i < 300; i++) {
        lamp_rng g = lamp_stream(94, i);
        const lmg_ray r = disc_ray(&g, 1.1);
        float at[4];
        double x, y;
        const int root = lmg_trees_root(a->trees, &a->layout, r.origin, r.direction, at);
        assert_true(lmg_trees_luminance(a->trees, root, at, &x) == lmg_trees_luminance(b->trees, root, at, &y) && x == y);
    }
}

static void test_files(void **state)
{
    (void)state;
    char directory[256], first[300], second[300];
    fixture_directory(directory);
    snprintf(first, sizeof first, "%s/a.box.exr", directory);
    snprintf(second, sizeof second, "%s/b.box.exr", directory);
    lmg_field *field = small_field(1, 20000, 8);
    refine(field, 20000, 20000, 1, 0);
    for (int rounded = 0; rounded < 2; rounded++) {
        lmg_error err = {{0}};
        if ((rounded ? lmg_field_write_rounded(field, first, 0.1, NULL, &err) : lmg_field_write(field, first, &err)) != LMG_OK)
            fail_msg("%s", err.message);
        lmg_field *back = read_box(first);
        check_same_trees(field, back);
        if (!rounded) {
            assert_null(fixture_difference(field, back));
            for (uint64_t i = 0; i < 300; i++) {
                lamp_rng g = lamp_stream(93, i);
                const lmg_ray r = disc_ray(&g, 1.1);
                double a, b;
                assert_true(linear(field, &r, &a) == linear(back, &r, &b) && a == b);
            }
        } else { /* as read: rounded once */
            assert_int_equal(lmg_field_write(back, first, NULL), LMG_OK);
        }
        assert_int_equal(lmg_field_write(back, second, NULL), LMG_OK);
        size_t n, m;
        unsigned char *x = fixture_load(first, &n), *y = fixture_load(second, &m);
        assert_int_equal(n, m);
        assert_memory_equal(x, y, n);
        free(x);
        free(y);
        lmg_field_destroy(back);
    }
    grow(field, NULL, 0, 0);
    assert_int_equal(lmg_field_write(field, first, NULL), LMG_OK);
    lmg_field *back = read_box(first);
    assert_int_equal(lmg_field_trees(back).trees, 0);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
    fixture_remove_directory(directory);
}

/* -------------------------------------------------------------------------------------------------------- damaged bytes */

/* docs/format.md: where things are in the bytes of a forest of one root. */
enum {
    AT_VERSION = 0,
    AT_TREES = 4,
    AT_TILINGS = 6,
    AT_LOOKS = 16,
    AT_SLAB = 24,
    AT_TILES = 28,
    AT_KINDS = 30,
    AT_KIND = 32,
    AT_COLOUR = 33,
    AT_UNIT = 45,
    AT_NODES = 53,
    HASH = 8
};

static void make_hash(unsigned char *bytes, size_t size)
{
    const uint64_t hash = lmg_hash(0xcbf29ce484222325u, bytes, size - HASH);
    for (int i = 0; i < HASH; i++)
        bytes[size - HASH + (size_t)i] = (unsigned char)(hash >> (8 * i));
}

/* Bytes of an exact length, so that a sanitizer sees what is read beyond them: refused with a line, or trees that answer with
 * numbers and are stored in the same bytes. */
static lmg_result decode(const unsigned char *bytes, size_t size, const lmg_layout *layout)
{
    unsigned char *exact = malloc(size > 0 ? size : 1);
    assert_non_null(exact);
    memcpy(exact, bytes, size);
    lmg_trees *trees = NULL;
    lmg_error err = {{0}};
    const lmg_result result = lmg_trees_decode(exact, size, layout, &trees, &err);
    if (result != LMG_OK) {
        assert_true(!trees && err.message[0] && (result == LMG_ERROR_FILE_FORMAT || result == LMG_ERROR_FILE_VERSION));
    } else {
        size_t again;
        unsigned char *encoded = lmg_trees_encode(trees, &again);
        assert_non_null(encoded);
        assert_int_equal(again, size);
        assert_memory_equal(encoded, exact, size);
        free(encoded);
        for (uint64_t i = 0; i < 20; i++) {
            lamp_rng g = lamp_stream(92, i);
            const float at[4] = {(float)lamp_next(&g), (float)lamp_next(&g), (float)lamp_next(&g),
                                 i == 0 ? 0 : (float)lamp_next(&g)};
            double variance;
            const double x = lmg_trees_luminance(trees, 0, at, &variance);
            assert_true(isfinite(x) && x >= 0 && isfinite(variance) && variance >= 0);
        }
    }
    lmg_trees_destroy(trees);
    free(exact);
    return result;
}

/* A small forest, with edges. */
static unsigned char *small_forest(lmg_layout *layout, size_t *size)
{
    lmg_field *field = small_field(3, 800, 2);
    refine(field, 500, 500, 1, 0);
    uint32_t edges = 0;
    for (uint32_t i = 0; i < field->trees->trees[1].count; i++)
        edges += field->trees->trees[1].nodes[i].axis == LMG_EDGE;
    assert_true(edges > 0);
    *layout = field->layout;
    unsigned char *bytes = lmg_trees_encode(field->trees, size);
    assert_non_null(bytes);
    assert_true(*size < 1000);
    lmg_field_destroy(field);
    return bytes;
}

static void test_cut_and_flipped(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    assert_int_equal(decode(bytes, size, &layout), LMG_OK);
    for (size_t n = 0; n < size; n++) {
        assert_int_equal(decode(bytes, n, &layout), LMG_ERROR_FILE_FORMAT);
        if (n >= HASH) { /* so that more than the hash is looked at */
            unsigned char tail[HASH];
            memcpy(tail, bytes + n - HASH, HASH);
            make_hash(bytes, n);
            assert_int_equal(decode(bytes, n, &layout), LMG_ERROR_FILE_FORMAT);
            memcpy(bytes + n - HASH, tail, HASH);
        }
    }
    size_t accepted = 0;
    for (size_t i = 0; i < 8 * size; i++) {
        bytes[i / 8] ^= (unsigned char)(1 << i % 8);
        assert_int_equal(decode(bytes, size, &layout), LMG_ERROR_FILE_FORMAT);
        if (i / 8 < size - HASH) {
            make_hash(bytes, size);
            accepted += decode(bytes, size, &layout) == LMG_OK;
        }
        bytes[i / 8] ^= (unsigned char)(1 << i % 8);
        make_hash(bytes, size);
    }
    /* a count or a cut that is another is no damage that shows */
    assert_true(accepted > size && accepted < 8 * size);
    assert_int_equal(decode(bytes, size, &layout), LMG_OK);
    free(bytes);
}

/* Puts count bytes in place, has the forest decoded, and puts back what was there. */
static lmg_result decode_with(unsigned char *bytes, size_t size, const lmg_layout *layout, size_t at, const void *value,
                              size_t count)
{
    unsigned char was[16];
    memcpy(was, bytes + at, count);
    memcpy(bytes + at, value, count);
    make_hash(bytes, size);
    const lmg_result result = decode(bytes, size, layout);
    memcpy(bytes + at, was, count);
    make_hash(bytes, size);
    return result;
}

/* A tree that is a chain of so many forks, each hanging on the first child of that above. */
static size_t make_chain(unsigned char *bytes, size_t forks)
{
    bytes[AT_TREES] = 1;
    for (size_t i = 0; i < forks; i++)
        bytes[AT_NODES + i] = (unsigned char)(0x80 | (i % 4) << 5 | 16);
    memset(bytes + AT_NODES + forks, 100, 2 * (forks + 1));
    const size_t size = AT_NODES + 3 * forks + 2 + HASH;
    make_hash(bytes, size);
    return size;
}

static void test_impossible_forests(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    bytes = realloc(bytes, size + 1);
    assert_non_null(bytes);
#define WITH(place, value) decode_with(bytes, size, &layout, place, &(value), sizeof(value))
    assert_int_equal(WITH(AT_VERSION, (uint32_t){2}), LMG_ERROR_FILE_VERSION);
    static const uint16_t COUNTS[] = {0, 1, 3, LMG_MOST_TREES + 1, 65535};
    for (int i = 0; i < 5; i++) {
        assert_int_equal(WITH(AT_TREES, COUNTS[i]), LMG_ERROR_FILE_FORMAT);
        if (COUNTS[i] != 1)
            assert_int_equal(WITH(AT_TILINGS, COUNTS[i]), LMG_ERROR_FILE_FORMAT);
    }
    assert_int_equal(WITH(AT_SLAB, (uint32_t){1}), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(WITH(AT_SLAB, (uint32_t){UINT32_MAX}), LMG_ERROR_FILE_FORMAT);
    static const uint16_t TILES[] = {0, 1, 0x0100, 0x0111, 0x1101, 0x0102};
    for (int i = 0; i < 6; i++)
        assert_int_equal(WITH(AT_TILES, TILES[i]), LMG_ERROR_FILE_FORMAT);
    static const uint16_t KINDS[] = {0, 2, LMG_MOST_KINDS + 1, 65535};
    for (int i = 0; i < 4; i++)
        assert_int_equal(WITH(AT_KINDS, KINDS[i]), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(WITH(AT_KIND, (uint8_t){1}), LMG_ERROR_FILE_FORMAT);
    static const double NUMBERS[] = {-1, NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 4; i++) {
        assert_int_equal(WITH(AT_UNIT, NUMBERS[i]), LMG_ERROR_FILE_FORMAT);
        if (i > 0)
            assert_int_equal(WITH(AT_COLOUR, (float){(float)NUMBERS[i]}), LMG_ERROR_FILE_FORMAT);
    }
    assert_int_equal(WITH(AT_UNIT, (double){1e300}), LMG_ERROR_FILE_FORMAT); /* radiance beyond any number */
    assert_int_equal(WITH(AT_UNIT, (double){0}), LMG_OK);
#undef WITH
    const lmg_layout finite = one_slab(LMG_SLAB_CUBE, 0.5, 1), slopes = one_slab(LMG_SLAB_CUBE, INFINITY, 1);
    assert_int_equal(decode(bytes, size, &finite), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(decode(bytes, size, &slopes), LMG_OK);
    /* more than there should be, within the hash */
    bytes[size - HASH] = 0;
    make_hash(bytes, size + 1);
    assert_int_equal(decode(bytes, size + 1, &layout), LMG_ERROR_FILE_FORMAT);

    /* as deep as trees may be, deeper, and with leaves that are no wider than a number's last bit */
    unsigned char chain[AT_NODES + 3 * 100000 + 2 + HASH];
    memcpy(chain, bytes, AT_NODES);
    assert_int_equal(decode(chain, make_chain(chain, LMG_TREE_DEPTH - 1), &layout), LMG_OK);
    assert_int_equal(decode(chain, make_chain(chain, LMG_TREE_DEPTH), &layout), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(decode(chain, make_chain(chain, 100000), &layout), LMG_ERROR_FILE_FORMAT);
    const size_t thin = make_chain(chain, LMG_TREE_DEPTH - 1);
    memset(chain + AT_NODES, 0x80 | 3 << 5 | 31, LMG_TREE_DEPTH - 1);
    make_hash(chain, thin);
    decode(chain, thin, &layout);
    memset(chain + AT_NODES, 0x80 | 3 << 5, LMG_TREE_DEPTH - 1);
    make_hash(chain, thin);
    decode(chain, thin, &layout);
    free(bytes);
}

/* A tree over tiles, a leaf for each kind; its size. */
static size_t make_tiled(unsigned char *bytes, uint8_t nu, uint8_t nv, uint16_t kinds, const uint8_t *kind)
{
    unsigned char *at = bytes + AT_TILES;
    bytes[AT_TREES] = 1;
    *at++ = nu;
    *at++ = nv;
    memcpy(at, &kinds, sizeof kinds);
    at += sizeof kinds;
    memcpy(at, kind, (size_t)nu * nv);
    at += (size_t)nu * nv;
    for (int i = 0; i < 3 * kinds; i++, at += sizeof(float))
        memcpy(at, &(float){1}, sizeof(float));
    for (int i = 0; i < kinds; i++, at += sizeof(double))
        memcpy(at, &(double){1}, sizeof(double));
    for (int i = 0; i < kinds; i++) {
        *at++ = 100;
        *at++ = 3;
    }
    const size_t size = (size_t)(at - bytes) + HASH;
    make_hash(bytes, size);
    return size;
}

static void test_impossible_tiles(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    bytes = realloc(bytes, size + 4096);
    assert_non_null(bytes);
    uint8_t kind[17 * 17];
    for (int i = 0; i < 17 * 17; i++)
        kind[i] = (uint8_t)(i % 16);
    static const struct {
        uint8_t nu, nv;
        uint16_t kinds;
        lmg_result result;
    } CASES[] = {
        {16, 16, 16, LMG_OK},
        {16, 1, 16, LMG_OK},
        {4, 4, 16, LMG_OK},
        {0, 1, 16, LMG_ERROR_FILE_FORMAT},
        {1, 0, 16, LMG_ERROR_FILE_FORMAT},
        {17, 1, 16, LMG_ERROR_FILE_FORMAT},
        {1, 17, 16, LMG_ERROR_FILE_FORMAT},
        {16, 16, 15, LMG_ERROR_FILE_FORMAT}, /* a kind too many in its tiles */
        {16, 16, 17, LMG_ERROR_FILE_FORMAT},
        {3, 5, 16, LMG_ERROR_FILE_FORMAT}, /* a kind without tiles */
        {16, 16, 0, LMG_ERROR_FILE_FORMAT},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        size = make_tiled(bytes, CASES[i].nu, CASES[i].nv, CASES[i].kinds, kind);
        assert_int_equal(decode(bytes, size, &layout), CASES[i].result);
    }
    free(bytes);
}

/* An edge as the only node of a root, and what is none. */
static void test_impossible_edges(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    unsigned char one[AT_NODES + 32];
    memcpy(one, bytes, AT_NODES);
    free(bytes);
    one[AT_TREES] = 1;
    static const struct {
        unsigned char nodes[12];
        size_t count;
        lmg_result result;
    } CASES[] = {
        {{1, 0x7e, 0x77, 15, 0, 100, 3}, 7, LMG_OK},
        {{1, 0x7e, 0x77, 15, 100, 3, 100, 3}, 8, LMG_OK},
        {{1, 0x77, 0x77, 15, 0, 100, 3}, 7, LMG_ERROR_FILE_FORMAT},                   /* no normal */
        {{1, 0x7f, 0x77, 15, 0, 100, 3}, 7, LMG_ERROR_FILE_FORMAT},                   /* one beyond 7 */
        {{1, 0x7e, 0x77, 31, 0, 100, 3}, 7, LMG_ERROR_FILE_FORMAT},                   /* nothing beyond it */
        {{1, 0x7e, 0x77, 15, 0x80, 0, 100, 3, 0}, 9, LMG_ERROR_FILE_FORMAT},          /* a fork below */
        {{1, 0x7e, 0x77, 15, 0, 1, 0x7e, 0x77, 15, 0, 0}, 11, LMG_ERROR_FILE_FORMAT}, /* an edge below */
        {{1, 0x7e, 0x77, 15, 0, 100}, 6, LMG_ERROR_FILE_FORMAT},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        memcpy(one + AT_NODES, CASES[i].nodes, CASES[i].count);
        make_hash(one, AT_NODES + CASES[i].count + HASH);
        assert_int_equal(decode(one, AT_NODES + CASES[i].count + HASH, &layout), CASES[i].result);
    }
    /* none without looks, which would go by boxes alone */
    memcpy(one + AT_NODES, CASES[0].nodes, CASES[0].count);
    memset(one + AT_LOOKS, 0, 8);
    make_hash(one, AT_NODES + CASES[0].count + HASH);
    assert_int_equal(decode(one, AT_NODES + CASES[0].count + HASH, &layout), LMG_ERROR_FILE_FORMAT);
}

/* Codes by themselves: luminance to half a step of 64 an octave, precision to half an octave, in order. */
static void test_codes(void **state)
{
    (void)state;
    assert_true(lmg_leaf_code(0, 1) == 0 && lmg_leaf_code(-1, 1) == 0 && lmg_leaf_code(NAN, 1) == 0 &&
                lmg_leaf_code(1e-30, 1) == 0);
    assert_true(lmg_leaf_part(0) == 0 && lmg_leaf_variance(0) == 0 && lmg_leaf_part(lmg_leaf_code(1, 1)) == 1);
    for (unsigned code = LMG_LEAF_DARKEST << 4; code <= (LMG_LEAF_BRIGHTEST << 4 | 15); code++)
        assert_int_equal(lmg_leaf_code(lmg_leaf_part((uint16_t)code), lmg_leaf_variance((uint16_t)code)), code);
    for (double x = 1; x > 4e-10; x *= 0.9991)
        assert_near(lmg_leaf_part(lmg_leaf_code(x, 0.1)), x, 0.0055 * x);
    for (double v = 3.9; v > 1.3e-4; v *= 0.97) {
        const double back = lmg_leaf_variance(lmg_leaf_code(0.5, v));
        assert_true(back / v < 1.4143 && v / back < 1.4143);
    }
    assert_true(lmg_leaf_variance(lmg_leaf_code(0.5, 1e9)) == 4); /* powers of two are exact */
    assert_true(lmg_leaf_variance(lmg_leaf_code(0.5, 0)) == 4 / 32768.0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_light_is_kept),      cmocka_unit_test(test_light_beside), cmocka_unit_test(test_sharper_than_cells),
        cmocka_unit_test(test_standard_errors),    cmocka_unit_test(test_colours),      cmocka_unit_test(test_asked_for),
        cmocka_unit_test(test_same_again),         cmocka_unit_test(test_files),        cmocka_unit_test(test_cut_and_flipped),
        cmocka_unit_test(test_impossible_forests), cmocka_unit_test(test_codes),        cmocka_unit_test(test_looks),
        cmocka_unit_test(test_looks_errors),       cmocka_unit_test(test_outlines),     cmocka_unit_test(test_tiles),
        cmocka_unit_test(test_impossible_tiles),   cmocka_unit_test(test_edges),        cmocka_unit_test(test_impossible_edges),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
