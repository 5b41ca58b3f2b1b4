/* SPDX-License-Identifier: Apache-2.0 */
/* Small vectors, for the files of this library only.  Double precision; nothing here can fail. */
#ifndef LUMIGRAPH_VEC_H
#define LUMIGRAPH_VEC_H

#include <lumigraph/lumigraph.h>

#include <math.h>

#define LMG_PI 3.14159265358979323846

/*
 * For functions that work on columns of numbers: compiled for several instruction sets, the best one chosen when the program starts.
 * The arithmetic is the same operation by operation (nothing is contracted or reordered), so the results are the same bits.
 */
#if defined(__x86_64__) && defined(__ELF__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define LMG_WIDE __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define LMG_WIDE
#endif

/* Four numbers at once, by the vectors of GCC and Clang: arithmetic is number by number, a[k] is one of them. */
typedef float lmg_float4 __attribute__((vector_size(16)));
typedef int32_t lmg_int4 __attribute__((vector_size(16)));
typedef double lmg_double4 __attribute__((vector_size(32)));
typedef int64_t lmg_long4 __attribute__((vector_size(32))); /* what comparing them gives: all bits or none */

static inline double v_dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline lmg_vec3 v_add(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline lmg_vec3 v_sub(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline lmg_vec3 v_scale(double k, lmg_vec3 a)
{
    return (lmg_vec3){k * a.x, k * a.y, k * a.z};
}

/* a + k b */
static inline lmg_vec3 v_fma(lmg_vec3 a, double k, lmg_vec3 b)
{
    return (lmg_vec3){a.x + k * b.x, a.y + k * b.y, a.z + k * b.z};
}

static inline lmg_vec3 v_cross(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double v_length(lmg_vec3 a)
{
    return sqrt(v_dot(a, a));
}

static inline bool v_finite(lmg_vec3 a)
{
    return isfinite(a.x) && isfinite(a.y) && isfinite(a.z);
}

static inline double v_axis(lmg_vec3 a, int axis)
{
    return axis == 0 ? a.x : axis == 1 ? a.y : a.z;
}

/* Without fmin's care for NaN, which costs a call. */
static inline double d_min(double x, double y)
{
    return x < y ? x : y;
}

static inline double d_max(double x, double y)
{
    return x > y ? x : y;
}

static inline double d_clamp(double x, double lo, double hi)
{
    return x < lo ? lo : x > hi ? hi : x;
}

#endif
