/* SPDX-License-Identifier: Apache-2.0 */
/* Lamps as formulas: rays of known light, for the tests of the light field.  Every ray has flux 1 and is keyed by (seed, number). */
#ifndef TESTS_LAMP_FIXTURE_H
#define TESTS_LAMP_FIXTURE_H

#include <lumigraph/lumigraph.h>

typedef enum lamp {
    LAMP_DISC,    /* Lambertian disc, radius 0.05 m, in the plane y = 0, facing -Y; alone I = 1/pi per unit of flux */
    LAMP_SQUARE,  /* Lambertian square, side 0.6 m, centre (0.1, 0.2, -0.3), facing +X */
    LAMP_SPHERE,  /* Lambertian sphere, radius 0.15 m, at the origin */
    LAMP_BEAD,    /* Lambertian sphere, radius 0.01 m, off centre in bounds of 0.4 m */
    LAMP_SPOT,    /* paraboloid mirror f = 20 mm, rim radius 50 mm in y = 0, facing -Y, Lambertian source of radius 2 mm in the focus */
    LAMP_LOUVRE,  /* panel 0.6 m in y = 0, facing -Y: 8 x 8 cells 37.5 mm deep, half of what meets them leaves diffusely */
    LAMP_LENS,    /* beam of 7.1 degrees through a lens of radius 20 mm in y = 0, facing -Y, and 5 % from a point behind, everywhere */
    LAMP_COUNT
} lamp;

typedef struct lamp_rng {
    uint64_t state;
} lamp_rng;

lamp_rng lamp_stream(uint64_t seed, uint64_t number);
double lamp_next(lamp_rng *rng);

const char *lamp_name(lamp kind);
void lamp_bounds(lamp kind, lmg_vec3 *lo, lmg_vec3 *hi);
lmg_vec3 lamp_axis(lamp kind); /* main direction, unit */

/* Ray number n: what leaves the lamp; for lamps that absorb, the first of its tries that leaves. */
lmg_ray lamp_ray(lamp kind, uint64_t seed, uint64_t number);

/* Rays first..first+count-1; free() them. */
lmg_ray *lamp_rays(lamp kind, uint64_t seed, uint64_t first, size_t count);

/* The whole way: pilot of 100,000 rays (other seed) -> fit -> accumulate count rays -> field of 1 lumen.  Fails the test on errors. */
lmg_field *lamp_field(lamp kind, uint64_t seed, size_t count, const lmg_fit_options *wishes);
lmg_layout lamp_layout(lamp kind, const lmg_fit_options *wishes);

/* |x - y| <= tolerance in double (cmocka's own comparison is in float); a NaN fails.  To be used after cmocka.h. */
#define assert_near(x, y, tolerance)                                                                                                   \
    do {                                                                                                                               \
        const double near_x = (x), near_y = (y), near_t = (tolerance);                                                                 \
        if (!(near_x - near_y <= near_t && near_y - near_x <= near_t))                                                                 \
            fail_msg("%s = %.15g is %.3g away from %.15g; %.3g is allowed", #x, near_x, near_x - near_y, near_y, near_t);              \
    } while (0)

#endif
