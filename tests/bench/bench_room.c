/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What a box saves: the sample room lit by the paraboloid spot, by its box and by its path-traced geometry, at equal error.
 *
 * Error times time: the mean squared relative deviation of 8 x 8 pixel means from the box's own converged picture, times the
 * seconds that the picture took; both methods' deviation falls as 1 / time, so the ratio of the two products is the ratio of times
 * for equal error.  A path tracer that misses rare events underrates its own noise, hence the deviation from an independent, far
 * longer picture and not from its own standard errors.  Blocks that show the lamp itself are left out.  The box's bake error is
 * part of the deviation of the geometry's pictures and of no others, and is negligible there (a few per cent against hundreds). The
 * uncertainty is that of the independent runs (jackknife).  The median over blocks, which rare events can't carry, is printed
 * beside the mean.
 *
 * Usage: test_bench_room [LAMP [seconds of bake]]; LAMP: paraboloid-spot (default), opal-globe, louvred-panel or glass-lens.
 */
#include "bake.h"
#include "render.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { WIDTH = 96, HEIGHT = 72, BLOCK = 8, BLOCKS = WIDTH / BLOCK * (HEIGHT / BLOCK), RUNS = 6 };

static void demand(lmg_result r, const lmg_error *err)
{
    if (r != LMG_OK) {
        fprintf(stderr, "error: %s\n", err->message);
        exit(1);
    }
}

/* Mean luminance of each block. */
static double render_blocks(const view_scene *scene, const view_camera *camera, uint32_t samples, uint64_t seed,
                            double block[BLOCKS])
{
    lmg_error err;
    view_render *render = NULL;
    view_image image;
    view_render_options options = {.width = WIDTH, .height = HEIGHT, .seed = seed, .path = {.max_depth = UINT32_MAX}};
    demand(view_render_create(scene, camera, &options, &render, &err), &err);
    demand(view_render_pass(render, samples, NULL, &err), &err);
    demand(view_image_create(WIDTH, HEIGHT, &image, &err), &err);
    view_render_resolve(render, &image);
    for (int b = 0; b < BLOCKS; b++) {
        int x0 = b % (WIDTH / BLOCK) * BLOCK, y0 = b / (WIDTH / BLOCK) * BLOCK;
        block[b] = 0;
        for (int i = 0; i < BLOCK * BLOCK; i++) {
            block[b] += lmg_luminance(&image.rgb[3 * ((y0 + i / BLOCK) * WIDTH + x0 + i % BLOCK)]) / (BLOCK * BLOCK);
        }
    }
    double seconds = view_render_look(render).seconds;
    view_image_free(&image);
    view_render_destroy(render);
    return seconds;
}

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

typedef struct cost {
    double run[RUNS]; /* mean squared relative deviation times seconds */
    double mean, se, median;
    double seconds;
} cost;

static cost measure(const view_scene *scene, const view_camera *camera, uint32_t samples, uint64_t seed,
                    const double reference[BLOCKS], const char *skip)
{
    cost c = {.mean = 0};
    double squares = 0, typical[BLOCKS] = {0};
    int used = 0;
    for (int i = 0; i < RUNS; i++) {
        double block[BLOCKS], sum = 0, seconds = render_blocks(scene, camera, samples, seed + (uint64_t)i, block);
        used = 0;
        for (int b = 0; b < BLOCKS; b++) {
            if (skip[b]) {
                continue;
            }
            double d = block[b] / reference[b] - 1;
            sum += d * d;
            typical[used++] += d * d * seconds / RUNS;
        }
        c.run[i] = sum / used * seconds;
        c.mean += c.run[i] / RUNS;
        squares += c.run[i] * c.run[i] / RUNS;
        c.seconds += seconds / RUNS;
    }
    c.se = sqrt((squares - c.mean * c.mean) / (RUNS - 1));
    qsort(typical, (size_t)used, sizeof typical[0], compare);
    c.median = typical[used / 2];
    return c;
}

int main(int argc, char **argv)
{
    const char *lamp = argc > 1 ? argv[1] : "paraboloid-spot";
    char path[1024], recipe_path[1024];
    lmg_error err;
    lum_recipe *recipe = NULL;
    lum_model *model = NULL;
    lmg_field *field = NULL;
    snprintf(path, sizeof path, LUMIBOX_BINARY_DIR "/models/%s/%s.gltf", lamp, lamp);
    snprintf(recipe_path, sizeof recipe_path, LUMIBOX_BINARY_DIR "/models/%s/%s.recipe.json", lamp, lamp);
    FILE *there = fopen(recipe_path, "r");
    if (there) {
        fclose(there);
        demand(lum_recipe_read(recipe_path, &recipe, &err), &err);
    }
    demand(lum_model_load(path, recipe, &model, &err), &err);
    bake_options options = {.seconds = argc > 2 ? atof(argv[2]) : 30, .seed = 1, .fit = {.struct_size = sizeof options.fit}};
    bake_report report;
    demand(bake_run(model, &options, &field, &report, &err), &err);

    const view_placement place = {.position = {0, 2.2, 0}};
    view_scene *boxed = NULL, *built = NULL;
    demand(view_scene_create(LUMIBOX_BINARY_DIR "/models/room/room.gltf", NULL, &boxed, &err), &err);
    demand(view_scene_create(LUMIBOX_BINARY_DIR "/models/room/room.gltf", NULL, &built, &err), &err);
    demand(view_scene_adopt_box(boxed, field, &place, 0, &err), &err);
    demand(view_scene_add_lamp(built, path, recipe, &place, 0, &err), &err);
    demand(view_scene_finish(boxed, &err), &err);
    demand(view_scene_finish(built, &err), &err);
    view_camera camera;
    demand(view_camera_from_room(boxed, NULL, &camera, &err), &err);

    double reference[BLOCKS];
    double seconds = render_blocks(boxed, &camera, 2048, 1000, reference);
    /* The lamp itself: blocks whose sight meets the bounds of the box, by a margin of a block. */
    char skip[BLOCKS] = {0};
    int skipped = 0;
    for (int y = -BLOCK; y < HEIGHT + BLOCK; y++) {
        for (int x = -BLOCK; x < WIDTH + BLOCK; x++) {
            double t;
            if (!view_box_enter(boxed, 0, camera.eye, view_camera_direction(&camera, x + 0.5, y + 0.5, WIDTH, HEIGHT), &t)) {
                continue;
            }
            for (int dy = -1; dy <= 1; dy++) {
                for (int dx = -1; dx <= 1; dx++) {
                    int bx = (x + BLOCK) / BLOCK - 1 + dx, by = (y + BLOCK) / BLOCK - 1 + dy;
                    if (bx >= 0 && by >= 0 && bx < WIDTH / BLOCK && by < HEIGHT / BLOCK) {
                        skip[by * (WIDTH / BLOCK) + bx] = 1;
                    }
                }
            }
        }
    }
    for (int b = 0; b < BLOCKS; b++) {
        skipped += skip[b];
    }
    cost box = measure(boxed, &camera, 64, 1, reference, skip), geometry = measure(built, &camera, 512, 101, reference, skip);
    double ratio = geometry.mean / box.mean, relative = hypot(geometry.se / geometry.mean, box.se / box.mean);
    printf("%s in the sample room, %d x %d pixels, %d blocks of %d x %d (%d with the lamp left out), reference %.0f s\n", lamp,
           WIDTH, HEIGHT, BLOCKS - skipped, BLOCK, BLOCK, skipped, seconds);
    printf("box       squared relative error x time: mean %.4g +- %.2g s, median %.4g s (runs of %.1f s, rms error %.2g %%)\n",
           box.mean, box.se, box.median, box.seconds, 100 * sqrt(box.mean / box.seconds));
    printf("geometry  squared relative error x time: mean %.4g +- %.2g s, median %.4g s (runs of %.1f s, rms error %.2g %%)\n",
           geometry.mean, geometry.se, geometry.median, geometry.seconds, 100 * sqrt(geometry.mean / geometry.seconds));
    printf("ratio of times at equal error: %.3g +- %.2g (mean), %.3g (median over blocks)\n", ratio, ratio * relative,
           geometry.median / box.median);
    printf("{\"benchmark\": \"room\", \"lamp\": \"%s\", \"ratio\": %.4g, \"standard_error\": %.3g, \"ratio_median\": %.4g}\n", lamp,
           ratio, ratio * relative, geometry.median / box.median);
    view_scene_destroy(boxed);
    view_scene_destroy(built);
    lum_model_destroy(model);
    lum_recipe_destroy(recipe);
    return 0;
}
