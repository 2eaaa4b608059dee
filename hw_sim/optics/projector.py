"""The projector's light for 8-bit codes: response, black level, pixels, and blur away from the focus.

A pixel is a square of light through a lens. Square and lens in focus together are, to a percent, the cubic B-spline
(variance 1/3 px²: 1/12 of the square, 1/4 of a lens blur of half a pixel), by which the light is sampled.
Away from the focus the light spreads further, in proportion to the square of the distance.
"""

# Symbols in collect:
#   p, q      pattern coordinate of a camera pixel, shifted by PAD; i, j its integer, s, t its fractional part
#   r, e      1 − s, 1 − t
#   a0..a3    weights of the cubic B-spline along x at the nodes i − 1 .. i + 2; b0..b3 the same along y
#   near, far light in focus and at FAR_MM from it, between which the pixel's softness 0..1 interpolates

from __future__ import annotations

import math
import zlib
from collections.abc import Hashable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

FOCUS_MM = 522.5
FAR_MM = 120.0
"""Distance from the focus with the softest light."""
SPREAD_FAR_PX = 1.1
"""Gaussian sigma in projector px that is added at ``FAR_MM``."""
BLACK = 0.0025
"""Light of code 0 over code 255: contrast 400."""

FOCUS_WAY_MM = 487.5
"""Path in water to the focus, which is in the middle of the volume."""

PAD = 4
"""Dark pixels around the pattern in ``soften``'s result."""

Light = NDArray[np.float32]


def response(kind: str = "measured") -> Light:
    """Return the light 0..1 of each code, (256,) float32; ``kind`` is one of ``scene.RESPONSES``.

    The measured-like one is monotone, with a toe and a shoulder; no pure gamma.
    """
    x = np.arange(256) / 255.0
    light = {
        "measured": 0.75 * x**1.35 + 0.25 * (3.0 * x**2 - 2.0 * x**3),
        "linear": x,
        "gamma": x**2.2,
    }[kind]
    return (BLACK + (1.0 - BLACK) * light).astype(np.float32)


@dataclass(frozen=True, slots=True)
class LightSlice:
    """One image of the projector during a part of an exposure."""

    image: NDArray[np.uint8]
    """(768, 1024) green codes as scanned out."""
    duration_s: float
    since_blank_s: float = 0.0
    """Time from its vertical blank to the beginning of this slice, for ``light_engine``."""
    frame_s: float = 1.0 / 60.0
    """Time from one vertical blank to the next."""

    def key(self) -> tuple[Hashable, ...]:
        """Return a key that is equal for equal light."""
        return zlib.crc32(self.image.tobytes()), round(self.duration_s, 6)


def light_between(slices: tuple[LightSlice, ...], begin_s: float, end_s: float, table: Light) -> Light | None:
    """Return light times seconds per pixel, (768, 1024) float32, of successive ``slices`` between two times.

    The times count from the start of the first slice. ``None``: no slice overlaps.
    """
    total: Light | None = None
    at_s = 0.0
    for part in slices:
        seconds = min(end_s, at_s + part.duration_s) - max(begin_s, at_s)
        at_s += part.duration_s
        if seconds <= 0.0:
            continue
        light = cv2.LUT(np.ascontiguousarray(part.image), table * np.float32(seconds))
        total = np.asarray(light if total is None else total + light, np.float32)
    return total


def soften(light: Light, water_blur_px: float, spread_far_px: float = SPREAD_FAR_PX) -> Light:
    """Return the light (h, w) as spline coefficients in focus and ``FAR_MM`` from it.

    (h + 2 PAD, w + 2 PAD, 2) float32, with ``PAD`` dark px around. ``water_blur_px`` is the sigma by the water on the
    way, in projector px; ``spread_far_px`` that of the lens at ``FAR_MM`` (0: no defocus).
    """
    lowest, highest, _, _ = cv2.minMaxLoc(light)
    if lowest == highest:
        # Blur is linear, so a uniform image is scaled from that of 1. Most images of a measurement are uniform.
        return np.asarray(_soft_flat(light.shape, water_blur_px, spread_far_px) * np.float32(highest), np.float32)
    return _softened(light, water_blur_px, spread_far_px)


@lru_cache(maxsize=4)
def _soft_flat(shape: tuple[int, ...], water_blur_px: float, spread_far_px: float) -> Light:
    flat = _softened(np.ones(shape, np.float32), water_blur_px, spread_far_px)
    flat.flags.writeable = False
    return flat


def _softened(light: Light, water_blur_px: float, spread_far_px: float) -> Light:
    around = np.zeros((light.shape[0] + 2 * PAD, light.shape[1] + 2 * PAD), np.float32)
    around[PAD:-PAD, PAD:-PAD] = light
    # Below 0.15 px a Gaussian is narrower than its own sampling: it changes nothing.
    near = _blur(around, water_blur_px) if water_blur_px > 0.15 else around
    far = _blur(around, math.hypot(water_blur_px, spread_far_px)) if spread_far_px > 0.0 else near
    return np.asarray(cv2.merge([near, far]), np.float32)


def defocus_px(way_mm: ArrayLike, depth_mm: float, focus_mm: ArrayLike = FOCUS_WAY_MM) -> NDArray[np.float64]:
    """Return the Gaussian sigma, projector px, of a thin lens's defocus ``way_mm`` behind the port.

    It is ``SPREAD_FAR_PX`` at ``FAR_MM`` behind the middle. ``depth_mm``: see ``geometry.Lamp``; ``focus_mm``: path to
    the focus.
    """
    # The disc's angle is the aperture times the difference of the reciprocal distances.
    in_focus, path_mm = 1.0 / (np.asarray(focus_mm, np.float64) + depth_mm), np.asarray(way_mm, np.float64)
    scale = 1.0 / (FOCUS_WAY_MM + depth_mm) - 1.0 / (FOCUS_WAY_MM + FAR_MM + depth_mm)
    return np.asarray(SPREAD_FAR_PX * np.abs(1.0 / (path_mm + depth_mm) - in_focus) / scale)


def _blur(light: Light, sigma_px: float) -> Light:
    size = 2 * math.ceil(3.5 * sigma_px) + 1
    return np.asarray(cv2.GaussianBlur(light, (size, size), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def collect(
    pixels: Light, light: Light, white: np.float32, ambient: np.float32, backscatter: Light, electrons: Light
) -> None:
    """Add projected light × ``white``, grey × ``ambient``, and ``backscatter`` (h, w) to ``electrons`` (h, w).

    ``pixels`` (h, w, 5) are (p, q, lit, softness, grey) as in ``geometry``; ``light`` is what ``soften`` gives, sampled
    by the cubic B-spline; p and q lie within PAD − 2 px of the pattern wherever ``lit`` is not zero.
    """
    unity, half, third, sixth = np.float32(1.0), np.float32(0.5), np.float32(2.0 / 3.0), np.float32(1.0 / 6.0)
    for y in range(pixels.shape[0]):
        for x in range(pixels.shape[1]):
            value = ambient * pixels[y, x, 4] + backscatter[y, x]
            share = pixels[y, x, 2]
            if share > np.float32(0.0):
                p, q = pixels[y, x, 0] + np.float32(PAD), pixels[y, x, 1] + np.float32(PAD)
                i, j = int(p), int(q)
                s, t = p - np.float32(i), q - np.float32(j)
                r, e = unity - s, unity - t
                # Cubic B-spline: (1 − s)³/6, 2/3 − s² + s³/2, the remainder, s³/6; they sum to 1.
                a0, a3, a1 = r * r * r * sixth, s * s * s * sixth, third - s * s * (unity - half * s)
                b0, b3, b1 = e * e * e * sixth, t * t * t * sixth, third - t * t * (unity - half * t)
                a2, b2 = unity - a0 - a1 - a3, unity - b0 - b1 - b3
                near, far = np.float32(0.0), np.float32(0.0)
                for m in range(4):
                    k = b0 if m == 0 else (b1 if m == 1 else (b2 if m == 2 else b3))
                    n = j - 1 + m
                    near += k * (
                        light[n, i - 1, 0] * a0
                        + light[n, i, 0] * a1
                        + light[n, i + 1, 0] * a2
                        + light[n, i + 2, 0] * a3
                    )
                    far += k * (
                        light[n, i - 1, 1] * a0
                        + light[n, i, 1] * a1
                        + light[n, i + 1, 1] * a2
                        + light[n, i + 2, 1] * a3
                    )
                # The variance of defocus grows with the square of the distance, so light is linear in softness.
                value += white * share * (near + pixels[y, x, 3] * (far - near))
            electrons[y, x] += value
