/* SPDX-License-Identifier: Apache-2.0 */
/* lumiview render: options, passes, progress, files.  No physics. */
#include "cmd_lux.h"
#include "cmd_scene.h"
#include "image_io.h"
#include "render.h"
#include "tonemap.h"

#include <errno.h>
#include <getopt.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

typedef struct settings {
    scene_wish scene;
    const char *exr, *png, *exposure;
    lux_wish *meters;
    size_t meter_count;
    uint64_t paths;   /* of each meter */
    uint64_t samples; /* 0 = until the time is over */
    double seconds;   /* 0 = no limit */
    bool json;
} settings;

static const uint64_t DEFAULT_SAMPLES = 64, DEFAULT_PATHS = 200000;

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
    enum { PNG = 256, LUX, PATHS, SPP, TIME, EXPOSURE, JSON };
    static const struct option OPTIONS[] = {SCENE_OPTIONS,
                                            {"output", required_argument, NULL, 'o'},
                                            {"png", required_argument, NULL, PNG},
                                            {"lux", required_argument, NULL, LUX},
                                            {"paths", required_argument, NULL, PATHS},
                                            {"spp", required_argument, NULL, SPP},
                                            {"time", required_argument, NULL, TIME},
                                            {"exposure", required_argument, NULL, EXPOSURE},
                                            {"json", no_argument, NULL, JSON},
                                            {NULL, 0, NULL, 0}};
    *s = (settings){.exposure = "auto", .paths = DEFAULT_PATHS};
    s->meters = calloc((size_t)argc, sizeof *s->meters);
    if (!scene_wish_create(&s->scene, "render", argc, 960, 540) || !s->meters) {
        say_error("out of memory");
        return EXIT_FAILED;
    }
    opterr = 0;
    optind = 1;
    int option, which = 0;
    while ((option = getopt_long(argc, argv, ":o:vqh", OPTIONS, &which)) != -1) {
        bool good = true;
        const char *wanted = "";
        switch (option) {
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
        case EXPOSURE:
            s->exposure = optarg;
            break;
        case JSON:
            s->json = true;
            break;
        case 'h':
            print_help();
            return -1;
        case ':':
            return say_usage("render", "%s needs a value", argv[optind - 1]);
        default:
            switch (scene_option(&s->scene, option, optarg, &wanted)) {
            case SCENE_TAKEN:
                break;
            case SCENE_NOT_MINE:
                return say_usage("render", "there is no option %s", argv[optind - 1]);
            case SCENE_BAD:
                good = false;
                break;
            case SCENE_SAID:
                return EXIT_USAGE;
            }
        }
        if (!good) {
            return say_usage("render", "--%s %s: should be %s", OPTIONS[which].name, optarg, wanted);
        }
    }
    int code = scene_finish(&s->scene, argc, argv, optind);
    if (code != EXIT_DONE) {
        return code;
    }
    if (!s->exr && !s->png && !s->meter_count) {
        return say_usage("render", "where should the picture go? Use -o FILE.exr, --png FILE.png or both (or measure with --lux)");
    }
    if (!s->samples && !(s->seconds > 0)) {
        s->samples = DEFAULT_SAMPLES;
    }
    return EXIT_DONE;
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
static lmg_result run_passes(const settings *s, view_render *render, const atomic_int *stop, lmg_error *err)
{
    bool show = !s->scene.quiet && isatty(STDERR_FILENO);
    double begin = now();
    uint64_t done = 0;
    lmg_result r = LMG_OK;
    while (r == LMG_OK && !scene_interrupted()) {
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
        r = view_render_pass(render, (uint32_t)pass, stop, err);
        done += (uint64_t)pass;
        if (show && !scene_interrupted()) {
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
        json_t *o =
            json_pack("{s:i, s:s, s:i, s:i, s:i, s:f, s:I, s:f, s:I, s:f, s:f, s:f, s:I}", "version", 1, "command", "render",
                      "width", (int)s->scene.width, "height", (int)s->scene.height, "samples_per_pixel", (int)state->samples_min,
                      "seconds", state->seconds, "rays", (json_int_t)state->rays, "rays_per_second", rate, "refused",
                      (json_int_t)state->refused, "mean_luminance_cd_m2", state->mean, "mid_grey_cd_m2", mid_grey, "exposure_value",
                      view_exposure_to_ev(mid_grey), "seed", (json_int_t)s->scene.seed);
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
    if (s->scene.quiet) {
        return;
    }
    printf("%s: %u x %u pixels, %u samples per pixel in %.1f s", s->exr ? s->exr : s->png, s->scene.width, s->scene.height,
           state->samples_min, state->seconds);
    if (isfinite(state->noise)) {
        printf(", noise %.2g %%", 100 * state->noise);
    }
    printf("; mean %.4g cd/m2", state->mean);
    if (isfinite(state->mean_render) && state->mean > 0) {
        printf(" +- %.2g %% bake +- %.2g %% render", 100 * state->mean_bake / state->mean, 100 * state->mean_render / state->mean);
    }
    printf("; mid-grey at %.4g cd/m2 (EV %.1f)\n", mid_grey, view_exposure_to_ev(mid_grey));
    if (s->scene.verbose) {
        fprintf(stderr, "%.3g rays, %.2f Mrays/s, %llu paths refused as not finite, paths from boxes for %.0f %% of the samples\n",
                (double)state->rays, rate * 1e-6, (unsigned long long)state->refused, 100 * connect);
    }
}

static lmg_result write_files(const settings *s, const view_render *render, const view_render_state *state, double *mid_grey,
                              const char *command, lmg_error *err)
{
    view_image image;
    lmg_result r = view_image_create(s->scene.width, s->scene.height, &image, err);
    if (r != LMG_OK) {
        return r;
    }
    view_render_resolve(render, &image);
    if (!(*mid_grey > 0)) {
        *mid_grey = view_exposure_auto(&image);
    }
    if (s->exr) {
        view_image_notes notes = {.samples = state->samples_min,
                                  .seconds = state->seconds,
                                  .seed = s->scene.seed,
                                  .mid_grey = *mid_grey,
                                  .command = command};
        r = view_write_exr(&image, &notes, s->exr, err);
    }
    if (r == LMG_OK && s->png) {
        uint8_t *bytes = malloc(3 * (size_t)s->scene.width * s->scene.height);
        if (bytes) {
            view_tonemap(&image, *mid_grey, bytes);
            r = view_write_png(bytes, s->scene.width, s->scene.height, s->png, err);
            free(bytes);
        } else {
            r = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %s", s->png);
        }
    }
    view_image_free(&image);
    return r;
}

/* The picture, from camera to files. */
static lmg_result make_picture(const settings *s, const view_scene *scene, const char *command, json_t *meters, lmg_error *err)
{
    view_render *render = NULL;
    view_camera camera;
    double mid_grey = 0;
    lmg_result r = read_exposure(s->exposure, &mid_grey, err);
    r = r ? r : scene_camera(&s->scene, scene, &camera, err);
    if (r == LMG_OK) {
        scene_warn_eye(&s->scene, scene, &camera);
        view_render_options options = {.width = s->scene.width,
                                       .height = s->scene.height,
                                       .seed = s->scene.seed,
                                       .threads = (unsigned)s->scene.threads,
                                       .path = {.max_depth = (uint32_t)s->scene.max_depth}};
        r = view_render_create(scene, &camera, &options, &render, err);
    }
    if (r == LMG_OK) {
        r = run_passes(s, render, scene_catch_interrupts(), err);
    }
    if (r == LMG_OK) {
        view_render_state state = view_render_look(render);
        r = write_files(s, render, &state, &mid_grey, command, err);
        if (r == LMG_OK) {
            print_result(s, &state, mid_grey, scene->connect, meters);
            if (state.refused && !s->scene.quiet) {
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
    r = r ? r : scene_check_place(s->exr, &err);
    r = r ? r : scene_check_place(s->png, &err);
    r = r ? r : scene_load(&s->scene, SCENE_BOXES | SCENE_LAMPS, &scene, &err);
    if (r == LMG_OK) {
        scene_warn(&s->scene, scene);
        const view_meter_options options = {.samples = s->paths,
                                            .seed = s->scene.seed,
                                            .threads = (unsigned)s->scene.threads,
                                            .path = {.max_depth = (uint32_t)s->scene.max_depth}};
        r = lux_measure(scene, s->meters, s->meter_count, &options, s->scene.quiet, meters, &err);
    }
    if (r == LMG_OK && picture) {
        r = make_picture(s, scene, command, meters, &err);
    } else if (r == LMG_OK && meters) {
        json_t *o = json_pack("{s:i, s:s, s:O, s:I}", "version", 1, "command", "render", "meters", meters, "seed",
                              (json_int_t)s->scene.seed);
        json_dumpf(o, stdout, JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9));
        putchar('\n');
        json_decref(o);
    }
    int code = EXIT_DONE;
    if (r != LMG_OK) {
        code = say_result(r, &err);
    } else if (scene_interrupted()) {
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
    scene_wish_free(&s.scene);
    free(s.meters);
    return code;
}
