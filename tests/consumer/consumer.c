/* SPDX-License-Identifier: Apache-2.0 */
/* What a renderer does with the installed library: reads a box and prints the radiance along one ray.  Uses the public header alone. */
#include <lumigraph/lumigraph.h>

#include <stdio.h>
#include <string.h>

int main(int argc, char **argv)
{
    if (argc != 2 || strcmp(lmg_version(), LMG_VERSION_STRING) != 0) {
        fprintf(stderr, "usage: consumer FILE.box.exr (library %s, header %s)\n", lmg_version(), LMG_VERSION_STRING);
        return 2;
    }
    lmg_field *field;
    lmg_error error;
    if (lmg_field_read(argv[1], &field, &error) != LMG_OK) {
        fprintf(stderr, "%s\n", error.message);
        return 3;
    }
    const lmg_vec3 origin = {0.1, 0.2, 3}, direction = {0, 0, 1};
    float rgb[3];
    lmg_field_radiance(field, origin, direction, LMG_NEAREST, rgb, NULL);
    printf("%.3f %.3f %.3f cd/m2\n", (double)rgb[0], (double)rgb[1], (double)rgb[2]);
    lmg_field_destroy(field);
    return 0;
}
