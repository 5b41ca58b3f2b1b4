/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Looks into the lamp, along which radiance trees grow (lmg_looks): rays traced backwards that say what an eye sees, or, where that has
 * too much noise, only which surface it meets first and how bright that is on the whole.
 */
#ifndef BAKER_LOOK_H
#define BAKER_LOOK_H

#include "source.h"

#include <signal.h>

/* Variance of a single look along rays of light, over the squared radiance there: 0 where mirrors and clear glass lead to emitters, some
 * tens where light finds its way out by many bounces.  For that two looks each go along some of the rays; none of them sees light: infinite.
 * Errors: LMG_ERROR_MEMORY. */
lmg_result bake_look_noise(const bake_source *tracer, const lmg_ray *rays, size_t count, double *noise, lmg_error *err);

/*
 * Luminance of each surface (bake_tracer_outline), in the mean of all that is seen of it, the brightest one's being 1: the light of the
 * rays that come from it over the etendue of the looks that meet it.  Where the trees' radiance is rather as if all were equally bright,
 * they all are 1.  Traces the looks, fresh ones that tell outlines, and puts what is expected of each.  rays: the lamp's, some of which
 * will do.  *brightness: the caller's.  The same for any number of threads.  Errors: LMG_ERROR_MEMORY.
 */
lmg_result bake_look_brightness(const bake_source *tracer, lmg_looks *looks, const lmg_ray *rays, size_t count, unsigned threads,
                                float **brightness, lmg_error *err);

/* Traces all looks, in rounds, so that *stop (may be NULL) is heard between them and the rest stays untraced.  brightness: of surfaces, for
 * looks that tell outlines; NULL: they tell radiance.  flux: lumens that the lamp's sources emit, after rescaling. */
lmg_result bake_look_run(const bake_source *tracer, lmg_looks *looks, const float *brightness, double flux, unsigned threads,
                         const volatile sig_atomic_t *stop, lmg_error *err);

#endif
