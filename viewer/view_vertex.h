/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The points of a path from the eye at which light is scattered - of surfaces and of media - and the solids that the path is inside
 * of on its way.
 */
#ifndef VIEWER_VIEW_VERTEX_H
#define VIEWER_VIEW_VERTEX_H

#include "view_bands.h"

/* Nested solids that a path may be inside of at once. */
enum { VIEW_MAX_NESTED = 8 };

typedef struct view_stack {
    const view_medium *inside[VIEW_MAX_NESTED]; /* innermost last */
    int depth;
} view_stack;

/* Points in a medium and meters have no material, and their model's frame is the world. */
typedef enum view_vertex_kind {
    VIEW_ON_SURFACE,
    VIEW_IN_MEDIUM, /* scatters by a phase function */
    VIEW_ON_METER   /* the front of a virtual lux meter: scatters as a white Lambertian surface */
} view_vertex_kind;

typedef struct view_vertex {
    view_vertex_kind kind;
    const view_scene *scene;
    view_hit hit; /* of a point in a medium: position alone; of a meter: and the normal */
    const view_object *object;
    lum_surface surface;
    const view_medium *medium; /* of the surface's material */
    lmg_vec3 v;                /* towards where the path came from, in the model's frame */
    double eta_outside;        /* index on the front side */
    double g;                  /* of a point in a medium: of its phase function */
    bool front;                /* the path came from the front side */
    bool smoothed;             /* surface.ng is the shading normal: room only */
    bool converted;            /* what a phosphor emits, not what it scatters (view_settle) */
} view_vertex;

static inline bool view_is_boundary(const lum_material *material)
{
    return material->kind == LUM_SURFACE_PBR && !material->thin &&
           (material->transmission > 0 || material->diffuse_transmission > 0);
}

/* Whether the vertex is on the boundary of a solid. */
static inline bool view_on_boundary(const view_vertex *x)
{
    return x->kind == VIEW_ON_SURFACE && view_is_boundary(x->medium->material);
}

static inline const view_medium *view_innermost(const view_stack *stack)
{
    return stack->depth ? stack->inside[stack->depth - 1] : NULL;
}

/* Whether a boundary lies inside of a solid of higher priority, where light doesn't notice it. */
static inline bool view_is_hidden(const view_stack *stack, const lum_material *material)
{
    return stack->depth > 0 && stack->inside[stack->depth - 1]->material->priority > material->priority;
}

/* The stack after the boundary of a solid has been crossed, inwards or outwards. */
view_stack view_cross_boundary(view_stack stack, const view_medium *medium, bool inwards);

/* A path that meets the back of a solid's boundary from outside of all that it knows has been inside all along: known from now on.
 */
void view_notice_inside(view_stack *stack, const view_vertex *x);

/* The surface at x->hit as seen along d (world). */
void view_see(view_vertex *x, lmg_vec3 d);

/* Makes x the point of a medium where light that came along d (world) is scattered. */
void view_vertex_in_medium(view_vertex *x, const view_scene *scene, lmg_vec3 position, lmg_vec3 d, double g);

/* Makes x a meter that faces normal (unit, world). */
void view_vertex_on_meter(view_vertex *x, const view_scene *scene, lmg_vec3 position, lmg_vec3 normal);

/* Gives a surface what depends on what is around: the index outside, and at boundaries that refract by wavelength one wavelength
 * and its index. */
void view_settle(view_vertex *x, const view_stack *media, view_bands *bands, lum_rng *rng);

/* Whether w is on the same side of the true surface and of the one that shades. */
bool view_same_side(const view_vertex *x, lmg_vec3 w);

/* The light that comes from w (model frame) and goes on towards v, per unit of radiance and steradian of w, per band: p, times the
 * cosine ratio of the adjoint where that applies.  False: none. */
bool view_reflect(const view_vertex *x, const view_bands *bands, lmg_vec3 w, double f[LUM_WAVES]);

/* Density with which scattering finds w (model frame). */
double view_scatter_pdf(const view_vertex *x, lmg_vec3 w);

/* A scattering backwards from v. */
typedef struct view_scattered {
    lmg_vec3 w;               /* model frame */
    double weight[LUM_WAVES]; /* on the bands */
    double eta_scale;         /* change of radiance by refraction */
    double pdf;               /* 0 when direct */
    bool direct;              /* by a delta lobe */
    bool crosses;             /* the boundary of a solid */
} view_scattered;

/* Samples a direction; false when no light comes that way.  Polarization is kept in the world frame. */
bool view_scatter(const view_vertex *x, const view_bands *bands, lum_rng *rng, lum_polarization *polarization, view_scattered *out);

/* Where a ray that leaves the vertex in direction d (world) starts. */
static inline lmg_vec3 view_departure(const view_vertex *x, lmg_vec3 d)
{
    return x->kind == VIEW_IN_MEDIUM ? x->hit.position : view_leave(&x->hit, d);
}

#endif
