/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Directions in which a point sees light: importance sampling of the (u,v) planes with an exact density.  Relies on sampler.h's tables and
 * on geometry.h for who owns a ray.
 *
 * From a point each place (u,v) of a slab's plane is seen in one direction, so light is a picture on the plane.  A quadtree over the
 * plane is descended; each of four children gets a chance in proportion to its solid angle times the mean luminance that it sends in the
 * directions towards the point, read from a coarse table whose (s,t) resolution is chosen to match the child's size as seen from the point.
 * A tenth of the samples ignores the tables and goes by solid angle alone, so that light the tables are too coarse to show is
 * found as well and no weight exceeds ten times what uniform sampling would give.  The descent ends at the tables' finest blocks, later
 * if the point is near: where a block is small beside its distance.  Its density follows from the path alone, and the path from the
 * place on the plane: the density of any direction is found by going down again.
 *
 * A plane may stick out of the bounds; from beside the bounds light is then seen before it reaches its plane: the same lines, the other
 * way round.  Of cube slabs a point sees only the part of the plane at slopes up to 1, a square about its foot; the tree's nodes are clipped to it.
 */
#include "memory.h"
#include "sampler.h"

#include <stdlib.h>
#include <string.h>

/* Share of samples that go by solid angle alone. */
static const double DEFENSIVE = 0.1;
/* A node is small when its side is below half its distance: 1/r^3 then varies by a factor of about two within it. */
static const double SMALL = 0.25; /* squared */
/* Deepest level of a descent: 2^-30 of the plane; a point nearer than that is on it. */
enum { DEEPEST = 30 };
static const double BELOW_ONE = 1 - 0x1p-53;
/* Part of the brightest neighbour's luminance added to each bin: light may stand across the border of bins or blocks from where the
 * node's middle looks. */
static const float SPILL = 0.1F;

/* First value of a level's blocks, in pictures; and of a mip within a picture. */
static const uint32_t LEVEL_START[LMG_LEVELS] = {0, 1, 5, 21, 85};
static const uint32_t MIP_START[LMG_LEVELS] = {0, 256, 320, 336, 340};

/* ------------------------------------------------------------------------------------------------------------- tables */

/* Overlap of cell i of n on [lo,hi] with bins on [from,to]: first bin, number, and each bin's covered share; at most `room`. */
static int overlap(double lo, double hi, uint32_t n, uint32_t i, double from, double to, int bins, int *first, double *share)
{
    double a = lo + (hi - lo) * i / n, b = lo + (hi - lo) * (i + 1) / n, step = (to - from) / bins;
    a = fmax(a, from);
    b = fmin(b, to);
    if (!(b > a))
        return 0;
    int k0 = (int)((a - from) / step), k1 = (int)((b - from) / step);
    k0 = k0 < bins ? k0 : bins - 1;
    k1 = k1 < bins ? k1 : bins - 1;
    *first = k0;
    for (int k = k0; k <= k1; k++)
        share[k - k0] = fmax(fmin(b, from + (k + 1) * step) - fmax(a, from + k * step), 0) / step;
    return k1 - k0 + 1;
}

enum { FINE = 1 << (LMG_LEVELS - 1) }; /* blocks of the finest level, each way */

/* Adds the light of slab j to the finest level of a table: mean luminance per block and bin. */
static bool gather(const lmg_field *field, uint32_t j, const lmg_group *g, const lmg_brightness *table)
{
    const lmg_slab *slab = &field->layout.slabs[j];
    float *fine = table->picture + (size_t)LEVEL_START[LMG_LEVELS - 1] * LMG_PICTURE;
    double(*shares)[LMG_BINS] = malloc(slab->ns * sizeof *shares);
    int(*where)[2] = malloc(slab->ns * sizeof *where);
    if (!shares || !where) {
        free(shares);
        free(where);
        return false;
    }
    for (uint32_t is = 0; is < slab->ns; is++)
        where[is][1] = overlap(slab->s0, slab->s1, slab->ns, is, table->s0, table->s1, LMG_BINS, &where[is][0], shares[is]);
    for (uint32_t iv = 0; iv < slab->nv; iv++)
        for (uint32_t iu = 0; iu < slab->nu; iu++) {
            uint64_t cell = ((uint64_t)iv * slab->nu + iu) * slab->nt * slab->ns;
            double picture[LMG_BINS][LMG_BINS] = {{0}}; /* [t][s] */
            bool any = false;
            for (uint32_t it = 0; it < slab->nt; it++) {
                double row[LMG_BINS] = {0}, share_t[LMG_BINS];
                int first_t, nt = overlap(slab->t0, slab->t1, slab->nt, it, table->t0, table->t1, LMG_BINS, &first_t, share_t);
                if (!nt) {
                    cell += slab->ns;
                    continue;
                }
                bool lit = false;
                for (uint32_t is = 0; is < slab->ns; is++, cell++) {
                    double l = lmg_cell_luminance(field, j, cell);
                    if (!(l > 0))
                        continue;
                    lit = true;
                    for (int k = 0; k < where[is][1]; k++)
                        row[where[is][0] + k] += l * shares[is][k];
                }
                for (int k = 0; lit && k < nt; k++)
                    for (int s = 0; s < LMG_BINS; s++)
                        picture[first_t + k][s] += row[s] * share_t[k];
                any = any || lit;
            }
            if (!any)
                continue;
            double share_u[FINE], share_v[FINE];
            int first_u, first_v, nu = overlap(slab->u0, slab->u1, slab->nu, iu, g->u0, g->u1, FINE, &first_u, share_u);
            int nv = overlap(slab->v0, slab->v1, slab->nv, iv, g->v0, g->v1, FINE, &first_v, share_v);
            for (int y = 0; y < nv; y++)
                for (int x = 0; x < nu; x++) {
                    float *p = fine + ((size_t)(first_v + y) * FINE + (size_t)(first_u + x)) * LMG_PICTURE;
                    for (int k = 0; k < LMG_BINS * LMG_BINS; k++)
                        p[k] += (float)(picture[k / LMG_BINS][k % LMG_BINS] * share_u[x] * share_v[y]);
                }
        }
    free(shares);
    free(where);
    return true;
}

/* Spill into neighbours, then mips and coarser levels by averaging. */
static void finish(const lmg_brightness *table)
{
    for (int block = 0; block < FINE * FINE; block++) {
        float *p = table->picture + (LEVEL_START[LMG_LEVELS - 1] + (size_t)block) * LMG_PICTURE, old[LMG_BINS * LMG_BINS];
        memcpy(old, p, sizeof old);
        for (int t = 0; t < LMG_BINS; t++)
            for (int s = 0; s < LMG_BINS; s++) {
                float most = 0;
                for (int y = t > 0 ? t - 1 : 0; y <= t + 1 && y < LMG_BINS; y++)
                    for (int x = s > 0 ? s - 1 : 0; x <= s + 1 && x < LMG_BINS; x++)
                        most = old[y * LMG_BINS + x] > most ? old[y * LMG_BINS + x] : most;
                p[t * LMG_BINS + s] += SPILL * most;
            }
        for (int m = 1; m < LMG_LEVELS; m++) {
            int n = LMG_BINS >> m;
            const float *from = p + MIP_START[m - 1];
            float *to = p + MIP_START[m];
            for (int t = 0; t < n; t++)
                for (int s = 0; s < n; s++)
                    to[t * n + s] = 0.25F * (from[2 * t * 2 * n + 2 * s] + from[2 * t * 2 * n + 2 * s + 1] + from[(2 * t + 1) * 2 * n + 2 * s] +
                                             from[(2 * t + 1) * 2 * n + 2 * s + 1]);
        }
    }
    for (int level = LMG_LEVELS - 2; level >= 0; level--) {
        int n = 1 << level;
        for (int y = 0; y < n; y++)
            for (int x = 0; x < n; x++) {
                float *to = table->picture + (LEVEL_START[level] + (size_t)(y * n + x)) * LMG_PICTURE;
                for (int k = 0; k < 4; k++) {
                    const float *from = table->picture +
                                        (LEVEL_START[level + 1] + (size_t)((2 * y + k / 2) * 2 * n + 2 * x + k % 2)) * LMG_PICTURE;
                    for (int i = 0; i < LMG_PICTURE; i++)
                        to[i] += 0.25F * from[i];
                }
            }
    }
}

static const size_t TABLE_BYTES = (size_t)LMG_BLOCKS * LMG_PICTURE * sizeof(float);

size_t lmg_groups_memory(const lmg_sampler *sampler)
{
    size_t sum = 0;
    for (uint32_t g = 0; g < sampler->group_count; g++)
        sum += sampler->groups[g].table_count * (sizeof(lmg_brightness) + TABLE_BYTES);
    return sum;
}

void lmg_groups_destroy(lmg_sampler *sampler)
{
    for (uint32_t g = 0; g < sampler->group_count; g++) {
        for (uint32_t k = 0; k < sampler->groups[g].table_count; k++)
            lmg_table_free(sampler->groups[g].tables[k].picture, TABLE_BYTES);
        free(sampler->groups[g].tables);
    }
    sampler->group_count = 0;
}

lmg_result lmg_groups_create(const lmg_field *field, lmg_sampler *sampler, lmg_error *err)
{
    const lmg_layout *layout = &field->layout;
    for (uint32_t j = 0; j < layout->slab_count; j++)
        sampler->group_of[j] = -1;
    for (uint32_t j = 0; j < layout->slab_count; j++) {
        const lmg_slab *slab = &layout->slabs[j];
        if (!(field->slabs[j].flux > 0))
            continue;
        uint32_t at = 0;
        while (at < sampler->group_count && !lmg_same_frame(sampler->groups[at].frame, slab))
            at++;
        lmg_group *g = &sampler->groups[at];
        if (at == sampler->group_count) {
            *g = (lmg_group){.frame = slab, .u0 = slab->u0, .u1 = slab->u1, .v0 = slab->v0, .v1 = slab->v1, .inside = true};
            sampler->group_count++;
        }
        g->u0 = fmin(g->u0, slab->u0);
        g->u1 = fmax(g->u1, slab->u1);
        g->v0 = fmin(g->v0, slab->v0);
        g->v1 = fmax(g->v1, slab->v1);
        g->flux += field->slabs[j].flux;
        g->inside = g->inside && sampler->etendue[j].inside;
        uint32_t cells = slab->nu > slab->nv ? slab->nu : slab->nv, levels = 0;
        while (levels + 1 < LMG_LEVELS && (uint32_t)1 << levels < cells)
            levels++;
        g->levels = levels > g->levels ? levels : g->levels;
        sampler->group_of[j] = (int8_t)at;
    }
    for (uint32_t i = 0; i < sampler->group_count; i++) {
        lmg_group *g = &sampler->groups[i];
        uint32_t count = 0;
        for (uint32_t j = 0; j < layout->slab_count; j++)
            count += sampler->group_of[j] == (int8_t)i;
        g->tables = calloc(count + 1, sizeof *g->tables);
        if (!g->tables)
            return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its sampler");
        /* one for each slab, and one around all where none of them is that */
        lmg_brightness around = {INFINITY, -INFINITY, INFINITY, -INFINITY, 0, 0, NULL};
        for (uint32_t j = 0; j < layout->slab_count; j++) {
            const lmg_slab *s = &layout->slabs[j];
            if (sampler->group_of[j] != (int8_t)i)
                continue;
            g->tables[g->table_count++] = (lmg_brightness){.s0 = s->s0, .s1 = s->s1, .t0 = s->t0, .t1 = s->t1};
            around.s0 = fmin(around.s0, s->s0);
            around.s1 = fmax(around.s1, s->s1);
            around.t0 = fmin(around.t0, s->t0);
            around.t1 = fmax(around.t1, s->t1);
        }
        const lmg_brightness *last = &g->tables[g->table_count - 1];
        if (last->s0 > around.s0 || last->s1 < around.s1 || last->t0 > around.t0 || last->t1 < around.t1)
            g->tables[g->table_count++] = around;
        for (uint32_t k = 0; k < g->table_count; k++) {
            lmg_brightness *table = &g->tables[k];
            table->bin_s = (table->s1 - table->s0) / LMG_BINS;
            table->bin_t = (table->t1 - table->t0) / LMG_BINS;
            table->picture = lmg_table_alloc(TABLE_BYTES);
            if (!table->picture)
                return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its sampler");
            for (uint32_t j = 0; j < layout->slab_count; j++)
                if (sampler->group_of[j] == (int8_t)i && !gather(field, j, g, table))
                    return lmg_fail(err, LMG_ERROR_MEMORY, "field: no memory for its sampler");
            finish(table);
        }
    }
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------------------- nodes */

/* A point as a group sees it: its foot on the plane, its distance from it, and on which side it is: 1 past the plane, -1 before it. */
typedef struct view {
    const lmg_group *g;
    double pu, pv, h, side;
    double u0, u1, v0, v1; /* part of the plane that the point can see */
    double weight;         /* estimate of the light from there: solid angle x luminance */
} view;

typedef struct rectangle {
    double u0, u1, v0, v1;
} rectangle;

static inline double corner_angle(double x, double y, double h)
{
    return atan2(x * y, h * sqrt(x * x + y * y + h * h));
}

/* Solid angle of a rectangle of the plane: of small ones by their middle, else exactly. */
static inline double solid_angle(const view *w, const rectangle *r, double r2)
{
    double a = r->u1 - r->u0, b = r->v1 - r->v0, longest = a > b ? a : b;
    if (longest * longest < SMALL * r2)
        return a * b * w->h / (r2 * sqrt(r2));
    double x0 = r->u0 - w->pu, x1 = r->u1 - w->pu, y0 = r->v0 - w->pv, y1 = r->v1 - w->pv;
    double omega = corner_angle(x1, y1, w->h) - corner_angle(x0, y1, w->h) - corner_angle(x1, y0, w->h) + corner_angle(x0, y0, w->h);
    return omega > 0 ? omega : 0; /* rounding, when the point is far: 1e-16 */
}

/* Mean luminance that block (x,y) of a level sends from (cu,cv) towards the point; side: the node's longest side. */
static inline double luminance_of(const view *w, uint32_t level, uint32_t x, uint32_t y, double cu, double cv, double r2, double side)
{
    const lmg_group *g = w->g;
    const lmg_slab *frame = g->frame;
    double du = w->side * (w->pu - cu), dv = w->side * (w->pv - cv), s, t, span;
    if (frame->kind == LMG_SLAB_APERTURE) {
        /* The concentric map with 4/pi atan(z) ~ z + 0.3476 z (1 - |z|), within 0.005: this only chooses bins. */
        double inv = 1 / sqrt(r2), a = du * inv, b = dv * inv, r = sqrt(a * a + b * b);
        if (fabs(a) >= fabs(b)) {
            double z = a != 0 ? b / a : 0;
            s = a < 0 ? -r : r;
            t = s * (z + 0.3476 * z * (1 - fabs(z)));
        } else {
            double z = a / b;
            t = b < 0 ? -r : r;
            s = t * (z + 0.3476 * z * (1 - fabs(z)));
        }
        span = side * inv;
    } else {
        s = du / w->h;
        t = dv / w->h;
        span = side / w->h;
        if (isfinite(frame->distance)) {
            s = cu + frame->distance * s;
            t = cv + frame->distance * t;
            span = fabs(side - frame->distance * span);
        }
    }
    for (uint32_t k = 0; k < g->table_count; k++) {
        const lmg_brightness *table = &g->tables[k];
        double x_bin = (s - table->s0) / table->bin_s, y_bin = (t - table->t0) / table->bin_t;
        /* a window serves where the node's middle looks into it with no more directions than it has */
        if (k + 1 < g->table_count && !(x_bin >= 0 && x_bin < LMG_BINS && y_bin >= 0 && y_bin < LMG_BINS &&
                                        span < LMG_BINS * (table->bin_s < table->bin_t ? table->bin_s : table->bin_t)))
            continue;
        int mip = 0;
        double bin = table->bin_s < table->bin_t ? table->bin_s : table->bin_t;
        while (mip + 1 < LMG_LEVELS && bin < span) {
            bin *= 2;
            mip++;
        }
        /* between the middles of bins as wide as the span: what a footprint of that width sees */
        int n = LMG_BINS >> mip;
        double scale = 1.0 / (1 << mip), fs = d_clamp(x_bin * scale - 0.5, 0, n - 1), ft = d_clamp(y_bin * scale - 0.5, 0, n - 1);
        int s0 = (int)fs, t0 = (int)ft, s1 = s0 + 1 < n ? s0 + 1 : s0, t1 = t0 + 1 < n ? t0 + 1 : t0;
        fs -= s0;
        ft -= t0;
        const float *p = table->picture + (size_t)(LEVEL_START[level] + (y << level) + x) * LMG_PICTURE + MIP_START[mip];
        return (1 - ft) * ((1 - fs) * (double)p[t0 * n + s0] + fs * (double)p[t0 * n + s1]) +
               ft * ((1 - fs) * (double)p[t1 * n + s0] + fs * (double)p[t1 * n + s1]);
    }
    return 0;
}

/* The four children of a node: solid angles and estimates of their light.  Child k: u upper half if k & 1, v upper half if k & 2. */
static inline void look_at_children(const view *w, const rectangle *child, uint32_t level, uint32_t x, uint32_t y, double angle[4],
                                    double light[4])
{
    for (uint32_t k = 0; k < 4; k++) {
        rectangle r = child[k];
        r.u0 = r.u0 > w->u0 ? r.u0 : w->u0;
        r.u1 = r.u1 < w->u1 ? r.u1 : w->u1;
        r.v0 = r.v0 > w->v0 ? r.v0 : w->v0;
        r.v1 = r.v1 < w->v1 ? r.v1 : w->v1;
        if (!(r.u1 > r.u0 && r.v1 > r.v0)) {
            angle[k] = light[k] = 0;
            continue;
        }
        double cu = 0.5 * (r.u0 + r.u1), cv = 0.5 * (r.v0 + r.v1), du = w->pu - cu, dv = w->pv - cv, r2 = du * du + dv * dv + w->h * w->h;
        double a = r.u1 - r.u0, b = r.v1 - r.v0;
        angle[k] = solid_angle(w, &r, r2);
        /* below the tables' finest level the block stays what it was */
        uint32_t up = level > w->g->levels ? level - w->g->levels : 0;
        light[k] = angle[k] * luminance_of(w, level - up, (2 * x + (k & 1)) >> up, (2 * y + (k >> 1)) >> up, cu, cv, r2, a > b ? a : b);
    }
}

static inline rectangle clipped(const view *w, const rectangle *r)
{
    return (rectangle){fmax(r->u0, w->u0), fmin(r->u1, w->u1), fmax(r->v0, w->v0), fmin(r->v1, w->v1)};
}

static inline bool descent_ends(const view *w, uint32_t level, const rectangle *r)
{
    if (level < w->g->levels)
        return false;
    if (level >= DEEPEST)
        return true;
    rectangle c = clipped(w, r);
    double du = w->pu - 0.5 * (c.u0 + c.u1), dv = w->pv - 0.5 * (c.v0 + c.v1), r2 = du * du + dv * dv + w->h * w->h;
    double a = c.u1 - c.u0, b = c.v1 - c.v0, longest = a > b ? a : b;
    return longest * longest < SMALL * r2;
}

/* What a descent ends with: the leaf and the chances of its path by light and by solid angle. */
typedef struct leaf {
    rectangle r;
    double by_light, by_angle;
} leaf;

/*
 * Goes down the tree: towards the place (u,v) when random is NULL, else by random numbers, by light or by solid angle; *random
 * becomes what is left of them, uniform within the leaf.  Chances are the same products in both cases.
 */
static leaf descend(const view *w, double u, double v, double random[2], bool light_counts)
{
    leaf out = {{w->g->u0, w->g->u1, w->g->v0, w->g->v1}, 1, 1};
    uint32_t x = 0, y = 0;
    for (uint32_t level = 0; !descent_ends(w, level, &out.r);) {
        level++;
        double mu = 0.5 * (out.r.u0 + out.r.u1), mv = 0.5 * (out.r.v0 + out.r.v1), angle[4], light[4];
        const rectangle child[4] = {{out.r.u0, mu, out.r.v0, mv}, {mu, out.r.u1, out.r.v0, mv}, {out.r.u0, mu, mv, out.r.v1}, {mu, out.r.u1, mv, out.r.v1}};
        look_at_children(w, child, level, x, y, angle, light);
        double angles = angle[0] + angle[1] + angle[2] + angle[3], lights = light[0] + light[1] + light[2] + light[3];
        if (!(angles > 0)) {
            /* a sliver whose solid angle underflows: halves of equal area */
            for (int k = 0; k < 4; k++) {
                rectangle c = clipped(w, &child[k]);
                angle[k] = c.u1 > c.u0 && c.v1 > c.v0 ? (c.u1 - c.u0) * (c.v1 - c.v0) : 0;
            }
            angles = angle[0] + angle[1] + angle[2] + angle[3];
        }
        const double *by_light = lights > 0 ? light : angle;
        double all_light = lights > 0 ? lights : angles;
        uint32_t k;
        if (random) {
            const double *p = light_counts ? by_light : angle;
            double lower = p[0] + p[1], upper = p[2] + p[3], split = lower / (lower + upper);
            bool up = random[1] >= split;
            random[1] = fmin(up ? (random[1] - split) / (1 - split) : random[1] / split, BELOW_ONE);
            const double *row = up ? p + 2 : p;
            split = row[0] / (row[0] + row[1]);
            bool right = random[0] >= split;
            random[0] = fmin(right ? (random[0] - split) / (1 - split) : random[0] / split, BELOW_ONE);
            k = (up ? 2U : 0U) + (right ? 1U : 0U);
        } else {
            /* a place on the upper border of what the point sees belongs to the half that reaches there */
            k = (v >= mv && mv < w->v1 ? 2U : 0U) + (u >= mu && mu < w->u1 ? 1U : 0U);
        }
        out.by_light *= by_light[k] / all_light;
        out.by_angle *= angle[k] / angles;
        out.r = child[k];
        x = 2 * x + (k & 1);
        y = 2 * y + (k >> 1);
    }
    out.r = clipped(w, &out.r);
    return out;
}

/* What the point sees of a group; false if nothing. */
static bool look(const lmg_layout *layout, const lmg_group *g, lmg_vec3 point, bool within, view *w)
{
    const lmg_slab *f = g->frame;
    lmg_vec3 d = v_sub(point, f->o);
    double h = v_dot(d, f->n);
    if (h == 0 || (h < 0 && (g->inside || within || !lmg_box_behind(layout->bounds_min, layout->bounds_max, f->n, point))))
        return false;
    *w = (view){g, v_dot(d, f->a), v_dot(d, f->b), fabs(h), h < 0 ? -1 : 1, g->u0, g->u1, g->v0, g->v1, 0};
    h = w->h;
    if (f->kind == LMG_SLAB_CUBE) {
        w->u0 = fmax(w->u0, w->pu - h);
        w->u1 = fmin(w->u1, w->pu + h);
        w->v0 = fmax(w->v0, w->pv - h);
        w->v1 = fmin(w->v1, w->pv + h);
        if (!(w->u1 > w->u0 && w->v1 > w->v0))
            return false;
    }
    return true;
}

/* Estimate of the light of a whole group. */
static double estimate(const view *w)
{
    rectangle r = {w->u0, w->u1, w->v0, w->v1};
    double cu = 0.5 * (r.u0 + r.u1), cv = 0.5 * (r.v0 + r.v1), du = w->pu - cu, dv = w->pv - cv, r2 = du * du + dv * dv + w->h * w->h;
    double a = r.u1 - r.u0, b = r.v1 - r.v0;
    return solid_angle(w, &r, r2) * luminance_of(w, 0, 0, 0, cu, cv, r2, a > b ? a : b);
}

/* All groups that the point sees, with sums of their estimates and fluxes. */
typedef struct scene {
    uint32_t count;
    view views[LMG_MAX_SLABS];
    double light, flux;
} scene;

static void look_around(const lmg_sampler *sampler, lmg_vec3 point, scene *s)
{
    const lmg_layout *layout = sampler->plan.layout;
    bool within = lmg_box_contains(layout->bounds_min, layout->bounds_max, point);
    s->count = 0;
    s->light = s->flux = 0;
    for (uint32_t i = 0; i < sampler->group_count; i++) {
        view *w = &s->views[s->count];
        if (!look(layout, &sampler->groups[i], point, within, w))
            continue;
        s->count++;
        s->flux += w->g->flux;
    }
    for (uint32_t i = 0; i < s->count; i++)
        if (s->count > 1) {
            s->views[i].weight = estimate(&s->views[i]);
            s->light += s->views[i].weight;
        }
    if (s->count == 1)
        s->views[0].weight = s->light = 1; /* no choice to make */
}

/* Density per steradian of a direction whose leaf is known: c = cosine to the plane's normal. */
static inline double density(const scene *s, const view *w, const leaf *l, double c)
{
    double by_light = s->light > 0 ? (1 - DEFENSIVE) * w->weight / s->light * l->by_light : 0;
    double share = s->light > 0 ? DEFENSIVE : 1;
    double chance = by_light + share * w->g->flux / s->flux * l->by_angle;
    double area = (l->r.u1 - l->r.u0) * (l->r.v1 - l->r.v0);
    return chance / area * (w->h * w->h) / (c * c * c);
}

/* Where the line through the view's point with direction d (against the light: d . n = -c) crosses the plane. */
static inline void foot(const view *w, lmg_vec3 d, double c, double *u, double *v)
{
    const lmg_slab *f = w->g->frame;
    double k = w->side * w->h / c;
    *u = w->pu + k * v_dot(d, f->a);
    *v = w->pv + k * v_dot(d, f->b);
}

double lmg_field_point_pdf(const lmg_field *field, lmg_vec3 point, lmg_vec3 direction)
{
    const lmg_sampler *sampler = field->sampler;
    double uvst[4];
    int j = lmg_plan_owner(&sampler->plan, point, v_scale(-1, direction), uvst);
    if (j < 0 || sampler->group_of[j] < 0)
        return 0;
    scene s;
    look_around(sampler, point, &s);
    const lmg_group *g = &sampler->groups[sampler->group_of[j]];
    for (uint32_t i = 0; i < s.count; i++) {
        const view *w = &s.views[i];
        if (w->g != g)
            continue;
        double c = -v_dot(direction, g->frame->n), u, v;
        if (!(c > 0))
            return 0;
        foot(w, direction, c, &u, &v);
        /* the owner has this place: rounding alone can put it outside */
        u = d_clamp(u, w->u0, w->u1);
        v = d_clamp(v, w->v0, w->v1);
        leaf l = descend(w, u, v, NULL, false);
        return density(&s, w, &l, c);
    }
    return 0;
}

bool lmg_field_sample_point(const lmg_field *field, lmg_vec3 point, const double xi[3], lmg_point_sample *out)
{
    const lmg_sampler *sampler = field->sampler;
    const lmg_layout *layout = &field->layout;
    scene s;
    look_around(sampler, point, &s);
    if (!s.count)
        return false;
    /* first number: by light or by solid angle, then which group */
    double pick = xi[0];
    bool light_counts = s.light > 0 && pick < 1 - DEFENSIVE;
    if (s.light > 0)
        pick = light_counts ? pick / (1 - DEFENSIVE) : (pick - (1 - DEFENSIVE)) / DEFENSIVE;
    pick *= light_counts ? s.light : s.flux;
    uint32_t i = 0;
    for (; i + 1 < s.count; i++) {
        double part = light_counts ? s.views[i].weight : s.views[i].g->flux;
        if (pick < part)
            break;
        pick -= part;
    }
    const view *w = &s.views[i];
    const lmg_slab *frame = w->g->frame;
    double random[2] = {xi[1], xi[2]};
    leaf l = descend(w, 0, 0, random, light_counts);
    double u = l.r.u0 + random[0] * (l.r.u1 - l.r.u0), v = l.r.v0 + random[1] * (l.r.v1 - l.r.v0);
    lmg_vec3 d = v_fma(v_fma(v_scale(-w->side * w->h, frame->n), u - w->pu, frame->a), v - w->pv, frame->b);
    d = v_scale(w->side / v_length(d), d);
    /* Is the light there this group's, and does it come out of the bounds before the point? */
    double uvst[4], k0, k1;
    int j = lmg_plan_owner(&sampler->plan, point, v_scale(-1, d), uvst);
    if (j < 0 || sampler->group_of[j] < 0 || &sampler->groups[sampler->group_of[j]] != w->g)
        return false;
    if (!lmg_box_interval(layout->bounds_min, layout->bounds_max, point, d, &k0, &k1) || k1 < 0)
        return false;
    uint64_t cell = lmg_plan_cell(&sampler->plan, j, uvst);
    lmg_cell_rgb(field, (uint32_t)j, cell, out->radiance);
    if (out->radiance[0] == 0 && out->radiance[1] == 0 && out->radiance[2] == 0)
        return false;
    out->direction = d;
    out->distance = k0 > 0 ? k0 : 0;
    double c = -v_dot(d, frame->n);
    /* If rounding has moved the direction out of the leaf, the density is that of where it is now. */
    foot(w, d, c, &u, &v);
    if (u >= l.r.u0 && u < l.r.u1 && v >= l.r.v0 && v < l.r.v1)
        out->pdf = density(&s, w, &l, c);
    else
        out->pdf = lmg_field_point_pdf(field, point, d);
    return out->pdf > 0;
}
