/* SPDX-License-Identifier: Apache-2.0 */
/* Light from a table of emitters (emitters.c): photons, one or many at once, and points as seen from elsewhere. */
#include "emitters_data.h"

#include <luminaires/rng.h>

#include <string.h>

/* ------------------------------------------------------------------------------------------------------------- choices */

/* An entry of an alias table of n, in proportion to power. */
static uint32_t pick(const alias_entry *table, uint32_t n, double u)
{
    double x = u * n;
    uint32_t i = (uint32_t)x;
    i = i < n ? i : n - 1;
    return x - i < table[i].keep ? i : table[i].other;
}

/* A vector of a profile light's own frame, in the model's. */
static lmg_vec3 in_model(const lum_light *light, lmg_vec3 v)
{
    return vec_along(vec_along(vec_scale(light->axes[0], v.x), light->axes[1], v.y), light->axes[2], v.z);
}

/* Share of a spot's axial intensity at cosine c. */
static double spot_falloff(const punctual *p, double c)
{
    double a = (c - p->light.cos_outer) / p->width;
    a = a < 0 ? 0 : a > 1 ? 1 : a;
    return a * a;
}

static uint32_t patch_of(const emissive_triangle *t, double b1, double b2)
{
    if (t->n == 1) {
        return t->first_patch;
    }
    uint32_t n = t->n;
    double x = fmin(fmax(b1, 0), 1) * n, y = fmin(fmax(b2, 0), 1) * n;
    uint32_t i = (uint32_t)x, j = (uint32_t)y;
    i = i < n ? i : n - 1;
    uint32_t last = n - 1 - i;
    bool turned = x - i + y - j > 1;
    if (j > last || (j == last && turned)) {
        j = last;
        turned = false;
    }
    return t->first_patch + row_start(n, i) + 2 * j + (turned ? 1 : 0);
}

/* A uniformly distributed point of a patch, as barycentrics of its triangle. */
static void point_in_patch(const emissive_triangle *t, uint32_t index, double x, double y, double *b1, double *b2)
{
    double corner[2], step, r = sqrt(x);
    if (t->n == 1) {
        *b1 = 1 - r;
        *b2 = y * r;
        return;
    }
    uint32_t within = index - t->first_patch, i = row_of(t->n, within);
    patch_corner(t->n, i, within - row_start(t->n, i), corner, &step);
    *b1 = corner[0] + step * (1 - r);
    *b2 = corner[1] + step * (y * r);
}

/* In the model's unit. */
static inline lmg_vec3 point_at(const emissive_triangle *t, double b1, double b2, lmg_vec3 *ng)
{
    lmg_vec3 a = vec_from_float(t->v[0]), n = vec_from_float(t->ng);
    lmg_vec3 e1 = vec_sub(vec_from_float(t->v[1]), a), e2 = vec_sub(vec_from_float(t->v[2]), a);
    *ng = vec_scale(n, 1.5 - 0.5 * vec_dot(n, n)); /* unit in double: a Newton step, as scene.c has it */
    return vec_along(vec_along(a, e1, b1), e2, b2);
}

void lum_emitters_sample(const lum_emitters *emitters, const double xi[6], double (*next)(void *state), void *state,
                         lum_photon *out)
{
    uint32_t i = pick(emitters->alias, emitters->patch_count + emitters->light_count, xi[0]);
    if (i >= emitters->patch_count) {
        const punctual *p = &emitters->lights[i - emitters->patch_count];
        out->origin = p->light.position;
        out->material = LUM_NONE;
        memcpy(out->flux, p->colour, sizeof out->flux);
        if (p->light.kind == LUM_LIGHT_PROFILE) {
            const double on[3] = {xi[1], xi[2], xi[3]};
            const lmg_vec3 d = lum_profile_direction(p->light.profile, next, state);
            out->direction = in_model(&p->light, d);
            out->origin = vec_add(out->origin, in_model(&p->light, lum_shape_point(&p->light.shape, d, on)));
        } else if (p->light.kind == LUM_LIGHT_POINT) {
            out->direction = vec_about(vec(0, 0, 1), 2 * xi[1] - 1, xi[2]);
        } else {
            double c;
            if (xi[5] < p->ramp) {
                c = p->light.cos_outer + p->width * p->ramp_top * cbrt(xi[1]); /* flux up to a grows as a^3 */
            } else {
                c = 1 - xi[1] * (1 - p->light.cos_outer - p->width);
            }
            out->direction = vec_about(p->light.direction, fmin(c, 1), xi[2]);
        }
        return;
    }

    const emissive_triangle *t = &emitters->triangles[emitters->alias[i].owner];
    double b1, b2;
    point_in_patch(t, i, xi[1], xi[2], &b1, &b2);
    memcpy(out->flux, t->colour, sizeof out->flux);
    out->material = t->material;
    if (t->textured) {
        float rgb[3];
        lum_emission_at(emitters->model, t->triangle, b1, b2, rgb);
        while (next(state) * (double)emitters->patches[i].bound >= lmg_luminance(rgb)) {
            double x = next(state), y = next(state);
            point_in_patch(t, i, x, y, &b1, &b2);
            lum_emission_at(emitters->model, t->triangle, b1, b2, rgb);
        }
        double luminance = lmg_luminance(rgb);
        for (int c = 0; c < 3; c++) {
            out->flux[c] = (float)((double)rgb[c] / luminance);
        }
    }
    lmg_vec3 ng, p = point_at(t, b1, b2, &ng);
    if (t->both && xi[5] < 0.5) {
        ng = vec_scale(ng, -1);
    }
    out->origin = vec_scale(vec_along(p, ng, (double)t->error), emitters->model->unit);
    out->direction = vec_about_squared(ng, xi[3], xi[4]);
}

/* --------------------------------------------------------------------------------------------------- many photons at once */

/* Stands in the columns for photons that aren't of a plain triangle. */
static const emissive_triangle NO_TRIANGLE = {.ng = {0, 0, 1}, .colour = {1, 1, 1}};

/* One step of the streams of all photons. */
static inline void next_numbers(size_t count, uint64_t *restrict rng, double *restrict out)
{
    for (size_t i = 0; i < count; i++) {
        lum_rng r = {rng[i]};
        out[i] = lum_rng_next(&r);
        rng[i] = r.state;
    }
}

LUM_WIDE static void begin_streams(uint64_t seed, size_t count, lum_photons *restrict p, double (*restrict xi)[LUM_PHOTONS])
{
    for (size_t i = 0; i < count; i++) {
        p->rng[i] = lum_rng_stream(seed, p->number[i]).state;
    }
    for (int k = 0; k < 6; k++) {
        next_numbers(count, p->rng, xi[k]);
    }
}

/* What photons need of their triangles, gathered. */
typedef struct plain_columns {
    float v[3][3][LUM_PHOTONS], ng[3][LUM_PHOTONS], error[LUM_PHOTONS], colour[3][LUM_PHOTONS];
    double both[LUM_PHOTONS]; /* 0.5: shines to both sides, else 0 */
} plain_columns;

/* lum_emitters_sample for photons of plain triangles, whose coordinates are in a unit. */
LUM_WIDE static void sample_plain(size_t count, double unit, const plain_columns *restrict c, double (*restrict xi)[LUM_PHOTONS],
                                  lum_photons *restrict p)
{
    for (size_t i = 0; i < count; i++) {
        lmg_vec3 a = vec((double)c->v[0][0][i], (double)c->v[0][1][i], (double)c->v[0][2][i]);
        lmg_vec3 e1 = vec_sub(vec((double)c->v[1][0][i], (double)c->v[1][1][i], (double)c->v[1][2][i]), a);
        lmg_vec3 e2 = vec_sub(vec((double)c->v[2][0][i], (double)c->v[2][1][i], (double)c->v[2][2][i]), a);
        lmg_vec3 ng = vec((double)c->ng[0][i], (double)c->ng[1][i], (double)c->ng[2][i]);
        ng = vec_scale(ng, 1.5 - 0.5 * vec_dot(ng, ng));
        double r = sqrt(xi[1][i]);
        lmg_vec3 at = vec_along(vec_along(a, e1, 1 - r), e2, xi[2][i] * r);
        ng = vec_scale(ng, xi[5][i] < c->both[i] ? -1.0 : 1.0);
        at = vec_scale(vec_along(at, ng, (double)c->error[i]), unit);
        lmg_vec3 d = vec_about_squared(ng, xi[3][i], xi[4][i]);
        p->origin[0][i] = at.x;
        p->origin[1][i] = at.y;
        p->origin[2][i] = at.z;
        p->direction[0][i] = d.x;
        p->direction[1][i] = d.y;
        p->direction[2][i] = d.z;
        double red = (double)c->colour[0][i], green = (double)c->colour[1][i], blue = (double)c->colour[2][i];
        double scale = 1 / (0.2126 * red + 0.7152 * green + 0.0722 * blue); /* the floats' luminance is 1 to float precision */
        p->colour[0][i] = red * scale;
        p->colour[1][i] = green * scale;
        p->colour[2][i] = blue * scale;
    }
}

static double next_of_stream(void *state)
{
    return lum_rng_next(state);
}

static void sample_other(const lum_emitters *emitters, size_t i, double (*xi)[LUM_PHOTONS], lum_photons *p)
{
    lum_rng rng = {p->rng[i]};
    lum_photon photon;
    lum_emitters_sample(emitters, (const double[6]){xi[0][i], xi[1][i], xi[2][i], xi[3][i], xi[4][i], xi[5][i]}, next_of_stream, &rng,
                        &photon);
    p->rng[i] = rng.state;
    p->material[i] = photon.material;
    const double o[3] = {photon.origin.x, photon.origin.y, photon.origin.z};
    const double d[3] = {photon.direction.x, photon.direction.y, photon.direction.z};
    double scale = 1 / lmg_luminance(photon.flux);
    for (int c = 0; c < 3; c++) {
        p->origin[c][i] = o[c];
        p->direction[c][i] = d[c];
        p->colour[c][i] = (double)photon.flux[c] * scale;
    }
}

void lum_emitters_sample_many(const lum_emitters *emitters, uint64_t seed, size_t count, lum_photons *photons)
{
    double xi[6][LUM_PHOTONS];
    plain_columns columns;
    uint8_t others[LUM_PHOTONS];
    size_t other_count = 0;
    begin_streams(seed, count, photons, xi);
    uint32_t n = emitters->patch_count + emitters->light_count;
    for (size_t i = 0; i < count; i++) {
        uint32_t at = pick(emitters->alias, n, xi[0][i]);
        const emissive_triangle *t = at < emitters->patch_count ? &emitters->triangles[emitters->alias[at].owner] : NULL;
        if (!t || !t->plain) {
            others[other_count++] = (uint8_t)i;
            t = &NO_TRIANGLE;
        }
        for (int k = 0; k < 3; k++) {
            for (int m = 0; m < 3; m++) {
                columns.v[m][k][i] = t->v[m][k];
            }
            columns.ng[k][i] = t->ng[k];
            columns.colour[k][i] = t->colour[k];
        }
        columns.error[i] = t->error;
        columns.both[i] = t->both ? 0.5 : 0;
        photons->material[i] = t->material;
    }
    if (other_count < count) {
        sample_plain(count, emitters->model->unit, &columns, xi, photons);
    }
    for (size_t k = 0; k < other_count; k++) {
        sample_other(emitters, others[k], xi, photons);
    }
}

LUM_WIDE void lum_emitters_parts(uint64_t seed, uint64_t first, size_t count, uint32_t parts, uint16_t *part)
{
    for (size_t i = 0; i < count; i++) {
        lum_rng rng = lum_rng_stream(seed, first + i);
        part[i] = (uint16_t)(int)(lum_rng_next(&rng) * parts);
    }
}

/* ------------------------------------------------------------------------------------------------ points seen from elsewhere */

bool lum_emitters_sample_point(const lum_emitters *emitters, lmg_vec3 p, const double xi[3], lum_light_sample *out)
{
    if (!(emitters->flux_all > 0)) {
        return false;
    }
    uint32_t i = pick(emitters->alias_all, emitters->patch_count + emitters->light_count, xi[0]);
    if (i >= emitters->patch_count) {
        const punctual *light = &emitters->lights[i - emitters->patch_count];
        double chance = light->power / emitters->flux_all, factor = 1;
        if (light->light.kind == LUM_LIGHT_DIRECTIONAL) {
            out->direction = vec_scale(light->light.direction, -1);
            out->distance = INFINITY;
        } else {
            lmg_vec3 at = light->light.position;
            if (light->light.kind == LUM_LIGHT_PROFILE) {
                /* Uniform over a flat shape, whatever the direction: its radiance is intensity over projected area, so the point's
                 * share of illuminance is intensity over distance squared. */
                const double on[3] = {xi[1], xi[2], 0};
                at = vec_add(at, in_model(&light->light, lum_shape_point(&light->light.shape, vec(0, -1, 0), on)));
            }
            lmg_vec3 d = vec_sub(at, p);
            double d2 = vec_dot(d, d);
            if (!(d2 > 0)) {
                return false;
            }
            out->distance = sqrt(d2);
            out->direction = vec_scale(d, 1 / out->distance);
            factor = 1 / d2;
            if (light->light.kind == LUM_LIGHT_SPOT) {
                factor *= spot_falloff(light, -vec_dot(out->direction, light->light.direction));
            } else if (light->light.kind == LUM_LIGHT_PROFILE) {
                const lmg_vec3 *axes = light->light.axes, back = vec_scale(out->direction, -1);
                factor *= lum_profile_intensity(light->light.profile,
                                                vec(vec_dot(back, axes[0]), vec_dot(back, axes[1]), vec_dot(back, axes[2])));
            }
        }
        for (int c = 0; c < 3; c++) {
            out->radiance[c] = (float)((double)light->light.intensity[c] * factor / chance);
        }
        out->pdf = 1;
        out->delta = true;
        out->material = LUM_NONE;
        return factor > 0;
    }

    const emissive_triangle *t = &emitters->triangles[emitters->alias_all[i].owner];
    double b1, b2;
    point_in_patch(t, i, xi[1], xi[2], &b1, &b2);
    lmg_vec3 ng, d = vec_sub(vec_scale(point_at(t, b1, b2, &ng), emitters->model->unit), p);
    double d2 = vec_dot(d, d);
    if (!(d2 > 0)) {
        return false;
    }
    out->distance = sqrt(d2);
    out->direction = vec_scale(d, 1 / out->distance);
    double cosine = -vec_dot(out->direction, ng);
    if (t->both ? cosine == 0 : cosine <= 0) {
        return false;
    }
    double area = (double)t->area / ((double)t->n * t->n);
    out->pdf = emitters->patches[i].power / emitters->flux_all * d2 / (area * fabs(cosine));
    out->delta = false;
    out->material = emitters->model->triangle_material[t->triangle];
    if (t->textured) {
        lum_emission_at(emitters->model, t->triangle, b1, b2, out->radiance);
    } else {
        memcpy(out->radiance, t->emission, sizeof out->radiance);
    }
    return out->pdf > 0 && out->pdf < (double)INFINITY && lmg_luminance(out->radiance) > 0;
}

double lum_emitters_point_pdf(const lum_emitters *emitters, lmg_vec3 p, const lum_hit *hit)
{
    int32_t index = emitters->of_triangle[hit->triangle];
    if (index == LUM_NONE || !(emitters->flux_all > 0)) {
        return 0;
    }
    const emissive_triangle *t = &emitters->triangles[index];
    lmg_vec3 d = vec_sub(hit->position, p);
    double d2 = vec_dot(d, d), distance = sqrt(d2);
    double cosine = d2 > 0 ? -vec_dot(d, hit->ng) / distance : 0;
    if (t->both ? cosine == 0 : cosine <= 0) {
        return 0;
    }
    uint32_t i = patch_of(t, (double)hit->b1, (double)hit->b2);
    double area = (double)t->area / ((double)t->n * t->n);
    return emitters->patches[i].power / emitters->flux_all * d2 / (area * fabs(cosine));
}
