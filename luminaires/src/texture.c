/* SPDX-License-Identifier: Apache-2.0 */
/* Looking textures up (lum_texture_fetch), in the conventions of glTF: (0,0) is the upper left corner of the first texel. */
#include <luminaires/model.h>

#include <math.h>
#include <string.h>

/* The texel that an index outside [0, n) stands for. */
static uint32_t wrap(double i, uint32_t n, uint8_t mode)
{
    double last = (double)n - 1;
    if (mode == LUM_WRAP_CLAMP)
        return i <= 0 ? 0 : i >= last ? n - 1 : (uint32_t)i;
    if (mode == LUM_WRAP_MIRROR) {
        double period = i - 2.0 * n * floor(i / (2.0 * n));
        return (uint32_t)(period < n ? period : 2.0 * n - 1 - period);
    }
    return (uint32_t)(i - n * floor(i / n));
}

static const float *texel(const lum_image *image, uint32_t x, uint32_t y)
{
    return image->texels + 4 * ((size_t)y * image->width + x);
}

void lum_texture_fetch(const lum_model *model, const lum_texture *tex, const float uv0[2], const float uv1[2], float rgba[4])
{
    rgba[0] = rgba[1] = rgba[2] = rgba[3] = 1;
    if (tex->image < 0 || (uint32_t)tex->image >= model->image_count)
        return;
    const lum_image *image = &model->images[tex->image];
    const float *uv = tex->coordinates == 1 ? uv1 : uv0;
    double u = (double)tex->m[0][0] * (double)uv[0] + (double)tex->m[0][1] * (double)uv[1] + (double)tex->m[0][2];
    double v = (double)tex->m[1][0] * (double)uv[0] + (double)tex->m[1][1] * (double)uv[1] + (double)tex->m[1][2];
    double x = u * image->width, y = v * image->height;
    /* Beyond 2^40 texels the position within a texel is lost anyway; this also stops infinities. */
    if (!(fabs(x) < 0x1p40) || !(fabs(y) < 0x1p40))
        x = y = 0;
    if (tex->nearest) {
        memcpy(rgba, texel(image, wrap(floor(x), image->width, tex->wrap_s), wrap(floor(y), image->height, tex->wrap_t)),
               4 * sizeof *rgba);
        return;
    }
    double x0 = floor(x - 0.5), y0 = floor(y - 0.5);
    float fx = (float)(x - 0.5 - x0), fy = (float)(y - 0.5 - y0);
    uint32_t xa = wrap(x0, image->width, tex->wrap_s), xb = wrap(x0 + 1, image->width, tex->wrap_s);
    uint32_t ya = wrap(y0, image->height, tex->wrap_t), yb = wrap(y0 + 1, image->height, tex->wrap_t);
    const float *a = texel(image, xa, ya), *b = texel(image, xb, ya), *c = texel(image, xa, yb), *d = texel(image, xb, yb);
    for (int i = 0; i < 4; i++) {
        float top = a[i] + fx * (b[i] - a[i]), bottom = c[i] + fx * (d[i] - c[i]);
        rgba[i] = top + fy * (bottom - top);
    }
}

bool lum_material_is_textured(const lum_material *m)
{
    const lum_layers *l = &m->layers;
    const struct {
        uint32_t layer; /* that the texture belongs to; 0 = the material itself */
        const lum_texture *texture;
    } all[] = {{0, &m->base_texture},
               {0, &m->metal_rough_texture},
               {0, &m->normal_texture},
               {0, &m->transmission_texture},
               {0, &m->diffuse_transmission_texture},
               {0, &m->diffuse_transmission_color_texture},
               {LUM_LAYER_SPECULAR, &l->specular_texture},
               {LUM_LAYER_SPECULAR, &l->specular_color_texture},
               {LUM_LAYER_CLEARCOAT, &l->clearcoat_texture},
               {LUM_LAYER_CLEARCOAT, &l->clearcoat_roughness_texture},
               {LUM_LAYER_CLEARCOAT, &l->clearcoat_normal_texture},
               {LUM_LAYER_SHEEN, &l->sheen_color_texture},
               {LUM_LAYER_SHEEN, &l->sheen_roughness_texture},
               {LUM_LAYER_ANISOTROPY, &l->anisotropy_texture},
               {LUM_LAYER_IRIDESCENCE, &l->iridescence_texture},
               {LUM_LAYER_IRIDESCENCE, &l->thickness_texture}};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if ((all[i].layer == 0 || (l->present & all[i].layer)) && all[i].texture->image != LUM_NONE)
            return true;
    return false;
}
