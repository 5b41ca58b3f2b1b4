/* SPDX-License-Identifier: Apache-2.0 */
/* Colours that recipes name: of glowing bodies by temperature, of metals by name. */
#ifndef LUMINAIRES_COLOUR_H
#define LUMINAIRES_COLOUR_H

#include <stdbool.h>

/* Range of lum_planckian, kelvin. */
#define LUM_KELVIN_MIN 1000.0
#define LUM_KELVIN_MAX 25000.0

/* Linear Rec.709 R,G,B of luminance 1 of a black body, LUM_KELVIN_MIN..LUM_KELVIN_MAX.  Below about 1900 K it is outside the gamut: blue is
 * negative. */
void lum_planckian(double kelvin, double rgb[3]);

/* The name of a metal that may be given by its chemical symbol ("Al"); other names as they are. */
const char *lum_metal_name(const char *name_or_symbol);

/* Complex index eta - i k of a metal, by name, at 610, 550 and 465 nm; false for a name it doesn't know. */
bool lum_metal(const char *name, float eta[3], float k[3]);

/* The names it knows, separated by ", ". */
const char *lum_metal_names(void);

#endif
