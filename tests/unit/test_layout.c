/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What the fit of a layout judges by, against closed forms, and what it decides by that.  Lamps by formula (lamp_fixture.h); seeds
 * are fixed.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "geometry.h"
#include "lamp_fixture.h"
#include "layout_columns.h"
#include "layout_search.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { RAYS = 60000 };

static lmg_pilot pilot_of(lamp kind, lmg_ray **rays)
{
    lmg_pilot pl = {0};
    lamp_bounds(kind, &pl.lo, &pl.hi);
    const lmg_vec3 pad = {1e-6, 1e-6, 1e-6};
    pl.lo = v_sub(pl.lo, pad);
    pl.hi = v_add(pl.hi, pad);
    *rays = lamp_rays(kind, 5, 0, RAYS);
    assert_int_equal(lmg_pilot_create(&pl, *rays, RAYS, NULL), LMG_OK);
    pl.size = 0.1;
    return pl;
}

static lmg_slab square_slab(lmg_slab_kind kind, uint32_t n)
{
    lmg_slab s = {.kind = kind,
                  .distance = INFINITY,
                  .o = {0.1, 0.2, -0.3},
                  .u0 = -0.3,
                  .u1 = 0.3,
                  .v0 = -0.3,
                  .v1 = 0.3,
                  .s0 = -1,
                  .s1 = 1,
                  .t0 = -1,
                  .t1 = 1,
                  .nu = n,
                  .nv = n,
                  .ns = n,
                  .nt = n};
    lmg_class_frame(0, &s.a, &s.b, &s.n);
    return s;
}

/* A Lambertian square of flux 1 has radiance 1/(pi A) in an etendue pi A, so that the integral of its square is 1/(pi A), however
 * fine the cells; pairs of n rays tell it, and with n (n-1)/2 pairs falling in p of them, to about 1/sqrt(p).  Three standard
 * errors, six cells. */
static void pairs_of_rays_tell_the_square_of_radiance(void **state)
{
    (void)state;
    lmg_ray *rays;
    lmg_pilot pl = pilot_of(LAMP_SQUARE, &rays);
    lmg_judge *judge = lmg_judge_create(&pl, 0, true);
    assert_non_null(judge);
    const double n = (double)pl.count, exact = 1 / (LMG_PI * 0.36);
    static const uint32_t SIDES[] = {1, 2, 5, 11, 24, 40};
    for (size_t i = 0; i < sizeof SIDES / sizeof *SIDES; i++) {
        const lmg_slab s = square_slab(LMG_SLAB_APERTURE, SIDES[i]);
        double pairs;
        const double kept = lmg_judge_kept(judge, &s, 1, &pairs) / (n * (n - 1));
        assert_true(pairs > 500);
        assert_near(kept / exact, 1, SIDES[i] == 1 ? 1e-6 : 3 / sqrt(pairs));
    }
    lmg_judge_destroy(judge);
    /* The same of a cube slab, whose cells have the etendue that their middle says: off by a square of their width over 24, 0.3 %
     * at most with 24 of them.  The light of its class fills its whole etendue. */
    judge = lmg_judge_create(&pl, 0, false);
    assert_non_null(judge);
    double mine = 0;
    for (size_t i = 0; i < pl.count; i++)
        mine += pl.class[i] == 0;
    const lmg_slab whole = square_slab(LMG_SLAB_CUBE, 1), fine = square_slab(LMG_SLAB_CUBE, 24);
    double pairs;
    const double kept = lmg_judge_kept(judge, &fine, 1, &pairs) / (mine * (mine - 1));
    assert_near(kept * lmg_slab_cell_etendue(&whole, 0, 0, 0, 0), 1, 3 / sqrt(pairs) + 0.003);
    lmg_judge_destroy(judge);
    lmg_pilot_destroy(&pl);
    free(rays);
}

/* Cells lose what a light varies within them.  Half of the square dark: one cell keeps half of the square of radiance, and two
 * cells all of it: errors 1/2 and 0.  A box of as many rays as the pilot in c cells has noise of c/n of it, and so an error more by
 * that. */
static void errors_of_radiance(void **state)
{
    (void)state;
    lmg_ray *rays = lamp_rays(LAMP_SQUARE, 5, 0, RAYS);
    size_t n = 0;
    for (size_t i = 0; i < RAYS; i++)
        if (rays[i].origin.y > 0.2)
            rays[n++] = rays[i];
    lmg_pilot pl = {0};
    lamp_bounds(LAMP_SQUARE, &pl.lo, &pl.hi);
    assert_int_equal(lmg_pilot_create(&pl, rays, n, NULL), LMG_OK);
    pl.size = 0.2; /* planes so near that they see an edge of the light */
    lmg_judge *judge = lmg_judge_create(&pl, 0, true);
    lmg_judge_set_square(judge, (double)pl.count * (double)pl.count / (LMG_PI * 0.18));
    lmg_slab s = square_slab(LMG_SLAB_APERTURE, 1);
    assert_near(lmg_judge_slabs(judge, &s, 1, true, INFINITY).radiance, 0.5, 1e-4);
    s.nu = s.nv = 2;
    assert_near(lmg_judge_slabs(judge, &s, 1, true, INFINITY).radiance, 0,
                3 / sqrt(0.25 * (double)n * (double)n)); /* four cells, two lit */
    s.nu = s.nv = 16;
    s.ns = s.nt = 8;
    /* twice the square, since errors below 0 are cut off */
    lmg_judge_set_square(judge, 2 * (double)pl.count * (double)pl.count / (LMG_PI * 0.18));
    pl.photons = (double)n;
    const lmg_verdict noisy = lmg_judge_slabs(judge, &s, 1, true, INFINITY);
    pl.photons = 0;
    const lmg_verdict clean = lmg_judge_slabs(judge, &s, 1, true, INFINITY);
    assert_near(noisy.radiance - clean.radiance, 0.5 * 128 * 64 / (double)n,
                1e-6); /* lit cells over photons: the same rays; etendue in floats */
    /* The edge between lit and dark lies in the middle of a row of cells that is 0.2 m high: illuminance near by notices, and is
     * off by the more the higher the cells. */
    s.ns = s.nt = 200;
    double error[2];
    for (int i = 0; i < 2; i++) {
        s.nu = s.nv = i ? 3 : 7;
        error[i] = lmg_judge_slabs(judge, &s, 1, false, INFINITY).illuminance;
    }
    assert_true(error[1] > 1e-3 && error[0] < 0.25 * error[1]);
    lmg_judge_destroy(judge);
    lmg_pilot_destroy(&pl);
    free(rays);
}

/* Candidates are judged by all rays if they are below a limit, however closely, and given up if they are far above it. */
static int by_y(const void *a, const void *b)
{
    const double x = ((const lmg_ray *)a)->direction.y, y = ((const lmg_ray *)b)->direction.y;
    return (x > y) - (x < y);
}

/* sorted: as a file may be, in which the first rays don't speak for all. */
static void check_given_up(bool sorted)
{
    lmg_ray *rays;
    lmg_pilot pl = pilot_of(LAMP_LOUVRE, &rays);
    if (sorted) {
        const lmg_vec3 lo = pl.lo, hi = pl.hi;
        lmg_pilot_destroy(&pl);
        pl = (lmg_pilot){.lo = lo, .hi = hi};
        qsort(rays, RAYS, sizeof *rays, by_y);
        assert_int_equal(lmg_pilot_create(&pl, rays, RAYS, NULL), LMG_OK);
    }
    pl.size = 0.85;                                    /* its diagonal */
    lmg_judge *judge = lmg_judge_create(&pl, 3, true); /* -y */
    assert_non_null(judge);
    lmg_slab s = {.kind = LMG_SLAB_APERTURE, .u0 = -0.3, .u1 = 0.3, .v0 = -0.3, .v1 = 0.3, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
    lmg_class_frame(3, &s.a, &s.b, &s.n);
    double pairs;
    s.nu = s.nv = s.ns = s.nt = 24;
    lmg_judge_set_square(judge, lmg_judge_kept(judge, &s, 1, &pairs));
    for (int by_radiance = 0; by_radiance < 2; by_radiance++)
        for (uint32_t n = 1; n < 20; n++) {
            s.nu = s.nv = n;
            s.ns = s.nt = 4;
            const lmg_verdict all = lmg_judge_slabs(judge, &s, 1, by_radiance, INFINITY);
            const lmg_verdict within = lmg_judge_slabs(judge, &s, 1, by_radiance, all.error + 1e-9);
            assert_memory_equal(&all, &within, sizeof all);
            /* Half of the rays have a standard error twice as large at most.  Two of them and three more, twice as much for receivers
             * that see the same, are 16 of all rays', two of which are taken off already. */
            assert_true(all.error > 14 * all.se);
            assert_true(isinf(lmg_judge_slabs(judge, &s, 1, by_radiance, 0).error));
        }
    lmg_judge_destroy(judge);
    lmg_pilot_destroy(&pl);
    free(rays);
}

static void hopeless_candidates_are_given_up(void **state)
{
    (void)state;
    check_given_up(false);
    check_given_up(true);
}

/* Rays moved within their cells in columns are where lmg_slab_ray has them: to 2e-9, as the series for angles promises, and
 * rounding. */
static void columns_move_rays_as_single_ones(void **state)
{
    (void)state;
    const lmg_vec3 axes[3] = {{0, 0.6, 0.8}, {1, 0, 0}, {0, 0.8, -0.6}};
    for (int kind = 0; kind < 3; kind++) {
        lmg_slab s = square_slab(kind ? LMG_SLAB_CUBE : LMG_SLAB_APERTURE, 5);
        s.nu = 7;
        s.nt = 65535;
        if (kind == 2) {
            s.distance = 0.4;
            s.s1 = 0.7;
        }
        const double scale[4] = {s.nu / (s.u1 - s.u0), s.nv / (s.v1 - s.v0), s.ns / (s.s1 - s.s0), s.nt / (s.t1 - s.t0)};
        lmg_members m = {.count = LMG_COLUMN};
        lmg_ray_columns got;
        uint64_t random = 3;
        for (size_t i = 0; i < m.count; i++) {
            m.within[i] = (double)((random = random * 6364136223846793005u + 1442695040888963407u) % lmg_slab_cells(&s));
            for (int c = 0; c < 4; c++)
                m.jitter[c][i] = (double)((random = random * 6364136223846793005u + 1442695040888963407u) >> 11) * 0x1p-53;
        }
        lmg_members_move(&s, scale, &m);
        lmg_members_rays(&s, axes, &m, &got);
        for (size_t i = 0; i < m.count; i++) {
            const uint64_t cell = (uint64_t)m.within[i];
            const uint32_t is = (uint32_t)(cell % s.ns), it = (uint32_t)(cell / s.ns % s.nt),
                           iu = (uint32_t)(cell / s.ns / s.nt % s.nu), iv = (uint32_t)(cell / s.ns / s.nt / s.nu);
            const double uvst[4] = {s.u0 + (iu + m.jitter[0][i]) / scale[0], s.v0 + (iv + m.jitter[1][i]) / scale[1],
                                    s.s0 + (is + m.jitter[2][i]) / scale[2], s.t0 + (it + m.jitter[3][i]) / scale[3]};
            lmg_vec3 o, d;
            lmg_slab_ray(&s, uvst, &o, &d);
            for (int k = 0; k < 3; k++) {
                assert_near(got.origin[k][i], v_dot(o, axes[k]), 1e-14);
                assert_near(got.direction[k][i], v_dot(d, axes[k]), 2e-9);
            }
            if (kind == 0) /* cells of equal etendue */
                assert_near(m.inverse[i] * lmg_slab_cell_etendue(&s, iu, iv, is, it), 1, 1e-12);
        }
    }
}

/* A source that is seen directly is found where it is, and nothing in a panel that shines evenly. */
static void a_source_in_the_open_is_found(void **state)
{
    (void)state;
    lmg_ray *rays;
    lmg_slab s;
    lmg_pilot pl = pilot_of(LAMP_SPOT, &rays);
    assert_true(lmg_focus_find(&pl, 3, 0.01, &s)); /* -y */
    assert_near(s.o.y, 0.01125, 0.001);            /* half a radius of the source */
    assert_true(s.u1 - s.u0 > 0.003 && s.u1 - s.u0 < 0.007 && s.v1 - s.v0 > 0.003 &&
                s.v1 - s.v0 < 0.007); /* 4 mm wide, seen aslant */
    assert_near(0.5 * (s.u0 + s.u1), 0, 0.001);
    assert_near(0.5 * (s.v0 + s.v1), 0, 0.001);
    lmg_pilot_destroy(&pl);
    free(rays);
    static const lamp EVEN[] = {LAMP_DISC, LAMP_SQUARE, LAMP_LOUVRE};
    for (size_t i = 0; i < sizeof EVEN / sizeof *EVEN; i++) {
        pl = pilot_of(EVEN[i], &rays);
        assert_false(lmg_focus_find(&pl, EVEN[i] == LAMP_SQUARE ? 0 : 3, EVEN[i] == LAMP_DISC ? 0.01 : 0.36, &s));
        lmg_pilot_destroy(&pl);
        free(rays);
    }
}

static double cells_of(const lmg_layout *l)
{
    double sum = 0;
    for (uint32_t j = 0; j < l->slab_count; j++)
        sum += (double)lmg_slab_cells(&l->slabs[j]);
    return sum;
}

/* Where fewer cells may be taken, few photons get few, and no number of photons more than were asked for; where not, as many as
 * were asked for. */
static void cells_go_with_photons(void **state)
{
    (void)state;
    static const lamp LAMPS[] = {LAMP_LOUVRE, LAMP_SPHERE};
    for (size_t i = 0; i < sizeof LAMPS / sizeof *LAMPS; i++) {
        lmg_layout l = lamp_layout(LAMPS[i], &(lmg_fit_options){.cells = 2000000, .photons = 1e5, .fewer_cells = true});
        const double few = cells_of(&l);
        l = lamp_layout(LAMPS[i], &(lmg_fit_options){.cells = 2000000, .photons = 1e10, .fewer_cells = true});
        const double many = cells_of(&l);
        l = lamp_layout(LAMPS[i], &(lmg_fit_options){.cells = 2000000, .photons = 1e5});
        const double all = cells_of(&l);
        assert_true(few < 0.2 * many);
        assert_true(many < 1.2 * 2000000);
        assert_true(all > 0.8 * 2000000 && all < 1.2 * 2000000);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pairs_of_rays_tell_the_square_of_radiance),
        cmocka_unit_test(errors_of_radiance),
        cmocka_unit_test(hopeless_candidates_are_given_up),
        cmocka_unit_test(columns_move_rays_as_single_ones),
        cmocka_unit_test(a_source_in_the_open_is_found),
        cmocka_unit_test(cells_go_with_photons),
    };
    return cmocka_run_group_tests_name("layout", tests, NULL, NULL);
}
