/* SPDX-License-Identifier: Apache-2.0 */
/* Rays against triangles: no leaks out of closed bodies, hits on the surface, agreement with a loop over all triangles. */
#include "../unit/make_model.h"

#include <luminaires/rng.h>

#include <fenv.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <cmocka.h>

typedef struct walk {
    uint64_t bounces, escaped, outer, wrong_side;
    double largest_error; /* distance of hits from where they should be, in units of lum_hit.error */
} walk;

/* Bounces through the scene; a photon that meets nothing has escaped and starts again. */
static walk bounce(const lum_model *model, lmg_vec3 start, uint64_t bounces, uint64_t seed, uint32_t first_outer, bool lambert)
{
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    unsigned saved = lum_thread_begin();
    walk w = {0};
    lum_rng rng = lum_rng_stream(seed, 0);
    bool fresh = true;
    lmg_vec3 o = start, d = {0, 0, 1};
    for (uint64_t i = 0; i < bounces; i++) {
        if (fresh) {
            double z = 2 * lum_rng_next(&rng) - 1, phi = 6.283185307179586 * lum_rng_next(&rng), r = sqrt(1 - z * z);
            o = start;
            d = (lmg_vec3){r * cos(phi), r * sin(phi), z};
            fresh = false;
        }
        lum_hit hit;
        if (!lum_scene_intersect(scene, o, d, &hit)) {
            w.escaped++;
            fresh = true;
            continue;
        }
        w.bounces++;
        w.outer += hit.triangle >= first_outer;
        lum_surface s;
        lum_scattered out;
        double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lum_surface_at(scene, &hit, d, &s);
        w.wrong_side += !s.front;
        lum_scatter_trace(&s, (lmg_vec3){-d.x, -d.y, -d.z}, 1, xi, NULL, &out);
        o = lum_offset(&hit, out.wo);
        d = out.wo;
        double n2 = d.x * d.x + d.y * d.y + d.z * d.z;
        assert_true(fabs(n2 - 1) < 1e-9);
        double n = 1 / sqrt(n2); /* a tracer renormalizes now and then */
        d = (lmg_vec3){d.x * n, d.y * n, d.z * n};
        fresh = !lambert && (i & 0xfff) == 0xfff; /* mirror paths may be periodic */
    }
    lum_thread_end(saved);
    lum_scene_destroy(scene);
    return w;
}

static void report(const char *what, walk w)
{
    print_message("%s: %llu bounces, %llu escaped, %llu beyond the wall, %llu on the back\n", what, (unsigned long long)w.bounces,
                  (unsigned long long)w.escaped, (unsigned long long)w.outer, (unsigned long long)w.wrong_side);
    assert_int_equal(w.escaped, 0);
    assert_int_equal(w.outer, 0);
    assert_int_equal(w.wrong_side, 0);
}

/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { BOUNCES = 300000 };
#else
enum { BOUNCES = 10000000 };
#endif

static void closed_boxes_keep_light(void **state)
{
    (void)state;
    for (int lambert = 0; lambert < 2; lambert++) {
        lum_model *model = make_model();
        uint32_t m = lambert ? make_lambert(model, 1) : make_mirror(model, 1, 0);
        /* Off centre, edges of odd lengths. */
        make_box(model, (lmg_vec3){-0.317, -0.411, -0.223}, (lmg_vec3){0.529, 0.377, 0.613}, true, 3, m);
        finish_model(model);
        report(lambert ? "white box" : "mirror box", bounce(model, (lmg_vec3){0.1, 0.05, 0.2}, BOUNCES, 11, UINT32_MAX, lambert));
        free_model(model);
    }
}

static void closed_spheres_keep_light(void **state)
{
    (void)state;
    for (int smooth = 0; smooth < 2; smooth++) {
        lum_model *model = make_model();
        uint32_t m = make_mirror(model, 1, 0);
        make_sphere(model, (lmg_vec3){0.02, 0.01, -0.03}, 0.5, 50, true, smooth, m);
        finish_model(model);
        report(smooth ? "mirror sphere, smooth normals" : "mirror sphere, facets",
               bounce(model, (lmg_vec3){0.1, 0.05, 0.2}, BOUNCES, 12, UINT32_MAX, false));
        free_model(model);
    }
}

/* A second box 0.1 mm outside of a 1 m box: nothing may get between. */
static void thin_shells_hold(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t m = make_lambert(model, 1);
    double t = 1e-4;
    lmg_vec3 low = {-0.5, -0.5, -0.5}, high = {0.5, 0.5, 0.5};
    make_box(model, low, high, true, 2, m);
    uint32_t inner = model->triangle_count;
    make_box(model, (lmg_vec3){low.x - t, low.y - t, low.z - t}, (lmg_vec3){high.x + t, high.y + t, high.z + t}, true, 2, m);
    finish_model(model);
    report("0.1 mm behind a 1 m box", bounce(model, (lmg_vec3){0.1, 0.05, 0.2}, BOUNCES, 13, inner, true));
    /* The offset is a fiftieth of the wall at most. */
    lum_scene *scene;
    lum_hit hit;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    assert_true(lum_scene_intersect(scene, (lmg_vec3){0, 0, 0}, (lmg_vec3){0, 0.6, 0.8}, &hit));
    assert_true(hit.error <= t / 50);
    lum_scene_destroy(scene);
    free_model(model);
}

/* Walls that meet at 20 degrees, in a prism. */
static void acute_edges_hold(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t m = make_lambert(model, 1);
    double h = tan(20 * 3.14159265358979323846 / 180);
    lmg_vec3 a = {-0.3, -0.2, -0.4}, b = {0.7, -0.2, -0.4}, c = {0.7, h - 0.2, -0.4};
    lmg_vec3 a2 = {a.x, a.y, 0.4}, b2 = {b.x, b.y, 0.4}, c2 = {c.x, c.y, 0.4}, z = {0, 0, 0.8};
    make_triangle(model, a, b, c, m);
    make_triangle(model, a2, c2, b2, m);
    make_quad(model, a, z, (lmg_vec3){b.x - a.x, b.y - a.y, 0}, 1, m);
    make_quad(model, b, z, (lmg_vec3){c.x - b.x, c.y - b.y, 0}, 1, m);
    make_quad(model, c, z, (lmg_vec3){a.x - c.x, a.y - c.y, 0}, 1, m);
    (void)a2;
    finish_model(model);
    report("prism with an edge of 20 degrees", bounce(model, (lmg_vec3){0.5, -0.1, 0.1}, BOUNCES, 14, UINT32_MAX, true));
    free_model(model);
}

/* Moeller and Trumbore in double over all triangles. */
static bool closest(const lum_model *model, lmg_vec3 o, lmg_vec3 d, double *t, uint32_t *which)
{
    *t = INFINITY;
    for (uint32_t i = 0; i < model->triangle_count; i++) {
        double v[3][3];
        for (int k = 0; k < 3; k++) {
            for (int c = 0; c < 3; c++) {
                v[k][c] = (double)model->positions[3 * (size_t)model->indices[3 * (size_t)i + (size_t)k] + (size_t)c];
            }
        }
        lmg_vec3 e1 = {v[1][0] - v[0][0], v[1][1] - v[0][1], v[1][2] - v[0][2]};
        lmg_vec3 e2 = {v[2][0] - v[0][0], v[2][1] - v[0][1], v[2][2] - v[0][2]};
        lmg_vec3 s = {o.x - v[0][0], o.y - v[0][1], o.z - v[0][2]};
        lmg_vec3 p = {d.y * e2.z - d.z * e2.y, d.z * e2.x - d.x * e2.z, d.x * e2.y - d.y * e2.x};
        lmg_vec3 q = {s.y * e1.z - s.z * e1.y, s.z * e1.x - s.x * e1.z, s.x * e1.y - s.y * e1.x};
        double det = e1.x * p.x + e1.y * p.y + e1.z * p.z;
        double b1 = (s.x * p.x + s.y * p.y + s.z * p.z) / det, b2 = (d.x * q.x + d.y * q.y + d.z * q.z) / det;
        double at = (e2.x * q.x + e2.y * q.y + e2.z * q.z) / det;
        if (b1 >= 0 && b2 >= 0 && b1 + b2 <= 1 && at > 0 && at < *t) {
            *t = at;
            *which = i;
        }
    }
    return *t < (double)INFINITY;
}

static void agrees_with_all_triangles(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t m = make_lambert(model, 1);
    make_sphere(model, (lmg_vec3){0.1, 0, 0}, 0.3, 9, false, false, m);
    make_quad(model, (lmg_vec3){-0.8, -0.7, -0.5}, (lmg_vec3){1.5, 0.1, 0.2}, (lmg_vec3){0.2, 1.4, -0.1}, 4, m);
    finish_model(model);
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    lum_rng rng = lum_rng_stream(5, 0);
    int hits = 0, differ = 0;
    for (int i = 0; i < 100000; i++) {
        double z = 2 * lum_rng_next(&rng) - 1, phi = 6.283185307179586 * lum_rng_next(&rng), r = sqrt(1 - z * z), t = 0;
        lmg_vec3 o = {2 * lum_rng_next(&rng) - 1, 2 * lum_rng_next(&rng) - 1, 2 * lum_rng_next(&rng) - 1};
        lmg_vec3 d = {r * cos(phi), r * sin(phi), z};
        uint32_t which = 0;
        lum_hit hit;
        bool a = closest(model, o, d, &t, &which), b = lum_scene_intersect(scene, o, d, &hit);
        /* Rays within a rounding of an outline or edge may go either way: about 1e-7 of lengths, times the outlines in the picture.
         */
        if (a != b || (a && which != hit.triangle)) {
            differ++;
            continue;
        }
        if (a) {
            hits++;
            assert_true(fabs(hit.t - t) <= 4 * hit.error);
            double x = o.x + t * d.x - hit.position.x, y = o.y + t * d.y - hit.position.y, w = o.z + t * d.z - hit.position.z;
            /* Hits keep four errors away from edges. */
            assert_true(sqrt(x * x + y * y + w * w) <= 16 * hit.error);
            assert_true(fabs(hit.ng.x * hit.ng.x + hit.ng.y * hit.ng.y + hit.ng.z * hit.ng.z - 1) < 1e-12);
            assert_false(lum_scene_occluded(scene, o, d, t));
            assert_true(lum_scene_occluded(scene, o, d, t * 1.001 + 1e-4));
        }
    }
    print_message("%d hits, %d decided the other way\n", hits, differ);
    assert_true(hits > 15000); /* it tests something */
    assert_true(differ <= 3);
    lum_scene_destroy(scene);
    free_model(model);
}

/* With trapping enabled, as debugging builds have it, neither building nor tracing may stop the program. */
static void floating_point_traps_survive(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_box(model, (lmg_vec3){-1, -1, -1}, (lmg_vec3){1, 1, 1}, true, 1, make_material(model, LUM_SURFACE_PBR));
    finish_model(model);
    unsigned csr = __builtin_ia32_stmxcsr();
    __builtin_ia32_ldmxcsr((csr & ~0x3fu) & ~(0x0080u | 0x0200u)); /* unmask invalid and division by zero */
    lum_scene *scene;
    lum_hit hit;
    lmg_result result = lum_scene_create(model, &scene, NULL);
    unsigned saved = lum_thread_begin();
    bool found = !result && lum_scene_intersect(scene, (lmg_vec3){0, 0, 0}, (lmg_vec3){1, 0, 0}, &hit);
    lum_thread_end(saved);
    __builtin_ia32_ldmxcsr(csr);
    assert_int_equal(result, LMG_OK);
    assert_true(found);
    lum_scene_destroy(scene);
    free_model(model);
}

static void nothing_to_hit(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_lambert(model, 1);
    finish_model(model);
    lum_scene *scene;
    lum_hit hit;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    assert_false(lum_scene_intersect(scene, (lmg_vec3){0, 0, 0}, (lmg_vec3){1, 0, 0}, &hit));
    assert_false(lum_scene_occluded(scene, (lmg_vec3){0, 0, 0}, (lmg_vec3){1, 0, 0}, 1));
    lum_scene_destroy(scene);
    free_model(model);
}

/* A plate whose large faces are strips 2,500 times as long as wide: Embree's barycentrics are off by many roundings along them, so
 * that a ray between two triangles isn't where Embree says that it meets either. */
static void thin_triangles_hold(void **state)
{
    (void)state;
    enum { STRIPS = 100 };
    lum_model *model = make_model();
    uint32_t wall = make_lambert(model, 1);
    const double l = 0.15, t = 0.004, w = 0.00012;
    for (int i = 0; i < STRIPS; i++) {
        const double z = -0.1 + i * w;
        make_quad(model, (lmg_vec3){-l, 0, z}, (lmg_vec3){0, 0, w}, (lmg_vec3){2 * l, 0, 0}, 1, wall);
        make_quad(model, (lmg_vec3){-l, t, z}, (lmg_vec3){2 * l, 0, 0}, (lmg_vec3){0, 0, w}, 1, wall);
        make_quad(model, (lmg_vec3){-l, 0, z}, (lmg_vec3){0, t, 0}, (lmg_vec3){0, 0, w}, 1, wall);
        make_quad(model, (lmg_vec3){l, 0, z}, (lmg_vec3){0, 0, w}, (lmg_vec3){0, t, 0}, 1, wall);
    }
    make_quad(model, (lmg_vec3){-l, 0, -0.1}, (lmg_vec3){2 * l, 0, 0}, (lmg_vec3){0, t, 0}, 1, wall);
    make_quad(model, (lmg_vec3){-l, 0, -0.1 + STRIPS * w}, (lmg_vec3){0, t, 0}, (lmg_vec3){2 * l, 0, 0}, 1, wall);
    finish_model(model);
    report("plate of strips", bounce(model, (lmg_vec3){0.01, 0.002, -0.094}, BOUNCES, 15, UINT32_MAX, true));
    free_model(model);
}

/* Light inside a plate that cuts off the tip of a groove leaves it and enters it again within less than floats tell apart: the side
 * that it meets first comes first.  Which of a side's two triangles it is doesn't matter. */
static void grooves_hold(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t wall = make_lambert(model, 1);
    const double l = 0.15, h = 0.000114, tip_y = 0.001386, tip_z = 0.1177686;
    make_quad(model, (lmg_vec3){-l, tip_y, tip_z}, (lmg_vec3){0, h, -h}, (lmg_vec3){2 * l, 0, 0}, 1, wall);
    make_quad(model, (lmg_vec3){-l, tip_y, tip_z}, (lmg_vec3){2 * l, 0, 0}, (lmg_vec3){0, h, h}, 1, wall);
    finish_model(model);
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    unsigned saved = lum_thread_begin();
    lum_rng rng = lum_rng_stream(16, 0);
    int both = 0, farther = 0;
    const float *tip = model->positions; /* as the model has it, in floats */
    for (int i = 0; i < 300000; i++) {
        const double x = 0.2 * lum_rng_next(&rng) - 0.1, up = 3e-8 * lum_rng_next(&rng), way = 0.002 + 0.03 * lum_rng_next(&rng);
        lmg_vec3 d = {-0.17, 0.12 + 0.02 * lum_rng_next(&rng), i & 1 ? -0.978 : 0.978};
        const double n = 1 / sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
        d = (lmg_vec3){d.x * n, d.y * n, d.z * n};
        const lmg_vec3 o = {x - way * d.x, (double)tip[1] + up - way * d.y, (double)tip[2] - way * d.z};
        double t;
        uint32_t which;
        lum_hit one, many;
        /* Embree, which rounds the ray's origin, may find that it passes below the tip. */
        if (!closest(model, o, d, &t, &which) || !lum_scene_intersect(scene, o, d, &one))
            continue;
        lum_scene_intersect_many(scene, 1, &o, &d, &many);
        assert_int_equal(many.triangle, one.triangle);
        both++;
        farther += one.triangle / 2 != which / 2;
    }
    lum_thread_end(saved);
    print_message("%d rays over the tip, the farther side of %d\n", both, farther);
    assert_true(both > 200000);
    assert_int_equal(farther, 0);
    lum_scene_destroy(scene);
    free_model(model);
}

/* Ways that are told to be clear meet none of the triangles, however they lie: a shell in facets, a tilted box across its wall, slivers;
 * ways from anywhere and from off a surface.  Most of those in the wall that meet nothing are told so, or there would be no use. */
static void clear_ways_meet_nothing(void **state)
{
    (void)state;
    lum_model *model = make_model();
    const uint32_t wall = make_lambert(model, 1);
    make_sphere(model, (lmg_vec3){0.01, 0, 0}, 0.060, 28, false, false, wall);
    make_sphere(model, (lmg_vec3){0.01, 0, 0}, 0.057, 23, true, false, wall);
    make_quad(model, (lmg_vec3){0.05, -0.02, 0.01}, (lmg_vec3){0.03, 0.011, 0.007}, (lmg_vec3){-0.004, 0.03, 0.02}, 3, wall);
    for (int i = 0; i < 40; i++)
        make_triangle(model, (lmg_vec3){-0.049, 0.001 * i, 0}, (lmg_vec3){-0.0495, 0.001 * i + 0.0007, 0.02},
                      (lmg_vec3){-0.0488, 0.001 * i + 0.0001, 0.01}, wall);
    finish_model(model);
    lum_scene *scene;
    lum_clearance *clearance;
    const double thickness = 0.003, r = 0.0601;
    const lmg_vec3 low = {0.01 - r, -r, -r}, high = {0.01 + r, r, r};
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    assert_int_equal(lum_clearance_create(scene, low, high, thickness, 3 * thickness, &clearance, NULL), LMG_OK);
    assert_null(clearance); /* a thin medium */
    const double free_paths[2] = {0.0025, 0.00025}, least_told[2] = {0.6, 0.8};
    const double least_off[2] = {0.6, 0.05}; /* facets are known by what one cell knows, so in dense media small ones only */
    for (int depth = 0; depth < 2; depth++) {
        const double free_path = free_paths[depth];
        assert_int_equal(lum_clearance_create(scene, low, high, thickness, free_path, &clearance, NULL), LMG_OK);
        assert_non_null(clearance);
        const unsigned saved = lum_thread_begin();
        lum_rng rng = lum_rng_stream(23, 0);
        int in_wall = 0, told_in_wall = 0, off_wall = 0, told_off_wall = 0;
        lmg_vec3 origins[LUM_MAX_RAYS], directions[LUM_MAX_RAYS];
        double reaches[LUM_MAX_RAYS];
        bool each[LUM_MAX_RAYS], many[LUM_MAX_RAYS], met[LUM_MAX_RAYS];
        uint32_t list[LUM_MAX_RAYS], left[LUM_MAX_RAYS], waiting = 0;
        for (int i = 0; i < 40000; i++) {
            const double z = 2 * lum_rng_next(&rng) - 1, phi = 6.283185307179586 * lum_rng_next(&rng), q = sqrt(1 - z * z);
            const lmg_vec3 away = {q * cos(phi), q * sin(phi), z};
            const double at = 0.057 + 0.003 * lum_rng_next(&rng), w = 2 * lum_rng_next(&rng) - 1,
                         turn = 6.283185307179586 * lum_rng_next(&rng);
            const double s = sqrt(1 - w * w), reach = -free_path * log(1 - lum_rng_next(&rng)) * (i % 3 == 2 ? 10 : 1);
            lmg_vec3 d = {s * cos(turn), s * sin(turn), w};
            lmg_vec3 o = {0.01 + at * away.x, at * away.y, at * away.z};
            const uint32_t k = LUM_MAX_RAYS - 1 - waiting; /* the arrays from their ends */
            left[k] = LUM_MISS;
            if (i % 3 == 1) { /* off what the ray meets, onwards or back */
                lum_hit hit;
                if (!lum_scene_intersect(scene, o, d, &hit))
                    continue;
                o = lum_offset(&hit, (lmg_vec3){-d.x, -d.y, -d.z});
                left[k] = hit.triangle;
                if (i % 2)
                    d = (lmg_vec3){-d.x, -d.y, -d.z};
            }
            double t = INFINITY;
            uint32_t which;
            list[waiting] = k;
            origins[k] = o;
            directions[k] = d;
            reaches[k] = reach;
            met[waiting] = closest(model, o, d, &t, &which) && t <= reach;
            each[waiting] = lum_clearance_clear(clearance, o, d, reach);
            in_wall += i % 3 == 0 && !met[waiting];
            told_in_wall += i % 3 == 0 && each[waiting];
            if (++waiting < LUM_MAX_RAYS)
                continue;
            lum_clearance_many(clearance, waiting, list, origins, directions, reaches, NULL, many);
            assert_memory_equal(many, each, sizeof(many));
            lum_clearance_many(clearance, waiting, list, origins, directions, reaches, left, many);
            for (uint32_t n = 0; n < waiting; n++) {
                const bool leaves = left[list[n]] != LUM_MISS;
                assert_false((each[n] || many[n]) && met[n]);
                assert_true(leaves ? many[n] || !each[n] : many[n] == each[n]);
                off_wall += leaves && !met[n];
                told_off_wall += leaves && many[n];
            }
            waiting = 0;
        }
        assert_false(
            lum_clearance_clear(clearance, (lmg_vec3){0.2, 0, 0}, (lmg_vec3){1, 0, 0}, 0.001)); /* not asked for: not known */
        assert_false(lum_clearance_clear(clearance, (lmg_vec3){0.0685, 0, 0}, (lmg_vec3){1, 0, 0}, INFINITY));
        lum_thread_end(saved);
        print_message("free path %g: told to be clear in the wall %d of %d, off its faces %d of %d\n", free_path, told_in_wall,
                      in_wall, told_off_wall, off_wall);
        assert_true(told_in_wall > least_told[depth] * in_wall && told_off_wall > least_off[depth] * off_wall);
        lum_clearance_destroy(clearance);
    }
    lum_scene_destroy(scene);
    free_model(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(agrees_with_all_triangles),
        cmocka_unit_test(floating_point_traps_survive),
        cmocka_unit_test(nothing_to_hit),
        cmocka_unit_test(closed_boxes_keep_light),
        cmocka_unit_test(closed_spheres_keep_light),
        cmocka_unit_test(thin_shells_hold),
        cmocka_unit_test(acute_edges_hold),
        cmocka_unit_test(thin_triangles_hold),
        cmocka_unit_test(grooves_hold),
        cmocka_unit_test(clear_ways_meet_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
