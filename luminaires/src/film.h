/* SPDX-License-Identifier: Apache-2.0 */
/* Colours of thin films: reflectance of a film on a surface in R,G,B. */
#ifndef LUMINAIRES_FILM_H
#define LUMINAIRES_FILM_H

#include <luminaires/scatter.h>

/* Steps of the table below, nm of path difference; beyond its end nothing of the interference is left in R,G,B. */
enum { LUM_FILM_STEP = 10, LUM_FILM_STEPS = 2000 };

/* Mean of cos(2 pi x / wavelength) over what the eye sees as R,G,B under D65, by the path difference x. */
typedef struct lum_film_table {
    float mean[LUM_FILM_STEPS + 1][3];
} lum_film_table;

void lum_film_table_fill(lum_film_table *table);

/*
 * Reflectance of unpolarized light, cosine c in [0,1] outside, by a film of index n (relative to outside) and thickness nm on an
 * opaque or clear base whose own reflectance at normal incidence from outside is f0 (R,G,B, [0,1]): the base has the real index
 * (1 + sqrt f0) / (1 - sqrt f0), as KHR_materials_iridescence has it.  All reflections inside the film are summed (Airy
 * [born1999optics, ch. 7.6]), integrated over the spectrum and cut to [0,1], which the colours of some films exceed by being
 * outside of the gamut.
 */
void lum_film_reflectance(const lum_film_table *table, double c, double n, double nm, const float f0[3], float out[3]);

#endif
