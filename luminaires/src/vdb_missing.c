/* SPDX-License-Identifier: Apache-2.0 */
/* What takes the place of vdb_shim.cpp in a build without OpenVDB (CMake option LUMIBOX_OPENVDB). */
#include "vdb_shim.h"

lmg_result lum_grid_read_vdb(const char *path, const char *name, lum_interpolation interpolation, double extinction, lum_grid **out,
                             double index_to_world[3][4], lmg_error *err)
{
    (void)name, (void)interpolation, (void)extinction, (void)index_to_world;
    *out = NULL;
    return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: this Lumibox was built without OpenVDB; install libopenvdb-dev and build again",
                    path);
}

lmg_result lum_vdb_write(const char *path, const char *name, const int32_t low[3], const uint32_t size[3], const float *values,
                         const double index_to_world[3][4], lmg_error *err)
{
    (void)name, (void)low, (void)size, (void)values, (void)index_to_world;
    return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: this Lumibox was built without OpenVDB; install libopenvdb-dev and build again",
                    path);
}

bool lum_vdb_available(void)
{
    return false;
}
