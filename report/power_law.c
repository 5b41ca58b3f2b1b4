/* SPDX-License-Identifier: Apache-2.0 */
/* The slope of a log-log plot by linear regression. */
#include "power_law.h"

#include <math.h>
#include <stdio.h>

/* Student's t at 97.5 %, by degrees of freedom; beyond the table within 0.1 % of 1.96 + 2.46 / n. */
static double student(size_t freedom)
{
    static const double T[] = {12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201,
                               2.179,  2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074};
    const size_t count = sizeof(T) / sizeof(T[0]);
    return freedom <= count ? T[freedom - 1] : 1.96 + 2.46 / (double)freedom;
}

static int counts(double x, double y)
{
    return isfinite(x) && isfinite(y) && x > 0 && y > 0;
}

report_slope report_slope_fit(const double *x, const double *y, size_t count)
{
    report_slope f = {.slope = NAN, .standard_error = NAN, .confidence = NAN};
    double mean_a = 0, mean_b = 0, n = 0;
    for (size_t i = 0; i < count; ++i) {
        if (!counts(x[i], y[i]))
            continue;
        n += 1;
        mean_a += (log(x[i]) - mean_a) / n;
        mean_b += (log(y[i]) - mean_b) / n;
    }
    f.points = (size_t)n;
    /* Deviations from the means: sums of squares of logarithms would cancel where x hardly varies. */
    double aa = 0, ab = 0, bb = 0;
    for (size_t i = 0; i < count; ++i) {
        if (!counts(x[i], y[i]))
            continue;
        const double a = log(x[i]) - mean_a, b = log(y[i]) - mean_b;
        aa += a * a;
        ab += a * b;
        bb += b * b;
    }
    if (f.points >= 3 && aa > 0) {
        f.slope = ab / aa;
        const double residual = bb - f.slope * ab;
        f.standard_error = sqrt((residual > 0 ? residual : 0) / ((n - 2) * aa));
        f.confidence = student(f.points - 2) * f.standard_error;
    }
    return f;
}

const char *report_slope_text(report_slope f, const char *sign, char text[64])
{
    if (isfinite(f.slope) && isfinite(f.confidence))
        snprintf(text, 64, "%.3f %s %.3f", f.slope, sign, f.confidence);
    else
        snprintf(text, 64, "-");
    return text;
}
