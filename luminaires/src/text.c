/* SPDX-License-Identifier: Apache-2.0 */
/* Names and messages (text.h).  Plain C strings, no locale. */
#include "text.h"

#include <stdio.h>
#include <string.h>

uint64_t lum_fnv1a(uint64_t hash, const void *bytes, size_t count)
{
    const unsigned char *b = bytes;
    for (size_t i = 0; i < count; i++)
        hash = (hash ^ b[i]) * 0x100000001b3u;
    return hash;
}

static bool is_continuation(char c)
{
    return ((unsigned char)c & 0xc0) == 0x80;
}

/* Length of the UTF-8 character at s, 0 if it isn't one (cut off, overlong lead byte, stray continuation). */
static size_t character(const char *s)
{
    unsigned char c = (unsigned char)*s;
    size_t n = c < 0x80 ? 1 : c >= 0xc2 && c < 0xe0 ? 2 : c >= 0xe0 && c < 0xf0 ? 3 : c >= 0xf0 && c < 0xf5 ? 4 : 0;
    for (size_t i = 1; i < n; i++)
        if (!is_continuation(s[i]))
            return 0;
    return n;
}

void lum_make_one_line(char *s)
{
    while (*s) {
        size_t n = character(s);
        if (n == 0 || (unsigned char)*s < 0x20 || *s == 0x7f) { /* 0x7f is DEL */
            *s++ = '?';
        } else {
            s += n;
        }
    }
}

void lum_copy_name(char out[LUM_NAME_SIZE], const char *name, const char *kind, uint32_t index)
{
    if (!name || !*name) {
        snprintf(out, LUM_NAME_SIZE, "%s %u", kind, index);
        return;
    }
    size_t n = strlen(name);
    if (n >= LUM_NAME_SIZE) {
        n = LUM_NAME_SIZE - 1;
        while (n > 0 && is_continuation(name[n]))
            n--;
    }
    memcpy(out, name, n);
    out[n] = 0;
    lum_make_one_line(out);
}

const char *lum_base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash && slash[1] ? slash + 1 : path;
}

void lum_prefix_error(lmg_error *err, const char *prefix)
{
    if (!err)
        return;
    char text[sizeof err->message + 200]; /* cut at the end when both are long: the place matters more than the remedy */
    snprintf(text, sizeof text, "%.160s: %s", prefix, err->message);
    memcpy(err->message, text, sizeof err->message);
    err->message[sizeof err->message - 1] = 0;
    lum_make_one_line(err->message);
}

bool lum_match(const char *pattern, const char *name)
{
    /* Greedy with one point of return: after a '*' failed, let it swallow one character more. */
    const char *star = NULL, *mark = NULL;
    while (*name) {
        if (*pattern == '*') {
            star = pattern++;
            mark = name;
        } else if (*pattern == *name) {
            pattern++;
            name++;
        } else if (star) {
            pattern = star + 1;
            name = ++mark;
        } else {
            return false;
        }
    }
    while (*pattern == '*')
        pattern++;
    return *pattern == 0;
}

static unsigned lower(char c)
{
    return (unsigned)(c >= 'A' && c <= 'Z' ? c + 32 : c);
}

static uint32_t min3(uint32_t a, uint32_t b, uint32_t c)
{
    uint32_t m = a < b ? a : b;
    return m < c ? m : c;
}

uint32_t lum_edit_distance(const char *a, const char *b)
{
    /* Levenshtein's table, one row at a time.  Names are shorter than LUM_NAME_SIZE; longer patterns are compared by their start.
     */
    uint32_t row[LUM_NAME_SIZE];
    size_t n = strnlen(b, LUM_NAME_SIZE - 1);
    for (size_t j = 0; j <= n; j++)
        row[j] = (uint32_t)j;
    for (size_t i = 0; a[i]; i++) {
        uint32_t diagonal = row[0];
        row[0] = (uint32_t)i + 1;
        for (size_t j = 0; j < n; j++) {
            uint32_t next = min3(row[j + 1] + 1, row[j] + 1, diagonal + (lower(a[i]) != lower(b[j])));
            diagonal = row[j + 1];
            row[j + 1] = next;
        }
    }
    return row[n];
}
