/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of lamps with clear solids but no textures. */
#define KERNEL_NAME tracer_kernel_glass
#define KERNEL_FEATURES (TRACER_SOLIDS | TRACER_ABSORPTION)
#include "tracer_kernel.h"
