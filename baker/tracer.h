/* SPDX-License-Identifier: Apache-2.0 */
/* What the plan and the benchmarks ask of the photon tracer beside source.h. */
#ifndef BAKER_TRACER_H
#define BAKER_TRACER_H

#include "effects.h"
#include "source.h"

struct lum_scene;

/* The scene that a tracer source traces in; belongs to the source. */
const struct lum_scene *bake_tracer_scene(const bake_source *tracer);

/* Traces photons first .. first+count-1 on the calling thread without sinks and writes the origin and direction (6 floats) of the
 * first `capacity` ray segments, relative to the model's centre.  Returns the number written. */
size_t bake_tracer_record(const bake_source *tracer, uint64_t first, uint64_t count, float *rays, size_t capacity);

/* The name of the kernel that runs (tracer_kernels.c). */
const char *bake_tracer_kernel(const bake_source *tracer);

/* Runs on kernel number `index` instead.  False, and nothing changes, when there is none, or it lacks a feature that is
 * needed.  Every kernel that serves a model gives the same rays. */
bool bake_tracer_use_kernel(bake_source *tracer, size_t index);

/* What paths meet: how many of them each effect, and how many end at each material (on its surface, absorbed). */
typedef struct bake_survey {
    uint64_t photons, escaped, segments;
    uint64_t met[BAKE_EFFECT_COUNT];
    uint64_t *ended; /* per material of the model; the caller's array, added to */
} bake_survey;

/* Traces photons first .. first+count-1 with all features and notes what they meet, in *survey. */
lmg_result bake_tracer_survey(const bake_source *tracer, uint64_t first, uint64_t count, unsigned threads, bake_survey *survey,
                              lmg_error *err);

/*
 * What an eye outside sees along rays of light (of any origin on their way outside the model; direction of travel, luminaire
 * frame): paths traced backwards into the lamp, each an unbiased estimate of the radiance along its ray, R,G,B in cd/m2 of the
 * model's own emission.  Random numbers are keyed by the tracer's seed and ray.number.  Runs on the calling thread.  segments (may
 * be NULL): added to. Only if bake_tracer_can_look.  False: out of memory, or light is trapped.
 */
bool bake_tracer_look(const bake_source *tracer, const lmg_ray *rays, size_t count, float (*radiance)[3], uint64_t *segments);

/* Lumens that the model emits by itself, to which such radiance belongs. */
double bake_tracer_emission(const bake_source *tracer);

/* Whether paths traced backwards see all light of this tracer's model: exact adjoints are known for its effects, and eyes meet its
 * emitters.  If not, *why (may be NULL) names the effect in the way. */
bool bake_tracer_can_look(const bake_source *tracer, const char **why);

/* The surface that an eye outside meets first along each of these rays: 0 to bake_tracer_surfaces - 1, the front and the back of each
 * part of the model, or BAKE_NO_SURFACE.  Runs on the calling thread.  Only if bake_tracer_has_outline. */
#define BAKE_NO_SURFACE UINT32_MAX
void bake_tracer_outline(const bake_source *tracer, const lmg_ray *rays, size_t count, uint32_t *surface);
uint32_t bake_tracer_surfaces(const bake_source *tracer);

/* Whether all light of this tracer's model comes from the direction of a surface.  If not, *why (may be NULL) names the effect in the
 * way. */
bool bake_tracer_has_outline(const bake_source *tracer, const char **why);

#endif
