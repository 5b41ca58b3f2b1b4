/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What a path from the eye carries: how much of the light that it will meet counts, per band.
 *
 * In most scenes the bands are R,G,B.  Where something in the scene spreads or converts light or acts on it by a spectrum
 * (lum_model_is_spectral), they are wavelengths (luminaires/waves.h), drawn as a photon of D65 would carry them; light of another
 * spectrum is weighed by what it has over D65.  Each wavelength remembers the R,G,B that the eye sees of it, or, behind a phosphor,
 * of what the phosphor made of it.
 */
#ifndef VIEWER_VIEW_BANDS_H
#define VIEWER_VIEW_BANDS_H

#include "view_scene.h"

typedef struct view_bands {
    uint32_t count;                /* 3, or of waves */
    const lum_wave_tables *tables; /* NULL: the bands are R,G,B, and the rest isn't used */
    double beta[LUM_WAVES];        /* throughput */
    double response[LUM_WAVES][3]; /* R,G,B of light of luminance 1 in a band */
    lum_waves waves;               /* share isn't kept up */
    double importance;             /* at the start */
} view_bands;

/* A path's beginning; tables: NULL for R,G,B. */
void view_bands_begin(view_bands *bands, const lum_wave_tables *tables, lum_rng *rng);

/* R,G,B of light (LUM_NONE), or light of an emitter of a model with these tables, in the bands. */
void view_bands_light(const view_bands *bands, const lum_wave_tables *tables, int32_t material, const float rgb[3],
                      double light[LUM_WAVES]);

/* Adds beta light factor to R,G,B. */
void view_bands_add(const view_bands *bands, const double light[LUM_WAVES], double factor, double sum[3]);

/* What of R,G,B scattering applies to the bands; rgb: weights in [0,1] (lum_scattered). */
void view_bands_scattered(const view_bands *bands, const lum_wave_tables *tables, int32_t material, bool reflected,
                          const float rgb[3], double out[LUM_WAVES]);

/* Transmittance (Beer-Lambert, scattering included) of the inside of a solid over a distance. */
void view_bands_transmittance(const view_bands *bands, const view_medium *medium, double distance, double out[LUM_WAVES]);

/* What factors of R,G,B that come from volumes (lum_volumes) are in the bands. */
void view_bands_factors(const view_bands *bands, const double rgb[3], double out[LUM_WAVES]);

/* A flight through the scattering inside of a solid, or, with medium NULL, through volumes along a ray: passes length or ends at
 * flight->t; beta is updated.  False when the light on that way is absorbed. */
bool view_bands_fly(view_bands *bands, const view_medium *medium, const lum_volumes *volumes, lmg_vec3 origin, lmg_vec3 direction,
                    double length, lum_rng *rng, lum_flight *flight);

/* One wavelength goes on alone. */
void view_bands_choose(view_bands *bands, double u);

/* Whether light that a phosphor emits is followed back to what it absorbed, and not light that it scatters; beta and the
 * wavelengths are updated for either. */
bool view_bands_convert(view_bands *bands, const lum_wave_tables *tables, const lum_phosphor *phosphor, lum_rng *rng);

/* What is left of the path, about 1 at the start: for Russian roulette. */
double view_bands_carried(const view_bands *bands);

#endif
