/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The effect plan.  Nothing changes: every kernel that serves a lamp gives the same rays, bit for bit.  Nothing is missed: for each effect
 * there is a small lamp where it matters; the plan keeps it there, and light traced with other photons changes without it as the plan
 * said.  And what no light reaches is left out.  All seeds are fixed.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "plan.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Two comparisons for each of a dozen lamps: p < 7e-5 each. */
static const double SIGMAS = 4;

static lmg_vec3 v3(double x, double y, double z)
{
    return (lmg_vec3){x, y, z};
}

static uint32_t make_source(lum_model *m)
{
    const uint32_t source = make_material(m, LUM_SURFACE_BLACK);
    for (int k = 0; k < 3; ++k)
        m->materials[source].emissive[k] = 1000;
    return source;
}

/* A square of 20 mm that shines up, from y = 0. */
static void add_panel(lum_model *m)
{
    make_quad(m, v3(-0.01, 0, -0.01), v3(0, 0, 0.02), v3(0.02, 0, 0), 1, make_source(m));
}

/* A ray of light (a spot of 1e-3 radians) from (0, 0, 0) in direction d. */
static void add_ray(lum_model *m, lmg_vec3 d)
{
    m->lights = calloc(1, sizeof(*m->lights));
    assert_non_null(m->lights);
    m->light_count = 1;
    lum_light *l = &m->lights[0];
    strcpy(l->name, "ray");
    l->kind = LUM_LIGHT_SPOT;
    l->direction = d;
    l->intensity[0] = l->intensity[1] = l->intensity[2] = 1000;
    l->cos_inner = cos(0.5e-3);
    l->cos_outer = cos(1e-3);
}

/* A plate of 60 mm over the source, tipped by an angle about x. */
static void add_plate(lum_model *m, double height, double angle, uint32_t material)
{
    const double c = 0.06 * cos(angle), s = 0.06 * sin(angle);
    make_quad(m, v3(-0.03, height - 0.5 * s, -0.5 * c), v3(0, s, c), v3(0.06, 0, 0), 1, material);
}

/* A checkerboard of two texels: half of it black, transparent, and a normal tipped by 30 degrees. */
static void add_image(lum_model *m)
{
    static const float TEXELS[2][4] = {{1, 1, 1, 1}, {0.75f, 0.5f, 0.933f, 0}};
    m->images = calloc(1, sizeof(*m->images));
    float *texels = malloc(sizeof(TEXELS));
    assert_true(m->images && texels);
    memcpy(texels, TEXELS, sizeof(TEXELS));
    m->images[0] = (lum_image){2, 1, texels};
    m->image_count = 1;
    free(m->uv[0]);
    m->uv[0] = calloc(2 * (size_t)m->vertex_count, sizeof(float));
    assert_non_null(m->uv[0]);
    for (uint32_t i = 0; i < m->vertex_count; ++i) {
        m->uv[0][2 * i] = m->positions[3 * i] / 0.06f + 0.5f;
        m->uv[0][2 * i + 1] = m->positions[3 * i + 2] / 0.06f + 0.5f;
    }
}

static lum_texture picture(void)
{
    return (lum_texture){.image = 0, .nearest = true, .m = {{1, 0, 0}, {0, 1, 0}}};
}

static uint32_t make_pbr(lum_model *m, float metallic, float roughness, float grey)
{
    const uint32_t i = make_material(m, LUM_SURFACE_PBR);
    lum_material *p = &m->materials[i];
    p->metallic = metallic;
    p->roughness = roughness;
    p->base_color[0] = p->base_color[1] = p->base_color[2] = grey;
    return i;
}

/* --------------------------------------------------------------------------------------------------------- the lamps */

/* finish_model, and the parts that say which materials are used: one per material. */
static void finish(lum_model *m)
{
    finish_model(m);
    free(m->parts);
    m->parts = calloc(m->material_count, sizeof(*m->parts));
    assert_non_null(m->parts);
    m->part_count = m->material_count;
    for (uint32_t i = 0; i < m->part_count; ++i)
        m->parts[i].material = (int32_t)i;
    for (uint32_t i = 0; i < m->triangle_count; ++i) {
        m->triangle_part[i] = (uint32_t)m->triangle_material[i];
        ++m->parts[m->triangle_part[i]].triangle_count;
    }
}

/* A small lamp in which the effect matters. */
static lum_model *lamp_for(bake_effect effect)
{
    lum_model *m = make_model();
    const double tipped = 0.6;
    uint32_t i;
    if (effect == BAKE_POLARIZATION) {
        /* Four panes near Brewster's angle: polarized light passes the last ones, unpolarized light is reflected at each. */
        add_ray(m, v3(0, 1, 0));
        const uint32_t pane = make_glass(m, 1.52f, 0, true);
        for (int k = 0; k < 4; ++k)
            add_plate(m, 0.1 + 0.1 * k, atan(1.52), pane);
        finish(m);
        return m;
    }
    add_panel(m);
    switch (effect) {
    case BAKE_CONDUCTOR_ROUGH:
        add_plate(m, 0.03, tipped, make_mirror(m, 0.9f, 0.6f));
        break;
    case BAKE_COAT:
        add_plate(m, 0.03, tipped, make_pbr(m, 0, 0.3f, 0.2f));
        break;
    case BAKE_GLASS_THIN:
        add_plate(m, 0.02, 0, make_glass(m, 1.52f, 0, true));
        break;
    case BAKE_GLASS_SMOOTH:
        make_sphere(m, v3(0, 0.04, 0), 0.02, 24, false, true, make_glass(m, 1.52f, 0, false));
        break;
    case BAKE_GLASS_ROUGH:
        make_sphere(m, v3(0, 0.04, 0), 0.02, 24, false, true, make_glass(m, 1.52f, 0.6f, false));
        break;
    case BAKE_ABSORPTION:
    case BAKE_MEDIUM:
        i = make_glass(m, 1.3f, 0, false);
        for (int k = 0; k < 3; ++k) {
            m->materials[i].absorption[k] = effect == BAKE_ABSORPTION ? 30 : 0;
            m->materials[i].scattering[k] = effect == BAKE_MEDIUM ? 100 : 0;
        }
        make_box(m, v3(-0.02, 0.005, -0.02), v3(0.02, 0.02, 0.02), false, 2, i);
        break;
    case BAKE_DIFFUSE_TRANSMISSION:
        i = make_lambert(m, 0.8f);
        m->materials[i].kind = LUM_SURFACE_PBR;
        m->materials[i].roughness = 1;
        m->materials[i].ior = 1.5f;
        m->materials[i].diffuse_transmission = 0.5f;
        for (int k = 0; k < 3; ++k)
            m->materials[i].diffuse_transmission_color[k] = 0.8f;
        add_plate(m, 0.02, 0, i);
        break;
    case BAKE_COVERAGE:
        i = make_lambert(m, 0.5f);
        m->materials[i].alpha_mode = LUM_ALPHA_BLEND;
        m->materials[i].base_color[3] = 0.4f;
        add_plate(m, 0.02, 0, i);
        break;
    case BAKE_TEXTURES:
    case BAKE_NORMAL_MAPS:
        i = effect == BAKE_TEXTURES ? make_pbr(m, 0, 1, 0.9f) : make_pbr(m, 1, 0, 0.9f);
        if (effect == BAKE_TEXTURES)
            m->materials[i].base_texture = picture();
        else
            m->materials[i].normal_texture = picture();
        m->materials[i].normal_scale = 1;
        /* over one half of the picture, not the mean of it */
        make_quad(m, v3(0.005, 0.02, -0.03), v3(0, 0, 0.06), v3(0.03, 0, 0), 1, i);
        add_image(m);
        break;
    default:
        fail_msg("no lamp for %s", bake_effect_name(effect));
    }
    finish(m);
    return m;
}

static bake_source *tracer_with(const lum_model *m, uint32_t effects)
{
    bake_source *s;
    lmg_error err = {{0}};
    if (bake_tracer_create_with(m, effects, 5, NULL, &s, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return s;
}

static void plan_for(const lum_model *m, double error, unsigned threads, bake_plan *plan)
{
    bake_source *s = tracer_with(m, UINT32_MAX);
    const bake_plan_options o = {.error = error, .threads = threads};
    lmg_error err = {{0}};
    if (bake_plan_make(m, s, 5, &o, plan, &err) != LMG_OK)
        fail_msg("%s", err.message);
    s->destroy(s);
}

static const bake_plan_entry *entry_of(const bake_plan *plan, bake_effect effect)
{
    for (size_t i = 0; i < plan->count; ++i)
        if (plan->entries[i].effect == effect)
            return &plan->entries[i];
    fail_msg("%s isn't in the plan", bake_effect_name(effect));
    return NULL;
}

/* Share of the light that leaves, of photons that the plan didn't use. */
static double share_out(const lum_model *m, uint32_t effects, double *error)
{
    const double photons = 200000;
    bake_source *s = tracer_with(m, effects);
    bake_tally t = {0};
    lmg_error err = {{0}};
    assert_int_equal(s->run(s, 0, (uint64_t)photons, 0, NULL, 0, &t, &err), LMG_OK);
    s->destroy(s);
    const double share = t.escaped / photons;
    *error = sqrt(share * (1 - share) / photons);
    return share;
}

static const bake_effect MEASURED[] = {BAKE_CONDUCTOR_ROUGH, BAKE_COAT,     BAKE_GLASS_THIN,   BAKE_GLASS_SMOOTH,
                                       BAKE_GLASS_ROUGH,     BAKE_ABSORPTION, BAKE_MEDIUM,     BAKE_DIFFUSE_TRANSMISSION,
                                       BAKE_COVERAGE,        BAKE_TEXTURES, BAKE_NORMAL_MAPS,  BAKE_POLARIZATION};
enum { MEASURED_COUNT = sizeof(MEASURED) / sizeof(MEASURED[0]) };

static void test_nothing_is_missed(void **state)
{
    (void)state;
    for (int k = 0; k < MEASURED_COUNT; ++k) {
        lum_model *m = lamp_for(MEASURED[k]);
        bake_plan plan;
        plan_for(m, 0.01, 0, &plan);
        const bake_plan_entry *e = entry_of(&plan, MEASURED[k]);
        double with_error, without_error;
        const double with = share_out(m, plan.contained, &with_error);
        const double without = share_out(m, plan.contained & ~(1u << MEASURED[k]), &without_error);
        const double change = without / with - 1, error = hypot(with_error * without / with, without_error) / with;
        print_message("%s: met by %.1f %%; plan: flux %+.2f +- %.2f %%, far %.1f, near %.1f; traced: flux %+.2f +- %.2f %%\n",
                      bake_effect_name(MEASURED[k]), 100 * e->met, 100 * e->flux.value, 100 * e->flux.error, 100 * e->far_field.value,
                      100 * e->near_field.value, 100 * change, 100 * error);
        assert_true(e->simulated);
        assert_true(e->measured);
        assert_true(e->bound > 0.01);
        assert_true(fmax(e->flux.sigmas, fmax(e->far_field.sigmas, e->near_field.sigmas)) > SIGMAS);
        assert_true(fabs(change - e->flux.value) <= SIGMAS * hypot(error, e->flux.error)); /* both 0 where nothing absorbs */
        free_model(m);
    }
}

/* ---------------------------------------------------------------------------------------------------------- decisions */

/* The same effects where no light comes are left out, each with its reason; emission and what has no stand-in stay. */
static void test_unreached_is_left_out(void **state)
{
    (void)state;
    lum_model *m = make_model();
    add_panel(m);
    /* under the panel, which shines up and is black */
    make_quad(m, v3(-0.005, -0.02, -0.005), v3(0, 0, 0.01), v3(0.01, 0, 0), 1, make_mirror(m, 0.9f, 0.5f));
    make_box(m, v3(-0.005, -0.05, -0.005), v3(0.005, -0.04, 0.005), false, 1, make_glass(m, 1.5f, 0.4f, false));
    finish(m);
    bake_plan plan;
    plan_for(m, 0.01, 0, &plan);
    assert_false(entry_of(&plan, BAKE_CONDUCTOR_ROUGH)->simulated);
    assert_false(entry_of(&plan, BAKE_GLASS_ROUGH)->simulated);
    assert_false(entry_of(&plan, BAKE_POLARIZATION)->simulated);
    assert_true(entry_of(&plan, BAKE_EMISSION_AREA)->simulated);
    assert_true(plan.left_out > 0 && plan.left_out <= plan.error);
    bake_source *planned = tracer_with(m, plan.simulated);
    assert_string_equal(bake_tracer_kernel(planned), "glass"); /* smooth glass still */
    planned->destroy(planned);
    free_model(m);
}

/* Asked for an error that nothing can be known to, the plan leaves nothing out; at any error what is left out adds up to less. */
static void test_error_decides(void **state)
{
    (void)state;
    lum_model *m = lamp_for(BAKE_COAT);
    bake_plan strict, lax;
    plan_for(m, 1e-6, 0, &strict);
    plan_for(m, 0.9, 0, &lax);
    assert_true(entry_of(&strict, BAKE_COAT)->simulated);
    assert_false(entry_of(&lax, BAKE_COAT)->simulated);
    assert_true(lax.left_out <= lax.error);
    free_model(m);
}

static void test_threads_dont_matter(void **state)
{
    (void)state;
    lum_model *m = lamp_for(BAKE_GLASS_ROUGH);
    bake_plan one, three;
    plan_for(m, 0.01, 1, &one);
    plan_for(m, 0.01, 3, &three);
    char *a = bake_plan_text(&one), *b = bake_plan_text(&three);
    assert_string_equal(a, b);
    free(a);
    free(b);
    free_model(m);
}

static void test_names(void **state)
{
    (void)state;
    uint32_t effects;
    lmg_error err = {{0}};
    assert_int_equal(bake_effects_parse("coat, glass-smooth,polarization", &effects, &err), LMG_OK);
    assert_int_equal(effects, 1u << BAKE_COAT | 1u << BAKE_GLASS_SMOOTH | 1u << BAKE_POLARIZATION);
    assert_int_equal(bake_effects_parse("coat,glas", &effects, &err), LMG_ERROR_ARGUMENT);
    assert_non_null(strstr(err.message, "'glas'"));
    char text[512];
    bake_effects_print((1u << BAKE_EFFECT_COUNT) - 1, text, sizeof(text));
    assert_int_equal(bake_effects_parse(text, &effects, &err), LMG_OK);
    assert_int_equal(effects, (1u << BAKE_EFFECT_COUNT) - 1);
}

/* ----------------------------------------------------------------------------------------------------- nothing changes */

static uint64_t bits(double x)
{
    uint64_t b;
    memcpy(&b, &x, sizeof(b));
    return b;
}

/* A hash of the set of rays that any order gives alike. */
static void hash_rays(void *self, const lmg_ray *rays, size_t count)
{
    _Atomic uint64_t *hash = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_ray *r = &rays[i];
        uint64_t h = r->number;
        const double values[9] = {r->origin.x,    r->origin.y,        r->origin.z,        r->direction.x,    r->direction.y,
                                  r->direction.z, (double)r->flux[0], (double)r->flux[1], (double)r->flux[2]};
        for (int k = 0; k < 9; ++k)
            h = lum_mix64(h ^ bits(values[k]));
        *hash += h;
    }
}

/* Traces on every kernel that serves the lamp; returns how many those are. */
static int compare_kernels(const lum_model *m, uint32_t effects)
{
    int served = 0;
    uint64_t first_hash = 0;
    bake_tally first = {0};
    bake_source *s = tracer_with(m, effects);
    for (size_t i = 0; i < 32; ++i) {
        if (!bake_tracer_use_kernel(s, i))
            continue;
        _Atomic uint64_t hash = 0;
        const lmg_sink sink = {&hash, hash_rays};
        bake_tally tally = {0};
        lmg_error err;
        assert_int_equal(s->run(s, 0, 20000, 2, &sink, 1, &tally, &err), LMG_OK);
        if (served++ == 0) {
            first_hash = hash;
            first = tally;
        }
        assert_true(hash == first_hash);
        assert_memory_equal(&tally, &first, sizeof(tally));
    }
    s->destroy(s);
    return served;
}

static void test_nothing_changes(void **state)
{
    (void)state;
    const uint32_t unpolarized = ~(1u << BAKE_POLARIZATION);
    /* only what every kernel has: source, mirrors, diffuse surfaces of colours */
    lum_model *m = make_model();
    add_panel(m);
    const uint32_t wall = make_lambert(m, 0.7f);
    m->materials[wall].base_color[0] = 0.3f;
    add_plate(m, 0.03, 0.5, make_mirror(m, 0.9f, 0.3f));
    add_plate(m, -0.02, -0.3, wall);
    finish(m);
    const int all = compare_kernels(m, UINT32_MAX);
    print_message("%d kernels give the same rays\n", all);
    assert_true(all >= 6);
    free_model(m);
    for (int k = 0; k < MEASURED_COUNT; ++k) {
        m = lamp_for(MEASURED[k]);
        assert_true(compare_kernels(m, unpolarized) >= 2);
        assert_true(compare_kernels(m, UINT32_MAX) >= 1);
        /* naming an effect that the model doesn't have changes nothing */
        assert_int_equal(bake_effects_of(m) & 1u << BAKE_EMISSION_TEXTURED, 0);
        free_model(m);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_nothing_is_missed),   cmocka_unit_test(test_unreached_is_left_out), cmocka_unit_test(test_error_decides),
        cmocka_unit_test(test_threads_dont_matter), cmocka_unit_test(test_names),                 cmocka_unit_test(test_nothing_changes),
    };
    return cmocka_run_group_tests_name("plan", tests, NULL, NULL);
}
