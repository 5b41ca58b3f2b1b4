/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fits a layout to pilot rays: one opening, perhaps with a slab for a source that is seen directly, or six faces, each as
 * layout_search.c finds it, and coarse slabs for what passes beside.  Everything is judged by layout_judge.h.
 */
#include "field.h"
#include "geometry.h"
#include "layout_search.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Share of the flux that may pass beside the opening (or backwards) for a luminaire to be one that shines through an opening. */
static const double APERTURE_REST = 0.02;
static const uint64_t DEFAULT_CELLS = 4000000;
/* Six faces have to be this much better than one opening, which has the simpler cells: one rectangle, equal etendue. */
static const double CUBE_GAIN = 0.8;
/* A focus cuts into the cells below it, which makes them slower to measure: it has to gain this much. */
static const double FOCUS_GAIN = 0.95;

/* A cube slab through the middle of the bounds that holds every line of its class through the bounds. */
static lmg_slab catch_all(int c, lmg_vec3 lo, lmg_vec3 hi, uint32_t resolution)
{
    lmg_slab s = {.kind = LMG_SLAB_CUBE, .distance = INFINITY, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
    lmg_class_frame(c, &s.a, &s.b, &s.n);
    s.o = v_scale(0.5, v_add(lo, hi));
    lmg_vec3 half = v_scale(0.5, v_sub(hi, lo));
    /* at slopes up to 1 a line strays from where it is in the bounds by at most half their depth */
    double depth = fabs(v_dot(half, s.n)), margin = 1e-6 * v_length(half);
    s.u1 = fabs(v_dot(half, s.a)) + depth + margin;
    s.v1 = fabs(v_dot(half, s.b)) + depth + margin;
    s.u0 = -s.u1;
    s.v0 = -s.v1;
    s.nu = s.nv = s.ns = s.nt = resolution;
    return s;
}

static void say(char *report, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 2, 3)))
#endif
    ;

static void say(char *report, const char *format, ...)
{
    if (!report)
        return;
    size_t used = strlen(report);
    va_list args;
    va_start(args, format);
    vsnprintf(report + used, 1024 - used, format, args);
    va_end(args);
}

static void describe(char *report, const lmg_pilot *pl, const lmg_choice *c)
{
    lmg_slab slabs[LMG_CHOICE_SLABS];
    uint32_t n = lmg_choice_slabs(pl, c, slabs);
    const lmg_slab *main = &slabs[n - 1], *focus = slabs, *window = c->window ? main - 1 : NULL;
    if (c->focus) {
        const lmg_vec3 at = v_fma(v_fma(focus->o, 0.5 * (focus->u0 + focus->u1), focus->a), 0.5 * (focus->v0 + focus->v1), focus->b);
        say(report, "focus: (u,v) %.4g x %.4g m around %.4g %.4g %.4g m, %u x %u x %u x %u cells\n", focus->u1 - focus->u0, focus->v1 - focus->v0,
            at.x, at.y, at.z, focus->nu, focus->nv, focus->ns, focus->nt);
    }
    say(report, "%s: (u,v) %.4g x %.4g m at %.4g m, %u x %u x %u x %u cells", lmg_class_name(c->class), main->u1 - main->u0, main->v1 - main->v0,
        c->depth, main->nu, main->nv, main->ns, main->nt);
    if (window)
        say(report, "; beam window s %.3g..%.3g t %.3g..%.3g, %u x %u x %u x %u", window->s0, window->s1, window->t0, window->t1, window->nu,
            window->nv, window->ns, window->nt);
    say(report, "\n");
}

static void tell_errors(char *report, const char *what, lmg_verdict v)
{
    say(report, "%sillumination %.2g %%, far field %.2g %%, radiance %.2g %%\n", what, 100 * sqrt(v.illuminance), 100 * sqrt(v.intensity),
        100 * sqrt(fmax(v.radiance, 0)));
}

/* Cuts a focus in as many cells as radiance asks for: four times as many only if they keep so much more of the light's square. */
static double cut_focus(lmg_judge *judge, lmg_slab *focus, double most)
{
    static const double BIASES[] = {0.25, 1, 4}, WORTH = 0.0005, LEAST = 200;
    double error = INFINITY, cells = 0;
    lmg_slab kept = *focus;
    for (double n = LEAST; n <= most; n *= 4) {
        double worth = cells > 0 ? WORTH / LMG_GOOD_RADIANCE / LMG_GOOD_RADIANCE : 0;
        for (size_t k = 0; k < sizeof BIASES / sizeof *BIASES; k++) {
            lmg_focus_cut(focus, n, BIASES[k]);
            const lmg_verdict v = lmg_judge_slabs(judge, focus, 1, true, error - worth);
            if (!(v.error < error - worth))
                continue;
            worth = 0;
            error = v.error;
            kept = *focus;
            cells = n;
        }
        if (cells < n)
            break;
    }
    *focus = kept;
    return cells;
}

/* One opening, without and with a focus, which is kept if it is worth it. */
static lmg_verdict search_opening(lmg_pilot *pl, lmg_judge *judge, lmg_choice *opening, lmg_slab *focus)
{
    static const double SHARE = 0.2, LEAST_REST = 0.01;
    const lmg_choice plain = *opening;
    lmg_verdict without = lmg_choice_search(pl, judge, opening);
    if (plain.fixed || !lmg_focus_find(pl, opening->class, opening->spread, focus))
        return without;
    double rest = 0;
    for (size_t i = 0; i < pl->count; i++) {
        double unused[4];
        pl->taken[i] = lmg_slab_coordinates(focus, pl->origin[i], pl->direction[i], unused);
        rest += !pl->taken[i] && v_dot(pl->direction[i], focus->n) > 0 ? pl->flux[i] / pl->total : 0;
    }
    if (rest < LEAST_REST) /* the focus is the opening */
        return without;
    const double square = lmg_judge_square(judge);
    lmg_choice with = plain;
    with.focus = focus;
    with.cells -= cut_focus(judge, focus, SHARE * plain.cells);
    lmg_slab slabs[LMG_CHOICE_SLABS];
    lmg_choice_search(pl, judge, &with);
    lmg_judge_set_square(judge, fmax(square, lmg_judge_square(judge)));
    const lmg_verdict v = lmg_judge_slabs(judge, slabs, lmg_choice_slabs(pl, &with, slabs), false, INFINITY);
    without = lmg_judge_slabs(judge, slabs, lmg_choice_slabs(pl, opening, slabs), false, INFINITY);
    if (!lmg_better(v, without, FOCUS_GAIN, LMG_LIKELY))
        return without;
    *opening = with;
    return v;
}

lmg_result lmg_layout_fit(const lmg_ray *rays, size_t count, const lmg_fit_options *options, lmg_layout *out, char report[1024],
                          lmg_error *err)
{
    if (report)
        report[0] = 0;
    if (!options || !out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: no options or no place for the result");
    *out = (lmg_layout){0};
    if (options->struct_size != sizeof *options)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: struct_size is %zu, this library's is %zu", options->struct_size, sizeof *options);
    if (!rays || !count)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: no pilot rays to fit to");
    lmg_vec3 lo = options->bounds_min, hi = options->bounds_max;
    double diagonal = v_length(v_sub(hi, lo));
    if (!v_finite(lo) || !v_finite(hi) || !(lo.x <= hi.x && lo.y <= hi.y && lo.z <= hi.z) || !(diagonal > 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the bounds [%g %g %g] to [%g %g %g] m are empty", lo.x, lo.y, lo.z, hi.x, hi.y, hi.z);
    if ((unsigned)options->choice > LMG_LAYOUT_APERTURE)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: unknown choice %d", (int)options->choice);
    if (options->channels != 0 && options->channels != 1 && options->channels != 3)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %u channels; 1 or 3 are possible", options->channels);
    if (!(options->photons >= 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %g photons; their number can't be negative", options->photons);
    if (!(options->distance >= 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the distance %g m must be positive", options->distance);
    double cells = options->cells ? (double)options->cells : (double)DEFAULT_CELLS;
    if (cells > 0x1p32)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %.3g cells; 2^32 are possible", cells);
    for (int k = 0; k < 4; k++)
        if (options->resolution[k] > 65535)
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %u cells along %c; 65535 are possible", options->resolution[k], "uvst"[k]);

    /* Flat bounds (a bare disc) get a thickness, so that lines in their plane have a way out and rounding doesn't put rays beside them. */
    double pad = 1e-6 * diagonal;
    lmg_pilot pl = {.lo = v_sub(lo, (lmg_vec3){pad, pad, pad}), .hi = v_add(hi, (lmg_vec3){pad, pad, pad})};
    lmg_judge *judge = NULL;
    lmg_slab focus;
    lmg_result r = lmg_pilot_create(&pl, rays, count, err);
    if (r != LMG_OK) {
        lmg_pilot_destroy(&pl);
        return r;
    }
    pl.photons = options->photons;
    float colour[3];
    bool grey = lmg_one_colour(rays, count, colour);
    out->channels = options->channels ? options->channels : grey ? 1 : 3;
    memcpy(out->colour, colour, sizeof colour);
    out->bounds_min = pl.lo;
    out->bounds_max = pl.hi;

    /* the axis that most light goes along, and how much goes the other way */
    double along[6] = {0}, forward[6] = {0}, class_flux[6] = {0};
    for (size_t i = 0; i < pl.count; i++) {
        class_flux[pl.class[i]] += pl.flux[i];
        for (int c = 0; c < 6; c++) {
            double dn = v_axis(pl.direction[i], c / 2) * (c % 2 ? -1 : 1);
            if (dn > 0) {
                along[c] += dn * pl.flux[i];
                forward[c] += pl.flux[i];
            }
        }
    }
    int main_class = 0;
    for (int c = 1; c < 6; c++)
        if (along[c] > along[main_class])
            main_class = c;

    /* size: provisional for the planes; the largest face of the light's box */
    lmg_vec3 extent = v_sub(pl.light_hi, pl.light_lo);
    double xy = hypot(extent.x, extent.y), yz = hypot(extent.y, extent.z), zx = hypot(extent.z, extent.x);
    double cube_size = fmax(fmax(xy, yz), fmax(zx, 1e-6 * diagonal)), aperture_size = main_class / 2 == 0 ? yz : main_class / 2 == 1 ? zx : xy;
    aperture_size = fmax(aperture_size, 1e-6 * diagonal);
    bool try_aperture = options->choice == LMG_LAYOUT_APERTURE ||
                        (options->choice == LMG_LAYOUT_AUTO && forward[main_class] >= (1 - APERTURE_REST) * pl.total);
    bool try_cube = options->choice != LMG_LAYOUT_APERTURE;
    pl.size = try_aperture ? aperture_size : cube_size;

    const bool fixed = options->resolution[0] || options->resolution[1] || options->resolution[2] || options->resolution[3];
    lmg_choice plain = {.distance = options->distance > 0 ? options->distance : (double)INFINITY, .bias = 1, .window_bias = 1, .cells = cells,
                        .fixed = fixed ? options->resolution : NULL, .fewer = options->fewer_cells && !fixed};
    lmg_choice aperture = plain;
    aperture.kind = LMG_SLAB_APERTURE;
    aperture.class = main_class;
    lmg_verdict aperture_error = {.error = INFINITY}, cube_error = {.error = INFINITY};
    if (try_aperture) {
        judge = lmg_judge_create(&pl, main_class, true);
        if (!judge) {
            r = lmg_fail(err, LMG_ERROR_MEMORY, "layout: no memory");
            goto cleanup;
        }
        aperture_error = search_opening(&pl, judge, &aperture, &focus);
    }
    double through = 0;
    for (size_t i = 0; i < pl.count && try_aperture; i++)
        through += aperture.focus && pl.taken[i] ? pl.flux[i] / pl.total : 0;
    through += try_aperture ? aperture.flux / pl.total : 0;
    lmg_choice cube[6];
    if (try_cube) {
        /* Cells to each face: the error of a face falls like its cells^(-1/4), so that the sum of flux x error is least for cells in
         * proportion to flux^(4/5). */
        double sum = 0;
        for (int c = 0; c < 6; c++)
            sum += pow(class_flux[c] / pl.total, 0.8);
        for (int c = 0; c < 6; c++) {
            cube[c] = plain;
            cube[c].kind = LMG_SLAB_CUBE;
            cube[c].class = c;
            cube[c].cells = fmax(cells * pow(class_flux[c] / pl.total, 0.8) / sum, 1);
            if (!(class_flux[c] > 0))
                continue;
            lmg_judge *face = lmg_judge_create(&pl, c, false);
            if (!face) {
                r = lmg_fail(err, LMG_ERROR_MEMORY, "layout: no memory");
                goto cleanup;
            }
            lmg_choice_search(&pl, face, &cube[c]);
            lmg_judge_destroy(face);
        }
        /* judged where an opening would be judged */
        if (try_aperture) {
            lmg_slab slabs[12];
            uint32_t n = 0;
            for (int c = 0; c < 6; c++)
                if (class_flux[c] > 0)
                    n += lmg_choice_slabs(&pl, &cube[c], slabs + n);
            cube_error = lmg_judge_slabs(judge, slabs, n, false, INFINITY);
        }
    }
    bool use_aperture = options->choice == LMG_LAYOUT_APERTURE ||
                        (try_aperture && through >= 1 - APERTURE_REST && !lmg_better(cube_error, aperture_error, CUBE_GAIN, LMG_CLEAR));

    double beside[6] = {0};
    if (use_aperture) {
        out->slab_count = lmg_choice_slabs(&pl, &aperture, out->slabs);
        out->size = aperture_size;
    } else {
        for (int c = 0; c < 6; c++)
            if (class_flux[c] > 0)
                out->slab_count += lmg_choice_slabs(&pl, &cube[c], out->slabs + out->slab_count);
        out->size = cube_size;
    }
    /* what the slabs so far leave over, by class, decides how fine the slabs that catch it are */
    for (size_t i = 0; i < pl.count; i++) {
        double unused[4];
        if (lmg_layout_owner(out, pl.origin[i], pl.direction[i], unused) < 0)
            beside[pl.class[i]] += pl.flux[i] / pl.total;
    }
    double rest = 0;
    for (int c = 0; c < 6; c++) {
        rest += beside[c];
        out->slabs[out->slab_count++] = catch_all(c, pl.lo, pl.hi, (uint32_t)d_clamp(floor(pow(cells * beside[c], 0.25)), 6, 16));
    }
    if (use_aperture) {
        say(report, "aperture: %.2f %% of the flux passes one opening towards %s\n", 100 * through, lmg_class_name(main_class));
        describe(report, &pl, &aperture);
        tell_errors(report, "foretold errors: ", aperture_error);
        if (isfinite(cube_error.error))
            tell_errors(report, "as six faces: ", cube_error);
    } else {
        say(report, "cube: ");
        if (try_aperture && through < 1 - APERTURE_REST)
            say(report, "only %.2f %% of the flux passes one opening towards %s\n", 100 * through, lmg_class_name(main_class));
        else
            say(report, "%.2f %% of the flux goes towards %s\n", 100 * forward[main_class] / pl.total, lmg_class_name(main_class));
        for (int c = 0; c < 6; c++)
            if (class_flux[c] > 0)
                describe(report, &pl, &cube[c]);
        if (try_aperture && through >= 1 - APERTURE_REST) {
            tell_errors(report, "foretold errors: ", cube_error);
            tell_errors(report, "as one opening: ", aperture_error);
        }
    }
    say(report, "%.3f %% of the flux goes to the coarse slabs below; %s; size %.4g m\n", 100 * rest,
        out->channels == 1 ? "one colour" : "three channels", out->size);
    r = lmg_layout_check(out, err);
cleanup:
    lmg_judge_destroy(judge);
    lmg_pilot_destroy(&pl);
    if (r != LMG_OK)
        *out = (lmg_layout){0};
    return r;
}
