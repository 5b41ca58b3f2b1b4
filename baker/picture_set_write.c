/* SPDX-License-Identifier: Apache-2.0 */
/* A virtual near-field goniophotometer: luminance pictures of a box from all around.  Relies on POSIX mkdtemp and rename. */
#include "picture_set.h"

#include "bake.h"
#include "parallel.h"
#include "picture_set_inside.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Rays per pixel each way: four in all, regular; cells of boxes are wider than pixels of pictures taken to look at them. */
enum { RAYS = 2 };
/* Pictures computed at once, so that threads have work whatever a picture's size: about so many pixels. */
static const uint64_t BLOCK_PIXELS = 1u << 18;

typedef struct work {
    const lmg_field *field;
    const picture_set *set;
    lmg_filter filter; /* trees are what a camera sees; cells aren't interpolated, so that the set has their flux */
    uint32_t first;    /* picture */
    lum_picture *pictures;
} work;

static void *begin(void *self)
{
    return self;
}

static void end(void *self, void *state)
{
    (void)self;
    (void)state;
}

static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    (void)state;
    const work *w = self;
    const picture_set *set = w->set;
    const uint64_t pixels = (uint64_t)set->width * set->height;
    for (uint64_t n = first; n < first + count; ++n) {
        const uint32_t local = (uint32_t)(n / pixels), index = w->first + local;
        const uint64_t pixel = n % pixels;
        const set_camera c = set_camera_at(set, set->theta[index / set->columns], set->phi[index % set->columns]);
        const lmg_vec3 eye = set_place(set, c.out);
        double sum[3] = {0, 0, 0};
        for (int k = 0; k < RAYS * RAYS; ++k) {
            double x, y;
            set_pixel_at(set, (double)(pixel % set->width) + (k % RAYS + 0.5) / RAYS, (double)(pixel / set->width) + (k / RAYS + 0.5) / RAYS,
                         &x, &y);
            const double shorten = 1 / sqrt(1 + x * x + y * y);
            const lmg_vec3 d = {shorten * (c.out.x - x * c.right.x - y * c.up.x), shorten * (c.out.y - x * c.right.y - y * c.up.y),
                                shorten * (c.out.z - x * c.right.z - y * c.up.z)};
            float rgb[3];
            lmg_field_radiance(w->field, eye, d, w->filter, rgb, NULL);
            for (int i = 0; i < 3; ++i)
                sum[i] += (double)rgb[i];
        }
        for (int i = 0; i < 3; ++i)
            w->pictures[local].rgb[3 * pixel + (uint64_t)i] = (float)(sum[i] / (RAYS * RAYS));
    }
}

/* Flux that a picture stands for; 0 and nothing but zeros go together. */
static double flux_of(const picture_set *set, const lum_picture *picture, uint32_t index, bool *dark)
{
    double sum = 0;
    *dark = true;
    for (size_t k = 0; k < (size_t)set->width * set->height; ++k) {
        double x, y;
        const double luminance = lmg_luminance(&picture->rgb[3 * k]);
        *dark = *dark && luminance == 0;
        sum += luminance * set_pixel_at(set, (double)(k % set->width) + 0.5, (double)(k / set->width) + 0.5, &x, &y);
    }
    return sum * set_cell_area(set, index / set->columns, index % set->columns);
}

static uint64_t file_bytes(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 ? (uint64_t)s.st_size : 0;
}

static lmg_result write_block(picture_set *set, const char *folder, uint32_t first, uint32_t count, const lum_picture *pictures,
                              bake_picture_set_report *report, lmg_error *err)
{
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t index = first + i;
        bool dark;
        report->flux += flux_of(set, &pictures[i], index, &dark);
        report->raw_bytes += (uint64_t)set->width * set->height * (pictures[i].colour ? 3 : 1) * sizeof(float);
        ++report->pictures;
        if (dark) {
            ++report->dark;
            continue;
        }
        char name[32], path[2048];
        snprintf(name, sizeof(name), "p%05u.exr", index);
        if (snprintf(path, sizeof(path), "%s/%s", folder, name) >= (int)sizeof(path))
            return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s...: the name is too long", folder);
        const lmg_result result = lum_picture_write(&pictures[i], path, err);
        if (result != LMG_OK)
            return result;
        report->stored_bytes += file_bytes(path);
        set->files[index] = strdup(name);
        if (!set->files[index])
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a name");
    }
    return LMG_OK;
}

static lmg_result take_pictures(const lmg_field *field, const bake_picture_set_options *o, picture_set *set, const char *folder,
                                bake_picture_set_report *report, lmg_error *err)
{
    const uint64_t pixels = (uint64_t)set->width * set->height;
    const uint32_t all = set->rows * set->columns;
    uint32_t block = (uint32_t)(BLOCK_PIXELS / pixels);
    block = block < 1 ? 1 : block > all ? all : block;
    lum_picture *pictures = calloc(block, sizeof(*pictures));
    lmg_result result = pictures ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for pictures");
    const lmg_layout *layout = lmg_field_layout(field);
    const bool grey = layout->channels == 1 && layout->colour[0] == layout->colour[1] && layout->colour[1] == layout->colour[2];
    for (uint32_t i = 0; result == LMG_OK && i < block; ++i) {
        result = lum_picture_create(set->width, set->height, &pictures[i], err);
        pictures[i].colour = !grey;
    }
    for (uint32_t first = 0; result == LMG_OK && first < all; first += block) {
        const uint32_t count = all - first < block ? all - first : block;
        work w = {.field = field,
                  .set = set,
                  .filter = lmg_field_trees(field).trees > 0 ? LMG_LINEAR : LMG_NEAREST,
                  .first = first,
                  .pictures = pictures};
        const bake_work job = {.self = &w, .begin = begin, .chunk = chunk, .end = end};
        result = o->stop && *o->stop ? lmg_fail(err, LMG_ERROR_INTERNAL, "interrupted; nothing was written")
                                     : bake_parallel(&job, 0, count * pixels, o->threads, err);
        if (result == LMG_OK)
            result = write_block(set, folder, first, count, pictures, report, err);
    }
    for (uint32_t i = 0; pictures && i < block; ++i)
        lum_picture_free(&pictures[i]);
    free(pictures);
    return result;
}

/* Removes what has been written so far. */
static void discard(const picture_set *set, const char *folder)
{
    char path[2048];
    for (uint32_t i = 0; i < set->rows * set->columns; ++i)
        if (set->files[i] && snprintf(path, sizeof(path), "%s/%s", folder, set->files[i]) < (int)sizeof(path))
            unlink(path);
    /* the picture that failed, which has no name in the set */
    for (uint32_t i = 0; i < set->rows * set->columns; ++i)
        if (!set->files[i] && snprintf(path, sizeof(path), "%s/p%05u.exr", folder, i) < (int)sizeof(path))
            unlink(path);
    if (snprintf(path, sizeof(path), "%s/index.json", folder) < (int)sizeof(path))
        unlink(path);
    rmdir(folder);
}

static lmg_result prepare(const lmg_field *field, const bake_picture_set_options *o, const char *folder, picture_set *set, lmg_error *err)
{
    const double pi = 3.14159265358979323846;
    const double step = o->step > 0 ? o->step : 5;
    const uint32_t rows = (uint32_t)lround(180 / step);
    if (rows < 2 || rows > 1800 || fabs(rows * step - 180) > 1e-9 * 180)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a step of %g degrees doesn't divide 180 into 2 to 1800 parts", step);
    lmg_result result = set_create(rows, 2 * rows, folder, set, err);
    if (result != LMG_OK)
        return result;
    for (uint32_t i = 0; i < rows; ++i)
        set->theta[i] = (i + 0.5) * pi / rows;
    for (uint32_t j = 0; j < 2 * rows; ++j)
        set->phi[j] = (j + 0.5) * pi / rows;
    set_make_edges(set);
    const lmg_layout *layout = lmg_field_layout(field);
    set->lo = layout->bounds_min;
    set->hi = layout->bounds_max;
    set->centre = (lmg_vec3){0.5 * (set->lo.x + set->hi.x), 0.5 * (set->lo.y + set->hi.y), 0.5 * (set->lo.z + set->hi.z)};
    const lmg_vec3 e = {set->hi.x - set->lo.x, set->hi.y - set->lo.y, set->hi.z - set->lo.z};
    const double radius = 0.5 * sqrt(e.x * e.x + e.y * e.y + e.z * e.z);
    set->distance = o->distance > 0 ? o->distance : 4 * radius;
    if (!(set->distance > 1.001 * radius)) {
        set_free(set);
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a camera at %g m from the centre isn't outside the luminaire (radius %g m)", o->distance,
                        radius);
    }
    /* the whole sphere around the bounds is in the picture, and no more */
    set->half_field = radius / sqrt((set->distance - radius) * (set->distance + radius));
    set->width = set->height = o->pixels ? o->pixels : 64;
    set->axis = (lmg_vec3){0, 0, 1};
    set->zero = (lmg_vec3){1, 0, 0};
    set->radiant = o->radiant;
    return LMG_OK;
}

lmg_result bake_picture_set_write(const lmg_field *field, const bake_picture_set_options *o, const char *folder,
                                  bake_picture_set_report *report, lmg_error *err)
{
    *report = (bake_picture_set_report){0};
    const double began = bake_clock();
    char temporary[2048];
    picture_set set;
    size_t length = strlen(folder);
    while (length > 1 && folder[length - 1] == '/')
        --length;
    if (snprintf(temporary, sizeof(temporary), "%.*s.XXXXXX", (int)(length < 1900 ? length : 1900), folder) > 1900)
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s...: the name is too long", folder);
    lmg_result result = prepare(field, o, folder, &set, err);
    if (result != LMG_OK)
        return result;
    if (!mkdtemp(temporary)) {
        set_free(&set);
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't write there: %s", folder, strerror(errno));
    }
    const mode_t mask = umask(0);
    umask(mask);
    chmod(temporary, 0777 & ~mask);
    result = take_pictures(field, o, &set, temporary, report, err);
    if (result == LMG_OK)
        result = set_write_index(&set, temporary, report->flux, o->origin, err);
    char index[2100];
    snprintf(index, sizeof(index), "%s/index.json", temporary);
    report->stored_bytes += file_bytes(index);
    if (result == LMG_OK && rename(temporary, folder) != 0)
        result = lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't put the finished folder in place: %s", folder, strerror(errno));
    if (result != LMG_OK)
        discard(&set, temporary);
    report->distance = set.distance;
    report->seconds = bake_clock() - began;
    set_free(&set);
    return result;
}
