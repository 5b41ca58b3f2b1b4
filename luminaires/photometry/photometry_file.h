/* SPDX-License-Identifier: Apache-2.0 */
/* What the readers and writers of photometric files share: text in, text out, symmetry, messages.  Inside luminaires/photometry
 * only. */
#ifndef LUMINAIRES_PHOTOMETRY_FILE_H
#define LUMINAIRES_PHOTOMETRY_FILE_H

#include <luminaires/photometry.h>

#include <stdarg.h>

/* ------------------------------------------------------------------------------------------------------------- reading */

/* A file's text as UTF-8 with '\n' line ends: from UTF-8 (a byte order mark is dropped) or, where it isn't UTF-8, Latin-1.  Ends
 * with a NUL; NULs inside make it an error (not a text file).  To be freed. */
lmg_result lum_text_decode(const uint8_t *bytes, size_t size, char **text, lmg_error *err);

/* The number that the whole of text[0..length) stands for: decimal, with e/E/d/D exponents; no hex, inf or nan.  False if it is
 * none, or not finite. */
bool lum_parse_number(const char *text, size_t length, double *value);

/* Remarks on the file, joined by "; ". */
void lum_photometry_warn(lum_photometry *p, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Appends a keyword; text is cut at line ends and stripped of blanks at both sides. */
lmg_result lum_photometry_add_keyword(lum_photometry *p, const char *name, const char *value, size_t length, lmg_error *err);

/* Finds the symmetry that the horizontal angles of a file stand for and brings 90..270 (LM-63-1995) to -90..90. */
lmg_result lum_photometry_settle_symmetry(lum_photometry *p, lmg_error *err);

/* The largest number of intensities that a file of so many bytes can hold (a digit and a separator each): counts beyond it are
 * refused before memory is asked for. */
static inline bool lum_count_fits(uint64_t h, uint64_t v, size_t size)
{
    return h >= 1 && v >= 1 && h <= LUM_MAX_ANGLES && v <= LUM_MAX_ANGLES && h * v <= size;
}

lmg_result lum_ies_read(const char *text, const char *path, lum_photometry **out,
                        lmg_error *err); /* path: for TILT files, or NULL */
lmg_result lum_eulumdat_read(const char *text, lum_photometry **out, lmg_error *err);
lmg_result lum_tm33_read(const char *bytes, size_t size, lum_photometry **out, lmg_error *err);

/* LM-63's width, length, height (metres here) as a shape, by the rules of 2002 and later or by those before; false: no rule fits.
 */
bool lum_ies_shape(double width, double length, double height, bool rules_2002, lum_shape *out);

/* ------------------------------------------------------------------------------------------------------------- writing */

/* Text that grows; out of memory shows in `failed` and is reported once at the end. */
typedef struct lum_output {
    char *text;
    size_t size, capacity;
    bool failed;
} lum_output;

void lum_output_add(lum_output *o, const char *bytes, size_t count);
void lum_output_print(lum_output *o, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* A number with as few digits (at most 9) as give it back to one part in 10^9. */
void lum_format_number(char out[32], double value);
/* Appends UTF-8 text as Latin-1, '?' for what that lacks and for control characters. */
void lum_output_latin1(lum_output *o, const char *utf8, size_t length);
/* Writes bytes beside path and renames. */
lmg_result lum_write_whole_file(const char *path, const void *bytes, size_t size, lmg_error *err);

/* What a format can't keep, joined by "; ". */
void lum_note_loss(char loss[512], const char *format, ...) __attribute__((format(printf, 2, 3)));

void lum_ies_write(const lum_photometry *p, bool version_2019, const lum_photometry_write_options *options, lum_output *o,
                   char loss[512]);
void lum_eulumdat_write(const lum_photometry *p, const lum_photometry_write_options *options, double flux, double down,
                        lum_output *o, char loss[512]);
lmg_result lum_tm33_write(const lum_photometry *p, const lum_photometry_write_options *options, double flux, lum_output *o,
                          char loss[512], lmg_error *err);
void lum_usd_write(const lum_photometry *p, const char *ies_name, double flux, lum_output *o);
lmg_result lum_gltf_write(const lum_photometry *p, const lum_output *ies, double flux, lum_output *o, lmg_error *err);
lmg_result lum_goniometric_write(const lum_photometry *p, const char *path, uint32_t resolution, lmg_error *err);

/* The date of a document: options->date, or today's (UTC). */
void lum_document_date(const lum_photometry_write_options *options, char out[32]);

/* ------------------------------------------------------------------------------------------------------------- the grid */

/* Horizontal cells of the stored grid: between neighbours, for a whole circle also from the last plane to the first; one for axial
 * symmetry. */
uint32_t lum_grid_h_cells(const lum_photometry *p);
/* Borders (degrees) of horizontal cell i and the planes at both. */
void lum_grid_h_cell(const lum_photometry *p, uint32_t i, double *h0, double *h1, uint32_t *plane0, uint32_t *plane1);
/* How many times the stored sector is there in all directions: 1, 2 or 4. */
double lum_grid_copies(const lum_photometry *p);
/* Direction of the stored angles (h, v), degrees. */
lmg_vec3 lum_grid_direction(const lum_photometry *p, double h, double v);
/* Integrals over an interval of a linear function's two end values, in radians: with weight sin(x) (x0, x1 degrees). */
void lum_sine_weights(double x0, double x1, double *w0, double *w1);
/* Exact flux of the interpolated intensity in horizontal cell i and vertical cell j (of the stored sector alone). */
double lum_grid_cell_flux(const lum_photometry *p, uint32_t i, uint32_t j);

#endif
