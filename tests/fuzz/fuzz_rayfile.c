/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fuzz target of the ray file readers: any bytes are opened as any format and decoded; whatever comes out is either one line of
 * error or rays that can be light.  Built into test_rayfile, which replays its corpus, and with clang -fsanitize=fuzzer as it
 * stands.
 */
#include "fuzz.h"

#include <luminaires/rayfile.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_RAYS = 20000 };

static void check_rays(const lmg_ray *rays, size_t count)
{
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 o = rays[i].origin, d = rays[i].direction;
        const double length = sqrt(d.x * d.x + d.y * d.y + d.z * d.z), y = lmg_luminance(rays[i].flux);
        /* negative luminance: only what float rounding of a colour outside the gamut leaves of 0 */
        if (!isfinite(o.x + o.y + o.z) || !(fabs(length - 1) < 1e-6) || isnan(y))
            abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static lmg_ray rays[LUM_RAY_BLOCK];
    for (int flux = LUM_RAY_LIGHT; flux <= LUM_RAY_STORED; ++flux) {
        lmg_error err = {{0}};
        lum_rayfile *file;
        if (lum_rayfile_open_memory(bytes, size, "fuzz", (lum_ray_flux)flux, &file, &err) != LMG_OK) {
            if (file)
                abort();
            fuzz_check_message(&err);
            continue;
        }
        lum_ray_reader *reader;
        if (lum_ray_reader_create(file, &reader, &err) != LMG_OK)
            abort();
        const uint64_t has = lum_rayfile_info(file)->rays, end = has < MOST_RAYS ? has : MOST_RAYS;
        for (uint64_t at = 0; at < end;) {
            const size_t n = end - at < LUM_RAY_BLOCK ? (size_t)(end - at) : LUM_RAY_BLOCK;
            if (lum_ray_reader_read(reader, at, n, 1, rays, &err) != LMG_OK) {
                fuzz_check_message(&err);
                break;
            }
            check_rays(rays, n);
            at += n;
        }
        for (size_t i = 0; lum_rayfile_remark(file, i); ++i)
            if (strchr(lum_rayfile_remark(file, i), '\n'))
                abort();
        lum_ray_reader_destroy(reader);
        lum_rayfile_close(file);
    }
    return 0;
}
