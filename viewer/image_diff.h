/* SPDX-License-Identifier: Apache-2.0 */
/*
 * How two renderings of the same view differ, with their noise told apart by their standard errors.  The two are to be independent
 * (different seeds): equal seeds share random numbers, and their noise then counts too much.
 */
#ifndef VIEWER_IMAGE_DIFF_H
#define VIEWER_IMAGE_DIFF_H

#include "render.h"

typedef struct view_diff_options {
    uint32_t block; /* pixels: compare means over block x block pixels; at least 1 */
    double
        limit; /* blocks where either picture is brighter than limit x the mean of b are left out (the lamp itself); 0 = none is */
} view_diff_options;

typedef struct view_diff {
    uint64_t blocks, left_out;
    double mean_a, mean_b;       /* mean luminance of the blocks compared, cd/m2 */
    double mean_a_se, mean_b_se; /* NAN when a picture has no standard errors */
    double rmse;                 /* sqrt(mean (a - b)^2) / mean_b: as it is */
    double noise;                /* sqrt(mean (se_a^2 + se_b^2)) / mean_b: what noise alone gives */
    double rmse_clean;           /* sqrt(max(0, rmse^2 - noise^2)); NAN without standard errors */
    double rmse_clean_se; /* standard error of rmse_clean^2, from the spread over blocks, as of rmse_clean: rmse_clean is at most
                             sqrt(rmse_clean^2 + 2 rmse_clean_se^2) with 95 % */
    double typical;       /* median of |a - b| / ((a + b) / 2) over blocks */
} view_diff;

/* Errors: LMG_ERROR_INPUT when the sizes differ or nothing is left to compare. */
lmg_result view_image_diff(const view_image *a, const view_image *b, const view_diff_options *options, view_diff *out,
                           lmg_error *err);

/*
 * The picture of the relative difference 2 (a - b) / (a + b) of block means: red where a is brighter, blue where b is, white where
 * they agree; full colour at +-scale.  Where both are darker than a thousandth of the mean, the difference is taken against that.
 * What noise explains is taken off: a difference d with the standard error s shows as d (1 - (2 s / d)^2), below 2 s as white.  s:
 * pooled over 5 x 5 blocks.
 */
void view_diff_picture(const view_image *a, const view_image *b, uint32_t block, double scale, uint8_t *bytes);

#endif
