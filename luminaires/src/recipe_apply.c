/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A recipe on a model.  An entry matches a part by the name of its material or mesh, of its node, or of any node above.  Parts that
 * share a material but match different entries get a copy of the material each.  Later entries win.
 */
#include "recipe.h"
#include "colour.h"
#include "model_build.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

double lum_recipe_scale(const lum_recipe *recipe)
{
    return recipe ? recipe->scale : 1;
}

uint64_t lum_recipe_hash(const lum_recipe *recipe, uint64_t hash)
{
    return recipe ? lum_fnv1a(hash, &recipe->hash, sizeof recipe->hash) : hash;
}

static bool node_matches(const lum_build *b, const lum_recipe_entry *e, int32_t node)
{
    for (; node >= 0; node = b->node_parent[node]) {
        char name[LUM_NAME_SIZE];
        lum_copy_name(name, b->doc->nodes[node].name, "node", (uint32_t)node);
        if (lum_match(e->match, name))
            return true;
    }
    return false;
}

/* mesh and material may be NULL. */
static bool matches(const lum_build *b, const lum_recipe_entry *e, int32_t node, const char *mesh, const char *material)
{
    bool any = e->target == LUM_TARGET_ANY;
    if (e->profile[0]) /* put at nodes by profile_light.c, nothing else */
        return false;
    return (material && (any || e->target == LUM_TARGET_MATERIAL) && lum_match(e->match, material)) ||
           (mesh && (any || e->target == LUM_TARGET_MESH) && lum_match(e->match, mesh)) ||
           ((any || e->target == LUM_TARGET_NODE) && node_matches(b, e, node));
}

bool lum_recipe_leaves_out(lum_build *b, int32_t node, const char *mesh, const char *material)
{
    bool out = false;
    for (uint32_t i = 0; b->recipe && i < b->recipe->entry_count; i++) {
        const lum_recipe_entry *e = &b->recipe->entries[i];
        if (!matches(b, e, node, mesh, material))
            continue;
        b->entry_matched[i] = true;
        out = out || e->leave_out;
    }
    return out;
}

bool lum_recipe_darkens(lum_build *b, int32_t node, const char *light)
{
    bool out = false;
    for (uint32_t i = 0; b->recipe && i < b->recipe->entry_count; i++) {
        const lum_recipe_entry *e = &b->recipe->entries[i];
        if (!matches(b, e, node, NULL, NULL) && !(e->target == LUM_TARGET_ANY && lum_match(e->match, light)))
            continue;
        b->entry_matched[i] = true;
        out = out || e->leave_out || e->no_emission;
    }
    return out;
}

/* ------------------------------------------------------------------------------------------------- unmatched entries */

typedef struct nearest {
    const char *name[3];
    uint32_t distance[3];
} nearest;

static void consider(nearest *n, const char *pattern, const char *name)
{
    if (!name || !*name)
        return;
    uint32_t d = lum_edit_distance(pattern, name);
    if (strstr(name, pattern)) /* part of a longer name is closer than any other */
        d = 0;
    for (int i = 0; i < 3; i++)
        if (n->name[i] && strcmp(n->name[i], name) == 0)
            return;
    for (int i = 0; i < 3; i++)
        if (!n->name[i] || d < n->distance[i]) {
            for (int j = 2; j > i; j--) {
                n->name[j] = n->name[j - 1];
                n->distance[j] = n->distance[j - 1];
            }
            n->name[i] = name;
            n->distance[i] = d;
            return;
        }
}

static lmg_result check_all_matched(lum_build *b)
{
    for (uint32_t i = 0; i < b->recipe->entry_count; i++) {
        if (b->entry_matched[i])
            continue;
        const lum_recipe_entry *e = &b->recipe->entries[i];
        nearest n = {{NULL, NULL, NULL}, {0, 0, 0}};
        bool any = e->target == LUM_TARGET_ANY;
        for (uint32_t k = 0; (any || e->target == LUM_TARGET_MATERIAL) && k < b->doc->material_count; k++)
            consider(&n, e->match, b->doc->materials[k].name);
        for (uint32_t k = 0; (any || e->target == LUM_TARGET_MESH) && k < b->doc->mesh_count; k++)
            consider(&n, e->match, b->doc->meshes[k].name);
        for (uint32_t k = 0; (any || e->target == LUM_TARGET_NODE) && k < b->doc->node_count; k++)
            consider(&n, e->match, b->doc->nodes[k].name);
        char names[300] = "";
        size_t used = 0;
        for (int k = 0; k < 3 && n.name[k]; k++)
            used += (size_t)snprintf(names + used, sizeof names - used, "%s\"%.60s\"", k ? ", " : "; close names: ", n.name[k]);
        return lmg_fail(b->err, LMG_ERROR_INPUT, "recipe %s: nothing in the scene is called \"%.60s\"%s", e->where, e->match,
                        names);
    }
    return LMG_OK;
}

/* ------------------------------------------------------------------------------------------------------ one material */

static void plain(lum_material *m)
{
    const lum_texture none = {.image = LUM_NONE, .m = {{1, 0, 0}, {0, 1, 0}}};
    m->base_texture = m->metal_rough_texture = m->transmission_texture = none;
    m->diffuse_transmission_texture = m->diffuse_transmission_color_texture = none;
    lum_layers_none(&m->layers);
    m->alpha_mode = LUM_ALPHA_OPAQUE;
    m->metallic = 0;
    m->transmission = m->diffuse_transmission = 0;
    m->has_eta = false;
    m->priority = 0;
    const lum_spectral emission = {.emission = m->spectral.emission, .measured = m->spectral.measured};
    m->spectral = emission;
    m->thin = true;
    m->roughness = 1;
    for (int i = 0; i < 4; i++)
        m->base_color[i] = 1;
    for (int i = 0; i < 3; i++) {
        m->absorption[i] = m->scattering[i] = 0;
        m->diffuse_transmission_color[i] = 1;
    }
}

static void set_color(lum_material *m, const float rgb[3])
{
    memcpy(m->base_color, rgb, 3 * sizeof *rgb);
}

/* A layer that reflects r and transmits t diffusely.  In glTF's terms: a share d of the light goes through and takes the
 * transmission colour, the rest comes back with the base colour; with an index of 1 there is no interface before it. */
static void set_diffuse_transmission(lum_material *m, const lum_recipe_entry *e)
{
    float d = e->through;
    m->kind = LUM_SURFACE_PBR;
    m->ior = 1;
    m->diffuse_transmission = d;
    for (int i = 0; i < 3; i++) {
        m->base_color[i] = d < 1 ? fminf(e->reflectance[i] / (1 - d), 1) : 0;
        m->diffuse_transmission_color[i] = d > 0 ? fminf(e->transmittance[i] / d, 1) : 0;
    }
}

static void apply_finish(lum_material *m, const lum_recipe_entry *e)
{
    if (e->finish == LUM_FINISH_NONE)
        return;
    plain(m);
    const lum_spectral emission = m->spectral;
    m->spectral = e->spectral;
    m->spectral.emission = emission.emission;
    m->spectral.measured = emission.measured;
    switch (e->finish) {
    case LUM_FINISH_GLASS:
        m->kind = LUM_SURFACE_PBR;
        m->transmission = 1;
        m->roughness = e->roughness;
        memcpy(m->absorption, e->absorption, sizeof m->absorption);
        break;
    case LUM_FINISH_MIRROR:
        m->kind = LUM_SURFACE_CONDUCTOR;
        m->roughness = e->roughness;
        m->metallic = 1;
        set_color(m, e->reflectance);
        break;
    case LUM_FINISH_CONDUCTOR:
        m->kind = LUM_SURFACE_CONDUCTOR;
        m->roughness = e->roughness;
        m->metallic = 1;
        m->has_eta = true;
        memcpy(m->eta, e->eta, sizeof m->eta);
        memcpy(m->k, e->k, sizeof m->k);
        break;
    case LUM_FINISH_DIFFUSE:
        m->kind = LUM_SURFACE_LAMBERT;
        set_color(m, e->reflectance);
        break;
    case LUM_FINISH_DIFFUSE_TRANSMISSION:
        set_diffuse_transmission(m, e);
        break;
    case LUM_FINISH_PHOSPHOR:
        set_diffuse_transmission(m, e);
        m->kind = LUM_SURFACE_LAMBERT;
        break;
    case LUM_FINISH_BLACK:
        m->kind = LUM_SURFACE_BLACK;
        set_color(m, (const float[3]){0, 0, 0});
        break;
    case LUM_FINISH_NONE:
        break;
    }
}

/* What is known by wavelength of the inside of a solid. */
static void set_filling(lum_material *m, const lum_spectral *from)
{
    lum_spectral *s = &m->spectral;
    s->absorption = from->absorption;
    s->scattering = from->scattering;
    if (from->fills || s->fills) {
        s->excitation = from->excitation;
        s->converted = from->converted;
        s->quantum_yield = from->quantum_yield;
        s->fills = from->fills;
    }
}

static void apply_entry(lum_material *m, const lum_recipe_entry *e)
{
    const lum_texture none = {.image = LUM_NONE, .m = {{1, 0, 0}, {0, 1, 0}}};
    apply_finish(m, e);
    if (e->ior > 0) {
        m->ior = (float)e->ior;
        m->spectral.index = e->spectral.index;
    }
    if (e->has_priority)
        m->priority = e->priority;
    if (e->has_thin) {
        m->thin = e->thin;
        for (int i = 0; i < 3 && e->thin; i++)
            m->absorption[i] = m->scattering[i] = 0;
        if (e->thin)
            set_filling(m, &(lum_spectral){0});
    }
    if (e->has_medium) {
        memcpy(m->scattering, e->scattering, sizeof m->scattering);
        memcpy(m->absorption, e->medium_absorption, sizeof m->absorption);
        set_filling(m, &e->filling);
        m->anisotropy = e->anisotropy;
    }
    if (e->no_emission || e->emitter) {
        memset(m->emissive, 0, sizeof m->emissive); /* an emitter's luminance follows when its area is known */
        m->emissive_texture = none;
        m->emits_back = false;
        m->spectral.emission = e->spectral.emission;
        m->spectral.measured = e->spectral.measured;
    }
    if (e->emitter) {
        m->emits_back = e->sides == LUM_SIDES_BOTH;
        if (m->alpha_mode == LUM_ALPHA_BLEND) /* what glows isn't half there: its transparency stood for glass */
            m->alpha_mode = LUM_ALPHA_OPAQUE;
    }
}

/* -------------------------------------------------------------------------------------------------------- all parts */

typedef struct variant {
    int32_t base;      /* material of the document */
    uint64_t entries;  /* hash of the list of entries that match */
    uint32_t material; /* in the new list */
    uint32_t dark;     /* the same without its emission, or UINT32_MAX: faces of an emitter that look inside */
    int32_t emitter;   /* the entry that sets the emission, -1 = none */
} variant;

typedef struct applying {
    lum_build *b;
    lum_material *materials;
    uint32_t count, capacity;
    variant *variants;
    uint32_t variant_count;
    uint32_t *part_variant;
    double *emitting; /* m2, per entry, both sides counted where both emit */
} applying;

static lmg_result add_material(applying *a, const lum_material *m, uint32_t *index)
{
    if (a->count == a->capacity) {
        a->capacity = 2 * a->capacity + 16;
        LUM_TRY(lum_grow((void **)&a->materials, sizeof *a->materials, a->capacity, a->b->err));
    }
    *index = a->count;
    a->materials[a->count++] = *m;
    return LMG_OK;
}

static lmg_result find_variant(applying *a, uint32_t p)
{
    lum_build *b = a->b;
    lum_model *m = b->model;
    const lum_part *part = &m->parts[p];
    const lum_material *base = &m->materials[part->material];
    uint32_t n = b->recipe ? b->recipe->entry_count : 0;
    uint64_t hash = LUM_HASH_START;
    for (uint32_t i = 0; i < n; i++)
        if (matches(b, &b->recipe->entries[i], b->part_node[p], part->mesh, base->name))
            hash = lum_fnv1a(hash, &i, sizeof i);
    for (uint32_t i = 0; i < a->variant_count; i++)
        if (a->variants[i].base == part->material && a->variants[i].entries == hash) {
            a->part_variant[p] = i;
            return LMG_OK;
        }
    variant v = {.base = part->material, .entries = hash, .dark = UINT32_MAX, .emitter = -1};
    lum_material changed = *base;
    const lum_recipe_entry *medium = NULL;
    for (uint32_t i = 0; i < n; i++) {
        const lum_recipe_entry *e = &b->recipe->entries[i];
        if (!matches(b, e, b->part_node[p], part->mesh, base->name))
            continue;
        apply_entry(&changed, e);
        if (e->emitter || e->no_emission)
            v.emitter = e->emitter ? (int32_t)i : -1;
        if (e->has_medium)
            medium = e;
        if (e->has_thin && changed.transmission == 0 && e->finish == LUM_FINISH_NONE)
            lum_warn(b, "recipe %s: \"thin\" changes nothing on material \"%.60s\", which lets no light through; \"glass\" would",
                     e->where, base->name);
    }
    if (medium && (changed.scattering[0] > 0 || changed.scattering[1] > 0 || changed.scattering[2] > 0 || changed.spectral.scattering ||
                   changed.spectral.fills))
        LUM_TRY(lum_recipe_check_medium(b, medium, &changed));
    for (uint32_t i = 0; i < n; i++) {
        const lum_recipe_entry *e = &b->recipe->entries[i];
        if (e->has_priority && (changed.transmission == 0 || changed.thin) && matches(b, e, b->part_node[p], part->mesh, base->name))
            lum_warn(b, "recipe %s: \"priority\" changes nothing on material \"%.60s\", which is not a clear solid; \"glass\" would make it one",
                     e->where, base->name);
    }
    LUM_TRY(add_material(a, &changed, &v.material));
    if (v.emitter >= 0 && b->recipe->entries[v.emitter].sides == LUM_SIDES_OUTSIDE)
        LUM_TRY(add_material(a, &changed, &v.dark));
    LUM_TRY(lum_grow((void **)&a->variants, sizeof *a->variants, a->variant_count + 1u, b->err));
    a->part_variant[p] = a->variant_count;
    a->variants[a->variant_count++] = v;
    return LMG_OK;
}

/* Gives the part's triangles their materials and sums the emitting area.  `inside`: per triangle, NULL if not needed. */
static void assign(applying *a, uint32_t p, const bool *inside)
{
    lum_model *m = a->b->model;
    lum_part *part = &m->parts[p];
    const variant *v = &a->variants[a->part_variant[p]];
    for (uint32_t t = part->first_triangle; t < part->first_triangle + part->triangle_count; t++) {
        bool dark = v->dark != UINT32_MAX && inside && inside[t];
        m->triangle_material[t] = (int32_t)(dark ? v->dark : v->material);
        if (v->emitter >= 0 && !dark)
            a->emitting[v->emitter] += lum_triangle_area(m, t) * (a->materials[v->material].emits_back ? 2 : 1);
    }
    part->material = (int32_t)v->material;
}

/* Luminance of a Lambertian surface that emits a flux in lumens from an area: L = flux / (pi A). */
static lmg_result light_up(applying *a)
{
    const double pi = 3.14159265358979323846;
    for (uint32_t i = 0; i < a->variant_count; i++) {
        const variant *v = &a->variants[i];
        if (v->emitter < 0)
            continue;
        const lum_recipe_entry *e = &a->b->recipe->entries[v->emitter];
        double area = a->emitting[v->emitter];
        if (!(area > 0))
            return lmg_fail(a->b->err, LMG_ERROR_INPUT,
                            "recipe %s: no face of \"%.60s\" looks outside; give its emitter \"sides\": \"both\"", e->where,
                            e->match);
        double luminance = e->lumens > 0 ? e->lumens / (pi * area) : e->luminance;
        for (int k = 0; k < 3; k++) {
            a->materials[v->material].emissive[k] = (float)(luminance * e->color[k]);
            if (!isfinite(a->materials[v->material].emissive[k]))
                return lmg_fail(a->b->err, LMG_ERROR_INPUT,
                                "recipe %s: %g cd/m2 is beyond the range of float; check the emitter's area", e->where, luminance);
        }
    }
    return LMG_OK;
}

static lmg_result apply(applying *a)
{
    lum_build *b = a->b;
    lum_model *m = b->model;
    a->part_variant = calloc((size_t)m->part_count + 1, sizeof *a->part_variant);
    a->emitting = calloc((size_t)(b->recipe ? b->recipe->entry_count : 0) + 1, sizeof *a->emitting);
    if (!a->part_variant || !a->emitting)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    bool outside = false;
    for (uint32_t p = 0; p < m->part_count; p++) {
        LUM_TRY(find_variant(a, p));
        outside = outside || a->variants[a->part_variant[p]].dark != UINT32_MAX;
    }
    bool *inside = NULL;
    if (outside)
        LUM_TRY(lum_find_inside(b, &inside));
    for (uint32_t p = 0; p < m->part_count; p++)
        assign(a, p, inside);
    free(inside);
    LUM_TRY(light_up(a));
    if (a->count == 0) { /* a model of lights alone still has a material */
        uint32_t index;
        LUM_TRY(add_material(a, &m->materials[m->material_count - 1], &index));
    }
    free(m->materials);
    m->materials = a->materials;
    m->material_count = a->count;
    a->materials = NULL;
    return LMG_OK;
}

/* The model owns what its materials point to: copies the recipe's spectra that they use. */
static lmg_result adopt_spectra(lum_build *b)
{
    for (uint32_t i = 0; b->recipe && i < b->recipe->spectrum_count; i++) {
        const lum_spectrum *theirs = b->recipe->spectra[i], *ours = NULL;
        for (uint32_t k = 0; k < b->model->material_count; k++) {
            lum_spectral *s = &b->model->materials[k].spectral;
            const lum_spectrum **part[] = {&s->emission, &s->index, &s->absorption, &s->reflectance, &s->transmittance,
                                           &s->eta,      &s->k,     &s->excitation, &s->converted,   &s->scattering};
            for (size_t p = 0; p < sizeof part / sizeof *part; p++) {
                if (*part[p] != theirs)
                    continue;
                if (!ours)
                    LUM_TRY(lum_add_spectrum(b, theirs, &ours));
                *part[p] = ours;
            }
        }
    }
    return LMG_OK;
}

/* Also without a recipe: materials that no part uses go. */
lmg_result lum_recipe_apply(lum_build *b)
{
    if (b->recipe) {
        b->model->rated_flux = b->recipe->flux;
        LUM_TRY(check_all_matched(b));
    }
    applying a = {.b = b};
    lmg_result result = apply(&a);
    if (!result)
        result = adopt_spectra(b);
    free(a.materials);
    free(a.variants);
    free(a.part_variant);
    free(a.emitting);
    return result;
}
