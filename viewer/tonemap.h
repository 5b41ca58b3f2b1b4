/* SPDX-License-Identifier: Apache-2.0 */
/*
 * From luminance to a screen.
 *
 * Exposure: one luminance of the scene, "mid-grey", is shown as 18 % of the screen's white.  Automatic: the geometric mean of the
 * luminance over the picture, taken over small blocks against noise (blocks under a thousandth of the mean left out), as Reinhard
 * et al. 2002 do; or an exposure value at ISO 100, EV = log2(L / 0.125 cd/m2) (reflected-light meter constant K = 12.5); or cd/m2.
 *
 * Tone curve, on luminance x in units of screen white: y = x up to KNEE = 0.4 (there the picture is proportional to luminance),
 * above it y = KNEE + (1 - KNEE) z (1 + z / w^2) / (1 + z), z = (x - KNEE) / (1 - KNEE): joins with equal slope and reaches white,
 * 1, at z = w = 32, that is 19.6 times the luminance that would be white without the curve, 109 times mid-grey. R,G,B are scaled
 * alike, so hues stay; a colour outside what the screen can show at that luminance is mixed with grey of the same luminance just as
 * far as needed. Then the sRGB transfer function (IEC 61966-2-1) and 8 bits, with half a step of fixed noise against banding.
 */
#ifndef VIEWER_TONEMAP_H
#define VIEWER_TONEMAP_H

#include "render.h"

/* Mid-grey luminance (cd/m2) that shows the picture well; 1 for a picture without light. */
double view_exposure_auto(const view_image *image);

/* Mid-grey luminance of an exposure value at ISO 100, and back. */
double view_exposure_from_ev(double ev);
double view_exposure_to_ev(double mid_grey);

/* The tone curve on luminance in units of screen white. */
double view_tone_curve(double x);

/* One colour (linear R,G,B, cd/m2) to linear screen R,G,B in [0,1]. */
void view_tone_color(const float rgb[3], double mid_grey, double out[3]);

/* sRGB transfer function of a linear value in [0,1]. */
double view_srgb(double linear);

/* The picture as 8-bit sRGB, 3 bytes per pixel. */
void view_tonemap(const view_image *image, double mid_grey, uint8_t *bytes);

#endif
