/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Ray files: every variant of TM-25 that makers write, all formats written and read back, real files, and damage of every kind: cut
 * off at every length, wrong counts, numbers that aren't, random bytes.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "fuzz.h"
#include "rayfile_maker.h"

#include <luminaires/rayfile.h>
#include <luminaires/rng.h>
#include <luminaires/spectrum.h>

#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { RAYS = 137 };

static void near(double value, double expected, double tolerance)
{
    if (!(fabs(value - expected) <= tolerance))
        fail_msg("%.12g is not %.12g +- %.3g", value, expected, tolerance);
}

static const tm25_recipe PLAIN = {.rays = RAYS, .flags = {1, 1, 0, 0, 1, 0, 0, 0}, .luminous = 146.3f, .radiant = NAN};

static lum_rayfile *open_bytes(const void *bytes, size_t size, lum_ray_flux flux)
{
    lmg_error err = {{0}};
    lum_rayfile *file;
    if (lum_rayfile_open_memory(bytes, size, "test", flux, &file, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return file;
}

static void read_all(const lum_rayfile *file, double scale, lmg_ray *rays)
{
    lmg_error err = {{0}};
    lum_ray_reader *reader;
    assert_int_equal(lum_ray_reader_create(file, &reader, &err), LMG_OK);
    const uint64_t n = lum_rayfile_info(file)->rays;
    for (uint64_t at = 0; at < n; at += 50) /* odd blocks, so that places inside blocks are found */
        if (lum_ray_reader_read(reader, at, n - at < 50 ? (size_t)(n - at) : 50, scale, rays + at, &err) != LMG_OK)
            fail_msg("%s", err.message);
    lum_ray_reader_destroy(reader);
}

/* Positions and directions as the maker made them; floats in mm, so half a unit in the last place of 137. */
static void check_geometry(const lmg_ray *rays)
{
    for (uint32_t i = 0; i < RAYS; ++i) {
        float k[3];
        tm25_direction(i, k);
        near(rays[i].origin.x, 1e-3 * i, 1e-3 * 137 * 0x1p-24);
        near(rays[i].origin.y, -0.5e-3 * i, 1e-3 * 137 * 0x1p-24);
        near(rays[i].origin.z, 0.25e-3, 1e-12);
        near(rays[i].direction.x, (double)k[0], 0x1p-23);
        near(rays[i].direction.y, (double)k[1], 0x1p-23);
        near(rays[i].direction.z, (double)k[2], 0x1p-23);
        assert_int_equal(rays[i].number, i);
    }
}

static void tm25_variants(void **state)
{
    (void)state;
    for (int variant = 0; variant < 8; ++variant) {
        tm25_recipe r = PLAIN;
        r.tables = variant & 1 ? 3 : 0;
        r.table_points = 5;
        r.unpadded = variant & 2;
        r.extra = variant & 4 ? 2 : 0;
        r.no_labels = variant == 7;
        r.text_bytes = variant == 5 ? 64 : 0;
        r.flags[5] = variant == 6; /* Stokes */
        r.flags[7] = variant == 3; /* spectrum index: */
        r.spectral = variant == 3 ? 4 : 0;
        size_t size;
        uint8_t *bytes = tm25_make(&r, &size);
        lum_rayfile *file = open_bytes(bytes, size, LUM_RAY_LIGHT);
        const lum_ray_info *info = lum_rayfile_info(file);
        assert_int_equal(info->format, LUM_RAYS_TM25);
        assert_int_equal(info->rays, RAYS);
        assert_true(info->photometric);
        assert_int_equal(info->extra_columns, r.extra);
        assert_int_equal(info->has_polarization, r.flags[5]);
        assert_int_equal(info->spectra, r.tables);
        assert_string_equal(info->date, "2024-05-06 07:08:09");
        assert_string_equal(info->texts[2], "C\xe4\xb8\xad");
        near(info->luminous_lm, 146.3, 1e-5);
        assert_true(isnan(info->radiant_W));
        lmg_ray rays[RAYS];
        read_all(file, 2, rays);
        check_geometry(rays);
        for (uint32_t i = 0; i < RAYS; ++i) /* three float roundings */
            near(lmg_luminance(rays[i].flux), 2 * (1 + 0.001 * i), 3 * 2.3 * 0x1p-24);
        lum_rayfile_close(file);
        free(bytes);
    }
}

static void unknown_totals(void **state)
{
    (void)state;
    tm25_recipe r = PLAIN;
    for (int k = 0; k < 3; ++k) {
        r.big_endian_nan = k == 0;
        r.luminous = r.radiant = k == 1 ? NAN : 0;
        size_t size;
        uint8_t *bytes = tm25_make(&r, &size);
        lum_rayfile *file = open_bytes(bytes, size, LUM_RAY_LIGHT);
        assert_true(isnan(lum_rayfile_info(file)->luminous_lm) && isnan(lum_rayfile_info(file)->radiant_W));
        lum_rayfile_close(file);
        free(bytes);
    }
}

/* Lumens out of watts: by wavelength, by one spectrum, by each ray's spectrum, by the header, not at all. */
static void units(void **state)
{
    (void)state;
    lmg_ray rays[RAYS];
    size_t size;
    double xyz[3];
    for (int k = 0; k < 5; ++k) {
        tm25_recipe r = PLAIN;
        r.flags[2] = true;
        r.flags[4] = false;
        r.flags[3] = k == 0;
        r.flags[7] = k == 2;
        r.spectral = k == 0 ? 2 : k == 1 ? 3 : k == 2 ? 4 : 0;
        r.tables = k == 1 ? 1 : k == 2 ? 3 : 0;
        r.table_points = 2; /* 500 + 20 t and 1 nm more, weights 1 and 2 */
        r.luminous = k == 3 ? 60 : NAN;
        r.radiant = k == 3 ? 0.2f : NAN;
        uint8_t *bytes = tm25_make(&r, &size);
        lum_rayfile *file = open_bytes(bytes, size, LUM_RAY_LIGHT);
        assert_int_equal(lum_rayfile_info(file)->photometric, k != 4);
        assert_non_null(lum_rayfile_remark(file, 0));
        read_all(file, 1, rays);
        for (uint32_t i = 0; i < RAYS; ++i) {
            double worth = k == 3 ? 300 : 1;
            if (k == 0) {
                lum_observer(500.0 + i, xyz);
                worth = 683 * xyz[1];
                near((double)rays[i].wavelength, 500.0 + i, 1e-4);
            } else if (k == 1 || k == 2) { /* trapezoid of both ends: weights 1 and 2 of 1.5 in all */
                const double nm = 500 + (k == 2 ? 20 * (i % 3) : 0);
                lum_observer(nm, xyz);
                worth = xyz[1] / 3;
                lum_observer(nm + 1, xyz);
                worth = 683 * (worth + xyz[1] * 2 / 3);
            }
            /* wavelengths have colours of components up to 30 times the luminance: their float rounding */
            near(lmg_luminance(rays[i].flux), (double)0.002f * worth, 30 * 0.002 * worth * 0x1p-22);
        }
        lum_rayfile_close(file);
        file = open_bytes(bytes, size, LUM_RAY_POWER);
        read_all(file, 1, rays);
        assert_false(lum_rayfile_info(file)->photometric);
        near(lmg_luminance(rays[3].flux), 0.002, 1e-9);
        lum_rayfile_close(file);
        free(bytes);
    }
    /* watts of a file that has lumens only */
    uint8_t *bytes = tm25_make(&PLAIN, &size);
    lum_rayfile *file;
    lmg_error err;
    assert_int_equal(lum_rayfile_open_memory(bytes, size, "x", LUM_RAY_POWER, &file, &err), LMG_ERROR_UNSUPPORTED);
    free(bytes);
}

static void tristimulus(void **state)
{
    (void)state;
    tm25_recipe r = PLAIN;
    r.flags[6] = true;
    size_t size;
    uint8_t *bytes = tm25_make(&r, &size);
    lum_rayfile *file = open_bytes(bytes, size, LUM_RAY_LIGHT);
    lmg_ray rays[RAYS];
    float rgb[3];
    assert_false(lum_rayfile_colour(file, rgb));
    read_all(file, 1, rays);
    for (int i = 0; i < RAYS; ++i) {
        const double v[3] = {(double)rays[i].flux[0], (double)rays[i].flux[1], (double)rays[i].flux[2]};
        const double y = 1 + 0.001 * i;
        double xyz[3];
        lum_rgb_to_xyz(v, xyz);
        near(xyz[0], 0.5 * y, 1e-6);
        near(xyz[1], y, 1e-6);
        near(xyz[2], 0.25 * y, 1e-6);
    }
    lum_rayfile_close(file);
    free(bytes);
}

/* --------------------------------------------------------------------------------------------------------- round trips */

static char folder[] = "/tmp/lumibox_rayfile_XXXXXX";

static const char *path_of(const char *name)
{
    static char path[256];
    snprintf(path, sizeof(path), "%s/%s", folder, name);
    return path;
}

static int files_in_folder(void)
{
    DIR *d = opendir(folder);
    int n = 0;
    for (struct dirent *e; (e = readdir(d));)
        n += e->d_name[0] != '.';
    closedir(d);
    return n;
}

static uint8_t *slurp(const char *path, size_t *size)
{
    FILE *f = fopen(path, "rb");
    if (!f)
        return NULL;
    fseek(f, 0, SEEK_END);
    *size = (size_t)ftell(f);
    rewind(f);
    uint8_t *bytes = malloc(*size + 1);
    assert_int_equal(fread(bytes, 1, *size, f), *size);
    fclose(f);
    return bytes;
}

static void round_trips(void **state)
{
    (void)state;
    size_t size;
    for (int format = LUM_RAYS_TM25; format <= LUM_RAYS_LIGHTTOOLS_TEXT; ++format)
        for (int kind = 0; kind < 4; ++kind) { /* lumens, watts, watts with wavelengths, lumens with colours */
            tm25_recipe r = PLAIN;
            r.flags[2] = kind == 1 || kind == 2;
            r.flags[4] = kind == 0 || kind == 3;
            r.flags[3] = kind == 2;
            r.flags[6] = kind == 3;
            r.spectral = kind == 2 ? 2 : 0;
            uint8_t *bytes = tm25_make(&r, &size);
            lum_rayfile *file = open_bytes(bytes, size, LUM_RAY_STORED);
            lmg_ray before[RAYS], after[RAYS];
            read_all(file, 1, before);
            lum_rayfile_close(file);
            free(bytes);

            const lum_ray_writer_options o = {.format = (lum_ray_format)format,
                                              .photometric = kind == 0 || kind == 3,
                                              .wavelength = kind == 2,
                                              .tristimulus = kind == 3,
                                              .source = "a lamp \xe4\xb8\xad",
                                              .software = "test"};
            lmg_error err = {{0}};
            lum_ray_writer *w;
            const lmg_result made = lum_ray_writer_create(path_of("rays"), &o, &w, &err);
            const bool text = format == LUM_RAYS_ZEMAX_TEXT;
            if ((kind == 3 && format != LUM_RAYS_TM25) || (kind == 0 && text)) {
                assert_int_equal(made, LMG_ERROR_UNSUPPORTED);
                assert_int_equal(files_in_folder(), 0);
                continue;
            }
            if (made != LMG_OK)
                fail_msg("%s", err.message);
            assert_int_equal(lum_ray_writer_append(w, before, 100, 1, &err), LMG_OK);
            assert_int_equal(lum_ray_writer_append(w, before + 100, RAYS - 100, 1, &err), LMG_OK);
            assert_int_equal(access(path_of("rays"), F_OK), -1); /* not before it is whole */
            double total, sum = 0;
            assert_int_equal(lum_ray_writer_finish(w, &total, &err), LMG_OK);
            assert_int_equal(files_in_folder(), 1);

            assert_int_equal(lum_ray_format_of_file(path_of("rays")), format);
            if (lum_rayfile_open(path_of("rays"), LUM_RAY_STORED, &file, &err) != LMG_OK)
                fail_msg("%s", err.message);
            const lum_ray_info *info = lum_rayfile_info(file);
            assert_int_equal(info->rays, RAYS);
            assert_int_equal(info->photometric, o.photometric);
            read_all(file, 1, after);
            check_geometry(after);
            for (int i = 0; i < RAYS; ++i) {
                sum += lmg_luminance(before[i].flux);
                near((double)after[i].wavelength, (double)before[i].wavelength, 500 * 0x1p-22);
                for (int c = 0; c < 3; ++c) /* floats through tristimulus values and back: a few roundings of values up to 1 */
                    near((double)after[i].flux[c], (double)before[i].flux[c], 16 * 0x1p-24 * (kind == 3 ? 4 : 1));
            }
            near(total, sum, 1e-6 * sum);
            const double told = o.photometric ? info->luminous_lm : info->radiant_W;
            if (format != LUM_RAYS_ZEMAX_TEXT)
                near(told, sum, 1e-6 * sum);
            lum_rayfile_close(file);
            unlink(path_of("rays"));
        }
    /* giving up leaves nothing */
    const lum_ray_writer_options o = {.format = LUM_RAYS_TM25, .photometric = true};
    lum_ray_writer *w;
    assert_int_equal(lum_ray_writer_create(path_of("rays"), &o, &w, NULL), LMG_OK);
    lum_ray_writer_abandon(w);
    assert_int_equal(files_in_folder(), 0);
}

/* A text file longer than the index's first stride and than the reader's buffer, read from places in its middle. */
static void long_text(void **state)
{
    (void)state;
    enum { MANY = 20000 };
    lmg_error err = {{0}};
    lum_ray_writer *w;
    const lum_ray_writer_options o = {.format = LUM_RAYS_LIGHTTOOLS_TEXT, .photometric = true};
    assert_int_equal(lum_ray_writer_create(path_of("long.txt"), &o, &w, &err), LMG_OK);
    for (int i = 0; i < MANY; ++i) {
        const lmg_ray ray = {.origin = {i, 0, 0}, .direction = {0, 0.6, 0.8}, .flux = {1, 1, 1}};
        assert_int_equal(lum_ray_writer_append(w, &ray, 1, 1, &err), LMG_OK);
    }
    assert_int_equal(lum_ray_writer_finish(w, NULL, &err), LMG_OK);
    lum_rayfile *file;
    assert_int_equal(lum_rayfile_open(path_of("long.txt"), LUM_RAY_LIGHT, &file, &err), LMG_OK);
    assert_int_equal(lum_rayfile_info(file)->rays, MANY);
    lum_ray_reader *reader;
    assert_int_equal(lum_ray_reader_create(file, &reader, &err), LMG_OK);
    static lmg_ray rays[LUM_RAY_BLOCK];
    static const uint64_t PLACES[] = {0, 1, 255, 256, 257, 8191, MANY - LUM_RAY_BLOCK};
    for (size_t p = 0; p < sizeof(PLACES) / sizeof(PLACES[0]); ++p) {
        assert_int_equal(lum_ray_reader_read(reader, PLACES[p], LUM_RAY_BLOCK, 1, rays, &err), LMG_OK);
        for (size_t i = 0; i < LUM_RAY_BLOCK; ++i) /* metres through millimetres in floats */
            near(rays[i].origin.x, (double)(PLACES[p] + i), 2e4 * 0x1p-23);
    }
    assert_int_equal(lum_ray_reader_read(reader, MANY - 1, 2, 1, rays, &err), LMG_ERROR_ARGUMENT);
    lum_ray_reader_destroy(reader);
    lum_rayfile_close(file);
    unlink(path_of("long.txt"));
}

/* -------------------------------------------------------------------------------------------------------------- damage */

/* Opening and reading to the end gives an error of one line with this in it. */
static void refused(const void *bytes, size_t size, const char *why)
{
    lmg_error err = {{0}};
    lum_rayfile *file;
    lmg_result result = lum_rayfile_open_memory(bytes, size, "bad", LUM_RAY_LIGHT, &file, &err);
    if (result == LMG_OK) {
        lum_ray_reader *reader;
        lmg_ray rays[RAYS];
        const uint64_t n = lum_rayfile_info(file)->rays;
        assert_true(n <= RAYS);
        assert_int_equal(lum_ray_reader_create(file, &reader, &err), LMG_OK);
        result = lum_ray_reader_read(reader, 0, (size_t)n, 1, rays, &err);
        lum_ray_reader_destroy(reader);
        lum_rayfile_close(file);
    }
    assert_int_not_equal(result, LMG_OK);
    assert_null(strchr(err.message, '\n'));
    if (!strstr(err.message, why))
        fail_msg("'%s' doesn't say '%s'", err.message, why);
}

static void put32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; ++i)
        p[i] = (uint8_t)(v >> 8 * i);
}

static void bad_tm25(void **state)
{
    (void)state;
    size_t size;
    tm25_recipe r = PLAIN;
    r.tables = 1;
    r.table_points = 5;
    uint8_t *good = tm25_make(&r, &size), *bytes = malloc(size);
    static const struct {
        size_t at;
        uint32_t value;
        const char *why;
    } MISTAKES[] = {
        {4, 12, "version"},
        {20, 0, "0 rays"},
        {24, 0x80000000u, "9223372036854775945 rays"}, /* 2^63 and those that are there */
        {20, RAYS + 1, "cut off"},
        {60, 9, "spectral identifier 9"},
        {60, 2, "without wavelength"},
        {60, 4, "without a table's number"},
        {76, 0xffffffffu, "-1 tables"},
        {76, 2, "spectral table 2"},
        {80, 0x7fffffffu, "further columns"},
        {80, 3, "cut off"},
        {84, 0x7fffffe0u, "cut off"},
        {256, 0, "no position"},
        {260, 0, "no direction"},
        {272, 0, "no flux"},
        {264, 7, "radiant flux is 7"},
        {264, 1, "cut off"},
        {36288, 0x7fffffffu, "points"},
        {36292, 0x7fc00000u, "spectral table 1, point 1"},
    };
    for (size_t i = 0; i < sizeof(MISTAKES) / sizeof(MISTAKES[0]); ++i) {
        memcpy(bytes, good, size);
        put32(bytes + MISTAKES[i].at, MISTAKES[i].value);
        refused(bytes, size, MISTAKES[i].why);
    }
    const size_t start = size - RAYS * 28, ray = start + 100 * 28; /* past the rays that opening looks at from either end */
    static const struct {
        int column;
        uint32_t value;
        const char *why;
    } RAY[] = {
        {1, 0x7fc00000u, "ray 101: its position isn't a number"},
        {2, 0x7f800000u, "ray 101: its position isn't a number"},
        {3, 0x7fc00001u, "ray 101: its direction isn't a number"},
        {4, 0x40000000u, "ray 101: its direction has length"},
        {6, 0x7fc00000u, "ray 101: its flux isn't a number"},
        {6, 0x0100807fu, "ray 101: its flux isn't a number (a NaN with its bytes swapped)"},
        {6, 0x0100c07fu, "bytes swapped"},
        {6, 0xbf800000u, "ray 101: a flux of -1"},
        {6, 0xff800000u, "isn't a number"},
    };
    for (size_t i = 0; i < sizeof(RAY) / sizeof(RAY[0]); ++i) {
        r.rays = RAYS;
        memcpy(bytes, good, size);
        put32(bytes + ray - 30 * 28 + 4 * (size_t)RAY[i].column, RAY[i].value);
        /* ray 71: between the 64 first and the 64 last of 137 */
        char why[100];
        snprintf(why, sizeof(why), "%s", RAY[i].why);
        char *number = strstr(why, "101");
        if (number)
            memcpy(number, "71:", 3), memmove(number + 3, number + 4, strlen(number + 4) + 1);
        refused(bytes, size, why);
    }
    /* cut off at every length */
    for (size_t n = 0; n < size; n += n < 36000 ? 97 : 1)
        refused(good, n, n < 4 ? "isn't a ray file" : n + 100 < size ? "cut off" : ""); /* by a padding: what is left has no directions */
    free(bytes);
    free(good);
}

/* A file of a format in memory, by the library's writer. */
static uint8_t *written(lum_ray_format format, bool photometric, bool wavelength, size_t *size)
{
    lmg_error err = {{0}};
    lum_ray_writer *w;
    const lum_ray_writer_options o = {.format = format, .photometric = photometric, .wavelength = wavelength};
    assert_int_equal(lum_ray_writer_create(path_of("w"), &o, &w, &err), LMG_OK);
    for (uint32_t i = 0; i < RAYS; ++i) {
        float k[3];
        tm25_direction(i, k);
        const lmg_ray ray = {.origin = {1e-3 * i + 0.12345, 0, 0}, .direction = {(double)k[0], (double)k[1], (double)k[2]}, .flux = {1, 1, 1}, .wavelength = 555};
        assert_int_equal(lum_ray_writer_append(w, &ray, 1, 1, &err), LMG_OK);
    }
    assert_int_equal(lum_ray_writer_finish(w, NULL, &err), LMG_OK);
    uint8_t *bytes = slurp(path_of("w"), size);
    unlink(path_of("w"));
    return bytes;
}

static void bad_others(void **state)
{
    (void)state;
    size_t size;
    uint8_t *bytes = written(LUM_RAYS_ZEMAX, true, false, &size);
    for (size_t n = 0; n < size; ++n)
        refused(bytes, n, n < 4 ? "isn't a ray file" : "cut off");
    static const struct {
        size_t at;
        uint32_t value;
        const char *why;
    } ZEMAX[] = {{4, 0, "0 rays"},       {4, RAYS + 1, "cut off"}, {4, 0xffffffffu, "cut off"}, {136, 5, "unit of length 5"},
                 {192, 1, "ray format"}, {196, 2, "flux type 2"},  {192, 2, "can't have"}};
    for (size_t i = 0; i < sizeof(ZEMAX) / sizeof(ZEMAX[0]); ++i) {
        uint8_t *copy = malloc(size);
        memcpy(copy, bytes, size);
        put32(copy + ZEMAX[i].at, ZEMAX[i].value);
        refused(copy, size, ZEMAX[i].why);
        free(copy);
    }
    put32(bytes + 208 + 70 * 28 + 24, 0x0100807fu);
    refused(bytes, size, "bytes swapped");
    free(bytes);

    bytes = written(LUM_RAYS_LIGHTTOOLS, false, true, &size);
    for (size_t n = 0; n < size; ++n)
        refused(bytes, n, n < 4 ? "isn't a ray file" : "cut off");
    static const struct {
        size_t at;
        uint32_t value;
        const char *why;
    } LIGHTTOOLS[] = {{4, 3, "polarized"},      {4, 9, "version 9"},   {12, 2, "data type 2"}, {16, 2, "far field 2"},
                      {20, 1, "tristimulus"},   {20, 3, "colour 3"},   {24, 8, "unit of length 8"},
                      {28, 0x7fc00000u, "origin"}, {20, 0, "unit directions"}};
    for (size_t i = 0; i < sizeof(LIGHTTOOLS) / sizeof(LIGHTTOOLS[0]); ++i) {
        uint8_t *copy = malloc(size);
        memcpy(copy, bytes, size);
        put32(copy + LIGHTTOOLS[i].at, LIGHTTOOLS[i].value);
        refused(copy, size, LIGHTTOOLS[i].at == 20 && LIGHTTOOLS[i].value == 0 ? "aren't whole rays" : LIGHTTOOLS[i].why);
        free(copy);
    }
    /* data that looks like the trailer isn't it: the trailer is at the end */
    memcpy(bytes + 44 + 70 * 32, "LTRFEND", 7);
    lum_rayfile *file = open_bytes(bytes, size, LUM_RAY_LIGHT);
    lmg_ray rays[RAYS];
    assert_int_equal(lum_rayfile_info(file)->rays, RAYS);
    read_all(file, 1, rays);
    lum_rayfile_close(file);
    free(bytes);

    bytes = written(LUM_RAYS_LIGHTTOOLS_TEXT, true, false, &size);
    for (size_t n = 0; n + 13 < size; n += 1 + n / 50) /* the last line of 13 characters may lack its end */
        refused(bytes, n, ""); /* cut in a line of its header it misses a value */
    refused(bytes, size - 2, "cut off");
    char *line = strstr((char *)bytes, "lt_startofdata\n") + strlen("lt_startofdata\n");
    memcpy(line, "nan 0 0 0 0 1 1\n#", 17); /* the rest of its line becomes a comment */
    refused(bytes, size, "ray 1: its position isn't a number");
    memcpy(line, "abc 0 0 0 0 1 1\n#", 17);
    refused(bytes, size, "ray 1: its line holds other things");
    free(bytes);

    bytes = written(LUM_RAYS_ZEMAX_TEXT, false, true, &size);
    for (size_t n = 0; n + 12 < size; n += 1 + n / 50) /* cut in its very last number, 0.555000007, it holds a shorter one */
        refused(bytes, n, "");
    memcpy(bytes, "138", 3);
    refused(bytes, size, "cut off");
    memcpy(bytes, "1e99", 4);
    refused(bytes, size, "first line");
    memcpy(bytes, "nan ", 4);
    refused(bytes, size, "first line");
    free(bytes);
}

static void replay(void **state)
{
    (void)state;
    enum { SEEDS = 9, MUTANTS = 400 };
    static const lum_ray_format FORMATS[4] = {LUM_RAYS_ZEMAX, LUM_RAYS_LIGHTTOOLS, LUM_RAYS_ZEMAX_TEXT, LUM_RAYS_LIGHTTOOLS_TEXT};
    lum_rng rng = lum_rng_stream(2025, 1);
    for (int seed = 0; seed < SEEDS; ++seed) {
        size_t size;
        uint8_t *bytes;
        if (seed < 4) {
            bytes = written(FORMATS[seed], false, true, &size);
        } else {
            tm25_recipe r = PLAIN;
            r.rays = 7;
            r.tables = seed == 4 ? 0 : 2;
            r.table_points = 3;
            r.extra = seed == 5 ? 1 : 0;
            r.flags[6] = seed == 6;
            r.flags[7] = seed == 7;
            r.flags[2] = seed == 8;
            r.flags[4] = seed != 8;
            bytes = tm25_make(&r, &size);
        }
        assert_int_equal(LLVMFuzzerTestOneInput(bytes, size), 0);
        uint8_t *copy = malloc(size);
        for (int m = 0; m < MUTANTS; ++m) {
            memcpy(copy, bytes, size);
            const int changes = 1 + (int)(4 * lum_rng_next(&rng));
            for (int k = 0; k < changes; ++k) {
                /* headers and rays rather than the kilobytes of text between */
                size_t at = (size_t)(lum_rng_next(&rng) * (double)size);
                if (seed >= 4 && at >= 288 && at < 36288)
                    at = at % 288;
                copy[at] = lum_rng_next(&rng) < 0.5 ? (uint8_t)(256 * lum_rng_next(&rng)) : (uint8_t)(copy[at] ^ 1u << (at % 8));
            }
            const size_t cut = lum_rng_next(&rng) < 0.2 ? (size_t)(lum_rng_next(&rng) * (double)size) : size;
            LLVMFuzzerTestOneInput(copy, cut);
        }
        free(copy);
        free(bytes);
    }
}

/* ---------------------------------------------------------------------------------------------------------- real files */

static void real_files(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        lum_ray_format format;
        uint64_t rays;
        double flux; /* sum over the rays as stored */
    } FILES[] = {
        {"rayfile_LERTDUW_S2WP_green_100k_20161013_IES_TM25.TM25RAY", LUM_RAYS_TM25, 100000, 337},
        {"Cyl10k.1.tm25ray", LUM_RAYS_TM25, 10000, 10000},
        {"Cyl10k.1.ray", LUM_RAYS_LIGHTTOOLS_TEXT, 10000, 10000},
        {"ThreeRays_PowerOnly.1.ray", LUM_RAYS_LIGHTTOOLS, 3, 0.009319804},
        {"ThreeRays_Wavelength.1.ray", LUM_RAYS_LIGHTTOOLS, 3, 0.009319804},
        {"ThreeRays_Wavelength.1.txt", LUM_RAYS_LIGHTTOOLS_TEXT, 3, 0.009319804},
        {"ThreeRays_Wavelength_ZMW_to_LT.ray", LUM_RAYS_LIGHTTOOLS, 3, 0.009319804},
        {"ThreeRays_Wavelength_ZMX.ray", LUM_RAYS_ZEMAX, 3, 0.009319804},
        {"ZemaxText.txt", LUM_RAYS_ZEMAX_TEXT, 9, 138.865815},
        {"ZemaxWavelengthText.txt", LUM_RAYS_ZEMAX_TEXT, 9, 138.865815},
    };
    for (size_t i = 0; i < sizeof(FILES) / sizeof(FILES[0]); ++i) {
        char path[1024];
        snprintf(path, sizeof(path), "%s/rayfiles/%s", LUMIBOX_SHARED_DATA, FILES[i].name);
        if (access(path, R_OK) != 0) {
            print_message("skipped: no %s\n", path);
            continue;
        }
        lmg_error err = {{0}};
        lum_rayfile *file;
        if (lum_rayfile_open(path, LUM_RAY_STORED, &file, &err) != LMG_OK)
            fail_msg("%s", err.message);
        const lum_ray_info *info = lum_rayfile_info(file);
        assert_int_equal(info->format, FILES[i].format);
        assert_int_equal(info->rays, FILES[i].rays);
        lmg_ray *rays = malloc((size_t)info->rays * sizeof(*rays));
        read_all(file, 1, rays);
        double sum = 0;
        for (uint64_t k = 0; k < info->rays; ++k)
            sum += lmg_luminance(rays[k].flux);
        near(sum, FILES[i].flux, 1e-6 * FILES[i].flux);
        if (info->rays == 3) { /* the same three rays in all of these; six digits in the text */
            near(rays[1].origin.y, 0.8334215e-3, 1e-10);
            near(rays[1].direction.z, 0.75, 1e-6);
            if (info->has_wavelength)
                near((double)rays[2].wavelength, 620, 1e-3);
        }
        free(rays);
        lum_rayfile_close(file);
    }
}

static int setup(void **state)
{
    (void)state;
    return mkdtemp(folder) ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    return rmdir(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tm25_variants), cmocka_unit_test(unknown_totals), cmocka_unit_test(units),
        cmocka_unit_test(tristimulus),   cmocka_unit_test(round_trips),    cmocka_unit_test(long_text),
        cmocka_unit_test(bad_tm25),      cmocka_unit_test(bad_others),     cmocka_unit_test(replay),
        cmocka_unit_test(real_files),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
