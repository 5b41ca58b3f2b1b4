/* SPDX-License-Identifier: Apache-2.0 */
#include "bench_seen.h"

#include "bench_lamp.h"
#include "geometry.h"

#include <stdio.h>
#include <stdlib.h>

enum { ROUND = 1000000 };
/* Metres from the room to the lamp above it: far enough for the room to be dark. */
static const double HEIGHT = 30;

void bench_seen_open(bench_seen *l, const char *name, uint64_t seed)
{
    char path[1024];
    lmg_error err = {{0}};
    lum_recipe *recipe = bench_recipe(name);
    snprintf(path, sizeof path, LUMIBOX_BINARY_DIR "/models/%s/%s.gltf", name, name);
    *l = (bench_seen){.name = name, .model = bench_load(name)};
    bench_demand(bake_tracer_create(l->model, seed, &l->source, &err), &err);
    const view_placement place = {.position = {0, HEIGHT, 0}};
    bench_demand(view_scene_create(LUMIBOX_BINARY_DIR "/models/room/room.gltf", NULL, &l->scene, &err), &err);
    if (view_scene_add_lamp(l->scene, path, recipe, &place, 0, &err) == LMG_OK) {
        bench_demand(view_scene_finish(l->scene, &err), &err);
        l->shift = v_sub((lmg_vec3){0, HEIGHT, 0}, l->scene->origin);
        l->weights = calloc(2 * l->scene->light_count, sizeof *l->weights);
        if (!l->weights)
            bench_demand(lmg_fail(&err, LMG_ERROR_MEMORY, "no memory for the lights of %s", name), &err);
    } else {
        printf("%s: no pictures nor radiance: %s\n", name, err.message);
        view_scene_destroy(l->scene);
        l->scene = NULL;
    }
    lum_recipe_destroy(recipe);
}

void bench_seen_close(bench_seen *l)
{
    free(l->weights);
    if (l->scene)
        view_scene_destroy(l->scene);
    l->source->destroy(l->source);
    lum_model_destroy(l->model);
}

double bench_seen_look(const bench_seen *l, lmg_vec3 from, lmg_vec3 travel, lum_rng *rng)
{
    const view_path_options options = {.max_depth = UINT32_MAX, .connect = -1};
    view_worker worker = {.weights = l->weights};
    double rgb[3];
    if (!l->scene)
        return 0;
    view_path_radiance(l->scene, &options, v_add(from, l->shift), v_scale(-1, travel), rng, &worker, rgb);
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

void bench_seen_photons(bench_seen *l, uint64_t first, uint64_t count, void (*use)(void *self, const lmg_ray *rays, size_t n),
                        void *self)
{
    lmg_error err = {{0}};
    for (uint64_t done = 0; done < count;) {
        const uint64_t n = count - done < ROUND ? count - done : ROUND;
        bake_ray_list *list;
        bake_tally tally = {0};
        bench_demand(bake_ray_list_create((size_t)n, &list, &err), &err);
        const lmg_sink sink = bake_ray_list_sink(list);
        bench_demand(l->source->run(l->source, first + done, n, 0, &sink, 1, &tally, &err), &err);
        bench_demand(bake_ray_list_check(list, &err), &err);
        size_t rays;
        const lmg_ray *at = bake_ray_list_sorted(list, &rays);
        use(self, at, rays);
        bake_ray_list_destroy(list);
        done += n;
    }
}
