/* SPDX-License-Identifier: Apache-2.0 */
/* Placements: parsing and the rotation matrix.  Relies on nothing but libc. */
#include "placement.h"

#include <stdlib.h>
#include <string.h>

/* Sine and cosine of degrees, exact at multiples of 90 so that a box turned by 90 degrees stays aligned with the room. */
static void sin_cos_degrees(double degrees, double *s, double *c)
{
    double r = fmod(degrees, 360.0);
    if (r < 0) {
        r += 360.0;
    }
    double quarter = r / 90.0;
    if (quarter == floor(quarter)) {
        static const double SINE[4] = {0, 1, 0, -1};
        int q = (int)quarter & 3;
        *s = SINE[q];
        *c = SINE[(q + 1) & 3];
        return;
    }
    *s = sin(r * (VIEW_PI / 180));
    *c = cos(r * (VIEW_PI / 180));
}

void view_placement_motion(const view_placement *placement, view_motion *out)
{
    double sx, cx, sy, cy, sz, cz;
    sin_cos_degrees(placement->rx, &sx, &cx);
    sin_cos_degrees(placement->ry, &sy, &cy);
    sin_cos_degrees(placement->rz, &sz, &cz);
    /* Rz Ry Rx */
    double r[3][3] = {{cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx},
                      {sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx},
                      {-sy, cy * sx, cy * cx}};
    memcpy(out->r, r, sizeof r);
    out->t = placement->position;
    out->identity = false;
}

/* How many comma-separated finite numbers text consists of, at most limit of them into out; -1 when it's anything else. */
static int parse_list(const char *text, double *out, int limit)
{
    int n = 0;
    for (;;) {
        if (*text == '\0' || *text == ' ' || *text == '\t') {
            return -1;
        }
        char *end;
        double value = strtod(text, &end);
        if (end == text || !isfinite(value) || n == limit) {
            return -1;
        }
        out[n++] = value;
        if (*end == '\0') {
            return n;
        }
        if (*end != ',') {
            return -1;
        }
        text = end + 1;
    }
}

bool view_parse_numbers(const char *text, double *out, size_t count)
{
    return parse_list(text, out, (int)count) == (int)count;
}

lmg_result view_placement_parse(const char *text, view_placement *out, char *path, size_t path_size, lmg_error *err)
{
    const char *at = strrchr(text, '@');
    if (!at) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT,
                        "\"%s\" doesn't say where it stands: write FILE@X,Y,Z[,RX,RY,RZ] (metres, degrees)", text);
    }
    size_t length = (size_t)(at - text);
    if (length == 0 || length >= path_size) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "\"%s\": the file name before '@' is %s", text, length ? "too long" : "missing");
    }
    double v[6] = {0};
    int n = parse_list(at + 1, v, 6);
    if (n != 3 && n != 4 && n != 6) {
        return lmg_fail(
            err, LMG_ERROR_ARGUMENT,
            "\"%s\": after '@' there should be X,Y,Z in metres, then nothing, one angle about y, or RX,RY,RZ in degrees", text);
    }
    memcpy(path, text, length);
    path[length] = '\0';
    *out = (view_placement){.position = {v[0], v[1], v[2]}};
    if (n == 4) {
        out->ry = v[3];
    } else if (n == 6) {
        out->rx = v[3];
        out->ry = v[4];
        out->rz = v[5];
    }
    return LMG_OK;
}
