/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Opens a glTF file: text or binary container, its buffers and images from wherever they are (GLB chunk, data URI, file beside it),
 * all checked, and the document parsed.  The only place where luminaires/ opens files.
 */
#ifndef LUMINAIRES_GLTF_FILE_H
#define LUMINAIRES_GLTF_FILE_H

#include "gltf_check.h"
#include "gltf_shim.h"

/* An image of the document: encoded bytes in a buffer view, or from a data URI, or in a file that is read when something uses it.
 */
typedef struct gltf_image {
    char label[96]; /* for messages: name, URI or number */
    int32_t view;   /* -1: not in a buffer */
    uint8_t *data;  /* from a data URI */
    size_t size;
    char *path; /* file, NULL if none */
} gltf_image;

/* Bytes in a buffer view, a data URI or a file, like an image's: a photometric file of EXT_lights_ies. */
typedef gltf_image gltf_profile;

typedef struct gltf_file {
    gltf_document *document;
    gltf_ignored ignored;
    gltf_image *images;
    uint32_t image_count;
    gltf_profile *profiles;
    uint32_t profile_count;
    uint64_t hash; /* FNV-1a of the file and of the buffers; image files are added by gltf_image_load */
} gltf_file;

/* Messages don't name the file: the caller puts its name in front. */
lmg_result gltf_open(const char *path, gltf_file **out, lmg_error *err);
void gltf_close(gltf_file *file);

/* Decodes image number `index` (of the document): R,G,B,A of 8 or 16 bits; *pixels is freed by free(). */
lmg_result gltf_image_load(gltf_file *file, uint32_t index, uint32_t *width, uint32_t *height, int *bits, void **pixels,
                           lmg_error *err);

/* Reads photometric file number `index` of EXT_lights_ies. */
struct lum_photometry;
lmg_result gltf_profile_load(gltf_file *file, uint32_t index, struct lum_photometry **out, lmg_error *err);

/* Reads a whole regular file, at most `limit` bytes; *bytes has a zero after its end and is freed by free(). */
lmg_result lum_read_file(const char *path, size_t limit, uint8_t **bytes, size_t *size, lmg_error *err);

#endif
