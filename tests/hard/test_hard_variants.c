/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Random lamps from a printed seed: unions of shells of random materials, turned and moved at random.  Whatever they are, the
 * balance of photons closes exactly, threads and splits change nothing, nothing is lost but inside solids that touch others, and
 * the box holds the flux.  Arguments: "long" for 1,000 of them instead of 12; or how many, and from which seed on (1).
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hard.h"
#include "make_model.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double pick(lum_rng *rng, double low, double high)
{
    return low + (high - low) * lum_rng_next(rng);
}

/* A material of any kind; some absorb nothing, some all. */
static uint32_t any_material(lum_model *m, lum_rng *rng)
{
    const double u = lum_rng_next(rng), albedo = u < 0.1 ? 1 : pick(rng, 0, 0.95),
                 roughness = lum_rng_next(rng) < 0.4 ? 0 : pick(rng, 0, 1);
    uint32_t i;
    switch ((int)(6 * lum_rng_next(rng))) {
    case 0:
        return make_lambert(m, (float)albedo);
    case 1:
        return make_mirror(m, (float)albedo, (float)roughness);
    case 2:
        i = make_glass(m, (float)pick(rng, 1, 2.4), (float)roughness, false);
        for (int c = 0; c < 3; ++c)
            m->materials[i].absorption[c] = (float)pick(rng, 0, 20);
        return i;
    case 3:
        return make_glass(m, (float)pick(rng, 1, 2.4), (float)roughness, true);
    case 4:
        i = make_material(m, LUM_SURFACE_PBR);
        m->materials[i].metallic = (float)lum_rng_next(rng);
        m->materials[i].roughness = (float)roughness;
        for (int c = 0; c < 3; ++c)
            m->materials[i].base_color[c] = (float)pick(rng, 0, 0.95);
        return i;
    default:
        return make_lambert(m, 0);
    }
}

/* Turns the vertices from `first` on at random, about the place where they are to be. */
static void scatter_vertices(lum_model *m, uint32_t first, lmg_vec3 place, double scale, lum_rng *rng)
{
    double q[4], n = 0;
    for (int i = 0; i < 4; ++i) {
        q[i] = pick(rng, -1, 1);
        n += q[i] * q[i];
    }
    for (int i = 0; i < 4; ++i)
        q[i] /= sqrt(n);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double r[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                            {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                            {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    const double at[3] = {place.x, place.y, place.z};
    for (uint32_t v = first; v < m->vertex_count; ++v) {
        float *p = m->positions + 3 * (size_t)v, *normal = m->normals + 3 * (size_t)v;
        double a[3], b[3];
        for (int i = 0; i < 3; ++i) {
            a[i] = at[i], b[i] = 0;
            for (int k = 0; k < 3; ++k) {
                a[i] += scale * r[i][k] * (double)p[k];
                b[i] += r[i][k] * (double)normal[k];
            }
        }
        for (int i = 0; i < 3; ++i) {
            p[i] = (float)a[i];
            normal[i] = (float)b[i];
        }
    }
}

static lum_model *variant(uint64_t seed)
{
    lum_rng rng = lum_rng_stream(seed, 0);
    lum_model *m = make_model();
    const double size = pow(10, pick(&rng, -3, 1));
    const int shells = 1 + (int)(6 * lum_rng_next(&rng));
    for (int i = 0; i <= shells; ++i) {
        uint32_t material = i == 0 ? make_lambert(m, (float)pick(&rng, 0, 0.9)) : any_material(m, &rng);
        if (i == 0)
            for (int c = 0; c < 3; ++c)
                m->materials[material].emissive[c] = (float)pick(&rng, 1, 1000);
        const uint32_t first = m->vertex_count;
        const double r = pick(&rng, 0.05, 0.4);
        switch ((int)(3 * lum_rng_next(&rng))) {
        case 0:
            make_sphere(m, v3(0, 0, 0), r, 4 + (uint32_t)(20 * lum_rng_next(&rng)), false, lum_rng_next(&rng) < 0.5, material);
            break;
        case 1:
            make_box(m, v3(-r, -0.7 * r, -0.4 * r), v3(r, 0.7 * r, 0.4 * r), false, 1 + (uint32_t)(3 * lum_rng_next(&rng)),
                     material);
            break;
        default:
            make_quad(m, v3(-r, 0, -r), v3(2 * r, 0, 0), v3(0, 0, 2 * r), 1 + (uint32_t)(4 * lum_rng_next(&rng)), material);
            /* a sheet can't bound a solid */
            if (m->materials[material].transmission > 0)
                m->materials[material].thin = true;
        }
        const lmg_vec3 place = {size * pick(&rng, -0.5, 0.5), size * pick(&rng, -0.5, 0.5), size * pick(&rng, -0.5, 0.5)};
        scatter_vertices(m, first, place, size, &rng);
    }
    finish_model(m);
    return m;
}

static void hash_rays(void *self, const lmg_ray *rays, size_t count)
{
    for (size_t i = 0; i < count; ++i) {
        uint64_t h = rays[i].number;
        const double x[6] = {rays[i].origin.x,    rays[i].origin.y,    rays[i].origin.z,
                             rays[i].direction.x, rays[i].direction.y, rays[i].direction.z};
        for (int k = 0; k < 6; ++k) {
            uint64_t b;
            memcpy(&b, &x[k], sizeof(b));
            h = lum_mix64(h ^ b);
        }
        atomic_fetch_add((_Atomic uint64_t *)self, h);
    }
}

static uint64_t count = 12, seed = 1;

static void test_variants(void **state)
{
    (void)state;
    print_message("variants %llu to %llu\n", (unsigned long long)seed, (unsigned long long)(seed + count - 1));
    enum { PHOTONS = 10000 };
    double worst_lost = 0, worst_inside = 0, worst_box = 0;
    unsigned open = 0, split = 0, dark = 0, boxes = 0;
    for (uint64_t k = seed; k < seed + count; ++k) {
        lum_model *m = variant(k);
        bake_source *s = hard_tracer(m, k);
        lmg_error err = {{0}};
        _Atomic uint64_t whole = 0, parts = 0;
        const lmg_sink a = {&whole, hash_rays}, b = {&parts, hash_rays};
        bake_tally t = {0}, u = {0};
        const lmg_result result = s->run(s, 0, PHOTONS, 1, &a, 1, &t, &err);
        if (result != LMG_OK) { /* shells that close round the light and absorb nothing: a message */
            assert_non_null(strstr(err.message, "trapped"));
            ++dark;
        } else {
            open += t.emitted != t.escaped + t.absorbed + t.lost || t.photons != PHOTONS;
            s->run(s, 0, 3333, 3, &b, 1, &u, NULL);
            s->run(s, 3333, PHOTONS - 3333, 2, &b, 1, &u, NULL);
            if (whole != parts || memcmp(&t, &u, sizeof(t)) != 0) {
                ++split;
                print_message("variant %llu: split in parts it has other photons\n", (unsigned long long)k);
            }
            worst_lost = fmax(worst_lost, (t.lost - t.lost_inside) / t.emitted);
            worst_inside = fmax(worst_inside, t.lost_inside / t.emitted);
            bake_options o = {.photons = PHOTONS, .pilot_photons = 5000, .seed = k, .fit.cells = 5000};
            lmg_field *f;
            bake_report r;
            if (t.escaped > 0.01 * t.emitted && bake_run(m, &o, &f, &r, &err) == LMG_OK) {
                const lmg_ledger l = lmg_field_ledger(f);
                worst_box = fmax(worst_box, fabs((l.stored + l.residual + l.absorbed + l.lost) / l.emitted - 1));
                const lmg_layout *y = lmg_field_layout(f);
                const double e = hard_illuminance(f, v3(y->bounds_min.x - y->size, 0, 0), v3(1, 0, 0), NULL);
                assert_true(isfinite(e) && e >= 0);
                ++boxes;
                lmg_field_destroy(f);
            } else {
                ++dark;
            }
        }
        s->destroy(s);
        free_model(m);
    }
    const char *name = hard_text("%llu random lamps from seed %llu", (unsigned long long)count, (unsigned long long)seed);
    hard_holds(name, "emitted = escaped + absorbed + lost, exactly", open == 0, "%u open, %u of them dark or closed", open, dark);
    hard_holds(name, "1, 2 and 3 threads, one run or two: the same photons to the bit", split == 0, "%u differ", split);
    hard_at_most(name, "lost outside solids, share of the worst", worst_lost, 1e-3);
    hard_holds(name, "lost inside solids (shells cut one another at random): counted", worst_inside <= 1, "%.2g of the worst",
               worst_inside);
    hard_at_most(name, "balance of the boxes, relative, worst", worst_box, 1e-6);
    assert_true(boxes > 0);
}

int main(int argc, char **argv)
{
    const bool all = argc > 1 && strcmp(argv[1], "long") == 0;
    if (argc > 1)
        count = all ? 1000 : strtoull(argv[1], NULL, 10);
    if (argc > 2)
        seed = strtoull(argv[2], NULL, 10);
    hard_begin(all ? "long_variants" : "variants");
    hard_without_traps();
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_variants)};
    return cmocka_run_group_tests_name("hard_variants", tests, NULL, NULL);
}
