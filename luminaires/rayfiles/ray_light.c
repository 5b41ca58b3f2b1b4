/* SPDX-License-Identifier: Apache-2.0 */
/* Lumens, watts and colours of rays: what the columns of a file mean as light.  Relies on the CIE 1931 observer of spectrum.h. */
#include "rayfile_inside.h"

#include <luminaires/spectrum.h>

#include <math.h>

/* Lumens per watt at 555 nm (SI: 683 lm/W at 540 THz). */
static const double MOST_LUMENS = 683;

void lum_ray_rgb(double x, double z, float rgb[3])
{
    const double xyz[3] = {x, 1, z};
    double out[3];
    lum_xyz_to_rgb(xyz, out);
    for (int i = 0; i < 3; ++i)
        rgb[i] = (float)out[i];
}

void lum_ray_monochrome(double nm, ray_spectrum *out)
{
    double xyz[3];
    lum_observer(nm, xyz);
    out->lumens_per_watt = MOST_LUMENS * xyz[1];
    if (!(xyz[1] > 0)) /* no light to give a colour to */
        lum_observer(nm < 500 ? (double)LUM_NM_FIRST : (double)LUM_NM_LAST, xyz);
    lum_ray_rgb(xyz[0] / xyz[1], xyz[2] / xyz[1], out->rgb);
}

void lum_ray_tabulated(const float *pairs, size_t count, ray_spectrum *out)
{
    /* Trapezoids between the table's points and every nanometre between them; a single point is a line. */
    double sum[3] = {0, 0, 0}, power = 0;
    for (size_t i = 0; i < count; ++i) {
        const double nm = (double)pairs[2 * i], w = (double)pairs[2 * i + 1];
        if (count == 1) {
            lum_observer(nm, sum);
            power = 1;
            break;
        }
        if (i + 1 == count)
            break;
        const double next = (double)pairs[2 * i + 2], w2 = (double)pairs[2 * i + 3], width = next - nm;
        power += 0.5 * (w + w2) * width;
        const double low = fmax(nm, LUM_NM_FIRST), high = fmin(next, LUM_NM_LAST);
        if (!(high > low))
            continue;
        const int steps = (int)ceil(high - low);
        for (int k = 0; k <= steps; ++k) {
            const double at = low + (high - low) * k / steps, weight = (w + (w2 - w) * (at - nm) / width) * (high - low) / steps;
            double xyz[3];
            lum_observer(at, xyz);
            for (int c = 0; c < 3; ++c)
                sum[c] += (k == 0 || k == steps ? 0.5 : 1) * weight * xyz[c];
        }
    }
    out->lumens_per_watt = power > 0 ? MOST_LUMENS * sum[1] / power : 0;
    out->rgb[0] = out->rgb[1] = out->rgb[2] = 1;
    if (sum[1] > 0)
        lum_ray_rgb(sum[0] / sum[1], sum[2] / sum[1], out->rgb);
}

/* Lumens of watts, by what the file tells of wavelengths. */
static void lumens_from_watts(lum_rayfile *file)
{
    lum_ray_info *info = &file->info;
    ray_spectrum line;
    info->photometric = true;
    if (file->columns.spectrum >= 0) {
        file->flux_by_spectrum = true;
        lum_ray_remark(file, "lumens are computed from watts by each ray's spectrum");
    } else if (file->columns.wavelength >= 0) {
        file->flux_by_wavelength = true;
        lum_ray_remark(file, "lumens are computed from watts by each ray's wavelength");
    } else if (file->spectrum_count > 0 && file->spectra[0].lumens_per_watt > 0) {
        file->flux_constant = file->spectra[0].lumens_per_watt;
        lum_ray_remark(file, "lumens are computed from watts by the spectrum: %.5g lm/W", file->flux_constant);
    } else if (lum_ray_monochrome(info->wavelength_nm > 0 ? info->wavelength_nm : 0, &line), line.lumens_per_watt > 0) {
        file->flux_constant = line.lumens_per_watt;
        lum_ray_remark(file, "lumens are computed from watts at %.5g nm: %.5g lm/W", info->wavelength_nm, file->flux_constant);
    } else if (info->luminous_lm > 0 && info->radiant_W > 0) {
        file->flux_constant = info->luminous_lm / info->radiant_W;
        lum_ray_remark(file, "lumens are computed from watts by the header's totals: %.5g lm/W", file->flux_constant);
    } else {
        info->photometric = false;
        lum_ray_remark(file, "its flux is in watts and nothing tells of visible wavelengths: all light is in watts (W, W/sr, W/m2)");
    }
}

lmg_result lum_ray_decide_flux(lum_rayfile *file, lum_ray_flux flux, lmg_error *err)
{
    lum_ray_info *info = &file->info;
    const ray_columns *c = &file->columns;
    file->flux_constant = 1;
    if (flux == LUM_RAY_STORED && info->has_radiant && (info->has_wavelength || !info->has_luminous))
        flux = LUM_RAY_POWER;
    if (flux == LUM_RAY_POWER && !info->has_radiant)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: its rays carry lumens only, no watts", file->name);
    file->flux_column = flux != LUM_RAY_POWER && info->has_luminous ? c->luminous : c->radiant;
    if (flux != LUM_RAY_POWER && !info->has_luminous)
        lumens_from_watts(file);
    else
        info->photometric = flux != LUM_RAY_POWER;

    file->colour[0] = file->colour[1] = file->colour[2] = 1;
    if (!info->photometric)
        return LMG_OK; /* a watt has no colour */
    file->own_colours = c->x >= 0 || c->spectrum >= 0 || c->wavelength >= 0;
    ray_spectrum line;
    if (!file->own_colours && file->spectrum_count > 0)
        memcpy(file->colour, file->spectra[0].rgb, sizeof(file->colour));
    else if (!file->own_colours && info->wavelength_nm > 0 &&
             (lum_ray_monochrome(info->wavelength_nm, &line), line.lumens_per_watt > 0))
        memcpy(file->colour, line.rgb, sizeof(file->colour));
    return LMG_OK;
}
