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
/* Groups with less than this share of the flux (the coarse slabs that catch what passes beside an opening) aren't estimated point by
 * point: they get their share of the samples that don't go by light, which is enough for their share of the light. */
static const double SMALL_GROUP = 0.02;
/* A node is small when its side is below half its distance: 1/r^3 then varies by a factor of about two within it. */
static const double SMALL = 0.25; /* squared */
/* Deepest level of a descent: 2^-30 of the plane; a point nearer than that is on it. */
enum { DEEPEST = 30 };
static const double BELOW_ONE = 1 - 0x1p-53;
/* Part of the brightest neighbour's luminance added to each bin: light may stand across the border of bins or blocks from where the
 * node's middle looks. */
static const float SPILL = 0.1F;

/* First block of a level, among parents; and first bin of a mip within a picture. */
static const uint32_t LEVEL_START[LMG_LEVELS] = {0, 1, 5, 21, 85};
static const uint32_t MIP_START[LMG_LEVELS] = {0, 256, 320, 336, 340};

/* ------------------------------------------------------------------------------------------------------------- tables */

enum { FINE = 1 << (LMG_LEVELS - 1), BINS = LMG_BINS * LMG_BINS }; /* blocks of the finest level, each way; finest bins of a picture */

/* Overlap of cell i of n on [lo,hi] with blocks on [from,to]: first block, number, and each block's covered share. */
static int overlap(double lo, double hi, uint32_t n, uint32_t i, double from, double to, int *first, double share[FINE])
{
    double a = lo + (hi - lo) * i / n, b = lo + (hi - lo) * (i + 1) / n, step = (to - from) / FINE;
    int k0 = (int)d_clamp((a - from) / step, 0, FINE - 1), k1 = (int)d_clamp((b - from) / step, 0, FINE - 1);
    *first = k0;
    for (int k = k0; k <= k1; k++)
        share[k - k0] = d_max(d_min(b, from + (k + 1) * step) - d_max(a, from + k * step), 0) / step;
    return k1 - k0 + 1;
}

/* Which bins an (s,t) cell's light falls in, and what share of the bin it covers. */
typedef struct part {
    uint32_t bin;
    float share;
} part;

/* Parts of all (s,t) cells of a slab, cell i's from start[i] to start[i+1]; NULL without memory.  By points spread over each cell. */
static part *parts_of_cells(const lmg_slab *slab, const lmg_brightness *table, size_t *start)
{
    size_t count = 0, room = (size_t)slab->ns * slab->nt * 2 + BINS;
    part *parts = malloc(room * sizeof *parts);
    double ds = (slab->s1 - slab->s0) / slab->ns, dt = (slab->t1 - slab->t0) / slab->nt;
    double bin_x = (table->x1 - table->x0) / LMG_BINS, bin_y = (table->y1 - table->y0) / LMG_BINS;
    int ms = (int)d_clamp(ceil(4 * ds / bin_x), 3, 64), mt = (int)d_clamp(ceil(4 * dt / bin_y), 3, 64);
    for (uint32_t it = 0; parts && it < slab->nt; it++)
        for (uint32_t is = 0; is < slab->ns; is++) {
            float share[BINS] = {0};
            uint32_t touched[BINS];
            size_t n = 0;
            for (int k = 0; k < ms * mt; k++) {
                double s = slab->s0 + ds * (is + (k % ms + 0.5) / ms), t = slab->t0 + dt * (it + (k / ms + 0.5) / mt), z;
                double area = ds * dt / (ms * mt);
                if (slab->kind == LMG_SLAB_APERTURE) {
                    lmg_square_to_disc(s, t, &s, &t, &z);
                    area *= LMG_PI / 4;
                }
                double x = floor((s - table->x0) / bin_x), y = floor((t - table->y0) / bin_y);
                if (!(x >= 0 && x < LMG_BINS && y >= 0 && y < LMG_BINS))
                    continue;
                uint32_t bin = (uint32_t)y * LMG_BINS + (uint32_t)x;
                if (share[bin] == 0)
                    touched[n++] = bin;
                share[bin] += (float)(area / (bin_x * bin_y));
            }
            if (count + n > room) {
                room = 2 * room + BINS;
                part *more = realloc(parts, room * sizeof *parts);
                if (!more) {
                    free(parts);
                    return NULL;
                }
                parts = more;
            }
            start[(size_t)it * slab->ns + is] = count;
            for (size_t k = 0; k < n; k++)
                parts[count++] = (part){touched[k], share[touched[k]]};
        }
    start[(size_t)slab->ns * slab->nt] = count;
    return parts;
}

/* Adds the light of slab j to pictures of the finest blocks: mean luminance per block and bin. */
static bool gather(const lmg_field *field, uint32_t j, const lmg_group *g, const lmg_brightness *table, float (*fine)[LMG_PICTURE])
{
    const lmg_slab *slab = &field->layout.slabs[j];
    size_t st = (size_t)slab->ns * slab->nt;
    size_t *start = malloc((st + 1) * sizeof *start);
    part *parts = start ? parts_of_cells(slab, table, start) : NULL;
    for (uint32_t iv = 0; parts && iv < slab->nv; iv++)
        for (uint32_t iu = 0; iu < slab->nu; iu++) {
            uint64_t cell = ((uint64_t)iv * slab->nu + iu) * st;
            float picture[BINS] = {0};
            for (size_t i = 0; i < st; i++) {
                if (start[i] == start[i + 1])
                    continue;
                double l = lmg_cell_luminance(field, j, cell + i);
                if (l > 0)
                    for (size_t k = start[i]; k < start[i + 1]; k++)
                        picture[parts[k].bin] += parts[k].share * (float)l;
            }
            double share_u[FINE], share_v[FINE];
            int first_u, first_v, nu = overlap(slab->u0, slab->u1, slab->nu, iu, g->u0, g->u1, &first_u, share_u);
            int nv = overlap(slab->v0, slab->v1, slab->nv, iv, g->v0, g->v1, &first_v, share_v);
            for (int y = 0; y < nv; y++)
                for (int x = 0; x < nu; x++) {
                    float *p = fine[(first_v + y) * FINE + first_u + x], share = (float)(share_u[x] * share_v[y]);
                    for (int k = 0; k < BINS; k++)
                        p[k] += picture[k] * share;
                }
        }
    bool done = parts != NULL;
    free(parts);
    free(start);
    return done;
}

/* The upper half of a float: eight bits of precision steer well enough, and tables of half the size stay in the cache. */
static inline uint16_t pack(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (uint16_t)((bits + (bits < 0x7f7f0000 ? 0x8000 : 0)) >> 16); /* rounded, but not to infinity */
}

static inline float unpack(uint16_t half)
{
    uint32_t bits = (uint32_t)half << 16;
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* From the finest blocks' finest bins: spill into neighbours, mips, coarser levels, and all of it into the table. */
static void finish(lmg_brightness *table, float (*level_pictures)[LMG_PICTURE])
{
    for (int block = 0; block < FINE * FINE; block++) {
        float *p = level_pictures[block], old[BINS];
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
    /* Each level goes to its parents' places and is averaged for the next, in place: parent i reads blocks that come after it. */
    for (int level = LMG_LEVELS - 2; level >= 0; level--) {
        int n = 1 << level;
        for (int y = 0; y < n; y++)
            for (int x = 0; x < n; x++) {
                float mean[LMG_PICTURE] = {0};
                uint16_t *to = table->children + (size_t)(LEVEL_START[level] + (uint32_t)(y * n + x)) * LMG_PICTURE * 4;
                for (int k = 0; k < 4; k++) {
                    const float *from = level_pictures[(2 * y + k / 2) * 2 * n + 2 * x + k % 2];
                    for (int i = 0; i < LMG_PICTURE; i++) {
                        to[4 * i + k] = pack(from[i]);
                        mean[i] += 0.25F * from[i];
                    }
                }
                memcpy(level_pictures[y * n + x], mean, sizeof mean);
            }
    }
    for (int i = 0; i < LMG_PICTURE; i++)
        table->root[i] = pack(level_pictures[0][i]);
}

static const size_t TABLE_BYTES = (size_t)LMG_PARENTS * LMG_PICTURE * 4 * sizeof(uint16_t);

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
            lmg_table_free(sampler->groups[g].tables[k].children, TABLE_BYTES);
        free(sampler->groups[g].tables);
    }
    sampler->group_count = 0;
}

/* Rectangle of directions that holds a slab's (s,t): itself, or of aperture slabs the direction cosines on it, which go furthest on its
 * border. */
static void directions_of(const lmg_slab *slab, lmg_brightness *table)
{
    if (slab->kind != LMG_SLAB_APERTURE) {
        *table = (lmg_brightness){.x0 = slab->s0, .x1 = slab->s1, .y0 = slab->t0, .y1 = slab->t1};
        return;
    }
    *table = (lmg_brightness){.x0 = INFINITY, .x1 = -INFINITY, .y0 = INFINITY, .y1 = -INFINITY};
    enum { STEPS = 64 };
    for (int k = 0; k < 4 * STEPS; k++) {
        double f = (double)(k % STEPS) / STEPS, x, y, z;
        double s = k < STEPS ? slab->s0 + f * (slab->s1 - slab->s0) : k < 2 * STEPS ? slab->s1 : k < 3 * STEPS ? slab->s1 - f * (slab->s1 - slab->s0) : slab->s0;
        double t = k < STEPS ? slab->t0 : k < 2 * STEPS ? slab->t0 + f * (slab->t1 - slab->t0) : k < 3 * STEPS ? slab->t1 : slab->t1 - f * (slab->t1 - slab->t0);
        lmg_square_to_disc(s, t, &x, &y, &z);
        table->x0 = d_min(table->x0, x);
        table->x1 = d_max(table->x1, x);
        table->y0 = d_min(table->y0, y);
        table->y1 = d_max(table->y1, y);
    }
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
        g->u0 = d_min(g->u0, slab->u0);
        g->u1 = d_max(g->u1, slab->u1);
        g->v0 = d_min(g->v0, slab->v0);
        g->v1 = d_max(g->v1, slab->v1);
        g->flux += field->slabs[j].flux;
        sampler->flux += field->slabs[j].flux;
        g->inside = g->inside && sampler->etendue[j].inside;
        uint32_t cells = slab->nu > slab->nv ? slab->nu : slab->nv, levels = 0;
        while (levels + 1 < LMG_LEVELS && (uint32_t)1 << levels < cells)
            levels++;
        g->levels = levels > g->levels ? levels : g->levels;
        sampler->group_of[j] = (int8_t)at;
    }
    float(*pictures)[LMG_PICTURE] = malloc(FINE * FINE * sizeof *pictures);
    lmg_result r = pictures ? LMG_OK : LMG_ERROR_MEMORY;
    for (uint32_t i = 0; r == LMG_OK && i < sampler->group_count; i++) {
        lmg_group *g = &sampler->groups[i];
        uint32_t count = 0;
        for (uint32_t j = 0; j < layout->slab_count; j++)
            count += sampler->group_of[j] == (int8_t)i;
        g->tables = calloc(count + 1, sizeof *g->tables);
        if (!g->tables) {
            r = LMG_ERROR_MEMORY;
            break;
        }
        /* one for each slab, and one around all where the last of them isn't that */
        lmg_brightness around = {.x0 = INFINITY, .x1 = -INFINITY, .y0 = INFINITY, .y1 = -INFINITY};
        for (uint32_t j = 0; j < layout->slab_count; j++)
            if (sampler->group_of[j] == (int8_t)i) {
                lmg_brightness *t = &g->tables[g->table_count++];
                directions_of(&layout->slabs[j], t);
                around.x0 = d_min(around.x0, t->x0);
                around.x1 = d_max(around.x1, t->x1);
                around.y0 = d_min(around.y0, t->y0);
                around.y1 = d_max(around.y1, t->y1);
            }
        const lmg_brightness *last = &g->tables[g->table_count - 1];
        if (last->x0 > around.x0 || last->x1 < around.x1 || last->y0 > around.y0 || last->y1 < around.y1)
            g->tables[g->table_count++] = around;
        for (uint32_t k = 0; r == LMG_OK && k < g->table_count; k++) {
            lmg_brightness *t = &g->tables[k];
            t->x_scale = (float)(LMG_BINS / (t->x1 - t->x0));
            t->y_scale = (float)(LMG_BINS / (t->y1 - t->y0));
            t->inv_finest = fmaxf(t->x_scale, t->y_scale);
            t->finest = 1 / t->inv_finest;
            t->children = lmg_table_alloc(TABLE_BYTES);
            if (!t->children)
                r = LMG_ERROR_MEMORY;
            memset(pictures, 0, FINE * FINE * sizeof *pictures);
            for (uint32_t j = 0; r == LMG_OK && j < layout->slab_count; j++)
                if (sampler->group_of[j] == (int8_t)i && !gather(field, j, g, t, pictures))
                    r = LMG_ERROR_MEMORY;
            if (r == LMG_OK)
                finish(t, pictures);
        }
    }
    free(pictures);
    return r == LMG_OK ? LMG_OK : lmg_fail(err, r, "field: no memory for its sampler");
}

/* -------------------------------------------------------------------------------------------------------------- nodes */

/* A point as a group sees it: its foot on the plane, its distance from it, and on which side it is: 1 past the plane, -1 before it. */
typedef struct view {
    const lmg_group *g;
    double pu, pv, h, side;
    double u0, u1, v0, v1; /* part of the plane that the point can see */
    double inv_h, to_units; /* 1 / h; with the side's sign */
    double weight;         /* estimate of the light from there: solid angle x luminance */
} view;

typedef struct rectangle {
    double u0, u1, v0, v1;
} rectangle;

static inline double corner_angle(double x, double y)
{
    return atan2(x * y, sqrt(x * x + y * y + 1));
}

/*
 * Solid angle of a rectangle of sides a, b whose middle is (x,y) from the foot, in units of the point's distance from the plane.  It only
 * steers, so an approximation does while the rectangle isn't large: a b / (r^2 + 0.135 a b)^(3/2), exact far away, and for a
 * square seen from over its middle at a distance of half its side.
 */
static inline float small_angle(float x, float y, float a, float b)
{
    float area = a * b, q = 1 + x * x + y * y + 0.135F * area;
    return area / (q * sqrtf(q));
}

/* Whether that won't do, and what does. */
static inline bool is_large(float a, float b)
{
    return a * b > 4 || a > 4 || b > 4;
}

static float large_angle(float x, float y, float a, float b)
{
    double x0 = (double)x - 0.5 * (double)a, x1 = (double)x + 0.5 * (double)a, y0 = (double)y - 0.5 * (double)b, y1 = (double)y + 0.5 * (double)b;
    double omega = corner_angle(x1, y1) - corner_angle(x0, y1) - corner_angle(x1, y0) + corner_angle(x0, y0);
    return omega > 0 ? (float)omega : 0; /* rounding */
}

/* The table to read: the first that holds the direction and isn't narrower than the span; else the last. */
static inline const lmg_brightness *table_for(const lmg_group *g, float s, float t, float span)
{
    const lmg_brightness *table = g->tables;
    for (uint32_t k = 1; k < g->table_count; k++, table++)
        if (s >= (float)table->x0 && s < (float)table->x1 && t >= (float)table->y0 && t < (float)table->y1 && span < LMG_BINS * table->finest)
            break;
    return table;
}

/* Mean luminance over a span of directions about (s,t), between the middles of bins as wide as the span.  bins: every stride-th value. */
static inline float read_bins(const lmg_brightness *table, const uint16_t *bins, int stride, float s, float t, float span)
{
    /* the mip whose bins are as wide as the span: 1 + floor(log2(span / finest)), from the float's exponent */
    static const float SCALE[LMG_LEVELS] = {1, 0.5F, 0.25F, 0.125F, 0.0625F};
    float ratio = span * table->inv_finest;
    uint32_t bits;
    memcpy(&bits, &ratio, sizeof bits);
    int mip = (int)(bits >> 23) - 126;
    mip = mip < 0 ? 0 : mip >= LMG_LEVELS ? LMG_LEVELS - 1 : mip;
    int n = LMG_BINS >> mip;
    float scale = SCALE[mip], most = (float)(n - 1);
    float fs = (s - (float)table->x0) * table->x_scale * scale - 0.5F, ft = (t - (float)table->y0) * table->y_scale * scale - 0.5F;
    fs = fs < 0 ? 0 : fs > most ? most : fs;
    ft = ft < 0 ? 0 : ft > most ? most : ft;
    int s0 = (int)fs, t0 = (int)ft, right = s0 + 1 < n ? stride : 0, up = t0 + 1 < n ? stride * n : 0;
    fs -= (float)s0;
    ft -= (float)t0;
    const uint16_t *p = bins + (MIP_START[mip] + (uint32_t)(t0 * n + s0)) * (uint32_t)stride;
    return (1 - ft) * ((1 - fs) * unpack(p[0]) + fs * unpack(p[right])) + ft * ((1 - fs) * unpack(p[up]) + fs * unpack(p[up + right]));
}

/* Up to four places at once, so that the compiler can use vectors: places (x,y) of a plane in units of the point's distance, squares of
 * side `longest` about them.  Gives the light's directions towards the point in the tables' coordinates and the span of directions. */
static inline void directions_towards(const view *w, const float x[4], const float y[4], const double cu[4], const double cv[4],
                                      const float longest[4], float s[4], float t[4], float span[4])
{
    const lmg_slab *frame = w->g->frame;
    if (frame->kind == LMG_SLAB_APERTURE) {
        for (int k = 0; k < 4; k++) {
            float inv = 1 / sqrtf(1 + x[k] * x[k] + y[k] * y[k]);
            s[k] = x[k] * inv;
            t[k] = y[k] * inv;
            span[k] = longest[k] * inv;
        }
    } else if (isinf(frame->distance)) {
        for (int k = 0; k < 4; k++) {
            s[k] = x[k];
            t[k] = y[k];
            span[k] = longest[k];
        }
    } else {
        for (int k = 0; k < 4; k++) {
            s[k] = (float)(cu[k] + frame->distance * (double)x[k]);
            t[k] = (float)(cv[k] + frame->distance * (double)y[k]);
            span[k] = (float)fabs((double)longest[k] * (w->h - frame->distance));
        }
    }
}

/* Where a descent is. */
typedef struct node {
    rectangle r;
    uint32_t level, x, y;
    uint32_t parent;  /* among the tables' blocks */
    int slot;         /* below the finest level: the child that everything is in; else -1 */
} node;

/* The four children of a node: solid angles and estimates of their light.  Child k: u upper half if k & 1, v upper half if k & 2. */
static inline void look_at_children(const view *w, const node *at, double mu, double mv, float angle[4], float light[4])
{
    const double us[4] = {d_max(at->r.u0, w->u0), d_min(mu, w->u1), d_max(mu, w->u0), d_min(at->r.u1, w->u1)};
    const double vs[4] = {d_max(at->r.v0, w->v0), d_min(mv, w->v1), d_max(mv, w->v0), d_min(at->r.v1, w->v1)};
    float x[4], y[4], a[4], b[4], longest[4], s[4], t[4], span[4];
    double cu[4], cv[4];
    for (int k = 0; k < 4; k++) {
        int i = k & 1, j = k >> 1;
        cu[k] = 0.5 * (us[2 * i] + us[2 * i + 1]);
        cv[k] = 0.5 * (vs[2 * j] + vs[2 * j + 1]);
        x[k] = (float)((w->pu - cu[k]) * w->to_units);
        y[k] = (float)((w->pv - cv[k]) * w->to_units);
        double da = us[2 * i + 1] - us[2 * i], db = vs[2 * j + 1] - vs[2 * j];
        a[k] = (float)((da > 0 ? da : 0) * w->inv_h);
        b[k] = (float)((db > 0 ? db : 0) * w->inv_h);
        longest[k] = a[k] > b[k] ? a[k] : b[k];
    }
    bool large = false;
    for (int k = 0; k < 4; k++) {
        angle[k] = small_angle(x[k], y[k], a[k], b[k]);
        large = large || is_large(a[k], b[k]);
    }
    for (int k = 0; large && k < 4; k++)
        if (is_large(a[k], b[k]))
            angle[k] = large_angle(x[k], y[k], a[k], b[k]);
    directions_towards(w, x, y, cu, cv, longest, s, t, span);
    for (int k = 0; k < 4; k++) {
        const lmg_brightness *table = table_for(w->g, s[k], t[k], span[k]);
        const uint16_t *bins = table->children + (size_t)at->parent * LMG_PICTURE * 4 + (at->slot < 0 ? k : at->slot);
        light[k] = angle[k] * read_bins(table, bins, 4, s[k], t[k], span[k]);
    }
}

static inline rectangle clipped(const view *w, const rectangle *r)
{
    return (rectangle){d_max(r->u0, w->u0), d_min(r->u1, w->u1), d_max(r->v0, w->v0), d_min(r->v1, w->v1)};
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
    node at = {out.r, 0, 0, 0, 0, w->g->levels > 0 ? -1 : 0};
    while (!descent_ends(w, at.level, &at.r)) {
        double mu = 0.5 * (at.r.u0 + at.r.u1), mv = 0.5 * (at.r.v0 + at.r.v1);
        float angle[4], light[4];
        look_at_children(w, &at, mu, mv, angle, light);
        /* summed as the two splits below do, so that densities are exact */
        double angles = ((double)angle[0] + (double)angle[1]) + ((double)angle[2] + (double)angle[3]);
        double lights = ((double)light[0] + (double)light[1]) + ((double)light[2] + (double)light[3]);
        if (!(angles > 0)) {
            angles = 0;
            /* slivers whose solid angle underflows: whatever has an area counts alike */
            for (int k = 0; k < 4; k++) {
                bool left = d_min(mu, w->u1) > d_max(at.r.u0, w->u0), right = d_min(at.r.u1, w->u1) > d_max(mu, w->u0);
                bool lower = d_min(mv, w->v1) > d_max(at.r.v0, w->v0), upper = d_min(at.r.v1, w->v1) > d_max(mv, w->v0);
                angle[k] = (k & 1 ? right : left) && (k & 2 ? upper : lower) ? 1 : 0;
                angles += (double)angle[k];
            }
        }
        const float *by_light = lights > 0 ? light : angle;
        double all_light = lights > 0 ? lights : angles;
        uint32_t k;
        if (random) {
            /* Written for conditional moves: which way it goes is random, and a branch would be mispredicted half the time. */
            const float *p = light_counts ? by_light : angle;
            double lower = (double)p[0] + (double)p[1], upper = (double)p[2] + (double)p[3], r = random[1] * (lower + upper);
            bool up = r >= lower && upper > 0;
            double row_sum = up ? upper : lower;
            random[1] = d_min((r - (up ? lower : 0)) / row_sum, BELOW_ONE);
            const float *row = p + 2 * up;
            double left = (double)row[0];
            r = random[0] * row_sum;
            bool right = r >= left && row[1] > 0;
            random[0] = d_min((r - (right ? left : 0)) / (double)row[right], BELOW_ONE);
            k = (up ? 2U : 0U) + (right ? 1U : 0U);
        } else {
            /* a place on the upper border of what the point sees belongs to the half that reaches there */
            k = (v >= mv && mv < w->v1 ? 2U : 0U) + (u >= mu && mu < w->u1 ? 1U : 0U);
        }
        out.by_light *= (double)by_light[k] / all_light;
        out.by_angle *= (double)angle[k] / angles;
        at.r.u0 = k & 1 ? mu : at.r.u0;
        at.r.u1 = k & 1 ? at.r.u1 : mu;
        at.r.v0 = k & 2 ? mv : at.r.v0;
        at.r.v1 = k & 2 ? at.r.v1 : mv;
        at.level++;
        at.x = 2 * at.x + (k & 1);
        at.y = 2 * at.y + (k >> 1);
        if (at.level < w->g->levels)
            at.parent = LEVEL_START[at.level] + (at.y << at.level) + at.x;
        else if (at.level == w->g->levels)
            at.slot = (int)k; /* from here on the block stays what it is */
    }
    out.r = clipped(w, &at.r);
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
    *w = (view){g, v_dot(d, f->a), v_dot(d, f->b), fabs(h), h < 0 ? -1 : 1, g->u0, g->u1, g->v0, g->v1, 1 / fabs(h), 1 / h, 0};
    h = w->h;
    if (f->kind == LMG_SLAB_CUBE) {
        w->u0 = d_max(w->u0, w->pu - h);
        w->u1 = d_min(w->u1, w->pu + h);
        w->v0 = d_max(w->v0, w->pv - h);
        w->v1 = d_min(w->v1, w->pv + h);
        if (!(w->u1 > w->u0 && w->v1 > w->v0))
            return false;
    }
    return true;
}

/* Estimate of the light of a whole group. */
static double estimate(const view *w)
{
    /* one place, four times: what is shared with the children's four */
    const double cu[4] = {0.5 * (w->u0 + w->u1)}, cv[4] = {0.5 * (w->v0 + w->v1)};
    float a = (float)((w->u1 - w->u0) * w->inv_h), b = (float)((w->v1 - w->v0) * w->inv_h), s[4], t[4], span[4];
    const float x[4] = {(float)((w->pu - cu[0]) * w->to_units)}, y[4] = {(float)((w->pv - cv[0]) * w->to_units)}, longest[4] = {a > b ? a : b};
    directions_towards(w, x, y, cu, cv, longest, s, t, span);
    const lmg_brightness *table = table_for(w->g, s[0], t[0], span[0]);
    float angle = is_large(a, b) ? large_angle(x[0], y[0], a, b) : small_angle(x[0], y[0], a, b);
    return (double)(angle * read_bins(table, table->root, 1, s[0], t[0], span[0]));
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
    uint32_t large = 0;
    for (uint32_t i = 0; i < s->count; i++)
        large += s->views[i].g->flux >= SMALL_GROUP * sampler->flux;
    for (uint32_t i = 0; i < s->count; i++)
        if (s->views[i].g->flux >= SMALL_GROUP * sampler->flux) {
            s->views[i].weight = large > 1 ? estimate(&s->views[i]) : 1; /* no choice to make between one */
            s->light += s->views[i].weight;
        }
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
        double chance = light_counts ? s.views[i].weight : s.views[i].g->flux;
        if (pick < chance)
            break;
        pick -= chance;
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
    const lmg_place place = lmg_plan_place(&sampler->plan, j, uvst);
    lmg_place_prefetch(field, (uint32_t)j, &place);
    if (!lmg_box_interval(layout->bounds_min, layout->bounds_max, point, d, &k0, &k1) || k1 < 0)
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
    lmg_place_rgb(field, (uint32_t)j, &place, out->radiance);
    if (out->radiance[0] == 0 && out->radiance[1] == 0 && out->radiance[2] == 0)
        return false;
    return out->pdf > 0;
}
