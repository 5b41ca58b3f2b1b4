/* SPDX-License-Identifier: Apache-2.0 */
/* Scattering at surfaces: samples against densities (scatter_compare.h), energy, reciprocity, tilted shading normals, tables. */
#include "../../luminaires/src/microfacet.h"
#include "scatter_compare.h"

#include <luminaires/rng.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

/* One quad per material; triangle 2 i has material i. */
static lum_scene *scene_of(lum_model *model)
{
    lum_scene *scene;
    for (uint32_t i = 0; i < model->material_count; i++) {
        make_quad(model, v3(-1, -1, -1.0 * i), v3(2, 0, 0), v3(0, 2, 0), 1, i);
    }
    finish_model(model);
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    return scene;
}

typedef struct scattering_case {
    const char *name;
    lum_surface_kind kind;
    float metallic, transmission, diffuse_transmission, ior;
    bool thin, eta;
} scattering_case;

static const scattering_case CASES[] = {
    {"Lambert", LUM_SURFACE_LAMBERT, 0, 0, 0, 1.5f, false, false},
    {"Lambert, part through", LUM_SURFACE_LAMBERT, 0, 0, 0.3f, 1.5f, false, false},
    {"metal", LUM_SURFACE_CONDUCTOR, 0, 0, 0, 1.5f, false, false},
    {"metal of index eta, k", LUM_SURFACE_CONDUCTOR, 0, 0, 0, 1.5f, false, true},
    {"coated diffuser", LUM_SURFACE_PBR, 0, 0, 0, 1.5f, false, false},
    {"coated diffuser, part through", LUM_SURFACE_PBR, 0, 0, 0.4f, 1.5f, false, false},
    {"half metal", LUM_SURFACE_PBR, 0.45f, 0, 0, 1.5f, false, false},
    {"glass", LUM_SURFACE_PBR, 0, 1, 0, 1.52f, false, false},
    {"half glass", LUM_SURFACE_PBR, 0, 0.6f, 0.2f, 1.52f, false, false},
    {"pane", LUM_SURFACE_PBR, 0, 1, 0, 1.52f, true, false},
    {"a bit of everything", LUM_SURFACE_PBR, 0.3f, 0.5f, 0.25f, 1.7f, true, false},
};
enum { CASE_COUNT = sizeof CASES / sizeof CASES[0] };
static const float ROUGHNESS[] = {0, 1e-3f, 0.05f, 0.2f, 0.5f, 1};
enum { ROUGHNESS_COUNT = sizeof ROUGHNESS / sizeof ROUGHNESS[0] };

static lum_model *all_materials(bool coloured)
{
    static const float BASE[3] = {0.9f, 0.55f, 0.2f}, THROUGH[3] = {0.35f, 0.6f, 0.8f};
    lum_model *model = make_model();
    for (int i = 0; i < CASE_COUNT; i++) {
        for (int r = 0; r < ROUGHNESS_COUNT; r++) {
            const scattering_case *c = &CASES[i];
            uint32_t index = make_material(model, c->kind);
            lum_material *m = &model->materials[index];
            m->roughness = ROUGHNESS[r];
            m->metallic = c->metallic;
            m->transmission = c->transmission;
            m->diffuse_transmission = c->diffuse_transmission;
            m->ior = c->ior;
            m->thin = c->thin;
            if (c->eta && coloured) {
                static const float ETA[3] = {0.18f, 0.42f, 1.37f}, K[3] = {3.42f, 2.35f, 1.77f}; /* like gold */
                m->has_eta = true;
                memcpy(m->eta, ETA, sizeof ETA);
                memcpy(m->k, K, sizeof K);
            }
            if (coloured) {
                memcpy(m->base_color, BASE, sizeof BASE);
                memcpy(m->diffuse_transmission_color, THROUGH, sizeof THROUGH);
            }
        }
    }
    return model;
}

static const double DEGREES[] = {0, 23, 51, 77, 88};
enum { DEGREES_COUNT = sizeof DEGREES / sizeof DEGREES[0] };

static lmg_vec3 incoming(double degrees, bool behind)
{
    double t = degrees * PI / 180, phi = 0.7;
    return v3(sin(t) * cos(phi), sin(t) * sin(phi), behind ? -cos(t) : cos(t));
}

static void white_furnace(void **state)
{
    (void)state;
    lum_model *model = all_materials(false);
    lum_scene *scene = scene_of(model);
    const lmg_vec3 tilts[] = {unit(v3(0.2, 0.1, 1)), unit(v3(-0.9, 0.5, 1)), unit(v3(0.1, -3, 1))};
    lum_rng rng = lum_rng_stream(21, 0);
    for (uint32_t m = 0; m < model->material_count; m++) {
        for (int a = 0; a < 2 * DEGREES_COUNT; a++) {
            lmg_vec3 wi = incoming(DEGREES[a / 2], a & 1), d = v3(-wi.x, -wi.y, -wi.z);
            for (int tilt = 0; tilt < 4; tilt++) {
                lum_surface s = surface_of(scene, 2 * m, d, tilt ? &tilts[tilt - 1] : NULL);
                for (int i = 0; i < 500; i++) {
                    double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
                    lum_scattered o;
                    lum_polarization pol = {0};
                    lum_scatter_trace(&s, wi, i % 3 ? 1 : 1.33f, xi, i & 1 ? &pol : NULL, &o);
                    assert_true(o.weight[0] == 1 && o.weight[1] == 1 && o.weight[2] == 1);
                    /* On the side that the event says. */
                    double c = dot(o.wo, s.ng) * (wi.z > 0 ? 1 : -1);
                    assert_true(o.event & LUM_REFLECTED ? c >= 0 : c <= 0);
                    assert_true(fabs(dot(o.wo, o.wo) - 1) < 1e-9);
                    if (pol.known) {
                        assert_true(fabs(dot(pol.re, pol.re) + dot(pol.im, pol.im) - 1) < 1e-9);
                        assert_true(fabs(dot(pol.re, o.wo)) < 1e-7 && fabs(dot(pol.im, o.wo)) < 1e-7);
                    }
                }
            }
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

/* What many encounters give together is what each gives alone, to the bit: in any company, polarized or not, at the extremes too. */
static void many_as_each(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    const double ends[] = {0, 0.25, 0.5, 1 - 0x1p-53};
    static lum_encounter many[LUM_MAX_ENCOUNTERS];
    static lum_polarization fields[2][LUM_MAX_ENCOUNTERS];
    lum_rng rng = lum_rng_stream(31, 0);
    int diffuse = 0, reflected = 0;
    for (int batch = 0; batch < 4000; batch++) {
        const size_t count = (size_t)batch % LUM_MAX_ENCOUNTERS + 1;
        for (size_t i = 0; i < count; i++) {
            lum_encounter *e = &many[i];
            const uint32_t m = (uint32_t)(lum_rng_next(&rng) * model->material_count);
            const double c = batch % 8 ? 2 * lum_rng_next(&rng) - 1 : i % 4 < 2 ? 1 - (double)(i % 4 * 2) : i % 4 == 2 ? 1e-13 : 0, r = sqrt((1 - c) * (1 + c));
            const lmg_vec3 tilt = unit(v3(lum_rng_next(&rng) - 0.5, 2 * lum_rng_next(&rng) - 1, 0.5));
            e->wi = v3(0.6 * r, -0.8 * r, c);
            e->surface = surface_of(scene, 2 * m, v3(-e->wi.x, -e->wi.y, -e->wi.z), i % 3 ? &tilt : NULL);
            e->eta_outside = i % 5 ? 1 : 1.33f;
            for (int k = 0; k < 4; k++) {
                e->xi[k] = batch % 10 ? lum_rng_next(&rng) : ends[(int)(lum_rng_next(&rng) * 4)];
            }
            lmg_vec3 across = unit(v3(0.8, 0.6, 0)); /* perpendicular to wi */
            fields[0][i] = fields[1][i] = (lum_polarization){.re = across, .known = i % 7 == 0};
            e->polarization = i % 2 ? &fields[0][i] : NULL;
        }
        lum_scatter_trace_many(count, many);
        for (size_t i = 0; i < count; i++) {
            const lum_encounter *e = &many[i];
            lum_scattered o;
            lum_scatter_trace(&e->surface, e->wi, e->eta_outside, e->xi, e->polarization ? &fields[1][i] : NULL, &o);
            assert_memory_equal(&o.wo, &e->out.wo, sizeof o.wo);
            assert_memory_equal(o.weight, e->out.weight, sizeof o.weight);
            assert_int_equal(o.event, e->out.event);
            assert_true(o.pdf == 0 && e->out.pdf == 0);
            assert_true(fields[0][i].known == fields[1][i].known);
            if (fields[0][i].known) {
                assert_memory_equal(&fields[0][i].re, &fields[1][i].re, sizeof(lmg_vec3));
                assert_memory_equal(&fields[0][i].im, &fields[1][i].im, sizeof(lmg_vec3));
            }
            diffuse += e->surface.kind == LUM_SURFACE_LAMBERT;
            reflected += o.event == LUM_REFLECTED && e->surface.kind == LUM_SURFACE_CONDUCTOR;
        }
    }
    assert_true(diffuse > 1000 && reflected > 1000); /* of 130,000 */
    lum_scene_destroy(scene);
    free_model(model);
}

/* Extremes of the numbers and of the incidence. */
static void extremes(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    const double ends[] = {0, 0.25, 0.5, 1 - 0x1p-53};
    const double grazing[] = {1, 1e-3, 1e-8, 1e-16, 0};
    for (uint32_t m = 0; m < model->material_count; m++) {
        for (int a = 0; a < 10; a++) {
            double c = grazing[a / 2], r = sqrt(1 - c * c);
            lmg_vec3 wi = v3(0.6 * r, -0.8 * r, a & 1 ? -c : c), tilt = unit(v3(1, 1, 0.5));
            for (int t = 0; t < 2; t++) {
                lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), t ? &tilt : NULL);
                for (int i = 0; i < 256; i++) {
                    double xi[4] = {ends[i & 3], ends[i >> 2 & 3], ends[i >> 4 & 3], ends[i >> 6]};
                    lum_scattered o;
                    lum_polarization pol = {0};
                    lum_scatter_trace(&s, wi, 1, xi, &pol, &o);
                    if (!(fabs(dot(o.wo, o.wo) - 1) < 1e-9)) {
                        print_message("material %u, incidence %d, tilt %d, numbers %d: |wo| %g\n", m, a, t, i, dot(o.wo, o.wo));
                    }
                    assert_true(fabs(dot(o.wo, o.wo) - 1) < 1e-9);
                    lum_scatter_sample(&s, wi, 1, xi, &o);
                    assert_true(o.pdf >= 0 && o.pdf < (double)INFINITY);
                    for (int k = 0; k < 3; k++) {
                        assert_true(o.weight[k] >= 0 && o.weight[k] <= 1);
                    }
                }
            }
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

static void samples_follow_densities(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    tally t = {.lowest = 1};
    for (int i = 0; i < CASE_COUNT; i++) {
        for (int r = 0; r < ROUGHNESS_COUNT; r++) {
            uint32_t m = (uint32_t)(i * ROUGHNESS_COUNT + r);
            if (r > 0 && CASES[i].kind == LUM_SURFACE_LAMBERT) {
                continue;
            }
            for (int a = 0; a < DEGREES_COUNT; a++) {
                for (int behind = 0; behind < 2; behind++) {
                    char name[200];
                    if (behind && !(CASES[i].transmission > 0)) {
                        continue; /* scatters as from the front */
                    }
                    lmg_vec3 wi = incoming(DEGREES[a], behind);
                    lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), NULL);
                    snprintf(name, sizeof name, "%s, roughness %g, %g degrees%s", CASES[i].name, (double)ROUGHNESS[r], DEGREES[a],
                             behind ? " from behind" : "");
                    compare(name, &s, wi, 1, 1000 + (uint64_t)t.tests, TABLE, &t);
                }
            }
        }
    }
    judge(&t);
    lum_scene_destroy(scene);
    free_model(model);
}

/* Normals tipped by interpolation or a map: also lobes that are mirrored at the geometric surface have the density they say. */
static void tilted_normals(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    const lmg_vec3 tilts[] = {unit(v3(0.3, -0.1, 1)), unit(v3(-1.2, 0.4, 1))};
    tally t = {.lowest = 1};
    for (int i = 2; i < CASE_COUNT; i++) {
        for (int r = 3; r < 5; r++) {
            for (int a = 1; a < DEGREES_COUNT - 1; a++) {
                for (int k = 0; k < 4; k++) {
                    char name[200];
                    bool behind = k & 1;
                    lmg_vec3 wi = incoming(DEGREES[a], behind);
                    lum_surface s =
                        surface_of(scene, 2 * (uint32_t)(i * ROUGHNESS_COUNT + r), v3(-wi.x, -wi.y, -wi.z), &tilts[k / 2]);
                    snprintf(name, sizeof name, "%s, roughness %g, %g degrees%s, tilt %d", CASES[i].name, (double)ROUGHNESS[r],
                             DEGREES[a], behind ? " from behind" : "", k / 2);
                    compare(name, &s, wi, 1, 9000 + (uint64_t)t.tests, TABLE, &t);
                }
            }
        }
    }
    judge(&t);
    lum_scene_destroy(scene);
    free_model(model);
}

/* f = p / cos is symmetric; across refraction f / n_o^2 is: radiance over n^2 is what travels unchanged. */
static void reciprocity(void **state)
{
    (void)state;
    lum_model *model = all_materials(true);
    lum_scene *scene = scene_of(model);
    lum_rng rng = lum_rng_stream(31, 0);
    int compared = 0;
    for (uint32_t m = 0; m < model->material_count; m++) {
        const lum_material *material = &model->materials[m];
        bool solid = material->transmission > 0 && !material->thin;
        for (int i = 0; i < 400; i++) {
            lmg_vec3 w[2];
            for (int k = 0; k < 2; k++) {
                double z = 2 * lum_rng_next(&rng) - 1, phi = 2 * PI * lum_rng_next(&rng), q = sqrt(1 - z * z);
                w[k] = v3(q * cos(phi), q * sin(phi), z);
            }
            if (material->kind == LUM_SURFACE_PBR && solid && material->transmission < 1 && w[0].z * w[1].z < 0) {
                continue; /* the diffusing share of a half clear solid has an interface on one side only */
            }
            float f[2][3];
            double n2[2];
            for (int k = 0; k < 2; k++) {
                lum_surface s = surface_of(scene, 2 * m, v3(-w[k].x, -w[k].y, -w[k].z), NULL);
                lum_scatter_eval(&s, w[k], w[1 - k], 1, f[k]);
                n2[k] = solid && w[1 - k].z < 0 ? (double)material->ior * (double)material->ior : 1;
            }
            for (int c = 0; c < 3; c++) {
                double a = (double)f[0][c] / fabs(w[1].z) / n2[0], b = (double)f[1][c] / fabs(w[0].z) / n2[1];
                /* p is returned in float; a smooth coat has its exact reflectance for the light that enters and the interpolated
                 * one of its table for the light that leaves: up to 2e-3 of 1 - E, more where 1 - E itself is small near grazing.
                 */
                bool smooth_coat = material->kind == LUM_SURFACE_PBR && material->roughness * material->roughness < LUM_SMOOTH;
                double tolerance = smooth_coat ? 0.02 : 4e-7;
                if (smooth_coat && (fabs(w[0].z) < 0.05 || fabs(w[1].z) < 0.05)) {
                    continue;
                }
                assert_true(fabs(a - b) <= tolerance * (fabs(a) + fabs(b)));
                compared += a > 0;
            }
        }
    }
    print_message("%d values compared\n", compared);
    assert_true(compared > 10000);
    lum_scene_destroy(scene);
    free_model(model);
}

/* The tables against quadrature with a hundred times the points, at cosines and roughnesses between their nodes. */
static void tables_are_accurate(void **state)
{
    (void)state;
    lum_model *model = make_model();
    const float texel[4] = {1, 1, 1, 1};
    int32_t image = make_image(model, 1, 1, texel);
    uint32_t m[2] = {make_glass(model, 1.5f, 1, false), make_material(model, LUM_SURFACE_PBR)};
    model->materials[m[0]].metallic = 0.5f;
    model->materials[m[0]].metal_rough_texture.image = image; /* all roughnesses */
    model->materials[m[1]].roughness = 0.45f;                 /* one */
    lum_scene *scene = scene_of(model);
    for (int which = 0; which < 2; which++) {
        const struct lum_tables *tables = surface_of(scene, 2 * m[which], v3(0, 0, -1), NULL).tables;
        const lum_lobe_set *sets[4] = {tables->medium[0].coat, tables->metal, tables->medium[0].outside, tables->medium[0].inside};
        for (int k = 0; k < (which ? 1 : 4); k++) {
            double worst = 0;
            for (int r = 0; r < (which ? 1 : 10); r++) {
                double alpha = which ? (double)(0.45f * 0.45f) : pow(0.15 + 0.09 * r, 2);
                for (int j = 1; j < 12; j++) {
                    double mu = 0.035 + 0.08 * j;
                    double exact = 1 - lum_lobe_albedo((lum_lobe_kind)sets[k]->kind, alpha, (double)sets[k]->eta, mu, 200000);
                    worst = fmax(worst, fabs(lum_lobe_rest(sets[k], alpha, mu) - exact));
                }
            }
            print_message("%s, table %d: off by at most %.1e\n", which ? "one roughness" : "all roughnesses", k, worst);
            assert_true(worst < TABLE);
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

/* The tests above must be able to fail: densities that are wrong by as much as people get them wrong are found out. */
static void mutants_are_rejected(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t m = make_lambert(model, 1);
    lum_scene *scene = scene_of(model);
    lmg_vec3 wi = incoming(51, false);
    lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), NULL);
    grid grids[2] = {grid_about(reflected(wi, s.ng), 1), grid_about(v3(0, 0, -1), 1)};
    /* A Lambertian tipped by one degree differs by chi2 = 1.4e-3 N on some 600 cells, whose spread is 35 to 50: N = 100000 is a
     * matter of luck (p up to 4e-5 over 40 seeds), 200000 gives p < 1e-17, this p < 1e-50. */
    enum { MUTANT_SAMPLES = 400000 };
    static integrals q;
    static sampled n;
    integrate(&s, wi, 1, grids, FINE, &q);
    draw(&s, wi, 1, grids, MUTANT_SAMPLES, 77, &n);
    double right[CELLS], no_cosine[CELLS], tilted[CELLS], sum = 0;
    lmg_vec3 tip = unit(v3(0.02, 0, 1)); /* one degree */
    for (int i = 0; i < CELLS; i++) {
        right[i] = MUTANT_SAMPLES * q.pdf[i];
    }
    assert_true(stats_chi_square(n.counts, right, CELLS, NULL, NULL) > 0.01);
    for (int mutant = 0; mutant < 2; mutant++) {
        double *e = mutant ? tilted : no_cosine;
        sum = 0;
        for (int i = 0; i < CELLS; i++) {
            int k = i % HALF;
            lmg_vec3 w = direction(&grids[i / HALF], ring_angle(&grids[i / HALF], (k / SECTORS + 0.5) / RINGS),
                                   2 * PI * ((k % SECTORS + 0.5) / SECTORS - 0.5));
            e[i] = w.z > 0.02 ? right[i] * (mutant ? fmax(dot(w, tip), 0) / w.z : 1 / w.z) : right[i];
            sum += e[i];
        }
        for (int i = 0; i < CELLS; i++) {
            e[i] *= MUTANT_SAMPLES / sum;
        }
        assert_true(stats_chi_square(n.counts, e, CELLS, NULL, NULL) < 1e-6);
    }
    /* A pdf scaled by 1.03 shows in the total. */
    assert_true(fabs(1.03 * q.total - 1) > TABLE);
    assert_true(fabs(q.total - 1) < TABLE);
    lum_scene_destroy(scene);
    free_model(model);
}

static void statistics(void **state)
{
    (void)state;
    /* Tabulated quantiles (Abramowitz and Stegun, table 26.8), to their digits. */
    assert_true(fabs(stats_chi_square_tail(3.84146, 1) - 0.05) < 1e-6);
    assert_true(fabs(stats_chi_square_tail(18.3070, 10) - 0.05) < 1e-6);
    assert_true(fabs(stats_chi_square_tail(135.807, 100) - 0.01) < 1e-5);
    assert_true(fabs(stats_chi_square_tail(2.55821, 10) - 0.99) < 1e-6);
    assert_true(fabs(stats_normal_tail(1.95996) - 0.05) < 1e-6);
    /* p-values of true hypotheses are uniform: Kolmogorov's test at 1e-3 (1.95 / sqrt(n)). */
    enum { TRIALS = 500, BINS = 23 };
    double p[TRIALS], worst = 0;
    lum_rng rng = lum_rng_stream(3, 3);
    for (int t = 0; t < TRIALS; t++) {
        double counts[BINS] = {0}, expected[BINS];
        for (int i = 0; i < 2000; i++) {
            double x = lum_rng_next(&rng);
            counts[(int)(x * x * BINS)]++;
        }
        for (int i = 0; i < BINS; i++) {
            expected[i] = 2000 * (sqrt((i + 1.0) / BINS) - sqrt((double)i / BINS));
        }
        p[t] = stats_chi_square(counts, expected, BINS, NULL, NULL);
    }
    for (int t = 0; t < TRIALS; t++) {
        double below = 0;
        for (int i = 0; i < TRIALS; i++) {
            below += p[i] <= p[t];
        }
        worst = fmax(worst, fabs(below / TRIALS - p[t]));
    }
    assert_true(worst < 1.95 / sqrt(TRIALS));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(statistics),
        cmocka_unit_test(white_furnace),
        cmocka_unit_test(many_as_each),
        cmocka_unit_test(extremes),
        cmocka_unit_test(tables_are_accurate),
        cmocka_unit_test(mutants_are_rejected),
        cmocka_unit_test(reciprocity),
        cmocka_unit_test(samples_follow_densities),
        cmocka_unit_test(tilted_normals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
