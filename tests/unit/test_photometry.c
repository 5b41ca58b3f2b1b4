/* SPDX-License-Identifier: Apache-2.0 */
/* Photometric files written for the purpose: every dialect, symmetry and shape; orientation; closed forms; and files broken in
 * every way, which get one clear line each. */
#include <luminaires/photometry.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "fuzz.h"
#include "photometry_corpus.h"

static const double PI = 3.14159265358979323846;
static const double ROUNDING = 1e-12;

static lum_photometry *read_text(const char *text)
{
    lum_photometry *p;
    lmg_error err = {""};
    if (lum_photometry_read_memory(text, strlen(text), NULL, &p, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return p;
}

static double at(const lum_photometry *p, double c, double gamma)
{
    return lum_photometry_intensity(p, lum_direction_from_c_gamma(c, gamma));
}

static void assert_near(double a, double b)
{
    if (!(fabs(a - b) <= 1e-9 * (1 + fabs(b))))
        fail_msg("%.12g is not %.12g", a, b);
}

/* ------------------------------------------------------------------------------------------------------------ the frame */

static void directions_are_as_documented(void **state)
{
    (void)state;
    static const struct {
        double c, gamma;
        lmg_vec3 d;
    } known[] = {{0, 0, {0, -1, 0}},    {0, 90, {1, 0, 0}},   {90, 90, {0, 0, -1}},
                 {180, 90, {-1, 0, 0}}, {270, 90, {0, 0, 1}}, {33, 180, {0, 1, 0}}};
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        const lmg_vec3 d = lum_direction_from_c_gamma(known[i].c, known[i].gamma), w = known[i].d;
        assert_true(hypot(hypot(d.x - w.x, d.y - w.y), d.z - w.z) < 1e-15);
    }
    for (int i = 0; i < 360; i += 7)
        for (int j = 1; j < 180; j += 11) {
            double c, gamma;
            lum_direction_to_c_gamma(lum_direction_from_c_gamma(i, j), &c, &gamma);
            assert_true(fabs(c - i) < ROUNDING * 360 && fabs(gamma - j) < ROUNDING * 180);
        }
}

/* One function of direction on the grids of all types and symmetries: they agree where it has the symmetry. */
static double wave(lmg_vec3 d, int kind)
{
    const double x = kind == 0   ? d.x + 0.3 * d.z
                     : kind == 1 ? 0
                     : kind == 2 ? d.x + d.z * d.z
                     : kind == 3 ? d.z + d.x * d.x
                                 : d.x * d.x - 0.5 * d.z * d.z;
    return 100 * (2 + x - 0.8 * d.y);
}

static lum_photometry *sampled(lum_photometry_type type, lum_symmetry symmetry, int kind, uint32_t n, uint32_t m)
{
    static const double ranges[][2] = {{0, 360}, {0, 0}, {0, 180}, {-90, 90}, {0, 90}};
    lum_photometry *p;
    assert_int_equal(lum_photometry_create(n, m, &p, NULL), LMG_OK);
    p->type = type;
    p->symmetry = symmetry;
    const double low = type == LUM_TYPE_C ? ranges[symmetry][0] : type == LUM_TYPE_B ? -90 : -180;
    const double high = type == LUM_TYPE_C ? ranges[symmetry][1] : type == LUM_TYPE_B ? 90 : 180;
    for (uint32_t i = 0; i < n; i++)
        p->h[i] = n > 1 ? low + (high - low) * i / (n - 1) : 0;
    for (uint32_t j = 0; j < m; j++)
        p->v[j] = type == LUM_TYPE_C ? 180.0 * j / (m - 1) : -90 + 180.0 * j / (m - 1);
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t j = 0; j < m; j++) {
            lmg_vec3 d = lum_direction_from_c_gamma(p->h[i], p->v[j]);
            const double h = p->h[i] * PI / 180, v = p->v[j] * PI / 180;
            if (type == LUM_TYPE_B) /* planes about C90-C270, v from down towards C0, h towards C270 */
                d = (lmg_vec3){cos(h) * sin(v), -cos(h) * cos(v), sin(h)};
            if (type == LUM_TYPE_A) /* planes about the vertical, v from the horizontal up, h clockwise seen from above */
                d = (lmg_vec3){cos(v) * cos(h), sin(v), cos(v) * sin(h)};
            p->intensity[(size_t)i * m + j] = wave(d, kind);
        }
    lmg_error err;
    if (lum_photometry_check(p, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return p;
}

static void types_and_symmetries_name_the_same_directions(void **state)
{
    (void)state;
    static const struct {
        lum_photometry_type type;
        lum_symmetry symmetry;
        int kind;
        uint32_t n, m;
    } cases[] = {{LUM_TYPE_C, LUM_SYMMETRY_NONE, 0, 181, 181},    {LUM_TYPE_C, LUM_SYMMETRY_AXIAL, 1, 1, 181},
                 {LUM_TYPE_C, LUM_SYMMETRY_C0_C180, 2, 91, 181},  {LUM_TYPE_C, LUM_SYMMETRY_C90_C270, 3, 91, 181},
                 {LUM_TYPE_C, LUM_SYMMETRY_QUADRANT, 4, 46, 181}, {LUM_TYPE_A, LUM_SYMMETRY_NONE, 0, 181, 181},
                 {LUM_TYPE_B, LUM_SYMMETRY_NONE, 0, 181, 181}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        lum_photometry *p = sampled(cases[k].type, cases[k].symmetry, cases[k].kind, cases[k].n, cases[k].m);
        /* Linear interpolation over 2 x 1 (type B 1 x 1) degrees: h^2/8 times the second derivatives, at most 100 x (2 + 4) rad^-2.
         */
        const double bound = 600 * (2.0 * 2.0 + 1) / 8 * (PI / 180) * (PI / 180);
        for (int i = 0; i < 400; i++) {
            const double y = cos(2.4 * i) * (i % 2 ? 0.9 : 1), phi = 1.7 * i, across = sqrt(1 - y * y);
            lmg_vec3 d = {across * cos(phi), y, across * sin(phi)};
            if (cases[k].type == LUM_TYPE_B)
                d.y = -fabs(d.y); /* v stops at +-90 */
            assert_true(fabs(lum_photometry_intensity(p, d) - wave(d, cases[k].kind)) < bound);
        }
        lum_photometry *q;
        assert_int_equal(lum_photometry_resample(p, 0, 0, &q, NULL), LMG_OK);
        for (int i = 0; i < 100 && cases[k].type == LUM_TYPE_C && cases[k].n > 1; i++) /* unfolding changes nothing */
            assert_near(at(q, 3.7 * i, 1.8 * i), at(p, 3.7 * i, 1.8 * i));
        lum_photometry_destroy(q);
        lum_photometry_destroy(p);
    }
}

static void fluxes_of_closed_forms(void **state)
{
    (void)state;
    /* Isotropic: 4 pi I, whatever the angles.  Lambertian: pi I0, with the error of linear interpolation in 5 degrees: h^2/12. */
    lum_photometry *p, *q;
    assert_int_equal(lum_photometry_create(1, 5, &p, NULL), LMG_OK);
    p->symmetry = LUM_SYMMETRY_AXIAL;
    const double v[5] = {0, 17, 44, 101, 180};
    for (int j = 0; j < 5; j++) {
        p->v[j] = v[j];
        p->intensity[j] = 250;
    }
    lum_photometry_measures m;
    assert_int_equal(lum_photometry_measure(p, &m, NULL), LMG_OK);
    assert_near(m.flux, 1000 * PI);
    assert_near(m.up, 500 * PI);
    for (int k = 0; k < LUM_ZONES; k++)
        assert_near(m.zonal[k], 500 * PI * (cos(10 * k * PI / 180) - cos(10 * (k + 1) * PI / 180)));
    assert_near(m.beam_angle, 360);
    lum_photometry_destroy(p);
    assert_int_equal(lum_photometry_create(1, 19, &p, NULL), LMG_OK);
    p->symmetry = LUM_SYMMETRY_AXIAL;
    p->power = 10;
    p->lamp_sets[0].flux = 4000;
    for (int j = 0; j < 19; j++) {
        p->v[j] = 5 * j;
        p->intensity[j] = 1000 * cos(5 * j * PI / 180) * (j < 18);
    }
    assert_int_equal(lum_photometry_measure(p, &m, NULL), LMG_OK);
    const double step = 5 * PI / 180;
    assert_true(fabs(m.flux / (1000 * PI) - 1 + step * step / 12) < step * step / 120);
    assert_near(m.efficiency, m.flux / 4000);
    assert_near(m.efficacy, m.flux / 10);
    /* Half of the peak at 60, a tenth at 84.26 degrees; the grid has 60, and 5 degree steps about the other. */
    assert_near(m.beam_c0, 120);
    assert_true(fabs(m.field_angle - 2 * 84.26) < 0.1);
    /* Against itself and against twice itself: Bergen's fit 100 and 100 (1 - 1/3). */
    lum_photometry_difference d;
    assert_int_equal(lum_photometry_compare(p, p, &d, NULL), LMG_OK);
    assert_true(d.bergen == 100 && d.bergen_weighted == 100 && d.rms_of_peak == 0 && d.flux_ratio == 1);
    assert_int_equal(lum_photometry_copy(p, &q, NULL), LMG_OK);
    for (int j = 0; j < 19; j++)
        q->intensity[j] *= 2;
    assert_int_equal(lum_photometry_compare(q, p, &d, NULL), LMG_OK);
    assert_near(d.bergen, 100 * (1 - 1.0 / 3));
    assert_near(d.bergen_weighted, 100 * (1 - 1.0 / 3));
    assert_near(d.largest_of_peak, 1);
    assert_near(d.flux_ratio, 2);
    lum_photometry_destroy(q);
    lum_photometry_destroy(p);
}

/* A constant comes back exactly (bumps add up to 1); a smooth lobe ever better with the level; what is asked for is met. */
static void smooth_reconstruction_on_the_octahedron(void **state)
{
    (void)state;
    lum_photometry *p = sampled(LUM_TYPE_C, LUM_SYMMETRY_QUADRANT, 4, 46, 91);
    lum_octahedron *o;
    lmg_error err;
    double last = 1;
    for (unsigned l = 0; l <= 4; l++) {
        assert_int_equal(lum_octahedron_create(p, l, 0, &o, &err), LMG_OK);
        const lum_octahedron_report r = lum_octahedron_get_report(o);
        assert_int_equal(r.level, l);
        assert_true(r.mean_error < last && r.mean_error <= r.rms_error);
        last = r.mean_error;
        double worst = 0;
        for (int i = 0; i < 500; i++) { /* the report says what the look-up does */
            const lmg_vec3 d = lum_direction_from_c_gamma(77.7 * i, 180 * (i + 0.5) / 500);
            worst = fmax(worst, fabs(lum_octahedron_intensity(o, d) - lum_photometry_intensity(p, d)));
        }
        assert_true(worst < 12 * r.rms_error * 200);
        lum_octahedron_destroy(o);
    }
    assert_true(last < 0.001);
    assert_int_equal(lum_octahedron_create(p, 6, 0.01, &o, &err), LMG_OK);
    lum_octahedron_report r = lum_octahedron_get_report(o);
    /* The stopping rule sees its own 36864 directions, the report others: a tenth apart at most. */
    assert_true(r.mean_error < 0.011 && r.bytes == 6 * r.coefficients && r.coefficients < 300);
    lum_octahedron_destroy(o);
    for (size_t i = 0; i < (size_t)p->h_count * p->v_count; i++)
        p->intensity[i] = 123;
    assert_int_equal(lum_octahedron_create(p, 2, 0, &o, &err), LMG_OK);
    for (int i = 0; i < 100; i++) /* shares are kept as float while fitting */
        assert_true(fabs(lum_octahedron_intensity(o, lum_direction_from_c_gamma(13.1 * i, 1.8 * i)) - 123) < 123 * 1e-5);
    lum_octahedron_destroy(o);
    assert_int_equal(lum_octahedron_create(p, 7, 0, &o, &err), LMG_ERROR_ARGUMENT);
    assert_null(o);
    memset(p->intensity, 0, (size_t)p->h_count * p->v_count * sizeof *p->intensity);
    assert_int_equal(lum_octahedron_create(p, 2, 0, &o, &err), LMG_ERROR_INPUT);
    lum_photometry_destroy(p);
}

/* ------------------------------------------------------------------------------------------------------------- dialects */

static void ies_dialects(void **state)
{
    (void)state;
    /* 1986: no header; feet; a second factor for the ballast; numbers broken anywhere, commas, tabs. */
    lum_photometry *p = read_text(
        "SOME LUMINAIRE\n10 APRIL 1987\nTILT=NONE\n2,1000\t1.5\n3 2 1 1 1 2 0.5 0.9,0.8 40\n0 45\n90 0 90\n10 20\n30 40 50 60\n");
    assert_string_equal(p->format, "IES LM-63-1986");
    assert_int_equal(p->symmetry, LUM_SYMMETRY_QUADRANT);
    assert_near(at(p, 0, 45), 20 * 1.5 * 0.9 * 0.8);
    assert_near(at(p, 270, 90), 60 * 1.5 * 0.9 * 0.8);
    assert_near(at(p, 180, 91), 0);
    assert_near(p->lamp_sets[0].flux, 2000);
    assert_near(p->shape.c0, 2 * 0.3048);
    assert_near(p->shape.c90, 0.3048);
    assert_int_equal(p->shape.kind, LUM_SHAPE_BOX);
    assert_string_equal(lum_photometry_keyword(p, "OTHER"), "SOME LUMINAIRE");
    lum_photometry_destroy(p);
    /* 2002: the second factor is for future use.  Latin-1, CR LF, [MORE], keywords without blank. */
    p = read_text("IESNA:LM-63-2002\r\n[TEST]1\r\n[MANUFAC] B\xfcro\r\n[MORE] und mehr\r\n[NEARFIELD] 1 2 3\r\n TILT = NONE \r\n1 "
                  "-1 2 2 3 1 2 0 0 0\r\n1 0.5 40\r\n0 "
                  "90\r\n0 90 180\r\n1 2\r\n3 4\r\n5 6\r\n\x1a");
    assert_string_equal(lum_photometry_keyword(p, "MANUFAC"), "B\xc3\xbcro");
    assert_string_equal(lum_photometry_keyword(p, "NEARFIELD"), "1 2 3");
    assert_string_equal(p->keywords[2].name, "MORE");
    assert_true(p->absolute);
    assert_int_equal(p->symmetry, LUM_SYMMETRY_C0_C180);
    assert_near(at(p, 270, 90), 8);
    assert_near(at(p, 200, 90), 2 * (4 + 2 * 70.0 / 90)); /* between planes 90 and 180 */
    assert_string_equal(p->warnings, "");
    lum_photometry_destroy(p);
    /* 1995: 90..270; TILT=INCLUDE. */
    p = read_text(
        "IESNA:LM-63-1995\nTILT=INCLUDE\n1\n2\n0 90\n1 0.8\n1 1000 1 2 3 1 2 0 0 0 1 1 9\n0 90\n90 180 270\n1 2\n3 4\n5 6\n");
    assert_int_equal(p->symmetry, LUM_SYMMETRY_C90_C270);
    assert_near(at(p, 90, 90), 2);
    assert_near(at(p, 180, 90), 4);
    assert_near(at(p, 0, 90), 4);
    assert_near(at(p, 270, 90), 6);
    assert_near(at(p, 45, 90), 3);
    assert_int_equal(p->tilt.count, 2);
    assert_near(p->tilt.factors[1], 0.8);
    lum_photometry_destroy(p);
    /* Decimal commas; a TILT file that isn't there; a circle without 360; an odd unit. */
    p = read_text("IESNA91\n[OTHER] values in mW/sr\nTILT=lamp.tlt\n1 -1 1 2 4 1 2 0 0 0\n1 1 1\n0 90\n0 90 180 270\n1,5 2\n3 "
                  "4,25\n5 6\n7 8\n");
    assert_near(at(p, 0, 0), 1.5);
    assert_near(at(p, 90, 90), 4.25);
    assert_near(at(p, 315, 90), 5);
    assert_string_equal(p->unit, "mW/sr");
    assert_non_null(strstr(p->warnings, "TILT"));
    assert_non_null(strstr(p->warnings, "decimal commas"));
    lum_photometry_destroy(p);
    /* Types B and A; both symmetric to the sides. */
    p = read_text("IES:LM-63-2019\nTILT=NONE\n1 -1 1 3 2 2 2 0 0 0\n1 1.00010 1\n-90 0 90\n0 90\n1 2 3\n4 5 6\n");
    assert_int_equal(p->type, LUM_TYPE_B);
    assert_int_equal(p->symmetry, LUM_SYMMETRY_LATERAL);
    assert_near(lum_photometry_intensity(p, (lmg_vec3){0, -1, 0}), 2);
    assert_near(lum_photometry_intensity(p, (lmg_vec3){1, 0, 0}), 3);
    assert_near(lum_photometry_intensity(p, (lmg_vec3){-1, 0, 0}), 1);
    assert_near(lum_photometry_intensity(p, (lmg_vec3){sqrt(0.5) * sqrt(0.5), -sqrt(0.5) * sqrt(0.5), sqrt(0.5)}),
                0.5 * 2.5 + 0.5 * 5.5);
    lum_photometry_destroy(p);
    p = read_text("IES:LM-63-2019\nTILT=NONE\n1 -1 1 3 3 3 2 0 0 0\n1 1.00010 1\n-90 0 90\n-90 0 90\n1 2 3\n4 5 6\n7 8 9\n");
    assert_int_equal(p->type, LUM_TYPE_A);
    assert_near(lum_photometry_intensity(p, (lmg_vec3){1, 0, 0}), 5);
    assert_near(lum_photometry_intensity(p, (lmg_vec3){0, 0, 1}), 8); /* h = 90, clockwise: C270 */
    assert_near(lum_photometry_intensity(p, (lmg_vec3){-1, 0, 0}), 0);
    lum_photometry_destroy(p);
}

static void a_tilt_file_is_read_from_beside(void **state)
{
    (void)state;
    FILE *f = fopen("photometry_tilt.ies", "w"), *t = fopen("photometry_lamp.tlt", "w");
    assert_true(f && t);
    fputs("IESNA:LM-63-2002\nTILT=C:\\FILES\\photometry_lamp.tlt\n1 100 1 2 1 1 2 0 0 0\n1 1 9\n0 90\n0\n1 2\n", f);
    fputs("2\n3\n0 45 90\n1 .9 .8\n", t);
    fclose(f);
    fclose(t);
    lum_photometry *p;
    assert_int_equal(lum_photometry_read("photometry_tilt.ies", &p, NULL), LMG_OK);
    assert_int_equal(p->tilt.geometry, 2);
    assert_int_equal(p->tilt.count, 3);
    assert_near(p->tilt.factors[1], 0.9);
    assert_string_equal(p->warnings, "");
    lum_photometry_destroy(p);
    unlink("photometry_tilt.ies");
    unlink("photometry_lamp.tlt");
}

static void luminous_shapes_by_sign(void **state)
{
    (void)state;
    static const struct {
        const char *version;
        double w, l, h;
        lum_shape_kind kind;
        double c0, c90, height;
    } cases[] = {{"IESNA:LM-63-2002", 0, 0, 0, LUM_SHAPE_POINT, 0, 0, 0},
                 {"IESNA:LM-63-2002", .1, .2, 0, LUM_SHAPE_RECTANGLE, .2, .1, 0},
                 {"IESNA:LM-63-2002", 0, .2, 0, LUM_SHAPE_RECTANGLE, .2, 0, 0},
                 {"IESNA:LM-63-2002", .1, .2, .3, LUM_SHAPE_BOX, .2, .1, .3},
                 {"IESNA:LM-63-2002", -.1, -.1, 0, LUM_SHAPE_ELLIPSE, .1, .1, 0},
                 {"IESNA:LM-63-2002", -.1, -.2, .3, LUM_SHAPE_CYLINDER, .2, .1, .3},
                 {"IESNA:LM-63-2002", -.1, -.2, -.3, LUM_SHAPE_ELLIPSOID, .2, .1, .3},
                 {"IES:LM-63-2019", -.1, .2, -.3, LUM_SHAPE_CYLINDER_C0, .2, .1, .3},
                 {"IES:LM-63-2019", .1, -.2, -.3, LUM_SHAPE_CYLINDER_C90, .2, .1, .3},
                 {"IES:LM-63-2019", -.1, 0, -.3, LUM_SHAPE_ELLIPSE_FACING_C0, 0, .1, .3},
                 {"IESNA:LM-63-1995", -.1, 0, 0, LUM_SHAPE_ELLIPSE, .1, .1, 0},
                 {"IESNA:LM-63-1995", -.1, 0, .3, LUM_SHAPE_CYLINDER, .1, .1, .3},
                 {"IESNA:LM-63-1995", -.1, 0, -.1, LUM_SHAPE_ELLIPSOID, .1, .1, .1},
                 {"IESNA:LM-63-1995", 0, .2, -.1, LUM_SHAPE_CYLINDER_C0, .2, .1, .1},
                 {"IESNA91", .2, 0, -.1, LUM_SHAPE_CYLINDER_C90, .1, .2, .1},
                 {"IESNA91", -.1, .2, 0, LUM_SHAPE_ELLIPSE, .2, .1, 0},
                 {"IESNA:LM-63-1995", -.1, .2, -.3, LUM_SHAPE_ELLIPSOID, .2, .1, .3},
                 {"IESNA:LM-63-1995", -.1, -.1, 0, LUM_SHAPE_ELLIPSE, .1, .1, 0}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char text[512];
        snprintf(text, sizeof text, "%s\nTILT=NONE\n1 -1 1 2 1 1 2 %g %g %g\n1 1 1\n0 90\n0\n1 2\n", cases[i].version, cases[i].w,
                 cases[i].l, cases[i].h);
        lum_photometry *p = read_text(text);
        if (p->shape.kind != cases[i].kind)
            fail_msg("%s %g %g %g is shape %d, not %d", cases[i].version, cases[i].w, cases[i].l, cases[i].h, p->shape.kind,
                     cases[i].kind);
        assert_near(p->shape.c0, cases[i].c0);
        assert_near(p->shape.c90, cases[i].c90);
        assert_near(p->shape.height, cases[i].height);
        lum_photometry_destroy(p);
    }
}

/* EULUMDAT: planes at 0, 60, 90, 120, 180, 240, 270, 300 with gamma 0 and 90; intensities count up. */
static void eulumdat_symmetries(void **state)
{
    (void)state;
    static const struct {
        int isym;
        lum_symmetry symmetry;
        int planes;
        double plane[8]; /* where stored plane k must turn up */
        double mirror;   /* and where plane 1 must too */
    } cases[] = {{0, LUM_SYMMETRY_NONE, 8, {0, 60, 90, 120, 180, 240, 270, 300}, 60},
                 {1, LUM_SYMMETRY_AXIAL, 1, {0}, 0},
                 {2, LUM_SYMMETRY_C0_C180, 5, {0, 60, 90, 120, 180}, 300},
                 {3, LUM_SYMMETRY_C90_C270, 5, {270, 300, 0, 60, 90}, 240},
                 {4, LUM_SYMMETRY_QUADRANT, 3, {0, 60, 90}, 240}};
    for (size_t k = 0; k < 5; k++) {
        char text[2048];
        int n = snprintf(
            text, sizeof text,
            "Lichtwerk\n1\n%d\n8\n0\n2\n90\nR "
            "1\nName\nNr\nfile\n1.1.2020\n600\n0\n80\n500\n0\n10\n20\n30\n40\n100\n80\n1,0\n0\n1\n2\nLED\n2000\n3000 K\n80\n12,5\n",
            cases[k].isym);
        for (int i = 0; i < 10; i++)
            n += snprintf(text + n, sizeof text - (size_t)n, "0.%d\n", i);
        n += snprintf(text + n, sizeof text - (size_t)n, "0\n60\n90\n120\n180\n240\n270\n300\n0\n90\n");
        for (int i = 0; i < cases[k].planes; i++)
            n += snprintf(text + n, sizeof text - (size_t)n, "100\n%d,5\n", 10 * (i + 1));
        lum_photometry *p = read_text(text);
        assert_int_equal(p->symmetry, cases[k].symmetry);
        for (int i = 0; i < cases[k].planes; i++) /* cd/klm x 2 klm */
            assert_near(at(p, cases[k].plane[i], 90), 2 * (10 * (i + 1) + 0.5));
        if (cases[k].planes > 1)
            assert_near(at(p, cases[k].mirror, 90), 2 * 20.5);
        assert_near(p->power, 12.5);
        assert_near(p->lamp_sets[0].flux, 2000);
        assert_int_equal(p->shape.kind, LUM_SHAPE_CYLINDER); /* width 0: round */
        assert_near(p->shape.height, 0.025);
        assert_near(p->side_heights[3], 0.04);
        assert_true(p->has_direct_ratios);
        lum_photometry_destroy(p);
    }
}

/* Every field that a format has a place for comes back. */
static void descriptions_come_back(void **state)
{
    (void)state;
    lum_photometry *p = read_text(CORPUS_LDT), *q;
    lmg_error err;
    char loss[512];
    const lum_photometry_write_options options = {.struct_size = sizeof options, .date = "2026-01-01"};
    assert_int_equal(lum_photometry_write(p, "photometry_again.ldt", &options, loss, &err), LMG_OK);
    assert_string_equal(loss, "");
    assert_int_equal(lum_photometry_read("photometry_again.ldt", &q, &err), LMG_OK);
    assert_int_equal(q->keyword_count, p->keyword_count);
    for (uint32_t i = 0; i < p->keyword_count; i++)
        assert_string_equal(lum_photometry_keyword(q, p->keywords[i].name), p->keywords[i].value);
    assert_int_equal(q->lamp_set_count, 2);
    for (int i = 0; i < 2; i++) {
        assert_int_equal(q->lamp_sets[i].count, p->lamp_sets[i].count);
        assert_near(q->lamp_sets[i].flux, p->lamp_sets[i].flux);
        assert_near(q->lamp_sets[i].power, p->lamp_sets[i].power);
        assert_string_equal(q->lamp_sets[i].type, p->lamp_sets[i].type);
        assert_string_equal(q->lamp_sets[i].colour, p->lamp_sets[i].colour);
        assert_string_equal(q->lamp_sets[i].cri, p->lamp_sets[i].cri);
    }
    for (int i = 0; i < 4; i++)
        assert_near(q->side_heights[i], p->side_heights[i]);
    for (int i = 0; i < 3; i++)
        assert_near(q->housing[i], p->housing[i]);
    for (int i = 0; i < LUM_DIRECT_RATIOS; i++)
        assert_near(q->direct_ratios[i], p->direct_ratios[i]);
    assert_near(q->measured_tilt, p->measured_tilt);
    lum_photometry_destroy(q);
    unlink("photometry_again.ldt");
    /* To IES: what is lost is said. */
    assert_int_equal(lum_photometry_write(p, "photometry_again.ies", &options, loss, &err), LMG_OK);
    assert_non_null(strstr(loss, "1 of 2 lamp sets"));
    assert_non_null(strstr(loss, "direct ratios"));
    unlink("photometry_again.ies");
    lum_photometry_destroy(p);
    /* IES keywords survive XML, long ones go on in [MORE]. */
    p = read_text(CORPUS_IES);
    char longest[700];
    memset(longest, 'x', sizeof longest);
    longest[sizeof longest - 1] = 0;
    assert_int_equal(lum_photometry_set_keyword(p, "LAMP", longest, &err), LMG_OK);
    assert_int_equal(lum_photometry_write(p, "photometry_again.ies", &options, loss, &err), LMG_OK);
    FILE *f = fopen("photometry_again.ies", "r");
    char line[1024];
    while (fgets(line, sizeof line, f)) {
        assert_true(strlen(line) <= 256);
        assert_non_null(strstr(line, "\r\n"));
    }
    fclose(f);
    assert_int_equal(lum_photometry_read("photometry_again.ies", &q, &err), LMG_OK);
    assert_int_equal(q->tilt.count, p->tilt.count);
    assert_string_equal(lum_photometry_keyword(q, "NEARFIELD"), lum_photometry_keyword(p, "NEARFIELD"));
    size_t total = 0;
    for (uint32_t i = 0; i < q->keyword_count; i++)
        if (strspn(q->keywords[i].value, "x") == strlen(q->keywords[i].value))
            total += strlen(q->keywords[i].value);
    assert_int_equal(total, 699);
    lum_photometry_destroy(q);
    lum_photometry_destroy(p);
    unlink("photometry_again.ies");
}

static void other_renderers_get_their_files(void **state)
{
    (void)state;
    lum_photometry *p = read_text(CORPUS_IES);
    lmg_error err;
    char text[65536];
    const lum_photometry_write_options options = {.struct_size = sizeof options, .date = "2026-01-01", .resolution = 64};
    static const char *const names[] = {"photometry_out.usda", "photometry_out.gltf", "photometry_out.exr"};
    for (int k = 0; k < 3; k++) {
        if (lum_photometry_write(p, names[k], &options, NULL, &err) != LMG_OK)
            fail_msg("%s", err.message);
        FILE *f = fopen(names[k], "rb");
        assert_non_null(f);
        text[fread(text, 1, sizeof text - 1, f)] = 0;
        fclose(f);
        if (k == 0) {
            assert_non_null(strstr(text, "@./photometry_out.ies@"));
            lum_photometry *q;
            assert_int_equal(lum_photometry_read("photometry_out.ies", &q, &err), LMG_OK);
            assert_near(at(q, 0, 45), at(p, 0, 45));
            lum_photometry_destroy(q);
        } else if (k == 1) {
            assert_non_null(strstr(text, "EXT_lights_ies"));
            assert_non_null(strstr(text, "KHR_lights_punctual"));
        } else {
            assert_memory_equal(text, "\x76\x2f\x31\x01", 4);
        }
        unlink(names[k]);
    }
    unlink("photometry_out.ies");
    assert_int_equal(lum_photometry_write(p, "photometry.txt", NULL, NULL, &err), LMG_ERROR_ARGUMENT);
    assert_int_equal(lum_photometry_write(p, "no/such/folder.ies", NULL, NULL, &err), LMG_ERROR_FILE_OPEN);
    p->intensity[0] = NAN;
    assert_int_equal(lum_photometry_write(p, "photometry_nan.ies", NULL, NULL, &err), LMG_ERROR_INPUT);
    assert_int_equal(access("photometry_nan.ies", F_OK), -1);
    lum_photometry_destroy(p);
}

/* ------------------------------------------------------------------------------------------------------------ bad files */

static void assert_refused(const char *text, size_t size, const char *wanted)
{
    lum_photometry *p = (lum_photometry *)&p;
    lmg_error err = {""};
    char *copy = malloc(size ? size : 1); /* of the exact size, so that a sanitizer sees reads beyond it */
    memcpy(copy, text, size);
    const lmg_result result = lum_photometry_read_memory(copy, size, "bad", &p, &err);
    free(copy);
    if (result == LMG_OK)
        fail_msg("accepted, but should say: %s", wanted);
    assert_int_equal(result, LMG_ERROR_INPUT);
    assert_null(p);
    assert_true(strncmp(err.message, "bad: ", 5) == 0);
    if (wanted && !strstr(err.message, wanted))
        fail_msg("\"%s\" doesn't say \"%s\"", err.message, wanted);
    for (const char *c = err.message; *c; c++)
        assert_true((unsigned char)*c >= 0x20);
}

static void broken_files_get_one_clear_line(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof corpus_bad / sizeof *corpus_bad; i++)
        assert_refused(corpus_bad[i].text, strlen(corpus_bad[i].text), corpus_bad[i].message);
    assert_refused("", 0, "is empty");
    assert_refused("\xef\xbb\xbf", 3, "is empty");
    assert_refused("IESNA91\0TILT=NONE", 17, "NUL");
    lum_photometry *p;
    lmg_error err;
    assert_int_equal(lum_photometry_read("no such file.ies", &p, &err), LMG_ERROR_FILE_OPEN);
    assert_int_equal(lum_photometry_read("/", &p, &err), LMG_ERROR_FILE_OPEN);
}

/* A file cut off anywhere is refused, or reads as the whole one does (what is missing was the end of the last number's line, or
 * trailing zeros of EULUMDAT, which has no end mark). */
static void truncated_at_every_length(void **state)
{
    (void)state;
    static const char *const texts[] = {CORPUS_IES, CORPUS_LDT, CORPUS_TM33, CORPUS_S001};
    for (int k = 0; k < 4; k++) {
        lum_photometry *whole = read_text(texts[k]);
        const size_t size = strlen(texts[k]);
        size_t accepted = 0;
        for (size_t n = 0; n < size; n++) {
            lum_photometry *p;
            lmg_error err = {""};
            char *copy = malloc(n ? n : 1);
            memcpy(copy, texts[k], n);
            const lmg_result result = lum_photometry_read_memory(copy, n, NULL, &p, &err);
            free(copy);
            if (result != LMG_OK) {
                assert_null(p);
                assert_true(err.message[0] != 0 && !strchr(err.message, '\n'));
                continue;
            }
            accepted++;
            assert_int_equal(p->h_count, whole->h_count);
            assert_memory_equal(p->intensity, whole->intensity, (size_t)p->h_count * p->v_count * sizeof *p->intensity);
            lum_photometry_destroy(p);
        }
        /* The corpus ends in one-digit zeros: of LM-63 the last line end can go, of EULUMDAT the three last zeros but one. */
        printf("file %d: %zu of %zu lengths read as the whole\n", k, accepted, size);
        assert_true(accepted <= 6);
        lum_photometry_destroy(whole);
    }
}

/* The fuzz target over its corpus: the files in small, the broken ones, and each of the whole ones with single bytes changed and
 * pieces doubled or dropped. */
static void the_fuzz_target_replays_its_corpus(void **state)
{
    (void)state;
    static const char *const texts[] = {CORPUS_IES, CORPUS_LDT, CORPUS_TM33, CORPUS_S001};
    static const char bytes[] = "\0\n -,.9e<>&\"/[]\xff";
    for (size_t i = 0; i < sizeof corpus_bad / sizeof *corpus_bad; i++)
        LLVMFuzzerTestOneInput((const uint8_t *)corpus_bad[i].text, strlen(corpus_bad[i].text));
    for (int k = 0; k < 4; k++) {
        const size_t size = strlen(texts[k]);
        uint8_t *copy = malloc(2 * size);
        LLVMFuzzerTestOneInput((const uint8_t *)texts[k], size);
        for (size_t i = 0; i < size; i++)
            for (size_t b = 0; b < sizeof bytes - 1; b++) {
                memcpy(copy, texts[k], size);
                copy[i] = (uint8_t)bytes[b];
                LLVMFuzzerTestOneInput(copy, size);
            }
        for (size_t from = 0; from < size; from += 7)
            for (size_t length = 1; length < size - from; length += 13) {
                memcpy(copy, texts[k], from); /* dropped */
                memcpy(copy + from, texts[k] + from + length, size - from - length);
                LLVMFuzzerTestOneInput(copy, size - length);
                memcpy(copy, texts[k], from + length); /* doubled */
                memcpy(copy + from + length, texts[k] + from, size - from);
                LLVMFuzzerTestOneInput(copy, size + length);
            }
        free(copy);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(directions_are_as_documented),
                                       cmocka_unit_test(types_and_symmetries_name_the_same_directions),
                                       cmocka_unit_test(fluxes_of_closed_forms),
                                       cmocka_unit_test(smooth_reconstruction_on_the_octahedron),
                                       cmocka_unit_test(ies_dialects),
                                       cmocka_unit_test(a_tilt_file_is_read_from_beside),
                                       cmocka_unit_test(luminous_shapes_by_sign),
                                       cmocka_unit_test(eulumdat_symmetries),
                                       cmocka_unit_test(descriptions_come_back),
                                       cmocka_unit_test(other_renderers_get_their_files),
                                       cmocka_unit_test(broken_files_get_one_clear_line),
                                       cmocka_unit_test(truncated_at_every_length),
                                       cmocka_unit_test(the_fuzz_target_replays_its_corpus)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
