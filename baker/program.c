/* SPDX-License-Identifier: Apache-2.0 */
/* Shared by the commands of lumibake: arguments, messages, exit codes, loading a lamp with its recipe. */
#include "program.h"

#include "bake.h"

#include <luminaires/model.h>

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* One line, whatever the message holds. */
static void print_error(const lmg_error *err)
{
    fputs("error: ", stderr);
    for (const char *c = err->message; *c; ++c)
        fputc(*c == '\n' || *c == '\r' ? ' ' : *c, stderr);
    fputc('\n', stderr);
}

int report_failure(const lmg_error *err)
{
    print_error(err);
    return EXIT_FAILED;
}

int report_error(lmg_result result, const lmg_error *err)
{
    print_error(err);
    switch (result) {
    case LMG_OK:
        return EXIT_DONE;
    case LMG_ERROR_FILE_OPEN:
    case LMG_ERROR_FILE_READ:
    case LMG_ERROR_FILE_FORMAT:
    case LMG_ERROR_FILE_VERSION:
    case LMG_ERROR_INPUT:
    case LMG_ERROR_UNSUPPORTED:
    case LMG_ERROR_ARGUMENT: /* values come from the user's files; options have been checked before */
        return EXIT_INPUT;
    default:
        return EXIT_FAILED;
    }
}

void usage_error(const struct argp_state *state, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    fputs("error: ", stderr);
    vfprintf(stderr, format, args);
    fprintf(stderr, " (see %s --help)\n", state->name);
    va_end(args);
    exit(EXIT_USAGE);
}

bool box_is_photometric(const lmg_field *field)
{
    const char *quantity = lmg_field_get_text(field, "quantity");
    return !quantity || strcmp(quantity, "radiant") != 0;
}

double argument_number(const struct argp_state *state, const char *option, const char *text, double least, double most)
{
    char *end;
    errno = 0;
    const double value = strtod(text, &end);
    if (end == text || *end || errno || !isfinite(value))
        usage_error(state, "%s: '%s' is not a number", option, text);
    if (value < least || value > most)
        usage_error(state, "%s: %s is outside %g to %g", option, text, least, most);
    return value;
}

uint64_t argument_count(const struct argp_state *state, const char *option, const char *text, uint64_t least, uint64_t most)
{
    char *end;
    errno = 0;
    if (text[0] >= '0' && text[0] <= '9') {
        const unsigned long long whole = strtoull(text, &end, 10);
        if (!*end && !errno && whole >= least && whole <= most)
            return whole;
    }
    /* "1e8", "2.5e6", "2.5M" */
    errno = 0;
    double value = strtod(text, &end);
    const double unit = !strcmp(end, "k") ? 1e3 : !strcmp(end, "M") ? 1e6 : !strcmp(end, "G") ? 1e9 : 1;
    if (end == text || (*end && unit == 1) || errno || !isfinite(value) || value * unit != floor(value * unit))
        usage_error(state, "%s: '%s' is not a whole number such as 4000000, 4e6 or 4M", option, text);
    value *= unit;
    if (value < (double)least || value > 0x1p63 || (uint64_t)value > most)
        usage_error(state, "%s: %s is outside %.6g to %.6g", option, text, (double)least, (double)most);
    return (uint64_t)value;
}

double argument_seconds(const struct argp_state *state, const char *option, const char *text)
{
    char *end;
    const double value = strtod(text, &end);
    const double unit = !strcmp(end, "") || !strcmp(end, "s")      ? 1
                        : !strcmp(end, "m") || !strcmp(end, "min") ? 60
                        : !strcmp(end, "h")                        ? 3600
                                                                   : 0;
    if (end == text || unit == 0 || !(value * unit > 0) || !(value * unit <= 1e8))
        usage_error(state, "%s: '%s' is not a time such as 90s, 5m or 2h", option, text);
    return value * unit;
}

double argument_share(const struct argp_state *state, const char *option, const char *text)
{
    char *end;
    double value = strtod(text, &end);
    if (end != text && !strcmp(end, "%")) {
        value /= 100;
        ++end;
    }
    if (end == text || *end || !(value > 0) || !(value < 1))
        usage_error(state, "%s: '%s' is not a share such as 1%% or 0.01", option, text);
    return value;
}

double argument_bytes(const struct argp_state *state, const char *option, const char *text)
{
    char *end;
    double value = strtod(text, &end);
    const double unit = !strcmp(end, "kB") ? 1e3 : !strcmp(end, "MB") ? 1e6 : !strcmp(end, "GB") ? 1e9 : !strcmp(end, "") || !strcmp(end, "B") ? 1 : 0;
    value *= unit;
    if (end == text || unit == 0 || !(value >= 1e5) || !(value <= 1e11))
        usage_error(state, "%s: '%s' is not a size such as 8MB, from 100kB to 100GB", option, text);
    return value;
}

double argument_lumens(const struct argp_state *state, const char *option, const char *text)
{
    char *end;
    const double value = strtod(text, &end);
    if (end == text || (strcmp(end, "") && strcmp(end, "lm")) || !(value > 0) || !(value <= 1e12))
        usage_error(state, "%s: '%s' is not a luminous flux such as 800lm", option, text);
    return value;
}

/* ------------------------------------------------------------------------------------------------------------- output */

lmg_layout_choice argument_layout(const struct argp_state *state, const char *text)
{
    static const char *const KINDS[] = {"auto", "cube", "aperture"};
    for (int i = 0; i < 3; ++i)
        if (!strcmp(text, KINDS[i]))
            return (lmg_layout_choice)i;
    usage_error(state, "--layout: '%s' is not auto, cube or aperture", text);
}

void argument_resolution(const struct argp_state *state, const char *text, uint32_t resolution[4])
{
    unsigned long v[4];
    char extra;
    if (sscanf(text, "%lu,%lu,%lu,%lu%c", &v[0], &v[1], &v[2], &v[3], &extra) != 4 || strchr(text, '-'))
        usage_error(state, "--resolution: '%s' is not four numbers such as 32,32,64,64", text);
    for (int i = 0; i < 4; ++i) {
        if (v[i] > 65535)
            usage_error(state, "--resolution: %lu is beyond 65535", v[i]);
        resolution[i] = (uint32_t)v[i];
    }
}

lmg_result write_box(const lmg_field *field, const char *path, bool lossless, lmg_rounding *lost, lmg_error *err)
{
    *lost = (lmg_rounding){0};
    return lossless ? lmg_field_write(field, path, err) : lmg_field_write_rounded(field, path, BAKE_ROUNDING, lost, err);
}

lmg_result check_output(const char *output, const char *const *inputs, size_t count, lmg_error *err)
{
    struct stat in, out;
    if (stat(output, &out) == 0) {
        if (S_ISDIR(out.st_mode))
            return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s: is a directory; give the name of a file", output);
        for (size_t i = 0; i < count; ++i)
            if (stat(inputs[i], &in) == 0 && in.st_dev == out.st_dev && in.st_ino == out.st_ino)
                return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s: the output would overwrite an input", output);
    }
    const char *slash = strrchr(output, '/');
    char folder[1024] = ".";
    if (slash && snprintf(folder, sizeof(folder), "%.*s", (int)(slash - output) + 1, output) >= (int)sizeof(folder))
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "the name of the output is too long");
    if (access(folder, W_OK) != 0)
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s: can't write in %.100s: %s", output, folder, strerror(errno));
    return LMG_OK;
}

static void print_share(const char *name, double lumens, double error, double emitted)
{
    printf("  %-9s %12.6g lm  +- %-9.2g %9.4f %%\n", name, lumens, error, 100 * lumens / emitted);
}

void print_ledger(const lmg_ledger *l)
{
    printf("  emitted   %12.6g lm\n", l->emitted);
    print_share("stored", l->stored, l->stored_se, l->emitted);
    print_share("residual", l->residual, l->residual_se, l->emitted);
    print_share("absorbed", l->absorbed, l->absorbed_se, l->emitted);
    print_share("lost", l->lost, l->lost_se, l->emitted);
}

/* ------------------------------------------------------------------------------------------------------------ recipes */

void add_recipe_entry(const struct argp_state *state, lamp_options *lamp, const char *entry)
{
    if (lamp->set_count == sizeof(lamp->sets) / sizeof(lamp->sets[0]))
        usage_error(state, "more than %zu recipe entries; write a recipe file", lamp->set_count);
    lamp->sets[lamp->set_count++] = entry;
}

bool parse_lamp_option(const struct argp_state *state, int key, const char *arg, lamp_options *lamp)
{
    switch (key) {
    case KEY_LAMP_RECIPE:
        lamp->recipe_path = arg;
        break;
    case KEY_LAMP_NO_RECIPE:
        lamp->no_recipe = true;
        break;
    case KEY_LAMP_SET:
        add_recipe_entry(state, lamp, arg);
        break;
    default:
        return false;
    }
    if (lamp->recipe_path && lamp->no_recipe)
        usage_error(state, "--recipe and --no-recipe exclude each other");
    return true;
}

bool lamp_recipe_path(const lamp_options *lamp, char path[1024])
{
    path[0] = 0;
    if (lamp->recipe_path)
        return snprintf(path, 1024, "%s", lamp->recipe_path) < 1024;
    if (lamp->no_recipe)
        return false;
    /* lamp.gltf -> lamp.recipe.json */
    const char *slash = strrchr(lamp->path, '/');
    const char *dot = strrchr(lamp->path, '.');
    const size_t stem = dot && (!slash || dot > slash) ? (size_t)(dot - lamp->path) : strlen(lamp->path);
    const int n = snprintf(path, 1024, "%.*s.recipe.json", (int)(stem < 900 ? stem : 900), lamp->path);
    if (n > 0 && n < 1024 && stem < 900 && access(path, R_OK) == 0)
        return true;
    path[0] = 0;
    return false;
}

/* The recipe's text for the file's provenance: compact JSON with sorted keys, the shorthands added as "set". */
static char *recipe_text(const char *path, const lamp_options *lamp)
{
    if (!path[0] && lamp->set_count == 0)
        return NULL;
    json_t *object = path[0] ? json_load_file(path, 0, NULL) : NULL;
    if (!object)
        object = json_object();
    json_t *sets = json_array();
    for (size_t i = 0; i < lamp->set_count; ++i)
        json_array_append_new(sets, json_string(lamp->sets[i]));
    if (lamp->set_count > 0)
        json_object_set(object, "set", sets);
    json_decref(sets);
    char *text = json_dumps(object, JSON_COMPACT | JSON_SORT_KEYS | JSON_REAL_PRECISION(15));
    json_decref(object);
    return text;
}

lmg_result lamp_load(const lamp_options *lamp, struct lum_model **out, char **text, char used[1024], lmg_error *err)
{
    *out = NULL;
    *text = NULL;
    lum_recipe *recipe = NULL;
    lmg_result result = lamp_recipe_path(lamp, used) ? lum_recipe_read(used, &recipe, err) : lum_recipe_create(&recipe, err);
    for (size_t i = 0; result == LMG_OK && i < lamp->set_count; ++i)
        result = lum_recipe_add(recipe, lamp->sets[i], err);
    if (result == LMG_OK)
        result = lum_model_load(lamp->path, recipe, out, err);
    lum_recipe_destroy(recipe);
    if (result == LMG_OK)
        *text = recipe_text(used, lamp);
    return result;
}

/* ------------------------------------------------------------------------------------------------------------- Ctrl-C */

static volatile sig_atomic_t interrupted;

static void on_signal(int number)
{
    (void)number;
    if (interrupted)
        _exit(EXIT_INTERRUPTED);
    interrupted = 1;
}

const volatile sig_atomic_t *catch_interrupts(void)
{
    struct sigaction action = {.sa_handler = on_signal, .sa_flags = SA_RESTART};
    sigemptyset(&action.sa_mask);
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    return &interrupted;
}

/* --------------------------------------------------------------------------------------------------------------- JSON */

bool print_json(json_t *object)
{
    const bool done = object && json_dumpf(object, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(9)) == 0 &&
                      fputc('\n', stdout) != EOF && fflush(stdout) == 0;
    json_decref(object);
    return done;
}

json_t *json_number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

json_t *json_trees(const lmg_field *field)
{
    const lmg_tree_totals t = lmg_field_trees(field);
    if (t.trees == 0)
        return json_null();
    return json_pack("{s:i, s:i, s:i, s:I, s:I, s:I, s:I, s:I}", "trees", (int)t.trees, "tiles", (int)t.tiles, "kinds_of_tiles", (int)t.kinds,
                     "leaves", (json_int_t)t.leaves, "rays", (json_int_t)t.rays, "looks", (json_int_t)t.looks, "memory",
                     (json_int_t)t.memory, "bytes", (json_int_t)t.bytes);
}
