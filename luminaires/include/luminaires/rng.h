/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Random numbers from a counter keyed by (seed, photon number): SplitMix64 (Steele, Lea, Flood 2014), one stream per photon.
 * No state outlives a photon, so any photon can be traced by any thread at any time with the same result.
 */
#ifndef LUMINAIRES_RNG_H
#define LUMINAIRES_RNG_H

#include <stdint.h>

typedef struct lum_rng {
    uint64_t state;
} lum_rng;

static inline uint64_t lum_mix64(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

/* The stream of one photon.  Two rounds of mixing keep the streams of neighbouring numbers and seeds apart. */
static inline lum_rng lum_rng_stream(uint64_t seed, uint64_t number)
{
    lum_rng r = {lum_mix64(lum_mix64(seed + 0x9e3779b97f4a7c15u) ^ (number * 0xd1342543de82ef95u + 0x632be59bd9b4e019u))};
    return r;
}

/* Uniform in [0,1), 53 bits. */
static inline double lum_rng_next(lum_rng *rng)
{
    rng->state += 0x9e3779b97f4a7c15u;
    return (double)(lum_mix64(rng->state) >> 11) * 0x1p-53;
}

#endif
