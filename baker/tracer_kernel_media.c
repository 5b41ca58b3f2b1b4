/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of everything in R,G,B. */
#define KERNEL_NAME tracer_kernel_media
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_POLARIZATION | TRACER_MEDIA)
#include "tracer_kernel.h"
