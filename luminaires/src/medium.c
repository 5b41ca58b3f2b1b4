/* SPDX-License-Identifier: Apache-2.0 */
/* Phase functions, and flights through homogeneous media; what is computed stands in medium.h. */
#include <luminaires/medium.h>

#include "vec.h"

double lum_phase_pdf(double g, double cosine)
{
    const double d = 1 + g * (g - 2 * cosine);
    return (1 - g * g) / (4 * LUM_PI * d * sqrt(d));
}

/*
 * Inversion.  With s = 2 xi - 1 the usual cosine (1 + g^2 - ((1 - g^2) / (1 + g s))^2) / 2g divides by zero at g = 0 and cancels
 * near the peak.  Its complements factor without remainder: 1 - cosine = A / (1 + g s)^2,  A = (1 - g)^2 (1 - s) (1 + g (1 + s) /
 * 2) 1 + cosine = B / (1 + g s)^2,  B = (1 + g)^2 (1 + s) (1 - g (1 - s) / 2),   A + B = 2 (1 + g s)^2 and A and B are sums and
 * products of positive terms, so that sine and cosine are exact to rounding for the narrowest peaks.
 */
static inline lmg_vec3 scattered(double g, lmg_vec3 d, double xi, double turns)
{
    const double s = 2 * xi - 1;
    const double a = (1 - g) * (1 - g) * (1 - s) * (1 + 0.5 * g * (1 + s)),
                 b = (1 + g) * (1 + g) * (1 + s) * (1 - 0.5 * g * (1 - s));
    const double scale = 1 / (a + b), sine = 2 * sqrt(a * b) * scale, cosine = (b - a) * scale;
    double turn_sine, turn_cosine;
    sincos_turns(turns, &turn_sine, &turn_cosine);
    lmg_vec3 x, y;
    vec_frame(d, &x, &y);
    return vec_add(vec_scale(d, cosine), vec_add(vec_scale(x, sine * turn_cosine), vec_scale(y, sine * turn_sine)));
}

lmg_vec3 lum_phase_sample(double g, lmg_vec3 d, const double xi[2])
{
    return scattered(g, d, xi[0], xi[1]);
}

/* Whole vectors: a loop's last few rounds, one by one, would take as long as all the others. */
LUM_WIDE static void scatter_columns(size_t count, lum_phase_columns *restrict c)
{
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 d = {c->direction[0][i], c->direction[1][i], c->direction[2][i]};
        const lmg_vec3 out = scattered(c->g[i], d, c->xi[0][i], c->xi[1][i]);
        c->direction[0][i] = out.x;
        c->direction[1][i] = out.y;
        c->direction[2][i] = out.z;
    }
}

void lum_phase_sample_many(size_t count, lum_phase_columns *c)
{
    enum { VECTOR = 8 };
    const size_t whole = (count + VECTOR - 1) / VECTOR * VECTOR;
    for (size_t i = count; i < whole; ++i) {
        c->g[i] = c->xi[0][i] = c->xi[1][i] = c->direction[0][i] = c->direction[1][i] = 0;
        c->direction[2][i] = 1;
    }
    scatter_columns(whole, c);
}

void lum_medium_set(lum_medium *m, const float scattering[3], const float absorption[3], float anisotropy)
{
    *m = (lum_medium){.g = (double)anisotropy, .grey = true};
    for (int c = 0; c < 3; ++c) {
        m->scattering[c] = (double)scattering[c];
        m->extinction[c] = m->scattering[c] + (double)absorption[c];
        m->majorant = fmax(m->majorant, m->extinction[c]);
        m->scatters |= m->scattering[c] > 0;
        m->grey &= scattering[c] == scattering[0] && absorption[c] == absorption[0];
    }
}

/* Distance to the next event of a process of the given rate; u in [0,1).  1 - u is exact for numbers of 53 bits. */
static double free_path(double u, double rate)
{
    return rate > 0 ? -log(1 - u) / rate : (double)INFINITY;
}

/* Probabilities of the colours in proportion to the magnitudes of their shares. */
static void colour_chances(const double share[3], double p[3])
{
    const double a[3] = {fabs(share[0]), fabs(share[1]), fabs(share[2])}, scale = 1 / (a[0] + a[1] + a[2]);
    for (int c = 0; c < 3; ++c)
        p[c] = a[c] * scale;
}

double lum_medium_draw(const lum_medium *m, const double share[3], lum_rng *rng)
{
    if (m->grey)
        return free_path(lum_rng_next(rng), m->majorant);
    double p[3];
    colour_chances(share, p);
    const double u = lum_rng_next(rng);
    const int chosen = u < p[0] ? 0 : u < p[0] + p[1] ? 1 : 2;
    return free_path(lum_rng_next(rng), m->extinction[chosen]);
}

static void arrive_coloured(const lum_medium *m, const double share[3], lum_rng *rng, lum_flight *out)
{
    const bool passed = out->event == LUM_FLIGHT_PASSED;
    double p[3], e[3], chance = 0;
    colour_chances(share, p);
    for (int c = 0; c < 3; ++c) {
        /* in INFINITY only what has no extinction passes */
        e[c] = m->extinction[c] > 0 ? exp(-m->extinction[c] * out->t) : 1;
        if (!passed)
            e[c] *= m->extinction[c];
        chance += p[c] * e[c];
    }
    /* The colour that drew the distance has a term of at least 2^-53 of its share, so chance is positive. */
    if (passed) {
        for (int c = 0; c < 3; ++c)
            out->factor[c] = e[c] / chance;
        return;
    }
    double scattered = 0;
    for (int c = 0; c < 3; ++c) {
        out->factor[c] = m->extinction[c] > 0 ? e[c] / chance * (m->scattering[c] / m->extinction[c]) : 0;
        scattered += p[c] * out->factor[c];
    }
    out->event = lum_rng_next(rng) < scattered ? LUM_FLIGHT_SCATTERED : LUM_FLIGHT_ABSORBED;
    for (int c = 0; c < 3 && out->event == LUM_FLIGHT_SCATTERED; ++c)
        out->factor[c] /= scattered;
}

void lum_medium_arrive(const lum_medium *m, double drawn, double t_max, const double share[3], lum_rng *rng, lum_flight *out)
{
    const bool passed = drawn >= t_max;
    *out = (lum_flight){
        .event = passed ? LUM_FLIGHT_PASSED : LUM_FLIGHT_SCATTERED, .t = passed ? t_max : drawn, .factor = {1, 1, 1}, .g = m->g};
    if (!m->grey)
        arrive_coloured(m, share, rng, out);
    else if (!passed && lum_medium_absorbs(m, rng))
        out->event = LUM_FLIGHT_ABSORBED;
}

void lum_medium_fly(const lum_medium *m, double t_max, const double share[3], lum_rng *rng, lum_flight *out)
{
    lum_medium_arrive(m, lum_medium_draw(m, share, rng), t_max, share, rng, out);
}
