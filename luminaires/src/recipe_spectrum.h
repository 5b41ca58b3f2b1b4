/* SPDX-License-Identifier: Apache-2.0 */
/* Spectra in recipes: the values of keys that may be given by wavelength (docs/recipe.md, "Spectra"). */
#ifndef LUMINAIRES_RECIPE_SPECTRUM_H
#define LUMINAIRES_RECIPE_SPECTRUM_H

#include "recipe.h"
#include "recipe_reader.h"

/* The power of a light: a name or an object.  Whether the key is there and right; the recipe owns *out. */
bool lum_reader_light(lum_reader *r, const char *key, const lum_spectrum **out);

/* Power of a black body, and complex index of a metal that lum_metal knows. */
const lum_spectrum *lum_reader_blackbody(lum_reader *r, double kelvin);
void lum_reader_metal(lum_reader *r, const char *name, const lum_spectrum **eta, const lum_spectrum **k);

/* A property of matter, each value in [low, high]: a number, [R, G, B], or a spectrum, of which rgb gets the values at 610, 550 and 465 nm.
 * *out: NULL where it isn't a spectrum. */
bool lum_reader_property(lum_reader *r, const char *key, double low, double high, float rgb[3], const lum_spectrum **out);

/* The same for a reflectance or transmittance, [0,1]; rgb gets its colour under D65, within [0,1]. */
bool lum_reader_reflectance(lum_reader *r, const char *key, float rgb[3], const lum_spectrum **out);

/* "ior" of a number with or without "abbe", a glass's name, a dispersion formula or a spectrum.  *ior: at the d line. */
bool lum_reader_index(lum_reader *r, double *ior, const lum_spectrum **out);

/* "reflectance" and "transmittance" of a layer that scatters diffusely to both sides.  by_wavelength: as spectra in any case. */
void lum_recipe_read_layer(lum_reader *in, lum_recipe_entry *e, bool by_wavelength);

/* Puts a spectrum into the recipe, which owns it; NULL after an error. */
const lum_spectrum *lum_reader_keep(lum_reader *r, const lum_spectrum *s);

/* "phosphor" of a medium, absorbing at most so much, 1/m: whether it is there. */
bool lum_recipe_read_filling(lum_reader *r, double most, lum_spectral *s);

/* "phosphor". */
void lum_recipe_read_phosphor(lum_reader *r, lum_recipe_entry *e);

#endif
