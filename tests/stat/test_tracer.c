/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The photon tracer as a whole: energy balance in whole photons, clear and absorbing slabs against closed forms, light guides,
 * solids inside one another, open solids, coloured light out of gamut, and independence of threads and of how a range is split. All
 * seeds are fixed.  Statistical tolerances: 4 standard errors, p < 7e-5 for each of about 30 comparisons.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "effects.h"
#include "source.h"
#include "tracer.h"

#include <luminaires/model.h>
#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;
static const double SIGMAS = 4;

static lmg_vec3 v3(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

static void emit(lum_model *model, uint32_t material, float r, float g, float b)
{
    lum_material *m = &model->materials[material];
    m->emissive[0] = r;
    m->emissive[1] = g;
    m->emissive[2] = b;
}

/* A spot light of so small a cone (1e-3 radians) that its light is a ray. */
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
    l->cos_inner = cos(0.5e-3);
    l->cos_outer = cos(1e-3);
}

static bake_source *tracer_of(const lum_model *model, uint64_t seed)
{
    bake_source *source;
    lmg_error err = {{0}};
    if (bake_tracer_create(model, seed, &source, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return source;
}

static bake_tally trace(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sink)
{
    bake_tally tally = {0};
    lmg_error err = {{0}};
    if (source->run(source, first, count, threads, sink, sink ? 1 : 0, &tally, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return tally;
}

static void assert_balanced(const bake_tally *t)
{
    /* whole numbers below 2^53: equal to the last bit */
    assert_true(t->emitted == t->escaped + t->absorbed + t->lost);
    assert_true(t->emitted == (double)t->photons);
}

/* Colour sums of the rays that travel down (d.y < 0) and of all, and a hash of the set of rays that any order gives alike. */
typedef struct census {
    _Atomic uint64_t hash, rays, down, bad;
    double colour[3], squares[3];
} census;

static uint64_t bits(double x)
{
    uint64_t b;
    memcpy(&b, &x, sizeof(b));
    return b;
}

static void count_rays(void *self, const lmg_ray *rays, size_t count)
{
    census *c = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_ray *r = &rays[i];
        uint64_t h = r->number;
        const double values[9] = {r->origin.x,    r->origin.y,        r->origin.z,        r->direction.x,    r->direction.y,
                                  r->direction.z, (double)r->flux[0], (double)r->flux[1], (double)r->flux[2]};
        for (int k = 0; k < 9; ++k)
            h = lum_mix64(h ^ bits(values[k]));
        c->hash += h;
        ++c->rays;
        const double length =
            sqrt(r->direction.x * r->direction.x + r->direction.y * r->direction.y + r->direction.z * r->direction.z);
        /* float rounding of three components whose weighted sum is 1 */
        if (fabs(length - 1) > 1e-12 ||
            fabs(lmg_luminance(r->flux) - 1) >
                4 * 0x1p-24 * (fabs((double)r->flux[0]) + fabs((double)r->flux[1]) + fabs((double)r->flux[2])))
            ++c->bad;
        c->down += r->direction.y < 0;
    }
}

/* The same, with colour sums of the light that travels down; for one thread. */
static void sum_colours(void *self, const lmg_ray *rays, size_t count)
{
    count_rays(self, rays, count);
    census *c = self;
    for (size_t i = 0; i < count; ++i)
        for (int k = 0; rays[i].direction.y < 0 && k < 3; ++k) {
            c->colour[k] += (double)rays[i].flux[k];
            c->squares[k] += (double)rays[i].flux[k] * (double)rays[i].flux[k];
        }
}

/* -------------------------------------------------------------------------------------------------------------- energy */

/* Lossless things of every kind round a source in a box without a lid: all light comes out. */
static lum_model *lossless_lamp(void)
{
    lum_model *m = make_model();
    const uint32_t white = make_lambert(m, 1), rough = make_mirror(m, 1, 0.4f), mirror = make_mirror(m, 1, 0);
    const uint32_t glass = make_glass(m, 1.52f, 0, false), frosted = make_glass(m, 1.5f, 0.5f, false),
                   pane = make_glass(m, 1.5f, 0, true);
    const uint32_t source = make_lambert(m, 1);
    emit(m, source, 1000, 1000, 1000);
    make_sphere(m, v3(0.013, 0.021, -0.007), 0.02, 16, false, true, source);
    make_sphere(m, v3(0.05, 0.02, 0.03), 0.019, 24, false, true, glass);
    make_sphere(m, v3(-0.045, 0.01, 0.04), 0.015, 16, false, false, frosted);
    make_quad(m, v3(-0.05, -0.05, -0.06), v3(0.1, 0.01, 0), v3(0.01, 0.02, 0.08), 3, rough);
    make_quad(m, v3(-0.08, 0.07, -0.08), v3(0.16, 0, 0), v3(0, 0, 0.16), 2, pane);
    make_box(m, v3(-0.03, -0.045, 0.01), v3(0.03, -0.035, 0.05), false, 2, glass);
    /* box open at the top, white inside, mirror outside */
    const double b = 0.1, t = 0.101;
    make_quad(m, v3(-b, -b, -b), v3(0, 0, 2 * b), v3(2 * b, 0, 0), 2, white);
    make_quad(m, v3(-b, -b, -b), v3(0, 2 * b, 0), v3(0, 0, 2 * b), 2, white);
    make_quad(m, v3(b, -b, -b), v3(0, 0, 2 * b), v3(0, 2 * b, 0), 2, white);
    make_quad(m, v3(-b, -b, -b), v3(2 * b, 0, 0), v3(0, 2 * b, 0), 2, white);
    make_quad(m, v3(-b, -b, b), v3(0, 2 * b, 0), v3(2 * b, 0, 0), 2, white);
    make_quad(m, v3(-t, -t, -t), v3(2 * t, 0, 0), v3(0, 0, 2 * t), 2, mirror);
    finish_model(m);
    return m;
}

static void test_white_furnace(void **state)
{
    (void)state;
    lum_model *m = lossless_lamp();
    bake_source *s = tracer_of(m, 11);
    census c = {0};
    const lmg_sink sink = {&c, count_rays};
    const uint64_t photons = 1000000;
    const bake_tally t = trace(s, 0, photons, 0, &sink);
    assert_balanced(&t);
    print_message("furnace: %.0f absorbed, %.0f lost (%.0f inside solids) of %.0f, %.1f segments each\n", t.absorbed, t.lost,
                  t.lost_inside, t.emitted, (double)t.segments / t.emitted);
    assert_true(t.absorbed == 0); /* weights are exactly 1 */
    assert_true(t.lost <= 1e-6 * (double)photons);
    assert_int_equal(c.rays, (uint64_t)t.escaped);
    assert_int_equal(c.bad, 0);
    s->destroy(s);
    free_model(m);
}

/* A furnace must be able to fail: with one surface of albedo 0.999 the light is missing. */
static void test_furnace_notices_loss(void **state)
{
    (void)state;
    lum_model *m = lossless_lamp();
    for (int k = 0; k < 3; ++k)
        m->materials[0].base_color[k] = 0.999f;
    bake_source *s = tracer_of(m, 11);
    const bake_tally t = trace(s, 0, 100000, 0, NULL);
    assert_balanced(&t);
    assert_true(t.absorbed > 100);
    s->destroy(s);
    free_model(m);
}

/* Light that can't get out: nothing leaks through edges and corners of a closed mirror box, and the runaway guard ends it, a few
 * photons as lost, many with a message that says where they are. */
static void test_closed_box(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t rough = make_mirror(m, 1, 0.3f), source = make_mirror(m, 1, 0);
    emit(m, source, 1, 1, 1);
    make_box(m, v3(0.3, 0.1, -0.2), v3(0.5, 0.25, 0.1), true, 3, rough);
    make_sphere(m, v3(0.4, 0.16, -0.05), 0.03, 8, false, false, source);
    finish_model(m);
    strcpy(m->materials[rough].name, "shell");
    m->parts[0].material = (int32_t)rough;
    bake_source *s = tracer_of(m, 5);
    bake_tally t = trace(s, 0, 4, 0, NULL); /* 4 million segments */
    assert_balanced(&t);
    assert_true(t.escaped == 0);
    assert_true(t.lost == 4);
    lmg_error err = {{0}};
    const bake_tally before = t;
    assert_int_equal(s->run(s, 0, 20000, 0, NULL, 0, &t, &err), LMG_ERROR_INPUT);
    print_message("%s\n", err.message);
    assert_non_null(strstr(err.message, "trapped"));
    assert_non_null(strstr(err.message, "shell"));
    assert_memory_equal(&t, &before, sizeof(t));
    s->destroy(s);
    free_model(m);
}

/* --------------------------------------------------------------------------------------------------------------- slabs */

/* A clear slab 4 mm thick with a ray of light from above. */
static lum_model *slab_lamp(double degrees, const float absorption[3], bool cut_in_two)
{
    lum_model *m = make_model();
    const uint32_t glass = make_glass(m, 1.52f, 0, false);
    for (int k = 0; absorption && k < 3; ++k)
        m->materials[glass].absorption[k] = absorption[k];
    make_box(m, v3(-0.6, -0.004, -0.5), v3(0.6, 0, 0.5), false, 3, glass);
    if (cut_in_two) { /* the same glass again inside it: no optical boundary */
        const uint32_t other = make_glass(m, 1.52f, 0, false);
        for (int k = 0; absorption && k < 3; ++k)
            m->materials[other].absorption[k] = absorption[k];
        make_sphere(m, v3(0.001, -0.002, 0), 0.0015, 24, false, true, other);
    }
    const double a = degrees * PI / 180;
    add_ray_light(m, v3(0.0013 - 0.002 * tan(a), 0.002, 0.00017), v3(sin(a), -cos(a), 0));
    finish_model(m);
    return m;
}

static void test_clear_slab(void **state)
{
    (void)state;
    const struct {
        double degrees, transmittance;
    } cases[] = {{0, 0.9183}, {30, 0.9160}, {45, 0.9025}, {60, 0.8435}, {75, 0.6148}, {85, 0.2456}};
    const double photons = 2000000;
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        lum_model *m = slab_lamp(cases[i].degrees, NULL, false);
        bake_source *s = tracer_of(m, 100 + i);
        census c = {0};
        const lmg_sink sink = {&c, count_rays};
        const bake_tally t = trace(s, 0, (uint64_t)photons, 0, &sink);
        assert_balanced(&t);
        assert_true(t.escaped == photons);
        const double got = (double)c.down / photons, error = sqrt(got * (1 - got) / photons);
        print_message("slab %2.0f degrees: %.5f +- %.5f, closed form %.4f\n", cases[i].degrees, got, error, cases[i].transmittance);
        /* the closed forms are rounded to four places: 5e-5 more */
        assert_true(fabs(got - cases[i].transmittance) < 3 * error + 5e-5);
        assert_true(fabs(got - cases[i].transmittance) < 2e-3);
        assert_int_equal(c.bad, 0);
        s->destroy(s);
        free_model(m);
    }
}

/* Beer-Lambert in colours, perpendicular: T = t^2 e / (1 - r^2 e^2), e = exp(-a d), r = ((n-1)/(n+1))^2, t = 1 - r; for a slab and
 * for a slab with a sphere of the same glass in the way, where light goes through nested solids. */
static void test_absorbing_slab(void **state)
{
    (void)state;
    const float absorption[3] = {30, 110, 410};
    const double photons = 1000000, r = pow(0.52 / 2.52, 2);
    for (int nested = 0; nested < 2; ++nested) {
        lum_model *m = slab_lamp(0, absorption, nested);
        bake_source *s = tracer_of(m, 21);
        census c = {0};
        const lmg_sink sink = {&c, sum_colours};
        const bake_tally t = trace(s, 0, (uint64_t)photons, 1, &sink);
        assert_balanced(&t);
        assert_true(t.lost == 0);
        for (int k = 0; k < 3; ++k) {
            const double e = exp(-(double)absorption[k] * 0.004);
            const double expected = (1 - r) * (1 - r) * e / (1 - r * r * e * e);
            const double got = c.colour[k] / photons;
            const double error = sqrt(c.squares[k] / photons - got * got) / sqrt(photons);
            print_message("absorbing slab %d, channel %d: %.5f +- %.5f, closed form %.5f\n", nested, k, got, error, expected);
            assert_true(fabs(got - expected) < SIGMAS * error);
        }
        assert_int_equal(c.bad, 0);
        s->destroy(s);
        free_model(m);
    }
}

/* -------------------------------------------------------------------------------------------------------- light guides */

/* A rod of glass, 4 x 4 mm, 1.5 m long: light that enters at one end is guided by total reflection, on average hundreds of times.
 * All of it leaves through the ends (or is reflected there), none is lost or cut off. */
static void test_light_guide(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t glass = make_glass(m, 1.5f, 0, false), source = make_material(m, LUM_SURFACE_BLACK);
    emit(m, source, 1, 1, 1);
    make_box(m, v3(-0.002, -0.002, 0), v3(0.002, 0.002, 1.5), false, 1, glass);
    make_quad(m, v3(-0.0005, -0.0005, -1e-5), v3(0.001, 0, 0), v3(0, 0.001, 0), 1,
              source); /* shines along +z, 10 um from the end */
    finish_model(m);
    bake_source *s = tracer_of(m, 3);
    census c = {0};
    const lmg_sink sink = {&c, count_rays};
    const bake_tally t = trace(s, 0, 20000, 0, &sink);
    assert_balanced(&t);
    print_message("light guide: %.0f of %.0f out, %.0f absorbed by the source, %.0f lost; %.0f segments each\n", t.escaped,
                  t.emitted, t.absorbed, t.lost, (double)t.segments / t.emitted);
    assert_true(t.lost == 0);
    assert_true((double)t.segments / t.emitted > 200);
    assert_int_equal(c.bad, 0);
    s->destroy(s);
    free_model(m);
}

/* --------------------------------------------------------------------------------------------------------------- media */

/* A source inside a solid: its first boundary is met from within. */
static void test_source_inside_glass(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t glass = make_glass(m, 1.5f, 0, false), source = make_lambert(m, 1);
    emit(m, source, 1, 1, 1);
    make_sphere(m, v3(0.2, 0.3, 0.1), 0.05, 40, false, true, glass);
    make_sphere(m, v3(0.2, 0.3, 0.1), 0.004, 12, false, true, source);
    finish_model(m);
    bake_source *s = tracer_of(m, 31);
    bake_tally t = trace(s, 0, 200000, 0, NULL);
    assert_balanced(&t);
    assert_true(t.escaped == t.emitted);

    /* With absorption: light goes once through the sphere (a source in the middle meets the surface head-on) and comes out with
     * T = sum over k of (1-r) r^k e^(2k+1) at least, where the first path is 46 mm and further ones at most 104 mm; the source's
     * own size makes paths differ by 4 mm.  Bounds: */
    for (int k = 0; k < 3; ++k)
        m->materials[glass].absorption[k] = 20;
    s->destroy(s);
    s = tracer_of(m, 31);
    t = trace(s, 0, 200000, 0, NULL);
    assert_balanced(&t);
    const double share = t.escaped / t.emitted, error = sqrt(share * (1 - share) / t.emitted), r = 0.04;
    assert_true(share > (1 - r) * exp(-20 * 0.0502) - SIGMAS * error);
    assert_true(share < (1 - r) * (exp(-20 * 0.0458) + r * exp(-20 * 0.0458 * 2)) / (1 - r) + SIGMAS * error);
    s->destroy(s);
    free_model(m);
}

/* Half a glass sphere without its flat face: light gets inside and out through the hole, which the ledger must say. */
static void test_open_solid(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t glass = make_glass(m, 1.5f, 0, false), source = make_lambert(m, 0.5f);
    emit(m, source, 1, 1, 1);
    make_sphere(m, v3(0, -0.2, 0), 0.01, 12, false, true, source);
    /* a single face of a solid, facing the source */
    make_quad(m, v3(-0.1, 0, -0.1), v3(0.2, 0, 0), v3(0, 0, 0.2), 1, glass);
    finish_model(m);
    bake_source *s = tracer_of(m, 8);
    const bake_tally t = trace(s, 0, 100000, 0, NULL);
    assert_balanced(&t);
    assert_true(t.lost_inside > 0.05 * t.emitted);
    assert_true(t.lost == t.lost_inside);
    s->destroy(s);
    free_model(m);
}

/* -------------------------------------------------------------------------------------------------------------- colour */

/* Coloured walls round a coloured source: the light of each channel is that of a grey furnace of its own.  One diffuse quad (albedo
 * c) under a small one-sided source: E[flux of channel k that leaves] = emitted_k (1 - F + F c_k), F the share that hits. */
static void check_colours(const float source_colour[3], const float albedo[3], uint64_t seed)
{
    lum_model *m = make_model();
    const uint32_t wall = make_lambert(m, 1), source = make_material(m, LUM_SURFACE_BLACK),
                   shade = make_material(m, LUM_SURFACE_BLACK);
    for (int k = 0; k < 3; ++k)
        m->materials[wall].base_color[k] = albedo[k];
    emit(m, source, source_colour[0], source_colour[1], source_colour[2]);
    /* shines up at the wall, which is huge: all light hits it and nearly all that it reflects goes down past the source */
    make_quad(m, v3(-1e-5, 0, -1e-5), v3(0, 0, 2e-5), v3(2e-5, 0, 0), 1, source);
    make_quad(m, v3(-50, 0.01, -50), v3(100, 0, 0), v3(0, 0, 100), 1, wall);
    make_quad(m, v3(-50, 0.02, -50), v3(100, 0, 0), v3(0, 0, 100), 1, shade);
    finish_model(m);
    bake_source *s = tracer_of(m, seed);
    census c = {0};
    const lmg_sink sink = {&c, sum_colours};
    const double photons = 1000000;
    const bake_tally t = trace(s, 0, (uint64_t)photons, 1, &sink);
    assert_balanced(&t);
    assert_true(t.lost == 0);
    assert_int_equal(c.bad, 0);
    const double y = lmg_luminance(source_colour);
    for (int k = 0; k < 3; ++k) {
        const double expected = (double)source_colour[k] / y * (double)albedo[k];
        const double got = c.colour[k] / photons, error = sqrt(c.squares[k] / photons) / sqrt(photons);
        print_message("colour %d: %+.5f +- %.5f, expected %+.5f\n", k, got, error, expected);
        /* the source hides 4e-10 / (pi 1e-4) of the reflected light; the wall's border lets 1e-8 pass */
        assert_true(fabs(got - expected) < SIGMAS * error + 2e-6);
    }
    s->destroy(s);
    free_model(m);
}

static void test_colours(void **state)
{
    (void)state;
    check_colours((const float[3]){3, 1, 0.25f}, (const float[3]){0.9f, 0.35f, 0.1f}, 41);
    /* out of gamut: the wall takes the negative red away, so more luminance leaves than arrives */
    check_colours((const float[3]){-2, 2, 0.5f}, (const float[3]){0.05f, 0.9f, 0.9f}, 42);
}

/* ------------------------------------------------------------------------------------------------------ reproducibility */

static void test_threads_and_ranges(void **state)
{
    (void)state;
    lum_model *m = lossless_lamp();
    for (int k = 0; k < 3; ++k)
        m->materials[0].base_color[k] = 0.8f - 0.1f * (float)k;
    bake_source *s = tracer_of(m, 77);
    const uint64_t photons = 30011; /* no multiple of anything */
    uint64_t hash = 0;
    bake_tally first = {0};
    for (unsigned threads = 1; threads <= 3; ++threads) {
        census c = {0};
        const lmg_sink sink = {&c, count_rays};
        const bake_tally t = trace(s, 0, photons, threads, &sink);
        assert_balanced(&t);
        if (threads == 1) {
            hash = c.hash;
            first = t;
        }
        assert_int_equal(c.hash, hash);
        assert_memory_equal(&t, &first, sizeof(t));
    }
    census c = {0};
    const lmg_sink sink = {&c, count_rays};
    bake_tally sum = {0};
    lmg_error err;
    const uint64_t cuts[] = {0, 1, 4097, 5000, 29999, photons};
    for (int i = 5; i-- > 0;)
        assert_int_equal(s->run(s, cuts[i], cuts[i + 1] - cuts[i], 2, &sink, 1, &sum, &err), LMG_OK);
    assert_int_equal(c.hash, hash);
    assert_memory_equal(&sum, &first, sizeof(sum));

    /* another seed, other light */
    bake_source *other = tracer_of(m, 78);
    census d = {0};
    const lmg_sink other_sink = {&d, count_rays};
    trace(other, 0, photons, 2, &other_sink);
    assert_int_not_equal(d.hash, hash);
    other->destroy(other);
    s->destroy(s);
    free_model(m);
}

/* What is still in the beam. */
static void count_straight(void *self, const lmg_ray *rays, size_t count)
{
    uint64_t *straight = self;
    for (size_t i = 0; i < count; ++i)
        *straight += rays[i].direction.y < -1 + 1e-6;
}

static void test_dark_model(void **state)
{
    (void)state;
    lum_model *m = make_model();
    make_box(m, v3(0, 0, 0), v3(1, 1, 1), false, 1, make_lambert(m, 1));
    finish_model(m);
    bake_source *s;
    lmg_error err = {{0}};
    assert_int_equal(bake_tracer_create(m, 1, &s, &err), LMG_ERROR_INPUT);
    assert_null(s);
    assert_non_null(strstr(err.message, "emit"));
    free_model(m);
}

/* ------------------------------------------------------------------------------------------------------- polarization */

/*
 * Two panes at Brewster's angle to a beam, tipped in the same plane or with the second turned by 90 degrees about the beam, by the whole
 * tracer.  A pane transmits p light wholly and Ts = (1 - Rs) / (1 + Rs) of s light, Rs = ((n^2 - 1) / (n^2 + 1))^2.  In line:
 * (1 + Ts^2) / 2, crossed Ts; without polarization ((1 + Ts) / 2)^2 both times, which is 2 to 3 % off.
 */
static void test_brewster_plates(void **state)
{
    (void)state;
    const double n = 1.52, angle = atan(n), rs = pow((n * n - 1) / (n * n + 1), 2), ts = (1 - rs) / (1 + rs);
    for (int crossed = 0; crossed < 2; ++crossed) {
        lum_model *m = make_model();
        const uint32_t glass = make_glass(m, (float)n, 0, true);
        for (int i = 0; i < 2; ++i) {
            /* one axis lies across the beam, the other rises; the second pane leans the other way, so that light between them is lost sideways */
            const double rise = i ? -sin(angle) : sin(angle), along = cos(angle);
            const lmg_vec3 a = i && crossed ? v3(0, 0, 0.2) : v3(0.2, 0, 0);
            const lmg_vec3 b = i && crossed ? v3(0.2 * along, 0.2 * rise, 0) : v3(0, 0.2 * rise, 0.2 * along);
            make_quad(m, v3(-0.5 * (a.x + b.x), -0.3 * (i + 1) - 0.5 * b.y, -0.5 * (a.z + b.z)), a, b, 1, glass);
        }
        add_ray_light(m, v3(0.001, 0.1, 0.002), v3(0, -1, 0));
        finish_model(m);
        for (int with = 0; with < 2; ++with) {
            bake_source *source;
            lmg_error err = {{0}};
            const uint32_t polarization = 1u << BAKE_POLARIZATION;
            assert_int_equal(bake_tracer_create_with(m, with ? UINT32_MAX : ~polarization, 17, NULL, &source, &err), LMG_OK);
            uint64_t through = 0;
            const lmg_sink sink = {.self = &through, .consume = count_straight};
            enum { COUNT = 400000 };
            const bake_tally t = trace(source, 0, COUNT, 1, &sink);
            assert_balanced(&t);
            source->destroy(source);
            const double expected = !with ? pow((1 + ts) / 2, 2) : crossed ? ts : (1 + ts * ts) / 2;
            const double share = (double)through / COUNT, error = sqrt(expected * (1 - expected) / COUNT);
            print_message("panes %s, %s polarization: %.5f +- %.5f, closed form %.5f\n", crossed ? "crossed" : "in line", with ? "with" : "without",
                          share, error, expected);
            /* within the beam's 1e-3 radians transmittance changes by less than 1e-4 */
            assert_true(fabs(share - expected) < SIGMAS * error + 1e-4);
        }
        free_model(m);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_white_furnace),       cmocka_unit_test(test_furnace_notices_loss), cmocka_unit_test(test_closed_box),
        cmocka_unit_test(test_clear_slab),          cmocka_unit_test(test_absorbing_slab),       cmocka_unit_test(test_light_guide),
        cmocka_unit_test(test_source_inside_glass), cmocka_unit_test(test_open_solid),           cmocka_unit_test(test_colours),
        cmocka_unit_test(test_threads_and_ranges),  cmocka_unit_test(test_dark_model),
        cmocka_unit_test(test_brewster_plates),
    };
    return cmocka_run_group_tests_name("tracer", tests, NULL, NULL);
}
