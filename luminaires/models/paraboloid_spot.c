/* SPDX-License-Identifier: Apache-2.0 */
/* The paraboloid spot: a small Lambertian sphere in the focus of a mirror; see dimensions.h for its closed forms. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

enum { RINGS = 64, SEGMENTS = 160 }; /* 20,320 triangles of mirror */

static const double PI = 3.14159265358979323846;

/* Points of the paraboloid moved out by `gap` along its outer normal, rings in equal steps of radius; normals inwards (side = +1,
 * towards the light) or outwards (-1). */
static void add_paraboloid(mesh *m, double gap, double side, unsigned rings, unsigned segments)
{
    mesh_profile profile[RINGS + 1];
    const double centre[3] = {0, 0, 0};
    for (unsigned i = 0; i <= rings; i++) {
        double r = SPOT_RIM_RADIUS * i / rings, y = SPOT_APEX - r * r / (4 * SPOT_FOCAL_LENGTH);
        /* Gradient of r^2 + 4 f y: outwards and up. */
        double slope = hypot(r, 2 * SPOT_FOCAL_LENGTH), nr = r / slope, ny = 2 * SPOT_FOCAL_LENGTH / slope;
        profile[i] = (mesh_profile){r + gap * nr, y + gap * ny, -side * nr, -side * ny};
    }
    mesh_add_revolution(m, centre, profile, rings + 1, segments);
}

void make_paraboloid_spot(const char *folder)
{
    gltf_file *file = gltf_begin("paraboloid-spot");
    mesh m = {0};

    add_paraboloid(&m, 0, 1, RINGS, SEGMENTS);
    const gltf_material mirror = {.name = "Mirror", .color = {SPOT_REFLECTANCE, SPOT_REFLECTANCE, SPOT_REFLECTANCE}, .metallic = 1};
    gltf_add(file, "Reflector", &m, &mirror);
    mesh_free(&m);

    /* A sphere of the mesh's own: vertices far enough out for the facets to have the true sphere's area. */
    const double focus[3] = {0, SPOT_FOCUS, 0};
    const double area = 4 * PI * SPOT_SOURCE_RADIUS * SPOT_SOURCE_RADIUS;
    mesh_add_sphere(&m, focus, SPOT_SOURCE_RADIUS, 48, 96);
    double radius = SPOT_SOURCE_RADIUS * sqrt(area / mesh_area(&m));
    mesh_free(&m);
    mesh_add_sphere(&m, focus, radius, 48, 96);
    const gltf_material source = {
        .name = "Source", .roughness = 1, .emission_color = {1, 1, 1}, .luminance = SPOT_FLUX / (PI * mesh_area(&m))};
    gltf_add(file, "Source", &m, &source);
    mesh_free(&m);

    const gltf_material paint = {.name = "Black paint", .color = {0.02, 0.02, 0.02}, .roughness = 0.8, .double_sided = true};
    add_paraboloid(&m, SPOT_SHELL_GAP, -1, 16, SEGMENTS);
    const double slope = hypot(SPOT_RIM_RADIUS, 2 * SPOT_FOCAL_LENGTH), centre[3] = {0, 0, 0};
    mesh_add_cone(&m, centre, SPOT_RIM_RADIUS, 0, SPOT_RIM_RADIUS + SPOT_SHELL_GAP * SPOT_RIM_RADIUS / slope,
                  SPOT_SHELL_GAP * 2 * SPOT_FOCAL_LENGTH / slope, 1, 1, SEGMENTS);
    gltf_add(file, "Housing", &m, &paint);
    mesh_free(&m);

    gltf_end(file, folder);
}
