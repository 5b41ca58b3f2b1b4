/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The scene: loading, placing, and rays against everything.  Each model keeps its own Embree scene; a ray asks the room and then
 * those lamps whose bounds it meets before the nearest hit so far.
 */
#include "view_scene.h"

#include <luminaires/rng.h>

#include <float.h>
#include <stdlib.h>
#include <string.h>

/* ------------------------------------------------------------------------------------------------------------ building */

static void object_release(view_object *object)
{
    lum_emitters_destroy(object->emitters);
    lum_wave_tables_destroy(object->waves);
    free(object->media);
    lum_scene_destroy(object->scene);
    lum_model_destroy(object->model);
}

/* Illuminance of all directional lights together, lx; their flux has no meaning. */
static double directional_illuminance(const lum_model *model)
{
    double sum = 0;
    for (uint32_t i = 0; i < model->light_count; i++) {
        if (model->lights[i].kind == LUM_LIGHT_DIRECTIONAL) {
            sum += fmax(lmg_luminance(model->lights[i].intensity), 0);
        }
    }
    return sum;
}

static lmg_result prepare_media(view_object *object, lmg_error *err)
{
    const lum_model *model = object->model;
    object->media = calloc((size_t)model->material_count, sizeof *object->media);
    if (!object->media) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: out of memory", model->path);
    }
    for (uint32_t i = 0; i < model->material_count; i++) {
        const lum_material *m = &model->materials[i];
        if (m->spectral.fills) {
            return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                            "%s: material \"%.60s\" is filled with phosphor, which lumiview doesn't follow; bake the lamp and light the scene with "
                            "its box",
                            model->path, m->name);
        }
        object->media[i] = (view_medium){.material = m, .index = (int32_t)i};
        lum_medium_set(&object->media[i].inside, m->scattering, m->absorption, m->anisotropy);
        object->media[i].scatters = object->media[i].inside.scatters || m->spectral.scattering;
    }
    return LMG_OK;
}

/* Whether a surface sends light in one direction only: what a punctual light sends that way meets no path from the eye. */
static bool is_specular(const lum_material *m)
{
    bool smooth = m->roughness * m->roughness < LUM_SMOOTH;
    return smooth && (m->kind == LUM_SURFACE_CONDUCTOR || (m->kind == LUM_SURFACE_PBR && (m->transmission > 0 || m->metallic > 0)));
}

static const char *unseen_light(const lum_model *model)
{
    for (uint32_t i = 0; i < model->material_count && model->light_count; i++) {
        if (is_specular(&model->materials[i])) {
            return model->lights[0].name;
        }
    }
    return NULL;
}

/* Fills an object from a file; on failure nothing is left over. */
static lmg_result object_load(const char *path, const lum_recipe *recipe, view_object *out, lmg_error *err)
{
    *out = (view_object){.scale = 1};
    lmg_result r = lum_model_load(path, recipe, &out->model, err);
    if (r != LMG_OK) {
        return r;
    }
    const lum_model *model = out->model;
    r = prepare_media(out, err);
    if (r == LMG_OK && model->triangle_count) {
        r = lum_scene_create(model, &out->scene, err);
    }
    if (r == LMG_OK) {
        r = lum_emitters_create(model, &out->emitters, err);
    }
    if (r != LMG_OK) {
        object_release(out);
        return r;
    }
    out->unseen = unseen_light(model);
    double rgb[3];
    out->flux = lum_emitters_flux(out->emitters, rgb);
    if (!(out->flux > 0)) {
        out->flux = 0;
        if (!(directional_illuminance(model) > 0)) {
            lum_emitters_destroy(out->emitters);
            out->emitters = NULL;
        }
    }
    for (uint32_t i = 0; i < model->material_count; i++) {
        out->has_alpha = out->has_alpha || model->materials[i].alpha_mode != LUM_ALPHA_OPAQUE;
    }
    return LMG_OK;
}

lmg_result view_scene_create(const char *room_path, const lum_recipe *recipe, view_scene **out, lmg_error *err)
{
    *out = NULL;
    view_scene *scene = calloc(1, sizeof *scene);
    view_object *objects = calloc(1, sizeof *objects);
    if (!scene || !objects) {
        free(scene);
        free(objects);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: out of memory", room_path);
    }
    lmg_result r = object_load(room_path, recipe, &objects[0], err);
    if (r != LMG_OK) {
        free(scene);
        free(objects);
        return r;
    }
    objects[0].motion = (view_motion){.r = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, .identity = true};
    scene->objects = objects;
    scene->object_count = 1;
    scene->origin = objects[0].model->centre;
    *out = scene;
    return LMG_OK;
}

void view_scene_destroy(view_scene *scene)
{
    if (!scene) {
        return;
    }
    for (uint32_t i = 0; i < scene->object_count; i++) {
        object_release(&scene->objects[i]);
    }
    lum_volumes_destroy(scene->volumes);
    for (uint32_t i = 0; i < scene->box_count; i++) {
        lmg_field_destroy(scene->boxes[i].field);
    }
    free(scene->objects);
    free(scene->boxes);
    free(scene->lights);
    free(scene);
}

static lmg_result add_box(view_scene *scene, lmg_field *field, const char *path, const view_placement *placement, double flux,
                          lmg_error *err)
{
    const lmg_layout *layout = lmg_field_layout(field);
    double stored = 0;
    for (uint32_t i = 0; i < layout->slab_count; i++) {
        stored += lmg_field_slab_flux(field, i, NULL);
    }
    if (!(stored > 0)) {
        lmg_field_destroy(field);
        return lmg_fail(err, LMG_ERROR_INPUT, "%s: the box holds no light", path);
    }
    view_box *grown = realloc(scene->boxes, (scene->box_count + 1) * sizeof *grown);
    if (!grown) {
        lmg_field_destroy(field);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: out of memory", path);
    }
    scene->boxes = grown;
    view_box *box = &grown[scene->box_count++];
    double emitted = lmg_field_ledger(field).emitted;
    *box = (view_box){.field = field, .scale = flux > 0 ? flux / (emitted > 0 ? emitted : stored) : 1};
    box->flux = stored * box->scale;
    view_placement_motion(placement, &box->motion);
    box->motion.t = view_sub(placement->position, scene->origin);
    lmg_vec3 half = view_scale(view_sub(layout->bounds_max, layout->bounds_min), 0.5);
    box->centre = view_point_out(&box->motion, view_add(layout->bounds_min, half));
    box->radius2 = view_dot(half, half);
    strncpy(box->path, path, sizeof box->path - 1);
    return LMG_OK;
}

lmg_result view_scene_adopt_box(view_scene *scene, lmg_field *field, const view_placement *placement, double flux, lmg_error *err)
{
    return add_box(scene, field, "box in memory", placement, flux, err);
}

lmg_result view_scene_add_box(view_scene *scene, const char *path, const view_placement *placement, double flux, lmg_error *err)
{
    lmg_field *field = NULL;
    lmg_result r = lmg_field_read(path, &field, err);
    return r == LMG_OK ? add_box(scene, field, path, placement, flux, err) : r;
}

lmg_result view_scene_add_lamp(view_scene *scene, const char *path, const lum_recipe *recipe, const view_placement *placement,
                               double flux, lmg_error *err)
{
    view_object object;
    lmg_result r = object_load(path, recipe, &object, err);
    if (r != LMG_OK) {
        return r;
    }
    if (!(object.flux > 0)) {
        object_release(&object);
        return lmg_fail(err, LMG_ERROR_INPUT,
                        "%s: nothing in this lamp emits light; a recipe entry such as \"emitter:NAME=800lm\" says what shines",
                        path);
    }
    view_object *grown = realloc(scene->objects, (scene->object_count + 1) * sizeof *grown);
    if (!grown) {
        object_release(&object);
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: out of memory", path);
    }
    scene->objects = grown;
    object.lamp = true;
    double wanted = flux > 0 ? flux : object.model->rated_flux;
    if (wanted > 0) {
        object.scale = wanted / object.flux;
        object.flux = wanted;
    }
    view_placement_motion(placement, &object.motion);
    /* The model's coordinates are relative to its centre, the placement is of its file's origin. */
    object.motion.t =
        view_add(view_direction_out(&object.motion, object.model->centre), view_sub(placement->position, scene->origin));
    grown[scene->object_count++] = object;
    return LMG_OK;
}

/* Concentration from which on every path connects. */
static const double CONNECT_ALWAYS = 100;

static double room_area(const lum_model *model)
{
    double area = 0;
    for (uint32_t i = 0; i < model->part_count; i++) {
        area += model->parts[i].area;
    }
    return area;
}

static void measure_concentration(view_scene *scene)
{
    enum { RAYS = 64 };
    double area = room_area(scene->objects[0].model), concentration = 0;
    scene->boxes_flux = 0;
    scene->connect = 0;
    for (uint32_t i = 0; i < scene->box_count; i++) {
        scene->boxes_flux += scene->boxes[i].flux;
    }
    for (uint32_t i = 0; i < scene->box_count; i++) {
        const view_box *box = &scene->boxes[i];
        double sum = 0;
        for (uint32_t k = 0; k < RAYS; k++) {
            lum_rng rng = lum_rng_stream(i, k);
            double xi[5], e[3];
            for (int j = 0; j < 5; j++) {
                xi[j] = lum_rng_next(&rng);
            }
            lmg_ray ray;
            view_hit hit;
            if (!lmg_field_emit(box->field, xi, &ray)) {
                continue;
            }
            lmg_vec3 d = view_direction_out(&box->motion, ray.direction);
            if (!view_scene_intersect(scene, view_point_out(&box->motion, ray.origin), d, &hit)) {
                continue;
            }
            lmg_vec3 n = view_dot(hit.ng, d) < 0 ? hit.ng : view_minus(hit.ng);
            if (lmg_field_illuminance(box->field, view_point_in(&box->motion, hit.position), view_direction_in(&box->motion, n), e,
                                      NULL, NULL) == LMG_OK) {
                sum += (0.2126 * e[0] + 0.7152 * e[1] + 0.0722 * e[2]) * box->scale / RAYS;
            }
        }
        concentration += sum * area / scene->boxes_flux * (box->flux / scene->boxes_flux);
    }
    double share = concentration / CONNECT_ALWAYS;
    scene->connect = share < 0.1 ? 0 : fmin(share, 1);
}

/* A volume of an object in the world's frame. */
static lum_volume volume_in_world(const lum_volume *volume, const view_motion *motion)
{
    lum_volume out = *volume;
    for (int i = 0; i < 3 && !motion->identity; i++) {
        const double *m = volume->to_index[i], t[3] = {motion->t.x, motion->t.y, motion->t.z};
        out.to_index[i][3] = m[3];
        for (int k = 0; k < 3; k++) {
            /* m times the inverse of the motion's rotation, which is its transpose */
            out.to_index[i][k] = m[0] * motion->r[k][0] + m[1] * motion->r[k][1] + m[2] * motion->r[k][2];
            out.to_index[i][3] -= out.to_index[i][k] * t[k];
        }
    }
    return out;
}

static lmg_result join_volumes(view_scene *scene, lmg_error *err)
{
    lum_volumes_destroy(scene->volumes);
    scene->volumes = NULL;
    lum_model all = {.path = "the scene", .unit = 1};
    for (uint32_t i = 0; i < scene->object_count; i++) {
        all.volume_count += scene->objects[i].model->volume_count;
    }
    all.volumes = calloc((size_t)all.volume_count + 1, sizeof *all.volumes);
    if (!all.volumes) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for the scene's volumes");
    }
    uint32_t count = 0;
    for (uint32_t i = 0; i < scene->object_count; i++) {
        const view_object *object = &scene->objects[i];
        for (uint32_t k = 0; k < object->model->volume_count; k++) {
            all.volumes[count++] = volume_in_world(&object->model->volumes[k], &object->motion);
        }
    }
    lmg_result r = lum_volumes_create(&all, &scene->volumes, err);
    free(all.volumes);
    return r;
}

static bool has_phosphor(const lum_model *model)
{
    for (uint32_t i = 0; i < model->material_count; i++) {
        if (model->materials[i].spectral.converted) {
            return true;
        }
    }
    return false;
}

/* Light by wavelength, where an object calls for it.  Paths draw from the tables of one that does: of a phosphor's if there is one,
 * whose wavelengths excite it. */
static lmg_result prepare_waves(view_scene *scene, lmg_error *err)
{
    const view_object *first = NULL;
    scene->waves = NULL;
    for (uint32_t i = 0; i < scene->object_count; i++) {
        const view_object *object = &scene->objects[i];
        if (lum_model_is_spectral(object->model) && (!first || (has_phosphor(object->model) && !has_phosphor(first->model)))) {
            first = object;
        }
    }
    for (uint32_t i = 0; i < scene->object_count && first; i++) {
        view_object *object = &scene->objects[i];
        lum_wave_tables_destroy(object->waves);
        lmg_result r = lum_wave_tables_create(object->model, &object->waves, err);
        if (r != LMG_OK) {
            return r;
        }
        for (uint32_t k = 0; k < object->model->material_count; k++) {
            object->media[k].tables = object->waves;
        }
    }
    scene->waves = first ? first->waves : NULL;
    return LMG_OK;
}

lmg_result view_scene_finish(view_scene *scene, lmg_error *err)
{
    lmg_result r = join_volumes(scene, err);
    if (r == LMG_OK) {
        r = prepare_waves(scene, err);
    }
    if (r != LMG_OK) {
        return r;
    }
    free(scene->lights);
    scene->light_count = 0;
    scene->lights = calloc((size_t)scene->box_count + scene->object_count, sizeof *scene->lights);
    if (!scene->lights) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for the list of lights");
    }
    for (uint32_t i = 0; i < scene->box_count; i++) {
        const view_box *box = &scene->boxes[i];
        scene->lights[scene->light_count++] = (view_light){.kind = VIEW_LIGHT_BOX,
                                                           .index = i,
                                                           .strength = box->flux / (4 * VIEW_PI),
                                                           .centre = box->centre,
                                                           .radius2 = box->radius2};
    }
    for (uint32_t i = 0; i < scene->object_count; i++) {
        const view_object *object = &scene->objects[i];
        const lum_model *model = object->model;
        if (!object->emitters) {
            continue;
        }
        lmg_vec3 half = view_scale(view_sub(model->bounds_max, model->bounds_min), 0.5);
        lmg_vec3 middle = view_add(model->bounds_min, half);
        scene->lights[scene->light_count++] = (view_light){.kind = VIEW_LIGHT_EMITTERS,
                                                           .index = i,
                                                           .strength = object->flux / (4 * VIEW_PI),
                                                           .everywhere = directional_illuminance(model) * object->scale,
                                                           .centre = view_point_out(&object->motion, middle),
                                                           .radius2 = view_dot(half, half)};
    }
    measure_concentration(scene);
    return LMG_OK;
}

double view_light_weights(const view_scene *scene, lmg_vec3 p, double *weights)
{
    /* The estimate knows nothing of a light's distribution, so a share of a tenth is dealt out evenly: no light that matters is
     * starved. */
    double sum = 0;
    for (uint32_t i = 0; i < scene->light_count; i++) {
        const view_light *light = &scene->lights[i];
        lmg_vec3 v = view_sub(light->centre, p);
        weights[i] = light->strength / fmax(fmax(view_dot(v, v), light->radius2), DBL_MIN) + light->everywhere;
        sum += weights[i];
    }
    double even = 0.1 / 0.9 * sum / scene->light_count;
    for (uint32_t i = 0; i < scene->light_count; i++) {
        weights[i] += even;
    }
    return sum / 0.9;
}

/* ---------------------------------------------------------------------------------------------------------------- rays */

/* Whether origin + t direction, 0 <= t < limit, meets the bounds, widened by the rounding that float geometry may have. */
static bool meets_bounds(const lum_model *model, lmg_vec3 origin, lmg_vec3 direction, double limit)
{
    const double o[3] = {origin.x, origin.y, origin.z};
    const double d[3] = {direction.x, direction.y, direction.z};
    const double lower[3] = {model->bounds_min.x, model->bounds_min.y, model->bounds_min.z};
    const double upper[3] = {model->bounds_max.x, model->bounds_max.y, model->bounds_max.z};
    double near = 0, far = limit;
    for (int i = 0; i < 3; i++) {
        double slack = 4 * (double)FLT_EPSILON * (fabs(lower[i]) + fabs(upper[i]) + (upper[i] - lower[i]));
        double a = lower[i] - slack - o[i], b = upper[i] + slack - o[i];
        if (d[i] == 0) {
            if (a > 0 || b < 0) {
                return false;
            }
            continue;
        }
        double t0 = a / d[i], t1 = b / d[i];
        near = fmax(near, fmin(t0, t1));
        far = fmin(far, fmax(t0, t1));
    }
    return near <= far;
}

bool view_scene_intersect(const view_scene *scene, lmg_vec3 origin, lmg_vec3 direction, view_hit *out)
{
    double nearest = (double)INFINITY;
    for (uint32_t i = 0; i < scene->object_count; i++) {
        const view_object *object = &scene->objects[i];
        if (!object->scene) {
            continue;
        }
        lmg_vec3 o = view_point_in(&object->motion, origin);
        lmg_vec3 d = view_direction_in(&object->motion, direction);
        lum_hit hit;
        if (i > 0 && !meets_bounds(object->model, o, d, nearest)) {
            continue;
        }
        if (lum_scene_intersect(object->scene, o, d, &hit) && hit.t < nearest) {
            nearest = hit.t;
            out->hit = hit;
            out->object = i;
        }
    }
    if (nearest == (double)INFINITY) {
        return false;
    }
    const view_motion *motion = &scene->objects[out->object].motion;
    out->position = view_point_out(motion, out->hit.position);
    out->ng = view_direction_out(motion, out->hit.ng);
    return true;
}

/* Surfaces that a straight ray may pass by chance (alpha coverage) before it is given up as stopped: guards against loops of
 * rounding. */
enum { MAX_PASSES = 1000 };

static bool occluded_by(const view_object *object, lmg_vec3 o, lmg_vec3 d, double distance, double (*next)(void *state),
                        void *state)
{
    if (!object->has_alpha) {
        return lum_scene_occluded(object->scene, o, d, distance);
    }
    for (int pass = 0; pass < MAX_PASSES; pass++) {
        lum_hit hit;
        if (!lum_scene_intersect(object->scene, o, d, &hit) || hit.t >= distance) {
            return false;
        }
        const lum_material *material = &object->model->materials[object->model->triangle_material[hit.triangle]];
        if (material->alpha_mode == LUM_ALPHA_OPAQUE) {
            return true;
        }
        lum_surface surface;
        lum_surface_at(object->scene, &hit, d, &surface);
        if (surface.coverage >= 1 || next(state) < (double)surface.coverage) {
            return true;
        }
        lmg_vec3 from = lum_offset(&hit, d);
        distance -= view_dot(view_sub(from, o), d);
        o = from;
    }
    return true;
}

/*
 * How far short of a light a shadow ray ends, relative to the coordinates involved, those of the object's own frame: the shadow ray and
 * the light's own triangle are each rounded to float, and Embree's distance is good to a few dozen roundings of such numbers; 64
 * roundings (2^-24 each) cover both.
 */
static const double SHADOW_ROUNDING = 0x1p-18;

bool view_scene_occluded(const view_scene *scene, lmg_vec3 origin, lmg_vec3 direction, double distance, double (*next)(void *state),
                         void *state)
{
    for (uint32_t i = 0; i < scene->object_count; i++) {
        const view_object *object = &scene->objects[i];
        if (!object->scene) {
            continue;
        }
        lmg_vec3 o = view_point_in(&object->motion, origin);
        lmg_vec3 d = view_direction_in(&object->motion, direction);
        const double reach =
            isfinite(distance) ? distance - SHADOW_ROUNDING * (fabs(o.x) + fabs(o.y) + fabs(o.z) + distance) : distance;
        if (!(reach > 0) || (i > 0 && !meets_bounds(object->model, o, d, reach))) {
            continue;
        }
        if (occluded_by(object, o, d, reach, next, state)) {
            return true;
        }
    }
    return false;
}

static bool inside_bounds(const lmg_layout *layout, lmg_vec3 own)
{
    return own.x >= layout->bounds_min.x && own.x <= layout->bounds_max.x && own.y >= layout->bounds_min.y &&
           own.y <= layout->bounds_max.y && own.z >= layout->bounds_min.z && own.z <= layout->bounds_max.z;
}

bool view_box_inside(const view_box *box, lmg_vec3 p)
{
    return inside_bounds(lmg_field_layout(box->field), view_point_in(&box->motion, p));
}

uint64_t view_box_cell(const view_box *box, uint32_t index, lmg_vec3 point, lmg_vec3 direction, double *error)
{
    const lmg_layout *layout = lmg_field_layout(box->field);
    float rgb[3], se;
    lmg_field_radiance(box->field, point, direction, LMG_NEAREST, rgb, &se);
    *error = (double)se * box->scale;
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        const lmg_slab *slab = &layout->slabs[j];
        const double low[4] = {slab->u0, slab->v0, slab->s0, slab->t0}, high[4] = {slab->u1, slab->v1, slab->s1, slab->t1};
        const uint32_t n[4] = {slab->nu, slab->nv, slab->ns, slab->nt};
        double at[4];
        if (!lmg_slab_coordinates(slab, point, direction, at)) {
            continue;
        }
        uint64_t cell = (uint64_t)index << 32 | j;
        for (int k = 0; k < 4; k++) {
            double i = floor((at[k] - low[k]) / (high[k] - low[k]) * n[k]);
            cell = lum_mix64(cell) + (uint64_t)fmin(fmax(i, 0), n[k] - 1.0);
        }
        return lum_mix64(cell);
    }
    return 0;
}

bool view_box_enter(const view_scene *scene, uint32_t b, lmg_vec3 origin, lmg_vec3 direction, double *t)
{
    const view_box *box = &scene->boxes[b];
    lmg_vec3 own = view_point_in(&box->motion, origin);
    return !inside_bounds(lmg_field_layout(box->field), own) &&
           lmg_field_enter(box->field, own, view_direction_in(&box->motion, direction), t);
}

bool view_scene_bounds(const view_scene *scene, lmg_vec3 *lower, lmg_vec3 *upper)
{
    const lum_model *model = scene->objects[0].model;
    *lower = model->bounds_min;
    *upper = model->bounds_max;
    return model->triangle_count > 0;
}
