"""Tests of an image set description against the images of one camera, with corrections.

*Code*: from one pixel to the next a stripe number changes by one, or not at all; in another order of the bits it leaps.
*Phase against code*: over two whole stripes the mean of their numbers is the coordinate to a fraction of a period. The phase
runs along with it, R = |mean exp 2πi(turns − mean)| near 1, or against it; the angle of that mean is the start of the phase.
*Steps*: least squares leaves small residuals; else the first two principal components of the images give their steps.
*Periods*: the phases of all periods agree on a coordinate much better than unrelated phases would on the best of all
fringes, or the coordinate continues from one fringe to the next.
*Size*: hardly a pixel has a coordinate beyond the pattern.
A test that could not have failed is no fit: its statement stays unchecked, with the reason.
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
from appliance.desk.foreign.code import LEAST_BITS, number_stripes, stripe_numbers
from appliance.desk.foreign.decode import AxisMeasurement, chance_misfit, place_by_periods
from appliance.desk.foreign.description import AxisConvention, equal_steps, toml_value, word_for
from appliance.desk.foreign.order import Shows
from appliance.desk.foreign.phase import Floats, some_pixels, step_columns

SAMPLES = 400_000
"""Number of pixels that are tested, in whole lines along the direction."""
LEAST_RUN_PX = 3.0
"""Least mean distance of the stripe borders in an image of the code that counts for the order of the bits."""
LEAST_CHANGES = 200
"""Least number of stripe borders for a conclusion."""
CLEARLY_BETTER, GOOD_CODE = 0.25, 0.6
"""A convention of the code is wrong where the share of its borders between neighbouring numbers is below the second
value and another convention has more by the first."""
GOOD_FIT, POOR_FIT = 0.6, 0.45
"""R above which phase and code belong together, and below which they do not."""
MOST_START, HALF_OFF = 0.09, 0.38
"""Largest error of the start of the phase, in turns; and the error above which the code is half a period off."""
MOST_MISFIT, BENT = 0.6, 0.15
"""Largest misfit of the steps as a share of the modulation: a bent response of the projector alone makes up to a half.
Above the second value the report has a line about it."""
GOOD_OF_CHANCE, POOR_OF_CHANCE, GOES_ON, LEAPS = 0.45, 0.8, 0.7, 0.15
"""Disagreement of the phases of several periods over that of unrelated phases: good below the first value, wrong above
the second. Share of fringe borders at which the coordinate continues: that of right periods, and that of wrong ones."""
FEW, START_DEG, NEARLY = 3000, 5, 1.3
"""Number of pixels on which steps and starts of phases are tried; the increment of the tried starts; and the factor by
which the other sign must be better, since a mirrored pattern makes the same points with two cameras."""
MOST_BEYOND = 0.02
"""Largest share of coordinates beyond the pattern: rightly described sets have a quarter of a percent."""
SAME_TURNS = 0.02
"""Difference in turns of phases that count as equal, since periods are written with few digits."""
CODE = ("fine_first", "inverted", "plain_binary")


class Outcome(Enum):
    """Outcomes of a test."""

    FITS = "fits"
    """It could have failed, and did not."""
    WRONG = "wrong"
    UNCHECKED = "unchecked"
    """No test could tell."""


@dataclass(frozen=True, slots=True)
class ExaminedAssumption:
    """One statement of a description with the result of its test."""

    subject: str
    """The key of the description: ``x.sign``."""
    outcome: Outcome
    text: str
    """The result; of a wrong statement also the correction, of an unchecked one the reason."""
    corrections: Mapping[str, Any] = field(default_factory=dict)
    """Values that fit, by field of the direction's convention; empty if no value does."""

    def __str__(self) -> str:
        """Return the statement and its result as one line."""
        return f"{self.subject}: {self.text}"


def fits_or_unchecked(subject: str, fits: bool, text: str) -> ExaminedAssumption:
    """Return an assumption that fits if its test could have failed, else one that is unchecked."""
    return ExaminedAssumption(subject, Outcome.FITS if fits else Outcome.UNCHECKED, text)


def contradiction(subject: str, text: str, **corrections: Any) -> ExaminedAssumption:
    """Return an assumption that the images contradict."""
    return ExaminedAssumption(subject, Outcome.WRONG, text, corrections)


def correction(axis: AxisConvention, text: str, **corrections: Any) -> ExaminedAssumption:
    """Return the contradiction of a direction's values that the values of ``corrections`` replace."""
    lines = []
    for name, value in corrections.items():
        if value != getattr(axis, name):
            word, written = word_for(name, value)
            lines.append(f"{axis.name}.{word} = {toml_value(written, 6)}")
    return contradiction(lines[0].split(" ")[0], f"{text} {' and '.join(lines)}", **corrections)


def examine_axis(camera: DecodedCamera, axis: AxisConvention) -> list[ExaminedAssumption]:
    """Run all tests of one direction on the images of one camera."""
    measured = camera.measured[axis.name]
    results = _check_steps(measured, axis)
    if measured.bits is None:
        return [*results, *_check_periods(measured, axis, camera.placed[axis.name].coordinate_px)]
    usable, bits = _lines_along(measured.usable, axis), _lines_along(measured.bits.bits, axis)
    both_usable = usable[:, 1:] & usable[:, :-1]
    code = _check_code(bits, both_usable, axis)
    if measured.turns and all(assumption.outcome is not Outcome.WRONG for assumption in code):
        code += _check_phase_against_code(measured, bits, usable, both_usable, axis)
    if count := sum(measured.bits.left_out):
        text = (
            f"{count} of {axis.bits} images of the code have stripes that the camera does not resolve, and are "
            "left out: stripes of"
        )
        results.append(
            fits_or_unchecked(f"{axis.name}.stripe_px", False, f"{text} {axis.stripe_px * 2**count:g} px are used")
        )
    return [*results, *code]


def examine_references(camera: DecodedCamera) -> list[ExaminedAssumption]:
    """Test whether the bright frame is brighter than the dark frame."""
    bright, dark = camera.images.image(Shows.BRIGHT), camera.images.image(Shows.DARK)
    if bright is None or dark is None:
        return []
    light = float(bright.mean()) - float(dark.mean())
    if light < 0.0:
        return [
            contradiction(
                "images.order: bright dark", "bright and dark are exchanged; write dark bright in place of bright dark"
            )
        ]
    return [fits_or_unchecked("images.order: bright dark", True, f"the first is brighter by {light:.0f} grey values")]


# -------------------------------------------------------------------------------------------------- code


def _lines_along(values: NDArray[Any], axis: AxisConvention) -> NDArray[Any]:
    """Return every n-th row or column of maps (…, h, w) as lines (…, n, length) along the direction."""
    step = max(1, values.shape[-1] * values.shape[-2] // SAMPLES)
    lines = values if axis.name == "x" else np.swapaxes(values, -1, -2)
    return np.ascontiguousarray(lines[..., step // 2 :: step, :])


def _wide_enough(bits: NDArray[np.bool_], both_usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return bits without the images at either end whose stripes are hardly wider than a pixel.

    There numbers leap at the borders.
    """
    pixels = np.count_nonzero(both_usable)
    wide = [bool(LEAST_RUN_PX * np.count_nonzero(np.diff(bit, axis=1) & both_usable) <= pixels) for bit in bits]
    return bits[wide.index(True) : len(wide) - wide[::-1].index(True)] if sum(wide) >= LEAST_BITS else bits


def _check_code(
    all_bits: NDArray[np.bool_], both_usable: NDArray[np.bool_], axis: AxisConvention
) -> list[ExaminedAssumption]:
    """Test the order of the bits on lines.

    ``both_usable`` marks pixels that are usable and whose next one is.
    """
    names = [f"{axis.name}.{word_for(word, True)[0]}" for word in CODE]
    described = tuple(getattr(axis, word) for word in CODE)
    bits, changes = _wide_enough(all_bits, both_usable), 0
    shares: dict[tuple[bool, ...], float] = {}
    for flags in product((False, True), repeat=len(CODE)):
        convention: dict[str, Any] = dict(zip(CODE, flags, strict=True))
        step = np.abs(np.diff(stripe_numbers(bits, replace(axis, **convention)), axis=1)[both_usable])
        # In any convention, a number changes where a bit does.
        changes = int(np.count_nonzero(step))
        shares[flags] = float(np.count_nonzero(step == 1) / max(1, changes))
    if changes < LEAST_CHANGES or axis.bits < LEAST_BITS:
        text = f"{changes} borders of stripes are found; {LEAST_CHANGES} of {LEAST_BITS} images are needed"
        return [fits_or_unchecked(subject, False, text) for subject in names]
    share = shares[described]
    share_text = f"{100 * share:.0f} % of {changes} borders lie between neighbouring stripes"
    if share < GOOD_CODE:
        # Of several that fit alike, the one nearest to the description.
        best = max(shares, key=lambda candidate: (shares[candidate], -np.not_equal(candidate, described).sum()))
        if shares[best] <= share + CLEARLY_BETTER:
            return [
                contradiction(
                    names[0], f"{share_text}; no order of the bits fits: check which images are gray, and their order"
                )
            ]
        return [
            correction(axis, f"{share_text}, {100 * shares[best]:.0f} % with", **dict(zip(CODE, best, strict=True)))
        ]
    results = []
    for k, word in enumerate(CODE):
        rival = max(shares[candidate] for candidate in shares if candidate[k] != described[k])
        name, written = word_for(word, not described[k])
        text = f"{share_text}, {100 * rival:.0f} % with {name} = {toml_value(written)}"
        results.append(fits_or_unchecked(names[k], rival <= share - CLEARLY_BETTER, text))
    return results


# ------------------------------------------------------------------------------------------ phase against code


def _check_phase_against_code(
    measured: AxisMeasurement,
    bits: NDArray[np.bool_],
    usable: NDArray[np.bool_],
    both_usable: NDArray[np.bool_],
    axis: AxisConvention,
) -> list[ExaminedAssumption]:
    """Test whether the phase of the period that the code numbers runs along with the code of lines."""
    assert measured.bits is not None
    period = axis.periods_px[axis.numbered]
    keys = [f"{axis.name}.{word}" for word in ("sign", "stripe_px", "start_deg")]
    stripe_number, stripe = number_stripes(bits, measured.bits.left_out, axis)
    number = stripe_number.astype(np.float32)
    changes = np.count_nonzero((np.diff(number, axis=1) != 0) & both_usable)
    # Two stripes are so wide in this image.
    size = (2 * round(np.count_nonzero(both_usable) / max(1, int(changes))) + 1, 1)
    middle = (number + np.float32(0.5)) * np.float32(stripe) + np.float32(axis.code_offset_px)
    mean = cv2.boxFilter(middle, -1, size, borderType=cv2.BORDER_REFLECT)
    full = cv2.boxFilter(usable.astype(np.float32), -1, size, borderType=cv2.BORDER_CONSTANT) > np.float32(0.999)
    good = full & (np.abs(middle - mean) < np.float32(0.75 * stripe))
    if changes < LEAST_CHANGES or np.count_nonzero(good) < 10 * LEAST_CHANGES:
        return [
            fits_or_unchecked(word, False, f"{changes} borders of stripes are found, which is too few") for word in keys
        ]
    turns = _lines_along(measured.turns[axis.numbered], axis)[good].astype(np.float64)
    coordinate = mean[good].astype(np.float64)
    sums = {
        (sign, factor): np.exp(2j * np.pi * (sign * turns - factor * coordinate / period)).mean()
        for sign in (1, -1)
        for factor in (1.0, 0.5, 2.0)
    }
    fits = {key: float(abs(sum_)) for key, sum_ in sums.items()}
    best, fit = max(fits, key=lambda key: fits[key]), fits[1, 1.0]
    if fit < POOR_FIT and fits[best] > GOOD_FIT:
        text = f"the correlation of phase and code is {fit:.2f}, and {fits[best]:.2f} with"
        return [correction(axis, text, sign=best[0] * axis.sign, stripe_px=best[1] * axis.stripe_px)]
    if fit < POOR_FIT:
        text = (
            f"phase and code do not correlate (R = {fit:.2f}; other signs and stripes of half and double width "
            "fit no better)"
        )
        return [
            contradiction(
                f"{axis.name}.period_px", f"{text}: check it, the order of the steps, and which images are gray"
            )
        ]
    rivals = fits[-1, 1.0], max(fits[1, 0.5], fits[1, 2.0])
    results = [
        fits_or_unchecked(
            word, rival < POOR_FIT, f"the correlation of phase and code is {fit:.2f}, {rival:.2f} with another one"
        )
        for word, rival in zip(keys, rivals, strict=False)
    ]
    off_turns = float(np.angle(sums[1, 1.0])) / (2.0 * np.pi) - axis.begins_deg[axis.numbered] / 360.0
    off_turns -= round(off_turns)
    text = f"phase and code are {360 * abs(off_turns):.0f} degrees apart"
    if abs(off_turns) <= MOST_START:
        return [*results, fits_or_unchecked(keys[2], True, text)]
    start_deg = round((axis.start_deg + 360.0 * off_turns) / START_DEG) * START_DEG % 360.0
    if abs(off_turns) <= HALF_OFF:
        return [*results, correction(axis, f"{text}: they fit with", start_deg=start_deg)]
    offset_px = axis.code_offset_px + (0.5 * period if axis.code_offset_px < 0.0 else -0.5 * period)
    text = f"{text}: they fit with {keys[2]} = {start_deg:g}, or"
    return [*results, correction(axis, text, code_offset_px=offset_px)]


# ------------------------------------------------------------------------------------------------ steps, periods


def _check_steps(measured: AxisMeasurement, axis: AxisConvention) -> list[ExaminedAssumption]:
    subject = f"{axis.name}.steps"
    places, results = _sample_places(some_pixels(measured.usable)), list[ExaminedAssumption]()
    for images, steps_deg in zip(measured.sines, axis.signed_deg, strict=False):
        if len(images) != len(steps_deg) or len(images) < 4 or not places.size:
            results += [] if results else [fits_or_unchecked(subject, False, "three steps fit any images")]
            continue
        stack = images[:, places].astype(np.float64)
        residual = misfit(stack, steps_deg)
        residual_text = f"a sine with these steps leaves {100 * residual:.0f} % of the modulation"
        if residual <= MOST_MISFIT:
            results.append(fits_or_unchecked(subject, True, residual_text))
        if residual <= BENT:
            continue
        count, estimated_deg = len(images) - 1, estimate_steps(stack)
        for end, part in (("first", stack[1:]), ("last", stack[:-1])) if count > 3 else ():
            if (residual_share := misfit(part, equal_steps(count))) < 0.5 * residual:
                text = f"{residual_text}; without the {end} of its images, steps = {count} leaves {100 * residual_share:.0f} %"
                results.append(contradiction("images.order", text))
        better = misfit(stack, estimated_deg)
        if residual > MOST_MISFIT and better < min(0.5 * residual, MOST_MISFIT):
            steps = f"{axis.name}.steps_deg = [{', '.join(f'{step:g}' for step in estimated_deg)}]"
            results.append(contradiction(subject, f"{residual_text}; {steps} leaves {100 * better:.0f} %"))
        elif residual > MOST_MISFIT:
            results.append(
                contradiction(subject, f"{residual_text}; no other steps fit: check which images are sine-{axis.name}")
            )
    share = measured.misfit_share or 0.0
    if max(share, 4.0 * np.pi * measured.bend_turns) > BENT:
        sines = f", sines leave {100 * share:.0f} %" if share else ""
        text = (
            f"it is not sinusoidal: phases are {360 * measured.bend_turns:.1f}° off{sines}, which the error of "
            "each point includes"
        )
        results.append(fits_or_unchecked(f"response of {axis.name}", False, text))
    return results


def _sample_places(usable: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the places of a few usable pixels."""
    places = np.flatnonzero(usable)
    return places[:: max(1, places.size // FEW)]


def misfit(stack: NDArray[np.float64], steps_deg: tuple[float, ...]) -> float:
    """Return the root mean square residual of the best sines in images (n, pixels), over their modulation."""
    columns = step_columns(steps_deg)
    values = np.linalg.pinv(columns) @ stack
    residual = np.sqrt(np.square(stack - columns @ values).sum(axis=0) / max(1, len(columns) - 3))
    return float(np.median(residual / np.maximum(np.hypot(values[1], values[2]), 1e-6)))


def estimate_steps(stack: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the steps of images (n, pixels) by their principal components, beginning with 0.

    Their sign cannot be told.
    """
    centred = stack - stack.mean(axis=0)
    _, vectors = np.linalg.eigh(centred @ centred.T)
    degrees = np.rad2deg(np.arctan2(vectors[:, -1], vectors[:, -2]))
    degrees = (degrees - degrees[0]) % 360.0
    count = len(degrees)
    equal_deg = np.rint(degrees * count / 360.0) * 360.0 / count
    # Nearly all sets have steps of equal size; noise of a degree is not worth writing down.
    are_equal = np.abs(degrees - equal_deg).max() < 100.0 / count and len(set((equal_deg % 360.0).tolist())) == count
    rounded = equal_deg % 360.0 if are_equal else np.round(degrees)
    # Take the sign that makes the first step off the axis less than half a turn.
    off_axis = rounded[(rounded % 180.0 > 1.0) & (rounded % 180.0 < 179.0)]
    if off_axis.size and off_axis[0] > 180.0:
        rounded = (-rounded) % 360.0
    return tuple(float(step) for step in rounded)


def _check_periods(measured: AxisMeasurement, axis: AxisConvention, coordinate_px: Floats) -> list[ExaminedAssumption]:
    subject = f"{axis.name}.period_px"
    places = _sample_places(measured.usable)
    if len(axis.periods_px) == 1 or not places.size:
        return [
            fits_or_unchecked(subject, False, "nothing to check: one fringe covers the pattern, or no pixel is bright")
        ]
    continuous = _continuous_share(coordinate_px, axis)
    leaps = f"the coordinate is continuous at {100 * continuous:.0f} % of the fringe borders"
    if axis.micro:
        return [fits_or_unchecked(subject, continuous >= GOES_ON, leaps)]

    def place_with(**changed: Any) -> tuple[Floats, Floats]:
        """Return the coordinates at ``places`` by another convention, and the disagreement of their phases."""
        convention = replace(axis, **changed)
        sign = np.float32(convention.sign * axis.sign)
        return place_by_periods([sign * phase.ravel()[places] for phase in measured.turns], convention)

    def disagreement(changed: Mapping[str, Any]) -> float:
        return float(np.median(place_with(**changed)[1]))

    chance, described = chance_misfit(axis), disagreement({})
    unrepeated_px, apart = place_with(size_px=_unambiguous_px(axis))
    if np.median(apart) < GOOD_OF_CHANCE * chance and (results := check_extent(axis, unrepeated_px)):
        return results
    text = f"their phases are {360 * described:.1f}° apart"
    if described < GOOD_OF_CHANCE * chance:
        return [fits_or_unchecked(subject, True, f"{text}; by chance it would be {360 * chance:.1f}°")]
    orders = permutations(axis.periods_px) if len(axis.periods_px) <= 4 else [axis.periods_px[::-1]]
    starts = product((axis.sign, -axis.sign), np.arange(0.0, 360.0, START_DEG).tolist())
    for changes in (
        [{"periods_px": periods_px} for periods_px in orders],
        [{"sign": other_sign, "start_deg": start} for other_sign, start in starts],
    ):
        disagreements = [
            disagreement(change) * (NEARLY if change.get("sign", axis.sign) != axis.sign else 1.0) for change in changes
        ]
        k = int(np.argmin(disagreements))
        if disagreements[k] < min(GOOD_OF_CHANCE * chance, 0.6 * described):
            return [correction(axis, f"{text}, and {360 * disagreements[k]:.1f}° with", **changes[k])]
    # A bent response moves the phase of a coarse period by as much as a fine one has fringes in it: then each fringe
    # must follow the last.
    text += f", and would be {360 * chance:.1f}° by chance; {leaps}"
    if (
        continuous < GOES_ON
        and described > POOR_OF_CHANCE * chance
        and (continuous < LEAPS or len(axis.periods_px) > 2)
    ):
        return [contradiction(subject, f"{text}: check it or {axis.name}.fringes, and the order of the images")]
    return [fits_or_unchecked(subject, continuous >= GOES_ON, text)]


def _unambiguous_px(axis: AxisConvention) -> float:
    """Return the length, at least the pattern's, within which the phases never repeat together.

    Lengths beyond twice the pattern's count as that.
    """
    ends_px = axis.period_px * np.arange(
        np.ceil(axis.size_px / axis.period_px - SAME_TURNS), 2.0 * axis.size_px / axis.period_px
    )
    turns = ends_px[:, None] / np.array(axis.periods_px)
    repeats = np.abs(turns - np.rint(turns)).max(axis=1) < SAME_TURNS
    return max(axis.size_px, float(min(ends_px[repeats], default=2.0 * axis.size_px)))


def check_extent(axis: AxisConvention, coordinate_px: Floats) -> list[ExaminedAssumption]:
    """Return a contradiction of the projector's size if too many coordinates lie beyond it."""
    finite_px = coordinate_px[np.isfinite(coordinate_px)]
    share = float(np.mean(finite_px > axis.size_px + axis.period_px)) if finite_px.size else 0.0
    if share <= MOST_BEYOND:
        return []
    size_px = axis.covered_px[1] if axis.bits else float(np.quantile(finite_px, 0.999)) + 0.5
    stretched = f"{axis.name}.{'period_px' if axis.periods_px else 'stripe_px'}"
    extent_text = (
        f"{'the code covers' if axis.bits else 'the fringes reach'} {size_px:.0f} px, or {stretched} is too long"
    )
    text = f"{100 * share:.0f} % of the coordinates lie beyond the pattern: {extent_text}"
    return [contradiction(f"projector.{'width' if axis.name == 'x' else 'height'}_px", text)]


def _continuous_share(coordinate_px: Floats, axis: AxisConvention) -> float:
    """Return the share of fringe borders, along the direction, at which the coordinate continues.

    NaN where too few are seen.
    """
    along = coordinate_px if axis.name == "x" else coordinate_px.T
    with np.errstate(invalid="ignore"):
        border = np.diff(np.floor((along + np.float32(0.5)) / np.float32(axis.period_px)), axis=1)
    at_border = np.isfinite(border) & (border != 0)
    step = np.abs(np.diff(along, axis=1)[at_border])
    return float(np.mean(step < 0.5 * axis.period_px)) if step.size >= LEAST_CHANGES else np.nan
