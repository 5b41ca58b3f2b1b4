/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake study: what accuracy costs in time, for one lamp. */
#include "program.h"

#include "study.h"

#include <luminaires/model.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { KEY_TIME = 256, KEY_FLUX, KEY_SEED, KEY_THREADS, KEY_JSON };

static const struct argp_option OPTIONS[] = {
    {"output", 'o', "REPORT.html", 0, "write the study as one HTML file (needs gnuplot)", 1},
    {"time", KEY_TIME, "TIME", 0, "of the whole study, about: 90s, 10m (default 5m)", 1},
    {"flux", KEY_FLUX, "LM", 0, "what the lamp's sources emit, as in bake", 2},
    LAMP_OPTIONS(2),
    {"seed", KEY_SEED, "N", 0, "seed of the random numbers (default 1)", 3},
    {"threads", KEY_THREADS, "N", 0, "default: all cores", 3},
    {"json", KEY_JSON, 0, 0, "every number as JSON", 4},
    {0},
};

static const char DOC[] = "Bakes a lamp with rising numbers of photons and of cells, judges every box by many more of the lamp's "
                          "own rays, and says what an error of "
                          "5, 2, 1 and 0.5 % costs in time and size; what plain bins and rays traced backwards would make of it."
                          "\vExample:\n  lumibake study lamp.gltf --time 10m -o study.html";

typedef struct command {
    lamp_options lamp;
    study_options options;
    const char *report;
    bool json;
} command;

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case 'o':
        c->report = arg;
        break;
    case KEY_TIME:
        c->options.seconds = argument_seconds(state, "--time", arg);
        break;
    case KEY_FLUX:
        c->options.flux_lm = argument_lumens(state, "--flux", arg);
        break;
    case KEY_SEED:
        c->options.seed = argument_count(state, "--seed", arg, 0, UINT64_MAX);
        break;
    case KEY_THREADS:
        c->options.threads = (unsigned)argument_count(state, "--threads", arg, 1, 1024);
        break;
    case KEY_JSON:
        c->json = true;
        break;
    case ARGP_KEY_ARG:
        if (c->lamp.path)
            usage_error(state, "'%s': one lamp at a time", arg);
        c->lamp.path = arg;
        break;
    case ARGP_KEY_END:
        if (!c->lamp.path)
            usage_error(state, "which lamp? give a .gltf or .glb file");
        break;
    default:
        return parse_lamp_option(state, key, arg, &c->lamp) ? 0 : ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static void print_rung(FILE *to, const study_rung *r)
{
    fprintf(to, "%-8s %9.3g %9.3g %7.1f %6.1f", study_ladder_name(r->ladder), (double)r->photons, (double)r->cells,
            study_rung_seconds(r), 1e-6 * (double)r->bytes);
    for (int m = 0; m < JUDGE_MEASURES; ++m)
        fprintf(to, "  %6.2f +- %-4.2f", 100 * r->verdict.error[m].rms, 100 * r->verdict.error[m].standard_error);
    if (isfinite(r->plain.error[JUDGE_NEAR].rms))
        fprintf(to, "  %6.2f", 100 * r->plain.error[JUDGE_NEAR].rms);
    fputc('\n', to);
}

static const char HEAD[] =
    "ladder     photons     cells seconds     MB    near field %      far field %    luminance %  near, plain bins %\n";

static void show_progress(void *self, const study_rung *rung, size_t done, size_t all)
{
    (void)self;
    if (done == 1)
        fputs(HEAD, stderr);
    fprintf(stderr, "[%2zu/%zu] ", done, all);
    print_rung(stderr, rung);
}

static json_t *error_json(judge_error e)
{
    return json_pack("{s:o, s:o}", "rms", json_number(e.rms), "standard_error", json_number(e.standard_error));
}

static json_t *slope_json(report_slope f)
{
    return json_pack("{s:o, s:o, s:o, s:I}", "slope", json_number(f.slope), "standard_error", json_number(f.standard_error),
                     "confidence_95", json_number(f.confidence), "points", (json_int_t)f.points);
}

static json_t *study_json(const command *c, const study *s)
{
    static const char *const KEYS[JUDGE_MEASURES] = {"near_field", "far_field", "luminance"};
    json_t *rungs = json_array(), *fits = json_object(), *advice = json_array();
    for (size_t i = 0; i < s->rung_count; ++i) {
        const study_rung *r = &s->rungs[i];
        json_t *planes = json_array(), *plain = json_object();
        json_t *j =
            json_pack("{s:s, s:I, s:I, s:I, s:I, s:f, s:f, s:f, s:f, s:f, s:f, s:o}", "ladder", study_ladder_name(r->ladder),
                      "photons", (json_int_t)r->photons, "gathered_rays", (json_int_t)r->gathered_rays, "cells",
                      (json_int_t)r->cells, "bytes", (json_int_t)r->bytes, "pilot_s", r->pilot_seconds, "trace_s", r->trace_seconds,
                      "gather_s", r->gather_seconds, "reconstruct_s", r->reconstruct_seconds, "write_s", r->write_seconds,
                      "processor_s", r->processor_seconds, "noise", json_number(r->noise));
        for (int k = 0; k < JUDGE_DISTANCES; ++k)
            json_array_append_new(planes, error_json(r->verdict.planes[k]));
        json_object_set_new(j, "planes", planes);
        for (int m = 0; m < JUDGE_MEASURES; ++m)
            json_object_set_new(j, KEYS[m], error_json(r->verdict.error[m]));
        for (int m = 0; m < JUDGE_MEASURES; ++m)
            json_object_set_new(plain, KEYS[m], error_json(r->plain.error[m]));
        json_object_set_new(j, "plain_bins", plain);
        json_array_append_new(rungs, j);
    }
    for (int m = 0; m < JUDGE_MEASURES; ++m)
        json_object_set_new(fits, KEYS[m],
                            json_pack("{s:o, s:o, s:o, s:o}", "of_1e6_photons", json_number(report_slope_y(s->fit[m].over_photons, 1e6)), "over_photons", slope_json(s->fit[m].over_photons), "over_time",
                                      slope_json(s->fit[m].over_seconds), "reference_noise", json_number(s->reference_noise[m])));
    for (int t = 0; t < STUDY_TARGETS; ++t) {
        const study_advice *a = &s->advice[t];
        char line[1024];
        json_t *text = a->reachable ? json_string(study_command(a, c->lamp.path, line, sizeof(line))) : json_null();
        json_array_append_new(advice, json_pack("{s:o, s:f, s:b, s:I, s:f, s:f}", "command", text, "target", a->target,
                                                "reachable", a->reachable, "photons", (json_int_t)a->photons, "seconds", a->seconds, "bytes", a->bytes));
    }
    return json_pack("{s:s, s:s, s:f, s:I, s:f, s:f, s:o, s:o, s:o, s:o}", "format", "lumibake study 3", "lamp", c->lamp.path,
                     "size_m", s->size, "reference_photons", (json_int_t)s->reference_photons, "photons_per_second",
                     s->photons_per_second, "deposit_share", s->deposit_share, "rungs", rungs, "fits", fits, "advice", advice,
                     "combined_why", s->combined_why[0] ? json_string(s->combined_why) : json_null());
}

static void print_study(const command *c, const study *s)
{
    printf("%s: judged by %.3g rays of its own, size %.4g m\n%s", c->lamp.path, (double)s->reference_photons, s->size, HEAD);
    for (size_t i = 0; i < s->rung_count; ++i)
        print_rung(stdout, &s->rungs[i]);
    for (int m = 0; m < JUDGE_MEASURES; ++m) {
        char photons[64], seconds[64];
        printf("%-24s slope over photons %s, over time %s (95 %%), %.2f %% with 1e6 photons\n", judge_measure_name((judge_measure)m),
               report_slope_text(s->fit[m].over_photons, "+-", photons), report_slope_text(s->fit[m].over_seconds, "+-", seconds),
               100 * report_slope_y(s->fit[m].over_photons, 1e6));
    }
    if (s->combined_why[0])
        printf("no ladder of photons and rays traced backwards: %s\n", s->combined_why);
    printf("depositing takes %.0f %% of tracing\n", 100 * s->deposit_share);
    for (int t = 0; t < STUDY_TARGETS; ++t) {
        const study_advice *a = &s->advice[t];
        char line[1024];
        if (a->reachable)
            printf("%4g %%: %s, about %.2g s and %.2g MB\n", 100 * a->target, study_command(a, c->lamp.path, line, sizeof(line)),
                   a->seconds, 1e-6 * a->bytes);
        else
            printf("%4g %%: not foretold; give the study more time\n", 100 * a->target);
    }
}

int cmd_study(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "LAMP", .doc = DOC};
    command c = {.options = {.seconds = 300, .seed = 1}};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    lum_model *model;
    char *recipe, used[1024];
    lmg_result result = lamp_load(&c.lamp, &model, &recipe, used, &err);
    free(recipe);
    if (result != LMG_OK)
        return report_error(result, &err);
    if (used[0] && !c.lamp.recipe_path)
        fprintf(stderr, "using the recipe %s\n", used);
    c.options.stop = catch_interrupts();
    c.options.progress = show_progress;
    const char *temporary = getenv("TMPDIR");
    c.options.folder = temporary && temporary[0] ? temporary : "/tmp";
    study s;
    result = study_run(model, &c.options, &s, &err);
    lum_model_destroy(model);
    if (result != LMG_OK)
        return report_error(result, &err);
    bool printed;
    if (c.json) {
        printed = print_json(study_json(&c, &s));
    } else {
        print_study(&c, &s);
        printed = fflush(stdout) == 0 && !ferror(stdout);
    }
    if (!printed) {
        lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print: %s", strerror(errno));
        return report_failure(&err);
    }
    if (c.report) {
        const char *slash = strrchr(c.lamp.path, '/');
        if (study_report(&s, slash ? slash + 1 : c.lamp.path, c.report, &err) != LMG_OK)
            return report_failure(&err);
    }
    return *c.options.stop ? EXIT_INTERRUPTED : EXIT_DONE;
}
