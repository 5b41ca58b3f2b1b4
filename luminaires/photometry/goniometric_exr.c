/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A distribution as a goniometric picture for pbrt-v4: intensities (cd) in one float channel over the equal-area octahedral square
 * [clarberg2008].  The picture's z axis is up: picture (x, y, z) = luminaire frame (x, z, y), which is how pbrt's light looks it up
 * in a scene that keeps glTF's axes ("Scale -1 1 1" for its left-handed world).  Each pixel is the mean over 3 x 3 directions.
 */
#include "photometry_file.h"

#include "text.h"

#include <math.h>
#include <openexr.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Direction of a point of the unit square, luminaire frame. */
static lmg_vec3 direction_at(double u, double v)
{
    const double quarter_pi = 0.785398163397448309616;
    u = 2 * u - 1;
    v = 2 * v - 1;
    const double a = fabs(u), b = fabs(v), outside = 1 - (a + b), r = 1 - fabs(outside);
    const double phi = (r == 0 ? 1 : (b - a) / r + 1) * quarter_pi, across = r * sqrt(fmax(0, 2 - r * r));
    const double x = copysign(cos(phi), u) * across, y = copysign(sin(phi), v) * across, z = copysign(1 - r * r, outside);
    return (lmg_vec3){x, z, y};
}

static void keep_quiet(exr_const_context_t context, exr_result_t code, const char *message)
{
    (void)context;
    (void)code;
    (void)message;
}

static exr_result_t write_picture(exr_context_t file, const float *pixels, uint32_t n)
{
    int part;
    exr_result_t r = exr_add_part(file, "intensity", EXR_STORAGE_SCANLINE, &part);
    r = r ? r : exr_initialize_required_attr_simple(file, part, (int32_t)n, (int32_t)n, EXR_COMPRESSION_ZIP);
    r = r ? r : exr_add_channel(file, part, "Y", EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR, 1, 1);
    r = r ? r : exr_attr_set_string(file, part, "software", "Lumibox " LMG_VERSION_STRING);
    r = r ? r : exr_attr_set_string(file, part, "unit", "cd, equal-area octahedral map, z up");
    r = r ? r : exr_write_header(file);
    int32_t lines = 1;
    r = r ? r : exr_get_scanlines_per_chunk(file, part, &lines);
    for (uint32_t y = 0; y < n && !r; y += (uint32_t)lines) {
        exr_chunk_info_t chunk;
        exr_encode_pipeline_t pipeline = EXR_ENCODE_PIPELINE_INITIALIZER;
        r = exr_write_scanline_chunk_info(file, part, (int)y, &chunk);
        r = r ? r : exr_encoding_initialize(file, part, &chunk, &pipeline);
        if (r)
            break;
        exr_coding_channel_info_t *c = &pipeline.channels[0];
        c->encode_from_ptr = (const uint8_t *)(pixels + (size_t)y * n);
        c->user_bytes_per_element = sizeof(float);
        c->user_data_type = EXR_PIXEL_FLOAT;
        c->user_pixel_stride = sizeof(float);
        c->user_line_stride = (int32_t)(n * sizeof(float));
        r = exr_encoding_choose_default_routines(file, part, &pipeline);
        r = r ? r : exr_encoding_run(file, part, &pipeline);
        exr_encoding_destroy(file, &pipeline);
    }
    return r;
}

lmg_result lum_goniometric_write(const lum_photometry *p, const char *path, uint32_t n, lmg_error *err)
{
    enum { FINE = 3 };
    if (n < 2 || n > 8192)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a goniometric picture of %u x %u pixels is outside 2..8192", n, n);
    float *pixels = malloc((size_t)n * n * sizeof *pixels);
    char *temporary = malloc(strlen(path) + 32);
    if (!pixels || !temporary) {
        free(pixels);
        free(temporary);
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a picture of %u x %u pixels", n, n);
    }
    for (size_t i = 0; i < (size_t)n * n; i++) {
        double sum = 0;
        for (int k = 0; k < FINE * FINE; k++)
            sum += lum_photometry_intensity(
                p, direction_at(((double)(i % n) + (k % FINE + 0.5) / FINE) / n, ((double)(i / n) + (k / FINE + 0.5) / FINE) / n));
        pixels[i] = (float)(sum / (FINE * FINE));
    }
    sprintf(temporary, "%s.%ld.tmp", path, (long)getpid());
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = keep_quiet;
    exr_context_t file = NULL;
    exr_result_t r = exr_start_write(&file, temporary, EXR_WRITE_FILE_DIRECTLY, &init);
    if (!r) {
        r = write_picture(file, pixels, n);
        const exr_result_t closed = exr_finish(&file);
        r = r ? r : closed;
    }
    lmg_result result = LMG_OK;
    if (r || rename(temporary, path) != 0) {
        unlink(temporary);
        result = lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.200s: can't be written: %s", path,
                          r ? exr_get_default_error_message(r) : "no rename");
    }
    free(temporary);
    free(pixels);
    return result;
}
