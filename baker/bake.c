/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The bake: pilot -> layout -> rounds of tracing into the accumulator -> reconstruction -> provenance.
 * With a fixed number of photons the field depends on model, recipe, seed and settings alone: not on threads, rounds or speed.
 */
#include "bake.h"

#include "bake_trees.h"
#include "parallel.h"
#include "part.h"
#include "receiver.h"
#include "size.h"
#include "team.h"

#include <luminaires/model.h>

#include <inttypes.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* The pilot takes a twentieth of the bake, at most 400,000 photons (more don't change a layout of some million cells) and at least
 * 20,000 (fewer don't tell where the light is); a tenth of a bake that is asked for in photons as long as that isn't more than
 * 100,000, since with fewer chance chooses too much of the layout. */
static const uint64_t PILOT_MIN = 20000, PILOT_GOOD = 100000, PILOT_MAX = 400000;
static const double PILOT_SHARE = 0.05, PILOT_SHORT_SHARE = 0.1;
/* Rounds last about this long: often enough for progress and Ctrl-C, seldom enough that starting threads costs nothing. */
static const double ROUND_SECONDS = 0.5;
static const uint64_t ROUND_MIN = 8192;
static const double DEFAULT_SECONDS = 60, DEFAULT_CHECKPOINT_SECONDS = 60;
/* Cells for the size of a file: at most a few gigabytes of them; of more than sixteen to a photon nearly all stay dark; and, unless a size is
 * asked for, no more than a lamp's near field needs. */
static const uint64_t DEFAULT_CELLS = 4000000, MOST_CELLS = 64000000;
static const double CELLS_PER_PHOTON = 16;
/* Receiver that the noise is told on. */
static const uint32_t NOISE_PIXELS = 32;

double bake_clock(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

double bake_share_error(double part, double photons)
{
    if (!(photons > 0))
        return 0;
    double p = part / photons;
    p = p < 0 ? 0 : p > 1 ? 1 : p;
    return sqrt(p * (1 - p) / photons);
}

double bake_light_error(const bake_tally *tally, double part)
{
    const double n = (double)tally->photons;
    if (!(tally->escaped_squares > 0) || !(tally->escaped > 0) || !(n > 0))
        return bake_share_error(part, n);
    const double mean = part / n, square = mean * tally->escaped_squares / tally->escaped;
    return sqrt(fmax(square - mean * mean, 0) / n);
}

/* ------------------------------------------------------------------------------------------------------------ ray list */

struct bake_ray_list {
    pthread_mutex_t lock;
    size_t capacity, count, dropped; /* dropped: no memory for them */
    bool sorted;
    lmg_ray *rays;
};

lmg_result bake_ray_list_create(size_t capacity, bake_ray_list **out, lmg_error *err)
{
    *out = NULL;
    bake_ray_list *list = calloc(1, sizeof(*list));
    if (list)
        list->rays = calloc(capacity, sizeof(*list->rays));
    if (!list || !list->rays || pthread_mutex_init(&list->lock, NULL) != 0) {
        if (list)
            free(list->rays);
        free(list);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a list of %zu rays", capacity);
    }
    list->capacity = capacity;
    *out = list;
    return LMG_OK;
}

void bake_ray_list_destroy(bake_ray_list *list)
{
    if (!list)
        return;
    pthread_mutex_destroy(&list->lock);
    free(list->rays);
    free(list);
}

/* Batches of hundreds of rays: the lock costs nothing beside them. */
static void keep_rays(void *self, const lmg_ray *rays, size_t count)
{
    bake_ray_list *list = self;
    pthread_mutex_lock(&list->lock);
    if (count > list->capacity - list->count) {
        const size_t capacity = list->capacity + list->capacity / 2 + count;
        lmg_ray *more = realloc(list->rays, capacity * sizeof(*more));
        if (more) {
            list->rays = more;
            list->capacity = capacity;
        }
    }
    if (count <= list->capacity - list->count) {
        memcpy(list->rays + list->count, rays, count * sizeof(*rays));
        list->count += count;
    } else {
        list->dropped += count;
    }
    pthread_mutex_unlock(&list->lock);
}

lmg_sink bake_ray_list_sink(bake_ray_list *list)
{
    list->sorted = false;
    return (lmg_sink){.self = list, .consume = keep_rays};
}

lmg_result bake_ray_list_check(const bake_ray_list *list, lmg_error *err)
{
    return list->dropped == 0 ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a list of %zu rays", list->count + list->dropped);
}

/* By number; rays of one photon (a multiplied one) by direction, then origin, so that equal sets have equal order. */
static int compare_rays(const void *x, const void *y)
{
    const lmg_ray *a = x, *b = y;
    if (a->number != b->number)
        return a->number < b->number ? -1 : 1;
    const double p[6] = {a->direction.x, a->direction.y, a->direction.z, a->origin.x, a->origin.y, a->origin.z};
    const double q[6] = {b->direction.x, b->direction.y, b->direction.z, b->origin.x, b->origin.y, b->origin.z};
    for (int i = 0; i < 6; ++i)
        if (p[i] != q[i])
            return p[i] < q[i] ? -1 : 1;
    return 0;
}

const lmg_ray *bake_ray_list_any_order(bake_ray_list *list, size_t *count)
{
    *count = list->count;
    return list->rays;
}

const lmg_ray *bake_ray_list_sorted(bake_ray_list *list, size_t *count)
{
    bake_ray_list_any_order(list, count);
    if (!list->sorted)
        qsort(list->rays, *count, sizeof(*list->rays), compare_rays);
    list->sorted = true;
    return list->rays;
}

/* --------------------------------------------------------------------------------------------------------------- bake */

typedef struct bake {
    const lum_model *model;
    const bake_options *options;
    bake_source *tracer_of_all; /* with every effect of the model */
    bake_source *tracer;        /* with those that the plan simulates */
    bake_ray_list *pilot; /* NULL when resumed */
    bake_tally pilot_tally;
    double gather_share; /* of the time, that gathering will take */
    bake_trees trees;
    bake_part *part;
    bake_part *resume; /* what part is to become; NULL when it has */
    bake_report *report;
} bake;

static bool stopped(const bake *b)
{
    return b->options->stop && *b->options->stop;
}

/* Traces the pilot: a first part of PILOT_MIN photons tells the speed, from which a bake by time takes the size of the whole. */
static lmg_result run_pilot(bake *b, double seconds, lmg_error *err)
{
    const bake_options *o = b->options;
    uint64_t wanted = o->pilot_photons;
    if (wanted == 0 && o->photons > 0) {
        const double whole = (double)(o->whole > 0 ? o->whole : o->photons);
        wanted = (uint64_t)fmax(PILOT_SHARE * whole, fmin(PILOT_SHORT_SHARE * whole, (double)PILOT_GOOD));
        wanted = wanted < PILOT_MIN ? PILOT_MIN : wanted > PILOT_MAX ? PILOT_MAX : wanted;
    }
    const double began = bake_clock();
    lmg_result result = bake_ray_list_create(wanted ? wanted + 1024 : PILOT_MAX + 1024, &b->pilot, err);
    const lmg_sink sink = b->pilot ? bake_ray_list_sink(b->pilot) : (lmg_sink){0};
    bake_tally tally = {0};
    if (result == LMG_OK && wanted == 0) {
        result = b->tracer->run(b->tracer, BAKE_PILOT_FIRST, PILOT_MIN, o->threads, &sink, 1, &tally, err);
        const double rate = (double)PILOT_MIN / fmax(bake_clock() - began, 1e-6);
        const double share = 0.5 * PILOT_SHARE * seconds * rate; /* half: fitting the layout takes time as well */
        wanted = share < (double)PILOT_MIN ? PILOT_MIN : share > (double)PILOT_MAX ? PILOT_MAX : (uint64_t)share;
        wanted -= wanted % PILOT_MIN;
    }
    if (result == LMG_OK && wanted > tally.photons)
        result =
            b->tracer->run(b->tracer, BAKE_PILOT_FIRST + tally.photons, wanted - tally.photons, o->threads, &sink, 1, &tally, err);
    b->part->pilot_photons = tally.photons;
    b->pilot_tally = tally;
    if (result == LMG_OK)
        result = bake_ray_list_check(b->pilot, err);
    if (result != LMG_OK)
        return result;

    size_t count;
    bake_ray_list_sorted(b->pilot, &count);
    if (count == 0) {
        char places[256];
        bake_plan_where_absorbed(b->model, b->tracer, b->options->threads, places, sizeof(places));
        return lmg_fail(err, LMG_ERROR_INPUT,
                        "%.400s: no light leaves the luminaire: of %" PRIu64 " photons %.0f were absorbed and %.0f lost (%s); "
                        "does a closed or black part surround the source?",
                        b->model->path, tally.photons, tally.absorbed, tally.lost, places[0] ? places : "nowhere in particular");
    }
    return LMG_OK;
}

/* What the noise of an illuminance plane will be, from the pilot's rays on it. */
static lmg_result measure_noise(bake *b, const lmg_layout *layout, lmg_error *err)
{
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(b->pilot, &count);
    const bake_rectangle q = bake_measuring_rectangle(layout->bounds_min, layout->bounds_max, bake_main_axis(rays, count),
                                                      layout->size, layout->size, NOISE_PIXELS);
    bake_receiver *plane;
    const lmg_result result = bake_illuminance_create(&q, &plane, err);
    if (result != LMG_OK)
        return result;
    const lmg_sink sink = bake_receiver_sink(plane);
    sink.consume(sink.self, rays, count);
    b->part->pilot_noise = bake_receiver_noise(plane);
    bake_receiver_destroy(plane);
    return LMG_OK;
}

/* What the cells smooth, seen by the pilot's rays; a resumed bake traces them once more. */
static lmg_result measure_bias(bake *b, const lmg_field *field, lmg_error *err)
{
    const uint64_t wanted = b->part->pilot_photons;
    lmg_result result = LMG_OK;
    if (!b->pilot) {
        result = bake_ray_list_create(wanted + 1024, &b->pilot, err);
        if (result != LMG_OK)
            return result;
        const lmg_sink sink = bake_ray_list_sink(b->pilot);
        bake_tally tally = {0};
        result = b->tracer->run(b->tracer, BAKE_PILOT_FIRST, wanted, b->options->threads, &sink, 1, &tally, err);
    }
    if (result == LMG_OK)
        result = bake_ray_list_check(b->pilot, err);
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(b->pilot, &count);
    return result == LMG_OK ? bake_bias_measure(field, rays, count, &b->report->bias, err) : result;
}

static lmg_result write_checkpoint(bake *b, lmg_error *err)
{
    if (!b->options->checkpoint)
        return LMG_OK;
    const lmg_result result = bake_part_write(b->part, b->options->checkpoint, err);
    b->report->checkpointed |= result == LMG_OK;
    return result;
}

/* Numbers of the photons to trace: first .. end-1. */
static uint64_t end_of(const bake_options *o)
{
    return o->photons ? o->first + o->photons : BAKE_PILOT_FIRST;
}

static void tell_progress(const bake *b, double seconds_left)
{
    const bake_options *o = b->options;
    const bake_part *part = b->part;
    if (!o->progress)
        return;
    const double average = (double)part->tally.photons / fmax(part->seconds, 1e-6);
    const bake_progress p = {
        .photons = part->tally.photons,
        .seconds = part->seconds,
        .rate = average,
        .accounted = (part->tally.escaped + part->tally.absorbed) / part->tally.emitted,
        .noise = bake_part_noise(part),
        .seconds_left = o->photons ? (double)(o->photons - part->tally.photons) / average : fmax(seconds_left, 0),
    };
    o->progress(o->progress_self, &p);
}

/* The photons of the next round, at most `most`: with a team those that nobody has been given, else those that the part lacks. */
static bool next_photons(const bake *b, bake_team *team, uint64_t most, uint64_t *first, uint64_t *count)
{
    if (team)
        return team->take(team, most, first, count);
    if (!bake_part_gap(b->part, b->options->first, end_of(b->options), first, count))
        return false;
    *count = *count < most ? *count : most;
    return true;
}

/* Rounds until the photons are traced, the time is up (deadline, by bake_clock) or somebody says stop. */
static lmg_result trace(bake *b, double deadline, lmg_error *err)
{
    const bake_options *o = b->options;
    bake_part *part = b->part;
    lmg_sink sinks[2] = {lmg_accumulator_sink(part->accumulator)};
    const double began = bake_clock(), before = part->seconds;
    const double between = o->checkpoint_seconds > 0 ? o->checkpoint_seconds : DEFAULT_CHECKPOINT_SECONDS;
    double checkpoint_due = o->checkpoint ? began + between : (double)INFINITY;
    double rate = b->report->resumed ? (double)part->tally.photons / fmax(before, 1e-6)
                                     : (double)part->pilot_photons / fmax(b->report->pilot_seconds, 1e-6);
    bake_team *team = o->team;
    if (team) {
        const lmg_result result = team->invite(team, part, b->report->plan.simulated, o->first, end_of(o), err);
        if (result != LMG_OK)
            return result;
    }
    bool done = b->report->resumed && began >= deadline;
    for (;;) {
        const double now = bake_clock();
        const double want = rate * fmin(ROUND_SECONDS, deadline - now);
        uint64_t first, round;
        if (done || !next_photons(b, team, want < (double)ROUND_MIN ? ROUND_MIN : (uint64_t)want, &first, &round)) {
            if (!team)
                break;
            /* what is there is safe before anything is waited for; photons that don't come back are traced below */
            lmg_result result = b->report->interrupted ? write_checkpoint(b, err) : LMG_OK;
            if (result == LMG_OK)
                result = team->gather(team, part, err);
            if (result != LMG_OK)
                return result;
            team = NULL;
            continue;
        }
        const bool keep = b->trees.kept && first < o->first + b->trees.most_photons;
        if (keep) {
            sinks[1] = bake_ray_list_sink(b->trees.kept);
            if (round > o->first + b->trees.most_photons - first)
                round = o->first + b->trees.most_photons - first;
        }
        lmg_result result = b->tracer->run(b->tracer, first, round, o->threads, sinks, keep ? 2 : 1, &part->tally, err);
        if (result == LMG_OK)
            result = bake_part_add_range(part, first, round, err);
        const double after = bake_clock();
        part->seconds = before + after - began;
        rate = (double)round / fmax(after - now, 1e-6);
        if (result == LMG_OK && team)
            result = team->serve(team, part, err);
        tell_progress(b, deadline - after);
        if (result == LMG_OK && after >= checkpoint_due) {
            result = write_checkpoint(b, err);
            checkpoint_due = bake_clock() + between;
        }
        if (result != LMG_OK)
            return result;
        done = after >= deadline;
        if (!done && stopped(b)) {
            b->report->interrupted = bake_part_gap(part, o->first, end_of(o), &first, &round);
            done = true;
        }
    }
    part->seconds = before + bake_clock() - began;
    if (b->report->interrupted && o->photons) /* the others may have had all that was left */
        b->report->interrupted = part->tally.photons < o->photons;
    if (o->checkpoint && (o->keep || b->report->interrupted || b->report->checkpointed))
        return write_checkpoint(b, err);
    return LMG_OK;
}

static const char *file_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static char *join_warnings(const lum_model *model)
{
    size_t size = 1;
    for (uint32_t i = 0; i < model->warning_count; ++i)
        size += strlen(model->warnings[i]) + 1;
    char *text = malloc(size);
    if (!text)
        return NULL;
    size_t at = 0;
    for (uint32_t i = 0; i < model->warning_count; ++i) {
        const size_t n = strlen(model->warnings[i]);
        memcpy(text + at, model->warnings[i], n);
        at += n;
        if (i + 1 < model->warning_count)
            text[at++] = '\n';
    }
    text[at] = 0;
    return text;
}

/* Says whose photons the part is to have, as far as it is known before the pilot. */
static lmg_result identify(const bake *b, bake_part *part, lmg_error *err)
{
    char hash[17], seed[24], effects[512];
    snprintf(hash, sizeof(hash), "%016" PRIx64, b->model->hash);
    snprintf(seed, sizeof(seed), "%" PRIu64, b->options->seed);
    bake_effects_print(b->report->plan.simulated, effects, sizeof(effects));
    char *plan = bake_plan_text(&b->report->plan);
    char *warnings = join_warnings(b->model);
    if (!warnings || !plan) {
        free(warnings);
        free(plan);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the warnings");
    }
    const struct {
        bake_part_text which;
        const char *text;
    } texts[] = {
        {PART_SOFTWARE, "lumibake " LMG_VERSION_STRING},
        {PART_MODEL, file_name(b->model->path)},
        {PART_MODEL_HASH, hash},
        {PART_RECIPE, b->options->recipe},
        {PART_SETTINGS, b->options->settings},
        {PART_SEED, seed},
        {PART_EFFECTS, effects},
        {PART_PLAN, plan},
        {PART_WARNINGS, warnings[0] ? warnings : NULL},
    };
    lmg_result result = LMG_OK;
    for (size_t i = 0; result == LMG_OK && i < sizeof(texts) / sizeof(texts[0]); ++i)
        result = bake_part_set_text(part, texts[i].which, texts[i].text, err);
    free(warnings);
    free(plan);
    part->source_flux = b->tracer->flux;
    part->flux_lm = b->options->flux_lm;
    part->output_flux_lm = b->options->output_flux_lm;
    return result;
}

/* How many photons the whole bake will have, about. */
static double photons_expected(const bake *b, double seconds)
{
    const bake_options *o = b->options;
    return o->whole > 0     ? (double)o->whole
           : o->photons > 0 ? (double)o->photons
                            : (double)b->part->pilot_photons / fmax(b->report->pilot_seconds, 1e-6) * seconds;
}

/* The layout: of as many cells as are asked for, or as the size of the file allows and the light calls for; a line on why. */
static lmg_result choose_layout(bake *b, double seconds, lmg_layout *layout, char both[1184], lmg_error *err)
{
    const bake_options *o = b->options;
    if (o->layout) {
        *layout = *o->layout;
        snprintf(both, 1184, "%s", "in cells that another bake was found to be worth");
        return LMG_OK;
    }
    lmg_fit_options fit = o->fit;
    char why[1024], cells[160] = "";
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(b->pilot, &count);
    const double photons = photons_expected(b, seconds), pilot_photons = (double)b->part->pilot_photons;
    fit.struct_size = sizeof(fit);
    fit.bounds_min = b->tracer->bounds_min;
    fit.bounds_max = b->tracer->bounds_max;
    /* With a pilot of a size that is asked for the layout is a function of its rays alone, so that bakes of other lengths have it, too; and so it
     * is with cells that are asked for. */
    const bool by_pilot = o->pilot_photons > 0;
    lmg_result result;
    if (fit.cells || fit.resolution[0] || fit.resolution[1] || fit.resolution[2] || fit.resolution[3]) {
        result = lmg_layout_fit(rays, count, &fit, layout, why, err);
    } else {
        /* narrow light fills a few hundredths of the cells, so that there may be more of them than photons */
        const double most = o->size > 0 ? fmin(fmax(CELLS_PER_PHOTON * photons, (double)DEFAULT_CELLS), (double)MOST_CELLS) : (double)DEFAULT_CELLS;
        const double whole = o->size > 0 ? o->size : BAKE_SIZE;
        const double wanted = bake_trees_wanted(o, seconds) > 0 ? bake_trees_leave(whole) : whole;
        bake_size size;
        fit.fewer_cells = !by_pilot;
        fit.photons = by_pilot ? 0 : photons * (double)count / pilot_photons;
        result = bake_size_choose(rays, count, pilot_photons, photons, &fit, wanted, (uint64_t)most, layout, why, &size, err);
        if (result != LMG_OK)
            return result;
        b->report->size_foretold = size.bytes;
        if (size.bytes > 0)
            snprintf(cells, sizeof(cells), "at most %.3g M cells: %s; about %.2f MB of %.2f for %.3g M photons\n", 1e-6 * (double)size.cells,
                     size.limited ? "what the size allows" : "the size would allow more", 1e-6 * size.bytes, 1e-6 * wanted, 1e-6 * photons);
        else
            snprintf(cells, sizeof(cells), "at most %.3g M cells: those of %.3g M photons don't fill %.2f MB\n",
                     1e-6 * (double)size.cells, 1e-6 * photons, 1e-6 * wanted);
    }
    snprintf(both, 1184, "%s%s", cells, result == LMG_OK ? why : "");
    return result;
}

/* The bake in photons that a pilot is for. */
static double bake_of_pilot(double pilot)
{
    return pilot / (pilot > (double)PILOT_GOOD ? PILOT_SHARE : PILOT_SHORT_SHARE);
}

/* Decides how many rays are traced backwards. */
static lmg_result decide_gathering(bake *b, const lmg_layout *layout, lmg_error *err)
{
    const bake_options *o = b->options;
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(b->pilot, &count);
    /* the bake that such a pilot is for: like the layout the decision must not change when a bake is extended */
    const double photons = bake_of_pilot((double)b->pilot_tally.photons);
    bake_gather_plan plan;
    lmg_result result = bake_gather_decide(b->tracer, layout, rays, count, &b->pilot_tally, photons, o->rays_per_photon, o->seed,
                                           o->threads, &plan, err);
    if (result != LMG_OK)
        return result;
    snprintf(b->report->gather_why, sizeof(b->report->gather_why), "%s", plan.why);
    if (!(plan.rays_per_photon > 0))
        return LMG_OK;
    b->gather_share = plan.rays_per_photon * plan.cost / (1 + plan.rays_per_photon * plan.cost);
    char text[32];
    snprintf(text, sizeof(text), "%.17g", plan.rays_per_photon);
    return bake_part_set_text(b->part, PART_GATHER, text, err);
}

/* Pilot and layout of a bake that starts. */
static lmg_result begin_part(bake *b, double seconds, lmg_error *err)
{
    const double began = bake_clock();
    lmg_result result = run_pilot(b, seconds, err);
    if (result != LMG_OK)
        return result;
    b->report->pilot_seconds = bake_clock() - began;

    lmg_layout layout;
    char why[1184], pilot[24];
    snprintf(pilot, sizeof(pilot), "%" PRIu64, b->part->pilot_photons);
    result = choose_layout(b, seconds, &layout, why, err);
    if (result == LMG_OK)
        result = measure_noise(b, &layout, err);
    if (result == LMG_OK && b->options->rays_per_photon != 0)
        result = decide_gathering(b, &layout, err);
    if (result == LMG_OK)
        result = bake_part_set_text(b->part, PART_PILOT_PHOTONS, pilot, err);
    if (result == LMG_OK)
        result = bake_part_set_text(b->part, PART_LAYOUT_WHY, why, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &b->part->accumulator, err);
    return result;
}

/* Takes over what is to be resumed, if it belongs to this bake. */
static lmg_result resume_part(bake *b, lmg_error *err)
{
    const bake_options *o = b->options;
    bake_part *old = b->resume, *self = b->part; /* self: identified, still empty */
    const char *name = o->checkpoint ? o->checkpoint : "the part to be resumed";
    lmg_result result = o->pilot_photons == 0 || o->pilot_photons == old->pilot_photons
                            ? bake_part_set_text(self, PART_PILOT_PHOTONS, old->texts[PART_PILOT_PHOTONS], err)
                            : lmg_fail(err, LMG_ERROR_INPUT, "%.200s: was begun with a pilot of %" PRIu64 " photons; leave --pilot out", name,
                                       old->pilot_photons);
    if (result == LMG_OK)
        result = bake_part_same_bake(old, name, self, "this bake", err);
    for (size_t i = 0; result == LMG_OK && i < old->range_count; ++i)
        if (old->ranges[i].first < o->first || old->ranges[i].first + old->ranges[i].count > end_of(o))
            result = lmg_fail(err, LMG_ERROR_INPUT, "%.200s: has photons that this bake isn't to have (%" PRIu64 " to %" PRIu64 "); ask for more",
                              name, old->ranges[i].first, old->ranges[i].first + old->ranges[i].count - 1);
    if (result != LMG_OK)
        return result;
    bake_part_destroy(self);
    b->part = old;
    b->resume = NULL;
    if (o->rays_per_photon >= 0) { /* else as the pilot said */
        char text[32];
        snprintf(text, sizeof(text), "%.17g", o->rays_per_photon);
        result = bake_part_set_text(old, PART_GATHER, o->rays_per_photon > 0 ? text : NULL, err);
        if (result != LMG_OK)
            return result;
    }
    b->report->resumed = old->tally.photons > 0;
    return LMG_OK;
}

/* Decides which effects are simulated, and makes the tracer that does.  A bake that is resumed is planned as when it began, however long it
 * is to take now. */
static lmg_result plan_effects(bake *b, double seconds, lmg_error *err)
{
    const bake_options *o = b->options;
    bake_plan *plan = &b->report->plan;
    const double began = bake_clock();
    lmg_result result = bake_tracer_create(b->model, o->seed, &b->tracer_of_all, err);
    if (result == LMG_OK && o->effects_chosen)
        bake_plan_choose(b->model, o->effects, plan);
    if (result == LMG_OK && !o->effects_chosen) {
        const bake_plan_options how = {.error = o->effects_error,
                                       .photons = b->resume ? bake_plan_text_photons(b->resume->texts[PART_PLAN]) : 0,
                                       .seconds = o->photons ? 0 : seconds,
                                       .threads = o->threads};
        result = bake_plan_make(b->model, b->tracer_of_all, o->seed, &how, plan, err);
    }
    if (result == LMG_OK)
        result = bake_tracer_create_with(b->model, plan->simulated, o->seed, b->tracer_of_all, &b->tracer, err);
    b->report->plan_seconds = bake_clock() - began;
    return result;
}

/* Traces rays backwards for the photons of the part, if that is decided: *out, NULL if not. */
static lmg_result gather(bake *b, lmg_gathering **out, lmg_error *err)
{
    const bake_part *part = b->part;
    double flux;
    *out = NULL;
    const double rays = part->texts[PART_GATHER] ? strtod(part->texts[PART_GATHER], NULL) : 0;
    const char *obstacle;
    if (!(rays > 0) || b->report->interrupted)
        return LMG_OK;
    if (!bake_tracer_can_look(b->tracer, &obstacle))
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                        "%s: rays can't be traced backwards through a lamp with %s; leave --gather out", b->model->path,
                        obstacle);
    const double began = bake_clock();
    lmg_result result = bake_part_flux(part, &flux, err);
    if (result == LMG_OK)
        result = lmg_gathering_create(part->accumulator, rays, b->options->seed, out, err);
    if (result == LMG_OK)
        result = bake_gather_run(b->tracer, *out, flux, b->options->threads, NULL, err);
    if (result == LMG_OK)
        b->report->gathered_rays = lmg_gathering_rays(*out);
    b->report->gather_seconds = bake_clock() - began;
    return result;
}

static lmg_result bake_all(bake *b, lmg_field **out, lmg_error *err)
{
    const bake_options *o = b->options;
    bake_report *r = b->report;
    const double seconds = o->seconds > 0 ? o->seconds : DEFAULT_SECONDS;
    const double began = bake_clock();
    lmg_result result = plan_effects(b, seconds, err);
    const char *obstacle;
    if (result == LMG_OK && bake_trees_wanted(o, seconds) > 0 && o->looks_chosen && o->looks > 0 && !bake_tracer_can_look(b->tracer, NULL) &&
        !bake_tracer_has_outline(b->tracer, &obstacle))
        result = lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: nothing can be seen of a lamp with %s by rays traced backwards; leave --looks out",
                          b->model->path, obstacle);
    if (result == LMG_OK)
        result = bake_part_create(&b->part, err);
    if (result == LMG_OK)
        result = identify(b, b->part, err);
    if (result == LMG_OK)
        result = b->resume ? resume_part(b, err) : begin_part(b, seconds, err);
    if (result == LMG_OK) {
        b->trees = (bake_trees){.options = o, .report = r, .tracer = b->tracer, .part = b->part};
        result = bake_trees_begin(&b->trees, seconds, err);
    }
    if (result == LMG_OK) {
        const double now = bake_clock(), left = fmax(seconds - b->part->seconds - (now - began), 0);
        result = trace(b, o->photons ? (double)INFINITY : now + (1 - b->gather_share) * bake_trees_tracing(&b->trees, left), err);
    }
    if (result != LMG_OK)
        return result;

    const bake_part *part = b->part;
    r->tally = part->tally;
    r->pilot_photons = part->pilot_photons;
    r->trace_seconds = part->seconds;
    r->noise = bake_part_noise(part);
    snprintf(r->layout_why, sizeof(r->layout_why), "%s", part->texts[PART_LAYOUT_WHY]);
    r->refused = lmg_accumulator_totals(part->accumulator).refused;
    lmg_gathering *gathering;
    result = gather(b, &gathering, err);
    const double reconstruct_began = bake_clock();
    if (result == LMG_OK)
        result = bake_part_flux(part, &r->flux_lm, err);
    r->lumens_per_photon = r->flux_lm / (double)part->tally.photons;
    if (result == LMG_OK)
        result = bake_part_field(part, gathering, out, err);
    lmg_gathering_destroy(gathering);
    if (result == LMG_OK)
        result = measure_bias(b, *out, err);
    r->reconstruct_seconds = bake_clock() - reconstruct_began;
    if (result != LMG_OK)
        return result;
    const bool interrupted = r->interrupted;
    bake_trees_grow(&b->trees, *out);
    return r->interrupted && !interrupted ? write_checkpoint(b, err) : LMG_OK;
}

lmg_result bake_run(const struct lum_model *model, const bake_options *options, lmg_field **out, bake_report *report,
                    lmg_error *err)
{
    *out = NULL;
    memset(report, 0, sizeof(*report));
    bake b = {.model = model, .options = options, .resume = options->resume, .report = report};
    const lmg_result result = bake_all(&b, out, err);
    if (result != LMG_OK) {
        lmg_field_destroy(*out);
        *out = NULL;
    }
    bake_part_destroy(b.part);
    bake_part_destroy(b.resume);
    bake_ray_list_destroy(b.pilot);
    bake_ray_list_destroy(b.trees.kept);
    if (b.tracer)
        b.tracer->destroy(b.tracer);
    if (b.tracer_of_all) /* lends to the other */
        b.tracer_of_all->destroy(b.tracer_of_all);
    return result;
}
