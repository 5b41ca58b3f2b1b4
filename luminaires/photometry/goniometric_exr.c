/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A distribution as a goniometric picture for pbrt-v4: intensities (cd) in one float channel over the equal-area octahedral square
 * [clarberg2008].  The picture's z axis is up: picture (x, y, z) = luminaire frame (x, z, y), which is how pbrt's light looks it up
 * in a scene that keeps glTF's axes ("Scale -1 1 1" for its left-handed world).  Each pixel is the mean over 3 x 3 directions.
 */
#include "photometry_file.h"

#include "text.h"

#include <luminaires/scanlines.h>

#include <math.h>
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

static exr_result_t write_picture(exr_context_t file, float *pixels, uint32_t n)
{
    const lum_channel intensity = {.name = "Y", .values = pixels, .stride = 1};
    exr_result_t r = lum_scanlines_add_part(file, "intensity", n, n, &intensity, 1);
    r = r ? r : exr_attr_set_string(file, 0, "software", "Lumibox " LMG_VERSION_STRING);
    r = r ? r : exr_attr_set_string(file, 0, "unit", "cd, equal-area octahedral map, z up");
    r = r ? r : exr_write_header(file);
    return r ? r : lum_scanlines_write(file, n, n, &intensity, 1);
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
    const exr_context_initializer_t init = lum_scanlines_settings(n);
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
