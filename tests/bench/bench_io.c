/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Writing and reading box files: sizes, and best wall-clock times of three, from a warm page cache, for fields of about 16 and 100 MB of
 * file, without compression and by levels of zip.  Prints a table; fails only when something can't be written or read.
 */
#include "../unit/box_fixture.h"
#include "exr_write.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>

#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void measure(const char *name, uint32_t slabs, uint32_t uv, uint32_t st, uint32_t channels)
{
    static const struct {
        const char *name;
        lmg_exr_compression compression;
        int level;
    } ways[] = {{"none", LMG_EXR_NONE, 0}, {"zip 1", LMG_EXR_ZIP, 1}, {"zip 4", LMG_EXR_ZIP, 4}, {"zip 6", LMG_EXR_ZIP, 6}, {"zip 9", LMG_EXR_ZIP, 9}};
    char directory[256], path[300];
    fixture_directory(directory);
    snprintf(path, sizeof path, "%s/a.box.exr", directory);
    lmg_field *field = fixture_photon_field(slabs, uv, uv, st, st, channels, 1);
    for (size_t i = 0; i < sizeof ways / sizeof ways[0]; i++) {
        double write_s = 1e9, read_s = 1e9;
        size_t size = 0;
        lmg_error error = {.message = ""};
        for (int round = 0; round < 3; round++) {
            double start = now();
            if (lmg_field_write_as(field, path, ways[i].compression, ways[i].level, &error) != LMG_OK) {
                fail_msg("%s", error.message);
            }
            double took = now() - start;
            write_s = took < write_s ? took : write_s;
            lmg_field *back = NULL;
            start = now();
            if (lmg_field_read(path, &back, &error) != LMG_OK) {
                fail_msg("%s", error.message);
            }
            took = now() - start;
            read_s = took < read_s ? took : read_s;
            lmg_field_destroy(back);
        }
        free(fixture_load(path, &size));
        printf("%-22s %-6s %8.1f MB   write %6.2f s   read %6.3f s\n", name, ways[i].name, (double)size * 1e-6, write_s, read_s);
    }
    lmg_field_destroy(field);
    fixture_remove_directory(directory);
}

static void test_table(void **state)
{
    (void)state;
    printf("%ld processors\n", sysconf(_SC_NPROCESSORS_ONLN));
    measure("6 x 32x32x16x16, Y", 6, 32, 16, 1);
    measure("6 x 24x24x24x24, RGB", 6, 24, 24, 3);
    measure("1 x 48x48x48x48, Y", 1, 48, 48, 1);
    measure("6 x 48x48x32x32, Y", 6, 48, 32, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_table)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
