/* SPDX-License-Identifier: Apache-2.0 */
/* Spectra: tables, files, the observer, colours of spectra, spectra of colours, refractive indices. */
#include <luminaires/spectrum.h>

#include "colour.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

static void assert_close(double a, double b, double tolerance)
{
    if (!(fabs(a - b) <= tolerance))
        fail_msg("%.12g is not within %g of %.12g", a, tolerance, b);
}

static double uv_distance(const double a[3], double x, double y)
{
    const double b[3] = {x / y, 1, (1 - x - y) / y};
    double xy[2], u[2], v[2];
    lum_chromaticity(a, xy, u);
    lum_chromaticity(b, xy, v);
    return hypot(u[0] - v[0], 2.0 / 3 * (u[1] - v[1])); /* CIE 1960, as duv */
}

static bool shared_file(const char *name, char path[512])
{
    snprintf(path, 512, "%s/spectra/%s", LUMIBOX_SHARED_DATA, name);
    FILE *f = fopen(path, "rb");
    if (f)
        fclose(f);
    else
        printf("skipped: no %s\n", path);
    return f != NULL;
}

/* ------------------------------------------------------------------------------------------------------------- tables */

/* Integrals of rows finer, coarser and unrelated to the grid are kept; straight lines come back as they are. */
static void tables_keep_integrals(void **state)
{
    (void)state;
    lum_spectrum s;
    lmg_error err;
    double nm[4001], value[4001], integral = 0;
    for (int i = 0; i <= 4000; ++i) { /* 0.1 nm apart: a line 0.4 nm wide at 450.33 nm, another across a grid point */
        nm[i] = 400.03 + 0.1 * i;
        value[i] = i == 503 ? 7 : i >= 1999 && i < 2001 ? 3 : 0;
        integral += 0.1 * value[i];
    }
    assert_int_equal(lum_spectrum_from_table(nm, value, 4001, LUM_SPECTRUM_ZERO, 0, 10, &s, &err), LMG_OK);
    double sum = 0, centre = 0;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        sum += (double)s.value[i];
        centre += (double)s.value[i] * (LUM_NM_FIRST + i);
    }
    assert_close(sum, integral, 1e-6 * integral);
    assert_close(centre, 0.7 * (400.03 + 50.3) + 0.6 * (400.03 + 199.95), 1e-6 * centre);

    const double two_nm[2] = {380, 780}, two[2] = {0.25, 0.75};
    assert_int_equal(lum_spectrum_from_table(two_nm, two, 2, LUM_SPECTRUM_HOLD, 0, 1, &s, &err), LMG_OK);
    assert_close(lum_spectrum_at(&s, 360), 0.25, 1e-7);
    assert_close(lum_spectrum_at(&s, 830), 0.75, 1e-7);
    assert_close(lum_spectrum_at(&s, 481.3), 0.25 + 0.5 * (481.3 - 380) / 400, 1e-7);
    assert_true(lum_spectrum_at(&s, 359.9) == 0 && lum_spectrum_at(&s, 830.1) == 0);
    assert_int_equal(lum_spectrum_from_table(two_nm, two, 2, LUM_SPECTRUM_ZERO, 0, 1, &s, &err), LMG_OK);
    assert_true(lum_spectrum_at(&s, 378) == 0 && lum_spectrum_at(&s, 782) == 0);
}

static void tables_that_are_wrong(void **state)
{
    (void)state;
    static const struct {
        const char *text, *message;
        lum_spectrum_end end;
    } cases[] = {
        {"400 1\n500 -0.1\n600 1\n", "-0.1 at 500 nm is outside [0, 1]", LUM_SPECTRUM_ZERO},
        {"400 1\n500 1.1\n600 1\n", "1.1 at 500 nm is outside [0, 1]", LUM_SPECTRUM_ZERO},
        {"400 1\n500 nan\n600 1\n", "nan at 500 nm is outside", LUM_SPECTRUM_ZERO},
        {"400 1\n500 1\n500 1\n", "row 3: wavelengths have to increase", LUM_SPECTRUM_ZERO},
        {"400 1\n", "has 1 rows", LUM_SPECTRUM_ZERO},
        {"", "has 0 rows", LUM_SPECTRUM_ZERO},
        {"wavelength, power\n400, 1\n\n410, \n420, 1\n", "line 4 isn't a row", LUM_SPECTRUM_ZERO},
        {"400,1\n410,,1\n420,1\n", "line 2 isn't a row", LUM_SPECTRUM_ZERO},
        {"200 1\n300 1\n", "has no light between 360 and 830 nm", LUM_SPECTRUM_ZERO},
        {"400 0\n700 0\n", "has no light", LUM_SPECTRUM_ZERO},
        {"450 1\n700 1\n", "covers 450 to 700 nm only", LUM_SPECTRUM_HOLD},
        {"400 1\n405 1\n410 1\n415 1\n420 1\n425 1\n430 1\n435 1\n440 1\n445 1\n450 1\n455 1\n460 1\n465 1\n500 1\n505 1\n510 1\n",
         "has a gap from 465 to 500 nm", LUM_SPECTRUM_ZERO},
        {"{\"lambda_nm\":[400,700,100],\"values\":[1,1,1]}", "400 to 700 by 100 doesn't fit 3", LUM_SPECTRUM_ZERO},
        {"{\"lambda_nm\":[400,700,10],\"values\":[1,1]}", "doesn't fit 2 values", LUM_SPECTRUM_ZERO},
        {"{\"lambda_nm\":[400,700],\"values\":[1,\"x\"]}", "\"values\" number 2 isn't a number", LUM_SPECTRUM_ZERO},
        {"{\"lambda_nm\":[400,500,600,700],\"values\":[1]}", "has 4 wavelengths and 1 values", LUM_SPECTRUM_ZERO},
        {"{\"nm\":[400]}", "needs \"lambda_nm\" and \"values\"", LUM_SPECTRUM_ZERO},
        {"{\"lambda_nm\":", "not JSON", LUM_SPECTRUM_ZERO},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; ++i) {
        lum_spectrum s;
        lmg_error err = {{0}};
        const lmg_result r = lum_spectrum_parse(cases[i].text, strlen(cases[i].text), cases[i].end, 0, 1, &s, &err);
        if (i == 12) { /* three numbers and three values are a list */
            assert_int_equal(r, LMG_ERROR_INPUT);
            assert_non_null(strstr(err.message, "wavelengths have to increase"));
            continue;
        }
        if (r != LMG_ERROR_INPUT || !strstr(err.message, cases[i].message))
            fail_msg("case %zu: %d \"%s\" instead of \"%s\"", i, (int)r, err.message, cases[i].message);
    }
}

/* The same table in every dialect. */
static void dialects(void **state)
{
    (void)state;
    static const char *const texts[] = {
        "400 0\n500 1\n600 0.25\n",
        "\xef\xbb\xbfWavelength (nm),Relative power (%)\r\n400,0\r\n500,1\r\n600,0.25\r\n",
        "# a comment\nnm;value\n400;0\n500;1,0\n600;0,25",
        "dataname:\tLED\ncontinuous\n400\t0\n500\t1\n600\t0.25\tx\n\n",
        "{\"lambda_nm\":[400,500,600],\"values\":[0,1,0.25]}",
        " {\"description\":\"x\",\"lambda_nm\":[400,600,100],\"values\":[0,1,0.25]}",
    };
    lum_spectrum first, s;
    lmg_error err = {{0}};
    for (size_t i = 0; i < sizeof texts / sizeof *texts; ++i) {
        if (i == 5) /* three numbers for three values are a list: not a range */
            continue;
        if (lum_spectrum_parse(texts[i], strlen(texts[i]), LUM_SPECTRUM_ZERO, 0, 1, &s, &err))
            fail_msg("dialect %zu: %s", i, err.message);
        if (i == 0)
            first = s;
        assert_memory_equal(&first, &s, sizeof s);
    }
    assert_close(lum_spectrum_at(&first, 450), 0.5, 1e-7);
}

/* ------------------------------------------------------------------------------------------------------------- colour */

/* Chromaticities and temperatures that the CIE gives (CIE 15:2004, tables T.3 and T.8). */
static void illuminants(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        double x, y, kelvin;
    } cases[] = {{"A", 0.44758, 0.40745, 2856}, {"D50", 0.34567, 0.35851, 5003}, {"D55", 0.33243, 0.34744, 5503},
                 {"D65", 0.31272, 0.32903, 6504}, {"D75", 0.29903, 0.31488, 7504}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; ++i) {
        lum_spectrum s;
        double xyz[3], xy[2], uv[2], kelvin, duv;
        assert_true(lum_spectrum_illuminant(cases[i].name, &s));
        lum_spectrum_xyz(&s, xyz);
        lum_chromaticity(xyz, xy, uv);
        assert_close(xy[0], cases[i].x, 2e-5);
        assert_close(xy[1], cases[i].y, 2e-5);
        assert_true(lum_cct(xyz, &kelvin, &duv));
        assert_close(kelvin, cases[i].kelvin, 3);
        if (i > 0)
            assert_true(duv > 0.0028 && duv < 0.0036); /* daylight is above the locus */
    }
    lum_spectrum s;
    double xyz[3];
    assert_true(lum_spectrum_illuminant("E", &s));
    assert_close(lum_spectrum_efficacy(&s), 683 * 106.857 / 470, 0.01);
    assert_false(lum_spectrum_illuminant("D60", &s));
    lum_spectrum_gaussian(520, 10, &s); /* far from white: has no temperature */
    lum_spectrum_xyz(&s, xyz);
    double kelvin, duv;
    assert_false(lum_cct(xyz, &kelvin, &duv));
}

/* Black bodies are on their own locus. */
static void black_bodies(void **state)
{
    (void)state;
    for (double t = 1100; t < 24000; t *= 1.31) {
        lum_spectrum s;
        double xyz[3], kelvin, duv;
        lum_spectrum_blackbody(t, &s);
        lum_spectrum_xyz(&s, xyz);
        assert_true(lum_cct(xyz, &kelvin, &duv));
        assert_close(1e6 / kelvin, 1e6 / t, 0.01);
        assert_close(duv, 0, 1e-7);
        assert_close(lum_spectrum_at(&s, 560), 1, 1e-7);
    }
}

static void colours_round_trip(void **state)
{
    (void)state;
    for (int i = 0; i < 27; ++i) {
        const double rgb[3] = {i % 3 * 0.7 - 0.1, i / 3 % 3 * 0.5 + 0.01, i / 9 * 0.45};
        double xyz[3], back[3];
        lum_rgb_to_xyz(rgb, xyz);
        assert_close(xyz[1], 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2], 1e-15);
        lum_xyz_to_rgb(xyz, back);
        for (int k = 0; k < 3; ++k)
            assert_close(back[k], rgb[k], 1e-14);
    }
}

static void spectra_of_colours(void **state)
{
    (void)state;
    for (double nm = 360; nm <= 830; nm += 0.37) {
        double b[3];
        lum_colour_basis(nm, b);
        assert_close(b[0] + b[1] + b[2], 1, 1e-15);
        for (int k = 0; k < 3; ++k)
            assert_true(b[k] >= 0 && b[k] <= 1);
    }
    lum_spectrum white, r, lit;
    double w[3], xyz[3], back[3];
    lum_spectrum_illuminant("D65", &white);
    lum_spectrum_xyz(&white, xyz);
    lum_xyz_to_rgb(xyz, w);
    for (int i = 0; i < 64; ++i) {
        const double rgb[3] = {i % 4 / 3.0, i / 4 % 4 / 3.0, i / 16 / 3.0};
        lum_spectrum_of_reflectance(rgb, &r);
        for (int k = 0; k < LUM_SPECTRUM_COUNT; ++k) {
            assert_true(r.value[k] >= 0 && r.value[k] <= 1);
            lit.value[k] = r.value[k] * white.value[k];
        }
        if (rgb[0] == rgb[1] && rgb[1] == rgb[2])
            assert_true(r.value[17] == (float)rgb[0] && r.value[333] == (float)rgb[0]);
        lum_spectrum_xyz(&lit, xyz);
        lum_xyz_to_rgb(xyz, back);
        for (int k = 0; k < 3; ++k)
            assert_close(back[k] / w[k], rgb[k], 3e-7); /* the table's rounding to six decimals; floats */
        lum_spectrum_of_light(rgb, &lit);
        lum_spectrum_xyz(&lit, xyz);
        lum_xyz_to_rgb(xyz, back);
        for (int k = 0; k < 3; ++k)
            assert_close(back[k], rgb[k], 3e-7);
    }
}

/* Against CIE's own tables. */
static void published_spectra(void **state)
{
    (void)state;
    char path[512];
    /* CIE 15:2004, table T.8. */
    static const struct {
        const char *name;
        double x, y, kelvin;
    } lamps[] = {{"f1", .3131, .3371, 6430},  {"f2", .3721, .3751, 4230},  {"f3", .4091, .3941, 3450},  {"f4", .4402, .4031, 2940},
                 {"f5", .3138, .3452, 6350},  {"f6", .3779, .3882, 4150},  {"f7", .3129, .3292, 6500},  {"f8", .3458, .3586, 5000},
                 {"f9", .3741, .3727, 4150},  {"f10", .3458, .3588, 5000}, {"f11", .3805, .3769, 4000}, {"f12", .4370, .4042, 3000},
                 {"hp1", .533, .415, 1959},   {"hp2", .4778, .4158, 2506}};
    for (size_t i = 0; i < sizeof lamps / sizeof *lamps; ++i) {
        char name[64];
        snprintf(name, sizeof name, "cie/illuminants_%s.json", lamps[i].name);
        if (!shared_file(name, path))
            continue;
        lum_spectrum s;
        lmg_error err;
        double xyz[3], kelvin, duv;
        if (lum_spectrum_read(path, LUM_SPECTRUM_ZERO, 0, 1e6, &s, &err))
            fail_msg("%s", err.message);
        lum_spectrum_xyz(&s, xyz);
        /* The CIE adds the products at 5 nm; linear between rows we differ for lamps with lines. */
        assert_true(uv_distance(xyz, lamps[i].x, lamps[i].y) < 1e-3);
        assert_true(lum_cct(xyz, &kelvin, &duv));
        assert_close(kelvin, lamps[i].kelvin, 0.006 * lamps[i].kelvin);
    }
    static const char *const hopeless[] = {"lamp_uv222_beacon.csv", "lamp_uv222_ushio_b1.csv"};
    for (int i = 0; i < 2; ++i)
        if (shared_file(hopeless[i], path)) { /* ultraviolet lamps; one with negative noise */
            lum_spectrum s;
            lmg_error err = {{0}};
            assert_int_equal(lum_spectrum_read(path, LUM_SPECTRUM_ZERO, 0, 1e6, &s, &err), LMG_ERROR_INPUT);
            assert_non_null(strstr(err.message, hopeless[i]));
        }
    snprintf(path, sizeof path, "%s/rayfiles/LEDWhite.txt", LUMIBOX_SHARED_DATA);
    FILE *f = fopen(path, "rb");
    if (!f) {
        printf("skipped: no %s\n", path);
        return;
    }
    fclose(f);
    lum_spectrum s;
    lmg_error err;
    double xyz[3], kelvin, duv;
    if (lum_spectrum_read(path, LUM_SPECTRUM_ZERO, 0, 1e6, &s, &err))
        fail_msg("%s", err.message);
    lum_spectrum_xyz(&s, xyz);
    assert_true(lum_cct(xyz, &kelvin, &duv));
    assert_true(kelvin > 4000 && kelvin < 8000 && fabs(duv) < 0.02);
}

/* Against the CIE's table at 1 nm: what lum_observer's comment says. */
static void observer(void **state)
{
    (void)state;
    char path[512];
    double xyz[3];
    lum_observer(555, xyz);
    assert_close(xyz[1], 1, 1e-12);
    lum_observer(359.9, xyz);
    assert_true(xyz[0] == 0 && xyz[1] == 0 && xyz[2] == 0);
    if (!shared_file("cie/observers_cie-1931-2.json", path))
        return;
    FILE *f = fopen(path, "rb");
    char *text = calloc(1, 1 << 20);
    assert_non_null(f);
    assert_true(text && fread(text, 1, (1 << 20) - 1, f) > 0);
    fclose(f);
    char *p = strstr(text, "\"xyz\"");
    assert_non_null(p);
    double worst = 0;
    for (int c = 0; c < 3; ++c) {
        double sum = 0, ours = 0;
        for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
            while (!(*p >= '0' && *p <= '9'))
                ++p;
            const double cie = strtod(p, &p);
            lum_observer(LUM_NM_FIRST + i, xyz);
            worst = fmax(worst, fabs(cie - xyz[c]));
            sum += cie;
            ours += xyz[c];
        }
        assert_close(ours / sum, 1, 1.1e-6);
    }
    free(text);
    assert_true(worst < 0.0024);
}

/* ---------------------------------------------------------------------------------------------------------- indices */

static void indices(void **state)
{
    (void)state;
    /* n_d and V_d of the catalogues; of the plastics n_d as measured in the paper whose formula we use. */
    static const struct {
        const char *name;
        double n, v;
    } cases[] = {{"N-BK7", 1.51680, 64.17},       {"N-F2", 1.62005, 36.43},   {"N-SF10", 1.72828, 28.53},   {"N-SF11", 1.78472, 25.68},
                 {"fused-silica", 1.45846, 67.8}, {"sapphire", 1.76817, 72.3}, {"PMMA", 1.4906, 0}, {"polycarbonate", 1.5848, 0},
                 {"B270", 1.5230, 58.76}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; ++i) {
        lum_index_model m;
        lum_spectrum s;
        lmg_error err;
        assert_true(lum_index_of_glass(cases[i].name, &m));
        assert_non_null(strstr(lum_glass_names(), cases[i].name));
        const double n = lum_index_at(&m, LUM_NM_D), v = (n - 1) / (lum_index_at(&m, LUM_NM_F) - lum_index_at(&m, LUM_NM_C));
        assert_close(n, cases[i].n, 6e-5);
        if (cases[i].v > 0)
            assert_close(v, cases[i].v, 0.006 * cases[i].v);
        assert_int_equal(lum_spectrum_of_index(&m, &s, &err), LMG_OK);
        assert_close(lum_spectrum_at(&s, LUM_NM_F), lum_index_at(&m, LUM_NM_F), 2e-6); /* linear within a nanometre; floats */
    }
    const lum_index_model abbe = {LUM_INDEX_ABBE, {1.5, 30}};
    assert_close(lum_index_at(&abbe, LUM_NM_D), 1.5, 1e-15);
    assert_close(0.5 / (lum_index_at(&abbe, LUM_NM_F) - lum_index_at(&abbe, LUM_NM_C)), 30, 1e-12);
    const lum_index_model cauchy = {LUM_INDEX_CAUCHY, {1.5, 0.005, 1e-4}};
    assert_close(lum_index_at(&cauchy, 500), 1.5 + 0.02 + 1.6e-3, 1e-12);

    lum_spectrum s;
    lmg_error err;
    const lum_index_model low = {LUM_INDEX_CAUCHY, {0.99, 0.005, 0}}, pole = {LUM_INDEX_SELLMEIER, {1, 0.25, 0, 0, 0, 0}};
    assert_int_equal(lum_spectrum_of_index(&low, &s, &err), LMG_ERROR_INPUT);
    assert_non_null(strstr(err.message, "outside [1, 4]"));
    assert_int_equal(lum_spectrum_of_index(&pole, &s, &err), LMG_ERROR_INPUT);
}

/* The coarse tables agree with the three wavelengths of colour.c, which come from the same papers. */
static void metals(void **state)
{
    (void)state;
    char names[200], *save = NULL;
    snprintf(names, sizeof names, "%s", lum_metal_names());
    for (char *name = strtok_r(names, ", ", &save); name; name = strtok_r(NULL, ", ", &save)) {
        static const double nm[3] = {610, 550, 465};
        lum_spectrum eta, k;
        float e[3], x[3];
        assert_true(lum_metal(name, e, x));
        assert_true(lum_spectrum_of_metal(name, &eta, &k));
        for (int i = 0; i < 3; ++i) {
            assert_close(lum_spectrum_at(&eta, nm[i]), (double)e[i], 0.002);
            assert_close(lum_spectrum_at(&k, nm[i]), (double)x[i], 0.002);
        }
    }
    lum_spectrum eta, k;
    assert_false(lum_spectrum_of_metal("unobtainium", &eta, &k));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tables_keep_integrals), cmocka_unit_test(tables_that_are_wrong), cmocka_unit_test(dialects),
        cmocka_unit_test(illuminants),           cmocka_unit_test(black_bodies),          cmocka_unit_test(colours_round_trip),
        cmocka_unit_test(spectra_of_colours),    cmocka_unit_test(published_spectra),     cmocka_unit_test(observer),
        cmocka_unit_test(indices),               cmocka_unit_test(metals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
