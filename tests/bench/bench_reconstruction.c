/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What a box makes of its photons, against the best uniform table: one opening or six faces, constant radiance in equal cells over
 * all directions, any split of the cells between (u,v) and (s,t), as many photons, and at most as many lit cells (dark ones cost a
 * file next to nothing; two leaves of a tree take as much of one as a cell), up to four times as many cells in all.  The tables stand on the planes and rectangles that the box's own
 * fit has found, and whatever passes beside them is taken as exact: all in the tables' favour.  So is that the best table is chosen
 * for each measure by itself.
 *
 * Measures, relative RMS each, no noise of judging in their mean:
 * - illuminance on planes of 32 x 32 pixels at 0.5 to 20 sizes, all in one and one by one; far-field intensity in 32 x 64 bins;
 * - luminance pictures: orthographic, 64 x 64 pixels, from eight directions, all in one;
 * - radiance, weighted with etendue (L2).
 *
 * Means of squares are taken as products of two independent estimates, so that noise has no part in them.  Box: rays that it emits,
 * in two halves, against two halves of the lamp's other photons.  Tables: the lamp's photons moved within their cells give what
 * infinitely many photons would (half against half, in common random numbers); their noise is that of a Poisson count, spread as
 * the cells spread it: the chance that a photon moved twice meets the same pixel both times.  Pictures and the square of the lamp's
 * radiance are those of paths followed backwards (viewer), the cross term with the box is the box's mean radiance along the lamp's
 * photons.  Whether the paths find the light that the photons bring is printed with it.  What of squares is below its standard error isn't told from nothing: two such errors count as alike.
 *
 * Usage: test_bench_reconstruction [LAMP|all [photons [cells, 0 = as many as the photons are worth [judging photons [sizes of
 * tables [rays [trees [looks]]]]]]]]; a line of JSON for each lamp.  rays: traced backwards for each photon that leaves, beside the box's photons (0; -1: as
 * the pilot says).  trees: radiance trees of the box (0), which radiance and pictures are then those of.  looks: for
 * these (as the bake decides).
 */
#include "bench_lamp.h"
#include "bench_seen.h"
#include "sampler.h"
#include "geometry.h"
#include "receiver.h"
#include "trees.h"

#include <luminaires/model.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PLANES = 6, PIXELS = 32, RINGS = 32, SECTORS = 64, VIEWS = 8, PICTURE = 64, SUBPIXELS = 64, MAX_TABLES = 24 };
enum { FAR = PLANES, RECEIVERS, BINS = RINGS * SECTORS }; /* bins: of the largest receiver */
static const double DISTANCE[PLANES] = {0.5, 1, 2, 5, 10, 20};
/* Directions of the pictures, degrees from the main axis: where a beam is, at its border, and where there is stray light only. */
static const double TILT[VIEWS] = {0, 3, 6, 15, 30, 45, 60, 75};
static const uint64_t SEED = 11;

static void *reserve(size_t count, size_t size)
{
    void *p = calloc(count, size);
    if (!p) {
        fprintf(stderr, "error: no memory for %zu x %zu bytes\n", count, size);
        exit(1);
    }
    return p;
}

/* ------------------------------------------------------------------------------------------------------------ receivers */

typedef struct instrument {
    lmg_vec3 axis, a, b, centre;
    bake_rectangle planes[PLANES];
    double radius; /* half the diagonal of the bounds */
} instrument;

/* Light in each pixel of each receiver, in two halves. */
typedef double images[2][RECEIVERS][BINS];

static int pixel_of(const instrument *in, int k, lmg_vec3 o, lmg_vec3 d)
{
    if (k == FAR) {
        int ring = (int)(0.5 * (1 - v_dot(d, in->axis)) * RINGS),
            sector = (int)((atan2(v_dot(d, in->b), v_dot(d, in->a)) / (2 * LMG_PI) + 0.5) * SECTORS);
        return (ring < RINGS ? ring : RINGS - 1) * SECTORS + (sector < SECTORS ? sector : SECTORS - 1);
    }
    const bake_rectangle *q = &in->planes[k];
    double dn = v_dot(d, in->axis);
    if (!(dn > 0))
        return -1;
    lmg_vec3 p = v_sub(v_fma(o, v_dot(v_sub(q->centre, o), in->axis) / dn, d), q->centre);
    double x = (v_dot(p, q->a) / q->width + 0.5) * PIXELS, y = (v_dot(p, q->b) / q->height + 0.5) * PIXELS;
    return x >= 0 && x < PIXELS && y >= 0 && y < PIXELS ? (int)y * PIXELS + (int)x : -1;
}

static double product(const double *a, const double *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

static double root(double square)
{
    return square >= 0 ? sqrt(square) : -sqrt(-square);
}

/* -------------------------------------------------------------------------------------------------------------- errors */

/* Squared relative errors. */
typedef struct errors {
    double planes[PLANES], near_field, far_field, pictures, radiance;
} errors;

static void finish_near(errors *e)
{
    e->near_field = 0;
    for (int k = 0; k < PLANES; k++)
        e->near_field += e->planes[k] / PLANES;
}

/* ------------------------------------------------------------------------------------------------------ uniform tables */

typedef struct table {
    uint32_t slab_count;
    lmg_slab slabs[6];
    float *flux[6];     /* of each cell, photons */
    double *etendue[6]; /* of the cells of one (u,v) cell */
    double side_uv, side_st;
    uint64_t cells, lit;
    double change[2][RECEIVERS][BINS], noise[RECEIVERS];
    errors error;
} table;

static uint32_t whole(double x)
{
    return (uint32_t)fmin(fmax(floor(x + 0.5), 1), 4096);
}

/* A table of about so many cells on the rectangles of the layout's wide slabs; split: (u,v) cells along a side over (s,t) cells. */
static table *table_create(const lmg_layout *like, double cells, double split)
{
    table *t = reserve(1, sizeof *t);
    /* of each direction the last slab before the six that catch everything else: the wide one, below its window */
    for (uint32_t j = 0; j + 6 < like->slab_count; j++)
        if (j + 7 == like->slab_count || v_dot(like->slabs[j].n, like->slabs[j + 1].n) < 1)
            t->slabs[t->slab_count++] = like->slabs[j];
    for (uint32_t k = 0; k < t->slab_count; k++) {
        lmg_slab *s = &t->slabs[k];
        double each = cells / t->slab_count, uv = sqrt(each) * split, ratio = sqrt((s->u1 - s->u0) / (s->v1 - s->v0));
        s->nu = whole(sqrt(uv) * ratio);
        s->nv = whole(uv / s->nu);
        s->ns = s->nt = whole(sqrt(each / ((double)s->nu * s->nv)));
        t->flux[k] = reserve((size_t)s->nu * s->nv * s->ns * s->nt, sizeof(float));
        t->cells += (uint64_t)s->nu * s->nv * s->ns * s->nt;
        t->etendue[k] = reserve((size_t)s->ns * s->nt, sizeof(double));
        for (uint32_t it = 0; it < s->nt; it++)
            for (uint32_t is = 0; is < s->ns; is++)
                t->etendue[k][it * s->ns + is] = lmg_slab_cell_etendue(s, 0, 0, is, it);
    }
    return t;
}

static void table_destroy(table *t)
{
    for (uint32_t k = 0; k < t->slab_count; k++) {
        free(t->flux[k]);
        free(t->etendue[k]);
    }
    free(t);
}

/* The slab and cell of a ray; -1: none. */
static int table_cell(const table *t, lmg_vec3 o, lmg_vec3 d, uint32_t i[4], size_t *cell)
{
    double x[4];
    for (uint32_t k = 0; k < t->slab_count; k++) {
        const lmg_slab *s = &t->slabs[k];
        if (!lmg_slab_coordinates(s, o, d, x))
            continue;
        const double lo[4] = {s->u0, s->v0, s->s0, s->t0}, hi[4] = {s->u1, s->v1, s->s1, s->t1};
        const uint32_t n[4] = {s->nu, s->nv, s->ns, s->nt};
        for (int c = 0; c < 4; c++) {
            i[c] = (uint32_t)((x[c] - lo[c]) / (hi[c] - lo[c]) * n[c]);
            i[c] = i[c] < n[c] ? i[c] : n[c] - 1;
        }
        *cell = ((size_t)i[1] * s->nu + i[0]) * s->ns * s->nt + (size_t)i[3] * s->ns + i[2];
        return (int)k;
    }
    return -1;
}

static double etendue_of(const table *t, int k, size_t cell)
{
    return t->etendue[k][cell % ((size_t)t->slabs[k].ns * t->slabs[k].nt)];
}

/* A ray of the cell, uniform in etendue. */
static void ray_in_cell(const lmg_slab *s, const uint32_t i[4], lum_rng *rng, lmg_vec3 *o, lmg_vec3 *d)
{
    const double lo[4] = {s->u0, s->v0, s->s0, s->t0}, hi[4] = {s->u1, s->v1, s->s1, s->t1};
    const uint32_t n[4] = {s->nu, s->nv, s->ns, s->nt};
    double x[4], weight = 1, most = 1;
    do {
        for (int c = 0; c < 4; c++)
            x[c] = lo[c] + (hi[c] - lo[c]) * (i[c] + lum_rng_next(rng)) / n[c];
        if (s->kind == LMG_SLAB_CUBE) {
            double near[2], r = 1 + x[2] * x[2] + x[3] * x[3];
            for (int c = 0; c < 2; c++) {
                double a = lo[2 + c] + (hi[2 + c] - lo[2 + c]) * i[2 + c] / n[2 + c], b = a + (hi[2 + c] - lo[2 + c]) / n[2 + c];
                near[c] = a > 0 ? a : b < 0 ? b : 0;
            }
            most = 1 + near[0] * near[0] + near[1] * near[1];
            weight = most * most / (r * r);
        }
    } while (lum_rng_next(rng) > weight);
    lmg_slab_ray(s, x, o, d);
}

/* A judging photon: what its cell does to it. */
static void table_spread(table *t, const instrument *in, const lmg_ray *ray, const int before[RECEIVERS], lum_rng *rng)
{
    uint32_t i[4];
    size_t cell;
    int half = (int)(ray->number & 1), k = table_cell(t, ray->origin, ray->direction, i, &cell);
    double y = lmg_luminance(ray->flux);
    lmg_vec3 o[2] = {ray->origin, ray->origin}, d[2] = {ray->direction, ray->direction};
    for (int n = 0; n < 2 && k >= 0; n++)
        ray_in_cell(&t->slabs[k], i, rng, &o[n], &d[n]);
    for (int r = 0; r < RECEIVERS; r++) {
        int first = k < 0 ? before[r] : pixel_of(in, r, o[0], d[0]), second = k < 0 ? before[r] : pixel_of(in, r, o[1], d[1]);
        t->noise[r] += first >= 0 && first == second ? y * y : 0;
        if (first == before[r])
            continue;
        if (before[r] >= 0)
            t->change[half][r][before[r]] -= y;
        if (first >= 0)
            t->change[half][r][first] += y;
    }
}

/* --------------------------------------------------------------------------------------------------------------- a trial */

typedef struct trial {
    bench_seen *lamp;
    lmg_field *field;
    instrument in;
    images *reference;
    uint32_t table_count;
    table *tables[MAX_TABLES];
    double cross, square; /* sums over judging photons: the box's radiance along them; a backward path along each */
    double table_cross[MAX_TABLES];
    double missing, missing_squares; /* sums of what a photon adds to the squared error of radiance, and of its square */
} trial;

static void fill_tables(void *self, const lmg_ray *rays, size_t n)
{
    trial *t = self;
    for (uint32_t k = 0; k < t->table_count; k++)
        for (size_t r = 0; r < n; r++) {
            uint32_t i[4];
            size_t cell;
            int slab = table_cell(t->tables[k], rays[r].origin, rays[r].direction, i, &cell);
            if (slab >= 0)
                t->tables[k]->flux[slab][cell] += (float)lmg_luminance(rays[r].flux);
        }
}

/* Whether the box's trees tell the radiance along a ray. */
static bool in_trees(const lmg_field *field, lmg_vec3 origin, lmg_vec3 direction)
{
    float at[4];
    return field->trees && lmg_trees_root(field->trees, &field->layout, origin, direction, at) >= 0;
}

static void judge_by(void *self, const lmg_ray *rays, size_t n)
{
    trial *t = self;
    for (size_t r = 0; r < n; r++) {
        const lmg_ray *ray = &rays[r];
        const double y = lmg_luminance(ray->flux);
        lum_rng rng = lum_rng_stream(SEED + 2, ray->number);
        int before[RECEIVERS];
        for (int k = 0; k < RECEIVERS; k++) {
            before[k] = pixel_of(&t->in, k, ray->origin, ray->direction);
            if (before[k] >= 0)
                (*t->reference)[ray->number & 1][k][before[k]] += y;
        }
        lmg_vec3 beyond = v_fma(ray->origin, 4 * t->in.radius, ray->direction);
        float rgb[3];
        lmg_field_radiance(t->field, beyond, ray->direction, in_trees(t->field, ray->origin, ray->direction) ? LMG_LINEAR : LMG_NEAREST, rgb, NULL);
        const double there = bench_seen_look(t->lamp, beyond, ray->direction, &rng), missing = y * (there - 2 * lmg_luminance(rgb));
        t->cross += y * lmg_luminance(rgb);
        t->square += y * there;
        t->missing += missing;
        t->missing_squares += missing * missing;
        for (uint32_t k = 0; k < t->table_count; k++) {
            table_spread(t->tables[k], &t->in, ray, before, &rng);
            uint32_t i[4];
            size_t cell;
            int slab = table_cell(t->tables[k], ray->origin, ray->direction, i, &cell);
            if (slab >= 0)
                t->table_cross[k] += y * (double)t->tables[k]->flux[slab][cell] / etendue_of(t->tables[k], slab, cell);
        }
    }
}

/* Pictures: luminance along SUBPIXELS rays in each of two halves of a pixel's samples. */
typedef struct picture_ray {
    lmg_vec3 from, travel;
} picture_ray;

static picture_ray sight(const instrument *in, int view, uint32_t pixel, int half, int sample)
{
    lum_rng rng = lum_rng_stream(SEED + 3, (((uint64_t)view * PICTURE * PICTURE + pixel) * 2 + (uint64_t)half) * SUBPIXELS +
                                               (uint64_t)sample);
    double tilt = TILT[view] * LMG_PI / 180, turn = 0.7 + 2.4 * view; /* golden angle: all sides */
    lmg_vec3 aside = v_fma(v_scale(cos(turn), in->a), sin(turn), in->b);
    lmg_vec3 travel = v_fma(v_scale(cos(tilt), in->axis), sin(tilt), aside), b = v_cross(in->axis, aside), a = v_cross(b, travel);
    double x = 2 * ((pixel % PICTURE + lum_rng_next(&rng)) / PICTURE) - 1,
           y = 2 * ((pixel / PICTURE + lum_rng_next(&rng)) / PICTURE) - 1;
    lmg_vec3 at = v_fma(v_fma(in->centre, x * in->radius, a), y * in->radius, b);
    return (picture_ray){v_fma(at, 4 * in->radius, travel), travel};
}

static void judge_pictures(trial *t, errors *box, errors *floor, double lumens_per_photon)
{
    double energy = 0, sum = 0, squares = 0, sums[MAX_TABLES] = {0};
    for (int view = 0; view < VIEWS; view++)
        for (uint32_t pixel = 0; pixel < PICTURE * PICTURE; pixel++) {
            double truth[2] = {0}, ours[2] = {0}, theirs[MAX_TABLES][2] = {{0}};
            for (int half = 0; half < 2; half++)
                for (int n = 0; n < SUBPIXELS; n++) {
                    picture_ray s = sight(&t->in, view, pixel, half, n);
                    lum_rng rng = lum_rng_stream(SEED + 4 + (uint64_t)half,
                                                 ((uint64_t)view * PICTURE * PICTURE + pixel) * SUBPIXELS + (uint64_t)n);
                    float rgb[3];
                    truth[half] += bench_seen_look(t->lamp, s.from, s.travel, &rng) / SUBPIXELS;
                    lmg_field_radiance(t->field, s.from, s.travel, LMG_LINEAR, rgb, NULL);
                    ours[half] += lmg_luminance(rgb) / SUBPIXELS;
                    for (uint32_t k = 0; k < t->table_count; k++) {
                        uint32_t i[4];
                        size_t cell;
                        int slab = table_cell(t->tables[k], s.from, s.travel, i, &cell);
                        if (slab >= 0)
                            theirs[k][half] += lumens_per_photon * (double)t->tables[k]->flux[slab][cell] /
                                               etendue_of(t->tables[k], slab, cell) / SUBPIXELS;
                    }
                }
            energy += truth[0] * truth[1];
            const double product_of_halves = (ours[0] - truth[0]) * (ours[1] - truth[1]);
            sum += product_of_halves;
            squares += product_of_halves * product_of_halves;
            for (uint32_t k = 0; k < t->table_count; k++)
                sums[k] += (theirs[k][0] - truth[0]) * (theirs[k][1] - truth[1]);
        }
    box->pictures = sum / energy;
    floor->pictures = sqrt(squares) / energy;
    for (uint32_t k = 0; k < t->table_count; k++)
        t->tables[k]->error.pictures = sums[k] / energy;
}

/* Square of the trees' radiance, lm cd/m2: their mean radiance along rays that are distributed as their light, times that light.
 * *found_part: light by paths backwards along these rays, over that of the trees, which is that of their photons: 1 if the judge is
 * right, but for what falls where trees are dark, and the noise of those photons. */
static double trees_self(const trial *t, uint64_t count, double *se, double *found_part, double *found_se)
{
    const lmg_field *field = t->field;
    const lmg_trees *trees = field->trees;
    double self = 0, squares = 0, flux = 0, found = 0, found_squares = 0;
    lum_rng rng = lum_rng_stream(SEED + 7, 0);
    for (uint32_t r = 0; r < trees->root_count; r++)
        for (uint32_t k = 0; k < trees->tree_count; k++) {
            const lmg_tree *tree = &trees->trees[k];
            const lmg_tiling *tiling = &trees->tilings[trees->roots[r].tiling];
            const lmg_slab *slab = &field->layout.slabs[tiling->slab], area = lmg_root_slab(trees, &field->layout, r);
            const uint32_t end = lmg_root_end(trees, tree, r);
            double *upto = reserve(end - tree->first[r], sizeof *upto), *etendue = reserve(tree->count, sizeof *etendue), sum = 0;
            lmg_tree_etendues(tree, r, &area, etendue);
            for (uint32_t i = tree->first[r]; i < end; i++)
                upto[i - tree->first[r]] = sum += tree->nodes[i].axis == LMG_LEAF ? (double)tree->nodes[i].radiance * etendue[i] : 0;
            const double light = sum / trees->tree_count;
            const uint64_t samples = 1 + count / trees->root_count / trees->tree_count;
            double mean = 0, square = 0, part = 0, part_square = 0;
            for (uint64_t n = 0; n < samples && sum > 0; n++) {
                const double want = lum_rng_next(&rng) * sum;
                uint32_t lo = 0, hi = end - tree->first[r] - 1;
                while (lo < hi) {
                    const uint32_t mid = (lo + hi) / 2;
                    upto[mid] > want ? (hi = mid) : (lo = mid + 1);
                }
                /* the leaf's box, by going down to it */
                lmg_tree_box b = lmg_tree_whole();
                const uint32_t leaf = tree->first[r] + lo;
                uint32_t at = tree->first[r];
                while (tree->nodes[at].axis < LMG_LEAF) {
                    const lmg_tree_node *fork = &tree->nodes[at];
                    const double cut = lmg_tree_cut(&b, fork->axis, fork->cut);
                    const bool second = leaf >= fork->second;
                    *(second ? &b.lo[fork->axis] : &b.hi[fork->axis]) = cut;
                    at = second ? fork->second : at + 1;
                }
                lmg_slab piece = *slab;
                double u[2] = {b.lo[0], b.hi[0]}, v[2] = {b.lo[1], b.hi[1]};
                for (int c = 0; c < 2; c++)
                    lmg_tile_place(tiling, r - tiling->first, 0, &u[c], &v[c]);
                piece.u0 = slab->u0 + u[0] * (slab->u1 - slab->u0), piece.u1 = slab->u0 + u[1] * (slab->u1 - slab->u0);
                piece.v0 = slab->v0 + v[0] * (slab->v1 - slab->v0), piece.v1 = slab->v0 + v[1] * (slab->v1 - slab->v0);
                piece.s0 = slab->s0 + b.lo[2] * (slab->s1 - slab->s0), piece.s1 = slab->s0 + b.hi[2] * (slab->s1 - slab->s0);
                piece.t0 = slab->t0 + b.lo[3] * (slab->t1 - slab->t0), piece.t1 = slab->t0 + b.hi[3] * (slab->t1 - slab->t0);
                piece.nu = piece.nv = piece.ns = piece.nt = 1;
                static const uint32_t only[4] = {0, 0, 0, 0};
                lmg_vec3 o, d;
                float rgb[3], where[4];
                do
                    ray_in_cell(&piece, only, &rng, &o, &d);
                while (tree->nodes[at].axis == LMG_EDGE && lmg_trees_root(trees, &field->layout, o, d, where) == (int)r &&
                       lmg_edge_below(&tree->nodes[at], &b, where) != (leaf == at + 1));
                const double far = 4 * v_length(v_sub(field->layout.bounds_max, field->layout.bounds_min));
                lmg_field_radiance(field, v_fma(o, far, d), d, LMG_LINEAR, rgb, NULL);
                /* numbers of its own, so that rays are the same whatever the viewer does; 0: rounding put the ray beside all slabs */
                lum_rng of_look = lum_rng_stream(SEED + 8, ((uint64_t)r * trees->tree_count + k) * samples + n);
                const double y = lmg_luminance(rgb), met = y > 0 ? bench_seen_look(t->lamp, v_fma(o, far, d), d, &of_look) / y : 0;
                mean += y;
                square += y * y;
                part += met;
                part_square += met * met;
            }
            mean /= (double)samples;
            part /= (double)samples;
            found += light * part;
            found_squares += light * light * fmax(part_square / (double)samples - part * part, 0) / (double)samples;
            flux += light;
            self += light * mean;
            squares += light * light * fmax(square / (double)samples - mean * mean, 0) / (double)samples;
            free(upto);
            free(etendue);
        }
    *se = sqrt(squares);
    *found_part = flux > 0 ? found / flux : 1;
    *found_se = flux > 0 ? sqrt(found_squares) / flux : 0;
    return self;
}

/* Rays of the box in the receivers, for box and reference scaled to lumens; the box's mean radiance along them, and the standard
 * error of that. */
static double emit(const trial *t, uint64_t count, images *out, double *se)
{
    double self = 0, squares = 0;
    for (uint64_t n = 0; n < count; n++) {
        lum_rng rng = lum_rng_stream(SEED + 6, n);
        double xi[5];
        lmg_ray ray;
        float rgb[3];
        for (int k = 0; k < 5; k++)
            xi[k] = lum_rng_next(&rng);
        if (!lmg_field_emit(t->field, xi, &ray))
            continue;
        for (int k = 0; k < RECEIVERS; k++) {
            int px = pixel_of(&t->in, k, ray.origin, ray.direction);
            if (px >= 0)
                (*out)[n & 1][k][px] += 1;
        }
        lmg_field_radiance(t->field, v_fma(ray.origin, 4 * t->in.radius, ray.direction), ray.direction, LMG_NEAREST, rgb, NULL);
        const double l = in_trees(t->field, ray.origin, ray.direction) ? 0 : lmg_luminance(rgb); /* theirs: trees_self */
        self += l;
        squares += l * l;
    }
    self /= (double)count;
    *se = sqrt(fmax(squares / (double)count - self * self, 0) / (double)count);
    return self;
}

/* ------------------------------------------------------------------------------------------------------------- printing */

static void print_errors(const char *what, const errors *e)
{
    printf("%-26s", what);
    for (int k = 0; k < PLANES; k++)
        printf(" %6.2f", 100 * root(e->planes[k]));
    printf("  %6.2f %6.2f %6.2f %6.2f\n", 100 * root(e->near_field), 100 * root(e->far_field), 100 * root(e->pictures),
           100 * root(e->radiance));
}

static void lower(double *least, double error)
{
    *least = error < *least ? error : *least;
}

/* Of two squared errors; where both are below what the judge can tell, they are alike. */
static double ratio_of(double error, double of, double floor)
{
    return sqrt(fmax(error, floor) / fmax(of, floor));
}

/*
 * Standard error of a squared error that is the product of halves: of independent differences with variances v in each pixel, the
 * sum of the products has the variance sum v^2.  The reference's noise and the box's, of as many rays, are taken as equal.
 */
static double resolution(const images *reference, int k, double energy, double scale)
{
    double squares = 0;
    for (int i = 0; i < BINS; i++) {
        double v =
            scale * scale * ((*reference)[0][k][i] + (*reference)[1][k][i]); /* a photon's flux is about 1; half of it, twice */
        squares += v * v;
    }
    return sqrt(squares) / energy;
}

static void run_lamp(const char *name, uint64_t photons, uint64_t cells, uint64_t judging, size_t sizes, double backward,
                     uint32_t trees, double looks)
{
    static const double SPLIT[] = {1.0 / 16, 1.0 / 4, 1, 4, 16, 64}, SIZE[] = {1.0 / 16, 1.0 / 4, 1, 4};
    lmg_error err;
    bench_seen l;
    bench_seen_open(&l, name, SEED + 1);
    bake_options options = {.photons = photons,
                            .rays_per_photon = backward,
                            .trees = trees,
                            .looks_chosen = looks >= 0,
                            .looks = (uint64_t)fmax(looks, 0),
                            .seed = SEED,
                            .fit = {.struct_size = sizeof options.fit, .cells = cells}};
    bake_report report;
    trial t = {.lamp = &l};
    bench_demand(bake_run(l.model, &options, &t.field, &report, &err), &err);
    printf("%s%s%.3g M rays backwards in %.1f s beside %.3g M photons in %.1f s\n", report.gather_why, report.gather_why[0] ? "\n" : "",
           1e-6 * (double)report.gathered_rays, report.gather_seconds, 1e-6 * (double)photons, report.trace_seconds);
    const lmg_layout *layout = lmg_field_layout(t.field);
    const lmg_ledger ledger = lmg_field_ledger(t.field);
    uint64_t lit = 0, all = 0;
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        all += t.field->slabs[j].cells;
        for (uint64_t i = 0; i < t.field->slabs[j].cells; i++)
            lit += lmg_cell_luminance(t.field, j, i) > 0;
    }
    const lmg_tree_totals grown = lmg_field_trees(t.field);
    if (grown.trees > 0)
        printf("%u trees with %.3g M leaves in %.1f s\n", grown.trees, 1e-6 * (double)grown.leaves, report.trees_seconds);
    lit += grown.leaves / 2;

    lmg_vec3 extent = v_sub(l.source->bounds_max, l.source->bounds_min);
    bake_ray_list *list;
    size_t pilot;
    bake_tally tally = {0};
    bench_demand(bake_ray_list_create(50000, &list, &err), &err);
    const lmg_sink sink = bake_ray_list_sink(list);
    bench_demand(l.source->run(l.source, BAKE_PILOT_FIRST, 50000, 0, &sink, 1, &tally, &err), &err);
    const lmg_ray *rays = bake_ray_list_sorted(list, &pilot);
    t.in.axis = bake_main_axis(rays, pilot);
    bake_ray_list_destroy(list);
    t.in.centre = v_scale(0.5, v_add(l.source->bounds_min, l.source->bounds_max));
    t.in.radius = 0.5 * v_length(extent);
    for (int k = 0; k < PLANES; k++)
        t.in.planes[k] = bake_measuring_rectangle(l.source->bounds_min, l.source->bounds_max, t.in.axis, layout->size,
                                                  DISTANCE[k] * layout->size, PIXELS);
    t.in.a = t.in.planes[0].a;
    t.in.b = t.in.planes[0].b;

    for (size_t k = 0; k < sizeof SIZE / sizeof *SIZE && k < sizes; k++)
        for (size_t i = 0; i < sizeof SPLIT / sizeof *SPLIT; i++) {
            table *made = table_create(layout, SIZE[k] * (double)all, SPLIT[i]);
            made->side_uv = made->slabs[0].nu;
            made->side_st = made->slabs[0].ns;
            t.tables[t.table_count++] = made;
        }
    /* the tables' photons are others than the box's, and others than the judge's */
    bench_seen_photons(&l, 0, photons, fill_tables, &t);
    uint32_t kept = 0;
    for (uint32_t k = 0; k < t.table_count; k++) {
        table *u = t.tables[k];
        double square = 0;
        for (uint32_t s = 0; s < u->slab_count; s++)
            for (size_t i = 0; i < (size_t)u->slabs[s].nu * u->slabs[s].nv * u->slabs[s].ns * u->slabs[s].nt; i++) {
                double f = (double)u->flux[s][i];
                u->lit += f > 0;
                square += f * f / etendue_of(u, (int)s, i);
            }
        if (u->lit > lit) {
            table_destroy(u);
            continue;
        }
        u->error.radiance = square;
        t.tables[kept++] = u;
    }
    t.table_count = kept;

    t.reference = reserve(1, sizeof *t.reference);
    bench_seen_photons(&l, UINT64_C(1) << 40, judging, judge_by, &t);
    images *emitted = reserve(1, sizeof *emitted);
    double self_se;
    const double self = emit(&t, judging, emitted, &self_se);
    const double flux = l.source->flux, per_judge = flux / (double)judging, per_photon = flux / (double)photons,
                 per_emitted = ledger.stored / (double)judging;

    errors box = {0}, floor = {0};
    /* squares of radiance, lm cd/m2: box, box x lamp, lamp */
    double trees_se = 0, light = 1, light_se = 0;
    const double bb = ledger.stored * self + (t.field->trees ? trees_self(&t, judging, &trees_se, &light, &light_se) : 0),
                 bl = per_judge * t.cross, ll = per_judge * t.square;
    box.radiance = (bb - 2 * bl + ll) / ll;
    floor.radiance =
        hypot(hypot(ledger.stored * self_se, trees_se), per_judge * sqrt(fmax(t.missing_squares - t.missing * t.missing / (double)judging, 0))) / ll;
    /* Cauchy and Schwarz: no light has less, but for noise; a lamp whose light paths don't find (fluorescence, say) has */
    const bool seen = ll > 0.9 * bl * bl / bb;
    if (seen)
        judge_pictures(&t, &box, &floor, per_photon);
    double scale = 2 * per_judge;
    for (int k = 0; k < RECEIVERS; k++) {
        double half[2][BINS], energy = product((*t.reference)[0][k], (*t.reference)[1][k], BINS) * scale * scale;
        for (int h = 0; h < 2; h++)
            for (int i = 0; i < BINS; i++)
                half[h][i] = 2 * per_emitted * (*emitted)[h][k][i] - scale * (*t.reference)[h][k][i];
        *(k == FAR ? &floor.far_field : &floor.planes[k]) = resolution(t.reference, k, energy, scale);
        *(k == FAR ? &box.far_field : &box.planes[k]) = product(half[0], half[1], BINS) / energy;
        for (uint32_t i = 0; i < t.table_count; i++) {
            table *u = t.tables[i];
            double blur = product(u->change[0][k], u->change[1][k], BINS) * scale * scale / energy;
            double noise = u->noise[k] * per_judge * per_photon / energy;
            *(k == FAR ? &u->error.far_field : &u->error.planes[k]) = blur + noise;
        }
    }
    finish_near(&box);
    for (int k = 0; k < PLANES; k++)
        floor.near_field = hypot(floor.near_field, floor.planes[k] / PLANES);
    errors best = {.near_field = INFINITY, .far_field = INFINITY, .pictures = INFINITY, .radiance = INFINITY};
    for (int k = 0; k < PLANES; k++)
        best.planes[k] = INFINITY;

    printf("%s: %.3g photons, %.3g cells, %.3g lit; judged by %.3g photons; sizes, errors in per cent\n%s", name, (double)photons,
           (double)cells, (double)lit, (double)judging, report.layout_why);
    printf("%-26s %6g %6g %6g %6g %6g %6g  %6s %6s %6s %6s\n", "", DISTANCE[0], DISTANCE[1], DISTANCE[2], DISTANCE[3], DISTANCE[4],
           DISTANCE[5], "planes", "far", "pictur", "radian");
    for (uint32_t k = 0; k < t.table_count; k++) {
        table *u = t.tables[k];
        u->error.radiance = (per_photon * per_photon * u->error.radiance - 2 * per_judge * per_photon * t.table_cross[k] + ll) / ll;
        finish_near(&u->error);
        char what[64];
        snprintf(what, sizeof what, "%gx%g %.2gM lit %.2gM", u->side_uv, u->side_st, 1e-6 * (double)u->cells,
                 1e-6 * (double)u->lit);
        print_errors(what, &u->error);
        for (int r = 0; r < PLANES; r++)
            lower(&best.planes[r], u->error.planes[r]);
        lower(&best.near_field, u->error.near_field);
        lower(&best.far_field, u->error.far_field);
        lower(&best.pictures, u->error.pictures);
        lower(&best.radiance, u->error.radiance);
    }
    print_errors("best of each measure", &best);
    print_errors("box", &box);
    print_errors("judge's resolution", &floor);
    if (seen && t.field->trees)
        printf("light by paths backwards over that of the trees: %.4f +- %.4f%s\n", light, light_se,
               fabs(light - 1) > 4 * light_se + 0.003 ? ": THE JUDGE IS WRONG" : "");
    const double ratio[4] = {
        ratio_of(box.near_field, best.near_field, floor.near_field), ratio_of(box.far_field, best.far_field, floor.far_field),
        ratio_of(box.pictures, best.pictures, floor.pictures), ratio_of(box.radiance, best.radiance, floor.radiance)};
    printf("box over best: planes %.2f, far %.2f", ratio[0], ratio[1]);
    if (seen)
        printf(", pictures %.2f, radiance %.2f\n\n", ratio[2], ratio[3]);
    else
        printf("; paths backwards don't find this lamp's light, so pictures and radiance aren't known\n\n");
    printf("{\"benchmark\": \"reconstruction\", \"lamp\": \"%s\", \"photons\": %.4g, \"cells\": %.4g, \"planes\": %.5g, "
           "\"far_field\": %.5g, "
           "\"planes_ratio\": %.4g, \"far_field_ratio\": %.4g",
           name, (double)photons, (double)all, root(box.near_field), root(box.far_field), ratio[0], ratio[1]);
    if (seen)
        printf(", \"light_ratio\": %.5g, \"light_ratio_se\": %.3g", light, light_se);
    if (seen)
        printf(", \"pictures\": %.5g, \"radiance\": %.5g, \"pictures_ratio\": %.4g, \"radiance_ratio\": %.4g", root(box.pictures),
               root(box.radiance), ratio[2], ratio[3]);
    printf("}\n");
    fflush(stdout);
    for (uint32_t k = 0; k < t.table_count; k++)
        table_destroy(t.tables[k]);
    free(t.reference);
    free(emitted);
    lmg_field_destroy(t.field);
    bench_seen_close(&l);
}

int main(int argc, char **argv)
{
    static const char *const LAMPS[] = {"paraboloid-spot", "glass-lens", "opal-globe", "louvred-panel", "phosphor-led"};
    const char *wanted = argc > 1 ? argv[1] : "all";
    const uint64_t photons = argc > 2 ? (uint64_t)atof(argv[2]) : 8000000, cells = argc > 3 ? (uint64_t)atof(argv[3]) : 0;
    const uint64_t judging = argc > 4 ? (uint64_t)atof(argv[4]) : 4000000;
    const double backward = argc > 6 ? atof(argv[6]) : 0;
    for (size_t i = 0; i < sizeof LAMPS / sizeof *LAMPS; i++)
        if (strcmp(wanted, "all") == 0 || strcmp(wanted, LAMPS[i]) == 0)
            run_lamp(LAMPS[i], photons, cells, judging, argc > 5 ? (size_t)atoi(argv[5]) : 4, backward,
                     argc > 7 ? (uint32_t)atoi(argv[7]) : 0, argc > 8 ? atof(argv[8]) : -1);
    return 0;
}
