/* SPDX-License-Identifier: Apache-2.0 */
/* Lights with a photometric file's angular profile: from EXT_lights_ies (points) and from recipes (with the file's luminous shape).
 */
#ifndef LUMINAIRES_PROFILE_LIGHT_H
#define LUMINAIRES_PROFILE_LIGHT_H

#include "model_build.h"

/* The node's EXT_lights_ies light; position and axes (columns, unit) of the node in the model. */
lmg_result lum_add_gltf_profile(lum_build *b, int32_t node, const char *node_name, lmg_vec3 position, const lmg_vec3 axes[3]);
/* The lights that recipe entries with "profile" put at this node. */
lmg_result lum_add_recipe_profiles(lum_build *b, const char *node_name, lmg_vec3 position, const lmg_vec3 axes[3]);

#endif
