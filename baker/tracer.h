/* SPDX-License-Identifier: Apache-2.0 */
/* What the benchmark asks of the photon tracer beside source.h. */
#ifndef BAKER_TRACER_H
#define BAKER_TRACER_H

#include "source.h"

struct lum_scene;

/* The scene that a tracer source traces in; belongs to the source. */
const struct lum_scene *bake_tracer_scene(const bake_source *tracer);

/* Traces photons first .. first+count-1 on the calling thread without sinks and writes the origin and direction (6 floats) of the
 * first `capacity` ray segments, relative to the model's centre.  Returns the number written. */
size_t bake_tracer_record(const bake_source *tracer, uint64_t first, uint64_t count, float *rays, size_t capacity);

#endif
