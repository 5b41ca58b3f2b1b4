/* SPDX-License-Identifier: Apache-2.0 */
/* The public header first and alone in C++17: it must bring what it needs and mean the same. */
#include <lumigraph/lumigraph.h>

static_assert(sizeof(lmg_result) == 4 && LMG_OK == 0 && LMG_MAX_SLABS == 32, "constants are the same in C++");

int main()
{
    lmg_error error;
    lmg_field *field = nullptr;
    const bool refused = lmg_field_read("", &field, &error) == LMG_ERROR_ARGUMENT && field == nullptr;
    return refused && lmg_version()[0] != 0 ? 0 : 1;
}
