/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading IES LM-63 of 1986, 1991, 1995, 2002 and 2019 [lm63].  Label lines up to TILT=, then numbers in free form.  Real files
 * break most rules somewhere, so separators, line lengths, encodings and header lines are taken as they come; what would change the
 * light (counts, angles, values) isn't.
 */
#include "photometry_file.h"

#include "gltf_file.h"
#include "text.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static const double FOOT = 0.3048;

/* ---------------------------------------------------------------------------------------------------------------- shape */

static lum_shape shape_of(lum_shape_kind kind, double c0, double c90, double height)
{
    return (lum_shape){kind, fabs(c0), fabs(c90), fabs(height)};
}

/* Signs as numbers -1, 0, 1: w, l, h pack into one case label. */
#define SIGNS(w, l, h) (((w) + 1) * 9 + ((l) + 1) * 3 + (h) + 1)

static int sign_of(double x)
{
    return (x > 0) - (x < 0);
}

/* LM-63-2002 and 2019.  width lies along C90-C270, length along C0-C180. */
static bool shape_2002(double w, double l, double h, lum_shape *out)
{
    switch (SIGNS(sign_of(w), sign_of(l), sign_of(h))) {
    case SIGNS(-1, -1, 0):
        *out = shape_of(LUM_SHAPE_ELLIPSE, l, w, 0);
        return true;
    case SIGNS(-1, -1, 1):
        *out = shape_of(LUM_SHAPE_CYLINDER, l, w, h);
        return true;
    case SIGNS(-1, -1, -1):
        *out = shape_of(LUM_SHAPE_ELLIPSOID, l, w, h);
        return true;
    case SIGNS(-1, 1, -1):
        *out = shape_of(LUM_SHAPE_CYLINDER_C0, l, w, h);
        return true;
    case SIGNS(1, -1, -1):
        *out = shape_of(LUM_SHAPE_CYLINDER_C90, l, w, h);
        return true;
    case SIGNS(-1, 0, -1):
        *out = shape_of(LUM_SHAPE_ELLIPSE_FACING_C0, 0, w, h);
        return true;
    default:
        return false;
    }
}

/* LM-63-1986, 1991 and 1995. */
static bool shape_1995(double w, double l, double h, lum_shape *out)
{
    switch (SIGNS(sign_of(w), sign_of(l), sign_of(h))) {
    case SIGNS(-1, 0, 0):
        *out = shape_of(LUM_SHAPE_ELLIPSE, w, w, 0);
        return true;
    case SIGNS(-1, 0, 1):
        *out = shape_of(LUM_SHAPE_CYLINDER, w, w, h);
        return true;
    case SIGNS(-1, 0, -1):
        *out = shape_of(LUM_SHAPE_ELLIPSOID, w, w, h);
        return true;
    case SIGNS(0, 1, -1):
        *out = shape_of(LUM_SHAPE_CYLINDER_C0, l, h, h);
        return true;
    case SIGNS(1, 0, -1):
        *out = shape_of(LUM_SHAPE_CYLINDER_C90, h, w, h);
        return true;
    case SIGNS(-1, 1, 0):
    case SIGNS(1, -1, 0):
        *out = shape_of(LUM_SHAPE_ELLIPSE, l, w, 0);
        return true;
    case SIGNS(-1, 1, 1):
    case SIGNS(1, -1, 1):
        *out = shape_of(LUM_SHAPE_CYLINDER, l, w, h);
        return true;
    case SIGNS(-1, 1, -1):
    case SIGNS(1, -1, -1):
        *out = shape_of(LUM_SHAPE_ELLIPSOID, l, w, h);
        return true;
    default:
        return false;
    }
}

bool lum_ies_shape(double w, double l, double h, bool rules_2002, lum_shape *out)
{
    if (w >= 0 && l >= 0 && h >= 0) {
        const int extents = (w > 0) + (l > 0) + (h > 0);
        *out = shape_of(extents == 0 ? LUM_SHAPE_POINT : extents == 3 ? LUM_SHAPE_BOX : LUM_SHAPE_RECTANGLE, l, w, h);
        return true;
    }
    /* Files mix the rules; a pattern that only the other edition has can mean nothing else. */
    return rules_2002 ? shape_2002(w, l, h, out) || shape_1995(w, l, h, out) : shape_1995(w, l, h, out) || shape_2002(w, l, h, out);
}

/* -------------------------------------------------------------------------------------------------------------- numbers */

typedef struct numbers {
    const char *at;
    unsigned line;
    bool decimal_comma;
    bool leftover; /* text stands after the last number */
    lmg_error *err;
} numbers;

static bool is_blank(const numbers *n, char c)
{
    /* '~' and Ctrl-Z are leftovers of old editors. */
    return c == ' ' || c == '\t' || c == '\n' || c == '\f' || c == '\v' || c == '~' || c == 0x1a || c == ';' ||
           (c == ',' && !n->decimal_comma);
}

/* The next number; what names it in messages. */
static lmg_result next_number(numbers *n, const char *what, double *value)
{
    while (*n->at && is_blank(n, *n->at)) {
        n->line += *n->at == '\n';
        n->at++;
    }
    const char *start = n->at;
    while (*n->at && !is_blank(n, *n->at))
        n->at++;
    const size_t length = (size_t)(n->at - start);
    if (length == 0)
        return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: the file ends where %s should be", n->line, what);
    char text[64];
    const size_t kept = length < sizeof text ? length : sizeof text - 1;
    memcpy(text, start, kept);
    text[kept] = 0;
    if (n->decimal_comma)
        for (char *c = text; *c; c++)
            *c = *c == ',' ? '.' : *c;
    if (length >= sizeof text || !lum_parse_number(text, length, value)) {
        lum_make_one_line(text);
        return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: \"%.24s\" is no number for %s", n->line, text, what);
    }
    return LMG_OK;
}

static lmg_result next_in(numbers *n, const char *what, double least, double most, double *value)
{
    LUM_TRY(next_number(n, what, value));
    if (!(*value >= least && *value <= most))
        return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: %s is %g, outside [%g, %g]", n->line, what, *value, least, most);
    return LMG_OK;
}

static lmg_result next_count(numbers *n, const char *what, double least, double most, uint32_t *value)
{
    double x;
    LUM_TRY(next_in(n, what, least, most, &x));
    if (x != floor(x))
        return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: %s is %g, not a whole number", n->line, what, x);
    *value = (uint32_t)x;
    return LMG_OK;
}

static lmg_result read_tilt(numbers *n, lum_tilt *tilt)
{
    uint32_t geometry, count;
    LUM_TRY(next_count(n, "the lamp-to-luminaire geometry of TILT", 1, 3, &geometry));
    LUM_TRY(next_count(n, "the number of tilt angles", 1, 1000, &count));
    if (count > strlen(n->at))
        return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: the file is too short for %u tilt angles", n->line, count);
    tilt->angles = malloc(count * sizeof *tilt->angles);
    tilt->factors = malloc(count * sizeof *tilt->factors);
    if (!tilt->angles || !tilt->factors)
        return lmg_fail(n->err, LMG_ERROR_MEMORY, "not enough memory for a tilt table");
    for (uint32_t i = 0; i < count; i++) {
        LUM_TRY(next_in(n, "a tilt angle", -360, 360, &tilt->angles[i]));
        if (i && !(tilt->angles[i] > tilt->angles[i - 1]))
            return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: tilt angle %g isn't larger than the one before", n->line,
                            tilt->angles[i]);
    }
    for (uint32_t i = 0; i < count; i++)
        LUM_TRY(next_in(n, "a tilt factor", 0, 1000, &tilt->factors[i]));
    tilt->geometry = (int)geometry;
    tilt->count = count;
    return LMG_OK;
}

/* A TILT file lies beside the photometric file: only its name counts, whatever path it gives. */
static void read_tilt_file(lum_photometry *p, const char *name, const char *path)
{
    const char *base = name + strlen(name);
    while (base > name && base[-1] != '/' && base[-1] != '\\' && base[-1] != ':')
        base--;
    lum_tilt tilt = {0};
    lmg_error why = {"it isn't looked for"};
    uint8_t *bytes = NULL;
    char *text = NULL;
    size_t size;
    char *beside = path ? malloc(strlen(path) + strlen(base) + 2) : NULL;
    lmg_result result = LMG_ERROR_FILE_OPEN;
    if (beside && *base && strcmp(base, "..") != 0) {
        sprintf(beside, "%.*s%s", (int)(lum_base_name(path) - path), path, base);
        result = lum_read_file(beside, (size_t)1 << 20, &bytes, &size, &why);
        if (result == LMG_OK)
            result = lum_text_decode(bytes, size, &text, &why);
        if (result == LMG_OK) {
            numbers n = {.at = text, .line = 1, .err = &why};
            result = read_tilt(&n, &tilt);
        }
    }
    if (result == LMG_OK) {
        p->tilt = tilt;
    } else {
        free(tilt.angles);
        free(tilt.factors);
        lum_photometry_warn(p, "the TILT file \"%.60s\" is not used: %.150s", base, why.message);
    }
    free(beside);
    free(bytes);
    free(text);
}

static lmg_result read_grid(numbers *n, lum_photometry *p, double factor)
{
    for (uint32_t j = 0; j < p->v_count; j++)
        LUM_TRY(next_number(n, "a vertical angle", &p->v[j]));
    for (uint32_t i = 0; i < p->h_count; i++)
        LUM_TRY(next_number(n, "a horizontal angle", &p->h[i]));
    for (uint32_t i = 0; i < p->h_count; i++)
        for (uint32_t j = 0; j < p->v_count; j++) {
            double cd;
            LUM_TRY(next_number(n, "a candela value", &cd));
            if (cd < 0)
                return lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: candela value %g at horizontal %g, vertical %g is negative",
                                n->line, cd, p->h[i], p->v[j]);
            p->intensity[(size_t)i * p->v_count + j] = cd * factor;
        }
    return LMG_OK;
}

/* What TILT= leaves: the lamp lines and the grid. */
static lmg_result read_data(numbers *n, const lum_photometry *labels, const char *tilt_name, const char *path, bool rules_2002,
                            lum_photometry **out)
{
    lum_tilt tilt = {0};
    lum_photometry *p = NULL;
    lmg_result result = strcasecmp(tilt_name, "INCLUDE") == 0 ? read_tilt(n, &tilt) : LMG_OK;
    double lumens = 0, multiplier = 1, extent[3] = {0}, ballast = 1, second = 1, watts = 0;
    uint32_t lamps = 0, v_count = 0, h_count = 0, type = 0, units = 0;
    if (result == LMG_OK)
        result = next_count(n, "the number of lamps", 0, 100000, &lamps);
    if (result == LMG_OK)
        result = next_in(n, "the lumens per lamp", -1e9, 1e9, &lumens);
    if (result == LMG_OK)
        result = next_in(n, "the candela multiplier", 1e-12, 1e12, &multiplier);
    if (result == LMG_OK)
        result = next_count(n, "the number of vertical angles", 1, LUM_MAX_ANGLES, &v_count);
    if (result == LMG_OK)
        result = next_count(n, "the number of horizontal angles", 1, LUM_MAX_ANGLES, &h_count);
    if (result == LMG_OK)
        result = next_count(n, "the photometric type (1 = C, 2 = B, 3 = A)", 1, 3, &type);
    if (result == LMG_OK)
        result = next_count(n, "the unit of length (1 = feet, 2 = metres)", 1, 2, &units);
    for (int i = 0; i < 3 && result == LMG_OK; i++)
        result = next_in(n, "an extent of the luminous opening", -10000, 10000, &extent[i]);
    if (result == LMG_OK)
        result = next_in(n, "the ballast factor", 1e-6, 1e6, &ballast);
    if (result == LMG_OK)
        result = next_in(n, "the ballast-lamp factor or file generation type", 0, 1e6, &second);
    if (result == LMG_OK)
        result = next_in(n, "the input watts", -1e9, 1e9, &watts);
    if (result == LMG_OK && !lum_count_fits(h_count, v_count, strlen(n->at)))
        result = lmg_fail(n->err, LMG_ERROR_INPUT, "line %u: the file is too short for %u x %u candela values", n->line, v_count,
                          h_count);
    if (result == LMG_OK)
        result = lum_photometry_create(h_count, v_count, &p, n->err);
    if (result != LMG_OK) {
        free(tilt.angles);
        free(tilt.factors);
        return result;
    }
    p->tilt = tilt;
    p->type = (lum_photometry_type)type;
    memcpy(p->format, labels->format, sizeof p->format);
    /* Up to 1995 a second factor (lamp on this ballast) stands there; 2002 has 1 for future use, 2019 a code. */
    const bool second_factor = !rules_2002 && second > 0;
    p->ballast_factor = ballast * (second_factor ? second : 1);
    p->absolute = lumens < 0;
    p->lamp_sets[0].count = lamps > 0 ? (int)lamps : 1;
    p->lamp_sets[0].flux = p->absolute ? 0 : lumens * lamps;
    p->lamp_sets[0].power = p->power = fmax(watts, 0);
    const double unit = units == 1 ? FOOT : 1;
    if (!lum_ies_shape(extent[0] * unit, extent[1] * unit, extent[2] * unit, rules_2002, &p->shape)) {
        lum_photometry_warn(p, "no rule for a luminous opening of %g x %g x %g; taken as a rectangle", extent[0], extent[1],
                            extent[2]);
        lum_ies_shape(fabs(extent[0] * unit), fabs(extent[1] * unit), fabs(extent[2] * unit), rules_2002, &p->shape);
    }
    for (uint32_t i = 0; i < labels->keyword_count && result == LMG_OK; i++)
        result = lum_photometry_add_keyword(p, labels->keywords[i].name, labels->keywords[i].value,
                                            strlen(labels->keywords[i].value), n->err);
    if (result == LMG_OK)
        result = read_grid(n, p, multiplier * p->ballast_factor);
    if (result == LMG_OK)
        result = lum_photometry_settle_symmetry(p, n->err);
    if (result == LMG_OK)
        result = lum_photometry_check(p, n->err);
    if (result != LMG_OK) {
        lum_photometry_destroy(p);
        return result;
    }
    if (strcasecmp(tilt_name, "INCLUDE") != 0 && strcasecmp(tilt_name, "NONE") != 0)
        read_tilt_file(p, tilt_name, path);
    while (*n->at && is_blank(n, *n->at))
        n->at++;
    n->leftover = *n->at != 0;
    if (n->leftover)
        lum_photometry_warn(p, "text after the last candela value is ignored");
    *out = p;
    return LMG_OK;
}

/* --------------------------------------------------------------------------------------------------------------- labels */

static lmg_result add_label(lum_photometry *p, const char *line, size_t length, lmg_error *err)
{
    while (length && (line[0] == ' ' || line[0] == '\t'))
        line++, length--;
    const char *close = length && line[0] == '[' ? memchr(line, ']', length) : NULL;
    char name[64];
    if (!close || (size_t)(close - line) > sizeof name || close == line + 1) {
        while (length && (unsigned char)line[length - 1] <= ' ')
            length--;
        return length ? lum_photometry_add_keyword(p, "OTHER", line, length, err) : LMG_OK;
    }
    const size_t n = (size_t)(close - line) - 1;
    memcpy(name, line + 1, n);
    name[n] = 0;
    lum_make_one_line(name);
    return lum_photometry_add_keyword(p, name, close + 1, length - n - 2, err);
}

/* Whether a label line is the TILT line; *value: what stands after '='. */
static bool tilt_line(const char *line, size_t length, char value[256])
{
    while (length && (*line == ' ' || *line == '\t'))
        line++, length--;
    if (length < 5 || strncasecmp(line, "TILT", 4) != 0)
        return false;
    line += 4, length -= 4;
    while (length && (*line == ' ' || *line == '\t'))
        line++, length--;
    if (!length || *line != '=')
        return false;
    line++, length--;
    while (length && (*line == ' ' || *line == '\t'))
        line++, length--;
    while (length && (unsigned char)line[length - 1] <= ' ')
        length--;
    snprintf(value, 256, "%.*s", (int)length, line);
    return true;
}

/* Files that were measured in other units than candela say so in words; LM-63 has no field for it. */
static void find_unit(lum_photometry *p)
{
    for (uint32_t i = 0; i < p->keyword_count; i++) {
        const char *at = strstr(p->keywords[i].value, "W/sr");
        if (!at)
            continue;
        const char *start = at;
        while (start > p->keywords[i].value && at - start < 1 && start[-1] != ' ' && start[-1] != '>' && start[-1] != '(')
            start--;
        snprintf(p->unit, sizeof p->unit, "%.*s", (int)(at + 4 - start), start);
        lum_photometry_warn(p, "values are in %s, not in candela", p->unit);
        return;
    }
}

lmg_result lum_ies_read(const char *text, const char *path, lum_photometry **out, lmg_error *err)
{
    *out = NULL;
    lum_photometry *labels = NULL;
    LUM_TRY(lum_photometry_create(1, 1, &labels, err));
    lmg_result result = LMG_OK;
    char tilt[256] = "";
    const char *at = text;
    unsigned line = 0;
    bool found = false, rules_2002 = false;
    snprintf(labels->format, sizeof labels->format, "IES LM-63-1986");
    while (*at && !found && result == LMG_OK) {
        const size_t length = strcspn(at, "\n");
        line++;
        if (line == 1 && (strncasecmp(at, "IES", 3) == 0)) {
            snprintf(labels->format, sizeof labels->format, "%.*s", (int)(length < 40 ? length : 40), at);
            lum_make_one_line(labels->format);
            for (size_t n = strlen(labels->format); n && (labels->format[n - 1] == ' ' || labels->format[n - 1] == '?'); n--)
                labels->format[n - 1] = 0;
            /* IESNA86, IESNA91, IESNA95, IESNA:LM-63-1995, IESNA:LM-63-2002, IES:LM-63-2019 */
            const char *year = labels->format + strcspn(labels->format, "0123456789");
            rules_2002 = strstr(labels->format, "-20") || strncmp(year, "63-20", 5) == 0;
        } else if (tilt_line(at, length, tilt)) {
            found = true;
        } else {
            result = add_label(labels, at, length, err);
        }
        at += length + (at[length] == '\n');
    }
    if (result == LMG_OK && !found)
        result = lmg_fail(err, LMG_ERROR_INPUT, "no line TILT=: not an IES LM-63 file, or cut off before its data");
    if (result == LMG_OK) {
        numbers n = {.at = at, .line = line + 1, .err = err};
        result = read_data(&n, labels, tilt, path, rules_2002, out);
        /* A comma between digits separates numbers by the rules, and is a decimal comma in some files: what comes out even is
         * meant. */
        if (result == LMG_ERROR_INPUT || (result == LMG_OK && n.leftover)) {
            const char *comma = at;
            while ((comma = strchr(comma, ',')) &&
                   !(comma > at && comma[-1] >= '0' && comma[-1] <= '9' && comma[1] >= '0' && comma[1] <= '9'))
                comma++;
            lmg_error ignored;
            lum_photometry *other = NULL;
            numbers again = {.at = at, .line = line + 1, .decimal_comma = true, .err = &ignored};
            if (comma && read_data(&again, labels, tilt, path, rules_2002, &other) == LMG_OK && !again.leftover) {
                lum_photometry_destroy(*out);
                *out = other;
                other = NULL;
                result = LMG_OK;
                lum_photometry_warn(*out, "decimal commas");
            }
            lum_photometry_destroy(other);
        }
    }
    lum_photometry_destroy(labels);
    if (result == LMG_OK)
        find_unit(*out);
    return result;
}
