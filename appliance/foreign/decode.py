"""Owns decoding by a description: one camera's images become pattern coordinates, modulation, and reasons where there are none.

Two steps, so that other conventions can be tried on the same images: ``measure`` reads from the images what no convention changes
but the phase steps, ``place`` makes coordinates of it.

Symbols: P is the finest period, turns its phase φ/2π, m the middle of a stripe in periods, off = turns − start − m wrapped to −½ … ½; the
coordinate is p = P (m + off) − ½, which is right at any phase as long as the stripe is at most a period wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.foreign.code import CodeBits, numbered_stripes, read_bits
from appliance.foreign.description import AxisConvention
from appliance.foreign.images import ImageSet
from appliance.foreign.order import Shows
from appliance.foreign.phase import Floats, SineFit, fit_sine

LEAST_MODULATION, MOST_LEAST_MODULATION = 1.0 / 255.0, 5.0 / 255.0
"""Least modulation of a pixel that is used, as a share of full scale: so many ``NOISE_SIGMAS`` of its noise, within these."""
NOISE_SIGMAS = 6.0
LEAST_CONTRAST = 4.0 / 255.0
"""Least swing of a code without sines, as a share of full scale."""
SLACK_PERIODS = 0.11
"""Allowed distance of the phase beyond the border of its stripe, in periods: blur and noise."""
UNSURE_PERIODS = 0.36
"""Distance from the stripe's middle beyond which a stripe of a whole period is a coin's toss, and the neighbours are asked."""
MAX_PERIODS_MISFIT = 0.09
"""Largest disagreement of the phases of several periods, as root mean square in turns."""
FRINGES_AT_MOST = 4096
DRAWN = 0.008
"""Error of a coordinate between two borders of a stripe, as a share of it: measured on rendered sets with stripes of 4 and 8 px."""
MOST_SKIPPED = 2
"""Largest change of a stripe's number at a border that a coordinate is drawn from: one stripe in between may be too narrow to be seen."""


class NoCoordinate(IntEnum):
    """Reason why a pixel has no coordinate; the first that applies."""

    VALID = 0
    SATURATED = 1
    WEAK = 2
    """Too little modulation, or contrast."""
    CONTRADICTION = 3
    """The parts of the code contradict each other, or the coordinate lies beyond the pattern."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Evidence of the images of one direction, whatever a convention makes of it."""

    fits: tuple[SineFit, ...]
    """Fit of each period; empty for a code alone."""
    bits: CodeBits | None
    weak: NDArray[np.bool_]
    """(h, w): too dark to be used."""
    saturated: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class PlacedAxis:
    """Coordinates of one direction."""

    coordinate_px: Floats
    """(h, w) float32, NaN where ``reason`` says why."""
    reason: NDArray[np.uint8]
    """(h, w), values of ``NoCoordinate``."""
    modulation: Floats
    """(h, w): in grey values; of a code alone, half of its contrast."""
    stripe_px: float = 0.0
    """Width of the stripes between whose borders coordinates were drawn; 0: fringes make them."""


def measure(images: ImageSet, axis: AxisConvention) -> Measured:
    """Read the images of one direction. Raises ForeignError."""
    fits = []
    for period, steps_deg in enumerate(axis.signed_deg):
        sines = [images.image(Shows.SINE, axis.name, k, period) for k in range(len(steps_deg))]
        fits.append(fit_sine([one for one in sines if one is not None], steps_deg, images.white))
    bits = read_bits(images, axis, fits[0].offset if fits else None) if axis.bits else None
    saturated = np.zeros(images.shape, np.bool_)
    if fits:
        for fit in fits:
            saturated |= fit.saturated
        modulation = np.minimum.reduce([fit.modulation for fit in fits])
        weak = modulation < least_modulation(fits[axis.finest], len(axis.steps_deg[axis.finest]), images.white)
    else:
        assert bits is not None
        weak = bits.contrast < LEAST_CONTRAST * images.white
    return Measured(tuple(fits), bits, weak, saturated)


def least_modulation(fit: SineFit, steps: int, white: float) -> float:
    """Return the least modulation that tells a phase, in grey values: ``NOISE_SIGMAS`` of its noise."""
    if fit.misfit is None:
        return 0.6 * MOST_LEAST_MODULATION * white
    # Where there is next to no light the misfit is the camera's own noise, and none of the projector's response.
    dim = fit.misfit[fit.modulation <= np.quantile(fit.modulation[::7, ::7], 0.3)]
    noise = float(np.median(dim)) if dim.size else 0.0
    wanted = NOISE_SIGMAS * noise * (2.0 / steps) ** 0.5
    return float(min(max(wanted, LEAST_MODULATION * white), MOST_LEAST_MODULATION * white))


def place(found: Measured, axis: AxisConvention, *, repaired: bool = True) -> PlacedAxis:
    """Make coordinates by the convention of ``axis``; ``repaired``: borders of wide stripes ask their neighbours."""
    reason = np.zeros(found.weak.shape, np.uint8)
    stripe_px = 0.0
    if not found.fits:
        coordinate_px, contradiction, stripe_px = _by_code_alone(found, axis)
        assert found.bits is not None
        modulation = np.float32(0.5) * found.bits.contrast
    else:
        modulation = found.fits[axis.finest].modulation
        dark = found.weak | found.saturated
        if found.bits is not None:
            coordinate_px, contradiction = _by_code(found, axis, ~dark, repaired)
        else:
            coordinate_px, misfit = by_periods(found, axis)
            contradiction = misfit > min(MAX_PERIODS_MISFIT, chance_misfit(axis))
    with np.errstate(invalid="ignore"):
        outside = (coordinate_px < -0.5 - 0.25 * axis.period_px) | (
            coordinate_px > axis.size_px - 0.5 + 0.25 * axis.period_px
        )
    reason[contradiction | outside | np.isnan(coordinate_px)] = NoCoordinate.CONTRADICTION
    reason[found.weak] = NoCoordinate.WEAK
    reason[found.saturated] = NoCoordinate.SATURATED
    coordinate_px[reason != NoCoordinate.VALID] = np.nan
    return PlacedAxis(coordinate_px, reason, modulation, stripe_px)


def offset_periods(found: Measured, axis: AxisConvention) -> tuple[Floats, Floats, float]:
    """Return the middle m of each pixel's stripe in periods; off, its phase less that middle, −½ … ½; the stripes' width in px."""
    assert found.bits is not None
    number, stripe_px = numbered_stripes(found.bits.bits, found.bits.left_out, axis)
    middle = ((number + np.float32(0.5)) * np.float32(stripe_px) + np.float32(axis.code_offset_px)) / np.float32(
        axis.period_px
    )
    off = found.fits[axis.finest].turns - np.float32(axis.begins_deg[axis.finest] / 360.0) - middle
    off -= np.floor(off + np.float32(0.5))
    return middle, off, stripe_px


def _by_code(
    found: Measured, axis: AxisConvention, usable: NDArray[np.bool_], repaired: bool
) -> tuple[Floats, NDArray[np.bool_]]:
    middle, off, stripe_px = offset_periods(found, axis)
    period = np.float32(axis.period_px)
    coordinate_px = period * (middle + off) - np.float32(0.5)
    limit = 0.5 * stripe_px / axis.period_px + SLACK_PERIODS
    if limit < 0.5 - 0.3 * SLACK_PERIODS:
        return coordinate_px, np.abs(off) > limit
    if not repaired:
        return coordinate_px, np.zeros(off.shape, np.bool_)
    # A stripe as wide as a period: near its borders, a bit and a phase that disagree by a pixel are a whole period apart.
    sure = usable & (np.abs(off) < UNSURE_PERIODS)
    return _asked_neighbours(coordinate_px, sure, axis)


def _asked_neighbours(
    coordinate_px: Floats, sure: NDArray[np.bool_], axis: AxisConvention
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the coordinates, those that are not ``sure`` moved by whole periods to the mean of the sure ones about them."""
    period = np.float32(axis.period_px)
    width = stripe_width(coordinate_px, sure, axis)
    size = (2 * int(width * 0.6) + 3, 3) if axis.name == "x" else (3, 2 * int(width * 0.6) + 3)
    known = sure.astype(np.float32)
    count = cv2.boxFilter(known, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(
        np.where(sure, coordinate_px, np.float32(0.0)), -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    mean = total / np.maximum(count, np.float32(1.0))
    away = np.rint((mean - coordinate_px) / period)
    moved = np.where(sure, coordinate_px, coordinate_px + period * away)
    lost = ~sure & ((count < 3.0) | (np.abs(moved - mean) > np.float32(0.45) * period))
    return np.asarray(moved, np.float32), np.asarray(lost)


def stripe_width(coordinate_px: Floats, usable: NDArray[np.bool_], axis: AxisConvention) -> float:
    """Return the usual width of a period in the camera's image, in px: 2 where nothing tells."""
    along = 1 if axis.name == "x" else 0
    step = np.abs(np.diff(coordinate_px, axis=along))
    both = usable[:, 1:] & usable[:, :-1] if along else usable[1:] & usable[:-1]
    steps = step[both]
    usual = float(np.median(steps)) if steps.size else 0.0
    return min(max(axis.period_px / usual if usual > 1e-3 else 2.0, 2.0), 400.0)


def by_periods(found: Measured, axis: AxisConvention) -> tuple[Floats, Floats]:
    """Choose the number of the finest fringe with which the phases of all other periods agree best (temporal unwrapping).

    Returns the coordinates (h, w) in px, and the root mean square by which those phases disagree, in turns.
    """
    period = axis.period_px
    starts = [np.float32(begin / 360.0) for begin in axis.begins_deg]
    turns = found.fits[axis.finest].turns - starts[axis.finest]
    others = [
        (fit.turns - start, other)
        for k, (fit, start, other) in enumerate(zip(found.fits, starts, axis.periods_px, strict=True))
        if k != axis.finest
    ]
    best = np.full(turns.shape, np.inf, np.float32)
    coordinate_px = np.full(turns.shape, np.nan, np.float32)
    first = turns - np.floor(turns)
    for fringe in range(_fringes(axis)):
        edge_px = np.float32(period) * (first + np.float32(fringe))
        misfit = np.zeros(turns.shape, np.float32)
        for other_turns, other in others:
            off = edge_px / np.float32(other) - other_turns
            off -= np.rint(off)
            misfit += np.square(off)
        better = misfit < best
        best = np.where(better, misfit, best)
        coordinate_px = np.where(better, edge_px - np.float32(0.5), coordinate_px)
    return coordinate_px, np.asarray(np.sqrt(best / np.float32(max(1, len(others)))), np.float32)


def chance_misfit(axis: AxisConvention) -> float:
    """Return the median of what ``by_periods`` leaves of phases that have nothing to do with each other, in turns.

    The m other phases disagree by a place in a cube of side 1; the best of K fringes is nearer to its middle than r with probability
    1 − (1 − V r^m)^K, V being the volume of the unit ball.
    """
    others = len(axis.periods_px) - 1
    if others < 1:
        return 0.5
    volume = math.pi ** (0.5 * others) / math.gamma(0.5 * others + 1.0)
    radius = (math.log(2.0) / (_fringes(axis) * volume)) ** (1.0 / others)
    return float(min(radius / math.sqrt(others), 0.25))


def _fringes(axis: AxisConvention) -> int:
    """Return how many of the finest fringes the pattern has."""
    return min(math.ceil(axis.size_px / axis.period_px) + 1, FRINGES_AT_MOST)


def _by_code_alone(found: Measured, axis: AxisConvention) -> tuple[Floats, NDArray[np.bool_], float]:
    """Return coordinates of a code without sines: between two borders of stripes along the image, linear; else the stripe's middle.

    Besides, what contradicts (nothing does) and the stripes' width in px.
    """
    code = found.bits
    assert code is not None
    assert code.borders is not None
    number, stripe_px = numbered_stripes(code.bits, code.left_out, axis)
    turned = axis.name == "y"
    rows = np.ascontiguousarray(number.T if turned else number)
    usable = np.ascontiguousarray(~found.weak.T if turned else ~found.weak)
    width = rows.shape[1]
    place = np.broadcast_to(np.arange(width), rows.shape)
    changed = np.ones((rows.shape[0], width + 1), np.bool_)
    changed[:, 1:-1] = (rows[:, 1:] != rows[:, :-1]) | (usable[:, 1:] != usable[:, :-1])
    # First and last pixel of the run of one stripe that each pixel lies in.
    first = np.maximum.accumulate(np.where(changed[:, :-1], place, 0), axis=1)
    last = np.minimum.accumulate(np.where(changed[:, 1:], place, width - 1)[:, ::-1], axis=1)[:, ::-1]
    before = np.take_along_axis(rows, np.maximum(first - 1, 0), 1) - rows
    behind = np.take_along_axis(rows, np.minimum(last + 1, width - 1), 1) - rows
    # Between stripes i and i + 1 lies the border i + 1; where one is too narrow to be seen, i and i + 2, it is the middle of both.
    begin = first - 1 + np.take_along_axis(code.borders, np.clip(first - 1, 0, width - 2), 1)
    end = last + np.take_along_axis(code.borders, np.clip(last, 0, width - 2), 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        known = usable & (before * behind < 0) & (np.abs(before) <= MOST_SKIPPED) & (np.abs(behind) <= MOST_SKIPPED)
        share = np.clip((place - begin) / (end - begin), 0.0, 1.0)
        within = np.float32(0.5) + np.float32(0.5) * (before + share * (behind - before))
        within = np.where(known & np.isfinite(within), within, np.float32(0.5))
    along_px = (rows + within) * np.float32(stripe_px)
    found_px = np.asarray(along_px.T if turned else along_px, np.float32)
    coordinate_px = np.ascontiguousarray(found_px) + np.float32(axis.code_offset_px - 0.5)
    return coordinate_px, np.zeros(number.shape, np.bool_), stripe_px
