/* SPDX-License-Identifier: Apache-2.0 */
/* Spectra in recipes (recipe_spectrum.h).  Relies on spectrum.h for making them and on jansson. */
#include "recipe_spectrum.h"

#include "text.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* What a spectrum is of decides what it may be and what its table means beyond its ends. */
typedef struct wanted {
    lum_spectrum_end end;
    double low, high;
} wanted;

static const wanted A_LIGHT = {LUM_SPECTRUM_ZERO, 0, 1e30};

/* Puts a spectrum into the recipe, which owns it. */
const lum_spectrum *lum_reader_keep(lum_reader *r, const lum_spectrum *s)
{
    lum_recipe *recipe = r->recipe;
    lum_spectrum **grown = realloc(recipe->spectra, (recipe->spectrum_count + 1u) * sizeof *grown);
    lum_spectrum *copy = malloc(sizeof *copy);
    if (grown)
        recipe->spectra = grown;
    if (!grown || !copy) {
        free(copy);
        r->result = lmg_fail(r->err, LMG_ERROR_MEMORY, "out of memory");
        return NULL;
    }
    *copy = *s;
    recipe->hash = lum_fnv1a(recipe->hash, s, sizeof *s); /* what a file says is part of the recipe */
    recipe->spectra[recipe->spectrum_count++] = copy;
    return copy;
}

/* Takes over the message of a function that knows nothing of the recipe. */
static void failed(lum_reader *r, const char *key, const lmg_error *why)
{
    lum_reader_fail(r, key, "%.250s", why->message);
}

/* ------------------------------------------------------------------------------------------------------- forms of it */

static bool numbers(lum_reader *r, const char *key, const json_t *array, size_t least, size_t most, double *out)
{
    const size_t n = json_array_size(array);
    if (!json_is_array(array) || n < least || n > most) {
        lum_reader_fail(r, key, least == most ? "must be a list of %zu numbers" : "must be a list of %zu or more numbers", least);
        return false;
    }
    for (size_t i = 0; i < n; ++i)
        if (!lum_reader_in_range(r, key, json_array_get(array, i), -1e12, 1e12, &out[i]))
            return false;
    return true;
}

/* {"nm": [...], "values": [...]} */
static void read_lists(lum_reader *in, json_t *nm, const wanted *want, lum_spectrum *out)
{
    enum { MAX_ROWS = 1 << 16 };
    json_t *values = lum_reader_take(in, "values");
    const size_t n = json_array_size(nm);
    double *x = malloc((n + 1) * sizeof *x), *y = malloc((n + 1) * sizeof *y);
    lmg_error why;
    if (!x || !y)
        in->result = lmg_fail(in->err, LMG_ERROR_MEMORY, "out of memory");
    else if (numbers(in, "nm", nm, 2, MAX_ROWS, x) && json_array_size(values) != n)
        lum_reader_fail(in, "values", "needs %zu numbers, as many as \"nm\"", n);
    else if (!in->result && numbers(in, "values", values, n, n, y) &&
             lum_spectrum_from_table(x, y, n, want->end, want->low, want->high, out, &why))
        failed(in, "", &why);
    free(x);
    free(y);
    json_decref(values);
}

static void read_file(lum_reader *in, const json_t *file, const wanted *want, lum_spectrum *out)
{
    char path[2048];
    const char *name = json_string_value(file);
    lmg_error why;
    if (!name || !*name || strlen(name) > 1000) {
        lum_reader_fail(in, "file", "must be the name of a file");
        return;
    }
    snprintf(path, sizeof path, "%s%s", *name == '/' ? "" : in->recipe->folder, name);
    if (lum_spectrum_read(path, want->end, want->low, want->high, out, &why))
        failed(in, "file", &why);
}

static void read_gaussian(lum_reader *in, const json_t *value, const wanted *want, lum_spectrum *out)
{
    double p[2], height = want->end == LUM_SPECTRUM_ZERO ? 1 : fmin(1, want->high);
    if (!numbers(in, "gaussian", value, 2, 2, p))
        return;
    if (!(p[0] >= LUM_NM_FIRST && p[0] <= LUM_NM_LAST))
        lum_reader_fail(in, "gaussian", "its peak at %g nm is outside [%d, %d]", p[0], LUM_NM_FIRST, LUM_NM_LAST);
    else if (!(p[1] >= 2 && p[1] <= 1000))
        lum_reader_fail(in, "gaussian", "its width of %g nm is outside [2, 1000]", p[1]);
    lum_reader_number(in, "height", want->low, want->high, &height);
    if (in->result)
        return;
    lum_spectrum_gaussian(p[0], p[1], out);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        out->value[i] = (float)(height * (double)out->value[i]);
}

/* An object that says one thing.  `in` is the object. */
static void read_spectrum(lum_reader *in, const wanted *want, lum_spectrum *out)
{
    const bool light = want->end == LUM_SPECTRUM_ZERO;
    const char *const forms = light ? "\"nm\" and \"values\", \"file\", \"gaussian\", \"blackbody\" or \"daylight\""
                                    : "\"nm\" and \"values\", \"file\" or \"gaussian\"";
    double kelvin;
    json_t *nm = lum_reader_take(in, "nm"), *file = lum_reader_take(in, "file"), *line = lum_reader_take(in, "gaussian");
    const bool body = light && lum_reader_number(in, "blackbody", LUM_BLACKBODY_MIN, LUM_BLACKBODY_MAX, &kelvin);
    const bool day = light && lum_reader_number(in, "daylight", LUM_DAYLIGHT_MIN, LUM_DAYLIGHT_MAX, &kelvin);
    if ((nm != NULL) + (file != NULL) + (line != NULL) + body + day != 1)
        lum_reader_fail(in, "", "give one of %s", forms);
    else if (nm)
        read_lists(in, nm, want, out);
    else if (file)
        read_file(in, file, want, out);
    else if (line)
        read_gaussian(in, line, want, out);
    else if (body)
        lum_spectrum_blackbody(kelvin, out);
    else
        lum_spectrum_daylight(kelvin, out);
    json_decref(nm);
    json_decref(file);
    json_decref(line);
}

/* What kind of value a key has. */
static bool is_object(const lum_reader *r, const char *key)
{
    return !r->result && json_is_object(json_object_get(r->object, key));
}

static const lum_spectrum *get_spectrum(lum_reader *r, const char *key, const wanted *want)
{
    lum_reader in;
    lum_spectrum s;
    if (!lum_reader_open(r, key, &in))
        return NULL;
    read_spectrum(&in, want, &s);
    lum_reader_close(r, &in);
    return r->result ? NULL : lum_reader_keep(r, &s);
}

/* --------------------------------------------------------------------------------------------------------------- keys */

bool lum_reader_light(lum_reader *r, const char *key, const lum_spectrum **out)
{
    *out = NULL;
    if (is_object(r, key)) {
        *out = get_spectrum(r, key, &A_LIGHT);
        double xyz[3] = {0};
        if (*out)
            lum_spectrum_xyz(*out, xyz);
        if (*out && !(xyz[1] > 0))
            lum_reader_fail(r, key, "has no visible light");
        return !r->result;
    }
    char name[LUM_NAME_SIZE];
    lum_spectrum s;
    if (!lum_reader_string(r, key, name))
        return false;
    if (!lum_spectrum_illuminant(name, &s))
        lum_reader_fail(r, key, "\"%.40s\" is not one of %s; a file is {\"file\": \"%.40s\"}", name, lum_spectrum_illuminant_names(),
                        name);
    else
        *out = lum_reader_keep(r, &s);
    return !r->result;
}

const lum_spectrum *lum_reader_blackbody(lum_reader *r, double kelvin)
{
    lum_spectrum s;
    lum_spectrum_blackbody(kelvin, &s);
    return r->result ? NULL : lum_reader_keep(r, &s);
}

void lum_reader_metal(lum_reader *r, const char *name, const lum_spectrum **eta, const lum_spectrum **k)
{
    lum_spectrum e, x;
    if (r->result || !lum_spectrum_of_metal(name, &e, &x))
        return;
    *eta = lum_reader_keep(r, &e);
    *k = r->result ? NULL : lum_reader_keep(r, &x);
}

bool lum_reader_property(lum_reader *r, const char *key, double low, double high, float rgb[3], const lum_spectrum **out)
{
    static const double nm[3] = {610, 550, 465};
    const wanted want = {LUM_SPECTRUM_HOLD, low, high};
    *out = NULL;
    if (!is_object(r, key))
        return lum_reader_rgb_float(r, key, low, high, rgb);
    *out = get_spectrum(r, key, &want);
    for (int i = 0; *out && i < 3; ++i)
        rgb[i] = (float)lum_spectrum_at(*out, nm[i]);
    return *out != NULL;
}

bool lum_reader_reflectance(lum_reader *r, const char *key, float rgb[3], const lum_spectrum **out)
{
    if (!lum_reader_property(r, key, 0, 1, rgb, out))
        return false;
    if (!*out)
        return true;
    lum_spectrum white;
    double xyz[3], lit[3], unlit[3];
    lum_spectrum_illuminant("D65", &white);
    lum_spectrum_xyz(&white, xyz);
    lum_xyz_to_rgb(xyz, unlit);
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        white.value[i] *= (*out)->value[i];
    lum_spectrum_xyz(&white, xyz);
    lum_xyz_to_rgb(xyz, lit);
    for (int i = 0; i < 3; ++i)
        rgb[i] = (float)fmin(fmax(lit[i] / unlit[i], 0), 1);
    return true;
}

/* A formula: {"sellmeier": [B1, C1, ...]} or {"cauchy": [A, B, C]}; false if the object is none of these. */
static bool read_formula(lum_reader *in, lum_index_model *model)
{
    json_t *sellmeier = lum_reader_take(in, "sellmeier"), *cauchy = lum_reader_take(in, "cauchy");
    const bool formula = sellmeier || cauchy;
    *model = (lum_index_model){.kind = sellmeier ? LUM_INDEX_SELLMEIER : LUM_INDEX_CAUCHY};
    if (sellmeier && cauchy)
        lum_reader_fail(in, "", "give either \"sellmeier\" or \"cauchy\"");
    else if (sellmeier && numbers(in, "sellmeier", sellmeier, 2, 6, model->c) && json_array_size(sellmeier) % 2)
        lum_reader_fail(in, "sellmeier", "needs pairs of B and C (um^2)");
    else if (cauchy)
        numbers(in, "cauchy", cauchy, 1, 3, model->c);
    json_decref(sellmeier);
    json_decref(cauchy);
    return formula;
}

static void from_model(lum_reader *r, const lum_index_model *model, double *ior, const lum_spectrum **out)
{
    lum_spectrum s;
    lmg_error why;
    if (r->result)
        return;
    if (lum_spectrum_of_index(model, &s, &why)) {
        failed(r, "ior", &why);
        return;
    }
    *ior = lum_index_at(model, LUM_NM_D);
    *out = lum_reader_keep(r, &s);
}

bool lum_reader_index(lum_reader *r, double *ior, const lum_spectrum **out)
{
    static const wanted index = {LUM_SPECTRUM_HOLD, 1, 4};
    lum_index_model model;
    double abbe = 0;
    *out = NULL;
    const json_t *value = r->result ? NULL : json_object_get(r->object, "ior");
    const bool plain = json_is_number(value);
    if (lum_reader_number(r, "abbe", 1, 1000, &abbe) && !plain)
        lum_reader_fail(r, "abbe", "belongs to an \"ior\" that is a number");
    if (!value || r->result)
        return false;
    if (json_is_string(value)) {
        char name[LUM_NAME_SIZE];
        if (!lum_reader_string(r, "ior", name))
            return false;
        if (lum_index_of_glass(name, &model))
            from_model(r, &model, ior, out);
        else
            lum_reader_fail(r, "ior", "\"%.40s\" is not one of %s", name, lum_glass_names());
        return !r->result;
    }
    if (json_is_object(value)) {
        lum_reader in;
        lum_spectrum s;
        if (!lum_reader_open(r, "ior", &in))
            return false;
        const bool formula = read_formula(&in, &model);
        if (!formula)
            read_spectrum(&in, &index, &s);
        lum_reader_close(r, &in);
        if (formula)
            from_model(r, &model, ior, out);
        else if (!r->result) {
            *ior = lum_spectrum_at(&s, LUM_NM_D);
            *out = lum_reader_keep(r, &s);
        }
        return !r->result;
    }
    if (!lum_reader_number(r, "ior", 1, 4, ior))
        return false;
    if (abbe > 0) {
        model = (lum_index_model){LUM_INDEX_ABBE, {*ior, abbe}};
        const double n = *ior;
        from_model(r, &model, ior, out);
        *ior = n;
    }
    return !r->result;
}

/* Everything by wavelength that a diffuse layer is, if anything is. */
static void complete(lum_reader *r, lum_recipe_entry *e)
{
    const lum_spectrum **part[2] = {&e->spectral.reflectance, &e->spectral.transmittance};
    const float *rgb[2] = {e->reflectance, e->transmittance};
    for (int i = 0; i < 2 && !r->result; ++i)
        if (!*part[i]) {
            const double colour[3] = {(double)rgb[i][0], (double)rgb[i][1], (double)rgb[i][2]};
            lum_spectrum s;
            lum_spectrum_of_reflectance(colour, &s);
            *part[i] = lum_reader_keep(r, &s);
        }
}

void lum_recipe_read_layer(lum_reader *in, lum_recipe_entry *e, bool by_wavelength)
{
    const lum_spectrum *r = NULL, *t = NULL;
    if (!lum_reader_reflectance(in, "reflectance", e->reflectance, &r))
        lum_reader_fail(in, "reflectance", "is missing");
    if (!lum_reader_reflectance(in, "transmittance", e->transmittance, &t))
        lum_reader_fail(in, "transmittance", "is missing");
    e->spectral.reflectance = r;
    e->spectral.transmittance = t;
    if (in->result)
        return;
    if (r || t || by_wavelength)
        complete(in, e);
    double peak[2] = {0};
    for (int i = 0; i < 3; ++i) {
        peak[0] = fmax(peak[0], (double)e->reflectance[i]);
        peak[1] = fmax(peak[1], (double)e->transmittance[i]);
    }
    if (e->spectral.reflectance && e->spectral.transmittance) {
        peak[0] = lum_spectrum_peak(e->spectral.reflectance);
        peak[1] = lum_spectrum_peak(e->spectral.transmittance);
    }
    /* The rounding of two floats to decimal and back. */
    if (peak[0] + peak[1] > 1 + 0x1p-22)
        lum_reader_fail(in, "", "reflectance and transmittance together exceed 1");
    e->through = peak[1] > 0 ? (float)(peak[1] / (peak[0] + peak[1])) : 0;
}

/* More energy than it takes is nothing that a phosphor emits. */
static void check_energy(lum_reader *in, const lum_spectral *s)
{
    double power = 0, moment = 0;
    if (in->result)
        return;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        power += (double)s->converted->value[i];
        moment += (double)s->converted->value[i] * (LUM_NM_FIRST + i);
    }
    const double mean = moment / power, yield = (double)s->quantum_yield;
    const double least = 1e-3 * (s->fills ? lum_spectrum_peak(s->excitation) : 1); /* what is below is the tail of a fit */
    for (int i = 0; i < LUM_SPECTRUM_COUNT && !in->result; ++i)
        if ((double)s->excitation->value[i] > least && yield * (LUM_NM_FIRST + i) > mean)
            lum_reader_fail(in, "absorption",
                            "at %d nm it would emit more energy than it takes: %g photons of %.0f nm on average; end it before %.0f nm",
                            LUM_NM_FIRST + i, yield, mean, mean / yield);
}

/* What converts: absorption, within [0, most]; emission; yield. */
static void read_conversion(lum_reader *in, double most, const char *what, lum_spectral *s)
{
    double yield = 1;
    float rgb[3];
    if (!lum_reader_property(in, "absorption", 0, most, rgb, &s->excitation) || !s->excitation)
        lum_reader_fail(in, "absorption", "needs a spectrum: %s, by wavelength", what);
    if (!lum_reader_light(in, "emission", &s->converted))
        lum_reader_fail(in, "emission", "is missing: the spectrum of the light that the phosphor emits");
    if (!lum_reader_number(in, "quantum_yield", 0, 1, &yield))
        lum_reader_fail(in, "quantum_yield", "is missing: photons emitted per photon absorbed");
    s->quantum_yield = (float)yield;
}

bool lum_recipe_read_filling(lum_reader *r, double most, lum_spectral *s)
{
    lum_reader in;
    if (!lum_reader_open(r, "phosphor", &in))
        return false;
    read_conversion(&in, most, "what the phosphor absorbs, in 1/m", s);
    s->fills = true;
    check_energy(&in, s);
    lum_reader_close(r, &in);
    return !r->result;
}

void lum_recipe_read_phosphor(lum_reader *r, lum_recipe_entry *e)
{
    lum_reader in;
    double forward = 0.5;
    lum_spectral *s = &e->spectral;
    if (!lum_reader_open(r, "phosphor", &in))
        return;
    if (e->finish != LUM_FINISH_NONE)
        lum_reader_fail(&in, "", "the entry says two things about the same surface; split it in two, the later one wins");
    e->finish = LUM_FINISH_PHOSPHOR;
    read_conversion(&in, 1, "the share of the light that the phosphor absorbs", s);
    lum_reader_number(&in, "forward", 0, 1, &forward);
    lum_recipe_read_layer(&in, e, true);
    s->forward = (float)forward;
    check_energy(&in, s);
    lum_reader_close(r, &in);
}
