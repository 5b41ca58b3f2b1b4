/* SPDX-License-Identifier: Apache-2.0 */
/* Receivers: illuminance on rectangles, intensity in far-field bins.  Relies on C11 atomics. */
#include "receiver.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>

static const double PI = 3.14159265358979323846;
/* Sums count in units of 2^-20 of a ray's unit flux. */
static const double FIXED = 0x1p20;

typedef struct pixel {
    atomic_int_least64_t sum, squares;
} pixel;

struct bake_receiver {
    bool far_field;
    bake_rectangle rectangle;
    lmg_vec3 n; /* a x b, or the axis of the far field; a, b of the far field are in rectangle */
    uint32_t rings, sectors;
    double per_pixel; /* 1 / area or 1 / solid angle */
    size_t count;
    pixel *pixels;
};

static double dot(lmg_vec3 a, lmg_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static lmg_vec3 cross(lmg_vec3 a, lmg_vec3 b)
{
    return (lmg_vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static void count_ray(bake_receiver *r, size_t i, const lmg_ray *ray)
{
    const double y = lmg_luminance(ray->flux);
    if (!isfinite(y))
        return;
    atomic_fetch_add_explicit(&r->pixels[i].sum, (int_least64_t)llrint(y * FIXED), memory_order_relaxed);
    atomic_fetch_add_explicit(&r->pixels[i].squares, (int_least64_t)llrint(y * y * FIXED), memory_order_relaxed);
}

static void consume_rectangle(void *self, const lmg_ray *rays, size_t count)
{
    bake_receiver *r = self;
    const bake_rectangle *q = &r->rectangle;
    const lmg_vec3 n = r->n;
    const double sx = (double)q->nx / q->width, sy = (double)q->ny / q->height;
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 o = rays[i].origin, d = rays[i].direction;
        const lmg_vec3 to = {q->centre.x - o.x, q->centre.y - o.y, q->centre.z - o.z};
        const double along = dot(d, n), height = dot(to, n);
        if (!(along > 0) || height < 0)
            continue;
        const double t = height / along;
        const lmg_vec3 p = {t * d.x - to.x, t * d.y - to.y, t * d.z - to.z};
        const double x = (dot(p, q->a) + 0.5 * q->width) * sx, y = (dot(p, q->b) + 0.5 * q->height) * sy;
        if (x >= 0 && x < (double)q->nx && y >= 0 && y < (double)q->ny)
            count_ray(r, (size_t)y * q->nx + (size_t)x, &rays[i]);
    }
}

static void consume_far_field(void *self, const lmg_ray *rays, size_t count)
{
    bake_receiver *r = self;
    for (size_t i = 0; i < count; ++i) {
        const lmg_vec3 d = rays[i].direction;
        const double z = 0.5 * (dot(d, r->n) + 1) * r->rings;
        const double phi = (atan2(dot(d, r->rectangle.b), dot(d, r->rectangle.a)) + PI) / (2 * PI) * r->sectors;
        if (!(z >= 0) || !(phi >= 0))
            continue;
        size_t ring = (size_t)z, sector = (size_t)phi;
        ring = ring < r->rings ? ring : r->rings - 1; /* the pole itself, and rounding beyond it */
        sector = sector < r->sectors ? sector : r->sectors - 1;
        count_ray(r, ring * r->sectors + sector, &rays[i]);
    }
}

static lmg_result create(bake_receiver **out, size_t count, lmg_error *err)
{
    *out = NULL;
    bake_receiver *r = calloc(1, sizeof(*r));
    if (r)
        r->pixels = calloc(count, sizeof(*r->pixels));
    if (!r || !r->pixels) {
        free(r);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for a receiver of %zu pixels", count);
    }
    r->count = count;
    *out = r;
    return LMG_OK;
}

lmg_result bake_illuminance_create(const bake_rectangle *q, bake_receiver **out, lmg_error *err)
{
    *out = NULL;
    if (!(q->width > 0) || !(q->height > 0) || q->nx < 1 || q->ny < 1 || q->nx > 65535 || q->ny > 65535)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a receiver of %g x %g m with %u x %u pixels can't measure", q->width, q->height,
                        q->nx, q->ny);
    const lmg_result result = create(out, (size_t)q->nx * q->ny, err);
    if (result != LMG_OK)
        return result;
    bake_receiver *r = *out;
    r->rectangle = *q;
    r->n = cross(q->a, q->b);
    r->per_pixel = (double)r->count / (q->width * q->height);
    return LMG_OK;
}

lmg_result bake_far_field_create(lmg_vec3 axis, uint32_t rings, uint32_t sectors, bake_receiver **out, lmg_error *err)
{
    *out = NULL;
    if (rings < 1 || sectors < 1 || rings > 65535 || sectors > 65535)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a far field of %u x %u bins can't measure", rings, sectors);
    const lmg_result result = create(out, (size_t)rings * sectors, err);
    if (result != LMG_OK)
        return result;
    bake_receiver *r = *out;
    r->far_field = true;
    r->rings = rings;
    r->sectors = sectors;
    r->n = axis;
    const lmg_vec3 other = fabs(axis.x) < 0.5 ? (lmg_vec3){1, 0, 0} : (lmg_vec3){0, 1, 0};
    lmg_vec3 a = cross(other, axis);
    const double length = sqrt(dot(a, a));
    r->rectangle.a = (lmg_vec3){a.x / length, a.y / length, a.z / length};
    r->rectangle.b = cross(axis, r->rectangle.a);
    r->per_pixel = (double)r->count / (4 * PI);
    return LMG_OK;
}

void bake_receiver_destroy(bake_receiver *r)
{
    if (!r)
        return;
    free(r->pixels);
    free(r);
}

lmg_sink bake_receiver_sink(bake_receiver *r)
{
    return (lmg_sink){.self = r, .consume = r->far_field ? consume_far_field : consume_rectangle};
}

size_t bake_receiver_count(const bake_receiver *r)
{
    return r->count;
}

static double sum_of(const bake_receiver *r, size_t i)
{
    return (double)atomic_load_explicit(&r->pixels[i].sum, memory_order_relaxed) / FIXED;
}

static double squares_of(const bake_receiver *r, size_t i)
{
    return (double)atomic_load_explicit(&r->pixels[i].squares, memory_order_relaxed) / FIXED;
}

double bake_receiver_reading(const bake_receiver *r, size_t i, double lumens_per_unit, double *standard_error)
{
    const double scale = lumens_per_unit * r->per_pixel;
    if (standard_error)
        *standard_error = scale * sqrt(squares_of(r, i));
    return scale * sum_of(r, i);
}

double bake_receiver_noise(const bake_receiver *r)
{
    double signal = 0, noise = 0;
    for (size_t i = 0; i < r->count; ++i) {
        const double s = sum_of(r, i), v = squares_of(r, i);
        signal += s * s - v;
        noise += v;
    }
    return signal > 0 ? sqrt(noise / signal) : (double)INFINITY;
}

lmg_vec3 bake_main_axis(const lmg_ray *rays, size_t count)
{
    lmg_vec3 mean = {0, 0, 0};
    double total = 0;
    for (size_t i = 0; i < count; ++i) {
        const double y = lmg_luminance(rays[i].flux);
        if (!isfinite(y))
            continue;
        mean = (lmg_vec3){mean.x + y * rays[i].direction.x, mean.y + y * rays[i].direction.y, mean.z + y * rays[i].direction.z};
        total += y;
    }
    const double x = fabs(mean.x), y = fabs(mean.y), z = fabs(mean.z);
    if (!(sqrt(dot(mean, mean)) > 0.1 * total))
        return (lmg_vec3){0, -1, 0};
    if (y >= x && y >= z)
        return (lmg_vec3){0, copysign(1, mean.y), 0};
    return x >= z ? (lmg_vec3){copysign(1, mean.x), 0, 0} : (lmg_vec3){0, 0, copysign(1, mean.z)};
}

bake_rectangle bake_measuring_rectangle(lmg_vec3 lo, lmg_vec3 hi, lmg_vec3 axis, double size, double distance, uint32_t pixels)
{
    bake_rectangle q = {.centre = {0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), 0.5 * (lo.z + hi.z)}};
    const double half = 0.5 * (fabs(axis.x) * (hi.x - lo.x) + fabs(axis.y) * (hi.y - lo.y) + fabs(axis.z) * (hi.z - lo.z));
    const double out = half + distance;
    q.centre = (lmg_vec3){q.centre.x + out * axis.x, q.centre.y + out * axis.y, q.centre.z + out * axis.z};
    q.a = fabs(axis.x) > 0.5 ? (lmg_vec3){0, 0, 1} : (lmg_vec3){1, 0, 0};
    q.b = cross(axis, q.a);
    q.width = q.height = 2 * distance + size;
    q.nx = q.ny = pixels;
    return q;
}
