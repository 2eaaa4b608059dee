"""The images of marine snow and bubbles: lit by the pattern, defocused, and covering the background.

A speck is a disc; one smaller than a pixel keeps its light and loses its form. Specks cast no shadows, as the
projector's aperture is wider than most of them.
"""

# Symbols in the kernels:
#   drawn     per speck: U, V its middle, px; MOVED_U, MOVED_V its path in the exposure; RADIUS, SIGMA size and defocus,
#             px; FAR its distance, mm; KIND snow or bubble; SEEN
#   samples   per speck and place of LOOKS: the channels of geometry.Geometry.pixels
#   p, q      pattern coordinate; reduced the optical distance, mm: water counts by 1 / index
#   r, sigma  radius and softness, px; cover, hides, shines shares of a pixel

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.geometry import CHANNELS, GREY, LIT, MIDDLE_MM, SOFT, Geometry, Lamp, P, Q
from hw_sim.optics.projector import FAR_MM, collect
from hw_sim.optics.shadow import nearest
from hw_sim.optics.table import OUTSIDE, look_up
from hw_sim.optics.trace import DISTANCE, FOCAL, FOCUS, GLASS, HEIGHT, THICKNESS, WATER, WIDTH, project_point
from hw_sim.water.drift import BUBBLE, Specks

Array = NDArray[np.float64]
Picture = NDArray[np.float32]

APERTURE_MM = 11.5 / 8.0
DEFOCUS_SIGMA = 0.25
"""Gaussian sigma of an out-of-focus disc, against its diameter."""
SNOW_ALBEDO, SNOW_OPACITY = 0.5, 0.7
BALL = 2.0 / 3.0
"""Mean brightness of a matt ball lit from the direction of view, against a disc."""
BUBBLE_ALBEDO = 0.5
RIM, RIM_LIGHT, CORE_OPACITY = 0.75, 1.0, 0.3
"""Share of a bubble's radius beyond which light is totally reflected (1/1.333); brightness of that; opacity inside."""
SPOT_AT, SPOT_RADIUS, SPOT_LIGHT = 0.35, 0.16, 4.0
"""The projector's reflex, in radii."""
LOOKS = ((0.0, 0.0), (0.7, 0.0), (0.35, 0.606), (-0.35, 0.606), (-0.7, 0.0), (-0.35, -0.606), (0.35, -0.606))
"""Places on a speck at which the light is sampled, in radii."""
LEAST_SIGMA_PX = 0.3
"""Softness in focus, so that a speck's position within a pixel is not lost before the lens blurs the image."""
MOST_STEPS = 24
"""Largest number of steps in which a speck's path during one exposure is drawn."""
U, V, MOVED_U, MOVED_V, RADIUS, SIGMA, FAR, KIND, SEEN = range(9)


def scatter(
    electrons: Picture,
    covered: Picture | None,
    specks: Specks,
    duration_s: float,
    eye: Array,
    table: Array,
    rays: Array,
    geometry: Geometry,
    lamp: Lamp,
    first: Picture | None,
    softened: Picture | None,
    white_e: float,
    ambient_e: float,
    attenuation_per_m: float,
) -> None:
    """Put specks before the mean ``electrons`` (h, w) of an instant of ``duration_s``, in place.

    ``softened``: projected light from ``projector.soften``; ``first``: its first intersections; ``None``: dark.
    ``covered`` (h, w), if given, receives the hidden share of each pixel.
    """
    count, per_mm = len(specks.radius_mm), attenuation_per_m / 1000.0
    drawn = np.empty((count, 9))
    samples = np.empty((count, len(LOOKS), CHANNELS), np.float32)
    shade = np.empty((0, 0), np.float32) if first is None else first
    _place(
        specks.places_mm, specks.velocity_mm_s * duration_s, specks.radius_mm, specks.kind, eye, table, rays,
        softened is not None, shade, lamp.eye, lamp.table, lamp.window, lamp.depth_mm, per_mm, np.array(LOOKS),
        drawn, samples,
    )  # fmt: skip
    visible = drawn[:, SEEN] > 0.0
    drawn, samples = drawn[visible], samples[visible]
    light = np.zeros(samples.shape[:2], np.float32)
    if softened is None:
        light += np.float32(ambient_e) * samples[..., GREY]
    else:
        collect(samples, softened, np.float32(white_e), np.float32(ambient_e), np.zeros_like(light), light)
    hidden = np.empty((0, 0), np.float32) if covered is None else covered
    opacity, glow = np.zeros_like(electrons), np.zeros_like(electrons)
    _draw(drawn, light.mean(axis=1), geometry.distance_mm, opacity, glow, electrons, hidden)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _pixel(eye: Array, table: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the pixel of a point: from the table, or exactly where that does not reach."""
    u, v = look_up(eye, table, x, y, z)
    if u <= OUTSIDE:
        return project_point(eye, x, y, z)
    return u, v


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _place(
    places: Array, moved: Array, radius: Array, kind: NDArray[np.int64], eye: Array, table: Array, rays: Array,
    is_lit: bool, first: Picture, lamp: Array, lamp_table: Array, window: Picture, depth_mm: float, per_mm: float,
    looks: Array, drawn: Array, samples: Picture,
) -> None:  # fmt: skip
    """Fill ``drawn`` (n, 9) and ``samples`` (n, len(LOOKS), CHANNELS): image and illumination of each speck."""
    h, w = rays.shape[:2]
    behind_glass = eye[DISTANCE] + eye[THICKNESS] / eye[GLASS]
    focus_mm = behind_glass + MIDDLE_MM / eye[WATER]
    middle = rays[h // 2, w // 2]
    lamp_behind = lamp[DISTANCE] + lamp[THICKNESS] / lamp[GLASS]
    for i in range(radius.size):
        out = drawn[i]
        out[SEEN] = 0.0
        x, y, z = places[i, 0], places[i, 1], places[i, 2]
        # Far outside of the image: no exact computation.
        bx, by, bz = x - middle[0], y - middle[1], z - middle[2]
        depth = bx * middle[3] + by * middle[4] + bz * middle[5]
        if depth < 10.0:
            continue
        reduced = behind_glass + depth / eye[WATER]
        per_px = eye[FOCAL] / reduced
        across = math.sqrt(max(bx * bx + by * by + bz * bz - depth * depth, 0.0))
        if across * per_px > 0.75 * (w + h):
            continue
        mx, my, mz = 0.5 * moved[i, 0], 0.5 * moved[i, 1], 0.5 * moved[i, 2]
        u0, v0 = _pixel(eye, table, x - mx, y - my, z - mz)
        u1, v1 = _pixel(eye, table, x + mx, y + my, z + mz)
        out[RADIUS] = radius[i] * per_px
        # Circle of confusion in the image: aperture · f · |1/s − 1/s₀|.
        out[SIGMA] = DEFOCUS_SIGMA * APERTURE_MM * eye[FOCAL] * abs(1.0 / reduced - 1.0 / focus_mm)
        reach = out[RADIUS] + 4.0 * out[SIGMA] + 2.0
        if not (max(u0, u1) > -reach and min(u0, u1) < w + reach and max(v0, v1) > -reach and min(v0, v1) < h + reach):
            continue
        u, v = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
        ray = rays[min(max(int(v + 0.5), 0), h - 1), min(max(int(u + 0.5), 0), w - 1)]
        far = math.sqrt((x - ray[0]) ** 2 + (y - ray[1]) ** 2 + (z - ray[2]) ** 2)
        out[U], out[V], out[MOVED_U], out[MOVED_V] = u, v, u1 - u0, v1 - v0
        out[FAR], out[KIND], out[SEEN] = far, kind[i], 1.0
        # The same light as at a surface point (optics.geometry), but for the cosine: a ball has its own mean.
        grey = BUBBLE_ALBEDO if kind[i] == BUBBLE else SNOW_ALBEDO * BALL
        grey *= math.exp(-per_mm * far)
        p, q, light, soft, length = OUTSIDE, OUTSIDE, 0.0, 0.0, 0.0
        if is_lit:
            p, q = look_up(lamp, lamp_table, x, y, z)
            if 0.0 < p < lamp[WIDTH] - 1.0 and 0.0 < q < lamp[HEIGHT] - 1.0:
                start = window[nearest(q), nearest(p)]
                length = math.sqrt((x - start[0]) ** 2 + (y - start[1]) ** 2 + (z - start[2]) ** 2)
                # In the object's shadow, but for a millimetre: no projector light.
                if not first[nearest(q), nearest(p)] < length - 1.0:
                    spread = (MIDDLE_MM + depth_mm) / (length + depth_mm)
                    light = grey * spread * spread * start[3] * math.exp(-per_mm * length)
                    away = (z - lamp[FOCUS]) / FAR_MM
                    soft = min(away * away, 1.0)
        # Large specks extend over several fringes, so the pattern is sampled all over them.
        wide = radius[i] * lamp[FOCAL] / (lamp_behind + length / lamp[WATER])
        for k in range(looks.shape[0]):
            sample = samples[i, k]
            sample[P] = min(max(p + wide * looks[k, 0], -1.0), lamp[WIDTH])
            sample[Q] = min(max(q + wide * looks[k, 1], -1.0), lamp[HEIGHT])
            sample[LIT], sample[SOFT], sample[GREY] = light, soft, grey


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _step(edge: float, sigma: float) -> float:
    """Return a soft step: 1 well inside of an edge, 0 well outside (Gaussian of sigma px)."""
    return 0.5 * math.erfc(edge / (math.sqrt(2.0) * sigma))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _draw(
    drawn: Array, light: Picture, distance: Array, opacity: Picture, glow: Picture, electrons: Picture, hidden: Picture
) -> None:
    """Draw the specks over ``electrons`` (h, w), the furthest first.

    ``opacity`` and ``glow`` of the present speck, both (h, w), are zero at the beginning and at the end.
    """
    h, w = electrons.shape
    root = math.sqrt(2.0)
    for i in range(drawn.shape[0]):
        speck = drawn[i]
        r, sigma, bubble = speck[RADIUS], max(speck[SIGMA], LEAST_SIGMA_PX), speck[KIND] == BUBBLE
        path_px = math.hypot(speck[MOVED_U], speck[MOVED_V])
        steps = min(MOST_STEPS, 1 + int(path_px / max(0.7, sigma, 0.1 * r if bubble else 0.5 * r)))
        # A small speck is a Gaussian with the disc's own variance r²/4 added; a large one a disc with soft edges.
        formless = r < 2.0 * sigma
        spread = math.sqrt(sigma * sigma + 0.25 * r * r)
        reach = 0.5 * path_px + (4.0 * spread + 1.0 if formless else r + 4.0 * sigma + 1.0)
        x0, x1 = max(0, int(speck[U] - reach)), min(w - 1, int(speck[U] + reach) + 1)
        y0, y1 = max(0, int(speck[V] - reach)), min(h - 1, int(speck[V] + reach) + 1)
        if x0 > x1 or y0 > y1:
            continue
        area = math.pi * r * r
        disc = math.sqrt(max(r * r - sigma * sigma, 0.0))  # compensates the area of a soft edge
        for k in range(steps):
            along = (k + 0.5) / steps - 0.5
            cu, cv = speck[U] + along * speck[MOVED_U], speck[V] + along * speck[MOVED_V]
            for y in range(y0, y1 + 1):
                dy = y - cv
                if abs(dy) > reach:
                    continue
                row = 1.0
                if formless:
                    # The Gaussian is integrated over each pixel (differences of erf), so no light is lost between pixels.
                    row = area * 0.5 * (math.erf((dy + 0.5) / (root * spread)) - math.erf((dy - 0.5) / (root * spread)))
                for x in range(x0, x1 + 1):
                    dx = x - cu
                    if formless:
                        cover = (
                            row
                            * 0.5
                            * (math.erf((dx + 0.5) / (root * spread)) - math.erf((dx - 0.5) / (root * spread)))
                        )
                        hides = cover * (0.6 if bubble else SNOW_OPACITY)
                        shines = cover * (0.54 if bubble else 1.0)
                    else:
                        d = math.sqrt(dx * dx + dy * dy)
                        cover = _step(d - disc, sigma)
                        hides, shines = cover * SNOW_OPACITY, cover
                        if bubble:
                            # A bubble: bright rim by total reflection, a nearly clear core, and the projector's reflex
                            # above its middle.
                            core = _step(d - RIM * disc, sigma)
                            hides = cover - (1.0 - CORE_OPACITY) * core
                            spot = math.hypot(dx, dy + SPOT_AT * r)
                            wide = SPOT_RADIUS * SPOT_RADIUS * r * r + sigma * sigma
                            bright = SPOT_LIGHT * SPOT_RADIUS * SPOT_RADIUS * r * r / wide
                            shines = RIM_LIGHT * (cover - core) + bright * math.exp(-0.5 * spot * spot / wide)
                    opacity[y, x] += hides / steps
                    glow[y, x] += shines / steps
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                # Painter's algorithm: the background shines through this speck's transparency, unless the object is
                # nearer.
                hides, shines = min(opacity[y, x], np.float32(1.0)), glow[y, x]
                opacity[y, x], glow[y, x] = 0.0, 0.0
                if distance[y, x] < speck[FAR]:
                    continue
                electrons[y, x] += shines * light[i] - hides * electrons[y, x]
                if hidden.size:
                    hidden[y, x] += (1.0 - hidden[y, x]) * hides
