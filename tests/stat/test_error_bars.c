/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Error bars are honest: each sample lamp is baked with 20 seeds into one layout, and what a box reports as standard error is held
 * against how far the 20 boxes spread - for its flux and that of its slabs, far field, illuminance and the radiance of its cells.
 * Aim: 20 %. With k independent readings the ratio of the two is itself uncertain by 1 / sqrt(2 x 19 k): 3 % for 32 of them, but 16
 * % for the flux alone, so three times that is added.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "bake.h"
#include "judge.h"
#include "part.h"

#include <luminaires/model.h>
#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { SEEDS = 20, POINTS = 32, DIRECTIONS = 32, RAYS = 400, PHOTONS = 200000, CELLS = 20000 };

/* Sums over the seeds of one reading. */
typedef struct reading {
    double sum, squares, variances;
} reading;

static void add(reading *r, double value, double error)
{
    r->sum += value;
    r->squares += value * value;
    r->variances += error * error;
}

/* Root of the readings' observed over their reported variance, each reading with the same weight; 0 without light. */
static double spread_over_reported(const reading *readings, size_t count, size_t *used)
{
    double sum = 0;
    size_t n = 0;
    for (size_t i = 0; i < count; ++i) {
        const reading *r = &readings[i];
        const double observed = (r->squares - r->sum * r->sum / SEEDS) / (SEEDS - 1), reported = r->variances / SEEDS;
        /* a reading that some 10 photons made has no normal error: its error bar is a guess from the same few photons */
        if (!(reported > 0) || reported * SEEDS * SEEDS > 0.1 * r->sum * r->sum)
            continue;
        sum += observed / reported;
        ++n;
    }
    *used = n;
    return n ? sqrt(sum / (double)n) : 0;
}

static lmg_vec3 on_sphere(uint64_t number)
{
    const double golden = 2.39996322972865332, z = 1 - 2 * ((double)number + 0.5) / POINTS, r = sqrt(1 - z * z);
    return (lmg_vec3){r * cos(golden * (double)number), z, r * sin(golden * (double)number)};
}

static lmg_field *bake(const lum_model *model, const lmg_layout *layout, uint64_t seed)
{
    lmg_error err;
    bake_source *source;
    bake_part *part;
    lmg_field *field;
    assert_int_equal(bake_tracer_create(model, seed, &source, &err), LMG_OK);
    assert_int_equal(bake_part_create(&part, &err), LMG_OK);
    assert_int_equal(lmg_accumulator_create(layout, &part->accumulator, &err), LMG_OK);
    part->source_flux = source->flux;
    const lmg_sink sink = lmg_accumulator_sink(part->accumulator);
    assert_int_equal(source->run(source, 0, PHOTONS, 0, &sink, 1, &part->tally, &err), LMG_OK);
    assert_int_equal(bake_part_add_range(part, 0, PHOTONS, &err), LMG_OK);
    if (bake_part_field(part, NULL, &field, &err) != LMG_OK)
        fail_msg("%s", err.message);
    bake_part_destroy(part);
    source->destroy(source);
    return field;
}

static void error_bars(const char *lamp)
{
    char path[1024];
    snprintf(path, sizeof(path), LUMIBOX_BINARY_DIR "/models/%s/%s.gltf", lamp, lamp);
    lmg_error err;
    lum_model *model;
    if (lum_model_load(path, NULL, &model, &err) != LMG_OK)
        fail_msg("%s", err.message);
    const bake_options options = {.photons = 200000, .seed = 1000, .fit = {.cells = CELLS}};
    bake_report report;
    lmg_field *first;
    if (bake_run(model, &options, &first, &report, &err) != LMG_OK)
        fail_msg("%s: %s", lamp, err.message);
    const lmg_layout layout = *lmg_field_layout(first);

    /* Rays of the light itself, seen from well outside. */
    static lmg_ray rays[RAYS];
    for (int i = 0; i < RAYS; ++i) {
        lum_rng rng = lum_rng_stream(77, (uint64_t)i);
        const double xi[5] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        assert_true(lmg_field_emit(first, xi, &rays[i]));
        const double far = 3 * layout.size;
        rays[i].origin = (lmg_vec3){rays[i].origin.x + far * rays[i].direction.x, rays[i].origin.y + far * rays[i].direction.y,
                                    rays[i].origin.z + far * rays[i].direction.z};
    }
    lmg_field_destroy(first);

    static reading flux[1 + LMG_MAX_SLABS], intensity[DIRECTIONS], illuminance[POINTS], radiance[RAYS];
    reading *const all[4] = {flux, intensity, illuminance, radiance};
    static const size_t COUNT[4] = {1 + LMG_MAX_SLABS, DIRECTIONS, POINTS, RAYS};
    for (int k = 0; k < 4; ++k)
        for (size_t i = 0; i < COUNT[k]; ++i)
            all[k][i] = (reading){0};
    for (uint64_t seed = 1; seed <= SEEDS; ++seed) {
        lmg_field *field = bake(model, &layout, seed);
        const lmg_ledger ledger = lmg_field_ledger(field);
        add(&flux[0], ledger.stored, ledger.stored_se);
        for (uint32_t i = 0; i < layout.slab_count; ++i) {
            double error;
            const double lumens = lmg_field_slab_flux(field, i, &error);
            add(&flux[1 + i], lumens, error);
        }
        for (int i = 0; i < DIRECTIONS; ++i) {
            double rgb[3], error;
            /* half of them along the light, half all over */
            const lmg_vec3 d = i % 2 ? on_sphere((uint64_t)i) : rays[i].direction;
            assert_int_equal(lmg_field_intensity(field, d, rgb, &error, &err), LMG_OK);
            add(&intensity[i], 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2], error);
            const lmg_vec3 p = {rays[i].origin.x / (1 + i % 3), rays[i].origin.y / (1 + i % 3), rays[i].origin.z / (1 + i % 3)};
            const lmg_vec3 n = {-rays[i].direction.x, -rays[i].direction.y, -rays[i].direction.z};
            assert_int_equal(lmg_field_illuminance(field, p, n, rgb, &error, &err), LMG_OK);
            add(&illuminance[i], 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2], error);
        }
        for (int i = 0; i < RAYS; ++i) {
            float rgb[3], error;
            lmg_field_radiance(field, rays[i].origin, rays[i].direction, LMG_NEAREST, rgb, &error);
            add(&radiance[i], lmg_luminance(rgb), (double)error);
        }
        lmg_field_destroy(field);
    }
    lum_model_destroy(model);
    static const char *const NAME[4] = {"flux", "far field", "illuminance", "radiance"};
    bool good = true;
    for (int k = 0; k < 4; ++k) {
        size_t used;
        const double ratio = spread_over_reported(all[k], COUNT[k], &used),
                     chance = 3 / sqrt(2 * (SEEDS - 1) * fmax(1, (double)used));
        printf("%s: %s: spread / reported %.3f (%zu of %zu readings, 3 s.e. %.3f)\n", lamp, NAME[k], ratio, used, COUNT[k], chance);
        good = good && used > 0 && fabs(ratio - 1) < 0.2 + chance;
    }
    assert_true(good);
}

static void spot(void **state)
{
    (void)state;
    error_bars("paraboloid-spot");
}
static void globe(void **state)
{
    (void)state;
    error_bars("opal-globe");
}
static void panel(void **state)
{
    (void)state;
    error_bars("louvred-panel");
}
static void lens(void **state)
{
    (void)state;
    error_bars("glass-lens");
}

/* What the cells smooth, as a bake tells it from its pilot, against a judge that looks at millions of rays of lamp and box: cells
 * so few that noise of the box counts for little beside it. */
static void bias(void **state)
{
    (void)state;
    lmg_error err;
    lum_model *model;
    assert_int_equal(lum_model_load(LUMIBOX_BINARY_DIR "/models/paraboloid-spot/paraboloid-spot.gltf", NULL, &model, &err), LMG_OK);
    const bake_options options = {.photons = 2000000, .pilot_photons = 400000, .seed = 5, .fit = {.cells = CELLS}};
    bake_report report;
    lmg_field *field;
    judge *j;
    judge_verdict verdict;
    assert_int_equal(bake_run(model, &options, &field, &report, &err), LMG_OK);
    assert_int_equal(judge_create(model, 5, 0, 0, &j, &err), LMG_OK);
    assert_int_equal(judge_measure_lamp(j, 2000000, &err), LMG_OK);
    assert_int_equal(judge_box(j, field, 2000000, &verdict, &err), LMG_OK);
    bool good = true;
    for (int k = 0; k <= BIAS_DISTANCES; ++k) {
        const bake_bias_error told = k < BIAS_DISTANCES ? report.bias.planes[k] : report.bias.far_field;
        const judge_error seen = k < BIAS_DISTANCES ? verdict.planes[k] : verdict.error[JUDGE_FAR];
        printf("bias %.2f +- %.2f %%, seen %.2f +- %.2f %%\n", 100 * told.rms, 100 * told.standard_error, 100 * seen.rms,
               100 * seen.standard_error);
        /* 10 %: the noise of the box's own cells, which only the judge sees */
        good = good && fabs(told.rms - seen.rms) < 3 * hypot(told.standard_error, seen.standard_error) + 0.1 * seen.rms;
    }
    /* in so few cells there is something to tell */
    assert_true(good && report.bias.planes[0].rms > 10 * report.bias.planes[0].standard_error);
    judge_destroy(j);
    lmg_field_destroy(field);
    lum_model_destroy(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(spot), cmocka_unit_test(globe), cmocka_unit_test(panel),
                                       cmocka_unit_test(lens), cmocka_unit_test(bias)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
