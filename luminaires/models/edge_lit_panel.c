/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The edge-lit panel: a plate of acrylic that guides the light of two LED strips by total internal reflection, until it meets one
 * of the grooves in its upper face and is turned down; see dimensions.h.
 */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

static const double PI = 3.14159265358979323846;

/* A point of the upper face's profile across the grooves. */
typedef struct point {
    double z, y;
} point;

/* A face with its own normal, corners counter-clockwise as seen from outside; d may equal c. */
static void add_face(mesh *m, const double a[3], const double b[3], const double c[3], const double d[3])
{
    double e[3], f[3], n[3];
    for (int i = 0; i < 3; i++) {
        e[i] = b[i] - a[i];
        f[i] = c[i] - a[i];
    }
    for (int i = 0; i < 3; i++) {
        n[i] = e[(i + 1) % 3] * f[(i + 2) % 3] - e[(i + 2) % 3] * f[(i + 1) % 3];
    }
    const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int i = 0; i < 3; i++) {
        n[i] /= length;
    }
    const uint32_t v[4] = {mesh_add_vertex(m, a, n), mesh_add_vertex(m, b, n), mesh_add_vertex(m, c, n), mesh_add_vertex(m, d, n)};
    mesh_add_triangle(m, v[0], v[1], v[2]);
    mesh_add_triangle(m, v[0], v[2], v[3]);
}

/* The plate between two points of the profile: top, bottom and the two ends of the slice. */
static void add_slice(mesh *m, point p, point q)
{
    const double x = PANEL_SIDE / 2;
    const double top[4][3] = {{-x, p.y, p.z}, {-x, q.y, q.z}, {x, q.y, q.z}, {x, p.y, p.z}};
    const double bottom[4][3] = {{-x, 0, p.z}, {x, 0, p.z}, {x, 0, q.z}, {-x, 0, q.z}};
    add_face(m, top[0], top[1], top[2], top[3]);
    add_face(m, bottom[0], bottom[1], bottom[2], bottom[3]);
    add_face(m, bottom[0], bottom[3], top[1], top[0]);
    add_face(m, bottom[2], bottom[1], top[3], top[2]);
}

void make_edge_lit_panel(const char *folder)
{
    enum { POINTS = 3 * PANEL_GROOVES + 2 };
    gltf_file *file = gltf_begin("edge-lit-panel");
    const double half = PANEL_SIDE / 2, pitch = PANEL_SIDE / (PANEL_GROOVES + 1);
    mesh m = {0};

    /* Grooves of 90 degrees, shallow near the LEDs and deep in the middle, so that the light lasts. */
    point profile[POINTS];
    int count = 0;
    profile[count++] = (point){-half, PANEL_THICKNESS};
    for (int i = 0; i < PANEL_GROOVES; i++) {
        const double z = -half + pitch * (i + 1), middle = 1 - fabs(z) / half;
        const double depth = PANEL_GROOVE_MIN + (PANEL_GROOVE_MAX - PANEL_GROOVE_MIN) * middle * middle;
        profile[count++] = (point){z - depth, PANEL_THICKNESS};
        profile[count++] = (point){z, PANEL_THICKNESS - depth};
        profile[count++] = (point){z + depth, PANEL_THICKNESS};
    }
    profile[count++] = (point){half, PANEL_THICKNESS};
    for (int i = 0; i + 1 < count; i++) {
        add_slice(&m, profile[i], profile[i + 1]);
    }
    const double x = half, t = PANEL_THICKNESS;
    const double low[4][3] = {{-x, 0, -half}, {-x, t, -half}, {x, t, -half}, {x, 0, -half}};
    const double high[4][3] = {{-x, 0, half}, {x, 0, half}, {x, t, half}, {-x, t, half}};
    add_face(&m, low[0], low[1], low[2], low[3]);
    add_face(&m, high[0], high[1], high[2], high[3]);
    const gltf_material acrylic = {.name = "Acrylic", .color = {1, 1, 1}, .ior = PANEL_IOR, .thickness = t};
    gltf_add(file, "Light guide", &m, &acrylic);
    mesh_free(&m);

    /* LED strips, as high as the plate, a little off its edges and facing them. */
    const double gap = PANEL_LED_GAP, corner[2][3] = {{-x, 0, -half - gap}, {-x, 0, half + gap}}, along[3] = {2 * x, 0, 0},
                 up[3] = {0, t, 0};
    mesh_add_rectangle(&m, corner[0], along, up);
    mesh_add_rectangle(&m, corner[1], up, along);
    const gltf_material led = {.name = "LED",
                               .color = {0.7, 0.7, 0.7},
                               .roughness = 1,
                               .emission_color = {1, 1, 1},
                               .luminance = PANEL_FLUX / (PI * mesh_area(&m))};
    gltf_add(file, "LED strips", &m, &led);
    mesh_free(&m);

    /* A white tray: reflector over the plate, and walls round it down to its lower face. */
    const double wall = half + 2 * gap, lid = t + 2 * gap;
    const double a[3] = {-wall, lid, -wall}, ex[3] = {2 * wall, 0, 0}, ez[3] = {0, 0, 2 * wall}, ey[3] = {0, lid, 0};
    const double c00[3] = {-wall, 0, -wall}, c01[3] = {-wall, 0, wall}, c10[3] = {wall, 0, -wall};
    mesh_add_rectangle(&m, a, ex, ez);
    mesh_add_rectangle(&m, c00, ex, ey);
    mesh_add_rectangle(&m, c01, ey, ex);
    mesh_add_rectangle(&m, c00, ey, ez);
    mesh_add_rectangle(&m, c10, ez, ey);
    const gltf_material white = {
        .name = "White tray", .color = {PANEL_TRAY, PANEL_TRAY, PANEL_TRAY}, .roughness = 1, .double_sided = true};
    gltf_add(file, "Tray", &m, &white);
    mesh_free(&m);

    gltf_end(file, folder);
}
