/* SPDX-License-Identifier: Apache-2.0 */
/* Makes TM-25 files in memory, byte by byte and independently of the library's writer: with the columns, quirks and mistakes that a
 * test wants. */
#ifndef TESTS_RAYFILE_MAKER_H
#define TESTS_RAYFILE_MAKER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct tm25_recipe {
    uint32_t rays;
    bool flags[8]; /* as in the file: position, direction, radiant, wavelength, luminous, Stokes, tristimulus, spectrum index */
    int32_t spectral, tables, table_points, extra, text_bytes;
    bool unpadded;  /* tables without padding */
    bool no_labels; /* further columns without their names */
    bool big_endian_nan;
    float luminous, radiant; /* header; NAN = unknown */
} tm25_recipe;

/* Bytes of the file (malloc'd).  Ray i starts at (i, -i/2, 0.25) mm, goes along a direction that turns with i, carries 0.002 W,
 * 1 lm + i/1000, wavelength 500 + i nm, X = 0.5 Y, Z = 0.25 Y, table 1 + i % tables; skipped columns hold 7. */
uint8_t *tm25_make(const tm25_recipe *recipe, size_t *size);

/* Direction of ray i. */
void tm25_direction(uint32_t i, float k[3]);

#endif
