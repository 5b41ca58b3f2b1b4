/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The sample lamps whose light has to be followed by wavelength, from glTF and recipe to the box: where the prism sends each part of the
 * spectrum, and what the phosphor makes of the chip's light.  Fixed seeds.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "bake.h"
#include "dimensions.h"

#include <luminaires/model.h>
#include <luminaires/spectrum.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

static lum_model *load(const char *name)
{
    char path[2][512];
    lum_recipe *recipe;
    lum_model *model;
    lmg_error err = {{0}};
    snprintf(path[0], sizeof(path[0]), "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, name, name);
    snprintf(path[1], sizeof(path[1]), "%s/models/%s/%s.recipe.json", LUMIBOX_BINARY_DIR, name, name);
    if (lum_recipe_read(path[1], &recipe, &err) || lum_model_load(path[0], recipe, &model, &err))
        fail_msg("%s", err.message);
    lum_recipe_destroy(recipe);
    return model;
}

/* X,Y,Z of the rays with wavelengths from low to high, or of all, and their mean angle from straight down towards +x. */
typedef struct census {
    double low, high;
    double xyz[3], squares, angle, angle_squares, weight;
} census;

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    census *c = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_ray *r = &rays[i];
        if (c->high > 0 && !((double)r->wavelength >= c->low && (double)r->wavelength < c->high))
            continue;
        const double a = atan2(r->direction.x, -r->direction.y);
        if (c->high > 0 && fabs(a) > 0.2) /* not the refracted beam */
            continue;
        const double rgb[3] = {(double)r->flux[0], (double)r->flux[1], (double)r->flux[2]};
        double xyz[3];
        lum_rgb_to_xyz(rgb, xyz);
        for (int k = 0; k < 3; ++k)
            c->xyz[k] += xyz[k];
        c->squares += xyz[1] * xyz[1];
        c->angle += a;
        c->angle_squares += a * a;
        c->weight += 1;
    }
}

static bake_tally trace(const lum_model *m, uint64_t photons, census *c)
{
    bake_source *source;
    bake_tally t = {0};
    lmg_error err = {{0}};
    const lmg_sink sink = {c, consume};
    if (bake_tracer_create(m, 5, &source, &err) || source->run(source, 0, photons, 1, &sink, 1, &t, &err))
        fail_msg("%s", err.message);
    source->destroy(source);
    assert_true(t.emitted == t.escaped + t.absorbed + t.lost);
    return t;
}

/* Angle from straight down, towards +x, at which the middle ray leaves the prism when the index is n. */
static double exit_angle(double n)
{
    const double incidence = asin(PRISM_IOR * 0.5);
    return incidence - asin(n * sin(PI / 3 - asin(sin(incidence) / n)));
}

static void prism_by_wavelength(void **state)
{
    (void)state;
    lum_model *m = load("prism-lamp");
    lum_index_model glass;
    assert_true(lum_index_of_glass("N-SF11", &glass));
    for (double nm = 450; nm < 680; nm += 40) {
        census c = {.low = nm - 2, .high = nm + 2};
        trace(m, 60000, &c);
        const double mean = c.angle / c.weight, spread = sqrt(c.angle_squares / c.weight - mean * mean);
        const double expected = exit_angle(lum_index_at(&glass, nm));
        print_message("%.0f nm: leaves at %.3f +- %.3f degrees, middle ray %.3f; %.0f photons\n", nm, mean * 180 / PI,
                      spread / sqrt(c.weight) * 180 / PI, expected * 180 / PI, c.weight);
        /* Over the beam's half a degree the deviation is curved: d2/di2 is below 4 for this prism, times the beam's variance / 2. */
        const double curved = 4 * PRISM_CONE * PRISM_CONE / 6;
        assert_true(c.weight > 100);
        assert_true(fabs(mean - expected) < 4 * spread / sqrt(c.weight) + curved);
    }
    print_message("F to C: %.3f degrees\n",
                  (exit_angle(lum_index_at(&glass, LUM_NM_C)) - exit_angle(lum_index_at(&glass, LUM_NM_F))) * 180 / PI);
    lum_model_destroy(m);
}

/* In the box: seen from far away, red light comes under one angle, blue under another, green between. */
static void prism_in_the_box(void **state)
{
    (void)state;
    lum_model *m = load("prism-lamp");
    lum_index_model glass;
    lmg_field *field;
    bake_report report;
    lmg_error err = {{0}};
    assert_true(lum_index_of_glass("N-SF11", &glass));
    const bake_options options = {.photons = 400000, .seed = 3, .threads = 1, .fit = {.struct_size = sizeof(lmg_fit_options)}};
    if (bake_run(m, &options, &field, &report, &err))
        fail_msg("%s", err.message);
    double rgb[3][3];
    const double nm[3] = {630, 545, 460};
    for (int i = 0; i < 3; ++i) {
        const double a = exit_angle(lum_index_at(&glass, nm[i]));
        const lmg_vec3 d = {sin(a), -cos(a), 0};
        assert_int_equal(lmg_field_intensity(field, d, rgb[i], NULL, &err), LMG_OK);
        print_message("towards %.0f nm: R,G,B %.4g %.4g %.4g cd\n", nm[i], rgb[i][0], rgb[i][1], rgb[i][2]);
    }
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 3; ++i)
            assert_true(i == k || rgb[k][k] > 2 * rgb[i][k]); /* each colour is strongest in its own direction */
    assert_true(rgb[0][0] > 2 * rgb[0][1] && rgb[1][1] > 2 * rgb[1][0] && rgb[2][2] > 2 * rgb[2][1]);
    lmg_field_destroy(field);
    lum_model_destroy(m);
}

/* From a recipe's spectrum to the colour of a box: x, y, temperature and duv of the light straight below the spot, of which the mirror is
 * grey.  Without and with a surface that makes the light be followed by wavelength (also grey). */
static void colour_through_the_chain(void **state)
{
    (void)state;
    static const char *const names[] = {"A", "D50", "D65"};
    for (int i = 0; i < 6; ++i) {
        lum_recipe *recipe;
        lum_model *m;
        lmg_field *field;
        bake_report report;
        lmg_error err = {{0}};
        char path[512], emitter[64];
        snprintf(path, sizeof(path), "%s/models/paraboloid-spot/paraboloid-spot.gltf", LUMIBOX_BINARY_DIR);
        snprintf(emitter, sizeof(emitter), "emitter:Source=800lm,%s", names[i % 3]);
        if (lum_recipe_create(&recipe, &err) || lum_recipe_add(recipe, emitter, &err) ||
            lum_recipe_add(recipe, i < 3 ? "mirror:Mirror=0.9" : "conductor:Mirror=silver", &err) ||
            lum_model_load(path, recipe, &m, &err))
            fail_msg("%s", err.message);
        lum_recipe_destroy(recipe);
        for (uint32_t k = 0; k < m->material_count && i >= 3; ++k) { /* a metal that is followed by wavelength, yet grey */
            lum_spectral *s = &m->materials[k].spectral;
            for (int nm = 0; nm < LUM_SPECTRUM_COUNT && s->eta; ++nm)
                for (uint32_t n = 0; n < m->spectrum_count; ++n)
                    m->spectra[n]->value[nm] = m->spectra[n] == s->eta ? 0.1f : m->spectra[n] == s->k ? 3.5f : m->spectra[n]->value[nm];
            for (int c = 0; c < 3; ++c) {
                m->materials[k].eta[c] = 0.1f;
                m->materials[k].k[c] = 3.5f;
            }
        }
        const bake_options options = {.photons = 300000, .seed = 3, .threads = 1, .fit = {.struct_size = sizeof(lmg_fit_options)}};
        if (bake_run(m, &options, &field, &report, &err))
            fail_msg("%s", err.message);
        double rgb[3], sum[3] = {0}, xyz[3], want[3], got_xy[2], want_xy[2], a[2], b[2], kelvin[2], duv[2];
        for (int k = 0; k < 81; ++k) { /* directions within the beam */
            const double x = 0.01 * (k % 9 - 4), z = 0.01 * (k / 9 - 4), y = -sqrt(1 - x * x - z * z);
            assert_int_equal(lmg_field_intensity(field, (lmg_vec3){x, y, z}, rgb, NULL, &err), LMG_OK);
            for (int c = 0; c < 3; ++c)
                sum[c] += rgb[c];
        }
        lum_spectrum s;
        assert_true(lum_spectrum_illuminant(names[i % 3], &s));
        lum_spectrum_xyz(&s, want);
        lum_rgb_to_xyz(sum, xyz);
        lum_chromaticity(xyz, got_xy, a);
        lum_chromaticity(want, want_xy, b);
        assert_true(lum_cct(xyz, &kelvin[0], &duv[0]) && lum_cct(want, &kelvin[1], &duv[1]));
        print_message("%s %s: x %.5f y %.5f, %.0f K, duv %.5f; of the spectrum x %.5f y %.5f, %.0f K, duv %.5f\n", names[i % 3],
                      i < 3 ? "in R,G,B" : "by wavelength", got_xy[0], got_xy[1], kelvin[0], duv[0], want_xy[0], want_xy[1], kelvin[1], duv[1]);
        assert_true(hypot(a[0] - b[0], (a[1] - b[1]) * 2 / 3) < 1e-3);
        assert_true(fabs(duv[0] - duv[1]) < 1e-3);
        lmg_field_destroy(field);
        lum_model_destroy(m);
    }
}

/* Light that leaves the phosphor LED is chip light and phosphor light: their shares follow from Y and Z, and with them the power. */
static void phosphor_power(void **state)
{
    (void)state;
    lum_model *m = load("phosphor-led");
    const lum_spectral *phosphor = NULL, *chip = NULL;
    for (uint32_t i = 0; i < m->material_count; ++i) {
        phosphor = m->materials[i].spectral.converted ? &m->materials[i].spectral : phosphor;
        chip = m->materials[i].spectral.emission ? &m->materials[i].spectral : chip;
    }
    assert_true(phosphor && chip);
    census c = {0};
    const double photons = 300000;
    const bake_tally t = trace(m, (uint64_t)photons, &c);
    double kelvin = 0, duv = 0, xy[2], uv[2];
    lum_chromaticity(c.xyz, xy, uv);
    const bool white = lum_cct(c.xyz, &kelvin, &duv);
    const double share = t.escaped / photons, se = sqrt(c.squares / photons - share * share) / sqrt(photons);
    const double lumens = lum_spectrum_efficacy(chip->emission) * share; /* of the chip's 1 W */
    print_message("phosphor LED: %.2f +- %.2f lm, x %.4f y %.4f, %.0f K, duv %.4f\n", lumens,
                  se * lum_spectrum_efficacy(chip->emission), xy[0], xy[1], kelvin, duv);
    assert_true(white);
    assert_true(kelvin > 5000 && kelvin < 7500 && fabs(duv) < 0.02);

    double a[3], b[3], power[2] = {0};
    lum_spectrum_xyz(chip->emission, a);
    lum_spectrum_xyz(phosphor->converted, b);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        power[0] += (double)chip->emission->value[i];
        power[1] += (double)phosphor->converted->value[i];
    }
    /* Chip light filtered by the layer and phosphor light that the layer has taken in part keep nearly their shapes. */
    const double det = a[1] * b[2] - a[2] * b[1], y = c.xyz[1] / photons * a[1], z = c.xyz[2] / photons * a[1];
    const double blue = (y * b[2] - z * b[1]) / det, yellow = (z * a[1] - y * a[2]) / det * power[1] / power[0];
    print_message("phosphor LED: of the chip's power %.3f leaves as blue, %.3f as yellow\n", blue, yellow);
    assert_true(blue > 0.05 && yellow > 0.1);
    /* Each watt that leaves as yellow took 1 / (0.9 x 450/566) watts of blue. */
    assert_true(blue + yellow / (0.9 * 450 / 566) < 1);
    lum_model_destroy(m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(prism_by_wavelength),
        cmocka_unit_test(prism_in_the_box),
        cmocka_unit_test(colour_through_the_chain),
        cmocka_unit_test(phosphor_power),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
