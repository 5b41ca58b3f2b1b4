/* SPDX-License-Identifier: Apache-2.0 */
/* The program lumiview: finds the command and runs it.  Command line only, no physics. */
#include "lumiview.h"

#include <math.h>
#include <openexr.h>
#include <png.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifndef LUMIVIEW_REVISION
#define LUMIVIEW_REVISION "unknown revision"
#endif

void say_error(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fputs("error: ", stderr);
    vfprintf(stderr, format, arguments);
    fputc('\n', stderr);
    va_end(arguments);
}

int say_usage(const char *command, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fputs("error: ", stderr);
    vfprintf(stderr, format, arguments);
    fprintf(stderr, " (see lumiview %s --help)\n", command);
    va_end(arguments);
    return EXIT_USAGE;
}

int say_result(lmg_result result, const lmg_error *err)
{
    say_error("%s", err->message);
    switch (result) {
    case LMG_ERROR_ARGUMENT:
        return EXIT_USAGE;
    case LMG_ERROR_FILE_OPEN:
    case LMG_ERROR_FILE_READ:
    case LMG_ERROR_FILE_FORMAT:
    case LMG_ERROR_FILE_VERSION:
    case LMG_ERROR_INPUT:
    case LMG_ERROR_UNSUPPORTED:
        return EXIT_INPUT;
    default:
        return EXIT_FAILED;
    }
}

bool read_count(const char *text, uint64_t maximum, uint64_t *out)
{
    char *end;
    if (*text >= '0' && *text <= '9' && strspn(text, "0123456789") == strlen(text) && strlen(text) < 20) {
        *out = strtoull(text, &end, 10);
        return *out <= maximum;
    }
    double value = strtod(text, &end);
    /* Whole numbers up to 2^53 are exact in a double. */
    if (end == text || *end || !(value >= 0 && value <= 0x1p53) || value != floor(value) || (uint64_t)value > maximum) {
        return false;
    }
    *out = (uint64_t)value;
    return true;
}

bool read_positive(const char *text, const char *unit, double *out)
{
    char *end;
    *out = strtod(text, &end);
    return end != text && (*end == '\0' || strcmp(end, unit) == 0) && isfinite(*out) && *out > 0;
}

bool read_seconds(const char *text, double *out)
{
    char *end;
    *out = strtod(text, &end);
    if (end == text) {
        return false;
    }
    if (strcmp(end, "m") == 0 || strcmp(end, "min") == 0) {
        *out *= 60;
    } else if (strcmp(end, "h") == 0) {
        *out *= 3600;
    } else if (*end && strcmp(end, "s") != 0) {
        return false;
    }
    return isfinite(*out) && *out > 0;
}

bool read_size(const char *text, uint32_t maximum, uint32_t *width, uint32_t *height)
{
    unsigned w, h;
    int used = 0;
    if (sscanf(text, "%5ux%5u%n", &w, &h, &used) != 2 || text[used] || strspn(text, "0123456789x") != strlen(text)) {
        return false;
    }
    *width = w;
    *height = h;
    return w >= 1 && h >= 1 && w <= maximum && h <= maximum;
}

static void print_help(void)
{
    puts("lumiview: renders rooms that are lit by baked boxes of light\n"
         "\n"
         "  lumiview render ROOM.gltf --light LAMP.box.exr@X,Y,Z --png room.png   a picture of a room\n"
         "  lumiview diff A.exr B.exr --png diff.png                              how two pictures differ\n"
         "  lumiview study ROOM.gltf --light BOX@X,Y,Z --lamp LAMP.gltf@X,Y,Z     what accuracy costs in time, box and geometry\n"
         "  lumiview --version\n"
         "\n"
         "lumiview COMMAND --help says more.\n"
         "Exit codes: 0 done, 1 failed, 2 wrong usage, 3 bad input, 130 interrupted (what there is has been written).");
}

int main(int argc, char **argv)
{
    const char *command = argc > 1 ? argv[1] : "";
    if (strcmp(command, "render") == 0) {
        return cmd_render(argc - 1, argv + 1);
    }
    if (strcmp(command, "diff") == 0) {
        return cmd_diff(argc - 1, argv + 1);
    }
    if (strcmp(command, "study") == 0) {
        return cmd_study(argc - 1, argv + 1);
    }
    if (strcmp(command, "--help") == 0 || strcmp(command, "-h") == 0 || strcmp(command, "help") == 0) {
        print_help();
        return EXIT_DONE;
    }
    if (strcmp(command, "--version") == 0) {
        printf("lumiview %s (%s), lumigraph %s, OpenEXR %s, libpng %s\n", LMG_VERSION_STRING, LUMIVIEW_REVISION, lmg_version(),
               OPENEXR_VERSION_STRING, PNG_LIBPNG_VER_STRING);
        return EXIT_DONE;
    }
    if (argc > 1) {
        say_error("there is no command \"%s\"; the commands are render, diff and study (see lumiview --help)", command);
    } else {
        say_error("which command? render, diff or study (see lumiview --help)");
    }
    return EXIT_USAGE;
}
