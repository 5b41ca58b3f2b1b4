/* SPDX-License-Identifier: Apache-2.0 */
/* Inside sets of goniometer pictures: the geometry that reading and writing share. */
#ifndef BAKER_PICTURE_SET_INSIDE_H
#define BAKER_PICTURE_SET_INSIDE_H

#include <luminaires/picture.h>

typedef struct picture_set {
    char *path;            /* the folder */
    uint32_t rows, columns; /* values of theta and phi */
    double *theta, *phi, *theta_edge, *phi_edge; /* radians; edges: one more each.  One allocation, theta's */
    char **files;          /* names in the folder, [row * columns + column]; NULL = dark */
    uint32_t width, height;
    double half_field;     /* tangent of half the field's angle across the width */
    double distance;
    lmg_vec3 centre, axis, zero; /* theta counts from axis, phi from zero towards axis x zero */
    lmg_vec3 lo, hi;             /* bounds that the light comes out of */
    bool radiant;
    double told;
} picture_set;

/* Directions of the camera that stands towards (theta, phi): out from the luminaire, right and up in its picture. */
typedef struct set_camera {
    lmg_vec3 out, right, up;
} set_camera;

set_camera set_camera_at(const picture_set *set, double theta, double phi);

/* Where the camera stands. */
lmg_vec3 set_place(const picture_set *set, lmg_vec3 out);

/* Tangents x (right), y (up) of the place (i, j) of a picture, in pixels from its upper left corner; returns cos(alpha) dw of the
 * pixel there. */
double set_pixel_at(const picture_set *set, double i, double j, double *x, double *y);

/* A picture's share of the camera's sphere, m2. */
double set_cell_area(const picture_set *set, uint32_t row, uint32_t column);

lmg_result set_create(uint32_t rows, uint32_t columns, const char *path, picture_set *set, lmg_error *err);
void set_make_edges(picture_set *set);
void set_free(picture_set *set);

/* Reads one that isn't dark. */
lmg_result set_read_picture(const picture_set *set, uint32_t index, lum_picture *picture, lmg_error *err);

/* index.json of the folder. */
lmg_result set_read_index(const char *path, picture_set *set, lmg_error *err);
lmg_result set_write_index(const picture_set *set, const char *folder, double flux, const char *origin, lmg_error *err);

#endif
