/* SPDX-License-Identifier: Apache-2.0 */
/* The opal ball: a bulb in the middle of a thick shell of opal glass, all concentric; see dimensions.h.  The recipe fills the
 * glass. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

/* A sphere about the origin; side +1: faces outwards, -1: inwards. */
static void add_sphere(mesh *m, double radius, double side)
{
    enum { BANDS = 64, SEGMENTS = 128 };
    const double centre[3] = {0, 0, 0};
    mesh_profile profile[BANDS + 1];
    for (int i = 0; i <= BANDS; i++) {
        double theta = PI * i / BANDS, s = i == 0 || i == BANDS ? 0 : sin(theta), c = cos(theta);
        profile[i] = (mesh_profile){radius * s, radius * c, side * s, side * c};
    }
    mesh_add_revolution(m, centre, profile, BANDS + 1, SEGMENTS);
}

void make_opal_ball(const char *folder)
{
    gltf_file *file = gltf_begin("opal-ball");
    mesh m = {0};

    /* Both faces of the shell are one closed surface: the glass is between them. */
    add_sphere(&m, BALL_RADIUS, 1);
    add_sphere(&m, BALL_RADIUS - BALL_WALL, -1);
    const gltf_material glass = {.name = "Opal glass", .color = {1, 1, 1}, .ior = BALL_IOR, .thickness = BALL_WALL};
    gltf_add(file, "Shell", &m, &glass);
    mesh_free(&m);

    gltf_material bulb = {.name = "Bulb", .color = {0.5, 0.5, 0.5}, .roughness = 1, .emission_color = {1, 1, 1}};
    add_sphere(&m, BALL_BULB_RADIUS, 1);
    bulb.luminance = BALL_FLUX / (PI * mesh_area(&m));
    gltf_add(file, "Bulb", &m, &bulb);
    mesh_free(&m);

    gltf_end(file, folder);
}
