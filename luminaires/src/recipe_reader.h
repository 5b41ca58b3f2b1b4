/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reading the objects of a recipe key by key, for the files that know what the keys mean.  Getters remove what they have read, so that
 * what is left at the end is unknown, and an error; messages give the key's path.  After the first error getters do nothing.
 */
#ifndef LUMINAIRES_RECIPE_READER_H
#define LUMINAIRES_RECIPE_READER_H

#include <luminaires/model.h>

#include <jansson.h>

/* One object being read. */
typedef struct lum_reader {
    json_t *object;
    struct lum_recipe *recipe; /* that owns the spectra which are read, and knows where files are */
    char path[LUM_NAME_SIZE];
    lmg_error *err;
    lmg_result result; /* the first error; later getters do nothing */
} lum_reader;

/* Makes it an error, of which the place is the reader's path and the key ("" = the object itself). */
void lum_reader_fail(lum_reader *r, const char *key, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;

/* The value of a key, for the caller to release; NULL when absent or after an error. */
json_t *lum_reader_take(lum_reader *r, const char *key);

/* Whether a value is a number within [low, high]; else an error. */
bool lum_reader_in_range(lum_reader *r, const char *key, const json_t *value, double low, double high, double *out);

/* Getters: whether the key is there and its value right; *out stays as it is otherwise. */
bool lum_reader_number(lum_reader *r, const char *key, double low, double high, double *out);
bool lum_reader_bool(lum_reader *r, const char *key, bool *out);
/* A number for all of R,G,B, or three of them. */
bool lum_reader_rgb(lum_reader *r, const char *key, double low, double high, double out[3]);
bool lum_reader_rgb_float(lum_reader *r, const char *key, double low, double high, float out[3]);
/* A string that must fit a name. */
bool lum_reader_string(lum_reader *r, const char *key, char out[LUM_NAME_SIZE]);
/* The place of the key's value among the choices; `otherwise` when absent. */
int lum_reader_choice(lum_reader *r, const char *key, const char *const *choices, int count, const char *list, int otherwise);

/* Opens the object of a key for reading; false when absent.  To be closed by lum_reader_close, which refuses what nobody has read. */
bool lum_reader_open(lum_reader *r, const char *key, lum_reader *inner);
void lum_reader_close(lum_reader *r, lum_reader *inner);
/* Refuses what nobody has read. */
void lum_reader_check_rest(lum_reader *r);

#endif
