/* SPDX-License-Identifier: Apache-2.0 */
/* Spectra as values on a grid of nanometres: making them, their colours, and spectra of colours.  Relies on spectrum_tables.c. */
#include <luminaires/spectrum.h>

#include "spectrum_tables.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* h c / k (exact SI of 2019), nm K. */
static const double PLANCK_C2 = 1.438776877e7;
/* Rec.709's primaries, x / y and z / y, and the luminance of each in white. */
static const double WEIGHT[3] = {0.2126, 0.7152, 0.0722};
static const double X_OF[3] = {0.64 / 0.33, 0.30 / 0.60, 0.15 / 0.06}, Z_OF[3] = {0.03 / 0.33, 0.10 / 0.60, 0.79 / 0.06};

/* ------------------------------------------------------------------------------------------------------------- making */

typedef struct table {
    const double *nm, *values;
    size_t count;
    lum_spectrum_end end;
} table;

/* Integral of the piece from a to b, on which the table is linear, times the rising and the falling hat of the nanometre n..n+1 */
static void add_piece(double a, double b, double va, double vb, int n, double sum[LUM_SPECTRUM_COUNT])
{
    if (!(b > a))
        return;
    /* Simpson's rule is exact for the product of two linear functions. */
    const double ha = a - (LUM_NM_FIRST + n), hb = b - (LUM_NM_FIRST + n), hm = 0.5 * (ha + hb), vm = 0.5 * (va + vb);
    const double rise = (b - a) / 6 * (va * ha + 4 * vm * hm + vb * hb), all = (b - a) * vm;
    sum[n] += all - rise;
    sum[n + 1] += rise;
}

/* The line from (a, va) to (b, vb), cut at whole nanometres. */
static void add_line(double a, double b, double va, double vb, double sum[LUM_SPECTRUM_COUNT])
{
    const double lo = fmax(a, LUM_NM_FIRST), hi = fmin(b, LUM_NM_LAST);
    if (!(hi > lo))
        return;
    const double slope = (vb - va) / (b - a);
    for (int n = (int)(lo - LUM_NM_FIRST); n < LUM_SPECTRUM_COUNT - 1 && LUM_NM_FIRST + n < hi; ++n) {
        const double p = fmax(lo, LUM_NM_FIRST + n), q = fmin(hi, LUM_NM_FIRST + n + 1);
        add_piece(p, q, va + slope * (p - a), va + slope * (q - a), n, sum);
    }
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Measured tables have regular steps; one with a hole in it has lost rows. */
static lmg_result check_gaps(const table *t, lmg_error *err)
{
    enum { REGULAR_ROWS = 16 }; /* fewer are written by hand, at the corners of a curve */
    if (t->count < REGULAR_ROWS)
        return LMG_OK;
    double *steps = malloc((t->count - 1) * sizeof *steps);
    if (!steps)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i + 1 < t->count; ++i)
        steps[i] = t->nm[i + 1] - t->nm[i];
    qsort(steps, t->count - 1, sizeof *steps, by_size);
    const double usual = steps[(t->count - 1) / 2];
    free(steps);
    for (size_t i = 0; i + 1 < t->count; ++i) {
        const double step = t->nm[i + 1] - t->nm[i];
        if (step > 10 && step > 3 * usual && t->nm[i + 1] > LUM_NM_FIRST && t->nm[i] < LUM_NM_LAST)
            return lmg_fail(err, LMG_ERROR_INPUT, "has a gap from %g to %g nm, where its rows are %g nm apart otherwise; fill it in",
                            t->nm[i], t->nm[i + 1], usual);
    }
    return LMG_OK;
}

static lmg_result check_table(const table *t, double low, double high, lmg_error *err)
{
    if (t->count < 2)
        return lmg_fail(err, LMG_ERROR_INPUT, "has %zu rows; a spectrum needs two or more", t->count);
    for (size_t i = 0; i < t->count; ++i) {
        if (!isfinite(t->nm[i]) || t->nm[i] <= 0)
            return lmg_fail(err, LMG_ERROR_INPUT, "row %zu: %g is no wavelength in nm", i + 1, t->nm[i]);
        if (i > 0 && t->nm[i] <= t->nm[i - 1])
            return lmg_fail(err, LMG_ERROR_INPUT, "row %zu: wavelengths have to increase, and %g nm follows %g nm", i + 1, t->nm[i],
                            t->nm[i - 1]);
        if (!(t->values[i] >= low && t->values[i] <= high))
            return lmg_fail(err, LMG_ERROR_INPUT, "%g at %g nm is outside [%g, %g]", t->values[i], t->nm[i], low, high);
    }
    const double first = t->nm[0], last = t->nm[t->count - 1];
    if (t->end == LUM_SPECTRUM_HOLD && (first > 400 || last < 700))
        return lmg_fail(err, LMG_ERROR_INPUT, "covers %g to %g nm only; it has to cover 400 to 700 nm", first, last);
    return check_gaps(t, err);
}

lmg_result lum_spectrum_from_table(const double *nm, const double *values, size_t count, lum_spectrum_end end, double low,
                                   double high, lum_spectrum *out, lmg_error *err)
{
    const table t = {nm, values, count, end};
    memset(out, 0, sizeof *out);
    const lmg_result result = check_table(&t, low, high, err);
    if (result)
        return result;
    double sum[LUM_SPECTRUM_COUNT] = {0}, total = 0;
    if (end == LUM_SPECTRUM_HOLD) {
        add_line(fmin(LUM_NM_FIRST, nm[0] - 1), nm[0], values[0], values[0], sum);
        add_line(nm[count - 1], fmax(LUM_NM_LAST, nm[count - 1] + 1), values[count - 1], values[count - 1], sum);
    }
    for (size_t i = 0; i + 1 < count; ++i)
        add_line(nm[i], nm[i + 1], values[i], values[i + 1], sum);
    /* The grid's first and last hats are half ones. */
    sum[0] *= 2;
    sum[LUM_SPECTRUM_COUNT - 1] *= 2;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        out->value[i] = (float)sum[i];
        total += sum[i];
    }
    if (end == LUM_SPECTRUM_ZERO && !(total > 0))
        return lmg_fail(err, LMG_ERROR_INPUT, "has no light between %d and %d nm", LUM_NM_FIRST, LUM_NM_LAST);
    if (!isfinite(total))
        return lmg_fail(err, LMG_ERROR_INPUT, "its values are beyond the range of numbers");
    return LMG_OK;
}

/* x = c2 / T, nm */
static void planck(double x, lum_spectrum *out)
{
    const double unit = expm1(x / 560);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        out->value[i] = (float)(pow(560 / nm, 5) * (unit / expm1(x / nm)));
    }
}

void lum_spectrum_blackbody(double kelvin, lum_spectrum *out)
{
    planck(PLANCK_C2 / kelvin, out);
}

static double thousandths(double x)
{
    return floor(1000 * x + 0.5) / 1000;
}

void lum_spectrum_daylight(double kelvin, lum_spectrum *out)
{
    const double t = 1000 / kelvin;
    const double x = kelvin <= 7000 ? ((-4.6070 * t + 2.9678) * t + 0.09911) * t + 0.244063
                                    : ((-2.0064 * t + 1.9018) * t + 0.24748) * t + 0.237040;
    const double y = (-3.000 * x + 2.870) * x - 0.275, m = 0.0241 + 0.2562 * x - 0.7341 * y;
    const double m1 = thousandths((-1.3515 - 1.7703 * x + 5.9114 * y) / m), m2 = thousandths((0.0300 - 31.4424 * x + 30.0717 * y) / m);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const int row = i / 10 < LUM_TABLE_10NM - 1 ? i / 10 : LUM_TABLE_10NM - 2;
        const double f = i / 10.0 - row;
        double s[2];
        for (int k = 0; k < 2; ++k) {
            const double *d = lum_daylight_table[row + k];
            s[k] = d[0] + m1 * d[1] + m2 * d[2];
        }
        out->value[i] = (float)((1 - f) * s[0] + f * s[1]);
    }
}

void lum_spectrum_gaussian(double peak, double width, lum_spectrum *out)
{
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double x = (LUM_NM_FIRST + i - peak) / width;
        out->value[i] = (float)exp2(-4 * x * x);
    }
}

bool lum_spectrum_illuminant(const char *name, lum_spectrum *out)
{
    /* The temperatures in the names of daylight are from before c2 was revised (CIE 15:2004, 3.1); so is that of A. */
    static const struct {
        const char *name;
        double kelvin;
    } daylight[] = {{"D50", 5000}, {"D55", 5500}, {"D65", 6500}, {"D75", 7500}};
    if (strcmp(name, "A") == 0) {
        planck(1.435e7 / 2848, out);
        return true;
    }
    if (strcmp(name, "E") == 0) {
        for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
            out->value[i] = 1;
        return true;
    }
    for (size_t i = 0; i < sizeof daylight / sizeof *daylight; ++i)
        if (strcmp(name, daylight[i].name) == 0) {
            lum_spectrum_daylight(daylight[i].kelvin * 1.4388 / 1.4380, out);
            return true;
        }
    return false;
}

const char *lum_spectrum_illuminant_names(void)
{
    return "A, E, D50, D55, D65, D75";
}

/* -------------------------------------------------------------------------------------------------------------- colour */

void lum_observer(double nm, double xyz[3])
{
    const double x = (nm - LUM_NM_FIRST) / 5;
    xyz[0] = xyz[1] = xyz[2] = 0;
    if (!(x >= 0 && x <= LUM_TABLE_5NM - 1))
        return;
    int i = (int)x - 1;
    i = i < 0 ? 0 : i > LUM_TABLE_5NM - 4 ? LUM_TABLE_5NM - 4 : i;
    const double s = x - i;
    const double w[4] = {-(s - 1) * (s - 2) * (s - 3) / 6, s * (s - 2) * (s - 3) / 2, -s * (s - 1) * (s - 3) / 2,
                         s * (s - 1) * (s - 2) / 6};
    for (int c = 0; c < 3; ++c) {
        for (int k = 0; k < 4; ++k)
            xyz[c] += w[k] * lum_observer_table[i + k][c];
        /* The polynomial undershoots by 6e-7 where z ends. */
        xyz[c] = xyz[c] > 0 ? xyz[c] : 0;
    }
}

/* Trapezoidal weights of the grid. */
static double grid_weight(int i)
{
    return i == 0 || i == LUM_SPECTRUM_COUNT - 1 ? 0.5 : 1;
}

void lum_spectrum_xyz(const lum_spectrum *s, double xyz[3])
{
    xyz[0] = xyz[1] = xyz[2] = 0;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        double o[3];
        lum_observer(LUM_NM_FIRST + i, o);
        for (int c = 0; c < 3; ++c)
            xyz[c] += grid_weight(i) * (double)s->value[i] * o[c];
    }
}

double lum_spectrum_efficacy(const lum_spectrum *s)
{
    double xyz[3], power = 0;
    lum_spectrum_xyz(s, xyz);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        power += grid_weight(i) * (double)s->value[i];
    return power > 0 ? 683 * xyz[1] / power : 0;
}

void lum_rgb_to_xyz(const double rgb[3], double xyz[3])
{
    xyz[0] = xyz[1] = xyz[2] = 0;
    for (int k = 0; k < 3; ++k) {
        const double y = WEIGHT[k] * rgb[k];
        xyz[0] += X_OF[k] * y;
        xyz[1] += y;
        xyz[2] += Z_OF[k] * y;
    }
}

void lum_xyz_to_rgb(const double xyz[3], double rgb[3])
{
    /* Cramer's rule for the luminances y of the three primaries: sum of x y = X, of y = Y, of z y = Z. */
    const double *x = X_OF, *z = Z_OF;
    double y[3], det = 0;
    for (int k = 0; k < 3; ++k) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        y[k] = xyz[0] * (z[b] - z[a]) + xyz[1] * (z[a] * x[b] - z[b] * x[a]) + xyz[2] * (x[a] - x[b]);
        det += x[k] * (z[b] - z[a]);
    }
    for (int k = 0; k < 3; ++k)
        rgb[k] = y[k] / (det * WEIGHT[k]);
}

bool lum_spectrum_rgb(const lum_spectrum *s, double rgb[3])
{
    double xyz[3];
    lum_spectrum_xyz(s, xyz);
    if (!(xyz[1] > 0) || !isfinite(xyz[1]))
        return false;
    const double unit[3] = {xyz[0] / xyz[1], 1, xyz[2] / xyz[1]};
    lum_xyz_to_rgb(unit, rgb);
    return true;
}

void lum_chromaticity(const double xyz[3], double xy[2], double uv[2])
{
    const double sum = xyz[0] + xyz[1] + xyz[2], d = xyz[0] + 15 * xyz[1] + 3 * xyz[2];
    xy[0] = xyz[0] / sum;
    xy[1] = xyz[1] / sum;
    uv[0] = 4 * xyz[0] / d;
    uv[1] = 9 * xyz[1] / d;
}

/* CIE 1960 u, v of the black body of 1e6 / mired kelvin. */
static void planckian_uv(double mired, double uv[2])
{
    lum_spectrum s;
    double xyz[3], xy[2];
    lum_spectrum_blackbody(1e6 / mired, &s);
    lum_spectrum_xyz(&s, xyz);
    lum_chromaticity(xyz, xy, uv);
    uv[1] *= 2.0 / 3;
}

static double distance_at(double mired, const double uv[2])
{
    double p[2];
    planckian_uv(mired, p);
    return hypot(uv[0] - p[0], uv[1] - p[1]);
}

bool lum_cct(const double xyz[3], double *kelvin, double *duv)
{
    enum { STEPS = 48 };
    const double first = 1e6 / 40000, last = 1e6 / 900, golden = 0.61803398874989485;
    double xy[2], uv[2], best = INFINITY;
    lum_chromaticity(xyz, xy, uv);
    uv[1] *= 2.0 / 3;
    int at = 0;
    for (int i = 0; i <= STEPS; ++i) {
        const double d = distance_at(first + (last - first) * i / STEPS, uv);
        if (d < best) {
            best = d;
            at = i;
        }
    }
    /* !(best <= ...): also when the colour isn't finite. */
    if (at == 0 || at == STEPS || !(best <= 0.1))
        return false;
    double a = first + (last - first) * (at - 1) / STEPS, b = first + (last - first) * (at + 1) / STEPS;
    double p = b - golden * (b - a), q = a + golden * (b - a), dp = distance_at(p, uv), dq = distance_at(q, uv);
    while (b - a > 1e-6 * last) {
        if (dp < dq) {
            b = q;
            q = p;
            dq = dp;
            p = b - golden * (b - a);
            dp = distance_at(p, uv);
        } else {
            a = p;
            p = q;
            dp = dq;
            q = a + golden * (b - a);
            dq = distance_at(q, uv);
        }
    }
    double locus[2];
    planckian_uv(0.5 * (a + b), locus);
    *kelvin = 2e6 / (a + b);
    *duv = copysign(hypot(uv[0] - locus[0], uv[1] - locus[1]), uv[1] - locus[1]);
    return *kelvin >= 1000 && *kelvin <= 25000 && fabs(*duv) <= 0.05;
}

/* --------------------------------------------------------------------------------------------------- spectra of colours */

void lum_colour_basis(double nm, double basis[3])
{
    const double x = fmin(fmax((nm - LUM_NM_FIRST) / 5, 0), LUM_TABLE_5NM - 1);
    const int i = x < LUM_TABLE_5NM - 1 ? (int)x : LUM_TABLE_5NM - 2;
    const double f = x - i;
    const double *a = lum_red_blue_table[i], *b = lum_red_blue_table[i + 1];
    basis[0] = (1 - f) * a[0] + f * b[0];
    basis[2] = (1 - f) * a[1] + f * b[1];
    const double rest = 1 - basis[0] - basis[2];
    basis[1] = rest > 0 ? rest : 0; /* rounding */
}

double lum_spectrum_peak(const lum_spectrum *s)
{
    double peak = 0;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        peak = fmax(peak, (double)s->value[i]);
    return peak;
}

void lum_spectrum_of_reflectance(const double rgb[3], lum_spectrum *out)
{
    const double least = fmin(fmin(rgb[0], rgb[1]), rgb[2]), most = fmax(fmax(rgb[0], rgb[1]), rgb[2]);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        double b[3];
        lum_colour_basis(LUM_NM_FIRST + i, b);
        /* Written so that grey is exact although the three functions add up to 1 only to rounding, and kept within R,G,B for the same
         * reason. */
        const double r = rgb[1] + (rgb[0] - rgb[1]) * b[0] + (rgb[2] - rgb[1]) * b[2];
        out->value[i] = (float)fmin(fmax(r, least), most);
    }
}

void lum_spectrum_of_light(const double rgb[3], lum_spectrum *out)
{
    lum_spectrum white;
    double xyz[3], unit[3];
    lum_spectrum_illuminant("D65", &white);
    lum_spectrum_xyz(&white, xyz);
    lum_xyz_to_rgb(xyz, unit); /* what the three functions times D65 add up to: near R = G = B */
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        double b[3];
        lum_colour_basis(LUM_NM_FIRST + i, b);
        out->value[i] =
            (float)((double)white.value[i] * (rgb[0] / unit[0] * b[0] + rgb[1] / unit[1] * b[1] + rgb[2] / unit[2] * b[2]));
    }
}
