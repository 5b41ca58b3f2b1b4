/* SPDX-License-Identifier: Apache-2.0 */
/* Rooms of rectangles as glTF files, boxes of known light, and measured pictures, for the tests of the viewer. */
#ifndef LUMIBOX_TESTS_ROOM_FIXTURE_H
#define LUMIBOX_TESTS_ROOM_FIXTURE_H

#include "render.h"

/* A rectangle corner, corner + e1, ...; its front is on the side of e1 x e2. */
typedef struct room_rectangle {
    double corner[3], e1[3], e2[3];
    double albedo; /* Lambertian; with metal: reflectance */
    bool metal;
    double roughness; /* metal */
    double luminance; /* cd/m2, front only; 0 = doesn't shine */
} room_rectangle;

/* Writes a glTF file (all in one) and fails the test if it can't. */
void room_write(const char *path, const room_rectangle *rectangles, size_t count);

/* The six walls of a box-shaped room, fronts inwards. */
void room_walls(const double lower[3], const double upper[3], double albedo, room_rectangle walls[6]);

/* A field whose light is exactly that of a Lambertian rectangle of luminance 1 (times color) in the plane y = 0, shining down:
 * x0 <= x <= x1, z0 <= z <= z1.  Its bounds reach from y = 0 up to height. */
lmg_field *panel_field(double x0, double x1, double z0, double z1, double height, const float color[3], double luminance);

/* The same with light only in directions whose aperture coordinates are within +-window (a beam about -y). */
lmg_field *beam_field(double x0, double x1, double z0, double z1, double height, const float color[3], double luminance,
                      double window);

/* Its flux (lumens) and its illuminance at (x,-h,z) on a surface facing up: closed forms. */
double panel_flux(double x0, double x1, double z0, double z1, double luminance);
double panel_illuminance(double x0, double x1, double z0, double z1, double luminance, double x, double h, double z);

/* Mean luminance of a rendering and its standard error. */
typedef struct measurement {
    double mean, se;
    uint64_t refused;
} measurement;
measurement measure(const view_scene *scene, const view_camera *camera, uint32_t width, uint32_t height, uint32_t samples,
                    uint64_t seed, view_path_options options);

/* A camera given in the room file's frame. */
view_camera camera_at(const view_scene *scene, double ex, double ey, double ez, double tx, double ty, double tz,
                      double yfov_degrees);

/* A scene from rectangles, by way of a temporary glTF file; not finished yet. */
view_scene *scene_of(const room_rectangle *rectangles, size_t count);

/* The same with a recipe for the room (JSON; NULL: none). */
view_scene *scene_with_recipe(const room_rectangle *rectangles, size_t count, const char *recipe);

#endif
