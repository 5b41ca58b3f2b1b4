/* SPDX-License-Identifier: Apache-2.0 */
/* Large zeroed tables.  On Linux an anonymous mapping with huge pages asked for; elsewhere aligned memory that is cleared. */
#if defined(__linux__)
#define _DEFAULT_SOURCE /* madvise, MAP_ANONYMOUS */
#endif
#include "memory.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__linux__)
#include <sys/mman.h>

enum { HUGE_PAGE = 2 << 20 };

/* Small tables come from calloc: a mapping each would waste pages.  Which of the two a table is follows from its size alone. */
static bool is_mapped(size_t bytes)
{
    return bytes >= (size_t)2 * HUGE_PAGE;
}

void *lmg_table_alloc(size_t bytes)
{
    if (bytes > SIZE_MAX / 2)
        return NULL;
    if (is_mapped(bytes)) {
        /* Mapped with one huge page to spare, then trimmed at both ends so that it starts on a huge page. */
        size_t length = (bytes + HUGE_PAGE - 1) / HUGE_PAGE * HUGE_PAGE;
        char *raw = mmap(NULL, length + HUGE_PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (raw == MAP_FAILED)
            return NULL;
        size_t head = (HUGE_PAGE - (uintptr_t)raw % HUGE_PAGE) % HUGE_PAGE;
        if (head)
            munmap(raw, head);
        if (head < HUGE_PAGE)
            munmap(raw + head + length, HUGE_PAGE - head);
        (void)madvise(raw + head, length, MADV_HUGEPAGE); /* advice only: without it the table is slower, not wrong */
        return raw + head;
    }
    size_t padded = (bytes + 63) / 64 * 64 + (bytes == 0) * 64;
    void *table = aligned_alloc(64, padded);
    if (table)
        memset(table, 0, padded);
    return table;
}

void lmg_table_free(void *table, size_t bytes)
{
    if (!table)
        return;
    if (is_mapped(bytes))
        munmap(table, (bytes + HUGE_PAGE - 1) / HUGE_PAGE * HUGE_PAGE);
    else
        free(table);
}
#else
void *lmg_table_alloc(size_t bytes)
{
    if (bytes > SIZE_MAX / 2)
        return NULL;
    size_t padded = (bytes + 63) / 64 * 64 + (bytes == 0) * 64;
    void *table = aligned_alloc(64, padded);
    if (table)
        memset(table, 0, padded);
    return table;
}

void lmg_table_free(void *table, size_t bytes)
{
    (void)bytes;
    free(table);
}
#endif
