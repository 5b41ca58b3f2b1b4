/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Conversions of light: a measured near field (OSRAM LE RTD UW S2WP, green chip) into a box that keeps flux, virtual focus and
 * illuminance near and far; rays of sources with closed forms; boxes into rays and back.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "bake.h"
#include "convert.h"
#include "parallel.h"
#include "picture_set.h"
#include "receiver.h"
#include "stats.h"

#include <luminaires/rng.h>

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define GREEN LUMIBOX_SHARED_DATA "/rayfiles/rayfile_LERTDUW_S2WP_green_100k_20161013_IES_TM25.TM25RAY"
static const double PI = 3.14159265358979323846;

static char folder[] = "/tmp/lumibox_convert_XXXXXX";

static const char *path_of(const char *name)
{
    static char path[2][256];
    static int turn;
    turn = !turn;
    snprintf(path[turn], sizeof(path[turn]), "%s/%s", folder, name);
    return path[turn];
}

static void near(double value, double expected, double tolerance)
{
    if (!(fabs(value - expected) <= tolerance))
        fail_msg("%.12g is not %.12g +- %.3g", value, expected, tolerance);
}

static void check(lmg_result result, const lmg_error *err)
{
    if (result != LMG_OK)
        fail_msg("%s", err->message);
}

typedef struct opened {
    lum_rayfile *file;
    bake_source *source;
} opened;

static opened open_rays(const char *path)
{
    lmg_error err = {{0}};
    opened o;
    check(lum_rayfile_open(path, LUM_RAY_LIGHT, &o.file, &err), &err);
    check(bake_rayfile_source_create(o.file, 1, 0, &o.source, &err), &err);
    return o;
}

static void close_rays(opened *o)
{
    o->source->destroy(o->source);
    lum_rayfile_close(o->file);
}

static lmg_field *box_of(bake_source *source, uint64_t cells, bake_conversion *report)
{
    lmg_error err = {{0}};
    lmg_field *field;
    const bake_convert_options options = {.fit = {.cells = cells}};
    check(bake_convert_to_field(source, &options, &field, report, &err), &err);
    return field;
}

/* ---------------------------------------------------------------------------------------------------------- measured LED */

enum { PLANES = 4 };

/* The point with the least flux-weighted sum of squared distances from the rays' lines; one thread, doubles: apart from the
 * program's own. */
typedef struct focus {
    double m[3][3], b[3];
} focus;

static void consume_focus(void *self, const lmg_ray *rays, size_t count)
{
    focus *f = self;
    for (size_t i = 0; i < count; ++i) {
        const double d[3] = {rays[i].direction.x, rays[i].direction.y, rays[i].direction.z};
        const double o[3] = {rays[i].origin.x, rays[i].origin.y, rays[i].origin.z}, w = lmg_luminance(rays[i].flux);
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) {
                const double p = w * ((r == c) - d[r] * d[c]);
                f->m[r][c] += p;
                f->b[r] += p * o[c];
            }
    }
}

static double determinant(double m[3][3])
{
    return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

static lmg_vec3 focus_point(const focus *f)
{
    double x[3];
    for (int c = 0; c < 3; ++c) { /* Cramer's rule */
        double m[3][3], all[3][3];
        memcpy(m, f->m, sizeof(m));
        memcpy(all, f->m, sizeof(all));
        for (int r = 0; r < 3; ++r)
            m[r][c] = f->b[r];
        x[c] = determinant(m) / determinant(all);
    }
    return (lmg_vec3){x[0], x[1], x[2]};
}

/* What a goniophotometrist looks at: flux through squares of half side z/20 on the axis, the plane at 0.1 mm, the virtual focus. */
typedef struct look {
    double e[3], e_se[3]; /* E z^2 at 10 mm, 100 mm, 1 m, cd */
    double peak, peak_se; /* lm/m2 at 0.1 mm */
    double peak_x, peak_y;
    lmg_vec3 focus;
} look;

static look look_at(bake_source *source, uint64_t photons)
{
    static const double Z[3] = {0.01, 0.1, 1};
    lmg_error err = {{0}};
    bake_receiver *r[PLANES];
    focus f = {{{0}}, {0}};
    lmg_sink sinks[PLANES + 1];
    const lmg_vec3 x = {1, 0, 0}, y = {0, 1, 0};
    for (int i = 0; i < PLANES; ++i) {
        const double z = i < 3 ? Z[i] : 1e-4, side = i < 3 ? z / 10 : 0.01;
        const bake_rectangle q = {.centre = {0, 0, z}, .a = x, .b = y, .width = side, .height = side, .nx = i < 3 ? 1 : 100, .ny = i < 3 ? 1 : 100};
        check(bake_illuminance_create(&q, &r[i], &err), &err);
        sinks[i] = bake_receiver_sink(r[i]);
    }
    sinks[PLANES] = (lmg_sink){.self = &f, .consume = consume_focus};
    bake_tally tally = {0};
    check(source->run(source, 0, photons, 1, sinks, PLANES + 1, &tally, &err), &err);
    const double unit = source->flux / (double)photons;
    look l;
    for (int i = 0; i < 3; ++i) {
        l.e[i] = bake_receiver_reading(r[i], 0, unit, &l.e_se[i]) * Z[i] * Z[i];
        l.e_se[i] *= Z[i] * Z[i];
    }
    l.peak = 0;
    for (size_t i = 0; i < 10000; ++i) {
        double se;
        const double e = bake_receiver_reading(r[3], i, unit, &se);
        if (e > l.peak) {
            l.peak = e;
            l.peak_se = se;
            l.peak_x = -0.005 + 1e-4 * ((double)(i % 100) + 0.5);
            l.peak_y = -0.005 + 1e-4 * ((double)(i / 100) + 0.5);
        }
    }
    l.focus = focus_point(&f);
    for (int i = 0; i < PLANES; ++i)
        bake_receiver_destroy(r[i]);
    return l;
}

static double apart(lmg_vec3 a, lmg_vec3 b)
{
    return sqrt((a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y) + (a.z - b.z) * (a.z - b.z));
}

static void measured_near_field(void **state)
{
    (void)state;
    if (access(GREEN, R_OK) != 0) {
        print_message("skipped: no %s\n", GREEN);
        skip();
    }
    opened o = open_rays(GREEN);
    near(o.source->flux, 337, 1e-5 * 337);
    const look rays = look_at(o.source, o.source->photons);
    /* the maker's virtual focus of the set of 10 M rays, and this file's own as computed by others to 0.01 um */
    assert_true(apart(rays.focus, (lmg_vec3){-0.682e-3, 0.836e-3, -0.449e-3}) < 5e-6);
    assert_true(apart(rays.focus, (lmg_vec3){-0.68356e-3, 0.83609e-3, -0.44910e-3}) < 2e-8);
    static const double E[3] = {95.7, 113.9, 112.2}; /* four digits, computed by others */
    for (int i = 0; i < 3; ++i)
        near(rays.e[i], E[i], 0.051);
    near(rays.peak, 136.8e6, 0.05e6);
    near(rays.peak_x, -0.85e-3, 1e-9);
    near(rays.peak_y, 0.95e-3, 1e-9);

    bake_conversion report;
    lmg_field *field = box_of(o.source, 0, &report);
    lmg_error err = {{0}};
    near(report.flux_out, o.source->flux, 1e-5 * o.source->flux);
    near(report.residual, 0, 1e-5 * o.source->flux);
    bake_source *box;
    check(bake_box_source_create(field, 7, &box, &err), &err);
    const look seen = look_at(box, 4000000);
    print_message("focus %.2f um off; E z^2 %.2f %.2f %.2f cd (rays +- %.1f %.1f %.1f); peak %.1f lm/mm2 at %.2f %.2f mm\n",
                  1e6 * apart(seen.focus, rays.focus), seen.e[0], seen.e[1], seen.e[2], rays.e_se[0], rays.e_se[1], rays.e_se[2],
                  1e-6 * seen.peak, 1e3 * seen.peak_x, 1e3 * seen.peak_y);
    assert_true(apart(seen.focus, rays.focus) < 5e-6);
    for (int i = 0; i < 3; ++i)
        near(seen.e[i], rays.e[i], rays.e_se[i]);
    /* a cell is 0.3 mm wide: the peak is found in or beside the cell that holds it */
    assert_true(fabs(seen.peak_x - rays.peak_x) < 0.35e-3 && fabs(seen.peak_y - rays.peak_y) < 0.35e-3);
    box->destroy(box);
    lmg_field_destroy(field);
    close_rays(&o);
}

/* ------------------------------------------------------------------------------------------------------- closed forms */

/* Rays of a Lambertian opening in z = 0 that shines along +z: a square of 1 x 1 mm of 1 W, or a disc of 1 mm of 1 lm; weighted: with
 * fluxes between 0.5 and 1.5 of the mean.  Even: low-discrepancy numbers (Kronecker's sequence of the powers of the root of
 * x^5 = x + 1) instead of random ones, so that what a box makes of them is seen, and not their noise. */
static void write_lambertian(const char *path, uint32_t count, bool square, bool weighted, bool even, lum_ray_format format)
{
    lmg_error err = {{0}};
    lum_ray_writer *w;
    const lum_ray_writer_options o = {.format = format, .photometric = !square};
    check(lum_ray_writer_create(path, &o, &w, &err), &err);
    for (uint32_t i = 0; i < count; ++i) {
        lum_rng rng = lum_rng_stream(4711, i);
        double q[4];
        for (int k = 0; k < 4; ++k)
            q[k] = even ? fmod(0.5 + (i + 1.0) * pow(1.1673039782614187, -(k + 1)), 1) : lum_rng_next(&rng);
        const double a = q[0], b = q[1], c = q[2], phi = 2 * PI * q[3];
        const double r = 0.5e-3 * sqrt(a), turn = 2 * PI * b, s = sqrt(c);
        const float flux = weighted ? 0.5f + (float)lum_rng_next(&rng) : 1.0f;
        const lmg_ray ray = {
            .origin = square ? (lmg_vec3){1e-3 * (a - 0.5), 1e-3 * (b - 0.5), 0} : (lmg_vec3){r * cos(turn), r * sin(turn), 0},
            .direction = {s * cos(phi), s * sin(phi), sqrt(1 - c)},
            .flux = {flux, flux, flux},
        };
        check(lum_ray_writer_append(w, &ray, 1, 1.0 / count, &err), &err);
    }
    check(lum_ray_writer_finish(w, NULL, &err), &err);
}

/* Mean radiance of the square over its points and directions within 5 degrees of an angle, from eight sides: pixels of
 * luminance pictures. */
static double radiance_seen(const lmg_field *field, double degrees)
{
    enum { POINTS = 512, SIDES = 8, CONE = 128 * SIDES };
    double sum = 0;
    for (int k = 0; k < CONE; ++k) {
        /* even over the cone about +z, then turned about y */
        const double z = 1 - (1 - cos(5 * PI / 180)) * (k + 0.5) / CONE, turn = 2.399963 * k, s = sqrt(1 - z * z);
        const double t = degrees * PI / 180, x = s * cos(turn);
        const double side = 2 * PI * (k % SIDES + 0.3) / SIDES, across = x * cos(t) + z * sin(t), along = s * sin(turn);
        const lmg_vec3 d = {across * cos(side) - along * sin(side), across * sin(side) + along * cos(side), z * cos(t) - x * sin(t)};
        for (int i = 0; i < POINTS; ++i) { /* other points for each direction, even over the square in the end (R2 sequence) */
            const double n = (double)k * POINTS + i, px = 1e-3 * (fmod(0.7548776662466927 * n, 1) - 0.5),
                         py = 1e-3 * (fmod(0.5698402909980532 * n, 1) - 0.5);
            float rgb[3];
            lmg_field_radiance(field, (lmg_vec3){px + d.x, py + d.y, d.z}, d, LMG_NEAREST, rgb, NULL);
            sum += lmg_luminance(rgb);
        }
    }
    return sum / (CONE * POINTS);
}

static void lambertian_square(void **state)
{
    (void)state;
    for (int weighted = 0; weighted < 2; ++weighted) {
        write_lambertian(path_of("square.tm25ray"), 1000000, true, weighted, true, LUM_RAYS_TM25);
        opened o = open_rays(path_of("square.tm25ray"));
        assert_false(lum_rayfile_info(o.file)->photometric);
        bake_conversion report;
        lmg_field *field = box_of(o.source, 0, &report);
        near(report.flux_out, o.source->flux, 1e-5 * o.source->flux);
        static const double ANGLES[3] = {0, 45, 70};
        for (int k = 0; k < 3; ++k) {
            const double radiance = radiance_seen(field, ANGLES[k]) / o.source->flux; /* of 1 W: weighted fluxes don't add up to it exactly */
            print_message("%g degrees: %.0f W/(sr m2)\n", ANGLES[k], radiance);
            near(radiance, 1 / (PI * 1e-6), 0.01 / (PI * 1e-6));
        }
        lmg_field_destroy(field);
        close_rays(&o);
        unlink(path_of("square.tm25ray"));
    }
}

static void half_intensity(void **state)
{
    (void)state;
    write_lambertian(path_of("disc.ray"), 400000, false, false, true, LUM_RAYS_LIGHTTOOLS);
    opened o = open_rays(path_of("disc.ray"));
    bake_conversion report;
    lmg_field *field = box_of(o.source, 0, &report);
    lmg_error err = {{0}};
    bake_source *box;
    check(bake_box_source_create(field, 5, &box, &err), &err);
    for (int which = 0; which < 2; ++which) { /* the rays themselves, and the box */
        enum { RINGS = 180 };                 /* of equal solid angle, 0.6 degrees wide at 60 */
        bake_receiver *r;
        bake_source *source = which ? box : o.source;
        const uint64_t photons = which ? 4000000 : o.source->photons;
        const bake_sphere far = {.radius = INFINITY, .axis = {0, 0, 1}, .rings = RINGS, .sectors = 1};
        check(bake_sphere_create(&far, &r, &err), &err);
        const lmg_sink sink = bake_receiver_sink(r);
        bake_tally tally = {0};
        check(source->run(source, 0, photons, 0, &sink, 1, &tally, &err), &err);
        /* a line through the rings about 60 degrees, where the intensity of a Lambertian lamp is one in cos, by least squares */
        double n = 0, x = 0, y = 0, xx = 0, xy = 0;
        for (size_t i = RINGS / 10; i < RINGS * 4 / 10; ++i) {
            const double z = 1 - 2 * (i + 0.5) / RINGS, e = bake_receiver_reading(r, i, source->flux / (double)photons, NULL);
            n += 1, x += z, y += e, xx += z * z, xy += z * e;
        }
        const double slope = (n * xy - x * y) / (n * xx - x * x), half = acos((0.5 / PI - (y - slope * x) / n) / slope) * 180 / PI;
        print_message("%s: half intensity at %.3f degrees\n", which ? "box" : "rays", half);
        /* 60,000 rays in those rings: 0.4 % of intensity; 1 % are 0.33 degrees */
        near(half, 60, 0.33);
        bake_receiver_destroy(r);
    }
    box->destroy(box);
    lmg_field_destroy(field);
    close_rays(&o);
    unlink(path_of("disc.ray"));
}

/* ---------------------------------------------------------------------------------------------------------- round trips */

typedef struct counts {
    const lmg_layout *layout;
    size_t cells;
    double *cell;
} counts;

/* The cell of a ray by the rule of the format: the first slab whose domain holds it.  One thread at a time. */
static void count_rays(void *self, const lmg_ray *rays, size_t n)
{
    counts *c = self;
    for (size_t i = 0; i < n; ++i) {
        size_t first = 0;
        for (uint32_t k = 0; k < c->layout->slab_count; ++k) {
            const lmg_slab *s = &c->layout->slabs[k];
            double q[4];
            if (lmg_slab_coordinates(s, rays[i].origin, rays[i].direction, q)) {
                const double lo[4] = {s->u0, s->v0, s->s0, s->t0}, hi[4] = {s->u1, s->v1, s->s1, s->t1};
                const uint32_t cells[4] = {s->nu, s->nv, s->ns, s->nt};
                size_t at = 0;
                for (int d = 0; d < 4; ++d) {
                    size_t j = (size_t)((q[d] - lo[d]) / (hi[d] - lo[d]) * cells[d]);
                    at = at * cells[d] + (j < cells[d] ? j : cells[d] - 1);
                }
                c->cell[first + at] += 1;
                break;
            }
            first += (size_t)s->nu * s->nv * s->ns * s->nt;
        }
    }
}

static double *count_cells(bake_source *source, uint64_t photons, const lmg_layout *layout, size_t *cells)
{
    *cells = 0;
    for (uint32_t k = 0; k < layout->slab_count; ++k)
        *cells += (size_t)layout->slabs[k].nu * layout->slabs[k].nv * layout->slabs[k].ns * layout->slabs[k].nt;
    counts c = {.layout = layout, .cells = *cells, .cell = calloc(*cells, sizeof(double))};
    const lmg_sink sink = {.self = &c, .consume = count_rays};
    bake_tally tally = {0};
    lmg_error err = {{0}};
    check(source->run(source, 0, photons, 1, &sink, 1, &tally, &err), &err);
    return c.cell;
}

/* Rays -> box -> rays -> cells: the sampled rays' counts come from the box's own distribution. */
static void sampled_rays_give_the_box_back(void **state)
{
    (void)state;
    enum { SAMPLED = 600000 };
    write_lambertian(path_of("disc.dat"), 300000, false, false, false, LUM_RAYS_ZEMAX);
    opened o = open_rays(path_of("disc.dat"));
    bake_conversion report;
    lmg_field *field = box_of(o.source, 20000, &report);
    lmg_error err = {{0}};
    bake_source *box;
    check(bake_box_source_create(field, 99, &box, &err), &err);
    const bake_convert_options options = {.rays = SAMPLED};
    const lum_ray_writer_options writer = {.format = LUM_RAYS_TM25, .photometric = true};
    check(bake_convert_to_rays(box, &options, path_of("out.tm25ray"), &writer, &report, &err), &err);
    assert_int_equal(report.rays, SAMPLED);
    near(report.flux_out, 1, 1e-5);
    opened back = open_rays(path_of("out.tm25ray"));
    near(back.source->flux, 1, 1e-5);

    const lmg_layout *layout = lmg_field_layout(field);
    size_t cells;
    double *expected = count_cells(o.source, o.source->photons, layout, &cells);
    double *counted = count_cells(back.source, SAMPLED, layout, &cells);
    double wrong_total = 0;
    double *wrong = malloc(cells * sizeof(*wrong));
    for (size_t i = 0; i < cells; ++i) {
        expected[i] *= (double)SAMPLED / 300000;
        wrong[i] = expected[i] * (i % 2 ? 1.05 : 0.95);
        wrong_total += wrong[i];
    }
    for (size_t i = 0; i < cells; ++i)
        wrong[i] *= SAMPLED / wrong_total;
    double statistic;
    int degrees;
    const double p = stats_chi_square(counted, expected, cells, &statistic, &degrees);
    print_message("chi-square %.0f with %d degrees of freedom: p = %.3f\n", statistic, degrees, p);
    assert_true(p > 0.001);
    assert_true(stats_chi_square(counted, wrong, cells, NULL, NULL) < 0.001);
    free(expected);
    free(counted);
    free(wrong);
    close_rays(&back);
    box->destroy(box);
    lmg_field_destroy(field);
    close_rays(&o);
    unlink(path_of("disc.dat"));
    unlink(path_of("out.tm25ray"));
}

/* ------------------------------------------------------------------------------------------------------------ pictures */

static void remove_set(const char *path)
{
    char name[512];
    for (int i = 0; i < 1000; ++i) {
        snprintf(name, sizeof(name), "%s/p%05d.exr", path, i);
        unlink(name);
    }
    snprintf(name, sizeof(name), "%s/index.json", path);
    unlink(name);
    rmdir(path);
}

static void put_file(const char *path, const char *text)
{
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
}

static void set_refused(const char *path, lmg_result code, const char *why)
{
    lmg_error err = {{0}};
    bake_source *source;
    bake_picture_set_info info;
    const lmg_result result = bake_picture_set_source_create(path, 1, &source, &info, &err);
    assert_null(source);
    if (result != code || !strstr(err.message, why) || strchr(err.message, '\n'))
        fail_msg("%d, '%s': not %d and '%s'", result, err.message, code, why);
}

/* A square's box, photographed all around, made into a box again: flux, and illuminance in front of it by its closed form. */
static void goniometer_pictures(void **state)
{
    (void)state;
    write_lambertian(path_of("square.tm25ray"), 400000, true, false, true, LUM_RAYS_TM25);
    opened o = open_rays(path_of("square.tm25ray"));
    bake_conversion report;
    lmg_error err = {{0}};
    lmg_field *field = box_of(o.source, 100000, &report), *again;
    char folder_path[256];
    snprintf(folder_path, sizeof(folder_path), "%s", path_of("set"));
    const bake_picture_set_options options = {.distance = 0.01, .step = 10, .pixels = 48, .radiant = true, .origin = "a square"};
    bake_picture_set_report set;
    check(bake_picture_set_write(field, &options, folder_path, &set, &err), &err);
    assert_int_equal(set.pictures, 18 * 36);
    assert_int_equal(set.dark, 18 * 36 / 2); /* behind it */
    /* midpoint rule in steps of 10 degrees: step^2/24 = 0.13 % of a cosine; pixels across edges: one of 24 pixels' hundredths */
    near(set.flux, o.source->flux, 0.01 * o.source->flux);
    /* a folder that holds something isn't written over, and nothing is left of the attempt */
    assert_int_equal(bake_picture_set_write(field, &options, folder_path, &set, &err), LMG_ERROR_FILE_WRITE);

    bake_source *source;
    bake_picture_set_info info;
    check(bake_picture_set_source_create(folder_path, 3, &source, &info, &err), &err);
    assert_false(info.photometric);
    assert_true(isnan(info.told));
    near(source->flux, set.flux, 1e-5 * set.flux);
    again = box_of(source, 100000, &report);
    /* deposits are rounded to 2^-20; of pixels across the edge of the bounds, whose places are a thousandth of it wide, some rays pass it by */
    near(report.flux_out + report.residual, source->flux, 1e-6 * source->flux);
    near(report.residual, 0, 1e-3 * source->flux);
    /* On the axis of a square of side a and exitance M at height h: E = 4 M/(2 pi) * 2 k/sqrt(1+k^2) atan(k/sqrt(1+k^2)), k = a/(2h) */
    static const double HEIGHTS[3] = {0.5e-3, 1e-3, 2e-3};
    for (int i = 0; i < 3; ++i) {
        const double h = HEIGHTS[i], k = 0.5e-3 / h, q = k / sqrt(1 + k * k);
        const double expected = 1e6 * 4 / (2 * PI) * 2 * q * atan(q);
        double rgb[3];
        check(lmg_field_illuminance(again, (lmg_vec3){0, 0, h}, (lmg_vec3){0, 0, -1}, rgb, NULL, &err), &err);
        print_message("E at %g mm: %.4g of %.4g\n", 1e3 * h, rgb[1], expected);
        near(rgb[1], expected, 0.03 * expected);
    }
    source->destroy(source);
    lmg_field_destroy(again);

    /* damage */
    char name[512], kept[512];
    snprintf(name, sizeof(name), "%s/p00020.exr", folder_path);
    snprintf(kept, sizeof(kept), "%s/p00030.exr", folder_path);
    assert_int_equal(truncate(name, 500), 0);
    set_refused(folder_path, LMG_ERROR_FILE_READ, "p00020.exr");
    put_file(name, "no picture");
    set_refused(folder_path, LMG_ERROR_FILE_FORMAT, "p00020.exr");
    unlink(name);
    set_refused(folder_path, LMG_ERROR_FILE_OPEN, "p00020.exr");
    static const struct {
        const char *text, *why;
    } INDEXES[] = {
        {"", "line 1"},
        {"{\"format\": 3}", "format"},
        {"{\"format\": \"lumibox luminance pictures 1\"}", "theta_degrees"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [30, 20], \"phi_degrees\": [0]}", "rise"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [360]}", "rise"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0]}", "unit"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\"}", "camera"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\", "
         "\"camera\": {\"width\": 9, \"height\": 9, \"field_degrees\": 20}}",
         "centre_m"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\", "
         "\"camera\": {\"width\": 9, \"height\": 9, \"field_degrees\": 20}, \"centre_m\": [0,0,0], \"axis\": [0,0,2], \"zero\": [1,0,0], "
         "\"bounds_min_m\": [-1,-1,-1], \"bounds_max_m\": [1,1,1]}",
         "right angles"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\", "
         "\"camera\": {\"width\": 9, \"height\": 9, \"field_degrees\": 20}, \"centre_m\": [0,0,0], \"axis\": [0,0,1], \"zero\": [1,0,0], "
         "\"bounds_min_m\": [-1,-1,-1], \"bounds_max_m\": [1,1,1], \"distance_m\": 1.7}",
         "outside of the bounds"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\", "
         "\"camera\": {\"width\": 9, \"height\": 9, \"field_degrees\": 20}, \"centre_m\": [0,0,0], \"axis\": [0,0,1], \"zero\": [1,0,0], "
         "\"bounds_min_m\": [-1,-1,-1], \"bounds_max_m\": [1,1,1], \"distance_m\": 3, \"pictures\": [[\"../p00030.exr\"]]}",
         "isn't a file in the folder"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\", "
         "\"camera\": {\"width\": 9, \"height\": 9, \"field_degrees\": 20}, \"centre_m\": [0,0,0], \"axis\": [0,0,1], \"zero\": [1,0,0], "
         "\"bounds_min_m\": [-1,-1,-1], \"bounds_max_m\": [1,1,1], \"distance_m\": 3, \"pictures\": [[\"p00030.exr\"]]}",
         "48 x 48 pixels"},
        {"{\"format\": \"lumibox luminance pictures 1\", \"theta_degrees\": [20], \"phi_degrees\": [0], \"unit\": \"cd/m2\", "
         "\"camera\": {\"width\": 9, \"height\": 9, \"field_degrees\": 20}, \"centre_m\": [0,0,0], \"axis\": [0,0,1], \"zero\": [1,0,0], "
         "\"bounds_min_m\": [-1,-1,-1], \"bounds_max_m\": [1,1,1], \"distance_m\": 3, \"pictures\": [[null]]}",
         "no light"},
    };
    snprintf(name, sizeof(name), "%s/index.json", folder_path);
    for (size_t i = 0; i < sizeof(INDEXES) / sizeof(INDEXES[0]); ++i) {
        put_file(name, INDEXES[i].text);
        set_refused(folder_path, i + 1 == sizeof(INDEXES) / sizeof(INDEXES[0]) ? LMG_ERROR_INPUT : LMG_ERROR_FILE_FORMAT, INDEXES[i].why);
    }
    remove_set(folder_path);
    lmg_field_destroy(field);
    close_rays(&o);
    unlink(path_of("square.tm25ray"));
}

/* What a photometer at one diameter takes for the intensity of a Lambertian disc: 0.8 of it on the axis. */
static void application_distance(void **state)
{
    (void)state;
    write_lambertian(path_of("disc.ray"), 1000000, false, false, true, LUM_RAYS_LIGHTTOOLS);
    opened o = open_rays(path_of("disc.ray"));
    lmg_error err = {{0}};
    static const double DISTANCES[4] = {0, 1e-3, 5e-3, 0.5e-3};
    for (int i = 0; i < 4; ++i) {
        const bake_convert_options options = {.near = DISTANCES[i]};
        bake_conversion report;
        lum_photometry *p;
        const lmg_result result = bake_convert_to_photometry(o.source, &options, &p, &report, &err);
        if (i == 3) { /* inside of it */
            assert_int_equal(result, LMG_ERROR_ARGUMENT);
            break;
        }
        check(result, &err);
        near(report.flux_out, 1, 1e-4);
        const double d = DISTANCES[i], expected = (d > 0 ? d * d / (d * d + 0.25e-6) : 1) / PI;
        double sum = 0; /* 2 degrees off the axis, from eight sides: a grid point alone is noisy */
        for (int k = 0; k < 8; ++k)
            sum += lum_photometry_intensity(p, (lmg_vec3){0.035 * cos(k * PI / 4), 0.035 * sin(k * PI / 4), sqrt(1 - 0.035 * 0.035)}) / 8;
        print_message("at %g mm: %.4f of %.4f lm/sr\n", 1e3 * d, sum, expected);
        /* some 15,000 rays within 5 degrees, even ones */
        near(sum, expected, 0.015 * expected);
        lum_photometry_destroy(p);
    }
    close_rays(&o);
    unlink(path_of("disc.ray"));
}

/* The same rays through every format and any number of threads: the same light, the same bytes. */
static void threads(void **state)
{
    (void)state;
    write_lambertian(path_of("disc.dat"), 30000, false, true, false, LUM_RAYS_ZEMAX);
    opened o = open_rays(path_of("disc.dat"));
    lmg_error err = {{0}};
    char *bytes[2][2];
    size_t size[2][2];
    for (unsigned t = 0; t < 2; ++t) {
        const bake_convert_options options = {.threads = t ? 4 : 1};
        const lum_ray_writer_options writer = {.format = LUM_RAYS_LIGHTTOOLS, .photometric = true};
        bake_conversion report;
        lmg_field *field;
        check(bake_convert_to_rays(o.source, &options, path_of("out"), &writer, &report, &err), &err);
        check(bake_convert_to_field(o.source, &options, &field, &report, &err), &err);
        check(lmg_field_write(field, path_of("box"), &err), &err);
        lmg_field_destroy(field);
        for (int k = 0; k < 2; ++k) {
            FILE *f = fopen(path_of(k ? "box" : "out"), "rb");
            assert_non_null(f);
            bytes[t][k] = malloc(1 << 23);
            size[t][k] = fread(bytes[t][k], 1, 1 << 23, f);
            fclose(f);
        }
    }
    for (int k = 0; k < 2; ++k) {
        assert_int_equal(size[0][k], size[1][k]);
        assert_memory_equal(bytes[0][k], bytes[1][k], size[0][k]);
        free(bytes[0][k]);
        free(bytes[1][k]);
    }
    /* more rays than there are; a file that is cut short after it was opened */
    const bake_convert_options many = {.rays = 30001};
    bake_conversion report;
    lmg_field *field;
    assert_int_equal(bake_convert_to_field(o.source, &many, &field, &report, &err), LMG_ERROR_ARGUMENT);
    assert_null(field);
    assert_int_equal(truncate(path_of("disc.dat"), 400000), 0);
    const bake_convert_options all = {0};
    const lum_ray_writer_options writer = {.format = LUM_RAYS_TM25, .photometric = true};
    unlink(path_of("out"));
    assert_int_equal(bake_convert_to_rays(o.source, &all, path_of("out"), &writer, &report, &err), LMG_ERROR_FILE_READ);
    assert_int_equal(access(path_of("out"), F_OK), -1);
    close_rays(&o);
    unlink(path_of("disc.dat"));
    unlink(path_of("box"));
}

static int setup(void **state)
{
    (void)state;
    return mkdtemp(folder) ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    return rmdir(folder);
}

/* A pilot of a file has each of its items once before it has any twice, and its every part is from all over the file: of the first tenth of
 * the runs half are in the first half, to what the discrepancy of a golden rotation is at most, 1 + ln(n) of n. */
static void pilots_are_spread(void **state)
{
    (void)state;
    static const uint64_t COUNTS[] = {1, 63, 64, 65, 1000, 64 * 97, 100003, 262144 + 17};
    for (size_t k = 0; k < sizeof COUNTS / sizeof *COUNTS; k++) {
        const uint64_t count = COUNTS[k], whole = count < 64 ? count : count / 64 * 64;
        unsigned char *had = calloc(count, 1);
        assert_non_null(had);
        uint64_t low = 0;
        const uint64_t tenth = whole / 640 * 64;
        for (uint64_t i = 0; i < whole; i++) {
            const uint64_t place = bake_pilot_place(i, count, 64, 11);
            assert_true(place < count);
            assert_int_equal(had[place]++, 0);
            low += i < tenth && place < count / 2;
        }
        if (tenth > 0)
            assert_true(fabs((double)low - 0.5 * (double)tenth) <= 64 * (1 + log((double)tenth / 64)));
        free(had);
    }
}

/* A list keeps every ray of several threads, however small its room at first, in the order of their numbers. */
enum { FEEDERS = 4, FEED = 5000, BATCH = 50 };

typedef struct feeder {
    lmg_sink sink;
    uint64_t first;
} feeder;

static void *feed(void *argument)
{
    const feeder *f = argument;
    lmg_ray batch[BATCH] = {{.direction = {0, 0, 1}}};
    for (uint64_t n = 0; n < FEED; n += BATCH) {
        for (uint64_t i = 0; i < BATCH; i++)
            batch[i].number = f->first + n + i;
        f->sink.consume(f->sink.self, batch, BATCH);
    }
    return NULL;
}

static void ray_lists_grow(void **state)
{
    (void)state;
    lmg_error err;
    bake_ray_list *list;
    assert_int_equal(bake_ray_list_create(10, &list, &err), LMG_OK);
    feeder feeders[FEEDERS];
    pthread_t threads_of[FEEDERS];
    for (int i = 0; i < FEEDERS; i++) {
        feeders[i] = (feeder){bake_ray_list_sink(list), (uint64_t)(FEEDERS - 1 - i) * FEED};
        assert_int_equal(pthread_create(&threads_of[i], NULL, feed, &feeders[i]), 0);
    }
    for (int i = 0; i < FEEDERS; i++)
        assert_int_equal(pthread_join(threads_of[i], NULL), 0);
    size_t count;
    assert_int_equal(bake_ray_list_check(list, &err), LMG_OK);
    const lmg_ray *rays = bake_ray_list_sorted(list, &count);
    assert_int_equal(count, FEEDERS * FEED);
    for (size_t i = 0; i < count; i++)
        assert_int_equal(rays[i].number, i);
    bake_ray_list_destroy(list);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(measured_near_field),          cmocka_unit_test(lambertian_square), cmocka_unit_test(half_intensity),
        cmocka_unit_test(sampled_rays_give_the_box_back), cmocka_unit_test(threads),
        cmocka_unit_test(goniometer_pictures),          cmocka_unit_test(pilots_are_spread),
        cmocka_unit_test(application_distance),         cmocka_unit_test(ray_lists_grow),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
