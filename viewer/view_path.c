/* SPDX-License-Identifier: Apache-2.0 */
/* The path tracer proper; see view_path.h for what it computes and why. */
#include "view_path.h"

#include "view_vertex.h"

/* From this many scatterings on, Russian roulette may end a path, with a probability that depends on what it still carries. */
enum { ROULETTE_FROM = 4 };
/* From here on even a path that loses nothing ends at last (light guides need hundreds of bounces; a closed mirror room has no
 * end). */
enum { ENDLESS_FROM = 512 };
#define ENDLESS_SURVIVAL 0.99

/* Surfaces that let a ray pass by chance (alpha coverage) before the path is given up. */
enum { MAX_PASSES = 1000 };

static double next_number(void *state)
{
    return lum_rng_next(state);
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

static double luminance_of(const double rgb[3])
{
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
}

/*
 * What is left of light on its way: by Beer and Lambert in the solid that the way is inside of, or outside of solids through the
 * scene's volumes (exact: lum_volumes_depth).  False if there is nothing that takes any.
 */
static bool transmittance(const view_scene *scene, const view_bands *bands, const view_stack *media, lmg_vec3 origin,
                          lmg_vec3 direction, double distance, double out[LUM_WAVES])
{
    if (media->depth) {
        view_bands_transmittance(bands, view_innermost(media), distance, out);
        return true;
    }
    if (!scene->volumes) {
        return false;
    }
    double depth[3];
    lum_volumes_depth(scene->volumes, origin, direction, distance, depth);
    for (int c = 0; c < 3; c++) {
        depth[c] = exp(-depth[c]);
    }
    view_bands_factors(bands, depth, out);
    return true;
}

/* light times what is left of it on its way. */
static void attenuate(const view_scene *scene, const view_bands *bands, const view_stack *media, lmg_vec3 origin,
                      lmg_vec3 direction, double distance, double light[LUM_WAVES])
{
    double left[LUM_WAVES];
    if (transmittance(scene, bands, media, origin, direction, distance, left)) {
        for (uint32_t i = 0; i < bands->count; i++) {
            light[i] *= left[i];
        }
    }
}

/*
 * Adds light of a box that reached the path from point (world) along direction (towards the box), and what the error of the cell
 * that it comes from would make of it.  radiance: of the box itself, LMG_NEAREST.
 */
static void add_box_light(const view_scene *scene, uint32_t index, lmg_vec3 point, lmg_vec3 direction, const float radiance[3],
                          const view_bands *bands, const double light[LUM_WAVES], double factor, view_worker *worker, double sum[3])
{
    double before = luminance_of(sum);
    view_bands_add(bands, light, factor, sum);
    if (!worker->deviation) {
        return;
    }
    const view_box *box = &scene->boxes[index];
    double own = lmg_luminance(radiance), off = 0;
    uint64_t coins =
        view_box_cell(box, index, view_point_in(&box->motion, point), view_minus(view_direction_in(&box->motion, direction)), &off);
    double step = own > 0 ? (luminance_of(sum) - before) * off / own : 0;
    for (int k = 0; k < VIEW_BAKES; k++) {
        worker->deviation[k] += coins >> k & 1 ? step : -step;
    }
}

/* A sample of one light as seen from a point, in the world frame.  A box's radiance comes from of_box, later (box_radiance). */
static bool sample_light(const view_scene *scene, const view_light *light, lmg_vec3 p, const double xi[3], lum_light_sample *out,
                         lmg_point_sample *of_box)
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
    if (view_box_inside(box, p) || !lmg_field_sample_point(box->field, own, xi, of_box)) {
        return false;
    }
    *out = (lum_light_sample){.direction = view_direction_out(&box->motion, of_box->direction),
                              .distance = of_box->distance,
                              .pdf = of_box->pdf,
                              .material = LUM_NONE};
    return true;
}

/* False when it is dark there. */
static bool box_radiance(const view_box *box, const lmg_point_sample *sample, float radiance[3])
{
    if (!lmg_field_sample_radiance(box->field, sample, radiance)) {
        return false;
    }
    for (int c = 0; c < 3; c++) {
        radiance[c] *= (float)box->scale;
    }
    return true;
}

/* Whether nothing stands between a point and a light sampled from it.  The ray starts off the surface and still ends at the light.
 */
static bool light_arrives(const view_scene *scene, const view_vertex *x, const lum_light_sample *sample, lum_rng *rng)
{
    lmg_vec3 start = view_departure(x, sample->direction), direction = sample->direction;
    double distance = sample->distance;
    if (distance < (double)INFINITY) {
        lmg_vec3 way = view_sub(view_add(x->hit.position, view_scale(direction, distance)), start);
        distance = view_length(way);
        if (!(distance > 0)) {
            return true;
        }
        direction = view_scale(way, 1 / distance);
    }
    return !view_scene_occluded(scene, start, direction, distance, next_number, rng);
}

/* How the ray under way began. */
typedef struct departure {
    lmg_vec3 point; /* world */
    lmg_vec3 leg;   /* the ray is followed from here: point, or where it last passed a boundary that light doesn't notice */
    bool direct;    /* from the eye or a delta lobe: no other estimate finds the light that it meets */
    double pdf;     /* else the density of its direction */
    double total;   /* sum of worker->weights, made at point; 0 when no light was chosen there */
    double connect; /* density of a path from the boxes that comes along this ray, per luminance of the box; 0 when there is none */
} departure;

/*
 * A path eye ... p x light, with x a surface, can be made by choosing a light at x, by scattering at x, or by a path from a
 * box.  In terms of the direction at x towards the light, and over the density with which scattering at p finds x, the third has
 * the density connect luminance |cos| / flux  /  (pdf_p cos_x / d^2) with cos against x's normal of the direction to the box.  This
 * gives all but luminance and |cos|; 0 when paths from boxes can't make it: x is in a medium, p is the eye or mirrors, or the way
 * from p to x is inside a solid.  What volumes take on the way is in the light, not in the densities.
 */
static double connect_factor(const view_scene *scene, double connect, const departure *from, const view_vertex *x,
                             const view_stack *media)
{
    if (!(connect > 0) || x->kind != VIEW_ON_SURFACE || from->direct || media->depth || !(from->pdf > 0)) {
        return 0;
    }
    lmg_vec3 way = view_sub(x->hit.position, from->point);
    double arrival = from->pdf * fabs(view_dot(x->hit.hit.ng, x->v));
    return arrival > 0 ? connect / scene->boxes_flux * view_dot(way, way) / arrival : 0;
}

/* |cos| of that direction, w (model frame); 0 where light from outside can't come from, through the boundary of a solid. */
static double connect_cosine(const view_vertex *x, lmg_vec3 w)
{
    double cosine = view_dot(x->hit.hit.ng, w);
    return (cosine >= 0) != x->front && view_on_boundary(x) ? 0 : fabs(cosine);
}

/* The solids that a way from x in direction w (model frame) is inside of. */
static view_stack media_towards(const view_vertex *x, const view_stack *media, lmg_vec3 w)
{
    bool across = view_on_boundary(x) && (view_dot(x->hit.hit.ng, w) >= 0) != x->front;
    return across ? view_cross_boundary(*media, x->medium, x->front) : *media;
}

/* Direct light at x from one light chosen by chance.  worker->weights hold the lights' weights at x, which sum to total;
 * factor: connect_factor. */
static void direct_light(const view_scene *scene, const view_path_options *options, const view_vertex *x, const view_stack *media,
                         double total, double factor, const view_bands *bands, lum_rng *rng, view_worker *worker, double sum[3])
{
    double pick = lum_rng_next(rng) * total;
    uint32_t chosen = 0;
    while (chosen + 1 < scene->light_count && pick >= worker->weights[chosen]) {
        pick -= worker->weights[chosen++];
    }
    const double xi[3] = {lum_rng_next(rng), lum_rng_next(rng), lum_rng_next(rng)};
    lum_light_sample sample;
    lmg_point_sample of_box;
    const view_light *from = &scene->lights[chosen];
    if (!sample_light(scene, from, x->hit.position, xi, &sample, &of_box)) {
        return;
    }
    lmg_vec3 w = view_direction_in(&x->object->motion, sample.direction);
    double f[LUM_WAVES], light[LUM_WAVES];
    if (!view_reflect(x, bands, w, f)) {
        return;
    }
    if (from->kind == VIEW_LIGHT_BOX && !box_radiance(&scene->boxes[from->index], &of_box, sample.radiance)) {
        return;
    }
    double pdf = sample.pdf * (worker->weights[chosen] / total);
    double weight = 1;
    if (!sample.delta && options->strategy == VIEW_MIS) {
        double connected = 0;
        if (factor > 0 && from->kind == VIEW_LIGHT_BOX) {
            connected = factor * fabs(lmg_luminance(sample.radiance)) * connect_cosine(x, w);
        }
        weight = power_heuristic(pdf, view_scatter_pdf(x, w), connected);
    }
    worker->rays++;
    if (!light_arrives(scene, x, &sample, rng)) {
        return;
    }
    view_bands_light(bands, from->kind == VIEW_LIGHT_EMITTERS ? scene->objects[from->index].waves : NULL, sample.material,
                     sample.radiance, light);
    for (uint32_t i = 0; i < bands->count; i++) {
        light[i] *= f[i];
    }
    view_stack on_the_way = media_towards(x, media, w);
    attenuate(scene, bands, &on_the_way, x->hit.position, sample.direction, sample.distance, light);
    if (from->kind == VIEW_LIGHT_BOX) {
        add_box_light(scene, from->index, x->hit.position, sample.direction, sample.radiance, bands, light, weight / pdf, worker,
                      sum);
    } else {
        view_bands_add(bands, light, weight / pdf, sum);
    }
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

/* Light of all boxes that the ray meets before distance from where its leg began. */
static void add_boxes(const view_scene *scene, const view_path_options *options, const departure *from, lmg_vec3 d, double distance,
                      const view_stack *media, const view_bands *bands, view_worker *worker, double sum[3])
{
    if (!from->direct && options->strategy == VIEW_LIGHTS_ONLY) {
        return;
    }
    for (uint32_t i = 0; i < scene->box_count; i++) {
        double t;
        if (!view_box_enter(scene, i, from->leg, d, &t) || t >= distance) {
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
        double light[LUM_WAVES];
        view_bands_light(bands, NULL, LUM_NONE, rgb, light);
        attenuate(scene, bands, media, from->leg, d, t, light);
        for (int c = 0; c < 3; c++) {
            rgb[c] *= (float)box->scale;
        }
        add_box_light(scene, i, from->leg, d, rgb, bands, light, box->scale * scattering_weight(options, from, density, connected),
                      worker, sum);
    }
}

/* The emission of the surface that the ray met. */
static void add_emission(const view_scene *scene, const view_path_options *options, const departure *from, const view_vertex *x,
                         const view_bands *bands, const view_worker *worker, double sum[3])
{
    if (!any_light(x->surface.emission)) {
        return;
    }
    double density = 0, light[LUM_WAVES];
    if (!from->direct && options->strategy == VIEW_MIS && x->object->emitters) {
        density = light_share(scene, worker->weights, from->total, VIEW_LIGHT_EMITTERS, x->hit.object) *
                  lum_emitters_point_pdf(x->object->emitters, view_point_in(&x->object->motion, from->point), &x->hit.hit);
    }
    view_bands_light(bands, x->object->waves, x->medium->index, x->surface.emission, light);
    view_bands_add(bands, light, x->object->scale * scattering_weight(options, from, density, 0), sum);
}

/* Follows the straight ray from origin in direction d to the next surface that meets it, passing those that by chance don't.
 * *distance is counted from p, just behind which origin lies.  False when nothing is met; *distance is infinite then. */
static bool next_vertex(const view_scene *scene, lmg_vec3 p, lmg_vec3 origin, lmg_vec3 d, lum_rng *rng, view_worker *worker,
                        view_vertex *x, double *distance)
{
    for (int pass = 0; pass < MAX_PASSES; pass++) {
        worker->rays++;
        if (!view_scene_intersect(scene, origin, d, &x->hit)) {
            break;
        }
        x->scene = scene;
        view_see(x, d);
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
    double distance; /* to where the ray left the box */
    view_vertex x;   /* as the light sees it */
    float color[3];  /* of the box's light in the ray, luminance 1 */
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
    out->back = view_minus(d);
    for (int c = 0; c < 3; c++) {
        out->color[c] = ray.flux[c];
    }
    out->valid =
        next_vertex(scene, origin, origin, d, rng, worker, &out->x, &out->distance) && !view_box_inside(box, out->x.hit.position);
}

/* Light that goes from a box to the light vertex, from there to x and on towards the eye. */
static void connect_paths(const view_scene *scene, const view_vertex *x, const view_stack *media, const light_vertex *from,
                          double connect, view_bands *bands, lum_rng *rng, view_worker *worker, double sum[3])
{
    lmg_vec3 way = view_sub(from->x.hit.position, x->hit.position);
    double d2 = view_dot(way, way), distance = sqrt(d2);
    if (!(d2 > 0)) {
        return;
    }
    lum_light_sample towards = {.direction = view_scale(way, 1 / distance), .distance = distance};
    lmg_vec3 w = view_direction_in(&x->object->motion, towards.direction);
    double f[LUM_WAVES], g[LUM_WAVES], light[LUM_WAVES];
    if (!view_reflect(x, bands, w, f) || media_towards(x, media, w).depth) {
        return;
    }
    /* The light vertex as the eye's path would see it from x. */
    static const view_stack OUTSIDE = {.depth = 0};
    view_vertex y = {.scene = scene, .hit = from->x.hit};
    view_bands own;
    if (bands->tables) { /* its own, since the light vertex may choose or change wavelengths */
        own = *bands;
        bands = &own;
        for (uint32_t i = 0; i < own.count; i++) {
            own.beta[i] *= f[i];
            f[i] = 1;
        }
    }
    view_see(&y, towards.direction);
    view_settle(&y, &OUTSIDE, bands, rng);
    lmg_vec3 back = view_direction_in(&y.object->motion, from->back);
    double cosine = connect_cosine(&y, back), arrival = fabs(view_dot(y.hit.hit.ng, y.v)) / d2;
    if (!(cosine > 0) || !(arrival > 0) || !view_reflect(&y, bands, back, g)) {
        return;
    }
    worker->rays++;
    if (!light_arrives(scene, x, &towards, rng)) {
        return;
    }
    /* The densities of the three estimates, as in connect_factor. */
    const view_box *box = &scene->boxes[from->box];
    lmg_vec3 own_y = view_point_in(&box->motion, y.hit.position), own_back = view_direction_in(&box->motion, from->back);
    float radiance[3];
    lmg_field_radiance(box->field, own_y, view_minus(own_back), LMG_NEAREST, radiance, NULL);
    double mine = connect * cosine * fabs(lmg_luminance(radiance)) * box->scale / scene->boxes_flux;
    double found = view_scatter_pdf(x, w) * arrival;
    double *weights = worker->weights + scene->light_count;
    double total = view_light_weights(scene, y.hit.position, weights);
    double chosen =
        light_share(scene, weights, total, VIEW_LIGHT_BOX, from->box) * lmg_field_point_pdf(box->field, own_y, own_back);
    double weight = power_heuristic(mine, found * chosen, found * view_scatter_pdf(&y, back));
    view_bands_light(bands, NULL, LUM_NONE, from->color, light);
    for (uint32_t i = 0; i < bands->count; i++) {
        light[i] *= f[i] * g[i];
    }
    attenuate(scene, bands, &OUTSIDE, x->hit.position, towards.direction, distance, light);
    attenuate(scene, bands, &OUTSIDE, y.hit.position, from->back, from->distance, light);
    for (int c = 0; c < 3; c++) {
        radiance[c] *= (float)box->scale;
    }
    add_box_light(scene, from->box, y.hit.position, from->back, radiance, bands, light,
                  scene->boxes_flux * arrival * weight / (connect * cosine), worker, sum);
}

typedef enum way_end { WAY_LOST, WAY_SURFACE, WAY_MEDIUM } way_end;

/* What scattering and absorption leave of a path on its ray from start to the surface that it met, or to infinity.  length: of the
 * leg that the ray is the last piece of.  Where the path is scattered before, *x becomes that point. */
static way_end travel(const view_scene *scene, const view_stack *media, const departure *from, lmg_vec3 start, lmg_vec3 d, bool met,
                      double length, view_bands *bands, lum_rng *rng, view_vertex *x)
{
    const view_medium *medium = view_innermost(media);
    if (medium ? !medium->scatters : !scene->volumes) {
        double left[LUM_WAVES];
        if (met && medium) {
            view_bands_transmittance(bands, medium, length, left);
            for (uint32_t i = 0; i < bands->count; i++) {
                bands->beta[i] *= left[i];
            }
        }
        return met ? WAY_SURFACE : WAY_LOST;
    }
    if (medium && !met) {
        return WAY_LOST; /* out of a solid by a hole in it: the medium has no end there */
    }
    double skipped = view_dot(view_sub(start, from->leg), d);
    lum_flight flight;
    if (!(view_bands_carried(bands) > 0) ||
        !view_bands_fly(bands, medium, scene->volumes, start, d, fmax(length - skipped, 0), rng, &flight)) {
        return WAY_LOST;
    }
    if (flight.event != LUM_FLIGHT_SCATTERED) {
        return met ? WAY_SURFACE : WAY_LOST;
    }
    /* Rounding mustn't put the point beyond the surface: nearer than its error, it stands where rays that leave it start. */
    lmg_vec3 place = view_add(start, view_scale(d, flight.t));
    if (met) {
        double cosine = view_dot(d, x->hit.ng), gap = (length - skipped - flight.t) * fabs(cosine), shift = x->hit.hit.error - gap;
        if (shift > 0) {
            place = view_add(place, view_scale(x->hit.ng, cosine > 0 ? -shift : shift));
        }
    }
    view_vertex_in_medium(x, scene, place, d, flight.g);
    return WAY_MEDIUM;
}

/* Ends paths by chance that carry little, and in the end all; false when it has ended. */
static bool survives(uint32_t scatterings, double eta_scale, view_bands *bands, lum_rng *rng)
{
    double carried = view_bands_carried(bands);
    if (!(carried > 0)) {
        return false;
    }
    if (scatterings < ROULETTE_FROM) {
        return true;
    }
    double survive = fmin(scatterings >= ENDLESS_FROM ? ENDLESS_SURVIVAL : 1.0, carried / eta_scale);
    if (survive < 1) {
        if (lum_rng_next(rng) >= survive) {
            return false;
        }
        for (uint32_t i = 0; i < bands->count; i++) {
            bands->beta[i] /= survive;
        }
    }
    return true;
}

/* A path under way. */
typedef struct path {
    view_bands bands;
    departure from;
    view_stack media;
    lum_polarization polarization;
    lmg_vec3 start, d; /* of its ray */
    double eta_scale;  /* change of radiance by refraction so far, which roulette must not mistake for loss */
    double connect;    /* probability of paths from the boxes */
    light_vertex light;
    double sum[3];
} path;

static void begin(const view_scene *scene, const view_path_options *options, lmg_vec3 origin, lum_rng *rng, view_worker *worker,
                  path *p)
{
    p->from = (departure){.point = origin, .leg = origin, .direct = true};
    p->media.depth = 0;
    p->polarization = (lum_polarization){.known = false};
    p->eta_scale = 1;
    p->connect = 0;
    p->light.valid = false;
    p->sum[0] = p->sum[1] = p->sum[2] = 0;
    view_bands_begin(&p->bands, scene->waves, rng);
    if (options->strategy == VIEW_MIS && scene->box_count && options->max_depth > 1 && options->connect >= 0) {
        p->connect = options->connect > 0 ? fmin(options->connect, 1) : scene->connect;
    }
    if (p->connect > 0 && (p->connect >= 1 || lum_rng_next(rng) < p->connect)) {
        trace_from_box(scene, rng, worker, &p->light);
    }
}

/* The light that x sends towards the eye, and where the path goes on from there; depth: scatterings before.  False at its end. */
static bool scatter(const view_scene *scene, const view_path_options *options, const view_vertex *x, uint32_t depth, lum_rng *rng,
                    view_worker *worker, path *p)
{
    double factor = connect_factor(scene, p->connect, &p->from, x, &p->media);
    p->from.total = 0;
    if (scene->light_count && options->strategy != VIEW_SCATTERING_ONLY) {
        p->from.total = view_light_weights(scene, x->hit.position, worker->weights);
        if (p->from.total > 0) {
            direct_light(scene, options, x, &p->media, p->from.total, factor, &p->bands, rng, worker, p->sum);
        }
    }
    if (p->light.valid && depth + 1 < options->max_depth) {
        connect_paths(scene, x, &p->media, &p->light, p->connect, &p->bands, rng, worker, p->sum);
    }
    view_scattered s;
    if (!view_scatter(x, &p->bands, rng, &p->polarization, &s)) {
        return false;
    }
    p->from.direct = s.direct;
    p->from.pdf = s.pdf;
    p->from.connect = factor > 0 ? factor * connect_cosine(x, s.w) : 0;
    p->eta_scale *= s.eta_scale;
    if (s.crosses) {
        p->media = view_cross_boundary(p->media, x->medium, x->front);
    }
    for (uint32_t i = 0; i < p->bands.count; i++) {
        p->bands.beta[i] *= s.weight[i];
    }
    if (!survives(depth + 1, p->eta_scale, &p->bands, rng)) {
        return false;
    }
    p->d = view_direction_out(&x->object->motion, s.w);
    p->from.point = p->from.leg = x->hit.position;
    p->start = view_departure(x, p->d);
    return true;
}

/* Follows a path to its end; depth: scatterings before. */
static void follow(const view_scene *scene, const view_path_options *options, uint32_t depth, lum_rng *rng, view_worker *worker,
                   path *p)
{
    for (;;) {
        view_vertex x;
        double distance;
        bool met = next_vertex(scene, p->from.leg, p->start, p->d, rng, worker, &x, &distance);
        if (met) {
            view_notice_inside(&p->media, &x);
        }
        add_boxes(scene, options, &p->from, p->d, distance, &p->media, &p->bands, worker, p->sum);
        way_end end = travel(scene, &p->media, &p->from, p->start, p->d, met, distance, &p->bands, rng, &x);
        if (end == WAY_LOST) {
            return;
        }
        if (end == WAY_SURFACE) {
            if (view_on_boundary(&x) && view_is_hidden(&p->media, x.surface.material)) {
                p->media = view_cross_boundary(p->media, x.medium, x.front);
                p->from.leg = x.hit.position;
                p->start = view_leave(&x.hit, p->d);
                continue;
            }
            add_emission(scene, options, &p->from, &x, &p->bands, worker, p->sum);
        }
        if (depth >= options->max_depth || (end == WAY_SURFACE && x.surface.kind == LUM_SURFACE_BLACK)) {
            return;
        }
        if (end == WAY_SURFACE) {
            view_settle(&x, &p->media, &p->bands, rng);
        }
        if (!scatter(scene, options, &x, depth++, rng, worker, p)) {
            return;
        }
    }
}

static void finish(const path *p, view_worker *worker, double scale, double rgb[3])
{
    bool finite = isfinite(p->sum[0]) && isfinite(p->sum[1]) && isfinite(p->sum[2]);
    worker->refused += !finite;
    for (int c = 0; c < 3; c++) {
        rgb[c] = finite ? scale * p->sum[c] : 0;
    }
}

void view_path_radiance(const view_scene *scene, const view_path_options *options, lmg_vec3 origin, lmg_vec3 direction,
                        lum_rng *rng, view_worker *worker, double rgb[3])
{
    path p;
    begin(scene, options, origin, rng, worker, &p);
    p.start = origin;
    p.d = direction;
    follow(scene, options, 0, rng, worker, &p);
    finish(&p, worker, 1, rgb);
}

void view_path_illuminance(const view_scene *scene, const view_path_options *options, lmg_vec3 point, lmg_vec3 normal, lum_rng *rng,
                           view_worker *worker, double rgb[3])
{
    path p;
    view_vertex meter;
    begin(scene, options, point, rng, worker, &p);
    view_vertex_on_meter(&meter, scene, point, normal);
    if (options->max_depth > 0 && scatter(scene, options, &meter, 0, rng, worker, &p)) {
        follow(scene, options, 1, rng, worker, &p);
    }
    finish(&p, worker, VIEW_PI, rgb);
}
