/* SPDX-License-Identifier: Apache-2.0 */
/*
 * One light path, followed from the eye: the estimate of the radiance that arrives along a ray.
 *
 * At every surface the direct light is estimated in two ways, by choosing a light and a direction to it, and by following the
 * surface's own scattering until it meets a light; both are combined by the power heuristic [Veach1997, section 9.2] with exact
 * densities, light by light, so that each light's share is an unbiased estimate whatever the weights.
 *
 * A beam that lights a small patch of the room makes that patch a strong light for the rest, and scattering finds it by luck only.
 * So paths also start at the boxes: a ray emitted by a box, the first surface it meets, and from there to the surface points of the
 * eye's path.  This third estimate of light that comes by way of one more surface has an exact density too (a box emits in
 * proportion to radiance) and shares in the heuristic.  It costs a ray or two per surface point, so it is made with a probability
 * that the scene measures (view_scene_finish).
 *
 * Scattering backwards.  On lamps the photon tracer's flux density p(wo|wi) is used as its exact adjoint (luminaires/scatter.h), so
 * that a lamp's geometry in the room and a bake of it agree also under interpolated normals.  On the room itself the shading normal
 * takes the place of the geometric one (light that would pass the true surface is dropped): with flat shading that is the same
 * thing, and under interpolated normals it gives the smooth pictures that those normals are there for.
 *
 * Media.  A ray through a scattering medium - in a solid, or the scene's volumes outside of solids - ends at a collision drawn as
 * the photon tracer draws it (luminaires/medium.h), and what happens there is estimated as at a surface, with the phase function in
 * place of scattering.  Light of boxes on the way, and light chosen directly, is weighed with the exact transmittance.  Solids hide
 * their inside from light chosen outside, and the other way round, as ever: light through their boundary is found by scattering.
 *
 * Wavelengths: view_bands.h.  At a boundary that refracts by wavelength one goes on alone.  At a phosphor the path goes on either
 * with the light that is scattered there or, from the wavelengths emitted, back to wavelengths that excite.
 *
 * Polarization travels with the path (transport is reciprocal), so that panes and lenses transmit what they should; light that is
 * met by choosing a light directly is taken as unpolarized at that one surface.
 *
 * Boxes: eye rays and rays after a mirror or clear glass see a box through the LINEAR filter (a picture of the luminaire); all
 * other light uses NEAREST, the very radiance that light sampling returns.
 */
#ifndef VIEWER_VIEW_PATH_H
#define VIEWER_VIEW_PATH_H

#include "view_scene.h"

#include <luminaires/rng.h>

/* Which of the two estimates of direct light is used; all three have the same mean (but scattering never meets punctual lights). */
typedef enum view_strategy { VIEW_MIS = 0, VIEW_LIGHTS_ONLY = 1, VIEW_SCATTERING_ONLY = 2 } view_strategy;

typedef struct view_path_options {
    uint32_t max_depth;     /* scatterings followed; 0 shows only what shines itself */
    view_strategy strategy; /* others than VIEW_MIS make no connections */
    double connect;         /* probability of paths from the boxes: 0 = as the scene says, negative = none, else up to 1 */
} view_path_options;

/* Made-up bakes by which the boxes' errors are followed (meter.h). */
enum { VIEW_BAKES = 64 };

/* One thread's working memory and counters. */
typedef struct view_worker {
    double *weights;   /* 2 light_count numbers, from the caller */
    double *deviation; /* VIEW_BAKES numbers, from the caller: light of boxes in made-up bakes less what it is, luminance, added up;
                          NULL: not wanted.  Of a meter: over pi */
    uint64_t rays;     /* closest-hit rays and shadow rays traced */
    uint64_t refused;  /* estimates that weren't finite, counted as zero; 0 in a sound scene */
} view_worker;

/* Radiance (cd/m2, R,G,B) that reaches origin (world) from direction (unit, the way the ray looks). */
void view_path_radiance(const view_scene *scene, const view_path_options *options, lmg_vec3 origin, lmg_vec3 direction,
                        lum_rng *rng, view_worker *worker, double rgb[3]);

/* Illuminance (lx, R,G,B) on the front of a small plane at point (world) that faces normal (unit): a virtual lux meter, which
 * itself neither hides nor reflects anything.  Counts as one scattering. */
void view_path_illuminance(const view_scene *scene, const view_path_options *options, lmg_vec3 point, lmg_vec3 normal, lum_rng *rng,
                           view_worker *worker, double rgb[3]);

#endif
