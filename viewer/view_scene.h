/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What the viewer renders: a room, boxes of light placed in it, and lamps placed in it by their geometry.
 *
 * World frame: the room file's frame minus the room model's centre (small numbers), metres.
 *
 * A box stands in for its lamp.  It is light only: it hides nothing and casts no shadow, its light starts where a ray meets its
 * bounds, and whatever else stands inside the bounds (a ceiling that cuts through, say) doesn't hide it.  A point inside the bounds
 * gets no light from that box.  A surface outside the bounds shadows it as usual.
 *
 * Threads: a scene that is complete may be used by any number of threads.
 */
#ifndef VIEWER_VIEW_SCENE_H
#define VIEWER_VIEW_SCENE_H

#include "placement.h"
#include "view_math.h"

#include <luminaires/scatter.h>
#include <luminaires/waves.h>

/* A medium inside a solid, as paths need it. */
typedef struct view_medium {
    const lum_material *material;
    int32_t index; /* of the material in its model */
    bool scatters;
    lum_medium inside;
    const lum_wave_tables *tables; /* of its model; NULL in scenes in R,G,B */
} view_medium;

/* Geometry in the scene: the room (always the first) or a lamp. */
typedef struct view_object {
    lum_model *model;
    lum_scene *scene;       /* NULL when the model has no triangles */
    lum_emitters *emitters; /* NULL when it has none that shine */
    view_medium *media;     /* per material */
    lum_wave_tables *waves; /* NULL in scenes in R,G,B */
    const char *unseen;     /* a punctual light whose light by way of mirrors and clear glass no path from the eye finds; NULL: none */
    view_motion motion;     /* from the model's coordinates (minus its centre) to the world */
    double flux;            /* lumens of its emitters, scale included */
    double scale;           /* its emitters' light is multiplied by this */
    bool lamp;              /* exact adjoint of the photon tracer (see view_path.h) */
    bool has_alpha;         /* some material lets light by without scattering */
} view_object;

/* A placed box of light. */
typedef struct view_box {
    lmg_field *field;
    view_motion motion; /* from the luminaire's frame to the world */
    double flux;        /* lumens stored, scale included */
    double scale;       /* its light is multiplied by this */
    lmg_vec3 centre;    /* of the bounds, world */
    double radius2;     /* squared half diagonal of the bounds */
    char path[1024];
} view_box;

/* A light that the paths choose from: a box, or all that shines in an object. */
typedef enum view_light_kind { VIEW_LIGHT_BOX, VIEW_LIGHT_EMITTERS } view_light_kind;
typedef struct view_light {
    view_light_kind kind;
    uint32_t index;    /* of the box, or of the object */
    double strength;   /* flux / 4 pi (cd) */
    double everywhere; /* illuminance of directional lights (lx) */
    lmg_vec3 centre;
    double radius2; /* keeps the estimate of the light's share finite nearby */
} view_light;

typedef struct view_scene {
    uint32_t object_count, box_count, light_count;
    view_object *objects;
    view_box *boxes;
    view_light *lights;
    lum_volumes *volumes;         /* of all objects, in the world, outside of solids; NULL = none */
    const lum_wave_tables *waves; /* from which paths draw wavelengths; NULL: everything is in R,G,B */
    lmg_vec3 origin;   /* the room model's centre: file frame = world + origin */
    double boxes_flux; /* lumens of all boxes */
    double connect;    /* probability with which paths from the boxes are worth while */
} view_scene;

/* A hit in the world frame, with the object that was hit. */
typedef struct view_hit {
    lum_hit hit;           /* position and normal in the model's frame, as lum_surface_at needs it */
    lmg_vec3 position, ng; /* world */
    uint32_t object;
} view_hit;

/* Loads the room; recipe may be NULL (borrowed for the call).  Errors are those of lum_model_load and lum_scene_create. */
lmg_result view_scene_create(const char *room_path, const lum_recipe *recipe, view_scene **out, lmg_error *err);
void view_scene_destroy(view_scene *scene);

/* Adds a placed box; flux: lumens that the baked lamp's sources are to emit (before losses in the luminaire), 0 = as baked. */
lmg_result view_scene_add_box(view_scene *scene, const char *path, const view_placement *placement, double flux, lmg_error *err);

/* Adds a box that is already in memory and takes it over (also on failure). */
lmg_result view_scene_adopt_box(view_scene *scene, lmg_field *field, const view_placement *placement, double flux, lmg_error *err);

/* Adds a lamp by its geometry; recipe may be NULL (borrowed for the call).  flux: lumens that its sources are to emit, 0 = as the
 * model says. */
lmg_result view_scene_add_lamp(view_scene *scene, const char *path, const lum_recipe *recipe, const view_placement *placement,
                               double flux, lmg_error *err);

/*
 * Makes the list of lights, joins the objects' volumes (LMG_ERROR_UNSUPPORTED: too many), makes tables of wavelengths where an object
 * calls for them, and measures what paths from the boxes would gain; to be called once everything is in.
 *
 * The measure: the mean illuminance that the boxes' own light meets with where it falls, over the mean illuminance of the room; 1
 * for a room lit evenly, thousands for a spot.  That many paths fewer than by luck find the lit patch.  Connections are made in
 * proportion up to CONNECT_ALWAYS, and not at all below a tenth of it.
 */
lmg_result view_scene_finish(view_scene *scene, lmg_error *err);

/* Closest hit along origin + t direction (unit), t > 0. */
bool view_scene_intersect(const view_scene *scene, lmg_vec3 origin, lmg_vec3 direction, view_hit *hit);

/* Whether something stands between origin and a light that is so far away (INFINITY: anywhere) in that direction.  What stands within
 * some roundings of the light, micrometres in a room, is taken for it.  next(state) decides by chance at surfaces that cover in part.
 */
bool view_scene_occluded(const view_scene *scene, lmg_vec3 origin, lmg_vec3 direction, double distance, double (*next)(void *state),
                         void *state);

/* Where a ray that leaves hit in direction d starts. */
static inline lmg_vec3 view_leave(const view_hit *hit, lmg_vec3 d)
{
    double side = view_dot(d, hit->ng) >= 0 ? hit->hit.error : -hit->hit.error;
    return view_add(hit->position, view_scale(hit->ng, side));
}

/* Whether p (world) is inside the bounds of a box, where its light isn't defined. */
bool view_box_inside(const view_box *box, lmg_vec3 p);

/* The cell of the box in which light travels through point in direction (both in the luminaire's frame, direction of travel): 64
 * coins that belong to the cell; index tells boxes apart.  *error: the standard error of its luminance, scale included. */
uint64_t view_box_cell(const view_box *box, uint32_t index, lmg_vec3 point, lmg_vec3 direction, double *error);

/* Where the ray meets box b's bounds from outside; false if it misses or starts inside. */
bool view_box_enter(const view_scene *scene, uint32_t b, lmg_vec3 origin, lmg_vec3 direction, double *t);

/* The probability with which light i is chosen at point p is view_light_weights()[i] / sum.  weights: light_count numbers. */
double view_light_weights(const view_scene *scene, lmg_vec3 p, double *weights);

/* Bounds of all triangles of the room, world frame; false when it has none. */
bool view_scene_bounds(const view_scene *scene, lmg_vec3 *lower, lmg_vec3 *upper);

#endif
