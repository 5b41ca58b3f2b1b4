/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Parts of a bake in files: checkpoints, and what `lumibake merge` reads.
 *
 *     lumibox part 1 NNNNNNNNNN\n      N: bytes of the head, ten digits
 *     head\n                           JSON: texts, numbers, tally, ranges; any editor shows what a file is
 *     counts                           lmg_accumulator_save
 *     \nHHHHHHHHHHHHHHHH\n             FNV-1a 64 of all before this line's first byte, hexadecimal
 *
 * The hash tells accidents; against malice every value is checked as well.  Relies on jansson and POSIX files.
 */
#include "part.h"

#include <jansson.h>

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char MAGIC[] = "lumibox part 1 ";
enum { LINE = sizeof(MAGIC) - 1 + 10 + 1, TRAILER = 1 + 16 + 1 };

/* The numbers of a part by name.  A new member of bake_tally belongs here and in add_tally (part.c). */
_Static_assert(sizeof(bake_tally) == 64, "NUMBERS and add_tally must list every member of bake_tally");
static const struct {
    const char *name;
    size_t offset;
} NUMBERS[] = {
    {"source_flux", offsetof(bake_part, source_flux)},
    {"flux_lm", offsetof(bake_part, flux_lm)},
    {"output_flux_lm", offsetof(bake_part, output_flux_lm)},
    {"seconds", offsetof(bake_part, seconds)},
    {"emitted", offsetof(bake_part, tally.emitted)},
    {"escaped", offsetof(bake_part, tally.escaped)},
    {"escaped_squares", offsetof(bake_part, tally.escaped_squares)},
    {"absorbed", offsetof(bake_part, tally.absorbed)},
    {"lost", offsetof(bake_part, tally.lost)},
    {"lost_inside", offsetof(bake_part, tally.lost_inside)},
}, COUNTS[] = {
    {"photons", offsetof(bake_part, tally.photons)},
    {"segments", offsetof(bake_part, tally.segments)},
    {"pilot", offsetof(bake_part, pilot_photons)},
};
enum { NUMBER_COUNT = sizeof(NUMBERS) / sizeof(NUMBERS[0]), COUNT_COUNT = sizeof(COUNTS) / sizeof(COUNTS[0]) };

/* -------------------------------------------------------------------------------------------------------------- saving */

typedef struct hashed {
    lmg_write_bytes write;
    void *self;
    uint64_t hash;
} hashed;

static uint64_t fnv(uint64_t hash, const void *bytes, size_t count)
{
    const unsigned char *b = bytes;
    for (size_t i = 0; i < count; ++i)
        hash = (hash ^ b[i]) * 0x100000001b3u;
    return hash;
}
static const uint64_t FNV_START = 0xcbf29ce484222325u;

static bool write_hashed(void *self, const void *bytes, size_t count)
{
    hashed *h = self;
    h->hash = fnv(h->hash, bytes, count);
    return h->write(h->self, bytes, count);
}

/* The head as JSON, or NULL.  jansson lets a failed call pass NULL on, and its containers refuse that. */
static char *head_text(const bake_part *part)
{
    json_t *texts = json_object(), *ranges = json_array(), *head = json_object();
    bool good = true;
    for (int i = 0; i < PART_TEXT_COUNT; ++i)
        if (part->texts[i])
            good &= json_object_set_new(texts, bake_part_text_name((bake_part_text)i), json_string(part->texts[i])) == 0;
    for (size_t i = 0; i < part->range_count; ++i)
        good &= json_array_append_new(
                    ranges, json_pack("[II]", (json_int_t)part->ranges[i].first, (json_int_t)part->ranges[i].count)) == 0;
    good &= json_object_set_new(head, "texts", texts) == 0;
    good &= json_object_set_new(head, "ranges", ranges) == 0;
    for (int i = 0; i < NUMBER_COUNT; ++i) {
        double value;
        memcpy(&value, (const char *)part + NUMBERS[i].offset, sizeof(value));
        good &= json_object_set_new(head, NUMBERS[i].name, json_real(value)) == 0;
    }
    for (int i = 0; i < COUNT_COUNT; ++i) {
        uint64_t value;
        memcpy(&value, (const char *)part + COUNTS[i].offset, sizeof(value));
        good &= json_object_set_new(head, COUNTS[i].name, json_integer((json_int_t)value)) == 0;
    }
    /* JSON has no infinity; a pilot that met the measuring rectangle nowhere has an infinite noise */
    if (isfinite(part->pilot_noise))
        good &= json_object_set_new(head, "pilot_noise", json_real(part->pilot_noise)) == 0;
    char *text = good ? json_dumps(head, JSON_COMPACT | JSON_SORT_KEYS | JSON_REAL_PRECISION(17)) : NULL;
    json_decref(head);
    return text;
}

lmg_result bake_part_save(const bake_part *part, lmg_write_bytes write, void *self, lmg_error *err)
{
    char *head = head_text(part);
    if (!head)
        return lmg_fail(err, LMG_ERROR_INTERNAL, "the state of the bake can't be put into words");
    hashed h = {write, self, FNV_START};
    char line[LINE + 1], trailer[TRAILER + 1];
    const size_t length = strlen(head);
    snprintf(line, sizeof(line), "%s%010zu\n", MAGIC, length % 10000000000u);
    lmg_result result = write_hashed(&h, line, LINE) && write_hashed(&h, head, length) && write_hashed(&h, "\n", 1)
                            ? LMG_OK
                            : lmg_fail(err, LMG_ERROR_FILE_WRITE, "writing the head failed");
    free(head);
    if (result == LMG_OK)
        result = lmg_accumulator_save(part->accumulator, write_hashed, &h, err);
    snprintf(trailer, sizeof(trailer), "\n%016" PRIx64 "\n", h.hash);
    if (result == LMG_OK && !write(self, trailer, TRAILER))
        result = lmg_fail(err, LMG_ERROR_FILE_WRITE, "writing the end failed");
    return result;
}

/* ------------------------------------------------------------------------------------------------------------- loading */

static bool get_ranges(const json_t *head, bake_part *part)
{
    const json_t *ranges = json_object_get(head, "ranges");
    if (!json_is_array(ranges))
        return false;
    uint64_t photons = 0, last = 0;
    for (size_t i = 0; i < json_array_size(ranges); ++i) {
        const json_t *pair = json_array_get(ranges, i);
        const json_t *first = json_array_get(pair, 0), *count = json_array_get(pair, 1);
        if (!json_is_integer(first) || !json_is_integer(count) || json_integer_value(first) < 0 || json_integer_value(count) <= 0)
            return false;
        const uint64_t f = (uint64_t)json_integer_value(first), n = (uint64_t)json_integer_value(count);
        if ((i > 0 && f < last) || bake_part_add_range(part, f, n, NULL) != LMG_OK)
            return false;
        last = f + n;
        photons += n;
    }
    return photons == part->tally.photons;
}

static bool get_head(const json_t *head, bake_part *part)
{
    const json_t *texts = json_object_get(head, "texts");
    for (int i = 0; i < PART_TEXT_COUNT; ++i) {
        const json_t *text = json_object_get(texts, bake_part_text_name((bake_part_text)i));
        if (text && (!json_is_string(text) || bake_part_set_text(part, (bake_part_text)i, json_string_value(text), NULL) != LMG_OK))
            return false;
    }
    for (int i = 0; i < NUMBER_COUNT; ++i) {
        const json_t *number = json_object_get(head, NUMBERS[i].name);
        const double value = json_real_value(number);
        /* sums of photons' shares: whole numbers within what a double counts exactly; the fluxes' bound is as good as any */
        if (!json_is_real(number) || !isfinite(value) || fabs(value) > 0x1p62)
            return false;
        memcpy((char *)part + NUMBERS[i].offset, &value, sizeof(value));
    }
    for (int i = 0; i < COUNT_COUNT; ++i) {
        const json_t *number = json_object_get(head, COUNTS[i].name);
        if (!json_is_integer(number) || json_integer_value(number) < 0)
            return false;
        const uint64_t value = (uint64_t)json_integer_value(number);
        memcpy((char *)part + COUNTS[i].offset, &value, sizeof(value));
    }
    const json_t *noise = json_object_get(head, "pilot_noise");
    part->pilot_noise = noise ? json_real_value(noise) : (double)INFINITY;
    return part->texts[PART_MODEL] && part->texts[PART_SEED] && part->source_flux > 0 && part->flux_lm >= 0 &&
           part->output_flux_lm >= 0 && part->seconds >= 0 && part->pilot_noise >= 0 && get_ranges(head, part);
}

lmg_result bake_part_load(const void *bytes, size_t size, const char *name, bake_part **out, lmg_error *err)
{
    *out = NULL;
    const char *b = bytes;
    const size_t magic = sizeof(MAGIC) - 1;
    if (size < magic || memcmp(b, MAGIC, magic - 2) != 0)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%.200s: not a checkpoint or part of a bake", name);
    if (memcmp(b, MAGIC, magic) != 0)
        return lmg_fail(err, LMG_ERROR_FILE_VERSION, "%.200s: a part of a version that this program doesn't know; update it", name);
    uint64_t length = 0;
    bool good = size >= LINE + 1 + TRAILER && b[LINE - 1] == '\n';
    for (size_t i = magic; good && i < LINE - 1; ++i) {
        good = b[i] >= '0' && b[i] <= '9';
        length = 10 * length + (uint64_t)(b[i] - '0');
    }
    good = good && length <= size - (LINE + 1 + TRAILER);
    char trailer[TRAILER + 1];
    if (good)
        snprintf(trailer, sizeof(trailer), "\n%016" PRIx64 "\n", fnv(FNV_START, b, size - TRAILER));
#ifndef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION /* or a fuzzer would hardly get past this line */
    good = good && memcmp(b + size - TRAILER, trailer, TRAILER) == 0;
#endif
    if (!good)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%.200s: cut short or altered: its hash doesn't fit; use another copy or bake again", name);

    bake_part *part;
    lmg_result result = bake_part_create(&part, err);
    if (result != LMG_OK)
        return result;
    json_t *head = json_loadb(b + LINE, (size_t)length, JSON_REJECT_DUPLICATES, NULL);
    if (!head || !get_head(head, part) || b[LINE + length] != '\n')
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%.200s: its head is not that of a part of a bake", name);
    json_decref(head);
    lmg_error why = {{0}};
    if (result == LMG_OK) {
        const size_t at = LINE + (size_t)length + 1;
        result = lmg_accumulator_load(b + at, size - TRAILER - at, &part->accumulator, &why);
        if (result != LMG_OK)
            lmg_fail(err, result, "%.200s: %.250s", name, why.message);
    }
    if (result == LMG_OK)
        *out = part;
    else
        bake_part_destroy(part);
    return result;
}

/* --------------------------------------------------------------------------------------------------------------- files */

/* "path: what: the system's reason". */
static lmg_result fail_errno(lmg_error *err, lmg_result code, const char *path, const char *what)
{
    const int number = errno;
    return lmg_fail(err, code, "%.300s: %s: %s", path, what, strerror(number));
}

static bool write_file(void *self, const void *bytes, size_t count)
{
    return fwrite(bytes, 1, count, self) == count;
}

/* Makes a new name in its directory last through a crash; file systems that can't have the whole file all the same. */
static void sync_folder_of(const char *path)
{
    char folder[PATH_MAX];
    const char *slash = strrchr(path, '/');
    snprintf(folder, sizeof(folder), "%.*s", slash ? (int)(slash - path) + 1 : 1, slash ? path : ".");
    const int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0)
        return;
    (void)fsync(fd);
    close(fd);
}

lmg_result bake_part_write(const bake_part *part, const char *path, lmg_error *err)
{
    /* always the same name: what a killed program leaves behind, the next one overwrites */
    char beside[PATH_MAX];
    if (snprintf(beside, sizeof(beside), "%s.new", path) >= (int)sizeof(beside))
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.200s...: the name is too long", path);
    FILE *file = fopen(beside, "wb");
    if (!file)
        return fail_errno(err, LMG_ERROR_FILE_OPEN, beside, "can't create it");
    lmg_error why = {{0}};
    lmg_result result = bake_part_save(part, write_file, file, &why);
    if (result == LMG_ERROR_FILE_WRITE || (result == LMG_OK && (fflush(file) != 0 || fsync(fileno(file)) != 0)))
        result = fail_errno(err, LMG_ERROR_FILE_WRITE, beside, "can't write");
    else if (result != LMG_OK)
        lmg_fail(err, result, "%.200s: %.250s", path, why.message);
    if (fclose(file) != 0 && result == LMG_OK)
        result = fail_errno(err, LMG_ERROR_FILE_WRITE, beside, "can't write");
    if (result == LMG_OK && rename(beside, path) != 0)
        result = fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't give the finished file its name");
    if (result == LMG_OK)
        sync_folder_of(path);
    else
        unlink(beside);
    return result;
}

lmg_result bake_part_read(const char *path, bake_part **out, lmg_error *err)
{
    *out = NULL;
    FILE *file = fopen(path, "rb");
    if (!file)
        return fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't open it");
    struct stat status;
    lmg_result result = LMG_OK;
    char *bytes = NULL;
    if (fstat(fileno(file), &status) != 0 || !S_ISREG(status.st_mode))
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "%.300s: not a regular file", path);
    const size_t size = result == LMG_OK ? (size_t)status.st_size : 0;
    if (result == LMG_OK && !(bytes = malloc(size + 1)))
        result = lmg_fail(err, LMG_ERROR_MEMORY, "%.300s: no memory for its %zu bytes", path, size);
    if (result == LMG_OK && fread(bytes, 1, size, file) != size)
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "%.300s: can't read it", path);
    fclose(file);
    if (result == LMG_OK)
        result = bake_part_load(bytes, size, path, out, err);
    free(bytes);
    return result;
}
