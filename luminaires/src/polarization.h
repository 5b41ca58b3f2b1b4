/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Polarized light at interfaces: amplitudes of reflection and transmission [born1999optics, ch. 1.5 and 14.2], and the field of a
 * photon (lum_polarization) before and after.  NULL stands for light that is unpolarized at every event.
 */
#ifndef LUMINAIRES_POLARIZATION_H
#define LUMINAIRES_POLARIZATION_H

#include "scatter_parts.h"

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

INLINE interface conductor(double c, double eta, double k)
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

#endif
