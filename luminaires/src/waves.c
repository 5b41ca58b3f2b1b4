/* SPDX-License-Identifier: Apache-2.0 */
/* Light by wavelength (waves.h).  Relies on luminaires/spectrum.h for spectra and colours. */
#include <luminaires/waves.h>

#include <luminaires/scatter.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Powers of y, x, z in the importance. */
static const double FOR_Y = 0.5, FOR_X = 0.2, FOR_Z = 0.3;

/* -------------------------------------------------------------------------------------------------------------- tables */

static bool varies(const lum_spectrum *s)
{
    for (int i = 1; s && i < LUM_SPECTRUM_COUNT; ++i)
        if (s->value[i] != s->value[0])
            return true;
    return false;
}

static bool spreads(const lum_material *m)
{
    return lum_material_is_solid(m) && varies(m->spectral.index);
}

bool lum_model_is_spectral(const lum_model *model)
{
    bool emission = false, metal = false;
    for (uint32_t i = 0; i < model->material_count; ++i) {
        const lum_material *m = &model->materials[i];
        const lum_spectral *s = &m->spectral;
        if (spreads(m) || s->converted || s->reflectance || s->transmittance || s->absorption || s->scattering)
            return true;
        emission |= s->emission && s->measured;
        metal |= s->eta && s->k;
    }
    /* A metal by name is spectral where a light is. */
    return emission && metal;
}

static double grid_weight(int i)
{
    return i == 0 || i == LUM_SPECTRUM_COUNT - 1 ? 0.5 : 1;
}

/* Integral of a times b (NULL: 1) by the trapezoidal rule on the grid. */
static double integral(const lum_spectrum *a, const lum_spectrum *b)
{
    double sum = 0;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
        sum += grid_weight(i) * (double)a->value[i] * (b ? (double)b->value[i] : 1);
    return sum;
}

/* Light to draw from: its luminance per nm, and wavelengths in equal steps of importance.  Between knots wavelengths are spread
 * evenly, which is a density of its own and makes weights exact whatever the knots. */
static void make_light(const lum_wave_tables *spectral, const lum_spectrum *power, lum_wave_light *light)
{
    enum { KNOTS = LUM_WAVES * LUM_WAVE_KNOTS };
    double nm_power = 0;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        double o[3];
        lum_observer(LUM_NM_FIRST + i, o);
        light->luminance.value[i] = (float)((double)power->value[i] * o[1]);
        nm_power += grid_weight(i) * (double)power->value[i] * (LUM_NM_FIRST + i);
    }
    const double luminance = integral(&light->luminance, NULL), watts = integral(power, NULL);
    light->efficacy = 683 * luminance / watts;
    light->mean_nm = nm_power / watts;
    double sum[LUM_SPECTRUM_COUNT];
    sum[0] = 0;
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        light->luminance.value[i] = (float)((double)light->luminance.value[i] / luminance);
        if (i > 0) {
            double step = 0;
            for (int k = i - 1; k <= i; ++k)
                step += 0.5 * (double)light->luminance.value[k] * (double)spectral->importance.value[k];
            sum[i] = sum[i - 1] + step;
        }
    }
    const double total = sum[LUM_SPECTRUM_COUNT - 1];
    int at = 0;
    for (int k = 0; k <= KNOTS; ++k) {
        const double aim = total * k / KNOTS;
        while (at < LUM_SPECTRUM_COUNT - 2 && (sum[at + 1] < aim || (k == 0 && !(sum[at + 1] > 0))))
            ++at;
        const double step = sum[at + 1] - sum[at];
        const double f = step > 0 ? fmin(fmax((aim - sum[at]) / step, 0), 1) : 1;
        light->knots[k] = (float)(LUM_NM_FIRST + at + f);
    }
}

static void make_observer_tables(lum_wave_tables *s, const lum_model *model)
{
    lum_spectrum white;
    double xyz[3];
    lum_spectrum_illuminant("D65", &white);
    lum_spectrum_xyz(&white, xyz);
    for (int c = 0; c < 3; ++c)
        s->white_rgb[c] = 0;
    double rgb[3];
    lum_xyz_to_rgb(xyz, rgb);
    for (int c = 0; c < 3; ++c)
        s->white_rgb[c] = rgb[c] / xyz[1];
    for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
        const double nm = LUM_NM_FIRST + i;
        double o[3], basis[3];
        lum_observer(nm, o);
        lum_colour_basis(nm, basis);
        const double unit[3] = {o[0] / o[1], 1, o[2] / o[1]};
        lum_xyz_to_rgb(o, rgb);
        s->observer.value[i] = (float)o[1];
        for (int c = 0; c < 3; ++c) {
            s->basis[c].value[i] = (float)basis[c];
            s->colour[c].value[i] = (float)rgb[c];
        }
        s->importance.value[i] = (float)(FOR_Y + FOR_X * unit[0] * xyz[1] / xyz[0] + FOR_Z * unit[2] * xyz[1] / xyz[2]);
    }
    /* What phosphors make of a wavelength counts as the luminance that it becomes. */
    for (uint32_t m = 0; m < model->material_count; ++m) {
        const lum_spectral *p = &model->materials[m].spectral;
        if (!p->converted)
            continue;
        double mean = 0, watts = integral(p->converted, NULL);
        for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
            mean += grid_weight(i) * (double)p->converted->value[i] * (LUM_NM_FIRST + i) / watts;
        const double efficacy = lum_spectrum_efficacy(p->converted), most = p->fills ? lum_spectrum_peak(p->excitation) : 1;
        for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
            double o[3];
            const double nm = LUM_NM_FIRST + i;
            lum_observer(nm, o);
            const double taken = most > 0 ? (double)p->excitation->value[i] / most : 0;
            const double gain = taken * (double)p->quantum_yield * nm / mean * efficacy / (683 * o[1]);
            s->importance.value[i] = (float)fmax((double)s->importance.value[i], gain);
        }
    }
}

static lmg_result make_phosphor(lum_wave_tables *s, const lum_material *m, lum_phosphor **out, lmg_error *err)
{
    lum_phosphor *p = *out = calloc(1, sizeof *p);
    if (!p)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for spectra");
    p->excitation = m->spectral.excitation;
    p->forward = (double)m->spectral.forward;
    make_light(s, m->spectral.converted, &p->light);
    p->importance = integral(&p->light.luminance, &s->importance);
    /* Watts absorbed per lumen, 1 / (683 y); photons keep their number but for the yield, so watts shrink by nm / mean_nm. */
    p->gain = (double)m->spectral.quantum_yield / p->light.mean_nm * p->light.efficacy / 683;
    return LMG_OK;
}

static lmg_result make_material(lum_wave_tables *s, const lum_material *m, lum_wave_material *out, lmg_error *err)
{
    const lum_spectral *from = &m->spectral;
    out->index = spreads(m) ? from->index : NULL;
    out->refracts = out->index != NULL;
    out->absorption = from->absorption;
    memcpy(out->rgb_reflectance, m->base_color, sizeof out->rgb_reflectance);
    out->scattering = from->scattering;
    if (from->converted && (!from->fills || lum_material_is_solid(m))) {
        const lmg_result result = make_phosphor(s, m, from->fills ? &out->filling : &out->phosphor, err);
        if (result)
            return result;
    }
    if (m->kind == LUM_SURFACE_CONDUCTOR && from->eta && from->k) {
        out->tint = LUM_TINT_CONDUCTOR;
        for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i)
            out->reflectance.value[i] = (float)lum_fresnel_conductor(1, (double)from->eta->value[i], (double)from->k->value[i]);
        for (int c = 0; c < 3; ++c)
            out->rgb_reflectance[c] = (float)lum_fresnel_conductor(1, (double)m->eta[c], (double)m->k[c]);
    } else if (m->kind == LUM_SURFACE_CONDUCTOR && from->reflectance) {
        out->tint = LUM_TINT_MIRROR;
        for (int c = 1; c < 3; ++c)
            out->brightest = m->base_color[c] > m->base_color[out->brightest] ? c : out->brightest;
        out->reflectance = *from->reflectance;
    } else if (from->reflectance || from->transmittance) {
        /* Scattering chooses the far side with the chance d. */
        const double d = (double)m->diffuse_transmission;
        out->tint = LUM_TINT_DIFFUSE;
        for (int i = 0; i < LUM_SPECTRUM_COUNT; ++i) {
            out->reflectance.value[i] = from->reflectance && d < 1 ? (float)((double)from->reflectance->value[i] / (1 - d)) : 0;
            out->transmittance.value[i] = from->transmittance && d > 0 ? (float)((double)from->transmittance->value[i] / d) : 0;
        }
    }
    if (from->emission) {
        out->emission = malloc(sizeof *out->emission);
        if (!out->emission)
            return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for spectra");
        make_light(s, from->emission, out->emission);
    }
    return LMG_OK;
}

lmg_result lum_wave_tables_create(const lum_model *model, lum_wave_tables **out, lmg_error *err)
{
    lum_spectrum white;
    *out = NULL;
    lum_wave_tables *s = calloc(1, sizeof *s);
    if (s)
        s->materials = calloc((size_t)model->material_count + 1, sizeof *s->materials);
    lmg_result result = s && s->materials ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for spectra");
    if (!result) {
        s->material_count = model->material_count;
        make_observer_tables(s, model);
        lum_spectrum_illuminant("D65", &white);
        make_light(s, &white, &s->white);
    }
    for (uint32_t i = 0; i < model->material_count && !result; ++i)
        result = make_material(s, &model->materials[i], &s->materials[i], err);
    if (result) {
        lum_wave_tables_destroy(s);
        return result;
    }
    *out = s;
    return LMG_OK;
}

void lum_wave_tables_destroy(lum_wave_tables *spectral)
{
    if (!spectral)
        return;
    for (uint32_t i = 0; spectral->materials && i < spectral->material_count; ++i) {
        free(spectral->materials[i].emission);
        free(spectral->materials[i].phosphor);
        free(spectral->materials[i].filling);
    }
    free(spectral->materials);
    free(spectral);
}

/* ------------------------------------------------------------------------------------------------------------- drawing */

/* Wavelengths at the same place of each eighth of the light's importance, and how many nm each stands for. */
static void draw(const lum_wave_light *light, double u, lum_waves *out, double stands_for[LUM_WAVES])
{
    const double x = u * LUM_WAVE_KNOTS;
    int k = (int)x;
    k = k < LUM_WAVE_KNOTS ? k : LUM_WAVE_KNOTS - 1;
    const double f = x - k;
    out->count = LUM_WAVES;
    for (int i = 0; i < LUM_WAVES; ++i) {
        const float *knot = &light->knots[i * LUM_WAVE_KNOTS + k];
        const double step = (double)knot[1] - (double)knot[0];
        out->nm[i] = (float)((double)knot[0] + f * step);
        stands_for[i] = step * LUM_WAVE_KNOTS;
    }
}

/* Shares of 1 from luminances; returns their sum. */
static double normalize(const lum_wave_tables *spectral, const double luminance[LUM_WAVES], lum_waves *out)
{
    double sum = 0;
    for (int i = 0; i < LUM_WAVES; ++i)
        sum += luminance[i];
    if (!(sum > 0))
        return 0;
    for (int i = 0; i < LUM_WAVES; ++i) {
        out->share[i] = (float)(luminance[i] / sum);
        out->importance[i] = (float)lum_spectrum_at(&spectral->importance, (double)out->nm[i]);
    }
    return sum;
}

double lum_waves_draw(const lum_wave_tables *spectral, const lum_wave_light *light, double u, lum_waves *out)
{
    double luminance[LUM_WAVES];
    draw(light, u, out, luminance);
    for (int i = 0; i < LUM_WAVES; ++i)
        luminance[i] *= lum_spectrum_at(&light->luminance, (double)out->nm[i]);
    return normalize(spectral, luminance, out);
}

double lum_waves_emit(const lum_wave_tables *spectral, int32_t material, const float rgb[3], double u, lum_waves *out)
{
    if (material >= 0 && spectral->materials[material].emission)
        return lum_waves_draw(spectral, spectral->materials[material].emission, u, out);
    double luminance[LUM_WAVES];
    draw(&spectral->white, u, out, luminance);
    for (int i = 0; i < LUM_WAVES; ++i) {
        const double nm = (double)out->nm[i];
        double colour = 0;
        for (int c = 0; c < 3; ++c)
            colour += (double)rgb[c] / spectral->white_rgb[c] * lum_spectrum_at(&spectral->basis[c], nm);
        luminance[i] *= lum_spectrum_at(&spectral->white.luminance, nm) * colour;
    }
    return normalize(spectral, luminance, out);
}

static void over_white(const lum_wave_tables *tables, const lum_wave_light *light, double luminance, const lum_waves *waves,
                       double out[LUM_WAVES])
{
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double nm = (double)waves->nm[i];
        out[i] = luminance * lum_spectrum_at(&light->luminance, nm) / lum_spectrum_at(&tables->white.luminance, nm);
    }
}

void lum_waves_lit(const lum_wave_tables *tables, int32_t material, const float rgb[3], const lum_waves *waves,
                   double light[LUM_WAVES])
{
    if (material >= 0 && tables->materials[material].emission) {
        over_white(tables, tables->materials[material].emission, lmg_luminance(rgb), waves, light);
        return;
    }
    for (uint32_t i = 0; i < waves->count; ++i) {
        light[i] = 0;
        for (int c = 0; c < 3; ++c)
            light[i] += (double)rgb[c] / tables->white_rgb[c] * lum_spectrum_at(&tables->basis[c], (double)waves->nm[i]);
    }
}

void lum_waves_converted(const lum_wave_tables *tables, const lum_phosphor *phosphor, const lum_waves *waves,
                         double light[LUM_WAVES])
{
    over_white(tables, &phosphor->light, 1, waves, light);
}

void lum_wave_rgb(const lum_wave_tables *tables, double nm, double rgb[3])
{
    /* Colour over y: the quotient itself is too curved to be taken as linear within a nanometre. */
    const double y = lum_spectrum_at(&tables->observer, nm);
    for (int c = 0; c < 3; ++c)
        rgb[c] = lum_spectrum_at(&tables->colour[c], nm) / y;
}

void lum_waves_rgb(const lum_wave_tables *spectral, const lum_waves *waves, double rgb[3])
{
    rgb[0] = rgb[1] = rgb[2] = 0;
    for (uint32_t i = 0; i < waves->count; ++i) {
        /* Colour over y: the quotient itself is too curved to be taken as linear within a nanometre. */
        const double nm = (double)waves->nm[i], share = (double)waves->share[i] / lum_spectrum_at(&spectral->observer, nm);
        for (int c = 0; c < 3; ++c)
            rgb[c] += share * lum_spectrum_at(&spectral->colour[c], nm);
    }
}

/* -------------------------------------------------------------------------------------------------------------- events */

/* A reflectance r by wavelength that scattering took as g in R,G,B, of which it left w.  Light scattered more than once on a rough
 * surface loses more: w = g^2 (1 - l) / (1 - g l), l the share of facets' light that meets another one. */
static double repeated(double r, double g, double w)
{
    if (w == g || !(g > 0) || g == 1)
        return r;
    const double l = (g * g - w) / (g * (g - w));
    return r * r * (1 - l) / (1 - r * l);
}

/* Linear between what is known at 465, 550 and 610 nm (lum_metal). */
static double between(const float rgb[3], double nm)
{
    const double r = (double)rgb[0], g = (double)rgb[1], b = (double)rgb[2];
    return nm <= 465 ? b : nm <= 550 ? b + (nm - 465) / 85 * (g - b) : nm <= 610 ? g + (nm - 550) / 60 * (r - g) : r;
}

void lum_waves_scattered(const lum_wave_tables *spectral, int32_t material, bool reflected, const float rgb[3], const lum_waves *waves,
                          float share[LUM_WAVES])
{
    const lum_wave_material *m = &spectral->materials[material];
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double nm = (double)waves->nm[i];
        switch (m->tint) {
        case LUM_TINT_DIFFUSE:
            share[i] = (float)lum_spectrum_at(reflected ? &m->reflectance : &m->transmittance, nm);
            break;
        case LUM_TINT_MIRROR:
            share[i] = (float)repeated(lum_spectrum_at(&m->reflectance, nm), (double)m->rgb_reflectance[m->brightest],
                                       (double)rgb[m->brightest]);
            break;
        case LUM_TINT_CONDUCTOR: {
            /* Exact at normal incidence at all wavelengths, and at all angles at three; between, absorptances scale alike. */
            const double known = 1 - between(m->rgb_reflectance, nm), here = 1 - lum_spectrum_at(&m->reflectance, nm);
            const double left = 1 - (1 - between(rgb, nm)) * (known > 0 ? here / known : 1);
            share[i] = left > 0 ? (float)left : 0;
            break;
        }
        case LUM_TINT_RGB:
        default:
            share[i] = rgb[1];
            if (rgb[0] != rgb[1] || rgb[2] != rgb[1])
                share[i] += (float)((double)(rgb[0] - rgb[1]) * lum_spectrum_at(&spectral->basis[0], nm) +
                                    (double)(rgb[2] - rgb[1]) * lum_spectrum_at(&spectral->basis[2], nm));
            break;
        }
    }
}

/* Coefficients in R,G,B stand for a spectrum. */
static double coefficient(const lum_wave_tables *spectral, const lum_spectrum *known, const double rgb[3], double nm)
{
    if (known)
        return lum_spectrum_at(known, nm);
    double sum = 0;
    for (int c = 0; c < 3; ++c)
        sum += rgb[c] * lum_spectrum_at(&spectral->basis[c], nm);
    return sum;
}

double lum_waves_scattering(const lum_wave_tables *spectral, int32_t material, const lum_medium *medium, double nm)
{
    return coefficient(spectral, spectral->materials[material].scattering, medium->scattering, nm);
}

void lum_waves_absorbed(const lum_wave_tables *spectral, int32_t material, const double absorption[3], double length,
                         const lum_waves *waves, float share[LUM_WAVES])
{
    const lum_wave_material *m = &spectral->materials[material];
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double nm = (double)waves->nm[i];
        double a = coefficient(spectral, m->absorption, absorption, nm);
        if (m->filling)
            a += lum_spectrum_at(m->filling->excitation, nm);
        share[i] = (float)exp(-a * length);
    }
}

bool lum_waves_fly(const lum_wave_tables *spectral, int32_t material, const lum_medium *medium, double length, lum_rng *rng, const lum_waves *waves,
                    float share[LUM_WAVES], double taken[LUM_WAVES], double *t)
{
    const lum_wave_material *m = &spectral->materials[material];
    double scattering[LUM_WAVES], excitation[LUM_WAVES], extinction[LUM_WAVES], chance[LUM_WAVES], all = 0;
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double nm = (double)waves->nm[i];
        scattering[i] = coefficient(spectral, m->scattering, medium->scattering, nm);
        excitation[i] = m->filling ? lum_spectrum_at(m->filling->excitation, nm) : 0;
        if (m->absorption || m->scattering) {
            double absorption[3]; /* of the R,G,B coefficients */
            for (int c = 0; c < 3; ++c)
                absorption[c] = medium->extinction[c] - medium->scattering[c];
            extinction[i] = scattering[i] + coefficient(spectral, m->absorption, absorption, nm);
        } else {
            extinction[i] = coefficient(spectral, NULL, medium->extinction, nm);
        }
        extinction[i] += excitation[i];
        chance[i] = (double)waves->share[i] * (double)waves->importance[i];
        all += chance[i];
    }
    double u = lum_rng_next(rng) * all;
    uint32_t chosen = 0;
    while (chosen + 1 < waves->count && u >= chance[chosen])
        u -= chance[chosen++];
    *t = extinction[chosen] > 0 ? -log1p(-lum_rng_next(rng)) / extinction[chosen] : (double)INFINITY;
    const bool passes = !(*t < length);
    double density = 0, reach[LUM_WAVES];
    for (uint32_t i = 0; i < waves->count; ++i) {
        reach[i] = extinction[i] > 0 ? exp(-extinction[i] * (passes ? length : *t)) : 1;
        density += chance[i] / all * reach[i] * (passes ? 1 : extinction[i]);
    }
    for (uint32_t i = 0; i < waves->count; ++i)
        share[i] = density > 0 ? (float)(reach[i] * (passes ? 1 : scattering[i]) / density) : 0;
    for (uint32_t i = 0; taken && i < waves->count; ++i)
        taken[i] = density > 0 && !passes ? reach[i] * excitation[i] / density : 0;
    return passes;
}

void lum_waves_colours(const lum_wave_tables *spectral, const lum_waves *waves, double colours[3])
{
    double all = 0;
    colours[0] = colours[1] = colours[2] = 0;
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double importance = (double)waves->share[i] * (double)waves->importance[i];
        all += importance;
        for (int c = 0; c < 3; ++c)
            colours[c] += importance * lum_spectrum_at(&spectral->basis[c], (double)waves->nm[i]);
    }
    for (int c = 0; c < 3; ++c)
        colours[c] /= all;
}

void lum_waves_factors(const lum_wave_tables *spectral, const double factor[3], const lum_waves *waves, float share[LUM_WAVES])
{
    for (uint32_t i = 0; i < waves->count; ++i) {
        double sum = 0;
        for (int c = 0; c < 3; ++c)
            sum += factor[c] * lum_spectrum_at(&spectral->basis[c], (double)waves->nm[i]);
        share[i] = (float)sum;
    }
}

double lum_waves_choose(lum_waves *waves, double u)
{
    if (waves->count == 1)
        return 1;
    double sum = 0, before = 0;
    for (uint32_t i = 0; i < waves->count; ++i)
        sum += (double)waves->share[i] * (double)waves->importance[i];
    uint32_t chosen = 0;
    double chance = 0;
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double mine = (double)waves->share[i] * (double)waves->importance[i] / sum;
        if (mine > 0) { /* also the last one where rounding leaves u beyond the sum */
            chosen = i;
            chance = mine;
        }
        before += mine;
        if (u < before)
            break;
    }
    const double factor = (double)waves->share[chosen] / chance;
    waves->nm[0] = waves->nm[chosen];
    waves->importance[0] = waves->importance[chosen];
    waves->share[0] = 1;
    waves->count = 1;
    return factor;
}

double lum_waves_weigh(lum_waves *waves, const float share[LUM_WAVES], double *luminance)
{
    if (waves->count == 1) {
        *luminance = (double)share[0];
        return (double)share[0];
    }
    double before = 0, after = 0, light = 0, left[LUM_WAVES];
    for (uint32_t i = 0; i < waves->count; ++i) {
        left[i] = (double)waves->share[i] * (double)share[i];
        light += left[i];
        before += (double)waves->share[i] * (double)waves->importance[i];
        after += left[i] * (double)waves->importance[i];
    }
    *luminance = light;
    if (!(light > 0))
        return 0;
    for (uint32_t i = 0; i < waves->count; ++i)
        waves->share[i] = (float)(left[i] / light);
    return after / before;
}
