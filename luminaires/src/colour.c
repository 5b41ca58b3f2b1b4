/* SPDX-License-Identifier: Apache-2.0 */
/* Colours of glowing bodies and optical constants of metals (colour.h). */
#include "colour.h"

#include <stddef.h>
#include <string.h>

/*
 * Chromaticity of the Planckian locus in the CIE 1960 (u,v) diagram by the rational approximation of M. Krystek, "An algorithm to
 * calculate correlated colour temperature", Color Research and Application 10 (1985) 38-40: within 8e-5 in u and 9e-5 in v of the
 * exact locus from 1000 to 15000 K.  Below about 1900 K it leaves the gamut of Rec.709 (negative blue): the light is then mixed
 * with as little white of the same luminance as brings blue to zero, because light fields hold no negative light.
 */
void lum_planckian(double kelvin, double rgb[3])
{
    double t = kelvin;
    double u = (0.860117757 + 1.54118254e-4 * t + 1.28641212e-7 * t * t) / (1 + 8.42420235e-4 * t + 7.08145163e-7 * t * t);
    double v = (0.317398726 + 4.22806245e-5 * t + 4.20481691e-8 * t * t) / (1 - 2.89741816e-5 * t + 1.61456053e-7 * t * t);
    double d = 2 * u - 8 * v + 4, x = 3 * u / d, y = 2 * v / d;
    double X = x / y, Z = (1 - x - y) / y;
    /* XYZ to linear Rec.709, D65 white (IEC 61966-2-1). */
    rgb[0] = 3.2406 * X - 1.5372 - 0.4986 * Z;
    rgb[1] = -0.9689 * X + 1.8758 + 0.0415 * Z;
    rgb[2] = 0.0557 * X - 0.2040 + 1.0570 * Z;
    double least = rgb[0] < rgb[1] ? rgb[0] : rgb[1];
    least = least < rgb[2] ? least : rgb[2];
    double keep = least < 0 ? 1 / (1 - least) : 1; /* keep * least + (1 - keep) * 1 = 0 */
    double luminance = 0;
    const double weights[3] = {0.2126, 0.7152, 0.0722};
    for (int i = 0; i < 3; i++) {
        rgb[i] = keep * rgb[i] + (1 - keep);
        rgb[i] = rgb[i] > 0 ? rgb[i] : 0; /* rounding */
        luminance += weights[i] * rgb[i];
    }
    for (int i = 0; i < 3; i++)
        rgb[i] /= luminance;
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
