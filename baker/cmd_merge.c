/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake merge: parts of one bake into its box. */
#include "program.h"

#include "part.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

enum { KEY_KEEP = 256, KEY_LOSSLESS, KEY_JSON };

static const struct argp_option OPTIONS[] = {
    {"output", 'o', "BOX", 0, "the file to write, NAME.box.exr", 1},
    {"keep", KEY_KEEP, 0, 0, "write BOX.part too, to merge or go on later", 1},
    {"lossless", KEY_LOSSLESS, 0, 0, LOSSLESS_HELP, 1},
    {"quiet", 'q', 0, 0, "no summary", 2},
    {"json", KEY_JSON, 0, 0, "summary as JSON", 2},
    {0},
};

static const char DOC[] =
    "Adds up the parts of one bake (BOX.part, what bake --keep, --share or --first leaves, or a checkpoint) and writes its box: bit for "
    "bit the one that a single run with the same photons gives, in any order, but for radiance trees, which grow of rays that parts don't "
    "keep.  Parts of different bakes are refused."
    "\vExample:\n  lumibake merge a.box.exr.part b.box.exr.part -o lamp.box.exr";

typedef struct command {
    char **parts;
    size_t count;
    const char *output;
    bool keep, lossless, quiet, json;
} command;

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case 'o':
        c->output = arg;
        break;
    case KEY_KEEP:
        c->keep = true;
        break;
    case KEY_LOSSLESS:
        c->lossless = true;
        break;
    case 'q':
        c->quiet = true;
        break;
    case KEY_JSON:
        c->json = true;
        break;
    case ARGP_KEY_ARGS:
        c->parts = state->argv + state->next;
        c->count = (size_t)(state->argc - state->next);
        break;
    case ARGP_KEY_END:
        if (c->count == 0)
            usage_error(state, "which parts? give files such as lamp.box.exr.part");
        if (!c->output)
            usage_error(state, "where to? give -o NAME.box.exr");
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static lmg_result add_up(const command *c, bake_part **sum, lmg_error *err)
{
    lmg_result result = bake_part_read(c->parts[0], sum, err);
    for (size_t i = 1; result == LMG_OK && i < c->count; ++i) {
        bake_part *next;
        result = bake_part_read(c->parts[i], &next, err);
        /* an overlap may be with any of the parts before: which of them isn't known any more */
        char name[120];
        snprintf(name, sizeof(name), i == 1 ? "%.100s" : "the parts up to %.80s", c->parts[i - 1]);
        if (result == LMG_OK)
            result = bake_part_merge(*sum, name, next, c->parts[i], err);
        bake_part_destroy(next);
    }
    return result;
}

static const char NO_TREES_WHY[] = "parts keep no rays for them to grow of";

/* Whether the parts' bake was asked for radiance trees: who asks for looks does. */
static bool asked_for_trees(const bake_part *sum)
{
    json_t *settings = sum->texts[PART_SETTINGS] ? json_loads(sum->texts[PART_SETTINGS], 0, NULL) : NULL;
    const bool asked = json_integer_value(json_object_get(settings, "trees")) > 0 || json_integer_value(json_object_get(settings, "looks")) > 0;
    json_decref(settings);
    return asked;
}

static json_t *summary_json(const command *c, const bake_part *sum, const lmg_ledger *l)
{
    json_t *ranges = json_array();
    for (size_t i = 0; i < sum->range_count; ++i)
        json_array_append_new(ranges, json_pack("[II]", (json_int_t)sum->ranges[i].first, (json_int_t)sum->ranges[i].count));
    return json_pack("{s:s, s:s, s:I, s:I, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:n, s:s}", "format", "lumibake merge 1", "box", c->output, "parts",
                     (json_int_t)c->count, "photons", (json_int_t)l->photons, "ranges", ranges, "emitted_lm", json_number(l->emitted),
                     "stored_lm", json_number(l->stored), "residual_lm", json_number(l->residual), "absorbed_lm",
                     json_number(l->absorbed), "lost_lm", json_number(l->lost), "noise", json_number(bake_part_noise(sum)), "trees", "no_trees_why",
                     NO_TREES_WHY);
}

static void print_summary(const command *c, const bake_part *sum, const lmg_ledger *l)
{
    printf("%s\n  parts     %zu, %" PRIu64 " photons", c->output, c->count, l->photons);
    for (size_t i = 0; i < sum->range_count && i < 8; ++i)
        printf("%s %" PRIu64 "-%" PRIu64, i ? "," : ":", sum->ranges[i].first, sum->ranges[i].first + sum->ranges[i].count - 1);
    printf("%s; noise of illuminance one size away %.2g %%\n", sum->range_count > 8 ? ", ..." : "", 100 * bake_part_noise(sum));
    print_ledger(l);
    printf("  trees     none (%s)\n", NO_TREES_WHY);
}

int cmd_merge(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "PART... -o BOX", .doc = DOC};
    command c = {0};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    bake_part *sum = NULL;
    lmg_field *field = NULL;
    char part[1100];
    lmg_result result = check_output(c.output, (const char *const *)c.parts, c.count, &err);
    if (result == LMG_OK && snprintf(part, sizeof(part), "%s.part", c.output) >= (int)sizeof(part))
        result = lmg_fail(&err, LMG_ERROR_FILE_OPEN, "the name of the output is too long");
    if (result == LMG_OK && c.keep)
        result = check_output(part, (const char *const *)c.parts, c.count, &err);
    if (result != LMG_OK)
        return report_failure(&err);
    result = add_up(&c, &sum, &err);
    if (result == LMG_OK)
        result = bake_part_field(sum, NULL, &field, &err);
    int code = result == LMG_OK ? EXIT_DONE : report_error(result, &err);
    lmg_rounding lost;
    if (result == LMG_OK && (write_box(field, c.output, c.lossless, &lost, &err) != LMG_OK || (c.keep && bake_part_write(sum, part, &err) != LMG_OK)))
        code = report_failure(&err);
    if (code == EXIT_DONE && !c.quiet && asked_for_trees(sum))
        fprintf(stderr, "warning: no radiance trees, which --trees or --looks asked for: %s\n", NO_TREES_WHY);
    if (code == EXIT_DONE) {
        const lmg_ledger l = lmg_field_ledger(field);
        bool printed = true;
        if (c.json)
            printed = print_json(summary_json(&c, sum, &l));
        else if (!c.quiet)
            print_summary(&c, sum, &l);
        if (!printed || fflush(stdout) != 0) {
            lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print the summary");
            code = report_failure(&err);
        }
    }
    lmg_field_destroy(field);
    bake_part_destroy(sum);
    return code;
}
