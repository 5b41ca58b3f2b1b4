/* SPDX-License-Identifier: Apache-2.0 */
/* What asking a field needs besides its cells, for sample.c and ask.c. */
#ifndef LUMIGRAPH_SAMPLER_H
#define LUMIGRAPH_SAMPLER_H

#include "etendue.h"
#include "field.h"
#include "geometry.h"
#include "slopes.h"

/*
 * How bright a group of slabs is seen from where: slabs that share a frame and so one (u,v) plane.  The plane is cut in blocks, 1 x 1 to
 * 16 x 16 (levels), each with a coarse picture of its mean luminance over directions, 16 x 16 bins and their averages down to 1 x 1
 * (mips).  Directions are (s,t) of cube slabs, direction cosines of aperture slabs.  A beam window has a table of its own, so that the
 * bins follow the beam; tables include the light of all slabs of the group that lie in their rectangle.
 */
enum { LMG_LEVELS = 5, LMG_BINS = 16, LMG_PICTURE = 256 + 64 + 16 + 4 + 1, LMG_PARENTS = 1 + 4 + 16 + 64 };
/* First block of a level, among parents; and first bin of a mip within a picture. */
static const uint32_t LMG_LEVEL_START[LMG_LEVELS] = {0, 1, 5, 21, 85};
static const int32_t LMG_MIP_START[LMG_LEVELS] = {0, 256, 320, 336, 340};

typedef struct lmg_brightness {
    double x0, x1, y0, y1; /* rectangle of directions */
    float low[2], high[2];  /* the same */
    float x_scale, y_scale; /* bins per unit */
    float finest, inv_finest; /* width of the narrower finest bins */
    uint16_t *children; /* for each block of levels 0 to 3, each bin: the luminance of its four children side by side, each as the upper half
                           of a float; two bins more at the end */
} lmg_brightness;

typedef struct lmg_group {
    const lmg_slab *frame; /* any of its slabs */
    double u0, u1, v0, v1; /* holds the rectangles of all */
    double flux;           /* lumens */
    bool inside;           /* the (u,v) rectangles lie in the bounds: no light is seen before its plane */
    uint32_t levels;       /* finest level worth going down to */
    uint32_t table_count;
    lmg_brightness *tables; /* in order of priority, the last one contains the others */
} lmg_group;

struct lmg_sampler {
    lmg_plan plan;
    lmg_etendue etendue[LMG_MAX_SLABS];
    lmg_slopes slopes[LMG_MAX_SLABS];
    /* Emission: running sum of flux over rows of cells, over all slabs in order.  A row is the cells that differ in s only, or a single
     * cell where the etendue of cells is costly (row_length 1). */
    double *rows;
    uint64_t row_count;
    /* Where to look for a flux among the rows: first row whose sum exceeds k/guide_count of all, k from 0 to guide_count, a power of 2. */
    uint64_t *guide;
    uint64_t guide_count;
    uint64_t first_row[LMG_MAX_SLABS + 1];
    uint32_t row_length[LMG_MAX_SLABS];
    double flux; /* of all groups, lumens */
    uint32_t group_count;
    lmg_group groups[LMG_MAX_SLABS];
    int8_t group_of[LMG_MAX_SLABS]; /* -1: no light */
};

/* Luminance of a cell. */
static inline double lmg_cell_luminance(const lmg_field *field, uint32_t j, uint64_t cell)
{
    const float *r = lmg_cell_radiance(&field->slabs[j], cell);
    return field->layout.channels == 1 ? (double)r[0] : lmg_luminance(r);
}

static inline void lmg_place_prefetch(const lmg_field *field, uint32_t j, const lmg_place *place)
{
#if defined(__GNUC__)
    __builtin_prefetch(lmg_cell_radiance(&field->slabs[j], place->cell));
#else
    (void)field, (void)j, (void)place;
#endif
}

/* R,G,B of a cell: its mean. */
static inline void lmg_cell_mean(const lmg_field *field, uint32_t j, uint64_t cell, float rgb[3])
{
    const float *r = lmg_cell_radiance(&field->slabs[j], cell);
    for (int c = 0; c < 3; c++)
        rgb[c] = field->layout.channels == 1 ? r[0] * field->layout.colour[c] : r[c];
}

/* R,G,B at a place of slab j. */
static inline void lmg_place_rgb(const lmg_field *field, uint32_t j, const lmg_place *place, float rgb[3])
{
    float shape = lmg_shape(&field->sampler->slopes[j], lmg_cell_slopes(&field->slabs[j], place->cell), place);
    lmg_cell_mean(field, j, place->cell, rgb);
    for (int c = 0; c < 3; c++)
        rgb[c] *= shape;
}

/* ask.c: lmg_field_illuminance; everywhere: also where no light can be, which must give the same. */
lmg_result lmg_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, bool everywhere, double rgb[3], double *standard_error,
                           lmg_error *err);

/* brightness.c */
lmg_result lmg_groups_create(const lmg_field *field, lmg_sampler *sampler, lmg_error *err);
void lmg_groups_destroy(lmg_sampler *sampler);
size_t lmg_groups_memory(const lmg_sampler *sampler);

#endif
