/* SPDX-License-Identifier: Apache-2.0 */
/* Exact tests of the viewer's parts: placements, cameras, tone curve, picture files, differences of pictures. */
#include "image_diff.h"
#include "image_io.h"
#include "placement.h"
#include "tonemap.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <luminaires/rng.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static void near(double a, double b, double tolerance)
{
    if (!(fabs(a - b) <= tolerance)) {
        fail_msg("%.17g is not %.17g +- %g", a, b, tolerance);
    }
}

/* ----------------------------------------------------------------------------------------------------------- placement */

static void placements_are_parsed_from_the_right(void **state)
{
    (void)state;
    view_placement p;
    char path[64];
    lmg_error err;
    assert_int_equal(view_placement_parse("a@b,1,2@x.box.exr@1.5,-2e-1,+3", &p, path, sizeof path, &err), LMG_OK);
    assert_string_equal(path, "a@b,1,2@x.box.exr");
    near(p.position.x, 1.5, 0);
    near(p.position.y, -0.2, 0);
    near(p.position.z, 3, 0);
    near(p.rx, 0, 0);
    near(p.ry, 0, 0);
    assert_int_equal(view_placement_parse("lamp@1,2,3,45", &p, path, sizeof path, &err), LMG_OK);
    near(p.ry, 45, 0);
    near(p.rx, 0, 0);
    assert_int_equal(view_placement_parse("lamp@1,2,3,10,20,-30", &p, path, sizeof path, &err), LMG_OK);
    near(p.rx, 10, 0);
    near(p.ry, 20, 0);
    near(p.rz, -30, 0);
    static const char *const BAD[] = {
        "lamp",        "lamp@",      "@1,2,3",        "lamp@1,2",     "lamp@1,2,3,4,5", "lamp@1,2,3,4,5,6,7",
        "lamp@1,2,x",  "lamp@1,,3",  "lamp@1,2,3 ",   "lamp@nan,2,3", "lamp@1,inf,3",   "lamp@1,2,3,",
        "lamp@ 1,2,3", "lamp@1;2;3", "lamp@1e999,0,0"};
    for (size_t i = 0; i < sizeof BAD / sizeof BAD[0]; i++) {
        err.message[0] = '\0';
        assert_int_equal(view_placement_parse(BAD[i], &p, path, sizeof path, &err), LMG_ERROR_ARGUMENT);
        assert_true(err.message[0] && !strchr(err.message, '\n'));
    }
    char longer[200];
    memset(longer, 'a', sizeof longer);
    strcpy(longer + 100, "@1,2,3");
    assert_int_equal(view_placement_parse(longer, &p, path, sizeof path, &err), LMG_ERROR_ARGUMENT);
}

static void turn(double rx, double ry, double rz, lmg_vec3 own, lmg_vec3 wanted, double tolerance)
{
    view_placement p = {.position = {10, 20, 30}, .rx = rx, .ry = ry, .rz = rz};
    view_motion m;
    view_placement_motion(&p, &m);
    lmg_vec3 d = view_direction_out(&m, own), back = view_direction_in(&m, d), at = view_point_out(&m, own),
             home = view_point_in(&m, at);
    near(d.x, wanted.x, tolerance);
    near(d.y, wanted.y, tolerance);
    near(d.z, wanted.z, tolerance);
    /* The inverse, to a few roundings of numbers up to 30. */
    near(back.x, own.x, 1e-15);
    near(home.x, own.x, 1e-14);
    near(home.y, own.y, 1e-14);
    near(home.z, own.z, 1e-14);
    near(at.x, 10 + wanted.x, 1e-14);
}

static void rotations_are_right_handed_about_x_then_y_then_z(void **state)
{
    (void)state;
    const lmg_vec3 x = {1, 0, 0}, y = {0, 1, 0}, z = {0, 0, 1};
    turn(90, 0, 0, y, z, 0); /* quarter turns are exact */
    turn(90, 0, 0, z, (lmg_vec3){0, -1, 0}, 0);
    turn(0, 90, 0, z, x, 0);
    turn(0, -270, 0, z, x, 0);
    turn(0, 0, 90, x, y, 0);
    turn(90, 90, 0, y, x, 0);  /* x first: y -> z, then z -> x */
    turn(90, 90, 90, y, y, 0); /* ... and then x -> y */
    turn(0, 30, 0, x, (lmg_vec3){sqrt(0.75), 0, -0.5}, 1e-15);
    turn(360, 720, -360, (lmg_vec3){0.3, 0.4, 0.5}, (lmg_vec3){0.3, 0.4, 0.5}, 0);
}

static void cameras_look_where_they_should(void **state)
{
    (void)state;
    view_camera c;
    lmg_error err;
    assert_int_equal(view_camera_set(&c, (lmg_vec3){1, 2, 3}, (lmg_vec3){0, 0, -2}, (lmg_vec3){0, 1, 0}, VIEW_PI / 2, &err),
                     LMG_OK);
    lmg_vec3 d = view_camera_direction(&c, 50, 25, 100, 50); /* the middle */
    near(d.z, -1, 1e-15);
    d = view_camera_direction(&c, 50, 0, 100, 50); /* top: 45 degrees up */
    near(d.y, sqrt(0.5), 1e-15);
    d = view_camera_direction(&c, 100, 25, 100, 50); /* right edge: twice as far in tangents */
    near(d.x / -d.z, 2, 1e-15);
    /* Straight down works, whatever the roll. */
    assert_int_equal(view_camera_set(&c, (lmg_vec3){0}, (lmg_vec3){0, -1, 0}, (lmg_vec3){0, 1, 0}, 1, &err), LMG_OK);
    near(view_length(c.right), 1, 1e-15);
    near(view_dot(c.right, c.forward), 0, 1e-15);
    assert_int_equal(view_camera_set(&c, (lmg_vec3){0}, (lmg_vec3){0, 0, 0}, (lmg_vec3){0, 1, 0}, 1, &err), LMG_ERROR_ARGUMENT);
    assert_int_equal(view_camera_set(&c, (lmg_vec3){0}, (lmg_vec3){0, 0, 1}, (lmg_vec3){0, 1, 0}, 4, &err), LMG_ERROR_ARGUMENT);
}

/* ---------------------------------------------------------------------------------------------------------- tone curve */

static void tone_curve_is_smooth_and_keeps_hues(void **state)
{
    (void)state;
    near(view_tone_curve(0.18), 0.18, 0);
    near(view_tone_curve(0.4), 0.4, 0);
    near(view_tone_curve(-1), 0, 0);
    near(view_tone_curve((double)NAN), 0, 0);
    /* White at z = 32, that is x = 0.4 + 0.6 * 32 = 19.6. */
    near(view_tone_curve(19.6), 1, 1e-15);
    near(view_tone_curve(1e9), 1, 0);
    double previous = 0;
    for (double x = 1e-3; x < 25; x *= 1.01) {
        double y = view_tone_curve(x);
        assert_true(y > previous || y == 1);
        previous = y;
    }
    /* Equal slopes at the knee, to the second order of the step. */
    near((view_tone_curve(0.4 + 1e-4) - 0.4) / 1e-4, 1, 1e-3);

    lum_rng rng = lum_rng_stream(3, 3);
    for (int i = 0; i < 10000; i++) {
        double scale = exp(12 * (lum_rng_next(&rng) - 0.5));
        float rgb[3];
        for (int c = 0; c < 3; c++) {
            rgb[c] = (float)(scale * (lum_rng_next(&rng) * 1.2 - 0.2)); /* negative components happen: colours outside of Rec.709 */
        }
        double out[3], y = lmg_luminance(rgb);
        view_tone_color(rgb, 1, out);
        double shown = 0.2126 * out[0] + 0.7152 * out[1] + 0.0722 * out[2];
        assert_true(out[0] >= 0 && out[1] >= 0 && out[2] >= 0 && out[0] <= 1 && out[1] <= 1 && out[2] <= 1);
        near(shown, view_tone_curve(y * 0.18), 1e-12);
        /* Differences of components keep their ratios: the hue stays. */
        if (y > 0) {
            double before = ((double)rgb[0] - (double)rgb[1]) * (out[1] - out[2]),
                   after = ((double)rgb[1] - (double)rgb[2]) * (out[0] - out[1]);
            near(before, after, 1e-12 * scale);
        }
    }
    near(view_exposure_to_ev(view_exposure_from_ev(7.3)), 7.3, 1e-14);
    near(view_exposure_from_ev(10), 128, 0);
    near(view_srgb(0), 0, 0);
    near(view_srgb(1), 1, 1e-15);
    near(view_srgb(0.5), 0.735356983052, 1e-11); /* IEC 61966-2-1 */
}

/* ------------------------------------------------------------------------------------------------------------ pictures */

static view_image noise_picture(uint32_t width, uint32_t height, uint64_t seed)
{
    view_image image;
    lmg_error err;
    assert_int_equal(view_image_create(width, height, &image, &err), LMG_OK);
    lum_rng rng = lum_rng_stream(seed, 1);
    for (size_t i = 0; i < (size_t)width * height; i++) {
        for (size_t c = 0; c < 3; c++) {
            image.rgb[3 * i + c] = (float)exp(20 * (lum_rng_next(&rng) - 0.5));
        }
        image.standard_error[i] = (float)lum_rng_next(&rng);
    }
    image.rgb[0] = -1.5f;
    image.rgb[1] = 0;
    image.rgb[2] = 3e38f;
    return image;
}

static void exr_round_trip(void **state)
{
    (void)state;
    static const uint32_t SIZE[][2] = {{1, 1}, {37, 53}, {64, 16}, {3, 200}};
    char folder[] = "/tmp/lumibox-exr-XXXXXX", path[64];
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/picture.exr", folder);
    for (size_t i = 0; i < sizeof SIZE / sizeof SIZE[0]; i++) {
        view_image image = noise_picture(SIZE[i][0], SIZE[i][1], i), again;
        view_image_notes notes = {.samples = 17,
                                  .seconds = 2.25,
                                  .seed = UINT64_MAX,
                                  .mid_grey = 12.5,
                                  .command = "lumiview render 'a b'"},
                         back;
        lmg_error err = {""};
        assert_int_equal(view_write_exr(&image, &notes, path, &err), LMG_OK);
        assert_int_equal(view_read_exr(path, &again, &back, &err), LMG_OK);
        assert_int_equal(again.width, image.width);
        assert_int_equal(again.height, image.height);
        size_t pixels = (size_t)image.width * image.height;
        assert_memory_equal(again.rgb, image.rgb, pixels * 3 * sizeof(float));
        assert_memory_equal(again.standard_error, image.standard_error, pixels * sizeof(float));
        assert_int_equal(back.samples, 17);
        near(back.seconds, 2.25, 0);
        assert_true(back.seed == UINT64_MAX);
        near(back.mid_grey, 12.5, 0);
        view_image_free(&again);

        /* Cut off anywhere: an error, never a picture and never a crash. */
        FILE *file = fopen(path, "rb");
        assert_non_null(file);
        static char bytes[1 << 20];
        size_t size = fread(bytes, 1, sizeof bytes, file);
        fclose(file);
        for (size_t length = 0; length < size; length += 1 + length / 7) {
            file = fopen(path, "wb");
            assert_non_null(file);
            fwrite(bytes, 1, length, file);
            fclose(file);
            lmg_result r = view_read_exr(path, &again, NULL, &err);
            assert_true(r == LMG_ERROR_FILE_FORMAT || r == LMG_ERROR_FILE_READ || r == LMG_ERROR_FILE_OPEN);
            assert_true(strstr(err.message, path) == err.message && !strchr(err.message, '\n'));
            assert_null(again.rgb);
        }
        view_image_free(&image);
    }
    lmg_error err;
    view_image none;
    unlink(path);
    assert_int_equal(view_read_exr(path, &none, NULL, &err), LMG_ERROR_FILE_OPEN);
    rmdir(folder);
    /* Nowhere to write. */
    view_image image = noise_picture(2, 2, 1);
    view_image_notes notes = {0};
    assert_int_equal(view_write_exr(&image, &notes, path, &err), LMG_ERROR_FILE_OPEN);
    view_image_free(&image);
}

static void differences_tell_noise_apart(void **state)
{
    (void)state;
    view_image a, b;
    lmg_error err;
    assert_int_equal(view_image_create(256, 192, &a, &err), LMG_OK);
    assert_int_equal(view_image_create(256, 192, &b, &err), LMG_OK);
    /* b is 10 everywhere, a is 3 % more in every second column pair and 3 % less in the others; both with noise of 0.5 and 0.4. */
    lum_rng rng = lum_rng_stream(9, 9);
    for (size_t i = 0; i < 256 * 192; i++) {
        double na = 0, nb = 0;
        for (int k = 0; k < 12; k++) {
            na += lum_rng_next(&rng) - 0.5;
            nb += lum_rng_next(&rng) - 0.5; /* sums of 12 uniform numbers: variance 1 */
        }
        double va = 10 * (1 + (i & 2 ? 0.03 : -0.03)) + 0.5 * na, vb = 10 + 0.4 * nb;
        for (size_t c = 0; c < 3; c++) {
            a.rgb[3 * i + c] = (float)va;
            b.rgb[3 * i + c] = (float)vb;
        }
        a.standard_error[i] = 0.5f;
        b.standard_error[i] = 0.4f;
    }
    view_diff d;
    view_diff_options options = {.block = 2};
    /* Blocks of 2 x 2: halves the noise, keeps the stripes (columns 0,1 | 2,3 ...). */
    assert_int_equal(view_image_diff(&a, &b, &options, &d, &err), LMG_OK);
    assert_int_equal(d.blocks, 128 * 96);
    near(d.noise, hypot(0.5, 0.4) / 2 / d.mean_b, 1e-8);
    /* rmse_clean^2 has a standard error of rmse_clean_se^2; 4 of them. */
    near(d.rmse_clean * d.rmse_clean, 0.03 * 0.03, 4 * d.rmse_clean_se * d.rmse_clean_se);
    assert_true(d.rmse_clean_se < 0.01);
    near(d.mean_a, 10, 4 * d.mean_a_se);
    near(d.mean_a_se, 0.5 / sqrt(256 * 192), 1e-8);

    /* A single very bright block is left out by the limit. */
    for (size_t c = 0; c < 12; c++) {
        a.rgb[c] = 1e6f;
    }
    options.limit = 10;
    assert_int_equal(view_image_diff(&a, &b, &options, &d, &err), LMG_OK);
    assert_true(d.left_out == 2 && d.blocks == 128 * 96 - 2);
    near(d.rmse_clean, 0.03, 0.003);

    uint8_t *bytes = malloc(3 * 256 * 192);
    assert_non_null(bytes);
    view_diff_picture(&b, &b, 1, 0.1, bytes);
    for (size_t i = 0; i < 3 * 256 * 192; i++) {
        assert_int_equal(bytes[i], 255);
    }
    view_diff_picture(&a, &b, 2, 0.01, bytes);
    assert_true(bytes[0] > bytes[2]); /* far brighter: red */
    /* 3 % less with a noise of 3.2 %: nothing to be seen; known exactly: blue. */
    size_t dark = 3 * (256 * 10 + 4), pixels = 256 * 192;
    for (size_t i = 0; i < pixels; i++) {
        for (size_t c = 0; c < 3; c++) {
            b.rgb[3 * i + c] = 10;
            a.rgb[3 * i + c] = i & 2 ? 10.3f : 9.7f;
        }
    }
    view_diff_picture(&a, &b, 2, 0.01, bytes);
    assert_true(bytes[dark] == 255 && bytes[dark + 1] == 255 && bytes[dark + 2] == 255);
    memset(a.standard_error, 0, pixels * sizeof(float));
    memset(b.standard_error, 0, pixels * sizeof(float));
    view_diff_picture(&a, &b, 2, 0.01, bytes);
    assert_true(bytes[dark] < bytes[dark + 2]);
    assert_true(bytes[dark + 6] > bytes[dark + 8]);
    free(bytes);
    view_image small;
    assert_int_equal(view_image_create(256, 191, &small, &err), LMG_OK);
    assert_int_equal(view_image_diff(&a, &small, &options, &d, &err), LMG_ERROR_INPUT);
    view_image_free(&small);
    view_image_free(&a);
    view_image_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(placements_are_parsed_from_the_right),
        cmocka_unit_test(rotations_are_right_handed_about_x_then_y_then_z),
        cmocka_unit_test(cameras_look_where_they_should),
        cmocka_unit_test(tone_curve_is_smooth_and_keeps_hues),
        cmocka_unit_test(exr_round_trip),
        cmocka_unit_test(differences_tell_noise_apart),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
