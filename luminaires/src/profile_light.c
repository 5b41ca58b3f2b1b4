/* SPDX-License-Identifier: Apache-2.0 */
/* Lights with a photometric file's angular profile (profile_light.h). */
#include "profile_light.h"

#include "recipe.h"
#include "text.h"
#include "vec.h"

#include <luminaires/photometry.h>

#include <stdlib.h>
#include <string.h>

/* Orthonormal axes near the node's: its z (x for EXT_lights_ies) kept, scale and shear gone. */
static void straighten(const lmg_vec3 from[3], lmg_vec3 to[3])
{
    lmg_vec3 x = from[0], z = from[2];
    x = vec_sub(x, vec_scale(z, vec_dot(x, z)));
    double n = vec_length(x);
    if (!(n > 0)) { /* flattened: any axis across will do */
        x = fabs(z.x) < 0.5 ? vec(1, 0, 0) : vec(0, 1, 0);
        x = vec_sub(x, vec_scale(z, vec_dot(x, z)));
        n = vec_length(x);
    }
    to[0] = vec_scale(x, 1 / n);
    to[2] = z;
    to[1] = vec_cross(z, to[0]);
}

/* axes: where the photometry's +X, +Y and +Z go. */
static lmg_result add(lum_build *b, const char *name, const lum_photometry *p, const double color[3], lmg_vec3 position,
                      const lmg_vec3 axes[3])
{
    LUM_TRY(lum_grow((void **)&b->model->lights, sizeof *b->model->lights, b->model->light_count + 1u, b->err));
    lum_light light = {.kind = LUM_LIGHT_PROFILE, .position = position, .direction = vec_scale(axes[1], -1)};
    lum_copy_name(light.name, name, "light", b->model->light_count);
    memcpy(light.axes, axes, sizeof light.axes);
    light.shape = p->shape;
    for (int i = 0; i < 3; i++)
        light.intensity[i] = (float)color[i];
    LUM_TRY(lum_profile_create(p, &light.profile, b->err));
    b->model->lights[b->model->light_count++] = light;
    if (strcmp(p->unit, "cd") != 0)
        lum_warn(b, "light \"%.60s\": its photometric file has %s, taken as candela", light.name, p->unit);
    return LMG_OK;
}

lmg_result lum_add_gltf_profile(lum_build *b, int32_t index, const char *node_name, lmg_vec3 position, const lmg_vec3 axes[3])
{
    const gltf_node *node = &b->doc->nodes[index];
    lum_photometry *p;
    LUM_TRY(gltf_profile_load(b->file, (uint32_t)node->profile, &p, b->err));
    p->shape = (lum_shape){.kind = LUM_SHAPE_POINT}; /* EXT_lights_ies: points */
    double color[3];
    for (int i = 0; i < 3; i++)
        color[i] = node->profile_multiplier * node->profile_color[i];
    /* Straight down is the node's -Z and C0 its +X: our -Y and +X, turned about X. */
    lmg_vec3 local[3], turned[3];
    straighten(axes, local);
    turned[0] = local[0];
    turned[1] = local[2];
    turned[2] = vec_scale(local[1], -1);
    const lmg_result result = add(b, node_name, p, color, position, turned);
    lum_photometry_destroy(p);
    return result;
}

lmg_result lum_add_recipe_profiles(lum_build *b, const char *node_name, lmg_vec3 position, const lmg_vec3 axes[3])
{
    lmg_result result = LMG_OK;
    for (uint32_t i = 0; b->recipe && i < b->recipe->entry_count && result == LMG_OK; i++) {
        const lum_recipe_entry *e = &b->recipe->entries[i];
        if (!e->profile[0] || (e->target != LUM_TARGET_ANY && e->target != LUM_TARGET_NODE) || !lum_match(e->match, node_name))
            continue;
        b->entry_matched[i] = true;
        lum_photometry *p;
        result = lum_photometry_read(e->profile, &p, b->err);
        if (result == LMG_OK) {
            if (e->profile_point)
                p->shape = (lum_shape){.kind = LUM_SHAPE_POINT};
            const lum_shape_kind kind = p->shape.kind;
            lum_photometry_measures m;
            result = lum_photometry_measure(p, &m, b->err);
            /* A flat opening or a line sends light from all over alike, seen from near too; bodies would need to be seen face by
             * face. */
            if (result == LMG_OK && kind != LUM_SHAPE_POINT && kind != LUM_SHAPE_RECTANGLE && kind != LUM_SHAPE_ELLIPSE &&
                kind != LUM_SHAPE_ELLIPSE_FACING_C0)
                result = lmg_fail(
                    b->err, LMG_ERROR_UNSUPPORTED,
                    "%.60s: its luminous shape is a body; in a lamp only points and flat shapes shine: give \"shape\": \"point\"",
                    lum_base_name(e->profile));
            if (result == LMG_OK && !(m.flux > 0))
                result = lmg_fail(b->err, LMG_ERROR_INPUT, "%.60s: holds no light", lum_base_name(e->profile));
            if (result == LMG_OK) {
                const double scale = e->profile_lumens > 0 ? e->profile_lumens / m.flux : 1;
                const double color[3] = {scale, scale, scale};
                lmg_vec3 straight[3];
                straighten(axes, straight);
                result = add(b, node_name, p, color, position, straight);
            }
            lum_photometry_destroy(p);
        }
        if (result != LMG_OK && b->err)
            lum_prefix_error(b->err, e->where);
    }
    return result;
}
