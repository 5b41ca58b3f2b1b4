/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Checks the container of a box file before OpenEXRCore parses it.
 *
 * Box files come from anywhere, and OpenEXR's header parser has had a long list of memory faults on hostile files.  A box file uses
 * a small part of what EXR can say, so everything else is refused here, by a parser that only moves forward over a block of memory
 * and compares every length with what is left.  It relies on nothing but the bytes; the container's grammar is in docs/format.md.
 */
#include "exr_check.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* More attributes than this in one part are refused; our own parts have about 40 besides the texts. */
enum { MAX_ATTRIBUTES = 1024 };

/* Deflate codes at best 258 bytes in 2 bits (RFC 1951: the longest match, with one-bit codes for length and distance). */
enum { DEFLATE_MAX_RATIO = 1032 };

enum { VERSION_NUMBER = 2, FLAG_TILED = 0x200, FLAG_LONG_NAMES = 0x400, FLAG_MULTI_PART = 0x1000 };
enum { COMPRESSION_NONE = 0, COMPRESSION_ZIPS = 2, COMPRESSION_ZIP = 3 };
enum { PIXEL_HALF = 1, PIXEL_FLOAT = 2 };

typedef struct scan {
    const unsigned char *bytes;
    size_t size, at;
    bool multi_part, long_names;
    lmg_exr_fault *fault;
} scan;

/* What the rest of the file is compared with. */
typedef struct part_shape {
    uint32_t width, height, tile_width, tile_height, channels, sample_bytes;
    uint32_t columns, rows; /* of tiles */
    int compression;
    uint64_t tile_bytes; /* unpacked */
} part_shape;

typedef struct attribute {
    const char *name, *type;
    const unsigned char *value;
    uint32_t size;
} attribute;

static lmg_result fail(scan *s, lmg_result code, const char *format, ...) __attribute__((format(printf, 3, 4)));

static lmg_result fail(scan *s, lmg_result code, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(s->fault->text, sizeof s->fault->text, format, arguments);
    va_end(arguments);
    s->fault->code = code;
    return code;
}

static uint32_t get_u32(const unsigned char *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static int32_t get_i32(const unsigned char *p)
{
    const uint32_t bits = get_u32(p);
    int32_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint64_t get_u64(const unsigned char *p)
{
    return (uint64_t)get_u32(p) | (uint64_t)get_u32(p + 4) << 32;
}

static float get_f32(const unsigned char *p)
{
    const uint32_t bits = get_u32(p);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static size_t left(const scan *s)
{
    return s->size - s->at;
}

static lmg_result truncated(scan *s, const char *where)
{
    return fail(s, LMG_ERROR_FILE_READ, "ends in %s after %zu bytes: truncated, copy it again", where, s->size);
}

/* A NUL-terminated name of 1..limit printable ASCII characters at s->at, not yet stepped over. */
static lmg_result take_name(scan *s, const char *what, const char **out)
{
    const size_t limit = s->long_names ? LMG_EXR_LONG_NAME : LMG_EXR_SHORT_NAME;
    const unsigned char *start = s->bytes + s->at;
    size_t length = 0;
    while (length < left(s) && start[length] != 0) {
        if (length == limit || start[length] < 0x20 || start[length] > 0x7e) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "damaged header: %s at byte %zu isn't 1 to %zu printable characters", what, s->at, limit);
        }
        length++;
    }
    if (length == left(s)) {
        return truncated(s, "its header");
    }
    if (length == 0) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "damaged header: empty %s at byte %zu", what, s->at);
    }
    *out = (const char *)start;
    s->at += length + 1;
    return LMG_OK;
}

/* Sizes of the attribute types that may occur; variable: checked elsewhere or free (string, trees). */
static bool type_size(const char *type, uint32_t *size, bool *variable)
{
    static const struct {
        const char *type;
        uint32_t size;
    } fixed[] = {
        {"box2i", 16}, {"box2f", 16},    {"chromaticities", 32}, {"compression", 1}, {"double", 8}, {"float", 4}, {"int", 4},
        {"lineOrder", 1}, {"m33f", 36},  {"m33d", 72},           {"m44f", 64},       {"m44d", 128}, {"rational", 8},
        {"tiledesc", 9},  {"timecode", 8}, {"v2i", 8},           {"v2f", 8},         {"v2d", 16},   {"v3i", 12},  {"v3f", 12},
        {"v3d", 24},
    };
    *variable = strcmp(type, "string") == 0 || strcmp(type, "chlist") == 0 || strcmp(type, LMG_EXR_TREES) == 0;
    *size = 0;
    for (size_t i = 0; i < sizeof fixed / sizeof fixed[0]; i++) {
        if (strcmp(type, fixed[i].type) == 0) {
            *size = fixed[i].size;
            return true;
        }
    }
    return *variable;
}

static lmg_result take_attribute(scan *s, attribute *a)
{
    lmg_result result = take_name(s, "attribute name", &a->name);
    if (result == LMG_OK) {
        result = take_name(s, "attribute type", &a->type);
    }
    if (result != LMG_OK) {
        return result;
    }
    if (left(s) < 4) {
        return truncated(s, "its header");
    }
    const int32_t size = get_i32(s->bytes + s->at);
    s->at += 4;
    uint32_t expected;
    bool variable;
    if (!type_size(a->type, &expected, &variable)) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "attribute \"%.64s\" has type \"%.32s\", which box files don't hold", a->name, a->type);
    }
    if (size < 0 || (!variable && (uint32_t)size != expected)) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "damaged header: attribute \"%.64s\" of type %.32s says it has %d bytes", a->name, a->type,
                    (int)size);
    }
    if ((size_t)size > left(s)) {
        return truncated(s, "its header");
    }
    a->value = s->bytes + s->at;
    a->size = (uint32_t)size;
    s->at += a->size;
    return LMG_OK;
}

/* The channel list is one of exactly four, so it's compared with what it has to be, byte by byte. */
static bool match_channels(const attribute *a, uint32_t type, const char *const *names, size_t count)
{
    size_t at = 0;
    for (size_t i = 0; i < count; i++) {
        const size_t length = strlen(names[i]) + 1;
        if (a->size - at < length + 16 || memcmp(a->value + at, names[i], length) != 0) {
            return false;
        }
        /* pixel type; then pLinear and three reserved bytes, which say nothing here; then x and y sampling */
        const unsigned char *entry = a->value + at + length;
        if (get_u32(entry) != type || get_u32(entry + 8) != 1 || get_u32(entry + 12) != 1 || entry[4] > 1) {
            return false;
        }
        at += length + 16;
    }
    return a->size - at == 1 && a->value[at] == 0;
}

static bool is(const attribute *a, const char *name)
{
    return strcmp(a->name, name) == 0;
}

enum { SEEN_CHANNELS = 1, SEEN_COMPRESSION = 2, SEEN_DATA = 4, SEEN_DISPLAY = 8, SEEN_ORDER = 16, SEEN_ASPECT = 32, SEEN_CENTER = 64,
       SEEN_WIDTH = 128, SEEN_TILES = 256, SEEN_NAME = 512, SEEN_TYPE = 1024, SEEN_COUNT = 2048 };
enum { SEEN_SINGLE = SEEN_NAME - 1, SEEN_MULTI = 2 * SEEN_COUNT - 1 };

static const struct {
    const char *name, *type;
    int seen;
} standard[] = {
    {"channels", "chlist", SEEN_CHANNELS},
    {"compression", "compression", SEEN_COMPRESSION},
    {"dataWindow", "box2i", SEEN_DATA},
    {"displayWindow", "box2i", SEEN_DISPLAY},
    {"lineOrder", "lineOrder", SEEN_ORDER},
    {"pixelAspectRatio", "float", SEEN_ASPECT},
    {"screenWindowCenter", "v2f", SEEN_CENTER},
    {"screenWindowWidth", "float", SEEN_WIDTH},
    {"tiles", "tiledesc", SEEN_TILES},
    {"name", "string", SEEN_NAME},
    {"type", "string", SEEN_TYPE},
    {"chunkCount", "int", SEEN_COUNT},
};

/* Checks one of EXR's own attributes, remembers what the chunks depend on, and marks it as seen. */
static lmg_result check_standard(scan *s, const attribute *a, uint32_t part, part_shape *shape, uint32_t *chunk_count, int *seen)
{
    static const char *const one[] = {"Y", "half_a.Y", "stderr.Y"};
    static const char *const three[] = {"B", "G", "R", "half_a.Y", "stderr.Y"};
    static const char *const rounded[] = {"BY", "RY", "Y", "difference", "weight"};
    size_t i = 0;
    while (i < sizeof standard / sizeof standard[0] && !is(a, standard[i].name)) {
        i++;
    }
    if (i == sizeof standard / sizeof standard[0]) {
        if (is(a, "version") || is(a, "maxSamplesPerPixel")) { /* of deep files; OpenEXRCore would act on them */
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has the attribute \"%s\", which box files don't hold", part, a->name);
        }
        return LMG_OK;
    }
    if (strcmp(a->type, standard[i].type) != 0) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "damaged header: part %u, attribute \"%s\" has type \"%s\", not \"%s\"", part, a->name, a->type,
                    standard[i].type);
    }
    *seen |= standard[i].seen;
    switch (standard[i].seen) {
    case SEEN_CHANNELS:
        shape->channels = match_channels(a, PIXEL_FLOAT, one, 3) || match_channels(a, PIXEL_HALF, rounded + 2, 3)   ? 1
                          : match_channels(a, PIXEL_FLOAT, three, 5) || match_channels(a, PIXEL_HALF, rounded, 5) ? 3
                                                                                                                  : 0;
        shape->sample_bytes = match_channels(a, PIXEL_FLOAT, shape->channels == 1 ? one : three, shape->channels + 2) ? 4 : 2;
        if (shape->channels == 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "not a box file: part %u doesn't hold the channels Y (or R, G, B), half_a.Y and stderr.Y as 32-bit "
                        "floats, nor Y (or Y, RY, BY), difference and weight as 16-bit ones", part);
        }
        break;
    case SEEN_COMPRESSION:
        shape->compression = a->value[0];
        if (shape->compression != COMPRESSION_NONE && shape->compression != COMPRESSION_ZIPS && shape->compression != COMPRESSION_ZIP) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u uses EXR compression %d; box files use none, zips or zip", part, shape->compression);
        }
        break;
    case SEEN_DATA: {
        const int32_t x = get_i32(a->value + 8), y = get_i32(a->value + 12);
        if (get_u32(a->value) != 0 || get_u32(a->value + 4) != 0 || x < 0 || y < 0 || x >= LMG_EXR_MAX_EXTENT || y >= LMG_EXR_MAX_EXTENT) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has an impossible data window", part);
        }
        shape->width = (uint32_t)x + 1;
        shape->height = (uint32_t)y + 1;
        break;
    }
    case SEEN_DISPLAY: {
        const int32_t x = get_i32(a->value + 8), y = get_i32(a->value + 12);
        if (get_u32(a->value) != 0 || get_u32(a->value + 4) != 0 || x < 0 || y < 0 || x >= LMG_EXR_MAX_EXTENT || y >= LMG_EXR_MAX_EXTENT) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has an impossible display window", part);
        }
        break;
    }
    case SEEN_ORDER:
        if (a->value[0] != 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has line order %u; box files are stored by increasing y", part, a->value[0]);
        }
        break;
    case SEEN_ASPECT:
    case SEEN_WIDTH: /* they say nothing here; OpenEXR wants sensible ones */
        if (get_f32(a->value) != 1.0f) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u: %s isn't 1", part, a->name);
        }
        break;
    case SEEN_CENTER:
        if (get_f32(a->value) != 0.0f || get_f32(a->value + 4) != 0.0f) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u: %s isn't 0, 0", part, a->name);
        }
        break;
    case SEEN_TILES:
        shape->tile_width = get_u32(a->value);
        shape->tile_height = get_u32(a->value + 4);
        if (shape->tile_width < 1 || shape->tile_width > 65535 || shape->tile_height < 1 || shape->tile_height > 65535 || a->value[8] != 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has impossible tiles, or tiles of several levels", part);
        }
        break;
    case SEEN_NAME: {
        char expected[16];
        snprintf(expected, sizeof expected, "slab%02u", part);
        if (a->size != strlen(expected) || memcmp(a->value, expected, a->size) != 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "not a box file: part %u isn't named %s", part, expected);
        }
        break;
    }
    case SEEN_TYPE:
        if (a->size != strlen("tiledimage") || memcmp(a->value, "tiledimage", a->size) != 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "not a box file: part %u isn't a tiled image", part);
        }
        break;
    case SEEN_COUNT:
        *chunk_count = get_u32(a->value);
        break;
    }
    return LMG_OK;
}

static lmg_result check_header(scan *s, uint32_t part, part_shape *shape)
{
    const char *names[MAX_ATTRIBUTES];
    size_t count = 0;
    uint32_t chunk_count = 0;
    int seen = 0;
    memset(shape, 0, sizeof *shape);
    for (;;) {
        if (left(s) == 0) {
            return truncated(s, "its header");
        }
        if (s->bytes[s->at] == 0) {
            s->at++;
            break;
        }
        attribute a;
        lmg_result result = take_attribute(s, &a);
        if (result == LMG_OK) {
            result = check_standard(s, &a, part, shape, &chunk_count, &seen);
        }
        if (result != LMG_OK) {
            return result;
        }
        for (size_t i = 0; i < count; i++) {
            if (strcmp(names[i], a.name) == 0) {
                return fail(s, LMG_ERROR_FILE_FORMAT, "damaged header: part %u has attribute \"%.64s\" twice", part, a.name);
            }
        }
        if (count == MAX_ATTRIBUTES) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has more than %d attributes", part, MAX_ATTRIBUTES);
        }
        names[count++] = a.name;
    }
    const int needed = s->multi_part ? SEEN_MULTI : SEEN_SINGLE;
    for (size_t i = 0; i < sizeof standard / sizeof standard[0]; i++) {
        if ((needed & ~seen & standard[i].seen) != 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "not a box file: part %u has no attribute \"%s\"", part, standard[i].name);
        }
    }
    if (shape->width % shape->tile_width != 0 || shape->height % shape->tile_height != 0) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "part %u: tiles of %u x %u don't divide the picture of %u x %u", part, shape->tile_width,
                    shape->tile_height, shape->width, shape->height);
    }
    shape->columns = shape->width / shape->tile_width;
    shape->rows = shape->height / shape->tile_height;
    /* below 2^16 * 2^16 * 20: fits */
    shape->tile_bytes = (uint64_t)shape->tile_width * shape->tile_height * (shape->channels + 2) * shape->sample_bytes;
    const uint64_t chunks = (uint64_t)shape->columns * shape->rows;
    if (shape->tile_bytes > INT32_MAX || chunks > INT32_MAX) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "part %u has tiles larger or more numerous than EXR can hold", part);
    }
    if ((seen & SEEN_COUNT) != 0 && chunk_count != chunks) {
        return fail(s, LMG_ERROR_FILE_FORMAT, "damaged header: part %u says it has %u tiles where its size makes %llu", part, chunk_count,
                    (unsigned long long)chunks);
    }
    return LMG_OK;
}

/* The chunks of one part: each where its table says, right after the one before, belonging to its tile. */
static lmg_result check_chunks(scan *s, uint32_t part, const part_shape *shape, const unsigned char *table)
{
    const size_t leader_size = s->multi_part ? 24 : 20;
    const uint64_t chunks = (uint64_t)shape->columns * shape->rows;
    for (uint64_t k = 0; k < chunks; k++) {
        const uint32_t column = (uint32_t)(k % shape->columns), row = (uint32_t)(k / shape->columns);
        if (get_u64(table + 8 * k) != s->at) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "damaged: part %u, tile %u,%u isn't at the place its table says (byte %zu)", part, column, row,
                        s->at);
        }
        if (left(s) < leader_size) {
            return truncated(s, "its tiles");
        }
        const unsigned char *leader = s->bytes + s->at;
        if (s->multi_part) {
            if (get_u32(leader) != part) {
                return fail(s, LMG_ERROR_FILE_FORMAT, "damaged: the tile at byte %zu isn't of part %u", s->at, part);
            }
            leader += 4;
        }
        if (get_u32(leader) != column || get_u32(leader + 4) != row || get_u32(leader + 8) != 0 || get_u32(leader + 12) != 0) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "damaged: part %u, the tile at byte %zu isn't tile %u,%u", part, s->at, column, row);
        }
        const uint32_t packed = get_u32(leader + 16);
        s->at += leader_size;
        if (packed == 0 || packed > shape->tile_bytes || (packed < shape->tile_bytes && shape->compression == COMPRESSION_NONE) ||
            shape->tile_bytes > (uint64_t)packed * DEFLATE_MAX_RATIO) {
            return fail(s, LMG_ERROR_FILE_FORMAT, "damaged: part %u, tile %u,%u says that %llu bytes are packed in %u", part, column, row,
                        (unsigned long long)shape->tile_bytes, packed);
        }
        if (packed > left(s)) {
            return truncated(s, "its tiles");
        }
        s->at += packed;
    }
    return LMG_OK;
}

lmg_result lmg_exr_check(const unsigned char *bytes, size_t size, lmg_exr_fault *fault)
{
    scan s = {.bytes = bytes, .size = size, .fault = fault};
    fault->code = LMG_OK;
    fault->text[0] = 0;
    if (size < 8) {
        return truncated(&s, "its first 8 bytes");
    }
    if (get_u32(bytes) != 20000630) {
        return fail(&s, LMG_ERROR_FILE_FORMAT, "not an EXR file, so not a box file");
    }
    const uint32_t version = get_u32(bytes + 4);
    s.multi_part = (version & FLAG_MULTI_PART) != 0;
    s.long_names = (version & FLAG_LONG_NAMES) != 0;
    if ((version & ~(uint32_t)FLAG_LONG_NAMES) != (VERSION_NUMBER | FLAG_MULTI_PART) &&
        (version & ~(uint32_t)FLAG_LONG_NAMES) != (VERSION_NUMBER | FLAG_TILED)) {
        return fail(&s, LMG_ERROR_FILE_FORMAT, "not a box file: an EXR file, but neither tiled nor of several parts (version field 0x%x)",
                    (unsigned)version);
    }
    s.at = 8;

    part_shape shapes[LMG_MAX_SLABS];
    uint32_t parts = 0;
    do {
        if (parts == LMG_MAX_SLABS) {
            return fail(&s, LMG_ERROR_FILE_FORMAT, "not a box file: more than %d parts", LMG_MAX_SLABS);
        }
        const lmg_result result = check_header(&s, parts, &shapes[parts]);
        if (result != LMG_OK) {
            return result;
        }
        if (shapes[parts].channels != shapes[0].channels || shapes[parts].sample_bytes != shapes[0].sample_bytes) {
            return fail(&s, LMG_ERROR_FILE_FORMAT, "not a box file: parts 0 and %u have different channels", parts);
        }
        parts++;
        if (s.multi_part && left(&s) == 0) {
            return truncated(&s, "its header");
        }
    } while (s.multi_part && bytes[s.at] != 0);
    if (s.multi_part) {
        s.at++;
    }

    const unsigned char *tables[LMG_MAX_SLABS];
    for (uint32_t part = 0; part < parts; part++) {
        const uint64_t chunks = (uint64_t)shapes[part].columns * shapes[part].rows;
        if (chunks > left(&s) / 8) {
            return truncated(&s, "its tables of tiles");
        }
        tables[part] = bytes + s.at;
        s.at += (size_t)chunks * 8;
    }
    for (uint32_t part = 0; part < parts; part++) {
        const lmg_result result = check_chunks(&s, part, &shapes[part], tables[part]);
        if (result != LMG_OK) {
            return result;
        }
    }
    if (left(&s) != 0) {
        return fail(&s, LMG_ERROR_FILE_FORMAT, "damaged: %zu bytes follow the last tile", left(&s));
    }
    return LMG_OK;
}
