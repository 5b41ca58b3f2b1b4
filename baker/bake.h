/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A bake from model to field: pilot, layout, tracing in rounds until the budget is used, reconstruction, provenance.
 * Nothing is printed; the caller gets a report, and progress through a callback.
 */
#ifndef BAKER_BAKE_H
#define BAKER_BAKE_H

#include "bias.h"
#include "gather.h"
#include "plan.h"
#include "source.h"

#include <signal.h>

struct lum_model;
struct bake_part;
struct bake_team;

/* What a running bake knows about itself. */
typedef struct bake_progress {
    uint64_t photons; /* traced so far */
    double seconds;   /* since tracing began */
    double rate;      /* photons per second */
    double accounted; /* share of the emitted flux that left or was absorbed */
    double noise;     /* see bake_report.noise, for the photons so far */
    double seconds_left;
} bake_progress;

typedef struct bake_options {
    uint64_t photons;       /* 0 = by time */
    uint64_t first;         /* number of the first photon, below BAKE_PILOT_FIRST - photons */
    uint64_t whole;         /* photons of the bake that these are a part of, for the size of the pilot; 0 = photons */
    double seconds;         /* of pilot and tracing, when photons is 0; 0 = 60 */
    uint64_t pilot_photons; /* 0 = a twentieth of the bake, within 20,000 and 400,000; a tenth of short ones asked for in photons,
                               up to 100,000 */
    double rays_per_photon; /* traced backwards for each stored photon, once they are traced (gather.h); 0 = photons only, < 0 = as
                               the pilot says */
    uint32_t trees;         /* radiance trees (lmg_field_grow_trees) of the first photons, up to BAKE_TREE_PHOTONS; 0 = none,
                               BAKE_TREES_AUTO = where the bake is long enough that they don't take much of its time */
    bool looks_chosen;      /* refine the trees by `looks` rays traced backwards, 0 = none; else two for each photon up to BAKE_MOST_LOOKS.
                               Where an eye that looks into the lamp sees much noise, they tell outlines only (lmg_look_kind) */
    uint64_t looks;
    uint64_t seed;
    bool effects_chosen;    /* simulate `effects` (bits of bake_effect) as far as the model has them, instead of what a plan says */
    uint32_t effects;
    double effects_error;              /* of the plan; 0: BAKE_PLAN_ERROR */
    unsigned threads;                  /* 0 = all cores */
    double flux_lm;                    /* > 0: the lamp's sources emit so many lumens */
    double output_flux_lm;             /* > 0: so many lumens leave the luminaire; excludes flux_lm */
    lmg_fit_options fit;               /* layout wishes; the bounds are filled in */
    const lmg_layout *layout;          /* the layout, whatever the pilot and fit say; NULL = fitted */
    double size;                       /* bytes of the box's file, of which trees get about a third; the layout's cells are chosen for the rest, unless fit says cells or resolution;
                                        * 0 = at most BAKE_SIZE, of at most as many cells as lmg_layout_fit takes by itself */
    const char *settings;              /* further texts for the file, NULL = none: the settings as JSON, ... */
    const char *recipe;                /* ... and the recipe */
    const volatile sig_atomic_t *stop; /* when it becomes non-zero, the bake ends with the round at hand */
    void (*progress)(void *self, const bake_progress *progress); /* after every round, on the calling thread */
    void *progress_self;
    const char *checkpoint;    /* the part's file (part.h), written while the bake runs; NULL = none */
    double checkpoint_seconds; /* between two of them; 0 = 60 */
    bool keep;                 /* write it at the end too, whatever the bake's length */
    struct bake_part *resume;  /* go on from here: photons that it has aren't traced again; taken over.  NULL = from the start */
    struct bake_team *team;    /* other processes that help (team.h); NULL = none */
} bake_options;

typedef struct bake_report {
    bake_tally tally; /* in photons */
    double flux_lm;   /* emitted by the sources, after rescaling */
    double lumens_per_photon;
    uint64_t pilot_photons;
    uint64_t refused; /* rays that the accumulator refused; counted as lost in the ledger */
    uint64_t gathered_rays; /* traced backwards */
    char no_trees_why[200]; /* why there are none though they were asked for, or the bake is long enough; "" otherwise */
    char looks_why[200];    /* why trees have none, or see outlines only, though nobody forbade it; "" otherwise */
    char gather_why[200];   /* why so many; "" when it wasn't asked, or decided by an earlier run */
    double plan_seconds, pilot_seconds, trace_seconds, gather_seconds, reconstruct_seconds, trees_seconds;
    double noise;     /* relative standard error of illuminance, RMS over 32 x 32 pixels one size away (bake_measuring_rectangle) */
    bake_bias bias;   /* what the cells smooth, as the pilot's rays see it */
    bake_plan plan;   /* of effects; plan.simulated are those of the box */
    double size_foretold; /* bytes, from the pilot; 0 = not foretold (cells were given, or the bake was resumed) */
    char layout_why[1184];
    bool interrupted;
    bool resumed;      /* photons of an earlier run are among these */
    bool checkpointed; /* the checkpoint's file holds all of them, or those up to the last minute */
} bake_report;

/* Bakes.  The field is the caller's.  Errors: LMG_ERROR_INPUT when the model emits nothing or no light leaves it, or when what is to be
 * resumed is of another bake; LMG_ERROR_FILE_* when the checkpoint can't be written. */
lmg_result bake_run(const struct lum_model *model, const bake_options *options, lmg_field **out, bake_report *report,
                    lmg_error *err);

/* A sink that keeps rays, at first with room for `capacity` of them.  Rays are sorted by photon number when asked for, so their order doesn't depend on threads. */
typedef struct bake_ray_list bake_ray_list;
lmg_result bake_ray_list_create(size_t capacity, bake_ray_list **out, lmg_error *err);
void bake_ray_list_destroy(bake_ray_list *list);
lmg_sink bake_ray_list_sink(bake_ray_list *list);
/* LMG_ERROR_MEMORY if there was no memory for some of the rays: which of them are missing is a matter of chance then. */
lmg_result bake_ray_list_check(const bake_ray_list *list, lmg_error *err);
const lmg_ray *bake_ray_list_sorted(bake_ray_list *list, size_t *count);
const lmg_ray *bake_ray_list_any_order(bake_ray_list *list, size_t *count); /* for sums of integers */

/* What boxes lose by rounding, of their noise (lmg_field_write_rounded): a tenth can't be told from nothing. */
#define BAKE_ROUNDING 0.1

/* Bytes of a box, at most, when nothing is asked for. */
#define BAKE_SIZE 16e6

/* Radiance trees of bakes that last so long, in seconds or photons, when nothing is said of them. */
#define BAKE_TREES_AUTO UINT32_MAX
#define BAKE_TREES 8
#define BAKE_TREES_SECONDS 20
#define BAKE_TREES_FROM 100000000

/* Photons of a bake that radiance trees are grown of, at most: their rays take some 200 bytes each while that lasts, and 20 more for each thread. */
#define BAKE_TREE_PHOTONS 4000000
/* If looks tell radiance, photons tell where to look, for which fewer do. */
#define BAKE_LOOKED_PHOTONS 2000000
/* Some 30 bytes each, and as many again for each thread. */
#define BAKE_MOST_LOOKS 16000000

/* Pilot photons are numbered from here on, apart from those of the bake. */
#define BAKE_PILOT_FIRST (UINT64_C(1) << 62)

/* Seconds of a clock that only goes forward. */
double bake_clock(void);

/* Standard error of a share of `photons`, of which `part` (may be fractional or beyond 0..photons by rounding) belong to it:
 * binomial. */
double bake_share_error(double part, double photons);

/* The same of `part` of the light that escaped, also where photons carry different amounts. */
double bake_light_error(const bake_tally *tally, double part);

#endif
