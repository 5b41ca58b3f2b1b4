/* SPDX-License-Identifier: Apache-2.0 */
/* Bands of colour along a path from the eye (view_bands.h). */
#include "view_bands.h"

#include <math.h>

/* The importance of what the waves carry. */
static double carried_importance(const view_bands *b)
{
    double sum = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        sum += fabs(b->beta[i]) * (double)b->waves.importance[i];
    }
    return sum;
}

void view_bands_begin(view_bands *b, const lum_wave_tables *tables, lum_rng *rng)
{
    b->tables = tables;
    b->count = 3;
    b->beta[0] = b->beta[1] = b->beta[2] = 1;
    if (!tables) {
        return;
    }
    double luminance = lum_waves_draw(tables, &tables->white, lum_rng_next(rng), &b->waves);
    b->count = b->waves.count;
    for (uint32_t i = 0; i < b->count; i++) {
        b->beta[i] = luminance * (double)b->waves.share[i];
        lum_wave_rgb(tables, (double)b->waves.nm[i], b->response[i]);
    }
    b->importance = carried_importance(b);
}

void view_bands_light(const view_bands *b, const lum_wave_tables *tables, int32_t material, const float rgb[3],
                      double light[LUM_WAVES])
{
    if (b->tables) {
        lum_waves_lit(tables ? tables : b->tables, tables ? material : LUM_NONE, rgb, &b->waves, light);
        return;
    }
    for (int c = 0; c < 3; c++) {
        light[c] = (double)rgb[c];
    }
}

void view_bands_add(const view_bands *b, const double light[LUM_WAVES], double factor, double sum[3])
{
    if (!b->tables) {
        for (int c = 0; c < 3; c++) {
            sum[c] += b->beta[c] * light[c] * factor;
        }
        return;
    }
    for (uint32_t i = 0; i < b->count; i++) {
        double weight = b->beta[i] * light[i] * factor;
        for (int c = 0; c < 3; c++) {
            sum[c] += b->response[i][c] * weight;
        }
    }
}

void view_bands_scattered(const view_bands *b, const lum_wave_tables *tables, int32_t material, bool reflected, const float rgb[3],
                          double out[LUM_WAVES])
{
    if (!b->tables) {
        for (int c = 0; c < 3; c++) {
            out[c] = (double)rgb[c];
        }
        return;
    }
    float share[LUM_WAVES];
    lum_waves_scattered(tables, material, reflected, rgb, &b->waves, share);
    for (uint32_t i = 0; i < b->count; i++) {
        out[i] = (double)share[i];
    }
}

void view_bands_transmittance(const view_bands *b, const view_medium *m, double distance, double out[LUM_WAVES])
{
    if (!b->tables) {
        for (int c = 0; c < 3; c++) {
            out[c] = m->inside.extinction[c] > 0 ? exp(-m->inside.extinction[c] * distance) : 1;
        }
        return;
    }
    const lum_material *material = m->material;
    const double absorption[3] = {(double)material->absorption[0], (double)material->absorption[1],
                                  (double)material->absorption[2]};
    float share[LUM_WAVES];
    lum_waves_absorbed(m->tables, m->index, absorption, distance, &b->waves, share);
    for (uint32_t i = 0; i < b->count; i++) {
        double scattering = lum_waves_scattering(m->tables, m->index, &m->inside, (double)b->waves.nm[i]);
        out[i] = (double)share[i] * (m->scatters ? exp(-scattering * distance) : 1);
    }
}

void view_bands_factors(const view_bands *b, const double rgb[3], double out[LUM_WAVES])
{
    if (!b->tables) {
        for (int c = 0; c < 3; c++) {
            out[c] = rgb[c];
        }
        return;
    }
    float share[LUM_WAVES];
    lum_waves_factors(b->tables, rgb, &b->waves, share);
    for (uint32_t i = 0; i < b->count; i++) {
        out[i] = (double)share[i];
    }
}

/* The waves' shares of what is carried, for the functions that draw in proportion to them. */
static void keep_shares(view_bands *b)
{
    double sum = 0;
    for (uint32_t i = 0; i < b->count; i++) {
        sum += fabs(b->beta[i]);
    }
    for (uint32_t i = 0; i < b->count; i++) {
        b->waves.share[i] = (float)(fabs(b->beta[i]) / sum);
    }
}

/* The luminance in each of R,G,B, adding up to 1. */
static void colour_shares(const view_bands *b, double share[3])
{
    static const double LUMINANCE[3] = {0.2126, 0.7152, 0.0722};
    double sum = 0;
    for (int c = 0; c < 3; c++) {
        sum += share[c] = LUMINANCE[c] * fabs(b->beta[c]);
    }
    for (int c = 0; c < 3; c++) {
        share[c] /= sum;
    }
}

bool view_bands_fly(view_bands *b, const view_medium *medium, const lum_volumes *volumes, lmg_vec3 origin, lmg_vec3 direction,
                    double length, lum_rng *rng, lum_flight *flight)
{
    double factor[LUM_WAVES];
    if (b->tables && medium) {
        float share[LUM_WAVES];
        keep_shares(b);
        bool passed = lum_waves_fly(medium->tables, medium->index, &medium->inside, length, rng, &b->waves, share, NULL,
                                    &flight->t);
        flight->event = passed ? LUM_FLIGHT_PASSED : LUM_FLIGHT_SCATTERED;
        flight->t = passed ? length : flight->t;
        flight->g = medium->inside.g;
        for (uint32_t i = 0; i < b->count; i++) {
            factor[i] = (double)share[i];
        }
    } else {
        double share[3];
        if (b->tables) {
            keep_shares(b);
            lum_waves_colours(b->tables, &b->waves, share);
        } else {
            colour_shares(b, share);
        }
        if (medium) {
            lum_medium_fly(&medium->inside, length, share, rng, flight);
        } else {
            lum_volumes_fly(volumes, origin, direction, length, share, rng, flight);
        }
        if (flight->event == LUM_FLIGHT_ABSORBED) {
            return false;
        }
        view_bands_factors(b, flight->factor, factor);
    }
    for (uint32_t i = 0; i < b->count; i++) {
        b->beta[i] *= factor[i];
    }
    return true;
}

void view_bands_choose(view_bands *b, double u)
{
    if (b->count == 1) {
        return;
    }
    double all = carried_importance(b), before = 0;
    uint32_t chosen = 0;
    double chance = 1;
    for (uint32_t i = 0; i < b->count; i++) {
        double mine = fabs(b->beta[i]) * (double)b->waves.importance[i] / all;
        if (mine > 0) { /* also the last one where rounding leaves u beyond the sum */
            chosen = i;
            chance = mine;
        }
        before += mine;
        if (u < before) {
            break;
        }
    }
    b->beta[0] = b->beta[chosen] / chance;
    b->waves.nm[0] = b->waves.nm[chosen];
    b->waves.importance[0] = b->waves.importance[chosen];
    for (int c = 0; c < 3; c++) {
        b->response[0][c] = b->response[chosen][c];
    }
    b->count = b->waves.count = 1;
}

bool view_bands_convert(view_bands *b, const lum_wave_tables *tables, const lum_phosphor *phosphor, lum_rng *rng)
{
    double emitted[LUM_WAVES], rgb[3] = {0, 0, 0}, luminance = 0;
    lum_waves_converted(tables, phosphor, &b->waves, emitted);
    for (uint32_t i = 0; i < b->count; i++) {
        double weight = b->beta[i] * emitted[i];
        luminance += weight;
        for (int c = 0; c < 3; c++) {
            rgb[c] += b->response[i][c] * weight;
        }
    }
    /* What excites isn't known from here, so both ways get their turn, where the phosphor emits what the path carries. */
    double chance = luminance > 0 ? 0.5 : 0;
    if (lum_rng_next(rng) >= chance) {
        for (uint32_t i = 0; i < b->count; i++) {
            b->beta[i] *= (1 - lum_spectrum_at(phosphor->excitation, (double)b->waves.nm[i])) / (1 - chance);
        }
        return false;
    }
    double drawn = lum_waves_draw(tables, &tables->white, lum_rng_next(rng), &b->waves);
    b->count = b->waves.count;
    for (uint32_t i = 0; i < b->count; i++) {
        double nm = (double)b->waves.nm[i];
        b->beta[i] = drawn * (double)b->waves.share[i] * luminance / chance * lum_spectrum_at(phosphor->excitation, nm) *
                     lum_phosphor_gain(tables, phosphor, nm);
        for (int c = 0; c < 3; c++) {
            b->response[i][c] = rgb[c] / luminance;
        }
    }
    return true;
}

double view_bands_carried(const view_bands *b)
{
    return b->tables ? carried_importance(b) / b->importance : fmax(fmax(b->beta[0], b->beta[1]), b->beta[2]);
}
