/* SPDX-License-Identifier: Apache-2.0 */
/* Power laws, y = c x^slope: straight lines in a log-log plot. */
#ifndef REPORT_POWER_LAW_H
#define REPORT_POWER_LAW_H

#include <stddef.h>

typedef struct report_slope {
    double slope;
    double standard_error;
    double confidence; /* the slope is within slope +- confidence at 95 % (Student's t), if the points scatter about a line by
                          chance alone */
    double x, y;       /* the point of the line whose y doesn't hang on the slope */
    size_t points;     /* that the line goes through */
} report_slope;

/* Least squares of log y over log x; the standard error is from the residuals.  Points count whose x and y are finite and positive;
 * fewer than three of them, or all at one x, make everything but points NAN. */
report_slope report_slope_fit(const double *x, const double *y, size_t count);

/* The same of squares y^2 that are known with an error and may so be negative, as a square less its noise is: the power law that
 * makes the squares themselves likeliest, so that small ones count whatever their sign.  (A line through the logarithms of those
 * that are positive leaves out the lucky: too flat.)  The squares are taken as normal about the law's, with their standard errors
 * and luck, the part of y that points scatter by without noise; the fit's standard error is by these, or by the residuals if they
 * are larger: at least 95 % are within confidence if luck is right and the points' noise is their own.  Points count, 64 at most,
 * whose x is positive, and whose standard error or luck is.  Fewer than three, all at one x, a law that isn't seen above the noise,
 * or one steeper than y ~ x^3, make everything but points NAN. */
report_slope report_squares_fit(const double *x, const double *square, const double *standard_error, double luck, size_t count);

/* y of the line at x, and x of the line at y. */
double report_slope_y(report_slope f, double x);
double report_slope_x(report_slope f, double y);

/* "-0.501 +- 0.020": the slope and its confidence, sign between them; "-" when there is none.  Returns text. */
const char *report_slope_text(report_slope f, const char *sign, char text[64]);

#endif
