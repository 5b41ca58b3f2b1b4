/* SPDX-License-Identifier: Apache-2.0 */
/* Photometric files as wholes: which format it is, reading from disk or memory, writing beside the final name.  The formats are in
 * their own files. */
#include "photometry_file.h"

#include "gltf_file.h"
#include "text.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* Far above any photometric file (a quarter of a degree in both angles is 10 MB). */
#define MAX_PHOTOMETRY_BYTES ((size_t)256 << 20)

static bool ends_in(const char *path, const char *ending)
{
    const size_t n = strlen(path), m = strlen(ending);
    return n > m && strcasecmp(path + n - m, ending) == 0;
}

lum_photometry_format lum_photometry_format_of_name(const char *path)
{
    static const struct {
        const char *ending;
        lum_photometry_format format;
    } names[] = {{".ies", LUM_FORMAT_IES},  {".ldt", LUM_FORMAT_EULUMDAT}, {".eul", LUM_FORMAT_EULUMDAT},
                 {".xml", LUM_FORMAT_TM33}, {".tm33", LUM_FORMAT_TM33},    {".exr", LUM_FORMAT_GONIOMETRIC_EXR},
                 {".usda", LUM_FORMAT_USD}, {".gltf", LUM_FORMAT_GLTF}};
    if (ends_in(path, ".box.exr"))
        return LUM_FORMAT_AUTO;
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (ends_in(path, names[i].ending))
            return names[i].format;
    return LUM_FORMAT_AUTO;
}

bool lum_photometry_is_readable_name(const char *path)
{
    const lum_photometry_format format = lum_photometry_format_of_name(path);
    return format == LUM_FORMAT_IES || format == LUM_FORMAT_EULUMDAT || format == LUM_FORMAT_TM33;
}

/* ------------------------------------------------------------------------------------------------------------- reading */

static const char *next_line(const char *line)
{
    line += strcspn(line, "\n");
    return line + (*line == '\n');
}

static bool is_numeric_line(const char *line)
{
    line += strspn(line, " \t");
    const char *end = line + strspn(line, "0123456789.,");
    end += strspn(end, " \t");
    return end > line && *end == '\n';
}

/* Not XML: EULUMDAT has numbers in lines 2 to 5, LM-63 its name in the first line or a line TILT=.  A line 2 that is a number alone
 * is enough where nothing else fits, so that the message can say what is missing. */
static lum_photometry_format format_of_text(const char *text)
{
    if (strncasecmp(text, "IESNA", 5) == 0 || strncasecmp(text, "IES:", 4) == 0)
        return LUM_FORMAT_IES;
    const char *second = next_line(text), *line = second;
    int numbers = 0;
    for (; numbers < 4 && is_numeric_line(line); line = next_line(line))
        numbers++;
    if (numbers == 4)
        return LUM_FORMAT_EULUMDAT;
    for (line = text; *line; line = next_line(line)) {
        const char *start = line + strspn(line, " \t");
        if (strncasecmp(start, "TILT", 4) == 0 && start[4 + strspn(start + 4, " \t")] == '=')
            return LUM_FORMAT_IES;
    }
    return is_numeric_line(second) ? LUM_FORMAT_EULUMDAT : LUM_FORMAT_AUTO;
}

static lmg_result read_bytes(const void *bytes, size_t size, const char *path, lum_photometry **out, lmg_error *err)
{
    const uint8_t *b = bytes;
    size_t start = size >= 3 && b[0] == 0xef && b[1] == 0xbb && b[2] == 0xbf ? 3 : 0;
    while (start < size && (b[start] == ' ' || b[start] == '\t' || b[start] == '\r' || b[start] == '\n'))
        start++;
    /* XML says its encoding itself (UTF-16 starts with a byte order mark). */
    if (start < size && (b[start] == '<' || (size >= 2 && ((b[0] == 0xff && b[1] == 0xfe) || (b[0] == 0xfe && b[1] == 0xff)))))
        return lum_tm33_read((const char *)bytes + start, size - start, out, err);
    if (start == size)
        return lmg_fail(err, LMG_ERROR_INPUT, "is empty");
    char *text;
    LUM_TRY(lum_text_decode(bytes, size, &text, err));
    const lum_photometry_format format = format_of_text(text);
    const lmg_result result = format == LUM_FORMAT_IES ? lum_ies_read(text, path, out, err)
                              : format == LUM_FORMAT_EULUMDAT
                                  ? lum_eulumdat_read(text, out, err)
                                  : lmg_fail(err, LMG_ERROR_INPUT,
                                             "is no photometric file: neither IES (no TILT= line) nor EULUMDAT "
                                             "(line 2 is no type indicator) nor TM-33 (no XML)");
    free(text);
    return result;
}

lmg_result lum_photometry_read_memory(const void *bytes, size_t size, const char *name, lum_photometry **out, lmg_error *err)
{
    *out = NULL;
    const lmg_result result = read_bytes(bytes, size, NULL, out, err);
    if (result != LMG_OK && name)
        lum_prefix_error(err, lum_base_name(name));
    return result;
}

lmg_result lum_photometry_read(const char *path, lum_photometry **out, lmg_error *err)
{
    *out = NULL;
    uint8_t *bytes;
    size_t size;
    lmg_result result = lum_read_file(path, MAX_PHOTOMETRY_BYTES, &bytes, &size, err);
    if (result == LMG_OK)
        result = read_bytes(bytes, size, path, out, err);
    free(bytes);
    if (result != LMG_OK)
        lum_prefix_error(err, lum_base_name(path));
    return result;
}

/* ------------------------------------------------------------------------------------------------------------- writing */

/* The .ies that a USD file points to: beside it, same name. */
static char *ies_beside(const char *path)
{
    const size_t n = strlen(path);
    char *name = malloc(n + 5);
    if (name) {
        const char *dot = strrchr(lum_base_name(path), '.');
        sprintf(name, "%.*s.ies", (int)(dot ? (size_t)(dot - path) : n), path);
    }
    return name;
}

static lmg_result write_text(const lum_photometry *p, lum_photometry_format format, const char *path,
                             const lum_photometry_write_options *options, char loss[512], lmg_error *err)
{
    lum_photometry_measures m;
    LUM_TRY(lum_photometry_measure(p, &m, err));
    lum_output o = {0}, ies = {0};
    lmg_result result = LMG_OK;
    char *beside = NULL;
    if (format == LUM_FORMAT_USD || format == LUM_FORMAT_GLTF)
        lum_ies_write(p, true, options, &ies, loss);
    switch (format) {
    case LUM_FORMAT_EULUMDAT:
        lum_eulumdat_write(p, options, m.flux, m.down, &o, loss);
        break;
    case LUM_FORMAT_TM33:
        result = lum_tm33_write(p, options, m.flux, &o, loss, err);
        break;
    case LUM_FORMAT_GLTF:
        result = lum_gltf_write(p, &ies, m.flux, &o, err);
        break;
    case LUM_FORMAT_USD:
        beside = ies_beside(path);
        if (beside) {
            lum_usd_write(p, lum_base_name(beside), m.flux, &o);
            if (!ies.failed)
                result = lum_write_whole_file(beside, ies.text, ies.size, err);
        } else {
            o.failed = true;
        }
        break;
    default:
        lum_ies_write(p, format == LUM_FORMAT_IES, options, &o, loss);
        break;
    }
    if (result == LMG_OK && (o.failed || ies.failed))
        result = lmg_fail(err, LMG_ERROR_MEMORY, "not enough memory to write %.200s", path);
    if (result == LMG_OK)
        result = lum_write_whole_file(path, o.text, o.size, err);
    free(o.text);
    free(ies.text);
    free(beside);
    return result;
}

lmg_result lum_photometry_write(const lum_photometry *p, const char *path, const lum_photometry_write_options *options,
                                char loss[512], lmg_error *err)
{
    lum_photometry_write_options o = {0};
    char ignored[512];
    loss = loss ? loss : ignored;
    loss[0] = 0;
    if (options)
        memcpy(&o, options, options->struct_size < sizeof o ? options->struct_size : sizeof o);
    const lum_photometry_format format = o.format ? o.format : lum_photometry_format_of_name(path);
    if (format <= LUM_FORMAT_AUTO || format > LUM_FORMAT_GLTF)
        return lmg_fail(err, LMG_ERROR_ARGUMENT,
                        "%.200s: the name doesn't say which photometric format (.ies, .ldt, .xml, .exr, .usda, .gltf)",
                        lum_base_name(path));
    lmg_result result = lum_photometry_check(p, err);
    if (result != LMG_OK) {
        lum_prefix_error(err, lum_base_name(path));
        return result;
    }
    if (format == LUM_FORMAT_GONIOMETRIC_EXR) {
        lum_note_loss(loss, "everything but the intensities");
        return lum_goniometric_write(p, path, o.resolution ? o.resolution : 512, err);
    }
    /* Symmetries and types that a format doesn't know are unfolded to type C; linear interpolation between the same planes stays.
     */
    const bool ies = format != LUM_FORMAT_EULUMDAT && format != LUM_FORMAT_TM33;
    lum_photometry *unfolded = NULL;
    if (ies ? p->symmetry == LUM_SYMMETRY_C90_C270 : p->type != LUM_TYPE_C) {
        if (p->type != LUM_TYPE_C)
            lum_note_loss(loss, "photometric type %c, resampled to C in steps of 5 and 1 degrees", " CBA"[p->type]);
        result = lum_photometry_resample(p, 0, 0, &unfolded, err);
    }
    if (result == LMG_OK)
        result = write_text(unfolded ? unfolded : p, format, path, &o, loss, err);
    lum_photometry_destroy(unfolded);
    return result;
}
