/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The effect plan: which of the effects that a luminaire contains are simulated, and why.
 *
 * Each effect is measured in a small run of its own: how much of the light meets it, and what changes when it is left out and its
 * stand-in (effects.h) does its work - total flux, far field, near field, colour - the same photon numbers traced with and without.
 * An effect is left out when all these changes, with their confidence bounds, stay under the error asked for, and those of everything
 * that is left out add up to no more.  Polarization is the other way round: it is simulated only when the run shows that it matters.
 * The plan depends on model, seed and options alone: not on threads or speed.
 */
#ifndef BAKER_PLAN_H
#define BAKER_PLAN_H

#include "effects.h"
#include "source.h"
#include "tracer.h"

/* A relative change and its standard error.  Of an RMS, whose square has the symmetric error, it is half the way to the upper bound. */
typedef struct bake_change {
    double value, error;
    double sigmas; /* by how many standard errors it (its square) is above zero */
} bake_change;

typedef struct bake_plan_entry {
    bake_effect effect;
    bool simulated, measured;    /* measured: the changes are */
    double met, met_error;       /* share of the emitted photons that meet it */
    bake_change flux;            /* of the light that leaves the luminaire, relative */
    /* RMS over 6,144 (3 degrees) or 96 cells, relative, flux-weighted, noise subtracted; the one with the higher bound */
    bake_change far_field;       /* luminance by direction */
    bake_change near_field;      /* by the place of the bounds where light leaves them */
    bake_change colour;          /* R - Y or B - Y by direction */
    double bound;                /* upper limit of the largest change (two standard errors) */
    double seconds_without;      /* per photon and thread, when it is left out; depends on the machine */
    char why[160];
} bake_plan_entry;

typedef struct bake_plan {
    uint32_t contained, simulated; /* bits of bake_effect */
    uint64_t photons;              /* of each run; 0: the effects were chosen by the user */
    uint64_t escaped;              /* of them; 0: nothing is known of what leaves, and all is simulated */
    double error;
    double left_out;               /* sum of the bounds of what is left out */
    double seconds_with;           /* per photon and thread, everything simulated; depends on the machine */
    size_t count;
    bake_plan_entry entries[BAKE_EFFECT_COUNT]; /* what the model contains */
} bake_plan;

typedef struct bake_plan_options {
    double error;      /* 0: BAKE_PLAN_ERROR */
    uint64_t photons;  /* of each run; 0: 65,536, fewer where they are slow or the bake is short */
    double seconds;    /* that the bake is to take; 0: not known, or a minute or more */
    unsigned threads;  /* 0 = all cores */
} bake_plan_options;

/* A tenth of a per cent: well under what a box of light is asked for, and about what a plan can tell from nothing. */
#define BAKE_PLAN_ERROR 0.001

/* Plans.  tracer: of the model, with all effects.  Errors: LMG_ERROR_INPUT when light is trapped. */
lmg_result bake_plan_make(const lum_model *model, const bake_source *tracer, uint64_t seed, const bake_plan_options *options,
                          bake_plan *plan, lmg_error *err);

/* The plan that simulates these effects, as far as the model contains them, and what it emits. */
void bake_plan_choose(const lum_model *model, uint32_t effects, bake_plan *plan);

/* The plan as text of several lines, without what depends on the machine; to be freed; NULL: no memory. */
char *bake_plan_text(const bake_plan *plan);
/* The photons of each run, of a plan whose text that is; 0 where it doesn't say (text may be NULL). */
uint64_t bake_plan_text_photons(const char *text);

/* Which materials have an effect, and the nodes where: "\"Glass\" (bulb), ..."; cut off where text is full. */
void bake_plan_where(const lum_model *model, bake_effect effect, char *text, size_t size);

/* For the message that no light leaves: which materials swallow it.  Traces some photons. */
void bake_plan_where_absorbed(const lum_model *model, const bake_source *tracer, unsigned threads, char *text, size_t size);

#endif
