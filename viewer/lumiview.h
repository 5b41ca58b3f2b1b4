/* SPDX-License-Identifier: Apache-2.0 */
/* What the commands of lumiview share: exit codes, messages, option values. */
#ifndef VIEWER_LUMIVIEW_H
#define VIEWER_LUMIVIEW_H

#include <lumigraph/lumigraph.h>

enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2, EXIT_INPUT = 3, EXIT_INTERRUPTED = 130 };

int cmd_render(int argc, char **argv);
int cmd_diff(int argc, char **argv);
int cmd_study(int argc, char **argv);

/* One line "error: ..." on stderr. */
void say_error(const char *format, ...) __attribute__((format(printf, 1, 2)));
/* The same for wrong usage, with a hint at --help; returns EXIT_USAGE. */
int say_usage(const char *command, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* Prints the error and returns the exit code that goes with it. */
int say_result(lmg_result result, const lmg_error *err);

/* Option values.  False when the text isn't one. */
bool read_count(const char *text, uint64_t maximum, uint64_t *out);                    /* a whole number, also as 1e6 */
bool read_positive(const char *text, const char *unit, double *out);                   /* a number > 0, the unit may follow */
bool read_seconds(const char *text, double *out);                                      /* 90, 90s, 1.5m, 1.5min, 2h */
bool read_size(const char *text, uint32_t maximum, uint32_t *width, uint32_t *height); /* 960x540 */

#endif
