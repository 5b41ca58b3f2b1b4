/* SPDX-License-Identifier: Apache-2.0 */
/* A comparison as a page: tables, polar plots, maps. */
#include "compare.h"
#include "page.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

/* "1.23 +- 0.04", or a dash where there is no such figure. */
static const char *with_error(char text[64], double value, double se)
{
    if (!isfinite(value))
        snprintf(text, 64, "\u2013");
    else if (isfinite(se) && se > 0)
        snprintf(text, 64, "%.5g \u00b1 %.2g", value, se);
    else
        snprintf(text, 64, "%.5g", value);
    return text;
}

static void add_alignment(report_page *page, const bake_comparison *c)
{
    const bake_alignment *al = &c->alignment;
    const lmg_vec3 t = al->motion.shift, se = al->shift_se;
    report_page_heading(page, "Alignment");
    if (bake_motion_is_identity(&al->motion))
        report_page_text(page, "No turn or shift of A towards B that the noise of the rays couldn't make.");
    else
        report_page_text(
            page,
            "A turned by %.3g \u00b1 %.2g degrees and shifted by %.4g, %.4g, %.4g mm (\u00b1 %.2g, %.2g, %.2g) would lie on B. %s",
            al->angle * 180 / PI, al->angle_se * 180 / PI, 1e3 * t.x, 1e3 * t.y, 1e3 * t.z, 1e3 * se.x, 1e3 * se.y, 1e3 * se.z,
            c->moved ? "That makes the two more alike, and everything below is measured so."
                     : "It wasn't applied: it wasn't asked for, or doesn't make the two more alike.");
    if (al->turns < 3)
        report_page_text(
            page, "The light determines %u of three turns; about the others it is the same from all sides, and nothing was turned.",
            al->turns);
}

static void add_planes(report_page *page, const bake_comparison *c)
{
    report_page_heading(page, "Near field: illuminance on planes");
    report_page_text(
        page,
        "Planes of %u x %u pixels across the main axis (%+g %+g %+g), distances from the face of the bounds in sizes of %.4g m. "
        "Differences in %% of B's RMS reading, the noise of both taken out.",
        c->pixels, c->pixels, c->axis.x, c->axis.y, c->axis.z, c->size);
    report_page_table(page,
                      "distance\tside, m\tmean A, lx\tmean B, lx\tRMS difference, %\tunaligned, %\t99th percentile, %\tnoise, %");
    for (size_t i = 0; i <= c->plane_count; ++i) {
        const bool far = i == c->plane_count;
        const bake_difference *d = far ? &c->far_field : &c->planes[i].difference;
        const bake_difference *u = far ? &c->far_field_unmoved : &c->planes[i].unmoved;
        char rms[64], before[64], a[64], b[64];
        with_error(rms, 100 * d->rms, 100 * d->standard_error);
        with_error(before, 100 * u->rms, 100 * u->standard_error);
        if (far)
            report_page_row(page, "far field\t\u2013\t\u2013\t\u2013\t%s\t%s\t%.3g\t%.3g", rms, before, 100 * d->p99,
                            100 * d->noise);
        else
            report_page_row(page, "%g sizes\t%.4g\t%s\t%s\t%s\t%s\t%.3g\t%.3g", c->planes[i].sizes, c->planes[i].side,
                            with_error(a, c->planes[i].mean[0], c->planes[i].mean_se[0]),
                            with_error(b, c->planes[i].mean[1], c->planes[i].mean_se[1]), rms, before, 100 * d->p99,
                            100 * d->noise);
    }
    report_page_table_end(page);
}

/* A, B and A - B side by side. */
static void add_maps(report_page *page, const bake_readings *r, uint32_t pixels, double width, const char *unit, const char *what)
{
    double *difference = malloc(r->count * sizeof(*difference)), most = 0, apart = 0;
    if (!difference)
        return;
    for (size_t i = 0; i < r->count; ++i) {
        difference[i] = r->a[i] - r->b[i];
        most = fmax(most, fmax(r->a[i], r->b[i]));
        apart = fmax(apart, fabs(difference[i]));
    }
    char title[3][128];
    static const char *const OF[3] = {"A", "B", "A - B"};
    for (int k = 0; k < 3; ++k)
        snprintf(title[k], sizeof(title[k]), "%s: %s", what, OF[k]);
    const report_map map = {.unit = unit, .nx = pixels, .ny = pixels, .width = width, .height = width};
    report_map maps[3] = {map, map, map};
    for (int k = 0; k < 3; ++k)
        maps[k].title = title[k];
    maps[0].values = r->a, maps[0].most = most;
    maps[1].values = r->b, maps[1].most = most;
    maps[2].values = difference, maps[2].least = -apart, maps[2].most = apart, maps[2].diverging = true;
    report_page_maps(page, maps, 3);
    free(difference);
}

static void add_polar(report_page *page, const bake_comparison *c, const char *const names[2])
{
    const uint32_t n = c->profile_rings;
    report_page_heading(page, "Far field");
    double *x = malloc(2 * n * sizeof(*x)), *y = malloc(4 * n * sizeof(*y));
    for (int plane = 0; x && y && plane < 2; ++plane) {
        /* The two half-planes opposite each other as one curve, from -180 to 180 degrees. */
        for (uint32_t i = 0; i < n; ++i) {
            const double angle = 180 * (i + 0.5) / n;
            x[n + i] = angle;
            x[n - 1 - i] = -angle;
            for (int s = 0; s < 2; ++s) {
                y[2 * n * (uint32_t)s + n + i] = c->profile[s][plane][i];
                y[2 * n * (uint32_t)s + n - 1 - i] = c->profile[s][plane + 2][i];
            }
        }
        const report_curve curves[2] = {{.name = names[0], .x = x, .y = y, .count = 2 * n},
                                        {.name = names[1], .x = x, .y = y + 2 * n, .count = 2 * n}};
        char title[96];
        snprintf(title, sizeof(title), "Intensity, cd, in the half-planes at %d and %d degrees (main axis down)", 90 * plane, 90 * plane + 180);
        report_page_polar(page, title, curves, 2);
    }
    free(x);
    free(y);
}

static void add_measures(report_page *page, const bake_comparison *c)
{
    report_page_heading(page, "Measures");
    report_page_text(page, "Each with its standard error; 'differs' where the difference is more than three of them.");
    report_page_table(page, "measure\tA\tB\tdifference\tverdict");
    for (size_t i = 0; i < c->measure_count; ++i) {
        const bake_measure *m = &c->measures[i];
        if (m->a == 0 && m->b == 0) /* no such light */
            continue;
        char a[64], b[64], d[64];
        const double scale = m->relative ? 100 : 1;
        with_error(d, scale * m->difference, scale * m->difference_se);
        report_page_row(page, "%s%s%s\t%s\t%s\t%s%s\t%s", m->name, m->unit[0] ? ", " : "", m->unit, with_error(a, m->a, m->a_se),
                        with_error(b, m->b, m->b_se), d, m->relative ? " %" : "",
                        !isfinite(m->difference)  ? "\u2013"
                        : bake_measure_differs(m) ? "differs"
                                                  : "within noise");
    }
    report_page_table_end(page);
}

static void add_distances(report_page *page, const bake_comparison *c, const char *const names[2])
{
    report_page_heading(page, "Where the far field begins");
    report_page_text(
        page,
        "E r\u00b2 on spheres about the luminaire against the intensity, by angle from the main axis: the distance, in sizes, "
        "from which on they agree to 1 %% and to 5 %%. Beyond the largest sphere (%g sizes): \u221e.",
        c->radii[BAKE_RADII - 1]);
    double *angle = malloc(c->rings * sizeof(*angle));
    if (!angle)
        return;
    report_curve curves[4];
    char name[4][80];
    for (int k = 0; k < 4; ++k) {
        snprintf(name[k], sizeof(name[k]), "%.60s, %s", names[k / 2], k % 2 ? "5 %" : "1 %");
        curves[k] = (report_curve){.name = name[k], .x = angle, .y = c->valid_from[k / 2][k % 2], .count = c->rings};
    }
    for (uint32_t i = 0; i < c->rings; ++i)
        angle[i] = 180 * (i + 0.5) / c->rings;
    report_page_plot(
        page,
        &(report_axes){
            .title = "Far field valid from", .x = "angle from the main axis, degrees", .y = "distance, sizes", .log_y = true},
        curves, 4);
    free(angle);
}

static void add_pictures(report_page *page, const bake_comparison *c)
{
    report_page_heading(page, "Luminance pictures");
    report_page_text(page, "Seen from far away, as means over cones of 5 degrees half-angle; the noise is that of the rays.");
    report_page_table(page, "view\toff the main axis, degrees\tabout it, degrees\tRMS difference, %\tnoise, %");
    for (size_t v = 0; v < BAKE_VIEWS; ++v) {
        char rms[64];
        const bake_difference *d = &c->views[v].difference;
        report_page_row(page, "%zu\t%g\t%g\t%s\t%.3g", v + 1, c->views[v].tilt, c->views[v].turn,
                        with_error(rms, 100 * d->rms, 100 * d->standard_error), 100 * d->noise);
    }
    report_page_table_end(page);
    for (size_t v = 0; v < BAKE_VIEWS; ++v) {
        char what[64];
        snprintf(what, sizeof(what), "view %zu", v + 1);
        add_maps(page, &c->views[v].picture, c->pixels, c->views[v].width, "cd/m2", what);
    }
}

static const char *file_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

lmg_result bake_comparison_report(const bake_comparison *c, const char *const paths[2], const char *path, lmg_error *err)
{
    const char *const names[2] = {file_name(paths[0]), file_name(paths[1])};
    report_page *page;
    lmg_result result = report_page_create("Comparison of two luminaires", &page, err);
    if (result != LMG_OK)
        return result;
    report_page_table(page, "\tsource\tflux, lm\trays\tseconds");
    for (int s = 0; s < 2; ++s) {
        char flux[64];
        report_page_row(page, "%c\t%s\t%s\t%.3g\t%.3g", 'A' + s, names[s], with_error(flux, c->flux[s], c->flux_se[s]),
                        (double)c->tally[s].photons, c->seconds[s]);
    }
    report_page_table_end(page);
    add_alignment(page, c);
    add_planes(page, c);
    for (size_t i = 0; i < c->plane_count; ++i) {
        char what[64];
        snprintf(what, sizeof(what), "%g sizes", c->planes[i].sizes);
        add_maps(page, &c->planes[i].map, c->pixels, c->planes[i].side, "lx", what);
    }
    add_polar(page, c, names);
    add_measures(page, c);
    add_distances(page, c, names);
    add_pictures(page, c);
    result = report_page_write(page, path, err);
    report_page_destroy(page);
    return result;
}
