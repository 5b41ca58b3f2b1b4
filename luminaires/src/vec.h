/* SPDX-License-Identifier: Apache-2.0 */
/* Vectors in double, and the few elementary functions that sampling needs, identical on every C library. */
#ifndef LUMINAIRES_VEC_H
#define LUMINAIRES_VEC_H

#include <lumigraph/lumigraph.h>
#include <math.h>

#define LUM_PI 3.14159265358979323846

/*
 * For functions that work on columns of numbers: compiled for several instruction sets, the best one chosen when the program starts.
 * The arithmetic is the same operation by operation (nothing is contracted or reordered), so the results are the same bits.
 */
#if defined(__x86_64__) && defined(__ELF__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define LUM_WIDE __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define LUM_WIDE
#endif

static inline lmg_vec3 vec(double x, double y, double z)
{
    lmg_vec3 r = {x, y, z};
    return r;
}
static inline lmg_vec3 vec_from_float(const float v[3])
{
    return vec((double)v[0], (double)v[1], (double)v[2]);
}
static inline lmg_vec3 vec_add(lmg_vec3 a, lmg_vec3 b)
{
    return vec(a.x + b.x, a.y + b.y, a.z + b.z);
}
static inline lmg_vec3 vec_sub(lmg_vec3 a, lmg_vec3 b)
{
    return vec(a.x - b.x, a.y - b.y, a.z - b.z);
}
static inline lmg_vec3 vec_scale(lmg_vec3 a, double s)
{
    return vec(a.x * s, a.y * s, a.z * s);
}
/* a + s b */
static inline lmg_vec3 vec_along(lmg_vec3 a, lmg_vec3 b, double s)
{
    return vec(a.x + b.x * s, a.y + b.y * s, a.z + b.z * s);
}
static inline double vec_dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline lmg_vec3 vec_cross(lmg_vec3 a, lmg_vec3 b)
{
    return vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline double vec_length(lmg_vec3 a)
{
    return sqrt(vec_dot(a, a));
}
/* a / |a|; a must not be zero. */
static inline lmg_vec3 vec_unit(lmg_vec3 a)
{
    return vec_scale(a, 1 / vec_length(a));
}

/* Two axes that make a right-handed orthonormal frame with the unit vector n.  [duff2017frame] */
static inline void vec_frame(lmg_vec3 n, lmg_vec3 *x, lmg_vec3 *y)
{
    double sign = copysign(1.0, n.z);
    double a = -1 / (sign + n.z), b = n.x * n.y * a;
    *x = vec(1 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *y = vec(b, sign + n.y * n.y * a, -n.y);
}

/*
 * Sine and cosine of 2 pi u for u in [0,1].  Taylor series on [-pi/4, pi/4]; the first terms left out are (pi/4)^15/15! = 2e-14 and
 * (pi/4)^16/16! = 1e-15 of 1 at the ends.  Faster than libm's, and the same bits with every libm.
 */
static inline void sincos_turns(double u, double *s, double *c)
{
    int k = (int)(u * 4 + 0.5);
    double r = (u - k * 0.25) * (2 * LUM_PI), q = r * r;
    double si =
        r * (1 + q * (-1.0 / 6 +
                      q * (1.0 / 120 + q * (-1.0 / 5040 + q * (1.0 / 362880 + q * (-1.0 / 39916800 + q * (1.0 / 6227020800.0)))))));
    double co =
        1 + q * (-1.0 / 2 +
                 q * (1.0 / 24 + q * (-1.0 / 720 + q * (1.0 / 40320 + q * (-1.0 / 3628800 + q * (1.0 / 479001600.0 +
                                                                                                 q * (-1.0 / 87178291200.0)))))));
    double a = k & 1 ? co : si, b = k & 1 ? si : co;
    *s = k & 2 ? -a : a;
    *c = (k + 1) & 2 ? -b : b;
}

/* A direction about n (unit) with cosine mu, sine r and azimuth u (turns). */
static inline lmg_vec3 vec_turned(lmg_vec3 n, double mu, double r, double u)
{
    lmg_vec3 x, y;
    vec_frame(n, &x, &y);
    double s, c;
    sincos_turns(u, &s, &c);
    return vec(r * (c * x.x + s * y.x) + mu * n.x, r * (c * x.y + s * y.y) + mu * n.y, r * (c * x.z + s * y.z) + mu * n.z);
}
static inline lmg_vec3 vec_about(lmg_vec3 n, double mu, double u)
{
    return vec_turned(n, mu, sqrt(mu < 1 ? (1 - mu) * (1 + mu) : 0), u);
}
/* The same with squared cosine q in [0,1]: distributed as the cosine if q is uniform. */
static inline lmg_vec3 vec_about_squared(lmg_vec3 n, double q, double u)
{
    return vec_turned(n, sqrt(q), sqrt(1 - q), u);
}

#endif
