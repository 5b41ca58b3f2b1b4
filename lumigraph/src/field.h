/* SPDX-License-Identifier: Apache-2.0 */
/* The inside of a field, for the files of this library only: reconstruct.c fills it, exr_write.c and
 * exr_read.c store it and bring it back, sample.c and ask.c read it. */
#ifndef LUMIGRAPH_FIELD_H
#define LUMIGRAPH_FIELD_H

#include <lumigraph/lumigraph.h>

typedef struct lmg_text {
    char name[64];
    char *value;
} lmg_text;

/* Cells are ordered so that the (s,t) picture of one (u,v) cell lies together: index = ((iv * nu + iu) * nt + it) * ns + is. */
typedef struct lmg_slab_data {
    uint64_t cells;
    float *cell;           /* what a look-up reads of a cell, side by side so that it touches one line of the cache; see below */
    uint32_t stride;       /* floats of a cell: channels + 1 */
    float *standard_error; /* of the luminance, cd/m2, one per cell */
    float *half_a;         /* luminance of half A alone, cd/m2, scaled as if A were the whole bake; half B = 2 x luminance - A */
    double flux, flux_se;  /* lumens; derived, recomputed on reading */
} lmg_slab_data;

/* Radiance of a cell, cd/m2: one number for each channel; with one channel luminance. */
static inline float *lmg_cell_radiance(const lmg_slab_data *data, uint64_t cell)
{
    return data->cell + cell * data->stride;
}

/* After it, in place of a float, the slopes of radiance within the cell (slopes.h): gu, gv, gs, gt in units of 1/127; derived, not
 * stored in files. */
static inline int8_t *lmg_cell_slopes(const lmg_slab_data *data, uint64_t cell)
{
    return (int8_t *)(data->cell + cell * data->stride + data->stride - 1);
}

/* What sampling from a point and emission need, built after reconstruction or reading (sample.c); derived, not stored in files. */
typedef struct lmg_sampler lmg_sampler;

struct lmg_field {
    lmg_layout layout;
    lmg_ledger ledger;
    lmg_slab_data slabs[LMG_MAX_SLABS];
    lmg_text *texts; /* sorted by name */
    size_t text_count;
    lmg_sampler *sampler;
    lmg_rounding rounding; /* of the file it was read from */
    struct lmg_trees *trees; /* NULL: none */
};

/* field.c: an empty field with zeroed cells for the layout (already checked). */
lmg_result lmg_field_allocate(const lmg_layout *layout, lmg_field **out, lmg_error *err);

/* sample.c: (re)computes slab fluxes and builds the sampler from the cells; to be called once the cells are final. */
lmg_result lmg_field_prepare(lmg_field *field, lmg_error *err);
void lmg_sampler_destroy(lmg_sampler *sampler);
size_t lmg_sampler_memory(const lmg_sampler *sampler);

/* geometry.c: the slab that owns a ray (first that contains it), or -1; coordinates of the ray there. */
int lmg_layout_owner(const lmg_layout *layout, lmg_vec3 origin, lmg_vec3 direction, double uvst[4]);

/* etendue.c: etendue of a cell without the parts that slabs of higher priority own or whose lines miss the bounds;
 * lmg_slab_cell_etendue where there are none.  Slow; etendue.h serves many cells. */
double lmg_layout_cell_etendue(const lmg_layout *layout, uint32_t slab, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);

/* geometry.c: FNV-1a 64 over bytes, continued from hash (start with 0xcbf29ce484222325). */
uint64_t lmg_hash(uint64_t hash, const void *bytes, size_t count);

#endif
