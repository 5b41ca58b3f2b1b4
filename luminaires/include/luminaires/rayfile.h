/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Ray files: measured or simulated light sources as lists of rays.  Read and written: IES TM-25, Zemax source files (binary and
 * text), LightTools ray data (binary and ASCII); docs/rayfiles.md tells what each holds and what is lost.
 *
 * A file is opened once (header, units, sizes: everything is checked against the file's true length) and decoded by any number of
 * readers, one per thread, in any order; memory doesn't depend on the file's size.  Positions become metres, directions unit
 * vectors.  Files are untrusted: a number that can't be (not finite, a direction that isn't one, a negative flux) is an error that
 * names the ray, never a value.
 */
#ifndef LUMINAIRES_RAYFILE_H
#define LUMINAIRES_RAYFILE_H

#include <lumigraph/lumigraph.h>

typedef enum lum_ray_format {
    LUM_RAYS_NONE = 0,
    LUM_RAYS_TM25,
    LUM_RAYS_ZEMAX,
    LUM_RAYS_ZEMAX_TEXT,
    LUM_RAYS_LIGHTTOOLS,
    LUM_RAYS_LIGHTTOOLS_TEXT
} lum_ray_format;

/* "IES TM-25", ...; static storage. */
const char *lum_ray_format_name(lum_ray_format format);

/* The format that a name of an output asks for by its ending: .tm25ray TM-25, .dat Zemax binary, .ray LightTools binary (case
 * doesn't matter); LUM_RAYS_NONE for any other. */
lum_ray_format lum_ray_format_of_name(const char *path);

/* The format of a file by its first bytes (and, of plain columns of numbers, by its first line); LUM_RAYS_NONE when it is none or
 * can't be opened. */
lum_ray_format lum_ray_format_of_file(const char *path);

/* What the flux of decoded rays is to be. */
typedef enum lum_ray_flux {
    LUM_RAY_LIGHT = 0, /* lumens where the file allows it (stored, or computed from watts and wavelengths), else watts */
    LUM_RAY_POWER = 1, /* watts; an error when the file has none */
    LUM_RAY_STORED = 2 /* as stored: watts if rays carry wavelengths, else lumens if there are, else watts */
} lum_ray_flux;

enum { LUM_RAY_TEXTS = 9 }; /* of TM-25: source, maker, model's and file's creator, equipment, camera, operation, remarks, reference */

typedef struct lum_ray_info {
    lum_ray_format format;
    uint64_t rays;
    bool photometric;                 /* decoded flux is in lumens, else in watts */
    double luminous_lm, radiant_W;    /* totals that the header tells; NAN = it doesn't */
    bool has_luminous, has_radiant;   /* which fluxes the rays carry */
    bool has_wavelength;              /* each ray its own, nm */
    bool has_tristimulus;
    double wavelength_nm;             /* one for all rays; NAN = none */
    uint32_t spectra;                 /* spectral tables */
    bool has_spectrum_index;          /* each ray names its table */
    bool has_polarization;            /* Stokes parameters, skipped */
    uint32_t extra_columns;           /* further columns, skipped */
    uint32_t record_bytes;            /* of a ray; 0: text */
    char date[32];
    const char *texts[LUM_RAY_TEXTS]; /* UTF-8, "" = none; storage of the file */
} lum_ray_info;

typedef struct lum_rayfile lum_rayfile;

/* Opens a ray file.  Errors: LMG_ERROR_FILE_OPEN, LMG_ERROR_FILE_READ (cut off), LMG_ERROR_FILE_FORMAT (contradicts itself),
 * LMG_ERROR_UNSUPPORTED (a variant whose layout isn't public, or watts asked for where there are lumens only). */
lmg_result lum_rayfile_open(const char *path, lum_ray_flux flux, lum_rayfile **out, lmg_error *err);

/* The same from memory, which is borrowed until close.  name stands for the path in messages. */
lmg_result lum_rayfile_open_memory(const void *bytes, size_t size, const char *name, lum_ray_flux flux, lum_rayfile **out,
                                   lmg_error *err);
void lum_rayfile_close(lum_rayfile *file);

const lum_ray_info *lum_rayfile_info(const lum_rayfile *file);

/* What a user should know of this file (things skipped, quirks, how lumens were found), one line each; NULL past the end. */
const char *lum_rayfile_remark(const lum_rayfile *file, size_t i);

/* The common R,G,B (luminance 1) of all rays when they have one; false when rays have colours of their own. */
bool lum_rayfile_colour(const lum_rayfile *file, float rgb[3]);

/* One thread's way through a file. */
typedef struct lum_ray_reader lum_ray_reader;
enum { LUM_RAY_BLOCK = 4096 }; /* rays a reader decodes at once, at most */

lmg_result lum_ray_reader_create(const lum_rayfile *file, lum_ray_reader **out, lmg_error *err);
void lum_ray_reader_destroy(lum_ray_reader *reader);

/* Decodes rays first .. first+count-1 (count up to LUM_RAY_BLOCK, all within the file).  flux: lumens or watts (info.photometric) x
 * scale, as R,G,B with that luminance; number: the ray's place in the file. */
lmg_result lum_ray_reader_read(lum_ray_reader *reader, uint64_t first, size_t count, double scale, lmg_ray *rays, lmg_error *err);

/* ------------------------------------------------------------------------------------------------------------- writing */

typedef struct lum_ray_writer_options {
    lum_ray_format format;
    bool photometric;  /* flux is lumens, else watts */
    bool tristimulus;  /* TM-25 only: the rays' colours as X and Z beside Y (needs photometric) */
    bool wavelength;   /* each ray's wavelength (needs watts in TM-25 and Zemax files) */
    const char *source, *software, *remarks; /* texts for the header; NULL = none */
} lum_ray_writer_options;

/* A file that grows beside its final name and gets it when finished.  Ray count and total flux are filled in at the end. */
typedef struct lum_ray_writer lum_ray_writer;

/* Errors: LMG_ERROR_FILE_OPEN, and LMG_ERROR_UNSUPPORTED for what the format can't hold. */
lmg_result lum_ray_writer_create(const char *path, const lum_ray_writer_options *options, lum_ray_writer **out, lmg_error *err);

/* Appends rays; flux x scale is in lumens or watts. */
lmg_result lum_ray_writer_append(lum_ray_writer *writer, const lmg_ray *rays, size_t count, double scale, lmg_error *err);

/* Completes the file and gives it its name; total (may be NULL): the flux written.  The writer is gone afterwards, also on error. */
lmg_result lum_ray_writer_finish(lum_ray_writer *writer, double *total, lmg_error *err);

/* Gives up: nothing is left behind.  NULL is allowed. */
void lum_ray_writer_abandon(lum_ray_writer *writer);

#endif
