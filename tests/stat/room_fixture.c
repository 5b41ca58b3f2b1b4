/* SPDX-License-Identifier: Apache-2.0 */
/* See room_fixture.h.  Relies on the public interfaces of the libraries and on cmocka. */
#include "room_fixture.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static void put_base64(FILE *file, const unsigned char *bytes, size_t size)
{
    static const char DIGITS[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < size; i += 3) {
        unsigned v =
            (unsigned)bytes[i] << 16 | (i + 1 < size ? (unsigned)bytes[i + 1] << 8 : 0) | (i + 2 < size ? bytes[i + 2] : 0u);
        fputc(DIGITS[v >> 18], file);
        fputc(DIGITS[v >> 12 & 63], file);
        fputc(i + 1 < size ? DIGITS[v >> 6 & 63] : '=', file);
        fputc(i + 2 < size ? DIGITS[v & 63] : '=', file);
    }
}

void room_write(const char *path, const room_rectangle *rectangles, size_t count)
{
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    float *positions = malloc(count * 12 * sizeof *positions);
    assert_non_null(positions);
    float lower[3], upper[3];
    for (size_t i = 0; i < count; i++) {
        const room_rectangle *r = &rectangles[i];
        for (size_t k = 0; k < 3; k++) {
            float *p = positions + 12 * i;
            p[k] = (float)r->corner[k];
            p[3 + k] = (float)(r->corner[k] + r->e1[k]);
            p[6 + k] = (float)(r->corner[k] + r->e1[k] + r->e2[k]);
            p[9 + k] = (float)(r->corner[k] + r->e2[k]);
        }
    }
    static const uint16_t INDICES[6] = {0, 1, 2, 0, 2, 3};
    fprintf(file, "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"KHR_materials_ior\",\"KHR_materials_emissive_strength\"],"
                  "\"scene\":0,\"scenes\":[{\"nodes\":[");
    for (size_t i = 0; i < count; i++) {
        fprintf(file, "%s%zu", i ? "," : "", i);
    }
    fprintf(file, "]}],\"nodes\":[");
    for (size_t i = 0; i < count; i++) {
        fprintf(file, "%s{\"name\":\"rectangle %zu\",\"mesh\":%zu}", i ? "," : "", i, i);
    }
    fprintf(file, "],\"meshes\":[");
    for (size_t i = 0; i < count; i++) {
        fprintf(file, "%s{\"primitives\":[{\"attributes\":{\"POSITION\":%zu},\"indices\":0,\"material\":%zu}]}", i ? "," : "",
                i + 1, i);
    }
    fprintf(file, "],\"materials\":[");
    for (size_t i = 0; i < count; i++) {
        const room_rectangle *r = &rectangles[i];
        /* Index 1 takes the gloss off the glTF dielectric: what is left is Lambertian. */
        fprintf(file,
                "%s{\"name\":\"m%zu\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[%.9g,%.9g,%.9g,1],\"metallicFactor\":%d,"
                "\"roughnessFactor\":%.9g},\"emissiveFactor\":[%d,%d,%d],\"extensions\":{\"KHR_materials_ior\":{\"ior\":1},"
                "\"KHR_materials_emissive_strength\":{\"emissiveStrength\":%.9g}}}",
                i ? "," : "", i, r->albedo, r->albedo, r->albedo, r->metal, r->metal ? r->roughness : 1, r->luminance > 0,
                r->luminance > 0, r->luminance > 0, r->luminance);
    }
    fprintf(file, "],\"accessors\":[{\"bufferView\":0,\"componentType\":5123,\"count\":6,\"type\":\"SCALAR\"}");
    for (size_t i = 0; i < count; i++) {
        for (size_t k = 0; k < 3; k++) {
            lower[k] = upper[k] = positions[12 * i + k];
            for (size_t j = 1; j < 4; j++) {
                lower[k] = fminf(lower[k], positions[12 * i + 3 * j + k]);
                upper[k] = fmaxf(upper[k], positions[12 * i + 3 * j + k]);
            }
        }
        fprintf(
            file,
            ",{\"bufferView\":1,\"byteOffset\":%zu,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[%.9g,%.9g,%.9g],"
            "\"max\":[%.9g,%.9g,%.9g]}",
            i * 48, (double)lower[0], (double)lower[1], (double)lower[2], (double)upper[0], (double)upper[1], (double)upper[2]);
    }
    size_t bytes = count * 48;
    fprintf(file,
            "],\"bufferViews\":[{\"buffer\":0,\"byteLength\":12},{\"buffer\":0,\"byteOffset\":12,\"byteLength\":%zu}],"
            "\"buffers\":[{\"byteLength\":%zu,\"uri\":\"data:application/octet-stream;base64,",
            bytes, 12 + bytes);
    unsigned char *all = malloc(12 + bytes);
    assert_non_null(all);
    memcpy(all, INDICES, 12);
    memcpy(all + 12, positions, bytes);
    put_base64(file, all, 12 + bytes);
    fprintf(file, "\"}]}\n");
    free(all);
    free(positions);
    assert_int_equal(fclose(file), 0);
}

void room_walls(const double l[3], const double u[3], double albedo, room_rectangle walls[6])
{
    const double x = u[0] - l[0], y = u[1] - l[1], z = u[2] - l[2];
    const room_rectangle all[6] = {
        {.corner = {l[0], l[1], l[2]}, .e1 = {0, 0, z}, .e2 = {x, 0, 0}}, /* floor */
        {.corner = {l[0], u[1], l[2]}, .e1 = {x, 0, 0}, .e2 = {0, 0, z}}, /* ceiling */
        {.corner = {l[0], l[1], l[2]}, .e1 = {x, 0, 0}, .e2 = {0, y, 0}}, /* -z */
        {.corner = {l[0], l[1], u[2]}, .e1 = {0, y, 0}, .e2 = {x, 0, 0}}, /* +z */
        {.corner = {l[0], l[1], l[2]}, .e1 = {0, y, 0}, .e2 = {0, 0, z}}, /* -x */
        {.corner = {u[0], l[1], l[2]}, .e1 = {0, 0, z}, .e2 = {0, y, 0}}, /* +x */
    };
    memcpy(walls, all, sizeof all);
    for (int i = 0; i < 6; i++) {
        walls[i].albedo = albedo;
    }
}

lmg_field *panel_field(double x0, double x1, double z0, double z1, double height, const float color[3], double luminance)
{
    return beam_field(x0, x1, z0, z1, height, color, luminance, 1);
}

lmg_field *beam_field(double x0, double x1, double z0, double z1, double height, const float color[3], double luminance,
                      double window)
{
    lmg_layout layout = {.slab_count = 1, .channels = 3, .colour = {1, 1, 1}};
    layout.bounds_min = (lmg_vec3){x0, 0, z0};
    layout.bounds_max = (lmg_vec3){x1, height, z1};
    layout.size = hypot(x1 - x0, z1 - z0);
    lmg_slab *slab = &layout.slabs[0];
    /* Different numbers of cells in all dimensions, so that transposed axes show. */
    *slab = (lmg_slab){.kind = LMG_SLAB_APERTURE,
                       .a = {1, 0, 0},
                       .b = {0, 0, 1},
                       .n = {0, -1, 0},
                       .distance = (double)INFINITY,
                       .u0 = x0,
                       .u1 = x1,
                       .v0 = z0,
                       .v1 = z1,
                       .s0 = -window,
                       .s1 = window,
                       .t0 = -window,
                       .t1 = window,
                       .nu = 3,
                       .nv = 2,
                       .ns = 8,
                       .nt = 6};
    lmg_error err;
    lmg_accumulator *acc = NULL;
    lmg_field *field = NULL;
    assert_int_equal(lmg_accumulator_create(&layout, &acc, &err), LMG_OK);
    /* One ray for either half in the middle of each cell, with the cell's share of the flux: no noise.  In units of which a cell
     * has about 2^20, the fixed point's 2^-20 is a relative error of 2^-40. */
    double flux = 0, scale = 0x1p20 * slab->nu * slab->nv * slab->ns * slab->nt / (VIEW_PI * (x1 - x0) * (z1 - z0));
    for (uint32_t iv = 0; iv < slab->nv; iv++) {
        for (uint32_t iu = 0; iu < slab->nu; iu++) {
            for (uint32_t it = 0; it < slab->nt; it++) {
                for (uint32_t is = 0; is < slab->ns; is++) {
                    double etendue = lmg_slab_cell_etendue(slab, iu, iv, is, it);
                    double uvst[4] = {x0 + (x1 - x0) * (iu + 0.5) / slab->nu, z0 + (z1 - z0) * (iv + 0.5) / slab->nv,
                                      window * (2 * (is + 0.5) / slab->ns - 1), window * (2 * (it + 0.5) / slab->nt - 1)};
                    lmg_ray rays[2] = {{.number = 0}, {.number = 1}};
                    for (int i = 0; i < 2; i++) {
                        lmg_slab_ray(slab, uvst, &rays[i].origin, &rays[i].direction);
                        for (int c = 0; c < 3; c++) {
                            rays[i].flux[c] = (float)(0.5 * etendue * scale) * color[c];
                        }
                    }
                    lmg_accumulator_deposit(acc, rays, 2);
                    flux += etendue * luminance * lmg_luminance(color);
                }
            }
        }
    }
    lmg_ledger ledger = {.photons = 2 * (uint64_t)slab->nu * slab->nv * slab->ns * slab->nt, .emitted = flux, .stored = flux};
    assert_int_equal(lmg_field_reconstruct(acc, luminance / scale, &ledger, &field, &err), LMG_OK);
    lmg_accumulator_destroy(acc);
    return field;
}

double panel_flux(double x0, double x1, double z0, double z1, double luminance)
{
    return VIEW_PI * luminance * (x1 - x0) * (z1 - z0);
}

/* Illuminance from a rectangle a x b with one corner straight above: half the sum of the contour integral's two sides. */
static double corner(double a, double b, double h)
{
    double ra = sqrt(a * a + h * h), rb = sqrt(b * b + h * h);
    return 0.5 * (a / ra * atan(b / ra) + b / rb * atan(a / rb));
}

double panel_illuminance(double x0, double x1, double z0, double z1, double luminance, double x, double h, double z)
{
    /* Signed corners: the rectangle is a difference of rectangles that begin at the point. */
    return luminance *
           (corner(x1 - x, z1 - z, h) - corner(x0 - x, z1 - z, h) - corner(x1 - x, z0 - z, h) + corner(x0 - x, z0 - z, h));
}

measurement measure(const view_scene *scene, const view_camera *camera, uint32_t width, uint32_t height, uint32_t samples,
                    uint64_t seed, view_path_options options)
{
    lmg_error err;
    view_render *render = NULL;
    view_image image;
    view_render_options all = {.width = width, .height = height, .seed = seed, .path = options};
    assert_int_equal(view_render_create(scene, camera, &all, &render, &err), LMG_OK);
    assert_int_equal(view_render_pass(render, samples, NULL, &err), LMG_OK);
    assert_int_equal(view_image_create(width, height, &image, &err), LMG_OK);
    view_render_resolve(render, &image);
    double sum = 0, variance = 0;
    size_t pixels = (size_t)width * height;
    for (size_t i = 0; i < pixels; i++) {
        double se = (double)image.standard_error[i];
        sum += lmg_luminance(&image.rgb[3 * i]);
        variance += se * se;
    }
    measurement m = {sum / (double)pixels, sqrt(variance) / (double)pixels, view_render_look(render).refused};
    view_image_free(&image);
    view_render_destroy(render);
    return m;
}

view_camera camera_at(const view_scene *scene, double ex, double ey, double ez, double tx, double ty, double tz,
                      double yfov_degrees)
{
    view_camera camera;
    lmg_error err;
    lmg_vec3 eye = view_sub((lmg_vec3){ex, ey, ez}, scene->origin);
    assert_int_equal(view_camera_set(&camera, eye, (lmg_vec3){tx - ex, ty - ey, tz - ez}, (lmg_vec3){0, 1, 0},
                                     yfov_degrees * VIEW_PI / 180, &err),
                     LMG_OK);
    return camera;
}

view_scene *scene_of(const room_rectangle *rectangles, size_t count)
{
    return scene_with_recipe(rectangles, count, NULL);
}

view_scene *scene_with_recipe(const room_rectangle *rectangles, size_t count, const char *recipe)
{
    char folder[] = "/tmp/lumibox-room-XXXXXX", path[64], recipe_path[64];
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/room.gltf", folder);
    snprintf(recipe_path, sizeof recipe_path, "%s/room.recipe.json", folder);
    room_write(path, rectangles, count);
    view_scene *scene = NULL;
    lum_recipe *read = NULL;
    lmg_error err = {""};
    lmg_result r = LMG_OK;
    if (recipe) {
        FILE *file = fopen(recipe_path, "w");
        assert_non_null(file);
        fputs(recipe, file);
        assert_int_equal(fclose(file), 0);
        r = lum_recipe_read(recipe_path, &read, &err);
        unlink(recipe_path);
    }
    if (r == LMG_OK) {
        r = view_scene_create(path, read, &scene, &err);
    }
    lum_recipe_destroy(read);
    unlink(path);
    rmdir(folder);
    if (r != LMG_OK) {
        fail_msg("%s", err.message);
    }
    return scene;
}
