/* SPDX-License-Identifier: Apache-2.0 */
/* Tables that spectrum.c works from. */
#ifndef LUMINAIRES_SPECTRUM_TABLES_H
#define LUMINAIRES_SPECTRUM_TABLES_H

enum { LUM_TABLE_5NM = 95, LUM_TABLE_10NM = 48 }; /* 360 .. 830 nm */

/* CIE 1931 2-degree x, y, z: CIE 15:2004, table T.4. */
extern const double lum_observer_table[LUM_TABLE_5NM][3];

/* S0, S1, S2 of CIE daylight: CIE 15:2004, table T.2. */
extern const double lum_daylight_table[LUM_TABLE_10NM][3];

/* b_R and b_B of lum_colour_basis; b_G = 1 - b_R - b_B. */
extern const double lum_red_blue_table[LUM_TABLE_5NM][2];

#endif
