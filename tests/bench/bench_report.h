/* SPDX-License-Identifier: Apache-2.0 */
/* How benchmarks report a figure so that scripts/bench finds it: a line "bench: NAME = VALUE UNIT".  NAME without spaces, by area:
 * "tracer.paraboloid-spot.photons". */
#ifndef LUMIBOX_TESTS_BENCH_REPORT_H
#define LUMIBOX_TESTS_BENCH_REPORT_H

#include <stdio.h>

static inline void bench_report(const char *name, double value, const char *unit)
{
    printf("bench: %s = %.6g %s\n", name, value, unit);
    fflush(stdout);
}

#endif
