/* SPDX-License-Identifier: Apache-2.0 */
/* The slope of a log-log plot: by linear regression of the logarithms, and of squares by least squares weighted anew in each round.
 */
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

/* A point of a fit of squares: logarithm of x, square, variance of its noise, weight. */
typedef struct point {
    double t, square, variance, weight;
} point;

/* The factor A of A exp(b t) that is nearest to the points, and how near: the sum of weighted squares; A isn't negative. */
static double nearest(const point *p, size_t count, double b, double *factor)
{
    double mm = 0, ms = 0, sum = 0;
    for (size_t i = 0; i < count; ++i) {
        const double m = exp(b * p[i].t);
        mm += p[i].weight * m * m;
        ms += p[i].weight * m * p[i].square;
    }
    *factor = ms > 0 ? ms / mm : 0;
    for (size_t i = 0; i < count; ++i) {
        const double d = p[i].square - *factor * exp(b * p[i].t);
        sum += p[i].weight * d * d;
    }
    return sum;
}

/* The exponent b of the nearest A exp(b t): the best of a row, then ever finer about it. */
static double nearest_exponent(const point *p, size_t count, double *factor)
{
    static const double STEEPEST = 6; /* of squares: errors that fall faster than the third power of x aren't looked for */
    enum { ROW = 48, FINER = 40 };
    double at = 0, step = 2 * STEEPEST / ROW, unused, least = INFINITY;
    for (int k = 0; k <= ROW; ++k) {
        const double b = -STEEPEST + k * step, sum = nearest(p, count, b, &unused);
        if (sum < least) {
            least = sum;
            at = b;
        }
    }
    for (int round = 0; round < FINER; ++round, step *= 0.5)
        for (int side = -1; side <= 1; side += 2) {
            const double b = at + 0.5 * side * step, sum = nearest(p, count, b, &unused);
            if (sum < least) {
                least = sum;
                at = b;
            }
        }
    nearest(p, count, at, factor);
    return at;
}

report_slope report_squares_fit(const double *x, const double *square, const double *standard_error, double luck, size_t count)
{
    enum { MOST = 64, ROUNDS = 10 };
    report_slope f = NO_SLOPE;
    point p[MOST];
    double middle = 0, spread = 0;
    for (size_t i = 0; i < count && f.points < MOST; ++i) {
        if (!(isfinite(x[i]) && x[i] > 0 && isfinite(square[i]) && isfinite(standard_error[i])))
            continue;
        if (!(standard_error[i] > 0 || (luck > 0 && square[i] > 0)))
            continue;
        p[f.points++] = (point){.t = log(x[i]), .square = square[i], .variance = standard_error[i] * standard_error[i]};
    }
    for (size_t i = 0; i < f.points; ++i)
        middle += p[i].t / (double)f.points;
    for (size_t i = 0; i < f.points; ++i) {
        p[i].t -= middle; /* so that A is of the order of the squares */
        spread += p[i].t * p[i].t;
    }
    if (f.points < 3 || !(spread > 0))
        return f;
    double factor = 0, b = 0;
    for (int round = 0; round < ROUNDS; ++round) {
        for (size_t i = 0; i < f.points; ++i) {
            /* luck is a part of what the law says; in the first round it hasn't said anything yet */
            const double lucky = 2 * luck * (round ? factor * exp(b * p[i].t) : fmax(p[i].square, 0));
            p[i].weight = 1 / (p[i].variance + lucky * lucky);
        }
        b = nearest_exponent(p, f.points, &factor);
        if (!(factor > 0))
            return f;
    }
    /* Information on log A and b; the point where they are independent. */
    double information = 0, first = 0, second = 0, chi = 0;
    for (size_t i = 0; i < f.points; ++i) {
        const double m = factor * exp(b * p[i].t), w = p[i].weight * m * m, d = p[i].square - m;
        information += w;
        first += w * p[i].t;
        second += w * p[i].t * p[i].t;
        chi += p[i].weight * d * d;
    }
    const double at = first / information, left = second - first * at;
    if (!(left > 0))
        return f;
    f.slope = 0.5 * b;
    f.x = exp(middle + at);
    f.y = sqrt(factor * exp(b * at));
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
