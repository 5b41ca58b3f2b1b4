/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Hard cases of direction: light so narrow that it is a ray, along axes and diagonals and exactly on the borders of slabs, through edges
 * and corners of the box: every photon in exactly one cell, all the flux, in the right direction within a cell.  And extreme layouts:
 * one cell, rows, primes, a thousand cells in one dimension, (s,t) planes from very near to infinity.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"
#include "make_model.h"

#include "field.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static lmg_vec3 unit(double x, double y, double z)
{
    const double n = 1 / sqrt(x * x + y * y + z * z);
    return v3(x * n, y * n, z * n);
}

static lmg_field *field_of(const lmg_layout *layout, const lmg_ray *rays, size_t count, lmg_deposit_totals *totals)
{
    lmg_accumulator *acc;
    lmg_field *field;
    lmg_error err = {{0}};
    if (lmg_accumulator_create(layout, &acc, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lmg_accumulator_deposit(acc, rays, count);
    *totals = lmg_accumulator_totals(acc);
    if (lmg_field_reconstruct(acc, 1.0 / (double)count, NULL, &field, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lmg_accumulator_destroy(acc);
    return field;
}

static size_t cells_with_light(const lmg_field *f)
{
    size_t n = 0;
    for (uint32_t j = 0; j < f->layout.slab_count; ++j)
        for (uint64_t c = 0; c < f->slabs[j].cells; ++c)
            n += *lmg_cell_radiance(&f->slabs[j], c) != 0;
    return n;
}

/* Largest sine between the beam and what the box emits, and the cell's own width in direction there. */
static double widest_emission(const lmg_field *f, lmg_vec3 beam, double *cell)
{
    double widest = 0;
    *cell = 0;
    for (int i = 0; i < 200; ++i) {
        lum_rng rng = lum_rng_stream(9, (uint64_t)i);
        double xi[5];
        for (int k = 0; k < 5; ++k)
            xi[k] = lum_rng_next(&rng);
        lmg_ray ray;
        assert_true(lmg_field_emit(f, xi, &ray));
        const lmg_vec3 d = ray.direction;
        const double x = d.y * beam.z - d.z * beam.y, y = d.z * beam.x - d.x * beam.z, z = d.x * beam.y - d.y * beam.x;
        widest = fmax(widest, sqrt(x * x + y * y + z * z));
        double uvst[4];
        const int j = lmg_layout_owner(&f->layout, ray.origin, d, uvst);
        assert_true(j >= 0);
        const lmg_slab *s = &f->layout.slabs[j];
        /* two directions of one cell, and of its neighbour for a beam on the border, are this far apart at most: slopes and cosines
         * change direction by at most their own change, the square's image of the disc by pi/2 of it */
        const double ws = (s->s1 - s->s0) / s->ns, wt = (s->t1 - s->t0) / s->nt;
        *cell = fmax(*cell, 0.5 * 3.1416 * hypot(ws, wt) / (s->kind == LMG_SLAB_CUBE && isfinite(s->distance) ? s->distance : 1) +
                                (s->kind == LMG_SLAB_CUBE && isfinite(s->distance)
                                     ? 0.5 * 3.1416 * hypot((s->u1 - s->u0) / s->nu, (s->v1 - s->v0) / s->nv) / s->distance
                                     : 0));
    }
    return widest;
}

/* --------------------------------------------------------------------------------------------------------- needle beams */

static const struct {
    const char *name;
    double d[3];
} DIRECTIONS[] = {
    {"along an axis", {0, -1, 0}},
    {"along a face's diagonal, a border of slabs", {1, -1, 0}},
    {"along the body's diagonal, three slabs' corner", {-1, -1, -1}},
    {"an ulp off the diagonal", {1, -0x1.fffffffffffffp-1, 0}},
    {"oblique", {0.3, -0.8, 0.5}},
    {"nearly along a plane", {1, -1e-9, 1e-12}},
};

static void test_needles(void **state)
{
    (void)state;
    enum { N = 20000 };
    lmg_ray *rays = calloc(N, sizeof(*rays));
    assert_non_null(rays);
    static const char *const KINDS[] = {"chosen", "cube", "aperture"};
    for (size_t c = 0; c < sizeof(DIRECTIONS) / sizeof(DIRECTIONS[0]); ++c)
        for (int narrow = 0; narrow < 2; ++narrow) {
            const lmg_vec3 d = unit(DIRECTIONS[c].d[0], DIRECTIONS[c].d[1], DIRECTIONS[c].d[2]);
            /* 0.001 degree wide, from a square of 1 mm; or all the same direction from one point, the corner of the box */
            const double half = narrow ? 0 : 0.001 / 57.29577951;
            for (uint64_t i = 0; i < N; ++i) {
                lum_rng rng = lum_rng_stream(4, i);
                const double x = 2 * lum_rng_next(&rng) - 1, y = 2 * lum_rng_next(&rng) - 1, z = 2 * lum_rng_next(&rng) - 1;
                const double p = lum_rng_next(&rng), q = lum_rng_next(&rng);
                rays[i] = (lmg_ray){.origin = narrow ? v3(0.05, -0.05, 0.05) : v3(0.001 * p, -0.05, 0.001 * q),
                                    .direction = unit(d.x + half * x, d.y + half * y, d.z + half * z),
                                    .flux = {1, 1, 1},
                                    .number = i};
            }
            for (int k = 0; k < 3; ++k) {
                lmg_fit_options o = {.struct_size = sizeof(o), .choice = (lmg_layout_choice)k, .cells = 200000};
                o.bounds_min = v3(-0.05, -0.05, -0.05);
                o.bounds_max = v3(0.05, 0.05, 0.05);
                lmg_layout layout;
                lmg_error err = {{0}};
                if (lmg_layout_fit(rays, N, &o, &layout, NULL, &err) != LMG_OK)
                    fail_msg("%s", err.message);
                lmg_deposit_totals t;
                lmg_field *f = field_of(&layout, rays, N, &t);
                const char *name = hard_text("%s %s, layout %s", narrow ? "one ray from a corner of the box" : "0.001 degree beam",
                                             DIRECTIONS[c].name, KINDS[k]);
                hard_holds(name, "every photon in one cell, flux exact", t.rays == N && t.stored == N && t.unplaced == 0 && t.refused == 0,
                           "%.0f of %d stored in %zu cells", t.stored, N, cells_with_light(f));
                const lmg_ledger l = lmg_field_ledger(f);
                hard_at_most(name, "stored and residual are all", fabs(l.stored + l.residual - 1), 1e-9);
                if (narrow) {
                    /* from that corner some directions touch the box in the corner alone: no cell can carry light of lines that pass the
                     * box by, so it is counted as residual */
                    const bool touches = d.x < 0 || d.z < 0;
                    hard_holds(name, "one ray, one cell; if it only touches the box's corner, one cell or residual",
                               (cells_with_light(f) == 1 && l.residual == 0) || (touches && cells_with_light(f) == 0 && l.stored == 0),
                               "%zu cells, residual %g", cells_with_light(f), l.residual);
                }
                if (l.stored == 0) {
                    lmg_field_destroy(f);
                    continue;
                }
                double cell;
                const double widest = widest_emission(f, d, &cell);
                hard_at_most(name, "emitted in the beam's direction within a cell (sine of the angle)", widest, cell + 1.5 * half);
                lmg_field_destroy(f);
            }
        }
    free(rays);
}

/* Punctual spot in a glTF-like model, baked: it sits exactly on the box, whose light is a line. */
static lmg_layout one_slab(lmg_slab_kind kind, double distance, uint32_t nu, uint32_t nv, uint32_t ns, uint32_t nt)
{
    lmg_layout y = {.slab_count = 1, .channels = 1, .colour = {1, 1, 1}, .size = 0.1};
    y.bounds_min = v3(-0.05, -0.02, -0.05);
    y.bounds_max = v3(0.05, 0, 0.05);
    const double reach = isfinite(distance) && kind == LMG_SLAB_CUBE ? 0.06 + distance : 1;
    y.slabs[0] = (lmg_slab){.kind = kind,
                            .o = v3(0, -0.02, 0),
                            .a = v3(1, 0, 0),
                            .b = v3(0, 0, 1),
                            .n = v3(0, -1, 0),
                            .distance = distance,
                            .u0 = -0.05,
                            .u1 = 0.05,
                            .v0 = -0.05,
                            .v1 = 0.05,
                            .s0 = -reach,
                            .s1 = reach,
                            .t0 = -reach,
                            .t1 = reach,
                            .nu = nu,
                            .nv = nv,
                            .ns = ns,
                            .nt = nt};
    return y;
}

/* Lambertian light of the plane, in the cube slab's directions only. */
static void test_resolutions(void **state)
{
    (void)state;
    enum { N = 100000 };
    lmg_ray *rays = calloc(N, sizeof(*rays));
    assert_non_null(rays);
    for (uint64_t i = 0; i < N;) {
        lum_rng rng = lum_rng_stream(17, i + 1000000 * (i == 0));
        for (;;) {
            const double u = lum_rng_next(&rng), phi = 6.283185307179586 * lum_rng_next(&rng), r = sqrt(u);
            const lmg_vec3 d = {r * cos(phi), -sqrt(1 - u), r * sin(phi)};
            if (fabs(d.x) > -d.y || fabs(d.z) > -d.y)
                continue;
            rays[i] = (lmg_ray){.origin = v3(0.1 * lum_rng_next(&rng) - 0.05, -0.02, 0.1 * lum_rng_next(&rng) - 0.05),
                                .direction = d,
                                .flux = {1, 1, 1},
                                .number = i};
            ++i;
            break;
        }
    }
    static const struct {
        const char *name;
        uint32_t n[4];
    } SHAPES[] = {
        {"1 cell", {1, 1, 1, 1}},
        {"1 x 1 x 1 x 1024", {1, 1, 1, 1024}},
        {"1024 x 1 x 1 x 1", {1024, 1, 1, 1}},
        {"1 x 997 x 1 x 3", {1, 997, 1, 3}},
        {"primes 7 x 11 x 13 x 17", {7, 11, 13, 17}},
        {"65535 x 1 x 2 x 1", {65535, 1, 2, 1}},
    };
    static const double DISTANCES[] = {(double)INFINITY, 1e-4, 0.1, 1e5};
    for (size_t k = 0; k < sizeof(SHAPES) / sizeof(SHAPES[0]); ++k)
        for (int d = 0; d < 5; ++d) {
            const uint32_t *n = SHAPES[k].n;
            const bool aperture = d == 4;
            const lmg_layout y = one_slab(aperture ? LMG_SLAB_APERTURE : LMG_SLAB_CUBE, aperture ? (double)INFINITY : DISTANCES[d], n[0], n[1],
                                          n[2], n[3]);
            lmg_deposit_totals t;
            lmg_field *f = field_of(&y, rays, N, &t);
            const char *name = aperture                 ? hard_text("%s, aperture", SHAPES[k].name)
                               : isfinite(DISTANCES[d]) ? hard_text("%s, (s,t) plane at %g sizes", SHAPES[k].name, DISTANCES[d] / y.size)
                                                        : hard_text("%s, (s,t) plane at infinity", SHAPES[k].name);
            hard_holds(name, "flux exact", t.stored + t.residual == N && t.refused == 0 && t.unplaced == 0, "%.0f of %d stored", t.stored, N);
            double error;
            hard_at_most(name, "the field holds it: relative difference", fabs(lmg_field_slab_flux(f, 0, &error) - 1), 1e-6);
            /* where a photon's coordinates are, is the photon */
            double worst = 0;
            for (size_t i = 0; i < N; i += 97) {
                double uvst[4], back[4];
                lmg_vec3 o, w;
                assert_true(lmg_slab_coordinates(&y.slabs[0], rays[i].origin, rays[i].direction, uvst));
                lmg_slab_ray(&y.slabs[0], uvst, &o, &w);
                const lmg_vec3 e = rays[i].direction;
                worst = fmax(worst, fmax(fabs(w.x - e.x), fmax(fabs(w.y - e.y), fabs(w.z - e.z))));
                assert_true(lmg_slab_coordinates(&y.slabs[0], o, w, back));
                float rgb[3], se;
                lmg_field_radiance(f, rays[i].origin, e, LMG_NEAREST, rgb, &se);
                /* the photon's own cell has light, where it comes out of the bounds */
                const bool seen = rgb[0] > 0;
                lmg_vec3 below = {rays[i].origin.x + 0.5 * e.x, rays[i].origin.y + 0.5 * e.y, rays[i].origin.z + 0.5 * e.z};
                lmg_field_radiance(f, below, e, LMG_NEAREST, rgb, &se);
                if (!(rgb[0] > 0) && !seen)
                    fail_msg("%s: photon %zu isn't in the field", name, i);
            }
            /* (s - u)/D of coordinates of magnitude |s| + |u|: rounding of both over D, times the unit vector's normalization */
            const double magnitude = aperture || !isfinite(DISTANCES[d]) ? 1 : (0.12 + DISTANCES[d]) / DISTANCES[d];
            hard_at_most(name, "look-up inverts (direction)", worst, 64 * 0x1p-53 * magnitude);
            lmg_field_destroy(f);
        }
    free(rays);
}

/*
 * A luminous sphere has the same luminance on both sides of a border between faces of the cube; so must its box, within the error of the two
 * cells that meet there.
 */
static void test_seams(void **state)
{
    (void)state;
    lum_model *m = make_model();
    const uint32_t source = make_lambert(m, 0);
    hard_emit(m, source, 1000);
    make_sphere(m, v3(0, 0, 0), 0.1, 40, false, false, source);
    finish_model(m);
    const bake_options o = {.photons = 3000000, .seed = 8, .fit.cells = 60000, .fit.choice = LMG_LAYOUT_CUBE};
    lmg_field *f = hard_bake(m, &o, NULL);
    free_model(m);
    double squares = 0, sum = 0, level = 0;
    enum { PAIRS = 20000 };
    for (uint64_t i = 0; i < PAIRS; ++i) {
        lum_rng rng = lum_rng_stream(91, i);
        /* a line through the inner half of the ball, so far from the rim that cells there see only it */
        const double sign[3] = {lum_rng_next(&rng) < 0.5 ? -1 : 1, lum_rng_next(&rng) < 0.5 ? -1 : 1, 0};
        const double rest = 1.8 * lum_rng_next(&rng) - 0.9;
        const int axis = (int)(3 * lum_rng_next(&rng));
        const double p[3] = {0.05 * (2 * lum_rng_next(&rng) - 1), 0.05 * (2 * lum_rng_next(&rng) - 1), 0.05 * (2 * lum_rng_next(&rng) - 1)};
        double l[2], se[2];
        for (int side = 0; side < 2; ++side) {
            double d[3], length = 0;
            d[axis] = rest;
            d[(axis + 1) % 3] = sign[0] * (side ? 1 + 1e-9 : 1);
            d[(axis + 2) % 3] = sign[1] * (side ? 1 : 1 + 1e-9);
            for (int k = 0; k < 3; ++k)
                length += d[k] * d[k];
            length = sqrt(length);
            float rgb[3], e;
            lmg_field_radiance(f, v3(p[0] + 5 * d[0], p[1] + 5 * d[1], p[2] + 5 * d[2]), v3(d[0] / length, d[1] / length, d[2] / length), LMG_NEAREST, rgb,
                               &e);
            l[side] = lmg_luminance(rgb);
            se[side] = (double)e;
        }
        const double z = (l[0] - l[1]) / hypot(se[0], se[1]);
        squares += z * z;
        sum += l[0] - l[1];
        level += 0.5 * (l[0] + l[1]);
    }
    /* Two cells' luminances differ by their noise, 1; their slopes add what a neighbour's noise makes of it (a quarter of the difference of two
     * of them along the axis that ends here, a third of that along the three others: 1/8 + 3/24), and radiances' spread is up to 1.09 of the error that they
     * say (docs/accuracy.md): 1.25 x 1.09^2 = 1.49.  Of some 1,000 independent pairs: +- 0.07. */
    hard_at_most("sphere, across the twelve borders between faces", "mean square of the step in luminance over the two cells' variances", squares / PAIRS, 1.49 + 3 * 0.07);
    hard_at_most("sphere, across the twelve borders between faces", "mean step over the luminance", fabs(sum / level), 0.01);
    hard_at_most("sphere, beside the borders", "mean luminance, relative", fabs(level / PAIRS / 1000 - 1), 0.01);
    lmg_field_destroy(f);
}

int main(void)
{
    hard_begin("beams");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_needles),
        cmocka_unit_test(test_resolutions),
        cmocka_unit_test(test_seams),
    };
    return cmocka_run_group_tests_name("hard_beams", tests, NULL, NULL);
}
