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
        const report_slope f = report_slope_fit(x, y, n);
        assert_int_equal(f.points, n);
        assert_true(fabs(f.slope + 0.5) < 1e-12);
        assert_true(f.standard_error < 1e-7 && f.confidence >= f.standard_error); /* roots of rounding errors */
    }
    assert_true(isnan(report_slope_fit(x, y, 2).slope));
    y[1] = 0;
    y[2] = NAN;
    y[3] = -1;
    const report_slope f = report_slope_fit(x, y, 7);
    assert_int_equal(f.points, 4);
    assert_true(fabs(f.slope + 0.5) < 1e-12);
    assert_true(fabs(report_slope_y(f, 1e-6) - 42e3) < 1e-6 && fabs(report_slope_x(f, 42e3) - 1e-6) < 1e-15);
    for (int i = 0; i < 24; ++i)
        x[i] = 3;
    assert_true(isnan(report_slope_fit(x, y, 24).slope));
}

/* Against least squares worked out apart, and Student's t of three degrees of freedom, 3.182. */
static void scattered_power_law(void **state)
{
    (void)state;
    static const double X[5] = {1, 2, 4, 8, 16}, Y[5] = {10, 7.5, 4.6, 3.7, 2.4};
    const report_slope f = report_slope_fit(X, Y, 5);
    assert_true(fabs(f.slope - (-0.513715270297)) < 1e-9);
    assert_true(fabs(f.standard_error - 0.030230108389) < 1e-9);
    assert_true(fabs(f.confidence / f.standard_error - 3.182) < 1e-9);
    char text[64];
    assert_string_equal(report_slope_text((report_slope){.slope = -0.5, .confidence = 0.0625}, "+-", text), "-0.500 +- 0.062");
    assert_string_equal(report_slope_text(report_slope_fit(X, Y, 2), "+-", text), "-");
}

/* Squares on their law, which are found there whatever they weigh (standard errors of up to half of them); and of those that aren't
 * there nothing is said.  1e-6: a likelihood of some -200 is known to 3e-14, hence its least to 2e-7 of a standard error. */
static void exact_squares(void **state)
{
    (void)state;
    double x[9], square[9], se[9];
    for (int i = 0; i < 9; ++i) {
        x[i] = 1e5 * pow(2, i);
        square[i] = 9e-4 * pow(x[i] / 1e6, -0.8);
        se[i] = (i % 3 + 1) * 1e-5;
    }
    report_slope f = report_squares_fit(x, square, se, 0, 9);
    assert_int_equal(f.points, 9);
    assert_true(fabs(f.slope + 0.4) < 1e-6 && f.standard_error > 0 && f.confidence > f.standard_error);
    assert_true(fabs(report_slope_y(f, 1e6) - 0.03) < 1e-6);
    /* Luck that didn't happen: the likeliest squares are lower by 4 luck^2 at most, since less scatters less, which is 2 % of y; by
     * less where noise weighs more than luck, which turns the slope by some of these 2 % over a factor of 256. */
    f = report_squares_fit(x, square, se, 0.1, 9);
    assert_true(fabs(f.slope + 0.4) < 0.01);
    assert_true(fabs(report_slope_y(f, 1e6) / 0.03 - 1) < 0.025);
    assert_true(isnan(report_squares_fit(x, square, se, 0.1, 2).slope));
    for (int i = 0; i < 9; ++i)
        square[i] = -square[i];
    assert_true(isnan(report_squares_fit(x, square, se, 0.1, 9).slope));
    for (int i = 0; i < 9; ++i) {
        x[i] = 3;
        square[i] = 1;
    }
    assert_true(isnan(report_squares_fit(x, square, se, 0.1, 9).slope));
}

/* A normal number of mean 0 and variance 1, nearly: twelve uniform ones. */
static double normal(uint64_t *at)
{
    double sum = -6;
    for (int i = 0; i < 12; ++i) {
        *at = *at * 6364136223846793005u + 1442695040888963407u;
        sum += (double)(*at >> 11) * 0x1p-53;
    }
    return sum;
}

/*
 * Errors that fall like x^(-1/2) below the judge's noise, which four of eight squares are less than.  Null hypothesis: the mean
 * slope is -1/2, and what the error is at the middle of the ladder is right, within 3 standard errors and a bias of a tenth of the
 * slope's spread or so; 95 % of the confidence intervals hold it.  A line through the logarithms of the positive squares is flatter
 * by far.
 */
static void noisy_squares(void **state)
{
    (void)state;
    enum { TRIALS = 1000, POINTS = 8 };
    uint64_t at = 1;
    double slopes = 0, slope_squares = 0, middles = 0, by_logs = 0, errors = 0;
    int within = 0, fitted = 0;
    for (int n = 0; n < TRIALS; ++n) {
        double x[POINTS], square[POINTS], se[POINTS], y[POINTS];
        for (int i = 0; i < POINTS; ++i) {
            x[i] = pow(2, i);
            se[i] = 0.06;
            square[i] = 1 / x[i] * (1 + 0.2 * normal(&at)) + se[i] * normal(&at);
            y[i] = square[i] > 0 ? sqrt(square[i]) : 0;
        }
        const report_slope f = report_squares_fit(x, square, se, 0.1, POINTS);
        if (!isfinite(f.slope))
            continue;
        ++fitted;
        slopes += f.slope;
        errors += f.standard_error;
        slope_squares += f.slope * f.slope;
        middles += report_slope_y(f, 2) * sqrt(2);
        within += fabs(f.slope + 0.5) <= f.confidence;
        by_logs += report_slope_fit(x, y, POINTS).slope / TRIALS;
    }
    const double mean = slopes / fitted, spread = sqrt(slope_squares / fitted - mean * mean);
    printf("slope %.4f, spread %.4f, by logarithms of what is positive %.4f; error at 2: %.4f of the true; %d of %d within "
           "confidence\n",
           mean, spread, by_logs, middles / fitted, within, fitted);
    assert_int_equal(fitted, TRIALS);
    assert_true(fabs(mean + 0.5) < 3 * spread / sqrt(TRIALS) + 0.1 * spread);
    assert_true(fabs(middles / fitted - 1) < 0.02);
    assert_true(within > 0.94 * TRIALS && within < TRIALS);
    assert_true(errors / fitted > 0.8 * spread && errors / fitted < 1.6 * spread);
    assert_true(by_logs > mean + 0.5 * spread);
}

/* One error of twice the law's, ten times its luck, doesn't turn the law over, wherever it is, and shows in the standard error. */
static void squares_with_one_off(void **state)
{
    (void)state;
    double clean = 0;
    for (int off = -1; off < 8; ++off) {
        double x[8], square[8], se[8];
        for (int i = 0; i < 8; ++i) {
            x[i] = pow(2, i);
            square[i] = (i == off ? 4 : 1) / x[i];
            se[i] = 1e-4;
        }
        const report_slope f = report_squares_fit(x, square, se, 0.1, 8);
        clean = off < 0 ? f.standard_error : clean;
        assert_true(fabs(f.slope + 0.5) < 0.2);
        assert_true(off < 0 || f.standard_error > 1.5 * clean);
    }
}

/* Where there is nothing but noise nothing is said, or next to nothing: seldom is a slope told that isn't within its confidence of
 * 0. */
static void nothing_but_noise(void **state)
{
    (void)state;
    enum { TRIALS = 1000, POINTS = 8 };
    uint64_t at = 2;
    int none = 0, claimed = 0;
    for (int n = 0; n < TRIALS; ++n) {
        double x[POINTS], square[POINTS], se[POINTS];
        for (int i = 0; i < POINTS; ++i) {
            x[i] = pow(2, i);
            se[i] = 0.06;
            square[i] = se[i] * normal(&at);
        }
        const report_slope f = report_squares_fit(x, square, se, 0.1, POINTS);
        none += isnan(f.slope);
        claimed += fabs(f.slope) > f.confidence;
    }
    printf("of noise alone: no slope in %d of %d, one that differs from 0 in %d\n", none, TRIALS, claimed);
    assert_true(none > TRIALS / 3);
    assert_true(claimed < 0.1 * TRIALS);
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
        cmocka_unit_test(exact_power_law), cmocka_unit_test(scattered_power_law),  cmocka_unit_test(exact_squares),
        cmocka_unit_test(noisy_squares),   cmocka_unit_test(squares_with_one_off), cmocka_unit_test(nothing_but_noise),
        cmocka_unit_test(page_escapes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
