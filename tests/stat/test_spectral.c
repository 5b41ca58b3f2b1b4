/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Light by wavelength through the photon tracer: sources of every kind keep their colour, a prism's deviation and spectrum, spectral
 * reflectance and absorption, metals, phosphor; the balance of light to the last bit, and independence of threads.  All seeds are fixed.
 * Statistical tolerances: 4.5 standard errors, p < 7e-6 for each of about 100 comparisons.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "source.h"

#include <luminaires/rng.h>
#include <luminaires/spectrum.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;
static const double SIGMAS = 4.5;

static lmg_vec3 v3(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

static void emit(lum_model *model, uint32_t material, const lum_spectrum *spectrum)
{
    lum_material *m = &model->materials[material];
    double rgb[3] = {1, 1, 1};
    if (spectrum)
        assert_true(lum_spectrum_rgb(spectrum, rgb));
    for (int k = 0; k < 3; ++k)
        m->emissive[k] = (float)(1000 * rgb[k]);
    m->spectral.emission = spectrum;
}

/* A light whose cone is a ray: 1e-6 radians. */
static void add_ray_light(lum_model *model, lmg_vec3 position, lmg_vec3 direction)
{
    model->lights = calloc(1, sizeof(*model->lights));
    assert_non_null(model->lights);
    model->light_count = 1;
    lum_light *l = &model->lights[0];
    strcpy(l->name, "ray");
    l->kind = LUM_LIGHT_SPOT;
    l->position = position;
    l->direction = direction;
    l->intensity[0] = l->intensity[1] = l->intensity[2] = 1000;
    l->cos_inner = 1;
    l->cos_outer = cos(1e-6);
}

/* A small quad far below that makes the model spectral and that little light meets. */
static void make_spectral(lum_model *m)
{
    static lum_spectrum half;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        half.value[i] = 0.5f;
    const uint32_t i = make_lambert(m, 0.5f);
    m->materials[i].spectral.reflectance = &half;
    make_quad(m, v3(0, -50, 0), v3(1e-3, 0, 0), v3(0, 0, 1e-3), 1, i);
}

typedef struct census {
    double sum[3], squares[3]; /* X, Y, Z of all rays, or of those that `take` takes */
    uint64_t rays, hash;
    bool (*take)(const struct census *self, const lmg_ray *ray);
    const lum_index_model *glass;
    uint64_t taken;
} census;

static uint64_t bits(double x)
{
    uint64_t b;
    memcpy(&b, &x, sizeof(b));
    return b;
}

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    census *c = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_ray *r = &rays[i];
        uint64_t h = r->number;
        const double values[6] = {r->direction.x, r->direction.y, (double)r->flux[0], (double)r->flux[1], (double)r->flux[2],
                                  (double)r->wavelength};
        for (int k = 0; k < 6; ++k)
            h = lum_mix64(h ^ bits(values[k]));
        c->hash += h;
        ++c->rays;
        if (c->take && !c->take(c, r))
            continue;
        ++c->taken;
        const double rgb[3] = {(double)r->flux[0], (double)r->flux[1], (double)r->flux[2]};
        double xyz[3];
        lum_rgb_to_xyz(rgb, xyz);
        for (int k = 0; k < 3; ++k) {
            c->sum[k] += xyz[k];
            c->squares[k] += xyz[k] * xyz[k];
        }
    }
}

/* Traces on one thread; checks the balance and that rays carry what the tally says. */
static bake_tally trace(const lum_model *model, uint64_t seed, uint64_t photons, census *c)
{
    bake_source *source;
    bake_tally t = {0};
    lmg_error err = {{0}};
    const lmg_sink sink = {c, consume};
    if (bake_tracer_create(model, seed, &source, &err) || source->run(source, 0, photons, 1, &sink, 1, &t, &err))
        fail_msg("%s", err.message);
    source->destroy(source);
    assert_true(t.emitted == t.escaped + t.absorbed + t.lost); /* whole parts of photons below 2^53: to the last bit */
    assert_true(t.emitted == (double)photons);
    assert_true(t.lost == 0);
    if (!c->take)
    {
        assert_true(fabs(c->sum[1] - t.escaped) <= 1e-6 * t.escaped); /* floats of R,G,B */
        assert_true(t.escaped_squares == 0 || fabs(c->squares[1] - t.escaped_squares) <= 2e-6 * t.escaped_squares);
    }
    return t;
}

/* The mean X,Y,Z per photon are as expected. */
static void assert_mean(const char *what, const census *c, double photons, const double expected[3])
{
    for (int k = 0; k < 3; ++k) {
        const double got = c->sum[k] / photons, variance = c->squares[k] / photons - got * got;
        const double error = sqrt(fmax(variance, 0) / photons);
        print_message("%s: %c %.5f +- %.5f, expected %.5f (relative variance %.2f)\n", what, "XYZ"[k], got, error, expected[k],
                      variance / (got * got));
        if (!(fabs(got - expected[k]) < SIGMAS * error + 2e-6 * expected[k])) /* floats */
            fail_msg("%s: %c is %g standard errors off", what, "XYZ"[k], (got - expected[k]) / error);
    }
}

/* X,Y,Z of a spectrum times a filter, over the spectrum's Y. */
static void filtered(const lum_spectrum *s, double (*filter)(double nm, const void *self), const void *self, double xyz[3])
{
    double y = 0;
    xyz[0] = xyz[1] = xyz[2] = 0;
    for (int i = 0; i < 4 * (LUM_SPECTRUM_COUNT - 1); ++i) { /* midpoints of quarters of a nanometre */
        const double nm = LUM_NM_FIRST + 0.25 * (i + 0.5), v = lum_spectrum_at(s, nm);
        double o[3];
        lum_observer(nm, o);
        y += v * o[1];
        for (int k = 0; k < 3; ++k)
            xyz[k] += v * o[k] * (filter ? filter(nm, self) : 1);
    }
    for (int k = 0; k < 3; ++k)
        xyz[k] /= y;
}

/* ------------------------------------------------------------------------------------------------------------- sources */

/* A source in the open keeps its X,Y,Z, temperature and distance from the black body. */
static void keeps_colour(const char *name, const lum_spectrum *s)
{
    const double photons = 200000;
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0);
    emit(m, source, s);
    make_quad(m, v3(0, 0, 0), v3(0, 0, 0.01), v3(0.01, 0, 0), 1, source);
    make_spectral(m);
    finish_model(m);
    census c = {0};
    trace(m, 7, (uint64_t)photons, &c);
    double expected[3], kelvin, duv, got_kelvin, got_duv;
    lum_spectrum_xyz(s, expected);
    const bool white = lum_cct(expected, &kelvin, &duv);
    const double y = expected[1];
    for (int k = 0; k < 3; ++k)
        expected[k] /= y;
    assert_mean(name, &c, photons, expected);
    if (white) {
        assert_true(lum_cct(c.sum, &got_kelvin, &got_duv));
        print_message("%s: %.0f K, duv %.5f; of the spectrum %.0f K, %.5f\n", name, got_kelvin, got_duv, kelvin, duv);
        assert_true(fabs(got_duv - duv) < 1e-3);
        double a[2], b[2], xy[2];
        lum_chromaticity(c.sum, xy, a);
        lum_chromaticity(expected, xy, b);
        assert_true(hypot(a[0] - b[0], (a[1] - b[1]) * 2 / 3) < 1e-3);
    }
    free_model(m);
}

static void sources_keep_their_colour(void **state)
{
    (void)state;
    lum_spectrum s;
    lum_spectrum_blackbody(1500, &s);
    keeps_colour("black body 1500 K", &s);
    lum_spectrum_blackbody(2700, &s);
    keeps_colour("black body 2700 K", &s);
    lum_spectrum_illuminant("D65", &s);
    keeps_colour("D65", &s);
    lum_spectrum_gaussian(450, 18, &s);
    keeps_colour("blue LED", &s);
    static const char *const files[] = {"cie/illuminants_f2.json", "cie/illuminants_f11.json", "cie/illuminants_hp1.json"};
    for (int i = 0; i < 3; ++i) {
        char path[512];
        lmg_error err;
        snprintf(path, sizeof(path), "%s/spectra/%s", LUMIBOX_SHARED_DATA, files[i]);
        if (lum_spectrum_read(path, LUM_SPECTRUM_ZERO, 0, 1e6, &s, &err) == LMG_OK)
            keeps_colour(files[i], &s);
        else
            print_message("skipped: no %s\n", path);
    }
}

/* Light given as R,G,B comes out as that, also where it is coloured by surfaces on the way: grey ones change nothing. */
static void colours_keep_their_colour(void **state)
{
    (void)state;
    const double photons = 200000;
    for (int i = 0; i < 3; ++i) {
        const float rgb[3][3] = {{1, 1, 1}, {3, 0.5f, 0.1f}, {0, 0, 1}};
        lum_model *m = make_model();
        const uint32_t source = make_lambert(m, 0);
        for (int k = 0; k < 3; ++k)
            m->materials[source].emissive[k] = 100 * rgb[i][k];
        make_quad(m, v3(0, 0, 0), v3(0, 0, 0.01), v3(0.01, 0, 0), 1, source);
        make_spectral(m);
        finish_model(m);
        census c = {0};
        trace(m, 8, (uint64_t)photons, &c);
        double expected[3];
        const double colour[3] = {(double)rgb[i][0], (double)rgb[i][1], (double)rgb[i][2]};
        lum_rgb_to_xyz(colour, expected);
        const double y = expected[1];
        for (int k = 0; k < 3; ++k)
            expected[k] /= y;
        assert_mean("R,G,B", &c, photons, expected);
        free_model(m);
    }
}

/* --------------------------------------------------------------------------------------------------------------- prism */

/* A prism whose faces meet at APEX; a ray in the x,y plane meets the first face, whose normal is -x, at INCIDENCE. */
static const double APEX = 35 * 0.01745329251994329577, INCIDENCE = 40 * 0.01745329251994329577;

static void add_prism(lum_model *m, uint32_t glass)
{
    /* Apex up at (0, h); first face x = 0; the second leans back from it by APEX. */
    const double h = 0.05, b = h * tan(APEX), w = 0.05;
    const lmg_vec3 top[2] = {{0, h, -w}, {0, h, w}}, near[2] = {{0, 0, -w}, {0, 0, w}}, far[2] = {{b, 0, -w}, {b, 0, w}};
    make_triangle(m, near[0], near[1], top[1], glass); /* first face: looks to -x */
    make_triangle(m, near[0], top[1], top[0], glass);
    make_triangle(m, far[1], far[0], top[0], glass); /* second */
    make_triangle(m, far[1], top[0], top[1], glass);
    make_triangle(m, near[1], near[0], far[0], glass); /* bottom */
    make_triangle(m, near[1], far[0], far[1], glass);
    make_triangle(m, near[0], top[0], far[0], glass); /* ends */
    make_triangle(m, near[1], far[1], top[1], glass);
}

/* Angle of the refracted ray with the second face's normal, and the share that gets through both faces, unpolarized. */
static double through_prism(double n, double *share)
{
    const double r1 = asin(sin(INCIDENCE) / n), i2 = APEX - r1, t2 = asin(n * sin(i2));
    double s = 1, p = 1;
    const double c[2][2] = {{cos(INCIDENCE), cos(r1)}, {cos(i2), cos(t2)}}, eta[2] = {n, 1 / n};
    for (int k = 0; k < 2; ++k) {
        const double rs = (c[k][0] - eta[k] * c[k][1]) / (c[k][0] + eta[k] * c[k][1]);
        const double rp = (eta[k] * c[k][0] - c[k][1]) / (eta[k] * c[k][0] + c[k][1]);
        s *= 1 - rs * rs;
        p *= 1 - rp * rp;
    }
    *share = 0.5 * (s + p);
    return t2;
}

static double prism_share(double nm, const void *glass)
{
    double share;
    through_prism(lum_index_at(glass, nm), &share);
    return share;
}

/* Rays of the direct beam: their direction is what Snell's law says at their wavelength. */
static bool in_beam(const census *self, const lmg_ray *ray)
{
    if (ray->wavelength == 0)
        return false;
    double share;
    const double t2 = through_prism(lum_index_at(self->glass, (double)ray->wavelength), &share);
    /* The second face's normal points to (cos APEX, sin APEX); the ray leaves t2 on the side away from the apex. */
    const double a = APEX - t2;
    /* The cone of 1e-6, magnified; floats of the wavelength, and of the index at whole nanometres. */
    return fabs(atan2(ray->direction.y, ray->direction.x) - a) < 2e-5 && fabs(ray->direction.z) < 2e-5;
}

/* Every ray's deviation is that of its wavelength, and the spectrum as a whole is the source's times what the faces let through:
 * its X,Y,Z, and the light in each tenth of the visible range. */
static void prism(void **state)
{
    (void)state;
    static const char *const glasses[] = {"N-BK7", "N-SF11"};
    for (int g = 0; g < 2; ++g) {
        lum_index_model glass;
        lum_spectrum index, d65;
        lmg_error err;
        assert_true(lum_index_of_glass(glasses[g], &glass));
        assert_int_equal(lum_spectrum_of_index(&glass, &index, &err), LMG_OK);
        lum_model *m = make_model();
        const uint32_t material = make_glass(m, (float)lum_index_at(&glass, LUM_NM_D), 0, false);
        m->materials[material].spectral.index = &index;
        add_prism(m, material);
        const double drop = 0.003; /* to the face's lower half, far from its edges */
        add_ray_light(m, v3(-drop, 0.015 - drop * tan(INCIDENCE), 0.0001), v3(cos(INCIDENCE), sin(INCIDENCE), 0));
        finish_model(m);
        const double photons = 400000;
        census c = {.take = in_beam, .glass = &glass};
        trace(m, 31, (uint64_t)photons, &c);
        double expected[3];
        lum_spectrum_illuminant("D65", &d65);
        filtered(&d65, prism_share, &glass, expected);
        assert_mean(glasses[g], &c, photons, expected);
        free_model(m);
    }
}

/* The share of the light between two wavelengths. */
static double band_low, band_high;
static bool in_band(const census *self, const lmg_ray *ray)
{
    return in_beam(self, ray) && (double)ray->wavelength >= band_low && (double)ray->wavelength < band_high;
}

static double band_share(double nm, const void *glass)
{
    return nm >= band_low && nm < band_high ? prism_share(nm, glass) : 0;
}

static void prism_spectrum(void **state)
{
    (void)state;
    lum_index_model glass;
    lum_spectrum index, led;
    lmg_error err;
    assert_true(lum_index_of_glass("N-SF11", &glass));
    assert_int_equal(lum_spectrum_of_index(&glass, &index, &err), LMG_OK);
    lum_spectrum_illuminant("D65", &led);
    lum_model *m = make_model();
    const uint32_t material = make_glass(m, 1.78f, 0, false);
    m->materials[material].spectral.index = &index;
    add_prism(m, material);
    add_ray_light(m, v3(-0.003, 0.015 - 0.003 * tan(INCIDENCE), 0.0001), v3(cos(INCIDENCE), sin(INCIDENCE), 0));
    finish_model(m);
    for (band_low = 420; band_low < 700; band_low += 40) {
        band_high = band_low + 40;
        const double photons = 60000;
        census c = {.take = in_band, .glass = &glass};
        trace(m, 32, (uint64_t)photons, &c);
        double expected[3];
        char what[32];
        filtered(&led, band_share, &glass, expected);
        snprintf(what, sizeof(what), "%.0f-%.0f nm", band_low, band_high);
        assert_mean(what, &c, photons, expected);
    }
    free_model(m);
}

/* Without dispersion nothing is followed by wavelength; with an index that doesn't vary neither, and the bits are the same. */
static void constant_index_changes_nothing(void **state)
{
    (void)state;
    lum_spectrum index;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        index.value[i] = 1.5f;
    uint64_t hash[2];
    for (int i = 0; i < 2; ++i) {
        lum_model *m = make_model();
        const uint32_t material = make_glass(m, 1.5f, 0, false);
        m->materials[material].spectral.index = i ? &index : NULL;
        add_prism(m, material);
        add_ray_light(m, v3(-0.003, 0.012, 0.0001), v3(cos(INCIDENCE), sin(INCIDENCE), 0));
        finish_model(m);
        census c = {0};
        trace(m, 3, 20000, &c);
        hash[i] = c.hash;
        free_model(m);
    }
    assert_true(hash[0] == hash[1]);
}

/* ------------------------------------------------------------------------------------------------------------ surfaces */

static double by_spectrum(double nm, const void *s)
{
    return lum_spectrum_at(s, nm);
}

static double twice_by_spectrum(double nm, const void *s)
{
    return lum_spectrum_at(s, nm) * lum_spectrum_at(s, nm);
}

static double by_metal(double nm, const void *s)
{
    const lum_spectrum *e = s;
    return lum_fresnel_conductor(cos(PI / 6), lum_spectrum_at(&e[0], nm), lum_spectrum_at(&e[1], nm));
}

static bool is_returned(const census *self, const lmg_ray *ray)
{
    (void)self;
    return ray->direction.y > 0;
}

/* A ray of light meets a surface once and is reflected: X,Y,Z are those of light times reflectance. */
static void reflectance_by_wavelength(void **state)
{
    (void)state;
    lum_spectrum d65, r, metal[2];
    lum_spectrum_illuminant("D65", &d65);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) /* a steep edge, as of a dichroic filter */
        r.value[i] = LUM_NM_FIRST + i < 500 ? 0.05f : LUM_NM_FIRST + i < 510 ? 0.5f : 0.93f;
    for (int kind = 0; kind < 4; ++kind) {
        lum_model *m = make_model();
        uint32_t i;
        if (kind < 2) {
            i = kind == 0 ? make_lambert(m, 0.7f) : make_mirror(m, 0.7f, 0);
            m->materials[i].spectral.reflectance = &r;
        } else {
            i = make_mirror(m, 1, 0);
            lum_material *c = &m->materials[i];
            assert_true(lum_spectrum_of_metal(kind == 2 ? "gold" : "copper", &metal[0], &metal[1]));
            c->has_eta = true;
            c->spectral.eta = &metal[0];
            c->spectral.k = &metal[1];
            for (int k = 0; k < 3; ++k) {
                c->eta[k] = (float)lum_spectrum_at(&metal[0], k == 0 ? 610 : k == 1 ? 550 : 465);
                c->k[k] = (float)lum_spectrum_at(&metal[1], k == 0 ? 610 : k == 1 ? 550 : 465);
            }
            make_spectral(m);
        }
        make_quad(m, v3(-1, 0, -1), v3(0, 0, 2), v3(2, 0, 0), 1, i);
        add_ray_light(m, v3(0, 0.1, 0), v3(0.5, -cos(PI / 6), 0));
        finish_model(m);
        const double photons = 200000;
        census c = {.take = is_returned};
        trace(m, 41, (uint64_t)photons, &c);
        double expected[3];
        filtered(&d65, kind < 2 ? by_spectrum : by_metal, kind < 2 ? (const void *)&r : metal, expected);
        if (kind >= 2) {
            /* Between the three wavelengths the angle's effect is interpolated: at 30 degrees within 1e-3. */
            for (int k = 0; k < 3; ++k)
                print_message("metal %d: %c off by %.2e\n", kind, "XYZ"[k], c.sum[k] / photons / expected[k] - 1);
        }
        for (int k = 0; k < 3; ++k) {
            const double got = c.sum[k] / photons, error = sqrt(c.squares[k] / photons - got * got) / sqrt(photons);
            assert_true(fabs(got - expected[k]) < SIGMAS * error + (kind >= 2 ? 1e-3 : 1e-6) * expected[k]);
        }
        free_model(m);
    }
}

/* Two spectral sheets in a row, and absorption inside a slab: what is left multiplies by wavelength, not in R,G,B. */
static void losses_multiply(void **state)
{
    (void)state;
    lum_spectrum d65, half, t;
    lum_spectrum_illuminant("D65", &d65);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        half.value[i] = 0;
        t.value[i] = (float)(0.1 + 0.85 * exp(-pow((nm - 540) / 30, 2)));
    }
    lum_model *m = make_model();
    const uint32_t sheet = make_lambert(m, 0);
    lum_material *s = &m->materials[sheet];
    s->diffuse_transmission = 1; /* all of it goes through */
    s->spectral.reflectance = &half;
    s->spectral.transmittance = &t;
    make_quad(m, v3(-1e3, 0, -1e3), v3(0, 0, 2e3), v3(2e3, 0, 0), 1, sheet);
    make_quad(m, v3(-1e3, -0.01, -1e3), v3(0, 0, 2e3), v3(2e3, 0, 0), 1, sheet);
    add_ray_light(m, v3(0, 0.1, 0), v3(0, -1, 0));
    finish_model(m);
    const double photons = 200000;
    census c = {0};
    trace(m, 51, (uint64_t)photons, &c);
    double expected[3];
    filtered(&d65, twice_by_spectrum, &t, expected);
    assert_mean("two sheets", &c, photons, expected);
    free_model(m);

    m = make_model();
    const uint32_t glass = make_glass(m, 1.0f, 0, false); /* index 1: nothing but absorption */
    lum_spectrum a;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        a.value[i] = (float)(-log((double)t.value[i]) / 0.02);
    for (int k = 0; k < 3; ++k)
        m->materials[glass].absorption[k] = 1; /* says that it absorbs; the spectrum says how much */
    m->materials[glass].spectral.absorption = &a;
    make_box(m, v3(-1, -0.02, -1), v3(1, 0, 1), false, 1, glass);
    add_ray_light(m, v3(0.01, 0.1, 0.02), v3(0, -1, 0));
    finish_model(m);
    census d = {0};
    trace(m, 52, (uint64_t)photons, &d);
    filtered(&d65, by_spectrum, &t, expected);
    assert_mean("absorbing slab", &d, photons, expected);
    free_model(m);
}

/* ------------------------------------------------------------------------------------------------------------ phosphor */

/*
 * A blue LED's ray meets a layer of phosphor in the open: the share a(nm) is absorbed, q photons are emitted per photon absorbed,
 * the rest is reflected (r) or goes through (t).  All that happens once, so X,Y,Z of both sides are closed forms; and in watts: out
 * = in (1 - absorbed (1 - q nm / mean nm of emission) - (1 - r - t) unabsorbed).
 */
static void phosphor(void **state)
{
    (void)state;
    lum_spectrum blue, excitation, yellow, r, t;
    lum_spectrum_gaussian(450, 20, &blue);
    lum_spectrum_gaussian(560, 110, &yellow);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        excitation.value[i] = (float)(0.7 * exp(-pow((nm - 455) / 35, 2)));
        r.value[i] = 0.3f;
        t.value[i] = 0.6f;
    }
    const double yield = 0.85, forward = 0.6, photons = 200000;
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0), layer = make_lambert(m, 0.5f);
    emit(m, source, &blue);
    lum_material *p = &m->materials[layer];
    p->diffuse_transmission = 0.6f / 0.9f;
    p->spectral = (lum_spectral){.excitation = &excitation,
                                 .converted = &yellow,
                                 .reflectance = &r,
                                 .transmittance = &t,
                                 .quantum_yield = (float)yield,
                                 .forward = (float)forward};
    /* The source's light all meets the layer, 1 um above; what comes back from there passes the source, which is a thin line. */
    make_quad(m, v3(-1e3, 0, -1e3), v3(0, 0, 2e3), v3(2e3, 0, 0), 1, layer);
    make_quad(m, v3(0, -0.5, 0), v3(1e-6, 0, 0), v3(0, 0, -1e-3), 1, source);
    finish_model(m);

    /* Closed forms by midpoints of quarters of a nanometre. */
    double lumens = 0, watts = 0, unabsorbed[3] = {0}, number = 0, emission[3] = {0}, e_watts = 0, e_number = 0, left = 0;
    for (int i = 0; i < 4 * (LUM_SPECTRUM_COUNT - 1); ++i) {
        const double nm = LUM_NM_FIRST + 0.25 * (i + 0.5), s = lum_spectrum_at(&blue, nm), a = lum_spectrum_at(&excitation, nm);
        const double e = lum_spectrum_at(&yellow, nm);
        double o[3];
        lum_observer(nm, o);
        lumens += s * o[1];
        watts += s;
        number += s * nm * a;
        left += s * (1 - a);
        e_watts += e;
        e_number += e * nm;
        for (int k = 0; k < 3; ++k) {
            unabsorbed[k] += s * (1 - a) * o[k];
            emission[k] += e * o[k];
        }
    }
    const double gain = yield * number / e_number; /* times e: emitted */
    for (int side = 0; side < 2; ++side) {
        census c = {.take = is_returned}; /* upwards: through */
        trace(m, 61 + (uint64_t)side, (uint64_t)photons, &c);
        double expected[3];
        for (int k = 0; k < 3; ++k)
            expected[k] = (0.6 * unabsorbed[k] + forward * gain * emission[k]) / lumens;
        assert_mean("phosphor, through", &c, photons, expected);
    }
    census all = {0};
    const bake_tally tally = trace(m, 63, (uint64_t)photons, &all);
    double expected[3];
    for (int k = 0; k < 3; ++k)
        expected[k] = (0.9 * unabsorbed[k] + gain * emission[k]) / lumens;
    assert_mean("phosphor, both sides", &all, photons, expected);
    assert_true(tally.absorbed < 0); /* more luminance comes out than went in: it is no energy */

    /* Watts, from Y and Z of the two spectra that the light is a mixture of. */
    double y = all.sum[1] / photons * lumens, z = all.sum[2] / photons * lumens;
    const double det = unabsorbed[1] * emission[2] - unabsorbed[2] * emission[1];
    const double blue_part = (y * emission[2] - z * emission[1]) / det, yellow_part = (z * unabsorbed[1] - y * unabsorbed[2]) / det;
    const double out = blue_part * left + yellow_part * e_watts, expected_out = 0.9 * left + gain * e_watts;
    print_message("phosphor: %.4f of the power comes out, expected %.4f\n", out / watts, expected_out / watts);
    assert_true(fabs(out / expected_out - 1) < 0.01); /* Y and Z have relative errors of 0.2 %; they are amplified by the inversion */
    assert_true(out < watts);
    free_model(m);
}

/* --------------------------------------------------------------------------------------------------------- bookkeeping */

/* The same rays on one and two threads, and in parts. */
static void threads_and_parts(void **state)
{
    (void)state;
    lum_index_model glass;
    lum_spectrum index;
    lmg_error err = {{0}};
    assert_true(lum_index_of_glass("N-SF11", &glass));
    assert_int_equal(lum_spectrum_of_index(&glass, &index, &err), LMG_OK);
    lum_model *m = make_model();
    const uint32_t material = make_glass(m, 1.78f, 0, false), source = make_lambert(m, 0.4f);
    m->materials[material].spectral.index = &index;
    m->materials[source].base_color[2] = 0.1f;
    emit(m, source, NULL);
    add_prism(m, material);
    make_sphere(m, v3(-0.03, 0.02, 0), 0.01, 16, false, true, source);
    finish_model(m);
    bake_source *s;
    assert_int_equal(bake_tracer_create(m, 71, &s, &err), LMG_OK);
    uint64_t hash[2] = {0};
    double absorbed[2];
    for (int i = 0; i < 2; ++i) {
        bake_tally t = {0};
        if (i == 0) {
            census c = {0};
            const lmg_sink sink = {&c, consume};
            assert_int_equal(s->run(s, 0, 60000, 1, &sink, 1, &t, &err), LMG_OK);
            hash[i] = c.hash;
        } else { /* on one thread: the census isn't for several */
            census c = {0};
            const lmg_sink sink = {&c, consume};
            assert_int_equal(s->run(s, 0, 20001, 1, &sink, 1, &t, &err), LMG_OK);
            assert_int_equal(s->run(s, 20001, 39999, 1, &sink, 1, &t, &err), LMG_OK);
            hash[i] = c.hash;
        }
        assert_true(t.emitted == t.escaped + t.absorbed + t.lost);
        absorbed[i] = t.absorbed;
    }
    bake_tally two = {0};
    assert_int_equal(s->run(s, 0, 60000, 2, NULL, 0, &two, &err), LMG_OK);
    assert_true(hash[0] == hash[1]);
    assert_true(absorbed[0] == absorbed[1] && two.absorbed == absorbed[0]);
    s->destroy(s);
    free_model(m);
}

/* Grey things: followed by wavelength or not, the same share of the light comes out. */
static void grey_is_grey(void **state)
{
    (void)state;
    const double photons = 300000;
    double out[2], error[2];
    for (int i = 0; i < 2; ++i) {
        lum_model *m = make_model();
        const uint32_t source = make_lambert(m, 0), grey = make_lambert(m, 0.6f), glass = make_glass(m, 1.5f, 0.2f, false);
        emit(m, source, NULL);
        make_box(m, v3(-0.1, 0, -0.1), v3(0.1, 0.2, 0.1), true, 1, grey);
        m->triangle_count -= 2; /* one face is open */
        make_sphere(m, v3(0, 0.1, 0), 0.02, 12, false, true, source);
        make_sphere(m, v3(0.05, 0.1, 0.03), 0.02, 12, false, true, glass);
        if (i)
            make_spectral(m);
        finish_model(m);
        census c = {0};
        const bake_tally t = trace(m, 81, (uint64_t)photons, &c);
        out[i] = t.escaped / photons;
        error[i] = sqrt(c.squares[1] / photons - out[i] * out[i]) / sqrt(photons);
        free_model(m);
    }
    print_message("grey: %.5f +- %.5f in R,G,B, %.5f +- %.5f by wavelength\n", out[0], error[0], out[1], error[1]);
    assert_true(out[0] > 0.05 && out[0] < 0.95);
    assert_true(fabs(out[0] - out[1]) < SIGMAS * hypot(error[0], error[1]));
    /* Luminances vary little: the error is at most a tenth larger. */
    assert_true(error[1] < 1.1 * error[0]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(sources_keep_their_colour), cmocka_unit_test(colours_keep_their_colour),
        cmocka_unit_test(prism),                     cmocka_unit_test(prism_spectrum),
        cmocka_unit_test(constant_index_changes_nothing), cmocka_unit_test(reflectance_by_wavelength),
        cmocka_unit_test(losses_multiply),           cmocka_unit_test(phosphor),
        cmocka_unit_test(threads_and_parts),         cmocka_unit_test(grey_is_grey),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
