/* SPDX-License-Identifier: Apache-2.0 */
/* lumiview render --lux: parsing and printing; meter.h measures. */
#include "cmd_lux.h"

#include <stdio.h>

bool lux_parse(const char *text, lux_wish *out)
{
    double v[6];
    if (!view_parse_numbers(text, v, 6)) {
        return false;
    }
    double length = hypot(hypot(v[3], v[4]), v[5]);
    if (!(length > 0) || !isfinite(length)) {
        return false;
    }
    out->point = (lmg_vec3){v[0], v[1], v[2]};
    out->normal = view_scale((lmg_vec3){v[3], v[4], v[5]}, 1 / length);
    return true;
}

static void print_line(const lux_wish *wish, const view_reading *r)
{
    printf("illuminance at %g,%g,%g = %.4g lx", wish->point.x, wish->point.y, wish->point.z, r->lux);
    if (r->lux > 0) {
        printf(" +- %.2g %% bake +- %.2g %% render", 100 * r->bake / r->lux, 100 * r->render / r->lux);
    }
    printf("; %llu paths in %.1f s\n", (unsigned long long)r->samples, r->seconds);
}

static json_t *row_of(const lux_wish *wish, const view_reading *r)
{
    return json_pack("{s:[f,f,f], s:[f,f,f], s:f, s:f, s:f, s:[f,f,f], s:[f,f,f], s:I, s:f}", "point", wish->point.x, wish->point.y,
                     wish->point.z, "normal", wish->normal.x, wish->normal.y, wish->normal.z, "illuminance_lx", r->lux,
                     "standard_error_bake_lx", r->bake, "standard_error_render_lx", r->render, "rgb", r->rgb[0], r->rgb[1],
                     r->rgb[2], "rgb_standard_error_render", r->se[0], r->se[1], r->se[2], "paths", (json_int_t)r->samples,
                     "seconds", r->seconds);
}

lmg_result lux_measure(const view_scene *scene, const lux_wish *wishes, size_t count, const view_meter_options *options, bool quiet,
                       json_t *rows, lmg_error *err)
{
    for (size_t i = 0; i < count; i++) {
        const lux_wish *wish = &wishes[i];
        lmg_vec3 point = view_sub(wish->point, scene->origin);
        view_meter_options own = *options;
        own.seed += i << 32; /* meters don't share their chance */
        view_reading reading;
        for (uint32_t b = 0; b < scene->box_count && !quiet; b++) {
            if (view_box_inside(&scene->boxes[b], point)) {
                fprintf(stderr, "warning: %s: the meter at %g,%g,%g is inside the bounds of this box and gets none of its light\n",
                        scene->boxes[b].path, wish->point.x, wish->point.y, wish->point.z);
            }
        }
        lmg_result r = view_meter_read(scene, point, wish->normal, &own, &reading, err);
        if (r != LMG_OK) {
            return r;
        }
        if (reading.refused && !quiet) {
            fprintf(stderr, "warning: %llu paths gave no finite number and count as dark\n", (unsigned long long)reading.refused);
        }
        if (rows) {
            json_array_append_new(rows, row_of(wish, &reading));
        } else {
            print_line(wish, &reading);
        }
    }
    return LMG_OK;
}
