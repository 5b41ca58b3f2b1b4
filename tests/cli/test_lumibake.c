/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The program lumibake as a user meets it: exit codes, messages, files left behind, Ctrl-C, the same bytes for any number of
 * threads, tables of numbers, and bad input of every kind, which must end in one line that begins with "error:".
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "run_lumibake.h"

#include <jansson.h>

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static char lamp[1100]; /* a sample lamp */
static char box[1100];  /* and its box, baked by setup */

/* ------------------------------------------------------------------------------------------------------ usage and help */

static void test_help(void **state)
{
    (void)state;
    static const char *const COMMANDS[] = {"bake", "info", "probe", "compare"};
    outcome o = RUN("--help");
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "Example"));
    for (int i = 0; i < 4; ++i)
        assert_non_null(strstr(o.out, COMMANDS[i]));
    release(&o);
    for (int i = 0; i < 4; ++i) {
        o = RUN(COMMANDS[i], "--help");
        assert_int_equal(o.code, 0);
        assert_non_null(strstr(o.out, "Example:"));
        assert_true(lines_of(o.out) <= 50); /* a screen */
        for (const char *line = o.out; *line; line += strcspn(line, "\n"), line += *line == '\n')
            assert_true(strcspn(line, "\n") <= 80);
        release(&o);
    }
    o = RUN("--version");
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "lumibake"));
    assert_non_null(strstr(o.out, "Embree"));
    assert_non_null(strstr(o.out, "OpenEXR"));
    release(&o);
}

static void test_usage_errors(void **state)
{
    (void)state;
    EXPECT(RUN("cook"), 2, "cook");
    EXPECT(RUN("bake"), 2, "which lamp");
    EXPECT(RUN("bake", lamp), 2, "-o");
    EXPECT(RUN("bake", lamp, lamp, "-o", "x.exr"), 2, "one lamp");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--time", "60s", "--photons", "1e6"), 2, "exclude");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--flux", "60s"), 2, "60s");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--flux", "-3lm"), 2, "-3lm");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--flux", "nan"), 2, "nan");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--time", "soon"), 2, "soon");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--photons", "0"), 2, "--photons");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--photons", "1.5"), 2, "1.5");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--photons", "-5"), 2, "-5");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--threads", "0"), 2, "--threads");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--layout", "sphere"), 2, "sphere");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--resolution", "8,8,8"), 2, "8,8,8");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--recipe", "r.json", "--no-recipe"), 2, "exclude");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--trees", "17"), 2, "--trees");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--trees", "8", "--photons", "1000", "--share", "1/2"), 2, "leave these out");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--trees", "8", "--photons", "1000", "--first", "500", "--pilot", "1000"), 2, "leave these out");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--looks", "100", "--photons", "1000", "--share", "1/2"), 2, "leave these out");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--looks", "100", "--error", "2%"), 2, "--error judges cells");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--trees", "8", "--error", "2%"), 2, "--error judges cells");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--looks", "100", "--trees", "0"), 2, "--trees 0");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--trees", "1"), 2, "2 to 16");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--photons-only", "--looks", "100"), 2, "leave out --looks");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--photons-only", "--gather", "auto"), 2, "leave out --looks and --gather");
    EXPECT(RUN("bake", lamp, "-o", "x.exr", "--trees", "8", "--looks", "1e9"), 2, "--looks");
    EXPECT(RUN("probe", box), 2, "--points");
    EXPECT(RUN("probe", box, "--points", "-", "--rays", "-"), 2, "at a time");
    EXPECT(RUN("probe", box, "--points", "-", "--linear"), 2, "--rays");
    EXPECT(RUN("compare", box), 2, "two files");
    EXPECT(RUN("compare", box, box, "--distances", "1,,2"), 2, "1,,2");
    EXPECT(RUN("compare", box, box, "--distances", "0"), 2, "0");
    outcome o = RUN("bake", "--no-such-option"); /* argp's own message */
    assert_int_equal(o.code, 2);
    release(&o);
    o = RUN("--help", "me");
    assert_int_equal(o.code, 0);
    release(&o);
}

static void test_missing_files(void **state)
{
    (void)state;
    EXPECT(RUN("bake", "/no/such/lamp.gltf", "-o", in_folder("x.exr")), 3, "lamp.gltf");
    EXPECT(RUN("bake", lamp, "-o", "/no/such/folder/x.exr"), 1, "folder");
    EXPECT(RUN("bake", lamp, "-o", folder), 1, "directory");
    EXPECT(RUN("bake", lamp, "-o", lamp), 1, "overwrite");
    EXPECT(RUN("bake", lamp, "-o", in_folder("x.exr"), "--recipe", "/no/such/recipe.json"), 3, "recipe.json");
    EXPECT(RUN("bake", lamp, "-o", in_folder("x.exr"), "--set", "gibberish"), 3, "gibberish");
    EXPECT(RUN("info", "/no/such/box.exr"), 3, "box.exr");
    EXPECT(RUN("info", lamp), 3, "paraboloid-spot.gltf");
    EXPECT(RUN("probe", "/no/such/box.exr", "--points", "/dev/null"), 3, "no rows");
    EXPECT(RUN("probe", box, "--points", "/no/such/table.csv"), 3, "table.csv");
    EXPECT(RUN("compare", "/no/such/a.gltf", box), 3, "a.gltf");
    assert_int_not_equal(access(in_folder("x.exr"), F_OK), 0);
}

/* ---------------------------------------------------------------------------------------------------------------- bake */

static void test_dark_and_closed_lamps(void **state)
{
    (void)state;
    char room[1100];
    snprintf(room, sizeof(room), "%s/models/room/room.gltf", LUMIBOX_BINARY_DIR);
    EXPECT(RUN("bake", room, "-o", in_folder("dark.exr"), "--photons", "1000"), 3, "emit");
    /* a source shut in black: everything is absorbed */
    EXPECT(RUN("bake", lamp, "-o", in_folder("dark.exr"), "--photons", "1000", "--set", "leave-out:Reflector", "--set",
               "leave-out:Housing", "--set", "no-emission:Source"),
           3, "emit");
    assert_int_not_equal(access(in_folder("dark.exr"), F_OK), 0);
}

static void test_same_bytes_for_any_threads(void **state)
{
    (void)state;
    static const char *const THREADS[] = {"1", "2", "3"};
    char *first = NULL;
    size_t first_size = 0;
    for (int i = 0; i < 3; ++i) {
        outcome o = RUN("bake", lamp, "-o", in_folder("threads.box.exr"), "--photons", "300000", "--cells", "3e5", "--seed", "5",
                        "--threads", THREADS[i], "--json");
        assert_int_equal(o.code, 0);
        release(&o);
        size_t size;
        char *bytes = slurp(in_folder("threads.box.exr"), &size);
        if (i == 0) {
            first = bytes;
            first_size = size;
            continue;
        }
        assert_int_equal(size, first_size);
        assert_memory_equal(bytes, first, size);
        free(bytes);
    }
    outcome o = RUN("bake", lamp, "-o", in_folder("threads.box.exr"), "--photons", "300000", "--cells", "3e5", "--seed", "6");
    assert_int_equal(o.code, 0);
    release(&o);
    size_t size;
    char *other = slurp(in_folder("threads.box.exr"), &size);
    assert_true(size != first_size || memcmp(other, first, size) != 0);
    free(other);
    free(first);
}

static json_t *parse_json(const char *text)
{
    json_error_t error;
    json_t *o = json_loads(text, 0, &error);
    if (!o)
        fail_msg("not JSON: %s at line %d of: %s", error.text, error.line, text);
    return o;
}

static double number_at(json_t *o, const char *a, const char *b)
{
    json_t *v = json_object_get(o, a);
    if (b)
        v = json_object_get(v, b);
    assert_true(json_is_number(v));
    return json_number_value(v);
}

static void test_bake_summary_and_flux(void **state)
{
    (void)state;
    outcome o = RUN("bake", lamp, "-o", in_folder("flux.box.exr"), "--photons", "100000", "--cells", "1e5", "--output-flux",
                    "1234lm", "--json");
    assert_int_equal(o.code, 0);
    json_t *j = parse_json(o.out);
    assert_true(fabs(number_at(j, "stored", "lm") + number_at(j, "residual", "lm") - 1234) < 1e-3);
    assert_int_equal(number_at(j, "photons", NULL), 100000);
    assert_true(number_at(j, "lost", "lm") <= 1e-6 * number_at(j, "emitted", "lm"));
    const double sum =
        number_at(j, "stored", "lm") + number_at(j, "residual", "lm") + number_at(j, "absorbed", "lm") + number_at(j, "lost", "lm");
    assert_true(fabs(sum - number_at(j, "emitted", "lm")) < 1e-6 * sum);
    json_decref(j);
    release(&o);

    o = RUN("info", in_folder("flux.box.exr"), "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    assert_int_equal(json_integer_value(json_object_get(json_object_get(j, "ledger"), "photons")), 100000);
    json_t *texts = json_object_get(j, "texts");
    assert_string_equal(json_string_value(json_object_get(texts, "model")), "paraboloid-spot.gltf");
    assert_string_equal(json_string_value(json_object_get(texts, "seed")), "1");
    assert_non_null(strstr(json_string_value(json_object_get(texts, "settings")), "1234"));
    assert_non_null(strstr(json_string_value(json_object_get(texts, "effects")), "area-emission"));
    /* R = G = B is D65, 6504 K and 0.0032 above the black bodies */
    assert_true(fabs(number_at(j, "colour_of_light", "cct_K") - 6504) < 3 && fabs(number_at(j, "colour_of_light", "duv") - 0.0032) < 1e-4);
    json_decref(j);
    release(&o);

    o = RUN("info", in_folder("flux.box.exr"));
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "emitted"));
    assert_non_null(strstr(o.out, "+-"));
    release(&o);
    o = RUN("bake", lamp, "-o", in_folder("flux.box.exr"), "--photons", "20000", "--cells", "1e5", "--quiet");
    assert_int_equal(o.code, 0);
    assert_string_equal(o.out, "");
    assert_string_equal(o.err, "");
    release(&o);
}

/* Radiance trees, when they are asked for: the summary and the box say how many.  A short bake has none by itself; in a file that is too small
 * for eight there are fewer, or none. */
static void test_trees(void **state)
{
    (void)state;
    char with[1200], without[1200];
    snprintf(with, sizeof(with), "%s", in_folder("trees.box.exr"));
    snprintf(without, sizeof(without), "%s", in_folder("no-trees.box.exr"));
    outcome o = RUN("bake", lamp, "-o", with, "--photons", "20000", "--cells", "5e3", "--effects", "all", "--trees", "8", "--json");
    assert_int_equal(o.code, 0);
    json_t *j = parse_json(o.out);
    assert_int_equal(number_at(j, "trees", "trees"), 8);
    const double leaves = number_at(j, "trees", "leaves"), rays = number_at(j, "trees", "rays");
    /* a photon leaves as one ray at most; no leaf is taken for less than a few */
    assert_true(leaves > 8 && leaves < rays && rays > 2000 && rays <= 20000);
    json_decref(j);
    release(&o);
    o = RUN("info", with, "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    assert_true(number_at(j, "trees", "trees") == 8 && number_at(j, "trees", "leaves") == leaves && number_at(j, "trees", "rays") == rays &&
                number_at(j, "trees", "memory") > leaves);
    json_decref(j);
    release(&o);
    o = RUN("info", with);
    assert_non_null(strstr(o.out, "8 radiance trees"));
    release(&o);

    o = RUN("bake", lamp, "-o", without, "--photons", "20000", "--cells", "5e3", "--effects", "all", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    assert_true(json_is_null(json_object_get(j, "trees")));
    json_decref(j);
    release(&o);
    o = RUN("info", without, "--json");
    j = parse_json(o.out);
    assert_true(json_is_null(json_object_get(j, "trees")));
    json_decref(j);
    release(&o);
    o = RUN("info", without);
    assert_null(strstr(o.out, "radiance trees"));
    release(&o);

#define SIZED(size, ...) RUN("bake", lamp, "-o", with, "--photons", "300000", "--size", size, "--effects", "all", __VA_ARGS__)
    o = SIZED("2MB", "--trees", "8", "--photons-only", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    assert_true(number_at(j, "trees", "trees") == 8 && number_at(j, "trees", "looks") == 0);
    const double whole = number_at(j, "bytes", NULL), of_trees = number_at(j, "trees", "bytes");
    json_decref(j);
    release(&o);
    assert_true(of_trees > 0.3 * whole && of_trees < whole);
    /* room for three and a half of them, and the cells get two thirds of it */
    char size[32];
    snprintf(size, sizeof(size), "%.0fkB", 1e-3 * fmax(1.5 * (whole - of_trees), whole - of_trees * 4.5 / 8));
    o = SIZED(size, "--trees", "8", "--photons-only", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    print_message("%.0f bytes, %.0f of trees; at most %s: %.0f, %.0f\n", whole, of_trees, size, number_at(j, "bytes", NULL),
                  number_at(j, "trees", "bytes"));
    assert_true(number_at(j, "trees", "trees") >= 2 && number_at(j, "trees", "trees") < 8 &&
                number_at(j, "bytes", NULL) < 1.03e3 * strtod(size, NULL));
    json_decref(j);
    release(&o);
    o = SIZED("100kB", "--looks", "1e6"); /* looks are looks of trees, which ask for these; as many as are asked for, whatever the size */
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "trees     none: two of them take"));
    release(&o);
}

/* Looks into the lamp: two for each photon unless asked for otherwise; outlines where no path goes backwards, none where there is no
 * surface either, both of which is told. */
static void test_looks(void **state)
{
    (void)state;
    const char *path = in_folder("looks.box.exr");
    static const struct {
        const char *looks, *effects;
        double count;
        const char *why;
    } CASES[] = {{NULL, "auto", 40000, NULL}, {"0", "auto", 0, NULL}, {"1", "auto", 1, NULL}, {"5000", "auto", 5000, NULL},
                 {NULL, "all", 0, "outlines only, beyond which there is hardly any radiance"}, {"5000", "all", 5000, "outlines only: paths can't be traced"},
                 {"0", "all", 0, NULL}};
    for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); ++i) {
        const char *args[20] = {"bake",     lamp,  "-o",        path,             "--photons", "20000", "--cells", "5e3",
                                "--trees",  "4",   "--effects", CASES[i].effects, "--json"};
        if (CASES[i].looks) {
            args[13] = "--looks";
            args[14] = CASES[i].looks;
        }
        outcome o = finish(start(args));
        assert_int_equal(o.code, 0);
        json_t *j = parse_json(o.out);
        assert_true(number_at(j, "trees", "looks") == CASES[i].count && number_at(j, "trees", "trees") == 4);
        const char *why = json_string_value(json_object_get(j, "looks_why"));
        assert_true(CASES[i].why ? why && strstr(why, CASES[i].why) : !why);
        json_decref(j);
        release(&o);
    }
    char spot_light[1200];
    snprintf(spot_light, sizeof(spot_light), "%s/models/prism-lamp/prism-lamp.gltf", LUMIBOX_BINARY_DIR);
    EXPECT(RUN("bake", spot_light, "-o", path, "--photons", "20000", "--trees", "4", "--looks", "100"), 3, "leave --looks out");
    outcome o = RUN("bake", spot_light, "-o", path, "--photons", "20000", "--trees", "4");
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "looks: none"));
    release(&o);
}

/* Ctrl-C in a long bake: a valid box with what was traced, exit code 130. */
static void test_interrupt(void **state)
{
    (void)state;
    static const int SIGNALS[] = {SIGINT, SIGTERM};
    for (int i = 0; i < 2; ++i) {
        char path[1200];
        snprintf(path, sizeof(path), "%s/interrupted.box.exr", folder);
        unlink(path);
        const pid_t pid =
            start((const char *const[]){"bake", lamp, "-o", path, "--time", "200s", "--cells", "1e5", "--progress", NULL});
        /* once the first round is through there is something to interrupt */
        for (int k = 0; k < 600; ++k) {
            pause_seconds(0.1);
            char *err = slurp(in_folder("stderr"), NULL);
            const bool begun = err && strstr(err, "photons");
            free(err);
            if (begun)
                break;
            if (k == 20)
                break; /* the first progress line comes after ten seconds: by now the bake is tracing */
        }
        kill(pid, SIGNALS[i]);
        outcome o = finish(pid);
        assert_int_equal(o.code, 130);
        assert_non_null(strstr(o.err, "interrupted"));
        release(&o);
        o = RUN("info", path, "--json");
        assert_int_equal(o.code, 0);
        json_t *j = parse_json(o.out);
        assert_true(json_integer_value(json_object_get(json_object_get(j, "ledger"), "photons")) > 0);
        json_decref(j);
        release(&o);
    }
}

/* ---------------------------------------------------------------------------------------------------------------- probe */

static void test_probe(void **state)
{
    (void)state;
    static const char TABLE[] =
        "x, y, z, nx, ny, nz\n# a comment\n\n0,-2,0, 0,1,0\r\n 0.1;-3;0.2;0;2;0 # normals needn't be unit\n0\t-1e1\t0\t0\t1\t0\n";
    write_file(in_folder("points.csv"), TABLE, sizeof(TABLE) - 1);
    outcome o = RUN("probe", box, "--points", in_folder("points.csv"));
    assert_int_equal(o.code, 0);
    assert_int_equal(lines_of(o.out), 4);
    double v[3][8];
    const char *line = strchr(o.out, '\n') + 1;
    for (int i = 0; i < 3; ++i, line = strchr(line, '\n') + 1)
        assert_int_equal(sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &v[i][0], &v[i][1], &v[i][2], &v[i][3], &v[i][4], &v[i][5],
                                &v[i][6], &v[i][7]),
                         8);
    /* about 36 kcd straight down, the narrow beam's blur aside */
    assert_true(v[0][6] > 5000 && v[0][6] < 11000);
    assert_true(v[2][6] > 250 && v[2][6] < 420);
    assert_true(v[0][7] > 0);
    release(&o);

    o = RUN("probe", box, "--points", in_folder("points.csv"), "--json");
    assert_int_equal(o.code, 0);
    json_t *j = parse_json(o.out);
    assert_int_equal(json_array_size(json_object_get(j, "rows")), 3);
    json_t *row = json_array_get(json_object_get(j, "rows"), 0);
    assert_int_equal(json_array_size(json_object_get(row, "rgb")), 3);
    assert_true(fabs(number_at(row, "cct_K", NULL) - 6504) < 3);
    json_decref(j);
    release(&o);

    write_file(in_folder("stdin"), "0,-1,0\n", 7);
    o = RUN("probe", box, "--intensity", "-");
    assert_int_equal(o.code, 0);
    double intensity;
    assert_int_equal(sscanf(strchr(o.out, '\n') + 1, "0,-1,0,%lf,", &intensity), 1);
    assert_true(intensity > 28000 && intensity < 42000);
    release(&o);
    write_file(in_folder("stdin"), "0.02,-1,0.01,0,-1,0\n", 20);
    o = RUN("probe", box, "--rays", "-", "--linear");
    assert_int_equal(o.code, 0);
    assert_int_equal(lines_of(o.out), 2);
    release(&o);
    write_file(in_folder("stdin"), "", 0);
}

static void test_bad_tables(void **state)
{
    (void)state;
    const struct {
        const char *text, *message;
    } cases[] = {
        {"", "no rows"},
        {"x,y,z,nx,ny,nz\n", "no rows"},
        {"0,-2,0,0,1\n", ":1: 5 columns, expected 6"},
        {"0,-2,0,0,1,\n", ":1: 5 columns, expected 6"},
        {"# c\n0,-2,0,0,1,0,7\n", ":2: more than 6"},
        {"0,-2,0,0,1,0\n0,-2,zero,0,1,0\n", ":2: column 3: 'zero' is not a number"},
        {"0,-2,0,0,1,inf\n", ":1: column 6 is not finite"},
        {"0,-2,0,0,1,nan\n", ":1: column 6 is not finite"},
        {"0,-2,0,0,0,0\n", ":1: the normal has no length"},
        {"a,b\n0,-2,0,0,1,0\nx,y,z,nx,ny,nz\n", ":3: column 1: 'x' is not a number"},
        {"0,-2,0 0,0,1,0\n", ":1: column 3"},
        {"0,0.01,0,0,1,0\n", ":1: the point is inside the luminaire"},
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        write_file(in_folder("bad.csv"), cases[i].text, strlen(cases[i].text));
        EXPECT(RUN("probe", box, "--points", in_folder("bad.csv")), 3, cases[i].message);
    }
    write_file(in_folder("bad.csv"), "0,-2,0\0,0,1,0\n", 14);
    EXPECT(RUN("probe", box, "--points", in_folder("bad.csv")), 3, "zero byte");
}

/* -------------------------------------------------------------------------------------------------------------- compare */

static void test_compare(void **state)
{
    (void)state;
    outcome o = RUN("compare", box, lamp, "--photons", "1e6", "--json");
    assert_int_equal(o.code, 0);
    json_t *j = parse_json(o.out);
    json_t *sides = json_object_get(j, "sides");
    const double a = number_at(json_array_get(sides, 0), "flux_lm", NULL), b = number_at(json_array_get(sides, 1), "flux_lm", NULL);
    const double ea = number_at(json_array_get(sides, 0), "flux_standard_error", NULL),
                 eb = number_at(json_array_get(sides, 1), "flux_standard_error", NULL);
    assert_true(ea > 0 && eb > 0);
    assert_true(fabs(a - b) < 4 * hypot(ea, eb));
    json_t *planes = json_object_get(j, "planes");
    assert_int_equal(json_array_size(planes), 6);
    for (size_t i = 1; i < 6; ++i) { /* at 0.1 sizes the cells of a short bake show */
        json_t *d = json_object_get(json_array_get(planes, i), "difference");
        assert_true(number_at(d, "raw", NULL) > fabs(number_at(d, "rms", NULL)));
        assert_true(number_at(d, "rms", NULL) < 0.1);
    }
    json_decref(j);
    release(&o);
    /* a lamp against itself, other photons: no difference beyond noise */
    o = RUN("compare", lamp, lamp, "--photons", "1e6", "--distances", "1,3", "--size", "0.1", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    planes = json_object_get(j, "planes");
    for (size_t i = 0; i < 2; ++i) {
        json_t *d = json_object_get(json_array_get(planes, i), "difference");
        assert_true(fabs(number_at(d, "rms", NULL)) < 4 * number_at(d, "standard_error", NULL) + 1e-3);
    }
    json_decref(j);
    release(&o);
    o = RUN("compare", lamp, box, "--photons", "1e5");
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "far-field"));
    release(&o);
    /* a tolerance decides the exit code: two lamps of different flux */
    o = RUN("compare", lamp, lamp, "--photons", "1e5", "--tolerance", "30%");
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "within 30 %"));
    release(&o);
    o = RUN("compare", lamp, lamp, "--photons", "1e5", "--tolerance", "0.0001%");
    assert_int_equal(o.code, 4);
    release(&o);
    EXPECT(RUN("compare", lamp, lamp, "--tolerance", "much"), 2, "much");
    /* the report: one file that needs nothing beside it, with plots */
    char report[1200];
    snprintf(report, sizeof(report), "%s", in_folder("report.html"));
    o = RUN("compare", lamp, lamp, "--photons", "1e5", "--distances", "1", "-o", report);
    assert_int_equal(o.code, 0);
    release(&o);
    FILE *file = fopen(report, "rb");
    assert_non_null(file);
    static char text[8 << 20];
    text[fread(text, 1, sizeof(text) - 1, file)] = 0;
    fclose(file);
    assert_non_null(strstr(text, "<svg"));
    assert_non_null(strstr(text, "virtual focus"));
    assert_non_null(strstr(text, "</html>"));
    assert_null(strstr(text, "href=\"http"));
    assert_null(strstr(text, "src=\"http"));
    EXPECT(RUN("compare", lamp, lamp, "--photons", "1e5", "--distances", "1", "-o", "/no/such/folder/report.html"), 1, "report.html");
}

/* ---------------------------------------------------------------------------------------------------------------- study */

/* A study of a few seconds: more photons and more cells make smaller errors, and what it advises does. */
static void test_study(void **state)
{
    (void)state;
    outcome o = RUN("study", lamp, "--time", "4s", "--json", "-o", in_folder("study.html"));
    assert_int_equal(o.code, 0);
    json_t *j = parse_json(o.out), *rungs = json_object_get(j, "rungs");
    assert_int_equal(json_array_size(rungs), 16);
    double error[2] = {0, 0}, photons[2] = {0, 0};
    for (size_t i = 0; i < 8; ++i) {
        json_t *r = json_array_get(rungs, i);
        assert_string_equal(json_string_value(json_object_get(r, "ladder")), "photons");
        const double n = number_at(r, "photons", NULL);
        assert_true(n > photons[1]); /* each rung has more than the one before */
        photons[1] = n;
        error[i >= 4] += pow(number_at(json_object_get(r, "near_field"), "rms", NULL), 2) / 4;
    }
    assert_true(error[1] < error[0]);
    json_t *fit = json_object_get(json_object_get(j, "fits"), "near_field");
    assert_true(number_at(json_object_get(fit, "over_photons"), "slope", NULL) < 0);
    assert_true(number_at(json_object_get(fit, "over_time"), "confidence_95", NULL) > 0);
    /* Plain bins: another verdict of the same box, of photons alone; rays traced backwards: only in the last four. */
    for (size_t i = 0; i < 16; ++i) {
        json_t *r = json_array_get(rungs, i),
               *plain = json_object_get(json_object_get(json_object_get(r, "plain_bins"), "near_field"), "rms");
        assert_string_equal(json_string_value(json_object_get(r, "ladder")), i < 8 ? "photons" : i < 12 ? "cells" : "combined");
        assert_true(i < 12 ? json_is_number(plain) : json_is_null(plain));
        assert_true(i >= 12 || json_number_value(plain) != number_at(json_object_get(r, "near_field"), "rms", NULL));
        assert_int_equal(number_at(r, "gathered_rays", NULL) > 0, i >= 12);
        assert_int_equal(number_at(r, "gather_s", NULL) > 0, i >= 12);
    }
    assert_true(json_is_null(json_object_get(j, "combined_why")));
    const double share = number_at(j, "deposit_share", NULL);
    assert_true(share >= 0 && share < 1);
    json_t *advice = json_object_get(j, "advice");
    assert_int_equal(json_array_size(advice), 4);
    double before = 0;
    for (size_t i = 0; i < 4; ++i) {
        json_t *a = json_array_get(advice, i), *command = json_object_get(a, "command");
        if (!json_is_true(json_object_get(a, "reachable"))) {
            assert_true(json_is_null(command));
            continue;
        }
        if (before == 0) { /* the first command, word by word; its last one is where the box goes */
            char words[2048];
            const char *args[16] = {NULL};
            size_t n = 0;
            snprintf(words, sizeof words, "%s", json_string_value(command));
            assert_string_equal(strtok(words, " "), "lumibake");
            for (char *word; (word = strtok(NULL, " ")) && n < 15;)
                args[n++] = word;
            assert_int_equal(n, 6);
            assert_string_equal(args[4], "-o");
            args[5] = in_folder("advised.box.exr");
            outcome bake = run_args(args);
            assert_int_equal(bake.code, 0);
            release(&bake);
            assert_int_equal(access(in_folder("advised.box.exr"), F_OK), 0);
        }
        assert_true(number_at(a, "seconds", NULL) >= before); /* less error never costs less */
        before = number_at(a, "seconds", NULL);
    }
    json_decref(j);
    release(&o);
    assert_int_equal(access(in_folder("study.html"), F_OK), 0);
    EXPECT(RUN("study"), 2, "which lamp");
    EXPECT(RUN("study", lamp, lamp), 2, "one lamp");
    EXPECT(RUN("study", "/no/such/a.gltf"), 3, "a.gltf");
}

/* A bake to a stated error: what it says it reached is what compare finds, with photons and a seed of its own. */
static void test_error(void **state)
{
    (void)state;
    outcome o = RUN("bake", lamp, "-o", in_folder("error.box.exr"), "--error", "2%", "--seed", "5", "--json");
    assert_int_equal(o.code, 0);
    json_t *j = parse_json(o.out), *e = json_object_get(j, "error");
    const double said = number_at(e, "rms", NULL), se = number_at(e, "standard_error", NULL);
    assert_true(json_is_true(json_object_get(e, "within")));
    assert_true(said <= 1.15 * 0.02 && said >= 0.85 * 0.02);
    json_decref(j);
    release(&o);
    o = RUN("compare", in_folder("error.box.exr"), lamp, "--photons", "2e6", "--distances", "0.5,1,2,5,10", "--no-align", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out);
    json_t *planes = json_object_get(j, "planes");
    double square = 0, variance = 0;
    for (size_t i = 0; i < 5; ++i) {
        json_t *d = json_object_get(json_array_get(planes, i), "difference");
        const double rms = number_at(d, "rms", NULL), s = number_at(d, "standard_error", NULL);
        square += rms * fabs(rms) / 5;
        variance += pow(2 * rms * s / 5, 2);
    }
    const double found = sqrt(fmax(square, 0));
    print_message("error %.4f +- %.4f as baked, %.4f +- %.4f as compared\n", said, se, found, sqrt(variance) / (2 * found));
    assert_true(fabs(found - said) < 4 * hypot(se, sqrt(variance) / (2 * found)));
    json_decref(j);
    release(&o);

    /* The search steps down from its first bake of 10^5 photons, which is better than that, again to what was asked for. */
    o = RUN("bake", lamp, "-o", in_folder("error.box.exr"), "--error", "12%", "--seed", "5", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out), e = json_object_get(j, "error");
    print_message("12 %% asked for: %.4f with %.0f photons\n", number_at(e, "rms", NULL), number_at(j, "photons", NULL));
    assert_true(fabs(number_at(e, "rms", NULL) / 0.12 - 1) <= 0.15 && number_at(j, "photons", NULL) < 1e5);
    json_decref(j);
    release(&o);

    /* Of the flux it is the standard error, which the photons alone decide. */
    o = RUN("bake", lamp, "-o", in_folder("error.box.exr"), "--error", "0.2%", "--error-of", "flux", "--json");
    assert_int_equal(o.code, 0);
    j = parse_json(o.out), e = json_object_get(j, "error");
    const double share = number_at(j, "stored", "lm") / number_at(j, "emitted", "lm");
    print_message("flux 0.2 %%: %.5f, %.0f photons\n", number_at(e, "rms", NULL), number_at(j, "photons", NULL));
    assert_true(fabs(number_at(e, "rms", NULL) / 0.002 - 1) <= 0.15);
    assert_true(fabs(number_at(e, "rms", NULL) / sqrt((1 - share) / share / number_at(j, "photons", NULL)) - 1) < 0.02);
    json_decref(j);
    release(&o);
    EXPECT(RUN("bake", lamp, "-o", in_folder("x.box.exr"), "--error", "1%", "--photons", "1e5"), 2, "--error");
    EXPECT(RUN("bake", lamp, "-o", in_folder("x.box.exr"), "--error", "0.001%"), 2, "0.01");
    EXPECT(RUN("bake", lamp, "-o", in_folder("x.box.exr"), "--error-of", "colour"), 2, "colour");
}

/* ------------------------------------------------------------------------------------------------------------ bad input */

static int files_tried, files_baked;

/* Bakes a file, as it is or with everything in it made to shine: a box, or one line of error and no box. */
static void try_file_as(const char *path, bool shining)
{
    char output[1200];
    snprintf(output, sizeof(output), "%s/hard.box.exr", folder);
    unlink(output);
    outcome o = shining ? RUN("bake", path, "-o", output, "--photons", "1000", "--cells", "1e4", "--no-recipe", "--set",
                              "emitter:*=100cd/m2")
                        : RUN("bake", path, "-o", output, "--photons", "1000", "--cells", "1e4", "--no-recipe");
    ++files_tried;
    const int errors = lines_with(o.err, "error:");
    if (o.code == 0) {
        ++files_baked;
        if (errors != 0 || access(output, R_OK) != 0)
            fail_msg("%s: exit code 0, but %d errors or no file: %s", path, errors, o.err);
    } else if (o.code != 3 || errors != 1 || access(output, F_OK) == 0) {
        fail_msg("%s: exit code %d, %d error lines, output %s: %s", path, o.code, errors,
                 access(output, F_OK) == 0 ? "left" : "none", o.err);
    }
    release(&o);
}

static void try_file(const char *path)
{
    try_file_as(path, false);
    try_file_as(path, true);
}

static void try_folder(const char *path)
{
    DIR *d = opendir(path);
    if (!d)
        return;
    for (struct dirent *e; (e = readdir(d));) {
        if (e->d_name[0] == '.')
            continue;
        char inner[2048];
        snprintf(inner, sizeof(inner), "%s/%s", path, e->d_name);
        struct stat s;
        if (stat(inner, &s) != 0)
            continue;
        const size_t n = strlen(inner);
        if (S_ISDIR(s.st_mode))
            try_folder(inner);
        else if ((n > 5 && !strcmp(inner + n - 5, ".gltf")) || (n > 4 && !strcmp(inner + n - 4, ".glb")))
            try_file(inner);
    }
    closedir(d);
}

static void sweep(const char *name)
{
    char path[1024];
    snprintf(path, sizeof(path), "%s/%s", LUMIBOX_SHARED_DATA, name);
    if (access(path, R_OK) != 0) {
        print_message("skipped: %s isn't there\n", name);
        return;
    }
    files_tried = files_baked = 0;
    try_folder(path);
    print_message("%s: %d runs, %d baked, %d refused\n", name, files_tried, files_baked, files_tried - files_baked);
    assert_true(files_tried > 0);
}

static void test_invalid_gltf(void **state)
{
    (void)state;
    sweep("gltf-invalid");
}

static void test_odd_gltf(void **state)
{
    (void)state;
    sweep("gltf-odd");
}

/* Files of all formats where a lamp or a box is expected. */
static void test_wrong_kinds(void **state)
{
    (void)state;
    write_file(in_folder("empty.gltf"), "", 0);
    write_file(in_folder("empty.glb"), "", 0);
    write_file(in_folder("text.gltf"), "hello\n", 6);
    write_file(in_folder("text.glb"), "glTF\2\0\0\0\xff\xff\xff\xff", 12);
    EXPECT(RUN("bake", in_folder("empty.gltf"), "-o", in_folder("x.exr")), 3, "empty.gltf");
    EXPECT(RUN("bake", in_folder("empty.glb"), "-o", in_folder("x.exr")), 3, "empty.glb");
    EXPECT(RUN("bake", in_folder("text.gltf"), "-o", in_folder("x.exr")), 3, "text.gltf");
    EXPECT(RUN("bake", in_folder("text.glb"), "-o", in_folder("x.exr")), 3, "text.glb");
    EXPECT(RUN("bake", folder, "-o", in_folder("x.exr")), 3, "folder");
    EXPECT(RUN("bake", box, "-o", in_folder("x.exr")), 3, "spot.box.exr");
    EXPECT(RUN("info", folder), 3, folder);
    EXPECT(RUN("info", "/dev/null"), 3, "/dev/null");
    EXPECT(RUN("compare", lamp, in_folder("text.gltf")), 3, "text.gltf");
    assert_int_not_equal(access(in_folder("x.exr"), F_OK), 0);
}

/* A box cut off anywhere, or with any bit turned, is refused - unless the bit carries nothing (after the end of a deflate stream):
 * then all reads as before. */
static void test_damaged_boxes(void **state)
{
    (void)state;
    size_t size;
    outcome o = RUN("bake", lamp, "-o", in_folder("small.box.exr"), "--photons", "20000", "--cells", "5e3", "--quiet");
    assert_int_equal(o.code, 0);
    release(&o);
    char *bytes = slurp(in_folder("small.box.exr"), &size);
    for (int i = 0; i < 24; ++i) {
        write_file(in_folder("damaged.box.exr"), bytes, size * (size_t)i / 24);
        EXPECT(RUN(i % 2 ? "info" : "compare", in_folder("damaged.box.exr"), i % 2 ? "--json" : lamp), 3, "damaged.box.exr");
    }
    write_file(in_folder("damaged.box.exr"), bytes, size);
    o = RUN("info", in_folder("damaged.box.exr"), "--json");
    assert_int_equal(o.code, 0);
    char *before = o.out;
    free(o.err);
    uint64_t x = 12345;
    int harmless = 0;
    for (int i = 0; i < 48; ++i) {
        x = x * 6364136223846793005u + 1442695040888963407u;
        /* half of them in the first kilobytes, where the headers are */
        const size_t at = (size_t)(x >> 20) % (i % 2 ? size : size < 4096 ? size : 4096);
        bytes[at] ^= (char)(1 << (x >> 60) % 8);
        write_file(in_folder("damaged.box.exr"), bytes, size);
        o = RUN("info", in_folder("damaged.box.exr"), "--json");
        if (o.code == 0) {
            ++harmless;
            assert_string_equal(o.out, before);
            release(&o);
        } else {
            expect(__LINE__, o, 3, "damaged.box.exr");
        }
        bytes[at] ^= (char)(1 << (x >> 60) % 8);
    }
    assert_true(harmless <= 2);
    free(before);
    free(bytes);
}

static int setup(void **state)
{
    (void)state;
    snprintf(folder, sizeof(folder), "%s/tests/cli_lumibake", LUMIBOX_BINARY_DIR);
    mkdir(folder, 0777);
    snprintf(lamp, sizeof(lamp), "%s/models/paraboloid-spot/paraboloid-spot.gltf", LUMIBOX_BINARY_DIR);
    snprintf(box, sizeof(box), "%s/spot.box.exr", folder);
    write_file(in_folder("stdin"), "", 0);
    outcome o = RUN("bake", lamp, "-o", box, "--photons", "2e6", "--cells", "1e6", "--seed", "9");
    const int code = o.code;
    if (code != 0)
        fprintf(stderr, "%s\n", o.err);
    release(&o);
    return code;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_help),
        cmocka_unit_test(test_usage_errors),
        cmocka_unit_test(test_missing_files),
        cmocka_unit_test(test_dark_and_closed_lamps),
        cmocka_unit_test(test_same_bytes_for_any_threads),
        cmocka_unit_test(test_bake_summary_and_flux),
        cmocka_unit_test(test_trees),
        cmocka_unit_test(test_looks),
        cmocka_unit_test(test_interrupt),
        cmocka_unit_test(test_probe),
        cmocka_unit_test(test_bad_tables),
        cmocka_unit_test(test_compare),
        cmocka_unit_test(test_study),
        cmocka_unit_test(test_error),
        cmocka_unit_test(test_invalid_gltf),
        cmocka_unit_test(test_odd_gltf),
        cmocka_unit_test(test_wrong_kinds),
        cmocka_unit_test(test_damaged_boxes),
    };
    return cmocka_run_group_tests_name("lumibake", tests, setup, NULL);
}
