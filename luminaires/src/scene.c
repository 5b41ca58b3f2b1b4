/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Rays against triangles: the only file that calls Embree.  Embree finds the triangle in single precision; the hit is then computed
 * again in double, which gives exact positions and rejects false hits (grazing rays on slivers, the triangle a ray has just left).
 * Inside, lengths are in the model's unit; rays come and hits go in metres.
 * Relies on surface.c and microfacet.c for what a scene holds besides geometry.
 */
#include "scene_data.h"
#include "vec.h"

#include <embree3/rtcore.h>
#include <fenv.h>
#include <float.h>
#include <stdlib.h>
#include <string.h>
#include <xmmintrin.h>

unsigned lum_thread_begin(void)
{
    unsigned saved = _mm_getcsr(), on = saved | _MM_FLUSH_ZERO_ON | 0x0040u /* denormals are zero */;
#ifdef LUMIBOX_TRAPS /* whoever wants traps gets them; intersect() keeps Embree out */
    _mm_setcsr(on);
#else
    _mm_setcsr(on | _MM_MASK_MASK);
#endif
    return saved;
}

void lum_thread_end(unsigned saved)
{
    _mm_setcsr(saved);
}

/* The record of a triangle; false if its area is zero. */
static bool fill_triangle(const lum_model *model, uint32_t index, lum_triangle *out, float normals[3][3])
{
    const uint32_t *corner = model->indices + 3 * (size_t)index;
    bool smooth = false;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            out->v[i][k] = model->positions[3 * (size_t)corner[i] + (size_t)k];
            normals[i][k] = model->normals ? model->normals[3 * (size_t)corner[i] + (size_t)k] : 0;
        }
    }
    lmg_vec3 a = vec_from_float(out->v[0]), b = vec_from_float(out->v[1]), c = vec_from_float(out->v[2]);
    lmg_vec3 cross = vec_cross(vec_sub(b, a), vec_sub(c, a));
    double twice_area = vec_length(cross);
    lmg_vec3 ng = twice_area > 0 ? vec_scale(cross, 1 / twice_area) : vec(0, 0, 1);
    out->ng[0] = (float)ng.x;
    out->ng[1] = (float)ng.y;
    out->ng[2] = (float)ng.z;
    for (int i = 0; i < 3; i++) {
        /* Flat when the vertex normal is the face's to the rounding of floats (1e-6 is 8 ulps of 1, a fifth of a second of arc). */
        lmg_vec3 n = vec_from_float(normals[i]);
        smooth |= vec_length(vec_sub(n, ng)) > 1e-6 && vec_dot(n, n) > 0.25;
    }
    out->material = (uint32_t)model->triangle_material[index] | (smooth ? LUM_TRIANGLE_SMOOTH : 0);
    double error = lum_triangle_error((const float(*)[3])out->v);
    double longest = fmax(vec_length(vec_sub(b, a)), fmax(vec_length(vec_sub(c, b)), vec_length(vec_sub(a, c))));
    /* Hits keep 4 errors from each edge that isn't flat, so that the origin offset from one wall can't pass through another that
     * meets it at an angle of more than 14 degrees.  Small triangles keep what they can. */
    double margin = twice_area > 0 ? 4 * error * longest / twice_area : 0.25;
    out->error = nextafterf((float)error, INFINITY);
    out->margin = (float)(margin < 0.25 ? margin : 0.25);
    out->edges = 0; /* filled by note_edges */
    return twice_area > 0;
}

/* Triangles that meet at an edge, as far as note_edges cares: of more than two nothing is noted. */
typedef struct edge_slot {
    uint32_t count;
    uint32_t edge[2]; /* 3 * triangle + corner opposite the edge */
} edge_slot;

/* End points of the edge opposite a corner, in an order that both its triangles agree on; -0 is 0. */
static void edge_ends(const lum_triangle *tri, uint32_t corner, float ends[6])
{
    for (int k = 0; k < 3; k++) {
        ends[k] = tri->v[(corner + 1) % 3][k] + 0.0f;
        ends[3 + k] = tri->v[(corner + 2) % 3][k] + 0.0f;
    }
    if (memcmp(ends, ends + 3, 3 * sizeof(float)) > 0) {
        for (int k = 0; k < 3; k++) {
            float swap = ends[k];
            ends[k] = ends[3 + k];
            ends[3 + k] = swap;
        }
    }
}

static void mark_flat(lum_scene *scene, const edge_slot *slot)
{
    for (int i = 0; i < 2; i++) {
        scene->triangles[slot->edge[i] / 3].edges |= 1u << slot->edge[i] % 3;
    }
}

/* The direction from an edge into its triangle, in the frame of an edge of triangle a: x into a, y its normal. */
static void into_triangle(const lum_triangle *a, uint32_t i, lmg_vec3 towards, double *x, double *y)
{
    lmg_vec3 n = vec_from_float(a->ng), from = vec_from_float(a->v[(i + 1) % 3]);
    lmg_vec3 inward = vec_cross(n, vec_unit(vec_sub(vec_from_float(a->v[(i + 2) % 3]), from)));
    lmg_vec3 w = vec_sub(towards, from);
    *x = vec_dot(w, inward);
    *y = vec_dot(w, n);
}

/* Notes the angle from each of the two triangles at an edge to the other: 1 .. LUM_FOLD_STEPS for 0 .. 360 degrees. */
static void note_folds(lum_scene *scene, const edge_slot *slot)
{
    for (int i = 0; i < 2; i++) {
        lum_triangle *a = &scene->triangles[slot->edge[i] / 3];
        const lum_triangle *b = &scene->triangles[slot->edge[1 - i] / 3];
        double x, y;
        into_triangle(a, slot->edge[i] % 3, vec_from_float(b->v[slot->edge[1 - i] % 3]), &x, &y);
        double turn = atan2(y, x) / (2 * LUM_PI);
        uint32_t code = 1 + (uint32_t)((turn < 0 ? turn + 1 : turn) * (LUM_FOLD_STEPS - 1) + 0.5);
        a->edges |= code << (3 + LUM_FOLD_BITS * (slot->edge[i] % 3));
    }
}

static void note_neighbours(lum_scene *scene, const edge_slot *slot)
{
    for (int i = 0; i < 2; i++) {
        scene->neighbour[slot->edge[i] / 3][slot->edge[i] % 3] = slot->edge[1 - i] / 3;
    }
}

static void forget_edges(lum_scene *scene, const edge_slot *slot)
{
    for (int i = 0; i < 2; i++) {
        scene->neighbour[slot->edge[i] / 3][slot->edge[i] % 3] = LUM_MISS;
        uint32_t k = slot->edge[i] % 3;
        scene->triangles[slot->edge[i] / 3].edges &= ~(1u << k | (uint32_t)LUM_FOLD_STEPS << (3 + LUM_FOLD_BITS * k));
    }
}

/*
 * Whether a ray in direction d sees both triangles at the edge opposite vertex k on the same side of it: then one that passes the
 * edge by meets neither of them.  False where that isn't known.
 */
static bool is_outline(const lum_triangle *tri, int k, lmg_vec3 d)
{
    uint32_t code = tri->edges >> (3 + LUM_FOLD_BITS * k) & LUM_FOLD_STEPS;
    if (code == 0) {
        return false;
    }
    double s, c, x, y;
    sincos_turns((double)(code - 1) / (LUM_FOLD_STEPS - 1), &s, &c);
    into_triangle(tri, (uint32_t)k, vec_add(vec_from_float(tri->v[(k + 1) % 3]), d), &x, &y);
    return y * (y * c - x * s) > 0;
}

/* Whether the second triangle of an edge is folded back onto the side where the first one lies, like the two sides of a sheet. */
static bool lies_folded(const lum_scene *scene, const edge_slot *slot)
{
    const lum_triangle *a = &scene->triangles[slot->edge[0] / 3], *b = &scene->triangles[slot->edge[1] / 3];
    uint32_t i = slot->edge[0] % 3, j = slot->edge[1] % 3;
    lmg_vec3 from = vec_from_float(a->v[(i + 1) % 3]), along = vec_sub(vec_from_float(a->v[(i + 2) % 3]), from);
    lmg_vec3 across = vec_cross(along, vec_from_float(a->ng));
    double first = vec_dot(across, vec_sub(vec_from_float(a->v[i]), from));
    double second = vec_dot(across, vec_sub(vec_from_float(b->v[j]), from));
    return first * second >= 0;
}

/*
 * Looks at the edges where exactly two triangles meet, matched by position: which they are, how they are folded, and where they go on almost in one
 * plane (within 8 degrees).  There an origin that stands off one triangle stands off the other as well (by at least 0.99 of it), so
 * hits need no distance from the edge; and in the acute corner of a long thin triangle there would be no room for it: a hit would
 * be moved far along the triangle.
 */
static bool note_edges(lum_scene *scene, uint32_t count)
{
    size_t slots = 64;
    while (slots < (size_t)count * 6) {
        slots *= 2;
    }
    edge_slot *table = calloc(slots, sizeof *table);
    if (!table) {
        return false;
    }
    for (uint32_t e = 0; e < 3 * count; e++) {
        float ends[6], other[6];
        edge_ends(&scene->triangles[e / 3], e % 3, ends);
        uint64_t hash = 0xcbf29ce484222325u;
        for (int k = 0; k < 6; k++) {
            uint32_t word;
            memcpy(&word, &ends[k], sizeof word);
            hash = (hash ^ word) * 0x9e3779b97f4a7c15u;
            hash ^= hash >> 29;
        }
        size_t at = hash & (slots - 1);
        while (table[at].count > 0) {
            edge_ends(&scene->triangles[table[at].edge[0] / 3], table[at].edge[0] % 3, other);
            if (memcmp(ends, other, sizeof ends) == 0) {
                break;
            }
            at = (at + 1) & (slots - 1);
        }
        edge_slot *slot = &table[at];
        if (slot->count < 2) {
            slot->edge[slot->count] = e;
        }
        slot->count += slot->count < 3;
        if (slot->count == 2) {
            note_neighbours(scene, slot);
            note_folds(scene, slot);
            const float *m = scene->triangles[slot->edge[0] / 3].ng, *n = scene->triangles[e / 3].ng;
            if (fabsf(m[0] * n[0] + m[1] * n[1] + m[2] * n[2]) > 0.99f && !lies_folded(scene, slot)) {
                mark_flat(scene, slot);
            }
        } else if (slot->count == 3) {
            forget_edges(scene, slot);
        }
    }
    free(table);
    return true;
}

static lmg_result embree_failure(RTCDevice device, lmg_error *err)
{
    switch (rtcGetDeviceError(device)) {
    case RTC_ERROR_OUT_OF_MEMORY:
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the ray tracing structure; use a model with fewer triangles");
    case RTC_ERROR_UNSUPPORTED_CPU:
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "Embree doesn't support this processor (it needs SSE2)");
    case RTC_ERROR_NONE:
        return LMG_OK;
    default:
        return lmg_fail(err, LMG_ERROR_INTERNAL, "Embree failed to build the ray tracing structure");
    }
}

lmg_result lum_scene_create(const lum_model *model, lum_scene **out, lmg_error *err)
{
    *out = NULL;
    lum_scene *scene = calloc(1, sizeof *scene);
    if (!scene) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the scene");
    }
    scene->model = model;
    scene->unit = model->unit;
    scene->per_unit = 1 / model->unit;
    lmg_result result = LMG_OK;
    fenv_t environment;
    feholdexcept(&environment); /* rtcCommitScene raises invalid operations, which kill a program that traps them */

    uint32_t count = model->triangle_count, smooth = 0;
    scene->triangles = aligned_alloc(64, ((size_t)count + 1) * sizeof *scene->triangles);
    scene->normals = malloc(((size_t)count + 1) * sizeof *scene->normals);
    scene->neighbour = malloc(((size_t)count + 1) * sizeof *scene->neighbour);
    if (!scene->triangles || !scene->normals || !scene->neighbour) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %u triangles", count);
        goto cleanup;
    }
    memset(scene->neighbour, 0xff, ((size_t)count + 1) * sizeof *scene->neighbour); /* LUM_MISS */
    for (uint32_t i = 0; i < count; i++) {
        fill_triangle(model, i, &scene->triangles[i], scene->normals[i]);
        smooth += scene->triangles[i].material >> 31;
    }
    if (!note_edges(scene, count)) {
        result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %u triangles", count);
        goto cleanup;
    }
    result = lum_find_touching(scene, err);
    if (result) {
        goto cleanup;
    }
    if (!smooth) {
        free(scene->normals);
        scene->normals = NULL;
    }
    result = lum_tables_create(model, &scene->tables, err);
    if (!result) {
        result = lum_shading_create(scene, err);
    }
    if (result) {
        goto cleanup;
    }

    /* One thread: then the tree, and with it which of two coincident triangles is hit, is the same on every machine. */
    RTCDevice device = rtcNewDevice("threads=1,set_affinity=0");
    scene->device = device;
    if (!device) {
        result = embree_failure(NULL, err);
        goto cleanup;
    }
    RTCScene embree = rtcNewScene(device);
    scene->embree = embree;
    rtcSetSceneFlags(embree, scene->touching ? RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION : RTC_SCENE_FLAG_ROBUST);
    rtcSetSceneBuildQuality(embree, RTC_BUILD_QUALITY_MEDIUM);
    if (count) {
        RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, model->positions, 0, 3 * sizeof(float),
                                   model->vertex_count);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, model->indices, 0, 3 * sizeof(uint32_t),
                                   count);
        rtcCommitGeometry(geometry);
        rtcAttachGeometryByID(embree, geometry, 0);
        rtcReleaseGeometry(geometry);
    }
    rtcCommitScene(embree);
    result = embree_failure(device, err);

cleanup:
    fesetenv(&environment);
    if (result) {
        lum_scene_destroy(scene);
        scene = NULL;
    }
    *out = scene;
    return result;
}

lmg_result lum_scene_create_variant(const lum_scene *geometry, const lum_model *model, lum_scene **out, lmg_error *err)
{
    *out = NULL;
    lum_scene *scene = calloc(1, sizeof *scene);
    if (!scene) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the scene");
    }
    *scene = (lum_scene){.model = model,
                         .unit = geometry->unit,
                         .per_unit = geometry->per_unit,
                         .triangles = geometry->triangles,
                         .normals = geometry->normals,
                         .neighbour = geometry->neighbour,
                         .device = geometry->device,
                         .embree = geometry->embree,
                         .touching = geometry->touching,
                         .tables = {.like = &geometry->tables},
                         .variant = true};
    lmg_result result = lum_tables_create(model, &scene->tables, err);
    if (!result) {
        result = lum_shading_create(scene, err);
    }
    if (result) {
        lum_scene_destroy(scene);
        return result;
    }
    *out = scene;
    return LMG_OK;
}

void lum_scene_destroy(lum_scene *scene)
{
    if (!scene) {
        return;
    }
    if (!scene->variant) {
        if (scene->embree) {
            rtcReleaseScene(scene->embree);
        }
        if (scene->device) {
            rtcReleaseDevice(scene->device);
        }
        free(scene->normals);
        free(scene->neighbour);
        free(scene->triangles);
    }
    lum_tables_destroy(&scene->tables);
    free(scene->shading);
    free(scene);
}

static inline void set_ray(struct RTCRay *ray, lmg_vec3 o, lmg_vec3 d, float near, float far)
{
    ray->org_x = (float)o.x;
    ray->org_y = (float)o.y;
    ray->org_z = (float)o.z;
    ray->tnear = near;
    ray->dir_x = (float)d.x;
    ray->dir_y = (float)d.y;
    ray->dir_z = (float)d.z;
    ray->time = 0;
    ray->tfar = far;
    ray->mask = (unsigned)-1;
    ray->id = 0;
    ray->flags = 0;
}

/* Of a ray that misses the triangle, its barycentrics b0, *b1, *b2 tell beyond which edges: the nearest point of these, as *b1 and
 * *b2, its place along the ray and its distance from it.  s: from the first corner to the ray's origin.  *edge: which one, -1 where
 * that is a corner. */
static double nearest_edge_point(lmg_vec3 s, lmg_vec3 e1, lmg_vec3 e2, lmg_vec3 d, double b0, double *b1, double *b2, double *along,
                                 int *edge)
{
    const lmg_vec3 corner[3] = {{0, 0, 0}, e1, e2};
    const double b[3] = {b0, *b1, *b2};
    double least = (double)INFINITY;
    *along = 0;
    *edge = -1;
    for (int k = 0; k < 3; k++) {
        if (b[k] >= 0) {
            continue;
        }
        int from = (k + 1) % 3, to = (k + 2) % 3;
        lmg_vec3 e = vec_sub(corner[to], corner[from]), w = vec_sub(s, corner[from]);
        lmg_vec3 across = vec_along(e, d, -vec_dot(e, d)); /* as seen along the ray */
        double x = vec_dot(w, across) / vec_dot(across, across);
        x = x > 0 ? x < 1 ? x : 1 : 0; /* NaN, of an edge along the ray: 0 */
        w = vec_along(w, e, -x);
        double t = -vec_dot(w, d), off = vec_length(vec_along(w, d, t));
        if (off < least) {
            least = off;
            *along = t;
            *edge = x > 0 && x < 1 ? k : -1;
            double c[3] = {0, 0, 0};
            c[from] = 1 - x;
            c[to] = x;
            *b1 = c[1];
            *b2 = c[2];
        }
    }
    return least;
}

/* Moves a point of a triangle, given by its barycentrics, off those edges that ask for it, by the same distance everywhere:
 * barycentrics change by distance / height over the edge, and heights go as one over the edges' lengths.  (One margin for all would
 * move a hit on a long thin triangle far along it.) */
static inline void keep_off_edges(const lum_triangle *tri, lmg_vec3 e1, lmg_vec3 e2, double *b1, double *b2)
{
    double l0 = vec_length(vec_sub(e2, e1)), l1 = vec_length(e2), l2 = vec_length(e1);
    double per_length = (double)tri->margin / fmax(l0, fmax(l1, l2));
    double m0 = tri->edges & 1 ? 0 : per_length * l0;
    double m1 = tri->edges & 2 ? 0 : per_length * l1;
    double m2 = tri->edges & 4 ? 0 : per_length * l2;
    *b1 = fmax(*b1, m1);
    *b2 = fmax(*b2, m2);
    double excess = *b1 + *b2 - (1 - m0);
    if (excess > 0) {
        double shift1 = fmin(*b1 - m1, 0.5 * excess), shift2 = fmin(*b2 - m2, excess - shift1);
        shift1 = fmin(*b1 - m1, excess - shift2);
        *b1 -= shift1;
        *b2 -= shift2;
    }
}

/* Where a ray meets a triangle's plane [moller1997triangle]. */
typedef struct plane_point {
    lmg_vec3 a, e1, e2, s; /* a corner, the edges from it, the way from it to the ray's origin */
    double b1, b2, t;
} plane_point;

/* False for a ray along the plane. */
static inline bool meet_plane(const lum_triangle *tri, lmg_vec3 o, lmg_vec3 d, plane_point *at)
{
    at->a = vec_from_float(tri->v[0]);
    at->e1 = vec_sub(vec_from_float(tri->v[1]), at->a);
    at->e2 = vec_sub(vec_from_float(tri->v[2]), at->a);
    at->s = vec_sub(o, at->a);
    const lmg_vec3 p = vec_cross(d, at->e2), q = vec_cross(at->s, at->e1);
    const double determinant = vec_dot(at->e1, p);
    if (determinant == 0) {
        return false;
    }
    const double inverse = 1 / determinant;
    at->b1 = vec_dot(at->s, p) * inverse;
    at->b2 = vec_dot(d, q) * inverse;
    at->t = vec_dot(at->e2, q) * inverse;
    return true;
}

typedef enum met { NOT_MET = 0, MET, MET_AT_EDGE } met;

/*
 * The triangle again, in double.  Returns whether the ray truly meets it, and that
 * near one of its edges.
 *
 * Embree decides in float and (robust mode) in favour of a hit, so near an edge the exact point may lie slightly outside.  Then the
 * point of the edge that the ray passes closest is taken, if that is within the rounding of Embree's input: origin and direction
 * rounded to float displace the ray by sqrt(3) u (|o| + t), its edge functions add some roundings of differences up to M + |o|: 32
 * u covers both.  (The point that Embree names is off by as much as the triangle is thin.)  Not so at the outline of a body, where
 * the other triangle lies behind the first one: light that just passes it by goes on, or it would be held to have met the second
 * one without the first.
 */
static inline met confirm_hit(const lum_triangle *tri, lmg_vec3 o, lmg_vec3 d, lum_hit *hit)
{
    plane_point at;
    if (!meet_plane(tri, o, d, &at) || !(at.t > 0 && at.t < (double)INFINITY)) {
        return NOT_MET;
    }
    const lmg_vec3 a = at.a, e1 = at.e1, e2 = at.e2, s = at.s;
    double b1 = at.b1, b2 = at.b2, t = at.t;
    double margin = (double)tri->margin, b0 = 1 - b1 - b2;
    met result = MET;
    if (!(b1 >= margin && b2 >= margin && b0 >= margin)) {
        if (!(b1 >= 0 && b2 >= 0 && b0 >= 0)) {
            int edge;
            double along, off = nearest_edge_point(s, e1, e2, d, b0, &b1, &b2, &along, &edge);
            double reach = (double)tri->error + 32 * LUM_FLOAT_ROUNDING * (fabs(o.x) + fabs(o.y) + fabs(o.z) + along);
            if (!(along > 0 && off <= reach) || (edge >= 0 && is_outline(tri, edge, d))) {
                return NOT_MET;
            }
            t = along;
        }
        keep_off_edges(tri, e1, e2, &b1, &b2);
        result = MET_AT_EDGE;
    }
    hit->t = t;
    hit->position = vec_along(vec_along(a, e1, b1), e2, b2);
    hit->b1 = (float)b1;
    hit->b2 = (float)b2;
    hit->error = (double)tri->error;
    /* The normal was rounded to float: its square is 1 + x, |x| < 2e-7; one Newton step for 1/sqrt(1+x) makes it unit to x^2. */
    lmg_vec3 ng = vec_from_float(tri->ng);
    hit->ng = vec_scale(ng, 1.5 - 0.5 * vec_dot(ng, ng));
    return result;
}

/*
 * Of two triangles that a ray meets near the edge between them, Embree's distances, rounded to float, may put the farther one first:
 * at the tip of a groove in glass, light would be found to enter where it hasn't yet left.  Here the nearer one becomes the hit.
 */
static void prefer_neighbour(const lum_scene *scene, lmg_vec3 o, lmg_vec3 d, lum_hit *hit)
{
    const uint32_t found = hit->triangle;
    for (int k = 0; k < 3; k++) {
        const uint32_t other = scene->neighbour[found][k];
        if (other == LUM_MISS || scene->triangles[found].edges >> k & 1) {
            continue;
        }
        const lum_triangle *tri = &scene->triangles[other];
        plane_point at;
        if (meet_plane(tri, o, d, &at) && at.b1 >= 0 && at.b2 >= 0 && at.b1 + at.b2 <= 1 && at.t > 0 && at.t < hit->t &&
            confirm_hit(tri, o, d, hit)) {
            hit->triangle = other;
        }
    }
}

static inline void to_metres(const lum_scene *scene, lum_hit *hit)
{
    hit->t *= scene->unit;
    hit->position = vec_scale(hit->position, scene->unit);
    hit->error *= scene->unit;
}

/* Whether a ray for which Embree has found the triangle truly meets it, or its neighbour before it: then that is the hit. */
static inline bool take_hit(const lum_scene *scene, uint32_t triangle, lmg_vec3 o, lmg_vec3 d, lum_hit *hit)
{
    const met how = confirm_hit(&scene->triangles[triangle], o, d, hit);
    hit->triangle = triangle;
    if (how == MET_AT_EDGE) {
        prefer_neighbour(scene, o, d, hit);
    }
    return how != NOT_MET;
}

/* Where to go on after a false hit at distance t, beyond `near`.  Tracing threads take denormal numbers for zero, so the next
 * distance after 0 is the least normal number; and should Embree report no more than `near` for lack of smaller numbers, twice
 * `near`. */
static inline float beyond(float t, float near)
{
    float next = nextafterf(t, INFINITY);
    return t < near ? 2 * near : next < FLT_MIN ? FLT_MIN : next;
}

static inline void intersect(RTCScene embree, struct RTCIntersectContext *context, struct RTCRayHit *rayhit)
{
#ifdef LUMIBOX_TRAPS /* it divides by directions' zeros */
    const unsigned saved = _mm_getcsr();
    _mm_setcsr(saved | _MM_MASK_MASK);
    rtcIntersect1(embree, context, rayhit);
    _mm_setcsr(saved);
#else
    rtcIntersect1(embree, context, rayhit);
#endif
}

/* Closest hit between `near` and `far`, as Embree sees it. */
static inline bool trace(const lum_scene *scene, struct RTCIntersectContext *context, lmg_vec3 o, lmg_vec3 d, float near, float far,
                         struct RTCRayHit *rayhit)
{
    set_ray(&rayhit->ray, o, d, near, far);
    rayhit->hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rayhit->hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    intersect(scene->embree, context, rayhit);
    return rayhit->hit.geomID != RTC_INVALID_GEOMETRY_ID;
}

/* The first true hit after the one that Embree found at the given distance, where nothing is met in truth.  It was the closest that
 * Embree found, so all others lie beyond. */
static bool look_beyond(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, float distance, lum_hit *hit)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRayHit rayhit;
    float near = beyond(distance, 0);
    while (trace(scene, &context, origin, direction, near, INFINITY, &rayhit)) {
        if (take_hit(scene, rayhit.hit.primID, origin, direction, hit)) {
            return true;
        }
        near = beyond(rayhit.ray.tfar, near);
    }
    return false;
}

bool lum_scene_intersect(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, lum_hit *hit)
{
    const lmg_vec3 o = vec_scale(origin, scene->per_unit);
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRayHit rayhit;
    if (!trace(scene, &context, o, direction, 0, INFINITY, &rayhit) ||
        !(take_hit(scene, rayhit.hit.primID, o, direction, hit) || look_beyond(scene, o, direction, rayhit.ray.tfar, hit))) {
        return false;
    }
    to_metres(scene, hit);
    return true;
}

bool lum_scene_touches(const lum_scene *scene)
{
    return scene->touching;
}

/* What lum_scene_all_here asks Embree with. */
typedef struct touching_query {
    struct RTCIntersectContext context; /* first: a filter is given its address */
    const lum_scene *scene;
    lmg_vec3 origin, direction;
    lum_hit *hits;
    bool at_edge[LUM_MAX_HERE], too_many;
    uint32_t count;
} touching_query;

/* Whether the ray passes within rounding of a triangle's edge, so that it may have been found to meet the next one as well. */
static bool meets_edge(const lum_triangle *tri, lmg_vec3 o, lmg_vec3 d)
{
    const double rounding = 0x1p-40; /* of quotients of differences, with the digits that cancel */
    plane_point at;
    return !(meet_plane(tri, o, d, &at) && at.b1 > rounding && at.b2 > rounding && 1 - at.b1 - at.b2 > rounding);
}

/* Takes what lies at the place of hits[0]; tells Embree to go on. */
static void take_here(const struct RTCFilterFunctionNArguments *arguments)
{
    touching_query *q = (touching_query *)arguments->context;
    arguments->valid[0] = 0;
    const uint32_t triangle = ((const struct RTCHit *)(const void *)arguments->hit)->primID; /* of one ray: N is 1 */
    const lum_triangle *all = q->scene->triangles, *tri = &all[triangle];
    const lum_hit *first = &q->hits[0];
    lum_hit hit = {.triangle = triangle};
    if (triangle == first->triangle || !(tri->edges & LUM_TRIANGLE_TOUCHES) ||
        !confirm_hit(tri, q->origin, q->direction, &hit)) {
        return;
    }
    const double gap = vec_dot(vec_sub(hit.position, first->position), first->ng);
    if (fabs(gap) > LUM_TOUCHING_GAP * fmax(hit.error, first->error)) {
        return;
    }
    const bool front = vec_dot(hit.ng, q->direction) < 0, at_edge = meets_edge(tri, q->origin, q->direction);
    for (uint32_t i = 0; i < q->count; i++) {
        const lum_hit *other = &q->hits[i];
        const bool same_side = (vec_dot(other->ng, q->direction) < 0) == front;
        if (other->triangle == triangle || ((at_edge || q->at_edge[i]) && same_side && ((all[other->triangle].material ^ tri->material) & LUM_TRIANGLE_MATERIAL) == 0)) {
            return; /* again, or a neighbour's */
        }
    }
    if (q->count == LUM_MAX_HERE) {
        q->too_many = true;
        return;
    }
    q->at_edge[q->count] = at_edge;
    q->hits[q->count++] = hit;
}

uint32_t lum_scene_all_here(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, lum_hit hits[LUM_MAX_HERE])
{
    const lum_triangle *first = &scene->triangles[hits[0].triangle];
    if (!(first->edges & LUM_TRIANGLE_TOUCHES)) {
        return 1;
    }
    const lum_hit given = hits[0];
    origin = vec_scale(origin, scene->per_unit);
    hits[0].t *= scene->per_unit;
    hits[0].position = vec_scale(given.position, scene->per_unit);
    hits[0].error *= scene->per_unit;
    /* The piece of the ray within twice the gap of the place: Embree rounds its ends. */
    const double cosine = fabs(vec_dot(hits[0].ng, direction)), reach = 2 * LUM_TOUCHING_GAP * hits[0].error / fmax(cosine, 1e-6);
    touching_query query = {.scene = scene, .origin = origin, .direction = direction, .hits = hits, .count = 1};
    query.at_edge[0] = meets_edge(first, origin, direction);
    rtcInitIntersectContext(&query.context);
    query.context.filter = take_here;
    struct RTCRayHit rayhit;
    set_ray(&rayhit.ray, vec_along(hits[0].position, direction, -reach), direction, 0, nextafterf((float)(2 * reach), INFINITY));
    rayhit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rayhit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    intersect(scene->embree, &query.context, &rayhit);
    const uint32_t count = query.count;
    if (query.too_many || count == 1) {
        hits[0] = given;
        return query.too_many ? UINT32_MAX : 1;
    }
    for (uint32_t i = 1; i < count; i++) {
        for (uint32_t k = i; k > 0 && hits[k - 1].triangle > hits[k].triangle; k--) {
            const lum_hit swap = hits[k];
            hits[k] = hits[k - 1];
            hits[k - 1] = swap;
        }
    }
    /* One place, off the edges of all of them: twice, as moving off the one's can bring it near the other's. */
    lmg_vec3 place = hits[0].position;
    double error = 0, farthest = 0;
    for (uint32_t i = 0; i < 2 * count; i++) {
        lum_hit *hit = &hits[i % count];
        const lum_triangle *tri = &scene->triangles[hit->triangle];
        const lmg_vec3 a = vec_from_float(tri->v[0]), e1 = vec_sub(vec_from_float(tri->v[1]), a), e2 = vec_sub(vec_from_float(tri->v[2]), a);
        const lmg_vec3 w = vec_sub(place, a), n = vec_cross(e1, e2);
        const double square = vec_dot(n, n), b1 = vec_dot(vec_cross(w, e2), n) / square, b2 = vec_dot(vec_cross(e1, w), n) / square;
        double kept1 = b1, kept2 = b2;
        keep_off_edges(tri, e1, e2, &kept1, &kept2);
        place = vec_along(vec_along(place, e1, kept1 - b1), e2, kept2 - b2);
        hit->b1 = (float)kept1;
        hit->b2 = (float)kept2;
        error = fmax(error, hit->error);
        farthest = fmax(farthest, fabs(vec_dot(vec_sub(a, place), hit->ng)));
    }
    for (uint32_t i = 0; i < count; i++) {
        hits[i].position = place;
        hits[i].error = error + farthest;
        to_metres(scene, &hits[i]);
    }
    return count;
}

/* reach: NULL = no end.  Whether a ray meets anything can't be foretold; so those that do are listed without a branch and worked on
 * afterwards. */
static inline void intersect_all(const lum_scene *scene, size_t count, const lmg_vec3 *origins, const lmg_vec3 *directions,
                                 const double *reach, lum_hit *hits)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRayHit rayhit;
    uint32_t ray[LUM_MAX_RAYS], triangle[LUM_MAX_RAYS];
    float distance[LUM_MAX_RAYS];
    size_t ray_count = 0;
    for (size_t i = 0; i < count; i++) {
        const lmg_vec3 origin = vec_scale(origins[i], scene->per_unit);
        const float far = reach ? nextafterf((float)(reach[i] * scene->per_unit), INFINITY) : INFINITY;
        bool hit = trace(scene, &context, origin, directions[i], 0, far, &rayhit);
        uint32_t at = hit ? rayhit.hit.primID : 0;
        __builtin_prefetch(&scene->triangles[at]);
        if (scene->normals) {
            __builtin_prefetch(scene->normals[at]);
        }
        hits[i].triangle = LUM_MISS;
        ray[ray_count] = (uint32_t)i;
        triangle[ray_count] = at;
        distance[ray_count] = rayhit.ray.tfar;
        ray_count += hit;
    }
    for (size_t k = 0; k < ray_count; k++) {
        size_t i = ray[k];
        const lmg_vec3 origin = vec_scale(origins[i], scene->per_unit);
        if (take_hit(scene, triangle[k], origin, directions[i], &hits[i]) ||
            look_beyond(scene, origin, directions[i], distance[k], &hits[i])) {
            to_metres(scene, &hits[i]);
        } else {
            hits[i].triangle = LUM_MISS;
        }
    }
}

void lum_scene_intersect_many(const lum_scene *scene, size_t count, const lmg_vec3 *origins, const lmg_vec3 *directions,
                              lum_hit *hits)
{
    intersect_all(scene, count, origins, directions, NULL, hits);
}

void lum_scene_intersect_within(const lum_scene *scene, size_t count, const lmg_vec3 *origins, const lmg_vec3 *directions,
                                const double *reach, lum_hit *hits)
{
    intersect_all(scene, count, origins, directions, reach, hits);
}

/* Any-hit queries can't be checked in double triangle by triangle, and Embree's distances are off by the rounding of its input over
 * the cosine, so that a light would shadow itself at grazing angles: hence the closest hit here too. */
bool lum_scene_occluded(const lum_scene *scene, lmg_vec3 origin, lmg_vec3 direction, double distance)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    struct RTCRayHit rayhit;
    lum_hit hit;
    origin = vec_scale(origin, scene->per_unit);
    distance *= scene->per_unit;
    float near = 0, far = nextafterf((float)distance, INFINITY);
    while (trace(scene, &context, origin, direction, near, far, &rayhit)) {
        if (confirm_hit(&scene->triangles[rayhit.hit.primID], origin, direction, &hit)) {
            /* Hits are exact, so what is closer than the end by an origin's offset is in between. */
            return hit.t < distance - hit.error;
        }
        near = beyond(rayhit.ray.tfar, near);
    }
    return false;
}

uint64_t lum_scene_trace_raw(const lum_scene *scene, const float *rays, size_t count)
{
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    uint64_t hits = 0;
    for (size_t i = 0; i < count; i++) {
        struct RTCRayHit rayhit;
        const float *r = rays + 6 * i;
        rayhit.ray.org_x = (float)((double)r[0] * scene->per_unit);
        rayhit.ray.org_y = (float)((double)r[1] * scene->per_unit);
        rayhit.ray.org_z = (float)((double)r[2] * scene->per_unit);
        rayhit.ray.tnear = 0;
        rayhit.ray.dir_x = r[3];
        rayhit.ray.dir_y = r[4];
        rayhit.ray.dir_z = r[5];
        rayhit.ray.time = 0;
        rayhit.ray.tfar = INFINITY;
        rayhit.ray.mask = (unsigned)-1;
        rayhit.ray.id = 0;
        rayhit.ray.flags = 0;
        rayhit.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        rayhit.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        intersect(scene->embree, &context, &rayhit);
        hits += rayhit.hit.geomID != RTC_INVALID_GEOMETRY_ID;
    }
    return hits;
}
