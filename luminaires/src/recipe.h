/* SPDX-License-Identifier: Apache-2.0 */
/* The inside of a recipe: recipe.c reads it, recipe_apply.c applies it.  Meaning of the fields: docs/recipe.md. */
#ifndef LUMINAIRES_RECIPE_H
#define LUMINAIRES_RECIPE_H

#include <luminaires/model.h>

/* What an entry's name is compared with.  ANY: material, mesh, node or one of the node's ancestors. */
typedef enum lum_target { LUM_TARGET_ANY, LUM_TARGET_MATERIAL, LUM_TARGET_MESH, LUM_TARGET_NODE } lum_target;

typedef enum lum_sides { LUM_SIDES_FRONT, LUM_SIDES_BOTH, LUM_SIDES_OUTSIDE } lum_sides;

typedef enum lum_finish {
    LUM_FINISH_NONE, /* the material's own */
    LUM_FINISH_GLASS,
    LUM_FINISH_MIRROR,
    LUM_FINISH_CONDUCTOR,
    LUM_FINISH_DIFFUSE,
    LUM_FINISH_DIFFUSE_TRANSMISSION,
    LUM_FINISH_PHOSPHOR,
    LUM_FINISH_BLACK
} lum_finish;

typedef struct lum_recipe_entry {
    char where[LUM_NAME_SIZE]; /* for messages: its place in the file, or the shorthand */
    char match[LUM_NAME_SIZE]; /* name, '*' for any characters */
    lum_target target;
    bool leave_out, no_emission;
    bool emitter;
    double lumens, luminance; /* one of them > 0 */
    double color[3];          /* luminance 1 */
    lum_sides sides;
    bool has_thin, thin;
    bool has_priority;
    int32_t priority; /* of a solid among others that overlap it */
    double ior; /* 0 = not given */
    lum_finish finish;
    float reflectance[3], transmittance[3], roughness, eta[3], k[3], absorption[3];
    bool has_medium;
    float scattering[3], medium_absorption[3], anisotropy;
    lum_spectral filling; /* of the medium: scattering, absorption, phosphor */
    float through; /* of a diffusing layer: share of what it scatters that goes to the far side, at most */
    char profile[1024];    /* photometric file of a light at matching nodes, "" = none */
    bool profile_point;    /* from a point, whatever shape the file gives */
    double profile_lumens; /* 0 = as the file says */
    lum_spectral spectral; /* what is given by wavelength; the recipe owns it */
} lum_recipe_entry;

/* Smoke or haze: an OpenVDB file, or a box where path is empty. */
typedef struct lum_recipe_volume {
    char where[LUM_NAME_SIZE], name[LUM_NAME_SIZE];
    char path[1024], grid[LUM_NAME_SIZE];
    int interpolation;                  /* lum_interpolation */
    double low[3], high[3];             /* of the box */
    float scattering[3], absorption[3]; /* 1/m at density 1 */
    float anisotropy;
    double to_model[3][4]; /* from the file's world, or the box's frame, to the model's, in its units */
} lum_recipe_volume;

struct lum_recipe {
    double scale; /* metres per unit of the model */
    double flux;  /* rated lumens, 0 = not given */
    uint64_t hash;
    lum_recipe_entry *entries;
    uint32_t entry_count;
    lum_recipe_volume *volumes;
    uint32_t volume_count;
    char folder[1024]; /* files that it names are looked for there: ends in "/", or empty */
    lum_spectrum **spectra;
    uint32_t spectrum_count;
};

/* recipe_medium.c: reads an entry's "medium"; reads "volumes", whose files are looked for in `folder` (ending in "/", or ""). */
struct lum_reader;
void lum_recipe_read_medium(struct lum_reader *r, lum_recipe_entry *e);
void lum_recipe_read_volumes(struct lum_reader *r, const char *folder, lum_recipe *recipe);

#endif
