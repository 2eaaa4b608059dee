"""Owns the tests of a description against its images: what can be told from them, and what fits instead where it is
wrong.

*Code*: from one pixel to the next a stripe's number changes by one, or by nothing; in another order of the bits it leaps.
*Phase against code*: over two whole stripes the mean of their numbers is the coordinate to a fraction of a period. The phase
runs along with it, R = |mean exp 2πi(turns − mean)| near 1, or against it; the angle of that mean is where the phase begins.
*Steps*: least squares leaves little over; else the images' own two principal components say which steps they have.
*Periods*: the phases of all periods agree on a coordinate much better than unrelated phases would on the best of all fringes, or it
goes on from one fringe to the next.
*Size*: hardly a pixel has a coordinate that lies beyond the pattern.
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

from appliance.desk.foreign.camera import DecodedCamera
from appliance.desk.foreign.code import LEAST_BITS, numbered_stripes, stripe_numbers
from appliance.desk.foreign.decode import Measured, by_periods, chance_misfit
from appliance.desk.foreign.description import AxisConvention, equal_steps, toml_value, word_for
from appliance.desk.foreign.order import Shows
from appliance.desk.foreign.phase import Floats, some_pixels, step_columns

SAMPLES = 400_000
"""Number of pixels that are asked, in whole lines along the direction."""
LEAST_RUN_PX = 3.0
"""Least mean distance of the borders of an image of the code, for its order to be told by neighbouring pixels."""
LEAST_CHANGES = 200
"""Number of borders between stripes from which on something is concluded."""
CLEARLY_BETTER, GOOD_CODE = 0.25, 0.6
"""A convention of the code is wrong where less than this share of its borders are between neighbours, and another one
has so much more."""
GOOD_FIT, POOR_FIT = 0.6, 0.45
"""R from which on phase and code belong together, and below which they do not."""
MOST_START, HALF_OFF = 0.09, 0.38
"""Allowed error of where the phase begins, in turns; and that from which on the code is half a period off."""
MOST_MISFIT, BENT = 0.6, 0.15
"""Allowed misfit of the steps, as a share of the modulation: a bent response of the projector alone makes up to a half.

A line from the second on.
"""
GOOD_OF_CHANCE, POOR_OF_CHANCE, GOES_ON, LEAPS = 0.45, 0.8, 0.7, 0.15
"""Disagreement of the phases of several periods over that of phases that have nothing to do with each other: good
below, wrong above; share of the borders of fringes at which the coordinate goes on, of periods that belong together,
and of others."""
FEW, START_DEG, NEARLY = 3000, 5, 1.3
"""Pixels that are asked which steps fit, and where the phases of several periods begin, the steps in which it is
searched, and how much worse the sign that was said may do: of two cameras a pattern that is mirrored makes the same
points."""
MOST_BEYOND = 0.02
"""Largest share of the coordinates that may lie beyond the pattern: of rightly described sets a quarter of a percent
does."""
SAME_TURNS = 0.02
"""Difference of phases that come back, by how exactly periods are written."""
CODE = ("fine_first", "inverted", "plain_binary")


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
        """Return what is said of it as one line."""
        return f"{self.about}: {self.text}"


def told(about: str, fits: bool, text: str) -> ExaminedAssumption:
    """Return an assumption that fits if it could have failed, else one that nothing could tell."""
    return ExaminedAssumption(about, Outcome.FITS if fits else Outcome.UNCHECKED, text)


def wrong(about: str, text: str, **instead: Any) -> ExaminedAssumption:
    """Return an assumption that the images contradict."""
    return ExaminedAssumption(about, Outcome.WRONG, text, instead)


def corrected(axis: AxisConvention, text: str, **instead: Any) -> ExaminedAssumption:
    """Return that words of a direction are wrong, and behind ``text`` which ones fit instead."""
    said = []
    for name, value in instead.items():
        if value != getattr(axis, name):
            word, written = word_for(name, value)
            said.append(f"{axis.name}.{word} = {toml_value(written, 6)}")
    return wrong(said[0].split(" ")[0], f"{text} {' and '.join(said)}", **instead)


def examine_axis(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Test all that is assumed of one direction on one camera's images."""
    found = camera.measured[axis.name]
    said = _steps(found, axis)
    if found.bits is None:
        return [*said, *_periods(found, axis, camera.placed[axis.name].coordinate_px)]
    usable, bits = _along(found.usable, axis), _along(found.bits.bits, axis)
    both = usable[:, 1:] & usable[:, :-1]
    code = _code(bits, both, axis)
    if found.turns and all(one.outcome is not Outcome.WRONG for one in code):
        code += _phase_against_code(found, bits, usable, both, axis)
    if count := sum(found.bits.left_out):
        text = f"{count} of {axis.bits} images of the code have stripes that the camera cannot tell apart, and are left out: stripes of"
        said.append(told(f"{axis.name}.stripe_px", False, f"{text} {axis.stripe_px * 2**count:g} px are used"))
    return [*said, *code]


def examine_references(camera: DecodedCamera) -> list[ExaminedAssumption]:
    """Test whether bright and dark are what their names say."""
    bright, dark = camera.images.image(Shows.BRIGHT), camera.images.image(Shows.DARK)
    if bright is None or dark is None:
        return []
    light = float(bright.mean()) - float(dark.mean())
    if light < 0.0:
        return [wrong("images.order: bright dark", "they are exchanged: write dark bright where it has bright dark")]
    return [told("images.order: bright dark", True, f"the first is brighter by {light:.0f} grey values")]


# -------------------------------------------------------------------------------------------------- code


def _along(values: NDArray[Any], axis: AxisConvention) -> NDArray[Any]:
    """Return every so many rows of maps (…, h, w), or columns, as lines (…, n, length) along the direction."""
    step = max(1, values.shape[-1] * values.shape[-2] // SAMPLES)
    lines = values if axis.name == "x" else np.swapaxes(values, -1, -2)
    return np.ascontiguousarray(lines[..., step // 2 :: step, :])


def _wide_enough(bits: NDArray[np.bool_], both: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return bits without the images at either end whose stripes are hardly wider than a pixel: numbers leap at their
    borders."""
    pixels = np.count_nonzero(both)
    wide = [bool(LEAST_RUN_PX * np.count_nonzero(np.diff(bit, axis=1) & both) <= pixels) for bit in bits]
    return bits[wide.index(True) : len(wide) - wide[::-1].index(True)] if sum(wide) >= LEAST_BITS else bits


def _code(all_bits: NDArray[np.bool_], both: NDArray[np.bool_], axis: AxisConvention) -> list[ExaminedAssumption]:
    """Test in which order the bits of lines are, where ``both`` a pixel and the next one are usable."""
    names = [f"{axis.name}.{word_for(word, True)[0]}" for word in CODE]
    said = tuple(getattr(axis, word) for word in CODE)
    bits, changes = _wide_enough(all_bits, both), 0
    shares: dict[tuple[bool, ...], float] = {}
    for flags in product((False, True), repeat=len(CODE)):
        other: dict[str, Any] = dict(zip(CODE, flags, strict=True))
        step = np.abs(np.diff(stripe_numbers(bits, replace(axis, **other)), axis=1)[both])
        # Whatever the convention, a number changes where a bit does.
        changes = int(np.count_nonzero(step))
        shares[flags] = float(np.count_nonzero(step == 1) / max(1, changes))
    if changes < LEAST_CHANGES or axis.bits < LEAST_BITS:
        text = f"{changes} borders of stripes are seen; {LEAST_CHANGES} of {LEAST_BITS} images are needed"
        return [told(about, False, text) for about in names]
    share = shares[said]
    here = f"{100 * share:.0f} % of {changes} borders are between neighbouring stripes"
    if share < GOOD_CODE:
        # Of several that fit alike, the one nearest to what was said.
        best = max(shares, key=lambda one: (shares[one], -np.not_equal(one, said).sum()))
        if shares[best] <= share + CLEARLY_BETTER:
            return [wrong(names[0], f"{here}; no order of the bits fits: check which images are gray, and their order")]
        return [corrected(axis, f"{here}, {100 * shares[best]:.0f} % with", **dict(zip(CODE, best, strict=True)))]
    found = []
    for k, word in enumerate(CODE):
        rival = max(shares[one] for one in shares if one[k] != said[k])
        name, written = word_for(word, not said[k])
        text = f"{here}, {100 * rival:.0f} % with {name} = {toml_value(written)}"
        found.append(told(names[k], rival <= share - CLEARLY_BETTER, text))
    return found


# ------------------------------------------------------------------------------------------ phase against code


def _phase_against_code(
    found: Measured, bits: NDArray[np.bool_], usable: NDArray[np.bool_], both: NDArray[np.bool_], axis: AxisConvention
) -> list[ExaminedAssumption]:
    """Test whether the phase of the period that the code numbers runs along with the code of lines."""
    assert found.bits is not None
    period = axis.periods_px[axis.numbered]
    words = [f"{axis.name}.{word}" for word in ("sign", "stripe_px", "start_deg")]
    whole, stripe = numbered_stripes(bits, found.bits.left_out, axis)
    number = whole.astype(np.float32)
    changes = np.count_nonzero((np.diff(number, axis=1) != 0) & both)
    # Two stripes are so wide in this image.
    size = (2 * round(np.count_nonzero(both) / max(1, int(changes))) + 1, 1)
    middle = (number + np.float32(0.5)) * np.float32(stripe) + np.float32(axis.code_offset_px)
    mean = cv2.boxFilter(middle, -1, size, borderType=cv2.BORDER_REFLECT)
    full = cv2.boxFilter(usable.astype(np.float32), -1, size, borderType=cv2.BORDER_CONSTANT) > np.float32(0.999)
    good = full & (np.abs(middle - mean) < np.float32(0.75 * stripe))
    if changes < LEAST_CHANGES or np.count_nonzero(good) < 10 * LEAST_CHANGES:
        return [told(word, False, f"{changes} borders of stripes are seen, which is too few") for word in words]
    turns = _along(found.turns[axis.numbered], axis)[good].astype(np.float64)
    coordinate = mean[good].astype(np.float64)
    sums = {
        (sign, factor): np.exp(2j * np.pi * (sign * turns - factor * coordinate / period)).mean()
        for sign in (1, -1)
        for factor in (1.0, 0.5, 2.0)
    }
    fits = {one: float(abs(sum_)) for one, sum_ in sums.items()}
    best, fit = max(fits, key=lambda one: fits[one]), fits[1, 1.0]
    if fit < POOR_FIT and fits[best] > GOOD_FIT:
        text = f"R of phase and code is {fit:.2f}, and {fits[best]:.2f} with"
        return [corrected(axis, text, sign=best[0] * axis.sign, stripe_px=best[1] * axis.stripe_px)]
    if fit < POOR_FIT:
        text = f"phase and code do not belong together (R = {fit:.2f}; other signs and stripes of half and double width fit no better)"
        return [wrong(f"{axis.name}.period_px", f"{text}: check it, the order of the steps, and which images are gray")]
    rivals = fits[-1, 1.0], max(fits[1, 0.5], fits[1, 2.0])
    said = [
        told(word, rival < POOR_FIT, f"R of phase and code is {fit:.2f}, {rival:.2f} with another one")
        for word, rival in zip(words, rivals, strict=False)
    ]
    away = float(np.angle(sums[1, 1.0])) / (2.0 * np.pi) - axis.begins_deg[axis.numbered] / 360.0
    away -= round(away)
    text = f"phase and code are {360 * abs(away):.0f} degrees apart"
    if abs(away) <= MOST_START:
        return [*said, told(words[2], True, text)]
    start_deg = round((axis.start_deg + 360.0 * away) / START_DEG) * START_DEG % 360.0
    if abs(away) <= HALF_OFF:
        return [*said, corrected(axis, f"{text}: they fit with", start_deg=start_deg)]
    offset_px = axis.code_offset_px + (0.5 * period if axis.code_offset_px < 0.0 else -0.5 * period)
    text = f"{text}: they fit with {words[2]} = {start_deg:g}, or"
    return [*said, corrected(axis, text, code_offset_px=offset_px)]


# ------------------------------------------------------------------------------------------------ steps, periods


def _steps(found: Measured, axis: AxisConvention) -> list[ExaminedAssumption]:
    about = f"{axis.name}.steps"
    few, said = _few(some_pixels(found.usable)), list[ExaminedAssumption]()
    for images, steps_deg in zip(found.sines, axis.signed_deg, strict=False):
        if len(images) != len(steps_deg) or len(images) < 4 or not few.size:
            said += [] if said else [told(about, False, "three steps fit any images")]
            continue
        stack = images[:, few].astype(np.float64)
        left = misfit(stack, steps_deg)
        here = f"a sine with these steps leaves {100 * left:.0f} % of the modulation"
        if left <= MOST_MISFIT:
            said.append(told(about, True, here))
        if left <= BENT:
            continue
        count, measured = len(images) - 1, measured_steps(stack)
        for end, others in (("first", stack[1:]), ("last", stack[:-1])) if count > 3 else ():
            if (rest := misfit(others, equal_steps(count))) < 0.5 * left:
                text = f"{here}; without the {end} of its images, steps = {count} leaves {100 * rest:.0f} %"
                said.append(wrong("images.order", text))
        better = misfit(stack, measured)
        if left > MOST_MISFIT and better < min(0.5 * left, MOST_MISFIT):
            steps = f"{axis.name}.steps_deg = [{', '.join(f'{step:g}' for step in measured)}]"
            said.append(wrong(about, f"{here}; {steps} leaves {100 * better:.0f} %"))
        elif left > MOST_MISFIT:
            said.append(wrong(about, f"{here}; no other steps fit: check which images are sine-{axis.name}"))
    share = found.misfit_share or 0.0
    if max(share, 4.0 * np.pi * found.bend_turns) > BENT:
        sines = f", sines leave {100 * share:.0f} %" if share else ""
        text = (
            f"it is bent: phases are {360 * found.bend_turns:.1f}° off{sines}, which the error of each point includes"
        )
        said.append(told(f"response of {axis.name}", False, text))
    return said


def _few(usable: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the places of a few usable pixels."""
    places = np.flatnonzero(usable)
    return places[:: max(1, places.size // FEW)]


def misfit(stack: NDArray[np.float64], steps_deg: tuple[float, ...]) -> float:
    """Return the root mean square that the best sines leave of images (n, pixels), as a share of their modulation."""
    columns = step_columns(steps_deg)
    values = np.linalg.pinv(columns) @ stack
    left = np.sqrt(np.square(stack - columns @ values).sum(axis=0) / max(1, len(columns) - 3))
    return float(np.median(left / np.maximum(np.hypot(values[1], values[2]), 1e-6)))


def measured_steps(stack: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the steps of images (n, pixels) by their own principal components, beginning with 0; their sign cannot be
    told."""
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
    few = _few(found.usable)
    if len(axis.periods_px) == 1 or not few.size:
        return [told(about, False, "one fringe covers the pattern, or no pixel is bright: nothing contradicts it")]
    goes_on = _goes_on(coordinate_px, axis)
    leaps = f"the coordinate goes on at {100 * goes_on:.0f} % of the borders of fringes"
    if axis.micro:
        return [told(about, goes_on >= GOES_ON, leaps)]

    def placed(**changed: Any) -> tuple[Floats, Floats]:
        """Return coordinates of a few pixels by another convention, and how far their phases are apart."""
        other = replace(axis, **changed)
        sign = np.float32(other.sign * axis.sign)
        return by_periods([sign * one.ravel()[few] for one in found.turns], other)

    def left(changed: Mapping[str, Any]) -> float:
        return float(np.median(placed(**changed)[1]))

    chance, here = chance_misfit(axis), left({})
    whole_px, apart = placed(size_px=_unrepeated_px(axis))
    if np.median(apart) < GOOD_OF_CHANCE * chance and (said := beyond(axis, whole_px)):
        return said
    text = f"their phases are {360 * here:.1f}° apart"
    if here < GOOD_OF_CHANCE * chance:
        return [told(about, True, f"{text}; by chance it would be {360 * chance:.1f}°")]
    orders = permutations(axis.periods_px) if len(axis.periods_px) <= 4 else [axis.periods_px[::-1]]
    starts = product((axis.sign, -axis.sign), np.arange(0.0, 360.0, START_DEG).tolist())
    for tried in (
        [{"periods_px": one} for one in orders],
        [{"sign": one, "start_deg": start} for one, start in starts],
    ):
        lefts = [left(one) * (NEARLY if one.get("sign", axis.sign) != axis.sign else 1.0) for one in tried]
        k = int(np.argmin(lefts))
        if lefts[k] < min(GOOD_OF_CHANCE * chance, 0.6 * here):
            return [corrected(axis, f"{text}, and {360 * lefts[k]:.1f}° with", **tried[k])]
    # A bent response moves the phase of a coarse period by as much as a fine one has fringes in it: then each fringe
    # must follow the last.
    text += f", and would be {360 * chance:.1f}° by chance; {leaps}"
    if goes_on < GOES_ON and here > POOR_OF_CHANCE * chance and (goes_on < LEAPS or len(axis.periods_px) > 2):
        return [wrong(about, f"{text}: check it or {axis.name}.fringes, and the order of the images")]
    return [told(about, goes_on >= GOES_ON, text)]


def _unrepeated_px(axis: AxisConvention) -> float:
    """Return the length, at least the pattern's, up to which its phases come back nowhere together; of long ones, twice
    the pattern's."""
    ends_px = axis.period_px * np.arange(
        np.ceil(axis.size_px / axis.period_px - SAME_TURNS), 2.0 * axis.size_px / axis.period_px
    )
    turns = ends_px[:, None] / np.array(axis.periods_px)
    again = np.abs(turns - np.rint(turns)).max(axis=1) < SAME_TURNS
    return max(axis.size_px, float(min(ends_px[again], default=2.0 * axis.size_px)))


def beyond(axis: AxisConvention, coordinate_px: Floats) -> list[ExaminedAssumption]:
    """Return that the projector is larger than it is said to be, where more coordinates than a few lie beyond it."""
    known = coordinate_px[np.isfinite(coordinate_px)]
    share = float(np.mean(known > axis.size_px + axis.period_px)) if known.size else 0.0
    if share <= MOST_BEYOND:
        return []
    size_px = axis.covered_px[1] if axis.bits else float(np.quantile(known, 0.999)) + 0.5
    stretched = f"{axis.name}.{'period_px' if axis.periods_px else 'stripe_px'}"
    upto = f"{'the code covers' if axis.bits else 'they go on to'} {size_px:.0f} px, or {stretched} is too long"
    text = f"{100 * share:.0f} % of the coordinates lie beyond it: {upto}"
    return [wrong(f"projector.{'width' if axis.name == 'x' else 'height'}_px", text)]


def _goes_on(coordinate_px: Floats, axis: AxisConvention) -> float:
    """Return the share of the borders of fringes, along the direction, at which the coordinate goes on; NaN where too
    few are seen."""
    along = coordinate_px if axis.name == "x" else coordinate_px.T
    with np.errstate(invalid="ignore"):
        border = np.diff(np.floor((along + np.float32(0.5)) / np.float32(axis.period_px)), axis=1)
    known = np.isfinite(border) & (border != 0)
    step = np.abs(np.diff(along, axis=1)[known])
    return float(np.mean(step < 0.5 * axis.period_px)) if step.size >= LEAST_CHANGES else np.nan
