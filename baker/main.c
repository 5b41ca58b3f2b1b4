/* SPDX-License-Identifier: Apache-2.0 */
/* The program lumibake: chooses the command. */
#include "program.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "versions.h"

static const struct {
    const char *name, *what;
    int (*run)(int argc, char **argv);
} COMMANDS[] = {
    {"bake", "trace a luminaire's light (glTF) into a box of light (.box.exr)", cmd_bake},
    {"plan", "which effects of light a luminaire shows, which a bake simulates, and why", cmd_plan},
    {"info", "say what is in a box: layout, planes, flux, provenance", cmd_info},
    {"probe", "measure in a box's light: illuminance, luminance, intensity", cmd_probe},
    {"merge", "parts of one bake, from several runs or machines, into its box", cmd_merge},
    {"compare", "two lamps or boxes on the same receivers: how much they differ", cmd_compare},
    {"study", "what accuracy costs in time: a lamp's error against photons, cells and size", cmd_study},
    {"convert", "light from one form into another: ray files, boxes", cmd_convert},
};
enum { COMMAND_COUNT = sizeof(COMMANDS) / sizeof(COMMANDS[0]) };

static void print_help(FILE *to)
{
    fputs("Usage: lumibake COMMAND [OPTION...]\n"
          "Bakes luminaires into boxes of light: near-field light of a lamp in one file.\n\nCommands:\n",
          to);
    for (int i = 0; i < COMMAND_COUNT; ++i)
        fprintf(to, "  %-10s %s\n", COMMANDS[i].name, COMMANDS[i].what);
    fputs("\n  --help     this text; lumibake COMMAND --help tells a command's options\n"
          "  --version  versions of the program and of its libraries\n\n"
          "Exit codes: 0 done, 1 failed, 2 usage, 3 bad input, 4 compare: beyond the tolerance, 130 interrupted.\n\n"
          "Example:\n"
          "  lumibake bake lamp.gltf -o lamp.box.exr --time 60s\n",
          to);
}

int main(int argc, char **argv)
{
    argp_err_exit_status = EXIT_USAGE;
    argp_program_version_hook = print_versions;
    if (argc < 2) {
        print_help(stderr);
        return EXIT_USAGE;
    }
    if (!strcmp(argv[1], "--help") || !strcmp(argv[1], "-?") || !strcmp(argv[1], "help")) {
        print_help(stdout);
        return EXIT_DONE;
    }
    if (!strcmp(argv[1], "--version") || !strcmp(argv[1], "-V")) {
        print_versions(stdout, NULL);
        return EXIT_DONE;
    }
    for (int i = 0; i < COMMAND_COUNT; ++i)
        if (!strcmp(argv[1], COMMANDS[i].name)) {
            char name[32];
            snprintf(name, sizeof(name), "lumibake %s", COMMANDS[i].name);
            argv[1] = name;
            return COMMANDS[i].run(argc - 1, argv + 1);
        }
    fprintf(stderr, "error: '%s' is not a command of lumibake (see lumibake --help)\n", argv[1]);
    return EXIT_USAGE;
}
