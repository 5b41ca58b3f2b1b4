/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fits a layout to pilot rays.  Relies on geometry.h for coordinates.
 *
 * Everything is judged by one measure, the error that the layout's cells alone put into illuminance, noise left out: each pilot ray is
 * moved to a random place in its own cell (that is what a cell does to light), and the illuminance on planes before and after is
 * compared.  Half A's differences times half B's, summed over the planes' pixels, have the squared error as their mean, because the noise of the
 * halves is independent.  All candidates use the same random numbers, so that they differ by what the cells do.
 *
 * In turn: where each (u,v) plane stands, which window in (s,t) holds the beam if there is one, how the cells are shared out between
 * (u,v) and (s,t) and between window and the rest; last, one opening or six faces.
 */
#include "field.h"
#include "geometry.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Pilot rays that the search looks at; more don't change its choices, they only take time. */
enum { SEARCH_RAYS = 50000 };
/* Planes at these distances, in sizes, and their pixels each way. */
enum { PLANES = 4, PIXELS = 24 };
static const double PLANE_DISTANCE[PLANES] = {0.5, 1, 2, 5};
/* Share of the flux left out at either end of a (u,v) rectangle; the slabs below catch it. */
static const double RECTANGLE_TAIL = 5e-5;
/* Share of the flux that may pass beside the opening (or backwards) for a luminaire to be one that shines through an opening. */
static const double APERTURE_REST = 0.02;
static const uint64_t DEFAULT_CELLS = 4000000;
/* A candidate has to be this much better than what stands, and by three standard errors: dozens are tried, and the luckiest of equals
 * mustn't win. */
static const double GAIN = 0.97;
/* Errors of illuminance below 0.1 % are good enough: nothing is gained by telling them apart. */
static const double GOOD_ENOUGH = 0.001 * 0.001;
/* A window has to promise less than this part of the error without it. */
static const double WINDOW_WORTH = 0.8;
/* Six faces have to be this much better than one opening, which has the simpler cells: one rectangle, equal etendue. */
static const double CUBE_GAIN = 0.8;
/* Narrowest (u,v) rectangle, in sizes: light from a point gets a place whose radiance is finite and that no receiver tells from a point. */
static const double NARROWEST = 1e-3;

typedef struct pilot {
    size_t count;
    lmg_vec3 *origin, *direction;
    double *flux;      /* luminance */
    uint8_t *half, *class;
    float (*jitter)[4];
    double *x, *w; /* scratch */
    double total;
    lmg_vec3 lo, hi;             /* the layout's bounds */
    lmg_vec3 light_lo, light_hi; /* holds 99 % of the light's origins */
    double size;                 /* of the luminous opening, for the planes */
} pilot;

/* Right-handed frame of a direction class: n along the axis, a and b the next two, b reversed for negative n so that a x b = n. */
static void class_frame(int c, lmg_vec3 *a, lmg_vec3 *b, lmg_vec3 *n)
{
    static const lmg_vec3 unit[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, minus[3] = {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
    int axis = c / 2;
    *n = c % 2 ? minus[axis] : unit[axis];
    *a = unit[(axis + 1) % 3];
    *b = c % 2 ? minus[(axis + 2) % 3] : unit[(axis + 2) % 3];
}

static const char *class_name(int c)
{
    static const char *const names[6] = {"+x", "-x", "+y", "-y", "+z", "-z"};
    return names[c];
}

/* ----------------------------------------------------------------------------------------------------------- statistics */

/* The value below which a share `tail` of the weight lies: bins between least and most, then finer bins in the one that holds it, until
 * the interval is a 2^-40th.  Several times faster than sorting. */
static double quantile(const double *x, const double *w, size_t n, double tail, double least, double most)
{
    enum { STEPS = 256 };
    double total = 0, below = 0, lo = least, hi = most;
    for (size_t i = 0; i < n; i++)
        total += w[i];
    for (int round = 0; round < 5 && hi > lo; round++) {
        double bins[STEPS] = {0}, scale = STEPS / (hi - lo);
        for (size_t i = 0; i < n; i++)
            if (x[i] >= lo && x[i] <= hi) {
                int k = (int)((x[i] - lo) * scale);
                bins[k < STEPS ? k : STEPS - 1] += w[i];
            }
        int k = 0;
        while (k + 1 < STEPS && below + bins[k] <= tail * total)
            below += bins[k++];
        double step = (hi - lo) / STEPS;
        hi = k + 1 == STEPS ? hi : lo + (k + 1) * step;
        lo = lo + k * step;
        /* the first bin of the next round starts where this one does: what is below stays counted */
    }
    return 0.5 * (lo + hi);
}

/* The interval of x that leaves out a share `tail` of the weight at either end, and the outermost values. */
typedef struct interval {
    double lo, hi, least, most;
} interval;

static interval quantiles(const double *x, const double *w, size_t n, double tail)
{
    interval r = {0, 0, INFINITY, -INFINITY};
    for (size_t i = 0; i < n; i++) {
        r.least = fmin(r.least, x[i]);
        r.most = fmax(r.most, x[i]);
    }
    r.lo = quantile(x, w, n, tail, r.least, r.most);
    r.hi = quantile(x, w, n, 1 - tail, r.least, r.most);
    return r;
}

/* Rays of half A's and half B's planes. */
typedef struct planes {
    lmg_vec3 a, b, n;
    double start;              /* along n: where the light's box ends */
    double ca, cb;             /* centre */
    double reach[PLANES], half[PLANES];
    double cross;              /* mean over planes of sum(A B): what errors are relative to */
    double energy[PLANES];
    int16_t (*pixel)[PLANES];  /* of each ray as it is; -1 outside */
    float (*change)[2][PIXELS * PIXELS];
    float (*variance)[2][PIXELS * PIXELS]; /* of change */
} planes;

static int pixel_of(const planes *p, int k, lmg_vec3 o, lmg_vec3 d)
{
    double dn = v_dot(d, p->n);
    if (!(dn > 0))
        return -1;
    double t = (p->start + p->reach[k] - v_dot(o, p->n)) / dn, scale = PIXELS / (2 * p->half[k]);
    double x = (v_dot(o, p->a) + t * v_dot(d, p->a) - p->ca + p->half[k]) * scale;
    double y = (v_dot(o, p->b) + t * v_dot(d, p->b) - p->cb + p->half[k]) * scale;
    return x >= 0 && x < PIXELS && y >= 0 && y < PIXELS ? (int)y * PIXELS + (int)x : -1;
}

static bool planes_create(planes *p, const pilot *pl, int c)
{
    *p = (planes){0};
    class_frame(c, &p->a, &p->b, &p->n);
    lmg_vec3 mid = v_scale(0.5, v_add(pl->light_lo, pl->light_hi)), half = v_scale(0.5, v_sub(pl->light_hi, pl->light_lo));
    p->start = v_dot(mid, p->n) + fabs(v_dot(half, p->n));
    p->ca = v_dot(mid, p->a);
    p->cb = v_dot(mid, p->b);
    p->pixel = malloc(pl->count * sizeof *p->pixel);
    p->change = malloc(PLANES * sizeof *p->change);
    p->variance = malloc(PLANES * sizeof *p->variance);
    if (!p->pixel || !p->change || !p->variance)
        return false;
    memset(p->change, 0, PLANES * sizeof *p->change);
    for (int k = 0; k < PLANES; k++) {
        p->reach[k] = PLANE_DISTANCE[k] * pl->size;
        p->half[k] = (PLANE_DISTANCE[k] + 0.5) * pl->size;
        for (size_t i = 0; i < pl->count; i++) {
            int px = pixel_of(p, k, pl->origin[i], pl->direction[i]);
            p->pixel[i][k] = (int16_t)px;
            if (px >= 0)
                p->change[k][pl->half[i]][px] += (float)pl->flux[i];
        }
        for (int i = 0; i < PIXELS * PIXELS; i++)
            p->energy[k] += (double)p->change[k][0][i] * (double)p->change[k][1][i];
    }
    return true;
}

static void planes_destroy(planes *p)
{
    free(p->pixel);
    free(p->change);
    free(p->variance);
}

/* A squared relative error, with the standard error of its estimate. */
typedef struct verdict {
    double error, se;
} verdict;

static bool better(verdict x, verdict than, double gain)
{
    return x.error < than.error * gain && than.error - x.error > 3 * fmax(x.se, than.se);
}

/* Mean squared relative error of illuminance over the planes that the slabs' cells cause; class >= 0: by rays of that class only (but
 * relative to all light on the planes). */
static verdict measure(const pilot *pl, planes *p, const lmg_slab *slabs, uint32_t slab_count, int class)
{
    memset(p->change, 0, PLANES * sizeof *p->change);
    memset(p->variance, 0, PLANES * sizeof *p->variance);
    double scale[LMG_MAX_SLABS][4];
    for (uint32_t j = 0; j < slab_count; j++) {
        const lmg_slab *s = &slabs[j];
        scale[j][0] = s->nu / (s->u1 - s->u0);
        scale[j][1] = s->nv / (s->v1 - s->v0);
        scale[j][2] = s->ns / (s->s1 - s->s0);
        scale[j][3] = s->nt / (s->t1 - s->t0);
    }
    for (size_t i = 0; i < pl->count; i++) {
        if (class >= 0 && pl->class[i] != class)
            continue;
        double x[4];
        for (uint32_t j = 0; j < slab_count; j++) {
            const lmg_slab *s = &slabs[j];
            if (!lmg_slab_coordinates(s, pl->origin[i], pl->direction[i], x))
                continue;
            const double low[4] = {s->u0, s->v0, s->s0, s->t0};
            for (int k = 0; k < 4; k++)
                x[k] = low[k] + (floor((x[k] - low[k]) * scale[j][k]) + (double)pl->jitter[i][k]) / scale[j][k];
            lmg_vec3 o, d;
            lmg_slab_ray(s, x, &o, &d);
            for (int k = 0; k < PLANES; k++) {
                int before = p->pixel[i][k], after = pixel_of(p, k, o, d);
                if (before == after)
                    continue;
                float w = (float)pl->flux[i];
                if (before >= 0) {
                    p->change[k][pl->half[i]][before] -= w;
                    p->variance[k][pl->half[i]][before] += w * w;
                }
                if (after >= 0) {
                    p->change[k][pl->half[i]][after] += w;
                    p->variance[k][pl->half[i]][after] += w * w;
                }
            }
            break;
        }
    }
    /* Independent a, b of one mean m and variances va, vb: Var[a b] = va vb + m^2 (va + vb), with m^2 estimated by a b. */
    double sum = 0, variance = 0;
    int used = 0;
    for (int k = 0; k < PLANES; k++) {
        if (!(p->energy[k] > 0))
            continue;
        for (int i = 0; i < PIXELS * PIXELS; i++) {
            double e = (double)p->change[k][0][i] * (double)p->change[k][1][i];
            double va = (double)p->variance[k][0][i], vb = (double)p->variance[k][1][i];
            sum += e / p->energy[k];
            variance += (va * vb + fmax(e, 0) * (va + vb)) / (p->energy[k] * p->energy[k]);
        }
        used++;
    }
    return used ? (verdict){fmax(sum / used, GOOD_ENOUGH), sqrt(variance) / used} : (verdict){GOOD_ENOUGH, 0};
}

/* -------------------------------------------------------------------------------------------------------------- slabs */

/* What the search decides for one direction. */
typedef struct choice {
    lmg_slab_kind kind;
    int class;
    double distance;
    double depth;          /* of the (u,v) plane along n, metres in the luminaire frame */
    double rect[4];        /* u0 u1 v0 v1 about the frame's origin */
    bool window;
    double st[4];          /* window's s0 s1 t0 t1, before alignment */
    double share;          /* of the cells, for the window */
    double bias, window_bias; /* cells of (u,v) over cells of (s,t), as a factor on each side of the square root */
    double cells;
    double flux;           /* in the rectangle, in units of the pilot */
    double spread;         /* area of the rectangle that the light would need, were it not kept within the bounds */
    const uint32_t *fixed; /* resolution asked for; NULL or zeros: chosen */
} choice;

static uint32_t whole(double x)
{
    return (uint32_t)d_clamp(floor(x + 0.5), 1, 65535);
}

/* Cells of a rectangle of sides w, h cut in about n nearly square cells. */
static void cut(double n, double w, double h, uint32_t *nw, uint32_t *nh)
{
    *nw = whole(sqrt(n * w / h));
    *nh = whole(n / *nw);
}

/* The frame of a choice's slabs, at its depth. */
static lmg_slab frame_of(const pilot *pl, const choice *c)
{
    lmg_slab s = {.kind = c->kind, .distance = c->kind == LMG_SLAB_CUBE ? c->distance : (double)INFINITY, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
    class_frame(c->class, &s.a, &s.b, &s.n);
    lmg_vec3 mid = v_scale(0.5, v_add(pl->lo, pl->hi));
    s.o = v_fma(mid, c->depth - v_dot(mid, s.n), s.n);
    return s;
}

/* The slabs of a choice: the window, if any, before the main slab.  Returns their number. */
static uint32_t build(const pilot *pl, const choice *c, lmg_slab out[2])
{
    lmg_slab main = frame_of(pl, c);
    main.u0 = c->rect[0];
    main.u1 = c->rect[1];
    main.v0 = c->rect[2];
    main.v1 = c->rect[3];
    if (main.kind == LMG_SLAB_CUBE && isfinite(main.distance)) {
        main.s0 = main.u0 - main.distance;
        main.s1 = main.u1 + main.distance;
        main.t0 = main.v0 - main.distance;
        main.t1 = main.v1 + main.distance;
    }
    double w = main.u1 - main.u0, h = main.v1 - main.v0;
    double cells = c->window ? c->cells * (1 - c->share) : c->cells;
    cut(sqrt(cells) * c->bias, w, h, &main.nu, &main.nv);
    cut(cells / ((double)main.nu * main.nv), main.s1 - main.s0, main.t1 - main.t0, &main.ns, &main.nt);
    if (c->fixed) {
        main.nu = c->fixed[0] ? c->fixed[0] : main.nu;
        main.nv = c->fixed[1] ? c->fixed[1] : main.nv;
        main.ns = c->fixed[2] ? c->fixed[2] : main.ns;
        main.nt = c->fixed[3] ? c->fixed[3] : main.nt;
    }
    if (!c->window) {
        out[0] = main;
        return 1;
    }
    /* The window's borders are borders of the main slab's cells, so that no cell of that is partly covered: among resolutions about the wanted
     * one, that whose borders lie closest around the beam. */
    lmg_slab window = main;
    for (int axis = 0; axis < 2; axis++) {
        double lo = c->st[2 * axis], hi = c->st[2 * axis + 1], best = INFINITY;
        uint32_t wanted = axis ? main.nt : main.ns, first = wanted > 8 ? wanted - wanted / 5 : wanted, n = first;
        for (uint32_t m = first; m <= wanted + wanted / 8; m++) {
            double step = 2.0 / m, i0 = floor((lo + 1) / step + 1e-9), i1 = ceil((hi + 1) / step - 1e-9);
            /* a slight preference for more cells: the width saved counts as much as the cells lost */
            double score = (i1 - i0) * step / (hi - lo) * sqrt((double)wanted / m);
            if (score < best) {
                best = score;
                n = m;
            }
        }
        double step = 2.0 / n;
        uint32_t i0 = (uint32_t)floor((lo + 1) / step + 1e-9), i1 = (uint32_t)ceil((hi + 1) / step - 1e-9);
        double from = i0 == 0 ? -1 : -1 + i0 * step, to = i1 >= n ? 1 : -1 + i1 * step;
        if (axis) {
            main.nt = n;
            window.t0 = from;
            window.t1 = to;
        } else {
            main.ns = n;
            window.s0 = from;
            window.s1 = to;
        }
    }
    cells = c->cells * c->share;
    cut(sqrt(cells) * c->window_bias, w, h, &window.nu, &window.nv);
    cut(cells / ((double)window.nu * window.nv), window.s1 - window.s0, window.t1 - window.t0, &window.ns, &window.nt);
    out[0] = window;
    out[1] = main;
    return 2;
}

static verdict judge(const pilot *pl, planes *p, const choice *c)
{
    lmg_slab slabs[2];
    uint32_t n = build(pl, c, slabs);
    return measure(pl, p, slabs, n, c->kind == LMG_SLAB_CUBE ? c->class : -1);
}

/* Whether a ray is one that the choice's slab is for. */
static bool belongs(const pilot *pl, size_t i, const choice *c, lmg_vec3 n)
{
    return c->kind == LMG_SLAB_CUBE ? pl->class[i] == c->class : v_dot(pl->direction[i], n) > 0;
}

/* Fits the (u,v) rectangle at the choice's depth; false when there is no light. */
static bool fit_rectangle(const pilot *pl, choice *c)
{
    lmg_slab s = frame_of(pl, c);
    lmg_vec3 half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    double limit[2] = {fabs(v_dot(half, s.a)), fabs(v_dot(half, s.b))};
    const double far = 1e3 * v_length(half); /* grazing rays cross anywhere, up to infinity */
    c->spread = 1;
    for (int axis = 0; axis < 2; axis++) {
        size_t n = 0;
        for (size_t i = 0; i < pl->count; i++) {
            double u, v, dn = v_dot(pl->direction[i], s.n);
            if (!belongs(pl, i, c, s.n))
                continue;
            lmg_slab_crossing(&s, pl->origin[i], pl->direction[i], dn, &u, &v);
            pl->x[n] = d_clamp(axis ? v : u, -far, far);
            pl->w[n++] = pl->flux[i];
        }
        if (!n)
            return false;
        interval q = quantiles(pl->x, pl->w, n, RECTANGLE_TAIL);
        /* An opening with an edge: the outermost of all rays is where its edge is, and is taken.  Light that thins out: the quantile. */
        double width = q.hi - q.lo;
        double lo = q.least >= q.lo - 0.02 * width ? q.least : q.lo, hi = q.most <= q.hi + 0.02 * width ? q.most : q.hi;
        /* Margin: what n rays leave undiscovered of a sharp edge, a few n-ths of the width; never less than the bounds' rounding. */
        double margin = 4.0 / (double)n * (hi - lo) + 1e-7 * v_length(half);
        margin = fmax(margin, 0.5 * (NARROWEST * pl->size - (hi - lo)));
        lo -= margin;
        hi += margin;
        c->spread *= hi - lo;
        if (c->kind == LMG_SLAB_APERTURE) {
            /* the opening is within the bounds; every line through it then comes out of them, see etendue.c */
            lo = fmax(lo, -limit[axis]);
            hi = fmin(hi, limit[axis]);
        }
        if (!(hi > lo))
            return false;
        c->rect[2 * axis] = lo;
        c->rect[2 * axis + 1] = hi;
    }
    c->flux = 0;
    for (size_t i = 0; i < pl->count; i++) {
        double u, v, dn = v_dot(pl->direction[i], s.n);
        if (!belongs(pl, i, c, s.n))
            continue;
        lmg_slab_crossing(&s, pl->origin[i], pl->direction[i], dn, &u, &v);
        if (u >= c->rect[0] && u < c->rect[1] && v >= c->rect[2] && v < c->rect[3])
            c->flux += pl->flux[i];
    }
    return true;
}

/* What a choice costs: its measure, and the flux beside its rectangle as if that were all wrong. */
static verdict cost(const pilot *pl, planes *p, choice *c, double wanted_flux)
{
    if (!fit_rectangle(pl, c))
        return (verdict){INFINITY, 0};
    double beside = fmax(wanted_flux - c->flux, 0) / pl->total;
    verdict v = judge(pl, p, c);
    v.error += beside * beside;
    return v;
}

/* Depth of the (u,v) plane between lo and hi.  First where the light is narrowest, least area of the rectangle; then wherever else the
 * cells do clearly less harm. */
static void search_depth(const pilot *pl, planes *p, choice *c, double wanted_flux, double lo, double hi, int steps)
{
    double least = INFINITY, at = 0.5 * (lo + hi);
    double step = (hi - lo) / steps;
    for (int k = 0; k <= steps; k++) {
        c->depth = lo + step * k;
        double area = fit_rectangle(pl, c) ? c->spread : (double)INFINITY;
        if (area < least) {
            least = area;
            at = c->depth;
        }
    }
    for (int round = 0; round < 6; round++) {
        step *= 0.5;
        double centre = at;
        for (int side = -1; side <= 1; side += 2) {
            c->depth = d_clamp(centre + side * step, lo, hi);
            double area = fit_rectangle(pl, c) ? c->spread : (double)INFINITY;
            if (area < least) {
                least = area;
                at = c->depth;
            }
        }
    }
    c->depth = at;
    verdict best = cost(pl, p, c, wanted_flux);
    step = (hi - lo) / steps;
    for (int round = 0; round < 3; round++, step *= 0.3) {
        double centre = at;
        for (int k = round ? -1 : 0; k <= (round ? 1 : steps); k++) {
            c->depth = round ? d_clamp(centre + k * step, lo, hi) : lo + step * k;
            verdict e = cost(pl, p, c, wanted_flux);
            if (better(e, best, GAIN)) {
                best = e;
                at = c->depth;
            }
        }
    }
    c->depth = at;
    fit_rectangle(pl, c);
}

/* Nested rectangles in (s,t) around the densest light: the emptiest border strip of a histogram is taken off again and again; wherever
 * the area has halved, a rectangle is kept.  A rectangle grown small is looked at in a finer histogram. */
enum { MAX_NESTED = 24, BINS = 64 };
static int nested(const pilot *pl, const choice *c, double out[MAX_NESTED][4], double flux[MAX_NESTED])
{
    lmg_slab s = frame_of(pl, c);
    static const int AREA_PER_LEVEL = 16;
    double r[4] = {-1, 1, -1, 1}, total = 0;
    double *histogram = malloc(BINS * BINS * sizeof *histogram);
    int count = 0;
    for (int level = 0; histogram && level < 4; level++) {
        memset(histogram, 0, BINS * BINS * sizeof *histogram);
        double inside = 0;
        for (size_t i = 0; i < pl->count; i++) {
            if (!belongs(pl, i, c, s.n))
                continue;
            double a, b;
            lmg_slab_st(&s, pl->direction[i], v_dot(pl->direction[i], s.n), 0, 0, &a, &b);
            int x = (int)floor((a - r[0]) / (r[1] - r[0]) * BINS), y = (int)floor((b - r[2]) / (r[3] - r[2]) * BINS);
            if (x >= 0 && x < BINS && y >= 0 && y < BINS) {
                histogram[y * BINS + x] += pl->flux[i];
                inside += pl->flux[i];
            }
        }
        if (level == 0)
            total = inside;
        /* a window that holds little of the light isn't worth its cells */
        if (inside < 0.2 * total)
            break;
        int x0 = 0, x1 = BINS, y0 = 0, y1 = BINS, kept = BINS * BINS;
        while ((x1 - x0) * (y1 - y0) * AREA_PER_LEVEL > BINS * BINS && x1 - x0 > 4 && y1 - y0 > 4) {
            double side[4] = {0};
            for (int y = y0; y < y1; y++) {
                side[0] += histogram[y * BINS + x0];
                side[1] += histogram[y * BINS + x1 - 1];
            }
            for (int x = x0; x < x1; x++) {
                side[2] += histogram[y0 * BINS + x];
                side[3] += histogram[(y1 - 1) * BINS + x];
            }
            int least = 0;
            for (int k = 0; k < 4; k++) {
                /* by density; of about equals that of the longer direction, so that the rectangle doesn't turn into a stripe */
                double strip = k < 2 ? y1 - y0 : x1 - x0, across = k < 2 ? x1 - x0 : y1 - y0;
                side[k] /= strip * across * across;
                least = side[k] < side[least] ? k : least;
            }
            x0 += least == 0;
            x1 -= least == 1;
            y0 += least == 2;
            y1 -= least == 3;
            if ((x1 - x0) * (y1 - y0) * 2 <= kept && count < MAX_NESTED) {
                kept = (x1 - x0) * (y1 - y0);
                flux[count] = 0;
                for (int y = y0; y < y1; y++)
                    for (int x = x0; x < x1; x++)
                        flux[count] += histogram[y * BINS + x] / total;
                double *o = out[count++];
                o[0] = r[0] + (r[1] - r[0]) * x0 / BINS;
                o[1] = r[0] + (r[1] - r[0]) * x1 / BINS;
                o[2] = r[2] + (r[3] - r[2]) * y0 / BINS;
                o[3] = r[2] + (r[3] - r[2]) * y1 / BINS;
            }
        }
        double next[4] = {r[0] + (r[1] - r[0]) * x0 / BINS, r[0] + (r[1] - r[0]) * x1 / BINS, r[2] + (r[3] - r[2]) * y0 / BINS,
                          r[2] + (r[3] - r[2]) * y1 / BINS};
        memcpy(r, next, sizeof r);
    }
    free(histogram);
    return count;
}

/* Window or none, then how the cells are shared out. */
static verdict search_cells(const pilot *pl, planes *p, choice *c, verdict best)
{
    bool may_window = !(c->fixed && (c->fixed[2] || c->fixed[3])) && (c->kind == LMG_SLAB_APERTURE || isinf(c->distance));
    if (may_window) {
        /*
         * Which window: by a model, because the measure's noise hides small differences.  A slab's part in the error goes with its flux
         * and with the fourth root of its cells' etendue; the measure has a veto.
         */
        double rects[MAX_NESTED][4], shares_of_flux[MAX_NESTED];
        int n = nested(pl, c, rects, shares_of_flux);
        choice kept = *c;
        double least = WINDOW_WORTH;
        for (int k = 0; k < n; k++) {
            choice t = *c;
            t.window = true;
            t.share = 0.6;
            memcpy(t.st, rects[k], sizeof t.st);
            double part = 0.25 * (rects[k][1] - rects[k][0]) * (rects[k][3] - rects[k][2]), phi = shares_of_flux[k];
            double model = phi * pow(part / t.share, 0.25) + (1 - phi) * pow(1 / (1 - t.share), 0.25);
            if (model >= least)
                continue;
            verdict e = judge(pl, p, &t);
            if (better(best, e, 1) || (kept.window && best.error < e.error - 2 * e.se))
                continue;
            least = model;
            best = e;
            kept = t;
        }
        *c = kept;
    }
    static const double biases[] = {0.25, 0.5, 2, 4}, shares[] = {0.35, 0.5, 0.75, 0.87};
    for (int round = 0; round < 2; round++) {
        choice kept = *c;
        for (int k = 0; k < 4; k++) {
            choice t = kept;
            t.bias = c->bias * biases[k];
            verdict e = judge(pl, p, &t);
            if (t.bias > 0.05 && t.bias < 20 && better(e, best, GAIN)) {
                best = e;
                *c = t;
            }
        }
        if (!c->window)
            break;
        kept = *c;
        for (int k = 0; k < 4; k++) {
            choice t = kept;
            t.window_bias = kept.window_bias * biases[k];
            verdict e = judge(pl, p, &t);
            if (t.window_bias > 0.05 && t.window_bias < 20 && better(e, best, GAIN)) {
                best = e;
                *c = t;
            }
        }
        kept = *c;
        for (int k = 0; k < 4; k++) {
            choice t = kept;
            t.share = shares[k];
            verdict e = judge(pl, p, &t);
            if (better(e, best, GAIN)) {
                best = e;
                *c = t;
            }
        }
    }
    return best;
}

/* Everything about one direction. */
static verdict search(const pilot *pl, planes *p, choice *c)
{
    lmg_vec3 a, b, n, mid = v_scale(0.5, v_add(pl->lo, pl->hi)), half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    class_frame(c->class, &a, &b, &n);
    double wanted = 0, centre = v_dot(mid, n), depth = fabs(v_dot(half, n));
    for (size_t i = 0; i < pl->count; i++)
        wanted += belongs(pl, i, c, n) ? pl->flux[i] : 0;
    search_depth(pl, p, c, wanted, centre - depth, centre + depth, 16);
    verdict best = search_cells(pl, p, c, judge(pl, p, c));
    if (c->window) {
        /* the window has changed what counts: look at the depth once more */
        choice t = *c;
        search_depth(pl, p, &t, wanted, centre - depth, centre + depth, 12);
        verdict e = judge(pl, p, &t);
        if (better(e, best, GAIN)) {
            *c = t;
            best = e;
        }
    }
    return best;
}

/* A cube slab through the middle of the bounds that holds every line of its class through the bounds. */
static lmg_slab catch_all(int c, lmg_vec3 lo, lmg_vec3 hi, uint32_t resolution)
{
    lmg_slab s = {.kind = LMG_SLAB_CUBE, .distance = INFINITY, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
    class_frame(c, &s.a, &s.b, &s.n);
    s.o = v_scale(0.5, v_add(lo, hi));
    lmg_vec3 half = v_scale(0.5, v_sub(hi, lo));
    /* at slopes up to 1 a line strays from where it is in the bounds by at most half their depth */
    double depth = fabs(v_dot(half, s.n)), margin = 1e-6 * v_length(half);
    s.u1 = fabs(v_dot(half, s.a)) + depth + margin;
    s.v1 = fabs(v_dot(half, s.b)) + depth + margin;
    s.u0 = -s.u1;
    s.v0 = -s.v1;
    s.nu = s.nv = s.ns = s.nt = resolution;
    return s;
}

/* ------------------------------------------------------------------------------------------------------------- the fit */

static void pilot_destroy(pilot *pl)
{
    free(pl->origin);
    free(pl->direction);
    free(pl->flux);
    free(pl->half);
    free(pl->class);
    free(pl->jitter);
    free(pl->x);
    free(pl->w);
}

static double uniform(uint64_t i)
{
    uint64_t z = (i + 1) * 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

static bool usable(const lmg_ray *r)
{
    double y = lmg_luminance(r->flux);
    return y > 0 && isfinite(y) && v_finite(r->origin) && v_finite(r->direction) && lmg_direction_class(r->direction) >= 0;
}

static lmg_result pilot_create(pilot *pl, const lmg_ray *rays, size_t count, lmg_error *err)
{
    size_t good = 0, parity[2] = {0};
    for (size_t i = 0; i < count; i++)
        if (usable(&rays[i])) {
            good++;
            parity[rays[i].number & 1]++;
        }
    if (!good)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: none of the %zu pilot rays carries light", count);
    /* an odd stride keeps both halves; if all numbers are of one parity, the halves are every other ray */
    size_t stride = good / SEARCH_RAYS;
    stride += stride % 2 == 0;
    bool by_number = parity[0] && parity[1];
    size_t room = good / stride + 1;
    pl->origin = malloc(room * sizeof *pl->origin);
    pl->direction = malloc(room * sizeof *pl->direction);
    pl->flux = malloc(room * sizeof *pl->flux);
    pl->half = malloc(room);
    pl->class = malloc(room);
    pl->jitter = malloc(room * sizeof *pl->jitter);
    pl->x = malloc(room * sizeof *pl->x);
    pl->w = malloc(room * sizeof *pl->w);
    if (!pl->origin || !pl->direction || !pl->flux || !pl->half || !pl->class || !pl->jitter || !pl->x || !pl->w)
        return lmg_fail(err, LMG_ERROR_MEMORY, "layout: no memory for %zu pilot rays", room);
    for (size_t i = 0, k = 0; i < count; i++) {
        if (!usable(&rays[i]) || k++ % stride)
            continue;
        size_t m = pl->count++;
        pl->origin[m] = rays[i].origin;
        pl->direction[m] = v_scale(1 / v_length(rays[i].direction), rays[i].direction);
        pl->flux[m] = lmg_luminance(rays[i].flux);
        pl->class[m] = (uint8_t)lmg_direction_class(rays[i].direction);
        pl->half[m] = (uint8_t)((by_number ? rays[i].number : m) & 1);
        for (uint64_t c = 0; c < 4; c++)
            pl->jitter[m][c] = (float)uniform(4 * m + c);
        pl->total += pl->flux[m];
    }
    /* the light's own box: 99 % of the origins, within the bounds */
    double lo[3], hi[3];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < pl->count; i++) {
            pl->x[i] = d_clamp(v_axis(pl->origin[i], axis), v_axis(pl->lo, axis), v_axis(pl->hi, axis));
            pl->w[i] = pl->flux[i];
        }
        interval q = quantiles(pl->x, pl->w, pl->count, 0.005);
        lo[axis] = q.lo;
        hi[axis] = q.hi;
    }
    pl->light_lo = (lmg_vec3){lo[0], lo[1], lo[2]};
    pl->light_hi = (lmg_vec3){hi[0], hi[1], hi[2]};
    return LMG_OK;
}

/* One colour for all rays?  colour: that of the sum, at luminance 1.  Float rounding of a product: a few 2^-24. */
static bool one_colour(const lmg_ray *rays, size_t count, float colour[3])
{
    double sum[3] = {0};
    for (size_t i = 0; i < count; i++)
        for (int c = 0; c < 3 && usable(&rays[i]); c++)
            sum[c] += (double)rays[i].flux[c];
    double y = 0.2126 * sum[0] + 0.7152 * sum[1] + 0.0722 * sum[2];
    for (int c = 0; c < 3; c++)
        colour[c] = (float)(sum[c] / y);
    for (size_t i = 0; i < count; i++) {
        double yi = lmg_luminance(rays[i].flux);
        for (int c = 0; c < 3 && usable(&rays[i]); c++)
            if (fabs((double)rays[i].flux[c] - yi * sum[c] / y) > 1e-6 * yi)
                return false;
    }
    return true;
}

static void say(char *report, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 2, 3)))
#endif
    ;

#include <stdarg.h>

static void say(char *report, const char *format, ...)
{
    if (!report)
        return;
    size_t used = strlen(report);
    va_list args;
    va_start(args, format);
    vsnprintf(report + used, 1024 - used, format, args);
    va_end(args);
}

static void describe(char *report, const pilot *pl, const choice *c)
{
    lmg_slab s[2];
    uint32_t n = build(pl, c, s);
    say(report, "%s: (u,v) %.4g x %.4g m at %.4g m, %u x %u x %u x %u cells", class_name(c->class), s[0].u1 - s[0].u0, s[0].v1 - s[0].v0,
        c->depth, s[n - 1].nu, s[n - 1].nv, s[n - 1].ns, s[n - 1].nt);
    if (n == 2)
        say(report, "; beam window s %.3g..%.3g t %.3g..%.3g, %u x %u x %u x %u", s[0].s0, s[0].s1, s[0].t0, s[0].t1, s[0].nu, s[0].nv, s[0].ns,
            s[0].nt);
    say(report, "\n");
}

lmg_result lmg_layout_fit(const lmg_ray *rays, size_t count, const lmg_fit_options *options, lmg_layout *out, char report[1024],
                          lmg_error *err)
{
    if (report)
        report[0] = 0;
    if (!options || !out)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: no options or no place for the result");
    *out = (lmg_layout){0};
    if (options->struct_size != sizeof *options)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: struct_size is %zu, this library's is %zu", options->struct_size, sizeof *options);
    if (!rays || !count)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: no pilot rays to fit to");
    lmg_vec3 lo = options->bounds_min, hi = options->bounds_max;
    double diagonal = v_length(v_sub(hi, lo));
    if (!v_finite(lo) || !v_finite(hi) || !(lo.x <= hi.x && lo.y <= hi.y && lo.z <= hi.z) || !(diagonal > 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the bounds [%g %g %g] to [%g %g %g] m are empty", lo.x, lo.y, lo.z, hi.x, hi.y, hi.z);
    if ((unsigned)options->choice > LMG_LAYOUT_APERTURE)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: unknown choice %d", (int)options->choice);
    if (options->channels != 0 && options->channels != 1 && options->channels != 3)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %u channels; 1 or 3 are possible", options->channels);
    if (!(options->distance >= 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: the distance %g m must be positive", options->distance);
    double cells = options->cells ? (double)options->cells : (double)DEFAULT_CELLS;
    if (cells > 0x1p32)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %.3g cells; 2^32 are possible", cells);
    for (int k = 0; k < 4; k++)
        if (options->resolution[k] > 65535)
            return lmg_fail(err, LMG_ERROR_ARGUMENT, "layout: %u cells along %c; 65535 are possible", options->resolution[k], "uvst"[k]);

    /* Flat bounds (a bare disc) get a thickness, so that lines in their plane have a way out and rounding doesn't put rays beside them. */
    double pad = 1e-6 * diagonal;
    pilot pl = {.lo = v_sub(lo, (lmg_vec3){pad, pad, pad}), .hi = v_add(hi, (lmg_vec3){pad, pad, pad})};
    planes six[6] = {0};
    lmg_result r = pilot_create(&pl, rays, count, err);
    if (r != LMG_OK) {
        pilot_destroy(&pl);
        return r;
    }
    float colour[3];
    bool grey = one_colour(rays, count, colour);
    out->channels = options->channels ? options->channels : grey ? 1 : 3;
    memcpy(out->colour, colour, sizeof colour);
    out->bounds_min = pl.lo;
    out->bounds_max = pl.hi;

    /* the axis that most light goes along, and how much goes the other way */
    double along[6] = {0}, forward[6] = {0}, class_flux[6] = {0};
    for (size_t i = 0; i < pl.count; i++) {
        class_flux[pl.class[i]] += pl.flux[i];
        for (int c = 0; c < 6; c++) {
            double dn = v_axis(pl.direction[i], c / 2) * (c % 2 ? -1 : 1);
            if (dn > 0) {
                along[c] += dn * pl.flux[i];
                forward[c] += pl.flux[i];
            }
        }
    }
    int main_class = 0;
    for (int c = 1; c < 6; c++)
        if (along[c] > along[main_class])
            main_class = c;

    /* size: provisional for the planes; the largest face of the light's box */
    lmg_vec3 extent = v_sub(pl.light_hi, pl.light_lo);
    double xy = hypot(extent.x, extent.y), yz = hypot(extent.y, extent.z), zx = hypot(extent.z, extent.x);
    double cube_size = fmax(fmax(xy, yz), fmax(zx, 1e-6 * diagonal)), aperture_size = main_class / 2 == 0 ? yz : main_class / 2 == 1 ? zx : xy;
    aperture_size = fmax(aperture_size, 1e-6 * diagonal);
    bool try_aperture = options->choice == LMG_LAYOUT_APERTURE ||
                        (options->choice == LMG_LAYOUT_AUTO && forward[main_class] >= (1 - APERTURE_REST) * pl.total);
    bool try_cube = options->choice != LMG_LAYOUT_APERTURE;
    pl.size = try_aperture ? aperture_size : cube_size;

    const bool fixed = options->resolution[0] || options->resolution[1] || options->resolution[2] || options->resolution[3];
    choice plain = {.distance = options->distance > 0 ? options->distance : (double)INFINITY, .bias = 1, .window_bias = 1, .cells = cells,
                    .fixed = fixed ? options->resolution : NULL};
    for (int c = 0; c < 6; c++)
        if (!planes_create(&six[c], &pl, c)) {
            r = lmg_fail(err, LMG_ERROR_MEMORY, "layout: no memory");
            goto cleanup;
        }

    choice aperture = plain;
    aperture.kind = LMG_SLAB_APERTURE;
    aperture.class = main_class;
    verdict aperture_error = {INFINITY, 0}, cube_error = {INFINITY, 0};
    if (try_aperture)
        aperture_error = search(&pl, &six[main_class], &aperture);
    double through = try_aperture ? aperture.flux / pl.total : 0;

    choice cube[6];
    if (try_cube) {
        /* Cells to each face: the error of a face falls like its cells^(-1/4), so that the sum of flux x error is least for cells in
         * proportion to flux^(4/5). */
        double sum = 0;
        for (int c = 0; c < 6; c++)
            sum += pow(class_flux[c] / pl.total, 0.8);
        for (int c = 0; c < 6; c++) {
            cube[c] = plain;
            cube[c].kind = LMG_SLAB_CUBE;
            cube[c].class = c;
            cube[c].cells = fmax(cells * pow(class_flux[c] / pl.total, 0.8) / sum, 1);
            if (class_flux[c] > 0)
                search(&pl, &six[c], &cube[c]);
        }
        /* judged where an opening would be judged */
        if (try_aperture) {
            lmg_slab slabs[12];
            uint32_t n = 0;
            for (int c = 0; c < 6; c++)
                if (class_flux[c] > 0)
                    n += build(&pl, &cube[c], slabs + n);
            cube_error = measure(&pl, &six[main_class], slabs, n, -1);
        }
    }
    bool use_aperture = options->choice == LMG_LAYOUT_APERTURE ||
                        (try_aperture && through >= 1 - APERTURE_REST && !better(cube_error, aperture_error, CUBE_GAIN));

    double beside[6] = {0};
    if (use_aperture) {
        out->slab_count = build(&pl, &aperture, out->slabs);
        out->size = aperture_size;
    } else {
        for (int c = 0; c < 6; c++)
            if (class_flux[c] > 0)
                out->slab_count += build(&pl, &cube[c], out->slabs + out->slab_count);
        out->size = cube_size;
    }
    /* what the slabs so far leave over, by class, decides how fine the slabs that catch it are */
    for (size_t i = 0; i < pl.count; i++) {
        double unused[4];
        if (lmg_layout_owner(out, pl.origin[i], pl.direction[i], unused) < 0)
            beside[pl.class[i]] += pl.flux[i] / pl.total;
    }
    double rest = 0;
    for (int c = 0; c < 6; c++) {
        rest += beside[c];
        out->slabs[out->slab_count++] = catch_all(c, pl.lo, pl.hi, (uint32_t)d_clamp(floor(pow(cells * beside[c], 0.25)), 6, 16));
    }
    if (use_aperture) {
        say(report, "aperture: %.2f %% of the flux passes one opening towards %s\n", 100 * through, class_name(main_class));
        describe(report, &pl, &aperture);
        if (isfinite(cube_error.error))
            say(report, "blur of illuminance at 0.5 to 5 sizes %.2f %%, as six faces %.2f %%\n", 100 * sqrt(aperture_error.error),
                100 * sqrt(cube_error.error));
    } else {
        say(report, "cube: ");
        if (try_aperture && through < 1 - APERTURE_REST)
            say(report, "only %.2f %% of the flux passes one opening towards %s\n", 100 * through, class_name(main_class));
        else if (try_aperture)
            say(report, "blur of illuminance %.2f %%, as one opening %.2f %%\n", 100 * sqrt(cube_error.error), 100 * sqrt(aperture_error.error));
        else
            say(report, "%.2f %% of the flux goes towards %s\n", 100 * forward[main_class] / pl.total, class_name(main_class));
        for (int c = 0; c < 6; c++)
            if (class_flux[c] > 0)
                describe(report, &pl, &cube[c]);
    }
    say(report, "%.3f %% of the flux goes to the coarse slabs below; %s; size %.4g m\n", 100 * rest,
        out->channels == 1 ? "one colour" : "three channels", out->size);
    r = lmg_layout_check(out, err);
cleanup:
    for (int c = 0; c < 6; c++)
        planes_destroy(&six[c]);
    pilot_destroy(&pl);
    if (r != LMG_OK)
        *out = (lmg_layout){0};
    return r;
}
