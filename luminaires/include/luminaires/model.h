/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The luminaire model: geometry, materials and emitters of a glTF file after its lamp recipe, in SI units.  Everything that a
 * file says ambiguously has been settled when a lum_model exists; nothing downstream looks at glTF again.  Rooms are models too.
 */
#ifndef LUMINAIRES_MODEL_H
#define LUMINAIRES_MODEL_H

#include <luminaires/photometry.h>
#include <luminaires/spectrum.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { LUM_NAME_SIZE = 128, LUM_NONE = -1 };

/* A picture, decoded.  Texels are linear (sRGB undone where the slot says so), R,G,B,A floats in rows from the top, as glTF's (u,v). */
typedef struct lum_image {
    uint32_t width, height;
    float *texels; /* width * height * 4 */
} lum_image;

typedef enum lum_wrap { LUM_WRAP_REPEAT = 0, LUM_WRAP_CLAMP = 1, LUM_WRAP_MIRROR = 2 } lum_wrap;

/* A use of an image: sampler, texture coordinate set and KHR_texture_transform (uv' = m * (u,v,1)). image LUM_NONE = not textured. */
typedef struct lum_texture {
    int32_t image;
    uint8_t coordinates; /* 0 or 1 */
    uint8_t wrap_s, wrap_t; /* lum_wrap */
    bool nearest;
    float m[2][3];
} lum_texture;

/* What scatters light at a surface. */
typedef enum lum_surface_kind {
    LUM_SURFACE_PBR = 0,       /* glTF metallic-roughness, with transmission, volume, ior, diffuse transmission, and layers */
    LUM_SURFACE_LAMBERT = 1,   /* recipe "diffuse": reflects base_color, Lambertian, nothing specular */
    LUM_SURFACE_CONDUCTOR = 2, /* recipe "mirror"/"conductor": GGX of the given roughness (0 = smooth); reflectance base_color at all
                                  angles ("mirror"), or Fresnel with eta, k ("conductor") */
    LUM_SURFACE_BLACK = 3      /* absorbs everything */
} lum_surface_kind;

typedef enum lum_alpha { LUM_ALPHA_OPAQUE = 0, LUM_ALPHA_MASK = 1, LUM_ALPHA_BLEND = 2 } lum_alpha;

/* What glTF lays over or puts in place of a plain surface; LUM_SURFACE_PBR only.  Bits of lum_layers.present. */
typedef enum lum_layer {
    LUM_LAYER_SPECULAR = 1,    /* KHR_materials_specular: strength and colour of the dielectric's reflection */
    LUM_LAYER_CLEARCOAT = 2,   /* KHR_materials_clearcoat: a clear coat of index 1.5 over everything */
    LUM_LAYER_SHEEN = 4,       /* KHR_materials_sheen: fibres standing on the surface, under the clear coat */
    LUM_LAYER_ANISOTROPY = 8,  /* KHR_materials_anisotropy: brushed metal */
    LUM_LAYER_IRIDESCENCE = 16 /* KHR_materials_iridescence: a thin film on metal or dielectric */
} lum_layer;

typedef struct lum_layers {
    uint32_t present;               /* lum_layer bits; the rest holds glTF's defaults where a layer isn't present */
    float specular;                 /* [0,1] */
    float specular_color[3];        /* >= 0; what it makes of the reflectance at normal incidence is at most 1 */
    lum_texture specular_texture;   /* A */
    lum_texture specular_color_texture; /* sRGB */
    float clearcoat, clearcoat_roughness; /* [0,1] */
    lum_texture clearcoat_texture, clearcoat_roughness_texture; /* R; G */
    lum_texture clearcoat_normal_texture;
    float clearcoat_normal_scale;
    float sheen_color[3], sheen_roughness; /* [0,1] */
    lum_texture sheen_color_texture, sheen_roughness_texture; /* sRGB; A */
    float anisotropy;               /* [0,1]: GGX widths alpha + (1 - alpha) anisotropy^2 along the direction, alpha across it */
    float anisotropy_rotation;      /* radians from the tangent towards the bitangent */
    lum_texture anisotropy_texture; /* R,G direction, B strength */
    float iridescence, iridescence_ior; /* [0,1]; index of the film, >= 1 */
    float thickness_min, thickness_max; /* of the film, nm; without texture: the maximum */
    lum_texture iridescence_texture, thickness_texture; /* R; G */
} lum_layers;

typedef struct lum_material {
    char name[LUM_NAME_SIZE];
    lum_surface_kind kind;
    float base_color[4];         /* linear R,G,B in [0,1]; alpha */
    lum_texture base_texture;    /* sRGB */
    float metallic, roughness;   /* [0,1]; GGX alpha = roughness^2 */
    lum_texture metal_rough_texture; /* G roughness, B metallic */
    lum_texture normal_texture;
    float normal_scale;
    float ior;                   /* >= 1; 1.5 by default */
    float transmission;          /* [0,1], specular transmission (KHR_materials_transmission) */
    lum_texture transmission_texture; /* R */
    float diffuse_transmission;  /* [0,1]: share of the diffuse part that goes through (KHR_materials_diffuse_transmission) */
    float diffuse_transmission_color[3];
    lum_texture diffuse_transmission_texture;       /* A */
    lum_texture diffuse_transmission_color_texture; /* sRGB */
    bool thin;                   /* a transmitting surface is a thin wall (both faces at once: no refraction); false = the boundary of a solid */
    int32_t priority;            /* of a solid: where several overlap, the one of the highest priority is there (recipe "priority") */
    float absorption[3];         /* 1/m inside a solid (KHR_materials_volume: -ln(colour)/distance) */
    float scattering[3];         /* 1/m inside a solid (recipe "medium"); zeros = clear */
    float anisotropy;            /* mean cosine of the phase function of what is inside (luminaires/medium.h) */
    bool has_eta;                /* conductor with complex index eta - i k, per R,G,B */
    float eta[3], k[3];
    float emissive[3];           /* cd/m2, R,G,B (factor x strength, or from the recipe); all zero = doesn't emit */
    lum_texture emissive_texture;/* sRGB */
    lum_alpha alpha_mode;
    float alpha_cutoff;
    bool double_sided;
    bool emits_back;             /* emission from the back face too (double-sided emitters) */
    lum_layers layers;
    lum_spectral spectral;       /* by wavelength, where more is known than R,G,B */
} lum_material;

typedef enum lum_light_kind { LUM_LIGHT_POINT = 0, LUM_LIGHT_SPOT = 1, LUM_LIGHT_DIRECTIONAL = 2, LUM_LIGHT_PROFILE = 3 } lum_light_kind;

/* KHR_lights_punctual, and lights with a photometric file's profile (EXT_lights_ies, recipe).  Directional lights (lux) light rooms; they can't be baked. */
typedef struct lum_light {
    char name[LUM_NAME_SIZE];
    lum_light_kind kind;
    lmg_vec3 position;          /* metres, model frame minus lum_model.centre */
    lmg_vec3 direction;         /* unit, where the light points */
    float intensity[3];         /* cd (point, spot) or lx (directional), R,G,B */
    double cos_inner, cos_outer;
    /* LUM_LIGHT_PROFILE: intensity is a factor on the file's candela; its frame's axes +X, +Y, +Z in the model; its flat shape. */
    lmg_vec3 axes[3];
    lum_shape shape;
    lum_profile *profile; /* belongs to the model */
} lum_light;

typedef struct lum_camera {
    char name[LUM_NAME_SIZE];
    lmg_vec3 eye, forward, up; /* model frame (centre NOT subtracted), unit vectors */
    double yfov;               /* radians */
} lum_camera;

/* One drawn piece: a primitive of a mesh in a node. */
typedef struct lum_part {
    char node[LUM_NAME_SIZE];
    char mesh[LUM_NAME_SIZE];
    int32_t material;
    uint32_t first_triangle, triangle_count;
    double area;              /* m2 */
    bool has_normals;         /* vertex normals came from the file: they say the true curve */
    uint32_t boundary_edges;  /* edges with one triangle, after welding equal positions: 0 = closed */
    uint32_t turned_edges;    /* edges whose two triangles are wound against each other: 0 = front and back are the same all over */
    double enclosed_volume;   /* m3, signed: negative = inward-facing winding; meaningful when closed */
} lum_part;

/* Smoke, haze: a participating medium in a region of space outside of solids, of varying density (luminaires/medium.h). */
typedef struct lum_volume {
    char name[LUM_NAME_SIZE];
    float scattering[3], absorption[3]; /* 1/m where the density is 1 */
    float anisotropy;                   /* mean cosine of the phase function */
    struct lum_grid *grid;              /* density; belongs to the model */
    double to_index[3][4];              /* from the model's frame minus centre (m) to the grid's index coordinates, affine */
    lmg_vec3 bounds_min, bounds_max;    /* relative to centre */
} lum_volume;

/*
 * All arrays belong to the model.  Vertices are kept in a length of the model's own, its unit: so that they are rounded to the same
 * floats whatever the lamp's scale, and light takes the same ways.  All other lengths are in metres.
 */
typedef struct lum_model {
    char path[1024];
    uint64_t hash;            /* of the file, its buffers, images and the recipe: FNV-1a 64 */
    lmg_vec3 centre;          /* metres, in the file's frame */
    uint32_t vertex_count, triangle_count;
    double unit;              /* metres, > 0: the largest coordinate of a vertex relative to centre (1 without any) */
    float *positions;         /* 3 per vertex, (position - centre) / unit, rounded from double; followed by at least 4 spare bytes (Embree
                                 reads 16) */
    float *normals;           /* 3 per vertex, unit; flat ones where the file has none */
    float *tangents;          /* 4 per vertex, or NULL */
    float *uv[2];             /* 2 per vertex, or NULL */
    float *colors;            /* 4 per vertex (linear), or NULL */
    uint32_t *indices;        /* 3 per triangle; counter-clockwise seen from the front, also under mirroring transforms */
    int32_t *triangle_material;
    uint32_t *triangle_part;
    uint32_t part_count;      lum_part *parts;
    uint32_t material_count;  lum_material *materials; /* at least one */
    uint32_t image_count;     lum_image *images;
    uint32_t light_count;     lum_light *lights;
    uint32_t spectrum_count;  lum_spectrum **spectra; /* what the materials' spectral data point to */
    uint32_t camera_count;    lum_camera *cameras;
    uint32_t volume_count;    lum_volume *volumes;
    double rated_flux;        /* lumens of the whole lamp as the recipe's "flux" says, 0 = not given; the emitters are as they are */
    lmg_vec3 bounds_min, bounds_max; /* of the triangles (and punctual lights and volumes), relative to centre */
    uint32_t warning_count;   char **warnings; /* one line each, naming the mesh or material and the recipe entry that would settle it */
} lum_model;

/* ------------------------------------------------------------------------------------------------------------- recipe */

/* A lamp recipe: what a bake needs to know and glTF doesn't say.  JSON, specified in docs/recipe.md. */
typedef struct lum_recipe lum_recipe;

/* Reads a recipe file.  Unknown keys, wrong types and values out of range are errors that name line or key. */
lmg_result lum_recipe_read(const char *path, lum_recipe **out, lmg_error *err);
/* An empty recipe, to be filled by command-line shorthands. */
lmg_result lum_recipe_create(lum_recipe **out, lmg_error *err);
/* Adds one shorthand (all of them: docs/recipe.md), e.g. "emitter:Bulb=800lm", "emitter:Tube=9500cd/m2", "thin:Glass", "no-emission:Shade", "mirror:Reflector=0.9",
 * "diffuse:Casing=0.8", "leave-out:Pole".  Later entries win over earlier ones. */
lmg_result lum_recipe_add(lum_recipe *recipe, const char *shorthand, lmg_error *err);
void lum_recipe_destroy(lum_recipe *recipe);

/* ---------------------------------------------------------------------------------------------------------------- load */

/*
 * Loads a .gltf or .glb (its default scene, else the first), applies the recipe (NULL = none), converts to SI and checks.
 * Errors (LMG_ERROR_FILE_*, LMG_ERROR_INPUT, LMG_ERROR_UNSUPPORTED) name file, element and remedy; *out is NULL then.
 * Files are untrusted.  The model is destroyed by lum_model_destroy.
 */
lmg_result lum_model_load(const char *path, const lum_recipe *recipe, lum_model **out, lmg_error *err);
void lum_model_destroy(lum_model *model);

/* ------------------------------------------------------------------------------------------------------------- lookups */

/* A vertex relative to centre, metres. */
static inline lmg_vec3 lum_model_vertex(const lum_model *m, uint32_t vertex)
{
    const float *p = m->positions + 3 * (size_t)vertex;
    lmg_vec3 r = {m->unit * (double)p[0], m->unit * (double)p[1], m->unit * (double)p[2]};
    return r;
}

/* Whether its surface is the boundary of a solid that lets light in. */
static inline bool lum_material_is_solid(const lum_material *m)
{
    return m->kind == LUM_SURFACE_PBR && !m->thin && m->transmission > 0;
}

/* Whether anything of a material but its emission is textured. */
bool lum_material_is_textured(const lum_material *material);

/* Bilinear (or nearest) texel at texture coordinates uv[coordinates]; (1,1,1,1) when tex->image is LUM_NONE. */
void lum_texture_fetch(const lum_model *model, const lum_texture *tex, const float uv0[2], const float uv1[2], float rgba[4]);

#ifdef __cplusplus
}
#endif
#endif
