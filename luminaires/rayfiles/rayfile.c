/* SPDX-License-Identifier: Apache-2.0 */
/* Opening ray files of any format and decoding their records.  Relies on POSIX pread: readers share one descriptor. */
#include "rayfile_inside.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

/* A direction's length may be off by so much before the record is taken for damaged: files in use are good to 1e-4, texts with few
 * digits to 1e-3; what isn't a direction at all is within these bounds by chance only. */
static const double DIRECTION_SLACK = 0.02;
/* Below and above these a flux is no flux: the smallest that a file could mean is a photon's energy, 1e-19 J; the sun gives 4e26 W. */
static const float LEAST_FLUX = 1e-30f, MOST_FLUX = 1e30f;
/* X/Y and Z/Y beyond this aren't those of a light; of the deepest violet they are 33 and 155. */
static const double MOST_COLOUR = 1e6;

const char *lum_ray_format_name(lum_ray_format format)
{
    static const char *const NAMES[] = {"none", "IES TM-25", "Zemax binary", "Zemax text", "LightTools binary", "LightTools ASCII"};
    return (unsigned)format < sizeof(NAMES) / sizeof(NAMES[0]) ? NAMES[format] : NAMES[0];
}

static bool ends_with(const char *text, const char *end)
{
    const size_t n = strlen(text), m = strlen(end);
    if (n < m)
        return false;
    for (size_t i = 0; i < m; ++i)
        if (tolower((unsigned char)text[n - m + i]) != end[i])
            return false;
    return true;
}

lum_ray_format lum_ray_format_of_name(const char *path)
{
    return ends_with(path, ".tm25ray") ? LUM_RAYS_TM25
           : ends_with(path, ".dat")   ? LUM_RAYS_ZEMAX
           : ends_with(path, ".ray")   ? LUM_RAYS_LIGHTTOOLS
                                       : LUM_RAYS_NONE;
}

/* Whether text starts with a line of 7 or 8 numbers: a Zemax text file has nothing else to be known by. */
static bool starts_with_columns(const char *text, size_t size)
{
    char line[RAY_MAX_LINE + 1];
    size_t n = 0;
    while (n < size && n < RAY_MAX_LINE && text[n] && text[n] != '\n' && text[n] != '\r') {
        line[n] = text[n];
        ++n;
    }
    line[n] = 0;
    int columns = 0;
    for (const char *c = line; *c;) {
        char *end;
        (void)strtod(c, &end);
        if (end == c)
            break;
        ++columns;
        c = end + strspn(end, " \t,");
        if (!*c)
            return columns == 7 || columns == 8;
    }
    return false;
}

/* By the first bytes; size: of the block at hand. */
static lum_ray_format format_of_bytes(const uint8_t *bytes, size_t size)
{
    if (size >= 4 && !memcmp(bytes, "TM25", 4))
        return LUM_RAYS_TM25;
    if (size >= 4 && !memcmp(bytes, "LTRF", 4))
        return LUM_RAYS_LIGHTTOOLS;
    if (size >= 4 && ray_u32(bytes) == 1010)
        return LUM_RAYS_ZEMAX;
    const char *text = (const char *)bytes;
    const char *head = "# LightTools", *version = "lt_rdf_version";
    if (size >= strlen(head) && !memcmp(text, head, strlen(head)))
        return LUM_RAYS_LIGHTTOOLS_TEXT;
    for (size_t i = 0; i + strlen(version) <= size && bytes[i]; ++i)
        if (!memcmp(text + i, version, strlen(version)))
            return LUM_RAYS_LIGHTTOOLS_TEXT;
    return starts_with_columns(text, size) ? LUM_RAYS_ZEMAX_TEXT : LUM_RAYS_NONE;
}

lum_ray_format lum_ray_format_of_file(const char *path)
{
    uint8_t bytes[RAY_MAX_LINE];
    const int descriptor = open(path, O_RDONLY | O_CLOEXEC);
    if (descriptor < 0)
        return LUM_RAYS_NONE;
    const ssize_t n = pread(descriptor, bytes, sizeof(bytes), 0);
    close(descriptor);
    return n > 0 ? format_of_bytes(bytes, (size_t)n) : LUM_RAYS_NONE;
}

/* --------------------------------------------------------------------------------------------------------------- bytes */

lmg_result lum_ray_fetch(const lum_rayfile *file, uint64_t offset, size_t count, void *buffer, const uint8_t **out, lmg_error *err)
{
    *out = NULL;
    if (offset > file->size || count > file->size - offset)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: bytes %" PRIu64 " to %" PRIu64 " are missing, it has %" PRIu64,
                        file->name, offset, offset + count, file->size);
    if (file->descriptor < 0) {
        *out = file->memory + offset;
        return LMG_OK;
    }
    size_t done = 0;
    while (done < count) {
        const ssize_t n = pread(file->descriptor, (uint8_t *)buffer + done, count - done, (off_t)(offset + done));
        if (n < 0 && errno == EINTR)
            continue;
        if (n <= 0)
            return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: can't be read at byte %" PRIu64 ": %s", file->name, offset + done,
                            n < 0 ? strerror(errno) : "it became shorter while being read");
        done += (size_t)n;
    }
    *out = buffer;
    return LMG_OK;
}

void lum_ray_set_columns(lum_rayfile *file, bool positions, bool photometric, bool wavelength)
{
    ray_columns *c = &file->columns;
    c->position = positions ? 0 : -1;
    c->direction = positions ? 3 : 0;
    int at = c->direction + 3;
    *(photometric ? &c->luminous : &c->radiant) = at++;
    if (wavelength)
        c->wavelength = at++;
    c->count = (uint32_t)at;
}

void lum_ray_remark(lum_rayfile *file, const char *format, ...)
{
    if (file->remark_count == RAY_MAX_REMARKS)
        return;
    va_list args;
    va_start(args, format);
    vsnprintf(file->remarks[file->remark_count++], RAY_REMARK_SIZE, format, args);
    va_end(args);
}

bool lum_ray_unknown(float value)
{
    if (isnan(value))
        return true;
    uint8_t bytes[4];
    ray_put_f32(bytes, value);
    const uint32_t swapped = (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
    /* Written by big-endian software: all exponent bits, some of the mantissa.  Numbers that mean something look like that only
     * when they end in 7f80.. to 7fff: tiny ones are told apart, by LEAST_FLUX, from quantities. */
    return (swapped & 0x7f800000u) == 0x7f800000u && (swapped & 0x007fffffu) != 0 && fabsf(value) < LEAST_FLUX;
}

bool lum_ray_plausible(const lum_rayfile *file, uint64_t start, uint64_t first, size_t n)
{
    const size_t record = 4 * (size_t)file->columns.count;
    uint8_t *buffer = malloc(record);
    bool good = buffer != NULL;
    for (size_t i = 0; good && i < n; ++i) {
        const uint8_t *bytes;
        if (lum_ray_fetch(file, start + (first + i) * record, record, buffer, &bytes, NULL) != LMG_OK) {
            good = false;
            break;
        }
        double length = 0;
        for (int k = 0; k < 3; ++k) {
            const double d = (double)ray_f32(bytes + 4 * (file->columns.direction + k));
            length += d * d;
            good = good && (file->columns.position < 0 || isfinite(ray_f32(bytes + 4 * (file->columns.position + k))));
        }
        good = good && fabs(sqrt(length) - 1) <= DIRECTION_SLACK;
    }
    free(buffer);
    return good;
}

/* ------------------------------------------------------------------------------------------------------------- opening */

static lmg_result open_any(lum_rayfile *file, lum_ray_flux flux, lmg_error *err)
{
    uint8_t buffer[RAY_MAX_LINE];
    const uint8_t *head;
    const size_t n = file->size < sizeof(buffer) ? (size_t)file->size : sizeof(buffer);
    lmg_result result = lum_ray_fetch(file, 0, n, buffer, &head, err);
    if (result != LMG_OK)
        return result;
    lum_ray_info *info = &file->info;
    info->format = format_of_bytes(head, n);
    info->luminous_lm = info->radiant_W = info->wavelength_nm = NAN;
    for (int i = 0; i < LUM_RAY_TEXTS; ++i)
        info->texts[i] = "";
    file->columns = (ray_columns){-1, -1, -1, -1, -1, -1, -1, -1, 0};
    file->metres = 1e-3;
    file->nanometres = 1;
    switch (info->format) {
    case LUM_RAYS_TM25:
        result = lum_ray_open_tm25(file, err);
        break;
    case LUM_RAYS_ZEMAX:
        result = lum_ray_open_zemax(file, err);
        break;
    case LUM_RAYS_LIGHTTOOLS:
        result = lum_ray_open_lighttools(file, err);
        break;
    case LUM_RAYS_ZEMAX_TEXT:
        result = lum_ray_open_zemax_text(file, err);
        break;
    case LUM_RAYS_LIGHTTOOLS_TEXT:
        result = lum_ray_open_lighttools_text(file, err);
        break;
    case LUM_RAYS_NONE:
    default:
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: isn't a ray file that is known (IES TM-25, Zemax binary or text, LightTools binary or ASCII)", file->name);
    }
    if (result != LMG_OK)
        return result;
    const ray_columns *c = &file->columns;
    info->has_luminous = c->luminous >= 0;
    info->has_radiant = c->radiant >= 0;
    info->has_wavelength = c->wavelength >= 0;
    info->has_tristimulus = c->x >= 0;
    info->has_spectrum_index = c->spectrum >= 0;
    info->spectra = file->spectrum_count;
    if (file->index == NULL)
        info->record_bytes = 4 * c->count;
    return lum_ray_decide_flux(file, flux, err);
}

static lmg_result create(const char *name, lum_rayfile **out, lmg_error *err)
{
    lum_rayfile *file = calloc(1, sizeof(*file));
    const size_t size = strlen(name) + 1;
    if (file)
        file->name = malloc(size);
    if (!file || !file->name) {
        free(file);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a ray file");
    }
    memcpy(file->name, name, size);
    file->descriptor = -1;
    *out = file;
    return LMG_OK;
}

lmg_result lum_rayfile_open(const char *path, lum_ray_flux flux, lum_rayfile **out, lmg_error *err)
{
    *out = NULL;
    lum_rayfile *file = NULL;
    lmg_result result = create(path, &file, err);
    if (result != LMG_OK)
        return result;
    struct stat status;
    file->descriptor = open(path, O_RDONLY | O_CLOEXEC);
    if (file->descriptor < 0 || fstat(file->descriptor, &status) != 0)
        result = lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: can't be opened: %s", path, strerror(errno));
    else if (!S_ISREG(status.st_mode))
        result = lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: isn't a file", path);
    if (result == LMG_OK) {
        file->size = (uint64_t)status.st_size;
        result = open_any(file, flux, err);
    }
    if (result != LMG_OK) {
        lum_rayfile_close(file);
        return result;
    }
    *out = file;
    return LMG_OK;
}

lmg_result lum_rayfile_open_memory(const void *bytes, size_t size, const char *name, lum_ray_flux flux, lum_rayfile **out,
                                   lmg_error *err)
{
    *out = NULL;
    lum_rayfile *file = NULL;
    lmg_result result = create(name ? name : "rays", &file, err);
    if (result != LMG_OK)
        return result;
    file->memory = bytes;
    file->size = size;
    result = open_any(file, flux, err);
    if (result != LMG_OK) {
        lum_rayfile_close(file);
        return result;
    }
    *out = file;
    return LMG_OK;
}

void lum_rayfile_close(lum_rayfile *file)
{
    if (!file)
        return;
    if (file->descriptor >= 0)
        close(file->descriptor);
    free(file->spectra);
    free(file->index);
    free(file->texts);
    free(file->name);
    free(file);
}

const lum_ray_info *lum_rayfile_info(const lum_rayfile *file)
{
    return &file->info;
}

const char *lum_rayfile_remark(const lum_rayfile *file, size_t i)
{
    return i < file->remark_count ? file->remarks[i] : NULL;
}

bool lum_rayfile_colour(const lum_rayfile *file, float rgb[3])
{
    if (file->own_colours)
        return false;
    memcpy(rgb, file->colour, sizeof(file->colour));
    return true;
}

/* ------------------------------------------------------------------------------------------------------------ decoding */

struct lum_ray_reader {
    const lum_rayfile *file;
    uint8_t *records; /* LUM_RAY_BLOCK of them, or as many as fit in 1 MB */
    size_t block;     /* records that fit */
    float *rows;      /* text files */
    size_t buffer_size;
};

lmg_result lum_ray_reader_create(const lum_rayfile *file, lum_ray_reader **out, lmg_error *err)
{
    *out = NULL;
    lum_ray_reader *reader = calloc(1, sizeof(*reader));
    if (reader) {
        const size_t record = 4 * (size_t)file->columns.count;
        reader->file = file;
        reader->block = (1u << 20) / record;
        reader->block = reader->block > LUM_RAY_BLOCK ? LUM_RAY_BLOCK : reader->block;
        reader->buffer_size = file->index ? (1u << 18) : reader->block * record;
        reader->records = malloc(reader->buffer_size);
        reader->rows = file->index ? malloc(reader->block * record) : NULL;
    }
    if (!reader || !reader->records || (file->index && !reader->rows)) {
        lum_ray_reader_destroy(reader);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for reading rays");
    }
    *out = reader;
    return LMG_OK;
}

void lum_ray_reader_destroy(lum_ray_reader *reader)
{
    if (!reader)
        return;
    free(reader->records);
    free(reader->rows);
    free(reader);
}

/* Says what is wrong with a ray that the fast loop found bad. */
static lmg_result describe(const lum_rayfile *file, const uint8_t *record, uint64_t number, lmg_error *err)
{
    const ray_columns *c = &file->columns;
    const char *const what[3] = {"position", "direction", "flux"};
    const int first[3] = {c->position, c->direction, file->flux_column}, size[3] = {3, 3, 1};
    for (int k = 0; k < 3; ++k)
        for (int i = 0; first[k] >= 0 && i < size[k]; ++i) {
            const float value = ray_f32(record + 4 * (first[k] + i));
            if (!isfinite(value) || (k == 2 && lum_ray_unknown(value)))
                return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: ray %" PRIu64 ": its %s isn't a number%s", file->name, number + 1,
                                what[k], isfinite(value) ? " (a NaN with its bytes swapped)" : "");
        }
    double length = 0;
    for (int i = 0; i < 3; ++i) {
        const double d = (double)ray_f32(record + 4 * (c->direction + i));
        length += d * d;
    }
    length = sqrt(length);
    if (!(fabs(length - 1) <= DIRECTION_SLACK))
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: ray %" PRIu64 ": its direction has length %.4g, not 1; the file is damaged or its columns are others",
                        file->name, number + 1, length);
    const float flux = ray_f32(record + 4 * file->flux_column);
    if (flux < 0 || flux > MOST_FLUX)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: ray %" PRIu64 ": a flux of %g", file->name, number + 1, (double)flux);
    return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: ray %" PRIu64 ": its colour, wavelength or spectrum can't be", file->name,
                    number + 1);
}

/* Colour and worth of a watt at the ray's own wavelength, tristimulus values or table; false when they can't be. */
static bool own_colour(const lum_rayfile *file, const uint8_t *record, double *worth, float rgb[3], float *wavelength)
{
    const ray_columns *c = &file->columns;
    memcpy(rgb, file->colour, sizeof(file->colour));
    if (c->wavelength >= 0) {
        const double nm = (double)ray_f32(record + 4 * c->wavelength) * file->nanometres;
        if (!(nm > 0 && nm < 1e7))
            return false;
        *wavelength = (float)nm;
        if (file->flux_by_wavelength || file->own_colours) {
            ray_spectrum s;
            lum_ray_monochrome(nm, &s);
            if (file->flux_by_wavelength)
                *worth *= s.lumens_per_watt;
            if (file->own_colours)
                memcpy(rgb, s.rgb, sizeof(s.rgb));
        }
    }
    if (c->spectrum >= 0) {
        const float index = ray_f32(record + 4 * c->spectrum);
        if (!(index >= 1 && index <= (float)file->spectrum_count) || index != floorf(index))
            return false;
        const ray_spectrum *s = &file->spectra[(size_t)index - 1];
        if (file->flux_by_spectrum)
            *worth *= s->lumens_per_watt;
        if (file->own_colours)
            memcpy(rgb, s->rgb, sizeof(s->rgb));
    }
    if (c->x >= 0 && file->own_colours) {
        const double y = (double)ray_f32(record + 4 * c->luminous), x = (double)ray_f32(record + 4 * c->x);
        const double z = (double)ray_f32(record + 4 * c->z);
        if (!(x >= 0 && x <= MOST_COLOUR * y) || !(z >= 0 && z <= MOST_COLOUR * y))
            return false;
        if (y > 0)
            lum_ray_rgb(x / y, z / y, rgb);
    }
    return true;
}

/* The loop that has to be fast: no branch but the one on bad rays, which ends it. */
static size_t decode(const lum_rayfile *file, const uint8_t *records, size_t count, double scale, uint64_t number, lmg_ray *rays)
{
    const ray_columns c = file->columns;
    const size_t record = 4 * (size_t)c.count;
    const double metres = file->metres, constant = file->flux_constant * scale;
    const double ox = file->origin[0] * metres, oy = file->origin[1] * metres, oz = file->origin[2] * metres;
    const bool plain = !file->own_colours && !file->flux_by_wavelength && !file->flux_by_spectrum && c.wavelength < 0;
    const double low = (1 - DIRECTION_SLACK) * (1 - DIRECTION_SLACK), high = (1 + DIRECTION_SLACK) * (1 + DIRECTION_SLACK);
    for (size_t i = 0; i < count; ++i, records += record) {
        lmg_ray *ray = &rays[i];
        double px = 0, py = 0, pz = 0;
        if (c.position >= 0) {
            px = (double)ray_f32(records + 4 * c.position);
            py = (double)ray_f32(records + 4 * c.position + 4);
            pz = (double)ray_f32(records + 4 * c.position + 8);
        }
        const double dx = (double)ray_f32(records + 4 * c.direction), dy = (double)ray_f32(records + 4 * c.direction + 4),
                     dz = (double)ray_f32(records + 4 * c.direction + 8);
        const float stored = ray_f32(records + 4 * file->flux_column);
        const double d2 = dx * dx + dy * dy + dz * dz;
        /* 0 x infinity and 0 x NaN aren't 0: one test for three positions */
        const bool good = d2 >= low && d2 <= high && 0 * (px + py + pz) == 0 &&
                          (stored >= LEAST_FLUX ? stored <= MOST_FLUX : stored >= 0 && !lum_ray_unknown(stored));
        if (!good)
            return i;
        const double e = d2 - 1;
        /* 1/sqrt to 4e-11 by its series where the direction is as good as a float can be */
        const double shorten = e * e < 1e-10 ? 1 - 0.5 * e : 1 / sqrt(d2);
        ray->origin = (lmg_vec3){px * metres + ox, py * metres + oy, pz * metres + oz};
        ray->direction = (lmg_vec3){dx * shorten, dy * shorten, dz * shorten};
        ray->number = number + i;
        double flux = (double)stored * constant;
        if (plain) {
            ray->wavelength = 0;
            ray->flux[0] = (float)flux * file->colour[0];
            ray->flux[1] = (float)flux * file->colour[1];
            ray->flux[2] = (float)flux * file->colour[2];
        } else {
            float rgb[3];
            ray->wavelength = 0;
            if (!own_colour(file, records, &flux, rgb, &ray->wavelength))
                return i;
            for (int k = 0; k < 3; ++k)
                ray->flux[k] = (float)(flux * (double)rgb[k]);
        }
    }
    return count;
}

lmg_result lum_ray_reader_read(lum_ray_reader *reader, uint64_t first, size_t count, double scale, lmg_ray *rays, lmg_error *err)
{
    const lum_rayfile *file = reader->file;
    const size_t record = 4 * (size_t)file->columns.count;
    if (count > LUM_RAY_BLOCK || first > file->info.rays || count > file->info.rays - first)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%s: rays %" PRIu64 " to %" PRIu64 " of %" PRIu64, file->name, first, first + count,
                        file->info.rays);
    while (count > 0) {
        const size_t n = count < reader->block ? count : reader->block;
        const uint8_t *bytes;
        lmg_result result;
        if (file->index) {
            result = lum_ray_text_rows(file, first, n, (char *)reader->records, reader->buffer_size, reader->rows, err);
            bytes = (const uint8_t *)reader->rows;
        } else {
            result = lum_ray_fetch(file, file->start + first * record, n * record, reader->records, &bytes, err);
        }
        if (result != LMG_OK)
            return result;
        const size_t good = decode(file, bytes, n, scale, first, rays);
        if (good < n)
            return describe(file, bytes + good * record, first + good, err);
        first += n;
        count -= n;
        rays += n;
    }
    return LMG_OK;
}
