/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What the photon tracer (tracer.c) and its kernels (tracer_kernel.h, compiled several times) share: features, the tracer, counts.
 *
 * A *feature* is code that not every luminaire needs.  Each kernel is compiled with a constant set of features and contains no
 * code of the others; tracer.c chooses one kernel per bake, the first in the list of tracer_kernels.c that has all that the model
 * and the plan need.  A feature that the model doesn't use never changes a result: what a photon does with its random numbers
 * depends on what it meets, not on the kernel.
 *
 * To add a feature: a bit here, its code under HAS(bit) in tracer_kernel.h, the kernels that have it (tracer_kernel_*.c), and the
 * condition under which a model needs it in needed_features (tracer.c).
 */
#ifndef BAKER_TRACER_STATE_H
#define BAKER_TRACER_STATE_H

#include "parallel.h"
#include <luminaires/waves.h>
#include "source.h"

#include <luminaires/medium.h>
#include <luminaires/model.h>
#include <luminaires/scatter.h>
#include <luminaires/scene.h>

#include <stdatomic.h>

#define TRACER_TEXTURES 1u     /* textures, normal maps, vertex colours */
#define TRACER_COVERAGE 2u     /* alpha mask and blend: part of the light passes a surface by */
#define TRACER_SOLIDS 4u       /* boundaries of solids: paths remember what they are inside of */
#define TRACER_ABSORPTION 8u   /* inside solids; needs TRACER_SOLIDS */
#define TRACER_POLARIZATION 16u /* photons carry a polarization from one specular event to the next */
#define TRACER_MEDIA 32u       /* scattering on the way: inside solids and in volumes; needs TRACER_SOLIDS, TRACER_ABSORPTION */
#define TRACER_SPECTRAL 64u    /* light by wavelength (luminaires/waves.h), where the tracer has the tables for it */
#define TRACER_TOUCHING 128u   /* boundaries of solids that lie on other surfaces act as one; needs TRACER_SOLIDS */
#define TRACER_BACKWARD (1u << 30) /* paths run from outside into the lamp and see what it emits */
#define TRACER_SURVEY (1u << 31) /* notes which effects each photon meets, and where it ends: for the plan, not for a bake */

/* What the loop needs of a material, in one cache line per few materials. */
typedef struct tracer_medium {
    bool solid, absorbs;
    bool opaque; /* no light goes through its surface, unless past it */
    bool bare; /* a solid whose boundary is nothing but a step of the index */
    float ior;
    int32_t priority; /* lum_material.priority */
    uint32_t rank;    /* order by priority; among equals the smaller solid comes after the larger one, which may hold it */
    double absorption[3]; /* 1/m */
    bool scatters;
    lum_medium inside; /* where it scatters */
} tracer_medium;

/* Kernels count light in whole units: photons, or of a path whose luminance isn't 1, these parts of a photon. */
#define TRACER_UNITS(features) ((features) & TRACER_SPECTRAL ? 1 << 20 : 1)

typedef struct tracer_kernel tracer_kernel;

typedef struct tracer {
    bake_source source; /* first: a bake_source is cast back to its tracer */
    const lum_model *model;
    lum_model *variant; /* the tracer's own copy of a model with other materials, which `model` points to then; else NULL */
    lum_scene *scene;
    lum_emitters *emitters;
    bool borrows_emitters; /* another tracer's */
    tracer_medium *media; /* per material */
    lum_volumes *volumes; /* outside of solids; NULL = none */
    lum_clearance *clearance; /* of solids with media that scatter; NULL = none, or not worth it */
    bool borrows_clearance;   /* another tracer's */
    double near;          /* with media: how far beyond a scattering surfaces are looked for, so that none is passed by rounding */
    lum_wave_tables *spectral; /* NULL: light of this model has R,G,B */
    uint32_t features; /* needed for what is simulated */
    bool polarized;    /* polarization is */
    bool recut;        /* a cut-out emitter is whole in the variant: eyes would see another emission than photons have */
    const tracer_kernel *kernel;
    uint64_t seed;
} tracer;

typedef struct tracer_counts {
    int64_t photons, segments;
    int64_t escaped_squares; /* of TRACER_SPECTRAL, in its units */
    int64_t escaped, absorbed, lost, lost_inside; /* TRACER_UNITS each photon */
} tracer_counts;

/* Where light goes round for ever: the last triangles of paths that were given up (a few, enough to name the place). */
enum { TRACER_TRAPPED_KEPT = 16 };
typedef struct tracer_trap {
    uint32_t started, trapped; /* photons, of the chunk that gave up */
    uint32_t triangle[TRACER_TRAPPED_KEPT];
} tracer_trap;

/* What a kernel with TRACER_SURVEY notes.  Effects are bits of bake_effect (effects.h). */
typedef struct tracer_survey {
    const uint32_t *effects;     /* per material: what light meets there */
    uint32_t lights, scattering; /* what light of point and spot lights shows, and light scattered in a medium */
    _Atomic int64_t met[32];     /* paths that met effect k */
    _Atomic int64_t *ended;      /* per material: paths that ended there */
} tracer_survey;

/* One call of run: work for bake_parallel. */
typedef struct tracer_job {
    const tracer *tracer;
    const lmg_sink *sinks;
    size_t sink_count;
    float *record; /* for the benchmark, else NULL: segments' origins and directions, 6 floats each */
    size_t record_count, record_capacity;
    tracer_survey *survey; /* for a kernel with TRACER_SURVEY */
    const lmg_ray *rays;   /* for one with TRACER_BACKWARD: rays of light whose radiance is asked for, ... */
    float (*radiance)[3];  /* ... and the radiance seen along each, cd/m2 */
    tracer_counts counts; /* summed up in end */
    atomic_flag trap_taken; /* the first thread that gives up describes the trap */
    atomic_bool stopped;    /* light is trapped: the rest of the work is left */
    tracer_trap trap;
} tracer_job;

/* One compiled kernel.  begin, chunk and end are those of bake_work, self being a tracer_job. */
struct tracer_kernel {
    const char *name;
    uint32_t features;
    void *(*begin)(void *self);
    void (*chunk)(void *self, void *state, uint64_t first, uint64_t count);
    void (*end)(void *self, void *state);
};

/* tracer_kernels.c: all kernels, those with fewer features first; the last has all features.  Apart from them, those that
 * survey and that run backwards. */
extern const tracer_kernel tracer_kernel_survey, tracer_kernel_backward;
extern const tracer_kernel *const tracer_kernels[];
extern const size_t tracer_kernel_count;

#endif
