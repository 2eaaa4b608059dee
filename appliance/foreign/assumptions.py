"""Owns the tests of a description against its images: what can be told from them, and what fits instead where it is wrong.

*Code*: from one pixel to the next a stripe's number changes by one, or by nothing; in another order of the bits it leaps.
*Phase against code*: over two whole stripes the mean of their numbers is the coordinate to a fraction of a period. The phase
runs along with it, R = |mean exp 2πi(turns − mean)| near 1, or against it; the angle of that mean is where the phase begins.
*Steps*: least squares leaves little over; else the images' own two principal components say which steps they have.
*Periods*: the phases of all periods agree on a coordinate much better than unrelated phases would on the best of all fringes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import permutations, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.foreign.camera import DecodedCamera
from appliance.foreign.code import LEAST_BITS, CodeBits, numbered_stripes, stripe_numbers
from appliance.foreign.decode import Measured, by_periods, chance_misfit
from appliance.foreign.description import AxisConvention
from appliance.foreign.order import Shows
from appliance.foreign.phase import Floats

SAMPLES = 400_000
"""Number of pixels that are asked, in whole lines along the direction."""
LEAST_RUN_PX = 3.0
"""Least mean distance of the borders of an image of the code, for its order to be told by neighbouring pixels."""
LEAST_CHANGES = 200
"""Number of borders between stripes from which on something is concluded."""
CLEARLY_BETTER, GOOD_CODE = 0.25, 0.6
"""A convention of the code is wrong where less than this share of its borders are between neighbours, and another one has so much more."""
GOOD_FIT, POOR_FIT = 0.6, 0.45
"""R from which on phase and code belong together, and below which they do not."""
MOST_START = 0.09
"""Allowed error of where the phase begins, in turns."""
HALF_OFF = 0.38
MOST_MISFIT = 0.6
"""Allowed misfit of the steps, as a share of the modulation: a bent response of the projector alone makes up to 0.35."""
GOOD_OF_CHANCE, POOR_OF_CHANCE = 0.45, 0.8
"""Disagreement of the phases of several periods over that of phases that have nothing to do with each other: good below, wrong above."""
FEW, START_DEG, NEARLY, FINER_DEG = 3000, 15, 1.3, (-6.0, -3.0, 0.0, 3.0, 6.0)
"""Pixels that are asked where the phases of several periods begin, the steps in which it is searched, how much worse the sign that was
said may do, and the finer steps about the best one."""
ACROSS = 2.0


class Outcome(Enum):
    """Outcomes of a test."""

    FITS = "fits"
    WRONG = "wrong"
    NOT_JUDGED = "not judged"
    """The images cannot tell, or show too little."""


@dataclass(frozen=True, slots=True)
class ExaminedAssumption:
    """One assumption that was tested."""

    about: str
    """Name of the assumption, for example ``sign of x``."""
    outcome: Outcome
    text: str
    """Finding in words; of a wrong assumption it says what fits instead."""
    instead: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the direction's convention that fit instead; empty where nothing does."""

    def __str__(self) -> str:
        """Return it as one line."""
        return f"{self.about}: {self.outcome.value}: {self.text}"


def examine_axis(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Test all that is assumed of one direction on one camera's images."""
    found = camera.measured[axis.name]
    said = _steps(camera, axis)
    if found.bits is None:
        return [*said, _periods(found, axis), *_across(camera, axis)]
    lines = _Lines.of(found, axis)
    said += _resolution(found.bits, axis)
    code = _code(lines, axis)
    said.append(code)
    if found.fits and code.outcome is not Outcome.WRONG:
        said += _phase_against_code(lines, axis)
    return [*said, *_across(camera, axis)]


def examine_references(camera: DecodedCamera) -> list[ExaminedAssumption]:
    """Test whether bright and dark are what their names say."""
    bright, dark = camera.images.image(Shows.BRIGHT), camera.images.image(Shows.DARK)
    if bright is None or dark is None:
        return []
    light = float(bright.mean()) - float(dark.mean())
    if light < 0.0:
        return [
            ExaminedAssumption(
                "bright and dark",
                Outcome.WRONG,
                "they are exchanged: write dark bright where the order has bright dark",
            )
        ]
    return [ExaminedAssumption("bright and dark", Outcome.FITS, f"bright is brighter by {light:.0f} grey values")]


# -------------------------------------------------------------------------------------------------- code


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Lines along the direction: (n, length) of every so many rows, or columns."""

    bits: NDArray[np.bool_]
    """(bits, n, length)."""
    left_out: tuple[int, int]
    turns: Floats | None
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, found: Measured, axis: AxisConvention) -> _Lines:
        assert found.bits is not None
        step = max(1, found.weak.size // SAMPLES)

        def lines(values: NDArray[Any]) -> NDArray[Any]:
            along = values if axis.name == "x" else np.swapaxes(values, -1, -2)
            return np.ascontiguousarray(along[..., step // 2 :: step, :])

        turns = lines(found.fits[axis.finest].turns) if found.fits else None
        return cls(lines(found.bits.bits), found.bits.left_out, turns, lines(~(found.weak | found.saturated)))


def _resolution(code: CodeBits, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Say how many images of the code the camera cannot resolve, and what its finest stripes are."""
    count = sum(code.left_out)
    if not count:
        return []
    _, stripe_px = numbered_stripes(code.bits[:, :1, :1], code.left_out, replace(axis, periods_px=()))
    return [
        ExaminedAssumption(
            f"resolution of {axis.name}", Outcome.NOT_JUDGED,
            f"{count} of {axis.bits} images of the code have stripes that the camera cannot tell apart, and are left out: stripes of "
            f"{stripe_px:g} px are used",
        )
    ]  # fmt: skip


def _wide_enough(lines: _Lines) -> NDArray[np.bool_]:
    """Return the bits without the images at either end whose stripes are hardly wider than a pixel: numbers leap at their borders."""
    both = lines.usable[:, 1:] & lines.usable[:, :-1]
    pixels = np.count_nonzero(both)
    wide = [bool(LEAST_RUN_PX * np.count_nonzero((bit[:, 1:] != bit[:, :-1]) & both) <= pixels) for bit in lines.bits]
    if sum(wide) < LEAST_BITS:
        return lines.bits
    first, last = wide.index(True), wide[::-1].index(True)
    return lines.bits[first : len(wide) - last]


def _continuity(lines: _Lines, bits: NDArray[np.bool_], axis: AxisConvention) -> tuple[float, int]:
    """Return the share of the borders at which the number changes by one, and how many borders there are."""
    step = np.diff(stripe_numbers(bits, axis), axis=1)[lines.usable[:, 1:] & lines.usable[:, :-1]]
    changes = np.abs(step[step != 0])
    return (float(np.mean(changes == 1)) if changes.size else 0.0), int(changes.size)


def _code(lines: _Lines, axis: AxisConvention) -> ExaminedAssumption:
    about = f"code of {axis.name}"
    bits = _wide_enough(lines)
    share, changes = _continuity(lines, bits, axis)
    if changes < LEAST_CHANGES or axis.bits < 3:
        return ExaminedAssumption(
            about, Outcome.NOT_JUDGED, f"{changes} borders of stripes are seen; {LEAST_CHANGES} are needed"
        )
    words = {
        "fine_first": 'code_order = "fine-first"',
        "inverted": "code_inverted = true",
        "plain_binary": 'code = "binary"',
    }
    usual = {
        "fine_first": 'code_order = "coarse-first"',
        "inverted": "code_inverted = false",
        "plain_binary": 'code = "gray"',
    }
    best, best_share = axis, share
    for flags in product((False, True), repeat=3):
        other = replace(axis, fine_first=flags[0], inverted=flags[1], plain_binary=flags[2])
        its_share, its_changes = _continuity(lines, bits, other)
        # Of several that fit alike, the one nearest to what was said.
        if its_share > best_share + CLEARLY_BETTER and its_changes >= LEAST_CHANGES // 4:
            best, best_share = other, its_share
    if best is axis or share >= GOOD_CODE:
        outcome = Outcome.FITS if share >= GOOD_CODE else Outcome.WRONG
        told = (
            ""
            if outcome is Outcome.FITS
            else "; no order of the bits fits: check which images are gray, and their order"
        )
        return ExaminedAssumption(
            about, outcome, f"{100 * share:.0f} % of {changes} borders are between neighbouring stripes{told}"
        )
    said = [
        (words if getattr(best, name) else usual)[name] for name in words if getattr(best, name) != getattr(axis, name)
    ]
    return ExaminedAssumption(
        about, Outcome.WRONG,
        f"{100 * share:.0f} % of its borders are between neighbouring stripes, {100 * best_share:.0f} % with "
        f"{', '.join(f'{axis.name}.{word}' for word in said)}", {name: getattr(best, name) for name in words},
    )  # fmt: skip


# ------------------------------------------------------------------------------------------ phase against code


def _phase_against_code(lines: _Lines, axis: AxisConvention) -> list[ExaminedAssumption]:
    assert lines.turns is not None
    period, about = axis.period_px, f"sign of {axis.name}"
    whole, stripe = numbered_stripes(lines.bits, lines.left_out, axis)
    number = whole.astype(np.float32)
    usable = lines.usable
    both = usable[:, 1:] & usable[:, :-1]
    changes = np.count_nonzero((np.diff(number, axis=1) != 0) & both)
    if changes < LEAST_CHANGES:
        return [
            ExaminedAssumption(
                about, Outcome.NOT_JUDGED, f"{changes} borders of stripes are seen; {LEAST_CHANGES} are needed"
            )
        ]
    # Two stripes are so wide in this image.
    width = 2 * round(np.count_nonzero(both) / changes) + 1
    size = (width, 1)
    middle = (number + np.float32(0.5)) * np.float32(stripe) + np.float32(axis.code_offset_px)
    mean = cv2.boxFilter(middle, -1, size, borderType=cv2.BORDER_REFLECT)
    full = cv2.boxFilter(usable.astype(np.float32), -1, size, borderType=cv2.BORDER_CONSTANT) > np.float32(0.999)
    good = full & (np.abs(middle - mean) < np.float32(0.75 * stripe))
    if np.count_nonzero(good) < 10 * LEAST_CHANGES:
        return [ExaminedAssumption(about, Outcome.NOT_JUDGED, "too little of it is seen over two stripes")]
    turns, coordinate = lines.turns[good].astype(np.float64), mean[good].astype(np.float64)

    def together(sign: int, factor: float) -> tuple[float, float]:
        sum_ = np.exp(2j * np.pi * (sign * turns - factor * coordinate / period)).mean()
        return float(abs(sum_)), float(np.angle(sum_) / (2 * np.pi))

    fit, start = together(1, 1.0)
    others = {(sign, factor): together(sign, factor)[0] for sign in (1, -1) for factor in (1.0, 0.5, 2.0)}
    best = max(others, key=lambda one: others[one])
    if fit < POOR_FIT and others[best] > GOOD_FIT:
        instead = {"sign": best[0] * axis.sign, "stripe_px": best[1] * axis.stripe_px}
        return [ExaminedAssumption(about, Outcome.WRONG, _other_way(axis, best, fit, others[best]), instead)]
    if fit < POOR_FIT:
        return [
            ExaminedAssumption(
                f"phase and code of {axis.name}", Outcome.WRONG,
                f"they do not belong together (R = {fit:.2f}; other signs and stripes of half and double width fit no better): check "
                f"{axis.name}.period_px, the order of the steps, and which images are gray",
            )
        ]  # fmt: skip
    said = [
        ExaminedAssumption(
            about,
            Outcome.FITS,
            f"the phase runs along with the code (R = {fit:.2f}, the other way {others[-1, 1.0]:.2f})",
        )
    ]
    away = start - axis.start_deg / 360.0
    away -= round(away)
    about = f"start of {axis.name}"
    if abs(away) <= MOST_START:
        return [*said, ExaminedAssumption(about, Outcome.FITS, f"phase and code are {360 * abs(away):.0f}° apart")]
    if abs(away) > HALF_OFF:
        offset_px = axis.code_offset_px + (0.5 * period if axis.code_offset_px < 0.0 else -0.5 * period)
        return [
            *said,
            ExaminedAssumption(
                about, Outcome.WRONG,
                f"the code is half a period off: {axis.name}.code_offset_px = {offset_px:g} fits (or {axis.name}.start_deg = "
                f"{(axis.start_deg + 180.0) % 360.0:g})", {"code_offset_px": offset_px},
            ),
        ]  # fmt: skip
    degrees = round((axis.start_deg + 360.0 * away) / 5.0) * 5 % 360
    text = f"the phase begins elsewhere: {axis.name}.start_deg = {degrees} fits"
    return [*said, ExaminedAssumption(about, Outcome.WRONG, text, {"start_deg": float(degrees)})]


def _other_way(axis: AxisConvention, best: tuple[int, float], fit: float, better: float) -> str:
    sign, factor = best
    words = []
    if sign < 0:
        words.append(f'the phase runs the other way: {axis.name}.sign = "{"-" if axis.sign > 0 else "+"}" fits')
    if factor != 1.0:
        wide = factor * axis.stripe_px
        kind = "a whole period" if abs(wide - axis.period_px) < 0.01 * wide else "half a period"
        words.append(f"the stripes of the code are {kind} wide: {axis.name}.stripe_px = {wide:g} fits")
    return f"{', and '.join(words)} (R = {better:.2f} instead of {fit:.2f})"


# ------------------------------------------------------------------------------------------------ steps, periods


def _steps(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    said = []
    for period, steps_deg in enumerate(axis.steps_deg):
        about = f"steps of {axis.name}" + (f"{period + 1}" if period else "")
        fit = camera.measured[axis.name].fits[period]
        if fit.misfit is None:
            said.append(ExaminedAssumption(about, Outcome.NOT_JUDGED, "three steps fit any images"))
            continue
        sample = tuple(slice(3, None, max(1, round((size / 200) ** 1))) for size in fit.turns.shape)
        images = [camera.images.image(Shows.SINE, axis.name, k, period) for k in range(len(steps_deg))]
        stack = (
            np.stack([one[sample] for one in images if one is not None]).astype(np.float64).reshape(len(steps_deg), -1)
        )
        swing = stack.max(axis=0) - stack.min(axis=0)
        strong = swing > max(0.02 * camera.images.white, 0.5 * float(np.quantile(swing, 0.8)))
        left_over = misfit(stack[:, strong], axis.signed_deg[period])
        if left_over <= MOST_MISFIT:
            said.append(
                ExaminedAssumption(about, Outcome.FITS, f"a sine leaves {100 * left_over:.0f} % of the modulation")
            )
            continue
        measured = measured_steps(stack[:, strong])
        better = misfit(stack[:, strong], measured)
        text = f"a sine with these steps leaves {100 * left_over:.0f} % of the modulation; "
        if better < 0.5 * left_over and better < MOST_MISFIT:
            text += (
                f"{axis.name}.steps_deg = [{', '.join(f'{step:g}' for step in measured)}] leaves {100 * better:.0f} %"
            )
        else:
            text += f"no other steps fit: check which images are sine-{axis.name}"
        said.append(ExaminedAssumption(about, Outcome.WRONG, text))
    return said


def equal_steps(count: int) -> tuple[float, ...]:
    """Return ``count`` steps of equal size around the circle, in degrees."""
    return tuple(360.0 * k / count for k in range(count))


def misfit(stack: NDArray[np.float64], steps_deg: tuple[float, ...]) -> float:
    """Return the root mean square that the best sines leave of images (n, pixels), as a share of their modulation."""
    angles = np.deg2rad(np.asarray(steps_deg))
    columns = np.stack([np.ones_like(angles), np.cos(angles), -np.sin(angles)], axis=1)
    values, *_ = np.linalg.lstsq(columns, stack, rcond=None)
    left = np.sqrt(np.square(stack - columns @ values).sum(axis=0) / max(1, len(angles) - 3))
    return float(np.median(left / np.maximum(np.hypot(values[1], values[2]), 1e-6)))


def measured_steps(stack: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the steps of images (n, pixels) by their own principal components, beginning with 0; their sign cannot be told."""
    centred = stack - stack.mean(axis=0)
    _, vectors = np.linalg.eigh(centred @ centred.T)
    degrees = np.rad2deg(np.arctan2(vectors[:, -1], vectors[:, -2]))
    degrees = (degrees - degrees[0]) % 360.0
    count = len(degrees)
    whole = np.rint(degrees * count / 360.0) * 360.0 / count
    # Steps of equal size are what nearly all sets have; noise of a degree is not worth being written down.
    equal = np.abs(degrees - whole).max() < 100.0 / count and len(set((whole % 360.0).tolist())) == count
    rounded = whole % 360.0 if equal else np.round(degrees)
    # Of two signs, the one by which the first step aside is less than half a turn.
    aside = rounded[(rounded % 180.0 > 1.0) & (rounded % 180.0 < 179.0)]
    if aside.size and aside[0] > 180.0:
        rounded = (-rounded) % 360.0
    return tuple(float(one) for one in rounded)


def _periods(found: Measured, axis: AxisConvention) -> ExaminedAssumption:
    about = f"periods of {axis.name}"
    usual = tuple(range(len(found.fits)))
    if len(usual) == 1:
        return ExaminedAssumption(about, Outcome.NOT_JUDGED, "one fringe covers the pattern: nothing contradicts it")
    chance = chance_misfit(axis)

    def misfit_of(order: tuple[int, ...]) -> float:
        again = replace(found, fits=tuple(found.fits[k] for k in order))
        _, left = by_periods(again, axis)
        known = left[~(found.weak | found.saturated)]
        return float(np.median(known)) if known.size else 1.0

    here = misfit_of(usual)
    if here < GOOD_OF_CHANCE * chance:
        return ExaminedAssumption(
            about, Outcome.FITS, f"their phases are {360 * here:.1f}° apart; by chance it would be {360 * chance:.1f}°"
        )
    others = {order: misfit_of(order) for order in (permutations(usual) if len(usual) <= 4 else [usual[::-1]])}
    best = min(others, key=lambda order: others[order])
    if others[best] < min(GOOD_OF_CHANCE * chance, 0.6 * here):
        # The k-th period belongs to the images that were taken for those of another one.
        wanted = [0.0] * len(usual)
        for k, images in enumerate(best):
            wanted[images] = axis.periods_px[k]
        return ExaminedAssumption(
            about, Outcome.WRONG,
            f"their phases are {360 * here:.1f}° apart, and {360 * others[best]:.1f}° with {axis.name}.period_px = "
            f"[{', '.join(f'{one:g}' for one in wanted)}]", {"periods_px": tuple(wanted)},
        )  # fmt: skip
    sign, start_deg, left = _other_begin(found, axis)
    if left < min(GOOD_OF_CHANCE * chance, 0.6 * here):
        words = [f'{axis.name}.sign = "{"+" if sign * axis.sign > 0 else "-"}"'] if sign < 0 else []
        words.append(f"{axis.name}.start_deg = {start_deg:g}")
        return ExaminedAssumption(
            about, Outcome.WRONG,
            f"their phases are {360 * here:.1f}° apart, and {360 * left:.1f}° with {' and '.join(words)}",
            {"sign": sign * axis.sign, "start_deg": start_deg},
        )  # fmt: skip
    text = f"their phases are {360 * here:.1f}° apart, and would be {360 * chance:.1f}° by chance"
    if here > POOR_OF_CHANCE * chance:
        text += f": check {axis.name}.period_px or {axis.name}.fringes, and the order of the images"
        return ExaminedAssumption(about, Outcome.WRONG, text)
    return ExaminedAssumption(about, Outcome.NOT_JUDGED, text)


def _other_begin(found: Measured, axis: AxisConvention) -> tuple[int, float, float]:
    """Return the sign and the start with which the phases of several periods agree best, and by how much they then disagree, in turns.

    All periods begin alike at the edge of the pattern: another start moves each by another part of its period.
    """
    usable = np.flatnonzero(~(found.weak | found.saturated))
    few = usable[:: max(1, usable.size // FEW)]
    if not few.size:
        return 1, axis.start_deg, 1.0
    nothing = np.zeros((1, few.size), np.bool_)

    def left_with(sign: int, start_deg: float) -> float:
        fits = tuple(
            replace(fit, turns=np.float32(sign) * fit.turns.ravel()[few][None], modulation=fit.modulation.ravel()[few][None],
                    offset=fit.offset.ravel()[few][None], misfit=None, saturated=nothing)
            for fit in found.fits
        )  # fmt: skip
        _, left = by_periods(
            replace(found, fits=fits, weak=nothing, saturated=nothing), replace(axis, start_deg=start_deg)
        )
        return float(np.median(left))

    coarse = {(sign, float(start)): left_with(sign, start) for sign in (1, -1) for start in range(0, 360, START_DEG)}
    sign, start = min(coarse, key=lambda one: coarse[one])
    # The same sign where it does nearly as well: of two cameras a pattern that is mirrored makes the same points.
    mine = min((one for one in coarse if one[0] == 1), key=lambda one: coarse[one])
    if coarse[mine] < NEARLY * coarse[sign, start]:
        sign, start = mine
    fine = {(start + off) % 360.0: left_with(sign, start + off) for off in FINER_DEG}
    best = min(fine, key=lambda one: fine[one])
    return sign, best, fine[best]


def _across(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Test whether the coordinate varies along the image as its name says; said only where it does not."""
    coordinate = camera.placed[axis.name].coordinate_px
    steps = []
    for along in (1, 0):
        step = np.abs(np.diff(coordinate, axis=along))
        known = step[np.isfinite(step)]
        steps.append(float(np.median(known)) if known.size else 0.0)
    own, other = steps if axis.name == "x" else steps[::-1]
    if other <= ACROSS * own or not camera.valid.any():
        return []
    way = "down" if axis.name == "x" else "across"
    return [
        ExaminedAssumption(
            f"direction of {axis.name}", Outcome.NOT_JUDGED,
            f"it varies {way} the images: cameras that stand on their side, or x and y are exchanged in the description",
        )
    ]  # fmt: skip
