/* SPDX-License-Identifier: Apache-2.0 */
/* The glass lens: an LED behind a solid hyperbolic-plane lens in a dark tube; see dimensions.h for its closed form. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

void make_glass_lens(const char *folder)
{
    enum { RINGS = 64, SEGMENTS = 160 };
    gltf_file *file = gltf_begin("glass-lens");
    const double centre[3] = {0, 0, 0}, n = LENS_IOR, f = LENS_FOCAL_LENGTH, n2 = LENS_IOR * LENS_IOR - 1;
    mesh m = {0};

    /* Curved face: sag w(r) below the vertex; the lens is below it, so the outer normal points up, to the LED. */
    double q = (n - 1) * f, depth = (sqrt(q * q + n2 * LENS_RADIUS * LENS_RADIUS) - q) / n2;
    double vertex = LENS_FLAT_FACE + LENS_RIM + depth, led = vertex + f;
    mesh_profile profile[RINGS + 1];
    for (int i = 0; i <= RINGS; i++) {
        double r = LENS_RADIUS * i / RINGS, root = sqrt(q * q + n2 * r * r), slope = r / root; /* dw/dr */
        double length = hypot(slope, 1);
        profile[i] = (mesh_profile){r, i == RINGS ? LENS_FLAT_FACE + LENS_RIM : vertex - (root - q) / n2, slope / length, 1 / length};
    }
    mesh_add_revolution(&m, centre, profile, RINGS + 1, SEGMENTS);
    mesh_add_cone(&m, centre, LENS_RADIUS, LENS_FLAT_FACE, LENS_RADIUS, LENS_FLAT_FACE + LENS_RIM, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, 0, LENS_FLAT_FACE, LENS_RADIUS, LENS_FLAT_FACE, 1, 1, SEGMENTS);
    const gltf_material glass = {.name = "Glass", .color = {1, 1, 1}, .ior = LENS_IOR, .thickness = depth + LENS_RIM};
    gltf_add(file, "Lens", &m, &glass);
    mesh_free(&m);

    /* LED: a disc that faces down, its radius raised so that the polygon has the circle's area. */
    const unsigned sides = 96;
    double polygon = sides / (2 * PI) * sin(2 * PI / sides), radius = LENS_SOURCE_RADIUS / sqrt(polygon);
    mesh_add_cone(&m, centre, 0, led, radius, led, 1, 1, sides);
    const gltf_material source = {.name = "LED",
                                  .color = {0.5, 0.5, 0.5},
                                  .roughness = 1,
                                  .emission_color = {1, 1, 1},
                                  .luminance = LENS_FLUX / (PI * mesh_area(&m))};
    gltf_add(file, "LED", &m, &source);
    mesh_free(&m);

    /* Inside: plate behind the LED, tube, and the lip under the lens. */
    const double r = LENS_TUBE_RADIUS, plate = led + 0.001, c = LENS_TUBE_REFLECTANCE;
    const gltf_material dark = {.name = "Dark paint", .color = {c, c, c}, .roughness = 0.9, .double_sided = true};
    mesh_add_cone(&m, centre, 0, plate, r, plate, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, r, plate, r, 0, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, LENS_OPENING_RADIUS, 0, r, 0, -1, 1, SEGMENTS);
    gltf_add(file, "Tube inside", &m, &dark);
    mesh_free(&m);

    /* Outside: aluminium body. */
    const double outer = r + LENS_TUBE_WALL, top = plate + 0.010;
    const gltf_material body = {.name = "Anodised body", .color = {0.3, 0.3, 0.32}, .metallic = 1, .roughness = 0.5, .double_sided = true};
    mesh_add_cone(&m, centre, r, 0, outer, 0, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, outer, 0, outer, top, 1, 1, SEGMENTS);
    mesh_add_cone(&m, centre, outer, top, 0, top, 1, 1, SEGMENTS);
    gltf_add(file, "Body", &m, &body);
    mesh_free(&m);

    gltf_end(file, folder);
}
