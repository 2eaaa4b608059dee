"""Owns how bright each surface element is under full light: its albedo, from Gray images, read where the element was.

A Gray image shows every element either full light or none, and the motion says which. So it tells the albedo without asking for
a phase: what the sines need when a point that moves along with the fringes sees nearly the same phase in all of them. With the
albedo known, the offset of the four sines is known but for the albedo's noise, and four values within 90° tell the phase nearly
as well as four around the circle. The Gray images around the x-sines tell it; those in which an element was dark tell what the
water and the surroundings send: the backscatter.

Legend of the kernel, per pixel (column x, row)::

    t, c       depth, and coefficients of the pixel's parabolas (``displacement``)
    p, q       place in the pattern that lights the pixel at the reference time
    m          number of a Gray image, in the order in which they are asked
    bright, weights, squares   Σ w y, Σ w, Σ w² over the images that lit it; at last mean and number
    dim, dims                  Σ y and their number over those that did not; at last mean and number
"""

from __future__ import annotations

from typing import NamedTuple, cast

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.motion.displacement import (
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
from appliance.measure.motion.phase_solver import BRIGHT, FIRST_GRAY, MAX_T, Sources, Terms
from appliance.measure.motion.row_reader import parabola_row, place_row, read_row, shares_of
from appliance.measure.motion.stripes import Stripes, illuminated_at, stripes_of

Map = NDArray[np.float32]

CLEAR_PX = 3.0
"""Nearer to a stripe's border in the pattern nothing is read: defocus and motion during an exposure blur it."""
NEAR_IMAGES = 4
"""Gray images so near to the x-sines, before and after, come first: the farther, the less the element's place is known."""
ENOUGH = np.float32(3.0)
"""Weight of the images from which on the others are needless."""
FAR_WEIGHT = np.float32(0.25)
"""Weight of the other images."""
EVEN_PX, NEAR_PX, BACKSCATTER_PX = 5, 20, 31
"""Windows in px of pictures 800 px wide: over which noise is taken out, gaps are filled, and the backscatter is smoothed."""
WIDE_PX = 8
"""Pixels that are left of a wide window in the smaller picture that its mean is taken in."""
FILLED_SD = 0.03
"""Standard deviation of the albedo, as a share, where only its neighbours' is known."""
PLACE_PX = 0.05
"""Uncertainty (σ) of the albedo's place, in px of pictures 800 px wide, however well the motion is known."""
MEAN_NOISE_SHARE = 0.23
"""Variance of a value read between pixels, as a share of one pixel's, in the mean over places."""
_NAN, _HALF, _ZERO, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(0.0), np.float32(1.0)
_NONE, _P, _Q = (cast(int, np.int64(k)) for k in (0, P_OF_T, Q_OF_T))
"""Whole numbers of a type of their own: for plain ones, numba would compile what is called with them for each value."""


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
    backscatter = np.nan_to_num(wide_mean(means.dark, scaled_window(BACKSCATTER_PX, width)))
    full_dn2 = terms.dark_dn2 + terms.shot_dn * np.maximum(means.lit, _ZERO)
    noise_dn2 = np.asarray(MEAN_NOISE_SHARE * full_dn2 / np.maximum(means.lit_count, _ONE), np.float32)
    even_px = scaled_window(EVEN_PX, width)
    albedo, variance = denoised(means.lit - backscatter, noise_dn2, even_px)
    # Gaps get what is around them.
    near = wide_mean(albedo, scaled_window(NEAR_PX, width))
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
    """Read every ``stride``-th row from ``start`` to ``stop`` − 1 of pixels at ``depth`` (h, w) in t, one row of ``means`` each.

    A pixel without a depth, or in no image, has neither albedo nor backscatter.
    """
    stripes, places, near = images
    lit, lit_count, dark, dark_count = means
    height, width = depth.shape
    pixels = frames.reshape(frames.size)
    at_row = np.empty((field.nodes.shape[1], field.nodes.shape[2]), np.float32)
    shares = shares_of(field.step_px)
    t, p, q, shown = (
        np.empty(width, np.float32),
        np.empty(width, np.float32),
        np.empty(width, np.float32),
        np.empty(width, np.float32),
    )
    u, v, grey = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    light, cell = np.empty(width, np.int32), np.empty(width, np.int32)
    c = np.empty(field.nodes.shape[2], np.float32)
    for row in range(start, stop, stride):
        interpolate_row(field.nodes, field.step_px, row, at_row)
        line = (row - start) // stride
        bright, weights, dim, dims = lit[line], lit_count[line], dark[line], dark_count[line]
        first, last = width, _NONE
        for x in range(width):
            bright[x], weights[x], dim[x], dims[x] = _ZERO, _ZERO, _ZERO, _ZERO
            # Only pixels between the first and the last one with a depth are read.
            known = abs(depth[row, x]) < MAX_T
            t[x] = depth[row, x] if known else _NAN
            first, last = min(first, x) if known else first, x + 1 if known else last
        # Where the projector lights them at the reference time: (p, q)(t).
        if first < last:
            parabola_row(at_row, shares, _P, t, first, last, p)
            parabola_row(at_row, shares, _Q, t, first, last, q)
        # The images around the x-sines, whole rows at once.
        for m in range(near if first < last else 0):
            at = FIRST_FRAME + FRAME_COEFFICIENTS * places[m]
            # Where the points were in this image: (x, row) + (u, v)(t) of its frame; and by how many periods the pattern moved.
            parabola_row(at_row, shares, at + OF_PHASE, t, first, last, shown)
            parabola_row(at_row, shares, at, t, first, last, u)
            parabola_row(at_row, shares, at + OF_V, t, first, last, v)
            place_row(row, first, last, u, v)
            read_row(pixels, stripes.frames[m] * (height * width), height, width, u, v, first, last, cell, grey)
            _illuminated_row(
                p if stripes.axes[m] == 0 else q, shown, period_px, stripes.widths_px[m], first, last, light
            )
            for x in range(first, last):
                # Σ y and number of what was lit, and of what was dark.
                known = grey[x] == grey[x]
                is_lit, is_dark = known & (light[x] == 1), known & (light[x] == 0)
                bright[x] += grey[x] if is_lit else _ZERO
                weights[x] += _ONE if is_lit else _ZERO
                dim[x] += grey[x] if is_dark else _ZERO
                dims[x] += _ONE if is_dark else _ZERO
        for x in range(width):
            # NaN: no depth, no albedo.
            if not first <= x < last or t[x] != t[x]:
                bright[x], dim[x] = _NAN, _NAN
                continue
            squares = weights[x]
            if weights[x] < ENOUGH:
                # The others are asked only until there is enough, and tell nothing of the backscatter.
                interpolate_pixel(at_row, field.step_px, x, 0, c)
                for m in range(near, places.size):
                    if weights[x] >= ENOUGH:
                        break
                    # Where the point was in this image: (x, row) + (u, v)(t) of its frame.
                    at = FIRST_FRAME + FRAME_COEFFICIENTS * places[m]
                    u_px = np.float32(x) + parabola_at(c, at, t[x])
                    v_px = np.float32(row) + parabola_at(c, at + OF_V, t[x])
                    if not (u_px >= 1.0 and v_px >= 1.0 and u_px < width - 2.0 and v_px < height - 2.0):
                        continue
                    if stripes.axes[m] >= 0:
                        place = (
                            (p[x] if stripes.axes[m] == 0 else q[x])
                            + _HALF
                            + period_px * parabola_at(c, at + OF_PHASE, t[x])
                        )
                        if illuminated_at(float(place), stripes.widths_px[m], CLEAR_PX) != 1:
                            continue
                    # Lit: it counts with less weight, for its place is known less well.
                    one = read_spline(pixels, stripes.frames[m] * (height * width), width, u_px, v_px)
                    if one == one:
                        bright[x] += FAR_WEIGHT * one
                        weights[x] += FAR_WEIGHT
                        squares += FAR_WEIGHT * FAR_WEIGHT
            # A weighted mean has the noise of (Σ w)² / Σ w² images.
            if weights[x] > _ZERO:
                bright[x], weights[x] = bright[x] / weights[x], weights[x] * weights[x] / squares
            else:
                bright[x] = _NAN
            dim[x] = dim[x] / dims[x] if dims[x] > _ZERO else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _illuminated_row(
    place_px: NDArray[np.float32], turns: NDArray[np.float32], period_px: np.float32, width_px: float, first: int, stop: int,
    light: NDArray[np.int32],
) -> None:  # fmt: skip
    """Write what ``illuminated_at`` says of columns ``first`` to ``stop`` − 1 into ``light`` (w,).

    They are at ``place_px`` (w,) of the pattern, in whose direction motion took them ``turns`` (w,) periods on.
    """
    for x in range(first, stop):
        shown = (place_px[x] + _HALF) + period_px * turns[x]
        stripe = float(shown) / width_px + 0.5
        number = np.floor(stripe)
        inside = stripe - number
        odd = number - 2.0 * np.floor(0.5 * number)
        clear = min(inside, 1.0 - inside) * width_px >= CLEAR_PX
        light[x] = np.int32(odd) if clear else np.int32(-1)


def known_mean(values: Map, window_px: int) -> Map:
    """Return the mean (h, w) of what is known within ``window_px`` around each pixel of ``values``; NaN where nothing is."""
    known = np.isfinite(values)
    share = cv2.boxFilter(known.astype(np.float32), -1, (window_px, window_px))
    total = cv2.boxFilter(np.where(known, values, _ZERO), -1, (window_px, window_px))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(share > 1e-6, total / share, _NAN), np.float32)


def wide_mean(values: Map, window_px: int) -> Map:
    """Return ``known_mean`` (h, w) of a wide window, where nobody asks for it to a pixel: taken in a smaller picture.

    That is as many times smaller as leaves ``WIDE_PX`` of the window.
    """
    height, width = values.shape
    times = max(1, window_px // WIDE_PX)
    known = np.isfinite(values)
    size = (-(-width // times), -(-height // times))
    share = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(known, values, _ZERO), size, interpolation=cv2.INTER_AREA)
    window = (window_px // times | 1, window_px // times | 1)
    share, total = cv2.boxFilter(share, -1, window), cv2.boxFilter(total, -1, window)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(share > 1e-6, total / share, _NAN).astype(np.float32)
    return np.asarray(cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def denoised(grey: Map, variance: Map, window_px: int) -> tuple[Map, Map]:
    """Return ``grey`` (h, w) without noise of ``variance`` where it varies no more than that, and the variance that is left.

    ``variance`` is known where ``grey`` is. The local-statistics filter: J.-S. Lee, IEEE PAMI 2 (1980) 165.
    """
    window, known = (window_px, window_px), np.isfinite(grey)

    def summed(values: Map) -> Map:
        return np.asarray(cv2.boxFilter(np.where(known, values, _ZERO), -1, window), np.float32)

    share = cv2.boxFilter(known.astype(np.float32), -1, window)
    with np.errstate(invalid="ignore", divide="ignore"):
        per_share = np.where(share > 1e-6, _ONE / share, _NAN).astype(np.float32)
        mean = summed(grey) * per_share
        apart = grey - mean
        around, noise = summed(apart * apart), summed(variance)
        own = np.clip(_ONE - np.float32(1.5) * noise / around, _ZERO, _ONE)
        noise *= per_share / np.float32(window_px**2)
    own2 = own * own
    return mean + own * apart, variance * own2 + (_ONE - own2) * noise
