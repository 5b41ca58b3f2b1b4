/* SPDX-License-Identifier: Apache-2.0 */
/* Lights with a photometric file's profile in a lamp: from EXT_lights_ies and from recipes.  The source itself has the file's flux
 * and far field, turned with its node, and lights a point as its luminous shape would. */
#include "goniometer.h"
#include "source.h"
#include "stats.h"

#include <luminaires/photometry.h>
#include <luminaires/scatter.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static const double PI = 3.14159265358979323846;

/* A lopsided beam, bright enough everywhere below to be counted. */
static lum_photometry *make_file(const char *path, lum_shape shape)
{
    lum_photometry *p;
    lmg_error err;
    assert_int_equal(lum_photometry_create(13, 13, &p, NULL), LMG_OK);
    for (int i = 0; i < 13; i++)
        p->h[i] = 30 * i;
    for (int j = 0; j < 13; j++)
        p->v[j] = 10 * j;
    for (int i = 0; i < 13; i++)
        for (int j = 0; j < 13; j++)
            p->intensity[i * 13 + j] = 60 + 500 * exp(-0.05 * (j - 3) * (j - 3)) * (1 + 0.6 * cos(PI * (i - 2) / 6) * (j > 0));
    p->shape = shape;
    if (lum_photometry_write(p, path, NULL, NULL, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return p;
}

static void write_text(const char *path, const char *text)
{
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
}

enum { RINGS = 20, SECTORS = 24, PHOTONS = 400000 };

typedef struct bins {
    double count[RINGS * SECTORS];
} bins;

static void consume(void *self, const lmg_ray *rays, size_t count)
{
    bins *b = self;
    for (size_t i = 0; i < count; i++) {
        const lmg_vec3 d = rays[i].direction;
        const int r = (int)(0.5 * (d.y + 1) * RINGS), s = (int)((atan2(d.z, d.x) / (2 * PI) + (d.z < 0)) * SECTORS);
        b->count[(r < RINGS ? r : RINGS - 1) * SECTORS + (s < SECTORS ? s : SECTORS - 1)]++;
    }
}

/* Null hypothesis: the model's light is the file's, with the model's X, Y, Z axes seen by the file as x, y, z. */
static void check_far_field(const char *model_path, const char *recipe_path, const lum_photometry *p, lmg_vec3 x, lmg_vec3 y,
                            lmg_vec3 z, double factor)
{
    enum { FINE = 20 };
    lum_recipe *recipe = NULL;
    lum_model *model;
    lmg_error err = {""};
    if ((recipe_path && lum_recipe_read(recipe_path, &recipe, &err) != LMG_OK) ||
        lum_model_load(model_path, recipe, &model, &err) != LMG_OK)
        fail_msg("%s", err.message);
    assert_int_equal(model->light_count, 1);
    assert_int_equal(model->lights[0].kind, LUM_LIGHT_PROFILE);
    bake_source *source;
    assert_int_equal(bake_tracer_create(model, 11, &source, &err), LMG_OK);
    lum_photometry_measures m;
    assert_int_equal(lum_photometry_measure(p, &m, NULL), LMG_OK);
    assert_true(fabs(source->flux / (m.flux * factor) - 1) < 1e-6); /* the factor went through float */
    bins seen = {{0}};
    double expected[RINGS * SECTORS] = {0}, total = 0;
    const lmg_sink sink = {&seen, consume};
    bake_tally tally = {0};
    assert_int_equal(source->run(source, 0, PHOTONS, 1, &sink, 1, &tally, &err), LMG_OK);
    assert_true(tally.escaped == PHOTONS);
    for (int r = 0; r < RINGS; r++)
        for (int s = 0; s < SECTORS; s++)
            for (int f = 0; f < FINE * FINE; f++) {
                const double h = 2 * (r + (f % FINE + 0.5) / FINE) / RINGS - 1,
                             phi = 2 * PI * (s + (f / FINE + 0.5) / FINE) / SECTORS;
                const double a = sqrt(1 - h * h) * cos(phi), c = sqrt(1 - h * h) * sin(phi);
                const lmg_vec3 local = {a * x.x + h * y.x + c * z.x, a * x.y + h * y.y + c * z.y, a * x.z + h * y.z + c * z.z};
                expected[r * SECTORS + s] += lum_photometry_intensity(p, local);
            }
    for (int i = 0; i < RINGS * SECTORS; i++)
        total += expected[i];
    for (int i = 0; i < RINGS * SECTORS; i++)
        expected[i] *= PHOTONS / total;
    const double p_value = stats_chi_square(seen.count, expected, RINGS * SECTORS, NULL, NULL);
    printf("%s: p = %.3f\n", model_path, p_value);
    assert_true(p_value > 0.001);
    source->destroy(source);
    lum_model_destroy(model);
    lum_recipe_destroy(recipe);
}

static void a_light_of_ext_lights_ies(void **state)
{
    (void)state;
    /* Our own writer's file: turned so that the lamp's down is down. */
    lum_photometry *p = make_file("profile_light.gltf", (lum_shape){.kind = LUM_SHAPE_POINT});
    check_far_field("profile_light.gltf", NULL, p, (lmg_vec3){1, 0, 0}, (lmg_vec3){0, 1, 0}, (lmg_vec3){0, 0, 1}, 1);
    lum_photometry_destroy(p);
    unlink("profile_light.gltf");
    /* As the extension has it: an untransformed node shines along -Z, plane 0 towards +X; from a file beside, made weaker and
     * moved; scale and mirror of the node's parents don't matter to intensities. */
    p = make_file("profile_light.ies", (lum_shape){LUM_SHAPE_RECTANGLE, 0.3, 0.2, 0});
    write_text(
        "profile_light.gltf",
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"EXT_lights_ies\"],\"extensionsRequired\":[\"EXT_lights_ies\"],"
        "\"extensions\":{\"EXT_lights_ies\":{\"lights\":[{\"uri\":\"profile_light.ies\"}]}},\"scene\":0,\"scenes\":[{\"nodes\":[0]}"
        "],"
        "\"nodes\":[{\"name\":\"L\",\"translation\":[1,2,3],\"scale\":[2,2,2],\"extensions\":{\"EXT_lights_ies\":{\"light\":0,"
        "\"multiplier\":0.25,\"color\":[1,1,1]}}}]}");
    /* Model X is the file's x, model Z (opposite to the beam) its up, y; model Y is its C90, -z. */
    check_far_field("profile_light.gltf", NULL, p, (lmg_vec3){1, 0, 0}, (lmg_vec3){0, 0, -1}, (lmg_vec3){0, 1, 0}, 0.25);
    lum_photometry_destroy(p);
    unlink("profile_light.gltf");
    unlink("profile_light.ies");
}

static const char NODE[] =
    "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"Head\","
    "\"translation\":[0,1,0],\"rotation\":[0,0,0.7071067811865476,0.7071067811865476]}]}";

static void a_profile_by_recipe(void **state)
{
    (void)state;
    lum_photometry *p = make_file("profile_light.ldt", (lum_shape){LUM_SHAPE_RECTANGLE, 0.3, 0.2, 0});
    write_text("profile_light.gltf", NODE); /* turned by 90 degrees about Z: the file's x is the model's Y, its y the model's -X */
    write_text("profile_light.json",
               "{\"entries\": [{\"match\": \"He*\", \"profile\": {\"file\": \"profile_light.ldt\", \"lumens\": 500}}]}");
    lum_photometry_measures m;
    assert_int_equal(lum_photometry_measure(p, &m, NULL), LMG_OK);
    check_far_field("profile_light.gltf", "profile_light.json", p, (lmg_vec3){0, -1, 0}, (lmg_vec3){1, 0, 0}, (lmg_vec3){0, 0, 1},
                    500 / m.flux);

    /* Illuminance (across the direction) at points near and far, against the sum over the rectangle. */
    lum_recipe *recipe;
    lum_model *model;
    lum_emitters *emitters;
    lmg_error err;
    assert_int_equal(lum_recipe_read("profile_light.json", &recipe, &err), LMG_OK);
    assert_int_equal(lum_model_load("profile_light.gltf", recipe, &model, &err), LMG_OK);
    assert_int_equal(lum_emitters_create(model, &emitters, &err), LMG_OK);
    /* The luminous opening stands upright in Y-Z: it is in the bounds. */
    assert_true(fabs(model->bounds_max.y - model->bounds_min.y - 0.3) < 1e-6 &&
                fabs(model->bounds_max.z - model->bounds_min.z - 0.2) < 1e-6);
    static const lmg_vec3 points[] = {{0.1, 0.05, 0.02}, {0.5, -0.3, 0.2}, {7, 3, -2}};
    for (int k = 0; k < 3; k++) {
        stats_mean mean = {0};
        lum_rng rng = lum_rng_stream(3, (uint64_t)k);
        const lmg_vec3 at = points[k];
        for (int i = 0; i < 20000; i++) {
            const double xi[3] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
            lum_light_sample s;
            stats_add(&mean, lum_emitters_sample_point(emitters, at, xi, &s) ? lmg_luminance(s.radiance) : 0);
        }
        double sum = 0;
        enum { N = 200 };
        for (int i = 0; i < N * N; i++) { /* positions are relative to the model's centre, where the light is */
            const double y = 0.3 * ((i % N + 0.5) / N - 0.5), z = 0.2 * ((i / N + 0.5) / N - 0.5);
            const lmg_vec3 d = {at.x, at.y - y, at.z - z};
            const double r = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
            sum += lum_photometry_intensity(p, (lmg_vec3){d.y / r, -d.x / r, d.z / r}) / (r * r) / (N * N);
        }
        sum *= 500 / m.flux;
        printf("%g lx, sampled %g +- %g\n", sum, mean.mean, stats_error(&mean));
        assert_true(fabs(mean.mean - sum) < 4 * stats_error(&mean) + 1e-4 * sum);
    }
    lum_emitters_destroy(emitters);
    lum_model_destroy(model);
    lum_recipe_destroy(recipe);
    lum_photometry_destroy(p);
    unlink("profile_light.gltf");
    unlink("profile_light.json");
    unlink("profile_light.ldt");
}

static void what_cannot_shine_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *entry, *message;
    } bad[] = {
        {"{\"match\": \"Head\", \"profile\": {\"file\": \"profile_light.ies\", \"shape\": \"point\"}}, "
         "{\"match\": \"Nobody\", \"profile\": {\"file\": \"profile_light.ies\"}}",
         "nothing in the scene is called \"Nobody\""},
        {"{\"match\": \"Head\", \"profile\": {\"file\": \"profile_none.ies\"}}", "profile_none.ies"},
        {"{\"match\": \"Head\", \"profile\": {\"file\": \"profile_light.ies\"}}", "is a body"},
        {"{\"match\": \"Head\", \"profile\": {\"fill\": \"profile_light.ies\"}}", "file"},
        {"{\"match\": \"Head\", \"profile\": {\"file\": \"profile_light.ies\", \"lumens\": -1}}", "lumens"},
        {"{\"match\": \"Head\", \"profile\": {\"file\": \"profile_light.ies\"}, \"black\": true}", "stands in an entry of its own"},
        {"{\"match\": \"Head\", \"target\": \"mesh\", \"profile\": {\"file\": \"profile_light.ies\"}}", "belongs to a node"}};
    lum_photometry_destroy(make_file("profile_light.ies", (lum_shape){LUM_SHAPE_BOX, 0.3, 0.2, 0.1}));
    write_text("profile_light.gltf", NODE);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        char text[512];
        snprintf(text, sizeof text, "{\"entries\": [%s]}", bad[i].entry);
        write_text("profile_light.json", text);
        lum_recipe *recipe = NULL;
        lum_model *model = NULL;
        lmg_error err = {""};
        lmg_result result = lum_recipe_read("profile_light.json", &recipe, &err);
        if (result == LMG_OK)
            result = lum_model_load("profile_light.gltf", recipe, &model, &err);
        assert_int_not_equal(result, LMG_OK);
        assert_null(strchr(err.message, '\n'));
        if (!strstr(err.message, bad[i].message))
            fail_msg("\"%s\" doesn't say \"%s\"", err.message, bad[i].message);
        lum_model_destroy(model);
        lum_recipe_destroy(recipe);
    }
    /* In glTF: an index beyond the list, neither uri nor bufferView, no photometric file. */
    static const struct {
        const char *lights, *node, *message;
    } gltf[] = {{"[{\"uri\":\"profile_light.ies\"}]", "{\"light\":1}", "profiles"},
                {"[{}]", "{\"light\":0}", "needs either a uri or a bufferView"},
                {"[{\"uri\":\"profile_light.json\"}]", "{\"light\":0}", "is no photometric file"},
                {"[{\"uri\":\"profile_light.ies\"}]", "{\"light\":0,\"multiplier\":-1}", "multiplier"}};
    for (size_t i = 0; i < sizeof gltf / sizeof *gltf; i++) {
        char text[1024];
        snprintf(text, sizeof text,
                 "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"EXT_lights_ies\"],\"extensions\":{\"EXT_lights_ies\":{"
                 "\"lights\":%s}},"
                 "\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"extensions\":{\"EXT_lights_ies\":%s}}]}",
                 gltf[i].lights, gltf[i].node);
        write_text("profile_light.gltf", text);
        lum_model *model = NULL;
        lmg_error err = {""};
        assert_int_not_equal(lum_model_load("profile_light.gltf", NULL, &model, &err), LMG_OK);
        if (!strstr(err.message, gltf[i].message))
            fail_msg("\"%s\" doesn't say \"%s\"", err.message, gltf[i].message);
    }
    unlink("profile_light.gltf");
    unlink("profile_light.json");
    unlink("profile_light.ies");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_light_of_ext_lights_ies), cmocka_unit_test(a_profile_by_recipe),
                                       cmocka_unit_test(what_cannot_shine_is_refused)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
