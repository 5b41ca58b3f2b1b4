/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Writes box files: docs/format.md in C.  Relies on OpenEXRCore for packing tiles and placing them, and on exr_attributes.c for the
 * headers.
 *
 * Tiles are independent, so hashing and encoding are shared out over the processors; the file doesn't depend on how many there are.
 */
#include "box_hash.h"
#include "cell_code.h"
#include "exr_attributes.h"
#include "file_message.h"
#include "exr_write.h"
#include "work.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Measured on boxes of 1 to 14 million cells (tests/bench/bench_io.c): level 4 writes two to six times as fast as 9 and is 1 to 2 %
 * larger. */
enum { ZIP_LEVEL = 4, ROUNDED_ZIP_LEVEL = 6 };

/* The packed form of one tile on its way from the thread that made it to the file. */
typedef struct packed_tile {
    void *bytes; /* owned */
    size_t size;
} packed_tile;

typedef struct writer {
    lmg_exr_file file;
    const lmg_field *field;
    exr_compression_t compression;
    int level;
    const lmg_codes *codes; /* cells to be rounded, or NULL */
    lmg_tiles tiles;
    packed_tile *packed; /* tiles.end - tiles.first of them */
} writer;

typedef struct encoder {
    bool started;
    int part;
    packed_tile *target;
    exr_encode_pipeline_t pipeline;
} encoder;

_Static_assert(sizeof(encoder) <= LMG_WORK_SCRATCH, "a thread's scratch space holds its encoder");

/* Stands in for the pipeline's writing: keeps the packed bytes until it's their turn. */
static exr_result_t keep_packed(exr_encode_pipeline_t *pipeline)
{
    packed_tile *target = ((encoder *)pipeline->encoding_user_data)->target;
    const void *bytes = pipeline->compressed_buffer;
    target->size = pipeline->compressed_bytes;
    /* No compression, or none gained.  When deflating ends at just the unpacked size, OpenEXRCore 3.1.5 hands over the deflated
     * bytes, which every reader would take for unpacked ones. */
    if (bytes == NULL || target->size == 0 || target->size >= pipeline->packed_bytes) {
        bytes = pipeline->packed_buffer;
        target->size = pipeline->packed_bytes;
    }
    target->bytes = malloc(target->size);
    if (target->bytes == NULL) {
        return EXR_ERR_OUT_OF_MEMORY;
    }
    memcpy(target->bytes, bytes, target->size);
    return EXR_ERR_SUCCESS;
}

static lmg_result pack_tile(writer *w, encoder *e, uint32_t slab, uint64_t tile_in_slab, packed_tile *target, lmg_error *err)
{
    const lmg_slab *s = &w->field->layout.slabs[slab];
    const lmg_slab_data *data = &w->field->slabs[slab];
    const int part = (int)slab, column = (int)(tile_in_slab % s->nu), row = (int)(tile_in_slab / s->nu);
    exr_chunk_info_t chunk;
    exr_result_t exr = exr_write_tile_chunk_info(w->file.context, part, column, row, 0, 0, &chunk);
    if (exr == EXR_ERR_SUCCESS && e->started && e->part != part) {
        exr_encoding_destroy(w->file.context, &e->pipeline);
        memset(e, 0, sizeof *e);
    }
    const bool fresh = !e->started;
    if (exr == EXR_ERR_SUCCESS) {
        if (fresh) {
            exr = exr_encoding_initialize(w->file.context, part, &chunk, &e->pipeline);
            e->started = exr == EXR_ERR_SUCCESS;
            e->part = part;
        } else {
            exr = exr_encoding_update(w->file.context, part, &chunk, &e->pipeline);
        }
    }
    if (exr == EXR_ERR_SUCCESS) {
        const uint64_t channels = w->field->layout.channels, first = tile_in_slab * lmg_tile_cells(s);
        for (int c = 0; c < e->pipeline.channel_count; c++) {
            exr_coding_channel_info_t *info = &e->pipeline.channels[c];
            if (w->codes != NULL) {
                const uint64_t count = channels + 2;
                info->encode_from_ptr = (const uint8_t *)(w->codes->of[slab] + first * count + (uint64_t)c * s->ns);
                info->user_data_type = EXR_PIXEL_HALF;
                info->user_bytes_per_element = sizeof(uint16_t);
                info->user_pixel_stride = sizeof(uint16_t);
                info->user_line_stride = (int32_t)(count * sizeof(uint16_t) * s->ns);
                continue;
            }
            const float *from;
            uint64_t step = 1;
            if (strcmp(info->channel_name, "half_a.Y") == 0) {
                from = data->half_a + first;
            } else if (strcmp(info->channel_name, "stderr.Y") == 0) {
                from = data->standard_error + first;
            } else { /* B, G, R; or Y */
                step = data->stride;
                from = lmg_cell_radiance(data, first) + (channels == 3 ? 2 - c : 0);
            }
            info->encode_from_ptr = (const uint8_t *)from;
            info->user_data_type = EXR_PIXEL_FLOAT;
            info->user_bytes_per_element = sizeof(float);
            info->user_pixel_stride = (int32_t)(step * sizeof(float));
            info->user_line_stride = (int32_t)(step * sizeof(float) * s->ns);
        }
        if (fresh) {
            exr = exr_encoding_choose_default_routines(w->file.context, part, &e->pipeline);
            e->pipeline.write_fn = keep_packed;
            e->pipeline.yield_until_ready_fn = NULL;
            e->pipeline.encoding_user_data = e;
        }
    }
    e->target = target;
    if (exr == EXR_ERR_SUCCESS) {
        exr = exr_encoding_run(w->file.context, part, &e->pipeline);
    }
    return exr == EXR_ERR_SUCCESS ? LMG_OK : lmg_exr_fail(err, LMG_ERROR_FILE_WRITE, &w->file, "can't encode a tile", exr);
}

static lmg_result pack_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    writer *w = self;
    const uint64_t first = w->tiles.first + index * w->tiles.run;
    const uint64_t after = first + w->tiles.run < w->tiles.end ? first + w->tiles.run : w->tiles.end;
    for (uint64_t tile = first; tile < after; tile++) {
        const uint32_t slab = lmg_tile_slab(&w->tiles, tile);
        LMG_TRY(pack_tile(w, scratch, slab, tile - w->tiles.start[slab], &w->packed[tile - w->tiles.first], err));
    }
    return LMG_OK;
}

static void pack_end(void *self, void *scratch)
{
    const writer *w = self;
    encoder *e = scratch;
    if (e->started) {
        exr_encoding_destroy(w->file.context, &e->pipeline);
    }
}

static lmg_result hash_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    (void)scratch;
    writer *w = self;
    const uint64_t first = index * w->tiles.run, after = first + w->tiles.run < w->tiles.end ? first + w->tiles.run : w->tiles.end;
    for (uint64_t tile = first; tile < after; tile++) {
        const uint32_t slab = lmg_tile_slab(&w->tiles, tile);
        const uint64_t tile_in_slab = tile - w->tiles.start[slab];
        if (!lmg_tile_is_sound(&w->tiles, slab, tile_in_slab)) {
            const uint32_t nu = w->field->layout.slabs[slab].nu;
            return lmg_fail(err, LMG_ERROR_ARGUMENT,
                            "%s: slab %u, cell u %u, v %u holds a value that is no finite number, or a negative standard error",
                            w->file.where, slab, (unsigned)(tile_in_slab % nu), (unsigned)(tile_in_slab / nu));
        }
        if (w->codes != NULL) {
            const uint64_t cells = lmg_tile_cells(&w->field->layout.slabs[slab]), count = w->field->layout.channels + 2;
            w->tiles.hashes[tile] = lmg_hash_codes(w->codes->of[slab] + tile_in_slab * cells * count, cells * count);
        }
    }
    if (w->codes == NULL) {
        lmg_hash_tiles(&w->tiles, first, after);
    }
    return LMG_OK;
}

/* Tiles are packed in batches of about this much data: enough for the processors, little beside the field itself. */
enum { BATCH_BYTES = 16 << 20 };

static lmg_result write_tiles(writer *w, lmg_error *err)
{
    const uint64_t all = w->tiles.end;
    uint64_t batch = w->tiles.run * (BATCH_BYTES / LMG_RUN_BYTES);
    batch = batch < all ? batch : all;
    w->packed = calloc((size_t)batch, sizeof *w->packed);
    if (w->packed == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for packing tiles", w->file.where);
    }
    lmg_result result = LMG_OK;
    for (uint64_t first = 0; first < all && result == LMG_OK; first += batch) {
        w->tiles.first = first;
        w->tiles.end = first + batch < all ? first + batch : all;
        lmg_work job = {.piece = pack_run,
                        .end = pack_end,
                        .self = w,
                        .scratch_size = sizeof(encoder),
                        .count = (w->tiles.end - first + w->tiles.run - 1) / w->tiles.run};
        result = lmg_work_do(&job, err);
        for (uint64_t tile = first; tile < w->tiles.end; tile++) {
            packed_tile *packed = &w->packed[tile - first];
            if (result == LMG_OK) {
                const uint32_t slab = lmg_tile_slab(&w->tiles, tile), nu = w->field->layout.slabs[slab].nu;
                const uint64_t in_slab = tile - w->tiles.start[slab];
                const exr_result_t exr = exr_write_tile_chunk(w->file.context, (int)slab, (int)(in_slab % nu), (int)(in_slab / nu),
                                                              0, 0, packed->bytes, packed->size);
                if (exr != EXR_ERR_SUCCESS) {
                    result = lmg_exr_fail(err, LMG_ERROR_FILE_WRITE, &w->file, "can't write a tile", exr);
                }
            }
            free(packed->bytes);
            *packed = (packed_tile){.bytes = NULL};
        }
    }
    w->tiles.first = 0;
    w->tiles.end = all;
    free(w->packed);
    w->packed = NULL;
    return result;
}

/* Writes the field to an open, empty file. */
static lmg_result write_exr(writer *w, const char *path, lmg_error *err)
{
    lmg_tiles_init(&w->tiles, &w->field->layout);
    w->tiles.field = w->field;
    if (w->codes != NULL) {
        w->tiles.units = w->codes->units;
        w->tiles.rounding = w->codes->rounding;
    }
    w->tiles.hashes = calloc((size_t)w->tiles.end, sizeof *w->tiles.hashes);
    w->file.stream.buffer = malloc(LMG_EXR_WRITE_BUFFER);
    lmg_result result = LMG_OK;
    if (w->tiles.hashes == NULL || w->file.stream.buffer == NULL) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for writing", w->file.where);
    }
    if (result == LMG_OK) {
        lmg_work job = {.piece = hash_run, .self = w, .count = (w->tiles.end + w->tiles.run - 1) / w->tiles.run};
        result = lmg_work_do(&job, err);
    }
    if (result == LMG_OK) {
        exr_context_initializer_t init = lmg_exr_initializer(&w->file.stream);
        init.write_fn = lmg_exr_stream_write;
        init.zip_level = w->level;
        exr_result_t exr = exr_start_write(&w->file.context, w->file.where, EXR_WRITE_FILE_DIRECTLY, &init);
        if (exr != EXR_ERR_SUCCESS) {
            result = lmg_exr_fail(err, LMG_ERROR_FILE_WRITE, &w->file, "can't start writing", exr);
        }
        if (result == LMG_OK) {
            result = lmg_exr_write_header(&w->file, &w->tiles, w->compression, lmg_hash_field(&w->tiles), err);
        }
        if (result == LMG_OK) {
            result = write_tiles(w, err);
        }
        exr = exr_finish(&w->file.context);
        if (result == LMG_OK && exr != EXR_ERR_SUCCESS) {
            result = lmg_exr_fail(err, LMG_ERROR_FILE_WRITE, &w->file, "can't finish the file", exr);
        }
    }
    if (result == LMG_OK && (!lmg_exr_flush(&w->file.stream) || fsync(w->file.stream.fd) != 0)) {
        result = lmg_fail_errno(err, LMG_ERROR_FILE_WRITE, path, "can't write",
                                w->file.stream.write_errno != 0 ? w->file.stream.write_errno : errno);
    } else if (result != LMG_OK && w->file.stream.write_errno != 0) { /* OpenEXRCore only knows that writing failed, not why */
        result = lmg_fail_errno(err, LMG_ERROR_FILE_WRITE, path, "can't write", w->file.stream.write_errno);
    }
    free(w->file.stream.buffer);
    free(w->tiles.hashes);
    return result;
}

/* A new, empty file in the target's directory.  Its name doesn't grow with the target's, which may be as long as names can be. */
static lmg_result create_temporary(const char *path, char **name, int *fd, lmg_error *err)
{
    const char *slash = strrchr(path, '/');
    const size_t directory = slash == NULL ? 0 : (size_t)(slash - path) + 1;
    const size_t room = directory + 64;
    *name = malloc(room);
    if (*name == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its name", lmg_show_path(path).text);
    }
    memcpy(*name, path, directory);
    for (unsigned attempt = 0; attempt < 10000; attempt++) {
        snprintf(*name + directory, room - directory, ".lumibox-%ld-%u.tmp", (long)getpid(), attempt);
        *fd = open(*name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (*fd >= 0) {
            return LMG_OK;
        }
        if (errno != EEXIST) {
            break;
        }
    }
    const int number = errno;
    free(*name);
    *name = NULL;
    return lmg_fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't create a file in its directory", number);
}

/* Makes the new name itself last through a crash.  Some file systems can't sync directories; the file is complete all the same. */
static void sync_directory(const char *path)
{
    char *directory = strdup(path);
    if (directory != NULL) {
        char *slash = strrchr(directory, '/');
        if (slash != NULL) {
            slash[slash == directory ? 1 : 0] = 0;
        }
        const int fd = open(slash != NULL ? directory : ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
        if (fd >= 0) {
            (void)fsync(fd);
            close(fd);
        }
        free(directory);
    }
}

static lmg_result write_field(const lmg_field *field, const lmg_codes *codes, const char *path, lmg_exr_compression compression, int level,
                              lmg_error *err)
{
    if (field == NULL || path == NULL || path[0] == 0) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lmg_field_write: no field or no path");
    }
    const lmg_shown_path where = lmg_show_path(path);
    struct stat info;
    if (stat(path, &info) == 0 && !S_ISREG(info.st_mode)) { /* renaming would put a file in a device's place */
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: is %s; name a file", where.text,
                        S_ISDIR(info.st_mode) ? "a directory" : "not a regular file");
    }
    if (path[strlen(path) - 1] == '/') {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: names a directory; name a file", where.text);
    }
    LMG_TRY(lmg_box_check(field, where.text, LMG_ERROR_ARGUMENT, err));
    writer *w = calloc(1, sizeof *w);
    if (w == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory", where.text);
    }
    w->field = field;
    w->codes = codes;
    w->file.where = where.text;
    w->compression = compression == LMG_EXR_NONE   ? EXR_COMPRESSION_NONE
                     : compression == LMG_EXR_ZIPS ? EXR_COMPRESSION_ZIPS
                                                   : EXR_COMPRESSION_ZIP;
    w->level = level;
    if (pthread_mutex_init(&w->file.stream.lock, NULL) != 0) {
        free(w);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: can't make a lock", where.text);
    }
    char *temporary = NULL;
    lmg_result result = create_temporary(path, &temporary, &w->file.stream.fd, err);
    if (result == LMG_OK) {
        result = write_exr(w, path, err);
        if (close(w->file.stream.fd) != 0 && result == LMG_OK) {
            result = lmg_fail_errno(err, LMG_ERROR_FILE_WRITE, path, "can't write", errno);
        }
        if (result == LMG_OK && rename(temporary, path) != 0) {
            result = lmg_fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't give the finished file its name", errno);
        }
        if (result == LMG_OK) {
            sync_directory(path);
        } else {
            unlink(temporary);
        }
        free(temporary);
    }
    pthread_mutex_destroy(&w->file.stream.lock);
    free(w);
    return result;
}

lmg_result lmg_field_write(const lmg_field *field, const char *path, lmg_error *err)
{
    return lmg_field_write_as(field, path, LMG_EXR_ZIP, ZIP_LEVEL, err);
}

lmg_result lmg_field_write_rounded(const lmg_field *field, const char *path, double loss, lmg_rounding *out, lmg_error *err)
{
    if (field == NULL || !(loss > 0 && loss <= 1)) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lmg_field_write_rounded: no field, or a loss of %g; above 0 and at most 1 is possible", loss);
    }
    lmg_codes codes;
    bool possible;
    lmg_result result = lmg_codes_create(&codes, field, loss, &possible, err);
    if (result == LMG_OK) {
        result = write_field(field, possible ? &codes : NULL, path, LMG_EXR_ZIP, possible ? ROUNDED_ZIP_LEVEL : ZIP_LEVEL, err);
    }
    if (out != NULL) {
        *out = codes.rounding;
    }
    lmg_codes_destroy(&codes);
    return result;
}

lmg_result lmg_field_write_as(const lmg_field *field, const char *path, lmg_exr_compression compression, int level, lmg_error *err)
{
    return write_field(field, NULL, path, compression, level, err);
}
