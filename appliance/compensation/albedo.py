"""Owns how bright each surface element is under full light: its albedo, from Gray images, read where the element was.

A Gray image shows every element either full light or none, and the motion says which. So it tells the albedo without asking for
a phase: what the sines need when a point that moves along with the fringes sees nearly the same phase in all of them. With the
albedo known, the offset of the four sines is known but for the albedo's noise, and four values within 90° tell the phase nearly
as well as four around the circle. The Gray images around the x-sines tell it; those in which an element was dark tell what the
water and the surroundings send: the backscatter.

Legend of the kernel, per pixel (column x, row)::

    t, c       depth, and coefficients of the pixel's parabolas (``displacement``)
    p, q       place in the pattern that lights the pixel at the reference time, px from its edge
    m          number of a Gray image, in the order in which they are asked
    bright, weights, squares   Σ w y, Σ w, Σ w² over the images that lit it
    dim, dims                  Σ y and their number over those that did not
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.displacement import (
    FIRST_FRAME,
    FRAME_COEFFICIENTS,
    OF_PHASE,
    OF_V,
    P_OF_T,
    Q_OF_T,
    DisplacementField,
    interpolate_pixel,
    interpolate_row,
    parabola_at,
    read_spline,
)
from appliance.compensation.phase_solver import BRIGHT, FIRST_GRAY, MAX_T, Sources, Terms
from appliance.compensation.stripes import Stripes, illuminated_at, stripes_of
from appliance.patterns.sequence import Direction, PatternSequence

Map = NDArray[np.float32]

CLEAR_PX = 3.0
"""Nearer to a stripe's border in the pattern nothing is read: defocus and motion during an exposure blur it."""
NEAR_IMAGES = 4
"""Gray images so near to the x-sines, before and after, come first: the farther, the less the element's place is known."""
ENOUGH = np.float32(3.0)
"""Weight of the images from which on the others are needless."""
FAR_WEIGHT = np.float32(0.25)
"""Weight of the other images."""
EVEN_PX, NEAR_PX, BACKSCATTER_PX = 5, 15, 31
"""Windows in px of pictures 800 px wide: over which noise is taken out, gaps are filled, and the backscatter is smoothed."""
FILLED_SD = 0.03
"""Standard deviation of the albedo, as a share, where only its neighbours' is known."""
PLACE_PX = 0.05
"""Uncertainty (σ) of the albedo's place, in px of pictures 800 px wide, however well the motion is known."""
MEAN_NOISE_SHARE = 0.23
"""Variance of a value read between pixels, as a share of one pixel's, in the mean over places."""
_NAN, _HALF, _ZERO, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(0.0), np.float32(1.0)


class GrayImages(NamedTuple):
    """Images that tell the albedo, in the order in which they are asked."""

    stripes: Stripes
    """The images (n); axis −1: lit everywhere."""
    places: NDArray[np.int64]
    """(n,): their places among the followed frames."""
    near: int
    """The first so many are always asked, the others only where those say too little."""


class GrayMeans(NamedTuple):
    """Mean grey values (h, w) of an element when it was lit and when it was dark, and of how many images; NaN and 0: of none."""

    lit: Map
    lit_count: Map
    dark: Map
    dark_count: Map


def gray_images(sequence: PatternSequence) -> GrayImages:
    """Return the Gray images around the x-sines, then the others by their distance in time, then the bright frame."""
    every, sines = stripes_of(sequence), sequence.axis(Direction.X).sine
    away = np.maximum(sines[0] - every.frames, every.frames - sines[-1])
    order = np.argsort(away, kind="stable")
    stripes = Stripes(
        np.append(every.frames[order], sequence.bright), np.append(every.axes[order], -1),
        np.append(every.widths_px[order], 1.0),
    )  # fmt: skip
    places = np.append(FIRST_GRAY + order, BRIGHT).astype(np.int64)
    return GrayImages(stripes, places, int(np.count_nonzero(away <= NEAR_IMAGES)))


def with_albedo(
    sequence: PatternSequence, sources: Sources, terms: Terms, field: DisplacementField, lateral_sd_px: float,
    stride: int = 1,
) -> Sources:  # fmt: skip
    """Return ``sources`` with the albedo of what is at its rough depth, which may lie ``lateral_sd_px`` beside its place.

    With a ``stride``, only every so many rows are read and serve their neighbours, too: a row knows nothing of those between
    then, and windows are so much higher.
    """
    height, width = sources.p_px.shape
    rows = -(-height // stride)
    means = GrayMeans(*(np.empty((rows, width), np.float32) for _ in range(4)))
    gather(sources.frames, gray_images(sequence), field, sources.rough_t, terms.period_px, 0, height, stride, means)
    backscatter = np.nan_to_num(known_mean(means.dark, scaled_window(BACKSCATTER_PX, width)))
    full_dn2 = terms.dark_dn2 + terms.shot_dn * np.maximum(means.lit, _ZERO)
    noise_dn2 = np.asarray(MEAN_NOISE_SHARE * full_dn2 / np.maximum(means.lit_count, _ONE), np.float32)
    even_px = scaled_window(EVEN_PX, width)
    albedo, variance = denoised(means.lit - backscatter, noise_dn2, even_px)
    # Gaps get what is around them.
    near = known_mean(known_mean(albedo, even_px), scaled_window(NEAR_PX, width))
    unseen = ~np.isfinite(albedo)
    albedo = np.where(unseen, near, albedo)
    variance = np.where(unseen, np.float32(FILLED_SD**2) * near**2, variance)
    # On a slope of albedo, an uncertain place is an uncertain albedo; beside what is not known, the slope is not either.
    slopes = np.gradient(albedo, stride, 1) if stride > 1 else np.gradient(albedo)
    uneven = sum(np.asarray(one, np.float32) ** 2 for one in slopes)
    misplaced = np.float32((PLACE_PX * width / 800.0) ** 2 + lateral_sd_px**2) * uneven
    doubt_dn2 = np.asarray(np.where(np.isfinite(misplaced), variance + misplaced, 2.0 * variance), np.float32)
    if stride > 1:
        albedo, backscatter, doubt_dn2 = (
            np.repeat(one, stride, axis=0)[:height] for one in (albedo, backscatter, doubt_dn2)
        )
    return sources._replace(albedo_dn=albedo, backscatter_dn=backscatter, albedo_variance_dn2=doubt_dn2)


def scaled_window(px: int, width: int) -> int:
    """Return a window of ``px`` of 800 in px of a picture ``width`` px wide; odd."""
    return 2 * round(0.5 * px * width / 800.0) + 1


@numba.njit(nogil=True, cache=True, error_model="numpy")
def gather(
    frames: NDArray[np.uint8], images: GrayImages, field: DisplacementField, depth: Map, period_px: np.float32, start: int,
    stop: int, stride: int, means: GrayMeans,
) -> None:  # fmt: skip
    """Read every ``stride``-th row from ``start`` to ``stop`` − 1 of pixels at ``depth`` (h, w) in t, one row of ``means`` each."""
    stripes, places, near = images
    lit, lit_count, dark, dark_count = means
    height, width = depth.shape
    nodes, step = field.nodes, field.step_px
    count = nodes.shape[2]
    pixels = frames.reshape(frames.size)
    at_row = np.empty((nodes.shape[1], count), np.float32)
    c = np.empty(count, np.float32)
    for row in range(start, stop, stride):
        interpolate_row(nodes, step, row, at_row)
        line = (row - start) // stride
        for x in range(width):
            # A pixel without a depth, or in no image, has neither albedo nor backscatter.
            lit[line, x], dark[line, x] = _NAN, _NAN
            lit_count[line, x], dark_count[line, x] = _ZERO, _ZERO
            t = depth[row, x]
            if not (abs(t) < MAX_T):
                continue
            interpolate_pixel(at_row, step, x, 0, c)
            p, q = parabola_at(c, P_OF_T, t) + _HALF, parabola_at(c, Q_OF_T, t) + _HALF
            bright, dim, weights, squares, dims = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            for m in range(places.size):
                # The images around the x-sines come first: the others are asked only until there is enough.
                if m >= near and weights >= ENOUGH:
                    break
                # Where the point was in this image: (x, row) + (u, v)(t) of its frame.
                at = FIRST_FRAME + FRAME_COEFFICIENTS * places[m]
                u, v = np.float32(x) + parabola_at(c, at, t), np.float32(row) + parabola_at(c, at + OF_V, t)
                if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
                    continue
                # Whether it was lit there; far images tell nothing of the backscatter.
                light = 1
                if stripes.axes[m] >= 0:
                    shown = (p if stripes.axes[m] == 0 else q) + period_px * parabola_at(c, at + OF_PHASE, t)
                    light = illuminated_at(float(shown), stripes.widths_px[m], CLEAR_PX)
                if light < 0 or (light == 0 and m >= near):
                    continue
                grey = read_spline(pixels, stripes.frames[m] * (height * width), width, u, v)
                if grey != grey:
                    continue
                # Σ w y, Σ w, Σ w² of what was lit; Σ y of what was dark.
                if light == 1:
                    weight = _ONE if m < near else FAR_WEIGHT
                    bright += weight * grey
                    weights += weight
                    squares += weight * weight
                else:
                    dim += grey
                    dims += _ONE
            # A weighted mean has the noise of (Σ w)² / Σ w² images.
            if weights > _ZERO:
                lit[line, x], lit_count[line, x] = bright / weights, weights * weights / squares
            if dims > _ZERO:
                dark[line, x], dark_count[line, x] = dim / dims, dims


def known_mean(values: Map, window_px: int) -> Map:
    """Return the mean (h, w) of what is known within ``window_px`` around each pixel of ``values``; NaN where nothing is."""
    known = np.isfinite(values)
    share = cv2.boxFilter(known.astype(np.float32), -1, (window_px, window_px))
    total = cv2.boxFilter(np.where(known, values, np.float32(0.0)), -1, (window_px, window_px))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(share > 1e-6, total / share, _NAN), np.float32)


def denoised(grey: Map, variance: Map, window_px: int) -> tuple[Map, Map]:
    """Return ``grey`` (h, w) without noise of ``variance`` where it varies no more than that, and the variance that is left.

    The local-statistics filter: J.-S. Lee, IEEE PAMI 2 (1980) 165.
    """
    mean = known_mean(grey, window_px)
    around = known_mean((grey - mean) ** 2, window_px)
    noise = known_mean(variance, window_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.clip(1.0 - 1.5 * noise / around, 0.0, 1.0).astype(np.float32)
    return mean + own * (grey - mean), variance * own**2 + (1 - own**2) * noise / window_px**2
