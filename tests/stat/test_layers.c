/* SPDX-License-Identifier: Apache-2.0 */
/* Layers of glTF materials (clear coat, sheen, anisotropy, iridescence, specular): samples against densities, albedo at most 1,
 * reciprocity, and what each has to look like in the limit. */
#include "../../luminaires/src/film.h"
#include "../../luminaires/src/scene_data.h"
#include "../../luminaires/src/sheen.h"
#include "../../luminaires/src/stretched.h"
#include "scatter_compare.h"

#include <luminaires/rng.h>
#include <luminaires/spectrum.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

typedef struct layered_case {
    const char *name;
    uint32_t present;
    float metallic, transmission, diffuse_transmission;
    bool thin;
    float strength, outside; /* of the anisotropy; index outside; 0: 0.8, air */
} layered_case;

enum { ALL = LUM_LAYER_SPECULAR | LUM_LAYER_CLEARCOAT | LUM_LAYER_SHEEN | LUM_LAYER_ANISOTROPY | LUM_LAYER_IRIDESCENCE };
static const layered_case CASES[] = {
    {"coated paint", LUM_LAYER_CLEARCOAT, 0, 0, 0, true, 0, 0},
    {"coated metal", LUM_LAYER_CLEARCOAT, 1, 0, 0, true, 0, 0},
    {"coated glass", LUM_LAYER_CLEARCOAT, 0, 1, 0, false, 0, 0},
    {"coated pane", LUM_LAYER_CLEARCOAT, 0, 1, 0, true, 0, 0},
    {"cloth", LUM_LAYER_SHEEN, 0, 0, 0.3f, true, 0, 0},
    {"brushed metal", LUM_LAYER_ANISOTROPY, 1, 0, 0, true, 0, 0},
    {"lightly brushed metal", LUM_LAYER_ANISOTROPY, 1, 0, 0, true, 0.3f, 0},
    {"brushed, half metal", LUM_LAYER_ANISOTROPY, 0.5f, 0, 0, true, 0, 0},
    {"film on paint", LUM_LAYER_IRIDESCENCE, 0, 0, 0, true, 0, 0},
    {"film on metal", LUM_LAYER_IRIDESCENCE, 1, 0, 0, true, 0, 0},
    {"film on a pane", LUM_LAYER_IRIDESCENCE, 0, 1, 0, true, 0, 0},
    {"film on glass", LUM_LAYER_IRIDESCENCE, 0, 1, 0, false, 0, 0},
    {"specular paint", LUM_LAYER_SPECULAR, 0, 0, 0, true, 0, 0},
    {"specular glass", LUM_LAYER_SPECULAR, 0, 1, 0, false, 0, 0},
    {"specular glass under water", LUM_LAYER_SPECULAR, 0, 1, 0, false, 0, 1.33f},
    {"everything", ALL, 0.4f, 0.4f, 0.3f, true, 0, 0},
};
enum { CASE_COUNT = sizeof CASES / sizeof CASES[0] };
static const float ROUGHNESS[] = {0, 0.25f, 0.6f};
enum { ROUGHNESS_COUNT = sizeof ROUGHNESS / sizeof ROUGHNESS[0] };

/* One material per case and roughness, quad by quad: triangle 2 i has material i. */
static lum_scene *make_scene(lum_model *model, bool white)
{
    lum_scene *scene;
    for (int i = 0; i < CASE_COUNT * ROUGHNESS_COUNT; i++) {
        const layered_case *c = &CASES[i / ROUGHNESS_COUNT];
        uint32_t index = make_material(model, LUM_SURFACE_PBR);
        lum_material *m = &model->materials[index];
        m->roughness = ROUGHNESS[i % ROUGHNESS_COUNT];
        m->metallic = c->metallic;
        m->transmission = c->transmission;
        m->diffuse_transmission = c->diffuse_transmission;
        m->thin = c->thin;
        lum_layers *l = &m->layers;
        l->present = c->present;
        l->specular = 0.7f;
        l->clearcoat = 0.8f;
        l->clearcoat_roughness = i % ROUGHNESS_COUNT ? 0.35f : 0;
        l->sheen_roughness = 0.5f;
        l->anisotropy = c->strength > 0 ? c->strength : 0.8f;
        l->anisotropy_rotation = 0.4f;
        l->iridescence = 0.9f;
        l->iridescence_ior = 1.38f;
        l->thickness_min = 100;
        l->thickness_max = 420;
        for (int k = 0; k < 3; k++) {
            static const float BASE[3] = {0.9f, 0.55f, 0.2f}, SPECULAR[3] = {1, 2.1f, 0.4f}, SHEEN[3] = {0.2f, 0.5f, 0.8f};
            l->specular_color[k] = SPECULAR[k];
            l->sheen_color[k] = SHEEN[k];
            m->base_color[k] = white ? 1 : BASE[k];
            m->diffuse_transmission_color[k] = white ? 1 : BASE[2 - k];
        }
    }
    uint32_t water = make_material(model, LUM_SURFACE_PBR);
    model->materials[water].transmission = 1;
    model->materials[water].ior = 1.33f;
    for (uint32_t i = 0; i < model->material_count; i++) {
        make_quad(model, v3(-1, -1, -1.0 * i), v3(2, 0, 0), v3(0, 2, 0), 1, i);
    }
    finish_model(model);
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    return scene;
}

static lmg_vec3 from(double degrees, double phi, bool behind)
{
    double t = degrees * PI / 180;
    return v3(sin(t) * cos(phi), sin(t) * sin(phi), behind ? -cos(t) : cos(t));
}

static void samples_follow_densities(void **state)
{
    (void)state;
    lum_model *model = make_model();
    lum_scene *scene = make_scene(model, false);
    const lmg_vec3 tilt = unit(v3(0.3, -0.1, 1));
    static const double DEGREES[] = {0, 51, 80};
    tally t = {.lowest = 1};
    for (uint32_t m = 0; m < CASE_COUNT * ROUGHNESS_COUNT; m++) {
        const layered_case *c = &CASES[m / ROUGHNESS_COUNT];
        for (int a = 0; a < 4; a++) {
            /* The last: a tipped normal, one roughness. */
            bool tilted = a == 3, behind = c->transmission > 0 && a == 1;
            uint32_t rough = m % ROUGHNESS_COUNT;
            if ((tilted && (rough != 1 || c->metallic == 0)) || (rough == 0 && a != 2) || (rough == 2 && a != 1)) {
                continue;
            }
            if (c->outside > 0 && (a != 1 || rough != 1)) {
                continue; /* its tables are made anew for every density */
            }
            if (rough == 0 && (c->present & LUM_LAYER_ANISOTROPY)) {
                continue; /* a sheet of light too thin for the grid */
            }
            lmg_vec3 wi = from(DEGREES[a % 3], 0.7, behind);
            lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), tilted ? &tilt : NULL);
            char name[200];
            snprintf(name, sizeof name, "%s, roughness %g, %g degrees%s%s", c->name, (double)ROUGHNESS[m % ROUGHNESS_COUNT],
                     DEGREES[a % 3], behind ? " from behind" : "", tilted ? ", tilted" : "");
            compare(name, &s, wi, c->outside > 0 ? c->outside : 1, 500 + (uint64_t)t.tests, TABLE, &t);
        }
    }
    judge(&t);
    lum_scene_destroy(scene);
    free_model(model);
}

/* White materials under white light from all around: never more than 1, and what nothing absorbs loses nothing: not at second
 * bounces, and not between colours, of which at least one goes on whole. */
static void white_furnace(void **state)
{
    (void)state;
    lum_model *model = make_model();
    lum_scene *scene = make_scene(model, true);
    enum { SAMPLES_EACH = 20000 };
    lum_rng rng = lum_rng_stream(5, 5);
    double least = 1, most = 0;
    for (uint32_t m = 0; m < CASE_COUNT * ROUGHNESS_COUNT; m++) {
        const layered_case *c = &CASES[m / ROUGHNESS_COUNT];
        for (int a = 0; a < 5; a++) {
            lmg_vec3 wi = from(22.0 * a, 0.3, false);
            lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, -wi.y, -wi.z), NULL);
            stats_mean albedo[3] = {{0}};
            for (int i = 0; i < SAMPLES_EACH; i++) {
                double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
                lum_scattered o;
                lum_scatter_trace(&s, wi, 1, xi, NULL, &o);
                for (int k = 0; k < 3; k++) {
                    stats_add(&albedo[k], (double)o.weight[k]);
                    assert_true(o.weight[k] >= 0 && o.weight[k] <= 1);
                }
                /* Films absorb on metals, and the minimum of two attenuations loses light under coats and cloth. */
                if (!(c->present & (LUM_LAYER_CLEARCOAT | LUM_LAYER_SHEEN)) &&
                    !(c->metallic > 0 && (c->present & LUM_LAYER_IRIDESCENCE))) {
                    assert_true(fmaxf(fmaxf(o.weight[0], o.weight[1]), o.weight[2]) == 1.0f);
                }
            }
            for (int k = 0; k < 3; k++) {
                most = fmax(most, albedo[k].mean);
                least = fmin(least, albedo[k].mean);
            }
            /* A clear coat on white paint or on a smooth white metal loses nothing but the metal's second order. */
            if (c->present == LUM_LAYER_CLEARCOAT && c->metallic == 0 && c->transmission == 0) {
                assert_true(albedo[0].mean > 1 - 0.01);
            }
        }
    }
    print_message("albedos %.4f .. %.6f\n", least, most);
    assert_true(most <= 1);
    lum_scene_destroy(scene);
    free_model(model);
}

static void reciprocity(void **state)
{
    (void)state;
    lum_model *model = make_model();
    lum_scene *scene = make_scene(model, false);
    lum_rng rng = lum_rng_stream(31, 0);
    double worst = 0;
    int compared = 0;
    for (uint32_t m = 0; m < CASE_COUNT * ROUGHNESS_COUNT; m++) {
        const lum_material *material = &model->materials[m];
        bool solid = material->transmission > 0 && !material->thin;
        for (int i = 0; i < 60; i++) {
            lmg_vec3 w[2];
            for (int k = 0; k < 2; k++) {
                double z = 0.05 + 0.95 * lum_rng_next(&rng), phi = 2 * PI * lum_rng_next(&rng), q = sqrt(1 - z * z);
                w[k] = v3(q * cos(phi), q * sin(phi), k && material->transmission > 0 && i % 2 ? -z : z);
            }
            double f[2][3];
            for (int k = 0; k < 2; k++) {
                float p[3];
                lum_surface s = surface_of(scene, 2 * m, v3(-w[k].x, -w[k].y, -w[k].z), NULL);
                lum_scatter_eval(&s, w[k], w[1 - k], 1, p);
                double n2 = solid && w[1 - k].z < 0 ? (double)material->ior * (double)material->ior : 1;
                for (int c = 0; c < 3; c++) {
                    f[k][c] = (double)p[c] / (fabs(w[1 - k].z) * n2);
                }
            }
            for (int c = 0; c < 3; c++) {
                double sum = f[0][c] + f[1][c];
                if (sum > 0 && fabs(f[0][c] - f[1][c]) > 2e-6 * sum) {
                    print_message("%s, roughness %g, cosines %.3f %.3f: %g and %g\n", CASES[m / ROUGHNESS_COUNT].name,
                                  (double)material->roughness, w[0].z, w[1].z, f[0][c], f[1][c]);
                }
                compared += sum > 0;
                worst = fmax(worst, sum > 0 ? fabs(f[0][c] - f[1][c]) / sum : 0);
            }
        }
    }
    print_message("%d values, off by at most %.1e\n", compared, worst);
    assert_true(compared > 3000);
    assert_true(worst < 2e-6); /* densities and weights are multiplied in float */
    lum_scene_destroy(scene);
    free_model(model);
}

/* The film's characteristic matrix (admittances), wavelength by wavelength, against Airy's sum with the table of path differences.
 */
static void films_are_exact(void **state)
{
    (void)state;
    static lum_film_table table;
    lum_film_table_fill(&table);
    lum_spectrum white;
    assert_true(lum_spectrum_illuminant("D65", &white));
    double worst = 0;
    for (int i = 0; i < 60; i++) {
        double c = 0.02 + 0.98 * (i % 6) / 5.0, n = 1.2 + 0.2 * (i / 6 % 4), nm = 90 + 173.0 * (i / 12);
        const float f0[3] = {0.04f, 0.3f, 0.9f};
        float rgb[3];
        lum_film_reflectance(&table, c, n, nm, f0, rgb);
        for (int k = 0; k < 3; k++) {
            double sum = 0, total = 0;
            double root = sqrt((double)f0[k]), index[3] = {1, n, (1 + root) / (1 - root)}, cosine[3];
            for (int m = 0; m < 3; m++) {
                cosine[m] = sqrt(1 - (1 - c * c) / (index[m] * index[m]));
            }
            for (double wavelength = 360; wavelength <= 830; wavelength++) {
                double xyz[3], weight[3], r = 0;
                lum_observer(wavelength, xyz);
                lum_xyz_to_rgb(xyz, weight);
                double w = weight[k] * lum_spectrum_at(&white, wavelength), delta = 2 * PI * n * nm * cosine[1] / wavelength;
                for (int pol = 0; pol < 2; pol++) {
                    double y[3]; /* admittances */
                    for (int m = 0; m < 3; m++) {
                        y[m] = pol ? index[m] / cosine[m] : index[m] * cosine[m];
                    }
                    double co = cos(delta), si = sin(delta), mixed = y[0] * y[2] / y[1];
                    r += 0.5 * (pow((y[0] - y[2]) * co, 2) + pow((mixed - y[1]) * si, 2)) /
                         (pow((y[0] + y[2]) * co, 2) + pow((mixed + y[1]) * si, 2));
                }
                sum += w * r;
                total += w;
            }
            worst = fmax(worst, fabs(fmin(fmax(sum / total, 0), 1) - (double)rgb[k]));
        }
    }
    print_message("films off by at most %.1e\n", worst);
    /* Linear interpolation of a cosine of period 360 nm at least over 10 nm: (2 pi 10 / 360)^2 / 8 = 3.8e-3 of the amplitude at a
     * single wavelength, a third of that over the spectrum, times the amplitude of the fringes. */
    assert_true(worst < 1.5e-3);
}

/* Sheen gives out at most what arrives, and its table is the integral of its density. */
static void sheen_is_bounded(void **state)
{
    (void)state;
    static lum_sheen_table table;
    static const double ROUGH[] = {0.12, 0.37, 0.8};
    double worst = 0;
    for (int r = 0; r < 3; r++) {
        double alpha = ROUGH[r] * ROUGH[r];
        lum_sheen_table_fill(&table, ROUGH[r], ROUGH[r]);
        for (int i = 0; i < 6; i++) {
            double mu = 0.05 + 0.19 * i, sum = 0;
            lmg_vec3 wi = v3(sqrt(1 - mu * mu), 0, mu);
            enum { RINGS_FINE = 300, SECTORS_FINE = 240 };
            for (int k = 0; k < RINGS_FINE * SECTORS_FINE; k++) {
                double x = (k / SECTORS_FINE + 0.5) / RINGS_FINE, z = x * x, phi = 2 * PI * (k % SECTORS_FINE + 0.5) / SECTORS_FINE;
                lmg_vec3 wo = v3(sqrt(1 - z * z) * cos(phi), sqrt(1 - z * z) * sin(phi), z);
                sum += 2 * x * lum_sheen_density(&table, alpha, wi, wo);
            }
            sum *= 2 * PI / (RINGS_FINE * SECTORS_FINE);
            assert_true(sum <= 1);
            worst = fmax(worst, fabs(sum - lum_sheen_albedo(&table, alpha, mu)));
        }
    }
    print_message("sheen's albedo off by at most %.1e\n", worst);
    assert_true(worst < TABLE);
}

/* Layers of no strength are no layers: the same albedo and density as the plain material; a film of thickness 0 too. */
static void nothing_changes_nothing(void **state)
{
    (void)state;
    lum_model *model = make_model();
    for (int i = 0; i < 3; i++) {
        uint32_t index = make_material(model, LUM_SURFACE_PBR);
        lum_material *m = &model->materials[index];
        m->roughness = 0.4f;
        if (i > 0) {
            lum_layers *l = &m->layers;
            l->present = i == 1 ? LUM_LAYER_SPECULAR | LUM_LAYER_CLEARCOAT | LUM_LAYER_SHEEN : LUM_LAYER_IRIDESCENCE;
            l->specular = l->specular_color[0] = l->specular_color[1] = l->specular_color[2] = 1;
            l->iridescence = 1;
            l->iridescence_ior = 1.3f;
        }
        make_quad(model, v3(-1, -1, -1.0 * i), v3(2, 0, 0), v3(0, 2, 0), 1, (uint32_t)i);
    }
    finish_model(model);
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    lum_rng rng = lum_rng_stream(8, 0);
    for (int i = 0; i < 300; i++) {
        double z = 0.1 + 0.9 * lum_rng_next(&rng), phi = 6 * lum_rng_next(&rng), y = lum_rng_next(&rng);
        lmg_vec3 wi = v3(sqrt(1 - z * z), 0, z), wo = v3(sqrt(1 - y * y) * cos(phi), sqrt(1 - y * y) * sin(phi), y);
        float p[3][3];
        for (uint32_t m = 0; m < 3; m++) {
            lum_surface s = surface_of(scene, 2 * m, v3(-wi.x, 0, -wi.z), NULL);
            lum_scatter_eval(&s, wi, wo, 1, p[m]);
        }
        for (int k = 0; k < 3; k++) {
            /* Two ways to tabulate the same albedo. */
            assert_true(fabsf(p[1][k] - p[0][k]) <= 2e-3f * p[0][k] + 1e-5f);
            assert_true(fabsf(p[2][k] - p[0][k]) <= 2e-3f * p[0][k] + 1e-5f);
        }
    }
    lum_scene_destroy(scene);
    free_model(model);
}

/* Brushed along x, a metal spreads light along x: the second moments of the half vector's slopes have the widths' ratio. */
static void brushing_spreads_along(void **state)
{
    (void)state;
    lum_model *model = make_model();
    uint32_t m = make_material(model, LUM_SURFACE_PBR);
    model->materials[m].metallic = 1;
    model->materials[m].roughness = 0.2f; /* alpha 0.04 */
    model->materials[m].layers.present = LUM_LAYER_ANISOTROPY;
    model->materials[m].layers.anisotropy = 0.4f; /* alpha along: 0.04 + 0.96 * 0.16 = 0.1936 */
    make_quad(model, v3(-1, -1, 0), v3(2, 0, 0), v3(0, 2, 0), 1, m);
    finish_model(model);
    lum_scene *scene;
    assert_int_equal(lum_scene_create(model, &scene, NULL), LMG_OK);
    lum_surface s = surface_of(scene, 0, v3(0, 0, -1), NULL);
    lum_rng rng = lum_rng_stream(2, 0);
    double along = 0, across = 0;
    for (int i = 0; i < 100000; i++) {
        double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
        lum_scattered o;
        lum_scatter_trace(&s, v3(0, 0, 1), 1, xi, NULL, &o);
        if (o.event & LUM_REFLECTED) { /* medians of the slopes: those of GGX have no second moment */
            along += fabs(o.wo.x) / (1 + o.wo.z) < 0.1936 ? 1 : -1;
            across += fabs(o.wo.y) / (1 + o.wo.z) < 0.04 ? 1 : -1;
        }
    }
    /* A slope of GGX over its width is distributed as t / sqrt(1 + t^2) / 2 about the middle: 1 / sqrt(2) within the width. */
    print_message("shares within the widths: %.4f %.4f\n", 0.5 + along / 200000, 0.5 + across / 200000);
    assert_true(fabs(0.5 + along / 200000 - 0.70711) < 0.02);
    assert_true(fabs(0.5 + across / 200000 - 0.70711) < 0.02);
    lum_scene_destroy(scene);
    free_model(model);
}

/* The albedo of stretched facets: tables against a finer quadrature, for fixed and for varying widths; and facets that aren't
 * stretched are those of microfacet.c. */
static void stretched_albedo(void **state)
{
    (void)state;
    enum { TRIALS = 64, POINTS = 10946, BEFORE = 6765 };
    lum_table_store store = {0};
    bool failed = false;
    const lum_stretched_set *varying = lum_stretched_find(&store, -1, -1, &failed);
    lum_rng rng = lum_rng_stream(77, 0);
    double worst[2] = {0, 0}, worst_total = 0, worst_isotropic = 0;
    for (int k = 0; k < 4; k++) {
        float roughness = (float)lum_rng_next(&rng), strength = (float)lum_rng_next(&rng), alpha = roughness * roughness;
        const lum_stretched_set *fixed = lum_stretched_find(&store, roughness, strength, &failed),
                                *round = lum_stretched_find(&store, roughness, 0, &failed);
        const lum_lobe_set *isotropic = lum_lobe_set_find(&store, LUM_LOBE_METAL, 0, alpha, &failed);
        assert_false(failed);
        assert_ptr_equal(fixed, lum_stretched_find(&store, roughness, strength, &failed));
        double mean[2] = {0, 0}, total;
        for (int i = 0; i < TRIALS; i++) {
            double z = sqrt((i + 0.5) / TRIALS), s, c, sum = 0; /* cosine-weighted directions */
            sincos_turns(i * 0.6180339887498949, &s, &c);
            double q = sqrt((1 - z) * (1 + z));
            facets f = {.wi = vec(q * c, q * s, z), .ax = (double)(alpha + (1 - alpha) * strength * strength), .ay = (double)alpha};
            f.b = facets_b(&f, f.wi);
            for (int j = 0; j < POINTS; j++) {
                facet h = facets_sample(&f, (double)((uint64_t)j * BEFORE % POINTS) / POINTS, (j + 0.5) / POINTS);
                lmg_vec3 o = facet_reflected(&f, &h);
                sum += o.z > 0 ? o.z * (z + f.b) / (o.z * f.b + z * facets_b(&f, o)) : 0;
            }
            double exact = 1 - sum / POINTS;
            worst[0] = fmax(worst[0], fabs(lum_stretched_rest(fixed, &f, &total) - exact));
            mean[0] += exact / TRIALS;
            mean[1] += lum_stretched_rest(varying, &f, &total) / TRIALS;
            worst[1] = fmax(worst[1], fabs(lum_stretched_rest(varying, &f, &total) - exact));
            worst_total = fmax(worst_total, fabs(total - (double)fixed->sets[0].total));
            f.ax = f.ay;
            f.b = facets_b(&f, f.wi);
            worst_isotropic =
                fmax(worst_isotropic, fabs(lum_stretched_rest(round, &f, &total) - lum_lobe_rest(isotropic, (double)alpha, z)));
            worst_isotropic = fmax(worst_isotropic, fabs(total - lum_lobe_total(isotropic, (double)alpha)));
        }
        print_message("roughness %.3f, strength %.3f: loses %.5f, tables %.5f and %.5f\n", (double)roughness, (double)strength,
                      mean[0], (double)fixed->sets[0].total, mean[1]);
        /* Evenly spread directions: their mean is off by the function's variation, at most 1, over twice their number. */
        assert_true(fabs(mean[0] - (double)fixed->sets[0].total) < 0.5 / TRIALS);
    }
    print_message("off by at most %.1e; varying %.1e, its totals %.1e; isotropic %.1e\n", worst[0], worst[1], worst_total,
                  worst_isotropic);
    /* What densities are off by, where samples follow the true ones. */
    assert_true(worst[0] < 6e-4);
    assert_true(worst[1] < 5e-3);
    assert_true(worst_total < 2e-3);
    assert_true(worst_isotropic < 2e-3);
    lum_tables_destroy(&store);
}

/* Khronos' models with layers: what they are about is understood. */
static void real_models(void **state)
{
    (void)state;
    static const struct {
        const char *path;
        uint32_t layers;
    } models[] = {{"luminaires/AnisotropyBarnLamp/AnisotropyBarnLamp.gltf", LUM_LAYER_ANISOTROPY | LUM_LAYER_CLEARCOAT},
                  {"luminaires/StainedGlassLamp/StainedGlassLamp.gltf", LUM_LAYER_CLEARCOAT},
                  {"gltf-materials/ClearCoatTest/ClearCoatTest.glb", LUM_LAYER_CLEARCOAT},
                  {"gltf-materials/SpecularTest/SpecularTest.glb", LUM_LAYER_SPECULAR}};
    for (size_t i = 0; i < sizeof models / sizeof *models; i++) {
        char path[1024];
        snprintf(path, sizeof path, "%s/%s", LUMIBOX_SHARED_DATA, models[i].path);
        FILE *file = fopen(path, "rb");
        if (!file) {
            print_message("skipped: %s isn't there\n", models[i].path);
            continue;
        }
        fclose(file);
        lum_model *model;
        lum_scene *scene;
        lmg_error err;
        if (lum_model_load(path, NULL, &model, &err) != LMG_OK || lum_scene_create(model, &scene, &err) != LMG_OK) {
            fail_msg("%s", err.message);
        }
        uint32_t present = 0;
        for (uint32_t k = 0; k < model->material_count; k++) {
            present |= model->materials[k].layers.present;
        }
        assert_int_equal(present, models[i].layers);
        for (uint32_t k = 0; k < model->warning_count; k++) {
            assert_null(strstr(model->warnings[k], "KHR_materials_"));
        }
        /* Rays from outside: what they meet reflects at most what arrives. */
        lum_rng rng = lum_rng_stream(4, i);
        lmg_vec3 low = model->bounds_min, high = model->bounds_max;
        int met = 0;
        for (int ray = 0; ray < 3000; ray++) {
            double size = high.x - low.x + high.y - low.y + high.z - low.z;
            lmg_vec3 target = v3(low.x + (high.x - low.x) * lum_rng_next(&rng), low.y + (high.y - low.y) * lum_rng_next(&rng),
                                 low.z + (high.z - low.z) * lum_rng_next(&rng));
            double z = 2 * lum_rng_next(&rng) - 1, phi = 2 * PI * lum_rng_next(&rng), r = sqrt(1 - z * z);
            lmg_vec3 d = v3(r * cos(phi), r * sin(phi), z),
                     o = v3(target.x - size * d.x, target.y - size * d.y, target.z - size * d.z);
            lum_hit hit;
            if (!lum_scene_intersect(scene, o, d, &hit)) {
                continue;
            }
            lum_surface s;
            lum_scattered out;
            lum_surface_at(scene, &hit, d, &s);
            double xi[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
            lum_scatter_sample(&s, v3(-d.x, -d.y, -d.z), 1, xi, &out);
            assert_true(out.event == LUM_ABSORBED || fabs(dot(out.wo, out.wo) - 1) < 1e-6);
            assert_true(out.pdf >= 0 && out.pdf < (double)INFINITY);
            for (int c = 0; c < 3; c++) {
                assert_true(out.weight[c] >= 0 && out.weight[c] <= 1);
            }
            met++;
        }
        print_message("%s: %d hits\n", models[i].path, met);
        assert_true(met > 100);
        lum_scene_destroy(scene);
        lum_model_destroy(model);
    }
}

/* A scene with other materials makes no table again that the first one has (the plan makes one for each effect), and has those that are its
 * own. */
static void variants_share_tables(void **state)
{
    (void)state;
    lum_model *model = make_model();
    lum_scene *scene = make_scene(model, false), *variant;
    lum_model other = *model;
    other.materials = malloc(model->material_count * sizeof *other.materials);
    assert_non_null(other.materials);
    memcpy(other.materials, model->materials, model->material_count * sizeof *other.materials);
    other.materials[0].roughness = 0.317f;
    lmg_error err;
    assert_int_equal(lum_scene_create_variant(scene, &other, &variant, &err), LMG_OK);
    for (uint32_t i = 1; i < model->material_count; i++) {
        const struct lum_tables *a = &scene->tables.tables[i], *b = &variant->tables.tables[i];
        assert_ptr_equal(a->metal, b->metal);
        assert_ptr_equal(a->clearcoat, b->clearcoat);
        assert_ptr_equal(a->cosines, b->cosines);
        assert_ptr_equal(a->stretched, b->stretched);
        assert_ptr_equal(a->film, b->film);
        assert_int_equal(a->media, b->media);
        for (int k = 0; k < a->media; k++) {
            assert_ptr_equal(a->medium[k].coat, b->medium[k].coat);
            assert_ptr_equal(a->medium[k].outside, b->medium[k].outside);
            assert_ptr_equal(a->medium[k].changed, b->medium[k].changed);
        }
    }
    assert_ptr_not_equal(scene->tables.tables[0].medium[0].coat, variant->tables.tables[0].medium[0].coat);
    lum_scene_destroy(variant);
    lum_scene_destroy(scene);
    free(other.materials);
    free_model(model);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(films_are_exact),          cmocka_unit_test(sheen_is_bounded), cmocka_unit_test(nothing_changes_nothing),
        cmocka_unit_test(brushing_spreads_along),   cmocka_unit_test(reciprocity),      cmocka_unit_test(white_furnace),
        cmocka_unit_test(samples_follow_densities), cmocka_unit_test(real_models),      cmocka_unit_test(stretched_albedo),
        cmocka_unit_test(variants_share_tables),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
