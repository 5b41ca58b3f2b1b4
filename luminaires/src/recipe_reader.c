/* SPDX-License-Identifier: Apache-2.0 */
/* Reading the objects of a recipe key by key; see recipe_reader.h. */
#include "recipe_reader.h"

#include "text.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

void lum_reader_fail(lum_reader *r, const char *key, const char *format, ...)
{
    if (r->result)
        return;
    char text[300];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    r->result = lmg_fail(r->err, LMG_ERROR_INPUT, "%s%s%s%s%s", r->path, *r->path && *key ? "." : "", key, *r->path || *key ? ": " : "", text);
}

/* The value of a key, for the caller to release; NULL when absent or after an error. */
json_t *lum_reader_take(lum_reader *r, const char *key)
{
    json_t *value = r->result ? NULL : json_object_get(r->object, key);
    if (value) {
        json_incref(value);
        json_object_del(r->object, key);
    }
    return value;
}

bool lum_reader_in_range(lum_reader *r, const char *key, const json_t *value, double low, double high, double *out)
{
    if (!json_is_number(value)) {
        lum_reader_fail(r, key, "must be a number");
        return false;
    }
    double x = json_number_value(value);
    if (!(x >= low && x <= high)) {
        lum_reader_fail(r, key, "%g is outside [%g, %g]", x, low, high);
        return false;
    }
    *out = x;
    return true;
}

bool lum_reader_number(lum_reader *r, const char *key, double low, double high, double *out)
{
    json_t *value = lum_reader_take(r, key);
    if (!value)
        return false;
    bool ok = lum_reader_in_range(r, key, value, low, high, out);
    json_decref(value);
    return ok;
}

bool lum_reader_bool(lum_reader *r, const char *key, bool *out)
{
    json_t *value = lum_reader_take(r, key);
    if (!value)
        return false;
    bool ok = json_is_boolean(value);
    if (ok)
        *out = json_is_true(value);
    else
        lum_reader_fail(r, key, "must be true or false");
    json_decref(value);
    return ok;
}

/* A number for all of R,G,B, or three of them. */
bool lum_reader_rgb(lum_reader *r, const char *key, double low, double high, double out[3])
{
    json_t *value = lum_reader_take(r, key);
    if (!value)
        return false;
    bool ok = true;
    if (json_is_array(value) && json_array_size(value) == 3) {
        for (size_t i = 0; i < 3 && ok; i++)
            ok = lum_reader_in_range(r, key, json_array_get(value, i), low, high, &out[i]);
    } else if (json_is_number(value)) {
        ok = lum_reader_in_range(r, key, value, low, high, &out[0]);
        out[1] = out[2] = out[0];
    } else {
        ok = false;
        lum_reader_fail(r, key, "must be a number or three, [R, G, B]");
    }
    json_decref(value);
    return ok;
}

bool lum_reader_rgb_float(lum_reader *r, const char *key, double low, double high, float out[3])
{
    double values[3];
    if (!lum_reader_rgb(r, key, low, high, values))
        return false;
    for (int i = 0; i < 3; i++)
        out[i] = (float)values[i];
    return true;
}

/* Copies a string that must fit a name. */
bool lum_reader_string(lum_reader *r, const char *key, char out[LUM_NAME_SIZE])
{
    json_t *value = lum_reader_take(r, key);
    if (!value)
        return false;
    const char *s = json_string_value(value);
    bool ok = s && *s && strlen(s) < LUM_NAME_SIZE;
    if (ok)
        lum_copy_name(out, s, "", 0);
    else
        lum_reader_fail(r, key, s ? "must have 1 to %d characters" : "must be a string", LUM_NAME_SIZE - 1);
    json_decref(value);
    return ok;
}

int lum_reader_choice(lum_reader *r, const char *key, const char *const *choices, int count, const char *list, int otherwise)
{
    char name[LUM_NAME_SIZE];
    if (!lum_reader_string(r, key, name))
        return otherwise;
    for (int i = 0; i < count; i++)
        if (strcmp(name, choices[i]) == 0)
            return i;
    lum_reader_fail(r, key, "\"%.40s\" is not one of %s", name, list);
    return otherwise;
}

/* Opens the object of a key for reading; false when absent. */
bool lum_reader_open(lum_reader *r, const char *key, lum_reader *inner)
{
    json_t *value = lum_reader_take(r, key);
    if (!value)
        return false;
    if (!json_is_object(value)) {
        lum_reader_fail(r, key, "must be an object");
        json_decref(value);
        return false;
    }
    *inner = (lum_reader){.object = value, .recipe = r->recipe, .err = r->err};
    snprintf(inner->path, sizeof inner->path, "%.100s%s%.20s", r->path, *r->path ? "." : "", key);
    return true;
}

/* Refuses what nobody has read. */
void lum_reader_check_rest(lum_reader *r)
{
    json_decref(lum_reader_take(r, "comment"));
    const char *key;
    json_t *value;
    if (r->result)
        return;
    json_object_foreach(r->object, key, value) lum_reader_fail(r, "", "unknown key \"%.60s\"; see docs/recipe.md", key);
}

void lum_reader_close(lum_reader *r, lum_reader *inner)
{
    lum_reader_check_rest(inner);
    json_decref(inner->object);
    if (!r->result)
        r->result = inner->result;
}
