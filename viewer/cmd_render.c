/* SPDX-License-Identifier: Apache-2.0 */
/* lumiview render: options, passes, progress, files.  No physics. */
#include "cmd_lux.h"
#include "image_io.h"
#include "lumiview.h"
#include "render.h"
#include "tonemap.h"

#include <errno.h>
#include <getopt.h>
#include <jansson.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { PATH_SIZE = 1024 };

/* A --light or --lamp with what applies to it. */
typedef struct placed {
    bool lamp;
    char path[PATH_SIZE];
    view_placement placement;
    double flux;        /* lm, 0 = as it is */
    const char *recipe; /* lamps; NULL = the one beside the model if there is one */
} placed;

typedef struct settings {
    const char *room, *exr, *png, *camera, *exposure, *eye, *target;
    const char *recipe; /* of the room; NULL = the one beside it if there is one */
    placed *things;
    size_t thing_count;
    lux_wish *meters;
    size_t meter_count;
    uint64_t paths;    /* of each meter */
    const char **sets; /* --set entries, in order, ... */
    size_t *set_thing; /* ... and what each belongs to: 0 the room, 1 the first of things ... */
    size_t set_count;
    uint64_t samples; /* 0 = until the time is over */
    double seconds;   /* 0 = no limit */
    uint32_t width, height;
    double fov; /* degrees, 0 = default */
    uint64_t seed, threads, max_depth;
    bool json, quiet, verbose;
} settings;

static const uint64_t DEFAULT_SAMPLES = 64, DEFAULT_PATHS = 200000;

/* Vertical angle of a camera given by --eye without --fov, degrees. */
static const double DEFAULT_FOV = 50;

static atomic_int interrupted;

static void on_interrupt(int number)
{
    (void)number;
    atomic_store(&interrupted, 1);
}

static void print_help(void)
{
    puts(
        "lumiview render ROOM.gltf [what lights it] -o room.exr --png room.png\n"
        "  --light BOX@X,Y,Z[,R]      a baked box, its origin at X,Y,Z (metres, room's frame); R: one angle about y, or RX,RY,RZ,\n"
        "                             degrees about x, then y, then z.  May be given several times.  A box is light alone: it "
        "hides\n"
        "                             nothing, and points inside its bounds get none of its light\n"
        "  --lamp LAMP.gltf@X,Y,Z[,R] a lamp by its geometry, path traced: slow, the reference.  Lights in ROOM.gltf shine as "
        "well\n"
        "  --recipe FILE              recipe for the last --lamp, or before all of them for the room: materials, smoke and haze\n"
        "                             (default: NAME.recipe.json beside the model, if there is one)\n"
        "  --set ENTRY                a recipe entry for the same, such as emitter:Bulb=800lm; later ones win\n"
        "  --flux LM                  lumens that the sources of the last --light or --lamp emit (default: as baked or modelled)\n"
        "  -o FILE.exr                R,G,B in cd/m2 and stderr.Y, the standard error of the luminance\n"
        "  --png FILE.png             tone-mapped, sRGB\n"
        "  --lux X,Y,Z,NX,NY,NZ       a virtual lux meter at a point on a surface with this normal, all light included: "
        "illuminance with\n"
        "                             the standard errors of the boxes' bakes and of the paths.  May be given several times; the\n"
        "                             picture may be left out\n"
        "  --paths N                  paths of each meter (default 200000)\n"
        "  --spp N                    samples per pixel (default 64, or as many as --time allows)\n"
        "  --time T                   stop before T is over: 60s, 5min, 1h\n"
        "  --size WxH                 pixels (default 960x540)\n"
        "  --camera NAME              a camera of the room (default: its first; if it has none, a view of the whole)\n"
        "  --eye X,Y,Z --target X,Y,Z [--fov DEGREES]   a camera of your own (vertical angle, default 50)\n"
        "  --exposure E               luminance shown as 18 % grey: auto (default), an EV at ISO 100, 120cd/m2, or as in "
        "OTHER.exr\n"
        "  --seed N, --threads N      default 1, all cores; the number of threads doesn't change the picture\n"
        "  --max-depth N              follow light for N scatterings at most (default: without end, by Russian roulette)\n"
        "  --json, --quiet, -v        result as JSON; no messages; more messages\n"
        "Example: lumiview render room.gltf --light spot.box.exr@0,2.4,0 --time 60s -o room.exr --png room.png");
}

/* ------------------------------------------------------------------------------------------------------------- options */

static int read_options(int argc, char **argv, settings *s)
{
    enum {
        LIGHT = 256,
        LAMP,
        RECIPE,
        SET,
        FLUX,
        PNG,
        LUX,
        PATHS,
        SPP,
        TIME,
        SIZE,
        CAMERA,
        EYE,
        TARGET,
        FOV,
        EXPOSURE,
        SEED,
        THREADS,
        DEPTH,
        JSON,
        QUIET
    };
    static const struct option OPTIONS[] = {{"light", required_argument, NULL, LIGHT},
                                            {"lamp", required_argument, NULL, LAMP},
                                            {"recipe", required_argument, NULL, RECIPE},
                                            {"set", required_argument, NULL, SET},
                                            {"flux", required_argument, NULL, FLUX},
                                            {"output", required_argument, NULL, 'o'},
                                            {"png", required_argument, NULL, PNG},
                                            {"lux", required_argument, NULL, LUX},
                                            {"paths", required_argument, NULL, PATHS},
                                            {"spp", required_argument, NULL, SPP},
                                            {"time", required_argument, NULL, TIME},
                                            {"size", required_argument, NULL, SIZE},
                                            {"camera", required_argument, NULL, CAMERA},
                                            {"eye", required_argument, NULL, EYE},
                                            {"target", required_argument, NULL, TARGET},
                                            {"fov", required_argument, NULL, FOV},
                                            {"exposure", required_argument, NULL, EXPOSURE},
                                            {"seed", required_argument, NULL, SEED},
                                            {"threads", required_argument, NULL, THREADS},
                                            {"max-depth", required_argument, NULL, DEPTH},
                                            {"json", no_argument, NULL, JSON},
                                            {"quiet", no_argument, NULL, QUIET},
                                            {"verbose", no_argument, NULL, 'v'},
                                            {"help", no_argument, NULL, 'h'},
                                            {NULL, 0, NULL, 0}};
    *s = (settings){.width = 960, .height = 540, .seed = 1, .max_depth = UINT32_MAX, .exposure = "auto", .paths = DEFAULT_PATHS};
    s->things = calloc((size_t)argc, sizeof *s->things);
    s->sets = calloc((size_t)argc, sizeof *s->sets);
    s->set_thing = calloc((size_t)argc, sizeof *s->set_thing);
    s->meters = calloc((size_t)argc, sizeof *s->meters);
    if (!s->things || !s->meters || !s->sets || !s->set_thing) {
        say_error("out of memory");
        return EXIT_FAILED;
    }
    opterr = 0;
    optind = 1;
    lmg_error err;
    int option, which = 0;
    while ((option = getopt_long(argc, argv, ":o:vqh", OPTIONS, &which)) != -1) {
        placed *last = s->thing_count ? &s->things[s->thing_count - 1] : NULL;
        bool good = true;
        const char *wanted = "";
        switch (option) {
        case LIGHT:
        case LAMP:
            last = &s->things[s->thing_count++];
            last->lamp = option == LAMP;
            if (view_placement_parse(optarg, &last->placement, last->path, sizeof last->path, &err) != LMG_OK) {
                return say_usage("render", "--%s %s", last->lamp ? "lamp" : "light", err.message);
            }
            break;
        case RECIPE:
            if (last && !last->lamp) {
                return say_usage("render", "--recipe belongs behind the --lamp that it is for, or for the room before all of them");
            }
            *(last ? &last->recipe : &s->recipe) = optarg;
            break;
        case SET:
            if (last && !last->lamp) {
                return say_usage("render", "--set belongs behind the --lamp that it is for, or for the room before all of them");
            }
            s->set_thing[s->set_count] = s->thing_count;
            s->sets[s->set_count++] = optarg;
            break;
        case FLUX:
            if (!last) {
                return say_usage("render", "--flux belongs behind the --light or --lamp that it is for");
            }
            good = read_positive(optarg, "lm", &last->flux);
            wanted = "lumens, more than 0";
            break;
        case 'o':
            s->exr = optarg;
            break;
        case PNG:
            s->png = optarg;
            break;
        case LUX:
            good = lux_parse(optarg, &s->meters[s->meter_count++]);
            wanted = "X,Y,Z,NX,NY,NZ: a point in metres and a normal";
            break;
        case PATHS:
            good = read_count(optarg, UINT64_C(1) << 40, &s->paths) && s->paths > 1;
            wanted = "a whole number, at least 2";
            break;
        case SPP:
            good = read_count(optarg, UINT32_MAX / 2, &s->samples) && s->samples > 0;
            wanted = "a whole number, at least 1";
            break;
        case TIME:
            good = read_seconds(optarg, &s->seconds);
            wanted = "a time such as 60s, 5min or 1h";
            break;
        case SIZE:
            good = read_size(optarg, VIEW_MAX_SIDE, &s->width, &s->height);
            wanted = "WIDTHxHEIGHT in pixels, 1 to 16384 each";
            break;
        case CAMERA:
            s->camera = optarg;
            break;
        case EYE:
            s->eye = optarg;
            break;
        case TARGET:
            s->target = optarg;
            break;
        case FOV:
            good = read_positive(optarg, "", &s->fov) && s->fov < 180;
            wanted = "degrees between 0 and 180";
            break;
        case EXPOSURE:
            s->exposure = optarg;
            break;
        case SEED:
            good = read_count(optarg, UINT64_MAX, &s->seed);
            wanted = "a whole number";
            break;
        case THREADS:
            good = read_count(optarg, 1024, &s->threads);
            wanted = "a whole number up to 1024";
            break;
        case DEPTH:
            good = read_count(optarg, UINT32_MAX, &s->max_depth);
            wanted = "a whole number";
            break;
        case JSON:
            s->json = true;
            break;
        case QUIET:
        case 'q':
            s->quiet = true;
            break;
        case 'v':
            s->verbose = true;
            break;
        case 'h':
            print_help();
            return -1;
        case ':':
            return say_usage("render", "%s needs a value", argv[optind - 1]);
        default:
            return say_usage("render", "there is no option %s", argv[optind - 1]);
        }
        if (!good) {
            return say_usage("render", "--%s %s: should be %s", OPTIONS[which].name, optarg, wanted);
        }
    }
    if (optind + 1 != argc) {
        return optind == argc ? say_usage("render", "which room? Name a .gltf or .glb file")
                              : say_usage("render", "one room at a time: what is \"%s\"?", argv[optind + 1]);
    }
    s->room = argv[optind];
    if (!s->exr && !s->png && !s->meter_count) {
        return say_usage("render", "where should the picture go? Use -o FILE.exr, --png FILE.png or both (or measure with --lux)");
    }
    if ((s->eye != NULL) != (s->target != NULL) || (s->fov > 0 && !s->eye) || (s->camera && s->eye)) {
        return say_usage("render", "a camera is either --camera NAME, or --eye and --target (and --fov) together");
    }
    if (!s->samples && !(s->seconds > 0)) {
        s->samples = DEFAULT_SAMPLES;
    }
    return EXIT_DONE;
}

/* ------------------------------------------------------------------------------------------------------------- loading */

/* The recipe beside LAMP.gltf, LAMP.recipe.json; false if there is none. */
static bool recipe_beside(const char *lamp, char path[PATH_SIZE + 16])
{
    snprintf(path, PATH_SIZE, "%s", lamp);
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
static lmg_result make_recipe(const settings *s, const char *model, const char *path, size_t thing, lum_recipe **out,
                              lmg_error *err)
{
    char beside[PATH_SIZE + 16];
    if (!path && recipe_beside(model, beside)) {
        path = beside;
    }
    lmg_result r = path ? lum_recipe_read(path, out, err) : lum_recipe_create(out, err);
    for (size_t i = 0; i < s->set_count && r == LMG_OK; i++) {
        if (s->set_thing[i] == thing) {
            r = lum_recipe_add(*out, s->sets[i], err);
        }
    }
    return r;
}

static lmg_result add_lamp(view_scene *scene, size_t index, const settings *s, lmg_error *err)
{
    const placed *thing = &s->things[index];
    lum_recipe *recipe = NULL;
    lmg_result r = make_recipe(s, thing->path, thing->recipe, index + 1, &recipe, err);
    if (r == LMG_OK) {
        r = view_scene_add_lamp(scene, thing->path, recipe, &thing->placement, thing->flux, err);
    }
    lum_recipe_destroy(recipe);
    if (r == LMG_OK && !s->quiet) {
        print_warnings(scene->objects[scene->object_count - 1].model);
    }
    return r;
}

static lmg_result load(const settings *s, view_scene **out, lmg_error *err)
{
    lum_recipe *recipe = NULL;
    lmg_result r = make_recipe(s, s->room, s->recipe, 0, &recipe, err);
    if (r == LMG_OK) {
        r = view_scene_create(s->room, recipe, out, err);
    }
    lum_recipe_destroy(recipe);
    if (r == LMG_OK && s->verbose) {
        print_warnings((*out)->objects[0].model);
    }
    for (size_t i = 0; i < s->thing_count && r == LMG_OK; i++) {
        const placed *thing = &s->things[i];
        r = thing->lamp ? add_lamp(*out, i, s, err) : view_scene_add_box(*out, thing->path, &thing->placement, thing->flux, err);
    }
    return r == LMG_OK ? view_scene_finish(*out, err) : r;
}

static lmg_result choose_camera(const settings *s, const view_scene *scene, view_camera *camera, lmg_error *err)
{
    if (s->eye) {
        double eye[3], target[3];
        if (!view_parse_numbers(s->eye, eye, 3) || !view_parse_numbers(s->target, target, 3)) {
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "--eye %s --target %s: each should be X,Y,Z in metres", s->eye, s->target);
        }
        lmg_vec3 from = view_sub((lmg_vec3){eye[0], eye[1], eye[2]}, scene->origin);
        lmg_vec3 to = view_sub((lmg_vec3){target[0], target[1], target[2]}, scene->origin);
        double fov = (s->fov > 0 ? s->fov : DEFAULT_FOV) * VIEW_PI / 180;
        return view_camera_set(camera, from, view_sub(to, from), (lmg_vec3){0, 1, 0}, fov, err);
    }
    if (s->camera || scene->objects[0].model->camera_count) {
        return view_camera_from_room(scene, s->camera, camera, err);
    }
    return view_camera_frame(scene, s->width / (double)s->height, camera, err);
}

/* Mid-grey luminance from --exposure, known before rendering; 0 = auto. */
static lmg_result read_exposure(const char *text, double *mid_grey, lmg_error *err)
{
    char *end;
    *mid_grey = 0;
    if (strcmp(text, "auto") == 0) {
        return LMG_OK;
    }
    double value = strtod(text, &end);
    if (end != text && *end == '\0' && fabs(value) <= 64) {
        *mid_grey = view_exposure_from_ev(value);
        return LMG_OK;
    }
    if (end != text && strcmp(end, "cd/m2") == 0 && value > 0 && isfinite(value)) {
        *mid_grey = value;
        return LMG_OK;
    }
    size_t length = strlen(text);
    if (length > 4 && strcmp(text + length - 4, ".exr") == 0) {
        view_image image;
        view_image_notes notes;
        lmg_result r = view_read_exr(text, &image, &notes, err);
        if (r != LMG_OK) {
            return r;
        }
        *mid_grey = notes.mid_grey > 0 ? notes.mid_grey : view_exposure_auto(&image);
        view_image_free(&image);
        return LMG_OK;
    }
    return lmg_fail(err, LMG_ERROR_ARGUMENT,
                    "--exposure %s: should be auto, an EV such as 8.5, a luminance such as 120cd/m2, or a picture .exr", text);
}

/* ------------------------------------------------------------------------------------------------------------ rendering */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void print_progress(const settings *s, const view_render *render, double elapsed)
{
    view_render_state state = view_render_look(render);
    double rate = (double)state.rays / fmax(state.seconds, 1e-9), per_sample = elapsed / state.samples_min;
    double left = s->samples ? per_sample * (double)(s->samples - state.samples_min) : s->seconds - elapsed;
    if (s->samples && s->seconds > 0) {
        left = fmin(left, s->seconds - elapsed);
    }
    fprintf(stderr, "\r%u samples per pixel, %.2f Mrays/s, noise %.2g %%, %.0f s left \033[K", state.samples_min, rate * 1e-6,
            100 * state.noise, fmax(left, 0));
}

/* Passes until the samples are there, the time is over, or somebody interrupts. */
static lmg_result run_passes(const settings *s, view_render *render, lmg_error *err)
{
    bool show = !s->quiet && isatty(STDERR_FILENO);
    double begin = now();
    uint64_t done = 0;
    lmg_result r = LMG_OK;
    while (r == LMG_OK && !atomic_load(&interrupted)) {
        double elapsed = now() - begin, per_sample = done ? elapsed / (double)done : 0;
        double left = s->seconds > 0 ? s->seconds - elapsed : (double)INFINITY;
        if ((s->samples && done >= s->samples) || (done && left < per_sample)) {
            break;
        }
        /* About a second per pass, so that the display moves. */
        double pass = done ? fmin(fmax(1 / per_sample, 1), fmin(left / per_sample, 1e6)) : 1;
        if (s->samples) {
            pass = fmin(pass, (double)(s->samples - done));
        }
        r = view_render_pass(render, (uint32_t)pass, &interrupted, err);
        done += (uint64_t)pass;
        if (show && !atomic_load(&interrupted)) {
            print_progress(s, render, now() - begin);
        }
    }
    if (show) {
        fputs("\r\033[K", stderr);
    }
    return r;
}

/* The command line as one string, quoted where the shell would need it; NULL when there's no memory. */
static char *command_line(int argc, char **argv)
{
    size_t size = sizeof "lumiview";
    for (int i = 0; i < argc; i++) {
        size += 4 * strlen(argv[i]) + 3;
    }
    char *text = malloc(size), *end = text;
    if (!text) {
        return NULL;
    }
    end += sprintf(end, "lumiview");
    for (int i = 0; i < argc; i++) {
        bool plain = argv[i][0] &&
                     strspn(argv[i], "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789@%+=:,./_-") == strlen(argv[i]);
        *end++ = ' ';
        if (plain) {
            end += sprintf(end, "%s", argv[i]);
            continue;
        }
        *end++ = '\'';
        for (const char *c = argv[i]; *c; c++) {
            if (*c == '\'') {
                end += sprintf(end, "'\\''");
            } else {
                *end++ = *c;
            }
        }
        *end++ = '\'';
    }
    *end = '\0';
    return text;
}

static void print_result(const settings *s, const view_render_state *state, double mid_grey, double connect, json_t *meters)
{
    double rate = (double)state->rays / fmax(state->seconds, 1e-9);
    if (s->json) {
        json_t *o = json_pack(
            "{s:i, s:s, s:i, s:i, s:i, s:f, s:I, s:f, s:I, s:f, s:f, s:f, s:I}", "version", 1, "command", "render", "width",
            (int)s->width, "height", (int)s->height, "samples_per_pixel", (int)state->samples_min, "seconds", state->seconds,
            "rays", (json_int_t)state->rays, "rays_per_second", rate, "refused", (json_int_t)state->refused, "mean_luminance_cd_m2",
            state->mean, "mid_grey_cd_m2", mid_grey, "exposure_value", view_exposure_to_ev(mid_grey), "seed", (json_int_t)s->seed);
        if (o) {
            json_object_set_new(o, "noise", isfinite(state->noise) ? json_real(state->noise) : json_null());
            json_object_set_new(o, "mean_standard_error_bake_cd_m2", json_real(state->mean_bake));
            json_object_set_new(o, "mean_standard_error_render_cd_m2",
                                isfinite(state->mean_render) ? json_real(state->mean_render) : json_null());
            json_object_set(o, "meters", meters);
            json_object_set_new(o, "exr", s->exr ? json_string(s->exr) : json_null());
            json_object_set_new(o, "png", s->png ? json_string(s->png) : json_null());
            json_dumpf(o, stdout, JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9));
            putchar('\n');
            json_decref(o);
        }
        return;
    }
    if (s->quiet) {
        return;
    }
    printf("%s: %u x %u pixels, %u samples per pixel in %.1f s", s->exr ? s->exr : s->png, s->width, s->height, state->samples_min,
           state->seconds);
    if (isfinite(state->noise)) {
        printf(", noise %.2g %%", 100 * state->noise);
    }
    printf("; mean %.4g cd/m2", state->mean);
    if (isfinite(state->mean_render) && state->mean > 0) {
        printf(" +- %.2g %% bake +- %.2g %% render", 100 * state->mean_bake / state->mean, 100 * state->mean_render / state->mean);
    }
    printf("; mid-grey at %.4g cd/m2 (EV %.1f)\n", mid_grey, view_exposure_to_ev(mid_grey));
    if (s->verbose) {
        fprintf(stderr, "%.3g rays, %.2f Mrays/s, %llu paths refused as not finite, paths from boxes for %.0f %% of the samples\n",
                (double)state->rays, rate * 1e-6, (unsigned long long)state->refused, 100 * connect);
    }
}

/* Whether a file can be made where the picture is to go: better known before the rendering than after. */
static lmg_result check_place(const char *path, lmg_error *err)
{
    char folder[PATH_SIZE];
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

static lmg_result write_files(const settings *s, const view_render *render, const view_render_state *state, double *mid_grey,
                              const char *command, lmg_error *err)
{
    view_image image;
    lmg_result r = view_image_create(s->width, s->height, &image, err);
    if (r != LMG_OK) {
        return r;
    }
    view_render_resolve(render, &image);
    if (!(*mid_grey > 0)) {
        *mid_grey = view_exposure_auto(&image);
    }
    if (s->exr) {
        view_image_notes notes = {
            .samples = state->samples_min, .seconds = state->seconds, .seed = s->seed, .mid_grey = *mid_grey, .command = command};
        r = view_write_exr(&image, &notes, s->exr, err);
    }
    if (r == LMG_OK && s->png) {
        uint8_t *bytes = malloc(3 * (size_t)s->width * s->height);
        if (bytes) {
            view_tonemap(&image, *mid_grey, bytes);
            r = view_write_png(bytes, s->width, s->height, s->png, err);
            free(bytes);
        } else {
            r = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %s", s->png);
        }
    }
    view_image_free(&image);
    return r;
}

static void warn_about_scene(const settings *s, const view_scene *scene)
{
    if (s->quiet) {
        return;
    }
    if (!scene->light_count) {
        fprintf(stderr, "warning: %s: nothing shines in this scene; add --light BOX@X,Y,Z or --lamp LAMP.gltf@X,Y,Z\n", s->room);
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

static void warn_about_eye(const settings *s, const view_scene *scene, const view_camera *camera)
{
    for (uint32_t i = 0; i < scene->box_count && !s->quiet; i++) {
        if (view_box_inside(&scene->boxes[i], camera->eye)) {
            fprintf(stderr, "warning: %s: the camera is inside the bounds of this box and sees none of its light from there\n",
                    scene->boxes[i].path);
        }
    }
}

/* The picture, from camera to files. */
static lmg_result make_picture(const settings *s, const view_scene *scene, const char *command, json_t *meters, lmg_error *err)
{
    view_render *render = NULL;
    view_camera camera;
    double mid_grey = 0;
    lmg_result r = read_exposure(s->exposure, &mid_grey, err);
    r = r ? r : choose_camera(s, scene, &camera, err);
    if (r == LMG_OK) {
        warn_about_eye(s, scene, &camera);
        view_render_options options = {.width = s->width,
                                       .height = s->height,
                                       .seed = s->seed,
                                       .threads = (unsigned)s->threads,
                                       .path = {.max_depth = (uint32_t)s->max_depth}};
        r = view_render_create(scene, &camera, &options, &render, err);
    }
    if (r == LMG_OK) {
        struct sigaction action = {.sa_handler = on_interrupt};
        action.sa_flags = (int)SA_RESETHAND; /* a second Ctrl-C ends the program at once */
        sigaction(SIGINT, &action, NULL);
        sigaction(SIGTERM, &action, NULL);
        r = run_passes(s, render, err);
    }
    if (r == LMG_OK) {
        view_render_state state = view_render_look(render);
        r = write_files(s, render, &state, &mid_grey, command, err);
        if (r == LMG_OK) {
            print_result(s, &state, mid_grey, scene->connect, meters);
            if (state.refused && !s->quiet) {
                fprintf(stderr, "warning: %llu paths gave no finite number and count as dark\n", (unsigned long long)state.refused);
            }
        }
    }
    view_render_destroy(render);
    return r;
}

static int render_scene(const settings *s, int argc, char **argv)
{
    lmg_error err;
    view_scene *scene = NULL;
    bool picture = s->exr || s->png;
    double unused;
    char *command = command_line(argc, argv);
    json_t *meters = s->json ? json_array() : NULL;
    lmg_result r = read_exposure(s->exposure, &unused, &err);
    r = r ? r : check_place(s->exr, &err);
    r = r ? r : check_place(s->png, &err);
    r = r ? r : load(s, &scene, &err);
    if (r == LMG_OK) {
        warn_about_scene(s, scene);
        const view_meter_options options = {
            .samples = s->paths, .seed = s->seed, .threads = (unsigned)s->threads, .path = {.max_depth = (uint32_t)s->max_depth}};
        r = lux_measure(scene, s->meters, s->meter_count, &options, s->quiet, meters, &err);
    }
    if (r == LMG_OK && picture) {
        r = make_picture(s, scene, command, meters, &err);
    } else if (r == LMG_OK && meters) {
        json_t *o =
            json_pack("{s:i, s:s, s:O, s:I}", "version", 1, "command", "render", "meters", meters, "seed", (json_int_t)s->seed);
        json_dumpf(o, stdout, JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9));
        putchar('\n');
        json_decref(o);
    }
    int code = EXIT_DONE;
    if (r != LMG_OK) {
        code = say_result(r, &err);
    } else if (atomic_load(&interrupted)) {
        code = EXIT_INTERRUPTED;
    }
    json_decref(meters);
    view_scene_destroy(scene);
    free(command);
    return code;
}

int cmd_render(int argc, char **argv)
{
    settings s;
    int code = read_options(argc, argv, &s);
    if (code == EXIT_DONE) {
        code = render_scene(&s, argc, argv);
    } else if (code < 0) {
        code = EXIT_DONE; /* --help */
    }
    free(s.things);
    free(s.sets);
    free(s.set_thing);
    free(s.meters);
    return code;
}
