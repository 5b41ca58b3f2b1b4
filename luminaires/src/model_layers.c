/* SPDX-License-Identifier: Apache-2.0 */
/* The layers of glTF materials (KHR_materials_specular, _clearcoat, _sheen, _anisotropy, _iridescence) as lum_layers.  Ranges have
 * been checked by gltf_check.c; here what depends on several values together. */
#include "model_build.h"

#include <math.h>

void lum_layers_none(lum_layers *layers)
{
    const lum_texture none = {.image = LUM_NONE, .m = {{1, 0, 0}, {0, 1, 0}}};
    *layers = (lum_layers){.specular = 1,
                           .specular_color = {1, 1, 1},
                           .specular_texture = none,
                           .specular_color_texture = none,
                           .clearcoat_texture = none,
                           .clearcoat_roughness_texture = none,
                           .clearcoat_normal_texture = none,
                           .clearcoat_normal_scale = 1,
                           .sheen_color_texture = none,
                           .sheen_roughness_texture = none,
                           .anisotropy_texture = none,
                           .iridescence_ior = 1.3f,
                           .thickness_min = 100,
                           .thickness_max = 400,
                           .iridescence_texture = none,
                           .thickness_texture = none};
}

static bool any(const double rgb[3])
{
    return rgb[0] > 0 || rgb[1] > 0 || rgb[2] > 0;
}

static lmg_result convert_specular(lum_build *b, const gltf_material *from, lum_layers *to)
{
    bool white = from->specular_color[0] == 1 && from->specular_color[1] == 1 && from->specular_color[2] == 1;
    if (from->specular == 1 && white && from->specular_texture.texture < 0 && from->specular_color_texture.texture < 0)
        return LMG_OK;
    to->present |= LUM_LAYER_SPECULAR;
    to->specular = (float)from->specular;
    for (int i = 0; i < 3; i++)
        to->specular_color[i] = (float)from->specular_color[i];
    LUM_TRY(lum_build_texture(b, &from->specular_texture, false, &to->specular_texture));
    return lum_build_texture(b, &from->specular_color_texture, true, &to->specular_color_texture);
}

static lmg_result convert_clearcoat(lum_build *b, const gltf_material *from, lum_layers *to)
{
    if (!(from->clearcoat > 0))
        return LMG_OK;
    to->present |= LUM_LAYER_CLEARCOAT;
    to->clearcoat = (float)from->clearcoat;
    to->clearcoat_roughness = (float)from->clearcoat_roughness;
    to->clearcoat_normal_scale = (float)from->clearcoat_normal_texture.strength;
    LUM_TRY(lum_build_texture(b, &from->clearcoat_texture, false, &to->clearcoat_texture));
    LUM_TRY(lum_build_texture(b, &from->clearcoat_roughness_texture, false, &to->clearcoat_roughness_texture));
    return lum_build_texture(b, &from->clearcoat_normal_texture, false, &to->clearcoat_normal_texture);
}

static lmg_result convert_sheen(lum_build *b, const gltf_material *from, lum_layers *to)
{
    if (!any(from->sheen_color))
        return LMG_OK;
    to->present |= LUM_LAYER_SHEEN;
    for (int i = 0; i < 3; i++)
        to->sheen_color[i] = (float)from->sheen_color[i];
    to->sheen_roughness = (float)from->sheen_roughness;
    LUM_TRY(lum_build_texture(b, &from->sheen_color_texture, true, &to->sheen_color_texture));
    return lum_build_texture(b, &from->sheen_roughness_texture, false, &to->sheen_roughness_texture);
}

static lmg_result convert_anisotropy(lum_build *b, const gltf_material *from, lum_layers *to)
{
    if (!(from->anisotropy > 0))
        return LMG_OK;
    to->present |= LUM_LAYER_ANISOTROPY;
    to->anisotropy = (float)from->anisotropy;
    to->anisotropy_rotation = (float)fmod(from->anisotropy_rotation, 6.283185307179586);
    return lum_build_texture(b, &from->anisotropy_texture, false, &to->anisotropy_texture);
}

static lmg_result convert_iridescence(lum_build *b, const char *name, const gltf_material *from, lum_layers *to)
{
    /* 10 um: beyond it the colours of a film can't be told from white, and no layer that shines is thicker. */
    const double thickest = 10000;
    if (!(from->iridescence > 0))
        return LMG_OK;
    if (from->iridescence_thickness_min > thickest || from->iridescence_thickness_max > thickest)
        return lmg_fail(b->err, LMG_ERROR_INPUT,
                        "material \"%.60s\": an iridescence thickness of %g nm is outside [0, %g] nm; the unit is the nanometre",
                        name, fmax(from->iridescence_thickness_min, from->iridescence_thickness_max), thickest);
    if (from->iridescence_ior > 4)
        return lmg_fail(b->err, LMG_ERROR_INPUT, "material \"%.60s\": iridescenceIor %g is outside [1, 4]", name,
                        from->iridescence_ior);
    to->present |= LUM_LAYER_IRIDESCENCE;
    to->iridescence = (float)from->iridescence;
    to->iridescence_ior = (float)from->iridescence_ior;
    to->thickness_min = (float)from->iridescence_thickness_min;
    to->thickness_max = (float)from->iridescence_thickness_max;
    LUM_TRY(lum_build_texture(b, &from->iridescence_texture, false, &to->iridescence_texture));
    return lum_build_texture(b, &from->iridescence_thickness_texture, false, &to->thickness_texture);
}

lmg_result lum_build_layers(lum_build *b, const char *name, const gltf_material *from, lum_layers *to)
{
    lum_layers_none(to);
    LUM_TRY(convert_specular(b, from, to));
    LUM_TRY(convert_clearcoat(b, from, to));
    LUM_TRY(convert_sheen(b, from, to));
    LUM_TRY(convert_anisotropy(b, from, to));
    return convert_iridescence(b, name, from, to);
}
