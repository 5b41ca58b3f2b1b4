/* SPDX-License-Identifier: Apache-2.0 */
/* Writing EULUMDAT [stockmar1990]: type C photometry in cd per kilolumen, all listed C angles and the stored planes.  Latin-1, CR
 * LF. */
#include "photometry_file.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void text_line(lum_output *o, const char *text, size_t most)
{
    size_t n = text ? strlen(text) : 0;
    n = n < most ? n : most;
    lum_output_latin1(o, text ? text : "", n);
    lum_output_add(o, "\r\n", 2);
}

static void number_line(lum_output *o, double value)
{
    char text[32];
    lum_format_number(text, value);
    lum_output_print(o, "%s\r\n", text);
}

/* The common step of angles, 0 if they have none. */
static double step_of(const double *x, uint32_t n, double end)
{
    if (n < 2)
        return 0;
    const double step = x[1] - x[0];
    for (uint32_t i = 1; i < n; i++)
        if (fabs(x[i] - x[i - 1] - step) > 1e-6)
            return 0;
    return end > 0 && fabs(x[n - 1] + step - end) > 1e-6 ? 0 : step;
}

/* The whole list of C angles in [0,360): the stored ones and their mirror images.  n_out: their number. */
static double *all_planes(const lum_photometry *p, uint32_t *n_out)
{
    const uint32_t n = p->h_count;
    double *c = malloc(4 * (size_t)n * sizeof *c);
    uint32_t k = 0;
    if (!c)
        return NULL;
    switch (p->symmetry) {
    case LUM_SYMMETRY_C0_C180: /* 0..180, then back */
        for (uint32_t i = 0; i < n; i++)
            c[k++] = p->h[i];
        for (uint32_t i = n - 2; i >= 1; i--)
            c[k++] = 360 - p->h[i];
        break;
    case LUM_SYMMETRY_C90_C270: /* from plane 0 (or the first beyond it) to 90, the mirror images to 270, the rest up to 360 */
        for (uint32_t i = 0; i < n; i++)
            if (p->h[i] >= 0)
                c[k++] = p->h[i];
        for (uint32_t i = n - 1; i-- > 1;)
            c[k++] = 180 - p->h[i];
        for (uint32_t i = 0; i < n; i++)
            if (p->h[i] < 0)
                c[k++] = 360 + p->h[i];
        break;
    case LUM_SYMMETRY_QUADRANT:
        for (uint32_t i = 0; i < n; i++)
            c[k++] = p->h[i];
        for (uint32_t i = n - 1; i-- > 0;)
            c[k++] = 180 - p->h[i];
        for (uint32_t i = 1; i < n; i++)
            c[k++] = 180 + p->h[i];
        for (uint32_t i = n - 1; i-- > 1;)
            c[k++] = 360 - p->h[i];
        break;
    default: /* the whole circle without its end, or one plane */
        for (uint32_t i = 0; i < n; i++)
            if (p->h[i] < 360)
                c[k++] = p->h[i];
        break;
    }
    *n_out = k;
    return c;
}

void lum_eulumdat_write(const lum_photometry *p, const lum_photometry_write_options *options, double flux, double down,
                        lum_output *o, char loss[512])
{
    static const int isym[] = {0, 1, 2, 3, 4};
    const lum_symmetry symmetry = p->symmetry;
    uint32_t mc = 0, stored = p->h_count;
    double *c = all_planes(p, &mc);
    if (!c) {
        o->failed = true;
        return;
    }
    if (symmetry == LUM_SYMMETRY_NONE && p->h[p->h_count - 1] == 360) { /* EULUMDAT's circle has no end */
        stored--;
        for (uint32_t j = 0; j < p->v_count; j++)
            if (p->intensity[j] != p->intensity[(size_t)stored * p->v_count + j]) {
                lum_note_loss(loss, "plane C360, which differs from C0");
                break;
            }
    }
    char date[32];
    lum_document_date(options, date);
    const lum_shape *s = &p->shape;
    const char *issue = lum_photometry_keyword(p, "ISSUEDATE"), *kind = lum_photometry_keyword(p, "_EULUMDAT_TYPE");
    const bool linear = fmax(s->c0, s->c90) > 2 * fmin(s->c0, s->c90) && s->kind != LUM_SHAPE_POINT;
    const int ityp = kind && strlen(kind) == 1 && *kind >= '1' && *kind <= '3' ? *kind - '0'
                     : symmetry == LUM_SYMMETRY_AXIAL                          ? 1
                     : linear                                                  ? 2
                                                                               : 3;
    text_line(o, lum_photometry_keyword(p, "MANUFAC"), 78);
    number_line(o, ityp);
    number_line(o, isym[symmetry]);
    number_line(o, mc);
    number_line(o, step_of(c, mc, 360));
    number_line(o, p->v_count);
    number_line(o, step_of(p->v, p->v_count, 0));
    text_line(o, lum_photometry_keyword(p, "TEST"), 78);
    text_line(o, lum_photometry_keyword(p, "LUMINAIRE"), 78);
    text_line(o, lum_photometry_keyword(p, "LUMCAT"), 78);
    text_line(o, lum_photometry_keyword(p, "_FILENAME"), 78);
    text_line(o, issue ? issue : date, 78);

    const bool round_housing = s->kind == LUM_SHAPE_ELLIPSE && s->c0 == s->c90 && p->housing[0] == p->housing[1];
    number_line(o, 1e3 * p->housing[1]);
    number_line(o, round_housing ? 0 : 1e3 * p->housing[0]);
    number_line(o, 1e3 * p->housing[2]);
    const bool round_shape = (s->kind == LUM_SHAPE_ELLIPSE || s->kind == LUM_SHAPE_CYLINDER) && s->c0 == s->c90;
    if (s->kind != LUM_SHAPE_POINT && s->kind != LUM_SHAPE_RECTANGLE && s->kind != LUM_SHAPE_BOX && !round_shape)
        lum_note_loss(loss, "the luminous shape, written as its bounding box");
    number_line(o, 1e3 * s->c90);
    number_line(o, round_shape ? 0 : 1e3 * s->c0);
    double sides = 0;
    for (int i = 0; i < 4; i++)
        sides += 0.25 * p->side_heights[i];
    for (int i = 0; i < 4; i++) /* the four sides as read, unless the shape has changed since */
        number_line(o, 1e3 * (fabs(sides - s->height) <= 1e-9 ? p->side_heights[i] : s->height));

    const lum_lamp_set *first = &p->lamp_sets[0];
    const bool relative = !p->absolute && first->flux > 0;
    const double reference = relative ? first->flux : p->absolute && first->flux > 0 ? first->flux : flux > 0 ? flux : 1000;
    number_line(o, flux > 0 ? 100 * down / flux : 0);
    number_line(o, relative ? 100 * flux / reference : 100);
    number_line(o, 1);
    number_line(o, p->measured_tilt);
    number_line(o, p->lamp_set_count);
    for (uint32_t i = 0; i < p->lamp_set_count; i++) {
        const lum_lamp_set *set = &p->lamp_sets[i];
        number_line(o, relative ? set->count : -set->count);
        const char *type = set->type[0] || i ? set->type : lum_photometry_keyword(p, "LAMP");
        text_line(o, type, 40);
        number_line(o, i == 0 ? reference : set->flux);
        text_line(o, set->colour, 24);
        text_line(o, set->cri, 24);
        number_line(o, set->power);
    }
    for (int i = 0; i < LUM_DIRECT_RATIOS; i++)
        number_line(o, p->direct_ratios[i]);
    for (uint32_t k = 0; k < mc; k++)
        number_line(o, c[k]);
    for (uint32_t j = 0; j < p->v_count; j++)
        number_line(o, p->v[j]);
    for (uint32_t i = 0; i < stored; i++)
        for (uint32_t j = 0; j < p->v_count; j++)
            number_line(o, p->intensity[(size_t)i * p->v_count + j] * 1000 / reference);
    free(c);
    static const char *const kept[] = {"MANUFAC",   "TEST",      "LUMINAIRE",      "LUMCAT",
                                       "_FILENAME", "ISSUEDATE", "_EULUMDAT_TYPE", "LAMP"};
    unsigned lost = 0;
    for (uint32_t i = 0; i < p->keyword_count; i++) {
        bool has = false;
        for (size_t k = 0; k < sizeof kept / sizeof *kept; k++)
            has = has || strcmp(kept[k], p->keywords[i].name) == 0;
        lost += !has;
    }
    if (lost)
        lum_note_loss(loss, "%u keywords", lost);
    if (p->tilt.count)
        lum_note_loss(loss, "the tilt table");
}
