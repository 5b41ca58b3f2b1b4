/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Participating media in recipes: what fills a solid (an entry's "medium"), and volumes of smoke or haze in the space around it
 * ("volumes").  Meaning and ranges: docs/recipe.md.  Volumes are read from the recipe here and made ready when a model is loaded.
 */
#include "recipe.h"

#include "gltf_file.h"
#include "model_build.h"
#include "recipe_reader.h"
#include "recipe_spectrum.h"

#include <luminaires/medium.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Far beyond any medium: a mean free path of a nanometre, where rays mean nothing. */
#define MAX_COEFFICIENT 1e9
#define MAX_VDB_BYTES ((size_t)8 << 30)
enum { MAX_VOLUMES = 16 };

/* "scattering" and "absorption", or "extinction" and "albedo"; times scale.  Read last: where none is given, a misspelt key is why. */
static void read_coefficients(lum_reader *r, double scale, float scattering[3], float absorption[3])
{
    double s[3] = {0, 0, 0}, a[3] = {0, 0, 0}, albedo[3];
    const bool by_scattering = lum_reader_rgb(r, "scattering", 0, MAX_COEFFICIENT, s);
    const bool absorbs = lum_reader_rgb(r, "absorption", 0, MAX_COEFFICIENT, a);
    double e[3];
    const bool by_extinction = lum_reader_rgb(r, "extinction", 0, MAX_COEFFICIENT, e),
               has_albedo = lum_reader_rgb(r, "albedo", 0, 1, albedo);
    if (!(by_extinction || has_albedo || by_scattering || absorbs))
        lum_reader_check_rest(r);
    if (by_extinction != has_albedo || (by_extinction && (by_scattering || absorbs)) ||
        !(by_extinction || by_scattering || absorbs))
        lum_reader_fail(r, "", "give \"scattering\" and \"absorption\" (1/m), or \"extinction\" (1/m) and \"albedo\"");
    for (int c = 0; c < 3; c++) {
        if (by_extinction && has_albedo) {
            s[c] = e[c] * albedo[c];
            a[c] = e[c] - s[c];
        }
        scattering[c] = (float)(s[c] * scale);
        absorption[c] = (float)(a[c] * scale);
    }
}

static float read_anisotropy(lum_reader *r)
{
    double g = 0;
    lum_reader_number(r, "anisotropy", -LUM_MAX_ANISOTROPY, LUM_MAX_ANISOTROPY, &g);
    return (float)g;
}

static bool any(const float rgb[3])
{
    return rgb[0] > 0 || rgb[1] > 0 || rgb[2] > 0;
}

/* A coefficient or an albedo of a medium: in R,G,B, and as a spectrum where it is given so. */
typedef struct coefficient {
    bool given;
    float rgb[3];
    const lum_spectrum *by_nm;
} coefficient;

static coefficient read_one(lum_reader *r, const char *key, double most)
{
    coefficient c = {.given = false};
    c.given = lum_reader_property(r, key, 0, most, c.rgb, &c.by_nm);
    return c;
}

static double at(const coefficient *c, int i)
{
    if (c->by_nm)
        return (double)c->by_nm->value[i];
    double basis[3];
    lum_colour_basis(LUM_NM_FIRST + i, basis);
    return (double)c->rgb[0] * basis[0] + (double)c->rgb[1] * basis[1] + (double)c->rgb[2] * basis[2];
}

/* As read_coefficients, but each may be a spectrum. */
static void read_spectral_coefficients(lum_reader *r, lum_recipe_entry *e)
{
    const coefficient scattering = read_one(r, "scattering", MAX_COEFFICIENT), absorption = read_one(r, "absorption", MAX_COEFFICIENT);
    const coefficient extinction = read_one(r, "extinction", MAX_COEFFICIENT), albedo = read_one(r, "albedo", 1);
    if (!(extinction.given || albedo.given || scattering.given || absorption.given || e->filling.fills))
        lum_reader_check_rest(r);
    if (extinction.given != albedo.given || (extinction.given && (scattering.given || absorption.given)) ||
        !(extinction.given || scattering.given || absorption.given || e->filling.fills))
        lum_reader_fail(r, "", "give \"scattering\" and \"absorption\" (1/m), or \"extinction\" (1/m) and \"albedo\"");
    if (r->result)
        return;
    for (int c = 0; c < 3; c++) {
        const double x = (double)extinction.rgb[c], s = extinction.given ? x * (double)albedo.rgb[c] : (double)scattering.rgb[c];
        e->scattering[c] = (float)s;
        e->medium_absorption[c] = (float)(extinction.given ? x - s : (double)absorption.rgb[c]);
    }
    if (!scattering.by_nm && !absorption.by_nm && !extinction.by_nm && !albedo.by_nm)
        return;
    lum_spectrum s, a;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; i++) {
        const double x = at(&extinction, i), w = extinction.given ? x * at(&albedo, i) : at(&scattering, i);
        s.value[i] = (float)w;
        a.value[i] = (float)(extinction.given ? x - w : at(&absorption, i));
    }
    e->filling.scattering = lum_reader_keep(r, &s);
    e->filling.absorption = r->result ? NULL : lum_reader_keep(r, &a);
}

void lum_recipe_read_medium(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "medium", &in))
        return;
    e->has_medium = true;
    e->anisotropy = read_anisotropy(&in);
    lum_recipe_read_filling(&in, MAX_COEFFICIENT, &e->filling);
    read_spectral_coefficients(&in, e);
    const bool scatters = any(e->scattering) || (e->filling.scattering && lum_spectrum_peak(e->filling.scattering) > 0);
    if (!in.result && !scatters && !e->filling.fills)
        lum_reader_fail(&in, "", "scatters nothing; absorption alone is said by \"glass\" with \"absorption\"");
    lum_reader_close(r, &in);
}

/* Three numbers; `same`: one will do for all. */
static bool read_vector(lum_reader *r, const char *key, double low, double high, bool same, double out[3])
{
    json_t *value = lum_reader_take(r, key);
    if (!value)
        return false;
    bool ok = true;
    if (same && json_is_number(value)) {
        ok = lum_reader_in_range(r, key, value, low, high, &out[0]);
        out[1] = out[2] = out[0];
    } else if (json_is_array(value) && json_array_size(value) == 3) {
        for (size_t i = 0; i < 3 && ok; i++)
            ok = lum_reader_in_range(r, key, json_array_get(value, i), low, high, &out[i]);
    } else {
        ok = false;
        lum_reader_fail(r, key, same ? "must be a number or three, [x, y, z]" : "must be three numbers, [x, y, z]");
    }
    json_decref(value);
    return ok;
}

/* glTF's translation, rotation (a unit quaternion x, y, z, w) and scale. */
static void read_transform(lum_reader *r, double m[3][4])
{
    double t[3] = {0, 0, 0}, s[3] = {1, 1, 1}, q[4] = {0, 0, 0, 1};
    read_vector(r, "translation", -1e9, 1e9, false, t);
    read_vector(r, "scale", 1e-9, 1e9, true, s);
    json_t *rotation = lum_reader_take(r, "rotation");
    if (rotation) {
        double length = 0;
        if (!json_is_array(rotation) || json_array_size(rotation) != 4)
            lum_reader_fail(r, "rotation", "must be a unit quaternion, [x, y, z, w]");
        for (size_t i = 0; i < 4 && !r->result; i++)
            if (lum_reader_in_range(r, "rotation", json_array_get(rotation, i), -1, 1, &q[i]))
                length += q[i] * q[i];
        length = sqrt(length);
        /* written with three digits it may be that far from unit length */
        if (!r->result && !(fabs(length - 1) < 2e-3))
            lum_reader_fail(r, "rotation", "is a quaternion of length %g; it must be 1", length);
        for (int i = 0; i < 4 && !r->result; i++)
            q[i] /= length;
        json_decref(rotation);
    }
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const double turn[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
                               {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
                               {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            m[i][k] = turn[i][k] * s[k];
        m[i][3] = t[i];
    }
}

static void read_volume(lum_reader *r, const char *folder, lum_recipe_volume *v)
{
    char file[LUM_NAME_SIZE] = "";
    lum_reader box;
    double density = 1;
    lum_reader_string(r, "name", v->name);
    const bool vdb = lum_reader_string(r, "vdb", file), boxed = lum_reader_open(r, "box", &box);
    if (boxed) {
        const bool low = read_vector(&box, "min", -1e9, 1e9, false, v->low),
                   high = read_vector(&box, "max", -1e9, 1e9, false, v->high);
        if (!low || !high)
            lum_reader_fail(&box, "", "needs \"min\" and \"max\", [x, y, z] each");
        for (int a = 0; a < 3 && low && high; a++)
            if (!(v->high[a] > v->low[a]))
                lum_reader_fail(&box, "", "\"max\" isn't beyond \"min\"");
        lum_reader_close(r, &box);
    }
    if (vdb == boxed)
        lum_reader_fail(r, "", "give \"vdb\", the name of an OpenVDB file, or \"box\"");
    if (vdb && snprintf(v->path, sizeof v->path, "%s%s", *file == '/' ? "" : folder, file) >= (int)sizeof v->path)
        lum_reader_fail(r, "vdb", "the path is too long");
    const bool chosen = lum_reader_string(r, "grid", v->grid);
    static const char *const interpolations[] = {"linear", "nearest"};
    v->interpolation = lum_reader_choice(r, "interpolation", interpolations, 2, "linear, nearest", -1);
    if (boxed && (chosen || v->interpolation >= 0))
        lum_reader_fail(r, chosen ? "grid" : "interpolation", "belongs to \"vdb\"");
    v->interpolation = boxed ? LUM_INTERPOLATION_NEAREST : v->interpolation < 0 ? LUM_INTERPOLATION_LINEAR : v->interpolation;
    lum_reader_number(r, "density_scale", 0, 1e12, &density);
    v->anisotropy = read_anisotropy(r);
    read_transform(r, v->to_model);
    read_coefficients(r, density, v->scattering, v->absorption);
    if (!r->result && !any(v->scattering) && !any(v->absorption))
        lum_reader_fail(r, "", "is clear: all its coefficients are zero");
    for (int c = 0; c < 3 && !r->result; c++)
        if (!isfinite(v->scattering[c] + v->absorption[c]))
            lum_reader_fail(r, "density_scale", "makes a coefficient too large");
    lum_reader_check_rest(r);
}

void lum_recipe_read_volumes(lum_reader *r, const char *folder, lum_recipe *recipe)
{
    json_t *list = lum_reader_take(r, "volumes");
    if (!list)
        return;
    if (!json_is_array(list))
        lum_reader_fail(r, "volumes", "must be an array");
    const size_t count = json_array_size(list);
    if (!r->result && count > MAX_VOLUMES)
        lum_reader_fail(r, "volumes", "has %zu volumes; at most %d are supported", count, MAX_VOLUMES);
    if (!r->result && count > 0) {
        recipe->volumes = calloc(count, sizeof *recipe->volumes);
        if (!recipe->volumes)
            r->result = lmg_fail(r->err, LMG_ERROR_MEMORY, "out of memory");
    }
    for (size_t i = 0; i < count && !r->result; i++) {
        lum_recipe_volume *v = &recipe->volumes[recipe->volume_count++];
        snprintf(v->where, sizeof v->where, "volumes[%zu]", i);
        snprintf(v->name, sizeof v->name, "volume %zu", i);
        lum_reader in = {.object = json_array_get(list, i), .err = r->err};
        snprintf(in.path, sizeof in.path, "%s", v->where);
        if (json_is_object(in.object))
            read_volume(&in, folder, v);
        else
            lum_reader_fail(&in, "", "must be an object");
        r->result = in.result;
    }
    json_decref(list);
}

/* ------------------------------------------------------------------------------------------------------ into the model */

/* a after b */
static void compose(const double a[3][4], const double b[3][4], double out[3][4])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 4; k++)
            out[i][k] = a[i][0] * b[0][k] + a[i][1] * b[1][k] + a[i][2] * b[2][k] + (k == 3 ? a[i][3] : 0);
}

/* By cofactors; false when the map is flat. */
static bool invert(const double m[3][4], double out[3][4])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const int r0 = (k + 1) % 3, r1 = (k + 2) % 3, c0 = (i + 1) % 3, c1 = (i + 2) % 3;
            out[i][k] = m[r0][c0] * m[r1][c1] - m[r0][c1] * m[r1][c0];
        }
    const double determinant = m[0][0] * out[0][0] + m[0][1] * out[1][0] + m[0][2] * out[2][0];
    bool ok = isfinite(determinant) && determinant != 0;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            out[i][k] /= determinant;
            ok = ok && isfinite(out[i][k]);
        }
        out[i][3] = -(out[i][0] * m[0][3] + out[i][1] * m[1][3] + out[i][2] * m[2][3]);
    }
    return ok;
}

/* The box as a lattice of one voxel around the origin, and where that is in the box's frame. */
static lmg_result box_grid(const lum_recipe_volume *v, lum_grid **grid, double to_world[3][4], lmg_error *err)
{
    const int32_t origin[3] = {0, 0, 0};
    const uint32_t size[3] = {1, 1, 1};
    const float one = 1;
    memset(to_world, 0, 3 * sizeof to_world[0]);
    for (int a = 0; a < 3; a++) {
        to_world[a][a] = v->high[a] - v->low[a];
        to_world[a][3] = v->low[a] + 0.5 * (v->high[a] - v->low[a]);
    }
    return lum_grid_create(origin, size, &one, LUM_INTERPOLATION_NEAREST, 0, grid, err);
}

static lmg_result load_volume(lum_build *b, const lum_recipe_volume *from, lum_volume *to)
{
    double to_world[3][4], to_model[3][4], low[3], high[3], largest = 0, edge = 0;
    memcpy(to->name, from->name, sizeof to->name);
    memcpy(to->scattering, from->scattering, sizeof to->scattering);
    memcpy(to->absorption, from->absorption, sizeof to->absorption);
    to->anisotropy = from->anisotropy;
    for (int c = 0; c < 3; c++)
        largest = fmax(largest, (double)from->scattering[c] + (double)from->absorption[c]);
    for (int a = 0; a < 3; a++)
        edge += b->scale / 3 *
                sqrt(from->to_model[0][a] * from->to_model[0][a] + from->to_model[1][a] * from->to_model[1][a] +
                     from->to_model[2][a] * from->to_model[2][a]);
    if (*from->path) {
        uint8_t *bytes;
        size_t size;
        LUM_TRY(lum_read_file(from->path, MAX_VDB_BYTES, &bytes, &size, b->err));
        b->model->hash = lum_fnv1a(b->model->hash, bytes, size);
        free(bytes);
        LUM_TRY(lum_grid_read_vdb(from->path, from->grid, (lum_interpolation)from->interpolation, largest * edge, &to->grid,
                                  to_world, b->err));
    } else {
        LUM_TRY(box_grid(from, &to->grid, to_world, b->err));
    }
    compose(from->to_model, to_world, to_model);
    const lmg_vec3 centre = b->model->centre;
    const double middle[3] = {centre.x, centre.y, centre.z};
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 4; k++)
            to_model[i][k] *= b->scale;
        to_model[i][3] -= middle[i];
    }
    if (!invert(to_model, to->to_index))
        return lmg_fail(b->err, LMG_ERROR_INPUT, "its place in the model can't be inverted; check \"scale\"");
    lum_grid_bounds(to->grid, low, high);
    double lo[3] = {INFINITY, INFINITY, INFINITY}, hi[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (int corner = 0; corner < 8; corner++)
        for (int i = 0; i < 3; i++) {
            double x = to_model[i][3];
            for (int k = 0; k < 3; k++)
                x += to_model[i][k] * (corner >> k & 1 ? high[k] : low[k]);
            lo[i] = fmin(lo[i], x);
            hi[i] = fmax(hi[i], x);
        }
    to->bounds_min = (lmg_vec3){lo[0], lo[1], lo[2]};
    to->bounds_max = (lmg_vec3){hi[0], hi[1], hi[2]};
    return LMG_OK;
}

static void include(lum_model *m, const lum_volume *v)
{
    m->bounds_min = (lmg_vec3){fmin(m->bounds_min.x, v->bounds_min.x), fmin(m->bounds_min.y, v->bounds_min.y),
                               fmin(m->bounds_min.z, v->bounds_min.z)};
    m->bounds_max = (lmg_vec3){fmax(m->bounds_max.x, v->bounds_max.x), fmax(m->bounds_max.y, v->bounds_max.y),
                               fmax(m->bounds_max.z, v->bounds_max.z)};
}

lmg_result lum_recipe_apply_volumes(lum_build *b)
{
    const lum_recipe *recipe = b->recipe;
    lum_model *m = b->model;
    if (!recipe || recipe->volume_count == 0)
        return LMG_OK;
    m->volumes = calloc(recipe->volume_count, sizeof *m->volumes);
    if (!m->volumes)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    for (uint32_t i = 0; i < recipe->volume_count; i++) {
        const lum_recipe_volume *v = &recipe->volumes[i];
        m->volume_count++; /* also when it fails half way: the model's end frees it */
        const lmg_result result = load_volume(b, v, &m->volumes[i]);
        if (result) {
            char where[2 * LUM_NAME_SIZE];
            snprintf(where, sizeof where, "recipe %s: %.100s", v->where, *v->path ? lum_base_name(v->path) : v->name);
            lum_prefix_error(b->err, where);
            return result;
        }
        include(m, &m->volumes[i]);
    }
    return LMG_OK;
}

lmg_result lum_recipe_check_medium(lum_build *b, const lum_recipe_entry *e, const lum_material *material)
{
    if (lum_material_is_solid(material))
        return LMG_OK;
    return lmg_fail(
        b->err, LMG_ERROR_INPUT,
        "recipe %s: \"medium\" fills a solid that light gets into, and material \"%.60s\" isn't one; \"glass\" in the same "
        "entry makes it one",
        e->where, material->name);
}
