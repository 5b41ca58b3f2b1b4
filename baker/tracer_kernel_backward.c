/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel that follows rays from outside into the lamp: all features whose backward direction is the exact adjoint. */
#define KERNEL_NAME tracer_kernel_backward
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_BACKWARD)
#include "tracer_kernel.h"
