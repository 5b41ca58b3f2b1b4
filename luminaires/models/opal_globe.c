/* SPDX-License-Identifier: Apache-2.0 */
/* The opal-globe pendant: an LED bulb in a globe of opal glass under a metal cap and rod; see dimensions.h. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

void make_opal_globe(const char *folder)
{
    enum { BANDS = 96, SEGMENTS = 128 };
    gltf_file *file = gltf_begin("opal-globe");
    const double centre[3] = {0, 0, 0};
    mesh m = {0};

    /* The globe from its neck to the south pole. */
    mesh_profile profile[BANDS + 1];
    double neck = asin(GLOBE_NECK_RADIUS / GLOBE_RADIUS), neck_y = GLOBE_RADIUS * cos(neck);
    for (int i = 0; i <= BANDS; i++) {
        double theta = neck + (PI - neck) * i / BANDS, s = i == BANDS ? 0 : sin(theta), c = cos(theta);
        profile[i] = (mesh_profile){GLOBE_RADIUS * s, GLOBE_RADIUS * c, s, c};
    }
    mesh_add_revolution(&m, centre, profile, BANDS + 1, SEGMENTS);
    const gltf_material opal = {.name = "Opal glass",
                                .color = {GLOBE_ALBEDO, GLOBE_ALBEDO, GLOBE_ALBEDO},
                                .roughness = GLOBE_ROUGHNESS,
                                .diffuse_transmission = GLOBE_TRANSMIT,
                                .double_sided = true};
    gltf_add(file, "Globe", &m, &opal);
    mesh_free(&m);

    /* Luminance over the mesh's own area, so that the flux is the rated one. */
    gltf_material bulb = {.name = "Bulb", .color = {0.8, 0.8, 0.8}, .roughness = 0.5};
    gltf_chromaticity(GLOBE_KELVIN_X, GLOBE_KELVIN_Y, bulb.emission_color);
    mesh_add_sphere(&m, centre, GLOBE_BULB_RADIUS, 32, 64);
    bulb.luminance = GLOBE_FLUX / (PI * mesh_area(&m));
    gltf_add(file, "Bulb", &m, &bulb);
    mesh_free(&m);

    /* Socket: a white cylinder from inside the bulb's top to the plate of the cap. */
    const gltf_material white = {.name = "White plastic", .color = {0.8, 0.8, 0.8}, .roughness = 0.6, .double_sided = true};
    mesh_add_cone(&m, centre, 0.013, GLOBE_BULB_RADIUS - 0.004, 0.013, neck_y, 1, 1, SEGMENTS);
    gltf_add(file, "Socket", &m, &white);
    mesh_free(&m);

    /* Cap: a plate over the neck (white below), a cylinder round it that reaches a little over the glass, and a lid with the rod. */
    const gltf_material steel = {.name = "Brushed steel", .color = {0.6, 0.6, 0.6}, .metallic = 1, .roughness = 0.35, .double_sided = true};
    double cap = GLOBE_NECK_RADIUS + 0.002, low = neck_y - 0.003, top = neck_y + GLOBE_CAP_HEIGHT;
    mesh_add_cone(&m, centre, 0, neck_y + 0.001, cap, neck_y + 0.001, 1, 1, SEGMENTS);
    gltf_add(file, "Cap plate", &m, &white);
    mesh_free(&m);
    mesh_add_cone(&m, centre, cap, low, cap, top, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, cap, top, GLOBE_ROD_RADIUS, top + 0.010, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, GLOBE_ROD_RADIUS, top + 0.010, GLOBE_ROD_RADIUS, GLOBE_ROD_TOP, 1, 1, 32);
    mesh_add_cone(&m, centre, GLOBE_ROD_RADIUS, GLOBE_ROD_TOP, 0, GLOBE_ROD_TOP, 1, 1, 32);
    gltf_add(file, "Cap and rod", &m, &steel);
    mesh_free(&m);

    gltf_end(file, folder);
}
