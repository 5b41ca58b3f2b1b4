/* SPDX-License-Identifier: Apache-2.0 */
/* What the programs of the hard-case suite share; see hard.h.  Results go to BUILD/hard/GROUP.tsv: case, expectation, result, margin. */
#define _GNU_SOURCE /* feenableexcept */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"

#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

static FILE *list;
static char folder[900];

void hard_begin(const char *group)
{
    char path[1200];
    snprintf(folder, sizeof(folder), "%s/hard", LUMIBOX_BINARY_DIR);
    mkdir(folder, 0777);
    snprintf(path, sizeof(path), "%s/%s.tsv", folder, group);
    list = fopen(path, "w");
    if (!list) {
        perror(path);
        exit(1);
    }
    snprintf(folder, sizeof(folder), "%s/hard/%s", LUMIBOX_BINARY_DIR, group);
    mkdir(folder, 0777);
    feenableexcept(FE_INVALID | FE_DIVBYZERO);
}

void hard_without_traps(void)
{
#ifndef LUMIBOX_TRAPS
    fedisableexcept(FE_INVALID | FE_DIVBYZERO);
#endif
}

static void note(const char *name, const char *expectation, const char *result, const char *margin)
{
    fprintf(list, "%s\t%s\t%s\t%s\n", name, expectation, result, margin);
    fflush(list);
    print_message("%s: %s: %s (margin %s)\n", name, expectation, result, margin);
}

void hard_at_most(const char *name, const char *expectation, double got, double bound)
{
    const bool holds = got <= bound;
    note(name, expectation, hard_text("%.3g, at most %.3g", got, bound),
         !holds ? "FAILED" : !(got > 0) ? "exact" : hard_text("x %.3g", bound / got));
    if (!holds)
        fail_msg("%s: %s: %.6g, at most %.6g", name, expectation, got, bound);
}

void hard_holds(const char *name, const char *expectation, bool holds, const char *result, ...)
{
    char text[400];
    va_list args;
    va_start(args, result);
    vsnprintf(text, sizeof(text), result, args);
    va_end(args);
    note(name, expectation, text, holds ? "holds" : "FAILED");
    if (!holds)
        fail_msg("%s: %s: %s", name, expectation, text);
}

const char *hard_text(const char *format, ...)
{
    static char texts[8][400];
    static int turn;
    char *text = texts[turn++ % 8];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(texts[0]), format, args);
    va_end(args);
    return text;
}

const char *hard_path(const char *file)
{
    static char paths[8][1200];
    static int turn;
    char *path = paths[turn++ % 8];
    snprintf(path, sizeof(paths[0]), "%s/%s", folder, file);
    return path;
}

bake_source *hard_tracer(const lum_model *model, uint64_t seed)
{
    bake_source *source;
    lmg_error err = {{0}};
    if (bake_tracer_create(model, seed, &source, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return source;
}

bake_tally hard_trace(bake_source *source, uint64_t count, const lmg_sink *sink)
{
    bake_tally t = {0};
    lmg_error err = {{0}};
    if (source->run(source, 0, count, sink ? 1 : 0, sink, sink ? 1 : 0, &t, &err) != LMG_OK)
        fail_msg("%s", err.message);
    if (t.emitted != t.escaped + t.absorbed + t.lost || t.emitted != (double)count)
        fail_msg("the balance of %.0f photons is open: %.17g escaped, %.17g absorbed, %.17g lost", t.emitted, t.escaped, t.absorbed,
                 t.lost);
    return t;
}

void hard_emit(lum_model *model, uint32_t material, float luminance)
{
    for (int c = 0; c < 3; ++c)
        model->materials[material].emissive[c] = luminance;
}

void hard_ray_light(lum_model *model, lmg_vec3 position, lmg_vec3 direction, double half_angle)
{
    model->lights = calloc(1, sizeof(*model->lights));
    assert_non_null(model->lights);
    model->light_count = 1;
    lum_light *l = &model->lights[0];
    strcpy(l->name, "ray");
    l->kind = LUM_LIGHT_SPOT;
    l->position = position;
    l->direction = direction;
    l->intensity[0] = l->intensity[1] = l->intensity[2] = 1000;
    l->cos_inner = cos(0.5 * half_angle);
    l->cos_outer = cos(half_angle);
}

lmg_field *hard_bake(const lum_model *model, const bake_options *options, bake_report *report)
{
    bake_report own;
    lmg_field *field;
    lmg_error err = {{0}};
    if (bake_run(model, options, &field, report ? report : &own, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return field;
}

lum_model *hard_load(const char *path, const lum_recipe *recipe)
{
    lum_model *model;
    lmg_error err = {{0}};
    if (lum_model_load(path, recipe, &model, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return model;
}

double hard_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, double *standard_error)
{
    double rgb[3], error;
    lmg_error err = {{0}};
    if (lmg_field_illuminance(field, point, normal, rgb, &error, &err) != LMG_OK)
        fail_msg("%s", err.message);
    if (standard_error)
        *standard_error = error;
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}
