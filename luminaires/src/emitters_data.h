/* SPDX-License-Identifier: Apache-2.0 */
/* The inside of an emitters' table, for emitters.c, which builds it, and emit.c, which draws light from it. */
#ifndef LUMINAIRES_EMITTERS_DATA_H
#define LUMINAIRES_EMITTERS_DATA_H

#include "scene_data.h"
#include "vec.h"

typedef struct patch {
    double power; /* lumens */
    float bound;  /* largest luminance (cd/m2) in it, coverage applied; 0 when dark */
    float mean;   /* cd/m2 */
} patch;

typedef struct emissive_triangle {
    float v[3][3];     /* vertices, in the model's unit */
    float ng[3];       /* geometric normal, rounded to float */
    float emission[3]; /* cd/m2, of untextured ones */
    float colour[3];   /* the same at luminance 1 */
    float error;       /* lum_triangle_error, in the model's unit */
    float area;        /* m2 */
    uint32_t n;        /* cuts per edge: n * n patches */
    bool textured, both;
    bool plain; /* uniform, Lambertian: what lum_emitters_sample_many does in columns */
    uint32_t first_patch, triangle;
    int32_t material;
} emissive_triangle;

/* One entry of the alias table: a patch, or (from patch_count on) a light. */
typedef struct alias_entry {
    double keep;
    uint32_t other;
    uint32_t owner; /* of a patch: index of its emissive triangle */
} alias_entry;

typedef struct punctual {
    lum_light light;
    double power;    /* lumens; of directional lights: through the model's bounding sphere, only to choose between lights */
    double width;    /* spots: cos_inner - cos_outer as the falloff uses it */
    double ramp_top; /* spots: the falloff's root where the cone ends, 1 unless the ramp goes beyond the axis */
    double ramp;     /* spots: share of the flux in the ramp */
    float colour[3]; /* R,G,B at luminance 1 */
} punctual;

struct lum_emitters {
    const lum_model *model;
    uint32_t triangle_count, patch_count, light_count;
    emissive_triangle *triangles;
    patch *patches;
    int32_t *of_triangle; /* of a model's triangle: index in triangles, or LUM_NONE */
    punctual *lights;
    alias_entry *alias;     /* by flux, directional lights left out (power 0): emission */
    alias_entry *alias_all; /* with directional lights: next-event estimation */
    double flux, flux_all;  /* lumens: sum of the powers in each table */
    double rgb[3];
};

/* Emitted radiance of a triangle at barycentrics, cd/m2, with the surface's coverage (alpha) applied. */
void lum_emission_at(const lum_model *model, uint32_t triangle, double b1, double b2, float rgb[3]);

/* Barycentrics of the corner of patch k of n * n, and the signed step of its edges: the patch is corner + step (a, b), a, b >= 0,
 * a + b <= 1.  Row i (of b1) holds 2 (n - i) - 1 patches, upright and turned ones in turn. */
static inline void patch_corner(uint32_t n, uint32_t i, uint32_t within, double corner[2], double *step)
{
    uint32_t j = within / 2, turned = within & 1;
    corner[0] = (double)(i + turned) / n;
    corner[1] = (double)(j + turned) / n;
    *step = turned ? -1.0 / n : 1.0 / n;
}

static inline uint32_t row_start(uint32_t n, uint32_t i)
{
    return 2 * n * i - i * i;
}

static inline uint32_t row_of(uint32_t n, uint32_t index)
{
    /* Inverse of row_start: i = n - sqrt(n^2 - index), then corrected for rounding. */
    uint32_t i = (uint32_t)((double)n - sqrt((double)n * n - index));
    while (i > 0 && row_start(n, i) > index) {
        i--;
    }
    while (i + 1 < n && row_start(n, i + 1) <= index) {
        i++;
    }
    return i;
}

#endif
