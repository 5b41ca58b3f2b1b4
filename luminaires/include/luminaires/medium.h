/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Participating media: light that is scattered and absorbed on its way, in opal glass, plastic, smoke.
 *
 * A medium has a scattering and an absorption coefficient per colour (1/m) and a phase function.  It fills the inside of a solid
 * (lum_medium), or a region of space with a density that varies from place to place (lum_volume: coefficients times density).
 *
 * Flights.  A photon of luminance 1 whose colours hold the given shares of it flies up to t_max and passes, is scattered or is
 * absorbed.  Which of these, and where, is drawn in proportion to luminance: with p_c the share of colour c, the distance has the
 * density  sum_c p_c sigma_c exp(-sigma_c t),  the single-sample balance heuristic over the colours [miller2019null; the
 * choice of p_c is ours].  The photon's colours are then multiplied by factor[c], and its luminance stays exactly 1, so it is
 * thinned out in number and never in weight.  For a grey medium all factors are 1.  Shares may be negative (light out of the
 * gamut): then |p_c| is taken, and the luminance afterwards is sum_c share_c factor_c, in any case unbiased.
 *
 * Varying density is met by null collisions [woodcock1965, novak2018]: tentative collisions at the rate of a local
 * bound of the density, of which a share is real.  The bounds are those of bricks of 8^3 cells, and of single cells where a brick's
 * bound is far above what is in it, so a few bright voxels slow down nothing but their neighbourhood.
 *
 * Threads: const calls on one object are safe together.  Random numbers come from the caller.
 */
#ifndef LUMINAIRES_MEDIUM_H
#define LUMINAIRES_MEDIUM_H

#include <luminaires/model.h>
#include <luminaires/rng.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ------------------------------------------------------------------------------------------------------ phase function */

/* |g| up to here; beyond it the peak is narrower than any measured medium's. */
#define LUM_MAX_ANISOTROPY 0.9999

/* The phase function of Henyey and Greenstein (1941): density per steradian for the cosine between the directions of travel before
 * and after; its mean cosine is g in [-LUM_MAX_ANISOTROPY, LUM_MAX_ANISOTROPY]; g = 0 is isotropic.  Its integral is 1. */
double lum_phase_pdf(double g, double cosine);

/* A direction of travel (unit) after scattering of light that travels in direction d (unit), with exactly that density. */
lmg_vec3 lum_phase_sample(double g, lmg_vec3 d, const double xi[2]);

/* The same for many at once, to the same bits: the first `count` columns, at most LUM_MAX_SCATTERED.  The new directions replace
 * the old ones. */
enum { LUM_MAX_SCATTERED = 64 };
typedef struct lum_phase_columns {
    double g[LUM_MAX_SCATTERED], xi[2][LUM_MAX_SCATTERED], direction[3][LUM_MAX_SCATTERED];
} lum_phase_columns;
void lum_phase_sample_many(size_t count, lum_phase_columns *columns);

/* -------------------------------------------------------------------------------------------------- homogeneous media */

/* A medium made ready for flights. */
typedef struct lum_medium {
    double scattering[3], extinction[3]; /* 1/m; extinction = scattering + absorption */
    double majorant;                     /* largest extinction */
    double g;                            /* mean cosine of the phase function */
    bool scatters;                       /* some colour is scattered */
    bool grey;                           /* all colours alike */
} lum_medium;

/* coefficients: 1/m, not negative, finite. */
void lum_medium_set(lum_medium *medium, const float scattering[3], const float absorption[3], float anisotropy);

typedef enum lum_flight_event { LUM_FLIGHT_PASSED, LUM_FLIGHT_SCATTERED, LUM_FLIGHT_ABSORBED } lum_flight_event;

typedef struct lum_flight {
    lum_flight_event event;
    double t;         /* where: t_max when passed */
    double factor[3]; /* for the colours of a photon that goes on */
    double g;         /* of the medium that scattered */
} lum_flight;

/* share: luminance in each colour, adding up to 1; t_max >= 0, may be INFINITY.  Uses one to three numbers of rng.  The same in two
 * steps, for tracers that look for surfaces no further than the light goes: lum_medium_draw gives the distance of the next event
 * (INFINITY: none), lum_medium_arrive says what that means when the way ends at t_max. */
double lum_medium_draw(const lum_medium *medium, const double share[3], lum_rng *rng);
void lum_medium_arrive(const lum_medium *medium, double drawn, double t_max, const double share[3], lum_rng *rng, lum_flight *out);
/* Of an event in a grey medium, where all factors are 1: whether it is absorption. */
static inline bool lum_medium_absorbs(const lum_medium *medium, lum_rng *rng)
{
    const double scattering = medium->scattering[0], extinction = medium->extinction[0];
    return scattering < extinction && lum_rng_next(rng) * extinction >= scattering;
}
void lum_medium_fly(const lum_medium *medium, double t_max, const double share[3], lum_rng *rng, lum_flight *out);

/* --------------------------------------------------------------------------------------------- lattices of density */

/* Densities at the points of a cubic lattice, index coordinates: voxel (i,j,k) is at the point (i,j,k).  Between them trilinear, or
 * each voxel constant in its cube of side 1; zero outside.  Compact: bricks of 8^3 cells, none where nothing is. */
typedef struct lum_grid lum_grid;
typedef struct lum_grid_builder lum_grid_builder;

typedef enum lum_interpolation { LUM_INTERPOLATION_LINEAR = 0, LUM_INTERPOLATION_NEAREST = 1 } lum_interpolation;

enum { LUM_GRID_BRICK = 8 };

/* Starts a lattice whose voxels outside low .. high (inclusive) are zero.  Errors: LMG_ERROR_INPUT when the region is empty or has
 * more than 2^27 bricks; LMG_ERROR_MEMORY. */
lmg_result lum_grid_begin(const int32_t low[3], const int32_t high[3], lum_interpolation interpolation, lum_grid_builder **out,
                          lmg_error *err);
/* Sets the 8^3 voxels from `origin` (multiples of 8) on; the third index runs fastest.  What lies outside low .. high must be zero
 * or is dropped.  Errors: LMG_ERROR_INPUT for densities that are negative or not finite, with the voxel. */
lmg_result lum_grid_put(lum_grid_builder *builder, const int32_t origin[3], const float values[512], lmg_error *err);
/* Sets all voxels low .. high (inclusive) to one value. */
lmg_result lum_grid_fill(lum_grid_builder *builder, const int32_t low[3], const int32_t high[3], float value, lmg_error *err);
/* Makes the lattice and ends the builder, on failure too.  voxel_depth: optical depth of one voxel of density 1; it decides where
 * the bounds of single cells pay, and changes no result but the random numbers' use.  Errors: LMG_ERROR_INPUT when all densities
 * are zero. */
lmg_result lum_grid_end(lum_grid_builder *builder, double voxel_depth, lum_grid **out, lmg_error *err);
void lum_grid_cancel(lum_grid_builder *builder); /* accepts NULL */
void lum_grid_destroy(lum_grid *grid);           /* accepts NULL */

/* The same from an array of size[0] x size[1] x size[2] values, third index fastest, the first of them at `low`. */
lmg_result lum_grid_create(const int32_t low[3], const uint32_t size[3], const float *values, lum_interpolation interpolation,
                           double voxel_depth, lum_grid **out, lmg_error *err);

/* Density at a point in index coordinates. */
double lum_grid_density(const lum_grid *grid, const double p[3]);
/* Where the density can differ from zero, index coordinates. */
void lum_grid_bounds(const lum_grid *grid, double low[3], double high[3]);

/* Reads the grid called `name` of an OpenVDB file (NULL or "": its only one of floating-point numbers, or "density").
 * index_to_world: the file's own map, row by row, translation last.  extinction: 1/m at density 1, times the metres per unit of the
 * file's world, for lum_grid_end.  Errors (one line): LMG_ERROR_FILE_* when the file can't be read or is damaged; LMG_ERROR_INPUT
 * for unknown names, level sets, backgrounds other than zero, densities that are negative or not finite;
 * LMG_ERROR_UNSUPPORTED for grids of other types, maps that aren't affine, and where Lumibox was built without OpenVDB. */
lmg_result lum_grid_read_vdb(const char *path, const char *name, lum_interpolation interpolation, double extinction, lum_grid **out,
                             double index_to_world[3][4], lmg_error *err);

/* --------------------------------------------------------------------------------------------- volumes in the model */

/* Prepared volumes of a model: where the tracer flies through. */
typedef struct lum_volumes lum_volumes;

/* The model is borrowed until lum_volumes_destroy.  *out is NULL, and that's no error, when it has no volumes. */
lmg_result lum_volumes_create(const lum_model *model, lum_volumes **out, lmg_error *err);
void lum_volumes_destroy(lum_volumes *volumes);

/* lum_medium_fly through all volumes (which may overlap: their coefficients add up) along origin + t direction (unit), model frame
 * minus centre.  t_max may be INFINITY. */
void lum_volumes_fly(const lum_volumes *volumes, lmg_vec3 origin, lmg_vec3 direction, double t_max, const double share[3],
                     lum_rng *rng, lum_flight *out);

/* Optical depth of the way 0 .. t_max per colour, exact (the density along a ray is a cubic in each cell). */
void lum_volumes_depth(const lum_volumes *volumes, lmg_vec3 origin, lmg_vec3 direction, double t_max, double depth[3]);

#ifdef __cplusplus
}
#endif
#endif
