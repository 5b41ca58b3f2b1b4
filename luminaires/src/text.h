/* SPDX-License-Identifier: Apache-2.0 */
/* Names and messages: what comes from files is cut to size and kept on one line before it reaches a message. */
#ifndef LUMINAIRES_TEXT_H
#define LUMINAIRES_TEXT_H

#include <luminaires/model.h>

/* Returns a failure of expr to the caller. */
#define LUM_TRY(expr)                                                                                                              \
    do {                                                                                                                           \
        lmg_result lum_try_result = (expr);                                                                                        \
        if (lum_try_result)                                                                                                        \
            return lum_try_result;                                                                                                 \
    } while (0)

/* FNV-1a 64 over bytes, continued from hash. */
#define LUM_HASH_START 0xcbf29ce484222325u
uint64_t lum_fnv1a(uint64_t hash, const void *bytes, size_t count);

/* Copies a name: at most LUM_NAME_SIZE - 1 bytes, cut between UTF-8 characters, control characters replaced by '?'.  When name is
 * NULL or empty: "<kind> <index>". */
void lum_copy_name(char out[LUM_NAME_SIZE], const char *name, const char *kind, uint32_t index);

/* The last part of a path. */
const char *lum_base_name(const char *path);

/* Replaces control characters, which would break messages into lines, and bytes that aren't UTF-8 (names cut to size) by '?'. */
void lum_make_one_line(char *s);

/* Puts "prefix: " before err's message and makes sure that the whole is one line. */
void lum_prefix_error(lmg_error *err, const char *prefix);

/* Whether name matches pattern, where '*' stands for any characters; case matters. */
bool lum_match(const char *pattern, const char *name);

/* Number of single-character edits that turn a into b, ignoring case; for "did you mean". */
uint32_t lum_edit_distance(const char *a, const char *b);

#endif
