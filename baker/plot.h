/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Reports: one self-contained HTML file with tables, text and plots.  Plots are SVG drawn by gnuplot (a program, called once per
 * plot), set into the page, so that a report needs nothing beside it.
 */
#ifndef BAKER_PLOT_H
#define BAKER_PLOT_H

#include <lumigraph/lumigraph.h>

typedef struct bake_page bake_page;

/* An empty page.  Content goes on in the order of the calls; calls after a failure do nothing, and bake_page_write reports the
 * first one.  Texts are plain: what HTML means something by is escaped. */
lmg_result bake_page_create(const char *title, bake_page **out, lmg_error *err);
void bake_page_destroy(bake_page *page);

void bake_page_heading(bake_page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));
void bake_page_text(bake_page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Tables: columns and cells are parts of one text, separated by tabs.  The first column is left-aligned, the others right. */
void bake_page_table(bake_page *page, const char *columns);
void bake_page_row(bake_page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));
void bake_page_table_end(bake_page *page);

/* One curve: count points; y_se may be NULL (no error bars).  Points that aren't finite are left out, and on a logarithmic axis
 * those <= 0. */
typedef struct bake_curve {
    const char *name;
    const double *x, *y, *y_se;
    size_t count;
} bake_curve;

typedef struct bake_axes {
    const char *title, *x, *y; /* labels with units */
    bool log_x, log_y;
} bake_axes;

void bake_page_plot(bake_page *page, const bake_axes *axes, const bake_curve *curves, size_t count);

/* Polar plot of the photometric kind: angle 0 points down, x of the curves is the angle in degrees (-180 .. 180), y the radius. */
void bake_page_polar(bake_page *page, const char *title, const bake_curve *curves, size_t count);

/* A picture of nx * ny values, rows from the bottom, from dark to bright between least and most; diverging: blue - white - red
 * about the middle of that range. */
typedef struct bake_map {
    const char *title, *unit;
    const double *values;
    uint32_t nx, ny;
    double width, height; /* metres */
    double least, most;
    bool diverging;
} bake_map;

/* Several maps side by side. */
void bake_page_maps(bake_page *page, const bake_map *maps, size_t count);

/* Writes the page beside its final name and renames it.  Errors: what went wrong first while the page was made (LMG_ERROR_MEMORY,
 * LMG_ERROR_UNSUPPORTED when gnuplot can't be run: the message says how to install it), LMG_ERROR_FILE_WRITE. */
lmg_result bake_page_write(bake_page *page, const char *path, lmg_error *err);

#endif
