"""Owns the tests of a description against its images: what can be told from them, and what fits instead where it is wrong.

*Code*: from one pixel to the next a stripe's number changes by one, or by nothing; in another order of the bits it leaps.
*Phase against code*: over two whole stripes the mean of their numbers is the coordinate to a fraction of a period. The phase
runs along with it, R = |mean exp 2πi(turns − mean)| near 1, or against it; the angle of that mean is where the phase begins.
*Steps*: least squares leaves little over; else the images' own two principal components say which steps they have.
*Periods*: the phases of all periods agree on a coordinate much better than unrelated phases would on the best of all fringes, or it
goes on from one fringe to the next.
A test that could not have failed is no fit: what it is about stays unchecked, with that reason.
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
from appliance.foreign.code import LEAST_BITS, numbered_stripes, stripe_numbers
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
MOST_START, HALF_OFF = 0.09, 0.38
"""Allowed error of where the phase begins, in turns; and that from which on the code is half a period off."""
MOST_MISFIT, BENT = 0.6, 0.15
"""Allowed misfit of the steps, as a share of the modulation: a bent response of the projector alone makes up to a half. A line from
the second on."""
GOOD_OF_CHANCE, POOR_OF_CHANCE, GOES_ON, LEAPS = 0.45, 0.8, 0.7, 0.15
"""Disagreement of the phases of several periods over that of phases that have nothing to do with each other: good below, wrong above;
share of the borders of fringes at which the coordinate goes on, of periods that belong together, and of others."""
FEW, START_DEG, NEARLY, FINER_DEG = 3000, 15, 1.3, (-6.0, -3.0, 0.0, 3.0, 6.0)
"""Pixels that are asked where the phases of several periods begin, the steps in which it is searched, how much worse the sign that was
said may do, and the finer steps about the best one."""
ACROSS = 2.0
WORDS = {
    "fine_first": ("code_order", '"coarse-first"', '"fine-first"'), "inverted": ("code_inverted", "false", "true"),
    "plain_binary": ("code", '"gray"', '"binary"'),
}  # fmt: skip
"""Words of a description for what a code may be: false, true."""


class Outcome(Enum):
    """Outcomes of a test."""

    FITS = "fits"
    """It could have failed, and did not."""
    WRONG = "wrong"
    UNCHECKED = "unchecked"
    """Nothing could tell."""


@dataclass(frozen=True, slots=True)
class ExaminedAssumption:
    """One word of a description that was tested."""

    about: str
    """The word: ``x.sign``."""
    outcome: Outcome
    text: str
    """Finding; of a wrong word what fits instead, of an unchecked one why nothing could tell."""
    instead: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the direction's convention that fit instead; empty where nothing does."""

    def __str__(self) -> str:
        """Return it as one line."""
        return f"{self.about}: {self.outcome.value}: {self.text}"


def fits(about: str, text: str) -> ExaminedAssumption:
    """Return an assumption that could have failed, and did not."""
    return ExaminedAssumption(about, Outcome.FITS, text)


def wrong(about: str, text: str, **instead: Any) -> ExaminedAssumption:
    """Return an assumption that the images contradict."""
    return ExaminedAssumption(about, Outcome.WRONG, text, instead)


def unchecked(about: str, text: str) -> ExaminedAssumption:
    """Return an assumption that nothing could tell."""
    return ExaminedAssumption(about, Outcome.UNCHECKED, text)


def examine_axis(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Test all that is assumed of one direction on one camera's images."""
    found = camera.measured[axis.name]
    said = [*_steps(camera, axis), *_across(camera, axis)]
    if found.bits is None:
        return [*said, *_periods(found, axis, camera.placed[axis.name].coordinate_px)]
    lines = _Lines.of(found, axis)
    code = _code(lines, axis)
    if found.turns and all(one.outcome is not Outcome.WRONG for one in code):
        code += _phase_against_code(lines, axis)
    return [*said, *_resolution(lines, axis), *code]


def examine_references(camera: DecodedCamera) -> list[ExaminedAssumption]:
    """Test whether bright and dark are what their names say."""
    bright, dark = camera.images.image(Shows.BRIGHT), camera.images.image(Shows.DARK)
    if bright is None or dark is None:
        return []
    light = float(bright.mean()) - float(dark.mean())
    if light < 0.0:
        return [wrong("images.order: bright dark", "they are exchanged: write dark bright where it has bright dark")]
    return [fits("images.order: bright dark", f"the first is brighter by {light:.0f} grey values")]


# -------------------------------------------------------------------------------------------------- code


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Lines along the direction: (n, length) of every so many rows, or columns."""

    bits: NDArray[np.bool_]
    """(bits, n, length)."""
    left_out: tuple[int, int]
    turns: Floats | None
    """Phase of the period that the code numbers."""
    usable: NDArray[np.bool_]
    both: NDArray[np.bool_]
    """(n, length − 1): this pixel and the next one are usable."""

    @classmethod
    def of(cls, found: Measured, axis: AxisConvention) -> _Lines:
        assert found.bits is not None
        step = max(1, found.weak.size // SAMPLES)

        def lines(values: NDArray[Any]) -> NDArray[Any]:
            along = values if axis.name == "x" else np.swapaxes(values, -1, -2)
            return np.ascontiguousarray(along[..., step // 2 :: step, :])

        turns = lines(found.turns[axis.numbered]) if found.turns else None
        usable = lines(found.usable)
        return cls(lines(found.bits.bits), found.bits.left_out, turns, usable, usable[:, 1:] & usable[:, :-1])


def _resolution(lines: _Lines, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Say how many images of the code the camera cannot resolve, and what its finest stripes are."""
    count = sum(lines.left_out)
    if not count:
        return []
    _, stripe_px = numbered_stripes(lines.bits[:, :1, :1], lines.left_out, replace(axis, periods_px=()))
    text = f"{count} of {axis.bits} images of the code have stripes that the camera cannot tell apart, and are left out: stripes of"
    return [unchecked(f"{axis.name}.stripe_px", f"{text} {stripe_px:g} px are used")]


def _wide_enough(lines: _Lines) -> NDArray[np.bool_]:
    """Return the bits without the images at either end whose stripes are hardly wider than a pixel: numbers leap at their borders."""
    pixels = np.count_nonzero(lines.both)
    borders = [np.count_nonzero((bit[:, 1:] != bit[:, :-1]) & lines.both) for bit in lines.bits]
    wide = [bool(LEAST_RUN_PX * count <= pixels) for count in borders]
    if sum(wide) < LEAST_BITS:
        return lines.bits
    return lines.bits[wide.index(True) : len(wide) - wide[::-1].index(True)]


def _code(lines: _Lines, axis: AxisConvention) -> list[ExaminedAssumption]:
    bits = _wide_enough(lines)
    shares, counts = {}, {}
    for flags in product((False, True), repeat=len(WORDS)):
        other: dict[str, Any] = dict(zip(WORDS, flags, strict=True))
        step = np.diff(stripe_numbers(bits, replace(axis, **other)), axis=1)[lines.both]
        changes = np.abs(step[step != 0])
        shares[flags], counts[flags] = float(np.mean(changes == 1)) if changes.size else 0.0, int(changes.size)
    said = tuple(getattr(axis, name) for name in WORDS)
    share, changes = shares[said], counts[said]
    names = [f"{axis.name}.{word}" for word, *_ in WORDS.values()]
    if changes < LEAST_CHANGES or axis.bits < LEAST_BITS:
        text = f"{changes} borders of stripes are seen; {LEAST_CHANGES} of {LEAST_BITS} images are needed"
        return [unchecked(about, text) for about in names]
    here = f"{100 * share:.0f} % of {changes} borders are between neighbouring stripes"
    if share < GOOD_CODE:
        # Of several that fit alike, the one nearest to what was said.
        best = max(
            shares, key=lambda one: (shares[one] * (counts[one] >= LEAST_CHANGES // 4), -np.not_equal(one, said).sum())
        )
        if shares[best] <= share + CLEARLY_BETTER:
            return [wrong(names[0], f"{here}; no order of the bits fits: check which images are gray, and their order")]
        named = [
            f"{name} = {words[1 + now]}"
            for name, words, now, was in zip(names, WORDS.values(), best, said, strict=True)
            if now != was
        ]
        text = f"{here}, {100 * shares[best]:.0f} % with {', '.join(named)}"
        return [wrong(named[0].split(" ")[0], text, **dict(zip(WORDS, best, strict=True)))]
    found = []
    for k, (about, (word, *words)) in enumerate(zip(names, WORDS.values(), strict=True)):
        flipped = max((one for one in shares if one[k] != said[k]), key=lambda one: shares[one])
        as_good = shares[flipped] > share - CLEARLY_BETTER
        text = f"{here}, {100 * shares[flipped]:.0f} % with {word} = {words[not said[k]]}"
        found.append(unchecked(about, text) if as_good else fits(about, text))
    return found


# ------------------------------------------------------------------------------------------ phase against code


def _phase_against_code(lines: _Lines, axis: AxisConvention) -> list[ExaminedAssumption]:
    assert lines.turns is not None
    period = axis.periods_px[axis.numbered]
    words = [f"{axis.name}.{word}" for word in ("sign", "stripe_px", "start_deg")]
    whole, stripe = numbered_stripes(lines.bits, lines.left_out, axis)
    number = whole.astype(np.float32)
    changes = np.count_nonzero((np.diff(number, axis=1) != 0) & lines.both)
    # Two stripes are so wide in this image.
    size = (2 * round(np.count_nonzero(lines.both) / max(1, int(changes))) + 1, 1)
    middle = (number + np.float32(0.5)) * np.float32(stripe) + np.float32(axis.code_offset_px)
    mean = cv2.boxFilter(middle, -1, size, borderType=cv2.BORDER_REFLECT)
    full = cv2.boxFilter(lines.usable.astype(np.float32), -1, size, borderType=cv2.BORDER_CONSTANT) > np.float32(0.999)
    good = full & (np.abs(middle - mean) < np.float32(0.75 * stripe))
    if changes < LEAST_CHANGES or np.count_nonzero(good) < 10 * LEAST_CHANGES:
        return [unchecked(word, f"{changes} borders of stripes are seen, which is too few") for word in words]
    turns, coordinate = lines.turns[good].astype(np.float64), mean[good].astype(np.float64)

    def together(sign: int, factor: float) -> tuple[float, float]:
        sum_ = np.exp(2j * np.pi * (sign * turns - factor * coordinate / period)).mean()
        return float(abs(sum_)), float(np.angle(sum_) / (2 * np.pi))

    fit, start = together(1, 1.0)
    others = {(sign, factor): together(sign, factor)[0] for sign in (1, -1) for factor in (1.0, 0.5, 2.0)}
    best = max(others, key=lambda one: others[one])
    if fit < POOR_FIT and others[best] > GOOD_FIT:
        text = f"{_other_way(axis, best)} (R = {others[best]:.2f} instead of {fit:.2f})"
        return [wrong(words[best[0] > 0], text, sign=best[0] * axis.sign, stripe_px=best[1] * axis.stripe_px)]
    if fit < POOR_FIT:
        text = f"phase and code do not belong together (R = {fit:.2f}; other signs and stripes of half and double width fit no better)"
        return [wrong(f"{axis.name}.period_px", f"{text}: check it, the order of the steps, and which images are gray")]
    backwards, wider = others[-1, 1.0], max(others[1, 0.5], others[1, 2.0])
    said = [(fits if rival < POOR_FIT else unchecked)(word, f"R of phase and code is {fit:.2f}, {rival:.2f} with another one")
            for word, rival in zip(words, (backwards, wider), strict=False)]  # fmt: skip
    away = start - axis.begins_deg[axis.numbered] / 360.0
    away -= round(away)
    if abs(away) <= MOST_START:
        return [*said, fits(words[2], f"phase and code are {360 * abs(away):.0f}° apart")]
    if abs(away) > HALF_OFF:
        offset_px = axis.code_offset_px + (0.5 * period if axis.code_offset_px < 0.0 else -0.5 * period)
        about, degrees = f"{axis.name}.code_offset_px", (axis.start_deg + 180.0) % 360.0
        text = f"the code is half a period off: {about} = {offset_px:g} fits (or {axis.name}.start_deg = {degrees:g})"
        return [*said, wrong(about, text, code_offset_px=offset_px)]
    degrees = round((axis.start_deg + 360.0 * away) / 5.0) * 5 % 360
    text = f"the phase begins elsewhere: {axis.name}.start_deg = {degrees} fits"
    return [*said, wrong(words[2], text, start_deg=float(degrees))]


def _other_way(axis: AxisConvention, best: tuple[int, float]) -> str:
    sign, factor = best
    words = []
    if sign < 0:
        words.append(f'the phase runs the other way: {axis.name}.sign = "{"-" if axis.sign > 0 else "+"}" fits')
    if factor != 1.0:
        wide = factor * axis.stripe_px
        kind = "a whole period" if abs(wide - axis.period_px) < 0.01 * wide else "half a period"
        words.append(f"the stripes of the code are {kind} wide: {axis.name}.stripe_px = {wide:g} fits")
    return ", and ".join(words)


# ------------------------------------------------------------------------------------------------ steps, periods


def _steps(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    about = f"{axis.name}.steps"
    said: list[ExaminedAssumption] = []
    for period, steps_deg in enumerate(axis.signed_deg):
        images = camera.images.all_of(Shows.SINE, axis.name, period)
        if len(images) != len(steps_deg) or len(images) < 4:
            said += [] if said else [unchecked(about, "three steps fit any images")]
            continue
        sample = tuple(slice(3, None, max(1, round(size / 200))) for size in images[0].shape)
        stack = np.stack([one[sample] for one in images]).astype(np.float64).reshape(len(images), -1)
        swing = stack.max(axis=0) - stack.min(axis=0)
        stack = stack[:, swing > max(0.02 * camera.images.white, 0.5 * float(np.quantile(swing, 0.8)))]
        left = misfit(stack, steps_deg)
        here = f"a sine with these steps leaves {100 * left:.0f} % of the modulation"
        fewer = equal_steps(len(images) - 1)
        for off, end in ((0, "first"), (-1, "last")) if left > BENT and len(fewer) > 3 else ():
            rest = misfit(np.delete(stack, off, axis=0), fewer)
            if rest < 0.5 * left:
                text = f"{here}; without the {end} of its images, steps = {len(fewer)} leaves {100 * rest:.0f} %"
                said.append(wrong("images.order", text))
        measured = measured_steps(stack)
        better = misfit(stack, measured)
        if left <= MOST_MISFIT:
            said.append(fits(about, here))
        elif better < min(0.5 * left, MOST_MISFIT):
            steps = f"{axis.name}.steps_deg = [{', '.join(f'{step:g}' for step in measured)}]"
            said.append(wrong(about, f"{here}; {steps} leaves {100 * better:.0f} %"))
        else:
            said.append(wrong(about, f"{here}; no other steps fit: check which images are sine-{axis.name}"))
    found = camera.measured[axis.name]
    share = found.misfit_share or 0.0
    if max(share, 4.0 * np.pi * found.bend_turns) > BENT:
        text = f"it is bent: phases are {360 * found.bend_turns:.1f}° off" + (
            f", sines leave {100 * share:.0f} %" if share else ""
        )
        said.append(unchecked(f"response of {axis.name}", f"{text}, which the error of each point includes"))
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


def _periods(found: Measured, axis: AxisConvention, coordinate_px: Floats) -> list[ExaminedAssumption]:
    about = f"{axis.name}.period_px"
    if len(axis.periods_px) == 1:
        return [unchecked(about, "one fringe covers the pattern: nothing contradicts it")]
    usable = np.flatnonzero(found.usable)
    few = usable[:: max(1, usable.size // FEW)]
    if not few.size:
        return [unchecked(about, "no pixel is bright enough")]
    goes_on = _goes_on(coordinate_px, axis)
    leaps = f"the coordinate goes on at {100 * goes_on:.0f} % of the borders of fringes"
    if axis.micro:
        return [(fits if goes_on >= GOES_ON else unchecked)(about, leaps)]
    usual = tuple(range(len(found.turns)))

    def left(order: tuple[int, ...] = usual, sign: int = 1, start_deg: float = axis.start_deg) -> float:
        turns = [np.float32(sign) * found.turns[k].ravel()[few] for k in order]
        return float(np.median(by_periods(turns, replace(axis, start_deg=start_deg))[1]))

    chance, here = chance_misfit(axis), left()
    good = min(GOOD_OF_CHANCE * chance, 0.6 * here)
    text = f"their phases are {360 * here:.1f}° apart"
    if here < GOOD_OF_CHANCE * chance:
        return [fits(about, f"{text}; by chance it would be {360 * chance:.1f}°")]
    orders = {order: left(order) for order in (permutations(usual) if len(usual) <= 4 else [usual[::-1]])}
    best = min(orders, key=lambda order: orders[order])
    if orders[best] < good:
        # The k-th period belongs to the images that were taken for those of another one.
        wanted = tuple(axis.periods_px[best.index(k)] for k in usual)
        said = f"{about} = [{', '.join(f'{one:g}' for one in wanted)}]"
        return [wrong(about, f"{text}, and {360 * orders[best]:.1f}° with {said}", periods_px=wanted)]
    starts = {(sign, float(start)): left(usual, sign, start) for sign in (1, -1) for start in range(0, 360, START_DEG)}
    sign, start = min(starts, key=lambda one: starts[one])
    # The same sign where it does nearly as well: of two cameras a pattern that is mirrored makes the same points.
    mine = min((one for one in starts if one[0] == 1), key=lambda one: starts[one])
    sign, start = mine if starts[mine] < NEARLY * starts[sign, start] else (sign, start)
    finer = {(start + off) % 360.0: left(usual, sign, start + off) for off in FINER_DEG}
    start = min(finer, key=lambda one: finer[one])
    if finer[start] < good:
        words = [f'{axis.name}.sign = "{"+" if sign * axis.sign > 0 else "-"}"'] if sign < 0 else []
        said = " and ".join([*words, f"{axis.name}.start_deg = {start:g}"])
        text = f"{text}, and {360 * finer[start]:.1f}° with {said}"
        return [wrong(f"{axis.name}.{'sign' if words else 'start_deg'}", text, sign=sign * axis.sign, start_deg=start)]
    # A bent response moves the phase of a coarse period by as much as a fine one has fringes in it: then each fringe must follow the last.
    text += f", and would be {360 * chance:.1f}° by chance; {leaps}"
    if goes_on >= GOES_ON:
        return [fits(about, text)]
    if here > POOR_OF_CHANCE * chance and (goes_on < LEAPS or len(usual) > 2):
        return [wrong(about, f"{text}: check it or {axis.name}.fringes, and the order of the images")]
    return [unchecked(about, text)]


def _goes_on(coordinate_px: Floats, axis: AxisConvention) -> float:
    """Return the share of the borders of fringes, along the direction, at which the coordinate goes on; NaN where too few are seen."""
    along = coordinate_px if axis.name == "x" else coordinate_px.T
    with np.errstate(invalid="ignore"):
        border = np.diff(np.floor((along + np.float32(0.5)) / np.float32(axis.period_px)), axis=1)
    known = np.isfinite(border) & (border != 0)
    step = np.abs(np.diff(along, axis=1)[known])
    return float(np.mean(step < 0.5 * axis.period_px)) if step.size >= LEAST_CHANGES else np.nan


def _across(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Test whether the coordinate varies along the image as its name says; said only where it does not."""
    steps = []
    for along in (1, 0):
        step = np.abs(np.diff(camera.placed[axis.name].coordinate_px, axis=along))
        steps.append(float(np.median(known)) if (known := step[np.isfinite(step)]).size else 0.0)
    own, other = steps if axis.name == "x" else steps[::-1]
    if other <= ACROSS * own or not camera.valid.any():
        return []
    way = "down" if axis.name == "x" else "across"
    text = f"{axis.name} varies {way} the images: cameras that stand on their side, or x and y are exchanged"
    return [unchecked("images.order", text)]
