/* SPDX-License-Identifier: Apache-2.0 */
/* Refractive indices by wavelength: dispersion formulae, glasses and plastics, metals. */
#include <luminaires/spectrum.h>

#include "colour.h"

#include <math.h>
#include <string.h>

double lum_index_at(const lum_index_model *model, double nm)
{
    const double *c = model->c, l2 = 1e-6 * nm * nm; /* um^2 */
    switch (model->kind) {
    case LUM_INDEX_SELLMEIER: {
        double n2 = 1;
        for (int i = 0; i < 6; i += 2)
            n2 += c[i] != 0 ? c[i] * l2 / (l2 - c[i + 1]) : 0;
        return sqrt(n2);
    }
    case LUM_INDEX_CAUCHY:
        return c[0] + c[1] / l2 + c[2] / (l2 * l2);
    case LUM_INDEX_ABBE:
    default: {
        const double f = 1e6 / (LUM_NM_F * LUM_NM_F), d = 1e6 / (LUM_NM_D * LUM_NM_D), line_c = 1e6 / (LUM_NM_C * LUM_NM_C);
        const double b = (c[0] - 1) / (c[1] * (f - line_c));
        return c[0] + b * (1 / l2 - d);
    }
    }
}

lmg_result lum_spectrum_of_index(const lum_index_model *model, lum_spectrum *out, lmg_error *err)
{
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i, n = lum_index_at(model, nm);
        if (!(n >= 1 && n <= 4))
            return lmg_fail(err, LMG_ERROR_INPUT, "the refractive index comes to %g at %g nm, outside [1, 4]", n, nm);
        out->value[i] = (float)n;
    }
    return LMG_OK;
}

/*
 * Room temperature, relative to air.
 *   N-BK7, N-F2, N-SF10, N-SF11    SCHOTT optical glass catalogue, 2017-01-20
 *   B270                           SCHOTT data sheet of 1993 (n_F, n_d, n_C)
 *   fused-silica                   I. H. Malitson, J. Opt. Soc. Am. 55 (1965) 1205
 *   sapphire (ordinary ray)        I. H. Malitson, J. Opt. Soc. Am. 52 (1962) 1377
 *   PMMA, polycarbonate            N. Sultanova, S. Kasarova, I. Nikolov, Acta Phys. Polonica A 116 (2009) 585; 437 .. 1052 nm
 *   silicone (Sylgard 184)         F. Schneider et al., Sensors and Actuators A 151 (2009) 95
 */
static const struct {
    const char *name;
    lum_index_model model;
} glasses[] = {
    {"N-BK7", {LUM_INDEX_SELLMEIER, {1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653}}},
    {"N-F2", {LUM_INDEX_SELLMEIER, {1.39757037, 0.00995906143, 0.159201403, 0.0546931752, 1.2686543, 119.248346}}},
    {"N-SF10", {LUM_INDEX_SELLMEIER, {1.62153902, 0.0122241457, 0.256287842, 0.0595736775, 1.64447552, 147.468793}}},
    {"N-SF11", {LUM_INDEX_SELLMEIER, {1.73759695, 0.013188707, 0.313747346, 0.0623068142, 1.89878101, 155.23629}}},
    {"B270", {LUM_INDEX_ABBE, {1.5230, 58.76}}},
    {"fused-silica",
     {LUM_INDEX_SELLMEIER,
      {0.6961663, 0.0684043 * 0.0684043, 0.4079426, 0.1162414 * 0.1162414, 0.8974794, 9.896161 * 9.896161}}},
    {"sapphire",
     {LUM_INDEX_SELLMEIER,
      {1.4313493, 0.0726631 * 0.0726631, 0.65054713, 0.1193242 * 0.1193242, 5.3414021, 18.028251 * 18.028251}}},
    {"PMMA", {LUM_INDEX_SELLMEIER, {1.1819, 0.011313}}},
    {"polycarbonate", {LUM_INDEX_SELLMEIER, {1.4182, 0.021304}}},
    {"silicone", {LUM_INDEX_SELLMEIER, {1.0093, 0.013185}}},
};

bool lum_index_of_glass(const char *name, lum_index_model *out)
{
    for (size_t i = 0; i < sizeof glasses / sizeof *glasses; ++i)
        if (strcmp(name, glasses[i].name) == 0) {
            *out = glasses[i].model;
            return true;
        }
    return false;
}

const char *lum_glass_names(void)
{
    return "N-BK7, N-F2, N-SF10, N-SF11, B270, fused-silica, sapphire, PMMA, polycarbonate, silicone";
}

/* nm, n, k.  Sources: colour.c. */
static const double silver[][3] = {
    {342.5, 0.14, 1.142}, {354.2, 0.1, 1.419}, {367.9, 0.07, 1.657}, {381.5, 0.05, 1.864}, {397.4, 0.05, 2.07},
    {413.3, 0.05, 2.275}, {430.5, 0.04, 2.462}, {450.9, 0.04, 2.657}, {471.4, 0.05, 2.869}, {495.9, 0.05, 3.093},
    {520.9, 0.05, 3.324}, {548.6, 0.06, 3.586}, {582.1, 0.05, 3.858}, {616.8, 0.06, 4.152}, {659.5, 0.05, 4.483},
    {704.5, 0.04, 4.838}, {756, 0.03, 5.242}, {821.1, 0.04, 5.727},
};
static const double gold[][3] = {
    {342.5, 1.48, 1.871}, {354.2, 1.5, 1.866}, {367.9, 1.48, 1.895}, {381.5, 1.46, 1.933}, {397.4, 1.47, 1.952},
    {413.3, 1.46, 1.958}, {430.5, 1.45, 1.948}, {450.9, 1.38, 1.914}, {471.4, 1.31, 1.849}, {495.9, 1.04, 1.833},
    {520.9, 0.62, 2.081}, {548.6, 0.43, 2.455}, {582.1, 0.29, 2.863}, {616.8, 0.21, 3.272}, {659.5, 0.14, 3.697},
    {704.5, 0.13, 4.103}, {756, 0.14, 4.542}, {821.1, 0.16, 5.083},
};
static const double copper[][3] = {
    {342.5, 1.36, 1.864}, {354.2, 1.37, 1.916}, {367.9, 1.36, 1.975}, {381.5, 1.33, 2.045}, {397.4, 1.32, 2.116},
    {413.3, 1.28, 2.207}, {430.5, 1.25, 2.305}, {450.9, 1.24, 2.397}, {471.4, 1.25, 2.483}, {495.9, 1.22, 2.564},
    {520.9, 1.18, 2.608}, {548.6, 1.02, 2.577}, {582.1, 0.7, 2.704}, {616.8, 0.3, 3.205}, {659.5, 0.22, 3.747},
    {704.5, 0.21, 4.205}, {756, 0.24, 4.665}, {821.1, 0.26, 5.18},
};
static const double chromium[][3] = {
    {342, 1.76, 2.58}, {354, 1.84, 2.64}, {368, 1.87, 2.69}, {381, 1.92, 2.74}, {397, 2, 2.83}, {413, 2.08, 2.93},
    {431, 2.19, 3.04}, {451, 2.33, 3.14}, {471, 2.51, 3.24}, {496, 2.75, 3.3}, {521, 2.94, 3.33}, {549, 3.18, 3.33},
    {582, 3.22, 3.3}, {617, 3.17, 3.3}, {659, 3.09, 3.34}, {704, 3.05, 3.39}, {756, 3.08, 3.42}, {821, 3.2, 3.48},
};
static const double nickel[][3] = {
    {342, 1.78, 2.26}, {354, 1.74, 2.32}, {368, 1.7, 2.4}, {381, 1.72, 2.48}, {397, 1.72, 2.57}, {413, 1.7, 2.69},
    {431, 1.71, 2.82}, {451, 1.73, 2.95}, {471, 1.78, 3.09}, {496, 1.82, 3.25}, {521, 1.85, 3.42}, {549, 1.92, 3.61},
    {582, 1.96, 3.8}, {617, 1.99, 4.02}, {659, 1.99, 4.26}, {704, 2.06, 4.5}, {756, 2.13, 4.73}, {821, 2.26, 4.97},
};
static const double aluminium[][3] = {
    {364.66, 0.39877, 4.3957}, {413.28, 0.52135, 5.0008}, {442.8, 0.6079, 5.3676}, {476.87, 0.7278, 5.7781},
    {516.6, 0.8734, 6.2418}, {563.57, 1.0728, 6.7839}, {619.93, 1.366, 7.4052}, {652.25, 1.5724, 7.7354},
    {688.81, 1.8301, 8.0601}, {729.32, 2.1606, 8.3565}, {774.91, 2.6154, 8.4914}, {794.78, 2.7675, 8.3866},
    {815.69, 2.7668, 8.2573}, {837.74, 2.6945, 8.1878},
};

bool lum_spectrum_of_metal(const char *name, lum_spectrum *eta, lum_spectrum *k)
{
    static const struct {
        const char *name;
        const double (*rows)[3];
        int count;
    } metals[] = {{"silver", silver, sizeof silver / sizeof *silver},
                  {"gold", gold, sizeof gold / sizeof *gold},
                  {"copper", copper, sizeof copper / sizeof *copper},
                  {"chromium", chromium, sizeof chromium / sizeof *chromium},
                  {"nickel", nickel, sizeof nickel / sizeof *nickel},
                  {"aluminium", aluminium, sizeof aluminium / sizeof *aluminium}};
    double three[3][3];
    const double(*rows)[3] = NULL;
    int count = 0;
    for (size_t i = 0; i < sizeof metals / sizeof *metals; ++i)
        if (strcmp(name, metals[i].name) == 0) {
            rows = metals[i].rows;
            count = metals[i].count;
        }
    float e[3], x[3];
    if (!rows && lum_metal(name, e, x)) {
        /* Known at three wavelengths only. */
        static const double nm[3] = {465, 550, 610};
        for (int i = 0; i < 3; ++i) {
            three[i][0] = nm[i];
            three[i][1] = (double)e[2 - i];
            three[i][2] = (double)x[2 - i];
        }
        rows = (const double(*)[3])three;
        count = 3;
    }
    if (!rows)
        return false;
    for (int i = 0, row = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        while (row < count - 2 && rows[row + 1][0] < nm)
            ++row;
        const double f = fmin(fmax((nm - rows[row][0]) / (rows[row + 1][0] - rows[row][0]), 0), 1);
        eta->value[i] = (float)((1 - f) * rows[row][1] + f * rows[row + 1][1]);
        k->value[i] = (float)((1 - f) * rows[row][2] + f * rows[row + 1][2]);
    }
    return true;
}
