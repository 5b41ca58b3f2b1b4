/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading recipes: JSON (docs/recipe.md) and command-line shorthands, which are turned into the same JSON so that there is one set
 * of rules.  Every key is known or an error; messages give the key's path.  Relies on jansson, and on gltf_file.c for reading
 * files.
 */
#include "recipe.h"
#include "colour.h"
#include "gltf_file.h"
#include "recipe_reader.h"
#include "recipe_spectrum.h"
#include "text.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_RECIPE_BYTES ((size_t)16 << 20)

/* ------------------------------------------------------------------------------------------------------------- entries */

static void read_emitter(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "emitter", &in))
        return;
    e->emitter = true;
    bool lumens = lum_reader_number(&in, "lumens", 1e-12, 1e12, &e->lumens);
    bool luminance = lum_reader_number(&in, "luminance", 1e-12, 1e15, &e->luminance);
    double watts, kelvin;
    bool power = lum_reader_number(&in, "watts", 1e-12, 1e12, &watts);
    if (lumens + luminance + power != 1)
        lum_reader_fail(&in, "", "%s", lumens + luminance + power
                                           ? "give one of \"lumens\", \"luminance\" (cd/m2) and \"watts\""
                                           : "needs \"lumens\" or \"luminance\" (cd/m2), or \"watts\" and a \"spectrum\"");
    bool colour = lum_reader_rgb(&in, "color", 0, 1e12, e->color);
    bool temperature = lum_reader_number(&in, "kelvin", LUM_KELVIN_MIN, LUM_KELVIN_MAX, &kelvin);
    bool spectrum = lum_reader_light(&in, "spectrum", &e->spectral.emission);
    if (colour + temperature + spectrum > 1)
        lum_reader_fail(&in, "", "give one of \"color\", \"kelvin\" and \"spectrum\"");
    if (power && !spectrum)
        lum_reader_fail(&in, "watts", "needs a \"spectrum\"");
    if (spectrum && !in.result) {
        lum_spectrum_rgb(e->spectral.emission, e->color);
        e->spectral.measured = true;
        if (power)
            e->lumens = watts * lum_spectrum_efficacy(e->spectral.emission);
    } else if (temperature) {
        lum_planckian(kelvin, e->color);
        e->spectral.emission = lum_reader_blackbody(&in, kelvin);
    } else if (!colour) {
        e->color[0] = e->color[1] = e->color[2] = 1;
    } else {
        double y = 0.2126 * e->color[0] + 0.7152 * e->color[1] + 0.0722 * e->color[2];
        if (!(y > 0))
            lum_reader_fail(&in, "color", "is black");
        for (int i = 0; i < 3 && y > 0; i++)
            e->color[i] /= y;
    }
    static const char *const sides[] = {"front", "both", "outside"};
    e->sides = (lum_sides)lum_reader_choice(&in, "sides", sides, 3, "front, both, outside", LUM_SIDES_FRONT);
    lum_reader_close(r, &in);
}

static void set_finish(lum_reader *r, const char *key, lum_recipe_entry *e, lum_finish finish)
{
    if (e->finish != LUM_FINISH_NONE)
        lum_reader_fail(r, key, "the entry says two things about the same surface; split it in two, the later one wins");
    e->finish = finish;
}

static void get_roughness(lum_reader *r, lum_recipe_entry *e)
{
    double x;
    if (lum_reader_number(r, "roughness", 0, 1, &x))
        e->roughness = (float)x;
}

static void get_priority(lum_reader *r, lum_recipe_entry *e)
{
    double x;
    if (!lum_reader_number(r, "priority", -1000, 1000, &x))
        return;
    if (x != floor(x))
        lum_reader_fail(r, "priority", "%g is not a whole number", x);
    e->priority = (int32_t)x;
    e->has_priority = true;
}

static void read_glass(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "glass", &in))
        return;
    set_finish(&in, "", e, LUM_FINISH_GLASS);
    if (!lum_reader_index(&in, &e->ior, &e->spectral.index))
        e->ior = 1.5;
    e->thin = false;
    lum_reader_bool(&in, "thin", &e->thin);
    e->has_thin = true;
    get_priority(&in, e);
    get_roughness(&in, e);
    double color[3], distance;
    bool absorption = lum_reader_property(&in, "absorption", 0, 1e9, e->absorption, &e->spectral.absorption);
    bool coloured = lum_reader_rgb(&in, "attenuation_color", 1e-30, 1, color);
    bool distant = lum_reader_number(&in, "attenuation_distance", 1e-9, 1e9, &distance);
    if (coloured != distant || (coloured && absorption))
        lum_reader_fail(&in, "", "give \"absorption\" (1/m), or \"attenuation_color\" and \"attenuation_distance\" (m) together");
    if (coloured && distant)
        for (int i = 0; i < 3; i++)
            e->absorption[i] = (float)(-log(color[i]) / distance);
    if (e->thin && (absorption || coloured))
        lum_reader_fail(&in, "", "a thin wall has no inside to absorb light in; leave the absorption out or set \"thin\" to false");
    lum_reader_close(r, &in);
}

static void read_mirror(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "mirror", &in))
        return;
    set_finish(&in, "", e, LUM_FINISH_MIRROR);
    get_roughness(&in, e);
    if (!lum_reader_reflectance(&in, "reflectance", e->reflectance, &e->spectral.reflectance)) {
        lum_reader_check_rest(&in); /* a misspelt key is why */
        lum_reader_fail(&in, "reflectance", "is missing");
    }
    lum_reader_close(r, &in);
}

static void read_conductor(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "conductor", &in))
        return;
    set_finish(&in, "", e, LUM_FINISH_CONDUCTOR);
    char given[LUM_NAME_SIZE];
    bool named = lum_reader_string(&in, "metal", given);
    const char *metal = named ? lum_metal_name(given) : NULL;
    bool eta = lum_reader_property(&in, "eta", 1e-6, 1e3, e->eta, &e->spectral.eta);
    bool k = lum_reader_property(&in, "k", 0, 1e3, e->k, &e->spectral.k);
    if ((e->spectral.eta != NULL) != (e->spectral.k != NULL))
        lum_reader_fail(&in, "", "give both \"eta\" and \"k\" by wavelength, or neither");
    if (named == (eta || k) || eta != k)
        lum_reader_fail(&in, "", "give \"metal\", or \"eta\" and \"k\" together");
    if (named && !lum_metal(metal, e->eta, e->k))
        lum_reader_fail(&in, "metal", "\"%.40s\" is not one of %s, or the symbol of one", metal, lum_metal_names());
    if (named)
        lum_reader_metal(&in, metal, &e->spectral.eta, &e->spectral.k);
    get_roughness(&in, e);
    lum_reader_close(r, &in);
}

static void read_diffuse(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "diffuse", &in))
        return;
    set_finish(&in, "", e, LUM_FINISH_DIFFUSE);
    if (!lum_reader_reflectance(&in, "reflectance", e->reflectance, &e->spectral.reflectance)) {
        lum_reader_check_rest(&in);
        lum_reader_fail(&in, "reflectance", "is missing");
    }
    lum_reader_close(r, &in);
}

static void read_diffuse_transmission(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    if (!lum_reader_open(r, "diffuse_transmission", &in))
        return;
    set_finish(&in, "", e, LUM_FINISH_DIFFUSE_TRANSMISSION);
    lum_recipe_read_layer(&in, e, false);
    lum_reader_close(r, &in);
}

/* "profile": a light with a photometric file's intensities at every node that matches. */
static void read_profile(lum_reader *r, lum_recipe_entry *e)
{
    static const char *const shapes[] = {"file", "point"};
    lum_reader in;
    char file[LUM_NAME_SIZE];
    if (!lum_reader_open(r, "profile", &in))
        return;
    if (e->target == LUM_TARGET_MATERIAL || e->target == LUM_TARGET_MESH)
        lum_reader_fail(r, "profile", "belongs to a node, not to a material or mesh");
    if (!lum_reader_string(&in, "file", file))
        lum_reader_fail(&in, "file", "is missing: the name of an IES, EULUMDAT or TM-33 file");
    else if (snprintf(e->profile, sizeof e->profile, "%s%s", *file == '/' ? "" : r->recipe->folder, file) >= (int)sizeof e->profile)
        lum_reader_fail(&in, "file", "the path is too long");
    lum_reader_number(&in, "lumens", 1e-9, 1e12, &e->profile_lumens);
    e->profile_point = lum_reader_choice(&in, "shape", shapes, 2, "file, point", 0) == 1;
    lum_reader_close(r, &in);
}

static void read_entry_keys(lum_reader *r, lum_recipe_entry *e)
{
    static const char *const targets[] = {"any", "material", "mesh", "node"};
    if (!lum_reader_string(r, "match", e->match))
        lum_reader_fail(r, "match", "is missing: the name of a material, mesh or node");
    e->target = (lum_target)lum_reader_choice(r, "target", targets, 4, "any, material, mesh, node", LUM_TARGET_ANY);
    bool black = false;
    lum_reader_bool(r, "leave_out", &e->leave_out);
    lum_reader_bool(r, "no_emission", &e->no_emission);
    read_emitter(r, e);
    read_profile(r, e);
    read_glass(r, e);
    read_mirror(r, e);
    read_conductor(r, e);
    read_diffuse(r, e);
    read_diffuse_transmission(r, e);
    lum_recipe_read_medium(r, e);
    lum_recipe_read_phosphor(r, e);
    if (lum_reader_bool(r, "black", &black) && black)
        set_finish(r, "black", e, LUM_FINISH_BLACK);
    double ior;
    bool thin, has_thin = lum_reader_bool(r, "thin", &thin), has_ior;
    const lum_spectrum *index;
    has_ior = lum_reader_index(r, &ior, &index);
    if ((has_thin || has_ior) && e->finish != LUM_FINISH_NONE)
        lum_reader_fail(r, has_thin ? "thin" : "ior", "belongs inside \"glass\" when the entry names a surface");
    if (has_thin) {
        e->thin = thin;
        e->has_thin = true;
    }
    if (has_ior) {
        e->ior = ior;
        e->spectral.index = index;
    }
    get_priority(r, e);
    if (e->emitter && e->no_emission)
        lum_reader_fail(r, "no_emission", "contradicts \"emitter\"");
    if (e->profile[0] && (e->leave_out || e->no_emission || e->emitter || e->has_thin || e->has_priority || e->ior != 0 ||
                          e->finish != LUM_FINISH_NONE || e->has_medium))
        lum_reader_fail(r, "profile", "stands in an entry of its own");
    lum_reader_check_rest(r); /* before complaining that it says nothing: a misspelt key is why */
    if (!r->result && !e->leave_out && !e->no_emission && !e->emitter && !e->has_thin && !e->has_priority && e->ior == 0 &&
        e->finish == LUM_FINISH_NONE && !e->has_medium && !e->profile[0])
        lum_reader_fail(r, "", "says nothing about \"%.60s\"", e->match);
}

/* Reads one entry and adds it. */
static lmg_result add_entry(lum_recipe *recipe, json_t *object, const char *where, lmg_error *err)
{
    lum_recipe_entry e = {.sides = LUM_SIDES_FRONT};
    snprintf(e.where, sizeof e.where, "%.120s", where);
    lum_reader r = {.object = object, .recipe = recipe, .err = err};
    snprintf(r.path, sizeof r.path, "%.100s", where);
    if (!json_is_object(object))
        return lmg_fail(err, LMG_ERROR_INPUT, "%s: must be an object", where);
    read_entry_keys(&r, &e);
    if (r.result)
        return r.result;
    lum_recipe_entry *grown = realloc(recipe->entries, (recipe->entry_count + 1u) * sizeof *grown);
    if (!grown)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    recipe->entries = grown;
    recipe->entries[recipe->entry_count++] = e;
    return LMG_OK;
}

/* --------------------------------------------------------------------------------------------------------------- whole */

static void read_globals(lum_recipe *recipe, lum_reader *r)
{
    lum_reader_number(r, "scale", 1e-9, 1e9, &recipe->scale);
    lum_reader_number(r, "flux", 1e-12, 1e12, &recipe->flux);
}

static lmg_result read_document(lum_recipe *recipe, json_t *root, lmg_error *err)
{
    lum_reader r = {.object = root, .err = err};
    if (!json_is_object(root))
        return lmg_fail(err, LMG_ERROR_INPUT, "a recipe is an object, { ... }; see docs/recipe.md");
    read_globals(recipe, &r);
    lum_recipe_read_volumes(&r, recipe->folder, recipe);
    json_t *entries = lum_reader_take(&r, "entries");
    if (entries && !json_is_array(entries))
        lum_reader_fail(&r, "entries", "must be an array");
    for (size_t i = 0; !r.result && i < json_array_size(entries); i++) {
        char where[40];
        snprintf(where, sizeof where, "entries[%zu]", i);
        r.result = add_entry(recipe, json_array_get(entries, i), where, err);
    }
    json_decref(entries);
    lum_reader_check_rest(&r);
    return r.result;
}

lmg_result lum_recipe_create(lum_recipe **out, lmg_error *err)
{
    *out = calloc(1, sizeof **out);
    if (!*out)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    (*out)->scale = 1;
    (*out)->hash = LUM_HASH_START;
    return LMG_OK;
}

void lum_recipe_destroy(lum_recipe *recipe)
{
    if (!recipe)
        return;
    for (uint32_t i = 0; i < recipe->spectrum_count; i++)
        free(recipe->spectra[i]);
    free(recipe->spectra);
    free(recipe->entries);
    free(recipe->volumes);
    free(recipe);
}

lmg_result lum_recipe_read(const char *path, lum_recipe **out, lmg_error *err)
{
    lum_recipe *recipe;
    *out = NULL;
    LUM_TRY(lum_recipe_create(&recipe, err));
    uint8_t *text = NULL;
    size_t size = 0;
    json_t *root = NULL;
    snprintf(recipe->folder, sizeof recipe->folder, "%.*s", (int)(lum_base_name(path) - path), path);
    lmg_result result = lum_read_file(path, MAX_RECIPE_BYTES, &text, &size, err);
    if (!result) {
        json_error_t e;
        root = json_loadb((const char *)text, size, JSON_REJECT_DUPLICATES, &e);
        if (!root)
            result = lmg_fail(err, LMG_ERROR_INPUT, "not JSON: line %d, column %d: %.200s", e.line, e.column, e.text);
    }
    if (!result)
        result = read_document(recipe, root, err);
    if (!result)
        recipe->hash = lum_fnv1a(recipe->hash, text, size);
    json_decref(root);
    free(text);
    if (result) {
        lum_prefix_error(err, lum_base_name(path));
        lum_recipe_destroy(recipe);
        return result;
    }
    *out = recipe;
    return LMG_OK;
}

/* --------------------------------------------------------------------------------------------------------- shorthands */

/* The value of a shorthand, cut at its commas. */
typedef struct words {
    char text[LUM_NAME_SIZE];
    char *word[4];
    int count;
} words;

static bool cut(const char *value, words *w)
{
    if (strlen(value) >= sizeof w->text)
        return false;
    strcpy(w->text, value);
    w->count = 0;
    for (char *p = w->text; p; w->count++) {
        if (w->count == 4)
            return false;
        w->word[w->count] = p;
        p = strchr(p, ',');
        if (p)
            *p++ = 0;
    }
    return true;
}

/* A number followed by nothing but the unit. */
static bool quantity(const char *text, const char *unit, double *out)
{
    char *end;
    *out = strtod(text, &end);
    return end != text && strcmp(end, unit) == 0 && isfinite(*out);
}

/* {"emitter": {...}} of "800lm", "9500cd/m2", with ",2700K" or ",D65", and ",both" or ",outside" after it in any order. */
static json_t *emitter_words(const words *w)
{
    json_t *e = json_object();
    double x;
    lum_spectrum light;
    for (int i = 0; i < w->count; i++) {
        if (quantity(w->word[i], "lm", &x)) {
            json_object_set_new(e, "lumens", json_real(x));
        } else if (quantity(w->word[i], "cd/m2", &x)) {
            json_object_set_new(e, "luminance", json_real(x));
        } else if (quantity(w->word[i], "K", &x)) {
            json_object_set_new(e, "kelvin", json_real(x));
        } else if (strcmp(w->word[i], "front") == 0 || strcmp(w->word[i], "both") == 0 || strcmp(w->word[i], "outside") == 0) {
            json_object_set_new(e, "sides", json_string(w->word[i]));
        } else if (lum_spectrum_illuminant(w->word[i], &light)) {
            json_object_set_new(e, "spectrum", json_string(w->word[i]));
        } else {
            json_decref(e);
            return NULL;
        }
    }
    return e;
}

/* {first: number, second: number} of "0.9" or "0.9,0.1"; text is kept where first is a name. */
static json_t *pair_words(const words *w, const char *first, const char *second, bool named)
{
    double a = 0, b = 0;
    lum_index_model glass;
    named |= strcmp(first, "ior") == 0 && lum_index_of_glass(w->word[0], &glass);
    if (w->count > 2 || (!named && !quantity(w->word[0], "", &a)) || (w->count == 2 && (!second || !quantity(w->word[1], "", &b))))
        return NULL;
    json_t *e = json_object();
    json_object_set_new(e, first, named ? json_string(w->word[0]) : json_real(a));
    if (w->count == 2)
        json_object_set_new(e, second, json_real(b));
    return e;
}

typedef enum form { FORM_FLAG, FORM_EMITTER, FORM_PAIR, FORM_NAMED_PAIR } form;

static const struct shorthand {
    const char *verb, *key;
    form form;
    bool value; /* of a flag */
    const char *first, *second;
} shorthands[] = {
    {"emitter", "emitter", FORM_EMITTER, true, NULL, NULL},
    {"no-emission", "no_emission", FORM_FLAG, true, NULL, NULL},
    {"thin", "thin", FORM_FLAG, true, NULL, NULL},
    {"solid", "thin", FORM_FLAG, false, NULL, NULL},
    {"black", "black", FORM_FLAG, true, NULL, NULL},
    {"leave-out", "leave_out", FORM_FLAG, true, NULL, NULL},
    {"glass", "glass", FORM_PAIR, true, "ior", "roughness"},
    {"mirror", "mirror", FORM_PAIR, true, "reflectance", "roughness"},
    {"conductor", "conductor", FORM_NAMED_PAIR, true, "metal", "roughness"},
    {"diffuse", "diffuse", FORM_PAIR, true, "reflectance", NULL},
    {"diffuse-transmission", "diffuse_transmission", FORM_PAIR, true, "reflectance", "transmittance"},
};

/* Turns "verb:name=value" into the JSON of an entry; NULL when it isn't one. */
static json_t *shorthand_entry(const struct shorthand *s, const char *name_and_value)
{
    char name[2 * LUM_NAME_SIZE];
    const char *equals = s->form == FORM_FLAG ? NULL : strrchr(name_and_value, '=');
    size_t n = equals ? (size_t)(equals - name_and_value) : strlen(name_and_value);
    words w;
    if (n == 0 || n >= sizeof name || (s->form != FORM_FLAG && (!equals || !cut(equals + 1, &w))))
        return NULL;
    memcpy(name, name_and_value, n);
    name[n] = 0;
    json_t *value = s->form == FORM_FLAG      ? json_boolean(s->value)
                    : s->form == FORM_EMITTER ? emitter_words(&w)
                                              : pair_words(&w, s->first, s->second, s->form == FORM_NAMED_PAIR);
    if (!value)
        return NULL;
    json_t *entry = json_object();
    json_object_set_new(entry, "match", json_string(name));
    json_object_set_new(entry, s->key, value);
    return entry;
}

static lmg_result bad_shorthand(const char *text, lmg_error *err)
{
    return lmg_fail(
        err, LMG_ERROR_ARGUMENT,
        "recipe shorthand \"%.80s\" is not understood; examples: emitter:Bulb=800lm,2700K  emitter:Tube=9500cd/m2  thin:Glass  "
        "solid:Lens  no-emission:Shade  mirror:Reflector=0.9,0.1  conductor:Rim=aluminium  diffuse:Casing=0.8  glass:Lens=1.5  "
        "diffuse-transmission:Globe=0.4,0.5  black:Socket  leave-out:Pole  scale=0.001  flux=800lm",
        text);
}

lmg_result lum_recipe_add(lum_recipe *recipe, const char *shorthand, lmg_error *err)
{
    double x;
    lmg_result result = LMG_OK;
    if (strncmp(shorthand, "scale=", 6) == 0 || strncmp(shorthand, "flux=", 5) == 0) {
        bool scale = shorthand[0] == 's';
        if (!quantity(shorthand + (scale ? 6 : 5), scale ? "" : "lm", &x))
            return bad_shorthand(shorthand, err);
        json_t *object = json_pack("{s:f}", scale ? "scale" : "flux", x);
        lum_reader r = {.object = object, .err = err};
        read_globals(recipe, &r);
        json_decref(object);
        result = r.result;
    } else {
        const char *colon = strchr(shorthand, ':');
        const struct shorthand *s = NULL;
        for (size_t i = 0; colon && i < sizeof shorthands / sizeof *shorthands; i++)
            if (strlen(shorthands[i].verb) == (size_t)(colon - shorthand) &&
                strncmp(shorthands[i].verb, shorthand, (size_t)(colon - shorthand)) == 0)
                s = &shorthands[i];
        json_t *entry = s ? shorthand_entry(s, colon + 1) : NULL;
        if (!entry)
            return bad_shorthand(shorthand, err);
        char where[LUM_NAME_SIZE];
        snprintf(where, sizeof where, "\"%.100s\"", shorthand);
        result = add_entry(recipe, entry, where, err);
        json_decref(entry);
    }
    if (!result)
        recipe->hash = lum_fnv1a(recipe->hash, shorthand, strlen(shorthand) + 1);
    else
        lum_prefix_error(err, "recipe");
    return result;
}
