/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What a box saves: the sample room lit by a lamp's box and by its path-traced geometry, at equal error (room_study.h), of a box
 * baked for it here.
 *
 * Usage: test_bench_room [LAMP [seconds of bake]]; LAMP: paraboloid-spot (default), opal-globe, louvred-panel or glass-lens.
 */
#include "bake.h"
#include "bench_lamp.h"
#include "room_study.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv)
{
    const char *lamp = argc > 1 ? argv[1] : "paraboloid-spot";
    char path[1024], recipe_path[1024];
    lmg_error err;
    lum_recipe *recipe = NULL;
    lum_model *model = bench_load(lamp);
    lmg_field *field = NULL;
    snprintf(path, sizeof path, LUMIBOX_BINARY_DIR "/models/%s/%s.gltf", lamp, lamp);
    snprintf(recipe_path, sizeof recipe_path, LUMIBOX_BINARY_DIR "/models/%s/%s.recipe.json", lamp, lamp);
    FILE *there = fopen(recipe_path, "r");
    if (there) {
        fclose(there);
        bench_demand(lum_recipe_read(recipe_path, &recipe, &err), &err);
    }
    bake_options options = {.seconds = argc > 2 ? atof(argv[2]) : 30, .seed = 1, .fit = {.struct_size = sizeof options.fit}};
    bake_report report;
    bench_demand(bake_run(model, &options, &field, &report, &err), &err);

    const view_placement place = {.position = {0, 2.2, 0}};
    view_scene *boxed = NULL, *built = NULL;
    bench_demand(view_scene_create(LUMIBOX_BINARY_DIR "/models/room/room.gltf", NULL, &boxed, &err), &err);
    bench_demand(view_scene_create(LUMIBOX_BINARY_DIR "/models/room/room.gltf", NULL, &built, &err), &err);
    bench_demand(view_scene_adopt_box(boxed, field, &place, 0, &err), &err);
    bench_demand(view_scene_add_lamp(built, path, recipe, &place, 0, &err), &err);
    bench_demand(view_scene_finish(boxed, &err), &err);
    bench_demand(view_scene_finish(built, &err), &err);
    view_camera camera;
    bench_demand(view_camera_from_room(boxed, NULL, &camera, &err), &err);

    const view_study_options wanted = {.width = 96,
                                       .height = 72,
                                       .block = 8,
                                       .runs = 6,
                                       .rungs = 1,
                                       .samples = {64, 512},
                                       .seed = 1,
                                       .path = {.max_depth = UINT32_MAX}};
    static view_study s;
    bench_demand(view_study_run(boxed, built, &camera, &wanted, &s, &err), &err);
    printf("%s in the sample room, %u x %u pixels, %u blocks of %u x %u (%u with the lamp left out), reference of %u samples "
           "(noise %.2g %%)\n",
           lamp, s.width, s.height, s.blocks, s.block, s.block, s.lamp_blocks, s.reference_samples, 100 * s.reference_noise);
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        const view_study_result *r = &s.of[m];
        printf("%-9s squared relative error x time: mean %.4g +- %.2g s, median %.4g s (pictures of %.1f processor seconds, rms "
               "error %.2g %%)\n",
               view_study_method_name((view_study_method)m), r->cost, r->cost_se, r->cost_median, r->rungs[0].seconds,
               100 * r->rungs[0].error.rms);
    }
    printf("ratio of times at equal error: %.3g +- %.2g (mean), %.3g (median over blocks)\n", s.ratio, s.ratio_se, s.ratio_median);
    printf("{\"benchmark\": \"room\", \"lamp\": \"%s\", \"ratio\": %.4g, \"standard_error\": %.3g, \"ratio_median\": %.4g}\n", lamp,
           s.ratio, s.ratio_se, s.ratio_median);
    view_scene_destroy(boxed);
    view_scene_destroy(built);
    lum_model_destroy(model);
    lum_recipe_destroy(recipe);
    return 0;
}
