/* SPDX-License-Identifier: Apache-2.0 */
/* Radiance trees as bytes: they come back from files as they were, and survive damaged bytes. */
#include "box_fixture.h"
#include "field.h"
#include "lamp_fixture.h"
#include "trees.h"
#include "trees_fixture.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ---------------------------------------------------------------------------------------------------------------- files */

static lmg_field *read_box(const char *path)
{
    lmg_error err = {{0}};
    lmg_field *field = NULL;
    if (lmg_field_read(path, &field, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return field;
}

static void check_same_trees(const lmg_field *a, const lmg_field *b)
{
    const lmg_tree_totals t = lmg_field_trees(a), u = lmg_field_trees(b);
    assert_true(t.trees == u.trees && t.leaves == u.leaves && t.rays == u.rays && t.looks == u.looks && t.memory == u.memory);
    trees_same_bytes(a->trees, b->trees);
    for (uint64_t i = 0; i < 300; i++) {
        lamp_rng g = lamp_stream(94, i);
        const lmg_ray r = trees_disc_ray(&g, 1.1);
        float at[4];
        double x, y;
        const int root = lmg_trees_root(a->trees, &a->layout, r.origin, r.direction, at);
        assert_true(lmg_trees_luminance(a->trees, root, at, &x) == lmg_trees_luminance(b->trees, root, at, &y) && x == y);
    }
}

static void test_files(void **state)
{
    (void)state;
    char directory[256], first[300], second[300];
    fixture_directory(directory);
    snprintf(first, sizeof first, "%s/a.box.exr", directory);
    snprintf(second, sizeof second, "%s/b.box.exr", directory);
    lmg_field *field = trees_small_field(1, 20000, 8);
    trees_refine(field, 20000, 20000, 1, 0);
    for (int rounded = 0; rounded < 2; rounded++) {
        lmg_error err = {{0}};
        if ((rounded ? lmg_field_write_rounded(field, first, 0.1, NULL, &err) : lmg_field_write(field, first, &err)) != LMG_OK)
            fail_msg("%s", err.message);
        lmg_field *back = read_box(first);
        check_same_trees(field, back);
        if (!rounded) {
            assert_null(fixture_difference(field, back));
            for (uint64_t i = 0; i < 300; i++) {
                lamp_rng g = lamp_stream(93, i);
                const lmg_ray r = trees_disc_ray(&g, 1.1);
                double a, b;
                assert_true(trees_linear(field, &r, &a) == trees_linear(back, &r, &b) && a == b);
            }
        } else { /* as read: rounded once */
            assert_int_equal(lmg_field_write(back, first, NULL), LMG_OK);
        }
        assert_int_equal(lmg_field_write(back, second, NULL), LMG_OK);
        size_t n, m;
        unsigned char *x = fixture_load(first, &n), *y = fixture_load(second, &m);
        assert_int_equal(n, m);
        assert_memory_equal(x, y, n);
        free(x);
        free(y);
        lmg_field_destroy(back);
    }
    trees_grow(field, NULL, 0, 0);
    assert_int_equal(lmg_field_write(field, first, NULL), LMG_OK);
    lmg_field *back = read_box(first);
    assert_int_equal(lmg_field_trees(back).trees, 0);
    lmg_field_destroy(back);
    lmg_field_destroy(field);
    fixture_remove_directory(directory);
}

/* -------------------------------------------------------------------------------------------------------- damaged bytes */

/* docs/format.md: where things are in the bytes of a forest of one root. */
enum {
    AT_VERSION = 0,
    AT_TREES = 4,
    AT_TILINGS = 6,
    AT_LOOKS = 16,
    AT_SLAB = 24,
    AT_TILES = 28,
    AT_KINDS = 30,
    AT_KIND = 32,
    AT_COLOUR = 33,
    AT_UNIT = 45,
    AT_NODES = 53,
    HASH = 8
};

static void make_hash(unsigned char *bytes, size_t size)
{
    const uint64_t hash = lmg_hash(0xcbf29ce484222325u, bytes, size - HASH);
    for (int i = 0; i < HASH; i++)
        bytes[size - HASH + (size_t)i] = (unsigned char)(hash >> (8 * i));
}

/* Bytes of an exact length, so that a sanitizer sees what is read beyond them: refused with a line, or trees that answer with
 * numbers and are stored in the same bytes. */
static lmg_result decode(const unsigned char *bytes, size_t size, const lmg_layout *layout)
{
    unsigned char *exact = malloc(size > 0 ? size : 1);
    assert_non_null(exact);
    memcpy(exact, bytes, size);
    lmg_trees *trees = NULL;
    lmg_error err = {{0}};
    const lmg_result result = lmg_trees_decode(exact, size, layout, &trees, &err);
    if (result != LMG_OK) {
        assert_true(!trees && err.message[0] && (result == LMG_ERROR_FILE_FORMAT || result == LMG_ERROR_FILE_VERSION));
    } else {
        size_t again;
        unsigned char *encoded = lmg_trees_encode(trees, &again);
        assert_non_null(encoded);
        assert_int_equal(again, size);
        assert_memory_equal(encoded, exact, size);
        free(encoded);
        for (uint64_t i = 0; i < 20; i++) {
            lamp_rng g = lamp_stream(92, i);
            const float at[4] = {(float)lamp_next(&g), (float)lamp_next(&g), (float)lamp_next(&g),
                                 i == 0 ? 0 : (float)lamp_next(&g)};
            double variance;
            const double x = lmg_trees_luminance(trees, 0, at, &variance);
            assert_true(isfinite(x) && x >= 0 && isfinite(variance) && variance >= 0);
        }
    }
    lmg_trees_destroy(trees);
    free(exact);
    return result;
}

/* A small forest, with edges. */
static unsigned char *small_forest(lmg_layout *layout, size_t *size)
{
    lmg_field *field = trees_small_field(3, 800, 2);
    trees_refine(field, 500, 500, 1, 0);
    uint32_t edges = 0;
    for (uint32_t i = 0; i < field->trees->trees[1].count; i++)
        edges += field->trees->trees[1].nodes[i].axis == LMG_EDGE;
    assert_true(edges > 0);
    *layout = field->layout;
    unsigned char *bytes = lmg_trees_encode(field->trees, size);
    assert_non_null(bytes);
    assert_true(*size < 1000);
    lmg_field_destroy(field);
    return bytes;
}

static void test_cut_and_flipped(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    assert_int_equal(decode(bytes, size, &layout), LMG_OK);
    for (size_t n = 0; n < size; n++) {
        assert_int_equal(decode(bytes, n, &layout), LMG_ERROR_FILE_FORMAT);
        if (n >= HASH) { /* so that more than the hash is looked at */
            unsigned char tail[HASH];
            memcpy(tail, bytes + n - HASH, HASH);
            make_hash(bytes, n);
            assert_int_equal(decode(bytes, n, &layout), LMG_ERROR_FILE_FORMAT);
            memcpy(bytes + n - HASH, tail, HASH);
        }
    }
    size_t accepted = 0;
    for (size_t i = 0; i < 8 * size; i++) {
        bytes[i / 8] ^= (unsigned char)(1 << i % 8);
        assert_int_equal(decode(bytes, size, &layout), LMG_ERROR_FILE_FORMAT);
        if (i / 8 < size - HASH) {
            make_hash(bytes, size);
            accepted += decode(bytes, size, &layout) == LMG_OK;
        }
        bytes[i / 8] ^= (unsigned char)(1 << i % 8);
        make_hash(bytes, size);
    }
    /* a count or a cut that is another is no damage that shows */
    assert_true(accepted > size && accepted < 8 * size);
    assert_int_equal(decode(bytes, size, &layout), LMG_OK);
    free(bytes);
}

/* Puts count bytes in place, has the forest decoded, and puts back what was there. */
static lmg_result decode_with(unsigned char *bytes, size_t size, const lmg_layout *layout, size_t at, const void *value,
                              size_t count)
{
    unsigned char was[16];
    memcpy(was, bytes + at, count);
    memcpy(bytes + at, value, count);
    make_hash(bytes, size);
    const lmg_result result = decode(bytes, size, layout);
    memcpy(bytes + at, was, count);
    make_hash(bytes, size);
    return result;
}

/* A tree that is a chain of so many forks, each hanging on the first child of that above. */
static size_t make_chain(unsigned char *bytes, size_t forks)
{
    bytes[AT_TREES] = 1;
    for (size_t i = 0; i < forks; i++)
        bytes[AT_NODES + i] = (unsigned char)(0x80 | (i % 4) << 5 | 16);
    memset(bytes + AT_NODES + forks, 100, 2 * (forks + 1));
    const size_t size = AT_NODES + 3 * forks + 2 + HASH;
    make_hash(bytes, size);
    return size;
}

static void test_impossible_forests(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    bytes = realloc(bytes, size + 1);
    assert_non_null(bytes);
#define WITH(place, value) decode_with(bytes, size, &layout, place, &(value), sizeof(value))
    assert_int_equal(WITH(AT_VERSION, (uint32_t){2}), LMG_ERROR_FILE_VERSION);
    static const uint16_t COUNTS[] = {0, 1, 3, LMG_MOST_TREES + 1, 65535};
    for (int i = 0; i < 5; i++) {
        assert_int_equal(WITH(AT_TREES, COUNTS[i]), LMG_ERROR_FILE_FORMAT);
        if (COUNTS[i] != 1)
            assert_int_equal(WITH(AT_TILINGS, COUNTS[i]), LMG_ERROR_FILE_FORMAT);
    }
    assert_int_equal(WITH(AT_SLAB, (uint32_t){1}), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(WITH(AT_SLAB, (uint32_t){UINT32_MAX}), LMG_ERROR_FILE_FORMAT);
    static const uint16_t TILES[] = {0, 1, 0x0100, 0x0111, 0x1101, 0x0102};
    for (int i = 0; i < 6; i++)
        assert_int_equal(WITH(AT_TILES, TILES[i]), LMG_ERROR_FILE_FORMAT);
    static const uint16_t KINDS[] = {0, 2, LMG_MOST_KINDS + 1, 65535};
    for (int i = 0; i < 4; i++)
        assert_int_equal(WITH(AT_KINDS, KINDS[i]), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(WITH(AT_KIND, (uint8_t){1}), LMG_ERROR_FILE_FORMAT);
    static const double NUMBERS[] = {-1, NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 4; i++) {
        assert_int_equal(WITH(AT_UNIT, NUMBERS[i]), LMG_ERROR_FILE_FORMAT);
        if (i > 0)
            assert_int_equal(WITH(AT_COLOUR, (float){(float)NUMBERS[i]}), LMG_ERROR_FILE_FORMAT);
    }
    assert_int_equal(WITH(AT_UNIT, (double){1e300}), LMG_ERROR_FILE_FORMAT); /* radiance beyond any number */
    assert_int_equal(WITH(AT_UNIT, (double){0}), LMG_OK);
#undef WITH
    const lmg_layout finite = trees_one_slab(LMG_SLAB_CUBE, 0.5, 1), slopes = trees_one_slab(LMG_SLAB_CUBE, INFINITY, 1);
    assert_int_equal(decode(bytes, size, &finite), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(decode(bytes, size, &slopes), LMG_OK);
    /* more than there should be, within the hash */
    bytes[size - HASH] = 0;
    make_hash(bytes, size + 1);
    assert_int_equal(decode(bytes, size + 1, &layout), LMG_ERROR_FILE_FORMAT);

    /* as deep as trees may be, deeper, and with leaves that are no wider than a number's last bit */
    unsigned char chain[AT_NODES + 3 * 100000 + 2 + HASH];
    memcpy(chain, bytes, AT_NODES);
    assert_int_equal(decode(chain, make_chain(chain, LMG_TREE_DEPTH - 1), &layout), LMG_OK);
    assert_int_equal(decode(chain, make_chain(chain, LMG_TREE_DEPTH), &layout), LMG_ERROR_FILE_FORMAT);
    assert_int_equal(decode(chain, make_chain(chain, 100000), &layout), LMG_ERROR_FILE_FORMAT);
    const size_t thin = make_chain(chain, LMG_TREE_DEPTH - 1);
    memset(chain + AT_NODES, 0x80 | 3 << 5 | 31, LMG_TREE_DEPTH - 1);
    make_hash(chain, thin);
    decode(chain, thin, &layout);
    memset(chain + AT_NODES, 0x80 | 3 << 5, LMG_TREE_DEPTH - 1);
    make_hash(chain, thin);
    decode(chain, thin, &layout);
    free(bytes);
}

/* A tree over tiles, a leaf for each kind; its size. */
static size_t make_tiled(unsigned char *bytes, uint8_t nu, uint8_t nv, uint16_t kinds, const uint8_t *kind)
{
    unsigned char *at = bytes + AT_TILES;
    bytes[AT_TREES] = 1;
    *at++ = nu;
    *at++ = nv;
    memcpy(at, &kinds, sizeof kinds);
    at += sizeof kinds;
    memcpy(at, kind, (size_t)nu * nv);
    at += (size_t)nu * nv;
    for (int i = 0; i < 3 * kinds; i++, at += sizeof(float))
        memcpy(at, &(float){1}, sizeof(float));
    for (int i = 0; i < kinds; i++, at += sizeof(double))
        memcpy(at, &(double){1}, sizeof(double));
    for (int i = 0; i < kinds; i++) {
        *at++ = 100;
        *at++ = 3;
    }
    const size_t size = (size_t)(at - bytes) + HASH;
    make_hash(bytes, size);
    return size;
}

static void test_impossible_tiles(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    bytes = realloc(bytes, size + 4096);
    assert_non_null(bytes);
    uint8_t kind[17 * 17];
    for (int i = 0; i < 17 * 17; i++)
        kind[i] = (uint8_t)(i % 16);
    static const struct {
        uint8_t nu, nv;
        uint16_t kinds;
        lmg_result result;
    } CASES[] = {
        {16, 16, 16, LMG_OK},
        {16, 1, 16, LMG_OK},
        {4, 4, 16, LMG_OK},
        {0, 1, 16, LMG_ERROR_FILE_FORMAT},
        {1, 0, 16, LMG_ERROR_FILE_FORMAT},
        {17, 1, 16, LMG_ERROR_FILE_FORMAT},
        {1, 17, 16, LMG_ERROR_FILE_FORMAT},
        {16, 16, 15, LMG_ERROR_FILE_FORMAT}, /* a kind too many in its tiles */
        {16, 16, 17, LMG_ERROR_FILE_FORMAT},
        {3, 5, 16, LMG_ERROR_FILE_FORMAT}, /* a kind without tiles */
        {16, 16, 0, LMG_ERROR_FILE_FORMAT},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        size = make_tiled(bytes, CASES[i].nu, CASES[i].nv, CASES[i].kinds, kind);
        assert_int_equal(decode(bytes, size, &layout), CASES[i].result);
    }
    free(bytes);
}

/* An edge as the only node of a root, and what is none. */
static void test_impossible_edges(void **state)
{
    (void)state;
    lmg_layout layout;
    size_t size;
    unsigned char *bytes = small_forest(&layout, &size);
    unsigned char one[AT_NODES + 32];
    memcpy(one, bytes, AT_NODES);
    free(bytes);
    one[AT_TREES] = 1;
    static const struct {
        unsigned char nodes[12];
        size_t count;
        lmg_result result;
    } CASES[] = {
        {{1, 0x7e, 0x77, 15, 0, 100, 3}, 7, LMG_OK},
        {{1, 0x7e, 0x77, 15, 100, 3, 100, 3}, 8, LMG_OK},
        {{1, 0x77, 0x77, 15, 0, 100, 3}, 7, LMG_ERROR_FILE_FORMAT},                   /* no normal */
        {{1, 0x7f, 0x77, 15, 0, 100, 3}, 7, LMG_ERROR_FILE_FORMAT},                   /* one beyond 7 */
        {{1, 0x7e, 0x77, 31, 0, 100, 3}, 7, LMG_ERROR_FILE_FORMAT},                   /* nothing beyond it */
        {{1, 0x7e, 0x77, 15, 0x80, 0, 100, 3, 0}, 9, LMG_ERROR_FILE_FORMAT},          /* a fork below */
        {{1, 0x7e, 0x77, 15, 0, 1, 0x7e, 0x77, 15, 0, 0}, 11, LMG_ERROR_FILE_FORMAT}, /* an edge below */
        {{1, 0x7e, 0x77, 15, 0, 100}, 6, LMG_ERROR_FILE_FORMAT},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        memcpy(one + AT_NODES, CASES[i].nodes, CASES[i].count);
        make_hash(one, AT_NODES + CASES[i].count + HASH);
        assert_int_equal(decode(one, AT_NODES + CASES[i].count + HASH, &layout), CASES[i].result);
    }
    /* none without looks, which would go by boxes alone */
    memcpy(one + AT_NODES, CASES[0].nodes, CASES[0].count);
    memset(one + AT_LOOKS, 0, 8);
    make_hash(one, AT_NODES + CASES[0].count + HASH);
    assert_int_equal(decode(one, AT_NODES + CASES[0].count + HASH, &layout), LMG_ERROR_FILE_FORMAT);
}

/* Codes by themselves: luminance to half a step of 64 an octave, precision to half an octave, in order. */
static void test_codes(void **state)
{
    (void)state;
    assert_true(lmg_leaf_code(0, 1) == 0 && lmg_leaf_code(-1, 1) == 0 && lmg_leaf_code(NAN, 1) == 0 &&
                lmg_leaf_code(1e-30, 1) == 0);
    assert_true(lmg_leaf_part(0) == 0 && lmg_leaf_variance(0) == 0 && lmg_leaf_part(lmg_leaf_code(1, 1)) == 1);
    for (unsigned code = LMG_LEAF_DARKEST << 4; code <= (LMG_LEAF_BRIGHTEST << 4 | 15); code++)
        assert_int_equal(lmg_leaf_code(lmg_leaf_part((uint16_t)code), lmg_leaf_variance((uint16_t)code)), code);
    for (double x = 1; x > 4e-10; x *= 0.9991)
        assert_near(lmg_leaf_part(lmg_leaf_code(x, 0.1)), x, 0.0055 * x);
    for (double v = 3.9; v > 1.3e-4; v *= 0.97) {
        const double back = lmg_leaf_variance(lmg_leaf_code(0.5, v));
        assert_true(back / v < 1.4143 && v / back < 1.4143);
    }
    assert_true(lmg_leaf_variance(lmg_leaf_code(0.5, 1e9)) == 4); /* powers of two are exact */
    assert_true(lmg_leaf_variance(lmg_leaf_code(0.5, 0)) == 4 / 32768.0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_files),
        cmocka_unit_test(test_cut_and_flipped),
        cmocka_unit_test(test_impossible_forests),
        cmocka_unit_test(test_impossible_tiles),
        cmocka_unit_test(test_impossible_edges),
        cmocka_unit_test(test_codes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
