/* SPDX-License-Identifier: Apache-2.0 */
/*
 * A second reader of box files, written from docs/format.md alone.  It shares no code and no header with the library and parses the
 * EXR container itself, so that text, library and reader keep each other honest.  It's for files that are known to be good: it stops
 * at what it doesn't expect, but isn't meant for hostile input.
 */
#ifndef LUMIBOX_TESTS_BOX_READER_H
#define LUMIBOX_TESTS_BOX_READER_H

#include <stdint.h>

typedef struct box_slab {
    int aperture; /* else cube */
    double o[3], a[3], b[3], n[3], distance;
    double u[2], v[2], s[2], t[2];
    uint32_t nu, nv, ns, nt;
    float *radiance; /* cells in the order of the file: iv, iu, it, is slowest to fastest; channels per cell, R, G, B or Y */
    float *standard_error, *half_a;
    double unit;      /* of rounded cells (version 2) ... */
    uint16_t *codes;  /* ... and the half floats of its tiles, as they lie in the file */
} box_slab;

typedef struct box {
    int version, slabs, channels, texts;
    float colour[3];
    double bounds_min[3], bounds_max[3], size;
    uint64_t photons, hash;
    double flux[5][2]; /* emitted, stored, residual, absorbed, lost; each with its standard error */
    double rounding[2]; /* version 2 */
    char *text_name[64], *text[64]; /* in the order of the file */
    box_slab slab[32];
} box;

/* 0, or -1 with a line on why in message.  box_free in either case. */
int box_read(const char *path, box *out, char message[256]);
void box_free(box *b);

/* The content hash as section "Content hash" of the text computes it. */
uint64_t box_hash(const box *b);

/* The slab a ray belongs to, or -1, and its cell (iu, iv, is, it). */
int box_find(const box *b, const double origin[3], const double direction[3], uint32_t cell[4]);

/* The ray in the middle of a cell. */
void box_ray(const box_slab *slab, const uint32_t cell[4], double origin[3], double direction[3]);

#endif
