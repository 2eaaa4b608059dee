"""Decoding by a description: from one camera's images to pattern coordinates and mask reasons.

Two steps, so that other conventions can be tried on the same images: ``measure`` reads from the images all that no
convention changes but the phase steps, ``place`` makes coordinates of it.

Symbols: P is the finest period, turns its phase φ/2π, m the middle of a stripe in periods, off = turns − start − m
wrapped to −½ … ½; the coordinate is p = P (m + off) − ½, which is right at any phase as long as the stripe is at most a
period wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.code import LINES_AT_ONCE, CodeBits, read_bits
from appliance.desk.foreign.description import AxisConvention, equal_steps
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import Shows
from appliance.desk.foreign.phase import (
    ROWS_AT_ONCE,
    TURN,
    Floats,
    SineFit,
    correct_response,
    fit_sine,
    misfit_samples,
    misfit_share,
    some_pixels,
)
from appliance.measure import choose_fringes

LEAST_MODULATION, MAX_LEAST_MODULATION = 1.0 / 255.0, 5.0 / 255.0
"""Limits of the least modulation of a used pixel, as a share of full scale; between them, ``NOISE_SIGMAS`` of its noise
count."""
NOISE_SIGMAS = 6.0
LEAST_CONTRAST = 4.0 / 255.0
"""Least swing of a code without sines, as a share of full scale."""
SLACK_PERIODS = 0.11
"""Allowed distance of the phase beyond the border of its stripe, in periods: blur and noise."""
UNSURE_PERIODS = 0.36
"""Distance from the middle of a stripe, in periods, beyond which a stripe of a whole period is ambiguous, and neighbours
decide."""
MAX_PERIODS_MISFIT = 0.09
"""Largest disagreement of the phases of several periods, as root mean square in turns."""
PIXELS_AT_ONCE = 1 << 13
"""Pixels that are processed together, so that they stay in the cache."""
MOST_FINER = 0.35
"""Largest disagreement of a period with the next finer one, in turns of that."""
BORDER_ERROR = 0.008
"""Error of a coordinate between two stripe borders, over the stripe's width: measured on rendered sets with stripes of
4 and 8 px."""
MOST_SKIPPED = 2
"""Largest change of the stripe number at a border that is interpolated from: one stripe in between may be too narrow to
be seen."""


GAP_PIXELS, SIGMA_PIXELS = 2.5, 5.0
"""Largest ray gap and expected error of a point, over the size of a pixel on the object there."""
_GAP = f"rays pass each other by more than {GAP_PIXELS:g} pixels; check the cameras' numbers, [water] and [ports]"
_SIGMA = f"the standard deviation exceeds {SIGMA_PIXELS:g} pixels on the object; range.max_sigma_mm sets another limit"


class Reason(IntEnum):
    """Mask reason: the first that applies to a left pixel without a point, with its colour."""

    text: str
    """Meaning, with the remedy."""
    colour: tuple[int, int, int]

    def __new__(cls, value: int, text: str, *colour: int) -> Reason:
        reason = int.__new__(cls, value)
        reason._value_, reason.text = value, text
        red, green, blue = colour
        reason.colour = red, green, blue
        return reason

    FOUND = 0, "a point", 128, 128, 128
    SATURATED = 1, "saturated in some image", 255, 255, 0
    WEAK = 2, "too little light or contrast", 16, 16, 72
    CONTRADICTION = 3, "the parts of the code contradict each other", 214, 39, 40
    OUTSIDE = 4, "beyond the pattern, whose size is in [projector], [x] and [y]", 148, 103, 189
    NO_RAY = 5, "the lens model is not invertible there", 140, 86, 75
    NO_MATCH = 6, "the other side has no such coordinate along the pixel's ray", 31, 119, 180
    GAP = 7, _GAP, 255, 127, 14
    SIGMA = 8, _SIGMA, 44, 160, 44
    DEPTH = 9, "outside range.near_mm to range.far_mm", 23, 190, 207
    NEIGHBOURS = 10, "a depth discontinuity, or without neighbours", 227, 119, 194

    @property
    def word(self) -> str:
        """The reason's name in reports."""
        return self.name.lower().replace("_", "-")


@dataclass(frozen=True, slots=True, eq=False)
class AxisMeasurement:
    """Phases, bits and masks of one direction, which do not depend on the convention."""

    turns: tuple[Floats, ...]
    """Phase (h, w) of each period, −½ … ½; empty for a code alone. Of micro phase shifting, the first period's alone."""
    modulation: Floats
    """Modulation (h, w) of the finest period in grey values; of a code alone, half of its contrast."""
    mean: NDArray[Any] | None
    """Mean (h, w) of the first period's steps, in grey values; ``None`` for a code alone."""
    bits: CodeBits | None
    weak: NDArray[np.bool_]
    """True (h, w) where it is too dark."""
    saturated: NDArray[np.bool_]
    singles: tuple[Floats, ...] = ()
    """Cosine (h, w) of each further period of micro phase shifting, which has one image."""
    sines: tuple[NDArray[Any], ...] = ()
    """Grey values (n, pixels) of each period's sine frames at some pixels; none where they are micro or modulated."""
    misfit_share: float | None = None
    """Misfit of the finest period's steps, over its modulation; ``None`` with up to three steps, which always fit."""
    bend_turns: float = 0.0
    """Standard deviation of that period's phase by the ripple that remains of a non-linear response."""

    @property
    def usable(self) -> NDArray[np.bool_]:
        """(h, w): neither too dark nor white."""
        return ~(self.weak | self.saturated)


@dataclass(frozen=True, slots=True, eq=False)
class AxisCoordinates:
    """Pattern coordinates of one direction."""

    coordinate_px: Floats
    """(h, w) float32, NaN where ``reason`` says why."""
    reason: NDArray[np.uint8]
    """(h, w), values of ``Reason``."""
    modulation: Floats
    """(h, w), as in ``AxisMeasurement``."""
    mean: NDArray[Any] | None = None
    """(h, w), as in ``AxisMeasurement``."""
    stripe_px: float = 0.0
    """Width of the stripes between whose borders coordinates are interpolated; 0: fringes make them."""
    bend_px: float = 0.0
    """Standard deviation that a non-linear response adds to the noise."""


def measure(images: ImageSet, axis: AxisConvention) -> AxisMeasurement:
    """Measure one direction of one camera's images. Raises ForeignError."""
    turns: list[Floats] = []
    samples: list[tuple[Floats, Floats] | None] = []
    singles: list[Floats] = []
    sines: list[NDArray[Any]] = []
    offset: Floats | None = None
    for period, steps_deg in enumerate(axis.signed_deg[:1] if axis.micro else axis.signed_deg):
        across = axis.carriers[period] if axis.carriers else 0
        kind = Shows.MICRO if axis.micro else Shows.MODULATED if across else Shows.SINE
        frames = images.all_of(kind, axis.name, period)
        fit = (
            _fit_modulated(frames, steps_deg, across, images.white)
            if across
            else fit_sine(frames[: len(steps_deg)], steps_deg, images.white)
        )
        if axis.micro:
            modulation = np.maximum(fit.modulation, np.float32(1e-3))
            singles = [np.asarray((frame - fit.offset) / modulation, np.float32) for frame in frames[len(steps_deg) :]]
        if period == axis.finest:
            finest = fit.modulation
            least_dn = least_modulation(fit, len(axis.steps_deg[period]), images.white)
        if not turns:
            mean = np.rint(fit.offset).astype(images.images.dtype)
            offset = fit.offset if axis.bits else None
            lowest, saturated = fit.modulation, fit.saturated
        else:
            lowest, saturated = np.minimum(lowest, fit.modulation), saturated | fit.saturated
        turns.append(fit.turns)
        samples.append(misfit_samples(fit))
        sines.append(some_pixels(frames) if kind is Shows.SINE else np.empty((0, 0)))
        # Free them before the next frames and the code are read: both at once are a third of all memory.
        del frames, fit
    bits = read_bits(images, axis, offset) if axis.bits else None
    if not turns:
        assert bits is not None
        weak, no_pixel = bits.contrast < LEAST_CONTRAST * images.white, np.zeros(images.shape, np.bool_)
        return AxisMeasurement((), np.float32(0.5) * bits.contrast, None, bits, weak, no_pixel)
    weak = lowest < least_dn
    usable = ~(weak | saturated)
    shares = [misfit_share(sample, usable) for sample in samples]
    bends = [
        correct_response(phase, usable, len(steps_deg), share)
        for phase, steps_deg, share in zip(turns, axis.steps_deg, shares, strict=False)
    ]
    return AxisMeasurement(
        tuple(turns), finest, mean, bits, weak, saturated, tuple(singles), tuple(sines), shares[axis.finest], bends[axis.finest]
    )  # fmt: skip


def _fit_modulated(images: NDArray[Any], steps_deg: tuple[float, ...], across: int, white: float) -> SineFit:
    """Fit fringes times a carrier.

    Light that varies with the carrier's steps came straight from the projector. Source: Chen, Seidel, Lensch, CVPR 2008.
    """
    carrier_fits = [fit_sine(images[k : k + across], equal_steps(across), white) for k in range(0, len(images), across)]
    fit = fit_sine([carrier_fit.modulation for carrier_fit in carrier_fits], steps_deg, math.inf)
    return replace(fit, saturated=np.logical_or.reduce([carrier_fit.saturated for carrier_fit in carrier_fits]))


def least_modulation(fit: SineFit, steps: int, white: float) -> float:
    """Return the least modulation for a phase, in grey values: ``NOISE_SIGMAS`` of its noise."""
    if fit.misfit is None:
        return 0.6 * MAX_LEAST_MODULATION * white
    # In the dark the misfit is camera noise alone, without the projector's response.
    dim = fit.misfit[fit.modulation <= np.quantile(fit.modulation[::7, ::7], 0.3)]
    noise = float(np.median(dim)) if dim.size else 0.0
    least_dn = NOISE_SIGMAS * noise * (2.0 / steps) ** 0.5
    return float(min(max(least_dn, LEAST_MODULATION * white), MAX_LEAST_MODULATION * white))


def place(measured: AxisMeasurement, axis: AxisConvention, extent_px: tuple[float, float]) -> AxisCoordinates:
    """Return coordinates by the convention of ``axis``, on a pattern from begin to end ``extent_px``."""
    reason = np.zeros(measured.weak.shape, np.uint8)
    stripe_px = 0.0
    if not measured.turns:
        coordinate_px, stripe_px = _place_by_code_alone(measured, axis)
        contradiction = np.isnan(coordinate_px)
    elif measured.bits is not None:
        coordinate_px, contradiction = _place_by_code(measured, axis)
    else:
        coordinate_px, misfit = place_by_periods(measured.turns, axis, measured.usable, measured.singles)
        contradiction = ~(misfit <= min(MAX_PERIODS_MISFIT, chance_misfit(axis)))
    begin_px, end_px = extent_px
    beyond_px = 0.5 - 0.25 * axis.period_px
    with np.errstate(invalid="ignore"):
        outside = (coordinate_px < begin_px - 1.0 + beyond_px) | (coordinate_px > end_px - beyond_px)
    reason[outside] = Reason.OUTSIDE
    reason[contradiction] = Reason.CONTRADICTION
    reason[measured.weak] = Reason.WEAK
    reason[measured.saturated] = Reason.SATURATED
    coordinate_px[reason != Reason.FOUND] = np.nan
    return AxisCoordinates(
        coordinate_px, reason, measured.modulation, measured.mean, stripe_px, measured.bend_turns * axis.period_px
    )


def _place_by_code(measured: AxisMeasurement, axis: AxisConvention) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the coordinates, and where their parts contradict each other.

    The code numbers the fringes of one period, and that period numbers those of each finer one.
    """
    k, shape = axis.numbered, measured.weak.shape
    period, begin = np.float32(axis.periods_px[k]), np.float32(axis.begins_deg[k] / 360.0)
    assert measured.bits is not None
    coordinate_px, contradicted, sure = np.empty(shape, np.float32), np.zeros(shape, np.bool_), np.ones(shape, np.bool_)
    for first in range(0, shape[0], ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        number, stripe_px = measured.bits.numbered(axis, rows)
        middle = ((number + np.float32(0.5)) * np.float32(stripe_px) + np.float32(axis.code_offset_px)) / period
        off_turns = measured.turns[k][rows] - begin - middle
        off_turns -= np.floor(off_turns + np.float32(0.5))
        coordinate_px[rows] = period * (middle + off_turns) - np.float32(0.5)
        limit = 0.5 * stripe_px / float(period) + SLACK_PERIODS
        if limit < 0.5 - 0.3 * SLACK_PERIODS:
            contradicted[rows] = np.abs(off_turns) > limit
        else:
            sure[rows] = np.abs(off_turns) < UNSURE_PERIODS
    if axis.wraps:
        # Before neighbours decide, which lie at the same end.
        coordinate_px[coordinate_px < -0.5] += np.float32(axis.covered_px[1])
    if not sure.all():
        # A stripe as wide as a period: near its borders, a bit and a phase that disagree by a pixel are a whole period
        # apart.
        sure &= measured.usable
        coordinate_px, contradicted = _correct_by_neighbours(coordinate_px, sure, axis)
    finer = zip(axis.periods_px, measured.turns, axis.begins_deg, strict=False)
    for finer_px, turns, begin_deg in sorted(finer, key=lambda finer_period: -finer_period[0]):
        if finer_px < period:
            off_turns = turns - np.float32(begin_deg / 360.0) - (coordinate_px + np.float32(0.5)) / np.float32(finer_px)
            off_turns -= np.rint(off_turns)
            coordinate_px += off_turns * np.float32(finer_px)
            contradicted |= np.abs(off_turns) > MOST_FINER
    return coordinate_px, contradicted


def _correct_by_neighbours(
    coordinate_px: Floats, sure: NDArray[np.bool_], axis: AxisConvention
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the coordinates, with unsure ones moved by whole periods towards sure neighbours.

    The second result is true where neighbours leave a pixel ambiguous.
    """
    period = np.float32(axis.periods_px[axis.numbered])
    # The median width of a period in the camera's image.
    along = 1 if axis.name == "x" else 0
    both_sure = sure[:, 1:] & sure[:, :-1] if along else sure[1:] & sure[:-1]
    steps = np.abs(np.diff(coordinate_px, axis=along))[both_sure]
    width = min(max(float(period) / max(float(np.median(steps)), 1e-3) if steps.size else 2.0, 2.0), 400.0)
    size = (2 * int(width * 0.6) + 3, 3) if axis.name == "x" else (3, 2 * int(width * 0.6) + 3)
    weight = sure.astype(np.float32)
    count = cv2.boxFilter(weight, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(
        np.where(sure, coordinate_px, np.float32(0.0)), -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    mean = total / np.maximum(count, np.float32(1.0))
    off_periods = np.rint((mean - coordinate_px) / period)
    moved = np.where(sure, coordinate_px, coordinate_px + period * off_periods)
    ambiguous = ~sure & ((count < 3.0) | (np.abs(moved - mean) > np.float32(0.45) * period))
    return np.asarray(moved, np.float32), np.asarray(ambiguous)


def place_by_periods(
    turns: Sequence[Floats],
    axis: AxisConvention,
    usable: NDArray[np.bool_] | None = None,
    singles: Sequence[Floats] = (),
) -> tuple[Floats, Floats]:
    """Choose the number of the finest fringe by the phases of all other periods (temporal unwrapping).

    Returns the coordinates (h, w) in px, and the root mean square by which those phases disagree, in turns; NaN where
    ``usable`` is false. Of micro phase shifting cosines take the phases' place, and all images together the finest
    period's. Sources: Huntley, Saldner, Appl. Opt. 32 (1993) 3047; Gupta, Nayar, CVPR 2012.
    """
    conventions = np.array([axis.periods_px, np.divide(axis.begins_deg, 360.0)], np.float32)
    other_phases = singles or [phase for k, phase in enumerate(turns) if k != axis.finest]
    period, first_begin = conventions[:, axis.finest]
    conventions = np.delete(conventions, axis.finest, axis=1)
    finest, end_px = turns[axis.finest], np.float32(axis.size_px + SLACK_PERIODS * axis.period_px)
    coordinate_px, misfit = np.full((2, *finest.shape), np.nan, np.float32)
    places = np.arange(finest.size) if usable is None else np.flatnonzero(usable)
    for first in range(0, places.size, PIXELS_AT_ONCE):
        batch = places[first : first + PIXELS_AT_ONCE]
        fine_phase = finest.ravel()[batch] - first_begin
        fine_phase -= np.floor(fine_phase)
        batch_phases = np.array([phase.ravel()[batch] for phase in other_phases], np.float32).reshape(-1, batch.size)
        best_px, best = results = np.empty((2, batch.size), np.float32)
        choose_fringes(fine_phase, period, end_px, _fringes(axis), batch_phases, conventions, bool(singles), results)
        if singles:
            best_px += _refine_together(best_px, batch_phases, conventions, period)
        coordinate_px.ravel()[batch] = best_px - np.float32(0.5)
        misfit.ravel()[batch] = np.sqrt(best / np.float32(max(1, len(other_phases))))
    return coordinate_px, misfit


def _refine_together(edge_px: Floats, cosines: Floats, conventions: Floats, period: np.float32) -> Floats:
    """Return the correction of a coordinate by least squares over all images of micro phase shifting.

    It is one step of Gauss and Newton from the coordinate of the first period.
    """
    weight = np.full(edge_px.shape, np.float32(1.5 * (TURN / period) ** 2))
    total = np.zeros_like(weight)
    for cosine, period_px, begin in zip(cosines, *conventions, strict=True):
        angle = np.float32(TURN) * (edge_px / period_px + begin)
        slope = np.float32(-TURN / period_px) * np.sin(angle)
        # Mean and modulation are those of the first period's steps: their error is small beside that of one image.
        weight += slope * slope
        total += slope * (cosine - np.cos(angle))
    return np.asarray(total / weight, np.float32)


def chance_misfit(axis: AxisConvention) -> float:
    """Return the median disagreement that ``place_by_periods`` leaves with unrelated phases, in turns.

    The m other phases disagree by a place in a cube of side 1; the best of K fringes is nearer to its middle than r
    with probability 1 − (1 − V r^m)^K, V being the volume of the unit ball.
    """
    other_count = len(axis.periods_px) - 1
    if other_count < 1:
        return 0.5
    volume = math.pi ** (0.5 * other_count) / math.gamma(0.5 * other_count + 1.0)
    radius = (math.log(2.0) / (_fringes(axis) * volume)) ** (1.0 / other_count)
    return float(min(radius / math.sqrt(other_count), 0.25))


def _fringes(axis: AxisConvention) -> int:
    """Return the number of finest fringes on the pattern."""
    return math.ceil(axis.size_px / axis.period_px) + 1


def _place_by_code_alone(measured: AxisMeasurement, axis: AxisConvention) -> tuple[Floats, float]:
    """Return coordinates of a code without sine frames, and the width of the stripes in px.

    A coordinate is linear between two stripe borders along the image, else the middle of its stripe.
    """
    code = measured.bits
    assert code is not None
    assert code.borders is not None
    is_vertical = axis.name == "y"
    rows, stripe_px = code.numbered(axis, slice(None))
    rows, usable = (rows.T, ~measured.weak.T) if is_vertical else (rows, ~measured.weak)
    along = np.empty(rows.shape, np.float32)
    for begin in range(0, len(rows), LINES_AT_ONCE):
        part = slice(begin, begin + LINES_AT_ONCE)
        along[part] = _between_borders(np.ascontiguousarray(rows[part]), usable[part], code.borders[part])
    coordinate_px = np.ascontiguousarray(along.T if is_vertical else along)
    coordinate_px *= np.float32(stripe_px)
    coordinate_px += np.float32(axis.code_offset_px - 0.5)
    return coordinate_px, stripe_px


def _between_borders(rows: NDArray[np.int32], usable: NDArray[np.bool_], borders: Floats) -> Floats:
    """Return the place in the code, in stripes, of each pixel of some lines (n, length)."""
    width = rows.shape[1]
    place = np.broadcast_to(np.arange(width, dtype=np.int32), rows.shape)
    changed = np.ones((rows.shape[0], width + 1), np.bool_)
    changed[:, 1:-1] = (rows[:, 1:] != rows[:, :-1]) | (usable[:, 1:] != usable[:, :-1])
    # First and last pixel of the run of one stripe that each pixel lies in.
    first = np.maximum.accumulate(np.where(changed[:, :-1], place, 0), axis=1)
    last = np.minimum.accumulate(np.where(changed[:, 1:], place, width - 1)[:, ::-1], axis=1)[:, ::-1]
    before = np.take_along_axis(rows, np.maximum(first - 1, 0), 1) - rows
    behind = np.take_along_axis(rows, np.minimum(last + 1, width - 1), 1) - rows
    # Between stripes i and i + 1 lies the border i + 1; where one is too narrow to be seen, i and i + 2, it is the
    # middle of both.
    begin = first - 1 + np.take_along_axis(borders, np.clip(first - 1, 0, width - 2), 1)
    end = last + np.take_along_axis(borders, np.clip(last, 0, width - 2), 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        is_bounded = (
            usable & (before * behind < 0) & (np.abs(before) <= MOST_SKIPPED) & (np.abs(behind) <= MOST_SKIPPED)
        )
        share = np.clip((place - begin) / (end - begin), 0.0, 1.0)
        within = np.float32(0.5) + np.float32(0.5) * (before + share * (behind - before))
        within = np.where(is_bounded & np.isfinite(within), within, np.float32(0.5))
    return np.asarray(rows + within, np.float32)
