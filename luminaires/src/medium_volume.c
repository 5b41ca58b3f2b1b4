/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Flights through lattices of density: a walk from brick to brick, and from cell to cell where the lattice says that this pays
 * [amanatides1987], with tentative collisions at the rate of the local bound; see medium.h.
 */
#include "medium_grid.h"

#include "vec.h"

#include <stdlib.h>

/* Walks are kept on the stack. */
enum { MAX_VOLUMES = 16 };

typedef struct volume {
    const lum_grid *grid;
    lum_medium medium;
    double to_bricks[3][4]; /* from the model's frame minus centre to brick coordinates */
} volume;

struct lum_volumes {
    uint32_t count;
    volume volume[];
};

lmg_result lum_volumes_create(const lum_model *model, lum_volumes **out, lmg_error *err)
{
    *out = NULL;
    if (model->volume_count == 0)
        return LMG_OK;
    if (model->volume_count > MAX_VOLUMES)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: %u volumes; at most %d are supported", model->path, model->volume_count,
                        MAX_VOLUMES);
    lum_volumes *v = malloc(sizeof(*v) + model->volume_count * sizeof(v->volume[0]));
    if (!v)
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory");
    v->count = model->volume_count;
    for (uint32_t i = 0; i < v->count; ++i) {
        const lum_volume *from = &model->volumes[i];
        volume *to = &v->volume[i];
        to->grid = from->grid;
        lum_medium_set(&to->medium, from->scattering, from->absorption, from->anisotropy);
        const double half = from->grid->interpolation == LUM_INTERPOLATION_NEAREST ? 0.5 : 0;
        for (int a = 0; a < 3; ++a) {
            for (int k = 0; k < 4; ++k)
                to->to_bricks[a][k] = (from->to_index[a][k] + (k == 3 ? half : 0)) / LUM_GRID_BRICK;
            to->to_bricks[a][3] -= from->grid->base[a];
        }
    }
    *out = v;
    return LMG_OK;
}

void lum_volumes_destroy(lum_volumes *v)
{
    free(v);
}

/* A walk through a block of n cubic cells of side 1. */
typedef struct walk {
    double next[3]; /* where, along the ray, the next face across each axis is */
    double step[3]; /* from face to face */
    int32_t at[3], way[3];
} walk;

/* Starts at distance t, where the ray is at p; n: cells along each axis.  Rounding may have put p a little outside. */
static void walk_begin(walk *w, const double p[3], const double d[3], double t, const int32_t n[3])
{
    for (int a = 0; a < 3; ++a) {
        const double f = floor(p[a]);
        int32_t i = f < 0 ? 0 : f >= n[a] ? n[a] - 1 : (int32_t)f;
        w->at[a] = i;
        /* Slower than this, a ray doesn't cross a cell in any distance that matters, and 1/d might overflow. */
        if (fabs(d[a]) < 1e-200) {
            w->way[a] = 0;
            w->next[a] = w->step[a] = INFINITY;
            continue;
        }
        const double inverse = 1 / d[a];
        w->way[a] = d[a] > 0 ? 1 : -1;
        w->step[a] = fabs(inverse);
        w->next[a] = t + ((d[a] > 0 ? i + 1 : i) - p[a]) * inverse;
    }
}

static int walk_axis(const walk *w)
{
    return w->next[0] < w->next[1] ? (w->next[0] < w->next[2] ? 0 : 2) : (w->next[1] < w->next[2] ? 1 : 2);
}

/* To the next cell across an axis; false outside. */
static bool walk_on(walk *w, int axis, const int32_t n[3])
{
    w->next[axis] += w->step[axis];
    w->at[axis] += w->way[axis];
    return w->at[axis] >= 0 && w->at[axis] < n[axis];
}

static const int32_t BRICK_CELLS[3] = {LUM_GRID_BRICK, LUM_GRID_BRICK, LUM_GRID_BRICK};

/* A flight through one volume. */
typedef struct flight {
    const volume *v;
    double o[3], d[3]; /* brick coordinates */
    double t, end;
    walk bricks, cells;
    bool in_blocks; /* `bricks` walks over blocks of bricks, and there are neither a brick nor cells */
    const lum_brick *brick;
    bool in_cells; /* the bound is that of a cell of `cells` */
    double bound;  /* of the density, here */
    double exit;   /* where it stops to apply */
} flight;

static double clamp_to(double x, double end)
{
    return x < end ? x : end;
}

static void enter_cell(flight *f)
{
    const walk *w = &f->cells;
    const float *most = f->v->grid->values + lum_brick_cells(f->v->grid, f->brick);
    f->bound = (double)most[(w->at[0] * LUM_GRID_BRICK + w->at[1]) * LUM_GRID_BRICK + w->at[2]];
    f->exit = clamp_to(w->next[walk_axis(w)], f->end);
}

/* Starts a walk from cell to cell where the flight is. */
static void begin_cells(flight *f)
{
    double p[3], d[3];
    for (int a = 0; a < 3; ++a) {
        p[a] = (f->o[a] + f->t * f->d[a] - f->bricks.at[a]) * LUM_GRID_BRICK;
        d[a] = f->d[a] * LUM_GRID_BRICK;
    }
    walk_begin(&f->cells, p, d, f->t, BRICK_CELLS);
}

static void enter_brick(flight *f, bool cells_wherever_there_are_values)
{
    const lum_grid *g = f->v->grid;
    if (f->in_blocks) {
        const walk *w = &f->bricks;
        f->in_cells = false;
        f->bound = (double)g->block_most[((size_t)w->at[0] * (size_t)g->blocks[1] + (size_t)w->at[1]) * (size_t)g->blocks[2] +
                                         (size_t)w->at[2]];
        f->exit = clamp_to(w->next[walk_axis(w)], f->end);
        return;
    }
    f->brick = &g->table[lum_brick_index(g, f->bricks.at)];
    f->in_cells = f->brick->by_cell || (cells_wherever_there_are_values && f->brick->values != LUM_NO_VALUES);
    f->bound = (double)f->brick->most;
    f->exit = clamp_to(f->bricks.next[walk_axis(&f->bricks)], f->end);
    if (f->in_cells) {
        begin_cells(f);
        if (f->brick->by_cell)
            enter_cell(f);
        else
            f->exit = clamp_to(f->cells.next[walk_axis(&f->cells)], f->end);
    }
}

/* To where the next bound applies; false at the end. */
static bool go_on(flight *f, bool cells_wherever_there_are_values)
{
    f->t = f->exit;
    if (f->in_cells) {
        if (f->t >= f->end)
            return false;
        if (walk_on(&f->cells, walk_axis(&f->cells), BRICK_CELLS)) {
            if (f->brick->by_cell)
                enter_cell(f);
            else
                f->exit = clamp_to(f->cells.next[walk_axis(&f->cells)], f->end);
            return true;
        }
    }
    const lum_grid *g = f->v->grid;
    if (f->t >= f->end || !walk_on(&f->bricks, walk_axis(&f->bricks), f->in_blocks ? g->blocks : g->bricks))
        return false;
    enter_brick(f, cells_wherever_there_are_values);
    return true;
}

/* Clips the ray to the volume; false when it doesn't meet it. */
static bool begin(flight *f, const volume *v, lmg_vec3 o, lmg_vec3 d, double t_max, bool cells_wherever_there_are_values)
{
    const lum_grid *g = v->grid;
    double from = 0, to = t_max;
    f->v = v;
    for (int a = 0; a < 3; ++a) {
        const double *m = v->to_bricks[a];
        f->o[a] = m[0] * o.x + m[1] * o.y + m[2] * o.z + m[3];
        f->d[a] = m[0] * d.x + m[1] * d.y + m[2] * d.z;
        if (fabs(f->d[a]) < 1e-200) {
            if (f->o[a] < g->clip_low[a] || f->o[a] >= g->clip_high[a])
                return false;
            continue;
        }
        const double inverse = 1 / f->d[a], low = (g->clip_low[a] - f->o[a]) * inverse,
                     high = (g->clip_high[a] - f->o[a]) * inverse;
        from = fmax(from, fmin(low, high));
        to = fmin(to, fmax(low, high));
    }
    if (!(from < to))
        return false;
    f->t = from;
    f->end = to;
    f->in_blocks = g->group > 1 && !cells_wherever_there_are_values;
    const double scale = f->in_blocks ? 1.0 / g->group : 1;
    double p[3], step[3];
    for (int a = 0; a < 3; ++a) {
        p[a] = (f->o[a] + from * f->d[a]) * scale;
        step[a] = f->d[a] * scale;
    }
    walk_begin(&f->bricks, p, step, from, f->in_blocks ? g->blocks : g->bricks);
    enter_brick(f, cells_wherever_there_are_values);
    return true;
}

/* Flies to the next tentative collision; false when there is none. */
static bool next_collision(flight *f, lum_rng *rng)
{
    const double rate = f->v->medium.majorant;
    double depth = -log(1 - lum_rng_next(rng));
    for (;;) {
        const double sigma = f->bound * rate, across = (f->exit - f->t) * sigma;
        if (depth < across) {
            f->t = clamp_to(f->t + depth / sigma, f->exit);
            return true;
        }
        /* across is negative when rounding put a face a little before t */
        depth -= across > 0 ? across : 0;
        if (f->exit < f->t)
            f->exit = f->t;
        if (!go_on(f, false))
            return false;
    }
}

/* The brick that the flight is in, and where in it, in cells. */
static const lum_brick *place(const flight *f, double q[3])
{
    const lum_grid *g = f->v->grid;
    int32_t brick[3];
    for (int a = 0; a < 3; ++a) {
        const double x = f->o[a] + f->t * f->d[a];
        brick[a] = !f->in_blocks ? f->bricks.at[a] : x < 0 ? 0 : x >= g->bricks[a] ? g->bricks[a] - 1 : (int32_t)x;
        q[a] = (x - brick[a]) * LUM_GRID_BRICK;
    }
    return f->in_blocks ? &g->table[lum_brick_index(g, brick)] : f->brick;
}

/* Density where the flight is; below or at the flight's bound (rounding may put a point that belongs to one cell into its
 * neighbour). */
static double density_at(const flight *f, const lum_brick *b, const double q[3])
{
    const lum_grid *g = f->v->grid;
    if (b->values == LUM_NO_VALUES)
        return fmin((double)b->most, f->bound);
    if (f->in_cells && g->interpolation == LUM_INTERPOLATION_NEAREST)
        return f->bound;
    return fmin(lum_brick_density(g->values + b->values, g->interpolation, q), f->bound);
}

/* A tentative collision in a grey medium.  Mostly the brick's bounds decide, and its values needn't be fetched from memory. */
static lum_flight_event decide_grey(const flight *f, lum_rng *rng)
{
    const lum_medium *m = &f->v->medium;
    const double level = lum_rng_next(rng) * f->bound;
    double q[3];
    const lum_brick *b = place(f, q);
    if (level >= (double)b->most || (level >= (double)b->least && level >= density_at(f, b, q)))
        return LUM_FLIGHT_PASSED;
    if (m->scattering[0] < m->majorant && lum_rng_next(rng) * m->majorant >= m->scattering[0])
        return LUM_FLIGHT_ABSORBED;
    return LUM_FLIGHT_SCATTERED;
}

/* A tentative collision in a coloured medium; updates the factors.  A photon that goes on, also after a null collision, keeps
 * luminance 1 (for shares that aren't negative). */
static lum_flight_event decide_coloured(const flight *f, const double share[3], lum_rng *rng, double factor[3])
{
    const lum_medium *m = &f->v->medium;
    double q[3], p[3], total = 0, scattered = 0, absorbed = 0, sum = 0;
    const lum_brick *b = place(f, q);
    const double scale = density_at(f, b, q) / f->bound / m->majorant, u = lum_rng_next(rng);
    for (int c = 0; c < 3; ++c)
        total += p[c] = fabs(share[c] * factor[c]);
    for (int c = 0; c < 3; ++c) {
        p[c] /= total;
        scattered += p[c] * scale * m->scattering[c];
        absorbed += p[c] * scale * (m->extinction[c] - m->scattering[c]);
    }
    if (u >= scattered && u < scattered + absorbed)
        return LUM_FLIGHT_ABSORBED;
    const bool real = u < scattered;
    double chance[3];
    for (int c = 0; c < 3; ++c) {
        chance[c] = real ? scale * m->scattering[c] : fmax(1 - scale * m->extinction[c], 0);
        sum += p[c] * chance[c];
    }
    /* sum is the probability of what happened, up to rounding, and with it dividing keeps the luminance to the last bits. */
    for (int c = 0; c < 3; ++c)
        factor[c] *= sum > 0 ? chance[c] / sum : 1;
    return real ? LUM_FLIGHT_SCATTERED : LUM_FLIGHT_PASSED;
}

void lum_volumes_fly(const lum_volumes *volumes, lmg_vec3 origin, lmg_vec3 direction, double t_max, const double share[3],
                     lum_rng *rng, lum_flight *out)
{
    /* The tentative collisions of all volumes, in the order in which the photon meets them. */
    flight flights[MAX_VOLUMES];
    uint32_t count = 0;
    for (uint32_t i = 0; i < volumes->count; ++i)
        if (begin(&flights[count], &volumes->volume[i], origin, direction, t_max, false) && next_collision(&flights[count], rng))
            ++count;
    *out = (lum_flight){.event = LUM_FLIGHT_PASSED, .t = t_max, .factor = {1, 1, 1}};
    while (count > 0) {
        uint32_t first = 0;
        for (uint32_t i = 1; i < count; ++i)
            first = flights[i].t < flights[first].t ? i : first;
        flight *f = &flights[first];
        const lum_flight_event event = f->v->medium.grey ? decide_grey(f, rng) : decide_coloured(f, share, rng, out->factor);
        if (event != LUM_FLIGHT_PASSED) {
            out->event = event;
            out->t = f->t;
            out->g = f->v->medium.g;
            return;
        }
        if (!next_collision(f, rng)) {
            --count;
            if (first != count)
                flights[first] = flights[count];
        }
    }
}

/* Integral of the density over the piece of a cell from t to exit: two points of Gauss and Legendre, exact for cubics. */
static double cell_integral(const flight *f)
{
    const lum_grid *g = f->v->grid;
    const double length = f->exit - f->t, offset = 0.5 / sqrt(3.0);
    double sum = 0;
    for (int k = -1; k <= 1; k += 2) {
        const double t = f->t + (0.5 + k * offset) * length;
        double q[3];
        for (int a = 0; a < 3; ++a) {
            /* in the cell that the walk says: at its faces, rounding might read another cell's polynomial */
            q[a] = (f->o[a] + t * f->d[a] - f->bricks.at[a]) * LUM_GRID_BRICK;
            q[a] = fmin(fmax(q[a], f->cells.at[a]), f->cells.at[a] + (1 - 0x1p-40));
        }
        sum += 0.5 * lum_brick_density(g->values + f->brick->values, g->interpolation, q);
    }
    return sum * length;
}

void lum_volumes_depth(const lum_volumes *volumes, lmg_vec3 origin, lmg_vec3 direction, double t_max, double depth[3])
{
    depth[0] = depth[1] = depth[2] = 0;
    for (uint32_t i = 0; i < volumes->count; ++i) {
        const volume *v = &volumes->volume[i];
        flight f;
        if (!begin(&f, v, origin, direction, t_max, true))
            continue;
        double column = 0;
        do {
            if (f.exit > f.t)
                column += f.in_cells ? cell_integral(&f) : f.bound * (f.exit - f.t);
            else
                f.exit = f.t;
        } while (go_on(&f, true));
        for (int c = 0; c < 3; ++c)
            depth[c] += column * v->medium.extinction[c];
    }
}
