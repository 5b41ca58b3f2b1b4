/* SPDX-License-Identifier: Apache-2.0 */
/* Loading a model: the order of the steps (model_build.h), and what they share. */
#include "model_build.h"
#include "recipe.h"

#include <luminaires/medium.h>

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void lum_warn(lum_build *b, const char *format, ...)
{
    lum_model *m = b->model;
    if (m->warning_count > LUM_MAX_WARNINGS)
        return;
    if (m->warning_count == b->warning_capacity) {
        uint32_t capacity = b->warning_capacity * 2 + 16;
        char **grown = realloc(m->warnings, capacity * sizeof *grown);
        if (!grown)
            return; /* a warning less is better than no model */
        m->warnings = grown;
        b->warning_capacity = capacity;
    }
    char text[640];
    if (m->warning_count == LUM_MAX_WARNINGS) {
        snprintf(text, sizeof text, "there is more of this kind: the first %d warnings are shown", LUM_MAX_WARNINGS);
    } else {
        va_list args;
        va_start(args, format);
        vsnprintf(text, sizeof text, format, args);
        va_end(args);
        lum_make_one_line(text);
    }
    char *copy = strdup(text);
    if (copy)
        m->warnings[m->warning_count++] = copy;
}

lmg_result lum_grow(void **array, size_t size, size_t needed, lmg_error *err)
{
    void *grown = realloc(*array, needed * size);
    if (!grown)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %zu MB", needed * size >> 20);
    *array = grown;
    return LMG_OK;
}

lmg_result lum_add_spectrum(lum_build *b, const lum_spectrum *s, const lum_spectrum **out)
{
    LUM_TRY(lum_grow((void **)&b->model->spectra, sizeof *b->model->spectra, b->model->spectrum_count + 1u, b->err));
    lum_spectrum *copy = malloc(sizeof *copy);
    if (!copy)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    *copy = *s;
    b->model->spectra[b->model->spectrum_count++] = copy;
    *out = copy;
    return LMG_OK;
}

static void warn_ignored(lum_build *b)
{
    const gltf_ignored *ignored = &b->file->ignored;
    char list[400] = "";
    size_t n = 0;
    for (uint32_t i = 0; i < ignored->count && n < sizeof list - 80; i++)
        n += (size_t)snprintf(list + n, sizeof list - n, "%s%s", i ? ", " : "", ignored->names[i]);
    if (ignored->count)
        lum_warn(b, "extensions that are not simulated: %s; the model is taken without them", list);
    if (ignored->animations)
        lum_warn(b, "its %u animation%s ignored: the model is taken at rest", ignored->animations,
                 ignored->animations == 1 ? " is" : "s are");
}

static lmg_result build(lum_build *b)
{
    warn_ignored(b);
    LUM_TRY(lum_build_scene(b));
    LUM_TRY(lum_build_materials(b));
    LUM_TRY(lum_build_finish(b));
    LUM_TRY(lum_check_meshes(b));
    LUM_TRY(lum_recipe_apply(b));
    lum_warn_model(b);
    b->model->hash = lum_recipe_hash(b->recipe, b->file->hash);
    return lum_recipe_apply_volumes(b);
}

lmg_result lum_model_load(const char *path, const lum_recipe *recipe, lum_model **out, lmg_error *err)
{
    if (!out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lum_model_load: out is NULL");
    *out = NULL;
    if (!path || !*path)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lum_model_load: the path is empty");
    lum_build b = {.recipe = recipe, .err = err, .scale = lum_recipe_scale(recipe)};
    lmg_result result = gltf_open(path, &b.file, err);
    if (!result) {
        b.doc = b.file->document;
        b.model = calloc(1, sizeof *b.model);
        b.entry_matched = calloc((recipe ? recipe->entry_count : 0) + 1u, sizeof *b.entry_matched);
        if (b.model)
            snprintf(b.model->path, sizeof b.model->path, "%s", path);
        result = b.model && b.entry_matched ? build(&b) : lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    }
    free(b.positions);
    free(b.part_node);
    free(b.node_parent);
    free(b.image_slots);
    free(b.entry_matched);
    gltf_close(b.file);
    if (result) {
        lum_prefix_error(err, lum_base_name(path));
        lum_model_destroy(b.model);
        return result;
    }
    *out = b.model;
    return LMG_OK;
}

void lum_model_destroy(lum_model *model)
{
    if (!model)
        return;
    free(model->positions);
    free(model->normals);
    free(model->tangents);
    free(model->uv[0]);
    free(model->uv[1]);
    free(model->colors);
    free(model->indices);
    free(model->triangle_material);
    free(model->triangle_part);
    free(model->parts);
    free(model->materials);
    for (uint32_t i = 0; i < model->image_count; i++)
        free(model->images[i].texels);
    free(model->images);
    for (uint32_t i = 0; i < model->spectrum_count; i++)
        free(model->spectra[i]);
    free(model->spectra);
    for (uint32_t i = 0; i < model->light_count && model->lights; i++)
        lum_profile_destroy(model->lights[i].profile);
    free(model->lights);
    free(model->cameras);
    for (uint32_t i = 0; i < model->volume_count; i++)
        lum_grid_destroy(model->volumes[i].grid);
    free(model->volumes);
    for (uint32_t i = 0; i < model->warning_count; i++)
        free(model->warnings[i]);
    free(model->warnings);
    free(model);
}
