/* SPDX-License-Identifier: Apache-2.0 */
/* Reading spectra from files: rows of text, or JSON (spectrum.h says which).  Files are untrusted.  Relies on jansson. */
#include <luminaires/spectrum.h>

#include "gltf_file.h"
#include "text.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_ROWS = 1 << 20 };
#define MAX_SPECTRUM_BYTES ((size_t)64 << 20)

typedef struct rows {
    double *nm, *values;
    size_t count, capacity;
} rows;

static lmg_result add_row(rows *r, double nm, double value, lmg_error *err)
{
    if (r->count == MAX_ROWS)
        return lmg_fail(err, LMG_ERROR_INPUT, "has more than %d rows", MAX_ROWS);
    if (r->count == r->capacity) {
        const size_t capacity = 2 * r->capacity + 64;
        double *a = realloc(r->nm, capacity * sizeof *a);
        r->nm = a ? a : r->nm;
        double *b = realloc(r->values, capacity * sizeof *b);
        r->values = b ? b : r->values;
        if (!a || !b)
            return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
        r->capacity = capacity;
    }
    r->nm[r->count] = nm;
    r->values[r->count++] = value;
    return LMG_OK;
}

/* ---------------------------------------------------------------------------------------------------------------- text */

/* The number that starts at *s, followed by a separator or the end; moves on past one separator and the blanks around it. */
static bool number_at(char **s, char separator, double *out)
{
    char *end;
    *out = strtod(*s, &end);
    if (end == *s || (*end && *end != separator && *end != ' ' && *end != '\t'))
        return false;
    end += strspn(end, " \t");
    if (separator && *end == separator)
        ++end;
    *s = end + strspn(end, " \t");
    return true;
}

/* One line, without its end.  Wavelength and value are its first two fields. */
static lmg_result read_line(char *line, size_t number, rows *r, lmg_error *err)
{
    char *s = line + strspn(line, " \t");
    s[strcspn(s, "#")] = 0;
    if (!*s)
        return LMG_OK;
    char separator = 0;
    if (strchr(s, ';')) {
        separator = ';';
        for (char *p = s; *p; ++p) /* the decimal comma of tables that are separated so */
            *p = *p == ',' ? '.' : *p;
    } else if (strchr(s, ',')) {
        separator = ',';
    }
    double nm, value;
    const bool row = number_at(&s, separator, &nm) && number_at(&s, separator, &value);
    if (row)
        return add_row(r, nm, value, err);
    if (r->count > 0)
        return lmg_fail(err, LMG_ERROR_INPUT, "line %zu isn't a row of wavelength (nm) and value; remove or complete it", number);
    return LMG_OK;
}

static lmg_result read_text(const char *bytes, size_t size, rows *r, lmg_error *err)
{
    enum { MAX_LINE = 4096 };
    char line[MAX_LINE];
    size_t number = 1;
    for (size_t at = 0; at < size; ++number) {
        size_t n = 0;
        while (at + n < size && bytes[at + n] != '\n' && bytes[at + n] != '\r')
            ++n;
        if (n >= MAX_LINE || memchr(bytes + at, 0, n))
            return lmg_fail(err, LMG_ERROR_INPUT, "line %zu isn't text of a table", number);
        memcpy(line, bytes + at, n);
        line[n] = 0;
        const lmg_result result = read_line(line, number, r, err);
        if (result)
            return result;
        at += n;
        if (at < size && bytes[at] == '\r' && at + 1 < size && bytes[at + 1] == '\n')
            ++at;
        ++at;
    }
    return LMG_OK;
}

/* ---------------------------------------------------------------------------------------------------------------- JSON */

static lmg_result numbers_of(const json_t *array, const char *key, size_t i, double *out, lmg_error *err)
{
    const json_t *value = json_array_get(array, i);
    if (!json_is_number(value))
        return lmg_fail(err, LMG_ERROR_INPUT, "\"%s\" number %zu isn't a number", key, i + 1);
    *out = json_number_value(value);
    return LMG_OK;
}

static lmg_result read_json(const char *bytes, size_t size, rows *r, lmg_error *err)
{
    json_error_t e;
    json_t *root = json_loadb(bytes, size, JSON_REJECT_DUPLICATES, &e);
    if (!root)
        return lmg_fail(err, LMG_ERROR_INPUT, "not JSON: line %d, column %d: %.200s", e.line, e.column, e.text);
    const json_t *nm = json_object_get(root, "lambda_nm"), *values = json_object_get(root, "values");
    const size_t n = json_array_size(values), m = json_array_size(nm);
    lmg_result result = LMG_OK;
    double range[3] = {0, 0, 0};
    if (n == 0 || m == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "needs \"lambda_nm\" and \"values\", two lists of numbers");
    const bool steps = m == 3 && n != 3;
    for (size_t i = 0; i < 3 && steps && !result; ++i)
        result = numbers_of(nm, "lambda_nm", i, &range[i], err);
    if (!result && steps && !(fabs(range[0] + (double)(n - 1) * range[2] - range[1]) <= 1e-6 * fabs(range[1])))
        result = lmg_fail(err, LMG_ERROR_INPUT, "\"lambda_nm\": %g to %g by %g doesn't fit %zu values", range[0], range[1], range[2], n);
    if (!result && !steps && m != n)
        result = lmg_fail(err, LMG_ERROR_INPUT, "has %zu wavelengths and %zu values", m, n);
    for (size_t i = 0; i < n && !result; ++i) {
        double x = range[0] + (double)i * range[2], y = 0;
        if (!steps)
            result = numbers_of(nm, "lambda_nm", i, &x, err);
        if (!result)
            result = numbers_of(values, "values", i, &y, err);
        if (!result)
            result = add_row(r, x, y, err);
    }
    json_decref(root);
    return result;
}

/* --------------------------------------------------------------------------------------------------------------- whole */

lmg_result lum_spectrum_parse(const void *bytes, size_t size, lum_spectrum_end end, double low, double high, lum_spectrum *out,
                              lmg_error *err)
{
    const char *text = bytes;
    rows r = {0};
    memset(out, 0, sizeof *out);
    if (size >= 3 && memcmp(text, "\xef\xbb\xbf", 3) == 0) { /* byte order mark */
        text += 3;
        size -= 3;
    }
    size_t start = 0;
    while (start < size && strchr(" \t\r\n", text[start]) && text[start])
        ++start;
    const bool json = start < size && text[start] == '{';
    lmg_result result = json ? read_json(text, size, &r, err) : read_text(text, size, &r, err);
    if (!result)
        result = lum_spectrum_from_table(r.nm, r.values, r.count, end, low, high, out, err);
    free(r.nm);
    free(r.values);
    return result;
}

lmg_result lum_spectrum_read(const char *path, lum_spectrum_end end, double low, double high, lum_spectrum *out, lmg_error *err)
{
    uint8_t *bytes = NULL;
    size_t size = 0;
    memset(out, 0, sizeof *out);
    lmg_result result = lum_read_file(path, MAX_SPECTRUM_BYTES, &bytes, &size, err);
    if (!result)
        result = lum_spectrum_parse(bytes, size, end, low, high, out, err);
    free(bytes);
    if (result)
        lum_prefix_error(err, lum_base_name(path));
    return result;
}
