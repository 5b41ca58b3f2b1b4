/* SPDX-License-Identifier: Apache-2.0 */
/* The inside of a scene, for the files of this library only: scene.c builds and traces it, surface.c and emitters.c read it. */
#ifndef LUMINAIRES_SCENE_DATA_H
#define LUMINAIRES_SCENE_DATA_H

#include "microfacet.h"

/* Half the distance between 1 and the next float: bound of the relative error of rounding to float. */
#define LUM_FLOAT_ROUNDING 0x1p-24

enum {
    LUM_TRIANGLE_SMOOTH = 1u << 31, /* in lum_triangle.material: the vertex normals differ from the face's */
    LUM_TRIANGLE_MATERIAL = 0x7fffffff,
    LUM_FOLD_BITS = 9,
    LUM_FOLD_STEPS = (1 << LUM_FOLD_BITS) - 1,
    LUM_TRIANGLE_TOUCHES = 1u << 30 /* in lum_triangle.edges: other surfaces lie on it (touching.c) */
};

/* Surfaces are at the same place when they are this near, in lum_triangle_error: an origin that stands off the one by an error would
 * otherwise be too close to the other one for Embree to tell its side. */
#define LUM_TOUCHING_GAP 2.0

/* All that a hit needs of a triangle, in one cache line. */
typedef struct lum_triangle {
    float v[3][3];       /* vertices, in the model's unit */
    float ng[3];         /* geometric normal, rounded to float */
    uint32_t material;   /* index | LUM_TRIANGLE_SMOOTH */
    float error;         /* lum_hit.error in the model's unit: see lum_triangle_error */
    float margin;        /* largest barycentric distance that hits keep from the edges: see lum_triangle_error */
    uint32_t edges;      /* of the edge opposite vertex i: bit i, it is flat, hits may lie on it; from bit 3 + LUM_FOLD_BITS i on, how
                            the surface goes on there (scene.c: note_edges) */
} lum_triangle;

/* What lum_surface_at knows of a material before it sees the hit. */
typedef struct lum_shading {
    lum_surface surface; /* of an untextured point seen from the front */
    bool emissive;
    bool fetch; /* anything depends on the hit: textures or vertex colours */
} lum_shading;

struct lum_scene {
    const lum_model *model;
    double unit, per_unit;    /* the model's, metres, and 1 / unit: triangles and Embree are in it, as the model's vertices are */
    lum_triangle *triangles;
    float (*normals)[3][3]; /* per triangle; NULL if no triangle is smooth */
    uint32_t (*neighbour)[3]; /* per triangle: the one beyond the edge opposite vertex i, where exactly two meet, else LUM_MISS */
    lum_shading *shading;   /* per material */
    lum_table_store tables;
    void *device, *embree; /* RTCDevice, RTCScene */
    bool touching;         /* some triangle is marked LUM_TRIANGLE_TOUCHES */
    bool variant;          /* triangles, normals, device and embree belong to another scene */
};

/*
 * How far a new ray's origin must stand off a triangle, in the unit of its vertices.
 *
 * Hits are found again in double precision, so a hit's position is exact to about 1e-16 of the coordinates.  What limits is that
 * Embree takes the origin of the next ray as floats.  With u = 2^-24 and M the largest vertex coordinate (it bounds |P| on the
 * triangle): rounding of the origin moves it along the normal by at most u (|Px nx| + |Py ny| + |Pz nz|) <= sqrt(3) u M; Embree's
 * differences V - O have components of at most 2 M, rounded: another 2 sqrt(3) u M along the normal; its normal, a cross product of
 * such differences, and the dot product with it: each of 6 more roundings at most 2 sqrt(3) u M. Sum: at most 15 sqrt(3) u M = 26 u
 * M for a triangle that isn't a sliver (where the normal's relative error grows as 1/sin of the smallest angle; there the hit is
 * rejected by the test in double precision).  32 u M is 1.9 um per metre of M: a fiftieth of a 0.1 mm wall.
 */
static inline double lum_triangle_error(const float v[3][3])
{
    double m = 0;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            double a = v[i][k] < 0 ? -(double)v[i][k] : (double)v[i][k];
            m = a > m ? a : m;
        }
    }
    return 32 * LUM_FLOAT_ROUNDING * m + 0x1p-100; /* never zero, also for a triangle at the very origin */
}

/* microfacet.c: the tables of all materials. */
lmg_result lum_tables_create(const lum_model *model, lum_table_store *store, lmg_error *err);
void lum_tables_destroy(lum_table_store *store);

/* touching.c: marks triangles of solids and others that lie on each other. */
lmg_result lum_find_touching(lum_scene *scene, lmg_error *err);

/* surface.c: fills scene->shading. */
lmg_result lum_shading_create(lum_scene *scene, lmg_error *err);

#endif
