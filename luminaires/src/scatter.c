/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Scattering at surfaces: sample, evaluate, pdf.  Relies on microfacet.h for rough lobes and their albedo tables.
 *
 * The model.  A surface is a mixture by area of (PBR) a metal with share `metallic`, a clear dielectric with share `transmission`
 * of the rest, and a coated diffuser; the other kinds are one of these alone.
 * - Metal: GGX.  Without eta, k the reflectance is the base colour at all angles: a base colour doesn't determine a complex index,
 *   and the unpolarized reflectance of Al, Ag, Au, Cu, Cr, Fe and Ni stays within 0.035 of its normal value up to 70 degrees (0.08
 *   at 80), less than what is known of most base colours.  With eta, k: Fresnel's formulae.
 * - Clear dielectric.  Thin: reflects and transmits straight on (rough: mirrored at the surface); solid: refracts.  The base colour
 *   multiplies what is transmitted, at each transmission, as glTF has it.
 * - Coated diffuser: a dielectric interface over a diffuse base; the base colour is the share of the light entering the base that
 *   comes back, and it comes back with the reciprocal density proportional to (1 - E(mu)) mu.  Seen from inside of a solid that it
 *   shares a surface with, the base has no interface.
 *
 * Light that one bounce on microfacets loses goes where microfacet.h says, so lossless surfaces stay lossless.
 *
 * Normals.  Diffuse lobes and the multiple-scattering lobes are about the geometric normal, where flux through the surface is
 * defined; mirrors and single-scattering lobes are about the shading normal.  If light arrives from below the shading normal's
 * horizon, the geometric normal is used.  A direction on the wrong side of the geometric surface is mirrored at it, with unchanged
 * weight.  So no light is lost, gained or leaked by interpolated normals, and the density remains known: a lobe's value at a
 * direction plus its value at the mirrored direction.
 */
#include "microfacet.h"

#include <string.h>

/* Relative steps of the index below this are none: they would reflect less than 1e-12 and deflect by less than 1e-6 tan(theta). */
#define LUM_NO_STEP 1e-6

#define INLINE static inline __attribute__((always_inline))

/* ------------------------------------------------------------------------------------------------------------ geometry */

/* The surface as the incoming light sees it. */
typedef struct side {
    lmg_vec3 n, g; /* shading and geometric normal, on the side of wi */
    double ci, cg; /* cosines of wi with them, > 0 (cg may be 0 for light along the surface) */
    bool front;
    bool tilted; /* n differs from g */
} side;

INLINE side side_of(const lum_surface *surface, lmg_vec3 wi)
{
    side r;
    double cg = vec_dot(wi, surface->ng);
    r.front = cg >= 0;
    r.g = r.front ? surface->ng : vec_scale(surface->ng, -1);
    r.cg = fabs(cg);
    r.tilted = false;
    r.n = r.g;
    r.ci = r.cg;
    if (surface->tilted) {
        lmg_vec3 n = r.front ? surface->ns : vec_scale(surface->ns, -1);
        double ci = vec_dot(wi, n);
        if (ci > 0) {
            r.n = n;
            r.ci = ci;
            r.tilted = true;
        }
    }
    /* Rounding of unit vectors gives cosines up to 1 + 4e-16; exactly grazing light would divide by zero below. */
    r.ci = r.ci < 1 ? r.ci > 1e-12 ? r.ci : 1e-12 : 1;
    return r;
}

/* w mirrored at the plane with unit normal m. */
INLINE lmg_vec3 mirrored(lmg_vec3 w, lmg_vec3 m)
{
    return vec_along(w, m, -2 * vec_dot(w, m));
}

/* Uniform numbers are used up by choices: true with probability p, and *u is uniform again. */
INLINE bool choose(double *u, double p)
{
    if (p <= 0) {
        return false;
    }
    if (p >= 1) {
        return true;
    }
    bool yes = *u < p;
    double v = yes ? *u / p : (*u - p) / (1 - p);
    *u = v < 1 ? v : 0x1.fffffffffffffp-1;
    return yes;
}

/* ------------------------------------------------------------------------------------------------------- polarization */

INLINE void depolarize(lum_polarization *pol)
{
    if (pol) {
        pol->known = false;
    }
}

INLINE void mirror_field(lum_polarization *pol, lmg_vec3 n)
{
    if (pol && pol->known) {
        pol->re = mirrored(pol->re, n);
        pol->im = mirrored(pol->im, n);
    }
}

/* Unit vector perpendicular to the plane of incidence of light travelling along d on a surface with normal m (any perpendicular to
 * d at normal incidence). */
INLINE lmg_vec3 s_axis(lmg_vec3 d, lmg_vec3 m)
{
    lmg_vec3 s = vec_cross(d, m);
    double l2 = vec_dot(s, s);
    /* Below 1e-20 the angle of incidence is under 1e-10 and both polarizations are reflected alike. */
    if (l2 > 1e-20) {
        return vec_scale(s, 1 / sqrt(l2));
    }
    lmg_vec3 x, y;
    vec_frame(d, &x, &y);
    return x;
}

typedef struct complex2 {
    double re, im;
} complex2;

INLINE complex2 times(complex2 a, complex2 b)
{
    complex2 r = {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
    return r;
}

INLINE complex2 divide(complex2 a, complex2 b)
{
    double n = 1 / (b.re * b.re + b.im * b.im);
    complex2 r = {(a.re * b.re + a.im * b.im) * n, (a.im * b.re - a.re * b.im) * n};
    return r;
}

/* What an interface does to a photon: amplitudes of the perpendicular (s) and parallel (p) fields, with |a|^2 = share of the flux.
 */
typedef struct interface {
    double ct;       /* cosine of refraction; meaningless beyond the critical angle */
    complex2 rs, rp; /* reflection */
    double fs, fp;   /* |rs|^2, |rp|^2 */
} interface;

INLINE interface dielectric(double c, double eta)
{
    interface r;
    double ct2 = 1 - (1 - c) * (1 + c) / (eta * eta);
    if (ct2 > 0) {
        r.ct = sqrt(ct2);
        r.rs = (complex2){(c - eta * r.ct) / (c + eta * r.ct), 0};
        r.rp = (complex2){(eta * c - r.ct) / (eta * c + r.ct), 0};
        r.fs = r.rs.re * r.rs.re;
        r.fp = r.rp.re * r.rp.re;
    } else {
        /* Total reflection: cos of refraction is -i kappa, which turns the phases. */
        double kappa = sqrt(-ct2);
        r.ct = 0;
        r.rs = divide((complex2){c, eta * kappa}, (complex2){c, -eta * kappa});
        r.rp = divide((complex2){eta * c, kappa}, (complex2){eta * c, -kappa});
        r.fs = r.fp = 1;
    }
    return r;
}

INLINE interface thin_wall(double c, double eta)
{
    interface r = dielectric(c, eta);
    r.fs = 2 * r.fs / (1 + r.fs);
    r.fp = 2 * r.fp / (1 + r.fp);
    r.rs = (complex2){copysign(sqrt(r.fs), r.rs.re), 0};
    r.rp = (complex2){copysign(sqrt(r.fp), r.rp.re), 0};
    return r;
}

static interface conductor(double c, double eta, double k)
{
    interface r;
    double s2 = (1 - c) * (1 + c), d = eta * eta - k * k - s2;
    double modulus = sqrt(d * d + 4 * eta * eta * k * k);
    double a = sqrt(fmax(0.5 * (modulus + d), 0)), b = sqrt(fmax(0.5 * (modulus - d), 0));
    complex2 e2 = {(eta * eta - k * k) * c, -2 * eta * k * c}; /* (eta - i k)^2 c */
    r.ct = 0;
    r.rs = divide((complex2){c - a, b}, (complex2){c + a, -b});
    r.rp = divide((complex2){e2.re - a, e2.im + b}, (complex2){e2.re + a, e2.im - b});
    r.fs = r.rs.re * r.rs.re + r.rs.im * r.rs.im;
    r.fp = r.rp.re * r.rp.re + r.rp.im * r.rp.im;
    return r;
}

/* Shares of the flux in the two polarizations, and their amplitudes, of light travelling along d. */
typedef struct shares {
    double s, p;
    complex2 es, ep;
    lmg_vec3 axis; /* s_axis; of known polarization only */
} shares;

INLINE shares shares_of(const lum_polarization *pol, lmg_vec3 d, lmg_vec3 m)
{
    shares r = {0.5, 0.5, {0, 0}, {0, 0}, {0, 0, 0}};
    if (pol && pol->known) {
        r.axis = s_axis(d, m);
        lmg_vec3 p = vec_cross(r.axis, d);
        r.es = (complex2){vec_dot(pol->re, r.axis), vec_dot(pol->im, r.axis)};
        r.ep = (complex2){vec_dot(pol->re, p), vec_dot(pol->im, p)};
        double s = r.es.re * r.es.re + r.es.im * r.es.im, q = r.ep.re * r.ep.re + r.ep.im * r.ep.im;
        /* Their sum is 1 but for rounding along the path; renormalized at every event. */
        double n = s + q > 0 ? 1 / (s + q) : 0;
        r.s = n > 0 ? s * n : 0.5;
        r.p = n > 0 ? q * n : 0.5;
    }
    return r;
}

/* The field after an event with amplitudes as, ap (a, b: their squares) on a surface with normal m, from d to wo.  Unpolarized
 * light becomes one of the two linear states, in proportion to their shares after the event, chosen by *u. */
INLINE void set_field(lum_polarization *pol, const shares *in, complex2 as, complex2 ap, double a, double b, lmg_vec3 d, lmg_vec3 m,
                      lmg_vec3 wo, double *u)
{
    if (!pol) {
        return;
    }
    if (pol->known) {
        lmg_vec3 s = in->axis, p = vec_cross(s, wo);
        complex2 es = times(as, in->es), ep = times(ap, in->ep);
        lmg_vec3 re = vec_along(vec_scale(s, es.re), p, ep.re), im = vec_along(vec_scale(s, es.im), p, ep.im);
        double n2 = vec_dot(re, re) + vec_dot(im, im);
        if (n2 > 0) {
            double n = 1 / sqrt(n2);
            pol->re = vec_scale(re, n);
            pol->im = vec_scale(im, n);
        } else {
            pol->known = false;
        }
    } else {
        if (a + b > 0) {
            pol->re = s_axis(d, m);
            if (!choose(u, a / (a + b))) {
                pol->re = vec_cross(pol->re, wo);
            }
            pol->im = vec(0, 0, 0);
            pol->known = true;
        }
    }
}

INLINE complex2 passed(double f)
{
    return (complex2){sqrt(f < 1 ? 1 - f : 0), 0};
}

/* --------------------------------------------------------------------------------------------------------------- lobes */

INLINE void set_weight(lum_scattered *out, const float w[3])
{
    out->weight[0] = w[0];
    out->weight[1] = w[1];
    out->weight[2] = w[2];
}

INLINE void set_white(lum_scattered *out)
{
    out->weight[0] = out->weight[1] = out->weight[2] = 1;
}

/* Leaves along wo on the side of wi, mirrored there if it points below the geometric surface. */
INLINE void leave(const side *at, lmg_vec3 wo, bool above, lum_polarization *pol, lum_scattered *out)
{
    if (at->tilted) {
        double c = vec_dot(wo, at->g);
        if (above ? c < 0 : c > 0) {
            wo = vec_along(wo, at->g, -2 * c);
            mirror_field(pol, at->g);
        }
    }
    out->wo = wo;
}

static const lum_medium_tables *medium_of(const struct lum_tables *tables, float eta_outside)
{
    for (int i = 0; i < tables->media; i++) {
        if (tables->medium[i].eta_outside == eta_outside) {
            return &tables->medium[i];
        }
    }
    return &tables->medium[0]; /* a medium from another model: the energy stays exact, eval and pdf of the rest approximate */
}

INLINE void metal_average(const lum_surface *surface, float average[3])
{
    for (int c = 0; c < 3; c++) {
        average[c] = surface->material->has_eta ? surface->tables->metal_average[c] : surface->base[c];
    }
}

/* Reflectance of light that is scattered more than once, when a bounce reflects r on average and keeps the share 1 - e: the
 * geometric series r^2 e / (1 - r (1 - e)) [kulla2017imageworks]. */
INLINE float repeated(float r, double lost)
{
    double d = 1 - (double)r * lost;
    return d > 0 ? (float)((double)r * (double)r * (1 - lost) / d) : r;
}

/* A microfacet as seen from wi. */
typedef struct facet {
    double c;   /* cosine of wi with its normal */
    lmg_vec3 h; /* its normal; axes: x in the plane of incidence towards wi, z the shading normal */
} facet;

INLINE facet sample_facet(const side *at, lmg_vec3 wi, double alpha, const double xi[4])
{
    facet f;
    double s = vec_length(vec_along(wi, at->n, -at->ci));
    f.h = ggx_sample_visible(alpha, s, at->ci, xi[0], xi[1]);
    f.c = s * f.h.x + at->ci * f.h.z;
    f.c = f.c < 1 ? f.c : 1;
    return f;
}

/* Its normal in the model frame. */
INLINE lmg_vec3 facet_normal(const side *at, lmg_vec3 wi, const facet *f)
{
    lmg_vec3 x = vec_along(wi, at->n, -at->ci), y;
    double s2 = vec_dot(x, x);
    if (s2 > 1e-24) { /* closer to the normal the frame doesn't matter */
        x = vec_scale(x, 1 / sqrt(s2));
        y = vec_cross(at->n, x);
    } else {
        vec_frame(at->n, &x, &y);
    }
    return vec(f->h.x * x.x + f->h.y * y.x + f->h.z * at->n.x, f->h.x * x.y + f->h.y * y.y + f->h.z * at->n.y,
               f->h.x * x.z + f->h.y * y.z + f->h.z * at->n.z);
}

/* Share of the light reflected at the facet that gets away in one bounce: G2/G1, height-correlated Smith [heitz2014masking]. */
INLINE double keeps_reflected(const side *at, const facet *f, double alpha)
{
    double z = 2 * f->c * f->h.z - at->ci;
    if (!(z > 0)) {
        return 0;
    }
    z = z < 1 ? z : 1;
    double a = 1 + ggx_lambda(alpha, at->ci, (1 - at->ci) * (1 + at->ci));
    return a / (a + ggx_lambda(alpha, z, (1 - z) * (1 + z)));
}

/* Mirror or rough metal; the choice is made: all of the light is here. */
INLINE void sample_metal(const lum_surface *surface, const side *at, lmg_vec3 wi, const double xi[4], double u,
                         lum_polarization *pol, lum_scattered *out)
{
    lmg_vec3 m = at->n;
    double c = at->ci;
    bool rough = surface->alpha >= LUM_SMOOTH;
    out->event = LUM_REFLECTED | (rough ? 0 : LUM_DELTA);
    if (rough) {
        double alpha = (double)surface->alpha, v = xi[2];
        facet f = sample_facet(at, wi, alpha, xi);
        if (!choose(&v, keeps_reflected(at, &f, alpha))) {
            out->wo = vec_about_squared(at->g, lum_lobe_sample(surface->tables->metal, alpha, v), u);
            float average[3];
            metal_average(surface, average);
            double lost = lum_lobe_total(surface->tables->metal, alpha);
            for (int i = 0; i < 3; i++) {
                out->weight[i] = repeated(average[i], lost);
            }
            depolarize(pol);
            return;
        }
        m = facet_normal(at, wi, &f);
        c = f.c;
    }
    lmg_vec3 wo = vec_along(vec_scale(wi, -1), m, 2 * c);
    if (!surface->material->has_eta) {
        set_weight(out, surface->base);
        if (pol && pol->known) {
            mirror_field(pol, m); /* an ideal conductor: E' = 2 (E.m) m - E; the sign of the whole doesn't matter */
        }
    } else {
        lmg_vec3 d = vec_scale(wi, -1);
        shares in = shares_of(pol, d, m);
        const lum_material *material = surface->material;
        interface green = {0};
        for (int i = 0; i < 3; i++) {
            interface f = conductor(c, (double)material->eta[i], (double)material->k[i]);
            out->weight[i] = (float)(in.s * f.fs + in.p * f.fp);
            if (i == 1) {
                green = f; /* one field for the three colours: that of the channel with most of the luminance */
            }
        }
        set_field(pol, &in, green.rs, green.rp, green.fs, green.fp, d, m, wo, &u);
    }
    leave(at, wo, true, pol, out);
}

/* Light that enters the base of a coated diffuser (coat NULL: no interface). */
INLINE void sample_base(const lum_surface *surface, const side *at, const lum_lobe_set *coat, double azimuth, double u,
                        lum_polarization *pol, lum_scattered *out)
{
    bool through = choose(&u, (double)surface->diffuse_transmission);
    double q = coat ? lum_lobe_sample(coat, (double)surface->alpha, u) : u;
    depolarize(pol);
    out->wo = vec_about_squared(through ? vec_scale(at->g, -1) : at->g, q, azimuth);
    out->event = through ? LUM_TRANSMITTED : LUM_REFLECTED;
    set_weight(out, through ? surface->material->diffuse_transmission_color : surface->base);
}

INLINE void sample_coated(const lum_surface *surface, const side *at, lmg_vec3 wi, const lum_lobe_set *coat, double eta,
                          const double xi[4], double u, lum_polarization *pol, lum_scattered *out)
{
    bool rough = surface->alpha >= LUM_SMOOTH;
    lmg_vec3 m = at->n, d = vec_scale(wi, -1);
    double c = at->ci, alpha = (double)surface->alpha, v = xi[2];
    facet h = {0};
    if (rough) {
        h = sample_facet(at, wi, alpha, xi);
        c = h.c;
        if (pol && pol->known) {
            m = facet_normal(at, wi, &h);
        }
    }
    interface f = dielectric(c, eta);
    shares in = shares_of(pol, d, m);
    if (!choose(&u, in.s * f.fs + in.p * f.fp) || (rough && !choose(&v, keeps_reflected(at, &h, alpha)))) {
        sample_base(surface, at, coat, v, u, pol, out);
        return;
    }
    if (rough) {
        m = facet_normal(at, wi, &h);
    }
    lmg_vec3 wo = vec_along(d, m, 2 * c);
    set_white(out);
    out->event = LUM_REFLECTED | (rough ? 0 : LUM_DELTA);
    set_field(pol, &in, f.rs, f.rp, f.fs, f.fp, d, m, wo, &u);
    leave(at, wo, true, pol, out);
}

/* The densities of what comes back from the rough boundary of a solid after more than one bounce: the share that is transmitted.
 * Reciprocity wants share_outside * n_outside^2 * lost_outside = share_inside * n_inside^2 * lost_inside; of the values that meet
 * it, this is the largest up to the smooth boundary's own transmittance. */
INLINE double repeated_through(const lum_medium_tables *t, double alpha, double eta, bool front)
{
    double lost_out = lum_lobe_total(t->outside, alpha), lost_in = lum_lobe_total(t->inside, alpha);
    double index2 = front ? eta * eta : 1 / (eta * eta); /* (n_inside / n_outside)^2 */
    double a = lost_out, b = lost_in * index2;
    double k = fmin(b, (1 - t->fresnel_average) * a);
    return front ? k / a : k / b;
}

/* The clear share of a dielectric: boundary of a solid, or thin wall.  eta: relative index across. */
INLINE void sample_clear(const lum_surface *surface, const side *at, lmg_vec3 wi, const lum_medium_tables *tables, double eta,
                         const double xi[4], double u, lum_polarization *pol, lum_scattered *out)
{
    bool thin = surface->material->thin, rough = surface->alpha >= LUM_SMOOTH;
    int boundary = thin ? 0 : LUM_BOUNDARY;
    lmg_vec3 d = vec_scale(wi, -1);
    if (fabs(eta - 1) < LUM_NO_STEP) {
        out->wo = d;
        out->event = LUM_TRANSMITTED | LUM_DELTA | boundary;
        set_weight(out, surface->base);
        return;
    }
    int delta = rough ? 0 : LUM_DELTA;
    lmg_vec3 m = at->n;
    double c = at->ci, alpha = (double)surface->alpha, v = xi[2];
    facet h = {0};
    if (rough) {
        h = sample_facet(at, wi, alpha, xi);
        m = facet_normal(at, wi, &h);
        c = h.c;
    }
    interface f = thin ? thin_wall(c, eta) : dielectric(c, eta);
    shares in = shares_of(pol, d, m);
    bool reflected = choose(&u, in.s * f.fs + in.p * f.fp);
    if (reflected) {
        if (rough && !choose(&v, keeps_reflected(at, &h, alpha))) {
            goto repeated;
        }
        lmg_vec3 wo = vec_along(d, m, 2 * c);
        set_white(out);
        out->event = LUM_REFLECTED | delta;
        set_field(pol, &in, f.rs, f.rp, f.fs, f.fp, d, m, wo, &u);
        leave(at, wo, true, pol, out);
        return;
    }
    if (thin) {
        /* Reflected, then mirrored at the surface.  Of the field the component along the mirrored wo x s changes sign, so that a
         * wall straight on leaves the field as it is. */
        if (rough && !choose(&v, keeps_reflected(at, &h, alpha))) {
            goto repeated;
        }
        lmg_vec3 wo = vec_along(d, m, 2 * c);
        complex2 tp = passed(f.fp);
        tp.re = -tp.re;
        set_field(pol, &in, passed(f.fs), tp, 1 - f.fs, 1 - f.fp, d, m, wo, &u);
        mirror_field(pol, at->n);
        wo = rough ? mirrored(wo, at->n) : d;
        set_weight(out, surface->base);
        out->event = LUM_TRANSMITTED | delta;
        leave(at, wo, false, pol, out);
        return;
    }
    lmg_vec3 wo = vec_along(vec_scale(d, 1 / eta), m, c / eta - f.ct);
    if (rough) {
        double z = -vec_dot(wo, at->n);
        z = z < 1 ? z : 1;
        double keep = z > 0 ? 1 / (1 + ggx_lambda(alpha, z, (1 - z) * (1 + z))) : 0;
        if (!choose(&v, keep)) {
            goto repeated;
        }
    }
    set_weight(out, surface->base);
    out->event = LUM_TRANSMITTED | LUM_BOUNDARY | delta;
    set_field(pol, &in, passed(f.fs), passed(f.fp), 1 - f.fs, 1 - f.fp, d, m, wo, &u);
    leave(at, wo, false, pol, out);
    return;

repeated:
    depolarize(pol);
    const lum_lobe_set *same, *other;
    double through;
    if (thin) {
        same = other = surface->tables->metal;
        through = 1 - tables->thin_average;
    } else {
        same = at->front ? tables->outside : tables->inside;
        other = at->front ? tables->inside : tables->outside;
        through = repeated_through(tables, alpha, eta, at->front);
    }
    if (choose(&u, through)) {
        out->wo = vec_about_squared(vec_scale(at->g, -1), lum_lobe_sample(other, alpha, u), v);
        out->event = LUM_TRANSMITTED | boundary;
        set_weight(out, surface->base);
    } else {
        out->wo = vec_about_squared(at->g, lum_lobe_sample(same, alpha, u), v);
        out->event = LUM_REFLECTED;
        set_white(out);
    }
}

/* ------------------------------------------------------------------------------------------------------------ sampling */

static const lum_lobe_set *coat_of(const lum_surface *surface, const lum_medium_tables *tables, bool front)
{
    bool from_inside = !front && surface->transmission > 0 && !surface->material->thin;
    return from_inside ? NULL : tables->coat;
}

INLINE void scatter(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4], lum_polarization *pol,
                    lum_scattered *out)
{
    side at = side_of(surface, wi);
    double u = xi[3];
    out->pdf = 0;
    switch (surface->kind) {
    case LUM_SURFACE_LAMBERT: {
        bool through = choose(&u, (double)surface->diffuse_transmission);
        depolarize(pol);
        out->event = through ? LUM_TRANSMITTED : LUM_REFLECTED;
        set_weight(out, through ? surface->material->diffuse_transmission_color : surface->base);
        out->wo = vec_about_squared(through ? vec_scale(at.g, -1) : at.g, xi[1], xi[0]);
        return;
    }
    case LUM_SURFACE_CONDUCTOR:
        sample_metal(surface, &at, wi, xi, u, pol, out);
        return;
    case LUM_SURFACE_PBR: {
        if (choose(&u, (double)surface->metallic)) {
            sample_metal(surface, &at, wi, xi, u, pol, out);
            return;
        }
        const lum_medium_tables *tables = medium_of(surface->tables, eta_outside);
        double eta = (double)surface->material->ior / (double)eta_outside;
        if (choose(&u, (double)surface->transmission)) {
            bool outward = !at.front && !surface->material->thin;
            sample_clear(surface, &at, wi, tables, outward ? 1 / eta : eta, xi, u, pol, out);
            return;
        }
        const lum_lobe_set *coat = coat_of(surface, tables, at.front);
        if (coat) {
            sample_coated(surface, &at, wi, coat, eta, xi, u, pol, out);
        } else {
            sample_base(surface, &at, NULL, xi[0], u, pol, out);
        }
        return;
    }
    case LUM_SURFACE_BLACK:
    default:
        out->event = LUM_ABSORBED;
        out->wo = at.g;
        out->weight[0] = out->weight[1] = out->weight[2] = 0;
        return;
    }
}

void lum_scatter_trace(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4],
                       lum_polarization *polarization, lum_scattered *out)
{
    scatter(surface, wi, eta_outside, xi, polarization, out);
}

void lum_scatter_sample(const lum_surface *surface, lmg_vec3 wi, float eta_outside, const double xi[4], lum_scattered *out)
{
    scatter(surface, wi, eta_outside, xi, NULL, out);
    if (out->event & LUM_DELTA) {
        out->pdf = 1;
    } else if (out->event != LUM_ABSORBED) {
        out->pdf = lum_scatter_pdf(surface, wi, out->wo, eta_outside);
    }
}

/* ---------------------------------------------------------------------------------------------------------- evaluation */

/* Densities of the lobes about the shading normal at wo, in the frame of wi: reflection for wo on its side, else transmission. */
typedef struct density {
    double pdf; /* of directions, all reflectances 1 */
    double p[3];
} density;

INLINE void add(density *sum, double pdf, const float weight[3])
{
    sum->pdf += pdf;
    for (int i = 0; i < 3; i++) {
        sum->p[i] += pdf * (double)weight[i];
    }
}

static const float white[3] = {1, 1, 1};

typedef struct frame {
    lmg_vec3 x, y, n;
} frame;

INLINE lmg_vec3 to_local(const frame *f, lmg_vec3 w)
{
    return vec(vec_dot(w, f->x), vec_dot(w, f->y), vec_dot(w, f->n));
}

/* Density of a single reflection on microfacets, reflectance 1; *c: cosine with the facet. */
INLINE double reflected_density(double alpha, lmg_vec3 wi, lmg_vec3 wo, double *c)
{
    *c = 1;
    if (!(wo.z > 0 && wi.z > 0)) {
        return 0;
    }
    lmg_vec3 h = vec_unit(vec_add(wi, wo));
    *c = fmin(vec_dot(wi, h), 1);
    double a = ggx_lambda(alpha, wi.z, wi.x * wi.x + wi.y * wi.y), b = ggx_lambda(alpha, wo.z, wo.x * wo.x + wo.y * wo.y);
    return ggx_d(alpha, h) / ((1 + a + b) * 4 * wi.z);
}

/* Density of a single refraction, transmittance 1 - F included. */
INLINE double refracted_density(double alpha, double eta, lmg_vec3 wi, lmg_vec3 wo)
{
    if (!(wo.z < 0 && wi.z > 0)) {
        return 0;
    }
    lmg_vec3 h = vec_along(wi, wo, eta);
    h = vec_scale(h, (h.z > 0 ? 1 : -1) / vec_length(h));
    double ci = vec_dot(wi, h), co = vec_dot(wo, h);
    if (!(ci > 0 && co < 0)) {
        return 0;
    }
    double a = ggx_lambda(alpha, wi.z, wi.x * wi.x + wi.y * wi.y), b = ggx_lambda(alpha, wo.z, wo.x * wo.x + wo.y * wo.y);
    double j = ci + eta * co, f = lum_fresnel_dielectric(ci, eta);
    /* Visible normals D G1 ci / wi.z, times 1 - F, times G1(wo), times dh/dwo. */
    return ggx_d(alpha, h) * ci * (1 - f) * eta * eta * -co / ((1 + a) * (1 + b) * wi.z * j * j);
}

/* The lobes about the shading normal, towards wo.  Shares of the mixture: metal, clear, coated. */
static void add_facets(const lum_surface *surface, const side *at, const frame *f, lmg_vec3 wi, lmg_vec3 wo, double eta, bool coat,
                       const double share[3], density *sum)
{
    double alpha = (double)surface->alpha, c;
    lmg_vec3 i = to_local(f, wi), o = to_local(f, wo);
    bool thin = surface->material->thin;
    (void)at;
    if (o.z > 0) {
        double d = reflected_density(alpha, i, o, &c);
        if (share[0] > 0) {
            float r[3] = {surface->base[0], surface->base[1], surface->base[2]};
            if (surface->material->has_eta) {
                for (int k = 0; k < 3; k++) {
                    r[k] = (float)lum_fresnel_conductor(c, (double)surface->material->eta[k], (double)surface->material->k[k]);
                }
            }
            add(sum, share[0] * d, r);
        }
        if (share[1] > 0) {
            add(sum, share[1] * d * (thin ? lum_fresnel_thin(c, eta) : lum_fresnel_dielectric(c, eta)), white);
        }
        if (share[2] > 0 && coat) {
            add(sum, share[2] * d * lum_fresnel_dielectric(c, eta), white);
        }
    } else if (share[1] > 0) {
        if (thin) {
            double d = reflected_density(alpha, i, vec(o.x, o.y, -o.z), &c);
            add(sum, share[1] * d * (1 - lum_fresnel_thin(c, eta)), surface->base);
        } else {
            add(sum, share[1] * refracted_density(alpha, eta, i, o), surface->base);
        }
    }
}

/* Density of a lobe of microfacet.h. */
INLINE double rest_density(const lum_lobe_set *set, double alpha, double mu)
{
    return lum_lobe_rest(set, alpha, mu) * mu / (LUM_PI * lum_lobe_total(set, alpha));
}

static density density_of(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside)
{
    density sum = {0};
    side at = side_of(surface, wi);
    double co = vec_dot(wo, at.g), mu = fmin(fabs(co), 1);
    bool above = co > 0, rough = surface->alpha >= LUM_SMOOTH;
    double alpha = (double)surface->alpha;
    const lum_material *material = surface->material;
    double share[3] = {0, 0, 0};

    if (co == 0) {
        return sum;
    }
    if (surface->kind == LUM_SURFACE_LAMBERT) {
        double d = (double)surface->diffuse_transmission;
        add(&sum, (above ? 1 - d : d) * mu / LUM_PI, above ? surface->base : material->diffuse_transmission_color);
        return sum;
    }
    if (surface->kind == LUM_SURFACE_CONDUCTOR) {
        share[0] = 1;
    } else if (surface->kind == LUM_SURFACE_PBR) {
        share[0] = (double)surface->metallic;
        share[1] = (1 - share[0]) * (double)surface->transmission;
        share[2] = 1 - share[0] - share[1];
    } else {
        return sum;
    }

    const lum_medium_tables *tables = surface->kind == LUM_SURFACE_PBR ? medium_of(surface->tables, eta_outside) : NULL;
    double eta = (double)material->ior / (double)eta_outside;
    const lum_lobe_set *coat = share[2] > 0 ? coat_of(surface, tables, at.front) : NULL;
    bool outward = !at.front && !material->thin && surface->transmission > 0;
    double across = outward ? 1 / eta : eta; /* the relative index that light from wi meets */
    if (fabs(across - 1) < LUM_NO_STEP) {
        share[1] = 0; /* straight through: a delta */
    }

    if (rough) {
        frame f;
        f.n = at.n;
        vec_frame(f.n, &f.x, &f.y);
        add_facets(surface, &at, &f, wi, wo, across, coat != NULL, share, &sum);
        if (at.tilted) {
            /* What pointed to the wrong side of the geometric surface was mirrored at it.  A lobe about n that is on the other side
             * of the geometric surface than this direction comes from there. */
            lmg_vec3 other = mirrored(wo, at.g);
            double no = vec_dot(other, at.n);
            density folded = {0};
            if (above ? no > 0 : no < 0) {
                add_facets(surface, &at, &f, wi, other, across, coat != NULL, share, &folded);
            }
            /* And the lobe at wo itself counts only if it is meant for this side. */
            double n = vec_dot(wo, at.n);
            if (above ? n <= 0 : n >= 0) {
                memset(&sum, 0, sizeof sum);
            }
            sum.pdf += folded.pdf;
            for (int i = 0; i < 3; i++) {
                sum.p[i] += folded.p[i];
            }
        }
        if (share[0] > 0) {
            if (above) {
                float average[3], weight[3];
                double lost = lum_lobe_total(surface->tables->metal, alpha);
                metal_average(surface, average);
                for (int i = 0; i < 3; i++) {
                    weight[i] = repeated(average[i], lost);
                }
                double rest = lum_lobe_rest(surface->tables->metal, alpha, at.ci);
                add(&sum, share[0] * rest * rest_density(surface->tables->metal, alpha, mu), weight);
            }
        }
        if (share[1] > 0) {
            const lum_lobe_set *same = surface->tables->metal, *other = same;
            double through = 1 - tables->thin_average;
            if (!material->thin) {
                same = at.front ? tables->outside : tables->inside;
                other = at.front ? tables->inside : tables->outside;
                through = repeated_through(tables, alpha, across, at.front);
            }
            double rest = share[1] * lum_lobe_rest(same, alpha, at.ci);
            if (above) {
                add(&sum, rest * (1 - through) * rest_density(same, alpha, mu), white);
            } else {
                add(&sum, rest * through * rest_density(other, alpha, mu), surface->base);
            }
        }
    }
    if (share[2] > 0) {
        double enters = coat ? (rough ? lum_lobe_rest(coat, alpha, at.ci) : 1 - lum_fresnel_dielectric(at.ci, across)) : 1;
        double d = (double)surface->diffuse_transmission;
        double lobe = coat ? rest_density(coat, alpha, mu) : mu / LUM_PI;
        add(&sum, share[2] * enters * (above ? 1 - d : d) * lobe, above ? surface->base : material->diffuse_transmission_color);
    }
    return sum;
}

void lum_scatter_eval(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside, float p[3])
{
    density d = density_of(surface, wi, wo, eta_outside);
    p[0] = (float)d.p[0];
    p[1] = (float)d.p[1];
    p[2] = (float)d.p[2];
}

double lum_scatter_pdf(const lum_surface *surface, lmg_vec3 wi, lmg_vec3 wo, float eta_outside)
{
    return density_of(surface, wi, wo, eta_outside).pdf;
}
