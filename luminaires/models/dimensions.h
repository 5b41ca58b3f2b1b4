/* SPDX-License-Identifier: Apache-2.0 */
/*
 * Measures of our sample lamps and of the sample room: what make_models builds, what the READMEs quote and what tests compare with.
 * Metres, lumens, glTF frame (+Y up).  Every lamp shines down -Y.  The origin of each lamp is the centre of its luminous opening
 * (of the globe, for the pendant), so that "at 1 m below" means y = -1.  Closed forms are given where one exists.
 */
#ifndef LUMIBOX_MODELS_DIMENSIONS_H
#define LUMIBOX_MODELS_DIMENSIONS_H

/* ------------------------------------------------------------------------------------------------------ paraboloid-spot */
/*
 * Mirror: r^2 = 4 f (apex - y), 0 <= r <= R; opening in the plane y = 0.  Source: Lambertian sphere of radius a at the focus; its mesh
 * is blown up so that it has the sphere's area 4 pi a^2, hence (Cauchy) also its mean projected area, and luminance
 * L = flux / (4 pi^2 a^2) = 5.066e6 cd/m2.  The source absorbs what comes back to it.
 *   far axial intensity     I = rho L pi (R^2 - a^2) + L pi a^2            (35.82 kcd)
 *   full-flash distance     z = R / tan(asin(a / (f + R^2/4f)))             (1280.3 mm from the rim)
 *   direct share            F = (1 - h / sqrt(h^2 + R^2)) / 2, h = apex - f (0.39024; exact, sphere to coaxial disc)
 *   efficiency              F + rho (1 - F - a^2/(4 f^2))                   (0.93677; last term: light thrown back on the source,
 *                                                                            to first order in (a/f)^2)
 */
#define SPOT_FLUX 800.0
#define SPOT_SOURCE_RADIUS 0.002
#define SPOT_FOCAL_LENGTH 0.020
#define SPOT_RIM_RADIUS 0.050
#define SPOT_REFLECTANCE 0.9
#define SPOT_APEX (SPOT_RIM_RADIUS * SPOT_RIM_RADIUS / (4.0 * SPOT_FOCAL_LENGTH)) /* 31.25 mm above the opening */
#define SPOT_FOCUS (SPOT_APEX - SPOT_FOCAL_LENGTH)                                /* 11.25 mm above the opening */
#define SPOT_SHELL_GAP 0.002                                                      /* outer shell behind the mirror */

/* ---------------------------------------------------------------------------------------------------------- opal-globe */
/*
 * Thin diffusing shell: of the light that meets it, albedo * transmit goes on to the far side and albedo * (1 - transmit) returns,
 * both Lambertian, apart from the glossy reflection of its surface.  For a whole sphere, without that gloss and without loss on the
 * fittings inside: efficiency t / (1 - r) = 0.495 / (1 - 0.405) = 0.832.
 */
#define GLOBE_FLUX 1000.0
#define GLOBE_RADIUS 0.125
#define GLOBE_NECK_RADIUS 0.045 /* the globe is open above, where the cap sits */
#define GLOBE_ALBEDO 0.9
#define GLOBE_TRANSMIT 0.55
#define GLOBE_ROUGHNESS 0.4
#define GLOBE_BULB_RADIUS 0.030
#define GLOBE_KELVIN_X 0.3805 /* chromaticity of a 4000 K black body, CIE 1931 */
#define GLOBE_KELVIN_Y 0.3768
#define GLOBE_CAP_HEIGHT 0.050
#define GLOBE_ROD_RADIUS 0.006
#define GLOBE_ROD_TOP 0.400 /* height of the rod's upper end over the globe's centre */

/* -------------------------------------------------------------------------------------------------------- louvred-panel */
/* Panel luminance L = flux / (pi A) = 3331 cd/m2; straight down half-way between the blades the panel is seen unobstructed, and with the
 * blades' own light at grazing angles only: far axial intensity is at least L times the open area between the blades. */
#define LOUVRE_FLUX 3400.0
#define LOUVRE_OUTER 0.600   /* side of the housing */
#define LOUVRE_OPENING 0.570 /* side of the opening and of the emitting panel */
#define LOUVRE_CELLS 8
#define LOUVRE_BLADE_HEIGHT 0.030
#define LOUVRE_BLADE_THICKNESS 0.0015
#define LOUVRE_BLADE_BOTTOM 0.002 /* above the opening's plane */
#define LOUVRE_PANEL_HEIGHT 0.040 /* of the emitting panel above the opening's plane */
#define LOUVRE_HOUSING_HEIGHT 0.060
#define LOUVRE_BLADE_REFLECTANCE 0.87
#define LOUVRE_BLADE_ROUGHNESS 0.3
#define LOUVRE_WALL_REFLECTANCE 0.8
#define LOUVRE_PANEL_REFLECTANCE 0.7
#define LOUVRE_KELVIN_X 0.3451 /* chromaticity of a 5000 K black body, CIE 1931 */
#define LOUVRE_KELVIN_Y 0.3516

/* ---------------------------------------------------------------------------------------------------------- glass-lens */
/*
 * LED: Lambertian disc of radius a in the focal plane, facing down.  Lens: the face towards the LED is the hyperboloid
 *   w(r) = (sqrt((n-1)^2 f^2 + (n^2-1) r^2) - (n-1) f) / (n^2 - 1)   below its vertex, f below the LED,
 * which makes light from the focus exactly parallel inside the glass; the far face is plane.  So the opening is fully flashed from far
 * away on the axis:  I = L * integral over the opening of T(r) dA, with L = flux / (pi^2 a^2) and T the product of both faces' exact
 * Fresnel transmittances (plane face: 4n/(n+1)^2 = 0.9574; curved face: incidence angle of the ray from the focus).
 * Half-angle of the beam about atan(a / f) = 7.1 degrees.
 */
#define LENS_FLUX 1000.0
#define LENS_SOURCE_RADIUS 0.0025
#define LENS_IOR 1.52
#define LENS_FOCAL_LENGTH 0.020
#define LENS_RADIUS 0.020
#define LENS_RIM 0.003            /* height of the lens's cylindrical edge */
#define LENS_OPENING_RADIUS 0.0195 /* of the lip that holds the lens; in the plane y = 0 */
#define LENS_FLAT_FACE 0.0005     /* height of the lens's plane face over the opening */
#define LENS_TUBE_RADIUS 0.0205   /* inside */
#define LENS_TUBE_WALL 0.002
#define LENS_TUBE_REFLECTANCE 0.05

/* ----------------------------------------------------------------------------------------------------------- opal-ball */
/*
 * Bulb and shell are concentric, so the far intensity is the same in all directions: efficiency * flux / (4 pi).  The recipe fills the
 * wall with a medium of scattering 2000/m, absorption 0.5/m, mean cosine 0.8: optical depth 6 across, of which 1.2 counts as
 * isotropic.  With a lossless medium and bulb all light comes out, whatever the glass reflects.
 */
#define BALL_FLUX 1000.0
#define BALL_RADIUS 0.060
#define BALL_WALL 0.003
#define BALL_IOR 1.5
#define BALL_BULB_RADIUS 0.015

/* ---------------------------------------------------------------------------------------------------------- smoke-lamp */
/*
 * Density exp(-r^2 / 2 w^2) at the voxels, linear between them; the recipe's extinction is sigma = 8/m in the middle.  Light that
 * starts at the bulb's surface and isn't scattered: exp(-sigma integral of the density), for a bulb small against w about
 * exp(-sigma w sqrt(pi/2)) = 0.4482 for all directions from the middle.
 */
#define SMOKE_FLUX 800.0
#define SMOKE_BULB_RADIUS 0.006
#define SMOKE_WIDTH 0.080
#define SMOKE_VOXEL 0.005
#define SMOKE_REACH 48 /* voxels from the middle: 3 widths */

/* ------------------------------------------------------------------------------------------------------ edge-lit-panel */
/*
 * Acrylic, n > sqrt(2): light that enters through an edge can't leave through the large faces but for the grooves, which turn it down.
 * The opening is the plate's lower face, in y = 0.
 */
#define PANEL_FLUX 2000.0
#define PANEL_SIDE 0.300
#define PANEL_THICKNESS 0.004
#define PANEL_IOR 1.49
#define PANEL_GROOVES 120
#define PANEL_GROOVE_MIN 0.00010 /* depth at the edges with LEDs */
#define PANEL_GROOVE_MAX 0.00040 /* ... and in the middle */
#define PANEL_LED_GAP 0.0005     /* between LEDs and plate, LEDs and tray, and twice above the plate */
#define PANEL_TRAY 0.95

/* ---------------------------------------------------------------------------------------------------------- prism-lamp */
/*
 * An equilateral prism of N-SF11, side s, in the beam of a spot light (half angle PRISM_CONE): for the d line (587.6 nm) the ray in the
 * middle passes at the angle of least deviation, through the middles of both faces, and leaves straight down.
 *   incidence               sin i = n sin 30 deg
 *   deviation               2 i - 60 deg at the d line; at n: exit angle asin(n sin(60 deg - asin(sin i / n)))
 *   F to C line             4.00 deg
 * Light not refracted at both faces is reflected inside and leaves elsewhere.
 */
#define PRISM_FLUX 100.0    /* lumens of the spot light */
#define PRISM_IOR 1.7847173 /* n_d of N-SF11 */
#define PRISM_ABBE 25.68
#define PRISM_SIDE 0.040
#define PRISM_LENGTH 0.040
#define PRISM_CONE 0.0087266462599716479 /* 0.5 degrees */
#define PRISM_DISTANCE 0.100             /* from the light to the prism's face */

/* -------------------------------------------------------------------------------------------------------- phosphor-led */
/*
 * A blue LED chip at the bottom of a white cup, under a layer of yellow phosphor that closes the cup.  The recipe has the spectra:
 * chip 1 W about 450 nm; the layer absorbs 75 % there, emits 0.9 photons per photon absorbed, half of them outwards.
 */
#define PHOSPHOR_CUP_RADIUS 0.003
#define PHOSPHOR_CUP_DEPTH 0.0015
#define PHOSPHOR_CHIP 0.001 /* side */
#define PHOSPHOR_BODY 0.005 /* side of the white package round it */
#define PHOSPHOR_CUP_REFLECTANCE 0.95

/* ----------------------------------------------------------------------------------------------------------------- room */
/* Floor at y = 0, middle of the floor at x = z = 0.  A lamp hangs at ROOM_LAMP_HEIGHT over the middle. */
#define ROOM_LENGTH 5.0 /* along x */
#define ROOM_WIDTH 4.0  /* along z */
#define ROOM_HEIGHT 2.7
#define ROOM_LAMP_HEIGHT 2.2

#endif
