/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of everything but media, where solids touch. */
#define KERNEL_NAME tracer_kernel_touching
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_POLARIZATION | TRACER_TOUCHING)
#include "tracer_kernel.h"
