/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What is derived from a field's cells, and emission of rays.  Relies on etendue.c for the measure of cells, on geometry.h for who owns a
 * ray, on seen.c for the tables behind sampling from a point.
 */
#include "memory.h"
#include "random.h"
#include "sampler.h"

#include <stdlib.h>

size_t lmg_sampler_memory(const lmg_sampler *sampler)
{
    if (!sampler)
        return 0;
    size_t sum = sizeof *sampler + (size_t)sampler->row_count * sizeof *sampler->rows + (size_t)(sampler->guide_count + 1) * sizeof *sampler->guide +
                 lmg_groups_memory(sampler);
    for (uint32_t j = 0; j < sampler->plan.layout->slab_count; j++)
        sum += lmg_slopes_memory(&sampler->slopes[j], &sampler->plan.layout->slabs[j]);
    return sum;
}

void lmg_sampler_destroy(lmg_sampler *sampler)
{
    if (!sampler)
        return;
    for (uint32_t j = 0; j < LMG_MAX_SLABS; j++) {
        lmg_etendue_release(&sampler->etendue[j]);
        lmg_slopes_destroy(&sampler->slopes[j]);
    }
    lmg_groups_destroy(sampler);
    lmg_table_free(sampler->rows, (size_t)sampler->row_count * sizeof *sampler->rows);
    free(sampler->guide);
    free(sampler);
}

/* The row sums of slab j go on from *sum; its flux and error go into its data. */
static void sum_slab(lmg_field *field, lmg_sampler *sampler, uint32_t j, double *sum)
{
    const lmg_slab *slab = &field->layout.slabs[j];
    lmg_slab_data *data = &field->slabs[j];
    const lmg_etendue *e = &sampler->etendue[j];
    const bool product =
        e->per_area &&
        (e->share || lmg_etendue_is_full(e)); /* what lmg_etendue_effective gives, without asking it for every cell */
    uint64_t cell = 0, row = sampler->first_row[j];
    double flux = 0, variance = 0;
    for (uint32_t iv = 0; iv < slab->nv; iv++)
        for (uint32_t iu = 0; iu < slab->nu; iu++) {
            const lmg_cell_box c = lmg_cell_limits(slab, iu, iv, 0, 0);
            const double area = (c.u1 - c.u0) * (c.v1 - c.v0);
            const double *per_area = e->per_area;
            for (uint32_t it = 0; it < slab->nt; it++)
                for (uint32_t is = 0; is < slab->ns; is++, cell++, per_area += product) {
                    double l = lmg_cell_luminance(field, j, cell), se = (double)data->standard_error[cell];
                    if (l != 0 || se != 0) {
                        double share = product && e->share ? (double)e->share[cell] : 1;
                        double g = product && share >= 0 ? area * *per_area * share : lmg_etendue_effective(e, iu, iv, is, it);
                        flux += l * g;
                        variance += se * g * se * g;
                        *sum += l > 0 ? l * g : 0;
                    }
                    if ((is + 1) % sampler->row_length[j] == 0)
                        sampler->rows[row++] = *sum;
                }
        }
    data->flux = flux;
    data->flux_se = sqrt(variance);
}

/* A guide that leaves a few rows to search among, of what fits a processor's cache [chen1974]. */
enum { MOST_GUIDE = 1 << 16 };
static bool make_guide(lmg_sampler *s)
{
    s->guide_count = 1;
    while (s->guide_count < MOST_GUIDE && 2 * s->guide_count <= s->row_count)
        s->guide_count *= 2;
    s->guide = malloc((size_t)(s->guide_count + 1) * sizeof *s->guide);
    if (!s->guide)
        return false;
    const double total = s->rows[s->row_count - 1];
    uint64_t row = 0;
    for (uint64_t k = 0; k <= s->guide_count; k++) {
        const double from = (double)k / (double)s->guide_count * total;
        while (row + 1 < s->row_count && !(s->rows[row] > from))
            row++;
        s->guide[k] = row;
    }
    return true;
}

/* Whether a cell of a slab carries anything. */
typedef struct lit_cells {
    const lmg_field *field;
    uint32_t j;
} lit_cells;

static bool is_lit(const void *self, uint64_t cell)
{
    const lit_cells *lit = self;
    return lmg_cell_luminance(lit->field, lit->j, cell) != 0 || lit->field->slabs[lit->j].standard_error[cell] != 0;
}

lmg_result lmg_field_prepare(lmg_field *field, lmg_error *err)
{
    const lmg_layout *layout = &field->layout;
    lmg_sampler_destroy(field->sampler);
    field->sampler = NULL;
    lmg_sampler *s = calloc(1, sizeof *s);
    if (!s)
        return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its sampler");
    lmg_plan_prepare(&s->plan, layout);
    lmg_result r = LMG_OK;
    for (uint32_t j = 0; r == LMG_OK && j < layout->slab_count; j++) {
        const lmg_slab *slab = &layout->slabs[j];
        r = lmg_etendue_prepare(&s->etendue[j], layout, j, err);
        s->row_length[j] = lmg_etendue_is_full(&s->etendue[j]) && s->etendue[j].per_area ? slab->ns : 1;
        s->first_row[j + 1] = s->first_row[j] + lmg_slab_cells(slab) / s->row_length[j];
    }
    s->row_count = s->first_row[layout->slab_count];
    if (r == LMG_OK && !(s->rows = lmg_table_alloc((size_t)s->row_count * sizeof *s->rows)))
        r = lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its sampler");
    double sum = 0;
    for (uint32_t j = 0; r == LMG_OK && j < layout->slab_count; j++) {
        const lit_cells lit = {field, j};
        r = lmg_etendue_share(&s->etendue[j], is_lit, &lit, err);
        if (r == LMG_OK) {
            sum_slab(field, s, j, &sum);
            r = lmg_slopes_create(&s->slopes[j], field, &s->etendue[j], err);
        }
        lmg_etendue_forget_share(&s->etendue[j]);
    }
    if (r == LMG_OK && !make_guide(s))
        r = lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its sampler");
    if (r == LMG_OK)
        r = lmg_groups_create(field, s, err);
    if (r != LMG_OK) {
        lmg_sampler_destroy(s);
        return r;
    }
    field->sampler = s;
    return LMG_OK;
}

void lmg_field_make_constant(lmg_field *field)
{
    for (uint32_t j = 0; j < field->layout.slab_count; j++)
        for (uint64_t cell = 0; cell < field->slabs[j].cells; cell++)
            memset(lmg_cell_slopes(&field->slabs[j], cell), 0, 4);
}

/* ------------------------------------------------------------------------------------------------------------ emission */

/*
 * Turns a place, uniform in a cell of sides 1, into one distributed as the cell's slopes say.  In a pair of dimensions whose etendue is
 * uniform, 1 + g.x at x and at -x add up to 2: the place is kept or reflected at the middle, and none is lost.  (s,t) of cube slabs: false
 * where the place is rejected.
 */
static bool tilt(const lmg_slopes *slopes, const int8_t g[4], uint32_t st, double within[4], uint64_t *state)
{
    for (int k = 0; k < 4; k += 2) {
        if (g[k] == 0 && g[k + 1] == 0)
            continue;
        double g0 = g[k] / 127.0, g1 = g[k + 1] / 127.0, m0 = 0, m1 = 0;
        bool moved = k == 2 && slopes->centroid;
        if (moved) {
            m0 = (double)slopes->centroid[st][0];
            m1 = (double)slopes->centroid[st][1];
        }
        double shape = 1 + g0 * (2 * within[k] - 1 - m0) + g1 * (2 * within[k + 1] - 1 - m1), r = lmg_next_number(state);
        if (moved && r * (1 - g0 * m0 - g1 * m1 + fabs(g0) + fabs(g1)) >= shape)
            return false;
        if (!moved && 2 * r >= shape)
            for (int m = k; m < k + 2; m++)
                within[m] = d_min(1 - within[m], 1 - 0x1p-53);
    }
    return true;
}

/* Draws a ray of a cell, distributed as the cell's light, by four numbers in [0,1).  It starts where it leaves the bounds. */
static void draw_in_cell(const lmg_field *field, uint32_t j, uint64_t cell, const double xi[4], lmg_vec3 *origin, lmg_vec3 *direction)
{
    const lmg_sampler *sampler = field->sampler;
    const lmg_slab *slab = &field->layout.slabs[j];
    const lmg_etendue *e = &sampler->etendue[j];
    const uint64_t i[4] = {cell / slab->ns / slab->nt % slab->nu, cell / slab->ns / slab->nt / slab->nu, cell % slab->ns,
                           cell / slab->ns % slab->nt};
    const double low[4] = {slab->u0, slab->v0, slab->s0, slab->t0}, *scale = sampler->plan.scale[j];
    /*
     * Within the cell uniformly in etendue, by rejection, and along the slopes of its radiance (see tilt).  Aperture slabs need no rejection;
     * for cube slabs, 1/(1+p^2+q^2)^2 against its largest value in the cell accepts at least 43 % (a cell of all directions), the slopes in
     * (s,t) at least half, and a cell shared with others, which has no slopes, at least 1 % (see reconstruct.c), so that 4096 tries fail
     * with probability e^-17 at most and then keep their last candidate, whose flux isn't lost.
     */
    double nearest = 0;
    if (slab->kind == LMG_SLAB_CUBE && isinf(slab->distance))
        for (int k = 2; k < 4; k++) {
            double a = low[k] + (double)i[k] / scale[k], b = low[k] + (double)(i[k] + 1) / scale[k];
            double m = a > 0 ? a : b < 0 ? b : 0;
            nearest += m * m;
        }
    uint64_t state = (uint64_t)(xi[0] * 0x1p53) * 0x9e3779b97f4a7c15u ^ (uint64_t)(xi[2] * 0x1p53);
    bool full = lmg_etendue_is_full(e);
    const lmg_slopes *slopes = &sampler->slopes[j];
    lmg_vec3 x = {0}, d = {0};
    for (int tries = 0; tries < 4096; tries++) {
        double uvst[4], own[4], within[4];
        for (int k = 0; k < 4; k++)
            within[k] = tries ? lmg_next_number(&state) : xi[k];
        if (!tilt(slopes, lmg_cell_slopes(&field->slabs[j], cell), (uint32_t)(cell % ((uint64_t)slab->ns * slab->nt)), within,
                  &state))
            continue;
        for (int k = 0; k < 4; k++)
            uvst[k] = low[k] + ((double)i[k] + within[k]) / scale[k];
        lmg_slab_ray(slab, uvst, &x, &d);
        if (slab->kind == LMG_SLAB_CUBE) {
            double z = v_dot(d, slab->n), f = z * z * (1 + nearest);
            if (fabs(v_dot(d, slab->a)) > z || fabs(v_dot(d, slab->b)) > z || lmg_next_number(&state) >= f * f)
                continue;
        }
        double k0, k1;
        if (full || (lmg_plan_owner(&sampler->plan, x, d, own) == (int)j &&
                     lmg_box_interval(field->layout.bounds_min, field->layout.bounds_max, x, d, &k0, &k1)))
            break;
    }
    double k0, k1;
    *origin = lmg_box_interval(field->layout.bounds_min, field->layout.bounds_max, x, d, &k0, &k1) ? v_fma(x, k1, d) : x;
    *direction = d;
}

bool lmg_field_emit(const lmg_field *field, const double xi[5], lmg_ray *out)
{
    const lmg_sampler *sampler = field->sampler;
    double total = sampler->rows[sampler->row_count - 1];
    if (!(total > 0))
        return false;
    /* The first row whose running sum exceeds the wanted flux: never a row without flux.  The guide's places don't lose it to rounding, since
     * products are rounded in order and its number is a power of 2. */
    double want = xi[0] * total;
    const uint64_t place = (uint64_t)d_clamp(xi[0] * (double)sampler->guide_count, 0, (double)(sampler->guide_count - 1));
    uint64_t lo = sampler->guide[place], hi = sampler->guide[place + 1];
    while (lo < hi) {
        uint64_t mid = (lo + hi) / 2;
        if (sampler->rows[mid] > want)
            hi = mid;
        else
            lo = mid + 1;
    }
    uint32_t j = 0;
    while (sampler->first_row[j + 1] <= lo)
        j++;
    const lmg_slab *slab = &field->layout.slabs[j];
    uint64_t cell = (lo - sampler->first_row[j]) * sampler->row_length[j];
    if (sampler->row_length[j] > 1) {
        /* within the row by the cells' own fluxes; the last one with flux takes what rounding leaves over */
        double rest = want - (lo ? sampler->rows[lo - 1] : 0);
        const double *per_area = &sampler->etendue[j].per_area[cell % ((uint64_t)slab->ns * slab->nt)];
        double uv_area = (slab->u1 - slab->u0) / slab->nu * ((slab->v1 - slab->v0) / slab->nv);
        uint32_t chosen = 0;
        for (uint32_t k = 0; k < slab->ns; k++) {
            double flux = lmg_cell_luminance(field, j, cell + k) * per_area[k] * uv_area;
            if (!(flux > 0))
                continue;
            chosen = k;
            if (rest < flux)
                break;
            rest -= flux;
        }
        cell += chosen;
    }
    double y = lmg_cell_luminance(field, j, cell);
    float rgb[3];
    lmg_cell_mean(field, j, cell, rgb);
    *out = (lmg_ray){0};
    draw_in_cell(field, j, cell, xi + 1, &out->origin, &out->direction);
    for (int c = 0; c < 3; c++)
        out->flux[c] = (float)((double)rgb[c] / y);
    return true;
}

bool lmg_field_redraw(const lmg_field *field, lmg_vec3 *origin, lmg_vec3 *direction, const double xi[4])
{
    double uvst[4];
    const int j = lmg_plan_owner(&field->sampler->plan, *origin, *direction, uvst);
    if (j < 0)
        return false;
    draw_in_cell(field, (uint32_t)j, lmg_plan_place(&field->sampler->plan, j, uvst).cell, xi, origin, direction);
    return true;
}
