/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Sampling of many surfaces at once.  A sample is a chain of square roots and divisions, each waiting for the last; what most light
 * in luminaires meets, diffuse surfaces (painted ones too) and rough metals, is done in columns instead.  What is to happen is
 * decided one by one, then directions are computed together, with the operations of scatter.c in their order.  The rest is left to
 * lum_scatter_trace.
 */
#include "polarization.h"
#include "scatter_parts.h"

/* Directions distributed about normals. */
typedef struct diffuse_columns {
    double n[3][LUM_MAX_ENCOUNTERS];
    double q[LUM_MAX_ENCOUNTERS], azimuth[LUM_MAX_ENCOUNTERS];
    double wo[3][LUM_MAX_ENCOUNTERS];
    uint32_t encounter[LUM_MAX_ENCOUNTERS];
    size_t count;
} diffuse_columns;

/* Reflections on rough metal. */
typedef struct facet_columns {
    double n[3][LUM_MAX_ENCOUNTERS], g[3][LUM_MAX_ENCOUNTERS], wi[3][LUM_MAX_ENCOUNTERS];
    double c[LUM_MAX_ENCOUNTERS], alpha[LUM_MAX_ENCOUNTERS], xi[3][LUM_MAX_ENCOUNTERS];
    double wo[3][LUM_MAX_ENCOUNTERS];
    int64_t kept[LUM_MAX_ENCOUNTERS]; /* 0: not so simple; lum_scatter_trace is to do it */
    uint32_t encounter[LUM_MAX_ENCOUNTERS];
    size_t count;
} facet_columns;

/* Columns are filled up to whole vectors: a loop's last few rounds, one by one, would take as long as all the others. */
enum { VECTOR = 8 };

static inline size_t whole_vectors(size_t count)
{
    return (count + VECTOR - 1) / VECTOR * VECTOR;
}

static inline void put(double (*column)[LUM_MAX_ENCOUNTERS], size_t i, lmg_vec3 v)
{
    column[0][i] = v.x;
    column[1][i] = v.y;
    column[2][i] = v.z;
}

static inline lmg_vec3 get(const double (*column)[LUM_MAX_ENCOUNTERS], size_t i)
{
    return vec(column[0][i], column[1][i], column[2][i]);
}

LUM_WIDE static void turn_diffusely(diffuse_columns *restrict c)
{
    const size_t count = whole_vectors(c->count);
    for (size_t i = 0; i < count; i++) {
        lmg_vec3 wo = vec_about_squared(get((const double(*)[LUM_MAX_ENCOUNTERS])c->n, i), c->q[i], c->azimuth[i]);
        put(c->wo, i, wo);
    }
}

LUM_WIDE static void reflect_on_facets(facet_columns *restrict c)
{
    const size_t count = whole_vectors(c->count);
    for (size_t i = 0; i < count; i++) {
        lmg_vec3 n = get((const double(*)[LUM_MAX_ENCOUNTERS])c->n, i), g = get((const double(*)[LUM_MAX_ENCOUNTERS])c->g, i);
        lmg_vec3 x = vec_along(get((const double(*)[LUM_MAX_ENCOUNTERS])c->wi, i), n, -c->c[i]);
        double s2 = vec_dot(x, x), s = sqrt(s2);
        facets f = facets_about(n, vec_scale(x, 1 / s), c->c[i], s, c->alpha[i]);
        facet h = facets_sample(&f, c->xi[0][i], c->xi[1][i]);
        lmg_vec3 o = facet_reflected(&f, &h);
        /* facets_keep_reflected */
        bool kept = (o.z > 0) & (c->xi[2][i] * (o.z * f.b + f.wi.z * facets_b(&f, o)) < o.z * (f.wi.z + f.b));
        lmg_vec3 wo = facets_to_model(&f, o);
        double below = vec_dot(wo, g); /* mirrored where it points below the geometric surface */
        lmg_vec3 up = vec_along(wo, g, -2 * below);
        c->wo[0][i] = below < 0 ? up.x : wo.x;
        c->wo[1][i] = below < 0 ? up.y : wo.y;
        c->wo[2][i] = below < 0 ? up.z : wo.z;
        c->kept[i] = kept & (s2 > LUM_NO_SINE) ? 1 : 0;
    }
}

static inline void add_diffuse(lum_encounter *e, uint32_t k, const side *at, bool behind, double azimuth, double q,
                               diffuse_columns *c)
{
    const size_t i = c->count++;
    depolarize(e->polarization);
    put(c->n, i, behind ? vec_scale(at->g, -1) : at->g);
    c->q[i] = q;
    c->azimuth[i] = azimuth;
    c->encounter[i] = k;
    set_weight(&e->out, behind ? e->surface.through : e->surface.base);
    e->out.event = behind ? LUM_TRANSMITTED : LUM_REFLECTED;
}

static inline void add_facet(lum_encounter *e, uint32_t k, const side *at, facet_columns *c)
{
    const size_t i = c->count++;
    put(c->n, i, at->n);
    put(c->g, i, at->tilted ? at->g : vec(0, 0, 0)); /* nothing is below that */
    put(c->wi, i, e->wi);
    c->c[i] = at->ci;
    c->alpha[i] = (double)e->surface.alpha;
    for (int j = 0; j < 3; j++) {
        c->xi[j][i] = e->xi[j];
    }
    c->encounter[i] = k;
}

/* Puts encounter k into the columns where it belongs; false if it belongs to none. */
static inline bool sort_encounter(lum_encounter *e, uint32_t k, diffuse_columns *diffuse, facet_columns *metal)
{
    const lum_surface *surface = &e->surface;
    const bool plain = !(e->polarization && e->polarization->known);
    side at = side_of(surface, e->wi);
    double u = e->xi[3], azimuth = e->xi[0];
    if (surface->kind == LUM_SURFACE_LAMBERT) {
        bool through = choose(&u, (double)surface->diffuse_transmission);
        add_diffuse(e, k, &at, through, azimuth, e->xi[1], diffuse);
        return true;
    }
#ifdef LUM_ONLY_REFLECTORS /* the benchmark's build without other effects (tests/bench/bench_pay.c) */
    if (surface->kind != LUM_SURFACE_CONDUCTOR || !plain || surface->alpha < LUM_SMOOTH || surface->material->has_eta) {
        return false;
    }
    add_facet(e, k, &at, metal);
    return true;
#else
    const bool is_metal = surface->kind == LUM_SURFACE_CONDUCTOR ||
                          (surface->kind == LUM_SURFACE_PBR && !surface->layers_present && choose(&u, (double)surface->metallic));
    if (is_metal) {
        if (!plain || surface->alpha < LUM_SMOOTH || surface->material->has_eta) {
            return false;
        }
        add_facet(e, k, &at, metal);
        return true;
    }
    if (surface->kind != LUM_SURFACE_PBR || surface->layers_present || choose(&u, (double)surface->transmission)) {
        return false;
    }
    double q, rest;
    const lum_lobe_set *coat = coat_of(surface, medium_of(surface->tables, e->eta_outside), at.front);
    if (!coat) {
        bool through = base_goes_through(surface, NULL, &azimuth, e->xi[1], 0, &q);
        add_diffuse(e, k, &at, through, azimuth, q, diffuse);
        return true;
    }
    if (!plain || surface->alpha < LUM_SMOOTH || !coat_admits(coat, (double)surface->alpha, at.ci, u, &rest)) {
        return false;
    }
    bool through = base_goes_through(surface, coat, &azimuth, e->xi[1], e->xi[2], &q);
    add_diffuse(e, k, &at, through, azimuth, q, diffuse);
    return true;
#endif
}

static inline void trace_alone(lum_encounter *e)
{
    lum_scatter_trace(&e->surface, e->wi, e->eta_outside, e->xi, e->polarization, &e->out);
}

void lum_scatter_trace_many(size_t count, lum_encounter *encounters)
{
    diffuse_columns diffuse;
    facet_columns metal;
    diffuse.count = metal.count = 0;
    for (uint32_t k = 0; k < count; k++) {
        encounters[k].out.pdf = 0;
        if (!sort_encounter(&encounters[k], k, &diffuse, &metal)) {
            trace_alone(&encounters[k]);
        }
    }
    for (size_t i = diffuse.count; i < whole_vectors(diffuse.count); i++) {
        put(diffuse.n, i, vec(0, 0, 1));
        diffuse.q[i] = diffuse.azimuth[i] = 0;
    }
    turn_diffusely(&diffuse);
    for (size_t i = 0; i < diffuse.count; i++) {
        encounters[diffuse.encounter[i]].out.wo = get((const double(*)[LUM_MAX_ENCOUNTERS])diffuse.wo, i);
    }
    for (size_t i = metal.count; i < whole_vectors(metal.count); i++) {
        put(metal.n, i, vec(0, 0, 1));
        put(metal.g, i, vec(0, 0, 0));
        put(metal.wi, i, vec(0.6, 0, 0.8));
        metal.c[i] = 0.8;
        metal.alpha[i] = 0.5;
        metal.xi[0][i] = metal.xi[1][i] = metal.xi[2][i] = 0.5;
    }
    reflect_on_facets(&metal);
    for (size_t i = 0; i < metal.count; i++) {
        lum_encounter *e = &encounters[metal.encounter[i]];
        if (!metal.kept[i]) {
            trace_alone(e);
            continue;
        }
        e->out.wo = get((const double(*)[LUM_MAX_ENCOUNTERS])metal.wo, i);
        e->out.event = LUM_REFLECTED;
        set_weight(&e->out, e->surface.base);
    }
}
