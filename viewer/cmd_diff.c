/* SPDX-License-Identifier: Apache-2.0 */
/* lumiview diff: how two renderings of one view differ.  Command line only. */
#include "image_diff.h"
#include "image_io.h"
#include "lumiview.h"

#include <getopt.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>

typedef struct settings {
    const char *a, *b, *png;
    uint64_t block;
    double limit, scale;
    bool json;
} settings;

static void print_help(void)
{
    puts("lumiview diff A.exr B.exr [--png diff.png]: how picture A differs from B (the reference), luminance, noise told apart\n"
         "  --png FILE.png  2 (A - B) / (A + B): red where A is brighter, blue where B is, white where they\n"
         "                  agree to within 2 standard errors of the noise\n"
         "  --scale S       full colour at this relative difference (default 0.1)\n"
         "  --block N       compare means over N x N pixels (default 1)\n"
         "  --limit F       leave out blocks brighter than F times the mean of B, such as the lamp itself (default: none)\n"
         "  --json          result as JSON\n"
         "The noise is that of the files' stderr.Y channels; use different seeds for A and B, or it counts too much.\n"
         "Example: lumiview diff box.exr geometry.exr --block 8 --png diff.png");
}

static int read_options(int argc, char **argv, settings *s)
{
    enum { PNG = 256, SCALE, BLOCK, LIMIT, JSON };
    static const struct option OPTIONS[] = {{"png", required_argument, NULL, PNG},
                                            {"scale", required_argument, NULL, SCALE},
                                            {"block", required_argument, NULL, BLOCK},
                                            {"limit", required_argument, NULL, LIMIT},
                                            {"json", no_argument, NULL, JSON},
                                            {"help", no_argument, NULL, 'h'},
                                            {NULL, 0, NULL, 0}};
    *s = (settings){.block = 1, .scale = 0.1};
    opterr = 0;
    optind = 1;
    int option, which = 0;
    while ((option = getopt_long(argc, argv, ":h", OPTIONS, &which)) != -1) {
        bool good = true;
        const char *wanted = "";
        switch (option) {
        case PNG:
            s->png = optarg;
            break;
        case SCALE:
            good = read_positive(optarg, "", &s->scale);
            wanted = "a number more than 0";
            break;
        case BLOCK:
            good = read_count(optarg, VIEW_MAX_SIDE, &s->block) && s->block > 0;
            wanted = "a whole number of pixels, at least 1";
            break;
        case LIMIT:
            good = read_positive(optarg, "", &s->limit);
            wanted = "a number more than 0";
            break;
        case JSON:
            s->json = true;
            break;
        case 'h':
            print_help();
            return -1;
        case ':':
            return say_usage("diff", "%s needs a value", argv[optind - 1]);
        default:
            return say_usage("diff", "there is no option %s", argv[optind - 1]);
        }
        if (!good) {
            return say_usage("diff", "--%s %s: should be %s", OPTIONS[which].name, optarg, wanted);
        }
    }
    if (optind + 2 != argc) {
        return say_usage("diff", "name two pictures, A.exr and B.exr");
    }
    s->a = argv[optind];
    s->b = argv[optind + 1];
    return EXIT_DONE;
}

static json_t *number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

static void print_diff(const settings *s, const view_diff *d)
{
    if (s->json) {
        json_t *o = json_object();
        json_object_set_new(o, "version", json_integer(1));
        json_object_set_new(o, "command", json_string("diff"));
        json_object_set_new(o, "blocks", json_integer((json_int_t)d->blocks));
        json_object_set_new(o, "left_out", json_integer((json_int_t)d->left_out));
        json_object_set_new(o, "block_pixels", json_integer((json_int_t)s->block));
        json_object_set_new(o, "mean_a_cd_m2", number(d->mean_a));
        json_object_set_new(o, "mean_a_standard_error", number(d->mean_a_se));
        json_object_set_new(o, "mean_b_cd_m2", number(d->mean_b));
        json_object_set_new(o, "mean_b_standard_error", number(d->mean_b_se));
        json_object_set_new(o, "relative_rmse", number(d->rmse));
        json_object_set_new(o, "relative_noise", number(d->noise));
        json_object_set_new(o, "relative_rmse_without_noise", number(d->rmse_clean));
        json_object_set_new(o, "relative_rmse_without_noise_standard_error", number(d->rmse_clean_se));
        json_object_set_new(o, "median_relative_difference", number(d->typical));
        json_object_set_new(o, "picture_scale", s->png ? number(s->scale) : json_null());
        json_dumpf(o, stdout, JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(9));
        putchar('\n');
        json_decref(o);
        return;
    }
    printf("mean luminance  A %.5g, B %.5g cd/m2; A / B = %.4f", d->mean_a, d->mean_b, d->mean_a / d->mean_b);
    double se = d->mean_a / d->mean_b * hypot(d->mean_a_se / d->mean_a, d->mean_b_se / d->mean_b);
    if (isfinite(se)) {
        printf(" +- %.4f", se);
    }
    printf("\nrelative RMSE   %.4g %% over %llu blocks of %llu x %llu pixels", 100 * d->rmse, (unsigned long long)d->blocks,
           (unsigned long long)s->block, (unsigned long long)s->block);
    if (d->left_out) {
        printf(" (%llu brighter ones left out)", (unsigned long long)d->left_out);
    }
    if (isfinite(d->noise)) {
        printf("\n  of which noise %.4g %%; without it %.4g %%", 100 * d->noise, 100 * d->rmse_clean);
    }
    printf("\nmedian relative difference %.4g %%\n", 100 * d->typical);
    if (s->png) {
        printf("%s: blue (A darker) -%g %%, white 0, red (A brighter) +%g %%\n", s->png, 100 * s->scale, 100 * s->scale);
    }
}

int cmd_diff(int argc, char **argv)
{
    settings s;
    int code = read_options(argc, argv, &s);
    if (code != EXIT_DONE) {
        return code < 0 ? EXIT_DONE : code;
    }
    lmg_error err;
    view_image a = {0}, b = {0};
    view_diff diff;
    uint8_t *bytes = NULL;
    lmg_result r = view_read_exr(s.a, &a, NULL, &err);
    r = r ? r : view_read_exr(s.b, &b, NULL, &err);
    view_diff_options options = {.block = (uint32_t)s.block, .limit = s.limit};
    r = r ? r : view_image_diff(&a, &b, &options, &diff, &err);
    if (r == LMG_OK && s.png) {
        bytes = malloc(3 * (size_t)a.width * a.height);
        if (bytes) {
            view_diff_picture(&a, &b, (uint32_t)s.block, s.scale, bytes);
            r = view_write_png(bytes, a.width, a.height, s.png, &err);
        } else {
            r = lmg_fail(&err, LMG_ERROR_MEMORY, "out of memory for %s", s.png);
        }
    }
    if (r == LMG_OK) {
        print_diff(&s, &diff);
    } else {
        code = say_result(r, &err);
    }
    free(bytes);
    view_image_free(&a);
    view_image_free(&b);
    return code;
}
