/* SPDX-License-Identifier: Apache-2.0 */
/* Small fields with known, uneven content for the tests of box files, and exact comparison of fields. */
#ifndef LUMIBOX_TESTS_BOX_FIXTURE_H
#define LUMIBOX_TESTS_BOX_FIXTURE_H

#include <lumigraph/lumigraph.h>

/* A field of 1 to 8 slabs: the first an oblique aperture (aperture true), the others cube slabs, with directions or with a finite
 * distance in turn.  Resolutions are different primes (and 1) in every dimension, so that a transposed axis shows.  Cells hold
 * pseudo-random numbers from seed, with zeros, negative colour components and the extremes of float among them.  It comes prepared. */
lmg_field *fixture_field(uint32_t slabs, bool aperture, uint32_t channels, uint64_t seed);

/* Up to six cube slabs of the given resolution on the faces of a cube, with photon-like content (sparse, counts times what one photon
 * is worth in the cell), for measurements of size and speed. */
lmg_field *fixture_photon_field(uint32_t slabs, uint32_t nu, uint32_t nv, uint32_t ns, uint32_t nt, uint32_t channels, uint64_t seed);

/* NULL when the fields are equal to the last bit in everything a file holds, else what differs (static text). */
const char *fixture_difference(const lmg_field *a, const lmg_field *b);

/* The whole of a file, owned by the caller; fails the test when it can't be read. */
unsigned char *fixture_load(const char *path, size_t *size);

/* A fresh directory for a test's files, and its removal with everything in it. */
void fixture_directory(char path[256]);
void fixture_remove_directory(const char *path);

#endif
