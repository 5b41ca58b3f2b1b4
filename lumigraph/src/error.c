/* SPDX-License-Identifier: Apache-2.0 */
/* Error texts and the version.  Relies on nothing but libc. */
#include <lumigraph/lumigraph.h>

#include <stdarg.h>
#include <stdio.h>

const char *lmg_version(void)
{
    return LMG_VERSION_STRING;
}

lmg_result lmg_fail(lmg_error *err, lmg_result code, const char *format, ...)
{
    if (err) {
        va_list args;
        va_start(args, format);
        vsnprintf(err->message, sizeof err->message, format, args);
        va_end(args);
    }
    return code;
}
