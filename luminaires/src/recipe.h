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
    double ior; /* 0 = not given */
    lum_finish finish;
    float reflectance[3], transmittance[3], roughness, eta[3], k[3], absorption[3];
} lum_recipe_entry;

struct lum_recipe {
    double scale; /* metres per unit of the model */
    double flux;  /* rated lumens, 0 = not given */
    uint64_t hash;
    lum_recipe_entry *entries;
    uint32_t entry_count;
};

#endif
