/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Lumigraph: the light field of a luminaire, as a plain C library.
 *
 * A *field* is what leaves a luminaire, as radiance along rays.  It is filled from ray batches (lmg_accumulator), kept in an
 * OpenEXR file (lmg_field_read, lmg_field_write) and asked by renderers: radiance along a ray, importance samples seen from a
 * point, emitted rays.  A caller sees a light field, never its arrays.
 *
 * Units: metres, radians, lumens, candela, cd/m2.  Frame: the luminaire's own (glTF: right-handed, +Y up).
 * Colour: linear Rec.709 R,G,B scaled so that the luminance Y = 0.2126 R + 0.7152 G + 0.0722 B is in the photometric unit.
 * Threads: objects that are const may be used by any number of threads.  The library never prints, never exits, holds no globals.
 */
#ifndef LUMIGRAPH_LUMIGRAPH_H
#define LUMIGRAPH_LUMIGRAPH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#define LMG_API __declspec(dllexport)
#else
#define LMG_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define LMG_VERSION_MAJOR 0
#define LMG_VERSION_MINOR 1
#define LMG_VERSION_PATCH 0
#define LMG_VERSION_STRING "0.1.0"

/* Version of the library linked against, "MAJOR.MINOR.PATCH"; static storage. */
LMG_API const char *lmg_version(void);

/* ------------------------------------------------------------------------------------------------------------ results */

/* 0 is success; the numbers are fixed forever. */
typedef int32_t lmg_result;
enum {
    LMG_OK = 0,
    LMG_ERROR_ARGUMENT = 1,     /* a value outside its documented range */
    LMG_ERROR_MEMORY = 2,       /* an allocation failed */
    LMG_ERROR_FILE_OPEN = 10,   /* can't open, create or rename */
    LMG_ERROR_FILE_READ = 11,   /* truncated or unreadable */
    LMG_ERROR_FILE_WRITE = 12,  /* disk full, ... */
    LMG_ERROR_FILE_FORMAT = 13, /* not a box file, or one that contradicts itself */
    LMG_ERROR_FILE_VERSION = 14,/* a format version this library doesn't know */
    LMG_ERROR_INPUT = 20,       /* a model, recipe or table that can't be used */
    LMG_ERROR_UNSUPPORTED = 21, /* asks for something that isn't built in; the message names it */
    LMG_ERROR_INTERNAL = 90
};

/* Where an error's text goes: owned by the caller, may be NULL.  The text says where, what and what would help. */
typedef struct lmg_error {
    char message[512];
} lmg_error;

/* Writes a printf-style message into err (which may be NULL) and returns code, so that callers can `return lmg_fail(...)`. */
LMG_API lmg_result lmg_fail(lmg_error *err, lmg_result code, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;

/* ---------------------------------------------------------------------------------------------------------------- rays */

typedef struct lmg_vec3 {
    double x, y, z;
} lmg_vec3;

/*
 * One ray of light on its way out of a luminaire: the joint between sources and sinks.
 * origin: any point of its path in the air outside, metres.  direction: of travel, unit length to 1e-6.
 * flux: R,G,B; luminance-weighted it is the ray's share of light in units of the batch (for our tracer 1 = one photon, for a ray
 * file 1 = the mean flux of a ray; lumens = flux x lumens_per_unit).  wavelength: nm, 0 when the ray isn't monochromatic.
 * number: the photon's number in its source; even numbers form half A, odd ones half B.
 */
typedef struct lmg_ray {
    lmg_vec3 origin;
    lmg_vec3 direction;
    float flux[3];
    float wavelength;
    uint64_t number;
} lmg_ray;

/* A consumer of ray batches.  consume may be called by several threads at once; it must not keep the pointer. */
typedef struct lmg_sink {
    void *self;
    void (*consume)(void *self, const lmg_ray *rays, size_t count);
} lmg_sink;

/* --------------------------------------------------------------------------------------------------------------- slabs */

/* How a slab's (s,t) is laid out. */
typedef enum lmg_slab_kind {
    /* Cube slab: rays whose largest direction component (by magnitude, in the luminaire frame) is along +n.
     * distance D finite: (s,t) are the metres, along a and b, of the crossing with the plane o + D n.
     * D = INFINITY: (s,t) are the slopes p = da/dn, q = db/dn in [-1,1]. */
    LMG_SLAB_CUBE = 0,
    /* Aperture slab: rays with d.n > 0; (s,t) in [-1,1]^2 is the concentric, area-preserving image (Shirley and Chiu 1997) of the
     * disc of direction cosines (d.a, d.b), so that equal cells have equal etendue du dv ds dt pi/4. */
    LMG_SLAB_APERTURE = 1
} lmg_slab_kind;

/*
 * One slab: a frame with orthonormal axes (a x b = n), a rectangle of (u,v) in the plane through o, metres along a and b, and a
 * rectangle of (s,t) in the slab's own coordinates, each cut in equal cells.
 * A field is a list of slabs in order of priority: a ray belongs to the first slab whose direction rule, (u,v) rectangle and (s,t)
 * rectangle (borders half-open) contain it, so every ray has exactly one place.  A narrow window over a beam comes before the wide
 * slab that catches the rest.  Of directions with equal components, classes of cube slabs take the lowest axis; the end of (s,t)'s domain
 * (slope or square coordinate 1) is closed.
 */
typedef struct lmg_slab {
    lmg_slab_kind kind;
    lmg_vec3 o, a, b, n;
    double distance;        /* D, metres; INFINITY = directions.  Cube slabs only */
    double u0, u1, v0, v1;  /* metres */
    double s0, s1, t0, t1;  /* see kind */
    uint32_t nu, nv, ns, nt;/* cells in each dimension, 1..65535 each; the product of all four at most 2^32 */
} lmg_slab;

enum { LMG_MAX_SLABS = 32 };

/* The layout of a field: its slabs and the box around the luminaire. */
typedef struct lmg_layout {
    uint32_t slab_count; /* 1..LMG_MAX_SLABS */
    lmg_slab slabs[LMG_MAX_SLABS];
    uint32_t channels;   /* 1: all light has one colour (lmg_layout.colour), cells hold luminance; 3: R,G,B */
    float colour[3];     /* with channels 1: the common R,G,B at luminance 1 */
    lmg_vec3 bounds_min, bounds_max; /* metres; holds all of the luminaire.  The field is meant for points outside it */
    double size;         /* the luminaire's size for near-field distances: diagonal of the luminous opening, metres */
} lmg_layout;

/* Coordinates of a ray in a slab.  Returns whether the slab's own domain (direction rule and rectangles) contains it. */
LMG_API bool lmg_slab_coordinates(const lmg_slab *slab, lmg_vec3 origin, lmg_vec3 direction, double uvst[4]);

/* The ray at coordinates (u,v,s,t): a point of the (u,v) plane and a unit direction.  Inverse of lmg_slab_coordinates. */
LMG_API void lmg_slab_ray(const lmg_slab *slab, const double uvst[4], lmg_vec3 *origin, lmg_vec3 *direction);

/* Etendue of a cell (m2 sr), integrated over the cell and, for cube slabs, over the part of it where |p|,|q| <= 1. */
LMG_API double lmg_slab_cell_etendue(const lmg_slab *slab, uint32_t iu, uint32_t iv, uint32_t is, uint32_t it);

typedef enum lmg_layout_choice { LMG_LAYOUT_AUTO = 0, LMG_LAYOUT_CUBE = 1, LMG_LAYOUT_APERTURE = 2 } lmg_layout_choice;

/* Wishes for lmg_layout_fit; zero means default. */
typedef struct lmg_fit_options {
    size_t struct_size;
    lmg_layout_choice choice;
    uint64_t cells;       /* total number of cells to aim at; 0 = 4 million */
    bool fewer_cells;     /* cells is a limit: take fewer where more would hold too few of the photons each, or gain nothing */
    double photons;       /* rays that the cells will be filled with, >= 0, so that their noise counts; 0 = so many that it doesn't */
    uint32_t channels;    /* 1 or 3; 0 = measured from the rays (1 if all have one colour) */
    double distance;      /* D of cube slabs; 0 = INFINITY */
    uint32_t resolution[4]; /* nu,nv,ns,nt per main slab, each 0 = chosen */
    lmg_vec3 bounds_min, bounds_max; /* the luminaire's bounding box, required */
} lmg_fit_options;

/*
 * Fits a layout to a pilot batch of rays: chooses cube or aperture, where each (u,v) plane stands, how tightly its rectangle fits,
 * narrow (s,t) windows over beams, and a slab of its own for a source that is seen directly (its focus), within the number of cells asked
 * for, by what the cells do to illuminance, intensity and radiance.  Below these slabs six coarse cube slabs catch whatever passes beside, so
 * that every ray of any luminaire has a place.
 * Errors: LMG_ERROR_ARGUMENT (no rays, empty bounds, values out of range), LMG_ERROR_MEMORY.  report (may be NULL) gets a few printable lines on why.
 */
LMG_API lmg_result lmg_layout_fit(const lmg_ray *rays, size_t count, const lmg_fit_options *options, lmg_layout *out,
                                  char report[1024], lmg_error *err);

/* Checks a layout (ranges, orthonormal frames, sizes); what lmg_accumulator_create and the reader demand. */
LMG_API lmg_result lmg_layout_check(const lmg_layout *layout, lmg_error *err);

/* --------------------------------------------------------------------------------------------------------- accumulator */

/* Where rays are counted, one place each, nearest cell.  Sums are 64-bit fixed point (2^-20 of a unit), so they commute: the result
 * is the same bits for any order and number of threads.  A ray is rounded up or down to the unit by chance, keyed by its number: the same
 * ray always alike, yet without bias however small its flux.  10^11 units into one cell don't overflow. */
typedef struct lmg_accumulator lmg_accumulator;

LMG_API lmg_result lmg_accumulator_create(const lmg_layout *layout, lmg_accumulator **out, lmg_error *err);
LMG_API void lmg_accumulator_destroy(lmg_accumulator *acc);

/* Deposits rays.  Safe to call from several threads at once.  Rays with non-finite or negative luminance (a component may be negative:
 * colours outside the gamut), more than 2^24 units, a non-finite origin, or a non-finite or zero direction are refused and counted; rays that no slab contains go to a residual that is reported, never dropped silently. */
LMG_API void lmg_accumulator_deposit(lmg_accumulator *acc, const lmg_ray *rays, size_t count);

/* The accumulator as a sink. */
LMG_API lmg_sink lmg_accumulator_sink(lmg_accumulator *acc);

/* Adds everything of other (same layout) to acc. */
LMG_API lmg_result lmg_accumulator_merge(lmg_accumulator *acc, const lmg_accumulator *other, lmg_error *err);

typedef struct lmg_deposit_totals {
    uint64_t rays;             /* deposited in cells */
    uint64_t refused;          /* non-finite or negative */
    uint64_t unplaced;         /* in no slab */
    double stored, residual;   /* luminance-weighted flux, units: in cells; unplaced */
} lmg_deposit_totals;
LMG_API lmg_deposit_totals lmg_accumulator_totals(const lmg_accumulator *acc);

/* The layout it was made with; belongs to it. */
LMG_API const lmg_layout *lmg_accumulator_layout(const lmg_accumulator *acc);

/* Takes bytes in order; false when it can't, which ends the saving. */
typedef bool (*lmg_write_bytes)(void *self, const void *bytes, size_t count);

/* An accumulator as bytes, with its layout: what a checkpoint keeps, and what machines send each other.  Nobody may deposit meanwhile.
 * Errors: LMG_ERROR_FILE_WRITE when write says false. */
LMG_API lmg_result lmg_accumulator_save(const lmg_accumulator *acc, lmg_write_bytes write, void *self, lmg_error *err);

/* The accumulator that lmg_accumulator_save wrote, equal to the bit.  The bytes are untrusted: everything is checked before it is
 * believed, but bytes that were altered into something possible can't be told: keep a hash beside them.
 * Errors: LMG_ERROR_FILE_FORMAT, LMG_ERROR_MEMORY. */
LMG_API lmg_result lmg_accumulator_load(const void *bytes, size_t size, lmg_accumulator **out, lmg_error *err);

/* ----------------------------------------------------------------------------------------------------------- gathering */

/*
 * Radiance of cells by rays traced backwards into the luminaire, to be combined with the photons of an accumulator: cells into
 * which photons fell get rays in proportion, uniformly distributed in the cell's own etendue; whoever knows the luminaire says what
 * an eye sees along them.  The rays are a function of the accumulator's content, rays_per_unit and seed alone.
 */
typedef struct lmg_gathering lmg_gathering;
enum { LMG_GATHERING_RAYS = 1024 }; /* of half a cell, at most */

/* rays_per_unit: > 0, rays for each unit of flux in a cell (a photon).  The accumulator is borrowed and has to stay as it is.
 * Errors: LMG_ERROR_ARGUMENT, LMG_ERROR_MEMORY. */
LMG_API lmg_result lmg_gathering_create(const lmg_accumulator *acc, double rays_per_unit, uint64_t seed, lmg_gathering **out,
                                        lmg_error *err);
LMG_API void lmg_gathering_destroy(lmg_gathering *gathering); /* accepts NULL */

LMG_API size_t lmg_gathering_cells(const lmg_gathering *gathering);
LMG_API uint64_t lmg_gathering_rays(const lmg_gathering *gathering); /* of all cells */

/* The rays of the i-th cell: from where they leave the bounds, with numbers of their own for the randomness of what becomes of
 * them.  Returns how many; 0: too little of the cell is its own, it is to be left to the photons (put NULL). */
LMG_API uint32_t lmg_gathering_draw(const lmg_gathering *gathering, size_t i, lmg_ray rays[2 * LMG_GATHERING_RAYS]);

/* Etendue of the i-th cell, m2 sr, whole. */
LMG_API double lmg_gathering_etendue(const lmg_gathering *gathering, size_t i);

/* What is seen along the rays of the i-th cell, in their order: R,G,B, cd/m2, in the scale of lumens_per_unit of the
 * reconstruction; once for each cell; calls for different cells may run at once. */
LMG_API void lmg_gathering_put(lmg_gathering *gathering, size_t i, const float (*radiance)[3]);

/* --------------------------------------------------------------------------------------------------------------- field */

typedef struct lmg_field lmg_field;

/* Where the light went, lumens, with standard errors; emitted = stored + residual + absorbed + lost. */
typedef struct lmg_ledger {
    uint64_t photons;
    double emitted, stored, residual, absorbed, lost;
    double emitted_se, stored_se, residual_se, absorbed_se, lost_se;
} lmg_ledger;

/* Turns counts into radiance with a standard error per cell: L = flux / integrated etendue (of the rays that are the cell's own and come
 * out of the bounds).  lumens_per_unit > 0.  The accumulator stays usable, so that a long bake can be looked at on the way.  The field
 * is owned by the caller.  ledger: stored and residual are filled in from the accumulator, and their standard errors where they are 0
 * (as weighted Poisson counts); the rest is taken as given.  NULL: emitted = stored + residual. */
LMG_API lmg_result lmg_field_reconstruct(const lmg_accumulator *acc, double lumens_per_unit, const lmg_ledger *ledger,
                                         lmg_field **out, lmg_error *err);

/* The same of photons and what was gathered for them, cell by cell in a mixture that is unbiased and about as good as inverse
 * variances make it; the flux stays that of the photons.  gathering: of this accumulator, or NULL.  *share (may be NULL): of the
 * stored flux that lies in gathered cells. */
LMG_API lmg_result lmg_field_reconstruct_gathered(const lmg_accumulator *acc, double lumens_per_unit, const lmg_ledger *ledger,
                                                  const lmg_gathering *gathering, lmg_field **out, double *share, lmg_error *err);
LMG_API void lmg_field_destroy(lmg_field *field);

LMG_API const lmg_layout *lmg_field_layout(const lmg_field *field);
LMG_API lmg_ledger lmg_field_ledger(const lmg_field *field);
LMG_API size_t lmg_field_memory(const lmg_field *field); /* bytes held */

/* Flux stored in one slab: lumens, with its standard error, that of a share of the ledger's photons. */
LMG_API double lmg_field_slab_flux(const lmg_field *field, uint32_t slab, double *standard_error);

/* Makes radiance constant within each cell, the plain bins of a histogram, for comparisons: every cell's mean, and so every flux, stays, and
 * NEAREST, emission, sampling, illuminance and intensity read cells so.  Files hold no slopes: a field that is written and read has them
 * again.  Needs the caller's lock. */
LMG_API void lmg_field_make_constant(lmg_field *field);

/* Provenance and remarks: UTF-8 text by name ("model", "seed", "effects", ...), kept in the file.  set copies; value NULL removes.
 * get returns NULL when absent, storage of the field.  name: 1..63 of [A-Za-z0-9_.-]. */
LMG_API lmg_result lmg_field_set_text(lmg_field *field, const char *name, const char *value, lmg_error *err);
LMG_API const char *lmg_field_get_text(const lmg_field *field, const char *name);
/* The i-th text's name, NULL past the end; sorted by name. */
LMG_API const char *lmg_field_text_name(const lmg_field *field, size_t i);

/* Multiplies all light (radiance, errors, ledger) by factor > 0. */
LMG_API lmg_result lmg_field_scale(lmg_field *field, double factor, lmg_error *err);

/*
 * Radiance trees: a second estimate of radiance from some millions of a bake's rays, sharper than cells, for what is seen directly:
 * lmg_field_radiance with LMG_LINEAR asks them where they are.  Sampling, emission, illuminance and intensity don't.
 * rays: of the same light as the field, as many as tell where it is: their sum is taken to be all that is stored and residual; sorted by
 * something of their own, since trees depend on their order.  trees: 2 to LMG_MOST_TREES, 0 takes them away.  Colours are the cells'.
 * Where the light of a slab repeats itself over equal parts of it, as a louvre's does, and the rays don't tell these apart, they share their
 * rays.
 * Slabs that get trees: of a layout of more than six all but the last six, which lmg_layout_fit makes to catch the rest; windows are parts of the
 * wide slab behind them.  On failure the field is as before.
 * Errors: LMG_ERROR_ARGUMENT (no ray in a wide slab), LMG_ERROR_UNSUPPORTED (no slab whose (s,t) is a direction; more of them
 * than a file may hold), LMG_ERROR_MEMORY.
 */
enum { LMG_MOST_TREES = 16 };
LMG_API lmg_result lmg_field_grow_trees(lmg_field *field, const lmg_ray *rays, size_t count, uint32_t trees, lmg_error *err);

/*
 * Looks: rays spread over the leaves of a field's trees, some more in bright ones, along which whoever knows the luminaire says what an
 * eye sees.  They divide the leaves further, and find the edges within: where emitters are seen directly, by mirrors or through
 * glass, a look has no noise, and its dark side tells as much as its bright one.  Looks are a function of the trees, their kind and
 * number, and the seed alone.
 *
 * Where what is seen has too much noise, or nobody can tell it, looks still tell outlines: whether there is anything of the luminaire
 * along the ray at all, and how bright that is on the whole.  These divide the light that photons have brought to a leaf, or to many
 * together where they don't tell them apart, among the pieces that aren't empty.
 */
typedef enum lmg_look_kind { LMG_LOOK_RADIANCE, LMG_LOOK_OUTLINE } lmg_look_kind;
typedef struct lmg_looks lmg_looks;

/* The field, which has to have trees, is borrowed and has to stay as it is.  count: 1 to 2^32 - 1; each takes some 30 bytes, and as many
 * again for each thread that grows trees of them.  Errors: LMG_ERROR_ARGUMENT, LMG_ERROR_MEMORY. */
LMG_API lmg_result lmg_looks_create(const lmg_field *field, lmg_look_kind kind, size_t count, uint64_t seed, lmg_looks **out,
                                    lmg_error *err);
LMG_API void lmg_looks_destroy(lmg_looks *looks); /* accepts NULL */
LMG_API size_t lmg_looks_count(const lmg_looks *looks);

/* The rays of looks first .. first + count - 1: from where they leave the bounds, with numbers of their own for the randomness of what
 * becomes of them.  Once for each look; calls for different looks may run at once. */
LMG_API void lmg_looks_draw(lmg_looks *looks, size_t first, size_t count, lmg_ray *rays);

/* Etendue that a look stands for, m2 sr, once it was drawn; 0: its ray is of another slab. */
LMG_API double lmg_looks_weight(const lmg_looks *looks, size_t look);

/* What is seen along them: R,G,B, cd/m2, in the scale of the field; of outlines 0 where light is impossible, and how bright what is met
 * there is expected to be, up to 1, the brightest, and 1 where that isn't known.  For each look, after it was drawn; what is put last counts.
 * Calls for different looks may run at once. */
LMG_API void lmg_looks_put(lmg_looks *looks, size_t first, size_t count, const float (*radiance)[3]);

/* Of radiance as the trees have it, weighted with etendue, how much is where looks expect or see none: the root of the share of its squares, 0
 * to 1.  Once all looks have been put, before trees are refined by them. */
LMG_API double lmg_looks_misplaced(const lmg_looks *looks);

/* How far that radiance is from being in proportion to what looks expect or see: the root of the share of its squares that isn't, 0 to 1. When
 * it may be asked: as above. */
LMG_API double lmg_looks_unexpected(const lmg_looks *looks);

/* Grows the field's trees anew, of what was seen along all looks; each tree keeps its light.  field: the looks' own.  Once: afterwards looks
 * can only be destroyed.  On failure both are as before.  Errors: LMG_ERROR_ARGUMENT, LMG_ERROR_UNSUPPORTED (larger than a file may
 * hold), LMG_ERROR_MEMORY. */
LMG_API lmg_result lmg_field_refine_trees(lmg_field *field, lmg_looks *looks, lmg_error *err);

/* What the field has of them; zeros for none. */
typedef struct lmg_tree_totals {
    uint32_t trees;
    uint32_t tiles, kinds; /* of slabs whose light repeats itself, such as a louvre's: tiles of one kind share their rays; 0: none does */
    uint64_t leaves, rays, looks;
    size_t memory; /* bytes, part of lmg_field_memory */
    size_t bytes;  /* of a file */
} lmg_tree_totals;
LMG_API lmg_tree_totals lmg_field_trees(const lmg_field *field);

/* Takes trees away, each of which is an estimate by itself, until the rest take at most so many bytes of a file; where that would leave less than
 * two, all.  Returns how many are left.  Looks at trees that are thinned can only be destroyed. */
LMG_API uint32_t lmg_field_thin_trees(lmg_field *field, size_t bytes);

/* ---------------------------------------------------------------------------------------------------------------- file */

/* Reads a box file (docs/format.md).  Files are untrusted: every size is checked before it is believed; nothing is returned of a file
 * that is truncated, altered (its content hash disagrees) or contradicts itself.  Memory is bounded by the file's own checked sizes. */
LMG_API lmg_result lmg_field_read(const char *path, lmg_field **out, lmg_error *err);

/* The same from a block of memory that holds a whole box file.  name stands for the path in messages; may be NULL. */
LMG_API lmg_result lmg_field_read_memory(const void *bytes, size_t size, const char *name, lmg_field **out, lmg_error *err);

/* Writes a box file beside its final name and renames it, so that path never holds half a file.  Cells are kept to the bit. */
LMG_API lmg_result lmg_field_write(const lmg_field *field, const char *path, lmg_error *err);

/* What rounding changed, RMS over the cells that have noise: of the luminance over its standard error, and of (half A - half B) / 2 over the
 * same. */
typedef struct lmg_rounding {
    double loss, half_loss;
} lmg_rounding;

/* Writes a file of a third to a sixth of the size: cells are rounded to as many bits as their noise leaves meaning (format version 2).  loss:
 * the rounding error's RMS is at most about so much of the standard error; above 0, at most 1; 0.1 can't be told from nothing.  The flux of
 * each slab stays the same to 1e-9, sums over many cells to far less than their noise; standard errors change by up to 3 %, radiance without noise
 * by up to 5e-4.  out (may be NULL): what was lost, which the file says as well; zeros when the field's cells are of a kind that can't be rounded
 * (negative luminance, luminances of too many decades) and the file holds them to the bit. */
LMG_API lmg_result lmg_field_write_rounded(const lmg_field *field, const char *path, double loss, lmg_rounding *out, lmg_error *err);

/* What the file that the field was read from has lost by rounding; zeros for nothing. */
LMG_API lmg_rounding lmg_field_rounding(const lmg_field *field);

/* ------------------------------------------------------------------------------------------------------------- asking */

/* How cells are read.  NEAREST: from the ray's own cell, in which radiance is linear with slopes from its neighbours and keeps its mean,
 * exactly what emission, illuminance and intensity use.  LINEAR: for pictures of the luminaire itself, where steps from cell to cell would show:
 * from the field's trees, if it has any, else interpolated between cells. */
typedef enum lmg_filter { LMG_NEAREST = 0, LMG_LINEAR = 1 } lmg_filter;

/* Radiance (cd/m2, as R,G,B) of the light that travels through origin (outside the bounds, downstream of the luminaire) in direction
 * (unit, of travel: away from the luminaire).  Zero for rays that don't come out of the bounds before origin.  From a point inside the
 * bounds (under a desk lamp's head, say) light is seen that has already crossed its slab's (u,v) plane, as if nothing of the luminaire
 * stood in between.  standard_error of the luminance, may be NULL.  No allocation, no locks. */
LMG_API void lmg_field_radiance(const lmg_field *field, lmg_vec3 origin, lmg_vec3 direction, lmg_filter filter, float rgb[3],
                                float *standard_error);

/* A direction in which a point sees light of the box. */
typedef struct lmg_point_sample {
    lmg_vec3 direction; /* unit, from the point towards the box */
    double distance;    /* metres from the point to where the ray enters the bounds: what has to be free for the light to arrive; 0 inside */
    double pdf;         /* per steradian, > 0, exactly what lmg_field_point_pdf gives for this direction */
    /* Where its radiance is kept, for lmg_field_sample_radiance: slab, cell of it, (s,t) cell of it, and place in the cell, -1 to 1. */
    uint32_t slab, st;
    uint64_t cell;
    float within[4];
} lmg_point_sample;

/* Samples a direction from point (outside the bounds) with density about proportional to the radiance that arrives; xi: three numbers
 * in [0,1).  False when the point gets no light that way: then the sample counts as zero. */
LMG_API bool lmg_field_sample_point(const lmg_field *field, lmg_vec3 point, const double xi[3], lmg_point_sample *out);

/* The radiance (cd/m2, as R,G,B) that arrives along a sample, filter LMG_NEAREST; false when it is zero.  It has been on its way from memory
 * since lmg_field_sample_point: whoever evaluates a surface in between, or finds that the direction isn't wanted, doesn't wait for it. */
LMG_API bool lmg_field_sample_radiance(const lmg_field *field, const lmg_point_sample *sample, float rgb[3]);

/* The density (per steradian) with which lmg_field_sample_point gives direction (from the point towards the box). */
LMG_API double lmg_field_point_pdf(const lmg_field *field, lmg_vec3 point, lmg_vec3 direction);

/* Where the ray origin + t direction enters the bounds, t > 0; false if it misses. */
LMG_API bool lmg_field_enter(const lmg_field *field, lmg_vec3 origin, lmg_vec3 direction, double *t);

/* Emits a ray with density proportional to the flux; its flux is R,G,B at luminance 1 (lumens = stored flux / number of rays).
 * xi: five numbers in [0,1).  False only when the field holds no light. */
LMG_API bool lmg_field_emit(const lmg_field *field, const double xi[5], lmg_ray *out);

/* Puts another ray of the same cell in a ray's place, distributed as the cell's light is: what storing light in cells does to it, noise
 * left out.  The change of any measurement over rays that the box hasn't seen is the box's bias.  xi: four numbers in [0,1).  False for
 * a ray that no slab contains. */
LMG_API bool lmg_field_redraw(const lmg_field *field, lmg_vec3 *origin, lmg_vec3 *direction, const double xi[4]);

/* Illuminance (lx, as R,G,B) at a point outside the bounds on a surface with unit normal, by quadrature over the cells it sees, with
 * the standard error of the luminance that comes from the bake. */
LMG_API lmg_result lmg_field_illuminance(const lmg_field *field, lmg_vec3 point, lmg_vec3 normal, double rgb[3],
                                         double *standard_error, lmg_error *err);

/* Far-field luminous intensity (cd, as R,G,B) in a unit direction, with standard error of the luminance. */
LMG_API lmg_result lmg_field_intensity(const lmg_field *field, lmg_vec3 direction, double rgb[3], double *standard_error,
                                       lmg_error *err);

/* Luminance of linear Rec.709. */
static inline double lmg_luminance(const float rgb[3])
{
    return 0.2126 * (double)rgb[0] + 0.7152 * (double)rgb[1] + 0.0722 * (double)rgb[2];
}

#ifdef __cplusplus
}
#endif
#endif
