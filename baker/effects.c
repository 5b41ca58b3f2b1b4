/* SPDX-License-Identifier: Apache-2.0 */
/* The effects in a model, read off its materials and lights, and models with fewer of them. */
#include "effects.h"

#include <luminaires/model.h>
#include <luminaires/scatter.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const NAMES[BAKE_EFFECT_COUNT] = {
    [BAKE_EMISSION_AREA] = "area-emission",
    [BAKE_EMISSION_TEXTURED] = "textured-emission",
    [BAKE_EMISSION_POINT] = "point-lights",
    [BAKE_EMISSION_SPOT] = "spot-lights",
    [BAKE_EMISSION_PROFILE] = "profile-lights",
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
    [BAKE_DISPERSION] = "dispersion",
    [BAKE_SPECTRA] = "spectra",
    [BAKE_FLUORESCENCE] = "fluorescence",
    [BAKE_POLARIZATION] = "polarization",
    [BAKE_SPECULAR] = "specular",
    [BAKE_CLEARCOAT] = "clearcoat",
    [BAKE_SHEEN] = "sheen",
    [BAKE_ANISOTROPY] = "anisotropy",
    [BAKE_IRIDESCENCE] = "iridescence",
};

const char *bake_effect_name(bake_effect effect)
{
    return NAMES[effect];
}

static uint32_t bit(bake_effect effect)
{
    return 1u << effect;
}

static const struct {
    lum_layer layer;
    bake_effect effect;
} layers[] = {{LUM_LAYER_SPECULAR, BAKE_SPECULAR},
              {LUM_LAYER_CLEARCOAT, BAKE_CLEARCOAT},
              {LUM_LAYER_SHEEN, BAKE_SHEEN},
              {LUM_LAYER_ANISOTROPY, BAKE_ANISOTROPY},
              {LUM_LAYER_IRIDESCENCE, BAKE_IRIDESCENCE}};

uint32_t bake_effects_of_material(const lum_material *m)
{
    uint32_t e = 0;
    if (m->emissive[0] != 0 || m->emissive[1] != 0 || m->emissive[2] != 0)
        e |= bit(m->emissive_texture.image == LUM_NONE ? BAKE_EMISSION_AREA : BAKE_EMISSION_TEXTURED);
    if (m->kind == LUM_SURFACE_BLACK)
        return e;
    if (m->alpha_mode != LUM_ALPHA_OPAQUE)
        e |= bit(BAKE_COVERAGE);
    const lum_spectral *spectral = &m->spectral;
    if (spectral->index)
        e |= bit(BAKE_DISPERSION);
    if (spectral->reflectance || spectral->transmittance || spectral->absorption || spectral->scattering || (spectral->eta && spectral->k))
        e |= bit(BAKE_SPECTRA);
    if (spectral->converted)
        e |= bit(BAKE_FLUORESCENCE);
    if (m->kind == LUM_SURFACE_LAMBERT)
        return e | bit(BAKE_DIFFUSE);

    if (m->kind == LUM_SURFACE_PBR || m->has_eta)
        e |= bit(BAKE_POLARIZATION);
    const bool smooth = m->roughness * m->roughness < LUM_SMOOTH;
    const bool coat_normals = m->layers.present & LUM_LAYER_CLEARCOAT && m->layers.clearcoat_normal_texture.image != LUM_NONE;
    if (m->normal_texture.image != LUM_NONE || coat_normals)
        e |= bit(BAKE_NORMAL_MAPS);
    if (m->kind == LUM_SURFACE_CONDUCTOR) {
        if (!m->has_eta && smooth)
            return e | bit(BAKE_MIRROR);
        return e | bit(smooth ? BAKE_CONDUCTOR_SMOOTH : BAKE_CONDUCTOR_ROUGH);
    }
    lum_material plain = *m;
    plain.normal_texture.image = plain.layers.clearcoat_normal_texture.image = LUM_NONE; /* an effect of its own */
    if (lum_material_is_textured(&plain))
        e |= bit(BAKE_TEXTURES);
    for (size_t i = 0; i < sizeof layers / sizeof *layers; ++i)
        e |= m->layers.present & layers[i].layer ? bit(layers[i].effect) : 0;
    if (m->metallic > 0)
        e |= bit(smooth ? BAKE_CONDUCTOR_SMOOTH : BAKE_CONDUCTOR_ROUGH);
    /* A texture can take metallic and transmission anywhere below its factor. */
    if (m->metallic < 1 || m->metal_rough_texture.image != LUM_NONE) {
        if (m->transmission > 0) {
            e |= bit(m->thin ? BAKE_GLASS_THIN : smooth ? BAKE_GLASS_SMOOTH : BAKE_GLASS_ROUGH);
            if (!m->thin && (m->absorption[0] > 0 || m->absorption[1] > 0 || m->absorption[2] > 0))
                e |= bit(BAKE_ABSORPTION);
            if (!m->thin && (m->scattering[0] > 0 || m->scattering[1] > 0 || m->scattering[2] > 0 || spectral->scattering))
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

uint32_t bake_effects_of(const lum_model *model)
{
    uint32_t e = 0;
    for (uint32_t i = 0; i < model->part_count; ++i) {
        const int32_t m = model->parts[i].material;
        if (model->parts[i].triangle_count > 0 && m >= 0 && (uint32_t)m < model->material_count)
            e |= bake_effects_of_material(&model->materials[m]);
    }
    if (model->volume_count > 0)
        e |= bit(BAKE_VOLUMES);
    for (uint32_t i = 0; i < model->light_count; ++i) {
        if (model->lights[i].kind == LUM_LIGHT_POINT)
            e |= bit(BAKE_EMISSION_POINT);
        if (model->lights[i].kind == LUM_LIGHT_SPOT)
            e |= bit(BAKE_EMISSION_SPOT);
        if (model->lights[i].kind == LUM_LIGHT_PROFILE)
            e |= bit(BAKE_EMISSION_PROFILE);
    }
    return e;
}

lmg_result bake_effects_parse(const char *text, uint32_t *effects, lmg_error *err)
{
    *effects = 0;
    const char *at = text;
    while (*at) {
        at += strspn(at, ", ");
        const size_t length = strcspn(at, ", ");
        int i = 0;
        while (i < BAKE_EFFECT_COUNT && !(strlen(NAMES[i]) == length && !strncmp(NAMES[i], at, length)))
            ++i;
        if (length > 0 && i == BAKE_EFFECT_COUNT) {
            char all[512];
            bake_effects_print((1u << BAKE_EFFECT_COUNT) - 1, all, sizeof(all));
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "'%.*s' is no effect; there are auto, all, or some of: %s", (int)(length < 64 ? length : 64),
                            at, all);
        }
        if (length > 0)
            *effects |= bit((bake_effect)i);
        at += length;
    }
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------------- leaving out */

const char *bake_effect_stand_in(bake_effect effect)
{
    switch (effect) {
    case BAKE_CONDUCTOR_ROUGH:
        return "smooth metal";
    case BAKE_COAT:
        return "Lambertian, no coat";
    case BAKE_GLASS_THIN:
    case BAKE_GLASS_SMOOTH:
        return "nothing there: light passes";
    case BAKE_GLASS_ROUGH:
        return "smooth glass";
    case BAKE_ABSORPTION:
        return "clear glass";
    case BAKE_DIFFUSE_TRANSMISSION:
        return "opaque";
    case BAKE_COVERAGE:
        return "nothing cut out";
    case BAKE_TEXTURES:
        return "untextured, mean values";
    case BAKE_NORMAL_MAPS:
        return "smooth normals";
    case BAKE_MEDIUM:
    case BAKE_VOLUMES:
        return "clear, nothing scattered";
    case BAKE_DISPERSION:
        return "the index of the d line";
    case BAKE_SPECTRA:
        return "R,G,B";
    case BAKE_FLUORESCENCE:
        return "nothing converted";
    case BAKE_POLARIZATION:
        return "unpolarized at each surface";
    case BAKE_SPECULAR:
        return "the reflection that the index gives";
    case BAKE_CLEARCOAT:
        return "no clear coat";
    case BAKE_SHEEN:
        return "no fibres";
    case BAKE_ANISOTROPY:
        return "alike in all directions";
    case BAKE_IRIDESCENCE:
        return "no film";
    default:
        return NULL;
    }
}

static bool textured(const lum_texture *t)
{
    return t->image != LUM_NONE;
}

static void mean_texel(const lum_model *model, const lum_texture *texture, float mean[4])
{
    const lum_image *image = &model->images[texture->image];
    const size_t count = (size_t)image->width * image->height;
    double sum[4] = {0};
    for (size_t i = 0; i < count; ++i)
        for (int c = 0; c < 4; ++c)
            sum[c] += (double)image->texels[4 * i + (size_t)c];
    for (int c = 0; c < 4; ++c)
        mean[c] = count ? (float)(sum[c] / (double)count) : 1;
}

/* Textures' mean values in their place. */
static void flatten_textures(const lum_model *model, lum_material *m)
{
    float mean[4];
    if (textured(&m->base_texture)) {
        mean_texel(model, &m->base_texture, mean);
        for (int c = 0; c < 4; ++c)
            m->base_color[c] *= mean[c];
        m->base_texture.image = LUM_NONE;
    }
    if (textured(&m->metal_rough_texture)) {
        mean_texel(model, &m->metal_rough_texture, mean);
        m->roughness *= mean[1];
        m->metallic *= mean[2];
        m->metal_rough_texture.image = LUM_NONE;
    }
    lum_layers *l = &m->layers;
    const struct {
        lum_texture *texture;
        int channel; /* the first */
        float *values;
        int count;
    } others[] = {{&m->transmission_texture, 0, &m->transmission, 1},
                  {&m->diffuse_transmission_texture, 3, &m->diffuse_transmission, 1},
                  {&m->diffuse_transmission_color_texture, 0, m->diffuse_transmission_color, 3},
                  {&l->specular_texture, 3, &l->specular, 1},
                  {&l->specular_color_texture, 0, l->specular_color, 3},
                  {&l->clearcoat_texture, 0, &l->clearcoat, 1},
                  {&l->clearcoat_roughness_texture, 1, &l->clearcoat_roughness, 1},
                  {&l->sheen_color_texture, 0, l->sheen_color, 3},
                  {&l->sheen_roughness_texture, 3, &l->sheen_roughness, 1},
                  {&l->anisotropy_texture, 2, &l->anisotropy, 1},
                  {&l->iridescence_texture, 0, &l->iridescence, 1}};
    for (size_t i = 0; i < sizeof others / sizeof *others; ++i) {
        if (!textured(others[i].texture))
            continue;
        mean_texel(model, others[i].texture, mean);
        for (int c = 0; c < others[i].count; ++c)
            others[i].values[c] *= mean[others[i].channel + c];
        others[i].texture->image = LUM_NONE;
    }
    if (textured(&l->thickness_texture)) {
        mean_texel(model, &l->thickness_texture, mean);
        l->thickness_max = l->thickness_min + mean[1] * (l->thickness_max - l->thickness_min);
        l->thickness_texture.image = LUM_NONE;
    }
}

static void strip_material(const lum_model *model, uint32_t keep, lum_material *m)
{
    const uint32_t drop = bake_effects_of_material(m) & ~keep;
    if (drop & bit(BAKE_COVERAGE))
        m->alpha_mode = LUM_ALPHA_OPAQUE;
    for (size_t i = 0; i < sizeof layers / sizeof *layers; ++i)
        if (drop & bit(layers[i].effect))
            m->layers.present &= ~(uint32_t)layers[i].layer;
    if (drop & bit(BAKE_NORMAL_MAPS))
        m->normal_texture.image = m->layers.clearcoat_normal_texture.image = LUM_NONE;
    if (drop & bit(BAKE_TEXTURES))
        flatten_textures(model, m);
    if (drop & bit(BAKE_ABSORPTION))
        m->absorption[0] = m->absorption[1] = m->absorption[2] = 0;
    lum_spectral *spectral = &m->spectral;
    if (drop & bit(BAKE_MEDIUM)) {
        m->scattering[0] = m->scattering[1] = m->scattering[2] = 0;
        spectral->scattering = NULL;
    }
    if (drop & bit(BAKE_DISPERSION))
        spectral->index = NULL;
    if (drop & bit(BAKE_SPECTRA))
        spectral->reflectance = spectral->transmittance = spectral->absorption = spectral->scattering = spectral->eta = spectral->k = NULL;
    if (drop & bit(BAKE_FLUORESCENCE)) {
        spectral->converted = spectral->excitation = NULL;
        spectral->fills = false;
    }
    if (drop & bit(BAKE_DIFFUSE_TRANSMISSION))
        m->diffuse_transmission = 0;
    if (drop & (bit(BAKE_GLASS_ROUGH) | bit(BAKE_CONDUCTOR_ROUGH)))
        m->roughness = 0;
    if (drop & (bit(BAKE_GLASS_THIN) | bit(BAKE_GLASS_SMOOTH)) && m->metallic == 0) {
        /* the coated share of a part-glass stays, as a surface that light meets that often */
        m->alpha_mode = LUM_ALPHA_BLEND;
        m->base_color[3] = 1 - m->transmission;
        m->transmission = 0;
    }
    if (drop & bit(BAKE_COAT) && m->metallic == 0 && m->transmission == 0 && m->layers.present == 0)
        m->kind = LUM_SURFACE_LAMBERT;
}

lmg_result bake_effects_strip(const lum_model *model, uint32_t keep, lum_model **out, lmg_error *err)
{
    *out = malloc(sizeof(**out));
    lum_material *materials = malloc((model->material_count ? model->material_count : 1) * sizeof(*materials));
    if (!*out || !materials) {
        free(*out);
        free(materials);
        *out = NULL;
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for %u materials", model->material_count);
    }
    **out = *model;
    (*out)->materials = materials;
    if (!(keep & bit(BAKE_VOLUMES)))
        (*out)->volume_count = 0;
    for (uint32_t i = 0; i < model->material_count; ++i) {
        materials[i] = model->materials[i];
        strip_material(model, keep, &materials[i]);
    }
    return LMG_OK;
}

void bake_effects_free(lum_model *stripped)
{
    if (stripped)
        free(stripped->materials);
    free(stripped);
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
