/* SPDX-License-Identifier: Apache-2.0 */
/* Statistics for tests: tail probabilities, Pearson's chi-square test with pooled cells, means with standard errors. */
#ifndef TESTS_STATS_H
#define TESTS_STATS_H

#include <stddef.h>

/* Upper regularized incomplete gamma function Q(a, x), a > 0, x >= 0: series or continued fraction (Abramowitz and
 * Stegun 6.5.29, 6.5.31). */
double stats_gamma_q(double a, double x);

/* Probability that a chi-square variable with k degrees of freedom exceeds x. */
double stats_chi_square_tail(double x, double k);

/* Probability that a standard normal variable exceeds |z| in magnitude. */
double stats_normal_tail(double z);

/* Level of each of n independent tests so that all together fail by chance with probability `level` (Sidak). */
double stats_sidak(double level, int n);

/*
 * Pearson's test that counts come from a distribution with these expected counts (same total; call it with a last cell for
 * everything else).  Cells with fewer than 5 expected are pooled with one another, in order of size.  Returns the p-value;
 * *statistic and *degrees may be NULL.  A count in a cell of no expectation gives 0.
 */
double stats_chi_square(const double *counts, const double *expected, size_t cells, double *statistic, int *degrees);

/* Running mean and variance [welford1962note]. */
typedef struct stats_mean {
    double n, mean, m2;
} stats_mean;
void stats_add(stats_mean *s, double x);
double stats_error(const stats_mean *s); /* standard error of the mean */

#endif
