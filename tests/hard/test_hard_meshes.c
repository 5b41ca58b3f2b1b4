/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Dirty meshes through glTF: a luminous square, its mesh spoilt in the ways that exporters spoil meshes.  It must load with the
 * flux of the clean one, with a warning that names the mesh where something was repaired, or be refused with a line that names it.  Solids of
 * glass that are open or inconsistently wound: a warning, and what is lost is counted. With the argument "long": a lamp of 1e7 triangles.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "gltf_writer.h"
#include "hard.h"
#include "make_model.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

enum { MAX_VERTICES = 64, MAX_INDICES = 256 };
typedef struct soup {
    float positions[MAX_VERTICES][3], normals[MAX_VERTICES][3];
    uint32_t indices[MAX_INDICES];
    uint32_t vertices, count;
    bool with_normals;
} soup;

/* A square source in the plane y = 0, facing down, as two triangles. */
static soup clean(void)
{
    soup s = {.vertices = 4, .count = 6};
    static const float P[4][3] = {{-0.1f, 0, -0.1f}, {0.1f, 0, -0.1f}, {0.1f, 0, 0.1f}, {-0.1f, 0, 0.1f}};
    static const uint32_t I[6] = {0, 1, 2, 0, 2, 3};
    memcpy(s.positions, P, sizeof(P));
    memcpy(s.indices, I, sizeof(I));
    for (int i = 0; i < MAX_VERTICES; ++i)
        s.normals[i][1] = -1;
    return s;
}

static void add(soup *s, uint32_t a, uint32_t b, uint32_t c)
{
    s->indices[s->count++] = a;
    s->indices[s->count++] = b;
    s->indices[s->count++] = c;
}

static uint32_t vertex(soup *s, float x, float y, float z)
{
    s->positions[s->vertices][0] = x;
    s->positions[s->vertices][1] = y;
    s->positions[s->vertices][2] = z;
    return s->vertices++;
}

static const char LUMINOUS[] = "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0,0,0,1],\"metallicFactor\":0},\"emissiveFactor\":[1,1,1],"
                               "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":1000}}";
static const char GLASS[] = "\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0},\"extensions\":{\"KHR_materials_transmission\":"
                            "{\"transmissionFactor\":1},\"KHR_materials_volume\":{\"thicknessFactor\":0.1}}";

/* Writes the soup as mesh "Tray" of this material; returns the file's path. */
static const char *write_soup(const soup *s, const char *material)
{
    const size_t p = s->vertices * sizeof(s->positions[0]), i = s->count * sizeof(uint32_t);
    unsigned char *bytes = malloc(2 * p + i);
    memcpy(bytes, s->positions, p);
    memcpy(bytes + p, s->normals, p);
    memcpy(bytes + 2 * p, s->indices, i);
    char *uri = gltf_data_uri(bytes, 2 * p + i);
    char *text = gltf_text(
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_emissive_strength\",\"KHR_materials_transmission\","
        "\"KHR_materials_volume\"],\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"name\":\"Node\",\"mesh\":0}],"
        "\"meshes\":[{\"name\":\"Tray\",\"primitives\":[{\"attributes\":{\"POSITION\":0%s},\"indices\":2,\"material\":0}]}],"
        "\"materials\":[{\"name\":\"Paint\",%s}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":%u,\"type\":\"VEC3\",\"min\":[-1,-1,-1],\"max\":[1,1,1]}"
        ","
        "{\"bufferView\":1,\"componentType\":5126,\"count\":%u,\"type\":\"VEC3\"},{\"bufferView\":2,\"componentType\":5125,"
        "\"count\":%u,\"type\":\"SCALAR\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu},{\"buffer\":0,"
        "\"byteOffset\":%zu,\"byteLength\":%zu}],"
        "\"buffers\":[{\"byteLength\":%zu,\"uri\":\"%s\"}]}",
        s->with_normals ? ",\"NORMAL\":1" : "", material, s->vertices, s->vertices, s->count, p, p, p, 2 * p, i, 2 * p + i, uri);
    const char *path = hard_path("dirty.gltf");
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
    free(text);
    free(bytes);
    free(uri);
    return path;
}

static const double PI = 3.14159265358979323846;

/* The only warning of a model, or all of them counted. */
static const char *only_warning(const lum_model *m)
{
    return m->warning_count == 0 ? "no warning" : m->warning_count == 1 ? m->warnings[0] : hard_text("%u warnings", m->warning_count);
}

/* It has pi L A of the clean square; warning: what the one warning says, which also names the mesh, NULL: nothing needs one. */
static void repaired(const char *name, const soup *s, const char *warning)
{
    lum_model *m = hard_load(write_soup(s, LUMINOUS), NULL);
    bake_source *t = hard_tracer(m, 3);
    const bake_tally tally = hard_trace(t, 20000, NULL);
    const double flux = t->flux / (PI * 1000 * 0.04);
    const char *said = only_warning(m);
    hard_holds(name, "the flux of the clean mesh, and a warning that names the mesh where something was repaired",
               fabs(flux - 1) < 1e-5 && tally.lost == 0 && tally.escaped == tally.emitted &&
                   (warning ? strstr(said, warning) && strstr(said, "mesh \"Tray\"") : m->warning_count == 0),
               "flux x %.6f, %.150s", flux, said);
    t->destroy(t);
    lum_model_destroy(m);
}

static void refused(const char *name, const soup *s, const char *message)
{
    lum_model *m;
    lmg_error err = {{0}};
    const lmg_result result = lum_model_load(write_soup(s, LUMINOUS), NULL, &m, &err);
    const char *line = strstr(err.message, "dirty.gltf");
    hard_holds(name, "refused with a line that names file and mesh",
               result == LMG_ERROR_INPUT && line && strstr(line, message) && strstr(line, "\"Tray\"") && !strchr(line, '\n'), "%.200s",
               line ? line : err.message);
}

static void test_dirty(void **state)
{
    (void)state;
    soup s = clean();
    repaired("clean square", &s, NULL);

    add(&s, 0, 0, 1);
    add(&s, 2, 2, 2);
    repaired("degenerate triangles: equal corners", &s, "2 triangles without area");

    s = clean();
    const uint32_t half = vertex(&s, 0, 0, -0.1f);
    add(&s, 0, half, 1);
    repaired("degenerate triangle: corners in a line", &s, "1 triangle without area");

    s = clean();
    const uint32_t a = vertex(&s, -0.1f, 0, 0.1f + 1e-9f), b = vertex(&s, 0.1f, 0, 0.1f + 1e-8f);
    add(&s, 3, b, a);
    repaired("sliver thinner than the rounding of its corners", &s, "1 triangle without area");

    s = clean();
    add(&s, 3, 2, vertex(&s, 0.1f, 0, 0.1f + 2e-6f));
    repaired("sliver of 1e-5 of its length", &s, NULL);

    s = clean();
    add(&s, 0, 1, 2);
    add(&s, 1, 2, 0);
    repaired("duplicate faces, the same way round", &s, "2 triangles repeat another one");

    s = clean();
    vertex(&s, 50, -3, 8);
    vertex(&s, 1e30f, 0, 0);
    repaired("isolated vertices, one at 1e30", &s, NULL);

    s = clean();
    s.with_normals = true;
    memset(s.normals[1], 0, 2 * sizeof(s.normals[0]));
    repaired("zero normals", &s, "2 of its normals are zero");

    s = clean();
    s.with_normals = true;
    for (int i = 0; i < 4; ++i)
        s.normals[i][1] = 1;
    repaired("flipped normals: the winding says what is front", &s, NULL);

    s = clean();
    vertex(&s, NAN, 0, 0);
    refused("isolated vertex with NaN", &s, "vertex 4 is not finite");

    s = clean();
    s.positions[1][2] = NAN;
    refused("NaN in a corner", &s, "vertex 1 is not finite");

    s = clean();
    s.positions[2][0] = (float)INFINITY;
    refused("infinity in a corner", &s, "vertex 2 is not finite");

    s = clean();
    s.with_normals = true;
    s.normals[1][0] = NAN;
    refused("NaN in a normal", &s, "NORMAL");

    s = clean();
    s.indices[4] = 4000000000u;
    refused("index beyond the vertices", &s, "4000000000");
}

/* A tetrahedron of glass, closed and outward, spoilt: what its one warning says besides the names. */
static void test_warned_glass(void **state)
{
    (void)state;
    static const struct {
        const char *name, *warning;
        uint32_t indices[15];
        uint32_t count;
        float height; /* metres */
    } CASES[] = {
        {"closed, faces outward", NULL, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}, 12, 0.1f},
        {"open glass: a face missing", "is open (3 boundary edges)", {0, 2, 1, 0, 1, 3, 0, 3, 2}, 9, 0.1f},
        {"inconsistent winding: a face turned", "(3 edges between them)", {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 3, 2}, 12, 0.1f},
        {"all faces inward", "its faces look inward", {0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2}, 12, 0.1f},
        /* volume over half of the surface is a third of the height; 3.8 um times 0.05 m, half of the width, are 0.19 um */
        {"a film of 0.21 um", NULL, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}, 12, 0.63e-6f},
        {"a film of 0.17 um", "as if it wasn't there", {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}, 12, 0.51e-6f},
        {"duplicate face", "1 triangle repeats another one", {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3, 2, 3, 1}, 15, 0.1f},
    };
    for (size_t i = 0; i < sizeof(CASES) / sizeof(CASES[0]); ++i) {
        soup s = {.count = CASES[i].count};
        vertex(&s, 0, 0, 0);
        vertex(&s, 0.1f, 0, 0);
        vertex(&s, 0, 0.1f, 0);
        vertex(&s, 0, 0, CASES[i].height);
        memcpy(s.indices, CASES[i].indices, sizeof(CASES[i].indices));
        lum_model *m = hard_load(write_soup(&s, GLASS), NULL);
        /* that it has no emitter is said, too */
        const char *said = "no warning";
        uint32_t others = 0;
        for (uint32_t k = 0; k < m->warning_count; ++k)
            if (!strstr(m->warnings[k], "nothing in it emits light")) {
                said = m->warnings[k];
                ++others;
            }
        hard_holds(hard_text("glass: %s", CASES[i].name), "a warning that names the mesh, none without cause",
                   CASES[i].warning ? others == 1 && strstr(said, CASES[i].warning) && strstr(said, "mesh \"Tray\"") : others == 0, "%.220s", said);
        lum_model_destroy(m);
    }
}

/* A ball of glass under a source, some of its faces left out or turned round. */
static void test_dirty_glass(void **state)
{
    (void)state;
    static const char *const NAMES[] = {"closed glass ball", "glass ball without 1 of 50 faces",
                                        "glass ball, 1 of 50 faces turned round", "glass ball, all faces turned round"};
    double closed = 0;
    for (int k = 0; k < 4; ++k) {
        lum_model *m = make_model();
        const uint32_t source = make_lambert(m, 0);
        hard_emit(m, source, 1000);
        make_quad(m, v3(-0.02, 0.1, -0.02), v3(0.04, 0, 0), v3(0, 0, 0.04), 1, source);
        const uint32_t first = m->triangle_count;
        make_sphere(m, v3(0, 0, 0), 0.05, 20, false, false, make_glass(m, 1.5f, 0, false));
        uint32_t kept = first;
        for (uint32_t t = first; t < m->triangle_count; ++t) {
            if (k == 1 && t % 50 == 0)
                continue;
            uint32_t *to = m->indices + 3 * (size_t)kept++;
            memmove(to, m->indices + 3 * (size_t)t, 3 * sizeof(*to));
            if (k == 3 || (k == 2 && t % 50 == 0)) {
                const uint32_t swap = to[1];
                to[1] = to[2];
                to[2] = swap;
            }
        }
        m->triangle_count = kept;
        finish_model(m);
        bake_source *s = hard_tracer(m, 6);
        const double photons = 100000;
        const bake_tally t = hard_trace(s, (uint64_t)photons, NULL);
        if (k == 0)
            closed = (double)t.segments / photons;
        /* a solid's inside is where light goes that passes a face against its normal; light that leaves through a gap is still in
         * it when it is out of the lamp.  No more can be lost than passes such faces: a 50th of what the closed ball has of
         * segments. */
        const double most = k == 0 ? 0 : k == 3 ? 1 : closed / 50;
        hard_at_most(NAMES[k], k == 0 ? "nothing lost" : "lost as inside a solid, share: no more than meets the spoilt faces",
                     t.lost_inside / photons, most);
        hard_at_most(NAMES[k], "lost otherwise", t.lost - t.lost_inside, 0);
        s->destroy(s);
        free_model(m);
    }
}

/* ------------------------------------------------------------------------------------------------------- 1e7 triangles */

static double peak_gigabytes(void)
{
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    return (double)u.ru_maxrss / (1 << 20);
}

/* A paraboloid mirror of N x N quads as a .gltf and a .bin of 180 MB, with a Lambertian source in its focus. */
static void write_many(const char *gltf, const char *bin, uint32_t n)
{
    FILE *f = fopen(bin, "wb");
    assert_non_null(f);
    const double focus = 0.05;
    for (uint32_t i = 0; i <= n; ++i)
        for (uint32_t k = 0; k <= n; ++k) {
            const double x = 0.2 * k / n - 0.1, z = 0.2 * i / n - 0.1;
            const float p[3] = {(float)x, (float)((x * x + z * z) / (4 * focus) - focus), (float)z};
            assert_int_equal(fwrite(p, sizeof(p), 1, f), 1);
        }
    for (uint32_t i = 0; i < n; ++i)
        for (uint32_t k = 0; k < n; ++k) {
            const uint32_t a = i * (n + 1) + k, b = a + 1, c = a + n + 1, d = c + 1;
            const uint32_t quad[6] = {a, c, d, a, d, b};
            assert_int_equal(fwrite(quad, sizeof(quad), 1, f), 1);
        }
    const float source[4][3] = {{-0.005f, 0, -0.005f}, {0.005f, 0, -0.005f}, {0.005f, 0, 0.005f}, {-0.005f, 0, 0.005f}};
    const uint32_t two[6] = {0, 1, 2, 0, 2, 3};
    fwrite(source, sizeof(source), 1, f);
    fwrite(two, sizeof(two), 1, f);
    assert_int_equal(fclose(f), 0);
    const size_t vertices = (size_t)(n + 1) * (n + 1), v = 12 * vertices, i = 24 * (size_t)n * n;
    f = fopen(gltf, "w");
    assert_non_null(f);
    fprintf(
        f,
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_emissive_strength\"],\"scenes\":[{\"nodes\":[0,1]}],"
        "\"nodes\":[{\"mesh\":0},{\"mesh\":1}],\"meshes\":[{\"name\":\"Mirror\",\"primitives\":[{\"attributes\":{\"POSITION\":0},"
        "\"indices\":1,\"material\":0}]},"
        "{\"name\":\"Source\",\"primitives\":[{\"attributes\":{\"POSITION\":2},\"indices\":3,\"material\":1}]}],"
        "\"materials\":[{\"name\":\"Mirror\",\"doubleSided\":true,\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,1],"
        "\"metallicFactor\":1,\"roughnessFactor\":0}},"
        "{\"name\":\"Source\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[0,0,0,1],\"metallicFactor\":0},\"emissiveFactor\":[1,"
        "1,1],"
        "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":100000}}}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":%zu,\"type\":\"VEC3\",\"min\":[-0.1,-0.05,-0.1],\"max\":"
        "[0.1,0.05,0.1]},"
        "{\"bufferView\":1,\"componentType\":5125,\"count\":%zu,\"type\":\"SCALAR\"},"
        "{\"bufferView\":2,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[-0.005,0,-0.005],\"max\":[0.005,0,0.005]},"
        "{\"bufferView\":3,\"componentType\":5125,\"count\":6,\"type\":\"SCALAR\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu},"
        "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":24}],"
        "\"buffers\":[{\"byteLength\":%zu,\"uri\":\"many.bin\"}]}",
        vertices, i / 4, v, v, i, v + i, v + i + 48, v + i + 72);
    assert_int_equal(fclose(f), 0);
}

static void test_many_triangles(void **state)
{
    (void)state;
    const uint32_t n = 2237;
    const char *gltf = hard_path("many.gltf"), *bin = hard_path("many.bin");
    write_many(gltf, bin, n);
    const clock_t began = clock();
    lum_model *m = hard_load(gltf, NULL);
    const double load = (double)(clock() - began) / CLOCKS_PER_SEC;
    const bake_options o = {.photons = 1000000, .seed = 4, .fit.cells = 100000};
    bake_report report;
    lmg_field *f = hard_bake(m, &o, &report);
    const double all = (double)(clock() - began) / CLOCKS_PER_SEC;
    const lmg_ledger l = lmg_field_ledger(f);
    const char *name = hard_text("mirror of %.3g triangles", 2.0 * n * n + 2);
    hard_holds(name, "loads and bakes", m->triangle_count == 2 * n * n + 2 && m->warning_count == 0,
               "%.0f CPU s to load, %.0f with a bake of 1e6 photons, %.1f GB", load, all, peak_gigabytes());
    hard_at_most(name, "flux emitted, relative to pi L A", fabs(l.emitted / (PI * 100000 * 1e-4) - 1), 1e-5);
    hard_at_most(name, "lost, share", l.lost / l.emitted, 1e-6);
    hard_at_most(name, "balance, relative", fabs((l.stored + l.residual + l.absorbed + l.lost) / l.emitted - 1), 1e-6);
    lmg_field_destroy(f);
    lum_model_destroy(m);
    remove(bin);
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "long") == 0) {
        hard_begin("long_meshes");
        hard_without_traps();
        const struct CMUnitTest tests[] = {cmocka_unit_test(test_many_triangles)};
        return cmocka_run_group_tests_name("hard_long_meshes", tests, NULL, NULL);
    }
    hard_begin("meshes");
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_dirty), cmocka_unit_test(test_warned_glass), cmocka_unit_test(test_dirty_glass)};
    return cmocka_run_group_tests_name("hard_meshes", tests, NULL, NULL);
}
