/* SPDX-License-Identifier: Apache-2.0 */
/* index.json of a set of goniometer pictures, in and out. */
#include "picture_set_inside.h"

#include <jansson.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char FORMAT[] = "lumibox luminance pictures 1";
static const double DEGREE = 3.14159265358979323846 / 180;
/* Directions of the frame may be off by what four digits leave. */
static const double FRAME_SLACK = 1e-3;
enum { MAX_ANGLES = 3600 };

static lmg_result bad(const char *path, const char *what, lmg_error *err)
{
    return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s/index.json: %s", path, what);
}

static bool get_vector(const json_t *o, const char *name, lmg_vec3 *out)
{
    const json_t *v = json_object_get(o, name);
    double x[3];
    if (json_array_size(v) != 3)
        return false;
    for (size_t i = 0; i < 3; ++i) {
        if (!json_is_number(json_array_get(v, i)))
            return false;
        x[i] = json_number_value(json_array_get(v, i));
    }
    *out = (lmg_vec3){x[0], x[1], x[2]};
    return isfinite(x[0] + x[1] + x[2]);
}

static double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* Rising angles in degrees within [0, most]. */
static bool get_angles(const json_t *list, double most, double *out)
{
    for (size_t i = 0; i < json_array_size(list); ++i) {
        const json_t *v = json_array_get(list, i);
        const double degrees = json_is_number(v) ? json_number_value(v) : (double)NAN;
        if (!(degrees >= 0 && degrees <= most))
            return false;
        out[i] = degrees * DEGREE;
        if (i > 0 && !(out[i] > out[i - 1]))
            return false;
    }
    return true;
}

/* A plain name of a file in the folder: an index from a stranger opens nothing else. */
static bool is_plain(const char *name)
{
    return name[0] && name[0] != '.' && !strchr(name, '/') && strlen(name) < 256;
}

static lmg_result get_files(const json_t *list, const char *path, picture_set *set, lmg_error *err)
{
    if (json_array_size(list) != set->rows)
        return bad(path, "\"pictures\" isn't a list of lists, one for every theta", err);
    for (uint32_t i = 0; i < set->rows; ++i) {
        const json_t *row = json_array_get(list, i);
        if (json_array_size(row) != set->columns)
            return bad(path, "\"pictures\" has a row that doesn't name one file, or null, for every phi", err);
        for (uint32_t j = 0; j < set->columns; ++j) {
            const json_t *name = json_array_get(row, j);
            if (json_is_null(name))
                continue;
            if (!json_is_string(name) || !is_plain(json_string_value(name)))
                return bad(path, "\"pictures\" names something that isn't a file in the folder", err);
            set->files[i * set->columns + j] = strdup(json_string_value(name));
            if (!set->files[i * set->columns + j])
                return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for names", path);
        }
    }
    return LMG_OK;
}

static lmg_result get_geometry(const json_t *o, const char *path, picture_set *set, lmg_error *err)
{
    const json_t *camera = json_object_get(o, "camera");
    const json_int_t width = json_integer_value(json_object_get(camera, "width")), height = json_integer_value(json_object_get(camera, "height"));
    const char *unit = json_string_value(json_object_get(o, "unit"));
    set->distance = json_number_value(json_object_get(o, "distance_m"));
    const double field = json_number_value(json_object_get(camera, "field_degrees"));
    if (!unit || (strcmp(unit, "cd/m2") != 0 && strcmp(unit, "W/(sr m2)") != 0))
        return bad(path, "\"unit\" is neither cd/m2 nor W/(sr m2)", err);
    set->radiant = unit[0] == 'W';
    if (width < 1 || height < 1 || width > LUM_PICTURE_MAX_SIDE || height > LUM_PICTURE_MAX_SIDE || !(field > 0 && field < 170))
        return bad(path, "\"camera\" lacks width and height in pixels or field_degrees (across the width, below 170)", err);
    set->width = (uint32_t)width;
    set->height = (uint32_t)height;
    set->half_field = tan(0.5 * field * DEGREE);
    if (!get_vector(o, "centre_m", &set->centre) || !get_vector(o, "axis", &set->axis) || !get_vector(o, "zero", &set->zero) ||
        !get_vector(o, "bounds_min_m", &set->lo) || !get_vector(o, "bounds_max_m", &set->hi))
        return bad(path, "lacks centre_m, axis, zero, bounds_min_m or bounds_max_m, three numbers each", err);
    if (fabs(dot(set->axis, set->axis) - 1) > FRAME_SLACK || fabs(dot(set->zero, set->zero) - 1) > FRAME_SLACK ||
        fabs(dot(set->axis, set->zero)) > FRAME_SLACK)
        return bad(path, "\"axis\" and \"zero\" aren't unit vectors at right angles", err);
    if (!(set->lo.x <= set->hi.x && set->lo.y <= set->hi.y && set->lo.z <= set->hi.z))
        return bad(path, "its bounds are empty", err);
    double corner = 0; /* the camera stays outside: the corner furthest from the centre */
    for (int k = 0; k < 8; ++k) {
        const lmg_vec3 d = {(k & 1 ? set->hi.x : set->lo.x) - set->centre.x, (k & 2 ? set->hi.y : set->lo.y) - set->centre.y,
                            (k & 4 ? set->hi.z : set->lo.z) - set->centre.z};
        corner = fmax(corner, sqrt(dot(d, d)));
    }
    if (!(set->distance > corner) || !isfinite(set->distance) || !(corner > 0))
        return bad(path, "\"distance_m\" doesn't put the camera outside of the bounds", err);
    const json_t *told = json_object_get(o, "photometer_flux");
    set->told = json_is_number(told) ? json_number_value(told) : (double)NAN;
    return LMG_OK;
}

lmg_result set_read_index(const char *path, picture_set *set, lmg_error *err)
{
    *set = (picture_set){0};
    char name[2048];
    if (snprintf(name, sizeof(name), "%s/index.json", path) >= (int)sizeof(name))
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.300s...: the name is too long", path);
    json_error_t error;
    json_t *o = json_load_file(name, JSON_REJECT_DUPLICATES, &error);
    if (!o)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: line %d: %.200s", name, error.line, error.text);
    const char *format = json_string_value(json_object_get(o, "format"));
    const json_t *theta = json_object_get(o, "theta_degrees"), *phi = json_object_get(o, "phi_degrees");
    const size_t rows = json_array_size(theta), columns = json_array_size(phi);
    lmg_result result = LMG_OK;
    if (!format || strcmp(format, FORMAT) != 0)
        result = bad(path, "its \"format\" isn't \"lumibox luminance pictures 1\"", err);
    else if (rows < 1 || columns < 1 || rows > MAX_ANGLES || columns > MAX_ANGLES)
        result = bad(path, "lacks theta_degrees or phi_degrees, 1 to 3600 angles each", err);
    if (result == LMG_OK)
        result = set_create((uint32_t)rows, (uint32_t)columns, path, set, err);
    if (result == LMG_OK && (!get_angles(theta, 180, set->theta) || !get_angles(phi, 359.9999999, set->phi)))
        result = bad(path, "theta_degrees don't rise within 0 to 180, or phi_degrees within 0 to below 360", err);
    if (result == LMG_OK) {
        set_make_edges(set);
        result = get_geometry(o, path, set, err);
    }
    if (result == LMG_OK)
        result = get_files(json_object_get(o, "pictures"), path, set, err);
    json_decref(o);
    if (result != LMG_OK)
        set_free(set);
    return result;
}

static json_t *vector(lmg_vec3 v)
{
    return json_pack("[f,f,f]", v.x, v.y, v.z);
}

lmg_result set_write_index(const picture_set *set, const char *folder, double flux, const char *origin, lmg_error *err)
{
    char name[2048];
    if (snprintf(name, sizeof(name), "%s/index.json", folder) >= (int)sizeof(name))
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s...: the name is too long", folder);
    json_t *theta = json_array(), *phi = json_array(), *pictures = json_array();
    for (uint32_t i = 0; i < set->rows; ++i)
        json_array_append_new(theta, json_real(set->theta[i] / DEGREE));
    for (uint32_t j = 0; j < set->columns; ++j)
        json_array_append_new(phi, json_real(set->phi[j] / DEGREE));
    for (uint32_t i = 0; i < set->rows; ++i) {
        json_t *row = json_array();
        for (uint32_t j = 0; j < set->columns; ++j) {
            const char *file = set->files[i * set->columns + j];
            json_array_append_new(row, file ? json_string(file) : json_null());
        }
        json_array_append_new(pictures, row);
    }
    json_t *o = json_pack("{s:s, s:s, s:s, s:s*, s:f, s:o, s:o, s:o, s:o, s:o, s:{s:i, s:i, s:f}, s:f, s:o, s:o, s:o}", "format", FORMAT,
                          "software", "lumibake " LMG_VERSION_STRING, "unit", set->radiant ? "W/(sr m2)" : "cd/m2", "origin", origin,
                          "distance_m", set->distance, "centre_m", vector(set->centre), "axis", vector(set->axis), "zero", vector(set->zero),
                          "bounds_min_m", vector(set->lo), "bounds_max_m", vector(set->hi), "camera", "width", (int)set->width, "height",
                          (int)set->height, "field_degrees", 2 * atan(set->half_field) / DEGREE, "pictures_flux", flux, "theta_degrees",
                          theta, "phi_degrees", phi, "pictures", pictures);
    const bool good = o && json_dump_file(o, name, JSON_INDENT(1) | JSON_REAL_PRECISION(15)) == 0;
    json_decref(o);
    return good ? LMG_OK : lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written", name);
}
