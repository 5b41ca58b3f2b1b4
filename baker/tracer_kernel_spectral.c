/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel of light by wavelength, without media. */
#define KERNEL_NAME tracer_kernel_spectral
#define KERNEL_FEATURES (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_POLARIZATION | TRACER_SPECTRAL)
#include "tracer_kernel.h"
