/* SPDX-License-Identifier: Apache-2.0 */
/* The prism lamp: a narrow beam through a prism of heavy flint glass; see dimensions.h for its closed form. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

/* A point of the cross-section, moved along z. */
static void at(double out[3], const double xy[2], double z)
{
    out[0] = xy[0];
    out[1] = xy[1];
    out[2] = z;
}

void make_prism_lamp(const char *folder)
{
    gltf_file *file = gltf_begin("prism-lamp");
    /* The ray is turned by `half` at each face, towards the base; it comes from the upper left and leaves downwards. */
    const double incidence = asin(PRISM_IOR * 0.5), half = incidence - PI / 6, z = 0.5 * PRISM_LENGTH;
    const double inside[2] = {sin(half), -cos(half)}, to_base[2] = {-cos(half), -sin(half)};
    /* Inside, it runs parallel to the base, half as long, at half the height, and ends at the origin. */
    const double height = PRISM_SIDE * sqrt(0.75);
    double corner[3][2]; /* apex; base where the light comes in; base where it goes out */
    for (int k = 0; k < 2; k++) {
        const double middle = -0.25 * PRISM_SIDE * inside[k];
        corner[0][k] = middle - 0.5 * height * to_base[k];
        corner[1][k] = middle + 0.5 * height * to_base[k] - 0.5 * PRISM_SIDE * inside[k];
        corner[2][k] = middle + 0.5 * height * to_base[k] + 0.5 * PRISM_SIDE * inside[k];
    }
    mesh m = {0};
    for (int i = 0; i < 3; i++) { /* faces between corners i and i + 1 */
        const double *a = corner[i], *b = corner[(i + 1) % 3];
        double origin[3], along[3] = {b[0] - a[0], b[1] - a[1], 0}, up[3] = {0, 0, 2 * z};
        at(origin, a, -z);
        mesh_add_rectangle(&m, origin, along, up);
    }
    for (int side = -1; side <= 1; side += 2) {
        uint32_t v[3];
        const double normal[3] = {0, 0, side};
        for (int i = 0; i < 3; i++) {
            double p[3];
            at(p, corner[i], side * z);
            v[i] = mesh_add_vertex(&m, p, normal);
        }
        if (side > 0) {
            mesh_add_triangle(&m, v[0], v[1], v[2]);
        } else {
            mesh_add_triangle(&m, v[0], v[2], v[1]);
        }
    }
    const gltf_material glass = {
        .name = "Flint glass", .color = {1, 1, 1}, .ior = PRISM_IOR, .abbe = PRISM_ABBE, .thickness = 0.5 * PRISM_SIDE};
    gltf_add(file, "Prism", &m, &glass);
    mesh_free(&m);

    double eye[3], target[3];
    const double in[2] = {sin(2 * half), -cos(2 * half)};
    for (int k = 0; k < 2; k++) {
        target[k] = -0.5 * PRISM_SIDE * inside[k];
        eye[k] = target[k] - PRISM_DISTANCE * in[k];
    }
    eye[2] = target[2] = 0;
    /* KHR_lights_punctual: intensity times ((cos - cos of the cone) / 0.001)^2 in so narrow a cone. */
    const double ramp = 2 * pow(sin(0.5 * PRISM_CONE), 2) / 0.001;
    gltf_add_spot(file, "Beam", eye, target, PRISM_FLUX * 3 / (2 * PI * 0.001 * pow(ramp, 3)), PRISM_CONE);

    /* A black box behind the light. */
    const double b = 0.01, low[3] = {eye[0] - (b + 0.002) * in[0] - b, eye[1] - (b + 0.002) * in[1] + 0.002, -b};
    const double high[3] = {low[0] + b, low[1] + 2 * b, b};
    const gltf_material body = {.name = "Black paint", .color = {0.03, 0.03, 0.03}, .roughness = 0.9};
    mesh_add_box(&m, low, high, 1);
    gltf_add(file, "Body", &m, &body);
    mesh_free(&m);
    gltf_end(file, folder);
}
