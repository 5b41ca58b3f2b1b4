/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Thin films.  With amplitudes r12 at the film's top and r23 at its base (real: no absorption) and the phase d = 2 pi x /
 * wavelength, x = 2 n t cos(theta in the film), Airy's sum is
 *     R = 1 - (1 - r12^2) (1 - r23^2) / (1 + q^2 + 2 q cos d),   q = r12 r23,
 * and 1 / (1 + q^2 + 2 q cos d) = (1 + 2 sum_m (-q)^m cos(m d)) / (1 - q^2).  So all that the spectrum asks for is the mean of
 * cos(2 pi m x / wavelength), a function of m x alone, which is tabulated: the idea of [belcour2017iridescence], with the
 * observer's own functions in place of fits.
 */
#include "film.h"

#include "vec.h"

#include <luminaires/spectrum.h>

void lum_film_table_fill(lum_film_table *table)
{
    lum_spectrum white;
    lum_spectrum_illuminant("D65", &white);
    double total[3] = {0, 0, 0};
    static const int step_nm = 2;
    enum { SAMPLES = (LUM_NM_LAST - LUM_NM_FIRST) / 2 + 1 };
    double weight[SAMPLES][3];
    for (int i = 0; i < SAMPLES; i++) {
        double nm = LUM_NM_FIRST + i * step_nm, xyz[3];
        lum_observer(nm, xyz);
        lum_xyz_to_rgb(xyz, weight[i]);
        for (int k = 0; k < 3; k++) {
            weight[i][k] *= lum_spectrum_at(&white, nm);
            total[k] += weight[i][k];
        }
    }
    for (int j = 0; j <= LUM_FILM_STEPS; j++) {
        double sum[3] = {0, 0, 0};
        for (int i = 0; i < SAMPLES; i++) {
            double turns = (double)j * LUM_FILM_STEP / (LUM_NM_FIRST + i * step_nm), s, c;
            sincos_turns(turns - floor(turns), &s, &c);
            for (int k = 0; k < 3; k++) {
                sum[k] += weight[i][k] * c;
            }
        }
        for (int k = 0; k < 3; k++) {
            table->mean[j][k] = (float)(sum[k] / total[k]);
        }
    }
}

static double mean_cosine(const lum_film_table *table, double x, int channel)
{
    double t = x / LUM_FILM_STEP;
    int j = (int)t;
    if (j >= LUM_FILM_STEPS) {
        return 0;
    }
    double a = (double)table->mean[j][channel];
    return a + (t - j) * ((double)table->mean[j + 1][channel] - a);
}

void lum_film_reflectance(const lum_film_table *table, double c, double n, double nm, const float f0[3], float out[3])
{
    enum { ORDERS = 40 };
    double sin2 = (1 - c) * (1 + c), c2 = 1 - sin2 / (n * n);
    if (c2 <= 0) {
        out[0] = out[1] = out[2] = 1; /* total reflection above the film */
        return;
    }
    c2 = sqrt(c2);
    double r12[2] = {(c - n * c2) / (c + n * c2), (n * c - c2) / (n * c + c2)};
    double x = 2 * n * nm * c2;
    for (int k = 0; k < 3; k++) {
        double root = sqrt(fmin((double)f0[k], 0.9999)), n3 = (1 + root) / (1 - root);
        double c3 = sqrt(fmax(1 - sin2 / (n3 * n3), 0));
        double r23[2] = {(n * c2 - n3 * c3) / (n * c2 + n3 * c3), (n3 * c2 - n * c3) / (n3 * c2 + n * c3)};
        double sum = 0;
        for (int pol = 0; pol < 2; pol++) {
            double q = r12[pol] * r23[pol], power = 1, series = 1;
            for (int m = 1; m <= ORDERS && fabs(power) > 1e-6 && m * x < (double)LUM_FILM_STEP * LUM_FILM_STEPS; m++) {
                power *= -q;
                series += 2 * power * mean_cosine(table, m * x, k);
            }
            if (x == 0) { /* the sum of all orders */
                series = (1 - q) / (1 + q);
            }
            double t = (1 - r12[pol] * r12[pol]) * (1 - r23[pol] * r23[pol]), d = 1 - q * q;
            sum += d > 0 ? 1 - t / d * series : 1;
        }
        out[k] = (float)fmin(fmax(0.5 * sum, 0), 1);
    }
}
