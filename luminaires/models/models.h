/* SPDX-License-Identifier: Apache-2.0 */
/* The sample models; each writes <folder>/<name>.gltf and .bin (see dimensions.h for the measures). */
#ifndef LUMIBOX_MODELS_MODELS_H
#define LUMIBOX_MODELS_MODELS_H

void make_paraboloid_spot(const char *folder);
void make_opal_globe(const char *folder);
void make_louvred_panel(const char *folder);
void make_glass_lens(const char *folder);
void make_opal_ball(const char *folder);
/* Also writes smoke.vdb; needs OpenVDB. */
void make_smoke_lamp(const char *folder);
void make_edge_lit_panel(const char *folder);
void make_prism_lamp(const char *folder);
void make_phosphor_led(const char *folder);
void make_room(const char *folder);

#endif
