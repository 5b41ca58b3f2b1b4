/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fuzz target of box files: any bytes are refused with one line or give a field that answers every question with finite numbers,
 * and whose own file reads back.  (Built for fuzzing, the reader takes boxes whatever their content hash says; otherwise hardly any
 * change would get past it.)
 */
#include "fuzz.h"

#include <math.h>

/* Asks what costs little however large the field is. */
static void ask(const lmg_field *f)
{
    const lmg_layout *y = lmg_field_layout(f);
    const lmg_vec3 lo = y->bounds_min, hi = y->bounds_max;
    for (int i = 0; i < 27; ++i) {
        const lmg_vec3 p = {lo.x + (hi.x - lo.x) * (i % 3 - 0.5), lo.y + (hi.y - lo.y) * (i / 3 % 3 - 0.5),
                            lo.z + (hi.z - lo.z) * (i / 9 - 0.5)};
        const lmg_vec3 d = {0.6 * (i % 2 ? 1 : -1), 0.64, 0.48};
        float rgb[3], se;
        for (int filter = LMG_NEAREST; filter <= LMG_LINEAR; ++filter) {
            lmg_field_radiance(f, p, d, (lmg_filter)filter, rgb, &se);
            if (!(isfinite(rgb[0]) && isfinite(rgb[1]) && isfinite(rgb[2]) && se >= 0))
                abort();
        }
        const double xi[5] = {i / 27.0, 0.5, 0.25, 0.75, 0.125};
        lmg_point_sample s;
        if (lmg_field_sample_point(f, p, xi, &s) && (lmg_field_sample_radiance(f, &s, rgb), !(s.pdf > 0 && isfinite(rgb[0]))))
            abort();
        lmg_ray ray;
        if (lmg_field_emit(f, xi, &ray) && !isfinite(ray.origin.x + ray.origin.y + ray.origin.z))
            abort();
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    lmg_error err = {{0}};
    lmg_field *f = NULL;
    if (lmg_field_read_memory(bytes, size, "fuzz", &f, &err) != LMG_OK) {
        if (f)
            abort();
        fuzz_check_message(&err);
        return 0;
    }
    ask(f);
    lmg_field_destroy(f);
    return 0;
}
