/* SPDX-License-Identifier: Apache-2.0 */
/* Luminance pictures through OpenEXRCore. */
#include <luminaires/picture.h>

#include <math.h>
#include <openexr.h>
#include <stdlib.h>
#include <string.h>

static const char *const NAMES[4] = {"R", "G", "B", "Y"};

static void keep_quiet(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)context;
    (void)code;
    (void)message;
}

static exr_context_initializer_t quiet_context(void)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = keep_quiet;
    init.max_image_width = init.max_image_height = LUM_PICTURE_MAX_SIDE;
    return init;
}

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

/* Where a channel's values are in the picture's memory, first row y; NULL for a channel that isn't ours. */
static uint8_t *place_of(const lum_picture *picture, const char *channel, int y)
{
    for (int k = 0; k < 4; ++k)
        if (!strcmp(channel, NAMES[k]))
            return (uint8_t *)(picture->rgb + 3 * (size_t)y * picture->width + (k < 3 ? k : 0));
    return NULL;
}

static void lay_out(exr_coding_channel_info_t *c, const lum_picture *picture)
{
    c->user_bytes_per_element = sizeof(float);
    c->user_data_type = EXR_PIXEL_FLOAT;
    c->user_pixel_stride = 3 * sizeof(float);
    c->user_line_stride = (int32_t)(3 * sizeof(float) * picture->width);
}

lmg_result lum_picture_write(const lum_picture *picture, const char *path, lmg_error *err)
{
    exr_context_initializer_t init = quiet_context();
    exr_context_t file = NULL;
    exr_result_t r = exr_start_write(&file, path, EXR_WRITE_FILE_DIRECTLY, &init);
    if (r)
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written: %s", path, exr_get_default_error_message(r));
    int part;
    int32_t lines = 1;
    r = exr_add_part(file, "luminance", EXR_STORAGE_SCANLINE, &part);
    r = r ? r : exr_initialize_required_attr_simple(file, part, (int32_t)picture->width, (int32_t)picture->height, EXR_COMPRESSION_ZIP);
    for (int k = picture->colour ? 0 : 3; !r && k < (picture->colour ? 3 : 4); ++k)
        r = exr_add_channel(file, part, NAMES[k], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    r = r ? r : exr_attr_set_string(file, part, "software", "Lumibox " LMG_VERSION_STRING);
    r = r ? r : exr_write_header(file);
    r = r ? r : exr_get_scanlines_per_chunk(file, part, &lines);
    for (int y = 0; !r && y < (int)picture->height; y += lines) {
        exr_chunk_info_t chunk;
        exr_encode_pipeline_t pipeline = EXR_ENCODE_PIPELINE_INITIALIZER;
        r = exr_write_scanline_chunk_info(file, part, y, &chunk);
        r = r ? r : exr_encoding_initialize(file, part, &chunk, &pipeline);
        for (int i = 0; !r && i < pipeline.channel_count; ++i) {
            pipeline.channels[i].encode_from_ptr = place_of(picture, pipeline.channels[i].channel_name, y);
            lay_out(&pipeline.channels[i], picture);
        }
        r = r ? r : exr_encoding_choose_default_routines(file, part, &pipeline);
        r = r ? r : exr_encoding_run(file, part, &pipeline);
        exr_encoding_destroy(file, &pipeline);
    }
    const exr_result_t closed = exr_finish(&file);
    r = r ? r : closed;
    return r ? lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't be written: %s", path, exr_get_default_error_message(r)) : LMG_OK;
}

/* Size and channels of the file: R, G, B, or Y. */
static exr_result_t check_header(exr_context_t file, exr_attr_box2i_t *window, bool *colour)
{
    int parts = 0;
    exr_storage_t storage = EXR_STORAGE_LAST_TYPE;
    const exr_attr_chlist_t *channels = NULL;
    exr_result_t r = exr_get_count(file, &parts);
    r = r ? r : exr_get_storage(file, 0, &storage);
    r = r ? r : exr_get_data_window(file, 0, window);
    r = r ? r : exr_get_channels(file, 0, &channels);
    if (r || parts != 1 || storage != EXR_STORAGE_SCANLINE)
        return r ? r : EXR_ERR_BAD_CHUNK_LEADER;
    int found[4] = {0};
    for (int i = 0; i < channels->num_channels; ++i)
        for (int k = 0; k < 4; ++k)
            found[k] += !strcmp(channels->entries[i].name.str, NAMES[k]) && channels->entries[i].x_sampling == 1 &&
                        channels->entries[i].y_sampling == 1;
    *colour = found[0] && found[1] && found[2];
    return *colour || found[3] ? EXR_ERR_SUCCESS : EXR_ERR_MISSING_REQ_ATTR;
}

static exr_result_t read_rows(exr_context_t file, const lum_picture *picture, int first)
{
    int32_t lines = 0;
    exr_result_t r = exr_get_scanlines_per_chunk(file, 0, &lines);
    if (!r && lines < 1)
        r = EXR_ERR_BAD_CHUNK_LEADER;
    for (int y = 0; !r && y < (int)picture->height; y += lines) {
        exr_chunk_info_t chunk;
        exr_decode_pipeline_t pipeline = EXR_DECODE_PIPELINE_INITIALIZER;
        r = exr_read_scanline_chunk_info(file, 0, first + y, &chunk);
        if (!r && (chunk.start_y != first + y || chunk.width != (int32_t)picture->width || chunk.height < 1 ||
                   chunk.height > (int32_t)picture->height - y))
            r = EXR_ERR_BAD_CHUNK_LEADER;
        r = r ? r : exr_decoding_initialize(file, 0, &chunk, &pipeline);
        for (int i = 0; !r && i < pipeline.channel_count; ++i) {
            exr_coding_channel_info_t *c = &pipeline.channels[i];
            const bool luminance = !strcmp(c->channel_name, "Y");
            c->decode_to_ptr = luminance == picture->colour ? NULL : place_of(picture, c->channel_name, y);
            if (c->decode_to_ptr)
                lay_out(c, picture);
        }
        r = r ? r : exr_decoding_choose_default_routines(file, 0, &pipeline);
        r = r ? r : exr_decoding_run(file, 0, &pipeline);
        exr_decoding_destroy(file, &pipeline);
    }
    return r;
}

lmg_result lum_picture_read(const char *path, lum_picture *picture, lmg_error *err)
{
    exr_context_initializer_t init = quiet_context();
    exr_context_t file = NULL;
    exr_result_t r = exr_start_read(&file, path, &init);
    if (r)
        return lmg_fail(err, r == EXR_ERR_FILE_ACCESS ? LMG_ERROR_FILE_OPEN : LMG_ERROR_FILE_FORMAT, "%s: %s", path,
                        r == EXR_ERR_FILE_ACCESS ? "can't be opened" : "isn't an OpenEXR file that can be read");
    exr_attr_box2i_t window;
    memset(&window, 0, sizeof(window));
    bool colour = false;
    lmg_result result = LMG_OK;
    if (check_header(file, &window, &colour))
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: isn't a picture in scan lines with channels R, G, B or Y", path);
    const int64_t width = (int64_t)window.max.x - window.min.x + 1, height = (int64_t)window.max.y - window.min.y + 1;
    if (result == LMG_OK && (width < 1 || height < 1 || width > LUM_PICTURE_MAX_SIDE || height > LUM_PICTURE_MAX_SIDE))
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: a picture of %lld x %lld pixels", path, (long long)width, (long long)height);
    if (result == LMG_OK && (!picture->rgb || picture->width != width || picture->height != height)) {
        lum_picture_free(picture);
        result = lum_picture_create((uint32_t)width, (uint32_t)height, picture, err);
    }
    if (result == LMG_OK) {
        picture->colour = colour;
        r = read_rows(file, picture, window.min.y);
        if (r)
            result = lmg_fail(err, LMG_ERROR_FILE_READ, "%s: damaged or cut off: %s", path, exr_get_default_error_message(r));
    }
    exr_finish(&file);
    const size_t pixels = result == LMG_OK ? (size_t)width * (size_t)height : 0;
    for (size_t i = 0; i < pixels; ++i) {
        float *rgb = &picture->rgb[3 * i];
        if (!colour)
            rgb[1] = rgb[2] = rgb[0];
        const double y = lmg_luminance(rgb);
        if (!isfinite(y) || y < 0)
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: pixel (%zu, %zu) is %g", path, i % (size_t)width, i / (size_t)width, y);
    }
    return result;
}
