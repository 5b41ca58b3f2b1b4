/* SPDX-License-Identifier: Apache-2.0 */
/* Rooms and their lights from the command line; see cmd_scene.h. */
#include "cmd_scene.h"

#include "render.h"

#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Vertical angle of a camera given by --eye without --fov, degrees. */
static const double DEFAULT_FOV = 50;

/* ------------------------------------------------------------------------------------------------------------- options */

bool scene_wish_create(scene_wish *wish, const char *command, int argc, uint32_t width, uint32_t height)
{
    *wish = (scene_wish){.command = command, .width = width, .height = height, .seed = 1, .max_depth = UINT32_MAX};
    wish->things = calloc((size_t)argc, sizeof *wish->things);
    wish->sets = calloc((size_t)argc, sizeof *wish->sets);
    wish->set_thing = calloc((size_t)argc, sizeof *wish->set_thing);
    return wish->things && wish->sets && wish->set_thing;
}

void scene_wish_free(scene_wish *wish)
{
    free(wish->things);
    free(wish->sets);
    free(wish->set_thing);
}

static scene_taken place(scene_wish *wish, bool lamp, const char *value)
{
    lmg_error err;
    scene_thing *thing = &wish->things[wish->thing_count++];
    thing->lamp = lamp;
    if (view_placement_parse(value, &thing->placement, thing->path, sizeof thing->path, &err) != LMG_OK) {
        say_usage(wish->command, "--%s %s", lamp ? "lamp" : "light", err.message);
        return SCENE_SAID;
    }
    return SCENE_TAKEN;
}

scene_taken scene_option(scene_wish *wish, int option, const char *value, const char **wanted)
{
    scene_thing *last = wish->thing_count ? &wish->things[wish->thing_count - 1] : NULL;
    bool good = true;
    switch (option) {
    case SCENE_LIGHT:
    case SCENE_LAMP:
        return place(wish, option == SCENE_LAMP, value);
    case SCENE_RECIPE:
    case SCENE_SET:
        if (last && !last->lamp) {
            say_usage(wish->command, "--%s belongs behind the --lamp that it is for, or for the room before all of them",
                      option == SCENE_SET ? "set" : "recipe");
            return SCENE_SAID;
        }
        if (option == SCENE_SET) {
            wish->set_thing[wish->set_count] = wish->thing_count;
            wish->sets[wish->set_count++] = value;
        } else {
            *(last ? &last->recipe : &wish->recipe) = value;
        }
        break;
    case SCENE_FLUX:
        if (!last) {
            say_usage(wish->command, "--flux belongs behind the --light or --lamp that it is for");
            return SCENE_SAID;
        }
        good = read_positive(value, "lm", &last->flux);
        *wanted = "lumens, more than 0";
        break;
    case SCENE_SIZE:
        good = read_size(value, VIEW_MAX_SIDE, &wish->width, &wish->height);
        *wanted = "WIDTHxHEIGHT in pixels, 1 to 16384 each";
        break;
    case SCENE_CAMERA:
        wish->camera = value;
        break;
    case SCENE_EYE:
        wish->eye = value;
        break;
    case SCENE_TARGET:
        wish->target = value;
        break;
    case SCENE_FOV:
        good = read_positive(value, "", &wish->fov) && wish->fov < 180;
        *wanted = "degrees between 0 and 180";
        break;
    case SCENE_SEED:
        good = read_count(value, UINT64_MAX, &wish->seed);
        *wanted = "a whole number";
        break;
    case SCENE_THREADS:
        good = read_count(value, 1024, &wish->threads);
        *wanted = "a whole number up to 1024";
        break;
    case SCENE_DEPTH:
        good = read_count(value, UINT32_MAX, &wish->max_depth);
        *wanted = "a whole number";
        break;
    case 'q':
        wish->quiet = true;
        break;
    case 'v':
        wish->verbose = true;
        break;
    default:
        return SCENE_NOT_MINE;
    }
    return good ? SCENE_TAKEN : SCENE_BAD;
}

int scene_finish(scene_wish *wish, int argc, char **argv, int at)
{
    if (at + 1 != argc) {
        return at == argc ? say_usage(wish->command, "which room? Name a .gltf or .glb file")
                          : say_usage(wish->command, "one room at a time: what is \"%s\"?", argv[at + 1]);
    }
    wish->room = argv[at];
    if ((wish->eye != NULL) != (wish->target != NULL) || (wish->fov > 0 && !wish->eye) || (wish->camera && wish->eye)) {
        return say_usage(wish->command, "a camera is either --camera NAME, or --eye and --target (and --fov) together");
    }
    return EXIT_DONE;
}

/* ------------------------------------------------------------------------------------------------------------- loading */

/* The recipe beside LAMP.gltf, LAMP.recipe.json; false if there is none. */
static bool recipe_beside(const char *lamp, char path[SCENE_PATH_SIZE + 16])
{
    snprintf(path, SCENE_PATH_SIZE, "%s", lamp);
    char *slash = strrchr(path, '/'), *dot = strrchr(path, '.');
    if (dot && (!slash || dot > slash)) {
        *dot = '\0';
    }
    strcat(path, ".recipe.json");
    return access(path, F_OK) == 0;
}

static void print_warnings(const lum_model *model)
{
    for (uint32_t i = 0; i < model->warning_count; i++) {
        fprintf(stderr, "warning: %s\n", model->warnings[i]);
    }
}

/* The recipe of a model: a file, or the one beside the model, and what --set adds; thing: 0 the room, 1 the first of things. */
static lmg_result make_recipe(const scene_wish *wish, const char *model, const char *path, size_t thing, lum_recipe **out,
                              lmg_error *err)
{
    char beside[SCENE_PATH_SIZE + 16];
    if (!path && recipe_beside(model, beside)) {
        path = beside;
    }
    lmg_result r = path ? lum_recipe_read(path, out, err) : lum_recipe_create(out, err);
    for (size_t i = 0; i < wish->set_count && r == LMG_OK; i++) {
        if (wish->set_thing[i] == thing) {
            r = lum_recipe_add(*out, wish->sets[i], err);
        }
    }
    return r;
}

static lmg_result add_lamp(view_scene *scene, size_t index, const scene_wish *wish, lmg_error *err)
{
    const scene_thing *thing = &wish->things[index];
    lum_recipe *recipe = NULL;
    lmg_result r = make_recipe(wish, thing->path, thing->recipe, index + 1, &recipe, err);
    if (r == LMG_OK) {
        r = view_scene_add_lamp(scene, thing->path, recipe, &thing->placement, thing->flux, err);
    }
    lum_recipe_destroy(recipe);
    if (r == LMG_OK && !wish->quiet) {
        print_warnings(scene->objects[scene->object_count - 1].model);
    }
    return r;
}

lmg_result scene_load(const scene_wish *wish, unsigned which, view_scene **out, lmg_error *err)
{
    lum_recipe *recipe = NULL;
    *out = NULL;
    lmg_result r = make_recipe(wish, wish->room, wish->recipe, 0, &recipe, err);
    if (r == LMG_OK) {
        r = view_scene_create(wish->room, recipe, out, err);
    }
    lum_recipe_destroy(recipe);
    if (r == LMG_OK && wish->verbose) {
        print_warnings((*out)->objects[0].model);
    }
    for (size_t i = 0; i < wish->thing_count && r == LMG_OK; i++) {
        const scene_thing *thing = &wish->things[i];
        if (which & (thing->lamp ? SCENE_LAMPS : SCENE_BOXES)) {
            r = thing->lamp ? add_lamp(*out, i, wish, err)
                            : view_scene_add_box(*out, thing->path, &thing->placement, thing->flux, err);
        }
    }
    return r == LMG_OK ? view_scene_finish(*out, err) : r;
}

lmg_result scene_camera(const scene_wish *wish, const view_scene *scene, view_camera *camera, lmg_error *err)
{
    if (wish->eye) {
        double eye[3], target[3];
        if (!view_parse_numbers(wish->eye, eye, 3) || !view_parse_numbers(wish->target, target, 3)) {
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "--eye %s --target %s: each should be X,Y,Z in metres", wish->eye,
                            wish->target);
        }
        lmg_vec3 from = view_sub((lmg_vec3){eye[0], eye[1], eye[2]}, scene->origin);
        lmg_vec3 to = view_sub((lmg_vec3){target[0], target[1], target[2]}, scene->origin);
        double fov = (wish->fov > 0 ? wish->fov : DEFAULT_FOV) * VIEW_PI / 180;
        return view_camera_set(camera, from, view_sub(to, from), (lmg_vec3){0, 1, 0}, fov, err);
    }
    if (wish->camera || scene->objects[0].model->camera_count) {
        return view_camera_from_room(scene, wish->camera, camera, err);
    }
    return view_camera_frame(scene, wish->width / (double)wish->height, camera, err);
}

/* ------------------------------------------------------------------------------------------------ warnings, places, Ctrl-C */

void scene_warn(const scene_wish *wish, const view_scene *scene)
{
    if (wish->quiet) {
        return;
    }
    if (!scene->light_count) {
        fprintf(stderr, "warning: %s: nothing shines in this scene; add --light BOX@X,Y,Z or --lamp LAMP.gltf@X,Y,Z\n", wish->room);
    }
    for (uint32_t i = 0; i < scene->object_count; i++) {
        const view_object *object = &scene->objects[i];
        if (object->unseen) {
            fprintf(stderr,
                    "warning: %s: light of \"%.60s\", which has no size, by way of mirrors and clear glass isn't in the picture; "
                    "bake the lamp and use its box, or make an emitter of a surface\n",
                    object->model->path, object->unseen);
        }
    }
}

void scene_warn_eye(const scene_wish *wish, const view_scene *scene, const view_camera *camera)
{
    for (uint32_t i = 0; i < scene->box_count && !wish->quiet; i++) {
        if (view_box_inside(&scene->boxes[i], camera->eye)) {
            fprintf(stderr, "warning: %s: the camera is inside the bounds of this box and sees none of its light from there\n",
                    scene->boxes[i].path);
        }
    }
}

lmg_result scene_check_place(const char *path, lmg_error *err)
{
    char folder[SCENE_PATH_SIZE];
    const char *slash = path ? strrchr(path, '/') : NULL;
    size_t length = slash ? (size_t)(slash - path) : 0;
    if (!path) {
        return LMG_OK;
    }
    if (length >= sizeof folder || !*path || path[strlen(path) - 1] == '/') {
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: isn't the name of a file", path);
    }
    snprintf(folder, sizeof folder, "%.*s", slash ? (int)(length ? length : 1) : 1, slash ? path : ".");
    if (access(folder, W_OK | X_OK) != 0) {
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't write there: %s", path, strerror(errno));
    }
    return LMG_OK;
}

static atomic_int interrupted;

static void on_interrupt(int number)
{
    (void)number;
    atomic_store(&interrupted, 1);
}

const atomic_int *scene_catch_interrupts(void)
{
    struct sigaction action = {.sa_handler = on_interrupt};
    action.sa_flags = (int)SA_RESETHAND; /* a second Ctrl-C ends the program at once */
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    return &interrupted;
}

bool scene_interrupted(void)
{
    return atomic_load(&interrupted);
}
