/* SPDX-License-Identifier: Apache-2.0 */
/* Writing IES LM-63-2019 and 2002 [lm63]: label lines, lamp lines, grid.  Latin-1 text, CR LF, lines of at most 130 characters of
 * data and 254 of labels. */
#include "photometry_file.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

static void end_line(lum_output *o)
{
    lum_output_add(o, "\r\n", 2);
}

/* One label, long ones continued by [MORE]. */
static void label(lum_output *o, const char *name, const char *value)
{
    enum { LONGEST = 254 };
    size_t left = strlen(value);
    do {
        const size_t room = LONGEST - strlen(name) - 3;
        size_t n = left < room ? left : room;
        while (n < left && n > 1 && ((unsigned char)value[n] & 0xc0) == 0x80) /* not inside a character */
            n--;
        lum_output_add(o, "[", 1);
        lum_output_latin1(o, name, strlen(name));
        lum_output_add(o, "] ", 2);
        lum_output_latin1(o, value, n);
        end_line(o);
        value += n;
        left -= n;
        name = "MORE";
    } while (left);
}

/* Numbers one after the other, broken into lines. */
typedef struct row {
    lum_output *o;
    size_t column;
} row;

static void put(row *r, double value)
{
    char text[32];
    lum_format_number(text, value);
    const size_t n = strlen(text);
    if (r->column && r->column + 1 + n > 130) {
        end_line(r->o);
        r->column = 0;
    }
    if (r->column)
        lum_output_add(r->o, " ", 1);
    lum_output_add(r->o, text, n);
    r->column += n + (r->column > 0);
}

static void put_end(row *r)
{
    end_line(r->o);
    r->column = 0;
}

/* Width, length, height by the rules of 2002. */
static void opening(const lum_shape *s, double whl[3])
{
    double w = s->c90, l = s->c0, h = s->height;
    switch (s->kind) {
    case LUM_SHAPE_POINT:
        w = l = h = 0;
        break;
    case LUM_SHAPE_RECTANGLE:
    case LUM_SHAPE_BOX:
        break;
    case LUM_SHAPE_ELLIPSE:
        w = -w, l = -l, h = 0;
        break;
    case LUM_SHAPE_CYLINDER:
        w = -w, l = -l;
        break;
    case LUM_SHAPE_CYLINDER_C0:
        w = -w, h = -h;
        break;
    case LUM_SHAPE_CYLINDER_C90:
        l = -l, h = -h;
        break;
    case LUM_SHAPE_ELLIPSOID:
        w = -w, l = -l, h = -h;
        break;
    case LUM_SHAPE_ELLIPSE_FACING_C0:
        w = -w, l = 0, h = -h;
        break;
    }
    whl[0] = w + 0.0; /* no -0 */
    whl[1] = l + 0.0;
    whl[2] = h + 0.0;
}

void lum_ies_write(const lum_photometry *p, bool version_2019, const lum_photometry_write_options *options, lum_output *o,
                   char loss[512])
{
    static const char *const wanted[] = {"TEST", "TESTLAB", "ISSUEDATE", "MANUFAC"};
    char date[32];
    lum_document_date(options, date);
    lum_output_print(o, "%s\r\n", version_2019 ? "IES:LM-63-2019" : "IESNA:LM-63-2002");
    for (int i = 0; i < 4; i++)
        if (!lum_photometry_keyword(p, wanted[i]))
            label(o, wanted[i], i == 2 ? date : i == 1 && options->simulated ? "Lumibox, simulated" : "not given");
    for (uint32_t i = 0; i < p->keyword_count; i++)
        label(o, p->keywords[i].name, p->keywords[i].value);
    if (strcmp(p->unit, "cd") != 0 && !lum_photometry_keyword(p, "_INTENSITYUNITS"))
        label(o, "_INTENSITYUNITS", p->unit);
    row r = {o, 0};
    lum_output_print(o, "TILT=%s\r\n", p->tilt.count ? "INCLUDE" : "NONE");
    if (p->tilt.count) {
        put(&r, p->tilt.geometry);
        put_end(&r);
        put(&r, p->tilt.count);
        put_end(&r);
        for (uint32_t i = 0; i < p->tilt.count; i++)
            put(&r, p->tilt.angles[i]);
        put_end(&r);
        for (uint32_t i = 0; i < p->tilt.count; i++)
            put(&r, p->tilt.factors[i]);
        put_end(&r);
    }

    const lum_lamp_set *set = &p->lamp_sets[0];
    if (p->lamp_set_count > 1)
        lum_note_loss(loss, "%u of %u lamp sets", p->lamp_set_count - 1, p->lamp_set_count);
    if (p->has_direct_ratios)
        lum_note_loss(loss, "direct ratios");
    if (p->housing[0] > 0 || p->housing[1] > 0 || p->housing[2] > 0)
        lum_note_loss(loss, "size of the housing");
    double whl[3];
    opening(&p->shape, whl);
    const uint32_t n = p->h_count, m = p->v_count;
    /* A whole circle is closed by 360 = 0. */
    const bool close = p->type == LUM_TYPE_C && p->symmetry == LUM_SYMMETRY_NONE && p->h[n - 1] < 360;
    put(&r, set->count);
    put(&r, p->absolute || !(set->flux > 0) ? -1 : set->flux / set->count);
    put(&r, 1);
    put(&r, m);
    put(&r, n + close);
    put(&r, p->type);
    put(&r, 2);
    for (int i = 0; i < 3; i++)
        put(&r, whl[i]);
    put_end(&r);
    lum_output_print(o, "1 %s ", version_2019 ? (options->simulated ? "1.00010" : "1.00001") : "1");
    put(&r, p->power);
    put_end(&r);
    for (uint32_t j = 0; j < m; j++)
        put(&r, p->v[j]);
    put_end(&r);
    for (uint32_t i = 0; i < n; i++)
        put(&r, p->h[i]);
    if (close)
        put(&r, 360);
    put_end(&r);
    for (uint32_t i = 0; i < n + close; i++) {
        for (uint32_t j = 0; j < m; j++)
            put(&r, p->intensity[(size_t)(i % n) * m + j]);
        put_end(&r);
    }
}
