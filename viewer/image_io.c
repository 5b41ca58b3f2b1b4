/* SPDX-License-Identifier: Apache-2.0 */
/* EXR through OpenEXRCore, PNG through libpng's simplified interface. */
#include "image_io.h"

#include <luminaires/scanlines.h>

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* ------------------------------------------------------------------------------------------- temporary name and rename */

enum { PATH_SIZE = 4096 };

/* A new, empty file beside path, whose name goes to name; its permissions are those that a plain new file would get. */
static lmg_result temporary_create(const char *path, char name[PATH_SIZE], lmg_error *err)
{
    if (snprintf(name, PATH_SIZE, "%s.XXXXXX", path) >= PATH_SIZE) {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%.200s...: the name is too long", path);
    }
    int file = mkstemp(name);
    if (file < 0) {
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: can't write there: %s", path, strerror(errno));
    }
    mode_t mask = umask(0);
    umask(mask);
    fchmod(file, 0666 & ~mask);
    close(file);
    return LMG_OK;
}

static lmg_result temporary_rename(const char *name, const char *path, lmg_error *err)
{
    if (rename(name, path) != 0) {
        int reason = errno;
        unlink(name);
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't put the finished file in place: %s", path, strerror(reason));
    }
    return LMG_OK;
}

/* ----------------------------------------------------------------------------------------------------------------- EXR */

enum { CHANNELS = 4 };

static void channels_of(const view_image *image, lum_channel channels[CHANNELS])
{
    static const char *const NAMES[3] = {"R", "G", "B"};
    for (int k = 0; k < 3; k++) {
        channels[k] = (lum_channel){.name = NAMES[k], .values = image->rgb + k, .stride = 3};
    }
    channels[3] = (lum_channel){.name = "stderr.Y", .values = image->standard_error, .stride = 1};
}

static exr_result_t write_header(exr_context_t file, const view_image *image, const lum_channel channels[CHANNELS],
                                 const view_image_notes *notes)
{
    /* Rec.709 primaries and D65, and what R=G=B=1 means: 1 cd/m2. */
    static const exr_attr_chromaticities_t REC709 = {0.64f, 0.33f, 0.30f, 0.60f, 0.15f, 0.06f, 0.3127f, 0.3290f};
    char seed[24];
    snprintf(seed, sizeof seed, "%" PRIu64, notes->seed);
    exr_result_t r = lum_scanlines_add_part(file, "picture", image->width, image->height, channels, CHANNELS);
    r = r ? r : exr_attr_set_chromaticities(file, 0, "chromaticities", &REC709);
    r = r ? r : exr_attr_set_float(file, 0, "whiteLuminance", 1.0f);
    r = r ? r : exr_attr_set_string(file, 0, "software", "lumiview " LMG_VERSION_STRING);
    r = r ? r : exr_attr_set_int(file, 0, "spp", notes->samples > INT32_MAX ? INT32_MAX : (int32_t)notes->samples);
    r = r ? r : exr_attr_set_double(file, 0, "renderSeconds", notes->seconds);
    r = r ? r : exr_attr_set_string(file, 0, "seed", seed);
    if (notes->mid_grey > 0) {
        r = r ? r : exr_attr_set_double(file, 0, "midGrey", notes->mid_grey);
    }
    if (notes->command) {
        r = r ? r : exr_attr_set_string(file, 0, "command", notes->command);
    }
    return r ? r : exr_write_header(file);
}

lmg_result view_write_exr(const view_image *image, const view_image_notes *notes, const char *path, lmg_error *err)
{
    char name[PATH_SIZE];
    lmg_result result = temporary_create(path, name, err);
    if (result != LMG_OK) {
        return result;
    }
    const exr_context_initializer_t init = lum_scanlines_settings(VIEW_MAX_SIDE);
    lum_channel channels[CHANNELS];
    channels_of(image, channels);
    exr_context_t file = NULL;
    exr_result_t r = exr_start_write(&file, name, EXR_WRITE_FILE_DIRECTLY, &init);
    if (!r) {
        r = write_header(file, image, channels, notes);
        r = r ? r : lum_scanlines_write(file, image->width, image->height, channels, CHANNELS);
        exr_result_t closed = exr_finish(&file);
        r = r ? r : closed;
    }
    if (r) {
        unlink(name);
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't write the picture: %s", path, exr_get_default_error_message(r));
    }
    return temporary_rename(name, path, err);
}

static void read_notes(exr_context_t file, view_image_notes *notes)
{
    int32_t samples = 0, length = 0;
    const char *seed = NULL;
    *notes = (view_image_notes){0};
    if (!exr_attr_get_int(file, 0, "spp", &samples) && samples > 0) {
        notes->samples = (uint32_t)samples;
    }
    if (exr_attr_get_double(file, 0, "renderSeconds", &notes->seconds) || !isfinite(notes->seconds)) {
        notes->seconds = 0;
    }
    if (exr_attr_get_double(file, 0, "midGrey", &notes->mid_grey) || !(notes->mid_grey > 0 && isfinite(notes->mid_grey))) {
        notes->mid_grey = 0;
    }
    if (!exr_attr_get_string(file, 0, "seed", &length, &seed) && seed && length > 0 && length < 24) {
        char text[24] = "";
        memcpy(text, seed, (size_t)length);
        notes->seed = strtoull(text, NULL, 10);
    }
}

lmg_result view_read_exr(const char *path, view_image *out, view_image_notes *notes, lmg_error *err)
{
    *out = (view_image){0};
    exr_context_t file = NULL;
    uint32_t width, height;
    lmg_result result = lum_scanlines_open(path, VIEW_MAX_SIDE, &file, &width, &height, err);
    if (result != LMG_OK) {
        return result;
    }
    if (!lum_scanlines_has(file, "R") || !lum_scanlines_has(file, "G") || !lum_scanlines_has(file, "B")) {
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: has no channels R, G, B", path);
        goto cleanup;
    }
    result = view_image_create(width, height, out, err);
    if (result != LMG_OK) {
        goto cleanup;
    }
    for (size_t i = 0; i < (size_t)width * height; i++) {
        out->standard_error[i] = NAN;
    }
    lum_channel channels[CHANNELS];
    channels_of(out, channels);
    result = lum_scanlines_read(file, path, width, height, channels, CHANNELS, err);
    if (result == LMG_OK && notes) {
        read_notes(file, notes);
    }
cleanup:
    exr_finish(&file);
    if (result != LMG_OK) {
        view_image_free(out);
    }
    return result;
}

/* ----------------------------------------------------------------------------------------------------------------- PNG */

lmg_result view_write_png(const uint8_t *bytes, uint32_t width, uint32_t height, const char *path, lmg_error *err)
{
    char name[PATH_SIZE];
    lmg_result result = temporary_create(path, name, err);
    if (result != LMG_OK) {
        return result;
    }
    FILE *file = fopen(name, "wb");
    if (!file) {
        int reason = errno;
        unlink(name);
        return lmg_fail(err, LMG_ERROR_FILE_OPEN, "%s: can't write there: %s", path, strerror(reason));
    }
    png_image image = {.version = PNG_IMAGE_VERSION, .width = width, .height = height, .format = PNG_FORMAT_RGB};
    bool good = png_image_write_to_stdio(&image, file, 0, bytes, 0, NULL) != 0;
    good = fclose(file) == 0 && good;
    if (!good) {
        unlink(name);
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't write the picture: %s", path,
                        image.message[0] ? image.message : "the disk may be full");
    }
    return temporary_rename(name, path, err);
}
