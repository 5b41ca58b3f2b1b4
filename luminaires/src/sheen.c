/* SPDX-License-Identifier: Apache-2.0 */
/* The sheen of cloth (sheen.h) and the table of its albedo. */
#include "sheen.h"

static double clamped(double alpha)
{
    return alpha > LUM_SHEEN_SHARPEST ? alpha < 1 ? alpha : 1 : LUM_SHEEN_SHARPEST;
}

static double fitted(double alpha, double x)
{
    static const double SHARP[5] = {25.3245, 3.32435, 0.16801, -1.27393, -4.85967},
                        BROAD[5] = {21.5473, 3.82987, 0.19823, -1.97760, -4.32054};
    double t = (1 - alpha) * (1 - alpha), p[5];
    for (int i = 0; i < 5; i++) {
        p[i] = t * SHARP[i] + (1 - t) * BROAD[i];
    }
    return p[0] / (1 + p[1] * pow(x, p[2])) + p[3] * x + p[4];
}

double lum_sheen_lambda(double alpha, double mu)
{
    alpha = clamped(alpha);
    mu = mu < 1 ? mu : 1;
    return mu < 0.5 ? exp(fitted(alpha, mu)) : exp(2 * fitted(alpha, 0.5) - fitted(alpha, 1 - mu));
}

double lum_sheen_d_max(double alpha)
{
    return (2 + 1 / clamped(alpha)) / (2 * LUM_PI);
}

double lum_sheen_d(double alpha, double s2)
{
    return s2 > 0 ? lum_sheen_d_max(alpha) * pow(s2, 0.5 / clamped(alpha)) : 0;
}

/* Without caps. */
static double raw_density(double alpha, lmg_vec3 wi, lmg_vec3 wo)
{
    lmg_vec3 h = vec_add(wi, wo);
    double s2 = (h.x * h.x + h.y * h.y) / vec_dot(h, h);
    return lum_sheen_d(alpha, s2) / (4 * wi.z * (1 + lum_sheen_lambda(alpha, wi.z) + lum_sheen_lambda(alpha, wo.z)));
}

double lum_sheen_density(const lum_sheen_table *table, double alpha, lmg_vec3 wi, lmg_vec3 wo)
{
    return raw_density(alpha, wi, wo) / (lum_sheen_cap(table, alpha, wi.z) * lum_sheen_cap(table, alpha, wo.z));
}

/* By the midpoint rule over azimuth (half a turn: the other half is its mirror image) and over sqrt of the cosine: the lobe is
 * steep at grazing angles. */
static double albedo(double alpha, double mu, const lum_sheen_table *caps)
{
    enum { RINGS = 48, SECTORS = 32 };
    double sum = 0;
    lmg_vec3 wi = vec(sqrt((1 - mu) * (1 + mu)), 0, mu);
    double lambda = lum_sheen_lambda(alpha, mu), cap = caps ? lum_sheen_cap(caps, alpha, mu) : 1;
    for (int i = 0; i < RINGS; i++) {
        double x = (i + 0.5) / RINGS, z = x * x, r = sqrt((1 - z) * (1 + z));
        double masked = 1 / (4 * mu * (1 + lambda + lum_sheen_lambda(alpha, z)));
        masked /= caps ? cap * lum_sheen_cap(caps, alpha, z) : 1;
        for (int k = 0; k < SECTORS; k++) {
            double s, c;
            sincos_turns(0.5 * (k + 0.5) / SECTORS, &s, &c);
            lmg_vec3 h = vec_add(wi, vec(r * c, r * s, z));
            sum += 2 * x * masked * lum_sheen_d(alpha, (h.x * h.x + h.y * h.y) / vec_dot(h, h));
        }
    }
    return sum * 2 * LUM_PI / (RINGS * SECTORS);
}

/* Row and place between it and the next of a roughness. */
static int row_of(double roughness, double *t)
{
    double y = (roughness - 0.1) / 0.9 * LUM_SHEEN_ROUGHNESSES;
    int i = (int)(y > 0 ? y : 0);
    i = i < LUM_SHEEN_ROUGHNESSES ? i : LUM_SHEEN_ROUGHNESSES - 1;
    *t = y > 0 ? y - i : 0;
    return i;
}

static double interpolated(const float table[LUM_SHEEN_ROUGHNESSES + 1][LUM_SHEEN_COSINES + 1], double alpha, double mu)
{
    double x = sqrt(mu < 1 ? mu : 1) * LUM_SHEEN_COSINES, t;
    int j = (int)x, i = row_of(sqrt(clamped(alpha)), &t);
    j = j < LUM_SHEEN_COSINES ? j : LUM_SHEEN_COSINES - 1;
    double s = x - j;
    double a = (1 - s) * (double)table[i][j] + s * (double)table[i][j + 1];
    double b = (1 - s) * (double)table[i + 1][j] + s * (double)table[i + 1][j + 1];
    return (1 - t) * a + t * b;
}

void lum_sheen_table_fill(lum_sheen_table *table, double low, double high)
{
    double t;
    int first = row_of(low, &t), last = row_of(high, &t) + 1;
    for (int i = first; i <= last; i++) {
        double r = 0.1 + 0.9 * i / LUM_SHEEN_ROUGHNESSES;
        if (table->filled[i]) {
            continue;
        }
        for (int pass = 0; pass < 2; pass++) {
            for (int j = 0; j <= LUM_SHEEN_COSINES; j++) {
                double x = j ? (double)j / LUM_SHEEN_COSINES : 0.1 / LUM_SHEEN_COSINES;
                double e = albedo(r * r, x * x, pass ? table : NULL);
                if (pass == 0) {
                    table->cap[i][j] = e > 1 ? (float)e : 1;
                } else {
                    table->albedo[i][j] = e < 1 ? (float)e : 1;
                }
            }
            if (pass == 0 && i < LUM_SHEEN_ROUGHNESSES && !table->filled[i + 1]) { /* rounding of r may ask for the next row */
                for (int j = 0; j <= LUM_SHEEN_COSINES; j++) {
                    table->cap[i + 1][j] = table->cap[i][j];
                }
            }
        }
        table->filled[i] = true;
    }
}

double lum_sheen_albedo(const lum_sheen_table *table, double alpha, double mu)
{
    return interpolated(table->albedo, alpha, mu);
}

double lum_sheen_cap(const lum_sheen_table *table, double alpha, double mu)
{
    return interpolated(table->cap, alpha, mu);
}
