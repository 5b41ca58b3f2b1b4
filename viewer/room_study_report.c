/* SPDX-License-Identifier: Apache-2.0 */
/* The study of a room as a page: error against time and samples, times at equal error, every rung. */
#include "room_study.h"

#include "page.h"

#include <math.h>
#include <stdio.h>

static double seconds_of(const view_study_rung *r)
{
    return r->seconds;
}

static double samples_of(const view_study_rung *r)
{
    return r->samples;
}

/* Both methods' errors and medians over x(rung). */
static void add_errors(report_page *page, const view_study *s, const char *title, const char *label,
                       double (*x_of)(const view_study_rung *))
{
    static const char *const NAMES[VIEW_STUDY_METHODS][2] = {{"box", "box, median block"}, {"geometry", "geometry, median block"}};
    double x[VIEW_STUDY_METHODS][VIEW_STUDY_MAX_RUNGS], y[VIEW_STUDY_METHODS][VIEW_STUDY_MAX_RUNGS];
    double se[VIEW_STUDY_METHODS][VIEW_STUDY_MAX_RUNGS], median[VIEW_STUDY_METHODS][VIEW_STUDY_MAX_RUNGS];
    report_curve curves[2 * VIEW_STUDY_METHODS];
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        const view_study_result *r = &s->of[m];
        for (size_t k = 0; k < r->rung_count; k++) {
            x[m][k] = x_of(&r->rungs[k]);
            y[m][k] = 100 * r->rungs[k].error.rms;
            se[m][k] = 100 * r->rungs[k].error.standard_error;
            median[m][k] = 100 * r->rungs[k].median;
        }
        curves[m] = (report_curve){.name = NAMES[m][0], .x = x[m], .y = y[m], .y_se = se[m], .count = r->rung_count};
        curves[VIEW_STUDY_METHODS + m] = (report_curve){.name = NAMES[m][1], .x = x[m], .y = median[m], .count = r->rung_count};
    }
    const report_axes axes = {.title = title, .x = label, .y = "relative error of blocks, %", .log_x = true, .log_y = true};
    report_page_plot(page, &axes, curves, 2 * VIEW_STUDY_METHODS);
}

static void add_fits(report_page *page, const view_study *s)
{
    report_page_table(
        page, "lit by\tslope over time\tover samples\tof the median block over time\terror\u00b2 x time, s\tmedian block, s");
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        const view_study_result *r = &s->of[m];
        char time[64], samples[64], median[64];
        report_page_row(page, "%s\t%s\t%s\t%s\t%.3g \u00b1 %.2g\t%.3g", view_study_method_name((view_study_method)m),
                        report_slope_text(r->over_seconds, "\u00b1", time), report_slope_text(r->over_samples, "\u00b1", samples),
                        report_slope_text(r->median_over_seconds, "\u00b1", median), r->cost, r->cost_se, r->cost_median);
    }
    report_page_table_end(page);
    report_page_text(page, "Slopes are of log(error), by regression, with what they are within at 95 %% confidence; noise alone "
                           "has -0.5. Error\u00b2 x time is what doesn't change with time then: the "
                           "processor seconds to a relative error of 100 %%, with its standard error.");
}

static void add_ratio(report_page *page, const view_study *s)
{
    static const double ERRORS[] = {0.1, 0.05, 0.02, 0.01, 0.005};
    report_page_heading(page, "Time at equal error");
    report_page_text(
        page,
        "The geometry takes %.3g \u00b1 %.2g times as long as the box for the same error (root mean square over blocks), %.3g "
        "times "
        "by the median block, which rare bright paths can't carry. Where its errors are flat (slope nearer to 0 than to "
        "-0.5) it hasn't found its light yet, and that is a lower bound.",
        s->ratio, s->ratio_se, s->ratio_median);
    report_page_text(page,
                     "All pictures by the geometry together differ from the reference by %.3g \u00b1 %.2g %% more than their "
                     "spread explains (negative: "
                     "less). If the geometry has found its light, this is what the box is off by: the error of its bake, what its "
                     "cells blur, the lamp's own body in the room.",
                     100 * s->difference.rms, 100 * s->difference.standard_error);
    report_page_table(page, "error\tbox, processor seconds\tgeometry, processor seconds");
    for (size_t i = 0; i < sizeof ERRORS / sizeof ERRORS[0]; i++) {
        const double square = ERRORS[i] * ERRORS[i];
        report_page_row(page, "%g %%\t%.3g\t%.3g", 100 * ERRORS[i], s->of[VIEW_STUDY_BOX].cost / square,
                        s->of[VIEW_STUDY_GEOMETRY].cost / square);
    }
    report_page_table_end(page);
}

static void add_rungs(report_page *page, const view_study *s)
{
    report_page_heading(page, "Every rung");
    report_page_text(page, "Means of %u pictures each; the error of an error is from their spread.", s->runs);
    report_page_table(page, "lit by\tsamples per pixel\tprocessor seconds\terror, %\tmedian block, %");
    for (int m = 0; m < VIEW_STUDY_METHODS; m++) {
        for (size_t k = 0; k < s->of[m].rung_count; k++) {
            const view_study_rung *r = &s->of[m].rungs[k];
            report_page_row(page, "%s\t%u\t%.3g\t%.3g \u00b1 %.2g\t%.3g", view_study_method_name((view_study_method)m), r->samples,
                            r->seconds, 100 * r->error.rms, 100 * r->error.standard_error, 100 * r->median);
        }
    }
    report_page_table_end(page);
}

lmg_result view_study_report(const view_study *s, const char *room, const char *lights, const char *path, lmg_error *err)
{
    char title[256];
    snprintf(title, sizeof title, "What accuracy of a picture costs in time: %.60s lit by %.120s", room, lights);
    report_page *page;
    lmg_result result = report_page_create(title, &page, err);
    if (result != LMG_OK) {
        return result;
    }
    report_page_text(page,
                     "%u x %u pixels, %u blocks of %u x %u (%u with the lamp itself and %u dark ones left out). Errors are "
                     "deviations of blocks' mean "
                     "luminance from a picture with %u samples per pixel and random numbers of its own (lit by the box, %.3g s, "
                     "its noise of %.2g %% "
                     "taken out), root mean square.",
                     s->width, s->height, s->blocks, s->block, s->block, s->lamp_blocks, s->dark_blocks, s->reference_samples,
                     s->reference_seconds, 100 * s->reference_noise);
    report_page_heading(page, "Error against time");
    add_errors(page, s, "The same room lit by the box and by the geometry", "processor seconds of a picture", seconds_of);
    add_fits(page, s);
    add_ratio(page, s);
    report_page_heading(page, "Error against samples");
    add_errors(page, s, "The same by samples per pixel", "samples per pixel", samples_of);
    add_rungs(page, s);
    result = report_page_write(page, path, err);
    report_page_destroy(page);
    return result;
}
