/* SPDX-License-Identifier: Apache-2.0 */
/* HTML pages with plots.  Relies on the program gnuplot (terminal svg) and POSIX processes. */
#include "page.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

struct report_page {
    FILE *to; /* writes into text */
    char *text;
    size_t size;
    unsigned plots; /* so far: makes the identifiers in their SVG different */
    lmg_result result;
    lmg_error error;
};

/* Colours that stay apart for colour-blind readers (Okabe and Ito 2008), and in print by their order of lightness. */
static const char *const COLOURS[] = {"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"};
enum { COLOUR_COUNT = sizeof(COLOURS) / sizeof(COLOURS[0]) };

static const char STYLE[] = "body{font:15px/1.5 system-ui,sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}"
                            "h1{font-size:1.6em}h2{font-size:1.25em;margin-top:2em}table{border-collapse:collapse;margin:1em 0}"
                            "td,th{padding:.2em .8em;border-bottom:1px solid #ddd;text-align:right}"
                            "td:first-child,th:first-child{text-align:left}th{border-bottom:2px solid #888}"
                            ".plots{display:flex;gap:1em}.plots svg{flex:1 1 30%;min-width:0}svg{max-width:48em;height:auto;display:block}";

static void escape(FILE *to, const char *text)
{
    for (const char *c = text; *c; ++c)
        switch (*c) {
        case '&':
            fputs("&amp;", to);
            break;
        case '<':
            fputs("&lt;", to);
            break;
        case '>':
            fputs("&gt;", to);
            break;
        case '"':
            fputs("&quot;", to);
            break;
        default:
            fputc(*c, to);
        }
}

static void escape_format(FILE *to, const char *format, va_list arguments)
{
    char text[4096];
    vsnprintf(text, sizeof(text), format, arguments);
    escape(to, text);
}

lmg_result report_page_create(const char *title, report_page **out, lmg_error *err)
{
    *out = NULL;
    report_page *p = calloc(1, sizeof(*p));
    if (p)
        p->to = open_memstream(&p->text, &p->size);
    if (!p || !p->to) {
        free(p);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a report");
    }
    fputs("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n<title>", p->to);
    escape(p->to, title);
    fprintf(p->to, "</title>\n<style>%s</style></head><body>\n<h1>", STYLE);
    escape(p->to, title);
    fputs("</h1>\n", p->to);
    *out = p;
    return LMG_OK;
}

void report_page_destroy(report_page *p)
{
    if (!p)
        return;
    if (p->to)
        fclose(p->to);
    free(p->text);
    free(p);
}

void report_page_heading(report_page *p, const char *format, ...)
{
    fputs("<h2>", p->to);
    va_list arguments;
    va_start(arguments, format);
    escape_format(p->to, format, arguments);
    va_end(arguments);
    fputs("</h2>\n", p->to);
}

void report_page_text(report_page *p, const char *format, ...)
{
    fputs("<p>", p->to);
    va_list arguments;
    va_start(arguments, format);
    escape_format(p->to, format, arguments);
    va_end(arguments);
    fputs("</p>\n", p->to);
}

/* Cells of a row: the text between tabs. */
static void cells(FILE *to, const char *tag, char *text)
{
    fputs("<tr>", to);
    for (char *cell = text, *tab; cell; cell = tab ? tab + 1 : NULL) {
        tab = strchr(cell, '\t');
        if (tab)
            *tab = 0;
        fprintf(to, "<%s>", tag);
        escape(to, cell);
        fprintf(to, "</%s>", tag);
    }
    fputs("</tr>\n", to);
}

void report_page_table(report_page *p, const char *columns)
{
    char text[1024];
    snprintf(text, sizeof(text), "%s", columns);
    fputs("<table>\n", p->to);
    cells(p->to, "th", text);
}

void report_page_row(report_page *p, const char *format, ...)
{
    char text[4096];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof(text), format, arguments);
    va_end(arguments);
    cells(p->to, "td", text);
}

void report_page_table_end(report_page *p)
{
    fputs("</table>\n", p->to);
}

/* ------------------------------------------------------------------------------------------------------------- gnuplot */

/* A text in gnuplot's single quotes, where it expands nothing (in double ones what stands between backquotes would be run), with its
 * markup switched off by the terminal. */
static void quoted(FILE *to, const char *text)
{
    fputc('\'', to);
    for (const char *c = text; *c; ++c) {
        if (*c == '\'')
            fputc('\'', to);
        fputc(*c == '\n' ? ' ' : *c, to);
    }
    fputc('\'', to);
}

static FILE *begin_script(report_page *p, int width, int height)
{
    if (p->result != LMG_OK)
        return NULL;
    FILE *script = tmpfile();
    if (!script) {
        p->result = lmg_fail(&p->error, LMG_ERROR_FILE_WRITE, "can't make a temporary file for a plot: %s", strerror(errno));
        return NULL;
    }
    fprintf(script,
            "set terminal svg size %d,%d dynamic noenhanced font 'sans-serif,12' background 'white' name 'p%u'\n"
            "set encoding utf8\nset grid lc rgb '#cccccc'\nset key outside top center horizontal\n",
            width, height, p->plots++);
    return script;
}

/* Runs gnuplot on the script and takes what it draws into the page; closes the script. */
static void end_script(report_page *p, FILE *script)
{
    FILE *drawn = NULL;
    if (fflush(script) == 0 && !ferror(script))
        drawn = tmpfile();
    int status = -1, failure = errno;
    if (drawn) {
        rewind(script);
        posix_spawn_file_actions_t actions;
        posix_spawn_file_actions_init(&actions);
        posix_spawn_file_actions_adddup2(&actions, fileno(script), STDIN_FILENO);
        posix_spawn_file_actions_adddup2(&actions, fileno(drawn), STDOUT_FILENO);
        posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", 1 /* O_WRONLY */, 0);
        static char name[] = "gnuplot";
        char *const arguments[] = {name, NULL};
        pid_t child;
        failure = posix_spawnp(&child, name, &actions, NULL, arguments, environ);
        posix_spawn_file_actions_destroy(&actions);
        if (failure == 0)
            while (waitpid(child, &status, 0) < 0 && errno == EINTR)
                ;
    }
    if (status != 0) {
        if (failure == ENOENT)
            p->result = lmg_fail(&p->error, LMG_ERROR_UNSUPPORTED,
                                 "a report's plots need the program gnuplot; on Debian: apt-get install gnuplot-nox");
        else
            p->result = lmg_fail(&p->error, LMG_ERROR_UNSUPPORTED, "gnuplot failed to draw a plot (%s)",
                                 failure ? strerror(failure) : "it ended with an error");
    } else {
        char line[4096];
        rewind(drawn);
        while (fgets(line, sizeof(line), drawn))
            if (strncmp(line, "<?xml", 5)) /* a declaration belongs to the head of a file only */
                fputs(line, p->to);
    }
    if (drawn)
        fclose(drawn);
    fclose(script);
}

static void data_blocks(FILE *to, const report_curve *curves, size_t count, bool log_x, bool log_y)
{
    for (size_t i = 0; i < count; ++i) {
        fprintf(to, "$d%zu << END\n", i);
        const report_curve *c = &curves[i];
        for (size_t k = 0; k < c->count; ++k) {
            const double x = c->x[k], y = c->y[k], se = c->y_se ? c->y_se[k] : 0;
            if (isfinite(x) && isfinite(y) && isfinite(se) && !(log_x && x <= 0) && !(log_y && y <= 0))
                fprintf(to, "%.9g %.9g %.9g\n", x, y, se);
        }
        fputs("END\n", to);
    }
}

/* Whether gnuplot would find a point of any curve to draw: it treats an empty plot as an error. */
static bool drawable(const report_curve *curves, size_t count, bool log_x, bool log_y)
{
    for (size_t i = 0; i < count; ++i)
        for (size_t k = 0; k < curves[i].count; ++k) {
            const double x = curves[i].x[k], y = curves[i].y[k];
            if (isfinite(x) && isfinite(y) && !(log_x && x <= 0) && !(log_y && y <= 0))
                return true;
        }
    return false;
}

void report_page_plot(report_page *p, const report_axes *axes, const report_curve *curves, size_t count)
{
    if (!drawable(curves, count, axes->log_x, axes->log_y)) {
        report_page_text(p, "%s: no value to draw.", axes->title);
        return;
    }
    FILE *s = begin_script(p, 760, 420);
    if (!s)
        return;
    data_blocks(s, curves, count, axes->log_x, axes->log_y);
    fputs("set title ", s);
    quoted(s, axes->title);
    fputs("\nset xlabel ", s);
    quoted(s, axes->x);
    fputs("\nset ylabel ", s);
    quoted(s, axes->y);
    fprintf(s, "\n%s%sset format '%%g'\nplot ", axes->log_x ? "set logscale x\n" : "", axes->log_y ? "set logscale y\n" : "");
    for (size_t i = 0; i < count; ++i) {
        const char *colour = COLOURS[i % COLOUR_COUNT];
        fprintf(s, "%s$d%zu using 1:2 with linespoints pt 7 ps 0.4 lw 1.5 lc rgb '%s' title ", i ? ", " : "", i, colour);
        quoted(s, curves[i].name);
        if (curves[i].y_se)
            fprintf(s, ", $d%zu using 1:2:3 with yerrorbars pt 0 lw 1 lc rgb '%s' notitle", i, colour);
    }
    fputc('\n', s);
    end_script(p, s);
}

void report_page_polar(report_page *p, const char *title, const report_curve *curves, size_t count)
{
    if (!drawable(curves, count, false, false)) {
        report_page_text(p, "%s: no value to draw.", title);
        return;
    }
    FILE *s = begin_script(p, 480, 480);
    if (!s)
        return;
    data_blocks(s, curves, count, false, false);
    fputs("set title ", s);
    quoted(s, title);
    fputs("\nset polar\nset angles degrees\nset theta bottom counterclockwise\nset grid polar 30\nset ttics 0,30\nunset xtics\n"
          "unset ytics\nunset border\nset size square\nset rrange [0:*]\nplot ",
          s);
    for (size_t i = 0; i < count; ++i) {
        fprintf(s, "%s$d%zu using 1:2 with lines lw 1.5 lc rgb '%s' title ", i ? ", " : "", i, COLOURS[i % COLOUR_COUNT]);
        quoted(s, curves[i].name);
    }
    fputc('\n', s);
    end_script(p, s);
}

void report_page_maps(report_page *p, const report_map *maps, size_t count)
{
    fputs("<div class=\"plots\">\n", p->to);
    for (size_t m = 0; m < count; ++m) {
        const report_map *map = &maps[m];
        FILE *s = begin_script(p, 380, 340);
        if (!s)
            break;
        /* Pixels as rectangles: the picture format of gnuplot's SVG would need a file beside the page. */
        fputs("$d << END\n", s);
        for (uint32_t y = 0; y < map->ny; ++y)
            for (uint32_t x = 0; x < map->nx; ++x) {
                const double v = map->values[(size_t)y * map->nx + x];
                fprintf(s, "%.6g %.6g %.6g\n", ((x + 0.5) / map->nx - 0.5) * map->width, ((y + 0.5) / map->ny - 0.5) * map->height,
                        isfinite(v) ? v : 0);
            }
        fputs("END\nset title ", s);
        char title[256];
        snprintf(title, sizeof(title), "%s, %s", map->title, map->unit);
        quoted(s, title);
        const double most = map->most > map->least ? map->most : map->least + 1;
        fprintf(s, "\nunset key\nunset grid\nset size ratio -1\nset format '%%g'\nset palette defined (%s)\n",
                map->diverging ? "0 '#2166ac', 0.5 'white', 1 '#b2182b'" : "0 'black', 0.35 '#7a1f5c', 0.7 '#f08030', 1 '#ffffd0'");
        fprintf(s, "set cbrange [%.9g:%.9g]\nset xrange [%.9g:%.9g]\nset yrange [%.9g:%.9g]\nset xtics %.3g\nset ytics %.3g\n", map->least,
                most, -0.5 * map->width, 0.5 * map->width, -0.5 * map->height, 0.5 * map->height, map->width / 4, map->height / 4);
        fputs("plot $d using 1:2:3 with image pixels\n", s);
        end_script(p, s);
    }
    fputs("</div>\n", p->to);
}

lmg_result report_page_write(report_page *p, const char *path, lmg_error *err)
{
    if (p->result == LMG_OK && (fputs("</body></html>\n", p->to) < 0 || fflush(p->to) != 0))
        p->result = lmg_fail(&p->error, LMG_ERROR_MEMORY, "no memory for a report");
    if (p->result != LMG_OK)
        return lmg_fail(err, p->result, "%s: %.400s", path, p->error.message);
    const size_t length = strlen(path) + 32;
    char *temporary = malloc(length);
    if (!temporary)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory to write %s", path);
    snprintf(temporary, length, "%s.%ld.part", path, (long)getpid());
    FILE *file = fopen(temporary, "wb");
    bool written = file && fwrite(p->text, 1, p->size, file) == p->size;
    int failure = errno;
    if (file && fclose(file) != 0 && written) {
        written = false;
        failure = errno;
    }
    if (written && rename(temporary, path) != 0) {
        written = false;
        failure = errno;
    }
    if (!written) {
        if (file)
            remove(temporary);
        lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't write: %s", path, strerror(failure));
    }
    free(temporary);
    return written ? LMG_OK : LMG_ERROR_FILE_WRITE;
}
