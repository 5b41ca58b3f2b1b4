/* SPDX-License-Identifier: Apache-2.0 */
/* What looks implausible in a model, one line per material or mesh and kind, each with the recipe entry that would settle it. */
#include "model_build.h"
#include "scene_data.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Plausible ranges of luminaires.  Size: from a chip to a street lamp's pole; luminance: from a dim exit sign to the sun; flux:
 * from an indicator to a stadium light. */
#define MIN_SIZE_M 1e-3
#define MAX_SIZE_M 10.0
#define MIN_LUMINANCE 100.0
#define MAX_LUMINANCE 2e9
#define MIN_FLUX_LM 1.0
#define MAX_FLUX_LM 1e6

static const double pi = 3.14159265358979323846;

/* Area of a material's triangles, m2. */
static void material_areas(const lum_model *m, double *area)
{
    for (uint32_t t = 0; t < m->triangle_count; t++)
        area[m->triangle_material[t]] += lum_triangle_area(m, t);
}

static bool contains_ignoring_case(const char *name, const char *word)
{
    size_t n = strlen(word);
    for (; *name; name++) {
        size_t i = 0;
        while (i < n && (name[i] | 0x20) == word[i])
            i++;
        if (i == n)
            return true;
    }
    return false;
}

/* Names that say light, in the languages of common model libraries: first of light sources themselves, then of anything near them.
 */
static const char *const luminous[2][9] = {
    {"bulb", "led", "filament", "tube", "emit", "fluor", "flame", "bombeta", "glow"},
    {"lamp", "light", "neon", "candle", "luz", "leucht", "ampoule", "lumi", "lens"},
};

static bool sounds_luminous(const char *name, int rank)
{
    for (int i = 0; i < 9; i++)
        if (contains_ignoring_case(name, luminous[rank][i]))
            return true;
    return false;
}

static void warn_no_emitter(lum_build *b)
{
    const lum_model *m = b->model;
    char names[300] = "";
    size_t used = 0;
    int count = 0;
    for (int rank = 0; rank < 2 && count == 0; rank++)
        for (uint32_t i = 0; i < m->material_count && count < 4; i++)
            if (sounds_luminous(m->materials[i].name, rank))
                used +=
                    (size_t)snprintf(names + used, sizeof names - used, "%s\"%.50s\"", count++ ? ", " : "", m->materials[i].name);
    if (count)
        lum_warn(b, "nothing in it emits light. Recipe entry \"emitter\" can make one of its materials shine; by their names: %s",
                 names);
    else
        lum_warn(b, "nothing in it emits light. Recipe entry \"emitter\" can make one of its materials or meshes shine");
}

static double luminance_of(const lum_material *m)
{
    return lmg_luminance(m->emissive);
}

/* Flux of everything without an emission texture; *textured: some have one. */
static double total_flux(const lum_model *m, const double *area, bool *textured)
{
    double flux = 0;
    *textured = false;
    for (uint32_t i = 0; i < m->material_count; i++) {
        *textured = *textured || (luminance_of(&m->materials[i]) > 0 && m->materials[i].emissive_texture.image != LUM_NONE);
        flux += pi * area[i] * luminance_of(&m->materials[i]) * (m->materials[i].emits_back ? 2 : 1);
    }
    for (uint32_t i = 0; i < m->light_count; i++) {
        const lum_light *l = &m->lights[i];
        double solid = l->kind == LUM_LIGHT_PROFILE ? lum_profile_flux(l->profile)
                       : l->kind == LUM_LIGHT_POINT ? 4 * pi : l->kind == LUM_LIGHT_SPOT ? 2 * pi * (1 - l->cos_outer) : 0;
        flux += solid * lmg_luminance(l->intensity);
    }
    return flux;
}

static void warn_emitters(lum_build *b, const double *area)
{
    const lum_model *m = b->model;
    double brightest = 0; /* of emitters without a texture */
    bool any = false;
    for (uint32_t i = 0; i < m->light_count; i++)
        any = any || lmg_luminance(m->lights[i].intensity) > 0;
    bool lights = any;
    for (uint32_t i = 0; i < m->material_count; i++) {
        double luminance = luminance_of(&m->materials[i]);
        any = any || luminance > 0;
        if (m->materials[i].emissive_texture.image == LUM_NONE)
            brightest = fmax(brightest, luminance);
    }
    if (!any) {
        warn_no_emitter(b);
        return;
    }
    for (uint32_t i = 0; i < m->material_count; i++) {
        const lum_material *material = &m->materials[i];
        double luminance = luminance_of(material);
        if (!(luminance > 0))
            continue;
        bool painted = material->emissive_texture.image != LUM_NONE && (lights || brightest >= luminance);
        if (painted)
            lum_warn(b,
                     "material \"%.60s\" has an emission picture beside real emitters: if it is the painted-on look of a lit lamp, "
                     "its light "
                     "counts twice. Recipe entry \"no_emission\" ignores it",
                     material->name);
        else if (luminance < MIN_LUMINANCE || luminance > MAX_LUMINANCE)
            lum_warn(b,
                     "material \"%.60s\" emits %.3g cd/m2, outside the %g .. %.0e of lamps. Recipe entry \"emitter\" with "
                     "\"lumens\" can set "
                     "it, or --flux scales the whole lamp",
                     material->name, luminance, MIN_LUMINANCE, MAX_LUMINANCE);
    }
    bool textured;
    double flux = total_flux(m, area, &textured);
    if (flux > MAX_FLUX_LM || (flux < MIN_FLUX_LM && flux > 0 && !textured))
        lum_warn(b, "its emitters give %.3g lm in all, outside the %g .. %.0e of lamps. Recipe key \"flux\" sets the rated lumens",
                 flux, MIN_FLUX_LM, MAX_FLUX_LM);
}

static void warn_size(lum_build *b)
{
    const lum_model *m = b->model;
    double x = m->bounds_max.x - m->bounds_min.x, y = m->bounds_max.y - m->bounds_min.y, z = m->bounds_max.z - m->bounds_min.z;
    double size = fmax(fmax(x, y), z);
    if (m->triangle_count > 0 && (size < MIN_SIZE_M || size > MAX_SIZE_M))
        lum_warn(
            b,
            "it is %.3g m large (%.3g x %.3g x %.3g), which is unlikely for a luminaire: glTF is in metres. Recipe key \"scale\" "
            "(0.001 for a model in millimetres) sets the unit",
            size, x, y, z);
}

/* Whether a solid is a film whose two sides are so near to each other that light meets them in one place: they cancel. */
static bool is_film(const lum_model *m, const lum_part *part)
{
    double error = 0;
    for (uint32_t t = part->first_triangle; t < part->first_triangle + part->triangle_count; t++) {
        float v[3][3];
        for (int k = 0; k < 3; k++)
            memcpy(v[k], m->positions + 3 * (size_t)m->indices[3 * (size_t)t + (size_t)k], sizeof v[k]);
        error = fmax(error, lum_triangle_error((const float(*)[3])v));
    }
    /* of a plate, volume over half of the surface */
    return 2 * part->enclosed_volume < LUM_TOUCHING_GAP * error * m->unit * part->area;
}

/* Materials that let light through: openness, and transparency that only blends. */
static void warn_transparency(lum_build *b)
{
    const lum_model *m = b->model;
    bool *said = calloc((size_t)m->material_count + 1, sizeof *said);
    if (!said)
        return;
    for (uint32_t p = 0; p < m->part_count; p++) {
        const lum_part *part = &m->parts[p];
        const lum_material *material = &m->materials[part->material];
        if (said[part->material] || part->triangle_count == 0)
            continue;
        bool solid = lum_material_is_solid(material);
        if (solid && part->boundary_edges > 0) {
            lum_warn(b,
                     "mesh \"%.60s\" (material \"%.60s\") transmits light and is open (%u boundary edges), but is taken as the "
                     "surface of "
                     "solid glass. If it is a wall drawn as one sheet: recipe entry \"thin\"",
                     part->mesh, material->name, part->boundary_edges);
            said[part->material] = true;
        } else if (solid && part->turned_edges > 0) {
            lum_warn(b,
                     "mesh \"%.60s\" (material \"%.60s\") is a solid that transmits light, but some of its faces look inward and some outward "
                     "(%u edges between them): light that meets the wrong ones is lost. Make its faces consistent in the model",
                     part->mesh, material->name, part->turned_edges);
            said[part->material] = true;
        } else if (solid && part->enclosed_volume < 0) {
            lum_warn(
                b,
                "mesh \"%.60s\" (material \"%.60s\") is a solid that transmits light, but its faces look inward: glass and air are "
                "exchanged. Turn its faces round in the model, or recipe entry \"thin\"",
                part->mesh, material->name);
            said[part->material] = true;
        } else if (solid && is_film(m, part)) {
            lum_warn(b,
                     "mesh \"%.60s\" (material \"%.60s\") is a solid film of %.2g um, thinner than surfaces can be told apart at this "
                     "size (3.8 um per metre from the middle): light passes it as if it wasn't there. Recipe entry \"thin\" makes it a "
                     "sheet",
                     part->mesh, material->name, 2e6 * part->enclosed_volume / part->area);
            said[part->material] = true;
        } else if (material->alpha_mode == LUM_ALPHA_BLEND && material->base_color[3] < 0.5f &&
                   material->base_texture.image == LUM_NONE && material->kind == LUM_SURFACE_PBR && material->transmission == 0) {
            lum_warn(b,
                     "material \"%.60s\" is transparent by blending (alpha %.2g): it neither reflects nor refracts what it lets "
                     "through. If "
                     "it is glass: recipe entry \"glass\"",
                     material->name, (double)material->base_color[3]);
            said[part->material] = true;
        }
    }
    free(said);
}

/* Emitting parts of which the front is not the outside. */
static void warn_inward_emitters(lum_build *b)
{
    const lum_model *m = b->model;
    bool *said = calloc((size_t)m->material_count + 1, sizeof *said);
    if (!said)
        return;
    for (uint32_t p = 0; p < m->part_count; p++) {
        const lum_part *part = &m->parts[p];
        const lum_material *material = &m->materials[part->material];
        if (said[part->material] || part->boundary_edges > 0 || !(luminance_of(material) > 0) || material->emits_back)
            continue;
        bool split = false; /* "outside" has already chosen the faces */
        for (uint32_t t = part->first_triangle; t < part->first_triangle + part->triangle_count; t++)
            split = split || m->triangle_material[t] != part->material;
        /* A sphere of area A encloses A^1.5 / (6 sqrt(pi)); a thousandth of that is a sheet. */
        double round_volume = pow(part->area, 1.5) / (6 * sqrt(pi));
        bool inward = part->enclosed_volume < -1e-3 * round_volume, doubled = fabs(part->enclosed_volume) <= 1e-3 * round_volume;
        if (split || !(inward || doubled))
            continue;
        lum_warn(b,
                 "mesh \"%.60s\" (material \"%.60s\") emits light, and %s. Recipe entry \"emitter\" with \"sides\": \"outside\" "
                 "lets only its "
                 "outside shine",
                 part->mesh, material->name,
                 inward ? "its faces look inward" : "its faces are doubled, back to back: half of the light goes inside");
        said[part->material] = true;
    }
    free(said);
}

void lum_warn_model(lum_build *b)
{
    double *area = calloc((size_t)b->model->material_count + 1, sizeof *area);
    if (!area)
        return; /* warnings are a service; a model that fits in memory is not refused for them */
    material_areas(b->model, area);
    warn_size(b);
    warn_transparency(b);
    warn_inward_emitters(b);
    warn_emitters(b, area);
    free(area);
}
