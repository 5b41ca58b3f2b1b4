/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Ray files as text: Zemax (a first line with count and unit, then columns) and LightTools (a header of names and values, then
 * columns).  Lines have no fixed length, so opening such a file counts its lines and keeps the place of every index_stride-th one;
 * the stride doubles when the index is full, so that memory stays bounded.
 */
#include "rayfile_inside.h"

#include <ctype.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static const uint64_t FIRST_STRIDE = 256;

/* Lines of a file in order, whole lines only, '\r' and '\n' taken off. */
typedef struct line_reader {
    const lum_rayfile *file;
    char *buffer;
    size_t size;        /* of buffer */
    uint64_t at;        /* file offset of buffer[0] */
    size_t used, next;  /* bytes at hand; start of the next line */
} line_reader;

/* The next line, NUL-terminated in the buffer, and its offset.  *line NULL at the end of the file. */
static lmg_result next_line(line_reader *r, char **line, uint64_t *offset, lmg_error *err)
{
    *line = NULL;
    for (;;) {
        char *start = r->buffer + r->next;
        char *end = memchr(start, '\n', r->used - r->next);
        const bool last = r->at + r->used == r->file->size;
        if (!end && last && r->next < r->used)
            end = r->buffer + r->used; /* one byte of the buffer is kept free for this */
        if (end) {
            if (end - start >= RAY_MAX_LINE)
                return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: a line of %td characters at byte %" PRIu64, r->file->name, end - start,
                                r->at + r->next);
            *offset = r->at + r->next;
            r->next = (size_t)(end - r->buffer) + (end < r->buffer + r->used);
            while (end > start && (end[-1] == '\r' || end[-1] == ' ' || end[-1] == '\t'))
                --end;
            *end = 0;
            *line = start;
            return LMG_OK;
        }
        if (last)
            return LMG_OK;
        /* move the rest to the front and fill up */
        const size_t rest = r->used - r->next;
        if (rest >= RAY_MAX_LINE)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: a line of more than %d characters at byte %" PRIu64, r->file->name,
                            RAY_MAX_LINE, r->at + r->next);
        memmove(r->buffer, r->buffer + r->next, rest);
        r->at += r->next;
        r->next = 0;
        r->used = rest;
        const uint64_t left = r->file->size - (r->at + rest);
        const size_t room = r->size - 1 - rest, want = left < room ? (size_t)left : room;
        const uint8_t *bytes;
        const lmg_result result = lum_ray_fetch(r->file, r->at + rest, want, r->buffer + rest, &bytes, err);
        if (result != LMG_OK)
            return result;
        if (bytes != (const uint8_t *)r->buffer + rest)
            memcpy(r->buffer + rest, bytes, want);
        r->used += want;
    }
}

/* Numbers of a line into floats (stored little-endian, as in binary records); how many there are, -1 for a line that holds other
 * things.  Separators: blanks and commas. */
static int numbers(const char *line, float *out, int most)
{
    int n = 0;
    for (const char *c = line + strspn(line, " \t,"); *c;) {
        char *end;
        const double value = strtod(c, &end);
        if (end == c || (*end && !strchr(" \t,", *end)))
            return -1;
        if (n < most)
            ray_put_f32((uint8_t *)&out[n], (float)value);
        ++n;
        c = end + strspn(end, " \t,");
    }
    return n;
}

static bool is_data(const char *line)
{
    line += strspn(line, " \t");
    return *line && *line != '#' && *line != '!';
}

/* Goes through the lines of data, from the reader's place on, to `stop` (a line that ends them, NULL = the end of the file), and
 * builds the index. */
static lmg_result build_index(lum_rayfile *file, line_reader *reader, const char *stop, uint64_t *lines, bool *stopped, lmg_error *err)
{
    *lines = 0;
    *stopped = false;
    file->end = file->size;
    file->index_stride = FIRST_STRIDE;
    file->index = malloc(RAY_INDEX_ENTRIES * sizeof(*file->index));
    if (!file->index)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for an index of its lines", file->name);
    for (;;) {
        char *line;
        uint64_t offset;
        const lmg_result result = next_line(reader, &line, &offset, err);
        if (result != LMG_OK)
            return result;
        if (!line)
            return LMG_OK;
        if (!is_data(line))
            continue;
        if (stop && !strncmp(line + strspn(line, " \t"), stop, strlen(stop))) {
            file->end = offset;
            *stopped = true;
            return LMG_OK;
        }
        if (*lines % file->index_stride == 0) {
            if (file->index_count == RAY_INDEX_ENTRIES) {
                for (size_t i = 0; i < RAY_INDEX_ENTRIES / 2; ++i)
                    file->index[i] = file->index[2 * i];
                file->index_count /= 2;
                file->index_stride *= 2;
            }
            if (*lines % file->index_stride == 0)
                file->index[file->index_count++] = offset;
        }
        ++*lines;
    }
}

lmg_result lum_ray_text_rows(const lum_rayfile *file, uint64_t first, size_t count, char *buffer, size_t buffer_size, float *rows,
                             lmg_error *err)
{
    line_reader r = {.file = file, .buffer = buffer, .size = buffer_size, .at = file->index[first / file->index_stride]};
    const uint64_t skip = first % file->index_stride;
    const int columns = (int)file->columns.count;
    for (uint64_t i = 0; i < skip + count;) {
        char *line;
        uint64_t offset;
        const lmg_result result = next_line(&r, &line, &offset, err);
        if (result != LMG_OK)
            return result;
        if (!line || offset >= file->end)
            return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: it became shorter while being read", file->name);
        if (!is_data(line))
            continue;
        if (i >= skip) {
            const int n = numbers(line, rows, columns);
            if (n != columns)
                return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: ray %" PRIu64 ": %s %d numbers", file->name, first + (i - skip) + 1,
                                n < 0 ? "its line holds other things than" : "its line doesn't hold", columns);
            rows += columns;
        }
        ++i;
    }
    return LMG_OK;
}

enum { LINES_BUFFER = 1 << 18 };

lmg_result lum_ray_open_zemax_text(lum_rayfile *file, lmg_error *err)
{
    line_reader r = {.file = file, .buffer = malloc(LINES_BUFFER), .size = LINES_BUFFER};
    if (!r.buffer)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its lines", file->name);
    char *line;
    uint64_t offset, lines = 0;
    float head[8];
    bool stopped;
    lmg_result result = next_line(&r, &line, &offset, err);
    const int n = result == LMG_OK && line ? numbers(line, head, 8) : 0;
    const double rays = n > 0 ? (double)ray_f32((const uint8_t *)&head[0]) : 0, units = n > 1 ? (double)ray_f32((const uint8_t *)&head[1]) : -1;
    /* the count once more, as a double: a float is exact to 2^24 only */
    const double count = n > 0 ? strtod(line, NULL) : 0;
    if (result == LMG_OK && ((n != 7 && n != 8) || !(rays >= 1) || !(count <= 0x1p53) || count != floor(count) || !(units >= 0) ||
                             !(units <= 4) || units != floor(units)))
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                          "%s: its first line isn't that of a Zemax source file (number of rays, unit of length 0 to 4, zeros)", file->name);
    if (result == LMG_OK) {
        file->metres = RAY_ZEMAX_METRES[(int)units];
        file->nanometres = 1000;
        lum_ray_set_columns(file, true, false, n == 8);
        result = build_index(file, &r, NULL, &lines, &stopped, err);
    }
    if (result == LMG_OK && (double)lines < count)
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: its first line tells of %.0f rays, it has %" PRIu64, file->name, count,
                          lines);
    if (result == LMG_OK) {
        file->info.rays = (uint64_t)count;
        if (lines > file->info.rays)
            lum_ray_remark(file, "%" PRIu64 " lines behind the last ray are ignored", lines - file->info.rays);
    }
    free(r.buffer);
    return result;
}

/* What the header of a LightTools file says. */
typedef struct lighttools_head {
    bool photometric, far, wavelength, started;
    double metres, origin[3], flux;
} lighttools_head;

static bool is_name(const char *line, const char *name, const char **value)
{
    const size_t n = strlen(name);
    if (strncmp(line, name, n) != 0)
        return false;
    *value = line + n + strspn(line + n, " \t:");
    return true;
}

static lmg_result lighttools_line(const lum_rayfile *file, const char *line, lighttools_head *h, lmg_error *err)
{
    static const struct {
        const char *name;
        double metres;
    } UNITS[] = {{"millimeters", 1e-3}, {"centimeters", 0.01}, {"meters", 1},          {"inches", 0.0254},
                 {"feet", 0.3048},      {"microns", 1e-6},     {"micrometers", 1e-6}, {"nanometers", 1e-9}};
    const char *value;
    if (is_name(line, "lt_startofdata", &value)) {
        h->started = true;
    } else if (is_name(line, "lt_datatype", &value)) {
        h->photometric = !strncmp(value, "luminous", 8) || !strncmp(value, "photometric", 11);
        if (!h->photometric && strncmp(value, "radiant", 7) != 0 && strncmp(value, "radiometric", 11) != 0)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: lt_datatype '%.40s' is neither radiant_power nor luminous_flux", file->name,
                            value);
    } else if (is_name(line, "lt_far_field_data", &value)) {
        h->far = !strncmp(value, "yes", 3);
    } else if (is_name(line, "lt_color_info", &value)) {
        h->wavelength = !strncmp(value, "wavelength", 10);
        if (!h->wavelength && strncmp(value, "none", 4) != 0)
            return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                            "%s: LightTools rays with lt_color_info '%.40s': their layout isn't public; export them with wavelengths or none",
                            file->name, value);
    } else if (is_name(line, "lt_polarization", &value)) {
        if (strncmp(value, "no", 2) != 0)
            return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                            "%s: polarized LightTools rays: their layout isn't public; export them without", file->name);
    } else if (is_name(line, "lt_length_units", &value)) {
        h->metres = 0;
        for (size_t i = 0; i < sizeof(UNITS) / sizeof(UNITS[0]); ++i)
            if (!strcmp(value, UNITS[i].name))
                h->metres = UNITS[i].metres;
        if (h->metres == 0)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: lt_length_units '%.40s' isn't known", file->name, value);
    } else if (is_name(line, "lt_data_origin", &value)) {
        if (sscanf(value, "%lf %lf %lf", &h->origin[0], &h->origin[1], &h->origin[2]) != 3 ||
            !isfinite(h->origin[0] + h->origin[1] + h->origin[2]))
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: lt_data_origin '%.40s' isn't a point", file->name, value);
    } else if (is_name(line, "lt_radiant_flux", &value) || is_name(line, "lt_luminous_flux", &value)) {
        h->flux = strtod(value, NULL);
    }
    return LMG_OK;
}

lmg_result lum_ray_open_lighttools_text(lum_rayfile *file, lmg_error *err)
{
    line_reader r = {.file = file, .buffer = malloc(LINES_BUFFER), .size = LINES_BUFFER};
    if (!r.buffer)
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its lines", file->name);
    lighttools_head h = {.metres = 1e-3};
    lmg_result result = LMG_OK;
    while (result == LMG_OK && !h.started) {
        char *line;
        uint64_t offset;
        result = next_line(&r, &line, &offset, err);
        if (result == LMG_OK && !line)
            result = lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: no lt_startofdata", file->name);
        if (result == LMG_OK && line[0] != '#')
            result = lighttools_line(file, line, &h, err);
    }
    bool stopped = false;
    if (result == LMG_OK) {
        file->metres = h.metres;
        memcpy(file->origin, h.origin, sizeof(h.origin));
        *(h.photometric ? &file->info.luminous_lm : &file->info.radiant_W) = h.flux > 0 && isfinite(h.flux) ? h.flux : (double)NAN;
        lum_ray_set_columns(file, !h.far, h.photometric, h.wavelength);
        if (h.far)
            lum_ray_remark(file, "far field only: all rays start at the origin");
        result = build_index(file, &r, "lt_endofdata", &file->info.rays, &stopped, err);
    }
    if (result == LMG_OK && !stopped)
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: it doesn't end with lt_endofdata", file->name);
    if (result == LMG_OK && file->info.rays == 0)
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: holds no rays", file->name);
    free(r.buffer);
    return result;
}
