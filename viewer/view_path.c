/* SPDX-License-Identifier: Apache-2.0 */
/* The path tracer proper; see view_path.h for what it computes and why. */
#include "view_path.h"

#include <string.h>

/* Nested solids that a path may be inside of at once. */
enum { MAX_MEDIA = 8 };

/* From this many scatterings on, Russian roulette may end a path, with a probability that depends on what it still carries. */
enum { ROULETTE_FROM = 4 };
/* From here on even a path that loses nothing ends at last (light guides need hundreds of bounces; a closed mirror room has no
 * end). */
enum { ENDLESS_FROM = 512 };
#define ENDLESS_SURVIVAL 0.99

/* Surfaces that let a ray pass by chance (alpha coverage) before the path is given up. */
enum { MAX_PASSES = 1000 };

typedef struct medium_stack {
    const lum_material *inside[MAX_MEDIA];
    int depth;
} medium_stack;

static double index_of(const medium_stack *stack)
{
    return stack->depth ? (double)stack->inside[stack->depth - 1]->ior : 1.0;
}

/* Whether a boundary lies inside of a solid of higher priority, where light doesn't notice it. */
static bool is_hidden(const medium_stack *stack, const lum_material *material)
{
    return stack->depth > 0 && stack->inside[stack->depth - 1]->priority > material->priority;
}

/* The stack after the boundary of a solid has been crossed, inwards or outwards. */
static medium_stack cross_boundary(medium_stack stack, const lum_material *material, bool inwards)
{
    if (inwards) {
        if (stack.depth < MAX_MEDIA) {
            int at = stack.depth++;
            for (; at > 0 && stack.inside[at - 1]->priority > material->priority; at--) {
                stack.inside[at] = stack.inside[at - 1];
            }
            stack.inside[at] = material;
        }
        return stack;
    }
    for (int i = stack.depth - 1; i >= 0; i--) {
        if (stack.inside[i] == material) {
            memmove(&stack.inside[i], &stack.inside[i + 1], (size_t)(stack.depth - 1 - i) * sizeof stack.inside[0]);
            stack.depth--;
            break;
        }
    }
    return stack;
}

/* Transmittance (Beer-Lambert) of what the path is inside of, over a distance. */
static void attenuate(const medium_stack *stack, double distance, double rgb[3])
{
    if (!stack->depth) {
        return;
    }
    const float *absorption = stack->inside[stack->depth - 1]->absorption;
    for (int c = 0; c < 3; c++) {
        if (absorption[c] > 0) {
            rgb[c] *= exp(-(double)absorption[c] * distance);
        }
    }
}

static double next_number(void *state)
{
    return lum_rng_next(state);
}

/* A surface point on the way, seen from the direction the path came from. */
typedef struct vertex {
    const view_scene *scene;
    view_hit hit;
    const view_object *object;
    lum_surface surface;
    lmg_vec3 v;         /* towards where the path came from, in the model's frame */
    double eta_outside; /* index on the front side */
    bool front;         /* the path came from the front side */
    bool smoothed;      /* surface.ng is the shading normal: room only */
} vertex;

static bool solid_boundary(const lum_material *material)
{
    return material->kind == LUM_SURFACE_PBR && !material->thin &&
           (material->transmission > 0 || material->diffuse_transmission > 0);
}

/* Whether w is on the same side of the true surface and of the one that shades. */
static bool same_side(const vertex *x, lmg_vec3 w)
{
    return !x->smoothed || view_dot(x->hit.hit.ng, w) * view_dot(x->surface.ng, w) > 0;
}

/* The light that comes from w (model frame) and goes on towards v, per unit of radiance and steradian of w: p, times the cosine
 * ratio of the adjoint where that applies. */
static void reflect_towards_eye(const vertex *x, lmg_vec3 w, float f[3])
{
    if (!x->object->lamp) {
        if (!same_side(x, w)) {
            f[0] = f[1] = f[2] = 0;
            return;
        }
        lum_scatter_eval(&x->surface, x->v, w, (float)x->eta_outside, f);
        return;
    }
    lum_surface lit;
    lum_surface_at(x->object->scene, &x->hit.hit, view_minus(w), &lit);
    lum_scatter_eval(&lit, w, x->v, (float)x->eta_outside, f);
    double cos_v = fabs(view_dot(x->hit.hit.ng, x->v));
    float ratio = cos_v > 0 ? (float)(fabs(view_dot(x->hit.hit.ng, w)) / cos_v) : 0.0f;
    for (int c = 0; c < 3; c++) {
        f[c] *= ratio;
    }
}

/*
 * Turns the weight of a scattering sampled as if the path were a photon into that of radiance travelling backwards (lamps only):
 * the photon's density the other way over its density this way, times the adjoint's ratio of cosines.  With flat shading that is 1
 * by reciprocity, and (n_v / n_w)^2 across a boundary.  False when no light can come that way. *eta_scale: accumulated change of
 * radiance by refraction, which roulette must not mistake for loss.
 */
static bool adjoint_weight(const vertex *x, lum_scattered *s, double *eta_scale)
{
    double factor = 1;
    if (s->event & LUM_BOUNDARY) {
        double behind = (double)x->surface.material->ior;
        double n_v = x->front ? x->eta_outside : behind, n_w = x->front ? behind : x->eta_outside;
        factor = (n_v * n_v) / (n_w * n_w);
        *eta_scale *= factor;
    }
    if (x->surface.tilted) {
        const lmg_vec3 ng = x->hit.hit.ng, ns = x->surface.ns;
        double cos_v = fabs(view_dot(ng, x->v)), cos_w = fabs(view_dot(ng, s->wo));
        if (cos_v == 0) {
            return false;
        }
        if (s->event & LUM_DELTA) {
            /* A delta lobe maps solid angles by dwi/dwo = (n_o^2 cos_s o) / (n_i^2 cos_s i), cos_s against the shading normal;
             * mirrors and thin walls keep cos_s. */
            factor *= cos_w / cos_v;
            if (s->event & LUM_BOUNDARY) {
                double shade_v = fabs(view_dot(ns, x->v)), shade_w = fabs(view_dot(ns, s->wo));
                factor = shade_w > 0 ? factor * shade_v / shade_w : 0;
            }
        } else {
            float this_way[3], back[3];
            lum_scatter_eval(&x->surface, x->v, s->wo, (float)x->eta_outside, this_way);
            reflect_towards_eye(x, s->wo, back);
            for (int c = 0; c < 3; c++) {
                s->weight[c] = this_way[c] > 0 ? s->weight[c] * (back[c] / this_way[c]) : 0.0f;
            }
            return true;
        }
    }
    for (int c = 0; c < 3; c++) {
        s->weight[c] *= (float)factor;
    }
    return factor > 0;
}

/* Weight by the power heuristic of an estimate with density mine against two others. */
static double power_heuristic(double mine, double other, double third)
{
    if (!(mine > 0)) {
        return 0;
    }
    double a = other / mine, b = third / mine;
    return 1 / (1 + a * a + b * b);
}

static bool any_light(const float rgb[3])
{
    return rgb[0] != 0 || rgb[1] != 0 || rgb[2] != 0;
}

static void add_light(double sum[3], const double beta[3], const double attenuation[3], const float light[3], double factor)
{
    for (int c = 0; c < 3; c++) {
        sum[c] += beta[c] * attenuation[c] * (double)light[c] * factor;
    }
}

/* A sample of one light as seen from a point, in the world frame. */
static bool sample_light(const view_scene *scene, const view_light *light, lmg_vec3 p, const double xi[3], lum_light_sample *out)
{
    if (light->kind == VIEW_LIGHT_EMITTERS) {
        const view_object *object = &scene->objects[light->index];
        if (!lum_emitters_sample_point(object->emitters, view_point_in(&object->motion, p), xi, out)) {
            return false;
        }
        out->direction = view_direction_out(&object->motion, out->direction);
        for (int c = 0; c < 3; c++) {
            out->radiance[c] *= (float)object->scale;
        }
        return out->pdf > 0;
    }
    const view_box *box = &scene->boxes[light->index];
    lmg_vec3 own = view_point_in(&box->motion, p);
    lmg_point_sample sample;
    if (view_box_inside(box, p) || !lmg_field_sample_point(box->field, own, xi, &sample)) {
        return false;
    }
    *out = (lum_light_sample){
        .direction = view_direction_out(&box->motion, sample.direction), .distance = sample.distance, .pdf = sample.pdf};
    for (int c = 0; c < 3; c++) {
        out->radiance[c] = sample.radiance[c] * (float)box->scale;
    }
    return sample.pdf > 0;
}

/*
 * How far short of a light a shadow ray ends, relative to the coordinates involved: the shadow ray and the light's own triangle are
 * each rounded to float, and Embree's distance is good to a few dozen roundings of such numbers; 64 roundings (2^-24 each) cover
 * both. What hides a light within that distance of it, micrometres in a room, isn't seen.
 */
static const double SHADOW_ROUNDING = 0x1p-18;

/* Whether nothing stands between a surface and a light sampled from it.  The ray starts off the surface and still ends at the
 * light. */
static bool light_arrives(const view_scene *scene, const view_hit *hit, const lum_light_sample *sample, lum_rng *rng)
{
    lmg_vec3 start = view_leave(hit, sample->direction), direction = sample->direction;
    double distance = sample->distance;
    if (distance < (double)INFINITY) {
        lmg_vec3 way = view_sub(view_add(hit->position, view_scale(direction, distance)), start);
        double length = view_length(way);
        distance = length - SHADOW_ROUNDING * (fabs(start.x) + fabs(start.y) + fabs(start.z) + length);
        if (!(distance > 0)) {
            return true;
        }
        direction = view_scale(way, 1 / length);
    }
    return !view_scene_occluded(scene, start, direction, distance, next_number, rng);
}

/* How the ray under way began. */
typedef struct departure {
    lmg_vec3 point; /* world */
    bool direct;    /* from the eye or a delta lobe: no other estimate finds the light that it meets */
    double pdf;     /* else the density of its direction */
    double total;   /* sum of worker->weights, made at point; 0 when no light was chosen there */
    double connect; /* density of a path from the boxes that comes along this ray, per luminance of the box; 0 when there is none */
} departure;

/*
 * A path eye ... p x light, with p and x surfaces, can be made by choosing a light at x, by scattering at x, or by a path from a
 * box.  In terms of the direction at x towards the light, and over the density with which scattering at p finds x, the third has
 * the density connect luminance |cos| / flux  /  (pdf_p cos_x / d^2) with cos against x's normal of the direction to the box.  This
 * gives all but luminance and |cos|; 0 when paths from boxes can't make it: p is the eye or mirrors, or the way from p to x is
 * inside a solid.
 */
static double connect_factor(const view_scene *scene, double connect, const departure *from, const vertex *x, double distance,
                             const medium_stack *media)
{
    if (!(connect > 0) || from->direct || media->depth || !(from->pdf > 0)) {
        return 0;
    }
    double arrival = from->pdf * fabs(view_dot(x->hit.hit.ng, x->v));
    return arrival > 0 ? connect / scene->boxes_flux * distance * distance / arrival : 0;
}

/* |cos| of that direction, w (model frame); 0 where light from outside can't come from, through the boundary of a solid. */
static double connect_cosine(const vertex *x, lmg_vec3 w)
{
    double cosine = view_dot(x->hit.hit.ng, w);
    return (cosine >= 0) != x->front && solid_boundary(x->surface.material) ? 0 : fabs(cosine);
}

/* Direct light at x from one light chosen by chance.  worker->weights hold the lights' weights at x, which sum to total;
 * factor: connect_factor. */
static void direct_light(const view_scene *scene, const view_path_options *options, const vertex *x, const medium_stack *media,
                         double total, double factor, const double beta[3], lum_rng *rng, view_worker *worker, double sum[3])
{
    double pick = lum_rng_next(rng) * total;
    uint32_t chosen = 0;
    while (chosen + 1 < scene->light_count && pick >= worker->weights[chosen]) {
        pick -= worker->weights[chosen++];
    }
    const double xi[3] = {lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng)};
    lum_light_sample sample;
    if (!sample_light(scene, &scene->lights[chosen], x->hit.position, xi, &sample)) {
        return;
    }
    lmg_vec3 w = view_direction_in(&x->object->motion, sample.direction);
    float f[3];
    reflect_towards_eye(x, w, f);
    if (!any_light(f)) {
        return;
    }
    double pdf = sample.pdf * (worker->weights[chosen] / total);
    double weight = 1;
    if (!sample.delta && options->strategy == VIEW_MIS) {
        double connected = 0;
        if (factor > 0 && scene->lights[chosen].kind == VIEW_LIGHT_BOX) {
            connected = factor * fabs(lmg_luminance(sample.radiance)) * connect_cosine(x, w);
        }
        weight = power_heuristic(pdf, lum_scatter_pdf(&x->surface, x->v, w, (float)x->eta_outside), connected);
    }
    worker->rays++;
    if (!light_arrives(scene, &x->hit, &sample, rng)) {
        return;
    }
    double attenuation[3] = {1, 1, 1};
    bool front = view_dot(x->hit.hit.ng, w) >= 0;
    if (front != x->front && solid_boundary(x->surface.material)) {
        medium_stack beyond = cross_boundary(*media, x->surface.material, x->front);
        attenuate(&beyond, sample.distance, attenuation);
    } else {
        attenuate(media, sample.distance, attenuation);
    }
    float light[3] = {sample.radiance[0] * f[0], sample.radiance[1] * f[1], sample.radiance[2] * f[2]};
    add_light(sum, beta, attenuation, light, weight / pdf);
}

/* What the light that the ray meets counts, when choosing a light and a path from a box would have had the given densities. */
static double scattering_weight(const view_path_options *options, const departure *from, double light_density, double connected)
{
    if (from->direct || options->strategy == VIEW_SCATTERING_ONLY) {
        return 1;
    }
    return options->strategy == VIEW_LIGHTS_ONLY ? 0 : power_heuristic(from->pdf, light_density, connected);
}

/* The probability with which this light is chosen where the lights have these weights. */
static double light_share(const view_scene *scene, const double *weights, double total, view_light_kind kind, uint32_t index)
{
    for (uint32_t i = 0; i < scene->light_count && total > 0; i++) {
        if (scene->lights[i].kind == kind && scene->lights[i].index == index) {
            return weights[i] / total;
        }
    }
    return 0;
}

/* Light of all boxes that the ray meets before distance. */
static void add_boxes(const view_scene *scene, const view_path_options *options, const departure *from, lmg_vec3 d, double distance,
                      const medium_stack *media, const double beta[3], const view_worker *worker, double sum[3])
{
    if (!from->direct && options->strategy == VIEW_LIGHTS_ONLY) {
        return;
    }
    for (uint32_t i = 0; i < scene->box_count; i++) {
        double t;
        if (!view_box_enter(scene, i, from->point, d, &t) || t >= distance) {
            continue;
        }
        const view_box *box = &scene->boxes[i];
        lmg_vec3 own_p = view_point_in(&box->motion, from->point), own_d = view_direction_in(&box->motion, d);
        float rgb[3];
        lmg_field_radiance(box->field, own_p, view_minus(own_d), from->direct ? LMG_LINEAR : LMG_NEAREST, rgb, NULL);
        if (!any_light(rgb)) {
            continue;
        }
        double density = 0, connected = 0;
        if (!from->direct && options->strategy == VIEW_MIS) {
            density =
                light_share(scene, worker->weights, from->total, VIEW_LIGHT_BOX, i) * lmg_field_point_pdf(box->field, own_p, own_d);
            connected = from->connect * fabs(lmg_luminance(rgb)) * box->scale;
        }
        double attenuation[3] = {1, 1, 1};
        attenuate(media, t, attenuation);
        add_light(sum, beta, attenuation, rgb, box->scale * scattering_weight(options, from, density, connected));
    }
}

/* The emission of the surface that the ray met. */
static void add_emission(const view_scene *scene, const view_path_options *options, const departure *from, const vertex *x,
                         const double beta[3], const view_worker *worker, double sum[3])
{
    if (!any_light(x->surface.emission)) {
        return;
    }
    double density = 0;
    if (!from->direct && options->strategy == VIEW_MIS && x->object->emitters) {
        density = light_share(scene, worker->weights, from->total, VIEW_LIGHT_EMITTERS, x->hit.object) *
                  lum_emitters_point_pdf(x->object->emitters, view_point_in(&x->object->motion, from->point), &x->hit.hit);
    }
    static const double CLEAR[3] = {1, 1, 1};
    add_light(sum, beta, CLEAR, x->surface.emission, x->object->scale * scattering_weight(options, from, density, 0));
}

/* Scattering as a photon's, its polarization kept in the world frame. */
static void scatter(const vertex *x, lum_rng *rng, lum_polarization *polarization, lum_scattered *out)
{
    const view_motion *motion = &x->object->motion;
    const double xi[4] = {lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng)};
    lum_polarization own = {.known = polarization->known};
    if (own.known) {
        own.re = view_direction_in(motion, polarization->re);
        own.im = view_direction_in(motion, polarization->im);
    }
    lum_scatter_trace(&x->surface, x->v, (float)x->eta_outside, xi, &own, out);
    *polarization = (lum_polarization){.known = own.known};
    if (own.known) {
        polarization->re = view_direction_out(motion, own.re);
        polarization->im = view_direction_out(motion, own.im);
    }
}

/* The surface at x->hit as seen along d (world). */
static void see(vertex *x, lmg_vec3 d)
{
    x->object = &x->scene->objects[x->hit.object];
    lmg_vec3 own_d = view_direction_in(&x->object->motion, d);
    lum_surface_at(x->object->scene, &x->hit.hit, own_d, &x->surface);
    x->v = view_minus(own_d);
    double side = view_dot(x->hit.hit.ng, x->v);
    x->front = side >= 0;
    x->smoothed = !x->object->lamp && x->surface.tilted && side * view_dot(x->surface.ns, x->v) > 0;
    if (x->smoothed) {
        x->surface.ng = x->surface.ns;
        x->surface.tilted = false;
    }
}

/* Follows the straight ray from origin in direction d to the next surface that meets it, passing those that by chance don't.
 * *distance is counted from p, just behind which origin lies.  False when nothing is met; *distance is infinite then. */
static bool next_vertex(const view_scene *scene, lmg_vec3 p, lmg_vec3 origin, lmg_vec3 d, lum_rng *rng, view_worker *worker,
                        vertex *x, double *distance)
{
    for (int pass = 0; pass < MAX_PASSES; pass++) {
        worker->rays++;
        if (!view_scene_intersect(scene, origin, d, &x->hit)) {
            break;
        }
        x->scene = scene;
        see(x, d);
        if (x->surface.coverage >= 1 || lum_rng_next(rng) < (double)x->surface.coverage) {
            *distance = view_dot(view_sub(x->hit.position, p), d);
            return true;
        }
        origin = view_leave(&x->hit, d);
    }
    *distance = INFINITY;
    return false;
}

/* Where a ray emitted by a box meets the scene first. */
typedef struct light_vertex {
    bool valid;
    uint32_t box;
    lmg_vec3 back;   /* towards the box, world */
    vertex x;        /* as the light sees it */
    double color[3]; /* of the box's light in the ray, luminance 1 */
} light_vertex;

static void trace_from_box(const view_scene *scene, lum_rng *rng, view_worker *worker, light_vertex *out)
{
    double pick = lum_rng_next(rng) * scene->boxes_flux, xi[5];
    out->valid = false;
    out->box = 0;
    while (out->box + 1 < scene->box_count && pick >= scene->boxes[out->box].flux) {
        pick -= scene->boxes[out->box++].flux;
    }
    for (int i = 0; i < 5; i++) {
        xi[i] = lum_rng_next(rng);
    }
    const view_box *box = &scene->boxes[out->box];
    lmg_ray ray;
    if (!lmg_field_emit(box->field, xi, &ray)) {
        return;
    }
    lmg_vec3 origin = view_point_out(&box->motion, ray.origin), d = view_direction_out(&box->motion, ray.direction);
    double distance;
    out->back = view_minus(d);
    for (int c = 0; c < 3; c++) {
        out->color[c] = (double)ray.flux[c];
    }
    out->valid =
        next_vertex(scene, origin, origin, d, rng, worker, &out->x, &distance) && !view_box_inside(box, out->x.hit.position);
}

/* Light that goes from a box to the light vertex, from there to x and on towards the eye. */
static void connect_paths(const view_scene *scene, const vertex *x, const medium_stack *media, const light_vertex *light,
                          double connect, const double beta[3], lum_rng *rng, view_worker *worker, double sum[3])
{
    lmg_vec3 way = view_sub(light->x.hit.position, x->hit.position);
    double d2 = view_dot(way, way), distance = sqrt(d2);
    if (!(d2 > 0)) {
        return;
    }
    lum_light_sample towards = {.direction = view_scale(way, 1 / distance), .distance = distance};
    lmg_vec3 w = view_direction_in(&x->object->motion, towards.direction);
    float f[3];
    reflect_towards_eye(x, w, f);
    if (!any_light(f)) {
        return;
    }
    bool across = (view_dot(x->hit.hit.ng, w) >= 0) != x->front && solid_boundary(x->surface.material);
    if (across ? cross_boundary(*media, x->surface.material, x->front).depth : media->depth) {
        return;
    }
    /* The light vertex as the eye's path would see it from x. */
    vertex y = {.scene = scene, .hit = light->x.hit};
    see(&y, towards.direction);
    y.eta_outside = 1;
    lmg_vec3 back = view_direction_in(&y.object->motion, light->back);
    double cosine = connect_cosine(&y, back), arrival = fabs(view_dot(y.hit.hit.ng, y.v)) / d2;
    float g[3];
    reflect_towards_eye(&y, back, g);
    if (!(cosine > 0) || !(arrival > 0) || !any_light(g)) {
        return;
    }
    worker->rays++;
    if (!light_arrives(scene, &x->hit, &towards, rng)) {
        return;
    }
    /* The densities of the three estimates, as in connect_factor. */
    const view_box *box = &scene->boxes[light->box];
    lmg_vec3 own_y = view_point_in(&box->motion, y.hit.position), own_back = view_direction_in(&box->motion, light->back);
    float radiance[3];
    lmg_field_radiance(box->field, own_y, view_minus(own_back), LMG_NEAREST, radiance, NULL);
    double mine = connect * cosine * fabs(lmg_luminance(radiance)) * box->scale / scene->boxes_flux;
    double found = lum_scatter_pdf(&x->surface, x->v, w, (float)x->eta_outside) * arrival;
    double *weights = worker->weights + scene->light_count;
    double total = view_light_weights(scene, y.hit.position, weights);
    double chosen =
        light_share(scene, weights, total, VIEW_LIGHT_BOX, light->box) * lmg_field_point_pdf(box->field, own_y, own_back);
    double scattered = lum_scatter_pdf(&y.surface, y.v, back, (float)y.eta_outside);
    double weight = power_heuristic(mine, found * chosen, found * scattered);
    for (int c = 0; c < 3; c++) {
        sum[c] +=
            beta[c] * (double)f[c] * (double)g[c] * light->color[c] * (scene->boxes_flux * arrival * weight / (connect * cosine));
    }
}

void view_path_radiance(const view_scene *scene, const view_path_options *options, lmg_vec3 origin, lmg_vec3 direction,
                        lum_rng *rng, view_worker *worker, double rgb[3])
{
    double sum[3] = {0, 0, 0}, beta[3] = {1, 1, 1};
    double eta_scale = 1;
    departure from = {.point = origin, .direct = true};
    medium_stack media = {.depth = 0};
    lum_polarization polarization = {.known = false};
    lmg_vec3 start = origin, d = direction;
    double connect = 0;
    if (options->strategy == VIEW_MIS && scene->box_count && options->max_depth > 1 && options->connect >= 0) {
        connect = options->connect > 0 ? fmin(options->connect, 1) : scene->connect;
    }
    light_vertex light = {.valid = false};
    if (connect > 0 && (connect >= 1 || lum_rng_next(rng) < connect)) {
        trace_from_box(scene, rng, worker, &light);
    }

    for (uint32_t depth = 0;; depth++) {
        vertex x;
        double distance;
        bool met = next_vertex(scene, from.point, start, d, rng, worker, &x, &distance);
        add_boxes(scene, options, &from, d, distance, &media, beta, worker, sum);
        if (!met) {
            break;
        }
        attenuate(&media, distance, beta);
        if (solid_boundary(x.surface.material) && is_hidden(&media, x.surface.material)) {
            media = cross_boundary(media, x.surface.material, x.front);
            start = view_leave(&x.hit, d);
            depth--; /* no event: made up for by the loop's step */
            continue;
        }
        add_emission(scene, options, &from, &x, beta, worker, sum);
        const lum_surface *surface = &x.surface;
        if (depth >= options->max_depth || surface->kind == LUM_SURFACE_BLACK) {
            break;
        }
        medium_stack outside = media;
        if (!x.front && solid_boundary(surface->material)) {
            outside = cross_boundary(media, surface->material, false);
        }
        x.eta_outside = index_of(&outside);

        double factor = connect_factor(scene, connect, &from, &x, distance, &media);
        from.total = 0;
        if (scene->light_count && options->strategy != VIEW_SCATTERING_ONLY) {
            from.total = view_light_weights(scene, x.hit.position, worker->weights);
            if (from.total > 0) {
                direct_light(scene, options, &x, &media, from.total, factor, beta, rng, worker, sum);
            }
        }

        if (light.valid && depth + 1 < options->max_depth) {
            connect_paths(scene, &x, &media, &light, connect, beta, rng, worker, sum);
        }

        lum_scattered scattered;
        scatter(&x, rng, &polarization, &scattered);
        if (!(scattered.event & (LUM_REFLECTED | LUM_TRANSMITTED)) || !same_side(&x, scattered.wo)) {
            break;
        }
        /* Before the weight: the density is that of the photon's way. */
        from.direct = (scattered.event & LUM_DELTA) != 0;
        from.pdf = from.direct ? 0 : lum_scatter_pdf(surface, x.v, scattered.wo, (float)x.eta_outside);
        from.connect = factor > 0 ? factor * connect_cosine(&x, scattered.wo) : 0;
        if (x.object->lamp && !adjoint_weight(&x, &scattered, &eta_scale)) {
            break;
        }
        if (scattered.event & LUM_BOUNDARY) {
            media = x.front ? cross_boundary(media, surface->material, true) : outside;
        }
        double carried = 0;
        for (int c = 0; c < 3; c++) {
            beta[c] *= (double)scattered.weight[c];
            carried = fmax(carried, beta[c]);
        }
        if (!(carried > 0)) {
            break;
        }
        if (depth + 1 >= ROULETTE_FROM) {
            double survive = fmin(depth + 1 >= ENDLESS_FROM ? ENDLESS_SURVIVAL : 1.0, carried / eta_scale);
            if (survive < 1) {
                if (lum_rng_next(rng) >= survive) {
                    break;
                }
                for (int c = 0; c < 3; c++) {
                    beta[c] /= survive;
                }
            }
        }
        d = view_direction_out(&x.object->motion, scattered.wo);
        from.point = x.hit.position;
        start = view_leave(&x.hit, d);
    }
    bool finite = isfinite(sum[0]) && isfinite(sum[1]) && isfinite(sum[2]);
    worker->refused += !finite;
    for (int c = 0; c < 3; c++) {
        rgb[c] = finite ? sum[c] : 0;
    }
}
