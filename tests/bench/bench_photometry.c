/* SPDX-License-Identifier: Apache-2.0 */
/* A photometric file through rays and a box and back: Bergen's fit of what comes out with what went in, and how long it takes. */
#include "convert.h"

#include <luminaires/photometry.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

static void a_file_through_a_box_and_back(void **state)
{
    (void)state;
    lum_photometry *p, *q;
    lmg_error err;
    if (lum_photometry_read(LUMIBOX_SHARED_DATA "/ldt/vb_sample2.ldt", &p, &err) != LMG_OK) {
        printf("skipped: a_file_through_a_box_and_back: %s\n", err.message);
        skip();
    }
    bake_source *source, *box;
    lmg_field *field;
    bake_conversion in, out;
    assert_int_equal(bake_profile_source_create(p, 1, &source, &err), LMG_OK);
    const bake_convert_options to_box = {.rays = 10000000};
    if (bake_convert_to_field(source, &to_box, &field, &in, &err) != LMG_OK)
        fail_msg("%s", err.message);
    assert_int_equal(bake_box_source_create(field, 2, &box, &err), LMG_OK);
    const bake_convert_options to_file = {.rays = 40000000, .grid = {.planes = 72, .angles = 37, .symmetry = p->symmetry}};
    if (bake_convert_to_photometry(box, &to_file, &q, &out, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lum_photometry_difference d;
    assert_int_equal(lum_photometry_compare(q, p, &d, &err), LMG_OK);
    printf("rays -> box: %.2g rays/s; box -> far field: %.2g rays/s\n", (double)in.rays / in.seconds,
           (double)out.rays / out.seconds);
    printf("Bergen's fit %.3f, weighted %.3f; RMS %.2f %% of the peak; noise of the reading %.2f %%\n", d.bergen, d.bergen_weighted,
           100 * d.rms_of_peak, 100 * out.noise);
    assert_true(d.bergen >= 99.5 && d.bergen_weighted >= 99.5);
    box->destroy(box);
    source->destroy(source);
    lmg_field_destroy(field);
    lum_photometry_destroy(q);
    lum_photometry_destroy(p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_file_through_a_box_and_back)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
