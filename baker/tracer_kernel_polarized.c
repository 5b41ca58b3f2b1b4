/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of everything but media. */
#define KERNEL_NAME tracer_kernel_polarized
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_POLARIZATION)
#include "tracer_kernel.h"
