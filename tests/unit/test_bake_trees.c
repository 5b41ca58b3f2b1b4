/* SPDX-License-Identifier: Apache-2.0 */
/* Which bakes have radiance trees, and how much of their time and of their file these are given: by rule, nothing is traced. */
#include "bake_trees.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static void test_wanted(void **state)
{
    (void)state;
    bake_options o = {.trees = BAKE_TREES_AUTO};
    assert_int_equal(bake_trees_wanted(&o, 19.9), 0);
    assert_int_equal(bake_trees_wanted(&o, 20), BAKE_TREES);
    o.looks_chosen = true; /* of photons alone */
    assert_int_equal(bake_trees_wanted(&o, 1), 0);
    o.looks = 1;
    assert_int_equal(bake_trees_wanted(&o, 1), BAKE_TREES);
    o.looks_chosen = false;
    o.photons = 99999999; /* the time is of no account then */
    assert_int_equal(bake_trees_wanted(&o, 60), 0);
    o.photons = 100000000;
    assert_int_equal(bake_trees_wanted(&o, 60), BAKE_TREES);
    o.trees = 0;
    assert_int_equal(bake_trees_wanted(&o, 60), 0);
    o.photons = 1000;
    o.trees = 5;
    assert_int_equal(bake_trees_wanted(&o, 1), 5);
    bake_options plain = {.seconds = 60};
    assert_int_equal(bake_trees_wanted(&plain, 60), 0);
}

/* A pilot of 100,000 photons in a twentieth of a second, where eyes see outlines only. */
static void test_time(void **state)
{
    (void)state;
    for (int resumed = 0; resumed < 2; resumed++)
        for (int kind = 0; kind < 2; kind++) {
            bake_options o = {.trees = 8, .threads = 2};
            bake_report r = {.pilot_seconds = resumed ? 0 : 0.05, .resumed = resumed};
            bake_part part = {.pilot_photons = 100000, .seconds = resumed ? 10 : 0, .tally.photons = resumed ? 20000000 : 0};
            bake_trees t = {.options = &o, .report = &r, .part = &part, .count = 8, .kind = kind ? LMG_LOOK_OUTLINE : LMG_LOOK_RADIANCE,
                            .most_photons = 4000000, .most_looks = 16000000};
            double before = 0;
            for (double left = 0.5; left < 1000; left *= 2) {
                const double tracing = bake_trees_tracing(&t, left);
                /* longer bakes trace longer, by no more than they are longer, and trees leave them something always */
                assert_true(tracing >= before && tracing < left && (left < 1 || tracing - before <= left / 2 + 1e-6));
                assert_true(resumed || tracing > 0.05 * left); /* who resumes for a moment has trees to grow first */
                before = tracing;
            }
            assert_true(before > 0.9 * 512); /* there is an end to what trees take */
            t.count = 0;
            assert_true(bake_trees_tracing(&t, 10) == 10);
        }
    assert_true(bake_trees_leave(3e6) > 1.99e6 && bake_trees_leave(3e6) < 2.01e6);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_wanted),
        cmocka_unit_test(test_time),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
