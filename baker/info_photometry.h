/* SPDX-License-Identifier: Apache-2.0 */
/* What lumibake info says of a photometric file. */
#ifndef BAKER_INFO_PHOTOMETRY_H
#define BAKER_INFO_PHOTOMETRY_H

#include <lumigraph/lumigraph.h>

#include <jansson.h>

/* Reads the file and prints, or with json gives the object (the caller's) instead.  Errors: those of lum_photometry_read. */
lmg_result info_photometry(const char *path, bool json, json_t **object, lmg_error *err);

#endif
