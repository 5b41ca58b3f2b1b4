/* SPDX-License-Identifier: Apache-2.0 */
/* From the double positions of the parts to the model's arrays: centre, rounding to float, triangles without area dropped, normals
 * and tangents completed, bounds.  Materials and parts are known. */
#include "model_build.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct vec {
    double x[3];
} vec;

static vec minus(vec a, vec b)
{
    return (vec){{a.x[0] - b.x[0], a.x[1] - b.x[1], a.x[2] - b.x[2]}};
}

static vec cross(vec a, vec b)
{
    return (vec){{a.x[1] * b.x[2] - a.x[2] * b.x[1], a.x[2] * b.x[0] - a.x[0] * b.x[2], a.x[0] * b.x[1] - a.x[1] * b.x[0]}};
}

static double dot(vec a, vec b)
{
    return a.x[0] * b.x[0] + a.x[1] * b.x[1] + a.x[2] * b.x[2];
}

static vec load(const float *p)
{
    return (vec){{(double)p[0], (double)p[1], (double)p[2]}};
}

static void store(float *p, vec v)
{
    for (int i = 0; i < 3; i++)
        p[i] = (float)v.x[i];
}

/* In the model's unit. */
static vec corner(const lum_model *m, uint32_t triangle, int k)
{
    return load(m->positions + 3 * (size_t)m->indices[3 * (size_t)triangle + (size_t)k]);
}

/* Twice the area times the unit normal of a triangle; zero when it has no area.  The rounded positions decide, since they are what
 * rays meet: their differences are exact in double, so the cross product of two parallel edges is at most 2 eps |e1||e2| off zero
 * in each component, 2 sqrt(3) eps in length; four times eps covers that. */
static vec area_vector(const lum_model *m, uint32_t triangle)
{
    vec a = corner(m, triangle, 0), e1 = minus(corner(m, triangle, 1), a), e2 = minus(corner(m, triangle, 2), a);
    vec n = cross(e1, e2);
    if (dot(n, n) <= 16 * DBL_EPSILON * DBL_EPSILON * dot(e1, e1) * dot(e2, e2))
        return (vec){{0, 0, 0}};
    return n;
}

/* --------------------------------------------------------------------------------------------------------- positions */

static void extend(double lo[3], double hi[3], const double p[3])
{
    for (int i = 0; i < 3; i++) {
        lo[i] = fmin(lo[i], p[i]);
        hi[i] = fmax(hi[i], p[i]);
    }
}

/* A light at a place, or what shines of it; directional ones are nowhere. */
static void extend_by_light(double lo[3], double hi[3], const lum_light *light)
{
    if (light->kind == LUM_LIGHT_DIRECTIONAL)
        return;
    const lmg_vec3 p = light->position, x = light->axes[0], y = light->axes[1], z = light->axes[2];
    const bool flat = light->kind == LUM_LIGHT_PROFILE && light->shape.kind != LUM_SHAPE_POINT;
    const double a = flat ? 0.5 * light->shape.c0 : 0, b = flat ? 0.5 * light->shape.height : 0, c = flat ? 0.5 * light->shape.c90 : 0;
    const double half[3] = {a * fabs(x.x) + b * fabs(y.x) + c * fabs(z.x), a * fabs(x.y) + b * fabs(y.y) + c * fabs(z.y),
                            a * fabs(x.z) + b * fabs(y.z) + c * fabs(z.z)};
    extend(lo, hi, (const double[3]){p.x - half[0], p.y - half[1], p.z - half[2]});
    extend(lo, hi, (const double[3]){p.x + half[0], p.y + half[1], p.z + half[2]});
}

/* The middle of what is drawn: vertices that no triangle uses don't count; lights at a place do. */
static vec find_centre(const lum_build *b)
{
    const lum_model *m = b->model;
    double lo[3] = {INFINITY, INFINITY, INFINITY}, hi[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < 3 * (size_t)m->triangle_count; i++)
        extend(lo, hi, b->positions + 3 * (size_t)m->indices[i]);
    for (uint32_t i = 0; i < m->light_count; i++) {
        extend_by_light(lo, hi, &m->lights[i]);
    }
    vec c = {{0, 0, 0}};
    for (int i = 0; i < 3; i++)
        c.x[i] = lo[i] <= hi[i] ? lo[i] + (hi[i] - lo[i]) / 2 : 0;
    return c;
}

/* The largest coordinate of what is drawn; not what only a float's denormals could hold, which has no area. */
static double find_unit(const lum_build *b, vec centre)
{
    const lum_model *m = b->model;
    double unit = 0;
    for (size_t i = 0; i < 3 * (size_t)m->triangle_count; i++)
        for (int k = 0; k < 3; k++)
            unit = fmax(unit, fabs(b->positions[3 * (size_t)m->indices[i] + (size_t)k] - centre.x[k]));
    return unit >= (double)FLT_MIN ? unit : 1;
}

static lmg_result round_positions(lum_build *b, vec centre)
{
    lum_model *m = b->model;
    m->centre = (lmg_vec3){centre.x[0], centre.x[1], centre.x[2]};
    m->positions = calloc(3 * (size_t)m->vertex_count + 4, sizeof *m->positions);
    if (!m->positions)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    m->unit = find_unit(b, centre);
    for (size_t i = 0; i < 3 * (size_t)m->vertex_count; i++)
        /* what no triangle uses may be far away */
        m->positions[i] = (float)fmax(-(double)FLT_MAX, fmin((b->positions[i] - centre.x[i % 3]) / m->unit, (double)FLT_MAX));
    for (uint32_t i = 0; i < m->light_count; i++) {
        m->lights[i].position.x -= centre.x[0];
        m->lights[i].position.y -= centre.x[1];
        m->lights[i].position.z -= centre.x[2];
    }
    return LMG_OK;
}

/* Triangles without area have no front and meet no light; Embree's answers on them are accidental. */
static void drop_degenerate(lum_build *b)
{
    lum_model *m = b->model;
    uint32_t kept = 0;
    for (uint32_t p = 0; p < m->part_count; p++) {
        lum_part *part = &m->parts[p];
        uint32_t first = kept, last = part->first_triangle + part->triangle_count;
        for (uint32_t t = part->first_triangle; t < last; t++) {
            vec n = area_vector(m, t);
            if (!(dot(n, n) > 0))
                continue;
            memmove(m->indices + 3 * (size_t)kept, m->indices + 3 * (size_t)t, 3 * sizeof *m->indices);
            m->triangle_part[kept++] = p;
        }
        uint32_t dropped = part->triangle_count - (kept - first);
        part->first_triangle = first;
        part->triangle_count = kept - first;
        if (dropped)
            lum_warn(b, "mesh \"%.60s\": %u triangle%s without area left out", part->mesh, dropped, dropped == 1 ? "" : "s");
    }
    m->triangle_count = kept;
}

/* ----------------------------------------------------------------------------------------------- normals and tangents */

/* Vertices without a usable normal (none in the file, or a zero) get the mean of their triangles' normals, weighted by area; where
 * the file has none at all, every vertex belongs to one triangle and this is flat shading. */
static void complete_normals(lum_model *m, vec *sums)
{
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        vec n = area_vector(m, t);
        for (int k = 0; k < 3; k++)
            for (int i = 0; i < 3; i++)
                sums[m->indices[3 * (size_t)t + (size_t)k]].x[i] += n.x[i];
    }
    for (uint32_t v = 0; v < m->vertex_count; v++) {
        vec n = load(m->normals + 3 * (size_t)v);
        double length = sqrt(dot(n, n));
        if (!(length > 0)) {
            n = sums[v];
            length = sqrt(dot(n, n));
        }
        if (!(length > 0)) {
            n = (vec){{0, 1, 0}}; /* no triangle uses it, or its triangles cancel: any unit vector */
            length = 1;
        }
        store(m->normals + 3 * (size_t)v, (vec){{n.x[0] / length, n.x[1] / length, n.x[2] / length}});
    }
}

static vec any_perpendicular(vec n)
{
    vec axis = {{fabs(n.x[0]) < 0.6 ? 1.0 : 0.0, fabs(n.x[0]) < 0.6 ? 0.0 : 1.0, 0}};
    return cross(n, axis);
}

/* Direction in which u grows, times twice the area of the triangle; zero where the texture coordinates have no extent.  The
 * coordinates are those of the normal texture, after its transform.  *handedness: area of the triangle in (u,v), signed. */
static vec u_direction(const lum_model *m, uint32_t triangle, const lum_texture *tex, double *handedness)
{
    const float *uv = m->uv[tex->coordinates];
    double u[3], v[3];
    for (int k = 0; k < 3; k++) {
        const float *c = uv + 2 * (size_t)m->indices[3 * (size_t)triangle + (size_t)k];
        u[k] = (double)tex->m[0][0] * (double)c[0] + (double)tex->m[0][1] * (double)c[1];
        v[k] = (double)tex->m[1][0] * (double)c[0] + (double)tex->m[1][1] * (double)c[1];
    }
    double du1 = u[1] - u[0], du2 = u[2] - u[0], dv1 = v[1] - v[0], dv2 = v[2] - v[0];
    *handedness = du1 * dv2 - du2 * dv1;
    vec a = corner(m, triangle, 0), e1 = minus(corner(m, triangle, 1), a), e2 = minus(corner(m, triangle, 2), a);
    vec t;
    for (int i = 0; i < 3; i++)
        t.x[i] = (*handedness < 0 ? -1 : 1) * (e1.x[i] * dv2 - e2.x[i] * dv1);
    double length = sqrt(dot(t, t));
    vec n = area_vector(m, triangle);
    double weight = length > 0 && *handedness != 0 ? sqrt(dot(n, n)) / length : 0;
    for (int i = 0; i < 3; i++)
        t.x[i] *= weight;
    return t;
}

/* Tangents for parts with a normal map whose file has none: per vertex the area-weighted mean of the direction of growing u over
 * its triangles, made perpendicular to the normal. */
static lmg_result complete_tangents(lum_build *b, vec *sums)
{
    lum_model *m = b->model;
    bool needed = m->tangents != NULL;
    for (uint32_t p = 0; p < m->part_count; p++)
        needed = needed || m->materials[m->parts[p].material].normal_texture.image != LUM_NONE;
    if (!needed)
        return LMG_OK;
    double *signs = calloc((size_t)m->vertex_count + 1, sizeof *signs);
    if (!signs)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    if (!m->tangents) {
        m->tangents = calloc(4 * (size_t)m->vertex_count + 1, sizeof *m->tangents);
        if (!m->tangents) {
            free(signs);
            return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
        }
    }
    memset(sums, 0, m->vertex_count * sizeof *sums);
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        const lum_texture *tex = &m->materials[m->parts[m->triangle_part[t]].material].normal_texture;
        if (tex->image == LUM_NONE || !m->uv[tex->coordinates])
            continue;
        double handedness;
        vec d = u_direction(m, t, tex, &handedness);
        for (int k = 0; k < 3; k++) {
            uint32_t v = m->indices[3 * (size_t)t + (size_t)k];
            for (int i = 0; i < 3; i++)
                sums[v].x[i] += d.x[i];
            signs[v] += handedness;
        }
    }
    for (uint32_t v = 0; v < m->vertex_count; v++) {
        float *out = m->tangents + 4 * (size_t)v;
        vec n = load(m->normals + 3 * (size_t)v), t = load(out);
        bool given = dot(t, t) > 0;
        if (!given)
            t = sums[v];
        double along = dot(t, n), before = dot(t, t);
        for (int i = 0; i < 3; i++)
            t.x[i] -= along * n.x[i];
        /* What is left of a tangent parallel to the normal is rounding: below 2^-23 of its length. */
        if (!(dot(t, t) > 0x1p-46 * before))
            t = any_perpendicular(n);
        double length = sqrt(dot(t, t));
        store(out, (vec){{t.x[0] / length, t.x[1] / length, t.x[2] / length}});
        /* v points down in glTF's pictures: positive area in (u,v) means that the bitangent, up in the picture, is -dP/dv. */
        if (!given)
            out[3] = signs[v] > 0 ? -1 : 1;
    }
    free(signs);
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------------------- whole */

static void find_bounds(lum_model *m)
{
    double lo[3] = {INFINITY, INFINITY, INFINITY}, hi[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < 3 * (size_t)m->triangle_count; i++) {
        const lmg_vec3 p = lum_model_vertex(m, m->indices[i]);
        extend(lo, hi, (const double[3]){p.x, p.y, p.z});
    }
    for (uint32_t i = 0; i < m->light_count; i++) {
        extend_by_light(lo, hi, &m->lights[i]);
    }
    if (lo[0] <= hi[0]) {
        m->bounds_min = (lmg_vec3){lo[0], lo[1], lo[2]};
        m->bounds_max = (lmg_vec3){hi[0], hi[1], hi[2]};
    }
}

lmg_result lum_build_finish(lum_build *b)
{
    lum_model *m = b->model;
    LUM_TRY(round_positions(b, find_centre(b)));
    free(b->positions);
    b->positions = NULL;
    drop_degenerate(b);
    if (m->triangle_count == 0 && m->light_count == 0)
        return lmg_fail(b->err, LMG_ERROR_INPUT,
                        "none of its triangles has an area; check the model's unit, or set \"scale\" in a recipe");
    vec *sums = calloc((size_t)m->vertex_count + 1, sizeof *sums);
    if (!sums)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    complete_normals(m, sums);
    lmg_result result = complete_tangents(b, sums);
    free(sums);
    if (result)
        return result;
    m->triangle_material = malloc(((size_t)m->triangle_count + 1) * sizeof *m->triangle_material);
    if (!m->triangle_material)
        return lmg_fail(b->err, LMG_ERROR_MEMORY, "out of memory");
    for (uint32_t t = 0; t < m->triangle_count; t++)
        m->triangle_material[t] = m->parts[m->triangle_part[t]].material;
    find_bounds(m);
    return LMG_OK;
}
