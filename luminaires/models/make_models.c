/* SPDX-License-Identifier: Apache-2.0 */
/* make_models FOLDER: writes our sample lamps and the sample room into FOLDER/NAME/NAME.gltf.  A build step. */
#include "models.h"

#include "vdb_shim.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

int main(int argc, char **argv)
{
    static const struct {
        const char *name;
        void (*make)(const char *folder);
    } models[] = {{"paraboloid-spot", make_paraboloid_spot},
                  {"opal-globe", make_opal_globe},
                  {"louvred-panel", make_louvred_panel},
                  {"glass-lens", make_glass_lens},
                  {"opal-ball", make_opal_ball},
                  {"smoke-lamp", make_smoke_lamp},
                  {"edge-lit-panel", make_edge_lit_panel},
                  {"prism-lamp", make_prism_lamp},
                  {"phosphor-led", make_phosphor_led},
                  {"room", make_room}};

    if (argc != 2 || argv[1][0] == '-') {
        fprintf(stderr, "usage: make_models FOLDER\nWrites the sample lamps and the sample room into FOLDER/NAME/NAME.gltf\n");
        return 2;
    }
    for (size_t i = 0; i < sizeof models / sizeof *models; i++) {
        if (models[i].make == make_smoke_lamp && !lum_vdb_available()) {
            printf("make_models: smoke-lamp is left out, as this build has no OpenVDB\n");
            continue;
        }
        char folder[4096];
        int length = snprintf(folder, sizeof folder, "%s/%s", argv[1], models[i].name);
        if (length < 0 || (size_t)length >= sizeof folder || (mkdir(argv[1], 0777) != 0 && errno != EEXIST) ||
            (mkdir(folder, 0777) != 0 && errno != EEXIST)) {
            fprintf(stderr, "make_models: can't make the folder %s/%s: %s\n", argv[1], models[i].name, strerror(errno));
            return 1;
        }
        models[i].make(folder);
    }
    return 0;
}
