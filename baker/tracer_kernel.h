/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The inner loop of the photon tracer: start, fly, meet a surface, escape.  Compiled once per kernel (tracer_kernel_*.c), each time
 * with a constant set of features:
 *
 *     #define KERNEL_NAME tracer_kernel_plain      the tracer_kernel that this defines
 *     #define KERNEL_FEATURES 0u                   TRACER_... of tracer_state.h
 *     #include "tracer_kernel.h"
 *
 * Code of a feature stands under `if (HAS(TRACER_...))`, which the compiler drops where the kernel lacks it, or under #if where it
 * is a part of the path.  Whatever happens to a photon on its way happens in one of four places:
 *
 *     start()        it is born: position, direction, colour
 *     fly()          along a segment, before its end is looked at: absorption in solids
 *                    fly_through() in kernels with media: also scattering, which starts a new segment
 *     meet(), leave() at a surface (meet_layers() at several that lie on each other): passing by, entering and leaving solids;
 *                    scattering, in between, is done for all paths together
 *     escape()       it leaves the model
 *
 * survivors() turns any loss into whole photons; of light by wavelength, survives().  Numbers are drawn where a model needs them,
 * never by feature.
 *
 * With TRACER_BACKWARD a path is what an eye outside sees along a ray: it runs against the light, its colour is what of the
 * radiance ahead arrives at the eye, and meet() adds what a surface emits.  By reciprocity the same scattering serves, times
 * adjoint_weight().
 */
#include "batch.h"
#include "effects.h"
#include "tracer_state.h"

#include <luminaires/rng.h>

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define HAS(feature) ((KERNEL_FEATURES & (feature)) != 0)

/* How deep solids may be nested; deeper counts as lost. */
enum { MAX_NESTED = 8 };
/* Light that goes round for ever in a lossless closed model is given up (counted as lost) here, far beyond any light guide: of
 * light that makes 10,000 bounces on average, a share of e^-100 goes further. */
static const uint32_t RUNAWAY_SEGMENTS = 1000000;
/* Paths longer than this are followed alone to their end: then the first of many trapped ones is known sooner. */
static const uint32_t LONG_SEGMENTS = 100000;
/* The whole run gives up when in a chunk more than TRAP_COUNT + TRAP_SHARE x (photons started) were given up: a model that keeps a
 * thousandth of its light for ever is wrong (a thousand times the loss that is tolerated), and spends a thousand segments per
 * photon on it.  TRAP_COUNT keeps chance from deciding: of a chunk's few given up by a smaller share, more than that come once in
 * 10^4. */
static const double TRAP_COUNT = 4, TRAP_SHARE = 0.001;
/* Photons that wait because one became several.  On average one becomes at most one, so mostly a few wait; but light out of the gamut
 * whose luminance nearly cancels goes on as a hundred and more.  Beyond that they count as lost. */
enum { MAX_PENDING = 512 };

typedef struct path {
    double colour[3]; /* luminance 1 */
#if KERNEL_FEATURES & TRACER_SPECTRAL
    lum_waves waves; /* instead of colour, when the tracer has spectral tables */
    int64_t units;    /* its luminance */
#endif
    lum_rng rng;
    uint64_t number;
    uint32_t segments;
#if KERNEL_FEATURES & TRACER_SOLIDS
    uint32_t nested;
    int32_t inside[MAX_NESTED]; /* materials of the solids around, innermost last */
#endif
#if KERNEL_FEATURES & TRACER_POLARIZATION
    lum_polarization polarization;
#endif
#if KERNEL_FEATURES & TRACER_BACKWARD
    double radiance[3]; /* seen so far, cd/m2 */
    double gain;        /* of radiance by refraction, (n here)^-2: no loss that roulette is to mistake for one */
#endif
#if KERNEL_FEATURES & TRACER_SURVEY
    uint32_t met;        /* bits of bake_effect */
    bool polarized_once; /* polarization matters from the second event on that polarizes */
#endif
} path;

/* A path that waits, with its ray. */
typedef struct waiting_path {
    lmg_vec3 origin, direction;
    path path;
} waiting_path;

/*
 * A thread follows WAVE paths side by side, one segment each in turn: their rays are traced together, then all hits are worked on.
 * The memory that a hit needs is on its way meanwhile, and code and branches stay warm; a path's result doesn't depend on its
 * company.
 */
enum { WAVE = 64 };

#if KERNEL_FEATURES & TRACER_TOUCHING
/* The surfaces that lie on each other where a path is. */
typedef struct crossing {
    /* Boundaries of solids, all crossed by what goes through there; outermost solids first. */
    uint32_t count;
    int32_t material[LUM_MAX_HERE];
    bool front[LUM_MAX_HERE];
    /* What the light meets, in its order; 0 layers: one surface only.  boundary: the layer that acts for all boundaries, layer_count if none
     * does.  The path has arrived at layer `at`, along the order or (`back`) against it; `turned`: not in its first direction. */
    lum_hit layers[LUM_MAX_HERE];
    uint32_t layer_count, boundary, at;
    bool back, turned;
    /* The solids around on the other side of the boundaries. */
    uint32_t nested;
    int32_t inside[MAX_NESTED];
} crossing;
#endif

typedef struct worker {
    tracer_counts counts;
    tracer_survey *survey;
    float (*radiance)[3]; /* of TRACER_BACKWARD: tracer_job.radiance */
    tracer_trap trap;
    uint32_t alive; /* paths in the wave: the first ones */
    lmg_vec3 origin[WAVE], direction[WAVE];
    lum_hit hit[WAVE];
#if KERNEL_FEATURES & TRACER_MEDIA
    double reach[WAVE]; /* distance drawn for the segment, in a medium inside a solid; negative: none */
    bool ended[WAVE];   /* on its way there */
    uint32_t left[WAVE]; /* the triangle that the segment starts from, LUM_MISS: none */
#endif
    path path[WAVE];
    bool goes_on[WAVE];
#if KERNEL_FEATURES & TRACER_TOUCHING
    crossing here[WAVE];
#endif
    /* Paths that are to be scattered: what they meet, which they are, how many photons each stands for. */
    uint32_t met_count;
    lum_encounter met[WAVE];
    uint32_t met_path[WAVE], met_photons[WAVE];
#if KERNEL_FEATURES & TRACER_TOUCHING
    uint32_t onward_count, onward_path[WAVE], onward_photons[WAVE]; /* have passed a layer and come to the next one */
#endif
#if KERNEL_FEATURES & TRACER_SPECTRAL
    bool converted[WAVE]; /* by a phosphor, just now */
#endif
    uint32_t pending_count;
    waiting_path pending[MAX_PENDING];
    uint16_t order[BAKE_CHUNK]; /* of a chunk's photons: order_photons */
    uint32_t drawn_count, drawn_next;
    lum_photons drawn; /* photons that will start next */
    bake_batch batch;
} worker;

/* Where light goes on that a surface doesn't turn: along its own line, so that a boundary without a step of the index changes nothing.
 * Off the surface by the hit's error, as lum_offset; at grazing incidence that would be far along the line, so lum_offset serves. */
static inline lmg_vec3 pass_straight(const lum_hit *hit, lmg_vec3 d)
{
    const double c = fabs(d.x * hit->ng.x + d.y * hit->ng.y + d.z * hit->ng.z);
    if (c < 1.0 / 16)
        return lum_offset(hit, d);
    const double step = hit->error / c;
    return (lmg_vec3){hit->position.x + step * d.x, hit->position.y + step * d.y, hit->position.z + step * d.z};
}

static double luminance(const double c[3])
{
    return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
}

/* The luminance of a path in the units of the kernel's counts. */
static inline int64_t units_of(const path *p)
{
#if KERNEL_FEATURES & TRACER_SPECTRAL
    return p->units;
#else
    (void)p;
    return 1;
#endif
}

#if KERNEL_FEATURES & TRACER_BACKWARD
/*
 * Of a path that runs backwards the colour takes the loss, so that a mirror or a filter on its way adds no noise; only where little
 * is left it goes on by chance, in proportion.  Returns 0 or 1.
 */
static inline uint32_t survivors(path *p, const double share[3])
{
    static const double LITTLE = 0.25;
    for (int i = 0; i < 3; ++i)
        p->colour[i] *= share[i];
    const double left = luminance(p->colour) / p->gain;
    if (left >= LITTLE)
        return 1;
    const double q = left / LITTLE;
    if (!(q > 0) || lum_rng_next(&p->rng) >= q)
        return 0;
    for (int i = 0; i < 3; ++i)
        p->colour[i] /= q;
    return 1;
}
#else
/*
 * How many photons go on, each with luminance 1, after an event that leaves the given share of each colour: mostly 0 or 1.  The
 * path's colour becomes theirs.
 */
static inline uint32_t survivors(path *p, const double share[3])
{
    double q;
    if (share[0] == share[1] && share[1] == share[2]) {
        q = share[0]; /* grey: the colour stays, to the last bit */
    } else {
        const double c[3] = {p->colour[0] * share[0], p->colour[1] * share[1], p->colour[2] * share[2]};
        q = luminance(c);
        if (!(q > 0))
            return 0;
        const double scale = 1 / q;
        for (int i = 0; i < 3; ++i)
            p->colour[i] = c[i] * scale;
        /* Six products and sums round q by a few units in the last place: that close to 1, nothing happened. */
        if (fabs(q - 1) <= 8 * DBL_EPSILON)
            q = 1;
    }
    if (q == 1)
        return 1;
    const double u = lum_rng_next(&p->rng);
    if (q < 1)
        return u < q;
    const double whole = floor(q);
    return (uint32_t)(whole < MAX_PENDING ? whole : MAX_PENDING) + (u < q - whole);
}
#endif

/* Puts copies of a multiplied photon aside; each goes on from where it is now, with random numbers of its own. */
static void put_aside(worker *w, uint32_t i, uint32_t copies)
{
    for (uint32_t k = 0; k < copies; ++k) {
        if (w->pending_count == MAX_PENDING) {
            w->counts.lost += units_of(&w->path[i]);
            continue;
        }
        waiting_path *copy = &w->pending[w->pending_count++];
        *copy = (waiting_path){w->origin[i], w->direction[i], w->path[i]};
        copy->path.rng.state = lum_mix64(copy->path.rng.state + k + 1);
    }
}

/* ------------------------------------------------------------------------------------------------------- by wavelength */

#if KERNEL_FEATURES & TRACER_SPECTRAL
/* Multiplies a path's luminance; false if nothing is left. */
static inline bool change_luminance(worker *w, path *p, double factor)
{
    const int64_t units = llround((double)p->units * factor);
    w->counts.absorbed += p->units - units;
    p->units = units;
    return units > 0;
}

/* A loss that changes importance by `importance` and luminance by `luminance`: survives in proportion to importance. */
static inline bool survives_loss(worker *w, path *p, double importance, double luminance)
{
    /* Sums of shares are rounded to floats: that close to 1, nothing happened. */
    if (importance < 1 - 8 * (double)FLT_EPSILON) {
        if (!(lum_rng_next(&p->rng) < importance)) {
            w->counts.absorbed += p->units;
            return false;
        }
        luminance /= importance;
    }
    return p->waves.count == 1 && importance <= 1 ? true : change_luminance(w, p, luminance);
}

/* After an event that leaves a share of each wave. */
static inline bool survives(worker *w, path *p, const float share[LUM_WAVES])
{
    double luminance;
    const double importance = lum_waves_weigh(&p->waves, share, &luminance);
    return survives_loss(w, p, importance, luminance);
}

/* A surface that leaves R,G,B. */
static inline bool survives_surface(const tracer *t, worker *w, path *p, int32_t material, const lum_scattered *s)
{
    const lum_wave_material *m = &t->spectral->materials[material];
    if (m->tint == LUM_TINT_RGB && s->weight[0] == s->weight[1] && s->weight[1] == s->weight[2])
        return s->weight[0] == 1 || survives_loss(w, p, (double)s->weight[0], (double)s->weight[0]);
    float share[LUM_WAVES];
    lum_waves_scattered(t->spectral, material, (s->event & LUM_REFLECTED) != 0, s->weight, &p->waves, share);
    return survives(w, p, share);
}

/* Before a boundary where directions depend on the wavelength, one goes on alone.  outside: the solid on its front side, or -1.
 * False if nothing is left of it. */
static inline bool choose_wave(const tracer *t, worker *w, path *p, int32_t material, int32_t outside)
{
    const bool refracts = t->spectral->materials[material].refracts || (outside >= 0 && t->spectral->materials[outside].refracts);
    if (!refracts || p->waves.count == 1)
        return true;
    return change_luminance(w, p, lum_waves_choose(&p->waves, lum_rng_next(&p->rng)));
}

/*
 * Of each wave a phosphor takes `taken`, of which it emits what the quantum yield leaves of the photons, and `rest` is scattered.  One
 * of the two is followed, in proportion to its importance.  Returns whether anything is left; *converted: which of them.
 */
static inline bool convert(const tracer *t, worker *w, path *p, const lum_phosphor *phosphor, const double taken[LUM_WAVES],
                           const float rest[LUM_WAVES], bool *converted)
{
    lum_waves *waves = &p->waves;
    double light = 0, scattered = 0, before = 0; /* luminance emitted; importances */
    for (uint32_t i = 0; i < waves->count; ++i) {
        const double s = (double)waves->share[i];
        light += s * taken[i] * lum_phosphor_gain(t->spectral, phosphor, (double)waves->nm[i]);
        scattered += s * (double)rest[i] * (double)waves->importance[i];
        before += s * (double)waves->importance[i];
    }
    const double emitted = light * phosphor->importance, all = emitted + scattered;
    *converted = false;
    if (!(emitted > 0))
        return survives(w, p, rest);
    *converted = lum_rng_next(&p->rng) * all < emitted;
    double luminance;
    if (*converted) {
        luminance = light / emitted * all;
        luminance *= lum_waves_draw(t->spectral, &phosphor->light, lum_rng_next(&p->rng), waves);
    } else {
        lum_waves_weigh(waves, rest, &luminance);
        luminance *= all / scattered;
    }
    /* Of a lone wave that stays as it is, survives_loss keeps the luminance. */
    return survives_loss(w, p, all / before, luminance);
}

/* A layer of phosphor takes its share of each wave, and emits Lambertian to both sides. */
static inline bool meet_phosphor(const tracer *t, worker *w, path *p, const lum_phosphor *phosphor, bool *converted)
{
    double taken[LUM_WAVES];
    float rest[LUM_WAVES];
    for (uint32_t i = 0; i < p->waves.count; ++i) {
        taken[i] = lum_spectrum_at(phosphor->excitation, (double)p->waves.nm[i]);
        rest[i] = (float)(1 - taken[i]);
    }
    return convert(t, w, p, phosphor, taken, rest, converted);
}
#endif

#if KERNEL_FEATURES & TRACER_SURVEY
static void note_effects(path *p, uint32_t effects)
{
    const uint32_t polarization = 1u << BAKE_POLARIZATION;
    p->met |= effects & (p->polarized_once ? UINT32_MAX : ~polarization);
    p->polarized_once |= (effects & polarization) != 0;
}

static void note_end(const tracer *t, const worker *w, uint32_t i)
{
    for (int k = 0; k < BAKE_EFFECT_COUNT; ++k)
        if (w->path[i].met >> k & 1)
            atomic_fetch_add_explicit(&w->survey->met[k], 1, memory_order_relaxed);
    if (w->hit[i].triangle != LUM_MISS)
        atomic_fetch_add_explicit(&w->survey->ended[t->model->triangle_material[w->hit[i].triangle]], 1, memory_order_relaxed);
}
#endif

/* -------------------------------------------------------------------------------------------------------------- solids */

#if KERNEL_FEATURES & TRACER_SOLIDS
static bool is_inside(const path *p, int32_t material)
{
    for (uint32_t i = 0; i < p->nested; ++i)
        if (p->inside[i] == material)
            return true;
    return false;
}

/* A path that meets the back of a solid's boundary has been inside all along: it was born there.  Known from now on, and for this
 * segment.  False: nested too deep. */
static bool notice_birth_inside(const tracer *t, path *p, int32_t material, bool front)
{
    if (front || !t->media[material].solid || is_inside(p, material))
        return true;
    if (p->nested == MAX_NESTED)
        return false;
    uint32_t at = 0;
    while (at < p->nested && t->media[p->inside[at]].priority < t->media[material].priority)
        ++at;
    memmove(&p->inside[at + 1], &p->inside[at], (p->nested - at) * sizeof(p->inside[0]));
    p->inside[at] = material;
    ++p->nested;
    return true;
}

/* Goes through the boundary of a solid: in from its front, out from its back.  False: nested too deep. */
static bool cross_boundary(const tracer *t, path *p, int32_t material, bool front)
{
    if (front) {
        if (p->nested == MAX_NESTED)
            return false;
        uint32_t at = p->nested++;
        for (; at > 0 && t->media[p->inside[at - 1]].priority > t->media[material].priority; --at)
            p->inside[at] = p->inside[at - 1];
        p->inside[at] = material;
        return true;
    }
    for (uint32_t i = p->nested; i-- > 0;)
        if (p->inside[i] == material) {
            memmove(&p->inside[i], &p->inside[i + 1], (p->nested - i - 1) * sizeof(p->inside[0]));
            --p->nested;
            break;
        }
    return true;
}

/*
 * Whether light doesn't notice the boundary of a solid: it lies inside of a solid of higher priority [schmidt2002nested], or there
 * is the same index on both sides and nothing else at it.
 */
static bool is_unnoticed(const tracer *t, const path *p, int32_t material, bool front)
{
    const tracer_medium *m = &t->media[material];
    if (!m->solid)
        return false;
    uint32_t n = p->nested;
    if (n > 0 && t->media[p->inside[n - 1]].priority > m->priority)
        return true;
    if (!m->bare || t->spectral)
        return false;
    if (!front && n > 0 && p->inside[n - 1] == material)
        --n;
    return m->ior == (n > 0 ? t->media[p->inside[n - 1]].ior : 1.0f);
}

/* Where a ray goes on beyond a hit as if nothing was there: on the same line, unless it grazes the surface. */
static lmg_vec3 straight_on(const lum_hit *hit, lmg_vec3 origin, lmg_vec3 d)
{
    const double c = fabs(d.x * hit->ng.x + d.y * hit->ng.y + d.z * hit->ng.z);
    if (c < 0.01)
        return lum_offset(hit, d);
    const double beyond = hit->t + hit->error / c;
    return (lmg_vec3){origin.x + beyond * d.x, origin.y + beyond * d.y, origin.z + beyond * d.z};
}

/* The solid on the front side of a boundary of `material` that the path meets from the front or from inside, or -1. */
static int32_t solid_outside(const path *p, int32_t material, bool front)
{
    uint32_t n = p->nested;
    if (!front && n > 0 && p->inside[n - 1] == material)
        --n;
    return n > 0 ? p->inside[n - 1] : -1;
}

static float index_of_solid(const tracer *t, const path *p, int32_t solid)
{
    if (solid < 0)
        return 1.0f;
    const float index = t->media[solid].ior;
#if KERNEL_FEATURES & TRACER_SPECTRAL
    if (t->spectral)
        return lum_waves_index(t->spectral, solid, &p->waves, index);
#else
    (void)p;
#endif
    return index;
}
#endif

#if KERNEL_FEATURES & TRACER_TOUCHING
/* The solid that a path is in, or -1. */
static int32_t innermost(const path *p)
{
    return p->nested > 0 ? p->inside[p->nested - 1] : -1;
}

/* Goes through all boundaries of a place.  False: nested too deep. */
static bool cross_all(const tracer *t, path *p, const crossing *here)
{
    for (uint32_t k = 0; k < here->count; ++k)
        if (!here->front[k])
            cross_boundary(t, p, here->material[k], false);
    for (uint32_t k = 0; k < here->count; ++k)
        if (here->front[k] && !cross_boundary(t, p, here->material[k], true))
            return false;
    return true;
}

/* Takes a path to the other side of a place's boundaries. */
static void change_sides(path *p, crossing *here)
{
    const uint32_t nested = p->nested;
    int32_t inside[MAX_NESTED];
    memcpy(inside, p->inside, sizeof(inside));
    p->nested = here->nested;
    memcpy(p->inside, here->inside, sizeof(inside));
    here->nested = nested;
    memcpy(here->inside, inside, sizeof(inside));
}

/*
 * What path i meets where it has arrived, when several surfaces lie there: w->here[i].  What is opaque comes first, in contact with the
 * medium before: nothing slips through.  All boundaries of solids act as one between the medium before and the one after: it has the
 * surface of the solid of higher rank of these two; where both are the same there is none, and what was met may be no layer at all.
 * Sheets that let light through lie outside of that solid, those that face outwards outermost: from behind, light meets all this in
 * reversed order.  *alone: there is but one surface, w->hit[i].  False: nested too deep, or too many surfaces.
 */
static bool look_around(const tracer *t, worker *w, uint32_t i, bool *alone)
{
    path *p = &w->path[i];
    crossing *here = &w->here[i];
    lum_hit all[LUM_MAX_HERE];
    all[0] = w->hit[i];
    here->count = here->layer_count = 0;
    const uint32_t count = lum_scene_all_here(t->scene, w->origin[i], w->direction[i], all);
    *alone = count == 1;
    if (*alone)
        return true;
    if (count > LUM_MAX_HERE)
        return false;
    w->hit[i] = all[0];
    lum_hit *layers = here->layers;
    uint32_t layer_count = 0, opaque = 0, fronts[2] = {0, 0}, from[LUM_MAX_HERE];
    const lmg_vec3 d = w->direction[i];
    for (uint32_t k = 0; k < count; ++k) {
        const int32_t material = t->model->triangle_material[all[k].triangle];
        const bool front = d.x * all[k].ng.x + d.y * all[k].ng.y + d.z * all[k].ng.z < 0;
        if (!t->media[material].solid) {
            const bool passes = !t->media[material].opaque;
            const uint32_t at = (passes ? opaque : 0) + fronts[passes];
            fronts[passes] += front;
            opaque += !passes;
            memmove(&layers[at + 1], &layers[at], (layer_count - at) * sizeof(layers[0]));
            layers[at] = all[k];
            ++layer_count;
            continue;
        }
        /* Out of a solid and into another one of the same material: no boundary. */
        uint32_t at = 0;
        while (at < here->count && !(here->material[at] == material && here->front[at] != front))
            ++at;
        if (at < here->count) {
            --here->count;
            memmove(&here->material[at], &here->material[at + 1], (here->count - at) * sizeof(here->material[0]));
            memmove(&here->front[at], &here->front[at + 1], (here->count - at) * sizeof(here->front[0]));
            memmove(&from[at], &from[at + 1], (here->count - at) * sizeof(from[0]));
            continue;
        }
        for (at = here->count++; at > 0 && t->media[here->material[at - 1]].rank > t->media[material].rank; --at) {
            here->material[at] = here->material[at - 1];
            here->front[at] = here->front[at - 1];
            from[at] = from[at - 1];
        }
        here->material[at] = material;
        here->front[at] = front;
        from[at] = k;
    }
    for (uint32_t k = here->count; k-- > 0;)
        if (!notice_birth_inside(t, p, here->material[k], here->front[k]))
            return false;
    path beyond = *p;
    if (!cross_all(t, &beyond, here))
        return false;
    here->nested = beyond.nested;
    memcpy(here->inside, beyond.inside, sizeof(here->inside));
    const int32_t before = innermost(p), after = innermost(&beyond);
    here->boundary = UINT32_MAX;
    for (uint32_t k = here->count; before != after && k-- > 0;)
        if (here->material[k] == (here->front[k] ? after : before)) {
            here->boundary = here->front[k] ? layer_count : opaque;
            memmove(&layers[here->boundary + 1], &layers[here->boundary], (layer_count - here->boundary) * sizeof(layers[0]));
            layers[here->boundary] = all[from[k]];
            ++layer_count;
            break;
        }
    if (here->boundary == UINT32_MAX)
        here->boundary = layer_count;
    here->layer_count = layer_count;
    here->at = 0;
    here->back = here->turned = false;
    return true;
}
#endif

/* -------------------------------------------------------------------------------------------------------- on the way */

static inline void escape(const tracer *t, worker *w, uint32_t i)
{
    const path *p = &w->path[i];
#if KERNEL_FEATURES & TRACER_BACKWARD
    (void)t, (void)p; /* nothing shines out there */
#else
#if KERNEL_FEATURES & TRACER_SOLIDS
    if (p->nested > 0) {
        w->counts.lost += units_of(p);
        w->counts.lost_inside += units_of(p);
        return;
    }
#endif
    w->counts.escaped += units_of(p);
    const lmg_vec3 centre = t->model->centre, o = w->origin[i];
    lmg_ray *ray = bake_batch_next(&w->batch);
    ray->origin = (lmg_vec3){o.x + centre.x, o.y + centre.y, o.z + centre.z};
    ray->direction = w->direction[i];
    for (int k = 0; k < 3; ++k)
        ray->flux[k] = (float)p->colour[k];
    ray->wavelength = 0;
    ray->number = p->number;
#if KERNEL_FEATURES & TRACER_SPECTRAL
    if (t->spectral) {
        w->counts.escaped_squares += llround((double)p->units * (double)p->units / TRACER_UNITS(KERNEL_FEATURES));
        double rgb[3];
        lum_waves_rgb(t->spectral, &p->waves, rgb);
        for (int k = 0; k < 3; ++k)
            ray->flux[k] = (float)(rgb[k] * (double)p->units / TRACER_UNITS(KERNEL_FEATURES));
        ray->wavelength = p->waves.count == 1 ? p->waves.nm[0] : 0;
    }
#endif
#endif
}

/* What happens to path i along its segment of length `length`: the number of photons that arrive at its end. */
static inline uint32_t fly(const tracer *t, worker *w, uint32_t i, double length)
{
#if KERNEL_FEATURES & TRACER_ABSORPTION
    path *p = &w->path[i];
    if (p->nested > 0) {
        const tracer_medium *m = &t->media[p->inside[p->nested - 1]];
#if KERNEL_FEATURES & TRACER_SPECTRAL
        if (m->absorbs && t->spectral) {
            float share[LUM_WAVES];
            lum_waves_absorbed(t->spectral, p->inside[p->nested - 1], m->absorption, length, &p->waves, share);
            return survives(w, p, share);
        }
#endif
        if (m->absorbs) {
            double share[3];
            for (int k = 0; k < 3; ++k)
                share[k] = exp(-m->absorption[k] * length);
            const uint32_t photons = survivors(p, share);
            w->counts.absorbed += units_of(p) * (1 - (int64_t)photons);
            return photons;
        }
    }
#else
    (void)t, (void)w, (void)i, (void)length;
#endif
    return 1;
}

#if KERNEL_FEATURES & TRACER_MEDIA
static inline bool is_spectral(const tracer *t)
{
#if KERNEL_FEATURES & TRACER_SPECTRAL
    return t->spectral != NULL;
#else
    (void)t;
    return false;
#endif
}

/* The luminance in each of a path's colours. */
static inline void shares(const path *p, double share[3])
{
    share[0] = 0.2126 * p->colour[0];
    share[1] = 0.7152 * p->colour[1];
    share[2] = 0.0722 * p->colour[2];
}

/* Light that came out of a solid by a hole must not wander for ever in a medium without end. */
static bool within_model(const tracer *t, lmg_vec3 p)
{
    const lmg_vec3 lo = t->model->bounds_min, hi = t->model->bounds_max;
    const double e = t->near;
    return p.x >= lo.x - e && p.y >= lo.y - e && p.z >= lo.z - e && p.x <= hi.x + e && p.y <= hi.y + e && p.z <= hi.z + e;
}

/*
 * Where a scattering that fell short of a surface by (length - t) puts the photon.  Rounding of the surface's place must not let it
 * through: within the hit's error bound of the surface it is moved along the normal, to where a ray leaving the surface would
 * start.
 */
static lmg_vec3 scattering_place(lmg_vec3 origin, lmg_vec3 d, double t, const lum_hit *hit)
{
    lmg_vec3 p = {origin.x + t * d.x, origin.y + t * d.y, origin.z + t * d.z};
    if (hit->triangle != LUM_MISS) {
        const double cosine = d.x * hit->ng.x + d.y * hit->ng.y + d.z * hit->ng.z, gap = (hit->t - t) * fabs(cosine);
        if (gap < hit->error) {
            const double shift = cosine > 0 ? gap - hit->error : hit->error - gap;
            p = (lmg_vec3){p.x + shift * hit->ng.x, p.y + shift * hit->ng.y, p.z + shift * hit->ng.z};
        }
    }
    return p;
}

#if KERNEL_FEATURES & TRACER_SPECTRAL
/* The flight of a path of several wavelengths through the medium inside a solid, or (m NULL) through the volumes outside. */
static inline uint32_t fly_waves(const tracer *t, worker *w, uint32_t i, const tracer_medium *m, double length, lum_flight *flight)
{
    path *p = &w->path[i];
    float share[LUM_WAVES];
    if (m) {
        const int32_t material = p->inside[p->nested - 1];
        const lum_phosphor *phosphor = t->spectral->materials[material].filling;
        double taken[LUM_WAVES];
        const bool passed =
            lum_waves_fly(t->spectral, material, &m->inside, length, &p->rng, &p->waves, share, phosphor ? taken : NULL, &flight->t);
        flight->event = passed ? LUM_FLIGHT_PASSED : LUM_FLIGHT_SCATTERED;
        flight->g = m->inside.g;
        if (phosphor && !passed) {
            bool converted;
            if (!convert(t, w, p, phosphor, taken, share, &converted))
                return 0;
            if (converted)
                flight->g = 0; /* what particles emit goes to all sides */
            return 1;
        }
    } else {
        double colours[3];
        lum_waves_colours(t->spectral, &p->waves, colours);
        lum_volumes_fly(t->volumes, w->origin[i], w->direction[i], length, colours, &p->rng, flight);
        if (flight->event == LUM_FLIGHT_ABSORBED) {
            w->counts.absorbed += p->units;
            return 0;
        }
        lum_waves_factors(t->spectral, flight->factor, &p->waves, share);
    }
    return survives(w, p, share);
}
#endif

/* Draws how far path i would go in a medium. */
static inline void draw_reach(worker *w, uint32_t i, const lum_medium *m)
{
    double share[3];
    shares(&w->path[i], share);
    w->reach[i] = lum_medium_draw(m, share, &w->path[i].rng);
}

/* What happens to path i on its way of w->reach[i] in a medium of R,G,B that a surface ends at `length`: the number of photons that
 * go on. */
static inline uint32_t fly_in_medium(worker *w, uint32_t i, const lum_medium *m, double length, lum_flight *flight)
{
    path *p = &w->path[i];
    uint32_t photons;
    if (m->grey) { /* by far the most media; lum_medium_arrive does the same */
        const bool passed = w->reach[i] >= length;
        photons = passed || !lum_medium_absorbs(m, &p->rng);
        flight->event = passed ? LUM_FLIGHT_PASSED : LUM_FLIGHT_SCATTERED;
        flight->t = passed ? length : w->reach[i];
        flight->g = m->g;
    } else {
        double share[3];
        shares(p, share);
        lum_medium_arrive(m, w->reach[i], length, share, &p->rng, flight);
        photons = flight->event == LUM_FLIGHT_ABSORBED ? 0 : survivors(p, flight->factor);
    }
    w->counts.absorbed += units_of(p) * (1 - (int64_t)photons);
    return photons;
}

/* What happens to path i on its way to its hit, or out of the model, in a medium or in clear space: as fly; *scattered: it didn't
 * get there, and starts anew from where it is. */
static inline uint32_t fly_through(const tracer *t, worker *w, uint32_t i, bool *scattered)
{
    path *p = &w->path[i];
    const lum_hit *hit = &w->hit[i];
    const bool miss = hit->triangle == LUM_MISS;
    const double length = miss ? (double)INFINITY : hit->t;
    const tracer_medium *m = p->nested > 0 ? &t->media[p->inside[p->nested - 1]] : NULL;
    *scattered = false;
    w->left[i] = LUM_MISS; /* unless it leaves a surface now */
    if (m ? !m->scatters : !t->volumes)
        return miss ? 1 : fly(t, w, i, length);
    if (m && miss && (!(w->reach[i] >= 0 && isfinite(w->reach[i])) || !within_model(t, w->origin[i])))
        return 1; /* out of a solid with a hole: escape() counts it */
    lum_flight flight;
    uint32_t photons;
#if KERNEL_FEATURES & TRACER_SPECTRAL
    if (t->spectral) {
        photons = fly_waves(t, w, i, m, length, &flight);
    } else
#endif
        if (m) {
        if (w->reach[i] < 0) /* it has just turned out to have been born inside */
            draw_reach(w, i, &m->inside);
        photons = fly_in_medium(w, i, &m->inside, length, &flight);
    } else {
        double share[3];
        shares(p, share);
        lum_volumes_fly(t->volumes, w->origin[i], w->direction[i], length, share, &p->rng, &flight);
        photons = flight.event == LUM_FLIGHT_ABSORBED ? 0 : survivors(p, flight.factor);
        w->counts.absorbed += units_of(p) * (1 - (int64_t)photons);
    }
    if (photons == 0)
        return 0;
    if (flight.event == LUM_FLIGHT_SCATTERED) {
        *scattered = true;
        w->origin[i] = scattering_place(w->origin[i], w->direction[i], flight.t, hit);
#if KERNEL_FEATURES & TRACER_SURVEY
        note_effects(p, w->survey->scattering);
#endif
        const double xi[2] = {lum_rng_next(&p->rng), lum_rng_next(&p->rng)};
        w->direction[i] = lum_phase_sample(flight.g, w->direction[i], xi);
#if KERNEL_FEATURES & TRACER_POLARIZATION
        p->polarization = (lum_polarization){0};
#endif
    }
    return photons;
}
#endif

#if KERNEL_FEATURES & TRACER_BACKWARD
/* Adds what a surface emits towards the eye. */
static inline void see_emission(path *p, const lum_surface *surface)
{
    for (int k = 0; k < 3; ++k)
        p->radiance[k] += p->colour[k] * (double)surface->emission[k] * (double)surface->coverage;
}

/*
 * Scattering sampled as if the path was a photon: what makes its weight that of radiance that travels the other way, from s->wo to
 * v. The density of light that way over the density this way, times |cos(ng, wo)| / |cos(ng, v)| [veach1997thesis]: 1 by
 * reciprocity on a flat surface, (n_v / n_wo)^2 across a boundary.  False when no light can come that way.
 */
static bool adjoint_weight(path *p, const lum_surface *surface, const lum_scene *scene, const lum_hit *hit, float index, lmg_vec3 v,
                           lum_scattered *s)
{
    double factor = 1;
    if (s->event & LUM_BOUNDARY) {
        const double step = (double)(surface->front ? index / surface->ior : surface->ior / index);
        factor = step * step;
        p->gain *= factor;
    }
    if (surface->tilted) {
        const lmg_vec3 g = hit->ng, n = surface->ns, o = s->wo;
        const double cos_v = fabs(g.x * v.x + g.y * v.y + g.z * v.z), cos_o = fabs(g.x * o.x + g.y * o.y + g.z * o.z);
        if (!(cos_v > 0))
            return false;
        const double cosines = cos_o / cos_v;
        if (!(s->event & LUM_DELTA)) {
            lum_surface lit;
            lum_surface_at(scene, hit, (lmg_vec3){-o.x, -o.y, -o.z}, &lit);
            float there[3], back[3];
            lum_scatter_eval(surface, v, o, index, there);
            lum_scatter_eval(&lit, o, v, index, back);
            for (int k = 0; k < 3; ++k)
                s->weight[k] *= there[k] > 0 ? back[k] / there[k] * (float)cosines : 0;
            return s->weight[0] + s->weight[1] + s->weight[2] > 0;
        }
        factor *= cosines;
        /* A delta maps solid angles by (n_o^2 cos_o) / (n_i^2 cos_i), cosines with the shading normal; mirrors keep those. */
        if (s->event & LUM_BOUNDARY) {
            const double shade_v = fabs(n.x * v.x + n.y * v.y + n.z * v.z), shade_o = fabs(n.x * o.x + n.y * o.y + n.z * o.z);
            factor = shade_o > 0 ? factor * shade_v / shade_o : 0;
        }
    }
    for (int k = 0; k < 3; ++k)
        s->weight[k] *= (float)factor;
    return factor > 0;
}
#endif

static inline int32_t material_of(const tracer *t, const lum_encounter *e)
{
    return (int32_t)(e->surface.material - t->model->materials);
}

/* Passes by what path i, standing for `photons` equal ones, has met: from `origin` on, in the same direction. */
static inline bool pass_by(worker *w, uint32_t i, uint32_t photons, lmg_vec3 origin)
{
    w->origin[i] = origin;
    put_aside(w, i, photons - 1);
    return true;
}

/* Completes and keeps the encounter after the last of w->met, of which the surface is known, for scattering.  outside: the solid on
 * the front side of the surface, or -1. */
static inline void keep_encounter(const tracer *t, worker *w, uint32_t i, uint32_t photons, int32_t outside)
{
    path *p = &w->path[i];
    lum_encounter *e = &w->met[w->met_count];
#if KERNEL_FEATURES & TRACER_SPECTRAL
    bool converted = false;
    if (t->spectral) {
        const int32_t material = material_of(t, e);
        const lum_wave_material *m = &t->spectral->materials[material];
        if (!choose_wave(t, w, p, material, outside))
            return;
        e->surface.ior = lum_waves_index(t->spectral, material, &p->waves, e->surface.ior);
        if (m->phosphor) {
            if (!meet_phosphor(t, w, p, m->phosphor, &converted))
                return;
            if (converted)
                e->surface.diffuse_transmission = (float)m->phosphor->forward;
        }
    }
    w->converted[w->met_count] = converted;
#endif
    for (int k = 0; k < 4; ++k)
        e->xi[k] = lum_rng_next(&p->rng);
#if KERNEL_FEATURES & TRACER_SOLIDS
    e->eta_outside = index_of_solid(t, p, outside);
#else
    (void)t, (void)outside;
    e->eta_outside = 1;
#endif
    e->polarization = NULL;
#if KERNEL_FEATURES & TRACER_POLARIZATION
    e->polarization = t->polarized ? &p->polarization : NULL;
#endif
    const lmg_vec3 d = w->direction[i];
    e->wi = (lmg_vec3){-d.x, -d.y, -d.z};
    w->met_path[w->met_count] = i;
    w->met_photons[w->met_count++] = photons;
}

/*
 * What happens at a surface to path i, now standing for `photons` equal ones, before scattering.  The encounter after the last of
 * w->met holds the surface; if light is scattered by it, it is completed and kept.  Otherwise returns whether the path goes on, with its
 * origin renewed.
 */
static inline bool meet(const tracer *t, worker *w, uint32_t i, uint32_t photons)
{
    const lum_hit *hit = &w->hit[i];
    const lum_surface *surface = &w->met[w->met_count].surface;
    int32_t outside = -1;
#if KERNEL_FEATURES & TRACER_BACKWARD
    see_emission(&w->path[i], surface);
#endif
#if KERNEL_FEATURES & TRACER_SOLIDS
    path *p = &w->path[i];
    const int32_t material = material_of(t, &w->met[w->met_count]);
    if (is_unnoticed(t, p, material, surface->front)) {
        if (!cross_boundary(t, p, material, surface->front)) {
            w->counts.lost += photons * units_of(p);
            return false;
        }
        return pass_by(w, i, photons, straight_on(hit, w->origin[i], w->direction[i]));
    }
    outside = solid_outside(p, material, surface->front);
#endif
    if (HAS(TRACER_COVERAGE) && surface->coverage < 1 && lum_rng_next(&w->path[i].rng) >= (double)surface->coverage)
        return pass_by(w, i, photons, lum_offset(hit, w->direction[i]));
    keep_encounter(t, w, i, photons, outside);
    return false;
}

#if KERNEL_FEATURES & TRACER_TOUCHING
/* Beyond layer here->at, to the next one or (false) off the place. */
static bool pass_layer(path *p, crossing *here)
{
    if (here->at == here->boundary)
        change_sides(p, here);
    here->at += here->back ? UINT32_MAX : 1; /* from layer 0 back: beyond all */
    if (here->at == here->boundary && here->at == here->layer_count)
        change_sides(p, here); /* no layer stands for the boundaries */
    return here->at < here->layer_count;
}

/* The same where several surfaces lie on each other, from layer w->here[i].at on. */
static bool meet_layers(const tracer *t, worker *w, uint32_t i, uint32_t photons)
{
    path *p = &w->path[i];
    crossing *here = &w->here[i];
    lum_encounter *e = &w->met[w->met_count];
    if (here->layer_count == 0)
        change_sides(p, here);
    for (bool more = here->layer_count > 0; more; more = pass_layer(p, here)) {
        w->hit[i] = here->layers[here->at];
        lum_surface_at(t->scene, &w->hit[i], w->direction[i], &e->surface);
        const int32_t material = material_of(t, e), other = here->nested > 0 ? here->inside[here->nested - 1] : -1;
        const tracer_medium *m = &t->media[material];
        if (m->bare && !t->spectral && index_of_solid(t, p, innermost(p)) == index_of_solid(t, p, other))
            continue;
        if (e->surface.coverage < 1 && lum_rng_next(&p->rng) >= (double)e->surface.coverage)
            continue;
#if KERNEL_FEATURES & TRACER_SURVEY
        note_effects(p, w->survey->effects[material] & ~BAKE_EMISSION_BITS);
#endif
        keep_encounter(t, w, i, photons, m->solid && !e->surface.front ? other : innermost(p));
        return false;
    }
    const lum_hit *hit = &w->hit[i];
    return pass_by(w, i, photons,
                   here->turned ? lum_offset(hit, w->direction[i]) : straight_on(hit, w->origin[i], w->direction[i]));
}
#endif

/* What happens after the scattering of encounter k: whether its path goes on, with origin and direction renewed. */
static inline bool leave(const tracer *t, worker *w, uint32_t k)
{
    const uint32_t i = w->met_path[k];
    uint32_t photons = w->met_photons[k];
    path *p = &w->path[i];
    const lum_hit *hit = &w->hit[i];
    lum_encounter *e = &w->met[k];
    lum_scattered *s = &e->out;
    if (!(s->event & (LUM_REFLECTED | LUM_TRANSMITTED))) {
        w->counts.absorbed += photons * units_of(p);
        return false;
    }
#if KERNEL_FEATURES & TRACER_BACKWARD
    if (!adjoint_weight(p, &e->surface, t->scene, hit, e->eta_outside, e->wi, s))
        return false;
#endif
    const double share[3] = {(double)s->weight[0], (double)s->weight[1], (double)s->weight[2]};
    if (!isfinite(s->wo.x + s->wo.y + s->wo.z + share[0] + share[1] + share[2])) {
        w->counts.lost += photons * units_of(p);
        return false;
    }
#if KERNEL_FEATURES & TRACER_SPECTRAL
    if (t->spectral) {
        if (!w->converted[k] && !survives_surface(t, w, p, material_of(t, e), s))
            return false;
    } else
#endif
    {
        const uint32_t each = survivors(p, share);
        w->counts.absorbed += units_of(p) * (int64_t)photons * (1 - (int64_t)each);
        photons *= each;
    }
    if (photons == 0)
        return false;
#if KERNEL_FEATURES & TRACER_TOUCHING
    crossing *here = &w->here[i];
    bool more = false;
    if (here->layer_count > 0) {
        if (s->event & LUM_TRANSMITTED) {
            more = pass_layer(p, here);
        } else {
            here->back = !here->back;
            here->at += here->back ? UINT32_MAX : 1;
            more = here->at < here->layer_count;
            if (here->at == here->boundary && !more && !here->back)
                change_sides(p, here);
        }
    } else
#endif
#if KERNEL_FEATURES & TRACER_SOLIDS
    if (s->event & LUM_BOUNDARY && !cross_boundary(t, p, material_of(t, e), e->surface.front)) {
        w->counts.lost += photons * units_of(p);
        return false;
    }
#else
    (void)t;
#endif
    const lmg_vec3 d = w->direction[i];
#if KERNEL_FEATURES & TRACER_TOUCHING
    if (more) {
        const double n = 1.5 - 0.5 * (s->wo.x * s->wo.x + s->wo.y * s->wo.y + s->wo.z * s->wo.z);
        w->direction[i] = (lmg_vec3){s->wo.x * n, s->wo.y * n, s->wo.z * n};
        here->turned = true;
        w->onward_path[w->onward_count] = i;
        w->onward_photons[w->onward_count++] = photons;
        return false;
    }
#endif
    if (s->wo.x == d.x && s->wo.y == d.y && s->wo.z == d.z) {
        w->origin[i] = pass_straight(hit, d);
    } else {
        w->origin[i] = lum_offset(hit, s->wo);
        /* One Newton step towards unit length: rounding doesn't add up over hundreds of bounces. */
        const double n = 1.5 - 0.5 * (s->wo.x * s->wo.x + s->wo.y * s->wo.y + s->wo.z * s->wo.z);
        w->direction[i] = (lmg_vec3){s->wo.x * n, s->wo.y * n, s->wo.z * n};
    }
#if KERNEL_FEATURES & TRACER_MEDIA
    w->left[i] = hit->triangle;
#endif
    if (photons > 1)
        put_aside(w, i, photons - 1);
    return true;
}

/* What happens to path i of the wave along its segment to a surface and there, up to scattering: whether it goes on, unless it is
 * kept among w->met, from where leave decides. */
static inline bool arrive(const tracer *t, worker *w, uint32_t i, uint32_t photons)
{
    const lum_hit *hit = &w->hit[i];
    ++w->path[i].segments;
    lum_encounter *e = &w->met[w->met_count];
    lum_surface_at(t->scene, hit, w->direction[i], &e->surface);
#if KERNEL_FEATURES & TRACER_SURVEY
    note_effects(&w->path[i], w->survey->effects[material_of(t, e)] & ~BAKE_EMISSION_BITS);
#endif
#if (KERNEL_FEATURES & TRACER_SOLIDS) && !(KERNEL_FEATURES & TRACER_MEDIA)
    if (!notice_birth_inside(t, &w->path[i], material_of(t, e), e->surface.front)) {
        w->counts.lost += units_of(&w->path[i]);
        return false;
    }
#endif
    if (!HAS(TRACER_MEDIA))
        photons = fly(t, w, i, hit->t);
    return photons > 0 && meet(t, w, i, photons);
}

#if KERNEL_FEATURES & (TRACER_MEDIA | TRACER_TOUCHING)
/* The same on the way through media, which may scatter light before it gets to a surface or out, and to surfaces that lie on each
 * other. */
static inline bool arrive_through(const tracer *t, worker *w, uint32_t i)
{
#if KERNEL_FEATURES & TRACER_MEDIA
    if (w->ended[i])
        return false;
#endif
    const lum_hit *hit = &w->hit[i];
    uint32_t photons = 1;
    bool alone = true;
#if KERNEL_FEATURES & TRACER_TOUCHING
    w->here[i].layer_count = 0;
    if (hit->triangle != LUM_MISS && !look_around(t, w, i, &alone)) {
        w->counts.lost += units_of(&w->path[i]);
        return false;
    }
#endif
#if KERNEL_FEATURES & TRACER_MEDIA
    if (hit->triangle != LUM_MISS && alone) {
        const lmg_vec3 d = w->direction[i];
        const bool front = d.x * hit->ng.x + d.y * hit->ng.y + d.z * hit->ng.z < 0;
        if (!notice_birth_inside(t, &w->path[i], t->model->triangle_material[hit->triangle], front)) {
            w->counts.lost += units_of(&w->path[i]);
            return false;
        }
    }
    bool scattered;
    photons = fly_through(t, w, i, &scattered);
    if (photons == 0)
        return false;
    if (scattered) {
        put_aside(w, i, photons - 1);
        return true;
    }
#endif
    if (hit->triangle == LUM_MISS) {
        for (uint32_t k = 0; k < photons; ++k)
            escape(t, w, i);
        return false;
    }
    if (alone)
        return arrive(t, w, i, photons);
#if KERNEL_FEATURES & TRACER_TOUCHING
    ++w->path[i].segments;
    if (!HAS(TRACER_MEDIA))
        photons = fly(t, w, i, hit->t);
    return photons > 0 && meet_layers(t, w, i, photons);
#else
    return false;
#endif
}
#endif

/* What happens to `count` paths from `first` on, from the start of their segments to that of the next: w->goes_on. */
static void interact(const tracer *t, worker *w, uint32_t first, uint32_t count)
{
    w->met_count = 0;
    w->counts.segments += count;
#if KERNEL_FEATURES & (TRACER_MEDIA | TRACER_TOUCHING)
    for (uint32_t i = first; i < first + count; ++i)
        w->goes_on[i] = arrive_through(t, w, i);
#else
    /* Which paths get out can't be foretold; listed without a branch, they cost no wrong guess. */
    uint32_t hits[WAVE], misses[WAVE], hit_count = 0, miss_count = 0;
    for (uint32_t i = first; i < first + count; ++i) {
        const bool miss = w->hit[i].triangle == LUM_MISS;
        hits[hit_count] = misses[miss_count] = i;
        hit_count += !miss;
        miss_count += miss;
    }
    for (uint32_t k = 0; k < miss_count; ++k) {
        w->goes_on[misses[k]] = false;
        escape(t, w, misses[k]);
    }
    for (uint32_t k = 0; k < hit_count; ++k)
        w->goes_on[hits[k]] = arrive(t, w, hits[k], 1);
#endif
#if KERNEL_FEATURES & TRACER_TOUCHING
    while (w->met_count > 0) {
        w->onward_count = 0;
        lum_scatter_trace_many(w->met_count, w->met);
        for (uint32_t k = 0; k < w->met_count; ++k)
            w->goes_on[w->met_path[k]] = leave(t, w, k);
        w->met_count = 0;
        for (uint32_t k = 0; k < w->onward_count; ++k) {
            const uint32_t i = w->onward_path[k], photons = w->onward_photons[k];
            if (++w->path[i].segments >= RUNAWAY_SEGMENTS)
                w->counts.lost += photons * units_of(&w->path[i]);
            else
                w->goes_on[i] = meet_layers(t, w, i, photons);
        }
    }
#else
    lum_scatter_trace_many(w->met_count, w->met);
    for (uint32_t k = 0; k < w->met_count; ++k)
        w->goes_on[w->met_path[k]] = leave(t, w, k);
#endif
}

#if KERNEL_FEATURES & TRACER_BACKWARD
/* Starts ray k of the job's list as path i of the wave. */
static inline bool start_backward(const tracer_job *j, worker *w, uint32_t i, uint64_t k)
{
    const lmg_ray *ray = &j->rays[k];
    const lmg_vec3 centre = j->tracer->model->centre, o = ray->origin, d = ray->direction;
    path *p = &w->path[i];
    memset(p, 0, sizeof(*p));
    p->number = k;
    p->rng = lum_rng_stream(j->tracer->seed, ray->number);
    p->gain = 1;
    p->colour[0] = p->colour[1] = p->colour[2] = 1;
    w->origin[i] = (lmg_vec3){o.x - centre.x, o.y - centre.y, o.z - centre.z};
    w->direction[i] = (lmg_vec3){-d.x, -d.y, -d.z};
    ++w->counts.photons;
    return true;
}
#else
/* Draws the light of the next photons of the chunk, in the order of order_photons. */
static void draw(const tracer *t, worker *w, uint64_t first, uint32_t next, uint32_t count)
{
    w->drawn_count = count - next < LUM_PHOTONS ? count - next : LUM_PHOTONS;
    w->drawn_next = 0;
    for (uint32_t k = 0; k < w->drawn_count; ++k)
        w->drawn.number[k] = first + w->order[next + k];
    lum_emitters_sample_many(t->emitters, t->seed, w->drawn_count, &w->drawn);
}

/* Starts the next photon drawn as path i of the wave; false if it is lost at once. */
static inline bool start(const tracer *t, worker *w, uint32_t i)
{
    const lum_photons *drawn = &w->drawn;
    const uint32_t k = w->drawn_next++;
    path *p = &w->path[i];
    p->number = drawn->number[k];
    p->rng.state = drawn->rng[k];
    p->segments = 0;
#if KERNEL_FEATURES & TRACER_SOLIDS
    p->nested = 0;
#endif
#if KERNEL_FEATURES & TRACER_POLARIZATION
    p->polarization = (lum_polarization){0};
#endif
#if KERNEL_FEATURES & TRACER_SURVEY
    p->met = drawn->material[k] >= 0 ? w->survey->effects[drawn->material[k]] & BAKE_EMISSION_BITS : w->survey->lights;
    p->polarized_once = false;
#endif
    for (int c = 0; c < 3; ++c)
        p->colour[c] = drawn->colour[c][k];
    const lmg_vec3 o = {drawn->origin[0][k], drawn->origin[1][k], drawn->origin[2][k]};
    const lmg_vec3 d = {drawn->direction[0][k], drawn->direction[1][k], drawn->direction[2][k]};
    w->origin[i] = o;
    w->direction[i] = d;
    ++w->counts.photons;
#if KERNEL_FEATURES & TRACER_SPECTRAL
    p->units = TRACER_UNITS(KERNEL_FEATURES);
#endif
    if (!isfinite(o.x + o.y + o.z + d.x + d.y + d.z + p->colour[0] + p->colour[1] + p->colour[2])) {
        w->counts.lost += units_of(p);
        return false;
    }
#if KERNEL_FEATURES & TRACER_SPECTRAL
    if (t->spectral) {
        const float rgb[3] = {(float)p->colour[0], (float)p->colour[1], (float)p->colour[2]};
        const double wave = lum_rng_next(&p->rng);
        return change_luminance(w, p, lum_waves_emit(t->spectral, drawn->material[k], rgb, wave, &p->waves));
    }
#else
    (void)t;
#endif
    return true;
}
#endif

/* ---------------------------------------------------------------------------------------------------------- the wave */

/* Copies the origins and directions of the wave's rays for the benchmark. */
static void record(tracer_job *j, const worker *w)
{
    for (uint32_t i = 0; i < w->alive && j->record_count < j->record_capacity; ++i) {
        float *r = j->record + 6 * j->record_count++;
        const lmg_vec3 o = w->origin[i], d = w->direction[i];
        r[0] = (float)o.x, r[1] = (float)o.y, r[2] = (float)o.z;
        r[3] = (float)d.x, r[4] = (float)d.y, r[5] = (float)d.z;
    }
}

/* Puts the photons first .. first+count-1 (count at most BAKE_CHUNK) in the order of the emitting triangle that they choose,
 * roughly: neighbours in this order start close together and find the emitter, and the tree around it, in the cache. */
static void order_photons(const tracer *t, worker *w, uint64_t first, uint32_t count)
{
    enum { BUCKETS = 512, FEW = 64 };
    uint16_t bucket[BAKE_CHUNK], start_of[BUCKETS + 1] = {0};
    if (lum_emitters_count(t->emitters) <= FEW) { /* all are in the cache */
        for (uint32_t i = 0; i < count; ++i)
            w->order[i] = (uint16_t)i;
        return;
    }
    lum_emitters_parts(t->seed, first, count, BUCKETS, bucket);
    for (uint32_t i = 0; i < count; ++i)
        ++start_of[bucket[i] + 1];
    for (uint32_t b = 0; b < BUCKETS; ++b)
        start_of[b + 1] = (uint16_t)(start_of[b + 1] + start_of[b]);
    for (uint32_t i = 0; i < count; ++i)
        w->order[start_of[bucket[i]]++] = (uint16_t)i;
}

#if KERNEL_FEATURES & TRACER_MEDIA
/* Of paths that certainly meet no surface before the end of their reach: those that are scattered there, the rest has ended.
 * Returns their number. */
static inline uint32_t scatter_in_place(const tracer *t, worker *w, uint32_t count, uint32_t *list)
{
    lum_phase_columns columns;
    uint32_t kept = 0, copies[WAVE];
    for (uint32_t k = 0; k < count; ++k) {
        const uint32_t i = list[k];
        path *p = &w->path[i];
        const lum_medium *m = &t->media[p->inside[p->nested - 1]].inside;
        lum_flight flight;
        const uint32_t photons = fly_in_medium(w, i, m, (double)INFINITY, &flight);
        if (photons == 0) {
            w->ended[i] = true;
            continue;
        }
#if KERNEL_FEATURES & TRACER_SURVEY
        note_effects(p, w->survey->scattering);
#endif
#if KERNEL_FEATURES & TRACER_POLARIZATION
        p->polarization = (lum_polarization){0};
#endif
        copies[kept] = photons - 1;
        const lmg_vec3 o = w->origin[i], d = w->direction[i];
        w->origin[i] = (lmg_vec3){o.x + flight.t * d.x, o.y + flight.t * d.y, o.z + flight.t * d.z};
        columns.g[kept] = flight.g;
        columns.xi[0][kept] = lum_rng_next(&p->rng);
        columns.xi[1][kept] = lum_rng_next(&p->rng);
        columns.direction[0][kept] = d.x;
        columns.direction[1][kept] = d.y;
        columns.direction[2][kept] = d.z;
        w->left[i] = LUM_MISS;
        list[kept++] = i;
    }
    lum_phase_sample_many(kept, &columns);
    for (uint32_t k = 0; k < kept; ++k) {
        const uint32_t i = list[k];
        w->direction[i] = (lmg_vec3){columns.direction[0][k], columns.direction[1][k], columns.direction[2][k]};
        put_aside(w, i, copies[k]);
    }
    w->counts.segments += kept;
    return kept;
}

/*
 * Draws how far `count` paths from `first` on go in the medium around them: w->reach.  Where that certainly meets no surface they
 * are scattered at once, again and again; so in a dense medium a path takes many steps in its turn, of all that a surface needs
 * none.
 */
static inline void wander(const tracer *t, worker *w, uint32_t first, uint32_t count)
{
    enum { STEPS = 64 }; /* then it's the others' turn */
    uint32_t list[WAVE], left = 0;
    for (uint32_t i = first; i < first + count; ++i) {
        const path *p = &w->path[i];
        w->reach[i] = -1;
        w->ended[i] = false;
        list[left] = i;
        left += p->nested > 0 && t->media[p->inside[p->nested - 1]].scatters && !is_spectral(t);
    }
    for (uint32_t step = 0; left > 0; ++step) {
        for (uint32_t k = 0; k < left; ++k) {
            const path *p = &w->path[list[k]];
            draw_reach(w, list[k], &t->media[p->inside[p->nested - 1]].inside);
        }
        if (step == STEPS || !t->clearance)
            return;
        bool clear[WAVE];
        uint32_t cleared = 0;
        lum_clearance_many(t->clearance, left, list, w->origin, w->direction, w->reach, w->left, clear);
        for (uint32_t k = 0; k < left; ++k) {
            list[cleared] = list[k];
            cleared += clear[k];
        }
        left = scatter_in_place(t, w, cleared, list);
    }
}
#endif

/* What the rays of `count` paths from `first` on meet.  In a medium the next event is drawn before, and surfaces beyond it aren't
 * looked for. */
static inline void find_hits(const tracer *t, worker *w, uint32_t first, uint32_t count)
{
#if KERNEL_FEATURES & TRACER_MEDIA
    double reach[WAVE];
    wander(t, w, first, count);
    for (uint32_t i = first; i < first + count; ++i) {
        reach[i] = w->reach[i] < 0 ? (double)INFINITY : w->reach[i] + t->near;
    }
    lum_scene_intersect_within(t->scene, count, w->origin + first, w->direction + first, reach + first, w->hit + first);
#else
    lum_scene_intersect_many(t->scene, count, w->origin + first, w->direction + first, w->hit + first);
#endif
}

/* Follows a long path to its end, or until it is given up. */
static void follow_alone(const tracer *t, worker *w, uint32_t i)
{
    for (;;) {
        find_hits(t, w, i, 1);
        interact(t, w, i, 1);
        if (!w->goes_on[i])
            return;
        if (w->path[i].segments >= RUNAWAY_SEGMENTS) {
            w->counts.lost += units_of(&w->path[i]);
            if (w->trap.trapped < TRACER_TRAPPED_KEPT)
                w->trap.triangle[w->trap.trapped] = w->hit[i].triangle;
            ++w->trap.trapped;
            return;
        }
    }
}

/* Follows the wave's long paths to their ends; false when too many of `started` photons turned out to be trapped. */
static bool follow_long(const tracer *t, worker *w, uint32_t started)
{
    for (uint32_t i = 0; i < w->alive; ++i) {
        if (!w->goes_on[i] || w->path[i].segments < LONG_SEGMENTS)
            continue;
        follow_alone(t, w, i);
        w->goes_on[i] = false;
        if (w->trap.trapped > TRAP_COUNT + TRAP_SHARE * started)
            return false;
    }
    return true;
}

/* Path i has ended. */
static inline void finish(const tracer *t, worker *w, uint32_t i)
{
#if KERNEL_FEATURES & TRACER_SURVEY
    note_end(t, w, i);
#endif
#if KERNEL_FEATURES & TRACER_BACKWARD
    for (int k = 0; k < 3; ++k)
        w->radiance[w->path[i].number][k] = (float)w->path[i].radiance[k];
#endif
    (void)t, (void)w, (void)i;
}

/* Puts a path that waits, or the next photon of the chunk, in place i of the wave; false if there is none. */
static inline bool refill(const tracer_job *j, worker *w, uint32_t i, uint64_t first, uint32_t count, uint32_t *next)
{
    if (w->pending_count > 0) {
        const waiting_path *p = &w->pending[--w->pending_count];
        w->origin[i] = p->origin;
        w->direction[i] = p->direction;
        w->path[i] = p->path;
        return true;
    }
    while (*next < count) {
#if KERNEL_FEATURES & TRACER_BACKWARD
        if (start_backward(j, w, i, first + (*next)++))
            return true;
#else
        if (w->drawn_next == w->drawn_count)
            draw(j->tracer, w, first, *next, count);
        ++*next;
        if (start(j->tracer, w, i))
            return true;
#endif
    }
    return false;
}

/* Traces photons first .. first+count-1 (count at most BAKE_CHUNK) to their ends, or until too many are trapped. */
static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    tracer_job *j = self;
    const tracer *t = j->tracer;
    worker *w = state;
    if (atomic_load_explicit(&j->stopped, memory_order_relaxed))
        return;
    if (!HAS(TRACER_BACKWARD))
        order_photons(t, w, first, (uint32_t)count);
    w->trap.started = w->trap.trapped = 0;
    w->drawn_next = w->drawn_count = 0;
    uint32_t next = 0, free_count = WAVE;
    uint32_t free_place[WAVE]; /* of the wave, in ascending order */
    for (uint32_t i = 0; i < WAVE; ++i)
        free_place[i] = i;
    w->alive = WAVE;
    for (;;) {
        /* From the last on: where nothing is left to start, what the last path leaves free has been dealt with. */
        while (free_count > 0) {
            const uint32_t i = free_place[--free_count];
#if KERNEL_FEATURES & TRACER_MEDIA
            w->left[i] = LUM_MISS;
#endif
            if (refill(j, w, i, first, (uint32_t)count, &next))
                continue;
            const uint32_t last = --w->alive;
            w->origin[i] = w->origin[last];
            w->direction[i] = w->direction[last];
            w->path[i] = w->path[last];
#if KERNEL_FEATURES & TRACER_MEDIA
            w->left[i] = w->left[last];
#endif
        }
        if (w->alive == 0)
            return;
        if (j->record)
            record(j, w);
        find_hits(t, w, 0, w->alive);
        interact(t, w, 0, w->alive);
        bool some_long = false;
        for (uint32_t i = 0; i < w->alive; ++i)
            some_long |= w->path[i].segments >= LONG_SEGMENTS;
        if (some_long && !follow_long(t, w, next)) {
            if (!atomic_flag_test_and_set(&j->trap_taken)) {
                w->trap.started = next;
                j->trap = w->trap;
            }
            atomic_store(&j->stopped, true);
            return;
        }
        for (uint32_t i = 0; i < w->alive; ++i) {
            free_place[free_count] = i;
            free_count += !w->goes_on[i];
        }
        if (HAS(TRACER_SURVEY) || HAS(TRACER_BACKWARD))
            for (uint32_t k = 0; k < free_count; ++k)
                finish(t, w, free_place[k]);
    }
}

static void *begin(void *self)
{
    const tracer_job *j = self;
    worker *w = malloc(sizeof(*w));
    if (w) {
        memset(&w->counts, 0, sizeof(w->counts));
        w->alive = w->pending_count = 0;
        w->survey = j->survey;
        w->radiance = j->radiance;
        w->batch.sinks = j->sinks;
        w->batch.sink_count = j->sink_count;
        w->batch.count = 0;
    }
    return w;
}

static void end(void *self, void *state)
{
    tracer_job *j = self;
    worker *w = state;
    bake_batch_flush(&w->batch);
    j->counts.photons += w->counts.photons;
    j->counts.escaped += w->counts.escaped;
    j->counts.escaped_squares += w->counts.escaped_squares;
    j->counts.absorbed += w->counts.absorbed;
    j->counts.lost += w->counts.lost;
    j->counts.lost_inside += w->counts.lost_inside;
    j->counts.segments += w->counts.segments;
    free(w);
}

#define KERNEL_TEXT_OF(name) #name
#define KERNEL_TEXT(name) KERNEL_TEXT_OF(name)
const tracer_kernel KERNEL_NAME = {KERNEL_TEXT(KERNEL_NAME), KERNEL_FEATURES, begin, chunk, end};
