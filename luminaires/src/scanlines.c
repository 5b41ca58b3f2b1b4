/* SPDX-License-Identifier: Apache-2.0 */
#include <luminaires/scanlines.h>

#include <string.h>

/* OpenEXRCore would print its errors; ours go to the caller. */
static void keep_quiet(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)context;
    (void)code;
    (void)message;
}

exr_context_initializer_t lum_scanlines_settings(uint32_t max_side)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = keep_quiet;
    init.max_image_width = init.max_image_height = (int)max_side;
    return init;
}

/* Points the channels of a coding pipeline at memory, from row y on; those that aren't wanted are skipped. */
static void point_at(exr_coding_channel_info_t *coded, int coded_count, const lum_channel *channels, uint32_t count, uint32_t width,
                     uint32_t y, bool reading)
{
    for (int i = 0; i < coded_count; ++i) {
        exr_coding_channel_info_t *c = &coded[i];
        c->decode_to_ptr = NULL;
        for (uint32_t k = 0; k < count; ++k) {
            if (strcmp(c->channel_name, channels[k].name) != 0 || c->x_samples != 1 || c->y_samples != 1)
                continue;
            uint8_t *row = (uint8_t *)(channels[k].values + (size_t)channels[k].stride * width * y);
            if (reading)
                c->decode_to_ptr = row;
            else
                c->encode_from_ptr = row;
            c->user_bytes_per_element = sizeof(float);
            c->user_data_type = EXR_PIXEL_FLOAT;
            c->user_pixel_stride = (int32_t)(channels[k].stride * sizeof(float));
            c->user_line_stride = (int32_t)(channels[k].stride * sizeof(float) * width);
        }
    }
}

exr_result_t lum_scanlines_add_part(exr_context_t file, const char *name, uint32_t width, uint32_t height,
                                    const lum_channel *channels, uint32_t count)
{
    int part;
    exr_result_t r = exr_add_part(file, name, EXR_STORAGE_SCANLINE, &part);
    r = r ? r : exr_initialize_required_attr_simple(file, part, (int32_t)width, (int32_t)height, EXR_COMPRESSION_ZIP);
    for (uint32_t k = 0; k < count && !r; ++k)
        r = exr_add_channel(file, part, channels[k].name, EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    return r;
}

exr_result_t lum_scanlines_write(exr_context_t file, uint32_t width, uint32_t height, const lum_channel *channels, uint32_t count)
{
    int32_t lines = 0;
    exr_encode_pipeline_t pipeline = EXR_ENCODE_PIPELINE_INITIALIZER;
    bool ready = false;
    exr_result_t r = exr_get_scanlines_per_chunk(file, 0, &lines);
    for (uint32_t y = 0; y < height && !r; y += (uint32_t)lines) {
        exr_chunk_info_t chunk;
        r = exr_write_scanline_chunk_info(file, 0, (int)y, &chunk);
        r = r ? r : ready ? exr_encoding_update(file, 0, &chunk, &pipeline) : exr_encoding_initialize(file, 0, &chunk, &pipeline);
        if (r)
            break;
        point_at(pipeline.channels, pipeline.channel_count, channels, count, width, y, false);
        if (!ready)
            r = exr_encoding_choose_default_routines(file, 0, &pipeline);
        ready = true;
        r = r ? r : exr_encoding_run(file, 0, &pipeline);
    }
    if (ready)
        exr_encoding_destroy(file, &pipeline);
    return r;
}

lmg_result lum_scanlines_open(const char *path, uint32_t max_side, exr_context_t *file, uint32_t *width, uint32_t *height,
                              lmg_error *err)
{
    const exr_context_initializer_t init = lum_scanlines_settings(max_side);
    exr_storage_t storage = EXR_STORAGE_LAST_TYPE;
    exr_attr_box2i_t window = {0};
    int parts = 0;
    *file = NULL;
    exr_result_t r = exr_start_read(file, path, &init);
    if (r) {
        const bool missing = r == EXR_ERR_FILE_ACCESS;
        return lmg_fail(err, missing ? LMG_ERROR_FILE_OPEN : LMG_ERROR_FILE_FORMAT, "%s: %s", path,
                        missing ? "can't be opened" : "isn't an OpenEXR file that can be read");
    }
    r = exr_get_count(*file, &parts);
    r = r ? r : exr_get_storage(*file, 0, &storage);
    r = r ? r : exr_get_data_window(*file, 0, &window);
    const int64_t w = (int64_t)window.max.x - window.min.x + 1, h = (int64_t)window.max.y - window.min.y + 1;
    lmg_result result = LMG_OK;
    if (r || parts != 1 || storage != EXR_STORAGE_SCANLINE)
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: isn't a picture of one part in scan lines", path);
    else if (w < 1 || h < 1 || w > max_side || h > max_side)
        result =
            lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: a size of %lld x %lld pixels can't be", path, (long long)w, (long long)h);
    if (result != LMG_OK) {
        exr_finish(file);
        *file = NULL;
        return result;
    }
    *width = (uint32_t)w;
    *height = (uint32_t)h;
    return LMG_OK;
}

bool lum_scanlines_has(exr_context_t file, const char *name)
{
    const exr_attr_chlist_t *list = NULL;
    if (exr_get_channels(file, 0, &list))
        return false;
    for (int i = 0; i < list->num_channels; ++i)
        if (!strcmp(list->entries[i].name.str, name) && list->entries[i].x_sampling == 1 && list->entries[i].y_sampling == 1)
            return true;
    return false;
}

static exr_result_t read_rows(exr_context_t file, uint32_t width, uint32_t height, const lum_channel *channels, uint32_t count)
{
    int32_t lines = 0;
    exr_attr_box2i_t window = {0};
    exr_decode_pipeline_t pipeline = EXR_DECODE_PIPELINE_INITIALIZER;
    bool ready = false;
    exr_result_t r = exr_get_data_window(file, 0, &window);
    r = r ? r : exr_get_scanlines_per_chunk(file, 0, &lines);
    if (!r && lines < 1)
        r = EXR_ERR_BAD_CHUNK_LEADER;
    for (uint32_t y = 0; y < height && !r; y += (uint32_t)lines) {
        const int32_t row = window.min.y + (int32_t)y;
        exr_chunk_info_t chunk;
        r = exr_read_scanline_chunk_info(file, 0, row, &chunk);
        /* A chunk is to lie where the header says: the decoder writes whole chunks. */
        if (!r &&
            (chunk.start_y != row || chunk.width != (int32_t)width || chunk.height < 1 || (uint32_t)chunk.height > height - y))
            r = EXR_ERR_BAD_CHUNK_LEADER;
        r = r ? r : ready ? exr_decoding_update(file, 0, &chunk, &pipeline) : exr_decoding_initialize(file, 0, &chunk, &pipeline);
        if (r)
            break;
        point_at(pipeline.channels, pipeline.channel_count, channels, count, width, y, true);
        if (!ready)
            r = exr_decoding_choose_default_routines(file, 0, &pipeline);
        ready = true;
        r = r ? r : exr_decoding_run(file, 0, &pipeline);
    }
    if (ready)
        exr_decoding_destroy(file, &pipeline);
    return r;
}

lmg_result lum_scanlines_read(exr_context_t file, const char *path, uint32_t width, uint32_t height, const lum_channel *channels,
                              uint32_t count, lmg_error *err)
{
    const exr_result_t r = read_rows(file, width, height, channels, count);
    return r ? lmg_fail(err, LMG_ERROR_FILE_READ, "%s: damaged or cut off: %s", path, exr_get_default_error_message(r)) : LMG_OK;
}
