/* SPDX-License-Identifier: Apache-2.0 */
/* Tables of numbers from CSV text: what lumibake probe is asked. */
#ifndef BAKER_TABLE_H
#define BAKER_TABLE_H

#include <lumigraph/lumigraph.h>

typedef struct table {
    size_t columns, rows;
    double *values; /* rows * columns */
    size_t *lines;  /* line number of each row, from 1 */
} table;

/*
 * Reads a table with a fixed number of columns; path "-" is standard input.  Separators: comma, semicolon or tab, blanks around
 * them don't count.  '#' starts a comment, empty lines are skipped, and a first line that holds no number at all is a header.
 * Errors (LMG_ERROR_FILE_OPEN, LMG_ERROR_INPUT) say file, line and what was expected; names: the columns' names for the messages.
 */
lmg_result table_read(const char *path, size_t columns, const char *names, table *out, lmg_error *err);
void table_free(table *t);

#endif
