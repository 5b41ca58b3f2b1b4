/* SPDX-License-Identifier: Apache-2.0 */
/* Inside ray files: every format's header becomes one description of records, which one decoder reads. */
#ifndef LUMINAIRES_RAYFILE_INSIDE_H
#define LUMINAIRES_RAYFILE_INSIDE_H

#include <luminaires/rayfile.h>

#include <string.h>

enum {
    RAY_MAX_REMARKS = 12,
    RAY_REMARK_SIZE = 200,
    RAY_MAX_COLUMNS = 4096,    /* floats in a record */
    RAY_MAX_LINE = 1024,       /* characters in a line of a text file */
    RAY_INDEX_ENTRIES = 65536, /* of a text file's index of lines: its stride doubles when they are used up */
};

/* Where things are in a record of floats; -1 = absent. */
typedef struct ray_columns {
    int position, direction; /* first of three */
    int luminous, radiant, wavelength, x, z, spectrum;
    uint32_t count;          /* floats in a record */
} ray_columns;

/* What a radiant watt of a table or wavelength is worth, and its colour. */
typedef struct ray_spectrum {
    double lumens_per_watt;
    float rgb[3]; /* luminance 1 */
} ray_spectrum;

struct lum_rayfile {
    lum_ray_info info;
    char *name; /* for messages */
    int descriptor;       /* -1: memory */
    const uint8_t *memory;
    uint64_t size;        /* bytes */

    ray_columns columns;
    uint64_t start;       /* of the first record or line */
    double metres;        /* per unit of length of the file */
    double origin[3];     /* added, in units of the file */
    double nanometres;    /* per unit of wavelength of the file */

    /* How the decoded flux comes about: the column, times constant, times lumens per watt of the wavelength or table. */
    int flux_column;
    double flux_constant;
    bool flux_by_wavelength, flux_by_spectrum;
    bool own_colours;     /* rays have colours of their own, else: */
    float colour[3];

    uint32_t spectrum_count;
    ray_spectrum *spectra;

    /* Text files: byte offset of every index_stride-th line of data. */
    uint64_t *index;
    size_t index_count;
    uint64_t index_stride;
    uint64_t end; /* of the lines of data */

    char *texts; /* storage of info.texts */
    size_t remark_count;
    char remarks[RAY_MAX_REMARKS][RAY_REMARK_SIZE];
};

/* Gets bytes: a pointer into memory, or reads into buffer. Fails (LMG_ERROR_FILE_READ) when the file ends before. */
lmg_result lum_ray_fetch(const lum_rayfile *file, uint64_t offset, size_t count, void *buffer, const uint8_t **out, lmg_error *err);

/* Adds a remark; those beyond RAY_MAX_REMARKS are left out. */
void lum_ray_remark(lum_rayfile *file, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Headers.  Each sets info, columns, start, metres, origin, nanometres. */
lmg_result lum_ray_open_tm25(lum_rayfile *file, lmg_error *err);
lmg_result lum_ray_open_zemax(lum_rayfile *file, lmg_error *err);
lmg_result lum_ray_open_lighttools(lum_rayfile *file, lmg_error *err);
lmg_result lum_ray_open_zemax_text(lum_rayfile *file, lmg_error *err);
lmg_result lum_ray_open_lighttools_text(lum_rayfile *file, lmg_error *err);

/* Parses count rows of numbers of a text file from its row `first` on into floats, columns.count each. */
lmg_result lum_ray_text_rows(const lum_rayfile *file, uint64_t first, size_t count, char *buffer, size_t buffer_size, float *rows,
                             lmg_error *err);

/* Whether n records at `start` could be rays: unit directions to a hundredth, finite positions. */
bool lum_ray_plausible(const lum_rayfile *file, uint64_t start, uint64_t first, size_t n);

/* Columns of Zemax and LightTools rays: position (if there), direction, flux, wavelength (if there). */
void lum_ray_set_columns(lum_rayfile *file, bool positions, bool photometric, bool wavelength);

/* Zemax's units of length 0 to 4: m, inch, cm, foot, mm. */
static const double RAY_ZEMAX_METRES[5] = {1, 0.0254, 0.01, 0.3048, 0.001};

/* A watt of one wavelength: its lumens and colour (of the nearest visible wavelength where the eye sees nothing). */
void lum_ray_monochrome(double nm, ray_spectrum *out);

/* R,G,B of luminance 1 with X/Y = x and Z/Y = z. */
void lum_ray_rgb(double x, double z, float rgb[3]);

/* The same of a table of count pairs (nm, weight). */
void lum_ray_tabulated(const float *pairs, size_t count, ray_spectrum *out);

/* Decides what decoded flux and colour are; after the header. */
lmg_result lum_ray_decide_flux(lum_rayfile *file, lum_ray_flux flux, lmg_error *err);

static inline uint32_t ray_u32(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static inline int32_t ray_i32(const uint8_t *p)
{
    const uint32_t bits = ray_u32(p);
    int32_t value;
    memcpy(&value, &bits, sizeof(value));
    return value;
}

static inline float ray_f32(const uint8_t *p)
{
    const uint32_t bits = ray_u32(p);
    float value;
    memcpy(&value, &bits, sizeof(value));
    return value;
}

/* Whether a float is a NaN, or one whose bytes were written in the wrong order: such a "not known" reads as 2.36e-38, which looks
 * harmless and isn't a quantity of anything. */
bool lum_ray_unknown(float value);

static inline void ray_put_u32(uint8_t *p, uint32_t value)
{
    p[0] = (uint8_t)value;
    p[1] = (uint8_t)(value >> 8);
    p[2] = (uint8_t)(value >> 16);
    p[3] = (uint8_t)(value >> 24);
}

static inline void ray_put_f32(uint8_t *p, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof(bits));
    ray_put_u32(p, bits);
}

#endif
