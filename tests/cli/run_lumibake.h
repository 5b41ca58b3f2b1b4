/* SPDX-License-Identifier: Apache-2.0 */
/* The program lumibake run as a user runs it, for tests that look at its exit code, its words and its files.  To be included after
 * cmocka.h; LUMIBAKE is the program's path. */
#ifndef TESTS_RUN_LUMIBAKE_H
#define TESTS_RUN_LUMIBAKE_H

#include <stddef.h>
#include <sys/types.h>

/* Where a test's files go; it holds a file "stdin".  A test that has no folder of its own takes the fixtures: a new one, removed after. */
extern char folder[1024];
int make_folder(void **state);
int remove_folder(void **state);
/* A path in it; the last eight stay valid. */
const char *in_folder(const char *name);

enum { KILLED = 1000 };

typedef struct outcome {
    int code; /* exit code; KILLED + signal */
    char *out, *err;
} outcome;

/* The whole of a file with a 0 behind it, to be freed; NULL if it can't be opened.  size may be NULL. */
char *slurp(const char *path, size_t *size);
void write_file(const char *path, const void *bytes, size_t size);

/* Starts the program with these arguments (the last one NULL); one at a time. */
pid_t start(const char *const *args);
pid_t start_program(const char *program, const char *const *args);
outcome finish(pid_t pid);
outcome run_args(const char *const *args);
#define RUN(...) run_args((const char *const[]){__VA_ARGS__, NULL})
void release(outcome *o);

/* Lines of text that begin with `start`; all lines. */
int lines_with(const char *text, const char *start);
int lines_of(const char *text);

/* Exit code, a part of the message, and exactly one line that begins with "error:". */
void expect(int line, outcome o, int code, const char *message);
#define EXPECT(run, code, message) expect(__LINE__, run, code, message)

void pause_seconds(double s);

#endif
