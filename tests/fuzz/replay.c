/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Stands in for a fuzzer in the suite: gives a target every file of a folder, and changes of each (bytes, numbers that sizes
 * stumble over, cuts, repeats) from a fixed seed.  The target ends the program when something is wrong.
 */
#define _DEFAULT_SOURCE /* alphasort */
#include "fuzz.h"

#include <dirent.h>
#include <stdbool.h>
#include <stdio.h>

enum { CHANGES = 200, LARGEST = 1 << 20 };

static uint64_t next(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return *state >> 33;
}

static void change(uint8_t *bytes, size_t size, uint64_t *state)
{
    static const uint32_t TELLING[] = {0, 1, 0x7fffffff, 0x80000000, 0xffffffff, 65535, 65536, 0x7f800000, 0x7fc00000, 0x00000001};
    for (uint64_t k = 1 + next(state) % 4; k > 0; --k) {
        const size_t at = next(state) % size, from = next(state) % size, length = 1 + next(state) % 64;
        switch (next(state) % 4) {
        case 0:
            bytes[at] = (uint8_t)next(state);
            break;
        case 1:
            bytes[at] ^= (uint8_t)(1u << next(state) % 8);
            break;
        case 2: {
            const uint32_t value = TELLING[next(state) % (sizeof(TELLING) / sizeof(TELLING[0]))];
            memcpy(bytes + at, &value, size - at < sizeof(value) ? size - at : sizeof(value));
            break;
        }
        default: {
            const size_t most = size - (at > from ? at : from);
            memmove(bytes + at, bytes + from, length < most ? length : most);
        }
        }
    }
}

static bool replay(const char *path)
{
    FILE *f = fopen(path, "rb");
    static uint8_t original[LARGEST];
    const size_t size = f ? fread(original, 1, LARGEST, f) : 0;
    if (f)
        fclose(f);
    if (size == 0) {
        fprintf(stderr, "%s: can't be read\n", path);
        return false;
    }
    uint64_t state = 20261122;
    /* of its exact length, so that a sanitizer sees what is read beyond it */
    for (int i = 0; i <= CHANGES; ++i) {
        uint8_t *bytes = malloc(size);
        if (!bytes)
            return false;
        memcpy(bytes, original, size);
        if (i > 0)
            change(bytes, size, &state);
        const size_t length = i % 8 == 7 ? next(&state) % size : size;
        uint8_t *cut = length < size ? malloc(length + (length == 0)) : bytes;
        if (!cut)
            return false;
        if (cut != bytes)
            memcpy(cut, bytes, length);
        LLVMFuzzerTestOneInput(cut, length);
        if (cut != bytes)
            free(cut);
        free(bytes);
    }
    return true;
}

int main(int argc, char **argv)
{
    int files = 0;
    for (int a = 1; a < argc; ++a) {
        struct dirent **names;
        const int n = scandir(argv[a], &names, NULL, alphasort);
        for (int i = 0; i < n; ++i) {
            char path[2048];
            snprintf(path, sizeof(path), "%s/%s", argv[a], names[i]->d_name);
            if (names[i]->d_name[0] != '.') {
                printf("%s\n", path);
                fflush(stdout);
                if (!replay(path))
                    return 1;
                ++files;
            }
            free(names[i]);
        }
        if (n >= 0)
            free(names);
    }
    if (files == 0)
        fprintf(stderr, "usage: %s FOLDER...: no files there\n", argv[0]);
    return files == 0;
}
