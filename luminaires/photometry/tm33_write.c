/* SPDX-License-Identifier: Apache-2.0 */
/* Writing ANSI/IES TM-33 (XML) [tm33]: one emitter with luminous intensities of type C.  Relies on libxml2's writer. */
#include "photometry_file.h"

#include <libxml/xmlwriter.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

static void element(xmlTextWriter *w, const char *name, const char *value)
{
    if (value && *value)
        xmlTextWriterWriteElement(w, (const xmlChar *)name, (const xmlChar *)value);
}

static void number(xmlTextWriter *w, const char *name, double value)
{
    char text[32];
    lum_format_number(text, value);
    element(w, name, text);
}

static void open(xmlTextWriter *w, const char *name)
{
    xmlTextWriterStartElement(w, (const xmlChar *)name);
}

static void header(xmlTextWriter *w, const lum_photometry *p, const char *date, char loss[512])
{
    static const char *const elements[][2] = {{"Manufacturer", "MANUFAC"},
                                              {"CatalogNumber", "LUMCAT"},
                                              {"Description", "LUMINAIRE"},
                                              {"Laboratory", "TESTLAB"},
                                              {"ReportNumber", "TEST"},
                                              {"ReportDate", "TESTDATE"},
                                              {"UniqueIdentifier", "_UNIQUEIDENTIFIER"},
                                              {"DocumentCreator", "_DOCUMENTCREATOR"},
                                              {"DocumentCreationDate", "ISSUEDATE"}};
    enum { COUNT = sizeof elements / sizeof *elements };
    open(w, "Header");
    for (int i = 0; i < COUNT; i++) {
        const char *value = lum_photometry_keyword(p, elements[i][1]);
        element(w, elements[i][0], value ? value : strcmp(elements[i][1], "ISSUEDATE") == 0 ? date : NULL);
    }
    /* Everything else goes into comments with its keyword; the first of a repeated keyword has its own element. */
    for (uint32_t k = 0; k < p->keyword_count; k++) {
        const lum_keyword *key = &p->keywords[k];
        bool own = false;
        for (int i = 0; i < COUNT; i++)
            own = own || (strcasecmp(key->name, elements[i][1]) == 0 && lum_photometry_keyword(p, key->name) == key->value);
        if (own || !*key->value)
            continue;
        if (strcasecmp(key->name, "OTHER") == 0)
            element(w, "Comments", key->value);
        else
            xmlTextWriterWriteFormatElement(w, (const xmlChar *)"Comments", "[%s] %s", key->name, key->value);
    }
    xmlTextWriterEndElement(w);
    if (p->tilt.count)
        lum_note_loss(loss, "the tilt table");
    if (p->has_direct_ratios)
        lum_note_loss(loss, "direct ratios");
    if (p->lamp_set_count > 1)
        lum_note_loss(loss, "%u of %u lamp sets", p->lamp_set_count - 1, p->lamp_set_count);
}

static void intensities(xmlTextWriter *w, const lum_photometry *p)
{
    static const char *const symmetries[] = {"Symm _ None", "Symm _ Full", "Symm _ Bi0", "Symm _ Bi90", "Symm _ Quad"};
    open(w, "LuminousData");
    element(w, "PhotometryType", "CIE _ C");
    element(w, "Metric", "Luminous");
    element(w, "SymmType", symmetries[p->symmetry]);
    element(w, "Multiplier", "1.0");
    for (uint32_t i = 0; i < p->h_count; i++)
        for (uint32_t j = 0; j < p->v_count; j++) {
            char h[32], v[32], cd[32];
            lum_format_number(h, p->h[i]);
            lum_format_number(v, p->v[j]);
            lum_format_number(cd, p->intensity[(size_t)i * p->v_count + j]);
            open(w, "IntensityData");
            xmlTextWriterWriteAttribute(w, (const xmlChar *)"horz", (const xmlChar *)h);
            xmlTextWriterWriteAttribute(w, (const xmlChar *)"vert", (const xmlChar *)v);
            xmlTextWriterWriteString(w, (const xmlChar *)cd);
            xmlTextWriterEndElement(w);
        }
    xmlTextWriterEndElement(w);
}

lmg_result lum_tm33_write(const lum_photometry *p, const lum_photometry_write_options *options, double flux, lum_output *o,
                          char loss[512], lmg_error *err)
{
    xmlBuffer *buffer = xmlBufferCreate();
    xmlTextWriter *w = buffer ? xmlNewTextWriterMemory(buffer, 0) : NULL;
    if (!w) {
        xmlBufferFree(buffer);
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory to write XML");
    }
    char date[32];
    lum_document_date(options, date);
    xmlTextWriterSetIndent(w, 1);
    xmlTextWriterStartDocument(w, NULL, "UTF-8", NULL);
    open(w, "IESTM33-22");
    element(w, "Version", "1.1");
    header(w, p, date, loss);
    open(w, "Luminaire");
    open(w, "Dimensions");
    number(w, "Length", 1e3 * p->housing[0]);
    number(w, "Width", 1e3 * p->housing[1]);
    number(w, "Height", 1e3 * p->housing[2]);
    xmlTextWriterEndElement(w);
    element(w, "NumEmitters", "1");
    xmlTextWriterEndElement(w);
    open(w, "Emitter");
    element(w, "Description", p->lamp_sets[0].type);
    number(w, "Quantity", 1);
    number(w, "RatedLumens", p->lamp_sets[0].flux > 0 ? p->lamp_sets[0].flux : flux);
    number(w, "InputWattage", p->power);
    intensities(w, p);
    if (p->shape.kind != LUM_SHAPE_POINT) {
        if (p->shape.kind != LUM_SHAPE_RECTANGLE || p->shape.height > 0)
            lum_note_loss(loss, "the luminous shape, written as the rectangle around it");
        open(w, "EmissionAreas");
        open(w, "BottomFace");
        element(w, "NumberBottom", "1");
        open(w, "BottomArea");
        number(w, "Length", 1e3 * p->shape.c0);
        number(w, "Width", 1e3 * p->shape.c90);
        for (int i = 0; i < 3; i++)
            xmlTextWriterEndElement(w);
    }
    xmlTextWriterEndElement(w);
    xmlTextWriterEndElement(w);
    const int ended = xmlTextWriterEndDocument(w);
    xmlFreeTextWriter(w);
    if (ended >= 0)
        lum_output_add(o, (const char *)xmlBufferContent(buffer), (size_t)xmlBufferLength(buffer));
    else
        o->failed = true;
    xmlBufferFree(buffer);
    return LMG_OK;
}
