/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Homogeneous media and phase functions against closed forms and published values: Beer and Lambert's law, the diffuse transmission
 * of a conservative slab, Chandrasekhar's H-functions, the escape from an absorbing sphere, the mean path in any sphere.  Seeds are
 * fixed.  Statistical tolerances: 4 standard errors, p < 7e-5 for each of some hundred comparisons.
 */
#include "stats.h"

#include <luminaires/medium.h>

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>
#include <cmocka.h>

#define PI 3.14159265358979323846

static const double SIGMAS = 4;
static const double WHITE[3] = {0.2126, 0.7152, 0.0722};

/* Sanitizers look for errors of another kind, at a tenth of the speed. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SPARE = 20 };
#else
enum { SPARE = 1 };
#endif

static double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static lum_medium medium(float r, float g, float b, float ar, float ag, float ab, float mean_cosine)
{
    lum_medium m;
    lum_medium_set(&m, (const float[3]){r, g, b}, (const float[3]){ar, ag, ab}, mean_cosine);
    return m;
}

static lum_medium grey(double scattering, double absorption, double mean_cosine)
{
    const float s = (float)scattering, a = (float)absorption;
    return medium(s, s, s, a, a, a, (float)mean_cosine);
}

/* ------------------------------------------------------------------------------------------------------ phase function */

static const double ANISOTROPY[] = {-0.9999, -0.95, -0.4, 0, 1e-9, 1e-4, 0.3, 0.85, 0.999, 0.9999};
enum { ANISOTROPIES = sizeof(ANISOTROPY) / sizeof(ANISOTROPY[0]) };

/* Probability of a cosine below mu: integral of the density. */
static double phase_below(double g, double mu)
{
    if (fabs(g) < 1e-6) /* next term of the series: 3 g^2 / 2 */
        return 0.5 * (1 + mu) - 0.75 * g * (1 - mu * mu);
    /* 1 + g^2 - 2 g mu without cancellation */
    const double q = g > 0 ? (1 - g) * (1 - g) + 2 * g * (1 - mu) : (1 + g) * (1 + g) - 2 * g * (1 + mu);
    return (1 - g * g) / (2 * g) * (1 / sqrt(q) - 1 / (1 + g));
}

/* The samples follow the integral of the density: chi-square over 40 x 3 cells of equal probability; directions are unit. */
static void phase_samples_have_their_density(void **state)
{
    (void)state;
    enum { CELLS = 40, TURNS = 3, N = 200000 / SPARE };
    const lmg_vec3 d = {0.48, -0.6, 0.64};
    const lmg_vec3 x = {0.8, 0.64, 0}; /* not perpendicular to d; only its turn about d is used */
    for (int k = 0; k < ANISOTROPIES; ++k) {
        const double g = ANISOTROPY[k];
        double counts[CELLS * TURNS] = {0}, expected[CELLS * TURNS];
        stats_mean mean = {0, 0, 0};
        for (int i = 0; i < CELLS * TURNS; ++i)
            expected[i] = (double)N / (CELLS * TURNS);
        const double along = dot(x, d);
        lmg_vec3 e = {x.x - along * d.x, x.y - along * d.y, x.z - along * d.z};
        const double le = sqrt(dot(e, e));
        e = (lmg_vec3){e.x / le, e.y / le, e.z / le};
        const lmg_vec3 f = {d.y * e.z - d.z * e.y, d.z * e.x - d.x * e.z, d.x * e.y - d.y * e.x};
        for (int i = 0; i < N; ++i) {
            lum_rng rng = lum_rng_stream(11 + (uint64_t)k, (uint64_t)i);
            const double xi[2] = {lum_rng_next(&rng), lum_rng_next(&rng)};
            const lmg_vec3 w = lum_phase_sample(g, d, xi);
            assert_true(fabs(dot(w, w) - 1) < 1e-12);
            const double mu = fmin(fmax(dot(w, d), -1), 1), below = fmin(fmax(phase_below(g, mu), 0), 1 - DBL_EPSILON);
            const double turn = atan2(dot(w, f), dot(w, e)) / (2 * PI) + 0.5;
            ++counts[(int)(below * CELLS) * TURNS + (int)fmin(turn * TURNS, TURNS - 1)];
            stats_add(&mean, mu);
        }
        const double p = stats_chi_square(counts, expected, CELLS * TURNS, NULL, NULL);
        print_message("g = %g: mean cosine %.6f +- %.6f, chi-square p = %.3f\n", g, mean.mean, stats_error(&mean), p);
        assert_true(p > stats_sidak(1e-3, ANISOTROPIES));
        assert_true(fabs(mean.mean - g) <= SIGMAS * stats_error(&mean) + 1e-12);
    }
}

/* Columns give the bits that single samples do, whatever their number. */
static void phase_columns_are_phase_samples(void **state)
{
    (void)state;
    lum_rng rng = lum_rng_stream(77, 0);
    double xi[LUM_MAX_SCATTERED][2];
    lmg_vec3 before[LUM_MAX_SCATTERED];
    for (int i = 0; i < LUM_MAX_SCATTERED; ++i) {
        xi[i][0] = lum_rng_next(&rng);
        xi[i][1] = lum_rng_next(&rng);
    }
    for (int i = 0; i < LUM_MAX_SCATTERED; ++i)
        before[i] = lum_phase_sample(0, (lmg_vec3){0, 0, 1}, xi[LUM_MAX_SCATTERED - 1 - i]);
    before[1] = (lmg_vec3){0, 0, -1};
    for (size_t count = 0; count <= LUM_MAX_SCATTERED; ++count) {
        lum_phase_columns c;
        memset(&c, 0, sizeof(c));
        for (size_t i = 0; i < count; ++i) {
            c.g[i] = ANISOTROPY[i % ANISOTROPIES];
            c.xi[0][i] = xi[i][0];
            c.xi[1][i] = xi[i][1];
            c.direction[0][i] = before[i].x;
            c.direction[1][i] = before[i].y;
            c.direction[2][i] = before[i].z;
        }
        lum_phase_sample_many(count, &c);
        for (size_t i = 0; i < count; ++i) {
            const lmg_vec3 one = lum_phase_sample(ANISOTROPY[i % ANISOTROPIES], before[i], xi[i]);
            assert_true(c.direction[0][i] == one.x && c.direction[1][i] == one.y && c.direction[2][i] == one.z);
        }
    }
}

/* The density is the derivative of the integral, and its integral is 1. */
static void phase_density_is_normalized(void **state)
{
    (void)state;
    for (int k = 0; k < ANISOTROPIES; ++k) {
        const double g = ANISOTROPY[k];
        assert_true(fabs(phase_below(g, 1) - 1) < 1e-9 && fabs(phase_below(g, -1)) < 1e-9);
        /* Simpson's rule in q = (1 + g^2 - 2 g mu)^(-1/4), in which the peak is smooth; for small g in mu. */
        enum { N = 4000 };
        double sum = 0;
        for (int i = 0; i <= N; ++i) {
            const double w = i == 0 || i == N ? 1 : i % 2 ? 4 : 2;
            double mu = -1 + 2.0 * i / N, jacobian = 1, step = 2.0 / N;
            if (fabs(g) > 0.01) {
                const double q0 = 1 / sqrt(1 + fabs(g)), q1 = 1 / sqrt(1 - fabs(g)), q = q0 + (q1 - q0) * i / N;
                mu = (1 + g * g - pow(q, -4)) / (2 * g);
                jacobian = 4 * pow(q, -5) / (2 * fabs(g));
                step = (q1 - q0) / N;
            }
            sum += w * lum_phase_pdf(g, mu) * 2 * PI * jacobian * step / 3;
        }
        assert_true(fabs(sum - 1) < 1e-6);
    }
}

/* ----------------------------------------------------------------------------------------------- Beer and Lambert's law */

/* Optical depths from 1e-6 to 1e3: the share that passes, or for thin ones the share that doesn't, per colour, and what is
 * scattered on the way; a photon that goes on has luminance 1. */
static void flights_obey_beer_and_lambert(void **state)
{
    (void)state;
    const double depths[] = {1e-6, 1e-3, 0.1, 1, 5, 30, 1000};
    const double colours[3][3] = {{1, 1, 1}, {2.5, 0.6, 0.5}, {-0.3, 1.3, 1.85}}; /* R,G,B; the last is out of the gamut */
    for (int d = 0; d < 7; ++d)
        for (int c = 0; c < 3; ++c)
            for (int g = 0; g < 2; ++g) {
                const double length = 0.37;
                const float s = (float)(depths[d] / length);
                const lum_medium m = g ? medium(0.6f * s, 0.6f * s, 0.6f * s, 0.4f * s, 0.4f * s, 0.4f * s, 0)
                                       : medium(0.9f * s, 0.5f * s, 0, 0.1f * s, 0, 0.2f * s, 0);
                double share[3], y = 0;
                for (int k = 0; k < 3; ++k)
                    y += share[k] = WHITE[k] * colours[c][k];
                stats_mean passed[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}, scattered[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
                const int n = 100000 / SPARE;
                for (int k = 0; k < 3; ++k)
                    share[k] /= y;
                for (int i = 0; i < n; ++i) {
                    lum_rng rng = lum_rng_stream(21, (uint64_t)i);
                    lum_flight f;
                    lum_medium_fly(&m, length, share, &rng, &f);
                    double after = 0;
                    for (int k = 0; k < 3; ++k) {
                        stats_add(&passed[k], f.event == LUM_FLIGHT_PASSED ? f.factor[k] : 0);
                        stats_add(&scattered[k], f.event == LUM_FLIGHT_SCATTERED ? f.factor[k] : 0);
                        after += share[k] * f.factor[k];
                    }
                    assert_true(f.event == LUM_FLIGHT_PASSED ? f.t == length : f.t >= 0 && f.t < length);
                    if (f.event != LUM_FLIGHT_ABSORBED && c < 2)
                        assert_true(fabs(after - 1) <= 16 * DBL_EPSILON);
                }
                for (int k = 0; k < 3; ++k) {
                    const double sigma = m.extinction[k], t = exp(-sigma * length);
                    const double s_expected = sigma > 0 ? m.scattering[k] / sigma * -expm1(-sigma * length) : 0;
                    /* Where something has a probability below 1/n, the sample variance says little: a floor of the expected one. */
                    const double floor_p = sqrt(t * (1 - t) / n), floor_s = sqrt(s_expected * (1 - s_expected) / n);
                    assert_true(fabs(passed[k].mean - t) <= SIGMAS * fmax(stats_error(&passed[k]), floor_p) + 1e-12);
                    /* (a mean over n of rare weights of a few units) */
                    assert_true(fabs(scattered[k].mean - s_expected) <=
                                SIGMAS * fmax(stats_error(&scattered[k]), floor_s) + 5.0 / n * (depths[d] < 1e-4));
                }
            }
}

/* ------------------------------------------------------------------------------------------- slabs without boundaries */

typedef struct tally {
    double n, through, back, absorbed;
} tally;

/* Photons that enter a slab 0 < z < 1 from below in direction cosine mu (0: as from a Lambertian surface). */
static tally slab(const lum_medium *m, double mu, int n, uint64_t seed)
{
    tally result = {n, 0, 0, 0};
    for (int i = 0; i < n; ++i) {
        lum_rng rng = lum_rng_stream(seed, (uint64_t)i);
        const double c = mu > 0 ? mu : sqrt(1 - lum_rng_next(&rng)); /* never zero */
        lmg_vec3 d = {sqrt(1 - c * c), 0, c};
        double z = 0;
        for (;;) {
            const double edge = d.z > 0 ? (1 - z) / d.z : d.z < 0 ? -z / d.z : (double)INFINITY;
            lum_flight f;
            lum_medium_fly(m, edge, WHITE, &rng, &f);
            if (f.event == LUM_FLIGHT_ABSORBED) {
                ++result.absorbed;
                break;
            }
            if (f.event == LUM_FLIGHT_PASSED) {
                ++*(d.z > 0 ? &result.through : &result.back);
                break;
            }
            z += f.t * d.z;
            const double xi[2] = {lum_rng_next(&rng), lum_rng_next(&rng)};
            d = lum_phase_sample(m->g, d, xi);
        }
    }
    return result;
}

/* Conservative isotropic slab in diffuse light: transmittance after Heaslet and Warming (1965), four digits as tabulated in Modest,
 * Radiative Heat Transfer; beyond them its asymptote (4/3) / (b + 1.42089). */
static void conservative_slab_transmits_as_published(void **state)
{
    (void)state;
    const double depth[] = {0.1, 0.2, 0.5, 1, 2, 3, 5, 30}, published[] = {.9157, .8491, .7040, .5532, .3900, .3016, .2077, 0};
    for (int k = 0; k < 8; ++k) {
        const lum_medium m = grey(depth[k], 0, 0);
        const tally t = slab(&m, 0, (k < 7 ? 400000 : 100000) / SPARE, 31);
        const double expected = k < 7 ? published[k] : 4.0 / 3 / (depth[k] + 1.42089), mean = t.through / t.n;
        const double se = sqrt(mean * (1 - mean) / t.n);
        print_message("slab of depth %g: %.4f +- %.4f (%.4f)\n", depth[k], mean, se, expected);
        assert_true(t.through + t.back == t.n);
        assert_true(fabs(mean - expected) <= SIGMAS * se + 0.5e-4); /* the last printed digit */
    }
}

/* What is scattered forward counts little: a slab with g is like an isotropic one of depth (1 - g) b when b is large.  Similarity
 * isn't exact, 2 % at b (1 - g) = 10. */
static void forward_scattering_slab_is_similar(void **state)
{
    (void)state;
    const lum_medium m = grey(50, 0, 0.8);
    const tally t = slab(&m, 0, 100000 / SPARE, 32);
    const double mean = t.through / t.n, expected = 4.0 / 3 / (10 + 1.42089), se = sqrt(mean * (1 - mean) / t.n);
    print_message("forward scattering slab: %.4f +- %.4f (similarity %.4f)\n", mean, se, expected);
    assert_true(fabs(mean - expected) <= SIGMAS * se + 0.02 * expected);
}

/* Chandrasekhar's H-function for isotropic scattering: H(x) = 1 / (sqrt(1 - w) + w/2 integral of y H(y) / (x + y) dy), iterated on
 * Gauss and Legendre's points (found by Newton's method). */
enum { POINTS = 48 };
static double h_function(double albedo, double mu)
{
    double y[POINTS], w[POINTS], h[POINTS];
    for (int i = 0; i < POINTS; ++i) {
        double x = cos(PI * (i + 0.75) / (POINTS + 0.5)), derivative = 1;
        for (int k = 0; k < 50; ++k) {
            double p0 = 1, p1 = x;
            for (int n = 2; n <= POINTS; ++n) {
                const double p2 = ((2 * n - 1) * x * p1 - (n - 1) * p0) / n;
                p0 = p1;
                p1 = p2;
            }
            derivative = POINTS * (x * p1 - p0) / (x * x - 1);
            x -= p1 / derivative;
        }
        y[i] = 0.5 * (1 + x);
        w[i] = 1 / ((1 - x * x) * derivative * derivative);
        h[i] = 1;
    }
    const double root = sqrt(1 - albedo);
    double result = 1;
    for (int k = 0; k < 400; ++k) {
        double next[POINTS];
        for (int i = 0; i <= POINTS; ++i) {
            const double x = i < POINTS ? y[i] : mu;
            double sum = 0;
            for (int j = 0; j < POINTS; ++j)
                sum += w[j] * y[j] * h[j] / (x + y[j]);
            *(i < POINTS ? &next[i] : &result) = 1 / (root + 0.5 * albedo * sum);
        }
        for (int i = 0; i < POINTS; ++i)
            h[i] = 0.5 * (h[i] + next[i]); /* the mean of two iterates lies closer: they alternate */
    }
    return result;
}

/* Reflectance of a half-space, isotropic scattering: R(mu) = 1 - H(mu) sqrt(1 - w).  A slab of depth 60/sqrt(1 - w) is one. */
static void half_space_reflects_by_the_h_function(void **state)
{
    (void)state;
    /* Chandrasekhar, Radiative Transfer, Table XI: H(1) = 2.9078 for w = 1, to check the iteration (48 points, w just below). */
    assert_true(fabs(h_function(1 - 1e-10, 1) - 2.9078) < 2e-4);
    const double albedo[] = {0.3, 0.8, 0.95, 0.995}, cosine[] = {0.1, 0.5, 1};
    for (int a = 0; a < 4; ++a)
        for (int c = 0; c < 3; ++c) {
            const double depth = 60 / sqrt(1 - albedo[a]);
            const lum_medium m = grey(depth * albedo[a], depth * (1 - albedo[a]), 0);
            const tally t = slab(&m, cosine[c], 100000 / SPARE, 33);
            const double expected = 1 - h_function(albedo[a], cosine[c]) * sqrt(1 - albedo[a]), mean = t.back / t.n;
            const double se = sqrt(expected * (1 - expected) / t.n);
            print_message("half-space, albedo %g, cosine %g: %.4f +- %.4f (%.4f)\n", albedo[a], cosine[c], mean, se, expected);
            assert_true(fabs(mean - expected) <= SIGMAS * se + 1e-5);
        }
}

/* Very thin and very thick: what a thin slab turns back is half of what it scatters; a conservative one of depth 1000 loses
 * nothing. */
static void extreme_depths_behave(void **state)
{
    (void)state;
    const lum_medium thin = grey(1e-3, 0, 0), thick = grey(1000, 0, 0.9);
    /* Normal incidence: scattered 1 - exp(-b), of which half comes back, up to a second scattering of order b log(1/b). */
    const tally t = slab(&thin, 1, 2000000 / SPARE, 34);
    const double p = 0.5e-3;
    assert_true(fabs(t.back / t.n - p) <= SIGMAS * sqrt(p / t.n) + 0.01 * p);
    const tally u = slab(&thick, 0, 3000 / SPARE, 35);
    assert_true(u.through + u.back == u.n && u.absorbed == 0);
    const double expected = 4.0 / 3 / (100 + 1.42089);
    assert_true(fabs(u.through / u.n - expected) <= SIGMAS * sqrt(expected / u.n) + 0.02 * expected);
}

/* ------------------------------------------------------------------------------------------------------------- spheres */

static double sphere_exit(lmg_vec3 p, lmg_vec3 d)
{
    const double b = dot(p, d), c = dot(p, p) - 1;
    return fmax(-b + sqrt(fmax(b * b - c, 0)), 0);
}

static lmg_vec3 isotropic(lum_rng *rng)
{
    const double xi[2] = {lum_rng_next(rng), lum_rng_next(rng)};
    return lum_phase_sample(0, (lmg_vec3){0, 0, 1}, xi);
}

/* Uniform isotropic sources in an absorbing sphere of optical radius b: P = 3/(8 b^3) (2 b^2 - 1 + (1 + 2b) exp(-2b)) get out
 * (Case, de Hoffmann, Placzek 1953). */
static void light_escapes_from_an_absorbing_sphere(void **state)
{
    (void)state;
    const double depth[] = {0.05, 0.5, 2, 20};
    for (int k = 0; k < 4; ++k) {
        const lum_medium m = grey(0, depth[k], 0);
        const int n = 200000 / SPARE;
        double out = 0;
        for (int i = 0; i < n; ++i) {
            lum_rng rng = lum_rng_stream(41, (uint64_t)i);
            const double r = cbrt(lum_rng_next(&rng));
            const lmg_vec3 e = isotropic(&rng), p = {r * e.x, r * e.y, r * e.z}, d = isotropic(&rng);
            lum_flight f;
            lum_medium_fly(&m, sphere_exit(p, d), WHITE, &rng, &f);
            out += f.event == LUM_FLIGHT_PASSED;
        }
        const double b = depth[k], expected = 3 / (8 * b * b * b) * (2 * b * b - 1 + (1 + 2 * b) * exp(-2 * b));
        const double se = sqrt(expected * (1 - expected) / n);
        print_message("sphere of depth %g: %.4f +- %.4f (%.4f)\n", b, out / n, se, expected);
        assert_true(fabs(out / n - expected) <= SIGMAS * se);
    }
}

/* Light that enters a sphere diffusely travels 4 R / 3 in it on average, however much and whichever way it is scattered without
 * loss (Blanco and Fournier 2003). */
static void mean_path_in_a_sphere_is_invariant(void **state)
{
    (void)state;
    const double depth[] = {0.3, 3, 20}, g[] = {-0.5, 0, 0.9};
    for (int k = 0; k < 9; ++k) {
        const lum_medium m = grey(depth[k / 3], 0, g[k % 3]);
        stats_mean path = {0, 0, 0};
        for (int i = 0; i < 40000 / SPARE; ++i) {
            lum_rng rng = lum_rng_stream(43, (uint64_t)i);
            const double s = sqrt(lum_rng_next(&rng)), a = 2 * PI * lum_rng_next(&rng);
            lmg_vec3 p = {0, 0, -1}, d = {s * cos(a), s * sin(a), sqrt(1 - s * s)};
            double length = 0;
            for (;;) {
                lum_flight f;
                lum_medium_fly(&m, sphere_exit(p, d), WHITE, &rng, &f);
                length += f.t;
                if (f.event == LUM_FLIGHT_PASSED)
                    break;
                p = (lmg_vec3){p.x + f.t * d.x, p.y + f.t * d.y, p.z + f.t * d.z};
                const double xi[2] = {lum_rng_next(&rng), lum_rng_next(&rng)};
                d = lum_phase_sample(m.g, d, xi);
            }
            stats_add(&path, length);
        }
        print_message("mean path, depth %g, g = %g: %.4f +- %.4f (1.3333)\n", depth[k / 3], g[k % 3], path.mean,
                      stats_error(&path));
        assert_true(fabs(path.mean - 4.0 / 3) <= SIGMAS * stats_error(&path));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(phase_samples_have_their_density),
        cmocka_unit_test(phase_columns_are_phase_samples),
        cmocka_unit_test(phase_density_is_normalized),
        cmocka_unit_test(flights_obey_beer_and_lambert),
        cmocka_unit_test(conservative_slab_transmits_as_published),
        cmocka_unit_test(forward_scattering_slab_is_similar),
        cmocka_unit_test(half_space_reflects_by_the_h_function),
        cmocka_unit_test(extreme_depths_behave),
        cmocka_unit_test(light_escapes_from_an_absorbing_sphere),
        cmocka_unit_test(mean_path_in_a_sphere_is_invariant),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
