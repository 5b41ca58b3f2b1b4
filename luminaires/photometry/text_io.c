/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Text of photometric files, in and out (photometry_file.h).  Files come from four decades: UTF-8, Latin-1, byte order marks,
 * carriage returns of all kinds.  Numbers are read and written in the C locale.
 */
#include "photometry_file.h"

#include "text.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* ------------------------------------------------------------------------------------------------------------- reading */

static bool is_utf8(const uint8_t *b, size_t size)
{
    for (size_t i = 0; i < size;) {
        const uint8_t c = b[i];
        const size_t n = c < 0x80 ? 1 : c >= 0xc2 && c < 0xe0 ? 2 : c >= 0xe0 && c < 0xf0 ? 3 : c >= 0xf0 && c < 0xf5 ? 4 : 0;
        if (n == 0 || n > size - i)
            return false;
        for (size_t k = 1; k < n; k++)
            if ((b[i + k] & 0xc0) != 0x80)
                return false;
        i += n;
    }
    return true;
}

lmg_result lum_text_decode(const uint8_t *bytes, size_t size, char **text, lmg_error *err)
{
    *text = NULL;
    if (size >= 3 && bytes[0] == 0xef && bytes[1] == 0xbb && bytes[2] == 0xbf) {
        bytes += 3;
        size -= 3;
    }
    if (memchr(bytes, 0, size))
        return lmg_fail(err, LMG_ERROR_INPUT, "is not a text file (it holds NUL bytes)");
    const bool utf8 = is_utf8(bytes, size);
    char *out = malloc(2 * size + 1); /* a Latin-1 byte becomes at most two */
    if (!out)
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a text of %zu bytes", size);
    size_t n = 0;
    for (size_t i = 0; i < size; i++) {
        const uint8_t c = bytes[i];
        if (c == '\r') { /* CR LF, and the CR of old Macintoshes */
            if (i + 1 < size && bytes[i + 1] == '\n')
                continue;
            out[n++] = '\n';
        } else if (c < 0x80 || utf8) {
            out[n++] = (char)c;
        } else {
            out[n++] = (char)(0xc0 | c >> 6);
            out[n++] = (char)(0x80 | (c & 0x3f));
        }
    }
    out[n] = 0;
    *text = out;
    return LMG_OK;
}

bool lum_parse_number(const char *text, size_t length, double *value)
{
    char buffer[64];
    if (length == 0 || length >= sizeof buffer)
        return false;
    for (size_t i = 0; i < length; i++) {
        const char c = text[i];
        if (!((c >= '0' && c <= '9') || c == '+' || c == '-' || c == '.' || c == 'e' || c == 'E' || c == 'd' || c == 'D'))
            return false;
        buffer[i] = c == 'd' || c == 'D' ? 'e' : c; /* Fortran's exponent */
    }
    buffer[length] = 0;
    char *end;
    *value = strtod(buffer, &end);
    return end == buffer + length && isfinite(*value);
}

static void join(char *text, size_t size, const char *format, va_list args)
{
    const size_t used = strlen(text);
    if (used + 3 >= size)
        return;
    if (used)
        memcpy(text + used, "; ", 3);
    const size_t from = strlen(text);
    vsnprintf(text + from, size - from, format, args);
    lum_make_one_line(text);
}

void lum_photometry_warn(lum_photometry *p, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    join(p->warnings, sizeof p->warnings, format, args);
    va_end(args);
}

void lum_note_loss(char loss[512], const char *format, ...)
{
    va_list args;
    va_start(args, format);
    join(loss, 512, format, args);
    va_end(args);
}

/* ------------------------------------------------------------------------------------------------------------- writing */

void lum_output_add(lum_output *o, const char *bytes, size_t count)
{
    if (o->failed)
        return;
    if (count >= o->capacity - o->size) { /* keep a place for the NUL */
        const size_t capacity = 2 * (o->size + count) + 256;
        char *text = realloc(o->text, capacity);
        if (!text) {
            o->failed = true;
            return;
        }
        o->text = text;
        o->capacity = capacity;
    }
    memcpy(o->text + o->size, bytes, count);
    o->size += count;
    o->text[o->size] = 0;
}

void lum_output_print(lum_output *o, const char *format, ...)
{
    char buffer[512];
    va_list args;
    va_start(args, format);
    const int n = vsnprintf(buffer, sizeof buffer, format, args);
    va_end(args);
    if (n >= 0)
        lum_output_add(o, buffer, (size_t)n < sizeof buffer ? (size_t)n : sizeof buffer - 1);
}

void lum_format_number(char out[32], double value)
{
    for (int digits = 1; digits <= 9; digits++) {
        snprintf(out, 32, "%.*g", digits, value);
        if (fabs(strtod(out, NULL) - value) <= 1e-9 * fabs(value))
            break;
    }
    double whole;
    if (strchr(out, 'e') && modf(value, &whole) == 0 && fabs(value) < 1e9)
        snprintf(out, 32, "%.0f", value); /* 100, not 1e+02: some readers don't know exponents */
}

void lum_output_latin1(lum_output *o, const char *utf8, size_t length)
{
    for (size_t i = 0; i < length;) {
        const unsigned char c = (unsigned char)utf8[i++];
        char b = '?';
        if (c >= 0x20 && c < 0x7f)
            b = (char)c;
        else if ((c == 0xc2 || c == 0xc3) && i < length)
            b = (char)((c & 3) << 6 | ((unsigned char)utf8[i] & 0x3f));
        while (i < length && ((unsigned char)utf8[i] & 0xc0) == 0x80)
            i++;
        lum_output_add(o, &b, 1);
    }
}

lmg_result lum_write_whole_file(const char *path, const void *bytes, size_t size, lmg_error *err)
{
    const char *name = lum_base_name(path);
    const size_t length = strlen(path) + 32;
    char *temporary = malloc(length);
    if (!temporary)
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory to write %.200s", path);
    snprintf(temporary, length, "%.*s.%s.%ld.tmp", (int)(name - path), path, name, (long)getpid());
    const int fd = open(temporary, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    lmg_result result = LMG_OK;
    if (fd < 0) {
        result = lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.200s: can't be created: %s", path, strerror(errno));
        free(temporary);
        return result;
    }
    for (size_t done = 0; done < size && result == LMG_OK;) {
        const ssize_t n = write(fd, (const char *)bytes + done, size - done);
        if (n >= 0)
            done += (size_t)n;
        else if (errno != EINTR)
            result = lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.200s: can't be written: %s", path, strerror(errno));
    }
    if (close(fd) != 0 && result == LMG_OK)
        result = lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.200s: can't be written: %s", path, strerror(errno));
    if (result == LMG_OK && rename(temporary, path) != 0)
        result = lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.200s: can't be replaced: %s", path, strerror(errno));
    if (result != LMG_OK)
        unlink(temporary);
    free(temporary);
    return result;
}

void lum_document_date(const lum_photometry_write_options *options, char out[32])
{
    if (options->date) {
        snprintf(out, 32, "%s", options->date);
        return;
    }
    const time_t now = time(NULL);
    struct tm utc;
    if (!gmtime_r(&now, &utc) || strftime(out, 32, "%Y-%m-%d", &utc) == 0)
        out[0] = 0;
}
