/* SPDX-License-Identifier: Apache-2.0 */
/* The louvred panel: a 600 x 600 recessed luminaire, an emitting panel above a grid of aluminium blades; see dimensions.h. */
#include "dimensions.h"
#include "gltf_writer.h"
#include "models.h"

static const double PI = 3.14159265358979323846;

void make_louvred_panel(const char *folder)
{
    gltf_file *file = gltf_begin("louvred-panel");
    const double half = LOUVRE_OPENING / 2, outer = LOUVRE_OUTER / 2;
    mesh m = {0};

    /* Panel, front down. */
    const double corner[3] = {-half, LOUVRE_PANEL_HEIGHT, -half}, along_x[3] = {2 * half, 0, 0}, along_z[3] = {0, 0, 2 * half};
    mesh_add_rectangle(&m, corner, along_x, along_z);
    gltf_material panel = {.name = "Emitting panel",
                           .color = {LOUVRE_PANEL_REFLECTANCE, LOUVRE_PANEL_REFLECTANCE, LOUVRE_PANEL_REFLECTANCE},
                           .roughness = 1,
                           .luminance = LOUVRE_FLUX / (PI * LOUVRE_OPENING * LOUVRE_OPENING)};
    gltf_chromaticity(LOUVRE_KELVIN_X, LOUVRE_KELVIN_Y, panel.emission_color);
    gltf_add(file, "Panel", &m, &panel);
    mesh_free(&m);

    /* Blades: whole ones along x; pieces along z between them, whose ends stick in them and whose edges stand back by a tenth of a
     * millimetre, so that no two faces coincide.  They end a hair inside the walls. */
    const double t = LOUVRE_BLADE_THICKNESS / 2, pitch = LOUVRE_OPENING / LOUVRE_CELLS, into = LOUVRE_BLADE_THICKNESS / 4, back = 1e-4;
    const double low = LOUVRE_BLADE_BOTTOM, high = LOUVRE_BLADE_BOTTOM + LOUVRE_BLADE_HEIGHT;
    for (int i = 1; i < LOUVRE_CELLS; i++) {
        double z = -half + i * pitch;
        const double a[3] = {-half - into, low, z - t}, b[3] = {half + into, high, z + t};
        mesh_add_box(&m, a, b, 1);
    }
    for (int i = 1; i < LOUVRE_CELLS; i++) {
        double x = -half + i * pitch;
        for (int k = 0; k < LOUVRE_CELLS; k++) {
            double z0 = k == 0 ? -half - into : -half + k * pitch + t - into;
            double z1 = k == LOUVRE_CELLS - 1 ? half + into : -half + (k + 1) * pitch - t + into;
            const double a[3] = {x - t, low + back, z0}, b[3] = {x + t, high - back, z1};
            mesh_add_box(&m, a, b, 1);
        }
    }
    const gltf_material aluminium = {
        .name = "Aluminium",
        .color = {LOUVRE_BLADE_REFLECTANCE, LOUVRE_BLADE_REFLECTANCE, LOUVRE_BLADE_REFLECTANCE},
        .metallic = 1,
        .roughness = LOUVRE_BLADE_ROUGHNESS,
    };
    gltf_add(file, "Blades", &m, &aluminium);
    mesh_free(&m);

    /* Walls round the opening, facing in, from the opening to the panel. */
    const double up[3] = {0, LOUVRE_PANEL_HEIGHT, 0}, back_x[3] = {-2 * half, 0, 0}, back_z[3] = {0, 0, -2 * half};
    const double c00[3] = {-half, 0, -half}, c10[3] = {half, 0, -half}, c11[3] = {half, 0, half}, c01[3] = {-half, 0, half};
    mesh_add_rectangle(&m, c00, along_x, up);
    mesh_add_rectangle(&m, c10, along_z, up);
    mesh_add_rectangle(&m, c11, back_x, up);
    mesh_add_rectangle(&m, c01, back_z, up);
    const gltf_material white = {.name = "White enamel",
                                 .color = {LOUVRE_WALL_REFLECTANCE, LOUVRE_WALL_REFLECTANCE, LOUVRE_WALL_REFLECTANCE},
                                 .roughness = 0.6,
                                 .double_sided = true};
    gltf_add(file, "Walls", &m, &white);
    mesh_free(&m);

    /* Housing: the frame round the opening, outer sides and back. */
    const double edge = outer - half, height = LOUVRE_HOUSING_HEIGHT;
    const double f0[3] = {-outer, 0, -outer}, f1[3] = {-outer, 0, half}, f2[3] = {-outer, 0, -half}, f3[3] = {half, 0, -half};
    const double wide[3] = {2 * outer, 0, 0}, rim_z[3] = {0, 0, edge}, rim_x[3] = {edge, 0, 0};
    mesh_add_rectangle(&m, f0, wide, rim_z);
    mesh_add_rectangle(&m, f1, wide, rim_z);
    mesh_add_rectangle(&m, f2, rim_x, along_z);
    mesh_add_rectangle(&m, f3, rim_x, along_z);
    const double o00[3] = {-outer, 0, -outer}, o10[3] = {outer, 0, -outer}, o11[3] = {outer, 0, outer}, o01[3] = {-outer, 0, outer};
    const double rise[3] = {0, height, 0}, long_x[3] = {2 * outer, 0, 0}, long_z[3] = {0, 0, 2 * outer};
    const double minus_x[3] = {-2 * outer, 0, 0}, minus_z[3] = {0, 0, -2 * outer}, top[3] = {-outer, height, -outer};
    mesh_add_rectangle(&m, o10, minus_x, rise);
    mesh_add_rectangle(&m, o11, minus_z, rise);
    mesh_add_rectangle(&m, o01, long_x, rise);
    mesh_add_rectangle(&m, o00, long_z, rise);
    mesh_add_rectangle(&m, top, long_z, long_x);
    gltf_add(file, "Housing", &m, &white);
    mesh_free(&m);

    gltf_end(file, folder);
}
