/* SPDX-License-Identifier: Apache-2.0 */
/* The size of box files foretold: trials with the pilot's rays. */
#include "size.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Of a file beside its cells, about: headers and texts; what a tile takes however empty it is. */
static const double HEADER_BYTES = 8000, TILE_BYTES = 64;
/* A photon lights one cell at most, and that takes no more than this in three colours. */
static const double PHOTON_BYTES = 10;
/* A trial of fewer cells says nothing: its windows and rectangles are of a few cells each. */
static const double LEAST_TRIAL = 4000;
static const uint64_t LEAST_CELLS = 20000;
/* The second trial's share of the rays and cells, and what bytes of light on a set of two of the four dimensions grow by: the least
 * that a lamp can do. */
enum { SMALLER = 4 };
static const double LEAST_GROWTH = 0.5;
/* Part of the size that is aimed at: trials are off by about a tenth. */
static const double AIM = 0.9;

lmg_result bake_size_of(const lmg_field *field, double *bytes, lmg_error *err)
{
    const char *base = getenv("TMPDIR");
    char path[512];
    if ((size_t)snprintf(path, sizeof(path), "%s/lumibake-size-XXXXXX", base ? base : "/tmp") >= sizeof(path))
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "TMPDIR is too long a name");
    const int file = mkstemp(path);
    if (file < 0)
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.400s: can't create a temporary file: %s; set TMPDIR", path, strerror(errno));
    close(file);
    const lmg_result result = lmg_field_write_rounded(field, path, BAKE_ROUNDING, NULL, err);
    struct stat status = {0};
    if (result == LMG_OK && stat(path, &status) == 0)
        *bytes = (double)status.st_size;
    unlink(path);
    return result;
}

typedef struct trial {
    double cells, tiles, bytes;
} trial;

/* Of a layout's slabs, without those that catch what passes beside: they are much the same in all boxes. */
static double cells_of(const lmg_layout *layout)
{
    double cells = 0;
    for (uint32_t i = 0; i + 6 < layout->slab_count; ++i) {
        const lmg_slab *s = &layout->slabs[i];
        cells += (double)s->nu * s->nv * s->ns * s->nt;
    }
    return cells;
}

static double tiles_of(const lmg_layout *layout)
{
    double tiles = 0;
    for (uint32_t i = 0; i < layout->slab_count; ++i)
        tiles += (double)layout->slabs[i].nu * layout->slabs[i].nv;
    return tiles;
}

/* What a trial's cells take; never nothing. */
static double bytes_of_cells(const trial *t)
{
    return fmax(t->bytes - HEADER_BYTES / 2 - TILE_BYTES * t->tiles, 1);
}

/* A slab's cells, fewer in all by a factor. */
static uint32_t coarser(uint32_t n, double factor)
{
    const double m = floor((double)n * pow(factor, 0.25) + 0.5);
    return m > 1 ? (uint32_t)m : 1;
}

/* A box of the pilot's rays in cells that are fewer by a factor. */
static lmg_result try_cells(const lmg_ray *rays, size_t count, lmg_layout layout, double factor, trial *out, lmg_error *err)
{
    lmg_accumulator *accumulator = NULL;
    lmg_field *field = NULL;
    *out = (trial){0};
    for (uint32_t i = 0; i < layout.slab_count; ++i) {
        lmg_slab *s = &layout.slabs[i];
        s->nu = coarser(s->nu, factor);
        s->nv = coarser(s->nv, factor);
        s->ns = coarser(s->ns, factor);
        s->nt = coarser(s->nt, factor);
    }
    out->cells = cells_of(&layout);
    out->tiles = tiles_of(&layout);
    lmg_result result = lmg_accumulator_create(&layout, &accumulator, err);
    if (result == LMG_OK) {
        lmg_accumulator_deposit(accumulator, rays, count);
        result = lmg_field_reconstruct(accumulator, 1, NULL, &field, err);
    }
    if (result == LMG_OK)
        result = bake_size_of(field, &out->bytes, err);
    lmg_field_destroy(field);
    lmg_accumulator_destroy(accumulator);
    return result;
}

lmg_result bake_size_choose(const lmg_ray *rays, size_t count, double pilot_photons, double photons, const lmg_fit_options *fit,
                            double bytes, uint64_t most, lmg_layout *layout, char why[1024], bake_size *out, lmg_error *err)
{
    const double density = fmax(photons / pilot_photons, 1);
    lmg_fit_options wishes = *fit;
    wishes.cells = most;
    for (;;) {
        lmg_result result = lmg_layout_fit(rays, count, &wishes, layout, why, err);
        if (result != LMG_OK)
            return result;
        *out = (bake_size){.cells = wishes.cells, .limited = wishes.cells < most};
        const double cells = cells_of(layout);
        if (HEADER_BYTES + PHOTON_BYTES * photons + TILE_BYTES * tiles_of(layout) <= bytes)
            return LMG_OK;
        const double factor = 1 / fmax(fmin(density, cells / LEAST_TRIAL), 1);
        trial t, small;
        result = try_cells(rays, count, *layout, factor, &t, err);
        if (result == LMG_OK)
            result = try_cells(rays, count / SMALLER, *layout, factor / SMALLER, &small, err);
        if (result != LMG_OK)
            return result;
        /* edges matter less the finer cells are, so the exponent is between what the trials show and 1 */
        const double shown = log(bytes_of_cells(&t) / bytes_of_cells(&small)) / log(fmax(t.cells / small.cells, 1.5));
        const double exponent = 0.5 * (1 + fmin(fmax(shown, LEAST_GROWTH), 1));
        out->bytes = HEADER_BYTES + TILE_BYTES * tiles_of(layout) + bytes_of_cells(&t) * pow(cells / fmax(t.cells, 1), exponent);
        if (out->bytes <= bytes || wishes.cells <= LEAST_CELLS)
            return LMG_OK;
        /* fewer cells get more photons each, so that bytes go down more slowly still; and 0.8 is a step that is worth a fit */
        const double fewer = fmin((double)wishes.cells, cells) * fmin(pow(AIM * bytes / out->bytes, 1 / exponent), 0.8);
        wishes.cells = fewer > (double)LEAST_CELLS ? (uint64_t)fewer : LEAST_CELLS;
        wishes.fewer_cells = false; /* photons are worth more than the size allows, so all that it allows are taken */
    }
}
