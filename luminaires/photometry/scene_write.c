/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A distribution as a light in a scene of another renderer: UsdLux (a small sphere light shaped by an IES file) and glTF
 * (EXT_lights_ies, with a KHR_lights_punctual light of the same flux for readers that don't know it).  Both know IES profiles as
 * aimed along -Z with plane 0 towards +X; the node turns that to our -Y (down).
 */
#include "photometry_file.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

void lum_usd_write(const lum_photometry *p, const char *ies_name, double flux, lum_output *o)
{
    /* A sphere so small that only its flux is seen; the profile is normalized, so that it shapes and doesn't scale. */
    const double radius = 0.001, luminance = flux / (4 * PI * PI * radius * radius);
    const char *luminaire = lum_photometry_keyword(p, "LUMINAIRE");
    lum_output_print(o, "#usda 1.0\n(\n    defaultPrim = \"Luminaire\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\n"
                        "def Xform \"Luminaire\"\n{\n");
    if (luminaire && *luminaire) {
        lum_output_print(o, "    # ");
        lum_output_add(o, luminaire, strlen(luminaire));
        lum_output_print(o, "\n");
    }
    lum_output_print(o,
                     "    def SphereLight \"Light\" (\n        prepend apiSchemas = [\"ShapingAPI\"]\n    )\n    {\n"
                     "        float inputs:radius = %g\n        bool treatAsPoint = 1\n        float inputs:intensity = %.9g\n"
                     "        bool inputs:normalize = 0\n",
                     radius, luminance);
    lum_output_print(o, "        asset inputs:shaping:ies:file = @./");
    for (const char *c = ies_name; *c; c++) /* '@' would end the asset path */
        lum_output_add(o, *c == '@' ? "%40" : c, *c == '@' ? 3 : 1);
    lum_output_print(
        o, "@\n        bool inputs:shaping:ies:normalize = 1\n"
           "        float xformOp:rotateX = -90\n        uniform token[] xformOpOrder = [\"xformOp:rotateX\"]\n    }\n}\n");
}

static char *base64(const char *prefix, const char *bytes, size_t size)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const size_t start = strlen(prefix);
    char *out = malloc(start + (size + 2) / 3 * 4 + 1);
    if (!out)
        return NULL;
    memcpy(out, prefix, start);
    char *to = out + start;
    for (size_t i = 0; i < size; i += 3) {
        const unsigned left = size - i < 3 ? (unsigned)(size - i) : 3;
        unsigned bits = (unsigned)(unsigned char)bytes[i] << 16;
        bits |= left > 1 ? (unsigned)(unsigned char)bytes[i + 1] << 8 : 0;
        bits |= left > 2 ? (unsigned)(unsigned char)bytes[i + 2] : 0;
        for (unsigned k = 0; k < 4; k++)
            *to++ = k <= left ? digits[bits >> (18 - 6 * k) & 63] : '=';
    }
    *to = 0;
    return out;
}

lmg_result lum_gltf_write(const lum_photometry *p, const lum_output *ies, double flux, lum_output *o, lmg_error *err)
{
    lum_photometry_measures m;
    const lmg_result result = lum_photometry_measure(p, &m, err);
    if (result != LMG_OK || ies->failed)
        return result;
    /* The stand-in: a cone as wide as the field angle when hardly anything goes up, else a point; both carry the flux. */
    const double outer = fmin(0.5 * m.field_angle, 90) * PI / 180;
    const bool spot = m.up <= 0.01 * flux && outer > 0.01;
    json_t *light = spot ? json_pack("{s:s, s:f, s:{s:f, s:f}}", "type", "spot", "intensity",
                                     flux / (2 * PI * (1 - cos(outer)) / 3), "spot", "innerConeAngle", 0.0, "outerConeAngle", outer)
                         : json_pack("{s:s, s:f}", "type", "point", "intensity", flux / (4 * PI));
    const char *luminaire = lum_photometry_keyword(p, "LUMINAIRE");
    char *uri = base64("data:application/x-ies-lm-63;base64,", ies->text, ies->size);
    /* -90 degrees about X: -Z becomes -Y. */
    json_t *root =
        uri && light
            ? json_pack("{s:{s:s, s:s}, s:[s, s], s:{s:{s:[{s:s, s:s}]}, s:{s:[o]}}, s:i, s:[{s:[i]}], "
                        "s:[{s:s, s:[f, f, f, f], s:{s:{s:i}, s:{s:i}}}]}",
                        "asset", "version", "2.0", "generator", "Lumibox " LMG_VERSION_STRING, "extensionsUsed", "EXT_lights_ies",
                        "KHR_lights_punctual", "extensions", "EXT_lights_ies", "lights", "uri", uri, "mimeType",
                        "application/x-ies-lm-63", "KHR_lights_punctual", "lights", light, "scene", 0, "scenes", "nodes", 0,
                        "nodes", "name", luminaire && *luminaire ? luminaire : "luminaire", "rotation", -sqrt(0.5), 0.0, 0.0,
                        sqrt(0.5), "extensions", "EXT_lights_ies", "light", 0, "KHR_lights_punctual", "light", 0)
            : NULL;
    char *text = root ? json_dumps(root, JSON_INDENT(2) | JSON_REAL_PRECISION(9)) : NULL;
    if (text) {
        lum_output_add(o, text, strlen(text));
        lum_output_add(o, "\n", 1);
    } else {
        o->failed = true;
    }
    free(text);
    free(uri);
    json_decref(root);
    return LMG_OK;
}
