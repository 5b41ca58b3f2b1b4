/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Hard cases of materials and of surfaces close together: glass of index exactly 1 and just above, roughness towards zero, shells a
 * micrometre apart, nested glasses in contact, surfaces that coincide.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"
#include "make_model.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Where each photon left: direction by number. */
enum { PHOTONS = 40000 };
typedef struct exits {
    lmg_vec3 d[PHOTONS], o[PHOTONS];
    bool out[PHOTONS];
} exits;

static void keep_exits(void *self, const lmg_ray *rays, size_t count)
{
    exits *e = self;
    for (size_t i = 0; i < count; ++i) {
        e->d[rays[i].number] = rays[i].direction;
        e->o[rays[i].number] = rays[i].origin;
        e->out[rays[i].number] = true;
    }
}

static exits *trace_exits(lum_model *m, bake_tally *tally)
{
    finish_model(m);
    exits *e = calloc(1, sizeof(*e));
    assert_non_null(e);
    bake_source *s = hard_tracer(m, 12);
    const lmg_sink sink = {e, keep_exits};
    *tally = hard_trace(s, PHOTONS, &sink);
    s->destroy(s);
    free_model(m);
    return e;
}

/* A source and a ball of index n beside it. */
static lum_model *lamp_with_ball(float n, bool ball, float roughness)
{
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0);
    hard_emit(m, source, 100);
    make_quad(m, v3(-0.05, 0, -0.05), v3(0.1, 0, 0), v3(0, 0, 0.1), 1, source);
    /* keeps the model's centre and bounds whether or not the ball is there */
    make_quad(m, v3(-0.2, -0.2, -0.2), v3(0.4, 0, 0), v3(0, 0, 0.4), 1, source);
    make_quad(m, v3(-0.2, 0.2, -0.2), v3(0.01, 0, 0), v3(0, 0, 0.01), 1, source);
    if (ball)
        make_sphere(m, v3(0.013, -0.1, 0.007), 0.06, 40, false, true, make_glass(m, n, roughness, false));
    return m;
}

/* Angle between directions of photons that left in both, worst and mean. */
static double difference(const exits *a, const exits *b, double *mean)
{
    double worst = 0, sum = 0, n = 0;
    for (int i = 0; i < PHOTONS; ++i)
        if (a->out[i] && b->out[i]) {
            const lmg_vec3 d = {a->d[i].x - b->d[i].x, a->d[i].y - b->d[i].y, a->d[i].z - b->d[i].z};
            const double angle = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
            worst = fmax(worst, angle);
            sum += angle;
            n += 1;
        }
    *mean = n > 0 ? sum / n : 0;
    return worst;
}

static void test_index_one(void **state)
{
    (void)state;
    bake_tally t0, t1, t2;
    double mean;
    exits *without = trace_exits(lamp_with_ball(1, false, 0), &t0), *one = trace_exits(lamp_with_ball(1, true, 0), &t1),
          *near = trace_exits(lamp_with_ball(1.0000001f, true, 0), &t2);
    hard_holds("ball of index 1.0 exactly", "as many photons leave as without it, none is lost", t0.escaped == t1.escaped && t1.lost == 0, "%.0f and %.0f",
               t0.escaped, t1.escaped);
    hard_at_most("ball of index 1.0 exactly", "change of any photon's direction", difference(without, one, &mean), 0);
    double moved = 0, grazing = 0;
    for (int i = 0; i < PHOTONS; ++i)
        if (without->out[i] && one->out[i]) {
            /* the distance of one's origin from the other's line */
            const lmg_vec3 d = without->d[i], o = {one->o[i].x - without->o[i].x, one->o[i].y - without->o[i].y, one->o[i].z - without->o[i].z};
            const double x = o.y * d.z - o.z * d.y, y = o.z * d.x - o.x * d.z, z = o.x * d.y - o.y * d.x, off = sqrt(x * x + y * y + z * z);
            moved = fmax(moved, off);
            grazing += off > 1e-14;
        }
    hard_at_most("ball of index 1.0 exactly", "photons whose line isn't the same to 1e-14 m (grazing ones: cosine below 1/16 twice, 1/128 of those that meet it)",
                 grazing / PHOTONS, 1.0 / 128);
    hard_at_most("ball of index 1.0 exactly", "farthest that a line moved, metres (the offset off surfaces, twice)", moved, 2 * 2 * 32 * 0x1p-24 * 0.2);
    /* index 1 + 1.2e-7 (the next float): a ray is turned by 2 (n - 1) tan(i) at most; Fresnel reflects (n-1)^2/4, that is none, but at
     * grazing incidence all: within angles of sqrt(2 (n-1)) = 5e-4, of every photon that meets the ball one in 4 million */
    hard_holds("ball of index 1 + 1.2e-7", "no photon is lost or absorbed on the way", t2.lost == 0 && t2.escaped + t2.absorbed == t2.emitted,
               "%.0f left of %.0f without it", t2.escaped, t0.escaped);
    difference(without, near, &mean);
    hard_at_most("ball of index 1 + 1.2e-7", "mean change of direction", mean, 1e-5);
    free(without), free(one), free(near);
}

static void test_roughness(void **state)
{
    (void)state;
    bake_tally t, smooth_t;
    double mean, before = 0;
    exits *smooth = trace_exits(lamp_with_ball(1.5f, true, 0), &smooth_t);
    static const double ROUGHNESSES[] = {1e-5, 1e-4, 1e-3, 5e-3, 1e-2};
    bool monotonous = true;
    for (int i = 0; i < 5; ++i) {
        exits *e = trace_exits(lamp_with_ball(1.5f, true, (float)ROUGHNESSES[i]), &t);
        difference(smooth, e, &mean);
        const double p = smooth_t.escaped / PHOTONS;
        const char *name = hard_text("glass ball, roughness %g", ROUGHNESSES[i]);
        hard_at_most(name, "nothing lost", t.lost, 0);
        hard_at_most(name, "escaped as from a smooth one, in standard errors", fabs(t.escaped - smooth_t.escaped) / sqrt(2 * PHOTONS * p * (1 - p)), 4);
        /* alpha = roughness^2 is the width of the normals; two refractions turn by about alpha each, some paths take another turn */
        monotonous = monotonous && mean >= before;
        before = mean;
        free(e);
    }
    hard_holds("glass ball, roughness 1e-5 to 1e-2", "directions part from the smooth ball's continuously", monotonous && before < 0.05,
               "mean change of direction at 1e-2: %.2g", before);
    free(smooth);

    /* the same of a mirror: lobes as wide as alpha, the same albedo */
    static const double MIRRORS[] = {0, 1e-5, 1e-3, 1e-2, 1.001e-2, 2e-2};
    for (int i = 0; i < 6; ++i) {
        lum_model *m = make_model();
        const uint32_t mirror = make_mirror(m, 1, (float)MIRRORS[i]);
        make_quad(m, v3(-1, 0, -1), v3(0, 0, 2), v3(2, 0, 0), 1, mirror);
        hard_ray_light(m, v3(0.1, 0.5, 0.2), v3(0.6, -0.8, 0), 1e-6);
        exits *e = trace_exits(m, &t);
        double sum = 0;
        for (int k = 0; k < PHOTONS; ++k)
            sum += hypot(e->d[k].x - 0.6, e->d[k].z);
        const double alpha = MIRRORS[i] * MIRRORS[i];
        const char *name = hard_text("mirror, roughness %g", MIRRORS[i]);
        hard_at_most(name, "all light is reflected", PHOTONS - t.escaped, 0);
        /* GGX: the mean tilt of normals is a few alpha, directions turn by twice that */
        hard_at_most(name, "mean spread over alpha (+ the ray's own 1e-6)", sum / PHOTONS, 8 * alpha + 2e-6);
        free(e);
    }
}

/* ------------------------------------------------------------------------------------------------------- close surfaces */

static void test_gaps(void **state)
{
    (void)state;
    static const double GAPS[] = {1e-3, 1e-5, 1e-6, 0};
    for (int i = 0; i < 4; ++i) {
        /* two glass blocks one above the other, a lamp of 0.1 m; light from above through both */
        lum_model *m = make_model();
        const uint32_t glass = make_glass(m, 1.5f, 0, false), other = make_glass(m, 1.5f, 0, false);
        make_box(m, v3(-0.05, 0, -0.05), v3(0.05, 0.01, 0.05), false, 1, glass);
        make_box(m, v3(-0.05, -0.01 - GAPS[i], -0.05), v3(0.05, -GAPS[i], 0.05), false, 1, other);
        hard_ray_light(m, v3(0.003, 0.03, 0.002), v3(0, -1, 0), 1e-6);
        bake_tally t;
        exits *e = trace_exits(m, &t);
        double through = 0;
        for (int k = 0; k < PHOTONS; ++k)
            through += e->out[k] && e->d[k].y < 0;
        through /= PHOTONS;
        /* F of one face; k faces without absorption transmit (1-F)/(1+(k-1)F) in all */
        const double F = 0.04, four = (1 - F) / (1 + 3 * F);
        /* in contact they are one block */
        const double expected = GAPS[i] > 0 ? four : (1 - F) / (1 + F);
        const char *name = GAPS[i] > 0 ? hard_text("two glass blocks %g um apart", 1e6 * GAPS[i]) : "two glass blocks in contact";
        hard_at_most(name, "nothing lost or absorbed", t.lost + t.absorbed, 0);
        hard_at_most(name, hard_text("transmittance of %s faces, in standard errors", GAPS[i] > 0 ? "four" : "two"),
                     fabs(through - expected) / sqrt(expected * (1 - expected) / PHOTONS), 4);
        free(e);
    }
    /* two mirrors that coincide, facing each other's backs, and a shell 1 um inside a shell: no light gets between or through */
    lum_model *m = make_model();
    const uint32_t a = make_mirror(m, 0.9f, 0), b = make_lambert(m, 0.9f), source = make_lambert(m, 0);
    hard_emit(m, source, 10);
    make_sphere(m, v3(0, 0, 0), 0.01, 12, false, true, source);
    make_box(m, v3(-0.1, -0.1, -0.1), v3(0.1, 0.1, 0.1), true, 2, a);
    make_box(m, v3(-0.1, -0.1, -0.1), v3(0.1, 0.1, 0.1), false, 3, b);
    make_box(m, v3(-0.100001, -0.100001, -0.100001), v3(0.100001, 0.100001, 0.100001), false, 2, a);
    bake_tally t;
    exits *e = trace_exits(m, &t);
    hard_holds("closed shells that coincide and a third 1 um outside", "no light leaks", t.escaped == 0 && t.lost == 0,
               "%.0f escaped, %.0f lost of %d with %.0f strikes", t.escaped, t.lost, PHOTONS, (double)t.segments);
    free(e);

    /* glass in glass in contact: a core in a cladding that shares its side faces */
    m = make_model();
    const uint32_t core = make_glass(m, 1.6f, 0, false), clad = make_glass(m, 1.45f, 0, false);
    make_box(m, v3(-0.01, -0.02, -0.01), v3(0.01, 0.02, 0.01), false, 1, core);
    make_box(m, v3(-0.02, -0.02, -0.02), v3(0.02, 0.02, 0.02), false, 1, clad);
    hard_ray_light(m, v3(0.002, 0.1, 0.003), v3(0.05, -1, 0.02), 0.02);
    m->lights[0].direction = v3(0.05 / sqrt(1.0029), -1 / sqrt(1.0029), 0.02 / sqrt(1.0029));
    e = trace_exits(m, &t);
    hard_at_most("glass core in glass cladding, end faces coincident", "nothing lost or absorbed", t.lost + t.absorbed, 0);
    free(e);
}

int main(void)
{
    hard_begin("materials");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_index_one),
        cmocka_unit_test(test_roughness),
        cmocka_unit_test(test_gaps),
    };
    return cmocka_run_group_tests_name("hard_materials", tests, NULL, NULL);
}
