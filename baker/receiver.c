/* SPDX-License-Identifier: Apache-2.0 */
/* Receivers: illuminance on rectangles, intensity in bins of direction, luminance pictures.  Relies on C11 atomics. */
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
    void (*consume)(void *self, const lmg_ray *rays, size_t count);
    bake_rectangle rectangle;
    lmg_vec3 n; /* a x b, or the axis of a sphere, whose a and b are in rectangle */
    bake_sphere sphere;
    double cos_cone;  /* of a picture: directions with a larger cosine against n count */
    double per_pixel; /* 1 / area, or 1 / (area x projected solid angle of the cone); 1 for spheres */
    size_t count;
    pixel *pixels;
    atomic_int_least64_t *red, *blue; /* sums of a receiver with colour, else NULL */
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
    if (r->red) {
        atomic_fetch_add_explicit(&r->red[i], (int_least64_t)llrint((double)ray->flux[0] * FIXED), memory_order_relaxed);
        atomic_fetch_add_explicit(&r->blue[i], (int_least64_t)llrint((double)ray->flux[2] * FIXED), memory_order_relaxed);
    }
}

/* The pixel of the rectangle that a ray meets; false if it meets none or comes from behind. */
static bool meets(const bake_receiver *r, const lmg_ray *ray, bool both_ways, size_t *pixel_index)
{
    const bake_rectangle *q = &r->rectangle;
    const lmg_vec3 o = ray->origin, d = ray->direction;
    const lmg_vec3 to = {q->centre.x - o.x, q->centre.y - o.y, q->centre.z - o.z};
    const double along = dot(d, r->n), height = dot(to, r->n);
    if (!(along > 0) || (height < 0 && !both_ways))
        return false;
    const double t = height / along;
    const lmg_vec3 p = {t * d.x - to.x, t * d.y - to.y, t * d.z - to.z};
    const double x = (dot(p, q->a) / q->width + 0.5) * q->nx, y = (dot(p, q->b) / q->height + 0.5) * q->ny;
    if (!(x >= 0 && x < (double)q->nx && y >= 0 && y < (double)q->ny))
        return false;
    *pixel_index = (size_t)y * q->nx + (size_t)x;
    return true;
}

static void consume_rectangle(void *self, const lmg_ray *rays, size_t count)
{
    bake_receiver *r = self;
    size_t pixel_index;
    for (size_t i = 0; i < count; ++i)
        if (meets(r, &rays[i], false, &pixel_index))
            count_ray(r, pixel_index, &rays[i]);
}

static void consume_picture(void *self, const lmg_ray *rays, size_t count)
{
    bake_receiver *r = self;
    size_t pixel_index;
    /* A ray's line counts wherever along it the rectangle lies: the picture is of what is behind it as well as before. */
    for (size_t i = 0; i < count; ++i)
        if (dot(rays[i].direction, r->n) > r->cos_cone && meets(r, &rays[i], true, &pixel_index))
            count_ray(r, pixel_index, &rays[i]);
}

/* The bin that direction d, from the centre, lies in; d is a unit vector. */
static bool bin_of(const bake_receiver *r, lmg_vec3 d, size_t *bin)
{
    const bake_sphere *s = &r->sphere;
    const double c = dot(d, r->n);
    const double z = s->equal_angles ? acos(fmin(fmax(c, -1), 1)) / PI * s->rings : 0.5 * (1 - c) * s->rings;
    const double phi = (atan2(dot(d, r->rectangle.b), dot(d, r->rectangle.a)) + PI) / (2 * PI) * s->sectors;
    if (!(z >= 0) || !(phi >= 0))
        return false;
    size_t ring = (size_t)z, sector = (size_t)phi;
    ring = ring < s->rings ? ring : s->rings - 1; /* the pole itself, and rounding beyond it */
    sector = sector < s->sectors ? sector : s->sectors - 1;
    *bin = ring * s->sectors + sector;
    return true;
}

static void consume_sphere(void *self, const lmg_ray *rays, size_t count)
{
    bake_receiver *r = self;
    const bake_sphere *s = &r->sphere;
    for (size_t i = 0; i < count; ++i) {
        lmg_vec3 d = rays[i].direction;
        if (isfinite(s->radius)) {
            /* Where the ray leaves the sphere; lines that pass it by don't count. */
            const lmg_vec3 o = rays[i].origin;
            const lmg_vec3 p = {o.x - s->centre.x, o.y - s->centre.y, o.z - s->centre.z};
            const double along = dot(p, d), inside = s->radius * s->radius - dot(p, p) + along * along;
            if (!(inside >= 0))
                continue;
            const double t = sqrt(inside) - along;
            if (!(t > 0))
                continue;
            const double scale = 1 / s->radius;
            d = (lmg_vec3){(p.x + t * d.x) * scale, (p.y + t * d.y) * scale, (p.z + t * d.z) * scale};
        }
        size_t bin;
        if (bin_of(r, d, &bin))
            count_ray(r, bin, &rays[i]);
    }
}

static lmg_result create(bake_receiver **out, size_t count, bool colour, lmg_error *err)
{
    *out = NULL;
    bake_receiver *r = calloc(1, sizeof(*r));
    if (r)
        r->pixels = calloc(count, sizeof(*r->pixels));
    if (r && colour) {
        r->red = calloc(count, sizeof(*r->red));
        r->blue = calloc(count, sizeof(*r->blue));
    }
    if (!r || !r->pixels || (colour && (!r->red || !r->blue))) {
        bake_receiver_destroy(r);
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
    const lmg_result result = create(out, (size_t)q->nx * q->ny, q->colour, err);
    if (result != LMG_OK)
        return result;
    bake_receiver *r = *out;
    r->consume = consume_rectangle;
    r->rectangle = *q;
    r->n = cross(q->a, q->b);
    r->per_pixel = (double)r->count / (q->width * q->height);
    return LMG_OK;
}

lmg_result bake_picture_create(const bake_picture *p, bake_receiver **out, lmg_error *err)
{
    *out = NULL;
    if (!(p->half_angle > 0) || !(p->half_angle < 0.5 * PI))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a luminance picture needs a cone between 0 and 90 degrees, not %g",
                        p->half_angle * 180 / PI);
    const lmg_result result = bake_illuminance_create(&p->across, out, err);
    if (result != LMG_OK)
        return result;
    bake_receiver *r = *out;
    r->consume = consume_picture;
    r->cos_cone = cos(p->half_angle);
    const double sine = sin(p->half_angle);
    r->per_pixel /= PI * sine * sine;
    return LMG_OK;
}

lmg_result bake_sphere_create(const bake_sphere *s, bake_receiver **out, lmg_error *err)
{
    *out = NULL;
    if (s->rings < 1 || s->sectors < 1 || s->rings > 65535 || s->sectors > 65535 || !(s->radius > 0))
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a sphere of radius %g m with %u x %u bins can't measure", s->radius, s->rings,
                        s->sectors);
    const lmg_result result = create(out, (size_t)s->rings * s->sectors, s->colour, err);
    if (result != LMG_OK)
        return result;
    bake_receiver *r = *out;
    r->consume = consume_sphere;
    r->sphere = *s;
    r->n = s->axis;
    const lmg_vec3 other = fabs(s->axis.x) < 0.5 ? (lmg_vec3){1, 0, 0} : (lmg_vec3){0, 1, 0};
    lmg_vec3 a = cross(other, s->axis);
    const double length = sqrt(dot(a, a));
    r->rectangle.a = (lmg_vec3){a.x / length, a.y / length, a.z / length};
    r->rectangle.b = cross(s->axis, r->rectangle.a);
    return LMG_OK;
}

void bake_receiver_destroy(bake_receiver *r)
{
    if (!r)
        return;
    free(r->pixels);
    free(r->red);
    free(r->blue);
    free(r);
}

lmg_sink bake_receiver_sink(bake_receiver *r)
{
    return (lmg_sink){.self = r, .consume = r->consume};
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

bool bake_receiver_has_colour(const bake_receiver *r)
{
    return r->red != NULL;
}

lmg_vec3 bake_receiver_direction(const bake_receiver *r, double theta, double phi)
{
    const lmg_vec3 a = r->rectangle.a, b = r->rectangle.b, n = r->n;
    const double s = sin(theta), x = s * cos(phi), y = s * sin(phi), z = cos(theta);
    return (lmg_vec3){x * a.x + y * b.x + z * n.x, x * a.y + y * b.y + z * n.y, x * a.z + y * b.z + z * n.z};
}

double bake_receiver_solid_angle(const bake_receiver *r, size_t i)
{
    const bake_sphere *s = &r->sphere;
    if (!s->equal_angles)
        return 4 * PI / (double)r->count;
    const double ring = (double)(i / s->sectors), step = PI / s->rings;
    return 2 * PI / s->sectors * (cos(ring * step) - cos((ring + 1) * step));
}

/* What a unit of a pixel's sum means in the unit of its readings. */
static double unit_of(const bake_receiver *r, size_t i, double lumens_per_unit)
{
    return lumens_per_unit * (r->sphere.rings ? 1 / bake_receiver_solid_angle(r, i) : r->per_pixel);
}

double bake_receiver_reading(const bake_receiver *r, size_t i, double lumens_per_unit, double *standard_error)
{
    const double scale = unit_of(r, i, lumens_per_unit);
    if (standard_error)
        *standard_error = scale * sqrt(squares_of(r, i));
    return scale * sum_of(r, i);
}

void bake_receiver_colour(const bake_receiver *r, size_t i, double lumens_per_unit, double rgb[3])
{
    const double scale = unit_of(r, i, lumens_per_unit) / FIXED;
    const double y = scale * (double)atomic_load_explicit(&r->pixels[i].sum, memory_order_relaxed);
    rgb[0] = scale * (double)atomic_load_explicit(&r->red[i], memory_order_relaxed);
    rgb[2] = scale * (double)atomic_load_explicit(&r->blue[i], memory_order_relaxed);
    rgb[1] = (y - 0.2126 * rgb[0] - 0.0722 * rgb[2]) / 0.7152; /* Y of Rec.709 */
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
