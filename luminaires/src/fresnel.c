/* SPDX-License-Identifier: Apache-2.0 */
/* Fresnel's formulae for unpolarised light [born1999optics, ch. 1.5 and 14.2]; no approximations. */
#include <luminaires/scatter.h>

#include <math.h>

double lum_fresnel_dielectric(double cos_i, double eta)
{
    double c = cos_i < 1 ? cos_i : 1;
    /* 1 - (1 - c^2) / eta^2 without the cancellation that costs the critical angle its digits where eta is close to 1 */
    double cos2_t = (c * c - (1 - eta) * (1 + eta)) / (eta * eta);
    if (cos2_t <= 0) {
        return eta == 1 ? 0 : 1;
    }
    double ct = sqrt(cos2_t);
    double rs = (c - eta * ct) / (c + eta * ct);
    double rp = (eta * c - ct) / (eta * c + ct);
    return 0.5 * (rs * rs + rp * rp);
}

double lum_fresnel_conductor(double cos_i, double eta, double k)
{
    double c = cos_i < 1 ? cos_i : 1;
    double c2 = c * c, s2 = (1 - c) * (1 + c);
    double eta2 = eta * eta, k2 = k * k;
    /* a + i b = sqrt((eta - i k)^2 - sin^2): the normal component of the wave vector inside. */
    double d = eta2 - k2 - s2;
    double a2b2 = sqrt(d * d + 4 * eta2 * k2);
    double a = sqrt(fmax(0.5 * (a2b2 + d), 0));
    double ts = a2b2 + c2, us = 2 * a * c;
    double rs = ts + us > 0 ? (ts - us) / (ts + us) : 1; /* 0/0 only at grazing on a medium without step */
    double tp = a2b2 * c2 + s2 * s2, up = us * s2;
    double rp = tp + up > 0 ? rs * (tp - up) / (tp + up) : 0;
    return 0.5 * (rs + rp);
}

double lum_fresnel_thin(double cos_i, double eta)
{
    /* Two equal faces, intensities added: R = F + F (1-F)^2 / (1 - F^2) = 2 F / (1 + F), for each polarisation. */
    double c = cos_i < 1 ? cos_i : 1;
    double sin2_t = (1 - c) * (1 + c) / (eta * eta);
    if (sin2_t >= 1) {
        return eta == 1 ? 0 : 1;
    }
    double ct = sqrt(1 - sin2_t);
    double rs = (c - eta * ct) / (c + eta * ct);
    double rp = (eta * c - ct) / (eta * c + ct);
    double fs = rs * rs, fp = rp * rp;
    return fs / (1 + fs) + fp / (1 + fp);
}
