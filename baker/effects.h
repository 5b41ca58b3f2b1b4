/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The effects of light: which ones a luminaire contains, found by looking at the materials that its triangles use; where; and the
 * same luminaire with some of them left out, by simpler stand-ins.
 */
#ifndef BAKER_EFFECTS_H
#define BAKER_EFFECTS_H

#include <luminaires/model.h>

#include <stddef.h>
#include <stdint.h>

/* In the order of printing; bake_effect_name gives the word for each. */
typedef enum bake_effect {
    BAKE_EMISSION_AREA,
    BAKE_EMISSION_TEXTURED,
    BAKE_EMISSION_POINT,
    BAKE_EMISSION_SPOT,
    BAKE_EMISSION_PROFILE, /* the angular profile of a photometric file */
    BAKE_DIFFUSE,
    BAKE_MIRROR, /* smooth, all angles alike */
    BAKE_CONDUCTOR_SMOOTH,
    BAKE_CONDUCTOR_ROUGH,
    BAKE_COAT, /* Fresnel reflection on top of a diffuse base */
    BAKE_GLASS_THIN,
    BAKE_GLASS_SMOOTH, /* solids, refracting */
    BAKE_GLASS_ROUGH,
    BAKE_ABSORPTION,
    BAKE_MEDIUM,  /* scattering inside solids */
    BAKE_VOLUMES, /* smoke, haze: media in the space around */
    BAKE_DIFFUSE_TRANSMISSION,
    BAKE_COVERAGE, /* alpha mask and blend */
    BAKE_TEXTURES,
    BAKE_NORMAL_MAPS,
    BAKE_DISPERSION,   /* an index that depends on the wavelength */
    BAKE_SPECTRA,      /* surfaces and solids that act by wavelength */
    BAKE_FLUORESCENCE, /* phosphors */
    BAKE_POLARIZATION, /* photons keep their polarization from one surface to the next */
    BAKE_SPECULAR,     /* the dielectric's reflection weakened or coloured */
    BAKE_CLEARCOAT,
    BAKE_SHEEN,
    BAKE_ANISOTROPY,
    BAKE_IRIDESCENCE,
    BAKE_EFFECT_COUNT /* at most 31 */
} bake_effect;

/* What a source shows by itself: can't be left out. */
#define BAKE_EMISSION_BITS                                                                                                         \
    (1u << BAKE_EMISSION_AREA | 1u << BAKE_EMISSION_TEXTURED | 1u << BAKE_EMISSION_POINT | 1u << BAKE_EMISSION_SPOT | \
     1u << BAKE_EMISSION_PROFILE)

const char *bake_effect_name(bake_effect effect);

/* One bit per bake_effect. */
uint32_t bake_effects_of(const lum_model *model);
/* Of one material, emission included; as far as a photon can meet them there. */
uint32_t bake_effects_of_material(const lum_material *material);

/* "diffuse, glass-smooth, ..." */
void bake_effects_print(uint32_t effects, char *text, size_t size);

/* Reads such a list (comma separated, spaces allowed).  Errors: LMG_ERROR_ARGUMENT for a word that is no effect. */
lmg_result bake_effects_parse(const char *text, uint32_t *effects, lmg_error *err);

/* What takes an effect's place when it is left out ("untextured, mean colours"), NULL where nothing simpler can: then leaving it
 * out would save nothing, and it is always simulated. */
const char *bake_effect_stand_in(bake_effect effect);

/*
 * The model with the effects of `keep` only, others replaced by their stand-ins: a copy that shares all but the materials with the
 * model, which must outlive it.  Polarization is no matter of materials: the tracer leaves it out.  Freed by bake_effects_free.
 */
lmg_result bake_effects_strip(const lum_model *model, uint32_t keep, lum_model **out, lmg_error *err);
void bake_effects_free(lum_model *stripped);

#endif
