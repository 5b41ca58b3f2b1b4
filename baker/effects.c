/* SPDX-License-Identifier: Apache-2.0 */
/* The effects in a model: read off its materials and lights. */
#include "effects.h"

#include <luminaires/model.h>
#include <luminaires/scatter.h>

#include <stdio.h>
#include <stdlib.h>

static const char *const NAMES[BAKE_EFFECT_COUNT] = {
    [BAKE_EMISSION_AREA] = "area-emission",
    [BAKE_EMISSION_TEXTURED] = "textured-emission",
    [BAKE_EMISSION_POINT] = "point-lights",
    [BAKE_EMISSION_SPOT] = "spot-lights",
    [BAKE_DIFFUSE] = "diffuse",
    [BAKE_MIRROR] = "mirror",
    [BAKE_CONDUCTOR_SMOOTH] = "conductor-smooth",
    [BAKE_CONDUCTOR_ROUGH] = "conductor-rough",
    [BAKE_COAT] = "coat",
    [BAKE_GLASS_THIN] = "glass-thin",
    [BAKE_GLASS_SMOOTH] = "glass-smooth",
    [BAKE_GLASS_ROUGH] = "glass-rough",
    [BAKE_ABSORPTION] = "absorption",
    [BAKE_MEDIUM] = "medium",
    [BAKE_VOLUMES] = "volumes",
    [BAKE_DIFFUSE_TRANSMISSION] = "diffuse-transmission",
    [BAKE_COVERAGE] = "coverage",
    [BAKE_TEXTURES] = "textures",
    [BAKE_NORMAL_MAPS] = "normal-maps",
};

const char *bake_effect_name(bake_effect effect)
{
    return NAMES[effect];
}

static uint32_t bit(bake_effect effect)
{
    return 1u << effect;
}

static uint32_t effects_of_material(const lum_material *m)
{
    uint32_t e = 0;
    if (m->emissive[0] != 0 || m->emissive[1] != 0 || m->emissive[2] != 0)
        e |= bit(m->emissive_texture.image == LUM_NONE ? BAKE_EMISSION_AREA : BAKE_EMISSION_TEXTURED);
    if (m->kind == LUM_SURFACE_BLACK)
        return e;
    if (m->alpha_mode != LUM_ALPHA_OPAQUE)
        e |= bit(BAKE_COVERAGE);
    if (m->kind == LUM_SURFACE_LAMBERT)
        return e | bit(BAKE_DIFFUSE);

    const bool smooth = m->roughness * m->roughness < LUM_SMOOTH;
    if (m->normal_texture.image != LUM_NONE)
        e |= bit(BAKE_NORMAL_MAPS);
    if (m->kind == LUM_SURFACE_CONDUCTOR) {
        if (!m->has_eta && smooth)
            return e | bit(BAKE_MIRROR);
        return e | bit(smooth ? BAKE_CONDUCTOR_SMOOTH : BAKE_CONDUCTOR_ROUGH);
    }
    if (m->base_texture.image != LUM_NONE || m->metal_rough_texture.image != LUM_NONE || m->transmission_texture.image != LUM_NONE)
        e |= bit(BAKE_TEXTURES);
    if (m->metallic > 0)
        e |= bit(smooth ? BAKE_CONDUCTOR_SMOOTH : BAKE_CONDUCTOR_ROUGH);
    /* A texture can take metallic and transmission anywhere below its factor. */
    if (m->metallic < 1 || m->metal_rough_texture.image != LUM_NONE) {
        if (m->transmission > 0) {
            e |= bit(m->thin ? BAKE_GLASS_THIN : smooth ? BAKE_GLASS_SMOOTH : BAKE_GLASS_ROUGH);
            if (!m->thin && (m->absorption[0] > 0 || m->absorption[1] > 0 || m->absorption[2] > 0))
                e |= bit(BAKE_ABSORPTION);
            if (!m->thin && (m->scattering[0] > 0 || m->scattering[1] > 0 || m->scattering[2] > 0))
                e |= bit(BAKE_MEDIUM);
        }
        if (m->transmission < 1 || m->transmission_texture.image != LUM_NONE) {
            e |= bit(BAKE_DIFFUSE) | bit(BAKE_COAT);
            if (m->diffuse_transmission > 0)
                e |= bit(BAKE_DIFFUSE_TRANSMISSION);
        }
    }
    return e;
}

uint32_t bake_effects_of(const struct lum_model *model)
{
    uint32_t e = 0;
    for (uint32_t i = 0; i < model->part_count; ++i) {
        const int32_t m = model->parts[i].material;
        if (model->parts[i].triangle_count > 0 && m >= 0 && (uint32_t)m < model->material_count)
            e |= effects_of_material(&model->materials[m]);
    }
    if (model->volume_count > 0)
        e |= bit(BAKE_VOLUMES);
    for (uint32_t i = 0; i < model->light_count; ++i) {
        if (model->lights[i].kind == LUM_LIGHT_POINT)
            e |= bit(BAKE_EMISSION_POINT);
        if (model->lights[i].kind == LUM_LIGHT_SPOT)
            e |= bit(BAKE_EMISSION_SPOT);
    }
    return e;
}

void bake_effects_print(uint32_t effects, char *text, size_t size)
{
    if (size > 0)
        text[0] = 0;
    size_t used = 0;
    for (int i = 0; i < BAKE_EFFECT_COUNT && used < size; ++i)
        if (effects & bit((bake_effect)i)) {
            const int n = snprintf(text + used, size - used, "%s%s", used ? ", " : "", NAMES[i]);
            used += n > 0 ? (size_t)n : 0;
        }
}
