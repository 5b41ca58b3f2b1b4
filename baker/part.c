/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Parts of a bake: which photons they have, whether they belong together, their sum, and their box.  Everything that makes a box out of
 * counts is here and looks at the part alone, so that a straight bake, a resumed and a merged one can't differ.
 */
#include "part.h"

#include "bake.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Names as boxes carry them (docs/format.md), and what to say when parts differ in them. */
static const struct {
    const char *name, *remedy;
} TEXTS[PART_TEXT_COUNT] = {
    [PART_SOFTWARE] = {"software", "photons of other versions may go other ways"},
    [PART_RECIPE] = {"recipe", "bake all parts with one recipe"},
    [PART_SETTINGS] = {"settings", "bake all parts with the same options"},
    [PART_MODEL_HASH] = {"model_hash", "they are of different lamps, or the model was edited in between"},
    [PART_SEED] = {"seed", "parts of a bake share the seed and differ in their photon numbers (--share, --first)"},
    [PART_PILOT_PHOTONS] = {"pilot_photons", "bake all parts with the same --pilot, or as --share K/N of one bake"},
    [PART_EFFECTS] = {"effects", "bake all parts with the same program, --effects and --time"},
    [PART_PLAN] = {"effect_plan", "bake all parts with the same program, --effects and --time"},
    [PART_MODEL] = {"model", ""},
    [PART_LAYOUT_WHY] = {"layout_why", ""},
    [PART_GATHER] = {"gather", ""},
    [PART_WARNINGS] = {"warnings", ""},
};

lmg_result bake_part_create(bake_part **out, lmg_error *err)
{
    *out = calloc(1, sizeof(**out));
    return *out ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a part of a bake");
}

void bake_part_destroy(bake_part *part)
{
    if (!part)
        return;
    for (int i = 0; i < PART_TEXT_COUNT; ++i)
        free(part->texts[i]);
    free(part->ranges);
    lmg_accumulator_destroy(part->accumulator);
    free(part);
}

const char *bake_part_text_name(bake_part_text which)
{
    return TEXTS[which].name;
}

lmg_result bake_part_set_text(bake_part *part, bake_part_text which, const char *text, lmg_error *err)
{
    char *copy = text ? strdup(text) : NULL;
    if (text && !copy)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the text '%s' of a bake", TEXTS[which].name);
    free(part->texts[which]);
    part->texts[which] = copy;
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------------------- ranges */

lmg_result bake_part_add_range(bake_part *part, uint64_t first, uint64_t count, lmg_error *err)
{
    if (count == 0)
        return LMG_OK;
    if (count > UINT64_MAX - first)
        return lmg_fail(err, LMG_ERROR_INPUT, "photon numbers beyond 2^64");
    const uint64_t end = first + count;
    size_t i = 0; /* the first range that ends at or behind the new one's start */
    while (i < part->range_count && part->ranges[i].first + part->ranges[i].count < first)
        ++i;
    bake_range *r = part->ranges;
    /* of those that touch it, at most one before and one behind, no other may lie within */
    for (size_t k = i; k < part->range_count && r[k].first < end; ++k)
        if (r[k].first + r[k].count > first)
            return lmg_fail(err, LMG_ERROR_INPUT, "photons %" PRIu64 " to %" PRIu64 " are in both", r[k].first > first ? r[k].first : first,
                            (r[k].first + r[k].count < end ? r[k].first + r[k].count : end) - 1);
    const bool joins_before = i < part->range_count && r[i].first + r[i].count == first;
    const size_t behind = i + joins_before;
    const bool joins_behind = behind < part->range_count && r[behind].first == end;
    if (joins_before && joins_behind) {
        r[i].count += count + r[behind].count;
        memmove(&r[behind], &r[behind + 1], (part->range_count - behind - 1) * sizeof(*r));
        --part->range_count;
    } else if (joins_before) {
        r[i].count += count;
    } else if (joins_behind) {
        r[behind].first = first;
        r[behind].count += count;
    } else {
        r = realloc(r, (part->range_count + 1) * sizeof(*r));
        if (!r)
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for %zu ranges of photons", part->range_count + 1);
        part->ranges = r;
        memmove(&r[i + 1], &r[i], (part->range_count - i) * sizeof(*r));
        r[i] = (bake_range){first, count};
        ++part->range_count;
    }
    return LMG_OK;
}

bool bake_part_gap(const bake_part *part, uint64_t from, uint64_t end, uint64_t *first, uint64_t *count)
{
    for (size_t i = 0; i < part->range_count && part->ranges[i].first < end; ++i) {
        const bake_range r = part->ranges[i];
        if (r.first > from) {
            *first = from;
            *count = r.first - from;
            return true;
        }
        if (r.first + r.count > from)
            from = r.first + r.count;
    }
    *first = from;
    *count = from < end ? end - from : 0;
    return from < end;
}

/* --------------------------------------------------------------------------------------------------------------- merging */

lmg_result bake_part_same_bake(const bake_part *part, const char *name, const bake_part *other, const char *other_name, lmg_error *err)
{
    for (int i = 0; i <= PART_LAST_SHARED; ++i) {
        const char *a = part->texts[i] ? part->texts[i] : "none", *b = other->texts[i] ? other->texts[i] : "none";
        if (strcmp(a, b) != 0)
            return lmg_fail(err, LMG_ERROR_INPUT, "%.100s and %.100s are parts of different bakes: %s %.60s and %.60s; %s", name,
                            other_name, TEXTS[i].name, a, b, TEXTS[i].remedy);
    }
    if (part->source_flux != other->source_flux || part->flux_lm != other->flux_lm || part->output_flux_lm != other->output_flux_lm)
        return lmg_fail(err, LMG_ERROR_INPUT, "%.100s and %.100s are parts of different bakes: their lamps emit different flux", name,
                        other_name);
    return LMG_OK;
}

static void add_tally(bake_tally *sum, const bake_tally *t)
{
    sum->photons += t->photons;
    sum->emitted += t->emitted;
    sum->escaped += t->escaped;
    sum->escaped_squares += t->escaped_squares;
    sum->absorbed += t->absorbed;
    sum->lost += t->lost;
    sum->segments += t->segments;
    sum->lost_inside += t->lost_inside;
}

lmg_result bake_part_merge(bake_part *part, const char *name, const bake_part *other, const char *other_name, lmg_error *err)
{
    lmg_result result = bake_part_same_bake(part, name, other, other_name, err);
    if (result != LMG_OK)
        return result;
    /* on a copy of the ranges first: a conflict may come late in the list */
    bake_part sum = {.range_count = part->range_count, .ranges = malloc((part->range_count + 1) * sizeof(bake_range))};
    if (!sum.ranges)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory to merge %.100s", other_name);
    if (part->range_count > 0)
        memcpy(sum.ranges, part->ranges, part->range_count * sizeof(bake_range));
    lmg_error why;
    for (size_t i = 0; result == LMG_OK && i < other->range_count; ++i)
        result = bake_part_add_range(&sum, other->ranges[i].first, other->ranges[i].count, &why);
    if (result != LMG_OK)
        lmg_fail(err, result, "%.100s and %.100s overlap: %.200s; leave one of them out, or bake it again with another --share or --first",
                 name, other_name, why.message);
    else if (lmg_accumulator_merge(part->accumulator, other->accumulator, &why) != LMG_OK)
        result = lmg_fail(err, LMG_ERROR_INPUT, "%.100s and %.100s are parts of different bakes: their layouts differ", name, other_name);
    if (result != LMG_OK) {
        free(sum.ranges);
        return result;
    }
    free(part->ranges);
    part->ranges = sum.ranges;
    part->range_count = sum.range_count;
    part->seconds += other->seconds;
    add_tally(&part->tally, &other->tally);
    return LMG_OK;
}

/* ----------------------------------------------------------------------------------------------------------------- box */

double bake_part_noise(const bake_part *part)
{
    return part->pilot_noise * sqrt((double)part->pilot_photons / (double)part->tally.photons);
}

lmg_result bake_part_flux(const bake_part *part, double *lumens, lmg_error *err)
{
    *lumens = part->flux_lm > 0          ? part->flux_lm
              : part->output_flux_lm > 0 ? part->output_flux_lm * part->tally.emitted / part->tally.escaped
                                         : part->source_flux;
    return isfinite(*lumens) ? LMG_OK : lmg_fail(err, LMG_ERROR_INPUT, "%s: no light leaves the luminaire", part->texts[PART_MODEL]);
}

/* The balance in lumens.  Shares of N photons have binomial standard errors; what was emitted is known. */
static lmg_ledger balance(const bake_part *part, double flux)
{
    const bake_tally *t = &part->tally;
    const lmg_deposit_totals d = lmg_accumulator_totals(part->accumulator);
    const double n = (double)t->photons, lm = flux / n, all = n * lm;
    const double lost = t->lost + (double)d.refused;
    return (lmg_ledger){
        .photons = t->photons,
        .emitted = all,
        .stored = d.stored * lm,
        .residual = d.residual * lm,
        .absorbed = t->absorbed * lm,
        .lost = lost * lm,
        .stored_se = all * bake_light_error(t, d.stored),
        .residual_se = all * bake_light_error(t, d.residual),
        /* Of photons that all carry the same, any part is binomial; else what is absorbed is what doesn't come out. */
        .absorbed_se = all * (t->escaped_squares > 0 ? bake_light_error(t, t->escaped) : bake_share_error(t->absorbed, n)),
        .lost_se = all * bake_share_error(lost, n),
    };
}

/* The photons' numbers as "0-999,2000-2999", for boxes whose photons aren't 0 .. n-1; "" for the others.  To be freed; NULL = no
 * memory. */
static char *ranges_text(const bake_part *part)
{
    const bool plain = part->range_count == 1 && part->ranges[0].first == 0;
    const size_t each = 2 * 20 + 2, size = part->range_count * each + 1;
    char *text = malloc(size);
    if (!text)
        return NULL;
    text[0] = 0;
    for (size_t i = 0, at = 0; !plain && i < part->range_count; ++i)
        at += (size_t)snprintf(text + at, size - at, "%s%" PRIu64 "-%" PRIu64, i ? "," : "", part->ranges[i].first,
                               part->ranges[i].first + part->ranges[i].count - 1);
    return text;
}

/* Says in the field where it comes from; nothing that depends on the machine, the threads or the date, so that files can be
 * compared. */
static lmg_result add_texts(const bake_part *part, const lmg_gathering *gathering, double gathered, lmg_field *field,
                            lmg_error *err)
{
    char photons[24];
    snprintf(photons, sizeof(photons), "%" PRIu64, part->tally.photons);
    char *ranges = ranges_text(part);
    if (!ranges)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the list of photons");
    lmg_result result = lmg_field_set_text(field, "photons", photons, err);
    if (result == LMG_OK && ranges[0])
        result = lmg_field_set_text(field, "photon_ranges", ranges, err);
    for (int i = 0; result == LMG_OK && i < PART_TEXT_COUNT; ++i)
        if (part->texts[i] && (i != PART_GATHER || gathering))
            result = lmg_field_set_text(field, TEXTS[i].name, part->texts[i], err);
    free(ranges);
    if (result == LMG_OK && gathering) {
        char rays[24], share[24];
        snprintf(rays, sizeof(rays), "%" PRIu64, lmg_gathering_rays(gathering));
        snprintf(share, sizeof(share), "%.4f", gathered);
        result = lmg_field_set_text(field, "gathered_rays", rays, err);
        if (result == LMG_OK)
            result = lmg_field_set_text(field, "gathered_flux", share, err);
    }
    return result;
}

lmg_result bake_part_field(const bake_part *part, const lmg_gathering *gathering, lmg_field **out, lmg_error *err)
{
    *out = NULL;
    if (part->tally.photons == 0)
        return lmg_fail(err, LMG_ERROR_INPUT, "%s: no photons have been traced yet", part->texts[PART_MODEL]);
    double flux;
    lmg_result result = bake_part_flux(part, &flux, err);
    if (result != LMG_OK)
        return result;
    const lmg_ledger ledger = balance(part, flux);
    double gathered;
    result = lmg_field_reconstruct_gathered(part->accumulator, flux / (double)part->tally.photons, &ledger, gathering, out,
                                            &gathered, err);
    if (result == LMG_OK)
        result = add_texts(part, gathering, gathered, *out, err);
    if (result != LMG_OK) {
        lmg_field_destroy(*out);
        *out = NULL;
    }
    return result;
}
