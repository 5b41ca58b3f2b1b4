/* SPDX-License-Identifier: Apache-2.0 */
/* Cameras.  Relies on the scene for bounds and lines of sight. */
#include "view_camera.h"

#include <stdio.h>
#include <string.h>

lmg_result view_camera_set(view_camera *camera, lmg_vec3 eye, lmg_vec3 forward, lmg_vec3 up, double yfov, lmg_error *err)
{
    double length = view_length(forward);
    if (!(length > 0) || !isfinite(length)) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "camera: eye and target are the same point");
    }
    if (!(yfov > 0 && yfov < VIEW_PI)) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "camera: a vertical angle of %g degrees is outside (0, 180)",
                        yfov * 180 / VIEW_PI);
    }
    camera->eye = eye;
    camera->forward = view_scale(forward, 1 / length);
    lmg_vec3 right = view_cross(camera->forward, up);
    double across = view_length(right);
    /* Straight up or down to within what a float camera can say: any roll is as good. */
    if (!(across > 1e-6 * view_length(up))) {
        lmg_vec3 other = fabs(camera->forward.z) < 0.5 ? (lmg_vec3){0, 0, -1} : (lmg_vec3){1, 0, 0};
        right = view_cross(camera->forward, other);
        across = view_length(right);
    }
    camera->right = view_scale(right, 1 / across);
    camera->up = view_cross(camera->right, camera->forward);
    camera->half_height = tan(yfov / 2);
    return LMG_OK;
}

lmg_result view_camera_from_room(const view_scene *scene, const char *name, view_camera *camera, lmg_error *err)
{
    const lum_model *model = scene->objects[0].model;
    char names[256] = "";
    for (uint32_t i = 0; i < model->camera_count; i++) {
        const lum_camera *c = &model->cameras[i];
        if (!name || strcmp(name, c->name) == 0) {
            return view_camera_set(camera, view_sub(c->eye, scene->origin), c->forward, c->up, c->yfov, err);
        }
        size_t used = strlen(names);
        snprintf(names + used, sizeof names - used, "%s\"%.60s\"", i ? ", " : "", c->name);
    }
    if (!model->camera_count) {
        return lmg_fail(err, LMG_ERROR_ARGUMENT,
                        "%s: the room has no camera; use --eye and --target, or neither for a view of the whole", model->path);
    }
    return lmg_fail(err, LMG_ERROR_ARGUMENT, "%s: no camera is called \"%s\"; there are %s", model->path, name ? name : "", names);
}

/* The share of 64 lines of sight from p, spread evenly over the sphere (Fibonacci spiral), that end on the room. */
static double enclosure(const view_scene *scene, lmg_vec3 p)
{
    enum { LINES = 64 };
    int hits = 0;
    for (int i = 0; i < LINES; i++) {
        double y = 1 - (2 * i + 1) / (double)LINES, r = sqrt(1 - y * y), phi = i * VIEW_PI * (3 - sqrt(5.0));
        view_hit hit;
        hits += view_scene_intersect(scene, p, (lmg_vec3){r * cos(phi), y, r * sin(phi)}, &hit);
    }
    return hits / (double)LINES;
}

lmg_result view_camera_frame(const view_scene *scene, double aspect, view_camera *camera, lmg_error *err)
{
    lmg_vec3 lower, upper;
    if (!view_scene_bounds(scene, &lower, &upper)) {
        lower = (lmg_vec3){-1, -1, -1};
        upper = (lmg_vec3){1, 1, 1};
    }
    lmg_vec3 middle = view_scale(view_add(lower, upper), 0.5), half = view_scale(view_sub(upper, lower), 0.5);
    const lmg_vec3 y_up = {0, 1, 0};
    /* A room: most lines of sight from the middle, or from a third of the way up in case something hangs there, end on it. */
    lmg_vec3 low = {middle.x, middle.y - half.y / 3, middle.z};
    if (fmin(half.x, fmin(half.y, half.z)) > 0 && fmax(enclosure(scene, middle), enclosure(scene, low)) > 0.7) {
        /* From 6 % of the way off a vertical edge, somewhat above half height, to a point beyond the middle, a little lower. */
        static const double CORNER[4][2] = {{1, 1}, {-1, 1}, {1, -1}, {-1, -1}};
        int best = 0;
        double best_distance = -1;
        for (int i = 0; i < 4; i++) {
            lmg_vec3 eye = {middle.x + 0.88 * CORNER[i][0] * half.x, middle.y + 0.15 * half.y,
                            middle.z + 0.88 * CORNER[i][1] * half.z};
            lmg_vec3 to = view_unit(view_sub((lmg_vec3){middle.x, eye.y, middle.z}, eye));
            view_hit hit;
            double free_distance = view_scene_intersect(scene, eye, to, &hit) ? hit.hit.t : 0;
            if (free_distance > best_distance * 1.05) { /* the first corner unless another sees clearly further */
                best_distance = free_distance;
                best = i;
            }
        }
        lmg_vec3 eye = {middle.x + 0.88 * CORNER[best][0] * half.x, middle.y + 0.15 * half.y,
                        middle.z + 0.88 * CORNER[best][1] * half.z};
        lmg_vec3 target = {middle.x - 0.3 * CORNER[best][0] * half.x, middle.y - 0.15 * half.y,
                           middle.z - 0.3 * CORNER[best][1] * half.z};
        return view_camera_set(camera, eye, view_sub(target, eye), y_up, 60 * VIEW_PI / 180, err);
    }
    double radius = fmax(view_length(half), 1e-3), yfov = 40 * VIEW_PI / 180;
    double narrow = fmin(tan(yfov / 2), tan(yfov / 2) * aspect);
    lmg_vec3 away = view_unit((lmg_vec3){0.6, 0.45, 1});
    /* Far enough for the bounding sphere to fit the narrower angle. */
    lmg_vec3 eye = view_add(middle, view_scale(away, radius / sin(atan(narrow))));
    return view_camera_set(camera, eye, view_minus(away), y_up, yfov, err);
}

lmg_vec3 view_camera_direction(const view_camera *camera, double x, double y, double width, double height)
{
    double up = (1 - 2 * y / height) * camera->half_height, across = (2 * x - width) / height * camera->half_height;
    return view_unit(view_add(camera->forward, view_add(view_scale(camera->right, across), view_scale(camera->up, up))));
}
