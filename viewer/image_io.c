/* SPDX-License-Identifier: Apache-2.0 */
/* EXR through OpenEXRCore, PNG through libpng's simplified interface. */
#include "image_io.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <openexr.h>
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

static const char *const CHANNELS[4] = {"R", "G", "B", "stderr.Y"};

/* OpenEXRCore would print its errors; ours go to the caller. */
static void keep_quiet(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)context;
    (void)code;
    (void)message;
}

static exr_context_initializer_t initializer(void)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = keep_quiet;
    return init;
}

static exr_result_t write_header(exr_context_t file, const view_image *image, const view_image_notes *notes)
{
    /* Rec.709 primaries and D65, and what R=G=B=1 means: 1 cd/m2. */
    static const exr_attr_chromaticities_t REC709 = {0.64f, 0.33f, 0.30f, 0.60f, 0.15f, 0.06f, 0.3127f, 0.3290f};
    int part;
    char seed[24];
    snprintf(seed, sizeof seed, "%" PRIu64, notes->seed);
    exr_result_t r = exr_add_part(file, "picture", EXR_STORAGE_SCANLINE, &part);
    r = r ? r : exr_initialize_required_attr_simple(file, part, (int32_t)image->width, (int32_t)image->height, EXR_COMPRESSION_ZIP);
    for (int c = 0; c < 4 && !r; c++) {
        r = exr_add_channel(file, part, CHANNELS[c], EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    }
    r = r ? r : exr_attr_set_chromaticities(file, part, "chromaticities", &REC709);
    r = r ? r : exr_attr_set_float(file, part, "whiteLuminance", 1.0f);
    r = r ? r : exr_attr_set_string(file, part, "software", "lumiview " LMG_VERSION_STRING);
    r = r ? r : exr_attr_set_int(file, part, "spp", notes->samples > INT32_MAX ? INT32_MAX : (int32_t)notes->samples);
    r = r ? r : exr_attr_set_double(file, part, "renderSeconds", notes->seconds);
    r = r ? r : exr_attr_set_string(file, part, "seed", seed);
    if (notes->mid_grey > 0) {
        r = r ? r : exr_attr_set_double(file, part, "midGrey", notes->mid_grey);
    }
    if (notes->command) {
        r = r ? r : exr_attr_set_string(file, part, "command", notes->command);
    }
    return r ? r : exr_write_header(file);
}

/* Points the channels of a coding pipeline at the planes of the picture; row: first row of the chunk.  Returns how many matched. */
static int point_channels(exr_coding_channel_info_t *channels, int count, const view_image *image, size_t row, bool reading)
{
    int matched = 0;
    for (int i = 0; i < count; i++) {
        exr_coding_channel_info_t *c = &channels[i];
        c->decode_to_ptr = NULL;
        for (size_t k = 0; k < 4; k++) {
            if (strcmp(c->channel_name, CHANNELS[k]) != 0 || c->x_samples != 1 || c->y_samples != 1) {
                continue;
            }
            float *plane = k < 3 ? image->rgb + 3 * row * image->width + k : image->standard_error + row * image->width;
            size_t stride = (k < 3 ? 3 : 1) * sizeof(float);
            if (reading) {
                c->decode_to_ptr = (uint8_t *)plane;
            } else {
                c->encode_from_ptr = (const uint8_t *)plane;
            }
            c->user_bytes_per_element = sizeof(float);
            c->user_data_type = EXR_PIXEL_FLOAT;
            c->user_pixel_stride = (int32_t)stride;
            c->user_line_stride = (int32_t)(stride * image->width);
            matched++;
        }
    }
    return matched;
}

static exr_result_t write_rows(exr_context_t file, const view_image *image)
{
    int32_t lines = 0;
    exr_result_t r = exr_get_scanlines_per_chunk(file, 0, &lines);
    exr_encode_pipeline_t pipeline = EXR_ENCODE_PIPELINE_INITIALIZER;
    bool ready = false;
    for (uint32_t y = 0; y < image->height && !r; y += (uint32_t)lines) {
        exr_chunk_info_t chunk;
        r = exr_write_scanline_chunk_info(file, 0, (int)y, &chunk);
        r = r ? r : ready ? exr_encoding_update(file, 0, &chunk, &pipeline) : exr_encoding_initialize(file, 0, &chunk, &pipeline);
        if (r) {
            break;
        }
        point_channels(pipeline.channels, pipeline.channel_count, image, y, false);
        if (!ready) {
            r = exr_encoding_choose_default_routines(file, 0, &pipeline);
            ready = true;
        }
        r = r ? r : exr_encoding_run(file, 0, &pipeline);
    }
    if (ready) {
        exr_encoding_destroy(file, &pipeline);
    }
    return r;
}

lmg_result view_write_exr(const view_image *image, const view_image_notes *notes, const char *path, lmg_error *err)
{
    char name[PATH_SIZE];
    lmg_result result = temporary_create(path, name, err);
    if (result != LMG_OK) {
        return result;
    }
    exr_context_initializer_t init = initializer();
    exr_context_t file = NULL;
    exr_result_t r = exr_start_write(&file, name, EXR_WRITE_FILE_DIRECTLY, &init);
    if (!r) {
        r = write_header(file, image, notes);
        r = r ? r : write_rows(file, image);
        exr_result_t closed = exr_finish(&file);
        r = r ? r : closed;
    }
    if (r) {
        unlink(name);
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "%s: can't write the picture: %s", path, exr_get_default_error_message(r));
    }
    return temporary_rename(name, path, err);
}

/* Reads all chunks.  Sets *matched to the number of our channels in the file. */
static exr_result_t read_rows(exr_context_t file, const view_image *image, int32_t first_y, int *matched)
{
    int32_t lines = 0;
    exr_result_t r = exr_get_scanlines_per_chunk(file, 0, &lines);
    if (!r && lines < 1) {
        r = EXR_ERR_FILE_BAD_HEADER;
    }
    exr_decode_pipeline_t pipeline = EXR_DECODE_PIPELINE_INITIALIZER;
    bool ready = false;
    for (uint32_t y = 0; y < image->height && !r; y += (uint32_t)lines) {
        exr_chunk_info_t chunk;
        r = exr_read_scanline_chunk_info(file, 0, first_y + (int32_t)y, &chunk);
        /* A chunk is to lie where the header says: the decoder writes whole chunks. */
        if (!r && (chunk.start_y != first_y + (int32_t)y || chunk.width != (int32_t)image->width || chunk.height < 1 ||
                   (uint32_t)chunk.height > image->height - y)) {
            r = EXR_ERR_BAD_CHUNK_LEADER;
        }
        r = r ? r : ready ? exr_decoding_update(file, 0, &chunk, &pipeline) : exr_decoding_initialize(file, 0, &chunk, &pipeline);
        if (r) {
            break;
        }
        *matched = point_channels(pipeline.channels, pipeline.channel_count, image, y, true);
        if (!ready) {
            r = exr_decoding_choose_default_routines(file, 0, &pipeline);
            ready = true;
        }
        r = r ? r : exr_decoding_run(file, 0, &pipeline);
    }
    if (ready) {
        exr_decoding_destroy(file, &pipeline);
    }
    return r;
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
    exr_context_initializer_t init = initializer();
    init.max_image_width = VIEW_MAX_SIDE;
    init.max_image_height = VIEW_MAX_SIDE;
    exr_context_t file = NULL;
    exr_result_t r = exr_start_read(&file, path, &init);
    if (r) {
        bool missing = r == EXR_ERR_FILE_ACCESS;
        return lmg_fail(err, missing ? LMG_ERROR_FILE_OPEN : LMG_ERROR_FILE_FORMAT, "%s: %s", path,
                        missing ? "can't be opened" : "isn't an OpenEXR file that can be read");
    }
    lmg_result result = LMG_OK;
    exr_storage_t storage = EXR_STORAGE_LAST_TYPE;
    exr_attr_box2i_t window;
    int parts = 0;
    r = exr_get_count(file, &parts);
    r = r ? r : exr_get_storage(file, 0, &storage);
    r = r ? r : exr_get_data_window(file, 0, &window);
    if (r || parts != 1 || storage != EXR_STORAGE_SCANLINE) {
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: isn't a picture of one part in scan lines, as lumiview render writes it",
                          path);
        goto cleanup;
    }
    int64_t width = (int64_t)window.max.x - window.min.x + 1, height = (int64_t)window.max.y - window.min.y + 1;
    if (width < 1 || height < 1 || width > VIEW_MAX_SIDE || height > VIEW_MAX_SIDE) {
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: a size of %lld x %lld pixels can't be", path, (long long)width,
                          (long long)height);
        goto cleanup;
    }
    result = view_image_create((uint32_t)width, (uint32_t)height, out, err);
    if (result != LMG_OK) {
        goto cleanup;
    }
    for (size_t i = 0; i < (size_t)width * (size_t)height; i++) {
        out->standard_error[i] = NAN;
    }
    const exr_attr_chlist_t *channels = NULL;
    int colours = 0;
    r = exr_get_channels(file, 0, &channels);
    for (int i = 0; !r && i < channels->num_channels; i++) {
        for (int k = 0; k < 3; k++) {
            colours += strcmp(channels->entries[i].name.str, CHANNELS[k]) == 0 && channels->entries[i].x_sampling == 1 &&
                       channels->entries[i].y_sampling == 1;
        }
    }
    if (r || colours != 3) {
        result = lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: has no channels R, G, B", path);
        goto cleanup;
    }
    int matched = 0;
    r = read_rows(file, out, window.min.y, &matched);
    if (r) {
        result = lmg_fail(err, LMG_ERROR_FILE_READ, "%s: damaged or cut off: %s", path, exr_get_default_error_message(r));
        goto cleanup;
    }
    if (notes) {
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
