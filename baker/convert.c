/* SPDX-License-Identifier: Apache-2.0 */
/* Conversions: a source run once into an accumulator, or in rounds into a file. */
#include "convert.h"

#include "bake.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Rays that a layout is fitted to, at most: more don't change it. */
static const uint64_t PILOT_MOST = 400000;
static const uint64_t DEFAULT_RAYS = 10000000;
/* Rays kept between source and file: 19 MB. */
static const uint64_t ROUND = 1u << 18;
/* Photons between two looks at options.stop. */
static const uint64_t STRETCH = 1u << 22;
/* Slivers of an opening are thinner than this part of it: radiance at its edge changes by less than a tenth of a cell. */
static const double SLIVER = 2e-3;
/* Cells of a box per ray of a finite source, within these bounds.  A few rays in a cell tell its slopes from noise; where most cells are
 * empty, slopes towards them take radiance from the edges: 3 % at 70 degrees with one ray in two cells, 0.3 % with five in two. */
static const double CELLS_PER_RAY = 0.2;
static const uint64_t CELLS_LEAST = 1000000, CELLS_MOST = 4000000;

static lmg_result stopped(const bake_convert_options *o, lmg_error *err)
{
    return o->stop && *o->stop ? lmg_fail(err, LMG_ERROR_INTERNAL, "interrupted; nothing was written") : LMG_OK;
}

/* Cells of light that is the same all over its rectangle: few places, and fine directions. */
static const uint32_t EVEN[4] = {4, 4, 128, 128};

static lmg_result choose_photons(const bake_source *source, const bake_convert_options *o, uint64_t *photons, lmg_error *err)
{
    *photons = o->rays ? o->rays : source->photons ? source->photons : DEFAULT_RAYS;
    if (source->photons && *photons > source->photons)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%" PRIu64 " rays of a source that has %" PRIu64, *photons, source->photons);
    return LMG_OK;
}

/* An opening's rectangle leaves out the outermost 1e-4 of the light, which coarse slabs catch.  Where the light ends sharply at the
 * bounds that leaves a sliver too thin for the coarse slabs' cells to have an etendue; it goes to the rectangle. */
static void snap_to_bounds(lmg_layout *layout)
{
    lmg_slab *s = &layout->slabs[0];
    if (s->kind != LMG_SLAB_APERTURE)
        return;
    double *const low[2] = {&s->u0, &s->v0}, *const high[2] = {&s->u1, &s->v1};
    const lmg_vec3 axes[2] = {s->a, s->b};
    const lmg_vec3 lo = {layout->bounds_min.x - s->o.x, layout->bounds_min.y - s->o.y, layout->bounds_min.z - s->o.z};
    const lmg_vec3 hi = {layout->bounds_max.x - s->o.x, layout->bounds_max.y - s->o.y, layout->bounds_max.z - s->o.z};
    for (int k = 0; k < 2; ++k) {
        const double a[3] = {axes[k].x, axes[k].y, axes[k].z}, l[3] = {lo.x, lo.y, lo.z}, h[3] = {hi.x, hi.y, hi.z};
        double least = 0, most = 0;
        for (int i = 0; i < 3; ++i) {
            least += fmin(a[i] * l[i], a[i] * h[i]);
            most += fmax(a[i] * l[i], a[i] * h[i]);
        }
        const double width = *high[k] - *low[k];
        if (*low[k] > least && *low[k] - least < SLIVER * width)
            *low[k] = least;
        if (*high[k] < most && most - *high[k] < SLIVER * width)
            *high[k] = most;
    }
}

static lmg_result fit_layout(bake_source *source, const bake_convert_options *o, uint64_t photons, lmg_layout *layout, char why[1024],
                             lmg_error *err)
{
    const bool all = source->photons && photons <= PILOT_MOST;
    const uint64_t count = all ? photons : PILOT_MOST;
    bake_ray_list *list;
    lmg_result result = bake_ray_list_create((size_t)count, &list, err);
    if (result != LMG_OK)
        return result;
    const lmg_sink sink = bake_ray_list_sink(list);
    bake_tally tally = {0};
    result = source->run(source, all ? 0 : BAKE_PILOT_FIRST, count, o->threads, &sink, 1, &tally, err);
    size_t rays = 0;
    const lmg_ray *sorted = bake_ray_list_sorted(list, &rays);
    if (result == LMG_OK)
        result = bake_ray_list_check(list, err);
    if (result == LMG_OK && rays == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "no light leaves it");
    if (result == LMG_OK) {
        lmg_fit_options fit = o->fit;
        fit.struct_size = sizeof(fit);
        fit.bounds_min = source->bounds_min;
        fit.bounds_max = source->bounds_max;
        if (fit.cells == 0 && source->photons) {
            const double cells = CELLS_PER_RAY * (double)photons;
            fit.cells = cells < (double)CELLS_LEAST ? CELLS_LEAST : cells > (double)CELLS_MOST ? CELLS_MOST : (uint64_t)cells;
        }
        /* as many cells as asked for, or as the rays' number says, are shared out as for any light */
        const bool chosen = fit.cells || fit.resolution[0] || fit.resolution[1] || fit.resolution[2] || fit.resolution[3];
        if (source->even && !chosen)
            memcpy(fit.resolution, EVEN, sizeof(EVEN));
        result = lmg_layout_fit(sorted, rays, &fit, layout, why, err);
        if (result == LMG_OK)
            snap_to_bounds(layout);
    }
    bake_ray_list_destroy(list);
    return result;
}

/* All photons into one sink, with looks at options.stop. */
static lmg_result run_into(bake_source *source, const bake_convert_options *o, uint64_t photons, lmg_sink sink, bake_tally *tally,
                           lmg_error *err)
{
    lmg_result result = LMG_OK;
    for (uint64_t at = 0; result == LMG_OK && at < photons; at += STRETCH) {
        result = stopped(o, err);
        if (result == LMG_OK)
            result = source->run(source, at, photons - at < STRETCH ? photons - at : STRETCH, o->threads, &sink, 1, tally, err);
    }
    return result;
}

lmg_result bake_convert_to_field(bake_source *source, const bake_convert_options *o, lmg_field **out, bake_conversion *report,
                                 lmg_error *err)
{
    *out = NULL;
    *report = (bake_conversion){0};
    const double began = bake_clock();
    uint64_t photons;
    lmg_layout layout;
    lmg_accumulator *accumulator = NULL;
    lmg_result result = choose_photons(source, o, &photons, err);
    if (result == LMG_OK)
        result = fit_layout(source, o, photons, &layout, report->layout_why, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &accumulator, err);
    bake_tally tally = {0};
    if (result == LMG_OK)
        result = run_into(source, o, photons, lmg_accumulator_sink(accumulator), &tally, err);
    if (result == LMG_OK) {
        const double unit = source->flux / (double)photons, n = (double)photons;
        const lmg_deposit_totals totals = lmg_accumulator_totals(accumulator);
        const double lost = tally.lost + (double)totals.refused;
        const lmg_ledger ledger = {
            .photons = photons,
            .emitted = source->photons ? tally.emitted * unit : source->flux,
            .emitted_se = source->flux_se,
            .absorbed = tally.absorbed * unit,
            .absorbed_se = source->flux * bake_share_error(tally.absorbed, n),
            .lost = lost * unit,
            .lost_se = source->flux * bake_share_error(lost, n),
        };
        result = lmg_field_reconstruct(accumulator, unit, &ledger, out, err);
        if (result == LMG_OK) {
            const lmg_ledger done = lmg_field_ledger(*out);
            report->photons = photons;
            report->rays = totals.rays + totals.unplaced + totals.refused;
            report->flux_in = tally.escaped * unit;
            report->flux_out = done.stored;
            report->out_se = done.stored_se;
            report->residual = done.residual;
            report->refused = totals.refused;
        }
    }
    lmg_accumulator_destroy(accumulator);
    report->seconds = bake_clock() - began;
    return result;
}

/* One round: rays of photons first .. in the order of their numbers into the file. */
static lmg_result write_round(bake_source *source, const bake_convert_options *o, uint64_t first, uint64_t count, double unit,
                              lum_ray_writer *writer, bake_tally *tally, bake_conversion *report, lmg_error *err)
{
    bake_ray_list *list;
    lmg_result result = bake_ray_list_create((size_t)count, &list, err);
    if (result != LMG_OK)
        return result;
    const lmg_sink sink = bake_ray_list_sink(list);
    result = source->run(source, first, count, o->threads, &sink, 1, tally, err);
    size_t rays = 0;
    const lmg_ray *sorted = bake_ray_list_sorted(list, &rays);
    if (result == LMG_OK)
        result = bake_ray_list_check(list, err);
    if (result == LMG_OK)
        result = lum_ray_writer_append(writer, sorted, rays, unit, err);
    report->rays += rays;
    bake_ray_list_destroy(list);
    return result;
}

lmg_result bake_convert_to_rays(bake_source *source, const bake_convert_options *o, const char *path,
                                const lum_ray_writer_options *options, bake_conversion *report, lmg_error *err)
{
    *report = (bake_conversion){0};
    const double began = bake_clock();
    uint64_t photons;
    lum_ray_writer *writer = NULL;
    lmg_result result = choose_photons(source, o, &photons, err);
    if (result == LMG_OK)
        result = lum_ray_writer_create(path, options, &writer, err);
    if (result != LMG_OK)
        return result;
    const double unit = source->flux / (double)photons;
    bake_tally tally = {0};
    for (uint64_t at = 0; result == LMG_OK && at < photons; at += ROUND) {
        result = stopped(o, err);
        if (result == LMG_OK)
            result = write_round(source, o, at, photons - at < ROUND ? photons - at : ROUND, unit, writer, &tally, report, err);
    }
    if (result == LMG_OK && report->rays == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "no light leaves it");
    if (result == LMG_OK)
        result = lum_ray_writer_finish(writer, &report->flux_out, err);
    else
        lum_ray_writer_abandon(writer);
    report->photons = photons;
    report->flux_in = tally.escaped * unit;
    report->out_se = source->photons ? 0 : source->flux * bake_light_error(&tally, tally.escaped);
    report->seconds = bake_clock() - began;
    return result;
}

/* Rays as a photometer on a sphere meets them: with the direction of the place where they pass it. */
typedef struct near_sphere {
    lmg_sink to;
    lmg_vec3 centre;
    double radius;
} near_sphere;

static void consume_near(void *self, const lmg_ray *rays, size_t count)
{
    const near_sphere *s = self;
    enum { AT_ONCE = 64 };
    lmg_ray moved[AT_ONCE];
    while (count > 0) {
        const size_t n = count < AT_ONCE ? count : AT_ONCE;
        for (size_t i = 0; i < n; ++i) {
            const lmg_vec3 d = rays[i].direction;
            const lmg_vec3 o = {rays[i].origin.x - s->centre.x, rays[i].origin.y - s->centre.y, rays[i].origin.z - s->centre.z};
            const double b = o.x * d.x + o.y * d.y + o.z * d.z, c = o.x * o.x + o.y * o.y + o.z * o.z - s->radius * s->radius;
            const double t = sqrt(b * b - c) - b; /* the sphere holds all origins: c < 0, and the way out is ahead */
            moved[i] = rays[i];
            moved[i].direction = (lmg_vec3){(o.x + t * d.x) / s->radius, (o.y + t * d.y) / s->radius, (o.z + t * d.z) / s->radius};
        }
        s->to.consume(s->to.self, moved, n);
        rays += n;
        count -= n;
    }
}

lmg_result bake_convert_to_photometry(bake_source *source, const bake_convert_options *o, lum_photometry **out,
                                      bake_conversion *report, lmg_error *err)
{
    *out = NULL;
    *report = (bake_conversion){0};
    const double began = bake_clock();
    uint64_t photons;
    bake_goniometer *goniometer = NULL;
    double *se = NULL;
    bake_goniometer_options grid = o->grid;
    grid.bounds_min = source->bounds_min;
    grid.bounds_max = source->bounds_max;
    lmg_result result = choose_photons(source, o, &photons, err);
    if (result == LMG_OK)
        result = bake_goniometer_create(&grid, &goniometer, err);
    bake_tally tally = {0};
    near_sphere sphere = {.radius = o->near};
    if (result == LMG_OK) {
        const lmg_vec3 lo = source->bounds_min, hi = source->bounds_max, e = {hi.x - lo.x, hi.y - lo.y, hi.z - lo.z};
        const double radius = 0.5 * sqrt(e.x * e.x + e.y * e.y + e.z * e.z);
        sphere.to = bake_goniometer_sink(goniometer);
        sphere.centre = (lmg_vec3){0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), 0.5 * (lo.z + hi.z)};
        if (o->near > 0 && !(o->near > radius))
            result = lmg_fail(err, LMG_ERROR_ARGUMENT, "a photometer at %g m from the centre isn't outside the luminaire (radius %.4g m)",
                              o->near, radius);
    }
    if (result == LMG_OK)
        result = run_into(source, o, photons, o->near > 0 ? (lmg_sink){.self = &sphere, .consume = consume_near} : sphere.to, &tally, err);
    const double unit = result == LMG_OK ? source->flux / (double)photons : 0;
    if (result == LMG_OK)
        result = bake_goniometer_read(goniometer, unit, out, &se, err);
    lum_photometry_measures measures;
    if (result == LMG_OK)
        result = lum_photometry_measure(*out, &measures, err);
    if (result == LMG_OK) {
        double signal = 0, noise = 0;
        for (size_t i = 0; i < (size_t)(*out)->h_count * (*out)->v_count; ++i) {
            const double solid = sin((*out)->v[i % (*out)->v_count] * 3.14159265358979323846 / 180); /* the poles have none */
            signal += solid * (*out)->intensity[i] * (*out)->intensity[i];
            noise += solid * se[i] * se[i];
        }
        report->photons = photons;
        report->rays = (uint64_t)llround(tally.escaped);
        report->flux_in = tally.escaped * unit;
        report->flux_out = measures.flux;
        report->out_se = source->flux * bake_light_error(&tally, tally.escaped);
        report->noise = sqrt(noise / signal);
    } else {
        lum_photometry_destroy(*out);
        *out = NULL;
    }
    free(se);
    bake_goniometer_destroy(goniometer);
    report->seconds = bake_clock() - began;
    return result;
}
