/* SPDX-License-Identifier: Apache-2.0 */
/* Albedo tables of rough lobes (microfacet.h), computed when a scene is made, for the indices and roughnesses its materials have.
 */
#include "microfacet.h"

#include "scene_data.h"

#include <stdlib.h>

/* Gauss-Legendre nodes and weights on [0,1], by Newton's method from Chebyshev's nodes. */
static void gauss_legendre(int n, double *x, double *w)
{
    for (int i = 0; i < n; i++) {
        double t = cos(LUM_PI * (i + 0.75) / (n + 0.5)), slope = 1;
        for (int step = 0; step < 100; step++) {
            double p0 = 1, p1 = t;
            for (int k = 2; k <= n; k++) {
                double p2 = ((2 * k - 1) * t * p1 - (k - 1) * p0) / k;
                p0 = p1;
                p1 = p2;
            }
            slope = n * (t * p1 - p0) / (t * t - 1);
            double dt = p1 / slope;
            t -= dt;
            if (fabs(dt) < 1e-15) {
                break;
            }
        }
        x[i] = 0.5 * (1 - t);
        w[i] = 1 / ((1 - t * t) * slope * slope);
    }
}

/* Points of the quadrature, Fibonacci numbers.  Off by at most (300000 points for comparison, n = 1.52): 2.7e-4 at roughness 0.1,
 * 1e-4 at 0.4; from the denser side, where total reflection begins with an infinite slope, 2.3e-4 with the larger number. */
enum { LATTICE_POINTS = 2584, MORE_LATTICE_POINTS = 10946 };

/* What a facet with normal m (cosine ci with wi) lets get away: reflected, and for LUM_LOBE_BOUNDARY refracted. */
static double facet_albedo(lum_lobe_kind kind, double alpha, double eta, lmg_vec3 wi, double lambda_i, lmg_vec3 m)
{
    double ci = fmin(vec_dot(wi, m), 1), sum = 0;
    if (!(ci > 0 && m.z > 0)) {
        return 0;
    }
    double f = kind == LUM_LOBE_METAL ? 1 : lum_fresnel_dielectric(ci, eta);
    double z = fmin(2 * ci * m.z - wi.z, 1);
    if (z > 0) {
        sum = f * (1 + lambda_i) / (1 + lambda_i + ggx_lambda(alpha, z, (1 - z) * (1 + z)));
    }
    if (kind == LUM_LOBE_BOUNDARY && f < 1) {
        double ct = sqrt(fmax(1 - (1 - ci) * (1 + ci) / (eta * eta), 0));
        z = fmin(wi.z / eta - (ci / eta - ct) * m.z, 1);
        if (z > 0) {
            sum += (1 - f) / (1 + ggx_lambda(alpha, z, (1 - z) * (1 + z)));
        }
    }
    return sum;
}

/*
 * The visible normals are h = c + v (stretched by alpha) with c uniform over the spherical cap z > -v.z [dupuy2023caps]: E is the
 * mean over c of what a facet's light gets away with.  That has kinks, along curves, where a direction becomes horizontal and where
 * total reflection begins, which product rules follow badly; a Fibonacci lattice [niederreiter1992random, ch. 5] meets each curve
 * at as many different places as it has points.
 */
double lum_lobe_albedo(lum_lobe_kind kind, double alpha, double eta, double mu, int n)
{
    if (alpha < (double)LUM_SMOOTH) {
        return kind == LUM_LOBE_COAT ? lum_fresnel_dielectric(mu, eta) : 1;
    }
    mu = mu > 1e-9 ? mu : 1e-9; /* the limit at grazing */
    lmg_vec3 wi = vec(sqrt((1 - mu) * (1 + mu)), 0, mu);
    lmg_vec3 v = vec_unit(vec(alpha * wi.x, 0, wi.z));
    double lambda_i = ggx_lambda(alpha, wi.z, wi.x * wi.x);
    uint64_t count = 1, before = 1;
    while (count < (uint64_t)n) {
        uint64_t next = count + before;
        before = count;
        count = next;
    }
    double sum = 0;
    for (uint64_t i = 0; i < count; i++) {
        double s, c, cz = 1 - ((double)i + 0.5) / (double)count * (1 + v.z);
        double r = sqrt(fmax((1 - cz) * (1 + cz), 0)), z = cz + v.z;
        sincos_turns((double)(i * before % count) / (double)count, &s, &c);
        lmg_vec3 m = vec_unit(vec(alpha * (r * c + v.x), alpha * r * s, z > 0 ? z : 0x1p-60));
        sum += facet_albedo(kind, alpha, eta, wi, lambda_i, m);
    }
    return sum / (double)count;
}

static double node(int j)
{
    double x = (double)j / LUM_LOBE_SEGMENTS;
    return x * x * x * x;
}

/* Cubic (Lagrange) through values at -1, 0, 1, 2. */
static double cubic(double a, double b, double c, double d, double t)
{
    return -t * (t - 1) * (t - 2) / 6 * a + (t + 1) * (t - 1) * (t - 2) / 2 * b - (t + 1) * t * (t - 2) / 2 * c +
           (t + 1) * t * (t - 1) / 6 * d;
}

/* 1 - E at the nodes: computed at every STEP-th. */
static void compute_rest(double rest[LUM_LOBE_SEGMENTS + 1], lum_lobe_kind kind, double alpha, double eta, int points)
{
    enum { STEP = LUM_LOBE_SEGMENTS / LUM_LOBE_COMPUTED_SEGMENTS, LAST = LUM_LOBE_COMPUTED_SEGMENTS };
    double computed[LAST + 1];
    for (int i = 0; i <= LAST; i++) {
        /* At q = 0 the limit: taken a little above it, where the quadrature still resolves the lobe. */
        double mu = sqrt(i ? node(i * STEP) : 1e-3 * node(STEP));
        computed[i] = 1 - lum_lobe_albedo(kind, alpha, eta, mu, points);
    }
    for (int j = 0; j <= LUM_LOBE_SEGMENTS; j++) {
        int i = j / STEP;
        if (j % STEP == 0) {
            rest[j] = computed[i];
            continue;
        }
        i = i < 1 ? 1 : i > LAST - 2 ? LAST - 2 : i;
        rest[j] = cubic(computed[i - 1], computed[i], computed[i + 1], computed[i + 2], (double)j / STEP - i);
    }
}

static void fill_lobe(lum_lobe *lobe, const double rest[LUM_LOBE_SEGMENTS + 1])
{
    double sum = 0;
    lobe->top = 0;
    for (int j = 0; j <= LUM_LOBE_SEGMENTS; j++) {
        /* Never quite zero, so that the density stays defined for smooth surfaces that lose nothing; 1e-9 of the flux is below
         * anything that a simulation resolves. */
        lobe->rest[j] = (float)fmin(fmax(rest[j], 1e-9), 1);
        lobe->top = fmaxf(lobe->top, lobe->rest[j]);
    }
    lobe->sum[0] = 0;
    for (int j = 0; j < LUM_LOBE_SEGMENTS; j++) {
        sum += 0.5 * ((double)lobe->rest[j] + (double)lobe->rest[j + 1]) * (node(j + 1) - node(j));
        lobe->sum[j + 1] = (float)sum;
    }
    int segment = 0;
    for (int k = 0; k < LUM_LOBE_SEGMENTS; k++) {
        while (lobe->sum[segment + 1] <= lobe->sum[LUM_LOBE_SEGMENTS] * (float)k / LUM_LOBE_SEGMENTS) {
            segment++;
        }
        lobe->guide[k] = (uint8_t)segment;
    }
    /* Linear between the nodes: the least value of every segment that meets the part of q. */
    for (int k = 0; k < LUM_LOBE_FLOORS; k++) {
        float least = 1;
        for (int j = 0; j < LUM_LOBE_SEGMENTS; j++) {
            if (node(j) <= (k + 1.0) / LUM_LOBE_FLOORS && node(j + 1) >= (double)k / LUM_LOBE_FLOORS) {
                least = fminf(least, fminf(lobe->rest[j], lobe->rest[j + 1]));
            }
        }
        lobe->floor[k] = least * (1 - 0x1p-20f); /* under what rounding makes of it */
    }
}

/* How many points the quadrature takes.  Sets for one roughness are few and afford more. */
static int lattice_points(const lum_lobe_set *set)
{
    return set->count == 1 || (set->eta > 0 && set->eta < 1) ? MORE_LATTICE_POINTS : LATTICE_POINTS;
}

/* All roughnesses: computed at some, the others by cubic interpolation.  The albedo is even in roughness, which gives the value
 * before the first. */
static void fill_roughnesses(lum_lobe_set *set, double (*computed)[LUM_LOBE_SEGMENTS + 1])
{
    enum { STEP = LUM_LOBE_ROUGHNESSES / LUM_LOBE_COMPUTED_ROUGHNESSES, LAST = LUM_LOBE_COMPUTED_ROUGHNESSES };
    for (int i = 0; i <= LAST; i++) {
        double r = (double)i / LAST;
        compute_rest(computed[i], (lum_lobe_kind)set->kind, r * r, (double)set->eta, lattice_points(set));
    }
    for (int k = 0; k <= LUM_LOBE_ROUGHNESSES; k++) {
        int i = k / STEP > LAST - 2 ? LAST - 2 : k / STEP;
        double rest[LUM_LOBE_SEGMENTS + 1];
        for (int j = 0; j <= LUM_LOBE_SEGMENTS; j++) {
            double a = computed[i > 0 ? i - 1 : 1][j];
            rest[j] = cubic(a, computed[i][j], computed[i + 1][j], computed[i + 2][j], (double)k / STEP - i);
        }
        fill_lobe(&set->lobes[k], rest);
    }
}

/* Segment of q = mu^2 and place in it. */
static inline int locate(double mu, double q, double *s)
{
    int j = (int)(sqrt(mu) * LUM_LOBE_SEGMENTS);
    j = j < LUM_LOBE_SEGMENTS ? j : LUM_LOBE_SEGMENTS - 1;
    double a = node(j), x = (q - a) / (node(j + 1) - a);
    *s = x < 0 ? 0 : x > 1 ? 1 : x; /* rounding of the root may miss the segment by an ulp */
    return j;
}

static inline double rest_at(const lum_lobe *lobe, double w, double mu, double q)
{
    double s;
    int j = locate(mu, q, &s);
    double a = (double)lobe->rest[j], rest = a + s * ((double)lobe->rest[j + 1] - a);
    if (w > 0) {
        double b = (double)lobe[1].rest[j];
        rest += w * (b + s * ((double)lobe[1].rest[j + 1] - b) - rest);
    }
    return rest;
}

double lum_lobe_rest(const lum_lobe_set *set, double alpha, double mu)
{
    double w;
    const lum_lobe *lobe = lum_lobe_neighbours(set, alpha, &w);
    mu = mu < 1 ? mu : 1;
    return rest_at(lobe, w, mu, mu * mu);
}

double lum_lobe_total(const lum_lobe_set *set, double alpha)
{
    double w;
    const lum_lobe *lobe = lum_lobe_neighbours(set, alpha, &w);
    double total = (double)lobe->sum[LUM_LOBE_SEGMENTS];
    return w > 0 ? total + w * ((double)lobe[1].sum[LUM_LOBE_SEGMENTS] - total) : total;
}

double lum_lobe_sample(const lum_lobe_set *set, double alpha, double x)
{
    double w;
    const lum_lobe *lobe = lum_lobe_neighbours(set, alpha, &w);
    if (w > 0) {
        double a = (1 - w) * (double)lobe->sum[LUM_LOBE_SEGMENTS], b = w * (double)lobe[1].sum[LUM_LOBE_SEGMENTS];
        double y = x * (a + b);
        if (y < a) {
            x = y / a;
        } else {
            lobe++;
            x = (y - a) / b;
        }
    }
    x = x < 1 ? x : 1;
    double target = x * (double)lobe->sum[LUM_LOBE_SEGMENTS];
    int part = (int)(x * LUM_LOBE_SEGMENTS);
    int low = lobe->guide[part < LUM_LOBE_SEGMENTS ? part : LUM_LOBE_SEGMENTS - 1];
    while (low < LUM_LOBE_SEGMENTS - 1 && (double)lobe->sum[low + 1] <= target) {
        low++;
    }
    /* Solve a s + (b - a) s^2 / 2 = t, in the form that is stable for b near a. */
    double q0 = node(low), width = node(low + 1) - q0, a = (double)lobe->rest[low], b = (double)lobe->rest[low + 1];
    double t = (target - (double)lobe->sum[low]) / width;
    double root = a * a + 2 * (b - a) * t;
    double s = 2 * t / (a + sqrt(root > 0 ? root : 0));
    return q0 + width * (s < 1 ? s > 0 ? s : 0 : 1);
}

double lum_lobe_sample_flat(const lum_lobe_set *set, double alpha, double x, double y)
{
    double w;
    const lum_lobe *lobe = lum_lobe_neighbours(set, alpha, &w);
    double top = w > 0 ? (double)fmaxf(lobe->top, lobe[1].top) : (double)lobe->top, level = y * top;
    if (level < (double)lum_lobe_floor(set, alpha, x)) {
        return x;
    }
    double rest = rest_at(lobe, w, sqrt(x), x);
    return level < rest ? x : lum_lobe_sample(set, alpha, (level - rest) / (top - rest));
}

/* Cosine-weighted mean over the hemisphere: integral of f(sqrt(q)) dq. */
static double hemisphere_mean(double (*f)(double, double, double), double a, double b)
{
    double x[64], w[64], sum = 0;
    gauss_legendre(64, x, w);
    for (int i = 0; i < 64; i++) {
        sum += w[i] * 2 * x[i] * f(x[i], a, b);
    }
    return sum;
}

static double smooth_boundary(double mu, double eta, double unused)
{
    (void)unused;
    return lum_fresnel_dielectric(mu, eta);
}

static double thin_wall(double mu, double eta, double unused)
{
    (void)unused;
    return lum_fresnel_thin(mu, eta);
}

const lum_lobe_set *lum_lobe_set_find(lum_table_store *store, lum_lobe_kind kind, float eta, float alpha, bool *failed)
{
    alpha = alpha >= 0 && alpha < LUM_SMOOTH ? 0 : alpha;
    for (const lum_table_store *from = store; from; from = from->like) {
        for (size_t i = 0; i < from->set_count; i++) {
            const lum_lobe_set *s = from->sets[i];
            if (s->kind == (int)kind && s->eta == eta && s->alpha == alpha) {
                return s;
            }
        }
    }
    int count = alpha < 0 ? LUM_LOBE_ROUGHNESSES + 1 : 1;
    lum_lobe_set *set = malloc(sizeof *set + (size_t)count * sizeof set->lobes[0]);
    lum_lobe_set **sets = realloc(store->sets, (store->set_count + 1) * sizeof *sets);
    if (sets) {
        store->sets = sets;
    }
    if (!set || !sets) {
        free(set);
        *failed = true;
        return NULL;
    }
    sets[store->set_count++] = set;
    set->kind = (int)kind;
    set->eta = eta;
    set->alpha = alpha;
    set->count = count;
    if (count > 1) {
        double(*computed)[LUM_LOBE_SEGMENTS + 1] = malloc((LUM_LOBE_COMPUTED_ROUGHNESSES + 1) * sizeof *computed);
        if (!computed) {
            *failed = true; /* the set is in the store, which frees it */
            return NULL;
        }
        fill_roughnesses(set, computed);
        free(computed);
    } else {
        double rest[LUM_LOBE_SEGMENTS + 1];
        compute_rest(rest, kind, (double)alpha, (double)eta, lattice_points(set));
        fill_lobe(&set->lobes[0], rest);
    }
    return set;
}

static void fill_tables(lum_table_store *store, const lum_material *m, const float *media, int media_count, struct lum_tables *t,
                        bool *failed)
{
    bool pbr = m->kind == LUM_SURFACE_PBR;
    bool varies = m->metal_rough_texture.image != LUM_NONE;
    float alpha = varies ? -1.0f : m->roughness * m->roughness;
    bool rough = varies || alpha >= LUM_SMOOTH;
    bool transmits = pbr && m->transmission > 0;
    t->media = 0;
    if (rough && (m->kind == LUM_SURFACE_CONDUCTOR || (pbr && m->metallic > 0) || (transmits && m->thin))) {
        t->metal = lum_lobe_set_find(store, LUM_LOBE_METAL, 0, alpha, failed);
    }
    for (int c = 0; c < 3; c++) {
        t->metal_average[c] = m->has_eta ? (float)hemisphere_mean(lum_fresnel_conductor, (double)m->eta[c], (double)m->k[c]) : 1;
    }
    if (!pbr) {
        return;
    }
    if (m->layers.present) {
        lum_layer_tables_fill(store, m, t, failed);
    }
    for (int i = 0; i < media_count; i++) {
        lum_medium_tables *medium = &t->medium[t->media++];
        float eta = m->ior / media[i];
        medium->eta_outside = media[i];
        medium->fresnel_average = hemisphere_mean(smooth_boundary, (double)eta, 0);
        medium->thin_average = hemisphere_mean(thin_wall, (double)eta, 0);
        if (m->metallic < 1 || varies) {
            medium->coat = lum_lobe_set_find(store, LUM_LOBE_COAT, eta, alpha, failed);
        }
        if (rough && transmits && !m->thin) {
            medium->outside = lum_lobe_set_find(store, LUM_LOBE_BOUNDARY, eta, alpha, failed);
            medium->inside = lum_lobe_set_find(store, LUM_LOBE_BOUNDARY, 1 / eta, alpha, failed);
            if (m->layers.present & (LUM_LAYER_SPECULAR | LUM_LAYER_IRIDESCENCE)) {
                medium->changed = lum_boundary_set_find(store, alpha, eta, failed);
            }
        }
    }
}

lmg_result lum_tables_create(const lum_model *model, lum_table_store *store, lmg_error *err)
{
    /* The media that a surface may be in: air, and the insides of the model's solids. */
    float media[LUM_MAX_MEDIA] = {1.0f};
    int count = 1;
    for (uint32_t i = 0; i < model->material_count && count < LUM_MAX_MEDIA; i++) {
        const lum_material *m = &model->materials[i];
        bool solid = lum_material_is_solid(m), known = false;
        for (int k = 0; k < count; k++) {
            known |= media[k] == m->ior;
        }
        if (solid && !known) {
            media[count++] = m->ior;
        }
    }
    store->tables = calloc(model->material_count ? model->material_count : 1, sizeof *store->tables);
    bool failed = !store->tables;
    for (uint32_t i = 0; i < model->material_count && !failed; i++) {
        fill_tables(store, &model->materials[i], media, count, &store->tables[i], &failed);
    }
    return failed
               ? lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory for the albedo tables of %u materials", model->material_count)
               : LMG_OK;
}

void lum_tables_destroy(lum_table_store *store)
{
    for (size_t i = 0; i < store->set_count; i++) {
        free(store->sets[i]);
    }
    for (size_t i = 0; i < store->cosine_set_count; i++) {
        free(store->cosine_sets[i]);
    }
    free(store->cosine_sets);
    for (size_t i = 0; i < store->boundary_set_count; i++) {
        free(store->boundary_sets[i]);
    }
    free(store->boundary_sets);
    for (size_t i = 0; i < store->stretched_count; i++) {
        free(store->stretched[i]);
    }
    free(store->stretched);
    free(store->sheen);
    free(store->film);
    free(store->sets);
    free(store->tables);
    *store = (lum_table_store){0};
}
