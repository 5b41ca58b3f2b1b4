/* SPDX-License-Identifier: Apache-2.0 */
/* Triangle meshes from a few shapes, for make_models; see mesh_builder.h. */
#include "mesh_builder.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PI 3.14159265358979323846

static void *grow(void *data, size_t *room, size_t needed, size_t size)
{
    if (needed <= *room) {
        return data;
    }
    *room = needed > 2 * *room ? needed : 2 * *room;
    void *grown = realloc(data, *room * size);
    if (!grown) {
        fprintf(stderr, "make_models: out of memory\n");
        exit(1);
    }
    return grown;
}

void mesh_free(mesh *m)
{
    free(m->vertices);
    free(m->indices);
    memset(m, 0, sizeof *m);
}

uint32_t mesh_add_vertex(mesh *m, const double position[3], const double normal[3])
{
    m->vertices = grow(m->vertices, &m->vertex_room, m->vertex_count + 1, sizeof *m->vertices);
    mesh_vertex *v = &m->vertices[m->vertex_count];
    memcpy(v->position, position, sizeof v->position);
    memcpy(v->normal, normal, sizeof v->normal);
    return (uint32_t)m->vertex_count++;
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Twice the area, as a vector along the geometric normal. */
static void area_vector(const mesh *m, uint32_t a, uint32_t b, uint32_t c, double out[3])
{
    const double *p = m->vertices[a].position, *q = m->vertices[b].position, *r = m->vertices[c].position;
    double e1[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]}, e2[3] = {r[0] - p[0], r[1] - p[1], r[2] - p[2]};
    cross(e1, e2, out);
}

void mesh_add_triangle(mesh *m, uint32_t a, uint32_t b, uint32_t c)
{
    const mesh_vertex *v = m->vertices;
    if (!memcmp(v[a].position, v[b].position, sizeof v[a].position) || !memcmp(v[b].position, v[c].position, sizeof v[a].position) ||
        !memcmp(v[c].position, v[a].position, sizeof v[a].position)) {
        return;
    }
    double n[3], along = 0;
    area_vector(m, a, b, c, n);
    for (int i = 0; i < 3; i++) {
        along += n[i] * (v[a].normal[i] + v[b].normal[i] + v[c].normal[i]);
    }
    m->indices = grow(m->indices, &m->index_room, m->index_count + 3, sizeof *m->indices);
    m->indices[m->index_count++] = a;
    m->indices[m->index_count++] = along >= 0 ? b : c;
    m->indices[m->index_count++] = along >= 0 ? c : b;
}

void mesh_add_revolution(mesh *m, const double centre[3], const mesh_profile *profile, size_t count, unsigned segments)
{
    uint32_t first = (uint32_t)m->vertex_count;
    for (size_t i = 0; i < count; i++) {
        for (unsigned k = 0; k < segments; k++) {
            double phi = 2 * PI * k / segments, c = cos(phi), s = sin(phi);
            double p[3] = {centre[0] + profile[i].r * c, centre[1] + profile[i].y, centre[2] + profile[i].r * s};
            double n[3] = {profile[i].nr * c, profile[i].ny, profile[i].nr * s};
            mesh_add_vertex(m, p, n);
        }
    }
    for (size_t i = 0; i + 1 < count; i++) {
        for (unsigned k = 0; k < segments; k++) {
            uint32_t a = first + (uint32_t)(i * segments) + k, b = first + (uint32_t)(i * segments) + (k + 1) % segments;
            uint32_t c = a + segments, d = b + segments;
            mesh_add_triangle(m, a, b, d);
            mesh_add_triangle(m, a, d, c);
        }
    }
}

void mesh_add_cone(mesh *m, const double centre[3], double r0, double y0, double r1, double y1, double side, unsigned steps,
                   unsigned segments)
{
    double length = hypot(r1 - r0, y1 - y0), nr = side * (y1 - y0) / length, ny = -side * (r1 - r0) / length;
    mesh_profile *profile = grow(NULL, &(size_t){0}, steps + 1, sizeof *profile);
    for (unsigned i = 0; i <= steps; i++) {
        double t = (double)i / steps;
        profile[i] = (mesh_profile){r0 + t * (r1 - r0), y0 + t * (y1 - y0), nr, ny};
    }
    mesh_add_revolution(m, centre, profile, steps + 1, segments);
    free(profile);
}

void mesh_add_sphere(mesh *m, const double centre[3], double radius, unsigned bands, unsigned segments)
{
    mesh_profile *profile = grow(NULL, &(size_t){0}, bands + 1, sizeof *profile);
    for (unsigned i = 0; i <= bands; i++) {
        double theta = PI * i / bands, s = i == 0 || i == bands ? 0 : sin(theta), c = cos(theta);
        profile[i] = (mesh_profile){radius * s, radius * c, s, c};
    }
    mesh_add_revolution(m, centre, profile, bands + 1, segments);
    free(profile);
}

void mesh_add_rectangle(mesh *m, const double corner[3], const double edge1[3], const double edge2[3])
{
    double n[3], p[4][3];
    cross(edge1, edge2, n);
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    uint32_t v[4];
    for (int i = 0; i < 3; i++) {
        n[i] /= length;
        p[0][i] = corner[i];
        p[1][i] = corner[i] + edge1[i];
        p[2][i] = corner[i] + edge1[i] + edge2[i];
        p[3][i] = corner[i] + edge2[i];
    }
    for (int i = 0; i < 4; i++) {
        v[i] = mesh_add_vertex(m, p[i], n);
    }
    mesh_add_triangle(m, v[0], v[1], v[2]);
    mesh_add_triangle(m, v[0], v[2], v[3]);
}

void mesh_add_box(mesh *m, const double low[3], const double high[3], double side)
{
    for (int axis = 0; axis < 3; axis++) {
        int i = (axis + 1) % 3, j = (axis + 2) % 3;
        for (int end = 0; end < 2; end++) {
            double corner[3] = {low[0], low[1], low[2]}, e1[3] = {0, 0, 0}, e2[3] = {0, 0, 0};
            corner[axis] = end ? high[axis] : low[axis];
            /* The order of the two edges turns the normal outwards on both ends. */
            int first = (end == 1) == (side > 0) ? i : j, second = first == i ? j : i;
            e1[first] = high[first] - low[first];
            e2[second] = high[second] - low[second];
            mesh_add_rectangle(m, corner, e1, e2);
        }
    }
}

double mesh_area(const mesh *m)
{
    double sum = 0;
    for (size_t i = 0; i + 2 < m->index_count; i += 3) {
        double n[3];
        area_vector(m, m->indices[i], m->indices[i + 1], m->indices[i + 2], n);
        sum += 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    return sum;
}
