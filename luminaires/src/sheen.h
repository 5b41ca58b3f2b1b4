/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Sheen, as KHR_materials_sheen has it: fibres that stand on the surface [estevez2017sheen].  D(h) = (2 + 1/alpha) sin(theta_h)^(1
 * / alpha) / (2 pi), masking 1 / (1 + Lambda_i + Lambda_o) with the paper's fitted Lambda.  alpha = roughness^2, at least
 * LUM_SHEEN_SHARPEST.
 */
#ifndef LUMINAIRES_SHEEN_H
#define LUMINAIRES_SHEEN_H

#include "vec.h"

/* Below it (roughness 0.1) the lobe is so thin a ring at grazing angles that next to nothing is left of it. */
#define LUM_SHEEN_SHARPEST 0.01

enum { LUM_SHEEN_COSINES = 96, LUM_SHEEN_ROUGHNESSES = 48 };

/*
 * By sqrt(cosine) and roughness, as far as it is needed.  The model as published sends out more light than arrives at low roughness
 * and grazing angles (1.8 times at roughness 0.1 and 89 degrees), so each direction's cap = max(1, albedo) divides it: reciprocal,
 * and never more than 1.
 */
typedef struct lum_sheen_table {
    float cap[LUM_SHEEN_ROUGHNESSES + 1][LUM_SHEEN_COSINES + 1];
    float albedo[LUM_SHEEN_ROUGHNESSES + 1][LUM_SHEEN_COSINES + 1]; /* of white sheen, with the caps */
    bool filled[LUM_SHEEN_ROUGHNESSES + 1];
} lum_sheen_table;

/* Fills the rows for roughnesses (not alphas) from low to high, if they aren't yet.  The table begins as zeros. */
void lum_sheen_table_fill(lum_sheen_table *table, double low, double high);
double lum_sheen_albedo(const lum_sheen_table *table, double alpha, double mu);
double lum_sheen_cap(const lum_sheen_table *table, double alpha, double mu);

double lum_sheen_lambda(double alpha, double mu);
/* D for squared sine s2 of the half vector, and its largest value. */
double lum_sheen_d(double alpha, double s2);
double lum_sheen_d_max(double alpha);
/* Flux density f cos_o, white sheen, z the normal; both directions above the surface. */
double lum_sheen_density(const lum_sheen_table *table, double alpha, lmg_vec3 wi, lmg_vec3 wo);

#endif
