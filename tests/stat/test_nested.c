/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Solids in solids: priorities where they overlap, boundaries without a step of the index, and solids that touch, whose faces lie on
 * each other in whatever triangles.  A slab's transmittance at normal
 * incidence, Fresnel's with all reflections, tells which interfaces the light has met.
 */
#include "../unit/make_model.h"

#include "source.h"
#include "tracer.h"

#include <luminaires/spectrum.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { PHOTONS = 200000 };
#else
enum { PHOTONS = 1000000 };
#endif

typedef struct catcher {
    lmg_ray *rays; /* by number; flux 0 = hasn't come out */
    uint64_t up;
} catcher;

static void catch_rays(void *self, const lmg_ray *rays, size_t n)
{
    catcher *c = self;
    for (size_t i = 0; i < n; i++) {
        c->up += rays[i].direction.y > 0;
        if (c->rays) {
            c->rays[rays[i].number] = rays[i];
        }
    }
}

static void run(lum_model *model, uint64_t seed, catcher *c, bake_tally *tally)
{
    finish_model(model);
    bake_source *source;
    lmg_error err = {{0}};
    if (bake_tracer_create(model, seed, &source, &err) != LMG_OK) {
        fail_msg("%s", err.message);
    }
    *tally = (bake_tally){0};
    lmg_sink sink = {.self = c, .consume = catch_rays};
    assert_int_equal(source->run(source, 0, PHOTONS, 1, &sink, 1, tally, &err), LMG_OK);
    source->destroy(source);
}

/* A small black lamp at y = 0 shining up a long black tube: what gets to the slabs above it is nearly parallel, and what comes back
 * is absorbed. */
static void add_lamp(lum_model *model)
{
    uint32_t light = make_lambert(model, 0), black = make_material(model, LUM_SURFACE_BLACK);
    for (int c = 0; c < 3; c++) {
        model->materials[light].emissive[c] = 1;
    }
    make_quad(model, (lmg_vec3){-0.02, 0, -0.02}, (lmg_vec3){0, 0, 0.04}, (lmg_vec3){0.04, 0, 0}, 1, light);
    const double r = 0.021, top = 0.2;
    make_quad(model, (lmg_vec3){-r, 0, -r}, (lmg_vec3){2 * r, 0, 0}, (lmg_vec3){0, top, 0}, 1, black);
    make_quad(model, (lmg_vec3){-r, 0, r}, (lmg_vec3){2 * r, 0, 0}, (lmg_vec3){0, top, 0}, 1, black);
    make_quad(model, (lmg_vec3){-r, 0, -r}, (lmg_vec3){0, 0, 2 * r}, (lmg_vec3){0, top, 0}, 1, black);
    make_quad(model, (lmg_vec3){r, 0, -r}, (lmg_vec3){0, 0, 2 * r}, (lmg_vec3){0, top, 0}, 1, black);
}

static void add_slab(lum_model *model, double low, double high, double ior, int priority)
{
    uint32_t glass = make_glass(model, (float)ior, 0, false);
    model->materials[glass].priority = priority;
    make_box(model, (lmg_vec3){-0.5, low, -0.5}, (lmg_vec3){0.5, high, 0.5}, false, 1, glass);
}

typedef struct slab {
    double low, high, ior;
    int priority;
} slab;

static double transmitted(const slab *slabs, int count, bake_tally *tally)
{
    lum_model *model = make_model();
    add_lamp(model);
    for (int i = 0; i < count; i++) {
        add_slab(model, slabs[i].low, slabs[i].high, slabs[i].ior, slabs[i].priority);
    }
    catcher c = {0};
    run(model, 5, &c, tally);
    free_model(model);
    return (double)c.up;
}

/* Transmittance of a pile of layers for light straight on, intensities added: the interfaces' (1 - R) / R add up. */
static double pile(const double *n, int count)
{
    double sum = 0;
    for (int i = 0; i + 1 < count; i++) {
        double r = (n[i] - n[i + 1]) / (n[i] + n[i + 1]);
        sum += r * r / (1 - r * r);
    }
    return 1 / (1 + sum);
}

/* Liquid (1.33) filled into glass (1.9) so that it overlaps it by a tenth of a millimetre: with the glass above it in priority the
 * light meets air-glass, glass-liquid, liquid-air; the other way round the liquid displaces the glass, to the same effect; alone,
 * without an overlap but with a gap, there would be two more interfaces. */
static void the_higher_priority_is_there(void **state)
{
    (void)state;
    bake_tally tally;
    double open = transmitted(NULL, 0, &tally);
    static const double LAYERS[] = {1, 1.9, 1.33, 1}, GAP[] = {1, 1.9, 1, 1.33, 1};
    double expected = pile(LAYERS, 4), with_gap = pile(GAP, 5);
    for (int glass_first = 0; glass_first < 2; glass_first++) {
        slab s[] = {{0.25, 0.27, 1.9, glass_first ? 2 : 1}, {0.2699, 0.29, 1.33, glass_first ? 1 : 2}};
        double t = transmitted(s, 2, &tally) / open, error = sqrt(t * (1 - t) / open);
        print_message("overlap, %s first: transmitted %.4f +- %.4f; closed form straight on %.4f, with a gap %.4f\n",
                      glass_first ? "glass" : "liquid", t, error, expected, with_gap);
        assert_true(tally.lost == 0);
        /* Up to 11 degrees off straight on, unpolarized transmittance changes by less than 1e-3. */
        assert_true(fabs(t - expected) < 4 * error + 1e-3);
        assert_true(fabs(t - with_gap) > 4 * error);
    }
}

/* Three solids of which the middle one lies wholly inside of one of higher priority: it isn't there. */
static void what_is_hidden_does_nothing(void **state)
{
    (void)state;
    bake_tally tally;
    double open = transmitted(NULL, 0, &tally);
    slab s[] = {{0.25, 0.27, 1.5, 7}, {0.255, 0.262, 2.4, -3}};
    static const double LAYERS[] = {1, 1.5, 1};
    double t = transmitted(s, 2, &tally) / open, error = sqrt(t * (1 - t) / open);
    assert_true(tally.lost == 0);
    assert_true(fabs(t - pile(LAYERS, 3)) < 4 * error + 1e-3);
}

/* A ball of the index of what is around it changes no ray: the same directions to the last bit, on the same lines. */
static void matched_index_changes_nothing(void **state)
{
    (void)state;
    lmg_ray *rays[2];
    for (int with = 0; with < 2; with++) {
        lum_model *model = make_model();
        add_lamp(model);
        add_slab(model, 0.25, 0.35, 1.5, 0);
        if (with) {
            uint32_t same = make_glass(model, 1.5f, 0, false), air = make_glass(model, 1, 0, false);
            make_sphere(model, (lmg_vec3){0.001, 0.3, 0.002}, 0.02, 12, false, true, same);
            make_sphere(model, (lmg_vec3){0.003, 0.5, 0.001}, 0.1, 12, false, true, air);
        }
        rays[with] = calloc(PHOTONS, sizeof **rays);
        assert_non_null(rays[with]);
        catcher c = {.rays = rays[with]};
        bake_tally tally;
        run(model, 9, &c, &tally);
        assert_true(tally.lost == 0);
        free_model(model);
    }
    uint64_t came = 0, grazing = 0;
    for (int i = 0; i < PHOTONS; i++) {
        const lmg_ray *a = &rays[0][i], *b = &rays[1][i];
        assert_true((a->flux[1] > 0) == (b->flux[1] > 0));
        if (!(a->flux[1] > 0)) {
            continue;
        }
        assert_memory_equal(&a->direction, &b->direction, sizeof a->direction);
        double d[3] = {b->origin.x - a->origin.x, b->origin.y - a->origin.y, b->origin.z - a->origin.z};
        double along = d[0] * a->direction.x + d[1] * a->direction.y + d[2] * a->direction.z;
        double off = sqrt(fmax(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - along * along, 0));
        /* Rounding of distances of a metre; rays that touch the ball within 0.6 degrees are moved aside by the hit's error. */
        grazing += off > 1e-7;
        assert_true(off < 1e-6);
        came++;
    }
    print_message("%llu rays, %llu of them moved aside\n", (unsigned long long)came, (unsigned long long)grazing);
    assert_true(came > PHOTONS / 200 && grazing * 1000 < came);
    free(rays[0]);
    free(rays[1]);
}

/* ------------------------------------------------------------------------------------------------------------- contact */

/* Glass on liquid in contact, the faces cut into 1, 3 or 7 squares a side; whichever comes first in the file.  One interface, with Fresnel's
 * reflectance of the two indices, from below and (the lamp's light that comes back) from above. */
static void contact_is_one_interface(void **state)
{
    (void)state;
    bake_tally tally;
    double open = transmitted(NULL, 0, &tally);
    static const double LAYERS[] = {1, 1.9, 1.33, 1};
    const double expected = pile(LAYERS, 4);
    static const uint32_t CUTS[][2] = {{1, 1}, {1, 3}, {3, 7}, {7, 1}};
    for (int i = 0; i < 8; i++) {
        lum_model *model = make_model();
        add_lamp(model);
        const bool liquid_first = i & 1;
        uint32_t glass = make_glass(model, 1.9f, 0, false), liquid = make_glass(model, 1.33f, 0, false);
        model->materials[i & 2 ? glass : liquid].priority = 1;
        for (int k = 0; k < 2; k++) {
            if ((k == 0) != liquid_first) {
                make_box(model, (lmg_vec3){-0.5, 0.25, -0.5}, (lmg_vec3){0.5, 0.27, 0.5}, false, CUTS[i / 2][0], glass);
            } else {
                make_box(model, (lmg_vec3){-0.43, 0.27, -0.47}, (lmg_vec3){0.41, 0.29, 0.5}, false, CUTS[i / 2][1], liquid);
            }
        }
        catcher c = {0};
        run(model, 5, &c, &tally);
        free_model(model);
        double t = (double)c.up / open, error = sqrt(t * (1 - t) / open);
        print_message("contact, cut %u and %u, %s first: transmitted %.4f +- %.4f; closed form %.4f; lost %.2g\n", CUTS[i / 2][0],
                      CUTS[i / 2][1], liquid_first ? "liquid" : "glass", t, error, expected, tally.lost / tally.emitted);
        assert_true(tally.lost == 0);
        assert_true(fabs(t - expected) < 4 * error + 1e-3); /* as above */
    }
}

/* A block cut in two along a plane, each half with triangles and a material of its own but the same index, changes no ray. */
static void contact_of_equals_changes_nothing(void **state)
{
    (void)state;
    lmg_ray *rays[2];
    for (int cut = 0; cut < 2; cut++) {
        lum_model *model = make_model();
        add_lamp(model);
        uint32_t glass = make_glass(model, 1.5f, 0, false), other = make_glass(model, 1.5f, 0, false);
        if (cut) {
            make_box(model, (lmg_vec3){-0.5, 0.25, -0.5}, (lmg_vec3){0.5, 0.29, 0.5}, false, 5, glass);
            make_box(model, (lmg_vec3){-0.5, 0.29, -0.5}, (lmg_vec3){0.5, 0.35, 0.5}, false, 3, other);
        } else {
            make_box(model, (lmg_vec3){-0.5, 0.25, -0.5}, (lmg_vec3){0.5, 0.35, 0.5}, false, 5, glass);
        }
        rays[cut] = calloc(PHOTONS, sizeof **rays);
        assert_non_null(rays[cut]);
        catcher c = {.rays = rays[cut]};
        bake_tally tally;
        run(model, 9, &c, &tally);
        assert_true(tally.lost == 0);
        free_model(model);
    }
    uint64_t came = 0;
    for (int i = 0; i < PHOTONS; i++) {
        const lmg_ray *a = &rays[0][i], *b = &rays[1][i];
        assert_true((a->flux[1] > 0) == (b->flux[1] > 0));
        if (a->flux[1] > 0) {
            assert_memory_equal(&a->direction, &b->direction, sizeof a->direction);
            assert_true(fabs(a->origin.x - b->origin.x) < 1e-6 && fabs(a->origin.z - b->origin.z) < 1e-6);
            came++;
        }
    }
    assert_true(came > PHOTONS / 200);
    free(rays[0]);
    free(rays[1]);
}

/* Two media of index 1 in contact, cut into other triangles on each side, whichever comes first in the file: a beam straight through both keeps
 * exp(-depth) of each, and nothing is lost.  Four standard errors. */
static void media_in_contact(void **state)
{
    (void)state;
    static const float SCATTERING[2] = {30, 5}, ABSORPTION[2] = {10, 20};
    static const double LOW[2] = {0.1, 0.11}, HIGH[2] = {0.11, 0.14}; /* depths 0.4 and 0.75 */
    for (int order = 0; order < 2; order++) {
        lum_model *model = make_model();
        for (int k = 0; k < 2; k++) {
            const int which = order ? 1 - k : k;
            const uint32_t glass = make_glass(model, 1, 0, false);
            for (int c = 0; c < 3; c++) {
                model->materials[glass].scattering[c] = SCATTERING[which];
                model->materials[glass].absorption[c] = ABSORPTION[which];
            }
            make_box(model, (lmg_vec3){-0.3, LOW[which], -0.3}, (lmg_vec3){0.3, HIGH[which], 0.3}, false, which ? 3 : 5, glass);
        }
        lum_light *l = model->lights = calloc(1, sizeof *l);
        assert_non_null(l);
        model->light_count = 1;
        *l = (lum_light){.kind = LUM_LIGHT_SPOT,
                         .position = {0.001, 0, 0.002},
                         .direction = {0, 1, 0},
                         .intensity = {1000, 1000, 1000},
                         .cos_inner = cos(0.5e-6),
                         .cos_outer = cos(1e-6)};
        lmg_ray *rays = calloc(PHOTONS, sizeof *rays);
        assert_non_null(rays);
        catcher c = {.rays = rays};
        bake_tally tally;
        run(model, 21, &c, &tally);
        free_model(model);
        assert_true(tally.lost == 0 && tally.escaped + tally.absorbed == tally.emitted);
        double straight = 0;
        for (int i = 0; i < PHOTONS; i++) {
            straight += rays[i].flux[1] != 0 && rays[i].direction.y > 1 - 1e-11;
        }
        free(rays);
        const double share = straight / PHOTONS, expected = exp(-0.4 - 0.75), error = sqrt(expected * (1 - expected) / PHOTONS);
        print_message("through two media in contact: %.5f +- %.5f, expected %.5f\n", share, error, expected);
        assert_true(fabs(share - expected) < 4 * error);
    }
}

/* A sphere whose rings of flat quads are cut along the one diagonal, along the other one, or also by points on their edges. */
static void add_flat_sphere(lum_model *model, double radius, uint32_t rings, int cut, bool inward, uint32_t material)
{
    const double pi = 3.14159265358979323846;
    for (uint32_t j = 0; j < rings; j++) {
        for (uint32_t i = 0; i < 2 * rings; i++) {
            lmg_vec3 c[4]; /* lower left, lower right, upper right, upper left, seen from outside */
            for (int k = 0; k < 4; k++) {
                const double theta = pi * (j + (k < 2)) / rings, phi = pi * (i + (k == 1 || k == 2)) / rings;
                c[k] = (lmg_vec3){radius * sin(theta) * cos(phi), radius * cos(theta), -radius * sin(theta) * sin(phi)};
                if ((j == 0 && k >= 2) || (j + 1 == rings && k < 2)) {
                    c[k].x = c[k].z = 0; /* the poles exactly */
                }
                if (i + 1 == 2 * rings && (k == 1 || k == 2)) {
                    c[k] = (lmg_vec3){radius * sin(theta), c[k].y, 0}; /* and the seam */
                    c[k].x = (j == 0 && k == 2) || (j + 1 == rings && k == 1) ? 0 : c[k].x;
                }
                if (i == 0 && (k == 0 || k == 3)) {
                    c[k].z = 0;
                }
            }
            static const int CUTS[2][2][3] = {{{0, 1, 2}, {0, 2, 3}}, {{0, 1, 3}, {1, 2, 3}}};
            for (int k = 0; k < 2; k++) {
                const int *t = CUTS[cut & 1][k];
                lmg_vec3 a = c[t[0]], b = c[t[1]], d = c[t[2]];
                if ((a.x == b.x && a.y == b.y && a.z == b.z) || (b.x == d.x && b.y == d.y && b.z == d.z) ||
                    (a.x == d.x && a.y == d.y && a.z == d.z)) {
                    continue;
                }
                if (cut < 2) {
                    make_triangle(model, a, inward ? d : b, inward ? b : d, material);
                    continue;
                }
                lmg_vec3 m[3] = {{(a.x + b.x) / 2, (a.y + b.y) / 2, (a.z + b.z) / 2},
                                 {(b.x + d.x) / 2, (b.y + d.y) / 2, (b.z + d.z) / 2},
                                 {(d.x + a.x) / 2, (d.y + a.y) / 2, (d.z + a.z) / 2}};
                lmg_vec3 four[4][3] = {{a, m[0], m[2]}, {m[0], b, m[1]}, {m[2], m[1], d}, {m[0], m[1], m[2]}};
                for (int f = 0; f < 4; f++) {
                    make_triangle(model, four[f][0], four[f][inward ? 2 : 1], four[f][inward ? 1 : 2], material);
                }
            }
        }
    }
}

typedef struct spread {
    double sum[3]; /* of direction . (0, 1, 0)^k, k = 1 .. 3: enough to tell two far fields apart */
    uint64_t count;
} spread;

static void add_up(void *self, const lmg_ray *rays, size_t n)
{
    spread *s = self;
    for (size_t i = 0; i < n; i++) {
        const double y = rays[i].direction.y;
        s->sum[0] += y;
        s->sum[1] += y * y;
        s->sum[2] += y * y * y;
        s->count++;
    }
}

/* A square that shines up, in the plane where a block is cut in two, whichever comes first in the file: the far field
 * (share of the light that comes out, mean of its cosine and of its square and cube) is that of the same square in the whole
 * block.  Four standard errors of a difference, for photons on their own: cosines' powers have a variance of at most 1.  Lost is at most
 * what meets a side, 0.08 m high, nearer to the line where the cut ends than hits keep from edges, four errors of 32 x 2^-24 x 0.05 m;
 * in the whole block nothing. */
static void a_lamp_where_a_block_is_cut(void **state)
{
    (void)state;
    double mean[3][4] = {{0}};
    for (int cut = 0; cut < 3; cut++) {
        lum_model *model = make_model();
        const uint32_t lamp = make_lambert(model, 0.5f), glass = make_glass(model, 1.5f, 0, false), other = make_glass(model, 1.5f, 0, false);
        for (int c = 0; c < 3; c++) {
            model->materials[lamp].emissive[c] = 1000;
        }
        if (cut == 0) {
            make_box(model, (lmg_vec3){-0.05, 0.02, -0.05}, (lmg_vec3){0.05, 0.1, 0.05}, false, 4, glass);
        }
        if (cut == 2) {
            make_box(model, (lmg_vec3){-0.05, 0.06, -0.05}, (lmg_vec3){0.05, 0.1, 0.05}, false, 3, other);
        }
        make_quad(model, (lmg_vec3){-0.011, 0.06, -0.013}, (lmg_vec3){0, 0, 0.02}, (lmg_vec3){0.02, 0, 0}, 1, lamp);
        if (cut > 0) {
            make_box(model, (lmg_vec3){-0.05, 0.02, -0.05}, (lmg_vec3){0.05, 0.06, 0.05}, false, 5, glass);
        }
        if (cut == 1) {
            make_box(model, (lmg_vec3){-0.05, 0.06, -0.05}, (lmg_vec3){0.05, 0.1, 0.05}, false, 3, other);
        }
        finish_model(model);
        bake_source *source;
        lmg_error err = {{0}};
        assert_int_equal(bake_tracer_create(model, 30 + (uint64_t)cut, &source, &err), LMG_OK);
        spread s = {{0}, 0};
        const lmg_sink sink = {.self = &s, .consume = add_up};
        bake_tally tally = {0};
        assert_int_equal(source->run(source, 0, PHOTONS, 1, &sink, 1, &tally, &err), LMG_OK);
        source->destroy(source);
        free_model(model);
        print_message("lamp in a block, cut %d: %.5f come out, lost %.0f, %.1f segments each; moments %.5f %.5f %.5f\n", cut, (double)s.count / PHOTONS, tally.lost, (double)tally.segments / PHOTONS,
                      s.sum[0] / (double)s.count, s.sum[1] / (double)s.count, s.sum[2] / (double)s.count);
        assert_true(tally.lost <= (cut ? (double)tally.segments * 2 * 4 * 32 * 0x1p-24 * 0.05 / 0.08 : 0));
        mean[cut][3] = (double)s.count / PHOTONS;
        for (int k = 0; k < 3; k++) {
            mean[cut][k] = s.sum[k] / (double)s.count;
        }
        for (int k = 0; k < 4; k++) {
            assert_true(fabs(mean[cut][k] - mean[0][k]) < 4 * sqrt(2 / (double)s.count));
        }
    }
}

/* A bulb: glass around a liquid that fills it, the inner wall of the glass and the liquid's surface in contact but cut otherwise, each
 * rounded to floats by itself; in it, off the centre, a bubble with a small square that shines.  Nothing is lost and nothing absorbed,
 * and the far field is that of the same bulb whose liquid reaches a little into glass of higher priority. */
static void bulb_filled_to_the_wall(void **state)
{
    (void)state;
    spread s[3] = {{{0}, 0}};
    for (int kind = 0; kind < 3; kind++) { /* 0: overlap; 1, 2: contact, other cuts and other order of priority */
        lum_model *model = make_model();
        uint32_t light = make_lambert(model, 0), glass = make_glass(model, 1.52f, 0, false), liquid = make_glass(model, 1.41f, 0, false);
        for (int c = 0; c < 3; c++) {
            model->materials[light].emissive[c] = 1;
        }
        model->materials[light].base_color[0] = model->materials[light].base_color[1] = model->materials[light].base_color[2] = 1;
        model->materials[kind == 2 ? liquid : glass].priority = 2;
        make_quad(model, (lmg_vec3){0.002, 0.004, 0.001}, (lmg_vec3){0.001, 0, 0}, (lmg_vec3){0, 0.0003, -0.001}, 1, light);
        make_sphere(model, (lmg_vec3){0.0025, 0.004, 0.0005}, 0.0025, 10, true, false, liquid);
        add_flat_sphere(model, 0.02, 16, 0, false, glass);
        add_flat_sphere(model, 0.018, 16, kind == 2 ? 1 : 0, true, glass);
        add_flat_sphere(model, kind ? 0.018 : 0.0182, 16, kind == 1 ? 1 : kind == 2 ? 2 : 0, false, liquid);
        finish_model(model);
        bake_source *source;
        lmg_error err = {{0}};
        assert_int_equal(bake_tracer_create(model, 3, &source, &err), LMG_OK);
        bake_tally tally = {0};
        lmg_sink sink = {.self = &s[kind], .consume = add_up};
        assert_int_equal(source->run(source, 0, PHOTONS, 1, &sink, 1, &tally, &err), LMG_OK);
        source->destroy(source);
        free_model(model);
        print_message("bulb, %s: %.0f out, lost %.2g, absorbed %.2g\n", kind ? "contact" : "overlap", tally.escaped,
                      tally.lost / tally.emitted, tally.absorbed / tally.emitted);
        assert_true(tally.lost <= 1); /* of a million; sanitizers follow the first 200,000 of the same */
        assert_true(tally.absorbed == 0);
    }
    for (int kind = 1; kind < 3; kind++) {
        for (int k = 0; k < 3; k++) {
            /* Powers of a cosine: variance below that of the next even power's mean, at most 1. */
            const double mine = s[kind].sum[k] / (double)s[kind].count, its = s[0].sum[k] / (double)s[0].count;
            print_message("mean of cos^%d: contact %.5f, overlap %.5f\n", k + 1, mine, its);
            assert_true(fabs(mine - its) < 4 * sqrt(2.0 / 3 / PHOTONS));
        }
    }
}

static uint32_t add_half_diffuser(lum_model *model)
{
    uint32_t sheet = make_material(model, LUM_SURFACE_PBR);
    model->materials[sheet].thin = true;
    model->materials[sheet].diffuse_transmission = 0.5f;
    model->materials[sheet].ior = 1; /* nothing specular */
    return sheet;
}

/* Glass that lies on an opaque mirror, on a sheet that lets half of the light through diffusely, and a solid held by another whose bottoms
 * are in one plane: no light slips through the mirror, none is lost. */
static void contact_with_sheets(void **state)
{
    (void)state;
    for (int kind = 0; kind < 3; kind++) {
        lum_model *model = make_model();
        uint32_t light = make_lambert(model, 0), glass = make_glass(model, 1.5f, 0, false), inner = make_glass(model, 1.8f, 0, false);
        uint32_t sheet = kind == 0 ? make_mirror(model, 1, 0) : add_half_diffuser(model);
        for (int c = 0; c < 3; c++) {
            model->materials[light].emissive[c] = 1;
        }
        make_quad(model, (lmg_vec3){-0.01, 0.3, -0.01}, (lmg_vec3){0.02, 0, 0}, (lmg_vec3){0, 0, 0.02}, 1, light); /* downwards */
        make_box(model, (lmg_vec3){-0.3, 0, -0.3}, (lmg_vec3){0.3, 0.1, 0.3}, false, 2, glass);
        if (kind < 2) {
            make_quad(model, (lmg_vec3){-0.5, 0, -0.5}, (lmg_vec3){0, 0, 1}, (lmg_vec3){1, 0, 0}, 3, sheet);
        } else {
            make_box(model, (lmg_vec3){-0.1, 0, -0.1}, (lmg_vec3){0.15, 0.05, 0.12}, false, 3, inner);
        }
        bake_tally tally;
        lmg_ray *rays = calloc(PHOTONS, sizeof *rays);
        assert_non_null(rays);
        catcher c = {.rays = rays};
        run(model, 7, &c, &tally);
        free_model(model);
        uint64_t below = 0;
        for (int i = 0; i < PHOTONS; i++) {
            /* what comes out within the mirror's square, going down */
            const lmg_ray *r = &rays[i];
            below += r->flux[1] > 0 && r->direction.y < 0 && r->origin.y < -1e-9 && fabs(r->origin.x) < 0.29 && fabs(r->origin.z) < 0.29;
        }
        print_message("kind %d: lost %.2g, absorbed %.4f, below %llu\n", kind, tally.lost / tally.emitted,
                      tally.absorbed / tally.emitted, (unsigned long long)below);
        assert_true(tally.lost == 0);
        assert_true((below == 0) == (kind == 0));
        free(rays);
    }
}

/* Reflectance of a clear slab for light from all sides alike: both faces, intensities added, unpolarized face by face. */
static double diffuse_reflectance_of_slab(double n)
{
    enum { STEPS = 20000 };
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        const double sine2 = (i + 0.5) / STEPS, c = sqrt(1 - sine2), g = sqrt(1 - sine2 / (n * n));
        const double s = (c - n * g) / (c + n * g), p = (n * c - g) / (n * c + g), r = (s * s + p * p) / 2;
        sum += 2 * r / (1 + r);
    }
    return sum / STEPS;
}

/* A sheet in the plane of a slab's lower or upper face, facing up or down: it lies outside of the glass, whichever light meets first.  A pane
 * adds its two interfaces; of a sheet that reflects and transmits a half diffusely, light goes to and fro between it and the slab. */
static void sheets_lie_outside(void **state)
{
    (void)state;
    bake_tally tally;
    const double open = transmitted(NULL, 0, &tally), low = 0.25, high = 0.27, n = 1.9;
    static const double SLAB[] = {1, 1.9, 1}, WITH_PANE[] = {1, 1.5, 1, 1.9, 1};
    const double back = diffuse_reflectance_of_slab(n);
    for (int i = 0; i < 8; i++) {
        const bool upper = i & 1, faces_up = i & 2, diffuser = i & 4;
        lum_model *model = make_model();
        add_lamp(model);
        uint32_t sheet = diffuser ? add_half_diffuser(model) : make_glass(model, 1.5f, 0, true);
        const double r = 0.45, y = upper ? high : low;
        const lmg_vec3 x = {2 * r, 0, 0}, z = {0, 0, 2 * r};
        make_quad(model, (lmg_vec3){-r, y, -r}, faces_up ? z : x, faces_up ? x : z, 3, sheet);
        add_slab(model, low, high, n, 0);
        catcher c = {0};
        run(model, 5, &c, &tally);
        free_model(model);
        const double expected = !diffuser ? pile(WITH_PANE, 5) : (upper ? pile(SLAB, 3) : 1 - back) * 0.5 / (1 - 0.5 * back);
        const double t = (double)c.up / open, error = sqrt(t * (1 - t) / open);
        print_message("%s at the %s face: transmitted %.4f +- %.4f; closed form %.4f\n", diffuser ? "diffuser" : "pane",
                      upper ? "upper" : "lower", t, error, expected);
        assert_true(tally.lost == 0);
        assert_true(fabs(t - expected) < 4 * error + 1e-3); /* as above */
    }
}

/* A beam at 60 degrees through a slab with a pane in the plane of either face: it crosses the slab at the angle of refraction, once, three
 * times, five times ... */
static void a_pane_hides_no_refraction(void **state)
{
    (void)state;
    for (int upper = 0; upper < 2; upper++) {
        lum_model *model = make_model();
        uint32_t glass = make_glass(model, 1.5f, 0, false), pane = make_glass(model, 1.5f, 0, true);
        const double sine = sqrt(0.75), low = 0.1, high = 0.11;
        make_box(model, (lmg_vec3){-0.4, low, -0.3}, (lmg_vec3){0.4, high, 0.3}, false, 2, glass);
        make_quad(model, (lmg_vec3){-0.35, upper ? high : low, -0.25}, (lmg_vec3){0.7, 0, 0}, (lmg_vec3){0, 0, 0.5}, 3, pane);
        lum_light *l = model->lights = calloc(1, sizeof *l);
        assert_non_null(l);
        model->light_count = 1;
        *l = (lum_light){.kind = LUM_LIGHT_SPOT,
                         .position = {0.003 - low * sine / 0.5, 0, 0.002},
                         .direction = {sine, 0.5, 0},
                         .intensity = {1000, 1000, 1000},
                         .cos_inner = cos(0.5e-6),
                         .cos_outer = cos(1e-6)};
        lmg_ray *rays = calloc(PHOTONS, sizeof *rays);
        assert_non_null(rays);
        catcher c = {.rays = rays};
        bake_tally tally;
        run(model, 5, &c, &tally);
        free_model(model);
        assert_true(tally.lost == 0);
        const double once = (high - low) * (sine / 1.5) / sqrt(1 - 0.75 / 2.25);
        double worst = 0;
        uint64_t came = 0;
        for (int i = 0; i < PHOTONS; i++) {
            const lmg_ray *r = &rays[i];
            if (r->flux[1] > 0 && r->origin.y > high - 1e-4) {
                const double times = (r->origin.x - 0.003) / once;
                worst = fmax(worst, fabs(times - (2 * floor(times / 2) + 1)) * once);
                assert_true(fabs(r->direction.x - sine) < 4e-6);
                came++;
            }
        }
        print_message("%llu rays, off by at most %.1e m\n", (unsigned long long)came, worst);
        assert_true(came > PHOTONS / 2);
        assert_true(worst < 2e-5); /* an offset of about 1e-6 at each of up to some twenty faces; unrefracted light is off by 3e-3 */
        free(rays);
    }
}

/* A sheet that lets light through and a mirror in the plane of a block's face, whichever comes first in the file, lit through the block and from
 * outside: nothing passes the mirror. */
static void nothing_slips_through_a_mirror(void **state)
{
    (void)state;
    for (int kind = 0; kind < 16; kind++) {
        lum_model *model = make_model();
        uint32_t light = make_lambert(model, 0), glass = make_glass(model, 1.5f, 0, false), mirror = make_mirror(model, 1, 0);
        uint32_t sheet = kind & 4 ? add_half_diffuser(model) : make_glass(model, 1.5f, 0, true);
        for (int c = 0; c < 3; c++) {
            model->materials[light].emissive[c] = 1;
        }
        const bool below = kind & 1, faces_up = kind & 8;
        const lmg_vec3 along = {0.02, 0, 0}, across = {0, 0, 0.02}, x = {1, 0, 0}, z = {0, 0, 1};
        make_quad(model, (lmg_vec3){-0.01, below ? -0.05 : 0.2, -0.01}, below ? across : along, below ? along : across, 1, light);
        make_box(model, (lmg_vec3){-0.3, 0, -0.3}, (lmg_vec3){0.3, 0.1, 0.3}, false, 2, glass);
        for (int k = 0; k < 2; k++) {
            const bool first = (kind & 2) != 0;
            make_quad(model, (lmg_vec3){-0.5, 0, -0.5}, faces_up ? z : x, faces_up ? x : z, 3, (k == 0) == first ? mirror : sheet);
        }
        bake_tally tally;
        lmg_ray *rays = calloc(PHOTONS, sizeof *rays);
        assert_non_null(rays);
        catcher c = {.rays = rays};
        run(model, 7, &c, &tally);
        free_model(model);
        uint64_t through = 0;
        for (int i = 0; i < PHOTONS; i++) {
            const lmg_ray *r = &rays[i];
            const bool within = fabs(r->origin.x) < 0.29 && fabs(r->origin.z) < 0.29;
            through += r->flux[1] > 0 && within && (below ? r->origin.y > 1e-4 : r->origin.y < -1e-4 || (r->direction.y < 0 && r->origin.y < 1e-4));
        }
        assert_true(tally.lost == 0);
        assert_true(tally.emitted > 0 && through == 0);
        free(rays);
    }
}

/* Light of the bulb by the lean kernel and by the one with media and wavelengths too: the same rays to the last bit. */
static void kernels_agree_on_contact(void **state)
{
    (void)state;
    lum_model *model = make_model();
    add_lamp(model);
    uint32_t glass = make_glass(model, 1.9f, 0.2f, false), liquid = make_glass(model, 1.33f, 0, false);
    model->materials[liquid].absorption[0] = 20;
    make_box(model, (lmg_vec3){-0.5, 0.25, -0.5}, (lmg_vec3){0.5, 0.27, 0.5}, false, 3, glass);
    make_box(model, (lmg_vec3){-0.5, 0.27, -0.5}, (lmg_vec3){0.5, 0.29, 0.5}, false, 2, liquid);
    finish_model(model);
    lmg_ray *rays[2] = {calloc(PHOTONS, sizeof **rays), calloc(PHOTONS, sizeof **rays)};
    assert_true(rays[0] && rays[1]);
    bake_source *source;
    lmg_error err = {{0}};
    assert_int_equal(bake_tracer_create(model, 5, &source, &err), LMG_OK);
    assert_string_equal(bake_tracer_kernel(source), "touching");
    uint32_t runs = 0;
    for (size_t k = 0; k < 64 && runs < 2; k++) { /* more than there are */
        if (bake_tracer_use_kernel(source, k)) {
            catcher c = {.rays = rays[runs++]};
            bake_tally tally = {0};
            lmg_sink sink = {.self = &c, .consume = catch_rays};
            assert_int_equal(source->run(source, 0, PHOTONS / 4, 1, &sink, 1, &tally, &err), LMG_OK);
        }
    }
    assert_int_equal(runs, 2);
    source->destroy(source);
    free_model(model);
    assert_memory_equal(rays[0], rays[1], PHOTONS * sizeof **rays);
    free(rays[0]);
    free(rays[1]);
}

/* A beam born in a clear layer between two of a dispersive glass that touch it: whatever is refracted or reflected on the way, what comes out
 * at the top keeps the sine of its angle times the layer's index, if each of its interfaces has the index of one wavelength. */
static void one_wavelength_from_birth_on(void **state)
{
    (void)state;
    lum_index_model catalogue;
    static lum_spectrum index;
    lmg_error err;
    assert_true(lum_index_of_glass("N-SF11", &catalogue));
    assert_int_equal(lum_spectrum_of_index(&catalogue, &index, &err), LMG_OK);
    lum_model *model = make_model();
    uint32_t clear = make_glass(model, 1.4f, 0, false), dispersive = make_glass(model, 1.78f, 0, false);
    model->materials[dispersive].spectral.index = &index;
    make_box(model, (lmg_vec3){-0.3, 0.1, -0.3}, (lmg_vec3){0.3, 0.11, 0.3}, false, 3, dispersive);
    make_box(model, (lmg_vec3){-0.3, 0.08, -0.3}, (lmg_vec3){0.3, 0.09, 0.3}, false, 3, dispersive);
    make_box(model, (lmg_vec3){-0.25, 0.09, -0.25}, (lmg_vec3){0.25, 0.1, 0.25}, false, 2, clear);
    lum_light *l = model->lights = calloc(1, sizeof *l);
    assert_non_null(l);
    model->light_count = 1;
    const double sine = 0.5;
    *l = (lum_light){.kind = LUM_LIGHT_SPOT,
                     .position = {0.001, 0.095, 0.002},
                     .direction = {sine, sqrt(1 - sine * sine), 0},
                     .intensity = {1000, 1000, 1000},
                     .cos_inner = cos(0.5e-6),
                     .cos_outer = cos(1e-6)};
    lmg_ray *rays = calloc(PHOTONS, sizeof *rays);
    assert_non_null(rays);
    catcher c = {.rays = rays};
    bake_tally tally;
    run(model, 5, &c, &tally);
    free_model(model);
    assert_true(tally.lost == 0);
    uint64_t straight = 0;
    double worst = 0;
    for (int i = 0; i < PHOTONS; i++) {
        /* what hasn't met the sides */
        if (rays[i].flux[1] != 0 && rays[i].origin.y > 0.1099 && fabs(rays[i].origin.x) < 0.2) {
            worst = fmax(worst, fabs(rays[i].direction.x - 1.4 * sine));
            straight++;
        }
    }
    print_message("%llu rays, sine off by at most %.1e\n", (unsigned long long)straight, worst);
    assert_true(straight > PHOTONS / 2);
    assert_true(worst < 4e-6); /* the beam's width, and the floats that indices are */
    free(rays);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_higher_priority_is_there),
                                       cmocka_unit_test(what_is_hidden_does_nothing),
                                       cmocka_unit_test(matched_index_changes_nothing),
                                       cmocka_unit_test(contact_is_one_interface),
                                       cmocka_unit_test(contact_of_equals_changes_nothing),
                                       cmocka_unit_test(media_in_contact),
                                       cmocka_unit_test(a_lamp_where_a_block_is_cut),
                                       cmocka_unit_test(bulb_filled_to_the_wall),
                                       cmocka_unit_test(contact_with_sheets),
                                       cmocka_unit_test(sheets_lie_outside),
                                       cmocka_unit_test(a_pane_hides_no_refraction),
                                       cmocka_unit_test(nothing_slips_through_a_mirror),
                                       cmocka_unit_test(kernels_agree_on_contact),
                                       cmocka_unit_test(one_wavelength_from_birth_on)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
