/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reports: one self-contained HTML file with tables, text and plots.  Plots are SVG drawn by gnuplot (a program, called once per
 * plot), set into the page, so that a report needs nothing beside it.
 */
#ifndef REPORT_PAGE_H
#define REPORT_PAGE_H

#include <lumigraph/lumigraph.h>

typedef struct report_page report_page;

/* An empty page.  Content goes on in the order of the calls; calls after a failure do nothing, and report_page_write reports the
 * first one.  Texts are plain: what HTML means something by is escaped. */
lmg_result report_page_create(const char *title, report_page **out, lmg_error *err);
void report_page_destroy(report_page *page);

void report_page_heading(report_page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));
void report_page_text(report_page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Tables: columns and cells are parts of one text, separated by tabs.  The first column is left-aligned, the others right. */
void report_page_table(report_page *page, const char *columns);
void report_page_row(report_page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));
void report_page_table_end(report_page *page);

/* One curve: count points; y_se may be NULL (no error bars).  Points that aren't finite are left out, and on a logarithmic axis
 * those <= 0. */
typedef struct report_curve {
    const char *name;
    const double *x, *y, *y_se;
    size_t count;
} report_curve;

typedef struct report_axes {
    const char *title, *x, *y; /* labels with units */
    bool log_x, log_y;
} report_axes;

void report_page_plot(report_page *page, const report_axes *axes, const report_curve *curves, size_t count);

/* Polar plot of the photometric kind: angle 0 points down, x of the curves is the angle in degrees (-180 .. 180), y the radius. */
void report_page_polar(report_page *page, const char *title, const report_curve *curves, size_t count);

/* A picture of nx * ny values, rows from the bottom, from dark to bright between least and most; diverging: blue - white - red
 * about the middle of that range. */
typedef struct report_map {
    const char *title, *unit;
    const double *values;
    uint32_t nx, ny;
    double width, height; /* metres */
    double least, most;
    bool diverging;
} report_map;

/* Several maps side by side. */
void report_page_maps(report_page *page, const report_map *maps, size_t count);

/* Writes the page beside its final name and renames it.  Errors: what went wrong first while the page was made (LMG_ERROR_MEMORY,
 * LMG_ERROR_UNSUPPORTED when gnuplot can't be run: the message says how to install it), LMG_ERROR_FILE_WRITE. */
lmg_result report_page_write(report_page *page, const char *path, lmg_error *err);

#endif
