/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The far-field distribution itself (photometry.h): life, checks, keywords, angles and look-up.  Angles stay as the file has them;
 * symmetry is folded at look-up, so nothing is lost or multiplied by reading.
 */
#include "photometry_file.h"

#include "text.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static const double PI = 3.14159265358979323846;
static const double DEGREE = 3.14159265358979323846 / 180;

/* Largest extent of a luminous shape or housing, metres: longer is a wrong unit. */
static const double MAX_EXTENT = 1000;
/* Largest intensity: far above a lighthouse (10^8 cd), far below where sums overflow. */
static const double MAX_INTENSITY = 1e15;

/* ---------------------------------------------------------------------------------------------------------------- life */

lmg_result lum_photometry_create(uint32_t h_count, uint32_t v_count, lum_photometry **out, lmg_error *err)
{
    *out = NULL;
    if (h_count < 1 || v_count < 1 || h_count > LUM_MAX_ANGLES || v_count > LUM_MAX_ANGLES)
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "a distribution of %u x %u angles is outside 1..%d each", h_count, v_count,
                        LUM_MAX_ANGLES);
    lum_photometry *p = calloc(1, sizeof *p);
    if (p) {
        p->h = calloc(h_count, sizeof *p->h);
        p->v = calloc(v_count, sizeof *p->v);
        p->intensity = calloc((size_t)h_count * v_count, sizeof *p->intensity);
    }
    if (!p || !p->h || !p->v || !p->intensity) {
        lum_photometry_destroy(p);
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a distribution of %u x %u angles", h_count, v_count);
    }
    p->type = LUM_TYPE_C;
    p->h_count = h_count;
    p->v_count = v_count;
    p->lamp_set_count = 1;
    p->lamp_sets[0].count = 1;
    p->ballast_factor = 1;
    memcpy(p->unit, "cd", 3);
    *out = p;
    return LMG_OK;
}

void lum_photometry_destroy(lum_photometry *p)
{
    if (!p)
        return;
    for (uint32_t i = 0; i < p->keyword_count; i++) {
        free(p->keywords[i].name);
        free(p->keywords[i].value);
    }
    free(p->keywords);
    free(p->tilt.angles);
    free(p->tilt.factors);
    free(p->h);
    free(p->v);
    free(p->intensity);
    free(p);
}

/* Everything but the grid. */
static lmg_result copy_description(const lum_photometry *p, lum_photometry *to, lmg_error *err)
{
    const lum_photometry grid = *to;
    *to = *p;
    to->type = grid.type;
    to->symmetry = grid.symmetry;
    to->h_count = grid.h_count;
    to->v_count = grid.v_count;
    to->h = grid.h;
    to->v = grid.v;
    to->intensity = grid.intensity;
    to->keyword_count = 0;
    to->keywords = NULL;
    to->tilt.angles = to->tilt.factors = NULL;
    if (p->tilt.count) {
        const size_t bytes = p->tilt.count * sizeof *p->tilt.angles;
        to->tilt.angles = malloc(bytes);
        to->tilt.factors = malloc(bytes);
        if (!to->tilt.angles || !to->tilt.factors)
            return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for a tilt table");
        memcpy(to->tilt.angles, p->tilt.angles, bytes);
        memcpy(to->tilt.factors, p->tilt.factors, bytes);
    }
    for (uint32_t i = 0; i < p->keyword_count; i++)
        LUM_TRY(lum_photometry_add_keyword(to, p->keywords[i].name, p->keywords[i].value, strlen(p->keywords[i].value), err));
    return LMG_OK;
}

lmg_result lum_photometry_copy(const lum_photometry *p, lum_photometry **out, lmg_error *err)
{
    LUM_TRY(lum_photometry_create(p->h_count, p->v_count, out, err));
    lum_photometry *q = *out;
    memcpy(q->h, p->h, p->h_count * sizeof *p->h);
    memcpy(q->v, p->v, p->v_count * sizeof *p->v);
    memcpy(q->intensity, p->intensity, (size_t)p->h_count * p->v_count * sizeof *p->intensity);
    q->type = p->type;
    q->symmetry = p->symmetry;
    const lmg_result result = copy_description(p, q, err);
    if (result != LMG_OK) {
        lum_photometry_destroy(q);
        *out = NULL;
    }
    return result;
}

/* ------------------------------------------------------------------------------------------------------------ keywords */

lmg_result lum_photometry_add_keyword(lum_photometry *p, const char *name, const char *value, size_t length, lmg_error *err)
{
    const char *end = memchr(value, '\n', length);
    length = end ? (size_t)(end - value) : length;
    while (length && (unsigned char)value[0] <= ' ')
        value++, length--;
    while (length && (unsigned char)value[length - 1] <= ' ')
        length--;
    /* Grown by halves at powers of two: files have a few dozen, broken ones thousands. */
    if ((p->keyword_count & (p->keyword_count - 1)) == 0) {
        const size_t capacity = p->keyword_count ? 2 * (size_t)p->keyword_count : 1;
        lum_keyword *grown = realloc(p->keywords, capacity * sizeof *grown);
        if (!grown)
            return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for keywords");
        p->keywords = grown;
    }
    lum_keyword *k = &p->keywords[p->keyword_count];
    k->name = strdup(name);
    k->value = malloc(length + 1);
    if (!k->name || !k->value) {
        free(k->name);
        free(k->value);
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for keywords");
    }
    memcpy(k->value, value, length);
    k->value[length] = 0;
    lum_make_one_line(k->value);
    p->keyword_count++;
    return LMG_OK;
}

const char *lum_photometry_keyword(const lum_photometry *p, const char *name)
{
    for (uint32_t i = 0; i < p->keyword_count; i++)
        if (strcasecmp(p->keywords[i].name, name) == 0)
            return p->keywords[i].value;
    return NULL;
}

lmg_result lum_photometry_set_keyword(lum_photometry *p, const char *name, const char *value, lmg_error *err)
{
    for (uint32_t i = 0; i < p->keyword_count; i++) {
        if (strcasecmp(p->keywords[i].name, name) != 0)
            continue;
        if (value) {
            char *copy = strdup(value);
            if (!copy)
                return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for keywords");
            lum_make_one_line(copy);
            free(p->keywords[i].value);
            p->keywords[i].value = copy;
            return LMG_OK;
        }
        free(p->keywords[i].name);
        free(p->keywords[i].value);
        memmove(p->keywords + i, p->keywords + i + 1, (p->keyword_count - i - 1) * sizeof *p->keywords);
        p->keyword_count--;
        return LMG_OK;
    }
    return value ? lum_photometry_add_keyword(p, name, value, strlen(value), err) : LMG_OK;
}

/* --------------------------------------------------------------------------------------------------------------- check */

static lmg_result check_angles(const double *x, uint32_t n, double least, double most, const char *what, lmg_error *err)
{
    for (uint32_t i = 0; i < n; i++) {
        if (!(x[i] >= least && x[i] <= most))
            return lmg_fail(err, LMG_ERROR_INPUT, "%s angle %u is %g, outside [%g, %g]", what, i + 1, x[i], least, most);
        if (i && !(x[i] > x[i - 1]))
            return lmg_fail(err, LMG_ERROR_INPUT, "%s angle %u (%g) isn't larger than the one before (%g)", what, i + 1, x[i],
                            x[i - 1]);
    }
    return LMG_OK;
}

lmg_result lum_photometry_check(const lum_photometry *p, lmg_error *err)
{
    static const double ranges[][2] = {{0, 360}, {0, 360}, {0, 180}, {-90, 90}, {0, 90}, {0, 180}};
    if (p->type < LUM_TYPE_C || p->type > LUM_TYPE_A)
        return lmg_fail(err, LMG_ERROR_INPUT, "photometric type %d is unknown (1 = C, 2 = B, 3 = A)", (int)p->type);
    if ((int)p->symmetry < 0 || p->symmetry > LUM_SYMMETRY_LATERAL ||
        (p->type == LUM_TYPE_C ? p->symmetry == LUM_SYMMETRY_LATERAL
                               : p->symmetry != LUM_SYMMETRY_NONE && p->symmetry != LUM_SYMMETRY_LATERAL))
        return lmg_fail(err, LMG_ERROR_INPUT, "symmetry %d doesn't go with photometric type %c", (int)p->symmetry, " CBA"[p->type]);
    double least = ranges[p->symmetry][0], most = ranges[p->symmetry][1];
    if (p->type != LUM_TYPE_C) {
        most = p->type == LUM_TYPE_B ? 90 : 180;
        least = p->symmetry == LUM_SYMMETRY_LATERAL ? 0 : -most;
    }
    LUM_TRY(check_angles(p->h, p->h_count, least, most, "horizontal", err));
    LUM_TRY(check_angles(p->v, p->v_count, p->type == LUM_TYPE_C ? 0 : -90, p->type == LUM_TYPE_C ? 180 : 90, "vertical", err));
    if (p->symmetry == LUM_SYMMETRY_AXIAL ? p->h_count != 1 : p->h_count < 2)
        return lmg_fail(err, LMG_ERROR_INPUT, "%u horizontal angles don't go with the symmetry", p->h_count);
    if (p->v_count < 2)
        return lmg_fail(err, LMG_ERROR_INPUT, "one vertical angle alone is no distribution");
    if (p->symmetry >= LUM_SYMMETRY_C0_C180 && p->symmetry <= LUM_SYMMETRY_QUADRANT &&
        (p->h[0] != least || p->h[p->h_count - 1] != most))
        return lmg_fail(err, LMG_ERROR_INPUT, "horizontal angles run from %g to %g; the symmetry wants %g to %g", p->h[0],
                        p->h[p->h_count - 1], least, most);
    for (uint32_t i = 0; i < p->h_count; i++)
        for (uint32_t j = 0; j < p->v_count; j++) {
            const double x = p->intensity[(size_t)i * p->v_count + j];
            if (!(x >= 0 && x <= MAX_INTENSITY))
                return lmg_fail(err, LMG_ERROR_INPUT, "intensity %g at horizontal %g, vertical %g is %s", x, p->h[i], p->v[j],
                                x < 0 ? "negative" : "no usable number");
        }
    const double extents[] = {p->shape.c0, p->shape.c90, p->shape.height, p->housing[0], p->housing[1], p->housing[2]};
    for (int i = 0; i < 6; i++)
        if (!(extents[i] >= 0 && extents[i] <= MAX_EXTENT))
            return lmg_fail(err, LMG_ERROR_INPUT, "an extent of %g m is outside [0, %g]; wrong unit?", extents[i], MAX_EXTENT);
    if ((int)p->shape.kind < 0 || p->shape.kind > LUM_SHAPE_ELLIPSE_FACING_C0)
        return lmg_fail(err, LMG_ERROR_INPUT, "luminous shape %d is unknown", (int)p->shape.kind);
    if (p->lamp_set_count < 1 || p->lamp_set_count > LUM_MAX_LAMP_SETS)
        return lmg_fail(err, LMG_ERROR_INPUT, "%u lamp sets are outside 1..%d", p->lamp_set_count, LUM_MAX_LAMP_SETS);
    for (uint32_t i = 0; i < p->lamp_set_count; i++)
        if (p->lamp_sets[i].count < 1 || !(p->lamp_sets[i].flux >= 0 && p->lamp_sets[i].flux < 1e12))
            return lmg_fail(err, LMG_ERROR_INPUT, "lamp set %u has %d lamps of %g lm", i + 1, p->lamp_sets[i].count,
                            p->lamp_sets[i].flux);
    return LMG_OK;
}

lmg_result lum_photometry_settle_symmetry(lum_photometry *p, lmg_error *err)
{
    const double first = p->h[0], last = p->h[p->h_count - 1];
    const uint32_t n = p->h_count, m = p->v_count;
    if (n == 1) {
        /* One plane stands for all about the axis.  LM-63 has it for type C; type B and A files like it mean the beam's axis. */
        if (p->type == LUM_TYPE_A)
            for (uint32_t j = 0; j < m; j++)
                p->v[j] += 90;
        else if (p->type == LUM_TYPE_B && p->v[0] < 0)
            return lmg_fail(err, LMG_ERROR_INPUT,
                            "type B photometry with one horizontal angle and vertical angles below 0 names no distribution");
        if (p->type != LUM_TYPE_C)
            lum_photometry_warn(p, "type %c with one horizontal angle, taken as symmetric about its axis", " CBA"[p->type]);
        if (p->type == LUM_TYPE_C && first != 0)
            lum_photometry_warn(p, "one plane at %g instead of 0", first);
        p->type = LUM_TYPE_C;
        p->symmetry = LUM_SYMMETRY_AXIAL;
        p->h[0] = 0;
    } else if (p->type != LUM_TYPE_C) {
        p->symmetry = first == 0 ? LUM_SYMMETRY_LATERAL : LUM_SYMMETRY_NONE;
    } else if (first == 0 && last == 90) {
        p->symmetry = LUM_SYMMETRY_QUADRANT;
    } else if (first == 0 && last == 180) {
        p->symmetry = LUM_SYMMETRY_C0_C180;
    } else if (first == -90 && last == 90) {
        p->symmetry = LUM_SYMMETRY_C90_C270;
    } else if (first == 90 && last == 270) {
        /* C -> 180 - C leaves the distribution as it is and turns the order round. */
        p->symmetry = LUM_SYMMETRY_C90_C270;
        for (uint32_t i = 0; i < n / 2; i++) {
            const double h = p->h[i];
            p->h[i] = p->h[n - 1 - i];
            p->h[n - 1 - i] = h;
            for (uint32_t j = 0; j < m; j++) {
                double *a = &p->intensity[(size_t)i * m + j], *b = &p->intensity[(size_t)(n - 1 - i) * m + j], x = *a;
                *a = *b;
                *b = x;
            }
        }
        for (uint32_t i = 0; i < n; i++)
            p->h[i] = 180 - p->h[i];
    } else if (first == 0 && last > 180 && last <= 360) {
        p->symmetry = LUM_SYMMETRY_NONE;
        /* The gap to 360 mustn't be wider than the widest between neighbours, or planes are missing. */
        double widest = 0;
        for (uint32_t i = 1; i < n; i++)
            widest = fmax(widest, p->h[i] - p->h[i - 1]);
        if (360 - last > widest + 1e-6)
            return lmg_fail(err, LMG_ERROR_INPUT, "horizontal angles run from 0 to %g: neither 90, 180 nor the whole circle", last);
    } else {
        return lmg_fail(err, LMG_ERROR_INPUT,
                        "horizontal angles run from %g to %g; type C photometry has 0 alone, 0-90, 0-180, 90-270 or 0-360", first,
                        last);
    }
    return LMG_OK;
}

/* -------------------------------------------------------------------------------------------------------------- angles */

lmg_vec3 lum_direction_from_c_gamma(double c, double gamma)
{
    const double s = sin(gamma * DEGREE);
    return (lmg_vec3){s * cos(c * DEGREE), -cos(gamma * DEGREE), -s * sin(c * DEGREE)};
}

void lum_direction_to_c_gamma(lmg_vec3 d, double *c, double *gamma)
{
    const double across = hypot(d.x, d.z);
    *gamma = atan2(across, -d.y) / DEGREE;
    *c = across > 0 ? atan2(-d.z, d.x) / DEGREE : 0;
    if (*c < 0)
        *c += 360;
    if (*c >= 360) /* -1e-20 rounds up to 360 */
        *c = 0;
}

lmg_vec3 lum_grid_direction(const lum_photometry *p, double h, double v)
{
    if (p->type == LUM_TYPE_B) {
        const double ch = cos(h * DEGREE);
        return (lmg_vec3){ch * sin(v * DEGREE), -ch * cos(v * DEGREE), sin(h * DEGREE)};
    }
    return p->type == LUM_TYPE_A ? lum_direction_from_c_gamma(-h, v + 90) : lum_direction_from_c_gamma(h, v);
}

/* The stored angles that a direction falls on, symmetry folded away. */
static void stored_angles(const lum_photometry *p, lmg_vec3 d, double *h, double *v)
{
    if (p->type == LUM_TYPE_B) {
        *h = atan2(d.z, hypot(d.x, d.y)) / DEGREE;
        *v = atan2(d.x, -d.y) / DEGREE;
    } else {
        lum_direction_to_c_gamma(d, h, v);
        if (p->type == LUM_TYPE_A) {
            *v -= 90;
            *h = *h > 180 ? 360 - *h : -*h;
        }
    }
    switch (p->symmetry) {
    case LUM_SYMMETRY_AXIAL:
        *h = p->h[0];
        break;
    case LUM_SYMMETRY_C0_C180:
        *h = *h > 180 ? 360 - *h : *h;
        break;
    case LUM_SYMMETRY_C90_C270:
        *h = *h > 270 ? *h - 360 : *h > 90 ? 180 - *h : *h;
        break;
    case LUM_SYMMETRY_QUADRANT:
        *h = *h > 180 ? 360 - *h : *h;
        *h = *h > 90 ? 180 - *h : *h;
        break;
    case LUM_SYMMETRY_LATERAL:
        *h = fabs(*h);
        break;
    case LUM_SYMMETRY_NONE:
        break;
    }
}

/* Interval [x[i], x[i+1]] that holds value, and how far in; n >= 2, value within. */
static uint32_t locate(const double *x, uint32_t n, double value, double *t)
{
    uint32_t low = 0, high = n - 1;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (x[middle] <= value)
            low = middle;
        else
            high = middle;
    }
    *t = (value - x[low]) / (x[high] - x[low]);
    return low;
}

/* Directions computed from an angle come back to it within some 1e-14 degrees; a border mustn't turn dark by that. */
static const double BORDER = 1e-9;

double lum_photometry_intensity(const lum_photometry *p, lmg_vec3 direction)
{
    double h, v, t, s = 0;
    stored_angles(p, direction, &h, &v);
    const uint32_t n = p->h_count, m = p->v_count;
    if (!(v >= p->v[0] - BORDER && v <= p->v[m - 1] + BORDER))
        return 0;
    v = fmin(fmax(v, p->v[0]), p->v[m - 1]);
    uint32_t a = 0, b = 0;
    if (n > 1 && h >= p->h[0] && h <= p->h[n - 1]) {
        a = locate(p->h, n, h, &s);
        b = a + 1;
    } else if (n > 1 && p->type == LUM_TYPE_C && p->symmetry == LUM_SYMMETRY_NONE) { /* between the last plane and the first */
        a = n - 1;
        b = 0;
        const double gap = p->h[0] + 360 - p->h[n - 1];
        s = gap > 0 ? (h - p->h[n - 1] + (h < p->h[0] ? 360 : 0)) / gap : 0;
    } else if (n > 1) {
        if (!(h >= p->h[0] - BORDER && h <= p->h[n - 1] + BORDER))
            return 0;
        a = b = h > p->h[0] ? n - 1 : 0;
    }
    const uint32_t j = locate(p->v, m, v, &t);
    const double *ra = p->intensity + (size_t)a * m + j, *rb = p->intensity + (size_t)b * m + j;
    return (1 - s) * ((1 - t) * ra[0] + t * ra[1]) + s * ((1 - t) * rb[0] + t * rb[1]);
}

/* ------------------------------------------------------------------------------------------------------------ the grid */

uint32_t lum_grid_h_cells(const lum_photometry *p)
{
    if (p->symmetry == LUM_SYMMETRY_AXIAL)
        return 1;
    const bool wraps = p->type == LUM_TYPE_C && p->symmetry == LUM_SYMMETRY_NONE && p->h[p->h_count - 1] < p->h[0] + 360;
    return p->h_count - 1 + wraps;
}

void lum_grid_h_cell(const lum_photometry *p, uint32_t i, double *h0, double *h1, uint32_t *plane0, uint32_t *plane1)
{
    if (p->symmetry == LUM_SYMMETRY_AXIAL) {
        *h0 = 0;
        *h1 = 360;
        *plane0 = *plane1 = 0;
        return;
    }
    const bool wrap = i + 1 == p->h_count;
    *plane0 = i;
    *plane1 = wrap ? 0 : i + 1;
    *h0 = p->h[i];
    *h1 = p->h[*plane1] + (wrap ? 360 : 0);
}

double lum_grid_copies(const lum_photometry *p)
{
    switch (p->symmetry) {
    case LUM_SYMMETRY_C0_C180:
    case LUM_SYMMETRY_C90_C270:
    case LUM_SYMMETRY_LATERAL:
        return 2;
    case LUM_SYMMETRY_QUADRANT:
        return 4;
    default:
        return 1;
    }
}

void lum_sine_weights(double x0, double x1, double *w0, double *w1)
{
    const double a = x0 * DEGREE, b = x1 * DEGREE, slope = (sin(b) - sin(a)) / (b - a);
    *w0 = cos(a) - slope;
    *w1 = slope - cos(b);
}

double lum_grid_cell_flux(const lum_photometry *p, uint32_t i, uint32_t j)
{
    double h0, h1, v0 = p->v[j], v1 = p->v[j + 1], wh[2], wv[2];
    uint32_t a, b;
    lum_grid_h_cell(p, i, &h0, &h1, &a, &b);
    if (p->type == LUM_TYPE_B) { /* the pole is the horizontal axis */
        lum_sine_weights(h0 + 90, h1 + 90, &wh[0], &wh[1]);
        wv[0] = wv[1] = 0.5 * (v1 - v0) * DEGREE;
    } else {
        const double from = p->type == LUM_TYPE_A ? 90 : 0;
        lum_sine_weights(v0 + from, v1 + from, &wv[0], &wv[1]);
        wh[0] = wh[1] = 0.5 * (h1 - h0) * DEGREE;
    }
    const double *ra = p->intensity + (size_t)a * p->v_count + j, *rb = p->intensity + (size_t)b * p->v_count + j;
    return fmax(0, wh[0] * (wv[0] * ra[0] + wv[1] * ra[1]) + wh[1] * (wv[0] * rb[0] + wv[1] * rb[1]));
}

/* ------------------------------------------------------------------------------------------------------------ resample */

lmg_result lum_photometry_resample(const lum_photometry *p, uint32_t h_count, uint32_t v_count, lum_photometry **out,
                                   lmg_error *err)
{
    *out = NULL;
    /* The file's own planes, unfolded: each stored angle and its images in [0,360). */
    double *planes = malloc((4 * (size_t)p->h_count + 1) * sizeof *planes); /* and C0, which some formats start with */
    if (!planes)
        return lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for %u planes", p->h_count);
    uint32_t n = 0;
    if (h_count == 0 && p->type == LUM_TYPE_C && p->symmetry != LUM_SYMMETRY_AXIAL) {
        for (int image = 0; image < 4; image++) {
            const bool c0 = p->symmetry == LUM_SYMMETRY_C0_C180 || p->symmetry == LUM_SYMMETRY_QUADRANT;
            const bool c90 = p->symmetry == LUM_SYMMETRY_C90_C270 || p->symmetry == LUM_SYMMETRY_QUADRANT;
            if ((image & 1 && !c0) || (image & 2 && !c90))
                continue;
            for (uint32_t i = 0; i < p->h_count; i++) {
                double h = p->h[i];
                h = image & 1 ? -h : h;
                h = image & 2 ? 180 - h : h;
                planes[n++] = fmod(h + 720, 360);
            }
        }
        planes[n++] = 0;
        for (uint32_t i = 1; i < n; i++) /* insertion: sorted runs already */
            for (uint32_t k = i; k > 0 && planes[k] < planes[k - 1]; k--) {
                const double x = planes[k];
                planes[k] = planes[k - 1];
                planes[k - 1] = x;
            }
        uint32_t kept = 1;
        for (uint32_t i = 1; i < n; i++)
            if (planes[i] > planes[kept - 1] + 1e-9)
                planes[kept++] = planes[i];
        n = kept;
    }
    const bool own_planes = n >= 2, own_angles = v_count == 0 && p->type == LUM_TYPE_C;
    n = own_planes ? n : h_count ? h_count : p->type == LUM_TYPE_C ? 4 : 72;
    const uint32_t m = own_angles ? p->v_count : v_count ? v_count : 181;
    if (n < 2 || m < 2) {
        free(planes);
        return lmg_fail(err, LMG_ERROR_ARGUMENT, "%u planes of %u angles are too few for a distribution", n, m);
    }
    lmg_result result = lum_photometry_create(n, m, out, err);
    lum_photometry *q = *out;
    if (result == LMG_OK) {
        for (uint32_t i = 0; i < n; i++)
            q->h[i] = own_planes ? planes[i] : 360.0 * i / n;
        for (uint32_t j = 0; j < m; j++)
            q->v[j] = own_angles ? p->v[j] : 180.0 * j / (m - 1);
        for (uint32_t i = 0; i < n; i++)
            for (uint32_t j = 0; j < m; j++)
                q->intensity[(size_t)i * m + j] = lum_photometry_intensity(p, lum_direction_from_c_gamma(q->h[i], q->v[j]));
        result = copy_description(p, q, err);
    }
    free(planes);
    if (result != LMG_OK) {
        lum_photometry_destroy(q);
        *out = NULL;
    }
    return result;
}

lmg_vec3 lum_shape_point(const lum_shape *shape, lmg_vec3 d, const double xi[3])
{
    /* x along C0, y up, z along C90-C270: the luminaire frame's axes. */
    const double a = 0.5 * shape->c0, b = 0.5 * shape->height, c = 0.5 * shape->c90;
    const double u = 2 * xi[0] - 1, v = 2 * xi[1] - 1, phi = 2 * PI * xi[0], r = sqrt(xi[1]);
    switch (shape->kind) {
    case LUM_SHAPE_POINT:
        break;
    case LUM_SHAPE_RECTANGLE: /* flat: at most two extents */
        if (b == 0)
            return (lmg_vec3){a * u, 0, c * v};
        return a > 0 ? (lmg_vec3){a * u, b * v, 0} : (lmg_vec3){0, b * v, c * u};
    case LUM_SHAPE_ELLIPSE:
        return (lmg_vec3){a * r * cos(phi), 0, c * r * sin(phi)};
    case LUM_SHAPE_ELLIPSE_FACING_C0:
        return (lmg_vec3){0, b * r * sin(phi), c * r * cos(phi)};
    case LUM_SHAPE_BOX: {
        const double fx = fabs(d.x) * b * c, fy = fabs(d.y) * a * c, fz = fabs(d.z) * a * b, pick = xi[2] * (fx + fy + fz);
        if (pick < fx)
            return (lmg_vec3){copysign(a, d.x), b * u, c * v};
        return pick < fx + fy ? (lmg_vec3){a * u, copysign(b, d.y), c * v} : (lmg_vec3){a * u, b * v, copysign(c, d.z)};
    }
    case LUM_SHAPE_ELLIPSOID: {
        /* On the unit sphere that the ellipsoid is an image of, the projected area is a cosine about A^-1 d. */
        if (!(a > 0 && b > 0 && c > 0))
            break;
        const double e[3] = {d.x / a, d.y / b, d.z / c}, length = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
        const double n[3] = {e[0] / length, e[1] / length, e[2] / length}, s = copysign(1, n[2]), k = -1 / (s + n[2]);
        const double t[3] = {1 + s * n[0] * n[0] * k, s * n[0] * n[1] * k, -s * n[0]}; /* [duff2017frame] */
        const double w[3] = {n[0] * n[1] * k, s + n[1] * n[1] * k, -n[1]};
        const double x = r * cos(phi), y = r * sin(phi), z = sqrt(fmax(0, 1 - xi[1]));
        return (lmg_vec3){a * (x * t[0] + y * w[0] + z * n[0]), b * (x * t[1] + y * w[1] + z * n[1]),
                          c * (x * t[2] + y * w[2] + z * n[2])};
    }
    case LUM_SHAPE_CYLINDER:
    case LUM_SHAPE_CYLINDER_C0:
    case LUM_SHAPE_CYLINDER_C90: {
        /* (p, q): across the axis, w: along it.  The mantle's projected area per angle is r cos(angle - facing), sampled through
         * its sine. */
        const bool up = shape->kind == LUM_SHAPE_CYLINDER, along_x = shape->kind == LUM_SHAPE_CYLINDER_C0;
        const double ep = up ? a : along_x ? b : a, eq = up ? c : along_x ? c : b, half = up ? b : along_x ? a : c;
        const double dp = up ? d.x : along_x ? d.y : d.x, dq = up ? d.z : along_x ? d.z : d.y, dw = up ? d.y : along_x ? d.x : d.z;
        const double caps = PI * ep * eq * fabs(dw), mantle = 4 * half * hypot(eq * dp, ep * dq);
        double p, q, w;
        if (xi[2] * (caps + mantle) < caps) {
            p = ep * r * cos(phi);
            q = eq * r * sin(phi);
            w = copysign(half, dw);
        } else {
            const double angle = atan2(ep * dq, eq * dp) + asin(u);
            p = ep * cos(angle);
            q = eq * sin(angle);
            w = half * v;
        }
        return up ? (lmg_vec3){p, w, q} : along_x ? (lmg_vec3){w, p, q} : (lmg_vec3){p, q, w};
    }
    }
    return (lmg_vec3){0, 0, 0};
}
