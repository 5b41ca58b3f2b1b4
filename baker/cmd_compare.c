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
    KEY_NO_ALIGN,
    KEY_TOLERANCE,
    KEY_JSON
};

static const struct argp_option OPTIONS[] = {
    {"photons", KEY_PHOTONS, "N", 0, "rays from each (default 2e7; of a ray file as many as it has)", 1},
    {"distances", KEY_DISTANCES, "LIST", 0, "of the planes, in sizes of the lamp (default 0.1,0.5,1,2,5,10)", 1},
    {"size", KEY_SIZE, "M", 0, "the lamp's size in metres (default: the luminous opening's diagonal)", 1},
    {"flux", KEY_FLUX, "LM", 0, "what the sources of glTF lamps emit, as in bake", 2},
    {"recipe-a", KEY_RECIPE_A, "FILE", 0, "lamp recipe of A", 2},
    {"recipe-b", KEY_RECIPE_B, "FILE", 0, "lamp recipe of B (defaults as in bake)", 2},
    {"set-a", KEY_SET_A, "ENTRY", 0, "recipe entry for A (repeatable)", 2},
    {"set-b", KEY_SET_B, "ENTRY", 0, "recipe entry for B (repeatable)", 2},
    {"no-recipe", KEY_NO_RECIPE, 0, 0, "don't look for recipes beside the lamps", 2},
    {"seed", KEY_SEED, "N", 0, "seed of the random numbers (default 1)", 3},
    {"threads", KEY_THREADS, "N", 0, "default: all cores", 3},
    {"no-align", KEY_NO_ALIGN, 0, 0, "leave A where it is; by default it is turned and moved onto B if that makes them more alike", 1},
    {"tolerance", KEY_TOLERANCE, "PERCENT", 0,
     "end with 4 when the flux, the illuminance on a plane or the far field differ by more (RMS, noise taken out)", 4},
    {"output", 'o', "REPORT.html", 0, "write a report: one HTML file with tables, maps and plots (needs gnuplot)", 4},
    {"json", KEY_JSON, 0, 0, "result as JSON", 4},
    {0},
};

static const double DEGREES = 180 / 3.14159265358979323846;

static const char DOC[] = "Lights the same receivers with A and B, each a lamp (.gltf, .glb), a box or a ray file, and says how much they "
                          "differ: flux, illuminance on "
                          "planes of 32 x 32 pixels across the lamp's main axis, far-field intensity, luminance pictures, colour, virtual focus, "
                          "the distance from which the far field holds. A is judged against B."
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
    const char *report; /* NULL = none */
    double tolerance;   /* relative; 0 = none */
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
        add_recipe_entry(state, &c->sides[key == KEY_SET_B].lamp, arg);
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
    case KEY_NO_ALIGN:
        c->options.align = false;
        break;
    case KEY_TOLERANCE:
        c->tolerance = argument_share(state, "--tolerance", arg);
        break;
    case 'o':
        c->report = arg;
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

static json_t *measures_json(const bake_comparison *r)
{
    json_t *list = json_array();
    for (size_t i = 0; i < r->measure_count; ++i) {
        const bake_measure *m = &r->measures[i];
        json_array_append_new(list, json_pack("{s:s, s:s, s:[o,o], s:[o,o], s:o, s:o, s:b, s:b}", "name", m->name, "unit", m->unit, "a",
                                              json_number(m->a), json_number(m->a_se), "b", json_number(m->b), json_number(m->b_se),
                                              "difference", json_number(m->difference), "standard_error",
                                              json_number(m->difference_se), "relative", m->relative, "differs",
                                              bake_measure_differs(m)));
    }
    return list;
}

static json_t *alignment_json(const bake_comparison *r)
{
    const bake_alignment *a = &r->alignment;
    json_t *rows = json_array();
    for (int i = 0; i < 3; ++i)
        json_array_append_new(rows, json_pack("[f,f,f]", a->motion.rotation[i][0], a->motion.rotation[i][1], a->motion.rotation[i][2]));
    return json_pack("{s:b, s:o, s:[f,f,f], s:f, s:o, s:[o,o,o], s:i}", "applied", r->moved, "rotation", rows, "shift_m",
                     a->motion.shift.x, a->motion.shift.y, a->motion.shift.z, "angle_deg", a->angle * DEGREES, "angle_standard_error",
                     json_number(a->angle_se * DEGREES), "shift_standard_error", json_number(a->shift_se.x),
                     json_number(a->shift_se.y), json_number(a->shift_se.z), "turns_determined", (int)a->turns);
}

/* The distance from which the far field holds to 1 and 5 %, sizes, by ring of polar angle; null: dark, or beyond what was measured. */
static json_t *far_field_distances_json(const bake_comparison *r)
{
    json_t *rings = json_array();
    for (uint32_t i = 0; i < r->rings; ++i)
        json_array_append_new(rings, json_pack("{s:f, s:[o,o], s:[o,o]}", "angle_deg", 180 * (i + 0.5) / r->rings, "1%",
                                               json_number(r->valid_from[0][0][i]), json_number(r->valid_from[1][0][i]), "5%",
                                               json_number(r->valid_from[0][1][i]), json_number(r->valid_from[1][1][i])));
    return rings;
}

static json_t *views_json(const bake_comparison *r)
{
    json_t *views = json_array();
    for (int i = 0; i < BAKE_VIEWS; ++i)
        json_array_append_new(views, json_pack("{s:f, s:f, s:o}", "tilt_deg", r->views[i].tilt, "turn_deg", r->views[i].turn, "difference",
                                               difference_json(&r->views[i].difference)));
    return views;
}

/* The largest of what --tolerance judges: flux, planes, far field; relative. */
static double worst_difference(const bake_comparison *r)
{
    double worst = fmax(fabs(r->flux[0] / r->flux[1] - 1), r->far_field.rms);
    for (size_t i = 0; i < r->plane_count; ++i)
        worst = fmax(worst, r->planes[i].difference.rms);
    return worst;
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
            planes, json_pack("{s:f, s:f, s:f, s:[o,o], s:[o,o], s:o, s:o}", "distance_sizes", c->options.distances[i], "distance_m",
                              r->planes[i].distance, "side_m", r->planes[i].side, "mean_lx", json_number(r->planes[i].mean[0]),
                              json_number(r->planes[i].mean[1]), "mean_standard_error", json_number(r->planes[i].mean_se[0]),
                              json_number(r->planes[i].mean_se[1]), "difference", difference_json(&r->planes[i].difference),
                              "unaligned", difference_json(&r->planes[i].unmoved)));
    json_t *result = json_pack("{s:s, s:o, s:[f,f,f], s:f, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:f}", "format", "lumibake compare 2", "sides", sides,
                               "axis", r->axis.x, r->axis.y, r->axis.z, "size_m", r->size, "alignment", alignment_json(r), "planes",
                               planes, "far_field", difference_json(&r->far_field), "far_field_unaligned",
                               difference_json(&r->far_field_unmoved), "measures", measures_json(r), "views", views_json(r),
                               "far_field_from_sizes", far_field_distances_json(r), "worst_difference", worst_difference(r));
    if (c->tolerance > 0)
        json_object_set_new(result, "within_tolerance", json_boolean(worst_difference(r) <= c->tolerance));
    return result;
}

static void print_difference(const bake_difference *d)
{
    printf("%7.2f +- %-5.2f %8.2f %8.2f %8.2f\n", 100 * d->rms, 100 * d->standard_error, 100 * d->raw, 100 * d->noise,
           100 * d->p99);
}

/* "1.23 +- 0.04", or a dash. */
static const char *figure(char text[48], double value, double se)
{
    if (!isfinite(value))
        snprintf(text, 48, "-");
    else
        snprintf(text, 48, "%.5g +- %.2g", value, se);
    return text;
}

static void print_alignment(const bake_comparison *r)
{
    const bake_alignment *a = &r->alignment;
    if (bake_motion_is_identity(&a->motion)) {
        printf("alignment: A lies on B\n");
        return;
    }
    const lmg_vec3 t = a->motion.shift, se = a->shift_se;
    printf("alignment: A turned by %.3g +- %.2g degrees, shifted by %.4g %.4g %.4g mm (+- %.2g %.2g %.2g)%s\n", a->angle * DEGREES,
           a->angle_se * DEGREES, 1e3 * t.x, 1e3 * t.y, 1e3 * t.z, 1e3 * se.x, 1e3 * se.y, 1e3 * se.z,
           r->moved ? "" : "; not applied");
}

static void print_measures(const bake_comparison *r)
{
    printf("\n%-28s %22s %22s %22s\n", "", "A", "B", "difference");
    for (size_t i = 0; i < r->measure_count; ++i) {
        const bake_measure *m = &r->measures[i];
        if (!isfinite(m->difference) || (m->a == 0 && m->b == 0)) /* no such light */
            continue;
        char name[96], a[48], b[48], d[48];
        snprintf(name, sizeof(name), "%s%s%s", m->name, m->unit[0] ? ", " : "", m->unit);
        const double scale = m->relative ? 100 : 1;
        printf("%-28s %22s %22s %22s%s%s\n", name, figure(a, m->a, m->a_se), figure(b, m->b, m->b_se),
               figure(d, scale * m->difference, scale * m->difference_se), m->relative ? " %" : "", bake_measure_differs(m) ? "  differs" : "");
    }
}

static void print_comparison(const command *c, const bake_comparison *r)
{
    for (int s = 0; s < 2; ++s)
        printf("%c  %s: %.6g +- %.2g lm leave it (%.3g M rays in %.1f s)\n", 'A' + s, c->sides[s].lamp.path, r->flux[s],
               r->flux_se[s], 1e-6 * (double)r->tally[s].photons, r->seconds[s]);
    const double se = hypot(r->flux_se[0], r->flux_se[1]);
    printf("flux A - B: %+.4f +- %.4f %%\n", 100 * (r->flux[0] - r->flux[1]) / r->flux[1], 100 * se / r->flux[1]);
    print_alignment(r);
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
    print_measures(r);
    if (c->tolerance > 0)
        printf("\nlargest difference %.3g %%: %s %.3g %%\n", 100 * worst_difference(r),
               worst_difference(r) <= c->tolerance ? "within" : "more than", 100 * c->tolerance);
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
    command c = {.seed = 1, .options = {.distance_count = 6, .distances = {0.1, 0.5, 1, 2, 5, 10}, .align = true}};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    bake_comparison r = {0};
    lmg_result result = compare(&c, &r, &err);
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
    if (result == LMG_OK && c.report) {
        const char *const names[2] = {c.sides[0].lamp.path, c.sides[1].lamp.path};
        result = bake_comparison_report(&r, names, c.report, &err);
        if (result != LMG_OK)
            code = report_failure(&err);
    }
    if (code == EXIT_DONE && c.tolerance > 0 && !(worst_difference(&r) <= c.tolerance))
        code = EXIT_DIFFERENT;
    bake_comparison_release(&r);
    close_source(&c.sides[0].opened);
    close_source(&c.sides[1].opened);
    return code;
}
