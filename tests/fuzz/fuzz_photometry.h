/* SPDX-License-Identifier: Apache-2.0 */
/* The entry that a fuzzer calls, for tests that replay a corpus through it. */
#ifndef TESTS_FUZZ_PHOTOMETRY_H
#define TESTS_FUZZ_PHOTOMETRY_H

#include <stddef.h>
#include <stdint.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

#endif
