/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Cells to half floats and back.  Relies on etendue.c for what a cell weighs.
 *
 * Luminance is rounded to as many bits as its noise leaves meaning, and what that changes goes on to the next cell, weighted by
 * etendue: error diffusion [floyd1976], here along the order of the file.  So sums over many cells keep their values however few
 * photons cells have; to round each to the nearest would shift all cells of one photon the same way.  What is handed on stays among
 * cells whose steps mean about as much flux, so that bright ones don't leave their remainders to dim ones.
 */
#include "cell_code.h"

#include "sampler.h"

#include <stdlib.h>
#include <string.h>

/* Cells are told apart by the exponent of step x etendue, clamped to this range. */
enum { CLASSES = 512, LEAST_EXPONENT = -400 };
/* Significant bits, the leading one included, of weights (a standard error is off by 3 % at most) and of differences, which are
 * noise. */
enum { WEIGHT_BITS = 4, DIFFERENCE_BITS = 3 };
/* A component of a colour is taken to be as noisy as its luminance, relatively, but no less than by this share of the luminance. */
static const double LEAST_COMPONENT = 0.125;
/* Largest half float. */
static const double MOST = 65504;
/* Rounding that loses more than was allowed, by this factor, isn't worth having: light of too many decades for half floats. */
static const double TOLERANCE = 1.5;
static const double RED = 0.2126, GREEN = 0.7152, BLUE = 0.0722;

/* ---------------------------------------------------------------------------------------------------------- half floats */

static float from_half(uint16_t h)
{
    /* the exponent's bias goes from 15 to 127 by a product, which does subnormal numbers too */
    uint32_t bits = (uint32_t)(h & 0x7fff) << 13;
    float x;
    memcpy(&x, &bits, sizeof x);
    x *= 0x1p112F;
    return h & 0x8000 ? -x : x;
}

/* To the nearest, ties to even; |x| at most MOST. */
static uint16_t to_half(double x)
{
    const double size = d_min(fabs(x), MOST);
    int exponent = size > 0 ? ilogb(size) : -15;
    exponent = exponent < -14 ? -14 : exponent;
    /* in units of the last bit; 2048 carries into the exponent by itself */
    const uint32_t units = (uint32_t)rint(ldexp(size, 10 - exponent));
    const uint32_t code = units + (units >= 1024 || exponent > -14 ? (uint32_t)(exponent + 14) * 1024 : 0);
    return (uint16_t)(code | (signbit(x) && code ? 0x8000U : 0));
}

static double keep_bits(double x, int bits)
{
    return x == 0 ? 0 : ldexp(rint(ldexp(x, bits - 1 - ilogb(x))), ilogb(x) - bits + 1);
}

/* ------------------------------------------------------------------------------------------------------------- decoding */

double *lmg_code_scales(const lmg_slab *slab, double unit)
{
    double *scales = calloc((size_t)slab->ns * slab->nt, sizeof *scales), *to = scales;
    const bool slopes = slab->kind == LMG_SLAB_CUBE && isinf(slab->distance);
    for (uint32_t it = 0; scales && it < slab->nt; it++)
        for (uint32_t is = 0; is < slab->ns; is++) {
            const double s = slab->s0 + (slab->s1 - slab->s0) * (is + 0.5) / slab->ns,
                         t = slab->t0 + (slab->t1 - slab->t0) * (it + 0.5) / slab->nt;
            const double w = slopes ? 1 + s * s + t * t : 1;
            *to++ = unit * (w * w);
        }
    return scales;
}

/* Bytes in a file needn't be aligned. */
static inline uint16_t code_at(const unsigned char *line, size_t i)
{
    uint16_t code;
    memcpy(&code, line + i * sizeof code, sizeof code);
    return code;
}

bool lmg_decode_line(const unsigned char *line, uint32_t n, uint32_t channels, const double *scales, float *radiance,
                     float *standard_error, float *half_a)
{
    const size_t y_at = channels == 3 ? 2 * (size_t)n : 0;
    bool sound = true;
    for (size_t i = 0; i < n; i++) {
        const uint16_t y = code_at(line, y_at + i), difference = code_at(line, y_at + n + i),
                       weight = code_at(line, y_at + 2 * (size_t)n + i);
        sound &= y < 0x7c00 && weight < 0x7c00 && (difference & 0x7c00) != 0x7c00;
        const double photons = (double)from_half(y), luminance = photons * scales[i];
        standard_error[i] = (float)(sqrt((double)from_half(weight) * photons) * scales[i]);
        half_a[i] = (float)(luminance * (1 + (double)from_half(difference)));
        if (channels == 1) {
            radiance[2 * i] = (float)luminance;
            continue;
        }
        const uint16_t by = code_at(line, i), ry = code_at(line, n + i);
        sound &= (ry & 0x7c00) != 0x7c00 && (by & 0x7c00) != 0x7c00;
        const double red = luminance * (1 + (double)from_half(ry)), blue = luminance * (1 + (double)from_half(by));
        radiance[4 * i] = (float)red;
        radiance[4 * i + 1] = (float)((luminance - RED * red - BLUE * blue) / GREEN);
        radiance[4 * i + 2] = (float)blue;
    }
    return sound;
}

/* ------------------------------------------------------------------------------------------------------------- encoding */

/* What is handed on within a class: radiance x etendue. */
typedef struct leftover {
    double luminance, red, blue;
} leftover;

typedef struct encoder {
    const lmg_field *field;
    double loss;
    leftover leftovers[CLASSES];
    double squares, half_squares, cells; /* of errors over noise */
} encoder;

/* The step of numbers with so much noise: what is handed on and what is left of it are both even over a step, so the error's RMS is
 * step / sqrt(6). */
static double step_of(double loss, double noise)
{
    return noise > 0 ? ldexp(1, ilogb(loss * noise * 2.449489742783178)) : 0;
}

/* The code nearest to x, of those that are multiples of the step. */
static uint16_t code_of(double x, double step)
{
    return to_half(step > 0 ? step * rint(x / step) : x);
}

static leftover *leftover_of(encoder *e, double x)
{
    const int exponent = (x > 0 ? ilogb(x) : 0) - LEAST_EXPONENT;
    return &e->leftovers[exponent < 0 ? 0 : exponent >= CLASSES ? CLASSES - 1 : exponent];
}

/* Codes of one cell that has light, n cells of a line apart; scale: what code 1 means, etendue its own.  Gives the luminance that
 * results. */
static double encode_cell(encoder *e, uint32_t j, uint64_t cell, double scale, double etendue, uint16_t *codes, uint32_t n)
{
    const lmg_slab_data *data = &e->field->slabs[j];
    const double y = lmg_cell_luminance(e->field, j, cell), noise = (double)data->standard_error[cell],
                 step = step_of(e->loss, noise / scale);
    leftover *rest = leftover_of(e, (step > 0 ? step : y / scale * 0x1p-11) * scale * etendue);
    const bool coloured = e->field->layout.channels == 3;
    const double weight = etendue > 0 ? 1 / etendue : 0, wanted = y + weight * rest->luminance;
    uint16_t *code = codes + (coloured ? 2 * (size_t)n : 0);
    *code = code_of(d_clamp(wanted / scale, 0, MOST), step);
    const double photons = (double)from_half(*code), result = photons * scale;
    rest->luminance = (wanted - result) * etendue;
    if (noise > 0) {
        e->squares += (result - y) * (result - y) / (noise * noise);
        e->cells += 1;
    }
    for (int c = 0; coloured && c < 2; c++) { /* blue, red; with what was handed on luminance and colour belong together */
        double *carried = c ? &rest->red : &rest->blue;
        const double component = (double)lmg_cell_radiance(data, cell)[c ? 0 : 2] + weight * *carried;
        if (*code) {
            const double chroma = component / wanted - 1,
                         fine = step_of(e->loss, noise / y * d_max(fabs(1 + chroma), LEAST_COMPONENT));
            codes[(size_t)c * n] = code_of(chroma, fine);
        }
        *carried = etendue * (component - (*code ? result * (1 + (double)from_half(codes[(size_t)c * n])) : 0));
    }
    if (*code == 0)
        return 0;
    const double difference = (double)data->half_a[cell] / y - 1;
    code[n] = to_half(keep_bits(difference, DIFFERENCE_BITS));
    code[2 * (size_t)n] = to_half(keep_bits(noise * noise / (result * scale), WEIGHT_BITS));
    if (noise > 0) {
        const double error = (double)from_half(code[n]) * result - difference * y;
        e->half_squares += error * error / (noise * noise);
    }
    return result;
}

/* Whether codes can tell a cell: light has a positive luminance, no light has nothing else either. */
static bool is_possible(const lmg_field *field, uint32_t j, uint64_t cell, double y)
{
    const lmg_slab_data *data = &field->slabs[j];
    bool dark = data->standard_error[cell] == 0 && data->half_a[cell] == 0;
    for (uint32_t c = 0; c < field->layout.channels; c++)
        dark = dark && lmg_cell_radiance(data, cell)[c] == 0;
    return y > 0 || (y == 0 && dark);
}

/* Codes of a whole tile.  A cell without light says what the one before it said, which packs best: only its Y counts. */
static void encode_tile(encoder *e, uint32_t j, uint64_t first, const double *scales, const double *etendues, uint16_t *codes,
                        double flux[2])
{
    const lmg_slab *slab = &e->field->layout.slabs[j];
    const uint32_t n = slab->ns, count = e->field->layout.channels + 2, y_at = count - 3;
    uint16_t last[5] = {0};
    for (uint32_t st = 0; st < n * slab->nt; st++) {
        uint16_t *code = codes + (size_t)(st / n) * n * count + st % n;
        const double y = lmg_cell_luminance(e->field, j, first + st),
                     result = y > 0 ? encode_cell(e, j, first + st, scales[st], etendues[st], code, n) : 0;
        flux[0] += y * etendues[st];
        flux[1] += result * etendues[st];
        for (uint32_t c = 0; c < count; c++) {
            uint16_t *to = &code[(size_t)c * n];
            if (result > 0)
                last[c] = *to;
            else
                *to = c == y_at ? 0 : last[c];
        }
    }
}

typedef struct lit_cells {
    const lmg_field *field;
    uint32_t j;
} lit_cells;

static bool is_lit(const void *self, uint64_t cell)
{
    const lit_cells *lit = self;
    return lmg_cell_luminance(lit->field, lit->j, cell) > 0;
}

/* What one photon makes of a cell, on average; enough for the brightest cell to fit. */
static double unit_of(const lmg_field *field, uint32_t j, const double *shapes)
{
    const lmg_slab_data *data = &field->slabs[j];
    const uint64_t tile =
        lmg_slab_cells(&field->layout.slabs[j]) / ((uint64_t)field->layout.slabs[j].nu * field->layout.slabs[j].nv);
    double most = 0, squares = 0, sum = 0;
    for (uint64_t cell = 0; cell < data->cells; cell++) {
        const double y = lmg_cell_luminance(field, j, cell) / shapes[cell % tile],
                     noise = (double)data->standard_error[cell] / shapes[cell % tile];
        most = y > most ? y : most;
        squares += noise * noise;
        sum += y;
    }
    return most > 0 ? fmax(squares / sum, most / MOST) : 1;
}

static lmg_result encode_slab(encoder *e, lmg_codes *codes, uint32_t j, bool *possible, lmg_error *err)
{
    const lmg_field *field = e->field;
    const lmg_slab *slab = &field->layout.slabs[j];
    const lmg_slab_data *data = &field->slabs[j];
    const uint32_t tile = slab->ns * slab->nt, count = field->layout.channels + 2;
    for (uint64_t cell = 0; cell < data->cells && *possible; cell++)
        *possible = is_possible(field, j, cell, lmg_cell_luminance(field, j, cell));
    if (!*possible)
        return LMG_OK;
    const lit_cells lit = {field, j};
    lmg_etendue etendue;
    lmg_result result = lmg_etendue_prepare(&etendue, &field->layout, j, err);
    if (result == LMG_OK)
        result = lmg_etendue_share(&etendue, is_lit, &lit, err);
    codes->of[j] = calloc((size_t)data->cells * count, sizeof *codes->of[j]);
    double *scales = lmg_code_scales(slab, 1), *etendues = calloc(tile, sizeof *etendues), flux[2] = {0};
    if (result == LMG_OK && (!codes->of[j] || !scales || !etendues))
        result = lmg_fail(err, LMG_ERROR_MEMORY, "no memory for rounding %.1f million cells", 1e-6 * (double)data->cells);
    if (result == LMG_OK) {
        const double unit = unit_of(field, j, scales);
        free(scales);
        scales = lmg_code_scales(slab, unit);
        codes->units[j] = unit;
        if (!scales)
            result = lmg_fail(err, LMG_ERROR_MEMORY, "no memory for rounding");
    }
    memset(e->leftovers, 0, sizeof e->leftovers);
    uint64_t first = 0;
    for (uint32_t iv = 0; result == LMG_OK && iv < slab->nv; iv++)
        for (uint32_t iu = 0; iu < slab->nu; iu++, first += tile) {
            for (uint32_t st = 0; st < tile; st++)
                etendues[st] = is_lit(&lit, first + st) ? lmg_etendue_effective(&etendue, iu, iv, st % slab->ns, st / slab->ns) : 0;
            encode_tile(e, j, first, scales, etendues, codes->of[j] + first * count, flux);
        }
    /* what wasn't handed on to anybody: the flux stays what it was */
    if (result == LMG_OK && flux[1] > 0)
        codes->units[j] *= flux[0] / flux[1];
    *possible = *possible && (flux[1] > 0) == (flux[0] > 0);
    free(scales);
    free(etendues);
    lmg_etendue_release(&etendue);
    return result;
}

lmg_result lmg_codes_create(lmg_codes *codes, const lmg_field *field, double loss, bool *possible, lmg_error *err)
{
    memset(codes, 0, sizeof *codes);
    encoder *e = calloc(1, sizeof *e);
    if (!e)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for rounding");
    e->field = field;
    e->loss = loss;
    lmg_result result = LMG_OK;
    *possible = true;
    for (uint32_t j = 0; result == LMG_OK && *possible && j < field->layout.slab_count; j++)
        result = encode_slab(e, codes, j, possible, err);
    if (e->cells > 0)
        codes->rounding = (lmg_rounding){sqrt(e->squares / e->cells), sqrt(e->half_squares / e->cells)};
    free(e);
    *possible = *possible && codes->rounding.loss <= TOLERANCE * loss && codes->rounding.half_loss <= TOLERANCE * loss;
    if (result != LMG_OK || !*possible)
        lmg_codes_destroy(codes);
    return result;
}

void lmg_codes_destroy(lmg_codes *codes)
{
    for (uint32_t j = 0; j < LMG_MAX_SLABS; j++)
        free(codes->of[j]);
    memset(codes, 0, sizeof *codes);
}
