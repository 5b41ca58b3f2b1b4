/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Is the layout that a bake chooses within a size the best that one finds by hand?  Each sample lamp is baked with as many photons
 * in the chosen layout and in others around it: the resolution of the widest slab halved, kept and doubled along (u,v) and along
 * (s,t) (--resolution; kept, it's the chosen one, but for its windows and other faces), one opening and six faces of a quarter, as
 * many and four times as many cells (--layout, --cells); those whose file would be larger than the size don't count.  All are
 * judged by the lamp's other rays, the noise of judging taken out.
 *
 * Measures: near-field illuminance (0.5 to 10 sizes), far-field intensity, luminance pictures, and radiance weighted with etendue
 * (L2): the box's square along its own rays, what it shares with the lamp along the lamp's photons, the lamp's square by paths
 * followed backwards along these (viewer).  Then two sums, roots of the sum of squares in units of good ones: as fitted, of what
 * the fit weighs, illuminance, intensity and radiance; as seen, with pictures in place of radiance.  Pictures are means over cones,
 * so that the noise of single cells counts in radiance alone.  Target: chosen within 10 % of the best by both.
 *
 * Each layout is baked several times with other photons, so that the best isn't that whose photons had most luck; what is left of
 * it makes the ratio too large rather than too small.  Standard errors have the boxes' spread in them, if there are several, and
 * the judge's noise, which is taken to differ from layout to layout, though much of it is common to all.
 *
 *     test_bench_layout [LAMP|all [photons [MB [photons of the judge [seed [boxes of a layout]]]]]]        1e6, 1, 4e6, 5, 4
 */
#include "bench_seen.h"
#include "bench_lamp.h"
#include "geometry.h"
#include "judge.h"
#include "layout_judge.h"
#include "size.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RADIANCE = JUDGE_MEASURES, AS_FITTED, AS_SEEN, MEASURES };
static const char *const MEASURE[MEASURES] = {"near", "far", "luminance", "radiance", "as fitted", "as seen"};
static const double GOOD[AS_FITTED] = {LMG_GOOD_ILLUMINANCE, LMG_GOOD_INTENSITY, LMG_GOOD_RADIANCE, LMG_GOOD_RADIANCE},
                    TARGET = 1.1;
/* As many as --size takes at most: gigabytes of memory. */
static const double MOST_CELLS = 64e6;
/* Photons that radiance is judged along, at most. */
static const uint64_t MOST_LOOKS = 1000000;

/* A box: squares of its errors, in units of good ones but for those that are no sums, and their standard errors. */
typedef struct candidate {
    double square[MEASURES], se[MEASURES], bytes, cells;
    lmg_slab widest;
} candidate;

/* A photon that leaves the lamp, and what a path says that was followed backwards along its ray. */
typedef struct looked {
    lmg_vec3 from, direction; /* from: beyond the lamp */
    double flux, luminance;
} looked;

/* What radiance is judged by. */
typedef struct looks {
    const bench_seen *lamp;
    uint64_t seed;
    double square, flux, far; /* of the lamp's radiance, lm cd/m2; lm of a photon; m, where rays are beyond it */
    double photons;           /* emitted, for the rays in `at` */
    looked *at;
    size_t count;
} looks;

static double cells_of(const lmg_layout *layout)
{
    double cells = 0;
    for (uint32_t i = 0; i < layout->slab_count; ++i) {
        const lmg_slab *s = &layout->slabs[i];
        cells += (double)s->nu * s->nv * s->ns * s->nt;
    }
    return cells;
}

static void look_along(void *self, const lmg_ray *rays, size_t n)
{
    looks *l = self;
    lmg_error err = {{0}};
    looked *more = realloc(l->at, (l->count + n + 1) * sizeof(*more)); /* never of nothing */
    if (!more)
        bench_demand(lmg_fail(&err, LMG_ERROR_MEMORY, "no memory to judge radiance"), &err);
    l->at = more;
    for (size_t i = 0; i < n; ++i) {
        lum_rng rng = lum_rng_stream(l->seed, rays[i].number);
        const lmg_vec3 from = v_fma(rays[i].origin, l->far, rays[i].direction);
        looked *to = &l->at[l->count++];
        *to = (looked){from, rays[i].direction, lmg_luminance(rays[i].flux) * l->flux,
                       bench_seen_look(l->lamp, from, rays[i].direction, &rng)};
        l->square += to->flux * to->luminance;
    }
}

/* The lamp's photons and looks; the caller frees at. */
static looks look_at(const char *name, uint64_t photons, uint64_t seed)
{
    lmg_error err = {{0}};
    bench_seen lamp;
    bench_seen_open(&lamp, name, lum_mix64(lum_mix64(seed) + 1));
    looks l = {.lamp = &lamp,
               .seed = lum_mix64(lum_mix64(seed) + 2),
               .photons = (double)photons,
               .flux = lamp.source->flux / (double)photons,
               .far = 2 * v_length(v_sub(lamp.source->bounds_max, lamp.source->bounds_min))};
    bench_seen_photons(&lamp, 0, photons, look_along, &l);
    bench_seen_close(&lamp);
    l.lamp = NULL;
    if (!(l.square > 0))
        bench_demand(lmg_fail(&err, LMG_ERROR_INPUT, "paths followed backwards don't find the light of %s", name), &err);
    return l;
}

/* Squared error of radiance, relative, L2: |box|^2 along the box's own rays, box x lamp along the lamp's photons. */
static double radiance_error(const looks *l, const lmg_field *field, double *se)
{
    const lmg_ledger ledger = lmg_field_ledger(field);
    double self = 0, self_squares = 0, shared = 0, missing = 0, missing_squares = 0;
    float rgb[3];
    for (size_t i = 0; i < l->count; ++i) {
        const looked *at = &l->at[i];
        lmg_field_radiance(field, at->from, at->direction, LMG_NEAREST, rgb, NULL);
        const double m = at->flux * (at->luminance - 2 * lmg_luminance(rgb));
        shared += at->flux * lmg_luminance(rgb);
        missing += m;
        missing_squares += m * m;
    }
    for (size_t i = 0; i < l->count; ++i) {
        lum_rng rng = lum_rng_stream(l->seed + 1, i);
        double xi[5];
        lmg_ray ray;
        for (int k = 0; k < 5; ++k)
            xi[k] = lum_rng_next(&rng);
        if (!lmg_field_emit(field, xi, &ray))
            continue;
        lmg_field_radiance(field, v_fma(ray.origin, l->far, ray.direction), ray.direction, LMG_NEAREST, rgb, NULL);
        self += lmg_luminance(rgb);
        self_squares += lmg_luminance(rgb) * lmg_luminance(rgb);
    }
    const double n = (double)l->count, mean = self / n, square = ledger.stored * mean;
    /* Cauchy and Schwarz: no lamp has less, but for noise */
    if (l->square < 0.9 * shared * shared / square)
        printf("  paths followed backwards miss some of the lamp's light: radiance isn't judged right\n");
    const double self_se = ledger.stored * sqrt(fmax(self_squares / n - mean * mean, 0) / n);
    *se = hypot(self_se, sqrt(fmax(missing_squares - missing * missing / l->photons, 0))) / l->square;
    return (square + missing) / l->square;
}

/* The squared errors of a box, and the judge's standard errors of them. */
static void judge_squares(const lmg_field *field, const judge *j, const looks *l, uint64_t rays, double square[MEASURES],
                          double se[MEASURES])
{
    lmg_error err = {{0}};
    judge_verdict v;
    bench_demand(judge_box(j, field, rays, &v, &err), &err);
    for (int k = 0; k < JUDGE_MEASURES; ++k) {
        square[k] = v.error[k].rms * fabs(v.error[k].rms);
        se[k] = 2 * fabs(v.error[k].rms) * v.error[k].standard_error;
    }
    square[RADIANCE] = radiance_error(l, field, &se[RADIANCE]);
    for (int sum = AS_FITTED; sum <= AS_SEEN; ++sum) {
        square[sum] = se[sum] = 0;
        for (int k = 0; k < AS_FITTED; ++k)
            if (k != (sum == AS_SEEN ? (int)RADIANCE : (int)JUDGE_LUMINANCE)) {
                square[sum] += square[k] / (GOOD[k] * GOOD[k]);
                se[sum] = hypot(se[sum], se[k] / (GOOD[k] * GOOD[k]));
            }
    }
}

/* The box of a layout that the options ask for, and of it with others of the lamp's photons: what is judged is the layout, and not
 * what luck these photons had. */
static candidate try_layout(const lum_model *model, const judge *j, const looks *l, uint64_t rays, bake_options options, int boxes,
                            const char *what)
{
    lmg_error err = {{0}};
    candidate c = {.bytes = 0};
    double squares[MEASURES] = {0};
    lmg_layout layout;
    for (int i = 0; i < boxes; ++i) {
        lmg_field *field;
        bake_report report;
        double bytes, square[MEASURES], se[MEASURES];
        bench_demand(bake_run(model, &options, &field, &report, &err), &err);
        bench_demand(bake_size_of(field, &bytes, &err), &err);
        judge_squares(field, j, l, rays, square, se);
        c.bytes += bytes / boxes;
        for (int k = 0; k < MEASURES; ++k) {
            c.square[k] += square[k] / boxes;
            squares[k] += square[k] * square[k] / boxes;
            c.se[k] += se[k] / boxes; /* the same light judges each: no less for more boxes */
        }
        layout = *lmg_field_layout(field);
        lmg_field_destroy(field);
        options.seed += 1000;
        options.layout = &layout;
    }
    for (int k = 0; k < MEASURES && boxes > 1; ++k)
        c.se[k] = hypot(c.se[k], sqrt(fmax(squares[k] - c.square[k] * c.square[k], 0) / (boxes - 1)));
    c.cells = cells_of(&layout);
    c.widest = layout.slabs[layout.slab_count - 7]; /* before the six that catch what passes beside */
    printf("  %-34s %9.0f cells %7.3f MB:", what, c.cells, 1e-6 * c.bytes);
    for (int k = 0; k < MEASURES; ++k) {
        const double rms = sqrt(fmax(c.square[k], 0));
        if (k < AS_FITTED)
            printf(" %s %6.2f%s", MEASURE[k], 100 * rms, k == RADIANCE ? " %;" : ",");
        else
            printf(" %s %.3f +- %.3f", MEASURE[k], rms, c.se[k] / (2 * sqrt(fmax(c.square[k], c.se[k]))));
    }
    printf("\n");
    fflush(stdout);
    return c;
}

static bool try_lamp(const char *name, uint64_t photons, double size, uint64_t judging, uint64_t seed, int boxes)
{
    lmg_error err = {{0}};
    lum_model *model = bench_load(name);
    judge *j;
    bench_demand(judge_create(model, seed, 0, 0, &j, &err), &err);
    bench_demand(judge_measure_lamp(j, judging, &err), &err);
    looks l = look_at(name, judging < MOST_LOOKS ? judging : MOST_LOOKS, seed);
    printf("%s, %.3g M photons, %.3g MB at most\n", name, 1e-6 * (double)photons, 1e-6 * size);
    const bake_options plain = {.photons = photons, .seed = seed};
    bake_options o = plain;
    o.size = size;
    const candidate chosen = try_layout(model, j, &l, judging, o, boxes, "chosen");
    candidate best[MEASURES];
    int tried = 0;
    for (int k = 0; k < MEASURES; ++k)
        best[k] = chosen;
    if (chosen.bytes > size)
        printf("  which is larger than %.3g MB\n", 1e-6 * size);
    for (int i = 0; i < 15; ++i) {
        char what[100];
        o = plain;
        if (i < 9) {
            static const double FACTOR[3] = {0.5, 1, 2};
            const double uv = FACTOR[i / 3], st = FACTOR[i % 3];
            const uint32_t n[4] = {chosen.widest.nu, chosen.widest.nv, chosen.widest.ns, chosen.widest.nt};
            for (int k = 0; k < 4; ++k)
                o.fit.resolution[k] = (uint32_t)fmax(floor((k < 2 ? uv : st) * n[k] + 0.5), 1);
            if (chosen.cells * uv * uv * st * st > MOST_CELLS)
                continue;
            snprintf(what, sizeof(what), "--resolution %u,%u,%u,%u", o.fit.resolution[0], o.fit.resolution[1], o.fit.resolution[2],
                     o.fit.resolution[3]);
        } else {
            static const double FACTOR[3] = {0.25, 1, 4};
            o.fit.choice = i < 12 ? LMG_LAYOUT_APERTURE : LMG_LAYOUT_CUBE;
            o.fit.cells = (uint64_t)fmax(FACTOR[i % 3] * chosen.cells, 1000);
            snprintf(what, sizeof(what), "--layout %s --cells %.0f", i < 12 ? "aperture" : "cube", (double)o.fit.cells);
        }
        const candidate c = try_layout(model, j, &l, judging, o, boxes, what);
        if (c.bytes > size)
            continue;
        ++tried;
        for (int k = 0; k < MEASURES; ++k)
            if (c.square[k] < best[k].square[k])
                best[k] = c;
    }
    double ratio[MEASURES], se[MEASURES];
    printf("%-16s chosen over best of %d by hand:", name, tried);
    for (int k = 0; k < MEASURES; ++k) {
        /* what is below its standard error is chance */
        const double floor = fmax(chosen.se[k], best[k].se[k]), a = fmax(chosen.square[k], floor),
                     b = fmax(best[k].square[k], floor);
        ratio[k] = sqrt(a / b);
        se[k] = 0.5 * ratio[k] * hypot(chosen.se[k] / a, best[k].se[k] / b);
        if (fmax(chosen.square[k], best[k].square[k]) <= floor)
            printf(" %s less than can be told", MEASURE[k]);
        else
            printf(" %s %.2f +- %.2f%s", MEASURE[k], ratio[k], ratio[k] > 1 ? se[k] : 0,
                   k >= AS_FITTED && ratio[k] > TARGET ? " MISSED" : "");
    }
    printf("\n{\"benchmark\": \"layout by hand\", \"lamp\": \"%s\", \"photons\": %.0f, \"size\": %.0f, \"seed\": %.0f, "
           "\"as_fitted\": %.4f, \"as_fitted_se\": %.4f, \"as_seen\": %.4f, \"as_seen_se\": %.4f}\n",
           name, (double)photons, size, (double)seed, ratio[AS_FITTED], se[AS_FITTED], ratio[AS_SEEN], se[AS_SEEN]);
    fflush(stdout);
    free(l.at);
    judge_destroy(j);
    lum_model_destroy(model);
    return ratio[AS_FITTED] <= TARGET && ratio[AS_SEEN] <= TARGET;
}

int main(int argc, char **argv)
{
    static const char *const LAMPS[] = {"paraboloid-spot", "glass-lens", "louvred-panel", "opal-globe", "phosphor-led"};
    const char *wanted = argc > 1 ? argv[1] : "all";
    const double photons = argc > 2 ? atof(argv[2]) : 1e6, size = 1e6 * (argc > 3 ? atof(argv[3]) : 1),
                 judging = argc > 4 ? atof(argv[4]) : 4e6;
    const uint64_t seed = argc > 5 ? strtoull(argv[5], NULL, 10) : 5;
    const int boxes = argc > 6 ? atoi(argv[6]) : 4;
    bool within = true, any = false;
    if (!(photons >= 1 && size > 0 && judging >= 1 && boxes >= 1)) {
        fprintf(stderr, "usage: %s [LAMP|all [photons [MB [photons of the judge [seed [boxes of a layout]]]]]]\n", argv[0]);
        return 2;
    }
    for (size_t i = 0; i < sizeof(LAMPS) / sizeof(LAMPS[0]); ++i)
        if (strcmp(wanted, "all") == 0 || strcmp(wanted, LAMPS[i]) == 0) {
            any = true;
            within &= try_lamp(LAMPS[i], (uint64_t)photons, size, (uint64_t)judging, seed, boxes);
        }
    if (!any)
        fprintf(stderr, "no sample lamp is called '%s'\n", wanted);
    return any ? within ? 0 : 1 : 2;
}
