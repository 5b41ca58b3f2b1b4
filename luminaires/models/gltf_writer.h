/* SPDX-License-Identifier: Apache-2.0 */
/* Writes meshes, materials and a camera as glTF 2.0: NAME.gltf with its buffer in NAME.bin.  For make_models. */
#ifndef LUMIBOX_MODELS_GLTF_WRITER_H
#define LUMIBOX_MODELS_GLTF_WRITER_H

#include "mesh_builder.h"

#include <stdbool.h>

/* A material; zeros mean glTF's defaults where those make no light: black, dielectric, smooth. */
typedef struct gltf_material {
    const char *name;
    double color[3]; /* linear */
    double metallic, roughness;
    double emission_color[3], luminance; /* colour of any scale; cd/m2.  luminance 0: doesn't emit */
    double diffuse_transmission;         /* KHR_materials_diffuse_transmission; passed light has the base colour */
    double ior;                          /* > 0: clear solid glass (KHR_materials_transmission, volume, ior) */
    double abbe;                         /* > 0: its Abbe number (KHR_materials_dispersion) */
    double thickness;                    /* m, of that solid: advice to rasterizers */
    bool double_sided;
} gltf_material;

typedef struct gltf_file gltf_file;

gltf_file *gltf_begin(const char *name);
/* Adds a mesh in a node of its own.  Both are borrowed until the call returns. */
void gltf_add(gltf_file *file, const char *node, const mesh *m, const gltf_material *material);
void gltf_add_camera(gltf_file *file, const char *name, const double eye[3], const double target[3], double yfov, double aspect);
/* A spot light of KHR_lights_punctual: candela within the cone's half angle (radians), which has a sharp edge. */
void gltf_add_spot(gltf_file *file, const char *name, const double eye[3], const double target[3], double candela, double cone);
/* Writes <folder>/<name>.gltf and .bin and frees everything; ends the program with a message when it can't. */
void gltf_end(gltf_file *file, const char *folder);

/* Linear Rec.709 of a chromaticity (CIE 1931 x,y) at luminance 1. */
void gltf_chromaticity(double x, double y, double rgb[3]);

#endif
