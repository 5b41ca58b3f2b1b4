/* SPDX-License-Identifier: Apache-2.0 */
/* Power laws, y = c x^slope: straight lines in a log-log plot. */
#ifndef REPORT_POWER_LAW_H
#define REPORT_POWER_LAW_H

#include <stddef.h>

typedef struct report_slope {
    double slope;
    double standard_error; /* from the residuals */
    double confidence;     /* the slope is within slope +- confidence at 95 % (Student's t), if the points scatter about a line by
                              chance alone */
    double x, y;           /* a point of the line: weighted geometric means */
    size_t points;         /* that the line goes through */
} report_slope;

/* Least squares of log y over log x; relative_error: of each y, > 0, points weigh by 1 / its square; NULL = all alike.  Points count
 * whose x and y are finite and positive; fewer than three of them, or all at one x, make everything but points NAN. */
report_slope report_slope_fit(const double *x, const double *y, const double *relative_error, size_t count);

/* y of the line at x, and x of the line at y. */
double report_slope_y(report_slope f, double x);
double report_slope_x(report_slope f, double y);

/* "-0.501 +- 0.020": the slope and its confidence, sign between them; "-" when there is none.  Returns text. */
const char *report_slope_text(report_slope f, const char *sign, char text[64]);

#endif
