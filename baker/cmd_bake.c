/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake bake: options, progress and summary around bake_run. */
#include "program.h"

#include "bake.h"
#include "effects.h"
#include "part.h"
#include "target.h"
#include "team.h"

#include <luminaires/model.h>

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum {
    KEY_TIME = 256,
    KEY_ERROR,
    KEY_ERROR_OF,
    KEY_PHOTONS,
    KEY_FLUX,
    KEY_OUTPUT_FLUX,
    KEY_SEED,
    KEY_THREADS,
    KEY_LAYOUT,
    KEY_SIZE,
    KEY_CELLS,
    KEY_RESOLUTION,
    KEY_LOSSLESS,
    KEY_PILOT,
    KEY_EFFECTS,
    KEY_EFFECTS_ERROR,
    KEY_GATHER,
    KEY_TREES,
    KEY_LOOKS,
    KEY_PHOTONS_ONLY,
    KEY_RESUME,
    KEY_CHECKPOINT,
    KEY_KEEP,
    KEY_SHARE,
    KEY_FIRST,
    KEY_PROGRESS,
    KEY_JSON
};

/* A file may be larger than asked for by so much; beyond that its cells are rounded more coarsely, by at most so much of their
 * noise. */
static const double SIZE_SLACK = 1.03, MOST_ROUNDING = 0.4;
/* Trees of more would be larger than a file may hold. */
static const uint64_t MOST_LOOKS = 32000000;

static const struct argp_option OPTIONS[] = {
    {"output", 'o', "BOX", 0, "the file to write, NAME.box.exr", 1},
    {"time", KEY_TIME, "TIME", 0, "trace for so long: 90s, 5m, 1h (default 60s)", 2},
    {"photons", KEY_PHOTONS, "N", 0, "trace so many photons, such as 1e8", 2},
    {"error", KEY_ERROR, "PERCENT", 0, "until the box is that near to the lamp's light", 2},
    {"error-of", KEY_ERROR_OF, "WHAT", 0, "near-field (illuminance at 0.5 to 10 sizes; default), far-field, luminance or flux", 2},
    {"flux", KEY_FLUX, "LM", 0, "what the lamp's sources emit, such as 800lm", 3},
    {"output-flux", KEY_OUTPUT_FLUX, "LM", 0, "what leaves the luminaire", 3},
    LAMP_OPTIONS(3),
    {"layout", KEY_LAYOUT, "KIND", 0, "auto, cube or aperture (default auto)", 4},
    {"size", KEY_SIZE, "SIZE", 0, "of the file at most, such as 8MB (16MB)", 4},
    {"cells", KEY_CELLS, "N", 0, "so many cells (default: what photons are worth)", 4},
    {"resolution", KEY_RESOLUTION, "U,V,S,T", 0, "cells in each dimension of the main slabs, 0 = chosen", 4},
    {"lossless", KEY_LOSSLESS, 0, 0, LOSSLESS_HELP, 4},
    {"pilot", KEY_PILOT, "N", 0, "photons of the pilot that fits the layout", 4},
    {"effects", KEY_EFFECTS, "LIST", 0, "auto, all, or effects to simulate", 4},
    {"effects-error", KEY_EFFECTS_ERROR, "E", 0, "what leaving them out may change (default 0.1%)", 4},
    {"gather", KEY_GATHER, "R|auto", 0, "R rays traced backwards per photon (default none)", 4},
    {"trees", KEY_TREES, "N", 0, "0, or 2 to 16 radiance trees (8 from 20 s on)", 4},
    {"looks", KEY_LOOKS, "N", 0, "backward rays for trees (2 per photon, up to 16M)", 4},
    {"photons-only", KEY_PHOTONS_ONLY, 0, 0, "no rays traced backwards at all", 4},
    {"seed", KEY_SEED, "N", 0, "seed of the random numbers (default 1)", 5},
    {"threads", KEY_THREADS, "N", 0, "default: all cores; doesn't change the result", 5},
    {"resume", KEY_RESUME, 0, 0, "go on from the checkpoint BOX.part", 6},
    {"checkpoint", KEY_CHECKPOINT, "TIME", 0, "write one so often (default and most: 60s)", 6},
    {"keep", KEY_KEEP, 0, 0, "keep BOX.part: for more photons, or merge", 6},
    {"share", KEY_SHARE, "K/N", 0, "the K-th of N shares of --photons; keeps BOX.part", 6},
    {"first", KEY_FIRST, "N", 0, "start at photon N; needs --pilot, keeps BOX.part", 6},
    {"quiet", 'q', 0, 0, "no progress, no warnings, no summary", 7},
    {"progress", KEY_PROGRESS, 0, 0, "progress lines even when stderr is no terminal", 7},
    {"json", KEY_JSON, 0, 0, "summary as JSON", 7},
    {0},
};

static const char DOC[] =
    "Traces the light of a luminaire (.gltf, .glb) photon by photon and writes what leaves it as a box of light."
    "\vCtrl-C ends a bake early with a valid box (exit code 130) and a checkpoint that --resume goes on from; a second one quits "
    "without.\n"
    "Example:\n  lumibake bake lamp.gltf -o lamp.box.exr --flux 800lm --time 2m";

typedef struct command {
    lamp_options lamp;
    const char *output;
    bake_options bake;
    bool resume;
    uint64_t share, shares; /* of --photons: the share-th of shares; 0 = all */
    bool given_first, photons_only;
    char part[1100]; /* the checkpoint's file */
    bool lossless, quiet, progress, json;
    lmg_rounding lost;  /* by rounding the box's cells */
    bake_target target; /* error 0: none */
    bake_reached reached;
    /* progress on a terminal */
    bool terminal;
    double last_line;
} command;

static void parse_share(struct argp_state *state, const char *text, command *c)
{
    /* 2^52 photons times 1024 fit 64 bits */
    unsigned long k, n;
    char extra;
    if (sscanf(text, "%lu/%lu%c", &k, &n, &extra) != 2 || strchr(text, '-') || k < 1 || k > n || n > 1024)
        usage_error(state, "--share: '%s' is not a share such as 2/7, of 1024 at most", text);
    c->share = k;
    c->shares = n;
}

static target_measure error_of(struct argp_state *state, const char *text)
{
    static const char *const NAMES[TARGET_MEASURES] = {"near-field", "far-field", "luminance", "flux"};
    for (int m = 0; m < TARGET_MEASURES; ++m)
        if (!strcmp(text, NAMES[m]))
            return (target_measure)m;
    usage_error(state, "--error-of: '%s' is not near-field, far-field, luminance or flux", text);
}

/* Which photons, once all options are known. */
static void settle_photons(struct argp_state *state, command *c)
{
    bake_options *o = &c->bake;
    if (c->given_first && c->shares)
        usage_error(state, "--first and --share exclude each other");
    if (c->given_first && !o->pilot_photons)
        usage_error(state,
                    "--first needs --pilot, the same for all parts of a bake, so that they have one layout; such as --pilot 1e5");
    if (c->shares) {
        if (!o->photons)
            usage_error(state, "--share needs --photons, those of the whole bake");
        o->whole = o->photons;
        o->first = o->whole * (c->share - 1) / c->shares;
        o->photons = o->whole * c->share / c->shares - o->first;
        if (o->photons == 0)
            usage_error(state, "--share: too many shares for %" PRIu64 " photons", o->whole);
    }
    o->keep |= c->shares || c->given_first;
    if ((c->shares || c->given_first) && o->rays_per_photon != 0)
        usage_error(
            state,
            "--gather: a bake in parts is merged without its lamp, of photons only; leave out --gather, or --share and --first");
    const bool parts = c->shares || c->given_first, asked = o->trees != BAKE_TREES_AUTO && o->trees > 0;
    if (c->photons_only && (o->looks > 0 || o->rays_per_photon != 0))
        usage_error(state, "--photons-only: no rays are traced backwards then; leave out --looks and --gather");
    const bool looks = o->looks_chosen && o->looks > 0;
    if (looks && o->trees == 0)
        usage_error(state, "--looks: they sharpen radiance trees; --trees 0 is for none");
    if (c->target.error > 0 && (asked || looks))
        usage_error(state, "--trees, --looks: --error judges cells; bake once more with the --photons that it finds");
    if (parts && (asked || looks))
        usage_error(state, "--trees, --looks: a bake in parts is merged without its rays, which trees grow of; leave these out, or --share and --first");
    if (o->trees == BAKE_TREES_AUTO && (parts || c->target.error > 0))
        o->trees = 0;
}

static void argument_effects(struct argp_state *state, const char *text, bake_options *o)
{
    lmg_error err = {{0}};
    o->effects_chosen = strcmp(text, "auto") != 0;
    o->effects = UINT32_MAX;
    if (o->effects_chosen && strcmp(text, "all") != 0 && bake_effects_parse(text, &o->effects, &err) != LMG_OK)
        usage_error(state, "--effects: %s", err.message);
}

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case 'o':
        c->output = arg;
        break;
    case KEY_TIME:
        c->bake.seconds = argument_seconds(state, "--time", arg);
        break;
    case KEY_PHOTONS:
        c->bake.photons = argument_count(state, "--photons", arg, 0, UINT64_C(1) << 52);
        if (c->bake.photons == 0)
            usage_error(state, "--photons: no photons, no light; give at least 1, or --time");
        break;
    case KEY_ERROR:
        c->target.error = argument_share(state, "--error", arg);
        if (c->target.error < 1e-4)
            usage_error(state, "--error: '%s' is less than 0.01 %%", arg);
        break;
    case KEY_ERROR_OF:
        c->target.of = error_of(state, arg);
        break;
    case KEY_FLUX:
        c->bake.flux_lm = argument_lumens(state, "--flux", arg);
        break;
    case KEY_OUTPUT_FLUX:
        c->bake.output_flux_lm = argument_lumens(state, "--output-flux", arg);
        break;
    case KEY_LAYOUT:
        c->bake.fit.choice = argument_layout(state, arg);
        break;
    case KEY_SIZE:
        c->bake.size = argument_bytes(state, "--size", arg);
        break;
    case KEY_CELLS:
        c->bake.fit.cells = argument_count(state, "--cells", arg, 1000, UINT64_C(1) << 32);
        break;
    case KEY_RESOLUTION:
        argument_resolution(state, arg, c->bake.fit.resolution);
        break;
    case KEY_LOSSLESS:
        c->lossless = true;
        break;
    case KEY_PILOT:
        c->bake.pilot_photons = argument_count(state, "--pilot", arg, 1, 100000000);
        break;
    case KEY_EFFECTS:
        argument_effects(state, arg, &c->bake);
        break;
    case KEY_EFFECTS_ERROR:
        c->bake.effects_error = argument_share(state, "--effects-error", arg);
        break;
    case KEY_GATHER:
        c->bake.rays_per_photon = strcmp(arg, "auto") == 0 ? -1 : argument_number(state, "--gather", arg, 1.0 / 64, 64);
        break;
    case KEY_TREES:
        c->bake.trees = (uint32_t)argument_count(state, "--trees", arg, 0, LMG_MOST_TREES);
        if (c->bake.trees == 1)
            usage_error(state, "--trees: one alone is a staircase; 2 to %d, or 0 for none", LMG_MOST_TREES);
        break;
    case KEY_LOOKS:
        c->bake.looks_chosen = true;
        c->bake.looks = argument_count(state, "--looks", arg, 0, MOST_LOOKS);
        break;
    case KEY_PHOTONS_ONLY:
        c->photons_only = c->bake.looks_chosen = true;
        break;
    case KEY_SEED:
        c->bake.seed = argument_count(state, "--seed", arg, 0, UINT64_MAX);
        break;
    case KEY_THREADS:
        c->bake.threads = (unsigned)argument_count(state, "--threads", arg, 1, 1024);
        break;
    case KEY_RESUME:
        c->resume = true;
        break;
    case KEY_CHECKPOINT:
        c->bake.checkpoint_seconds = argument_seconds(state, "--checkpoint", arg);
        if (c->bake.checkpoint_seconds > 60)
            usage_error(state, "--checkpoint: %s is more than a minute", arg);
        break;
    case KEY_KEEP:
        c->bake.keep = true;
        break;
    case KEY_SHARE:
        parse_share(state, arg, c);
        break;
    case KEY_FIRST:
        c->bake.first = argument_count(state, "--first", arg, 0, UINT64_C(1) << 61);
        c->given_first = true;
        break;
    case 'q':
        c->quiet = true;
        break;
    case KEY_PROGRESS:
        c->progress = true;
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
        if (!c->output)
            usage_error(state, "where to? give -o NAME.box.exr");
        if (c->bake.size > 0 && (c->bake.fit.cells || c->bake.fit.resolution[0] || c->bake.fit.resolution[1] ||
                                 c->bake.fit.resolution[2] || c->bake.fit.resolution[3]))
            usage_error(state, "--size chooses the cells: no --cells or --resolution with it");
        if (c->bake.photons && c->bake.seconds > 0)
            usage_error(state, "--time and --photons exclude each other");
        if (c->target.error > 0 &&
            (c->bake.photons || c->bake.seconds > 0 || c->resume || c->bake.keep || c->shares || c->given_first))
            usage_error(state,
                        "--error finds the photons by itself: no --time, --photons, --resume, --keep, --share or --first with it");
        if (c->target.error > 0 && c->bake.output_flux_lm > 0)
            usage_error(state, "--error and --output-flux exclude each other; give --flux");
        if (c->bake.flux_lm > 0 && c->bake.output_flux_lm > 0)
            usage_error(state, "--flux and --output-flux exclude each other");
        settle_photons(state, c);
        break;
    default:
        return parse_lamp_option(state, key, arg, &c->lamp) ? 0 : ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static void print_duration(char text[16], double seconds)
{
    const unsigned s = seconds < 1e6 ? (unsigned)(seconds + 0.5) : 999999;
    if (s < 3600)
        snprintf(text, 16, "%u:%02u", s / 60, s % 60);
    else
        snprintf(text, 16, "%u:%02u:%02u", s / 3600 % 1000, s / 60 % 60, s % 60);
}

/* On a terminal one line that is written over; otherwise a line every ten seconds. */
static void show_progress(void *self, const bake_progress *p)
{
    command *c = self;
    if (!c->terminal && p->seconds_left > 0 && p->seconds - c->last_line < 10)
        return;
    c->last_line = p->seconds;
    char left[16];
    print_duration(left, p->seconds_left);
    fprintf(stderr, "%s%.4g M photons, %.3g M/s, %.4f %% of the flux accounted, noise %.2g %%, %s left%s", c->terminal ? "\r" : "",
            1e-6 * (double)p->photons, 1e-6 * p->rate, 100 * p->accounted, 100 * p->noise, left, c->terminal ? "\033[K" : "\n");
    fflush(stderr);
}

/* The error of a box: known with a standard error, or, of the flux, itself one. */
static void print_error(FILE *to, const command *c, judge_error e)
{
    if (c->target.of == TARGET_FLUX)
        fprintf(to, "standard error of flux %.3g %%", 100 * e.rms);
    else
        fprintf(to, "%s error %.3g +- %.2g %%", target_measure_name(c->target.of), 100 * e.rms, 100 * e.standard_error);
}

/* What a search for an error has found so far. */
static void show_bake(void *self, unsigned bake, uint64_t photons, uint64_t cells, judge_error error, uint64_t next, double seconds)
{
    const command *c = self;
    fprintf(stderr, "%sbake %u: %.3g M photons, %.3g M cells: ", c->terminal ? "\r\033[K" : "", bake, 1e-6 * (double)photons,
            1e-6 * (double)cells);
    print_error(stderr, c, error);
    if (next > 0) {
        char text[16];
        print_duration(text, seconds);
        fprintf(stderr, "; next %.3g M photons, about %s", 1e-6 * (double)next, text);
    }
    fputc('\n', stderr);
}

/* The settings that decide the result (not threads or paths; photons, and those of the plan, are told elsewhere in the box), as canonical
 * JSON. */
static char *settings_text(const command *c)
{
    static const char *const KINDS[] = {"auto", "cube", "aperture"};
    const lmg_fit_options *f = &c->bake.fit;
    json_t *o = json_object();
    json_object_set_new(o, "layout", json_string(KINDS[f->choice]));
    if (f->cells)
        json_object_set_new(o, "cells", json_integer((json_int_t)f->cells));
    if (f->resolution[0] || f->resolution[1] || f->resolution[2] || f->resolution[3]) {
        json_t *r = json_array();
        for (int i = 0; i < 4; ++i)
            json_array_append_new(r, json_integer(f->resolution[i]));
        json_object_set_new(o, "resolution", r);
    }
    if (c->bake.size > 0)
        json_object_set_new(o, "size", json_real(c->bake.size));
    if (c->target.error > 0) /* up to 64 million cells then */
        json_object_set_new(o, "error", json_real(c->target.error));
    if (c->bake.trees != BAKE_TREES_AUTO && !c->shares && !c->given_first && !(c->target.error > 0))
        json_object_set_new(o, "trees", json_integer(c->bake.trees));
    if (c->bake.looks_chosen)
        json_object_set_new(o, "looks", json_integer((json_int_t)c->bake.looks));
    if (c->bake.effects_error > 0)
        json_object_set_new(o, "effects_error", json_real(c->bake.effects_error));
    if (c->bake.flux_lm > 0)
        json_object_set_new(o, "flux_lm", json_real(c->bake.flux_lm));
    if (c->bake.output_flux_lm > 0)
        json_object_set_new(o, "output_flux_lm", json_real(c->bake.output_flux_lm));
    char *text = json_dumps(o, JSON_COMPACT | JSON_SORT_KEYS | JSON_REAL_PRECISION(15));
    json_decref(o);
    return text;
}

static json_t *json_flux(double lumens, double error)
{
    return json_pack("{s:o, s:o}", "lm", json_number(lumens), "standard_error", json_number(error));
}

static json_t *json_error(const bake_bias_error *e)
{
    return json_pack("{s:o, s:o}", "rms", json_number(e->rms), "standard_error", json_number(e->standard_error));
}

static json_t *json_bias(const bake_bias *bias)
{
    json_t *planes = json_array();
    for (int i = 0; i < BIAS_DISTANCES; ++i) {
        json_t *plane = json_error(&bias->planes[i]);
        json_object_set_new(plane, "sizes", json_real(BAKE_BIAS_DISTANCE[i]));
        json_array_append_new(planes, plane);
    }
    return json_pack("{s:o, s:o}", "illuminance", planes, "far_field", json_error(&bias->far_field));
}

static json_t *summary_json(const command *c, const lmg_field *field, const bake_report *r, const lum_model *model,
                            const char *recipe, double seconds, uint64_t bytes)
{
    const lmg_ledger l = lmg_field_ledger(field);
    const lmg_layout *y = lmg_field_layout(field);
    char effects[512];
    bake_effects_print(r->plan.simulated, effects, sizeof(effects));
    json_t *warnings = json_array();
    for (uint32_t i = 0; i < model->warning_count; ++i)
        json_array_append_new(warnings, json_string(model->warnings[i]));
    const double trace = fmax(r->trace_seconds, 1e-9);
    json_t *o = json_object();
    json_object_set_new(o, "format", json_string("lumibake bake 1"));
    json_object_set_new(o, "lamp", json_string(c->lamp.path));
    json_object_set_new(o, "recipe", recipe[0] ? json_string(recipe) : json_null());
    json_object_set_new(o, "box", json_string(c->output));
    json_object_set_new(o, "photons", json_integer((json_int_t)l.photons));
    json_object_set_new(o, "pilot_photons", json_integer((json_int_t)r->pilot_photons));
    json_object_set_new(o, "segments", json_integer((json_int_t)r->tally.segments));
    json_object_set_new(o, "emitted", json_flux(l.emitted, l.emitted_se));
    json_object_set_new(o, "stored", json_flux(l.stored, l.stored_se));
    json_object_set_new(o, "residual", json_flux(l.residual, l.residual_se));
    json_object_set_new(o, "absorbed", json_flux(l.absorbed, l.absorbed_se));
    json_object_set_new(o, "lost", json_flux(l.lost, l.lost_se));
    json_object_set_new(o, "lost_inside_photons", json_real(r->tally.lost_inside));
    json_object_set_new(o, "efficiency", json_number((l.stored + l.residual) / l.emitted));
    json_object_set_new(o, "noise", json_number(r->noise));
    json_object_set_new(o, "bias", json_bias(&r->bias));
    const char *gathered = lmg_field_get_text(field, "gathered_flux"), *rays = lmg_field_get_text(field, "gather");
    json_object_set_new(o, "gather",
                        json_pack("{s:o, s:I, s:o, s:s}", "rays_per_photon", json_number(rays ? strtod(rays, NULL) : 0), "rays",
                                  (json_int_t)r->gathered_rays, "flux_share", json_number(gathered ? strtod(gathered, NULL) : 0),
                                  "why", r->gather_why));
    if (c->target.error > 0)
        json_object_set_new(o, "error",
                            json_pack("{s:s, s:f, s:o, s:o, s:b, s:i}", "of", target_measure_name(c->target.of), "asked",
                                      c->target.error, "rms", json_number(c->reached.error.rms), "standard_error",
                                      json_number(c->reached.error.standard_error), "within", c->reached.within, "bakes",
                                      (int)c->reached.bakes));
    json_object_set_new(o, "effects", json_string(effects));
    json_object_set_new(o, "effect_plan", json_plan(&r->plan));
    json_object_set_new(o, "slabs", json_integer(y->slab_count));
    json_object_set_new(o, "channels", json_integer(y->channels));
    json_object_set_new(o, "size_m", json_number(y->size));
    json_object_set_new(o, "layout_why", json_string(r->layout_why));
    json_object_set_new(o, "photons_per_second", json_number((double)l.photons / trace));
    json_object_set_new(o, "segments_per_second", json_number((double)r->tally.segments / trace));
    json_object_set_new(o, "seconds",
                        json_pack("{s:f, s:f, s:f, s:f, s:f, s:f, s:f}", "plan", r->plan_seconds, "pilot", r->pilot_seconds, "trace",
                                  r->trace_seconds, "gather", r->gather_seconds, "reconstruct", r->reconstruct_seconds, "trees",
                                  r->trees_seconds, "total", seconds));
    json_object_set_new(o, "trees", json_trees(field));
    if (r->no_trees_why[0])
        json_object_set_new(o, "no_trees_why", json_string(r->no_trees_why));
    if (r->looks_why[0])
        json_object_set_new(o, "looks_why", json_string(r->looks_why));
    json_object_set_new(o, "bytes", json_integer((json_int_t)bytes));
    json_object_set_new(o, "bytes_foretold", r->size_foretold > 0 ? json_number(r->size_foretold) : json_null());
    json_object_set_new(o, "rounding",
                        json_pack("{s:o, s:o}", "loss", json_number(c->lost.loss), "half_loss", json_number(c->lost.half_loss)));
    json_object_set_new(o, "interrupted", json_boolean(r->interrupted));
    json_object_set_new(o, "resumed", json_boolean(r->resumed));
    json_object_set_new(o, "part", r->interrupted || c->bake.keep ? json_string(c->part) : json_null());
    json_object_set_new(o, "warnings", warnings);
    return o;
}

/* Errors, or what is above their noise of them. */
static void print_bias(const bake_bias *bias)
{
    fputs("  bias      of illuminance, by what the cells smooth, at", stdout);
    for (int i = 0; i < BIAS_DISTANCES; ++i)
        printf("%s %g sizes %.2g +- %.1g %%", i ? "," : "", BAKE_BIAS_DISTANCE[i], 100 * fmax(bias->planes[i].rms, 0),
               100 * bias->planes[i].standard_error);
    printf("; of the far field %.2g +- %.1g %%\n", 100 * fmax(bias->far_field.rms, 0), 100 * bias->far_field.standard_error);
}

static void print_summary(const command *c, const lmg_field *field, const bake_report *r, double seconds, uint64_t bytes)
{
    const lmg_ledger l = lmg_field_ledger(field);
    const lmg_layout *y = lmg_field_layout(field);
    const double n = (double)l.photons;
    const double out = l.stored + l.residual, share = out / l.emitted;
    char effects[512];
    bake_effects_print(r->plan.simulated, effects, sizeof(effects));
    printf("%s\n", c->output);
    printf("  effects   %s\n", effects);
    const uint32_t left_out = r->plan.contained & ~r->plan.simulated;
    if (left_out) {
        bake_effects_print(left_out, effects, sizeof(effects));
        printf("            left out: %s (lumibake plan says why)\n", effects);
    }
    printf("  photons   %" PRIu64 " in %.1f s, %.3g M/s, %.3g segments each; noise of illuminance one size away %.2g %%\n",
           l.photons, r->trace_seconds, 1e-6 * n / fmax(r->trace_seconds, 1e-9), (double)r->tally.segments / n, 100 * r->noise);
    print_bias(&r->bias);
    const char *gathered = lmg_field_get_text(field, "gathered_flux");
    if (r->gathered_rays > 0)
        printf("  gathered  %.3g M rays backwards in %.1f s, in cells with %.3g %% of the flux; %s\n",
               1e-6 * (double)r->gathered_rays, r->gather_seconds, 100 * (gathered ? strtod(gathered, NULL) : 0),
               r->gather_why[0] ? r->gather_why : "as the earlier run decided");
    else if (r->gather_why[0])
        printf("  gathered  %s\n", r->gather_why);
    if (c->target.error > 0) {
        fputs("  error     ", stdout);
        print_error(stdout, c, c->reached.error);
        printf(", asked for %.3g %%; found in %u bakes\n", 100 * c->target.error, c->reached.bakes);
    }
    print_ledger(&l);
    printf("  efficiency %.4f %% +- %.2g %%\n", 100 * share, 100 * bake_light_error(&r->tally, share * n));
    uint64_t cells = 0;
    for (uint32_t i = 0; i < y->slab_count; ++i)
        cells += (uint64_t)y->slabs[i].nu * y->slabs[i].nv * y->slabs[i].ns * y->slabs[i].nt;
    printf("  layout    %u slabs, %.3g M cells, %s; size %.4g m\n", y->slab_count, 1e-6 * (double)cells,
           y->channels == 1 ? "one colour" : "R,G,B", y->size);
    for (const char *line = r->layout_why; *line;) {
        const size_t length = strcspn(line, "\n");
        if (length > 0)
            printf("            %.*s\n", (int)length, line);
        line += length + (line[length] == '\n');
    }
    const lmg_tree_totals trees = lmg_field_trees(field);
    if (trees.trees > 0) {
        printf("  trees     %u with %.3g M leaves in all, of %.3g M rays and %.3g M looks, in %.1f s\n", trees.trees,
               1e-6 * (double)trees.leaves, 1e-6 * (double)trees.rays, 1e-6 * (double)trees.looks, r->trees_seconds);
        if (trees.tiles > 0)
            printf("            light repeats itself in %u tiles of %u kinds, which share their rays\n", trees.tiles, trees.kinds);
        if (r->looks_why[0])
            printf("            looks: %s\n", r->looks_why);
    } else if (r->no_trees_why[0]) {
        printf("  trees     none: %s\n", r->no_trees_why);
    }
    printf("  file      %.2f MB", 1e-6 * (double)bytes);
    if (r->size_foretold > 0)
        printf(" (foretold%s: %.2f)", trees.trees > 0 ? " without trees" : "", 1e-6 * r->size_foretold);
    printf(", ");
    if (c->lost.loss > 0 || c->lost.half_loss > 0)
        printf("cells rounded by %.2g of their noise; ", c->lost.loss);
    else
        printf("lossless; ");
    printf("%.1f s in all (plan %.1f s, pilot %.1f s)\n", seconds, r->plan_seconds, r->pilot_seconds);
}

/* What the ledger gives reason to warn of. */
static void print_remarks(const bake_report *r)
{
    const double n = r->tally.emitted;
    if (r->tally.lost_inside > 0)
        fprintf(stderr,
                "warning: %.3g %% of the light left the model while inside a solid dielectric: its mesh is open, its faces point "
                "inwards, or it touches another solid face to face; close it, declare it thin-walled (--set thin:MATERIAL), or "
                "leave a gap\n",
                100 * r->tally.lost_inside / n);
    if (r->tally.lost - r->tally.lost_inside > 1e-6 * n)
        fprintf(stderr, "warning: %.3g %% of the light was lost to numerical errors\n",
                100 * (r->tally.lost - r->tally.lost_inside) / n);
}

static uint64_t bytes_of(const char *path)
{
    struct stat status;
    return stat(path, &status) == 0 ? (uint64_t)status.st_size : 0;
}

/* Writes the box; of one that comes out larger than it may be, trees are taken away and then cells are rounded more coarsely, as far as that
 * goes. */
static lmg_result write_in_size(command *c, lmg_field *field, bake_report *report, lmg_error *err)
{
    lmg_result result = write_box(field, c->output, c->lossless, &c->lost, err);
    const double most = c->bake.size * SIZE_SLACK;
    if (!(most > 0)) /* so many cells as a bake has by itself, and trees, take less than BAKE_SIZE */
        return result;
    const lmg_tree_totals trees = lmg_field_trees(field);
    const double over = result == LMG_OK ? (double)bytes_of(c->output) - most : 0;
    if (over > 0 && trees.trees > 0) {
        const uint32_t left = lmg_field_thin_trees(field, over < (double)trees.bytes ? trees.bytes - (size_t)over : 0);
        if (left == 0)
            snprintf(report->no_trees_why, sizeof(report->no_trees_why), "two of them take %.2f MB, more than cells leave of %.2f MB",
                     1e-6 * 2 * (double)trees.bytes / trees.trees, 1e-6 * c->bake.size);
        result = write_box(field, c->output, c->lossless, &c->lost, err);
    }
    for (double loss = 2 * BAKE_ROUNDING; result == LMG_OK && !c->lossless && loss <= MOST_ROUNDING && (double)bytes_of(c->output) > most; loss *= 2)
        result = lmg_field_write_rounded(field, c->output, loss, &c->lost, err);
    if (result == LMG_OK && (double)bytes_of(c->output) > most && !c->quiet)
        fprintf(stderr,
                "warning: %.2f MB are more than the %.2f MB asked for; --cells with fewer than the box has makes it smaller\n",
                1e-6 * (double)bytes_of(c->output), 1e-6 * c->bake.size);
    return result;
}

static int bake_lamp(command *c, lum_model *model, const char *recipe, double began)
{
    lmg_error err = {{0}};
    char *settings = settings_text(c);
    c->bake.settings = settings;
    c->bake.stop = catch_interrupts();
    c->terminal = isatty(STDERR_FILENO) && !c->progress;
    if (!c->quiet && (c->terminal || c->progress)) {
        c->bake.progress = show_progress;
        c->bake.progress_self = c;
    }
    lmg_field *field = NULL;
    bake_report report;
    lmg_result result;
    if (c->target.error > 0) {
        c->target.progress = c->quiet ? NULL : show_bake;
        c->target.progress_self = c;
        result = bake_run_to_error(model, &c->bake, &c->target, &field, &report, &c->reached, &err);
    } else {
        result = bake_run(model, &c->bake, &field, &report, &err);
    }
    if (c->bake.progress && c->terminal)
        fputs("\r\033[K", stderr);
    free(settings);
    if (result != LMG_OK)
        return report_error(result, &err);
    if (write_in_size(c, field, &report, &err) != LMG_OK) {
        lmg_field_destroy(field);
        return report_failure(&err);
    }

    /* The box is there: a checkpoint, of this bake or of one that it replaces, has done its duty. */
    if (!report.interrupted && !c->bake.keep)
        unlink(c->part);
    const uint64_t bytes = bytes_of(c->output);
    const double seconds = bake_clock() - began;
    const bool missed = c->target.error > 0 && !c->reached.within && !report.interrupted;
    int code = report.interrupted ? EXIT_INTERRUPTED : missed ? EXIT_DIFFERENT : EXIT_DONE;
    if (!c->quiet) {
        print_remarks(&report);
        if (missed)
            fprintf(stderr, "warning: the error asked for isn't reached%s\n",
                    c->bake.fit.cells ? ": --cells fixes how fine the box can be; give more, or leave it out" : "");
        if (report.no_trees_why[0] && c->bake.trees != BAKE_TREES_AUTO)
            fprintf(stderr, "warning: no radiance trees: %s\n", report.no_trees_why);
        if (report.interrupted)
            fprintf(stderr, "interrupted: the box holds the %" PRIu64 " photons traced so far; --resume goes on from %s\n",
                    report.tally.photons, c->part);
    }
    bool printed = true;
    if (c->json) {
        printed = print_json(summary_json(c, field, &report, model, recipe, seconds, bytes));
    } else if (!c->quiet) {
        print_summary(c, field, &report, seconds, bytes);
        printed = fflush(stdout) == 0 && !ferror(stdout);
    }
    lmg_field_destroy(field);
    if (!printed) {
        lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print the summary: %s", strerror(errno));
        code = report_failure(&err);
    }
    return code;
}

/* Reads the checkpoint to go on from, or says that there is none, or that there is one nobody asked for. */
static lmg_result find_checkpoint(command *c, lmg_error *err)
{
    const bool there = access(c->part, F_OK) == 0;
    if (c->resume && there)
        return bake_part_read(c->part, &c->bake.resume, err);
    if (!c->quiet && c->resume)
        fprintf(stderr, "no checkpoint %s: the bake starts at the beginning\n", c->part);
    if (!c->quiet && !c->resume && there)
        fprintf(stderr, "warning: %s of an earlier bake will be replaced; --resume would go on from it\n", c->part);
    return LMG_OK;
}

/* Joins in the bake of another process.  loaded: how reading the lamp went here. */
static int help(const command *c, const lum_model *model, lmg_result loaded, lmg_error *err)
{
    const lmg_result result = bake_team_work(c->bake.team, model, &c->bake, loaded != LMG_OK, err);
    if (result != LMG_OK)
        return report_error(loaded != LMG_OK ? loaded : result, err);
    return loaded == LMG_OK ? EXIT_DONE : EXIT_INPUT; /* the first process couldn't read it either, and says so */
}

/* Everything between joining the team and leaving it. */
static int bake_or_help(command *c)
{
    const double began = bake_clock();
    const bool helps = bake_team_is_helper(c->bake.team);
    lmg_error err = {{0}};
    lum_model *model = NULL;
    char *recipe_text = NULL, recipe[1024];
    if (!helps && check_output(c->output, &c->lamp.path, 1, &err) != LMG_OK)
        return report_failure(&err);
    lmg_result result = lamp_load(&c->lamp, &model, &recipe_text, recipe, &err);
    int code;
    if (helps) {
        c->bake.stop = catch_interrupts();
        code = help(c, model, result, &err);
    } else {
        if (result == LMG_OK)
            result = find_checkpoint(c, &err);
        if (result != LMG_OK) {
            code = report_error(result, &err);
        } else {
            if (!c->quiet && recipe[0] && !c->lamp.recipe_path)
                fprintf(stderr, "using the recipe %s\n", recipe);
            for (uint32_t i = 0; !c->quiet && i < model->warning_count; ++i)
                fprintf(stderr, "warning: %s\n", model->warnings[i]);
            c->bake.recipe = recipe_text;
            code = bake_lamp(c, model, recipe, began);
        }
    }
    free(recipe_text);
    lum_model_destroy(model);
    return code;
}

int cmd_bake(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "LAMP -o BOX", .doc = DOC};
    command c = {.bake = {.seed = 1, .trees = BAKE_TREES_AUTO}};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    if (snprintf(c.part, sizeof(c.part), "%s.part", c.output) >= (int)sizeof(c.part)) {
        lmg_fail(&err, LMG_ERROR_FILE_OPEN, "the name of the output is too long");
        return report_failure(&err);
    }
    c.bake.checkpoint = c.part;
    if (bake_team_join(&c.bake.team, &err) != LMG_OK)
        return report_failure(&err);
    const int code = bake_or_help(&c);
    bake_team_leave(c.bake.team, code);
    return code;
}
