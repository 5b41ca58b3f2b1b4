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

report_slope report_slope_fit(const double *x, const double *y, const double *relative_error, size_t count)
{
    report_slope f = {.slope = NAN, .standard_error = NAN, .confidence = NAN, .x = NAN, .y = NAN};
    double mean_a = 0, mean_b = 0, weight = 0;
    for (size_t i = 0; i < count; ++i) {
        if (!counts(x[i], y[i]))
            continue;
        const double w = relative_error ? 1 / (relative_error[i] * relative_error[i]) : 1;
        weight += w;
        mean_a += (log(x[i]) - mean_a) * w / weight;
        mean_b += (log(y[i]) - mean_b) * w / weight;
        ++f.points;
    }
    /* Deviations from the means: sums of squares of logarithms would cancel where x hardly varies. */
    double aa = 0, ab = 0, bb = 0;
    for (size_t i = 0; i < count; ++i) {
        if (!counts(x[i], y[i]))
            continue;
        const double w = relative_error ? 1 / (relative_error[i] * relative_error[i]) : 1;
        const double a = log(x[i]) - mean_a, b = log(y[i]) - mean_b;
        aa += w * a * a;
        ab += w * a * b;
        bb += w * b * b;
    }
    if (f.points >= 3 && aa > 0) {
        f.slope = ab / aa;
        f.x = exp(mean_a);
        f.y = exp(mean_b);
        const double residual = bb - f.slope * ab; /* weights say how errors compare; how large they are, the residuals */
        f.standard_error = sqrt((residual > 0 ? residual : 0) / ((double)(f.points - 2) * aa));
        f.confidence = student(f.points - 2) * f.standard_error;
    }
    return f;
}

double report_slope_y(report_slope f, double x)
{
    return f.y * pow(x / f.x, f.slope);
}

double report_slope_x(report_slope f, double y)
{
    return f.x * pow(y / f.y, 1 / f.slope);
}

const char *report_slope_text(report_slope f, const char *sign, char text[64])
{
    if (isfinite(f.slope) && isfinite(f.confidence))
        snprintf(text, 64, "%.3f %s %.3f", f.slope, sign, f.confidence);
    else
        snprintf(text, 64, "-");
    return text;
}
