/* SPDX-License-Identifier: Apache-2.0 */
/* lumibake info: what a box or a photometric file says about itself. */
#include "program.h"

#include "info_photometry.h"

#include <luminaires/photometry.h>
#include <luminaires/spectrum.h>

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

enum { KEY_JSON = 256 };

static const struct argp_option OPTIONS[] = {
    {"json", KEY_JSON, 0, 0, "everything as JSON", 1},
    {0},
};

static const char DOC[] = "Says what is in a box of light: layout, planes, size, where the light went (with standard errors), "
                          "effects, provenance. Of a photometric "
                          "file (.ies, .ldt, .xml): its grid, shape, flux, zones and beam."
                          "\vExample:\n  lumibake info lamp.box.exr";

typedef struct command {
    const char *box;
    bool json;
} command;

static error_t parse(int key, char *arg, struct argp_state *state)
{
    command *c = state->input;
    switch (key) {
    case KEY_JSON:
        c->json = true;
        break;
    case ARGP_KEY_ARG:
        if (c->box)
            usage_error(state, "'%s': one box at a time", arg);
        c->box = arg;
        break;
    case ARGP_KEY_END:
        if (!c->box)
            usage_error(state, "which box? give a .box.exr file");
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const char *kind_name(lmg_slab_kind kind)
{
    return kind == LMG_SLAB_APERTURE ? "aperture" : "cube";
}

static json_t *json_vec(lmg_vec3 v)
{
    return json_pack("[o,o,o]", json_number(v.x), json_number(v.y), json_number(v.z));
}

static const char *flux_unit(const lmg_field *field)
{
    return box_is_photometric(field) ? "lm" : "W";
}

static json_t *slab_json(const lmg_field *field, uint32_t i)
{
    const lmg_slab *s = &lmg_field_layout(field)->slabs[i];
    double error;
    const double flux = lmg_field_slab_flux(field, i, &error);
    json_t *o = json_object();
    json_object_set_new(o, "kind", json_string(kind_name(s->kind)));
    json_object_set_new(o, "o", json_vec(s->o));
    json_object_set_new(o, "a", json_vec(s->a));
    json_object_set_new(o, "b", json_vec(s->b));
    json_object_set_new(o, "n", json_vec(s->n));
    json_object_set_new(o, "distance_m", json_number(s->distance)); /* null: infinity */
    json_object_set_new(o, "u_m", json_pack("[f,f]", s->u0, s->u1));
    json_object_set_new(o, "v_m", json_pack("[f,f]", s->v0, s->v1));
    json_object_set_new(o, "s", json_pack("[f,f]", s->s0, s->s1));
    json_object_set_new(o, "t", json_pack("[f,f]", s->t0, s->t1));
    json_object_set_new(o, "cells", json_pack("[i,i,i,i]", (int)s->nu, (int)s->nv, (int)s->ns, (int)s->nt));
    json_object_set_new(o, box_is_photometric(field) ? "flux_lm" : "flux_W", json_number(flux));
    json_object_set_new(o, "flux_standard_error", json_number(error));
    return o;
}

/* Colour of all light together, at luminance 1: that of the layout, or the mean of rays that the box emits, spread evenly by the
 * additive recurrence of the root of x^6 = x + 1. */
static void colour_of_light(const lmg_field *field, double rgb[3])
{
    enum { RAYS = 65536 };
    const lmg_layout *y = lmg_field_layout(field);
    const double root = 1.13472413840151949;
    for (int k = 0; k < 3; ++k)
        rgb[k] = y->channels == 1 ? (double)y->colour[k] : 0;
    for (int i = 0; y->channels == 3 && i < RAYS; ++i) {
        double xi[5], step = 1;
        for (int k = 0; k < 5; ++k) {
            step /= root;
            xi[k] = fmod(0.5 + i * step, 1);
        }
        lmg_ray ray;
        if (lmg_field_emit(field, xi, &ray))
            for (int k = 0; k < 3; ++k)
                rgb[k] += (double)ray.flux[k] / RAYS;
    }
}

static json_t *colour_json(const lmg_field *field)
{
    double rgb[3], xyz[3], xy[2], uv[2], kelvin, duv;
    colour_of_light(field, rgb);
    lum_rgb_to_xyz(rgb, xyz);
    lum_chromaticity(xyz, xy, uv);
    const bool white = lum_cct(xyz, &kelvin, &duv) && fabs(duv) <= LUM_CCT_LIMIT;
    return json_pack("{s:[o,o], s:o, s:o}", "xy", json_number(xy[0]), json_number(xy[1]), "cct_K",
                     white ? json_number(kelvin) : json_null(), "duv", white ? json_number(duv) : json_null());
}

static void print_colour(const lmg_field *field)
{
    double rgb[3], xyz[3], xy[2], uv[2], kelvin, duv;
    colour_of_light(field, rgb);
    lum_rgb_to_xyz(rgb, xyz);
    lum_chromaticity(xyz, xy, uv);
    printf("  colour    x %.4f, y %.4f", xy[0], xy[1]);
    if (lum_cct(xyz, &kelvin, &duv) && fabs(duv) <= LUM_CCT_LIMIT)
        printf(": %.0f K, duv %+.4f", kelvin, duv);
    putchar('\n');
}

static json_t *info_json(const command *c, const lmg_field *field, uint64_t bytes)
{
    const lmg_layout *y = lmg_field_layout(field);
    const lmg_ledger l = lmg_field_ledger(field);
    json_t *ledger = json_object();
    const struct {
        const char *name;
        double flux, error;
    } shares[] = {
        {"emitted", l.emitted, l.emitted_se},    {"stored", l.stored, l.stored_se}, {"residual", l.residual, l.residual_se},
        {"absorbed", l.absorbed, l.absorbed_se}, {"lost", l.lost, l.lost_se},
    };
    json_object_set_new(ledger, "photons", json_integer((json_int_t)l.photons));
    for (size_t i = 0; i < sizeof(shares) / sizeof(shares[0]); ++i)
        json_object_set_new(
            ledger, shares[i].name,
            json_pack("{s:o, s:o}", flux_unit(field), json_number(shares[i].flux), "standard_error", json_number(shares[i].error)));
    json_t *slabs = json_array();
    for (uint32_t i = 0; i < y->slab_count; ++i)
        json_array_append_new(slabs, slab_json(field, i));
    json_t *texts = json_object();
    for (size_t i = 0; lmg_field_text_name(field, i); ++i) {
        const char *name = lmg_field_text_name(field, i);
        json_object_set_new(texts, name, json_string(lmg_field_get_text(field, name)));
    }
    json_t *o = json_object();
    json_object_set_new(o, "format", json_string("lumibake info 1"));
    json_object_set_new(o, "box", json_string(c->box));
    json_object_set_new(o, "bytes", json_integer((json_int_t)bytes));
    json_object_set_new(o, "memory", json_integer((json_int_t)lmg_field_memory(field)));
    const lmg_rounding lost = lmg_field_rounding(field);
    json_object_set_new(o, "rounding",
                        json_pack("{s:o, s:o}", "loss", json_number(lost.loss), "half_loss", json_number(lost.half_loss)));
    json_object_set_new(o, "trees", json_trees(field));
    json_object_set_new(o, "ledger", ledger);
    json_object_set_new(o, "channels", json_integer(y->channels));
    json_object_set_new(o, "colour", json_pack("[f,f,f]", (double)y->colour[0], (double)y->colour[1], (double)y->colour[2]));
    json_object_set_new(o, "colour_of_light", box_is_photometric(field) ? colour_json(field) : json_null());
    json_object_set_new(o, "bounds_min_m", json_vec(y->bounds_min));
    json_object_set_new(o, "bounds_max_m", json_vec(y->bounds_max));
    json_object_set_new(o, "size_m", json_number(y->size));
    json_object_set_new(o, "slabs", slabs);
    json_object_set_new(o, "texts", texts);
    return o;
}

static void print_share(const char *name, const char *unit, double flux, double error, double emitted)
{
    printf("  %-9s %12.6g %-2s  +- %-9.2g %9.4f %%\n", name, flux, unit, error, 100 * flux / emitted);
}

/* A long text in lines that start under each other. */
static void print_text(const char *name, const char *value)
{
    printf("  %s:", name);
    const char *line = value;
    const bool several = strchr(value, '\n') != NULL;
    do {
        const size_t length = strcspn(line, "\n");
        fputs(several ? "\n    " : " ", stdout);
        fwrite(line, 1, length, stdout);
        line += length + (line[length] == '\n');
    } while (*line);
    putchar('\n');
}

static void print_info(const command *c, const lmg_field *field, uint64_t bytes)
{
    const lmg_layout *y = lmg_field_layout(field);
    const lmg_ledger l = lmg_field_ledger(field);
    const char *unit = flux_unit(field);
    const lmg_rounding lost = lmg_field_rounding(field);
    printf("%s: %.2f MB, %.1f MB in memory while rendering\n", c->box, 1e-6 * (double)bytes,
           1e-6 * (double)lmg_field_memory(field));
    if (lost.loss > 0 || lost.half_loss > 0)
        printf("cells rounded: RMS %.2g of their standard errors, halves %.2g\n", lost.loss, lost.half_loss);
    else
        printf("lossless\n");
    const lmg_tree_totals trees = lmg_field_trees(field);
    if (trees.trees > 0)
        printf("%u radiance trees with %.3g M leaves in all, of %.3g M rays and %.3g M looks; %.1f MB of that memory\n", trees.trees,
               1e-6 * (double)trees.leaves, 1e-6 * (double)trees.rays, 1e-6 * (double)trees.looks, 1e-6 * (double)trees.memory);
    if (trees.tiles > 0)
        printf("light repeats itself in %u tiles of %u kinds, which share their rays\n", trees.tiles, trees.kinds);
    printf("\nWhere the light went (%" PRIu64 " photons)\n", l.photons);
    printf("  emitted   %12.6g %s\n", l.emitted, unit);
    print_share("stored", unit, l.stored, l.stored_se, l.emitted);
    print_share("residual", unit, l.residual, l.residual_se, l.emitted);
    print_share("absorbed", unit, l.absorbed, l.absorbed_se, l.emitted);
    print_share("lost", unit, l.lost, l.lost_se, l.emitted);
    printf("\nLight field: %u slabs, %s, size %.4g m\n", y->slab_count, y->channels == 1 ? "one colour" : "R,G,B", y->size);
    printf("  bounds    %.5g %.5g %.5g to %.5g %.5g %.5g m\n", y->bounds_min.x, y->bounds_min.y, y->bounds_min.z, y->bounds_max.x,
           y->bounds_max.y, y->bounds_max.z);
    if (box_is_photometric(field))
        print_colour(field);
    printf("  slab kind     normal                 (u,v) plane at         u x v m              cells (u v s t)     flux %s\n",
           unit);
    for (uint32_t i = 0; i < y->slab_count; ++i) {
        const lmg_slab *s = &y->slabs[i];
        double error;
        const double flux = lmg_field_slab_flux(field, i, &error);
        char cells[40], origin[40], normal[40], size[40];
        snprintf(cells, sizeof(cells), "%u %u %u %u", s->nu, s->nv, s->ns, s->nt);
        snprintf(normal, sizeof(normal), "%.3g %.3g %.3g", s->n.x, s->n.y, s->n.z);
        snprintf(origin, sizeof(origin), "%.4g %.4g %.4g", s->o.x, s->o.y, s->o.z);
        snprintf(size, sizeof(size), "%.4g x %.4g", s->u1 - s->u0, s->v1 - s->v0);
        printf("  %3u  %-8s %-22s %-22s %-20s %-19s %.6g +- %.2g\n", i, kind_name(s->kind), normal, origin, size, cells, flux,
               error);
    }
    printf("\nProvenance\n");
    for (size_t i = 0; lmg_field_text_name(field, i); ++i) {
        const char *name = lmg_field_text_name(field, i);
        print_text(name, lmg_field_get_text(field, name));
    }
}

int cmd_info(int argc, char **argv)
{
    static const struct argp ARGP = {.options = OPTIONS, .parser = parse, .args_doc = "FILE", .doc = DOC};
    command c = {0};
    argp_parse(&ARGP, argc, argv, 0, NULL, &c);

    lmg_error err = {{0}};
    lmg_field *field;
    if (lum_photometry_is_readable_name(c.box)) {
        json_t *object;
        const lmg_result read = info_photometry(c.box, c.json, &object, &err);
        if (read != LMG_OK)
            return report_error(read, &err);
        const bool done = c.json ? print_json(object) : fflush(stdout) == 0 && !ferror(stdout);
        if (!done) {
            lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print: %s", strerror(errno));
            return report_failure(&err);
        }
        return EXIT_DONE;
    }
    const lmg_result result = lmg_field_read(c.box, &field, &err);
    if (result != LMG_OK)
        return report_error(result, &err);
    struct stat status = {0};
    const uint64_t bytes = stat(c.box, &status) == 0 ? (uint64_t)status.st_size : 0;
    bool printed;
    if (c.json) {
        printed = print_json(info_json(&c, field, bytes));
    } else {
        print_info(&c, field, bytes);
        printed = fflush(stdout) == 0 && !ferror(stdout);
    }
    lmg_field_destroy(field);
    if (!printed) {
        lmg_fail(&err, LMG_ERROR_FILE_WRITE, "can't print: %s", strerror(errno));
        return report_failure(&err);
    }
    return EXIT_DONE;
}
