/* SPDX-License-Identifier: Apache-2.0 */
#include "bench_lamp.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

void bench_demand(lmg_result r, const lmg_error *err)
{
    if (r != LMG_OK) {
        fprintf(stderr, "error: %s\n", err->message);
        exit(3);
    }
}

lum_recipe *bench_recipe(const char *name)
{
    char path[1024];
    lmg_error err = {{0}};
    lum_recipe *recipe = NULL;
    snprintf(path, sizeof(path), "%s/models/%s/%s.recipe.json", LUMIBOX_BINARY_DIR, name, name);
    if (access(path, R_OK) == 0)
        bench_demand(lum_recipe_read(path, &recipe, &err), &err);
    return recipe;
}

lum_model *bench_load(const char *name)
{
    char path[1024];
    lmg_error err = {{0}};
    lum_model *model;
    lum_recipe *recipe = bench_recipe(name);
    snprintf(path, sizeof(path), "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, name, name);
    bench_demand(lum_model_load(path, recipe, &model, &err), &err);
    lum_recipe_destroy(recipe);
    return model;
}
