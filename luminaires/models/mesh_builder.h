/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Triangle meshes from a few shapes: surfaces of revolution about Y, spheres, boxes, discs, rectangles.  Positions and normals in
 * double until they are written.  Triangles are wound so that their front faces the side their vertex normals point to.
 * Running out of memory ends the program: this serves a build step.
 */
#ifndef LUMIBOX_MODELS_MESH_BUILDER_H
#define LUMIBOX_MODELS_MESH_BUILDER_H

#include <stddef.h>
#include <stdint.h>

typedef struct mesh_vertex {
    double position[3], normal[3];
} mesh_vertex;

typedef struct mesh {
    mesh_vertex *vertices;
    uint32_t *indices;
    size_t vertex_count, vertex_room, index_count, index_room;
} mesh;

/* A point of a profile that turns about Y: radius, height and the normal's two components (unit). */
typedef struct mesh_profile {
    double r, y, nr, ny;
} mesh_profile;

void mesh_free(mesh *m);

uint32_t mesh_add_vertex(mesh *m, const double position[3], const double normal[3]);
/* Skips triangles without area (two equal corners at a pole). */
void mesh_add_triangle(mesh *m, uint32_t a, uint32_t b, uint32_t c);

/* Turns a profile about the Y axis through centre, in equal steps. */
void mesh_add_revolution(mesh *m, const double centre[3], const mesh_profile *profile, size_t count, unsigned segments);

/* Straight piece of profile from (r0,y0) to (r1,y1) in `steps` equal pieces, flat-shaded along it; the normal is to the right of the
 * direction of travel in the (r,y) half-plane turned by `side` = +1 or -1. */
void mesh_add_cone(mesh *m, const double centre[3], double r0, double y0, double r1, double y1, double side, unsigned steps,
                   unsigned segments);

/* Sphere with normals outwards; bands of equal angle. */
void mesh_add_sphere(mesh *m, const double centre[3], double radius, unsigned bands, unsigned segments);

/* Box between two corners, normals outwards (side = +1) or inwards (side = -1). */
void mesh_add_box(mesh *m, const double low[3], const double high[3], double side);

/* Rectangle from a corner along two edges; its front is the side of edge1 x edge2. */
void mesh_add_rectangle(mesh *m, const double corner[3], const double edge1[3], const double edge2[3]);

/* Area of all triangles, m2. */
double mesh_area(const mesh *m);

#endif
