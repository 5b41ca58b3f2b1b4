/* SPDX-License-Identifier: Apache-2.0 */
/* The sample room: a small furnished dining room without lights of its own, for a lamp over the middle of the table. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

#include <math.h>

static void box(gltf_file *file, const char *name, const gltf_material *material, double x0, double y0, double z0, double x1, double y1,
                double z1)
{
    mesh m = {0};
    const double low[3] = {x0, y0, z0}, high[3] = {x1, y1, z1};
    mesh_add_box(&m, low, high, 1);
    gltf_add(file, name, &m, material);
    mesh_free(&m);
}

static void rectangle(gltf_file *file, const char *name, const gltf_material *material, const double corner[3], const double e1[3],
                      const double e2[3])
{
    mesh m = {0};
    mesh_add_rectangle(&m, corner, e1, e2);
    gltf_add(file, name, &m, material);
    mesh_free(&m);
}

static void sphere(gltf_file *file, const char *name, const gltf_material *material, double x, double y, double z, double radius)
{
    mesh m = {0};
    const double centre[3] = {x, y, z};
    mesh_add_sphere(&m, centre, radius, 48, 96);
    gltf_add(file, name, &m, material);
    mesh_free(&m);
}

static void add_shell(gltf_file *file)
{
    static const gltf_material floor = {.name = "Oak floor", .color = {0.36, 0.23, 0.13}, .roughness = 0.7},
                               ceiling = {.name = "Ceiling white", .color = {0.80, 0.80, 0.78}, .roughness = 1},
                               cream = {.name = "Wall cream", .color = {0.72, 0.66, 0.55}, .roughness = 1},
                               blue = {.name = "Wall blue", .color = {0.22, 0.33, 0.45}, .roughness = 1},
                               green = {.name = "Wall green", .color = {0.42, 0.50, 0.36}, .roughness = 1},
                               skirting = {.name = "Skirting", .color = {0.75, 0.75, 0.73}, .roughness = 0.5},
                               rug = {.name = "Rug", .color = {0.45, 0.12, 0.09}, .roughness = 1};
    const double x = ROOM_LENGTH / 2, z = ROOM_WIDTH / 2, h = ROOM_HEIGHT;
    const double lx[3] = {2 * x, 0, 0}, lz[3] = {0, 0, 2 * z}, up[3] = {0, h, 0}, bx[3] = {-2 * x, 0, 0}, bz[3] = {0, 0, -2 * z};
    const double f00[3] = {-x, 0, -z}, f10[3] = {x, 0, -z}, f11[3] = {x, 0, z}, f01[3] = {-x, 0, z}, c00[3] = {-x, h, -z};
    rectangle(file, "Floor", &floor, f00, lz, lx);
    rectangle(file, "Ceiling", &ceiling, c00, lx, lz);
    rectangle(file, "Back wall", &cream, f00, lx, up);
    rectangle(file, "Right wall", &green, f10, lz, up);
    rectangle(file, "Front wall", &cream, f11, bx, up);
    rectangle(file, "Left wall", &blue, f01, bz, up);
    box(file, "Skirting back", &skirting, -x + 0.001, 0.001, -z + 0.001, x - 0.001, 0.08, -z + 0.015);
    box(file, "Skirting right", &skirting, x - 0.015, 0.001, -z + 0.016, x - 0.001, 0.08, z - 0.001);
    box(file, "Rug", &rug, -1.25, 0.001, -0.95, 1.25, 0.012, 0.95);
}

static void add_chair(gltf_file *file, const gltf_material *wood, double x, double z, double facing)
{
    const double w = 0.21, leg = 0.018, back = facing > 0 ? z - w : z + w - 2 * leg;
    for (int i = 0; i < 4; i++) {
        double lx = i & 1 ? x + w - 2 * leg : x - w, lz = i & 2 ? z + w - 2 * leg : z - w;
        box(file, "Chair leg", wood, lx, 0.013, lz, lx + 2 * leg, 0.44, lz + 2 * leg);
    }
    box(file, "Chair seat", wood, x - w, 0.441, z - w, x + w, 0.465, z + w);
    box(file, "Chair post", wood, x - w, 0.466, back, x - w + 2 * leg, 0.88, back + 2 * leg);
    box(file, "Chair post", wood, x + w - 2 * leg, 0.466, back, x + w, 0.88, back + 2 * leg);
    box(file, "Chair back", wood, x - w + 2 * leg + 0.001, 0.70, back + 0.008, x + w - 2 * leg - 0.001, 0.84, back + 0.028);
}

static void add_table(gltf_file *file)
{
    static const gltf_material beech = {.name = "Beech", .color = {0.52, 0.36, 0.21}, .roughness = 0.6},
                               walnut = {.name = "Walnut", .color = {0.16, 0.09, 0.05}, .roughness = 0.6},
                               brass = {.name = "Polished brass", .color = {0.91, 0.78, 0.42}, .metallic = 1, .roughness = 0.25},
                               red = {.name = "Red plastic", .color = {0.55, 0.05, 0.04}, .roughness = 0.3},
                               white = {.name = "White glaze", .color = {0.78, 0.77, 0.73}, .roughness = 0.35, .double_sided = true},
                               card = {.name = "Grey card", .color = {0.18, 0.18, 0.18}, .roughness = 1};
    const double top = 0.74;
    box(file, "Table top", &beech, -0.75, top - 0.03, -0.42, 0.75, top, 0.42);
    for (int i = 0; i < 4; i++) {
        double x = i & 1 ? 0.66 : -0.72, z = i & 2 ? 0.33 : -0.39;
        box(file, "Table leg", &beech, x, 0.013, z, x + 0.06, top - 0.031, z + 0.06);
    }
    sphere(file, "Brass ball", &brass, 0.30, top + 0.081, -0.12, 0.08);
    box(file, "Red box", &red, -0.46, top + 0.001, -0.22, -0.28, top + 0.16, -0.04);
    box(file, "Grey card", &card, -0.12, top + 0.001, 0.08, 0.10, top + 0.003, 0.24);

    /* A bowl: a spherical cap turned up, thin. */
    enum { STEPS = 24 };
    mesh_profile profile[STEPS + 1];
    const double radius = 0.11, open = 1.1, centre[3] = {-0.30, top + 0.002 + radius, 0.20};
    for (int i = 0; i <= STEPS; i++) {
        double a = open * i / STEPS, s = sin(a), c = cos(a);
        profile[i] = (mesh_profile){radius * s, -radius * c, -s, c};
    }
    mesh m = {0};
    mesh_add_revolution(&m, centre, profile, STEPS + 1, 96);
    gltf_add(file, "Bowl", &m, &white);
    mesh_free(&m);

    add_chair(file, &walnut, -0.30, -0.62, 1);
    add_chair(file, &walnut, 0.38, -0.62, 1);
    add_chair(file, &walnut, 0.20, 0.72, -1);
}

static void add_shelf(gltf_file *file)
{
    static const gltf_material board = {.name = "Shelf white", .color = {0.70, 0.70, 0.68}, .roughness = 0.6},
                               vase = {.name = "Blue glaze", .color = {0.06, 0.14, 0.40}, .roughness = 0.25},
                               frame = {.name = "Picture frame", .color = {0.08, 0.07, 0.06}, .roughness = 0.5},
                               paper = {.name = "Picture paper", .color = {0.76, 0.72, 0.60}, .roughness = 1},
                               ink = {.name = "Picture ink", .color = {0.55, 0.20, 0.10}, .roughness = 1};
    const double x0 = 1.05, x1 = 2.25, back = -ROOM_WIDTH / 2 + 0.016, front = back + 0.30;
    box(file, "Shelf side", &board, x0, 0.001, back, x0 + 0.022, 1.60, front);
    box(file, "Shelf side", &board, x1 - 0.022, 0.001, back, x1, 1.60, front);
    const double heights[] = {0.10, 0.58, 1.06, 1.54};
    for (int i = 0; i < 4; i++) {
        box(file, "Shelf board", &board, x0 + 0.0221, heights[i], back, x1 - 0.0221, heights[i] + 0.022, front - 0.002);
    }

    static const gltf_material books[] = {{.name = "Book red", .color = {0.42, 0.06, 0.05}, .roughness = 0.7},
                                          {.name = "Book ochre", .color = {0.55, 0.35, 0.08}, .roughness = 0.7},
                                          {.name = "Book green", .color = {0.08, 0.25, 0.12}, .roughness = 0.7},
                                          {.name = "Book cream", .color = {0.68, 0.62, 0.48}, .roughness = 0.7},
                                          {.name = "Book blue", .color = {0.07, 0.13, 0.30}, .roughness = 0.7}};
    for (int row = 0; row < 2; row++) {
        double x = row ? x0 + 0.03 : x0 + 0.42, y = heights[1 + row] + 0.023;
        for (int i = 0; i < 14; i++) {
            /* Thickness and height vary by small remainders, so that the row looks like books. */
            double thickness = 0.024 + 0.004 * ((i * 5 + row * 3) % 7), height = 0.20 + 0.012 * ((i * 7 + row) % 9);
            double depth = 0.17 + 0.006 * ((i * 3 + row) % 5);
            box(file, "Book", &books[(i * 3 + row * 2) % 5], x, y, front - 0.02 - depth, x + thickness, y + height, front - 0.02);
            x += thickness + 0.001;
        }
    }
    /* A vase on the upper shelf: a smooth profile with its normals. */
    enum { STEPS = 48 };
    mesh_profile profile[STEPS + 1];
    for (int i = 0; i <= STEPS; i++) {
        double t = (double)i / STEPS, y = 0.30 * t, r = 0.045 + 0.040 * sin(3.6 * t + 0.35);
        double slope = 0.040 * 3.6 * cos(3.6 * t + 0.35) / 0.30, length = hypot(1, slope);
        profile[i] = (mesh_profile){r, y, 1 / length, -slope / length};
    }
    mesh m = {0};
    const double centre[3] = {2.02, heights[2] + 0.023, back + 0.15};
    mesh_add_revolution(&m, centre, profile, STEPS + 1, 64);
    gltf_add(file, "Vase", &m, &vase);
    mesh_free(&m);

    /* A framed picture on the back wall. */
    const double z = -ROOM_WIDTH / 2;
    box(file, "Picture frame", &frame, -0.95, 1.15, z + 0.001, -0.05, 1.85, z + 0.025);
    box(file, "Picture paper", &paper, -0.91, 1.19, z + 0.0251, -0.09, 1.81, z + 0.027);
    box(file, "Picture ink", &ink, -0.72, 1.32, z + 0.0271, -0.42, 1.62, z + 0.028);
    box(file, "Picture ink", &frame, -0.36, 1.45, z + 0.0271, -0.24, 1.68, z + 0.028);
}

void make_room(const char *folder)
{
    gltf_file *file = gltf_begin("room");
    add_shell(file);
    add_table(file);
    add_shelf(file);
    const double eye[3] = {-1.80, 1.60, 1.60}, target[3] = {0.30, 1.08, -0.50};
    gltf_add_camera(file, "default", eye, target, 0.96, 4.0 / 3.0);
    gltf_end(file, folder);
}
