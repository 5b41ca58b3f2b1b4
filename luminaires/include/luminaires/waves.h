/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Light by wavelength, for what follows light.
 *
 * A spectral path carries several wavelengths at once (LUM_WAVES, spread evenly over the spectrum of its emitter), each with a
 * share of its luminance.  Whatever treats all of them alike in direction - emission, reflection, absorption - weighs the shares;
 * where the direction depends on the wavelength one of them goes on alone [wilkie2014hero].
 *
 * The eye sees little of deep blue and red, so photons of equal luminance would carry almost all of the blue of a picture in a few
 * of them.  Wavelengths are therefore drawn in proportion to an *importance* per luminance, mu(nm) = (0.5 y + 0.2 x / Xw + 0.3 z /
 * Zw) / y with D65's Xw, Zw at Yw = 1: half for the luminance, half for the colour, so that luminances stay below twice the mean
 * while a light's blue or red has at most a few times the variance of its luminance.  Where a phosphor converts light, what it would
 * become counts too: its luminance.  So a path's luminance isn't always 1: its importance stays about the same.
 */
#ifndef LUMINAIRES_WAVES_H
#define LUMINAIRES_WAVES_H

#include <luminaires/medium.h>
#include <luminaires/model.h>

enum { LUM_WAVES = 8, LUM_WAVE_KNOTS = 128 };

/* The wavelengths of a path: count is LUM_WAVES, or 1 after its light was spread. */
typedef struct lum_waves {
    uint32_t count;
    float nm[LUM_WAVES];
    float share[LUM_WAVES];      /* of the path's luminance; together 1 */
    float importance[LUM_WAVES]; /* mu */
} lum_waves;

/* A spectrum to draw wavelengths from. */
typedef struct lum_wave_light {
    lum_spectrum luminance;                        /* per nm, integral 1 */
    float knots[LUM_WAVES * LUM_WAVE_KNOTS + 1]; /* nm; equal steps of importance */
    double efficacy;                               /* lm/W */
    double mean_nm;                                /* of the power */
} lum_wave_light;

/* What converts light, a thin layer or particles in a medium: see lum_spectral. */
typedef struct lum_phosphor {
    const lum_spectrum *excitation;
    lum_wave_light light;
    double gain;       /* luminance emitted per luminance absorbed, times y over nm at the wavelength absorbed */
    double importance; /* mean of mu over the emitted luminance */
    double forward;
} lum_phosphor;

/* How to weigh what a surface leaves of light, beside the R,G,B that scattering gives. */
typedef enum lum_tint {
    LUM_TINT_RGB,       /* R,G,B stands for a spectrum (lum_colour_basis) */
    LUM_TINT_DIFFUSE,   /* reflectance and transmittance by wavelength */
    LUM_TINT_MIRROR,    /* reflectance by wavelength at all angles */
    LUM_TINT_CONDUCTOR  /* complex index by wavelength */
} lum_tint;

typedef struct lum_wave_material {
    lum_tint tint;
    bool refracts; /* boundary of a solid whose index depends on the wavelength */
    const lum_spectrum *index, *absorption, *scattering;
    lum_spectrum reflectance, transmittance; /* as the tint needs them; of the diffuse ones, over the chance of either side */
    float rgb_reflectance[3];                /* what R,G,B scattering takes for it */
    int brightest;                           /* of these, for mirrors */
    lum_wave_light *emission;                    /* NULL: its R,G,B */
    lum_phosphor *phosphor;                 /* a layer; NULL: none */
    lum_phosphor *filling;                  /* of a solid; NULL: none */
} lum_wave_material;

typedef struct lum_wave_tables {
    uint32_t material_count;
    lum_wave_material *materials;
    lum_spectrum basis[3];   /* lum_colour_basis */
    lum_spectrum observer;   /* y */
    lum_spectrum colour[3];  /* linear Rec.709 of monochromatic light of luminance y */
    lum_spectrum importance; /* mu */
    lum_wave_light white;        /* D65 */
    double white_rgb[3];     /* what basis times white add up to, of luminance 1 */
} lum_wave_tables;

/* Whether light in the model has to be followed by wavelength: something in it spreads light, converts it, or acts on it by a
 * spectrum rather than by R,G,B. */
bool lum_model_is_spectral(const lum_model *model);

/* The tables of a model, borrowed until destroy. */
lmg_result lum_wave_tables_create(const lum_model *model, lum_wave_tables **out, lmg_error *err);
void lum_wave_tables_destroy(lum_wave_tables *spectral);

/* Draws wavelengths for light of an emitter: of material's spectrum, or of R,G,B with luminance 1.  u in [0,1).  Returns the path's
 * luminance, of mean 1; 0 if there is none at these wavelengths. */
double lum_waves_emit(const lum_wave_tables *spectral, int32_t material, const float rgb[3], double u, lum_waves *out);

/* The same from a light's spectrum. */
double lum_waves_draw(const lum_wave_tables *spectral, const lum_wave_light *light, double u, lum_waves *out);

/*
 * For paths followed from the eye, which carry waves as if they came from D65 (lum_waves_draw of `white`): what light of an emitter
 * has at these waves, over D65 of luminance 1.  Light of material's spectrum if it has one (LUM_NONE: none), with the luminance of
 * R,G,B, else of R,G,B.  lum_waves_converted: the same for what a phosphor emits, of luminance 1.
 */
void lum_waves_lit(const lum_wave_tables *tables, int32_t material, const float rgb[3], const lum_waves *waves,
                   double light[LUM_WAVES]);
void lum_waves_converted(const lum_wave_tables *tables, const lum_phosphor *phosphor, const lum_waves *waves,
                         double light[LUM_WAVES]);

/* R,G,B of one wavelength at luminance 1. */
void lum_wave_rgb(const lum_wave_tables *tables, double nm, double rgb[3]);

/* Luminance that a phosphor emits per luminance that it absorbs at a wavelength. */
static inline double lum_phosphor_gain(const lum_wave_tables *spectral, const lum_phosphor *phosphor, double nm)
{
    return phosphor->gain * nm / lum_spectrum_at(&spectral->observer, nm);
}

/* R,G,B of the waves at luminance 1. */
void lum_waves_rgb(const lum_wave_tables *spectral, const lum_waves *waves, double rgb[3]);

/* What a surface leaves of each wave: by its spectra, or by R,G,B.  reflected: as against transmitted. */
void lum_waves_scattered(const lum_wave_tables *spectral, int32_t material, bool reflected, const float rgb[3], const lum_waves *waves,
                          float share[LUM_WAVES]);

/* Scattering coefficient inside a solid, 1/m. */
double lum_waves_scattering(const lum_wave_tables *spectral, int32_t material, const lum_medium *medium, double nm);

/* What the inside of a solid leaves along a length, metres, of light that isn't scattered; absorption in R,G,B where it has no spectrum. */
void lum_waves_absorbed(const lum_wave_tables *spectral, int32_t material, const double absorption[3], double length,
                         const lum_waves *waves, float share[LUM_WAVES]);

/*
 * A flight of the waves through a homogeneous medium inside a solid (spectra, where it has them, or coefficients in R,G,B that stand for spectra): passes
 * `length` or ends in a collision at *t.  Distances are drawn for the mixture of the waves, in proportion to importance; share: what
 * that leaves of each wave, on average over the flights exactly the medium's (the balance heuristic [miller2019null], as lum_medium_fly
 * has it); taken: what the phosphor of a filled solid takes of it, NULL = not asked for.  Returns whether it passed.
 */
bool lum_waves_fly(const lum_wave_tables *spectral, int32_t material, const lum_medium *medium, double length, lum_rng *rng, const lum_waves *waves,
                    float share[LUM_WAVES], double taken[LUM_WAVES], double *t);

/* For flights that are drawn in R,G,B (lum_volumes_fly): the waves' importance as shares of the three colours, adding up to 1; and
 * what the flight's factors leave of each wave. */
void lum_waves_colours(const lum_wave_tables *spectral, const lum_waves *waves, double colours[3]);
void lum_waves_factors(const lum_wave_tables *spectral, const double factor[3], const lum_waves *waves, float share[LUM_WAVES]);

/* One wave goes on alone, chosen by u in proportion to its importance: returns the factor on the path's luminance, of mean 1. */
double lum_waves_choose(lum_waves *waves, double u);

/*
 * Weighs the waves with what an event leaves of each.  *luminance: the factor on the path's luminance; the shares add up to 1
 * again.  Returns the factor on its importance (0: nothing is left), with which the path should survive where it is below 1.
 */
double lum_waves_weigh(lum_waves *waves, const float share[LUM_WAVES], double *luminance);

/* Index of refraction of a solid at the first wave. */
static inline float lum_waves_index(const lum_wave_tables *spectral, int32_t material, const lum_waves *waves, float otherwise)
{
    const lum_spectrum *index = spectral->materials[material].index;
    return index ? (float)lum_spectrum_at(index, (double)waves->nm[0]) : otherwise;
}

#endif
