/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A bake shared by the processes of mpirun.
 *
 * Messages of a helper to the first process: WANT (number of photons it would like next) and PART (size and whether it is the last,
 * then the bytes in pieces).  Of the first process to a helper: INVITATION (size and effects, then the bytes of an empty part),
 * once for each bake, and BLOCK (first photon, count; count 0: send what you have).  The last INVITATION has size 0, go home, and
 * says whether all processes are still there to end together.
 *
 * A helper asks for its next block when it begins one, so that the answer is there when it has finished; it sends its part every
 * checkpoint's time.  What is handed out and never comes back, because a process died, is missing from the list of photons: the
 * first process traces it itself in the end, or whoever resumes the bake from its checkpoint. Every receive is
 * polled, and a process that is silent for SILENCE_SECONDS counts as dead; one that comes back after that is left to the launcher, which
 * ends what remains of a job.
 *
 * Without MPI at build time only bake_team_join is left, which refuses to be one of several.
 */
#include "team.h"

#include "bake.h"

#include <stdlib.h>

/* The number of processes as Open MPI and MPICH (and what follows it) tell it. */
static long processes(void)
{
    const char *text = getenv("OMPI_COMM_WORLD_SIZE");
    if (!text)
        text = getenv("PMI_SIZE");
    return text ? strtol(text, NULL, 10) : 1;
}

#ifndef LUMIBOX_MPI

lmg_result bake_team_join(bake_team **team, lmg_error *err)
{
    *team = NULL;
    return processes() > 1 ? lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                                      "this lumibake was built without MPI: under mpirun every process would do the same bake; install "
                                      "libopenmpi-dev and build again, or use --share K/N and merge")
                           : LMG_OK;
}

bool bake_team_is_helper(const bake_team *team)
{
    (void)team;
    return false;
}

lmg_result bake_team_work(bake_team *team, const struct lum_model *model, const struct bake_options *options, bool failed,
                          lmg_error *err)
{
    (void)team, (void)model, (void)options, (void)failed;
    return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "this lumibake was built without MPI");
}

void bake_team_leave(bake_team *team, int code)
{
    (void)team, (void)code;
}

#else

#include <mpi.h>

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { TAG_INVITATION = 1, TAG_INVITATION_BYTES, TAG_BLOCK, TAG_WANT, TAG_PART, TAG_PART_BYTES };
/* MPI counts bytes in an int. */
enum { PIECE = 1 << 28 };
/* Blocks last about so long: the first process answers between rounds of half a second. */
static const double BLOCK_SECONDS = 2;
static const uint64_t FIRST_BLOCK = 512;
/* A helper reports with every block; this is thirty of them, and a checkpoint of some gigabytes fits in as well. */
static const double SILENCE_SECONDS = 60;
/* The first process may be busy for longer: reading and merging parts of all others. */
static const double FIRST_SILENCE_SECONDS = 600;
static const double CHECKPOINT_SECONDS = 60;

typedef struct helper {
    bool gone;      /* sent its last part of this bake, or counts as dead */
    bool finished;  /* sent its last part of this bake */
    bool dismissed; /* has been told to send it */
    bool asked;     /* waits for a block */
    uint64_t wants;
    double heard; /* bake_clock */
} helper;

typedef struct team_mpi {
    bake_team team; /* first */
    int rank, size;
    bool begun, over, some_died;
    bake_part *handed; /* its ranges: photons that somebody has or had */
    uint64_t first, end;
    helper *helpers; /* by rank; [0] unused */
} team_mpi;

static void doze(void)
{
    const struct timespec millisecond = {0, 1000000};
    nanosleep(&millisecond, NULL);
}

/* Receives count bytes from rank; false when they don't come within so many seconds. */
static bool receive(int rank, int tag, void *bytes, uint64_t count, double seconds)
{
    for (uint64_t at = 0; at < count; at += PIECE) {
        const uint64_t left = count - at;
        MPI_Request request;
        if (MPI_Irecv((char *)bytes + at, (int)(left < PIECE ? left : PIECE), MPI_BYTE, rank, tag, MPI_COMM_WORLD, &request) != MPI_SUCCESS)
            return false;
        const double until = bake_clock() + seconds;
        int done = 0;
        while (MPI_Test(&request, &done, MPI_STATUS_IGNORE) == MPI_SUCCESS && !done && bake_clock() < until)
            doze();
        if (!done) {
            MPI_Cancel(&request);
            MPI_Request_free(&request);
            return false;
        }
    }
    return true;
}

static bool send(int rank, int tag, const void *bytes, uint64_t count)
{
    for (uint64_t at = 0; at < count; at += PIECE) {
        const uint64_t left = count - at;
        if (MPI_Send((const char *)bytes + at, (int)(left < PIECE ? left : PIECE), MPI_BYTE, rank, tag, MPI_COMM_WORLD) != MPI_SUCCESS)
            return false;
    }
    return true;
}

/* ---------------------------------------------------------------------------------------------------- parts as bytes */

typedef struct memory {
    char *bytes;
    size_t size, capacity;
} memory;

static bool append(void *self, const void *bytes, size_t count)
{
    memory *m = self;
    if (count > m->capacity - m->size) {
        const size_t capacity = 2 * m->capacity + count;
        char *more = realloc(m->bytes, capacity);
        if (!more)
            return false;
        m->bytes = more;
        m->capacity = capacity;
    }
    memcpy(m->bytes + m->size, bytes, count);
    m->size += count;
    return true;
}

/* A part of the same bake without photons. */
static lmg_result empty_like(const bake_part *part, bake_part **out, lmg_error *err)
{
    lmg_result result = bake_part_create(out, err);
    if (result != LMG_OK)
        return result;
    bake_part *p = *out;
    for (int i = 0; result == LMG_OK && i < PART_TEXT_COUNT; ++i)
        result = bake_part_set_text(p, (bake_part_text)i, part->texts[i], err);
    p->source_flux = part->source_flux;
    p->flux_lm = part->flux_lm;
    p->output_flux_lm = part->output_flux_lm;
    p->pilot_photons = part->pilot_photons;
    p->pilot_noise = part->pilot_noise;
    if (result == LMG_OK)
        result = lmg_accumulator_create(lmg_accumulator_layout(part->accumulator), &p->accumulator, err);
    if (result != LMG_OK) {
        bake_part_destroy(p);
        *out = NULL;
    }
    return result;
}

/* --------------------------------------------------------------------------------------------------- the first process */

static bool is_dead(const helper *h)
{
    return h->gone && !h->finished;
}

static lmg_result invite(bake_team *self, const bake_part *part, uint32_t effects, uint64_t first, uint64_t end, lmg_error *err)
{
    team_mpi *t = (team_mpi *)self;
    t->first = first;
    t->end = end;
    t->over = false;
    bake_part_destroy(t->handed);
    t->handed = NULL;
    bake_part *empty;
    memory m = {0};
    lmg_result result = bake_part_create(&t->handed, err);
    for (size_t i = 0; result == LMG_OK && i < part->range_count; ++i)
        result = bake_part_add_range(t->handed, part->ranges[i].first, part->ranges[i].count, err);
    if (result == LMG_OK)
        result = empty_like(part, &empty, err);
    if (result != LMG_OK)
        return result;
    result = bake_part_save(empty, append, &m, err);
    bake_part_destroy(empty);
    const uint64_t head[2] = {m.size, effects};
    for (int r = 1; result == LMG_OK && r < t->size; ++r) {
        if (is_dead(&t->helpers[r]))
            continue;
        t->helpers[r] = (helper){.heard = bake_clock()};
        if (!send(r, TAG_INVITATION, head, sizeof(head)) || !send(r, TAG_INVITATION_BYTES, m.bytes, m.size))
            t->helpers[r].gone = t->some_died = true;
    }
    free(m.bytes);
    t->begun = true;
    return result;
}

static bool take(bake_team *self, uint64_t most, uint64_t *first, uint64_t *count)
{
    team_mpi *t = (team_mpi *)self;
    if (!bake_part_gap(t->handed, t->first, t->end, first, count))
        return false;
    *count = *count < most ? *count : most;
    return bake_part_add_range(t->handed, *first, *count, NULL) == LMG_OK;
}

/* Takes the part that helper r has announced. */
static lmg_result receive_part(team_mpi *t, int r, bake_part *part, lmg_error *err)
{
    helper *h = &t->helpers[r];
    uint64_t head[2];
    if (!receive(r, TAG_PART, head, sizeof(head), SILENCE_SECONDS)) {
        h->gone = t->some_died = true;
        return LMG_OK;
    }
    char *bytes = malloc(head[0] + 1);
    if (!bytes)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the part of process %d", r);
    lmg_result result = LMG_OK;
    if (!receive(r, TAG_PART_BYTES, bytes, head[0], SILENCE_SECONDS)) {
        h->gone = t->some_died = true;
    } else if (head[0] > 0) {
        char name[32];
        snprintf(name, sizeof(name), "the part of process %d", r);
        bake_part *theirs;
        result = bake_part_load(bytes, head[0], name, &theirs, err);
        if (result == LMG_OK)
            result = bake_part_merge(part, "the bake", theirs, name, err);
        bake_part_destroy(theirs);
    }
    free(bytes);
    h->heard = bake_clock();
    if (!h->gone && head[1] != 0)
        h->gone = h->finished = true;
    return result;
}

/* Reads what helpers have sent. */
static lmg_result listen(team_mpi *t, bake_part *part, lmg_error *err)
{
    for (int r = 1; r < t->size; ++r) {
        helper *h = &t->helpers[r];
        int there = 0;
        while (!h->gone && MPI_Iprobe(r, TAG_WANT, MPI_COMM_WORLD, &there, MPI_STATUS_IGNORE) == MPI_SUCCESS && there) {
            if (receive(r, TAG_WANT, &h->wants, sizeof(h->wants), SILENCE_SECONDS))
                h->asked = true;
            h->heard = bake_clock();
        }
        while (!h->gone && MPI_Iprobe(r, TAG_PART, MPI_COMM_WORLD, &there, MPI_STATUS_IGNORE) == MPI_SUCCESS && there) {
            const lmg_result result = receive_part(t, r, part, err);
            if (result != LMG_OK)
                return result;
        }
        if (!h->gone && bake_clock() - h->heard > SILENCE_SECONDS) {
            h->gone = t->some_died = true;
            fprintf(stderr, "warning: process %d has been silent for %.0f s and counts as dead; its photons are traced again\n", r,
                    SILENCE_SECONDS);
        }
    }
    return LMG_OK;
}

static void answer(team_mpi *t, int r, uint64_t first, uint64_t count)
{
    const uint64_t block[2] = {first, count};
    t->helpers[r].asked = false;
    t->helpers[r].dismissed |= count == 0;
    if (!send(r, TAG_BLOCK, block, sizeof(block)))
        t->helpers[r].gone = t->some_died = true;
}

static lmg_result serve(bake_team *self, bake_part *part, lmg_error *err)
{
    team_mpi *t = (team_mpi *)self;
    const lmg_result result = listen(t, part, err);
    for (int r = 1; result == LMG_OK && r < t->size; ++r) {
        uint64_t first, count;
        if (t->helpers[r].asked && !t->helpers[r].gone && take(self, t->helpers[r].wants, &first, &count))
            answer(t, r, first, count);
    }
    return result;
}

static lmg_result gather(bake_team *self, bake_part *part, lmg_error *err)
{
    team_mpi *t = (team_mpi *)self;
    lmg_result result = LMG_OK;
    for (bool waiting = true; waiting && result == LMG_OK;) {
        result = listen(t, part, err);
        waiting = false;
        for (int r = 1; r < t->size; ++r) {
            helper *h = &t->helpers[r];
            if (h->asked && !h->dismissed && !h->gone)
                answer(t, r, 0, 0);
            waiting |= !h->gone;
        }
        if (waiting)
            doze();
    }
    t->over = true;
    return result;
}

/* -------------------------------------------------------------------------------------------------------- the helpers */

/* Sends part and empties it. */
static lmg_result ship(bake_part **part, bool last, lmg_error *err)
{
    memory m = {0};
    bake_part *next = NULL;
    lmg_result result = bake_part_save(*part, append, &m, err);
    if (result == LMG_OK)
        result = empty_like(*part, &next, err);
    const uint64_t head[2] = {m.size, last};
    if (result == LMG_OK && (!send(0, TAG_PART, head, sizeof(head)) || !send(0, TAG_PART_BYTES, m.bytes, m.size)))
        result = lmg_fail(err, LMG_ERROR_INTERNAL, "the first process can't be reached");
    free(m.bytes);
    if (result == LMG_OK) {
        bake_part_destroy(*part);
        *part = next;
    } else {
        bake_part_destroy(next);
    }
    return result;
}

static lmg_result trace_blocks(bake_part **part, bake_source *tracer, const bake_options *o, lmg_error *err)
{
    const double between = o->checkpoint_seconds > 0 ? o->checkpoint_seconds : CHECKPOINT_SECONDS;
    double ship_due = bake_clock() + between;
    uint64_t want = FIRST_BLOCK, block[2];
    bool reached = send(0, TAG_WANT, &want, sizeof(want));
    for (;;) {
        if (!reached || !receive(0, TAG_BLOCK, block, sizeof(block), FIRST_SILENCE_SECONDS))
            return lmg_fail(err, LMG_ERROR_INTERNAL, "the first process can't be reached");
        if (block[1] == 0 || (o->stop && *o->stop))
            return ship(part, true, err);
        const double began = bake_clock();
        reached = send(0, TAG_WANT, &want, sizeof(want));
        const lmg_sink sink = lmg_accumulator_sink((*part)->accumulator);
        lmg_result result = tracer->run(tracer, block[0], block[1], o->threads, &sink, 1, &(*part)->tally, err);
        if (result == LMG_OK)
            result = bake_part_add_range(*part, block[0], block[1], err);
        const double took = bake_clock() - began;
        (*part)->seconds += took;
        want = (uint64_t)fmax((double)FIRST_BLOCK, (double)block[1] * fmin(BLOCK_SECONDS / fmax(took, 1e-3), 64));
        if (result == LMG_OK && bake_clock() >= ship_due) {
            result = ship(part, false, err);
            ship_due = bake_clock() + between;
        }
        if (result != LMG_OK)
            return result;
    }
}

/* One bake that the first process has announced in head.  failed: this process can't help. */
static lmg_result work(const struct lum_model *model, const bake_options *options, const uint64_t head[2], bool failed,
                       lmg_error *err)
{
    char *bytes = malloc(head[0]);
    bake_part *part = NULL;
    bake_source *tracer = NULL;
    lmg_result result = bytes ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the layout");
    if (result == LMG_OK && !receive(0, TAG_INVITATION_BYTES, bytes, head[0], FIRST_SILENCE_SECONDS))
        result = lmg_fail(err, LMG_ERROR_INTERNAL, "the first process can't be reached");
    if (result == LMG_OK && failed)
        result = LMG_ERROR_INPUT; /* its caller has said why, or an earlier bake */
    else if (result == LMG_OK)
        result = bake_part_load(bytes, head[0], "the first process's layout", &part, err);
    free(bytes);
    if (result == LMG_OK)
        result = bake_tracer_create_with(model, (uint32_t)head[1], options->seed, NULL, &tracer, err);
    if (result == LMG_OK)
        result = trace_blocks(&part, tracer, options, err);
    if (result != LMG_OK) {
        const uint64_t nothing[2] = {0, 1};
        send(0, TAG_PART, nothing, sizeof(nothing));
    }
    if (tracer)
        tracer->destroy(tracer);
    bake_part_destroy(part);
    return result;
}

lmg_result bake_team_work(bake_team *self, const struct lum_model *model, const struct bake_options *options, bool failed,
                          lmg_error *err)
{
    team_mpi *t = (team_mpi *)self;
    lmg_result result = LMG_OK;
    for (;;) {
        uint64_t head[2] = {0}; /* as invite sends it, or bake_team_leave */
        /* the first process may spend long on its pilot, or on judging a box; should it die, mpirun ends this one */
        receive(0, TAG_INVITATION, head, sizeof(head), (double)INFINITY);
        if (head[0] == 0) {
            t->some_died = !head[1];
            return result;
        }
        /* one that failed in the middle of a bake might still get blocks of that one, so it stays out of the others */
        const lmg_result now = work(model, options, head, failed || result != LMG_OK, result == LMG_OK ? err : NULL);
        result = result == LMG_OK ? now : result;
    }
}

/* -------------------------------------------------------------------------------------------------- joining and leaving */

lmg_result bake_team_join(bake_team **team, lmg_error *err)
{
    *team = NULL;
    if (processes() <= 1)
        return LMG_OK;
    int provided;
    if (MPI_Init_thread(NULL, NULL, MPI_THREAD_FUNNELED, &provided) != MPI_SUCCESS || provided < MPI_THREAD_FUNNELED)
        return lmg_fail(err, LMG_ERROR_INTERNAL, "MPI doesn't start");
    MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
    team_mpi *t = calloc(1, sizeof(*t));
    if (t) {
        t->team = (bake_team){invite, take, serve, gather};
        MPI_Comm_rank(MPI_COMM_WORLD, &t->rank);
        MPI_Comm_size(MPI_COMM_WORLD, &t->size);
        t->helpers = calloc((size_t)t->size, sizeof(*t->helpers));
    }
    if (!t || !t->helpers) {
        free(t);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a team");
    }
    *team = &t->team;
    return LMG_OK;
}

bool bake_team_is_helper(const bake_team *team)
{
    return team && ((const team_mpi *)team)->rank > 0;
}

void bake_team_leave(bake_team *self, int code)
{
    team_mpi *t = (team_mpi *)self;
    if (!t)
        return;
    fflush(NULL);
    if (t->rank == 0 && t->begun && !t->over)
        MPI_Abort(MPI_COMM_WORLD, code); /* failed in the middle: the others would work for nobody */
    if (t->rank == 0) {
        const uint64_t go_home[2] = {0, !t->some_died};
        for (int r = 1; r < t->size; ++r)
            if (!is_dead(&t->helpers[r]))
                send(r, TAG_INVITATION, go_home, sizeof(go_home));
    }
    /* MPI_Finalize waits for all processes: where one died, leave without it */
    if (t->some_died)
        _exit(code);
    bake_part_destroy(t->handed);
    free(t->helpers);
    free(t);
    MPI_Finalize();
}

#endif
