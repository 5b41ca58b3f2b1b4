/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake convert: light from one form into another.  Options, kinds of files, the report; the work is in convert.c. */
#include "program.h"

#include "convert.h"
#include "open_source.h"
#include "picture_set.h"

#include <luminaires/photometry.h>
#include <luminaires/rng.h>

#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum {
    KEY_TO = 256,
    KEY_RAYS,
    KEY_RADIOMETRIC,
    KEY_GRID,
    KEY_SYMMETRY,
    KEY_PIXELS,
    KEY_NEAR,
    KEY_DISTANCE,
    KEY_STEP,
    KEY_CELLS,
    KEY_LAYOUT,
    KEY_RESOLUTION,
    KEY_LOSSLESS,
    KEY_FLUX,
    KEY_SEED,
    KEY_THREADS,
    KEY_JSON
};

static const struct argp_option OPTIONS[] = {
    {"to", KEY_TO, "KIND", 0, "when B's name doesn't say: box, tm25, zemax, zemax-text, lighttools, lighttools-text, ies, ies-2002, ldt, "
     "tm33, goniometric, usd, gltf, pictures", 1},
    {"rays", KEY_RAYS, "N", 0, "rays to take (default: all of a ray file, else 1e7)", 1},
    {"radiometric", KEY_RADIOMETRIC, 0, 0, "watts of a ray file as they are, no lumens", 1},
    {"grid", KEY_GRID, "C,GAMMA", 0, "of a far field: planes round the circle and angles from 0 to 180 (default 72,73)", 2},
    {"symmetry", KEY_SYMMETRY, "KIND", 0, "of a far field: none, axial, c0, c90 (mirror planes) or quadrant (default none)", 2},
    {"near", KEY_NEAR, "M,...", 0, "photometric files of E d^2 at these distances, metres: B_0.5m.ies", 2},
    {"pixels", KEY_PIXELS, "N", 0, "of pictures, per side (default: goniometric 512, near field 64)", 2},
    {"distance", KEY_DISTANCE, "M", 0, "of the camera from the centre (default 4 radii of the bounds)", 2},
    {"step", KEY_STEP, "DEG", 0, "between near-field pictures, a divisor of 180 (default 5)", 2},
    {"cells", KEY_CELLS, "N", 0, "size of a box in cells (default: by the number of rays)", 2},
    {"layout", KEY_LAYOUT, "KIND", 0, "of a box: auto, cube or aperture (default auto)", 2},
    {"resolution", KEY_RESOLUTION, "U,V,S,T", 0, "cells in each dimension of the main slabs, 0 = chosen", 2},
    {"lossless", KEY_LOSSLESS, 0, 0, "of a box: " LOSSLESS_HELP, 2},
    {"flux", KEY_FLUX, "LM", 0, "what the sources of a glTF lamp emit, as in bake", 3},
    LAMP_OPTIONS(3),
    {"seed", KEY_SEED, "N", 0, "seed of the random numbers (default 1)", 4},
    {"threads", KEY_THREADS, "N", 0, "default: all cores; doesn't change the result", 4},
    {"quiet", 'q', 0, 0, "no remarks, no summary", 5},
    {"json", KEY_JSON, 0, 0, "summary as JSON", 5},
    {0},
};

static const char DOC[] =
    "Turns A into B. A: a ray file, a box, a lamp (.gltf, .glb), a folder of goniometer pictures or a photometric file; B: a "
    "box, a ray file, a photometric file, a folder of goniometer pictures, or its light for another renderer. Says what flux went in, what came out, and what was lost."
    "\vKinds by name: .box.exr, .tm25ray (IES TM-25), .dat (Zemax), .ray (LightTools), .ies, .ldt, .xml (TM-33), .usda, .gltf, FOLDER/.\n"
    "Example:\n  lumibake convert led.tm25ray led.box.exr";

/* What B can be. */
typedef enum target_kind { TO_NONE, TO_BOX, TO_RAYS, TO_PHOTOMETRY, TO_PICTURES } target_kind;

typedef struct command {
    lamp_options lamp;
    const char *output;
    target_kind to;
    lum_ray_format format;            /* of a ray file */
    lum_photometry_format photometry; /* of a photometric file */
    uint32_t pixels;
    size_t near_count;
    double near[16], distance, step;
    char losses[512]; /* of a photometric file: what its format can't keep */
    bool radiometric, lossless, quiet, json;
    double flux_lm;
    uint64_t seed;
    bake_convert_options options;
} command;

static void parse_to(struct argp_state *state, const char *text, command *c)
{
    static const struct {
        const char *name;
        target_kind to;
        lum_ray_format format;
        lum_photometry_format photometry;
    } KINDS[] = {
        {"box", TO_BOX, LUM_RAYS_NONE, LUM_FORMAT_AUTO},
        {"tm25", TO_RAYS, LUM_RAYS_TM25, LUM_FORMAT_AUTO},
        {"zemax", TO_RAYS, LUM_RAYS_ZEMAX, LUM_FORMAT_AUTO},
        {"zemax-text", TO_RAYS, LUM_RAYS_ZEMAX_TEXT, LUM_FORMAT_AUTO},
        {"lighttools", TO_RAYS, LUM_RAYS_LIGHTTOOLS, LUM_FORMAT_AUTO},
        {"lighttools-text", TO_RAYS, LUM_RAYS_LIGHTTOOLS_TEXT, LUM_FORMAT_AUTO},
        {"ies", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_IES},
        {"ies-2002", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_IES_2002},
        {"ldt", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_EULUMDAT},
        {"tm33", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_TM33},
        {"goniometric", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_GONIOMETRIC_EXR},
        {"usd", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_USD},
        {"gltf", TO_PHOTOMETRY, LUM_RAYS_NONE, LUM_FORMAT_GLTF},
        {"pictures", TO_PICTURES, LUM_RAYS_NONE, LUM_FORMAT_AUTO},
    };
    for (size_t i = 0; i < sizeof(KINDS) / sizeof(KINDS[0]); ++i)
        if (!strcmp(text, KINDS[i].name)) {
            c->to = KINDS[i].to;
            c->format = KINDS[i].format;
            c->photometry = KINDS[i].photometry;
            return;
        }
    usage_error(state,
                "--to: '%s' is none of box, tm25, zemax, zemax-text, lighttools, lighttools-text, ies, ies-2002, ldt, "
                "tm33, goniometric, usd, gltf, pictures",
                text);
}

/* The kind of B from its name. */
static void choose_target(command *c)
{
    const size_t n = strlen(c->output);
    c->photometry = lum_photometry_format_of_name(c->output);
    c->format = lum_ray_format_of_name(c->output);
    if (n > 1 && c->output[n - 1] == '/')
        c->to = TO_PICTURES;
    else if (c->format != LUM_RAYS_NONE)
        c->to = TO_RAYS;
    else if (n >= 4 && !strcmp(c->output + n - 4, ".exr"))
        c->to = TO_BOX; /* a goniometric picture has to be asked for */
    else if (c->photometry != LUM_FORMAT_AUTO)
        c->to = TO_PHOTOMETRY;
}

static void parse_near(struct argp_state *state, const char *text, command *c)
{
    c->near_count = 0;
    for (const char *at = text;;) {
        char *end;
        const double d = strtod(at, &end);
        if (end == at || (*end && *end != ',') || !(d >= 1e-6 && d <= 1e6) || c->near_count == sizeof(c->near) / sizeof(c->near[0]))
            usage_error(state, "--near: '%s' is not a list of up to 16 distances in metres such as 0.5,1,2", text);
        c->near[c->near_count++] = d;
        if (!*end)
            return;
        at = end + 1;
    }
}

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case KEY_TO:
        parse_to(state, arg, c);
        break;
    case KEY_RAYS:
        c->options.rays = argument_count(state, "--rays", arg, 1, UINT64_C(1) << 52);
        break;
    case KEY_RADIOMETRIC:
        c->radiometric = true;
        break;
    case KEY_GRID: {
        char *end;
        const unsigned long planes = strtoul(arg, &end, 10), angles = *end == ',' ? strtoul(end + 1, &end, 10) : 0;
        if (*end || planes < 4 || planes > 720 || planes % 4 || angles < 7 || angles > 1441)
            usage_error(state, "--grid: '%s' is not C,GAMMA with 4..720 planes, a multiple of 4, and 7..1441 angles", arg);
        c->options.grid.planes = (uint32_t)planes;
        c->options.grid.angles = (uint32_t)angles;
        break;
    }
    case KEY_SYMMETRY: {
        static const char *const NAMES[] = {"none", "axial", "c0", "c90", "quadrant"};
        int k = 0;
        while (k < 5 && strcmp(arg, NAMES[k]))
            ++k;
        if (k == 5)
            usage_error(state, "--symmetry: '%s' is none of none, axial, c0, c90, quadrant", arg);
        c->options.grid.symmetry = (lum_symmetry)k;
        break;
    }
    case KEY_PIXELS:
        c->pixels = (uint32_t)argument_count(state, "--pixels", arg, 2, 8192);
        break;
    case KEY_NEAR:
        parse_near(state, arg, c);
        break;
    case KEY_DISTANCE:
        c->distance = argument_number(state, "--distance", arg, 1e-6, 1e6);
        break;
    case KEY_STEP:
        c->step = argument_number(state, "--step", arg, 0.1, 90);
        if (fabs(180 / c->step - round(180 / c->step)) > 1e-9)
            usage_error(state, "--step: %s doesn't divide 180", arg);
        break;
    case KEY_CELLS:
        c->options.fit.cells = argument_count(state, "--cells", arg, 1000, UINT64_C(1) << 32);
        break;
    case KEY_LAYOUT:
        c->options.fit.choice = argument_layout(state, arg);
        break;
    case KEY_RESOLUTION:
        argument_resolution(state, arg, c->options.fit.resolution);
        break;
    case KEY_LOSSLESS:
        c->lossless = true;
        break;
    case KEY_FLUX:
        c->flux_lm = argument_lumens(state, "--flux", arg);
        break;
    case KEY_SEED:
        c->seed = argument_count(state, "--seed", arg, 0, UINT64_MAX);
        break;
    case KEY_THREADS:
        c->options.threads = (unsigned)argument_count(state, "--threads", arg, 1, 1024);
        break;
    case 'q':
        c->quiet = true;
        break;
    case KEY_JSON:
        c->json = true;
        break;
    case ARGP_KEY_ARG:
        if (c->output)
            usage_error(state, "'%s': from A to B, not more", arg);
        *(c->lamp.path ? &c->output : &c->lamp.path) = arg;
        break;
    case ARGP_KEY_END:
        if (!c->output)
            usage_error(state, "what into what? give A and B");
        if (c->to == TO_NONE)
            choose_target(c);
        if (c->to == TO_NONE)
            usage_error(state, "%s: its name doesn't say what it is to be; give --to KIND", c->output);
        if (c->near_count && c->to != TO_PHOTOMETRY)
            usage_error(state, "--near goes with photometric files");
        if ((c->distance > 0 || c->step > 0) && c->to != TO_PICTURES)
            usage_error(state, "--distance and --step go with pictures");
        break;
    default:
        return parse_lamp_option(state, key, arg, &c->lamp) ? 0 : ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const char *base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static const char *kind_name(const command *c, const opened_source *a, bool input)
{
    static const char *const PHOTOMETRY[] = {"", "IES", "IES", "EULUMDAT", "TM-33", "goniometric picture", "USD", "glTF light"};
    if (!input && c->to == TO_PICTURES)
        return "near-field pictures";
    if (!input)
        return c->to == TO_BOX ? "box" : c->to == TO_RAYS ? lum_ray_format_name(c->format) : PHOTOMETRY[c->photometry];
    if (a->kind == SOURCE_PHOTOMETRY)
        return a->photometry->format;
    return a->kind == SOURCE_LAMP  ? "glTF lamp"
           : a->kind == SOURCE_BOX ? "box"
           : a->kind == SOURCE_PICTURES ? "near-field pictures"
                                   : lum_ray_format_name(lum_rayfile_info(a->rays)->format);
}

/* -------------------------------------------------------------------------------------------------------------- arrows */

static lmg_result describe_box(const command *c, const opened_source *a, const bake_conversion *r, lmg_field *field, lmg_error *err)
{
    char rays[32], origin[512];
    snprintf(rays, sizeof(rays), "%" PRIu64, r->photons);
    snprintf(origin, sizeof(origin), "%.300s (%s)", base_name(a->path), kind_name(c, a, true));
    const struct {
        const char *name, *value;
    } texts[] = {
        {"software", "lumibake " LMG_VERSION_STRING},    {"source", origin}, {"rays", rays}, {"layout_why", r->layout_why},
        {"quantity", a->photometric ? NULL : "radiant"}, /* all "lumens" of this box are watts */
    };
    lmg_result result = LMG_OK;
    for (size_t i = 0; result == LMG_OK && i < sizeof(texts) / sizeof(texts[0]); ++i)
        if (texts[i].value)
            result = lmg_field_set_text(field, texts[i].name, texts[i].value, err);
    /* what the maker of the rays says of them */
    static const char *const NAMES[LUM_RAY_TEXTS] = {"ray_source",       "ray_manufacturer", "ray_model_creator",
                                                     "ray_file_creator", "ray_equipment",    "ray_camera",
                                                     "ray_operation",    "ray_remarks",      "ray_reference"};
    for (int i = 0; result == LMG_OK && a->rays && i < LUM_RAY_TEXTS; ++i)
        if (lum_rayfile_info(a->rays)->texts[i][0])
            result = lmg_field_set_text(field, NAMES[i], lum_rayfile_info(a->rays)->texts[i], err);
    return result;
}

static lmg_result to_box(const command *c, const opened_source *a, bake_conversion *r, lmg_error *err)
{
    lmg_field *field;
    lmg_result result = bake_convert_to_field(a->source, &c->options, &field, r, err);
    if (result == LMG_OK)
        result = describe_box(c, a, r, field, err);
    if (result == LMG_OK)
        result = write_box(field, c->output, c->lossless, &(lmg_rounding){0}, err);
    lmg_field_destroy(field);
    return result;
}

/* Whether rays have colours worth keeping. */
static bool has_colours(const opened_source *a)
{
    float rgb[3] = {1, 1, 1};
    if (a->rays)
        return !lum_rayfile_colour(a->rays, rgb) || rgb[0] != rgb[1] || rgb[1] != rgb[2];
    if (!a->field)
        return true;
    const lmg_layout *layout = lmg_field_layout(a->field);
    return layout->channels == 3 || layout->colour[0] != layout->colour[1] || layout->colour[1] != layout->colour[2];
}

static lmg_result to_rays(const command *c, const opened_source *a, bake_conversion *r, lmg_error *err)
{
    const bool lighttools = c->format == LUM_RAYS_LIGHTTOOLS || c->format == LUM_RAYS_LIGHTTOOLS_TEXT;
    const lum_ray_info *info = a->rays ? lum_rayfile_info(a->rays) : NULL;
    const bool wavelength = info && info->has_wavelength && (lighttools || !a->photometric);
    const bool colours = a->photometric && !wavelength && has_colours(a);
    const lum_ray_writer_options writer = {
        .format = c->format,
        .photometric = a->photometric,
        .wavelength = wavelength,
        .tristimulus = colours && c->format == LUM_RAYS_TM25,
        .source = info && info->texts[0][0] ? info->texts[0] : base_name(a->path),
        .software = "lumibake " LMG_VERSION_STRING,
        .remarks = info ? info->texts[7] : NULL,
    };
    if (!c->quiet && colours && !writer.tristimulus)
        fprintf(stderr, "note: %s: %s files can't hold colours; flux only\n", c->output, lum_ray_format_name(c->format));
    if (!c->quiet && info && info->spectra && writer.tristimulus)
        fprintf(stderr, "note: %s: spectra become tristimulus values\n", c->output);
    return bake_convert_to_rays(a->source, &c->options, c->output, &writer, r, err);
}

static lmg_result to_photometry(command *c, const opened_source *a, bake_conversion *r, lmg_error *err)
{
    /* A photometric file into another goes without rays, unless they are asked for. */
    const bool direct = a->photometry && c->options.rays == 0;
    lum_photometry *p = NULL;
    lmg_result result =
        direct ? lum_photometry_copy(a->photometry, &p, err) : bake_convert_to_photometry(a->source, &c->options, &p, r, err);
    lum_photometry_measures m;
    if (result == LMG_OK && direct) {
        *r = (bake_conversion){0};
        result = lum_photometry_measure(p, &m, err);
        r->flux_in = r->flux_out = m.flux;
    } else if (result == LMG_OK) {
        char origin[512];
        snprintf(origin, sizeof(origin), "%.300s (%s), %" PRIu64 " rays, lumibake " LMG_VERSION_STRING, base_name(a->path),
                 kind_name(c, a, true), r->rays);
        result = lum_photometry_set_keyword(p, "LUMINAIRE", base_name(a->path), err);
        if (result == LMG_OK)
            result = lum_photometry_set_keyword(p, "OTHER", origin, err);
        if (result == LMG_OK && !a->photometric)
            snprintf(p->unit, sizeof(p->unit), "W/sr");
    }
    const lum_photometry_write_options options = {.struct_size = sizeof(options),
                                                  .format = c->photometry,
                                                  .simulated = !direct && a->kind != SOURCE_RAYS,
                                                  .resolution = c->pixels};
    if (result == LMG_OK)
        result = lum_photometry_write(p, c->output, &options, c->losses, err);
    lum_photometry_destroy(p);
    return result;
}

/* B with the distance before its ending: lamp.ies -> lamp_0.5m.ies. */
static lmg_result near_name(const char *output, double distance, char name[2048], lmg_error *err)
{
    const char *base = base_name(output), *dot = strrchr(base, '.');
    const int stem = (int)((dot ? dot : base + strlen(base)) - output);
    if (stem > 1900 || snprintf(name, 2048, "%.*s_%gm%s", stem, output, distance, dot ? dot : "") >= 2048)
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "the name of the output is too long");
    return LMG_OK;
}

static lmg_result to_near_fields(command *c, const opened_source *a, bake_conversion *r, lmg_error *err)
{
    const char *output = c->output;
    lmg_result result = LMG_OK;
    for (size_t i = 0; result == LMG_OK && i < c->near_count; ++i) {
        char name[2048];
        result = near_name(output, c->near[i], name, err);
        if (result != LMG_OK)
            break;
        c->output = name;
        c->options.near = c->near[i];
        result = to_photometry(c, a, r, err);
        if (result == LMG_OK && !c->quiet && !c->json)
            printf("%s: %.8g %s\n", name, r->flux_out, a->photometric ? "lm" : "W");
        c->output = output;
    }
    return result;
}

/* A box's light as pictures; of other sources a box in memory comes between. */
static lmg_result to_pictures(const command *c, const opened_source *a, bake_conversion *r, lmg_error *err)
{
    lmg_field *made = NULL;
    *r = (bake_conversion){0};
    lmg_result result = a->field ? LMG_OK : bake_convert_to_field(a->source, &c->options, &made, r, err);
    if (result != LMG_OK)
        return result;
    const bake_picture_set_options options = {
        .distance = c->distance,
        .step = c->step,
        .pixels = c->pixels,
        .threads = c->options.threads,
        .radiant = !a->photometric,
        .origin = base_name(a->path),
        .stop = c->options.stop,
    };
    bake_picture_set_report report;
    result = bake_picture_set_write(made ? made : a->field, &options, c->output, &report, err);
    if (!made) {
        r->flux_in = lmg_field_ledger(a->field).stored;
        r->out_se = lmg_field_ledger(a->field).stored_se;
    }
    r->flux_out = report.flux;
    r->pictures = report.pictures;
    r->dark = report.dark;
    r->raw_bytes = report.raw_bytes;
    r->stored_bytes = report.stored_bytes;
    struct stat file;
    if (a->kind == SOURCE_BOX && stat(a->path, &file) == 0)
        r->box_bytes = (uint64_t)file.st_size;
    r->distance = report.distance;
    r->seconds += report.seconds;
    lmg_field_destroy(made);
    return result;
}

/* Whether the pictures' folder can be made: like check_output, but an empty folder may be there. */
static lmg_result check_folder(const char *path, const char *input, lmg_error *err)
{
    char name[1024];
    size_t n = strlen(path);
    while (n > 1 && path[n - 1] == '/')
        --n;
    if (n >= sizeof(name))
        return lmg_fail(err, LMG_ERROR_FILE_WRITE, "the name of the output is too long");
    memcpy(name, path, n);
    name[n] = 0;
    DIR *folder = opendir(name);
    if (!folder)
        return check_output(name, &input, 1, err);
    int entries = 0;
    for (const struct dirent *e; (e = readdir(folder));)
        entries += strcmp(e->d_name, ".") != 0 && strcmp(e->d_name, "..") != 0;
    closedir(folder);
    return entries ? lmg_fail(err, LMG_ERROR_FILE_WRITE, "%.300s: is a folder with something in it; give a new name", path) : LMG_OK;
}

static lmg_result convert(command *c, opened_source *a, bake_conversion *r, lmg_error *err)
{
    const source_kind kind = source_kind_of(c->lamp.path);
    if (c->near_count && kind == SOURCE_PHOTOMETRY)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: a far field knows of no near distances; give rays, a box or a lamp", c->lamp.path);
    if (c->to == TO_BOX && kind == SOURCE_LAMP)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: a lamp becomes a box by 'lumibake bake'", c->lamp.path);
    if (c->to == TO_BOX && kind == SOURCE_BOX)
        return lmg_fail(err, LMG_ERROR_UNSUPPORTED, "%s: isn't a ray file, and a box is a box already", c->lamp.path);
    const source_options options = {
        .flux_lm = c->flux_lm,
        .rays = c->radiometric     ? LUM_RAY_POWER
                : c->to == TO_RAYS ? LUM_RAY_STORED
                                   : LUM_RAY_LIGHT,
        .seed = lum_mix64(c->seed + 0x63), /* apart from a bake's with the same number */
        .threads = c->options.threads,
        .quiet = c->quiet,
    };
    const lmg_result result = open_source(&c->lamp, &options, a, err);
    if (result != LMG_OK)
        return result;
    switch (c->to) {
    case TO_BOX:
        return to_box(c, a, r, err);
    case TO_RAYS:
        return to_rays(c, a, r, err);
    case TO_PICTURES:
        return to_pictures(c, a, r, err);
    case TO_PHOTOMETRY:
    case TO_NONE:
    default:
        return c->near_count ? to_near_fields(c, a, r, err) : to_photometry(c, a, r, err);
    }
}

/* -------------------------------------------------------------------------------------------------------------- report */

static json_t *report_json(const command *c, const opened_source *a, const bake_conversion *r)
{
    json_t *o =
        json_pack("{s:s, s:{s:s, s:s}, s:{s:s, s:s}, s:s, s:I, s:I, s:o, s:o, s:o, s:o, s:f}", "format", "lumibake convert 1",
                  "from", "path", a->path, "kind", kind_name(c, a, true), "to", "path", c->output, "kind", kind_name(c, a, false),
                  "unit", a->photometric ? "lm" : "W", "photons", (json_int_t)r->photons, "rays", (json_int_t)r->rays, "flux_in",
                  json_number(r->flux_in), "flux_out", json_number(r->flux_out), "flux_out_standard_error", json_number(r->out_se),
                  "loss", json_number((r->flux_in - r->flux_out) / r->flux_in), "seconds", r->seconds);
    if (c->to == TO_PHOTOMETRY) {
        json_object_set_new(o, "noise", json_number(r->noise));
        json_object_set_new(o, "not_kept", json_string(c->losses));
    }
    if (c->to == TO_PICTURES)
        json_object_set_new(o, "pictures", json_pack("{s:i, s:i, s:f, s:I, s:I}", "count", (int)r->pictures, "dark", (int)r->dark, "distance_m",
                                                     r->distance, "raw_bytes", (json_int_t)r->raw_bytes, "stored_bytes", (json_int_t)r->stored_bytes));
    if (c->to == TO_PICTURES && r->box_bytes)
        json_object_set_new(o, "box_bytes", json_integer((json_int_t)r->box_bytes));
    if (c->near_count) {
        json_t *near = json_array();
        for (size_t i = 0; i < c->near_count; ++i)
            json_array_append_new(near, json_real(c->near[i]));
        json_object_set_new(o, "near_m", near);
    }
    if (c->to == TO_BOX) {
        json_object_set_new(o, "residual", json_number(r->residual));
        json_object_set_new(o, "refused_rays", json_integer((json_int_t)r->refused));
        json_object_set_new(o, "layout_why", json_string(r->layout_why));
    }
    return o;
}

static void print_report(const command *c, const opened_source *a, const bake_conversion *r)
{
    const char *unit = a->photometric ? "lm" : "W";
    printf("%s (%s) -> %s (%s)\n", a->path, kind_name(c, a, true), c->output, kind_name(c, a, false));
    if (r->photons > 0)
        printf("  rays      %" PRIu64 " of %" PRIu64 " photons, %.1f s\n", r->rays, r->photons, r->seconds);
    if (c->to == TO_PICTURES)
        printf("  pictures  %u from %.4g m, %u of them dark and left out, %.1f s\n", r->pictures, r->distance, r->dark, r->seconds);
    if (c->to == TO_PICTURES) {
        printf("  size      %.3g MB as plain floats, %.3g MB on disk", 1e-6 * (double)r->raw_bytes, 1e-6 * (double)r->stored_bytes);
        if (r->box_bytes)
            printf("; the box has %.3g MB", 1e-6 * (double)r->box_bytes);
        printf("\n");
    }
    printf("  flux in   %14.8g %s\n", r->flux_in, unit);
    printf("  flux out  %14.8g %s  +- %.2g\n", r->flux_out, unit, r->out_se);
    printf("  loss      %14.2g %%\n", 100 * (r->flux_in - r->flux_out) / r->flux_in);
    if (c->to == TO_PHOTOMETRY && r->noise > 0)
        printf("  noise     %14.2g %%  (standard error, RMS over the sphere)\n", 100 * r->noise);
    if (c->to == TO_PHOTOMETRY && c->losses[0])
        printf("  not kept  %s\n", c->losses);
    if (c->to == TO_BOX && (r->residual > 0 || r->refused > 0))
        printf("  of which  %.6g %s beside all slabs, %" PRIu64 " rays that can't be counted\n", r->residual, unit, r->refused);
}

int cmd_convert(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "A B", .doc = DOC};
    command c = {.seed = 1};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    opened_source a = {0};
    bake_conversion r = {0};
    if ((c.to == TO_PICTURES ? check_folder(c.output, c.lamp.path, &err) : check_output(c.output, &c.lamp.path, 1, &err)) != LMG_OK)
        return report_failure(&err);
    c.options.stop = catch_interrupts();
    const lmg_result result = convert(&c, &a, &r, &err);
    int code = EXIT_DONE;
    if (result != LMG_OK) {
        code = result == LMG_ERROR_FILE_WRITE ? report_failure(&err) : report_error(result, &err);
        if (*c.options.stop)
            code = EXIT_INTERRUPTED;
    } else if (c.json || !c.quiet) {
        bool printed = true;
        if (c.json)
            printed = print_json(report_json(&c, &a, &r));
        else
            print_report(&c, &a, &r);
        if (!printed || fflush(stdout) != 0 || ferror(stdout)) {
            lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print: %s", strerror(errno));
            code = report_failure(&err);
        }
    }
    close_source(&a);
    return code;
}
