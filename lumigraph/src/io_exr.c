/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reads and writes box files: docs/format.md in C.  Relies on OpenEXRCore for headers and tiles, and on exr_check.c, which sees every
 * byte before OpenEXRCore does.
 *
 * Reading takes the whole file into memory first: what was checked is then what is decoded, even if somebody rewrites the file
 * meanwhile.  Tiles are independent, so decoding, hashing and encoding are shared out over the processors; the result doesn't depend
 * on how many there are.
 */
#include "exr_check.h"
#include "field.h"
#include "io_exr.h"

#include <openexr.h>

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "io_exr.c copies floats between EXR's little-endian order and memory; a big-endian machine needs a swap there"
#endif

enum { FORMAT_VERSION = 1 };

/* Measured on boxes of 1 to 14 million cells (tests/bench/bench_io.c): level 4 writes two to six times as fast as 9 and is 1 to 2 % larger. */
enum { ZIP_LEVEL = 4 };

enum { MAX_THREADS = 16 };

static const uint64_t hash_start = 0xcbf29ce484222325u;

#define TRY(call)                                                                                                                          \
    do {                                                                                                                                   \
        const lmg_result try_result = (call);                                                                                              \
        if (try_result != LMG_OK) {                                                                                                        \
            return try_result;                                                                                                             \
        }                                                                                                                                  \
    } while (0)

/* ------------------------------------------------------------------------------------------------------------ messages */

/* A path as messages show it: messages have room for 512 bytes, paths may be longer, and the end is what tells files apart. */
typedef struct shown_path {
    char text[200];
} shown_path;

static shown_path show(const char *path)
{
    shown_path shown;
    const size_t length = strlen(path);
    if (length < sizeof shown.text) {
        memcpy(shown.text, path, length + 1);
    } else {
        const char *tail = path + length - (sizeof shown.text - 4);
        while (((unsigned char)*tail & 0xc0) == 0x80) { /* don't begin inside a UTF-8 character */
            tail++;
        }
        snprintf(shown.text, sizeof shown.text, "...%s", tail);
    }
    return shown;
}

static lmg_result fail_errno(lmg_error *err, lmg_result code, const char *path, const char *what, int number)
{
    char reason[128];
    if (strerror_r(number, reason, sizeof reason) != 0) {
        snprintf(reason, sizeof reason, "error %d", number);
    }
    return lmg_fail(err, code, "%s: %s: %s", show(path).text, what, reason);
}

/* ---------------------------------------------------------------------------------------------------------- parallel work */

/* count independent pieces of work, done by all processors.  Of several failures the one of the lowest piece is reported, so that the
 * same file gives the same message every time. */
typedef struct work {
    lmg_result (*piece)(void *self, uint64_t index, void *scratch, lmg_error *err);
    void (*end)(void *self, void *scratch); /* frees what a thread's scratch holds; may be NULL */
    void *self;
    size_t scratch_size; /* each thread's own, zeroed, at most WORK_SCRATCH */
    uint64_t count;
    atomic_uint_least64_t next;
    atomic_uint_least64_t failed; /* lowest failed piece so far, or count */
    pthread_mutex_t lock;         /* guards result and error */
    uint64_t reported;
    lmg_result result;
    lmg_error error;
} work;

enum { WORK_SCRATCH = 1024 };

static void *work_run(void *argument)
{
    work *w = argument;
    _Alignas(max_align_t) unsigned char scratch[WORK_SCRATCH];
    memset(scratch, 0, w->scratch_size);
    for (;;) {
        const uint64_t index = atomic_fetch_add(&w->next, 1);
        if (index >= w->count || index > atomic_load(&w->failed)) {
            break;
        }
        lmg_error error = {.message = ""};
        const lmg_result result = w->piece(w->self, index, scratch, &error);
        if (result != LMG_OK) {
            pthread_mutex_lock(&w->lock);
            if (index < w->reported) {
                w->reported = index;
                w->result = result;
                w->error = error;
                atomic_store(&w->failed, index);
            }
            pthread_mutex_unlock(&w->lock);
        }
    }
    if (w->end != NULL) {
        w->end(w->self, scratch);
    }
    return NULL;
}

static lmg_result work_do(work *w, lmg_error *err)
{
    atomic_init(&w->next, 0);
    atomic_init(&w->failed, w->count);
    w->reported = w->count;
    w->result = LMG_OK;
    if (pthread_mutex_init(&w->lock, NULL) != 0) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "can't make a lock");
    }
    const long processors = sysconf(_SC_NPROCESSORS_ONLN);
    uint64_t wanted = processors < 1 ? 1 : processors > MAX_THREADS ? MAX_THREADS : (uint64_t)processors;
    if (wanted > w->count) {
        wanted = w->count;
    }
    pthread_t threads[MAX_THREADS];
    unsigned started = 0;
    while (started + 1 < wanted && pthread_create(&threads[started], NULL, work_run, w) == 0) {
        started++;
    }
    work_run(w); /* this thread works too, so it goes on if no other could be started */
    for (unsigned i = 0; i < started; i++) {
        pthread_join(threads[i], NULL);
    }
    pthread_mutex_destroy(&w->lock);
    if (w->result != LMG_OK && err != NULL) {
        *err = w->error;
    }
    return w->result;
}

/* ---------------------------------------------------------------------------------------------------------- content hash */

static uint64_t hash_u32(uint64_t hash, uint32_t value)
{
    unsigned char bytes[4];
    for (int i = 0; i < 4; i++) {
        bytes[i] = (unsigned char)(value >> (8 * i));
    }
    return lmg_hash(hash, bytes, sizeof bytes);
}

static uint64_t hash_u64(uint64_t hash, uint64_t value)
{
    return hash_u32(hash_u32(hash, (uint32_t)value), (uint32_t)(value >> 32));
}

static uint64_t hash_f32(uint64_t hash, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return hash_u32(hash, bits);
}

static uint64_t hash_f64(uint64_t hash, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return hash_u64(hash, bits);
}

static uint64_t hash_vec3(uint64_t hash, lmg_vec3 v)
{
    return hash_f64(hash_f64(hash_f64(hash, v.x), v.y), v.z);
}

/* The ten numbers of the ledger in the order of the file and the hash. */
enum { LEDGER_ENTRIES = 5 };
static const char *const ledger_names[LEDGER_ENTRIES] = {"lumibox.emitted", "lumibox.stored", "lumibox.residual", "lumibox.absorbed",
                                                         "lumibox.lost"};

static void ledger_get(const lmg_ledger *l, double values[LEDGER_ENTRIES][2])
{
    const double all[LEDGER_ENTRIES][2] = {{l->emitted, l->emitted_se},
                                           {l->stored, l->stored_se},
                                           {l->residual, l->residual_se},
                                           {l->absorbed, l->absorbed_se},
                                           {l->lost, l->lost_se}};
    memcpy(values, all, sizeof all);
}

static void ledger_set(lmg_ledger *l, const double values[LEDGER_ENTRIES][2])
{
    l->emitted = values[0][0];
    l->emitted_se = values[0][1];
    l->stored = values[1][0];
    l->stored_se = values[1][1];
    l->residual = values[2][0];
    l->residual_se = values[2][1];
    l->absorbed = values[3][0];
    l->absorbed_se = values[3][1];
    l->lost = values[4][0];
    l->lost_se = values[4][1];
}

static uint64_t hash_metadata(const lmg_field *field)
{
    const lmg_layout *l = &field->layout;
    uint64_t h = lmg_hash(hash_start, "LUMIBOX", 7);
    h = hash_u32(h, FORMAT_VERSION);
    h = hash_u32(h, l->slab_count);
    h = hash_u32(h, l->channels);
    for (int i = 0; i < 3; i++) {
        h = hash_f32(h, l->colour[i]);
    }
    h = hash_vec3(h, l->bounds_min);
    h = hash_vec3(h, l->bounds_max);
    h = hash_f64(h, l->size);
    h = hash_u64(h, field->ledger.photons);
    double ledger[LEDGER_ENTRIES][2];
    ledger_get(&field->ledger, ledger);
    for (int i = 0; i < LEDGER_ENTRIES; i++) {
        h = hash_f64(hash_f64(h, ledger[i][0]), ledger[i][1]);
    }
    for (uint32_t i = 0; i < l->slab_count; i++) {
        const lmg_slab *s = &l->slabs[i];
        h = hash_u32(h, (uint32_t)s->kind);
        h = hash_vec3(hash_vec3(hash_vec3(hash_vec3(h, s->o), s->a), s->b), s->n);
        h = hash_f64(h, s->distance);
        h = hash_f64(hash_f64(h, s->u0), s->u1);
        h = hash_f64(hash_f64(h, s->v0), s->v1);
        h = hash_f64(hash_f64(h, s->s0), s->s1);
        h = hash_f64(hash_f64(h, s->t0), s->t1);
        h = hash_u32(hash_u32(hash_u32(hash_u32(h, s->nu), s->nv), s->ns), s->nt);
    }
    h = hash_u32(h, (uint32_t)field->text_count);
    for (size_t i = 0; i < field->text_count; i++) { /* with their terminating zeros, so that no two lists run into the same bytes */
        h = lmg_hash(h, field->texts[i].name, strlen(field->texts[i].name) + 1);
        h = lmg_hash(h, field->texts[i].value, strlen(field->texts[i].value) + 1);
    }
    return h;
}

/* ------------------------------------------------------------------------------------------------------------------ tiles */

/* All tiles of a field in the order of the file: slab by slab, iv by iv, iu by iu.  Work is shared out in runs of tiles: one tile of
 * 16 x 16 cells is too little to hand around. */
typedef struct tiles {
    const lmg_layout *layout;
    const lmg_field *field;
    uint64_t start[LMG_MAX_SLABS + 1]; /* number of tiles before each slab */
    uint64_t run;                      /* tiles per piece of work */
    uint64_t first, end;               /* tiles that the work is about */
    uint64_t *hashes;                  /* one per tile */
} tiles;

/* At least this much data to a piece of work, so that handing it out costs nothing beside it. */
enum { RUN_BYTES = 128 << 10 };

static uint64_t tile_cells(const lmg_slab *slab)
{
    return (uint64_t)slab->ns * slab->nt;
}

static void tiles_init(tiles *t, const lmg_layout *layout)
{
    memset(t, 0, sizeof *t);
    t->layout = layout;
    uint64_t largest = 1;
    for (uint32_t i = 0; i < layout->slab_count; i++) {
        const uint64_t bytes = tile_cells(&layout->slabs[i]) * (layout->channels + 2) * sizeof(float);
        largest = bytes > largest ? bytes : largest;
        t->start[i + 1] = t->start[i] + (uint64_t)layout->slabs[i].nu * layout->slabs[i].nv;
    }
    t->run = largest >= RUN_BYTES ? 1 : RUN_BYTES / largest;
    t->end = t->start[layout->slab_count];
}

static uint32_t tile_slab(const tiles *t, uint64_t tile)
{
    uint32_t slab = 0;
    while (tile >= t->start[slab + 1]) {
        slab++;
    }
    return slab;
}

static uint64_t hash_tile(const tiles *t, uint32_t slab, uint64_t tile_in_slab)
{
    const lmg_slab_data *data = &t->field->slabs[slab];
    const uint64_t cells = tile_cells(&t->layout->slabs[slab]), first = tile_in_slab * cells, channels = t->layout->channels;
    uint64_t h = lmg_hash(hash_start, data->radiance + first * channels, (size_t)(cells * channels) * sizeof(float));
    h = lmg_hash(h, data->standard_error + first, (size_t)cells * sizeof(float));
    return lmg_hash(h, data->half_a + first, (size_t)cells * sizeof(float));
}

static uint64_t hash_field(const tiles *t)
{
    uint64_t h = hash_metadata(t->field);
    for (uint64_t i = 0; i < t->start[t->layout->slab_count]; i++) {
        h = hash_u64(h, t->hashes[i]);
    }
    return h;
}

/* Every number of a tile is finite and standard errors aren't negative: what the readers of a field rely on. */
static bool tile_is_sound(const tiles *t, uint32_t slab, uint64_t tile_in_slab)
{
    const lmg_slab_data *data = &t->field->slabs[slab];
    const uint64_t cells = tile_cells(&t->layout->slabs[slab]), first = tile_in_slab * cells, channels = t->layout->channels;
    bool sound = true;
    for (uint64_t i = first * channels; i < (first + cells) * channels; i++) {
        sound &= isfinite(data->radiance[i]) != 0;
    }
    for (uint64_t i = first; i < first + cells; i++) {
        sound &= isfinite(data->standard_error[i]) && data->standard_error[i] >= 0 && isfinite(data->half_a[i]);
    }
    return sound;
}

/* What isn't a matter of one cell: checked before writing and after reading, so that what is written can be read. */
static lmg_result check_field(const lmg_field *field, const char *where, lmg_result code, lmg_error *err)
{
    double ledger[LEDGER_ENTRIES][2];
    ledger_get(&field->ledger, ledger);
    for (int i = 0; i < LEDGER_ENTRIES; i++) {
        if (!isfinite(ledger[i][0]) || !isfinite(ledger[i][1]) || ledger[i][1] < 0) {
            return lmg_fail(err, code, "%s: the flux %s is %g +- %g lm", where, ledger_names[i] + strlen("lumibox."), ledger[i][0],
                            ledger[i][1]);
        }
    }
    for (int i = 0; i < 3; i++) {
        if (!isfinite(field->layout.colour[i])) {
            return lmg_fail(err, code, "%s: the common colour isn't finite", where);
        }
    }
    for (uint32_t i = 0; i < field->layout.slab_count; i++) {
        const lmg_slab *s = &field->layout.slabs[i];
        const uint64_t width = (uint64_t)s->nu * s->ns, height = (uint64_t)s->nv * s->nt;
        if (width > LMG_EXR_MAX_EXTENT || height > LMG_EXR_MAX_EXTENT || (uint64_t)s->nu * s->nv > INT32_MAX ||
            tile_cells(s) * (field->layout.channels + 2) * sizeof(float) > INT32_MAX) {
            return lmg_fail(err, code, "%s: slab %u of %u x %u x %u x %u cells is larger than an EXR picture can be", where, i, s->nu, s->nv,
                            s->ns, s->nt);
        }
    }
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------------- OpenEXRCore */

/* What OpenEXRCore calls back with: bytes to read from, or a file to write to, and where its messages go. */
typedef struct stream {
    const unsigned char *bytes; /* reading */
    size_t size;
    int fd; /* writing */
    uint64_t buffer_offset;
    size_t buffered;
    unsigned char *buffer;
    int write_errno;
    pthread_mutex_t lock; /* guards message: decoding calls from several threads */
    char message[256];    /* OpenEXRCore's first */
} stream;

enum { WRITE_BUFFER = 1 << 20 };

static void stream_error(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)code;
    void *user = NULL;
    if (context != NULL && exr_get_user_data(context, &user) == EXR_ERR_SUCCESS && user != NULL && message != NULL) {
        stream *s = user;
        pthread_mutex_lock(&s->lock);
        if (s->message[0] == 0) {
            snprintf(s->message, sizeof s->message, "%s", message);
            for (char *p = s->message; *p != 0; p++) { /* one clean line, whatever the file made it quote */
                if ((unsigned char)*p < 0x20 || *p == 0x7f) {
                    *p = ' ';
                }
            }
        }
        pthread_mutex_unlock(&s->lock);
    }
}

static int64_t stream_read(exr_const_context_t context, void *user, void *buffer, uint64_t size, uint64_t offset,
                           exr_stream_error_func_ptr_t error_cb)
{
    (void)context;
    (void)error_cb;
    const stream *s = user;
    if (offset >= s->size) {
        return 0;
    }
    const uint64_t available = s->size - offset, count = size < available ? size : available;
    memcpy(buffer, s->bytes + offset, (size_t)count);
    return (int64_t)count;
}

static int64_t stream_size(exr_const_context_t context, void *user)
{
    (void)context;
    const stream *s = user;
    return (int64_t)s->size;
}

static bool stream_flush(stream *s)
{
    size_t done = 0;
    while (done < s->buffered) {
        const ssize_t count = pwrite(s->fd, s->buffer + done, s->buffered - done, (off_t)(s->buffer_offset + done));
        if (count < 0 && errno == EINTR) {
            continue;
        }
        if (count <= 0) {
            s->write_errno = count < 0 ? errno : ENOSPC;
            return false;
        }
        done += (size_t)count;
    }
    s->buffer_offset += s->buffered;
    s->buffered = 0;
    return true;
}

static int64_t stream_write(exr_const_context_t context, void *user, const void *bytes, uint64_t size, uint64_t offset,
                            exr_stream_error_func_ptr_t error_cb)
{
    (void)context;
    (void)error_cb;
    stream *s = user;
    if (s->write_errno != 0) {
        return -1;
    }
    if (offset != s->buffer_offset + s->buffered) {
        if (!stream_flush(s)) {
            return -1;
        }
        s->buffer_offset = offset;
    }
    const unsigned char *from = bytes;
    uint64_t todo = size;
    while (todo > 0) {
        const size_t room = WRITE_BUFFER - s->buffered, count = todo < room ? (size_t)todo : room;
        memcpy(s->buffer + s->buffered, from, count);
        s->buffered += count;
        from += count;
        todo -= count;
        if (s->buffered == WRITE_BUFFER && !stream_flush(s)) {
            return -1;
        }
    }
    return (int64_t)size;
}

static lmg_result fail_exr(lmg_error *err, lmg_result code, stream *s, const char *where, const char *what, exr_result_t exr)
{
    pthread_mutex_lock(&s->lock);
    const char *reason = s->message[0] != 0 ? s->message : exr_get_default_error_message(exr);
    const lmg_result result = lmg_fail(err, exr == EXR_ERR_OUT_OF_MEMORY ? LMG_ERROR_MEMORY : code, "%s: %s: %s", where, what, reason);
    pthread_mutex_unlock(&s->lock);
    return result;
}

static exr_context_initializer_t context_initializer(stream *s)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = stream_error;
    init.user_data = s;
    init.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    return init;
}

/* ---------------------------------------------------------------------------------------------------------------- reading */

typedef struct reader {
    exr_context_t context;
    stream stream;
    const char *where; /* the file's name as messages show it */
    lmg_layout layout;
    lmg_field *field;
    tiles tiles;
} reader;

static lmg_result attribute_fault(reader *r, int part, const char *name, exr_result_t exr, lmg_error *err)
{
    if (exr == EXR_ERR_NO_ATTR_BY_NAME) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: not a box file: part %d has no attribute \"%s\"", r->where, part, name);
    }
    return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d, attribute \"%s\": %s", r->where, part, name,
                    exr_get_default_error_message(exr));
}

/* Looks before it asks, so that a missing attribute isn't an error to OpenEXRCore, which would note it as its first message. */
static lmg_result need_attribute(reader *r, int part, const char *name, exr_attribute_type_t type, lmg_error *err)
{
    const exr_attribute_t *attribute = NULL;
    const exr_result_t exr = exr_get_attribute_by_name(r->context, part, name, &attribute);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(r, part, name, exr, err);
    }
    return attribute->type == type ? LMG_OK : attribute_fault(r, part, name, EXR_ERR_ATTR_TYPE_MISMATCH, err);
}

static lmg_result get_int(reader *r, int part, const char *name, int32_t *out, lmg_error *err)
{
    TRY(need_attribute(r, part, name, EXR_ATTR_INT, err));
    const exr_result_t exr = exr_attr_get_int(r->context, part, name, out);
    return exr == EXR_ERR_SUCCESS ? LMG_OK : attribute_fault(r, part, name, exr, err);
}

static lmg_result get_double(reader *r, int part, const char *name, double *out, lmg_error *err)
{
    TRY(need_attribute(r, part, name, EXR_ATTR_DOUBLE, err));
    const exr_result_t exr = exr_attr_get_double(r->context, part, name, out);
    return exr == EXR_ERR_SUCCESS ? LMG_OK : attribute_fault(r, part, name, exr, err);
}

static lmg_result get_v2d(reader *r, int part, const char *name, double *x, double *y, lmg_error *err)
{
    TRY(need_attribute(r, part, name, EXR_ATTR_V2D, err));
    exr_attr_v2d_t v;
    const exr_result_t exr = exr_attr_get_v2d(r->context, part, name, &v);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(r, part, name, exr, err);
    }
    *x = v.x;
    *y = v.y;
    return LMG_OK;
}

static lmg_result get_v3d(reader *r, int part, const char *name, lmg_vec3 *out, lmg_error *err)
{
    TRY(need_attribute(r, part, name, EXR_ATTR_V3D, err));
    exr_attr_v3d_t v;
    const exr_result_t exr = exr_attr_get_v3d(r->context, part, name, &v);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(r, part, name, exr, err);
    }
    *out = (lmg_vec3){v.x, v.y, v.z};
    return LMG_OK;
}

static lmg_result get_cells(reader *r, int part, const char *name, uint32_t *x, uint32_t *y, lmg_error *err)
{
    TRY(need_attribute(r, part, name, EXR_ATTR_V2I, err));
    exr_attr_v2i_t v;
    const exr_result_t exr = exr_attr_get_v2i(r->context, part, name, &v);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(r, part, name, exr, err);
    }
    if (v.x < 1 || v.x > 65535 || v.y < 1 || v.y > 65535) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d: %s %d x %d is outside 1 to 65535", r->where, part, name, (int)v.x, (int)v.y);
    }
    *x = (uint32_t)v.x;
    *y = (uint32_t)v.y;
    return LMG_OK;
}

/* A string without zeros inside, as a copy; to be freed by the caller. */
static lmg_result get_string(reader *r, int part, const char *name, char **out, lmg_error *err)
{
    TRY(need_attribute(r, part, name, EXR_ATTR_STRING, err));
    int32_t length = 0;
    const char *text = NULL;
    const exr_result_t exr = exr_attr_get_string(r->context, part, name, &length, &text);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(r, part, name, exr, err);
    }
    if (length < 0 || (length > 0 && (text == NULL || memchr(text, 0, (size_t)length) != NULL))) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d, attribute \"%s\": a zero byte inside a text", r->where, part, name);
    }
    char *copy = malloc((size_t)length + 1);
    if (copy == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for a text of %d bytes", r->where, (int)length);
    }
    if (length > 0) {
        memcpy(copy, text, (size_t)length);
    }
    copy[length] = 0;
    *out = copy;
    return LMG_OK;
}

/* An unsigned number of exactly this many hexadecimal digits (base 16) or of 1 to 20 decimal ones. */
static bool parse_number(const char *text, unsigned base, uint64_t *out)
{
    const size_t length = strlen(text);
    uint64_t value = 0;
    if (base == 16 ? length != 16 : length < 1 || length > 20) {
        return false;
    }
    for (const char *p = text; *p != 0; p++) {
        unsigned digit;
        if (*p >= '0' && *p <= '9') {
            digit = (unsigned)(*p - '0');
        } else if (base == 16 && *p >= 'a' && *p <= 'f') {
            digit = (unsigned)(*p - 'a') + 10;
        } else {
            return false;
        }
        if (value > (UINT64_MAX - digit) / base) {
            return false;
        }
        value = value * base + digit;
    }
    *out = value;
    return true;
}

static lmg_result get_number(reader *r, const char *name, unsigned base, uint64_t *out, lmg_error *err)
{
    char *text = NULL;
    TRY(get_string(r, 0, name, &text, err));
    const bool good = parse_number(text, base, out);
    free(text);
    return good ? LMG_OK : lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: attribute \"%s\" isn't a %s number", r->where, name,
                                    base == 16 ? "16-digit hexadecimal" : "decimal");
}

static lmg_result read_slab(reader *r, uint32_t index, lmg_error *err)
{
    const int part = (int)index;
    lmg_slab *s = &r->layout.slabs[index];
    int32_t number;
    TRY(get_int(r, part, "lumibox.slab", &number, err));
    if (number != part) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d says it is slab %d", r->where, part, (int)number);
    }
    char *kind = NULL;
    TRY(get_string(r, part, "lumibox.kind", &kind, err));
    const bool cube = strcmp(kind, "cube") == 0, aperture = strcmp(kind, "aperture") == 0;
    free(kind);
    if (!cube && !aperture) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d: lumibox.kind is neither \"cube\" nor \"aperture\"", r->where, part);
    }
    s->kind = cube ? LMG_SLAB_CUBE : LMG_SLAB_APERTURE;
    TRY(get_v3d(r, part, "lumibox.o", &s->o, err));
    TRY(get_v3d(r, part, "lumibox.a", &s->a, err));
    TRY(get_v3d(r, part, "lumibox.b", &s->b, err));
    TRY(get_v3d(r, part, "lumibox.n", &s->n, err));
    TRY(get_double(r, part, "lumibox.distance", &s->distance, err));
    TRY(get_v2d(r, part, "lumibox.u", &s->u0, &s->u1, err));
    TRY(get_v2d(r, part, "lumibox.v", &s->v0, &s->v1, err));
    TRY(get_v2d(r, part, "lumibox.s", &s->s0, &s->s1, err));
    TRY(get_v2d(r, part, "lumibox.t", &s->t0, &s->t1, err));
    TRY(get_cells(r, part, "lumibox.uvCells", &s->nu, &s->nv, err));
    TRY(get_cells(r, part, "lumibox.stCells", &s->ns, &s->nt, err));

    exr_attr_box2i_t window;
    uint32_t tile_width, tile_height;
    exr_tile_level_mode_t level;
    exr_tile_round_mode_t rounding;
    exr_result_t exr = exr_get_data_window(r->context, part, &window);
    if (exr == EXR_ERR_SUCCESS) {
        exr = exr_get_tile_descriptor(r->context, part, &tile_width, &tile_height, &level, &rounding);
    }
    if (exr != EXR_ERR_SUCCESS) {
        return fail_exr(err, LMG_ERROR_FILE_FORMAT, &r->stream, r->where, "can't get the picture's size", exr);
    }
    if (tile_width != s->ns || tile_height != s->nt || (uint64_t)s->nu * s->ns != (uint64_t)window.max.x + 1 ||
        (uint64_t)s->nv * s->nt != (uint64_t)window.max.y + 1) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d: %u x %u x %u x %u cells don't match a picture of %d x %d in tiles of %u x %u",
                        r->where, part, s->nu, s->nv, s->ns, s->nt, window.max.x + 1, window.max.y + 1, tile_width, tile_height);
    }
    return LMG_OK;
}

static lmg_result read_layout(reader *r, lmg_error *err)
{
    int parts = 0;
    exr_result_t exr = exr_get_count(r->context, &parts);
    if (exr != EXR_ERR_SUCCESS) {
        return fail_exr(err, LMG_ERROR_FILE_FORMAT, &r->stream, r->where, "can't count the parts", exr);
    }
    int32_t number;
    TRY(get_int(r, 0, "lumibox.version", &number, err));
    if (number != FORMAT_VERSION) {
        return lmg_fail(err, LMG_ERROR_FILE_VERSION, "%s: box format version %d; this library (%s) reads version %d", r->where, (int)number,
                        LMG_VERSION_STRING, FORMAT_VERSION);
    }
    TRY(get_int(r, 0, "lumibox.slabs", &number, err));
    if (number != parts || parts < 1 || parts > LMG_MAX_SLABS) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: says it has %d slabs, but has %d parts", r->where, (int)number, parts);
    }
    r->layout.slab_count = (uint32_t)parts;
    TRY(get_int(r, 0, "lumibox.channels", &number, err));
    const exr_attr_chlist_t *channels = NULL;
    exr = exr_get_channels(r->context, 0, &channels);
    if (exr != EXR_ERR_SUCCESS) {
        return fail_exr(err, LMG_ERROR_FILE_FORMAT, &r->stream, r->where, "can't get the channels", exr);
    }
    if ((number != 1 && number != 3) || channels->num_channels != number + 2) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: says it has %d colour channels, but its parts hold %d channels in all", r->where,
                        (int)number, channels->num_channels);
    }
    r->layout.channels = (uint32_t)number;
    TRY(need_attribute(r, 0, "lumibox.colour", EXR_ATTR_V3F, err));
    exr_attr_v3f_t colour;
    exr = exr_attr_get_v3f(r->context, 0, "lumibox.colour", &colour);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(r, 0, "lumibox.colour", exr, err);
    }
    r->layout.colour[0] = colour.x;
    r->layout.colour[1] = colour.y;
    r->layout.colour[2] = colour.z;
    TRY(get_v3d(r, 0, "lumibox.boundsMin", &r->layout.bounds_min, err));
    TRY(get_v3d(r, 0, "lumibox.boundsMax", &r->layout.bounds_max, err));
    TRY(get_double(r, 0, "lumibox.size", &r->layout.size, err));
    for (uint32_t i = 0; i < r->layout.slab_count; i++) {
        TRY(read_slab(r, i, err));
    }
    lmg_error reason = {.message = ""};
    const lmg_result result = lmg_layout_check(&r->layout, &reason);
    return result == LMG_OK ? LMG_OK : lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: impossible layout: %.240s", r->where, reason.message);
}

static lmg_result read_texts(reader *r, lmg_error *err)
{
    static const char prefix[] = "lumibox.text.";
    int32_t count = 0;
    const exr_result_t exr = exr_get_attribute_count(r->context, 0, &count);
    if (exr != EXR_ERR_SUCCESS) {
        return fail_exr(err, LMG_ERROR_FILE_FORMAT, &r->stream, r->where, "can't count the attributes", exr);
    }
    for (int32_t i = 0; i < count; i++) {
        const exr_attribute_t *attribute = NULL;
        if (exr_get_attribute_by_index(r->context, 0, EXR_ATTR_LIST_SORTED_ORDER, i, &attribute) != EXR_ERR_SUCCESS) {
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: can't get attribute %d", r->where, (int)i);
        }
        if (strncmp(attribute->name, prefix, strlen(prefix)) == 0) {
            char *value = NULL;
            TRY(get_string(r, 0, attribute->name, &value, err));
            lmg_error reason = {.message = ""};
            const lmg_result result = lmg_field_set_text(r->field, attribute->name + strlen(prefix), value, &reason);
            free(value);
            if (result != LMG_OK) {
                return lmg_fail(err, result == LMG_ERROR_MEMORY ? result : LMG_ERROR_FILE_FORMAT, "%s: attribute \"%s\": %.200s", r->where,
                                attribute->name, reason.message);
            }
        }
    }
    return LMG_OK;
}

/* A thread's decoder; one is good for all tiles of a part, so it's renewed when the part changes. */
typedef struct decoder {
    bool started;
    int part;
    exr_decode_pipeline_t pipeline;
} decoder;

_Static_assert(sizeof(decoder) <= WORK_SCRATCH, "a thread's scratch space holds its decoder");

/* Decompresses a tile into the decoder's buffer. */
static exr_result_t decode(const reader *r, decoder *d, int part, const exr_chunk_info_t *chunk)
{
    exr_result_t exr;
    if (d->started && d->part != part) {
        exr_decoding_destroy(r->context, &d->pipeline);
        memset(d, 0, sizeof *d);
    }
    if (d->started) {
        exr = exr_decoding_update(r->context, part, chunk, &d->pipeline);
    } else {
        exr = exr_decoding_initialize(r->context, part, chunk, &d->pipeline);
        d->started = exr == EXR_ERR_SUCCESS;
        d->part = part;
        if (d->started) {
            exr = exr_decoding_choose_default_routines(r->context, part, &d->pipeline);
            d->pipeline.unpack_and_convert_fn = NULL; /* read_tile sorts the channels into our arrays */
        }
    }
    if (exr == EXR_ERR_SUCCESS) {
        exr = exr_decoding_run(r->context, part, &d->pipeline);
    }
    if (exr == EXR_ERR_SUCCESS && (d->pipeline.unpacked_buffer == NULL || d->pipeline.unpacked_alloc_size < chunk->unpacked_size)) {
        exr = EXR_ERR_CORRUPT_CHUNK;
    }
    return exr;
}

static lmg_result read_tile(reader *r, decoder *d, uint32_t slab, uint64_t tile_in_slab, lmg_error *err)
{
    const lmg_slab *s = &r->layout.slabs[slab];
    lmg_slab_data *data = &r->field->slabs[slab];
    const int part = (int)slab, column = (int)(tile_in_slab % s->nu), row = (int)(tile_in_slab / s->nu);
    const uint64_t cells = tile_cells(s), channels = r->layout.channels, first = tile_in_slab * cells;
    exr_chunk_info_t chunk;
    exr_result_t exr = exr_read_tile_chunk_info(r->context, part, column, row, 0, 0, &chunk);
    if (exr == EXR_ERR_SUCCESS && (chunk.unpacked_size != cells * (channels + 2) * sizeof(float) || chunk.data_offset > r->stream.size ||
                                   chunk.packed_size > r->stream.size - chunk.data_offset)) {
        exr = EXR_ERR_CORRUPT_CHUNK;
    }
    const unsigned char *from = NULL;
    if (exr == EXR_ERR_SUCCESS && chunk.packed_size == chunk.unpacked_size) { /* stored as it is: nothing to decode */
        from = r->stream.bytes + chunk.data_offset;
    } else if (exr == EXR_ERR_SUCCESS) {
        exr = decode(r, d, part, &chunk);
        from = d->pipeline.unpacked_buffer;
    }
    if (exr != EXR_ERR_SUCCESS) {
        return fail_exr(err, LMG_ERROR_FILE_READ, &r->stream, r->where, "damaged: a tile can't be decoded", exr);
    }
    /* a line of the tile holds its channels one after the other, sorted by name: B, G, R or Y, then half_a.Y, stderr.Y */
    const size_t line_bytes = s->ns * sizeof(float);
    for (uint32_t it = 0; it < s->nt; it++) {
        const uint64_t line = first + (uint64_t)it * s->ns;
        for (uint32_t c = 0; c < channels; c++) {
            if (channels == 1) {
                memcpy(data->radiance + line, from, line_bytes);
            } else {
                float *to = data->radiance + 3 * line + (2 - c);
                for (uint32_t is = 0; is < s->ns; is++) {
                    memcpy(to + 3 * (size_t)is, from + is * sizeof(float), sizeof(float));
                }
            }
            from += line_bytes;
        }
        memcpy(data->half_a + line, from, line_bytes);
        memcpy(data->standard_error + line, from + line_bytes, line_bytes);
        from += 2 * line_bytes;
    }
    if (!tile_is_sound(&r->tiles, slab, tile_in_slab)) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d, tile %d,%d holds a value that is no finite number, or a negative standard error",
                        r->where, part, column, row);
    }
    r->tiles.hashes[r->tiles.start[slab] + tile_in_slab] = hash_tile(&r->tiles, slab, tile_in_slab);
    return LMG_OK;
}

static lmg_result read_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    reader *r = self;
    const uint64_t first = index * r->tiles.run, after = first + r->tiles.run < r->tiles.end ? first + r->tiles.run : r->tiles.end;
    for (uint64_t tile = first; tile < after; tile++) {
        const uint32_t slab = tile_slab(&r->tiles, tile);
        TRY(read_tile(r, scratch, slab, tile - r->tiles.start[slab], err));
    }
    return LMG_OK;
}

static void read_end(void *self, void *scratch)
{
    const reader *r = self;
    decoder *d = scratch;
    if (d->started) {
        exr_decoding_destroy(r->context, &d->pipeline);
    }
}

static lmg_result read_all(reader *r, lmg_error *err)
{
    TRY(read_layout(r, err));
    uint64_t hash;
    TRY(get_number(r, "lumibox.hash", 16, &hash, err));
    lmg_error reason = {.message = ""};
    lmg_result result = lmg_field_allocate(&r->layout, &r->field, &reason);
    if (result != LMG_OK) {
        return lmg_fail(err, result, "%s: %.250s", r->where, reason.message);
    }
    TRY(get_number(r, "lumibox.photons", 10, &r->field->ledger.photons, err));
    double ledger[LEDGER_ENTRIES][2];
    for (int i = 0; i < LEDGER_ENTRIES; i++) {
        TRY(get_v2d(r, 0, ledger_names[i], &ledger[i][0], &ledger[i][1], err));
    }
    ledger_set(&r->field->ledger, (const double(*)[2])ledger);
    TRY(read_texts(r, err));
    TRY(check_field(r->field, r->where, LMG_ERROR_FILE_FORMAT, err));

    tiles_init(&r->tiles, &r->field->layout);
    r->tiles.field = r->field;
    r->tiles.hashes = calloc((size_t)r->tiles.end, sizeof *r->tiles.hashes);
    if (r->tiles.hashes == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for the hashes of %" PRIu64 " tiles", r->where, r->tiles.end);
    }
    work w = {.piece = read_run,
              .end = read_end,
              .self = r,
              .scratch_size = sizeof(decoder),
              .count = (r->tiles.end + r->tiles.run - 1) / r->tiles.run};
    TRY(work_do(&w, err));
    if (hash_field(&r->tiles) != hash) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: altered after it was written: its content hash disagrees; copy or bake it again", r->where);
    }
    result = lmg_field_prepare(r->field, &reason);
    return result == LMG_OK ? LMG_OK : lmg_fail(err, result, "%s: %.250s", r->where, reason.message);
}

lmg_result lmg_field_read_memory(const void *bytes, size_t size, const char *name, lmg_field **out, lmg_error *err)
{
    if (out == NULL || (bytes == NULL && size > 0)) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lmg_field_read_memory: no bytes, or nowhere to put the field");
    }
    *out = NULL;
    const shown_path where = show(name != NULL && name[0] != 0 ? name : "box in memory");
    lmg_exr_fault fault;
    if (lmg_exr_check(bytes, size, &fault) != LMG_OK) {
        return lmg_fail(err, fault.code, "%s: %s", where.text, fault.text);
    }
    reader *r = calloc(1, sizeof *r); /* a layout is 7 kB: not for the stacks of a host's threads */
    if (r == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory", where.text);
    }
    r->where = where.text;
    r->stream.bytes = bytes;
    r->stream.size = size;
    if (pthread_mutex_init(&r->stream.lock, NULL) != 0) {
        free(r);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: can't make a lock", where.text);
    }
    exr_context_initializer_t init = context_initializer(&r->stream);
    init.read_fn = stream_read;
    init.size_fn = stream_size;
    const exr_result_t exr = exr_start_read(&r->context, where.text, &init);
    lmg_result result;
    if (exr != EXR_ERR_SUCCESS) {
        result = fail_exr(err, LMG_ERROR_FILE_FORMAT, &r->stream, where.text, "not a box file", exr);
    } else {
        result = read_all(r, err);
    }
    exr_finish(&r->context);
    if (result == LMG_OK) {
        *out = r->field;
    } else {
        lmg_field_destroy(r->field);
    }
    free(r->tiles.hashes);
    pthread_mutex_destroy(&r->stream.lock);
    free(r);
    return result;
}

static lmg_result read_bytes(int fd, const char *path, unsigned char **out, size_t *size, lmg_error *err)
{
    struct stat info;
    if (fstat(fd, &info) != 0) {
        return fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't open", errno);
    }
    if (S_ISDIR(info.st_mode)) {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: is a directory; name the box file in it", show(path).text);
    }
    if (!S_ISREG(info.st_mode)) {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: isn't a regular file; copy its content to one", show(path).text);
    }
    if (info.st_size < 0 || (uint64_t)info.st_size > SIZE_MAX - 1) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: larger than this machine's memory", show(path).text);
    }
    *size = (size_t)info.st_size;
    *out = malloc(*size + 1);
    if (*out == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its %zu bytes", show(path).text, *size);
    }
    size_t done = 0;
    while (done < *size) {
        const ssize_t count = pread(fd, *out + done, *size - done, (off_t)done);
        if (count < 0 && errno == EINTR) {
            continue;
        }
        if (count < 0) {
            return fail_errno(err, LMG_ERROR_FILE_READ, path, "can't read", errno);
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
        return fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't open", errno);
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

/* ---------------------------------------------------------------------------------------------------------------- writing */

/* The packed form of one tile on its way from the thread that made it to the file. */
typedef struct packed_tile {
    void *bytes; /* owned */
    size_t size;
} packed_tile;

typedef struct writer {
    exr_context_t context;
    stream stream;
    const char *where;
    const lmg_field *field;
    exr_compression_t compression;
    int level;
    tiles tiles;
    packed_tile *packed; /* tiles.end - tiles.first of them */
} writer;

typedef struct encoder {
    bool started;
    int part;
    packed_tile *target;
    exr_encode_pipeline_t pipeline;
} encoder;

_Static_assert(sizeof(encoder) <= WORK_SCRATCH, "a thread's scratch space holds its encoder");

/* Stands in for the pipeline's writing: keeps the packed bytes until it's their turn. */
static exr_result_t keep_packed(exr_encode_pipeline_t *pipeline)
{
    packed_tile *target = ((encoder *)pipeline->encoding_user_data)->target;
    const void *bytes = pipeline->compressed_buffer;
    target->size = pipeline->compressed_bytes;
    /* No compression, or none gained.  When deflating ends at just the unpacked size, OpenEXRCore 3.1.5 hands over the deflated bytes,
     * which every reader would take for unpacked ones. */
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
    exr_result_t exr = exr_write_tile_chunk_info(w->context, part, column, row, 0, 0, &chunk);
    if (exr == EXR_ERR_SUCCESS && e->started && e->part != part) {
        exr_encoding_destroy(w->context, &e->pipeline);
        memset(e, 0, sizeof *e);
    }
    const bool fresh = !e->started;
    if (exr == EXR_ERR_SUCCESS) {
        if (fresh) {
            exr = exr_encoding_initialize(w->context, part, &chunk, &e->pipeline);
            e->started = exr == EXR_ERR_SUCCESS;
            e->part = part;
        } else {
            exr = exr_encoding_update(w->context, part, &chunk, &e->pipeline);
        }
    }
    if (exr == EXR_ERR_SUCCESS) {
        const uint64_t channels = w->field->layout.channels, first = tile_in_slab * tile_cells(s);
        for (int c = 0; c < e->pipeline.channel_count; c++) {
            exr_coding_channel_info_t *info = &e->pipeline.channels[c];
            const float *from;
            uint64_t step = 1;
            if (strcmp(info->channel_name, "half_a.Y") == 0) {
                from = data->half_a + first;
            } else if (strcmp(info->channel_name, "stderr.Y") == 0) {
                from = data->standard_error + first;
            } else { /* B, G, R; or Y */
                step = channels;
                from = data->radiance + first * channels + (channels == 3 ? 2 - c : 0);
            }
            info->encode_from_ptr = (const uint8_t *)from;
            info->user_data_type = EXR_PIXEL_FLOAT;
            info->user_bytes_per_element = sizeof(float);
            info->user_pixel_stride = (int32_t)(step * sizeof(float));
            info->user_line_stride = (int32_t)(step * sizeof(float) * s->ns);
        }
        if (fresh) {
            exr = exr_encoding_choose_default_routines(w->context, part, &e->pipeline);
            e->pipeline.write_fn = keep_packed;
            e->pipeline.yield_until_ready_fn = NULL;
            e->pipeline.encoding_user_data = e;
        }
    }
    e->target = target;
    if (exr == EXR_ERR_SUCCESS) {
        exr = exr_encoding_run(w->context, part, &e->pipeline);
    }
    return exr == EXR_ERR_SUCCESS ? LMG_OK : fail_exr(err, LMG_ERROR_FILE_WRITE, &w->stream, w->where, "can't encode a tile", exr);
}

static lmg_result pack_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    writer *w = self;
    const uint64_t first = w->tiles.first + index * w->tiles.run;
    const uint64_t after = first + w->tiles.run < w->tiles.end ? first + w->tiles.run : w->tiles.end;
    for (uint64_t tile = first; tile < after; tile++) {
        const uint32_t slab = tile_slab(&w->tiles, tile);
        TRY(pack_tile(w, scratch, slab, tile - w->tiles.start[slab], &w->packed[tile - w->tiles.first], err));
    }
    return LMG_OK;
}

static void pack_end(void *self, void *scratch)
{
    const writer *w = self;
    encoder *e = scratch;
    if (e->started) {
        exr_encoding_destroy(w->context, &e->pipeline);
    }
}

static lmg_result hash_run(void *self, uint64_t index, void *scratch, lmg_error *err)
{
    (void)scratch;
    writer *w = self;
    const uint64_t first = index * w->tiles.run, after = first + w->tiles.run < w->tiles.end ? first + w->tiles.run : w->tiles.end;
    for (uint64_t tile = first; tile < after; tile++) {
        const uint32_t slab = tile_slab(&w->tiles, tile);
        const uint64_t tile_in_slab = tile - w->tiles.start[slab];
        if (!tile_is_sound(&w->tiles, slab, tile_in_slab)) {
            const uint32_t nu = w->field->layout.slabs[slab].nu;
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "%s: slab %u, cell u %u, v %u holds a value that is no finite number, or a negative standard error",
                            w->where, slab, (unsigned)(tile_in_slab % nu), (unsigned)(tile_in_slab / nu));
        }
        w->tiles.hashes[tile] = hash_tile(&w->tiles, slab, tile_in_slab);
    }
    return LMG_OK;
}

/* Attributes are set one after the other; the first failure is kept and reported once. */
typedef struct attribute_setter {
    exr_context_t context;
    int part;
    exr_result_t first;
} attribute_setter;

static void note(attribute_setter *s, exr_result_t result)
{
    if (s->first == EXR_ERR_SUCCESS) {
        s->first = result;
    }
}

static void set_v2d(attribute_setter *s, const char *name, double x, double y)
{
    exr_attr_v2d_t v;
    v.x = x;
    v.y = y;
    note(s, exr_attr_set_v2d(s->context, s->part, name, &v));
}

static void set_v3d(attribute_setter *s, const char *name, lmg_vec3 vec)
{
    exr_attr_v3d_t v;
    v.x = vec.x;
    v.y = vec.y;
    v.z = vec.z;
    note(s, exr_attr_set_v3d(s->context, s->part, name, &v));
}

static void set_v2i(attribute_setter *s, const char *name, uint32_t x, uint32_t y)
{
    exr_attr_v2i_t v;
    v.x = (int32_t)x;
    v.y = (int32_t)y;
    note(s, exr_attr_set_v2i(s->context, s->part, name, &v));
}

static void set_part(writer *w, attribute_setter *s, uint32_t slab, int32_t display_width, int32_t display_height)
{
    const lmg_layout *l = &w->field->layout;
    const lmg_slab *geometry = &l->slabs[slab];
    char name[16];
    snprintf(name, sizeof name, "slab%02u", slab);
    note(s, exr_add_part(s->context, name, EXR_STORAGE_TILED, &s->part));
    if (s->first != EXR_ERR_SUCCESS) {
        return;
    }
    exr_attr_box2i_t data = {.min = {.x = 0, .y = 0}}, display = data;
    data.max.x = (int32_t)(geometry->nu * geometry->ns) - 1;
    data.max.y = (int32_t)(geometry->nv * geometry->nt) - 1;
    display.max.x = display_width - 1;
    display.max.y = display_height - 1;
    const exr_attr_v2f_t center = {.x = 0, .y = 0};
    note(s, exr_initialize_required_attr(s->context, s->part, &display, &data, 1.0f, &center, 1.0f, EXR_LINEORDER_INCREASING_Y,
                                         w->compression));
    static const char *const one[] = {"Y", "half_a.Y", "stderr.Y"}, *const three[] = {"B", "G", "R", "half_a.Y", "stderr.Y"};
    for (uint32_t c = 0; c < l->channels + 2; c++) {
        note(s, exr_add_channel(s->context, s->part, l->channels == 1 ? one[c] : three[c], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1));
    }
    note(s, exr_set_tile_descriptor(s->context, s->part, geometry->ns, geometry->nt, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN));
    note(s, exr_attr_set_float(s->context, s->part, "whiteLuminance", 1.0f)); /* R = G = B = 1 is 1 cd/m2 */
    note(s, exr_attr_set_int(s->context, s->part, "lumibox.slab", (int32_t)slab));
    note(s, exr_attr_set_string(s->context, s->part, "lumibox.kind", geometry->kind == LMG_SLAB_CUBE ? "cube" : "aperture"));
    set_v3d(s, "lumibox.o", geometry->o);
    set_v3d(s, "lumibox.a", geometry->a);
    set_v3d(s, "lumibox.b", geometry->b);
    set_v3d(s, "lumibox.n", geometry->n);
    note(s, exr_attr_set_double(s->context, s->part, "lumibox.distance", geometry->distance));
    set_v2d(s, "lumibox.u", geometry->u0, geometry->u1);
    set_v2d(s, "lumibox.v", geometry->v0, geometry->v1);
    set_v2d(s, "lumibox.s", geometry->s0, geometry->s1);
    set_v2d(s, "lumibox.t", geometry->t0, geometry->t1);
    set_v2i(s, "lumibox.uvCells", geometry->nu, geometry->nv);
    set_v2i(s, "lumibox.stCells", geometry->ns, geometry->nt);
}

static lmg_result set_header(writer *w, uint64_t hash, lmg_error *err)
{
    const lmg_layout *l = &w->field->layout;
    attribute_setter s = {.context = w->context};
    bool long_names = false;
    for (size_t i = 0; i < w->field->text_count; i++) {
        long_names = long_names || strlen("lumibox.text.") + strlen(w->field->texts[i].name) > LMG_EXR_SHORT_NAME;
    }
    note(&s, exr_set_longname_support(w->context, long_names));
    int32_t display_width = 1, display_height = 1; /* OpenEXR wants one display window for all parts */
    for (uint32_t i = 0; i < l->slab_count; i++) {
        const int32_t width = (int32_t)(l->slabs[i].nu * l->slabs[i].ns), height = (int32_t)(l->slabs[i].nv * l->slabs[i].nt);
        display_width = width > display_width ? width : display_width;
        display_height = height > display_height ? height : display_height;
    }
    for (uint32_t i = 0; i < l->slab_count; i++) {
        set_part(w, &s, i, display_width, display_height);
    }
    s.part = 0;
    char number[24];
    note(&s, exr_attr_set_int(s.context, 0, "lumibox.version", FORMAT_VERSION));
    note(&s, exr_attr_set_int(s.context, 0, "lumibox.slabs", (int32_t)l->slab_count));
    note(&s, exr_attr_set_int(s.context, 0, "lumibox.channels", (int32_t)l->channels));
    exr_attr_v3f_t colour;
    colour.x = l->colour[0];
    colour.y = l->colour[1];
    colour.z = l->colour[2];
    note(&s, exr_attr_set_v3f(s.context, 0, "lumibox.colour", &colour));
    set_v3d(&s, "lumibox.boundsMin", l->bounds_min);
    set_v3d(&s, "lumibox.boundsMax", l->bounds_max);
    note(&s, exr_attr_set_double(s.context, 0, "lumibox.size", l->size));
    snprintf(number, sizeof number, "%" PRIu64, w->field->ledger.photons);
    note(&s, exr_attr_set_string(s.context, 0, "lumibox.photons", number));
    double ledger[LEDGER_ENTRIES][2];
    ledger_get(&w->field->ledger, ledger);
    for (int i = 0; i < LEDGER_ENTRIES; i++) {
        set_v2d(&s, ledger_names[i], ledger[i][0], ledger[i][1]);
    }
    snprintf(number, sizeof number, "%016" PRIx64, hash);
    note(&s, exr_attr_set_string(s.context, 0, "lumibox.hash", number));
    for (size_t i = 0; i < w->field->text_count; i++) {
        char name[sizeof "lumibox.text." + sizeof w->field->texts[i].name];
        snprintf(name, sizeof name, "lumibox.text.%s", w->field->texts[i].name);
        note(&s, exr_attr_set_string(s.context, 0, name, w->field->texts[i].value));
    }
    if (s.first == EXR_ERR_SUCCESS) {
        s.first = exr_write_header(s.context);
    }
    return s.first == EXR_ERR_SUCCESS ? LMG_OK : fail_exr(err, LMG_ERROR_FILE_WRITE, &w->stream, w->where, "can't write the header", s.first);
}

/* Tiles are packed in batches of about this much data: enough for the processors, little beside the field itself. */
enum { BATCH_BYTES = 16 << 20 };

static lmg_result write_tiles(writer *w, lmg_error *err)
{
    const uint64_t all = w->tiles.end;
    uint64_t batch = w->tiles.run * (BATCH_BYTES / RUN_BYTES);
    batch = batch < all ? batch : all;
    w->packed = calloc((size_t)batch, sizeof *w->packed);
    if (w->packed == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for packing tiles", w->where);
    }
    lmg_result result = LMG_OK;
    for (uint64_t first = 0; first < all && result == LMG_OK; first += batch) {
        w->tiles.first = first;
        w->tiles.end = first + batch < all ? first + batch : all;
        work job = {.piece = pack_run,
                    .end = pack_end,
                    .self = w,
                    .scratch_size = sizeof(encoder),
                    .count = (w->tiles.end - first + w->tiles.run - 1) / w->tiles.run};
        result = work_do(&job, err);
        for (uint64_t tile = first; tile < w->tiles.end; tile++) {
            packed_tile *packed = &w->packed[tile - first];
            if (result == LMG_OK) {
                const uint32_t slab = tile_slab(&w->tiles, tile), nu = w->field->layout.slabs[slab].nu;
                const uint64_t in_slab = tile - w->tiles.start[slab];
                const exr_result_t exr = exr_write_tile_chunk(w->context, (int)slab, (int)(in_slab % nu), (int)(in_slab / nu), 0, 0, packed->bytes,
                                                              packed->size);
                if (exr != EXR_ERR_SUCCESS) {
                    result = fail_exr(err, LMG_ERROR_FILE_WRITE, &w->stream, w->where, "can't write a tile", exr);
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
    tiles_init(&w->tiles, &w->field->layout);
    w->tiles.field = w->field;
    w->tiles.hashes = calloc((size_t)w->tiles.end, sizeof *w->tiles.hashes);
    w->stream.buffer = malloc(WRITE_BUFFER);
    lmg_result result = LMG_OK;
    if (w->tiles.hashes == NULL || w->stream.buffer == NULL) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for writing", w->where);
    }
    if (result == LMG_OK) {
        work job = {.piece = hash_run, .self = w, .count = (w->tiles.end + w->tiles.run - 1) / w->tiles.run};
        result = work_do(&job, err);
    }
    if (result == LMG_OK) {
        exr_context_initializer_t init = context_initializer(&w->stream);
        init.write_fn = stream_write;
        init.zip_level = w->level;
        exr_result_t exr = exr_start_write(&w->context, w->where, EXR_WRITE_FILE_DIRECTLY, &init);
        if (exr != EXR_ERR_SUCCESS) {
            result = fail_exr(err, LMG_ERROR_FILE_WRITE, &w->stream, w->where, "can't start writing", exr);
        }
        if (result == LMG_OK) {
            result = set_header(w, hash_field(&w->tiles), err);
        }
        if (result == LMG_OK) {
            result = write_tiles(w, err);
        }
        exr = exr_finish(&w->context);
        if (result == LMG_OK && exr != EXR_ERR_SUCCESS) {
            result = fail_exr(err, LMG_ERROR_FILE_WRITE, &w->stream, w->where, "can't finish the file", exr);
        }
    }
    if (result == LMG_OK && (!stream_flush(&w->stream) || fsync(w->stream.fd) != 0)) {
        result = fail_errno(err, LMG_ERROR_FILE_WRITE, path, "can't write", w->stream.write_errno != 0 ? w->stream.write_errno : errno);
    } else if (result != LMG_OK && w->stream.write_errno != 0) { /* OpenEXRCore only knows that writing failed, not why */
        result = fail_errno(err, LMG_ERROR_FILE_WRITE, path, "can't write", w->stream.write_errno);
    }
    free(w->stream.buffer);
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
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its name", show(path).text);
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
    return fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't create a file in its directory", number);
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

lmg_result lmg_field_write(const lmg_field *field, const char *path, lmg_error *err)
{
    return lmg_field_write_as(field, path, LMG_EXR_ZIP, ZIP_LEVEL, err);
}

lmg_result lmg_field_write_as(const lmg_field *field, const char *path, lmg_exr_compression compression, int level, lmg_error *err)
{
    if (field == NULL || path == NULL || path[0] == 0) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "lmg_field_write: no field or no path");
    }
    const shown_path where = show(path);
    struct stat info;
    if (stat(path, &info) == 0 && !S_ISREG(info.st_mode)) { /* renaming would put a file in a device's place */
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: is %s; name a file", where.text, S_ISDIR(info.st_mode) ? "a directory" : "not a regular file");
    }
    if (path[strlen(path) - 1] == '/') {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: names a directory; name a file", where.text);
    }
    TRY(check_field(field, where.text, LMG_ERROR_ARGUMENT, err));
    writer *w = calloc(1, sizeof *w);
    if (w == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory", where.text);
    }
    w->field = field;
    w->where = where.text;
    w->compression = compression == LMG_EXR_NONE ? EXR_COMPRESSION_NONE : compression == LMG_EXR_ZIPS ? EXR_COMPRESSION_ZIPS : EXR_COMPRESSION_ZIP;
    w->level = level;
    if (pthread_mutex_init(&w->stream.lock, NULL) != 0) {
        free(w);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: can't make a lock", where.text);
    }
    char *temporary = NULL;
    lmg_result result = create_temporary(path, &temporary, &w->stream.fd, err);
    if (result == LMG_OK) {
        result = write_exr(w, path, err);
        if (close(w->stream.fd) != 0 && result == LMG_OK) {
            result = fail_errno(err, LMG_ERROR_FILE_WRITE, path, "can't write", errno);
        }
        if (result == LMG_OK && rename(temporary, path) != 0) {
            result = fail_errno(err, LMG_ERROR_FILE_OPEN, path, "can't give the finished file its name", errno);
        }
        if (result == LMG_OK) {
            sync_directory(path);
        } else {
            unlink(temporary);
        }
        free(temporary);
    }
    pthread_mutex_destroy(&w->stream.lock);
    free(w);
    return result;
}
