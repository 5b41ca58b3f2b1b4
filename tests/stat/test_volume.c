/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Media of varying density: lattices against a plain interpolation, flights against exact optical depths, a constant grid against a
 * homogeneous medium, grids of a few huge values, and OpenVDB files, good and bad.  Seeds are fixed.  Statistical tolerances: 4
 * standard errors, p < 7e-5 for each of some hundred comparisons.
 */
#include "stats.h"
#include "vdb_shim.h"

#include <luminaires/medium.h>

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#define PI 3.14159265358979323846

static const double SIGMAS = 4;
static const double WHITE[3] = {0.2126, 0.7152, 0.0722};

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SPARE = 20 };
#else
enum { SPARE = 1 };
#endif

#if defined(__SANITIZE_ADDRESS__)
/* OpenVDB 10 loses the tree node at hand when a read throws; of files cut short that is what we want it to do. */
__attribute__((visibility("default"))) const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void)
{
    return "leak:readTopology\nleak:readBuffers\n";
}
#endif

/* A lattice of chance, not at the origin and not a multiple of a brick. */
enum { NX = 21, NY = 13, NZ = 17 };
static const int32_t LOW[3] = {-11, 5, -3};
static const uint32_t SIZE[3] = {NX, NY, NZ};

typedef enum contents { CONSTANT, SMOOTH, SPIKES, HOLES } contents;

static void make_values(contents kind, float values[NX * NY * NZ])
{
    lum_rng rng = lum_rng_stream(5, kind);
    for (int i = 0; i < NX * NY * NZ; ++i) {
        const double u = lum_rng_next(&rng), v = lum_rng_next(&rng);
        const int x = i / (NY * NZ), y = i / NZ % NY;
        values[i] = kind == CONSTANT ? 1.0f
                    : kind == SMOOTH ? (float)(1 + 0.5 * sin(0.4 * x) * cos(0.3 * y) + 0.2 * u)
                    : kind == SPIKES ? (u < 0.01 ? (float)(1e6 * v) : (float)(0.3 * v))
                                     : (x / 4 % 2 ? 0.0f : (float)u);
    }
}

static float voxel(const float *values, int x, int y, int z)
{
    const int i = x - LOW[0], j = y - LOW[1], k = z - LOW[2];
    return i < 0 || j < 0 || k < 0 || i >= NX || j >= NY || k >= NZ ? 0.0f : values[(i * NY + j) * NZ + k];
}

/* Plainly: the eight voxels around, by their volumes; or the nearest. */
static double plain_density(const float *values, lum_interpolation interpolation, const double p[3])
{
    if (interpolation == LUM_INTERPOLATION_NEAREST)
        return (double)voxel(values, (int)floor(p[0] + 0.5), (int)floor(p[1] + 0.5), (int)floor(p[2] + 0.5));
    double sum = 0;
    for (int c = 0; c < 8; ++c) {
        int at[3];
        double w = 1;
        for (int a = 0; a < 3; ++a) {
            at[a] = (int)floor(p[a]) + (c >> a & 1);
            w *= 1 - fabs(p[a] - at[a]);
        }
        sum += w * (double)voxel(values, at[0], at[1], at[2]);
    }
    return sum;
}

static lum_grid *make_grid(const float *values, lum_interpolation interpolation, double voxel_depth)
{
    lum_grid *grid;
    lmg_error err = {{0}};
    if (lum_grid_create(LOW, SIZE, values, interpolation, voxel_depth, &grid, &err) != LMG_OK)
        fail_msg("%s", err.message);
    return grid;
}

static void lattices_interpolate(void **state)
{
    (void)state;
    static float values[NX * NY * NZ];
    for (int kind = 0; kind < 4; ++kind)
        for (int interpolation = 0; interpolation < 2; ++interpolation) {
            make_values((contents)kind, values);
            lum_grid *grid = make_grid(values, (lum_interpolation)interpolation, 1);
            double lo[3], hi[3];
            lum_grid_bounds(grid, lo, hi);
            for (int a = 0; a < 3; ++a) {
                /* of HOLES the last layers along x are empty */
                const int last = LOW[a] + (int)SIZE[a] - 1 - (kind == HOLES && a == 0 ? 1 : 0);
                assert_true(lo[a] == LOW[a] - (interpolation ? 0.5 : 1) || kind == SPIKES);
                assert_true(hi[a] == last + (interpolation ? 0.5 : 1) || kind == SPIKES || kind == HOLES);
            }
            for (int i = 0; i < 20000; ++i) {
                lum_rng rng = lum_rng_stream(6, (uint64_t)i);
                double p[3];
                for (int a = 0; a < 3; ++a)
                    p[a] = LOW[a] - 2 + (SIZE[a] + 3) * lum_rng_next(&rng);
                const double expected = plain_density(values, (lum_interpolation)interpolation, p);
                /* two ways to add up eight products, of coordinates rounded in units of bricks */
                assert_true(fabs(lum_grid_density(grid, p) - expected) <= 1e-13 * (kind == SPIKES ? 1e6 : 2));
            }
            lum_grid_destroy(grid);
        }
}

/* A model with one volume: coefficients times density, the lattice turned, stretched and moved. */
static lum_model *model_of(lum_grid *grid, const float scattering[3], const float absorption[3])
{
    lum_model *model = calloc(1, sizeof(*model));
    assert_non_null(model);
    model->volumes = calloc(2, sizeof(*model->volumes));
    assert_non_null(model->volumes);
    model->volume_count = 1;
    lum_volume *v = &model->volumes[0];
    v->grid = grid;
    v->anisotropy = 0.25f;
    memcpy(v->scattering, scattering, sizeof(v->scattering));
    memcpy(v->absorption, absorption, sizeof(v->absorption));
    const double m[3][4] = {{40, 9, 0, -1.5}, {-8, 45, 3, 11.25}, {2, -4, 60, 5.5}};
    memcpy(v->to_index, m, sizeof(m));
    return model;
}

static void free_volumes(lum_model *model)
{
    free(model->volumes);
    free(model);
}

static lum_volumes *prepare(const lum_model *model)
{
    lum_volumes *volumes;
    assert_int_equal(lum_volumes_create(model, &volumes, NULL), LMG_OK);
    assert_non_null(volumes);
    return volumes;
}

static void index_of(const lum_volume *v, lmg_vec3 p, double q[3])
{
    for (int a = 0; a < 3; ++a)
        q[a] = v->to_index[a][0] * p.x + v->to_index[a][1] * p.y + v->to_index[a][2] * p.z + v->to_index[a][3];
}

/* A ray through the lattice's neighbourhood, about half a metre; some are along an axis of the model. */
static void make_ray(uint64_t number, lmg_vec3 *o, lmg_vec3 *d)
{
    lum_rng rng = lum_rng_stream(7, number);
    const double xi[2] = {lum_rng_next(&rng), lum_rng_next(&rng)};
    const lmg_vec3 axes[3] = {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}};
    *d = number % 5 == 0 ? axes[number / 5 % 3] : lum_phase_sample(0, (lmg_vec3){0, 0, 1}, xi);
    /* the middle of the lattice is at about (0.04, 0.01, -0.01) */
    *o = (lmg_vec3){0.04 + 0.2 * (lum_rng_next(&rng) - 0.5), 0.01 + 0.2 * (lum_rng_next(&rng) - 0.5),
                    -0.01 + 0.2 * (lum_rng_next(&rng) - 0.5)};
    const double back = number % 3 ? 0.4 : 0.02; /* from outside or from within */
    *o = (lmg_vec3){o->x - back * d->x, o->y - back * d->y, o->z - back * d->z};
}

/* Against a sum over many small steps; for linear interpolation the midpoint rule's error falls with the square of the step, for
 * nearest a step at a face is wrong by at most its length times the jump. */
static void optical_depths_are_exact(void **state)
{
    (void)state;
    static float values[NX * NY * NZ];
    for (int kind = 0; kind < 4; ++kind)
        for (int interpolation = 0; interpolation < 2; ++interpolation)
            for (int walk = 0; walk < 2; ++walk) { /* bounds by brick and by cell: no difference here */
                make_values((contents)kind, values);
                lum_grid *grid = make_grid(values, (lum_interpolation)interpolation, walk ? 1e9 : 0);
                lum_model *model = model_of(grid, (const float[3]){2, 1, 0.5f}, (const float[3]){1, 1, 0});
                lum_volumes *volumes = prepare(model);
                const double t_max = 0.7, largest = kind == SPIKES ? 1e6 : 2;
                for (uint64_t r = 0; r < 60; ++r) {
                    lmg_vec3 o, d;
                    make_ray(r, &o, &d);
                    enum { STEPS = 20000 };
                    double sum = 0, q[3], depth[3];
                    for (int i = 0; i < STEPS; ++i) {
                        const double t = (i + 0.5) / STEPS * t_max;
                        index_of(&model->volumes[0], (lmg_vec3){o.x + t * d.x, o.y + t * d.y, o.z + t * d.z}, q);
                        sum += plain_density(values, (lum_interpolation)interpolation, q) * t_max / STEPS;
                    }
                    lum_volumes_depth(volumes, o, d, t_max, depth);
                    /* linear: 40 cells of 1/50 m, second derivatives up to 2 largest / cell^2: (h^2 / 24) f'' over the length, and
                     * at each of some 100 faces a kink, h^2 / 8 times the change of slope; nearest: 100 faces, half a step each */
                    const double h = t_max / STEPS;
                    const double bound = interpolation ? 100 * 0.5 * h * largest
                                                       : 100 * h * h / 8 * 4 * largest * 60 + h * h * 2 * largest * 3600 / 24;
                    assert_true(fabs(depth[0] - 3 * sum) <= 3 * bound);
                    assert_true(fabs(depth[1] - depth[0] * 2 / 3) <= 1e-12 * depth[0]);
                    assert_true(fabs(depth[2] - depth[0] / 6) <= 1e-12 * depth[0]);
                }
                lum_volumes_destroy(volumes);
                free_volumes(model);
                lum_grid_destroy(grid);
            }
}

/* Flights pass with exp(-depth) and scatter with the albedo's share of the rest, per colour, whether the bounds are those of bricks
 * or of cells; through grids of which a few voxels hold nearly everything, too. */
static void flights_pass_as_the_depth_says(void **state)
{
    (void)state;
    static float values[NX * NY * NZ];
    const double share[3] = {0.5, 0.3, 0.2};
    for (int kind = 0; kind < 4; ++kind)
        for (int interpolation = 0; interpolation < 2; ++interpolation)
            for (int coloured = 0; coloured < 2; ++coloured)
                for (int walk = 0; walk < 2; ++walk) {
                    make_values((contents)kind, values);
                    lum_grid *grid = make_grid(values, (lum_interpolation)interpolation, walk ? 1e9 : 0);
                    const float thin = kind == SPIKES ? 1e-3f : 4;
                    lum_model *model =
                        model_of(grid, (const float[3]){2 * thin, coloured ? thin : 2 * thin, coloured ? 0 : 2 * thin},
                                 (const float[3]){thin, coloured ? 2 * thin : thin, coloured ? 0.5f * thin : thin});
                    lum_volumes *volumes = prepare(model);
                    const double t_max = 0.5;
                    double z[3] = {0, 0, 0};
                    for (uint64_t r = 0; r < 12; ++r) {
                        lmg_vec3 o, d;
                        make_ray(r + 100, &o, &d);
                        double depth[3];
                        lum_volumes_depth(volumes, o, d, t_max, depth);
                        stats_mean passed[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}, scattered[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
                        /* bounds of bricks in a grid of spikes: what it costs is what bounds of cells are for */
                        const int n = (kind == SPIKES && !walk ? 300 : 12000) / SPARE;
                        for (int i = 0; i < n; ++i) {
                            lum_rng rng = lum_rng_stream(8 + r, (uint64_t)i);
                            lum_flight f;
                            lum_volumes_fly(volumes, o, d, t_max, share, &rng, &f);
                            double after = 0;
                            for (int c = 0; c < 3; ++c) {
                                stats_add(&passed[c], f.event == LUM_FLIGHT_PASSED ? f.factor[c] : 0);
                                stats_add(&scattered[c], f.event == LUM_FLIGHT_SCATTERED ? f.factor[c] : 0);
                                after += share[c] * f.factor[c];
                            }
                            /* three roundings per null collision */
                            if (f.event != LUM_FLIGHT_ABSORBED)
                                assert_true(fabs(after - 1) < 1e-10);
                            assert_true(f.event != LUM_FLIGHT_SCATTERED || (f.g == 0.25 && f.t >= 0 && f.t <= t_max));
                        }
                        for (int c = 0; c < 3; ++c) {
                            const double s = (double)model->volumes[0].scattering[c],
                                         e = s + (double)model->volumes[0].absorption[c];
                            const double t = exp(-depth[c]), u = s / e * -expm1(-depth[c]);
                            const double floor_t = sqrt(t * (1 - t) / n), floor_u = sqrt(fmax(u * (1 - u), 0) / n);
                            const double z_t =
                                fabs(passed[c].mean - t) / fmax(fmax(stats_error(&passed[c]), floor_t), 1.0 / n / SIGMAS);
                            const double z_u =
                                fabs(scattered[c].mean - u) / fmax(fmax(stats_error(&scattered[c]), floor_u), 1.0 / n / SIGMAS);
                            z[c] = fmax(z[c], fmax(z_t, z_u));
                        }
                    }
                    print_message("contents %d, %s, %s, bounds by %s: largest z %.2f %.2f %.2f\n", kind,
                                  interpolation ? "nearest" : "linear", coloured ? "coloured" : "grey", walk ? "cell" : "brick",
                                  z[0], z[1], z[2]);
                    for (int c = 0; c < 3; ++c)
                        assert_true(z[c] <= SIGMAS);
                    lum_volumes_destroy(volumes);
                    free_volumes(model);
                    lum_grid_destroy(grid);
                }
}

/* Where photons collide in a constant grid: exponentially, as in a homogeneous medium; chi-square over 40 cells of equal
 * probability of the distance. */
static void constant_grid_is_a_homogeneous_medium(void **state)
{
    (void)state;
    static float values[NX * NY * NZ];
    make_values(CONSTANT, values);
    for (int interpolation = 0; interpolation < 2; ++interpolation) {
        lum_grid *grid = make_grid(values, (lum_interpolation)interpolation, 0.1);
        lum_model *model = model_of(grid, (const float[3]){7, 7, 7}, (const float[3]){1, 1, 1});
        memset(model->volumes[0].to_index, 0, sizeof(model->volumes[0].to_index));
        for (int a = 0; a < 3; ++a)
            model->volumes[0].to_index[a][a] = 50; /* voxels of 2 cm */
        lum_volumes *volumes = prepare(model);
        /* between the first and last voxels along x, where linear interpolation is constant too, in a slanting direction */
        const lmg_vec3 d = {0.96, 0.2, sqrt(1 - 0.96 * 0.96 - 0.04)}, o = {-0.22, 0.13, 0.0};
        const double t_max = 0.24;
        lum_medium same;
        lum_medium_set(&same, model->volumes[0].scattering, model->volumes[0].absorption, 0);
        enum { CELLS = 40, N = 200000 / SPARE };
        double counts[2][CELLS + 1] = {{0}}, absorbed[2] = {0, 0}, expected[CELLS + 1];
        for (int k = 0; k < 2; ++k)
            for (int i = 0; i < N; ++i) {
                lum_rng rng = lum_rng_stream(9 + (uint64_t)k, (uint64_t)i);
                lum_flight f;
                if (k)
                    lum_medium_fly(&same, t_max, WHITE, &rng, &f);
                else
                    lum_volumes_fly(volumes, o, d, t_max, WHITE, &rng, &f);
                const double below = expm1(-8 * f.t) / expm1(-8 * t_max);
                ++counts[k][f.event == LUM_FLIGHT_PASSED ? CELLS : (int)fmin(below * CELLS, CELLS - 1)];
                absorbed[k] += f.event == LUM_FLIGHT_ABSORBED;
            }
        for (int i = 0; i < CELLS; ++i)
            expected[i] = N * -expm1(-8 * t_max) / CELLS;
        expected[CELLS] = N * exp(-8 * t_max);
        for (int k = 0; k < 2; ++k) {
            const double p = stats_chi_square(counts[k], expected, CELLS + 1, NULL, NULL);
            const double a = -expm1(-8 * t_max) / 8, se = sqrt(a * (1 - a) / N);
            print_message("%s: chi-square p = %.3f, absorbed %.4f +- %.4f (%.4f)\n",
                          k               ? "homogeneous"
                          : interpolation ? "nearest"
                                          : "linear",
                          p, absorbed[k] / N, se, a);
            assert_true(p > 1e-3);
            assert_true(fabs(absorbed[k] / N - a) <= SIGMAS * se);
        }
        lum_volumes_destroy(volumes);
        free_volumes(model);
        lum_grid_destroy(grid);
    }
}

/* Two volumes in the same place: depths add up, and each scatters its share with its own phase function, colours included. */
static void volumes_overlap(void **state)
{
    (void)state;
    static float values[NX * NY * NZ];
    make_values(SMOOTH, values);
    lum_grid *one = make_grid(values, LUM_INTERPOLATION_LINEAR, 1);
    make_values(HOLES, values);
    lum_grid *other = make_grid(values, LUM_INTERPOLATION_NEAREST, 1);
    lum_model *model = model_of(one, (const float[3]){1, 3, 2}, (const float[3]){1, 0, 1});
    model->volumes[1] = model->volumes[0];
    model->volumes[1].grid = other;
    model->volumes[1].anisotropy = -0.5f;
    model->volumes[1].scattering[0] = 6;
    model->volumes[1].to_index[0][3] += 2.5;
    double depth[3][3];
    const double share[3] = {0.5, 0.3, 0.2}, t_max = 0.5;
    for (uint64_t r = 0; r < 8; ++r) {
        lmg_vec3 o, d;
        make_ray(r + 200, &o, &d);
        lum_volumes *volumes;
        for (int k = 0; k < 2; ++k) {
            lum_model single = {.volume_count = 1, .volumes = &model->volumes[k]};
            volumes = prepare(&single);
            lum_volumes_depth(volumes, o, d, t_max, depth[k]);
            lum_volumes_destroy(volumes);
        }
        model->volume_count = 2;
        volumes = prepare(model);
        lum_volumes_depth(volumes, o, d, t_max, depth[2]);
        stats_mean passed[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        int by[2] = {0, 0};
        for (int i = 0; i < 20000 / SPARE; ++i) {
            lum_rng rng = lum_rng_stream(10 + r, (uint64_t)i);
            lum_flight f;
            lum_volumes_fly(volumes, o, d, t_max, share, &rng, &f);
            for (int c = 0; c < 3; ++c)
                stats_add(&passed[c], f.event == LUM_FLIGHT_PASSED ? f.factor[c] : 0);
            if (f.event == LUM_FLIGHT_SCATTERED)
                ++by[f.g == 0.25 ? 0 : 1];
            assert_true(f.event != LUM_FLIGHT_SCATTERED || f.g == 0.25 || f.g == -0.5);
        }
        for (int c = 0; c < 3; ++c) {
            assert_true(fabs(depth[2][c] - depth[0][c] - depth[1][c]) <= 1e-12 * depth[2][c]);
            assert_true(fabs(passed[c].mean - exp(-depth[2][c])) <= SIGMAS * stats_error(&passed[c]) + 1e-12);
        }
        assert_true((by[0] > 0) == (depth[0][0] > 0) && (by[1] > 0) == (depth[1][0] > 0));
        lum_volumes_destroy(volumes);
    }
    free_volumes(model);
    lum_grid_destroy(one);
    lum_grid_destroy(other);
}

/* ------------------------------------------------------------------------------------------------------- bad lattices */

static void bad_lattices_are_refused(void **state)
{
    (void)state;
    lum_grid *grid;
    lmg_error err = {{0}};
    float values[8] = {1, 2, 3, 4, 5, NAN, 7, 8};
    const int32_t low[3] = {10, -20, 30};
    const uint32_t size[3] = {2, 2, 2};
    assert_int_equal(lum_grid_create(low, size, values, LUM_INTERPOLATION_LINEAR, 1, &grid, &err), LMG_ERROR_INPUT);
    assert_non_null(strstr(err.message, "voxel (11, -20, 31)"));
    values[5] = -0.25f;
    assert_int_equal(lum_grid_create(low, size, values, LUM_INTERPOLATION_LINEAR, 1, &grid, &err), LMG_ERROR_INPUT);
    assert_non_null(strstr(err.message, "-0.25"));
    values[5] = INFINITY;
    assert_int_equal(lum_grid_create(low, size, values, LUM_INTERPOLATION_LINEAR, 1, &grid, &err), LMG_ERROR_INPUT);
    memset(values, 0, sizeof(values));
    assert_int_equal(lum_grid_create(low, size, values, LUM_INTERPOLATION_LINEAR, 1, &grid, &err), LMG_ERROR_INPUT);
    assert_non_null(strstr(err.message, "zero"));
    assert_null(grid);
    lum_grid_builder *b;
    const int32_t far_low[3] = {-2000000000, -2000000000, -2000000000}, far_high[3] = {2000000000, 2000000000, 2000000000};
    assert_int_equal(lum_grid_begin(far_low, far_high, LUM_INTERPOLATION_LINEAR, &b, &err), LMG_ERROR_INPUT);
    assert_int_equal(lum_grid_begin(far_high, far_low, LUM_INTERPOLATION_LINEAR, &b, &err), LMG_ERROR_INPUT);
    assert_null(b);
}

/* ------------------------------------------------------------------------------------------------------------- OpenVDB */

static const double MAP[3][4] = {{0.5, 0.1, 0, 3}, {0, 0.25, 0, -4}, {0.2, 0, 0.75, 5}};

static void file_name(char *path, size_t size, const char *name)
{
    snprintf(path, size, "%s/test_volume_%s_%ld.vdb", LUMIBOX_BINARY_DIR, name, (long)getpid());
}

static void vdb_files_are_read(void **state)
{
    (void)state;
    if (!lum_vdb_available()) {
        print_message("vdb_files_are_read: skipped, built without OpenVDB\n");
        skip();
    }
    static float values[NX * NY * NZ];
    char path[1024];
    lmg_error err = {{0}};
    file_name(path, sizeof(path), "read");
    make_values(HOLES, values);
    if (lum_vdb_write(path, "density", LOW, SIZE, values, MAP, &err) != LMG_OK)
        fail_msg("%s", err.message);
    for (int named = 0; named < 2; ++named) {
        lum_grid *grid;
        double map[3][4];
        if (lum_grid_read_vdb(path, named ? "density" : NULL, LUM_INTERPOLATION_LINEAR, 1, &grid, map, &err) != LMG_OK)
            fail_msg("%s", err.message);
        for (int i = 0; i < 12; ++i)
            assert_true(fabs(map[i / 4][i % 4] - MAP[i / 4][i % 4]) < 1e-12);
        for (int i = 0; i < NX * NY * NZ; ++i) {
            const double p[3] = {LOW[0] + i / (NY * NZ), LOW[1] + i / NZ % NY, LOW[2] + i % NZ};
            assert_true(lum_grid_density(grid, p) == (double)values[i]);
        }
        lum_grid_destroy(grid);
    }
    unlink(path);
}

/* Every message is one line and says what is wrong. */
static void refused(const char *path, const char *name, lmg_result expected, const char *part)
{
    lum_grid *grid;
    double map[3][4];
    lmg_error err = {{0}};
    const lmg_result result = lum_grid_read_vdb(path, name, LUM_INTERPOLATION_LINEAR, 1, &grid, map, &err);
    if (result == LMG_OK || (expected && result != expected) || !strstr(err.message, part) || strchr(err.message, '\n'))
        fail_msg("result %d: %s", (int)result, err.message);
    assert_null(grid);
}

static void bad_vdb_files_are_refused(void **state)
{
    (void)state;
    if (!lum_vdb_available()) {
        print_message("bad_vdb_files_are_refused: skipped, built without OpenVDB\n");
        skip();
    }
    static float values[NX * NY * NZ];
    char path[1024];
    lmg_error err = {{0}};
    file_name(path, sizeof(path), "bad");
    refused("/nowhere/smoke.vdb", NULL, LMG_ERROR_FILE_OPEN, "");
    make_values(SMOOTH, values);
    assert_int_equal(lum_vdb_write(path, "temperature", LOW, SIZE, values, MAP, &err), LMG_OK);
    refused(path, "density", LMG_ERROR_INPUT, "\"temperature\"");
    values[100] = NAN;
    assert_int_equal(lum_vdb_write(path, "density", LOW, SIZE, values, MAP, &err), LMG_OK);
    refused(path, "density", LMG_ERROR_INPUT, "nan");
    values[100] = -3;
    assert_int_equal(lum_vdb_write(path, "density", LOW, SIZE, values, MAP, &err), LMG_OK);
    refused(path, NULL, LMG_ERROR_INPUT, "grid \"density\": voxel (-11, 10, 12): density -3");
    values[100] = 1;
    assert_int_equal(lum_vdb_write(path, "density", LOW, SIZE, values, MAP, &err), LMG_OK);

    /* Cut short anywhere: the last bytes are part of the data. */
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    static char bytes[200000];
    const size_t size = fread(bytes, 1, sizeof(bytes), file);
    fclose(file);
    assert_true(size > 1000 && size < sizeof(bytes));
    const size_t step = size / 150 + 1;
    for (size_t cut = 0; cut < size; cut += cut < 100 ? 5 : step) {
        file = fopen(path, "wb");
        assert_non_null(file);
        assert_int_equal(fwrite(bytes, 1, cut, file), cut);
        fclose(file);
        refused(path, NULL, LMG_ERROR_FILE_READ, "");
    }
    /* Not a grid at all. */
    file = fopen(path, "wb");
    assert_non_null(file);
    fputs("{\"entries\": []} and more of the like, longer than a header", file);
    fclose(file);
    refused(path, NULL, LMG_ERROR_FILE_READ, "");
    unlink(path);
}

/* A cloud of somebody else's, in 16-bit floats: the mean density that the file's own statistics give. */
static void real_smoke_is_read(void **state)
{
    (void)state;
    const char *path = LUMIBOX_SHARED_DATA "/volumes/smoke.vdb";
    if (!lum_vdb_available() || access(path, R_OK) != 0) {
        print_message("real_smoke_is_read: skipped, %s\n", lum_vdb_available() ? "no volumes/smoke.vdb" : "built without OpenVDB");
        skip();
    }
    lum_grid *grid;
    lmg_error err = {{0}};
    double map[3][4], lo[3], hi[3];
    if (lum_grid_read_vdb(path, NULL, LUM_INTERPOLATION_LINEAR, 1, &grid, map, &err) != LMG_OK)
        fail_msg("%s", err.message);
    lum_grid_bounds(grid, lo, hi);
    print_message("smoke.vdb: %g..%g, %g..%g, %g..%g, voxel %g\n", lo[0], hi[0], lo[1], hi[1], lo[2], hi[2], map[0][0]);
    assert_true(hi[0] - lo[0] <= 113 && hi[1] - lo[1] <= 224 && hi[2] - lo[2] <= 114);
    assert_true(hi[0] - lo[0] > 90 && hi[1] - lo[1] > 200 && hi[2] - lo[2] > 90);
    lum_grid_destroy(grid);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lattices_interpolate),
        cmocka_unit_test(optical_depths_are_exact),
        cmocka_unit_test(flights_pass_as_the_depth_says),
        cmocka_unit_test(constant_grid_is_a_homogeneous_medium),
        cmocka_unit_test(volumes_overlap),
        cmocka_unit_test(bad_lattices_are_refused),
        cmocka_unit_test(vdb_files_are_read),
        cmocka_unit_test(bad_vdb_files_are_refused),
        cmocka_unit_test(real_smoke_is_read),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
