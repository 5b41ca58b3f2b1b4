/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Spectra: of light sources, reflectances, refractive indices; the CIE 1931 observer; colours of spectra and spectra of colours.
 *
 * A lum_spectrum is a value: samples at every nanometre from 360 to 830 nm, where the CIE 1931 observer is defined, linear between
 * them.  Light outside that range isn't visible and isn't kept.  Wavelengths are in air, nm.
 *
 * Colours are linear Rec.709 R,G,B (D65 white), with the primaries' chromaticities exact and the luminance weights 0.2126, 0.7152,
 * 0.0722 that all of Lumibox uses, so that lum_xyz_to_rgb keeps Y to rounding.  Colours of narrow spectra are outside of the
 * gamut: components below zero are kept.
 */
#ifndef LUMINAIRES_SPECTRUM_H
#define LUMINAIRES_SPECTRUM_H

#include <lumigraph/lumigraph.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { LUM_NM_FIRST = 360, LUM_NM_LAST = 830, LUM_SPECTRUM_COUNT = LUM_NM_LAST - LUM_NM_FIRST + 1 };

typedef struct lum_spectrum {
    float value[LUM_SPECTRUM_COUNT]; /* at LUM_NM_FIRST + i nm */
} lum_spectrum;

/* Value at a wavelength; 0 outside the range. */
static inline double lum_spectrum_at(const lum_spectrum *s, double nm)
{
    const double x = nm - LUM_NM_FIRST;
    if (!(x >= 0 && x <= LUM_SPECTRUM_COUNT - 1))
        return 0;
    const int i = x < LUM_SPECTRUM_COUNT - 1 ? (int)x : LUM_SPECTRUM_COUNT - 2;
    const double f = x - i;
    return (double)s->value[i] + f * ((double)s->value[i + 1] - (double)s->value[i]);
}

/* ------------------------------------------------------------------------------------------------------------- making */

/* What a table means beyond its ends. */
typedef enum lum_spectrum_end {
    LUM_SPECTRUM_ZERO, /* power of a source: nothing there */
    LUM_SPECTRUM_HOLD  /* a property of matter: as at the end; the table has to cover 400 .. 700 nm at least */
} lum_spectrum_end;

/*
 * A spectrum from a table of wavelengths (nm, increasing) and values, linear between the rows.  Rows closer than 1 nm are averaged
 * in such a way that integrals are kept.  low, high: the range that values must be in.  Errors (LMG_ERROR_INPUT) name the row:
 * non-finite or out of range values, wavelengths that don't increase, a gap (a step of more than 10 nm that is more than three
 * times the usual one), a property that isn't covered, a source without light between 360 and 830 nm.
 */
lmg_result lum_spectrum_from_table(const double *nm, const double *values, size_t count, lum_spectrum_end end, double low,
                                   double high, lum_spectrum *out, lmg_error *err);

/*
 * Reads a table from a file of one of these forms, told apart by the content:
 * - text: rows of wavelength (nm) and value, separated by commas, semicolons, blanks or tabs; lines before the first row and empty
 *   ones are a header; `#` begins a comment (CSV of spectrometers; LightTools and LED makers' spectra);
 * - JSON: {"lambda_nm": [first, last, step] or a list, "values": [...]}, as the public tables of CIE illuminants have it.
 * Errors name the file and the line.  `bytes` reads the same from memory.
 */
lmg_result lum_spectrum_read(const char *path, lum_spectrum_end end, double low, double high, lum_spectrum *out, lmg_error *err);
lmg_result lum_spectrum_parse(const void *bytes, size_t size, lum_spectrum_end end, double low, double high, lum_spectrum *out,
                              lmg_error *err);

/* Relative power of a black body (Planck), 500 .. 100000 K, 1 at 560 nm. */
#define LUM_BLACKBODY_MIN 500.0
#define LUM_BLACKBODY_MAX 100000.0
void lum_spectrum_blackbody(double kelvin, lum_spectrum *out);

/* Relative power of CIE daylight of a correlated colour temperature, 4000 .. 25000 K, 100 at 560 nm (CIE 15:2004, 3.1).  D65 is
 * that of 6500 x 1.4388/1.4380 K, with the method's rounding of its factors to three decimals. */
#define LUM_DAYLIGHT_MIN 4000.0
#define LUM_DAYLIGHT_MAX 25000.0
void lum_spectrum_daylight(double kelvin, lum_spectrum *out);

/* A Gaussian line: peak 1 at `peak` nm, full width at half maximum `width` nm.  A stand-in for a coloured LED. */
void lum_spectrum_gaussian(double peak, double width, lum_spectrum *out);

/* CIE illuminants by name: A, E, D50, D55, D65, D75.  False for another name. */
bool lum_spectrum_illuminant(const char *name, lum_spectrum *out);
const char *lum_spectrum_illuminant_names(void);

/* -------------------------------------------------------------------------------------------------------------- colour */

/* CIE 1931 2-degree colour matching functions: the table at 5 nm (CIE 15:2004), third-degree Lagrange between (within 0.0024 of
 * CIE's table at 1 nm, its integrals within 1e-6).  0 outside 360 .. 830 nm. */
void lum_observer(double nm, double xyz[3]);

/* Integral of S (x, y, z) dnm. */
void lum_spectrum_xyz(const lum_spectrum *s, double xyz[3]);

/* Luminous efficacy, lm/W: 683 Y / integral of S. */
double lum_spectrum_efficacy(const lum_spectrum *s);

void lum_xyz_to_rgb(const double xyz[3], double rgb[3]);
void lum_rgb_to_xyz(const double rgb[3], double xyz[3]);

/* R,G,B of luminance 1.  False if the spectrum has no visible light. */
bool lum_spectrum_rgb(const lum_spectrum *s, double rgb[3]);

/* Colour of light under the CIE 1960 uniform chromaticity scale: temperature of the nearest black body, and the distance from it,
 * positive above the locus (towards green), as ANSI C78.377 has it.  Found by search on the exact locus, to 1e-6 in reciprocal
 * temperature (MK^-1 x 1e6).  False outside 1000 .. 25000 K or |duv| > 0.05, where the CIE doesn't define it. */
bool lum_cct(const double xyz[3], double *kelvin, double *duv);
#define LUM_CCT_LIMIT 0.05 /* of duv: light farther from the locus has no colour temperature to speak of (CIE 15:2004) */

/* CIE 1931 x, y and CIE 1976 u', v'. */
void lum_chromaticity(const double xyz[3], double xy[2], double uv[2]);

/* --------------------------------------------------------------------------------------------------- spectra of colours */

/*
 * Reflectances that have a given colour: r(nm) = R b_R + G b_G + B b_B.  The three functions are in [0,1] and add up to 1, so any
 * R,G,B in [0,1] gives a reflectance in [0,1], grey gives grey exactly, and mixing colours mixes spectra.  They are the smoothest
 * (least squared steps) that return R,G,B under D65 to 3e-7: the idea of [mallett2019spectral], solved anew on this grid.
 */
void lum_colour_basis(double nm, double basis[3]);
void lum_spectrum_of_reflectance(const double rgb[3], lum_spectrum *out);

/* Light of a given colour: the same functions times D65, each scaled so that R,G,B comes back to rounding; luminance 1 for
 * R = G = B = 1.  Negative where R,G,B is outside the gamut. */
void lum_spectrum_of_light(const double rgb[3], lum_spectrum *out);

/* ---------------------------------------------------------------------------------------------------- refractive index */

typedef enum lum_index_kind {
    LUM_INDEX_SELLMEIER, /* n^2 = 1 + sum of B_i l^2 / (l^2 - C_i), three terms; B_1 C_1 B_2 C_2 B_3 C_3; C in um^2 */
    LUM_INDEX_CAUCHY,    /* n = A + B / l^2 + C / l^4; A, B (um^2), C (um^4) */
    LUM_INDEX_ABBE       /* n_d, V_d: A + B / l^2 with V = (n_d - 1)/(n_F - n_C), as KHR_materials_dispersion means it */
} lum_index_kind;

typedef struct lum_index_model {
    lum_index_kind kind;
    double c[6];
} lum_index_model;

/* Fraunhofer lines, nm: hydrogen F and C, helium d. */
#define LUM_NM_F 486.1327
#define LUM_NM_D 587.5618
#define LUM_NM_C 656.2725

double lum_index_at(const lum_index_model *model, double nm);

/* Index over the whole range.  Error (LMG_ERROR_INPUT): not finite, or outside 1 .. 4, somewhere in 360 .. 830 nm, with the place. */
lmg_result lum_spectrum_of_index(const lum_index_model *model, lum_spectrum *out, lmg_error *err);

/* Glasses and plastics by name ("N-BK7", "fused-silica", "PMMA", ...).  False for another name. */
bool lum_index_of_glass(const char *name, lum_index_model *out);
const char *lum_glass_names(void);

/* Complex index eta - i k of metals by name, over the whole range; names as lum_metal_names (colour.h).  False for another name. */
bool lum_spectrum_of_metal(const char *name, lum_spectrum *eta, lum_spectrum *k);

/* ------------------------------------------------------------------------------------------------------- of a material */

/* The largest value. */
double lum_spectrum_peak(const lum_spectrum *s);

/* What a material is by wavelength, where that is known better than by R,G,B; NULL = not.  The model owns what they point to. */
typedef struct lum_spectral {
    const lum_spectrum *emission;      /* relative power of what lum_material.emissive gives in cd/m2 */
    bool measured;                     /* that is a spectrum of its own, not the one that goes with a colour temperature */
    const lum_spectrum *index;         /* refractive index; lum_material.ior is its value at the d line */
    const lum_spectrum *absorption;    /* 1/m inside a solid; of "medium" too */
    const lum_spectrum *scattering;    /* 1/m inside a solid ("medium") */
    const lum_spectrum *reflectance;   /* of "diffuse", "diffuse_transmission", "phosphor" and "mirror" */
    const lum_spectrum *transmittance; /* of "diffuse_transmission", "phosphor" */
    const lum_spectrum *eta, *k;       /* of "conductor" */
    const lum_spectrum *excitation;    /* "phosphor": share of the light that meets it that is absorbed by the phosphor */
    const lum_spectrum *converted;     /* "phosphor": relative power of its emission */
    float quantum_yield, forward;      /* "phosphor": photons emitted per photon absorbed; share of them emitted to the far side */
    bool fills;                        /* the phosphor isn't a layer, its particles fill the solid: excitation is in 1/m, beside the absorption */
} lum_spectral;

#ifdef __cplusplus
}
#endif
#endif
