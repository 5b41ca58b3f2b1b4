/* SPDX-License-Identifier: Apache-2.0 */
/* See stats.h. */
#include "stats.h"

#include <math.h>
#include <stdlib.h>

double stats_gamma_q(double a, double x)
{
    if (x <= 0) {
        return 1;
    }
    double front = exp(a * log(x) - x - lgamma(a));
    if (x < a + 1) {
        double term = 1 / a, sum = term;
        for (int n = 1; n < 10000 && fabs(term) > 1e-17 * sum; n++) {
            term *= x / (a + n);
            sum += term;
        }
        return fmax(1 - front * sum, 0);
    }
    /* Modified Lentz's method; 1e-300 stands for a zero denominator. */
    double b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
    for (int i = 1; i < 10000; i++) {
        double an = -i * (i - a);
        b += 2;
        d = an * d + b;
        d = fabs(d) < 1e-300 ? 1e-300 : d;
        c = b + an / c;
        c = fabs(c) < 1e-300 ? 1e-300 : c;
        d = 1 / d;
        h *= c * d;
        if (fabs(c * d - 1) < 1e-16) {
            break;
        }
    }
    return front * h;
}

double stats_chi_square_tail(double x, double k)
{
    return stats_gamma_q(0.5 * k, 0.5 * x);
}

double stats_normal_tail(double z)
{
    return erfc(fabs(z) / sqrt(2.0));
}

double stats_sidak(double level, int n)
{
    return -expm1(log1p(-level) / n);
}

typedef struct cell {
    double count, expected;
} cell;

static int by_expected(const void *a, const void *b)
{
    double x = ((const cell *)a)->expected, y = ((const cell *)b)->expected;
    return (x > y) - (x < y);
}

double stats_chi_square(const double *counts, const double *expected, size_t cells, double *statistic, int *degrees)
{
    cell *sorted = malloc((cells + 1) * sizeof *sorted);
    if (!sorted) {
        abort();
    }
    for (size_t i = 0; i < cells; i++) {
        sorted[i].count = counts[i];
        sorted[i].expected = expected[i];
    }
    qsort(sorted, cells, sizeof *sorted, by_expected);
    double x = 0, count = 0, expect = 0;
    int pools = 0;
    for (size_t i = 0; i < cells; i++) {
        count += sorted[i].count;
        expect += sorted[i].expected;
        if (expect >= 5 || (i + 1 == cells && expect > 0)) {
            /* The last pool may stay below 5 only if everything does. */
            x += (count - expect) * (count - expect) / expect;
            pools++;
            count = expect = 0;
        }
    }
    free(sorted);
    double p;
    if (count > 0) {
        p = 0; /* all cells without expectation, yet counted */
    } else if (pools < 2) {
        p = x > 25 ? 0 : 1; /* nothing to compare but the total: 5 sigma */
    } else {
        p = stats_chi_square_tail(x, pools - 1);
    }
    if (statistic) {
        *statistic = x;
    }
    if (degrees) {
        *degrees = pools - 1;
    }
    return p;
}

void stats_add(stats_mean *s, double x)
{
    double d = x - s->mean;
    s->n += 1;
    s->mean += d / s->n;
    s->m2 += d * (x - s->mean);
}

double stats_error(const stats_mean *s)
{
    return s->n > 1 ? sqrt(s->m2 / (s->n - 1) / s->n) : (double)INFINITY;
}
