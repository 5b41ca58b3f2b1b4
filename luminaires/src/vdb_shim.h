/* SPDX-License-Identifier: Apache-2.0 */
/*
 * OpenVDB behind a C interface.  The only way to OpenVDB; vdb_shim.cpp implements it, vdb_missing.c where Lumibox is built without.
 * lum_grid_read_vdb (luminaires/medium.h) is the other entry point.
 */
#ifndef LUMINAIRES_VDB_SHIM_H
#define LUMINAIRES_VDB_SHIM_H

#include <luminaires/medium.h>

#ifdef __cplusplus
extern "C" {
#endif

/*
 * Writes one grid of floats as a fog volume: size[0] x size[1] x size[2] values, third index fastest, the first of them voxel `low`;
 * zeros aren't stored.  index_to_world as lum_grid_read_vdb gives it (an invertible affine map).  The values are written as they
 * are, also bad ones.  For sample models and tests.  Errors: LMG_ERROR_FILE_WRITE, LMG_ERROR_MEMORY, LMG_ERROR_UNSUPPORTED.
 */
lmg_result lum_vdb_write(const char *path, const char *name, const int32_t low[3], const uint32_t size[3], const float *values,
                         const double index_to_world[3][4], lmg_error *err);

/* Whether Lumibox was built with OpenVDB. */
bool lum_vdb_available(void);

#ifdef __cplusplus
}
#endif
#endif
