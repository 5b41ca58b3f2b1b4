/* SPDX-License-Identifier: Apache-2.0 */
/* Sources of light by path. */
#include "open_source.h"

#include "picture_set.h"

#include <luminaires/model.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A header's total is told of when it is off by more than what rounding to two or three digits does. */
static const double HEADER_SLACK = 0.005;

static bool has_suffix(const char *text, const char *suffix)
{
    const size_t n = strlen(text), m = strlen(suffix);
    return n >= m && !strcmp(text + n - m, suffix);
}

source_kind source_kind_of(const char *path)
{
    if (has_suffix(path, ".gltf") || has_suffix(path, ".glb"))
        return SOURCE_LAMP;
    if (bake_is_picture_set(path))
        return SOURCE_PICTURES;
    /* a name that promises rays is opened as rays, so that a damaged file is called a damaged ray file */
    if (lum_ray_format_of_file(path) != LUM_RAYS_NONE || lum_ray_format_of_name(path) != LUM_RAYS_NONE)
        return SOURCE_RAYS;
    return lum_photometry_is_readable_name(path) ? SOURCE_PHOTOMETRY : SOURCE_BOX;
}

static lmg_result open_lamp(const lamp_options *lamp, const source_options *options, opened_source *s, lmg_error *err)
{
    char used[1024];
    lmg_result result = lamp_load(lamp, &s->model, &s->recipe, used, err);
    if (result != LMG_OK)
        return result;
    if (used[0] && !lamp->recipe_path && !options->quiet)
        fprintf(stderr, "using the recipe %s\n", used);
    result = bake_tracer_create(s->model, options->seed, &s->source, err);
    if (result == LMG_OK && options->flux_lm > 0)
        s->source->flux = options->flux_lm;
    return result;
}

static lmg_result open_rays(const source_options *options, opened_source *s, lmg_error *err)
{
    lmg_result result = lum_rayfile_open(s->path, options->rays, &s->rays, err);
    if (result != LMG_OK)
        return result;
    s->photometric = lum_rayfile_info(s->rays)->photometric;
    for (size_t i = 0; !options->quiet && lum_rayfile_remark(s->rays, i); ++i)
        fprintf(stderr, "note: %s: %s\n", s->path, lum_rayfile_remark(s->rays, i));
    lmg_error inner = {{0}};
    result = bake_rayfile_source_create(s->rays, options->seed, options->threads, &s->source, &inner);
    if (result == LMG_OK) {
        const lum_ray_info *info = lum_rayfile_info(s->rays);
        const double told = info->photometric ? info->luminous_lm : info->radiant_W;
        if (!options->quiet && fabs(told - s->source->flux) > HEADER_SLACK * s->source->flux)
            fprintf(stderr, "note: %s: its header tells of %.6g %s, its rays add up to %.6g: the rays count\n", s->path, told,
                    info->photometric ? "lm" : "W", s->source->flux);
        return result;
    }
    /* the reader's messages begin with the path already */
    const size_t n = strlen(s->path);
    return !strncmp(inner.message, s->path, n) ? lmg_fail(err, result, "%.500s", inner.message)
                                               : lmg_fail(err, result, "%s: %.400s", s->path, inner.message);
}

static lmg_result open_photometry(const source_options *options, opened_source *s, lmg_error *err)
{
    lmg_result result = lum_photometry_read(s->path, &s->photometry, err);
    if (result != LMG_OK)
        return result;
    lum_photometry *p = s->photometry;
    if (p->warnings[0] && !options->quiet)
        fprintf(stderr, "note: %s: %s\n", s->path, p->warnings);
    s->photometric = !strcmp(p->unit, "cd");
    if (!s->photometric) { /* "mW/sr", "W/sr", ... */
        const double unit = p->unit[0] == 'm' ? 1e-3 : p->unit[0] == 'W' ? 1 : 1e-6;
        for (size_t i = 0; i < (size_t)p->h_count * p->v_count; ++i)
            p->intensity[i] *= unit;
        memcpy(p->unit, "W/sr", 5);
    }
    lmg_error inner = {{0}};
    result = bake_profile_source_create(p, options->seed, &s->source, &inner);
    return result == LMG_OK ? result : lmg_fail(err, result, "%s: %.400s", s->path, inner.message);
}

/* What camera and photometer may differ by before it is told: measured sets have been off by up to 16 % of the flux, when the camera's
 * range was too small for the luminaire's. */
static const double PHOTOMETER_SLACK = 0.02;

static lmg_result open_pictures(const source_options *options, opened_source *s, lmg_error *err)
{
    bake_picture_set_info info;
    const lmg_result result = bake_picture_set_source_create(s->path, options->seed, &s->source, &info, err);
    if (result != LMG_OK)
        return result;
    s->photometric = info.photometric;
    if (!options->quiet && fabs(info.told - s->source->flux) > PHOTOMETER_SLACK * info.told)
        fprintf(stderr, "note: %s: the pictures add up to %.6g %s, the photometer says %.6g (%+.1f %%): the pictures count\n", s->path,
                s->source->flux, info.photometric ? "lm" : "W", info.told, 100 * (s->source->flux / info.told - 1));
    return LMG_OK;
}

static lmg_result open_box(const source_options *options, opened_source *s, lmg_error *err)
{
    lmg_result result = lmg_field_read(s->path, &s->field, err);
    if (result != LMG_OK)
        return result;
    s->photometric = box_is_photometric(s->field);
    lmg_error inner = {{0}};
    result = bake_box_source_create(s->field, options->seed, &s->source, &inner);
    return result == LMG_OK ? result : lmg_fail(err, result, "%s: %.400s", s->path, inner.message);
}

lmg_result open_source(const lamp_options *lamp, const source_options *options, opened_source *out, lmg_error *err)
{
    *out = (opened_source){.kind = source_kind_of(lamp->path), .path = lamp->path, .photometric = true};
    lmg_result result = LMG_ERROR_INTERNAL;
    switch (out->kind) {
    case SOURCE_LAMP:
        result = open_lamp(lamp, options, out, err);
        break;
    case SOURCE_RAYS:
        result = open_rays(options, out, err);
        break;
    case SOURCE_PHOTOMETRY:
        result = open_photometry(options, out, err);
        break;
    case SOURCE_PICTURES:
        result = open_pictures(options, out, err);
        break;
    case SOURCE_BOX:
        result = open_box(options, out, err);
        break;
    }
    if (result != LMG_OK)
        close_source(out);
    return result;
}

void close_source(opened_source *s)
{
    if (s->source)
        s->source->destroy(s->source);
    lum_rayfile_close(s->rays);
    lum_photometry_destroy(s->photometry);
    lum_model_destroy(s->model);
    lmg_field_destroy(s->field);
    free(s->recipe);
    *s = (opened_source){0};
}
