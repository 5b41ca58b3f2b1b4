/* SPDX-License-Identifier: Apache-2.0 */
/*
 * lumibake convert as a user meets it: every arrow between ray files, boxes, lamps, goniometer pictures and photometric files, each
 * with its flux in, flux out and loss; usage errors, and damaged ray files, which end in one line and leave nothing behind.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "rayfile_maker.h"
#include "run_lumibake.h"

#include <jansson.h>

#include <dirent.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char LAMP[] = LUMIBOX_BINARY_DIR "/models/opal-globe/opal-globe.gltf";

static bool exists(const char *name)
{
    return access(in_folder(name), F_OK) == 0;
}

static uint8_t *make_rays(size_t *size)
{
    const tm25_recipe r = {.rays = 2000, .flags = {1, 1, 0, 0, 1, 0, 0, 0}, .luminous = 4000, .radiant = NAN};
    return tm25_make(&r, size);
}

/* A path of the test's folder that stays valid. */
typedef struct name {
    char text[1200];
} name;
static name path_of(const char *file)
{
    name n;
    snprintf(n.text, sizeof(n.text), "%s", in_folder(file));
    return n;
}

/* Runs a conversion with --json; returns its flux_out after checking that the loss is at most `most`. */
static double converts(const char *from, const char *to, const char *option, const char *value, double most)
{
    const name a = path_of(from), b = path_of(to);
    outcome o = RUN("convert", from[0] == '/' ? from : a.text, b.text, "--json", option ? option : "--seed", option ? value : "3");
    if (o.code != 0)
        fail_msg("%s -> %s: %s", from, to, o.err);
    json_t *j = json_loads(o.out, 0, NULL);
    assert_non_null(j);
    assert_string_equal(json_string_value(json_object_get(j, "format")), "lumibake convert 1");
    const double in = json_number_value(json_object_get(j, "flux_in")), out = json_number_value(json_object_get(j, "flux_out"));
    const double loss = json_number_value(json_object_get(j, "loss"));
    assert_true(in > 0 && out > 0 && fabs(loss - (in - out) / in) < 1e-8);
    if (!(fabs(loss) <= most))
        fail_msg("%s -> %s: a loss of %g", from, to, loss);
    json_decref(j);
    release(&o);
    return out;
}

static json_int_t bytes_of(const char *path)
{
    struct stat s;
    assert_int_equal(stat(path, &s), 0);
    return (json_int_t)s.st_size;
}

/* Of the files in a folder. */
static json_int_t bytes_in(const char *path)
{
    json_int_t sum = 0;
    DIR *d = opendir(path);
    assert_non_null(d);
    for (const struct dirent *e; (e = readdir(d));) {
        char file[1600];
        snprintf(file, sizeof(file), "%s/%s", path, e->d_name);
        if (e->d_name[0] != '.')
            sum += bytes_of(file);
    }
    closedir(d);
    return sum;
}

static void succeeds(outcome o)
{
    assert_int_equal(o.code, 0);
    release(&o);
}

static void arrows(void **state)
{
    (void)state;
    size_t size;
    uint8_t *bytes = make_rays(&size);
    write_file(in_folder("in.tm25ray"), bytes, size);
    free(bytes);
    /* float rounding of sums is all that may be lost between rays; a box counts in 2^-20 of a ray */
    const double flux = converts("in.tm25ray", "a.ray", NULL, NULL, 1e-6);
    assert_true(fabs(flux - 3999) < 1e-3 * 3999); /* sum of 1 + i/1000 */
    converts("a.ray", "b.dat", NULL, NULL, 1e-6);
    converts("b.dat", "c.txt", "--to", "lighttools-text", 1e-6);
    converts("c.txt", "d.tm25ray", NULL, NULL, 1e-6);
    converts("d.tm25ray", "d.box.exr", NULL, NULL, 1e-5);
    converts("d.box.exr", "e.tm25ray", "--rays", "50000", 1e-5);
    converts("d.box.exr", "d.ies", "--rays", "200000", 1e-3);
    converts("in.tm25ray", "f.ldt", NULL, NULL, 1e-3);
    converts(LAMP, "lamp.tm25ray", "--rays", "20000", 1e-6);
    converts("lamp.tm25ray", "lamp.box.exr", NULL, NULL, 1e-5);
    /* pictures in steps of 15 degrees: midpoint rule and noisy cells */
    converts("lamp.box.exr", "set/", "--step", "15", 0.1);
    assert_true(exists("set/index.json"));
    converts("set", "again.box.exr", NULL, NULL, 1e-3);
    converts("set", "set.tm25ray", NULL, NULL, 1e-5);

    const name box = path_of("lamp.box.exr"), ies = path_of("near.ies"), set = path_of("set");
    outcome o = RUN("convert", box.text, ies.text, "--near", "1.5,4", "--rays", "100000");
    assert_int_equal(o.code, 0);
    release(&o);
    assert_true(exists("near_1.5m.ies") && exists("near_4m.ies") && !exists("near.ies"));
    /* an opened source is one for compare too */
    o = RUN("compare", set.text, box.text, "--photons", "20000", "--no-align");
    assert_int_equal(o.code, 0);
    release(&o);
    EXPECT(RUN("convert", box.text, set.text, "--to", "pictures"), 1, "something in it");
    /* 12 x 24 pictures of 16 x 16 pixels of one colour or three, as floats; what is on disk is told as it is */
    const name small = path_of("small");
    o = RUN("convert", box.text, small.text, "--to", "pictures", "--step", "15", "--pixels", "16", "--json");
    assert_int_equal(o.code, 0);
    json_t *j = json_loads(o.out, 0, NULL), *pictures = json_object_get(j, "pictures");
    const json_int_t raw = json_integer_value(json_object_get(pictures, "raw_bytes"));
    assert_true(raw == 288 * 256 * 4 || raw == 288 * 256 * 12);
    assert_int_equal(json_integer_value(json_object_get(pictures, "stored_bytes")), bytes_in(small.text));
    assert_int_equal(json_integer_value(json_object_get(j, "box_bytes")), bytes_of(box.text));
    json_decref(j);
    release(&o);
    o = RUN("convert", box.text, path_of("small2").text, "--to", "pictures", "--step", "15", "--pixels", "16");
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "MB on disk; the box has"));
    release(&o);

    /* a camera sees trees where a box has them, and much the same light */
    const name bare = path_of("bare.box.exr"), leafy = path_of("leafy.box.exr"), bare_set = path_of("bare"), leafy_set = path_of("leafy");
    succeeds(RUN("bake", LAMP, "-o", bare.text, "--photons", "50000", "--cells", "1e5", "-q"));
    succeeds(RUN("bake", LAMP, "-o", leafy.text, "--photons", "50000", "--cells", "1e5", "--trees", "4", "--looks", "0", "-q"));
    succeeds(RUN("convert", bare.text, bare_set.text, "--to", "pictures", "--step", "15", "--pixels", "16"));
    succeeds(RUN("convert", leafy.text, leafy_set.text, "--to", "pictures", "--step", "15", "--pixels", "16"));
    assert_true(bytes_in(bare_set.text) != bytes_in(leafy_set.text));
    converts("leafy.box.exr", "leafy2/", "--step", "15", 0.1);
}

/* Rays in watts make a box in watts, and what reads it says so. */
static void watts(void **state)
{
    (void)state;
    const tm25_recipe r = {.rays = 2000, .flags = {1, 1, 1}, .luminous = NAN, .radiant = 4};
    size_t size;
    uint8_t *bytes = tm25_make(&r, &size);
    const name rays = path_of("watts.tm25ray"), box = path_of("watts.box.exr"), points = path_of("points.csv");
    write_file(rays.text, bytes, size);
    free(bytes);
    EXPECT(RUN("convert", rays.text, box.text, "--rays", "2.0005k"), 2, "whole number");
    EXPECT(RUN("convert", rays.text, box.text, "--rays", "2kk"), 2, "whole number");
    outcome o = RUN("convert", rays.text, box.text, "--radiometric", "--rays", "2k", "--json");
    assert_int_equal(o.code, 0);
    json_t *j = json_loads(o.out, 0, NULL);
    assert_string_equal(json_string_value(json_object_get(j, "unit")), "W");
    assert_int_equal(json_integer_value(json_object_get(j, "rays")), 2000);
    json_decref(j);
    release(&o);
    o = RUN("info", box.text);
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "4 W"));
    assert_null(strstr(o.out, " lm"));
    release(&o);
    write_file(points.text, "0,0,9,0,0,-1\n", 13);
    o = RUN("probe", box.text, "--points", points.text);
    assert_int_equal(o.code, 0);
    assert_non_null(strstr(o.out, "irradiance_W_m2"));
    release(&o);
}

static void usage(void **state)
{
    (void)state;
    EXPECT(RUN("convert"), 2, "what into what?");
    EXPECT(RUN("convert", "a.tm25ray"), 2, "what into what?");
    EXPECT(RUN("convert", "a", "b", "c"), 2, "not more");
    EXPECT(RUN("convert", "a", "b"), 2, "doesn't say");
    EXPECT(RUN("convert", "a", "b", "--to", "papyrus"), 2, "papyrus");
    EXPECT(RUN("convert", "a", "b.exr", "--rays", "0"), 2, "--rays");
    EXPECT(RUN("convert", "a", "b.exr", "--near", "1"), 2, "--near");
    EXPECT(RUN("convert", "a", "b.ies", "--near", "1,x"), 2, "--near");
    EXPECT(RUN("convert", "a", "b.exr", "--step", "10"), 2, "go with pictures");
    EXPECT(RUN("convert", "a", "b/", "--step", "7"), 2, "doesn't divide 180");
    EXPECT(RUN("convert", "a", "b.exr", "--cells", "7"), 2, "--cells");
}

static int entries(void)
{
    DIR *d = opendir(folder);
    int n = 0;
    while (readdir(d))
        ++n;
    closedir(d);
    return n;
}

/* Damaged rays: exit code 3, one line, and no new file, whatever they were to become. */
static void damaged(int line, const uint8_t *bytes, size_t size, const char *message)
{
    write_file(in_folder("bad.tm25ray"), bytes, size);
    /* what every run leaves */
    write_file(in_folder("stdout"), "", 0);
    write_file(in_folder("stderr"), "", 0);
    const int before = entries();
    static const char *const TARGETS[] = {"x.box.exr", "x.tm25ray", "x.ies", "x/"};
    for (size_t i = 0; i < sizeof(TARGETS) / sizeof(TARGETS[0]); ++i) {
        const name bad = path_of("bad.tm25ray"), to = path_of(TARGETS[i]);
        expect(line, RUN("convert", bad.text, to.text), 3, message);
        if (entries() != before)
            fail_msg("line %d: something was left behind for %s", line, TARGETS[i]);
    }
}

static void bad_input(void **state)
{
    (void)state;
    size_t size;
    uint8_t *good = make_rays(&size), *bytes = malloc(size);
    const size_t ray = size - 1000 * 28;
    static const uint8_t NOT_A_NUMBER[4] = {0, 0, 0xc0, 0x7f}, SWAPPED[4] = {0x7f, 0x80, 0, 1}, HUGE_COUNT[8] = {0, 0, 0, 0, 0, 0, 0, 0x80};
    memcpy(bytes, good, size);
    memcpy(bytes + ray + 4, NOT_A_NUMBER, 4);
    damaged(__LINE__, bytes, size, "ray 1001: its position isn't a number");
    memcpy(bytes, good, size);
    memcpy(bytes + ray + 24, SWAPPED, 4);
    damaged(__LINE__, bytes, size, "bytes swapped");
    memcpy(bytes, good, size);
    memcpy(bytes + 20, HUGE_COUNT, 8);
    damaged(__LINE__, bytes, size, "9223372036854775808 rays");
    damaged(__LINE__, good, size - 1, "cut off");
    damaged(__LINE__, good, 36288 + 28, "cut off");
    damaged(__LINE__, good, 100, "cut off");
    damaged(__LINE__, good, 0, "isn't a ray file");
    const name bad = path_of("bad.tm25ray"), box = path_of("y.box.exr"), missing = path_of("missing.tm25ray");
    EXPECT(RUN("convert", missing.text, box.text), 3, "can't be opened");
    EXPECT(RUN("convert", LAMP, box.text), 3, "lumibake bake");
    EXPECT(RUN("convert", bad.text, "/nowhere/x.box.exr"), 1, "can't write");
    write_file(in_folder("bad.tm25ray"), good, size);
    EXPECT(RUN("convert", bad.text, bad.text), 1, "overwrite an input");
    EXPECT(RUN("convert", bad.text, box.text, "--rays", "2001"), 3, "2001 rays of a source that has 2000");
    EXPECT(RUN("convert", bad.text, box.text, "--radiometric"), 3, "lumens only");
    /* the same size of zeros: rays without light */
    for (size_t i = 0; i < 2000; ++i)
        memset(good + size - 2000 * 28 + i * 28 + 24, 0, 4);
    damaged(__LINE__, good, size, "carry no light");
    free(bytes);
    free(good);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(arrows),
        cmocka_unit_test(watts),
        cmocka_unit_test(usage),
        cmocka_unit_test(bad_input),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
