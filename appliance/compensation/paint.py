"""Owns how bright each surface element is under full light: from Gray images, followed to where the element was.

A Gray image shows every element either full light or none, and the motion says which. So it tells paint without asking for
a phase: what the sines need when a point that moves along with the fringes sees nearly the same phase in all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.grays import Stripes, lit_there, stripes_of
from appliance.compensation.lookup import at, smooth, spread
from appliance.compensation.solve import BRIGHT, FIRST_GRAY, Sources, Terms
from appliance.compensation.ways import FIRST_WAY, P_OF_T, PER_FRAME, Q_OF_T, Ways
from appliance.patterns.sequence import Direction, PatternSequence

Picture = NDArray[np.float32]

CLEAR_PX = 3.0
"""From a stripe's border in the pattern: defocus and what moves during an exposure blur it."""
NEAR_IMAGES = 4
"""Of the Gray images before the x-sines and after them are asked first: the farther, the less their place is known."""
ENOUGH = np.float32(3.0)
"""So many images make the others needless."""
FAR_WEIGHT = np.float32(0.25)
EVEN_PX, NEAR_PX, VEIL_PX = 5, 15, 31
"""Windows in px of pictures 800 px wide."""
FILLED_SD = 0.03
"""Of the paint, as a share, where only its neighbours' is known."""
PLACE_PX = 0.05
"""By so much, in px of pictures 800 px wide, paint may lie elsewhere than the motion says."""
LOOKED_UP = 0.23
"""Variance of a value read between pixels, in the mean."""
_NAN, _ZERO, _ONE = np.float32(np.nan), np.float32(0.0), np.float32(1.0)


class Asked(NamedTuple):
    """Images that are asked for paint, in the order in which they are."""

    stripes: Stripes
    """Axis −1: lit everywhere."""
    places: NDArray[np.int64]
    """Of them among what is followed."""
    near: int
    """So many are always asked, the others only where those say too little."""


class Gathered(NamedTuple):
    """Means (h, w) of what was asked, and of how many images; NaN and 0 where none tells."""

    lit: Picture
    lit_count: Picture
    dark: Picture
    dark_count: Picture


def asked_images(sequence: PatternSequence) -> Asked:
    """The Gray images around the x-sines, then the others by their distance in time, then the bright frame."""
    every, sines = stripes_of(sequence, 0.0), sequence.axis(Direction.X).sine
    away = np.maximum(sines[0] - every.frames, every.frames - sines[-1])
    order = np.argsort(away, kind="stable")
    stripes = Stripes(
        np.append(every.frames[order], sequence.bright), np.append(every.axes[order], -1),
        np.append(every.widths_px[order], 1.0),
    )  # fmt: skip
    places = np.append(FIRST_GRAY + order, BRIGHT).astype(np.int64)
    return Asked(stripes, places, int(np.count_nonzero(away <= NEAR_IMAGES)))


def with_paint(
    sequence: PatternSequence, sources: Sources, terms: Terms, way: Ways, place_px: float, stride: int = 1
) -> Sources:
    """``sources`` with the paint of what is at its rough depth, which may lie ``place_px`` beside; of every ``stride``-th row
    alone, for those near it too: a row knows nothing of its neighbours then, and windows are so much higher."""
    height, width = sources.p_px.shape
    rows = -(-height // stride)
    gathered = Gathered(*(np.empty((rows, width), np.float32) for _ in range(4)))
    gather(sources.frames, asked_images(sequence), way, sources.rough, terms.period_px, 0, height, stride, gathered)
    veil = np.nan_to_num(known_smooth(gathered.dark, _window(VEIL_PX, width)))
    full_dn2 = terms.dark_dn2 + terms.shot_dn * np.maximum(gathered.lit, _ZERO)
    noise_dn2 = np.asarray(LOOKED_UP * full_dn2 / np.maximum(gathered.lit_count, _ONE), np.float32)
    even_px = _window(EVEN_PX, width)
    paint, variance = evened(gathered.lit - veil, noise_dn2, even_px)
    near = known_smooth(known_smooth(paint, even_px), _window(NEAR_PX, width))
    unseen = ~np.isfinite(paint)
    paint = np.where(unseen, near, paint)
    variance = np.where(unseen, np.float32(FILLED_SD**2) * near**2, variance)
    slopes = np.gradient(paint, stride, 1) if stride > 1 else np.gradient(paint)
    uneven = sum(np.asarray(one, np.float32) ** 2 for one in slopes)
    misplaced = np.float32((PLACE_PX * width / 800.0) ** 2 + place_px**2) * uneven
    # Beside what is not known, the slope is not either.
    doubt_dn2 = np.asarray(np.where(np.isfinite(misplaced), variance + misplaced, 2.0 * variance), np.float32)
    if stride > 1:
        paint, veil, doubt_dn2 = (np.repeat(one, stride, axis=0)[:height] for one in (paint, veil, doubt_dn2))
    return sources._replace(paint=paint, veil=veil, doubt_dn2=doubt_dn2)


def _window(px: int, width: int) -> int:
    """In this picture's px; odd."""
    return 2 * round(0.5 * px * width / 800.0) + 1


@numba.njit(nogil=True, cache=True, error_model="numpy")
def gather(
    frames: NDArray[np.uint8], asked: Asked, ways: Ways, depth: Picture, period_px: np.float32, start: int, stop: int,
    stride: int, gathered: Gathered,
) -> None:  # fmt: skip
    """Ask for every ``stride``-th row from ``start`` to ``stop`` − 1 of pixels at ``depth`` (t), into one row of ``gathered``
    each."""
    stripes, places, near = asked
    lit, lit_count, dark, dark_count = gathered
    height, width = depth.shape
    nodes, step = ways.nodes, ways.step_px
    count = nodes.shape[2]
    pixels = frames.reshape(frames.size)
    upper = np.empty((nodes.shape[1], count), np.float32)
    c = np.empty(count, np.float32)
    for row in range(start, stop, stride):
        spread(nodes, step, row, upper)
        line = (row - start) // stride
        for x in range(width):
            lit[line, x], dark[line, x] = _NAN, _NAN
            lit_count[line, x], dark_count[line, x] = _ZERO, _ZERO
            t = depth[row, x]
            if not (abs(t) < 2.5):
                continue
            i = x // step
            part = np.float32((x - i * step) / step)
            for k in range(count):
                c[k] = upper[i, k] + part * (upper[i + 1, k] - upper[i, k])
            p, q = at(c, P_OF_T, t) + np.float32(0.5), at(c, Q_OF_T, t) + np.float32(0.5)
            bright, dim, weights, squares, dims = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            for m in range(places.size):
                if m >= near and weights >= ENOUGH:
                    break
                way = FIRST_WAY + PER_FRAME * places[m]
                u, v = np.float32(x) + at(c, way, t), np.float32(row) + at(c, way + 3, t)
                if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
                    continue
                light = 1
                if stripes.axes[m] >= 0:
                    shown = (p if stripes.axes[m] == 0 else q) + period_px * at(c, way + 6, t)
                    light = lit_there(float(shown), stripes.widths_px[m], CLEAR_PX)
                if light < 0 or (light == 0 and m >= near):
                    continue
                grey = smooth(pixels, stripes.frames[m] * (height * width), width, u, v)
                if grey != grey:
                    continue
                if light == 1:
                    weight = _ONE if m < near else FAR_WEIGHT
                    bright += weight * grey
                    weights += weight
                    squares += weight * weight
                else:
                    dim += grey
                    dims += _ONE
            if weights > _ZERO:
                lit[line, x], lit_count[line, x] = bright / weights, weights * weights / squares
            if dims > _ZERO:
                dark[line, x], dark_count[line, x] = dim / dims, dims


def known_smooth(values: Picture, window_px: int) -> Picture:
    """Mean of what is known around each pixel; NaN where nothing is."""
    known = np.isfinite(values)
    share = cv2.boxFilter(known.astype(np.float32), -1, (window_px, window_px))
    total = cv2.boxFilter(np.where(known, values, np.float32(0.0)), -1, (window_px, window_px))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(share > 1e-6, total / share, _NAN), np.float32)


def evened(grey: Picture, variance: Picture, window_px: int) -> tuple[Picture, Picture]:
    """``grey`` with noise of ``variance`` taken out where it varies no more than that, and the variance that is left.

    The local-statistics filter: J.-S. Lee, IEEE PAMI 2 (1980) 165.
    """
    mean = known_smooth(grey, window_px)
    around = known_smooth((grey - mean) ** 2, window_px)
    noise = known_smooth(variance, window_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.clip(1.0 - 1.5 * noise / around, 0.0, 1.0).astype(np.float32)
    return mean + own * (grey - mean), variance * own**2 + (1 - own**2) * noise / window_px**2
