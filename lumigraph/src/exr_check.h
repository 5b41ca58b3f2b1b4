/* SPDX-License-Identifier: Apache-2.0 */
/* What exr_read.c asks about the bytes of a file before it lets OpenEXRCore see them. */
#ifndef LUMIGRAPH_EXR_CHECK_H
#define LUMIGRAPH_EXR_CHECK_H

#include <lumigraph/lumigraph.h>

/* EXR stores sizes as signed 32-bit integers, and OpenEXR refuses windows whose last coordinate reaches INT_MAX / 2. */
enum { LMG_EXR_MAX_EXTENT = INT32_MAX / 2 };

/* Attribute names: 31 characters at most, unless the file's version field carries the long-names flag, then 255. */
enum { LMG_EXR_SHORT_NAME = 31, LMG_EXR_LONG_NAME = 255 };

/* Type of the attribute that holds radiance trees. */
#define LMG_EXR_TREES "lumiboxTrees"

/* Why a file was refused; the caller puts the file's name before it. */
typedef struct lmg_exr_fault {
    lmg_result code;
    char text[320];
} lmg_exr_fault;

/*
 * Checks that bytes are, from the first to the last, an EXR file of the form that docs/format.md allows: version field, headers
 * (attribute names, types and sizes; the values of EXR's own attributes), offset tables, and chunks that follow each other without
 * gap or overlap to the end of the file, none expanding more than deflate can.  Sizes that pass are therefore bounded by the
 * size of the file.  Says nothing about the box's own attributes or the pixels.  No allocation.
 * Returns LMG_OK, or LMG_ERROR_FILE_READ (ends too early) or LMG_ERROR_FILE_FORMAT with the reason in fault.
 */
lmg_result lmg_exr_check(const unsigned char *bytes, size_t size, lmg_exr_fault *fault);

#endif
