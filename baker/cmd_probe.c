/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake probe: a virtual lux meter, luminance meter and goniometer in a box's light. */
#include "program.h"

#include "table.h"

#include <luminaires/spectrum.h>

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { KEY_POINTS = 256, KEY_RAYS, KEY_INTENSITY, KEY_LINEAR, KEY_JSON };

static const struct argp_option OPTIONS[] = {
    {"points", KEY_POINTS, "FILE", 0, "rows x,y,z,nx,ny,nz: illuminance in lx at a point on a surface with this normal", 1},
    {"rays", KEY_RAYS, "FILE", 0,
     "rows ox,oy,oz,dx,dy,dz: luminance in cd/m2 of the light that travels through a point in a direction (away from the lamp)", 1},
    {"intensity", KEY_INTENSITY, "FILE", 0, "rows dx,dy,dz: luminous intensity in cd, far away in this direction", 1},
    {"linear", KEY_LINEAR, 0, 0, "with --rays: interpolate between cells", 2},
    {"json", KEY_JSON, 0, 0, "JSON, with R,G,B", 2},
    {0},
};

static const char DOC[] =
    "Measures in the light of a box. Metres, in the luminaire's own frame (glTF, +Y up)."
    "\vFILE is CSV: an optional header line, # comments, '-' for standard input. The answer is the same rows with the "
    "value and its standard error.\n"
    "Example:\n  echo 0,-2,0,0,1,0 | lumibake probe lamp.box.exr --points -";

typedef struct mode {
    int key;
    size_t columns;
    const char *names;
    const char *quantity[2], *unit[2]; /* of light in watts, of light in lumens */
} mode;

static const mode MODES[] = {
    {KEY_POINTS, 6, "x,y,z,nx,ny,nz", {"irradiance", "illuminance"}, {"W_m2", "lx"}},
    {KEY_RAYS, 6, "ox,oy,oz,dx,dy,dz", {"radiance", "luminance"}, {"W_sr_m2", "cd_m2"}},
    {KEY_INTENSITY, 3, "dx,dy,dz", {"intensity", "intensity"}, {"W_sr", "cd"}},
};

typedef struct command {
    const char *box, *table;
    const mode *mode;
    bool linear, json;
    bool photometric; /* the box */
} command;

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case KEY_POINTS:
    case KEY_RAYS:
    case KEY_INTENSITY:
        if (c->mode)
            usage_error(state, "one of --points, --rays and --intensity at a time");
        for (size_t i = 0; i < sizeof(MODES) / sizeof(MODES[0]); ++i)
            if (MODES[i].key == key)
                c->mode = &MODES[i];
        c->table = arg;
        break;
    case KEY_LINEAR:
        c->linear = true;
        break;
    case KEY_JSON:
        c->json = true;
        break;
    case ARGP_KEY_ARG:
        if (c->box)
            usage_error(state, "'%s': one box at a time", arg);
        c->box = arg;
        break;
    case ARGP_KEY_END:
        if (!c->box)
            usage_error(state, "which box? give a .box.exr file");
        if (!c->mode)
            usage_error(state, "what to measure? give --points, --rays or --intensity");
        if (c->linear && c->mode->key != KEY_RAYS)
            usage_error(state, "--linear goes with --rays");
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

typedef struct reading {
    double rgb[3], value, standard_error;
} reading;

static bool normalise(lmg_vec3 *v)
{
    const double length = hypot(hypot(v->x, v->y), v->z);
    if (!(length > 0) || !isfinite(length))
        return false;
    *v = (lmg_vec3){v->x / length, v->y / length, v->z / length};
    return true;
}

static lmg_result measure(const command *c, const lmg_field *field, const double *row, reading *out, lmg_error *err)
{
    const lmg_vec3 first = {row[0], row[1], row[2]};
    lmg_vec3 direction = c->mode->columns == 6 ? (lmg_vec3){row[3], row[4], row[5]} : first;
    if (!normalise(&direction))
        return lmg_fail(err, LMG_ERROR_INPUT, "the %s has no length", c->mode->key == KEY_POINTS ? "normal" : "direction");
    lmg_result result = LMG_OK;
    const lmg_vec3 lo = lmg_field_layout(field)->bounds_min, hi = lmg_field_layout(field)->bounds_max;
    if (c->mode->key == KEY_POINTS) {
        if (first.x > lo.x && first.x < hi.x && first.y > lo.y && first.y < hi.y && first.z > lo.z && first.z < hi.z)
            return lmg_fail(err, LMG_ERROR_INPUT,
                            "the point is inside the luminaire (%g %g %g to %g %g %g m); a box holds the light outside it", lo.x,
                            lo.y, lo.z, hi.x, hi.y, hi.z);
        result = lmg_field_illuminance(field, first, direction, out->rgb, &out->standard_error, err);
    } else if (c->mode->key == KEY_INTENSITY) {
        result = lmg_field_intensity(field, direction, out->rgb, &out->standard_error, err);
    } else {
        float rgb[3], error = 0;
        lmg_field_radiance(field, first, direction, c->linear ? LMG_LINEAR : LMG_NEAREST, rgb, &error);
        for (int i = 0; i < 3; ++i)
            out->rgb[i] = (double)rgb[i];
        out->standard_error = (double)error;
    }
    if (result == LMG_OK)
        out->value = 0.2126 * out->rgb[0] + 0.7152 * out->rgb[1] + 0.0722 * out->rgb[2];
    return result;
}

static void print_csv(const command *c, const table *t, const reading *readings)
{
    printf("%s,%s_%s,standard_error\n", c->mode->names, c->mode->quantity[c->photometric], c->mode->unit[c->photometric]);
    for (size_t i = 0; i < t->rows; ++i) {
        for (size_t k = 0; k < t->columns; ++k)
            printf("%.10g,", t->values[i * t->columns + k]);
        printf("%.7g,%.3g\n", readings[i].value, readings[i].standard_error);
    }
}

static json_t *readings_json(const command *c, const table *t, const reading *readings)
{
    json_t *rows = json_array();
    for (size_t i = 0; i < t->rows; ++i) {
        json_t *input = json_array();
        for (size_t k = 0; k < t->columns; ++k)
            json_array_append_new(input, json_real(t->values[i * t->columns + k]));
        const reading *r = &readings[i];
        double xyz[3], kelvin, duv;
        lum_rgb_to_xyz(r->rgb, xyz);
        const bool white = c->photometric && r->value > 0 && lum_cct(xyz, &kelvin, &duv) && fabs(duv) <= LUM_CCT_LIMIT;
        json_array_append_new(rows,
                              json_pack("{s:o, s:o, s:o, s:[o,o,o], s:o, s:o}", "input", input, "value", json_number(r->value),
                                        "standard_error", json_number(r->standard_error), "rgb", json_number(r->rgb[0]),
                                        json_number(r->rgb[1]), json_number(r->rgb[2]), "cct_K",
                                        white ? json_number(kelvin) : json_null(), "duv", white ? json_number(duv) : json_null()));
    }
    return json_pack("{s:s, s:s, s:s, s:s, s:s, s:o}", "format", "lumibake probe 1", "box", c->box, "quantity",
                     c->mode->quantity[c->photometric], "unit", c->mode->unit[c->photometric], "columns", c->mode->names, "rows",
                     rows);
}

static int probe(const command *c, const lmg_field *field, const table *t)
{
    lmg_error err = {{0}};
    reading *readings = calloc(t->rows, sizeof(*readings));
    if (!readings) {
        lmg_fail(&err, LMG_ERROR_MEMORY, "no memory for %zu readings", t->rows);
        return report_failure(&err);
    }
    int code = EXIT_DONE;
    for (size_t i = 0; code == EXIT_DONE && i < t->rows; ++i) {
        const lmg_result result = measure(c, field, t->values + i * t->columns, &readings[i], &err);
        if (result != LMG_OK) {
            lmg_error with_line;
            lmg_fail(&with_line, result, "%s:%zu: %.400s", strcmp(c->table, "-") ? c->table : "standard input", t->lines[i],
                     err.message);
            code = report_error(result, &with_line);
        }
    }
    if (code == EXIT_DONE) {
        bool printed;
        if (c->json) {
            printed = print_json(readings_json(c, t, readings));
        } else {
            print_csv(c, t, readings);
            printed = fflush(stdout) == 0 && !ferror(stdout);
        }
        if (!printed) {
            lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print the readings: %s", strerror(errno));
            code = report_failure(&err);
        }
    }
    free(readings);
    return code;
}

int cmd_probe(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "BOX", .doc = DOC};
    command c = {0};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    table t;
    lmg_result result = table_read(c.table, c.mode->columns, c.mode->names, &t, &err);
    if (result != LMG_OK)
        return report_error(result, &err);
    lmg_field *field = NULL;
    result = lmg_field_read(c.box, &field, &err);
    c.photometric = result != LMG_OK || box_is_photometric(field);
    const int code = result == LMG_OK ? probe(&c, field, &t) : report_error(result, &err);
    lmg_field_destroy(field);
    table_free(&t);
    return code;
}
