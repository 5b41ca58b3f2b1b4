/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The effect plan.  Nothing changes: every kernel that serves a lamp gives the same rays, bit for bit.  Nothing is missed: for each
 * effect there is a small lamp where it matters; the plan keeps it there, and light traced with other photons changes without it as
 * the plan said.  And what no light reaches is left out.  All seeds are fixed.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "../unit/make_model.h"
#include "plan.h"

#include <luminaires/medium.h>
#include <luminaires/rng.h>
#include <luminaires/spectrum.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Two comparisons for each of two dozen lamps: p < 7e-5 each. */
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

/* Spectra and lattices that the lamps borrow. */
typedef struct borrowed {
    lum_spectrum blue, yellow, band, glass;
    lum_volume volume;
} borrowed;

static void shine_blue(lum_model *m, borrowed *b)
{
    double rgb[3];
    lum_spectrum_gaussian(450, 20, &b->blue);
    lum_spectrum_rgb(&b->blue, rgb);
    for (uint32_t i = 0; i < m->material_count; ++i)
        if (m->materials[i].emissive[0] > 0) {
            m->materials[i].spectral.emission = &b->blue;
            m->materials[i].spectral.measured = true;
            for (int k = 0; k < 3; ++k)
                m->materials[i].emissive[k] = (float)(1000 * rgb[k]);
        }
}

/* A ray on a prism of dense flint, apex of 35 degrees. */
static void add_prism(lum_model *m, borrowed *b)
{
    const uint32_t glass = make_glass(m, 1.7847f, 0, false);
    lum_index_model flint;
    assert_true(lum_index_of_glass("N-SF11", &flint));
    assert_int_equal(lum_spectrum_of_index(&flint, &b->glass, NULL), LMG_OK);
    m->materials[glass].spectral.index = &b->glass;
    const double h = 0.05, f = h * tan(0.61), w = 0.05;
    const lmg_vec3 top[2] = {{0, h, -w}, {0, h, w}}, near[2] = {{0, 0, -w}, {0, 0, w}}, far[2] = {{f, 0, -w}, {f, 0, w}};
    make_triangle(m, near[0], near[1], top[1], glass); /* the face that the ray meets looks to -x */
    make_triangle(m, near[0], top[1], top[0], glass);
    make_triangle(m, far[1], far[0], top[0], glass);
    make_triangle(m, far[1], top[0], top[1], glass);
    make_triangle(m, near[1], near[0], far[0], glass);
    make_triangle(m, near[1], far[0], far[1], glass);
    make_triangle(m, near[0], top[0], far[0], glass);
    make_triangle(m, near[1], far[1], top[1], glass);
    add_ray(m, v3(cos(0.7), sin(0.7), 0));
    m->lights[0].position = v3(-0.02 * cos(0.7), 0.02 - 0.02 * sin(0.7), 0);
}

/* Smoke in a cube of 60 mm over the source: alike everywhere, or a lattice of 8^3 densities from 0 to 2. */
static void add_smoke(lum_model *m, borrowed *b, bool lattice)
{
    enum { N = 8 };
    const int32_t low[3] = {0, 0, 0};
    const uint32_t n = lattice ? N : 1, size[3] = {n, n, n};
    float density[N * N * N];
    for (uint32_t i = 0; i < n * n * n; ++i)
        density[i] = lattice ? 2 * (float)(i % N) / (N - 1) : 1;
    lum_volume *v = &b->volume;
    *v = (lum_volume){.scattering = {15, 15, 15}, .absorption = {3, 3, 3}, .anisotropy = 0.3f};
    lmg_error err = {{0}};
    if (lum_grid_create(low, size, density, lattice ? LUM_INTERPOLATION_LINEAR : LUM_INTERPOLATION_NEAREST, 0.9 / n, &v->grid,
                        &err))
        fail_msg("%s", err.message);
    for (int a = 0; a < 3; ++a) {
        v->to_index[a][a] = n / 0.06;
        v->to_index[a][3] = (n - 1) / 2.0;
    }
    v->to_index[1][3] -= 0.035 * n / 0.06; /* from 5 to 65 mm above the source */
    m->volumes = v;
    m->volume_count = 1;
    m->bounds_min = v3(-0.04, 0, -0.04);
    m->bounds_max = v3(0.04, 0.07, 0.04);
}

static void free_lamp(lum_model *m)
{
    for (uint32_t i = 0; i < m->volume_count; ++i)
        lum_grid_destroy(m->volumes[i].grid);
    m->volumes = NULL;
    m->volume_count = 0;
    free_model(m);
}

/* A small lamp in which the effect matters; variant: another one, where there are several. */
static lum_model *lamp_for(bake_effect effect, bool variant, borrowed *b)
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
    if (effect == BAKE_DISPERSION) {
        add_prism(m, b);
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
    case BAKE_CLEARCOAT:
    case BAKE_SHEEN:
        i = make_pbr(m, effect == BAKE_CLEARCOAT ? 1 : 0, effect == BAKE_CLEARCOAT ? 0.7f : 1, 0.2f);
        m->materials[i].layers.present = effect == BAKE_CLEARCOAT ? LUM_LAYER_CLEARCOAT : LUM_LAYER_SHEEN;
        m->materials[i].layers.clearcoat = 1;
        m->materials[i].layers.clearcoat_roughness = 0.1f;
        m->materials[i].layers.sheen_roughness = 0.4f;
        for (int k = 0; k < 3; ++k)
            m->materials[i].layers.sheen_color[k] = 0.9f;
        add_plate(m, 0.03, tipped, i);
        break;
    case BAKE_SPECULAR:
        i = make_pbr(m, 0, 0.2f, 0.05f);
        m->materials[i].layers.present = LUM_LAYER_SPECULAR;
        m->materials[i].layers.specular = 0.2f;
        add_plate(m, 0.03, tipped, i);
        break;
    case BAKE_ANISOTROPY:
        i = make_pbr(m, 1, 0.25f, 0.8f);
        m->materials[i].layers.present = LUM_LAYER_ANISOTROPY;
        m->materials[i].layers.anisotropy = 0.9f;
        add_plate(m, 0.03, tipped, i);
        break;
    case BAKE_IRIDESCENCE:
        i = make_pbr(m, 1, 0.3f, 0.3f);
        m->materials[i].layers.present = LUM_LAYER_IRIDESCENCE;
        m->materials[i].layers.iridescence = 1;
        m->materials[i].layers.iridescence_ior = 2;
        m->materials[i].layers.thickness_max = 250;
        add_plate(m, 0.03, tipped, i);
        break;
    case BAKE_SPECTRA:
        /* Grey to R,G,B, but dark in the source's light. */
        shine_blue(m, b);
        i = make_lambert(m, 0.5f);
        lum_spectrum_gaussian(600, 120, &b->band);
        m->materials[i].spectral.reflectance = &b->band;
        add_plate(m, 0.03, tipped, i);
        break;
    case BAKE_FLUORESCENCE:
        shine_blue(m, b);
        i = make_lambert(m, 0.5f);
        m->materials[i].diffuse_transmission = 0.5f;
        lum_spectrum_gaussian(560, 110, &b->yellow);
        lum_spectrum_gaussian(455, 60, &b->band);
        m->materials[i].spectral =
            (lum_spectral){.excitation = &b->band, .converted = &b->yellow, .quantum_yield = 0.7f, .forward = 0.5f};
        add_plate(m, 0.03, 0, i);
        break;
    case BAKE_VOLUMES:
        finish(m);
        add_smoke(m, b, variant);
        return m;
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
    /* of photons that carry different amounts, by their squares */
    const double square = t.escaped_squares > 0 ? t.escaped_squares / photons : share;
    *error = sqrt((square - share * share) / photons);
    return share;
}

/* Those from BAKE_VOLUMES on aren't known to several kernels. */
static const bake_effect MEASURED[] = {BAKE_CONDUCTOR_ROUGH, BAKE_COAT,        BAKE_GLASS_THIN,  BAKE_GLASS_SMOOTH,
                                       BAKE_GLASS_ROUGH,     BAKE_ABSORPTION,  BAKE_MEDIUM,      BAKE_DIFFUSE_TRANSMISSION,
                                       BAKE_COVERAGE,        BAKE_TEXTURES,    BAKE_NORMAL_MAPS, BAKE_POLARIZATION,
                                       BAKE_CLEARCOAT,       BAKE_SHEEN,       BAKE_ANISOTROPY,  BAKE_IRIDESCENCE,
                                       BAKE_SPECULAR,        BAKE_VOLUMES,     BAKE_VOLUMES,     BAKE_DISPERSION,
                                       BAKE_SPECTRA,         BAKE_FLUORESCENCE};
enum { MEASURED_COUNT = sizeof(MEASURED) / sizeof(MEASURED[0]) };

static void test_nothing_is_missed(void **state)
{
    (void)state;
    for (int k = 0; k < MEASURED_COUNT; ++k) {
        borrowed b;
        lum_model *m = lamp_for(MEASURED[k], k > 0 && MEASURED[k - 1] == MEASURED[k], &b);
        bake_plan plan;
        plan_for(m, 0.01, 0, &plan);
        const bake_plan_entry *e = entry_of(&plan, MEASURED[k]);
        double with_error, without_error;
        const double with = share_out(m, plan.contained, &with_error);
        const double without = share_out(m, plan.contained & ~(1u << MEASURED[k]), &without_error);
        const double change = without / with - 1, error = hypot(with_error * without / with, without_error) / with;
        print_message("%s: met by %.1f %%; plan: flux %+.2f +- %.2f %%, far %.1f, near %.1f; traced: flux %+.2f +- %.2f %%\n",
                      bake_effect_name(MEASURED[k]), 100 * e->met, 100 * e->flux.value, 100 * e->flux.error,
                      100 * e->far_field.value, 100 * e->near_field.value, 100 * change, 100 * error);
        assert_true(e->simulated);
        assert_true(e->measured);
        assert_true(e->bound > 0.01);
        assert_true(fmax(e->flux.sigmas, fmax(e->far_field.sigmas, e->near_field.sigmas)) > SIGMAS);
        assert_true(fabs(change - e->flux.value) <= SIGMAS * hypot(error, e->flux.error)); /* both 0 where nothing absorbs */
        free_lamp(m);
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
    lum_model *m = lamp_for(BAKE_COAT, false, NULL);
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
    lum_model *m = lamp_for(BAKE_GLASS_ROUGH, false, NULL);
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
    for (int k = 0; MEASURED[k] != BAKE_VOLUMES; ++k) {
        m = lamp_for(MEASURED[k], false, NULL);
        assert_true(compare_kernels(m, unpolarized) >= 2);
        assert_true(compare_kernels(m, UINT32_MAX) >= 1);
        /* naming an effect that the model doesn't have changes nothing */
        assert_int_equal(bake_effects_of(m) & 1u << BAKE_EMISSION_TEXTURED, 0);
        free_model(m);
    }
}

/* A plan costs a short bake a share of its time: of six seconds at most a tenth of a minute's photons, down to those that a plan needs at
 * least; and its text tells how many there were. */
static void test_short_bakes(void **state)
{
    (void)state;
    lmg_error err = {{0}};
    lum_model *m;
    if (lum_model_load(LUMIBOX_BINARY_DIR "/models/opal-globe/opal-globe.gltf", NULL, &m, &err) != LMG_OK)
        fail_msg("%s", err.message);
    bake_source *s = tracer_with(m, UINT32_MAX);
    static const double SECONDS[3] = {0.01, 6, 6000};
    uint64_t photons[3];
    for (int i = 0; i < 3; ++i) {
        bake_plan plan;
        if (bake_plan_make(m, s, 5, &(bake_plan_options){.seconds = SECONDS[i]}, &plan, &err) != LMG_OK)
            fail_msg("%s", err.message);
        photons[i] = plan.photons;
        char *text = bake_plan_text(&plan);
        assert_non_null(text);
        assert_int_equal(bake_plan_text_photons(text), plan.photons);
        free(text);
    }
    assert_int_equal(photons[0], 2048);
    assert_true(10 * photons[1] <= 65536 && photons[1] >= photons[0]);
    assert_true(photons[2] > photons[1]);
    assert_int_equal(bake_plan_text_photons(NULL), 0);
    assert_int_equal(bake_plan_text_photons("effects chosen by the user"), 0);
    s->destroy(s);
    lum_model_destroy(m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_nothing_is_missed),
        cmocka_unit_test(test_unreached_is_left_out),
        cmocka_unit_test(test_error_decides),
        cmocka_unit_test(test_short_bakes),
        cmocka_unit_test(test_threads_dont_matter),
        cmocka_unit_test(test_names),
        cmocka_unit_test(test_nothing_changes),
    };
    return cmocka_run_group_tests_name("plan", tests, NULL, NULL);
}
