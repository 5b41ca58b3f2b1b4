/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The photon tracer: light from a luminaire's emitters through its real geometry until it leaves.
 *
 * Every photon carries a luminance-weighted flux of exactly 1 from birth to end.  At each event it survives with probability q, the
 * luminance of (its colour x what the event leaves of it), and its colour is divided by q: light is thinned out in number, never in
 * weight, which gives equal weights in the light field (lowest variance in bins) and a balance in whole numbers:
 *
 *     emitted = escaped + absorbed + lost        (exactly)
 *
 * Light out of the colour gamut has negative components, and where a surface swallows those q exceeds 1: then the photon goes on as
 * floor(q) photons or one more, by chance, each of luminance 1, and the extra ones count as negative absorption, so that the
 * balance stays exact and its expectation right.  Nothing is cut off by the number of bounces: a light guide needs hundreds.
 *
 * Participating media: a flight through one ends at a surface, at a scattering or in absorption, drawn in proportion to luminance
 * (luminaires/medium.h), so that here too luminance stays 1.  A scattering is no bounce: only surfaces count towards the limit after
 * which light is given up, as thick media scatter light a million times and still let it out.
 *
 * Light that has to be followed by wavelength (luminaires/waves.h) is the exception: a path carries several wavelengths, and a luminance that
 * varies about 1; it is counted in parts of a photon, and what a change of luminance gives or takes counts as absorbed, so that the
 * balance is exact there too.
 *
 * Solid dielectrics: the photon remembers which it is inside of (counted by material, innermost last); the innermost gives the
 * index on the other side of the next boundary and the absorption on the way there (Beer-Lambert, as survival).  Light that leaves
 * the model while still inside a solid came through a hole in its boundary: lost, and counted apart, as the model has to be mended.
 *
 * The loop itself is in tracer_kernel.h, compiled several times with more or fewer features; here one of these kernels is chosen for
 * the model, and run.
 *
 * Path state is in double, in the model's frame minus its centre; rays are handed out in the luminaire's own frame.
 */
#include "tracer.h"

#include "tracer_state.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Where trapped light was when it was given up, as text: the materials and nodes of the triangles it met last, most frequent first. */
static void describe_trap(const lum_model *model, const tracer_trap *trap, char *text, size_t size)
{
    enum { PLACES = 3 };
    const uint32_t kept = trap->trapped < TRACER_TRAPPED_KEPT ? trap->trapped : TRACER_TRAPPED_KEPT;
    uint32_t part[TRACER_TRAPPED_KEPT];
    for (uint32_t i = 0; i < kept; ++i)
        part[i] = model->triangle_part[trap->triangle[i]];
    size_t used = 0;
    text[0] = 0;
    for (int place = 0; place < PLACES && used < size; ++place) {
        uint32_t best = 0, most = 0;
        for (uint32_t i = 0; i < kept; ++i) {
            uint32_t same = 0;
            for (uint32_t k = 0; k < kept; ++k)
                same += part[k] == part[i] && part[i] != UINT32_MAX;
            if (same > most) {
                most = same;
                best = part[i];
            }
        }
        if (most == 0)
            break;
        const lum_part *p = &model->parts[best];
        const int n = snprintf(text + used, size - used, "%s\"%.40s\" (material \"%.40s\")", place ? ", " : "", p->node,
                               model->materials[p->material].name);
        used += n > 0 ? (size_t)n : 0;
        for (uint32_t i = 0; i < kept; ++i)
            if (part[i] == best)
                part[i] = UINT32_MAX;
    }
}

static lmg_result fail_trapped(const tracer_job *j, lmg_error *err)
{
    char places[320];
    describe_trap(j->tracer->model, &j->trap, places, sizeof(places));
    return lmg_fail(err, LMG_ERROR_INPUT,
                    "%s: light is trapped: %" PRIu32 " of %" PRIu32 " photons met a million surfaces without end, the last ones of %s; a "
                    "closed shell that absorbs nothing keeps its light for ever: open it, or lower its reflectance",
                    j->tracer->model->path, j->trap.trapped, j->trap.started, places);
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err)
{
    const tracer *t = (const tracer *)source;
    tracer_job j = {.tracer = t, .sinks = sinks, .sink_count = sink_count, .trap_taken = ATOMIC_FLAG_INIT};
    const bake_work work = {.self = &j, .begin = t->kernel->begin, .chunk = t->kernel->chunk, .end = t->kernel->end};
    const lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result != LMG_OK)
        return result;
    if (atomic_load(&j.stopped))
        return fail_trapped(&j, err);
    tally->photons += (uint64_t)j.counts.photons;
    const double photon = 1.0 / TRACER_UNITS(t->kernel->features); /* a power of two: sums stay exact */
    tally->emitted += (double)j.counts.photons;
    tally->escaped += (double)j.counts.escaped * photon;
    tally->escaped_squares += (double)j.counts.escaped_squares * photon;
    tally->absorbed += (double)j.counts.absorbed * photon;
    tally->lost += (double)j.counts.lost * photon;
    tally->lost_inside += (double)j.counts.lost_inside * photon;
    tally->segments += (uint64_t)j.counts.segments;
    return LMG_OK;
}

static void destroy(bake_source *source)
{
    tracer *t = (tracer *)source;
    if (!t)
        return;
    lum_volumes_destroy(t->volumes);
    if (!t->borrows_emitters)
        lum_emitters_destroy(t->emitters);
    if (!t->borrows_clearance)
        lum_clearance_destroy(t->clearance);
    lum_scene_destroy(t->scene);
    bake_effects_free(t->variant);
    free(t->media);
    lum_wave_tables_destroy(t->spectral);
    free(t);
}

/* What the triangles of a material enclose, m3, by the divergence theorem. */
static void enclosed_volumes(const lum_model *model, double *volume)
{
    for (uint32_t i = 0; i < model->triangle_count; ++i) {
        const uint32_t *corner = model->indices + 3 * (size_t)i;
        const lmg_vec3 a = lum_model_vertex(model, corner[0]), b = lum_model_vertex(model, corner[1]);
        const lmg_vec3 c = lum_model_vertex(model, corner[2]);
        volume[model->triangle_material[i]] +=
            (a.x * (b.y * c.z - c.y * b.z) + a.y * (b.z * c.x - c.z * b.x) + a.z * (b.x * c.y - c.x * b.y)) / 6;
    }
}

static bool rank_media(const lum_model *model, tracer_medium *media)
{
    double *volume = calloc((size_t)model->material_count + 1, sizeof(*volume));
    if (!volume)
        return false;
    enclosed_volumes(model, volume);
    for (uint32_t i = 0; i < model->material_count; ++i)
        for (uint32_t k = 0; media[i].solid && k < model->material_count; ++k) {
            const bool higher = media[i].priority > media[k].priority, equal = media[i].priority == media[k].priority;
            const double mine = fabs(volume[i]), its = fabs(volume[k]);
            media[i].rank += media[k].solid && (higher || (equal && (mine < its || (mine == its && i > k))));
        }
    free(volume);
    return true;
}

/* Which materials bound solids, and what those absorb. */
static tracer_medium *list_media(const lum_model *model)
{
    tracer_medium *media = calloc(model->material_count ? model->material_count : 1, sizeof(*media));
    for (uint32_t i = 0; media && i < model->material_count; ++i) {
        const lum_material *m = &model->materials[i];
        media[i].solid = lum_material_is_solid(m);
        media[i].opaque = !(m->kind == LUM_SURFACE_PBR && (m->transmission > 0 || m->diffuse_transmission > 0)) &&
                          !m->spectral.transmittance && !m->spectral.converted;
        media[i].ior = m->ior;
        media[i].priority = m->priority;
        const bool clear = m->transmission == 1 && m->metallic == 0 && m->layers.present == 0 && m->alpha_mode == LUM_ALPHA_OPAQUE;
        const bool white = m->base_color[0] == 1 && m->base_color[1] == 1 && m->base_color[2] == 1 && !model->colors;
        media[i].bare = media[i].solid && clear && white && !lum_material_is_textured(m);
        for (int c = 0; c < 3; ++c) {
            media[i].absorption[c] = (double)m->absorption[c];
            media[i].absorbs |= media[i].solid && m->absorption[c] > 0;
        }
        media[i].absorbs |= media[i].solid && m->spectral.absorption;
        lum_medium_set(&media[i].inside, m->scattering, m->absorption, m->anisotropy);
        media[i].scatters = media[i].solid && (media[i].inside.scatters || m->spectral.scattering || m->spectral.fills);
    }
    if (media && !rank_media(model, media)) {
        free(media);
        return NULL;
    }
    return media;
}

/* The features that the model's materials call for. */
static uint32_t needed_features(const lum_model *model, const tracer_medium *media)
{
    uint32_t features = (model->colors ? TRACER_TEXTURES : 0) | (model->volume_count > 0 ? TRACER_MEDIA : 0) |
                        (lum_model_is_spectral(model) ? TRACER_SPECTRAL : 0);
    for (uint32_t i = 0; i < model->material_count; ++i) {
        const lum_material *m = &model->materials[i];
        if (lum_material_is_textured(m))
            features |= TRACER_TEXTURES;
        if (m->alpha_mode != LUM_ALPHA_OPAQUE)
            features |= TRACER_COVERAGE;
        if (media[i].solid)
            features |= TRACER_SOLIDS;
        if (media[i].absorbs)
            features |= TRACER_ABSORPTION;
        if (media[i].scatters)
            features |= TRACER_MEDIA;
        if (m->kind == LUM_SURFACE_PBR || m->has_eta)
            features |= TRACER_POLARIZATION;
    }
    return features;
}

/* The first kernel that has all of these features: the leanest, as they are sorted. */
static const tracer_kernel *choose_kernel(uint32_t features)
{
    for (size_t i = 0; i + 1 < tracer_kernel_count; ++i)
        if ((features & ~tracer_kernels[i]->features) == 0)
            return tracer_kernels[i];
    return tracer_kernels[tracer_kernel_count - 1];
}

/* What tells that light in dense media of solids meets nothing before it is scattered.  like: NULL, or a tracer of the same geometry. */
static lmg_result find_clearance(tracer *t, const tracer *like, lmg_error *err)
{
    const lum_model *m = t->model;
    lmg_vec3 low = {INFINITY, INFINITY, INFINITY}, high = {-INFINITY, -INFINITY, -INFINITY};
    double most = 0, area = 0, volume = 0; /* of these solids: twice, and six times */
    if (like && like->clearance) {
        t->clearance = like->clearance;
        t->borrows_clearance = true;
        return LMG_OK;
    }
    for (uint32_t i = 0; i < m->triangle_count; ++i) {
        const tracer_medium *medium = &t->media[m->triangle_material[i]];
        if (!medium->scatters)
            continue;
        most = fmax(most, medium->inside.majorant);
        double p[3][3];
        for (int k = 0; k < 3; ++k) {
            for (int c = 0; c < 3; ++c)
                p[k][c] = m->unit * (double)m->positions[3 * (size_t)m->indices[3 * (size_t)i + (size_t)k] + (size_t)c];
            low = (lmg_vec3){fmin(low.x, p[k][0]), fmin(low.y, p[k][1]), fmin(low.z, p[k][2])};
            high = (lmg_vec3){fmax(high.x, p[k][0]), fmax(high.y, p[k][1]), fmax(high.z, p[k][2])};
        }
        const double e[3] = {p[1][0] - p[0][0], p[1][1] - p[0][1], p[1][2] - p[0][2]};
        const double f[3] = {p[2][0] - p[0][0], p[2][1] - p[0][1], p[2][2] - p[0][2]};
        const double n[3] = {e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]};
        area += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        volume += p[0][0] * n[0] + p[0][1] * n[1] + p[0][2] * n[2];
    }
    if (!(most > 0 && area > 0))
        return LMG_OK;
    const double thickness = 2 * fabs(volume) / 3 / area; /* of a plate or a shell: its volume over half of its surface */
    return lum_clearance_create(t->scene, low, high, thickness, 1 / most, &t->clearance, err);
}

/* Emitters (of the original: what is left out is no source), volumes and intersection structure. */
static lmg_result build(tracer *t, const lum_model *original, const tracer *like, lmg_error *err)
{
    const lum_model *model = t->model;
    lmg_result result = LMG_OK;
    if (like) {
        t->emitters = like->emitters;
        t->borrows_emitters = true;
    } else {
        result = lum_emitters_create(original, &t->emitters, err);
    }
    if (result == LMG_OK) {
        t->source.flux = lum_emitters_flux(t->emitters, NULL);
        if (!(t->source.flux > 0) || !isfinite(t->source.flux))
            result =
                lmg_fail(err, LMG_ERROR_INPUT,
                         "%s: nothing in the model emits light; declare an emitter in a recipe or with --set emitter:NAME=800lm",
                         model->path);
        if (model->rated_flux > 0)
            t->source.flux = model->rated_flux;
    }
    if (result == LMG_OK)
        result = lum_volumes_create(model, &t->volumes, err);
    if (result == LMG_OK)
        result = like ? lum_scene_create_variant(like->scene, model, &t->scene, err) : lum_scene_create(model, &t->scene, err);
    return result;
}

lmg_result bake_tracer_create_with(const struct lum_model *model, uint32_t effects, uint64_t seed, const bake_source *like,
                                   bake_source **out, lmg_error *err)
{
    *out = NULL;
    tracer *t = calloc(1, sizeof(*t));
    if (!t)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the photon tracer");
    t->source.run = run;
    t->source.destroy = destroy;
    t->model = model;
    t->seed = seed;
    lmg_result result = LMG_OK;
    if ((bake_effects_of(model) & ~effects & ~(1u << BAKE_POLARIZATION)) != 0) {
        result = bake_effects_strip(model, effects, &t->variant, err);
        if (result == LMG_OK)
            t->model = t->variant;
        for (uint32_t i = 0; i < model->material_count; ++i) {
            const lum_material *m = &model->materials[i];
            t->recut |= m->alpha_mode != LUM_ALPHA_OPAQUE && (m->emissive[0] != 0 || m->emissive[1] != 0 || m->emissive[2] != 0);
        }
    }
    if (result == LMG_OK) {
        t->media = list_media(t->model);
        result = t->media ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the photon tracer");
    }
    if (result == LMG_OK) {
        result = build(t, model, (const tracer *)like, err);
    }
    if (result == LMG_OK) {
        uint32_t features = needed_features(t->model, t->media);
        if (features & TRACER_SOLIDS && lum_scene_touches(t->scene))
            features |= TRACER_TOUCHING;
        if (!(effects & 1u << BAKE_POLARIZATION))
            features &= ~TRACER_POLARIZATION;
        t->features = features;
        t->polarized = features & TRACER_POLARIZATION;
        t->kernel = choose_kernel(features);
        if (lum_model_is_spectral(t->model))
            result = lum_wave_tables_create(t->model, &t->spectral, err);
        else if (result == LMG_OK) /* distances by wavelength aren't drawn before hits are looked for */
            result = find_clearance(t, (const tracer *)like, err);
    }
    if (result != LMG_OK) {
        destroy(&t->source);
        return result;
    }
    /* Positions are floats relative to the centre: their rounding, and the offsets off surfaces, stay within a few units in the
     * last place of the largest coordinate.  A margin of 2^-20 of the size keeps every point of the luminaire inside the bounds. */
    const lmg_vec3 lo = model->bounds_min, hi = model->bounds_max, c = model->centre;
    const double size = sqrt((hi.x - lo.x) * (hi.x - lo.x) + (hi.y - lo.y) * (hi.y - lo.y) + (hi.z - lo.z) * (hi.z - lo.z));
    const double margin = 0x1p-20 * size;
    /* A hit's error is below 2^-20 of the size (2^-23 as a rule): a thousand times that finds all surfaces that aren't nearly parallel
     * to the ray, and those are the business of the next segment. */
    t->near = 0x1p-13 * size;
    t->source.bounds_min = (lmg_vec3){c.x + lo.x - margin, c.y + lo.y - margin, c.z + lo.z - margin};
    t->source.bounds_max = (lmg_vec3){c.x + hi.x + margin, c.y + hi.y + margin, c.z + hi.z + margin};
    *out = &t->source;
    return LMG_OK;
}

lmg_result bake_tracer_create(const struct lum_model *model, uint64_t seed, bake_source **out, lmg_error *err)
{
    return bake_tracer_create_with(model, UINT32_MAX, seed, NULL, out, err);
}

lmg_result bake_tracer_survey(const bake_source *source, uint64_t first, uint64_t count, unsigned threads, bake_survey *survey,
                              lmg_error *err)
{
    const tracer *t = (const tracer *)source;
    const uint32_t materials = t->model->material_count;
    uint32_t *effects = calloc(materials + 1, sizeof(*effects));
    _Atomic int64_t *ended = calloc(materials + 1, sizeof(*ended));
    if (!effects || !ended) {
        free(effects);
        free(ended);
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the survey of %" PRIu32 " materials", materials);
    }
    for (uint32_t i = 0; i < materials; ++i)
        effects[i] = bake_effects_of_material(&t->model->materials[i]);
    tracer_survey notes = {.effects = effects,
                           .lights = bake_effects_of(t->model) & (1u << BAKE_EMISSION_POINT | 1u << BAKE_EMISSION_SPOT | 1u << BAKE_EMISSION_PROFILE),
                           .scattering = bake_effects_of(t->model) & (1u << BAKE_MEDIUM | 1u << BAKE_VOLUMES),
                           .ended = ended};
    tracer_job j = {.tracer = t, .survey = &notes, .trap_taken = ATOMIC_FLAG_INIT};
    const tracer_kernel *k = &tracer_kernel_survey;
    const bake_work work = {.self = &j, .begin = k->begin, .chunk = k->chunk, .end = k->end};
    lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result == LMG_OK && atomic_load(&j.stopped))
        result = fail_trapped(&j, err);
    survey->photons += (uint64_t)j.counts.photons;
    survey->escaped += (uint64_t)(j.counts.escaped / TRACER_UNITS(k->features));
    survey->segments += (uint64_t)j.counts.segments;
    for (int i = 0; i < BAKE_EFFECT_COUNT; ++i)
        survey->met[i] += (uint64_t)atomic_load(&notes.met[i]);
    for (uint32_t i = 0; survey->ended && i < materials; ++i)
        survey->ended[i] += (uint64_t)atomic_load(&ended[i]);
    free(effects);
    free(ended);
    return result;
}

bool bake_tracer_use_kernel(bake_source *source, size_t index)
{
    tracer *t = (tracer *)source;
    if (index >= tracer_kernel_count || (t->features & ~tracer_kernels[index]->features) != 0)
        return false;
    t->kernel = tracer_kernels[index];
    return true;
}

const char *bake_tracer_kernel(const bake_source *source)
{
    return ((const tracer *)source)->kernel->name + sizeof("tracer_kernel_") - 1;
}

const struct lum_scene *bake_tracer_scene(const bake_source *source)
{
    return ((const tracer *)source)->scene;
}

size_t bake_tracer_record(const bake_source *source, uint64_t first, uint64_t count, float *rays, size_t capacity)
{
    const tracer *t = (const tracer *)source;
    tracer_job j = {.tracer = t, .trap_taken = ATOMIC_FLAG_INIT, .record = rays, .record_capacity = capacity};
    void *worker = t->kernel->begin(&j);
    if (!worker)
        return 0;
    for (uint64_t i = 0; i < count && j.record_count < capacity; i += BAKE_CHUNK)
        t->kernel->chunk(&j, worker, first + i, count - i < BAKE_CHUNK ? count - i : BAKE_CHUNK);
    t->kernel->end(&j, worker);
    return j.record_count;
}

bool bake_tracer_can_look(const bake_source *source, const char **why)
{
    /* Points have no radiance; media, phosphors and layers wait for an adjoint that is tested; polarization would have to be known
     * of light that comes from ahead. */
    static const bake_effect CANT[] = {
        BAKE_EMISSION_POINT, BAKE_EMISSION_SPOT, BAKE_EMISSION_PROFILE, BAKE_MEDIUM, BAKE_VOLUMES,    BAKE_DISPERSION, BAKE_SPECTRA,
        BAKE_FLUORESCENCE,   BAKE_SPECULAR,      BAKE_CLEARCOAT,        BAKE_SHEEN,  BAKE_ANISOTROPY, BAKE_IRIDESCENCE};
    const tracer *t = (const tracer *)source;
    const uint32_t effects = bake_effects_of(t->model);
    bake_effect in_the_way = t->polarized  ? BAKE_POLARIZATION
                             : t->spectral ? BAKE_SPECTRA
                             : t->recut    ? BAKE_COVERAGE
                                           : BAKE_EFFECT_COUNT;
    for (size_t i = 0; i < sizeof(CANT) / sizeof(CANT[0]); ++i)
        if (effects & 1u << CANT[i])
            in_the_way = CANT[i];
    if (in_the_way != BAKE_EFFECT_COUNT && why)
        *why = bake_effect_name(in_the_way);
    if (in_the_way == BAKE_EFFECT_COUNT && t->features & TRACER_TOUCHING) {
        if (why)
            *why = "solids that touch";
        return false;
    }
    return in_the_way == BAKE_EFFECT_COUNT;
}

double bake_tracer_emission(const bake_source *source)
{
    return lum_emitters_flux(((const tracer *)source)->emitters, NULL);
}

bool bake_tracer_look(const bake_source *source, const lmg_ray *rays, size_t count, float (*radiance)[3], uint64_t *segments)
{
    const tracer_kernel *k = &tracer_kernel_backward;
    tracer_job j = {.tracer = (const tracer *)source, .rays = rays, .radiance = radiance, .trap_taken = ATOMIC_FLAG_INIT};
    void *worker = k->begin(&j);
    if (!worker)
        return false;
    for (size_t i = 0; i < count; i += BAKE_CHUNK)
        k->chunk(&j, worker, i, count - i < BAKE_CHUNK ? count - i : BAKE_CHUNK);
    k->end(&j, worker);
    if (segments)
        *segments += (uint64_t)j.counts.segments;
    return !atomic_load(&j.stopped);
}

bool bake_tracer_has_outline(const bake_source *source, const char **why)
{
    /* emission without surfaces; smoke in the space around */
    static const bake_effect CANT[] = {BAKE_EMISSION_POINT, BAKE_EMISSION_SPOT, BAKE_EMISSION_PROFILE, BAKE_VOLUMES};
    const uint32_t effects = bake_effects_of(((const tracer *)source)->model);
    for (size_t i = 0; i < sizeof(CANT) / sizeof(CANT[0]); ++i)
        if (effects & 1u << CANT[i]) {
            if (why)
                *why = bake_effect_name(CANT[i]);
            return false;
        }
    return true;
}

uint32_t bake_tracer_surfaces(const bake_source *source)
{
    return 2 * ((const tracer *)source)->model->part_count;
}

void bake_tracer_outline(const bake_source *source, const lmg_ray *rays, size_t count, uint32_t *surface)
{
    enum { TOGETHER = LUM_MAX_RAYS };
    const tracer *t = (const tracer *)source;
    const lmg_vec3 centre = t->model->centre;
    lmg_vec3 origin[TOGETHER], direction[TOGETHER];
    lum_hit hit[TOGETHER];
    for (size_t first = 0; first < count; first += TOGETHER) {
        const size_t n = count - first < TOGETHER ? count - first : TOGETHER;
        for (size_t i = 0; i < n; ++i) {
            const lmg_vec3 o = rays[first + i].origin, d = rays[first + i].direction;
            origin[i] = (lmg_vec3){o.x - centre.x, o.y - centre.y, o.z - centre.z};
            direction[i] = (lmg_vec3){-d.x, -d.y, -d.z};
        }
        lum_scene_intersect_many(t->scene, n, origin, direction, hit);
        for (size_t i = 0; i < n; ++i)
            if (hit[i].triangle == LUM_MISS) {
                surface[first + i] = BAKE_NO_SURFACE;
            } else {
                const lmg_vec3 normal = hit[i].ng, d = direction[i];
                surface[first + i] = 2 * t->model->triangle_part[hit[i].triangle] + (normal.x * d.x + normal.y * d.y + normal.z * d.z > 0);
            }
    }
}
