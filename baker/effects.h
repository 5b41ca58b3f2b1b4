/* SPDX-License-Identifier: Apache-2.0 */
/* Which effects of light a luminaire contains, as a printable list.  Found by looking at the materials that its triangles use. */
#ifndef BAKER_EFFECTS_H
#define BAKER_EFFECTS_H

#include <stddef.h>
#include <stdint.h>

struct lum_model;

/* In the order of printing; bake_effect_name gives the word for each. */
typedef enum bake_effect {
    BAKE_EMISSION_AREA,
    BAKE_EMISSION_TEXTURED,
    BAKE_EMISSION_POINT,
    BAKE_EMISSION_SPOT,
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
    BAKE_EFFECT_COUNT
} bake_effect;

const char *bake_effect_name(bake_effect effect);

/* One bit per bake_effect. */
uint32_t bake_effects_of(const struct lum_model *model);

/* "diffuse, glass-smooth, ..." */
void bake_effects_print(uint32_t effects, char *text, size_t size);

#endif
