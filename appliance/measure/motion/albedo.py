"""Owns how bright each surface element is under full light: its albedo, from Gray images, read where the element was.

A Gray image shows every element either full light or none, and the motion says which. So it tells the albedo without
asking for a phase: what the sines need when a point that moves along with the fringes sees nearly the same phase in all
of them. With the albedo known, the offset of the four sines is known but for the albedo's noise, and four values within
90° tell the phase nearly as well as four around the circle. The Gray images around the x-sines tell it; those in which
an element was dark tell what the water and the surroundings send: the backscatter.

Legend of the kernel, per pixel number i of a list, in column x of its row::

    t          depth
    p, q       place in the pattern that lights the pixel at the reference time
    m          number of a Gray image, in the order in which they are asked
    bright, weights, squares   Σ w y, Σ w, Σ w² over the images that lit it
    dim, dims                  Σ y and their number over those that did not
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
    P_OF_T,
    Q_OF_T,
    DisplacementField,
    interpolate_row,
)
from appliance.measure.motion.phase_solver import BRIGHT, FIRST_GRAY, MAX_T, Sources, Terms
from appliance.measure.motion.row_reader import Pictures, locate, parabola_row, places_in_frame, read_row
from appliance.measure.motion.stripes import Stripes, illuminated_at, stripes_of

Map = NDArray[np.float32]

CLEAR_PX = 3.0
"""Nearer to a stripe's border in the pattern nothing is read: defocus and motion during an exposure blur it."""
NEAR_IMAGES = 4
"""Gray images so near to the x-sines, before and after, come first: the farther, the less the element's place is known.
"""
ENOUGH = np.float32(3.0)
"""Weight of the images from which on the others are needless."""
FAR_WEIGHT = np.float32(0.25)
"""Weight of the other images."""
EVEN_PX, NEAR_PX, BACKSCATTER_PX = 5, 20, 31
"""Windows in px of pictures 800 px wide: over which noise is taken out, gaps are filled, and the backscatter is
smoothed."""
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
    """Mean grey values (h, w) of an element when it was lit and when it was dark, and of how many images; NaN and 0: of
    none."""

    lit: Map
    lit_count: Map
    dark: Map
    dark_count: Map


def gray_images(sequence: PatternSequence) -> GrayImages:
    """Return the Gray images around the x-sines, then the others by their distance in time, then the bright frame."""
    every, x_axis = stripes_of(sequence), sequence.axis(Direction.X)
    away = np.maximum(min(x_axis.sine) - every.frames, every.frames - x_axis.last)
    order = np.argsort(away, kind="stable")
    stripes = Stripes(
        np.append(every.frames[order], sequence.bright),
        np.append(every.axes[order], -1),
        np.append(every.widths_px[order], 1.0),
    )
    places = np.append(FIRST_GRAY + order, BRIGHT).astype(np.int64)
    return GrayImages(stripes, places, int(np.count_nonzero(away <= NEAR_IMAGES)))


def with_albedo(
    sequence: PatternSequence,
    sources: Sources,
    terms: Terms,
    field: DisplacementField,
    lateral_sd_px: float,
    stride: int = 1,
) -> Sources:
    """Return ``sources`` with the albedo of what is at its rough depth, which may lie ``lateral_sd_px`` beside its
    place.

    With a ``stride``, only every so many rows are read and serve their neighbours, too: a row knows nothing of those
    between then, and windows are so much higher.
    """
    height, width = sources.p_px.shape
    rows = -(-height // stride)
    means = GrayMeans(*(np.empty((rows, width), np.float32) for _ in range(4)))
    gather(sources.frames, gray_images(sequence), field, sources.rough_t, terms.period_px, stride, means)
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
    # On a slope of albedo, an uncertain place is an uncertain albedo; beside what is not known, the slope is not
    # either.
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
    frames: NDArray[np.uint8],
    images: GrayImages,
    field: DisplacementField,
    depth: Map,
    period_px: np.float32,
    stride: int,
    means: GrayMeans,
) -> None:
    """Read every ``stride``-th row of pixels at ``depth`` (h, w) in t, one row of ``means`` each.

    A pixel without a depth, or in no image, has neither albedo nor backscatter.
    """
    stripes, places, near = images
    (height, width), (_, nodes, coefficients) = depth.shape, field.nodes.shape
    pictures = Pictures(frames.reshape(frames.size), stripes.frames * (height * width), height, width)
    at_row = np.empty((nodes, coefficients), np.float32)
    share, begins = np.empty(width, np.float32), np.empty(nodes, np.int64)
    column, cell, light = np.empty(width, np.int32), np.empty(width, np.int32), np.empty(width, np.int32)
    # Per pixel of the list: depth, places in the pattern and in the image, grey value, and the sums so far.
    rows = np.empty((12, width), np.float32)
    t, p, q, shown, u, v, grey = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6]
    bright, weights, squares, dim, dims = rows[7], rows[8], rows[9], rows[10], rows[11]
    for row in range(0, height, stride):
        interpolate_row(field.nodes, field.step_px, row, at_row)
        n, line = _NONE, row // stride
        for x in range(width):
            means.lit[line, x], means.lit_count[line, x] = _NAN, _ZERO
            means.dark[line, x], means.dark_count[line, x] = _NAN, _ZERO
            if abs(depth[row, x]) < MAX_T:
                column[n], t[n] = x, depth[row, x]
                bright[n], weights[n], squares[n], dim[n], dims[n] = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
                n += 1
        chosen = locate(column[:n], field.step_px, share, begins)
        # Where the projector lights them at the reference time: (p, q)(t).
        parabola_row(at_row, chosen, _P, t[:n], p[:n])
        parabola_row(at_row, chosen, _Q, t[:n], q[:n])
        for m in range(places.size):
            if m >= near:
                # The images farther off are asked only until there is enough.
                left = _NONE
                for i in range(n):
                    if weights[i] >= ENOUGH:
                        _mean(means, line, column[i], bright[i], weights[i], squares[i], dim[i], dims[i])
                        continue
                    column[left] = column[i]
                    for k in range(rows.shape[0]):
                        rows[k, left] = rows[k, i]
                    left += 1
                n, chosen = left, locate(column[:left], field.step_px, share, begins)
            if n == 0:
                break
            # Where the points were in this image, and by how many periods the pattern moved on them.
            at = FIRST_FRAME + FRAME_COEFFICIENTS * places[m]
            parabola_row(at_row, chosen, at + OF_PHASE, t[:n], shown[:n])
            places_in_frame(at_row, chosen, at, row, t[:n], u[:n], v[:n])
            read_row(pictures, m, u[:n], v[:n], cell, grey[:n])
            place_px = p if stripes.axes[m] == 0 else q
            for i in range(n):
                shown_px = float((place_px[i] + _HALF) + period_px * shown[i])
                light[i] = illuminated_at(shown_px, stripes.widths_px[m], CLEAR_PX) if stripes.axes[m] >= 0 else 1
            # Those farther off count with less weight, for the place is known less well, and tell nothing of the
            # backscatter.
            weight = _ONE if m < near else FAR_WEIGHT
            dark_weight = _ONE if m < near else _ZERO
            for i in range(n):
                known = grey[i] == grey[i]
                is_lit, is_dark = known & (light[i] == 1), known & (light[i] == 0)
                # Σ w y, Σ w and Σ w² of what was lit, sum and number of what was dark.
                bright[i] += weight * grey[i] if is_lit else _ZERO
                weights[i] += weight if is_lit else _ZERO
                squares[i] += weight * weight if is_lit else _ZERO
                dim[i] += dark_weight * grey[i] if is_dark else _ZERO
                dims[i] += dark_weight if is_dark else _ZERO
        for i in range(n):
            _mean(means, line, column[i], bright[i], weights[i], squares[i], dim[i], dims[i])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _mean(
    means: GrayMeans,
    line: int,
    x: int,
    bright: np.float32,
    weights: np.float32,
    squares: np.float32,
    dim: np.float32,
    dims: np.float32,
) -> None:
    """Write one pixel's means of its sums; NaN where there is nothing to add up."""
    if weights > _ZERO:
        # A weighted mean has the noise of (Σ w)² / Σ w² images.
        means.lit[line, x], means.lit_count[line, x] = bright / weights, weights * weights / squares
    if dims > _ZERO:
        means.dark[line, x] = dim / dims
    means.dark_count[line, x] = dims


def known_mean(values: Map, window_px: int) -> Map:
    """Return the mean (h, w) of what is known within ``window_px`` around each pixel of ``values``; NaN where nothing
    is."""
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
    """Return ``grey`` (h, w) without noise of ``variance`` where it varies no more than that, and the variance that is
    left.

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
