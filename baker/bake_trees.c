/* SPDX-License-Identifier: Apache-2.0 */
#include "bake_trees.h"

#include "look.h"
#include "parallel.h"
#include "tracer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* Rays for trees are traced once more in rounds of so many photons, so that Ctrl-C is heard. */
static const uint64_t TREE_ROUND = 200000;
/* Seconds, about: of a processor, that growing a tree takes for each ray and each look, and that drawing a look takes beside tracing it; on one
 * thread, that sorting and placing a ray takes. */
static const double TREE_SECONDS = 2.2e-7, LOOK_TREE_SECONDS = 2.3e-7, LOOK_SECONDS = 9e-7, RAY_SECONDS = 4e-7;
/* The most that trees take of a bake by time, asked for or not; the least of that for looks; and what they take at all events. */
static const double MOST_FOR_TREES = 0.5, MOST_FOR_TREES_UNASKED = 0.25, LEAST_FOR_LOOKS = 0.3, MOST_AT_ALL = 0.7;
/* Of a file as large as it may be: what trees may take; and the bytes that a look comes to in a tree: 0.05 (spot, 8 M looks) to 0.07 (globe). */
static const double SIZE_FOR_TREES = 1.0 / 3, LOOK_BYTES = 0.07;
/* Twice the looks divide the error of radiance by 1.07 (panel) to 1.16 (lens). */
static const double LOOKS_PER_PHOTON = 2;
/* Variance of a look over that of a photon, beyond which looks tell outlines only: with 18 the opal globe's trees are a little worse. */
static const double MOST_LOOK_NOISE = 0.5;
static const uint64_t NOISE_PHOTONS = 8192;
/* Outlines are worth their time where so much of radiance, RMS, as trees of so many pilot photons have it, lies beyond them
 * (lmg_looks_misplaced): phosphor LED 0.05, opal globe 0.21, opal ball 0.16; so many looks tell. */
static const double LEAST_MISPLACED = 0.1;
static const uint64_t OUTLINE_PHOTONS = 100000, FEW_LOOKS = 100000;

static bool stopped(const bake_trees *t)
{
    return t->options->stop && *t->options->stop;
}

static double pilot_rate(const bake_trees *t)
{
    return (double)t->part->pilot_photons / fmax(t->report->pilot_seconds, 1e-6);
}

static double turns(const bake_trees *t)
{
    return ceil(t->count / fmin(bake_thread_count(t->options->threads), t->count));
}

/* Seconds that trees take of photons alone. */
static double rays_seconds(const bake_trees *t, double seconds)
{
    return fmin(pilot_rate(t) * seconds, (double)bake_trees_photons(t)) * (turns(t) * TREE_SECONDS + RAY_SECONDS);
}

/* Seconds that a look takes with all that hangs on it.  A path backwards takes about as long as a photon; an outline is its first ray. */
static double look_seconds(const bake_trees *t)
{
    return (t->kind == LMG_LOOK_RADIANCE ? 1 / pilot_rate(t) : 0) + LOOK_SECONDS / bake_thread_count(t->options->threads) +
           turns(t) * LOOK_TREE_SECONDS;
}

/* Rays of so many pilot photons; *list: the caller's to destroy. */
static lmg_result trace_pilot(const bake_trees *t, uint64_t photons, bake_ray_list **list, const lmg_ray **rays, size_t *count, lmg_error *err)
{
    lmg_result result = bake_ray_list_create(photons, list, err);
    if (result != LMG_OK)
        return result;
    const lmg_sink sink = bake_ray_list_sink(*list);
    bake_tally tally = {0};
    result = t->tracer->run(t->tracer, BAKE_PILOT_FIRST, photons, t->options->threads, &sink, 1, &tally, err);
    *rays = bake_ray_list_sorted(*list, count);
    return result == LMG_OK ? bake_ray_list_check(*list, err) : result;
}

/* The variance of a look, of pilot photons (bake_look_noise). */
static lmg_result pilot_noise(const bake_trees *t, double *noise, lmg_error *err)
{
    bake_ray_list *list = NULL;
    const lmg_ray *rays;
    size_t count;
    lmg_result result = trace_pilot(t, NOISE_PHOTONS, &list, &rays, &count, err);
    if (result == LMG_OK)
        result = bake_look_noise(t->tracer, rays, count, noise, err);
    bake_ray_list_destroy(list);
    return result;
}

/* Draws looks that tell outlines from the field's trees: how bright which surface is, *brightness, the caller's, and how much of the trees'
 * radiance is where less is expected. */
static lmg_result survey(const bake_trees *t, const lmg_field *field, const lmg_ray *rays, size_t count, float **brightness,
                         double *misplaced, lmg_error *err)
{
    const bake_options *o = t->options;
    lmg_looks *looks;
    lmg_result result = lmg_looks_create(field, LMG_LOOK_OUTLINE, FEW_LOOKS, o->seed, &looks, err);
    if (result == LMG_OK)
        result = bake_look_brightness(t->tracer, looks, rays, count, o->threads, brightness, err);
    if (result == LMG_OK)
        *misplaced = lmg_looks_misplaced(looks);
    lmg_looks_destroy(looks);
    return result;
}

/* How much of radiance outlines would move, as trees of some pilot photons have it. */
static lmg_result pilot_misplaced(const bake_trees *t, double *misplaced, lmg_error *err)
{
    bake_ray_list *list = NULL;
    const lmg_ray *rays;
    size_t count;
    lmg_accumulator *accumulator = NULL;
    lmg_field *field = NULL;
    float *brightness = NULL;
    lmg_layout layout = *lmg_accumulator_layout(t->part->accumulator);
    for (uint32_t i = 0; i < layout.slab_count; ++i) /* trees don't ask the cells */
        layout.slabs[i].nu = layout.slabs[i].nv = layout.slabs[i].ns = layout.slabs[i].nt = 2;
    lmg_result result = trace_pilot(t, OUTLINE_PHOTONS, &list, &rays, &count, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &accumulator, err);
    if (result == LMG_OK) {
        lmg_accumulator_deposit(accumulator, rays, count);
        result = lmg_field_reconstruct(accumulator, 1, NULL, &field, err);
    }
    if (result == LMG_OK)
        result = lmg_field_grow_trees(field, rays, count, 2, err);
    if (result == LMG_OK)
        result = survey(t, field, rays, count, &brightness, misplaced, err);
    free(brightness);
    lmg_field_destroy(field);
    lmg_accumulator_destroy(accumulator);
    bake_ray_list_destroy(list);
    return result;
}

/* What looks tell of this lamp: radiance, or outlines where an eye that looks into it sees nothing or too much noise.  False: neither. */
static bool decide_kind(bake_trees *t)
{
    char *why = t->report->looks_why;
    const size_t room = sizeof(t->report->looks_why);
    const char *obstacle;
    double noise = 0;
    lmg_error err = {.message = ""};
    t->kind = LMG_LOOK_OUTLINE;
    if (!bake_tracer_can_look(t->tracer, &obstacle))
        snprintf(why, room, "outlines only: paths can't be traced backwards through a lamp with %s", obstacle);
    else if (pilot_noise(t, &noise, &err) != LMG_OK)
        snprintf(why, room, "outlines only: %s", err.message);
    else if (isinf(noise))
        snprintf(why, room, "outlines only: paths traced backwards find none of this lamp's light");
    else if (noise > MOST_LOOK_NOISE)
        snprintf(why, room, "outlines only: what an eye sees in this lamp has %.2g times the variance of a photon", noise);
    else {
        t->kind = LMG_LOOK_RADIANCE;
        return true;
    }
    double misplaced;
    if (!bake_tracer_has_outline(t->tracer, &obstacle))
        snprintf(why, room, "none: nothing can be seen of a lamp with %s by rays traced backwards", obstacle);
    else if (t->options->looks_chosen)
        return true;
    else if (pilot_misplaced(t, &misplaced, &err) != LMG_OK)
        snprintf(why, room, "none: %s", err.message);
    else if (misplaced < LEAST_MISPLACED)
        snprintf(why, room, "none: paths would tell outlines only, beyond which there is hardly any radiance (%.2g %%, RMS)", 100 * misplaced);
    else
        return true;
    return false;
}

uint32_t bake_trees_wanted(const bake_options *o, double seconds)
{
    if (o->trees != BAKE_TREES_AUTO)
        return o->trees;
    return o->photons > 0 ? o->photons >= BAKE_TREES_FROM ? BAKE_TREES : 0 : seconds >= BAKE_TREES_SECONDS ? BAKE_TREES : 0;
}

double bake_trees_leave(double bytes)
{
    return (1 - SIZE_FOR_TREES) * bytes;
}

static double most_of_time(const bake_trees *t)
{
    return t->options->trees == BAKE_TREES_AUTO ? MOST_FOR_TREES_UNASKED : MOST_FOR_TREES;
}

/* How many looks the trees are grown of, at most: as many as are asked for, and no more than a part of a bake by time can trace, or a part of
 * the file hold. */
static void decide_looks(bake_trees *t, double seconds)
{
    const bake_options *o = t->options;
    t->most_looks = o->looks;
    if (t->count == 0 || (o->looks_chosen && o->looks == 0))
        return;
    const bool some = decide_kind(t);
    if (o->looks_chosen)
        return;
    t->most_looks = some ? BAKE_MOST_LOOKS : 0;
    if (o->size > 0) /* else there is room for the most */
        t->most_looks = (uint64_t)fmin((double)t->most_looks, SIZE_FOR_TREES * o->size / (LOOK_BYTES * t->count));
    if (some && o->photons == 0) {
        const double most = most_of_time(t) * seconds, looks = fmax(most - rays_seconds(t, seconds), LEAST_FOR_LOOKS * most);
        t->most_looks = (uint64_t)fmin((double)t->most_looks, looks / look_seconds(t));
    }
}

uint64_t bake_trees_photons(const bake_trees *t)
{
    return t->most_looks > 0 && t->kind == LMG_LOOK_RADIANCE ? BAKE_LOOKED_PHOTONS : BAKE_TREE_PHOTONS;
}

/* Has the rays of the bake's first photons kept for trees while they are traced; where others trace some of them, or have, they are traced
 * once more in the end. */
static lmg_result keep_rays(bake_trees *t, lmg_error *err)
{
    const bake_options *o = t->options;
    if (t->count == 0 || t->report->resumed || o->team)
        return LMG_OK;
    const uint64_t all = bake_trees_photons(t), most = o->photons > 0 && o->photons < all ? o->photons : all;
    return bake_ray_list_create((size_t)most + 1024, &t->kept, err);
}

static lmg_result trace_rays(bake_trees *t, lmg_error *err)
{
    const bake_options *o = t->options;
    const uint64_t all = t->part->tally.photons, most = bake_trees_photons(t), wanted = all < most ? all : most;
    lmg_result result = bake_ray_list_create((size_t)wanted + 1024, &t->kept, err);
    const lmg_sink sink = t->kept ? bake_ray_list_sink(t->kept) : (lmg_sink){0};
    bake_tally tally = {0};
    while (result == LMG_OK && tally.photons < wanted && !stopped(t)) {
        const uint64_t left = wanted - tally.photons;
        result = t->tracer->run(t->tracer, o->first + tally.photons, left < TREE_ROUND ? left : TREE_ROUND, o->threads, &sink, 1, &tally, err);
    }
    return result;
}

lmg_result bake_trees_begin(bake_trees *t, double seconds, lmg_error *err)
{
    t->count = bake_trees_wanted(t->options, seconds);
    decide_looks(t, seconds);
    return keep_rays(t, err);
}

/* Refines the trees by what is seen of the lamp; they stay as they are if somebody says stop. */
static lmg_result look_into(const bake_trees *t, lmg_field *field, const lmg_ray *rays, size_t ray_count, lmg_error *err)
{
    const bake_options *o = t->options;
    const double photons = (double)t->part->tally.photons;
    const uint64_t count = o->looks_chosen ? o->looks : (uint64_t)fmin(LOOKS_PER_PHOTON * photons, (double)t->most_looks);
    double misplaced;
    float *brightness = NULL;
    lmg_looks *looks = NULL;
    lmg_result result = LMG_OK;
    if (count > 0 && t->kind == LMG_LOOK_OUTLINE)
        result = survey(t, field, rays, ray_count, &brightness, &misplaced, err);
    if (result == LMG_OK && count > 0 && !stopped(t)) {
        result = lmg_looks_create(field, t->kind, (size_t)count, o->seed, &looks, err);
        if (result == LMG_OK)
            result = bake_look_run(t->tracer, looks, brightness, t->report->flux_lm, o->threads, o->stop, err);
        if (result == LMG_OK && !stopped(t))
            result = lmg_field_refine_trees(field, looks, err);
    }
    lmg_looks_destroy(looks);
    free(brightness);
    return result;
}

void bake_trees_grow(bake_trees *t, lmg_field *field)
{
    bake_report *r = t->report;
    if (t->count == 0)
        return;
    const double began = bake_clock();
    lmg_error why = {.message = ""};
    lmg_result result = LMG_OK;
    if (!t->kept && !r->interrupted)
        result = trace_rays(t, &why);
    if (result == LMG_OK && !r->interrupted && !stopped(t)) {
        result = bake_ray_list_check(t->kept, &why);
        size_t count;
        const lmg_ray *rays = bake_ray_list_sorted(t->kept, &count);
        if (result == LMG_OK)
            result = lmg_field_grow_trees(field, rays, count, t->count, &why);
        if (result == LMG_OK && look_into(t, field, rays, count, &why) != LMG_OK)
            snprintf(r->looks_why, sizeof(r->looks_why), "none: %s", why.message);
    }
    r->trees_seconds = bake_clock() - began;
    const bool looked = lmg_field_trees(field).looks > 0;
    if (result == LMG_OK && !r->interrupted && (looked || !stopped(t)))
        return;
    lmg_field_grow_trees(field, NULL, 0, 0, NULL);
    snprintf(r->no_trees_why, sizeof(r->no_trees_why), "%s", result != LMG_OK ? why.message : "interrupted");
    r->interrupted = r->interrupted || result == LMG_OK;
}

double bake_trees_share(const bake_trees *t, double seconds)
{
    if (t->count == 0)
        return 0;
    /* of each second so much goes to the looks of the photons that the rest traces, as long as there are no more than the most */
    const double each = look_seconds(t), looks = LOOKS_PER_PHOTON * pilot_rate(t) * each;
    return fmin(rays_seconds(t, seconds) / seconds + fmin(looks / (1 + looks), (double)t->most_looks * each / seconds), MOST_AT_ALL);
}
