/* SPDX-License-Identifier: Apache-2.0 */
/* The public header first and alone in C17. */
#include <lumigraph/lumigraph.h>

_Static_assert(sizeof(lmg_result) == 4 && LMG_OK == 0 && LMG_MAX_SLABS == 32, "constants");

int main(void)
{
    const float white[3] = {1, 1, 1};
    return lmg_luminance(white) > 0.99 && lmg_version()[0] != 0 ? 0 : 1;
}
