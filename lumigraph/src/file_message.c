/* SPDX-License-Identifier: Apache-2.0 */
/* Error messages about files: a path that fits, and the system's reason.  Relies on POSIX strerror_r. */
#include "file_message.h"

#include <stdio.h>
#include <string.h>

lmg_shown_path lmg_show_path(const char *path)
{
    lmg_shown_path shown;
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

lmg_result lmg_fail_errno(lmg_error *err, lmg_result code, const char *path, const char *what, int number)
{
    char reason[128];
    if (strerror_r(number, reason, sizeof reason) != 0) {
        snprintf(reason, sizeof reason, "error %d", number);
    }
    return lmg_fail(err, code, "%s: %s: %s", lmg_show_path(path).text, what, reason);
}
