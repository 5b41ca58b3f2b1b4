/* SPDX-License-Identifier: Apache-2.0 */
/* Values of accessors: strided, normalised, quantised and sparse ones come out as plain numbers. */
#ifndef LUMINAIRES_GLTF_ACCESSOR_H
#define LUMINAIRES_GLTF_ACCESSOR_H

#include "gltf_shim.h"

/*
 * All elements as doubles, `components` each, in *values (freed by free()).  The accessor must have `components` components.
 * Integers are mapped as the specification says when normalised, and taken as they are otherwise.  Errors: LMG_ERROR_INPUT (sparse
 * indices out of order or range, number of components), LMG_ERROR_MEMORY; the message doesn't name the accessor's user.
 */
lmg_result gltf_read_numbers(const gltf_document *doc, int32_t accessor, int32_t components, double **values, lmg_error *err);

/* All elements of a scalar accessor of unsigned integers. */
lmg_result gltf_read_indices(const gltf_document *doc, int32_t accessor, uint32_t **values, lmg_error *err);

#endif
