/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Is a box as good as `lumibake bake --error` was asked for?  Each sample lamp is baked to an error by ten seeds, each box is
 * judged by a longer reference of its lamp whose rays no search has seen, the noise of both taken out.  Target: true error over
 * asked within 0.7 to 1.3 for nine seeds of ten, of every lamp.
 *
 *     test_bench_error [LAMP|all [near-field|far-field|luminance [seeds [PERCENT ...]]]]
 *
 * By default 2 % of the near field.
 */
#include "bench_lamp.h"
#include "target.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

/* The reference's seed is none of the bakes'. */
enum { REFERENCE_SEED = 1000, MOST_ASKED = 8, ROUNDS = 6 };
static const double LEAST = 0.7, MOST = 1.3, ENOUGH = 0.9;
/* How well a true error is to be known, relative: a fifth of what it may be off by. */
static const double KNOWN = 0.06;
/* Rays to judge by: at first, and at most. */
static const uint64_t FIRST_RAYS = 500000, MOST_RAYS = 16000000;

/* The reference and the rays of it, and of each box, that it takes to know an error well. */
typedef struct reference {
    judge *judge;
    uint64_t rays;
} reference;

static judge_error true_error(reference *r, const lmg_field *field, judge_measure of, double asked)
{
    lmg_error err = {{0}};
    judge_verdict v;
    for (int round = 0;; ++round) {
        bench_demand(judge_box(r->judge, field, r->rays, &v, &err), &err);
        const judge_error e = v.error[of];
        /* the standard error of the square goes as 1 / rays where noise rules */
        const double more = fabs(e.rms) * e.standard_error / (KNOWN * asked * asked);
        if (!(more > 1.25) || r->rays >= MOST_RAYS || round == ROUNDS)
            return e;
        r->rays = (uint64_t)fmin((double)r->rays * more, (double)MOST_RAYS);
        bench_demand(judge_measure_lamp(r->judge, r->rays, &err), &err);
    }
}

static bool try_lamp(const char *name, judge_measure of, double asked, unsigned seeds)
{
    lmg_error err = {{0}};
    lum_model *model = bench_load(name);
    reference r = {.rays = FIRST_RAYS};
    bench_demand(judge_create(model, REFERENCE_SEED, 0, 0, &r.judge, &err), &err);
    bench_demand(judge_measure_lamp(r.judge, r.rays, &err), &err);
    unsigned right = 0, within = 0;
    double sum = 0, squares = 0, least = INFINITY, most = 0, photons = 0, bakes = 0;
    const clock_t began = clock();
    for (unsigned seed = 1; seed <= seeds; ++seed) {
        const bake_options options = {.seed = seed};
        const bake_target target = {.of = of, .error = asked};
        lmg_field *field;
        bake_report report;
        bake_reached reached;
        bench_demand(bake_run_to_error(model, &options, &target, &field, &report, &reached, &err), &err);
        const judge_error e = true_error(&r, field, of, asked);
        const double ratio = e.rms / asked;
        right += ratio >= LEAST && ratio <= MOST;
        within += reached.within;
        sum += ratio;
        squares += ratio * ratio;
        least = fmin(least, ratio);
        most = fmax(most, ratio);
        photons += (double)reached.photons / seeds;
        bakes += (double)reached.bakes / seeds;
        printf("  %-16s seed %2u: asked %.3g %%, told %.3g +- %.2g %%, true %.3g +- %.2g %%: %.2f%s; %.3g M photons, %.3g M cells, "
               "%u bakes%s\n",
               name, seed, 100 * asked, 100 * reached.error.rms, 100 * reached.error.standard_error, 100 * e.rms,
               100 * e.standard_error, ratio, ratio >= LEAST && ratio <= MOST ? "" : " OUTSIDE", 1e-6 * (double)reached.photons,
               1e-6 * (double)reached.cells, reached.bakes, reached.within ? "" : "; told not to be reached");
        fflush(stdout);
        lmg_field_destroy(field);
    }
    const double mean = sum / seeds, spread = sqrt(fmax(squares / seeds - mean * mean, 0) * seeds / fmax(seeds - 1, 1));
    const bool enough = right >= ENOUGH * seeds;
    printf("%-16s %s %.3g %%: true over asked %.2f, spread %.2f, %.2f to %.2f; %u of %u within %.1f to %.1f%s (the search: %u); "
           "%.3g M photons, %.1f bakes, %.0f s of processor time\n",
           name, judge_measure_name(of), 100 * asked, mean, spread, least, most, right, seeds, LEAST, MOST, enough ? "" : " MISSED",
           within, 1e-6 * photons, bakes, (double)(clock() - began) / CLOCKS_PER_SEC);
    printf("{\"benchmark\": \"asking for an error\", \"lamp\": \"%s\", \"measure\": \"%s\", \"asked\": %g, \"mean_ratio\": %.4f, "
           "\"spread\": %.4f, \"least\": %.4f, \"most\": %.4f, "
           "\"seeds\": %u, \"right\": %u}\n",
           name, judge_measure_name(of), asked, mean, spread, least, most, seeds, right);
    fflush(stdout);
    judge_destroy(r.judge);
    lum_model_destroy(model);
    return enough;
}

int main(int argc, char **argv)
{
    static const char *const LAMPS[] = {"paraboloid-spot", "glass-lens", "louvred-panel", "opal-globe", "phosphor-led"};
    static const char *const MEASURES[JUDGE_MEASURES] = {"near-field", "far-field", "luminance"};
    const char *wanted = argc > 1 ? argv[1] : "all", *measure = argc > 2 ? argv[2] : MEASURES[0];
    const unsigned seeds = argc > 3 ? (unsigned)atoi(argv[3]) : 10;
    double asked[MOST_ASKED] = {0.02};
    int count = argc > 4 ? 0 : 1;
    for (int i = 4; i < argc && count < MOST_ASKED; ++i)
        asked[count++] = 0.01 * atof(argv[i]);
    int of = 0;
    while (of < JUDGE_MEASURES && strcmp(measure, MEASURES[of]) != 0)
        ++of;
    if (of == JUDGE_MEASURES || seeds == 0 || !(asked[count - 1] > 0)) {
        fprintf(stderr, "usage: %s [LAMP|all [near-field|far-field|luminance [seeds [PERCENT ...]]]]\n", argv[0]);
        return 2;
    }
    bool right = true, any = false;
    for (size_t i = 0; i < sizeof(LAMPS) / sizeof(LAMPS[0]); ++i)
        for (int k = 0; k < count; ++k)
            if (strcmp(wanted, "all") == 0 || strcmp(wanted, LAMPS[i]) == 0) {
                any = true;
                right &= try_lamp(LAMPS[i], (judge_measure)of, asked[k], seeds);
            }
    if (!any)
        fprintf(stderr, "no sample lamp is called '%s'\n", wanted);
    return any ? right ? 0 : 1 : 2;
}
