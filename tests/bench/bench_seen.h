/* SPDX-License-Identifier: Apache-2.0 */
/* What benchmarks of radiance share: a sample lamp whose light is told by photons and by paths followed backwards (viewer). */
#ifndef TESTS_BENCH_SEEN_H
#define TESTS_BENCH_SEEN_H

#include "bake.h"
#include "view_path.h"

#include <luminaires/model.h>
#include <luminaires/rng.h>

typedef struct bench_seen {
    const char *name;
    lum_model *model;
    bake_source *source;
    view_scene *scene; /* the lamp far above a room; NULL: the viewer can't show it */
    lmg_vec3 shift;    /* from the luminaire's frame to the scene's world */
    double *weights;
} bench_seen;

/* Opens a sample lamp, the photons of whose source are those of the seed; says so where the viewer can't show it.  Ends the program
 * on errors. */
void bench_seen_open(bench_seen *l, const char *name, uint64_t seed);
void bench_seen_close(bench_seen *l);
/* Luminance, cd/m2, that leaves the lamp along a ray to `from`, beyond the lamp, travelling along `travel`: one backward path.  0
 * where the viewer can't show the lamp. */
double bench_seen_look(const bench_seen *l, lmg_vec3 from, lmg_vec3 travel, lum_rng *rng);
/* The rays of the lamp's photons first .. first + count - 1, some at a time, in order of the photons' numbers. */
void bench_seen_photons(bench_seen *l, uint64_t first, uint64_t count, void (*use)(void *self, const lmg_ray *rays, size_t n),
                        void *self);

#endif
