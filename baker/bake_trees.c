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
/* As many trees grow at once as there are processors, up to so many. */
static const double MOST_AT_ONCE = 16;
/* What trees may take of a bake by time, asked for or not, and of a file; and of both at least what is left for looks. */
static const double TIME_FOR_TREES = 0.5, TIME_FOR_TREES_UNASKED = 0.25, SIZE_FOR_TREES = 1.0 / 3, LEAST_FOR_LOOKS = 0.3;
/* Bytes that a ray and a look come to in a tree: 0.05 to 0.07 a look (spot, globe). */
static const double RAY_BYTES = 0.06, LOOK_BYTES = 0.07;
/* Twice the looks divide the error of radiance by 1.07 (panel) to 1.16 (lens). */
static const double LOOKS_PER_PHOTON = 2;
/* Variance of a look over that of a photon, beyond which looks tell outlines only: with 18 the opal globe's trees are a little worse. */
static const double MOST_LOOK_NOISE = 0.5;
static const uint64_t NOISE_PHOTONS = 8192;
/* Outlines are worth their time where so much of radiance, RMS, as trees of so many pilot photons have it, lies beyond them
 * (lmg_looks_misplaced): phosphor LED 0.0004, spot 0.04, opal ball 0.16, opal globe 0.18; so many looks tell. */
static const double LEAST_MISPLACED = 0.1;
static const uint64_t OUTLINE_PHOTONS = 100000, FEW_LOOKS = 100000;

static bool stopped(const bake_trees *t)
{
    return t->options->stop && *t->options->stop;
}

/* Photons a second, as far as it is known. */
static double rate(const bake_trees *t)
{
    if (t->report->resumed)
        return (double)t->part->tally.photons / fmax(t->part->seconds, 1e-6);
    return (double)t->part->pilot_photons / fmax(t->report->pilot_seconds, 1e-6);
}

/* Rays are kept as they are traced, unless others trace some of them, or have: then they are traced once more in the end. */
static bool keeps_rays(const bake_trees *t)
{
    return !t->report->resumed && !t->options->team;
}

static double turns(const bake_trees *t)
{
    return ceil(t->count / fmin(bake_thread_count(0), fmin(t->count, MOST_AT_ONCE)));
}

/* Seconds that a photon's rays take in trees. */
static double photon_seconds(const bake_trees *t)
{
    return turns(t) * TREE_SECONDS + RAY_SECONDS + (keeps_rays(t) ? 0 : 1 / rate(t));
}

/* Seconds that a look takes with all that hangs on it.  A path backwards takes about as long as a photon; an outline is its first ray. */
static double look_seconds(const bake_trees *t)
{
    return (t->kind == LMG_LOOK_RADIANCE ? 1 / rate(t) : 0) + LOOK_SECONDS / bake_thread_count(t->options->threads) +
           turns(t) * LOOK_TREE_SECONDS;
}

/* Looks of a bake of so many photons. */
static double looks_for(const bake_trees *t, double photons)
{
    return t->options->looks_chosen ? (double)t->options->looks : fmin(LOOKS_PER_PHOTON * photons, (double)t->most_looks);
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

/* Draws looks that tell outlines from the field's trees: how bright which surface is, *brightness, the caller's, and, unless NULL, how much of
 * the trees' radiance is where none is expected. */
static lmg_result survey(const bake_trees *t, const lmg_field *field, const lmg_ray *rays, size_t count, float **brightness,
                         double *misplaced, lmg_error *err)
{
    const bake_options *o = t->options;
    lmg_looks *looks;
    lmg_result result = lmg_looks_create(field, LMG_LOOK_OUTLINE, FEW_LOOKS, o->seed, &looks, err);
    if (result == LMG_OK)
        result = bake_look_brightness(t->tracer, looks, rays, count, o->threads, brightness, err);
    if (result == LMG_OK && misplaced)
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
    const bool wanted = (o->looks_chosen && o->looks > 0) || (o->photons > 0 ? o->photons >= BAKE_TREES_FROM : seconds >= BAKE_TREES_SECONDS);
    return wanted ? BAKE_TREES : 0;
}

double bake_trees_leave(double bytes)
{
    return (1 - SIZE_FOR_TREES) * bytes;
}

/* No more photons and looks than such a share of something, of which each takes so much. */
static void limit(bake_trees *t, double share, double photon, double look)
{
    t->most_photons = (uint64_t)fmin((double)t->most_photons, (1 - LEAST_FOR_LOOKS) * share / photon);
    t->most_looks = (uint64_t)fmin((double)t->most_looks, (share - (double)t->most_photons * photon) / look);
}

/* How many photons and looks the trees are grown of, at most: no more than a part of a bake by time can trace, or a part of the file hold. */
static void decide_most(bake_trees *t, double seconds)
{
    const bake_options *o = t->options;
    const bool some = (!o->looks_chosen || o->looks > 0) && decide_kind(t);
    t->most_looks = some ? BAKE_MOST_LOOKS : 0;
    t->most_photons = some && t->kind == LMG_LOOK_RADIANCE ? BAKE_LOOKED_PHOTONS : BAKE_TREE_PHOTONS;
    if (o->photons == 0)
        limit(t, (o->trees == BAKE_TREES_AUTO ? TIME_FOR_TREES_UNASKED : TIME_FOR_TREES) * seconds, photon_seconds(t), look_seconds(t));
    if (o->size > 0) /* else there is room for the most */
        limit(t, SIZE_FOR_TREES * o->size, t->count * RAY_BYTES, t->count * LOOK_BYTES);
}

static lmg_result trace_rays(bake_trees *t, lmg_error *err)
{
    const bake_options *o = t->options;
    const uint64_t all = t->part->tally.photons, wanted = all < t->most_photons ? all : t->most_photons;
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
    const bake_options *o = t->options;
    const double whole = fmax(seconds, t->part->seconds); /* a bake that is resumed for a moment is as long as it was */
    t->count = bake_trees_wanted(o, whole);
    if (t->count == 0)
        return LMG_OK;
    decide_most(t, whole);
    if (!keeps_rays(t))
        return LMG_OK;
    const uint64_t most = o->photons > 0 && o->photons < t->most_photons ? o->photons : t->most_photons;
    return bake_ray_list_create((size_t)most + 1024, &t->kept, err);
}

/* Refines the trees by what is seen of the lamp; they stay as they are if somebody says stop.  The rays aren't needed for that but where
 * outlines ask them how bright surfaces are. */
static lmg_result look_into(bake_trees *t, lmg_field *field, lmg_error *err)
{
    const bake_options *o = t->options;
    const uint64_t looks_wanted = (uint64_t)looks_for(t, (double)t->part->tally.photons);
    float *brightness = NULL;
    lmg_looks *looks = NULL;
    lmg_result result = LMG_OK;
    if (looks_wanted > 0 && t->kind == LMG_LOOK_OUTLINE) {
        size_t count;
        const lmg_ray *rays = bake_ray_list_sorted(t->kept, &count);
        result = survey(t, field, rays, count, &brightness, NULL, err);
    }
    bake_ray_list_destroy(t->kept);
    t->kept = NULL;
    if (result == LMG_OK && looks_wanted > 0 && !stopped(t)) {
        result = lmg_looks_create(field, t->kind, (size_t)looks_wanted, o->seed, &looks, err);
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
        if (result == LMG_OK && look_into(t, field, &why) != LMG_OK)
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

double bake_trees_tracing(const bake_trees *t, double left)
{
    if (t->count == 0)
        return left;
    double least = 0, most = left; /* the more is traced, the longer trees take */
    for (int i = 0; i < 40; ++i) {
        const double tracing = 0.5 * (least + most), photons = (double)t->part->tally.photons + rate(t) * tracing;
        const double growing = fmin(photons, (double)t->most_photons) * photon_seconds(t) + looks_for(t, photons) * look_seconds(t);
        *(tracing + growing < left ? &least : &most) = tracing;
    }
    return least;
}
