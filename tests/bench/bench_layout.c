/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Is the layout that a bake chooses within a size the best that one finds by hand?  Each sample lamp is baked with as many photons
 * in the chosen layout and in others around it: the resolution of the widest slab halved, kept and doubled along (u,v) and along
 * (s,t) (--resolution), one opening and six faces of a quarter, as many and four times as many cells (--layout, --cells); those
 * whose file would be larger than the size don't count.  All are judged by the lamp's other rays, the noise of judging taken out.
 *
 * Measures: near-field illuminance (0.5 to 10 sizes), far-field intensity, luminance pictures, and what the fit weighs by: the root
 * of the sum of their squares in units of good ones, 0.6, 2 and 30 %.  Target: chosen within 10 % of the best by that; the best
 * one's luck, being the least of many, makes the ratio too large rather than too small.
 *
 *     test_bench_layout [LAMP|all [photons [MB [photons of the judge [seed]]]]]        1e6, 1, 4e6, 5
 */
#include "bench_lamp.h"
#include "judge.h"
#include "size.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MEASURES = JUDGE_MEASURES + 1 };
static const double GOOD[JUDGE_MEASURES] = {0.006, 0.02, 0.3}, TARGET = 1.1;
/* As many as --size takes at most: gigabytes of memory. */
static const double MOST_CELLS = 64e6;

/* A box: squares of its errors, in units of good ones but for the first three, and their standard errors. */
typedef struct candidate {
    double square[MEASURES], se[MEASURES], bytes, cells;
    lmg_slab widest;
} candidate;

static double cells_of(const lmg_layout *layout)
{
    double cells = 0;
    for (uint32_t i = 0; i < layout->slab_count; ++i) {
        const lmg_slab *s = &layout->slabs[i];
        cells += (double)s->nu * s->nv * s->ns * s->nt;
    }
    return cells;
}

static candidate try_layout(const lum_model *model, const judge *j, uint64_t rays, const bake_options *options, const char *what)
{
    lmg_error err = {{0}};
    lmg_field *field;
    bake_report report;
    judge_verdict v;
    candidate c = {.bytes = 0};
    bench_demand(bake_run(model, options, &field, &report, &err), &err);
    bench_demand(bake_size_of(field, &c.bytes, &err), &err);
    bench_demand(judge_box(j, field, rays, &v, &err), &err);
    const lmg_layout *layout = lmg_field_layout(field);
    c.cells = cells_of(layout);
    c.widest = layout->slabs[layout->slab_count - 7]; /* before the six that catch what passes beside */
    for (int k = 0; k < JUDGE_MEASURES; ++k) {
        const judge_error e = v.error[k];
        c.square[k] = e.rms * fabs(e.rms);
        c.se[k] = 2 * fabs(e.rms) * e.standard_error;
        c.square[JUDGE_MEASURES] += c.square[k] / (GOOD[k] * GOOD[k]);
        c.se[JUDGE_MEASURES] = hypot(c.se[JUDGE_MEASURES], c.se[k] / (GOOD[k] * GOOD[k]));
    }
    printf("  %-34s %9.0f cells %7.3f MB: near %6.2f, far %6.2f, luminance %6.2f %%; together %6.3f +- %.3f\n", what, c.cells,
           1e-6 * c.bytes, 100 * v.error[JUDGE_NEAR].rms, 100 * v.error[JUDGE_FAR].rms, 100 * v.error[JUDGE_LUMINANCE].rms,
           sqrt(fmax(c.square[JUDGE_MEASURES], 0)),
           c.se[JUDGE_MEASURES] / (2 * sqrt(fmax(c.square[JUDGE_MEASURES], c.se[JUDGE_MEASURES]))));
    fflush(stdout);
    lmg_field_destroy(field);
    return c;
}

static bool try_lamp(const char *name, uint64_t photons, double size, uint64_t judging, uint64_t seed)
{
    static const char *const MEASURE[MEASURES] = {"near", "far", "luminance", "together"};
    lmg_error err = {{0}};
    lum_model *model = bench_load(name);
    judge *j;
    bench_demand(judge_create(model, seed, 0, 0, &j, &err), &err);
    bench_demand(judge_measure_lamp(j, judging, &err), &err);
    printf("%s, %.3g M photons, %.3g MB at most\n", name, 1e-6 * (double)photons, 1e-6 * size);
    const bake_options plain = {.photons = photons, .seed = seed};
    bake_options o = plain;
    o.size = size;
    const candidate chosen = try_layout(model, j, judging, &o, "chosen");
    candidate best[MEASURES];
    int tried = 0;
    for (int k = 0; k < MEASURES; ++k)
        best[k] = chosen;
    for (int i = 0; i < 15; ++i) {
        char what[100];
        o = plain;
        if (i < 9) {
            static const double FACTOR[3] = {0.5, 1, 2};
            const double uv = FACTOR[i / 3], st = FACTOR[i % 3];
            const uint32_t n[4] = {chosen.widest.nu, chosen.widest.nv, chosen.widest.ns, chosen.widest.nt};
            for (int k = 0; k < 4; ++k)
                o.fit.resolution[k] = (uint32_t)fmax(floor((k < 2 ? uv : st) * n[k] + 0.5), 1);
            if ((double)o.fit.resolution[0] * o.fit.resolution[1] * o.fit.resolution[2] * o.fit.resolution[3] > MOST_CELLS)
                continue;
            snprintf(what, sizeof(what), "--resolution %u,%u,%u,%u", o.fit.resolution[0], o.fit.resolution[1], o.fit.resolution[2],
                     o.fit.resolution[3]);
        } else {
            static const double FACTOR[3] = {0.25, 1, 4};
            o.fit.choice = i < 12 ? LMG_LAYOUT_APERTURE : LMG_LAYOUT_CUBE;
            o.fit.cells = (uint64_t)fmax(FACTOR[i % 3] * chosen.cells, 1000);
            snprintf(what, sizeof(what), "--layout %s --cells %.0f", i < 12 ? "aperture" : "cube", (double)o.fit.cells);
        }
        const candidate c = try_layout(model, j, judging, &o, what);
        if (c.bytes > size)
            continue;
        ++tried;
        for (int k = 0; k < MEASURES; ++k)
            if (c.square[k] < best[k].square[k])
                best[k] = c;
    }
    bool within = true;
    printf("%-16s chosen over best of %d by hand:", name, tried);
    for (int k = 0; k < MEASURES; ++k) {
        /* what is below its standard error is chance */
        const double floor = fmax(chosen.se[k], best[k].se[k]), a = fmax(chosen.square[k], floor),
                     b = fmax(best[k].square[k], floor);
        const double ratio = sqrt(a / b), se = 0.5 * ratio * hypot(chosen.se[k] / a, best[k].se[k] / b);
        printf(" %s %.2f +- %.2f", MEASURE[k], ratio, ratio > 1 ? se : 0);
        if (k == JUDGE_MEASURES) {
            within = ratio <= TARGET;
            printf("%s\n{\"benchmark\": \"layout by hand\", \"lamp\": \"%s\", \"photons\": %.0f, \"size\": %.0f, \"ratio\": %.4f, "
                   "\"ratio_se\": %.4f}\n",
                   within ? "" : " MISSED", name, (double)photons, size, ratio, se);
        }
    }
    fflush(stdout);
    judge_destroy(j);
    lum_model_destroy(model);
    return within;
}

int main(int argc, char **argv)
{
    static const char *const LAMPS[] = {"paraboloid-spot", "glass-lens", "louvred-panel", "opal-globe", "phosphor-led"};
    const char *wanted = argc > 1 ? argv[1] : "all";
    const double photons = argc > 2 ? atof(argv[2]) : 1e6, size = 1e6 * (argc > 3 ? atof(argv[3]) : 1),
                 judging = argc > 4 ? atof(argv[4]) : 4e6;
    const uint64_t seed = argc > 5 ? strtoull(argv[5], NULL, 10) : 5;
    bool within = true, any = false;
    if (!(photons >= 1 && size > 0 && judging >= 1)) {
        fprintf(stderr, "usage: %s [LAMP|all [photons [MB [photons of the judge [seed]]]]]\n", argv[0]);
        return 2;
    }
    for (size_t i = 0; i < sizeof(LAMPS) / sizeof(LAMPS[0]); ++i)
        if (strcmp(wanted, "all") == 0 || strcmp(wanted, LAMPS[i]) == 0) {
            any = true;
            within &= try_lamp(LAMPS[i], (uint64_t)photons, size, (uint64_t)judging, seed);
        }
    if (!any)
        fprintf(stderr, "no sample lamp is called '%s'\n", wanted);
    return any ? within ? 0 : 1 : 2;
}
