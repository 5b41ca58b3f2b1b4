/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of lamps without solids: textures, alpha. */
#define KERNEL_NAME tracer_kernel_textured
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE)
#include "tracer_kernel.h"
