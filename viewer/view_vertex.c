/* SPDX-License-Identifier: Apache-2.0 */
/* Scattering at the points of a path from the eye (view_vertex.h); view_path.h says what is computed and why. */
#include "view_vertex.h"

#include <string.h>

view_stack view_cross_boundary(view_stack stack, const view_medium *medium, bool inwards)
{
    if (inwards) {
        if (stack.depth < VIEW_MAX_NESTED) {
            int at = stack.depth++;
            for (; at > 0 && stack.inside[at - 1]->material->priority > medium->material->priority; at--) {
                stack.inside[at] = stack.inside[at - 1];
            }
            stack.inside[at] = medium;
        }
        return stack;
    }
    for (int i = stack.depth - 1; i >= 0; i--) {
        if (stack.inside[i] == medium) {
            memmove(&stack.inside[i], &stack.inside[i + 1], (size_t)(stack.depth - 1 - i) * sizeof stack.inside[0]);
            stack.depth--;
            break;
        }
    }
    return stack;
}

void view_notice_inside(view_stack *stack, const view_vertex *x)
{
    if (x->front || !view_on_boundary(x) || stack->depth == VIEW_MAX_NESTED) {
        return;
    }
    for (int i = 0; i < stack->depth; i++) {
        if (stack->inside[i] == x->medium) {
            return;
        }
    }
    *stack = view_cross_boundary(*stack, x->medium, true);
}

void view_see(view_vertex *x, lmg_vec3 d)
{
    x->object = &x->scene->objects[x->hit.object];
    lmg_vec3 own_d = view_direction_in(&x->object->motion, d);
    lum_surface_at(x->object->scene, &x->hit.hit, own_d, &x->surface);
    x->medium = &x->object->media[x->surface.material - x->object->model->materials];
    x->v = view_minus(own_d);
    double side = view_dot(x->hit.hit.ng, x->v);
    x->front = side >= 0;
    x->kind = VIEW_ON_SURFACE;
    x->converted = false;
    x->smoothed = !x->object->lamp && x->surface.tilted && side * view_dot(x->surface.ns, x->v) > 0;
    if (x->smoothed) {
        x->surface.ng = x->surface.ns;
        x->surface.tilted = false;
    }
}

void view_vertex_in_medium(view_vertex *x, const view_scene *scene, lmg_vec3 position, lmg_vec3 d, double g)
{
    x->scene = scene;
    x->object = &scene->objects[0]; /* whose frame is the world */
    x->hit.position = position;
    x->v = view_minus(d);
    x->g = g;
    x->kind = VIEW_IN_MEDIUM;
    x->smoothed = x->converted = false;
}

void view_vertex_on_meter(view_vertex *x, const view_scene *scene, lmg_vec3 position, lmg_vec3 normal)
{
    *x = (view_vertex){.kind = VIEW_ON_METER, .scene = scene, .object = &scene->objects[0], .front = true, .v = normal};
    x->hit.position = position;
    x->hit.ng = x->hit.hit.ng = normal;
}

static double index_of(const view_medium *medium, const view_bands *bands)
{
    if (!medium) {
        return 1;
    }
    float index = medium->material->ior;
    return (double)(bands->tables ? lum_waves_index(medium->tables, medium->index, &bands->waves, index) : index);
}

void view_settle(view_vertex *x, const view_stack *media, view_bands *bands, lum_rng *rng)
{
    const view_medium *inside = view_innermost(media);
    if (bands->tables) {
        const lum_wave_tables *own = x->object->waves;
        if (own->materials[x->medium->index].refracts || (inside && inside->tables->materials[inside->index].refracts)) {
            view_bands_choose(bands, lum_rng_next(rng));
        }
        x->surface.ior = lum_waves_index(own, x->medium->index, &bands->waves, x->surface.ior);
        const lum_phosphor *phosphor = own->materials[x->medium->index].phosphor;
        if (phosphor && view_bands_convert(bands, own, phosphor, rng)) {
            /* What is emitted is all of it, to both sides. */
            for (int c = 0; c < 3; c++) {
                x->surface.base[c] = x->surface.through[c] = 1;
            }
            x->surface.diffuse_transmission = (float)phosphor->forward;
            x->converted = true;
        }
    }
    view_stack outside = *media;
    if (!x->front && view_on_boundary(x)) {
        outside = view_cross_boundary(outside, x->medium, false);
    }
    x->eta_outside = index_of(view_innermost(&outside), bands);
}

bool view_same_side(const view_vertex *x, lmg_vec3 w)
{
    return !x->smoothed || view_dot(x->hit.hit.ng, w) * view_dot(x->surface.ng, w) > 0;
}

/* The surface as light that comes from w meets it. */
static void see_light(const view_vertex *x, lmg_vec3 w, lum_surface *lit)
{
    lum_surface_at(x->object->scene, &x->hit.hit, view_minus(w), lit);
    lit->ior = x->surface.ior;
    if (x->converted) {
        memcpy(lit->base, x->surface.base, sizeof lit->base);
        memcpy(lit->through, x->surface.through, sizeof lit->through);
        lit->diffuse_transmission = x->surface.diffuse_transmission;
    }
}

/* Density p from `from` towards `to` of a surface in the bands, of R,G,B rgb; mean: the density that goes with it. */
static void in_bands(const view_vertex *x, const view_bands *bands, bool reflected, const float rgb[3], double mean,
                     double out[LUM_WAVES])
{
    if (!bands->tables || x->converted || !(mean > 0)) {
        /* A phosphor's own light is the same in all. */
        for (uint32_t i = 0; i < bands->count; i++) {
            out[i] = (double)rgb[bands->tables ? 1 : i];
        }
        return;
    }
    float weight[3];
    for (int c = 0; c < 3; c++) {
        weight[c] = (float)((double)rgb[c] / mean);
    }
    view_bands_scattered(bands, x->object->waves, x->medium->index, reflected, weight, out);
    for (uint32_t i = 0; i < bands->count; i++) {
        out[i] *= mean;
    }
}

bool view_reflect(const view_vertex *x, const view_bands *bands, lmg_vec3 w, double f[LUM_WAVES])
{
    if (x->kind != VIEW_ON_SURFACE) {
        double p = view_scatter_pdf(x, w);
        for (uint32_t i = 0; i < bands->count; i++) {
            f[i] = p;
        }
        return p > 0;
    }
    float rgb[3];
    double ratio = 1, mean = 0;
    if (!x->object->lamp) {
        if (!view_same_side(x, w)) {
            return false;
        }
        lum_scatter_eval(&x->surface, x->v, w, (float)x->eta_outside, rgb);
        if (bands->tables) {
            mean = lum_scatter_pdf(&x->surface, x->v, w, (float)x->eta_outside);
        }
    } else {
        lum_surface lit;
        see_light(x, w, &lit);
        lum_scatter_eval(&lit, w, x->v, (float)x->eta_outside, rgb);
        if (bands->tables) {
            mean = lum_scatter_pdf(&lit, w, x->v, (float)x->eta_outside);
        }
        double cos_v = fabs(view_dot(x->hit.hit.ng, x->v));
        ratio = cos_v > 0 ? fabs(view_dot(x->hit.hit.ng, w)) / cos_v : 0;
    }
    if (rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0) {
        return false;
    }
    bool reflected = (view_dot(x->hit.hit.ng, w) >= 0) == x->front;
    in_bands(x, bands, reflected, rgb, mean, f);
    for (uint32_t i = 0; i < bands->count; i++) {
        f[i] *= ratio;
    }
    return ratio > 0;
}

double view_scatter_pdf(const view_vertex *x, lmg_vec3 w)
{
    switch (x->kind) {
    case VIEW_IN_MEDIUM:
        return lum_phase_pdf(x->g, -view_dot(w, x->v));
    case VIEW_ON_METER:
        return fmax(view_dot(w, x->hit.ng), 0) / VIEW_PI;
    default:
        return lum_scatter_pdf(&x->surface, x->v, w, (float)x->eta_outside);
    }
}

/* Scattering as a photon's. */
static void trace(const view_vertex *x, lum_rng *rng, lum_polarization *polarization, lum_scattered *out)
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

/*
 * Turns the weight of a scattering sampled as if the path were a photon into that of radiance travelling backwards (lamps only):
 * the photon's density the other way over its density this way, times the adjoint's ratio of cosines.  With flat shading that is 1
 * by reciprocity, and (n_v / n_w)^2 across a boundary.  False when no light can come that way.
 */
static bool adjoint_weight(const view_vertex *x, const view_bands *bands, int event, view_scattered *s)
{
    double factor = 1;
    if (event & LUM_BOUNDARY) {
        double behind = (double)x->surface.ior;
        double n_v = x->front ? x->eta_outside : behind, n_w = x->front ? behind : x->eta_outside;
        factor = (n_v * n_v) / (n_w * n_w);
        s->eta_scale *= factor;
    }
    if (x->surface.tilted) {
        const lmg_vec3 ng = x->hit.hit.ng, ns = x->surface.ns;
        double cos_v = fabs(view_dot(ng, x->v)), cos_w = fabs(view_dot(ng, s->w));
        if (cos_v == 0) {
            return false;
        }
        if (!s->direct) {
            float rgb[3];
            double this_way[LUM_WAVES], back[LUM_WAVES];
            lum_scatter_eval(&x->surface, x->v, s->w, (float)x->eta_outside, rgb);
            in_bands(x, bands, (view_dot(ng, s->w) >= 0) == x->front, rgb, s->pdf, this_way);
            bool any = view_reflect(x, bands, s->w, back);
            for (uint32_t i = 0; i < bands->count; i++) {
                s->weight[i] = any && this_way[i] > 0 ? s->weight[i] * (back[i] / this_way[i]) : 0;
            }
            return any;
        }
        /* A delta lobe maps solid angles by dwi/dwo = (n_o^2 cos_s o) / (n_i^2 cos_s i), cos_s against the shading normal;
         * mirrors and thin walls keep cos_s. */
        factor *= cos_w / cos_v;
        if (event & LUM_BOUNDARY) {
            double shade_v = fabs(view_dot(ns, x->v)), shade_w = fabs(view_dot(ns, s->w));
            factor = shade_w > 0 ? factor * shade_v / shade_w : 0;
        }
    }
    for (uint32_t i = 0; i < bands->count; i++) {
        s->weight[i] *= factor;
    }
    return factor > 0;
}

static lmg_vec3 cosine_direction(lmg_vec3 n, const double xi[2])
{
    lmg_vec3 a = view_unit(view_cross(n, fabs(n.x) < 0.5 ? (lmg_vec3){1, 0, 0} : (lmg_vec3){0, 1, 0})), b = view_cross(n, a);
    double r = sqrt(xi[0]), phi = 2 * VIEW_PI * xi[1];
    lmg_vec3 flat = view_add(view_scale(a, r * cos(phi)), view_scale(b, r * sin(phi)));
    return view_add(flat, view_scale(n, sqrt(1 - xi[0])));
}

bool view_scatter(const view_vertex *x, const view_bands *bands, lum_rng *rng, lum_polarization *polarization, view_scattered *out)
{
    out->eta_scale = 1;
    out->direct = out->crosses = false;
    if (x->kind != VIEW_ON_SURFACE) {
        const double xi[2] = {lum_rng_next(rng), lum_rng_next(rng)};
        out->w = x->kind == VIEW_IN_MEDIUM ? lum_phase_sample(x->g, view_minus(x->v), xi) : cosine_direction(x->hit.ng, xi);
        out->pdf = view_scatter_pdf(x, out->w);
        *polarization = (lum_polarization){.known = false};
        for (uint32_t i = 0; i < bands->count; i++) {
            out->weight[i] = 1;
        }
        return out->pdf > 0;
    }
    lum_scattered s;
    trace(x, rng, polarization, &s);
    if (!(s.event & (LUM_REFLECTED | LUM_TRANSMITTED)) || !view_same_side(x, s.wo)) {
        return false;
    }
    out->w = s.wo;
    out->direct = (s.event & LUM_DELTA) != 0;
    out->crosses = (s.event & LUM_BOUNDARY) != 0;
    /* Before the weight: the density is that of the photon's way. */
    out->pdf = out->direct ? 0 : lum_scatter_pdf(&x->surface, x->v, s.wo, (float)x->eta_outside);
    if (x->converted) {
        for (uint32_t i = 0; i < bands->count; i++) {
            out->weight[i] = 1;
        }
    } else {
        view_bands_scattered(bands, x->object->waves, x->medium->index, (s.event & LUM_REFLECTED) != 0, s.weight, out->weight);
    }
    return !x->object->lamp || adjoint_weight(x, bands, s.event, out);
}
