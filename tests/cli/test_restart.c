/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Bakes that are interrupted, killed, resumed, shared and merged: always the bytes of one straight run.  And what must not be merged or
 * resumed: it ends in one line that says why.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "run_lumibake.h"

#include <jansson.h>

#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static char spot[1100], globe[1100]; /* sample lamps */

static void same_file(const char *a, const char *b)
{
    size_t na, nb;
    char *x = slurp(a, &na), *y = slurp(b, &nb);
    assert_true(x && y);
    if (na != nb || memcmp(x, y, na) != 0)
        fail_msg("%s and %s differ", a, b);
    free(x);
    free(y);
}

static bool exists(const char *path)
{
    return access(path, F_OK) == 0;
}

/* A path that stays valid (in_folder's doesn't for long). */
typedef struct name {
    char text[1200];
} name;
static name path_of(const char *file)
{
    name n;
    snprintf(n.text, sizeof(n.text), "%s", in_folder(file));
    return n;
}

static void bake(const char *const *args)
{
    outcome o = run_args(args);
    if (o.code != 0)
        fail_msg("exit code %d: %s", o.code, o.err);
    release(&o);
}
/* all effects: the plan's measuring of each takes longer than these bakes; test_mpi has it */
#define BAKE(...) bake((const char *const[]){"bake", __VA_ARGS__, "--cells", "1e5", "--effects", "all", "-q", NULL})
#define BAKE_PLANNED(...) bake((const char *const[]){"bake", __VA_ARGS__, "--cells", "1e5", "-q", NULL})

/* ------------------------------------------------------------------------------------------------------------- merging */

/* Seven uneven parts of 300,000 photons, each by first photon and number; two have a single photon. */
static const int PARTS[7][2] = {{0, 1}, {1, 49999}, {50000, 100000}, {150000, 4097}, {154097, 45903}, {200000, 99999}, {299999, 1}};

static void test_seven_uneven_parts(void **state)
{
    (void)state;
    const name whole = path_of("whole.box.exr"), merged = path_of("merged.box.exr");
    BAKE(globe, "-o", whole.text, "--photons", "300000", "--pilot", "20000", "--seed", "5");
    assert_false(exists(in_folder("whole.box.exr.part")));
    name parts[7];
    for (int i = 0; i < 7; ++i) {
        char box[32], first[16], count[16];
        snprintf(box, sizeof(box), "p%d.box.exr", i);
        snprintf(first, sizeof(first), "%d", PARTS[i][0]);
        snprintf(count, sizeof(count), "%d", PARTS[i][1]);
        const name output = path_of(box);
        BAKE(globe, "-o", output.text, "--first", first, "--photons", count, "--pilot", "20000", "--seed", "5", "--threads",
             (const char *const[]){"1", "2", "3", "8"}[i % 4]);
        snprintf(box, sizeof(box), "p%d.box.exr.part", i);
        parts[i] = path_of(box);
    }
    static const int ORDERS[3][7] = {{0, 1, 2, 3, 4, 5, 6}, {6, 5, 4, 3, 2, 1, 0}, {3, 0, 6, 2, 5, 1, 4}};
    for (int k = 0; k < 3; ++k) {
        const char *args[12] = {"merge"};
        for (int i = 0; i < 7; ++i)
            args[1 + i] = parts[ORDERS[k][i]].text;
        args[8] = "-o";
        args[9] = merged.text;
        args[10] = "-q";
        bake(args);
        same_file(whole.text, merged.text);
    }
    /* in two steps, through a kept sum */
    const name half = path_of("half.box.exr"), kept = path_of("half.box.exr.part");
    bake((const char *const[]){"merge", parts[4].text, parts[0].text, parts[2].text, "-o", half.text, "--keep", "-q", NULL});
    bake((const char *const[]){"merge", parts[5].text, parts[1].text, kept.text, parts[6].text, parts[3].text, "-o", merged.text,
                               "-q", NULL});
    same_file(whole.text, merged.text);
    /* the gaps of a kept sum are what resuming fills */
    BAKE(globe, "-o", half.text, "--photons", "300000", "--seed", "5", "--resume");
    same_file(whole.text, half.text);
    assert_false(exists(kept.text));
    /* a box of scattered photons says which */
    outcome o = RUN("merge", parts[5].text, parts[1].text, "-o", merged.text, "--json");
    assert_int_equal(o.code, 0);
    json_t *j = json_loads(o.out, 0, NULL);
    assert_int_equal(json_array_size(json_object_get(j, "ranges")), 2);
    assert_int_equal(json_integer_value(json_object_get(j, "photons")), 49999 + 99999);
    json_decref(j);
    release(&o);
    o = RUN("info", merged.text);
    assert_non_null(strstr(o.out, "1-49999,200000-299998"));
    release(&o);
}

static uint64_t photons_of(const char *const *args)
{
    outcome o = run_args(args);
    if (o.code != 0)
        fail_msg("exit code %d: %s", o.code, o.err);
    json_t *j = json_loads(o.out, 0, NULL);
    const uint64_t photons = (uint64_t)json_integer_value(json_object_get(j, "photons"));
    json_decref(j);
    release(&o);
    return photons;
}

/* A bake by time goes on for longer, and by photons, with the plan it began with: those of short bakes are made of fewer photons. */
static void test_more_time(void **state)
{
    (void)state;
    const name box = path_of("time.box.exr");
#define TIMED(...) photons_of((const char *const[]){"bake", globe, "-o", box.text, "--cells", "1e5", "--keep", "--json", "-q", __VA_ARGS__, NULL})
    const uint64_t some = TIMED("--time", "0.1s"), more = TIMED("--resume", "--time", "3s");
    assert_true(more > some);
    char all[24];
    snprintf(all, sizeof(all), "%llu", (unsigned long long)more + 1000);
    assert_int_equal(TIMED("--resume", "--photons", all), more + 1000);
#undef TIMED
}

static void test_shares(void **state)
{
    (void)state;
    const name whole = path_of("whole.box.exr"), merged = path_of("merged.box.exr");
    BAKE(spot, "-o", whole.text, "--photons", "300001");
    static const char *const SHARES[3] = {"1/3", "2/3", "3/3"}, *const BOXES[3] = {"s1.box.exr", "s2.box.exr", "s3.box.exr"};
    for (int i = 0; i < 3; ++i)
        BAKE(spot, "-o", in_folder(BOXES[i]), "--photons", "300001", "--share", SHARES[i]);
    const name a = path_of("s1.box.exr.part"), b = path_of("s2.box.exr.part"), c = path_of("s3.box.exr.part");
    bake((const char *const[]){"merge", b.text, c.text, a.text, "-o", merged.text, "-q", NULL});
    same_file(whole.text, merged.text);
}

/* Parts keep no rays: what is merged has no trees, and who asked for some hears of it. */
static void test_merged_without_trees(void **state)
{
    (void)state;
    static const char *const ASKED[3][2] = {{"--trees", "0"}, {"--trees", "2"}, {"--looks", "1000"}};
    const name box = path_of("grown.box.exr"), part = path_of("grown.box.exr.part"), merged = path_of("merged.box.exr");
    for (int i = 0; i < 3; ++i) {
        bake((const char *const[]){"bake", spot, "-o", box.text, "--photons", "20000", "--cells", "1e4", ASKED[i][0], ASKED[i][1], "--keep",
                                   "-q", NULL});
        outcome o = RUN("merge", part.text, "-o", merged.text);
        assert_int_equal(o.code, 0);
        assert_non_null(strstr(o.out, "trees     none"));
        assert_true((strstr(o.err, "warning: no radiance trees") != NULL) == (i > 0));
        release(&o);
        o = RUN("info", merged.text, "--json");
        json_t *j = json_loads(o.out, 0, NULL);
        assert_true(json_is_null(json_object_get(j, "trees")));
        json_decref(j);
        release(&o);
    }
}

static void test_strangers_are_refused(void **state)
{
    (void)state;
    const name p0 = path_of("p0.box.exr.part"), out = path_of("merged.box.exr"), box = path_of("other.box.exr");
    const name other = path_of("other.box.exr.part");
    BAKE(globe, "-o", path_of("p0.box.exr").text, "--first", "0", "--photons", "1000", "--pilot", "20000", "--seed", "5");
    static const struct {
        const char *lamp, *option, *value, *seed, *pilot, *why;
    } STRANGERS[] = {
        {spot, "--threads", "1", "5", "20000", "recipe"}, /* the spot has one, the globe none */
        {globe, "--flux", "700lm", "5", "20000", "settings"},
        {globe, "--layout", "cube", "5", "20000", "settings"},
        {globe, "--set", "leave-out:Socket", "5", "20000", "recipe"},
        {globe, "--threads", "1", "6", "20000", "seed 5 and 6"},
        {globe, "--threads", "1", "5", "30000", "pilot_photons 20000 and 30000"},
        {globe, "--threads", "1", "5", "20000", "photons 500 to 999 are in both"},
    };
    for (size_t i = 0; i < sizeof(STRANGERS) / sizeof(STRANGERS[0]); ++i) {
        outcome o = RUN("bake", STRANGERS[i].lamp, "-o", box.text, "--first", "500", "--photons", "1000", "--pilot", STRANGERS[i].pilot,
                        "--seed", STRANGERS[i].seed, STRANGERS[i].option, STRANGERS[i].value, "--cells", "1e5", "--effects", "all", "-q");
        if (o.code == 0)
            EXPECT(RUN("merge", p0.text, other.text, "-o", out.text), 3, STRANGERS[i].why);
        else
            fail_msg("case %zu: %s", i, o.err);
        release(&o);
    }
    EXPECT(RUN("merge", p0.text, p0.text, "-o", out.text), 3, "overlap");
    EXPECT(RUN("merge", p0.text, spot, "-o", out.text), 3, "not a checkpoint");
    EXPECT(RUN("merge", p0.text, "-o", p0.text), 1, "overwrite");
    EXPECT(RUN("merge", p0.text), 2, "-o");
    EXPECT(RUN("merge", "-o", out.text), 2, "which parts");
    EXPECT(RUN("merge", in_folder("missing.part"), "-o", out.text), 3, "No such file");
    EXPECT(RUN("bake", spot, "-o", out.text, "--photons", "0"), 2, "no photons, no light");
    EXPECT(RUN("bake", spot, "-o", out.text, "--photons", "10", "--share", "3/2"), 2, "--share");
    EXPECT(RUN("bake", spot, "-o", out.text, "--share", "1/2"), 2, "--share needs --photons");
    EXPECT(RUN("bake", spot, "-o", out.text, "--photons", "1", "--share", "1/2"), 2, "too many shares");
    EXPECT(RUN("bake", spot, "-o", out.text, "--photons", "10", "--first", "3"), 2, "--first needs --pilot");
    EXPECT(RUN("bake", spot, "-o", out.text, "--checkpoint", "61s"), 2, "more than a minute");

    /* nor may a bake go on from them */
    const name at = path_of("p0.box.exr");
    EXPECT(RUN("bake", globe, "-o", at.text, "--photons", "5000", "--cells", "1e5", "--effects", "all", "--seed", "6", "--resume", "-q"), 3, "seed 5 and 6");
    EXPECT(RUN("bake", globe, "-o", at.text, "--photons", "5000", "--cells", "1e5", "--effects", "all", "--seed", "5", "--pilot", "50000", "--resume", "-q"), 3,
           "leave --pilot out");
    EXPECT(RUN("bake", globe, "-o", at.text, "--photons", "500", "--cells", "1e5", "--effects", "all", "--seed", "5", "--resume", "-q"), 3, "ask for more");
    EXPECT(RUN("bake", spot, "-o", at.text, "--photons", "5000", "--cells", "1e5", "--effects", "all", "--seed", "5", "--resume", "-q"), 3, "recipe");
}

/* Cut anywhere or with a bit flipped anywhere: one line, exit code 3. */
static void test_damaged_parts(void **state)
{
    (void)state;
    const name good = path_of("d.box.exr"), part = path_of("d.box.exr.part"), bad = path_of("bad.part"), out = path_of("merged.box.exr");
    BAKE(spot, "-o", good.text, "--photons", "3000", "--keep");
    size_t size;
    char *bytes = slurp(part.text, &size);
    assert_non_null(bytes);
    uint64_t random = 12345;
    for (int i = 0; i < 60; ++i) {
        random = random * 6364136223846793005u + 1442695040888963407u;
        size_t at = (size_t)(random >> 16) % size;
        if (i < 20)
            at = at % 1500; /* the head */
        if (i % 2 == 0) {
            write_file(bad.text, bytes, at);
        } else {
            bytes[at] = (char)(bytes[at] ^ 1 << (random >> 8) % 8);
            write_file(bad.text, bytes, size);
            bytes[at] = (char)(bytes[at] ^ 1 << (random >> 8) % 8);
        }
        outcome o = RUN("merge", bad.text, "-o", out.text);
        if (o.code != 3 || lines_with(o.err, "error:") != 1)
            fail_msg("%s at byte %zu: exit code %d: %s", i % 2 ? "flipped" : "cut", at, o.code, o.err);
        release(&o);
    }
    write_file(part.text, bytes, size / 2);
    EXPECT(RUN("bake", spot, "-o", good.text, "--photons", "3000", "--cells", "1e5", "--effects", "all", "--resume"), 3, "cut short or altered");
    free(bytes);
}

/* ------------------------------------------------------------------------------------------------------------- restart */

/* When a file was last written to; 0: it isn't there. */
static double written(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 ? (double)s.st_mtim.tv_sec + 1e-9 * (double)s.st_mtim.tv_nsec : 0;
}

/* Waits until a process has written a file that was `before`, or has ended.  However busy the machine is: no time is meant. */
static bool wait_written(pid_t pid, const char *path, double before)
{
    for (;;) {
        siginfo_t info = {.si_pid = 0};
        assert_int_equal(waitid(P_PID, (id_t)pid, &info, WEXITED | WNOHANG | WNOWAIT), 0);
        const double now = written(path);
        if (now != before && now > 0)
            return true;
        if (info.si_pid != 0)
            return false;
        pause_seconds(2e-4);
    }
}

/* Stops a process (SIGSTOP) at an instant when there is a file that was `before`, another one since, or waits until it has ended.
 */
static bool stop_in_writing(pid_t pid, const char *path, double before)
{
    for (;;) {
        kill(pid, SIGSTOP);
        siginfo_t info = {.si_pid = 0};
        assert_int_equal(waitid(P_PID, (id_t)pid, &info, WEXITED | WSTOPPED | WNOWAIT), 0);
        if (info.si_code != CLD_STOPPED)
            return false;
        const double now = written(path);
        if (now != before && now > 0)
            return true;
        assert_int_equal(waitid(P_PID, (id_t)pid, &info, WSTOPPED), 0);
        kill(pid, SIGCONT);
        pause_seconds(2e-4);
    }
}

static uint64_t random_state;
static double uniform(void) /* [0,1) */
{
    uint64_t z = random_state += 0x9e3779b97f4a7c15u;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

/* Ctrl-C, again and again: each time a valid box, and in the end the bytes of a bake that nobody interrupted. */
static void test_interrupted_and_resumed(void **state)
{
    (void)state;
    const name whole = path_of("whole.box.exr"), box = path_of("stopped.box.exr"), part = path_of("stopped.box.exr.part");
    BAKE(spot, "-o", whole.text, "--photons", "9e6");
    unlink(part.text);
    int interruptions = 0, code = -1;
    random_state = 5;
    for (int i = 0; i < 5 && code != 0; ++i) {
        const double before = written(part.text);
        const pid_t pid = start((const char *const[]){"bake", spot, "-o", box.text, "--photons", "9e6", "--cells", "1e5", "--effects", "all", "--resume",
                                                      "--checkpoint", "0.05s", i % 2 ? "--threads" : "-q", i % 2 ? "3" : NULL, NULL});
        if (wait_written(pid, part.text, before)) { /* it traces, and so it listens */
            pause_seconds(0.05 * uniform());
            kill(pid, i % 2 ? SIGINT : SIGTERM);
        }
        outcome o = finish(pid);
        code = o.code;
        release(&o);
        if (code == 130) {
            ++interruptions;
            assert_true(exists(part.text));
            o = RUN("info", box.text);
            assert_int_equal(o.code, 0);
            release(&o);
        } else {
            assert_int_equal(code, 0);
        }
    }
    assert_true(interruptions >= 1);
    if (code != 0)
        BAKE(spot, "-o", box.text, "--photons", "9e6", "--resume");
    same_file(whole.text, box.text);
    assert_false(exists(part.text));
}

/*
 * kill -9 at random instants: of a bake from its start to its end, and while a checkpoint is being written.  Whatever is there
 * afterwards is whole, and resuming gives the bytes of one straight run.  `test_restart kill NUMBER SEED` does only this.
 */
static uint64_t kills = 24, kill_seed = 1;

static void test_killed_and_resumed(void **state)
{
    (void)state;
    const name whole = path_of("whole.box.exr"), box = path_of("killed.box.exr"), part = path_of("killed.box.exr.part"), look = path_of("look.box.exr");
    const name unfinished = path_of("killed.box.exr.part.new");
#define SHORT_BAKE(box) "bake", spot, "-o", box, "--photons", "300000", "--pilot", "5000", "--layout", "aperture", "--resolution", "9,9,9,9", "--effects", "all", "-q"
    struct timespec began, ended;
    clock_gettime(CLOCK_MONOTONIC, &began);
    bake((const char *const[]){SHORT_BAKE(whole.text), NULL});
    clock_gettime(CLOCK_MONOTONIC, &ended);
    const double duration = (double)(ended.tv_sec - began.tv_sec) + 1e-9 * (double)(ended.tv_nsec - began.tv_nsec);
    unlink(part.text);
    unlink(box.text);
    random_state = kill_seed;
    uint64_t killed = 0, with_checkpoint = 0, in_writing = 0, finished = 0;
    for (uint64_t i = 0; i < kills; ++i) {
        const double before = written(unfinished.text), part_before = written(part.text);
        const pid_t pid = start((const char *const[]){SHORT_BAKE(box.text), "--resume", "--checkpoint", "0.001s", NULL});
        /* every fourth time in the second checkpoint, every fourth in one at random */
        if (i % 4 == 1)
            wait_written(pid, part.text, part_before);
        else
            pause_seconds(1.1 * duration * uniform());
        const bool writing = i % 2 && stop_in_writing(pid, unfinished.text, before);
        kill(pid, SIGKILL);
        outcome o = finish(pid);
        if (o.code != 0 && o.code != KILLED + SIGKILL)
            fail_msg("kill %llu of seed %llu: exit code %d: %s", (unsigned long long)i, (unsigned long long)kill_seed, o.code, o.err);
        const bool ended_itself = o.code == 0;
        release(&o);
        killed += !ended_itself;
        in_writing += writing;
        if (exists(box.text)) /* it gets its name when it's whole */
            same_file(whole.text, box.text);
        if (exists(part.text)) {
            ++with_checkpoint;
            o = RUN("merge", part.text, "-o", look.text, "-q");
            if (o.code != 0)
                fail_msg("after kill %llu of seed %llu: %s", (unsigned long long)i, (unsigned long long)kill_seed, o.err);
            release(&o);
        }
        if (ended_itself || uniform() < 0.25) {
            bake((const char *const[]){SHORT_BAKE(box.text), "--resume", NULL});
            same_file(whole.text, box.text);
            assert_false(exists(part.text));
            unlink(box.text);
            ++finished;
        }
    }
    bake((const char *const[]){SHORT_BAKE(box.text), "--resume", NULL});
    same_file(whole.text, box.text);
    assert_false(exists(part.text));
    print_message("seed %llu: %llu runs, %llu killed, %llu left a checkpoint, %llu were writing one; %llu + 1 resumed to the end\n",
                  (unsigned long long)kill_seed, (unsigned long long)kills, (unsigned long long)killed,
                  (unsigned long long)with_checkpoint, (unsigned long long)in_writing, (unsigned long long)finished);
    /* a bake of 300,000 photons writes checkpoints a millisecond apart: the second is met for certain, and the first is there then
     */
    assert_true(killed >= 1 && with_checkpoint >= 1 && in_writing >= 1);
}

/* A finished bake that was kept goes on to more photons. */
static void test_more_photons(void **state)
{
    (void)state;
    const name whole = path_of("whole.box.exr"), box = path_of("more.box.exr");
    BAKE(globe, "-o", whole.text, "--photons", "200000", "--pilot", "30000");
    BAKE(globe, "-o", box.text, "--photons", "77777", "--pilot", "30000", "--keep");
    BAKE(globe, "-o", box.text, "--photons", "200000", "--resume");
    same_file(whole.text, box.text);
}

/* Trees grow of the bake's first photons, whoever traces them and when: on any number of threads, once more after resuming, and of those
 * that an interrupted bake has. */
static void test_trees(void **state)
{
    (void)state;
    const name whole = path_of("whole.box.exr"), box = path_of("trees.box.exr"), part = path_of("trees.box.exr.part");
#define TREES(box, ...) BAKE(globe, "-o", box, "--pilot", "30000", "--trees", "4", __VA_ARGS__)
    TREES(whole.text, "--photons", "100000", "--threads", "1");
    TREES(box.text, "--photons", "100000", "--threads", "3");
    same_file(whole.text, box.text);
    TREES(box.text, "--photons", "33333", "--keep");
    TREES(box.text, "--photons", "100000", "--resume");
    same_file(whole.text, box.text);
    assert_false(exists(part.text));

    const name few = path_of("few.box.exr");
    const pid_t pid = start((const char *const[]){"bake", globe, "-o", box.text, "--pilot", "30000", "--trees", "4", "--photons", "1e9", "--cells",
                                                  "1e5", "--effects", "all", "--checkpoint", "0.05s", NULL});
    wait_written(pid, part.text, 0);
    kill(pid, SIGINT);
    outcome o = finish(pid);
    assert_int_equal(o.code, 130);
    release(&o);
    o = RUN("info", box.text, "--json");
    assert_int_equal(o.code, 0);
    json_t *j = json_loads(o.out, 0, NULL);
    assert_true(json_is_null(json_object_get(j, "trees"))); /* they are for the whole bake */
    char traced[24];
    const json_int_t photons = json_integer_value(json_object_get(json_object_get(j, "ledger"), "photons"));
    snprintf(traced, sizeof(traced), "%lld", (long long)photons);
    json_decref(j);
    release(&o);
    /* with other trees it would be another box */
    EXPECT(RUN("bake", globe, "-o", box.text, "--photons", "1e9", "--cells", "1e5", "--effects", "all", "--resume", "-q"), 3, "settings");
    /* going on without a photon more makes up for them */
    TREES(few.text, "--photons", traced);
    TREES(box.text, "--photons", traced, "--resume");
    same_file(few.text, box.text);
#undef TREES
    unlink(part.text);
}

/* The same of trees that grow of looks into the lamp. */
static void test_looks(void **state)
{
    (void)state;
    const char *const lens = LUMIBOX_BINARY_DIR "/models/glass-lens/glass-lens.gltf";
    const name whole = path_of("whole.box.exr"), box = path_of("looks.box.exr"), part = path_of("looks.box.exr.part");
#define LOOKS(box, ...) BAKE_PLANNED(lens, "-o", box, "--pilot", "30000", "--trees", "4", "--looks", "30000", __VA_ARGS__)
    LOOKS(whole.text, "--photons", "100000", "--threads", "1");
    outcome o = RUN("info", whole.text, "--json");
    json_t *j = json_loads(o.out, 0, NULL);
    assert_int_equal(json_integer_value(json_object_get(json_object_get(j, "trees"), "looks")), 30000);
    json_decref(j);
    release(&o);
    LOOKS(box.text, "--photons", "100000", "--threads", "3");
    same_file(whole.text, box.text);
    LOOKS(box.text, "--photons", "33333", "--keep");
    LOOKS(box.text, "--photons", "100000", "--resume");
    same_file(whole.text, box.text);

    /* interrupted while it looks: nothing but that is missing, and going on makes up for it */
#define MANY "bake", lens, "-o", box.text, "--pilot", "30000", "--trees", "4", "--cells", "1e5", "--photons", "100000", "--looks"
    const pid_t pid = start((const char *const[]){MANY, "32000000", NULL});
    pause_seconds(3);
    kill(pid, SIGINT);
    o = finish(pid);
    assert_int_equal(o.code, 130);
    release(&o);
    assert_true(exists(part.text));
    o = RUN("info", box.text, "--json");
    assert_int_equal(o.code, 0);
    j = json_loads(o.out, 0, NULL);
    assert_true(json_is_null(json_object_get(j, "trees")));
    json_decref(j);
    release(&o);
    EXPECT(RUN(MANY, "30000", "--resume"), 3, "settings");
    unlink(part.text);
#undef MANY
#undef LOOKS
}

/* ----------------------------------------------------------------------------------------------------------------- MPI */

#ifdef MPIRUN
static pid_t start_team(const char *const *args)
{
    const char *all[32] = {"--oversubscribe", "--bind-to", "none", "-n", "3", LUMIBAKE, "bake"};
    int n = 7;
    while (*args)
        all[n++] = *args++;
    return start_program(MPIRUN, all);
}

/* The last child of a process, 0 if it has none yet. */
static pid_t last_child(pid_t parent)
{
    char path[64];
    snprintf(path, sizeof(path), "/proc/%d/task/%d/children", (int)parent, (int)parent);
    FILE *f = fopen(path, "r");
    int child, last = 0;
    while (f && fscanf(f, "%d", &child) == 1)
        last = child;
    if (f)
        fclose(f);
    return (pid_t)last;
}
#endif

/* Three processes give the bytes of one; when one of them is killed, resuming from the checkpoint does. */
static void test_mpi(void **state)
{
    (void)state;
#ifndef MPIRUN
    print_message("skipped: test_mpi: built without MPI\n");
    skip();
#else
    setenv("OMPI_ALLOW_RUN_AS_ROOT", "1", 1);
    setenv("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1", 1);
    setenv("ASAN_OPTIONS", "detect_leaks=0", 1); /* Open MPI's own */
    const name whole = path_of("whole.box.exr"), box = path_of("team.box.exr"), part = path_of("team.box.exr.part");
    unlink(part.text);
    BAKE_PLANNED(globe, "-o", whole.text, "--photons", "2e6");
    outcome o = finish(start_team((const char *const[]){globe, "-o", box.text, "--photons", "2e6", "--cells", "1e5", "--threads", "1",
                                                        "--checkpoint", "0.5s", "-q", NULL}));
    if (o.code != 0)
        fail_msg("exit code %d: %s", o.code, o.err);
    release(&o);
    same_file(whole.text, box.text);
    assert_false(exists(part.text));

    const pid_t pid = start_team((const char *const[]){globe, "-o", box.text, "--photons", "2e9", "--pilot", "100000", "--cells", "1e5",
                                                       "--threads", "1", "--checkpoint", "0.5s", "-q", NULL});
    for (int i = 0; i < 600 && !exists(part.text); ++i)
        pause_seconds(0.1);
    assert_true(exists(part.text));
    const pid_t victim = last_child(pid);
    assert_true(victim > 0 && kill(victim, SIGKILL) == 0);
    o = finish(pid);
    assert_true(o.code != 0); /* mpirun ends all when one dies */
    release(&o);
    o = RUN("merge", part.text, "-o", path_of("look.box.exr").text, "--json");
    assert_int_equal(o.code, 0);
    json_t *j = json_loads(o.out, 0, NULL);
    const json_int_t photons = json_integer_value(json_object_get(j, "photons"));
    json_t *ranges = json_object_get(j, "ranges"), *last = json_array_get(ranges, json_array_size(ranges) - 1);
    /* gaps are what was handed out and hadn't come back: a bake of all up to the last one fills them */
    char all[32];
    const json_int_t end = json_integer_value(json_array_get(last, 0)) + json_integer_value(json_array_get(last, 1));
    snprintf(all, sizeof(all), "%lld", (long long)end);
    json_decref(j);
    release(&o);
    assert_true(photons > 0 && photons <= end);
    BAKE_PLANNED(globe, "-o", box.text, "--photons", all, "--resume");
    BAKE_PLANNED(globe, "-o", whole.text, "--photons", all, "--pilot", "100000");
    same_file(whole.text, box.text);
    EXPECT(finish(start_team((const char *const[]){"missing.gltf", "-o", box.text, NULL})), 3, "missing.gltf");

    /* trees, of photons that no process has traced alone */
    BAKE(globe, "-o", whole.text, "--photons", "100000", "--trees", "4");
    o = finish(start_team((const char *const[]){globe, "-o", box.text, "--photons", "100000", "--trees", "4", "--cells", "1e5", "--effects", "all",
                                                "--threads", "1", "-q", NULL}));
    if (o.code != 0)
        fail_msg("exit code %d: %s", o.code, o.err);
    release(&o);
    same_file(whole.text, box.text);

    const char *const lens = LUMIBOX_BINARY_DIR "/models/glass-lens/glass-lens.gltf";
    BAKE_PLANNED(lens, "-o", whole.text, "--photons", "100000", "--trees", "4", "--looks", "30000");
    o = finish(start_team((const char *const[]){lens, "-o", box.text, "--photons", "100000", "--trees", "4", "--looks", "30000", "--cells", "1e5",
                                                "--threads", "1", "-q", NULL}));
    if (o.code != 0)
        fail_msg("exit code %d: %s", o.code, o.err);
    release(&o);
    same_file(whole.text, box.text);

    /* a search for an error, two bakes of it at least, one after the other */
    o = RUN("bake", globe, "-o", whole.text, "--error", "4%", "--cells", "1e5", "--effects", "all");
    assert_true(o.code == 0 && strstr(o.err, "bake 2:"));
    release(&o);
    o = finish(start_team((const char *const[]){globe, "-o", box.text, "--error", "4%", "--cells", "1e5", "--effects", "all",
                                                "--threads", "1", "-q", NULL}));
    if (o.code != 0)
        fail_msg("exit code %d: %s", o.code, o.err);
    release(&o);
    same_file(whole.text, box.text);
    unsetenv("ASAN_OPTIONS");
#endif
}

static int setup(void **state)
{
    (void)state;
    snprintf(folder, sizeof(folder), "%s/tests/cli_restart", LUMIBOX_BINARY_DIR);
    mkdir(folder, 0777);
    snprintf(spot, sizeof(spot), "%s/models/paraboloid-spot/paraboloid-spot.gltf", LUMIBOX_BINARY_DIR);
    snprintf(globe, sizeof(globe), "%s/models/opal-globe/opal-globe.gltf", LUMIBOX_BINARY_DIR);
    write_file(in_folder("stdin"), "", 0);
    return 0;
}

int main(int argc, char **argv)
{
    if (argc == 4 && strcmp(argv[1], "kill") == 0) {
        kills = strtoull(argv[2], NULL, 10);
        kill_seed = strtoull(argv[3], NULL, 10);
        const struct CMUnitTest sweep[] = {cmocka_unit_test(test_killed_and_resumed)};
        return cmocka_run_group_tests_name("restart_kill", sweep, setup, NULL);
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_seven_uneven_parts),      cmocka_unit_test(test_shares),
        cmocka_unit_test(test_strangers_are_refused),   cmocka_unit_test(test_damaged_parts),
        cmocka_unit_test(test_more_time), cmocka_unit_test(test_interrupted_and_resumed), cmocka_unit_test(test_killed_and_resumed),
        cmocka_unit_test(test_more_photons),            cmocka_unit_test(test_trees),
        cmocka_unit_test(test_looks),                   cmocka_unit_test(test_mpi),
        cmocka_unit_test(test_merged_without_trees),
    };
    return cmocka_run_group_tests_name("restart", tests, setup, NULL);
}
