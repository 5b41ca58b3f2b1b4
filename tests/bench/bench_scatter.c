/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Time per call of what a photon tracer does at a hit, and of finding the hit: nanoseconds of processor time on one thread, best of
 * five rounds. Prints one line per material: lum_surface_at, lum_scatter_trace (with polarization), both; and for the scene Embree
 * alone, through lum_scene_intersect, and a whole segment (intersect, surface, scatter, offset) on the same kind of rays.
 */
#include "../unit/make_model.h"

#include <luminaires/rng.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { HITS = 4096, ROUNDS = 5, REPEAT = 100 };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static lmg_vec3 random_direction(lum_rng *rng)
{
    double z = 2 * lum_rng_next(rng) - 1, phi = 6.283185307179586 * lum_rng_next(rng), r = sqrt(1 - z * z);
    return (lmg_vec3){r * cos(phi), r * sin(phi), z};
}

static double sink;

static void run(const char *name, uint32_t (*make)(lum_model *))
{
    lum_model *model = make_model();
    uint32_t m = make(model);
    make_sphere(model, (lmg_vec3){0, 0, 0}, 0.5, 71, true, true, m); /* 20 thousand triangles */
    finish_model(model);
    lum_scene *scene;
    if (lum_scene_create(model, &scene, NULL)) {
        exit(1);
    }
    unsigned saved = lum_thread_begin();
    static lum_hit hits[HITS];
    static lmg_vec3 travel[HITS];
    static lum_surface surfaces[HITS];
    static double xi[HITS][4];
    static float rays[HITS * 6];
    static lmg_vec3 origins[HITS];
    lum_rng rng = lum_rng_stream(1, 0);
    for (int i = 0; i < HITS; i++) {
        lum_hit start;
        lmg_vec3 o = {0.1, 0.05, -0.1}, d = random_direction(&rng);
        if (!lum_scene_intersect(scene, o, d, &start)) {
            exit(1);
        }
        do { /* from wall to wall, as in a lamp */
            d = random_direction(&rng);
        } while (d.x * start.ng.x + d.y * start.ng.y + d.z * start.ng.z <= 0.01);
        o = lum_offset(&start, d);
        if (!lum_scene_intersect(scene, o, d, &hits[i])) {
            exit(1);
        }
        origins[i] = o;
        travel[i] = d;
        lum_surface_at(scene, &hits[i], d, &surfaces[i]);
        float r[6] = {(float)o.x, (float)o.y, (float)o.z, (float)d.x, (float)d.y, (float)d.z};
        for (int k = 0; k < 6; k++) {
            rays[6 * i + k] = r[k];
        }
        for (int k = 0; k < 4; k++) {
            xi[i][k] = lum_rng_next(&rng);
        }
    }
    double surface = INFINITY, scatter = INFINITY, both = INFINITY, raw = INFINITY, intersect = INFINITY, segment = INFINITY;
    for (int round = 0; round < ROUNDS; round++) {
        double t = now();
        for (int k = 0; k < REPEAT; k++) {
            for (int i = 0; i < HITS; i++) {
                lum_surface s;
                lum_surface_at(scene, &hits[i], travel[i], &s);
                sink += s.ns.x;
            }
        }
        surface = fmin(surface, now() - t);
        t = now();
        for (int k = 0; k < REPEAT; k++) {
            for (int i = 0; i < HITS; i++) {
                lum_scattered out;
                lum_polarization pol = {0};
                lum_scatter_trace(&surfaces[i], (lmg_vec3){-travel[i].x, -travel[i].y, -travel[i].z}, 1, xi[i], &pol, &out);
                sink += out.wo.x;
            }
        }
        scatter = fmin(scatter, now() - t);
        t = now();
        for (int k = 0; k < REPEAT; k++) {
            for (int i = 0; i < HITS; i++) {
                lum_scattered out;
                lum_surface s;
                lum_polarization pol = {0};
                lum_surface_at(scene, &hits[i], travel[i], &s);
                lum_scatter_trace(&s, (lmg_vec3){-travel[i].x, -travel[i].y, -travel[i].z}, 1, xi[i], &pol, &out);
                sink += out.wo.x;
            }
        }
        both = fmin(both, now() - t);
        t = now();
        for (int k = 0; k < REPEAT / 10; k++) {
            sink += (double)lum_scene_trace_raw(scene, rays, HITS);
        }
        raw = fmin(raw, 10 * (now() - t));
        t = now();
        for (int k = 0; k < REPEAT / 10; k++) {
            for (int i = 0; i < HITS; i++) {
                lum_hit hit;
                lum_scene_intersect(scene, origins[i], travel[i], &hit);
                sink += hit.t;
            }
        }
        intersect = fmin(intersect, 10 * (now() - t));
        t = now();
        for (int k = 0; k < REPEAT / 10; k++) {
            for (int i = 0; i < HITS; i++) {
                lum_hit hit;
                lum_surface s;
                lum_scattered out;
                lum_polarization pol = {0};
                lum_scene_intersect(scene, origins[i], travel[i], &hit);
                lum_surface_at(scene, &hit, travel[i], &s);
                double x[4] = {lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng), lum_rng_next(&rng)};
                lum_scatter_trace(&s, (lmg_vec3){-travel[i].x, -travel[i].y, -travel[i].z}, 1, x, &pol, &out);
                lmg_vec3 o = lum_offset(&hit, out.wo);
                sink += o.x;
            }
        }
        segment = fmin(segment, 10 * (now() - t));
    }
    double scale = 1e9 / ((double)REPEAT * HITS);
    printf("%-28s surface %5.1f  scatter %5.1f  both %5.1f | Embree %6.1f  intersect %6.1f  segment %6.1f ns: %.0f %% of Embree "
           "alone\n",
           name, surface * scale, scatter * scale, both * scale, raw * scale, intersect * scale, segment * scale,
           100 * raw / segment);
    lum_thread_end(saved);
    lum_scene_destroy(scene);
    free_model(model);
}

static uint32_t lambert(lum_model *model)
{
    return make_lambert(model, 0.8f);
}
static uint32_t mirror(lum_model *model)
{
    return make_mirror(model, 0.9f, 0);
}
static uint32_t rough_metal(lum_model *model)
{
    return make_mirror(model, 0.9f, 0.4f);
}
static uint32_t glass(lum_model *model)
{
    return make_glass(model, 1.52f, 0, false);
}
static uint32_t pane(lum_model *model)
{
    return make_glass(model, 1.52f, 0, true);
}
static uint32_t frosted(lum_model *model)
{
    return make_glass(model, 1.52f, 0.5f, false);
}
static uint32_t paint(lum_model *model)
{
    uint32_t m = make_material(model, LUM_SURFACE_PBR);
    model->materials[m].roughness = 0.5f;
    return m;
}
static uint32_t gold(lum_model *model)
{
    uint32_t m = make_mirror(model, 1, 0);
    model->materials[m].has_eta = true;
    for (int c = 0; c < 3; c++) {
        model->materials[m].eta[c] = 0.2f + 0.5f * (float)c;
        model->materials[m].k[c] = 3.4f - 0.8f * (float)c;
    }
    return m;
}

static uint32_t layered(lum_model *model, uint32_t layers, float metallic)
{
    uint32_t m = paint(model);
    lum_layers *l = &model->materials[m].layers;
    model->materials[m].metallic = metallic;
    l->present = layers;
    l->clearcoat = 1;
    l->clearcoat_roughness = 0.1f;
    l->sheen_roughness = 0.5f;
    l->sheen_color[0] = l->sheen_color[1] = l->sheen_color[2] = 0.5f;
    l->anisotropy = 0.5f;
    l->iridescence = 1;
    l->iridescence_ior = 1.3f;
    l->thickness_max = 400;
    return m;
}
static uint32_t coated(lum_model *model)
{
    return layered(model, LUM_LAYER_CLEARCOAT, 0);
}
static uint32_t cloth(lum_model *model)
{
    return layered(model, LUM_LAYER_SHEEN, 0);
}
static uint32_t brushed(lum_model *model)
{
    return layered(model, LUM_LAYER_ANISOTROPY, 1);
}
static uint32_t film(lum_model *model)
{
    return layered(model, LUM_LAYER_IRIDESCENCE, 1);
}

int main(void)
{
    run("Lambert", lambert);
    run("mirror", mirror);
    run("mirror of index eta, k", gold);
    run("glass", glass);
    run("pane", pane);
    run("rough metal", rough_metal);
    run("frosted glass", frosted);
    run("paint (PBR, roughness 0.5)", paint);
    run("clear-coated paint", coated);
    run("cloth (sheen)", cloth);
    run("brushed metal", brushed);
    run("film on metal", film);
    return sink == 0.12345;
}
