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
/* A photon lights one cell at most, and that takes no more than this in three colours; and there are fewer tiles than this times the root of the cells. */
static const double PHOTON_BYTES = 10, TILES = 8;
/* A trial of fewer cells says nothing: its windows and rectangles are of a few cells each. */
static const double LEAST_TRIAL = 4000;
static const uint64_t LEAST_CELLS = 20000;
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

/* A box of the pilot's rays. */
static lmg_result try_cells(const lmg_ray *rays, size_t count, const lmg_fit_options *fit, double cells, trial *out, lmg_error *err)
{
    lmg_fit_options wishes = *fit;
    wishes.cells = (uint64_t)cells;
    lmg_layout layout;
    lmg_accumulator *accumulator = NULL;
    lmg_field *field = NULL;
    lmg_result result = lmg_layout_fit(rays, count, &wishes, &layout, NULL, err);
    if (result == LMG_OK)
        result = lmg_accumulator_create(&layout, &accumulator, err);
    if (result == LMG_OK) {
        lmg_accumulator_deposit(accumulator, rays, count);
        result = lmg_field_reconstruct(accumulator, 1, NULL, &field, err);
    }
    *out = (trial){.cells = (double)wishes.cells}; /* the slabs that catch what passes beside are much the same in all boxes */
    if (result == LMG_OK) {
        for (uint32_t i = 0; i < layout.slab_count; ++i) {
            const lmg_slab *s = &layout.slabs[i];
            out->tiles += (double)s->nu * s->nv;
        }
        result = bake_size_of(field, &out->bytes, err);
    }
    lmg_field_destroy(field);
    lmg_accumulator_destroy(accumulator);
    return result;
}

lmg_result bake_size_choose(const lmg_ray *rays, size_t count, double pilot_photons, double photons, const lmg_fit_options *fit, double bytes,
                            uint64_t most, bake_size *out, lmg_error *err)
{
    const double density = fmax(photons / pilot_photons, 1);
    uint64_t cells = most;
    if (HEADER_BYTES + PHOTON_BYTES * photons + TILE_BYTES * TILES * sqrt((double)most) <= bytes) {
        *out = (bake_size){.cells = most};
        return LMG_OK;
    }
    for (;;) {
        trial t;
        const lmg_result result = try_cells(rays, count, fit, fmax((double)cells / density, fmin(LEAST_TRIAL, (double)cells)), &t, err);
        if (result != LMG_OK)
            return result;
        /* tiles become more as cells do, and larger alike */
        const double larger = fmax((double)cells / t.cells, 1), each = fmax(t.bytes - HEADER_BYTES / 2 - TILE_BYTES * t.tiles, 0) / t.cells;
        *out = (bake_size){.cells = cells, .bytes = HEADER_BYTES + TILE_BYTES * t.tiles * sqrt(larger) + each * (double)cells, .limited = cells < most};
        if (out->bytes <= bytes || cells <= LEAST_CELLS)
            return LMG_OK;
        /* fewer cells get more photons each, so that bytes go down more slowly than cells */
        const double fewer = (double)cells * fmin(AIM * bytes / out->bytes, 0.8);
        cells = fewer > (double)LEAST_CELLS ? (uint64_t)fewer : LEAST_CELLS;
    }
}
