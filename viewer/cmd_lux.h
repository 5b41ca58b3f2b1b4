/* SPDX-License-Identifier: Apache-2.0 */
/* lumiview render --lux: meters in the room, measured and told. */
#ifndef VIEWER_CMD_LUX_H
#define VIEWER_CMD_LUX_H

#include "meter.h"

#include <jansson.h>

/* A meter asked for: point (metres) and normal, room file's frame. */
typedef struct lux_wish {
    lmg_vec3 point, normal; /* the normal is made a unit vector by lux_parse */
} lux_wish;

/* X,Y,Z,NX,NY,NZ; false when the text isn't that or the normal has no length. */
bool lux_parse(const char *text, lux_wish *out);

/* Measures count meters; prints a line each on stdout, or with rows appends an object each to that array. */
lmg_result lux_measure(const view_scene *scene, const lux_wish *wishes, size_t count, const view_meter_options *options, bool quiet,
                       json_t *rows, lmg_error *err);

#endif
