/* SPDX-License-Identifier: Apache-2.0 */
/* A recipe's entries on a model. */
#include "model_build.h"

bool lum_recipe_leaves_out(const lum_build *b, int32_t node, const char *mesh, const char *material)
{
    (void)b; (void)node; (void)mesh; (void)material;
    return false;
}
lmg_result lum_recipe_apply(lum_build *b)
{
    (void)b;
    return LMG_OK;
}
double lum_recipe_scale(const lum_recipe *recipe)
{
    (void)recipe;
    return 1;
}
uint64_t lum_recipe_hash(const lum_recipe *recipe, uint64_t hash)
{
    (void)recipe;
    return hash;
}
void lum_warn_model(lum_build *b)
{
    (void)b;
}
