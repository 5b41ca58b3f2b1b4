/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake compare: two lamps or boxes on the same receivers. */
#include "program.h"

#include "bake.h"
#include "compare.h"
#include "open_source.h"

#include <luminaires/rng.h>

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    KEY_PHOTONS = 256,
    KEY_DISTANCES,
    KEY_SIZE,
    KEY_FLUX,
    KEY_RECIPE_A,
    KEY_RECIPE_B,
    KEY_SET_A,
    KEY_SET_B,
    KEY_NO_RECIPE,
    KEY_SEED,
    KEY_THREADS,
    KEY_JSON
};

static const struct argp_option OPTIONS[] = {
    {"photons", KEY_PHOTONS, "N", 0, "rays from each (default 2e7; of a ray file as many as it has)", 1},
    {"distances", KEY_DISTANCES, "LIST", 0, "of the planes, in sizes of the lamp (default 0.5,1,2,5)", 1},
    {"size", KEY_SIZE, "M", 0, "the lamp's size in metres (default: the luminous opening's diagonal)", 1},
    {"flux", KEY_FLUX, "LM", 0, "what the sources of glTF lamps emit, as in bake", 2},
    {"recipe-a", KEY_RECIPE_A, "FILE", 0, "lamp recipe of A", 2},
    {"recipe-b", KEY_RECIPE_B, "FILE", 0, "lamp recipe of B (defaults as in bake)", 2},
    {"set-a", KEY_SET_A, "ENTRY", 0, "recipe entry for A (repeatable)", 2},
    {"set-b", KEY_SET_B, "ENTRY", 0, "recipe entry for B (repeatable)", 2},
    {"no-recipe", KEY_NO_RECIPE, 0, 0, "don't look for recipes beside the lamps", 2},
    {"seed", KEY_SEED, "N", 0, "seed of the random numbers (default 1)", 3},
    {"threads", KEY_THREADS, "N", 0, "default: all cores", 3},
    {"json", KEY_JSON, 0, 0, "result as JSON", 4},
    {0},
};

static const char DOC[] = "Lights the same receivers with A and B, each a lamp (.gltf, .glb), a box or a ray file, and says how much they "
                          "differ: flux, illuminance on "
                          "planes of 32 x 32 pixels across the lamp's main axis, far-field intensity. A is judged against B."
                          "\v'RMS' is the relative RMS difference with the noise of both sides taken out.\n"
                          "Example:\n  lumibake compare lamp.box.exr lamp.gltf --distances 0.5,1,2,5";

/* One of the two things to compare, as a source of rays. */
typedef struct side {
    lamp_options lamp;
    opened_source opened;
} side;

typedef struct command {
    side sides[2];
    size_t side_count;
    bool no_recipe, json;
    double flux_lm;
    uint64_t seed;
    bake_compare_options options;
} command;

static void parse_distances(struct argp_state *state, const char *text, bake_compare_options *o)
{
    o->distance_count = 0;
    for (const char *c = text;;) {
        char *end;
        const double d = strtod(c, &end);
        if (end == c || (*end != ',' && *end) || !(d >= 1e-3) || !(d <= 1e6))
            usage_error(state, "--distances: '%s' is not a list such as 0.5,1,2,5 (each at least 0.001 sizes)", text);
        if (o->distance_count == BAKE_MAX_DISTANCES)
            usage_error(state, "--distances: more than %d", BAKE_MAX_DISTANCES);
        o->distances[o->distance_count++] = d;
        if (!*end)
            return;
        c = end + 1;
    }
}

static void add_set(struct argp_state *state, lamp_options *lamp, const char *entry)
{
    if (lamp->set_count == sizeof(lamp->sets) / sizeof(lamp->sets[0]))
        usage_error(state, "more than %zu recipe entries; write a recipe file", lamp->set_count);
    lamp->sets[lamp->set_count++] = entry;
}

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case KEY_PHOTONS:
        c->options.photons = argument_count(state, "--photons", arg, 1000, UINT64_C(1) << 52);
        break;
    case KEY_DISTANCES:
        parse_distances(state, arg, &c->options);
        break;
    case KEY_SIZE:
        c->options.size = argument_number(state, "--size", arg, 1e-6, 1e6);
        break;
    case KEY_FLUX:
        c->flux_lm = argument_lumens(state, "--flux", arg);
        break;
    case KEY_RECIPE_A:
    case KEY_RECIPE_B:
        c->sides[key == KEY_RECIPE_B].lamp.recipe_path = arg;
        break;
    case KEY_SET_A:
    case KEY_SET_B:
        add_set(state, &c->sides[key == KEY_SET_B].lamp, arg);
        break;
    case KEY_NO_RECIPE:
        c->no_recipe = true;
        break;
    case KEY_SEED:
        c->seed = argument_count(state, "--seed", arg, 0, UINT64_MAX);
        break;
    case KEY_THREADS:
        c->options.threads = (unsigned)argument_count(state, "--threads", arg, 1, 1024);
        break;
    case KEY_JSON:
        c->json = true;
        break;
    case ARGP_KEY_ARG:
        if (c->side_count == 2)
            usage_error(state, "'%s': two things to compare, not more", arg);
        c->sides[c->side_count++].lamp.path = arg;
        break;
    case ARGP_KEY_END:
        if (c->side_count < 2)
            usage_error(state, "what with what? give two files: .gltf, .glb, .box.exr or rays");
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static json_t *difference_json(const bake_difference *d)
{
    return json_pack("{s:o, s:o, s:o, s:o, s:o}", "rms", json_number(d->rms), "standard_error", json_number(d->standard_error),
                     "raw", json_number(d->raw), "noise", json_number(d->noise), "p99", json_number(d->p99));
}

static json_t *comparison_json(const command *c, const bake_comparison *r)
{
    json_t *sides = json_array();
    for (int s = 0; s < 2; ++s)
        json_array_append_new(sides, json_pack("{s:s, s:o, s:o, s:I, s:I, s:f}", "path", c->sides[s].lamp.path, "flux_lm",
                                               json_number(r->flux[s]), "flux_standard_error", json_number(r->flux_se[s]),
                                               "photons", (json_int_t)r->tally[s].photons, "segments",
                                               (json_int_t)r->tally[s].segments, "seconds", r->seconds[s]));
    json_t *planes = json_array();
    for (size_t i = 0; i < c->options.distance_count; ++i)
        json_array_append_new(
            planes, json_pack("{s:f, s:f, s:f, s:[o,o], s:[o,o], s:o}", "distance_sizes", c->options.distances[i], "distance_m",
                              r->planes[i].distance, "side_m", r->planes[i].side, "mean_lx", json_number(r->planes[i].mean[0]),
                              json_number(r->planes[i].mean[1]), "mean_standard_error", json_number(r->planes[i].mean_se[0]),
                              json_number(r->planes[i].mean_se[1]), "difference", difference_json(&r->planes[i].difference)));
    return json_pack("{s:s, s:o, s:[f,f,f], s:f, s:o, s:o}", "format", "lumibake compare 1", "sides", sides, "axis", r->axis.x,
                     r->axis.y, r->axis.z, "size_m", r->size, "planes", planes, "far_field", difference_json(&r->far_field));
}

static void print_difference(const bake_difference *d)
{
    printf("%7.2f +- %-5.2f %8.2f %8.2f %8.2f\n", 100 * d->rms, 100 * d->standard_error, 100 * d->raw, 100 * d->noise,
           100 * d->p99);
}

static void print_comparison(const command *c, const bake_comparison *r)
{
    for (int s = 0; s < 2; ++s)
        printf("%c  %s: %.6g +- %.2g lm leave it (%.3g M rays in %.1f s)\n", 'A' + s, c->sides[s].lamp.path, r->flux[s],
               r->flux_se[s], 1e-6 * (double)r->tally[s].photons, r->seconds[s]);
    const double se = hypot(r->flux_se[0], r->flux_se[1]);
    printf("flux A - B: %+.4f +- %.4f %%\n", 100 * (r->flux[0] - r->flux[1]) / r->flux[1], 100 * se / r->flux[1]);
    printf("size %.4g m, planes across %+g %+g %+g\n\n", r->size, r->axis.x, r->axis.y, r->axis.z);
    printf("                                             difference, %% of B's RMS\n");
    printf("distance      plane      mean A      mean B        RMS +- s.e.      raw    noise  99th pc\n");
    for (size_t i = 0; i < c->options.distance_count; ++i) {
        char distance[32];
        snprintf(distance, sizeof(distance), "%g sizes", c->options.distances[i]);
        printf("%-10s %6.4g m %8.5g lx %8.5g lx ", distance, r->planes[i].side, r->planes[i].mean[0], r->planes[i].mean[1]);
        print_difference(&r->planes[i].difference);
    }
    printf("%-43s ", "far-field intensity");
    print_difference(&r->far_field);
}

static lmg_result compare(command *c, bake_comparison *r, lmg_error *err)
{
    lmg_result result = LMG_OK;
    for (int s = 0; result == LMG_OK && s < 2; ++s) { /* seeds of their own, apart from a bake's with the same number */
        const source_options options = {
            .flux_lm = c->flux_lm, .seed = lum_mix64(c->seed + (s ? 0x62 : 0x61)), .threads = c->options.threads};
        c->sides[s].lamp.no_recipe = c->no_recipe;
        result = open_source(&c->sides[s].lamp, &options, &c->sides[s].opened, err);
    }
    if (result != LMG_OK)
        return result;
    const opened_source *a = &c->sides[0].opened, *b = &c->sides[1].opened;
    if (a->photometric != b->photometric)
        return lmg_fail(err, LMG_ERROR_INPUT, "%s is in lumens, %s in watts: they can't be compared", a->photometric ? a->path : b->path,
                        a->photometric ? b->path : a->path);
    for (int s = 1; s >= 0 && !(c->options.size > 0); --s)
        if (c->sides[s].opened.field)
            c->options.size = lmg_field_layout(c->sides[s].opened.field)->size;
    if (!(c->options.size > 0))
        result = bake_source_size(b->source, c->options.threads, &c->options.size, err);
    if (result == LMG_OK)
        result = bake_compare(a->source, b->source, &c->options, r, err);
    return result;
}

int cmd_compare(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "A B", .doc = DOC};
    command c = {.seed = 1, .options = {.distance_count = 4, .distances = {0.5, 1, 2, 5}}};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    bake_comparison r;
    const lmg_result result = compare(&c, &r, &err);
    int code = result == LMG_OK ? EXIT_DONE : report_error(result, &err);
    if (result == LMG_OK) {
        bool printed;
        if (c.json) {
            printed = print_json(comparison_json(&c, &r));
        } else {
            print_comparison(&c, &r);
            printed = fflush(stdout) == 0 && !ferror(stdout);
        }
        if (!printed) {
            lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print: %s", strerror(errno));
            code = report_failure(&err);
        }
    }
    close_source(&c.sides[0].opened);
    close_source(&c.sides[1].opened);
    return code;
}
