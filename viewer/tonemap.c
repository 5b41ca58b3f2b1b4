/* SPDX-License-Identifier: Apache-2.0 */
/* Exposure and tone curve; see tonemap.h for the formulas. */
#include "tonemap.h"

#include <luminaires/rng.h>

static const double GREY = 0.18;
static const double KNEE = 0.4;
static const double WHITE = 32;

/* Automatic exposure looks at this many blocks along the shorter side, and not at what is darker than this share of the mean. */
enum { BLOCKS = 40 };
static const double DARK = 1e-3;

/* Mean luminance of the block whose upper left corner is (x0,y0). */
static double block_luminance(const view_image *image, uint32_t x0, uint32_t y0, uint32_t block)
{
    double sum = 0;
    uint32_t n = 0;
    for (uint32_t y = y0; y < y0 + block && y < image->height; y++) {
        for (uint32_t x = x0; x < x0 + block && x < image->width; x++) {
            sum += lmg_luminance(&image->rgb[3 * ((size_t)y * image->width + x)]);
            n++;
        }
    }
    return sum / n;
}

double view_exposure_auto(const view_image *image)
{
    uint32_t shorter = image->width < image->height ? image->width : image->height, block = (shorter + BLOCKS - 1) / BLOCKS;
    double mean = 0;
    for (size_t i = 0; i < (size_t)image->width * image->height; i++) {
        mean += lmg_luminance(&image->rgb[3 * i]) / ((double)image->width * image->height);
    }
    double sum = 0;
    size_t count = 0;
    for (uint32_t y = 0; y < image->height; y += block) {
        for (uint32_t x = 0; x < image->width; x += block) {
            double luminance = block_luminance(image, x, y, block);
            if (luminance > DARK * mean) {
                sum += log(luminance);
                count++;
            }
        }
    }
    return count ? exp(sum / (double)count) : 1;
}

double view_exposure_from_ev(double ev)
{
    return 0.125 * exp2(ev);
}

double view_exposure_to_ev(double mid_grey)
{
    return log2(mid_grey / 0.125);
}

double view_tone_curve(double x)
{
    if (!(x > KNEE)) {
        return x > 0 ? x : 0;
    }
    double z = (x - KNEE) / (1 - KNEE);
    return z >= WHITE ? 1 : KNEE + (1 - KNEE) * z * (1 + z / (WHITE * WHITE)) / (1 + z);
}

void view_tone_color(const float rgb[3], double mid_grey, double out[3])
{
    double x = lmg_luminance(rgb) * GREY / mid_grey;
    double y = view_tone_curve(x);
    if (!(x > 0)) {
        out[0] = out[1] = out[2] = 0;
        return;
    }
    /* How much of the colour's distance from grey fits into [0,1]. */
    double keep = 1;
    for (int c = 0; c < 3; c++) {
        out[c] = (double)rgb[c] * GREY / mid_grey * (y / x);
        if (out[c] > 1) {
            keep = fmin(keep, (1 - y) / (out[c] - y));
        } else if (out[c] < 0) {
            keep = fmin(keep, y / (y - out[c]));
        }
    }
    for (int c = 0; c < 3; c++) {
        out[c] = fmin(fmax(y + keep * (out[c] - y), 0), 1);
    }
}

double view_srgb(double linear)
{
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

void view_tonemap(const view_image *image, double mid_grey, uint8_t *bytes)
{
    size_t pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++) {
        double color[3];
        view_tone_color(&image->rgb[3 * i], mid_grey, color);
        lum_rng rng = lum_rng_stream(0, i);
        double noise = lum_rng_next(&rng);
        for (int c = 0; c < 3; c++) {
            /* floor(v + noise) has the mean v; black and white stay what they are */
            double v = 255 * view_srgb(color[c]) + 0.5 + 0.5 * (noise - 0.5);
            bytes[3 * i + (size_t)c] = color[c] <= 0 ? 0 : (uint8_t)fmin(fmax(v, 0), 255);
        }
    }
}
