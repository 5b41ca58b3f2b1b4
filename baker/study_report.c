/* SPDX-License-Identifier: Apache-2.0 */
/* The accuracy study as a page: error against time, size and cells; advice; where the time goes. */
#include "page.h"
#include "study.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

/* A curve of errors: a measure of the boxes of a ladder, as reconstructed or read as plain bins. */
typedef struct errors_of {
    const char *name;
    study_ladder ladder;
    judge_measure measure;
    bool plain;
} errors_of;

enum { MOST_CURVES = 6 }; /* that can be told apart */

/* Curves over x(rung). */
static void add_curves(report_page *page, const study *s, const errors_of *which, size_t count, const report_axes *axes,
                       double (*x_of)(const study_rung *))
{
    double x[MOST_CURVES][STUDY_MAX_RUNGS], y[MOST_CURVES][STUDY_MAX_RUNGS], se[MOST_CURVES][STUDY_MAX_RUNGS];
    report_curve curves[MOST_CURVES];
    for (size_t c = 0; c < count; ++c) {
        size_t n = 0;
        for (size_t i = 0; i < s->rung_count; ++i) {
            const study_rung *r = &s->rungs[i];
            if (r->ladder != which[c].ladder)
                continue;
            const judge_error e = (which[c].plain ? &r->plain : &r->verdict)->error[which[c].measure];
            x[c][n] = x_of(r);
            y[c][n] = 100 * e.rms;
            se[c][n++] = 100 * e.standard_error;
        }
        curves[c] = (report_curve){.name = which[c].name, .x = x[c], .y = y[c], .y_se = se[c], .count = n};
    }
    report_page_plot(page, axes, curves, count);
}

/* One curve per measure, of one of the ladders. */
static void add_errors(report_page *page, const study *s, study_ladder ladder, const report_axes *axes,
                       double (*x_of)(const study_rung *))
{
    errors_of which[JUDGE_MEASURES];
    for (int m = 0; m < JUDGE_MEASURES; ++m)
        which[m] = (errors_of){judge_measure_name((judge_measure)m), ladder, (judge_measure)m, false};
    add_curves(page, s, which, JUDGE_MEASURES, axes, x_of);
}

static double cells_of(const study_rung *r)
{
    return (double)r->cells;
}

static double processor_seconds_of(const study_rung *r)
{
    return r->processor_seconds;
}

static double megabytes_of(const study_rung *r)
{
    return 1e-6 * (double)r->bytes;
}

static const char *percent(char text[48], judge_error e)
{
    snprintf(text, 48, "%.3g \u00b1 %.2g", 100 * e.rms, 100 * e.standard_error);
    return text;
}

static void add_rungs(report_page *page, const study *s)
{
    report_page_heading(page, "Every bake of the study");
    report_page_text(page, "Errors are relative RMS differences from the lamp's own light in %%, the noise of judging taken out; a "
                           "negative one is all noise. "
                           "Near: the RMS of five planes at 0.5, 1, 2, 5 and 10 sizes.");
    report_page_table(
        page, "ladder\tphotons\tcells\tseconds\tprocessor s\tMB\tnear\t0.5\t1\t2\t5\t10 sizes\tfar field\tluminance\tnoise, by "
              "the bake\tnear, plain bins");
    for (size_t i = 0; i < s->rung_count; ++i) {
        const study_rung *r = &s->rungs[i];
        char near[48], far[48], luminance[48], plain[48];
        report_page_row(page, "%s\t%.3g\t%.3g\t%.3g\t%.3g\t%.3g\t%s\t%.3g\t%.3g\t%.3g\t%.3g\t%.3g\t%s\t%s\t%.3g\t%s",
                        study_ladder_name(r->ladder), (double)r->photons, (double)r->cells, study_rung_seconds(r),
                        r->processor_seconds, megabytes_of(r), percent(near, r->verdict.error[JUDGE_NEAR]),
                        100 * r->verdict.planes[0].rms, 100 * r->verdict.planes[1].rms, 100 * r->verdict.planes[2].rms,
                        100 * r->verdict.planes[3].rms, 100 * r->verdict.planes[4].rms, percent(far, r->verdict.error[JUDGE_FAR]),
                        percent(luminance, r->verdict.error[JUDGE_LUMINANCE]), 100 * r->noise,
                        isfinite(r->plain.error[JUDGE_NEAR].rms) ? percent(plain, r->plain.error[JUDGE_NEAR]) : "\u2013");
    }
    report_page_table_end(page);
}

static void add_fits(report_page *page, const study *s)
{
    report_page_table(
        page, "measure\tslope of log error over log photons\tover log processor seconds\tof 10\u2076 photons, %\tnoise of the reference, %");
    for (int m = 0; m < JUDGE_MEASURES; ++m) {
        const study_fit *f = &s->fit[m];
        char photons[64], seconds[64];
        report_page_row(page, "%s\t%s\t%s\t%.3g\t%.3g", judge_measure_name((judge_measure)m),
                        report_slope_text(f->over_photons, "\u00b1", photons),
                        report_slope_text(f->over_seconds, "\u00b1", seconds), 100 * report_slope_y(f->over_photons, 1e6),
                        100 * s->reference_noise[m]);
    }
    report_page_table_end(page);
    report_page_text(page, "Slopes with what they are within at 95 %% confidence. Noise in the same cells alone has -0.5; more "
                           "photons are worth more cells, which blur less.");
}

static void add_advice(report_page *page, const study *s, const char *lamp)
{
    report_page_heading(page, "What to run");
    report_page_table(page, "near-field error\tcommand\tseconds, about\tMB, about");
    for (int t = 0; t < STUDY_TARGETS; ++t) {
        const study_advice *a = &s->advice[t];
        char command[1024];
        if (a->reachable)
            report_page_row(page, "%g %%\t%s\t%.2g\t%.2g", 100 * a->target, study_command(a, lamp, command, sizeof(command)),
                            a->seconds, 1e-6 * a->bytes);
        else
            report_page_row(page, "%g %%\tnot foretold; give the study more time\t\u2013\t\u2013", 100 * a->target);
    }
    report_page_table_end(page);
    report_page_text(page, "With the study's own --flux, --recipe, --no-recipe and --set, if it had any. By the power law of the errors below.");
}

static void add_methods(report_page *page, const study *s)
{
    static const errors_of PLAIN[] = {
        {"near", STUDY_CELLS, JUDGE_NEAR, false},
        {"near, plain bins", STUDY_CELLS, JUDGE_NEAR, true},
        {"far", STUDY_CELLS, JUDGE_FAR, false},
        {"far, plain bins", STUDY_CELLS, JUDGE_FAR, true},
        {"luminance", STUDY_CELLS, JUDGE_LUMINANCE, false},
        {"luminance, plain bins", STUDY_CELLS, JUDGE_LUMINANCE, true},
    };
    static const errors_of COMBINED[] = {
        {"near", STUDY_PHOTONS, JUDGE_NEAR, false},
        {"near, combined", STUDY_COMBINED, JUDGE_NEAR, false},
        {"far", STUDY_PHOTONS, JUDGE_FAR, false},
        {"far, combined", STUDY_COMBINED, JUDGE_FAR, false},
        {"luminance", STUDY_PHOTONS, JUDGE_LUMINANCE, false},
        {"luminance, combined", STUDY_COMBINED, JUDGE_LUMINANCE, false},
    };
    report_page_heading(page, "Other methods");
    report_page_text(
        page, "Plain bins: the same boxes with radiance constant within each cell, as a histogram has it, instead of linear.");
    add_curves(
        page, s, PLAIN, MOST_CURVES,
        &(report_axes){
            .title = "Plain bins and our reconstruction", .x = "cells", .y = "relative RMS error, %", .log_x = true, .log_y = true},
        cells_of);
    if (s->combined_why[0]) {
        report_page_text(page, "Photons and rays traced backwards, combined: not for this lamp. %s", s->combined_why);
        return;
    }
    report_page_text(page,
                     "Combined: photons and as many rays traced backwards into the lamp (bake --gather 1) as photons leave it.");
    add_curves(page, s, COMBINED, MOST_CURVES,
               &(report_axes){.title = "Photons only and combined",
                              .x = "processor seconds, all in",
                              .y = "relative RMS error, %",
                              .log_x = true,
                              .log_y = true},
               processor_seconds_of);
}

static void add_money(report_page *page, const study *s)
{
    const study_rung *top = NULL;
    for (size_t i = 0; i < s->rung_count; ++i)
        if (s->rungs[i].ladder == STUDY_PHOTONS)
            top = &s->rungs[i];
    if (!top)
        return;
    const double all = study_rung_seconds(top), deposit = s->deposit_share * top->trace_seconds;
    report_page_heading(page, "Where the time goes");
    report_page_text(page, "Of the largest bake of the ladder of photons, %.3g photons in %.3g s.", (double)top->photons, all);
    report_page_table(page, "part\tseconds\tshare, %");
    report_page_row(page, "pilot and layout\t%.3g\t%.3g", top->pilot_seconds, 100 * top->pilot_seconds / all);
    report_page_row(page, "tracing\t%.3g\t%.3g", top->trace_seconds - deposit, 100 * (top->trace_seconds - deposit) / all);
    report_page_row(page, "depositing\t%.3g\t%.3g", deposit, 100 * deposit / all);
    report_page_row(page, "reconstruction\t%.3g\t%.3g", top->reconstruct_seconds, 100 * top->reconstruct_seconds / all);
    report_page_row(page, "writing\t%.3g\t%.3g", top->write_seconds, 100 * top->write_seconds / all);
    report_page_table_end(page);
}

lmg_result study_report(const study *s, const char *lamp, const char *path, lmg_error *err)
{
    char title[160];
    snprintf(title, sizeof(title), "What accuracy costs in time: %.100s", lamp);
    report_page *page;
    lmg_result result = report_page_create(title, &page, err);
    if (result != LMG_OK)
        return result;
    report_page_text(page,
                     "Boxes of this lamp, judged by %.3g of its own rays on planes across %+g %+g %+g, far away and in luminance "
                     "pictures. Size %.4g m.",
                     (double)s->reference_photons, s->axis.x, s->axis.y, s->axis.z, s->size);
    add_advice(page, s, lamp);
    report_page_heading(page, "Error against time");
    add_errors(page, s, STUDY_PHOTONS,
               &(report_axes){.title = "Rising numbers of photons, in the cells that they are worth",
                              .x = "processor seconds, all in",
                              .y = "relative RMS error, %",
                              .log_x = true,
                              .log_y = true},
               processor_seconds_of);
    add_fits(page, s);
    report_page_heading(page, "Error against resolution and size");
    add_errors(page, s, STUDY_CELLS,
               &(report_axes){.title = "Rising numbers of cells, the same photons",
                              .x = "cells",
                              .y = "relative RMS error, %",
                              .log_x = true,
                              .log_y = true},
               cells_of);
    add_errors(
        page, s, STUDY_CELLS,
        &(report_axes){
            .title = "The same, by the size of the file", .x = "MB", .y = "relative RMS error, %", .log_x = true, .log_y = true},
        megabytes_of);
    add_methods(page, s);
    add_money(page, s);
    add_rungs(page, s);
    result = report_page_write(page, path, err);
    report_page_destroy(page);
    return result;
}
