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
#include "sampler.h"

#include <string.h>

/* Share of samples that go by solid angle alone. */
static const double DEFENSIVE = 0.1;
/* Groups with less than this share of the flux (the coarse slabs that catch what passes beside an opening) aren't estimated point by
 * point: they get their share of the samples that don't go by light, which is enough for their share of the light. */
static const double SMALL_GROUP = 0.02;
/* A node is small when its side is below half its distance: 1/r^3 then varies by a factor of about two within it. */
static const double SMALL = 0.25; /* squared */
/* Deepest level of a descent: 2^-30 of the plane. */
enum { DEEPEST = 30 };
/* A point nearer to the plane than this, in widths of it, is on it and sees nothing: numbers below stay within a float. */
static const double ON_PLANE = 0x1p-40;
static const double BELOW_ONE = 1 - 0x1p-53;

/* -------------------------------------------------------------------------------------------------------------- nodes */

/* Of four numbers at once, those of the four children of a node mostly.  Child k: u upper half if k & 1, v upper half if k & 2; "halves" are two
 * of u, then two of v. */
typedef int64_t two_integers __attribute__((vector_size(16)));
typedef uint16_t eight_shorts __attribute__((vector_size(16)));

static inline lmg_float4 choose(lmg_int4 mask, lmg_float4 yes, lmg_float4 no)
{
    return (lmg_float4)((mask & (lmg_int4)yes) | (~mask & (lmg_int4)no));
}

static inline bool any(lmg_int4 mask)
{
    two_integers m = (two_integers)mask;
    return (m[0] | m[1]) != 0;
}

static inline lmg_float4 clamped(lmg_float4 x, float lo, float hi)
{
    const lmg_float4 least = {lo, lo, lo, lo}, most = {hi, hi, hi, hi};
    x = choose(x > least, x, least);
    return choose(x < most, x, most);
}

/* 1/sqrt(q) to 0.2 %, by one of Newton's steps from a guess at the exponent: enough where it only steers, and the same bits everywhere. */
static inline lmg_float4 inverse_root(lmg_float4 q)
{
    lmg_float4 y = (lmg_float4)(0x5f375a86 - ((lmg_int4)q >> 1));
    return y * (1.5F - 0.5F * q * y * y);
}

static inline lmg_float4 of_u(lmg_float4 halves)
{
    return __builtin_shufflevector(halves, halves, 0, 1, 0, 1);
}

static inline lmg_float4 of_v(lmg_float4 halves)
{
    return __builtin_shufflevector(halves, halves, 2, 2, 3, 3);
}

typedef struct rectangle {
    double u0, u1, v0, v1;
} rectangle;

/* Solid angles of a node's children and estimates of their light. */
typedef struct children {
    lmg_float4 angle, light;
} children;

/*
 * A point as a group sees it, which side of the plane it is on (1 past it, -1 before it) and how far away.  Places on the plane are
 * counted from the point's foot in units of its distance, so that a place (x,y) is seen along the direction (x, y, -side).
 */
typedef struct view {
    const lmg_group *g;
    double side;
    rectangle whole, seen;   /* the group's, and the part of it that the point can see */
    float from[2], per_unit; /* of cube slabs: (s,t) towards the point is from + per_unit x place */
    double weight;           /* estimate of the light from there: solid angle x luminance */
    bool looked;
    children top;            /* of the whole, once it has been looked at */
} view;

/* Where a descent is. */
typedef struct node {
    rectangle r;
    uint32_t level, x, y;
    uint32_t parent; /* among the tables' blocks */
    int slot;        /* below the finest level: the child that everything is in; else -1 */
} node;

static inline double corner_angle(double x, double y)
{
    return atan2(x * y, sqrt(x * x + y * y + 1));
}

/* Solid angle of a rectangle of sides a, b whose middle is at (x,y). */
static float large_angle(float x, float y, float a, float b)
{
    double x0 = (double)x - 0.5 * (double)a, x1 = (double)x + 0.5 * (double)a, y0 = (double)y - 0.5 * (double)b, y1 = (double)y + 0.5 * (double)b;
    double omega = corner_angle(x1, y1) - corner_angle(x0, y1) - corner_angle(x1, y0) + corner_angle(x0, y0);
    return omega > 0 ? (float)omega : 0; /* rounding */
}

/*
 * It only steers, so an approximation does while no rectangle is large: a b / (r^2 + 0.135 a b)^(3/2), exact far away, and for a square
 * seen from over its middle at a distance of half its side.
 */
static inline lmg_float4 solid_angles(lmg_float4 x, lmg_float4 y, lmg_float4 a, lmg_float4 b, bool large)
{
    lmg_float4 area = a * b, y1 = inverse_root(1 + x * x + y * y + 0.135F * area), angle = area * y1 * y1 * y1;
    for (int k = 0; large && k < 4; k++)
        if (area[k] > 4 || a[k] > 4 || b[k] > 4)
            angle[k] = large_angle(x[k], y[k], a[k], b[k]);
    return angle;
}

/* Four numbers that are stored as the upper halves of floats. */
static inline lmg_float4 unpack(const uint16_t *a, const uint16_t *b, const uint16_t *c, const uint16_t *d)
{
#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    return (lmg_float4)(eight_shorts){*a, 0, *b, 0, *c, 0, *d, 0};
#else
    return (lmg_float4)(eight_shorts){0, *a, 0, *b, 0, *c, 0, *d};
#endif
}

/* Mean luminance of the four children over a span of directions about (s,t), between the middles of bins as wide as the span.  From `bins` on,
 * child k's are number offset[k] of each four. */
static inline lmg_float4 read_bins(const lmg_brightness *table, const uint16_t *bins, lmg_int4 offset, lmg_float4 s, lmg_float4 t, float span)
{
    /* the mip whose bins are as wide as the span: 1 + floor(log2(span / finest)), from the float's exponent */
    static const float SCALE[LMG_LEVELS] = {1, 0.5F, 0.25F, 0.125F, 0.0625F};
    float ratio = span * table->inv_finest;
    uint32_t bits;
    memcpy(&bits, &ratio, sizeof bits);
    int mip = (int)(bits >> 23) - 126;
    mip = mip < 0 ? 0 : mip >= LMG_LEVELS ? LMG_LEVELS - 1 : mip;
    const int shift = LMG_LEVELS - 1 - mip; /* 2^shift bins each way */
    const float scale = SCALE[mip], most = (float)((1 << shift) - 1);
    lmg_float4 fs = clamped((s - table->low[0]) * (table->x_scale * scale) - 0.5F, 0, most);
    lmg_float4 ft = clamped((t - table->low[1]) * (table->y_scale * scale) - 0.5F, 0, most);
    lmg_int4 is = __builtin_convertvector(fs, lmg_int4), it = __builtin_convertvector(ft, lmg_int4);
    fs -= __builtin_convertvector(is, lmg_float4);
    ft -= __builtin_convertvector(it, lmg_float4);
    const lmg_int4 at = (((it << shift) + is + LMG_MIP_START[mip]) << 2) + offset;
    /* at the last bin what lies beyond it has the weight 0 */
    const uint16_t *p0 = bins + at[0], *p1 = bins + at[1], *p2 = bins + at[2], *p3 = bins + at[3];
    const size_t right = 4, up = (size_t)4 << shift, both = up + right;
    const lmg_float4 a = unpack(p0, p1, p2, p3), b = unpack(p0 + right, p1 + right, p2 + right, p3 + right);
    const lmg_float4 c = unpack(p0 + up, p1 + up, p2 + up, p3 + up), d = unpack(p0 + both, p1 + both, p2 + both, p3 + both);
    const lmg_float4 lower = a + fs * (b - a), upper = c + fs * (d - c);
    return lower + ft * (upper - lower);
}

/* The four children of a node, whose middle is (mu,mv). */
#if defined(__GNUC__)
__attribute__((always_inline))
#endif
static inline children look_at_children(const view *w, const node *at, double mu, double mv)
{
    const lmg_double4 low = {d_max(at->r.u0, w->seen.u0), d_max(mu, w->seen.u0), d_max(at->r.v0, w->seen.v0), d_max(mv, w->seen.v0)};
    const lmg_double4 high = {d_min(mu, w->seen.u1), d_min(at->r.u1, w->seen.u1), d_min(mv, w->seen.v1), d_min(at->r.v1, w->seen.v1)};
    const lmg_float4 middle = __builtin_convertvector(0.5 * (low + high), lmg_float4), none = {0, 0, 0, 0};
    lmg_float4 side = __builtin_convertvector(high - low, lmg_float4);
    side = choose(side > none, side, none);
    const lmg_float4 x = of_u(middle), y = of_v(middle);
    lmg_float4 longest = __builtin_shufflevector(side, side, 2, 3, 0, 1);
    longest = choose(longest > side, longest, side);
    float span = longest[0] > longest[1] ? longest[0] : longest[1];
    children out;
    out.angle = solid_angles(x, y, of_u(side), of_v(side), span > 2);
    /* the light's directions towards the point in the tables' coordinates, and their span */
    const lmg_group *g = w->g;
    lmg_float4 s, t;
    if (g->frame->kind == LMG_SLAB_APERTURE) {
        const lmg_float4 inverse = w->per_unit * inverse_root(1 + x * x + y * y);
        s = x * inverse;
        t = y * inverse;
        span *= fabsf(inverse[0]);
    } else {
        s = w->from[0] + w->per_unit * x;
        t = w->from[1] + w->per_unit * y;
        span *= fabsf(w->per_unit);
    }
    /* each child by the first table that holds its direction and isn't narrower than the span; else the last */
    const lmg_int4 offset = at->slot < 0 ? (lmg_int4){0, 1, 2, 3} : (lmg_int4){at->slot, at->slot, at->slot, at->slot};
    const size_t first = (size_t)at->parent * LMG_PICTURE * 4;
    lmg_int4 left = {-1, -1, -1, -1};
    const lmg_brightness *table = g->tables, *last = table + g->table_count - 1;
    lmg_float4 light = none;
    for (; table < last && any(left); table++) {
        const lmg_int4 in =
            left & (s >= table->low[0]) & (s < table->high[0]) & (t >= table->low[1]) & (t < table->high[1]);
        if (span < LMG_BINS * table->finest && any(in)) {
            light = choose(in, read_bins(table, table->children + first, offset, s, t, span), light);
            left &= ~in;
        }
    }
    if (any(left))
        light = choose(left, read_bins(last, last->children + first, offset, s, t, span), light);
    out.light = out.angle * light;
    return out;
}

static inline rectangle clipped(const view *w, const rectangle *r)
{
    return (rectangle){d_max(r->u0, w->seen.u0), d_min(r->u1, w->seen.u1), d_max(r->v0, w->seen.v0), d_min(r->v1, w->seen.v1)};
}

static inline bool descent_ends(const view *w, uint32_t level, const rectangle *r)
{
    if (level < w->g->levels)
        return false;
    if (level >= DEEPEST)
        return true;
    rectangle c = clipped(w, r);
    double u = 0.5 * (c.u0 + c.u1), v = 0.5 * (c.v0 + c.v1), a = c.u1 - c.u0, b = c.v1 - c.v0, longest = a > b ? a : b;
    return longest * longest < SMALL * (u * u + v * v + 1);
}

/* What a descent ends with: the leaf and the chances of its path by light and by solid angle. */
typedef struct leaf {
    rectangle r;
    double by_light, by_angle;
} leaf;

static inline node top_of(const view *w)
{
    return (node){w->whole, 0, 0, 0, 0, w->g->levels > 0 ? -1 : 0};
}

/* Chances of children none of which has a solid angle above the smallest float: whatever has an area counts alike. */
static double count_slivers(const view *w, const node *at, double mu, double mv, float angle[4])
{
    double sum = 0;
    for (int k = 0; k < 4; k++) {
        const rectangle half = {k & 1 ? mu : at->r.u0, k & 1 ? at->r.u1 : mu, k & 2 ? mv : at->r.v0, k & 2 ? at->r.v1 : mv}, c = clipped(w, &half);
        angle[k] = c.u1 > c.u0 && c.v1 > c.v0 ? 1 : 0;
        sum += (double)angle[k];
    }
    return sum;
}

/*
 * Goes down the tree: towards the place (u,v) when random is NULL, else by random numbers, by light or by solid angle; *random
 * becomes what is left of them, uniform within the leaf.  Chances are the same products in both cases.
 */
LMG_WIDE static leaf descend(const view *w, double u, double v, double random[2], bool light_counts)
{
    leaf out = {{0}, 1, 1};
    node at = top_of(w);
    while (!descent_ends(w, at.level, &at.r)) {
        const double us[3] = {at.r.u0, 0.5 * (at.r.u0 + at.r.u1), at.r.u1}, vs[3] = {at.r.v0, 0.5 * (at.r.v0 + at.r.v1), at.r.v1};
        const double mu = us[1], mv = vs[1];
        const children seen = at.level == 0 && w->looked ? w->top : look_at_children(w, &at, mu, mv);
        float angle[4], light[4];
        memcpy(angle, &seen.angle, sizeof angle);
        memcpy(light, &seen.light, sizeof light);
        /* summed as the two splits below do, so that densities are exact */
        double angles = ((double)angle[0] + (double)angle[1]) + ((double)angle[2] + (double)angle[3]);
        double lights = ((double)light[0] + (double)light[1]) + ((double)light[2] + (double)light[3]);
        if (!(angles > 0))
            angles = count_slivers(w, &at, mu, mv, angle);
        const float *by_light = lights > 0 ? light : angle;
        double all_light = lights > 0 ? lights : angles;
        uint32_t right, up;
        if (random) {
            /* Looked up, not branched on: which way it goes is random, and a branch would be mispredicted half the time. */
            const float *p = light_counts ? by_light : angle;
            const double row[2] = {(double)p[0] + (double)p[1], (double)p[2] + (double)p[3]}, r = random[1] * (row[0] + row[1]);
            const double below[2] = {0, row[0]};
            up = (uint32_t)(r >= row[0]) & (uint32_t)(row[1] > 0);
            random[1] = d_min((r - below[up]) / row[up], BELOW_ONE);
            const double left[2] = {0, (double)p[2 * up]}, x = random[0] * row[up];
            right = (uint32_t)(x >= left[1]) & (uint32_t)(p[2 * up + 1] > 0);
            random[0] = d_min((x - left[right]) / (double)p[2 * up + right], BELOW_ONE);
        } else {
            /* a place on the upper border of what the point sees belongs to the half that reaches there */
            up = v >= mv && mv < w->seen.v1;
            right = u >= mu && mu < w->seen.u1;
        }
        out.by_light *= (double)by_light[2 * up + right] / all_light;
        out.by_angle *= (double)angle[2 * up + right] / angles;
        at.r = (rectangle){us[right], us[right + 1], vs[up], vs[up + 1]};
        at.level++;
        at.x = 2 * at.x + right;
        at.y = 2 * at.y + up;
        if (at.level < w->g->levels)
            at.parent = LMG_LEVEL_START[at.level] + (at.y << at.level) + at.x;
        else if (at.level == w->g->levels)
            at.slot = (int)(2 * up + right); /* from here on the block stays what it is */
    }
    out.r = clipped(w, &at.r);
    return out;
}

/* What the point sees of a group; false if nothing. */
static bool look(const lmg_layout *layout, const lmg_group *g, lmg_vec3 point, bool within, view *w)
{
    const lmg_slab *f = g->frame;
    const lmg_vec3 d = v_sub(point, f->o);
    const double past = v_dot(d, f->n), h = fabs(past), pu = v_dot(d, f->a), pv = v_dot(d, f->b);
    if (!(h > ON_PLANE * (g->u1 - g->u0 + g->v1 - g->v0)) ||
        (past < 0 && (g->inside || within || !lmg_box_behind(layout->bounds_min, layout->bounds_max, f->n, point))))
        return false;
    const double inverse = 1 / h, side = past < 0 ? -1 : 1;
    const bool cube = f->kind == LMG_SLAB_CUBE, slopes = !cube || isinf(f->distance);
    w->g = g;
    w->side = side;
    w->whole = w->seen = (rectangle){(g->u0 - pu) * inverse, (g->u1 - pu) * inverse, (g->v0 - pv) * inverse, (g->v1 - pv) * inverse};
    w->from[0] = slopes ? 0 : (float)pu;
    w->from[1] = slopes ? 0 : (float)pv;
    w->per_unit = (float)(slopes ? -side : h - side * f->distance);
    w->weight = 0;
    w->looked = false;
    if (cube) {
        w->seen = (rectangle){d_max(w->whole.u0, -1), d_min(w->whole.u1, 1), d_max(w->whole.v0, -1), d_min(w->whole.v1, 1)};
        return w->seen.u1 > w->seen.u0 && w->seen.v1 > w->seen.v0;
    }
    return true;
}

/* All groups that the point sees, with sums of their estimates and fluxes. */
typedef struct scene {
    uint32_t count;
    view views[LMG_MAX_SLABS];
    double light, flux;
} scene;

static inline bool is_large(const lmg_sampler *sampler, const lmg_group *g)
{
    return g->flux >= SMALL_GROUP * sampler->flux;
}

LMG_WIDE static void estimate(view *w)
{
    const node top = top_of(w);
    w->top = look_at_children(w, &top, 0.5 * (top.r.u0 + top.r.u1), 0.5 * (top.r.v0 + top.r.v1));
    w->looked = true;
    w->weight = ((double)w->top.light[0] + (double)w->top.light[1]) + ((double)w->top.light[2] + (double)w->top.light[3]);
}

static void look_around(const lmg_sampler *sampler, lmg_vec3 point, scene *s)
{
    const lmg_layout *layout = sampler->plan.layout;
    bool within = lmg_box_contains(layout->bounds_min, layout->bounds_max, point);
    uint32_t large = 0;
    s->count = 0;
    s->light = s->flux = 0;
    for (uint32_t i = 0; i < sampler->group_count; i++) {
        const lmg_group *g = &sampler->groups[i];
        if (!look(layout, g, point, within, &s->views[s->count]))
            continue;
        s->count++;
        s->flux += g->flux;
        large += is_large(sampler, g);
    }
    for (uint32_t i = 0; i < s->count; i++) {
        view *w = &s->views[i];
        if (!is_large(sampler, w->g))
            continue;
        if (large > 1)
            estimate(w);
        else
            w->weight = 1; /* no choice to make between one */
        s->light += w->weight;
    }
}

/* Density per steradian of a direction whose leaf is known: c = cosine to the plane's normal. */
static inline double density(const scene *s, const view *w, const leaf *l, double c)
{
    double by_light = s->light > 0 ? (1 - DEFENSIVE) * w->weight / s->light * l->by_light : 0;
    double share = s->light > 0 ? DEFENSIVE : 1;
    double chance = by_light + share * w->g->flux / s->flux * l->by_angle;
    return chance / ((l->r.u1 - l->r.u0) * (l->r.v1 - l->r.v0) * (c * c * c));
}

/* Where the line through the view's point with direction d (against the light: d . n = -c) crosses the plane. */
static inline void foot(const view *w, lmg_vec3 d, double c, double *u, double *v)
{
    const lmg_slab *f = w->g->frame;
    const double k = w->side / c;
    *u = k * v_dot(d, f->a);
    *v = k * v_dot(d, f->b);
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
        u = d_clamp(u, w->seen.u0, w->seen.u1);
        v = d_clamp(v, w->seen.v0, w->seen.v1);
        leaf l = descend(w, u, v, NULL, false);
        return density(&s, w, &l, c);
    }
    return 0;
}

LMG_WIDE bool lmg_field_sample_point(const lmg_field *field, lmg_vec3 point, const double xi[3], lmg_point_sample *out)
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
    lmg_vec3 d = v_fma(v_fma(v_scale(-w->side, frame->n), u, frame->a), v, frame->b);
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
    out->slab = (uint32_t)j;
    out->cell = place.cell;
    out->st = place.st;
    memcpy(out->within, &place.x, sizeof out->within);
    return out->pdf > 0;
}

bool lmg_field_sample_radiance(const lmg_field *field, const lmg_point_sample *sample, float rgb[3])
{
    lmg_place place = {.cell = sample->cell, .st = sample->st};
    memcpy(&place.x, sample->within, sizeof place.x);
    lmg_place_rgb(field, sample->slab, &place, rgb);
    return rgb[0] != 0 || rgb[1] != 0 || rgb[2] != 0;
}
