/* SPDX-License-Identifier: Apache-2.0 */
/* Sets of goniometer pictures: their geometry, the index, and a set as a source of rays. */
#include "picture_set.h"

#include "bake.h"
#include "batch.h"
#include "parallel.h"
#include "picture_set_inside.h"

#include <luminaires/rng.h>

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Photons of a set, at least: so many per pixel. */
static const uint64_t FEWEST_PHOTONS = 2000000;
/* Pilot photons come in runs of neighbouring pixels: a run costs the decoding of one picture. */
enum { PILOT_RUN = 1024 };
/* As of ray files: the brightest pixel times the number of rays stays within what receivers can count. */
static const double MOST_UNEVEN = 0x1p42;
static const double UNIT = 0x1p20;

/* ------------------------------------------------------------------------------------------------------------ geometry */

static lmg_vec3 cross(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static lmg_vec3 mix(lmg_vec3 a, double x, lmg_vec3 b, double y, lmg_vec3 c, double z)
{
    return (lmg_vec3){x * a.x + y * b.x + z * c.x, x * a.y + y * b.y + z * c.y, x * a.z + y * b.z + z * c.z};
}

set_camera set_camera_at(const picture_set *set, double theta, double phi)
{
    const lmg_vec3 third = cross(set->axis, set->zero);
    const double st = sin(theta), ct = cos(theta), sp = sin(phi), cp = cos(phi);
    return (set_camera){
        .out = mix(set->axis, ct, set->zero, st * cp, third, st * sp),
        .right = mix(set->axis, 0, set->zero, -sp, third, cp),
        .up = mix(set->axis, st, set->zero, -ct * cp, third, -ct * sp),
    };
}

lmg_vec3 set_place(const picture_set *set, lmg_vec3 out)
{
    return (lmg_vec3){set->centre.x + set->distance * out.x, set->centre.y + set->distance * out.y, set->centre.z + set->distance * out.z};
}

double set_pixel_at(const picture_set *set, double i, double j, double *x, double *y)
{
    const double size = 2 * set->half_field / set->width;
    *x = size * i - set->half_field;
    *y = size * (0.5 * set->height - j);
    const double c2 = 1 / (1 + *x * *x + *y * *y); /* cos squared of the angle to the axis */
    return size * size * c2 * c2;                  /* cos x solid angle: size^2 cos^3 */
}

double set_cell_area(const picture_set *set, uint32_t row, uint32_t column)
{
    return set->distance * set->distance * (cos(set->theta_edge[row]) - cos(set->theta_edge[row + 1])) *
           (set->phi_edge[column + 1] - set->phi_edge[column]);
}

/* Edges half-way between neighbours; theta ends at the poles if it begins or ends there, else as far outside as inside. */
void set_make_edges(picture_set *set)
{
    const double pi = 3.14159265358979323846;
    const uint32_t n = set->rows, m = set->columns;
    for (uint32_t i = 1; i < n; ++i)
        set->theta_edge[i] = 0.5 * (set->theta[i - 1] + set->theta[i]);
    set->theta_edge[0] = n > 1 ? fmax(0, set->theta[0] - 0.5 * (set->theta[1] - set->theta[0])) : 0;
    set->theta_edge[n] = n > 1 ? fmin(pi, set->theta[n - 1] + 0.5 * (set->theta[n - 1] - set->theta[n - 2])) : pi;
    for (uint32_t j = 1; j < m; ++j)
        set->phi_edge[j] = 0.5 * (set->phi[j - 1] + set->phi[j]);
    set->phi_edge[0] = 0.5 * (set->phi[m - 1] - 2 * pi + set->phi[0]);
    set->phi_edge[m] = set->phi_edge[0] + 2 * pi;
}

void set_free(picture_set *set)
{
    for (size_t i = 0; set->files && i < (size_t)set->rows * set->columns; ++i)
        free(set->files[i]);
    free(set->files);
    free(set->theta);
    free(set->path);
    *set = (picture_set){0};
}

lmg_result set_create(uint32_t rows, uint32_t columns, const char *path, picture_set *set, lmg_error *err)
{
    *set = (picture_set){.rows = rows, .columns = columns};
    const size_t n = rows, m = columns, length = strlen(path);
    set->files = calloc(n * m, sizeof(*set->files));
    set->theta = calloc(2 * (n + m) + 2, sizeof(double));
    set->path = malloc(length + 1);
    if (!set->files || !set->theta || !set->path) {
        set_free(set);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for %zu pictures", path, n * m);
    }
    memcpy(set->path, path, length + 1);
    set->theta_edge = set->theta + n;
    set->phi = set->theta_edge + n + 1;
    set->phi_edge = set->phi + m;
    return LMG_OK;
}

lmg_result set_read_picture(const picture_set *set, uint32_t index, lum_picture *picture, lmg_error *err)
{
    char path[2048];
    if (snprintf(path, sizeof(path), "%s/%s", set->path, set->files[index]) >= (int)sizeof(path))
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.300s...: the name is too long", set->path);
    const lmg_result result = lum_picture_read(path, picture, err);
    if (result == LMG_OK && (picture->width != set->width || picture->height != set->height))
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: is %u x %u pixels, the index says %u x %u", path, picture->width,
                        picture->height, set->width, set->height);
    return result;
}

/* -------------------------------------------------------------------------------------------------------------- source */

typedef struct set_source {
    bake_source source; /* first: a bake_source is cast back */
    picture_set set;
    uint64_t seed, pixels; /* per picture */
    uint32_t samples;      /* photons per pixel */
    double scale;          /* units per lumen */
} set_source;

typedef struct job {
    const set_source *source;
    const lmg_sink *sinks;
    size_t sink_count;
    int64_t units;
    uint64_t photons;
    lmg_result result;
    uint64_t failed_at;
    lmg_error error;
} job;

typedef struct worker {
    lum_picture picture;
    uint32_t at; /* the picture at hand; UINT32_MAX = none */
    int64_t units;
    uint64_t photons;
    lmg_result result;
    uint64_t failed_at;
    lmg_error error;
    bake_batch batch;
} worker;

static void *begin(void *self)
{
    const job *j = self;
    worker *w = calloc(1, sizeof(*w));
    if (w) {
        w->at = UINT32_MAX;
        w->batch.sinks = j->sinks;
        w->batch.sink_count = j->sink_count;
    }
    return w;
}

/* Where a line of sight (from p along -d) first meets the bounds, or, when it passes beside them, the plane through the centre. */
static lmg_vec3 meet(const picture_set *set, lmg_vec3 p, lmg_vec3 d, lmg_vec3 out)
{
    const double o[3] = {p.x, p.y, p.z}, v[3] = {-d.x, -d.y, -d.z};
    const double lo[3] = {set->lo.x, set->lo.y, set->lo.z}, hi[3] = {set->hi.x, set->hi.y, set->hi.z};
    double near = 0, far = INFINITY;
    for (int k = 0; k < 3; ++k) {
        if (v[k] == 0) {
            if (o[k] < lo[k] || o[k] > hi[k])
                far = -1;
            continue;
        }
        const double a = (lo[k] - o[k]) / v[k], b = (hi[k] - o[k]) / v[k];
        near = fmax(near, fmin(a, b));
        far = fmin(far, fmax(a, b));
    }
    const double t = near <= far ? near : set->distance / (d.x * out.x + d.y * out.y + d.z * out.z);
    return (lmg_vec3){o[0] + t * v[0], o[1] + t * v[1], o[2] + t * v[2]};
}

/* The ray of one photon; false when its pixel is dark. */
static bool make_ray(const set_source *s, const lum_picture *picture, uint32_t index, uint64_t pixel, uint64_t number, lmg_ray *ray)
{
    const picture_set *set = &s->set;
    const float *rgb = &picture->rgb[3 * pixel];
    if (!(lmg_luminance(rgb) > 0))
        return false;
    const uint32_t row = index / set->columns, column = index % set->columns;
    lum_rng rng = lum_rng_stream(s->seed, number);
    double xi[4], x, y;
    for (int k = 0; k < 4; ++k)
        xi[k] = lum_rng_next(&rng);
    const set_camera camera = set_camera_at(set, set->theta[row], set->phi[column]);
    const double i = (double)(pixel % set->width), j = (double)(pixel / set->width);
    const double etendue = set_pixel_at(set, i + 0.5, j + 0.5, &x, &y) * set_cell_area(set, row, column);
    set_pixel_at(set, i + xi[0], j + xi[1], &x, &y);
    /* light travels out through (x, y) of the picture: against the line of sight -out + x right + y up */
    const double shorten = 1 / sqrt(1 + x * x + y * y);
    const lmg_vec3 d = mix(camera.out, shorten, camera.right, -x * shorten, camera.up, -y * shorten);
    const lmg_vec3 place = meet(set, set_place(set, camera.out), d, camera.out);
    const double ca = cos(set->theta_edge[row]), cb = cos(set->theta_edge[row + 1]);
    const double cosine = ca + xi[2] * (cb - ca), phi = set->phi_edge[column] + xi[3] * (set->phi_edge[column + 1] - set->phi_edge[column]);
    const lmg_vec3 eye = set_place(set, set_camera_at(set, acos(fmax(-1, fmin(1, cosine))), phi).out);
    const lmg_vec3 to = {eye.x - place.x, eye.y - place.y, eye.z - place.z};
    const double length = sqrt(to.x * to.x + to.y * to.y + to.z * to.z);
    *ray = (lmg_ray){.origin = place, .direction = {to.x / length, to.y / length, to.z / length}, .number = number};
    for (int c = 0; c < 3; ++c)
        ray->flux[c] = (float)((double)rgb[c] * etendue * s->scale / s->samples);
    return true;
}

static void one_photon(const set_source *s, worker *w, uint64_t n, uint64_t number)
{
    const uint64_t per_picture = s->pixels * s->samples;
    const uint32_t index = (uint32_t)(n / per_picture);
    ++w->photons;
    if (!s->set.files[index])
        return;
    if (index != w->at) {
        w->result = set_read_picture(&s->set, index, &w->picture, &w->error);
        w->at = index;
        w->failed_at = number;
        if (w->result != LMG_OK)
            return;
    }
    lmg_ray *ray = bake_batch_next(&w->batch);
    if (!make_ray(s, &w->picture, index, n % s->pixels, number, ray)) {
        --w->batch.count;
        return;
    }
    w->units += llrint(lmg_luminance(ray->flux) * UNIT);
}

static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    const set_source *s = ((const job *)self)->source;
    worker *w = state;
    for (uint64_t n = first; w->result == LMG_OK && n < first + count; ++n) {
        const bool pilot = n >= BAKE_PILOT_FIRST;
        one_photon(s, w, pilot ? bake_pilot_place(n - BAKE_PILOT_FIRST, s->source.photons, PILOT_RUN, s->seed) : n, n);
    }
}

static void end(void *self, void *state)
{
    job *j = self;
    worker *w = state;
    bake_batch_flush(&w->batch);
    j->units += w->units;
    j->photons += w->photons;
    if (w->result != LMG_OK && w->failed_at < j->failed_at) {
        j->failed_at = w->failed_at;
        j->result = w->result;
        j->error = w->error;
    }
    lum_picture_free(&w->picture);
    free(w);
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err)
{
    const set_source *s = (const set_source *)source;
    if (first < BAKE_PILOT_FIRST && (first > source->photons || count > source->photons - first))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "photons up to number %" PRIu64 " of pictures that give %" PRIu64, first + count,
                        source->photons);
    job j = {.source = s, .sinks = sinks, .sink_count = sink_count, .failed_at = UINT64_MAX};
    const bake_work work = {.self = &j, .begin = begin, .chunk = chunk, .end = end};
    const lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result != LMG_OK)
        return result;
    if (j.result != LMG_OK) {
        if (err)
            *err = j.error;
        return j.result;
    }
    tally->photons += j.photons;
    tally->emitted += (double)j.units / UNIT;
    tally->escaped += (double)j.units / UNIT;
    return LMG_OK;
}

static void destroy(bake_source *source)
{
    set_source *s = (set_source *)source;
    set_free(&s->set);
    free(s);
}

/* Reads all pictures once: flux, and the brightest ray. */
static lmg_result scan(set_source *s, lmg_error *err)
{
    const picture_set *set = &s->set;
    lum_picture picture = {0};
    lmg_result result = LMG_OK;
    double total = 0, most = 0;
    for (uint32_t index = 0; result == LMG_OK && index < set->rows * set->columns; ++index) {
        if (!set->files[index])
            continue;
        result = set_read_picture(set, index, &picture, err);
        double sum = 0;
        for (uint64_t k = 0; result == LMG_OK && k < s->pixels; ++k) {
            double x, y;
            const double flux = lmg_luminance(&picture.rgb[3 * k]) *
                                set_pixel_at(set, (double)(k % set->width) + 0.5, (double)(k / set->width) + 0.5, &x, &y) *
                                set_cell_area(set, index / set->columns, index % set->columns);
            sum += flux;
            most = fmax(most, flux);
        }
        total += sum;
    }
    lum_picture_free(&picture);
    if (result != LMG_OK)
        return result;
    if (!(total > 0) || !isfinite(total))
        return lmg_fail(err, LMG_ERROR_INPUT, "%s: its pictures show no light", set->path);
    s->source.flux = total;
    s->scale = (double)s->source.photons / total;
    if (most * s->scale / s->samples * (double)s->source.photons > MOST_UNEVEN)
        return lmg_fail(err, LMG_ERROR_INPUT, "%s: its brightest pixel has %.3g times the mean flux: too uneven to be counted", set->path,
                        most * s->scale);
    return LMG_OK;
}

lmg_result bake_picture_set_source_create(const char *path, uint64_t seed, bake_source **out, bake_picture_set_info *info,
                                          lmg_error *err)
{
    *out = NULL;
    set_source *s = calloc(1, sizeof(*s));
    if (!s)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its pictures", path);
    lmg_result result = set_read_index(path, &s->set, err);
    if (result == LMG_OK) {
        const picture_set *set = &s->set;
        s->pixels = (uint64_t)set->width * set->height;
        const uint64_t all = s->pixels * set->rows * set->columns;
        s->samples = all < FEWEST_PHOTONS ? (uint32_t)((FEWEST_PHOTONS - 1) / all + 1) : 1;
        s->seed = seed;
        s->source = (bake_source){
            .run = run, .destroy = destroy, .photons = all * s->samples, .bounds_min = set->lo, .bounds_max = set->hi};
        result = scan(s, err);
    }
    if (result != LMG_OK) {
        set_free(&s->set);
        free(s);
        return result;
    }
    *info = (bake_picture_set_info){
        .pictures = s->set.rows * s->set.columns,
        .width = s->set.width,
        .height = s->set.height,
        .photometric = !s->set.radiant,
        .distance = s->set.distance,
        .told = s->set.told,
    };
    *out = &s->source;
    return LMG_OK;
}

bool bake_is_picture_set(const char *path)
{
    char index[2048];
    return snprintf(index, sizeof(index), "%s/index.json", path) < (int)sizeof(index) && access(index, F_OK) == 0;
}
