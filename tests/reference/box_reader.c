/* SPDX-License-Identifier: Apache-2.0 */
/* docs/format.md, read and obeyed; relies on zlib for inflating and on a little-endian machine.  Section names are those of the text. */
#include "box_reader.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <zlib.h>

typedef struct parser {
    const unsigned char *bytes;
    size_t size, at;
    const char *wrong; /* first thing that wasn't as expected */
} parser;

static const void *take(parser *p, size_t count)
{
    static const unsigned char nothing[256];
    if (p->wrong != NULL || count > p->size - p->at) {
        p->wrong = p->wrong != NULL ? p->wrong : "ends too early";
        return nothing;
    }
    p->at += count;
    return p->bytes + p->at - count;
}

static int32_t take_int(parser *p)
{
    int32_t value;
    memcpy(&value, take(p, 4), 4);
    return value;
}

static const char *take_name(parser *p)
{
    const size_t start = p->at;
    while (p->wrong == NULL && *(const char *)take(p, 1) != 0) {
    }
    return p->wrong == NULL ? (const char *)p->bytes + start : "";
}

/* ------------------------------------------------------------------------------------------------------- Container: headers */

/* An attribute of this name and type goes to here. */
typedef struct wanted {
    const char *name, *type;
    void *to;
    size_t size;
} wanted;

static char *copy_text(const void *bytes, size_t size)
{
    char *text = calloc(size + 1, 1);
    if (text != NULL) {
        memcpy(text, bytes, size);
    }
    return text;
}

typedef struct part {
    int32_t data_window[4];
    unsigned char tiles[9], compression;
    int32_t index, uv[2], st[2];
} part;

static void read_header(parser *p, box *b, int number, part *out)
{
    box_slab *s = &b->slab[number];
    int32_t slabs = 0;
    const wanted list[] = {
        {"dataWindow", "box2i", out->data_window, 16},
        {"tiles", "tiledesc", out->tiles, 9},
        {"compression", "compression", &out->compression, 1},
        {"lumibox.slab", "int", &out->index, 4},
        {"lumibox.o", "v3d", s->o, 24},
        {"lumibox.a", "v3d", s->a, 24},
        {"lumibox.b", "v3d", s->b, 24},
        {"lumibox.n", "v3d", s->n, 24},
        {"lumibox.distance", "double", &s->distance, 8},
        {"lumibox.u", "v2d", s->u, 16},
        {"lumibox.v", "v2d", s->v, 16},
        {"lumibox.s", "v2d", s->s, 16},
        {"lumibox.t", "v2d", s->t, 16},
        {"lumibox.uvCells", "v2i", out->uv, 8},
        {"lumibox.stCells", "v2i", out->st, 8},
        {"lumibox.version", "int", &b->version, 4},
        {"lumibox.unit", "double", &s->unit, 8},
        {"lumibox.rounding", "v2d", b->rounding, 16},
        {"lumibox.slabs", "int", &slabs, 4},
        {"lumibox.channels", "int", &b->channels, 4},
        {"lumibox.colour", "v3f", b->colour, 12},
        {"lumibox.boundsMin", "v3d", b->bounds_min, 24},
        {"lumibox.boundsMax", "v3d", b->bounds_max, 24},
        {"lumibox.size", "double", &b->size, 8},
        {"lumibox.emitted", "v2d", b->flux[0], 16},
        {"lumibox.stored", "v2d", b->flux[1], 16},
        {"lumibox.residual", "v2d", b->flux[2], 16},
        {"lumibox.absorbed", "v2d", b->flux[3], 16},
        {"lumibox.lost", "v2d", b->flux[4], 16},
    };
    while (p->wrong == NULL) {
        const char *name = take_name(p);
        if (name[0] == 0) {
            break;
        }
        const char *type = take_name(p);
        const int32_t size = take_int(p);
        const void *value = take(p, size < 0 ? SIZE_MAX : (size_t)size);
        if (p->wrong != NULL) {
            break;
        }
        for (size_t i = 0; i < sizeof list / sizeof list[0]; i++) {
            if (strcmp(name, list[i].name) == 0) {
                if (strcmp(type, list[i].type) != 0 || (size_t)size != list[i].size) {
                    p->wrong = list[i].name;
                } else {
                    memcpy(list[i].to, value, list[i].size);
                }
            }
        }
        if (strcmp(name, "lumibox.kind") == 0) {
            s->aperture = size == 8 && memcmp(value, "aperture", 8) == 0;
        } else if (strcmp(name, "lumibox.photons") == 0 || strcmp(name, "lumibox.hash") == 0) {
            char *text = copy_text(value, (size_t)size);
            *(name[8] == 'p' ? &b->photons : &b->hash) = strtoull(text, NULL, name[8] == 'p' ? 10 : 16);
            free(text);
        } else if (strncmp(name, "lumibox.text.", 13) == 0 && b->texts < 64) {
            b->text_name[b->texts] = copy_text(name + 13, strlen(name + 13));
            b->text[b->texts++] = copy_text(value, (size_t)size);
        }
    }
    s->nu = (uint32_t)out->uv[0];
    s->nv = (uint32_t)out->uv[1];
    s->ns = (uint32_t)out->st[0];
    s->nt = (uint32_t)out->st[1];
    if (p->wrong == NULL && b->version != 1 && b->version != 2) {
        p->wrong = "lumibox.version";
    } else if (p->wrong == NULL && (out->index != number || (uint32_t)out->data_window[2] + 1 != s->nu * s->ns ||
                                    (uint32_t)out->data_window[3] + 1 != s->nv * s->nt)) {
        p->wrong = "sizes";
    }
}

/* --------------------------------------------------------------------------------------------------------- Container: tiles */

/* Undoes EXR's zip: inflate, running sums, then the even-numbered bytes from the first half and the odd-numbered from the second. */
static int unzip(const unsigned char *packed, size_t packed_size, unsigned char *out, size_t size)
{
    unsigned char *work = malloc(size);
    uLongf got = (uLongf)size;
    const int good = work != NULL && uncompress(work, &got, packed, (uLong)packed_size) == Z_OK && got == size;
    for (size_t i = 1; good && i < size; i++) {
        work[i] = (unsigned char)(work[i - 1] + work[i] - 128);
    }
    for (size_t i = 0; good && i < size; i++) {
        out[i] = i % 2 == 0 ? work[i / 2] : work[(size + 1) / 2 + i / 2];
    }
    free(work);
    return good;
}

/* A half float: IEEE 754 binary16. */
static double half(uint16_t h)
{
    const int exponent = h >> 10 & 31, fraction = h & 1023;
    const double size = exponent == 0 ? ldexp(fraction, -24) : ldexp(1024 + fraction, exponent - 25);
    return h >> 15 ? -size : size;
}

/* Section "Rounded cells". */
static void decode_tile(const box *b, box_slab *s, size_t first)
{
    const size_t channels = (size_t)b->channels, count = channels + 2;
    for (uint32_t it = 0; it < s->nt; it++) {
        const uint16_t *line = s->codes + (first + (size_t)it * s->ns) * count;
        for (uint32_t is = 0; is < s->ns; is++) {
            const size_t cell = first + (size_t)it * s->ns + is;
            double scale = s->unit;
            if (!s->aperture && isinf(s->distance)) {
                const double x = s->s[0] + (s->s[1] - s->s[0]) * (is + 0.5) / s->ns, y = s->t[0] + (s->t[1] - s->t[0]) * (it + 0.5) / s->nt;
                const double w = 1 + x * x + y * y;
                scale = s->unit * (w * w);
            }
            const uint16_t *y = line + (channels == 3 ? 2 * s->ns : 0);
            const double photons = half(y[is]), luminance = photons * scale;
            s->half_a[cell] = (float)(luminance * (1 + half(y[s->ns + is])));
            s->standard_error[cell] = (float)(sqrt(half(y[2 * s->ns + is]) * photons) * scale);
            if (channels == 1) {
                s->radiance[cell] = (float)luminance;
            } else {
                const double red = luminance * (1 + half(line[s->ns + is])), blue = luminance * (1 + half(line[is]));
                s->radiance[3 * cell] = (float)red;
                s->radiance[3 * cell + 1] = (float)((luminance - 0.2126 * red - 0.0722 * blue) / 0.7152);
                s->radiance[3 * cell + 2] = (float)blue;
            }
        }
    }
}

static void read_tile(parser *p, box *b, int number, uint32_t iu, uint32_t iv, int multi_part)
{
    box_slab *s = &b->slab[number];
    const size_t lines = s->nt, width = s->ns, channels = (size_t)b->channels, size = lines * width * (channels + 2) * (b->version == 2 ? 2 : 4);
    if (multi_part && take_int(p) != number) {
        p->wrong = "part number of a tile";
    }
    int32_t place[4];
    memcpy(place, take(p, 16), 16);
    const int32_t packed_size = take_int(p);
    const unsigned char *packed = take(p, packed_size < 0 ? SIZE_MAX : (size_t)packed_size);
    if (p->wrong == NULL && (place[0] != (int32_t)iu || place[1] != (int32_t)iv || place[2] != 0 || place[3] != 0)) {
        p->wrong = "place of a tile";
    }
    unsigned char *unpacked = malloc(size);
    if (p->wrong == NULL && unpacked != NULL) {
        if ((size_t)packed_size == size) {
            memcpy(unpacked, packed, size);
        } else if (!unzip(packed, (size_t)packed_size, unpacked, size)) {
            p->wrong = "a tile doesn't inflate";
        }
    }
    if (p->wrong == NULL && unpacked != NULL && b->version == 2) {
        const size_t first = ((size_t)iv * s->nu + iu) * lines * width;
        memcpy(s->codes + first * (channels + 2), unpacked, size);
        decode_tile(b, s, first);
    }
    for (size_t it = 0; p->wrong == NULL && unpacked != NULL && b->version == 1 && it < lines; it++) {
        const unsigned char *line = unpacked + it * width * (channels + 2) * 4;
        for (size_t is = 0; is < width; is++) {
            const size_t cell = (((size_t)iv * s->nu + iu) * s->nt + it) * s->ns + is;
            for (size_t c = 0; c < channels; c++) { /* B, G, R in the file */
                memcpy(&s->radiance[cell * channels + c], line + ((channels - 1 - c) * width + is) * 4, 4);
            }
            memcpy(&s->half_a[cell], line + (channels * width + is) * 4, 4);
            memcpy(&s->standard_error[cell], line + ((channels + 1) * width + is) * 4, 4);
        }
    }
    free(unpacked);
}

static void read_box(parser *p, box *b)
{
    if (take_int(p) != 20000630) {
        p->wrong = "not EXR";
    }
    const int32_t version = take_int(p), multi_part = (version & 0x1000) != 0;
    if ((version & ~0x400) != (multi_part ? 0x1002 : 0x202)) {
        p->wrong = "version field";
    }
    static part parts[32];
    memset(parts, 0, sizeof parts);
    do {
        read_header(p, b, b->slabs, &parts[b->slabs]);
        b->slabs++;
    } while (p->wrong == NULL && multi_part && b->slabs < 32 && p->at < p->size && p->bytes[p->at] != 0);
    if (multi_part) {
        take(p, 1);
    }
    for (int i = 0; i < b->slabs; i++) {
        take(p, (size_t)8 * b->slab[i].nu * b->slab[i].nv); /* the chunks follow in the same order, without gaps */
    }
    for (int i = 0; i < b->slabs && p->wrong == NULL; i++) {
        box_slab *s = &b->slab[i];
        const size_t cells = (size_t)s->nu * s->nv * s->ns * s->nt;
        s->radiance = calloc(cells * (size_t)b->channels, 4);
        s->standard_error = calloc(cells, 4);
        s->half_a = calloc(cells, 4);
        s->codes = calloc(cells * (size_t)(b->channels + 2), 2);
        if (s->codes == NULL || s->radiance == NULL || s->standard_error == NULL || s->half_a == NULL) {
            p->wrong = "no memory";
        }
        for (uint32_t iv = 0; iv < s->nv; iv++) {
            for (uint32_t iu = 0; iu < s->nu && p->wrong == NULL; iu++) {
                read_tile(p, b, i, iu, iv, multi_part);
            }
        }
    }
    if (p->wrong == NULL && p->at != p->size) {
        p->wrong = "something follows";
    }
}

int box_read(const char *path, box *out, char message[256])
{
    memset(out, 0, sizeof *out);
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        snprintf(message, 256, "can't open");
        return -1;
    }
    fseek(file, 0, SEEK_END);
    const long length = ftell(file);
    rewind(file);
    unsigned char *bytes = malloc((size_t)length + 1);
    parser p = {.bytes = bytes, .size = bytes == NULL ? 0 : fread(bytes, 1, (size_t)length, file)};
    fclose(file);
    read_box(&p, out);
    if (p.wrong == NULL && box_hash(out) != out->hash) {
        p.wrong = "content hash";
    }
    snprintf(message, 256, "%s", p.wrong == NULL ? "" : p.wrong);
    free(bytes);
    return p.wrong == NULL ? 0 : -1;
}

void box_free(box *b)
{
    for (int i = 0; i < b->slabs; i++) {
        free(b->slab[i].radiance);
        free(b->slab[i].standard_error);
        free(b->slab[i].half_a);
        free(b->slab[i].codes);
    }
    for (int i = 0; i < b->texts; i++) {
        free(b->text_name[i]);
        free(b->text[i]);
    }
}

/* ------------------------------------------------------------------------------------------------------------ Content hash */

static void fnv(uint64_t *hash, const void *bytes, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        *hash = (*hash ^ ((const unsigned char *)bytes)[i]) * 1099511628211u;
    }
}

static void fnv_u32(uint64_t *hash, uint32_t value)
{
    fnv(hash, &value, 4);
}

uint64_t box_hash(const box *b)
{
    const uint64_t offset = 14695981039346656037u;
    uint64_t h = offset;
    fnv(&h, "LUMIBOX", 7);
    fnv_u32(&h, (uint32_t)b->version);
    fnv_u32(&h, (uint32_t)b->slabs);
    fnv_u32(&h, (uint32_t)b->channels);
    fnv(&h, b->colour, 12);
    fnv(&h, b->bounds_min, 24);
    fnv(&h, b->bounds_max, 24);
    fnv(&h, &b->size, 8);
    fnv(&h, &b->photons, 8);
    fnv(&h, b->flux, 80);
    if (b->version == 2) {
        fnv(&h, b->rounding, 16);
    }
    for (int i = 0; i < b->slabs; i++) {
        const box_slab *s = &b->slab[i];
        fnv_u32(&h, (uint32_t)s->aperture);
        const double *all[] = {s->o, s->a, s->b, s->n, &s->distance, s->u, s->v, s->s, s->t};
        const size_t sizes[] = {24, 24, 24, 24, 8, 16, 16, 16, 16};
        for (int k = 0; k < 9; k++) {
            fnv(&h, all[k], sizes[k]);
        }
        fnv_u32(&h, s->nu);
        fnv_u32(&h, s->nv);
        fnv_u32(&h, s->ns);
        fnv_u32(&h, s->nt);
        if (b->version == 2) {
            fnv(&h, &s->unit, 8);
        }
    }
    fnv_u32(&h, (uint32_t)b->texts);
    const char *last = "";
    for (int i = 0; i < b->texts; i++) { /* by name, whatever their order in the file */
        int next = -1;
        for (int k = 0; k < b->texts; k++) {
            if (strcmp(b->text_name[k], last) > 0 && (next < 0 || strcmp(b->text_name[k], b->text_name[next]) < 0)) {
                next = k;
            }
        }
        last = b->text_name[next];
        fnv(&h, last, strlen(last) + 1);
        fnv(&h, b->text[next], strlen(b->text[next]) + 1);
    }
    for (int i = 0; i < b->slabs; i++) {
        const box_slab *s = &b->slab[i];
        const size_t tile = (size_t)s->ns * s->nt, channels = (size_t)b->channels;
        for (size_t k = 0; k < (size_t)s->nu * s->nv; k++) {
            uint64_t of_tile = offset;
            if (b->version == 2) {
                fnv(&of_tile, s->codes + k * tile * (channels + 2), tile * (channels + 2) * 2);
                fnv(&h, &of_tile, 8);
                continue;
            }
            fnv(&of_tile, s->radiance + k * tile * channels, tile * channels * 4);
            fnv(&of_tile, s->standard_error + k * tile, tile * 4);
            fnv(&of_tile, s->half_a + k * tile, tile * 4);
            fnv(&h, &of_tile, 8);
        }
    }
    return h;
}
