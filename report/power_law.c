/* SPDX-License-Identifier: Apache-2.0 */
/* The slope of a log-log plot: by linear regression of the logarithms, and of squares by the greatest likelihood. */
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

static const report_slope NO_SLOPE = {.slope = NAN, .standard_error = NAN, .confidence = NAN, .x = NAN, .y = NAN};

report_slope report_slope_fit(const double *x, const double *y, size_t count)
{
    report_slope f = NO_SLOPE;
    double mean_a = 0, mean_b = 0;
    for (size_t i = 0; i < count; ++i) {
        if (!counts(x[i], y[i]))
            continue;
        ++f.points;
        mean_a += (log(x[i]) - mean_a) / (double)f.points;
        mean_b += (log(y[i]) - mean_b) / (double)f.points;
    }
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
        f.x = exp(mean_a);
        f.y = exp(mean_b);
        const double residual = bb - f.slope * ab;
        f.standard_error = sqrt((residual > 0 ? residual : 0) / ((double)(f.points - 2) * aa));
        f.confidence = student(f.points - 2) * f.standard_error;
    }
    return f;
}

/* A point of a fit of squares: logarithm of x, square, variance of its noise. */
typedef struct point {
    double t, square, variance;
} point;

/* What a law exp(a + b t) says of a point: its square and the variance of that, noise and luck; about the least of normal doubles,
 * so that squares that underflow divide by something. */
static double law(const point *p, double a, double b, double luck, double *variance)
{
    const double m = exp(a + b * p->t);
    *variance = fmax(p->variance + 4 * luck * luck * m * m, 1e-300);
    return m;
}

/* Minus twice the logarithm of the likelihood, but for a constant. */
static double unlikely(const point *p, size_t count, double a, double b, double luck)
{
    double sum = 0;
    for (size_t i = 0; i < count; ++i) {
        double v;
        const double d = p[i].square - law(&p[i], a, b, luck, &v);
        sum += d * d / v + log(v);
    }
    return sum;
}

report_slope report_squares_fit(const double *x, const double *square, const double *standard_error, double luck, size_t count)
{
    enum { MOST = 64, ROW = 48, COLUMN = 64, FINER = 60 };
    /* Looked for: squares that change by at most so many powers of x, and are at most so many e-folds below the largest. */
    static const double STEEPEST = 6, DEEPEST = 20;
    /* The law's squares have to be so many standard errors in all, or they are noise. */
    static const double SEEN = 2;
    report_slope f = NO_SLOPE;
    point p[MOST];
    double middle = 0, spread = 0, most = 0;
    for (size_t i = 0; i < count && f.points < MOST; ++i) {
        if (!(isfinite(x[i]) && x[i] > 0 && isfinite(square[i]) && isfinite(standard_error[i])))
            continue;
        if (!(standard_error[i] > 0 || (luck > 0 && square[i] > 0)))
            continue;
        p[f.points++] = (point){.t = log(x[i]), .square = square[i], .variance = standard_error[i] * standard_error[i]};
        most = fmax(most, square[i]);
    }
    for (size_t i = 0; i < f.points; ++i)
        middle += p[i].t / (double)f.points;
    for (size_t i = 0; i < f.points; ++i) {
        p[i].t -= middle; /* so that a is of the order of the squares' logarithms */
        spread += p[i].t * p[i].t;
    }
    if (f.points < 3 || !(spread > 0) || !(most > 0))
        return f;
    /* The likeliest of a grid, then ever finer about it. */
    const double top = log(most) + 2;
    double a = top, b = 0, step_a = DEEPEST / COLUMN, step_b = 2 * STEEPEST / ROW, least = INFINITY;
    for (int k = 0; k <= ROW; ++k)
        for (int i = 0; i <= COLUMN; ++i) {
            const double here_a = top - i * step_a, here_b = -STEEPEST + k * step_b,
                         sum = unlikely(p, f.points, here_a, here_b, luck);
            if (sum < least) {
                least = sum;
                a = here_a;
                b = here_b;
            }
        }
    for (int round = 0; round < FINER;) {
        const double from_a = a, from_b = b;
        for (int k = 0; k < 9; ++k) {
            const double here_a = from_a + (k / 3 - 1) * step_a, here_b = from_b + (k % 3 - 1) * step_b,
                         sum = unlikely(p, f.points, here_a, here_b, luck);
            if (sum < least && fabs(here_b) <= STEEPEST) {
                least = sum;
                a = here_a;
                b = here_b;
            }
        }
        if (a == from_a && b == from_b) {
            step_a *= 0.5;
            step_b *= 0.5;
            ++round;
        }
    }
    if (fabs(b) > 0.99 * STEEPEST)
        return f;
    /* Information on a and b; the point where they are independent. */
    double information = 0, first = 0, second = 0, chi = 0, seen = 0;
    for (size_t i = 0; i < f.points; ++i) {
        double v;
        const double m = law(&p[i], a, b, luck, &v), w = m * m / v, d = p[i].square - m;
        information += w;
        first += w * p[i].t;
        second += w * p[i].t * p[i].t;
        chi += d * d / v;
        seen += p[i].variance > 0 ? m * m / p[i].variance : (double)INFINITY;
    }
    const double at = first / information, left = second - first * at;
    if (!(left > 0) || !(seen > SEEN * SEEN))
        return f;
    f.slope = 0.5 * b;
    f.x = exp(middle + at);
    f.y = exp(0.5 * (a + b * at));
    f.standard_error = 0.5 * sqrt(fmax(chi / (double)(f.points - 2), 1) / left);
    f.confidence = student(f.points - 2) * f.standard_error;
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
