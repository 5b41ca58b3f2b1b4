/* SPDX-License-Identifier: Apache-2.0 */
/* A disc and trees of it; see the header. */
#include "trees_fixture.h"
#include "field.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

const lmg_vec3 TREES_LOW = {-0.06, -0.06, -0.02}, TREES_HIGH = {0.06, 0.06, 0};

double trees_disc_radiance(void)
{
    return 1 / (PI * TREES_RADIUS * TREES_RADIUS * PI * TREES_SINE * TREES_SINE);
}

lmg_ray trees_disc_ray(lamp_rng *g, double wider)
{
    double at[4];
    for (int i = 0; i < 4; i += 2) {
        const double r = wider * (i == 0 ? TREES_RADIUS : TREES_SINE) * sqrt(lamp_next(g)), f = 2 * PI * lamp_next(g);
        at[i] = r * cos(f);
        at[i + 1] = r * sin(f);
    }
    return (lmg_ray){
        .origin = {at[0], at[1], 0}, .direction = {at[2], at[3], sqrt(1 - at[2] * at[2] - at[3] * at[3])}, .flux = {1, 1, 1}};
}

static bool in_light(const lmg_ray *r)
{
    return hypot(r->origin.x, r->origin.y) < TREES_RADIUS && hypot(r->direction.x, r->direction.y) < TREES_SINE;
}

lmg_ray *trees_disc_rays(uint64_t seed, size_t count)
{
    lmg_ray *rays = malloc(count * sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < count; i++) {
        lamp_rng g = lamp_stream(seed, i);
        rays[i] = trees_disc_ray(&g, 1);
        rays[i].number = i;
    }
    return rays;
}

lmg_layout trees_one_slab(lmg_slab_kind kind, double distance, uint32_t channels)
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
                        .bounds_min = TREES_LOW,
                        .bounds_max = TREES_HIGH,
                        .size = 0.1};
}

lmg_layout trees_fitted(const lmg_ray *rays, lmg_fit_options wishes)
{
    lmg_layout layout;
    lmg_error err = {{0}};
    wishes.struct_size = sizeof wishes;
    if (lmg_layout_fit(rays, 10000, &wishes, &layout, NULL, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return layout;
}

lmg_field *trees_field_of(const lmg_layout *layout, const lmg_ray *rays, size_t count)
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

void trees_grow(lmg_field *field, const lmg_ray *rays, size_t count, uint32_t trees)
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
        return hypot(ray->origin.x, ray->origin.y) < TREES_RADIUS ? 7 : 0;
    lamp_rng g = lamp_stream(77, ray->number);
    return in_light(ray) && lamp_next(&g) < 1 / (1 + noise) ? (float)(trees_disc_radiance() * (1 + noise)) : 0;
}

double trees_refine_by(lmg_look_kind kind, lmg_field *field, size_t count, size_t piece, uint64_t seed, double noise)
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
            assert_true(rays[i].origin.z >= TREES_LOW.z && rays[i].direction.z >= 0);
            /* in the plane of the disc, which those that leave the bounds by a side cross beside it */
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

void trees_refine(lmg_field *field, size_t count, size_t piece, uint64_t seed, double noise)
{
    trees_refine_by(LMG_LOOK_RADIANCE, field, count, piece, seed, noise);
}

lmg_field *trees_small_field(uint64_t seed, size_t count, uint32_t trees)
{
    const lmg_layout layout = trees_one_slab(LMG_SLAB_APERTURE, INFINITY, 1);
    lmg_ray *rays = trees_disc_rays(seed, count);
    lmg_field *field = trees_field_of(&layout, rays, count);
    trees_grow(field, rays, count, trees);
    free(rays);
    return field;
}

double trees_linear(const lmg_field *field, const lmg_ray *ray, double *se)
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

double trees_light_of_root(const lmg_field *field, uint32_t tree, uint32_t root)
{
    const lmg_tree_box whole = lmg_tree_whole();
    const lmg_tree *t = &field->trees->trees[tree];
    uint32_t node = t->first[root];
    const lmg_slab slab = lmg_root_slab(field->trees, &field->layout, root);
    const double light = light_of(t, &slab, &whole, &node);
    assert_int_equal(node, root + 1 < field->trees->root_count ? t->first[root + 1] : t->count);
    return light;
}

double trees_disc_error(const lmg_field *field, double *inside)
{
    enum { ASKED = 4000 };
    double squares = 0, sum = 0, count = 0;
    for (uint64_t i = 0; i < ASKED; i++) {
        lamp_rng g = lamp_stream(99, i);
        const lmg_ray r = trees_disc_ray(&g, 1.2);
        const double x = trees_linear(field, &r, NULL) / trees_disc_radiance(), e = x - in_light(&r);
        squares += e * e;
        if (hypot(r.origin.x, r.origin.y) < 0.7 * TREES_RADIUS && hypot(r.direction.x, r.direction.y) < 0.7 * TREES_SINE) {
            sum += x;
            count++;
        }
    }
    *inside = sum / count;
    return sqrt(squares / ASKED);
}

void trees_same_bytes(const lmg_trees *a, const lmg_trees *b)
{
    size_t n, m;
    unsigned char *x = lmg_trees_encode(a, &n), *y = lmg_trees_encode(b, &m);
    assert_true(x && y);
    assert_int_equal(n, m);
    assert_memory_equal(x, y, n);
    free(x);
    free(y);
}
