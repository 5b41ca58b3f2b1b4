/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel with all features. */
#define KERNEL_NAME tracer_kernel_all
#define KERNEL_FEATURES                                                                                                            \
    (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_POLARIZATION | TRACER_MEDIA | TRACER_SPECTRAL |  \
     TRACER_TOUCHING)
#include "tracer_kernel.h"
