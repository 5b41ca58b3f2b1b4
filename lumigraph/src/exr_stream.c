/* SPDX-License-Identifier: Apache-2.0 */
/*
 * OpenEXRCore's callbacks: bytes read from memory, bytes written to a file through a buffer, and its first message kept for ours.
 * Relies on POSIX pwrite.
 */
#include "exr_stream.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static void stream_error(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)code;
    void *user = NULL;
    if (context != NULL && exr_get_user_data(context, &user) == EXR_ERR_SUCCESS && user != NULL && message != NULL) {
        lmg_exr_stream *s = user;
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

int64_t lmg_exr_stream_read(exr_const_context_t context, void *user, void *buffer, uint64_t size, uint64_t offset,
                            exr_stream_error_func_ptr_t error_cb)
{
    (void)context;
    (void)error_cb;
    const lmg_exr_stream *s = user;
    if (offset >= s->size) {
        return 0;
    }
    const uint64_t available = s->size - offset, count = size < available ? size : available;
    memcpy(buffer, s->bytes + offset, (size_t)count);
    return (int64_t)count;
}

int64_t lmg_exr_stream_size(exr_const_context_t context, void *user)
{
    (void)context;
    const lmg_exr_stream *s = user;
    return (int64_t)s->size;
}

bool lmg_exr_flush(lmg_exr_stream *s)
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

int64_t lmg_exr_stream_write(exr_const_context_t context, void *user, const void *bytes, uint64_t size, uint64_t offset,
                             exr_stream_error_func_ptr_t error_cb)
{
    (void)context;
    (void)error_cb;
    lmg_exr_stream *s = user;
    if (s->write_errno != 0) {
        return -1;
    }
    if (offset != s->buffer_offset + s->buffered) {
        if (!lmg_exr_flush(s)) {
            return -1;
        }
        s->buffer_offset = offset;
    }
    const unsigned char *from = bytes;
    uint64_t todo = size;
    while (todo > 0) {
        const size_t room = LMG_EXR_WRITE_BUFFER - s->buffered, count = todo < room ? (size_t)todo : room;
        memcpy(s->buffer + s->buffered, from, count);
        s->buffered += count;
        from += count;
        todo -= count;
        if (s->buffered == LMG_EXR_WRITE_BUFFER && !lmg_exr_flush(s)) {
            return -1;
        }
    }
    return (int64_t)size;
}

lmg_result lmg_exr_fail(lmg_error *err, lmg_result code, lmg_exr_file *file, const char *what, exr_result_t exr)
{
    lmg_exr_stream *s = &file->stream;
    pthread_mutex_lock(&s->lock);
    const char *reason = s->message[0] != 0 ? s->message : exr_get_default_error_message(exr);
    const lmg_result result =
        lmg_fail(err, exr == EXR_ERR_OUT_OF_MEMORY ? LMG_ERROR_MEMORY : code, "%s: %s: %s", file->where, what, reason);
    pthread_mutex_unlock(&s->lock);
    return result;
}

exr_context_initializer_t lmg_exr_initializer(lmg_exr_stream *s)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = stream_error;
    init.user_data = s;
    init.flags = EXR_CONTEXT_FLAG_DISABLE_CHUNK_RECONSTRUCTION;
    return init;
}
