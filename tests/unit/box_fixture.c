/* SPDX-License-Identifier: Apache-2.0 */
/* Fields for the tests of box files.  Relies on the inside of the library (field.h), to set cells that no accumulator would make. */
#include "box_fixture.h"
#include "field.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <dirent.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* SplitMix64 (Steele, Lea, Flood 2014). */
static uint64_t next(uint64_t *state)
{
    uint64_t z = *state += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}

static double uniform(uint64_t *state)
{
    return (double)(next(state) >> 11) * 0x1p-53;
}

static void cube_frame(lmg_slab *slab, uint32_t face)
{
    static const lmg_vec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    const lmg_vec3 e = axes[face / 2];
    const double sign = face % 2 == 0 ? 1 : -1;
    slab->n = (lmg_vec3){sign * e.x, sign * e.y, sign * e.z};
    slab->a = axes[(face / 2 + 1) % 3];
    /* b = n x a */
    slab->b = (lmg_vec3){slab->n.y * slab->a.z - slab->n.z * slab->a.y, slab->n.z * slab->a.x - slab->n.x * slab->a.z,
                         slab->n.x * slab->a.y - slab->n.y * slab->a.x};
}

static lmg_layout layout(uint32_t slabs, bool aperture, uint32_t channels)
{
    static const uint32_t cells[4][4] = {{3, 2, 5, 7}, {2, 5, 3, 1}, {1, 3, 2, 5}, {5, 1, 1, 3}};
    lmg_layout l = {.slab_count = slabs, .channels = channels, .size = 0.2385};
    l.colour[0] = channels == 1 ? 1.25f : 1.0f;
    l.colour[1] = channels == 1 ? 0.9375f : 1.0f;
    l.colour[2] = channels == 1 ? (float)((1 - 0.2126 * 1.25 - 0.7152 * 0.9375) / 0.0722) : 1.0f; /* luminance 1 */
    l.bounds_min = (lmg_vec3){-0.131, -0.217, -0.093};
    l.bounds_max = (lmg_vec3){0.171, 0.129, 0.233};
    for (uint32_t i = 0; i < slabs; i++) {
        lmg_slab *s = &l.slabs[i];
        *s = (lmg_slab){.kind = LMG_SLAB_CUBE,
                        .o = {0.0125, -0.03, 0.04},
                        .distance = INFINITY,
                        .u0 = -0.11,
                        .u1 = 0.13,
                        .v0 = -0.17,
                        .v1 = 0.07,
                        .s0 = -1,
                        .s1 = 1,
                        .t0 = -1,
                        .t1 = 1,
                        .nu = cells[i % 4][0],
                        .nv = cells[i % 4][1],
                        .ns = cells[i % 4][2],
                        .nt = cells[i % 4][3]};
        cube_frame(s, i % 6);
        if (aperture && i == 0) {
            s->kind = LMG_SLAB_APERTURE;
            const double c = cos(0.7), d = sin(0.7), e = cos(-2.385), f = sin(-2.385);
            s->a = (lmg_vec3){c * e, d * e, -f};
            s->b = (lmg_vec3){-d, c, 0};
            s->n = (lmg_vec3){c * f, d * f, e};
        } else if (i % 2 == 1) {
            s->distance = 0.7;
            s->s0 = -0.93, s->s1 = 0.81, s->t0 = -0.79, s->t1 = 0.97;
        }
    }
    return l;
}

static void fill(lmg_field *field, uint64_t seed)
{
    for (uint32_t i = 0; i < field->layout.slab_count; i++) {
        lmg_slab_data *d = &field->slabs[i];
        const uint64_t values = d->cells * field->layout.channels;
        for (uint64_t k = 0; k < values; k++) {
            const double x = uniform(&seed);
            float *r = lmg_cell_radiance(d, k / field->layout.channels) + k % field->layout.channels;
            *r = x < 0.2 ? 0.0f : (float)(1000 * x * x * uniform(&seed));
            if (field->layout.channels == 3 && x > 0.98) {
                *r *= -0.001f; /* out of gamut, luminance still positive */
            }
        }
        for (uint64_t k = 0; k < d->cells; k++) {
            d->standard_error[k] = (float)(3 * uniform(&seed));
            d->half_a[k] = (float)(500 * uniform(&seed));
        }
        d->standard_error[0] = FLT_TRUE_MIN;
        d->half_a[0] = FLT_MIN;
        d->standard_error[d->cells - 1] = 1e30f;
        d->half_a[d->cells - 1] = -0.0f;
    }
}

static lmg_field *finish(lmg_field *field)
{
    lmg_error error = {.message = ""};
    field->ledger = (lmg_ledger){.photons = 12345678901234567891u,
                                 .emitted = 803.5,
                                 .stored = 611.25,
                                 .residual = 0.03125,
                                 .absorbed = 192.1,
                                 .lost = 1.0 / 3,
                                 .emitted_se = 0,
                                 .stored_se = 0.2,
                                 .residual_se = 1e-4,
                                 .absorbed_se = 0.21,
                                 .lost_se = 1e-300};
    assert_int_equal(lmg_field_set_text(field, "model", "lampe \"\xc3\xa9t\xc3\xa9\".gltf", &error), LMG_OK);
    assert_int_equal(lmg_field_set_text(field, "seed", "42", &error), LMG_OK);
    assert_int_equal(lmg_field_set_text(field, "empty", "", &error), LMG_OK);
    if (lmg_field_prepare(field, &error) != LMG_OK) {
        fail_msg("fixture: %s", error.message);
    }
    return field;
}

lmg_field *fixture_field(uint32_t slabs, bool aperture, uint32_t channels, uint64_t seed)
{
    const lmg_layout l = layout(slabs, aperture, channels);
    lmg_error error = {.message = ""};
    if (lmg_layout_check(&l, &error) != LMG_OK) {
        fail_msg("fixture: %s", error.message);
    }
    lmg_field *field = NULL;
    assert_int_equal(lmg_field_allocate(&l, &field, &error), LMG_OK);
    fill(field, seed);
    return finish(field);
}

lmg_field *fixture_photon_field(uint32_t slabs, uint32_t nu, uint32_t nv, uint32_t ns, uint32_t nt, uint32_t channels, uint64_t seed)
{
    lmg_layout l = layout(slabs, false, channels);
    l.bounds_min = (lmg_vec3){-0.1, -0.1, -0.1};
    l.bounds_max = (lmg_vec3){0.1, 0.1, 0.1};
    for (uint32_t i = 0; i < slabs; i++) { /* the faces of the bounds: what a bake without pilot would use */
        lmg_slab *s = &l.slabs[i];
        s->o = (lmg_vec3){0.1 * s->n.x, 0.1 * s->n.y, 0.1 * s->n.z};
        s->distance = INFINITY;
        s->u0 = s->v0 = -0.1, s->u1 = s->v1 = 0.1;
        s->s0 = s->t0 = -1, s->s1 = s->t1 = 1;
        s->nu = nu, s->nv = nv, s->ns = ns, s->nt = nt;
    }
    lmg_error error = {.message = ""};
    if (slabs > 6 || lmg_layout_check(&l, &error) != LMG_OK) {
        fail_msg("fixture: %u slabs; %s", slabs, error.message);
    }
    lmg_field *field = NULL;
    assert_int_equal(lmg_field_allocate(&l, &field, &error), LMG_OK);
    for (uint32_t i = 0; i < slabs; i++) {
        lmg_slab_data *d = &field->slabs[i];
        for (uint64_t k = 0; k < d->cells; k++) {
            /* a lobe over (s,t) that lights about half of the cells, photons counted in each, cells of unequal etendue */
            const uint32_t is = (uint32_t)(k % ns), it = (uint32_t)(k / ns % nt);
            const double p = 2 * (is + 0.5) / ns - 1, q = 2 * (it + 0.5) / nt - 1, lobe = 20 * (1 - 1.3 * (p * p + q * q));
            const double mean = lobe > 0 ? lobe : 0, spread = sqrt(mean) * (uniform(&seed) + uniform(&seed) - 1) * 2.45;
            const double count = fmax(0, floor(mean + spread + 0.5)), per_count = 37.25 * (1 + p * p + q * q) * (1 + p * p + q * q);
            for (uint32_t c = 0; c < channels; c++) {
                lmg_cell_radiance(d, k)[c] = (float)(count * per_count * (1 - 0.1 * c));
            }
            d->standard_error[k] = (float)(sqrt(count) * per_count);
            d->half_a[k] = (float)(2 * floor(count / 2 * (0.5 + uniform(&seed))) * per_count);
        }
    }
    return finish(field);
}

const char *fixture_difference(const lmg_field *a, const lmg_field *b)
{
    const lmg_layout *p = &a->layout, *q = &b->layout;
    if (p->slab_count != q->slab_count || p->channels != q->channels || memcmp(p->colour, q->colour, sizeof p->colour) != 0) {
        return "slab count, channels or colour";
    }
    if (memcmp(&p->bounds_min, &q->bounds_min, sizeof p->bounds_min) != 0 ||
        memcmp(&p->bounds_max, &q->bounds_max, sizeof p->bounds_max) != 0 || memcmp(&p->size, &q->size, sizeof p->size) != 0) {
        return "bounds or size";
    }
    if (memcmp(&a->ledger, &b->ledger, sizeof a->ledger) != 0) {
        return "ledger";
    }
    if (a->text_count != b->text_count) {
        return "number of texts";
    }
    for (size_t i = 0; i < a->text_count; i++) {
        if (strcmp(a->texts[i].name, b->texts[i].name) != 0 || strcmp(a->texts[i].value, b->texts[i].value) != 0) {
            return "a text";
        }
    }
    for (uint32_t i = 0; i < p->slab_count; i++) {
        const lmg_slab *s = &p->slabs[i], *t = &q->slabs[i];
        if (s->kind != t->kind || memcmp(&s->o, &t->o, offsetof(lmg_slab, nu) - offsetof(lmg_slab, o)) != 0) { /* doubles without gaps */
            return "a slab's kind or geometry";
        }
        if (s->nu != t->nu || s->nv != t->nv || s->ns != t->ns || s->nt != t->nt) {
            return "a slab's resolution";
        }
        const lmg_slab_data *d = &a->slabs[i], *e = &b->slabs[i];
        if (memcmp(d->cell, e->cell, d->cells * d->stride * sizeof(float)) != 0) {
            return "radiance or slopes";
        }
        if (memcmp(d->standard_error, e->standard_error, d->cells * sizeof(float)) != 0) {
            return "standard errors";
        }
        if (memcmp(d->half_a, e->half_a, d->cells * sizeof(float)) != 0) {
            return "half A";
        }
        if (d->flux != e->flux || d->flux_se != e->flux_se) {
            return "a slab's flux";
        }
    }
    return NULL;
}

unsigned char *fixture_load(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    assert_int_equal(fseek(file, 0, SEEK_END), 0);
    const long length = ftell(file);
    assert_true(length >= 0);
    rewind(file);
    unsigned char *bytes = malloc((size_t)length + 1);
    assert_non_null(bytes);
    assert_int_equal(fread(bytes, 1, (size_t)length, file), length);
    fclose(file);
    *size = (size_t)length;
    return bytes;
}

void fixture_directory(char path[256])
{
    const char *base = getenv("TMPDIR");
    snprintf(path, 256, "%s/lumibox-test-XXXXXX", base != NULL && strlen(base) < 200 ? base : "/tmp");
    assert_non_null(mkdtemp(path));
}

void fixture_remove_directory(const char *path)
{
    DIR *directory = opendir(path);
    assert_non_null(directory);
    for (struct dirent *entry; (entry = readdir(directory)) != NULL;) {
        char name[1024];
        snprintf(name, sizeof name, "%s/%s", path, entry->d_name);
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0 && unlink(name) != 0) {
            assert_int_equal(rmdir(name), 0);
        }
    }
    closedir(directory);
    assert_int_equal(rmdir(path), 0);
}
