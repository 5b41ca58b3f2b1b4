/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Several processes at one bake.  The first hands out photon numbers, the others trace them and send back parts (part.h); counts
 * commute, so the box is the one of a single process, bit for bit.  bake.c knows this interface only; team_mpi.c fills it under mpirun.
 */
#ifndef BAKER_TEAM_H
#define BAKER_TEAM_H

#include "part.h"

struct bake_options;
struct lum_model;

typedef struct bake_team bake_team;
struct bake_team {
    /* Begins a bake, one after the other where there are several (bake_run_to_error).  Tells the others what is baked: part's bake
     * and layout, the photons among first .. end-1 that it lacks, with these effects (bits of bake_effect). */
    lmg_result (*invite)(bake_team *team, const bake_part *part, uint32_t effects, uint64_t first, uint64_t end, lmg_error *err);
    /* Takes up to `most` photons that nobody has yet, for the caller to trace; false when there are none. */
    bool (*take)(bake_team *team, uint64_t most, uint64_t *first, uint64_t *count);
    /* Answers the others and adds what they have sent to part.  To be called every second or so. */
    lmg_result (*serve)(bake_team *team, bake_part *part, lmg_error *err);
    /* Waits for what the others still have.  Photons of one who fell silent are missing from part then.  Ends the bake. */
    lmg_result (*gather)(bake_team *team, bake_part *part, lmg_error *err);
};

/*
 * Joins the processes that mpirun started.  *team NULL: there is one process only.  Errors: LMG_ERROR_UNSUPPORTED when there are
 * several but this program was built without MPI: each would do all the work and write the same file.
 */
lmg_result bake_team_join(bake_team **team, lmg_error *err);

/* Whether this process is one of the others: it calls bake_team_work in place of bake_run. */
bool bake_team_is_helper(const bake_team *team);

/* Traces what the first process hands out, bake after bake, until it says that this is all.  failed: this process can't help; it
 * says so and leaves. */
lmg_result bake_team_work(bake_team *team, const struct lum_model *model, const struct bake_options *options, bool failed,
                          lmg_error *err);

/* Leaves.  code: this process's exit code; if it isn't 0 or some process fell silent the call may end the program with it.  team may be
 * NULL. */
void bake_team_leave(bake_team *team, int code);

#endif
