/* SPDX-License-Identifier: Apache-2.0 */
/* Alignment: known motions are found within their standard errors, symmetric and equal sources stay where they are, and rays from
 * a point have it as their focus. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "align.h"
#include "compare.h"

#include <luminaires/rng.h>

#include <math.h>

static const double PI = 3.14159265358979323846;

/* A made-up lamp: light from a point at `point`, and from a second one 20 mm beside it; shape 0: to all sides alike, 1: round about
 * -y, 2: lopsided.  Turned and moved by `motion`. */
typedef struct lamp {
    bake_source source;
    lmg_vec3 point;
    int shape;
    uint64_t seed;
    bake_motion motion;
} lamp;

/* Relative intensity, at most 1, in the lamp's own frame. */
static double intensity(int shape, lmg_vec3 d)
{
    switch (shape) {
    case 0:
        return 1;
    case 1:
        return d.y < 0 ? d.y * d.y : 0.1;
    default:
        return fmin(1, fmax(0, -d.y) * (0.5 + 0.45 * d.x) + (d.z > 0 ? 0.3 * d.z * d.z : 0));
    }
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks, size_t sink_count,
                      bake_tally *tally, lmg_error *err)
{
    const lamp *l = (const lamp *)source;
    (void)threads;
    (void)err;
    for (uint64_t i = 0; i < count; ++i) {
        lum_rng rng = lum_rng_stream(l->seed, first + i);
        lmg_vec3 d;
        do {
            const double z = 2 * lum_rng_next(&rng) - 1, phi = 2 * PI * lum_rng_next(&rng), s = sqrt(1 - z * z);
            d = (lmg_vec3){s * cos(phi), s * sin(phi), z};
        } while (lum_rng_next(&rng) >= intensity(l->shape, d));
        lmg_vec3 o = l->point;
        if (l->shape == 2 && lum_rng_next(&rng) < 0.3)
            o.x += 0.02;
        const lmg_ray ray = {.origin = bake_motion_point(&l->motion, o),
                             .direction = bake_motion_direction(&l->motion, d),
                             .flux = {1, 1, 1},
                             .number = first + i};
        for (size_t s = 0; s < sink_count; ++s)
            sinks[s].consume(sinks[s].self, &ray, 1);
    }
    tally->photons += count;
    return LMG_OK;
}

static lamp make(int shape, uint64_t seed, lmg_vec3 point)
{
    return (lamp){.source = {.run = run, .flux = 100, .bounds_min = {-0.1, -0.1, -0.1}, .bounds_max = {0.1, 0.1, 0.1}},
                  .point = point,
                  .shape = shape,
                  .seed = seed,
                  .motion = {.rotation = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}};
}

enum { RAYS = 400000 };

static void test_equal_sources_stay(void **state)
{
    (void)state;
    for (int shape = 0; shape < 3; ++shape) {
        lamp a = make(shape, 1, (lmg_vec3){0.01, -0.02, 0.03}), b = make(shape, 2, (lmg_vec3){0.01, -0.02, 0.03});
        bake_alignment r;
        assert_int_equal(bake_align(&a.source, &b.source, RAYS, 1, &r, NULL), LMG_OK);
        print_message("shape %d: shift %.3g %.3g %.3g +- %.3g %.3g %.3g, angle %.3g +- %.3g, turns %u\n", shape, r.motion.shift.x, r.motion.shift.y, r.motion.shift.z, r.shift_se.x, r.shift_se.y, r.shift_se.z, r.angle, r.angle_se, r.turns);
        assert_true(bake_motion_is_identity(&r.motion));
        assert_int_equal(r.turns, shape == 0 ? 0 : shape == 1 ? 2 : 3);
    }
}

/* Rays from one point: no spread at all, so the focus is exact but for the fixed point of the sums (2^-28 of the lamp's size, a ray). */
static void test_focus_of_a_point(void **state)
{
    (void)state;
    lamp a = make(1, 1, (lmg_vec3){0.012, -0.034, 0.056}), b = make(1, 2, (lmg_vec3){0, 0, 0});
    bake_alignment r;
    assert_int_equal(bake_align(&a.source, &b.source, RAYS, 1, &r, NULL), LMG_OK);
    const double focus[3] = {r.focus[0].point.x - 0.012, r.focus[0].point.y + 0.034, r.focus[0].point.z - 0.056};
    const double shift[3] = {r.motion.shift.x + 0.012, r.motion.shift.y - 0.034, r.motion.shift.z + 0.056};
    for (int k = 0; k < 3; ++k) {
        assert_true(fabs(focus[k]) < 1e-8);
        assert_true(fabs(shift[k]) < 1e-8);
    }
    assert_int_equal(r.turns, 2);
}

/* A lopsided lamp turned by 25 degrees about an odd axis, and by 130 degrees, and moved. */
static void test_known_motion(void **state)
{
    (void)state;
    const double degrees[2] = {25, 130};
    for (int i = 0; i < 2; ++i) {
        const double angle = degrees[i] * PI / 180, c = cos(angle), s = sin(angle);
        const double x = 0.48, y = 0.6, z = 0.64;
        lamp a = make(2, 3, (lmg_vec3){0, 0, 0}), b = make(2, 4, (lmg_vec3){0, 0, 0});
        b.motion = (bake_motion){.rotation = {{c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s},
                                              {x * y * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s},
                                              {x * z * (1 - c) - y * s, y * z * (1 - c) + x * s, c + z * z * (1 - c)}},
                                 .shift = {0.005, -0.003, 0.011}};
        bake_alignment r;
        assert_int_equal(bake_align(&a.source, &b.source, RAYS, 1, &r, NULL), LMG_OK);
        assert_int_equal(r.turns, 3);
        /* The angle between found and true rotation: within four of its standard errors, and those small. */
        double trace = 0;
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k)
                trace += r.motion.rotation[j][k] * b.motion.rotation[j][k];
        const double off = acos(fmin(1, 0.5 * (trace - 1)));
        print_message("turned by %g degrees: found %.3f +- %.3f, off by %.3f\n", degrees[i], r.angle * 180 / PI, r.angle_se * 180 / PI,
                      off * 180 / PI);
        assert_true(off < 4 * r.angle_se);
        assert_true(r.angle_se < PI / 180);
        const double t[3] = {r.motion.shift.x - 0.005, r.motion.shift.y + 0.003, r.motion.shift.z - 0.011};
        const double se[3] = {r.shift_se.x, r.shift_se.y, r.shift_se.z};
        /* The second point is 20 mm off, so a wrong turn by its standard error shifts the rest by that share of 6 mm (its weight). */
        for (int k = 0; k < 3; ++k)
            assert_true(fabs(t[k]) < 4 * hypot(se[k], 0.02 * r.angle_se));
    }
}

/* The comparison moves A onto B when that makes them more alike, says how unlike they were before, and finds no difference after. */
static void test_comparison_aligns(void **state)
{
    (void)state;
    const double c = cos(0.4), s = sin(0.4);
    lamp a = make(2, 5, (lmg_vec3){0, 0, 0}), b = make(2, 6, (lmg_vec3){0, 0, 0});
    b.motion = (bake_motion){.rotation = {{c, 0, s}, {0, 1, 0}, {-s, 0, c}}, .shift = {0.02, -0.03, 0.01}};
    const bake_compare_options options = {.photons = 800000, .threads = 1, .size = 0.3, .distance_count = 2, .distances = {0.5, 2}, .align = true};
    bake_comparison r;
    assert_int_equal(bake_compare(&a.source, &b.source, &options, &r, NULL), LMG_OK);
    assert_true(r.moved);
    assert_true(fabs(r.alignment.angle - 0.4) < 4 * r.alignment.angle_se);
    for (size_t i = 0; i < 2; ++i) {
        print_message("%g sizes: %.4f before, %.4f +- %.4f after\n", r.planes[i].sizes, r.planes[i].unmoved.rms, r.planes[i].difference.rms,
                      r.planes[i].difference.standard_error);
        assert_true(r.planes[i].unmoved.rms > 0.05);
        /* What is left is the error of the alignment itself: half a degree. */
        assert_true(r.planes[i].difference.rms < 0.2 * r.planes[i].unmoved.rms);
    }
    bake_comparison_release(&r);

    /* Left where it is when not asked for. */
    bake_compare_options still = options;
    still.align = false;
    assert_int_equal(bake_compare(&a.source, &b.source, &still, &r, NULL), LMG_OK);
    assert_true(!r.moved);
    assert_true(r.planes[0].difference.rms > 0.05);
    bake_comparison_release(&r);

    /* Equal lamps: no measure differs by more than chance; each is beyond three standard errors once in 370 times (with eight blocks in 60),
     * there are some fifty, so five are too many. */
    b.motion = (bake_motion){.rotation = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    assert_int_equal(bake_compare(&a.source, &b.source, &options, &r, NULL), LMG_OK);
    assert_true(!r.moved);
    int different = 0;
    for (size_t i = 0; i < r.measure_count; ++i)
        different += bake_measure_differs(&r.measures[i]);
    print_message("%d of %zu measures differ\n", different, r.measure_count);
    assert_true(r.measure_count > 40 && different < 5);
    /* Light from two points 20 mm apart (size 0.3 m) follows the far field to 5 % from two sizes on in every ring that is lit. */
    for (uint32_t i = 0; i < r.rings; ++i)
        if (!isnan(r.valid_from[1][1][i]))
            assert_true(r.valid_from[1][1][i] < 7);
    bake_comparison_release(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_equal_sources_stay), cmocka_unit_test(test_focus_of_a_point),
                                       cmocka_unit_test(test_known_motion), cmocka_unit_test(test_comparison_aligns)};
    return cmocka_run_group_tests_name("align", tests, NULL, NULL);
}
