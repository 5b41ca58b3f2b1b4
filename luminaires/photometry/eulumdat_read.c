/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading EULUMDAT [stockmar1990]: one field a line, in fixed order.  Intensities are cd per kilolumen of the (first) lamp set.
 * EULUMDAT's length lies along C90-C270 (C0-C180 is the plane across a linear luminaire), its width along C0-C180.
 */
#include "photometry_file.h"

#include "text.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct lines {
    const char *at; /* the next line */
    unsigned line;  /* number of the last one taken */
    lmg_error *err;
} lines;

/* The next line without its end; false at the end of the file. */
static bool next_line(lines *l, const char **start, size_t *length)
{
    if (!*l->at)
        return false;
    *start = l->at;
    *length = strcspn(l->at, "\n");
    l->at += *length;
    l->at += *l->at == '\n';
    l->line++;
    while (*length && (unsigned char)**start <= ' ')
        (*start)++, (*length)--;
    while (*length && ((unsigned char)(*start)[*length - 1] <= ' '))
        (*length)--;
    return true;
}

static lmg_result cut_off(const lines *l, const char *what)
{
    return lmg_fail(l->err, LMG_ERROR_INPUT, "the file ends after line %u, where %s should be", l->line, what);
}

/* A number, with decimal comma or point; an empty line is 0, as old programs left fields blank. */
static lmg_result number(lines *l, const char *what, double least, double most, double *value)
{
    const char *start;
    size_t n;
    if (!next_line(l, &start, &n))
        return cut_off(l, what);
    char text[64];
    *value = 0;
    if (n == 0)
        return LMG_OK;
    const size_t kept = n < sizeof text ? n : sizeof text - 1;
    memcpy(text, start, kept);
    text[kept] = 0;
    for (char *c = text; *c; c++)
        *c = *c == ',' ? '.' : *c;
    if (n >= sizeof text || !lum_parse_number(text, n, value)) {
        lum_make_one_line(text);
        return lmg_fail(l->err, LMG_ERROR_INPUT, "line %u: \"%.24s\" is no number for %s", l->line, text, what);
    }
    if (!(*value >= least && *value <= most))
        return lmg_fail(l->err, LMG_ERROR_INPUT, "line %u: %s is %g, outside [%g, %g]", l->line, what, *value, least, most);
    return LMG_OK;
}

static lmg_result whole(lines *l, const char *what, double least, double most, int *value)
{
    double x;
    LUM_TRY(number(l, what, least, most, &x));
    if (x != floor(x))
        return lmg_fail(l->err, LMG_ERROR_INPUT, "line %u: %s is %g, not a whole number", l->line, what, x);
    *value = (int)x;
    return LMG_OK;
}

static lmg_result keyword(lines *l, lum_photometry *p, const char *name, const char *what)
{
    const char *start;
    size_t n;
    if (!next_line(l, &start, &n))
        return cut_off(l, what);
    return n ? lum_photometry_add_keyword(p, name, start, n, l->err) : LMG_OK;
}

static lmg_result words(lines *l, char *out, size_t size, const char *what)
{
    const char *start;
    size_t n;
    if (!next_line(l, &start, &n))
        return cut_off(l, what);
    snprintf(out, size, "%.*s", (int)(n < size ? n : size), start);
    lum_make_one_line(out);
    return LMG_OK;
}

static lmg_result read_lamps(lines *l, lum_photometry *p)
{
    int sets = 0;
    LUM_TRY(whole(l, "the number of lamp sets", 0, LUM_MAX_LAMP_SETS, &sets));
    p->lamp_set_count = sets > 0 ? (uint32_t)sets : 1;
    for (int i = 0; i < sets; i++) {
        lum_lamp_set *s = &p->lamp_sets[i];
        LUM_TRY(whole(l, "the number of lamps", -100000, 100000, &s->count));
        LUM_TRY(words(l, s->type, sizeof s->type, "the type of lamps"));
        LUM_TRY(number(l, "the total flux of the lamps", 0, 1e9, &s->flux));
        LUM_TRY(words(l, s->colour, sizeof s->colour, "the colour of the lamps"));
        LUM_TRY(words(l, s->cri, sizeof s->cri, "the colour rendering of the lamps"));
        LUM_TRY(number(l, "the watts of the lamps", 0, 1e9, &s->power));
        if (i == 0)
            p->absolute = s->count < 0;
        s->count = abs(s->count) > 0 ? abs(s->count) : 1;
    }
    p->lamp_sets[0].count = p->lamp_sets[0].count > 0 ? p->lamp_sets[0].count : 1;
    if (sets > 1)
        lum_photometry_warn(p, "%d lamp sets: intensities are for the first", sets);
    p->power = p->lamp_sets[0].power;
    return LMG_OK;
}

/* Which of the Mc listed planes are stored, for the symmetry: index of the first, and how many from there on (round the circle). */
static lmg_result stored_planes(lines *l, const double *c, int mc, int isym, int *first, int *count)
{
    static const double borders[5][2] = {{0, 360}, {0, 0}, {0, 180}, {270, 90}, {0, 90}};
    *first = *count = 0;
    if (isym <= 1) {
        *count = isym == 1 ? 1 : mc;
        return LMG_OK;
    }
    for (int k = 0; k < mc; k++) {
        const bool in = isym == 3 ? c[k] <= 90 || c[k] >= 270 : c[k] <= borders[isym][1];
        *count += in;
        if (c[k] == borders[isym][0])
            *first = k;
    }
    const int last = (*first + *count - 1) % mc;
    if (c[*first] != borders[isym][0] || c[last] != borders[isym][1])
        return lmg_fail(l->err, LMG_ERROR_INPUT, "symmetry %d needs planes at C%g and C%g in the list of C angles", isym,
                        borders[isym][0], borders[isym][1]);
    return LMG_OK;
}

/* The intensities of the stored planes; the last zeros of the last plane may be missing, as some programs cut them. */
static lmg_result read_intensities(lines *l, lum_photometry *p, double factor)
{
    double last = 1;
    for (uint32_t i = 0; i < p->h_count; i++)
        for (uint32_t j = 0; j < p->v_count; j++) {
            if (!*l->at && last == 0 && i + 1 == p->h_count && j > 0) {
                lum_photometry_warn(p, "the last %u values are missing and taken as 0, like the one before", p->v_count - j);
                return LMG_OK;
            }
            double x;
            LUM_TRY(number(l, "an intensity", -1e15, 1e15, &x));
            if (x < 0)
                return lmg_fail(l->err, LMG_ERROR_INPUT, "line %u: intensity %g at C%g, gamma %g is negative", l->line, x, p->h[i],
                                p->v[j]);
            p->intensity[(size_t)i * p->v_count + j] = x * factor;
            last = x;
        }
    return LMG_OK;
}

typedef struct header {
    int isym, mc, ng;
    double dc, dg, luminous[2], heights[4], factor;
} header;

static lmg_result read_header(lines *l, lum_photometry *p, header *h)
{
    int ityp = 0;
    double x, length, width, height;
    LUM_TRY(keyword(l, p, "MANUFAC", "the company"));
    LUM_TRY(whole(l, "the type indicator", 0, 3, &ityp));
    LUM_TRY(whole(l, "the symmetry indicator", 0, 4, &h->isym));
    LUM_TRY(whole(l, "the number of C planes", 1, LUM_MAX_ANGLES, &h->mc));
    LUM_TRY(number(l, "the distance of C planes", 0, 360, &h->dc));
    LUM_TRY(whole(l, "the number of gamma angles", 2, LUM_MAX_ANGLES, &h->ng));
    LUM_TRY(number(l, "the distance of gamma angles", 0, 180, &h->dg));
    LUM_TRY(keyword(l, p, "TEST", "the report number"));
    LUM_TRY(keyword(l, p, "LUMINAIRE", "the luminaire's name"));
    LUM_TRY(keyword(l, p, "LUMCAT", "the luminaire's number"));
    LUM_TRY(keyword(l, p, "_FILENAME", "the file name"));
    LUM_TRY(keyword(l, p, "ISSUEDATE", "date and user"));
    LUM_TRY(number(l, "the luminaire's length (mm)", 0, 1e6, &length));
    LUM_TRY(number(l, "the luminaire's width (mm)", 0, 1e6, &width));
    LUM_TRY(number(l, "the luminaire's height (mm)", 0, 1e6, &height));
    p->housing[0] = 1e-3 * (width > 0 ? width : length); /* width 0: round, length is the diameter */
    p->housing[1] = 1e-3 * length;
    p->housing[2] = 1e-3 * height;
    LUM_TRY(number(l, "the luminous length (mm)", 0, 1e6, &h->luminous[0]));
    LUM_TRY(number(l, "the luminous width (mm)", 0, 1e6, &h->luminous[1]));
    for (int i = 0; i < 4; i++) {
        LUM_TRY(number(l, "a luminous height (mm)", -1e6, 1e6, &h->heights[i]));
        p->side_heights[i] = 1e-3 * fabs(h->heights[i]);
    }
    LUM_TRY(number(l, "the downward flux fraction (%)", -1, 1000, &x));
    LUM_TRY(number(l, "the light output ratio (%)", -1, 1000, &x));
    LUM_TRY(number(l, "the conversion factor of intensities", 0, 1e9, &h->factor));
    if (h->factor == 0)
        h->factor = 1; /* left blank */
    LUM_TRY(number(l, "the tilt during measurement", -360, 360, &p->measured_tilt));
    if (ityp > 0) {
        char text[16];
        snprintf(text, sizeof text, "%d", ityp);
        LUM_TRY(lum_photometry_set_keyword(p, "_EULUMDAT_TYPE", text, l->err));
    }
    return LMG_OK;
}

static void find_shape(lum_photometry *p, const header *h)
{
    const double length = 1e-3 * h->luminous[0], width = 1e-3 * h->luminous[1];
    double height = 0;
    for (int i = 0; i < 4; i++)
        height += 0.25 * p->side_heights[i];
    const bool round = length > 0 && width == 0;
    p->shape.c90 = length;
    p->shape.c0 = round ? length : width;
    p->shape.height = height;
    const int extents = (p->shape.c0 > 0) + (p->shape.c90 > 0) + (height > 0);
    p->shape.kind = round          ? (height > 0 ? LUM_SHAPE_CYLINDER : LUM_SHAPE_ELLIPSE)
                    : extents == 0 ? LUM_SHAPE_POINT
                    : extents == 3 ? LUM_SHAPE_BOX
                                   : LUM_SHAPE_RECTANGLE;
}

lmg_result lum_eulumdat_read(const char *text, lum_photometry **out, lmg_error *err)
{
    *out = NULL;
    lines l = {text, 0, err};
    header h = {0};
    lum_photometry *head = NULL, *p = NULL;
    double *c = NULL;
    int first = 0, count = 0;
    LUM_TRY(lum_photometry_create(1, 1, &head, err));
    lmg_result result = read_header(&l, head, &h);
    if (result == LMG_OK)
        result = read_lamps(&l, head);
    head->has_direct_ratios = false;
    for (int i = 0; i < LUM_DIRECT_RATIOS && result == LMG_OK; i++) {
        result = number(&l, "a direct ratio", -1000, 1e6, &head->direct_ratios[i]);
        head->has_direct_ratios = head->has_direct_ratios || head->direct_ratios[i] != 0;
    }
    if (result == LMG_OK && !lum_count_fits((uint64_t)h.mc, 1, strlen(l.at)))
        result = lmg_fail(err, LMG_ERROR_INPUT, "line %u: the file is too short for %d C planes", l.line, h.mc);
    if (result == LMG_OK) {
        c = malloc((size_t)h.mc * sizeof *c);
        if (!c)
            result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %d C planes", h.mc);
    }
    for (int k = 0; k < h.mc && result == LMG_OK; k++)
        result = number(&l, "a C angle", -360, 720, &c[k]);
    if (result == LMG_OK)
        result = stored_planes(&l, c, h.mc, h.isym, &first, &count);
    if (result == LMG_OK && !lum_count_fits((uint64_t)count, (uint64_t)h.ng, 2 * strlen(l.at)))
        result =
            lmg_fail(err, LMG_ERROR_INPUT, "line %u: the file is too short for %d planes of %d intensities", l.line, count, h.ng);
    if (result == LMG_OK)
        result = lum_photometry_create((uint32_t)count, (uint32_t)h.ng, &p, err);
    if (result == LMG_OK) {
        /* The description moves over; the grid of head is the empty one. */
        lum_photometry grid = *p;
        *p = *head;
        p->h_count = grid.h_count, p->v_count = grid.v_count;
        p->h = grid.h, p->v = grid.v, p->intensity = grid.intensity;
        head->keyword_count = 0;
        head->keywords = NULL;
        snprintf(p->format, sizeof p->format, "EULUMDAT");
        static const lum_symmetry symmetries[] = {LUM_SYMMETRY_NONE, LUM_SYMMETRY_AXIAL, LUM_SYMMETRY_C0_C180,
                                                  LUM_SYMMETRY_C90_C270, LUM_SYMMETRY_QUADRANT};
        p->symmetry = symmetries[h.isym];
        for (int k = 0; k < count; k++) {
            const double angle = c[(first + k) % h.mc];
            p->h[k] = h.isym == 1 ? 0 : h.isym == 3 && angle >= 270 ? angle - 360 : angle;
        }
        for (uint32_t j = 0; j < p->v_count && result == LMG_OK; j++)
            result = number(&l, "a gamma angle", -360, 360, &p->v[j]);
    }
    if (result == LMG_OK) {
        double flux = p->lamp_sets[0].flux;
        if (!(flux > 0)) {
            lum_photometry_warn(p, "no lamp flux: intensities are for 1000 lm");
            flux = 1000;
        }
        find_shape(p, &h);
        result = read_intensities(&l, p, flux / 1000 * h.factor);
    }
    if (result == LMG_OK && h.isym == 0 && (p->h_count < 2 || p->h[0] != 0))
        result = lmg_fail(err, LMG_ERROR_INPUT, "symmetry 0 wants planes round the whole circle from C0 on, not %u from C%g",
                          p->h_count, p->h[0]);
    if (result == LMG_OK)
        result = lum_photometry_check(p, err);
    if (result == LMG_OK && h.isym == 0)
        result = lum_photometry_settle_symmetry(p, err);
    if (result == LMG_OK && l.at[strspn(l.at, " \t\n\x1a")])
        lum_photometry_warn(p, "lines after the last intensity are ignored");
    free(c);
    lum_photometry_destroy(head);
    if (result != LMG_OK) {
        lum_photometry_destroy(p);
        return result;
    }
    *out = p;
    return LMG_OK;
}
