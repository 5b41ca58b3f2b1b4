/* SPDX-License-Identifier: Apache-2.0 */
/* Small glTF files for tests: a document is put together from text and base64 data, written to a folder of its own and loaded. */
#ifndef TESTS_GLTF_WRITER_H
#define TESTS_GLTF_WRITER_H

#include <luminaires/model.h>

/* A folder under the build's, made by gltf_folder; every test program has its own. */
void gltf_folder(const char *name);
/* Path of a file in it; one static buffer per call in turn, four in all. */
const char *gltf_path(const char *file);
void gltf_write(const char *file, const void *bytes, size_t size);

/* data:application/octet-stream;base64 URI of bytes, allocated. */
char *gltf_data_uri(const void *bytes, size_t size);

/* printf into allocated text. */
char *gltf_text(const char *format, ...) __attribute__((format(printf, 1, 2)));

/* An 8-bit R,G,B,A PNG, stored without compression; allocated. */
unsigned char *gltf_png(const unsigned char *rgba, unsigned width, unsigned height, size_t *size);

/* A GLB of JSON and a binary part (may be NULL); allocated. */
unsigned char *gltf_glb(const char *json, const void *bin, size_t bin_size, size_t *size);

/* Writes json as file and loads it; fails the test when that fails.  gltf_refuse returns the message when it fails, as it should.
 */
lum_model *gltf_load(const char *file, const char *json, const lum_recipe *recipe);
const char *gltf_refuse(const char *file, const char *json, const lum_recipe *recipe, lmg_result expected);

/* Whether one of the model's warnings contains text. */
bool gltf_warned(const lum_model *model, const char *text);

#endif
