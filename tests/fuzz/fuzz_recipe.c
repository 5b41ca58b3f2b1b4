/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fuzz target of recipes: any bytes are refused with one line, or applied to a lamp of one glass triangle and one luminous one;
 * what doesn't fit it is refused with one line as well.
 */
#define _GNU_SOURCE /* memfd_create */
#include "fuzz.h"

#include <luminaires/model.h>

#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

/* Two materials and nodes with the names that recipes of the seeds use. */
static const char LAMP[] =
    "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_transmission\"],\"scenes\":[{\"nodes\":[0,1]}],"
    "\"nodes\":[{\"name\":\"Lens\",\"mesh\":0},{\"name\":\"LED\",\"mesh\":1}],"
    "\"meshes\":[{\"name\":\"Lens\",\"primitives\":[{\"attributes\":{\"POSITION\":0},\"material\":0}]},"
    "{\"name\":\"LED\",\"primitives\":[{\"attributes\":{\"POSITION\":0},\"material\":1}]}],"
    "\"materials\":[{\"name\":\"Glass\",\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1}}},"
    "{\"name\":\"Emitter\",\"emissiveFactor\":[1,1,1]}],"
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,0]}],"
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,\"uri\":\"data:application/"
    "octet-stream;base64,"
    "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"}]}";

static int in_memory(const void *bytes, size_t size, char path[64])
{
    const int fd = memfd_create("fuzz", MFD_CLOEXEC);
    if (fd < 0 || (size > 0 && write(fd, bytes, size) != (ssize_t)size))
        abort();
    snprintf(path, 64, "/proc/self/fd/%d", fd);
    return fd;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    char path[64], lamp[64];
    const int fd = in_memory(bytes, size, path), model = in_memory(LAMP, sizeof(LAMP) - 1, lamp);
    lmg_error err = {{0}};
    lum_recipe *recipe = NULL;
    if (lum_recipe_read(path, &recipe, &err) != LMG_OK) {
        if (recipe)
            abort();
        fuzz_check_message(&err);
    } else {
        lum_model *m = NULL;
        if (lum_model_load(lamp, recipe, &m, &err) != LMG_OK)
            fuzz_check_message(&err);
        lum_model_destroy(m);
        lum_recipe_destroy(recipe);
    }
    close(fd);
    close(model);
    return 0;
}
