/* SPDX-License-Identifier: Apache-2.0 */
#include "bake_trees.h"

#include "parallel.h"

#include <math.h>
#include <stdio.h>

/* Rays for trees are traced once more in rounds of so many photons, so that Ctrl-C is heard. */
static const uint64_t TREE_ROUND = 200000;
/* Seconds of a processor, about, that growing a tree takes for each ray and each look, and that drawing a look takes beside tracing it; and
 * the most that trees, and looks alone, take of a bake by time. */
static const double TREE_SECONDS = 3.2e-7, LOOK_TREE_SECONDS = 4.5e-7, LOOK_SECONDS = 1.2e-6, MOST_FOR_TREES = 0.5, MOST_FOR_LOOKS = 0.4;
/* Twice the looks divide the error of radiance by 1.07 (panel) to 1.16 (lens). */
static const double LOOKS_PER_PHOTON = 2;
/* Variance of a look over that of a photon, beyond which looks aren't worth their time: with 18 the opal globe's trees are a little worse. */
static const double MOST_LOOK_NOISE = 0.5;
static const uint64_t NOISE_PHOTONS = 8192;

static bool stopped(const bake_trees *t)
{
    return t->options->stop && *t->options->stop;
}

/* Seconds that a look takes with all that hangs on it; rate: photons per second. */
static double look_seconds(const bake_options *o, double rate)
{
    const double threads = bake_thread_count(o->threads), turns = ceil(o->trees / fmin(threads, o->trees));
    return 1 / rate + LOOK_SECONDS / threads + turns * LOOK_TREE_SECONDS;
}

static double pilot_rate(const bake_trees *t)
{
    return (double)t->part->pilot_photons / fmax(t->report->pilot_seconds, 1e-6);
}

/* How many looks the trees are grown of, at most: as many as are asked for, none where an eye that looks into the lamp sees nothing or too
 * much noise, and no more than a part of a bake by time can trace. */
static void decide_looks(bake_trees *t, double seconds)
{
    const bake_options *o = t->options;
    char *why = t->report->no_looks_why;
    const size_t room = sizeof(t->report->no_looks_why);
    const char *obstacle;
    t->most_looks = o->looks;
    if (o->trees == 0 || o->looks_chosen)
        return;
    if (!bake_tracer_can_look(t->tracer, &obstacle)) {
        snprintf(why, room, "rays can't be traced backwards through a lamp with %s", obstacle);
        return;
    }
    bake_ray_list *list;
    lmg_error err = {.message = ""};
    double noise = 0;
    lmg_result result = bake_ray_list_create(NOISE_PHOTONS, &list, &err);
    if (result == LMG_OK) {
        const lmg_sink sink = bake_ray_list_sink(list);
        bake_tally tally = {0};
        result = t->tracer->run(t->tracer, BAKE_PILOT_FIRST, NOISE_PHOTONS, o->threads, &sink, 1, &tally, &err);
        size_t count;
        const lmg_ray *rays = bake_ray_list_sorted(list, &count);
        if (result == LMG_OK)
            result = bake_ray_list_check(list, &err);
        if (result == LMG_OK)
            result = bake_look_noise(t->tracer, rays, count, &noise, &err);
        bake_ray_list_destroy(list);
    }
    if (result != LMG_OK)
        snprintf(why, room, "%s", err.message);
    else if (isinf(noise))
        snprintf(why, room, "paths traced backwards find none of this lamp's light");
    else if (noise > MOST_LOOK_NOISE)
        snprintf(why, room, "what an eye sees in this lamp has %.2g times the variance of a photon", noise);
    else
        t->most_looks = BAKE_MOST_LOOKS;
    if (t->most_looks > 0 && o->photons == 0)
        t->most_looks = (uint64_t)fmin((double)t->most_looks, MOST_FOR_LOOKS * seconds / look_seconds(o, pilot_rate(t)));
}

uint64_t bake_trees_photons(const bake_trees *t)
{
    return t->most_looks > 0 ? BAKE_LOOKED_PHOTONS : BAKE_TREE_PHOTONS;
}

/* Has the rays of the bake's first photons kept for trees while they are traced; where others trace some of them, or have, they are traced
 * once more in the end. */
static lmg_result keep_rays(bake_trees *t, lmg_error *err)
{
    const bake_options *o = t->options;
    if (o->trees == 0 || t->report->resumed || o->team)
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
    decide_looks(t, seconds);
    return keep_rays(t, err);
}

/* Refines the trees by what is seen inside the lamp; they stay as they are if somebody says stop. */
static lmg_result look_into(const bake_trees *t, lmg_field *field, lmg_error *err)
{
    const bake_options *o = t->options;
    const double photons = (double)t->part->tally.photons;
    const uint64_t count = o->looks_chosen ? o->looks : (uint64_t)fmin(LOOKS_PER_PHOTON * photons, (double)t->most_looks);
    lmg_looks *looks;
    if (count == 0)
        return LMG_OK;
    lmg_result result = lmg_looks_create(field, (size_t)count, o->seed, &looks, err);
    if (result != LMG_OK)
        return result;
    result = bake_look_run(t->tracer, looks, t->report->flux_lm, o->threads, o->stop, err);
    if (result == LMG_OK && !stopped(t))
        result = lmg_field_refine_trees(field, looks, err);
    lmg_looks_destroy(looks);
    return result;
}

void bake_trees_grow(bake_trees *t, lmg_field *field)
{
    const bake_options *o = t->options;
    bake_report *r = t->report;
    if (o->trees == 0)
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
            result = lmg_field_grow_trees(field, rays, count, o->trees, &why);
        if (result == LMG_OK && look_into(t, field, &why) != LMG_OK)
            snprintf(r->no_looks_why, sizeof(r->no_looks_why), "%s", why.message);
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
    const bake_options *o = t->options;
    if (o->trees == 0)
        return 0;
    const double rate = pilot_rate(t), turns = ceil(o->trees / fmin(bake_thread_count(o->threads), o->trees));
    const double photons = fmin(rate * seconds, (double)bake_trees_photons(t)) * turns * TREE_SECONDS / seconds;
    /* of each second so much goes to the looks of the photons that the rest traces, as long as there are no more than the most */
    const double each = look_seconds(o, rate), looks = LOOKS_PER_PHOTON * rate * each;
    return fmin(photons + fmin(looks / (1 + looks), (double)t->most_looks * each / seconds), MOST_FOR_TREES);
}
