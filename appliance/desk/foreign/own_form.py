"""Owns which foreign sets are scans of our own form: what ``PatternSequence`` promises, if the images are put into
another order.

Such a set becomes a scan folder that everything else accepts; of any other one the reason is said, and there is a
cloud.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.description import AxisConvention, Description
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import Shows
from appliance.measure import Direction, PatternSequence, build_sequence

_FOUR_DEG = [0, 90, 180, 270]


def own_sequence(description: Description, images: ImageSet) -> PatternSequence | str:
    """Return the sequence that a set keeps, or why there is none, in words."""
    if "right" not in description.files:
        return "there is no second camera"
    if description.one_direction:
        return f"it has fringes of one direction only, {description.axes[0].name}"
    if images.images.dtype != np.uint8:
        return "its images have 16 bits"
    if not {Shows.BRIGHT, Shows.DARK} <= {one.shows for one in images.shown}:
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
    for axis in description.axes:
        needed = _bits(sequence, axis)
        if axis.bits < needed:
            return f"{axis.name}: {axis.bits} images of its code, and {needed} are needed"
    return sequence


def own_frames(sequence: PatternSequence, description: Description, images: ImageSet) -> NDArray[np.uint8]:
    """Return one camera's images (n, h, w) uint8 in the order of ``sequence``, which ``own_sequence`` has found."""
    frames = [images.image(Shows.BRIGHT), images.image(Shows.DARK)]
    for axis in description.axes:
        bits = range(axis.bits)[::-1] if axis.fine_first else range(axis.bits)
        # Images before the most significant bit that is needed are dark all over.
        frames += [images.image(Shows.GRAY, axis.name, bit) for bit in bits[axis.bits - _bits(sequence, axis) :]]
        frames += [images.image(Shows.SINE, axis.name, _steps(axis).index(step)) for step in _FOUR_DEG]
    return np.stack([one for one in frames if one is not None])


def _bits(sequence: PatternSequence, axis: AxisConvention) -> int:
    return len(sequence.axis(Direction(axis.name)).gray)


def _steps(axis: AxisConvention) -> list[int]:
    """Return what each image adds to our phase, in whole degrees 0 to 359."""
    return [round(axis.begins_deg[0] + step) % 360 for step in axis.signed_deg[0]]


def _other_form(axis: AxisConvention) -> str | None:
    if len(axis.periods_px) != 1:
        return f"it has {len(axis.periods_px)} periods"
    if axis.period_px != round(axis.period_px):
        return f"its period is {axis.period_px:g} px, no whole number"
    if sorted(_steps(axis)) != _FOUR_DEG:
        return f"its steps {', '.join(f'{step}°' for step in _steps(axis))} are not the four of 0°, 90°, 180°, 270°"
    if axis.carriers:
        return "its fringes have a carrier"
    if not axis.bits:
        return "it has no Gray code"
    if axis.plain_binary or axis.inverted:
        return "its code is plain binary, or inverted"
    if axis.stripe_px != 0.5 * axis.period_px or axis.code_offset_px != 0.0:
        return "its code does not number half periods from the edge of the pattern"
    return None
