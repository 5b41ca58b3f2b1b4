/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What cells do to the light, in three measures.
 *
 * Illuminance and intensity: each pilot ray is moved to a random place in its own cell (that is what a cell does to light), and
 * what falls on planes, and into directions, before and after is compared.  All candidates use the same random numbers, so that
 * they differ by what the cells do.  Squares are taken over pairs of different rays, whose noise is independent.
 *
 * Radiance: of a light field L cells keep the means M.  |L - M|^2 = |L|^2 - |M|^2, the norm being the integral of squares over
 * etendue, and |M|^2 is the sum of (flux of cell)^2 / (etendue of cell), which every pair of rays in one cell tells without bias: a
 * U-statistic [hoeffding1948].  The noise of the box adds its variance, sum of (photons' flux)^2 / etendue.
 *
 * The three differ by orders of magnitude: a good box has an error of some tenths of a per cent of illuminance and one of 30 % of
 * radiance.  So each counts in units of what is good.  Errors of illuminance and intensity count as far as they are certain: where
 * they aren't, radiance, which pairs of rays tell much more exactly, decides.  What cells do to smooth light is smooth itself, and
 * is seen above less noise in larger pixels; what they do to edges is seen in the smallest.
 *
 * Most candidates are hopeless, and an eighth of the rays says so: all three measures are without bias whatever the number of rays.
 * Relies on layout_columns.h for the arithmetic of rays and place.h for cells.
 */
#include "layout_judge.h"

#include "layout_columns.h"
#include "work.h"

#include <stdlib.h>
#include <string.h>

static const double PLANE_DISTANCE[LMG_JUDGE_PLANES] = {0.5, 1, 2, 5};
/* The directions of most of the light: what is left out at either end of both coordinates, and how much wider than the rest the
 * receiver is. */
static const double BEAM_TAIL = 0.3, BEAM_MARGIN = 1.5;
/* Pairs that a standard error of radiance can be believed with: it is a square root of their number. */
static const double PAIRS_ENOUGH = 30;
/* Errors of illuminance and intensity count by so many standard errors less than they seem.  With one, of the dozens of candidates
 * that do nothing to illuminance every sixth would look worse than those that radiance prefers. */
static const double CERTAIN = 2;
/* What some of the rays say holds for all of them within so many standard errors. */
static const double SURE = 3;
/* Rays are dealt with in at most so many parts, and their pairs in so many, whatever the number of processors, so that sums of
 * floats are always the same. */
enum { PARTS = 16, PART_BLOCKS = 8, PAIR_PARTS = 16 };
/* Pixels are looked at one by one, and in squares of 2 and 4 a side. */
enum { SCALES = 3 };

/* Rays to be judged. */
typedef struct block {
    size_t count;
    lmg_ray_columns rays;
    float flux[LMG_COLUMN];
    float jitter[4][LMG_COLUMN];
    lmg_pixels pixel; /* as they are */
} block;

/* What moving the rays changes, in a part of the work; and the squares of each change. */
typedef struct sums {
    float change[LMG_JUDGE_RECEIVERS][LMG_JUDGE_PIXELS + 1], squares[LMG_JUDGE_RECEIVERS][LMG_JUDGE_PIXELS + 1];
    double beside, beside_squares; /* flux of rays that no slab holds, and of its squares */
} sums;

/* A ray in a cell. */
typedef struct record {
    uint64_t cell;
    float flux, inverse; /* one over the cell's etendue */
} record;

typedef struct slot {
    uint64_t cell; /* 1 + the cell's number over all slabs; 0: empty */
    double sum, kept;
    uint64_t rays;
} slot;

/* Sums over pairs of rays in one cell. */
typedef struct pair_sums {
    double kept, pairs, noise; /* noise: sum of squares over etendue, of the pilot's rays */
    double squares;            /* sum over rays of (kept by pairs with that ray)^2, as if the rays of a cell were alike */
} pair_sums;

struct lmg_judge {
    lmg_receiver receivers[LMG_JUDGE_RECEIVERS];
    const lmg_pilot *pl;
    lmg_vec3 axes[3];                           /* a, b and n */
    double start;                               /* along n: where the light's box ends */
    double energy[SCALES][LMG_JUDGE_RECEIVERS]; /* of the light on them */
    double square;                              /* |L|^2; 0: not known */
    size_t count, block_count, part_count;
    block *blocks;
    record *scratch, *records;                    /* by part, and within by parts of the cells' hash */
    uint32_t first_record[PARTS][PAIR_PARTS + 1]; /* within a part */
    sums *parts, *whole;
    slot *slots;
    size_t first_slot[PAIR_PARTS], slot_count[PAIR_PARTS]; /* powers of two, twice the rays at least */
    pair_sums pair_parts[PAIR_PARTS];
    /* of the call under way */
    lmg_layout layout;
    lmg_plan plan;
    bool move;
    size_t first_part, end_part; /* dealt with at once */
};

/* The arithmetic of columns is of rays in the frame of the judge: along a, b and n. */
static void to_frame(const lmg_judge *q, lmg_vec3 o, lmg_vec3 d, lmg_ray_columns *out, size_t i)
{
    for (int k = 0; k < 3; k++) {
        out->origin[k][i] = v_dot(o, q->axes[k]);
        out->direction[k][i] = v_dot(d, q->axes[k]);
    }
}

/* The receiver of a beam: the part of the square of directions that holds the middle of the light, and as much again around it. */
static bool set_directions(lmg_judge *q)
{
    const lmg_pilot *pl = q->pl;
    lmg_receiver *beam = &q->receivers[LMG_JUDGE_PLANES + 1];
    double *x = malloc(pl->count * sizeof *x), *y = malloc(pl->count * sizeof *y), *w = malloc(pl->count * sizeof *w);
    size_t n = 0;
    for (size_t i = 0; x && y && w && i < pl->count; i++)
        if (v_dot(pl->direction[i], q->axes[2]) > 0) {
            lmg_cone_to_square(v_dot(pl->direction[i], q->axes[0]), v_dot(pl->direction[i], q->axes[1]), 1, &x[n], &y[n]);
            w[n++] = pl->flux[i];
        }
    const bool there = x && y && w;
    lmg_interval qx = {-1, 1, 0, 0}, qy = {-1, 1, 0, 0};
    if (there && n) {
        qx = lmg_quantiles(x, w, n, BEAM_TAIL);
        qy = lmg_quantiles(y, w, n, BEAM_TAIL);
    }
    /* a beam narrower than any cell will be: anything positive */
    const double wx = fmax((1 + BEAM_MARGIN) * (qx.hi - qx.lo), 1e-6), wy = fmax((1 + BEAM_MARGIN) * (qy.hi - qy.lo), 1e-6);
    *beam = (lmg_receiver){.x0 = 0.5 * (qx.lo + qx.hi - wx),
                           .y0 = 0.5 * (qy.lo + qy.hi - wy),
                           .scale = LMG_JUDGE_SIDE / wx,
                           .scale_y = LMG_JUDGE_SIDE / wy};
    free(x);
    free(y);
    free(w);
    return there;
}

/* The planes across the axis, each as wide as its distance on either side of the light's box. */
static void set_planes(lmg_judge *q)
{
    const lmg_pilot *pl = q->pl;
    const lmg_vec3 mid = v_scale(0.5, v_add(pl->light_lo, pl->light_hi)), half = v_scale(0.5, v_sub(pl->light_hi, pl->light_lo));
    q->start = v_dot(mid, q->axes[2]) + fabs(v_dot(half, q->axes[2]));
    for (int k = 0; k < LMG_JUDGE_PLANES; k++) {
        const double w = (PLANE_DISTANCE[k] + 0.5) * pl->size;
        q->receivers[k] = (lmg_receiver){.reach = PLANE_DISTANCE[k] * pl->size,
                                         .x0 = v_dot(mid, q->axes[0]) - w,
                                         .y0 = v_dot(mid, q->axes[1]) - w,
                                         .scale = LMG_JUDGE_SIDE / (2 * w),
                                         .scale_y = LMG_JUDGE_SIDE / (2 * w)};
    }
}

/* Puts ray i of the pilot, which is ray k of rays in the frame with their pixels, among those judged. */
static void add_ray(lmg_judge *q, size_t i, lmg_pixels pixel, size_t k)
{
    block *b = &q->blocks[q->count / LMG_COLUMN];
    const size_t m = b->count++;
    q->count++;
    for (int c = 0; c < 3; c++) {
        b->rays.origin[c][m] = v_axis(q->pl->origin[i], c);
        b->rays.direction[c][m] = v_axis(q->pl->direction[i], c);
    }
    b->flux[m] = (float)q->pl->flux[i];
    for (int c = 0; c < 4; c++)
        b->jitter[c][m] = q->pl->jitter[i][c];
    for (int r = 0; r < LMG_JUDGE_RECEIVERS; r++)
        b->pixel[r][m] = pixel[r][k];
}

/* What moves in the i-th square of 2^scale pixels a side of a receiver, and the squares of that. */
static void square_of_pixels(const sums *from, int k, int scale, int i, double *change, double *squares)
{
    const int wide = k == LMG_JUDGE_PLANES ? LMG_JUDGE_SECTORS : LMG_JUDGE_SIDE, side = 1 << scale;
    const int first = i / (wide >> scale) * side * wide + i % (wide >> scale) * side;
    *change = *squares = 0;
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++) {
            *change += (double)from->change[k][first + y * wide + x];
            *squares += (double)from->squares[k][first + y * wide + x];
        }
}

/* A step that goes through all of 0 .. count-1, modulo count, spread evenly from the start: rays may come in any order, as a file's do, and the
 * first of them have to speak for all. */
static size_t spread_step(size_t count)
{
    size_t step = (size_t)(0.6180339887498949 * (double)count) + 1; /* the golden section */
    for (;; step++) {
        size_t a = step, b = count;
        while (b) {
            const size_t rest = a % b;
            a = b;
            b = rest;
        }
        if (a == 1)
            return step;
    }
}

lmg_judge *lmg_judge_create(const lmg_pilot *pl, int c, bool all)
{
    lmg_judge *q = calloc(1, sizeof *q);
    if (!q)
        return NULL;
    q->pl = pl;
    lmg_class_frame(c, &q->axes[0], &q->axes[1], &q->axes[2]);
    size_t judged = 0;
    for (size_t i = 0; i < pl->count; i++)
        judged += all || pl->class[i] == c;
    q->block_count = (judged + LMG_COLUMN - 1) / LMG_COLUMN;
    q->part_count = q->block_count / PART_BLOCKS < PARTS ? q->block_count / PART_BLOCKS : PARTS;
    q->part_count = q->part_count ? q->part_count : 1;
    q->blocks = calloc(q->block_count + 1, sizeof *q->blocks);
    q->scratch = malloc((judged + 1) * sizeof *q->scratch);
    q->records = malloc((judged + 1) * sizeof *q->records);
    q->parts = malloc(q->part_count * sizeof *q->parts);
    q->whole = calloc(1, sizeof *q->whole);
    q->slots = malloc((4 * judged + PAIR_PARTS) * sizeof *q->slots);
    if (!q->blocks || !q->scratch || !q->records || !q->parts || !q->whole || !q->slots || !set_directions(q)) {
        lmg_judge_destroy(q);
        return NULL;
    }
    set_planes(q);
    /* relative to all light on the receivers, whatever its class */
    const size_t step = spread_step(pl->count);
    for (size_t first = 0, ray = 0; first < pl->count; first += LMG_COLUMN) {
        const size_t n = pl->count - first < LMG_COLUMN ? pl->count - first : LMG_COLUMN;
        lmg_ray_columns rays;
        lmg_pixels pixel;
        size_t at[LMG_COLUMN];
        for (size_t k = 0; k < n; k++, ray = (ray + step) % pl->count) {
            at[k] = ray;
            to_frame(q, pl->origin[ray], pl->direction[ray], &rays, k);
        }
        lmg_pixels_of(q->receivers, q->start, n, &rays, pixel);
        for (size_t k = 0; k < n; k++) {
            const float w = (float)pl->flux[at[k]];
            for (int r = 0; r < LMG_JUDGE_RECEIVERS; r++) {
                q->whole->change[r][pixel[r][k]] += w;
                q->whole->squares[r][pixel[r][k]] += w * w;
            }
            if (all || pl->class[at[k]] == c)
                add_ray(q, at[k], pixel, k);
        }
    }
    for (int scale = 0; scale < SCALES; scale++)
        for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++) {
            double energy = 0, squares = 0;
            for (int i = 0; i < LMG_JUDGE_PIXELS >> (2 * scale); i++) {
                double light, v;
                square_of_pixels(q->whole, k, scale, i, &light, &v);
                energy += light * light - v;
                squares += v;
            }
            /* of single rays in pixels the rounding of floats, 2^-23 of the squares, would be left */
            q->energy[scale][k] = energy > 1e-5 * squares ? energy : 0;
        }
    return q;
}

void lmg_judge_destroy(lmg_judge *q)
{
    if (!q)
        return;
    free(q->blocks);
    free(q->scratch);
    free(q->records);
    free(q->parts);
    free(q->whole);
    free(q->slots);
    free(q);
}

void lmg_judge_set_square(lmg_judge *q, double square)
{
    q->square = square;
}

double lmg_judge_square(const lmg_judge *q)
{
    return q->square;
}

bool lmg_better(lmg_verdict x, lmg_verdict than, double gain, double standard_errors)
{
    return x.error < than.error * gain && than.error - x.error > standard_errors * fmax(x.se, than.se);
}

/* What the moved rays, whose pixels are `after`, change. */
static void count_moves(const block *b, const lmg_members *m, lmg_pixels after, sums *out)
{
    for (int r = 0; r < LMG_JUDGE_RECEIVERS; r++) {
        uint16_t moved[LMG_COLUMN];
        size_t n = 0;
        for (size_t k = 0; k < m->count; k++) { /* first without a branch that nobody can predict */
            moved[n] = (uint16_t)k;
            n += after[r][k] != b->pixel[r][m->at[k]];
        }
        float *change = out->change[r], *squares = out->squares[r];
        for (size_t j = 0; j < n; j++) {
            const size_t k = moved[j], i = m->at[k];
            const float w = b->flux[i], w2 = w * w;
            const uint16_t from = b->pixel[r][i], to = after[r][k];
            change[from] -= w;
            squares[from] += w2;
            change[to] += w;
            squares[to] += w2;
        }
    }
}

/* Which part of the pairs a cell's are in: bits that depend on all of the number's. */
static inline uint64_t mixed(uint64_t cell)
{
    const uint64_t z = (cell ^ (cell >> 29)) * 0x9e3779b97f4a7c15u;
    return (z ^ (z >> 32)) * 0xbf58476d1ce4e5b9u;
}

/* The rays of a block: their cells to out, as many as have one; what moving them changes. */
static size_t place_block(const lmg_judge *q, const block *b, record *out, sums *to)
{
    uint64_t cell[LMG_COLUMN];
    lmg_plan_place(&q->plan, b->count, &b->rays, cell);
    size_t n = 0;
    for (uint32_t j = 0; j < q->layout.slab_count; j++) {
        const lmg_slab *slab = &q->layout.slabs[j];
        const uint64_t first = q->plan.first[j], end = q->plan.first[j + 1];
        lmg_members m = {.count = 0};
        for (size_t i = 0; i < b->count; i++) {
            m.at[m.count] = (uint16_t)i;
            m.count += (cell[i] >= first) & (cell[i] < end);
        }
        if (!m.count)
            continue;
        for (size_t k = 0; k < m.count; k++) {
            m.within[k] = (double)(cell[m.at[k]] - first);
            for (int c = 0; c < 4; c++)
                m.jitter[c][k] = (double)b->jitter[c][m.at[k]];
        }
        lmg_members_move(slab, q->plan.scale[j], &m);
        for (size_t k = 0; k < m.count; k++)
            out[n++] = (record){cell[m.at[k]] + 1, b->flux[m.at[k]], (float)m.inverse[k]};
        if (!q->move)
            continue;
        lmg_ray_columns rays;
        lmg_pixels after;
        lmg_members_rays(slab, q->axes, &m, &rays);
        lmg_pixels_of(q->receivers, q->start, m.count, &rays, after);
        count_moves(b, &m, after, to);
    }
    for (size_t i = 0; n < b->count && i < b->count; i++)
        if (cell[i] == LMG_NO_CELL) {
            const double w = (double)b->flux[i];
            to->beside += w;
            to->beside_squares += w * w;
        }
    return n;
}

static size_t first_block(const lmg_judge *q, size_t part)
{
    return q->block_count * part / q->part_count;
}

/* Number of rays in the parts before. */
static size_t rays_before(const lmg_judge *q, size_t part)
{
    return part == q->part_count ? q->count : first_block(q, part) * LMG_COLUMN;
}

static lmg_result place_part(void *self, uint64_t piece, void *nothing, lmg_error *err)
{
    lmg_judge *q = self;
    (void)nothing, (void)err;
    const size_t part = q->first_part + piece;
    record *found = q->scratch + rays_before(q, part), *sorted = q->records + rays_before(q, part);
    size_t n = 0;
    if (q->move)
        memset(&q->parts[part], 0, sizeof q->parts[part]);
    q->parts[part].beside = q->parts[part].beside_squares = 0;
    for (size_t b = first_block(q, part); b < first_block(q, part + 1); b++)
        n += place_block(q, &q->blocks[b], found + n, &q->parts[part]);
    uint32_t *first = q->first_record[part], at[PAIR_PARTS] = {0};
    for (size_t i = 0; i < n; i++)
        at[mixed(found[i].cell) % PAIR_PARTS]++;
    first[0] = 0;
    for (int k = 0; k < PAIR_PARTS; k++) {
        first[k + 1] = first[k] + at[k];
        at[k] = first[k];
    }
    for (size_t i = 0; i < n; i++)
        sorted[at[mixed(found[i].cell) % PAIR_PARTS]++] = found[i];
    return LMG_OK;
}

/* No lock to be had: one piece after the other. */
static void do_all(lmg_judge *q, lmg_result (*piece)(void *, uint64_t, void *, lmg_error *), uint64_t count)
{
    lmg_work work = {.piece = piece, .self = q, .count = count};
    if (lmg_work_do(&work, NULL) != LMG_OK)
        for (uint64_t k = 0; k < count; k++)
            piece(q, k, NULL, NULL);
}

static void begin(lmg_judge *q, const lmg_slab *slabs, uint32_t slab_count, bool move)
{
    q->layout.slab_count = slab_count;
    memcpy(q->layout.slabs, slabs, slab_count * sizeof *slabs);
    lmg_plan_prepare(&q->plan, &q->layout);
    q->move = move;
    q->end_part = 0;
    memset(q->whole, 0, sizeof *q->whole);
}

/* Goes on to the part `end`. */
static void place_parts(lmg_judge *q, size_t end)
{
    q->first_part = q->end_part;
    q->end_part = end;
    do_all(q, place_part, end - q->first_part);
    for (size_t part = q->first_part; part < end; part++) {
        const sums *from = &q->parts[part];
        q->whole->beside += from->beside;
        q->whole->beside_squares += from->beside_squares;
        for (int k = 0; q->move && k < LMG_JUDGE_RECEIVERS; k++)
            for (int i = 0; i < LMG_JUDGE_PIXELS; i++) {
                q->whole->change[k][i] += from->change[k][i];
                q->whole->squares[k][i] += from->squares[k][i];
            }
    }
}

static lmg_result pair_part(void *self, uint64_t k, void *nothing, lmg_error *err)
{
    lmg_judge *q = self;
    (void)nothing, (void)err;
    slot *slots = q->slots + q->first_slot[k];
    const size_t mask = q->slot_count[k] - 1;
    memset(slots, 0, q->slot_count[k] * sizeof *slots);
    pair_sums sum = {0};
    for (size_t part = 0; part < q->end_part; part++) {
        const record *records = q->records + rays_before(q, part);
        for (uint32_t i = q->first_record[part][k]; i < q->first_record[part][k + 1]; i++) {
            const record r = records[i];
            size_t at = (size_t)(mixed(r.cell) >> 20) & mask;
            while (slots[at].cell && slots[at].cell != r.cell)
                at = (at + 1) & mask;
            slot *s = &slots[at];
            const double w = (double)r.flux, inverse = (double)r.inverse;
            s->kept += 2 * w * s->sum * inverse;
            sum.noise += w * w * inverse;
            sum.pairs += (double)s->rays;
            s->cell = r.cell;
            s->sum += w;
            s->rays++;
        }
    }
    for (size_t i = 0; i <= mask; i++)
        if (slots[i].rays > 1) {
            sum.kept += slots[i].kept;
            sum.squares += slots[i].kept * slots[i].kept / (double)slots[i].rays;
        }
    q->pair_parts[k] = sum;
    return LMG_OK;
}

/* Of the parts placed. */
static pair_sums pair_up(lmg_judge *q)
{
    size_t slots = 0;
    for (int k = 0; k < PAIR_PARTS; k++) {
        size_t rays = 0;
        for (size_t part = 0; part < q->end_part; part++)
            rays += q->first_record[part][k + 1] - q->first_record[part][k];
        q->first_slot[k] = slots;
        for (q->slot_count[k] = 1; q->slot_count[k] < 2 * rays;)
            q->slot_count[k] *= 2;
        slots += q->slot_count[k]; /* at most four for each ray, or one */
    }
    do_all(q, pair_part, PAIR_PARTS);
    pair_sums sum = {0};
    for (int k = 0; k < PAIR_PARTS; k++) {
        sum.kept += q->pair_parts[k].kept;
        sum.pairs += q->pair_parts[k].pairs;
        sum.noise += q->pair_parts[k].noise;
        sum.squares += q->pair_parts[k].squares;
    }
    return sum;
}

double lmg_judge_kept(lmg_judge *q, const lmg_slab *slabs, uint32_t slab_count, double *pairs)
{
    begin(q, slabs, slab_count, false);
    place_parts(q, q->part_count);
    const pair_sums sum = pair_up(q);
    *pairs = sum.pairs;
    return sum.kept;
}

/* Squared errors of one kind: in the smallest pixels; as much of it as is certain in any, with the standard error there; what that
 * won't be below by all rays. */
typedef struct moves {
    double error, certain, se, least;
} moves;

/* On planes and of directions, by a share of the rays. */
static void measure_moves(const lmg_judge *q, double share, moves out[2])
{
    /* Of a sum c of independent changes, c^2 less the sum of their squares v has the square of c's mean as its own mean; with that
     * m^2, its variance is 2 v^2 + 4 m^2 v. */
    out[0] = out[1] = (moves){0};
    for (int scale = 0; scale < SCALES; scale++) {
        double error[2] = {0}, variance[2] = {0}, sum_of_se[2] = {0}; /* receivers that see the same: the most that it can be */
        int used[2] = {0};
        for (int k = 0; k < LMG_JUDGE_RECEIVERS; k++) {
            const int far = k >= LMG_JUDGE_PLANES;
            const double weight =
                k > LMG_JUDGE_PLANES ? LMG_GOOD_INTENSITY * LMG_GOOD_INTENSITY / (LMG_GOOD_BEAM * LMG_GOOD_BEAM) : 1;
            const double energy = share * share * q->energy[scale][k];
            if (!(energy > 0))
                continue;
            double sum = 0, square = 0;
            for (int i = 0; i < LMG_JUDGE_PIXELS >> (2 * scale); i++) {
                double c, v;
                square_of_pixels(q->whole, k, scale, i, &c, &v);
                const double e = c * c - v;
                sum += e;
                square += 2 * v * v + 4 * fmax(e, 0) * v;
            }
            error[far] += weight / energy * sum;
            sum_of_se[far] += weight / energy * sqrt(square);
            variance[far] += weight * weight / (energy * energy) * square;
            used[far]++;
        }
        for (int far = 0; far < 2; far++) {
            const double n = fmax(used[far], 1), se = sqrt(variance[far]) / n, certain = error[far] / n - CERTAIN * se;
            if (scale == 0)
                out[far].error = error[far] / n;
            if (certain > out[far].certain) {
                out[far].certain = certain;
                out[far].se = se;
            }
            out[far].least = fmax(out[far].least, certain - SURE * sum_of_se[far] / n);
        }
    }
}

/* By the parts placed, to which a limit matters.  *least: what the error by all rays won't be below, SURE standard errors from
 * what these say. */
static lmg_verdict conclude(lmg_judge *q, bool by_radiance, double limit, double *least)
{
    static const double GOOD[2] = {LMG_GOOD_ILLUMINANCE * LMG_GOOD_ILLUMINANCE, LMG_GOOD_INTENSITY * LMG_GOOD_INTENSITY};
    const double share = (double)rays_before(q, q->end_part) / (double)(q->count ? q->count : 1), total = share * q->pl->total;
    const double beside = q->whole->beside / total, least_beside = fmax(beside - SURE * sqrt(q->whole->beside_squares) / total, 0);
    lmg_verdict v = {0};
    moves m[2] = {{0}};
    double variance = 0;
    *least = 0;
    if (!by_radiance)
        measure_moves(q, share, m);
    for (int far = 0; far < 2; far++) {
        v.error += (m[far].certain + beside * beside) / GOOD[far];
        variance += m[far].se * m[far].se / (GOOD[far] * GOOD[far]);
        *least += (m[far].least + least_beside * least_beside) / GOOD[far];
    }
    v.illuminance = fmax(m[0].error, 0) + beside * beside;
    v.intensity = fmax(m[1].error, 0) + beside * beside;
    /* pairs are counted where they can decide: what is hopeless already won't get better by them */
    if (q->square > 0 && *least <= limit && (by_radiance || v.error < limit || q->end_part < q->part_count)) {
        const pair_sums sum = pair_up(q);
        const double kept = sum.kept / (share * share), noise = sum.noise / share;
        const double net = kept - (q->pl->photons > 0 ? noise * (double)q->pl->count / q->pl->photons : 0);
        const double unit = 1 / (LMG_GOOD_RADIANCE * LMG_GOOD_RADIANCE),
                     uncertain = unit * kept / q->square / sqrt(fmax(sum.pairs, 1));
        v.radiance = 1 - net / q->square;
        const double counted = by_radiance ? v.radiance : fmax(v.radiance, 0); /* chance below 0 must not outweigh the others */
        v.error += unit * counted;
        variance += uncertain * uncertain;
        /* other rays would have made other pairs with each of these: variance of a U-statistic */
        const double rays = share * (double)q->count,
                     chance = 2 * sqrt(fmax(sum.squares - sum.kept * sum.kept / rays, 0)) / (share * share);
        const double sure = unit * (v.radiance - SURE * chance / q->square);
        if (sum.pairs >= PAIRS_ENOUGH)
            *least += by_radiance ? sure : fmax(sure, 0);
        else if (by_radiance)
            *least = -INFINITY;
    }
    v.se = sqrt(variance);
    return v;
}

lmg_verdict lmg_judge_slabs(lmg_judge *q, const lmg_slab *slabs, uint32_t slab_count, bool by_radiance, double limit)
{
    const size_t ends[3] = {q->part_count / 8, q->part_count / 2, q->part_count};
    begin(q, slabs, slab_count, !by_radiance);
    lmg_verdict v = {.error = INFINITY};
    for (int stage = limit < (double)INFINITY ? 0 : 2; stage < 3; stage++) {
        if (ends[stage] == q->end_part && stage < 2)
            continue;
        double least;
        place_parts(q, ends[stage]);
        v = conclude(q, by_radiance, limit, &least);
        if (stage < 2 && least > limit)
            return (lmg_verdict){.error = INFINITY};
    }
    return v;
}
