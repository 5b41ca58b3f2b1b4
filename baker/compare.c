/* SPDX-License-Identifier: Apache-2.0 */
/* Comparison of two sources by the receivers that both feed: measuring.  What is computed from the readings: compare_measures.c. */
#include "compare_inside.h"

#include "bake.h"
#include "receiver.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t DEFAULT_PHOTONS = 20000000;
static const double PI = 3.14159265358979323846;
/* Photons that main axis and size are taken from. */
static const uint64_t PILOT_PHOTONS = 50000;

/* ----------------------------------------------------------------------------------------------------------- instrument */

/* Views of the luminance pictures: from the main axis, and 30 and 60 degrees off it on two sides. */
static const struct {
    double tilt, turn; /* degrees */
} VIEWS[BAKE_VIEWS] = {{0, 0}, {30, 0}, {30, 90}, {60, 0}, {60, 90}};
/* Half-angle of the cone of a luminance picture, degrees: narrow enough for the picture to be sharp at a luminaire's own size, wide
 * enough to catch one ray in 130 of a Lambertian source. */
static const double CONE = 5;
/* Radii of the spheres, sizes: 1, 1.5, ... 50, so that every convention for where the far field begins lies between two of them. */
static const double RADII[BAKE_RADII] = {1, 1.5, 2, 3, 5, 7, 10, 15, 25, 50};

static lmg_vec3 add_scaled(lmg_vec3 a, double s, lmg_vec3 b)
{
    return (lmg_vec3){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}

static lmg_vec3 cross(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

void set_up_instrument(instrument *in, lmg_vec3 lo, lmg_vec3 hi, lmg_vec3 axis, double size, const double *distances, size_t count)
{
    in->plane_count = count;
    for (size_t i = 0; i < count; ++i) {
        in->planes[i] = bake_measuring_rectangle(lo, hi, axis, size, distances[i] * size, PIXELS);
        in->planes[i].colour = true;
    }
    in->far_field = (bake_sphere){.radius = INFINITY, .axis = axis, .rings = RINGS, .sectors = SECTORS, .colour = true};
    in->profile = (bake_sphere){.radius = INFINITY, .axis = axis, .rings = PROFILE_RINGS, .sectors = PROFILE_SECTORS, .equal_angles = true};
    in->nadir = (bake_sphere){.radius = INFINITY, .axis = {0, -1, 0}, .rings = ZONES, .sectors = 1, .equal_angles = true, .colour = true};
    const lmg_vec3 centre = {0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), 0.5 * (lo.z + hi.z)};
    const lmg_vec3 extent = {hi.x - lo.x, hi.y - lo.y, hi.z - lo.z};
    const double diagonal = sqrt(extent.x * extent.x + extent.y * extent.y + extent.z * extent.z);
    for (int i = 0; i < BAKE_RADII; ++i)
        in->spheres[i] = (bake_sphere){.centre = centre, .radius = RADII[i] * size, .axis = axis, .rings = NEAR_RINGS,
                                       .sectors = NEAR_SECTORS, .equal_angles = true};
    const lmg_vec3 first = bake_measuring_rectangle(lo, hi, axis, 1, 1, 1).a, second = cross(axis, first);
    for (int i = 0; i < BAKE_VIEWS; ++i) {
        const double tilt = VIEWS[i].tilt * PI / 180, turn = VIEWS[i].turn * PI / 180;
        const lmg_vec3 aside = add_scaled((lmg_vec3){cos(turn) * first.x, cos(turn) * first.y, cos(turn) * first.z}, sin(turn), second);
        const lmg_vec3 n = add_scaled((lmg_vec3){cos(tilt) * axis.x, cos(tilt) * axis.y, cos(tilt) * axis.z}, sin(tilt), aside);
        const lmg_vec3 b = cross(axis, aside); /* perpendicular to n as well: n lies in the plane of axis and aside */
        in->pictures[i] = (bake_picture){.across = {.centre = centre, .a = cross(b, n), .b = b, .width = diagonal, .height = diagonal,
                                                    .nx = PIXELS, .ny = PIXELS},
                                         .half_angle = CONE * PI / 180};
    }
}

static void destroy(receivers *r)
{
    for (size_t i = 0; i < r->count; ++i)
        bake_receiver_destroy(r->list[i]);
    r->count = 0;
}

static lmg_result create_one(const instrument *in, size_t i, bake_receiver **out, lmg_error *err)
{
    if (i < in->plane_count)
        return bake_illuminance_create(&in->planes[i], out, err);
    i -= in->plane_count;
    if (i == FAR_FIELD)
        return bake_sphere_create(&in->far_field, out, err);
    if (i == PROFILE)
        return bake_sphere_create(&in->profile, out, err);
    if (i == NADIR)
        return bake_sphere_create(&in->nadir, out, err);
    if (i < PICTURES)
        return bake_sphere_create(&in->spheres[i - SPHERES], out, err);
    return bake_picture_create(&in->pictures[i - PICTURES], out, err);
}

/* The first `count` receivers of the instrument. */
static lmg_result create(receivers *r, const instrument *in, size_t count, lmg_error *err)
{
    lmg_result result = LMG_OK;
    r->count = 0;
    while (result == LMG_OK && r->count < count) {
        result = create_one(in, r->count, &r->list[r->count], err);
        r->count += result == LMG_OK;
    }
    if (result != LMG_OK)
        destroy(r);
    return result;
}

static size_t sinks_of(const receivers *r, lmg_sink *sinks)
{
    for (size_t i = 0; i < r->count; ++i)
        sinks[i] = bake_receiver_sink(r->list[i]);
    return r->count;
}

/* -------------------------------------------------------------------------------------------------------------- pilots */

/* A few rays of a source, kept. */
static lmg_result run_pilot(bake_source *source, unsigned threads, bake_ray_list **list, const lmg_ray **rays, size_t *count,
                            lmg_error *err)
{
    lmg_result result = bake_ray_list_create(PILOT_PHOTONS, list, err);
    if (result != LMG_OK)
        return result;
    const lmg_sink sink = bake_ray_list_sink(*list);
    bake_tally tally = {0};
    result = source->run(source, BAKE_PILOT_FIRST, PILOT_PHOTONS, threads, &sink, 1, &tally, err);
    *rays = bake_ray_list_sorted(*list, count);
    if (result == LMG_OK)
        result = bake_ray_list_check(*list, err);
    if (result == LMG_OK && *count == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "no light leaves the luminaire: nothing to compare");
    if (result != LMG_OK) {
        bake_ray_list_destroy(*list);
        *list = NULL;
    }
    return result;
}

lmg_result source_main_axis(bake_source *source, unsigned threads, lmg_vec3 *axis, lmg_error *err)
{
    bake_ray_list *list;
    const lmg_ray *rays;
    size_t count;
    const lmg_result result = run_pilot(source, threads, &list, &rays, &count, err);
    if (result != LMG_OK)
        return result;
    *axis = bake_main_axis(rays, count);
    bake_ray_list_destroy(list);
    return LMG_OK;
}

lmg_result bake_source_size(bake_source *source, unsigned threads, double *size, lmg_error *err)
{
    bake_ray_list *list;
    const lmg_ray *rays;
    size_t count;
    lmg_result result = run_pilot(source, threads, &list, &rays, &count, err);
    if (result != LMG_OK)
        return result;
    const lmg_fit_options fit = {.struct_size = sizeof(fit), .bounds_min = source->bounds_min, .bounds_max = source->bounds_max};
    lmg_layout layout;
    result = lmg_layout_fit(rays, count, &fit, &layout, NULL, err);
    if (result == LMG_OK)
        *size = layout.size;
    bake_ray_list_destroy(list);
    return result;
}


static double least(double a, double b)
{
    return a < b ? a : b;
}

static double most(double a, double b)
{
    return a > b ? a : b;
}

/* The box about the source's bounds after a motion. */
static void moved_bounds(const bake_source *s, const bake_motion *motion, lmg_vec3 *lo, lmg_vec3 *hi)
{
    *lo = (lmg_vec3){INFINITY, INFINITY, INFINITY};
    *hi = (lmg_vec3){-INFINITY, -INFINITY, -INFINITY};
    for (int corner = 0; corner < 8; ++corner) {
        const lmg_vec3 c = {corner & 1 ? s->bounds_max.x : s->bounds_min.x, corner & 2 ? s->bounds_max.y : s->bounds_min.y,
                            corner & 4 ? s->bounds_max.z : s->bounds_min.z};
        const lmg_vec3 p = bake_motion_point(motion, c);
        *lo = (lmg_vec3){least(lo->x, p.x), least(lo->y, p.y), least(lo->z, p.z)};
        *hi = (lmg_vec3){most(hi->x, p.x), most(hi->y, p.y), most(hi->z, p.z)};
    }
}

const bake_motion BAKE_NO_MOTION = {.rotation = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

/* Planes stand clear of both, before and after the motion. */
static void set_up_for(instrument *in, const bake_source *a, const bake_motion *motion, const bake_source *b, lmg_vec3 axis,
                       const bake_compare_options *o)
{
    lmg_vec3 lo, hi, lo_moved, hi_moved;
    moved_bounds(a, &BAKE_NO_MOTION, &lo, &hi);
    moved_bounds(a, motion, &lo_moved, &hi_moved);
    lo = (lmg_vec3){least(least(lo.x, lo_moved.x), b->bounds_min.x), least(least(lo.y, lo_moved.y), b->bounds_min.y),
                    least(least(lo.z, lo_moved.z), b->bounds_min.z)};
    hi = (lmg_vec3){most(most(hi.x, hi_moved.x), b->bounds_max.x), most(most(hi.y, hi_moved.y), b->bounds_max.y),
                    most(most(hi.z, hi_moved.z), b->bounds_max.z)};
    set_up_instrument(in, lo, hi, axis, o->size, o->distances, o->distance_count);
}

/* ----------------------------------------------------------------------------------------------------------- measuring */

static void read_into(reading *to, int block, const bake_receiver *r, double lumens_per_unit)
{
    for (size_t i = 0; i < to->count; ++i) {
        double se;
        to->value[block * to->count + i] = bake_receiver_reading(r, i, lumens_per_unit, &se);
        to->variance[i] += se * se / (BLOCKS * BLOCKS);
        if (to->rgb)
            bake_receiver_colour(r, i, lumens_per_unit, &to->rgb[3 * (block * to->count + i)]);
    }
}

static lmg_result make_readings(measured *m, const receivers *r, lmg_error *err)
{
    for (size_t i = 0; i < r->count; ++i) {
        reading *x = &m->of[i];
        x->count = bake_receiver_count(r->list[i]);
        x->value = calloc(BLOCKS * x->count, sizeof(*x->value));
        x->variance = calloc(x->count, sizeof(*x->variance));
        if (bake_receiver_has_colour(r->list[i]))
            x->rgb = calloc(3 * BLOCKS * x->count, sizeof(*x->rgb));
        m->count = i + 1;
        if (!x->value || !x->variance || (bake_receiver_has_colour(r->list[i]) && !x->rgb))
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the comparison");
    }
    return LMG_OK;
}

void measured_release(measured *m)
{
    for (size_t i = 0; i < m->count; ++i) {
        free(m->of[i].value);
        free(m->of[i].variance);
        free(m->of[i].rgb);
    }
    m->count = 0;
}

lmg_result measure_source(bake_source *source, const instrument *in, size_t count, const bake_motion *motion, uint64_t first,
                          uint64_t photons, unsigned threads, measured *out, measured *unmoved, bake_tally *tally, lmg_error *err)
{
    lmg_result result = LMG_OK;
    /* A ray file has so many rays and no more. */
    const uint64_t has = source->photons, wanted = has && has < photons ? has : photons, each = (wanted + BLOCKS - 1) / BLOCKS;
    const double lumens_per_unit = source->flux * BLOCKS / (double)wanted;
    const bool moving = !bake_motion_is_identity(motion);
    for (int b = 0; result == LMG_OK && b < BLOCKS; ++b) {
        receivers here = {0}, there = {0};
        result = create(&here, in, count, err);
        if (result == LMG_OK && unmoved)
            result = create(&there, in, in->plane_count + 1, err);
        if (result == LMG_OK && b == 0)
            result = make_readings(out, &here, err);
        if (result == LMG_OK && b == 0 && unmoved)
            result = make_readings(unmoved, &there, err);
        if (result == LMG_OK) {
            lmg_sink sinks[2 * MAX_RECEIVERS], direct[MAX_RECEIVERS + 1];
            bake_moved_sink moved = {.motion = *motion, .sinks = sinks, .count = sinks_of(&here, sinks)};
            size_t direct_count = sinks_of(moving ? &there : &here, direct);
            if (moving)
                direct[direct_count++] = bake_moved_sink_of(&moved);
            const uint64_t done = (uint64_t)b * each, count_here = done >= wanted ? 0 : wanted - done < each ? wanted - done : each;
            if (count_here > 0)
                result = source->run(source, first + done, count_here, threads, direct, direct_count, tally, err);
        }
        for (size_t i = 0; result == LMG_OK && i < here.count; ++i)
            read_into(&out->of[i], b, here.list[i], lumens_per_unit);
        for (size_t i = 0; result == LMG_OK && i < there.count; ++i)
            read_into(&unmoved->of[i], b, there.list[i], lumens_per_unit);
        destroy(&here);
        destroy(&there);
    }
    return result;
}

/* Whether the motion makes A more like B: the sum of the squared differences of the planes and the far field, by a tenth of the
 * photons.  What the foci say is no more than a proposal: along a narrow beam they are hardly determined. */
static lmg_result is_better_moved(bake_source *a, bake_source *b, const instrument *in, const bake_motion *motion, uint64_t photons,
                                  unsigned threads, bool *better, lmg_error *err)
{
    measured moved = {0}, unmoved = {0}, other = {0};
    bake_tally tally = {0};
    const size_t count = in->plane_count + 1;
    lmg_result result = measure_source(a, in, count, motion, BAKE_PILOT_FIRST, photons, threads, &moved, &unmoved, &tally, err);
    if (result == LMG_OK)
        result = measure_source(b, in, count, &BAKE_NO_MOTION, BAKE_PILOT_FIRST, photons, threads, &other, NULL, &tally, err);
    if (result == LMG_OK) {
        double sum[2] = {0, 0}, variance[2] = {0, 0};
        for (size_t i = 0; i < count; ++i)
            for (int m = 0; m < 2; ++m) {
                const bake_difference d = differ(m ? &moved.of[i] : &unmoved.of[i], &other.of[i]);
                sum[m] += d.rms * fabs(d.rms);
                variance[m] += 4 * d.rms * d.rms * d.standard_error * d.standard_error;
            }
        *better = sum[0] - sum[1] > 3 * sqrt(variance[0] + variance[1]);
    }
    measured_release(&moved);
    measured_release(&unmoved);
    measured_release(&other);
    return result;
}

static lmg_result run(bake_source *const sources[2], const bake_compare_options *options, const bake_motion *motion, uint64_t photons,
                      measured sides[2], measured *unmoved, bake_comparison *out, lmg_error *err)
{
    instrument in = {0};
    set_up_for(&in, sources[0], motion, sources[1], out->axis, options);
    out->plane_count = in.plane_count;
    for (size_t i = 0; i < in.plane_count; ++i) {
        out->planes[i].sizes = options->distances[i];
        out->planes[i].distance = options->distances[i] * options->size;
        out->planes[i].side = in.planes[i].width;
    }
    for (int i = 0; i < BAKE_VIEWS; ++i) {
        out->views[i].tilt = VIEWS[i].tilt;
        out->views[i].turn = VIEWS[i].turn;
        out->views[i].width = in.pictures[i].across.width;
    }
    memcpy(out->radii, RADII, sizeof(RADII));
    lmg_result result = LMG_OK;
    for (int s = 0; result == LMG_OK && s < 2; ++s) {
        const double began = bake_clock();
        bake_tally *t = &out->tally[s];
        const bool moving = s == 0 && !bake_motion_is_identity(motion);
        result = measure_source(sources[s], &in, in.plane_count + RECEIVERS, s == 0 ? motion : &BAKE_NO_MOTION, 0, photons, options->threads,
                         &sides[s], moving ? unmoved : NULL, t, err);
        out->seconds[s] = bake_clock() - began;
        const double share = t->escaped / (double)t->photons;
        out->flux[s] = sources[s]->flux * share;
        out->flux_se[s] = hypot(sources[s]->flux * bake_light_error(t, t->escaped), sources[s]->flux_se * share);
    }
    return result;
}

lmg_result bake_compare(bake_source *a, bake_source *b, const bake_compare_options *options, bake_comparison *out, lmg_error *err)
{
    memset(out, 0, sizeof(*out));
    if (options->distance_count < 1 || options->distance_count > BAKE_MAX_DISTANCES || !(options->size > 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a comparison needs a size and 1 to %d distances", BAKE_MAX_DISTANCES);
    for (size_t i = 0; i < options->distance_count; ++i)
        if (!(options->distances[i] > 0))
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "a distance of %g sizes isn't outside the luminaire", options->distances[i]);
    const uint64_t photons = options->photons ? options->photons : DEFAULT_PHOTONS;
    out->size = options->size;
    lmg_result result = source_main_axis(b, options->threads, &out->axis, err);

    /* A hundredth of the rays for the alignment, but enough that it can tell a degree. */
    const uint64_t pilot = photons / 10 > 400000 ? 400000 : photons / 10 < 80000 ? 80000 : photons / 10;
    if (result == LMG_OK)
        result = bake_align(a, b, pilot, options->threads, &out->alignment, err);
    bake_motion motion = BAKE_NO_MOTION;
    if (result == LMG_OK && options->align && !bake_motion_is_identity(&out->alignment.motion)) {
        instrument in = {0};
        set_up_for(&in, a, &out->alignment.motion, b, out->axis, options);
        result = is_better_moved(a, b, &in, &out->alignment.motion, pilot, options->threads, &out->moved, err);
        if (out->moved)
            motion = out->alignment.motion;
    }
    measured sides[2] = {{0}, {0}}, unmoved = {0};
    bake_source *const sources[2] = {a, b};
    if (result == LMG_OK)
        result = run(sources, options, &motion, photons, sides, &unmoved, out, err);
    if (result == LMG_OK)
        result = evaluate(sides, unmoved.count > 0 ? &unmoved : &sides[0], out, err);
    measured_release(&sides[0]);
    measured_release(&sides[1]);
    measured_release(&unmoved);
    return result;
}
