/* SPDX-License-Identifier: Apache-2.0 */
/* Versions for --version.  Library versions come from the build (LUMIBOX_VERSIONS, baker/CMakeLists.txt). */
#include "versions.h"

#include <lumigraph/lumigraph.h>

#include <jansson.h>

void print_versions(FILE *to, struct argp_state *state)
{
    (void)state;
    fprintf(to, "lumibake %s (lumigraph %s; %s, jansson %s)\n", LMG_VERSION_STRING, lmg_version(), LUMIBOX_VERSIONS,
            jansson_version_str());
}
