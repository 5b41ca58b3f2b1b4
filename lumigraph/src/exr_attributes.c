/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Box attributes of EXR headers, by name: docs/format.md's tables in C, reading first, then writing.  Relies on OpenEXRCore, and
 * when reading on exr_check.c having seen the headers before.
 */
#include "exr_attributes.h"
#include "box_content.h"
#include "exr_check.h"
#include "trees.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---------------------------------------------------------------------------------------------------------------------- reading */

static lmg_result attribute_fault(lmg_exr_file *file, int part, const char *name, exr_result_t exr, lmg_error *err)
{
    if (exr == EXR_ERR_NO_ATTR_BY_NAME) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: not a box file: part %d has no attribute \"%s\"", file->where, part, name);
    }
    return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d, attribute \"%s\": %s", file->where, part, name,
                    exr_get_default_error_message(exr));
}

/* Looks before it asks, so that a missing attribute isn't an error to OpenEXRCore, which would note it as its first message. */
static lmg_result need_attribute(lmg_exr_file *file, int part, const char *name, exr_attribute_type_t type, lmg_error *err)
{
    const exr_attribute_t *attribute = NULL;
    const exr_result_t exr = exr_get_attribute_by_name(file->context, part, name, &attribute);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(file, part, name, exr, err);
    }
    return attribute->type == type ? LMG_OK : attribute_fault(file, part, name, EXR_ERR_ATTR_TYPE_MISMATCH, err);
}

static lmg_result get_int(lmg_exr_file *file, int part, const char *name, int32_t *out, lmg_error *err)
{
    LMG_TRY(need_attribute(file, part, name, EXR_ATTR_INT, err));
    const exr_result_t exr = exr_attr_get_int(file->context, part, name, out);
    return exr == EXR_ERR_SUCCESS ? LMG_OK : attribute_fault(file, part, name, exr, err);
}

static lmg_result get_double(lmg_exr_file *file, int part, const char *name, double *out, lmg_error *err)
{
    LMG_TRY(need_attribute(file, part, name, EXR_ATTR_DOUBLE, err));
    const exr_result_t exr = exr_attr_get_double(file->context, part, name, out);
    return exr == EXR_ERR_SUCCESS ? LMG_OK : attribute_fault(file, part, name, exr, err);
}

static lmg_result get_v2d(lmg_exr_file *file, int part, const char *name, double *x, double *y, lmg_error *err)
{
    LMG_TRY(need_attribute(file, part, name, EXR_ATTR_V2D, err));
    exr_attr_v2d_t v;
    const exr_result_t exr = exr_attr_get_v2d(file->context, part, name, &v);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(file, part, name, exr, err);
    }
    *x = v.x;
    *y = v.y;
    return LMG_OK;
}

static lmg_result get_v3d(lmg_exr_file *file, int part, const char *name, lmg_vec3 *out, lmg_error *err)
{
    LMG_TRY(need_attribute(file, part, name, EXR_ATTR_V3D, err));
    exr_attr_v3d_t v;
    const exr_result_t exr = exr_attr_get_v3d(file->context, part, name, &v);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(file, part, name, exr, err);
    }
    *out = (lmg_vec3){v.x, v.y, v.z};
    return LMG_OK;
}

static lmg_result get_cells(lmg_exr_file *file, int part, const char *name, uint32_t *x, uint32_t *y, lmg_error *err)
{
    LMG_TRY(need_attribute(file, part, name, EXR_ATTR_V2I, err));
    exr_attr_v2i_t v;
    const exr_result_t exr = exr_attr_get_v2i(file->context, part, name, &v);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(file, part, name, exr, err);
    }
    if (v.x < 1 || v.x > 65535 || v.y < 1 || v.y > 65535) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d: %s %d x %d is outside 1 to 65535", file->where, part, name,
                        (int)v.x, (int)v.y);
    }
    *x = (uint32_t)v.x;
    *y = (uint32_t)v.y;
    return LMG_OK;
}

/* A string without zeros inside, as a copy; to be freed by the caller. */
static lmg_result get_string(lmg_exr_file *file, int part, const char *name, char **out, lmg_error *err)
{
    LMG_TRY(need_attribute(file, part, name, EXR_ATTR_STRING, err));
    int32_t length = 0;
    const char *text = NULL;
    const exr_result_t exr = exr_attr_get_string(file->context, part, name, &length, &text);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(file, part, name, exr, err);
    }
    if (length < 0 || (length > 0 && (text == NULL || memchr(text, 0, (size_t)length) != NULL))) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d, attribute \"%s\": a zero byte inside a text", file->where, part,
                        name);
    }
    char *copy = malloc((size_t)length + 1);
    if (copy == NULL) {
        return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for a text of %d bytes", file->where, (int)length);
    }
    if (length > 0) {
        memcpy(copy, text, (size_t)length);
    }
    copy[length] = 0;
    *out = copy;
    return LMG_OK;
}

/* An unsigned number of exactly this many hexadecimal digits (base 16) or of 1 to 20 decimal ones. */
static bool parse_number(const char *text, unsigned base, uint64_t *out)
{
    const size_t length = strlen(text);
    uint64_t value = 0;
    if (base == 16 ? length != 16 : length < 1 || length > 20) {
        return false;
    }
    for (const char *p = text; *p != 0; p++) {
        unsigned digit;
        if (*p >= '0' && *p <= '9') {
            digit = (unsigned)(*p - '0');
        } else if (base == 16 && *p >= 'a' && *p <= 'f') {
            digit = (unsigned)(*p - 'a') + 10;
        } else {
            return false;
        }
        if (value > (UINT64_MAX - digit) / base) {
            return false;
        }
        value = value * base + digit;
    }
    *out = value;
    return true;
}

static lmg_result get_number(lmg_exr_file *file, const char *name, unsigned base, uint64_t *out, lmg_error *err)
{
    char *text = NULL;
    LMG_TRY(get_string(file, 0, name, &text, err));
    const bool good = parse_number(text, base, out);
    free(text);
    return good ? LMG_OK
                : lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: attribute \"%s\" isn't a %s number", file->where, name,
                           base == 16 ? "16-digit hexadecimal" : "decimal");
}

static lmg_result read_slab(lmg_exr_file *file, uint32_t index, lmg_slab *s, lmg_error *err)
{
    const int part = (int)index;
    int32_t number;
    LMG_TRY(get_int(file, part, "lumibox.slab", &number, err));
    if (number != part) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d says it is slab %d", file->where, part, (int)number);
    }
    char *kind = NULL;
    LMG_TRY(get_string(file, part, "lumibox.kind", &kind, err));
    const bool cube = strcmp(kind, "cube") == 0, aperture = strcmp(kind, "aperture") == 0;
    free(kind);
    if (!cube && !aperture) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %d: lumibox.kind is neither \"cube\" nor \"aperture\"", file->where,
                        part);
    }
    s->kind = cube ? LMG_SLAB_CUBE : LMG_SLAB_APERTURE;
    LMG_TRY(get_v3d(file, part, "lumibox.o", &s->o, err));
    LMG_TRY(get_v3d(file, part, "lumibox.a", &s->a, err));
    LMG_TRY(get_v3d(file, part, "lumibox.b", &s->b, err));
    LMG_TRY(get_v3d(file, part, "lumibox.n", &s->n, err));
    LMG_TRY(get_double(file, part, "lumibox.distance", &s->distance, err));
    LMG_TRY(get_v2d(file, part, "lumibox.u", &s->u0, &s->u1, err));
    LMG_TRY(get_v2d(file, part, "lumibox.v", &s->v0, &s->v1, err));
    LMG_TRY(get_v2d(file, part, "lumibox.s", &s->s0, &s->s1, err));
    LMG_TRY(get_v2d(file, part, "lumibox.t", &s->t0, &s->t1, err));
    LMG_TRY(get_cells(file, part, "lumibox.uvCells", &s->nu, &s->nv, err));
    LMG_TRY(get_cells(file, part, "lumibox.stCells", &s->ns, &s->nt, err));

    exr_attr_box2i_t window;
    uint32_t tile_width, tile_height;
    exr_tile_level_mode_t level;
    exr_tile_round_mode_t rounding;
    exr_result_t exr = exr_get_data_window(file->context, part, &window);
    if (exr == EXR_ERR_SUCCESS) {
        exr = exr_get_tile_descriptor(file->context, part, &tile_width, &tile_height, &level, &rounding);
    }
    if (exr != EXR_ERR_SUCCESS) {
        return lmg_exr_fail(err, LMG_ERROR_FILE_FORMAT, file, "can't get the picture's size", exr);
    }
    if (tile_width != s->ns || tile_height != s->nt || (uint64_t)s->nu * s->ns != (uint64_t)window.max.x + 1 ||
        (uint64_t)s->nv * s->nt != (uint64_t)window.max.y + 1) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT,
                        "%s: part %d: %u x %u x %u x %u cells don't match a picture of %d x %d in tiles of %u x %u", file->where,
                        part, s->nu, s->nv, s->ns, s->nt, window.max.x + 1, window.max.y + 1, tile_width, tile_height);
    }
    return LMG_OK;
}

lmg_result lmg_exr_read_units(lmg_exr_file *file, uint32_t slabs, double units[LMG_MAX_SLABS], lmg_rounding *rounding, lmg_error *err)
{
    LMG_TRY(get_v2d(file, 0, "lumibox.rounding", &rounding->loss, &rounding->half_loss, err));
    if (!isfinite(rounding->loss) || !isfinite(rounding->half_loss) || rounding->loss < 0 || rounding->half_loss < 0) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: says that rounding lost %g and %g of the noise", file->where, rounding->loss,
                        rounding->half_loss);
    }
    for (uint32_t i = 0; i < slabs; i++) {
        LMG_TRY(get_double(file, (int)i, "lumibox.unit", &units[i], err));
        if (!(units[i] > 0) || !isfinite(units[i])) {
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: part %u: the unit %g isn't positive and finite", file->where, i, units[i]);
        }
    }
    return LMG_OK;
}

lmg_result lmg_exr_read_layout(lmg_exr_file *file, lmg_layout *layout, int32_t *version, lmg_error *err)
{
    int parts = 0;
    exr_result_t exr = exr_get_count(file->context, &parts);
    if (exr != EXR_ERR_SUCCESS) {
        return lmg_exr_fail(err, LMG_ERROR_FILE_FORMAT, file, "can't count the parts", exr);
    }
    int32_t number;
    LMG_TRY(get_int(file, 0, "lumibox.version", &number, err));
    if (number != LMG_BOX_EXACT && number != LMG_BOX_ROUNDED) {
        return lmg_fail(err, LMG_ERROR_FILE_VERSION, "%s: box format version %d; this library (%s) reads versions 1 and 2", file->where,
                        (int)number, LMG_VERSION_STRING);
    }
    *version = number;
    LMG_TRY(get_int(file, 0, "lumibox.slabs", &number, err));
    if (number != parts || parts < 1 || parts > LMG_MAX_SLABS) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: says it has %d slabs, but has %d parts", file->where, (int)number, parts);
    }
    layout->slab_count = (uint32_t)parts;
    LMG_TRY(get_int(file, 0, "lumibox.channels", &number, err));
    const exr_attr_chlist_t *channels = NULL;
    exr = exr_get_channels(file->context, 0, &channels);
    if (exr != EXR_ERR_SUCCESS) {
        return lmg_exr_fail(err, LMG_ERROR_FILE_FORMAT, file, "can't get the channels", exr);
    }
    if ((channels->entries[0].pixel_type == EXR_PIXEL_HALF) != (*version == LMG_BOX_ROUNDED)) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: says it has format version %d, but its pixels are of another type", file->where,
                        (int)*version);
    }
    if ((number != 1 && number != 3) || channels->num_channels != number + 2) {
        return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: says it has %d colour channels, but its parts hold %d channels in all",
                        file->where, (int)number, channels->num_channels);
    }
    layout->channels = (uint32_t)number;
    LMG_TRY(need_attribute(file, 0, "lumibox.colour", EXR_ATTR_V3F, err));
    exr_attr_v3f_t colour;
    exr = exr_attr_get_v3f(file->context, 0, "lumibox.colour", &colour);
    if (exr != EXR_ERR_SUCCESS) {
        return attribute_fault(file, 0, "lumibox.colour", exr, err);
    }
    layout->colour[0] = colour.x;
    layout->colour[1] = colour.y;
    layout->colour[2] = colour.z;
    LMG_TRY(get_v3d(file, 0, "lumibox.boundsMin", &layout->bounds_min, err));
    LMG_TRY(get_v3d(file, 0, "lumibox.boundsMax", &layout->bounds_max, err));
    LMG_TRY(get_double(file, 0, "lumibox.size", &layout->size, err));
    for (uint32_t i = 0; i < layout->slab_count; i++) {
        LMG_TRY(read_slab(file, i, &layout->slabs[i], err));
    }
    lmg_error reason = {.message = ""};
    const lmg_result result = lmg_layout_check(layout, &reason);
    return result == LMG_OK ? LMG_OK
                            : lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: impossible layout: %.240s", file->where, reason.message);
}

static lmg_result read_texts(lmg_exr_file *file, lmg_field *field, lmg_error *err)
{
    static const char prefix[] = "lumibox.text.";
    int32_t count = 0;
    const exr_result_t exr = exr_get_attribute_count(file->context, 0, &count);
    if (exr != EXR_ERR_SUCCESS) {
        return lmg_exr_fail(err, LMG_ERROR_FILE_FORMAT, file, "can't count the attributes", exr);
    }
    for (int32_t i = 0; i < count; i++) {
        const exr_attribute_t *attribute = NULL;
        if (exr_get_attribute_by_index(file->context, 0, EXR_ATTR_LIST_SORTED_ORDER, i, &attribute) != EXR_ERR_SUCCESS) {
            return lmg_fail(err, LMG_ERROR_FILE_FORMAT, "%s: can't get attribute %d", file->where, (int)i);
        }
        if (strncmp(attribute->name, prefix, strlen(prefix)) == 0) {
            char *value = NULL;
            LMG_TRY(get_string(file, 0, attribute->name, &value, err));
            lmg_error reason = {.message = ""};
            const lmg_result result = lmg_field_set_text(field, attribute->name + strlen(prefix), value, &reason);
            free(value);
            if (result != LMG_OK) {
                return lmg_fail(err, result == LMG_ERROR_MEMORY ? result : LMG_ERROR_FILE_FORMAT, "%s: attribute \"%s\": %.200s",
                                file->where, attribute->name, reason.message);
            }
        }
    }
    return LMG_OK;
}

/* The trees, if there are any. */
static lmg_result read_trees(lmg_exr_file *file, lmg_field *field, lmg_error *err)
{
    const exr_attribute_t *attribute = NULL;
    if (exr_get_attribute_by_name(file->context, 0, "lumibox.trees", &attribute) != EXR_ERR_SUCCESS) {
        return LMG_OK;
    }
    LMG_TRY(need_attribute(file, 0, "lumibox.trees", EXR_ATTR_OPAQUE, err));
    lmg_error reason = {.message = ""};
    const lmg_result result = lmg_trees_decode(attribute->opaque->packed_data, (size_t)attribute->opaque->size, &field->layout, &field->trees, &reason);
    return result == LMG_OK ? LMG_OK : lmg_fail(err, result, "%s: %.240s", file->where, reason.message);
}

lmg_result lmg_exr_read_hash(lmg_exr_file *file, uint64_t *hash, lmg_error *err)
{
    return get_number(file, "lumibox.hash", 16, hash, err);
}

lmg_result lmg_exr_read_records(lmg_exr_file *file, lmg_field *field, lmg_error *err)
{
    LMG_TRY(get_number(file, "lumibox.photons", 10, &field->ledger.photons, err));
    double ledger[LMG_LEDGER_ENTRIES][2];
    for (int i = 0; i < LMG_LEDGER_ENTRIES; i++) {
        LMG_TRY(get_v2d(file, 0, lmg_ledger_names[i], &ledger[i][0], &ledger[i][1], err));
    }
    lmg_ledger_set(&field->ledger, (const double(*)[2])ledger);
    LMG_TRY(read_trees(file, field, err));
    return read_texts(file, field, err);
}

/* ---------------------------------------------------------------------------------------------------------------------- writing */

/* Attributes are set one after the other; the first failure is kept and reported once. */
typedef struct attribute_setter {
    exr_context_t context;
    int part;
    exr_result_t first;
} attribute_setter;

static void note(attribute_setter *s, exr_result_t result)
{
    if (s->first == EXR_ERR_SUCCESS) {
        s->first = result;
    }
}

static void set_v2d(attribute_setter *s, const char *name, double x, double y)
{
    exr_attr_v2d_t v;
    v.x = x;
    v.y = y;
    note(s, exr_attr_set_v2d(s->context, s->part, name, &v));
}

static void set_v3d(attribute_setter *s, const char *name, lmg_vec3 vec)
{
    exr_attr_v3d_t v;
    v.x = vec.x;
    v.y = vec.y;
    v.z = vec.z;
    note(s, exr_attr_set_v3d(s->context, s->part, name, &v));
}

static void set_v2i(attribute_setter *s, const char *name, uint32_t x, uint32_t y)
{
    exr_attr_v2i_t v;
    v.x = (int32_t)x;
    v.y = (int32_t)y;
    note(s, exr_attr_set_v2i(s->context, s->part, name, &v));
}

static void set_part(attribute_setter *s, const lmg_tiles *tiles, uint32_t slab, int32_t display_width, int32_t display_height,
                     exr_compression_t compression)
{
    const lmg_layout *l = tiles->layout;
    const lmg_slab *geometry = &l->slabs[slab];
    char name[16];
    snprintf(name, sizeof name, "slab%02u", slab);
    note(s, exr_add_part(s->context, name, EXR_STORAGE_TILED, &s->part));
    if (s->first != EXR_ERR_SUCCESS) {
        return;
    }
    exr_attr_box2i_t data = {.min = {.x = 0, .y = 0}}, display = data;
    data.max.x = (int32_t)(geometry->nu * geometry->ns) - 1;
    data.max.y = (int32_t)(geometry->nv * geometry->nt) - 1;
    display.max.x = display_width - 1;
    display.max.y = display_height - 1;
    const exr_attr_v2f_t center = {.x = 0, .y = 0};
    note(s, exr_initialize_required_attr(s->context, s->part, &display, &data, 1.0f, &center, 1.0f, EXR_LINEORDER_INCREASING_Y,
                                         compression));
    static const char *const one[] = {"Y", "half_a.Y", "stderr.Y"}, *const three[] = {"B", "G", "R", "half_a.Y", "stderr.Y"};
    static const char *const rounded[] = {"BY", "RY", "Y", "difference", "weight"};
    for (uint32_t c = 0; c < l->channels + 2; c++) {
        const char *channel = tiles->units != NULL ? rounded[c + 3 - l->channels] : l->channels == 1 ? one[c] : three[c];
        note(s, exr_add_channel(s->context, s->part, channel, tiles->units != NULL ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT, EXR_PERCEPTUALLY_LINEAR,
                                1, 1));
    }
    if (tiles->units != NULL) {
        note(s, exr_attr_set_double(s->context, s->part, "lumibox.unit", tiles->units[slab]));
    }
    note(s, exr_set_tile_descriptor(s->context, s->part, geometry->ns, geometry->nt, EXR_TILE_ONE_LEVEL, EXR_TILE_ROUND_DOWN));
    note(s, exr_attr_set_float(s->context, s->part, "whiteLuminance", 1.0f)); /* R = G = B = 1 is 1 cd/m2 */
    note(s, exr_attr_set_int(s->context, s->part, "lumibox.slab", (int32_t)slab));
    note(s, exr_attr_set_string(s->context, s->part, "lumibox.kind", geometry->kind == LMG_SLAB_CUBE ? "cube" : "aperture"));
    set_v3d(s, "lumibox.o", geometry->o);
    set_v3d(s, "lumibox.a", geometry->a);
    set_v3d(s, "lumibox.b", geometry->b);
    set_v3d(s, "lumibox.n", geometry->n);
    note(s, exr_attr_set_double(s->context, s->part, "lumibox.distance", geometry->distance));
    set_v2d(s, "lumibox.u", geometry->u0, geometry->u1);
    set_v2d(s, "lumibox.v", geometry->v0, geometry->v1);
    set_v2d(s, "lumibox.s", geometry->s0, geometry->s1);
    set_v2d(s, "lumibox.t", geometry->t0, geometry->t1);
    set_v2i(s, "lumibox.uvCells", geometry->nu, geometry->nv);
    set_v2i(s, "lumibox.stCells", geometry->ns, geometry->nt);
}

/* OpenEXRCore asks how many bytes an attribute of a type that it doesn't know takes, then for the bytes: they are packed already. */
static exr_result_t pack_trees(exr_context_t context, const void *data, int32_t size, int32_t *out_size, void *out)
{
    (void)context;
    *out_size = size;
    if (out != NULL) {
        memcpy(out, data, (size_t)size);
    }
    return EXR_ERR_SUCCESS;
}

lmg_result lmg_exr_write_header(lmg_exr_file *file, const lmg_tiles *tiles, exr_compression_t compression, uint64_t hash,
                                lmg_error *err)
{
    const lmg_field *field = tiles->field;
    const lmg_layout *l = &field->layout;
    attribute_setter s = {.context = file->context};
    bool long_names = false;
    for (size_t i = 0; i < field->text_count; i++) {
        long_names = long_names || strlen("lumibox.text.") + strlen(field->texts[i].name) > LMG_EXR_SHORT_NAME;
    }
    note(&s, exr_set_longname_support(file->context, long_names));
    int32_t display_width = 1, display_height = 1; /* OpenEXR wants one display window for all parts */
    for (uint32_t i = 0; i < l->slab_count; i++) {
        const int32_t width = (int32_t)(l->slabs[i].nu * l->slabs[i].ns), height = (int32_t)(l->slabs[i].nv * l->slabs[i].nt);
        display_width = width > display_width ? width : display_width;
        display_height = height > display_height ? height : display_height;
    }
    for (uint32_t i = 0; i < l->slab_count; i++) {
        set_part(&s, tiles, i, display_width, display_height, compression);
    }
    s.part = 0;
    char number[24];
    note(&s, exr_attr_set_int(s.context, 0, "lumibox.version", tiles->units != NULL ? LMG_BOX_ROUNDED : LMG_BOX_EXACT));
    note(&s, exr_attr_set_int(s.context, 0, "lumibox.slabs", (int32_t)l->slab_count));
    note(&s, exr_attr_set_int(s.context, 0, "lumibox.channels", (int32_t)l->channels));
    exr_attr_v3f_t colour;
    colour.x = l->colour[0];
    colour.y = l->colour[1];
    colour.z = l->colour[2];
    note(&s, exr_attr_set_v3f(s.context, 0, "lumibox.colour", &colour));
    set_v3d(&s, "lumibox.boundsMin", l->bounds_min);
    set_v3d(&s, "lumibox.boundsMax", l->bounds_max);
    note(&s, exr_attr_set_double(s.context, 0, "lumibox.size", l->size));
    snprintf(number, sizeof number, "%" PRIu64, field->ledger.photons);
    note(&s, exr_attr_set_string(s.context, 0, "lumibox.photons", number));
    if (tiles->units != NULL) {
        set_v2d(&s, "lumibox.rounding", tiles->rounding.loss, tiles->rounding.half_loss);
    }
    double ledger[LMG_LEDGER_ENTRIES][2];
    lmg_ledger_get(&field->ledger, ledger);
    for (int i = 0; i < LMG_LEDGER_ENTRIES; i++) {
        set_v2d(&s, lmg_ledger_names[i], ledger[i][0], ledger[i][1]);
    }
    snprintf(number, sizeof number, "%016" PRIx64, hash);
    note(&s, exr_attr_set_string(s.context, 0, "lumibox.hash", number));
    for (size_t i = 0; i < field->text_count; i++) {
        char name[sizeof "lumibox.text." + sizeof field->texts[i].name];
        snprintf(name, sizeof name, "lumibox.text.%s", field->texts[i].name);
        note(&s, exr_attr_set_string(s.context, 0, name, field->texts[i].value));
    }
    unsigned char *trees = NULL;
    if (field->trees) {
        size_t size;
        trees = lmg_trees_encode(field->trees, &size);
        if (!trees) {
            return lmg_fail(err, LMG_ERROR_MEMORY, "%s: no memory for its radiance trees", file->where);
        }
        note(&s, exr_register_attr_type_handler(s.context, LMG_EXR_TREES, NULL, pack_trees, NULL));
        note(&s, exr_attr_set_user(s.context, 0, "lumibox.trees", LMG_EXR_TREES, (int32_t)size, trees));
    }
    if (s.first == EXR_ERR_SUCCESS) {
        s.first = exr_write_header(s.context);
    }
    free(trees);
    return s.first == EXR_ERR_SUCCESS ? LMG_OK : lmg_exr_fail(err, LMG_ERROR_FILE_WRITE, file, "can't write the header", s.first);
}
