/* SPDX-License-Identifier: Apache-2.0 */
/* Where rays belong and what cells measure: coordinates and their inverse, one place for every ray, etendue against closed forms. */
#include "lamp_fixture.h"

#include "etendue.h"
#include "field.h"
#include "geometry.h"
#include "place.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

static const lmg_vec3 LO = {-0.13, -0.07, -0.21}, HI = {0.11, 0.09, 0.17};

/* Cube slab of a class (2 * axis + negative), its rectangle wide enough for every line through the bounds. */
static lmg_slab cube_slab(int class, double distance, const uint32_t n[4])
{
    static const lmg_vec3 unit[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, minus[3] = {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
    int axis = class / 2;
    lmg_slab s = {.kind = LMG_SLAB_CUBE, .distance = distance, .o = {0.012, -0.007, 0.021}};
    s.n = class % 2 ? minus[axis] : unit[axis];
    s.a = unit[(axis + 1) % 3];
    s.b = class % 2 ? minus[(axis + 2) % 3] : unit[(axis + 2) % 3];
    s.u0 = s.v0 = -0.731;
    s.u1 = s.v1 = 0.813;
    s.s0 = s.t0 = isinf(distance) ? -1 : s.u0 - distance;
    s.s1 = s.t1 = isinf(distance) ? 1 : s.u1 + distance;
    s.nu = n[0];
    s.nv = n[1];
    s.ns = n[2];
    s.nt = n[3];
    return s;
}

static lmg_slab aperture_slab(const uint32_t n[4])
{
    /* an oblique frame, a x b = n */
    double c = cos(0.4), s = sin(0.4);
    return (lmg_slab){.kind = LMG_SLAB_APERTURE, .o = {0.01, -0.02, 0.03}, .a = {c, s, 0}, .b = {0, 0, 1}, .n = {s, -c, 0}, .distance = INFINITY,
                      .u0 = -0.031, .u1 = 0.057, .v0 = -0.083, .v1 = 0.021, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1,
                      .nu = n[0], .nv = n[1], .ns = n[2], .nt = n[3]};
}

static lmg_layout cube_layout(const uint32_t n[4])
{
    lmg_layout l = {.slab_count = 6, .channels = 3, .bounds_min = LO, .bounds_max = HI, .size = 0.5};
    for (int c = 0; c < 6; c++)
        l.slabs[c] = cube_slab(c, INFINITY, n);
    return l;
}

static double sum_etendue(const lmg_slab *s)
{
    double sum = 0;
    for (uint32_t iv = 0; iv < s->nv; iv++)
        for (uint32_t iu = 0; iu < s->nu; iu++)
            for (uint32_t it = 0; it < s->nt; it++)
                for (uint32_t is = 0; is < s->ns; is++)
                    sum += lmg_slab_cell_etendue(s, iu, iv, is, it);
    return sum;
}

static const uint32_t RESOLUTIONS[][4] = {{1, 1, 1, 1}, {1, 3, 7, 1}, {5, 1, 1, 11}, {3, 2, 13, 17}, {2, 2, 64, 61}};
enum { RESOLUTION_COUNT = sizeof RESOLUTIONS / sizeof *RESOLUTIONS };

/* From one point of a cube slab, all directions of its class: 4 H(1,1) = 2 sqrt(2) atan(1/sqrt(2)) = 1.7408; six are not 6 pi but those
 * of a hemisphere per plane; through an aperture pi. */
static void etendue_adds_up(void **state)
{
    (void)state;
    const double class_total = 2 * sqrt(2) * atan(1 / sqrt(2));
    for (int r = 0; r < RESOLUTION_COUNT; r++) {
        lmg_slab s = cube_slab(r % 6, INFINITY, RESOLUTIONS[r]);
        double area = (s.u1 - s.u0) * (s.v1 - s.v0);
        /* rounding of at most 5e5 terms */
        assert_near(sum_etendue(&s) / (area * class_total), 1, 1e-12);
        s = aperture_slab(RESOLUTIONS[r]);
        area = (s.u1 - s.u0) * (s.v1 - s.v0);
        assert_near(sum_etendue(&s) / (area * PI), 1, 1e-12);
        /* A second plane at a finite distance, wide enough for all slopes: the same total.  Gauss' rule of 4 points on panels of D/8:
         * relative error below 1e-9. */
        for (double d = 0.037; d < 20; d *= 7.3) {
            s = cube_slab(r % 6, d, RESOLUTIONS[r]);
            area = (s.u1 - s.u0) * (s.v1 - s.v0);
            assert_near(sum_etendue(&s) / (area * class_total), 1, 1e-9);
        }
    }
}

/* The closed form of one cell against plain midpoint quadrature. */
static void etendue_of_a_cell(void **state)
{
    (void)state;
    lmg_slab s = cube_slab(3, INFINITY, (const uint32_t[4]){2, 3, 5, 4});
    for (uint32_t is = 0; is < 5; is++)
        for (uint32_t it = 0; it < 4; it++) {
            enum { N = 400 };
            double sum = 0;
            for (int i = 0; i < N; i++)
                for (int j = 0; j < N; j++) {
                    double p = -1 + 0.4 * (is + (i + 0.5) / N), q = -1 + 0.5 * (it + (j + 0.5) / N), k = 1 + p * p + q * q;
                    sum += 1 / (k * k);
                }
            double expected = sum * 0.4 * 0.5 / (N * N) * (s.u1 - s.u0) / 2 * (s.v1 - s.v0) / 3;
            assert_near(lmg_slab_cell_etendue(&s, 1, 2, is, it) / expected, 1, 1e-6); /* midpoint: h^2/24 x 4 */
        }
}

/* A finite distance against a Monte-Carlo estimate of the four-fold integral, clipping included. */
static void etendue_at_a_distance(void **state)
{
    (void)state;
    const double d = 0.23;
    lmg_slab s = cube_slab(0, d, (const uint32_t[4]){2, 3, 5, 4});
    lamp_rng g = lamp_stream(5, 7);
    for (uint32_t cell = 0; cell < 2 * 3 * 5 * 4; cell += 7) {
        uint32_t iu = cell % 2, iv = cell / 2 % 3, is = cell / 6 % 5, it = cell / 30;
        enum { N = 200000 };
        double sum = 0, squares = 0, du = (s.u1 - s.u0) / 2, dv = (s.v1 - s.v0) / 3, ds = (s.s1 - s.s0) / 5, dt = (s.t1 - s.t0) / 4;
        for (int i = 0; i < N; i++) {
            double u = s.u0 + du * (iu + lamp_next(&g)), v = s.v0 + dv * (iv + lamp_next(&g));
            double p = (s.s0 + ds * (is + lamp_next(&g)) - u) / d, q = (s.t0 + dt * (it + lamp_next(&g)) - v) / d;
            double k = 1 + p * p + q * q, f = fabs(p) <= 1 && fabs(q) <= 1 ? 1 / (k * k) : 0;
            sum += f;
            squares += f * f;
        }
        double volume = du * dv * ds * dt / (d * d), mean = sum / N, se = sqrt((squares / N - mean * mean) / N);
        double got = lmg_slab_cell_etendue(&s, iu, iv, is, it) / volume;
        assert_true(fabs(got - mean) <= 4.5 * se + 1e-12); /* 18 cells: one in 10^4 fails by chance */
    }
}

static void coordinates_invert(void **state)
{
    (void)state;
    lamp_rng g = lamp_stream(11, 1);
    for (int k = 0; k < 20000; k++) {
        lmg_slab s = k % 3 == 0 ? aperture_slab(RESOLUTIONS[3]) : cube_slab(k / 3 % 6, k % 3 == 1 ? (double)INFINITY : 0.31, RESOLUTIONS[3]);
        double in[4] = {s.u0 + (s.u1 - s.u0) * lamp_next(&g), s.v0 + (s.v1 - s.v0) * lamp_next(&g), 0, 0}, out[4];
        double scale = 1;
        for (int i = 2; i < 4; i++) {
            double x = 2 * lamp_next(&g) - 1;
            in[i] = s.kind == LMG_SLAB_CUBE && isfinite(s.distance) ? in[i - 2] + s.distance * x : x;
        }
        lmg_vec3 o, d;
        lmg_slab_ray(&s, in, &o, &d);
        assert_near(d.x * d.x + d.y * d.y + d.z * d.z, 1, 1e-14);
        if (k % 2) { /* any point of the line, any length of the direction */
            double t = 3 * lamp_next(&g) - 1, f = 0.1 + lamp_next(&g);
            o = (lmg_vec3){o.x + t * d.x, o.y + t * d.y, o.z + t * d.z};
            d = (lmg_vec3){f * d.x, f * d.y, f * d.z};
            /* a crossing at cosine c is known to 1/c rounding errors */
            scale = 1 / (d.x * s.n.x + d.y * s.n.y + d.z * s.n.z) * f;
        }
        /* the rim of the disc, where the inverse of sqrt((1-r)(1+r)) turns 1e-16 into 1e-8, is only reached by grazing rays */
        bool inside = lmg_slab_coordinates(&s, o, d, out);
        for (int i = 0; i < 4; i++)
            assert_near(out[i], in[i], 1e-13 * scale + 1e-13);
        assert_true(inside || scale > 1e6);
    }
}

/* Radii of the concentric map keep area: the disc of half the square's side holds a quarter. */
static void concentric_map_keeps_area(void **state)
{
    (void)state;
    lmg_slab s = aperture_slab(RESOLUTIONS[0]);
    enum { N = 400 };
    int inside[3] = {0};
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            lmg_vec3 o, d;
            const double in[4] = {0, 0, -1 + 2 * (i + 0.5) / N, -1 + 2 * (j + 0.5) / N};
            lmg_slab_ray(&s, in, &o, &d);
            double x = d.x * s.a.x + d.y * s.a.y + d.z * s.a.z, y = d.x * s.b.x + d.y * s.b.y + d.z * s.b.z;
            inside[0] += x * x + y * y < 0.25;
            inside[1] += x > 0 && y > 0;          /* a quarter */
            inside[2] += y > x && y > 0 && x > 0; /* an eighth */
        }
    /* grid lines of the square are the borders of all three regions, or nearly: at most 4 N points are on the wrong side */
    assert_true(abs(4 * inside[0] - N * N) <= 16 * N / 10);
    assert_true(abs(4 * inside[1] - N * N) == 0);
    assert_true(abs(8 * inside[2] - N * N) <= 8 * N / 2);
}

/* Every direction, exact ties and axes among them, is in exactly one of six cube slabs, and lmg_layout_owner finds it. */
static void every_ray_has_one_place(void **state)
{
    (void)state;
    lmg_layout l = cube_layout(RESOLUTIONS[3]);
    lmg_error err;
    assert_int_equal(lmg_layout_check(&l, &err), LMG_OK);
    lamp_rng g = lamp_stream(3, 3);
    for (int k = 0; k < 200000 + 27; k++) {
        lmg_vec3 d;
        if (k < 27) {
            d = (lmg_vec3){k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1};
            if (d.x == 0 && d.y == 0 && d.z == 0)
                continue;
        } else {
            do {
                d = (lmg_vec3){2 * lamp_next(&g) - 1, 2 * lamp_next(&g) - 1, 2 * lamp_next(&g) - 1};
            } while (d.x * d.x + d.y * d.y + d.z * d.z > 1);
            if (k % 5 == 0)
                d.y = k % 2 ? d.x : -d.x;
            if (k % 7 == 0)
                d.z = k % 2 ? d.y : -d.y;
        }
        double x[3], uvst[4];
        for (int i = 0; i < 3; i++)
            x[i] = (&LO.x)[i] + lamp_next(&g) * ((&HI.x)[i] - (&LO.x)[i]);
        lmg_vec3 o = {x[0], x[1], x[2]};
        int owners = 0, last = -1;
        for (int c = 0; c < 6; c++)
            if (lmg_slab_coordinates(&l.slabs[c], o, d, uvst)) {
                owners++;
                last = c;
            }
        assert_int_equal(owners, 1);
        assert_int_equal(lmg_layout_owner(&l, o, d, uvst), last);
        /* ties: the lowest axis */
        double ax = fabs(d.x), ay = fabs(d.y), az = fabs(d.z);
        int axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
        assert_int_equal(last / 2, axis);
    }
}

/* Borders are half-open, and the end of the slopes' domain is closed. */
static void borders(void **state)
{
    (void)state;
    lmg_slab s = cube_slab(0, INFINITY, RESOLUTIONS[0]);
    double uvst[4];
    assert_true(lmg_slab_coordinates(&s, (lmg_vec3){s.o.x, s.o.y + s.u0, s.o.z}, (lmg_vec3){1, 0, 0}, uvst));
    s.u1 = 0.5;
    s.o = (lmg_vec3){0, 0, 0};
    assert_false(lmg_slab_coordinates(&s, (lmg_vec3){0, 0.5, 0}, (lmg_vec3){1, 0, 0}, uvst));
    assert_true(lmg_slab_coordinates(&s, (lmg_vec3){0, 0, 0}, (lmg_vec3){1, 1, -1}, uvst)); /* slope exactly 1 */
    s.s1 = 0.25;
    assert_false(lmg_slab_coordinates(&s, (lmg_vec3){0, 0, 0}, (lmg_vec3){1, 0.25, 0}, uvst));
    assert_true(lmg_slab_coordinates(&s, (lmg_vec3){0, 0, 0}, (lmg_vec3){1, 0.2499999, 0}, uvst));
    assert_false(lmg_slab_coordinates(&s, (lmg_vec3){0, 0, 0}, (lmg_vec3){-1, 0, 0}, uvst));
    assert_false(lmg_slab_coordinates(&s, (lmg_vec3){0, 0, 0}, (lmg_vec3){0, 0, 0}, uvst));
    assert_false(lmg_slab_coordinates(&s, (lmg_vec3){0, 0, 0}, (lmg_vec3){(double)NAN, 0, 0}, uvst));
}

/*
 * All lines that leave a convex box have etendue pi x surface.  However the layout shares them out - cube alone, cube under an aperture,
 * windows, rectangles that stick out - the effective cells must add up to that: each line has exactly one cell, and cells hold
 * nothing else.
 */
static double sum_effective(const lmg_layout *l)
{
    double sum = 0;
    for (uint32_t j = 0; j < l->slab_count; j++) {
        const lmg_slab *s = &l->slabs[j];
        for (uint32_t iv = 0; iv < s->nv; iv++)
            for (uint32_t iu = 0; iu < s->nu; iu++)
                for (uint32_t it = 0; it < s->nt; it++)
                    for (uint32_t is = 0; is < s->ns; is++)
                        sum += lmg_layout_cell_etendue(l, j, iu, iv, is, it);
    }
    return sum;
}

static void effective_etendue_is_that_of_the_bounds(void **state)
{
    (void)state;
    double x = HI.x - LO.x, y = HI.y - LO.y, z = HI.z - LO.z, total = 2 * PI * (x * y + y * z + z * x);
    const uint32_t coarse[4] = {7, 6, 6, 5}, fine[4] = {4, 3, 10, 8};
    lmg_layout l = cube_layout(coarse);
    /* the midpoint rule over direction: see etendue.c; better where the cells are small */
    assert_near(sum_effective(&l) / total, 1, 1e-3);
    /* an aperture in front, axis-parallel, with a window of its own */
    memmove(&l.slabs[2], &l.slabs[0], 6 * sizeof *l.slabs);
    l.slab_count = 8;
    lmg_slab a = aperture_slab(fine);
    a.o = (lmg_vec3){0, -0.03, 0};
    a.a = (lmg_vec3){0, 0, 1};
    a.b = (lmg_vec3){1, 0, 0};
    a.n = (lmg_vec3){0, 1, 0};
    l.slabs[1] = a;
    l.slabs[0] = a;
    l.slabs[0].s0 = -0.2;
    l.slabs[0].s1 = 0.4;
    l.slabs[0].t0 = 0;
    l.slabs[0].t1 = 0.5;
    assert_int_equal(lmg_layout_check(&l, NULL), LMG_OK);
    assert_near(sum_effective(&l) / total, 1, 1e-3);
    /* the aperture's own parts: window and the rest together are pi times its area, exactly */
    double own = 0;
    for (uint32_t j = 0; j < 2; j++)
        for (uint32_t c = 0; c < 4 * 3 * 10 * 8; c++)
            own += lmg_layout_cell_etendue(&l, j, c % 4, c / 4 % 3, c / 12 % 10, c / 120);
    assert_near(own / (PI * (a.u1 - a.u0) * (a.v1 - a.v0)), 1, 1e-12);
    /* the aperture oblique, so that its shadow on the faces is a parallelogram */
    l.slabs[0] = l.slabs[1] = aperture_slab(fine);
    l.slabs[0].s0 = -0.4;
    l.slabs[0].s1 = 0;
    assert_near(sum_effective(&l) / total, 1, 2e-3);
    /* a second plane at a finite distance in one face, points instead of polygons */
    l = cube_layout((const uint32_t[4]){5, 5, 4, 4});
    l.slabs[3] = cube_slab(3, 0.4, (const uint32_t[4]){6, 5, 7, 7});
    assert_near(sum_effective(&l) / total, 1, 5e-3);
}

static bool every_cell(const void *self, uint64_t cell)
{
    (void)self, (void)cell;
    return true;
}

/* All cells at once, direction by direction, are what cells one by one are; of slabs whose directions fall on the axes, too. */
static void effective_etendue_of_all_cells(void **state)
{
    (void)state;
    const uint32_t odd[4] = {5, 6, 17, 9};
    for (int kind = 0; kind < 2; kind++) {
        lmg_layout l = cube_layout(odd);
        if (kind) {
            memmove(&l.slabs[1], &l.slabs[0], 6 * sizeof *l.slabs);
            l.slabs[0] = aperture_slab(odd);
            l.slab_count = 7;
        }
        for (uint32_t j = (uint32_t)kind; j < l.slab_count; j++) {
            const lmg_slab *s = &l.slabs[j];
            lmg_etendue e;
            assert_int_equal(lmg_etendue_prepare(&e, &l, j, NULL), LMG_OK);
            assert_int_equal(lmg_etendue_share(&e, every_cell, NULL, NULL), LMG_OK);
            assert_non_null(e.share);
            int cut = 0;
            for (uint32_t c = 0; c < s->nu * s->nv * s->ns * s->nt; c++) {
                uint32_t is = c % s->ns, it = c / s->ns % s->nt, iu = c / (s->ns * s->nt) % s->nu, iv = c / (s->ns * s->nt * s->nu);
                double full = lmg_slab_cell_etendue(s, iu, iv, is, it), one = lmg_layout_cell_etendue(&l, j, iu, iv, is, it);
                assert_near(lmg_etendue_effective(&e, iu, iv, is, it), one, 1e-6 * full); /* shares are floats */
                cut += one > 0.01 * full && one < 0.99 * full;
            }
            assert_true(cut > 100);
            lmg_etendue_release(&e);
        }
    }
}

/*
 * 31 oblique openings, none of which hides another, above one slab of a million cells: what a made-up file may hold.  The work is bounded
 * for the slab as a whole, and what comes of it is still right: against random rays of cells that are cut.
 */
static void many_slabs_above_one(void **state)
{
    (void)state;
    enum { RAYS = 4000, CELLS = 200 };
    const uint32_t shapes[2][4] = {{5, 6, 180, 190}, {90, 100, 11, 10}};
    for (int shape = 0; shape < 2; shape++) {
        lmg_layout l = cube_layout((const uint32_t[4]){1, 1, 1, 1});
        lamp_rng g = lamp_stream(91, (uint64_t)shape);
        for (int k = 0; k < LMG_MAX_SLABS - 1; k++) {
            lmg_slab *s = &l.slabs[k];
            *s = aperture_slab(RESOLUTIONS[3]);
            double turn = 0.4 * k; /* all tilted from +z, round about it */
            s->n = (lmg_vec3){0.3 * cos(turn), 0.3 * sin(turn), sqrt(1 - 0.09)};
            s->a = (lmg_vec3){-sin(turn), cos(turn), 0};
            s->b = v_cross(s->n, s->a);
            s->o = (lmg_vec3){0.3 * (lamp_next(&g) - 0.5), 0.3 * (lamp_next(&g) - 0.5), 0.05 * (lamp_next(&g) - 0.5)};
            s->u0 = s->v0 = -0.05;
            s->u1 = s->v1 = 0.05;
        }
        l.slab_count = LMG_MAX_SLABS;
        const uint32_t last = LMG_MAX_SLABS - 1;
        l.slabs[last] = cube_slab(4, INFINITY, shapes[shape]);
        assert_int_equal(lmg_layout_check(&l, NULL), LMG_OK);
        const lmg_slab *s = &l.slabs[last];
        lmg_etendue e;
        assert_int_equal(lmg_etendue_prepare(&e, &l, last, NULL), LMG_OK);
        assert_int_equal(e.higher_count, LMG_MAX_SLABS - 1);
        /* 2^27 crossings of strips with slabs, or 16 for each cell and slab */
        double cells = (double)lmg_slab_cells(s), work = cells * e.directions_s * e.directions_t * e.strips * LMG_MAX_SLABS;
        assert_true(work <= fmax(0x1p27, 16 * cells * LMG_MAX_SLABS) && e.strips >= 4);
        assert_int_equal(lmg_etendue_share(&e, every_cell, NULL, NULL), LMG_OK);
        double sum = 0, expected = 0, squares = 0;
        int cut = 0;
        for (int tries = 0; cut < CELLS && tries < 100000; tries++) {
            uint32_t i[4];
            for (int k = 0; k < 4; k++)
                i[k] = (uint32_t)(lamp_next(&g) * shapes[shape][k]);
            double full = lmg_slab_cell_etendue(s, i[0], i[1], i[2], i[3]), share = lmg_etendue_effective(&e, i[0], i[1], i[2], i[3]) / full;
            if (!(share > 0.05 && share < 0.95))
                continue;
            cut++;
            const double low[4] = {s->u0, s->v0, s->s0, s->t0}, high[4] = {s->u1, s->v1, s->s1, s->t1};
            int own = 0;
            for (int r = 0; r < RAYS; r++) {
                double uvst[4], at[4], k0, k1;
                for (int k = 0; k < 4; k++)
                    uvst[k] = low[k] + (i[k] + lamp_next(&g)) / shapes[shape][k] * (high[k] - low[k]);
                lmg_vec3 x, d;
                lmg_slab_ray(s, uvst, &x, &d);
                own += lmg_layout_owner(&l, x, d, at) == (int)last && lmg_box_interval(LO, HI, x, d, &k0, &k1);
            }
            sum += share;
            expected += (double)own / RAYS;
            double off = share - (double)own / RAYS;
            squares += off * off;
        }
        /* random rays' own error is at most 0.8 % of a cell; the largest cells, cut by many borders, are off by some per cent each */
        assert_int_equal(cut, CELLS);
        print_message("under 31 slabs: %d x %d directions, %d strips; shares off by %.3f RMS, %.4f in the mean\n", e.directions_s, e.directions_t, e.strips,
                      sqrt(squares / CELLS), (sum - expected) / CELLS);
        assert_true(sqrt(squares / CELLS) < 0.04);
        assert_near(sum / CELLS, expected / CELLS, 0.01);
        lmg_etendue_release(&e);
    }
}

/* The own arctangent of the concentric map, against the C library's: three roundings of the division, the polynomial and its product. */
static void octant_angle_is_the_arctangent(void **state)
{
    (void)state;
    lamp_rng g = lamp_stream(17, 4);
    assert_true(lmg_octant_angle(0, 0) == 0 && lmg_octant_angle(0, 1) == 0 && lmg_octant_angle(0.3, 0.3) == 1);
    assert_true(lmg_octant_angle(0x1p-1030, 0x1p-1030) <= 1);
    for (int k = 0; k < 200000; k++) {
        const double l = lamp_next(&g), m = l * (k % 2 ? lamp_next(&g) : ldexp(lamp_next(&g), -(k % 60))), angle = lmg_octant_angle(m, l);
        const double expected = 4 / PI * atan(m / l);
        assert_true(angle >= 0 && angle <= 1);
        assert_near(angle, expected, 4 * 0x1p-52 * expected);
    }
}

/* Columns give each ray the cell that it gets alone, to the bit: all kinds of slabs and their priorities, rays of all kinds, on borders too. */
static void many_rays_go_where_each_goes(void **state)
{
    (void)state;
    lmg_layout layouts[4];
    layouts[0] = cube_layout(RESOLUTIONS[3]);
    layouts[1] = cube_layout(RESOLUTIONS[3]); /* two planes */
    for (int c = 0; c < 6; c++)
        layouts[1].slabs[c] = cube_slab(c, 0.31, RESOLUTIONS[3]);
    layouts[2] = cube_layout(RESOLUTIONS[3]); /* windows before their own slabs, and a frame that comes twice */
    for (int c = 5; c >= 0; c--)
        layouts[2].slabs[c + 3] = layouts[2].slabs[c];
    for (int k = 0; k < 3; k++) {
        lmg_slab *s = &layouts[2].slabs[k];
        *s = cube_slab(k == 1 ? 3 : 0, INFINITY, RESOLUTIONS[4]);
        s->u0 = s->v0 = -0.1 - 0.02 * k;
        s->u1 = s->v1 = 0.07;
        s->s0 = s->t0 = -0.25;
        s->s1 = s->t1 = k == 2 ? 1 : 0.5;
    }
    layouts[2].slab_count = 9;
    layouts[3] = cube_layout(RESOLUTIONS[3]); /* an aperture before the cube */
    for (int c = 5; c >= 0; c--)
        layouts[3].slabs[c + 1] = layouts[3].slabs[c];
    layouts[3].slabs[0] = aperture_slab(RESOLUTIONS[4]);
    layouts[3].slab_count = 7;
    for (int k = 0; k < 4; k++) {
        const lmg_layout *l = &layouts[k];
        lmg_error err;
        assert_int_equal(lmg_layout_check(l, &err), LMG_OK);
        lmg_plan plan;
        lmg_plan_prepare(&plan, l);
        lamp_rng g = lamp_stream(8, (uint64_t)k);
        int placed = 0, aperture_or_window = 0;
        for (size_t batch = 0; batch < 1000; batch++) {
            const size_t count = batch % LMG_COLUMN + 1;
            static lmg_ray_columns rays;
            uint64_t cell[LMG_COLUMN];
            for (size_t i = 0; i < count; i++) {
                double o[3], d[3];
                for (int c = 0; c < 3; c++) {
                    o[c] = batch % 5 ? (&LO.x)[c] + lamp_next(&g) * ((&HI.x)[c] - (&LO.x)[c]) : lamp_next(&g) - 0.5;
                    d[c] = batch % 7 ? 2 * lamp_next(&g) - 1 : floor(3 * lamp_next(&g)) - 1; /* axes and diagonals, or nothing */
                }
                if (batch % 11 == 0) /* on the border of a slab's rectangle */
                    o[i % 3] = l->slabs[0].u0;
                for (int c = 0; c < 3; c++) {
                    rays.origin[c][i] = o[c];
                    rays.direction[c][i] = d[c];
                }
            }
            lmg_plan_place(&plan, count, &rays, cell);
            for (size_t i = 0; i < count; i++) {
                const lmg_vec3 o = {rays.origin[0][i], rays.origin[1][i], rays.origin[2][i]};
                const lmg_vec3 d = {rays.direction[0][i], rays.direction[1][i], rays.direction[2][i]};
                double uvst[4];
                const int j = lmg_plan_owner(&plan, o, d, uvst);
                assert_true(cell[i] == (j < 0 ? LMG_NO_CELL : plan.first[j] + lmg_plan_cell(&plan, j, uvst)));
                placed += j >= 0;
                aperture_or_window += j >= 0 && j + 6 < (int)l->slab_count;
            }
        }
        assert_true(placed > 30000 && (k < 2 || aperture_or_window > 1000)); /* of 60,000: all had something to do */
    }
}

static void bad_layouts_are_refused(void **state)
{
    (void)state;
    lmg_error err;
    lmg_layout good = cube_layout(RESOLUTIONS[3]), bad;
    assert_int_equal(lmg_layout_check(&good, &err), LMG_OK);
    assert_int_equal(lmg_layout_check(NULL, &err), LMG_ERROR_ARGUMENT);
#define REFUSED(change)                                                                                                                                        \
    do {                                                                                                                                                       \
        bad = good;                                                                                                                                            \
        change;                                                                                                                                                \
        err.message[0] = 0;                                                                                                                                    \
        assert_int_equal(lmg_layout_check(&bad, &err), LMG_ERROR_ARGUMENT);                                                                                    \
        assert_true(strlen(err.message) > 10);                                                                                                                 \
        lmg_accumulator *acc = (void *)&bad;                                                                                                                   \
        assert_int_equal(lmg_accumulator_create(&bad, &acc, NULL), LMG_ERROR_ARGUMENT);                                                                        \
        assert_null(acc);                                                                                                                                      \
    } while (0)
    REFUSED(bad.slab_count = 0);
    REFUSED(bad.slab_count = LMG_MAX_SLABS + 1);
    REFUSED(bad.channels = 2);
    REFUSED(bad.channels = 1); /* no colour */
    REFUSED(bad.bounds_min.y = bad.bounds_max.y);
    REFUSED(bad.bounds_max.x = (double)NAN);
    REFUSED(bad.size = 0);
    REFUSED(bad.slabs[2].nu = 0);
    REFUSED(bad.slabs[2].nt = 65536);
    REFUSED(bad.slabs[1].nu = bad.slabs[1].nv = bad.slabs[1].ns = 65535);
    REFUSED(bad.slabs[4].u1 = bad.slabs[4].u0);
    REFUSED(bad.slabs[4].v1 = (double)INFINITY);
    REFUSED(bad.slabs[4].s0 = -1.01);
    REFUSED(bad.slabs[4].distance = 0);
    REFUSED(bad.slabs[4].distance = (double)NAN);
    REFUSED(bad.slabs[4].a.x += 1e-3);
    REFUSED(bad.slabs[4].b = bad.slabs[4].a);
    REFUSED(bad.slabs[4].n.x = -bad.slabs[4].n.x; bad.slabs[4].n.y = -bad.slabs[4].n.y; bad.slabs[4].n.z = -bad.slabs[4].n.z);
    REFUSED(bad.slabs[0] = aperture_slab(RESOLUTIONS[3]); bad.slabs[0].kind = LMG_SLAB_CUBE); /* an oblique cube slab */
    REFUSED(bad.slabs[0].kind = (lmg_slab_kind)7);
}

static void hash_is_fnv(void **state)
{
    (void)state;
    /* published test vector of FNV-1a 64: "foobar" */
    assert_true(lmg_hash(0xcbf29ce484222325u, "foobar", 6) == 0x85944171f73967e8u);
    assert_true(lmg_hash(lmg_hash(0xcbf29ce484222325u, "foo", 3), "bar", 3) == 0x85944171f73967e8u);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(etendue_adds_up),
        cmocka_unit_test(etendue_of_a_cell),
        cmocka_unit_test(etendue_at_a_distance),
        cmocka_unit_test(coordinates_invert),
        cmocka_unit_test(concentric_map_keeps_area),
        cmocka_unit_test(every_ray_has_one_place),
        cmocka_unit_test(borders),
        cmocka_unit_test(effective_etendue_is_that_of_the_bounds),
        cmocka_unit_test(effective_etendue_of_all_cells),
        cmocka_unit_test(many_slabs_above_one),
        cmocka_unit_test(octant_angle_is_the_arctangent),
        cmocka_unit_test(many_rays_go_where_each_goes),
        cmocka_unit_test(bad_layouts_are_refused),
        cmocka_unit_test(hash_is_fnv),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
