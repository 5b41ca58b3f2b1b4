/* SPDX-License-Identifier: Apache-2.0 */
/* Pinhole cameras: from the room file, from the command line, or chosen to show the room. */
#ifndef VIEWER_VIEW_CAMERA_H
#define VIEWER_VIEW_CAMERA_H

#include "view_scene.h"

typedef struct view_camera {
    lmg_vec3 eye;                /* world */
    lmg_vec3 forward, right, up; /* unit, orthogonal */
    double half_height;          /* tangent of half the vertical angle */
} view_camera;

/* Looks from eye (world) along forward; yfov in radians, in (0, pi).  up only chooses the roll. */
lmg_result view_camera_set(view_camera *camera, lmg_vec3 eye, lmg_vec3 forward, lmg_vec3 up, double yfov, lmg_error *err);

/* The room's camera of this name; NULL = its first.  LMG_ERROR_ARGUMENT when there's none; the message lists those there are. */
lmg_result view_camera_from_room(const view_scene *scene, const char *name, view_camera *camera, lmg_error *err);

/*
 * A view of a room without a camera: from near a corner inside, if most lines of sight from its middle end on a surface (a room),
 * else from outside, so that everything is in the picture (an object).  aspect: width / height.
 */
lmg_result view_camera_frame(const view_scene *scene, double aspect, view_camera *camera, lmg_error *err);

/* The direction (unit) in which the camera sees the point (x,y) of a width x height picture, pixels from the upper left corner. */
lmg_vec3 view_camera_direction(const view_camera *camera, double x, double y, double width, double height);

#endif
