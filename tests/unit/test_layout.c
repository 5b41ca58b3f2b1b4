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
    assert_near(lmg_judge_slabs(judge, &s, 1, true).radiance, 0.5, 1e-4);
    s.nu = s.nv = 2;
    assert_near(lmg_judge_slabs(judge, &s, 1, true).radiance, 0, 3 / sqrt(0.25 * (double)n * (double)n)); /* four cells, two lit */
    s.nu = s.nv = 16;
    s.ns = s.nt = 8;
    /* twice the square, since errors below 0 are cut off */
    lmg_judge_set_square(judge, 2 * (double)pl.count * (double)pl.count / (LMG_PI * 0.18));
    pl.photons = (double)n;
    const lmg_verdict noisy = lmg_judge_slabs(judge, &s, 1, true);
    pl.photons = 0;
    const lmg_verdict clean = lmg_judge_slabs(judge, &s, 1, true);
    assert_near(noisy.radiance - clean.radiance, 0.5 * 128 * 64 / (double)n,
                1e-6); /* lit cells over photons: the same rays; etendue in floats */
    /* The edge between lit and dark lies in the middle of a row of cells that is 0.2 m high: illuminance near by notices, and is
     * off by the more the higher the cells. */
    s.ns = s.nt = 200;
    double error[2];
    for (int i = 0; i < 2; i++) {
        s.nu = s.nv = i ? 3 : 7;
        error[i] = lmg_judge_slabs(judge, &s, 1, false).illuminance;
    }
    assert_true(error[1] > 1e-3 && error[0] < 0.25 * error[1]);
    lmg_judge_destroy(judge);
    lmg_pilot_destroy(&pl);
    free(rays);
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
        cmocka_unit_test(a_source_in_the_open_is_found),
        cmocka_unit_test(cells_go_with_photons),
    };
    return cmocka_run_group_tests_name("layout", tests, NULL, NULL);
}
