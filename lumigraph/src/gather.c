/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Gathering: radiance of cells from rays that somebody traces backwards into the luminaire, beside the flux of photons.
 *
 * Both estimate the same mean radiance of a cell without bias, and a mixture of them with weights that know nothing of the
 * estimates' own errors is unbiased as well.  Weights made of the same counts that they weigh aren't like that: a cell into which
 * by chance too few photons fell would trust them the more.  So everything that decides about half A - whether a cell is gathered,
 * by how many rays, how the rays' mean is weighed against half A's photons - comes from elsewhere: the number of rays from half B's
 * photons; the weight of one half of these rays from the other half of them, and from the rays of the neighbouring cells
 * (cross-fitting [chernozhukov2018double]).  Half B likewise.  What is left is chance in the weights, which costs little: around
 * its minimum the variance is flat.
 */
#include "gather.h"

#include "accumulate.h"
#include "etendue.h"
#include "random.h"

#include <stdlib.h>
#include <string.h>

/* Rays of one half of a cell, at most: sums of squares stay exact enough in floats, and the numbers of rays apart. */
enum { MAX_RAYS = LMG_GATHERING_RAYS };
/* Tries to find a ray of a cell's own, each; cells of which less than about a tenth is their own are left to the photons. */
enum { TRIES = 64 };

/* One half's rays in two parts, by turns. */
typedef struct half_rays {
    uint32_t count;              /* even */
    float sum[2][3], squares[2]; /* of radiance; of luminance squared; cd/m2 */
} half_rays;

typedef struct gathered {
    half_rays half[2]; /* A, B */
} gathered;

struct lmg_gathering {
    const lmg_accumulator *acc;
    uint64_t seed, rays;
    size_t count;
    uint64_t *cell; /* ascending, over all slabs */
    gathered *gathered;
};

/* Units of luminance that fell into half h of a cell. */
static double units_of(const lmg_accumulator *acc, uint64_t cell, uint32_t h)
{
    static const double Y[3] = {0.2126, 0.7152, 0.0722};
    const uint32_t channels = acc->layout.channels;
    const _Atomic uint64_t *w = acc->words + cell * lmg_cell_words(channels) + h * channels;
    double sum = 0;
    for (uint32_t c = 0; c < channels; c++)
        sum += (channels == 1 ? 1 : Y[c]) * (double)(int64_t)atomic_load_explicit(&w[c], memory_order_relaxed) / LMG_FLUX_ONE;
    return sum;
}

/* Rays for one half of a cell, into whose other half so many units fell: in proportion, to an even number, by chance. */
static uint32_t rays_for(double units, double rays_per_unit, uint64_t key)
{
    if (!(units > 0))
        return 0;
    uint64_t state = key;
    double pairs = 0.5 * rays_per_unit * units;
    if (pairs >= MAX_RAYS / 2)
        return MAX_RAYS;
    double whole = floor(pairs);
    return 2 * (uint32_t)(whole + (lmg_next_number(&state) < pairs - whole));
}

lmg_result lmg_gathering_create(const lmg_accumulator *acc, double rays_per_unit, uint64_t seed, lmg_gathering **out,
                                lmg_error *err)
{
    *out = NULL;
    if (!(rays_per_unit > 0) || !isfinite(rays_per_unit))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "gathering: %g rays per unit must be positive", rays_per_unit);
    lmg_gathering *g = calloc(1, sizeof *g);
    if (!g)
        return lmg_fail(err, LMG_ERROR_MEMORY, "gathering: no memory");
    g->acc = acc;
    g->seed = seed;
    const uint64_t cells = acc->plan.first[acc->layout.slab_count];
    /* twice over the cells: count, then fill */
    for (int pass = 0; pass < 2; pass++) {
        size_t count = 0;
        for (uint64_t cell = 0; cell < cells; cell++) {
            uint32_t rays[2];
            for (uint32_t h = 0; h < 2; h++)
                rays[h] = rays_for(units_of(acc, cell, 1 - h), rays_per_unit, lmg_mix(2 * cell + h));
            if (rays[0] + rays[1] == 0)
                continue;
            if (pass) {
                g->cell[count] = cell;
                g->gathered[count].half[0].count = rays[0];
                g->gathered[count].half[1].count = rays[1];
                g->rays += rays[0] + rays[1];
            }
            count++;
        }
        g->count = count;
        if (!pass) {
            g->cell = malloc((count + 1) * sizeof *g->cell);
            g->gathered = calloc(count + 1, sizeof *g->gathered);
            if (!g->cell || !g->gathered) {
                lmg_gathering_destroy(g);
                return lmg_fail(err, LMG_ERROR_MEMORY, "gathering: no memory for %zu cells", count);
            }
        }
    }
    *out = g;
    return LMG_OK;
}

void lmg_gathering_destroy(lmg_gathering *g)
{
    if (!g)
        return;
    free(g->cell);
    free(g->gathered);
    free(g);
}

size_t lmg_gathering_cells(const lmg_gathering *g)
{
    return g->count;
}

uint64_t lmg_gathering_rays(const lmg_gathering *g)
{
    return g->rays;
}

/* A ray of a cell, uniformly distributed in the etendue that is the cell's own; false if none is found. */
static bool draw(const lmg_plan *plan, uint32_t j, const lmg_cell_box *c, uint64_t *state, lmg_ray *out)
{
    const lmg_slab *slab = &plan->layout->slabs[j];
    const double low[4] = {c->u0, c->v0, c->s0, c->t0}, high[4] = {c->u1, c->v1, c->s1, c->t1};
    const bool cube = slab->kind == LMG_SLAB_CUBE;
    double nearest = 0; /* cube slabs: etendue goes as 1 / (1 + p^2 + q^2)^2, here against its largest value in the cell */
    if (cube && isinf(slab->distance))
        for (int k = 2; k < 4; k++) {
            double m = low[k] > 0 ? low[k] : high[k] < 0 ? high[k] : 0;
            nearest += m * m;
        }
    for (int i = 0; i < TRIES; i++) {
        double uvst[4], own[4], k0, k1;
        lmg_vec3 x, d;
        for (int k = 0; k < 4; k++)
            uvst[k] = low[k] + (high[k] - low[k]) * lmg_next_number(state);
        lmg_slab_ray(slab, uvst, &x, &d);
        if (cube) {
            double z = v_dot(d, slab->n), f = z * z * (1 + nearest);
            if (lmg_next_number(state) >= f * f)
                continue;
        }
        if (lmg_plan_owner(plan, x, d, own) != (int)j ||
            !lmg_box_interval(plan->layout->bounds_min, plan->layout->bounds_max, x, d, &k0, &k1))
            continue;
        out->origin = v_fma(x, k1, d);
        out->direction = d;
        return true;
    }
    return false;
}

/* The slab and the limits of a gathered cell. */
static uint32_t place_of(const lmg_gathering *g, size_t i, lmg_cell_box *box)
{
    const lmg_plan *plan = &g->acc->plan;
    uint32_t j = 0;
    while (plan->first[j + 1] <= g->cell[i])
        j++;
    const lmg_slab *slab = &plan->layout->slabs[j];
    const uint64_t cell = g->cell[i] - plan->first[j], st = cell / slab->ns;
    *box = lmg_cell_limits(slab, (uint32_t)(st / slab->nt % slab->nu), (uint32_t)(st / slab->nt / slab->nu),
                           (uint32_t)(cell % slab->ns), (uint32_t)(st % slab->nt));
    return j;
}

double lmg_gathering_etendue(const lmg_gathering *g, size_t i)
{
    lmg_cell_box box;
    const uint32_t j = place_of(g, i, &box);
    return lmg_box_etendue(&g->acc->layout.slabs[j], &box);
}

uint32_t lmg_gathering_draw(const lmg_gathering *g, size_t i, lmg_ray rays[2 * LMG_GATHERING_RAYS])
{
    lmg_cell_box box;
    const uint32_t j = place_of(g, i, &box);
    const uint32_t count = g->gathered[i].half[0].count + g->gathered[i].half[1].count;
    for (uint32_t k = 0; k < count; k++) {
        uint64_t state = lmg_mix(lmg_mix(g->seed ^ 0x5851f42d4c957f2du) + g->cell[i] * (2 * MAX_RAYS) + k);
        rays[k] = (lmg_ray){.flux = {1, 1, 1}, .number = lmg_mix(state) | (uint64_t)1 << 63};
        if (!draw(&g->acc->plan, j, &box, &state, &rays[k]))
            return 0;
    }
    return count;
}

void lmg_gathering_put(lmg_gathering *g, size_t i, const float (*radiance)[3])
{
    for (uint32_t h = 0; h < 2; h++) {
        half_rays *half = &g->gathered[i].half[h];
        if (!radiance) {
            half->count = 0;
            continue;
        }
        for (uint32_t k = 0; k < half->count; k++, radiance++) {
            const float y = (float)lmg_luminance(*radiance);
            for (int c = 0; c < 3; c++)
                half->sum[k % 2][c] += (*radiance)[c];
            half->squares[k % 2] += y * y;
        }
    }
}

/* --------------------------------------------------------------------------------------------------------- combination */

uint64_t lmg_gathering_cell(const lmg_gathering *g, size_t i)
{
    return g->cell[i];
}

size_t lmg_gathering_find(const lmg_gathering *g, uint64_t cell)
{
    size_t lo = 0, hi = g->count;
    while (lo < hi) {
        size_t middle = lo + (hi - lo) / 2;
        if (g->cell[middle] < cell)
            lo = middle + 1;
        else
            hi = middle;
    }
    return lo < g->count && g->cell[lo] == cell ? lo : g->count;
}

/* What is known of the variance of single rays: sums over sets of rays of one cell each. */
typedef struct spread {
    double sum, rays;        /* luminance */
    double squares, freedom; /* of deviations from the sets' means */
} spread;

static void add_set(spread *s, double sum, double squares, double n)
{
    if (!(n > 0))
        return;
    s->sum += sum;
    s->rays += n;
    s->squares += fmax(squares - sum * sum / n, 0);
    s->freedom += n - 1;
}

static void add_cell(spread *s, const half_rays *h)
{
    add_set(s, lmg_luminance(h->sum[0]) + lmg_luminance(h->sum[1]), (double)h->squares[0] + (double)h->squares[1], h->count);
}

/* Of half h of the cells next to cell i, one step along each axis. */
static spread spread_around(const lmg_gathering *g, size_t i, uint32_t h)
{
    const lmg_plan *plan = &g->acc->plan;
    uint32_t j = 0;
    while (plan->first[j + 1] <= g->cell[i])
        j++;
    const lmg_slab *slab = &plan->layout->slabs[j];
    const uint64_t cell = g->cell[i] - plan->first[j];
    const uint64_t step[4] = {1, slab->ns, (uint64_t)slab->ns * slab->nt, (uint64_t)slab->ns * slab->nt * slab->nu};
    const uint32_t cells[4] = {slab->ns, slab->nt, slab->nu, slab->nv};
    spread s = {0};
    for (int k = 0; k < 4; k++) {
        const uint64_t at = cell / step[k] % cells[k];
        size_t n = g->count;
        if (at > 0 && (n = lmg_gathering_find(g, g->cell[i] - step[k])) < g->count)
            add_cell(&s, &g->gathered[n].half[h]);
        if (at + 1 < cells[k] && (n = lmg_gathering_find(g, g->cell[i] + step[k])) < g->count)
            add_cell(&s, &g->gathered[n].half[h]);
    }
    return s;
}

void lmg_gathering_combine(const lmg_gathering *g, size_t i, double etendue, double lumens, lmg_cell_flux *flux)
{
    const uint32_t channels = g->acc->layout.channels;
    double variance = 0; /* of the cell's flux */
    double fallen[2] = {0,
                        0}; /* units in the halves: of the photons' variance, which is known of both together, each has its share */
    for (uint32_t h = 0; h < 2; h++)
        fallen[h] = units_of(g->acc, g->cell[i], h);
    for (uint32_t h = 0; h < 2; h++) {
        const half_rays *half = &g->gathered[i].half[h];
        double *sum = h ? flux->b : flux->a;
        const double own_variance = flux->variance * fallen[h] / (fallen[0] + fallen[1]);
        if (half->count == 0) {
            variance += own_variance;
            continue;
        }
        const double each = 0.5 * half->count, unit = 2 * lumens / etendue; /* rays of a part; radiance of a photon of the half */
        const spread around = spread_around(g, i, h);
        double photons = 0, rays = 0, mixed[3] = {0, 0, 0};
        for (int k = 0; k < 2; k++) {
            /* The weight from the other part.  One deviation as large as the radiance is added: nothing is trusted for a few rays
             * that happen to agree. */
            spread s = around;
            add_set(&s, lmg_luminance(half->sum[1 - k]), (double)half->squares[1 - k], each);
            const double mean = s.sum / s.rays, one = (s.squares + mean * mean) / (s.freedom + 1) / each, other = unit * mean;
            const double w = mean > 0 ? one / (one + other) : 1;
            for (uint32_t c = 0; c < channels; c++) {
                const double seen = channels == 1 ? lmg_luminance(half->sum[k]) : (double)half->sum[k][c];
                mixed[c] += 0.5 * (w * sum[c] + (1 - w) * seen / each * 0.5 * etendue);
            }
            photons += 0.5 * w;
            /* the part's own variance, which its weight doesn't know, where it has one */
            spread own = {0};
            if (each > 1)
                add_set(&own, lmg_luminance(half->sum[k]), (double)half->squares[k], each);
            else
                add_cell(&own, half);
            rays += 0.25 * (1 - w) * (1 - w) * own.squares / own.freedom / each;
        }
        memcpy(sum, mixed, sizeof mixed);
        variance += photons * photons * own_variance + rays * 0.25 * etendue * etendue;
    }
    flux->variance = variance;
}
