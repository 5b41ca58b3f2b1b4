/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading ANSI/IES TM-33 (XML) and its origin ATLA S001 [tm33].  Elements are known by their local names, so that the dialects of
 * 2018 and 2023 read alike.  Of an emitter the luminous intensities are taken; spectra and other quantities are named and left.
 * Relies on libxml2: entities aren't expanded, nothing is fetched, its limits on size and depth stand.
 */
#include "photometry_file.h"

#include "text.h"

#include <libxml/parser.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static const char *name_of(const xmlNode *node)
{
    return (const char *)node->name;
}

/* The next child element called name (NULL: any) after `after` (NULL: the first). */
static xmlNode *child(const xmlNode *parent, const xmlNode *after, const char *name)
{
    for (xmlNode *n = after ? after->next : parent ? parent->children : NULL; n; n = n->next)
        if (n->type == XML_ELEMENT_NODE && (!name || strcmp(name_of(n), name) == 0))
            return n;
    return NULL;
}

/* An element's own text, blanks at both ends cut; "" when absent.  buffer keeps at most size - 1 bytes; false if it was longer. */
static bool text_of(const xmlNode *node, char *buffer, size_t size)
{
    size_t n = 0;
    bool whole = true;
    for (const xmlNode *t = node ? node->children : NULL; t; t = t->next) {
        if (t->type != XML_TEXT_NODE && t->type != XML_CDATA_SECTION_NODE)
            continue;
        const char *s = (const char *)t->content;
        for (; s && *s; s++) {
            if (n == 0 && (unsigned char)*s <= ' ')
                continue;
            if (n + 1 < size)
                buffer[n++] = *s;
            else
                whole = false;
        }
    }
    while (n && (unsigned char)buffer[n - 1] <= ' ')
        n--;
    buffer[n] = 0;
    return whole;
}

static unsigned line_of(const xmlNode *node)
{
    const long line = xmlGetLineNo(node);
    return line > 0 ? (unsigned)line : 0;
}

/* Number in a child element, or fallback when absent or empty. */
static lmg_result number(const xmlNode *parent, const char *name, double least, double most, double fallback, double *value,
                         lmg_error *err)
{
    const xmlNode *node = child(parent, NULL, name);
    char text[64];
    *value = fallback;
    if (!node)
        return LMG_OK;
    const bool whole = text_of(node, text, sizeof text);
    if (!*text)
        return LMG_OK;
    if (!whole || !lum_parse_number(text, strlen(text), value) || !(*value >= least && *value <= most)) {
        lum_make_one_line(text);
        return lmg_fail(err, LMG_ERROR_INPUT, "line %u: <%s> is \"%.24s\", not a number in [%g, %g]", line_of(node), name, text,
                        least, most);
    }
    return LMG_OK;
}

static lmg_result keyword(lum_photometry *p, const xmlNode *parent, const char *element, const char *name, lmg_error *err)
{
    char text[1024];
    for (const xmlNode *n = child(parent, NULL, element); n; n = child(parent, n, element)) {
        text_of(n, text, sizeof text);
        for (char *c = text; *c; c++)
            if (*c == '\n')
                *c = ' ';
        if (*text)
            LUM_TRY(lum_photometry_add_keyword(p, name, text, strlen(text), err));
    }
    return LMG_OK;
}

/* ---------------------------------------------------------------------------------------------------------- intensities */

typedef struct point {
    double h, v, cd;
    unsigned line;
} point;

static int by_angles(const void *a, const void *b)
{
    const point *p = a, *q = b;
    return p->h != q->h ? (p->h < q->h ? -1 : 1) : p->v != q->v ? (p->v < q->v ? -1 : 1) : 0;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static lmg_result attribute(const xmlNode *node, const char *const names[2], double *value, lmg_error *err)
{
    for (int i = 0; i < 2; i++) {
        xmlChar *text = xmlGetNoNsProp(node, (const xmlChar *)names[i]);
        if (!text)
            continue;
        const char *s = (const char *)text;
        s += strspn(s, " \t\n\r");
        size_t n = strlen(s);
        while (n && (unsigned char)s[n - 1] <= ' ')
            n--;
        const bool ok = lum_parse_number(s, n, value);
        xmlFree(text);
        return ok ? LMG_OK
                  : lmg_fail(err, LMG_ERROR_INPUT, "line %u: attribute %s of <%s> is no number", line_of(node), names[i],
                             name_of(node));
    }
    return lmg_fail(err, LMG_ERROR_INPUT, "line %u: <%s> lacks the attribute %s", line_of(node), name_of(node), names[0]);
}

static size_t distinct(double *x, size_t n)
{
    qsort(x, n, sizeof *x, by_value);
    size_t kept = 0;
    for (size_t i = 0; i < n; i++)
        if (kept == 0 || x[i] != x[kept - 1])
            x[kept++] = x[i];
    return kept;
}

/* The points as a grid; at the poles, where all planes meet, one value may stand for all. */
static lmg_result make_grid(point *points, size_t n, double factor, lum_photometry **out, lmg_error *err)
{
    double *h = malloc(n * sizeof *h), *v = malloc(n * sizeof *v);
    lmg_result result = LMG_OK;
    lum_photometry *p = NULL;
    if (!h || !v)
        result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %zu intensities", n);
    size_t nh = 0, nv = 0;
    if (result == LMG_OK) {
        for (size_t i = 0; i < n; i++) {
            h[i] = points[i].h;
            v[i] = points[i].v;
        }
        nh = distinct(h, n);
        nv = distinct(v, n);
        qsort(points, n, sizeof *points, by_angles);
        if (nh > LUM_MAX_ANGLES || nv > LUM_MAX_ANGLES || nh * nv > 4 * n)
            result =
                lmg_fail(err, LMG_ERROR_INPUT, "%zu intensities at %zu horizontal and %zu vertical angles are no grid", n, nh, nv);
    }
    if (result == LMG_OK)
        result = lum_photometry_create((uint32_t)nh, (uint32_t)nv, &p, err);
    if (result == LMG_OK) {
        memcpy(p->h, h, nh * sizeof *h);
        memcpy(p->v, v, nv * sizeof *v);
        size_t k = 0;
        for (size_t i = 0; i < nh && result == LMG_OK; i++)
            for (size_t j = 0; j < nv && result == LMG_OK; j++) {
                double *cell = &p->intensity[i * nv + j];
                if (k < n && points[k].h == h[i] && points[k].v == v[j]) {
                    *cell = points[k].cd * factor;
                    k++;
                    if (k < n && points[k].h == h[i] && points[k].v == v[j])
                        result = lmg_fail(err, LMG_ERROR_INPUT, "line %u: a second intensity at horizontal %g, vertical %g",
                                          points[k].line, h[i], v[j]);
                } else if (i > 0 && (v[j] == 0 || v[j] == 180)) {
                    *cell = p->intensity[j];
                } else {
                    result = lmg_fail(err, LMG_ERROR_INPUT, "no intensity at horizontal %g, vertical %g: the grid isn't complete",
                                      h[i], v[j]);
                }
            }
    }
    free(h);
    free(v);
    if (result != LMG_OK) {
        lum_photometry_destroy(p);
        return result;
    }
    *out = p;
    return LMG_OK;
}

/* The intensities of one emitter. */
static lmg_result read_intensities(const xmlNode *luminous, lum_photometry **out, lmg_error *err)
{
    static const char *const horizontal[2] = {"horz", "h"}, *const vertical[2] = {"vert", "v"};
    /* TM-33 has them in LuminousData, S001 one level below. */
    const xmlNode *parent = child(luminous, NULL, "LuminousIntensity");
    parent = parent ? parent : luminous;
    const char *element = child(parent, NULL, "IntData") ? "IntData" : "IntensityData";
    double factor;
    LUM_TRY(number(parent, "Multiplier", 1e-12, 1e12, 1, &factor, err));
    size_t n = 0, k = 0;
    for (const xmlNode *x = child(parent, NULL, element); x; x = child(parent, x, element))
        n++;
    if (n == 0)
        return lmg_fail(err, LMG_ERROR_INPUT, "line %u: <%s> holds no <IntensityData>", line_of(luminous), name_of(luminous));
    point *points = malloc(n * sizeof *points);
    if (!points)
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %zu intensities", n);
    lmg_result result = LMG_OK;
    for (const xmlNode *x = child(parent, NULL, element); x && result == LMG_OK; x = child(parent, x, element), k++) {
        char text[64];
        const bool whole = text_of(x, text, sizeof text);
        points[k].line = line_of(x);
        result = attribute(x, horizontal, &points[k].h, err);
        if (result == LMG_OK)
            result = attribute(x, vertical, &points[k].v, err);
        if (result == LMG_OK && (!whole || !lum_parse_number(text, strlen(text), &points[k].cd))) {
            lum_make_one_line(text);
            result = lmg_fail(err, LMG_ERROR_INPUT, "line %u: \"%.24s\" is no intensity", line_of(x), text);
        }
        if (result == LMG_OK && points[k].cd < 0)
            result = lmg_fail(err, LMG_ERROR_INPUT, "line %u: intensity %g is negative", line_of(x), points[k].cd);
    }
    if (result == LMG_OK)
        result = make_grid(points, n, factor, out, err);
    free(points);
    if (result != LMG_OK)
        return result;
    /* "CIE _ C", "IES_B" and so on: the last letter says it. */
    char type[64], metric[64];
    text_of(child(parent, NULL, "PhotometryType"), type, sizeof type);
    const size_t length = strlen(type);
    (*out)->type = length && type[length - 1] == 'B' ? LUM_TYPE_B : length && type[length - 1] == 'A' ? LUM_TYPE_A : LUM_TYPE_C;
    text_of(child(parent, NULL, "Metric"), metric, sizeof metric);
    result = *metric && strcasecmp(metric, "Luminous") != 0
                 ? lmg_fail(err, LMG_ERROR_UNSUPPORTED, "the metric is \"%.40s\"; only luminous intensities are read", metric)
                 : lum_photometry_settle_symmetry(*out, err);
    if (result == LMG_OK)
        result = lum_photometry_check(*out, err);
    if (result != LMG_OK) {
        lum_photometry_destroy(*out);
        *out = NULL;
    }
    return result;
}

/* Adds a further emitter's light: on the same grid, or on a common one of 5 x 1 degrees. */
static lmg_result add_light(lum_photometry **sum, lum_photometry *more, lmg_error *err)
{
    lum_photometry *a = *sum;
    const size_t grid = (size_t)a->h_count * a->v_count;
    if (a->type == more->type && a->symmetry == more->symmetry && a->h_count == more->h_count && a->v_count == more->v_count &&
        memcmp(a->h, more->h, a->h_count * sizeof *a->h) == 0 && memcmp(a->v, more->v, a->v_count * sizeof *a->v) == 0) {
        for (size_t i = 0; i < grid; i++)
            a->intensity[i] += more->intensity[i];
        return LMG_OK;
    }
    lum_photometry *b;
    LUM_TRY(lum_photometry_resample(a, 72, 181, &b, err));
    for (uint32_t i = 0; i < b->h_count; i++)
        for (uint32_t j = 0; j < b->v_count; j++)
            b->intensity[(size_t)i * b->v_count + j] +=
                lum_photometry_intensity(more, lum_direction_from_c_gamma(b->h[i], b->v[j]));
    lum_photometry_warn(b, "emitters with different angles, summed on a grid of 5 x 1 degrees");
    lum_photometry_destroy(a);
    *sum = b;
    return LMG_OK;
}

/* ---------------------------------------------------------------------------------------------------------- description */

/* The rectangle round the emission areas of the bottom face; unit: metres per unit of length. */
static lmg_result find_shape(const xmlNode *emitter, double unit, lum_photometry *p, lmg_error *err)
{
    const xmlNode *face = child(child(emitter, NULL, "EmissionAreas"), NULL, "BottomFace");
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    unsigned areas = 0;
    for (const xmlNode *a = child(face, NULL, "BottomArea"); a; a = child(face, a, "BottomArea"), areas++) {
        double size[2], offset[2];
        LUM_TRY(number(a, "Length", 0, 1e6, 0, &size[0], err));
        LUM_TRY(number(a, "Width", 0, 1e6, 0, &size[1], err));
        LUM_TRY(number(a, "LengthOffset", -1e6, 1e6, 0, &offset[0], err));
        LUM_TRY(number(a, "WidthOffset", -1e6, 1e6, 0, &offset[1], err));
        for (int k = 0; k < 2; k++) {
            low[k] = fmin(low[k], unit * (offset[k] - 0.5 * size[k]));
            high[k] = fmax(high[k], unit * (offset[k] + 0.5 * size[k]));
        }
    }
    if (areas == 0)
        return LMG_OK;
    /* As in LM-63: length along C0-C180. */
    p->shape.c0 = high[0] - low[0];
    p->shape.c90 = high[1] - low[1];
    p->shape.kind = p->shape.c0 > 0 || p->shape.c90 > 0 ? LUM_SHAPE_RECTANGLE : LUM_SHAPE_POINT;
    if (areas > 1)
        lum_photometry_warn(p, "%u emission areas, taken as the rectangle around them", areas);
    return LMG_OK;
}

static lmg_result describe(const xmlNode *root, double unit, lum_photometry *p, lmg_error *err)
{
    static const char *const header[][2] = {{"Manufacturer", "MANUFAC"},
                                            {"CatalogNumber", "LUMCAT"},
                                            {"Description", "LUMINAIRE"},
                                            {"Laboratory", "TESTLAB"},
                                            {"ReportNumber", "TEST"},
                                            {"ReportDate", "TESTDATE"},
                                            {"DocumentCreator", "_DOCUMENTCREATOR"},
                                            {"DocumentCreationDate", "ISSUEDATE"},
                                            {"UniqueIdentifier", "_UNIQUEIDENTIFIER"},
                                            {"Comments", "OTHER"},
                                            {"Comment", "OTHER"}};
    for (size_t i = 0; i < sizeof header / sizeof *header; i++)
        LUM_TRY(keyword(p, child(root, NULL, "Header"), header[i][0], header[i][1], err));
    const xmlNode *size = child(child(root, NULL, "Luminaire"), NULL, "Dimensions");
    static const char *const names[3] = {"Length", "Width", "Height"};
    for (int i = 0; i < 3; i++) {
        double x;
        LUM_TRY(number(size, names[i], 0, 1e6, 0, &x, err));
        p->housing[i] = unit * x;
    }
    return LMG_OK;
}

static lmg_result read_document(const xmlNode *root, lum_photometry **out, lmg_error *err)
{
    const bool tm33 = strncmp(name_of(root), "IESTM33", 7) == 0, s001 = strncmp(name_of(root), "ATLA_S001", 9) == 0;
    if (!tm33 && !s001 && strcmp(name_of(root), "LuminaireOpticalData") != 0) {
        char name[64];
        snprintf(name, sizeof name, "%.60s", name_of(root));
        lum_make_one_line(name);
        return lmg_fail(err, LMG_ERROR_INPUT, "<%s> is no TM-33 document (IESTM33-22, LuminaireOpticalData or ATLA_S001)", name);
    }
    /* Lengths are millimetres in TM-33 and metres in ATLA S001. */
    const double unit = tm33 ? 1e-3 : 1;
    double lumens = 0, watts = 0;
    unsigned emitters = 0;
    lmg_result result = LMG_OK;
    bool dropped = false;
    for (const xmlNode *e = child(root, NULL, "Emitter"); e && result == LMG_OK; e = child(root, e, "Emitter")) {
        const xmlNode *luminous = child(e, NULL, "LuminousData");
        dropped = dropped || child(e, NULL, "SpectralDistribution") || child(e, NULL, "SpectralData") ||
                  child(e, NULL, "RadiantData") || child(e, NULL, "PhotonData");
        if (!luminous)
            continue;
        lum_photometry *light = NULL;
        double rated = 0, power = 0, quantity = 1;
        result = read_intensities(luminous, &light, err);
        if (result == LMG_OK)
            result = number(e, "RatedLumens", -1, 1e9, 0, &rated, err);
        if (result == LMG_OK)
            result = number(e, "InputWattage", -1, 1e9, 0, &power, err);
        if (result == LMG_OK)
            result = number(e, "Quantity", 0, 1e6, 1, &quantity, err);
        lumens += fmax(rated, 0);
        watts += fmax(power, 0);
        if (result == LMG_OK && !*out) {
            *out = light;
            light = NULL;
            (*out)->lamp_sets[0].count = quantity >= 1 ? (int)quantity : 1;
            char text[64];
            text_of(child(e, NULL, "Description"), text, sizeof text);
            snprintf((*out)->lamp_sets[0].type, sizeof(*out)->lamp_sets[0].type, "%s", text);
            lum_make_one_line((*out)->lamp_sets[0].type);
            result = find_shape(e, unit, *out, err);
        } else if (result == LMG_OK) {
            result = add_light(out, light, err);
        }
        emitters += result == LMG_OK;
        lum_photometry_destroy(light);
    }
    if (result == LMG_OK && emitters == 0)
        result = lmg_fail(err, LMG_ERROR_INPUT, "no <Emitter> with <LuminousData>");
    if (result == LMG_OK)
        result = describe(root, unit, *out, err);
    if (result == LMG_OK) {
        lum_photometry *p = *out;
        char version[32];
        text_of(child(root, NULL, "Version"), version, sizeof version);
        snprintf(p->format, sizeof p->format, "%.28s%s%.24s", name_of(root), *version ? " " : "", version);
        lum_make_one_line(p->format);
        p->absolute = true; /* TM-33 data are absolute; rated lumens are only told */
        p->lamp_sets[0].flux = lumens;
        p->lamp_sets[0].power = p->power = watts;
        if (emitters > 1)
            lum_photometry_warn(p, "%u emitters, summed", emitters);
        if (dropped)
            lum_photometry_warn(p, "spectral, radiant and photon data are left out");
        result = lum_photometry_check(p, err);
    }
    if (result != LMG_OK) {
        lum_photometry_destroy(*out);
        *out = NULL;
    }
    return result;
}

lmg_result lum_tm33_read(const char *bytes, size_t size, lum_photometry **out, lmg_error *err)
{
    *out = NULL;
    if (size > INT32_MAX)
        return lmg_fail(err, LMG_ERROR_INPUT, "an XML file of %zu MB is too large", size >> 20);
    xmlParserCtxt *context = xmlNewParserCtxt();
    if (!context)
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for an XML parser");
    xmlDoc *doc =
        xmlCtxtReadMemory(context, bytes, (int)size, NULL, NULL, XML_PARSE_NONET | XML_PARSE_NOERROR | XML_PARSE_NOWARNING);
    lmg_result result;
    if (!doc) {
        const xmlError *e = xmlCtxtGetLastError(context);
        char text[200] = "no XML";
        if (e && e->message)
            snprintf(text, sizeof text, "%s", e->message);
        text[strcspn(text, "\n")] = 0;
        lum_make_one_line(text);
        result = lmg_fail(err, LMG_ERROR_INPUT, "line %d: not well-formed XML: %s", e ? e->line : 0, text);
    } else {
        const xmlNode *root = xmlDocGetRootElement(doc);
        result = root ? read_document(root, out, err) : lmg_fail(err, LMG_ERROR_INPUT, "the XML document is empty");
    }
    xmlFreeDoc(doc);
    xmlFreeParserCtxt(context);
    return result;
}
