/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Fuzz target of the readers of photometric files (LM-63, EULUMDAT, TM-33): any bytes are either refused with one line or give a
 * distribution that passes its check, has a finite flux and can be asked anywhere.  Built into test_photometry, which replays its
 * corpus, and with clang -fsanitize=fuzzer as it stands.
 */
#include "fuzz.h"

#include <luminaires/photometry.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    lum_photometry *p;
    lmg_error err = {{0}};
    if (lum_photometry_read_memory(bytes, size, "fuzz", &p, &err) != LMG_OK) {
        if (p)
            abort();
        fuzz_check_message(&err);
        return 0;
    }
    lum_photometry_measures m;
    if (lum_photometry_check(p, &err) != LMG_OK || strchr(p->warnings, '\n'))
        abort();
    if ((uint64_t)p->h_count * p->v_count <= 100000) {
        if (lum_photometry_measure(p, &m, &err) != LMG_OK || !isfinite(m.flux) || m.flux < 0 || !(m.peak >= 0))
            abort();
        for (int i = 0; i < 64; ++i) {
            const double x = lum_photometry_intensity(p, lum_direction_from_c_gamma(360.0 * (i % 8) / 8, 180.0 * (i / 8) / 7));
            if (!(x >= 0 && x <= m.peak * (1 + 1e-9)))
                abort();
        }
        lum_profile *profile;
        if (lum_profile_create(p, &profile, &err) == LMG_OK)
            lum_profile_destroy(profile);
    }
    lum_photometry_destroy(p);
    return 0;
}
