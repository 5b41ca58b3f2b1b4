/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The bake: pilot -> layout -> rounds of tracing into the accumulator -> reconstruction -> provenance.
 * With a fixed number of photons the field depends on model, recipe, seed and settings alone: not on threads, rounds or speed.
 */
#include "bake.h"

#include "effects.h"
#include "receiver.h"

#include <luminaires/model.h>

#include <inttypes.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* The pilot takes a twentieth of the bake, at most 400,000 photons (more don't change a layout of some million cells) and at least
 * 20,000 (fewer don't tell where the light is). */
static const uint64_t PILOT_MIN = 20000, PILOT_MAX = 400000;
static const double PILOT_SHARE = 0.05;
/* Rounds last about this long: often enough for progress and Ctrl-C, seldom enough that starting threads costs nothing. */
static const double ROUND_SECONDS = 0.5;
static const uint64_t ROUND_MIN = 8192;
static const double DEFAULT_SECONDS = 60;
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

/* ------------------------------------------------------------------------------------------------------------ ray list */

struct bake_ray_list {
    size_t capacity;
    atomic_size_t count; /* may run past the capacity: those rays were dropped */
    bool sorted;
    lmg_ray *rays;
};

lmg_result bake_ray_list_create(size_t capacity, bake_ray_list **out, lmg_error *err)
{
    *out = NULL;
    bake_ray_list *list = calloc(1, sizeof(*list));
    if (list)
        list->rays = calloc(capacity, sizeof(*list->rays));
    if (!list || !list->rays) {
        free(list);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for %zu pilot rays", capacity);
    }
    list->capacity = capacity;
    *out = list;
    return LMG_OK;
}

void bake_ray_list_destroy(bake_ray_list *list)
{
    if (!list)
        return;
    free(list->rays);
    free(list);
}

static void keep_rays(void *self, const lmg_ray *rays, size_t count)
{
    bake_ray_list *list = self;
    const size_t at = atomic_fetch_add_explicit(&list->count, count, memory_order_relaxed);
    if (at >= list->capacity)
        return;
    const size_t room = list->capacity - at;
    memcpy(list->rays + at, rays, (count < room ? count : room) * sizeof(*rays));
}

lmg_sink bake_ray_list_sink(bake_ray_list *list)
{
    list->sorted = false;
    return (lmg_sink){.self = list, .consume = keep_rays};
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

const lmg_ray *bake_ray_list_sorted(bake_ray_list *list, size_t *count)
{
    const size_t n = atomic_load(&list->count);
    *count = n < list->capacity ? n : list->capacity;
    if (!list->sorted)
        qsort(list->rays, *count, sizeof(*list->rays), compare_rays);
    list->sorted = true;
    return list->rays;
}

/* --------------------------------------------------------------------------------------------------------------- bake */

typedef struct bake {
    const lum_model *model;
    const bake_options *options;
    bake_source *tracer;
    bake_ray_list *pilot;
    lmg_accumulator *accumulator;
    double pilot_noise; /* relative, with the pilot's photons */
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
        wanted = (uint64_t)(PILOT_SHARE * (double)o->photons);
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
    b->report->pilot_photons = tally.photons;
    if (result != LMG_OK)
        return result;

    size_t count;
    bake_ray_list_sorted(b->pilot, &count);
    if (count == 0)
        return lmg_fail(err, LMG_ERROR_INPUT,
                        "%s: no light leaves the luminaire: of %" PRIu64 " photons %.0f were absorbed and %.0f lost; "
                        "does a closed or black part surround the source?",
                        b->model->path, tally.photons, tally.absorbed, tally.lost);
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
    b->pilot_noise = bake_receiver_noise(plane);
    bake_receiver_destroy(plane);
    return LMG_OK;
}

static double noise_after(const bake *b, uint64_t photons)
{
    return b->pilot_noise * sqrt((double)b->report->pilot_photons / (double)photons);
}

/* Rounds until the photons are traced, the time is up or somebody says stop. */
static lmg_result trace(bake *b, double seconds, double pilot_began, lmg_error *err)
{
    const bake_options *o = b->options;
    bake_tally *tally = &b->report->tally;
    const lmg_sink sink = lmg_accumulator_sink(b->accumulator);
    const double began = bake_clock();
    const double deadline = o->photons ? (double)INFINITY : pilot_began + seconds;
    double rate = (double)b->report->pilot_photons / fmax(b->report->pilot_seconds, 1e-6);
    for (;;) {
        const double now = bake_clock();
        const double left = deadline - now;
        double want = rate * fmin(ROUND_SECONDS, left);
        uint64_t round = want < (double)ROUND_MIN ? ROUND_MIN : (uint64_t)want;
        if (o->photons && round > o->photons - tally->photons)
            round = o->photons - tally->photons;
        const lmg_result result = b->tracer->run(b->tracer, tally->photons, round, o->threads, &sink, 1, tally, err);
        if (result != LMG_OK)
            return result;
        const double after = bake_clock();
        rate = (double)round / fmax(after - now, 1e-6);
        if (o->progress) {
            const double average = (double)tally->photons / fmax(after - began, 1e-6);
            const bake_progress p = {
                .photons = tally->photons,
                .seconds = after - began,
                .rate = average,
                .accounted = (tally->escaped + tally->absorbed) / tally->emitted,
                .noise = noise_after(b, tally->photons),
                .seconds_left = o->photons ? (double)(o->photons - tally->photons) / average : fmax(deadline - after, 0),
            };
            o->progress(o->progress_self, &p);
        }
        if (o->photons ? tally->photons >= o->photons : after >= deadline)
            break;
        if (stopped(b)) {
            b->report->interrupted = true;
            break;
        }
    }
    b->report->trace_seconds = bake_clock() - began;
    b->report->noise = noise_after(b, tally->photons);
    return LMG_OK;
}

/* The balance in lumens.  Shares of N photons have binomial standard errors; what was emitted is known. */
static lmg_ledger balance(const bake *b)
{
    const bake_tally *t = &b->report->tally;
    const lmg_deposit_totals d = lmg_accumulator_totals(b->accumulator);
    const double n = (double)t->photons, lm = b->report->lumens_per_photon, all = n * lm;
    const double lost = t->lost + (double)d.refused;
    return (lmg_ledger){
        .photons = t->photons,
        .emitted = all,
        .stored = d.stored * lm,
        .residual = d.residual * lm,
        .absorbed = t->absorbed * lm,
        .lost = lost * lm,
        .stored_se = all * bake_share_error(d.stored, n),
        .residual_se = all * bake_share_error(d.residual, n),
        .absorbed_se = all * bake_share_error(t->absorbed, n),
        .lost_se = all * bake_share_error(lost, n),
    };
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

/* Says in the field where it comes from; nothing that depends on the machine, the threads or the date, so that files can be
 * compared. */
static lmg_result add_texts(const bake *b, lmg_field *field, lmg_error *err)
{
    char hash[17], seed[24], photons[24], pilot[24], effects[512];
    snprintf(hash, sizeof(hash), "%016" PRIx64, b->model->hash);
    snprintf(seed, sizeof(seed), "%" PRIu64, b->options->seed);
    snprintf(photons, sizeof(photons), "%" PRIu64, b->report->tally.photons);
    snprintf(pilot, sizeof(pilot), "%" PRIu64, b->report->pilot_photons);
    bake_effects_print(b->report->effects, effects, sizeof(effects));
    char *warnings = join_warnings(b->model);
    if (!warnings)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the warnings");
    const struct {
        const char *name, *value;
    } texts[] = {
        {"software", "lumibake " LMG_VERSION_STRING},
        {"model", file_name(b->model->path)},
        {"model_hash", hash},
        {"recipe", b->options->recipe},
        {"settings", b->options->settings},
        {"seed", seed},
        {"photons", photons},
        {"pilot_photons", pilot},
        {"effects", effects},
        {"layout_why", b->report->layout_why},
        {"warnings", warnings[0] ? warnings : NULL},
    };
    lmg_result result = LMG_OK;
    for (size_t i = 0; result == LMG_OK && i < sizeof(texts) / sizeof(texts[0]); ++i)
        if (texts[i].value)
            result = lmg_field_set_text(field, texts[i].name, texts[i].value, err);
    free(warnings);
    return result;
}

static lmg_result bake_all(bake *b, lmg_field **out, lmg_error *err)
{
    const bake_options *o = b->options;
    bake_report *r = b->report;
    const double seconds = o->seconds > 0 ? o->seconds : DEFAULT_SECONDS;
    r->effects = bake_effects_of(b->model);
    lmg_result result = bake_tracer_create(b->model, o->seed, &b->tracer, err);
    if (result != LMG_OK)
        return result;

    const double began = bake_clock();
    result = run_pilot(b, seconds, err);
    if (result != LMG_OK)
        return result;
    r->pilot_seconds = bake_clock() - began;

    lmg_fit_options fit = o->fit;
    fit.struct_size = sizeof(fit);
    fit.bounds_min = b->tracer->bounds_min;
    fit.bounds_max = b->tracer->bounds_max;
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(b->pilot, &count);
    lmg_layout layout;
    result = lmg_layout_fit(rays, count, &fit, &layout, r->layout_why, err);
    if (result == LMG_OK)
        result = measure_noise(b, &layout, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &b->accumulator, err);
    if (result == LMG_OK)
        result = trace(b, seconds, began, err);
    if (result != LMG_OK)
        return result;

    const double flux = o->flux_lm > 0          ? o->flux_lm
                        : o->output_flux_lm > 0 ? o->output_flux_lm * r->tally.emitted / r->tally.escaped
                                                : b->tracer->flux;
    if (!isfinite(flux))
        return lmg_fail(err, LMG_ERROR_INPUT, "%s: no light leaves the luminaire", b->model->path);
    r->flux_lm = flux;
    r->lumens_per_photon = flux / (double)r->tally.photons;
    r->refused = lmg_accumulator_totals(b->accumulator).refused;
    const lmg_ledger ledger = balance(b);
    const double reconstruct_began = bake_clock();
    result = lmg_field_reconstruct(b->accumulator, r->lumens_per_photon, &ledger, out, err);
    if (result == LMG_OK)
        result = add_texts(b, *out, err);
    r->reconstruct_seconds = bake_clock() - reconstruct_began;
    return result;
}

lmg_result bake_run(const struct lum_model *model, const bake_options *options, lmg_field **out, bake_report *report,
                    lmg_error *err)
{
    *out = NULL;
    memset(report, 0, sizeof(*report));
    bake b = {.model = model, .options = options, .report = report};
    const lmg_result result = bake_all(&b, out, err);
    if (result != LMG_OK) {
        lmg_field_destroy(*out);
        *out = NULL;
    }
    lmg_accumulator_destroy(b.accumulator);
    bake_ray_list_destroy(b.pilot);
    if (b.tracer)
        b.tracer->destroy(b.tracer);
    return result;
}
