/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Two readers, one text: the library against the reader that knows docs/format.md only.  Cell by cell, number by number, over both
 * kinds of slab, both numbers of channels, non-square and prime resolutions; the cell that a ray belongs to; and the test vector that
 * the text prints.
 */
#include "../unit/box_fixture.h"
#include "box_reader.h"
#include "field.h"
#include "exr_write.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void assert_vec(const double a[3], lmg_vec3 b)
{
    assert_true(a[0] == b.x && a[1] == b.y && a[2] == b.z);
}

static void assert_floats(const float *a, const float *b, uint64_t count, const char *what)
{
    for (uint64_t i = 0; i < count; i++) {
        if (memcmp(a + i, b + i, sizeof *a) != 0) {
            fail_msg("%s %llu: %g and %g", what, (unsigned long long)i, (double)a[i], (double)b[i]);
        }
    }
}

static void compare(const lmg_field *field, const box *b)
{
    const lmg_layout *l = &field->layout;
    assert_int_equal(b->slabs, l->slab_count);
    assert_int_equal(b->channels, l->channels);
    assert_floats(b->colour, l->colour, 3, "colour");
    assert_vec(b->bounds_min, l->bounds_min);
    assert_vec(b->bounds_max, l->bounds_max);
    assert_true(b->size == l->size && b->photons == field->ledger.photons);
    const lmg_ledger *g = &field->ledger;
    const double flux[5][2] = {{g->emitted, g->emitted_se}, {g->stored, g->stored_se}, {g->residual, g->residual_se}, {g->absorbed, g->absorbed_se},
                               {g->lost, g->lost_se}};
    assert_memory_equal(flux, b->flux, sizeof flux);
    assert_int_equal(b->texts, field->text_count);
    for (int i = 0; i < b->texts; i++) {
        assert_string_equal(b->text[i], lmg_field_get_text(field, b->text_name[i]));
    }
    for (int i = 0; i < b->slabs; i++) {
        const lmg_slab *s = &l->slabs[i];
        const box_slab *t = &b->slab[i];
        assert_int_equal(t->aperture, s->kind == LMG_SLAB_APERTURE);
        assert_vec(t->o, s->o);
        assert_vec(t->a, s->a);
        assert_vec(t->b, s->b);
        assert_vec(t->n, s->n);
        assert_true(t->distance == s->distance && t->u[0] == s->u0 && t->u[1] == s->u1 && t->v[0] == s->v0 && t->v[1] == s->v1);
        assert_true(t->s[0] == s->s0 && t->s[1] == s->s1 && t->t[0] == s->t0 && t->t[1] == s->t1);
        assert_true(t->nu == s->nu && t->nv == s->nv && t->ns == s->ns && t->nt == s->nt);
        const lmg_slab_data *d = &field->slabs[i];
        for (uint64_t cell = 0; cell < d->cells; cell++) {
            assert_floats(t->radiance + cell * l->channels, lmg_cell_radiance(d, cell), l->channels, "radiance");
        }
        assert_floats(t->standard_error, d->standard_error, d->cells, "standard error");
        assert_floats(t->half_a, d->half_a, d->cells, "half A");
    }
}

/* Both readers say the same of a file, which is of this version. */
static void read_both(const char *path, int version)
{
    lmg_error error = {.message = ""};
    char message[256] = "";
    lmg_field *back = NULL;
    if (lmg_field_read(path, &back, &error) != LMG_OK) {
        fail_msg("%s", error.message);
    }
    box *b = malloc(sizeof *b);
    assert_non_null(b);
    if (box_read(path, b, message) != 0) {
        fail_msg("the reference reader says: %s", message);
    }
    assert_int_equal(b->version, version);
    compare(back, b);
    const lmg_rounding lost = lmg_field_rounding(back);
    assert_true(b->rounding[0] == lost.loss && b->rounding[1] == lost.half_loss);
    box_free(b);
    free(b);
    lmg_field_destroy(back);
}

static void both_ways(lmg_field *field, const char *path, lmg_exr_compression compression)
{
    lmg_error error = {.message = ""};
    if (lmg_field_write_as(field, path, compression, 4, &error) != LMG_OK) {
        fail_msg("%s", error.message);
    }
    read_both(path, 1);
}

static void test_same_cells(void **state)
{
    (void)state;
    char directory[256], path[300];
    fixture_directory(directory);
    snprintf(path, sizeof path, "%s/a.box.exr", directory);
    uint64_t seed = 100;
    for (uint32_t slabs = 1; slabs <= 8; slabs += slabs == 2 ? 5 : 1) {
        for (int aperture = 0; aperture < 2; aperture++) {
            for (uint32_t channels = 1; channels <= 3; channels += 2) {
                lmg_field *field = fixture_field(slabs, aperture == 1, channels, seed++);
                both_ways(field, path, seed % 3 == 0 ? LMG_EXR_NONE : LMG_EXR_ZIP);
                lmg_field_destroy(field);
            }
        }
    }
    for (uint32_t channels = 1; channels <= 3; channels += 2) { /* tiles that do compress */
        lmg_field *field = fixture_photon_field(2, 7, 3, 23, 13, channels, seed++);
        both_ways(field, path, LMG_EXR_ZIP);
        lmg_error error = {.message = ""};
        if (lmg_field_write_rounded(field, path, 0.1, NULL, &error) != LMG_OK) {
            fail_msg("%s", error.message);
        }
        read_both(path, 2);
        lmg_field_destroy(field);
    }
    fixture_remove_directory(directory);
}

/* The reference reader is an oracle only if it would notice: a field with one cell, one attribute or two cells changed must fail. */
static void test_notices(void **state)
{
    (void)state;
    char directory[256], path[300], message[256] = "";
    fixture_directory(directory);
    snprintf(path, sizeof path, "%s/a.box.exr", directory);
    lmg_field *field = fixture_field(2, true, 3, 3);
    assert_int_equal(lmg_field_write_as(field, path, LMG_EXR_NONE, 0, NULL), LMG_OK);
    box *b = malloc(sizeof *b);
    assert_non_null(b);
    assert_int_equal(box_read(path, b, message), 0);
    const uint64_t right = box_hash(b);
    b->slab[1].radiance[7] += 1;
    assert_true(box_hash(b) != right);
    b->slab[1].radiance[7] -= 1;
    b->slab[0].u[1] *= 2;
    assert_true(box_hash(b) != right);
    box_free(b);
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, -5, SEEK_END), 0);
    assert_int_equal(fputc(0x12, file), 0x12);
    fclose(file);
    assert_int_equal(box_read(path, b, message), -1);
    assert_string_equal(message, "content hash");
    box_free(b);
    free(b);
    lmg_field_destroy(field);
    fixture_remove_directory(directory);
}

/* Which cell a ray belongs to, and the ray of a cell: the text's formulas against the library's geometry. */
static void test_same_rays(void **state)
{
    (void)state;
    char directory[256], path[300], message[256] = "";
    fixture_directory(directory);
    snprintf(path, sizeof path, "%s/a.box.exr", directory);
    lmg_field *field = fixture_field(8, true, 1, 5);
    assert_int_equal(lmg_field_write(field, path, NULL), LMG_OK);
    box *b = malloc(sizeof *b);
    assert_non_null(b);
    assert_int_equal(box_read(path, b, message), 0);
    srand(7);
    int placed[8] = {0}, missed = 0;
    for (int round = 0; round < 200000; round++) {
        double x[6];
        for (int i = 0; i < 6; i++) {
            x[i] = rand() / (double)RAND_MAX - 0.5;
        }
        const double origin[3] = {0.3 * x[0], 0.3 * x[1], 0.3 * x[2]}, direction[3] = {x[3], x[4], x[5]};
        const double length = sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5]);
        uint32_t cell[4];
        const int mine = box_find(b, origin, direction, cell);
        double uvst[4];
        const int theirs = lmg_layout_owner(&field->layout, (lmg_vec3){origin[0], origin[1], origin[2]},
                                            (lmg_vec3){x[3] / length, x[4] / length, x[5] / length}, uvst);
        assert_int_equal(mine, theirs);
        if (mine < 0) {
            missed++;
            continue;
        }
        placed[mine]++;
        const lmg_slab *s = &field->layout.slabs[mine];
        const double lo[4] = {s->u0, s->v0, s->s0, s->t0}, hi[4] = {s->u1, s->v1, s->s1, s->t1};
        const uint32_t cells[4] = {s->nu, s->nv, s->ns, s->nt};
        for (int i = 0; i < 4; i++) {
            const double place = (uvst[i] - lo[i]) / (hi[i] - lo[i]) * cells[i];
            /* within the cell; 1e-9 of one covers both roundings (a dozen operations of 2^-53 on numbers of order 1) */
            assert_true(place > cell[i] - 1e-9 && place < cell[i] + 1 + 1e-9);
        }
        double from[3], along[3];
        box_ray(&b->slab[mine], cell, from, along);
        const double middle[4] = {lo[0] + (hi[0] - lo[0]) * (cell[0] + 0.5) / cells[0], lo[1] + (hi[1] - lo[1]) * (cell[1] + 0.5) / cells[1],
                                  lo[2] + (hi[2] - lo[2]) * (cell[2] + 0.5) / cells[2], lo[3] + (hi[3] - lo[3]) * (cell[3] + 0.5) / cells[3]};
        lmg_vec3 their_origin, their_direction;
        lmg_slab_ray(s, middle, &their_origin, &their_direction);
        const double eps = 1e-12; /* metres and direction cosines of order 1, the same dozen operations */
        assert_true(fabs(from[0] - their_origin.x) < eps && fabs(from[1] - their_origin.y) < eps && fabs(from[2] - their_origin.z) < eps);
        assert_true(fabs(along[0] - their_direction.x) < eps && fabs(along[1] - their_direction.y) < eps &&
                    fabs(along[2] - their_direction.z) < eps);
    }
    assert_true(missed > 100);
    for (int i = 0; i < 6; i++) { /* the last two lie behind the first two; the test is about six kinds of place */
        assert_true(placed[i] > 100);
    }
    box_free(b);
    free(b);
    lmg_field_destroy(field);
    fixture_remove_directory(directory);
}

/* The box of section "Test vector": if this fails, the text has to change with the format. */
static void test_vector(void **state)
{
    (void)state;
    lmg_layout l = {.slab_count = 1,
                    .channels = 1,
                    .colour = {1, 1, 1},
                    .bounds_min = {-1, -1, -1},
                    .bounds_max = {1, 1, 1},
                    .size = 2,
                    .slabs = {{.kind = LMG_SLAB_APERTURE,
                               .o = {0, 0, 1},
                               .a = {1, 0, 0},
                               .b = {0, 1, 0},
                               .n = {0, 0, 1},
                               .distance = INFINITY,
                               .u0 = -1,
                               .u1 = 1,
                               .v0 = -1,
                               .v1 = 1,
                               .s0 = -1,
                               .s1 = 1,
                               .t0 = -1,
                               .t1 = 1,
                               .nu = 2,
                               .nv = 1,
                               .ns = 3,
                               .nt = 2}}};
    lmg_field *field = NULL;
    assert_int_equal(lmg_field_allocate(&l, &field, NULL), LMG_OK);
    for (int i = 0; i < 12; i++) {
        *lmg_cell_radiance(&field->slabs[0], (uint64_t)i) = (float)i;
        field->slabs[0].standard_error[i] = 0.5f;
        field->slabs[0].half_a[i] = (float)(12 - i);
    }
    field->ledger = (lmg_ledger){.photons = 1000, .emitted = 100, .stored = 80, .absorbed = 20, .stored_se = 1, .absorbed_se = 1};
    assert_int_equal(lmg_field_set_text(field, "model", "test", NULL), LMG_OK);
    assert_int_equal(lmg_field_prepare(field, NULL), LMG_OK);
    char directory[256], path[300], message[256] = "";
    fixture_directory(directory);
    snprintf(path, sizeof path, "%s/a.box.exr", directory);
    assert_int_equal(lmg_field_write_as(field, path, LMG_EXR_NONE, 0, NULL), LMG_OK);
    box *b = malloc(sizeof *b);
    assert_non_null(b);
    assert_int_equal(box_read(path, b, message), 0);
    size_t size;
    unsigned char *bytes = fixture_load(path, &size);
    char hash[24], words[64], text[32768];
    snprintf(hash, sizeof hash, "%016llx", (unsigned long long)b->hash);
    snprintf(words, sizeof words, "%zu bytes", size);
    FILE *file = fopen(LUMIBOX_SOURCE_DIR "/docs/format.md", "r");
    assert_non_null(file);
    text[fread(text, 1, sizeof text - 1, file)] = 0;
    fclose(file);
    if (strstr(text, hash) == NULL || strstr(text, words) == NULL) {
        fail_msg("docs/format.md doesn't name the test vector's hash %s and its %s", hash, words);
    }
    /* the tile of u cell 1 is the last of the file: 20 bytes of leader, then two lines of Y, half_a.Y, stderr.Y */
    float tile[18];
    memcpy(tile, bytes + size - sizeof tile, sizeof tile);
    const float expected[18] = {6, 7, 8, 6, 5, 4, 0.5f, 0.5f, 0.5f, 9, 10, 11, 3, 2, 1, 0.5f, 0.5f, 0.5f};
    assert_memory_equal(tile, expected, sizeof tile);
    free(bytes);
    box_free(b);
    free(b);
    lmg_field_destroy(field);
    fixture_remove_directory(directory);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_same_cells),
        cmocka_unit_test(test_notices),
        cmocka_unit_test(test_same_rays),
        cmocka_unit_test(test_vector),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
