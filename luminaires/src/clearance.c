/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Where short ways meet nothing.  Space is cut in cubic cells.  What is near one, within the longest way that is asked about, lies
 * between parallel surfaces, as the two faces of a wall do: the cell knows the open slab between them in which its solid is.  A way
 * that starts in the cell and lies in the slab meets nothing.  Slabs bend as the walls do: their faces are level surfaces of a
 * quadratic function, which along a way is a parabola, so that ends and extreme tell all.  At an edge or in a corner there are
 * surfaces of two or three directions, and as many slabs.  Light that leaves a facet of a bent wall starts a little outside of the
 * slab; of each triangle it is known how far above it and below nothing else is.  Cells can be wider than a wall is thick, and are
 * 32 bytes each, so that those of a lamp stay in the cache.  Relies on scene_data.h.  Inside, lengths are in the scene's
 * unit.
 */
#include <luminaires/scene.h>

#include "scene_data.h"
#include "vec.h"

#include <stdlib.h>
#include <string.h>

/* Cells at most; visits of triangles to cells at most: meshes so fine are left to Embree. */
static const double MOST_CELLS = 1 << 18, MOST_VISITS = 6e6;
/* Cells are so wide, in thicknesses of the walls; ways may be so long, in free paths (longer ones are rare) and in thicknesses. */
static const double CELL = 2, LONGEST_PATHS = 4, LONGEST_WAY = 2;
/* Optical depth of a wall from which on it is worth it: in a thinner one most light comes to a surface. */
static const double DENSE = 0.5;
/* Triangles near a cell as a rule, and at most: in finer meshes cells are smaller and ways shorter, or cells say nothing. */
static const double NEAR = 150;
enum { MOST_NEAR = 512 };
/* A slab's function changes by at most 1 + STEEP per length, so that END is distance enough. */
static const double STEEP = 0.5;
/* Triangles are of one direction when their normals are that near to each other. */
static const double ALIKE = 0.94;
/* A way's start is off all surfaces by an error of theirs, less rounding in double; its end keeps as much from them as makes a hit
 * matter, in the largest error. */
static const double START = 0.25, END = 2;
/* A triangle's rim, of its heights. */
static const double RIM = 0x1p-10;
/* Directions of the triangles near a cell at most; what numbers that are rounded to whole ones have for 1. */
enum { MOST_SLABS = 3, UNIT = 32767 };

/* lo < f(q) < hi, rounded inwards; q = p - the cell's centre, f = n . q + bend (xx, yy, zz, xy, xz, yz of q) . curve.
 * more: slab more - 1 of lum_clearance.more counts as well; 0: none. */
typedef struct slab {
    float lo, hi, bend;
    int16_t n[3], curve[6];
    uint16_t more;
} slab;

struct lum_clearance {
    double per_unit; /* 1 / the scene's unit in metres */
    double low[3], high[3], per_length, width, longest; /* ways start within low .. high */
    double start, end; /* distances that ends keep from slabs' planes, times UNIT */
    uint32_t size[3];
    slab *cells, *more;
    uint32_t more_count;
    const lum_triangle *triangles; /* the scene's */
    float *alone; /* per triangle: within this distance of its plane nothing else is above it or below, but at its rim */
};

/* What of a triangle is near a cell, from the cell's centre. */
typedef struct piece {
    double corner[9][3];
    uint32_t count;
    lmg_vec3 normal, middle; /* middle: of the whole triangle */
    double area;
    bool done;
} piece;

static double least_of(double a, double b)
{
    return a < b ? a : b;
}

static double most_of(double a, double b)
{
    return a > b ? a : b;
}

/* The cells that a triangle's box is near. */
static bool cells_near(const lum_clearance *c, const lum_triangle *t, uint32_t from[3], uint32_t to[3])
{
    const double beyond = c->longest * c->per_length + 0x1p-20;
    for (int k = 0; k < 3; k++) {
        const double a = (double)t->v[0][k], b = (double)t->v[1][k], d = (double)t->v[2][k];
        const double first = floor((least_of(a, least_of(b, d)) - c->low[k]) * c->per_length - beyond);
        const double last = floor((most_of(a, most_of(b, d)) - c->low[k]) * c->per_length + beyond);
        if (last < 0 || first >= (double)c->size[k]) {
            return false;
        }
        from[k] = first > 0 ? (uint32_t)first : 0;
        to[k] = last < (double)c->size[k] ? (uint32_t)last : c->size[k] - 1;
    }
    return true;
}

/* What of a convex polygon is where side[i] of its corners is not negative, side being linear; all of it where rounding makes more than
 * two of its edges cross over.  So of n corners at most n + 1 come out, and of three, six times cut, nine. */
static uint32_t cut(uint32_t count, double (*restrict from)[3], const double side[9], double (*restrict to)[3])
{
    uint32_t kept = 0, crossings = 0;
    for (uint32_t i = 0; i < count; i++) {
        const double next = side[i + 1 < count ? i + 1 : 0];
        crossings += (side[i] > 0 && next < 0) || (side[i] < 0 && next > 0);
    }
    if (crossings > 2) {
        memcpy(to, from, count * sizeof to[0]);
        return count;
    }
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t next = i + 1 < count ? i + 1 : 0;
        if (side[i] >= 0) {
            memcpy(to[kept++], from[i], sizeof to[0]);
        }
        if ((side[i] > 0 && side[next] < 0) || (side[i] < 0 && side[next] > 0)) {
            const double x = side[i] / (side[i] - side[next]);
            for (int l = 0; l < 3; l++) {
                to[kept][l] = from[i][l] + x * (from[next][l] - from[i][l]);
            }
            kept++;
        }
    }
    return kept;
}

/* What of a triangle is in the cube of half a side `half` about a point; false: nothing. */
static bool cut_piece(const lum_triangle *t, lmg_vec3 normal, lmg_vec3 centre, double half, piece *out)
{
    double other[9][3];
    const double c[3] = {centre.x, centre.y, centre.z};
    out->middle = vec(0, 0, 0);
    bool whole = true;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            out->corner[i][k] = (double)t->v[i][k] - c[k];
            whole &= fabs(out->corner[i][k]) <= half;
        }
        out->middle = vec_along(out->middle, vec(out->corner[i][0], out->corner[i][1], out->corner[i][2]), 1.0 / 3);
    }
    out->count = 3;
    for (int k = 0; k < 3 && out->count > 0 && !whole; k++) {
        double side[9];
        for (uint32_t i = 0; i < out->count; i++) {
            side[i] = half - out->corner[i][k];
        }
        const uint32_t below = cut(out->count, out->corner, side, other);
        for (uint32_t i = 0; i < below; i++) {
            side[i] = half + other[i][k];
        }
        out->count = cut(below, other, side, out->corner);
    }
    if (out->count == 0) {
        return false;
    }
    lmg_vec3 sum = {0, 0, 0};
    const double *a = out->corner[0];
    for (uint32_t i = 2; i < out->count; i++) {
        const double *b = out->corner[i - 1], *d = out->corner[i];
        sum = vec_add(sum, vec_cross(vec(b[0] - a[0], b[1] - a[1], b[2] - a[2]), vec(d[0] - a[0], d[1] - a[1], d[2] - a[2])));
    }
    out->area = vec_length(sum);
    out->normal = normal;
    out->done = false;
    return true;
}

/* f of a slab for q = (a + b) / 2, but with its products of a's and b's coordinates: over a polygon f is between the least and the
 * most of this for all pairs of corners. */
static double blossom(const slab *s, const double a[3], const double b[3])
{
    const double flat = 0.5 * (s->n[0] * (a[0] + b[0]) + s->n[1] * (a[1] + b[1]) + s->n[2] * (a[2] + b[2]));
    const double curved = s->curve[0] * a[0] * b[0] + s->curve[1] * a[1] * b[1] + s->curve[2] * a[2] * b[2] +
                          0.5 * (s->curve[3] * (a[0] * b[1] + a[1] * b[0]) + s->curve[4] * (a[0] * b[2] + a[2] * b[0]) +
                                 s->curve[5] * (a[1] * b[2] + a[2] * b[1]));
    return flat + (double)s->bend * curved;
}

/* Sets f of a slab: its direction and, if it may bend, how, so that f is about constant on each of the pieces.  reach: the slab's
 * extent from the cell's centre.  False: it doesn't bend, or too much. */
static bool fit_direction(uint32_t count, const piece pieces[], const bool in[], bool bent, double reach, slab *out)
{
    lmg_vec3 mean = {0, 0, 0}, x, y;
    for (uint32_t i = 0; i < count; i++) {
        if (in[i]) {
            const double side = vec_dot(mean, pieces[i].normal) < 0 ? -1 : 1;
            /* pieces cut down to a line have a direction, too: an area far below any other's, whose lengths are of the order of 1 */
            mean = vec_along(mean, pieces[i].normal, side * (pieces[i].area + 1e-30));
        }
    }
    mean = vec_unit(mean);
    vec_frame(mean, &x, &y);
    /* Slopes g = s + S u of the normals against places u: least squares, weighted by areas. */
    double w = 0, u[2] = {0, 0}, g[2] = {0, 0}, uu[3] = {0, 0, 0}, gu[3] = {0, 0, 0};
    for (int pass = 0; pass < 2; pass++) {
        for (uint32_t i = 0; i < count; i++) {
            if (!in[i]) {
                continue;
            }
            const double cosine = vec_dot(pieces[i].normal, mean), a = pieces[i].area;
            const double px = vec_dot(pieces[i].middle, x), py = vec_dot(pieces[i].middle, y);
            const double sx = vec_dot(pieces[i].normal, x) / cosine, sy = vec_dot(pieces[i].normal, y) / cosine;
            if (pass == 0) {
                w += a;
                u[0] += a * px;
                u[1] += a * py;
                g[0] += a * sx;
                g[1] += a * sy;
            } else {
                const double dx = px - u[0], dy = py - u[1];
                uu[0] += a * dx * dx;
                uu[1] += a * dx * dy;
                uu[2] += a * dy * dy;
                gu[0] += a * (sx - g[0]) * dx;
                gu[1] += a * ((sx - g[0]) * dy + (sy - g[1]) * dx);
                gu[2] += a * (sy - g[1]) * dy;
            }
        }
        for (int k = 0; k < 2 && pass == 0 && w > 0; k++) {
            u[k] /= w;
            g[k] /= w;
        }
    }
    double S[3] = {0, 0, 0}; /* xx, xy, yy */
    /* all in a line, they tell nothing of the slope across: a millionth of the spread keeps the equations solvable and changes no bend
     * by more than that (whatever comes out, the ranges of f are taken from the slab as it is) */
    const double ridge = 1e-6 * (uu[0] + uu[2]);
    if (bent && ridge > 0) {
        const double a = uu[0] + ridge, b = uu[1], c = uu[2] + ridge, m = a + c;
        /* a S0 + b S1 = gu0,  b S0 + m S1 + b S2 = gu1,  b S1 + c S2 = gu2 */
        S[1] = (gu[1] - b * gu[0] / a - b * gu[2] / c) / (m - b * b / a - b * b / c);
        S[0] = (gu[0] - b * S[1]) / a;
        S[2] = (gu[2] - b * S[1]) / c;
    }
    const lmg_vec3 tilted = vec_along(mean, x, g[0] - S[0] * u[0] - S[1] * u[1]);
    const lmg_vec3 n = vec_unit(vec_along(tilted, y, g[1] - S[1] * u[0] - S[2] * u[1]));
    const double tangent[2][3] = {{x.x, x.y, x.z}, {y.x, y.y, y.z}}, along[3] = {n.x, n.y, n.z};
    double curve[6], most = 0;
    static const int ROW[6] = {0, 1, 2, 0, 0, 1}, COLUMN[6] = {0, 1, 2, 1, 2, 2};
    for (int k = 0; k < 6; k++) {
        const int r = ROW[k], c = COLUMN[k];
        curve[k] = (r == c ? 0.5 : 1) * (S[0] * tangent[0][r] * tangent[0][c] + S[2] * tangent[1][r] * tangent[1][c] +
                                         S[1] * (tangent[0][r] * tangent[1][c] + tangent[1][r] * tangent[0][c]));
        most = most_of(most, fabs(curve[k]));
    }
    for (int k = 0; k < 3; k++) {
        out->n[k] = (int16_t)lrint(UNIT * along[k]);
    }
    for (int k = 0; k < 6; k++) {
        out->curve[k] = (int16_t)(most > 0 ? lrint(UNIT * curve[k] / most) : 0);
    }
    out->bend = (float)most; /* f is in units of 1 / UNIT, as n and curve are */
    return most > 0 && reach * sqrt(3 * (S[0] * S[0] + 2 * S[1] * S[1] + S[2] * S[2])) < STEEP;
}

typedef struct range {
    double lo, hi;
    bool up; /* the front looks along the direction */
} range;

static int compare_ranges(const void *a, const void *b)
{
    const double x = ((const range *)a)->lo, y = ((const range *)b)->lo;
    return (x > y) - (x < y);
}

/* Where f is on none of the pieces: the widest range of it that a cell has a part of; rather inside of a solid than outside. False:
 * there is none. */
static bool find_gap(uint32_t count, const piece pieces[], const bool in[], double half, slab *s)
{
    range ranges[MOST_NEAR];
    uint32_t number = 0;
    const double n[3] = {s->n[0], s->n[1], s->n[2]};
    for (uint32_t i = 0; i < count; i++) {
        if (!in[i]) {
            continue;
        }
        range r = {(double)INFINITY, -(double)INFINITY, vec_dot(pieces[i].normal, vec(n[0], n[1], n[2])) > 0};
        for (uint32_t k = 0; k < pieces[i].count; k++) {
            for (uint32_t l = k; l < (s->bend > 0 ? pieces[i].count : k + 1); l++) {
                const double f = blossom(s, pieces[i].corner[k], pieces[i].corner[l]);
                r.lo = least_of(r.lo, f);
                r.hi = most_of(r.hi, f);
            }
        }
        ranges[number++] = r;
    }
    qsort(ranges, number, sizeof ranges[0], compare_ranges);
    const double reach = half * (fabs(n[0]) + fabs(n[1]) + fabs(n[2]));
    double best = 0, below = -(double)INFINITY;
    bool inside_above = true; /* of what is highest so far */
    for (uint32_t i = 0; i <= number; i++) {
        const double above = i < number ? ranges[i].lo : (double)INFINITY;
        const bool inside = (i == 0 || inside_above) && (i == number || ranges[i].up);
        const double part = (least_of(above, reach) - most_of(below, -reach)) * (inside ? 1 : 0.01);
        if (part > best) {
            best = part;
            s->lo = nextafterf((float)below, INFINITY);
            s->hi = nextafterf((float)above, -INFINITY);
        }
        if (i < number && ranges[i].hi > below) {
            below = ranges[i].hi;
            inside_above = !ranges[i].up;
        }
    }
    return best > 0;
}

/* Takes the pieces of about one direction from those that aren't done, and finds the slab between them.  False: there is none. */
static bool find_slab(uint32_t count, piece pieces[], double half, double reach, slab *out)
{
    uint32_t first = UINT32_MAX;
    for (uint32_t i = 0; i < count; i++) {
        if (!pieces[i].done && (first == UINT32_MAX || pieces[i].area > pieces[first].area)) {
            first = i;
        }
    }
    bool in[MOST_NEAR];
    for (uint32_t i = 0; i < count; i++) {
        in[i] = !pieces[i].done && (i == first || fabs(vec_dot(pieces[i].normal, pieces[first].normal)) >= ALIKE);
    }
    for (uint32_t i = 0; i < count; i++) {
        pieces[i].done |= in[i];
    }
    if (fit_direction(count, pieces, in, true, reach, out) && find_gap(count, pieces, in, half, out)) {
        return true;
    }
    fit_direction(count, pieces, in, false, reach, out);
    return find_gap(count, pieces, in, half, out);
}

static const slab FREE = {.lo = -INFINITY, .hi = INFINITY}, SILENT = {.lo = INFINITY, .hi = -INFINITY};

/* All that a cell can tell, of the pieces near it.  False: no memory. */
static bool fill_cell(lum_clearance *c, uint32_t count, piece pieces[], slab *cell)
{
    slab found[MOST_SLABS];
    uint32_t number = 0, left = count;
    *cell = FREE;
    while (left > 0) {
        if (number == MOST_SLABS || !find_slab(count, pieces, 0.5 * c->width, 0.5 * c->width + c->longest, &found[number++])) {
            *cell = SILENT;
            return true;
        }
        left = 0;
        for (uint32_t i = 0; i < count; i++) {
            left += !pieces[i].done;
        }
    }
    for (uint32_t k = number; k-- > 0;) {
        found[k].more = 0;
        if (k + 1 < number) {
            if (c->more_count >= UINT16_MAX) {
                *cell = SILENT;
                return true;
            }
            if ((c->more_count & (c->more_count - 1)) == 0) {
                slab *more = realloc(c->more, (c->more_count ? 2 * (size_t)c->more_count : 1) * sizeof *more);
                if (!more) {
                    return false;
                }
                c->more = more;
            }
            c->more[c->more_count++] = found[k + 1];
            found[k].more = (uint16_t)c->more_count;
        }
    }
    if (number > 0) {
        *cell = found[0];
    }
    return true;
}

/* The way from the middle of a triangle's edges inwards, 1 at the corner opposite edge k and 0 at the edge, is w . p + w[3]. */
static void barycentrics(const lum_triangle *t, double w[3][4])
{
    const lmg_vec3 n = vec_from_float(t->ng);
    for (int k = 0; k < 3; k++) {
        const lmg_vec3 a = vec_from_float(t->v[(k + 1) % 3]), b = vec_from_float(t->v[(k + 2) % 3]), top = vec_from_float(t->v[k]);
        const lmg_vec3 in = vec_cross(n, vec_sub(b, a));
        const double height = vec_dot(in, vec_sub(top, a)), scale = height > 0 ? 1 / height : 0;
        w[k][0] = in.x * scale;
        w[k][1] = in.y * scale;
        w[k][2] = in.z * scale;
        w[k][3] = -vec_dot(in, a) * scale;
    }
}

static double linear(const double w[4], const double p[3])
{
    return w[0] * p[0] + w[1] * p[1] + w[2] * p[2] + w[3];
}

/* How far from a triangle's plane, up to what a cell knows, nothing is above it or below but at its rim. */
static double height_alone(const lum_clearance *c, const lum_scene *scene, uint32_t index, const uint32_t *first,
                           const uint32_t *near)
{
    const lum_triangle *t = &scene->triangles[index];
    const lmg_vec3 n = vec_from_float(t->ng), a = vec_from_float(t->v[0]);
    double w[3][4], p[9][3], other[9][3], height = c->longest;
    uint32_t cell = 0;
    for (int k = 2; k >= 0; k--) {
        const double middle = ((double)t->v[0][k] + (double)t->v[1][k] + (double)t->v[2][k]) / 3;
        const double x = floor((middle - c->low[k]) * c->per_length), centre = c->low[k] + (x + 0.5) * c->width;
        if (!(x >= 0 && x < (double)c->size[k])) {
            return 0;
        }
        cell = cell * c->size[k] + (uint32_t)x;
        for (int i = 0; i < 3; i++) { /* what is that near is in the cell's list */
            height = least_of(height, 0.5 * c->width + c->longest - fabs((double)t->v[i][k] - centre));
        }
    }
    if (first[cell + 1] - first[cell] > MOST_NEAR) {
        return 0;
    }
    barycentrics(t, w);
    for (uint32_t j = first[cell]; j < first[cell + 1] && height > 0; j++) {
        const float(*v)[3] = scene->triangles[near[j]].v;
        double least = (double)INFINITY, most[3] = {0, 0, 0}, lo = (double)INFINITY, hi = -(double)INFINITY;
        if (near[j] == index) {
            continue;
        }
        for (int i = 0; i < 3; i++) {
            for (int k = 0; k < 3; k++) {
                p[i][k] = (double)v[i][k];
            }
            for (int k = 0; k < 3; k++) {
                most[k] = i == 0 ? linear(w[k], p[i]) : most_of(most[k], linear(w[k], p[i]));
            }
        }
        uint32_t count = 3;
        if (most[0] <= RIM || most[1] <= RIM || most[2] <= RIM) {
            continue;
        }
        for (int k = 0; k < 3 && count > 0; k++) {
            double side[9];
            for (uint32_t i = 0; i < count; i++) {
                side[i] = linear(w[k], p[i]) - RIM;
            }
            count = cut(count, p, side, other);
            memcpy(p, other, sizeof p);
        }
        for (uint32_t i = 0; i < count; i++) {
            const double h = vec_dot(n, vec_sub(vec(p[i][0], p[i][1], p[i][2]), a));
            lo = least_of(lo, h);
            hi = most_of(hi, h);
        }
        least = count == 0 ? (double)INFINITY : lo > 0 ? lo : hi < 0 ? -hi : 0;
        height = least_of(height, least);
    }
    return height > 0 ? height * (1 - 0x1p-20) : 0;
}

/* Fills the cells; false: no memory. */
static bool fill_cells(lum_clearance *c, const lum_scene *scene, double visits)
{
    const size_t cell_count = (size_t)c->size[0] * c->size[1] * c->size[2];
    const double half = (0.5 * c->width + c->longest) * (1 + 0x1p-20);
    uint32_t *first = calloc(cell_count + 2, sizeof *first), *near = malloc((size_t)(visits + 1) * sizeof *near);
    bool enough = first && near;
    /* Counts the triangles of each cell in first[cell + 2], then lists them. */
    for (int list = 0; list < 2 && enough; list++) {
        for (uint32_t i = 0; i < scene->model->triangle_count; i++) {
            const lum_triangle *t = &scene->triangles[i];
            uint32_t from[3], to[3];
            if (!cells_near(c, t, from, to)) {
                continue;
            }
            const lmg_vec3 a = vec_from_float(t->v[0]), n = vec_from_float(t->ng);
            const double reach = half * (fabs(n.x) + fabs(n.y) + fabs(n.z)) + c->end / UNIT;
            for (uint32_t z = from[2]; z <= to[2]; z++) {
                for (uint32_t y = from[1]; y <= to[1]; y++) {
                    for (uint32_t x = from[0]; x <= to[0]; x++) {
                        const lmg_vec3 centre = {c->low[0] + (x + 0.5) * c->width, c->low[1] + (y + 0.5) * c->width,
                                                 c->low[2] + (z + 0.5) * c->width};
                        if (fabs(vec_dot(n, vec_sub(centre, a))) > reach) {
                            continue;
                        }
                        const size_t cell = ((size_t)z * c->size[1] + y) * c->size[0] + x;
                        if (list) {
                            near[first[cell + 1]++] = i;
                        } else {
                            first[cell + 2]++;
                        }
                    }
                }
            }
        }
        for (size_t i = 2; i < cell_count + 2 && !list; i++) {
            first[i] += first[i - 1];
        }
    }
    for (uint32_t z = 0, cell = 0; z < c->size[2] && enough; z++) {
        for (uint32_t y = 0; y < c->size[1]; y++) {
            for (uint32_t x = 0; x < c->size[0] && enough; x++, cell++) {
                const lmg_vec3 centre = {c->low[0] + (x + 0.5) * c->width, c->low[1] + (y + 0.5) * c->width,
                                         c->low[2] + (z + 0.5) * c->width};
                piece pieces[MOST_NEAR];
                uint32_t count = 0;
                for (uint32_t k = first[cell]; k < first[cell + 1] && count < MOST_NEAR; k++) {
                    const lum_triangle *t = &scene->triangles[near[k]];
                    count += cut_piece(t, vec_from_float(t->ng), centre, half, &pieces[count]);
                }
                if (count == MOST_NEAR) {
                    c->cells[cell] = SILENT;
                } else {
                    enough = fill_cell(c, count, pieces, &c->cells[cell]);
                }
            }
        }
    }
    for (uint32_t i = 0; i < scene->model->triangle_count && enough; i++) {
        c->alone[i] = (float)height_alone(c, scene, i, first, near);
    }
    free(first);
    free(near);
    return enough;
}

/* How wide cells and how long ways should be, for the fineness of the mesh there; false: there is none. */
static bool choose_sizes(lum_clearance *c, const lum_scene *scene, const double extent[3], double thickness, double free_path)
{
    double width = CELL * thickness, area = 0, count = 0;
    c->longest = least_of(LONGEST_PATHS * free_path, LONGEST_WAY * thickness);
    for (uint32_t i = 0; i < scene->model->triangle_count; i++) {
        const float(*v)[3] = scene->triangles[i].v;
        const lmg_vec3 a = vec_from_float(v[0]), b = vec_from_float(v[1]), d = vec_from_float(v[2]);
        bool apart = false;
        for (int k = 0; k < 3; k++) {
            const double least = fmin((double)v[0][k], fmin((double)v[1][k], (double)v[2][k])) - c->low[k];
            const double most = fmax((double)v[0][k], fmax((double)v[1][k], (double)v[2][k])) - c->low[k];
            apart |= most < 0 || least > extent[k];
        }
        if (!apart) {
            area += 0.5 * vec_length(vec_cross(vec_sub(b, a), vec_sub(d, a)));
            count++;
        }
    }
    if (!(area > 0)) {
        return false;
    }
    const double wide = width + 2 * c->longest, most = sqrt(0.5 * NEAR * area / count); /* of a wall's two faces */
    if (most < wide) {
        width *= most / wide;
        c->longest *= most / wide;
    }
    while ((floor(extent[0] / width) + 1) * (floor(extent[1] / width) + 1) * (floor(extent[2] / width) + 1) > MOST_CELLS) {
        width *= 1.05;
    }
    c->width = width;
    c->per_length = 1 / width;
    for (int k = 0; k < 3; k++) {
        c->size[k] = (uint32_t)floor(extent[k] / width) + 1;
    }
    return true;
}

lmg_result lum_clearance_create(const lum_scene *scene, lmg_vec3 low, lmg_vec3 high, double thickness, double free_path,
                                lum_clearance **out, lmg_error *err)
{
    *out = NULL;
    /* in the unit these are rounded, and faces in the bounds must not be out of them */
    const lmg_vec3 rounding = {0x1p-40, 0x1p-40, 0x1p-40};
    low = vec_sub(vec_scale(low, scene->per_unit), rounding);
    high = vec_add(vec_scale(high, scene->per_unit), rounding);
    thickness *= scene->per_unit;
    free_path *= scene->per_unit;
    const double extent[3] = {high.x - low.x, high.y - low.y, high.z - low.z};
    if (!(free_path > 0 && thickness >= DENSE * free_path && extent[0] >= 0 && extent[1] >= 0 && extent[2] >= 0)) {
        return LMG_OK;
    }
    lum_clearance *c = calloc(1, sizeof *c);
    bool enough = c != NULL;
    if (c) {
        *c = (lum_clearance){
            .per_unit = scene->per_unit, .low = {low.x, low.y, low.z}, .high = {high.x, high.y, high.z}};
        if (!choose_sizes(c, scene, extent, thickness, free_path)) {
            free(c);
            return LMG_OK;
        }
        double visits = 0, error = 0;
        for (uint32_t i = 0; i < scene->model->triangle_count; i++) {
            uint32_t from[3], to[3];
            error = fmax(error, (double)scene->triangles[i].error);
            if (cells_near(c, &scene->triangles[i], from, to)) {
                visits += (double)(to[0] - from[0] + 1) * (to[1] - from[1] + 1) * (to[2] - from[2] + 1);
            }
        }
        if (!(visits <= MOST_VISITS)) {
            free(c);
            return LMG_OK;
        }
        c->start = START * error * UNIT;
        c->end = END * error * UNIT;
        c->cells = malloc((size_t)c->size[0] * c->size[1] * c->size[2] * sizeof *c->cells);
        c->triangles = scene->triangles;
        c->alone = malloc(((size_t)scene->model->triangle_count + 1) * sizeof *c->alone);
        enough = c->cells && c->alone && fill_cells(c, scene, visits);
    }
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
    free(c->alone);
    free(c->more);
    free(c);
}

/* Whether the piece o + t d, 0 < t < end, of a way that leaves a triangle is so near to it that nothing else can be met; its end
 * keeps a distance from everything. */
static bool stays_alone(const lum_clearance *c, uint32_t triangle, const double o[3], const double d[3], double end,
                        double distance)
{
    const lum_triangle *t = &c->triangles[triangle];
    const double p[3] = {o[0] + end * d[0], o[1] + end * d[1], o[2] + end * d[2]};
    const lmg_vec3 n = vec_from_float(t->ng), a = vec_from_float(t->v[0]);
    const double start_height = vec_dot(n, vec_sub(vec(o[0], o[1], o[2]), a)),
                 height = vec_dot(n, vec_sub(vec(p[0], p[1], p[2]), a));
    if (!(start_height * height > 0 && fabs(height) > fabs(start_height) + distance &&
          fabs(height) + distance < (double)c->alone[triangle])) {
        return false;
    }
    double w[3][4];
    barycentrics(t, w);
    bool over = true;
    for (int k = 0; k < 3; k++) { /* from the rim the end keeps the distance, too: at one height over the length of w it is 1 */
        const double in = linear(w[k], p) - 2 * RIM, square = w[k][0] * w[k][0] + w[k][1] * w[k][1] + w[k][2] * w[k][2];
        over &= linear(w[k], o) > 2 * RIM && in > 0 && in * in > distance * distance * square;
    }
    return over;
}

/* Whether the way from q, from the cell's centre, to q + d lies in its slabs, but for its start at `left`, a triangle or LUM_MISS;
 * o: its start in the model. */
static inline bool stays_within(const lum_clearance *c, const slab *s, uint32_t left, const double o[3], const double q[3],
                                const double d[3])
{
    for (;;) {
        /* along the way f = from + slope t + square t^2, 0 < t < 1 */
        const double nx = s->n[0], ny = s->n[1], nz = s->n[2], lo = (double)s->lo, hi = (double)s->hi, bend = (double)s->bend;
        double from = nx * q[0] + ny * q[1] + nz * q[2], slope = nx * d[0] + ny * d[1] + nz * d[2], square = 0;
        if (bend > 0) {
            const double xx = s->curve[0], yy = s->curve[1], zz = s->curve[2], xy = s->curve[3], xz = s->curve[4], yz = s->curve[5];
            const double gx = 2 * xx * q[0] + xy * q[1] + xz * q[2], gy = 2 * yy * q[1] + xy * q[0] + yz * q[2],
                         gz = 2 * zz * q[2] + xz * q[0] + yz * q[1];
            from += 0.5 * bend * (gx * q[0] + gy * q[1] + gz * q[2]);
            slope += bend * (gx * d[0] + gy * d[1] + gz * d[2]);
            square = bend * (d[0] * (xx * d[0] + xy * d[1] + xz * d[2]) + d[1] * (yy * d[1] + yz * d[2]) + zz * d[2] * d[2]);
        }
        const double to = from + slope + square;
        /* its extreme is on the way where the slopes at the two ends differ in sign */
        const double between = slope * (slope + 2 * square) < 0 ? from - 0.25 * slope * slope / square : to;
        const double least = least_of(to, between), most = most_of(to, between);
        if (!((least - lo > c->start) & (hi - most > c->start) & (to - lo > c->end) & (hi - to > c->end))) {
            return false;
        }
        if (!((from - lo > c->start) & (hi - from > c->start))) {
            /* The start is out of the slab, the rest is in it from where f is as far in as it should be: the way goes inwards. */
            const double short_of = from - lo > c->start ? hi - 2 * c->start - from : lo + 2 * c->start - from;
            if (left == LUM_MISS || !(slope * short_of > 0)) {
                return false;
            }
            const double in = 1.125 * short_of / slope, there = from + (slope + square * in) * in;
            if (!(in < 1 && there - lo > c->start && hi - there > c->start && slope * (slope + 2 * square * in) > 0 &&
                  stays_alone(c, left, o, d, in, 0))) {
                return false;
            }
        }
        if (s->more == 0) {
            return true;
        }
        s = &c->more[s->more - 1];
    }
}

void lum_clearance_many(const lum_clearance *c, size_t count, const uint32_t *which, const lmg_vec3 *origins,
                        const lmg_vec3 *directions, const double *reach, const uint32_t *left, bool *clear)
{
    const slab *cells[LUM_MAX_RAYS];
    double q[LUM_MAX_RAYS][3];
    for (size_t k = 0; k < count; k++) {
        const lmg_vec3 p = vec_scale(origins[which[k]], c->per_unit);
        const double x = (p.x - c->low[0]) * c->per_length, y = (p.y - c->low[1]) * c->per_length,
                     z = (p.z - c->low[2]) * c->per_length;
        /* not beyond the bounds: light that came out of an open solid is the tracer's to let go */
        const bool in = (x >= 0) & (p.x <= c->high[0]) & (y >= 0) & (p.y <= c->high[1]) & (z >= 0) & (p.z <= c->high[2]) &
                        (x < (double)c->size[0]) & (y < (double)c->size[1]) & (z < (double)c->size[2]) & (reach[which[k]] * c->per_unit <= c->longest);
        const int64_t i = in ? (int64_t)x : 0, j = in ? (int64_t)y : 0, l = in ? (int64_t)z : 0;
        cells[k] = in ? &c->cells[(l * c->size[1] + j) * c->size[0] + i] : &SILENT;
        __builtin_prefetch(cells[k]);
        q[k][0] = p.x - (c->low[0] + ((double)i + 0.5) * c->width);
        q[k][1] = p.y - (c->low[1] + ((double)j + 0.5) * c->width);
        q[k][2] = p.z - (c->low[2] + ((double)l + 0.5) * c->width);
    }
    for (size_t k = 0; k < count; k++) {
        const lmg_vec3 d = directions[which[k]], o = vec_scale(origins[which[k]], c->per_unit);
        const double r = cells[k] == &SILENT ? 0 : reach[which[k]] * c->per_unit; /* that may be infinite */
        const double start[3] = {o.x, o.y, o.z}, way[3] = {r * d.x, r * d.y, r * d.z};
        const uint32_t from = left ? left[which[k]] : LUM_MISS;
        clear[k] = stays_within(c, cells[k], from, start, q[k], way) ||
                   (from != LUM_MISS && r > 0 && stays_alone(c, from, start, way, 1, c->end / UNIT));
    }
}

bool lum_clearance_clear(const lum_clearance *c, lmg_vec3 origin, lmg_vec3 direction, double reach)
{
    bool clear;
    lum_clearance_many(c, 1, &(uint32_t){0}, &origin, &direction, &reach, NULL, &clear);
    return clear;
}
