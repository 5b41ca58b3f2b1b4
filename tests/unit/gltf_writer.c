/* SPDX-License-Identifier: Apache-2.0 */
/* Writing small glTF files (gltf_writer.h).  Relies on nothing of the loader. */
#include "gltf_writer.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <cmocka.h>

static char folder[512];

void gltf_folder(const char *name)
{
    snprintf(folder, sizeof folder, "%s/%s", LUMIBOX_BINARY_DIR, name);
    mkdir(folder, 0777);
}

const char *gltf_path(const char *file)
{
    static char paths[4][1024];
    static int next;
    char *path = paths[next++ % 4];
    snprintf(path, sizeof paths[0], "%s/%s", folder, file);
    return path;
}

void gltf_write(const char *file, const void *bytes, size_t size)
{
    FILE *f = fopen(gltf_path(file), "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(bytes, 1, size, f), size);
    assert_int_equal(fclose(f), 0);
}

char *gltf_data_uri(const void *bytes, size_t size)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    static const char head[] = "data:application/octet-stream;base64,";
    const unsigned char *b = bytes;
    char *text = malloc(sizeof head + (size + 2) / 3 * 4);
    assert_non_null(text);
    strcpy(text, head);
    char *out = text + sizeof head - 1;
    for (size_t i = 0; i < size; i += 3) {
        unsigned v = (unsigned)b[i] << 16 | (i + 1 < size ? (unsigned)b[i + 1] << 8 : 0) | (i + 2 < size ? b[i + 2] : 0u);
        *out++ = digits[v >> 18];
        *out++ = digits[v >> 12 & 63];
        *out++ = i + 1 < size ? digits[v >> 6 & 63] : '=';
        *out++ = i + 2 < size ? digits[v & 63] : '=';
    }
    *out = 0;
    return text;
}

char *gltf_text(const char *format, ...)
{
    va_list args;
    va_start(args, format);
    int n = vsnprintf(NULL, 0, format, args);
    va_end(args);
    assert_true(n >= 0);
    char *text = malloc((size_t)n + 1);
    assert_non_null(text);
    va_start(args, format);
    vsnprintf(text, (size_t)n + 1, format, args);
    va_end(args);
    return text;
}

/* ----------------------------------------------------------------------------------------------------------------- PNG */

static void put32(unsigned char *p, unsigned v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (unsigned char)(v >> (24 - 8 * i));
}

static unsigned crc32_of(const unsigned char *p, size_t n)
{
    unsigned c = 0xffffffffu;
    for (size_t i = 0; i < n; i++) {
        c ^= p[i];
        for (int k = 0; k < 8; k++)
            c = c & 1 ? 0xedb88320u ^ c >> 1 : c >> 1;
    }
    return ~c;
}

static unsigned char *chunk(unsigned char *out, const char *type, const unsigned char *data, size_t n)
{
    put32(out, (unsigned)n);
    memcpy(out + 4, type, 4);
    if (n)
        memcpy(out + 8, data, n);
    put32(out + 8 + n, crc32_of(out + 4, n + 4));
    return out + 12 + n;
}

unsigned char *gltf_png(const unsigned char *rgba, unsigned width, unsigned height, size_t *size)
{
    size_t row = 4 * (size_t)width + 1, raw = row * height;
    assert_true(raw < 65536); /* one stored block */
    unsigned char *z = malloc(raw + 11), *png = malloc(raw + 128);
    assert_non_null(z);
    assert_non_null(png);
    unsigned a = 1, b = 0;
    memcpy(z, "\x78\x01\x01", 3);
    z[3] = (unsigned char)raw;
    z[4] = (unsigned char)(raw >> 8);
    z[5] = (unsigned char)~z[3];
    z[6] = (unsigned char)~z[4];
    for (unsigned y = 0; y < height; y++) {
        z[7 + y * row] = 0; /* no filter */
        memcpy(z + 8 + y * row, rgba + 4 * (size_t)width * y, row - 1);
    }
    for (size_t i = 0; i < raw; i++) {
        a = (a + z[7 + i]) % 65521;
        b = (b + a) % 65521;
    }
    put32(z + 7 + raw, b << 16 | a);
    unsigned char header[13] = {0}, *out = png + 8;
    memcpy(png, "\x89PNG\r\n\x1a\n", 8);
    put32(header, width);
    put32(header + 4, height);
    header[8] = 8; /* bits */
    header[9] = 6; /* R,G,B,A */
    out = chunk(out, "IHDR", header, sizeof header);
    out = chunk(out, "IDAT", z, raw + 11);
    out = chunk(out, "IEND", NULL, 0);
    free(z);
    *size = (size_t)(out - png);
    return png;
}

/* ----------------------------------------------------------------------------------------------------------------- GLB */

static void put32_little(unsigned char *p, size_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (unsigned char)(v >> (8 * i));
}

unsigned char *gltf_glb(const char *json, const void *bin, size_t bin_size, size_t *size)
{
    size_t n = (strlen(json) + 3) / 4 * 4, m = (bin_size + 3) / 4 * 4;
    *size = 20 + n + (bin ? 8 + m : 0);
    unsigned char *glb = calloc(1, *size + 1);
    assert_non_null(glb);
    memcpy(glb, "glTF", 4);
    put32_little(glb + 4, 2);
    put32_little(glb + 8, *size);
    put32_little(glb + 12, n);
    memcpy(glb + 16, "JSON", 4);
    memset(glb + 20, ' ', n);
    memcpy(glb + 20, json, strlen(json));
    if (bin) {
        put32_little(glb + 20 + n, m);
        memcpy(glb + 24 + n, "BIN", 4);
        memcpy(glb + 28 + n, bin, bin_size);
    }
    return glb;
}

/* ------------------------------------------------------------------------------------------------------------- loading */

lum_model *gltf_load(const char *file, const char *json, const lum_recipe *recipe)
{
    lmg_error err = {{0}};
    lum_model *model = NULL;
    gltf_write(file, json, strlen(json));
    if (lum_model_load(gltf_path(file), recipe, &model, &err))
        fail_msg("%s", err.message);
    return model;
}

const char *gltf_refuse(const char *file, const char *json, const lum_recipe *recipe, lmg_result expected)
{
    static lmg_error err;
    lum_model *model = (lum_model *)&err; /* must become NULL */
    memset(&err, 0, sizeof err);
    gltf_write(file, json, strlen(json));
    lmg_result result = lum_model_load(gltf_path(file), recipe, &model, &err);
    assert_null(model);
    if (result != expected)
        fail_msg("result %d, expected %d: %s", result, expected, err.message);
    assert_null(strchr(err.message, '\n'));
    assert_non_null(strstr(err.message, file));
    return err.message;
}

bool gltf_warned(const lum_model *model, const char *text)
{
    for (uint32_t i = 0; i < model->warning_count; i++)
        if (strstr(model->warnings[i], text))
            return true;
    return false;
}
