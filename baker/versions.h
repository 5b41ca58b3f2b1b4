/* SPDX-License-Identifier: Apache-2.0 */
#ifndef BAKER_VERSIONS_H
#define BAKER_VERSIONS_H

#include <stdio.h>

struct argp_state;

/* Prints the versions of the program and of the libraries it was built with; an argp_program_version_hook. */
void print_versions(FILE *to, struct argp_state *state);

#endif
