/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Header of an IES TM-25 ray file (layout: docs/rayfiles.md).  Little-endian; a fixed block of 36,288 bytes, spectral tables, labels
 * of further columns, a text, rays.  Makers disagree on the padding of the tables and on whether labels are there, so where the rays
 * start is counted from the front and checked against the rays themselves.
 */
#include "rayfile_inside.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

enum {
    BLOCK = 256,          /* header proper */
    FLAGS = 32,           /* eight, four bytes each */
    TEXT_CHARACTERS = 1000,
    FIXED = BLOCK + FLAGS + LUM_RAY_TEXTS * TEXT_CHARACTERS * 4,
    PADDING = 32,         /* tables end at a multiple of it */
    LABEL = 512,          /* bytes of a further column's name */
    MAX_TABLE_POINTS = 1000000,
    PROBE = 64            /* rays looked at, at either end of the block */
};

static uint64_t round_up(uint64_t x)
{
    return (x + PADDING - 1) / PADDING * PADDING;
}

/* One code point as UTF-8; returns the bytes written. */
static size_t utf8(uint32_t c, char *out)
{
    if (c < 0x20 || c == 0x7f) /* control characters, line ends too: texts are lines of messages */
        c = ' ';
    if (c > 0x10ffff || (c >= 0xd800 && c < 0xe000))
        c = '?';
    if (c < 0x80) {
        out[0] = (char)c;
        return 1;
    }
    if (c < 0x800) {
        out[0] = (char)(0xc0 | c >> 6);
        out[1] = (char)(0x80 | (c & 0x3f));
        return 2;
    }
    if (c < 0x10000) {
        out[0] = (char)(0xe0 | c >> 12);
        out[1] = (char)(0x80 | (c >> 6 & 0x3f));
        out[2] = (char)(0x80 | (c & 0x3f));
        return 3;
    }
    out[0] = (char)(0xf0 | c >> 18);
    out[1] = (char)(0x80 | (c >> 12 & 0x3f));
    out[2] = (char)(0x80 | (c >> 6 & 0x3f));
    out[3] = (char)(0x80 | (c & 0x3f));
    return 4;
}

static lmg_result read_texts(lum_rayfile *file, const uint8_t *fixed, lmg_error *err)
{
    char *out = file->texts = malloc(LUM_RAY_TEXTS * (4 * TEXT_CHARACTERS + 1));
    if (!out)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its texts", file->name);
    const uint8_t *in = fixed + BLOCK + FLAGS;
    for (int t = 0; t < LUM_RAY_TEXTS; ++t, in += 4 * TEXT_CHARACTERS) {
        file->info.texts[t] = out;
        for (int i = 0; i < TEXT_CHARACTERS; ++i) {
            const uint32_t c = ray_u32(in + 4 * i);
            if (c == 0)
                break;
            out += utf8(c, out);
        }
        *out++ = 0;
    }
    return LMG_OK;
}

/* Reads tables from *at on and moves it behind them. */
static lmg_result read_tables(lum_rayfile *file, uint32_t count, uint64_t *at, lmg_error *err)
{
    file->spectra = calloc(count ? count : 1, sizeof(*file->spectra));
    if (!file->spectra)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for %u spectra", file->name, count);
    file->spectrum_count = count;
    uint64_t points = 0;
    for (uint32_t t = 0; t < count; ++t) {
        uint8_t head[4];
        const uint8_t *bytes;
        lmg_result result = lum_ray_fetch(file, *at, 4, head, &bytes, err);
        if (result != LMG_OK)
            return result;
        const int32_t n = ray_i32(bytes);
        points += n > 0 ? (uint64_t)n : 0;
        if (n < 1 || points > MAX_TABLE_POINTS)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its spectral table %u has %d points", file->name, t + 1, n);
        *at += 4;
        uint8_t *buffer = malloc(8 * (size_t)n);
        float *pairs = malloc(8 * (size_t)n);
        result = buffer && pairs ? lum_ray_fetch(file, *at, 8 * (size_t)n, buffer, &bytes, err)
                                 : lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for a spectrum", file->name);
        for (int32_t i = 0; result == LMG_OK && i < n; ++i) {
            const float nm = ray_f32(bytes + 8 * (size_t)i), weight = ray_f32(bytes + 8 * (size_t)i + 4);
            pairs[2 * i] = nm;
            pairs[2 * i + 1] = weight;
            if (!(nm > 0 && nm < 1e7f) || !(weight >= 0 && weight < 1e30f) || (i > 0 && !(nm > pairs[2 * (i - 1)])))
                result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its spectral table %u, point %d: %g nm, weight %g", file->name,
                                  t + 1, i + 1, (double)nm, (double)weight);
        }
        if (result == LMG_OK)
            lum_ray_tabulated(pairs, (size_t)n, &file->spectra[t]);
        free(buffer);
        free(pairs);
        if (result != LMG_OK)
            return result;
        *at += 8 * (uint64_t)n;
    }
    return LMG_OK;
}

static lmg_result read_columns(lum_rayfile *file, const uint8_t *flags, uint32_t extra, lmg_error *err)
{
    static const char *const NAMES[8] = {"position", "direction",   "radiant flux",     "wavelength",
                                         "luminous flux", "Stokes", "tristimulus", "spectrum index"};
    bool has[8];
    for (int i = 0; i < 8; ++i) {
        const int32_t flag = ray_i32(flags + 4 * i);
        if (flag != 0 && flag != 1)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its flag for %s is %d, neither 0 nor 1", file->name, NAMES[i], flag);
        has[i] = flag == 1;
    }
    if (!has[0] || !has[1])
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its rays have no %s", file->name, has[0] ? "direction" : "position");
    if (!has[2] && !has[4])
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its rays have no flux, neither radiant nor luminous", file->name);
    if (has[6] && !has[4])
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: tristimulus values X, Z without luminous flux, which is Y", file->name);
    ray_columns *c = &file->columns;
    int at = 0;
    c->position = at, at += 3;
    c->direction = at, at += 3;
    if (has[2])
        c->radiant = at++;
    if (has[3])
        c->wavelength = at++;
    if (has[4])
        c->luminous = at++;
    if (has[5]) /* three Stokes parameters and the axis of the ellipse */
        at += 6;
    if (has[6])
        c->x = at, c->z = at + 1, at += 2;
    if (has[7])
        c->spectrum = at++;
    c->count = (uint32_t)at + extra;
    file->info.has_polarization = has[5];
    file->info.extra_columns = extra;
    if (has[5])
        lum_ray_remark(file, "polarization (Stokes parameters) is skipped");
    if (extra)
        lum_ray_remark(file, "%u further column%s skipped", extra, extra > 1 ? "s are" : " is");
    return LMG_OK;
}

/* Where the rays start: behind what the header tells of, or - as some makers have it - with tables that aren't padded, or without the
 * labels; where rays are is known by their unit directions. */
static lmg_result find_rays(lum_rayfile *file, uint64_t tables_end, uint64_t labels, uint64_t text, lmg_error *err)
{
    const uint64_t record = 4 * (uint64_t)file->columns.count, rays = file->info.rays;
    const uint64_t padded = round_up(tables_end);
    const uint64_t candidates[4] = {padded + labels + text, padded + text, tables_end + labels + text, tables_end + text};
    const uint64_t room = file->size > tables_end ? (file->size - tables_end) / record : 0;
    if (rays > room)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: its header tells of %" PRIu64 " rays, it has room for %" PRIu64,
                        file->name, rays, room);
    bool fits = false;
    for (int i = 0; i < 4; ++i) {
        if (candidates[i] > file->size || file->size - candidates[i] < rays * record)
            continue;
        fits = true;
        const size_t probe = rays < PROBE ? (size_t)rays : PROBE;
        if (!lum_ray_plausible(file, candidates[i], 0, probe) || !lum_ray_plausible(file, candidates[i], rays - probe, probe))
            continue;
        file->start = candidates[i];
        if (i > 0 && candidates[i] != candidates[0])
            lum_ray_remark(file, "rays start %" PRId64 " bytes from where the header puts them, as some makers write it",
                           (int64_t)(candidates[i] - candidates[0]));
        if (candidates[i] + rays * record < file->size)
            lum_ray_remark(file, "%" PRIu64 " bytes behind the last ray are ignored", file->size - candidates[i] - rays * record);
        return LMG_OK;
    }
    if (!fits)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: its header tells of %" PRIu64 " rays of %" PRIu64 " bytes", file->name,
                        rays, record);
    return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                    "%s: what should be rays has no unit directions: its columns or the number of rays aren't those of its header",
                    file->name);
}

/* A header's total: unknown is NaN, by some makers with its bytes swapped, or 0. */
static double total(const uint8_t *bytes)
{
    const float value = ray_f32(bytes);
    return lum_ray_unknown(value) || !(value > 0) || isinf(value) ? (double)NAN : (double)value;
}

lmg_result lum_ray_open_tm25(lum_rayfile *file, lmg_error *err)
{
    uint8_t *buffer = malloc(FIXED);
    if (!buffer)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its header", file->name);
    const uint8_t *h;
    lum_ray_info *info = &file->info;
    lmg_result result = lum_ray_fetch(file, 0, FIXED, buffer, &h, err);
    if (result != LMG_OK)
        goto cleanup;
    const int32_t version = ray_i32(h + 4), spectral = ray_i32(h + 60);
    const int32_t tables = ray_i32(h + 76), extra = ray_i32(h + 80), text = ray_i32(h + 84);
    info->luminous_lm = total(h + 12);
    info->radiant_W = total(h + 16);
    info->rays = (uint64_t)ray_u32(h + 20) | (uint64_t)ray_u32(h + 24) << 32;
    for (int i = 0; i < 28 && h[28 + i]; ++i) {
        info->date[i] = h[28 + i] >= 0x20 && h[28 + i] < 0x7f ? (char)h[28 + i] : '?';
    }
    if (version < 2013 || version > 2100) {
        result = lmg_fail(err, LMG_ERROR_FILE_VERSION, "%s: version %d of TM-25 isn't known (2013 is)", file->name, version);
        goto cleanup;
    }
    if (version != 2013)
        lum_ray_remark(file, "TM-25 version %d is read as 2013", version);
    if (info->rays == 0 || spectral < 0 || spectral > 4 || tables < 0 || tables > 10000 || extra < 0 ||
        extra > RAY_MAX_COLUMNS - 32 || text < 0) {
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                          "%s: its header can't be: %" PRIu64 " rays, spectral identifier %d, %d tables, %d further columns, %d bytes of text",
                          file->name, info->rays, spectral, tables, extra, text);
        goto cleanup;
    }
    result = read_columns(file, h + BLOCK, (uint32_t)extra, err);
    if (result == LMG_OK && spectral == 2 && file->columns.wavelength < 0)
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: spectral identifier 2, but rays without wavelength", file->name);
    if (result == LMG_OK && (spectral == 3 || spectral == 4) && tables == 0)
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: spectral identifier %d, but no spectral table", file->name, spectral);
    if (result == LMG_OK && spectral == 4 && file->columns.spectrum < 0)
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: spectral identifier 4, but rays without a table's number", file->name);
    if (result != LMG_OK)
        goto cleanup;
    if (spectral == 1) {
        const float nm = ray_f32(h + 64);
        if (nm > 1 && nm < 1e7f)
            info->wavelength_nm = (double)nm;
        else
            lum_ray_remark(file, "tells of a single wavelength, but not which");
    }
    uint64_t at = FIXED;
    result = read_tables(file, (uint32_t)tables, &at, err);
    if (result == LMG_OK)
        result = read_texts(file, h, err);
    if (result == LMG_OK)
        result = find_rays(file, at, (uint64_t)extra * LABEL, (uint64_t)text, err);
cleanup:
    free(buffer);
    return result;
}
