/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Scattering at a surface: what a photon or a path does where it hits.
 *
 * A lum_surface is a material at a point, textures applied.  All directions are in the model frame and point AWAY from the surface:
 * wi is where the light came from (photon tracing: minus its direction of travel), wo where it goes.
 *
 * Flux convention.  The density p(wo | wi) per steradian of wo says where the flux that arrives from wi goes; its integral over wo
 * is the albedo.  lum_scatter_eval returns p(wo|wi) (R,G,B, 1/sr).  For flat normals p = f cos(wo), and reciprocity of f holds.
 * Radiance that leaves towards wo is: integral of L(wi) p(wo|wi) |cos_g wi| / |cos_g wo| dwi, with cos_g against the geometric
 * normal: that is how the viewer uses the same functions backwards (adjoint), also under interpolated normals, and across
 * refraction times (n_o/n_i)^2.
 *
 * Energy: the albedo never exceeds 1, and for lossless materials (reflectances 1, dielectrics) lum_scatter_sample returns weight
 * exactly 1, whatever the roughness or the shading normal.
 */
#ifndef LUMINAIRES_SCATTER_H
#define LUMINAIRES_SCATTER_H

#include <luminaires/scene.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The layers of a material at a point (lum_layers).  Meaningful where lum_surface.layers_present has their bits. */
typedef struct lum_surface_layers {
    float specular, specular_color[3];
    float clearcoat, clearcoat_alpha;
    lmg_vec3 clearcoat_normal; /* unit, same side as ng */
    float sheen[3], sheen_alpha;
    lmg_vec3 tangent;     /* of anisotropy: unit, perpendicular to ns; the direction of alpha_along */
    float alpha_along;    /* GGX width along it; across it: lum_surface.alpha */
    float iridescence, film_ior, film_nm;
} lum_surface_layers;

typedef struct lum_surface {
    const lum_material *material;
    const struct lum_tables *tables; /* albedo tables of rough lobes (microfacet.h); they belong to the scene */
    lmg_vec3 ng;                     /* geometric normal, front side */
    lmg_vec3 ns;                     /* shading normal (interpolated, normal map), same side as ng */
    bool tilted;                     /* ns differs from ng */
    lum_surface_kind kind;
    float base[3];         /* base colour with texture and vertex colour */
    float metallic, alpha; /* alpha: GGX width (roughness^2); below LUM_SMOOTH the surface is specular (delta) */
    float ior; /* the material's; a tracer that follows one wavelength puts that one's index here */
    float transmission, diffuse_transmission;
    float through[3];  /* colour of diffuse transmission */
    float coverage;    /* [0,1]: share of light that meets the surface at all (alpha mask / blend); the tracer decides by chance */
    float emission[3]; /* cd/m2 towards the side of wi, zero on dark sides */
    bool front;        /* the ray came from the front side */
    uint32_t layers_present;   /* lum_layer bits */
    lum_surface_layers layers; /* the last member: not copied where none is present */
} lum_surface;

/* GGX alpha below which a surface is treated as smooth (alpha 1e-4: lobe half-width 0.006 degrees). */
#define LUM_SMOOTH 1e-4f

/* Evaluates material, textures and normals at a hit reached by a ray travelling in direction d.  Takes the scene, not the model:
 * the scene keeps a compact record per triangle.  The result is valid as long as the scene. */
void lum_surface_at(const lum_scene *scene, const lum_hit *hit, lmg_vec3 d, lum_surface *out);

typedef enum lum_event {
    LUM_ABSORBED = 0, /* only by black surfaces; all others absorb through the weight */
    LUM_REFLECTED = 1,
    LUM_TRANSMITTED = 2, /* to the other side of the surface */
    LUM_DELTA = 4,       /* flag: from a delta distribution; pdf and eval don't apply */
    LUM_BOUNDARY = 8 /* flag, with LUM_TRANSMITTED: through the boundary of a solid, so the medium changes (outside <-> the solid's
                        inside); without it the light passed a thin wall or a diffusing sheet and the medium stays the same */
} lum_event;

typedef struct lum_scattered {
    lmg_vec3 wo;
    float weight[3]; /* R,G,B in [0,1]: the reflectance of the lobe chosen.  Its mean over everything that gives the same wo is p /
                        pdf, its expectation is the albedo */
    double pdf;      /* per steradian, of everything that could have given wo; 1 for delta */
    int event;       /* LUM_ABSORBED (weight 0), or LUM_REFLECTED / LUM_TRANSMITTED, | LUM_DELTA */
} lum_scattered;

/* eta_outside: refractive index of the medium on the front side (1 for air); solids use material->ior behind.  xi: four numbers in
 * [0,1), xi[3] may be reused (rescaled) for choices between lobes. */
void lum_scatter_sample(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4], lum_scattered *out);

/*
 * Polarization of a photon: the electric field (complex, unit, perpendicular to the direction of travel, model frame) of a pure
 * state; known = false: unpolarized, as emitters and diffuse reflection leave it; {0} at the start of a path.  Unpolarized light is
 * a mixture of pure states, so photons in random pure states carry partly polarized light exactly.  It matters: reflection
 * polarizes, and a clear pane transmits 0.8435 at 60 degrees where unpolarized formulae face by face give 0.8307.
 */
typedef struct lum_polarization {
    lmg_vec3 re, im;
    bool known;
} lum_polarization;

/* lum_scatter_sample for tracers that follow photons: without the pdf (left 0; see lum_scatter_pdf), which costs as much as the
 * sample, and with the photon's polarization, updated (NULL = taken as unpolarized at every event).  Serves paths traced backwards
 * from an eye just as well: transport is reciprocal. */
void lum_scatter_trace(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4],
                       lum_polarization *polarization, lum_scattered *out);

/* What meets a surface, and what becomes of it. */
typedef struct lum_encounter {
    lum_surface surface;
    lmg_vec3 wi;
    float eta_outside;
    double xi[4];
    lum_polarization *polarization; /* NULL as above */
    lum_scattered out;
} lum_encounter;

enum { LUM_MAX_ENCOUNTERS = 64 };

/* lum_scatter_trace for count (at most LUM_MAX_ENCOUNTERS) encounters: the same results to the bit, faster together. */
void lum_scatter_trace_many(size_t count, lum_encounter *encounters);

void lum_scatter_eval(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside, float p[3]);
double lum_scatter_pdf(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside);

/* Exact Fresnel reflectance of unpolarised light: dielectric with relative index eta = n_t / n_i (cos_i in [0,1]; 1 beyond the
 * critical angle) and conductor with relative complex index eta - i k.  Born and Wolf. */
double lum_fresnel_dielectric(double cos_i, double eta);
double lum_fresnel_conductor(double cos_i, double eta, double k);

/* Reflectance of a thin wall of index eta in unpolarized light, all inter-reflections, no absorption: the mean of 2F/(1+F) over the
 * two polarizations; the rest is transmitted. */
double lum_fresnel_thin(double cos_i, double eta);

/* ------------------------------------------------------------------------------------------------------------ emitters */

/* All that shines in a model: emissive triangles and point and spot lights, chosen in proportion to power. */
typedef struct lum_emitters lum_emitters;

lmg_result lum_emitters_create(const lum_model *model, lum_emitters **out, lmg_error *err);
void lum_emitters_destroy(lum_emitters *emitters);

/* Total flux in lumens (luminance) and as R,G,B; zero for a model that emits nothing. */
double lum_emitters_flux(const lum_emitters *emitters, double rgb[3]);

/* One emitted photon of luminance-weighted flux 1: origin (on the emitter, already offset off its surface), unit direction, flux
 * R,G,B.  xi: six numbers. Textured emitters are sampled by rejection with numbers from next(state), so that every photon carries
 * the same luminous flux. */
typedef struct lum_photon {
    lmg_vec3 origin, direction; /* model frame minus centre */
    float flux[3];
    int32_t material; /* of the emitting surface, LUM_NONE for lights */
} lum_photon;
void lum_emitters_sample(const lum_emitters *emitters, const double xi[6], double (*next)(void *state), void *state,
                         lum_photon *out);

/*
 * Many photons at once, in columns, so that processors with wide registers work on several: photon k of the result is what
 * lum_emitters_sample gives with six numbers from stream k.  count: at most LUM_PHOTONS.  numbers: of the photons; streams are those
 * of lum_rng_stream(seed, number), and are left where the photon's emission has got to.  colour: flux R,G,B at luminance 1.
 */
enum { LUM_PHOTONS = 64 };
typedef struct lum_photons {
    uint64_t number[LUM_PHOTONS], rng[LUM_PHOTONS];
    double origin[3][LUM_PHOTONS], direction[3][LUM_PHOTONS], colour[3][LUM_PHOTONS];
    int32_t material[LUM_PHOTONS]; /* of the emitting surface, LUM_NONE for lights */
} lum_photons;
void lum_emitters_sample_many(const lum_emitters *emitters, uint64_t seed, size_t count, lum_photons *photons);

/* How many triangles (or pieces of textured ones) and lights are in the emitters' table. */
uint32_t lum_emitters_count(const lum_emitters *emitters);

/* Which of `parts` equal parts of the emitters' table photon first + i chooses (the first number of its stream says so): photons of one
 * part start close together.  parts: at most 2^16. */
void lum_emitters_parts(uint64_t seed, uint64_t first, size_t count, uint32_t parts, uint16_t *part);

/* Next-event estimation, for the viewer: a point on an emitter as seen from p; radiance R,G,B arriving (unoccluded), direction,
 * distance, pdf per steradian.  Delta lights: delta true, pdf 1, radiance holds the illuminance across the direction over the
 * light's chance; directional lights have distance INFINITY.  False if it contributes nothing. */
typedef struct lum_light_sample {
    lmg_vec3 direction;
    double distance, pdf;
    float radiance[3];
    int32_t material; /* of the emitting surface, LUM_NONE for lights */
    bool delta;
} lum_light_sample;
bool lum_emitters_sample_point(const lum_emitters *emitters, lmg_vec3 p, const double xi[3], lum_light_sample *out);
/* pdf per steradian with which the above gives the direction that hits triangle at hit, from p. */
double lum_emitters_point_pdf(const lum_emitters *emitters, lmg_vec3 p, const lum_hit *hit);

#ifdef __cplusplus
}
#endif
#endif
