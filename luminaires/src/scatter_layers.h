/* SPDX-License-Identifier: Apache-2.0 */
/* Surfaces with layers: layer_parts.h says how they scatter.  Called by scatter.c and scatter_eval.c. */
#ifndef LUMINAIRES_SCATTER_LAYERS_H
#define LUMINAIRES_SCATTER_LAYERS_H

#include "scatter_parts.h"

void lum_sample_layers(const lum_surface *surface, const side *at, lmg_vec3 wi, float eta_outside, const double xi[4],
                       lum_polarization *pol, lum_scattered *out);
/* Adds the densities of everything but deltas. */
void lum_add_layers(const lum_surface *surface, const side *at, lmg_vec3 wi, lmg_vec3 wo, float eta_outside, density *sum);

/* Computes what the densities of an untextured material need often (lum_tables.base_albedo). */
void lum_prepare_layers(const lum_surface *surface, struct lum_tables *tables);

#endif
