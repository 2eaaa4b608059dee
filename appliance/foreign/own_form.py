"""Owns which foreign sets are scans of our own form: what ``PatternSequence`` promises, if the images are put into another order.

Such a set becomes a scan folder that everything else accepts; of any other one the reason is said, and there is a cloud.
"""

from __future__ import annotations

from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from appliance.foreign.description import AxisConvention, Description
from appliance.foreign.images import ImageSet
from appliance.foreign.order import Shows
from appliance.patterns.sequence import Kind, PatternSequence, build_sequence

_TOLERANCE_DEG = 0.5


def own_sequence(description: Description, images: ImageSet) -> PatternSequence | str:
    """Return the sequence that a set keeps, or why there is none, in words."""
    if "right" not in description.files:
        return "there is no second camera"
    if description.one_direction:
        return f"it has fringes of one direction only, {description.axes[0].name}"
    if images.images.dtype != np.uint8:
        return "its images have 16 bits"
    if images.find(Shows.BRIGHT) is None or images.find(Shows.DARK) is None:
        return "it has no bright and dark image"
    for axis in description.axes:
        reason = _other_form(axis)
        if reason is not None:
            return f"{axis.name}: {reason}"
    periods = {axis.period_px for axis in description.axes}
    if len(periods) != 1:
        return "its two directions have different periods"
    try:
        sequence = build_sequence(round(periods.pop()), *description.projector_px)
    except ValueError as error:
        return str(error)
    for axis, wanted in zip(description.axes, ("x", "y"), strict=True):
        needed = sum(one.kind is Kind.GRAY and one.direction.value == wanted for one in sequence.patterns)
        if axis.bits < needed:
            return f"{axis.name}: {axis.bits} images of its code, and {needed} are needed"
    return sequence


def own_frames(sequence: PatternSequence, description: Description, images: ImageSet) -> NDArray[np.uint8]:
    """Return one camera's images (n, h, w) uint8 in the order of ``sequence``, which ``own_sequence`` has found."""
    frames = []
    for pattern in sequence.patterns:
        match pattern.kind:
            case Kind.BRIGHT | Kind.DARK:
                frames.append(images.image(Shows.BRIGHT if pattern.kind is Kind.BRIGHT else Shows.DARK))
            case Kind.GRAY | Kind.SINE:
                axis = next(one for one in description.axes if one.name == pattern.direction.value)
                if pattern.kind is Kind.SINE:
                    frames.append(images.image(Shows.SINE, axis.name, _steps(axis).index(90 * pattern.index)))
                    continue
                mine = [
                    one for one in sequence.patterns if one.kind is Kind.GRAY and one.direction is pattern.direction
                ]
                # Images before the most significant bit that is needed are dark all over.
                bit = axis.bits - len(mine) + pattern.index
                frames.append(images.image(Shows.GRAY, axis.name, axis.bits - 1 - bit if axis.fine_first else bit))
            case unknown:
                assert_never(unknown)
    return np.stack([one for one in frames if one is not None])


def _steps(axis: AxisConvention) -> list[int]:
    """Return what each image adds to our phase, in whole degrees 0 to 359."""
    return [round(axis.start_deg + step) % 360 for step in axis.signed_deg[0]]


def _other_form(axis: AxisConvention) -> str | None:
    if len(axis.periods_px) != 1:
        return f"it has {len(axis.periods_px)} periods"
    if axis.period_px != round(axis.period_px):
        return f"its period is {axis.period_px:g} px, no whole number"
    exact = [axis.start_deg + step for step in axis.signed_deg[0]]
    if sorted(_steps(axis)) != [0, 90, 180, 270] or any(abs(one - round(one)) > _TOLERANCE_DEG for one in exact):
        return f"its {len(exact)} steps are not the four of 0°, 90°, 180°, 270°"
    if not axis.bits:
        return "it has no Gray code"
    if axis.plain_binary or axis.inverted:
        return "its code is plain binary, or inverted"
    if axis.stripe_px != 0.5 * axis.period_px or axis.code_offset_px != 0.0:
        return "its code does not number half periods from the edge of the pattern"
    return None
