/* SPDX-License-Identifier: Apache-2.0 */
/* Rays against a model's triangles.  The only part of Lumibox that calls Embree. */
#ifndef LUMINAIRES_SCENE_H
#define LUMINAIRES_SCENE_H

#include <luminaires/model.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct lum_scene lum_scene;

/* Builds the acceleration structure; the model is borrowed until lum_scene_destroy. */
lmg_result lum_scene_create(const lum_model *model, lum_scene **out, lmg_error *err);
void lum_scene_destroy(lum_scene *scene);

/* A scene of the same triangles with other materials: model is a copy of the model of `geometry` that differs in its materials alone.
 * Both are borrowed until lum_scene_destroy; what costs time to build is shared. */
lmg_result lum_scene_create_variant(const lum_scene *geometry, const lum_model *model, lum_scene **out, lmg_error *err);

/* To be called by every thread around its tracing: sets flush-to-zero and denormals-are-zero and masks floating-point traps, which
 * Embree asks for, and gives back what was set before.  Results are the same bits on all threads only if all threads do it. */
unsigned lum_thread_begin(void);
void lum_thread_end(unsigned saved);

/* Coordinates here are relative to model->centre (small numbers), metres. */
typedef struct lum_hit {
    double t;          /* distance along the ray */
    lmg_vec3 position; /* from the barycentrics, not origin + t d */
    lmg_vec3 ng;       /* unit geometric normal, towards the triangle's front (counter-clockwise) side */
    float b1, b2;      /* barycentrics of vertices 1 and 2 */
    uint32_t triangle;
    double error; /* bound of the position's rounding error, metres: offset new origins along +-ng by this */
} lum_hit;

/* Closest hit with t > 0.  direction: unit.  Thread-safe. */
bool lum_scene_intersect(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, lum_hit *hit);

/* Closest hits of several rays, count at most LUM_MAX_RAYS: the same as lum_scene_intersect for each, but what a hit needs of its triangle
 * is fetched from memory while the other rays are traced.  hits[i].triangle is LUM_MISS where ray i hits nothing. */
enum { LUM_MAX_RAYS = 64 };
#define LUM_MISS UINT32_MAX
void lum_scene_intersect_many(const lum_scene *scene, size_t count, const lmg_vec3 *origins, const lmg_vec3 *directions, lum_hit *hits);

/* The same for rays of which only the part up to reach[i] (may be INFINITY) is of interest: closest hits beyond it may be missed. */
void lum_scene_intersect_within(const lum_scene *scene, size_t count, const lmg_vec3 *origins, const lmg_vec3 *directions,
                                const double *reach, lum_hit *hits);

/*
 * Where surfaces lie on each other (faces of solids that touch, a solid on an opaque wall), lum_scene_intersect finds one of them.
 * Gives all that the ray meets at the place of hits[0] (as lum_scene_intersect gave it), at most LUM_MAX_HERE, in the order of their
 * triangles, whichever of them hits[0] was; positions and errors are such that an origin offset from any of them is off all of them.
 * Surfaces that aren't solids' and lie on each other are not looked for.  Returns their number, 1 where nothing else is there;
 * UINT32_MAX where there are more.
 */
enum { LUM_MAX_HERE = 16 };
uint32_t lum_scene_all_here(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, lum_hit hits[LUM_MAX_HERE]);
/* Whether there is any such place. */
bool lum_scene_touches(const lum_scene *scene);

/* Whether something lies on the segment origin + t direction, 0 < t < distance.  Ignores alpha: see lum_scene_transmittance users.
 */
bool lum_scene_occluded(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, double distance);

/*
 * Tells of many short ways that nothing is in them, for a fraction of the time that looking for hits takes: for light in dense media,
 * which is scattered many times before it gets anywhere.  Coordinates and threads as above.
 */
typedef struct lum_clearance lum_clearance;
/* For ways that start in low .. high (of others nothing is known), in walls of a thickness (metres), and mostly are a few free_path long.  *out is NULL, and
 * that's no error, where it would cost more than it saves: in thin media and very fine meshes.  The scene is borrowed until
 * destroy. */
lmg_result lum_clearance_create(const lum_scene *scene, lmg_vec3 low, lmg_vec3 high, double thickness, double free_path,
                                lum_clearance **out, lmg_error *err);
void lum_clearance_destroy(lum_clearance *clearance); /* accepts NULL */
/* Whether the way from the origin (off all surfaces, as lum_offset puts it) along direction (unit) certainly meets no surface as far as
 * reach (may be INFINITY) and a little more; false: not known. */
bool lum_clearance_clear(const lum_clearance *clearance, lmg_vec3 origin, lmg_vec3 direction, double reach);
/* The same for at most LUM_MAX_RAYS ways at once: clear[k] of the way which[k] of the arrays.  Memory that one of them needs is on
 * its way while others are worked on.  left: of each way the triangle whose hit it starts from, LUM_MISS for none; or NULL: more
 * ways are known to be clear where that is known. */
void lum_clearance_many(const lum_clearance *clearance, size_t count, const uint32_t *which, const lmg_vec3 *origins,
                        const lmg_vec3 *directions, const double *reach, const uint32_t *left, bool *clear);

/* Origin for a ray that leaves a hit in direction d: the hit's position moved off the surface, to the side d points to. */
static inline lmg_vec3 lum_offset(const lum_hit *hit, lmg_vec3 d)
{
    double side = d.x * hit->ng.x + d.y * hit->ng.y + d.z * hit->ng.z >= 0 ? hit->error : -hit->error;
    lmg_vec3 p = {hit->position.x + side * hit->ng.x, hit->position.y + side * hit->ng.y, hit->position.z + side * hit->ng.z};
    return p;
}

/* Rays per second that Embree alone reaches: traces count rays (origin, direction as 6 floats each) with rtcIntersect1 on this
 * thread and returns the number of hits; for the benchmark. */
uint64_t lum_scene_trace_raw(const lum_scene *scene, const float *rays, size_t count);

#ifdef __cplusplus
}
#endif
#endif
