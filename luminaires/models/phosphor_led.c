/* SPDX-License-Identifier: Apache-2.0 */
/* The phosphor-converted LED: a blue chip in a white cup under a layer of phosphor; see dimensions.h. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

void make_phosphor_led(const char *folder)
{
    enum { SEGMENTS = 64 };
    gltf_file *file = gltf_begin("phosphor-led");
    const double centre[3] = {0, 0, 0}, r = PHOSPHOR_CUP_RADIUS, depth = PHOSPHOR_CUP_DEPTH, c = PHOSPHOR_CUP_REFLECTANCE;
    mesh m = {0};

    /* The layer closes the cup, in the opening's plane; its front looks down, outwards. */
    mesh_add_cone(&m, centre, 0, 0, r, 0, 1, 1, SEGMENTS);
    const gltf_material layer = {.name = "Phosphor", .color = {0.9, 0.8, 0.2}, .roughness = 1, .double_sided = true};
    gltf_add(file, "Layer", &m, &layer);
    mesh_free(&m);

    /* Wall and bottom of the cup, white towards the inside and outside. */
    const gltf_material white = {.name = "White silicone", .color = {c, c, c}, .roughness = 1, .double_sided = true};
    mesh_add_cone(&m, centre, r, 0, r, depth, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, 0, depth, r, depth, 1, 1, SEGMENTS);
    gltf_add(file, "Cup", &m, &white);
    mesh_free(&m);

    /* Package round the cup: a ring in the opening's plane, and a body above it. */
    const double outer = 0.5 * PHOSPHOR_BODY * sqrt(2);
    mesh_add_cone(&m, centre, r, 0, outer, 0, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, outer, 0, outer, depth + 0.0005, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, outer, depth + 0.0005, 0, depth + 0.0005, 1, 1, SEGMENTS);
    gltf_add(file, "Package", &m, &white);
    mesh_free(&m);

    /* The chip, a little off the bottom; faces down. */
    const double h = 0.5 * PHOSPHOR_CHIP, corner[3] = {-h, depth - 0.0001, -h};
    const double a[3] = {PHOSPHOR_CHIP, 0, 0}, b[3] = {0, 0, PHOSPHOR_CHIP};
    mesh_add_rectangle(&m, corner, a, b);
    const gltf_material chip = {
        .name = "Chip", .color = {0.5, 0.5, 0.5}, .roughness = 1, .emission_color = {0.1, 0.1, 1}, .luminance = 1e6};
    gltf_add(file, "Chip", &m, &chip);
    mesh_free(&m);
    gltf_end(file, folder);
}
