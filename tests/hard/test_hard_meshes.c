/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Dirty meshes through glTF: a luminous square, its mesh spoilt in the ways that exporters spoil meshes.  It must load with the flux of the clean one, or be refused with a line that names the mesh.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "gltf_writer.h"
#include "hard.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

static char *document(const soup *s)
{
    const size_t p = s->vertices * sizeof(s->positions[0]), i = s->count * sizeof(uint32_t);
    unsigned char *bytes = malloc(2 * p + i);
    memcpy(bytes, s->positions, p);
    memcpy(bytes + p, s->normals, p);
    memcpy(bytes + 2 * p, s->indices, i);
    char *uri = gltf_data_uri(bytes, 2 * p + i);
    char *text = gltf_text(
        "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_emissive_strength\"],\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"Tray\",\"mesh\":0}],"
        "\"meshes\":[{\"name\":\"Tray\",\"primitives\":[{\"attributes\":{\"POSITION\":0%s},\"indices\":2,\"material\":0}]}],"
        "\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0,0,0,1],\"metallicFactor\":0},\"emissiveFactor\":[1,1,1],"
        "\"extensions\":{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":1000}}}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":%u,\"type\":\"VEC3\",\"min\":[-1,-1,-1],\"max\":[1,1,1]},"
        "{\"bufferView\":1,\"componentType\":5126,\"count\":%u,\"type\":\"VEC3\"},{\"bufferView\":2,\"componentType\":5125,\"count\":%u,\"type\":\"SCALAR\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu}],"
        "\"buffers\":[{\"byteLength\":%zu,\"uri\":\"%s\"}]}",
        s->with_normals ? ",\"NORMAL\":1" : "", s->vertices, s->vertices, s->count, p, p, p, 2 * p, i, 2 * p + i, uri);
    free(bytes);
    free(uri);
    return text;
}

static const double PI = 3.14159265358979323846;

/* pi L A of the clean square. */
static void same_flux(const char *name, const soup *s)
{
    char *text = document(s);
    const char *path = hard_path("dirty.gltf");
    FILE *f = fopen(path, "w");
    fputs(text, f);
    fclose(f);
    free(text);
    lum_model *m;
    lmg_error err = {{0}};
    const lmg_result result = lum_model_load(path, NULL, &m, &err);
    if (result != LMG_OK) {
        hard_holds(name, "the flux of the clean mesh, or refused with a line that names the file", strstr(err.message, "dirty.gltf") != NULL, "refused: %.200s",
                   strstr(err.message, "dirty.gltf") ? strstr(err.message, "dirty.gltf") : err.message);
        return;
    }
    bake_source *t = hard_tracer(m, 3);
    const bake_tally tally = hard_trace(t, 20000, NULL);
    const double flux = t->flux / (PI * 1000 * 0.04);
    hard_holds(name, "the flux of the clean mesh, or refused with a line that names the file",
               fabs(flux - 1) < 1e-5 && tally.lost == 0 && tally.escaped == tally.emitted, "flux x %.6f, %u warnings%s%.120s", flux, m->warning_count,
               m->warning_count ? ": " : "", m->warning_count ? m->warnings[0] : "");
    t->destroy(t);
    lum_model_destroy(m);
}

static void test_dirty(void **state)
{
    (void)state;
    soup s = clean();
    same_flux("clean square", &s);

    add(&s, 0, 0, 1);
    add(&s, 2, 2, 2);
    same_flux("degenerate triangles: equal corners", &s);

    s = clean();
    const uint32_t half = vertex(&s, 0, 0, -0.1f);
    add(&s, 0, half, 1);
    same_flux("degenerate triangle: corners in a line", &s);

    s = clean();
    const uint32_t a = vertex(&s, -0.1f, 0, 0.1f + 1e-9f), b = vertex(&s, 0.1f, 0, 0.1f + 1e-8f);
    add(&s, 3, b, a);
    same_flux("sliver of 1e-8 of its length", &s);

    s = clean();
    add(&s, 0, 1, 2);
    add(&s, 1, 2, 0);
    same_flux("duplicate faces, the same way round", &s);

    s = clean();
    vertex(&s, 50, -3, 8);
    vertex(&s, 1e30f, 0, 0);
    same_flux("isolated vertices, one at 1e30", &s);

    s = clean();
    vertex(&s, NAN, 0, 0);
    same_flux("isolated vertex with NaN", &s);

    s = clean();
    s.positions[1][2] = NAN;
    same_flux("NaN in a corner", &s);

    s = clean();
    s.positions[2][0] = (float)INFINITY;
    same_flux("infinity in a corner", &s);

    s = clean();
    s.with_normals = true;
    memset(s.normals, 0, sizeof(s.normals));
    same_flux("zero normals", &s);

    s = clean();
    s.with_normals = true;
    for (int i = 0; i < 4; ++i)
        s.normals[i][1] = 1;
    same_flux("flipped normals", &s);

    s = clean();
    s.with_normals = true;
    s.normals[1][0] = NAN;
    same_flux("NaN in a normal", &s);

    s = clean();
    s.indices[4] = 4000000000u;
    same_flux("index beyond the vertices", &s);
}

int main(void)
{
    hard_begin("meshes");
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_dirty)};
    return cmocka_run_group_tests_name("hard_meshes", tests, NULL, NULL);
}
