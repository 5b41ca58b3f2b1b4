/* SPDX-License-Identifier: Apache-2.0 */
/* Where a box or a lamp stands in the room: FILE@X,Y,Z[,RX,RY,RZ] on the command line. */
#ifndef VIEWER_PLACEMENT_H
#define VIEWER_PLACEMENT_H

#include "view_math.h"

/*
 * The object's own origin comes to (x,y,z), metres in the room file's frame, after the object has been turned about its origin by
 * rx about the x axis, then ry about y, then rz about z (degrees, right-handed, axes of the room).
 */
typedef struct view_placement {
    lmg_vec3 position;
    double rx, ry, rz;
} view_placement;

/* The rigid motion of a placement. */
void view_placement_motion(const view_placement *placement, view_motion *out);

/*
 * Takes "FILE@X,Y,Z", "FILE@X,Y,Z,RY" or "FILE@X,Y,Z,RX,RY,RZ" apart.  The last '@' counts, so that names may contain '@' and
 * commas. path gets FILE.  Errors: LMG_ERROR_ARGUMENT (no '@', not 3, 4 or 6 finite numbers, an empty or too long name).
 */
lmg_result view_placement_parse(const char *text, view_placement *out, char *path, size_t path_size, lmg_error *err);

/* Reads exactly count finite numbers separated by commas; nothing may follow.  Returns whether it could. */
bool view_parse_numbers(const char *text, double *out, size_t count);

#endif
