/* SPDX-License-Identifier: Apache-2.0 */
/* Headers of binary ray files of Zemax and LightTools (layouts: docs/rayfiles.md). */
#include "rayfile_inside.h"

#include <inttypes.h>
#include <math.h>

enum { PROBE = 64 };

static double known(float value)
{
    return lum_ray_unknown(value) || !(value > 0) || isinf(value) ? (double)NAN : (double)value;
}

static lmg_result check_rays(const lum_rayfile *file, lmg_error *err)
{
    const uint64_t rays = file->info.rays;
    const size_t probe = rays < PROBE ? (size_t)rays : PROBE;
    if (!lum_ray_plausible(file, file->start, 0, probe) || !lum_ray_plausible(file, file->start, rays - probe, probe))
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: what should be rays has no unit directions: the file is damaged or its columns aren't those of its header",
                        file->name);
    return LMG_OK;
}

/* --------------------------------------------------------------------------------------------------------------- Zemax */

enum { ZEMAX_HEADER = 208 };

lmg_result lum_ray_open_zemax(lum_rayfile *file, lmg_error *err)
{
    uint8_t buffer[ZEMAX_HEADER];
    const uint8_t *h;
    lmg_result result = lum_ray_fetch(file, 0, ZEMAX_HEADER, buffer, &h, err);
    if (result != LMG_OK)
        return result;
    lum_ray_info *info = &file->info;
    info->rays = ray_u32(h + 4);
    const uint32_t units = ray_u32(h + 136), format = ray_u32(h + 192), flux = ray_u32(h + 196);
    if (info->rays == 0 || units > 4 || (format != 0 && format != 2) || flux > 1)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: its Zemax header can't be: %" PRIu64 " rays, unit of length %u, ray format %u, flux type %u", file->name,
                        info->rays, units, format, flux);
    if (format == 2 && flux == 1)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: wavelengths with luminous flux, which Zemax files can't have", file->name);
    file->metres = RAY_ZEMAX_METRES[units];
    file->nanometres = 1000;
    *(flux == 1 ? &info->luminous_lm : &info->radiant_W) = known(ray_f32(h + 112));
    lum_ray_set_columns(file, true, flux == 1, format == 2);
    file->start = ZEMAX_HEADER;
    const uint64_t record = 4 * (uint64_t)file->columns.count, room = (file->size - ZEMAX_HEADER) / record;
    if (info->rays > room)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: its header tells of %" PRIu64 " rays, it has %" PRIu64, file->name,
                        info->rays, room);
    const uint64_t behind = file->size - ZEMAX_HEADER - info->rays * record;
    if (behind)
        lum_ray_remark(file, "%" PRIu64 " bytes behind the last ray are ignored", behind);
    return check_rays(file, err);
}

/* ---------------------------------------------------------------------------------------------------------- LightTools */

enum { LIGHTTOOLS_HEADER = 44 };
static const char LIGHTTOOLS_END[7] = {'L', 'T', 'R', 'F', 'E', 'N', 'D'};

lmg_result lum_ray_open_lighttools(lum_rayfile *file, lmg_error *err)
{
    static const double METRES[8] = {1e-3, 1e-3, 0.01, 1, 0.0254, 0.3048, 1e-6, 1e-9};
    uint8_t buffer[LIGHTTOOLS_HEADER];
    const uint8_t *h;
    lmg_result result = lum_ray_fetch(file, 0, LIGHTTOOLS_HEADER, buffer, &h, err);
    if (result != LMG_OK)
        return result;
    const uint32_t major = ray_u32(h + 4), type = ray_u32(h + 12), far = ray_u32(h + 16), colour = ray_u32(h + 20);
    const uint32_t units = ray_u32(h + 24);
    if (major == 3)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: polarized LightTools rays: their layout isn't public; export them without",
                        file->name);
    if (major != 2)
        return lmg_fail(err, LMG_ERROR_FILE_VERSION, "%s: version %u of LightTools ray files isn't known (2 is)", file->name, major);
    if (colour == 1)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED,
                        "%s: LightTools rays with tristimulus values: their layout isn't public; export them with wavelengths or without colour",
                        file->name);
    if (type > 1 || far > 1 || colour > 2 || units > 7)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: its LightTools header can't be: data type %u, far field %u, colour %u, unit of length %u", file->name,
                        type, far, colour, units);
    file->metres = METRES[units];
    if (units == 0)
        lum_ray_remark(file, "lengths are in the unit of the system that wrote it, which it doesn't tell; taken as mm");
    for (int i = 0; i < 3; ++i) {
        file->origin[i] = (double)ray_f32(h + 28 + 4 * i);
        if (!isfinite(file->origin[i]))
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its origin isn't a point", file->name);
    }
    lum_ray_info *info = &file->info;
    *(type == 1 ? &info->luminous_lm : &info->radiant_W) = known(ray_f32(h + 40));
    lum_ray_set_columns(file, !far, type == 1, colour == 2);
    if (far)
        lum_ray_remark(file, "far field only: all rays start at the origin");
    file->start = LIGHTTOOLS_HEADER;
    /* No count: the rays are what lies between header and trailer. */
    const uint64_t record = 4 * (uint64_t)file->columns.count, body = file->size - LIGHTTOOLS_HEADER;
    uint8_t tail[sizeof(LIGHTTOOLS_END)];
    const uint8_t *end = NULL;
    const bool trailer = body >= sizeof(tail) &&
                         lum_ray_fetch(file, file->size - sizeof(tail), sizeof(tail), tail, &end, NULL) == LMG_OK &&
                         !memcmp(end, LIGHTTOOLS_END, sizeof(tail));
    const uint64_t bytes = trailer ? body - sizeof(tail) : body;
    if (!trailer)
        return lmg_fail(err, LMG_ERROR_FILE_READ, "%s: cut off: it doesn't end with LTRFEND", file->name);
    if (bytes == 0 || bytes % record != 0)
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: its %" PRIu64 " bytes of rays aren't whole rays of %" PRIu64 " bytes",
                        file->name, bytes, record);
    info->rays = bytes / record;
    return check_rays(file, err);
}
