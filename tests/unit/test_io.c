/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Box files: what is written comes back to the last bit, the same field gives the same bytes, nothing that was cut, altered or made up
 * is believed, and a write that fails leaves what was there.  Under the sanitizers these tests are also the proof that hostile files
 * don't reach memory they shouldn't.
 */
#include "box_fixture.h"
#include "exr_check.h"
#include "field.h"
#include "exr_write.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

typedef struct state {
    char directory[256];
    char path[512];
} state;

static int set_up(void **out)
{
    state *s = calloc(1, sizeof *s);
    fixture_directory(s->directory);
    snprintf(s->path, sizeof s->path, "%s/a.box.exr", s->directory);
    *out = s;
    return 0;
}

static int tear_down(void **in)
{
    state *s = *in;
    fixture_remove_directory(s->directory);
    free(s);
    return 0;
}

static void write_ok(const lmg_field *field, const char *path)
{
    lmg_error error = {.message = ""};
    if (lmg_field_write(field, path, &error) != LMG_OK) {
        fail_msg("%s", error.message);
    }
}

static lmg_field *read_ok(const char *path)
{
    lmg_error error = {.message = ""};
    lmg_field *field = NULL;
    if (lmg_field_read(path, &field, &error) != LMG_OK) {
        fail_msg("%s", error.message);
    }
    assert_non_null(field);
    return field;
}

static void assert_same(const lmg_field *a, const lmg_field *b)
{
    const char *difference = fixture_difference(a, b);
    if (difference != NULL) {
        fail_msg("fields differ: %s", difference);
    }
}

/* One line, not empty, that begins with the file's name. */
static void assert_message(const lmg_error *error, const char *name)
{
    assert_true(strlen(error->message) > strlen(name) + 2);
    assert_memory_equal(error->message, name, strlen(name));
    for (const char *p = error->message; *p != 0; p++) {
        assert_true((unsigned char)*p >= 0x20);
    }
}

static bool is_file_error(lmg_result result)
{
    return result == LMG_ERROR_FILE_READ || result == LMG_ERROR_FILE_FORMAT || result == LMG_ERROR_FILE_VERSION;
}

/* ------------------------------------------------------------------------------------------------------------ round trip */

static void test_round_trip(void **in)
{
    const state *s = *in;
    uint64_t seed = 1;
    for (uint32_t slabs = 1; slabs <= 8; slabs++) {
        for (int aperture = 0; aperture < 2; aperture++) {
            for (uint32_t channels = 1; channels <= 3; channels += 2) {
                lmg_field *field = fixture_field(slabs, aperture == 1, channels, seed++);
                write_ok(field, s->path);
                lmg_field *back = read_ok(s->path);
                assert_same(field, back);
                lmg_field_destroy(back);
                lmg_field_destroy(field);
            }
        }
    }
}

static void test_compressions(void **in)
{
    const state *s = *in;
    static const lmg_exr_compression all[] = {LMG_EXR_NONE, LMG_EXR_ZIPS, LMG_EXR_ZIP};
    for (uint32_t channels = 1; channels <= 3; channels += 2) {
        lmg_field *field = fixture_photon_field(2, 5, 3, 17, 11, channels, 7);
        size_t sizes[3];
        for (size_t i = 0; i < 3; i++) {
            lmg_error error = {.message = ""};
            assert_int_equal(lmg_field_write_as(field, s->path, all[i], 4, &error), LMG_OK);
            free(fixture_load(s->path, &sizes[i]));
            lmg_field *back = read_ok(s->path);
            assert_same(field, back);
            lmg_field_destroy(back);
        }
        assert_true(sizes[2] < sizes[0] && sizes[1] == sizes[2]);
        lmg_field_destroy(field);
    }
}

/* As many slabs as there can be, each across all those before it: what a made-up file may hold, in a time that its cells don't multiply. */
static void test_overlapping_slabs(void **in)
{
    const state *s = *in;
    lmg_layout l = {.slab_count = LMG_MAX_SLABS, .channels = 1, .colour = {1, 1, 1}, .bounds_min = {-1, -1, -1}, .bounds_max = {1, 1, 1}, .size = 1};
    for (uint32_t k = 0; k < LMG_MAX_SLABS; k++) {
        const double c = cos(0.02 * k), d = sin(0.02 * k);
        l.slabs[k] = (lmg_slab){.kind = LMG_SLAB_APERTURE, .distance = INFINITY, .o = {0.01 * k, 0.5 + 0.01 * k, 0}, .a = {c, -d, 0}, .b = {0, 0, -1},
                                .n = {d, c, 0}, .u0 = -1.5, .u1 = 1.5, .v0 = -1.5, .v1 = 1.5, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1,
                                .nu = 3, .nv = 3, .ns = 4, .nt = 4};
    }
    lmg_field *field = NULL;
    assert_int_equal(lmg_field_allocate(&l, &field, NULL), LMG_OK);
    for (uint32_t k = 0; k < LMG_MAX_SLABS; k++)
        for (uint64_t cell = 0; cell < field->slabs[k].cells; cell++) {
            *lmg_cell_radiance(&field->slabs[k], cell) = (float)(1 + cell % 5);
            field->slabs[k].standard_error[cell] = 0.1f;
        }
    assert_int_equal(lmg_field_prepare(field, NULL), LMG_OK);
    write_ok(field, s->path);
    lmg_field *back = read_ok(s->path);
    assert_same(field, back);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
}

static void test_dark_field(void **in)
{
    const state *s = *in;
    lmg_field *field = fixture_field(2, true, 3, 5);
    for (uint32_t i = 0; i < 2; i++) {
        lmg_slab_data *d = &field->slabs[i];
        memset(d->cell, 0, d->cells * d->stride * sizeof(float));
        memset(d->standard_error, 0, d->cells * sizeof(float));
        memset(d->half_a, 0, d->cells * sizeof(float));
    }
    lmg_error error = {.message = ""};
    assert_int_equal(lmg_field_prepare(field, &error), LMG_OK);
    write_ok(field, s->path);
    lmg_field *back = read_ok(s->path);
    assert_same(field, back);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
}

static void test_same_bytes(void **in)
{
    const state *s = *in;
    lmg_field *field = fixture_photon_field(6, 9, 8, 7, 6, 3, 3); /* several pieces of work, so that threads race */
    write_ok(field, s->path);
    size_t size, again_size;
    unsigned char *bytes = fixture_load(s->path, &size);
    char other[600];
    snprintf(other, sizeof other, "%s/another name", s->directory);
    struct timespec wait = {.tv_nsec = 20000000};
    nanosleep(&wait, NULL);
    for (int i = 0; i < 5; i++) {
        write_ok(field, other);
        unsigned char *again = fixture_load(other, &again_size);
        assert_int_equal(size, again_size);
        assert_memory_equal(bytes, again, size);
        free(again);
    }
    lmg_field *back = read_ok(s->path); /* and through a reading */
    write_ok(back, other);
    unsigned char *again = fixture_load(other, &again_size);
    assert_int_equal(size, again_size);
    assert_memory_equal(bytes, again, size);
    free(again);
    free(bytes);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
}

static void test_names(void **in)
{
    const state *s = *in;
    char longest[256];
    memset(longest, 'x', 255);
    memcpy(longest + 255 - strlen(".box.exr"), ".box.exr", strlen(".box.exr") + 1);
    const char *names[] = {"with spaces in it.box.exr", "\xc3\xa9t\xc3\xa9 \xe6\xb6\xa6.box.exr", "%s%n.exr", "-o", longest};
    lmg_field *field = fixture_field(2, false, 1, 9);
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        char path[600];
        snprintf(path, sizeof path, "%s/%s", s->directory, names[i]);
        write_ok(field, path);
        lmg_field *back = read_ok(path);
        assert_same(field, back);
        lmg_field_destroy(back);
    }
    /* a text whose attribute needs EXR's long names */
    lmg_error error = {.message = ""};
    assert_int_equal(lmg_field_set_text(field, "a.text-with_a_name_of_63_characters_which_is_as_long_as_it_gets", "v", &error), LMG_OK);
    write_ok(field, s->path);
    lmg_field *back = read_ok(s->path);
    assert_same(field, back);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
}

/* ---------------------------------------------------------------------------------------------------------- damaged files */

static unsigned char *small_box(const state *s, uint32_t slabs, lmg_field **field, size_t *size)
{
    *field = fixture_field(slabs, true, slabs == 1 ? 1 : 3, 11);
    write_ok(*field, s->path);
    return fixture_load(s->path, size);
}

static void test_truncated(void **in)
{
    const state *s = *in;
    for (uint32_t slabs = 1; slabs <= 2; slabs++) {
        lmg_field *field;
        size_t size;
        unsigned char *bytes = small_box(s, slabs, &field, &size);
        for (size_t length = 0; length < size; length++) {
            unsigned char *cut = malloc(length + 1); /* a block of its own, so that reading past it is seen */
            memcpy(cut, bytes, length);
            unsigned char *exact = realloc(cut, length > 0 ? length : 1);
            lmg_field *out = field;
            lmg_error error = {.message = ""};
            const lmg_result result = lmg_field_read_memory(exact, length, "cut.exr", &out, &error);
            if (result != LMG_ERROR_FILE_READ) {
                fail_msg("%zu of %zu bytes: result %d, %s", length, size, (int)result, error.message);
            }
            assert_null(out);
            assert_message(&error, "cut.exr: ");
            free(exact);
        }
        /* and from files, at a few lengths */
        for (size_t length = 0; length < size; length += 97) {
            assert_int_equal(truncate(s->path, (off_t)(size - 1 - length)), 0);
            lmg_field *out = field;
            lmg_error error = {.message = ""};
            assert_int_equal(lmg_field_read(s->path, &out, &error), LMG_ERROR_FILE_READ);
            assert_null(out);
            assert_message(&error, s->path);
        }
        free(bytes);
        lmg_field_destroy(field);
    }
}

/* Either what was written or one clear error. */
static bool judge(const unsigned char *bytes, size_t size, const lmg_field *original, const char *how)
{
    lmg_field *out = NULL;
    lmg_error error = {.message = ""};
    const lmg_result result = lmg_field_read_memory(bytes, size, "altered.exr", &out, &error);
    if (result == LMG_OK) {
        const char *difference = fixture_difference(original, out);
        if (difference != NULL) {
            fail_msg("%s: accepted, but it differs: %s", how, difference);
        }
        lmg_field_destroy(out);
        return true;
    }
    if (!is_file_error(result)) {
        fail_msg("%s: result %d, %s", how, (int)result, error.message);
    }
    assert_null(out);
    assert_message(&error, "altered.exr: ");
    return false;
}

static void test_bit_flips(void **in)
{
    const state *s = *in;
    for (uint32_t slabs = 1; slabs <= 2; slabs++) {
        lmg_field *field;
        size_t size, accepted = 0;
        unsigned char *bytes = small_box(s, slabs, &field, &size);
        assert_true(judge(bytes, size, field, "unaltered"));
        for (size_t i = 0; i < size; i++) {
            for (int bit = 0; bit < 8; bit++) {
                char how[64];
                snprintf(how, sizeof how, "byte %zu, bit %d", i, bit);
                bytes[i] ^= (unsigned char)(1 << bit);
                accepted += judge(bytes, size, field, how);
                bytes[i] ^= (unsigned char)(1 << bit);
            }
        }
        /* What may change unseen: the display window, attributes that a reader ignores and their names, spare bits of compressed data. */
        if (accepted > 8 * size / 20) {
            fail_msg("%zu of %zu flips were accepted", accepted, 8 * size);
        }
        free(bytes);
        lmg_field_destroy(field);
    }
}

static uint64_t random_next(uint64_t *x)
{
    *x ^= *x << 13;
    *x ^= *x >> 7;
    *x ^= *x << 17;
    return *x;
}

static void test_mutations(void **in)
{
    const state *s = *in;
    static const uint32_t telling[] = {0, 1, 0x7fffffff, 0x80000000, 0xffffffff, 0x40000000, 65535, 65536, 0x3fffffff, 0x7f800000};
    uint64_t random = 20261122;
    for (uint32_t slabs = 1; slabs <= 2; slabs++) {
        lmg_field *field;
        size_t size;
        unsigned char *bytes = small_box(s, slabs, &field, &size), *altered = malloc(size);
        const size_t header = 2400 * slabs; /* about: where most of the structure is */
        for (int round = 0; round < 10000; round++) {
            memcpy(altered, bytes, size);
            const uint64_t count = 1 + random_next(&random) % 4;
            for (uint64_t i = 0; i < count; i++) {
                const size_t range = random_next(&random) % 2 == 0 && header < size ? header : size;
                const size_t at = (size_t)(random_next(&random) % range);
                switch (random_next(&random) % 5) {
                case 0: /* a byte */
                    altered[at] = (unsigned char)random_next(&random);
                    break;
                case 1: { /* a number that sizes are likely to stumble over */
                    const uint32_t value = telling[random_next(&random) % (sizeof telling / sizeof telling[0])];
                    memcpy(altered + at, &value, size - at < 4 ? size - at : 4);
                    break;
                }
                case 2: { /* a piece from elsewhere */
                    const size_t from = (size_t)(random_next(&random) % size), length = (size_t)(random_next(&random) % 64);
                    const size_t fits = size - (at > from ? at : from);
                    memmove(altered + at, altered + from, length < fits ? length : fits);
                    break;
                }
                case 3: /* zeros */
                    memset(altered + at, 0, size - at < 16 ? size - at : 16);
                    break;
                default: { /* noise */
                    for (size_t k = at; k < size && k < at + 8; k++) {
                        altered[k] = (unsigned char)random_next(&random);
                    }
                }
                }
            }
            char how[64];
            snprintf(how, sizeof how, "%u slabs, round %d", slabs, round);
            const size_t length = random_next(&random) % 8 == 0 ? (size_t)(random_next(&random) % size) : size;
            judge(altered, length, field, how);
        }
        free(altered);
        free(bytes);
        lmg_field_destroy(field);
    }
}

/* The value of an attribute in a file's bytes (of the first part that has it), and where its size stands. */
static unsigned char *find_attribute(unsigned char *bytes, size_t size, const char *name, const char *type, unsigned char **length)
{
    char key[128];
    const size_t name_length = strlen(name), key_length = name_length + strlen(type) + 2;
    memcpy(key, name, name_length + 1);
    memcpy(key + name_length + 1, type, strlen(type) + 1);
    for (size_t i = 8; i + key_length + 4 < size; i++) {
        if (memcmp(bytes + i, key, key_length) == 0) {
            if (length != NULL) {
                *length = bytes + i + key_length;
            }
            return bytes + i + key_length + 4;
        }
    }
    fail_msg("no attribute %s", name);
    return NULL;
}

static void put_u32(unsigned char *to, uint32_t value)
{
    for (int i = 0; i < 4; i++) {
        to[i] = (unsigned char)(value >> (8 * i));
    }
}

static void put_f64(unsigned char *to, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_u32(to, (uint32_t)bits);
    put_u32(to + 4, (uint32_t)(bits >> 32));
}

/* Reads altered bytes, expects this error with these words in it, and puts the original back. */
static void expect(unsigned char *bytes, const unsigned char *original, size_t size, lmg_result code, const char *words)
{
    lmg_field *out = NULL;
    lmg_error error = {.message = ""};
    const lmg_result result = lmg_field_read_memory(bytes, size, "hostile.exr", &out, &error);
    if (result != code || strstr(error.message, words) == NULL) {
        fail_msg("expected %d, \"%s\"; got %d, \"%s\"", (int)code, words, (int)result, error.message);
    }
    assert_null(out);
    memcpy(bytes, original, size);
}

static void test_hostile(void **in)
{
    const state *s = *in;
    lmg_field *field;
    size_t size;
    unsigned char *original = small_box(s, 3, &field, &size), *b = malloc(size), *length;
    memcpy(b, original, size);
    const lmg_result format = LMG_ERROR_FILE_FORMAT;

    put_u32(b, 0x474e5089);
    expect(b, original, size, format, "not an EXR file");
    put_u32(b + 4, 2);
    expect(b, original, size, format, "neither tiled nor of several parts");
    put_u32(b + 4, 2 | 0x1000 | 0x800);
    expect(b, original, size, format, "neither tiled nor of several parts");
    put_u32(find_attribute(b, size, "lumibox.version", "int", NULL), 3);
    expect(b, original, size, LMG_ERROR_FILE_VERSION, "version 3");

    /* sizes that would allocate the world */
    put_u32(find_attribute(b, size, "dataWindow", "box2i", NULL) + 8, 0x3ffffffd);
    expect(b, original, size, format, "divide");
    put_u32(find_attribute(b, size, "dataWindow", "box2i", NULL) + 8, 0x7fffffff);
    expect(b, original, size, format, "impossible data window");
    put_u32(find_attribute(b, size, "dataWindow", "box2i", NULL), 1);
    expect(b, original, size, format, "impossible data window");
    put_u32(find_attribute(b, size, "displayWindow", "box2i", NULL) + 12, 0x80000000);
    expect(b, original, size, format, "impossible display window");
    put_u32(find_attribute(b, size, "tiles", "tiledesc", NULL), 0);
    expect(b, original, size, format, "impossible tiles");
    put_u32(find_attribute(b, size, "tiles", "tiledesc", NULL), 65536);
    expect(b, original, size, format, "impossible tiles");
    find_attribute(b, size, "tiles", "tiledesc", NULL)[8] = 1;
    expect(b, original, size, format, "several levels");
    {
        /* a box of 65535 x 65535 cells per tile in a few kilobytes */
        unsigned char *window = find_attribute(b, size, "dataWindow", "box2i", NULL);
        unsigned char *tile = find_attribute(b, size, "tiles", "tiledesc", NULL);
        put_u32(window + 8, 3 * 65535 - 1);
        put_u32(window + 12, 2 * 65535 - 1);
        put_u32(tile, 65535);
        put_u32(tile + 4, 65535);
        expect(b, original, size, format, "larger or more numerous");
        /* 10 MB per tile, which no tile of this file can hold packed */
        put_u32(window + 8, 3 * 700 - 1);
        put_u32(window + 12, 2 * 700 - 1);
        put_u32(tile, 700);
        put_u32(tile + 4, 700);
        expect(b, original, size, format, "are packed in");
        /* two thousand million tiles of one cell, whose table alone would take 16 GB */
        put_u32(window + 8, 46340 - 1);
        put_u32(window + 12, 46340 - 1);
        put_u32(tile, 1);
        put_u32(tile + 4, 1);
        put_u32(find_attribute(b, size, "chunkCount", "int", NULL), 46340u * 46340u);
        expect(b, original, size, LMG_ERROR_FILE_READ, "tables of tiles");
    }
    put_u32(find_attribute(b, size, "chunkCount", "int", NULL), 0x7fffffff);
    expect(b, original, size, format, "says it has 2147483647 tiles");
    put_u32(find_attribute(b, size, "lumibox.uvCells", "v2i", NULL), 0);
    expect(b, original, size, format, "outside 1 to 65535");
    put_u32(find_attribute(b, size, "lumibox.uvCells", "v2i", NULL), 4);
    expect(b, original, size, format, "don't match a picture");
    put_u32(find_attribute(b, size, "lumibox.slabs", "int", NULL), 2);
    expect(b, original, size, format, "2 slabs, but has 3 parts");
    put_u32(find_attribute(b, size, "lumibox.channels", "int", NULL), 1);
    expect(b, original, size, format, "colour channels");
    put_u32(find_attribute(b, size, "lumibox.slab", "int", NULL), 1);
    expect(b, original, size, format, "says it is slab 1");

    /* structure */
    find_attribute(b, size, "compression", "compression", NULL)[0] = 4;
    expect(b, original, size, format, "compression 4");
    find_attribute(b, size, "lineOrder", "lineOrder", NULL)[0] = 1;
    expect(b, original, size, format, "line order");
    put_u32(find_attribute(b, size, "channels", "chlist", NULL) + 2, 1);
    expect(b, original, size, format, "doesn't hold the channels");
    find_attribute(b, size, "lumibox.distance", "double", &length);
    put_u32(length, 0xffffffff);
    expect(b, original, size, format, "says it has -1 bytes");
    find_attribute(b, size, "lumibox.kind", "string", &length);
    put_u32(length, 0x7fffffff);
    expect(b, original, size, LMG_ERROR_FILE_READ, "ends in its header");
    memcpy(find_attribute(b, size, "lumibox.kind", "string", NULL), "sphereic", 8);
    expect(b, original, size, format, "neither \"cube\" nor");
    find_attribute(b, size, "lumibox.text.model", "string", NULL)[2] = 0;
    expect(b, original, size, format, "zero byte");
    memcpy(find_attribute(b, size, "name", "string", NULL), "slab07", 6);
    expect(b, original, size, format, "isn't named");
    find_attribute(b, size, "type", "string", NULL)[0] = 'T';
    expect(b, original, size, format, "isn't a tiled image");
    memcpy(find_attribute(b, size, "lumibox.u", "v2d", NULL) - 4 - strlen("v2d") - 1 - 2, "v", 1);
    expect(b, original, size, format, "twice");

    /* values */
    put_f64(find_attribute(b, size, "lumibox.emitted", "v2d", NULL), (double)NAN);
    expect(b, original, size, format, "the flux emitted is nan");
    put_f64(find_attribute(b, size, "lumibox.size", "double", NULL), -1);
    expect(b, original, size, format, "impossible layout");
    put_f64(find_attribute(b, size, "lumibox.n", "v3d", NULL), 3);
    expect(b, original, size, format, "impossible layout");
    put_f64(find_attribute(b, size, "lumibox.u", "v2d", NULL), (double)INFINITY);
    expect(b, original, size, format, "impossible layout");
    find_attribute(b, size, "lumibox.hash", "string", NULL)[0] = 'g';
    expect(b, original, size, format, "isn't a 16-digit hexadecimal number");
    find_attribute(b, size, "lumibox.photons", "string", NULL)[0] = '9';
    expect(b, original, size, format, "isn't a decimal number"); /* 9.2e19 doesn't fit 64 bits */

    /* altered, though possible: only the content hash can tell */
    find_attribute(b, size, "lumibox.photons", "string", NULL)[19] = '0';
    expect(b, original, size, format, "content hash");
    find_attribute(b, size, "lumibox.text.seed", "string", NULL)[0] = '5';
    expect(b, original, size, format, "content hash");
    put_f64(find_attribute(b, size, "lumibox.stored", "v2d", NULL) + 8, 0.25);
    expect(b, original, size, format, "content hash");
    memcpy(find_attribute(b, size, "lumibox.text.seed", "string", NULL) - 4 - strlen("string") - 1 - 2, "n", 1);
    expect(b, original, size, format, "content hash"); /* the text is now called "seen" */

    /* more than the end */
    unsigned char *longer = malloc(size + 1);
    memcpy(longer, original, size);
    longer[size] = 0;
    lmg_field *out = field;
    lmg_error error = {.message = ""};
    assert_int_equal(lmg_field_read_memory(longer, size + 1, NULL, &out, &error), LMG_ERROR_FILE_FORMAT);
    assert_non_null(strstr(error.message, "follow the last tile"));
    assert_null(out);
    free(longer);
    free(b);
    free(original);
    lmg_field_destroy(field);
}

/* A cell that isn't a number, with a correct hash: written without compression, then patched with the hash made to agree is beyond a test;
 * so the check of cells is seen from the writing side, and on reading by its place before the hash. */
static void test_cells_not_numbers(void **in)
{
    const state *s = *in;
    static const float bad[] = {NAN, INFINITY, -INFINITY};
    lmg_field *field = fixture_field(2, false, 3, 17);
    for (int i = 0; i < 8; i++) {
        lmg_slab_data *d = &field->slabs[1];
        float *cell = i < 3 ? &lmg_cell_radiance(d, 14)[2] : i < 6 ? &d->half_a[13] : &d->standard_error[13];
        const float keep = *cell;
        *cell = i < 6 ? bad[i % 3] : i == 6 ? -1.0f : NAN;
        lmg_error error = {.message = ""};
        assert_int_equal(lmg_field_write(field, s->path, &error), LMG_ERROR_ARGUMENT);
        assert_non_null(strstr(error.message, "slab 1, cell u"));
        assert_int_equal(access(s->path, F_OK), -1);
        *cell = keep;
    }
    lmg_error error = {.message = ""};
    assert_int_equal(lmg_field_write_as(field, s->path, LMG_EXR_NONE, 0, &error), LMG_OK);
    size_t size;
    unsigned char *bytes = fixture_load(s->path, &size);
    const uint32_t nan_bits = 0x7fc00000;
    put_u32(bytes + size - 4, nan_bits); /* the last value of the file: a standard error */
    lmg_field *out = NULL;
    assert_int_equal(lmg_field_read_memory(bytes, size, "nan.exr", &out, &error), LMG_ERROR_FILE_FORMAT);
    assert_non_null(strstr(error.message, "no finite number"));
    free(bytes);
    field->ledger.lost_se = (double)NAN;
    assert_int_equal(lmg_field_write(field, s->path, &error), LMG_ERROR_ARGUMENT);
    assert_non_null(strstr(error.message, "flux lost"));
    lmg_field_destroy(field);
}

static void test_not_boxes(void **in)
{
    const state *s = *in;
    lmg_field *out = NULL;
    lmg_error error = {.message = ""};
    char path[600];
    snprintf(path, sizeof path, "%s/missing.box.exr", s->directory);
    assert_int_equal(lmg_field_read(path, &out, &error), LMG_ERROR_FILE_OPEN);
    assert_message(&error, path);
    assert_int_equal(lmg_field_read(s->directory, &out, &error), LMG_ERROR_FILE_OPEN);
    assert_non_null(strstr(error.message, "is a directory"));
    snprintf(path, sizeof path, "%s/pipe", s->directory);
    assert_int_equal(mkfifo(path, 0600), 0);
    assert_int_equal(lmg_field_read(path, &out, &error), LMG_ERROR_FILE_OPEN);
    assert_non_null(strstr(error.message, "isn't a regular file"));
    snprintf(path, sizeof path, "%s/text", s->directory);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    assert_int_equal(lmg_field_read(path, &out, &error), LMG_ERROR_FILE_READ); /* empty */
    fputs("This is not a picture of light.\n", file);
    fclose(file);
    assert_int_equal(lmg_field_read(path, &out, &error), LMG_ERROR_FILE_FORMAT);
    assert_non_null(strstr(error.message, "not an EXR file"));
    strcat(path, "/below"); /* a file isn't a directory */
    assert_int_equal(lmg_field_read(path, &out, &error), LMG_ERROR_FILE_OPEN);
    assert_message(&error, path);
    assert_null(out);
    assert_int_equal(lmg_field_read("", &out, &error), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_read(NULL, &out, NULL), LMG_ERROR_ARGUMENT);

    char endless[3000]; /* a message holds 512 bytes; what is wrong must not fall off its end */
    memset(endless, 'd', sizeof endless - 1);
    endless[sizeof endless - 1] = 0;
    assert_int_equal(lmg_field_read(endless, &out, &error), LMG_ERROR_FILE_OPEN);
    assert_non_null(strstr(error.message, "can't open: "));
}

/* --------------------------------------------------------------------------------------------------------- failing writes */

static size_t count_files(const char *directory)
{
    DIR *d = opendir(directory);
    assert_non_null(d);
    size_t count = 0;
    for (struct dirent *entry; (entry = readdir(d)) != NULL;) {
        count += strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0;
    }
    closedir(d);
    return count;
}

static void test_write_errors(void **in)
{
    const state *s = *in;
    lmg_field *field = fixture_field(2, true, 1, 23);
    lmg_error error = {.message = ""};
    char path[600];
    snprintf(path, sizeof path, "%s/no such directory/a.box.exr", s->directory);
    assert_int_equal(lmg_field_write(field, path, &error), LMG_ERROR_FILE_OPEN);
    assert_message(&error, path);
    write_ok(field, s->path);
    snprintf(path, sizeof path, "%s/b.box.exr", s->path); /* through a file */
    assert_int_equal(lmg_field_write(field, path, &error), LMG_ERROR_FILE_OPEN);
    assert_message(&error, path);
    assert_int_equal(lmg_field_write(field, s->directory, &error), LMG_ERROR_FILE_OPEN);
    assert_non_null(strstr(error.message, "is a directory"));
    snprintf(path, sizeof path, "%s/new/", s->directory);
    assert_int_equal(lmg_field_write(field, path, &error), LMG_ERROR_FILE_OPEN);
    assert_int_equal(lmg_field_write(field, "/dev/null", &error), LMG_ERROR_FILE_OPEN);
    assert_non_null(strstr(error.message, "not a regular file"));
    char name[300];
    memset(name, 'n', 256);
    name[256] = 0;
    snprintf(path, sizeof path, "%s/%s", s->directory, name); /* one more than a name may have */
    assert_int_equal(lmg_field_write(field, path, &error), LMG_ERROR_FILE_OPEN);
    assert_int_equal(lmg_field_write(NULL, s->path, &error), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_write(field, "", &error), LMG_ERROR_ARGUMENT);
    assert_int_equal(count_files(s->directory), 1); /* nothing left behind */
    lmg_field_destroy(field);
}

/* A limit on file sizes stands in for a full disk: writing fails in the middle. */
static void test_disk_full(void **in)
{
    const state *s = *in;
    lmg_field *old = fixture_field(1, false, 1, 29), *large = fixture_photon_field(3, 16, 16, 16, 16, 3, 31);
    write_ok(old, s->path);
    struct rlimit before, limit;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
    signal(SIGXFSZ, SIG_IGN);
    for (rlim_t bytes = 0; bytes < 1200000; bytes += 300000) { /* the file has 1.3 MB or more, 1 MB is written at a time */
        limit = before;
        limit.rlim_cur = bytes;
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
        lmg_error error = {.message = ""};
        const lmg_result result = lmg_field_write(large, s->path, &error);
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
        assert_int_equal(result, LMG_ERROR_FILE_WRITE);
        assert_message(&error, s->path);
        assert_non_null(strstr(error.message, strerror(EFBIG)));
        assert_int_equal(count_files(s->directory), 1);
        lmg_field *back = read_ok(s->path);
        assert_same(old, back);
        lmg_field_destroy(back);
    }
    signal(SIGXFSZ, SIG_DFL);
    write_ok(large, s->path);
    size_t size;
    free(fixture_load(s->path, &size));
    assert_true(size > 1200000); /* so that every limit above was below it */
    lmg_field_destroy(large);
    lmg_field_destroy(old);
}

static void test_killed(void **in)
{
    const state *s = *in;
    lmg_field *old = fixture_field(2, false, 1, 37), *large = fixture_photon_field(2, 16, 16, 12, 12, 3, 41);
    for (int round = 0; round < 10; round++) {
        write_ok(old, s->path);
        fflush(NULL);
        const pid_t child = fork();
        assert_true(child >= 0);
        if (child == 0) {
            for (;;) {
                if (lmg_field_write(large, s->path, NULL) != LMG_OK) {
                    _exit(1);
                }
            }
        }
        const struct timespec wait = {.tv_nsec = 3000000 * (round + 1)};
        nanosleep(&wait, NULL);
        kill(child, SIGKILL);
        int status = 0;
        assert_int_equal(waitpid(child, &status, 0), child);
        assert_true(WIFSIGNALED(status));
        lmg_field *back = read_ok(s->path); /* the old one or the new one, whole */
        if (fixture_difference(old, back) != NULL) {
            assert_same(large, back);
        }
        lmg_field_destroy(back);
    }
    lmg_field_destroy(large);
    lmg_field_destroy(old);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_round_trip, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_compressions, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_dark_field, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_overlapping_slabs, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_same_bytes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_names, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_truncated, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_bit_flips, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_mutations, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_hostile, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_cells_not_numbers, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_not_boxes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_write_errors, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_disk_full, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_killed, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
