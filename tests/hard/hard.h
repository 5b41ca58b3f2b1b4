/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The hard-case suite: each case has an exact expectation, is checked, and leaves a line for docs/hard-cases.md (scripts/hard-cases
 * puts the page together).  Floating-point traps are on in these programs: an invalid operation or a division by zero in our own code
 * ends them.  Built with LUMIBOX_TRAPS, also in threads that trace, everywhere but inside Embree; otherwise those have them masked.
 * To be included after cmocka.h.
 */
#ifndef TESTS_HARD_H
#define TESTS_HARD_H

#include "bake.h"
#include "source.h"

#include <luminaires/model.h>

#include <stdbool.h>

/* To be called first: opens the group's list of results and sets the traps.  For cmocka_run_group_tests_name: NULL otherwise. */
void hard_begin(const char *group);

/* No traps from here on, unless built with LUMIBOX_TRAPS: for programs that meet rough lobes, whose tables are vectorized
 * (-fno-trapping-math: lanes that aren't needed divide by zero). */
void hard_without_traps(void);

/* A case whose result is a number: fails the test unless got <= bound (NaN fails).  Texts: one line each, without tabs. */
void hard_at_most(const char *name, const char *expectation, double got, double bound);

/* A case that holds or doesn't; result says what was seen. */
void hard_holds(const char *name, const char *expectation, bool holds, const char *result, ...) __attribute__((format(printf, 4, 5)));

/* printf into one of eight buffers in turn. */
const char *hard_text(const char *format, ...) __attribute__((format(printf, 1, 2)));

/* A folder of the group's own, and a file in it (one of eight buffers in turn). */
const char *hard_path(const char *file);

/* Vectors. */
static inline lmg_vec3 v3(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

/* A tracer of a model; traces, into a sink on one thread since tests count without locks; the balance of what it traced has to be exact. */
bake_source *hard_tracer(const lum_model *model, uint64_t seed);
bake_tally hard_trace(bake_source *source, uint64_t count, const lmg_sink *sink);

/* Makes a material emit this luminance (cd/m2, white). */
void hard_emit(lum_model *model, uint32_t material, float luminance);

/* A spot light so narrow (half-angle in radians) that its light is a ray; one per model. */
void hard_ray_light(lum_model *model, lmg_vec3 position, lmg_vec3 direction, double half_angle);

/* Bakes a model; the test fails if that does. */
lmg_field *hard_bake(const lum_model *model, const bake_options *options, bake_report *report);

/* Loads a glTF file. */
lum_model *hard_load(const char *path, const lum_recipe *recipe);

/* Luminance of an illuminance, with its standard error (may be NULL). */
double hard_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, double *standard_error);

#endif
