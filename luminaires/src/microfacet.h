/* SPDX-License-Identifier: Apache-2.0 */
/*
 * GGX microfacets [walter2007microfacet] and where the light goes that one bounce on them doesn't account for.
 *
 * A single reflection on a rough surface loses the light that its own facets block: of what arrives under cosine mu the share E(mu)
 * gets away, the rest, 1 - E(mu), is scattered again.  That rest leaves with the density
 *     p(mu_o) = (1 - E(mu_o)) mu_o / (pi (1 - E_avg)),   E_avg = 2 * integral of E mu,
 * which is reciprocal and conserves energy [kelemen2001coupled, kulla2017imageworks].  1 - E is tabulated as a function that is
 * linear in q = mu^2 between nodes; with d(mu^2) = 2 mu dmu the density is linear in q too, so its integral and its inverse are
 * exact for the interpolant.
 */
#ifndef LUMINAIRES_MICROFACET_H
#define LUMINAIRES_MICROFACET_H

#include "vec.h"

#include <luminaires/scatter.h>

enum {
    /* Steps for which tables are computed, and those, multiples, that they are refined to by cubic interpolation. */
    LUM_LOBE_COMPUTED_SEGMENTS = 64,
    LUM_LOBE_SEGMENTS = 128, /* a power of two */
    LUM_LOBE_COMPUTED_ROUGHNESSES = 36,
    LUM_LOBE_ROUGHNESSES = 108,
    LUM_LOBE_FLOORS = 64
};

/* 1 - E over q at one roughness. */
typedef struct lum_lobe {
    float rest[LUM_LOBE_SEGMENTS + 1]; /* 1 - E at node j, q = (j / LUM_LOBE_SEGMENTS)^4 */
    float sum[LUM_LOBE_SEGMENTS + 1];  /* integral of rest dq from 0 to node j; the last is 1 - E_avg */
    float floor[LUM_LOBE_FLOORS];      /* lower bound of rest for q in [k, k+1] / LUM_LOBE_FLOORS: mostly saves looking closer */
    float top;                         /* its largest value */
    uint8_t guide[LUM_LOBE_SEGMENTS];  /* of part k of LUM_LOBE_SEGMENTS equal parts of the sum: the segment where it begins */
} lum_lobe;

/* Over roughness (sqrt of alpha): one lobe if it is constant, else LUM_LOBE_ROUGHNESSES + 1 equally spaced ones. */
typedef struct lum_lobe_set {
    int kind;    /* lum_lobe_kind */
    float eta;   /* relative index n_t / n_i; 0 for LUM_LOBE_METAL */
    float alpha; /* of a set with one lobe */
    int count;
    lum_lobe lobes[];
} lum_lobe_set;

typedef enum lum_lobe_kind {
    LUM_LOBE_METAL = 0,   /* E: single reflection, Fresnel reflectance 1 */
    LUM_LOBE_COAT = 1,    /* E: single reflection on a dielectric; the rest is what enters the base below */
    LUM_LOBE_BOUNDARY = 2 /* E: single reflection and single transmission of a dielectric */
} lum_lobe_kind;

/*
 * How much light one reflection on the facets sends back by the cosine c that it meets the facet with: so that for any reflectance
 * F(c) of the facets E(mu) = sum over k of F(k / LUM_COSINE_STEPS) share[k] (F linear in between).  Over sqrt(mu).
 */
enum { LUM_COSINE_STEPS = 64, LUM_COSINE_NODES = 64 };
typedef struct lum_cosine_rows {
    float share[LUM_COSINE_NODES + 1][LUM_COSINE_STEPS + 1];
} lum_cosine_rows;

typedef struct lum_cosine_set {
    float alpha; /* of a set with one element */
    int count;   /* 1, or LUM_LOBE_COMPUTED_ROUGHNESSES + 1 over roughness */
    lum_cosine_rows rows[];
} lum_cosine_set;

/*
 * The same for one reflection or one refraction at the boundary of a solid: for any reflectance F of the facets, F(c) of the cosine
 * c on the side of lower index, E(mu) = without(mu) + sum over k of F(k / LUM_COSINE_STEPS) share[k].
 */
typedef struct lum_boundary_rows {
    float without[LUM_COSINE_NODES + 1]; /* F = 0: all that doesn't meet total reflection is refracted */
    float share[LUM_COSINE_NODES + 1][LUM_COSINE_STEPS + 1];
} lum_boundary_rows;

typedef struct lum_boundary_set {
    float alpha; /* -1: over roughness, as in lum_cosine_set */
    float eta;   /* relative index from the front */
    int count;
    lum_boundary_rows rows[][2]; /* from the front, from inside */
} lum_boundary_set;

/* 1 - E at every node for the reflectance f at the steps, from the front or from inside; returns 1 - E_avg. */
double lum_boundary_rests(const lum_boundary_set *set, double alpha, bool front, const float f[LUM_COSINE_STEPS + 1],
                          float rest[LUM_COSINE_NODES + 1]);

/* E at every node (sqrt(mu) = j / LUM_COSINE_NODES) for the reflectance f at the steps. */
void lum_cosine_albedos(const lum_cosine_set *set, double alpha, const float f[LUM_COSINE_STEPS + 1],
                        float albedo[LUM_COSINE_NODES + 1]);

/* For one index of the medium outside. */
typedef struct lum_medium_tables {
    float eta_outside;
    const lum_lobe_set *coat;             /* opaque dielectrics */
    const lum_lobe_set *outside, *inside; /* boundaries of solids, light from the front and from behind; NULL if not needed */
    const lum_boundary_set *changed;      /* the same where layers change the reflectance; NULL if not needed */
    double fresnel_average;               /* of the smooth boundary from the front, over the cosine-weighted hemisphere */
    double thin_average;                  /* of lum_fresnel_thin */
} lum_medium_tables;

enum { LUM_MAX_MEDIA = 8 };

/* What the lobes of one material need. */
struct lum_tables {
    const lum_lobe_set *metal; /* NULL if not needed */
    float metal_average[3];    /* Fresnel reflectance of eta, k over the cosine-weighted hemisphere */
    int media;
    lum_medium_tables medium[LUM_MAX_MEDIA];
    /* Of materials with layers; NULL if not needed. */
    const lum_cosine_set *cosines; /* of the dielectric interface over the base */
    const lum_lobe_set *clearcoat;
    const struct lum_sheen_table *sheen;
    const struct lum_film_table *film;
    const struct lum_stretched_set *stretched; /* of the metal */
    /* Of the interface over the diffuse base, for the material in air, if no texture changes it (lum_prepare_layers): E at the
     * nodes of a lum_cosine_set, and T of layer_parts.h; 0 = not known. */
    float base_albedo[LUM_COSINE_NODES + 1];
    double base_total;
    /* 1 - E and 1 - E_avg of the changed boundary in air, from the front and from inside, if no texture changes it; 0 = not known.
     */
    float changed_rest[2][LUM_COSINE_NODES + 1];
    double changed_total[2];
};

/* All tables of a model: one lum_tables per material, lobe sets shared. */
typedef struct lum_table_store {
    struct lum_tables *tables;
    lum_lobe_set **sets;
    size_t set_count;
    lum_cosine_set **cosine_sets;
    size_t cosine_set_count;
    lum_boundary_set **boundary_sets;
    size_t boundary_set_count;
    struct lum_stretched_set **stretched;
    size_t stretched_count;
    struct lum_sheen_table *sheen;
    struct lum_film_table *film;
    const struct lum_table_store *like; /* NULL, or another store: what it has already isn't made again; it has to live as long */
} lum_table_store;

/* 1 - E and 1 - E_avg at a roughness. */
double lum_lobe_rest(const lum_lobe_set *set, double alpha, double mu);
double lum_lobe_total(const lum_lobe_set *set, double alpha);
/* Squared cosine q of a direction distributed as p above; x in [0,1). */
double lum_lobe_sample(const lum_lobe_set *set, double alpha, double x);
/* The same from two numbers, faster where 1 - E hardly varies (coats): q = x is accepted with probability (1 - E(q)) / top. */
double lum_lobe_sample_flat(const lum_lobe_set *set, double alpha, double x, double y);

/* The lower one of the two lobes whose roughnesses are next to alpha; *w the weight of the other, 0 if there is none. */
static inline const lum_lobe *lum_lobe_neighbours(const lum_lobe_set *set, double alpha, double *w)
{
    *w = 0;
    if (set->count == 1) {
        return set->lobes;
    }
    double x = sqrt(alpha < 1 ? alpha : 1) * LUM_LOBE_ROUGHNESSES;
    int k = (int)x;
    k = k < LUM_LOBE_ROUGHNESSES ? k : LUM_LOBE_ROUGHNESSES - 1;
    *w = x - k;
    return &set->lobes[k];
}

/* A lower bound of lum_lobe_rest at squared cosine q. */
static inline float lum_lobe_floor(const lum_lobe_set *set, double alpha, double q)
{
    double w;
    const lum_lobe *lobe = lum_lobe_neighbours(set, alpha, &w);
    int k = (int)(q * LUM_LOBE_FLOORS);
    k = k < LUM_LOBE_FLOORS ? k : LUM_LOBE_FLOORS - 1;
    float a = lobe->floor[k], b = w > 0 ? lobe[1].floor[k] : a;
    return a < b ? a : b;
}

/* layer_tables.c: what the material's layers need. */
void lum_layer_tables_fill(lum_table_store *store, const lum_material *material, struct lum_tables *tables, bool *failed);
const lum_boundary_set *lum_boundary_set_find(lum_table_store *store, float alpha, float eta, bool *failed);
/* The set for these parameters, made if it isn't there yet.  alpha < 0: all roughnesses. */
const lum_lobe_set *lum_lobe_set_find(lum_table_store *store, lum_lobe_kind kind, float eta, float alpha, bool *failed);
/* The single-scattering albedo E(mu) by quadrature: what the tables hold. n: points per dimension. */
double lum_lobe_albedo(lum_lobe_kind kind, double alpha, double eta, double mu, int n);

/* GGX, isotropic, in the frame whose z axis is the normal. */

/* Smith's Lambda of a direction with cosine z and squared sine s2 = 1 - z^2. */
static inline double ggx_lambda(double alpha, double z, double s2)
{
    double z2 = z * z;
    return z2 > 0 ? 0.5 * (sqrt(1 + alpha * alpha * s2 / z2) - 1) : (double)INFINITY;
}

/*
 * Microfacets as seen from wi: a frame with the shading normal as z, and what all facets have in common.  Isotropic surfaces take x
 * along wi, so that wi.y = 0.  For a direction w let B(w) = sqrt(z^2 + ax^2 x^2 + ay^2 y^2) = |z| (1 + 2 Lambda).
 */
typedef struct facets {
    lmg_vec3 x, y, n; /* model frame */
    lmg_vec3 wi;      /* local */
    double ax, ay;    /* GGX widths along x and y */
    double b;         /* B(wi) */
} facets;

/* One facet; m = h * length, so that reflection needs no square root. */
typedef struct facet {
    lmg_vec3 m;    /* local, not unit */
    double mm, im; /* m.m and wi.m */
} facet;

static inline double facets_b(const facets *f, lmg_vec3 w)
{
    double x = f->ax * w.x, y = f->ay * w.y;
    return sqrt(w.z * w.z + x * x + y * y);
}

/* D(h); the sum is of positive terms, so that narrow lobes keep their precision. */
static inline double facets_d(const facets *f, lmg_vec3 h)
{
    double a2 = f->ax * f->ay, e = a2 * h.z * h.z + f->ay / f->ax * h.x * h.x + f->ax / f->ay * h.y * h.y;
    return a2 / (LUM_PI * e * e);
}

/* Isotropic, x being given: unit, in the plane of wi and n, or any if wi is n.  c, s: cosine and sine of wi with n, c > 0. */
static inline facets facets_about(lmg_vec3 n, lmg_vec3 x, double c, double s, double alpha)
{
    facets f;
    f.n = n;
    f.x = x;
    f.y = vec_cross(n, x);
    f.wi = vec(s, 0, c);
    f.ax = f.ay = alpha;
    f.b = facets_b(&f, f.wi);
    return f;
}

/* Below this square of the sine, wi is so close to the normal that the frame doesn't matter. */
#define LUM_NO_SINE 1e-24

/* Isotropic. c: cosine of wi with n, in (0,1]. */
static inline facets facets_from(lmg_vec3 n, lmg_vec3 wi, double c, double alpha)
{
    lmg_vec3 x = vec_along(wi, n, -c), y;
    double s2 = vec_dot(x, x), s = 0;
    if (s2 > LUM_NO_SINE) {
        s = sqrt(s2);
        x = vec_scale(x, 1 / s);
    } else {
        vec_frame(n, &x, &y);
    }
    return facets_about(n, x, c, s, alpha);
}

/* A facet distributed as wi sees them: visible normals [heitz2018vndf], by spherical caps [dupuy2023caps]. */
static inline facet facets_sample(const facets *f, double x, double y)
{
    facet r;
    double inverse = 1 / f->b, vz = f->wi.z * inverse;
    double si, co, z = (1 - y) * (1 + vz) - vz;
    double r2 = (1 - z) * (1 + z), q = sqrt(r2 > 0 ? r2 : 0);
    sincos_turns(x, &si, &co);
    r.m = vec(f->ax * (q * co + f->ax * f->wi.x * inverse), f->ay * (q * si + f->ay * f->wi.y * inverse),
              z + vz + 0x1p-60 /* never the zero vector */);
    r.mm = vec_dot(r.m, r.m);
    r.im = vec_dot(f->wi, r.m);
    return r;
}

/* Cosine of wi with the facet. */
static inline double facet_cosine(const facet *m)
{
    double c = m->im / sqrt(m->mm);
    return c < 1 ? c > 0 ? c : 0 : 1;
}

static inline lmg_vec3 facet_reflected(const facets *f, const facet *m)
{
    double k = 2 * m->im / m->mm;
    return vec(k * m->m.x - f->wi.x, k * m->m.y - f->wi.y, k * m->m.z - f->wi.z);
}

/* Whether light reflected towards o (local) gets away in one bounce; true with probability G2/G1, height-correlated Smith
 * [heitz2014masking] = (1 + Lambda_i) / (1 + Lambda_i + Lambda_o) = z (c + B_i) / (z B_i + c B_o). */
static inline bool facets_keep_reflected(const facets *f, lmg_vec3 o, double v)
{
    return o.z > 0 && v * (o.z * f->b + f->wi.z * facets_b(f, o)) < o.z * (f->wi.z + f->b);
}

/* Share of light refracted towards o (local, |z|) that gets away: 1 / (1 + Lambda_o). */
static inline double facets_keep_refracted(const facets *f, lmg_vec3 o)
{
    double z = -o.z;
    return z > 0 ? 2 * z / (z + facets_b(f, o)) : 0;
}

/* Density of a single reflection towards o (local), reflectance 1: visible normals, times G2/G1, times dh/dwo = 1 / (4 c).  *c:
 * cosine with the facet. */
static inline double facets_reflected_density(const facets *f, lmg_vec3 o, double *c)
{
    *c = 1;
    if (!(o.z > 0 && f->wi.z > 0)) {
        return 0;
    }
    lmg_vec3 h = vec_unit(vec_add(f->wi, o));
    *c = fmin(vec_dot(f->wi, h), 1);
    return facets_d(f, h) * o.z / (2 * (f->b * o.z + facets_b(f, o) * f->wi.z));
}

/* Density of a single refraction by the relative index eta, transmittance 1. */
static inline double facets_refracted_density(const facets *f, double eta, lmg_vec3 o, double *c)
{
    *c = 1;
    if (!(o.z < 0 && f->wi.z > 0)) {
        return 0;
    }
    lmg_vec3 h = vec_along(f->wi, o, eta);
    h = vec_scale(h, (h.z > 0 ? 1 : -1) / vec_length(h));
    double ci = vec_dot(f->wi, h), co = vec_dot(o, h);
    if (!(ci > 0 && co < 0)) {
        return 0;
    }
    *c = fmin(ci, 1);
    double j = ci + eta * co;
    /* Visible normals D G1 ci / wi.z, times G1(wo), times dh/dwo. */
    return facets_d(f, h) * ci * eta * eta * -co * 4 * -o.z / ((f->wi.z + f->b) * (facets_b(f, o) - o.z) * j * j);
}

static inline lmg_vec3 facets_to_model(const facets *f, lmg_vec3 w)
{
    return vec(w.x * f->x.x + w.y * f->y.x + w.z * f->n.x, w.x * f->x.y + w.y * f->y.y + w.z * f->n.y,
               w.x * f->x.z + w.y * f->y.z + w.z * f->n.z);
}

static inline lmg_vec3 facets_to_local(const facets *f, lmg_vec3 w)
{
    return vec(vec_dot(w, f->x), vec_dot(w, f->y), vec_dot(w, f->n));
}

/* The facet's unit normal in the model frame. */
static inline lmg_vec3 facet_normal(const facets *f, const facet *m)
{
    return facets_to_model(f, vec_scale(m->m, 1 / sqrt(m->mm)));
}

#endif
