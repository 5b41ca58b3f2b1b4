/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Gathering: rays traced backwards from the box into the lamp estimate the same cells as the photons do.
 *
 * A photon in a cell tells its radiance with a relative variance of 1, a ray traced backwards with the variance V of what is seen
 * along the cell's rays: near 0 where a uniform emitter is seen directly, by mirrors or through glass, large where little light
 * finds its way out by many diffuse bounces.  A ray costs `cost` photons.  Where V x cost < 1, gathering is the cheaper way.  The
 * pilot measures V and cost and decides how many rays there are for each photon that is stored, if any; the mixture of the two in
 * each cell is lumigraph's (gather.c).
 */
#ifndef BAKER_GATHER_H
#define BAKER_GATHER_H

#include "source.h"

/* What the pilot says. */
typedef struct bake_gather_plan {
    double rays_per_photon; /* stored ones; 0: photons only */
    double cost;            /* of a ray, in stored photons, by their segments; 0: not measured */
    double gain;            /* predicted variance at equal cost over that of photons alone; 1: photons only */
    char why[200];
} bake_gather_plan;

/* Decides.  tracer: the one of the bake.  pilot: what of its photons left; tally: theirs.  photons: of the whole bake.
 * rays_per_photon: > 0: wanted, only its cost is measured; < 0: to be chosen, as model, seed, layout and photons alone say. Errors:
 * LMG_ERROR_UNSUPPORTED when it is wanted but can't be; LMG_ERROR_MEMORY. */
lmg_result bake_gather_decide(const bake_source *tracer, const lmg_layout *layout, const lmg_ray *pilot, size_t count,
                              const bake_tally *tally, double photons, double rays_per_photon, uint64_t seed, unsigned threads,
                              bake_gather_plan *plan, lmg_error *err);

/* Traces all rays of a gathering.  flux: lumens that the lamp's sources emit, after rescaling.  segments, may be NULL: added to. */
lmg_result bake_gather_run(const bake_source *tracer, lmg_gathering *gathering, double flux, unsigned threads, uint64_t *segments,
                           lmg_error *err);

#endif
