/* SPDX-License-Identifier: Apache-2.0 */
/* What fuzz targets share, and the entry that a fuzzer calls, for tests that replay inputs through it. */
#ifndef TESTS_FUZZ_H
#define TESTS_FUZZ_H

#include <lumigraph/lumigraph.h>

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

/* A refusal is one line of text. */
static inline void fuzz_check_message(const lmg_error *err)
{
    if (!err->message[0] || strchr(err->message, '\n') || !memchr(err->message, 0, sizeof(err->message)))
        abort();
}

#endif
