/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What shines in a model: its table (emit.c draws light from it).  Emissive triangles are cut into patches - one for a triangle of uniform emission, up to 64 x 64 for a
 * textured one - and patches and punctual lights are chosen in proportion to their luminous flux with an alias table
 * [vose1991alias].  Emission is Lambertian about the geometric normal.  Relies on texture.c for texels and on scene_data.h for the
 * offset of new rays.
 */
#include "emitters_data.h"

#include <stdlib.h>
#include <string.h>

/* ------------------------------------------------------------------------------------------------------------ emission */

static bool is_textured(const lum_texture *t)
{
    return t->image != LUM_NONE;
}

static void uv_at(const lum_model *model, uint32_t triangle, int set, double b1, double b2, float out[2])
{
    const uint32_t *corner = model->indices + 3 * (size_t)triangle;
    const float *uv = model->uv[set];
    out[0] = out[1] = 0;
    if (uv) {
        for (int k = 0; k < 2; k++) {
            out[k] =
                (float)((1 - b1 - b2) * (double)uv[2 * (size_t)corner[0] + (size_t)k] +
                        b1 * (double)uv[2 * (size_t)corner[1] + (size_t)k] + b2 * (double)uv[2 * (size_t)corner[2] + (size_t)k]);
        }
    }
}

void lum_emission_at(const lum_model *model, uint32_t triangle, double b1, double b2, float rgb[3])
{
    const lum_material *m = &model->materials[model->triangle_material[triangle]];
    memcpy(rgb, m->emissive, 3 * sizeof rgb[0]);
    bool emission = is_textured(&m->emissive_texture), cut = m->alpha_mode != LUM_ALPHA_OPAQUE;
    float uv0[2], uv1[2], texel[4], alpha = m->base_color[3];
    if (emission || (cut && is_textured(&m->base_texture))) {
        uv_at(model, triangle, 0, b1, b2, uv0);
        uv_at(model, triangle, 1, b1, b2, uv1);
    }
    if (emission) {
        lum_texture_fetch(model, &m->emissive_texture, uv0, uv1, texel);
        for (int c = 0; c < 3; c++) {
            rgb[c] *= texel[c];
        }
    }
    if (cut) {
        if (is_textured(&m->base_texture)) {
            lum_texture_fetch(model, &m->base_texture, uv0, uv1, texel);
            alpha *= texel[3];
        }
        if (model->colors) {
            const uint32_t *corner = model->indices + 3 * (size_t)triangle;
            alpha *= (float)((1 - b1 - b2) * (double)model->colors[4 * (size_t)corner[0] + 3] +
                             b1 * (double)model->colors[4 * (size_t)corner[1] + 3] +
                             b2 * (double)model->colors[4 * (size_t)corner[2] + 3]);
        }
        float coverage = m->alpha_mode == LUM_ALPHA_BLEND ? fminf(fmaxf(alpha, 0), 1) : alpha >= m->alpha_cutoff ? 1 : 0;
        for (int c = 0; c < 3; c++) {
            rgb[c] *= coverage;
        }
    }
}

/* Index of a texel under the wrap mode. */
static uint32_t wrapped(int64_t i, uint32_t size, uint8_t mode)
{
    int64_t n = size;
    if (mode == LUM_WRAP_CLAMP) {
        i = i < 0 ? 0 : i >= n ? n - 1 : i;
    } else if (mode == LUM_WRAP_MIRROR) {
        i = ((i % (2 * n)) + 2 * n) % (2 * n);
        i = i < n ? i : 2 * n - 1 - i;
    } else {
        i = ((i % n) + n) % n;
    }
    return (uint32_t)i;
}

/* Texture coordinates of the emissive texture in texels at barycentrics. */
static void texel_at(const lum_model *model, uint32_t triangle, double b1, double b2, double xy[2])
{
    const lum_texture *t = &model->materials[model->triangle_material[triangle]].emissive_texture;
    const lum_image *image = &model->images[t->image];
    float uv[2];
    uv_at(model, triangle, t->coordinates, b1, b2, uv);
    for (int k = 0; k < 2; k++) {
        double c = (double)t->m[k][0] * (double)uv[0] + (double)t->m[k][1] * (double)uv[1] + (double)t->m[k][2];
        xy[k] = c * (k ? image->height : image->width);
    }
}

/* Largest luminance that the emissive texture gives in a patch: over the texels of its bounding rectangle, one more on each side,
 * of which the interpolated values are means. */
static float patch_bound(const lum_model *model, uint32_t triangle, const double corner[2], double step)
{
    const lum_material *m = &model->materials[model->triangle_material[triangle]];
    const lum_texture *t = &m->emissive_texture;
    const lum_image *image = &model->images[t->image];
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int k = 0; k < 3; k++) {
        double xy[2];
        texel_at(model, triangle, corner[0] + (k == 1 ? step : 0), corner[1] + (k == 2 ? step : 0), xy);
        for (int a = 0; a < 2; a++) {
            low[a] = fmin(low[a], xy[a]);
            high[a] = fmax(high[a], xy[a]);
        }
    }
    int64_t first[2], count[2];
    uint32_t size[2] = {image->width, image->height};
    for (int a = 0; a < 2; a++) {
        /* Huge coordinates cover the whole image anyhow. */
        bool all = !(high[a] - low[a] < size[a]) || !(fabs(low[a]) < 1e15);
        first[a] = all ? 0 : (int64_t)floor(low[a]) - 1;
        count[a] = all ? size[a] : (int64_t)floor(high[a]) + 2 - first[a];
        count[a] = count[a] < size[a] ? count[a] : size[a];
    }
    float largest = 0;
    for (int64_t y = 0; y < count[1]; y++) {
        const float *row = image->texels + 4 * (size_t)wrapped(first[1] + y, size[1], t->wrap_t) * image->width;
        for (int64_t x = 0; x < count[0]; x++) {
            const float *texel = row + 4 * (size_t)wrapped(first[0] + x, size[0], t->wrap_s);
            float rgb[3] = {m->emissive[0] * texel[0], m->emissive[1] * texel[1], m->emissive[2] * texel[2]};
            largest = fmaxf(largest, (float)lmg_luminance(rgb));
        }
    }
    /* The products above and those of emission_at round differently by some units of 2^-24. */
    return largest * (1 + 16 * (float)LUM_FLOAT_ROUNDING);
}

enum { MAX_CUTS = 64, PATCH_TEXELS = 8, MAX_POINTS = 64 };

/* How many patches per edge a triangle is cut into: about one per 8 x 8 texels of whichever texture shapes its emission. */
static uint32_t cuts_of(const lum_model *model, uint32_t triangle, double *texels)
{
    double c[3][2];
    *texels = 0;
    texel_at(model, triangle, 0, 0, c[0]);
    texel_at(model, triangle, 1, 0, c[1]);
    texel_at(model, triangle, 0, 1, c[2]);
    for (int k = 0; k < 3; k++) {
        *texels = fmax(*texels, hypot(c[k][0] - c[(k + 1) % 3][0], c[k][1] - c[(k + 1) % 3][1]));
    }
    double n = ceil(*texels / PATCH_TEXELS);
    return n > MAX_CUTS ? MAX_CUTS : n > 1 ? (uint32_t)n : 1;
}

/* Mean over a patch, by midpoints of k * k equal triangles: four along a texel. */
static void patch_mean(const lum_model *model, uint32_t triangle, const double corner[2], double step, uint32_t k, double rgb[3])
{
    rgb[0] = rgb[1] = rgb[2] = 0;
    for (uint32_t i = 0; i < k; i++) {
        for (uint32_t w = 0; w < 2 * (k - i) - 1; w++) {
            double c[2], s;
            float e[3];
            patch_corner(k, i, w, c, &s);
            lum_emission_at(model, triangle, corner[0] + step * (c[0] + s / 3), corner[1] + step * (c[1] + s / 3), e);
            for (int a = 0; a < 3; a++) {
                rgb[a] += (double)e[a];
            }
        }
    }
    for (int a = 0; a < 3; a++) {
        rgb[a] /= (double)k * k;
    }
}

static void fill_patches(lum_emitters *emitters, emissive_triangle *t)
{
    const lum_model *model = emitters->model;
    double sides = t->both ? 2 : 1, texels = 0;
    double flux = (double)t->area / ((double)t->n * t->n) * LUM_PI * sides; /* of luminance 1 */
    if (t->textured) {
        cuts_of(model, t->triangle, &texels);
    }
    double points = ceil(4 * texels / t->n);
    uint32_t k = points > MAX_POINTS ? MAX_POINTS : points > 2 ? (uint32_t)points : 2;
    for (uint32_t i = 0; i < t->n; i++) {
        for (uint32_t w = 0; w < 2 * (t->n - i) - 1; w++) {
            patch *p = &emitters->patches[t->first_patch + row_start(t->n, i) + w];
            double corner[2], step, rgb[3];
            patch_corner(t->n, i, w, corner, &step);
            if (t->textured) {
                patch_mean(model, t->triangle, corner, step, k, rgb);
                p->bound = is_textured(&model->materials[model->triangle_material[t->triangle]].emissive_texture)
                               ? patch_bound(model, t->triangle, corner, step)
                               : (float)lmg_luminance(model->materials[model->triangle_material[t->triangle]].emissive) *
                                     (1 + 16 * (float)LUM_FLOAT_ROUNDING);
            } else {
                float e[3];
                lum_emission_at(model, t->triangle, 1.0 / 3, 1.0 / 3, e);
                for (int c = 0; c < 3; c++) {
                    rgb[c] = (double)e[c];
                }
                p->bound = (float)lmg_luminance(e);
            }
            double mean = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
            p->mean = (float)mean;
            p->power = mean > 0 ? mean * flux : 0;
            for (int c = 0; c < 3; c++) {
                emitters->rgb[c] += p->power > 0 ? rgb[c] * flux : 0;
            }
        }
    }
}

static void fill_light(const lum_model *model, const lum_light *light, punctual *p)
{
    p->light = *light;
    double y = lmg_luminance(light->intensity);
    for (int c = 0; c < 3; c++) {
        p->colour[c] = y > 0 ? (float)((double)light->intensity[c] / y) : 0;
    }
    p->power = 0;
    if (!(y > 0)) {
        return;
    }
    if (light->kind == LUM_LIGHT_PROFILE) {
        p->power = y * lum_profile_flux(light->profile);
    } else if (light->kind == LUM_LIGHT_POINT) {
        p->power = 4 * LUM_PI * y;
    } else if (light->kind == LUM_LIGHT_SPOT) {
        /* KHR_lights_punctual: intensity times a^2, a = (cos - cos_outer) / max(0.001, cos_inner - cos_outer) clamped to [0,1]. */
        p->width = fmax(0.001, light->cos_inner - light->cos_outer);
        p->ramp_top = fmin(1, (1 - light->cos_outer) / p->width);
        double ramp = p->width * p->ramp_top * p->ramp_top * p->ramp_top / 3;
        double core = fmax(0, 1 - light->cos_outer - p->width);
        p->ramp = ramp + core > 0 ? ramp / (ramp + core) : 0;
        p->power = 2 * LUM_PI * y * (ramp + core);
    } else {
        lmg_vec3 d = vec_sub(model->bounds_max, model->bounds_min);
        p->power = y * LUM_PI * 0.25 * vec_dot(d, d);
    }
}

/* --------------------------------------------------------------------------------------------------------- alias table */

static double power_of(const lum_emitters *e, uint32_t i, bool directional)
{
    if (i < e->patch_count) {
        return e->patches[i].power;
    }
    const punctual *p = &e->lights[i - e->patch_count];
    return p->light.kind == LUM_LIGHT_DIRECTIONAL && !directional ? 0 : p->power;
}

/* Vose's construction; the order of the work lists makes it deterministic. */
static bool build_alias(const lum_emitters *e, bool directional, alias_entry *table, double *total)
{
    uint32_t n = e->patch_count + e->light_count, small = 0, large = 0;
    double *scaled = malloc(((size_t)n + 1) * sizeof *scaled);
    uint32_t *list = malloc(((size_t)n + 1) * sizeof *list); /* small ones from the front, large ones from the back */
    double sum = 0, carry = 0;
    if (!scaled || !list) {
        free(scaled);
        free(list);
        return false;
    }
    for (uint32_t i = 0; i < n; i++) { /* Kahan: millions of triangles */
        double x = power_of(e, i, directional) - carry, next = sum + x;
        carry = (next - sum) - x;
        sum = next;
    }
    *total = sum;
    for (uint32_t i = 0; i < n; i++) {
        scaled[i] = sum > 0 ? power_of(e, i, directional) / sum * n : 1;
        table[i].keep = 1;
        table[i].other = i;
    }
    for (uint32_t i = 0; i < n; i++) {
        if (scaled[i] < 1) {
            list[small++] = i;
        } else {
            list[n - ++large] = i;
        }
    }
    while (small && large) {
        uint32_t s = list[--small], l = list[n - large];
        table[s].keep = scaled[s];
        table[s].other = l;
        scaled[l] = (scaled[l] + scaled[s]) - 1;
        if (scaled[l] < 1) {
            large--;
            list[small++] = l;
        }
    }
    /* What is left has probability 1 but for rounding; entries without power must not come up through it. */
    for (uint32_t k = 0; k < small; k++) {
        uint32_t i = list[k];
        if (power_of(e, i, directional) <= 0) {
            table[i].keep = 0;
            for (uint32_t j = 0; j < n; j++) {
                if (power_of(e, j, directional) > 0) {
                    table[i].other = j;
                    break;
                }
            }
        }
    }
    free(scaled);
    free(list);
    return true;
}

/* ------------------------------------------------------------------------------------------------------------- create */

static bool emits(const lum_model *model, uint32_t triangle)
{
    const lum_material *m = &model->materials[model->triangle_material[triangle]];
    return lmg_luminance(m->emissive) > 0;
}

lmg_result lum_emitters_create(const lum_model *model, lum_emitters **out, lmg_error *err)
{
    *out = NULL;
    lum_emitters *e = calloc(1, sizeof *e);
    if (!e) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the emitters");
    }
    e->model = model;
    for (uint32_t i = 0; i < model->triangle_count; i++) {
        e->triangle_count += emits(model, i);
    }
    e->light_count = model->light_count;
    e->triangles = calloc((size_t)e->triangle_count + 1, sizeof *e->triangles);
    e->of_triangle = malloc(((size_t)model->triangle_count + 1) * sizeof *e->of_triangle);
    e->lights = calloc((size_t)e->light_count + 1, sizeof *e->lights);
    if (!e->triangles || !e->of_triangle || !e->lights) {
        goto memory;
    }
    uint32_t next = 0;
    uint64_t patches = 0;
    for (uint32_t i = 0; i < model->triangle_count; i++) {
        e->of_triangle[i] = LUM_NONE;
        if (!emits(model, i)) {
            continue;
        }
        const lum_material *m = &model->materials[model->triangle_material[i]];
        emissive_triangle *t = &e->triangles[next];
        double texels;
        for (int k = 0; k < 3; k++) {
            memcpy(t->v[k], model->positions + 3 * (size_t)model->indices[3 * (size_t)i + (size_t)k], sizeof t->v[k]);
        }
        lmg_vec3 corner = vec_from_float(t->v[0]);
        lmg_vec3 cross = vec_cross(vec_sub(vec_from_float(t->v[1]), corner), vec_sub(vec_from_float(t->v[2]), corner));
        double twice = vec_length(cross), luminance;
        t->ng[0] = twice > 0 ? (float)(cross.x / twice) : 0;
        t->ng[1] = twice > 0 ? (float)(cross.y / twice) : 0;
        t->ng[2] = twice > 0 ? (float)(cross.z / twice) : 1;
        e->of_triangle[i] = (int32_t)next++;
        t->triangle = i;
        t->material = model->triangle_material[i];
        t->area = (float)(0.5 * twice * model->unit * model->unit);
        t->error = nextafterf((float)lum_triangle_error((const float(*)[3])t->v), INFINITY);
        lum_emission_at(model, i, 1.0 / 3, 1.0 / 3, t->emission);
        luminance = lmg_luminance(t->emission);
        for (int c = 0; c < 3; c++) {
            t->colour[c] = luminance > 0 ? (float)((double)t->emission[c] / luminance) : 0;
        }
        t->both = m->emits_back;
        bool by_emission = is_textured(&m->emissive_texture);
        t->textured = by_emission || (m->alpha_mode != LUM_ALPHA_OPAQUE && (is_textured(&m->base_texture) || model->colors));
        t->n = by_emission ? cuts_of(model, i, &texels) : 1;
        t->plain = !t->textured;
        t->first_patch = (uint32_t)patches;
        patches += (uint64_t)t->n * t->n;
    }
    if (patches + e->light_count > UINT32_MAX - 1) {
        lum_emitters_destroy(e);
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                        "the model has %llu emissive patches, more than 4 thousand million; reduce its emissive textures",
                        (unsigned long long)patches);
    }
    e->patch_count = (uint32_t)patches;
    uint32_t n = e->patch_count + e->light_count;
    e->patches = calloc((size_t)e->patch_count + 1, sizeof *e->patches);
    e->alias = calloc((size_t)n + 1, sizeof *e->alias);
    e->alias_all = calloc((size_t)n + 1, sizeof *e->alias_all);
    if (!e->patches || !e->alias || !e->alias_all) {
        goto memory;
    }
    for (uint32_t i = 0; i < e->triangle_count; i++) {
        fill_patches(e, &e->triangles[i]);
        for (uint32_t k = 0; k < e->triangles[i].n * e->triangles[i].n; k++) {
            e->alias[e->triangles[i].first_patch + k].owner = e->alias_all[e->triangles[i].first_patch + k].owner = i;
        }
    }
    for (uint32_t i = 0; i < e->light_count; i++) {
        fill_light(model, &model->lights[i], &e->lights[i]);
        if (model->lights[i].kind != LUM_LIGHT_DIRECTIONAL) {
            for (int c = 0; c < 3; c++) {
                e->rgb[c] += e->lights[i].power * (double)e->lights[i].colour[c];
            }
        }
    }
    if (!build_alias(e, false, e->alias, &e->flux) || !build_alias(e, true, e->alias_all, &e->flux_all)) {
        goto memory;
    }
    *out = e;
    return LMG_OK;

memory:
    lum_emitters_destroy(e);
    return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the emitters of %u triangles", model->triangle_count);
}

void lum_emitters_destroy(lum_emitters *emitters)
{
    if (emitters) {
        free(emitters->triangles);
        free(emitters->patches);
        free(emitters->of_triangle);
        free(emitters->lights);
        free(emitters->alias);
        free(emitters->alias_all);
        free(emitters);
    }
}

uint32_t lum_emitters_count(const lum_emitters *emitters)
{
    return emitters->patch_count + emitters->light_count;
}

double lum_emitters_flux(const lum_emitters *emitters, double rgb[3])
{
    if (rgb) {
        memcpy(rgb, emitters->rgb, sizeof emitters->rgb);
    }
    return emitters->flux;
}
