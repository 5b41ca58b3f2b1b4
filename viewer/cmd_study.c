/* SPDX-License-Identifier: Apache-2.0 */
/* lumiview study: what a picture's accuracy costs in time, by a box and by a lamp's geometry.  Command line only. */
#include "cmd_scene.h"
#include "room_study.h"

#include <getopt.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef struct settings {
    scene_wish scene;
    const char *page;
    uint64_t samples, runs, block;
    double seconds;
    bool json;
} settings;

static const double DEFAULT_SECONDS = 300;
enum { RUNGS = 6 };

static void print_help(void)
{
    puts(
        "lumiview study ROOM.gltf --light BOX@X,Y,Z --lamp LAMP.gltf@X,Y,Z -o study.html: what a picture's accuracy costs in time, "
        "lit\n"
        "by the box and by the lamp's geometry in the same place\n"
        "Renders the room with rising numbers of samples per pixel, several times each, and measures each picture's error against "
        "a far\n"
        "longer one with random numbers of its own; says how much longer the geometry takes for the same error.\n"
        "  --light, --lamp, --recipe, --set, --flux   what lights it, as in render; the boxes light one room, the lamps the other\n"
        "  -o FILE.html    the study as one page with plots (needs gnuplot)\n"
        "  --time T        of the whole study, about: 90s, 5min (default)\n"
        "  --spp N         instead: up to N samples per pixel by both; the reference has 16 N\n"
        "  --runs N        pictures of each kind (default 8, at least 3)\n"
        "  --block N       errors are those of the mean luminance of N x N pixels (default 8)\n"
        "  --size WxH      pixels (default 96x72)\n"
        "  --camera NAME, --eye X,Y,Z --target X,Y,Z [--fov DEGREES], --seed N, --threads N, --max-depth N   as in render\n"
        "  --json, --quiet, -v   every number as JSON; no messages; more messages\n"
        "Times are those of processors, all threads together; loading isn't counted.\n"
        "Example: lumiview study room.gltf --light spot.box.exr@0,2.2,0 --lamp spot.gltf@0,2.2,0 -o study.html");
}

static int read_options(int argc, char **argv, settings *s)
{
    enum { TIME = 256, SPP, RUNS, BLOCK, JSON };
    static const struct option OPTIONS[] = {SCENE_OPTIONS,
                                            {"output", required_argument, NULL, 'o'},
                                            {"time", required_argument, NULL, TIME},
                                            {"spp", required_argument, NULL, SPP},
                                            {"runs", required_argument, NULL, RUNS},
                                            {"block", required_argument, NULL, BLOCK},
                                            {"json", no_argument, NULL, JSON},
                                            {NULL, 0, NULL, 0}};
    *s = (settings){.runs = 8, .block = 8};
    if (!scene_wish_create(&s->scene, "study", argc, 96, 72)) {
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
            s->page = optarg;
            break;
        case TIME:
            good = read_seconds(optarg, &s->seconds);
            wanted = "a time such as 90s or 5min";
            break;
        case SPP:
            good = read_count(optarg, UINT32_MAX / VIEW_STUDY_REFERENCE, &s->samples) && s->samples > 0;
            wanted = "a whole number, at least 1 and at most 268435455";
            break;
        case RUNS:
            good = read_count(optarg, VIEW_STUDY_MAX_RUNS, &s->runs) && s->runs >= 3;
            wanted = "a whole number from 3 to 64";
            break;
        case BLOCK:
            good = read_count(optarg, VIEW_MAX_SIDE, &s->block) && s->block > 0;
            wanted = "a whole number of pixels, at least 1";
            break;
        case JSON:
            s->json = true;
            break;
        case 'h':
            print_help();
            return -1;
        case ':':
            return say_usage("study", "%s needs a value", argv[optind - 1]);
        default:
            switch (scene_option(&s->scene, option, optarg, &wanted)) {
            case SCENE_TAKEN:
                break;
            case SCENE_NOT_MINE:
                return say_usage("study", "there is no option %s", argv[optind - 1]);
            case SCENE_BAD:
                good = false;
                break;
            case SCENE_SAID:
                return EXIT_USAGE;
            }
        }
        if (!good) {
            return say_usage("study", "--%s %s: should be %s", OPTIONS[which].name, optarg, wanted);
        }
    }
    int code = scene_finish(&s->scene, argc, argv, optind);
    if (code != EXIT_DONE) {
        return code;
    }
    bool light = false, lamp = false;
    for (size_t i = 0; i < s->scene.thing_count; i++) {
        *(s->scene.things[i].lamp ? &lamp : &light) = true;
    }
    if (!light || !lamp) {
        return say_usage("study",
                         "what is to be compared? Name a box with --light BOX@X,Y,Z and its lamp with --lamp LAMP.gltf@X,Y,Z");
    }
    if (s->samples && s->seconds > 0) {
        return say_usage("study", "--time or --spp, not both: the one decides the other");
    }
    if (s->scene.quiet && !s->page && !s->json) {
        return say_usage("study", "--quiet without -o or --json would say nothing");
    }
    if (s->scene.width / s->block < 2 || s->scene.height / s->block < 2) {
        return say_usage(
            "study", "%u x %u pixels have fewer than two blocks of %u pixels each way; use a larger --size or a smaller --block",
            s->scene.width, s->scene.height, (unsigned)s->block);
    }
    return EXIT_DONE;
}

/* ------------------------------------------------------------------------------------------------------------- results */

static const char HEAD[] = "lit by     samples  seconds    error %           median block %\n";

static void print_rung(FILE *to, view_study_method m, const view_study_rung *r)
{
    fprintf(to, "%-9s %8u %8.3g   %7.3g +- %-7.2g %7.3g\n", view_study_method_name(m), r->samples, r->seconds, 100 * r->error.rms,
            100 * r->error.standard_error, 100 * r->median);
}

static void show_progress(void *self, view_study_method m, const view_study_rung *rung, size_t done, size_t all)
{
    (void)self;
    fprintf(stderr, "[%2zu/%zu] ", done, all);
    print_rung(stderr, m, rung);
}

static json_t *number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

static json_t *slope_json(report_slope f)
{
    return json_pack("{s:o, s:o, s:o, s:I}", "slope", number(f.slope), "standard_error", number(f.standard_error), "confidence_95",
                     number(f.confidence), "points", (json_int_t)f.points);
}

static json_t *result_json(const view_study *s, const view_study_result *r)
{
    json_t *rungs = json_array();
    for (size_t k = 0; k < r->rung_count; k++) {
        const view_study_rung *rung = &r->rungs[k];
        json_t *seeds = json_array(), *squares = json_array();
        for (uint32_t i = 0; i < s->runs; i++) {
            json_array_append_new(seeds, json_integer((json_int_t)rung->seed[i]));
            json_array_append_new(squares, number(rung->run[i]));
        }
        json_array_append_new(rungs, json_pack("{s:I, s:f, s:o, s:o, s:o, s:o, s:o}", "samples_per_pixel",
                                               (json_int_t)rung->samples, "processor_s", rung->seconds, "rms",
                                               number(rung->error.rms), "standard_error", number(rung->error.standard_error),
                                               "median", number(rung->median), "squared_errors", squares, "seeds", seeds));
    }
    return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "rungs", rungs, "over_time", slope_json(r->over_seconds),
                     "over_samples", slope_json(r->over_samples), "median_over_time", slope_json(r->median_over_seconds),
                     "squared_error_times_s", number(r->cost), "squared_error_times_s_standard_error", number(r->cost_se),
                     "squared_error_times_s_median", number(r->cost_median));
}

static json_t *study_json(const settings *s, const view_study *study)
{
    json_t *lights = json_array(), *lamps = json_array();
    for (size_t i = 0; i < s->scene.thing_count; i++) {
        json_array_append_new(s->scene.things[i].lamp ? lamps : lights, json_string(s->scene.things[i].path));
    }
    json_t *reference = json_pack("{s:I, s:[I,I], s:f, s:o}", "samples_per_pixel", (json_int_t)study->reference_samples, "seeds",
                                  (json_int_t)study->reference_seed[0], (json_int_t)study->reference_seed[1], "processor_s",
                                  study->reference_seconds, "noise", number(study->reference_noise));
    json_t *ratio = json_pack("{s:o, s:o, s:o}", "mean", number(study->ratio), "standard_error", number(study->ratio_se), "median",
                              number(study->ratio_median));
    json_t *difference =
        json_pack("{s:o, s:o}", "rms", number(study->difference.rms), "standard_error", number(study->difference.standard_error));
    return json_pack("{s:i, s:s, s:s, s:o, s:o, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:o, s:o, s:o, s:o, s:o}", "version", 1,
                     "command", "study", "room", s->scene.room, "lights", lights, "lamps", lamps, "width", (json_int_t)study->width,
                     "height", (json_int_t)study->height, "block_pixels", (json_int_t)study->block, "blocks",
                     (json_int_t)study->blocks, "lamp_blocks", (json_int_t)study->lamp_blocks, "dark_blocks",
                     (json_int_t)study->dark_blocks, "runs", (json_int_t)study->runs, "seed", (json_int_t)s->scene.seed,
                     "reference", reference, "box", result_json(study, &study->of[VIEW_STUDY_BOX]), "geometry",
                     result_json(study, &study->of[VIEW_STUDY_GEOMETRY]), "time_ratio_at_equal_error", ratio,
                     "difference_beyond_spread", difference);
}

static void print_study(const settings *s, const view_study *study)
{
    printf("%s: %u x %u pixels, %u blocks of %u x %u (%u with the lamp and %u dark ones left out), reference of %u samples (noise "
           "%.2g %%)\n%s",
           s->scene.room, study->width, study->height, study->blocks, study->block, study->block, study->lamp_blocks,
           study->dark_blocks, study->reference_samples, 100 * study->reference_noise, HEAD);
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        for (size_t k = 0; k < study->of[m].rung_count; k++) {
            print_rung(stdout, (view_study_method)m, &study->of[m].rungs[k]);
        }
    }
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        const view_study_result *r = &study->of[m];
        char time[64], samples[64], median[64];
        printf("%-9s slope over time %s, over samples %s, of the median block %s (95 %%); error^2 x time %.3g +- %.2g s, median "
               "block %.3g s\n",
               view_study_method_name((view_study_method)m), report_slope_text(r->over_seconds, "+-", time),
               report_slope_text(r->over_samples, "+-", samples), report_slope_text(r->median_over_seconds, "+-", median), r->cost,
               r->cost_se, r->cost_median);
    }
    printf("all pictures by the geometry together differ from the reference by %.3g +- %.2g %% beyond their spread\n",
           100 * study->difference.rms, 100 * study->difference.standard_error);
    printf("time of geometry over box at equal error: %.3g +- %.2g, %.3g by the median block\n", study->ratio, study->ratio_se,
           study->ratio_median);
}

static bool print_result(const settings *s, const view_study *study)
{
    if (s->json) {
        json_t *o = study_json(s, study);
        if (!o || json_dumpf(o, stdout, JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9)) != 0) {
            json_decref(o);
            return false;
        }
        putchar('\n');
        json_decref(o);
    } else if (!s->scene.quiet) {
        print_study(s, study);
    }
    return fflush(stdout) == 0 && !ferror(stdout);
}

/* ----------------------------------------------------------------------------------------------------------------- run */

static const char *base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* "spot.box.exr and by spot.gltf", of the first of each. */
static void name_lights(const scene_wish *wish, char *text, size_t size)
{
    const char *light = NULL, *lamp = NULL;
    for (size_t i = wish->thing_count; i-- > 0;) {
        *(wish->things[i].lamp ? &lamp : &light) = base_name(wish->things[i].path);
    }
    snprintf(text, size, "%s and by %s", light, lamp);
}

static lmg_result run_study(const settings *s, view_study *study, lmg_error *err)
{
    view_scene *boxed = NULL, *built = NULL;
    view_camera camera;
    const atomic_int *stop = scene_catch_interrupts(); /* while it loads too: then the study ends before it begins */
    lmg_result r = scene_check_place(s->page, err);
    r = r ? r : scene_load(&s->scene, SCENE_BOXES, &boxed, err);
    r = r ? r : scene_load(&s->scene, SCENE_LAMPS, &built, err);
    r = r ? r : scene_camera(&s->scene, boxed, &camera, err);
    if (r == LMG_OK) {
        scene_warn(&s->scene, built);
        scene_warn_eye(&s->scene, boxed, &camera);
        const view_study_options options = {
            .width = s->scene.width,
            .height = s->scene.height,
            .block = (uint32_t)s->block,
            .runs = (uint32_t)s->runs,
            .rungs = RUNGS,
            .samples = {(uint32_t)s->samples, (uint32_t)s->samples},
            .seconds = s->seconds > 0 ? s->seconds : DEFAULT_SECONDS,
            .seed = s->scene.seed,
            .threads = (unsigned)s->scene.threads,
            .path = {.max_depth = (uint32_t)s->scene.max_depth},
            .stop = stop,
            .progress = s->scene.quiet || !isatty(STDERR_FILENO) ? NULL : show_progress,
        };
        if (options.progress) {
            fprintf(stderr, "        %s", HEAD);
        }
        r = view_study_run(boxed, built, &camera, &options, study, err);
    }
    view_scene_destroy(boxed);
    view_scene_destroy(built);
    return r;
}

static int study_room(const settings *s)
{
    static view_study study;
    lmg_error err;
    lmg_result r = run_study(s, &study, &err);
    if (r != LMG_OK) {
        int code = say_result(r, &err);
        return scene_interrupted() ? EXIT_INTERRUPTED : code;
    }
    if (!print_result(s, &study)) {
        say_error("can't print the study");
        return EXIT_FAILED;
    }
    if (s->page) {
        char lights[256];
        name_lights(&s->scene, lights, sizeof lights);
        if (view_study_report(&study, base_name(s->scene.room), lights, s->page, &err) != LMG_OK) {
            say_error("%s", err.message);
            return EXIT_FAILED;
        }
    }
    return scene_interrupted() ? EXIT_INTERRUPTED : EXIT_DONE;
}

int cmd_study(int argc, char **argv)
{
    settings s;
    int code = read_options(argc, argv, &s);
    if (code == EXIT_DONE) {
        code = study_room(&s);
    } else if (code < 0) {
        code = EXIT_DONE; /* --help */
    }
    scene_wish_free(&s.scene);
    return code;
}
