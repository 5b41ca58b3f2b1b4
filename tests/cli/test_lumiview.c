/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The program lumiview from outside: exit codes, messages, files left behind, and every bad or odd glTF file as a room.
 * Runs the program LUMIVIEW (a path from the build) in folders of its own under /tmp.
 */
#include "image_io.h"
#include "room_fixture.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <jansson.h>
#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

/* A program that runs longer than this hangs (the slowest run here takes a few seconds with a sanitizer). */
enum { TOO_LONG = 120 };

static char folder[] = "/tmp/lumibox-view-XXXXXX";
static char out_text[1 << 16], err_text[1 << 16];

static void load(const char *name, char *text, size_t size)
{
    char path[64];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    text[fread(text, 1, size - 1, file)] = '\0';
    fclose(file);
}

/* Runs lumiview with these arguments (the last one NULL) in the folder; returns its exit code, or -signal. */
static int run_vector(char *const *arguments, int interrupt_after_ms)
{
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        if (chdir(folder) != 0 || !freopen("stdout.txt", "w", stdout) || !freopen("stderr.txt", "w", stderr)) {
            _exit(99);
        }
        alarm(TOO_LONG);
        execv(LUMIVIEW, arguments);
        _exit(98);
    }
    if (interrupt_after_ms > 0) {
        struct timespec wait = {interrupt_after_ms / 1000, interrupt_after_ms % 1000 * 1000000L};
        nanosleep(&wait, NULL);
        kill(child, SIGINT);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    load("stdout.txt", out_text, sizeof out_text);
    load("stderr.txt", err_text, sizeof err_text);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

/* The same from a line of words separated by spaces. */
static int run(const char *line)
{
    static char words[4096];
    char *arguments[64] = {(char *)(uintptr_t) "lumiview"};
    int count = 1;
    assert_true(strlen(line) < sizeof words);
    strcpy(words, line);
    for (char *word = strtok(words, " "); word; word = strtok(NULL, " ")) {
        assert_true(count < 63);
        arguments[count++] = word;
    }
    return run_vector(arguments, 0);
}

static bool exists(const char *name)
{
    char path[320];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return access(path, F_OK) == 0;
}

static void forget(const char *name)
{
    char path[320];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    unlink(path);
}

/* Number of files in the folder whose names begin so. */
static int count_files(const char *prefix)
{
    DIR *d = opendir(folder);
    assert_non_null(d);
    int count = 0;
    for (struct dirent *e; (e = readdir(d));) {
        count += strncmp(e->d_name, prefix, strlen(prefix)) == 0;
    }
    closedir(d);
    return count;
}

/* Exactly one line "error: ..." on stderr, besides warnings. */
static void one_error(void)
{
    int errors = 0;
    for (char *line = err_text; *line;) {
        char *end = strchr(line, '\n');
        assert_non_null(end);
        bool error = strncmp(line, "error: ", 7) == 0;
        errors += error;
        if (!error && strncmp(line, "warning: ", 9) != 0) {
            fail_msg("neither an error nor a warning: %.*s", (int)(end - line), line);
        }
        line = end + 1;
    }
    if (errors != 1) {
        fail_msg("%d lines with errors: %s", errors, err_text);
    }
}

static int make_folder(void **state)
{
    (void)state;
    static const float WHITE[3] = {1, 1, 1};
    if (!mkdtemp(folder)) {
        return -1;
    }
    char path[64];
    const double lower[3] = {-2, 0, -1.5}, upper[3] = {2, 2.5, 1.5};
    room_rectangle walls[6];
    room_walls(lower, upper, 0.6, walls);
    snprintf(path, sizeof path, "%s/room.gltf", folder);
    room_write(path, walls, 6);
    room_rectangle lamp = {.corner = {-0.2, 0, -0.2}, .e1 = {0.4, 0, 0}, .e2 = {0, 0, 0.4}, .luminance = 2000};
    snprintf(path, sizeof path, "%s/lamp.gltf", folder);
    room_write(path, &lamp, 1);
    lamp.luminance = 0;
    lamp.albedo = 0.5;
    snprintf(path, sizeof path, "%s/dark.gltf", folder);
    room_write(path, &lamp, 1);
    lmg_error err;
    lmg_field *field = panel_field(-0.2, 0.2, -0.2, 0.2, 0.05, WHITE, 2000);
    snprintf(path, sizeof path, "%s/lamp@1,2.box.exr", folder);
    assert_int_equal(lmg_field_write(field, path, &err), LMG_OK);
    lmg_field_destroy(field);
    return 0;
}

static int remove_folder(void **state)
{
    (void)state;
    DIR *d = opendir(folder);
    for (struct dirent *e; d && (e = readdir(d));) {
        forget(e->d_name);
    }
    if (d) {
        closedir(d);
    }
    return rmdir(folder);
}

/* --------------------------------------------------------------------------------------------------------------- tests */

static void renders_and_compares(void **state)
{
    (void)state;
    assert_int_equal(run("render room.gltf --light lamp@1,2.box.exr@0,2.4,0.1,30 -o box.exr --png box.png --size 40x30 --spp 8"),
                     0);
    assert_string_equal(err_text, "");
    assert_non_null(strstr(out_text, "box.exr: 40 x 30 pixels, 8 samples per pixel"));
    assert_true(exists("box.exr") && exists("box.png"));
    assert_int_equal(run("render --lamp lamp.gltf@0,2.4,0.1,30 --flux 1005.31lm room.gltf -o lamp.exr --exposure box.exr --seed 2 "
                         "--size=40x30 --spp 8 --json --threads 1"),
                     0);
    assert_string_equal(err_text, "");
    assert_true(out_text[0] == '{' && strstr(out_text, "\"samples_per_pixel\": 8"));
    assert_int_equal(run("diff box.exr lamp.exr --block 10 --png diff.png"), 0);
    assert_non_null(strstr(out_text, "relative RMSE"));
    assert_true(exists("diff.png"));
    assert_int_equal(run("diff box.exr lamp.exr --json"), 0);
    assert_true(out_text[0] == '{');

    /* The seed decides, the number of threads doesn't. */
    char path[64];
    view_image a, b;
    lmg_error err;
    view_image_notes notes;
    assert_int_equal(
        run("render room.gltf --light lamp@1,2.box.exr@0,2.4,0.1,30 -o one.exr --size 40x30 --spp 8 --threads 1 --quiet"), 0);
    assert_string_equal(out_text, "");
    snprintf(path, sizeof path, "%s/box.exr", folder);
    assert_int_equal(view_read_exr(path, &a, &notes, &err), LMG_OK);
    assert_true(notes.samples == 8 && notes.seed == 1 && notes.mid_grey > 0);
    snprintf(path, sizeof path, "%s/one.exr", folder);
    assert_int_equal(view_read_exr(path, &b, NULL, &err), LMG_OK);
    assert_memory_equal(a.rgb, b.rgb, 40 * 30 * 3 * sizeof(float));
    assert_memory_equal(a.standard_error, b.standard_error, 40 * 30 * sizeof(float));
    view_image_free(&a);
    view_image_free(&b);
    assert_int_equal(run("--version"), 0);
    assert_int_equal(run("--help"), 0);
    assert_int_equal(run("render --help"), 0);
    assert_int_equal(run("diff --help"), 0);
}

/* A meter without a picture, as a line and as JSON, 1 m under the panel. */
static void measures_illuminance(void **state)
{
    (void)state;
    double lux, bake, render;
    assert_int_equal(run("render room.gltf --light lamp@1,2.box.exr@0,2.4,0 --lux 0,1.4,0,0,1,0 --paths 20000"), 0);
    if (sscanf(out_text, "illuminance at 0,1.4,0 = %lf lx +- %lf %% bake +- %lf %% render", &lux, &bake, &render) != 3) {
        fail_msg("\"%s\" isn't a meter's line", out_text);
    }
    /* The panel's own light; and less than twice what the walls, of albedo 0.6, add on average: flux 0.6 / (59 m2 0.4). */
    double direct = panel_illuminance(-0.2, 0.2, -0.2, 0.2, 2000, 0, 1, 0),
           more = panel_flux(-0.2, 0.2, -0.2, 0.2, 2000) * 0.6 / (59 * 0.4);
    print_message("%s", out_text);
    assert_true(lux > direct && lux < direct + 2 * more && render > 0 && render < 3 && bake >= 0);
    assert_int_equal(run("render room.gltf --light lamp@1,2.box.exr@0,2.4,0 --lux 0,1.4,0,0,1,0 --paths 20000 --json"), 0);
    json_error_t where;
    json_t *o = json_loads(out_text, 0, &where);
    double again = json_real_value(json_object_get(json_array_get(json_object_get(o, "meters"), 0), "illuminance_lx"));
    assert_true(fabs(again / lux - 1) < 1e-3);
    json_decref(o);
}

/* ---------------------------------------------------------------------------------------------------------------- study */

static double number_at(json_t *o, const char *outer, const char *key)
{
    json_t *value = json_object_get(outer ? json_object_get(o, outer) : o, key);
    assert_true(json_is_number(value));
    return json_number_value(value);
}

static json_t *study_of(const char *more)
{
    char line[512];
    json_error_t where;
    snprintf(line, sizeof line,
             "study room.gltf --light lamp@1,2.box.exr@0,2.4,0.1,30 --lamp lamp.gltf@0,2.4,0.1,30 --flux 1005.31lm --size 48x36 "
             "--block 6 --runs 5 --spp 32 --json %s",
             more);
    assert_int_equal(run(line), 0);
    assert_string_equal(err_text, "");
    json_t *o = json_loads(out_text, 0, &where);
    assert_non_null(o);
    return o;
}

static int compare_seeds(const void *a, const void *b)
{
    const json_int_t x = *(const json_int_t *)a, y = *(const json_int_t *)b;
    return (x > y) - (x < y);
}

/* Errors of a panel's light, which both ways find easily: they fall as the root of the samples, within the confidence that is told
 * with the slope; the reference has seeds of its own and the noise that so many samples have; page and JSON are there. */
static void studies_a_room(void **state)
{
    (void)state;
    static const char *const METHODS[2] = {"box", "geometry"};
    json_t *o = study_of("-o study.html");
    json_t *reference = json_object_get(o, "reference"), *all[2];
    json_int_t seeds[2 + 2 * 6 * 5];
    size_t seed_count = 0, i;
    json_t *value;
    json_array_foreach(json_object_get(reference, "seeds"), i, value)
    {
        seeds[seed_count++] = json_integer_value(value);
    }
    assert_int_equal(seed_count, 2);
    for (int m = 0; m < 2; m++) {
        json_t *rungs = json_object_get(json_object_get(o, METHODS[m]), "rungs"),
               *slope = json_object_get(json_object_get(o, METHODS[m]), "over_samples");
        assert_int_equal(json_array_size(rungs), 6);
        for (size_t k = 0; k < 6; k++) {
            json_t *r = json_array_get(rungs, k);
            assert_int_equal((int)number_at(r, NULL, "samples_per_pixel"), 1 << k);
            assert_true(number_at(r, NULL, "processor_s") > 0 && number_at(r, NULL, "standard_error") > 0);
            json_array_foreach(json_object_get(r, "seeds"), i, value)
            {
                assert_true(seed_count < sizeof seeds / sizeof seeds[0]);
                seeds[seed_count++] = json_integer_value(value);
            }
        }
        const double first = number_at(json_array_get(rungs, 0), NULL, "rms"),
                     last = number_at(json_array_get(rungs, 5), NULL, "rms");
        const double told = number_at(slope, NULL, "slope"), confidence = number_at(slope, NULL, "confidence_95");
        print_message("%s: %.3g to %.3g %%, slope %.3f +- %.3f\n", METHODS[m], 100 * first, 100 * last, told, confidence);
        assert_true(last < first / 3); /* sqrt(32) is 5.7 */
        assert_true(confidence < 0.1);
        /* Of the geometry's errors the box's part is no noise, so that only the box's must have the slope of noise.  At 99.9 %
         * Student's t of four degrees of freedom is 8.61, 3.1 times that at 95 %. */
        assert_true(m == 1 || fabs(told + 0.5) <= 3.1 * confidence);
        all[m] = rungs;
    }
    assert_int_equal(seed_count, sizeof seeds / sizeof seeds[0]);
    qsort(seeds, seed_count, sizeof seeds[0], compare_seeds);
    for (i = 1; i < seed_count; i++) {
        assert_true(seeds[i - 1] != seeds[i]);
    }
    /* 16 times the samples of the highest rung: the root of that less noise, which halves tell on 48 blocks to a tenth. */
    assert_int_equal((int)number_at(reference, NULL, "samples_per_pixel"), 16 * 32);
    const double ratio = number_at(json_array_get(all[0], 5), NULL, "rms") / number_at(reference, NULL, "noise");
    assert_true(ratio > 4 / 1.6 && ratio < 4 * 1.6);
    /* The box is the panel's light to a few per mille. */
    const double difference = number_at(o, "difference_beyond_spread", "rms"),
                 time = number_at(o, "time_ratio_at_equal_error", "mean");
    print_message("difference %.3g %%, time ratio %.3g\n", 100 * difference, time);
    assert_true(fabs(difference) < 0.03 && time > 0);

    static char page[1 << 20];
    load("study.html", page, sizeof page);
    const char *plot = strstr(page, "<svg");
    assert_true(plot && strstr(plot + 1, "<svg") && strstr(page, "Time at equal error") && strstr(page, "</html>"));

    /* The seed decides, the number of threads doesn't. */
    json_t *again = study_of("--threads 1"), *other = study_of("--seed 2");
    for (int m = 0; m < 2; m++) {
        for (size_t k = 0; k < 6; k++) {
            json_t *squares = json_object_get(json_array_get(all[m], k), "squared_errors");
            json_t *same = json_array_get(json_object_get(json_object_get(again, METHODS[m]), "rungs"), k);
            json_t *new = json_array_get(json_object_get(json_object_get(other, METHODS[m]), "rungs"), k);
            assert_true(json_equal(squares, json_object_get(same, "squared_errors")));
            assert_false(json_equal(squares, json_object_get(new, "squared_errors")));
        }
    }
    json_decref(o);
    json_decref(again);
    json_decref(other);

    /* By time, as text. */
    assert_int_equal(
        run("study room.gltf --light lamp@1,2.box.exr@0,2.4,0.1,30 --lamp lamp.gltf@0,2.4,0.1,30 --size 32x24 --time 2s"), 0);
    assert_non_null(strstr(out_text, "time of geometry over box at equal error"));
    assert_int_equal(run("study --help"), 0);
}

static void interrupted_study_ends_with_130(void **state)
{
    (void)state;
    static const char *const WORDS[] = {
        "lumiview", "study", "room.gltf", "--light",  "lamp@1,2.box.exr@0,2.4,0", "--lamp", "lamp.gltf@0,2.4,0",
        "--time",   "1h",    "-o",        "none.html"};
    enum { COUNT = sizeof WORDS / sizeof WORDS[0] };
    char *arguments[COUNT + 1] = {NULL};
    for (int i = 0; i < COUNT; i++) {
        arguments[i] = (char *)(uintptr_t)WORDS[i];
    }
    assert_int_equal(run_vector(arguments, 1500), 130);
    one_error();
    assert_int_equal(count_files("none"), 0);
}

static void wrong_usage_is_2(void **state)
{
    (void)state;
    static const char *const LINES[] = {
        "",
        "rendr room.gltf",
        "render",
        "render room.gltf",
        "render room.gltf dark.gltf --png none.png",
        "render room.gltf --png none.png --light lamp@1,2.box.exr",
        "render room.gltf --png none.png --light lamp.box.exr@1,2",
        "render room.gltf --png none.png --lamp lamp.gltf@1,2,3,4,5",
        "render room.gltf --lux 0,1,0",
        "render room.gltf --lux 0,1,0,0,0,0",
        "render room.gltf --lux 0,1,0,0,1,0 --paths 1",
        "render room.gltf --png none.png --spp 0",
        "render room.gltf --png none.png --spp 1.5",
        "render room.gltf --png none.png --spp",
        "render room.gltf --png none.png --time 3parsec",
        "render room.gltf --png none.png --time -1",
        "render room.gltf --png none.png --size 100",
        "render room.gltf --png none.png --size 0x10",
        "render room.gltf --png none.png --size 100000x10",
        "render room.gltf --png none.png --frobnicate",
        "render room.gltf --light b.exr@0,0,0 --png none.png --recipe x.json",
        "render room.gltf --png none.png --flux 3",
        "render room.gltf --light b.exr@0,0,0 --png none.png --set thin:Glass",
        "render room.gltf --png none.png --eye 1,2,3",
        "render room.gltf --png none.png --eye 1,2 --target 1,2,4",
        "render room.gltf --png none.png --eye 1,2,3 --target 1,2,3",
        "render room.gltf --png none.png --fov 50",
        "render room.gltf --png none.png --eye 1,2,3 --target 1,2,4 --fov 180",
        "render room.gltf --png none.png --camera nobody",
        "render room.gltf --png none.png --exposure bright",
        "render room.gltf --png none.png --threads many",
        "render room.gltf --png none.png --seed -1",
        "study",
        "study room.gltf",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 -o none.html",
        "study room.gltf --lamp lamp.gltf@0,1,0 -o none.html",
        "study room.gltf --light lamp@1,2.box.exr --lamp lamp.gltf@0,1,0 -o none.html",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --runs 2",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --runs 65",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --block 0",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --block 40",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -q",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --spp 0",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --spp 4 --time 3s",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --time soon",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html --png none.png",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --recipe x.json --lamp lamp.gltf@0,1,0 -o none.html",
        "diff",
        "diff a.exr",
        "diff a.exr b.exr c.exr",
        "diff a.exr b.exr --block 0",
        "diff a.exr b.exr --scale x",
    };
    for (size_t i = 0; i < sizeof LINES / sizeof LINES[0]; i++) {
        int code = run(LINES[i]);
        if (code != 2) {
            fail_msg("\"%s\" ended with %d: %s", LINES[i], code, err_text);
        }
        one_error();
        assert_string_equal(out_text, "");
        assert_int_equal(count_files("none"), 0);
    }
}

static void bad_input_is_3(void **state)
{
    (void)state;
    char path[64];
    snprintf(path, sizeof path, "%s/text.gltf", folder);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    fputs("this is no room\n", file);
    fclose(file);
    /* Half a box. */
    snprintf(path, sizeof path, "%s/lamp@1,2.box.exr", folder);
    static char bytes[1 << 20];
    file = fopen(path, "rb");
    assert_non_null(file);
    size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    snprintf(path, sizeof path, "%s/half.box.exr", folder);
    file = fopen(path, "wb");
    assert_non_null(file);
    fwrite(bytes, 1, size / 2, file);
    fclose(file);
    bytes[size / 2] ^= 0x10;
    snprintf(path, sizeof path, "%s/flip.box.exr", folder);
    file = fopen(path, "wb");
    assert_non_null(file);
    fwrite(bytes, 1, size, file);
    fclose(file);
    static const char *const LINES[] = {
        "render missing.gltf --png none.png -o none.exr",
        "render text.gltf --png none.png -o none.exr",
        "render lamp@1,2.box.exr --png none.png -o none.exr",
        "render room.gltf --light missing.box.exr@0,1,0 --png none.png -o none.exr",
        "render room.gltf --light room.gltf@0,1,0 --png none.png -o none.exr",
        "render room.gltf --light half.box.exr@0,1,0 --png none.png -o none.exr",
        "render room.gltf --light flip.box.exr@0,1,0 --png none.png -o none.exr",
        "render room.gltf --lamp dark.gltf@0,1,0 --png none.png -o none.exr",
        "render room.gltf --lamp missing.gltf@0,1,0 --png none.png -o none.exr",
        "render room.gltf --lamp lamp.gltf@0,1,0 --recipe missing.json --png none.png -o none.exr",
        "render room.gltf --lamp lamp.gltf@0,1,0 --recipe room.gltf --png none.png -o none.exr",
        "render room.gltf --exposure missing.exr --png none.png -o none.exr",
        "study missing.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html",
        "study room.gltf --light missing.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html",
        "study room.gltf --light half.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o none.html",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp dark.gltf@0,1,0 -o none.html",
        "study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 --recipe missing.json -o none.html",
        "diff missing.exr missing.exr --png none.png",
        "diff room.gltf room.gltf --png none.png",
    };
    for (size_t i = 0; i < sizeof LINES / sizeof LINES[0]; i++) {
        int code = run(LINES[i]);
        if (code != 3) {
            fail_msg("\"%s\" ended with %d: %s", LINES[i], code, err_text);
        }
        one_error();
        assert_string_equal(out_text, "");
        assert_int_equal(count_files("none"), 0);
    }
    /* Nowhere to write: known at once, before a long rendering. */
    assert_int_equal(run("render room.gltf --light lamp@1,2.box.exr@0,1,0 --png no/such/folder/x.png --spp 1000000"), 1);
    one_error();
    assert_int_equal(run("study room.gltf --light lamp@1,2.box.exr@0,1,0 --lamp lamp.gltf@0,1,0 -o no/such/folder/x.html"), 1);
    one_error();
}

static void interrupt_writes_what_there_is(void **state)
{
    (void)state;
    char *arguments[] = {(char *)(uintptr_t) "lumiview",
                         (char *)(uintptr_t) "render",
                         (char *)(uintptr_t) "room.gltf",
                         (char *)(uintptr_t) "--light",
                         (char *)(uintptr_t) "lamp@1,2.box.exr@0,2.4,0",
                         (char *)(uintptr_t) "-o",
                         (char *)(uintptr_t) "stopped.exr",
                         (char *)(uintptr_t) "--size",
                         (char *)(uintptr_t) "64x48",
                         (char *)(uintptr_t) "--time",
                         (char *)(uintptr_t) "1h",
                         NULL};
    forget("stopped.exr");
    assert_int_equal(run_vector(arguments, 1500), 130);
    char path[64];
    view_image image;
    lmg_error err;
    snprintf(path, sizeof path, "%s/stopped.exr", folder);
    assert_int_equal(view_read_exr(path, &image, NULL, &err), LMG_OK);
    assert_int_equal(image.width, 64);
    view_image_free(&image);
    assert_int_equal(count_files("stopped.exr"), 1); /* and no temporary beside it */
}

static void time_is_kept(void **state)
{
    (void)state;
    struct timespec a, b;
    clock_gettime(CLOCK_MONOTONIC, &a);
    assert_int_equal(run("render room.gltf --light lamp@1,2.box.exr@0,2.4,0 --png time.png --size 32x24 --time 2s"), 0);
    clock_gettime(CLOCK_MONOTONIC, &b);
    double seconds = (double)(b.tv_sec - a.tv_sec) + 1e-9 * (double)(b.tv_nsec - a.tv_nsec);
    /* Two seconds of passes, and a busy machine's starting and writing. */
    assert_true(seconds > 1 && seconds < 30);
}

static int files_tried, pictures_made;

/* Every .gltf and .glb under path as a room. */
static void try_files(const char *path)
{
    DIR *d = opendir(path);
    assert_non_null(d);
    for (struct dirent *e; (e = readdir(d));) {
        char child[2048];
        struct stat info;
        if (e->d_name[0] == '.' || snprintf(child, sizeof child, "%s/%s", path, e->d_name) >= (int)sizeof child ||
            stat(child, &info) != 0) {
            continue;
        }
        if (S_ISDIR(info.st_mode)) {
            try_files(child);
            continue;
        }
        const char *dot = strrchr(child, '.');
        if (!dot || (strcmp(dot, ".gltf") != 0 && strcmp(dot, ".glb") != 0)) {
            continue;
        }
        char *arguments[] = {(char *)(uintptr_t) "lumiview",
                             (char *)(uintptr_t) "render",
                             child,
                             (char *)(uintptr_t) "--light",
                             (char *)(uintptr_t) "lamp@1,2.box.exr@0.3,1.7,0.4",
                             (char *)(uintptr_t) "--png",
                             (char *)(uintptr_t) "odd.png",
                             (char *)(uintptr_t) "--size",
                             (char *)(uintptr_t) "8x6",
                             (char *)(uintptr_t) "--spp",
                             (char *)(uintptr_t) "1",
                             NULL};
        forget("odd.png");
        int code = run_vector(arguments, 0);
        files_tried++;
        if (code == 0) {
            pictures_made++;
            assert_true(exists("odd.png"));
        } else if (code == 3) {
            one_error();
            assert_int_equal(count_files("odd.png"), 0);
        } else {
            fail_msg("%s: exit code %d: %s", child, code, err_text);
        }
    }
    closedir(d);
}

static void odd_rooms(void **state)
{
    (void)state;
    static const char *const FOLDERS[] = {LUMIBOX_SHARED_DATA "/gltf-invalid", LUMIBOX_SHARED_DATA "/gltf-odd"};
    for (size_t i = 0; i < 2; i++) {
        if (access(FOLDERS[i], R_OK) != 0) {
            print_message("SKIPPED odd_rooms: %s isn't there\n", FOLDERS[i]);
            skip();
        }
        files_tried = pictures_made = 0;
        try_files(FOLDERS[i]);
        print_message("%s: %d files, %d pictures, %d refused with one line\n", FOLDERS[i], files_tried, pictures_made,
                      files_tried - pictures_made);
        assert_true(files_tried > 0);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(renders_and_compares),
        cmocka_unit_test(measures_illuminance),
        cmocka_unit_test(wrong_usage_is_2),
        cmocka_unit_test(bad_input_is_3),
        cmocka_unit_test(interrupt_writes_what_there_is),
        cmocka_unit_test(studies_a_room),
        cmocka_unit_test(interrupted_study_ends_with_130),
        cmocka_unit_test(time_is_kept),
        cmocka_unit_test(odd_rooms),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
