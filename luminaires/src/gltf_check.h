/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Checks a parsed glTF document before anything believes it, and strips it to what Lumibox reads: what tinygltf sees afterwards has
 * known keys of known types, values in range, indices that exist, and accessors that lie within their buffers.
 */
#ifndef LUMINAIRES_GLTF_CHECK_H
#define LUMINAIRES_GLTF_CHECK_H

#include <lumigraph/lumigraph.h>
#include <jansson.h>

enum { GLTF_MAX_IGNORED = 32 };

/* What the document has and Lumibox leaves out: extensions, each once, and the number of animations. */
typedef struct gltf_ignored {
    uint32_t animations;
    uint32_t count;
    char names[GLTF_MAX_IGNORED][64];
} gltf_ignored;

/*
 * Integers written as 3.0 become integers.  Errors: LMG_ERROR_INPUT with the element's path and name, LMG_ERROR_UNSUPPORTED for
 * required extensions and other versions of glTF.  After success root has no "extras", no animations or skins, and no unknown
 * members.
 */
lmg_result gltf_check(json_t *root, gltf_ignored *ignored, lmg_error *err);

/* Checks, once the sizes of the buffers are known, that buffer views and accessors lie within them. */
lmg_result gltf_check_reach(const json_t *root, lmg_error *err);

#endif
