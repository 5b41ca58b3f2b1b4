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
 * Solid dielectrics: the photon remembers which it is inside of (counted by material, innermost last); the innermost gives the
 * index on the other side of the next boundary and the absorption on the way there (Beer-Lambert, as survival).  Light that leaves
 * the model while still inside a solid came through a hole in its boundary: lost, and counted apart, as the model has to be mended.
 *
 * Path state is in double, in the model's frame minus its centre; rays are handed out in the luminaire's own frame.
 */
#include "tracer.h"

#include "batch.h"
#include "parallel.h"

#include <luminaires/model.h>
#include <luminaires/rng.h>
#include <luminaires/scatter.h>
#include <luminaires/scene.h>

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* How deep solids may be nested; deeper counts as lost. */
enum { MAX_NESTED = 8 };
/* A guard against light that goes round for ever in a lossless closed model (counted as lost), far beyond any light guide. */
static const uint32_t RUNAWAY_SEGMENTS = 1000000;
/* Photons that wait because one became several.  On average one becomes at most one, so a few suffice; more count as lost. */
enum { MAX_PENDING = 64 };

typedef struct path {
    double colour[3]; /* luminance 1 */
    lum_rng rng;
    uint64_t number;
    uint32_t segments;
    uint32_t nested;
    int32_t inside[MAX_NESTED]; /* materials of the solids around, innermost last */
    lum_polarization polarization;
} path;

/* A path that waits, with its ray. */
typedef struct waiting_path {
    lmg_vec3 origin, direction;
    path path;
} waiting_path;

/* What the loop needs of a material, in one cache line per few materials. */
typedef struct medium {
    bool solid, absorbs;
    float ior;
    double absorption[3]; /* 1/m */
} medium;

typedef struct tracer {
    bake_source source; /* first: a bake_source is cast back to its tracer */
    const lum_model *model;
    lum_scene *scene;
    lum_emitters *emitters;
    medium *media; /* per material */
    uint64_t seed;
} tracer;

typedef struct counts {
    int64_t photons, escaped, absorbed, lost, lost_inside, segments;
} counts;

typedef struct job {
    const tracer *tracer;
    const lmg_sink *sinks;
    size_t sink_count;
    counts counts;
} job;

/*
 * A thread follows WAVE paths side by side, one segment each in turn: their rays are traced together, then all hits are worked on.
 * The memory that a hit needs is on its way meanwhile, and code and branches stay warm; a path's result doesn't depend on its
 * company.
 */
enum { WAVE = 32 };

typedef struct worker {
    counts counts;
    uint32_t alive; /* paths in the wave: the first ones */
    lmg_vec3 origin[WAVE], direction[WAVE];
    lum_hit hit[WAVE];
    path path[WAVE];
    uint32_t pending_count;
    waiting_path pending[MAX_PENDING];
    uint16_t order[BAKE_CHUNK]; /* of a chunk's photons: order_photons */
    float *record;              /* benchmark only, else NULL */
    size_t record_count, record_capacity;
    bake_batch batch;
} worker;

static double next_number(void *state)
{
    return lum_rng_next(state);
}

static double luminance(const double c[3])
{
    return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
}

/*
 * How many photons go on, each with luminance 1, after an event that leaves the given share of each colour: mostly 0 or 1.  The
 * path's colour becomes theirs.
 */
static uint32_t survivors(path *p, const double share[3])
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

/* Puts copies of a multiplied photon aside; each goes on from where it is now, with random numbers of its own. */
static void put_aside(worker *w, uint32_t i, uint32_t copies)
{
    for (uint32_t k = 0; k < copies; ++k) {
        if (w->pending_count == MAX_PENDING) {
            ++w->counts.lost;
            continue;
        }
        waiting_path *copy = &w->pending[w->pending_count++];
        *copy = (waiting_path){w->origin[i], w->direction[i], w->path[i]};
        copy->path.rng.state = lum_mix64(copy->path.rng.state + k + 1);
    }
}

static bool is_inside(const path *p, int32_t material)
{
    for (uint32_t i = 0; i < p->nested; ++i)
        if (p->inside[i] == material)
            return true;
    return false;
}

/* Takes the innermost entry of material out. */
static void leave(path *p, int32_t material)
{
    for (uint32_t i = p->nested; i-- > 0;)
        if (p->inside[i] == material) {
            memmove(&p->inside[i], &p->inside[i + 1], (p->nested - i - 1) * sizeof(p->inside[0]));
            --p->nested;
            return;
        }
}

/* Index of the medium on the front side of a boundary of `material` that the path meets from the front or from inside. */
static float index_outside(const tracer *t, const path *p, int32_t material, bool front)
{
    uint32_t n = p->nested;
    if (!front && n > 0 && p->inside[n - 1] == material)
        --n;
    return n > 0 ? t->media[p->inside[n - 1]].ior : 1.0f;
}

static void escape(const tracer *t, worker *w, uint32_t i)
{
    const path *p = &w->path[i];
    if (p->nested > 0) {
        ++w->counts.lost;
        ++w->counts.lost_inside;
        return;
    }
    ++w->counts.escaped;
    const lmg_vec3 centre = t->model->centre, o = w->origin[i];
    lmg_ray *ray = bake_batch_next(&w->batch);
    ray->origin = (lmg_vec3){o.x + centre.x, o.y + centre.y, o.z + centre.z};
    ray->direction = w->direction[i];
    for (int k = 0; k < 3; ++k)
        ray->flux[k] = (float)p->colour[k];
    ray->wavelength = 0;
    ray->number = p->number;
}

/* What happens to path i of the wave at the end of its segment.  Returns whether it goes on. */
static bool interact(const tracer *t, worker *w, uint32_t i)
{
    path *p = &w->path[i];
    const lum_hit *hit = &w->hit[i];
    ++w->counts.segments;
    if (hit->triangle == LUM_MISS) {
        escape(t, w, i);
        return false;
    }
    if (++p->segments > RUNAWAY_SEGMENTS) {
        ++w->counts.lost;
        return false;
    }

    lum_surface surface;
    lum_surface_at(t->scene, hit, w->direction[i], &surface);
    const int32_t material = (int32_t)(surface.material - t->model->materials);
    if (t->media[material].solid && !surface.front && !is_inside(p, material)) {
        /* The path has been inside all along: it was born there.  Known from now on, and for this segment. */
        if (p->nested == MAX_NESTED) {
            ++w->counts.lost;
            return false;
        }
        memmove(&p->inside[1], &p->inside[0], p->nested * sizeof(p->inside[0]));
        p->inside[0] = material;
        ++p->nested;
    }

    uint32_t photons = 1; /* that go through the same event */
    if (p->nested > 0) {
        const medium *m = &t->media[p->inside[p->nested - 1]];
        if (m->absorbs) {
            double share[3];
            for (int k = 0; k < 3; ++k)
                share[k] = exp(-m->absorption[k] * hit->t);
            photons = survivors(p, share);
            w->counts.absorbed += 1 - (int64_t)photons;
            if (photons == 0)
                return false;
        }
    }

    if (surface.coverage < 1 && lum_rng_next(&p->rng) >= (double)surface.coverage) {
        w->origin[i] = lum_offset(hit, w->direction[i]);
    } else {
        double xi[4];
        for (int k = 0; k < 4; ++k)
            xi[k] = lum_rng_next(&p->rng);
        const lmg_vec3 d = w->direction[i], wi = {-d.x, -d.y, -d.z};
        lum_scattered s;
        lum_scatter_trace(&surface, wi, index_outside(t, p, material, surface.front), xi, &p->polarization, &s);
        if (!(s.event & (LUM_REFLECTED | LUM_TRANSMITTED))) {
            w->counts.absorbed += photons;
            return false;
        }
        const double share[3] = {(double)s.weight[0], (double)s.weight[1], (double)s.weight[2]};
        if (!isfinite(s.wo.x + s.wo.y + s.wo.z + share[0] + share[1] + share[2])) {
            w->counts.lost += photons;
            return false;
        }
        const uint32_t each = survivors(p, share);
        w->counts.absorbed += (int64_t)photons * (1 - (int64_t)each);
        photons *= each;
        if (photons == 0)
            return false;
        if (s.event & LUM_BOUNDARY) {
            if (!surface.front) {
                leave(p, material);
            } else if (p->nested < MAX_NESTED) {
                p->inside[p->nested++] = material;
            } else {
                w->counts.lost += photons;
                return false;
            }
        }
        w->origin[i] = lum_offset(hit, s.wo);
        /* One Newton step towards unit length: rounding doesn't add up over hundreds of bounces. */
        const double n = 1.5 - 0.5 * (s.wo.x * s.wo.x + s.wo.y * s.wo.y + s.wo.z * s.wo.z);
        w->direction[i] = (lmg_vec3){s.wo.x * n, s.wo.y * n, s.wo.z * n};
    }
    if (photons > 1)
        put_aside(w, i, photons - 1);
    return true;
}

/* Starts photon `number` as path i of the wave; false if it is lost at once. */
static bool start(const tracer *t, worker *w, uint32_t i, uint64_t number)
{
    path *p = &w->path[i];
    p->number = number;
    p->rng = lum_rng_stream(t->seed, number);
    p->segments = 0;
    p->nested = 0;
    p->polarization = (lum_polarization){0};
    double xi[6];
    for (int k = 0; k < 6; ++k)
        xi[k] = lum_rng_next(&p->rng);
    lum_photon photon;
    lum_emitters_sample(t->emitters, xi, next_number, &p->rng, &photon);
    ++w->counts.photons;
    w->origin[i] = photon.origin;
    w->direction[i] = photon.direction;
    for (int k = 0; k < 3; ++k)
        p->colour[k] = (double)photon.flux[k];
    const double y = luminance(p->colour); /* 1 to float precision */
    const lmg_vec3 o = photon.origin, d = photon.direction;
    if (!isfinite(o.x + o.y + o.z + d.x + d.y + d.z + y) || !(y > 0)) {
        ++w->counts.lost;
        return false;
    }
    const double scale = 1 / y;
    for (int k = 0; k < 3; ++k)
        p->colour[k] *= scale;
    return true;
}

/* Copies the origins and directions of the wave's rays for the benchmark. */
static void record(worker *w)
{
    for (uint32_t i = 0; i < w->alive && w->record_count < w->record_capacity; ++i) {
        float *r = w->record + 6 * w->record_count++;
        const lmg_vec3 o = w->origin[i], d = w->direction[i];
        r[0] = (float)o.x, r[1] = (float)o.y, r[2] = (float)o.z;
        r[3] = (float)d.x, r[4] = (float)d.y, r[5] = (float)d.z;
    }
}

/* Puts the photons first .. first+count-1 (count at most BAKE_CHUNK) in the order of their first random number, roughly: it chooses
 * the emitting triangle, so neighbours in this order start close together and find the emitter, and the tree around it, in the
 * cache. */
static void order_photons(const tracer *t, worker *w, uint64_t first, uint32_t count)
{
    enum { BUCKETS = 512 };
    uint16_t bucket[BAKE_CHUNK], start_of[BUCKETS + 1] = {0};
    for (uint32_t i = 0; i < count; ++i) {
        lum_rng rng = lum_rng_stream(t->seed, first + i);
        bucket[i] = (uint16_t)(lum_rng_next(&rng) * BUCKETS);
        ++start_of[bucket[i] + 1];
    }
    for (uint32_t b = 0; b < BUCKETS; ++b)
        start_of[b + 1] = (uint16_t)(start_of[b + 1] + start_of[b]);
    for (uint32_t i = 0; i < count; ++i)
        w->order[start_of[bucket[i]]++] = (uint16_t)i;
}

/* Traces photons first .. first+count-1 (count at most BAKE_CHUNK) to their ends. */
static void trace_photons(const tracer *t, worker *w, uint64_t first, uint64_t count)
{
    order_photons(t, w, first, (uint32_t)count);
    uint32_t next = 0;
    for (;;) {
        while (w->alive < WAVE) {
            if (w->pending_count > 0) {
                const waiting_path *p = &w->pending[--w->pending_count];
                w->origin[w->alive] = p->origin;
                w->direction[w->alive] = p->direction;
                w->path[w->alive++] = p->path;
            } else if (next < count) {
                w->alive += start(t, w, w->alive, first + w->order[next++]);
            } else {
                break;
            }
        }
        if (w->alive == 0)
            return;
        if (w->record)
            record(w);
        lum_scene_intersect_many(t->scene, w->alive, w->origin, w->direction, w->hit);
        for (uint32_t i = 0; i < w->alive;) {
            if (interact(t, w, i)) {
                ++i;
                continue;
            }
            /* the last one takes the place of the one that ended; its hit is still to be worked on */
            const uint32_t end_of_wave = --w->alive;
            w->origin[i] = w->origin[end_of_wave];
            w->direction[i] = w->direction[end_of_wave];
            w->hit[i] = w->hit[end_of_wave];
            w->path[i] = w->path[end_of_wave];
        }
    }
}

static void *begin(void *self)
{
    const job *j = self;
    worker *w = malloc(sizeof(*w));
    if (w) {
        memset(&w->counts, 0, sizeof(w->counts));
        w->alive = w->pending_count = 0;
        w->record = NULL;
        w->record_count = w->record_capacity = 0;
        w->batch.sinks = j->sinks;
        w->batch.sink_count = j->sink_count;
        w->batch.count = 0;
    }
    return w;
}

static void chunk(void *self, void *state, uint64_t first, uint64_t count)
{
    const job *j = self;
    trace_photons(j->tracer, state, first, count);
}

static void end(void *self, void *state)
{
    job *j = self;
    worker *w = state;
    bake_batch_flush(&w->batch);
    j->counts.photons += w->counts.photons;
    j->counts.escaped += w->counts.escaped;
    j->counts.absorbed += w->counts.absorbed;
    j->counts.lost += w->counts.lost;
    j->counts.lost_inside += w->counts.lost_inside;
    j->counts.segments += w->counts.segments;
    free(w);
}

static lmg_result run(bake_source *source, uint64_t first, uint64_t count, unsigned threads, const lmg_sink *sinks,
                      size_t sink_count, bake_tally *tally, lmg_error *err)
{
    job j = {.tracer = (const tracer *)source, .sinks = sinks, .sink_count = sink_count};
    const bake_work work = {.self = &j, .begin = begin, .chunk = chunk, .end = end};
    const lmg_result result = bake_parallel(&work, first, count, threads, err);
    if (result != LMG_OK)
        return result;
    tally->photons += (uint64_t)j.counts.photons;
    tally->emitted += (double)j.counts.photons;
    tally->escaped += (double)j.counts.escaped;
    tally->absorbed += (double)j.counts.absorbed;
    tally->lost += (double)j.counts.lost;
    tally->lost_inside += (double)j.counts.lost_inside;
    tally->segments += (uint64_t)j.counts.segments;
    return LMG_OK;
}

static void destroy(bake_source *source)
{
    tracer *t = (tracer *)source;
    if (!t)
        return;
    lum_emitters_destroy(t->emitters);
    lum_scene_destroy(t->scene);
    free(t->media);
    free(t);
}

/* Which materials bound solids, and what those absorb. */
static medium *list_media(const lum_model *model)
{
    medium *media = calloc(model->material_count ? model->material_count : 1, sizeof(*media));
    for (uint32_t i = 0; media && i < model->material_count; ++i) {
        const lum_material *m = &model->materials[i];
        media[i].solid = m->kind == LUM_SURFACE_PBR && !m->thin && m->transmission > 0;
        media[i].ior = m->ior;
        for (int c = 0; c < 3; ++c) {
            media[i].absorption[c] = (double)m->absorption[c];
            media[i].absorbs |= media[i].solid && m->absorption[c] > 0;
        }
    }
    return media;
}

lmg_result bake_tracer_create(const struct lum_model *model, uint64_t seed, bake_source **out, lmg_error *err)
{
    *out = NULL;
    tracer *t = calloc(1, sizeof(*t));
    if (!t)
        return lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the photon tracer");
    t->source.run = run;
    t->source.destroy = destroy;
    t->model = model;
    t->seed = seed;
    t->media = list_media(model);
    lmg_result result = t->media ? LMG_OK : lmg_fail(err, LMG_ERROR_MEMORY, "no memory for the photon tracer");
    if (result == LMG_OK)
        result = lum_emitters_create(model, &t->emitters, err);
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
        result = lum_scene_create(model, &t->scene, err);
    if (result != LMG_OK) {
        destroy(&t->source);
        return result;
    }
    /* Positions are floats relative to the centre: their rounding, and the offsets off surfaces, stay within a few units in the
     * last place of the largest coordinate.  A margin of 2^-20 of the size keeps every point of the luminaire inside the bounds. */
    const lmg_vec3 lo = model->bounds_min, hi = model->bounds_max, c = model->centre;
    const double margin =
        0x1p-20 * sqrt((hi.x - lo.x) * (hi.x - lo.x) + (hi.y - lo.y) * (hi.y - lo.y) + (hi.z - lo.z) * (hi.z - lo.z));
    t->source.bounds_min = (lmg_vec3){c.x + lo.x - margin, c.y + lo.y - margin, c.z + lo.z - margin};
    t->source.bounds_max = (lmg_vec3){c.x + hi.x + margin, c.y + hi.y + margin, c.z + hi.z + margin};
    *out = &t->source;
    return LMG_OK;
}

const struct lum_scene *bake_tracer_scene(const bake_source *source)
{
    return ((const tracer *)source)->scene;
}

size_t bake_tracer_record(const bake_source *source, uint64_t first, uint64_t count, float *rays, size_t capacity)
{
    job j = {.tracer = (const tracer *)source};
    worker *w = begin(&j);
    if (!w)
        return 0;
    w->record = rays;
    w->record_capacity = capacity;
    for (uint64_t i = 0; i < count && w->record_count < capacity; i += BAKE_CHUNK)
        trace_photons(j.tracer, w, first + i, count - i < BAKE_CHUNK ? count - i : BAKE_CHUNK);
    const size_t written = w->record_count;
    end(&j, w);
    return written;
}
