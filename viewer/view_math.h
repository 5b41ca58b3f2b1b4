/* SPDX-License-Identifier: Apache-2.0 */
/* Vectors and rigid motions in double, for the viewer's own files. */
#ifndef VIEWER_VIEW_MATH_H
#define VIEWER_VIEW_MATH_H

#include <lumigraph/lumigraph.h>

#include <math.h>

#define VIEW_PI 3.14159265358979323846

static inline lmg_vec3 view_add(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline lmg_vec3 view_sub(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline lmg_vec3 view_scale(lmg_vec3 a, double f)
{
    return (lmg_vec3){a.x * f, a.y * f, a.z * f};
}

static inline lmg_vec3 view_minus(lmg_vec3 a)
{
    return (lmg_vec3){-a.x, -a.y, -a.z};
}

static inline double view_dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline lmg_vec3 view_cross(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double view_length(lmg_vec3 a)
{
    return sqrt(view_dot(a, a));
}

/* a / |a|; the caller knows that a isn't zero. */
static inline lmg_vec3 view_unit(lmg_vec3 a)
{
    return view_scale(a, 1 / view_length(a));
}

/* A rigid motion from an object's own frame to the world: world = r own + t.  r is orthonormal. */
typedef struct view_motion {
    double r[3][3];
    lmg_vec3 t;
    bool identity; /* saves the arithmetic for the room itself */
} view_motion;

static inline lmg_vec3 view_direction_out(const view_motion *m, lmg_vec3 d)
{
    if (m->identity) {
        return d;
    }
    return (lmg_vec3){m->r[0][0] * d.x + m->r[0][1] * d.y + m->r[0][2] * d.z,
                      m->r[1][0] * d.x + m->r[1][1] * d.y + m->r[1][2] * d.z,
                      m->r[2][0] * d.x + m->r[2][1] * d.y + m->r[2][2] * d.z};
}

static inline lmg_vec3 view_direction_in(const view_motion *m, lmg_vec3 d)
{
    if (m->identity) {
        return d;
    }
    return (lmg_vec3){m->r[0][0] * d.x + m->r[1][0] * d.y + m->r[2][0] * d.z,
                      m->r[0][1] * d.x + m->r[1][1] * d.y + m->r[2][1] * d.z,
                      m->r[0][2] * d.x + m->r[1][2] * d.y + m->r[2][2] * d.z};
}

static inline lmg_vec3 view_point_out(const view_motion *m, lmg_vec3 p)
{
    return m->identity ? p : view_add(view_direction_out(m, p), m->t);
}

static inline lmg_vec3 view_point_in(const view_motion *m, lmg_vec3 p)
{
    return m->identity ? p : view_direction_in(m, view_sub(p, m->t));
}

#endif
