/* SPDX-License-Identifier: Apache-2.0 */
/* The smoke lamp: a small bulb in the middle of a puff of smoke, whose density is written as an OpenVDB grid; see dimensions.h. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include "vdb_shim.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static const double PI = 3.14159265358979323846;

static void write_smoke(const char *folder)
{
    enum { N = 2 * SMOKE_REACH + 1 };
    const int32_t low[3] = {-SMOKE_REACH, -SMOKE_REACH, -SMOKE_REACH};
    const uint32_t size[3] = {N, N, N};
    const double v = SMOKE_VOXEL, to_world[3][4] = {{v, 0, 0, 0}, {0, v, 0, 0}, {0, 0, v, 0}};
    float *values = malloc((size_t)N * N * N * sizeof *values);
    char path[4200];
    lmg_error err = {""};
    if (!values) {
        fprintf(stderr, "make_models: out of memory\n");
        exit(1);
    }
    for (int i = 0; i < N * N * N; i++) {
        const int x = i / (N * N) - SMOKE_REACH, y = i / N % N - SMOKE_REACH, z = i % N - SMOKE_REACH;
        const double r = v * sqrt((double)(x * x + y * y + z * z));
        values[i] = (float)exp(-r * r / (2 * SMOKE_WIDTH * SMOKE_WIDTH));
    }
    snprintf(path, sizeof path, "%s/smoke.vdb", folder);
    if (lum_vdb_write(path, "density", low, size, values, to_world, &err) != LMG_OK) {
        fprintf(stderr, "make_models: %s\n", err.message);
        exit(1);
    }
    free(values);
}

void make_smoke_lamp(const char *folder)
{
    gltf_file *file = gltf_begin("smoke-lamp");
    const double centre[3] = {0, 0, 0};
    mesh m = {0};
    gltf_material bulb = {.name = "Bulb", .color = {0, 0, 0}, .roughness = 1, .emission_color = {1, 1, 1}};
    mesh_add_sphere(&m, centre, SMOKE_BULB_RADIUS, 32, 64);
    bulb.luminance = SMOKE_FLUX / (PI * mesh_area(&m));
    gltf_add(file, "Bulb", &m, &bulb);
    mesh_free(&m);
    gltf_end(file, folder);
    write_smoke(folder);
}
