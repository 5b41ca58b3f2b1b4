/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Where short ways meet nothing.  Space is cut in cubic cells; each knows the surfaces near it, in layers: all triangles of about
 * one direction between two parallel planes (one plane, if they are flat).  A way that starts in the cell, ends near it and has
 * both ends on one side of every layer meets none of the triangles.  Cells with too many layers say nothing.  Relies on
 * scene_data.h.  Inside, lengths are in the scene's unit.
 */
#include <luminaires/scene.h>

#include "scene_data.h"
#include "vec.h"

#include <stdlib.h>
#include <string.h>

/* Cells at most; visits of triangles to cells at most: meshes so fine are left to Embree. */
static const double MOST_CELLS = 1 << 18, MOST_VISITS = 2e7;
/* Cells are so wide, in thicknesses of the walls, and ways may leave them by so much, in free paths: longer ones are rare. */
static const double CELL = 0.667, BEYOND = 1.25;
/* Optical depth of a wall from which on it is worth it: in a thinner one light comes to a surface or to a new cell at nearly each
 * step, and to fetch a cell from memory takes as long as to ask Embree (measured with walls of glass: a quarter more time at 1.2,
 * no less at 6, five ninths at 60). */
static const double DENSE = 10;
/* Triangles join a layer when its normal is that near to theirs and it stays thinner than that part of what is near a cell. */
static const double ALIKE = 0.94, THIN = 0.06;
/* A way's start is off all surfaces by an error of theirs, less rounding in double; its end keeps as much from them as makes a hit
 * matter, in the largest error. */
static const double START = 0.25, END = 2;
/* A cell is the number of its layers and, from bit COUNT_BITS on, the first one's; SILENT layers where nothing is said. */
enum { MOST_LAYERS = 6, COUNT_BITS = 3, SILENT = 7 };

typedef struct layer {
    float n[3], lo, hi; /* of n . p over its triangles near the cell, rounded outwards */
} layer;

struct lum_clearance {
    double per_unit;                  /* 1 / the scene's unit in metres */
    double low[3], per_length, beyond; /* beyond: in cells */
    double start, end;                /* distances that ends keep from layers */
    uint32_t size[3];
    uint32_t *cells;
    layer *layers;
};

/* While it is built: MOST_LAYERS places for each cell that any triangle is near. */
typedef struct growing {
    lum_clearance *c;
    layer (*layers)[MOST_LAYERS];
    uint32_t count, room;
} growing;

/* The cells whose neighbourhood a triangle's box meets; false: none. */
static bool cells_near(const lum_clearance *c, const lum_triangle *t, uint32_t from[3], uint32_t to[3])
{
    for (int k = 0; k < 3; k++) {
        const double a = (double)t->v[0][k], b = (double)t->v[1][k], d = (double)t->v[2][k];
        const double first = floor((fmin(a, fmin(b, d)) - c->low[k]) * c->per_length - c->beyond) - 1;
        const double last = floor((fmax(a, fmax(b, d)) - c->low[k]) * c->per_length + c->beyond) + 1;
        if (last < 0 || first >= (double)c->size[k]) {
            return false;
        }
        from[k] = first > 0 ? (uint32_t)first : 0;
        to[k] = last < (double)c->size[k] ? (uint32_t)last : c->size[k] - 1;
    }
    return true;
}

static double least_of(double a, double b)
{
    return a < b ? a : b;
}

static double most_of(double a, double b)
{
    return a > b ? a : b;
}

/* The range of n . p over what of a triangle is within `radius` of a point: of its corners, and of its plane at an angle to n,
 * which is unit to the rounding of floats. */
static layer layer_of(const lum_triangle *t, lmg_vec3 normal, const float along[3], lmg_vec3 centre, double radius)
{
    const lmg_vec3 n = vec_from_float(along);
    const double height = vec_dot(normal, vec_sub(centre, vec_from_float(t->v[0])));
    const double cosine = vec_dot(n, normal), slope = (sqrt(most_of(1 - cosine * cosine, 0)) + 0x1p-20) * radius;
    const double middle = vec_dot(n, centre) - height * cosine;
    double lo = INFINITY, hi = -INFINITY;
    for (int i = 0; i < 3; i++) {
        const double x = vec_dot(n, vec_from_float(t->v[i]));
        lo = least_of(lo, x);
        hi = most_of(hi, x);
    }
    const float low = (float)most_of(lo, least_of(middle - slope, hi)), high = (float)least_of(hi, most_of(middle + slope, lo));
    return (layer){{along[0], along[1], along[2]}, nextafterf(low, -INFINITY), nextafterf(high, INFINITY)};
}

/* Takes a triangle among the layers of a cell that it is near; returns their number. */
static uint32_t join(uint32_t count, layer layers[MOST_LAYERS], const lum_triangle *t, lmg_vec3 normal, lmg_vec3 centre,
                     double radius)
{
    float least = (float)(THIN * 2 * radius);
    layer best = {0};
    uint32_t into = count;
    for (uint32_t k = 0; k < count; k++) {
        if (fabs(vec_dot(vec_from_float(layers[k].n), normal)) < ALIKE) {
            continue;
        }
        layer both = layer_of(t, normal, layers[k].n, centre, radius);
        both.lo = both.lo < layers[k].lo ? both.lo : layers[k].lo;
        both.hi = both.hi > layers[k].hi ? both.hi : layers[k].hi;
        if (both.hi - both.lo < least) {
            least = both.hi - both.lo;
            best = both;
            into = k;
        }
    }
    if (into == MOST_LAYERS) {
        return SILENT;
    }
    if (into == count) {
        const float n[3] = {(float)normal.x, (float)normal.y, (float)normal.z};
        best = layer_of(t, normal, n, centre, radius);
    }
    layers[into] = best;
    return into == count ? count + 1 : count;
}

/* Tells all cells near a triangle; false: no memory. */
static bool tell_cells(growing *g, const lum_triangle *t)
{
    lum_clearance *c = g->c;
    uint32_t from[3], to[3];
    if (!cells_near(c, t, from, to)) {
        return true;
    }
    const double reach = (0.5 + c->beyond) / c->per_length, radius = sqrt(3) * reach;
    const lmg_vec3 a = vec_from_float(t->v[0]),
                   cross = vec_cross(vec_sub(vec_from_float(t->v[1]), a), vec_sub(vec_from_float(t->v[2]), a));
    const double length = vec_length(cross);
    const lmg_vec3 normal = length > 0 ? vec_scale(cross, 1 / length) : vec(0, 0, 1); /* without area nothing is met */
    for (uint32_t z = from[2]; z <= to[2]; z++) {
        for (uint32_t y = from[1]; y <= to[1]; y++) {
            for (uint32_t x = from[0]; x <= to[0]; x++) {
                uint32_t *at = &c->cells[((size_t)z * c->size[1] + y) * c->size[0] + x];
                const lmg_vec3 centre = {c->low[0] + (x + 0.5) / c->per_length, c->low[1] + (y + 0.5) / c->per_length,
                                         c->low[2] + (z + 0.5) / c->per_length};
                const double height = fabs(vec_dot(normal, vec_sub(centre, a)));
                if ((*at & SILENT) == SILENT || height > reach * (fabs(normal.x) + fabs(normal.y) + fabs(normal.z)) + c->end) {
                    continue;
                }
                if (*at == 0) {
                    if (g->count == g->room) {
                        const uint32_t room = 2 * g->room + 1024;
                        layer(*more)[MOST_LAYERS] = realloc(g->layers, room * sizeof *more);
                        if (!more) {
                            return false;
                        }
                        g->layers = more;
                        g->room = room;
                    }
                    *at = g->count++ << COUNT_BITS;
                }
                const uint32_t place = *at >> COUNT_BITS;
                *at = place << COUNT_BITS | join(*at & SILENT, g->layers[place], t, normal, centre, radius);
            }
        }
    }
    return true;
}

/* Puts the layers of all cells one after the other. */
static bool pack(growing *g, size_t cell_count)
{
    size_t total = 1; /* never none */
    for (size_t i = 0; i < cell_count; i++) {
        const uint32_t count = g->c->cells[i] & SILENT;
        total += count == SILENT ? 0 : count;
    }
    g->c->layers = malloc(total * sizeof *g->c->layers);
    if (!g->c->layers) {
        return false;
    }
    uint32_t next = 0;
    for (size_t i = 0; i < cell_count; i++) {
        const uint32_t count = g->c->cells[i] & SILENT, from = g->c->cells[i] >> COUNT_BITS;
        g->c->cells[i] = count;
        if (count == 0 || count == SILENT) {
            continue;
        }
        memcpy(&g->c->layers[next], g->layers[from], count * sizeof(layer));
        g->c->cells[i] = next << COUNT_BITS | count;
        next += count;
    }
    return true;
}

lmg_result lum_clearance_create(const lum_scene *scene, lmg_vec3 low, lmg_vec3 high, double thickness, double free_path,
                                lum_clearance **out, lmg_error *err)
{
    *out = NULL;
    low = vec_scale(low, scene->per_unit);
    high = vec_scale(high, scene->per_unit);
    thickness *= scene->per_unit;
    free_path *= scene->per_unit;
    const double extent[3] = {high.x - low.x, high.y - low.y, high.z - low.z};
    double width = CELL * thickness, visits = 0, error = 0;
    if (!(free_path > 0 && thickness >= DENSE * free_path && extent[0] >= 0 && extent[1] >= 0 && extent[2] >= 0)) {
        return LMG_OK;
    }
    while ((floor(extent[0] / width) + 1) * (floor(extent[1] / width) + 1) * (floor(extent[2] / width) + 1) > MOST_CELLS) {
        width *= 1.05;
    }
    lum_clearance *c = calloc(1, sizeof *c);
    growing g = {.c = c};
    bool enough = c != NULL;
    if (c) {
        *c = (lum_clearance){.per_unit = scene->per_unit, .low = {low.x, low.y, low.z}, .per_length = 1 / width, .beyond = BEYOND * free_path / width};
        for (int k = 0; k < 3; k++) {
            c->size[k] = (uint32_t)floor(extent[k] / width) + 1;
        }
        const size_t count = (size_t)c->size[0] * c->size[1] * c->size[2];
        for (uint32_t i = 0; i < scene->model->triangle_count; i++) {
            uint32_t from[3], to[3];
            error = fmax(error, (double)scene->triangles[i].error);
            if (cells_near(c, &scene->triangles[i], from, to)) {
                visits += (double)(to[0] - from[0] + 1) * (to[1] - from[1] + 1) * (to[2] - from[2] + 1);
            }
        }
        c->start = START * error;
        c->end = END * error;
        if (visits > MOST_VISITS) {
            free(c);
            return LMG_OK;
        }
        c->cells = calloc(count, sizeof *c->cells);
        enough = c->cells != NULL;
        for (uint32_t i = 0; enough && i < scene->model->triangle_count; i++) {
            enough = tell_cells(&g, &scene->triangles[i]);
        }
        enough = enough && pack(&g, count);
    }
    free(g.layers);
    if (!enough) {
        lum_clearance_destroy(c);
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the surroundings of a medium");
    }
    *out = c;
    return LMG_OK;
}

void lum_clearance_destroy(lum_clearance *c)
{
    if (!c) {
        return;
    }
    free(c->cells);
    free(c->layers);
    free(c);
}

bool lum_clearance_clear(const lum_clearance *c, lmg_vec3 origin, lmg_vec3 direction, double reach)
{
    origin = vec_scale(origin, c->per_unit);
    reach *= c->per_unit;
    const double o[3] = {origin.x, origin.y, origin.z}, d[3] = {direction.x, direction.y, direction.z};
    size_t at[3];
    for (int k = 0; k < 3; k++) {
        const double x = (o[k] - c->low[k]) * c->per_length, end = x + reach * d[k] * c->per_length;
        if (!(x >= 0 && x < (double)c->size[k])) {
            return false;
        }
        at[k] = (size_t)x;
        if (!(end >= (double)at[k] - c->beyond && end <= (double)(at[k] + 1) + c->beyond)) {
            return false;
        }
    }
    const uint32_t here = c->cells[(at[2] * c->size[1] + at[1]) * c->size[0] + at[0]], count = here & SILENT;
    if (count == SILENT) {
        return false;
    }
    for (const layer *l = &c->layers[here >> COUNT_BITS], *last = l + count; l < last; l++) {
        const lmg_vec3 n = vec_from_float(l->n);
        const double from = vec_dot(n, origin), to = from + reach * vec_dot(n, direction), hi = (double)l->hi, lo = (double)l->lo;
        if (!((from - hi > c->start && to - hi > c->end) || (lo - from > c->start && lo - to > c->end))) {
            return false;
        }
    }
    return true;
}
