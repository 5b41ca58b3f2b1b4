/* SPDX-License-Identifier: Apache-2.0 */
/* CSV tables of numbers.  Lines of any length; the file is untrusted. */
#include "table.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_COLUMNS = 16 };

static const char *skip_blanks(const char *c)
{
    while (*c == ' ' || *c == '\t' || *c == '\r' || *c == '\v' || *c == '\f')
        ++c;
    return c;
}

/* A cell that is a number, up to its separator or the line's end (returned); NULL if it isn't one. */
static const char *parse_cell(const char *c, double *value)
{
    char *end;
    c = skip_blanks(c);
    *value = strtod(c, &end);
    if (end == c)
        return NULL;
    c = skip_blanks(end);
    /* A tab is a separator, and skip_blanks has passed it: then the next cell begins here. */
    if (*c == ',' || *c == ';' || *c == 0)
        return c;
    return memchr(end, '\t', (size_t)(c - end)) ? c - 1 : NULL;
}

static bool holds_a_number(const char *line)
{
    for (const char *c = line; *c;) {
        double value;
        if (parse_cell(c, &value))
            return true;
        c += strcspn(c, ",;\t");
        c += *c != 0;
    }
    return false;
}

static lmg_result parse_line(const char *path, size_t number, const char *line, size_t columns, const char *names, double *values,
                             lmg_error *err)
{
    const char *c = line;
    for (size_t i = 0; i < columns; ++i) {
        const char *cell = c;
        c = parse_cell(c, &values[i]);
        if (!c) {
            cell = skip_blanks(cell);
            const size_t length = strcspn(cell, ",;\t");
            if (length == 0 && !cell[0])
                return lmg_fail(err, LMG_ERROR_INPUT, "%s:%zu: %zu columns, expected %zu: %s", path, number, i, columns, names);
            return lmg_fail(err, LMG_ERROR_INPUT, "%s:%zu: column %zu: '%.*s' is not a number; expected %s", path, number, i + 1,
                            (int)(length < 40 ? length : 40), cell, names);
        }
        if (!isfinite(values[i]))
            return lmg_fail(err, LMG_ERROR_INPUT, "%s:%zu: column %zu is not finite", path, number, i + 1);
        if (i + 1 < columns) {
            if (!*c)
                return lmg_fail(err, LMG_ERROR_INPUT, "%s:%zu: %zu columns, expected %zu: %s", path, number, i + 1, columns, names);
            ++c;
        }
    }
    if (*skip_blanks(c))
        return lmg_fail(err, LMG_ERROR_INPUT, "%s:%zu: more than %zu columns; expected %s", path, number, columns, names);
    return LMG_OK;
}

static lmg_result add_row(table *t, const double *values, size_t line, size_t *capacity, lmg_error *err)
{
    if (t->rows == *capacity) {
        const size_t grown = *capacity ? 2 * *capacity : 256;
        double *v = realloc(t->values, grown * t->columns * sizeof(*v));
        if (v)
            t->values = v;
        size_t *l = realloc(t->lines, grown * sizeof(*l));
        if (l)
            t->lines = l;
        if (!v || !l)
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a table of %zu rows", grown);
        *capacity = grown;
    }
    memcpy(t->values + t->rows * t->columns, values, t->columns * sizeof(*values));
    t->lines[t->rows++] = line;
    return LMG_OK;
}

static lmg_result read_rows(FILE *file, const char *path, const char *names, table *t, lmg_error *err)
{
    char *line = NULL;
    size_t size = 0, number = 0, capacity = 0;
    bool first = true;
    lmg_result result = LMG_OK;
    ssize_t length;
    while (result == LMG_OK && (length = getline(&line, &size, file)) >= 0) {
        ++number;
        if (strlen(line) != (size_t)length) {
            result = lmg_fail(err, LMG_ERROR_INPUT, "%s:%zu: a zero byte: this is not a text file", path, number);
            break;
        }
        line[strcspn(line, "#\r\n")] = 0;
        const char *text = line;
        if (number == 1 && !strncmp(text, "\xef\xbb\xbf", 3))
            text += 3; /* byte-order mark of UTF-8 */
        if (!*skip_blanks(text))
            continue;
        if (first && !holds_a_number(text)) {
            first = false;
            continue;
        }
        first = false;
        double values[MAX_COLUMNS];
        result = parse_line(path, number, text, t->columns, names, values, err);
        if (result == LMG_OK)
            result = add_row(t, values, number, &capacity, err);
    }
    if (result == LMG_OK && ferror(file))
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "%s: can't read: %s", path, strerror(errno));
    if (result == LMG_OK && t->rows == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "%s: no rows; expected %s", path, names);
    free(line);
    return result;
}

lmg_result table_read(const char *path, size_t columns, const char *names, table *out, lmg_error *err)
{
    *out = (table){.columns = columns};
    if (columns < 1 || columns > MAX_COLUMNS)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a table of %zu columns", columns);
    const bool standard = !strcmp(path, "-");
    FILE *file = standard ? stdin : fopen(path, "r");
    if (!file)
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: can't open: %s", path, strerror(errno));
    const lmg_result result = read_rows(file, standard ? "standard input" : path, names, out, err);
    if (!standard)
        fclose(file);
    if (result != LMG_OK)
        table_free(out);
    return result;
}

void table_free(table *t)
{
    free(t->values);
    free(t->lines);
    *t = (table){0};
}
