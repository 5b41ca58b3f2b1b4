/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A part of a bake: the light of some of its photons as integer counts, and all that is needed to go on, to add further parts, or to
 * make the box.  What a photon does depends on (seed, number) alone and counts commute, so however a bake's photons are shared among
 * runs, interruptions and machines, the same photons make the same box, bit for bit.
 * A checkpoint is a part in a file (checkpoint.c).
 */
#ifndef BAKER_PART_H
#define BAKER_PART_H

#include "source.h"

/* Photons first .. first+count-1. */
typedef struct bake_range {
    uint64_t first, count;
} bake_range;

/* What a part says of its bake.  Parts of one bake agree in those up to PART_LAST_SHARED. */
typedef enum bake_part_text {
    PART_SOFTWARE,
    PART_RECIPE, /* as JSON, NULL = none */
    PART_SETTINGS,
    PART_MODEL_HASH,
    PART_SEED,
    PART_PILOT_PHOTONS,
    PART_EFFECTS, /* simulated */
    PART_PLAN,    /* bake_plan_text */
    PART_LAST_SHARED = PART_PLAN,
    PART_MODEL,
    PART_LAYOUT_WHY,
    PART_GATHER,   /* rays traced backwards for each stored photon, as the pilot said; NULL = none.  They are no part of the part:
                      whoever has   the lamp traces them for its photons */
    PART_WARNINGS, /* NULL = none */
    PART_TEXT_COUNT
} bake_part_text;

typedef struct bake_part {
    char *texts[PART_TEXT_COUNT]; /* the part's own; NULL where there is nothing to say */
    double source_flux;           /* lumens: what the model's sources emit */
    double flux_lm;               /* > 0: they are to emit this instead */
    double output_flux_lm;        /* > 0: so much is to leave */
    uint64_t pilot_photons;
    double pilot_noise; /* relative, of the pilot; may be infinite */
    double seconds;     /* of tracing */
    bake_tally tally;   /* of the photons in ranges */
    size_t range_count;
    bake_range *ranges; /* ascending, neither overlapping nor touching */
    lmg_accumulator *accumulator;
} bake_part;

/* An empty part, for the caller to fill; destroy accepts NULL. */
lmg_result bake_part_create(bake_part **out, lmg_error *err);
void bake_part_destroy(bake_part *part);

/* Copies text (NULL = none) into place. */
lmg_result bake_part_set_text(bake_part *part, bake_part_text which, const char *text, lmg_error *err);
/* The name under which a box carries it. */
const char *bake_part_text_name(bake_part_text which);

/* Notes that photons first .. first+count-1 have been traced.  Errors: LMG_ERROR_INPUT when some of them were before. */
lmg_result bake_part_add_range(bake_part *part, uint64_t first, uint64_t count, lmg_error *err);

/* The first photons among from .. end-1 that the part lacks: where they begin, and how many follow before the next that it has.  False
 * when it has them all. */
bool bake_part_gap(const bake_part *part, uint64_t from, uint64_t end, uint64_t *first, uint64_t *count);

/* Whether two parts come from one bake; if not, LMG_ERROR_INPUT, and the message says what differs. */
lmg_result bake_part_same_bake(const bake_part *part, const char *name, const bake_part *other, const char *other_name, lmg_error *err);

/* Adds other's photons to part.  The names stand for them in messages.  Errors: as bake_part_same_bake; LMG_ERROR_INPUT also when both
 * have a photon in common; part is unchanged then. */
lmg_result bake_part_merge(bake_part *part, const char *name, const bake_part *other, const char *other_name, lmg_error *err);

/* What the sources emit after rescaling: lumens.  Errors: LMG_ERROR_INPUT when nothing left although so much is to leave. */
lmg_result bake_part_flux(const bake_part *part, double *lumens, lmg_error *err);

/* The box of a part: reconstruction, ledger, provenance.  gathering: what was gathered for it, NULL = photons only.  The field is
 * the caller's.  Errors: LMG_ERROR_INPUT when it has no photons or no light leaves. */
lmg_result bake_part_field(const bake_part *part, const lmg_gathering *gathering, lmg_field **out, lmg_error *err);

/* The relative standard error of illuminance one size away, for the part's photons (bake_report.noise). */
double bake_part_noise(const bake_part *part);

/* ------------------------------------------------------------------------------------------------------- files (checkpoint.c) */

/* Writes a part beside its name, makes it last (fsync) and renames it: whatever happens, path holds a whole part, the old or the new. */
lmg_result bake_part_write(const bake_part *part, const char *path, lmg_error *err);

/* Reads one.  Files are untrusted; one that was cut or altered is refused (LMG_ERROR_FILE_*). */
lmg_result bake_part_read(const char *path, bake_part **out, lmg_error *err);

/* The same to and from bytes, for parts that travel between processes. */
lmg_result bake_part_save(const bake_part *part, lmg_write_bytes write, void *self, lmg_error *err);
lmg_result bake_part_load(const void *bytes, size_t size, const char *name, bake_part **out, lmg_error *err);

#endif
