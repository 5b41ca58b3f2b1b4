/* SPDX-License-Identifier: Apache-2.0 */
/* What lumibake info says of a photometric file: grid, shape, flux and its zones, beam, and how small a smooth reconstruction of it
 * is. */
#include "info_photometry.h"

#include "program.h"

#include <luminaires/photometry.h>

#include <stdio.h>

/* Mean error that the smooth reconstruction is to reach. */
static const double SMOOTH = 0.01;
enum { FINEST = 6 };

static const char *const SYMMETRIES[] = {"none", "axial", "C0-C180", "C90-C270", "quadrant", "lateral"};
static const char *const SHAPES[] = {"point",         "rectangle",      "box",       "ellipse",          "cylinder",
                                     "cylinder (C0)", "cylinder (C90)", "ellipsoid", "ellipse facing C0"};

static void print(const lum_photometry *p, const lum_photometry_measures *m, const lum_octahedron_report *smooth)
{
    const char *unit = p->unit, *luminaire = lum_photometry_keyword(p, "LUMINAIRE");
    printf("%s, type %c, %u x %u angles, symmetry %s%s\n", p->format, " CBA"[p->type], p -> h_count, p -> v_count,
           SYMMETRIES[p->symmetry], p -> absolute ? ", absolute" : "");
    if (luminaire && *luminaire)
        printf("  luminaire  %s\n", luminaire);
    printf("  shape      %s, %g x %g x %g m (along C0, along C90, height)\n", SHAPES[p->shape.kind], p->shape.c0, p->shape.c90,
           p->shape.height);
    printf("  flux       %.6g lm: %.6g down, %.6g up\n", m->flux, m->down, m->up);
    if (m->lamp_flux > 0)
        printf("  lamps      %.6g lm, light output ratio %.1f %%\n", m->lamp_flux, 100 * m->efficiency);
    if (m->efficacy > 0)
        printf("  power      %g W, %.4g lm/W\n", p->power, m->efficacy);
    printf("  peak       %.6g %s at C %g, gamma %g\n", m->peak, unit, m->peak_c, m->peak_gamma);
    printf("  beam       %.1f degrees (%.1f and %.1f across), field %.1f\n", m->beam_angle, m->beam_c0, m->beam_c90,
           m->field_angle);
    printf("  zones      gamma   lm\n");
    for (int k = 0; k < LUM_ZONES; ++k)
        if (m->zonal[k] > 0)
            printf("           %3d-%-3d   %.6g\n", 10 * k, 10 * (k + 1), m->zonal[k]);
    if (smooth)
        printf("  smooth     %u coefficients on the octahedron up to level %u, %zu bytes: mean error %.2f %%, RMS %.2f %%\n",
               smooth->coefficients, smooth->level, smooth->bytes, 100 * smooth->mean_error, 100 * smooth->rms_error);
    if (p->warnings[0])
        printf("  remarks    %s\n", p->warnings);
}

static json_t *as_json(const lum_photometry *p, const lum_photometry_measures *m, const lum_octahedron_report *smooth)
{
    const char type[2] = {" CBA"[p->type], 0};
    json_t *zones = json_array(), *keywords = json_array();
    for (int k = 0; k < LUM_ZONES; ++k)
        json_array_append_new(zones, json_real(m->zonal[k]));
    for (uint32_t i = 0; i < p->keyword_count; ++i)
        json_array_append_new(keywords, json_pack("[s, s]", p->keywords[i].name, p->keywords[i].value));
    json_t *o = json_pack(
        "{s:s, s:s, s:s, s:s, s:[i, i], s:b, s:s, s:{s:s, s:[f, f, f]}, s:f, s:f, s:f, s:o, s:f, s:f, s:f, s:f, s:[f, f], "
        "s:f, s:f, s:s, s:o}",
        "format", "lumibake info 1", "photometry", p->format, "type", type, "symmetry", SYMMETRIES[p->symmetry], "angles",
        (int)p->h_count, (int)p->v_count, "absolute", (int)p->absolute, "unit", p->unit, "shape", "kind", SHAPES[p->shape.kind],
        "extents_m", p->shape.c0, p->shape.c90, p->shape.height, "flux", m->flux, "flux_down", m->down, "flux_up", m->up, "zones",
        zones, "lamp_flux", m->lamp_flux, "efficiency", m->efficiency, "efficacy", m->efficacy, "peak", m->peak, "peak_c_gamma",
        m->peak_c, m->peak_gamma, "beam_angle", m->beam_angle, "field_angle", m->field_angle, "remarks", p->warnings, "keywords",
        keywords);
    if (o && smooth)
        json_object_set_new(o, "smooth",
                            json_pack("{s:i, s:i, s:I, s:f, s:f}", "level", (int)smooth->level, "coefficients",
                                      (int)smooth->coefficients, "bytes", (json_int_t)smooth->bytes, "mean_error",
                                      smooth->mean_error, "rms_error", smooth->rms_error));
    return o;
}

lmg_result info_photometry(const char *path, bool json, json_t **object, lmg_error *err)
{
    *object = NULL;
    lum_photometry *p;
    lmg_result result = lum_photometry_read(path, &p, err);
    if (result != LMG_OK)
        return result;
    lum_photometry_measures m;
    lum_octahedron *octahedron = NULL;
    lum_octahedron_report smooth;
    result = lum_photometry_measure(p, &m, err);
    if (result == LMG_OK && m.flux > 0) {
        result = lum_octahedron_create(p, FINEST, SMOOTH, &octahedron, err);
        if (result == LMG_OK)
            smooth = lum_octahedron_get_report(octahedron);
    }
    if (result == LMG_OK && json)
        *object = as_json(p, &m, octahedron ? &smooth : NULL);
    else if (result == LMG_OK)
        print(p, &m, octahedron ? &smooth : NULL);
    lum_octahedron_destroy(octahedron);
    lum_photometry_destroy(p);
    return result;
}
