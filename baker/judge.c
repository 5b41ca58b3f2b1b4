/* SPDX-License-Identifier: Apache-2.0 */
/* The judge of boxes: the receivers of the comparison (compare.c), fed by the lamp once and by each box. */
#include "judge.h"

#include "compare_inside.h"

#include <luminaires/model.h>
#include <luminaires/rng.h>

#include <math.h>
#include <stdlib.h>

static const double DISTANCES[JUDGE_DISTANCES] = {0.5, 1, 2, 5, 10};

struct judge {
    bake_source *lamp;
    uint64_t seed;
    unsigned threads;
    double size;
    lmg_vec3 axis;
    instrument instrument;
    measured reference;
};

const char *judge_measure_name(judge_measure m)
{
    static const char *const NAMES[JUDGE_MEASURES] = {"near-field illuminance", "far-field intensity", "luminance pictures"};
    return NAMES[m];
}

lmg_result judge_create(const struct lum_model *model, uint64_t seed, double flux_lm, unsigned threads, judge **out, lmg_error *err)
{
    *out = NULL;
    judge *j = calloc(1, sizeof(*j));
    if (!j)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory to judge boxes");
    j->seed = seed;
    j->threads = threads;
    /* Seeds apart from the bakes': what judges shares no photon with what it judges. */
    lmg_result result = bake_tracer_create(model, lum_mix64(seed + 0x61), &j->lamp, err);
    if (result == LMG_OK && flux_lm > 0)
        j->lamp->flux = flux_lm;
    if (result == LMG_OK)
        result = bake_source_size(j->lamp, threads, &j->size, err);
    if (result == LMG_OK)
        result = source_main_axis(j->lamp, threads, &j->axis, err);
    if (result != LMG_OK) {
        judge_destroy(j);
        return result;
    }
    set_up_instrument(&j->instrument, j->lamp->bounds_min, j->lamp->bounds_max, j->axis, j->size, DISTANCES, JUDGE_DISTANCES);
    *out = j;
    return LMG_OK;
}

void judge_destroy(judge *j)
{
    if (!j)
        return;
    measured_release(&j->reference);
    if (j->lamp)
        j->lamp->destroy(j->lamp);
    free(j);
}

lmg_result judge_measure_lamp(judge *j, uint64_t photons, lmg_error *err)
{
    measured_release(&j->reference);
    bake_tally tally = {0};
    lmg_result result = measure_source(j->lamp, &j->instrument, JUDGE_DISTANCES + RECEIVERS, &BAKE_NO_MOTION, 0, photons, j->threads,
                                       &j->reference, NULL, &tally, err);
    if (result == LMG_OK && !(tally.escaped > 0))
        result = lmg_fail(err, LMG_ERROR_INPUT, "no light leaves the luminaire");
    return result;
}

/* The receivers of a measure: first and how many. */
static size_t receivers_of(judge_measure m, size_t *first)
{
    *first = m == JUDGE_NEAR ? 0 : JUDGE_DISTANCES + (size_t)(m == JUDGE_FAR ? FAR_FIELD : PICTURES);
    return m == JUDGE_NEAR ? JUDGE_DISTANCES : m == JUDGE_FAR ? 1 : BAKE_VIEWS;
}

double judge_noise(const judge *j, judge_measure m)
{
    size_t first;
    const size_t count = receivers_of(m, &first);
    double sum = 0;
    for (size_t i = 0; i < count; ++i) {
        const double noise = differ(&j->reference.of[first + i], &j->reference.of[first + i]).noise;
        sum += noise * noise / 2 / (double)count; /* differ takes its two sides as independent */
    }
    return sqrt(sum);
}

/* The root of the mean of the squares of several errors; those of receivers that the lamp sends no light to are no numbers and don't count. */
static judge_error together(const judge_error *e, size_t all)
{
    double sum = 0, variance = 0, count = 0;
    for (size_t i = 0; i < all; ++i)
        count += isfinite(e[i].rms) ? 1 : 0;
    for (size_t i = 0; i < all; ++i) {
        if (!isfinite(e[i].rms))
            continue;
        sum += e[i].rms * fabs(e[i].rms) / count;
        variance += 4 * e[i].rms * e[i].rms * e[i].standard_error * e[i].standard_error / (count * count);
    }
    if (!(count > 0))
        return (judge_error){NAN, NAN};
    const double rms = sum >= 0 ? sqrt(sum) : -sqrt(-sum);
    return (judge_error){rms, rms != 0 ? sqrt(variance) / (2 * fabs(rms)) : 0};
}

lmg_result judge_box(const judge *j, const lmg_field *field, uint64_t rays, judge_verdict *out, lmg_error *err)
{
    bake_source *box;
    lmg_result result = bake_box_source_create(field, lum_mix64(j->seed + 0x62), &box, err);
    if (result != LMG_OK)
        return result;
    measured m = {0};
    bake_tally tally = {0};
    result = measure_source(box, &j->instrument, JUDGE_DISTANCES + RECEIVERS, &BAKE_NO_MOTION, 0, rays, j->threads, &m, NULL, &tally, err);
    for (int k = 0; result == LMG_OK && k < JUDGE_MEASURES; ++k) {
        judge_error each[JUDGE_DISTANCES + BAKE_VIEWS]; /* more than any measure has */
        size_t first;
        const size_t count = receivers_of((judge_measure)k, &first);
        for (size_t i = 0; i < count; ++i) {
            const bake_difference d = differ(&m.of[first + i], &j->reference.of[first + i]);
            each[i] = (judge_error){d.rms, d.standard_error};
            if (k == JUDGE_NEAR)
                out->planes[i] = each[i];
        }
        out->error[k] = together(each, count);
    }
    measured_release(&m);
    box->destroy(box);
    return result;
}

double judge_size(const judge *j)
{
    return j->size;
}

lmg_vec3 judge_axis(const judge *j)
{
    return j->axis;
}

bake_source *judge_lamp(const judge *j)
{
    return j->lamp;
}
