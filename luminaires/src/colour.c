/* SPDX-License-Identifier: Apache-2.0 */
/* Colours of glowing bodies and optical constants of metals (colour.h). */
#include "colour.h"

#include <luminaires/spectrum.h>

#include <stddef.h>
#include <string.h>

void lum_planckian(double kelvin, double rgb[3])
{
    lum_spectrum s;
    lum_spectrum_blackbody(kelvin, &s);
    lum_spectrum_rgb(&s, rgb);
}

/*
 * Interpolated linearly in wavelength from the published tables:
 *   silver, gold, copper      P. B. Johnson, R. W. Christy, Phys. Rev. B 6 (1972) 4370
 *   chromium, nickel, iron    the same authors, Phys. Rev. B 9 (1974) 5056
 *   aluminium                 A. D. Rakic, Applied Optics 34 (1995) 4755
 *   tungsten                  J. H. Weaver, C. G. Olson, D. W. Lynch, Phys. Rev. B 12 (1975) 1293
 *   brass (70 % Cu, 30 % Zn)  M. R. Querry, Contractor Report CRDC-CR-85034 (1985)
 * For clean, smooth films; a technical surface reflects less (anodised aluminium about 0.85).  In the comment: reflectance at
 * normal incidence at the three wavelengths.
 */
static const struct {
    const char *name;
    float eta[3], k[3];
} metals[] = {
    {"aluminium", {1.314f, 1.015f, 0.686f}, {7.296f, 6.627f, 5.635f}}, /* 0.910 0.915 0.921 */
    {"silver", {0.058f, 0.060f, 0.047f}, {4.094f, 3.597f, 2.803f}},    /* 0.987 0.983 0.979 */
    {"gold", {0.226f, 0.424f, 1.332f}, {3.192f, 2.472f, 1.869f}},      /* 0.923 0.792 0.404 */
    {"copper", {0.378f, 1.007f, 1.247f}, {3.107f, 2.582f, 2.456f}},    /* 0.869 0.624 0.550 */
    {"chromium", {3.180f, 3.181f, 2.456f}, {3.300f, 3.329f, 3.210f}},  /* 0.552 0.555 0.558 */
    {"nickel", {1.984f, 1.921f, 1.765f}, {3.976f, 3.616f, 3.048f}},    /* 0.679 0.644 0.583 */
    {"iron", {2.892f, 2.950f, 2.646f}, {3.038f, 2.932f, 2.805f}},      /* 0.525 0.512 0.500 */
    {"tungsten", {3.576f, 3.522f, 3.325f}, {2.879f, 2.741f, 2.574f}},  /* 0.511 0.496 0.475 */
    {"brass", {0.452f, 0.527f, 0.947f}, {3.345f, 2.765f, 1.920f}},     /* 0.864 0.789 0.493 */
};

const char *lum_metal_name(const char *name)
{
    static const char *const symbols[][2] = {{"Al", "aluminium"}, {"Ag", "silver"}, {"Au", "gold"}, {"Cu", "copper"},
                                             {"Cr", "chromium"},  {"Ni", "nickel"}, {"Fe", "iron"}, {"W", "tungsten"}};
    for (size_t i = 0; i < sizeof symbols / sizeof *symbols; i++)
        if (strcmp(name, symbols[i][0]) == 0)
            return symbols[i][1];
    return name;
}

bool lum_metal(const char *name, float eta[3], float k[3])
{
    for (size_t i = 0; i < sizeof metals / sizeof *metals; i++)
        if (strcmp(name, metals[i].name) == 0) {
            memcpy(eta, metals[i].eta, sizeof metals[i].eta);
            memcpy(k, metals[i].k, sizeof metals[i].k);
            return true;
        }
    return false;
}

const char *lum_metal_names(void)
{
    return "aluminium, silver, gold, copper, chromium, nickel, iron, tungsten, brass";
}
