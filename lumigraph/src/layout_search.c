/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What is best for one direction: in turn where its (u,v) plane stands, which window in (s,t) holds the beam if there is one, how the cells
 * are shared out between (u,v) and (s,t) and between window and the rest.  Relies on blur.h, which judges.
 */
#include "layout_search.h"

#include "geometry.h"

#include <stdlib.h>
#include <string.h>

/* Share of the flux left out at either end of a (u,v) rectangle; the slabs below catch it. */
static const double RECTANGLE_TAIL = 5e-5;
/* Where a face's light ends is told by so many of its outermost rays, and supposed no farther out than this part of the width. */
static const double OUTERMOST = 16, UNDISCOVERED = 0.05;
/* A candidate has to be this much better than what stands, and by three standard errors: dozens are tried, and the luckiest of equals
 * mustn't win. */
static const double GAIN = 0.97;
/* A window has to promise less than this part of the error without it. */
static const double WINDOW_WORTH = 0.8;
/* Narrowest (u,v) rectangle, in sizes: light from a point gets a place whose radiance is finite and that no receiver tells from a point. */
static const double NARROWEST = 1e-3;

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
static lmg_slab frame_of(const lmg_pilot *pl, const lmg_choice *c)
{
    lmg_slab s = {.kind = c->kind, .distance = c->kind == LMG_SLAB_CUBE ? c->distance : (double)INFINITY, .s0 = -1, .s1 = 1, .t0 = -1, .t1 = 1};
    lmg_class_frame(c->class, &s.a, &s.b, &s.n);
    lmg_vec3 mid = v_scale(0.5, v_add(pl->lo, pl->hi));
    s.o = v_fma(mid, c->depth - v_dot(mid, s.n), s.n);
    return s;
}
uint32_t lmg_choice_slabs(const lmg_pilot *pl, const lmg_choice *c, lmg_slab out[2])
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

static lmg_verdict judge(const lmg_pilot *pl, lmg_planes *p, const lmg_choice *c)
{
    lmg_slab slabs[2];
    uint32_t n = lmg_choice_slabs(pl, c, slabs);
    return lmg_measure_blur(pl, p, slabs, n, c->kind == LMG_SLAB_CUBE ? c->class : -1);
}

/* Whether a ray is one that the choice's slab is for. */
static bool belongs(const lmg_pilot *pl, size_t i, const lmg_choice *c, lmg_vec3 n)
{
    return c->kind == LMG_SLAB_CUBE ? pl->class[i] == c->class : v_dot(pl->direction[i], n) > 0;
}

/*
 * How far beyond the outermost ray light may go on that the pilot didn't meet; gap: between the outermost ray and the OUTERMOST-th.  Where
 * the number of rays beyond x falls like (end - x)^k, the j-th of them is about j^(1/k) times as far from the end as the first.  At a sharp
 * edge k is 1; past a globe, where only the most slanting light goes, it is 2.5, rounded up.  Half as much again, since one ray's place is
 * chance.
 */
static double undiscovered(double gap, double width)
{
    return d_clamp(1.5 * gap / (cbrt(OUTERMOST) - 1), 0, UNDISCOVERED * width);
}

/* Fits the (u,v) rectangle at the choice's depth; false when there is no light. */
static bool fit_rectangle(const lmg_pilot *pl, lmg_choice *c)
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
        bool faces = c->kind == LMG_SLAB_CUBE;
        lmg_interval q = lmg_quantiles(pl->x, pl->w, n, RECTANGLE_TAIL), outer = faces ? lmg_quantiles(pl->x, pl->w, n, OUTERMOST / (double)n) : q;
        /* Light with an edge: the outermost of all rays is where its edge is, and is taken.  Light that thins out: the quantile. */
        double width = q.hi - q.lo, lo = q.lo, hi = q.hi;
        if (q.least >= q.lo - 0.02 * width)
            lo = q.least - (faces ? undiscovered(outer.lo - q.least, width) : 0);
        if (q.most <= q.hi + 0.02 * width)
            hi = q.most + (faces ? undiscovered(q.most - outer.hi, width) : 0);
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
static lmg_verdict cost(const lmg_pilot *pl, lmg_planes *p, lmg_choice *c, double wanted_flux)
{
    if (!fit_rectangle(pl, c))
        return (lmg_verdict){INFINITY, 0};
    double beside = fmax(wanted_flux - c->flux, 0) / pl->total;
    lmg_verdict v = judge(pl, p, c);
    v.error += beside * beside;
    return v;
}

/* Depth of the (u,v) plane between lo and hi.  First where the light is narrowest, least area of the rectangle; then wherever else the
 * cells do clearly less harm. */
static void search_depth(const lmg_pilot *pl, lmg_planes *p, lmg_choice *c, double wanted_flux, double lo, double hi, int steps)
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
    lmg_verdict best = cost(pl, p, c, wanted_flux);
    step = (hi - lo) / steps;
    for (int round = 0; round < 3; round++, step *= 0.3) {
        double centre = at;
        for (int k = round ? -1 : 0; k <= (round ? 1 : steps); k++) {
            c->depth = round ? d_clamp(centre + k * step, lo, hi) : lo + step * k;
            lmg_verdict e = cost(pl, p, c, wanted_flux);
            if (lmg_better(e, best, GAIN)) {
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
static int nested(const lmg_pilot *pl, const lmg_choice *c, double out[MAX_NESTED][4], double flux[MAX_NESTED])
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
        /* a window that holds little of the light isn't worth its cells; a beam exactly on the border of classes may leave one empty */
        if (!(inside > 0) || inside < 0.2 * total)
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
static lmg_verdict search_cells(const lmg_pilot *pl, lmg_planes *p, lmg_choice *c, lmg_verdict best)
{
    bool may_window = !(c->fixed && (c->fixed[2] || c->fixed[3])) && (c->kind == LMG_SLAB_APERTURE || isinf(c->distance));
    if (may_window) {
        /*
         * Which window: by a model, because the measure's noise hides small differences.  A slab's part in the error goes with its flux
         * and with the fourth root of its cells' etendue; the measure has a veto.
         */
        double rects[MAX_NESTED][4], shares_of_flux[MAX_NESTED];
        int n = nested(pl, c, rects, shares_of_flux);
        lmg_choice kept = *c;
        double least = WINDOW_WORTH;
        for (int k = 0; k < n; k++) {
            lmg_choice t = *c;
            t.window = true;
            t.share = 0.6;
            memcpy(t.st, rects[k], sizeof t.st);
            double part = 0.25 * (rects[k][1] - rects[k][0]) * (rects[k][3] - rects[k][2]), phi = shares_of_flux[k];
            double model = phi * pow(part / t.share, 0.25) + (1 - phi) * pow(1 / (1 - t.share), 0.25);
            if (model >= least)
                continue;
            lmg_verdict e = judge(pl, p, &t);
            if (lmg_better(best, e, 1) || (kept.window && best.error < e.error - 2 * e.se))
                continue;
            least = model;
            best = e;
            kept = t;
        }
        *c = kept;
    }
    static const double biases[] = {0.25, 0.5, 2, 4}, shares[] = {0.35, 0.5, 0.75, 0.87};
    for (int round = 0; round < 2; round++) {
        lmg_choice kept = *c;
        for (int k = 0; k < 4; k++) {
            lmg_choice t = kept;
            t.bias = c->bias * biases[k];
            lmg_verdict e = judge(pl, p, &t);
            if (t.bias > 0.05 && t.bias < 20 && lmg_better(e, best, GAIN)) {
                best = e;
                *c = t;
            }
        }
        if (!c->window)
            break;
        kept = *c;
        for (int k = 0; k < 4; k++) {
            lmg_choice t = kept;
            t.window_bias = kept.window_bias * biases[k];
            lmg_verdict e = judge(pl, p, &t);
            if (t.window_bias > 0.05 && t.window_bias < 20 && lmg_better(e, best, GAIN)) {
                best = e;
                *c = t;
            }
        }
        kept = *c;
        for (int k = 0; k < 4; k++) {
            lmg_choice t = kept;
            t.share = shares[k];
            lmg_verdict e = judge(pl, p, &t);
            if (lmg_better(e, best, GAIN)) {
                best = e;
                *c = t;
            }
        }
    }
    return best;
}
lmg_verdict lmg_choice_search(const lmg_pilot *pl, lmg_planes *p, lmg_choice *c)
{
    lmg_vec3 a, b, n, mid = v_scale(0.5, v_add(pl->lo, pl->hi)), half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    lmg_class_frame(c->class, &a, &b, &n);
    double wanted = 0, centre = v_dot(mid, n), depth = fabs(v_dot(half, n));
    for (size_t i = 0; i < pl->count; i++)
        wanted += belongs(pl, i, c, n) ? pl->flux[i] : 0;
    search_depth(pl, p, c, wanted, centre - depth, centre + depth, 16);
    lmg_verdict best = search_cells(pl, p, c, judge(pl, p, c));
    if (c->window) {
        /* the window has changed what counts: look at the depth once more */
        lmg_choice t = *c;
        search_depth(pl, p, &t, wanted, centre - depth, centre + depth, 12);
        lmg_verdict e = judge(pl, p, &t);
        if (lmg_better(e, best, GAIN)) {
            *c = t;
            best = e;
        }
    }
    return best;
}
