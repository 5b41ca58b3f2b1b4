/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of plain lamps: opaque surfaces and thin walls without textures. */
#define KERNEL_NAME tracer_kernel_plain
#define KERNEL_FEATURES 0u
#include "tracer_kernel.h"
