/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake plan: the effects of light in a luminaire, measured, and which of them a bake simulates. */
#include "program.h"

#include "bake.h"
#include "plan.h"

#include <luminaires/model.h>

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { KEY_ERROR = 256, KEY_PHOTONS, KEY_SEED, KEY_THREADS, KEY_JSON };

static const struct argp_option OPTIONS[] = {
    {"error", KEY_ERROR, "E", 0, "what leaving effects out may change, such as 1% (default 0.1%)", 1},
    {"photons", KEY_PHOTONS, "N", 0, "photons of each run (default: those of a bake's plan)", 1},
    LAMP_OPTIONS(2),
    {"seed", KEY_SEED, "N", 0, "seed of the random numbers (default 1)", 3},
    {"threads", KEY_THREADS, "N", 0, "default: all cores; changes the costs only", 3},
    {"json", KEY_JSON, 0, 0, "everything as JSON", 3},
    {0},
};

static const char DOC[] =
    "Measures each effect of light that a luminaire shows - how much of the light meets it, and what would change without it - and says "
    "which of them a bake simulates, and why.\vExample:\n  lumibake plan lamp.gltf --error 1%";

typedef struct command {
    lamp_options lamp;
    bake_plan_options plan;
    uint64_t seed;
    bool json;
} command;

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case KEY_ERROR:
        c->plan.error = argument_share(state, "--error", arg);
        break;
    case KEY_PHOTONS:
        c->plan.photons = argument_count(state, "--photons", arg, 1024, 1000000000);
        break;
    case KEY_SEED:
        c->seed = argument_count(state, "--seed", arg, 0, UINT64_MAX);
        break;
    case KEY_THREADS:
        c->plan.threads = (unsigned)argument_count(state, "--threads", arg, 1, 1024);
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

static const char *reachable(const bake_plan_entry *e)
{
    return e->met > 0 ? "yes" : "not seen";
}

static void print_change(const bake_change *c)
{
    char text[32];
    snprintf(text, sizeof(text), "%+.2g+-%.1g", 100 * c->value, 100 * c->error);
    printf(" %16s", text);
}

static void print_plan(const command *c, const lum_model *model, const bake_plan *plan, const char *kernel, double seconds)
{
    printf("%s: effects of light, error asked for %.4g %%, %" PRIu64 " photons a run, %.2f s\n\n", c->lamp.path, 100 * plan->error,
           plan->photons, seconds);
    printf("                                               without it, per cent:\n");
    printf("%-22s %-8s %-14s %16s %16s %16s %16s %13s  decision\n", "effect", "reached", "meets light", "flux", "far field", "near field",
           "colour", "ns/photon");
    for (size_t i = 0; i < plan->count; ++i) {
        const bake_plan_entry *e = &plan->entries[i];
        char met[40];
        if (e->met > 0)
            snprintf(met, sizeof(met), "%.3g+-%.1g %%", 100 * e->met, 100 * e->met_error);
        else
            snprintf(met, sizeof(met), "<%.2g %%", 300 / (double)plan->photons);
        printf("%-22s %-8s %-14s", bake_effect_name(e->effect), reachable(e), met);
        if (e->measured) {
            print_change(&e->flux);
            print_change(&e->far_field);
            print_change(&e->near_field);
            print_change(&e->colour);
            printf(" %5.0f -> %4.0f", 1e9 * plan->seconds_with, 1e9 * e->seconds_without);
        } else {
            printf(" %16s %16s %16s %16s %13s", "-", "-", "-", "-", "-");
        }
        printf("  %s: %s\n", e->simulated ? "simulated" : "left out", e->why);
    }
    printf("\nWhere\n");
    for (size_t i = 0; i < plan->count; ++i) {
        char where[400];
        bake_plan_where(model, plan->entries[i].effect, where, sizeof(where));
        printf("  %-22s %s\n", bake_effect_name(plan->entries[i].effect), where);
    }
    printf("\nLeft out in all: at most %.2g %%.  Kernel: %s.\n", 100 * plan->left_out, kernel);
}

static json_t *json_change(const bake_change *c)
{
    return json_pack("{s:o, s:o}", "value", json_number(c->value), "standard_error", json_number(c->error));
}

json_t *json_plan(const struct bake_plan *plan)
{
    char names[512];
    json_t *o = json_object(), *list = json_array();
    for (size_t i = 0; i < plan->count; ++i) {
        const bake_plan_entry *e = &plan->entries[i];
        json_t *item = json_pack("{s:s, s:b, s:s}", "effect", bake_effect_name(e->effect), "simulated", e->simulated, "why", e->why);
        if (plan->photons > 0) {
            json_object_set_new(item, "reachable", json_boolean(e->met > 0));
            json_object_set_new(item, "meets", json_change(&(bake_change){e->met, e->met_error, 0}));
        }
        if (e->measured) {
            json_object_set_new(item, "flux", json_change(&e->flux));
            json_object_set_new(item, "far_field", json_change(&e->far_field));
            json_object_set_new(item, "near_field", json_change(&e->near_field));
            json_object_set_new(item, "colour", json_change(&e->colour));
            json_object_set_new(item, "bound", json_number(e->bound));
        }
        json_array_append_new(list, item);
    }
    json_object_set_new(o, "photons", json_integer((json_int_t)plan->photons));
    json_object_set_new(o, "error", json_number(plan->error));
    json_object_set_new(o, "left_out_bound", json_number(plan->left_out));
    bake_effects_print(plan->simulated, names, sizeof(names));
    json_object_set_new(o, "simulated", json_string(names));
    json_object_set_new(o, "effects", list);
    return o;
}

static json_t *plan_json(const command *c, const lum_model *model, const bake_plan *plan, const char *kernel, double seconds)
{
    json_t *o = json_plan(plan), *list = json_object_get(o, "effects");
    for (size_t i = 0; i < plan->count; ++i) {
        char where[400];
        bake_plan_where(model, plan->entries[i].effect, where, sizeof(where));
        json_t *item = json_array_get(list, i);
        json_object_set_new(item, "where", json_string(where));
        if (plan->entries[i].measured)
            json_object_set_new(item, "seconds_per_photon_without", json_number(plan->entries[i].seconds_without));
    }
    json_object_set_new(o, "format", json_string("lumibake plan 1"));
    json_object_set_new(o, "lamp", json_string(c->lamp.path));
    json_object_set_new(o, "kernel", json_string(kernel));
    json_object_set_new(o, "seconds_per_photon", json_number(plan->seconds_with));
    json_object_set_new(o, "seconds", json_number(seconds));
    return o;
}

static lmg_result make_plan(const command *c, const lum_model *model, bake_plan *plan, char kernel[32], lmg_error *err)
{
    bake_source *all = NULL, *planned = NULL;
    lmg_result result = bake_tracer_create(model, c->seed, &all, err);
    if (result == LMG_OK)
        result = bake_plan_make(model, all, c->seed, &c->plan, plan, err);
    if (result == LMG_OK && plan->escaped == 0) {
        char places[256];
        bake_plan_where_absorbed(model, all, c->plan.threads, places, sizeof(places));
        result = lmg_fail(err, LMG_ERROR_INPUT, "%.400s: no light leaves the luminaire (%s)", model->path, places);
    }
    if (result == LMG_OK)
        result = bake_tracer_create_with(model, plan->simulated, c->seed, all, &planned, err);
    if (result == LMG_OK)
        snprintf(kernel, 32, "%s", bake_tracer_kernel(planned));
    if (planned)
        planned->destroy(planned);
    if (all)
        all->destroy(all);
    return result;
}

int cmd_plan(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "LAMP", .doc = DOC};
    command c = {.seed = 1};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    lum_model *model = NULL;
    char *recipe_text = NULL, recipe[1024], kernel[32];
    lmg_result result = lamp_load(&c.lamp, &model, &recipe_text, recipe, &err);
    free(recipe_text);
    if (result != LMG_OK)
        return report_error(result, &err);
    bake_plan plan;
    const double began = bake_clock();
    result = make_plan(&c, model, &plan, kernel, &err);
    const double seconds = bake_clock() - began;
    bool printed = true;
    if (result == LMG_OK && c.json) {
        printed = print_json(plan_json(&c, model, &plan, kernel, seconds));
    } else if (result == LMG_OK) {
        print_plan(&c, model, &plan, kernel, seconds);
        printed = fflush(stdout) == 0 && !ferror(stdout);
    }
    lum_model_destroy(model);
    if (result != LMG_OK)
        return report_error(result, &err);
    if (!printed) {
        lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print the plan: %s", strerror(errno));
        return report_failure(&err);
    }
    return EXIT_DONE;
}
