/* SPDX-License-Identifier: Apache-2.0 */
#include "bias.h"

#include "receiver.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdlib.h>

enum { GROUPS = 8, PIXELS = 32, RINGS = 32, SECTORS = 64, BATCH = 1024, PLACES = BIAS_DISTANCES + 1 };

const double BAKE_BIAS_DISTANCE[BIAS_DISTANCES] = {0.5, 1, 2, 5};

static const uint64_t SEED = 0xb1a5;

/* Where readings are taken: of each group of rays, as they are and moved. */
typedef struct readings {
    bake_receiver *of[GROUPS][2];
} readings;

/*
 * The sum over pixels of the squared mean of x, of which the groups' sums are x[g]: |sum x|^2 has the groups' own squares on top of
 * (1 - 1/G) of what is wanted.  A group that is left out (skip) is as if it had never been.
 */
static double square(const double *x, size_t n, int skip)
{
    double all = 0, own = 0;
    int used = 0;
    for (int g = 0; g < GROUPS; ++g)
        used += g != skip;
    for (size_t i = 0; i < n; ++i) {
        double sum = 0;
        for (int g = 0; g < GROUPS; ++g) {
            if (g == skip)
                continue;
            const double v = x[(size_t)g * n + i];
            sum += v;
            own += v * v;
        }
        all += sum * sum;
    }
    return (all - own) / ((double)used * (used - 1));
}

/* RMS change over RMS reading, with a jackknife over the groups. */
static lmg_result evaluate(const readings *r, bake_bias_error *out, lmg_error *err)
{
    const size_t n = bake_receiver_count(r->of[0][0]);
    double *change = malloc(2 * GROUPS * n * sizeof(*change));
    if (!change)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory to measure the bias");
    double *light = change + GROUPS * n;
    for (size_t g = 0; g < GROUPS; ++g)
        for (size_t i = 0; i < n; ++i) {
            light[g * n + i] = bake_receiver_reading(r->of[g][0], i, 1, NULL);
            change[g * n + i] = bake_receiver_reading(r->of[g][1], i, 1, NULL) - light[g * n + i];
        }
    double ratio[GROUPS + 1], mean = 0, variance = 0; /* squares; the last one of all groups */
    for (int g = 0; g <= GROUPS; ++g) {
        const double of_light = square(light, n, g);
        ratio[g] = of_light > 0 ? square(change, n, g) / of_light : 0;
        mean += g < GROUPS ? ratio[g] / GROUPS : 0;
    }
    for (int g = 0; g < GROUPS; ++g)
        variance += (ratio[g] - mean) * (ratio[g] - mean) * (GROUPS - 1) / GROUPS;
    free(change);
    const double error = sqrt(variance), rms = sqrt(fabs(ratio[GROUPS]));
    *out = (bake_bias_error){.rms = ratio[GROUPS] < 0 ? -rms : rms,
                             /* of a root; near zero no more than the root of the square's own error */
                             .standard_error = fmin(rms > 0 ? error / (2 * rms) : (double)INFINITY, sqrt(error))};
    return LMG_OK;
}

static lmg_result create(const lmg_layout *layout, lmg_vec3 axis, readings all[PLACES], lmg_error *err)
{
    lmg_result result = LMG_OK;
    for (int k = 0; k < PLACES; ++k)
        for (int g = 0; g < 2 * GROUPS && result == LMG_OK; ++g) {
            bake_receiver **of = &all[k].of[g / 2][g % 2];
            if (k < BIAS_DISTANCES) {
                const bake_rectangle q = bake_measuring_rectangle(layout->bounds_min, layout->bounds_max, axis, layout->size,
                                                                  BAKE_BIAS_DISTANCE[k] * layout->size, PIXELS);
                result = bake_illuminance_create(&q, of, err);
            } else {
                result = bake_sphere_create(
                    &(bake_sphere){.radius = (double)INFINITY, .axis = axis, .rings = RINGS, .sectors = SECTORS}, of, err);
            }
        }
    return result;
}

static void destroy(readings all[PLACES])
{
    for (int k = 0; k < PLACES; ++k)
        for (int g = 0; g < 2 * GROUPS; ++g)
            bake_receiver_destroy(all[k].of[g / 2][g % 2]);
}

static void give(const readings all[PLACES], int group, int moved, const lmg_ray *rays, size_t count)
{
    for (int k = 0; k < PLACES; ++k) {
        const lmg_sink sink = bake_receiver_sink(all[k].of[group][moved]);
        sink.consume(sink.self, rays, count);
    }
}

lmg_result bake_bias_measure(const lmg_field *field, const lmg_ray *rays, size_t count, bake_bias *out, lmg_error *err)
{
    readings all[PLACES] = {0};
    *out = (bake_bias){0};
    lmg_result result = create(lmg_field_layout(field), bake_main_axis(rays, count), all, err);
    lmg_ray *batch = result == LMG_OK ? malloc(BATCH * sizeof(*batch)) : NULL;
    if (result == LMG_OK && !batch)
        result = lmg_fail(err, LMG_ERROR_MEMORY, "no memory to measure the bias");
    for (int moved = 0; result == LMG_OK && moved < 2; ++moved)
        for (int group = 0; group < GROUPS; ++group) {
            size_t held = 0;
            for (size_t i = 0; i < count; ++i) {
                if (rays[i].number % GROUPS != (uint64_t)group)
                    continue;
                lmg_ray *ray = &batch[held];
                *ray = rays[i];
                if (moved) {
                    lum_rng rng = lum_rng_stream(SEED, ray->number);
                    const double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
                    /* what no slab holds is residual, which the ledger shows; here it stays */
                    lmg_field_redraw(field, &ray->origin, &ray->direction, xi);
                }
                if (++held == BATCH) {
                    give(all, group, moved, batch, held);
                    held = 0;
                }
            }
            give(all, group, moved, batch, held);
        }
    for (int k = 0; result == LMG_OK && k < PLACES; ++k)
        result = evaluate(&all[k], k < BIAS_DISTANCES ? &out->planes[k] : &out->far_field, err);
    free(batch);
    destroy(all);
    return result;
}
