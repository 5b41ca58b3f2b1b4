/* SPDX-License-Identifier: Apache-2.0 */
/* Random numbers from a key, the same on every machine: SplitMix64 (Steele, Lea, Flood 2014). */
#ifndef LUMIGRAPH_RANDOM_H
#define LUMIGRAPH_RANDOM_H

#include <stdint.h>

static inline uint64_t lmg_mix(uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

/* A key of its own for each key. */
static inline uint64_t lmg_next_key(uint64_t key)
{
    return lmg_mix(key + 0x9e3779b97f4a7c15u);
}

/* From 0 to below 1. */
static inline double lmg_next_number(uint64_t *state)
{
    *state += 0x9e3779b97f4a7c15u;
    return (double)(lmg_mix(*state) >> 11) * 0x1p-53;
}

#endif
