/* SPDX-License-Identifier: Apache-2.0 */
/* Reports: slopes of power laws, and pages that stay HTML whatever their texts hold. */
#include "page.h"
#include "power_law.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static void exact_power_law(void **state)
{
    (void)state;
    double x[24], y[24];
    for (int i = 0; i < 24; ++i) {
        x[i] = 1e-3 * pow(1.7, i);
        y[i] = 42 * pow(x[i], -0.5);
    }
    for (size_t n = 3; n <= 24; ++n) {
        const report_slope f = report_slope_fit(x, y, NULL, n);
        assert_int_equal(f.points, n);
        assert_true(fabs(f.slope + 0.5) < 1e-12);
        assert_true(f.standard_error < 1e-7 && f.confidence >= f.standard_error); /* roots of rounding errors */
    }
    assert_true(isnan(report_slope_fit(x, y, NULL, 2).slope));
    y[1] = 0;
    y[2] = NAN;
    y[3] = -1;
    const report_slope f = report_slope_fit(x, y, NULL, 7);
    assert_int_equal(f.points, 4);
    assert_true(fabs(f.slope + 0.5) < 1e-12);
    assert_true(fabs(report_slope_y(f, 1e-6) - 42e3) < 1e-6 && fabs(report_slope_x(f, 42e3) - 1e-6) < 1e-15);
    for (int i = 0; i < 24; ++i)
        x[i] = 3;
    assert_true(isnan(report_slope_fit(x, y, NULL, 24).slope));
}

/* Against least squares worked out apart, and Student's t of three degrees of freedom, 3.182. */
static void scattered_power_law(void **state)
{
    (void)state;
    static const double X[5] = {1, 2, 4, 8, 16}, Y[5] = {10, 7.5, 4.6, 3.7, 2.4};
    const report_slope f = report_slope_fit(X, Y, NULL, 5);
    assert_true(fabs(f.slope - (-0.513715270297)) < 1e-9);
    assert_true(fabs(f.standard_error - 0.030230108389) < 1e-9);
    assert_true(fabs(f.confidence / f.standard_error - 3.182) < 1e-9);
    /* Weights: alike, as if there were none; twice the error, a quarter of the weight, as if the others were there four times. */
    static const double ALIKE[5] = {0.3, 0.3, 0.3, 0.3, 0.3}, LAST[5] = {0.1, 0.1, 0.1, 0.1, 0.2};
    assert_true(fabs(report_slope_fit(X, Y, ALIKE, 5).slope - f.slope) < 1e-12);
    double x[17], y[17];
    for (int i = 0; i < 17; ++i) {
        x[i] = X[i / 4];
        y[i] = Y[i / 4];
    }
    assert_true(fabs(report_slope_fit(X, Y, LAST, 5).slope - report_slope_fit(x, y, NULL, 17).slope) < 1e-12);
    char text[64];
    assert_string_equal(report_slope_text((report_slope){.slope = -0.5, .confidence = 0.0625}, "+-", text), "-0.500 +- 0.062");
    assert_string_equal(report_slope_text(report_slope_fit(X, Y, NULL, 2), "+-", text), "-");
}

static void page_escapes(void **state)
{
    (void)state;
    char path[64], text[1 << 16];
    lmg_error err;
    report_page *page;
    snprintf(path, sizeof path, "/tmp/lumibox-report-%ld.html", (long)getpid());
    assert_int_equal(report_page_create("a < b & \"c\"", &page, &err), LMG_OK);
    report_page_table(page, "one\ttwo");
    report_page_row(page, "<%s>\t%d", "script", 7);
    report_page_table_end(page);
    static const double X[2] = {1, 2}, Y[2] = {-1, 0};
    report_page_plot(page, &(report_axes){.title = "nothing", .x = "x", .y = "y", .log_y = true},
                     &(report_curve){.name = "n", .x = X, .y = Y, .count = 2}, 1);
    static const double HIGHER[2] = {2, 3};
    report_page_plot(page, &(report_axes){.title = "it's `echo $HOME` \\n", .x = "x", .y = "y"},
                     &(report_curve){.name = "\"`id`\"", .x = X, .y = HIGHER, .count = 2}, 1);
    assert_int_equal(report_page_write(page, path, &err), LMG_OK);
    assert_int_equal(report_page_write(page, "/no/such/folder/page.html", &err), LMG_ERROR_FILE_WRITE);
    report_page_destroy(page);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    text[fread(text, 1, sizeof text - 1, file)] = 0;
    fclose(file);
    unlink(path);
    assert_non_null(strstr(text, "<h1>a &lt; b &amp; &quot;c&quot;</h1>"));
    assert_non_null(strstr(text, "<tr><td>&lt;script&gt;</td><td>7</td></tr>"));
    assert_non_null(strstr(text, "it's `echo $HOME` \\n")); /* gnuplot runs and expands nothing */
    assert_non_null(strstr(text, "`id`"));
    assert_non_null(strstr(text, "nothing: no value to draw.")); /* on a logarithmic axis */
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(exact_power_law),
        cmocka_unit_test(scattered_power_law),
        cmocka_unit_test(page_escapes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
