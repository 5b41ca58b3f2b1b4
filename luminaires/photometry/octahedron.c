/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Smooth reconstruction of an intensity on a recursively divided octahedron.  Level l has the directions (i, j, k) with integers
 * |i| + |j| + |k| = 2^l as its vertices, each with a smooth bump that reaches some neighbours; the bumps of a level are divided by
 * their sum, so that they add up to 1.  A vertex's coefficient is the mean, weighted with its bump, of what the levels so far leave
 * - a singular integral [freeden1998] - repeated a few times, which makes it the least-squares coefficient.  Coefficients that
 * matter little are dropped, mirror images kept once.
 */
#include "photometry_file.h"

#include "text.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

enum {
    MAX_LEVEL = 6,  /* 16386 vertices, 1.6 degrees apart: finer than photometric files are */
    POINTS = 192,   /* per side of the square of directions that integrals are taken over */
    PASSES = 6,     /* of the singular integral per level: the error left falls by about 3 with each */
    NEIGHBOURS = 64 /* more than a bump's reach has */
};
/* Reach of a bump in mean distances of vertices: below 1.2 there are directions that hardly any bump reaches. */
static const double REACH = 1.6;
/* A coefficient is dropped when it is smaller than this share of threshold x mean intensity: what all dropped ones of a level
 * change together is below that share of the threshold. */
static const double DROP = 0.3;

typedef struct level {
    uint32_t count;
    uint16_t *ids; /* sorted */
    float *values; /* cd */
} level;

struct lum_octahedron {
    bool mirror_x, mirror_z;
    unsigned levels; /* used: 0 .. levels - 1 */
    level level[MAX_LEVEL + 1];
    lum_octahedron_report report;
};

/* -------------------------------------------------------------------------------------------------------------- bumps */

static uint32_t id_count(int n)
{
    return 2u * (uint32_t)(2 * n + 1) * (uint32_t)(2 * n + 1);
}

static uint32_t id_of(int n, int i, int j, bool below)
{
    return 2u * ((uint32_t)(i + n) * (uint32_t)(2 * n + 1) + (uint32_t)(j + n)) + below;
}

/* The vertices whose bumps reach direction d (x along i, z along j, y along k), with their share; returns how many. */
static int neighbours(const lum_octahedron *o, int n, lmg_vec3 d, uint32_t ids[NEIGHBOURS], double shares[NEIGHBOURS])
{
    const double reach = REACH * sqrt(4 * PI / (4.0 * n * n + 2)), reach2 = reach * reach; /* chord */
    const double norm = n / (fabs(d.x) + fabs(d.y) + fabs(d.z)), pi = d.x * norm, pj = d.z * norm;
    /* Moving a direction by a chord c moves its image on |x| + |y| + |z| = n by at most (1 + sqrt 3) / 1 c n in each coordinate
     * where the sum is 1, and less elsewhere. */
    const double window = 2.74 * n * reach;
    const int i0 = (int)fmax(ceil(pi - window), -n), i1 = (int)fmin(floor(pi + window), n);
    int count = 0;
    double sum = 0;
    for (int i = i0; i <= i1; i++) {
        const int rest = n - abs(i);
        const int j0 = (int)fmax(ceil(pj - window), -rest), j1 = (int)fmin(floor(pj + window), rest);
        for (int j = j0; j <= j1; j++) {
            const int k = rest - abs(j);
            const double length = 1 / sqrt((double)i * i + (double)j * j + (double)k * k);
            for (int below = 0; below < (k > 0 ? 2 : 1); below++) {
                const double dx = i * length - d.x, dy = (below ? -k : k) * length - d.y, dz = j * length - d.z;
                const double c2 = dx * dx + dy * dy + dz * dz;
                if (c2 >= reach2 || count == NEIGHBOURS)
                    continue;
                const double t = 1 - c2 / reach2;
                ids[count] = id_of(n, o->mirror_x ? abs(i) : i, o->mirror_z ? abs(j) : j, below);
                shares[count] = t * t * t;
                sum += shares[count++];
            }
        }
    }
    for (int a = 0; a < count; a++)
        shares[a] /= sum;
    return count;
}

static double level_value(const lum_octahedron *o, unsigned l, lmg_vec3 d)
{
    uint32_t ids[NEIGHBOURS];
    double shares[NEIGHBOURS], sum = 0;
    const level *v = &o->level[l];
    if (v->count == 0)
        return 0;
    const int count = neighbours(o, 1 << l, d, ids, shares);
    for (int a = 0; a < count; a++) {
        uint32_t low = 0, high = v->count;
        while (low < high) {
            const uint32_t middle = low + (high - low) / 2;
            if (v->ids[middle] < ids[a])
                low = middle + 1;
            else
                high = middle;
        }
        if (low < v->count && v->ids[low] == ids[a])
            sum += shares[a] * (double)v->values[low];
    }
    return sum;
}

double lum_octahedron_intensity(const lum_octahedron *o, lmg_vec3 direction)
{
    double sum = 0;
    for (unsigned l = 0; l < o->levels; l++)
        sum += level_value(o, l, direction);
    return fmax(sum, 0);
}

/* ------------------------------------------------------------------------------------------------------------ building */

/* Point i of n x n directions of equal solid angle: rings of equal height, turned against each other by the golden ratio. */
static lmg_vec3 direction_of(uint32_t i, uint32_t n)
{
    const double y = 1 - (2.0 * (i / n) + 1) / n, phi = 2 * PI * ((i % n + 0.5) / n + 0.6180339887498949 * (i / n)),
                 r = sqrt(1 - y * y);
    return (lmg_vec3){r * cos(phi), y, r * sin(phi)};
}

typedef struct building {
    uint32_t points;
    double *rest;    /* what is left at each point, cd */
    uint32_t *first; /* of each point's neighbours, points + 1 of them */
    uint32_t *ids;
    float *shares;
    double *value, *change, *weight; /* per id */
} building;

static bool find_neighbours(building *b, const lum_octahedron *o, int n)
{
    size_t used = 0, room = 0;
    for (uint32_t p = 0; p < b->points; p++) {
        uint32_t ids[NEIGHBOURS];
        double shares[NEIGHBOURS];
        const int count = neighbours(o, n, direction_of(p, POINTS), ids, shares);
        if (used + (size_t)count > room) {
            room = 2 * room + 16 * (size_t)b->points;
            uint32_t *more_ids = realloc(b->ids, room * sizeof *more_ids);
            b->ids = more_ids ? more_ids : b->ids;
            float *more = realloc(b->shares, room * sizeof *more);
            b->shares = more ? more : b->shares;
            if (!more_ids || !more)
                return false;
        }
        b->first[p] = (uint32_t)used;
        for (int a = 0; a < count; a++, used++) {
            b->ids[used] = ids[a];
            b->shares[used] = (float)shares[a];
        }
    }
    b->first[b->points] = (uint32_t)used;
    return true;
}

/* Adds the weighted means of what is left to the values, and takes their bumps off it.  keep (NULL = all): which may change. */
static void pass(building *b, uint32_t ids, const bool *keep)
{
    memset(b->change, 0, ids * sizeof *b->change);
    memset(b->weight, 0, ids * sizeof *b->weight);
    for (uint32_t p = 0; p < b->points; p++)
        for (uint32_t a = b->first[p]; a < b->first[p + 1]; a++) {
            b->change[b->ids[a]] += (double)b->shares[a] * b->rest[p];
            b->weight[b->ids[a]] += (double)b->shares[a];
        }
    for (uint32_t k = 0; k < ids; k++) {
        b->change[k] = b->weight[k] > 0 && (!keep || keep[k]) ? b->change[k] / b->weight[k] : 0;
        b->value[k] += b->change[k];
    }
    for (uint32_t p = 0; p < b->points; p++)
        for (uint32_t a = b->first[p]; a < b->first[p + 1]; a++)
            b->rest[p] -= (double)b->shares[a] * b->change[b->ids[a]];
}

static bool build_level(building *b, lum_octahedron *o, unsigned l, double least)
{
    const int n = 1 << l;
    const uint32_t ids = id_count(n);
    if (!find_neighbours(b, o, n))
        return false;
    memset(b->value, 0, ids * sizeof *b->value);
    for (int k = 0; k < PASSES; k++)
        pass(b, ids, NULL);
    /* Drop, and let the others take what they can of the dropped. */
    bool *keep = calloc(ids, sizeof *keep);
    if (!keep)
        return false;
    level *v = &o->level[l];
    for (uint32_t k = 0; k < ids; k++)
        v->count += keep[k] = b->weight[k] > 0 && fabs(b->value[k]) >= least;
    for (uint32_t p = 0; p < b->points; p++)
        for (uint32_t a = b->first[p]; a < b->first[p + 1]; a++)
            if (!keep[b->ids[a]])
                b->rest[p] += (double)b->shares[a] * b->value[b->ids[a]];
    for (int k = 0; k < PASSES / 2; k++)
        pass(b, ids, keep);
    v->ids = malloc((v->count + 1u) * sizeof *v->ids);
    v->values = malloc((v->count + 1u) * sizeof *v->values);
    for (uint32_t k = 0, at = 0; k < ids && v->ids && v->values; k++)
        if (keep[k]) {
            v->ids[at] = (uint16_t)k;
            v->values[at++] = (float)b->value[k];
        }
    free(keep);
    return v->ids && v->values;
}

/* Errors on directions other than those of the fit. */
static void measure_errors(const lum_photometry *p, lum_octahedron *o)
{
    const uint32_t n = 150;
    double mean = 0, error = 0, square = 0;
    for (uint32_t i = 0; i < n * n; i++) {
        const lmg_vec3 d = direction_of(i, n);
        const double x = lum_photometry_intensity(p, d), e = lum_octahedron_intensity(o, d) - x;
        mean += x;
        error += fabs(e);
        square += e * e;
    }
    o->report.mean_error = error / mean;
    o->report.rms_error = sqrt(square * n * n) / mean;
}

lmg_result lum_octahedron_create(const lum_photometry *p, unsigned max_level, double threshold, lum_octahedron **out,
                                 lmg_error *err)
{
    *out = NULL;
    if (max_level > MAX_LEVEL || !(threshold >= 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "level %u is outside 0..%d, or threshold %g negative", max_level, MAX_LEVEL,
                        threshold);
    LUM_TRY(lum_photometry_check(p, err));
    lum_octahedron *o = calloc(1, sizeof *o);
    building b = {.points = POINTS * POINTS};
    const uint32_t ids = id_count(1 << max_level);
    b.rest = malloc(b.points * sizeof *b.rest);
    b.first = malloc((b.points + 1u) * sizeof *b.first);
    b.value = malloc(ids * sizeof *b.value);
    b.change = malloc(ids * sizeof *b.change);
    b.weight = malloc(ids * sizeof *b.weight);
    bool ok = o && b.rest && b.first && b.value && b.change && b.weight;
    double mean = 0;
    if (ok) {
        const bool c = p->type == LUM_TYPE_C, quadrant = c && p->symmetry == LUM_SYMMETRY_QUADRANT;
        const bool axial = c && p->symmetry == LUM_SYMMETRY_AXIAL;
        o->mirror_x = quadrant || axial || (c && p->symmetry == LUM_SYMMETRY_C90_C270);
        o->mirror_z = quadrant || axial || (c && p->symmetry == LUM_SYMMETRY_C0_C180);
        for (uint32_t i = 0; i < b.points; i++)
            mean += b.rest[i] = lum_photometry_intensity(p, direction_of(i, POINTS));
        mean /= b.points;
    }
    for (unsigned l = 0; l <= max_level && ok && mean > 0; l++) {
        ok = build_level(&b, o, l, DROP * threshold * mean);
        o->levels = l + 1;
        o->report.level = l;
        o->report.coefficients += o->level[l].count;
        double error = 0;
        for (uint32_t i = 0; i < b.points; i++)
            error += fabs(b.rest[i]) / b.points;
        if (error < threshold * mean)
            break;
    }
    free(b.rest);
    free(b.first);
    free(b.ids);
    free(b.shares);
    free(b.value);
    free(b.change);
    free(b.weight);
    if (!ok || !(mean > 0)) {
        lum_octahedron_destroy(o);
        return ok ? lmg_fail(err, LMG_ERROR_INPUT, "the distribution holds no light")
                  : lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a divided octahedron");
    }
    o->report.bytes = o->report.coefficients * (sizeof *o->level[0].ids + sizeof *o->level[0].values);
    measure_errors(p, o);
    *out = o;
    return LMG_OK;
}

void lum_octahedron_destroy(lum_octahedron *o)
{
    if (!o)
        return;
    for (unsigned l = 0; l <= MAX_LEVEL; l++) {
        free(o->level[l].ids);
        free(o->level[l].values);
    }
    free(o);
}

lum_octahedron_report lum_octahedron_get_report(const lum_octahedron *o)
{
    return o->report;
}
