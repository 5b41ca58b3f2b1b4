/* SPDX-License-Identifier: Apache-2.0 */
/* glTF materials, textures and images as lum_material, lum_texture and lum_image.  Images are decoded when a slot that moves light
 * uses them, once as linear values and once with sRGB undone if both are asked for. */
#include "model_build.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

/* Texels of all images together: 4 GB as floats. */
#define MAX_TEXELS ((uint64_t)1 << 28)

static float srgb_to_linear(double s)
{
    return (float)(s <= 0.04045 ? s / 12.92 : pow((s + 0.055) / 1.055, 2.4));
}

/* Decodes an image into the model; tables make 8-bit images quick. */
static lmg_result load_image(lum_build *b, int32_t index, bool srgb, int32_t *slot)
{
    uint32_t width, height;
    int bits;
    void *pixels;
    LUM_TRY(gltf_image_load(b->file, (uint32_t)index, &width, &height, &bits, &pixels, b->err));
    size_t count = (size_t)width * height;
    b->texel_count += count;
    float *texels = NULL;
    lmg_result result = LMG_OK;
    if (b->texel_count > MAX_TEXELS)
        result = lmg_fail(b->err, LMG_ERROR_INPUT, "its images have more than %u million pixels together; scale them",
                          (unsigned)(MAX_TEXELS / 1000000));
    if (!result && !(texels = malloc(count * 4 * sizeof *texels)))
        result = lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory for an image of %u x %u", width, height);
    if (!result)
        result = lum_grow((void **)&b->model->images, sizeof *b->model->images, b->model->image_count + 1u, b->err);
    if (result) {
        free(pixels);
        free(texels);
        return result;
    }
    size_t levels = bits == 16 ? 65536 : 256;
    float *table = malloc(levels * sizeof *table);
    if (!table) {
        free(pixels);
        free(texels);
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    }
    for (size_t i = 0; i < levels; i++) {
        double s = (double)i / (double)(levels - 1);
        table[i] = srgb ? srgb_to_linear(s) : (float)s;
    }
    for (size_t i = 0; i < count * 4; i++) {
        size_t value = bits == 16 ? ((const uint16_t *)pixels)[i] : ((const uint8_t *)pixels)[i];
        texels[i] = i % 4 == 3 ? (float)value / (float)(levels - 1) : table[value]; /* alpha is linear in any case */
    }
    free(table);
    free(pixels);
    *slot = (int32_t)b->model->image_count;
    b->model->images[b->model->image_count++] = (lum_image){width, height, texels};
    return LMG_OK;
}

static uint8_t wrap_mode(int32_t gl)
{
    return gl == 33071 ? LUM_WRAP_CLAMP : gl == 33648 ? LUM_WRAP_MIRROR : LUM_WRAP_REPEAT;
}

lmg_result lum_build_texture(lum_build *b, const gltf_texture_use *use, bool srgb, lum_texture *out)
{
    *out = (lum_texture){.image = LUM_NONE, .m = {{1, 0, 0}, {0, 1, 0}}};
    if (use->texture < 0)
        return LMG_OK;
    const gltf_texture *texture = &b->doc->textures[use->texture];
    if (texture->image < 0)
        return lmg_fail(b->err, LMG_ERROR_UNSUPPORTED,
                        "textures[%d]: has no PNG or JPEG image (KTX2 and WebP are not supported); export it with one",
                        use->texture);
    if ((uint32_t)texture->image >= b->file->image_count)
        return lmg_fail(b->err, LMG_ERROR_INPUT, "textures[%d]: its image %d is outside the file's %u images; re-export the model",
                        use->texture, texture->image, b->file->image_count);
    if (use->coordinates > 1)
        return lmg_fail(b->err, LMG_ERROR_UNSUPPORTED,
                        "textures[%d]: uses texture coordinates TEXCOORD_%d; only 0 and 1 are supported", use->texture,
                        use->coordinates);
    int32_t *slot = &b->image_slots[2 * texture->image + srgb];
    if (*slot == LUM_NONE)
        LUM_TRY(load_image(b, texture->image, srgb, slot));
    out->image = *slot;
    out->coordinates = (uint8_t)use->coordinates;
    if (texture->sampler >= 0) {
        const gltf_sampler *sampler = &b->doc->samplers[texture->sampler];
        out->wrap_s = wrap_mode(sampler->wrap_s);
        out->wrap_t = wrap_mode(sampler->wrap_t);
        out->nearest = sampler->mag_filter == 9728;
    }
    /* KHR_texture_transform: scale, then rotate, then shift.  The sense of the rotation is that of Khronos' TextureTransformTest,
     * in which a point seen at an angle a in the (u,v) plane shows the texel at the angle a - rotation; the GLSL in the extension's
     * text turns the other way, which that model marks as the error. */
    double c = cos(use->rotation), s = sin(use->rotation);
    const double m[2][3] = {{c * use->scale[0], s * use->scale[1], use->offset[0]},
                            {-s * use->scale[0], c * use->scale[1], use->offset[1]}};
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 3; j++)
            out->m[i][j] = (float)m[i][j];
    return LMG_OK;
}

static void clean_defaults(lum_material *m)
{
    const lum_texture none = {.image = LUM_NONE, .m = {{1, 0, 0}, {0, 1, 0}}};
    *m = (lum_material){.base_color = {1, 1, 1, 1},
                        .metallic = 1,
                        .roughness = 1,
                        .ior = 1.5f,
                        .normal_scale = 1,
                        .alpha_cutoff = 0.5f,
                        .diffuse_transmission_color = {1, 1, 1},
                        .base_texture = none,
                        .metal_rough_texture = none,
                        .normal_texture = none,
                        .transmission_texture = none,
                        .diffuse_transmission_texture = none,
                        .diffuse_transmission_color_texture = none,
                        .emissive_texture = none};
    lum_layers_none(&m->layers);
}

static lmg_result convert(lum_build *b, const gltf_material *from, uint32_t index, lum_material *to)
{
    clean_defaults(to);
    lum_copy_name(to->name, from->name, "material", index);
    for (int i = 0; i < 4; i++)
        to->base_color[i] = (float)from->base_color[i];
    to->metallic = (float)from->metallic;
    to->roughness = (float)from->roughness;
    to->alpha_mode = (lum_alpha)from->alpha_mode;
    to->alpha_cutoff = (float)from->alpha_cutoff;
    to->double_sided = from->double_sided;
    to->emits_back = from->double_sided;
    LUM_TRY(lum_build_texture(b, &from->base_texture, true, &to->base_texture));
    if (from->metallic > 0 || from->roughness > 0)
        LUM_TRY(lum_build_texture(b, &from->metal_rough_texture, false, &to->metal_rough_texture));
    LUM_TRY(lum_build_texture(b, &from->normal_texture, false, &to->normal_texture));
    to->normal_scale = (float)from->normal_texture.strength;

    bool emits = false;
    for (int i = 0; i < 3; i++) {
        to->emissive[i] = (float)(from->emissive[i] * from->emissive_strength);
        if (!isfinite(to->emissive[i]))
            return lmg_fail(b->err, LMG_ERROR_INPUT, "material \"%.60s\": its emission of %g cd/m2 is beyond the range of float",
                            to->name, from->emissive[i] * from->emissive_strength);
        emits = emits || to->emissive[i] > 0;
    }
    if (emits)
        LUM_TRY(lum_build_texture(b, &from->emissive_texture, true, &to->emissive_texture));

    if (from->has_ior && from->ior < 1)
        return lmg_fail(b->err, LMG_ERROR_UNSUPPORTED, "material \"%.60s\": ior %g is below 1; give a refractive index from 1 on",
                        to->name, from->ior);
    to->ior = (float)from->ior;
    if (from->dispersion > 0) {
        /* KHR_materials_dispersion: 20 / V_d, with the index of the d line in ior. */
        const lum_index_model glass = {LUM_INDEX_ABBE, {from->ior, 20 / from->dispersion}};
        lum_spectrum by_nm;
        lmg_error why;
        if (lum_spectrum_of_index(&glass, &by_nm, &why))
            return lmg_fail(b->err, LMG_ERROR_INPUT, "material \"%.60s\": dispersion %g with ior %g: %.200s; lower the dispersion",
                            to->name, from->dispersion, from->ior, why.message);
        LUM_TRY(lum_add_spectrum(b, &by_nm, &to->spectral.index));
    }
    to->transmission = (float)from->transmission;
    if (from->transmission > 0)
        LUM_TRY(lum_build_texture(b, &from->transmission_texture, false, &to->transmission_texture));
    to->diffuse_transmission = (float)from->diffuse_transmission;
    for (int i = 0; i < 3; i++)
        to->diffuse_transmission_color[i] = (float)from->diffuse_transmission_color[i];
    if (from->diffuse_transmission > 0) {
        LUM_TRY(lum_build_texture(b, &from->diffuse_transmission_texture, false, &to->diffuse_transmission_texture));
        LUM_TRY(lum_build_texture(b, &from->diffuse_transmission_color_texture, true, &to->diffuse_transmission_color_texture));
    }
    LUM_TRY(lum_build_layers(b, to->name, from, &to->layers));
    to->thin = !(from->has_volume && from->thickness > 0);
    if (!to->thin && isfinite(from->attenuation_distance) && from->attenuation_distance > 0)
        for (int i = 0; i < 3; i++)
            to->absorption[i] = (float)(-log(fmax(from->attenuation_color[i], (double)FLT_MIN)) / from->attenuation_distance);
    if (from->unlit)
        lum_warn(b, "material \"%.60s\": KHR_materials_unlit has no meaning for light and is ignored", to->name);
    return LMG_OK;
}

lmg_result lum_build_materials(lum_build *b)
{
    uint32_t n = b->doc->material_count;
    b->image_slots = malloc((2 * (size_t)b->file->image_count + 1) * sizeof *b->image_slots);
    b->model->materials = calloc((size_t)n + 1, sizeof *b->model->materials);
    if (!b->image_slots || !b->model->materials)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < 2 * (size_t)b->file->image_count; i++)
        b->image_slots[i] = LUM_NONE;
    b->model->material_count = n + 1;
    bool *used = calloc((size_t)n + 1, sizeof *used);
    if (!used)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    for (uint32_t i = 0; i < b->model->part_count; i++)
        used[b->model->parts[i].material] = true;
    lmg_result result = LMG_OK;
    for (uint32_t i = 0; i < n && !result; i++) {
        if (used[i])
            result = convert(b, &b->doc->materials[i], i, &b->model->materials[i]);
    }
    free(used);
    if (result)
        return result;
    /* What primitives without a material get: glTF's default, a white metal of roughness 1. */
    clean_defaults(&b->model->materials[n]);
    b->model->materials[n].thin = true;
    lum_copy_name(b->model->materials[n].name, "default material", "", 0);
    return LMG_OK;
}
