/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fuzz target of checkpoints: any bytes are refused with one line or give a part that can be saved, loaded and saved again to the
 * same bytes. (Built for fuzzing, the reader takes checkpoints whatever their hash says.)
 */
#include "fuzz.h"

#include "part.h"

typedef struct buffer {
    uint8_t *bytes;
    size_t size;
} buffer;

static bool append(void *self, const void *bytes, size_t count)
{
    buffer *b = self;
    uint8_t *grown = realloc(b->bytes, b->size + count + 1);
    if (!grown)
        abort();
    memcpy(grown + b->size, bytes, count);
    b->bytes = grown;
    b->size += count;
    return true;
}

static buffer save(const bake_part *part)
{
    buffer b = {0};
    lmg_error err = {{0}};
    if (bake_part_save(part, append, &b, &err) != LMG_OK)
        abort();
    return b;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    lmg_error err = {{0}};
    bake_part *part = NULL, *again = NULL;
    if (bake_part_load(bytes, size, "fuzz", &part, &err) != LMG_OK) {
        if (part)
            abort();
        fuzz_check_message(&err);
        return 0;
    }
    buffer first = save(part);
    if (bake_part_load(first.bytes, first.size, "again", &again, &err) != LMG_OK)
        abort();
    buffer second = save(again);
    if (first.size != second.size || memcmp(first.bytes, second.bytes, first.size) != 0)
        abort();
    free(first.bytes);
    free(second.bytes);
    bake_part_destroy(part);
    bake_part_destroy(again);
    return 0;
}
