/* SPDX-License-Identifier: Apache-2.0 */
/* The list of the photon tracer's kernels, leanest first. */
#include "tracer_state.h"

#ifdef LUM_ONLY_REFLECTORS /* the benchmark's build without other effects (tests/bench/bench_pay.c) */
extern const tracer_kernel tracer_kernel_plain;

const tracer_kernel *const tracer_kernels[] = {&tracer_kernel_plain};
#else
extern const tracer_kernel tracer_kernel_plain, tracer_kernel_textured, tracer_kernel_glass, tracer_kernel_surfaces,
    tracer_kernel_polarized, tracer_kernel_touching, tracer_kernel_media, tracer_kernel_spectral, tracer_kernel_all;

const tracer_kernel *const tracer_kernels[] = {
    &tracer_kernel_plain, &tracer_kernel_textured, &tracer_kernel_glass, &tracer_kernel_surfaces, &tracer_kernel_polarized,
    &tracer_kernel_touching, &tracer_kernel_media, &tracer_kernel_spectral, &tracer_kernel_all,
};
#endif
const size_t tracer_kernel_count = sizeof(tracer_kernels) / sizeof(tracer_kernels[0]);
