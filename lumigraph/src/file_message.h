/* SPDX-License-Identifier: Apache-2.0 */
/* Error messages about files, for the files of this library only. */
#ifndef LUMIGRAPH_FILE_MESSAGE_H
#define LUMIGRAPH_FILE_MESSAGE_H

#include <lumigraph/lumigraph.h>

/* A path as messages show it: messages have room for 512 bytes, paths may be longer, and the end is what tells files apart. */
typedef struct lmg_shown_path {
    char text[200];
} lmg_shown_path;

lmg_shown_path lmg_show_path(const char *path);

/* lmg_fail with "path: what: the system's words for number", an errno. */
lmg_result lmg_fail_errno(lmg_error *err, lmg_result code, const char *path, const char *what, int number);

#endif
