/* SPDX-License-Identifier: Apache-2.0 */
/* The tracer kernel that notes which effects light meets: all features, for the plan. */
#define KERNEL_NAME tracer_kernel_survey
#define KERNEL_FEATURES \
    (TRACER_TEXTURES | TRACER_COVERAGE | TRACER_SOLIDS | TRACER_ABSORPTION | TRACER_POLARIZATION | TRACER_MEDIA | \
     TRACER_SPECTRAL | TRACER_TOUCHING | TRACER_SURVEY)
#include "tracer_kernel.h"
