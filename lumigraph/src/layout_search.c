/* SPDX-License-Identifier: Apache-2.0 */
/*
 * What is best for one direction: in turn where its (u,v) plane stands, which window in (s,t) holds the beam if there is one, how
 * the cells are shared out between (u,v) and (s,t) and between window and the rest, and whether fewer of them would do better.
 * Before that, whether light comes from a small place that deserves a slab of its own.  Relies on layout_judge.h.
 */
#include "layout_search.h"

#include "geometry.h"

#include <stdlib.h>
#include <string.h>

/* Share of the flux left out at either end of a (u,v) rectangle; the slabs below catch it. */
static const double RECTANGLE_TAIL = 5e-5;
/* Where a face's light ends is told by so many of its outermost rays, and supposed no farther out than this part of the width. */
static const double OUTERMOST = 16, UNDISCOVERED = 0.05;
/* A candidate has to be this much better than what stands, and by more than chance: dozens are tried, and the luckiest of equals
 * mustn't win. */
static const double GAIN = 0.97;
/* A window has to promise less than this part of the error without it. */
static const double WINDOW_WORTH = 0.8;
/* So much more concentrated has a focus to be than the light of the whole opening: (share of flux)^2 over area. */
static const double FOCUS_WORTH = 4;
/* Fewer cells for one direction aren't tried. */
static const double FEWEST = 1000;
/* For finding where light is narrow every so many-th ray will do. */
enum { SCAN = 5 };
/* Narrowest (u,v) rectangle, in sizes: light from a point gets a place whose radiance is finite and that no receiver tells from a
 * point. */
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
    lmg_slab s = {.kind = c->kind,
                  .distance = c->kind == LMG_SLAB_CUBE ? c->distance : (double)INFINITY,
                  .s0 = -1,
                  .s1 = 1,
                  .t0 = -1,
                  .t1 = 1};
    lmg_class_frame(c->class, &s.a, &s.b, &s.n);
    lmg_vec3 mid = v_scale(0.5, v_add(pl->lo, pl->hi));
    s.o = v_fma(mid, c->depth - v_dot(mid, s.n), s.n);
    return s;
}
uint32_t lmg_choice_slabs(const lmg_pilot *pl, const lmg_choice *c, lmg_slab out[LMG_CHOICE_SLABS])
{
    uint32_t count = 0;
    if (c->focus)
        out[count++] = *c->focus;
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
        out[count++] = main;
        return count;
    }
    /* The window's borders are borders of the main slab's cells, so that no cell of that is partly covered: among resolutions about
     * the wanted one, that whose borders lie closest around the beam. */
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
    out[count++] = window;
    out[count++] = main;
    return count;
}

static lmg_verdict judge_choice(const lmg_pilot *pl, lmg_judge *judge, const lmg_choice *c, bool by_radiance, double limit)
{
    lmg_slab slabs[LMG_CHOICE_SLABS];
    return lmg_judge_slabs(judge, slabs, lmg_choice_slabs(pl, c, slabs), by_radiance, limit);
}

/* Whether a ray is one that the choice's slab is for. */
static bool belongs(const lmg_pilot *pl, size_t i, const lmg_choice *c, lmg_vec3 n)
{
    if (c->focus && pl->taken[i])
        return false;
    return c->kind == LMG_SLAB_CUBE ? pl->class[i] == c->class : v_dot(pl->direction[i], n) > 0;
}

/*
 * How far beyond the outermost ray light may go on that the pilot didn't meet; gap: between the outermost ray and the OUTERMOST-th.
 * Where the number of rays beyond x falls like (end - x)^k, the j-th of them is about j^(1/k) times as far from the end as the
 * first.  At a sharp edge k is 1; past a globe, where only the most slanting light goes, it is 2.5, rounded up.  Half as much
 * again, since one ray's place is chance.
 */
static double undiscovered(double gap, double width)
{
    return d_clamp(1.5 * gap / (cbrt(OUTERMOST) - 1), 0, UNDISCOVERED * width);
}

/* Fits the (u,v) rectangle at the choice's depth, to every stride-th ray; false when there is no light. */
static bool fit_rectangle_to(const lmg_pilot *pl, lmg_choice *c, size_t stride)
{
    lmg_slab s = frame_of(pl, c);
    lmg_vec3 half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    double limit[2] = {fabs(v_dot(half, s.a)), fabs(v_dot(half, s.b))};
    const double far = 1e3 * v_length(half); /* grazing rays cross anywhere, up to infinity */
    c->spread = 1;
    for (int axis = 0; axis < 2; axis++) {
        size_t n = 0;
        for (size_t i = 0; i < pl->count; i += stride) {
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
        lmg_interval q = lmg_quantiles(pl->x, pl->w, n, RECTANGLE_TAIL),
                     outer = faces && stride == 1 ? lmg_quantiles(pl->x, pl->w, n, OUTERMOST / (double)n) : q;
        /* Light with an edge: the outermost of all rays is where its edge is, and is taken.  Light that thins out: the quantile. */
        double width = q.hi - q.lo, lo = q.lo, hi = q.hi;
        if (q.least >= q.lo - 0.02 * width)
            lo = q.least - (faces ? undiscovered(outer.lo - q.least, width) : 0);
        if (q.most <= q.hi + 0.02 * width)
            hi = q.most + (faces ? undiscovered(q.most - outer.hi, width) : 0);
        /* Margin: what n rays leave undiscovered of a sharp edge, a few n-ths of the width; never less than the bounds' rounding.
         */
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
    return true;
}

/* To all rays, whose flux in it is summed up. */
static bool fit_rectangle(const lmg_pilot *pl, lmg_choice *c)
{
    if (!fit_rectangle_to(pl, c, 1))
        return false;
    const lmg_slab s = frame_of(pl, c);
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

/* Depth of the (u,v) plane between lo and hi where the light is narrowest: least area of the rectangle. */
static void narrowest_depth(const lmg_pilot *pl, lmg_choice *c, double lo, double hi, int steps)
{
    double least = INFINITY, at = 0.5 * (lo + hi), step = (hi - lo) / steps;
    for (int k = 0; k <= steps; k++) {
        c->depth = lo + step * k;
        double area = fit_rectangle_to(pl, c, SCAN) ? c->spread : (double)INFINITY;
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
            double area = fit_rectangle_to(pl, c, SCAN) ? c->spread : (double)INFINITY;
            if (area < least) {
                least = area;
                at = c->depth;
            }
        }
    }
    c->depth = at;
    fit_rectangle(pl, c);
}

/* Fits the rectangle, and judges by radiance: a plane that is good for that is good for what falls on planes near and far. */
static lmg_verdict cost(const lmg_pilot *pl, lmg_judge *judge, lmg_choice *c, double limit)
{
    return fit_rectangle_to(pl, c, SCAN) ? judge_choice(pl, judge, c, true, limit) : (lmg_verdict){.error = INFINITY};
}

/* From the depth that the choice has to wherever else its cells do clearly less harm. */
static void search_depth(const lmg_pilot *pl, lmg_judge *judge, lmg_choice *c, double lo, double hi, int steps)
{
    /* in no more cells than leave pairs enough to tell by */
    static const double PAIRS = 20000;
    const double cells = c->cells;
    c->cells = fmin(cells, 0.5 * (double)pl->count * (double)pl->count / PAIRS);
    double at = c->depth, step = (hi - lo) / steps;
    lmg_verdict best = cost(pl, judge, c, INFINITY);
    for (int round = 0; round < 3; round++, step *= 0.3) {
        double centre = at;
        for (int k = round ? -1 : 0; k <= (round ? 1 : steps); k++) {
            if (round && k == 0)
                continue;
            c->depth = round ? d_clamp(centre + k * step, lo, hi) : lo + step * k;
            lmg_verdict e = cost(pl, judge, c, GAIN * best.error);
            if (lmg_better(e, best, GAIN, LMG_CERTAIN)) {
                best = e;
                at = c->depth;
            }
        }
    }
    c->depth = at;
    c->cells = cells;
    fit_rectangle(pl, c);
}

/* Nested rectangles in (s,t) around the densest light: the emptiest border strip of a histogram is taken off again and again;
 * wherever the area has halved, a rectangle is kept.  A rectangle grown small is looked at in a finer histogram. */
enum { MAX_NESTED = 24, BINS = 64 };
static int nested(const lmg_pilot *pl, const lmg_choice *c, double out[MAX_NESTED][4])
{
    lmg_slab s = frame_of(pl, c);
    static const int AREA_PER_LEVEL = 16;
    static const double STRAY = 0.002; /* of the light, in a strip: nothing to keep it for, and mostly chance */
    double r[4] = {-1, 1, -1, 1}, total = 0;
    double *histogram = malloc(BINS * BINS * sizeof *histogram);
    int count = 0;
    for (int level = 0; histogram && level < 4; level++) {
        memset(histogram, 0, BINS * BINS * sizeof *histogram);
        double inside = 0, mean[2] = {0};
        for (size_t i = 0; i < pl->count; i++) {
            if (!belongs(pl, i, c, s.n))
                continue;
            double a, b;
            lmg_slab_st(&s, pl->direction[i], v_dot(pl->direction[i], s.n), 0, 0, &a, &b);
            int x = (int)floor((a - r[0]) / (r[1] - r[0]) * BINS), y = (int)floor((b - r[2]) / (r[3] - r[2]) * BINS);
            if (x >= 0 && x < BINS && y >= 0 && y < BINS) {
                histogram[y * BINS + x] += pl->flux[i];
                inside += pl->flux[i];
                mean[0] += pl->flux[i] * (x + 0.5);
                mean[1] += pl->flux[i] * (y + 0.5);
            }
        }
        if (level == 0)
            total = inside;
        /* a window that holds little of the light isn't worth its cells; a beam exactly on the border of classes may leave one
         * empty */
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
                /* by density; of about equals that of the longer direction, so that the rectangle doesn't turn into a stripe, and
                 * that which is farther from the middle of the light */
                double strip = k < 2 ? y1 - y0 : x1 - x0, across = k < 2 ? x1 - x0 : y1 - y0, middle = mean[k / 2] / inside;
                double away = fmax(k == 0 ? middle - x0 : k == 1 ? x1 - middle : k == 2 ? middle - y0 : y1 - middle, 1);
                side[k] = (side[k] + STRAY * inside) / (strip * across * across * away * away);
                least = side[k] < side[least] ? k : least;
            }
            x0 += least == 0;
            x1 -= least == 1;
            y0 += least == 2;
            y1 -= least == 3;
            if ((x1 - x0) * (y1 - y0) * 2 <= kept && count < MAX_NESTED) {
                kept = (x1 - x0) * (y1 - y0);
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

/* How the cells are shared out: between (u,v) and (s,t), for the window too, and between window and the rest. */
static lmg_verdict share_cells(const lmg_pilot *pl, lmg_judge *judge, lmg_choice *c, lmg_verdict best)
{
    static const double biases[] = {0.25, 0.5, 2, 4}, shares[] = {0.35, 0.5, 0.75, 0.87};
    for (int round = 0; round < 2; round++) {
        const lmg_choice before = *c;
        for (int what = 0; what < 3; what++) {
            if (what && !c->window)
                break;
            const lmg_choice kept = *c;
            for (int k = 0; k < 4; k++) {
                lmg_choice t = kept;
                double *bias = what == 0 ? &t.bias : &t.window_bias;
                if (what == 2)
                    t.share = shares[k];
                else
                    *bias *= biases[k];
                if (what < 2 && (*bias < 0.05 || *bias > 20))
                    continue;
                lmg_verdict e = judge_choice(pl, judge, &t, false, GAIN * best.error);
                if (lmg_better(e, best, GAIN, LMG_LIKELY)) {
                    best = e;
                    *c = t;
                }
            }
        }
        if (before.bias == c->bias && before.window_bias == c->window_bias && before.share == c->share)
            break;
    }
    return best;
}

/* Fewer cells, if that may be, where their noise costs more than they are worth. */
static lmg_verdict fewer_cells(const lmg_pilot *pl, lmg_judge *judge, lmg_choice *c, lmg_verdict best)
{
    for (lmg_choice t = *c; c->fewer && t.cells >= 2 * FEWEST;) {
        t.cells *= 0.5;
        const lmg_verdict e = judge_choice(pl, judge, &t, false, best.error);
        if (e.error >= best.error)
            continue;
        best = e;
        *c = t;
    }
    return best;
}

/* Window or none: each that nested() finds, with cells shared out evenly, and, if there may be fewer, with a few numbers of them: a
 * narrow window is worth it with fewer cells than a wide one. */
static lmg_verdict search_window(const lmg_pilot *pl, lmg_judge *judge, lmg_choice *c, lmg_verdict best)
{
    double rects[MAX_NESTED][4], gain = WINDOW_WORTH;
    const int n = nested(pl, c, rects);
    lmg_choice kept = *c;
    for (int k = 0; k < n; k++)
        for (int fewer = 0; fewer < (c->fewer ? 3 : 1); fewer++) {
            lmg_choice t = *c;
            t.window = true;
            t.share = 0.6;
            t.cells = fmin(c->cells, fmax(c->cells * pow(5, -fewer), FEWEST));
            t.window_bias = fmax(c->bias, 0.25);
            memcpy(t.st, rects[k], sizeof t.st);
            lmg_verdict e = judge_choice(pl, judge, &t, false, gain * best.error);
            if (!lmg_better(e, best, gain, kept.window ? LMG_LIKELY : LMG_CERTAIN))
                continue;
            gain = GAIN; /* any window is that much worth; a better one less */
            best = e;
            kept = t;
        }
    *c = kept;
    return best;
}

/*
 * What the light has of squared radiance, without end of cells: the error of ever finer cells falls like their width where light
 * has edges, hence like the fourth root of their number, and two of them tell where it leads.
 */
static double square_of(const lmg_pilot *pl, lmg_judge *judge, const lmg_choice *c)
{
    enum { RUNGS = 6, STEP = 16 };
    /* margin: chance must not make any cells look better than perfect */
    static const double ENOUGH_PAIRS = 1000, COARSEST = 20000, MARGIN = 1.05;
    double before = 0, most = 0, end = 0;
    lmg_choice t = *c;
    t.cells = COARSEST;
    t.fixed = NULL;
    for (int k = 0; k < RUNGS; k++, t.cells *= STEP) {
        lmg_slab slabs[LMG_CHOICE_SLABS];
        double pairs, kept = lmg_judge_kept(judge, slabs, lmg_choice_slabs(pl, &t, slabs), &pairs);
        if (k && pairs < ENOUGH_PAIRS)
            break;
        end = k ? 2 * kept - before : kept;
        before = kept;
        most = fmax(most, kept);
    }
    return MARGIN * fmax(end, most);
}

lmg_verdict lmg_choice_search(lmg_pilot *pl, lmg_judge *judge, lmg_choice *c)
{
    lmg_vec3 a, b, n, mid = v_scale(0.5, v_add(pl->lo, pl->hi)), half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    lmg_class_frame(c->class, &a, &b, &n);
    const double centre = v_dot(mid, n), depth = fabs(v_dot(half, n));
    narrowest_depth(pl, c, centre - depth, centre + depth, 16);
    lmg_judge_set_square(judge, square_of(pl, judge, c));
    /* where planes stand is a matter of sharpness: noise would have them where cells are large */
    const double photons = pl->photons;
    pl->photons = 0;
    search_depth(pl, judge, c, centre - depth, centre + depth, 16);
    pl->photons = photons;
    lmg_verdict best = fewer_cells(pl, judge, c, judge_choice(pl, judge, c, false, INFINITY));
    /* where another split is better, other numbers of cells may be */
    for (double bias = 0; c->bias != bias;) {
        bias = c->bias;
        best = share_cells(pl, judge, c, best);
        if (c->bias != bias)
            best = fewer_cells(pl, judge, c, best);
    }
    bool may_window = !(c->fixed && (c->fixed[2] || c->fixed[3])) && (c->kind == LMG_SLAB_APERTURE || isinf(c->distance));
    if (may_window)
        best = search_window(pl, judge, c, best);
    if (c->window) {
        /* the window has changed what counts: look at the depth once more */
        pl->photons = 0;
        search_depth(pl, judge, c, centre - depth, centre + depth, 12);
        pl->photons = photons;
        best = share_cells(pl, judge, c, judge_choice(pl, judge, c, false, INFINITY));
        best = fewer_cells(pl, judge, c, best);
    }
    return best;
}

/* --------------------------------------------------------------------------------------------------------------- focus */

void lmg_focus_cut(lmg_slab *focus, double cells, double bias)
{
    cut(sqrt(cells) * bias, focus->u1 - focus->u0, focus->v1 - focus->v0, &focus->nu, &focus->nv);
    cut(cells / ((double)focus->nu * focus->nv), 1, 1, &focus->ns, &focus->nt);
}

/* Where most rays cross, by histograms zoomed into their fullest bin and its neighbours: (u,v) of its middle. */
static void densest(const double *u, const double *v, const double *w, size_t n, double u0, double u1, double v0, double v1,
                    double at[2])
{
    enum { SIDE = 32, ZOOMS = 3 };
    for (int zoom = 0; zoom < ZOOMS; zoom++) {
        double bins[SIDE * SIDE] = {0}, du = (u1 - u0) / SIDE, dv = (v1 - v0) / SIDE;
        for (size_t i = 0; i < n; i++) {
            double x = (u[i] - u0) / du, y = (v[i] - v0) / dv;
            if (x >= 0 && x < SIDE && y >= 0 && y < SIDE)
                bins[(int)y * SIDE + (int)x] += w[i];
        }
        int most = 0;
        for (int k = 1; k < SIDE * SIDE; k++)
            most = bins[k] > bins[most] ? k : most;
        at[0] = u0 + (most % SIDE + 0.5) * du;
        at[1] = v0 + (most / SIDE + 0.5) * dv;
        u0 = at[0] - 3 * du;
        u1 = at[0] + 3 * du;
        v0 = at[1] - 3 * dv;
        v1 = at[1] + 3 * dv;
    }
}

typedef struct crossing {
    double r, w; /* how far from the densest place, flux */
} crossing;

static int compare_crossings(const void *x, const void *y)
{
    const double a = ((const crossing *)x)->r, b = ((const crossing *)y)->r;
    return (a > b) - (a < b);
}

/* Scratch of the search for a focus. */
typedef struct crossings {
    double *u, *v, *w;
    crossing *sorted;
} crossings;

/* How concentrated the light is at a depth: the largest (share of flux)^2 / (area), m^-2, over squares around the densest place;
 * that square. */
static double concentration(const lmg_pilot *pl, const lmg_slab *frame, const crossings *x, double rect[4])
{
    static const double LEAST_SHARE = 0.05;
    size_t n = 0;
    double total = 0;
    for (size_t i = 0; i < pl->count; i += SCAN) {
        double dn = v_dot(pl->direction[i], frame->n);
        if (!(dn > 0))
            continue;
        lmg_slab_crossing(frame, pl->origin[i], pl->direction[i], dn, &x->u[n], &x->v[n]);
        total += x->w[n++] = pl->flux[i];
    }
    lmg_vec3 half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    const double hu = fabs(v_dot(half, frame->a)), hv = fabs(v_dot(half, frame->b));
    double at[2], best = 0, sum = 0;
    densest(x->u, x->v, x->w, n, -hu, hu, -hv, hv, at);
    for (size_t i = 0; i < n; i++)
        x->sorted[i] = (crossing){fmax(fabs(x->u[i] - at[0]), fabs(x->v[i] - at[1])), x->w[i]};
    qsort(x->sorted, n, sizeof *x->sorted, compare_crossings);
    for (size_t i = 0; i < n; i++) {
        sum += x->sorted[i].w;
        if (sum < LEAST_SHARE * total)
            continue;
        const double r = fmax(x->sorted[i].r, 0.5 * NARROWEST * pl->size), gain = sum * sum / (total * total * 4 * r * r);
        if (gain <= best)
            continue;
        best = gain;
        rect[0] = fmax(at[0] - r, -hu);
        rect[1] = fmin(at[0] + r, hu);
        rect[2] = fmax(at[1] - r, -hv);
        rect[3] = fmin(at[1] + r, hv);
    }
    return best;
}

bool lmg_focus_find(const lmg_pilot *pl, int c, double area, lmg_slab *out)
{
    enum { DEPTHS = 24, ROUNDS = 3 };
    const lmg_choice choice = {.kind = LMG_SLAB_APERTURE, .class = c};
    const crossings x = {malloc(pl->count * sizeof *x.u), malloc(pl->count * sizeof *x.v), malloc(pl->count * sizeof *x.w),
                         malloc(pl->count * sizeof *x.sorted)};
    double best = 0;
    lmg_vec3 mid = v_scale(0.5, v_add(pl->lo, pl->hi)), half = v_scale(0.5, v_sub(pl->hi, pl->lo));
    *out = frame_of(pl, &choice);
    const double reach = fabs(v_dot(half, out->n)), middle = v_dot(mid, out->n);
    double at = 0, step = 2 * reach / DEPTHS;
    for (int round = 0; x.u && x.v && x.w && x.sorted && round < ROUNDS; round++, step *= 0.25) {
        const double centre = at;
        for (int k = round ? -3 : -DEPTHS / 2; k <= (round ? 3 : DEPTHS / 2); k++) {
            lmg_choice here = choice;
            here.depth = middle + d_clamp(centre + k * step, -reach, reach);
            lmg_slab s = frame_of(pl, &here);
            double rect[4] = {0};
            const double gain = concentration(pl, &s, &x, rect);
            if (gain <= best || !(rect[1] > rect[0] && rect[3] > rect[2]))
                continue;
            best = gain;
            at = here.depth - middle;
            *out = s;
            out->u0 = rect[0];
            out->u1 = rect[1];
            out->v0 = rect[2];
            out->v1 = rect[3];
        }
    }
    free(x.u);
    free(x.v);
    free(x.w);
    free(x.sorted);
    out->nu = out->nv = out->ns = out->nt = 1;
    return best * area > FOCUS_WORTH;
}
