/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Lamps that keep their light, baked as a user bakes them, by time, by photons and by error: the program ends by itself with a line
 * that says where the light is.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "gltf_writer.h"
#include "hard.h"
#include "run_lumibake.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A cube round a cube that shines. */
static const char *closed_room(void)
{
    static const uint16_t OUTWARD[36] = {0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1,
                                         2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3};
    unsigned char bytes[2 * 8 * 12 + 2 * 72];
    for (int k = 0; k < 2; ++k) {
        const float h = k == 0 ? 0.2f : 0.02f;
        for (int c = 0; c < 8; ++c) {
            const float p[3] = {c & 4 ? h : -h, c & 2 ? 0.7f * h : -0.7f * h, c & 1 ? h : -h};
            memcpy(bytes + (8 * k + c) * 12, p, sizeof(p));
        }
        for (int t = 0; t < 36; t += 3) {
            const uint16_t face[3] = {OUTWARD[t], OUTWARD[t + (k == 0 ? 2 : 1)], OUTWARD[t + (k == 0 ? 1 : 2)]};
            memcpy(bytes + 192 + 72 * k + 2 * t, face, sizeof(face));
        }
    }
    char *uri = gltf_data_uri(bytes, sizeof(bytes));
    char *text = gltf_text(
        "{\"asset\":{\"version\":\"2.0\"},\"scenes\":[{\"nodes\":[0,1]}],\"nodes\":[{\"name\":\"Shell\",\"mesh\":0},{\"name\":"
        "\"LED\",\"mesh\":1}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":2,\"material\":0}]},"
        "{\"primitives\":[{\"attributes\":{\"POSITION\":1},\"indices\":3,\"material\":1}]}],"
        "\"materials\":[{\"name\":\"Shell\"},{\"name\":\"LED\",\"emissiveFactor\":[1,1,1]}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":8,\"type\":\"VEC3\",\"min\":[-1,-1,-1],\"max\":[1,1,1]},"
        "{\"bufferView\":1,\"componentType\":5126,\"count\":8,\"type\":\"VEC3\",\"min\":[-1,-1,-1],\"max\":[1,1,1]},"
        "{\"bufferView\":2,\"componentType\":5123,\"count\":36,\"type\":\"SCALAR\"},{\"bufferView\":3,\"componentType\":5123,"
        "\"count\":36,\"type\":\"SCALAR\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":96},{\"buffer\":0,\"byteOffset\":96,\"byteLength\":96},"
        "{\"buffer\":0,\"byteOffset\":192,\"byteLength\":72},{\"buffer\":0,\"byteOffset\":264,\"byteLength\":72}],"
        "\"buffers\":[{\"byteLength\":336,\"uri\":\"%s\"}]}",
        uri);
    const char *path = in_folder("closed.gltf");
    write_file(path, text, strlen(text));
    free(text);
    free(uri);
    return path;
}

static void test_trapped(void **state)
{
    (void)state;
    char lamp[1200], box[1200]; /* in_folder's don't stay */
    snprintf(lamp, sizeof(lamp), "%s", closed_room());
    snprintf(box, sizeof(box), "%s", in_folder("closed.box.exr"));
    static const struct {
        const char *name, *shell, *led;
    } ROOMS[] = {
        {"closed mirror box", "mirror:Shell=1", "mirror:LED=1"},
        {"white closed diffuse room", "diffuse:Shell=1", "diffuse:LED=1"},
        {"closed room that absorbs 1e-7", "diffuse:Shell=0.9999999", "mirror:LED=1"},
    };
    static const char *const WAYS[][2] = {{"--time", "2s"}, {"--photons", "50000"}, {"--error", "5%"}, {"-q", "-q"}};
    for (size_t r = 0; r < sizeof(ROOMS) / sizeof(ROOMS[0]); ++r)
        for (size_t w = 0; w < sizeof(WAYS) / sizeof(WAYS[0]); ++w) {
            if (r > 0 && w % 2 == 1)
                continue; /* by time and by error is enough */
            remove(box);
            outcome o = RUN("bake", lamp, "-o", box, "--set", ROOMS[r].shell, "--set", ROOMS[r].led, "--effects", "all", WAYS[w][0],
                            WAYS[w][1]);
            const char *why = strstr(o.err, "error:");
            char line[300];
            snprintf(line, sizeof(line), "%.*s", why ? (int)strcspn(why, "\n") : 0, why ? why : "");
            FILE *f = fopen(box, "rb");
            hard_holds(hard_text("%s, %s", ROOMS[r].name,
                                 w == 3 ? "neither time nor photons given" : hard_text("%s %s", WAYS[w][0], WAYS[w][1])),
                       "ends by itself, without a box, and names the shell",
                       o.code == 3 && !f && strstr(line, "trapped") && strstr(line, "Shell"), "%s",
                       strstr(line, "light is") ? strstr(line, "light is") : o.err);
            if (f)
                fclose(f);
            release(&o);
        }
}

int main(void)
{
    hard_begin("trapped");
    snprintf(folder, sizeof(folder), "%s/hard/trapped", LUMIBOX_BINARY_DIR);
    write_file(in_folder("stdin"), "", 0);
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_trapped)};
    return cmocka_run_group_tests_name("hard_trapped", tests, NULL, NULL);
}
