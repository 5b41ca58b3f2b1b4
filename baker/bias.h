/* SPDX-License-Identifier: Apache-2.0 */
/* What a box's cells smooth: its bias, apart from its noise. */
#ifndef BAKER_BIAS_H
#define BAKER_BIAS_H

#include <lumigraph/lumigraph.h>

enum { BIAS_DISTANCES = 4 };
extern const double BAKE_BIAS_DISTANCE[BIAS_DISTANCES]; /* of the planes, in sizes */

/* A relative RMS error with its standard error.  rms is negative when its estimated square is: nothing was seen above the noise. */
typedef struct bake_bias_error {
    double rms, standard_error;
} bake_bias_error;

typedef struct bake_bias {
    bake_bias_error planes[BIAS_DISTANCES]; /* illuminance on the planes of comparisons, 32 x 32 pixels */
    bake_bias_error far_field;              /* intensity in 32 x 64 bins of equal solid angle */
} bake_bias;

/*
 * Measures what storing the lamp's light in the box's cells does to it.  rays: light of the lamp that isn't in the box, with
 * numbers that follow each other, such as a pilot's.  Every ray is moved to another place of its cell (lmg_field_redraw), and the
 * change of the readings, in eight groups of rays whose noise is independent, is multiplied group by group, which leaves the noise
 * out; what the noise of the cells' slopes does is in it.  Errors: LMG_ERROR_MEMORY.
 */
lmg_result bake_bias_measure(const lmg_field *field, const lmg_ray *rays, size_t count, bake_bias *out, lmg_error *err);

#endif
