/* SPDX-License-Identifier: Apache-2.0 */
/* What the commands of lumiview that render have in common: the room, what lights it, the camera.  Options, loading, warnings. */
#ifndef VIEWER_CMD_SCENE_H
#define VIEWER_CMD_SCENE_H

#include "lumiview.h"
#include "view_camera.h"

#include <stdatomic.h>

enum { SCENE_PATH_SIZE = 1024 };

/* A --light or --lamp with what applies to it. */
typedef struct scene_thing {
    bool lamp;
    char path[SCENE_PATH_SIZE];
    view_placement placement;
    double flux;        /* lm, 0 = as it is */
    const char *recipe; /* lamps; NULL = the one beside the model if there is one */
} scene_thing;

typedef struct scene_wish {
    const char *command; /* "render", for messages */
    const char *room, *camera, *eye, *target;
    const char *recipe; /* of the room; NULL = the one beside it if there is one */
    scene_thing *things;
    size_t thing_count;
    const char **sets; /* --set entries, in order, ... */
    size_t *set_thing; /* ... and what each belongs to: 0 the room, 1 the first of things ... */
    size_t set_count;
    uint32_t width, height;
    double fov; /* degrees, 0 = default */
    uint64_t seed, threads, max_depth;
    bool quiet, verbose;
} scene_wish;

/* Room for what argc words can ask for; the rest are defaults.  False: no memory. */
bool scene_wish_create(scene_wish *wish, const char *command, int argc, uint32_t width, uint32_t height);
void scene_wish_free(scene_wish *wish);

/* The options, for getopt_long with the short ones ":...vqh". */
enum {
    SCENE_LIGHT = 512,
    SCENE_LAMP,
    SCENE_RECIPE,
    SCENE_SET,
    SCENE_FLUX,
    SCENE_SIZE,
    SCENE_CAMERA,
    SCENE_EYE,
    SCENE_TARGET,
    SCENE_FOV,
    SCENE_SEED,
    SCENE_THREADS,
    SCENE_DEPTH
};
#define SCENE_OPTIONS                                                                                                              \
    {"light", required_argument, NULL, SCENE_LIGHT}, {"lamp", required_argument, NULL, SCENE_LAMP},                                \
        {"recipe", required_argument, NULL, SCENE_RECIPE}, {"set", required_argument, NULL, SCENE_SET},                            \
        {"flux", required_argument, NULL, SCENE_FLUX}, {"size", required_argument, NULL, SCENE_SIZE},                              \
        {"camera", required_argument, NULL, SCENE_CAMERA}, {"eye", required_argument, NULL, SCENE_EYE},                            \
        {"target", required_argument, NULL, SCENE_TARGET}, {"fov", required_argument, NULL, SCENE_FOV},                            \
        {"seed", required_argument, NULL, SCENE_SEED}, {"threads", required_argument, NULL, SCENE_THREADS},                        \
        {"max-depth", required_argument, NULL, SCENE_DEPTH}, {"quiet", no_argument, NULL, 'q'},                                    \
        {"verbose", no_argument, NULL, 'v'},                                                                                       \
    {                                                                                                                              \
        "help", no_argument, NULL, 'h'                                                                                             \
    }

/* What became of an option.  Bad: the value isn't one, *wanted says what should stand there. */
typedef enum scene_taken {
    SCENE_TAKEN,
    SCENE_NOT_MINE,
    SCENE_BAD,
    SCENE_SAID /* wrong usage, and the message is out */
} scene_taken;
scene_taken scene_option(scene_wish *wish, int option, const char *value, const char **wanted);

/* The room, the last word of the line, and whether options fit together: EXIT_DONE, or EXIT_USAGE and a message is out. */
int scene_finish(scene_wish *wish, int argc, char **argv, int at);

/* Which things come in. */
enum { SCENE_BOXES = 1, SCENE_LAMPS = 2 };

/* The scene, finished; *out is set as soon as there is something to destroy. */
lmg_result scene_load(const scene_wish *wish, unsigned which, view_scene **out, lmg_error *err);
lmg_result scene_camera(const scene_wish *wish, const view_scene *scene, view_camera *camera, lmg_error *err);

/* Warnings on stderr, unless it is to be quiet. */
void scene_warn(const scene_wish *wish, const view_scene *scene);
void scene_warn_eye(const scene_wish *wish, const view_scene *scene, const view_camera *camera);

/* Whether a file can be made where a result is to go: better known before the rendering than after.  path may be NULL. */
lmg_result scene_check_place(const char *path, lmg_error *err);

/* Ctrl-C and SIGTERM: the first sets the flag that this returns, the second ends the program at once. */
const atomic_int *scene_catch_interrupts(void);
bool scene_interrupted(void);

#endif
