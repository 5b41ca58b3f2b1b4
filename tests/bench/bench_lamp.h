/* SPDX-License-Identifier: Apache-2.0 */
/* What benchmarks of whole bakes share: our sample lamps by name, and the end of a benchmark that can't go on. */
#ifndef TESTS_BENCH_LAMP_H
#define TESTS_BENCH_LAMP_H

#include <luminaires/model.h>

/* Ends the program with the message unless r is LMG_OK. */
void bench_demand(lmg_result r, const lmg_error *err);
/* The recipe of a sample lamp, NULL if it has none; the caller destroys it. */
lum_recipe *bench_recipe(const char *name);
/* A sample lamp with its recipe, if it has one; the caller destroys it. */
lum_model *bench_load(const char *name);

#endif
