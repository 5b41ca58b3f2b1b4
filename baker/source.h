/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Sources make ray batches, sinks take them, and neither knows the other's insides.  A source is asked for a range of photon
 * numbers; what photon number n does depends on (seed, n) alone, so a range gives the same rays on any number of threads, whole or
 * in parts.
 */
#ifndef BAKER_SOURCE_H
#define BAKER_SOURCE_H

#include <lumigraph/lumigraph.h>

/* Where photons ended, in units (photons x luminance-weighted flux), with sums of squares for standard errors. */
typedef struct bake_tally {
    uint64_t photons;
    double emitted, escaped, absorbed, lost;
    uint64_t segments;  /* ray segments traced */
    double escaped_squares; /* sum of the squares of what escaped photons carry; 0 = each of them carries 1 */
    double lost_inside; /* part of lost: left through an open boundary while inside a solid */
} bake_tally;

typedef struct bake_source bake_source;
struct bake_source {
    /* Traces photons first .. first+count-1 on `threads` threads (0 = all cores) into the sinks and adds to *tally. */
    lmg_result (*run)(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err);
    void (*destroy)(bake_source *source);
    double flux;                     /* lumens emitted, so that lumens_per_unit = flux / photons */
    uint64_t photons;                /* that it has, from number 0 on: the rays of a file; 0 = as many as are asked for */
    bool even;                       /* a rectangle that looks equally bright all over: where light leaves says nothing of where it goes */
    double flux_se;                  /* its standard error: of a box, from the box's own bake; 0 where it is known */
    lmg_vec3 bounds_min, bounds_max; /* luminaire frame, metres */
};

/* Photons through a luminaire's real geometry (tracer.c).  model: what lum_model_load gave, borrowed until destroy.  flux: the
 * model's rated flux if its recipe gives one, else what its emitters emit.  Errors: LMG_ERROR_INPUT when nothing in the model emits
 * light. */
struct lum_model;
lmg_result bake_tracer_create(const struct lum_model *model, uint64_t seed, bake_source **out, lmg_error *err);
/* The same with some effects only (bits of bake_effect, effects.h), the others left out; bake_tracer_create simulates all.  like: another
 * tracer of this model, which must outlive the new one, or NULL; it lends what costs time to build. */
lmg_result bake_tracer_create_with(const struct lum_model *model, uint32_t effects, uint64_t seed, const bake_source *like,
                                   bake_source **out, lmg_error *err);

/* Rays emitted by a baked box, borrowed until destroy. */
lmg_result bake_box_source_create(const lmg_field *field, uint64_t seed, bake_source **out, lmg_error *err);

/* Rays of a file, borrowed until destroy: photon n is ray n, photons from BAKE_PILOT_FIRST on are rays from all over the file.  The
 * whole file is read once, on `threads` threads (0 = all cores), and its every ray checked.  A unit is the mean flux of a ray; flux is
 * in lumens or watts as lum_rayfile_info says.  Errors: those of lum_ray_reader_read, LMG_ERROR_INPUT when the rays carry no light. */
struct lum_rayfile;
lmg_result bake_rayfile_source_create(const struct lum_rayfile *file, uint64_t seed, unsigned threads, bake_source **out,
                                      lmg_error *err);

/* Rays of a far-field distribution from its luminous shape, centred on the origin: the area source that looks equally bright all over
 * and has this far field.  The distribution is copied.  A point gets bounds of 1 mm.  Errors: LMG_ERROR_INPUT when it holds no light. */
struct lum_photometry;
lmg_result bake_profile_source_create(const struct lum_photometry *photometry, uint64_t seed, bake_source **out, lmg_error *err);

#endif
