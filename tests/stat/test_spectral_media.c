/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Media by wavelength through the photon tracer: coefficients given as spectra, and phosphor that fills a solid.  A beam of D65 goes
 * straight through slabs of index 1, so that Beer and Lambert's law, wavelength by wavelength, says what goes on in it; what leaves it is
 * scattered or converted, and in lossless slabs all of that comes out.  Seeds are fixed.  Tolerance: 4.5 standard errors, p < 7e-6 for
 * each of about 60 comparisons.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "bake.h"
#include "effects.h"
#include "source.h"
#include "stats.h"
#include "tracer.h"

#include <luminaires/spectrum.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double SIGMAS = 4.5, PHOTONS = 200000;
static const double THICKNESS = 0.01;

typedef struct census {
    double sum[2][3], squares[2][3]; /* X, Y, Z in the beam, and out of it */
    lmg_vec3 beam;
} census;

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    census *c = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 d = rays[i].direction, b = c->beam;
        const double rgb[3] = {(double)rays[i].flux[0], (double)rays[i].flux[1], (double)rays[i].flux[2]};
        const int out = !(d.x * b.x + d.y * b.y + d.z * b.z > 1 - 1e-9);
        double xyz[3];
        lum_rgb_to_xyz(rgb, xyz);
        for (int k = 0; k < 3; ++k) {
            c->sum[out][k] += xyz[k];
            c->squares[out][k] += xyz[k] * xyz[k];
        }
    }
}

static bake_tally trace(const lum_model *m, uint64_t seed, census *c)
{
    bake_source *s;
    lmg_error err = {{0}};
    if (bake_tracer_create(m, seed, &s, &err))
        fail_msg("%s", err.message);
    bake_tally t = {0};
    const lmg_sink sink = {c, consume};
    assert_int_equal(s->run(s, 0, (uint64_t)PHOTONS, 1, &sink, 1, &t, &err), LMG_OK);
    s->destroy(s);
    assert_true(t.emitted == t.escaped + t.absorbed + t.lost);
    assert_true(t.lost == 0);
    return t;
}

static void assert_xyz(const char *what, const census *c, int out, const double expected[3])
{
    for (int k = 0; k < 3; ++k) {
        const double mean = c->sum[out][k] / PHOTONS, error = sqrt(fmax(c->squares[out][k] / PHOTONS - mean * mean, 0) / PHOTONS);
        print_message("%s, %c: %.5f +- %.5f, expected %.5f\n", what, "XYZ"[k], mean, error, expected[k]);
        /* 1e-6: colours are rounded to floats, and matrices to and from R,G,B */
        assert_true(fabs(mean - expected[k]) < SIGMAS * error + 1e-6);
    }
}

/* A slab of index 1 in a beam of D65 that goes straight up. */
static lum_model *slab(uint32_t *material)
{
    lum_model *m = make_model();
    *material = make_glass(m, 1, 0, false);
    make_box(m, (lmg_vec3){-0.5, 0, -0.5}, (lmg_vec3){0.5, THICKNESS, 0.5}, false, 1, *material);
    lum_light *l = m->lights = calloc(1, sizeof(*l));
    assert_non_null(l);
    m->light_count = 1;
    *l = (lum_light){.kind = LUM_LIGHT_SPOT,
                     .position = {0.001, -0.01, 0.002},
                     .direction = {0, 1, 0},
                     .intensity = {1000, 1000, 1000},
                     .cos_inner = 1,
                     .cos_outer = cos(1e-6)};
    finish_model(m);
    return m;
}

/* X, Y, Z over the beam's luminance of D65 with the weight f(nm), by midpoints of quarters of a nanometre. */
static void beam_xyz(double (*f)(double nm, const void *data), const void *data, double xyz[3])
{
    lum_spectrum white;
    lum_spectrum_illuminant("D65", &white);
    double lumens = 0, sum[3] = {0};
    for (int i = 0; i < 4 * (LUM_SPECTRUM_COUNT - 1); ++i) {
        const double nm = LUM_NM_FIRST + 0.25 * (i + 0.5), s = lum_spectrum_at(&white, nm);
        double o[3];
        lum_observer(nm, o);
        lumens += s * o[1];
        for (int k = 0; k < 3; ++k)
            sum[k] += s * f(nm, data) * o[k];
    }
    for (int k = 0; k < 3; ++k)
        xyz[k] = sum[k] / lumens;
}

typedef struct coefficients {
    lum_spectrum scattering, absorption;
} coefficients;

static double passed(double nm, const void *data)
{
    const coefficients *c = data;
    return exp(-THICKNESS * (lum_spectrum_at(&c->scattering, nm) + lum_spectrum_at(&c->absorption, nm)));
}

static double not_passed(double nm, const void *data)
{
    return 1 - passed(nm, data);
}

/* ---------------------------------------------------------------------------------------------------------- coefficients */

/* Scattering as the fourth power of the frequency, without and with an absorption in green: the beam behind the slab is red, wavelength by
 * wavelength, and of the lossless haze all that is missing in the beam comes out elsewhere, blue. */
static void haze_is_blue(void **state)
{
    (void)state;
    static const double DEPTH[] = {0.02, 0.5, 3}; /* at 550 nm */
    for (int i = 0; i < 6; ++i) {
        const bool absorbs = i >= 3;
        coefficients c;
        for (int k = 0; k < LUM_SPECTRUM_COUNT; ++k) {
            const double nm = LUM_NM_FIRST + k;
            c.scattering.value[k] = (float)(DEPTH[i % 3] / THICKNESS * pow(550 / nm, 4));
            c.absorption.value[k] = absorbs ? (float)(DEPTH[i % 3] / THICKNESS * exp(-pow((nm - 530) / 40, 2))) : 0;
        }
        uint32_t material;
        lum_model *m = slab(&material);
        lum_material *glass = &m->materials[material];
        glass->spectral.scattering = &c.scattering;
        glass->spectral.absorption = &c.absorption;
        glass->anisotropy = 0.3f;
        census seen = {.beam = {0, 1, 0}};
        const bake_tally t = trace(m, 11 + (uint64_t)i, &seen);
        double expected[3];
        beam_xyz(passed, &c, expected);
        assert_xyz(absorbs ? "beam behind an absorbing haze" : "beam behind a haze", &seen, 0, expected);
        if (!absorbs) {
            beam_xyz(not_passed, &c, expected);
            assert_xyz("haze", &seen, 1, expected);
            assert_true(seen.sum[1][2] / seen.sum[1][1] > 1.02 * seen.sum[0][2] / seen.sum[0][1]);
        } else {
            assert_true(t.absorbed > 0);
        }
        free_model(m);
    }
}

/* --------------------------------------------------------------------------------------------------------------- phosphor */

/* An absorption in blue, cut off before the emission begins: what is emitted isn't absorbed again. */
static void make_phosphor(lum_material *m, double peak, double yield, lum_spectrum *excitation, lum_spectrum *yellow)
{
    lum_spectrum_gaussian(570, 60, yellow);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        excitation->value[i] = nm <= 500 ? (float)(peak * exp(-pow((nm - 450) / 30, 2))) : 0;
        yellow->value[i] = nm >= 505 ? yellow->value[i] : 0;
    }
    m->spectral.excitation = excitation;
    m->spectral.converted = yellow;
    m->spectral.quantum_yield = (float)yield;
    m->spectral.fills = true;
}

/* Without scattering: of each wavelength 1 - exp(-e L) is absorbed, from thin to thick, and of that as many photons are emitted as the
 * yield says, to all sides, half of them upwards. */
static void filled_slab(void **state)
{
    (void)state;
    static const double DEPTH[] = {0.01, 0.3, 1, 8};
    for (int i = 0; i < 4; ++i) {
        const double yield = 0.9;
        coefficients c = {{{0}}, {{0}}};
        lum_spectrum yellow, white;
        uint32_t material;
        lum_model *m = slab(&material);
        make_phosphor(&m->materials[material], DEPTH[i] / THICKNESS, yield, &c.absorption, &yellow);
        census seen = {.beam = {0, 1, 0}};
        const bake_tally t = trace(m, 31 + (uint64_t)i, &seen);
        double expected[3];
        beam_xyz(passed, &c, expected);
        assert_xyz("beam behind a phosphor", &seen, 0, expected);
        lum_spectrum_illuminant("D65", &white);
        double lumens = 0, number = 0, watts = 0, taken = 0, e_number = 0, e_watts = 0, emission[3] = {0};
        for (int k = 0; k < 4 * (LUM_SPECTRUM_COUNT - 1); ++k) {
            const double nm = LUM_NM_FIRST + 0.25 * (k + 0.5), s = lum_spectrum_at(&white, nm), e = lum_spectrum_at(&yellow, nm);
            double o[3];
            lum_observer(nm, o);
            lumens += s * o[1];
            number += s * nm * not_passed(nm, &c);
            taken += s * not_passed(nm, &c);
            watts += s;
            e_number += e * nm;
            e_watts += e;
            for (int j = 0; j < 3; ++j)
                emission[j] += e * o[j];
        }
        const double gain = yield * number / e_number;
        for (int k = 0; k < 3; ++k)
            expected[k] = gain * emission[k] / lumens;
        assert_xyz("emitted", &seen, 1, expected);
        /* Power: the emitted light is of one spectrum, so its Y says it.  Stokes: less than was taken. */
        const double power = seen.sum[1][1] / PHOTONS * lumens / emission[1] * e_watts;
        print_message("of %.4f of the power taken, %.4f is emitted (%.4f); absorbed luminance %.4f\n", taken / watts, power / watts,
                      gain * e_watts / watts, t.absorbed / t.emitted);
        assert_true(power < yield * taken);
        free_model(m);
    }
}

/* Directions of rays out of the beam, in cells of equal solid angle. */
enum { ZONES = 8, SECTORS = 9 };
typedef struct sphere_counts {
    double count[ZONES * SECTORS], all;
} sphere_counts;

static void count_directions(void *self, const lmg_ray *rays, size_t count)
{
    sphere_counts *c = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 d = rays[i].direction;
        if (d.y > 1 - 1e-9)
            continue;
        const int zone = (int)fmin(floor(0.5 * (1 + d.y) * ZONES), ZONES - 1);
        const int sector = (int)fmin(floor((atan2(d.z, d.x) / 6.283185307179586 + 0.5) * SECTORS), SECTORS - 1);
        ++c->count[zone * SECTORS + sector];
        ++c->all;
    }
}

/* Particles emit to all sides alike, whichever way the light came that they have taken and whatever the medium's phase function: in a slab
 * of index 1 without scattering what is emitted goes straight out.  Null hypothesis of the chi-square test: directions are independent and
 * uniform on the sphere, 72 cells of equal solid angle, 71 degrees of freedom. */
static void phosphor_emits_to_all_sides(void **state)
{
    (void)state;
    lum_spectrum excitation, yellow;
    uint32_t material;
    lum_model *m = slab(&material);
    make_phosphor(&m->materials[material], 1 / THICKNESS, 0.9, &excitation, &yellow);
    m->materials[material].anisotropy = 0.7f;
    bake_source *s;
    lmg_error err = {{0}};
    assert_int_equal(bake_tracer_create(m, 37, &s, &err), LMG_OK);
    bake_tally t = {0};
    static sphere_counts seen;
    const lmg_sink sink = {&seen, count_directions};
    assert_int_equal(s->run(s, 0, (uint64_t)PHOTONS, 1, &sink, 1, &t, &err), LMG_OK);
    s->destroy(s);
    free_model(m);
    double expected[ZONES * SECTORS], statistic;
    int degrees;
    for (int i = 0; i < ZONES * SECTORS; ++i)
        expected[i] = seen.all / (ZONES * SECTORS);
    const double p = stats_chi_square(seen.count, expected, ZONES * SECTORS, &statistic, &degrees);
    print_message("%.0f rays emitted, chi-square %.1f of %d degrees, p = %.3f\n", seen.all, statistic, degrees, p);
    assert_int_equal(degrees, ZONES * SECTORS - 1);
    assert_true(seen.all > 5000); /* a density off by a tenth, up in one half and down in the other, would have a chi-square of 50 more */
    assert_true(p > 7e-6);
}

static void count_lumens(void *self, const lmg_ray *rays, size_t count)
{
    double *sum = self;
    for (size_t i = 0; i < count; ++i) {
        const double rgb[3] = {(double)rays[i].flux[0], (double)rays[i].flux[1], (double)rays[i].flux[2]};
        double xyz[3];
        lum_rgb_to_xyz(rgb, xyz);
        for (int k = 0; k < 3; ++k)
            sum[k] += xyz[k];
    }
}

/* The same photons baked: the colour of the box, summed over directions, is theirs. */
static void through_the_box(const lum_model *m, double expected)
{
    lmg_field *field;
    bake_report report;
    lmg_error err = {{0}};
    const bake_options options = {
        .photons = (uint64_t)PHOTONS, .seed = 41, .threads = 1, .effects_chosen = true, .effects = UINT32_MAX, .fit = {.struct_size = sizeof(lmg_fit_options)}};
    if (bake_run(m, &options, &field, &report, &err))
        fail_msg("%s", err.message);
    enum { DIRECTIONS = 610, BEFORE = 377 }; /* a Fibonacci lattice */
    double sum[3] = {0}, xyz[3], kelvin, duv;
    for (int i = 0; i < DIRECTIONS; ++i) {
        const double y = 1 - 2 * (i + 0.5) / DIRECTIONS, r = sqrt(1 - y * y), a = 2 * 3.14159265358979323846 * (i * BEFORE % DIRECTIONS) / DIRECTIONS;
        double rgb[3];
        assert_int_equal(lmg_field_intensity(field, (lmg_vec3){r * cos(a), y, r * sin(a)}, rgb, NULL, &err), LMG_OK);
        for (int c = 0; c < 3; ++c)
            sum[c] += rgb[c];
    }
    lum_rgb_to_xyz(sum, xyz);
    assert_true(lum_cct(xyz, &kelvin, &duv));
    print_message("box: %.0f K, duv %.5f, photons' %.5f\n", kelvin, duv, expected);
    assert_true(fabs(duv - expected) < 1e-3);
    lmg_field_destroy(field);
}

/* A dome of silicone over a blue chip, filled with particles that scatter and convert.  Over the LED's band the excitation is flat, so that
 * what is left of the blue keeps its spectrum; the light that comes out is then a mixture of two known spectra, and its photons are those of
 * the chip: the blue ones that came out, and the converted ones over the yield.  Without fluorescence the plan's stand-in
 * leaves the scattering and all of the blue. */
static void filled_dome(void **state)
{
    (void)state;
    lum_spectrum blue, excitation, yellow;
    lum_spectrum_gaussian(450, 20, &blue);
    lum_spectrum_gaussian(570, 60, &yellow);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        excitation.value[i] = nm <= 500 ? 600 : 0;
        yellow.value[i] = nm >= 505 ? yellow.value[i] : 0;
        blue.value[i] = nm <= 499 ? blue.value[i] : 0;
    }
    const double yield = 0.85;
    lum_model *m = make_model();
    const uint32_t chip = make_lambert(m, 1), dome = make_glass(m, 1.41f, 0, false);
    double rgb[3];
    assert_true(lum_spectrum_rgb(&blue, rgb));
    for (int k = 0; k < 3; ++k)
        m->materials[chip].emissive[k] = (float)(1000 * rgb[k]);
    m->materials[chip].spectral.emission = &blue;
    m->materials[chip].spectral.measured = true;
    lum_material *silicone = &m->materials[dome];
    for (int k = 0; k < 3; ++k)
        silicone->scattering[k] = 900;
    silicone->anisotropy = 0.7f;
    silicone->spectral = (lum_spectral){.excitation = &excitation, .converted = &yellow, .quantum_yield = (float)yield, .fills = true};
    make_sphere(m, (lmg_vec3){0, 0, 0}, 0.003, 24, false, true, dome);
    make_quad(m, (lmg_vec3){-0.0005, 0.0002, -0.0005}, (lmg_vec3){0.001, 0, 0}, (lmg_vec3){0, 0, 0.001}, 1, chip);
    finish_model(m);
    lum_part *parts = realloc(m->parts, 2 * sizeof(*parts)); /* effects are listed by part: the dome, the chip */
    assert_non_null(parts);
    m->parts = parts;
    parts[1] = parts[0];
    parts[0].material = (int32_t)dome;
    parts[1].material = (int32_t)chip;
    m->part_count = 2;

    double lumens = 0, number = 0, watts = 0, e_number = 0, e_watts = 0, b[3] = {0}, e[3] = {0};
    for (int k = 0; k < 4 * (LUM_SPECTRUM_COUNT - 1); ++k) {
        const double nm = LUM_NM_FIRST + 0.25 * (k + 0.5), s = lum_spectrum_at(&blue, nm), y = lum_spectrum_at(&yellow, nm);
        double o[3];
        lum_observer(nm, o);
        lumens += s * o[1];
        number += s * nm;
        watts += s;
        e_number += y * nm;
        e_watts += y;
        for (int j = 0; j < 3; ++j) {
            b[j] += s * o[j];
            e[j] += y * o[j];
        }
    }
    for (int with = 0; with < 2; ++with) {
        bake_source *source;
        lmg_error err = {{0}};
        const uint32_t fluorescence = 1u << BAKE_FLUORESCENCE;
        assert_true(bake_effects_of(m) & fluorescence);
        assert_int_equal(bake_tracer_create_with(m, with ? UINT32_MAX : ~fluorescence, 41, NULL, &source, &err), LMG_OK);
        double xyz[3] = {0};
        bake_tally t = {0};
        const lmg_sink sink = {xyz, count_lumens};
        assert_int_equal(source->run(source, 0, (uint64_t)PHOTONS, 1, &sink, 1, &t, &err), LMG_OK);
        source->destroy(source);
        assert_true(t.lost == 0 && t.emitted == t.escaped + t.absorbed);
        const double y = xyz[1] / PHOTONS * lumens, z = xyz[2] / PHOTONS * lumens, det = b[1] * e[2] - b[2] * e[1];
        const double left = (y * e[2] - z * e[1]) / det, made = (z * b[1] - y * b[2]) / det;
        const double photons = left + made * e_number / (yield * number), power = (left * watts + made * e_watts) / watts;
        double kelvin, duv;
        const bool white = lum_cct(xyz, &kelvin, &duv);
        print_message("dome, phosphor %s: %.4f of the blue left, photons %.4f, power %.4f; %.0f K, duv %.4f\n", with ? "in" : "left out", left,
                      photons, power, white ? kelvin : 0, white ? duv : 0);
        /* Y of one photon in 200,000 varies by about twice its mean: 0.5 % */
        assert_true(fabs(photons - 1) < 0.015);
        if (with) {
            assert_true(left < 0.3 && power < 0.9 && power > 0.5);
            assert_true(t.absorbed < 0); /* of luminance more comes out than went in */
            through_the_box(m, duv);
        } else {
            assert_true(fabs(left - 1) < 0.015 && fabs(made) < 1e-3 * number / e_number);
        }
    }
    free_model(m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(haze_is_blue), cmocka_unit_test(phosphor_emits_to_all_sides), cmocka_unit_test(filled_slab), cmocka_unit_test(filled_dome)};
    return cmocka_run_group_tests_name("spectral_media", tests, NULL, NULL);
}
