/* SPDX-License-Identifier: Apache-2.0 */
/* Alignment of two sources by the light they give: rotation from the far fields, shift from where the rays pass. */
#include "align.h"

#include "bake.h"
#include "batch.h"
#include "receiver.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

static const double PI = 3.14159265358979323846;

enum {
    BLOCKS = 8,  /* of rays, for the jackknife */
    DEGREE = 10, /* of the spherical harmonics */
    TERMS = (DEGREE + 1) * (DEGREE + 1),
    RINGS = 180, /* one degree: far below what degree 10 resolves (18 degrees) */
    SECTORS = 360,
    PROBES = 642, /* directions in which the far fields are compared: several per term */
    STEPS = 40
};
/* Smoothing of the far fields, radians: damps degree 10 to 0.58, so that the sum doesn't ring. */
static const double SMOOTHING = 0.1;
/* How many times its standard error a motion has to be to count (an error from eight blocks is itself uncertain by a quarter: 5 is
 * passed by chance once in a thousand times), and how many times the slope that noise makes the far field must have about an axis for
 * a turn about it to be determined. */
static const double SIGNIFICANT = 5, SLOPE = 6;

static double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

lmg_vec3 bake_motion_direction(const bake_motion *m, lmg_vec3 d)
{
    const double(*r)[3] = m->rotation;
    return (lmg_vec3){r[0][0] * d.x + r[0][1] * d.y + r[0][2] * d.z, r[1][0] * d.x + r[1][1] * d.y + r[1][2] * d.z,
                      r[2][0] * d.x + r[2][1] * d.y + r[2][2] * d.z};
}

lmg_vec3 bake_motion_point(const bake_motion *m, lmg_vec3 p)
{
    const lmg_vec3 q = bake_motion_direction(m, p);
    return (lmg_vec3){q.x + m->shift.x, q.y + m->shift.y, q.z + m->shift.z};
}

bool bake_motion_is_identity(const bake_motion *m)
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            if (m->rotation[i][j] != (i == j))
                return false;
    return m->shift.x == 0 && m->shift.y == 0 && m->shift.z == 0;
}

static void consume_moved(void *self, const lmg_ray *rays, size_t count)
{
    const bake_moved_sink *m = self;
    lmg_ray moved[BAKE_BATCH_RAYS];
    for (size_t done = 0; done < count;) {
        const size_t n = count - done < BAKE_BATCH_RAYS ? count - done : BAKE_BATCH_RAYS;
        for (size_t i = 0; i < n; ++i) {
            moved[i] = rays[done + i];
            moved[i].origin = bake_motion_point(&m->motion, moved[i].origin);
            moved[i].direction = bake_motion_direction(&m->motion, moved[i].direction);
        }
        for (size_t s = 0; s < m->count; ++s)
            m->sinks[s].consume(m->sinks[s].self, moved, n);
        done += n;
    }
}

lmg_sink bake_moved_sink_of(bake_moved_sink *moved)
{
    return (lmg_sink){.self = moved, .consume = consume_moved};
}

/* ------------------------------------------------------------------------------------- where the rays pass: moments */

/* Sums over rays, in fixed point so that threads need no order: the matrix w (1 - d d^T) (xx xy xz yy yz zz) and the vector
 * w (1 - d d^T) o with o in units of `scale` from `centre`. */
typedef struct moments {
    lmg_vec3 centre;
    double scale;
    atomic_int_least64_t matrix[6], vector[3];
} moments;

static const double FIXED = 0x1p28;

static void consume_moments(void *self, const lmg_ray *rays, size_t count)
{
    moments *m = self;
    int_least64_t matrix[6] = {0}, vector[3] = {0};
    for (size_t i = 0; i < count; ++i) {
        const double w = lmg_luminance(rays[i].flux);
        const lmg_vec3 d = rays[i].direction, p = rays[i].origin;
        const lmg_vec3 o = {(p.x - m->centre.x) / m->scale, (p.y - m->centre.y) / m->scale, (p.z - m->centre.z) / m->scale};
        const double along = dot(o, d);
        const double v[3] = {o.x - along * d.x, o.y - along * d.y, o.z - along * d.z};
        /* A line that passes thousands of sizes away isn't this luminaire's light; it would overflow the sums. */
        if (!(w > 0) || !(fabs(v[0]) + fabs(v[1]) + fabs(v[2]) < 4096) || !(w < 4096))
            continue;
        const double a[6] = {1 - d.x * d.x, -d.x * d.y, -d.x * d.z, 1 - d.y * d.y, -d.y * d.z, 1 - d.z * d.z};
        for (int k = 0; k < 6; ++k)
            matrix[k] += llrint(w * a[k] * FIXED);
        for (int k = 0; k < 3; ++k)
            vector[k] += llrint(w * v[k] * FIXED);
    }
    for (int k = 0; k < 6; ++k)
        atomic_fetch_add_explicit(&m->matrix[k], matrix[k], memory_order_relaxed);
    for (int k = 0; k < 3; ++k)
        atomic_fetch_add_explicit(&m->vector[k], vector[k], memory_order_relaxed);
}

/* Solves the symmetric positive 3 x 3 system by Cholesky's method; false when it is singular to rounding. */
static bool solve3(const double a[6], const double b[3], double x[3])
{
    /* Pivots below this are the rounding of sums of the trace's size (2^-53, times the few operations, with room). */
    const double tiny = 1e-12 * (a[0] + a[3] + a[5]);
    const double l00 = sqrt(a[0]), l10 = a[1] / l00, l20 = a[2] / l00;
    const double d1 = a[3] - l10 * l10;
    if (!(a[0] > tiny) || !(d1 > tiny))
        return false;
    const double l11 = sqrt(d1), l21 = (a[4] - l20 * l10) / l11, d2 = a[5] - l20 * l20 - l21 * l21;
    if (!(d2 > tiny))
        return false;
    const double l22 = sqrt(d2);
    const double y0 = b[0] / l00, y1 = (b[1] - l10 * y0) / l11, y2 = (b[2] - l20 * y0 - l21 * y1) / l22;
    x[2] = y2 / l22;
    x[1] = (y1 - l21 * x[2]) / l11;
    x[0] = (y0 - l10 * x[1] - l20 * x[2]) / l00;
    return true;
}

/* ------------------------------------------------------------------------------------------------ one source measured */

typedef struct side {
    double matrix[BLOCKS][6], vector[BLOCKS][3]; /* moments per block, per unit of flux; vector in metres from the origin */
    double terms[BLOCKS][TERMS];                 /* far field per block, total flux 1 */
    double slope_noise;                          /* mean square slope that noise gives the far field about an axis */
    double noise;                                /* mean variance of the smoothed far field */
} side;

/* Real spherical harmonics, orthonormal, of a unit vector, in the order l (l + 1) + m. */
static void harmonics(lmg_vec3 d, double y[TERMS])
{
    const double root2 = sqrt(2.0);
    double cos_m = 1, sin_m = 0; /* sin^m(theta) times cos, sin of m phi */
    double sectoral = sqrt(1 / (4 * PI));
    for (int m = 0; m <= DEGREE; ++m) {
        double before = 0, p = sectoral;
        for (int l = m; l <= DEGREE; ++l) {
            if (m == 0) {
                y[l * (l + 1)] = p;
            } else {
                y[l * (l + 1) + m] = root2 * p * cos_m;
                y[l * (l + 1) - m] = root2 * p * sin_m;
            }
            const double n = l + 1, f = sqrt((4 * n * n - 1) / (n * n - (double)m * m));
            const double g = sqrt(((n - 1) * (n - 1) - (double)m * m) / (4 * (n - 1) * (n - 1) - 1));
            const double next = f * (d.z * p - (l > m ? g * before : 0));
            before = p;
            p = next;
        }
        const double c = cos_m * d.x - sin_m * d.y, s = sin_m * d.x + cos_m * d.y;
        cos_m = c;
        sin_m = s;
        sectoral *= -sqrt((2.0 * m + 3) / (2.0 * m + 2));
    }
}

static double damping(int l)
{
    return exp(-0.5 * l * (l + 1) * SMOOTHING * SMOOTHING);
}

/* Expands the far field that a receiver has counted, damped, for a total of 1. */
static void expand(const bake_receiver *r, double terms[TERMS])
{
    memset(terms, 0, TERMS * sizeof(terms[0]));
    double total = 0;
    for (size_t ring = 0; ring < RINGS; ++ring) {
        const double theta = PI * ((double)ring + 0.5) / RINGS;
        for (size_t sector = 0; sector < SECTORS; ++sector) {
            const size_t i = ring * SECTORS + sector;
            const double flux = bake_receiver_reading(r, i, 1, NULL) * bake_receiver_solid_angle(r, i);
            if (flux == 0)
                continue;
            const lmg_vec3 a = bake_receiver_direction(r, theta, 2 * PI * ((double)sector + 0.5) / SECTORS - PI);
            double y[TERMS];
            harmonics(a, y);
            for (int k = 0; k < TERMS; ++k)
                terms[k] += flux * y[k];
            total += flux;
        }
    }
    for (int l = 0; l <= DEGREE; ++l)
        for (int m = -l; m <= l; ++m)
            terms[l * (l + 1) + m] *= damping(l) / total;
}

static lmg_result measure(bake_source *source, uint64_t photons, unsigned threads, side *out, lmg_error *err)
{
    const lmg_vec3 lo = source->bounds_min, hi = source->bounds_max;
    lmg_result result = LMG_OK;
    for (uint64_t b = 0; result == LMG_OK && b < BLOCKS; ++b) {
        moments m = {.centre = {0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), 0.5 * (lo.z + hi.z)}};
        /* A source without extent is measured in nanometres: any unit serves, but zero. */
        m.scale = fmax(fmax(hi.x - lo.x, hi.y - lo.y), fmax(hi.z - lo.z, 1e-9));
        bake_receiver *far_field;
        result = bake_sphere_create(
            &(bake_sphere){.radius = INFINITY, .axis = {0, 0, 1}, .rings = RINGS, .sectors = SECTORS, .equal_angles = true}, &far_field, err);
        if (result != LMG_OK)
            break;
        const lmg_sink sinks[2] = {bake_receiver_sink(far_field), {.self = &m, .consume = consume_moments}};
        bake_tally tally = {0};
        const uint64_t count = photons / BLOCKS;
        result = source->run(source, BAKE_PILOT_FIRST + b * count, count, threads, sinks, 2, &tally, err);
        const double weight = 0.5 * (double)(m.matrix[0] + m.matrix[3] + m.matrix[5]); /* the trace of w (1 - d d^T) is 2 w */
        if (result == LMG_OK && !(weight > 0))
            result = lmg_fail(err, LMG_ERROR_INPUT, "no light leaves the luminaire: nothing to align");
        if (result == LMG_OK) {
            expand(far_field, out->terms[b]);
            double *a = out->matrix[b], *v = out->vector[b];
            for (int k = 0; k < 6; ++k)
                a[k] = (double)m.matrix[k] / weight;
            for (int k = 0; k < 3; ++k)
                v[k] = (double)m.vector[k] / weight * m.scale;
            const lmg_vec3 c = m.centre;
            v[0] += a[0] * c.x + a[1] * c.y + a[2] * c.z;
            v[1] += a[1] * c.x + a[3] * c.y + a[4] * c.z;
            v[2] += a[2] * c.x + a[4] * c.y + a[5] * c.z;
        }
        bake_receiver_destroy(far_field);
    }
    return result;
}

/* Mean over the blocks, leaving one out (BLOCKS = none). */
static void mean_without(const double *values, size_t width, int left_out, double *mean)
{
    memset(mean, 0, width * sizeof(*mean));
    for (int b = 0; b < BLOCKS; ++b)
        if (b != left_out)
            for (size_t k = 0; k < width; ++k)
                mean[k] += values[(size_t)b * width + k] / (left_out < BLOCKS ? BLOCKS - 1 : BLOCKS);
}

/* How far noise bends the far field: from the spread of the terms over the blocks. */
static void measure_noise(side *s)
{
    double mean[TERMS];
    mean_without(s->terms[0], TERMS, BLOCKS, mean);
    s->noise = s->slope_noise = 0;
    for (int l = 0; l <= DEGREE; ++l)
        for (int m = -l; m <= l; ++m) {
            const int k = l * (l + 1) + m;
            double v = 0;
            for (int b = 0; b < BLOCKS; ++b)
                v += (s->terms[b][k] - mean[k]) * (s->terms[b][k] - mean[k]) / (BLOCKS * (BLOCKS - 1));
            s->noise += v / (4 * PI);
            s->slope_noise += v * l * (l + 1) / 3.0 / (4 * PI); /* a turn about one axis of three */
        }
}

/* ------------------------------------------------------------------------------------------------------------ rotation */

/* exp of the rotation vector v, times r. */
static void turn(const double v[3], double r[3][3])
{
    const double angle = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (angle == 0)
        return;
    const double x = v[0] / angle, y = v[1] / angle, z = v[2] / angle, c = cos(angle), s = sin(angle), k = 1 - c;
    const double e[3][3] = {{c + k * x * x, k * x * y - s * z, k * x * z + s * y},
                            {k * x * y + s * z, c + k * y * y, k * y * z - s * x},
                            {k * x * z - s * y, k * y * z + s * x, c + k * z * z}};
    double product[3][3];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            product[i][j] = e[i][0] * r[0][j] + e[i][1] * r[1][j] + e[i][2] * r[2][j];
    memcpy(r, product, sizeof(product));
}

static double far_field_at(const double terms[TERMS], lmg_vec3 d)
{
    double y[TERMS], sum = 0;
    harmonics(d, y);
    for (int k = 0; k < TERMS; ++k)
        sum += terms[k] * y[k];
    return sum;
}

/* Directions spread evenly over the sphere (a Fibonacci spiral). */
static lmg_vec3 probe(int i)
{
    const double z = 1 - (2.0 * i + 1) / PROBES, s = sqrt(1 - z * z), phi = i * PI * (3 - sqrt(5.0));
    return (lmg_vec3){s * cos(phi), s * sin(phi), z};
}

/* A's far field, turned, in direction d. */
static double turned_at(const double terms[TERMS], const double r[3][3], lmg_vec3 d)
{
    const lmg_vec3 back = {r[0][0] * d.x + r[1][0] * d.y + r[2][0] * d.z, r[0][1] * d.x + r[1][1] * d.y + r[2][1] * d.z,
                           r[0][2] * d.x + r[1][2] * d.y + r[2][2] * d.z};
    return far_field_at(terms, back);
}

/* Mean square difference between B's far field at the probes and A's, turned. */
static double misfit(const double a[TERMS], const double at_probes[PROBES], const double r[3][3])
{
    double sum = 0;
    for (int i = 0; i < PROBES; ++i) {
        const double e = at_probes[i] - turned_at(a, r, probe(i));
        sum += e * e;
    }
    return sum / PROBES;
}

/* Eigenvectors (rows of v) and eigenvalues of a symmetric 3 x 3 matrix, by Jacobi's rotations. */
static void eigen3(double a[3][3], double v[3][3], double value[3])
{
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            v[i][j] = i == j;
    for (int sweep = 0; sweep < 30; ++sweep)
        for (int p = 0; p < 2; ++p)
            for (int q = p + 1; q < 3; ++q) {
                if (a[p][q] == 0)
                    continue;
                const double theta = 0.5 * atan2(2 * a[p][q], a[q][q] - a[p][p]), c = cos(theta), s = sin(theta);
                for (int k = 0; k < 3; ++k) {
                    const double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
                for (int k = 0; k < 3; ++k) {
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
                for (int k = 0; k < 3; ++k) {
                    const double x = v[p][k], y = v[q][k];
                    v[p][k] = c * x - s * y;
                    v[q][k] = s * x + c * y;
                }
            }
    for (int i = 0; i < 3; ++i)
        value[i] = a[i][i];
}

/* Gauss-Newton from r; turns that A's own far field doesn't determine (slope below least_slope, a mean square) are left alone.
 * Returns the misfit reached; *turns: how many are determined. */
static double fit_rotation(const double a[TERMS], const double at_probes[PROBES], double least_slope, double r[3][3], unsigned *turns)
{
    const double h = 1e-4; /* central differences of a function smooth over 0.1 rad, in double */
    double now = misfit(a, at_probes, r);
    for (int step = 0; step < STEPS; ++step) {
        double normal[3][3] = {{0}}, gradient[3] = {0};
        double plus[3][3][3], minus[3][3][3];
        for (int k = 0; k < 3; ++k) {
            double v[3] = {0};
            memcpy(plus[k], r, sizeof(plus[k]));
            memcpy(minus[k], r, sizeof(minus[k]));
            v[k] = h;
            turn(v, plus[k]);
            v[k] = -h;
            turn(v, minus[k]);
        }
        for (int i = 0; i < PROBES; ++i) {
            const lmg_vec3 d = probe(i);
            const double e = at_probes[i] - turned_at(a, r, d);
            double slope[3];
            for (int k = 0; k < 3; ++k)
                slope[k] = (turned_at(a, plus[k], d) - turned_at(a, minus[k], d)) / (2 * h);
            for (int j = 0; j < 3; ++j) {
                gradient[j] += slope[j] * e / PROBES;
                for (int k = 0; k < 3; ++k)
                    normal[j][k] += slope[j] * slope[k] / PROBES;
            }
        }
        double axis[3][3], value[3], v[3] = {0};
        eigen3(normal, axis, value);
        *turns = 0;
        for (int k = 0; k < 3; ++k) {
            if (!(value[k] > least_slope))
                continue;
            ++*turns;
            const double along = (axis[k][0] * gradient[0] + axis[k][1] * gradient[1] + axis[k][2] * gradient[2]) / value[k];
            for (int j = 0; j < 3; ++j)
                v[j] += along * axis[k][j];
        }
        /* No step beyond what the smoothed field resolves; halved until it helps. */
        const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        double scale = length > 2 * SMOOTHING ? 2 * SMOOTHING / length : 1;
        bool better = false;
        for (int half = 0; half < 8 && !better; ++half, scale *= 0.5) {
            double trial[3][3];
            memcpy(trial, r, sizeof(trial));
            turn((double[3]){v[0] * scale, v[1] * scale, v[2] * scale}, trial);
            const double then = misfit(a, at_probes, trial);
            if (then < now) {
                memcpy(r, trial, sizeof(trial));
                now = then;
                better = true;
            }
        }
        if (!better || length < 1e-6) /* radians: a thousandth of what any number of rays determines */
            break;
    }
    return now;
}

/* The 24 rotations of a cube: signed permutation matrices of determinant 1. */
static int cube_rotations(double r[24][3][3])
{
    static const int ORDER[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    int n = 0;
    for (int p = 0; p < 6; ++p)
        for (int signs = 0; signs < 8; ++signs) {
            const int minus = (signs & 1) + (signs >> 1 & 1) + (signs >> 2);
            if ((minus + (p >= 3)) % 2)
                continue; /* a reflection */
            memset(r[n], 0, sizeof(r[n]));
            for (int i = 0; i < 3; ++i)
                r[n][i][ORDER[p][i]] = signs >> i & 1 ? -1 : 1;
            ++n;
        }
    return n;
}

static const double IDENTITY[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

static void find_rotation(const side *a, const side *b, double r[3][3], unsigned *turns)
{
    double terms_a[TERMS], terms_b[TERMS], at_probes[PROBES];
    mean_without(a->terms[0], TERMS, BLOCKS, terms_a);
    mean_without(b->terms[0], TERMS, BLOCKS, terms_b);
    for (int i = 0; i < PROBES; ++i)
        at_probes[i] = far_field_at(terms_b, probe(i));
    const double least_slope = SLOPE * a->slope_noise;

    memcpy(r, IDENTITY, sizeof(IDENTITY));
    const double near = fit_rotation(terms_a, at_probes, least_slope, r, turns);
    double starts[24][3][3], best = near;
    const int count = cube_rotations(starts);
    double found[3][3];
    unsigned found_turns = 0;
    for (int i = 0; i < count; ++i) {
        /* Only starts that already do better than the worst start at the identity are worth the steps. */
        if (misfit(terms_a, at_probes, starts[i]) > 4 * misfit(terms_a, at_probes, IDENTITY))
            continue;
        unsigned t;
        const double reached = fit_rotation(terms_a, at_probes, least_slope, starts[i], &t);
        if (reached < best) {
            best = reached;
            memcpy(found, starts[i], sizeof(found));
            found_turns = t;
        }
    }
    /* A symmetric lamp fits in several ways equally well, to the noise: then it stays where it is. */
    if (best < near - SIGNIFICANT * (a->noise + b->noise)) {
        memcpy(r, found, sizeof(found));
        *turns = found_turns;
    }
}

static double angle_of(const double r[3][3])
{
    const double x = r[2][1] - r[1][2], y = r[0][2] - r[2][0], z = r[1][0] - r[0][1];
    return atan2(sqrt(x * x + y * y + z * z), r[0][0] + r[1][1] + r[2][2] - 1);
}

/* Standard error of the rotation, radians: refits with one block of both sources left out at a time. */
static double rotation_error(const side *a, const side *b, const double r[3][3])
{
    double sum = 0;
    for (int left = 0; left < BLOCKS; ++left) {
        double terms_a[TERMS], terms_b[TERMS], at_probes[PROBES], refit[3][3];
        unsigned turns;
        mean_without(a->terms[0], TERMS, left, terms_a);
        mean_without(b->terms[0], TERMS, left, terms_b);
        for (int i = 0; i < PROBES; ++i)
            at_probes[i] = far_field_at(terms_b, probe(i));
        memcpy(refit, r, sizeof(refit));
        fit_rotation(terms_a, at_probes, SLOPE * a->slope_noise, refit, &turns);
        double between[3][3];
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                between[i][j] = refit[i][0] * r[j][0] + refit[i][1] * r[j][1] + refit[i][2] * r[j][2];
        const double angle = angle_of(between);
        sum += angle * angle;
    }
    return sqrt(sum * (BLOCKS - 1) / BLOCKS);
}

/* --------------------------------------------------------------------------------------------------------------- shift */

static bool focus_without(const side *s, int left_out, double point[3])
{
    double a[6], v[3];
    mean_without(s->matrix[0], 6, left_out, a);
    mean_without(s->vector[0], 3, left_out, v);
    return solve3(a, v, point);
}

static bake_focus focus_of(const side *s)
{
    double p[3], squares[3] = {0};
    if (!focus_without(s, BLOCKS, p))
        return (bake_focus){{NAN, NAN, NAN}, {INFINITY, INFINITY, INFINITY}};
    for (int b = 0; b < BLOCKS; ++b) {
        double q[3];
        if (!focus_without(s, b, q))
            return (bake_focus){{p[0], p[1], p[2]}, {INFINITY, INFINITY, INFINITY}};
        for (int k = 0; k < 3; ++k)
            squares[k] += (q[k] - p[k]) * (q[k] - p[k]) * (BLOCKS - 1) / BLOCKS;
    }
    return (bake_focus){{p[0], p[1], p[2]}, {sqrt(squares[0]), sqrt(squares[1]), sqrt(squares[2])}};
}

/* The shift of A, already turned by r, that brings its focus to B's. */
static bool shift_without(const side *a, const side *b, const double r[3][3], int left_out, double t[3])
{
    double fa[3], fb[3];
    if (!focus_without(a, left_out, fa) || !focus_without(b, left_out, fb))
        return false;
    for (int i = 0; i < 3; ++i)
        t[i] = fb[i] - (r[i][0] * fa[0] + r[i][1] * fa[1] + r[i][2] * fa[2]);
    return true;
}

static void find_shift(const side *a, const side *b, const double r[3][3], lmg_vec3 *shift, lmg_vec3 *error)
{
    double t[3], squares[3] = {0};
    *shift = (lmg_vec3){0, 0, 0};
    *error = (lmg_vec3){INFINITY, INFINITY, INFINITY};
    if (!shift_without(a, b, r, BLOCKS, t))
        return;
    for (int left = 0; left < BLOCKS; ++left) {
        double q[3];
        if (!shift_without(a, b, r, left, q))
            return;
        for (int k = 0; k < 3; ++k)
            squares[k] += (q[k] - t[k]) * (q[k] - t[k]) * (BLOCKS - 1) / BLOCKS;
    }
    double *const to[3] = {&shift->x, &shift->y, &shift->z}, *const to_error[3] = {&error->x, &error->y, &error->z};
    for (int k = 0; k < 3; ++k) {
        *to_error[k] = sqrt(squares[k]);
        if (fabs(t[k]) > SIGNIFICANT * *to_error[k])
            *to[k] = t[k];
    }
}

lmg_result bake_align(bake_source *a, bake_source *b, uint64_t photons, unsigned threads, bake_alignment *out, lmg_error *err)
{
    memset(out, 0, sizeof(*out));
    if (photons < 80000)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "an alignment needs at least 80000 rays of each source");
    side *sides = calloc(2, sizeof(*sides));
    if (!sides)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the alignment");
    lmg_result result = measure(a, photons, threads, &sides[0], err);
    if (result == LMG_OK)
        result = measure(b, photons, threads, &sides[1], err);
    if (result == LMG_OK) {
        for (int s = 0; s < 2; ++s) {
            measure_noise(&sides[s]);
            out->focus[s] = focus_of(&sides[s]);
        }
        bake_motion *m = &out->motion;
        find_rotation(&sides[0], &sides[1], m->rotation, &out->turns);
        out->angle = angle_of(m->rotation);
        out->angle_se = out->turns > 0 ? rotation_error(&sides[0], &sides[1], m->rotation) : 0;
        if (!(out->angle > SIGNIFICANT * out->angle_se)) {
            memcpy(m->rotation, IDENTITY, sizeof(IDENTITY));
            out->angle = 0;
        }
        find_shift(&sides[0], &sides[1], m->rotation, &m->shift, &out->shift_se);
    }
    free(sides);
    return result;
}
