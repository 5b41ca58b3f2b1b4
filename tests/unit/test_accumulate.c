/* SPDX-License-Identifier: Apache-2.0 */
/* Counting and reconstruction, exactly: what goes in comes out, whatever the order, the threads, the weights and the layout. */
#include "lamp_fixture.h"

#include "accumulate.h"
#include "field.h"

#include <math.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static lmg_slab slab_of(uint32_t nu, uint32_t nv, uint32_t ns, uint32_t nt)
{
    return (lmg_slab){.kind = LMG_SLAB_CUBE, .distance = INFINITY, .a = {0, 0, 1}, .b = {1, 0, 0}, .n = {0, 1, 0}, .u0 = -2, .u1 = 2, .v0 = -2,
                      .v1 = 2, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1, .nu = nu, .nv = nv, .ns = ns, .nt = nt};
}

/* One slab upwards (+Y), bounds of +-1. */
static lmg_layout upwards(uint32_t nu, uint32_t nv, uint32_t ns, uint32_t nt, uint32_t channels)
{
    lmg_layout l = {.slab_count = 1, .channels = channels, .colour = {1, 1, 1}, .bounds_min = {-1, -1, -1}, .bounds_max = {1, 1, 1}, .size = 1};
    l.slabs[0] = slab_of(nu, nv, ns, nt);
    return l;
}

static lmg_accumulator *create(const lmg_layout *l)
{
    lmg_accumulator *acc;
    lmg_error err = {{0}};
    if (lmg_accumulator_create(l, &acc, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return acc;
}

static double stored_flux(const lmg_field *f)
{
    double sum = 0;
    for (uint32_t j = 0; j < lmg_field_layout(f)->slab_count; j++)
        sum += lmg_field_slab_flux(f, j, NULL);
    return sum;
}

/* Every ray's flux differs, colours too, some components negative. */
static lmg_ray *coloured(lamp kind, size_t count)
{
    lmg_ray *rays = lamp_rays(kind, 5, 0, count);
    for (size_t i = 0; i < count; i++) {
        lamp_rng g = lamp_stream(99, i);
        for (int c = 0; c < 3; c++)
            rays[i].flux[c] = (float)(lamp_next(&g) * 3 - (c == 2 ? 0.5 : 0));
    }
    return rays;
}

typedef struct job {
    lmg_accumulator *acc;
    const lmg_ray *rays;
    size_t count, first, stride;
} job;

static void *deposit_part(void *arg)
{
    job *j = arg;
    for (size_t i = j->first; i < j->count; i += j->stride) {
        size_t n = 37; /* an odd batch, so that threads' batches interleave */
        size_t at = i * n;
        if (at >= j->count)
            break;
        lmg_accumulator_deposit(j->acc, j->rays + at, j->count - at < n ? j->count - at : n);
    }
    return NULL;
}

/* Words in which two accumulators differ. */
static size_t differences(const lmg_accumulator *a, const lmg_accumulator *b)
{
    size_t n = 0;
    for (size_t i = 0; i < a->bytes / sizeof(uint64_t); i++)
        n += a->words[i] != b->words[i];
    return n;
}

static void threads_give_the_same_bits(void **state)
{
    (void)state;
    enum { N = 60000, THREADS = 8 };
    for (uint32_t channels = 1; channels <= 3; channels += 2) {
        lmg_fit_options wishes = {.cells = 20000, .channels = channels}; /* few cells: much contention */
        lmg_layout l = lamp_layout(LAMP_SPOT, &wishes);
        lmg_ray *rays = coloured(LAMP_SPOT, N);
        lmg_accumulator *one = create(&l), *many = create(&l), *parts[2] = {create(&l), create(&l)};
        lmg_accumulator_deposit(one, rays, N);
        pthread_t threads[THREADS];
        job jobs[THREADS];
        for (size_t t = 0; t < THREADS; t++) {
            jobs[t] = (job){many, rays, N, t, THREADS};
            assert_int_equal(pthread_create(&threads[t], NULL, deposit_part, &jobs[t]), 0);
        }
        for (int t = 0; t < THREADS; t++)
            pthread_join(threads[t], NULL);
        assert_int_equal(differences(one, many), 0);
        /* in two parts, in reverse, merged */
        for (size_t i = N; i-- > 0;)
            lmg_accumulator_deposit(parts[i % 3 == 0], &rays[i], 1);
        assert_int_equal(lmg_accumulator_merge(parts[0], parts[1], NULL), LMG_OK);
        assert_int_equal(differences(one, parts[0]), 0);
        lmg_deposit_totals a = lmg_accumulator_totals(one), b = lmg_accumulator_totals(many), c = lmg_accumulator_totals(parts[0]);
        assert_memory_equal(&a, &b, sizeof a);
        assert_memory_equal(&a, &c, sizeof a);
        assert_int_equal(a.rays + a.unplaced + a.refused, N);
        for (int k = 0; k < 2; k++)
            lmg_accumulator_destroy(parts[k]);
        lmg_accumulator_destroy(one);
        lmg_accumulator_destroy(many);
        free(rays);
    }
}

static void merging_needs_one_layout(void **state)
{
    (void)state;
    lmg_layout l = upwards(3, 4, 5, 6, 3), m = l;
    m.slabs[0].u1 += 1e-9;
    lmg_accumulator *a = create(&l), *b = create(&m);
    lmg_error err;
    assert_int_equal(lmg_accumulator_merge(a, b, &err), LMG_ERROR_ARGUMENT);
    lmg_accumulator_destroy(a);
    lmg_accumulator_destroy(b);
}

static void bad_rays_are_refused_and_counted(void **state)
{
    (void)state;
    lmg_layout l = upwards(4, 4, 4, 4, 3);
    lmg_accumulator *acc = create(&l);
    const lmg_ray good = {.origin = {0.1, 0, 0.2}, .direction = {0, 1, 0}, .flux = {1, 1, 1}};
    const float bad_flux[][3] = {{NAN, 1, 1}, {1, INFINITY, 1}, {1, 1, -INFINITY}, {-1, -1, -1}, {0.1F, -0.1F, 0}, {3e30F, -1e30F, 0}, {2e7F, 2e7F, 2e7F}};
    const double bad_directions[][3] = {{0, 0, 0}, {(double)NAN, 1, 0}, {0, (double)INFINITY, 0}, {1e-200, 0, 0}};
    uint64_t refused = 0;
    for (size_t i = 0; i < sizeof bad_flux / sizeof *bad_flux; i++, refused++) {
        lmg_ray r = good;
        memcpy(r.flux, bad_flux[i], sizeof r.flux);
        lmg_accumulator_deposit(acc, &r, 1);
    }
    for (size_t i = 0; i < sizeof bad_directions / sizeof *bad_directions; i++, refused++) {
        lmg_ray r = good;
        r.direction = (lmg_vec3){bad_directions[i][0], bad_directions[i][1], bad_directions[i][2]};
        lmg_accumulator_deposit(acc, &r, 1);
    }
    lmg_ray r = good;
    r.origin.y = (double)NAN;
    lmg_accumulator_deposit(acc, &r, 1);
    refused++;
    assert_int_equal(lmg_accumulator_totals(acc).refused, refused);
    assert_int_equal(lmg_accumulator_totals(acc).rays, 0);
    /* a negative component of a colour out of the gamut isn't bad; a ray downwards has no place here */
    r = good;
    r.flux[2] = -0.5F;
    lmg_accumulator_deposit(acc, &r, 1);
    r = good;
    r.direction.y = -1;
    r.flux[0] = 2;
    lmg_accumulator_deposit(acc, &r, 1);
    lmg_deposit_totals t = lmg_accumulator_totals(acc);
    assert_int_equal(t.rays, 1);
    assert_int_equal(t.unplaced, 1);
    assert_int_equal(t.refused, refused);
    assert_near(t.stored, 0.2126 + 0.7152 - 0.0722 * 0.5, 1e-12);
    assert_near(t.residual, 2 * 0.2126 + 0.7152 + 0.0722, 1e-12);
    lmg_accumulator_destroy(acc);
}

/* Weights far below the fixed point's unit keep their mean: 4 10^6 rays of 1e-9 are 4e-3, to a few standard errors of the rounding. */
static void small_weights_have_no_bias(void **state)
{
    (void)state;
    enum { N = 4000000 };
    lmg_layout l = upwards(1, 1, 1, 1, 1);
    const float weights[] = {1e-9F, 4.3e-7F, 1.3e-6F, 0.3F};
    for (int k = 0; k < 4; k++) {
        lmg_accumulator *acc = create(&l);
        lmg_ray r = {.origin = {0.1, 0, 0.2}, .direction = {0, 1, 0}, .flux = {weights[k], weights[k], weights[k]}};
        for (uint64_t i = 0; i < N; i++) {
            r.number = i;
            lmg_accumulator_deposit(acc, &r, 1);
        }
        /* a ray's rounding error has variance p (1-p) of a unit of 2^-20 */
        double w = (double)weights[k], p = w * 0x1p20 - floor(w * 0x1p20), se = sqrt(N * p * (1 - p)) * 0x1p-20;
        assert_near(lmg_accumulator_totals(acc).stored, N * w, 4.5 * se + 1e-12);
        p = w * w * LMG_SQUARE_ONE - floor(w * w * LMG_SQUARE_ONE);
        assert_near((double)acc->words[2] / LMG_SQUARE_ONE, N * w * w, 4.5 * sqrt(N * p * (1 - p)) / LMG_SQUARE_ONE + 1e-12);
        lmg_accumulator_destroy(acc);
    }
}

/* Sums don't overflow at 10^11 units in a cell; the words are set as if so many rays had come. */
static void large_sums_survive(void **state)
{
    (void)state;
    lmg_layout l = upwards(1, 1, 1, 1, 3);
    lmg_accumulator *acc = create(&l);
    const uint64_t rays = 100000000000u;
    for (int c = 0; c < 6; c++)
        acc->words[c] = rays / 2 << 20;
    acc->words[6] = rays << 12;
    lmg_field *f;
    assert_int_equal(lmg_field_reconstruct(acc, 1.0 / (double)rays, NULL, &f, NULL), LMG_OK);
    double se;
    assert_near(lmg_field_slab_flux(f, 0, &se), 1, 1e-6);
    assert_near(se * sqrt((double)rays), 1, 1e-6);
    lmg_field_destroy(f);
    lmg_accumulator_destroy(acc);
}

/* All of 1-cell, 1xN, prime resolutions, one and three channels: flux in = flux stored + residual, to 1e-6; halves add up. */
static void flux_is_conserved(void **state)
{
    (void)state;
    const uint32_t n[][4] = {{1, 1, 1, 1}, {1, 37, 1, 1}, {1, 1, 1, 41}, {7, 5, 11, 3}, {17, 19, 13, 23}};
    enum { N = 30000 };
    for (size_t k = 0; k < sizeof n / sizeof *n; k++)
        for (int kind = (int)k % 2; kind < LAMP_COUNT; kind += 2) {
            lmg_fit_options wishes = {.channels = k % 2 ? 3 : 1, .choice = (lmg_layout_choice)(k % 3)};
            memcpy(wishes.resolution, n[k], sizeof wishes.resolution);
            lmg_layout l = lamp_layout((lamp)kind, &wishes);
            lmg_accumulator *acc = create(&l);
            lmg_ray *rays = coloured((lamp)kind, N);
            lmg_accumulator_deposit(acc, rays, N);
            double sent = 0;
            for (int i = 0; i < N; i++)
                sent += fmax(lmg_luminance(rays[i].flux), 0);
            lmg_deposit_totals t = lmg_accumulator_totals(acc);
            assert_near((t.stored + t.residual) / sent, 1, 1e-6);
            assert_int_equal(t.unplaced, 0); /* every ray of a lamp within its bounds has a place */
            lmg_field *f;
            lmg_error err = {{0}};
            if (lmg_field_reconstruct(acc, 0.37, NULL, &f, &err) != LMG_OK)
                fail_msg("%s", err.message);
            assert_near(stored_flux(f) / (0.37 * t.stored), 1, 1e-6);
            assert_near((lmg_field_ledger(f).stored + lmg_field_ledger(f).residual) / (0.37 * sent), 1, 1e-6);
            /* nothing infinite, no error where nothing fell, halves within what they may be */
            for (uint32_t j = 0; j < l.slab_count; j++)
                for (uint64_t c = 0; c < f->slabs[j].cells; c++) {
                    float y = l.channels == 1 ? *lmg_cell_radiance(&f->slabs[j], c)
                                              : (float)lmg_luminance(lmg_cell_radiance(&f->slabs[j], c));
                    assert_true(isfinite(y) && isfinite(f->slabs[j].standard_error[c]) && isfinite(f->slabs[j].half_a[c]));
                    if (f->slabs[j].standard_error[c] == 0)
                        assert_true(y == 0 && f->slabs[j].half_a[c] == 0);
                    assert_true((double)f->slabs[j].half_a[c] <= 2 * (double)y * (1 + 1e-5));
                }
            lmg_field_destroy(f);
            lmg_accumulator_destroy(acc);
            free(rays);
        }
}

/* Half A is what even numbers give alone, scaled up: reconstructing them alone with twice the lumens gives the same cells. */
static void half_a_is_the_even_photons(void **state)
{
    (void)state;
    enum { N = 20000 };
    lmg_layout l = lamp_layout(LAMP_LENS, &(lmg_fit_options){.cells = 5000, .channels = 3});
    lmg_ray *rays = coloured(LAMP_LENS, N);
    lmg_accumulator *all = create(&l), *even = create(&l);
    lmg_accumulator_deposit(all, rays, N);
    for (int i = 0; i < N; i += 2)
        lmg_accumulator_deposit(even, &rays[i], 1);
    lmg_field *f, *a;
    assert_int_equal(lmg_field_reconstruct(all, 1, NULL, &f, NULL), LMG_OK);
    assert_int_equal(lmg_field_reconstruct(even, 2, NULL, &a, NULL), LMG_OK);
    for (uint32_t j = 0; j < l.slab_count; j++)
        for (uint64_t c = 0; c < f->slabs[j].cells; c++) {
            double y = lmg_luminance(lmg_cell_radiance(&a->slabs[j], c));
            assert_near((double)f->slabs[j].half_a[c], y, 1e-5 * fabs(y) + 1e-6 * (double)a->slabs[j].standard_error[c]);
        }
    lmg_field_destroy(f);
    lmg_field_destroy(a);
    lmg_accumulator_destroy(all);
    lmg_accumulator_destroy(even);
    free(rays);
}

/* A slab all but covered by one before it: what falls in the sliver left over stays, as finite radiance or as residual. */
static void slivers_keep_their_flux(void **state)
{
    (void)state;
    /* the first slab covers the second but for 1e-9 m at its end: in the same plane; in another plane, so that shadows are cut, not
     * rectangles; and with one single cell, so that no neighbour can take the flux in */
    for (int variant = 0; variant < 3; variant++) {
        uint32_t n = variant == 2 ? 1 : 4;
        lmg_layout l = upwards(n, n, n, n, 1);
        l.slab_count = 2;
        l.slabs[1] = l.slabs[0];
        l.slabs[0].u1 = l.slabs[1].u1 - 1e-9;
        l.slabs[0].v1 = l.slabs[1].v1 - 1e-9;
        l.slabs[0].o.y = variant == 1 ? 1e-12 : 0;
        /* (u,v) rectangles are z and x; the bounds are to hold all lines */
        l.bounds_min = (lmg_vec3){-3, -1, -3};
        l.bounds_max = (lmg_vec3){3, 1, 3};
        lmg_accumulator *acc = create(&l);
        for (uint64_t i = 0; i < 100; i++) {
            lmg_ray r = {.origin = {0.3, 0, i % 2 ? 2 - 5e-10 : 0.01 * (double)(i % 7)}, .direction = {0, 1, 0}, .flux = {1, 1, 1}, .number = i / 2};
            lmg_accumulator_deposit(acc, &r, 1);
        }
        assert_int_equal(lmg_accumulator_totals(acc).rays, 100);
        lmg_field *f;
        assert_int_equal(lmg_field_reconstruct(acc, 1, NULL, &f, NULL), LMG_OK);
        lmg_ledger ledger = lmg_field_ledger(f);
        assert_near(ledger.stored + ledger.residual, 100, 1e-9);
        /* the sliver's flux has no place in the second slab, of whose other cells nothing is its own either */
        assert_near(ledger.residual, 50, 1e-9);
        assert_near(stored_flux(f), ledger.stored, 1e-6 * 100);
        float most = 0;
        for (int j = 0; j < 2; j++)
            for (uint64_t c = 0; c < f->slabs[j].cells; c++)
                most = fmaxf(most, *lmg_cell_radiance(&f->slabs[j], c));
        /* 50 lm in the etendue of a cell of 1 m2 and slopes of 0.5: at least 0.25 / (1 + 0.25 + 0.25)^2 */
        assert_true((double)most <= 50 / (0.25 / 2.25));
        lmg_field_destroy(f);
        lmg_accumulator_destroy(acc);
    }
    /* half of the second slab is free: there the sliver's flux finds the nearest cell that can carry it */
    lmg_layout l = upwards(8, 4, 4, 4, 1);
    l.slab_count = 2;
    l.slabs[1] = l.slabs[0];
    l.slabs[0].u0 = -1.5 + 1e-4; /* leaves one column of cells, and 1e-4 of 0.5 m of the next, whose share is 0.02 %, */
    l.bounds_min = (lmg_vec3){-3, -1, -3};
    l.bounds_max = (lmg_vec3){3, 1, 3};
    lmg_accumulator *acc = create(&l);
    lmg_ray r = {.origin = {0.3, 0, -1.5 + 5e-5}, .direction = {0, 1, 0}, .flux = {1, 1, 1}};
    lmg_accumulator_deposit(acc, &r, 1);
    lmg_field *f;
    assert_int_equal(lmg_field_reconstruct(acc, 1, NULL, &f, NULL), LMG_OK);
    assert_near(lmg_field_ledger(f).residual, 0, 0);
    assert_near(lmg_field_slab_flux(f, 1, NULL), 1, 1e-6);
    assert_near(lmg_field_slab_flux(f, 0, NULL), 0, 0);
    lmg_field_destroy(f);
    lmg_accumulator_destroy(acc);
}

static void ledger_and_texts(void **state)
{
    (void)state;
    lmg_layout l = upwards(2, 2, 2, 2, 1);
    lmg_accumulator *acc = create(&l);
    lmg_ray r = {.origin = {0, 0, 0}, .direction = {0, 1, 0}, .flux = {1, 1, 1}};
    for (int i = 0; i < 10; i++)
        lmg_accumulator_deposit(acc, &r, 1);
    const lmg_ledger in = {.photons = 16, .emitted = 32, .absorbed = 11, .lost = 1, .emitted_se = 0, .absorbed_se = 0.5, .stored_se = 0.25};
    lmg_field *f;
    assert_int_equal(lmg_field_reconstruct(acc, 2, &in, &f, NULL), LMG_OK);
    lmg_ledger out = lmg_field_ledger(f);
    assert_int_equal(out.photons, 16);
    assert_near(out.stored, 20, 1e-12);
    assert_near(out.emitted, out.stored + out.residual + out.absorbed + out.lost, 1e-12);
    assert_near(out.stored_se, 0.25, 0);
    assert_int_equal(lmg_field_scale(f, 0.5, NULL), LMG_OK);
    assert_near(lmg_field_slab_flux(f, 0, NULL), 10, 1e-5);
    assert_near(lmg_field_ledger(f).absorbed_se, 0.25, 1e-12);
    assert_int_equal(lmg_field_scale(f, 0, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_scale(f, (double)NAN, NULL), LMG_ERROR_ARGUMENT);

    lmg_error err;
    assert_int_equal(lmg_field_set_text(f, "seed", "7", &err), LMG_OK);
    assert_int_equal(lmg_field_set_text(f, "model", "a lamp", &err), LMG_OK);
    assert_int_equal(lmg_field_set_text(f, "effects", "", &err), LMG_OK);
    assert_int_equal(lmg_field_set_text(f, "seed", "8", &err), LMG_OK);
    assert_int_equal(lmg_field_set_text(f, "", "x", &err), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_set_text(f, "two words", "x", &err), LMG_ERROR_ARGUMENT);
    assert_string_equal(lmg_field_text_name(f, 0), "effects");
    assert_string_equal(lmg_field_text_name(f, 1), "model");
    assert_string_equal(lmg_field_text_name(f, 2), "seed");
    assert_null(lmg_field_text_name(f, 3));
    assert_string_equal(lmg_field_get_text(f, "seed"), "8");
    assert_int_equal(lmg_field_set_text(f, "model", NULL, &err), LMG_OK);
    assert_null(lmg_field_get_text(f, "model"));
    assert_string_equal(lmg_field_text_name(f, 1), "seed");
    lmg_field_destroy(f);
    assert_int_equal(lmg_field_reconstruct(acc, 0, NULL, &f, &err), LMG_ERROR_ARGUMENT);
    assert_null(f);
    lmg_accumulator_destroy(acc);
    lmg_accumulator_destroy(NULL);
    lmg_field_destroy(NULL);
}

static void bad_wishes_are_refused(void **state)
{
    (void)state;
    lmg_ray *rays = lamp_rays(LAMP_DISC, 1, 0, 100);
    lmg_fit_options good = {.struct_size = sizeof good};
    lamp_bounds(LAMP_DISC, &good.bounds_min, &good.bounds_max);
    lmg_layout l;
    lmg_error err;
    char report[1024];
    assert_int_equal(lmg_layout_fit(rays, 100, &good, &l, report, &err), LMG_OK);
    assert_true(strlen(report) > 20 && report[strlen(report) - 1] == '\n');
    assert_int_equal(lmg_layout_fit(rays, 1, &good, &l, report, &err), LMG_OK); /* a single ray is a pilot, if a poor one */
    assert_int_equal(lmg_layout_fit(rays, 0, &good, &l, report, &err), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_layout_fit(NULL, 5, &good, &l, report, &err), LMG_ERROR_ARGUMENT);
#define BAD(change)                                                                                                                    \
    do {                                                                                                                               \
        lmg_fit_options o = good;                                                                                                      \
        change;                                                                                                                        \
        err.message[0] = 0;                                                                                                            \
        assert_int_equal(lmg_layout_fit(rays, 100, &o, &l, NULL, &err), LMG_ERROR_ARGUMENT);                                           \
        assert_true(strlen(err.message) > 10);                                                                                         \
    } while (0)
    BAD(o.struct_size = 3);
    BAD(o.bounds_min = o.bounds_max);
    BAD(o.bounds_min.x = (double)NAN);
    BAD(o.bounds_max.y = -1);
    BAD(o.channels = 2);
    BAD(o.distance = -1);
    BAD(o.distance = (double)NAN);
    BAD(o.photons = -1);
    BAD(o.photons = (double)NAN);
    BAD(o.resolution[2] = 70000);
    BAD(o.cells = (uint64_t)1 << 40);
    BAD(o.choice = (lmg_layout_choice)5);
    for (int i = 0; i < 100; i++)
        rays[i].flux[0] = rays[i].flux[1] = rays[i].flux[2] = 0;
    assert_int_equal(lmg_layout_fit(rays, 100, &good, &l, NULL, &err), LMG_ERROR_ARGUMENT);
    free(rays);
}

/* One colour is noticed and kept; two aren't one. */
static void one_colour_needs_one_channel(void **state)
{
    (void)state;
    enum { N = 2000 };
    lmg_ray *rays = lamp_rays(LAMP_DISC, 1, 0, N);
    lmg_fit_options o = {.struct_size = sizeof o};
    lamp_bounds(LAMP_DISC, &o.bounds_min, &o.bounds_max);
    lmg_layout l;
    for (int i = 0; i < N; i++) {
        float w = (float)(0.1 + 0.37 * (i % 13));
        rays[i].flux[0] = 1.7F * w;
        rays[i].flux[1] = 0.9F * w;
        rays[i].flux[2] = -0.1F * w;
    }
    assert_int_equal(lmg_layout_fit(rays, N, &o, &l, NULL, NULL), LMG_OK);
    assert_int_equal(l.channels, 1);
    assert_near(lmg_luminance(l.colour), 1, 1e-6);
    assert_near((double)(l.colour[0] / l.colour[1]), 1.7 / 0.9, 1e-5);
    rays[77].flux[2] *= 1.001F;
    assert_int_equal(lmg_layout_fit(rays, N, &o, &l, NULL, NULL), LMG_OK);
    assert_int_equal(l.channels, 3);
    free(rays);
}

/* ---------------------------------------------------------------------------------------------------- saving and loading */

typedef struct saved {
    unsigned char *bytes;
    size_t size, capacity;
} saved;

static bool keep_bytes(void *self, const void *bytes, size_t count)
{
    saved *s = self;
    if (s->size + count > s->capacity) {
        s->capacity = 2 * s->capacity + count;
        s->bytes = realloc(s->bytes, s->capacity);
        assert_non_null(s->bytes);
    }
    memcpy(s->bytes + s->size, bytes, count);
    s->size += count;
    return true;
}

static bool refuse_bytes(void *self, const void *bytes, size_t count)
{
    (void)self, (void)bytes, (void)count;
    return false;
}

static saved save(const lmg_accumulator *acc)
{
    saved s = {0};
    lmg_error err;
    if (lmg_accumulator_save(acc, keep_bytes, &s, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return s;
}

/* Rays with all that an accumulator can hold: three channels with negative components, unplaced and refused ones, empty cells. */
static lmg_accumulator *varied(uint32_t channels, uint64_t first, size_t count)
{
    lmg_fit_options o = {.struct_size = sizeof o, .cells = 200000, .channels = channels};
    const lmg_layout l = lamp_layout(LAMP_LENS, &o);
    lmg_accumulator *acc;
    assert_int_equal(lmg_accumulator_create(&l, &acc, NULL), LMG_OK);
    lmg_ray *rays = lamp_rays(LAMP_LENS, 3, first, count);
    for (size_t i = 0; i < count; i++) {
        const double w = exp(20 * (double)(rays[i].number % 97) / 97 - 10);
        rays[i].flux[0] = (float)(w * 1.9);
        rays[i].flux[1] = (float)(w * 0.9);
        rays[i].flux[2] = (float)(w * -0.4);
        if (i % 101 == 7)
            rays[i].flux[1] = NAN;
    }
    lmg_accumulator_deposit(acc, rays, count);
    free(rays);
    return acc;
}

static void saved_counts_come_back(void **state)
{
    (void)state;
    for (uint32_t channels = 1; channels <= 3; channels += 2) {
        lmg_accumulator *acc = varied(channels, 0, 20000), *back;
        saved s = save(acc);
        lmg_error err;
        if (lmg_accumulator_load(s.bytes, s.size, &back, &err) != LMG_OK)
            fail_msg("%s", err.message);
        assert_int_equal(back->bytes, acc->bytes);
        for (size_t i = 0; i < acc->bytes / sizeof(uint64_t); i++)
            assert_true(back->words[i] == acc->words[i]);
        assert_memory_equal(&back->layout.slabs[0], &acc->layout.slabs[0], sizeof(lmg_slab));
        const lmg_deposit_totals x = lmg_accumulator_totals(acc), y = lmg_accumulator_totals(back);
        assert_memory_equal(&x, &y, sizeof x);
        assert_true(x.refused > 0 && x.rays > 0);
        assert_true(s.size < acc->bytes / 4); /* a sparse table is far smaller than its memory */
        /* and it goes on as the first would have, with the same bytes */
        lmg_accumulator *more = varied(channels, 20000, 5000);
        assert_int_equal(lmg_accumulator_merge(acc, more, NULL), LMG_OK);
        assert_int_equal(lmg_accumulator_merge(back, more, NULL), LMG_OK);
        saved a = save(acc), b = save(back);
        assert_int_equal(a.size, b.size);
        assert_memory_equal(a.bytes, b.bytes, a.size);
        assert_int_equal(lmg_accumulator_save(acc, refuse_bytes, NULL, &err), LMG_ERROR_FILE_WRITE);
        lmg_accumulator_destroy(acc);
        lmg_accumulator_destroy(back);
        lmg_accumulator_destroy(more);
        free(s.bytes), free(a.bytes), free(b.bytes);
    }
}

/* Cut anywhere they are refused; with a byte changed they are refused or something possible, never a crash or a wild read. */
static void damaged_counts_are_refused(void **state)
{
    (void)state;
    lmg_accumulator *acc = varied(3, 0, 300), *back;
    saved s = save(acc);
    for (size_t n = 0; n < s.size; n += n < 2000 ? 1 : 37) {
        unsigned char *cut = malloc(n ? n : 1); /* its own block, so that reading past its end shows */
        memcpy(cut, s.bytes, n);
        lmg_error err;
        assert_int_equal(lmg_accumulator_load(cut, n, &back, &err), LMG_ERROR_FILE_FORMAT);
        assert_null(back);
        free(cut);
    }
    size_t refused = 0, tried = 0;
    for (size_t i = 0; i < s.size; i += i < 3000 ? 7 : 61)
        for (int bit = 0; bit < 8; bit += 7, tried++) {
            s.bytes[i] ^= (unsigned char)(1 << bit);
            if (lmg_accumulator_load(s.bytes, s.size, &back, NULL) != LMG_OK) {
                refused++;
                assert_null(back);
            }
            lmg_accumulator_destroy(back);
            s.bytes[i] ^= (unsigned char)(1 << bit);
        }
    assert_true(refused > tried / 10);
    /* trailing bytes */
    s.bytes = realloc(s.bytes, s.size + 1);
    s.bytes[s.size] = 0;
    assert_int_equal(lmg_accumulator_load(s.bytes, s.size + 1, &back, NULL), LMG_ERROR_FILE_FORMAT);
    lmg_accumulator_destroy(acc);
    free(s.bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(threads_give_the_same_bits),
        cmocka_unit_test(merging_needs_one_layout),
        cmocka_unit_test(bad_rays_are_refused_and_counted),
        cmocka_unit_test(small_weights_have_no_bias),
        cmocka_unit_test(large_sums_survive),
        cmocka_unit_test(flux_is_conserved),
        cmocka_unit_test(half_a_is_the_even_photons),
        cmocka_unit_test(slivers_keep_their_flux),
        cmocka_unit_test(ledger_and_texts),
        cmocka_unit_test(bad_wishes_are_refused),
        cmocka_unit_test(one_colour_needs_one_channel),
        cmocka_unit_test(saved_counts_come_back),
        cmocka_unit_test(damaged_counts_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
