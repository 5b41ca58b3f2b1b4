/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Opening glTF files (gltf_file.h).  A file is untrusted: sizes are checked before they are believed, only regular files beside or
 * below the model (or reached by ../) are opened, nothing is fetched from a network, and no name is ever given to a shell.
 * Relies on jansson for JSON, gltf_check.c for the schema, gltf_shim.cpp for the document and the decoding of images.
 */
#include "gltf_file.h"
#include "text.h"

#include <luminaires/photometry.h>

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Bounds on what is read into memory, far above any luminaire: a file, all buffers together, pixels of an image and a side of it.
 */
#define MAX_FILE_BYTES ((size_t)2 << 30)
#define MAX_BUFFER_BYTES ((size_t)4 << 30)
#define MAX_IMAGE_PIXELS ((uint64_t)1 << 26)
#define MAX_IMAGE_SIDE 16384u

lmg_result lum_read_file(const char *path, size_t limit, uint8_t **bytes, size_t *size, lmg_error *err)
{
    *bytes = NULL;
    *size = 0;
    /* O_NONBLOCK: a named pipe must not hang the open; it is refused as not regular below. */
    int fd = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0)
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "can't be opened: %s", strerror(errno));
    lmg_result result = LMG_OK;
    uint8_t *data = NULL;
    size_t done = 0;
    struct stat info;
    if (fstat(fd, &info) != 0) {
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "can't be read: %s", strerror(errno));
        goto cleanup;
    }
    if (!S_ISREG(info.st_mode)) {
        result =
            lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s", S_ISDIR(info.st_mode) ? "is a folder, not a file" : "is not a regular file");
        goto cleanup;
    }
    if (info.st_size < 0 || (uint64_t)info.st_size > limit) {
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "is larger than the limit of %zu MB", limit >> 20);
        goto cleanup;
    }
    size_t total = (size_t)info.st_size;
    data = malloc(total + 1);
    if (!data) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %zu MB", total >> 20);
        goto cleanup;
    }
    while (done < total) {
        ssize_t n = read(fd, data + done, total - done);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0) {
            result = lmg_fail(err, LMG_ERROR_FILE_READ, "can't be read: %s", strerror(errno));
            goto cleanup;
        }
        if (n == 0)
            break; /* it shrank while we read */
        done += (size_t)n;
    }
    data[done] = 0;
    *bytes = data;
    *size = done;
    data = NULL;
cleanup:
    free(data);
    close(fd);
    return result;
}

/* ---------------------------------------------------------------------------------------------------------------- URIs */

static int hex(char c)
{
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The path of a relative URI reference, %XX undone, below dir; allocated.  Messages don't name the URI: the caller does. */
static lmg_result uri_path(const char *dir, const char *uri, char **out_path, lmg_error *err)
{
    *out_path = NULL;
    size_t scheme = strcspn(uri, ":/?#");
    if (uri[scheme] == ':' && scheme > 1) /* one letter: a Windows drive, absolute, refused below */
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "is not beside the model; download it there and use its file name");
    if (uri[0] == '/' || uri[0] == '\\' || uri[scheme] == ':')
        return lmg_fail(err, LMG_ERROR_INPUT, "is an absolute path; put the file beside the model and use its name");
    size_t n = strlen(dir), m = strlen(uri);
    char *path = malloc(n + m + 1);
    if (!path)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    memcpy(path, dir, n);
    size_t out = n;
    for (size_t i = 0; i < m; i++) {
        char c = uri[i];
        if (c == '%' && hex(uri[i + 1]) >= 0 && hex(uri[i + 2]) >= 0) {
            c = (char)(hex(uri[i + 1]) * 16 + hex(uri[i + 2]));
            i += 2;
        }
        if (c == 0) {
            free(path);
            return lmg_fail(err, LMG_ERROR_INPUT, "has a zero byte in its name");
        }
        path[out++] = c;
    }
    path[out] = 0;
    *out_path = path;
    return LMG_OK;
}

static bool is_data_uri(const char *uri)
{
    return strncmp(uri, "data:", 5) == 0;
}

static int base64_value(char c)
{
    if (c >= 'A' && c <= 'Z')
        return c - 'A';
    if (c >= 'a' && c <= 'z')
        return c - 'a' + 26;
    if (c >= '0' && c <= '9')
        return c - '0' + 52;
    return c == '+' ? 62 : c == '/' ? 63 : -1;
}

/* Decodes data:<type>;base64,<text>. */
static lmg_result decode_data_uri(const char *uri, uint8_t **bytes, size_t *size, lmg_error *err)
{
    *bytes = NULL;
    *size = 0;
    const char *comma = strchr(uri, ',');
    if (!comma || comma - uri < 7 || strncmp(comma - 7, ";base64", 7) != 0)
        return lmg_fail(err, LMG_ERROR_INPUT, "its data URI is not base64");
    const char *text = comma + 1;
    size_t n = strlen(text);
    while (n > 0 && text[n - 1] == '=')
        n--;
    uint8_t *data = malloc(n / 4 * 3 + 4);
    if (!data)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    uint32_t bits = 0;
    size_t out = 0;
    for (size_t i = 0; i < n; i++) {
        int v = base64_value(text[i]);
        if (v < 0) {
            free(data);
            return lmg_fail(err, LMG_ERROR_INPUT, "character %zu of its base64 text is not base64; the file is damaged", i);
        }
        bits = bits << 6 | (uint32_t)v;
        if (i % 4 == 1)
            data[out++] = (uint8_t)(bits >> 4);
        else if (i % 4 == 2)
            data[out++] = (uint8_t)(bits >> 2);
        else if (i % 4 == 3)
            data[out++] = (uint8_t)bits;
    }
    *bytes = data;
    *size = out;
    return LMG_OK;
}

/* ----------------------------------------------------------------------------------------------------------- container */

static uint32_t little32(const uint8_t *b)
{
    return (uint32_t)b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

/* Finds the JSON text and the binary chunk (may be absent: NULL) of a file. */
static lmg_result split(const uint8_t *file, size_t size, const char **json, size_t *json_size, gltf_bytes *chunk, lmg_error *err)
{
    *chunk = (gltf_bytes){NULL, 0};
    if (size < 4 || memcmp(file, "glTF", 4) != 0) {
        *json = (const char *)file;
        *json_size = size;
        if (size >= 3 && memcmp(file, "\xef\xbb\xbf", 3) == 0) { /* a byte order mark, which some editors leave */
            *json += 3;
            *json_size -= 3;
        }
        return LMG_OK;
    }
    const uint32_t type_json = 0x4e4f534a, type_bin = 0x004e4942;
    if (size < 20)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "the binary glTF file ends after %zu bytes; it is truncated", size);
    if (little32(file + 4) != 2)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "binary glTF version %u is not supported; export the model as glTF 2.0",
                        little32(file + 4));
    uint64_t length = little32(file + 8);
    if (length > size)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "the file has %zu of the %llu bytes it declares; it is truncated", size,
                        (unsigned long long)length);
    *json = NULL;
    for (uint64_t at = 12; at + 8 <= length;) {
        uint64_t n = little32(file + at);
        uint32_t type = little32(file + at + 4);
        if (n > length - at - 8)
            return lmg_fail(err, LMG_ERROR_FILE_READ, "the chunk at byte %llu reaches past the end of the file; it is truncated",
                            (unsigned long long)at);
        if (!*json && type != type_json)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "its first chunk is not JSON");
        if (!*json) {
            *json = (const char *)file + at + 8;
            *json_size = n;
        } else if (type == type_bin && !chunk->data) {
            *chunk = (gltf_bytes){file + at + 8, n};
        }
        at += 8 + n;
    }
    if (!*json)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "it has no JSON chunk");
    while (*json_size > 0 && (*json)[*json_size - 1] == 0) /* old exporters pad with zeros where the specification says spaces */
        --*json_size;
    return LMG_OK;
}

static lmg_result parse_json(const char *text, size_t size, json_t **root, lmg_error *err)
{
    json_error_t e;
    *root = json_loadb(text, size, JSON_REJECT_DUPLICATES, &e);
    if (*root)
        return LMG_OK;
    if (json_error_code(&e) == json_error_out_of_memory)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "not a glTF file: JSON error in line %d, column %d: %.200s", e.line, e.column,
                    e.text);
}

/* ------------------------------------------------------------------------------------------------------------- buffers */

typedef struct loading {
    gltf_file *file;
    const char *dir;  /* of the model, with its final slash; "" = the current one */
    gltf_bytes chunk; /* of a GLB */
    json_t *root;
    gltf_bytes *buffers;
    uint8_t **owned; /* their contents */
    size_t buffer_count;
    size_t total;
} loading;

static lmg_result load_buffer(loading *l, size_t i, lmg_error *err)
{
    json_t *buffer = json_array_get(json_object_get(l->root, "buffers"), i);
    const char *uri = json_string_value(json_object_get(buffer, "uri"));
    uint64_t declared = (uint64_t)json_integer_value(json_object_get(buffer, "byteLength"));
    uint8_t *data = NULL;
    size_t size = 0;
    lmg_result result = LMG_OK;
    if (!uri) {
        if (!l->chunk.data)
            return lmg_fail(err, LMG_ERROR_INPUT, "buffers[%zu]: has no uri, and the file no binary part", i);
        data = malloc(l->chunk.size + 1);
        if (!data)
            return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
        memcpy(data, l->chunk.data, l->chunk.size);
        size = l->chunk.size;
    } else if (is_data_uri(uri)) {
        result = decode_data_uri(uri, &data, &size, err);
    } else {
        char *path;
        result = uri_path(l->dir, uri, &path, err);
        if (!result)
            result = lum_read_file(path, MAX_FILE_BYTES, &data, &size, err);
        free(path);
        if (!result)
            l->file->hash = lum_fnv1a(l->file->hash, data, size);
    }
    char where[128];
    snprintf(where, sizeof where, "buffers[%zu] \"%.80s\"", i, uri && !is_data_uri(uri) ? uri : "embedded");
    if (result) {
        lum_prefix_error(err, where);
        return result;
    }
    if (declared > size) {
        free(data);
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: has %zu bytes and should have %llu; it is truncated", where, size,
                        (unsigned long long)declared);
    }
    l->total += size;
    l->owned[i] = data;
    l->buffers[i] = (gltf_bytes){data, declared};
    if (l->total > MAX_BUFFER_BYTES)
        return lmg_fail(err, LMG_ERROR_INPUT, "its buffers are larger than the limit of %zu MB", MAX_BUFFER_BYTES >> 20);
    /* tinygltf asks for the buffer by this name. */
    char name[24];
    snprintf(name, sizeof name, "%zu", i);
    if (json_object_set_new(buffer, "uri", json_string(name)))
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    return LMG_OK;
}

static lmg_result load_buffers(loading *l, lmg_error *err)
{
    l->buffer_count = json_array_size(json_object_get(l->root, "buffers"));
    l->buffers = calloc(l->buffer_count + 1, sizeof *l->buffers);
    l->owned = calloc(l->buffer_count + 1, sizeof *l->owned);
    if (!l->buffers || !l->owned)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    for (size_t i = 0; i < l->buffer_count; i++)
        LUM_TRY(load_buffer(l, i, err));
    return LMG_OK;
}

/* Notes where the bytes of each entry of an array are: images, or the photometric files of EXT_lights_ies. */
static lmg_result list_entries(loading *l, const json_t *array, const char *kind, const char *kinds, gltf_image **out,
                               uint32_t *count, lmg_error *err)
{
    size_t n = json_array_size(array);
    *out = calloc(n + 1, sizeof **out);
    if (!*out)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    *count = (uint32_t)n;
    for (size_t i = 0; i < n; i++) {
        gltf_image *image = &(*out)[i];
        const json_t *entry = json_array_get(array, i);
        const char *uri = json_string_value(json_object_get(entry, "uri"));
        const char *name = json_string_value(json_object_get(entry, "name"));
        const json_t *view = json_object_get(entry, "bufferView");
        const char *label = uri && !is_data_uri(uri) ? uri : name;
        if (label && *label)
            snprintf(image->label, sizeof image->label, "%s \"%.70s\"", kind, label);
        else
            snprintf(image->label, sizeof image->label, "%s[%zu]", kinds, i);
        image->view = -1;
        if ((uri != NULL) == (view != NULL))
            return lmg_fail(err, LMG_ERROR_INPUT, "%s: needs either a uri or a bufferView", image->label);
        lmg_result result = LMG_OK;
        if (view) {
            image->view = (int32_t)json_integer_value(view);
        } else if (is_data_uri(uri)) {
            result = decode_data_uri(uri, &image->data, &image->size, err);
        } else {
            result = uri_path(l->dir, uri, &image->path, err);
        }
        if (result) {
            lum_prefix_error(err, image->label);
            return result;
        }
    }
    return LMG_OK;
}

/* Images are taken out of the document, so that the parser doesn't decode them. */
static lmg_result list_images(loading *l, lmg_error *err)
{
    gltf_file *f = l->file;
    const json_t *profiles = json_object_get(json_object_get(json_object_get(l->root, "extensions"), "EXT_lights_ies"), "lights");
    LUM_TRY(list_entries(l, json_object_get(l->root, "images"), "image", "images", &f->images, &f->image_count, err));
    LUM_TRY(list_entries(l, profiles, "light profile", "EXT_lights_ies.lights", &f->profiles, &f->profile_count, err));
    json_object_del(l->root, "images");
    return LMG_OK;
}

static lmg_result parse(loading *l, lmg_error *err)
{
    LUM_TRY(gltf_check(l->root, &l->file->ignored, err));
    LUM_TRY(gltf_check_reach(l->root, err));
    LUM_TRY(load_buffers(l, err));
    LUM_TRY(list_images(l, err));
    char *text = json_dumps(l->root, JSON_COMPACT);
    if (!text)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    lmg_result result = gltf_document_parse(text, strlen(text), l->buffers, (uint32_t)l->buffer_count, &l->file->document, err);
    free(text);
    return result;
}

lmg_result gltf_open(const char *path, gltf_file **out, lmg_error *err)
{
    *out = NULL;
    lmg_result result = LMG_OK;
    loading l = {0};
    uint8_t *bytes = NULL;
    size_t size = 0;
    const char *json = NULL;
    size_t json_size = 0;
    char *dir = strdup(path);
    l.file = calloc(1, sizeof *l.file);
    if (!dir || !l.file) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
        goto cleanup;
    }
    char *slash = strrchr(dir, '/');
    dir[slash ? slash + 1 - dir : 0] = 0;
    l.dir = dir;
    result = lum_read_file(path, MAX_FILE_BYTES, &bytes, &size, err);
    if (!result && size == 0)
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "the file is empty");
    if (!result) {
        l.file->hash = lum_fnv1a(LUM_HASH_START, bytes, size);
        result = split(bytes, size, &json, &json_size, &l.chunk, err);
    }
    if (!result)
        result = parse_json(json, json_size, &l.root, err);
    if (!result)
        result = parse(&l, err);
cleanup:
    for (size_t i = 0; i < l.buffer_count && l.owned; i++)
        free(l.owned[i]);
    free(l.owned);
    free(l.buffers);
    json_decref(l.root);
    free(bytes);
    free(dir);
    if (result) {
        gltf_close(l.file);
        l.file = NULL;
    }
    *out = l.file;
    return result;
}

void gltf_close(gltf_file *file)
{
    if (!file)
        return;
    gltf_document_free(file->document);
    gltf_image *lists[2] = {file->images, file->profiles};
    const uint32_t counts[2] = {file->image_count, file->profile_count};
    for (int k = 0; k < 2; k++) {
        for (uint32_t i = 0; i < counts[k] && lists[k]; i++) {
            free(lists[k][i].data);
            free(lists[k][i].path);
        }
        free(lists[k]);
    }
    free(file);
}

/* -------------------------------------------------------------------------------------------------------------- images */

static uint32_t big32(const uint8_t *b)
{
    return (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | (uint32_t)b[3];
}

/* Width and height from the header of a PNG or JPEG, before anything is allocated for its pixels; false for other formats. */
static bool image_size(const uint8_t *b, size_t n, uint32_t *width, uint32_t *height)
{
    if (n >= 24 && memcmp(b, "\x89PNG\r\n\x1a\n", 8) == 0) {
        *width = big32(b + 16);
        *height = big32(b + 20);
        return true;
    }
    if (n < 4 || b[0] != 0xff || b[1] != 0xd8)
        return false;
    /* JPEG: segments until a start of frame, SOF0..SOF15 without DHT (C4), JPG (C8) and DAC (CC). */
    for (size_t at = 2; at + 9 <= n;) {
        if (b[at] != 0xff)
            return false;
        uint8_t marker = b[at + 1];
        if (marker == 0xff) { /* fill byte */
            at++;
            continue;
        }
        if (marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc) {
            *height = (uint32_t)b[at + 5] << 8 | b[at + 6];
            *width = (uint32_t)b[at + 7] << 8 | b[at + 8];
            return true;
        }
        at += 2 + ((size_t)b[at + 2] << 8 | b[at + 3]);
    }
    return false;
}

static lmg_result decode(const uint8_t *bytes, size_t size, uint32_t *width, uint32_t *height, int *bits, void **pixels,
                         lmg_error *err)
{
    if (!image_size(bytes, size, width, height))
        return lmg_fail(err, LMG_ERROR_INPUT, "is neither PNG nor JPEG, or damaged; save it as PNG");
    if (*width == 0 || *height == 0 || *width > MAX_IMAGE_SIDE || *height > MAX_IMAGE_SIDE ||
        (uint64_t)*width * *height > MAX_IMAGE_PIXELS)
        return lmg_fail(err, LMG_ERROR_INPUT, "has %u x %u pixels, outside 1 .. %u a side and %u million in all; scale it", *width,
                        *height, MAX_IMAGE_SIDE, (unsigned)(MAX_IMAGE_PIXELS / 1000000));
    return gltf_image_decode(bytes, size, width, height, bits, pixels, err);
}

/* The bytes of an entry; those read from a file are added to the hash and are the caller's to free (*owned, else NULL). */
static lmg_result entry_bytes(gltf_file *file, const gltf_image *entry, gltf_bytes *bytes, uint8_t **owned, lmg_error *err)
{
    *owned = NULL;
    *bytes = (gltf_bytes){entry->data, entry->size};
    if (entry->view >= 0) {
        const gltf_view *view = &file->document->views[entry->view];
        *bytes = (gltf_bytes){file->document->buffers[view->buffer].data + view->offset, view->length};
    } else if (entry->path) {
        LUM_TRY(lum_read_file(entry->path, MAX_FILE_BYTES, owned, &bytes->size, err));
        bytes->data = *owned;
        file->hash = lum_fnv1a(file->hash, bytes->data, bytes->size);
    }
    return LMG_OK;
}

lmg_result gltf_profile_load(gltf_file *file, uint32_t index, lum_photometry **out, lmg_error *err)
{
    const gltf_profile *profile = &file->profiles[index];
    uint8_t *owned;
    gltf_bytes bytes;
    *out = NULL;
    lmg_result result = entry_bytes(file, profile, &bytes, &owned, err);
    if (!result)
        result = lum_photometry_read_memory(bytes.data, bytes.size, NULL, out, err);
    free(owned);
    if (result)
        lum_prefix_error(err, profile->label);
    return result;
}

lmg_result gltf_image_load(gltf_file *file, uint32_t index, uint32_t *width, uint32_t *height, int *bits, void **pixels,
                           lmg_error *err)
{
    const gltf_image *image = &file->images[index];
    uint8_t *owned;
    gltf_bytes bytes;
    *pixels = NULL;
    lmg_result result = entry_bytes(file, image, &bytes, &owned, err);
    if (!result)
        result = decode(bytes.data, bytes.size, width, height, bits, pixels, err);
    free(owned);
    if (result)
        lum_prefix_error(err, image->label);
    return result;
}
