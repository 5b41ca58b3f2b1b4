/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reads box files: docs/format.md in C.  Relies on OpenEXRCore for headers and tiles, on exr_check.c, which sees every byte before
 * OpenEXRCore does, and on exr_attributes.c for what the headers mean.
 *
 * Reading takes the whole file into memory first: what was checked is then what is decoded, even if somebody rewrites the file
 * meanwhile.  Tiles are independent, so decoding and hashing are shared out over the processors; the result doesn't depend on how
 * many there are.
 */
#include "box_hash.h"
#include "cell_code.h"
#include "exr_attributes.h"
#include "exr_check.h"
#include "file_message.h"
#include "work.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "exr_read.c copies floats from EXR's little-endian order to memory; a big-endian machine needs a swap there"
#endif

typedef struct reader {
    lmg_exr_file file;
    lmg_layout layout;
    lmg_field *field;
    lmg_tiles tiles;
    int32_t version;
    double units[LMG_MAX_SLABS];     /* of rounded cells */
    double *scales[LMG_MAX_SLABS];   /* lmg_code_scales; NULL: cells to the bit */
} reader;

/* A thread's decoder; one is good for all tiles of a part, so it's renewed when the part changes. */
typedef struct decoder {
    bool started;
    int part;
    exr_decode_pipeline_t pipeline;
} decoder;

_Static_assert(sizeof(decoder) <= LMG_WORK_SCRATCH, "a thread's scratch space holds its decoder");

/* Decompresses a tile into the decoder's buffer. */
static exr_result_t decode(const reader *r, decoder *d, int part, const exr_chunk_info_t *chunk)
{
    exr_result_t exr;
    if (d->started && d->part != part) {
        exr_decoding_destroy(r->file.context, &d->pipeline);
        memset(d, 0, sizeof *d);
    }
    if (d->started) {
        exr = exr_decoding_update(r->file.context, part, chunk, &d->pipeline);
    } else {
        exr = exr_decoding_initialize(r->file.context, part, chunk, &d->pipeline);
        d->started = exr == EXR_ERR_SUCCESS;
        d->part = part;
        if (d->started) {
            exr = exr_decoding_choose_default_routines(r->file.context, part, &d->pipeline);
            d->pipeline.unpack_and_convert_fn = NULL; /* read_tile sorts the channels into our arrays */
        }
    }
    if (exr == EXR_ERR_SUCCESS) {
        exr = exr_decoding_run(r->file.context, part, &d->pipeline);
    }
    if (exr == EXR_ERR_SUCCESS && (d->pipeline.unpacked_buffer == NULL || d->pipeline.unpacked_alloc_size < chunk->unpacked_size)) {
        exr = EXR_ERR_CORRUPT_CHUNK;
    }
    return exr;
}

/* Lines of rounded cells; false when a number in them can't be. */
static bool read_rounded(const reader *r, uint32_t slab, uint64_t first, const unsigned char *from)
{
    const lmg_slab *s = &r->layout.slabs[slab];
    const lmg_slab_data *data = &r->field->slabs[slab];
    const uint32_t channels = r->layout.channels;
    bool sound = true;
    for (uint32_t it = 0; it < s->nt; it++, first += s->ns, from += (size_t)s->ns * (channels + 2) * sizeof(uint16_t)) {
        sound &= lmg_decode_line(from, s->ns, channels, r->scales[slab] + (size_t)it * s->ns, lmg_cell_radiance(data, first),
                                 data->standard_error + first, data->half_a + first);
    }
    return sound;
}

static bool is_dark(const unsigned char *bytes, size_t size)
{
    uint64_t any = 0, word;
    size_t i = 0;
    for (; any == 0 && i + sizeof word <= size; i += sizeof word) {
        memcpy(&word, bytes + i, sizeof word);
        any = word;
    }
    for (; i < size; i++) {
        any |= bytes[i];
    }
    return any == 0;
}

static lmg_result read_tile(reader *r, decoder *d, uint32_t slab, uint64_t tile_in_slab, lmg_error *err)
{
    const lmg_slab *s = &r->layout.slabs[slab];
    lmg_slab_data *data = &r->field->slabs[slab];
    const int part = (int)slab, column = (int)(tile_in_slab % s->nu), row = (int)(tile_in_slab / s->nu);
    const uint64_t cells = lmg_tile_cells(s), channels = r->layout.channels, first = tile_in_slab * cells;
    exr_chunk_info_t chunk;
    exr_result_t exr = exr_read_tile_chunk_info(r->file.context, part, column, row, 0, 0, &chunk);
    if (exr == EXR_ERR_SUCCESS &&
        (chunk.unpacked_size != cells * (channels + 2) * (r->scales[slab] != NULL ? sizeof(uint16_t) : sizeof(float)) || chunk.data_offset > r->file.stream.size ||
         chunk.packed_size > r->file.stream.size - chunk.data_offset)) {
        exr = EXR_ERR_CORRUPT_CHUNK;
    }
    const unsigned char *from = NULL;
    if (exr == EXR_ERR_SUCCESS && chunk.packed_size == chunk.unpacked_size) { /* stored as it is: nothing to decode */
        from = r->file.stream.bytes + chunk.data_offset;
    } else if (exr == EXR_ERR_SUCCESS) {
        exr = decode(r, d, part, &chunk);
        from = d->pipeline.unpacked_buffer;
    }
    if (exr != EXR_ERR_SUCCESS) {
        return lmg_exr_fail(err, LMG_ERROR_FILE_READ, &r->file, "damaged: a tile can't be decoded", exr);
    }
    const bool rounded = r->scales[slab] != NULL;
    if (rounded) {
        r->tiles.hashes[r->tiles.start[slab] + tile_in_slab] = lmg_hash_codes(from, cells * (channels + 2));
    }
    if (is_dark(from, (size_t)chunk.unpacked_size)) {
        return LMG_OK; /* as the field is to begin with; its pages may stay untouched */
    }
    const bool decoded = !rounded || read_rounded(r, slab, first, from);
    /* a line of the tile holds its channels one after the other, sorted by name: B, G, R or Y, then half_a.Y, stderr.Y */
    const size_t line_bytes = s->ns * sizeof(float);
    for (uint32_t it = 0; !rounded && it < s->nt; it++) {
        const uint64_t line = first + (uint64_t)it * s->ns;
        for (uint32_t c = 0; c < channels; c++) {
            float *to = lmg_cell_radiance(data, line) + (channels - 1 - c);
            for (uint32_t is = 0; is < s->ns; is++) {
                memcpy(to + is * (size_t)data->stride, from + is * sizeof(float), sizeof(float));
            }
            from += line_bytes;
        }
        memcpy(data->half_a + line, from, line_bytes);
        memcpy(data->standard_error + line, from + line_bytes, line_bytes);
        from += 2 * line_bytes;
    }
    if (!decoded || !lmg_tile_is_sound(&r->tiles, slab, tile_in_slab)) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: part %d, tile %d,%d holds a value that is no finite number, or a negative standard error",
                        r->file.where, part, column, row);
    }
    return LMG_OK;
}

static lmg_result read_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    reader *r = self;
    const uint64_t first = index * r->tiles.run, after = first + r->tiles.run < r->tiles.end ? first + r->tiles.run : r->tiles.end;
    for (uint64_t tile = first; tile < after; tile++) {
        const uint32_t slab = lmg_tile_slab(&r->tiles, tile);
        LMG_TRY(read_tile(r, scratch, slab, tile - r->tiles.start[slab], err));
    }
    if (r->scales[0] == NULL) {
        lmg_hash_tiles(&r->tiles, first, after);
    }
    return LMG_OK;
}

static void read_end(void *self, void *scratch)
{
    const reader *r = self;
    decoder *d = scratch;
    if (d->started) {
        exr_decoding_destroy(r->file.context, &d->pipeline);
    }
}

static lmg_result read_all(reader *r, lmg_error *err)
{
    LMG_TRY(lmg_exr_read_layout(&r->file, &r->layout, &r->version, err));
    uint64_t hash;
    LMG_TRY(lmg_exr_read_hash(&r->file, &hash, err));
    lmg_error reason = {.message = ""};
    lmg_result result = lmg_field_allocate(&r->layout, &r->field, &reason);
    if (result != LMG_OK) {
        return lmg_fail(err, result, "%s: %.250s", r->file.where, reason.message);
    }
    LMG_TRY(lmg_exr_read_records(&r->file, r->field, err));
    LMG_TRY(lmg_box_check(r->field, r->file.where, LMG_ERROR_FILE_FORMAT, err));

    lmg_tiles_init(&r->tiles, &r->field->layout);
    r->tiles.field = r->field;
    if (r->version == LMG_BOX_ROUNDED) {
        LMG_TRY(lmg_exr_read_units(&r->file, r->layout.slab_count, r->units, &r->field->rounding, err));
        r->tiles.units = r->units;
        r->tiles.rounding = r->field->rounding;
        for (uint32_t i = 0; i < r->layout.slab_count; i++) {
            r->scales[i] = lmg_code_scales(&r->layout.slabs[i], r->units[i]);
            if (r->scales[i] == NULL) {
                return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for decoding", r->file.where);
            }
        }
    }
    r->tiles.hashes = calloc((size_t)r->tiles.end, sizeof *r->tiles.hashes);
    if (r->tiles.hashes == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for the hashes of %" PRIu64 " tiles", r->file.where, r->tiles.end);
    }
    lmg_work w = {.piece = read_run,
                  .end = read_end,
                  .self = r,
                  .scratch_size = sizeof(decoder),
                  .count = (r->tiles.end + r->tiles.run - 1) / r->tiles.run};
    LMG_TRY(lmg_work_do(&w, err));
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION /* or a fuzzer would hardly get past this line */
    const bool altered = false;
    (void)hash;
#else
    const bool altered = lmg_hash_field(&r->tiles) != hash;
#endif
    if (altered) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: altered after it was written: its content hash disagrees; copy or bake it again", r->file.where);
    }
    result = lmg_field_prepare(r->field, &reason);
    return result == LMG_OK ? LMG_OK : lmg_fail(err, result, "%s: %.250s", r->file.where, reason.message);
}

lmg_result lmg_field_read_memory(const void *bytes, size_t size, const char *name, lmg_field **out, lmg_error *err)
{
    if (out == NULL || (bytes == NULL && size > 0)) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lmg_field_read_memory: no bytes, or nowhere to put the field");
    }
    *out = NULL;
    const lmg_shown_path where = lmg_show_path(name != NULL && name[0] != 0 ? name : "box in memory");
    lmg_exr_fault fault;
    if (lmg_exr_check(bytes, size, &fault) != LMG_OK) {
        return lmg_fail(err, fault.code, "%s: %s", where.text, fault.text);
    }
    reader *r = calloc(1, sizeof *r); /* a layout is 7 kB: not for the stacks of a host's threads */
    if (r == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory", where.text);
    }
    r->file.where = where.text;
    r->file.stream.bytes = bytes;
    r->file.stream.size = size;
    if (pthread_mutex_init(&r->file.stream.lock, NULL) != 0) {
        free(r);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: can't make a lock", where.text);
    }
    exr_context_initializer_t init = lmg_exr_initializer(&r->file.stream);
    init.read_fn = lmg_exr_stream_read;
    init.size_fn = lmg_exr_stream_size;
    const exr_result_t exr = exr_start_read(&r->file.context, where.text, &init);
    lmg_result result;
    if (exr != EXR_ERR_SUCCESS) {
        result = lmg_exr_fail(err, LMG_ERROR_FILE_FORMAT, &r->file, "not a box file", exr);
    } else {
        result = read_all(r, err);
    }
    exr_finish(&r->file.context);
    if (result == LMG_OK) {
        *out = r->field;
    } else {
        lmg_field_destroy(r->field);
    }
    free(r->tiles.hashes);
    for (uint32_t i = 0; i < LMG_MAX_SLABS; i++) {
        free(r->scales[i]);
    }
    pthread_mutex_destroy(&r->file.stream.lock);
    free(r);
    return result;
}

static lmg_result read_bytes(int fd, const char *path, unsigned char **out, size_t *size, lmg_error *err)
{
    struct stat info;
    if (fstat(fd, &info) != 0) {
        return lmg_fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't open", errno);
    }
    if (S_ISDIR(info.st_mode)) {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: is a directory; name the box file in it", lmg_show_path(path).text);
    }
    if (!S_ISREG(info.st_mode)) {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: isn't a regular file; copy its content to one", lmg_show_path(path).text);
    }
    if (info.st_size < 0 || (uint64_t)info.st_size > SIZE_MAX - 1) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: larger than this machine's memory", lmg_show_path(path).text);
    }
    *size = (size_t)info.st_size;
    *out = malloc(*size + 1);
    if (*out == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its %zu bytes", lmg_show_path(path).text, *size);
    }
    size_t done = 0;
    while (done < *size) {
        const ssize_t count = pread(fd, *out + done, *size - done, (off_t)done);
        if (count < 0 && errno == EINTR) {
            continue;
        }
        if (count < 0) {
            return lmg_fail_errno(err, LMG_ERROR_FILE_READ, path, "can't read", errno);
        }
        if (count == 0) { /* somebody shortened it meanwhile; the check will say what is missing */
            *size = done;
        }
        done += (size_t)count;
    }
    return LMG_OK;
}

lmg_result lmg_field_read(const char *path, lmg_field **out, lmg_error *err)
{
    if (path == NULL || path[0] == 0 || out == NULL) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lmg_field_read: no path, or nowhere to put the field");
    }
    *out = NULL;
    const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); /* not to wait for the other end of a pipe */
    if (fd < 0) {
        return lmg_fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't open", errno);
    }
    unsigned char *bytes = NULL;
    size_t size = 0;
    lmg_result result = read_bytes(fd, path, &bytes, &size, err);
    close(fd);
    if (result == LMG_OK) {
        result = lmg_field_read_memory(bytes, size, path, out, err);
    }
    free(bytes);
    return result;
}
