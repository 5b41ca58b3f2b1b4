/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Boxes of rounded cells: what rounding may change and by how much, what it must not, and what can't be rounded.  The bounds:
 * errors of Y have an RMS of step / sqrt(6) with steps of at most sqrt(6) x loss x noise; what is handed on from cell to cell keeps
 * the sum over any run of cells to within a step of each class of cells; weights keep four bits (1/16) of the squared standard
 * error, so 3.2 % of it.
 */
#include "box_fixture.h"
#include "cell_code.h"
#include "sampler.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct files {
    char directory[256], path[300];
} files;

static int set_up(void **state)
{
    files *f = calloc(1, sizeof *f);
    assert_non_null(f);
    fixture_directory(f->directory);
    snprintf(f->path, sizeof f->path, "%s/a.box.exr", f->directory);
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    files *f = *state;
    fixture_remove_directory(f->directory);
    free(f);
    return 0;
}

static lmg_field *written_and_read(const lmg_field *field, const char *path, double loss, lmg_rounding *lost)
{
    lmg_error error = {.message = ""};
    lmg_field *back = NULL;
    if (lmg_field_write_rounded(field, path, loss, lost, &error) != LMG_OK || lmg_field_read(path, &back, &error) != LMG_OK)
        fail_msg("%s", error.message);
    return back;
}

static size_t size_of(const char *path)
{
    size_t size;
    free(fixture_load(path, &size));
    return size;
}

static void check_cells(const lmg_field *field, const lmg_field *back, double loss, const lmg_rounding *lost)
{
    double squares = 0, halves = 0, cells = 0;
    for (uint32_t j = 0; j < field->layout.slab_count; j++) {
        const lmg_slab_data *was = &field->slabs[j], *is = &back->slabs[j];
        const uint64_t tile = (uint64_t)field->layout.slabs[j].ns * field->layout.slabs[j].nt;
        double flux = 0; /* of the tile so far */
        for (uint64_t k = 0; k < was->cells; k++) {
            const double y = lmg_cell_luminance(field, j, k), noise = (double)was->standard_error[k],
                         now = lmg_cell_luminance(back, j, k);
            if (k % tile == 0)
                flux = 0;
            if (noise == 0) {
                assert_true(y == 0 && now == 0 && is->standard_error[k] == 0 && is->half_a[k] == 0);
                continue;
            }
            assert_true(fabs(now - y) <= 2 * 2.45 * loss * noise);
            assert_true(fabs((double)is->standard_error[k] / noise - 1) < 0.033);
            const double half = (double)is->half_a[k] - now - ((double)was->half_a[k] - y);
            assert_true(is->half_a[k] >= 0 && fabs(half) <= 0.126 * fabs((double)was->half_a[k] - y) +
                                                                2.5 * loss * fabs((double)was->half_a[k] / y - 1) * noise +
                                                                1e-6 * y);
            for (uint32_t c = 0; c < field->layout.channels; c++) {
                const double x = (double)lmg_cell_radiance(was, k)[c];
                assert_true(fabs((double)lmg_cell_radiance(is, k)[c] - x) <=
                            6 * 2.45 * loss * noise * fmax(x / y, 0.125));
            }
            squares += (now - y) * (now - y) / (noise * noise);
            halves += half * half / (noise * noise);
            cells++;
            flux += (now - y) / (noise * noise / y);
            /* in photons: steps reach sqrt(6) loss sqrt(26) of them, the classes' steps halve, and a tile takes over and hands on
             * half a step of each; as much again for what the fixture's weights of cells differ from their etendues */
            if (k % tile == tile - 1)
                assert_true(fabs(flux) <= 4 * 2.45 * loss * 5.1);
        }
        assert_true(fabs(lmg_field_slab_flux(back, j, NULL) / lmg_field_slab_flux(field, j, NULL) - 1) < 1e-6);
    }
    assert_true(sqrt(squares / cells) <= 1.1 * loss);
    assert_true(fabs(sqrt(squares / cells) - lost->loss) < 0.01 * lost->loss + 1e-4);
    assert_true(fabs(sqrt(halves / cells) - lost->half_loss) < 0.02 * lost->half_loss + 1e-4);
    const lmg_rounding told = lmg_field_rounding(back);
    assert_true(told.loss == lost->loss && told.half_loss == lost->half_loss);
}

static void test_within_noise(void **state)
{
    const files *f = *state;
    for (uint32_t channels = 1; channels <= 3; channels += 2)
        for (int i = 0; i < 2; i++) {
            const double loss = i == 0 ? 0.1 : 0.02;
            lmg_field *field = fixture_photon_field(2, 5, 4, 19, 16, channels, 11);
            lmg_rounding lost;
            lmg_field *back = written_and_read(field, f->path, loss, &lost);
            check_cells(field, back, loss, &lost);
            const size_t small = size_of(f->path);
            unsigned char *once = fixture_load(f->path, &(size_t){0});
            lmg_field_destroy(written_and_read(field, f->path, loss, NULL));
            unsigned char *again = fixture_load(f->path, &(size_t){0});
            assert_int_equal(size_of(f->path), small);
            assert_memory_equal(once, again, small);
            free(once);
            free(again);
            assert_int_equal(lmg_field_write(field, f->path, NULL), LMG_OK);
            if (i == 0)
                assert_true(2 * small < size_of(f->path));
            lmg_field_destroy(back);
            lmg_field_destroy(field);
        }
}

/* Dim light that rounding to the nearest would shift alike everywhere: one or two photons to a cell, of a weight that is no round
 * number.  The sum over every row of (u,v) cells stays. */
static void test_no_bias(void **state)
{
    const files *f = *state;
    lmg_field *field = fixture_photon_field(1, 6, 6, 12, 12, 1, 5);
    lmg_slab_data *d = &field->slabs[0];
    for (uint64_t k = 0; k < d->cells; k++) {
        const double photons = k % 7 < 3 ? 0 : k % 7 < 6 ? 1 : 2;
        /* each cell has a sum of squares of its own, so that no common unit fits */
        const double spread = 1 + 0.7 * (double)(k % 5);
        *lmg_cell_radiance(d, k) = (float)(11.3 * photons);
        d->standard_error[k] = (float)(11.3 * sqrt(photons * spread));
        d->half_a[k] = (float)(k % 2 ? 0 : 22.6 * photons);
    }
    assert_int_equal(lmg_field_prepare(field, NULL), LMG_OK);
    lmg_field *back = written_and_read(field, f->path, 0.1, NULL);
    const uint64_t row = 6 * 12 * 12;
    double changed = 0;
    for (uint64_t k = 0; k < d->cells; k += row) {
        double was = 0, is = 0;
        for (uint64_t i = k; i < k + row; i++) {
            was += (double)*lmg_cell_radiance(d, i);
            is += (double)*lmg_cell_radiance(&back->slabs[0], i);
            changed += fabs((double)*lmg_cell_radiance(d, i) - (double)*lmg_cell_radiance(&back->slabs[0], i)) / 11.3;
        }
        /* at most a quarter of a photon is handed on in each of the few classes, whose cells differ in etendue by up to 9 */
        assert_true(fabs(is - was) < 11.3 * 9);
    }
    assert_true(changed > 0.02 * (double)d->cells); /* something was rounded at all */
    lmg_field_destroy(back);
    lmg_field_destroy(field);
}

static void test_impossible(void **state)
{
    const files *f = *state;
    for (int i = 0; i < 3; i++) {
        lmg_field *field = fixture_photon_field(1, 3, 2, 5, 4, 1, 3);
        lmg_slab_data *d = &field->slabs[0];
        if (i == 0)
            *lmg_cell_radiance(d, 40) = -1; /* no light */
        else if (i == 1)
            *lmg_cell_radiance(d, 40) = 0, d->standard_error[40] = 1; /* nothing known of where nothing is seen */
        else
            for (uint64_t k = 1; k < d->cells; k++) /* too many decades */
                *lmg_cell_radiance(d, k) = *lmg_cell_radiance(d, k - 1) > 0 ? *lmg_cell_radiance(d, k - 1) * 0.7F : 1e20F,
                d->standard_error[k] = 1e-3F * *lmg_cell_radiance(d, k), d->half_a[k] = *lmg_cell_radiance(d, k);
        assert_int_equal(lmg_field_prepare(field, NULL), LMG_OK);
        lmg_rounding lost = {1, 1};
        lmg_field *back = written_and_read(field, f->path, 0.1, &lost);
        const char *difference = fixture_difference(field, back);
        assert_null(difference);
        assert_true(lost.loss == 0 && lost.half_loss == 0);
        lmg_field_destroy(back);
        lmg_field_destroy(field);
    }
    lmg_field *field = fixture_photon_field(1, 3, 2, 5, 4, 1, 3);
    assert_int_equal(lmg_field_write_rounded(field, f->path, 0, NULL, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_write_rounded(field, f->path, 2, NULL, NULL), LMG_ERROR_ARGUMENT);
    assert_int_equal(lmg_field_write_rounded(NULL, f->path, 0.1, NULL, NULL), LMG_ERROR_ARGUMENT);
    lmg_field_destroy(field);
}

/* Every half float that there is, decoded; and the codes that stand for no number. */
static void test_half_floats(void **state)
{
    (void)state;
    const double scale = 1;
    for (uint32_t code = 0; code < 0x10000; code++) {
        uint16_t line[3] = {(uint16_t)code, 0, 0};
        unsigned char bytes[sizeof line];
        float y, error, half;
        memcpy(bytes, line, sizeof line);
        assert_int_equal(lmg_decode_line(bytes, 1, 1, &scale, &y, &error, &half), code < 0x7c00);
        const int exponent = (int)(code >> 10 & 31);
        if (code < 0x7c00)
            assert_true((double)y == (exponent ? ldexp(1024 + (code & 1023), exponent - 25) : ldexp(code, -24)) && half == y &&
                        error == 0);
        const uint16_t other[3] = {0x3c00, (uint16_t)code, 0};
        memcpy(bytes, other, sizeof other);
        assert_int_equal(lmg_decode_line(bytes, 1, 1, &scale, &y, &error, &half), exponent != 31);
    }
}

/* A flipped bit anywhere gives the same field or an error. */
static void test_bit_flips(void **state)
{
    const files *f = *state;
    lmg_field *field = fixture_photon_field(2, 2, 2, 5, 4, 3, 9);
    lmg_field *back = written_and_read(field, f->path, 0.1, NULL);
    size_t size, accepted = 0, tried = 0;
    unsigned char *bytes = fixture_load(f->path, &size);
    for (size_t i = 0; i < 8 * size; i += 3) {
        lmg_field *damaged = NULL;
        lmg_error error = {.message = ""};
        bytes[i / 8] ^= (unsigned char)(1 << i % 8);
        const lmg_result result = lmg_field_read_memory(bytes, size, "flipped", &damaged, &error);
        bytes[i / 8] ^= (unsigned char)(1 << i % 8);
        tried++;
        if (result == LMG_OK) {
            accepted++;
            assert_null(fixture_difference(back, damaged));
        } else {
            assert_true(result >= LMG_ERROR_FILE_READ && result <= LMG_ERROR_FILE_VERSION && error.message[0]);
        }
        lmg_field_destroy(damaged);
    }
    assert_true(accepted < tried / 20);
    free(bytes);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_within_noise), cmocka_unit_test(test_no_bias),   cmocka_unit_test(test_impossible),
        cmocka_unit_test(test_half_floats),  cmocka_unit_test(test_bit_flips),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
