/* SPDX-License-Identifier: Apache-2.0 */
/* Large zeroed tables, for the files of this library only. */
#ifndef LUMIGRAPH_MEMORY_H
#define LUMIGRAPH_MEMORY_H

#include <stdbool.h>
#include <stddef.h>

/* Zeroed memory, aligned to 64 bytes at least, pages given lazily where the system can, in huge pages where it offers them (a random
 * look-up in 100 MB misses the TLB on small pages nearly every time).  NULL when there is none.  Freed by lmg_table_free with the same
 * size. */
void *lmg_table_alloc(size_t bytes);
void lmg_table_free(void *table, size_t bytes);

/* a * b, false when it doesn't fit a size_t. */
static inline bool lmg_size_product(size_t a, size_t b, size_t *out)
{
    if (b && a > (size_t)-1 / b)
        return false;
    *out = a * b;
    return true;
}

#endif
