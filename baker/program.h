/* SPDX-License-Identifier: Apache-2.0 */
/* What the commands of the program lumibake share: reading of arguments, messages, exit codes, Ctrl-C.  No physics here. */
#ifndef BAKER_PROGRAM_H
#define BAKER_PROGRAM_H

#include <lumigraph/lumigraph.h>

#include <argp.h>
#include <jansson.h>
#include <signal.h>

struct lum_model;
struct lum_recipe;

enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_INPUT = 3, EXIT_DIFFERENT = 4, EXIT_INTERRUPTED = 130 };

/* The commands: argv[0] is "lumibake NAME"; the exit code. */
int cmd_bake(int argc, char **argv);
int cmd_info(int argc, char **argv);
int cmd_plan(int argc, char **argv);
int cmd_probe(int argc, char **argv);
int cmd_compare(int argc, char **argv);
int cmd_study(int argc, char **argv);
int cmd_convert(int argc, char **argv);
int cmd_merge(int argc, char **argv);

/* Prints "error: message" as one line to stderr and returns the exit code that the result stands for when it came from reading or
 * judging the user's input. */
int report_error(lmg_result result, const lmg_error *err);
/* The same for what comes from writing results. */
int report_failure(const lmg_error *err);

/* Whether the "lumens" of a box are lumens, not watts (rays of a radiometric file are watts). */
bool box_is_photometric(const lmg_field *field);

/* Prints "error: ..." and where help is, and exits with EXIT_USAGE. */
_Noreturn void usage_error(const struct argp_state *state, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Values of options; they end in usage_error when the text isn't one. */
double argument_number(const struct argp_state *state, const char *option, const char *text, double least, double most);
uint64_t argument_count(const struct argp_state *state, const char *option, const char *text, uint64_t least,
                        uint64_t most);                                                        /* "1e8" */
double argument_seconds(const struct argp_state *state, const char *option, const char *text); /* "90s" "2m" "1h" */
double argument_bytes(const struct argp_state *state, const char *option, const char *text);   /* "8MB", "500kB" or "8e6", in bytes */
double argument_lumens(const struct argp_state *state, const char *option, const char *text);  /* "800lm" */
lmg_layout_choice argument_layout(const struct argp_state *state, const char *text);           /* --layout "cube" */
void argument_resolution(const struct argp_state *state, const char *text, uint32_t resolution[4]); /* --resolution "32,32,0,0" */

/* Writes a box, its cells rounded unless it is to be lossless (--lossless).  lost: what rounding changed. */
#define LOSSLESS_HELP "keep every bit: two to six times the size"
lmg_result write_box(const lmg_field *field, const char *path, bool lossless, lmg_rounding *lost, lmg_error *err);

/* Whether output can be written, asked before anything costly is done: its folder takes files, it is no folder itself and none of the
 * inputs. */
lmg_result check_output(const char *output, const char *const *inputs, size_t count, lmg_error *err);

/* Prints where the light went: a line each for emitted, stored, residual, absorbed, lost. */
void print_ledger(const lmg_ledger *ledger);

double argument_share(const struct argp_state *state, const char *option, const char *text);   /* "1%", "0.01": 0 < x < 1 */

/* A lamp with its recipe, as the options --recipe, --no-recipe and --set describe it. */
typedef struct lamp_options {
    const char *path;
    const char *recipe_path; /* NULL: LAMP.recipe.json beside the model, if there is one */
    bool no_recipe;
    size_t set_count;
    const char *sets[64];
} lamp_options;

/* Adds what --set says; more entries than there is room for are a usage error. */
void add_recipe_entry(const struct argp_state *state, lamp_options *lamp, const char *entry);

/* The options of every command that takes one lamp: --recipe, --no-recipe, --set, in an option group of its table. */
enum { KEY_LAMP_RECIPE = 4096, KEY_LAMP_NO_RECIPE, KEY_LAMP_SET };
#define LAMP_OPTIONS(group)                                                                                                          \
    {"recipe", KEY_LAMP_RECIPE, "FILE", 0, "lamp recipe (default LAMP.recipe.json if there)", group},                                \
        {"no-recipe", KEY_LAMP_NO_RECIPE, 0, 0, "don't look for a recipe beside the lamp", group},                                   \
        {"set", KEY_LAMP_SET, "ENTRY", 0, "recipe entry, such as emitter:Bulb=800lm (repeatable)", group}
/* Takes one of them; false: the key is none of these. */
bool parse_lamp_option(const struct argp_state *state, int key, const char *arg, lamp_options *lamp);

/* The recipe that belongs to a lamp: found (true) and its path. */
bool lamp_recipe_path(const lamp_options *lamp, char path[1024]);

/* Loads the model with recipe and shorthands.  *text: the recipe as compact JSON, or NULL; to be freed.  used: the recipe file's
 * path or "". */
lmg_result lamp_load(const lamp_options *lamp, struct lum_model **out, char **text, char used[1024], lmg_error *err);

/* Ctrl-C and SIGTERM: the first sets the flag that this returns, the second ends the program at once with EXIT_INTERRUPTED. */
const volatile sig_atomic_t *catch_interrupts(void);

/* Prints a JSON object with a newline and releases it; false if stdout doesn't take it. */
bool print_json(json_t *object);

/* The effect plan as an object, without what depends on the machine. */
struct bake_plan;
json_t *json_plan(const struct bake_plan *plan);

/* A JSON number; null when it isn't finite. */
json_t *json_number(double value);

/* What a box has of radiance trees; null for none. */
json_t *json_trees(const lmg_field *field);

#endif
