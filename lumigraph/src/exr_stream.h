/* SPDX-License-Identifier: Apache-2.0 */
/* An EXR file as OpenEXRCore sees it: where its bytes come from or go to, and where its messages end.  For the files of this
 * library only. */
#ifndef LUMIGRAPH_EXR_STREAM_H
#define LUMIGRAPH_EXR_STREAM_H

#include <lumigraph/lumigraph.h>

#include <openexr.h>

#include <pthread.h>
#include <stdbool.h>

#define LMG_TRY(call)                                                                                                              \
    do {                                                                                                                           \
        const lmg_result try_result = (call);                                                                                      \
        if (try_result != LMG_OK) {                                                                                                \
            return try_result;                                                                                                     \
        }                                                                                                                          \
    } while (0)

/* What OpenEXRCore calls back with: bytes to read from, or a file to write to, and where its messages go. */
typedef struct lmg_exr_stream {
    const unsigned char *bytes; /* reading */
    size_t size;
    int fd; /* writing */
    uint64_t buffer_offset;
    size_t buffered;
    unsigned char *buffer; /* LMG_EXR_WRITE_BUFFER bytes */
    int write_errno;
    pthread_mutex_t lock; /* guards message: decoding calls from several threads */
    char message[256];    /* OpenEXRCore's first */
} lmg_exr_stream;

enum { LMG_EXR_WRITE_BUFFER = 1 << 20 };

/* A file being read or written. */
typedef struct lmg_exr_file {
    exr_context_t context;
    lmg_exr_stream stream;
    const char *where; /* the file's name as messages show it */
} lmg_exr_file;

/* For a context whose messages go to the stream; the caller adds the functions below. */
exr_context_initializer_t lmg_exr_initializer(lmg_exr_stream *s);

int64_t lmg_exr_stream_read(exr_const_context_t context, void *user, void *buffer, uint64_t size, uint64_t offset,
                            exr_stream_error_func_ptr_t error_cb);
int64_t lmg_exr_stream_size(exr_const_context_t context, void *user);
int64_t lmg_exr_stream_write(exr_const_context_t context, void *user, const void *bytes, uint64_t size, uint64_t offset,
                             exr_stream_error_func_ptr_t error_cb);

/* Writes what is buffered; false, with write_errno set, when that fails. */
bool lmg_exr_flush(lmg_exr_stream *s);

/* lmg_fail with "where: what: OpenEXRCore's reason". */
lmg_result lmg_exr_fail(lmg_error *err, lmg_result code, lmg_exr_file *file, const char *what, exr_result_t exr);

#endif
