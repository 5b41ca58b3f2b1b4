/* SPDX-License-Identifier: Apache-2.0 */
/* Runs the program under test and keeps what it says.  Relies on POSIX processes. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "run_lumibake.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

char folder[1024];

char *slurp(const char *path, size_t *size)
{
    FILE *f = fopen(path, "rb");
    if (!f)
        return NULL;
    fseek(f, 0, SEEK_END);
    const long n = ftell(f);
    rewind(f);
    char *text = malloc((size_t)n + 1);
    assert_non_null(text);
    assert_int_equal(fread(text, 1, (size_t)n, f), n);
    text[n] = 0;
    fclose(f);
    if (size)
        *size = (size_t)n;
    return text;
}

void write_file(const char *path, const void *bytes, size_t size)
{
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(bytes, 1, size, f), size);
    fclose(f);
}

const char *in_folder(const char *name)
{
    static char paths[8][1200];
    static int turn;
    char *path = paths[turn++ % 8];
    snprintf(path, sizeof(paths[0]), "%s/%s", folder, name);
    return path;
}

int make_folder(void **state)
{
    (void)state;
    const char *base = getenv("TMPDIR");
    snprintf(folder, sizeof(folder), "%s/lumibox-test-XXXXXX", base ? base : "/tmp");
    if (!mkdtemp(folder))
        return -1;
    write_file(in_folder("stdin"), "", 0);
    return 0;
}

int remove_folder(void **state)
{
    (void)state;
    char command[1100];
    snprintf(command, sizeof(command), "rm -rf '%s'", folder);
    return system(command);
}

pid_t start_program(const char *program, const char *const *args)
{
    char *argv[32] = {(char *)(uintptr_t)program};
    int n = 1;
    for (; args[n - 1]; ++n) {
        assert_true(n < 31);
        argv[n] = (char *)(uintptr_t)args[n - 1];
    }
    const char *out = in_folder("stdout"), *err = in_folder("stderr");
    fflush(NULL);
    const pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        const int o = open(out, O_WRONLY | O_CREAT | O_TRUNC, 0666), e = open(err, O_WRONLY | O_CREAT | O_TRUNC, 0666);
        const int i = open(in_folder("stdin"), O_RDONLY | O_CREAT, 0666);
        dup2(i, 0);
        dup2(o, 1);
        dup2(e, 2);
        alarm(240); /* a hang is a failure */
        execv(argv[0], argv);
        _exit(127);
    }
    return pid;
}

pid_t start(const char *const *args)
{
    return start_program(LUMIBAKE, args);
}

outcome finish(pid_t pid)
{
    int status;
    while (waitpid(pid, &status, 0) < 0)
        assert_int_equal(errno, EINTR);
    outcome o = {.code = WIFEXITED(status) ? WEXITSTATUS(status) : KILLED + WTERMSIG(status)};
    o.out = slurp(in_folder("stdout"), NULL);
    o.err = slurp(in_folder("stderr"), NULL);
    assert_true(o.out && o.err);
    return o;
}

outcome run_args(const char *const *args)
{
    return finish(start(args));
}

void release(outcome *o)
{
    free(o->out);
    free(o->err);
}

int lines_with(const char *text, const char *start)
{
    int n = 0;
    for (const char *line = text; *line;) {
        n += !strncmp(line, start, strlen(start));
        line += strcspn(line, "\n");
        line += *line == '\n';
    }
    return n;
}

int lines_of(const char *text)
{
    return lines_with(text, "");
}

void expect(int line, outcome o, int code, const char *message)
{
    if (o.code != code || !strstr(o.err, message))
        fail_msg("line %d: exit code %d, expected %d and \"%s\" in: %s", line, o.code, code, message, o.err);
    if (lines_with(o.err, "error:") != 1)
        fail_msg("line %d: not one error line: %s", line, o.err);
    release(&o);
}

void pause_seconds(double s)
{
    const struct timespec t = {(time_t)s, (long)(1e9 * (s - floor(s)))};
    nanosleep(&t, NULL);
}
