/* SPDX-License-Identifier: Apache-2.0 */
/* What tests and benchmarks of the library ask of exr_write.c beyond lumigraph.h. */
#ifndef LUMIGRAPH_EXR_WRITE_H
#define LUMIGRAPH_EXR_WRITE_H

#include <lumigraph/lumigraph.h>

/* The compressions that box files may use, by EXR's numbers.  On tiles ZIPS and ZIP are the same. */
typedef enum lmg_exr_compression { LMG_EXR_NONE = 0, LMG_EXR_ZIPS = 2, LMG_EXR_ZIP = 3 } lmg_exr_compression;

/* lmg_field_write with a choice of compression; level: 1 fast .. 9 small, has no meaning for LMG_EXR_NONE. */
lmg_result lmg_field_write_as(const lmg_field *field, const char *path, lmg_exr_compression compression, int level, lmg_error *err);

#endif
