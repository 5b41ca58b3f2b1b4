/* SPDX-License-Identifier: Apache-2.0 */
/* Differences of pictures; see image_diff.h for the measures. */
#include "image_diff.h"
#include "tonemap.h"

#include <stdlib.h>

/* Mean luminance of a block and the variance of that mean. */
static double block_mean(const view_image *image, uint32_t x0, uint32_t y0, uint32_t block, double *variance)
{
    double sum = 0, var = 0;
    uint32_t n = 0;
    for (uint32_t y = y0; y < y0 + block && y < image->height; y++) {
        for (uint32_t x = x0; x < x0 + block && x < image->width; x++) {
            size_t i = (size_t)y * image->width + x;
            double se = (double)image->standard_error[i];
            sum += lmg_luminance(&image->rgb[3 * i]);
            var += se * se;
            n++;
        }
    }
    *variance = var / ((double)n * n);
    return sum / n;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Differences up to so many standard errors count as noise in the picture. */
static const double EXPLAINED = 2;

static double image_mean(const view_image *image)
{
    size_t pixels = (size_t)image->width * image->height;
    double sum = 0;
    for (size_t i = 0; i < pixels; i++) {
        sum += lmg_luminance(&image->rgb[3 * i]);
    }
    return sum / (double)pixels;
}

lmg_result view_image_diff(const view_image *a, const view_image *b, const view_diff_options *options, view_diff *out,
                           lmg_error *err)
{
    *out = (view_diff){0};
    if (a->width != b->width || a->height != b->height) {
        return lmg_fail(err, LMG_ERROR_INPUT,
                        "the pictures have different sizes, %u x %u and %u x %u pixels; render both with one --size", a->width,
                        a->height, b->width, b->height);
    }
    uint32_t block = options->block ? options->block : 1;
    size_t count = (size_t)((a->width + block - 1) / block) * ((a->height + block - 1) / block);
    double *relative = malloc(count * sizeof *relative);
    if (!relative) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "out of memory for %zu blocks", count);
    }
    double bright = options->limit > 0 ? options->limit * image_mean(b) : (double)INFINITY;
    double sum_a = 0, sum_b = 0, var_a = 0, var_b = 0, square = 0, noise = 0, clean2 = 0, clean4 = 0;
    size_t used = 0;
    for (uint32_t y = 0; y < a->height; y += block) {
        for (uint32_t x = 0; x < a->width; x += block) {
            double va, vb, ma = block_mean(a, x, y, block, &va), mb = block_mean(b, x, y, block, &vb);
            if (ma > bright || mb > bright) {
                out->left_out++;
                continue;
            }
            double d2 = (ma - mb) * (ma - mb), clean = d2 - va - vb;
            sum_a += ma;
            sum_b += mb;
            var_a += va;
            var_b += vb;
            square += d2;
            noise += va + vb;
            clean2 += clean;
            clean4 += clean * clean;
            double middle = 0.5 * (ma + mb);
            relative[used++] = middle > 0 ? fabs(ma - mb) / middle : 0;
        }
    }
    if (!used || !(sum_b > 0)) {
        free(relative);
        return lmg_fail(err, LMG_ERROR_INPUT,
                        used ? "the second picture is black: nothing to compare with"
                             : "every block is brighter than --limit: nothing is left to compare");
    }
    double n = (double)used;
    out->blocks = used;
    out->mean_a = sum_a / n;
    out->mean_b = sum_b / n;
    out->mean_a_se = sqrt(var_a) / n;
    out->mean_b_se = sqrt(var_b) / n;
    out->rmse = sqrt(square / n) / out->mean_b;
    out->noise = sqrt(noise / n) / out->mean_b;
    double clean = clean2 / n, spread = clean4 / n - clean * clean;
    out->rmse_clean = isnan(clean) ? (double)NAN : sqrt(fmax(0, clean)) / out->mean_b;
    out->rmse_clean_se = sqrt(sqrt(fmax(0, spread) / n)) / out->mean_b;
    qsort(relative, used, sizeof *relative, compare_doubles);
    out->typical = relative[used / 2];
    free(relative);
    return LMG_OK;
}

/* Variance of a block's difference, the mean over the block and its neighbours two blocks around: a block that happened to miss
 * rare bright paths is both too dark and too sure of itself, its neighbours together are less so. */
static double pooled_variance(const view_image *a, const view_image *b, uint32_t x0, uint32_t y0, uint32_t block)
{
    double sum = 0;
    int count = 0;
    for (int dy = -2; dy <= 2; dy++) {
        for (int dx = -2; dx <= 2; dx++) {
            int64_t x = (int64_t)x0 + dx * (int64_t)block, y = (int64_t)y0 + dy * (int64_t)block;
            if (x >= 0 && y >= 0 && x < a->width && y < a->height) {
                double va, vb;
                block_mean(a, (uint32_t)x, (uint32_t)y, block, &va);
                block_mean(b, (uint32_t)x, (uint32_t)y, block, &vb);
                sum += va + vb;
                count++;
            }
        }
    }
    return sum / count;
}

void view_diff_picture(const view_image *a, const view_image *b, uint32_t block, double scale, uint8_t *bytes)
{
    double floor_luminance = 1e-3 * image_mean(b);
    /* Full colours of the two ends, linear: a dark red and a dark blue of about equal luminance. */
    static const double RED[3] = {0.55, 0.01, 0.02}, BLUE[3] = {0.01, 0.08, 0.60};
    for (uint32_t y = 0; y < a->height; y += block) {
        for (uint32_t x = 0; x < a->width; x += block) {
            double va, vb, ma = block_mean(a, x, y, block, &va), mb = block_mean(b, x, y, block, &vb);
            double middle = fmax(0.5 * (ma + mb), floor_luminance), difference = ma - mb;
            double variance = pooled_variance(a, b, x, y, block);
            if (variance > 0) { /* false when unknown, NAN */
                double explained = EXPLAINED * EXPLAINED * variance;
                difference *= fmax(0, 1 - explained / fmax(difference * difference, explained));
            }
            double v = middle > 0 ? difference / middle / scale : 0;
            const double *end = v > 0 ? RED : BLUE;
            double f = fmin(fabs(v), 1);
            for (uint32_t py = y; py < y + block && py < a->height; py++) {
                for (uint32_t px = x; px < x + block && px < a->width; px++) {
                    uint8_t *byte = &bytes[3 * ((size_t)py * a->width + px)];
                    for (int c = 0; c < 3; c++) {
                        byte[c] = (uint8_t)(255 * view_srgb(1 + f * (end[c] - 1)) + 0.5);
                    }
                }
            }
        }
    }
}
