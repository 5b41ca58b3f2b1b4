/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Far-field photometry: the luminous intensity of a luminaire over all directions, as IES LM-63, EULUMDAT and TM-33 files carry it.
 * All readers give, and all writers take, one type, lum_photometry: a grid of candela, the luminous shape, lamps and keywords.
 *
 * Frame.  Photometry looks at a luminaire as it hangs: gamma 0 is straight down, C counts counter-clockwise seen from above.  In the
 * luminaire's own frame (glTF: +Y up) that is
 *
 *     down (gamma 0) = -Y     C0 (gamma 90) = +X     C90 = -Z     C180 = -X     C270 = +Z
 *
 * Threads: const calls on one object are safe together.  Nothing prints or exits.  docs/photometry.md says what each format keeps.
 */
#ifndef LUMINAIRES_PHOTOMETRY_H
#define LUMINAIRES_PHOTOMETRY_H

#include <luminaires/rng.h>
#include <lumigraph/lumigraph.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ------------------------------------------------------------------------------------------------------------- the type */

/* How the grid's angles name a direction (numbers as in LM-63).  v is the vertical, h the horizontal angle, degrees.
 * C: v = gamma from straight down, h = C.
 * B: planes share the horizontal axis C90-C270; v turns from straight down (0) towards C0 (90), h leans out of that plane towards C270.
 * A: planes share the vertical axis; v = -90 is straight down, 0 horizontal, h turns clockwise (h = -C). */
typedef enum lum_photometry_type { LUM_TYPE_C = 1, LUM_TYPE_B = 2, LUM_TYPE_A = 3 } lum_photometry_type;

/* What the stored planes stand for. */
typedef enum lum_symmetry {
    LUM_SYMMETRY_NONE = 0,     /* type C: the whole circle (the last plane joins the first); A, B: dark outside the stored angles */
    LUM_SYMMETRY_AXIAL = 1,    /* one plane for all */
    LUM_SYMMETRY_C0_C180 = 2,  /* h in [0,180], mirrored on the plane C0-C180 */
    LUM_SYMMETRY_C90_C270 = 3, /* h in [-90,90], mirrored on the plane C90-C270 */
    LUM_SYMMETRY_QUADRANT = 4, /* h in [0,90], mirrored on both */
    LUM_SYMMETRY_LATERAL = 5   /* types A and B: h in [0,90], the same for -h */
} lum_symmetry;

/* What shines, as photometric files describe it.  Extents along C0-C180, along C90-C270 and vertical; a rectangle with one extent 0 is
 * a line.  Flat shapes are horizontal unless named otherwise. */
typedef enum lum_shape_kind {
    LUM_SHAPE_POINT = 0,
    LUM_SHAPE_RECTANGLE = 1,       /* also lines, and with height alone or with one extent 0 an upright line or rectangle */
    LUM_SHAPE_BOX = 2,             /* rectangle with luminous sides */
    LUM_SHAPE_ELLIPSE = 3,         /* disc when both extents are equal */
    LUM_SHAPE_CYLINDER = 4,        /* upright, elliptic if its extents differ */
    LUM_SHAPE_CYLINDER_C0 = 5,     /* lying along C0-C180; elliptic across */
    LUM_SHAPE_CYLINDER_C90 = 6,    /* lying along C90-C270 */
    LUM_SHAPE_ELLIPSOID = 7,       /* sphere when all are equal */
    LUM_SHAPE_ELLIPSE_FACING_C0 = 8 /* upright disc or ellipse that faces C0, gamma 90; extents c90 and height */
} lum_shape_kind;

typedef struct lum_shape {
    lum_shape_kind kind;
    double c0, c90, height; /* metres, >= 0 */
} lum_shape;

typedef struct lum_keyword {
    char *name, *value; /* UTF-8, one line each; LM-63 keyword without brackets ("MANUFAC") */
} lum_keyword;

typedef struct lum_lamp_set {
    int count;         /* lamps in the set, >= 1 */
    double flux;       /* lumens of the set together, 0 = not known */
    double power;      /* watts of the set with its gear, 0 = not known */
    char type[64], colour[32], cri[32]; /* UTF-8 */
} lum_lamp_set;

enum { LUM_MAX_LAMP_SETS = 20, LUM_DIRECT_RATIOS = 10 };

/* Losses of a lamp that burns tilted, from TILT=INCLUDE or a TILT file.  Kept, and never applied: intensities are for the position in
 * which they were measured. */
typedef struct lum_tilt {
    int geometry; /* 1 upright, 2 horizontal, 3 horizontal and tilting with the luminaire; 0 = no table */
    uint32_t count;
    double *angles, *factors; /* degrees; both count long */
} lum_tilt;

typedef struct lum_photometry {
    lum_photometry_type type;
    lum_symmetry symmetry;
    uint32_t h_count, v_count;
    double *h, *v;         /* degrees, strictly increasing; h one value only with LUM_SYMMETRY_AXIAL */
    double *intensity;     /* cd (or unit), [ih * v_count + iv], >= 0; all multipliers and ballast factors applied */
    char unit[16];         /* "cd"; "mW/sr" and the like when the file says that it was measured in other units */
    bool absolute;         /* absolute photometry: no lamp flux to refer to */
    lum_shape shape;
    double housing[3];     /* metres: along C0, along C90, height; 0 = not known */
    uint32_t lamp_set_count;
    lum_lamp_set lamp_sets[LUM_MAX_LAMP_SETS];
    double power;          /* watts of the luminaire, 0 = not known */
    double ballast_factor; /* as read; already applied.  1 = none */
    lum_tilt tilt;
    uint32_t keyword_count;
    lum_keyword *keywords; /* in the order of the file */
    bool has_direct_ratios; /* EULUMDAT: utilance for ten room indices, k = 0.6 .. 5 */
    double direct_ratios[LUM_DIRECT_RATIOS];
    double measured_tilt;  /* degrees: tilt of the luminaire during measurement (road luminaires) */
    double side_heights[4];/* metres: EULUMDAT's luminous heights in C0, C90, C180, C270; box and cylinder have their mean */
    char format[64];       /* what was read: "IESNA:LM-63-2002", "EULUMDAT", "IESTM33-22 1.1", ... */
    char warnings[512];    /* what was odd but readable, joined by "; "; empty = nothing */
} lum_photometry;

/* Makes an empty distribution with a grid of h_count x v_count zeros; type C, point, 1 lamp, unit cd.  To be filled by the caller and
 * then checked.  Counts: 1..LUM_MAX_ANGLES each.  Destroyed by lum_photometry_destroy, which accepts NULL. */
enum { LUM_MAX_ANGLES = 14401 };
lmg_result lum_photometry_create(uint32_t h_count, uint32_t v_count, lum_photometry **out, lmg_error *err);
lmg_result lum_photometry_copy(const lum_photometry *p, lum_photometry **out, lmg_error *err);
void lum_photometry_destroy(lum_photometry *p);

/* What every reader demands of its result and every writer of its input: angles finite, increasing and in the range that type and
 * symmetry ask for, intensities finite and >= 0, sizes in [0, 1000] m. */
lmg_result lum_photometry_check(const lum_photometry *p, lmg_error *err);

/* Keywords: the first of that name, or NULL; set replaces or appends, value NULL removes. */
const char *lum_photometry_keyword(const lum_photometry *p, const char *name);
lmg_result lum_photometry_set_keyword(lum_photometry *p, const char *name, const char *value, lmg_error *err);

/* --------------------------------------------------------------------------------------------------------------- files */

typedef enum lum_photometry_format {
    LUM_FORMAT_AUTO = 0,     /* reading: by content; writing: by the name's ending */
    LUM_FORMAT_IES = 1,      /* .ies: LM-63-1986 .. 2019; written as 2019 */
    LUM_FORMAT_IES_2002 = 2, /* writing only */
    LUM_FORMAT_EULUMDAT = 3, /* .ldt */
    LUM_FORMAT_TM33 = 4,     /* .xml */
    LUM_FORMAT_GONIOMETRIC_EXR = 5, /* .exr, writing only: equal-area octahedral picture for pbrt-v4's goniometric light */
    LUM_FORMAT_USD = 6,      /* .usda, writing only: UsdLux sphere light with an .ies file beside it */
    LUM_FORMAT_GLTF = 7      /* .gltf, writing only: KHR_lights_punctual and EXT_lights_ies, the .ies file embedded */
} lum_photometry_format;

/* Whether a path ends in one of the names of photometric files that can be read (.ies, .ldt, .xml) or, when writing, any of the above;
 * case doesn't matter.  For programs that take many kinds of files. */
bool lum_photometry_is_readable_name(const char *path);
lum_photometry_format lum_photometry_format_of_name(const char *path);

/* Reads a photometric file; which kind is found from its content.  Files are untrusted.  Errors: LMG_ERROR_FILE_OPEN, LMG_ERROR_FILE_READ,
 * LMG_ERROR_INPUT with file, line and what is wrong; *out is NULL then.  A TILT=<file> is looked for beside the file. */
lmg_result lum_photometry_read(const char *path, lum_photometry **out, lmg_error *err);

/* The same from memory; name stands for the path in messages, may be NULL.  TILT files aren't looked for. */
lmg_result lum_photometry_read_memory(const void *bytes, size_t size, const char *name, lum_photometry **out, lmg_error *err);

typedef struct lum_photometry_write_options {
    size_t struct_size;
    lum_photometry_format format; /* AUTO = by the name's ending */
    bool simulated;       /* the data come from a simulation (LM-63-2019 file generation 1.00010) and not from a laboratory */
    uint32_t resolution;  /* pixels per side of a goniometric picture; 0 = 512 */
    const char *date;     /* ISO date of issue for files that ask for one; NULL = today (UTC) */
} lum_photometry_write_options;

/* Writes beside the final name and renames, so that path never holds half a file.  options NULL = defaults.  loss (may be NULL) gets one
 * line on what the format couldn't keep, "" when nothing was lost. */
lmg_result lum_photometry_write(const lum_photometry *p, const char *path, const lum_photometry_write_options *options,
                                char loss[512], lmg_error *err);

/* --------------------------------------------------------------------------------------------------------------- angles */

/* Unit direction of (C, gamma), degrees, in the luminaire's frame; and back: C in [0,360), gamma in [0,180]. */
lmg_vec3 lum_direction_from_c_gamma(double c, double gamma);
void lum_direction_to_c_gamma(lmg_vec3 direction, double *c, double *gamma);

/* Intensity (cd) in a direction (of travel, unit, luminaire frame): linear interpolation in the stored angles, 0 outside them. */
double lum_photometry_intensity(const lum_photometry *p, lmg_vec3 direction);

/* The same distribution on a grid of type C over the whole sphere without symmetry: h_count planes at equal steps from C0, v_count
 * angles at equal steps from 0 to 180.  h_count 0 = the file's own planes, unfolded; v_count 0 = its own angles (type C only; else 181).
 * Keywords, lamps and shape come along. */
lmg_result lum_photometry_resample(const lum_photometry *p, uint32_t h_count, uint32_t v_count, lum_photometry **out, lmg_error *err);

/* ------------------------------------------------------------------------------------------------------------- measures */

enum { LUM_ZONES = 18 };

typedef struct lum_photometry_measures {
    double flux, down, up;    /* lumens: exact integrals of the interpolated intensity; down: gamma < 90 */
    double zonal[LUM_ZONES];  /* lumens in zones of 10 degrees of gamma, 0-10 .. 170-180 */
    double lamp_flux;         /* lumens of the lamps, 0 = not known or absolute */
    double efficiency;        /* flux / lamp_flux (light output ratio), 0 = not known */
    double efficacy;          /* flux / power, lm/W, 0 = not known */
    double peak;              /* cd, largest value stored */
    double peak_c, peak_gamma;/* degrees */
    double beam_angle, field_angle;     /* degrees: full angle within which intensity is at least 50 % and 10 % of the peak, mean of
                                           two planes; 360 if it never falls so low.  Axis: straight down (up) if at least 90 % of the
                                           peak go there, else the peak's direction */
    double beam_c0, beam_c90, field_c0, field_c90; /* in the planes C0-C180 and C90-C270; of an oblique beam: in the upright plane
                                                      through its axis and in the one across */
} lum_photometry_measures;

lmg_result lum_photometry_measure(const lum_photometry *p, lum_photometry_measures *out, lmg_error *err);

/* Bergen's fit of two distributions, gathered over points that are weighted alike or by their solid angles [bergen2012]. */
typedef struct lum_bergen {
    double difference, sum; /* of w (a - b)^2, of w (a + b)^2; begin with zeros */
} lum_bergen;

void lum_bergen_add(lum_bergen *fit, double a, double b, double weight);
double lum_bergen_fit(const lum_bergen *fit); /* 100 (1 - sqrt(difference / sum)): 100 for equal ones; 0 without light */

/* How two distributions differ, on a common grid of 5 degrees in C and 2.5 degrees in gamma. */
typedef struct lum_photometry_difference {
    double bergen;          /* Bergen's fit over the grid points */
    double bergen_weighted; /* the same with every point weighted by its solid angle */
    double rms_of_peak;     /* solid-angle weighted RMS of the difference / peak of the second */
    double largest_of_peak; /* largest difference / peak of the second */
    double flux_ratio;      /* flux of the first / flux of the second */
} lum_photometry_difference;

lmg_result lum_photometry_compare(const lum_photometry *a, const lum_photometry *b, lum_photometry_difference *out, lmg_error *err);

/* ------------------------------------------------------------------------------------------------------ rays of a profile */

/* A distribution made ready to send out rays: cells of the grid in an alias table by flux. */
typedef struct lum_profile lum_profile;

/* Errors: LMG_ERROR_INPUT when the distribution holds no light.  Copies what it needs of p. */
lmg_result lum_profile_create(const lum_photometry *p, lum_profile **out, lmg_error *err);
void lum_profile_destroy(lum_profile *profile);
double lum_profile_flux(const lum_profile *profile); /* lumens: what lum_photometry_measure gives */
double lum_profile_intensity(const lum_profile *profile, lmg_vec3 direction); /* lum_photometry_intensity of its distribution */

/* A direction (luminaire frame) with density intensity / flux, exactly that of the interpolated distribution. */
lmg_vec3 lum_profile_direction(const lum_profile *profile, double (*next)(void *state), void *state);

/* A point from which a shape sends a ray in direction, such that the shape looks equally bright all over from every side (density: one
 * over the projected area): with lum_profile_direction, the area source whose far field is the distribution.  metres, shape centred
 * on the origin, xi in [0,1). */
lmg_vec3 lum_shape_point(const lum_shape *shape, lmg_vec3 direction, const double xi[3]);

/* --------------------------------------------------------------------------------------------------- smooth reconstruction */

/* An intensity as a sum of smooth bumps on the vertices of a recursively divided octahedron. */
typedef struct lum_octahedron lum_octahedron;

/*
 * Level by level, the part of the intensity that the levels so far don't give is smoothed with a kernel of the level's width (a
 * singular integral [freeden1998]) at the level's vertices; vertices whose value matters are kept, others dropped.  Stops at max_level (0..6)
 * or when the mean error is below threshold (relative to the mean intensity, e.g. 0.01).
 */
lmg_result lum_octahedron_create(const lum_photometry *p, unsigned max_level, double threshold, lum_octahedron **out, lmg_error *err);
void lum_octahedron_destroy(lum_octahedron *o);
double lum_octahedron_intensity(const lum_octahedron *o, lmg_vec3 direction); /* cd, never negative */
typedef struct lum_octahedron_report {
    unsigned level;        /* finest level used */
    uint32_t coefficients; /* kept, all levels */
    size_t bytes;          /* of the coefficients as they are stored */
    double mean_error;     /* mean over the sphere of |smooth - interpolated| / mean intensity */
    double rms_error;      /* the same, RMS */
} lum_octahedron_report;
lum_octahedron_report lum_octahedron_get_report(const lum_octahedron *o);

#ifdef __cplusplus
}
#endif
#endif
