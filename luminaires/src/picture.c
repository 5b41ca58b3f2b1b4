/* SPDX-License-Identifier: Apache-2.0 */
/* Luminance pictures through OpenEXRCore. */
#include <luminaires/picture.h>

#include <luminaires/scanlines.h>

#include <math.h>
#include <stdlib.h>

lmg_result lum_picture_create(uint32_t width, uint32_t height, lum_picture *out, lmg_error *err)
{
    *out = (lum_picture){0};
    if (width < 1 || height < 1 || width > LUM_PICTURE_MAX_SIDE || height > LUM_PICTURE_MAX_SIDE)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a picture of %u x %u pixels", width, height);
    float *rgb = calloc((size_t)width * height, 3 * sizeof(*rgb));
    if (!rgb)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a picture of %u x %u pixels", width, height);
    *out = (lum_picture){.width = width, .height = height, .rgb = rgb};
    return LMG_OK;
}

void lum_picture_free(lum_picture *picture)
{
    free(picture->rgb);
    *picture = (lum_picture){0};
}

enum { COLOURS = 3, CHANNELS };

/* R, G, B, and Y, which stands where R would. */
static void channels_of(const lum_picture *picture, lum_channel channels[CHANNELS])
{
    static const char *const NAMES[CHANNELS] = {"R", "G", "B", "Y"};
    for (int k = 0; k < CHANNELS; ++k)
        channels[k] = (lum_channel){.name = NAMES[k], .values = picture->rgb + (k < COLOURS ? k : 0), .stride = COLOURS};
}

lmg_result lum_picture_write(const lum_picture *picture, const char *path, lmg_error *err)
{
    const exr_context_initializer_t init = lum_scanlines_settings(LUM_PICTURE_MAX_SIDE);
    lum_channel all[CHANNELS];
    channels_of(picture, all);
    const lum_channel *channels = picture->colour ? all : &all[COLOURS];
    const uint32_t count = picture->colour ? COLOURS : 1;
    exr_context_t file = NULL;
    exr_result_t r = exr_start_write(&file, path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (r)
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written: %s", path, exr_get_default_error_message(r));
    r = lum_scanlines_add_part(file, "luminance", picture->width, picture->height, channels, count);
    r = r ? r : exr_attr_set_string(file, 0, "software", "Lumibox " LMG_VERSION_STRING);
    r = r ? r : exr_write_header(file);
    r = r ? r : lum_scanlines_write(file, picture->width, picture->height, channels, count);
    const exr_result_t closed = exr_finish(&file);
    r = r ? r : closed;
    return r ? lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written: %s", path, exr_get_default_error_message(r)) : LMG_OK;
}

/* A grey picture has Y only: spreads it.  Errors: a value that no light has. */
static lmg_result finish(lum_picture *picture, const char *path, lmg_error *err)
{
    for (size_t i = 0; i < (size_t)picture->width * picture->height; ++i) {
        float *rgb = &picture->rgb[COLOURS * i];
        if (!picture->colour)
            rgb[1] = rgb[2] = rgb[0];
        const double y = lmg_luminance(rgb);
        if (!isfinite(y) || y < 0)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: pixel (%zu, %zu) is %g", path, i % picture->width, i / picture->width,
                            y);
    }
    return LMG_OK;
}

lmg_result lum_picture_read(const char *path, lum_picture *picture, lmg_error *err)
{
    exr_context_t file = NULL;
    uint32_t width, height;
    lmg_result result = lum_scanlines_open(path, LUM_PICTURE_MAX_SIDE, &file, &width, &height, err);
    if (result != LMG_OK)
        return result;
    const bool colour = lum_scanlines_has(file, "R") && lum_scanlines_has(file, "G") && lum_scanlines_has(file, "B");
    if (!colour && !lum_scanlines_has(file, "Y"))
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: has neither channels R, G, B nor Y", path);
    if (result == LMG_OK && (!picture->rgb || picture->width != width || picture->height != height)) {
        lum_picture_free(picture);
        result = lum_picture_create(width, height, picture, err);
    }
    if (result == LMG_OK) {
        lum_channel all[CHANNELS];
        picture->colour = colour;
        channels_of(picture, all);
        result = lum_scanlines_read(file, path, width, height, colour ? all : &all[COLOURS], colour ? COLOURS : 1, err);
    }
    exr_finish(&file);
    return result == LMG_OK ? finish(picture, path, err) : result;
}
