/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Writes the box that the consumer reads: one aperture cell of 1 m2 over the whole hemisphere, etendue pi m2 sr, with 100 pi lumens in it,
 * so the radiance is 100 cd/m2 times the colour (1.5, 0.9, 0.518...) whose luminance is 1.
 */
#include <lumigraph/lumigraph.h>

#include <math.h>
#include <stdio.h>

int main(int argc, char **argv)
{
    lmg_layout layout = {.slab_count = 1,
                         .channels = 1,
                         .colour = {1.5f, 0.9f, (float)((1 - 0.2126 * 1.5 - 0.7152 * 0.9) / 0.0722)},
                         .bounds_min = {-0.5, -0.5, -0.1},
                         .bounds_max = {0.5, 0.5, 0},
                         .size = 1.4142,
                         .slabs = {{.kind = LMG_SLAB_APERTURE,
                                    .a = {1, 0, 0},
                                    .b = {0, 1, 0},
                                    .n = {0, 0, 1},
                                    .distance = INFINITY,
                                    .u0 = -0.5,
                                    .u1 = 0.5,
                                    .v0 = -0.5,
                                    .v1 = 0.5,
                                    .s0 = -1,
                                    .s1 = 1,
                                    .t0 = -1,
                                    .t1 = 1,
                                    .nu = 1,
                                    .nv = 1,
                                    .ns = 1,
                                    .nt = 1}}};
    lmg_error error = {.message = "usage: make_box FILE"};
    lmg_accumulator *accumulator = NULL;
    lmg_field *field = NULL;
    bool good = argc == 2 && lmg_accumulator_create(&layout, &accumulator, &error) == LMG_OK;
    for (uint64_t i = 0; good && i < 1000; i++) {
        const lmg_ray ray = {.origin = {0.1, 0.1, 0}, .direction = {0, 0, 1}, .flux = {1, 1, 1}, .number = i};
        lmg_accumulator_deposit(accumulator, &ray, 1);
    }
    good = good && lmg_field_reconstruct(accumulator, 0.1 * 3.14159265358979, NULL, &field, &error) == LMG_OK &&
           lmg_field_write(field, argv[1], &error) == LMG_OK;
    if (!good) {
        fprintf(stderr, "%s\n", error.message);
    }
    lmg_field_destroy(field);
    lmg_accumulator_destroy(accumulator);
    return good ? 0 : 1;
}
