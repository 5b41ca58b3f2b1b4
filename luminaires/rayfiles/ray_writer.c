/* SPDX-License-Identifier: Apache-2.0 */
/* Writing ray files: records one after the other behind a header whose count and total are filled in at the end.  Relies on POSIX
 * mkstemp and rename: a name never holds half a file. */
#include "rayfile_inside.h"

#include <luminaires/spectrum.h>

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum {
    TM25_FIXED = 36288,
    TM25_TEXT = 1000,
    ZEMAX_HEADER = 208,
    LIGHTTOOLS_HEADER = 44,
    ZEMAX_FIRST_LINE = 64, /* characters, blanks behind the numbers: the count comes later */
    FLUX_WIDTH = 16,       /* characters of a flux in a text header */
    BUFFER = 1 << 18
};

struct lum_ray_writer {
    lum_ray_writer_options options;
    char *path, *temporary;
    FILE *file;
    uint64_t rays;
    double total;
};

static lmg_result write_failed(const lum_ray_writer *w, lmg_error *err)
{
    return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written: %s", w->path, errno ? strerror(errno) : "the disk may be full");
}

/* UTF-8 into a field of 1000 code points; what isn't UTF-8 becomes '?'. */
static void put_text(uint8_t *field, const char *text)
{
    const uint8_t *c = (const uint8_t *)(text ? text : "");
    for (int i = 0; *c && i < TM25_TEXT - 1; ++i) {
        uint32_t value = *c++;
        const int more = value >= 0xf0 ? 3 : value >= 0xe0 ? 2 : value >= 0xc0 ? 1 : 0;
        if (value >= 0x80 && more == 0)
            value = '?';
        else if (more > 0)
            value &= 0x3fu >> more;
        for (int k = 0; k < more; ++k) {
            if ((*c & 0xc0) != 0x80) {
                value = '?';
                break;
            }
            value = value << 6 | (*c++ & 0x3f);
        }
        ray_put_u32(field + 4 * i, value);
    }
}

static bool put_tm25(lum_ray_writer *w)
{
    const lum_ray_writer_options *o = &w->options;
    uint8_t *h = calloc(1, TM25_FIXED);
    if (!h)
        return false;
    memcpy(h, "TM25", 4);
    ray_put_u32(h + 4, 2013);
    ray_put_u32(h + 8, 0); /* simulated or computed, not measured */
    ray_put_f32(h + 12, o->photometric ? (float)w->total : NAN);
    ray_put_f32(h + 16, o->photometric ? NAN : (float)w->total);
    ray_put_u32(h + 20, (uint32_t)w->rays);
    ray_put_u32(h + 24, (uint32_t)(w->rays >> 32));
    const time_t now = time(NULL);
    struct tm utc;
    char date[28] = "";
    if (gmtime_r(&now, &utc))
        strftime(date, sizeof(date), "%Y-%m-%dT%H:%M:%SZ", &utc);
    memcpy(h + 28, date, sizeof(date));
    ray_put_u32(h + 56, 7); /* start positions: unknown */
    ray_put_u32(h + 60, o->wavelength ? 2 : 0);
    ray_put_f32(h + 64, NAN);
    ray_put_f32(h + 68, NAN);
    ray_put_f32(h + 72, NAN);
    const bool flags[8] = {true, true, !o->photometric, o->wavelength, o->photometric, false, o->tristimulus, false};
    for (int i = 0; i < 8; ++i)
        ray_put_u32(h + 256 + 4 * i, flags[i]);
    put_text(h + 288, o->source);
    put_text(h + 288 + 4 * TM25_TEXT * 3, o->software);
    put_text(h + 288 + 4 * TM25_TEXT * 7, o->remarks);
    const bool good = fwrite(h, TM25_FIXED, 1, w->file) == 1;
    free(h);
    return good;
}

static bool put_zemax(lum_ray_writer *w)
{
    const lum_ray_writer_options *o = &w->options;
    uint8_t h[ZEMAX_HEADER] = {0};
    ray_put_u32(h, 1010);
    ray_put_u32(h + 4, (uint32_t)w->rays);
    snprintf((char *)h + 8, 100, "%s", o->source ? o->source : "");
    ray_put_f32(h + 108, (float)w->total);
    ray_put_f32(h + 112, (float)w->total);
    ray_put_f32(h + 116, o->wavelength ? 0 : 0.55f);
    ray_put_f32(h + 124, 180); /* inclination and azimuth: from 0 to these */
    ray_put_f32(h + 132, 360);
    ray_put_u32(h + 136, 4); /* mm */
    for (int i = 0; i < 3; ++i)
        ray_put_f32(h + 164 + 4 * i, 1); /* scale */
    ray_put_u32(h + 192, o->wavelength ? 2 : 0);
    ray_put_u32(h + 196, o->photometric);
    return fwrite(h, sizeof(h), 1, w->file) == 1;
}

static bool put_lighttools(lum_ray_writer *w)
{
    const lum_ray_writer_options *o = &w->options;
    uint8_t h[LIGHTTOOLS_HEADER] = {'L', 'T', 'R', 'F'};
    ray_put_u32(h + 4, 2);
    ray_put_u32(h + 12, o->photometric);
    ray_put_u32(h + 20, o->wavelength ? 2 : 0);
    ray_put_u32(h + 24, 1); /* mm */
    ray_put_f32(h + 40, (float)w->total);
    return fwrite(h, sizeof(h), 1, w->file) == 1;
}

static bool put_zemax_text(lum_ray_writer *w)
{
    char line[ZEMAX_FIRST_LINE + 1];
    const int n = snprintf(line, sizeof(line), "%" PRIu64 " 4 0 0 0 0 0%s", w->rays, w->options.wavelength ? " 0" : "");
    for (int i = n; i < ZEMAX_FIRST_LINE - 1; ++i)
        line[i] = ' ';
    line[ZEMAX_FIRST_LINE - 1] = '\n';
    return fwrite(line, ZEMAX_FIRST_LINE, 1, w->file) == 1;
}

static bool put_lighttools_text(lum_ray_writer *w)
{
    const lum_ray_writer_options *o = &w->options;
    char name[81] = "rays"; /* one line, no more than fits */
    if (o->source)
        snprintf(name, sizeof(name), "%s", o->source);
    return fprintf(w->file,
                   "# LightTools ray data, written by %s\n# Ray Data Export File\nlt_rdf_version: 2.0\ndataname: %s\nlt_datatype: %s\n"
                   "lt_far_field_data: no\nlt_color_info: %s\nlt_length_units: millimeters\nlt_data_origin: 0 0 0\n"
                   "lt_radiant_flux: %-*.9g\nlt_startofdata\n",
                   o->software ? o->software : "lumibake", name, o->photometric ? "luminous_flux" : "radiant_power",
                   o->wavelength ? "wavelength" : "none", (int)FLUX_WIDTH, w->total) > 0;
}

static bool put_header(lum_ray_writer *w)
{
    switch (w->options.format) {
    case LUM_RAYS_TM25:
        return put_tm25(w);
    case LUM_RAYS_ZEMAX:
        return put_zemax(w);
    case LUM_RAYS_LIGHTTOOLS:
        return put_lighttools(w);
    case LUM_RAYS_ZEMAX_TEXT:
        return put_zemax_text(w);
    case LUM_RAYS_LIGHTTOOLS_TEXT:
        return put_lighttools_text(w);
    case LUM_RAYS_NONE:
    default:
        return false;
    }
}

static lmg_result check_options(const char *path, const lum_ray_writer_options *o, lmg_error *err)
{
    const bool lighttools = o->format == LUM_RAYS_LIGHTTOOLS || o->format == LUM_RAYS_LIGHTTOOLS_TEXT;
    if (o->format == LUM_RAYS_NONE)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%s: which format of ray file?", path);
    if (o->tristimulus && (o->format != LUM_RAYS_TM25 || !o->photometric))
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: tristimulus values go into TM-25 files with luminous flux only", path);
    if (o->wavelength && o->photometric && !lighttools)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: %s has wavelengths with radiant flux only", path,
                        lum_ray_format_name(o->format));
    if (o->format == LUM_RAYS_ZEMAX_TEXT && o->photometric)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: Zemax text files hold watts only; the binary ones hold lumens too", path);
    return LMG_OK;
}

static void discard(lum_ray_writer *w)
{
    if (w->file)
        fclose(w->file);
    if (w->temporary) {
        unlink(w->temporary);
    }
    free(w->temporary);
    free(w->path);
    free(w);
}

lmg_result lum_ray_writer_create(const char *path, const lum_ray_writer_options *options, lum_ray_writer **out, lmg_error *err)
{
    *out = NULL;
    lmg_result result = check_options(path, options, err);
    if (result != LMG_OK)
        return result;
    lum_ray_writer *w = calloc(1, sizeof(*w));
    const size_t size = strlen(path) + 8;
    if (w) {
        w->path = malloc(size);
        w->temporary = malloc(size);
    }
    if (!w || !w->path || !w->temporary) {
        if (w) {
            free(w->path);
            free(w->temporary);
        }
        free(w);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for writing", path);
    }
    w->options = *options;
    snprintf(w->path, size, "%s", path);
    snprintf(w->temporary, size, "%s.XXXXXX", path);
    const int descriptor = mkstemp(w->temporary);
    if (descriptor < 0) {
        result = lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: can't write there: %s", path, strerror(errno));
        free(w->temporary);
        w->temporary = NULL;
        discard(w);
        return result;
    }
    const mode_t mask = umask(0); /* permissions as of a plain new file */
    umask(mask);
    fchmod(descriptor, 0666 & ~mask);
    w->file = fdopen(descriptor, "w+b");
    if (!w->file)
        close(descriptor);
    errno = 0;
    if (!w->file || setvbuf(w->file, NULL, _IOFBF, BUFFER) != 0 || !put_header(w)) {
        result = write_failed(w, err);
        discard(w);
        return result;
    }
    *out = w;
    return LMG_OK;
}

/* Values of a ray in the order of its columns; how many. */
static int columns_of(lum_ray_writer *w, const lmg_ray *ray, double scale, float v[12])
{
    const lum_ray_writer_options *o = &w->options;
    const double rgb[3] = {(double)ray->flux[0], (double)ray->flux[1], (double)ray->flux[2]};
    const double flux = lmg_luminance(ray->flux) * scale;
    int n = 0;
    v[n++] = (float)(1e3 * ray->origin.x);
    v[n++] = (float)(1e3 * ray->origin.y);
    v[n++] = (float)(1e3 * ray->origin.z);
    v[n++] = (float)ray->direction.x;
    v[n++] = (float)ray->direction.y;
    v[n++] = (float)ray->direction.z;
    const double nm = (double)ray->wavelength;
    const bool zemax = o->format == LUM_RAYS_ZEMAX || o->format == LUM_RAYS_ZEMAX_TEXT;
    v[n++] = (float)flux;
    if (o->wavelength)
        v[n++] = (float)(zemax ? 1e-3 * nm : nm);
    if (o->tristimulus) {
        double xyz[3];
        lum_rgb_to_xyz(rgb, xyz);
        v[n++] = (float)fmax(xyz[0] * scale, 0);
        v[n++] = (float)fmax(xyz[2] * scale, 0);
    }
    w->total += (double)v[6];
    return n;
}

lmg_result lum_ray_writer_append(lum_ray_writer *w, const lmg_ray *rays, size_t count, double scale, lmg_error *err)
{
    const bool text = w->options.format == LUM_RAYS_ZEMAX_TEXT || w->options.format == LUM_RAYS_LIGHTTOOLS_TEXT;
    errno = 0;
    if (w->options.format == LUM_RAYS_ZEMAX && w->rays + count > 4000000000u)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: more than 4,000,000,000 rays don't fit into a Zemax file", w->path);
    for (size_t i = 0; i < count; ++i) {
        float v[12];
        const int n = columns_of(w, &rays[i], scale, v);
        bool good = true;
        if (text) {
            for (int k = 0; good && k < n; ++k)
                good = fprintf(w->file, "%.9g%c", (double)v[k], k + 1 < n ? ' ' : '\n') > 0;
        } else {
            uint8_t record[48];
            for (int k = 0; k < n; ++k)
                ray_put_f32(record + 4 * k, v[k]);
            good = fwrite(record, 4 * (size_t)n, 1, w->file) == 1;
        }
        if (!good)
            return write_failed(w, err);
        ++w->rays;
    }
    return LMG_OK;
}

lmg_result lum_ray_writer_finish(lum_ray_writer *w, double *total, lmg_error *err)
{
    lmg_result result = LMG_OK;
    errno = 0;
    bool good = true;
    if (w->options.format == LUM_RAYS_LIGHTTOOLS)
        good = fwrite("LTRFEND", 7, 1, w->file) == 1;
    if (w->options.format == LUM_RAYS_LIGHTTOOLS_TEXT)
        good = fputs("lt_endofdata\n", w->file) >= 0;
    good = good && fseek(w->file, 0, SEEK_SET) == 0 && put_header(w) && fflush(w->file) == 0 && fsync(fileno(w->file)) == 0;
    good = fclose(w->file) == 0 && good;
    w->file = NULL;
    if (!good)
        result = write_failed(w, err);
    else if (rename(w->temporary, w->path) != 0)
        result = lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't put the finished file in place: %s", w->path, strerror(errno));
    if (result == LMG_OK) {
        free(w->temporary);
        w->temporary = NULL;
        if (total)
            *total = w->total;
    }
    discard(w);
    return result;
}

void lum_ray_writer_abandon(lum_ray_writer *w)
{
    if (w)
        discard(w);
}
