/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Rays traced backwards into the lamp: radiance along single rays against closed forms, of cells against photons, and their
 * mixture.
 */
#include "../unit/make_model.h"
#include "bake.h"
#include "field.h"
#include "geometry.h"
#include "look.h"
#include "part.h"
#include "stats.h"
#include "tracer.h"

#include <luminaires/rng.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SLOWER = 10 };
#else
enum { SLOWER = 1 };
#endif

static const double LUMINANCE = 5000;

static uint32_t emitter(lum_model *model)
{
    const uint32_t m = make_material(model, LUM_SURFACE_BLACK);
    for (int c = 0; c < 3; ++c)
        model->materials[m].emissive[c] = (float)LUMINANCE;
    return m;
}

static bake_source *trace_in(lum_model *model)
{
    bake_source *tracer;
    lmg_error err;
    finish_model(model);
    if (bake_tracer_create_with(model, ~(1u << BAKE_POLARIZATION), 3, NULL, &tracer, &err) != LMG_OK)
        fail_msg("%s", err.message);
    assert_true(bake_tracer_can_look(tracer, NULL));
    return tracer;
}

enum { MANY = 20000 };

/* Mean luminance over rays with one origin and direction, over LUMINANCE; *least, *most: of them. */
static stats_mean look(const bake_source *tracer, lmg_vec3 origin, lmg_vec3 direction, double *least, double *most)
{
    static lmg_ray rays[MANY];
    static float radiance[MANY][3];
    static uint64_t number;
    for (size_t i = 0; i < MANY; ++i)
        rays[i] = (lmg_ray){.origin = origin, .direction = direction, .number = number++};
    const unsigned saved = lum_thread_begin();
    assert_true(bake_tracer_look(tracer, rays, MANY, radiance, NULL));
    lum_thread_end(saved);
    stats_mean mean = {0};
    *least = (double)INFINITY;
    *most = 0;
    for (size_t i = 0; i < MANY; ++i) {
        const double y = lmg_luminance(radiance[i]) / LUMINANCE;
        stats_add(&mean, y);
        *least = fmin(*least, y);
        *most = fmax(*most, y);
    }
    return mean;
}

/* Directly, by a mirror, through a filter: without noise. */
static void without_noise(void **state)
{
    (void)state;
    double least, most;
    lum_model *model = make_model();
    const uint32_t light = emitter(model), mirror = make_mirror(model, 0.9f, 0), half = make_glass(model, 1.0f, 0, true);
    for (int c = 0; c < 3; ++c)
        model->materials[half].base_color[c] = 0.5f;
    make_quad(model, (lmg_vec3){-1, -1, 0}, (lmg_vec3){2, 0, 0}, (lmg_vec3){0, 2, 0}, 1, light); /* faces +z */
    make_quad(model, (lmg_vec3){3, -1, 0}, (lmg_vec3){0, 2, 0}, (lmg_vec3){0, 0, 2}, 1, mirror); /* faces +x: its back is seen */
    make_quad(model, (lmg_vec3){-1, -1, 1}, (lmg_vec3){0.5, 0, 0}, (lmg_vec3){0, 2, 0}, 1, half);
    bake_source *tracer = trace_in(model);
    look(tracer, (lmg_vec3){0.6, 0, 2}, (lmg_vec3){0.6, 0, 0.8}, &least, &most);
    assert_true(least > 1 - 1e-6 && most < 1 + 1e-6); /* direct, at 37 degrees */
    look(tracer, (lmg_vec3){0, 0, -2}, (lmg_vec3){0, 0, -1}, &least, &most);
    assert_true(most == 0); /* the dark side */
    /* Light from (0.5,0,0) goes up to the right, meets the mirror at x = 3, and returns to the left. */
    const double d = sqrt(0.5);
    look(tracer, (lmg_vec3){2, 0, 3.5}, (lmg_vec3){-d, 0, d}, &least, &most);
    assert_true(most == 0); /* above the mirror */
    look(tracer, (lmg_vec3){2.9, 0, 1.0}, (lmg_vec3){-2.5 / hypot(2.5, 1), 0, 1 / hypot(2.5, 1)}, &least, &most);
    assert_true(fabs(least - 0.9) < 1e-6 && fabs(most - 0.9) < 1e-6);
    look(tracer, (lmg_vec3){-0.8, 0, 2}, (lmg_vec3){0, 0, 1}, &least, &most);
    assert_true(fabs(least - 0.5) < 1e-6 && fabs(most - 0.5) < 1e-6);
    tracer->destroy(tracer);
    free_model(model);
}

/* Through a clear slab of n = 1.52, unpolarized at each face: (1 - F) / (1 + F). */
static void clear_slab(void **state)
{
    (void)state;
    static const double DEGREES[] = {0, 30, 45, 60, 75};
    lum_model *model = make_model();
    make_quad(model, (lmg_vec3){-90, -90, -1}, (lmg_vec3){180, 0, 0}, (lmg_vec3){0, 180, 0}, 1, emitter(model));
    make_box(model, (lmg_vec3){-9, -9, 0}, (lmg_vec3){9, 9, 0.01}, false, 3, make_glass(model, 1.52f, 0, false));
    bake_source *tracer = trace_in(model);
    for (int a = 0; a < 5; ++a) {
        const double t = DEGREES[a] * PI / 180, f = lum_fresnel_dielectric(cos(t), (double)1.52f), expected = (1 - f) / (1 + f);
        double least, most;
        const stats_mean mean = look(tracer, (lmg_vec3){0.3, 0.2, 1}, (lmg_vec3){sin(t), 0, cos(t)}, &least, &most);
        print_message("slab at %g degrees: %.4f +- %.4f, closed form %.4f\n", DEGREES[a], mean.mean, stats_error(&mean), expected);
        assert_true(fabs(mean.mean - expected) < 4 * stats_error(&mean)); /* 5 values: one in 3000 runs of other seeds */
    }
    tracer->destroy(tracer);
    free_model(model);
}

/* A lossless lamp in a uniformly bright room: whatever the rays meet, they see the room, to rounding. */
static void furnace(void **state)
{
    (void)state;
    lum_model *model = make_model();
    make_box(model, (lmg_vec3){-2, -2, -2}, (lmg_vec3){2, 2, 2}, true, 1, emitter(model));
    make_sphere(model, (lmg_vec3){0, 0, 0}, 0.5, 16, false, false, make_glass(model, 1.6f, 0, false));
    make_sphere(model, (lmg_vec3){0, 0, 0}, 0.2, 8, false, false, make_lambert(model, 1));
    make_box(model, (lmg_vec3){-1.5, -1.5, -1.5}, (lmg_vec3){1.5, 1.5, -1.2}, false, 1, make_glass(model, 1.5f, 0.4f, false));
    make_quad(model, (lmg_vec3){0.9, -1, -1}, (lmg_vec3){0, 2, 0}, (lmg_vec3){0, 0, 2}, 1, make_mirror(model, 1, 0.3f));
    make_quad(model, (lmg_vec3){-0.9, -1, -1}, (lmg_vec3){0, 2, 0}, (lmg_vec3){0, 0, 2}, 1, make_glass(model, 1.5f, 0, true));
    bake_source *tracer = trace_in(model);
    lum_rng rng = lum_rng_stream(9, 9);
    for (int i = 0; i < 40 / SLOWER; ++i) {
        double least, most;
        const double z = 2 * lum_rng_next(&rng) - 1, r = sqrt(1 - z * z), phi = 2 * PI * lum_rng_next(&rng);
        const lmg_vec3 o = {0.7, 1.6 * lum_rng_next(&rng) - 0.8, 1.6 * lum_rng_next(&rng) - 0.8};
        look(tracer, o, (lmg_vec3){r * cos(phi), r * sin(phi), z}, &least, &most);
        if (!(least > 1 - 1e-5 && most < 1 + 1e-5))
            fail_msg("ray %d sees %.7f to %.7f of the room", i, least, most);
    }
    tracer->destroy(tracer);
    free_model(model);
}

/* ---------------------------------------------------------------------------------------------------------------- cells */

/* A lamp's photons, in cells large enough for normal statistics. */
typedef struct counted {
    lum_model *model;
    bool file;
    bake_source *tracer;
    lmg_layout layout;
    lmg_accumulator *acc;
    lmg_field *field, *pilot; /* of the photons; of other ones, which choose the cells to be compared */
    uint64_t photons;
    bake_tally tally;
} counted;

static void count_photons(counted *c, uint64_t photons, uint64_t cells, uint64_t first)
{
    lmg_error err = {{0}};
    bake_ray_list *list;
    c->photons = photons;
    assert_int_equal(bake_ray_list_create(60000, &list, &err), LMG_OK);
    lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    assert_int_equal(c->tracer->run(c->tracer, BAKE_PILOT_FIRST, 50000, 0, &sink, 1, &tally, &err), LMG_OK);
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(list, &count);
    const lmg_fit_options fit = {
        .struct_size = sizeof(fit), .cells = cells, .bounds_min = c->tracer->bounds_min, .bounds_max = c->tracer->bounds_max};
    assert_int_equal(lmg_layout_fit(rays, count, &fit, &c->layout, NULL, &err), LMG_OK);
    lmg_accumulator *few;
    assert_int_equal(lmg_accumulator_create(&c->layout, &few, &err), LMG_OK);
    lmg_accumulator_deposit(few, rays, count);
    assert_int_equal(lmg_field_reconstruct(few, 1, NULL, &c->pilot, &err), LMG_OK);
    lmg_accumulator_destroy(few);
    bake_ray_list_destroy(list);
    assert_int_equal(lmg_accumulator_create(&c->layout, &c->acc, &err), LMG_OK);
    sink = lmg_accumulator_sink(c->acc);
    assert_int_equal(c->tracer->run(c->tracer, first, photons, 0, &sink, 1, &c->tally, &err), LMG_OK);
    assert_int_equal(lmg_field_reconstruct(c->acc, c->tracer->flux / (double)photons, NULL, &c->field, &err), LMG_OK);
}

static void free_counted(counted *c)
{
    lmg_field_destroy(c->field);
    lmg_field_destroy(c->pilot);
    lmg_accumulator_destroy(c->acc);
    c->tracer->destroy(c->tracer);
    if (c->file)
        lum_model_destroy(c->model);
    else
        free_model(c->model);
}

/* A sample lamp. */
static counted load(const char *name)
{
    char path[1200];
    lmg_error err = {{0}};
    counted c = {.file = true};
    snprintf(path, sizeof(path), "%s/models/%s/%s.gltf", LUMIBOX_BINARY_DIR, name, name);
    if (lum_model_load(path, NULL, &c.model, &err) != LMG_OK ||
        bake_tracer_create_with(c.model, ~(1u << BAKE_POLARIZATION), 5, NULL, &c.tracer, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return c;
}

/*
 * Gathered and counted radiance of the same cells, and the flux in them.  Null hypothesis: equal means.  Photons are Poisson, of
 * the mean that gathering says (the count's own would favour cells with few); both means are normal where cells have many photons
 * and the rays see light often.  Cells are chosen by photons of the pilot and by other rays (20 of them see light), which have no
 * part in either.
 */
static void compare_cells(counted *c, const char *name, double rays_per_photon)
{
    lmg_error err = {{0}};
    lmg_gathering *g, *other;
    assert_int_equal(lmg_gathering_create(c->acc, rays_per_photon, 77, &g, &err), LMG_OK);
    assert_int_equal(lmg_gathering_create(c->acc, rays_per_photon, 78, &other, &err), LMG_OK);
    assert_int_equal(lmg_gathering_cells(g),
                     lmg_gathering_cells(other)); /* so many photons fell into the cells compared that all get rays */
    static lmg_ray rays[2 * LMG_GATHERING_RAYS];
    static float radiance[2 * LMG_GATHERING_RAYS][3];
    lmg_plan plan;
    lmg_plan_prepare(&plan, &c->layout);
    const double scale = c->tracer->flux / bake_tracer_emission(c->tracer), unit = c->tracer->flux / (double)c->photons;
    double chi2 = 0, flux[2] = {0, 0}, variance = 0;
    int cells = 0;
    const unsigned saved = lum_thread_begin();
    for (size_t i = 0; i < lmg_gathering_cells(g); ++i) {
        const uint32_t n = lmg_gathering_draw(g, i, rays);
        if (n == 0)
            continue;
        double uvst[4];
        const int j = lmg_plan_owner(&plan, rays[0].origin, rays[0].direction, uvst);
        const uint64_t cell = lmg_plan_cell(&plan, j, uvst);
        const double etendue = lmg_layout_cell_etendue(
            &c->layout, (uint32_t)j, (uint32_t)(cell / c->layout.slabs[j].ns / c->layout.slabs[j].nt % c->layout.slabs[j].nu),
            (uint32_t)(cell / c->layout.slabs[j].ns / c->layout.slabs[j].nt / c->layout.slabs[j].nu),
            (uint32_t)(cell % c->layout.slabs[j].ns), (uint32_t)(cell / c->layout.slabs[j].ns % c->layout.slabs[j].nt));
        /* at least 5 photons of the pilot's 50,000 */
        const float *few = lmg_cell_radiance(&c->pilot->slabs[j], cell);
        if ((c->layout.channels == 1 ? (double)few[0] : lmg_luminance(few)) * etendue < 4.99)
            continue;
        uint32_t bright = 0;
        const uint32_t others = lmg_gathering_draw(other, i, rays);
        assert_true(bake_tracer_look(c->tracer, rays, others, radiance, NULL));
        for (uint32_t k = 0; k < others; ++k)
            bright += radiance[k][1] > 0;
        if (bright < 20)
            continue;
        assert_int_equal(lmg_gathering_draw(g, i, rays), n);
        assert_true(bake_tracer_look(c->tracer, rays, n, radiance, NULL));
        stats_mean seen = {0};
        for (uint32_t k = 0; k < n; ++k)
            stats_add(&seen, lmg_luminance(radiance[k]) * scale);
        const float *r = lmg_cell_radiance(&c->field->slabs[j], cell);
        const double photons = c->layout.channels == 1 ? (double)r[0] : lmg_luminance(r);
        const double var = pow(stats_error(&seen), 2) + seen.mean * unit / etendue;
        chi2 += pow(seen.mean - photons, 2) / var;
        flux[0] += photons * etendue;
        flux[1] += seen.mean * etendue;
        variance += var * etendue * etendue;
        ++cells;
    }
    lum_thread_end(saved);
    lmg_gathering_destroy(g);
    lmg_gathering_destroy(other);
    const double z = (flux[1] - flux[0]) / sqrt(variance);
    print_message("%s: %d cells with %.1f %% of the flux: chi-square %.0f, p %.2g; gathered flux %+.3f %% +- %.3f %%\n", name,
                  cells, 100 * flux[0] / (c->tally.escaped * unit), chi2, stats_chi_square_tail(chi2, cells),
                  100 * (flux[1] / flux[0] - 1), 100 * sqrt(variance) / flux[0]);
    assert_true(cells > (SLOWER > 1 ? 3 : 30)); /* few photons fill few cells */
    assert_true(SLOWER > 1 || flux[0] > 0.5 * c->tally.escaped * unit);
    assert_true(SLOWER > 1 || stats_chi_square_tail(chi2, cells) > 1e-4); /* too few for a normal law */
    assert_true(fabs(z) < 3.5); /* one in 2000 */
}

static void sample_lamp(void **state)
{
    const char *name = *state;
    counted c = load(name);
    count_photons(&c, 500000 / SLOWER, 3000, 0);
    compare_cells(&c, name, strcmp(name, "opal-globe") == 0 ? 4 : 1); /* there few of them find the bulb */
    free_counted(&c);
}

/* ------------------------------------------------------------------------------------------------------------- mixture */

/*
 * A panel half behind a grey blade, a few photons per cell, many times over: the mixture's mean is the photons' mean, cell by cell
 * (null hypothesis of the paired differences), its spread is less, and the standard errors say so within 20 %.
 */
static void mixture(void **state)
{
    (void)state;
    enum { RUNS = 60, PHOTONS = 20000 };
    lmg_error err = {{0}};
    counted c = {.model = make_model()};
    make_quad(c.model, (lmg_vec3){-0.1, -0.1, 0}, (lmg_vec3){0.2, 0, 0}, (lmg_vec3){0, 0.2, 0}, 1, emitter(c.model));
    make_quad(c.model, (lmg_vec3){0.013, -0.1, 0.07}, (lmg_vec3){0.08, 0, 0.02}, (lmg_vec3){0, 0.2, 0}, 1,
              make_lambert(c.model, 0.4f));
    c.tracer = trace_in(c.model);
    count_photons(&c, PHOTONS, 8000, 0);
    size_t cells = 0;
    for (uint32_t j = 0; j < c.layout.slab_count; ++j)
        cells += c.pilot->slabs[j].cells;
    stats_mean *difference = calloc(cells, sizeof(*difference)), *mixed = calloc(cells, sizeof(*mixed)),
               *alone = calloc(cells, sizeof(*alone));
    double *told = calloc(cells, sizeof(*told));
    assert_true(difference && mixed && alone && told);
    for (uint64_t run = 0; run < RUNS; ++run) {
        lmg_accumulator *acc;
        lmg_gathering *g;
        lmg_field *photons, *both;
        bake_tally tally = {0};
        assert_int_equal(lmg_accumulator_create(&c.layout, &acc, &err), LMG_OK);
        const lmg_sink into = lmg_accumulator_sink(acc);
        assert_int_equal(c.tracer->run(c.tracer, (1 + run) * PHOTONS, PHOTONS, 0, &into, 1, &tally, &err), LMG_OK);
        assert_int_equal(lmg_gathering_create(acc, 1, run, &g, &err), LMG_OK);
        assert_int_equal(bake_gather_run(c.tracer, g, c.tracer->flux, 0, NULL, &err), LMG_OK);
        const double unit = c.tracer->flux / PHOTONS;
        double share;
        assert_int_equal(lmg_field_reconstruct(acc, unit, NULL, &photons, &err), LMG_OK);
        assert_int_equal(lmg_field_reconstruct_gathered(acc, unit, NULL, g, &both, &share, &err), LMG_OK);
        assert_true(share > 0.5 && share <= 1);
        const double before = lmg_field_ledger(photons).stored, after = lmg_field_ledger(both).stored;
        assert_true(before == after);
        double sum[2] = {0, 0};
        for (uint32_t j = 0; j < c.layout.slab_count; ++j) {
            sum[0] += lmg_field_slab_flux(photons, j, NULL);
            sum[1] += lmg_field_slab_flux(both, j, NULL);
        }
        if (!(fabs(sum[1] - sum[0]) < 1e-6 * after))
            fail_msg("flux of the mixture %.9g, of the photons %.9g", sum[1], sum[0]);
        size_t k = 0;
        for (uint32_t j = 0; j < c.layout.slab_count; ++j)
            for (uint64_t i = 0; i < both->slabs[j].cells; ++i, ++k) {
                const double p = (double)*lmg_cell_radiance(&photons->slabs[j], i), m = (double)*lmg_cell_radiance(&both->slabs[j], i);
                assert_int_equal(c.layout.channels, 1);
                stats_add(&difference[k], m - p);
                stats_add(&mixed[k], m);
                stats_add(&alone[k], p);
                told[k] += pow((double)both->slabs[j].standard_error[i], 2) / RUNS;
            }
        lmg_field_destroy(photons);
        lmg_field_destroy(both);
        lmg_gathering_destroy(g);
        lmg_accumulator_destroy(acc);
    }
    /* cells with 2 to 40 photons a run, as another run of as many photons says */
    double chi2 = 0, spread[2] = {0, 0}, reported = 0;
    int used = 0;
    size_t k = 0;
    for (uint32_t j = 0; j < c.layout.slab_count; ++j)
        for (uint64_t i = 0; i < c.field->slabs[j].cells; ++i, ++k) {
            const double l = (double)*lmg_cell_radiance(&c.field->slabs[j], i), se = (double)c.field->slabs[j].standard_error[i];
            const double photons = se > 0 ? l * l / (se * se) : 0;
            if (photons < 1.9 || !(difference[k].m2 > 0))
                continue;
            chi2 += pow(difference[k].mean / stats_error(&difference[k]), 2);
            spread[0] += alone[k].m2 / (RUNS - 1);
            spread[1] += mixed[k].m2 / (RUNS - 1);
            reported += told[k];
            ++used;
        }
    /* squares of Student's t with RUNS - 1 degrees of freedom: mean n/(n-2), variance 2 n^2 (n-1) / ((n-2)^2 (n-4)) */
    const double n = RUNS - 1, z = (chi2 / used - n / (n - 2)) / sqrt(2 * n * n * (n - 1) / ((n - 2) * (n - 2) * (n - 4)) / used);
    print_message("mixture of %d cells: mean square of t %.3f, z = %.2f; variance %.3f of the photons', reported %.3f of it\n",
                  used, chi2 / used, z, spread[1] / spread[0], reported / spread[1]);
    assert_true(used > 500);
    assert_true(fabs(z) < 4);
    assert_true(spread[1] < 0.7 * spread[0]);
    assert_true(fabs(sqrt(reported / spread[1]) - 1) < 0.2);
    free(difference);
    free(mixed);
    free(alone);
    free(told);
    free_counted(&c);
}

/* ---------------------------------------------------------------------------------------------------------------- bakes */

static void *file_content(const char *path, size_t *size)
{
    FILE *f = fopen(path, "rb");
    assert_non_null(f);
    fseek(f, 0, SEEK_END);
    *size = (size_t)ftell(f);
    rewind(f);
    void *bytes = malloc(*size);
    assert_int_equal(fread(bytes, 1, *size, f), *size);
    fclose(f);
    return bytes;
}

static bake_report bake_to(const lum_model *model, const bake_options *options, const char *path)
{
    lmg_error err = {{0}};
    lmg_field *field;
    bake_report report;
    if (bake_run(model, options, &field, &report, &err) != LMG_OK || lmg_field_write(field, path, &err) != LMG_OK)
        fail_msg("%s", err.message);
    const lmg_ledger l = lmg_field_ledger(field);
    assert_true(fabs(l.stored + l.residual + l.absorbed + l.lost - l.emitted) <= 1e-6 * l.emitted);
    assert_true((lmg_field_get_text(field, "gathered_rays") != NULL) == (report.gathered_rays > 0));
    lmg_field_destroy(field);
    return report;
}

static void assert_same_file(const char *a, const char *b)
{
    size_t size[2];
    void *bytes[2] = {file_content(a, &size[0]), file_content(b, &size[1])};
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    free(bytes[0]);
    free(bytes[1]);
}

/* How bright the surfaces of the opal globe are, by its photons and its outlines: against the mean of what paths traced backwards from all over
 * see of each. */
static void brightness_of_surfaces(void **state)
{
    (void)state;
    enum { LINES = 400000 / SLOWER, LOOKS = 100000 };
    lmg_error err = {{0}};
    counted globe = load("opal-globe");
    const bake_options options = {.photons = 200000, .seed = 3, .trees = 2, .looks_chosen = true, .fit.cells = 20000};
    bake_report report;
    lmg_field *field;
    assert_int_equal(bake_run(globe.model, &options, &field, &report, &err), LMG_OK);
    lmg_looks *looks;
    assert_int_equal(lmg_looks_create(field, LMG_LOOK_OUTLINE, LOOKS, 3, &looks, &err), LMG_OK);
    bake_ray_list *list;
    assert_int_equal(bake_ray_list_create(options.photons, &list, &err), LMG_OK);
    const lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    assert_int_equal(globe.tracer->run(globe.tracer, 0, options.photons, 0, &sink, 1, &tally, &err), LMG_OK);
    size_t count;
    const lmg_ray *rays = bake_ray_list_sorted(list, &count);
    float *brightness;
    assert_int_equal(bake_look_brightness(globe.tracer, looks, rays, count, 0, &brightness, &err), LMG_OK);

    /* lines that are uniform in etendue around the lamp */
    const lmg_vec3 lo = globe.tracer->bounds_min, hi = globe.tracer->bounds_max, middle = v_scale(0.5, v_add(lo, hi));
    const double radius = 0.5 * v_length(v_sub(hi, lo));
    lmg_ray *line = malloc(LINES * sizeof(*line));
    float(*seen)[3] = malloc(LINES * sizeof(*seen));
    uint32_t *surface = malloc(LINES * sizeof(*surface));
    assert_true(line && seen && surface);
    for (size_t i = 0; i < LINES; ++i) {
        lum_rng rng = lum_rng_stream(78, i);
        const double z = 2 * lum_rng_next(&rng) - 1, turn = 2 * PI * lum_rng_next(&rng), r = sqrt(1 - z * z);
        const lmg_vec3 d = {r * cos(turn), r * sin(turn), z};
        const lmg_vec3 aside = v_cross(d, fabs(d.z) < 0.8 ? (lmg_vec3){0, 0, 1} : (lmg_vec3){1, 0, 0}), a = v_scale(1 / v_length(aside), aside),
                       b = v_cross(d, a);
        const double away = radius * sqrt(lum_rng_next(&rng)), around = 2 * PI * lum_rng_next(&rng);
        line[i] = (lmg_ray){.origin = v_fma(v_fma(v_fma(middle, 2 * radius, d), away * cos(around), a), away * sin(around), b),
                            .direction = d,
                            .number = i};
    }
    const unsigned saved = lum_thread_begin();
    bake_tracer_outline(globe.tracer, line, LINES, surface);
    assert_true(bake_tracer_look(globe.tracer, line, LINES, seen, NULL));
    lum_thread_end(saved);
    stats_mean *mean = calloc(bake_tracer_surfaces(globe.tracer), sizeof(*mean));
    assert_non_null(mean);
    for (size_t i = 0; i < LINES; ++i) {
        if (surface[i] == BAKE_NO_SURFACE)
            assert_true(seen[i][0] == 0 && seen[i][1] == 0 && seen[i][2] == 0);
        else
            stats_add(&mean[surface[i]], lmg_luminance(seen[i]));
    }
    uint32_t brightest = 0, compared = 0;
    for (uint32_t k = 0; k < bake_tracer_surfaces(globe.tracer); ++k)
        brightest = brightness[k] == 1 && mean[k].n > 1000 ? k : brightest;
    assert_true(brightness[brightest] == 1);
    for (uint32_t k = 0; k < bake_tracer_surfaces(globe.tracer); ++k) {
        if (mean[k].n < 500 || k == brightest)
            continue;
        const double y = mean[k].mean / mean[brightest].mean,
                     se = hypot(stats_error(&mean[k]) / mean[brightest].mean, y * stats_error(&mean[brightest]) / mean[brightest].mean);
        print_message("surface %u: brightness %.4f, seen %.4f +- %.4f\n", k, (double)brightness[k], y, se);
        assert_true(fabs((double)brightness[k] - y) < 3.5 * se + 0.1 * y + 0.002);
        compared++;
    }
    assert_true(compared > 0);
    free(mean);
    free(line);
    free(seen);
    free(surface);
    free(brightness);
    lmg_looks_destroy(looks);
    bake_ray_list_destroy(list);
    lmg_field_destroy(field);
    globe.tracer->destroy(globe.tracer);
    lum_model_destroy(globe.model);
}

/* The pilot gathers behind the lens and not through opal glass; the same bytes on 1 and 3 threads, and when resumed. */
static void whole_bakes(void **state)
{
    (void)state;
    char path[3][1200], part[1200];
    for (int i = 0; i < 3; ++i)
        snprintf(path[i], sizeof(path[i]), "%s/tests/backward-%d.box.exr", LUMIBOX_BINARY_DIR, i);
    snprintf(part, sizeof(part), "%s/tests/backward.part", LUMIBOX_BINARY_DIR);
    lmg_error err = {{0}};
    counted lens = load("glass-lens"), globe = load("opal-globe");
    bake_options options = {
        .photons = 300000, .whole = 3000000, .seed = 3, .threads = 1, .rays_per_photon = -1, .fit.cells = 60000};
    bake_report report = bake_to(lens.model, &options, path[0]);
    assert_true(report.gathered_rays > 10000);
    options.threads = 3;
    options.checkpoint = part;
    options.keep = true;
    options.photons = 170000;
    bake_to(lens.model, &options, path[1]);
    options.photons = 300000;
    assert_int_equal(bake_part_read(part, &options.resume, &err), LMG_OK);
    bake_to(lens.model, &options, path[1]);
    assert_same_file(path[0], path[1]);
    /* what the pilot chose, asked for */
    bake_options asked = {.photons = 300000, .whole = 3000000, .seed = 3, .fit.cells = 60000};
    report = bake_to(lens.model, &asked, path[2]);
    assert_true(report.gathered_rays == 0);
    asked.rays_per_photon = -1;
    report = bake_to(globe.model, &asked, path[2]);
    print_message("%s\n", report.gather_why);
    assert_true(report.gathered_rays == 0);
    remove(part);
    for (int i = 0; i < 3; ++i)
        remove(path[i]);
    lens.tracer->destroy(lens.tracer);
    lum_model_destroy(lens.model);
    globe.tracer->destroy(globe.tracer);
    lum_model_destroy(globe.model);
}

int main(void)
{
    static char spot[] = "paraboloid-spot", lens[] = "glass-lens", panel[] = "louvred-panel", globe[] = "opal-globe";
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(without_noise),
        cmocka_unit_test(clear_slab),
        cmocka_unit_test(furnace),
        {"cells_of_the_spot", sample_lamp, NULL, NULL, spot},
        {"cells_of_the_lens", sample_lamp, NULL, NULL, lens},
        {"cells_of_the_panel", sample_lamp, NULL, NULL, panel},
        {"cells_of_the_globe", sample_lamp, NULL, NULL, globe},
        cmocka_unit_test(mixture),
        cmocka_unit_test(brightness_of_surfaces),
        cmocka_unit_test(whole_bakes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
