/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of everything but polarization and media. */
#define KERNEL_NAME tracer_kernel_surfaces
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION)
#include "tracer_kernel.h"
