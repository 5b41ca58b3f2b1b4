/* SPDX-License-Identifier: Apache-2.0 */
/* What is told of a distribution in a few numbers: flux and its zones (exact integrals of the linear interpolation), beam, peak,
 * and how two distributions differ. */
#include "photometry_file.h"

#include "text.h"

#include <math.h>
#include <string.h>

static const double DEGREE = 3.14159265358979323846 / 180;

/* ---------------------------------------------------------------------------------------------------------------- flux */

/* Intensity at vertical angle j integrated over C, cd rad: what a ring of a type C distribution sends out. */
static double ring(const lum_photometry *p, uint32_t j)
{
    double sum = 0;
    for (uint32_t i = 0; i < lum_grid_h_cells(p); i++) {
        double h0, h1;
        uint32_t a, b;
        lum_grid_h_cell(p, i, &h0, &h1, &a, &b);
        sum += 0.5 * (h1 - h0) * DEGREE * (p->intensity[(size_t)a * p->v_count + j] + p->intensity[(size_t)b * p->v_count + j]);
    }
    return sum * lum_grid_copies(p);
}

/* Adds a type C distribution's flux, zone by zone, to out. */
static void zones(const lum_photometry *p, lum_photometry_measures *out)
{
    for (uint32_t j = 0; j + 1 < p->v_count; j++) {
        const double v0 = p->v[j], v1 = p->v[j + 1], i0 = ring(p, j), i1 = ring(p, j + 1);
        double from = v0;
        for (int zone = (int)(v0 / 10); from < v1 && zone < LUM_ZONES; zone++) {
            const double to = fmin(v1, 10.0 * (zone + 1));
            if (to <= from)
                continue;
            double w0, w1;
            lum_sine_weights(from, to, &w0, &w1);
            const double a = i0 + (i1 - i0) * (from - v0) / (v1 - v0), b = i0 + (i1 - i0) * (to - v0) / (v1 - v0);
            const double flux = fmax(0, w0 * a + w1 * b);
            out->zonal[zone] += flux;
            *(zone < 9 ? &out->down : &out->up) += flux;
            from = to;
        }
    }
}

/* --------------------------------------------------------------------------------------------------------------- beams */

/* Angle from axis towards side at which intensity falls below level for the first time; 180 if it doesn't. */
static double fall(const lum_photometry *p, lmg_vec3 axis, lmg_vec3 side, double level)
{
    const double step = 0.1;
    double before = lum_photometry_intensity(p, axis);
    for (int k = 1; k <= 1800; k++) {
        const double a = step * k * DEGREE, c = cos(a), s = sin(a);
        const double now =
            lum_photometry_intensity(p, (lmg_vec3){c * axis.x + s * side.x, c * axis.y + s * side.y, c * axis.z + s * side.z});
        if (now < level)
            return step * (before > now && before >= level ? k - 1 + (before - level) / (before - now) : k - 1);
        before = now;
    }
    return 180;
}

static void beams(const lum_photometry *p, lum_photometry_measures *out)
{
    lmg_vec3 axis = lum_direction_from_c_gamma(out->peak_c, out->peak_gamma);
    const lmg_vec3 down = {0, -1, 0}, up = {0, 1, 0};
    /* A flat-topped beam is measured about the vertical, whichever of its top values is the largest. */
    if (lum_photometry_intensity(p, down) >= 0.9 * out->peak)
        axis = down;
    else if (lum_photometry_intensity(p, up) >= 0.9 * out->peak)
        axis = up;
    const double across = hypot(axis.x, axis.z);
    lmg_vec3 first = {1, 0, 0}, second = {0, 0, -1};
    if (across > 1e-9) { /* the vertical plane through the axis, and the one across */
        second = (lmg_vec3){-axis.z / across, 0, axis.x / across};
        first = (lmg_vec3){-axis.x * axis.y / across, across, -axis.z * axis.y / across};
    }
    const lmg_vec3 sides[4] = {first, {-first.x, -first.y, -first.z}, second, {-second.x, -second.y, -second.z}};
    double beam[4], field[4];
    for (int k = 0; k < 4; k++) {
        beam[k] = fall(p, axis, sides[k], 0.5 * out->peak);
        field[k] = fall(p, axis, sides[k], 0.1 * out->peak);
    }
    out->beam_c0 = beam[0] + beam[1];
    out->beam_c90 = beam[2] + beam[3];
    out->field_c0 = field[0] + field[1];
    out->field_c90 = field[2] + field[3];
    out->beam_angle = 0.5 * (out->beam_c0 + out->beam_c90);
    out->field_angle = 0.5 * (out->field_c0 + out->field_c90);
}

lmg_result lum_photometry_measure(const lum_photometry *p, lum_photometry_measures *out, lmg_error *err)
{
    memset(out, 0, sizeof *out);
    const uint32_t cells = lum_grid_h_cells(p);
    for (uint32_t i = 0; i < cells; i++)
        for (uint32_t j = 0; j + 1 < p->v_count; j++)
            out->flux += lum_grid_cell_flux(p, i, j);
    out->flux *= lum_grid_copies(p);
    if (p->type == LUM_TYPE_C) {
        zones(p, out);
    } else { /* zones of gamma cut across the grid: by a fine grid of type C, scaled to the exact flux */
        lum_photometry *fine;
        LUM_TRY(lum_photometry_resample(p, 360, 361, &fine, err));
        zones(fine, out);
        lum_photometry_destroy(fine);
        const double scale = out->down + out->up > 0 ? out->flux / (out->down + out->up) : 0;
        out->down *= scale;
        out->up *= scale;
        for (int k = 0; k < LUM_ZONES; k++)
            out->zonal[k] *= scale;
    }
    for (uint32_t i = 0; i < p->h_count; i++)
        for (uint32_t j = 0; j < p->v_count; j++)
            if (p->intensity[(size_t)i * p->v_count + j] > out->peak) {
                out->peak = p->intensity[(size_t)i * p->v_count + j];
                lum_direction_to_c_gamma(lum_grid_direction(p, p->h[i], p->v[j]), &out->peak_c, &out->peak_gamma);
            }
    out->lamp_flux = p->absolute ? 0 : p->lamp_sets[0].flux;
    out->efficiency = out->lamp_flux > 0 ? out->flux / out->lamp_flux : 0;
    out->efficacy = p->power > 0 ? out->flux / p->power : 0;
    if (out->peak > 0)
        beams(p, out);
    return LMG_OK;
}

/* ---------------------------------------------------------------------------------------------------------- difference */

void lum_bergen_add(lum_bergen *fit, double a, double b, double weight)
{
    fit->difference += weight * (a - b) * (a - b);
    fit->sum += weight * (a + b) * (a + b);
}

double lum_bergen_fit(const lum_bergen *fit)
{
    return fit->sum > 0 ? 100 * (1 - sqrt(fit->difference / fit->sum)) : 0;
}

lmg_result lum_photometry_compare(const lum_photometry *a, const lum_photometry *b, lum_photometry_difference *out, lmg_error *err)
{
    enum { PLANES = 72, ANGLES = 73 };
    lum_photometry_measures ma, mb;
    memset(out, 0, sizeof *out);
    LUM_TRY(lum_photometry_measure(a, &ma, err));
    LUM_TRY(lum_photometry_measure(b, &mb, err));
    if (!(mb.peak > 0))
        return lmg_fail(err, LMG_ERROR_INPUT, "the distribution to compare with holds no light");
    lum_bergen plain = {0}, weighted = {0};
    double squares = 0, solid = 0, largest = 0;
    for (int j = 0; j < ANGLES; j++) {
        const double gamma = 2.5 * j;
        /* Solid angle of the ring half a step to both sides, per plane. */
        const double w = cos(fmax(gamma - 1.25, 0) * DEGREE) - cos(fmin(gamma + 1.25, 180) * DEGREE);
        for (int i = 0; i < PLANES; i++) {
            const lmg_vec3 d = lum_direction_from_c_gamma(5.0 * i, gamma);
            const double x = lum_photometry_intensity(a, d), y = lum_photometry_intensity(b, d);
            lum_bergen_add(&plain, x, y, 1);
            lum_bergen_add(&weighted, x, y, w);
            squares += w * (x - y) * (x - y);
            solid += w;
            largest = fmax(largest, fabs(x - y));
        }
    }
    out->bergen = lum_bergen_fit(&plain);
    out->bergen_weighted = lum_bergen_fit(&weighted);
    out->rms_of_peak = sqrt(squares / solid) / mb.peak;
    out->largest_of_peak = largest / mb.peak;
    out->flux_ratio = mb.flux > 0 ? ma.flux / mb.flux : 0;
    return LMG_OK;
}
